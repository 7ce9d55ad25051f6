// The fleet: every wheelset, where it runs, and the way to what is known of it.
import { getAll, segment } from "./client.js";
import { el } from "./dom.js";
import { km } from "./format.js";
import { live } from "./live.js";
import { table } from "./table.js";

const COLUMNS = [
  { name: "serial", label: "Wheelset", cell: (row) => el("a", { href: address(row), tabindex: -1 }, row.serial) },
  { name: "fleet", label: "Fleet", cell: (row) => row.fleet },
  { name: "vehicle", label: "Vehicle", cell: (row) => row.mounting?.vehicle ?? "not mounted" },
  { name: "axle", label: "Axle", class: "right", cell: (row) => row.mounting?.axle ?? "" },
  { name: "profile", label: "Wheel profile", cell: (row) => row.wheel_profile },
  { name: "mileage", label: "Mileage when mounted", class: "right", cell: (row) => km(row.mounting?.wheelset_mileage_km) },
];

const address = (row) => `#/wheelsets/${segment(row.serial)}`;

export function overview({ signal, title }) {
  title("Fleet");
  const list = table({
    columns: COLUMNS, label: "Wheelsets", rowHeight: 34, keyOf: (row) => row.serial,
    onOpen: (row) => (location.hash = address(row)),
  });
  const load = () => getAll("/v1/wheelsets?limit=1000", signal);
  return el(
    "div", {}, el("div", { class: "view-head" }, el("h1", {}, "Fleet")),
    live({ load, signal, everyS: 60, show: (rows) => list.setRows(rows) }),
  );
}
