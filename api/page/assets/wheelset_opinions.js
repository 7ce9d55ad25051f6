// What is said of a wheelset beside its geometry: by its wear signature, and by parting wheel and rail.
import { segment } from "./client.js";
import { el } from "./dom.js";
import { date, estimate, number } from "./format.js";
import { panel } from "./wheelset_panels.js";

const AMPLITUDE_MM = 3;
const WEAR_SHOWN = 0.01; // probability from which a state is named
const second = (...content) => el("span", { class: "second" }, ...content);
const link = (serial) => el("a", { href: `#/wheelsets/${segment(serial)}` }, serial);

/** Conicities at 3 mm of all methods, one beside the other; they are never mixed. */
export function opinionsPanel({ geometry, signature, rails }) {
  if (signature === null && rails === null) return panel("opinions", "Second opinions", el("p", { class: "absent" }, "No other method has looked at this wheelset yet."));
  const rows = [
    ["Geometry", geometry?.equivalent_conicity_at_3_mm_1, geometry ? `to ${date(geometry.measured_to)}` : null],
    ["Wear signature", signature?.equivalent_conicity_at_3_mm_1, signature ? taught(signature) : null],
    ["Without its rails", atThree(rails), rails ? `on ${rails.sections.join(", ")}` : null],
  ];
  return panel(
    "opinions", "Second opinions",
    el("table", { class: "plain" },
      el("thead", {}, el("tr", {}, ["Method", "Conicity at 3 mm", "From"].map((name) => el("th", { scope: "col" }, name)))),
      el("tbody", {}, rows.map(([name, found, from]) => el("tr", {}, el("td", {}, name), el("td", {}, estimate(found), found?.reason ? second(found.reason) : null), el("td", {}, from ?? "nothing yet"))))),
    disagreement(signature), state(signature),
  );
}

const atThree = (rails) => rails?.by_amplitude.find((one) => one.amplitude_mm === AMPLITUDE_MM)?.conicities.find((one) => one.method === "wheel_and_rail_apart")?.equivalent_conicity_1;

function taught(signature) {
  if (signature.used_entries.length === 0) return `${signature.library_wheelsets} wheelsets of known conicity`;
  const named = [...new Set(signature.used_entries.map((one) => one.wheelset))].slice(0, 3);
  return [`${signature.library_wheelsets} wheelsets of known conicity, above all `, named.flatMap((serial, place) => (place ? [", ", link(serial)] : [link(serial)]))];
}

function disagreement(signature) {
  const compared = signature?.compared;
  if (!compared?.disagree) return null;
  return el("p", {}, el("span", { class: "badge warning" }, "methods disagree"), ` by ${number(compared.difference_1, 3)}: measure the profiles.`);
}

function state(signature) {
  const likely = (signature?.states ?? []).filter((one) => one.probability >= WEAR_SHOWN);
  if (likely.length === 0) return null;
  const range = (one) => (one.to_1 === null ? `above ${number(one.from_1, 2)}` : `${number(one.from_1, 2)} to ${number(one.to_1, 2)}`);
  return el("p", { class: "absent" }, `By its signature its conicity is ${likely.map((one) => `${range(one)} with ${number(100 * one.probability)} %`).join(", ")}.`);
}
