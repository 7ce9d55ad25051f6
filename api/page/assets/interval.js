// A small drawing of an estimate on a scale: its 95 % interval, its value, and the limit it is held against.
import { svg } from "./dom.js";
import { number } from "./format.js";

const WIDTH = 100, HEIGHT = 18, EDGE = 3;

/** The scale that a list shares, so that rows can be compared: from 0 to a round number beyond all limits. */
export function scaleOf(rows) {
  const limits = rows.map((row) => row.state.limit_1).filter((limit) => limit !== null);
  return Math.max(0.6, Math.ceil(Math.max(0, ...limits) * 1.5 * 10) / 10);
}

/** Draw an estimate, in red where `over` its limit; without a value only the scale and the limit are drawn. */
export function interval(found, limit, most, over) {
  const at = (value) => EDGE + (Math.min(Math.max(value, 0), most) / most) * (WIDTH - 2 * EDGE);
  const middle = HEIGHT / 2;
  const known = found.value !== null;
  const parts = [svg("line", { class: "axis", x1: EDGE, x2: WIDTH - EDGE, y1: middle, y2: middle })];
  if (known) {
    const [low, high] = found.interval_95;
    parts.push(
      svg("rect", { class: over ? "bar over" : "bar", x: at(low), width: Math.max(1, at(high) - at(low)), y: middle - 4, height: 8, rx: 1.5 }),
      svg("line", { class: over ? "value over" : "value", x1: at(found.value), x2: at(found.value), y1: middle - 5.5, y2: middle + 5.5 }),
    );
    if (high > most) parts.push(svg("path", { class: "beyond", d: `M${WIDTH - 4} ${middle - 4} l4 4 l-4 4` }));
  }
  if (limit !== null) parts.push(svg("line", { class: "limit", x1: at(limit), x2: at(limit), y1: 1, y2: HEIGHT - 1 }));
  const text = known
    ? `${number(found.value, 3)}, from ${number(found.interval_95[0], 3)} to ${number(found.interval_95[1], 3)}${limit === null ? "" : `, limit ${number(limit, 3)}`}`
    : "not estimated";
  return svg("svg", { class: "interval-drawing", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, width: WIDTH, height: HEIGHT, role: "img", "aria-label": text }, parts);
}
