// Why nothing is estimated of a wheelset: its windows by reason, and what to do.
import { el } from "./dom.js";
import { age, date, lastData, number, words } from "./format.js";

const head = (...names) => el("thead", {}, el("tr", {}, names.map((name) => el("th", { scope: "col" }, name))));
const second = (text) => el("span", { class: "second" }, text);

/** A notice in place of numbers: why, what to do, and how many windows there are of each reason. */
export function noEstimate(without, geometry) {
  const title = geometry === null ? "Nothing has been estimated of this wheelset yet." : "Nothing is estimated of this wheelset now.";
  return el(
    "section", { class: "state reasons", data: { state: "empty", panel: "reasons" } }, el("h2", {}, title),
    without.reasons.length && geometry === null ? null : el("p", {}, without.reason),
    without.what_to_do ? el("p", {}, el("b", {}, without.what_to_do)) : null,
    without.reasons.length ? table(without.reasons) : null, el("p", { class: "quiet" }, counted(without)),
  );
}

const table = (reasons) => el("table", { class: "plain" }, head("Windows", "State", "Why", "What to do", "Newest"), el("tbody", {}, reasons.map(row)));

function row(one) {
  const cells = [
    ["Windows", number(one.windows)], ["State", one.state], ["Why", [words(one.reason_code), second(one.reason)]],
    ["What to do", one.what_to_do ?? "Wait."], ["Newest", age(one.newest_at)],
  ];
  return el("tr", {}, cells.map(([label, content]) => el("td", { data: { label } }, content)));
}

function counted(without) {
  if (without.windows === 0) return without.last_data_at ? ["Last data: ", lastData(without.last_data_at)] : "No data of it have been received.";
  const parts = ["refused", "pending", "estimated"].filter((state) => without[state]).map((state) => `${number(without[state])} ${state}`);
  return [`Its newest ${number(without.windows)} windows since ${date(without.counted_from)} are counted: ${parts.join(", ")}. Last data: `, lastData(without.last_data_at), "."];
}
