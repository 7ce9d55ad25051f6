// A list as one CSV file, however many pages the API gives it in.
import { send } from "./client.js";

const HEADER = /^[^\r\n]*\r?\n/;

async function pages(path) {
  const parts = [];
  for (let next = path; next !== null; ) {
    const answer = await send(next, { headers: { Accept: "text/csv" } });
    const text = await answer.text();
    parts.push(parts.length ? text.replace(HEADER, "") : text);
    next = /<([^>]+)>;\s*rel="next"/.exec(answer.headers.get("Link") ?? "")?.[1] ?? null;
  }
  return parts;
}

/** A button that saves the list behind `path()` as `name`. */
export function saveButton(el, path, name) {
  const button = el("button", { type: "button", title: "The whole list with these filters, as a table" }, "Save as CSV");
  button.addEventListener("click", async () => {
    button.disabled = true;
    try {
      const address = URL.createObjectURL(new Blob(await pages(path()), { type: "text/csv" }));
      el("a", { href: address, download: name }).click();
      setTimeout(() => URL.revokeObjectURL(address), 10000);
    } catch (error) {
      button.textContent = `Not saved: ${error.message}`;
    }
    button.disabled = false;
  });
  return button;
}
