// Follows the feed of alerts by long poll: `changed(events)` is called as soon as something has happened.
import { get, withQuery } from "./client.js";

const WAIT_S = 20, POLL_MS = 5000;

/** Follow from now on until the signal is aborted; an older service, without long poll, is asked every few seconds. */
export async function follow(signal, changed) {
  let cursor = null, waits = true;
  const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
  while (!signal.aborted) {
    try {
      if (cursor === null) cursor = await newest(signal);
      const began = Date.now();
      const page = await get(withQuery("/v1/alerts/feed", { after: cursor, limit: 100, wait_s: waits ? WAIT_S : "" }), signal);
      cursor = page.next_cursor;
      if (page.items.length) changed(page.items);
      else if (Date.now() - began < 1000) await pause(POLL_MS);
    } catch (error) {
      if (signal.aborted) return;
      if (error.status === 422 && waits) waits = false;
      else if (error.status === 409) cursor = null;
      else await pause(POLL_MS);
    }
  }
}

/** The cursor behind everything that has happened; what has is in the lists that are shown. */
async function newest(signal) {
  for (let cursor = ""; ; ) {
    const page = await get(withQuery("/v1/alerts/feed", { after: cursor, limit: 1000 }), signal);
    cursor = page.next_cursor;
    if (page.items.length < 1000) return cursor;
  }
}
