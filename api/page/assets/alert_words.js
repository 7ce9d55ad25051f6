// What an alert says, in words: its evidence by kind, with the numbers, intervals and limits that led to it.
import { date, number, roundKm, words } from "./format.js";

/** Kinds of alerts of wheelsets and track sections; a test compares them with the rules. */
export const KINDS = [
  "conicity_limit", "measure", "limit_forecast", "wheel_asymmetry", "no_data", "sensor_fault", "identity", "hunting",
  "suspension_change", "data_quality", "low_adhesion", "weak_damper", "unregistered_change", "wheel_flat",
];

const ACTIONS = {
  reprofile: "Turn the wheelset, or measure its profiles.",
  register_event: "Register what happened: a reprofiling, an exchange, another sensor.",
};
const STATES = { active: "open", pending: "pending", unknown: "not assessable now" };

export const stateOf = (alert) => STATES[alert.display_state] ?? alert.display_state;
export const actionOf = (alert) => ACTIONS[alert.action] ?? `${words(alert.action)[0].toUpperCase()}${words(alert.action).slice(1)}.`;

const have = (...values) => values.every((value) => value !== null && value !== undefined);
const part = (known, text) => (known ? [text()] : []);
const uncertain = (found, digits, unit = "") =>
  `${number(found.value, digits)}${unit} (95 %: ${number(found.interval_95[0], digits)} to ${number(found.interval_95[1], digits)}${unit})`;
const estimated = (found) => have(found) && found.value !== null;
const counted = (reasons) => Object.entries(reasons ?? {}).map(([name, count]) => `${count} ${words(name)}`).join(", ");

const OF_KIND = {
  conicity_limit: (e, alert) => [
    ...part(estimated(e.current_1), () => `equivalent conicity ${uncertain(e.current_1, 3)} at 3 mm`),
    ...part(estimated(e.conicity_1) && have(e.amplitude_mm) && e.amplitude_mm < 3, () => `${uncertain(e.conicity_1, 3)} at ${number(e.amplitude_mm, 2)} mm, as far as it moves`),
    ...part(have(e.limit_1 ?? alert.raise_limit), () => `limit ${number(e.limit_1 ?? alert.raise_limit, 3)}`),
    ...part(have(alert.probability_1), () => `exceeded with a probability of ${number(100 * alert.probability_1, 1)} %`),
  ],
  measure: (e, alert) => [
    "may be beyond its limit: measure",
    ...part(estimated(e.conicity_1), () => `equivalent conicity ${uncertain(e.conicity_1, 3)} at 3 mm${have(e.reached_mm) && e.reached_mm < 3 ? ", extrapolated" : ""}`),
    ...part(estimated(e.reached_1) && have(e.reached_mm) && e.reached_mm < 3, () => `${uncertain(e.reached_1, 3)} at ${number(e.reached_mm, 2)} mm, as far as it moves`),
    ...part(have(e.limit_1 ?? alert.raise_limit), () => `limit ${number(e.limit_1 ?? alert.raise_limit, 3)}`),
    ...part(have(alert.probability_1), () => `${estimated(e.reached_1) && have(e.reached_mm) && e.reached_mm < 3 ? "the likelier of the two is over it" : "by the data alone it is exceeded"} with a probability of ${number(100 * alert.probability_1, 1)} %`),
  ],
  limit_forecast: (e) => [
    ...part(have(e.distance_to_limit_km?.p50), () => (e.distance_to_limit_km.p50 > 0 ? `limit reached in ${roundKm(e.distance_to_limit_km.p50)} km` : "limit reached already")),
    ...part(have(e.distance_to_limit_km?.p10), () => `p10 ${roundKm(e.distance_to_limit_km.p10)} km`),
    ...part(have(e.date_of_limit?.p50), () => `about ${date(e.date_of_limit.p50)}`),
    ...part(have(e.limit_1), () => `limit ${number(e.limit_1, 3)}`),
    ...part(have(e.points), () => `trend of ${e.points} points`),
  ],
  wheel_asymmetry: (e) => [
    ...part(estimated(e.offset_mm), () => `wheels roll on one radius at ${uncertain(e.offset_mm, 2, " mm")}`),
    ...part(estimated(e.shape_mm), () => `even part of the rolling radius difference ${uncertain(e.shape_mm, 2, " mm")}`),
    ...part(e.raised_by?.length, () => `raised by ${e.raised_by.join(" and ")}`),
  ],
  no_data: (e, alert) => [
    have(e.last_usable_at) ? `no usable data since ${date(e.last_usable_at)}` : "no usable data ever",
    ...part(have(e.limit_days ?? alert.raise_limit), () => `limit ${number(e.limit_days ?? alert.raise_limit)} days`),
    ...part(e.refused_windows > 0, () => `data arrive, and cannot be used: ${counted(e.reasons)}`),
    ...part(have(e.reason), () => e.reason),
  ],
  sensor_fault: (e) => [
    ...part(have(e.faulty_windows, e.windows), () => `${e.faulty_windows} of the latest ${e.windows} windows are of a faulty sensor`),
    ...part(counted(e.reasons), () => counted(e.reasons)),
  ],
  identity: (e) => [
    ...part(have(e.reason), () => e.reason),
    ...part(have(e.partner), () => `other wheelset: ${e.partner}`),
    ...part(have(e.first_data_after_at), () => `since ${date(e.first_data_after_at)}`),
  ],
  hunting: (e) => [
    ...part(have(e.hunting_windows, e.windows), () => `hunting in ${e.hunting_windows} of the latest ${e.windows} windows`),
    ...part(have(e.frequency_hz), () => `${number(e.frequency_hz, 1)} Hz`),
    ...part(have(e.amplitude_mm), () => `up to ${number(e.amplitude_mm, 1)} mm`),
    ...part(have(e.speed_max_km_h), () => `up to ${number(e.speed_max_km_h)} km/h`),
  ],
  suspension_change: (e) => [
    ...part(estimated(e.change_1), () => `yaw stiffness has changed by ${number(100 * e.change_1.value)} % (95 %: ${e.change_1.interval_95.map((edge) => number(100 * edge)).join(" to ")} %)`),
    ...part(have(e.limit_1), () => `limit ${number(100 * e.limit_1)} %`),
    ...part(have(e.vehicle), () => `vehicle ${e.vehicle}`),
  ],
  data_quality: (e) => [
    ...part(e.implausible_windows > 0, () => `${e.implausible_windows} of the latest ${e.windows} windows are implausible: ${counted(e.reasons)}`),
    ...part(e.rejected_recordings > 0, () => `${e.rejected_recordings} recordings rejected: ${counted(e.rejected_reasons)}`),
  ],
  low_adhesion: (e) => [
    ...part(estimated(e.friction_1), () => `friction ${uncertain(e.friction_1, 2)}`),
    ...part(e.stretches?.length, () => e.stretches.map((one) => `${number(one.from_m)} to ${number(one.to_m)} m`).join(", ")),
    ...part(have(e.limit_1), () => `limit ${number(e.limit_1, 2)}`),
    ...part(have(e.passes), () => `${e.passes} passes of wheelsets`),
  ],
  weak_damper: (e) => [
    ...part(estimated(e.damping_share_1), () => `${uncertain(e.damping_share_1, 2)} of its damping is left`),
    ...part(have(e.limit_1), () => `limit ${number(e.limit_1, 2)}`),
    ...part(have(e.vehicle, e.first_axle), () => `vehicle ${e.vehicle}, running gear from axle ${e.first_axle}`),
  ],
  unregistered_change: (e) => [
    ...part(estimated(e.size_1), () => `the conicity has changed by ${uncertain(e.size_1, 2)}${have(e.level_before_1) ? ` from ${number(e.level_before_1, 2)}` : ""}`),
    ...part(have(e.before_km, e.after_km), () => `between ${roundKm(e.before_km)} and ${roundKm(e.after_km)} km`),
    ...part(have(e.first_data_behind_at), () => `before ${date(e.first_data_behind_at)}`),
    ...part(e.causes?.length, () => e.causes.filter((one) => one.share_1 >= 0.1).map((one) => `${words(one.cause)} ${number(100 * one.share_1)} %`).join(", ")),
    ...part(have(e.intervals_behind), () => `${e.intervals_behind} intervals since`),
  ],
  wheel_flat: (e) => [
    ...part(have(e.striking_windows, e.windows), () => `${have(e.wheel) ? `the ${e.wheel} wheel` : "a wheel"} strikes once a turn in ${e.striking_windows} of the latest ${e.windows} windows`),
    ...part(have(e.blow_m_s2), () => `blows of ${number(e.blow_m_s2)} m/s2`),
    ...part(have(e.speed_max_km_h), () => `up to ${number(e.speed_max_km_h)} km/h`),
  ],
  fleet_alert: (e) => [
    ...part(have(e.member_count), () => `stands for ${e.member_count} alerts, ${e.open_member_count} of them open`),
    ...part(e.wheelsets?.length, () => `${e.wheelsets.join(", ")}${e.member_count > e.wheelsets.length ? ", \u2026" : ""}`),
  ],
};

/** The evidence of an alert as one line. */
export function evidenceOf(alert) {
  const found = alert.evidence;
  const parts = OF_KIND[found.kind]?.(found, alert) ?? other(found);
  if (found.unknown_because) parts.push(`now unknown: ${found.unknown_because}`);
  return parts.join("; ") || `raised with a probability of ${number(100 * alert.probability_1, 1)} %`;
}

const other = (found) => [
  ...Object.entries(found.numbers ?? {}).filter(([, value]) => value !== null).map(([name, value]) => `${words(name)} ${number(value, 3)}`),
  ...Object.entries(found.texts ?? {}).map(([name, text]) => `${words(name)}: ${text}`),
];
