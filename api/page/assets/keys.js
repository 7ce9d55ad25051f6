// The keyboard: `/` to search, `g` and a letter to a view, `?` for this list, Esc out of everything.
import { el } from "./dom.js";

const PLACES = { f: "#/", p: "#/plan", a: "#/alerts", t: "#/tracks", c: "#/accuracy", o: "#/operation" };
const LIST = [
  ["/", "find a wheelset or a vehicle"],
  ["\u2191 \u2193 PgUp PgDn Home End", "move in a table"],
  ["Enter", "open the row"],
  ["Esc", "close a dialog, leave a field, go back to the list"],
  ["g f, g p, g a, g t, g c, g o", "fleet, turning plan, alerts, track sections, accuracy, operation"],
  ["?", "this list"],
];

/** Open a dialog; Esc closes it, and the focus goes back to where it was. */
export function dialog(title, ...content) {
  const box = el("dialog", { "aria-label": title }, el("h2", {}, title), ...content);
  document.body.append(box);
  box.addEventListener("close", () => box.remove());
  box.showModal();
  return box;
}

export function showKeys() {
  const rows = LIST.map(([keys, what]) => [el("dt", {}, el("kbd", {}, keys)), el("dd", {}, what)]);
  const box = dialog("Keyboard", el("dl", { class: "keys" }, rows));
  box.append(el("button", { type: "button", on: { click: () => box.close() } }, "Close"));
}

const typing = (target) => target.closest("input:not([type=checkbox]), textarea, select, dialog");

export function startKeys() {
  let after = null;
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (typing(event.target)) {
      if (event.key === "Escape" && !event.target.closest("dialog")) event.target.blur();
      return;
    }
    if (after === "g" && event.key in PLACES) location.hash = PLACES[event.key];
    else if (event.key === "/") document.getElementById("search-field").focus();
    else if (event.key === "?") showKeys();
    else if (event.key === "Escape" && document.querySelector("dialog[open]") === null) back();
    else {
      after = event.key;
      return;
    }
    after = null;
    event.preventDefault();
  });
}

function back() {
  const list = document.querySelector("#view [data-back]");
  if (list !== null) location.hash = list.dataset.back;
}
