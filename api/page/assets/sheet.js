// A wheelset's life on one sheet of A4, to be printed or kept as PDF.
import { segment } from "./client.js";
import { el } from "./dom.js";
import { date, estimate, km, moment, number, words } from "./format.js";
import { live } from "./live.js";
import { conicityChart } from "./wheelset_curves.js";
import { loadWheelset } from "./wheelset_data.js";
import { fact } from "./wheelset_panels.js";
import { forecast, trendChart } from "./wheelset_trend.js";

const ROWS = 7; // of each table: one sheet

export async function sheet({ params, signal, title }) {
  title(`Wheelset ${params.serial}: sheet`);
  const load = () => loadWheelset(params.serial, signal);
  return el("div", { data: { back: `#/wheelsets/${segment(params.serial)}` } }, live({ load, show: page, signal, everyS: 300, what: "Loading the wheelset" }));
}

function page(found) {
  const { wheelset: one, now, geometry, trend, comparisons, mountings, alerts, quality } = found;
  const total = quality.total.reduce((sum, row) => sum + row.windows, 0);
  const used = quality.total.filter((row) => row.state === "estimated").reduce((sum, row) => sum + row.windows, 0);
  return el(
    "article", { class: "sheet" },
    el("div", { class: "view-head" }, el("h1", {}, `Wheelset ${one.serial}`), el("span", { class: "quiet" }, `as of ${moment(new Date().toISOString())}`),
      el("span", { class: "actions" }, el("a", { href: `#/wheelsets/${segment(one.serial)}` }, "Back"), el("button", { type: "button", class: "main", on: { click: () => print() } }, "Print"))),
    el("div", { class: "columns" },
      el("dl", { class: "facts" },
        fact("Fleet", one.fleet), fact("Runs on", one.mounting ? `${one.mounting.vehicle}, axle ${one.mounting.axle}` : "no vehicle"), fact("Wheel profile", one.wheel_profile),
        fact("Nominal radius", `${number(one.nominal_radius_mm, 1)} mm`), fact("Mileage", km(now?.mileage_km))),
      el("dl", { class: "facts" },
        fact("Conicity at 3 mm", estimate(now?.conicity_1)), fact("Limit", now?.limit_1 == null ? "none known yet" : number(now.limit_1, 3)),
        fact("Limit reached", forecast(now)), fact("Data", geometry ? `${date(geometry.measured_from)} to ${date(geometry.measured_to)}` : "none estimated"),
        fact("Windows", `${number(used)} of ${number(total)} used${refusals(quality)}`))),
    el("section", {}, el("h2", {}, "Conicity over its life"), trend || found.intervals.length ? trendChart(found, "mileage", 190) : el("p", { class: "absent" }, "Nothing has been estimated yet.")),
    el("div", { class: "columns" },
      el("section", {}, el("h2", {}, "Conicity by amplitude, now"), conicityChart(found, 170)),
      el("section", {}, el("h2", {}, "Measured profiles"), measured(comparisons))),
    el("div", { class: "columns" },
      el("section", {}, el("h2", {}, "Mountings"), rows(["From", "To", "Vehicle, axle", "Mileage then"], mountings.toReversed(), (item) => [date(item.mounted_from), item.mounted_to ? date(item.mounted_to) : "now", `${item.vehicle}, ${item.axle}${item.reversed ? ", reversed" : ""}`, km(item.wheelset_mileage_km)], "It has been on no vehicle.")),
      el("section", {}, el("h2", {}, "Reprofilings"), rows(["Date", "Mileage", "Note"], one.reprofilings.toReversed(), (item) => [date(item.reprofiled_at), km(item.mileage_km), item.note], "It has not been reprofiled."))),
    el("section", {}, el("h2", {}, "Alerts"), rows(["Raised", "Kind", "Severity", "Acknowledged", "Closed"], alerts, (item) => [date(item.opened_at), words(item.kind), item.severity, item.acknowledged_by ? `${item.acknowledged_by}, ${date(item.acknowledged_at)}` : "\u2013", item.closed_at ? `${date(item.closed_at)}: ${item.close_reason ?? ""}` : "open"], "There have been none.")),
  );
}

function refusals(quality) {
  const refused = quality.total.filter((row) => row.state === "refused").slice(0, 2);
  return refused.length ? `; refused: ${refused.map((row) => `${number(row.windows)} ${words(row.reason_code)}`).join(", ")}` : "";
}

function measured(comparisons) {
  return rows(
    ["Date", "Sd L / R, mm", "Sh L / R, mm", "Conicity at 3 mm", "Estimate covers"], comparisons,
    (one) => {
      const pair = one.conicity_by_amplitude.find((item) => item.amplitude_mm === 3), { left, right } = one.wheels;
      const both = (name) => `${side(left[name])} / ${side(right[name])}`;
      const covers = pair.covered === null ? "not compared" : pair.covered ? "yes" : "no";
      return [date(one.measured_at), both("flange_thickness_mm"), both("flange_height_mm"), pair.measured_1.value === null ? "unknown" : number(pair.measured_1.value, 3), `${covers}${one.independent === false ? " (not independent)" : ""}`];
    }, "None have been measured.");
}

const side = (value) => (value === null ? "?" : number(value, 1));

function rows(names, items, cells, nothing) {
  if (items.length === 0) return el("p", { class: "absent" }, nothing);
  return [
    el("table", { class: "plain" }, el("thead", {}, el("tr", {}, names.map((name) => el("th", { scope: "col" }, name)))), el("tbody", {}, items.slice(0, ROWS).map((item) => el("tr", {}, cells(item).map((cell) => el("td", {}, cell)))))),
    items.length > ROWS ? el("p", { class: "absent" }, `and ${items.length - ROWS} earlier`) : null,
  ];
}
