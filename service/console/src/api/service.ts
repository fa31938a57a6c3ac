/** Requests to the service that this page came from. */

import { key } from "./key.svelte.ts";
import { retryPause, wait } from "../state/retries.svelte.ts";
import { problemOf, unreachable } from "./problem.ts";

/** Send a request, with the key if there is one; again after Retry-After. Throws RequestError unless it succeeds. */
export async function request(path: string, init: RequestInit = {}): Promise<Response> {
  for (let numTries = 1; ; numTries += 1) {
    const response = await sent(path, init);
    if (response.ok) return response;
    if (response.status === 401) key.refuse();
    const seconds = retryPause(response.status, response.headers.get("Retry-After"), numTries);
    if (seconds === null) throw problemOf(response.status, await response.text());
    await wait(seconds, init.signal);
  }
}

async function sent(path: string, init: RequestInit): Promise<Response> {
  try {
    return await fetch(relative(path), { ...init, headers: { ...key.headers(), ...init.headers } });
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw unreachable();
  }
}

export async function getJson<T>(path: string, signal?: AbortSignal): Promise<T> {
  return (await request(path, { signal: signal ?? null })).json() as Promise<T>;
}

export async function sendJson<T>(method: "PATCH" | "POST" | "PUT", path: string, body: unknown): Promise<T> {
  const init = { method, body: JSON.stringify(body), headers: { "Content-Type": "application/json" } };
  return (await request(path, init)).json() as Promise<T>;
}

export async function remove(path: string): Promise<void> {
  await request(path, { method: "DELETE" });
}

/** Return a picture or file. A URL in the page could not carry the key. */
export async function getBlob(path: string, signal?: AbortSignal): Promise<Blob> {
  return (await request(path, { signal: signal ?? null })).blob();
}

/** Return a path relative to the page, which may be served under a prefix, and says where the root of the service is. */
export function relative(path: string): string {
  return `${document.documentElement.dataset["root"] ?? "."}${path}`;
}
