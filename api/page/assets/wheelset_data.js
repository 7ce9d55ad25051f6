// What the API knows of one wheelset, read together: its own view and its printed sheet show the same.
import { getAll, getIfAny, get, segment } from "./client.js";

const COMPARED = 4; // measurements that are shown beside estimates, the newest

/** Everything of a wheelset; what there is none of yet is null or empty. */
export async function loadWheelset(serial, signal) {
  const own = `/v1/wheelsets/${segment(serial)}`;
  const wheelset = (await getIfAny(`${own}/state`, signal)) ?? (await get(own, signal)); // a voided one has no state
  const list = (path) => getAll(`${path}${path.includes("?") ? "&" : "?"}limit=1000`, signal);
  const [recorded, recordedTrend, design, intervals, measurements, mountings, alerts, quality, signature, rails] = await Promise.all([
    get(`${own}/geometry`, signal), get(`${own}/trend`, signal), getIfAny(`${own}/contact`, signal),
    list(`${own}/intervals`), list(`${own}/measured-profiles`), list(`${own}/mountings`),
    list(`/v1/alerts?wheelset=${segment(serial)}`), get(`${own}/data-quality`, signal),
    getIfAny(`${own}/signature`, signal), getIfAny(`${own}/rails`, signal),
  ]);
  const comparisons = (await Promise.all(measurements.slice(-COMPARED).map((one) => getIfAny(one.links.comparison, signal)))).filter(Boolean);
  comparisons.reverse();
  alerts.sort((a, b) => b.opened_at.localeCompare(a.opened_at));
  const [geometry, trend] = [recorded, recordedTrend].map((one) => (one.recorded_at === null ? null : one)); // ever estimated
  const without = recorded.unestimated_because && { ...recorded.unestimated_because, reason: recorded.reason };
  return { wheelset, now: wheelset.state ?? null, geometry, without, trend, design, intervals, measurements, comparisons, mountings, alerts, quality, signature, rails };
}

/** What happened to a wheelset, the newest first: `{at, what, detail, km}`. */
export function eventsOf({ wheelset, mountings, measurements, alerts }) {
  const events = [
    ...mountings.map((one) => ({ at: one.mounted_from, what: "mounted", detail: `${one.vehicle}, axle ${one.axle}${one.reversed ? ", the other way round" : ""}`, km: one.wheelset_mileage_km })),
    ...mountings.filter((one) => one.mounted_to).map((one) => ({ at: one.mounted_to, what: "taken off", detail: `${one.vehicle}, axle ${one.axle}`, km: null })),
    ...wheelset.reprofilings.map((one) => ({ at: one.reprofiled_at, what: "reprofiled", detail: one.note, km: one.mileage_km })),
    ...measurements.map((one) => ({ at: one.measured_at, what: "profiles measured", detail: `${one.left}, ${one.right}`, km: one.mileage_km })),
    ...alerts.map((one) => ({ at: one.opened_at, what: "alert", detail: `${one.kind.replaceAll("_", " ")} (${one.severity})`, km: null })),
  ];
  return events.sort((a, b) => b.at.localeCompare(a.at));
}
