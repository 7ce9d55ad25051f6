// Data that are read again: shown when they change, marked as stale when they cannot be read.
import { failure, loading, staleNotice } from "./states.js";
import { replace } from "./dom.js";

const SLOWEST_MS = 60000;

/**
 * Show what `load(signal)` returns by `show(data)`, again every `everyS` seconds and when the page is looked at again.
 *
 * Returns the element; `element.reload()` reads at once, `reload({ other: true })` something else than what is shown. The
 * first failure is the view's error state; a later one leaves what is shown, with a notice of its age.
 */
export function live({ load, show, signal, everyS = 30, what = "Loading" }) {
  const notice = document.createElement("div");
  const body = document.createElement("div");
  const element = document.createElement("div");
  element.append(notice, body);
  body.append(loading(what));
  let timer, shown, read, failures = 0, running = null;

  async function once() {
    try {
      const data = await load(signal);
      failures = 0;
      read = Date.now();
      notice.replaceChildren();
      const text = JSON.stringify(data);
      if (text !== shown) {
        shown = text;
        replace(body, await show(data));
      }
    } catch (error) {
      if (signal.aborted) return;
      failures += 1;
      if (shown === undefined) replace(body, failure(error, reload));
      else notice.replaceChildren(staleNotice(read, error));
      if (error.status === undefined) console.error(error);
    }
  }

  function reload() {
    clearTimeout(timer);
    running ??= once().finally(() => {
      running = null;
      if (signal.aborted) return;
      const wait = failures ? Math.min(1000 * 2 ** failures, SLOWEST_MS) : everyS * 1000;
      timer = setTimeout(reload, wait);
    });
    return running;
  }

  const looked = () => document.visibilityState === "visible" && read && Date.now() - read > 5000 && reload();
  document.addEventListener("visibilitychange", looked, { signal });
  signal.addEventListener("abort", () => clearTimeout(timer));
  element.reload = async ({ other = false } = {}) => {
    if (running) await running;
    if (other) shown = undefined; // a failure to read it leaves nothing of what was shown before
    return reload();
  };
  element.ready = reload();
  return element;
}
