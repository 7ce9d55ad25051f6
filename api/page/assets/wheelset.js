// One wheelset: what is known of it, how sure that is, why, and what was measured.
import { segment } from "./client.js";
import { el } from "./dom.js";
import { SLOPE_DIGITS, urgencyBadge } from "./fleet_columns.js";
import { estimate, km, lastData, number } from "./format.js";
import { live } from "./live.js";
import { conicityChart, occupancy, radiusChart } from "./wheelset_curves.js";
import { eventsOf, loadWheelset } from "./wheelset_data.js";
import { opinionsPanel } from "./wheelset_opinions.js";
import { alertsPanel, eventsPanel, fact, fitPanel, measurementsPanel, panel, qualityPanel } from "./wheelset_panels.js";
import { noEstimate } from "./wheelset_reasons.js";
import { forecast, trendChart } from "./wheelset_trend.js";

export async function wheelset({ params, signal, title }) {
  title(`Wheelset ${params.serial}`);
  const load = () => loadWheelset(params.serial, signal);
  const shown = live({ load, show: (found) => whole(found, () => shown.reload()), signal, everyS: 60, what: "Loading the wheelset" });
  return el("div", { data: { back: "#/" } }, shown);
}

function whole(found, changed) {
  const { wheelset: one, geometry, trend, without } = found;
  const drawn = trend?.points.value_1.length || found.intervals.length;
  return el(
    "div", { class: "wheelset" }, heading(one),
    el("div", { class: "grid" },
      panel("summary", "Now", summary(found)), alertsPanel(found, changed)),
    without ? noEstimate(without, geometry) : null,
    el("div", { class: "grid" },
      panel("conicity", "Conicity", conicityChart(found)), panel("difference", "Rolling radius difference", radiusChart(found, "rolling_radius_difference_mm")),
      panel("trend-mileage", "Trend by mileage", drawn ? trendChart(found, "mileage") : noTrend()),
      panel("trend-date", "Trend by date", drawn ? trendChart(found, "date") : noTrend())),
    opinionsPanel(found), measurementsPanel(found),
    el("div", { class: "grid" },
      panel("sum", "Rolling radius sum", radiusChart(found, "rolling_radius_sum_mm")),
      geometry === null ? null : panel("occupancy", "Bin occupancy", occupancy(found)),
      qualityPanel(found), fitPanel(found), eventsPanel(eventsOf(found))),
  );
}

function heading(one) {
  const at = one.mounting;
  return el(
    "div", { class: "view-head" }, el("h1", {}, one.serial),
    el("span", { class: "quiet" }, at ? [el("a", { href: `#/?vehicle=${segment(at.vehicle)}` }, at.vehicle), `, axle ${at.axle}`] : "on no vehicle", `, ${one.wheel_profile}, r0 ${one.nominal_radius_mm} mm, fleet ${one.fleet}`),
    el("span", { class: "actions" }, el("a", { href: `#/wheelsets/${segment(one.serial)}/sheet` }, "Sheet to print")),
  );
}

export function summary(found) {
  const { geometry, now } = found;
  const conicity = now?.conicity_1;
  return el(
    "dl", { class: "facts" },
    now ? fact("Urgency", urgencyBadge(now.urgency), el("span", { class: "second" }, now.reasons.map((one) => one.text).join("; "))) : null,
    fact("Conicity at 3 mm", estimate(conicity), conicity?.reason ? el("span", { class: "second" }, conicity.reason) : null),
    fact("Limit", now?.limit_1 == null ? "none known yet" : number(now.limit_1, 3)),
    fact("Slope per 1,000 km", estimate(now?.slope_1_per_1000_km, SLOPE_DIGITS)), fact("Limit reached", forecast(now)),
    fact("Mileage", km(now?.mileage_km)), fact("Last data", lastData(now ? now.last_data_at : geometry?.measured_to)),
    fact("Reprofilings", String(found.wheelset.reprofilings.length)),
  );
}

const noTrend = () => el("p", { class: "absent" }, "There is no trend yet: no mileage interval has been estimated.");
