// Filters of a list: fields with labels, their values in the address.
import { el } from "./dom.js";
import { words } from "./format.js";

/**
 * A row of filters. `fields` are `{name, label, options}` (a choice; an option is a code or `[code, text]`) or
 * `{name, label, list}` (a code to write, with what is known as proposals) or `{name, label, number, unit}` (a number
 * within `number`, the attributes of its field); `changed(values)` gets all values that are valid.
 */
export function filters(fields, values, changed, ...beside) {
  const chosen = { ...values };
  const set = (name, value) => {
    if (value) chosen[name] = value;
    else delete chosen[name];
    changed({ ...chosen });
  };
  const clear = el("button", { type: "button", on: { click: () => {
    for (const field of fields) {
      delete chosen[field.name];
      element.querySelector(`[name="${field.name}"]`).value = "";
    }
    changed({ ...chosen });
  } } }, "Clear");
  const element = el(
    "form", { class: "filters", role: "search", "aria-label": "Filters", on: { submit: (event) => event.preventDefault() } },
    fields.map((field) => el("label", { title: field.title }, field.label, field.options ? choice(field, chosen, set) : written(field, chosen, set))),
    clear, el("span", { class: "actions" }, ...beside),
  );
  return element;
}

function choice({ name, options, any = "all" }, chosen, set) {
  const items = options.map((option) => (Array.isArray(option) ? option : [option, words(option)]));
  const field = el(
    "select", { name, on: { change: () => set(name, field.value) } },
    any === null ? null : el("option", { value: "" }, any),
    items.map(([code, text]) => el("option", { value: code, selected: chosen[name] === code }, text)),
  );
  return field;
}

function written({ name, list, number: attributes, unit, size = 12 }, chosen, set) {
  const field = el("input", {
    name, size, value: chosen[name] ?? "", autocomplete: "off", spellcheck: "false", list: list ? `${name}-known` : null,
    type: attributes ? "number" : null, ...attributes,
    on: { change: () => field.reportValidity() && set(name, field.value.trim()) },
  });
  return [field, unit, list ? el("datalist", { id: `${name}-known` }, list.map((code) => el("option", { value: code }))) : null];
}
