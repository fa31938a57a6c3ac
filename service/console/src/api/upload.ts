/** Uploads with progress, which `fetch` does not tell. */

import { key } from "./key.svelte.ts";
import { problemOf, unreachable } from "./problem.ts";
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

/** Begin to send a form. `done` rejects with RequestError, or with an AbortError once cancelled. */
export function upload<T>({ method = "POST", path, form, headers = {}, onProgress }: UploadRequest): Upload<T> {
  const sending = new XMLHttpRequest();
  const done = new Promise<T>((resolve, reject) => {
    sending.open(method, relative(path));
    for (const [name, value] of Object.entries({ ...key.headers(), ...headers })) sending.setRequestHeader(name, value);
    sending.upload.onprogress = (event) => event.lengthComputable && onProgress?.(event.loaded / event.total);
    sending.onabort = () => reject(new DOMException("The upload was cancelled.", "AbortError"));
    sending.onerror = () => reject(unreachable());
    sending.onload = () => {
      if (sending.status >= 200 && sending.status < 300) {
        resolve(JSON.parse(sending.responseText) as T);
        return;
      }
      if (sending.status === 401) key.ask();
      reject(problemOf(sending.status, sending.responseText));
    };
    sending.send(form);
  });
  return { done, cancel: () => sending.abort() };
}
