// What a view shows when it has nothing to show: loading, empty, error; and when what it shows is stale.
import { el, announce } from "./dom.js";
import { span } from "./format.js";

export function loading(what = "Loading") {
  return el("div", { class: "state loading", role: "status", data: { state: "loading" } }, `${what}\u2026`);
}

/** Nothing there: what is missing, and what to do about it. */
export function empty(title, ...advice) {
  return el("div", { class: "state", data: { state: "empty" } }, el("h2", {}, title), ...advice.map((text) => el("p", {}, text)));
}

const ADVICE = {
  0: "The server does not answer. It may be starting again; this page tries again by itself.",
  401: "An API key is needed.",
  403: "Ask who runs this service for a key with that scope.",
  404: "It does not exist, or belongs to a fleet that your key does not show.",
  503: "The service is waiting for its database, or is busy.",
};

/** Why there is nothing, in the words of the API, and a way to try again. */
export function failure(error, retry) {
  const known = error.status !== undefined;
  announce(error.message);
  return el(
    "div",
    { class: "state error", role: "alert", data: { state: "error" } },
    el("h2", {}, known ? error.message : "This view failed."),
    el("p", {}, known ? (ADVICE[error.status] ?? `The API answered ${error.status}.`) : String(error)),
    (error.problem?.errors ?? []).map((item) => el("p", {}, `${item.in ?? ""} ${item.pointer}: ${item.detail}`)),
    retry ? el("button", { type: "button", on: { click: retry } }, "Try again") : null,
  );
}

/** A line above a view whose data could not be read again. */
export function staleNotice(since, error) {
  return el(
    "div",
    { class: "stale-notice", role: "status", data: { state: "stale" } },
    el("b", {}, `Not up to date: as of ${span(Date.now() - since)} ago. `),
    `${error.message} Trying again.`,
  );
}
