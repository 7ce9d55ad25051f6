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
};
const SEVERITIES = ["critical", "warning", "info"];
const second = (...content) => el("span", { class: "second" }, ...content);

const worstFirst = (one, other) =>
  SEVERITIES.indexOf(one.severity) - SEVERITIES.indexOf(other.severity) || other.opened_at.localeCompare(one.opened_at);

export async function alerts({ query, signal, title }) {
  title("Alerts");
  let { tab = "open", ...wanted } = query, all = [];
  const fleets = await getAll("/v1/fleets?limit=1000", signal);
  const path = () => withQuery("/v1/alerts", { fleet: wanted.fleet, kind: wanted.kind, open: true, limit: 1000 });
  const tabs = el("div", { class: "tabs", role: "group", "aria-label": "Which alerts" });
  const list = table({
    columns: columns((name, alert) => act(name, alert, changedOne)), label: "Alerts, the worst first", rowHeight: 58,
    keyOf: (alert) => alert.id, onOpen: (alert) => (location.hash = `#/alerts/${alert.id}`),
    nothing: () => empty(tab === "open" ? "No open alert." : `No alert is ${tab}.`, "New ones appear here by themselves."),
  });

  const load = () => getAll(path(), signal);

  function show(found) {
    all = found;
    replace(tabs, Object.entries(TABS).map(([name, { label, fits }]) => el(
      "button", { type: "button", "aria-pressed": String(name === tab), data: { tab: name }, on: { click: () => choose(name) } },
      `${label} `, el("span", { class: "count" }, String(all.filter(fits).length)),
    )));
    return list.setRows(all.filter(TABS[tab].fits).sort(worstFirst));
  }

  function choose(name) {
    tab = name;
    keepQuery({ ...wanted, tab: tab === "open" ? "" : tab });
    show(all);
    tabs.querySelector(`[data-tab="${name}"]`).focus();
  }

  function changedOne(alert) {
    show(all.map((one) => (one.id === alert.id ? alert : one)));
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
    keepQuery({ ...wanted, tab: tab === "open" ? "" : tab });
    shown.reload();
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
  if (alert.wheelset === null) return el("span", { class: "quiet" }, "whole fleet");
  return [
    el("a", { href: `#/wheelsets/${segment(alert.wheelset)}`, tabindex: -1 }, alert.wheelset),
    alert.vehicle ? second(`${alert.vehicle}, axle ${alert.axle}`) : null,
  ];
}

function state(alert) {
  if (alert.display_state === "acknowledged") return ["acknowledged", second(`by ${alert.acknowledged_by}, `, ago(alert.acknowledged_at))];
  if (alert.display_state === "shelved") return [`until ${moment(alert.shelved_until)}`, second(alert.shelved_reason)];
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
      el("h1", {}, `${words(alert.kind)}: ${alert.wheelset ?? alert.fleet}`), el("span", { class: `badge ${alert.severity}` }, alert.severity),
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
