/** Photos of this tab and the ids of their answers, in the browser's storage: a reload of the page keeps them. */

import type { QueryTarget } from "./queries.svelte.ts";

export interface KeptPhoto {
  key: number;
  /** Another tab has photos of its own. */
  tab: string;
  /** Unix time in milliseconds. */
  at: number;
  photo: File;
  target: QueryTarget;
  answerId: string;
}

const STORE = "photos";
const TAB_ENTRY = "panoloc-tab";
/** What a tab that was closed has left is removed after so long. */
const LIFETIME_MS = 24 * 3600 * 1000;

export const tab = (sessionStorage[TAB_ENTRY] ??= crypto.getRandomValues(new Uint32Array(2)).join("-")) as string;

function opened(): Promise<IDBDatabase> {
  const opening = indexedDB.open("panoloc", 1);
  opening.onupgradeneeded = () => opening.result.createObjectStore(STORE, { keyPath: "key" });
  return done(opening);
}

function done<T>(request: IDBRequest<T>): Promise<T> {
  return new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

async function store<T>(mode: IDBTransactionMode, act: (photos: IDBObjectStore) => IDBRequest<T>): Promise<T | null> {
  try {
    const database = await opened();
    const transaction = database.transaction(STORE, mode);
    const ended = new Promise((resolve) => (transaction.oncomplete = transaction.onabort = resolve));
    const result = await done(act(transaction.objectStore(STORE)));
    // Until it has ended, a reload of the page takes back what was written.
    await ended;
    database.close();
    return result;
  } catch {
    // A browser that keeps nothing, as in some private windows: a reload then loses the photos, as it says.
    return null;
  }
}

export async function keepPhoto(kept: KeptPhoto): Promise<void> {
  await store("readwrite", (photos) => photos.put(kept));
}

export async function dropPhoto(key: number): Promise<void> {
  await store("readwrite", (photos) => photos.delete(key));
}

/** Return the photos of this tab, the oldest first. */
export async function keptPhotos(): Promise<KeptPhoto[]> {
  const all = (await store<KeptPhoto[]>("readonly", (photos) => photos.getAll() as IDBRequest<KeptPhoto[]>)) ?? [];
  for (const old of all.filter((each) => each.at < Date.now() - LIFETIME_MS)) await dropPhoto(old.key);
  return all.filter((each) => each.tab === tab && each.at >= Date.now() - LIFETIME_MS).sort((a, b) => a.at - b.at);
}
