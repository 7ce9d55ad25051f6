// A table of thousands of rows of which only those in sight are in the document, and the first when it is printed.
import { el, replace } from "./dom.js";
import { empty } from "./states.js";

const MARGIN_ROWS = 8, AHEAD_ROWS = 20;
const PRINTED_ROWS = 500; // some 25 sheets; a browser lays thousands of rows out for minutes

/**
 * A table. `columns` are `{name, label, title, cell(row), class, sort}`; `sort` names what a click on the head sorts by.
 *
 * `table.setRows(rows, {total, more})` shows other rows; `more()` is called when the end of the rows comes into sight.
 * Arrows, Page Up, Page Down, Home and End move, Enter opens. End reads on until the last row is there.
 */
export function table({ columns, label, rowHeight = 44, keyOf, onOpen, onSort, sorted, rowClass, nothing }) {
  let rows = [], total = 0, more = null, focused = 0, first = -1, last = -1, toEnd = false;
  const head = el("tr", { "aria-rowindex": 1 }, columns.map((column) => headCell(column, sorted, onSort)));
  const above = el("tbody", { "aria-hidden": "true" });
  const body = el("tbody", {});
  const below = el("tbody", { "aria-hidden": "true" });
  const grid = el(
    "table",
    { role: "grid", "aria-label": label, class: "rows" },
    el("colgroup", {}, columns.map((column) => el("col", { class: `col-${column.name}` }))),
    el("thead", {}, head), above, body, below,
  );
  const cut = el("p", { class: "printed-cut" });
  const scroller = el("div", { class: "scroller", on: { scroll: () => requestAnimationFrame(draw) } }, grid, cut);
  const element = el("div", { class: "table" }, scroller);
  const print = matchMedia("print"); // asked when it is drawn: sizes change before its own event

  function draw() {
    if (rows.length === 0) return;
    const forPrint = print.matches;
    const height = scroller.clientHeight || innerHeight;
    const from = forPrint ? 0 : Math.max(0, Math.floor(scroller.scrollTop / rowHeight) - MARGIN_ROWS);
    const to = forPrint ? Math.min(rows.length, PRINTED_ROWS) : Math.min(rows.length, from + Math.ceil(height / rowHeight) + 2 * MARGIN_ROWS);
    if (more && !forPrint && to > rows.length - AHEAD_ROWS) {
      const ask = more;
      more = null;
      ask();
    }
    cut.textContent = forPrint && (more || to < rows.length) ? `The first ${to} rows. The table saved as CSV has all.` : "";
    if (from === first && to === last) return;
    const held = body.contains(document.activeElement);
    drawRows(from, to);
    first = from;
    last = to;
    spacer(above, from);
    spacer(below, Math.max(0, (forPrint ? to : rows.length) - to));
    if (held) body.querySelector('tr[tabindex="0"]')?.focus({ preventScroll: true });
  }

  /** Draw what has come into sight, and remove what has left it; all, where nothing of it is there yet. */
  function drawRows(from, to) {
    const drawn = (begin, end) => rows.slice(begin, end).map((row, place) => drawRow(row, begin + place));
    const begin = Math.max(from, first), end = Math.min(to, last);
    if (first === -1 || begin >= end) {
      replace(body, drawn(from, to));
      return;
    }
    for (const row of [...body.children]) {
      if (row.dataset.index < begin || row.dataset.index >= end) row.remove();
    }
    body.prepend(...drawn(from, begin));
    body.append(...drawn(end, to));
  }

  const spacer = (part, count) =>
    replace(part, count > 0 && el("tr", {}, el("td", { class: "spacer", style: { height: `${count * rowHeight}px` } })));

  function drawRow(row, index) {
    return el(
      "tr",
      {
        "aria-rowindex": index + 2,
        tabindex: index === focused ? 0 : -1,
        class: rowClass?.(row),
        data: { index, key: keyOf(row) },
        style: { height: `${rowHeight}px` },
        on: { focus: () => mark(index) },
      },
      columns.map((column) => el("td", { class: classOf(column) }, column.cell(row))),
    );
  }

  function mark(index) {
    body.querySelector('tr[tabindex="0"]')?.setAttribute("tabindex", "-1");
    focused = index;
    body.querySelector(`tr[data-index="${index}"]`)?.setAttribute("tabindex", "0");
  }

  function move(index) {
    const target = Math.max(0, Math.min(rows.length - 1, index));
    const top = target * rowHeight, room = scroller.clientHeight - head.offsetHeight - rowHeight;
    if (top < scroller.scrollTop) scroller.scrollTop = top;
    else if (top > scroller.scrollTop + room) scroller.scrollTop = top - room;
    draw();
    mark(target);
    body.querySelector(`tr[data-index="${target}"]`)?.focus({ preventScroll: true });
  }

  const pageOf = () => Math.max(1, Math.floor(scroller.clientHeight / rowHeight) - 2);
  const steps = {
    ArrowDown: () => focused + 1,
    ArrowUp: () => focused - 1,
    PageDown: () => focused + pageOf(),
    PageUp: () => focused - pageOf(),
    Home: () => 0,
    End: () => rows.length - 1,
  };

  body.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName !== "TR") return;
    toEnd = event.key === "End";
    if (event.key === "Enter") onOpen?.(rows[focused], event.target);
    else if (event.key in steps) move(steps[event.key]());
    else return;
    event.preventDefault();
  });
  body.addEventListener("click", (event) => {
    const row = event.target.closest("tr");
    if (row === null || event.target.closest("a, button") || getSelection().type === "Range") return;
    mark(Number(row.dataset.index));
    row.focus({ preventScroll: true });
    onOpen?.(rows[focused], row);
  });
  const asPrinted = () => {
    first = -1;
    draw();
  };
  print.addEventListener("change", asPrinted);
  const sized = new ResizeObserver(() => {
    if (!element.isConnected && first !== -1) print.removeEventListener("change", asPrinted);
    else draw();
  });
  sized.observe(scroller);

  element.setRows = (given, options = {}) => {
    const key = rows[focused] && keyOf(rows[focused]);
    rows = given;
    total = options.total ?? rows.length;
    more = options.more ?? null;
    focused = Math.max(0, rows.findIndex((row) => keyOf(row) === key));
    grid.setAttribute("aria-rowcount", more ? -1 : total + 1);
    first = -1;
    if (rows.length === 0) replace(element, nothing?.() ?? empty("Nothing here."));
    else if (!scroller.isConnected || element.firstChild !== scroller) replace(element, scroller);
    draw();
    if (toEnd && rows.length > 0 && element.isConnected) move(rows.length - 1); // on to the end of what is there
    toEnd &&= Boolean(options.more);
    return element;
  };
  element.focusFirst = () => move(focused);
  element.setSorted = (name) => {
    for (const [place, column] of columns.entries()) sortMark(head.children[place], column, name);
  };
  return element;
}

const classOf = (column) => `c-${column.name} ${column.class ?? ""}`;

function headCell(column, sorted, onSort) {
  const label = column.sort ? el("button", { type: "button", on: { click: () => onSort(column.sort) } }, column.label) : column.label;
  const cell = el("th", { scope: "col", class: classOf(column), title: column.title }, label);
  sortMark(cell, column, sorted);
  return cell;
}

function sortMark(cell, column, name) {
  if (!column.sort) return;
  const same = column.sort.replace(/^-/, "") === name?.replace(/^-/, "");
  cell.setAttribute("aria-sort", !same ? "none" : name.startsWith("-") ? "descending" : "ascending");
}
