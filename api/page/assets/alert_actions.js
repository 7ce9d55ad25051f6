// Acknowledge, shelve and unshelve an alert, under its ETag: what has changed meanwhile is shown, not overwritten.
import { getWithTag, key, post } from "./client.js";
import { announce, el } from "./dom.js";
import { moment } from "./format.js";
import { stateOf } from "./alert_words.js";
import { dialog } from "./keys.js";

const NAME = "treadwatch.name";
const DAY_MS = 86400000;

const kept = () => {
  try {
    return localStorage.getItem(NAME) ?? "";
  } catch {
    return "";
  }
};

function keep(name) {
  try {
    localStorage.setItem(NAME, name);
  } catch {
    // asked for again next time
  }
}

const field = (id, label, input) => [el("label", { for: id }, label), input];

function nameField() {
  return el("input", { id: "act-by", name: "by", value: kept(), maxlength: 200, required: true, autocomplete: "name" });
}

const written = (id, props = {}) => el("textarea", { id, rows: 2, maxlength: 2000, ...props });

const ACTIONS = {
  acknowledge: {
    title: "Acknowledge", done: "Acknowledged",
    explain: "You have seen it. It ends when the alert clears or becomes more severe.",
    fields: () => ({ note: [written("act-note"), "Note, for example what is planned"] }),
    body: ({ note }) => ({ note: note.value }),
  },
  shelve: {
    title: "Shelve", done: "Shelved",
    explain: "It is put out of sight until a time, and returns by itself.",
    fields: () => ({
      days: [el("select", { id: "act-days" }, [[1, "1 day"], [7, "1 week"], [14, "2 weeks"], [30, "30 days"], [90, "90 days"]].map(([n, text]) => el("option", { value: n, selected: n === 7 }, text))), "For"],
      reason: [written("act-reason", { required: true }), "Reason"],
    }),
    body: ({ days, reason }) => ({ until: new Date(Date.now() + Number(days.value) * DAY_MS).toISOString(), reason: reason.value }),
  },
  unshelve: {
    title: "Bring back", done: "Brought back",
    explain: "It is shown again among the open alerts.",
    fields: () => ({ note: [written("act-note"), "Note"] }),
    body: ({ note }) => ({ note: note.value }),
  },
};

/** Open the dialog of an action on an alert; `done(alert)` gets the alert as it is then. */
export async function act(name, alert, done) {
  const action = ACTIONS[name];
  let { body: current, tag } = await getWithTag(alert.links.self);
  const once = new Map(); // one key for each state that is acted on, so that a repeat after a lost answer changes nothing
  const by = key() === null ? nameField() : null, own = action.fields(); // the owner of a key is who acts, without a name
  const refused = el("p", { class: "refused", role: "alert" });
  const form = el(
    "form", {},
    el("p", {}, `${alert.wheelset ?? alert.track_section ?? alert.fleet}: ${alert.kind.replaceAll("_", " ")}. ${action.explain}`),
    Object.values(own).map(([input, label]) => field(input.id, label, input)),
    by === null ? null : field("act-by", "Your name", by), refused,
    el("div", { class: "actions" },
      el("button", { type: "button", on: { click: () => box.close() } }, "Cancel"),
      el("button", { type: "submit", class: "main" }, action.title)),
  );
  const box = dialog(`${action.title} alert ${alert.id}`, form);
  form.querySelector("textarea").focus();
  form.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) form.requestSubmit();
  });
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const named = by === null ? {} : { by: by.value };
    if (by !== null) keep(by.value);
    const button = form.querySelector("button.main");
    button.disabled = true;
    try {
      if (!once.has(tag)) once.set(tag, crypto.randomUUID?.() ?? String(Math.random()));
      const values = Object.fromEntries(Object.entries(own).map(([key, [input]]) => [key, input]));
      const answer = await post(`${alert.links.self}/${name}`, { ...named, ...action.body(values) }, { tag, once: once.get(tag) });
      box.close();
      announce(`${action.done}: alert ${alert.id}`);
      done(answer.body);
    } catch (error) {
      once.clear();
      refused.textContent = error.message;
      if (error.status === 412) {
        ({ body: current, tag } = await getWithTag(alert.links.self));
        const who = current.acknowledged_by ? `, acknowledged by ${current.acknowledged_by}` : "";
        refused.textContent = `It has changed since you opened it: now ${stateOf(current)}${who}, last seen ${moment(current.last_seen_at)}. Check it, and press again to act on it as it is now.`;
        done(current);
      }
    }
    button.disabled = false;
  });
}
