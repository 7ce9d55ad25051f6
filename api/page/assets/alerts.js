// The inbox of alerts: open, acknowledged, shelved, closed; what led to each, and what can be done about it.
import { get, getAll, segment, withQuery } from "./client.js";
import { announce, el, replace } from "./dom.js";
import { act } from "./alert_actions.js";
import { actionOf, evidenceOf, KINDS, stateOf } from "./alert_words.js";
import { filters } from "./filters.js";
import { follow } from "./follow.js";
import { ago, moment, words } from "./format.js";
import { live } from "./live.js";
import { keepQuery } from "./router.js";
import { empty } from "./states.js";
import { table } from "./table.js";
import { saveButton } from "./table_file.js";

const TABS = {
  open: { label: "Open", fits: (alert) => ["active", "unknown"].includes(alert.display_state) },
  acknowledged: { label: "Acknowledged", fits: (alert) => alert.display_state === "acknowledged" },
  shelved: { label: "Shelved", fits: (alert) => alert.display_state === "shelved" },
  cleared: { label: "Cleared", fits: (alert) => alert.display_state === "cleared" },
  closed: { label: "Closed", fits: (alert) => alert.closed_at !== null },
};
const CLOSED_AT_ONCE = 250;
const SEVERITIES = ["critical", "warning", "info"];
const second = (...content) => el("span", { class: "second" }, ...content);

const worstFirst = (one, other) =>
  SEVERITIES.indexOf(one.severity) - SEVERITIES.indexOf(other.severity) || other.opened_at.localeCompare(one.opened_at);

const newestFirst = (one, other) => other.closed_at.localeCompare(one.closed_at);

export async function alerts({ query, signal, title }) {
  title("Alerts");
  let { tab = "open", ...wanted } = query, all = [], further = null;
  if (!(tab in TABS)) tab = "open";
  const acted = new Set(); // stay where they are until another tab is chosen, so that it is seen what became of them
  const fleets = await getAll("/v1/fleets?limit=1000", signal);
  const choice = () => ({ fleet: wanted.fleet, kind: wanted.kind });
  const path = () => withQuery("/v1/alerts", tab === "closed" ? { ...choice(), sort: "-id", limit: 1000 } : { ...choice(), open: true, limit: 1000 });
  const tabs = el("div", { class: "tabs", role: "group", "aria-label": "Which alerts" });
  const list = table({
    columns: columns((name, alert) => act(name, alert, changedOne)), label: "Alerts, the worst first", rowHeight: 58,
    keyOf: (alert) => alert.id, onOpen: (alert) => (location.hash = `#/alerts/${alert.id}`),
    nothing: () => (tab === "closed" ? empty("No alert has been closed.") : empty(tab === "open" ? "No open alert." : `No alert is ${tab}.`, "New ones appear here by themselves.")),
  });

  /** All that are open; of the closed ones, which are many, as many pages as were read, from the newest on. */
  async function load() {
    const [open, past] = await Promise.all([
      getAll(withQuery("/v1/alerts", { ...choice(), open: true, limit: 1000 }), signal),
      tab === "closed" ? closed(withQuery("/v1/alerts", { ...choice(), sort: "-id", limit: CLOSED_AT_ONCE })) : { items: [], next: null },
    ]);
    return { items: [...open, ...past.items], next: past.next };
  }

  /** Closed alerts from a page on: at least one, if there is any. */
  async function closed(from) {
    const items = [];
    let next = from;
    while (next !== null && items.length === 0) {
      const page = await get(next, signal);
      items.push(...page.items.filter(TABS.closed.fits));
      next = page.next;
    }
    return { items, next };
  }

  function show({ items, next }) {
    all = items;
    further = next;
    return drawn();
  }

  async function more() {
    try {
      const past = await closed(further);
      if (tab === "closed") show({ items: [...all, ...past.items], next: past.next });
    } catch (error) {
      if (!signal.aborted) announce(error.message);
    }
  }

  function drawn() {
    replace(tabs, Object.entries(TABS).map(([name, { label, fits }]) => el(
      "button", { type: "button", "aria-pressed": String(name === tab), data: { tab: name }, on: { click: () => choose(name) } },
      `${label} `, name === "closed" ? null : el("span", { class: "count" }, String(all.filter(fits).length)),
    )));
    const rows = all.filter((alert) => TABS[tab].fits(alert) || acted.has(alert.id));
    return list.setRows(rows.sort(tab === "closed" ? newestFirst : worstFirst), { more: further === null ? null : more });
  }

  function choose(name) {
    tab = name;
    acted.clear();
    keepQuery({ ...wanted, tab: tab === "open" ? "" : tab });
    if (tab === "closed") shown.reload({ other: true });
    else further = null;
    drawn();
    tabs.querySelector(`[data-tab="${name}"]`).focus();
  }

  function changedOne(alert) {
    acted.add(alert.id);
    all = all.map((one) => (one.id === alert.id ? alert : one));
    drawn();
  }

  const fields = [
    { name: "fleet", label: "Fleet", options: fleets.map((fleet) => [fleet.code, fleet.code]) },
    { name: "kind", label: "Kind", options: KINDS },
  ];
  const shown = live({ load, show, signal, everyS: 60, what: "Loading alerts" });
  follow(signal, (events) => {
    announce(events.length === 1 ? `Alert ${events[0].alert.id}: ${words(events[0].event)}` : `${events.length} events`);
    shown.reload();
  });
  const chosen = (values) => {
    wanted = values;
    acted.clear();
    keepQuery({ ...wanted, tab: tab === "open" ? "" : tab });
    shown.reload({ other: true });
  };
  return el(
    "div", {}, el("div", { class: "view-head" }, el("h1", {}, "Alerts"), tabs),
    filters(fields, wanted, chosen, saveButton(el, path, "alerts.csv")), shown,
  );
}

const columns = (perform) => [
  { name: "severity", label: "Severity", cell: (alert) => el("span", { class: `badge ${alert.severity}` }, alert.severity) },
  { name: "alert", label: "Alert", cell: (alert) => [el("a", { href: `#/alerts/${alert.id}`, tabindex: -1 }, words(alert.kind)), second(`no. ${alert.id}, ${alert.fleet}`)] },
  { name: "where", label: "Wheelset", cell: (alert) => where(alert) },
  { name: "evidence", label: "Evidence and what to do", cell: (alert) => el("span", { title: evidenceOf(alert) }, el("span", { class: "clamp" }, evidenceOf(alert)), second(actionOf(alert))) },
  { name: "since", label: "Raised", class: "right", cell: (alert) => [ago(alert.opened_at), second("seen ", ago(alert.last_seen_at))] },
  { name: "state", label: "State", cell: state },
  { name: "act", label: "Action", cell: (alert) => el("span", { class: "actions" }, buttons(alert, perform)) },
];

function where(alert) {
  if (alert.track_section) return [el("span", {}, `section ${alert.track_section}`), second("fleet ", alert.fleet)];
  if (alert.wheelset === null) return el("span", { class: "quiet" }, "whole fleet");
  return [
    el("a", { href: `#/wheelsets/${segment(alert.wheelset)}`, tabindex: -1 }, alert.wheelset),
    alert.vehicle ? second(`${alert.vehicle}, axle ${alert.axle}`) : null,
  ];
}

function state(alert) {
  if (alert.display_state === "acknowledged") return ["acknowledged", second(`by ${alert.acknowledged_by}, `, ago(alert.acknowledged_at))];
  if (alert.display_state === "shelved") return [`until ${moment(alert.shelved_until)}`, second(alert.shelved_reason)];
  if (alert.closed_at !== null) return [el("span", {}, "closed ", ago(alert.closed_at)), el("span", { class: "second", title: alert.close_reason }, alert.close_reason)];
  return stateOf(alert);
}

/** The actions that the state of an alert allows. */
export function buttons(alert, perform) {
  const button = (name, text) => el("button", { type: "button", data: { act: name }, on: { click: () => perform(name, alert) } }, text);
  if (alert.closed_at !== null || alert.display_state === "cleared" || alert.display_state === "pending") return [];
  if (alert.display_state === "shelved") return [button("unshelve", "Bring back")];
  return [alert.acknowledged_at === null ? button("acknowledge", "Acknowledge") : null, button("shelve", "Shelve")];
}

/** One alert with its evidence and everything that happened to it. */
export async function alertView({ params, signal, title }) {
  title(`Alert ${params.id}`);
  const path = `/v1/alerts/${segment(params.id)}`;
  const load = async () => ({ alert: await get(path, signal), events: (await get(`${path}/events`, signal)).items });
  const shown = live({ load, show: (found) => whole(found, () => shown.reload()), signal, everyS: 60, what: "Loading the alert" });
  follow(signal, (events) => events.some((event) => String(event.alert.id) === params.id) && shown.reload());
  return el("div", { data: { back: "#/alerts" } }, shown);
}

function whole({ alert, events }, changed) {
  const fact = (name, value) => (value === null ? null : [el("dt", {}, name), el("dd", {}, value)]);
  const wheelset = alert.wheelset && el("a", { href: `#/wheelsets/${segment(alert.wheelset)}` }, alert.wheelset);
  return [
    el("div", { class: "view-head" },
      el("h1", {}, `${words(alert.kind)}: ${alert.wheelset ?? alert.track_section ?? alert.fleet}`), el("span", { class: `badge ${alert.severity}` }, alert.severity),
      el("span", { class: "quiet" }, stateOf(alert)),
      el("span", { class: "actions" }, buttons(alert, (name, one) => act(name, one, changed)))),
    el("section", { class: "panel" }, el("h2", {}, "Why"), el("p", {}, evidenceOf(alert)), el("p", {}, el("b", {}, actionOf(alert))),
      el("dl", { class: "facts" },
        fact("Wheelset", wheelset), fact("Fleet", alert.fleet), fact("Raised", moment(alert.opened_at)), fact("Last seen", `${moment(alert.last_seen_at)}, ${alert.occurrence_count} times`),
        fact("Acknowledged", alert.acknowledged_by && `${moment(alert.acknowledged_at)} by ${alert.acknowledged_by}`),
        fact("Shelved until", alert.shelved_until && `${moment(alert.shelved_until)}: ${alert.shelved_reason}`),
        fact("Closed", alert.closed_at && `${moment(alert.closed_at)}: ${alert.close_reason}`),
        fact("Work orders", alert.external_refs.length ? alert.external_refs.join(", ") : null), fact("Rules", alert.rules_version ?? null))),
    el("section", { class: "panel wide" }, el("h2", {}, "What happened"),
      el("table", { class: "plain" },
        el("thead", {}, el("tr", {}, ["Recorded", "Event", "By", "Severity", "Note"].map((name) => el("th", { scope: "col" }, name)))),
        el("tbody", {}, events.map((event) => el("tr", {}, el("td", {}, moment(event.recorded_at)), el("td", {}, words(event.event)), el("td", {}, event.actor), el("td", {}, event.alert.severity), el("td", {}, event.note)))))),
  ];
}
