/** Uploads with progress, which `fetch` does not tell. */

import { key } from "./key.svelte.ts";
import { retryPause, wait } from "../state/retries.svelte.ts";
import { brokenOff, problemOf } from "./problem.ts";
import { relative } from "./service.ts";

export interface Upload<T> {
  readonly done: Promise<T>;
  cancel(): void;
}

export interface UploadRequest {
  method?: "POST" | "PUT";
  path: string;
  form: FormData;
  headers?: Record<string, string>;
  /** Called with the share of the bytes that have left, 0..1. */
  onProgress?: (share: number) => void;
}

/** Begin to send a form, again where the service puts it off. `done` rejects with RequestError, or with an AbortError once cancelled. */
export function upload<T>(wanted: UploadRequest): Upload<T> {
  const ended = new AbortController();
  const sendPatiently = async (): Promise<T> => {
    for (let numTries = 1; ; numTries += 1) {
      const reply = await send(wanted, ended.signal);
      if (reply.status >= 200 && reply.status < 300) return JSON.parse(reply.body) as T;
      if (reply.status === 401) key.refuse();
      const seconds = retryPause(reply.status, reply.retryAfter, numTries);
      if (seconds === null) throw problemOf(reply.status, reply.body);
      await wait(seconds, ended.signal);
    }
  };
  return { done: sendPatiently(), cancel: () => ended.abort() };
}

interface Reply {
  status: number;
  body: string;
  retryAfter: string | null;
}

function send({ method = "POST", path, form, headers = {}, onProgress }: UploadRequest, signal: AbortSignal): Promise<Reply> {
  const sending = new XMLHttpRequest();
  signal.addEventListener("abort", () => sending.abort(), { once: true });
  return new Promise((resolve, reject) => {
    sending.open(method, relative(path));
    for (const [name, value] of Object.entries({ ...key.headers(), ...headers })) sending.setRequestHeader(name, value);
    sending.upload.onprogress = (event) => event.lengthComputable && onProgress?.(event.loaded / event.total);
    sending.onabort = () => reject(new DOMException("The upload was cancelled.", "AbortError"));
    sending.onerror = () => reject(brokenOff());
    sending.onload = () => resolve({ status: sending.status, body: sending.responseText, retryAfter: sending.getResponseHeader("Retry-After") });
    sending.send(form);
  });
}
