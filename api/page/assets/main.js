// The page begins here: views under their addresses, search, theme, keyboard, sign-in.
import { get, segment, session } from "./client.js";
import { announce } from "./dom.js";
import { showKeys, startKeys } from "./keys.js";
import { keyFromAddress, startLogin } from "./login.js";
import { overview } from "./overview.js";
import { route, show, start } from "./router.js";
// the fleet comes first; the other views are read when they are shown, or once the first has been
const accuracy = () => import("./accuracy.js");
const alerts = () => import("./alerts.js");
const operation = () => import("./operation.js");
const plan = () => import("./plan.js");
const sheet = () => import("./sheet.js");
const tracks = () => import("./tracks.js");
const wheelset = () => import("./wheelset.js");

route("/", "overview", overview);
route("/alerts", "alerts", later(alerts, "alerts"));
route("/alerts/:id", "alerts", later(alerts, "alertView"));
route("/plan", "plan", later(plan, "plan"));
route("/tracks", "tracks", later(tracks, "tracks"));
route("/tracks/:code", "tracks", later(tracks, "track"));
route("/wheelsets/:serial", "overview", later(wheelset, "wheelset"));
route("/wheelsets/:serial/sheet", "overview", later(sheet, "sheet"));
route("/accuracy", "accuracy", later(accuracy, "accuracy"));
route("/operation", "operation", later(operation, "operation"));
route("/operation/jobs/:name", "operation", later(operation, "jobView"));

function later(read, name) {
  return async (context) => {
    let views;
    try {
      views = await read();
    } catch (error) {
      const cause = new Error("The files of this view cannot be read; reload the page.", { cause: error });
      cause.status = 0; // the server is away, or serves another release
      throw cause;
    }
    return views[name](context);
  };
}

/** Read the other views while nothing else happens, so that they are there when they are wanted. */
function readOthers() {
  for (const read of [wheelset, plan, alerts, sheet, tracks, accuracy, operation]) read().catch(() => {});
}

function startTheme() {
  const button = document.getElementById("theme");
  const name = () => {
    const dark = document.documentElement.dataset.theme === "dark";
    button.textContent = dark ? "Light" : "Dark";
  };
  button.addEventListener("click", () => window.toggleTheme());
  addEventListener("themechange", name);
  name();
}

function startSearch() {
  const field = document.getElementById("search-field");
  document.getElementById("search").addEventListener("submit", async (event) => {
    event.preventDefault();
    const wanted = field.value.trim();
    if (wanted === "") return;
    try {
      location.hash = await placeOf(wanted);
      field.value = "";
      field.blur();
    } catch (error) {
      announce(error.message);
      field.setCustomValidity(error.status === 404 || error.status === 422 ? `Neither a wheelset nor a vehicle is called ${wanted}.` : error.message);
      field.reportValidity();
    }
  });
  field.addEventListener("input", () => field.setCustomValidity(""));
}

/** Where a serial or the code of a vehicle leads. */
async function placeOf(wanted) {
  try {
    const found = await get(`/v1/wheelsets/${segment(wanted)}`);
    return `#/wheelsets/${segment(found.serial)}`;
  } catch (error) {
    if (error.status !== 404 && error.status !== 422) throw error;
  }
  const vehicle = await get(`/v1/vehicles/${segment(wanted)}`);
  return `#/?vehicle=${segment(vehicle.code)}`;
}

function startNotice() {
  const notice = document.getElementById("notice");
  session.addEventListener("lost", () => {
    notice.textContent = "The server does not answer. What is shown may be out of date; trying again.";
    notice.hidden = false;
  });
  session.addEventListener("reached", () => (notice.hidden = true));
}

keyFromAddress();
startTheme();
startSearch();
startKeys();
startNotice();
startLogin(show);
document.getElementById("keys-help").addEventListener("click", showKeys);
start().then(() => (window.requestIdleCallback ?? setTimeout)(readOthers));
