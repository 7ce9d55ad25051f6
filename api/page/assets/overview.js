// The fleet, ranked by urgency with reasons; filtered and sorted by the API, read page by page as it is scrolled.
import { get, getAll, withQuery } from "./client.js";
import { announce, el, replace } from "./dom.js";
import { address, columns, nameOf, URGENCIES } from "./fleet_columns.js";
import { filters } from "./filters.js";
import { KINDS } from "./alert_words.js";
import { scaleOf } from "./interval.js";
import { live } from "./live.js";
import { keepQuery } from "./router.js";
import { empty } from "./states.js";
import { table } from "./table.js";
import { saveButton } from "./table_file.js";

const FIRST = 60, FURTHER = 100;
const STATUSES = ["estimated", "unestimated", "invalid", "model_mismatch"];
const FILTERS = ["fleet", "vehicle", "vehicle_class", "urgency", "status", "alert_kind"];

export async function overview({ query, signal, title }) {
  title("Fleet");
  let { sort = "urgency", ...wanted } = query;
  let rows = [], next = null, most = 0.6;
  const path = (limit) => withQuery("/v1/wheelsets", { ...pick(wanted), sort, limit });
  const count = el("span", { class: "quiet" });
  const list = table({
    columns: columns(() => most), label: "Wheelsets by urgency", keyOf: (row) => row.serial, sorted: sort,
    onOpen: (row) => (location.hash = address(row)), onSort: sortBy,
    nothing: () => (Object.keys(pick(wanted)).length
      ? empty("No wheelset fits these filters.", "Clear the filters to see all of them.")
      : firstSteps()),
  });

  /** Read as many rows as are shown, at least the first page. */
  async function load() {
    const found = [];
    let following = path(FIRST);
    do {
      const page = await get(following, signal);
      found.push(...page.items);
      following = page.next?.replace(/limit=\d+/, `limit=${FURTHER}`) ?? null;
    } while (following !== null && found.length < rows.length);
    return { found, following };
  }

  function show({ found, following }) {
    rows = found;
    next = following;
    most = Math.max(0.6, scaleOf(rows));
    return drawn();
  }

  function drawn() {
    count.textContent = `${rows.length}${next === null ? "" : " of more"} wheelset${rows.length === 1 ? "" : "s"}`;
    return list.setRows(rows, { more: next === null ? null : more });
  }

  async function more() {
    try {
      const page = await get(next.replace(/limit=\d+/, `limit=${FURTHER}`), signal);
      rows = [...rows, ...page.items];
      next = page.next;
      drawn();
    } catch (error) {
      if (!signal.aborted) announce(error.message);
    }
  }

  function again() {
    rows = [];
    keepQuery({ ...pick(wanted), sort: sort === "urgency" ? "" : sort });
    list.setSorted(sort);
    return shown.reload({ other: true });
  }

  function sortBy(name) {
    const turned = name.startsWith("-") ? name.slice(1) : `-${name}`;
    sort = sort === name ? turned : name;
    again();
  }

  const chosen = (values) => {
    wanted = values;
    again();
  };
  const save = saveButton(el, () => path(1000), "wheelsets.csv");
  const bar = el("div", { class: "filters-place" });
  const shown = live({ load, show, signal, everyS: 60, what: "Loading the fleet" });
  fieldsOf(signal)
    .then((fields) => replace(bar, filters(fields, wanted, chosen, save)))
    .catch((error) => signal.aborted || announce(error.message));
  return el(
    "div", {},
    el("div", { class: "view-head" }, el("h1", {}, "Fleet, the most urgent first"), count),
    bar, shown,
  );
}

/** The choices of the filters: those that are on file are read beside the rows, which do not wait for them. */
async function fieldsOf(signal) {
  const codes = async (path) => (await getAll(path, signal)).map((one) => [one.code, one.code]);
  const [fleets, classes] = await Promise.all([codes("/v1/fleets?limit=1000"), codes("/v1/vehicle-classes?limit=1000")]);
  return [
    { name: "fleet", label: "Fleet", options: fleets },
    { name: "vehicle", label: "Vehicle" },
    { name: "vehicle_class", label: "Class", options: classes },
    { name: "urgency", label: "Urgency", options: URGENCIES.map((code) => [code, nameOf(code)]) },
    { name: "status", label: "Status", options: STATUSES },
    { name: "alert_kind", label: "Alert", options: KINDS },
  ];
}

/** An empty database: what to do, in the order in which it is done. */
function firstSteps() {
  const steps = [
    ["treadwatch registry load FILE", "loads vehicles, wheelsets and their mountings"],
    ["treadwatch ingest FILE", "receives a recording"],
    ["treadwatch demo", "shows a simulated fleet instead"],
  ];
  return el(
    "div", { class: "state", data: { state: "empty" } }, el("h2", {}, "No wheelset is registered yet."),
    el("dl", { class: "steps" }, steps.map(([command, what]) => [el("dt", {}, el("code", {}, command)), el("dd", {}, what)])),
  );
}

const pick = (values) => Object.fromEntries(FILTERS.filter((name) => values[name]).map((name) => [name, values[name]]));
