// The turning plan: which wheelsets of a vehicle to turn in one visit to the lathe, by when, each with its reason.
import { get, getAll, segment, withQuery } from "./client.js";
import { el } from "./dom.js";
import { filters } from "./filters.js";
import { distance, urgencyBadge } from "./fleet_columns.js";
import { date, moment, number } from "./format.js";
import { live } from "./live.js";
import { keepQuery } from "./router.js";
import { empty } from "./states.js";
import { table } from "./table.js";
import { saveButton } from "./table_file.js";

const DAYS = { horizon_days: 90, together_days: 30 };
const LIMITS = ["cut_mm", "minimum_radius_mm", "axle_difference_mm", "bogie_difference_mm", "vehicle_difference_mm"];
const PARAMETERS = ["fleet", "vehicle", ...Object.keys(DAYS), "nominal_radii", ...LIMITS];
const CAUSES = { due: ["turn", "warning"], together: ["turn too", "info"], replace: ["replace", "critical"], not_assessed: ["not assessed", ""] };
const second = (...content) => el("span", { class: "second" }, ...content);

export async function plan({ query, signal, title }) {
  title("Turning plan");
  let wanted = query;
  const fleets = await getAll("/v1/fleets?limit=1000", signal);
  const path = () => withQuery("/v1/plans/reprofiling", Object.fromEntries(PARAMETERS.map((name) => [name, wanted[name]])));
  const summary = el("p", { class: "quiet" });
  const unchecked = el("p", { class: "quiet", data: { note: "unchecked" } });
  const list = table({
    columns, label: "Wheelsets to turn, the earliest visit first", rowHeight: 46, keyOf: (line) => line.wheelset,
    onOpen: (line) => (location.hash = `#/wheelsets/${segment(line.wheelset)}`), rowClass: (line) => (line.first ? "first-of-visit" : null),
    nothing: () => empty("No wheelset has to be turned within this horizon.", "None is over its limit, and none may reach it in that time. Plan further ahead to see what comes next."),
  });

  function show(found) {
    const lines = found.items.map((line, place) => ({ ...line, first: place === 0 || !sameVisit(line, found.items[place - 1]) }));
    summary.textContent = `${counted(lines)}; ${asked(found)}; as of ${moment(found.made_at)}`;
    unchecked.textContent = notChecked(found);
    return list.setRows(lines);
  }

  const shown = live({ load: () => get(path(), signal), show, signal, everyS: 300, what: "Making the plan" });
  const chosen = (values) => {
    wanted = values;
    keepQuery(wanted);
    shown.reload({ other: true });
  };
  return el(
    "div", { class: "plan" }, el("div", { class: "view-head" }, el("h1", {}, "Turning plan"), summary),
    filters(fieldsOf(fleets), wanted, chosen, saveButton(el, path, "turning-plan.csv"), el("button", { type: "button", on: { click: () => print() } }, "Print")),
    unchecked, shown,
  );
}

const millimetres = (name, label, title) => ({ name, label, title, number: { min: 0, max: 1000, step: "any" }, unit: "mm" });

const fieldsOf = (fleets) => [
  { name: "fleet", label: "Fleet", options: fleets.map((fleet) => [fleet.code, fleet.code]) },
  { name: "vehicle", label: "Vehicle" },
  { name: "horizon_days", label: "Due within", number: { min: 0, max: 3650, step: 1, placeholder: DAYS.horizon_days }, unit: "days", title: "How far ahead is planned, by the earliest date that the limit may be reached (p10)" },
  { name: "together_days", label: "Turn together within", number: { min: 0, max: 3650, step: 1, placeholder: DAYS.together_days }, unit: "days", title: "What becomes due so soon after a visit of its vehicle is turned in that visit" },
  { name: "nominal_radii", label: "Radii", options: [["true", "as on file"]], any: "not compared", title: "The registry has one radius a wheelset; as on file takes it for that of both wheels" },
  millimetres("cut_mm", "Cut", "Radius that a turning takes off at least"),
  millimetres("minimum_radius_mm", "Least radius", "Below it the wheelset is replaced"),
  millimetres("axle_difference_mm", "Difference in an axle", "Greatest difference of diameters"),
  millimetres("bogie_difference_mm", "in a bogie", "Greatest difference of diameters"),
  millimetres("vehicle_difference_mm", "in a vehicle", "Greatest difference of diameters"),
];

const sameVisit = (one, other) => one.vehicle === other.vehicle && one.visit === other.visit;
const plural = (count, what) => `${number(count)} ${what}${count === 1 ? "" : "s"}`;

function counted(lines) {
  const planned = lines.filter((line) => line.visit !== null);
  const visits = planned.filter((line) => line.first).length;
  const not = lines.length - planned.length;
  return `${plural(planned.length, "wheelset")} in ${plural(visits, "visit")} to the lathe${not ? `, ${number(not)} not assessed` : ""}`;
}

/** What the plan was made with, which paper has to say as well. */
function asked(found) {
  const limits = Object.entries(found.limits).filter(([, value]) => value !== null).map(([name, value]) => `${name.replace(/_mm$/, "").replaceAll("_", " ")} ${value} mm`);
  return [`due within ${plural(found.horizon_days, "day")}`, ...limits].join(", ");
}

/** What the plan could not be held against, and how often; the limits are the operator's and have no default. */
function notChecked(found) {
  const counts = new Map();
  for (const line of found.items) for (const text of line.not_checked) counts.set(text, (counts.get(text) ?? 0) + 1);
  if (counts.size === 0) return "";
  return `Not checked: ${[...counts].map(([text, count]) => (count === found.items.length ? text : `${text} (${plural(count, "wheelset")})`)).join("; ")}.`;
}

const columns = [
  { name: "turnby", label: "Turn by", title: "When the first wheelset of the visit may reach its limit (p10)", cell: turnBy },
  { name: "visit", label: "Vehicle", cell: (line) => (line.first ? [el("a", { href: `#/?vehicle=${segment(line.vehicle)}`, tabindex: -1 }, line.vehicle), line.visit ? second(`visit ${line.visit}`) : null] : null) },
  { name: "axle", label: "Axle", cell: (line) => [`axle ${line.axle}`, line.bogie === null ? null : second(`bogie ${line.bogie}`)] },
  { name: "serial", label: "Wheelset", cell: (line) => [el("a", { href: `#/wheelsets/${segment(line.wheelset)}`, tabindex: -1 }, line.wheelset), second(urgencyBadge(line.urgency, "tone"))] },
  { name: "cause", label: "What", cell: cause },
  { name: "why", label: "Why", cell: (line) => el("span", { class: "clamp", title: line.reason }, line.reason) },
  { name: "distance", label: "To the limit, km", class: "right", title: "Still to run: median, and p10 to p90", cell: (line) => distance(line.distance_to_limit_km) },
  { name: "radius", label: "Radius, mm", class: "right", title: "After the visit, and before it", cell: radius },
];

function turnBy(line) {
  if (!line.first) return null;
  if (line.turn_by === null) return el("span", { class: "unknown" }, "no date");
  const days = (Date.parse(line.turn_by) - Date.now()) / 86400000;
  return [el("b", {}, days <= 0 ? "now" : date(line.turn_by)), days <= 0 ? null : second(`in ${plural(Math.floor(days), "day")}`)];
}

function cause(line) {
  const [text, tone] = CAUSES[line.cause] ?? [line.cause, ""];
  return el("span", { class: `badge ${tone}` }, text);
}

function radius(line) {
  if (line.radius_mm === null) return el("span", { class: "quiet" }, "not compared");
  return [line.radius_after_mm === null ? el("span", { class: "unknown" }, "not known") : number(line.radius_after_mm, 1), second(`from ${number(line.radius_mm, 1)}`)];
}
