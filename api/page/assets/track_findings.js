// What the fleet has found of the rails of a section: friction along it, and what its rails add to the conicity.
import { chart } from "./chart.js";
import { el } from "./dom.js";
import { estimate, moment, number } from "./format.js";

const AMPLITUDE_MM = 3;

/** Friction along the section over the newest hours. */
export function frictionPanel(adhesion) {
  if (adhesion === null) return el("section", { class: "panel" }, el("h2", {}, "Friction"), el("p", { class: "quiet" }, "No pass has shown the friction of this section yet."));
  const middle = adhesion.places.map((one) => 0.5 * (one.from_m + one.to_m));
  const bound = (end) => adhesion.places.map((one) => one.friction_1.interval_95?.[end] ?? null);
  const series = [
    { label: "friction", x: middle, y: adhesion.places.map((one) => one.friction_1.value), low: bound(0), high: bound(1), role: "estimate", digits: 2, kind: "points" },
    { label: "at least", x: middle, y: adhesion.places.map((one) => (one.friction_1.value === null ? one.at_least_1 : null)), role: "design", digits: 2, kind: "points" },
  ];
  const low = adhesion.low_stretches.map((one) => `${number(one.from_m)} to ${number(one.to_m)} m`).join("; ");
  return el(
    "section", { class: "panel" }, el("h2", {}, "Friction"),
    el("p", {}, low ? [el("span", { class: "badge warning" }, "low adhesion"), ` at ${low}`] : "No stretch of low adhesion."),
    chart({ label: "Coefficient of friction along the section; 95 % interval", height: 180, sync: "track", x: { label: "position, m", unit: "m" }, y: { label: "friction" }, series, shades: adhesion.low_stretches.map((one) => ({ from: one.from_m, to: one.to_m })) }),
    adhesion.left_out.map((one) => el("p", {}, el("span", { class: "badge warning" }, "left out"), ` ${one.reason}`)),
    el("p", { class: "quiet" }, `${adhesion.windows} windows from ${moment(adhesion.measured_from)} to ${moment(adhesion.measured_to)}.`),
  );
}

/** What the rails of the section add to the conicity of the fleet's wheels, in its newest period. */
export function railsPanel(rails) {
  const title = el("h2", {}, "Rails");
  const newest = rails?.periods.at(-1);
  if (!newest) return el("section", { class: "panel" }, title, el("p", { class: "quiet" }, "Wheels and rails have not been parted here yet."));
  const at = newest.by_amplitude.find((one) => one.amplitude_mm === (rails.limit_amplitude_mm ?? AMPLITUDE_MM));
  const fact = (name, found) => (found ? [el("dt", {}, name), el("dd", {}, estimate(found), found.reason ? el("span", { class: "second" }, found.reason) : null)] : null);
  return el(
    "section", { class: "panel" }, title,
    rails.limit_exceeded ? el("p", {}, el("span", { class: "badge warning" }, "limit exceeded"), ` The rails ${at?.excess_1.value < 0 ? "take" : "add"} more than ${number(rails.limit_1, 2)} ${at?.excess_1.value < 0 ? "from" : "to"} the conicity of ${rails.reference_wheel_profile}.`) : null,
    el("dl", { class: "facts" },
      fact("The rails add", at?.rail_part_1), fact(`Conicity of ${rails.reference_wheel_profile ?? "the wheel as designed"}`, at?.reference_wheel_conicity_1), fact("Beyond that on file", at?.excess_1)),
    el("p", { class: "quiet" }, `At ${number(at?.amplitude_mm ?? AMPLITUDE_MM, 1)} mm; ${newest.n_wheelsets} wheelsets, ${newest.n_windows} windows.`),
    rails.trend_reason ? el("p", { class: "quiet" }, `No trend: ${rails.trend_reason}.`) : null,
  );
}
