// Operation: what is silent, what failed, what waits; jobs with their last runs, quarantine, recordings.
import { get, getAll, segment, withQuery } from "./client.js";
import { el } from "./dom.js";
import { ago, lastData, moment, number, OLD_AFTER_DAYS, span, words } from "./format.js";
import { live } from "./live.js";
import { chart } from "./chart.js";

const DAY_MS = 86400000;
const SILENT_SHOWN = 50, HELD_SHOWN = 100, RECORDINGS_SHOWN = 50, RECEIPTS_READ = 500;

export async function operation({ signal, title }) {
  title("Operation");
  const panels = [
    ["Jobs", () => getAll("/v1/jobs?limit=1000", signal), jobs, "wide-panel"],
    ["Receiving", () => get(withQuery("/v1/recordings", { limit: RECEIPTS_READ }), signal), receiving, "wide-panel"],
    ["Silent vehicles", () => oldest(signal), silent],
    ["Quarantine", () => get(withQuery("/v1/quarantine", { state: "held", limit: HELD_SHOWN }), signal), quarantine],
    ["Recordings", () => get(withQuery("/v1/recordings", { limit: RECORDINGS_SHOWN }), signal), recordings, "wide-panel"],
  ];
  return el(
    "div", {}, el("div", { class: "view-head" }, el("h1", {}, "Operation")),
    el("div", { class: "grid" }, panels.map(([name, load, show, wide]) =>
      el("section", { class: `panel wide ${wide ?? ""}`, "aria-label": name }, el("h2", {}, name), live({ load, show, signal, everyS: 30 })))),
  );
}

const rows = (heads, lines) => el(
  "table", { class: "plain" }, el("thead", {}, el("tr", {}, heads.map(([name, right]) => el("th", { scope: "col", class: right ? "right" : null }, name)))),
  el("tbody", {}, lines.map((cells) => el("tr", {}, cells.map((cell, place) => el("td", { class: heads[place][1] ? "right" : null }, cell))))),
);

function jobs(found) {
  const late = (job) => job.next_due_at !== null && Date.now() - Date.parse(job.next_due_at) > 3 * 1000 * job.every_s;
  return rows(
    [["Job"], ["Every", true], ["Last run"], ["Took", true], ["Outcome"], ["What it did"]],
    found.map((job) => {
      const run = job.last_run;
      const name = el("a", { href: `#/operation/jobs/${segment(job.name)}`, title: job.description }, words(job.name));
      if (run === null) return [name, span(1000 * job.every_s), el("span", { class: "unknown" }, "never"), "", "", ""];
      const overdue = late(job) ? el("span", { class: "badge old", title: `due ${moment(job.next_due_at)}` }, "overdue") : null;
      return [name, span(1000 * job.every_s), [ago(run.started_at), overdue], took(run), outcome(run), run.error ?? counts(run)];
    }),
  );
}

const took = (run) => (run.duration_s === null ? "" : `${number(run.duration_s, run.duration_s < 10 ? 1 : 0)} s`);
const counts = (run) => Object.entries(run.counts).filter(([, count]) => count).map(([name, count]) => `${number(count)} ${words(name)}`).join(", ") || "nothing to do";
const STATES = { decoded: "good", rejected: "critical", set_aside: "warning", stored: "info" };
const TONES = { succeeded: "good", failed: "critical", running: "info" };
const outcome = (run) => el("span", { class: `badge ${TONES[run.outcome] ?? "warning"}` }, words(run.outcome));

/** What each vehicle sent last; one whose newest recordings are all rejected is received in vain, and comes first. */
function receiving(page) {
  if (page.items.length === 0) return el("p", { class: "quiet" }, "No vehicle has sent anything yet.");
  const vehicles = new Map();
  for (const item of page.items) vehicles.set(item.vehicle, [...(vehicles.get(item.vehicle) ?? []), item]);
  const lines = [...vehicles].map(([vehicle, items]) => {
    const good = items.findIndex((item) => item.state !== "rejected");
    const rejected = good === -1 ? items.length : good;
    const day = items.filter((item) => Date.parse(items[0].received_at) - Date.parse(item.received_at) < DAY_MS);
    return { vehicle, last: items[0], rejected, used: day.reduce((sum, item) => sum + item.counts.used, 0) };
  });
  lines.sort((one, other) => other.rejected - one.rejected || other.last.received_at.localeCompare(one.last.received_at));
  return [
    rows([["Vehicle"], ["Last recording"], ["State"], ["Frames used in its last day", true], ["Why"]], lines.slice(0, SILENT_SHOWN).map((one) => [
      el("a", { href: `#/?vehicle=${segment(one.vehicle)}` }, one.vehicle), ago(one.last.received_at),
      el("span", { class: `badge ${STATES[one.last.state] ?? ""}` }, one.rejected > 1 ? `the last ${one.rejected} rejected` : words(one.last.state)),
      number(one.used), one.last.reason ? el("span", { class: "clamp", title: one.last.reason }, one.last.reason) : "",
    ])),
    page.next === null && lines.length <= SILENT_SHOWN ? null : el("p", { class: "quiet" }, `Of the newest ${RECEIPTS_READ} recordings.`),
  ];
}

/** The wheelsets whose data are oldest, and those that never had any: what is unknown comes last in every order. */
async function oldest(signal) {
  const [old, never] = await Promise.all([
    get(withQuery("/v1/wheelsets", { sort: "last_data", limit: 1000 }), signal),
    get(withQuery("/v1/wheelsets", { status: "unestimated", limit: 1000 }), signal),
  ]);
  const found = new Map([...old.items, ...never.items].map((row) => [row.serial, row]));
  return { rows: [...found.values()].map(({ vehicle, axle, fleet, state }) => ({ vehicle, axle, fleet, time: state.last_data_at })), whole: old.next === null && never.next === null };
}

/** Vehicles with axles whose data are old, or that never sent any; who is silent for longest comes first. */
function silent({ rows: found, whole }) {
  const isOld = ({ time }) => time === null || Date.now() - Date.parse(time) > OLD_AFTER_DAYS * DAY_MS;
  const vehicles = new Map();
  for (const row of found.filter((one) => one.vehicle !== null && isOld(one))) vehicles.set(row.vehicle, [...(vehicles.get(row.vehicle) ?? []), row]);
  if (vehicles.size === 0) return el("p", { class: "quiet" }, `Every wheelset under a vehicle has data of the last ${OLD_AFTER_DAYS} days.`);
  const lines = [...vehicles].map(([code, axles]) => ({ code, fleet: axles[0].fleet, axles: axles.map((one) => one.axle).sort((a, b) => a - b), time: axles.map((one) => one.time ?? "").sort()[0] }));
  lines.sort((one, other) => one.time.localeCompare(other.time));
  return [
    rows([["Vehicle"], ["Fleet"], ["Axles without data"], ["Last data", true]], lines.slice(0, SILENT_SHOWN).map((one) => [
      el("a", { href: `#/?vehicle=${segment(one.code)}&sort=last_data` }, one.code), one.fleet, one.axles.join(", "), lastData(one.time || null)])),
    whole && lines.length <= SILENT_SHOWN ? null : el("p", { class: "quiet" }, `The ${Math.min(lines.length, SILENT_SHOWN)} that are silent for longest.`),
  ];
}

function quarantine(page) {
  if (page.items.length === 0) return el("p", { class: "quiet" }, "Nothing is held: nothing has failed that has not succeeded since.");
  return [
    rows(
      [["What"], ["Stage"], ["Reason"], ["Attempts", true], ["Last failed"], ["Tried again"]],
      page.items.map((item) => [
        el("span", {}, words(item.kind), el("span", { class: "second mono" }, item.key)), words(item.stage), el("span", { title: item.reason }, words(item.reason_code), el("span", { class: "second" }, item.reason)),
        item.attempts, ago(item.last_failed_at), item.next_attempt_at ? moment(item.next_attempt_at) : "",
      ]),
    ),
    page.next === null ? null : el("p", { class: "quiet" }, `The first ${HELD_SHOWN}; GET /v1/quarantine has all.`),
  ];
}

function recordings(page) {
  if (page.items.length === 0) return el("p", { class: "quiet" }, "No recording has been received yet. treadwatch ingest FILE receives one.");
  const frames = ({ counts: seen }) => (seen.frames === 0 ? "" : [`${number(seen.used)} of ${number(seen.frames)}`, seen.lost ? el("span", { class: "second" }, `${number(seen.lost)} lost`) : null]);
  return rows(
    [["Received"], ["Vehicle"], ["File"], ["Measured"], ["State"], ["Frames used", true], ["Reason"]],
    page.items.map((item) => [
      ago(item.received_at), item.vehicle, el("span", { title: item.digest }, item.file_name ?? item.digest.slice(0, 12)),
      item.measured_from ? moment(item.measured_from) : "", el("span", { class: `badge ${STATES[item.state] ?? ""}` }, words(item.state)), frames(item),
      item.reason ? el("span", { class: "clamp", title: item.reason }, item.reason) : "",
    ]),
  );
}

/** The runs of one job, and how long they took. */
export async function jobView({ params, signal, title }) {
  title(words(params.name));
  const path = `/v1/jobs/${segment(params.name)}`;
  const load = async () => ({ job: await get(path, signal), runs: (await get(`${path}/runs?limit=100`, signal)).items });
  const show = ({ job, runs }) => {
    const done = runs.filter((run) => run.duration_s !== null).reverse();
    return [
      el("div", { class: "view-head" }, el("h1", {}, words(job.name)), el("p", { class: "quiet" }, `${job.description}; every ${span(1000 * job.every_s)}`)),
      done.length > 1 ? el("section", { class: "panel" }, chart({
        label: "Seconds a run", height: 160, x: { time: true }, y: { label: "s" },
        series: [{ label: "seconds", x: done.map((run) => Date.parse(run.started_at) / 1000), y: done.map((run) => run.duration_s), kind: "points", digits: 1 }],
      })) : null,
      el("section", { class: "panel wide" }, rows(
        [["Started"], ["By"], ["Took", true], ["Outcome"], ["What it did"]],
        runs.map((run) => [moment(run.started_at), words(run.trigger), took(run), outcome(run), run.error ?? counts(run)]),
      )),
    ];
  };
  return el("div", { data: { back: "#/operation" } }, live({ load, show, signal, everyS: 30 }));
}
