// Follows the feed of alerts by long poll: `changed(events)` is called as soon as something has happened.
import { get, withQuery } from "./client.js";

const WAIT_S = 20, POLL_MS = 5000;

/** Follow from now on until the signal is aborted; where the server is away, it is asked every few seconds. */
export async function follow(signal, changed) {
  let cursor = null;
  const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
  while (!signal.aborted) {
    try {
      if (cursor === null) cursor = (await get("/v1/alerts/feed?after=latest&limit=1", signal)).next_cursor;
      const page = await get(withQuery("/v1/alerts/feed", { after: cursor, limit: 100, wait_s: WAIT_S }), signal);
      cursor = page.next_cursor;
      if (page.items.length) changed(page.items);
    } catch (error) {
      if (signal.aborted) return;
      if (error.status === 409) cursor = null; // the database was restored: the lists are read again anyway
      await pause(POLL_MS);
    }
  }
}
