// The columns of the fleet: how urgent and why, conicity against its limit, how far it still runs.
import { el } from "./dom.js";
import { segment } from "./client.js";
import { date, lastData, number, roundKm, words } from "./format.js";
import { interval } from "./interval.js";

const TONES = { over_limit: "critical", probably_over: "warning", critical_alert: "critical", due: "warning", watch: "warning", unknown: "info" };
const NAMES = { over_limit: "over the limit", critical_alert: "critical" };

export const SLOPE_DIGITS = 5; // of a slope per 1,000 km: some 0.001

/** Urgencies, the most urgent first, as the API names them. */
export const URGENCIES = ["over_limit", "probably_over", "critical_alert", "due", "watch", "unknown", "fine", "not_mounted"];
export const nameOf = (urgency) => NAMES[urgency] ?? words(urgency);
/** An urgency in its words and its tone, which is that of the alerts behind it; `kind` is how it is drawn. */
export const urgencyBadge = (urgency, kind = "badge") => el("span", { class: `${kind} ${TONES[urgency] ?? ""}` }, nameOf(urgency));
export const address = (row) => `#/wheelsets/${segment(row.serial)}`;
const second = (...content) => el("span", { class: "second" }, ...content);

/** The columns; `most` is the end of the scale that all rows share. */
export const columns = (most) => [
  { name: "urgency", label: "Urgency", sort: "urgency", title: "How soon somebody has to look at it", cell: urgency },
  { name: "serial", label: "Wheelset", sort: "serial", cell: (row) => [el("a", { href: address(row), tabindex: -1 }, row.serial), second(row.fleet)] },
  { name: "place", label: "Vehicle, axle", cell: place },
  { name: "why", label: "Why", cell: why },
  { name: "conicity", label: "Conicity at 3 mm, 95 %", sort: "-conicity", title: "Equivalent conicity with its 95 % interval; the line across is the limit", cell: (row) => conicity(row.state, most()) },
  { name: "trend", label: "Per 1,000 km", class: "right", sort: "-trend", title: "Slope of the conicity since the last reprofiling", cell: (row) => slope(row.state.slope_1_per_1000_km) },
  { name: "distance", label: "To the limit, km", class: "right", sort: "distance_to_limit", title: "Still to run: median, and p10 to p90", cell: (row) => distance(row.state.distance_to_limit_km) },
  { name: "limitdate", label: "Reached about", class: "right", title: "When the limit is reached: median, and p10", cell: (row) => limitDate(row.state) },
  { name: "mileage", label: "Mileage, km", class: "right", sort: "-mileage", title: "Since new", cell: (row) => known(row.state.mileage_km, number) },
  { name: "data", label: "Last data", class: "right", sort: "last_data", cell: (row) => lastData(row.state.last_data_at) },
];

function urgency({ state }) {
  const open = state.alerts.length;
  const taken = state.alerts.filter((alert) => alert.acknowledged || alert.shelved_until).length;
  const note = taken ? `${taken} of ${open} seen` : `${open} alert${open === 1 ? "" : "s"}`;
  return [urgencyBadge(state.urgency), open ? second(note) : null];
}

function place(row) {
  if (row.vehicle === null) return el("span", { class: "unknown" }, "not mounted");
  const bogie = row.position?.bogie ? `bogie ${row.position.bogie}, ${row.position.place}` : null;
  return [`${row.vehicle}, axle ${row.axle}`, second(bogie ?? row.vehicle_class)];
}

function why({ state }) {
  const all = state.reasons.map((reason) => reason.text).join("; ");
  return el("span", { class: "clamp", title: all }, all || "no reason to look at it");
}

function conicity(state, most) {
  const found = state.conicity_1;
  const drawing = interval(found, state.limit_1, most, state.urgency === "over_limit");
  if (found.value === null) {
    const text = found.status === "invalid" ? "invalid" : found.status === "unestimated" ? "not estimated" : words(found.status);
    return el("span", { class: "drawn" }, drawing, el("span", { class: "unknown", title: found.reason }, text, second(found.reason)));
  }
  const [low, high] = found.interval_95;
  const note = found.status !== "estimated" ? words(found.status) : found.reason_code === "amplitude_extrapolated" ? "extrapolated" : null;
  return el(
    "span", { class: "drawn", title: found.reason },
    drawing,
    el("span", {}, el("b", {}, number(found.value, 3)), note ? el("span", { class: "note" }, note) : null, second(`${number(low, 3)} to ${number(high, 3)}`)),
  );
}

function slope(found) {
  if (found.value === null) return el("span", { class: "unknown", title: found.reason }, "not estimated");
  const [low, high] = found.interval_95;
  const signed = (value) => `${value < 0 ? "" : "+"}${number(value, SLOPE_DIGITS)}`;
  return [signed(found.value), second(`${number(low, SLOPE_DIGITS)} to ${number(high, SLOPE_DIGITS)}`)];
}

/** The distance that is left to the limit, from now: median, and p10 to p90. */
export function distance({ p10, p50, p90, reason, reason_code: code }) {
  if (p10 === null && p50 === null) {
    const beyond = code === "beyond_horizon";
    return el("span", { class: beyond ? "quiet" : "unknown", title: reason }, beyond ? "beyond horizon" : "not estimated");
  }
  if (p50 === null) return [`> ${roundKm(p10)}`, second("median beyond")];
  const to = p90 === null ? "beyond" : roundKm(p90);
  return [el("b", {}, roundKm(p50)), second(`${roundKm(p10)} to ${to}`)];
}

function limitDate(state) {
  const { p10, p50 } = state.date_of_limit;
  if (p10 === null && p50 === null) return el("span", { class: "quiet" }, "\u2013");
  return [p50 === null ? "beyond horizon" : date(p50), p10 === null ? null : second(`p10 ${date(p10)}`)];
}

const known = (value, text) => (value === null ? el("span", { class: "unknown" }, "unknown") : text(value));
