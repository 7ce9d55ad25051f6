// The page begins here: views under their addresses, search, theme, keyboard, sign-in.
import { get, segment, session } from "./client.js";
import { alerts, alertView } from "./alerts.js";
import { announce } from "./dom.js";
import { showKeys, startKeys } from "./keys.js";
import { keyFromAddress, startLogin } from "./login.js";
import { jobView, operation } from "./operation.js";
import { overview } from "./overview.js";
import { route, show, start } from "./router.js";
import { sheet } from "./sheet.js";
import { track, tracks } from "./tracks.js";
import { wheelset } from "./wheelset.js";

route("/", "overview", overview);
route("/alerts", "alerts", alerts);
route("/alerts/:id", "alerts", alertView);
route("/tracks", "tracks", tracks);
route("/tracks/:code", "tracks", track);
route("/wheelsets/:serial", "overview", wheelset);
route("/wheelsets/:serial/sheet", "overview", sheet);
route("/operation", "operation", operation);
route("/operation/jobs/:name", "operation", jobView);

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
start();
