// Hash routes: `#/wheelsets/WS-1?tab=x` is a view, its parameters and its query.
import { failure, loading } from "./states.js";
import { replace } from "./dom.js";

const routes = [];
let leaving = null;

/** Add a view: `pattern` like `/wheelsets/:serial`, `name` of its link, `view(context)` returns its element. */
export function route(pattern, name, view) {
  const names = [...pattern.matchAll(/:(\w+)/g)].map((found) => found[1]);
  routes.push({ names, name, view, fits: new RegExp(`^${pattern.replace(/:\w+/g, "([^/]+)")}$`) });
}

/** The path of a view, for a link. */
export function to(path, query = {}) {
  const text = new URLSearchParams(Object.entries(query).filter(([, value]) => value !== "" && value != null));
  return `#${path}${text.size ? `?${text}` : ""}`;
}

/** Change the query of the view that is shown, without a new entry in the history and without drawing it again. */
export function keepQuery(query) {
  const path = location.hash.slice(1).split("?")[0] || "/";
  history.replaceState(null, "", to(path, query));
}

function found() {
  const [path, query = ""] = (location.hash.slice(1) || "/").split("?");
  for (const one of routes) {
    const match = one.fits.exec(path);
    if (match === null) continue;
    try {
      const values = match.slice(1).map(decodeURIComponent);
      const params = Object.fromEntries(one.names.map((name, place) => [name, values[place]]));
      return { ...one, params, query: Object.fromEntries(new URLSearchParams(query)) };
    } catch {
      return null; // the address is not well formed
    }
  }
  return null;
}

/** Show the view of the address; a view that is left gets its signal aborted. */
export async function show() {
  leaving?.abort();
  leaving = new AbortController();
  const { signal } = leaving;
  const place = document.getElementById("view");
  const here = found();
  for (const link of document.querySelectorAll("header nav a")) {
    if (link.dataset.view === here?.name) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  if (here === null) {
    replace(place, failure({ status: 404, message: "There is no such view." }));
    return;
  }
  place.dataset.view = here.name;
  const waiting = setTimeout(() => replace(place, loading()), 150);
  signal.addEventListener("abort", () => clearTimeout(waiting)); // the files of a view that is left may still be read
  try {
    const element = await here.view({ params: here.params, query: here.query, signal, title });
    if (!signal.aborted) replace(place, element);
  } catch (error) {
    if (signal.aborted) return;
    if (error.status === undefined) console.error(error);
    replace(place, failure(error, show));
  } finally {
    clearTimeout(waiting);
  }
}

function title(text) {
  document.title = text ? `${text} \u2013 treadwatch` : "treadwatch";
}

/** Begin, and follow the address. */
export function start() {
  addEventListener("hashchange", () => {
    if (!location.hash.startsWith("#/") && location.hash !== "") return; // a place within the page
    show().then(() => {
      if (!document.activeElement?.matches("input, select, textarea, dialog *")) document.getElementById("view").focus({ preventScroll: true });
    });
    scrollTo(0, 0);
  });
  return show();
}
