// The conicity of a wheelset over mileage and date, over all reprofilings, with the fan of its forecast and the limit.
import { chart } from "./chart.js";
import { el } from "./dom.js";
import { date, number, roundKm } from "./format.js";

const seconds = (time) => Date.parse(time) / 1000;
const middle = (one) => (seconds(one.measured_from) + seconds(one.measured_to)) / 2;
const ordered = (x, rows) => {
  const places = x.map((_, place) => place).filter((place) => x[place] !== null).sort((a, b) => x[a] - x[b]);
  return { x: places.map((place) => x[place]), rows: places.map((place) => rows[place]) };
};

/** The trend over mileage (`over` is "mileage") or over date. */
export function trendChart(found, over, height = 280) {
  const { trend, intervals, comparisons, wheelset } = found;
  const byMileage = over === "mileage";
  const place = (one) => (byMileage ? one.mileage_km : middle(one));
  const series = [];
  const earlier = intervals.filter((one) => trend === null || one.baseline !== trend.baseline);
  const now = intervals.filter((one) => trend !== null && one.baseline === trend.baseline);
  if (earlier.length) series.push(points("before the last reprofiling, 95 %", "design", ordered(earlier.map(place), earlier)));
  if (now.length) series.push(points("since then, 95 %", "estimate", ordered(now.map(place), now)));
  else if (trend?.points.value_1.length) series.push(ownPoints(trend, byMileage));
  if (comparisons.length) {
    const rows = comparisons.map((one) => ({ ...one, pair: one.conicity_by_amplitude.find((pair) => pair.amplitude_mm === 3) }));
    const sorted = ordered(rows.map((one) => (byMileage ? one.mileage_km : seconds(one.measured_at))), rows);
    const values = sorted.rows.map((one) => one.pair.measured_1);
    series.push({ label: "measured", role: "measured", kind: "points", x: sorted.x, y: values.map((one) => one.value) });
  }
  series.push(...fan(trend, byMileage));
  const turned = wheelset.reprofilings.map((one) => ({ x: byMileage ? one.mileage_km : seconds(one.reprofiled_at), label: "reprofiled", role: "event" }));
  if (trend?.step) turned.push({ x: byMileage ? trend.step.after_km : seconds(trend.step.after_at), label: "step", role: "event" });
  const limit = trend?.limit_1;
  if (limit != null) turned.push({ y: limit, label: `limit ${number(limit, 3)}`, role: "limit" });
  return el(
    "div", { class: "charted", data: { chart: `trend-${over}` } },
    chart({
      label: `Equivalent conicity at 3 mm over ${over}`, height, series, marks: turned,
      x: byMileage ? { label: "mileage since new, km", unit: "km" } : { time: true, label: "date (UTC)" }, y: { label: "equivalent conicity" },
    }),
    byMileage ? missing(intervals) : null,
  );
}

function points(label, role, { x, rows }) {
  const values = rows.map((one) => one.equivalent_conicity_at_3_mm_1);
  return {
    label, role, kind: "points", x, y: values.map((one) => one.value),
    low: values.map((one) => one.interval_95?.[0] ?? null), high: values.map((one) => one.interval_95?.[1] ?? null),
  };
}

function ownPoints(trend, byMileage) {
  const x = byMileage ? trend.points.mileage_km : trend.points.measured_at.map(seconds);
  const rows = x.map((_, place) => place);
  const sorted = ordered(x, rows), pick = (values) => sorted.rows.map((row) => values[row]);
  const y = pick(trend.points.value_1), std = pick(trend.points.std_1);
  const edge = (sign) => y.map((value, row) => (value === null || std[row] === null ? null : value + sign * 1.959964 * std[row]));
  return { label: "points of the trend, 95 %", role: "estimate", kind: "points", x: sorted.x, y, low: edge(-1), high: edge(1) };
}

/** Straight lines from the fitted value at the last point to the limit, where each quantile reaches it from now on. */
function fan(trend, byMileage) {
  if (!trend || trend.fitted_1.value === null || trend.limit_1 === null || trend.fitted_1.value >= trend.limit_1) return [];
  const at = trend.points;
  const begin = byMileage ? Math.max(...at.mileage_km.filter((km) => km !== null)) : Math.max(...at.measured_at.map(seconds));
  if (!Number.isFinite(begin)) return [];
  const ahead = byMileage ? trend.distance_to_limit_km : trend.date_of_limit;
  const end = (value) => (byMileage ? begin + (trend.since_trend_km ?? 0) + value : seconds(value));
  return ["p10", "p50", "p90"].flatMap((name) => {
    if (ahead[name] === null) return [];
    const to = end(ahead[name]);
    if (!(to > begin)) return [];
    const label = `${name}: ${byMileage ? `in ${roundKm(ahead[name])} km` : date(ahead[name])}`;
    return [{ label, role: "forecast", kind: name === "p50" ? "line" : "dashed", x: [begin, to], y: [trend.fitted_1.value, trend.limit_1] }];
  });
}

function missing(intervals) {
  const unknown = intervals.filter((one) => one.equivalent_conicity_at_3_mm_1.value === null);
  if (unknown.length === 0) return null;
  const codes = [...new Set(unknown.map((one) => (one.equivalent_conicity_at_3_mm_1.reason_code ?? one.status).replaceAll("_", " ")))].join(", ");
  return el("p", { class: "absent" }, `${unknown.length} of ${intervals.length} mileage intervals have no conicity at 3 mm and are left out: ${codes}.`);
}

/** The forecast from now in words. */
export function forecast(now) {
  if (!now) return "nothing is known of it";
  const { p10, p50, p90, reason } = now.distance_to_limit_km, day = now.date_of_limit.p50;
  if (p50 === 0) return `reached already${now.probability_over_limit_1 === null ? "" : ` (probability ${Math.min(99, Math.floor(100 * now.probability_over_limit_1 + 1e-9))} %)`}`;
  if (p50 === null) return reason ?? "not known";
  return `in ${roundKm(p50)} km (80 %: ${roundKm(p10)} km to ${p90 === null ? "beyond the horizon" : `${roundKm(p90)} km`})${day ? `, about ${date(day)}` : ""}`;
}
