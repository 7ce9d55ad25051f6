// The API key of this session: asked for when the API wants one, taken once from `#key=...` by the demo's link.
import { el } from "./dom.js";
import { ApiError, get, keepKey, key, session } from "./client.js";
import { dialog } from "./keys.js";

let asking = null;

/** Take the key out of the address, so that it is neither seen, nor bookmarked, nor handed on. */
export function keyFromAddress() {
  const found = /^#key=([^&]+)/.exec(location.hash);
  if (found === null) return;
  keepKey(decodeURIComponent(found[1]));
  history.replaceState(null, "", `${location.pathname}#/`);
}

/** Ask for a key whenever the API wants one; `signedIn()` is called when it takes the key. */
export function startLogin(signedIn) {
  const button = document.getElementById("sign-out");
  const shown = () => (button.hidden = key() === null);
  button.addEventListener("click", () => {
    keepKey(null);
    location.reload();
  });
  shown();
  session.addEventListener("needkey", (event) => {
    asking ??= ask(event.detail, () => {
      shown();
      signedIn();
    });
  });
}

function ask(refusal, signedIn) {
  const field = el("input", { id: "key-field", type: "password", autocomplete: "off", spellcheck: "false", required: true });
  const refused = el("p", { class: "refused", role: "alert" }, key() === null ? null : refusal.message);
  const form = el(
    "form", {},
    el("p", {}, "This service asks for an API key with the scope \u201cread\u201d; to acknowledge and shelve alerts, also \u201cact\u201d."),
    el("label", { for: "key-field" }, "API key"), field, refused,
    el("p", { class: "quiet" }, "It is kept in this tab until it is closed. Who runs the service makes keys."),
    el("div", { class: "actions" }, el("button", { type: "submit", class: "main" }, "Sign in")),
  );
  const box = dialog("Sign in", form);
  box.addEventListener("close", () => (asking = null));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const before = key();
    keepKey(field.value.trim());
    try {
      await get("/v1/fleets?limit=1");
      box.close();
      signedIn();
    } catch (error) {
      if (error.status === 401) keepKey(before);
      refused.textContent = error instanceof ApiError ? error.message : String(error);
      field.select();
    }
  });
  return box;
}
