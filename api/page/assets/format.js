// Numbers, dates and estimates as they are shown: with their interval, or with the reason why there is none.
import { el } from "./dom.js";

const DAY = 86400000;
/** Data older than this are marked as old, in days. */
export const OLD_AFTER_DAYS = 7;

const plain = new Map();
/** A number with fixed decimals and thousands apart; an unknown one is never drawn as a number. */
export function number(value, digits = 0) {
  if (value === null || value === undefined) return "unknown";
  if (!plain.has(digits)) {
    plain.set(digits, new Intl.NumberFormat("en-GB", { minimumFractionDigits: digits, maximumFractionDigits: digits }));
  }
  return plain.get(digits).format(value).replace("-", "\u2212");
}

export const km = (value) => (value === null || value === undefined ? "unknown" : `${number(value)} km`);

/** Kilometres rounded to what a forecast can claim: three digits. */
export function roundKm(value) {
  if (value === null || value === undefined) return "unknown";
  const step = 10 ** Math.max(0, Math.floor(Math.log10(Math.max(1, Math.abs(value)))) - 2);
  return number(Math.round(value / step) * step);
}

/** `2026-11-23` */
export const date = (time) => (time ? time.slice(0, 10) : "unknown");

/** `2026-11-23 03:01 UTC` */
export const moment = (time) => (time ? `${time.slice(0, 10)} ${time.slice(11, 16)} UTC` : "unknown");

/** How long ago, in one unit. */
export function age(time, now = Date.now()) {
  if (!time) return "never";
  const passed = now - Date.parse(time);
  if (passed < 0) return passed > -60000 ? "now" : `in ${span(-passed)}`;
  return passed < 60000 ? "now" : `${span(passed)} ago`;
}

/** A length of time in one unit. */
export function span(ms) {
  if (ms < 60000) return `${Math.round(ms / 1000)} s`;
  if (ms < 3600000) return `${Math.round(ms / 60000)} min`;
  if (ms < 2 * DAY) return `${Math.round(ms / 3600000)} h`;
  if (ms < 730 * DAY) return `${Math.round(ms / DAY)} d`;
  return `${(ms / DAY / 365.25).toFixed(1)} years`;
}

/** A time with its age; marked where the data are old. */
export function lastData(time) {
  if (!time) return el("span", { class: "unknown" }, "no data yet");
  const old = Date.now() - Date.parse(time) > OLD_AFTER_DAYS * DAY;
  return el(
    "time",
    { datetime: time, class: old ? "old" : null, title: moment(time) },
    age(time),
    old ? el("span", { class: "badge old" }, "old") : null,
  );
}

/** A time of which the exact moment is in the tooltip. */
export const ago = (time) => el("time", { datetime: time, title: moment(time) }, age(time));

/** An estimate: value and 95 % interval, or what is missing and why. */
export function estimate(found, digits = 3, unit = "") {
  if (!found || found.value === null) {
    const why = found?.reason ?? "not estimated yet";
    return el("span", { class: "unknown", title: why }, found?.status === "invalid" ? "invalid" : "not estimated");
  }
  const [low, high] = found.interval_95;
  return el(
    "span",
    { class: "estimate", title: `std ${number(found.std, digits + 1)}, from ${number(found.n_windows, 1)} windows` },
    el("b", {}, number(found.value, digits), unit),
    el("span", { class: "interval" }, `[${number(low, digits)}, ${number(high, digits)}]`),
    found.status === "estimated" ? null : el("span", { class: "badge warning", title: found.reason }, found.status),
  );
}

/** A code as words. */
export const words = (code) => String(code ?? "").replaceAll("_", " ");
