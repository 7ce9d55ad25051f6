// Lines and points with their 95 % bands over one axis, drawn by uPlot in the colours of the theme; and their numbers.
import { el, replace } from "./dom.js";
import { date, number } from "./format.js";

const { uPlot } = await library();

/** The library is a script, not a module: it is read with the first view that draws. */
function library() {
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = new URL("./uPlot.iife.min.js", import.meta.url);
    script.addEventListener("load", () => resolve(window));
    script.addEventListener("error", () => reject(new Error(`${script.src} cannot be read`)));
    document.head.append(script);
  });
}
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/**
 * A chart.
 *
 * `series` are `{label, x, y, low, high, role, kind, digits}`: `x` ascending; `low` and `high` the band; `role` a colour
 * of app.css (`estimate`, `design`, `measured`, `limit`, `forecast`); `kind` `line`, `dashed` or `points`; `width` of
 * the line; null in `y` is a gap. `x` and `y` are `{label, time, range, digits}`. `marks` are `{x or y, label, role}`: lines across. `shades` are
 * `{from, to}` of x that are shaded. `sync` names charts with one cursor. x of time is in seconds.
 */
export function chart({ label, series, x = {}, y = {}, marks = [], shades = [], height = 260, sync }) {
  const host = el("div", { class: "plot" });
  const legend = el("ul", { class: "legend" });
  const readout = el("span", { class: "readout", "aria-hidden": "true" });
  const element = el(
    "figure", { class: "chart", "aria-label": label },
    el("figcaption", {}, label, readout), host, legend, numbers(series, x),
  );
  const joined = join(series);
  let plot = null, width = 0;

  function draw() {
    if (width === 0) return;
    plot?.destroy();
    plot = new uPlot(options({ series, x, y, marks, shades, height, width, sync, joined, readout }), joined.data, host);
  }
  const named = series.filter((one) => one.label);
  if (named.length > 1) replace(legend, named.map((one) => el("li", { class: `key ${one.kind ?? "line"} role-${one.role ?? "estimate"}` }, one.label)));
  const sized = new ResizeObserver(() => {
    const now = Math.floor(host.clientWidth);
    if (now === width || now === 0) return;
    width = now;
    if (plot === null) draw();
    else plot.setSize({ width, height });
  });
  sized.observe(host);
  const again = () => (element.isConnected ? draw() : removeEventListener("themechange", again));
  addEventListener("themechange", again);
  matchMedia("print").addEventListener("change", again);
  return element;
}

function join(series) {
  const places = [];
  const tables = series.map((one) => {
    const columns = [one.y];
    if (one.low) columns.push(one.high, one.low);
    return [one.x, ...columns];
  });
  let column = 1;
  for (const one of series) {
    places.push(column);
    column += one.low ? 3 : 1;
  }
  // what a series does not have at the x of another is no gap of it: undefined; its own null is
  const data = tables.length > 1 ? uPlot.join(tables, tables.map((t) => t.slice(1).map(() => 2))) : tables[0];
  return { data, places };
}

function options({ series, x, y, marks, shades, height, width, sync, joined, readout }) {
  const ink = colour("ink-quiet"), rule = colour("rule");
  const lines = [{}], bands = [];
  for (const [place, one] of series.entries()) {
    const tint = colour(one.role ?? "estimate");
    const points = one.kind === "points";
    lines.push({
      label: one.label, stroke: points ? undefined : tint, width: points ? 0 : one.width ?? 1.75, dash: one.kind === "dashed" ? [6, 4] : undefined,
      points: { show: points, size: 6, fill: tint, stroke: tint }, spanGaps: false,
    });
    if (!one.low) continue;
    const edge = { stroke: "transparent", width: 0, points: { show: false }, spanGaps: false };
    lines.push({ ...edge }, { ...edge });
    bands.push({ series: [joined.places[place] + 1, joined.places[place] + 2], fill: faint(tint) });
  }
  const axis = (given, side) => ({
    label: given.label, stroke: ink, font: "12px system-ui", labelFont: "12px system-ui", labelSize: 18, size: side ? 56 : given.time ? 44 : 30,
    grid: { stroke: rule, width: 1 }, ticks: { stroke: rule, width: 1, size: 4 },
    values: given.time ? undefined : (_, values) => values.map((value) => (value === null ? "" : short(value))),
  });
  return {
    width, height, tzDate: (seconds) => uPlot.tzDate(new Date(seconds * 1000), "Etc/UTC"),
    legend: { show: false }, series: lines, bands,
    scales: { x: { time: Boolean(x.time), range: x.range }, y: { range: y.range ?? spread(marks) } },
    axes: [axis(x, false), axis(y, true)],
    cursor: { drag: { x: true, y: false }, sync: sync ? { key: sync } : undefined, points: { size: 6 } },
    hooks: { drawClear: [(u) => shade(u, shades)], draw: [(u) => markLines(u, marks)], setCursor: [(u) => read(u, series, joined.places, x, readout)] },
  };
}

/** The range of y holds the marks too: a limit out of sight would look like none. */
function spread(marks) {
  const levels = marks.filter((mark) => mark.y !== undefined).map((mark) => mark.y);
  return (_, low, high) => {
    const from = Math.min(...levels, low ?? Infinity), to = Math.max(...levels, high ?? -Infinity);
    if (!Number.isFinite(from) || !Number.isFinite(to)) return [0, 1];
    const room = (to - from || Math.abs(to) || 1) * 0.06;
    return [from - room, to + room];
  };
}

const faint = (tint) => `color-mix(in srgb, ${tint} 20%, transparent)`;
const short = (value) => (Math.abs(value) >= 1000 ? number(value) : String(Number(value.toPrecision(6))).replace("-", "\u2212"));

function shade(u, shades) {
  u.ctx.fillStyle = colour("shade");
  for (const { from, to } of shades) {
    const left = u.valToPos(from, "x", true), right = u.valToPos(to, "x", true);
    u.ctx.fillRect(left, u.bbox.top, Math.max(1, right - left), u.bbox.height);
  }
}

function markLines(u, marks) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.font = `${11 * devicePixelRatio}px system-ui`;
  ctx.textAlign = "left"; // uPlot leaves that of its axes
  ctx.textBaseline = "alphabetic";
  ctx.lineWidth = 1.25 * devicePixelRatio;
  for (const mark of marks) {
    ctx.strokeStyle = ctx.fillStyle = colour(mark.role ?? "limit");
    ctx.setLineDash(mark.role === "event" ? [2 * devicePixelRatio, 3 * devicePixelRatio] : []);
    ctx.beginPath();
    const upright = mark.y === undefined;
    const at = upright ? u.valToPos(mark.x, "x", true) : u.valToPos(mark.y, "y", true);
    ctx.moveTo(upright ? at : bbox.left, upright ? bbox.top : at);
    ctx.lineTo(upright ? at : bbox.left + bbox.width, upright ? bbox.top + bbox.height : at);
    ctx.stroke();
    const gap = 4 * devicePixelRatio;
    if (mark.label) ctx.fillText(mark.label, upright ? at + gap : bbox.left + gap, upright ? bbox.top + 3 * gap : at - gap);
  }
  ctx.restore();
}

function read(u, series, places, x, readout) {
  const index = u.cursor.idx;
  if (index === null || index === undefined) return void (readout.textContent = "");
  const at = u.data[0][index];
  const parts = [x.time ? date(new Date(at * 1000).toISOString()) : `${short(at)} ${x.unit ?? ""}`.trim()];
  for (const [place, one] of series.entries()) {
    const value = u.data[places[place]][index];
    if (value === null || value === undefined || !one.label) continue;
    const low = one.low && u.data[places[place] + 2][index], high = one.low && u.data[places[place] + 1][index];
    const band = low === null || low === undefined ? "" : ` [${number(low, one.digits ?? 3)}, ${number(high, one.digits ?? 3)}]`;
    parts.push(`${one.label} ${number(value, one.digits ?? 3)}${band}`);
  }
  readout.textContent = parts.join("  \u00b7  ");
}

/** The numbers of a chart as a table, for who reads rather than looks; made when it is opened. */
function numbers(series, x) {
  const details = el("details", { class: "numbers" }, el("summary", {}, "Numbers"));
  details.addEventListener("toggle", () => {
    if (!details.open || details.querySelector("table")) return;
    for (const one of series.filter((item) => item.label)) details.append(numbersOf(one, x));
  });
  return details;
}

function numbersOf(one, x) {
  const digits = one.digits ?? 3;
  const rows = one.x.map((at, place) =>
    el(
      "tr", {},
      el("td", {}, x.time ? date(new Date(at * 1000).toISOString()) : short(at)), el("td", {}, number(one.y[place], digits)),
      one.low ? [el("td", {}, number(one.low[place], digits)), el("td", {}, number(one.high[place], digits))] : null,
    ));
  const band = one.low ? [el("th", { scope: "col" }, "low"), el("th", { scope: "col" }, "high")] : null;
  return el(
    "table", { class: "plain" }, el("caption", {}, one.label),
    el("thead", {}, el("tr", {}, el("th", { scope: "col" }, x.label ?? ""), el("th", { scope: "col" }, "value"), band)), el("tbody", {}, rows),
  );
}
