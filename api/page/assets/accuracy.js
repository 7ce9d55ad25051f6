// Estimates against measured profiles over the fleet: whether the intervals cover, and which do not.
import { chart } from "./chart.js";
import { get, getAll, segment, withQuery } from "./client.js";
import { el } from "./dom.js";
import { filters } from "./filters.js";
import { date, estimate, km, number, words } from "./format.js";
import { live } from "./live.js";
import { keepQuery } from "./router.js";
import { empty } from "./states.js";
import { saveButton } from "./table_file.js";

const NEWEST = 500, DAY_S = 86400;
const TONES = { covered: "good", not_covered: "warning" };

export async function accuracy({ query, signal, title }) {
  title("Accuracy");
  let wanted = query.fleet ? { fleet: query.fleet } : {};
  const fleets = await getAll("/v1/fleets?limit=1000", signal);
  const path = () => withQuery("/v1/accuracy", { ...wanted, limit: NEWEST });
  const shown = live({ load: () => get(path(), signal), show, signal, everyS: 300, what: "Comparing with the measured profiles" });
  const chosen = (values) => {
    wanted = values;
    keepQuery(wanted);
    shown.reload({ other: true });
  };
  const fields = [{ name: "fleet", label: "Fleet", options: fleets.map((fleet) => [fleet.code, fleet.code]) }];
  return el(
    "div", {},
    el("div", { class: "view-head" }, el("h1", {}, "Accuracy"), el("p", { class: "quiet" }, "Estimated conicity at 3 mm beside the conicity of measured profiles. Of 100 intervals, about 95 should cover.")),
    filters(fields, wanted, chosen, saveButton(el, path, "accuracy.csv")), shown,
  );
}

function show(found) {
  if (found.considered === 0 && found.unreadable.length === 0) {
    return empty("No measured profile is on file.", "Load one with a registry file (measured_profiles), or POST it to measured-profiles of its wheelset: the estimates are then held against it.");
  }
  const { everything, independent } = found.coverage;
  return el(
    "div", { class: "grid" },
    panel("Do the intervals cover?", "",
      el("dl", { class: "facts" },
        el("dt", {}, "All comparisons"), el("dd", {}, share(everything)),
        el("dt", {}, "Independent ones"), el("dd", {}, share(independent), el("span", { class: "second" }, "their estimate used no measurement of the same profiles")),
        el("dt", {}, "Measurements"), el("dd", {}, `${number(found.considered)} of ${number(found.on_file)} on file, the newest`),
        el("dt", {}, "z rms, all comparisons"), el("dd", {}, decimal(everything.z_rms_1), el("span", { class: "second" }, "error over standard deviation: below 1 intervals are wider than they need be, above 1 too narrow")),
        el("dt", {}, "Mean z"), el("dd", {}, decimal(everything.mean_z_1, true), el("span", { class: "second" }, "above 0 estimates are too high, below 0 too low")),
        found.not_compared.map((one) => [el("dt", {}, "Not compared"), el("dd", {}, `${number(one.measurements)}: ${words(one.reason_code)}`)]),
        found.unreadable.map((one) => [el("dt", {}, "Unreadable"), el("dd", {}, link(one.wheelset), el("span", { class: "second" }, one.reason))]),
      )),
    drawn(found.measurements),
    monitor(found.measurements),
    panel("By amplitude", "", shares("Amplitude", found.coverage_by_amplitude.map((one) => [`${number(one.amplitude_mm)} mm`, one]))),
    panel("By class and section", "",
      shares("Vehicle class", found.coverage_by_vehicle_class.map((one) => [one.key, one])),
      shares("Track section", found.coverage_by_track_section.map((one) => [el("a", { href: `#/tracks/${segment(one.key)}` }, one.key), one]))),
    panel("Measurements", "wide-panel", measurements(found.measurements)),
  );
}

const panel = (name, extra, ...content) => el("section", { class: `panel wide ${extra}`, "aria-label": name }, el("h2", {}, name), ...content);
const link = (serial) => el("a", { href: `#/wheelsets/${segment(serial)}` }, serial);

/** `34 of 36`, with the share and its own 95 % interval. */
function share({ compared, covered, fraction_1: fraction, fraction_interval_95_1: interval }) {
  if (compared === 0) return el("span", { class: "unknown" }, "nothing was compared");
  return el("span", {}, el("b", {}, `${number(covered)} of ${number(compared)}`), ` ${number(100 * fraction)} %`, el("span", { class: "interval" }, `[${number(100 * interval[0])} %, ${number(100 * interval[1])} %]`));
}

function shares(name, lines) {
  if (lines.length === 0) return el("p", { class: "absent" }, `${name}: nothing was compared.`);
  return el(
    "table", { class: "plain" },
    el("thead", {}, el("tr", {}, [name, "Covered", "z: rms, mean", "Independent, covered", "z: rms, mean"].map((text) => el("th", { scope: "col" }, text)))),
    el("tbody", {}, lines.map(([key, one]) => el("tr", {}, el("td", {}, key), held(one.everything), held(one.independent)))),
  );
}

const decimal = (value, signed) => (value === null ? "" : `${signed && value > 0 ? "+" : ""}${number(value, 2)}`);
const held = (one) => [el("td", {}, share(one)), el("td", {}, one.z_rms_1 === null ? "" : `${decimal(one.z_rms_1)}, ${decimal(one.mean_z_1, true)}`)];

/** z of every measurement over its date: about 95 of 100 are within 1.96, and none of them drifts. */
function monitor(found) {
  const compared = found.filter((row) => row.z_1 !== null).sort((one, other) => Date.parse(one.measured_at) - Date.parse(other.measured_at));
  if (compared.length === 0) return null;
  const at = new Map(compared.map((row, place) => [row, Date.parse(row.measured_at) / 1000 + place])); // of one time each keeps its point
  const points = (outcome, label, role) => {
    const rows = compared.filter((row) => (row.outcome === "covered") === outcome);
    return { label, role, kind: "points", digits: 2, x: rows.map((row) => at.get(row)), y: rows.map((row) => row.z_1) };
  };
  const series = [points(true, "covered", "estimate"), points(false, "not covered", "limit")].filter((one) => one.x.length);
  const far = Math.max(3, ...compared.map((row) => 1.1 * Math.abs(row.z_1)));
  return panel("z over time", "", chart({
    label: "Estimate less measurement, over the standard deviation of both", height: 200, x: { time: true, range: [at.get(compared[0]) - DAY_S, at.get(compared.at(-1)) + DAY_S] }, y: { label: "z", range: [-far, far], digits: 1 },
    series, marks: [1.96, 0, -1.96].map((y) => ({ y, label: y ? number(y, 2) : "", role: "design" })),
  }));
}

/** Estimated against measured conicity: what lies on the line agrees. */
function drawn(found) {
  const both = found.filter((row) => row.measured_1.value !== null && row.estimated_1.value !== null);
  if (both.length === 0) return null;
  both.sort((one, other) => one.measured_1.value - other.measured_1.value);
  const ends = [both[0].measured_1.value, both.at(-1).measured_1.value];
  const points = (outcome, label, role) => {
    const rows = both.filter((row) => (row.outcome === "covered") === outcome);
    return { label, role, kind: "points", digits: 3, x: rows.map((row) => row.measured_1.value), y: rows.map((row) => row.estimated_1.value) };
  };
  const series = [points(true, "covered", "estimate"), points(false, "not covered", "limit"), { label: "equal", role: "design", kind: "dashed", digits: 3, x: ends, y: ends }];
  return panel("Estimated against measured", "", chart({
    label: "Equivalent conicity at 3 mm", height: 240, x: { label: "measured", digits: 3 }, y: { label: "estimated", digits: 3 },
    series: series.filter((one) => one.x.length && (one.kind === "points" || ends[0] < ends[1])),
  }));
}

function measurements(found) {
  const heads = ["Wheelset", "Measured", "Outcome", "Conicity at 3 mm, measured", "estimated", "z", "Independent", "Why it is not compared"];
  return el(
    "table", { class: "plain" },
    el("thead", {}, el("tr", {}, heads.map((text) => el("th", { scope: "col" }, text)))),
    el("tbody", {}, found.map((row) => el(
      "tr", {}, el("td", {}, link(row.wheelset), row.vehicle_class ? el("span", { class: "second" }, row.vehicle_class) : null),
      el("td", {}, date(row.measured_at), el("span", { class: "second" }, km(row.mileage_km))),
      el("td", {}, el("span", { class: `badge ${TONES[row.outcome] ?? ""}` }, words(row.outcome))),
      el("td", {}, estimate(row.measured_1)), el("td", {}, estimate(row.estimated_1)), el("td", {}, decimal(row.z_1, true)),
      el("td", {}, row.independent === null ? "" : row.independent ? "yes" : "no"), el("td", {}, row.reason ?? ""),
    ))),
  );
}
