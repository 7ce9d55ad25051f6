// Track sections: alignment with its 95 % band along the section, gauge deviation, versions, and how they were found.
import { getAll, getIfAny, segment } from "./client.js";
import { el } from "./dom.js";
import { chart } from "./chart.js";
import { age, moment, number, words } from "./format.js";
import { live } from "./live.js";
import { empty } from "./states.js";
import { table } from "./table.js";
import { frictionPanel, railsPanel } from "./track_findings.js";

const BAND = 1.959964; // half of a normal 95 % interval, in standard deviations
const second = (...content) => el("span", { class: "second" }, ...content);
const address = (section) => `#/tracks/${segment(section.code)}`;
const TONES = { estimated: "good", invalid: "critical", unestimated: "info" };
const status = (found) => el("span", { class: `badge ${TONES[found.status] ?? "warning"}`, title: found.reason }, words(found.status));

export async function tracks({ signal, title }) {
  title("Track sections");
  const list = table({
    label: "Track sections", rowHeight: 48, keyOf: (row) => row.section.code, onOpen: (row) => (location.hash = address(row.section)),
    columns: [
      { name: "section", label: "Section", cell: ({ section }) => [el("a", { href: address(section), tabindex: -1 }, section.code), second(section.name)] },
      { name: "length", label: "Length, km", class: "right", cell: ({ section }) => number(section.length_m / 1000, 2) },
      { name: "rail", label: "Rail", cell: ({ section }) => [section.rail_profile, second(`gauge ${number(section.nominal_gauge_mm)} mm`)] },
      { name: "status", label: "Alignment", cell: ({ newest, report }) => standing(newest, report) },
      { name: "std", label: "Std, mm", class: "right", title: "Median along the section", cell: ({ newest }) => (newest?.alignment_std_mm == null ? el("span", { class: "unknown" }, "unknown") : number(newest.alignment_std_mm, 2)) },
      { name: "reason", label: "Last run", cell: ({ report }) => el("span", { class: "clamp" }, report === null ? "no run yet" : `${age(report.recorded_at)}: ${report.reason ?? report.recording ?? runWords(report)}`) },
    ],
    nothing: () => empty("No track section is registered.", "Vehicles on unknown sections are not estimated: register the sections they run on."),
  });
  const load = async () => Promise.all((await getAll("/v1/track-sections?limit=1000", signal)).map(async (section) => ({
    section, newest: (await getAll(section.links.alignments, signal)).at(-1) ?? null, report: await getIfAny(section.links.alignment_report, signal),
  })));
  return el("div", {}, el("div", { class: "view-head" }, el("h1", {}, "Track sections")), live({ load, show: (rows) => list.setRows(rows), signal, everyS: 120 }));
}

function standing(newest, report) {
  if (newest === null) return [el("span", { class: "badge info" }, "unestimated"), second(report?.reason ?? "neither surveyed nor estimated yet")];
  return [status(newest), second(`${newest.source === "fleet" ? "found by the fleet" : "surveyed"}, version ${newest.version}`)];
}

const runWords = (report) => `${report.n_windows} windows, ${report.passes} passes, ${report.wheelsets} wheelsets`;

export async function track({ params, signal, title }) {
  title(`Section ${params.code}`);
  const path = `/v1/track-sections/${segment(params.code)}`;
  const load = async () => {
    const [section, versions, alignment, report, adhesion, rails] = await Promise.all([
      getIfAny(path, signal), getAll(`${path}/alignments?limit=1000`, signal).catch(missing), getIfAny(`${path}/alignment`, signal), getIfAny(`${path}/alignment-report`, signal),
      getIfAny(`${path}/adhesion`, signal), getIfAny(`${path}/rails`, signal),
    ]);
    return { section, versions, alignment, report, adhesion, rails };
  };
  return el("div", { data: { back: "#/tracks" } }, live({ load, show, signal, everyS: 300, what: "Loading the section" }));
}

function missing(error) {
  if (error.status === 404) return [];
  throw error;
}

function show({ section, versions, alignment, report, adhesion, rails }) {
  if (section === null) return empty("There is no such track section.");
  const head = el(
    "div", { class: "view-head" }, el("h1", {}, `Section ${section.code}`),
    alignment ? status(alignment) : el("span", { class: "badge info" }, "unestimated"),
    el("p", { class: "quiet" }, `${section.name}; ${number(section.length_m / 1000, 2)} km, rail ${section.rail_profile}, inclination 1:${number(1 / section.rail_inclination_1)}, nominal gauge ${number(section.nominal_gauge_mm)} mm`),
  );
  return [
    head,
    alignment === null
      ? el("section", { class: "panel" }, empty("No alignment yet.", report?.reason ?? "It is neither surveyed nor estimated."))
      : el("section", { class: "panel" }, charts(alignment)),
    el("div", { class: "grid" }, frictionPanel(adhesion), railsPanel(rails), versionsPanel(versions), reportPanel(report)),
  ];
}

/** Lines with gaps where nothing is known: a place without a value is none. */
function charts(found) {
  const x = { label: "position, m", unit: "m" };
  const line = (label, values, std, role) => ({
    label, x: found.position_m, y: values, role, digits: 2, width: 1.1,
    low: values.map((value, place) => (value === null || std[place] === null ? null : value - BAND * std[place])),
    high: values.map((value, place) => (value === null || std[place] === null ? null : value + BAND * std[place])),
  });
  const parts = [];
  if (found.alignment_mm.some((value) => value !== null)) {
    parts.push(chart({ label: "Lateral alignment, mm, positive to the left; 95 % band", height: 250, sync: "track", x, y: { label: "mm" }, series: [line("alignment", found.alignment_mm, found.alignment_std_mm, "estimate")] }));
  } else parts.push(empty("No alignment is known along this section."));
  if (found.gauge_known && found.gauge_deviation_mm.some((value) => value !== null)) {
    parts.push(chart({ label: "Gauge deviation, mm, as surveyed; 95 % band", height: 180, sync: "track", x, y: { label: "mm" }, series: [line("gauge deviation", found.gauge_deviation_mm, found.gauge_deviation_std_mm, "second")] }));
  } else parts.push(el("p", { class: "quiet" }, "Gauge deviation: not on file. Passes do not determine its sign; its effect is in the intervals."));
  parts.push(chart({ label: "Passes behind each place", height: 110, sync: "track", x, y: { label: "passes" }, series: [{ label: "passes", x: found.position_m, y: found.passes, role: "design", digits: 0 }] }));
  return parts;
}

function versionsPanel(versions) {
  const row = (one) => el(
    "tr", {}, el("td", { class: "right" }, one.version), el("td", {}, status(one)), el("td", {}, one.source === "fleet" ? "fleet" : "survey"),
    el("td", { class: "right" }, one.alignment_std_mm === null ? "" : number(one.alignment_std_mm, 2)), el("td", { class: "right" }, one.cut_off_m === null ? "all" : `up to ${number(one.cut_off_m)} m`),
    el("td", { class: "right" }, one.points), el("td", {}, one.recorded_at ? moment(one.recorded_at) : "as registered"),
  );
  const heads = [["Version", true], ["Status"], ["Source"], ["Std, mm", true], ["Wavelengths", true], ["Points", true], ["Recorded"]];
  return el(
    "section", { class: "panel wide" }, el("h2", {}, "Versions, the newest first"),
    versions.length === 0 ? el("p", { class: "quiet" }, "None yet.") : el("table", { class: "plain" },
      el("thead", {}, el("tr", {}, heads.map(([name, right]) => el("th", { scope: "col", class: right ? "right" : null }, name)))), el("tbody", {}, [...versions].reverse().map(row))),
  );
}

function reportPanel(report) {
  if (report === null) return el("section", { class: "panel" }, el("h2", {}, "Last run"), el("p", { class: "quiet" }, "No run of refresh_alignment has looked at this section yet."));
  const fact = (name, value) => (value === null || value === undefined || value === "" ? null : [el("dt", {}, name), el("dd", {}, value)]);
  const refused = Object.entries(report.refused_windows).map(([why, count]) => `${count}: ${why}`).join("; ");
  return el(
    "section", { class: "panel" }, el("h2", {}, "Last run"),
    report.reason ? el("p", {}, el("b", {}, report.reason)) : null,
    el("dl", { class: "facts" },
      fact("Status", status(report)), fact("Recorded", `${moment(report.recorded_at)}, ${age(report.recorded_at)}`), fact("From", runWords(report)),
      fact("Known along", report.covered_1 === null ? null : `${number(100 * report.covered_1)} % of the section`), fact("Passes a place", report.mean_passes_1 === null ? null : number(report.mean_passes_1, 1)),
      fact("Converged", report.converged ? `yes, in ${report.rounds} rounds` : `no, after ${report.rounds} rounds`), fact("Residual, RMS", report.residual_rms_mm === null ? null : `${number(report.residual_rms_mm, 3)} mm`),
      fact("Besides", report.evidence.join(", ")), fact("Survey checked", report.recording), fact("Refused windows", refused)),
    el("h3", {}, "Journeys"),
    el("div", { class: "wide" }, el("table", { class: "plain" },
      el("thead", {}, el("tr", {}, ["Vehicle", "From", "Passes", "Moved by, m", "Residual, mm", "Used"].map((name) => el("th", { scope: "col" }, name)))),
      el("tbody", {}, report.journeys.map((one) => el("tr", {}, el("td", {}, one.vehicle), el("td", {}, moment(one.measured_from)), el("td", {}, one.passes), el("td", {}, one.offset_m === null ? "unknown" : number(one.offset_m, 1)), el("td", {}, one.residual_rms_mm === null ? "unknown" : number(one.residual_rms_mm, 3)), el("td", {}, one.used ? "yes" : `no: ${one.reason ?? "unknown"}`)))))),
  );
}
