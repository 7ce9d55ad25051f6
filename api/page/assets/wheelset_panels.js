// Panels of a wheelset's view that are tables and facts: measurements, alerts, data quality, fit, events.
import { act } from "./alert_actions.js";
import { buttons } from "./alerts.js";
import { actionOf, evidenceOf, stateOf } from "./alert_words.js";
import { el, svg } from "./dom.js";
import { date, estimate, km, moment, number, words } from "./format.js";

const head = (...names) => el("thead", {}, el("tr", {}, names.map((name) => el("th", { scope: "col" }, name))));
export const fact = (name, ...value) => [el("dt", {}, name), el("dd", {}, ...value)];
export const panel = (name, title, ...content) => el("section", { class: "panel", data: { panel: name } }, el("h2", {}, title), ...content);
const mm = (value) => (value === null ? el("span", { class: "unknown" }, "unknown") : number(value, 2));

/** Measured profiles beside the estimates of their dates. */
export function measurementsPanel({ comparisons, measurements }) {
  if (comparisons.length === 0) return panel("measured", "Estimate against measurement", el("p", { class: "absent" }, "No profile of this wheelset has been measured, so nothing can be compared."));
  const rows = comparisons.flatMap((one) => ["left", "right"].map((side) => {
    const wheel = one.wheels[side], pair = one.conicity_by_amplitude.find((item) => item.amplitude_mm === 3);
    const both = side === "left" ? [
      el("td", { rowspan: 2 }, date(one.measured_at), el("span", { class: "second" }, km(one.mileage_km))),
    ] : [];
    const compared = side === "left" ? [
      el("td", { rowspan: 2 }, estimate(pair.measured_1)), el("td", { rowspan: 2 }, estimate(pair.estimated_1)),
      el("td", { rowspan: 2 }, verdict(one, pair), el("span", { class: "second" }, independence(one))),
    ] : [];
    return el("tr", {}, both, el("td", {}, side), [wheel.flange_thickness_mm, wheel.flange_height_mm, wheel.flange_gradient_mm, wheel.hollow_mm].map((value) => el("td", { class: "right", title: wheel.reason }, mm(value))), compared);
  }));
  const older = measurements.length - comparisons.length;
  return panel(
    "measured", "Estimate against measurement",
    el("div", { class: "wide" }, el("table", { class: "plain compared" },
      head("Measured", "Wheel", "Sd, mm", "Sh, mm", "qR, mm", "Hollow, mm", "Conicity at 3 mm, measured", "estimated", "95 % interval"), el("tbody", {}, rows))),
    el("p", { class: "absent" }, comparisons[0].estimated_wheels.reason[0].toUpperCase() + comparisons[0].estimated_wheels.reason.slice(1), "."),
    older > 0 ? el("p", { class: "absent" }, `${older} older measurements are not shown.`) : null,
  );
}

function verdict(one, pair) {
  if (pair.covered === null) return el("span", { class: "unknown" }, one.reason ?? "not compared");
  return el("span", { class: `badge ${pair.covered ? "good" : "warning"}` }, pair.covered ? "covers" : "does not cover");
}

function independence(one) {
  if (one.independent === null) return "";
  return one.independent ? "an independent check" : "no independent check: the track was found with this measurement";
}

/** Open alerts with what can be done; the closed ones in a line each. */
export function alertsPanel({ alerts }, changed) {
  const open = alerts.filter((one) => one.closed_at === null), closed = alerts.filter((one) => one.closed_at !== null);
  const line = (one) => el(
    "li", { class: "alert-line" }, el("span", { class: `badge ${one.severity}` }, one.severity), " ", el("a", { href: `#/alerts/${one.id}` }, words(one.kind)),
    el("span", { class: "quiet" }, ` ${stateOf(one)}${one.acknowledged_by ? `, acknowledged by ${one.acknowledged_by}` : ""}, since ${date(one.opened_at)}`),
    el("p", {}, evidenceOf(one), " ", el("b", {}, actionOf(one))),
    changed ? el("span", { class: "actions" }, buttons(one, (name, alert) => act(name, alert, changed))) : null,
  );
  return panel(
    "alerts", `Alerts: ${open.length} open`, open.length ? el("ul", { class: "lines" }, open.map(line)) : el("p", { class: "absent" }, "No alert is open."),
    closed.length ? el("details", {}, el("summary", {}, `${closed.length} closed`), el("ul", { class: "lines" }, closed.map((one) => el("li", {}, `${date(one.opened_at)} to ${date(one.closed_at)}: ${words(one.kind)}, ${one.close_reason ?? ""}`)))) : null,
  );
}

const STATES = ["estimated", "pending", "refused"];

/** Windows over time: accepted, waiting, refused; and why. */
export function qualityPanel({ quality }) {
  if (quality.over_time.length === 0) return panel("quality", "Data quality", el("p", { class: "absent" }, "No window of data has been received yet."));
  const width = 620, height = 90;
  const sums = quality.over_time.map((one) => STATES.map((state) => one.windows_by_reason.filter((row) => row.state === state).reduce((sum, row) => sum + row.windows, 0)));
  const most = Math.max(...sums.map((parts) => parts.reduce((a, b) => a + b, 0)));
  const begin = Date.parse(quality.over_time[0].measured_from), span = Date.parse(quality.over_time.at(-1).measured_to) - begin;
  const bars = quality.over_time.flatMap((one, place) => {
    const x = ((Date.parse(one.measured_from) - begin) / span) * width;
    const wide = Math.max(1.5, ((Date.parse(one.measured_to) - Date.parse(one.measured_from)) / span) * width - 1);
    let foot = height;
    const text = `${date(one.measured_from)}: ${one.windows_by_reason.map((row) => `${row.windows} ${row.state}${row.reason_code ? ` (${words(row.reason_code)})` : ""}`).join(", ")}`;
    return STATES.map((state, part) => {
      const tall = (sums[place][part] / most) * height;
      foot -= tall;
      return svg("rect", { class: `window-${state}`, x, width: wide, y: foot, height: tall }, svg("title", {}, text));
    });
  });
  const total = quality.total.reduce((sum, row) => sum + row.windows, 0);
  return panel(
    "quality", "Data quality",
    el("p", { class: "quiet" }, `${number(total)} windows from ${date(quality.over_time[0].measured_from)} to ${date(quality.over_time.at(-1).measured_to)}`),
    svg("svg", { class: "bars", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "Windows over time by state" }, bars),
    el("ul", { class: "legend" }, STATES.map((state) => el("li", { class: `key window-${state}` }, state))),
    el("table", { class: "plain" }, head("State", "Reason", "Windows"), el("tbody", {}, quality.total.map((row) => el("tr", {}, el("td", {}, row.state), el("td", {}, row.reason_code ? words(row.reason_code) : ""), el("td", { class: "right" }, number(row.windows)))))),
  );
}

/** Whether the samples follow the equations, and what the estimate was made from. */
export function fitPanel({ geometry, trend }) {
  if (geometry === null) return panel("fit", "Model fit", el("p", { class: "absent" }, "Nothing has been estimated yet."));
  const out = Object.entries(geometry.windows_left_out ?? {});
  const versions = Object.entries(geometry.provenance.track_versions);
  const passed = geometry.status === "model_mismatch" ? "not passed" : geometry.status === "estimated" ? "passed" : "not decided";
  return panel(
    "fit", "Model fit",
    el("dl", { class: "facts" },
      fact("Status", el("span", { class: `badge ${geometry.status === "estimated" ? "good" : "warning"}` }, words(geometry.status)), geometry.reason ? ` ${geometry.reason}` : ""),
      fact("Tests of fit", `${passed}: equation of yaw with the spring of the class; rolling radius against that on file`),
      fact("Windows", number(geometry.n_windows)),
      fact("Left out", out.length ? out.map(([code, count]) => `${count} ${words(code)}`).join(", ") : "none"),
      fact("Nonlinearity NP", estimate(geometry.nonlinearity_parameter_per_mm, 3, " /mm"), why(geometry.nonlinearity_parameter_per_mm)),
      fact("Conicity about", geometry.centre ? centre(geometry.centre) : "not said"),
      fact("Zero crossing", estimate(geometry.zero_crossing_mm, 2, " mm"), why(geometry.zero_crossing_mm)),
      fact("Trend", trend === null ? "none yet" : `${words(trend.status)}${trend.converged ? "" : ", the robust fit did not converge"}${trend.reason ? `: ${trend.reason}` : ""}`),
      fact("Alignments", versions.length ? versions.map(([section, of]) => el("a", { href: `#/tracks/${encodeURIComponent(section)}` }, `${section} version ${of.join(", ")} `)) : "none"),
      fact("Data", `${moment(geometry.measured_from)} to ${moment(geometry.measured_to)}`), fact("Mathematics", geometry.provenance.code_version)),
  );
}

/** The point a conicity is about, and how far from it both wheels may roll alike. */
function centre({ displacement_mm: at, rolling_line_std_mm: std, origin }) {
  return `${at === null ? "" : `${number(at, 2)} mm from `}the ${words(origin)}${std ? `; equal rolling radii within ${number(std, 2)} mm (std) of it` : ""}`;
}

const why = (found) => (found.value === null && found.reason ? el("span", { class: "second" }, found.reason) : null);

/** What happened, the newest first. */
export function eventsPanel(events) {
  const shown = events.slice(0, 40);
  return panel(
    "events", "Events",
    shown.length ? el("table", { class: "plain" }, head("When", "What", "", "Mileage"), el("tbody", {}, shown.map((one) => el("tr", {}, el("td", { title: moment(one.at) }, date(one.at)), el("td", {}, one.what), el("td", {}, one.detail), el("td", { class: "right" }, one.km === null ? "" : km(one.km))))))
      : el("p", { class: "absent" }, "Nothing is recorded."),
  );
}
