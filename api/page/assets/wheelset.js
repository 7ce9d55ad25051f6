// One wheelset: what is known of it, how sure that is, why, and what was measured.
import { segment } from "./client.js";
import { el } from "./dom.js";
import { estimate, km, lastData } from "./format.js";
import { live } from "./live.js";
import { conicityChart, occupancy, radiusChart } from "./wheelset_curves.js";
import { eventsOf, loadWheelset, newestMileage } from "./wheelset_data.js";
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
  const { geometry, trend } = found;
  const mileage = newestMileage(found);
  const conicity = geometry?.equivalent_conicity_at_3_mm_1;
  return el(
    "dl", { class: "facts" },
    fact("Conicity at 3 mm", estimate(conicity), conicity?.reason ? el("span", { class: "second" }, conicity.reason) : null),
    fact("Limit", trend?.limit_1 == null ? "none on file" : String(trend.limit_1)),
    fact("Slope per 1,000 km", estimate(trend?.slope_1_per_1000_km, 4)), fact("Limit reached", forecast(trend)),
    fact("Mileage", mileage === null ? "unknown" : km(mileage)), fact("Last data", lastData(geometry?.measured_to ?? found.without?.last_data_at)),
    fact("Reprofilings", String(found.wheelset.reprofilings.length)),
  );
}

const noTrend = () => el("p", { class: "absent" }, "There is no trend yet: no mileage interval has been estimated.");
