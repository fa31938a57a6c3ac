/** One request to the service, sent again as long as that may help. */

import type { ProblemDocument } from "./types.ts";

/** What the service refused, as its problem document says; `status` 0 and `type` "unreachable" when nobody answered. */
export class PanolocError extends Error {
  override readonly name = "PanolocError";
  readonly status: number;
  /** Stable: `/problems/…` of the service explains it. */
  readonly type: string;
  readonly title: string;
  readonly detail: string;
  readonly requestId: string | null;
  /** Which fields of the request were refused, and why. */
  readonly fields: NonNullable<ProblemDocument["fields"]>;

  constructor(said: Partial<ProblemDocument> & { status: number; detail: string }) {
    super(said.detail);
    this.status = said.status;
    this.type = said.type ?? "about:blank";
    this.title = said.title ?? "The request failed";
    this.detail = said.detail;
    this.requestId = said.request_id ?? null;
    this.fields = said.fields ?? [];
  }
}

export interface Sending {
  signal?: AbortSignal | undefined;
  /** Called with the share of the bytes that have left, 0 to 1. Outside of browsers only with 1. */
  onProgress?: ((share: number) => void) | undefined;
  /** Of a POST: the same request with the same key is not done twice. Default: a new one. */
  idempotencyKey?: string | undefined;
}

export interface Access {
  url: string;
  key?: string | undefined;
  /** How often a request is sent again after 429, 503 or a lost connection. */
  retries: number;
}

const FIRST_PAUSE_S = 0.5;
const UNDER_WAY = "request-under-way";

/** Send a request and return its answer. Throws PanolocError, or the reason of the signal. */
export async function request(
  { url, key, retries }: Access,
  method: string,
  path: string,
  body?: FormData,
  { signal, onProgress, idempotencyKey }: Sending = {},
): Promise<Response> {
  const headers = new Headers({ Accept: "application/json" });
  if (key) headers.set("Authorization", `Bearer ${key}`);
  if (method === "POST") headers.set("Idempotency-Key", idempotencyKey ?? newKey());
  const init: RequestInit = { method, headers, body: body ?? null, signal: signal ?? null };
  for (let numTries = 1; ; numTries += 1) {
    const pause_s = FIRST_PAUSE_S * 2 ** (numTries - 1);
    signal?.throwIfAborted();
    try {
      const reply = await send(url + path, init, onProgress);
      if (reply.ok) return reply;
      const problem = await problemOf(reply);
      const mayPass = [429, 503].includes(reply.status) || (numTries > 1 && problem.type.endsWith(UNDER_WAY));
      if (!mayPass || numTries > retries) throw problem;
      await wait(Number(reply.headers.get("Retry-After") ?? pause_s) || pause_s, signal);
    } catch (error) {
      signal?.throwIfAborted();
      if (error instanceof PanolocError) throw error;
      // fetch says TypeError for whatever happens to a connection.
      if (numTries > retries) throw new PanolocError({ status: 0, type: "unreachable", detail: `No answer from ${url}: ${reasonOf(error)}` });
      await wait(pause_s, signal);
    }
  }
}

/** Wait, or throw the reason of the signal as soon as it is aborted. */
export function wait(seconds: number, signal?: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const stop = (): void => (clearTimeout(timer), reject(signal?.reason));
    const timer = setTimeout(() => (signal?.removeEventListener("abort", stop), resolve()), seconds * 1000);
    if (signal?.aborted) stop();
    signal?.addEventListener("abort", stop, { once: true });
  });
}

/** Node tells why a connection failed in the cause alone. */
function reasonOf(error: unknown): string {
  const cause = error instanceof Error ? error.cause : undefined;
  return cause instanceof Error ? `${String(error)} (${cause.message || String((cause as { code?: string }).code)})` : String(error);
}

// crypto.randomUUID exists on secure pages alone.
const newKey = (): string => Array.from(crypto.getRandomValues(new Uint32Array(4)), (word) => word.toString(36)).join("-");

async function problemOf(reply: Response): Promise<PanolocError> {
  const text = await reply.text();
  try {
    const said = JSON.parse(text) as Partial<ProblemDocument>;
    if (typeof said.detail === "string") return new PanolocError({ ...said, status: reply.status, detail: said.detail });
  } catch {
    // Not from panoloc: a proxy's page, for example.
  }
  return new PanolocError({ status: reply.status, detail: `The service answered with status ${reply.status}.` });
}

async function send(url: string, init: RequestInit, onProgress: Sending["onProgress"]): Promise<Response> {
  if (onProgress && typeof XMLHttpRequest !== "undefined") return sendWithProgress(url, init, onProgress);
  const reply = await fetch(url, init);
  onProgress?.(1);
  return reply;
}

/** Do what fetch does, which does not tell how much has left. */
function sendWithProgress(url: string, init: RequestInit, onProgress: (share: number) => void): Promise<Response> {
  const sending = new XMLHttpRequest();
  const stop = (): void => sending.abort();
  init.signal?.addEventListener("abort", stop, { once: true });
  return new Promise<Response>((resolve, reject) => {
    sending.open(init.method ?? "GET", url);
    sending.responseType = "blob";
    new Headers(init.headers).forEach((value, name) => sending.setRequestHeader(name, value));
    sending.upload.onprogress = ({ lengthComputable, loaded, total }) => lengthComputable && onProgress(loaded / total);
    sending.onerror = sending.onabort = () => reject(new TypeError("the connection was lost"));
    sending.onload = () => {
      const lines = sending.getAllResponseHeaders().trim().split(/[\r\n]+/).filter(Boolean);
      const headers = lines.map((line): [string, string] => [line.split(":", 1)[0] ?? "", line.slice(line.indexOf(":") + 1)]);
      resolve(new Response(sending.response as Blob, { status: sending.status, headers }));
    };
    if (init.signal?.aborted) stop();
    sending.send(init.body as FormData);
  }).finally(() => init.signal?.removeEventListener("abort", stop));
}
