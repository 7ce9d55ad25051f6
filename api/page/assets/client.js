// The REST API as any client sees it: problems as errors, ETags, the key of the session, pages of lists.

const KEY = "treadwatch.key";
const PATIENCE_MS = 30000;

/** Dispatches `needkey` when the API wants a key, and `reached` or `lost` as the server answers or not. */
export const session = new EventTarget();

/** A refusal of the API (RFC 9457), or a server that did not answer (`status` 0). */
export class ApiError extends Error {
  constructor(status, problem) {
    super(problem.detail ?? problem.title ?? `The server answered ${status}`);
    this.status = status;
    this.type = problem.type ?? "";
    this.problem = problem;
  }
}

export const key = () => sessionStorage.getItem(KEY);

export function keepKey(value) {
  if (value) sessionStorage.setItem(KEY, value);
  else sessionStorage.removeItem(KEY);
}

/** Headers of a request of this session. */
export function headersOf(given = {}) {
  const headers = { Accept: "application/json", ...given };
  const held = key();
  if (held) headers.Authorization = `Bearer ${held}`;
  return headers;
}

async function problemOf(answer) {
  const text = await answer.text();
  try {
    return JSON.parse(text);
  } catch {
    return { title: `The server answered ${answer.status} ${answer.statusText}` };
  }
}

/** Send a request; return the answer, which is good. Paths only: this page asks no other origin. */
export async function send(path, { method = "GET", headers = {}, body, signal, patience = PATIENCE_MS } = {}) {
  if (!path.startsWith("/") || path.startsWith("//")) throw new TypeError(`not a path: ${path}`);
  const signals = [signal, patience ? AbortSignal.timeout(patience) : null].filter(Boolean);
  let answer;
  try {
    answer = await fetch(path, {
      method,
      headers: headersOf(body === undefined ? headers : { "Content-Type": "application/json", ...headers }),
      body: body === undefined ? undefined : JSON.stringify(body),
      signal: signals.length ? AbortSignal.any(signals) : undefined,
      credentials: "omit",
    });
  } catch (error) {
    if (signal?.aborted) throw error;
    session.dispatchEvent(new Event("lost"));
    throw new ApiError(0, { title: "The server does not answer." });
  }
  session.dispatchEvent(new Event("reached"));
  if (answer.ok) return answer;
  const refused = new ApiError(answer.status, await problemOf(answer));
  if (refused.status === 401) session.dispatchEvent(new CustomEvent("needkey", { detail: refused }));
  throw refused;
}

/** The JSON of one resource. */
export async function get(path, signal) {
  return (await send(path, { signal })).json();
}

/** The JSON of one resource; null where there is no such thing, or none yet. */
export async function getIfAny(path, signal) {
  try {
    return await get(path, signal);
  } catch (error) {
    if (error.status === 404) return null;
    throw error;
  }
}

/** The JSON of one resource with the ETag that changes to it ask for. */
export async function getWithTag(path, signal) {
  const answer = await send(path, { signal });
  return { body: await answer.json(), tag: answer.headers.get("ETag") };
}

/** All items of a list, page by page; at most `most`. */
export async function getAll(path, signal, most = 10000) {
  const items = [];
  for (let next = path; next !== null && items.length < most; ) {
    const page = await get(next, signal);
    items.push(...page.items);
    next = page.next;
  }
  return items;
}

/** Send a change: under the ETag as it was read where one is given, and a key that makes a repeat harmless. */
export async function post(path, body, { tag, once = crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}` } = {}) {
  const headers = { "Idempotency-Key": once };
  if (tag) headers["If-Match"] = tag;
  const answer = await send(path, { method: "POST", headers, body });
  return { body: await answer.json(), tag: answer.headers.get("ETag") };
}

/** Let the browser save a resource in another format; the request carries the key, so a link alone would not do. */
export async function download(path, name, accept = "text/csv") {
  const answer = await send(path, { headers: { Accept: accept } });
  const address = URL.createObjectURL(await answer.blob());
  const link = document.createElement("a");
  link.href = address;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}

/** A path with a query; empty values are left out. */
export function withQuery(path, values) {
  const query = new URLSearchParams(Object.entries(values).filter(([, value]) => value !== "" && value != null));
  return query.size ? `${path}?${query}` : path;
}

/** A key as one segment of a path. */
export const segment = (text) => encodeURIComponent(text);
