// Rolling radii and conicity of a wheelset: estimated with 95 % bands, over its design and what was measured.
import { chart } from "./chart.js";
import { el, svg } from "./dom.js";
import { date, number, words } from "./format.js";

const BAND = 1.959964; // half of a normal 95 % interval, in standard deviations
const LIMIT_MM = 3; // amplitude of every conicity limit
const half = (value) => value / 2;
const band = (values, stds, sign) => values.map((value, place) => (value === null || stds[place] === null ? null : value + sign * BAND * stds[place]));
const centres = (bins) => bins.lower_mm.map((low, place) => half(low + bins.upper_mm[place]));

/** What is not estimated, as words: how many bins have which status. */
export function absent(bins, column) {
  const counts = new Map();
  for (const status of column.status) if (status !== "estimated") counts.set(status, (counts.get(status) ?? 0) + 1);
  if (counts.size === 0) return null;
  const listed = [...counts].map(([status, count]) => `${words(status)}: ${count} of ${bins.lower_mm.length} bins`).join("; ");
  return el("p", { class: "absent" }, `Not estimated where shaded. ${listed}.`);
}

function shades(bins, column) {
  return column.status.flatMap((status, place) => (status === "estimated" ? [] : [{ from: bins.lower_mm[place], to: bins.upper_mm[place] }]));
}

const NAMES = {
  rolling_radius_difference_mm: { label: "Rolling radius difference rL \u2212 rR over lateral displacement", y: "rL \u2212 rR, mm" },
  rolling_radius_sum_mm: { label: "Rolling radius sum rL + rR over lateral displacement", y: "rL + rR, mm" },
};

/** One combination of the rolling radii over the lateral displacement. */
export function radiusChart({ geometry, design, comparisons, wheelset }, name, height = 260) {
  const series = [];
  const whole = name === "rolling_radius_sum_mm" ? 2 * wheelset.nominal_radius_mm : 0;
  const bins = geometry?.bins, column = bins?.[name];
  if (column?.value.some((value) => value !== null)) {
    series.push({
      label: "estimate, 95 %", role: "estimate", x: centres(bins), y: column.value,
      low: band(column.value, column.std, -1), high: band(column.value, column.std, 1),
    });
  }
  const drawn = design?.contact.curve;
  if (drawn) series.push(within(bins, { label: `design ${design.wheel_profile}`, role: "design", kind: "dashed", x: drawn.lateral_displacement_mm, y: drawn[name].map((r) => (r === null ? null : r - (column ? whole : 0))) }));
  const [newest] = comparisons;
  if (newest?.measured.curve) series.push(within(bins, measuredCurve(newest, name, column ? whole : 0)));
  return el(
    "div", { class: "charted", data: { chart: name } },
    chart({
      label: NAMES[name].label, height, series,
      x: { label: "lateral displacement, mm, positive to the left", unit: "mm" },
      y: { label: whole && column ? `${NAMES[name].y} \u2212 2 r0` : NAMES[name].y }, shades: column ? shades(bins, column) : [],
    }),
    column ? absent(bins, column) : el("p", { class: "absent" }, "No estimate yet: the curves are those of the profiles."),
    newest?.measured.reason ? el("p", { class: "absent" }, `Measured ${date(newest.measured_at)}: ${newest.measured.reason}`) : null,
  );
}

/** The measured curve; counted from the origin of the estimate where that is known. */
function measuredCurve(one, name, whole) {
  const { curve } = one.measured, origin = name === "rolling_radius_difference_mm" ? one.measured_at_bins : null;
  const dx = origin?.origin_displacement_mm ?? 0, dy = origin?.origin_radius_difference_mm ?? whole;
  const y = curve[name].map((value) => (value === null ? null : value - dy));
  const std = name === "rolling_radius_difference_mm" ? curve.rolling_radius_difference_std_mm : curve[name].map(() => 0);
  const banded = name === "rolling_radius_difference_mm" ? { low: band(y, std, -1), high: band(y, std, 1) } : {};
  return { label: `measured ${date(one.measured_at)}${origin ? ", from the origin of the estimate" : ""}`, role: "measured", x: curve.lateral_displacement_mm.map((x) => x - dx), y, ...banded };
}

/** Curves reach as far as the bins, so that the flange does not squeeze what matters. */
function within(bins, one) {
  const most = bins ? Math.max(...bins.upper_mm.map(Math.abs)) : 6;
  const kept = one.x.map((x) => Math.abs(x) <= most);
  const cut = (values) => values?.filter((_, place) => kept[place]);
  return { ...one, x: cut(one.x), y: cut(one.y), low: cut(one.low), high: cut(one.high) };
}

/** Equivalent conicity by amplitude. */
export function conicityChart({ geometry, design, comparisons, trend }, height = 260) {
  const series = [];
  const estimated = geometry?.conicity_by_amplitude ?? [];
  if (estimated.some((one) => one.equivalent_conicity_1.value !== null)) series.push(ofConicity("estimate, 95 %", "estimate", estimated, "equivalent_conicity_1"));
  const drawn = design?.contact.conicity_by_amplitude ?? [];
  if (drawn.length) series.push({ ...ofConicity(`design ${design.wheel_profile}`, "design", drawn, "equivalent_conicity_1"), kind: "dashed", low: undefined, high: undefined });
  const [newest] = comparisons;
  if (newest?.conicity_by_amplitude.some((one) => one.measured_1.value !== null)) series.push(ofConicity(`measured ${date(newest.measured_at)}`, "measured", newest.conicity_by_amplitude, "measured_1"));
  const limit = trend?.limit_1;
  const unknown = estimated.filter((one) => one.equivalent_conicity_1.value === null);
  const step = estimated.length > 1 ? half(estimated[1].amplitude_mm - estimated[0].amplitude_mm) : 0;
  return el(
    "div", { class: "charted", data: { chart: "conicity" } },
    chart({
      label: "Equivalent conicity by amplitude (EN 15302)", height, series,
      x: { label: "amplitude, mm", unit: "mm" }, y: { label: "equivalent conicity" },
      marks: [...(limit == null ? [] : [{ y: limit, label: `limit ${number(limit, 2)} at 3 mm`, role: "limit" }]), { x: LIMIT_MM, label: "3 mm", role: "event" }],
      shades: unknown.map((one) => ({ from: one.amplitude_mm - step, to: one.amplitude_mm + step })),
    }),
    reasons(unknown.map((one) => [one.amplitude_mm, one.equivalent_conicity_1])),
  );
}

function ofConicity(label, role, rows, field) {
  const found = rows.map((one) => one[field]);
  return {
    label, role, x: rows.map((one) => one.amplitude_mm), y: found.map((one) => one.value),
    low: found.map((one) => one.interval_95?.[0] ?? null), high: found.map((one) => one.interval_95?.[1] ?? null),
  };
}

/** Amplitudes without an estimate by reason: `amplitude not covered: 3.25 to 6 mm`. */
function reasons(unknown) {
  const groups = new Map();
  for (const [amplitude, one] of unknown) {
    const code = words(one.reason_code ?? one.status);
    groups.set(code, [...(groups.get(code) ?? []), amplitude]);
  }
  if (groups.size === 0) return null;
  const listed = [...groups].map(([code, mm]) => `${code}: ${number(Math.min(...mm), 2)} to ${number(Math.max(...mm), 2)} mm`).join("; ");
  return el("p", { class: "absent" }, `Not estimated where shaded. ${listed}.`);
}

/** How many samples each bin has; an unestimated one is hollow and says why. */
export function occupancy({ geometry }) {
  const { bins } = geometry, column = bins.rolling_radius_difference_mm;
  const most = Math.max(1, ...bins.samples_1.map((count) => count ?? 0));
  const width = 620, height = 120, foot = 18, one = width / bins.lower_mm.length;
  const bars = bins.lower_mm.map((low, place) => {
    const count = bins.samples_1[place] ?? 0, known = column.status[place] === "estimated";
    const tall = (count / most) * (height - foot);
    const text = `${number(low, 2)} to ${number(bins.upper_mm[place], 2)} mm: ${number(count)} samples, ${words(column.status[place])}`;
    return svg("rect", { class: known ? "bin" : "bin absent-bin", x: place * one + 0.5, width: Math.max(1, one - 1), y: height - foot - tall, height: Math.max(count ? 1 : 0, tall) }, svg("title", {}, text));
  });
  const at = (mm) => ((mm - bins.lower_mm[0]) / (bins.upper_mm.at(-1) - bins.lower_mm[0])) * width;
  const ticks = [bins.lower_mm[0], 0, bins.upper_mm.at(-1)].map((mm, place) => svg("text", { x: at(mm), y: height - 4, "text-anchor": ["start", "middle", "end"][place] }, `${number(mm, 1)} mm`));
  const estimatedBins = column.status.filter((status) => status === "estimated").length;
  return el(
    "figure", { class: "chart", data: { chart: "occupancy" } }, el("figcaption", {}, "Samples by lateral displacement"),
    svg("svg", { class: "bars", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${estimatedBins} of ${bins.lower_mm.length} bins are estimated` }, svg("line", { class: "foot", x1: 0, x2: width, y1: height - foot, y2: height - foot }), bars, ticks),
    el("p", { class: "absent" }, `${estimatedBins} of ${bins.lower_mm.length} bins estimated; hollow bars are not, their tooltip says why.`),
  );
}
