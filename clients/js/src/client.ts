/** The calls of the HTTP API that applications make. */

import { request, wait, type Access, type Sending } from "./requests.ts";
import type { Batch, BatchOptions, LocalizeOptions, Localization, MapOptions, ScanMap } from "./types.ts";

/** Where to search: maps by their ids, or all maps with a tag. */
export interface Place {
  maps?: string | readonly string[] | undefined;
  tag?: string | undefined;
}

export interface Query extends Place {
  /** Non-zero pixels are ignored: one for all images, or one per image. */
  masks?: readonly Blob[] | undefined;
  options?: LocalizeOptions | undefined;
}

const FIRST_POLL_S = 0.2;
const LONGEST_POLL_S = 2;

/** A running service. All calls throw PanolocError, or the reason of their signal once that is aborted. */
export class Panoloc {
  readonly maps: Maps;
  readonly batches: Batches;
  readonly #access: Access;

  /** key: of the service, if it asks for one. */
  constructor(url: string, { key, retries = 4 }: { key?: string | undefined; retries?: number } = {}) {
    if (key && !/^[!-~]+$/.test(key)) throw new TypeError("expected a key of ASCII letters, digits and punctuation, got other characters in it");
    this.#access = { url: addressOf(url), key, retries };
    this.maps = new Maps(this.#access);
    this.batches = new Batches(this.#access);
  }

  /** Find where an image, or several of one session, were taken. `status` of the answer says whether there is a pose. */
  async localize(images: Blob | readonly Blob[], { masks = [], options, ...place }: Query = {}, sending?: Sending): Promise<Localization> {
    const form = formOf(images, place, options);
    for (const mask of masks) form.append("mask", mask);
    return (await request(this.#access, "POST", "/localize", form, sending)).json() as Promise<Localization>;
  }

  /** Delete an answer and its pictures. */
  async deleteLocalization(id: string, sending?: Sending): Promise<void> {
    await request(this.#access, "DELETE", `/localizations/${part(id)}`, undefined, sending);
  }

  /** Return what an answer links to, such as `answer.artifacts.overlay`. */
  async download(path: string, sending?: Sending): Promise<Blob> {
    return (await request(this.#access, "GET", path, undefined, sending)).blob();
  }
}

class Maps {
  readonly #access: Access;

  constructor(access: Access) {
    this.#access = access;
  }

  /** Upload a scan. The map answers queries once it is `ready`. name: of the file, whose ending says what it is. */
  async register(scan: Blob, name: string, options?: MapOptions, sending?: Sending): Promise<ScanMap> {
    const form = new FormData();
    form.append("file", scan, name);
    if (options) form.append("options", jsonOf(options));
    return (await request(this.#access, "POST", "/maps", form, sending)).json() as Promise<ScanMap>;
  }

  async get(id: string, sending?: Sending): Promise<ScanMap> {
    return (await request(this.#access, "GET", `/maps/${part(id)}`, undefined, sending)).json() as Promise<ScanMap>;
  }

  /** Return the map once its newest scan is `ready` or `failed`. A failed one with a `serving_revision` answers queries in that. */
  wait(id: string, onUpdate?: (map: ScanMap) => void, sending?: Sending): Promise<ScanMap> {
    return poll(() => this.get(id, sending), ({ status }) => status === "ready" || status === "failed", onUpdate, sending?.signal);
  }

  /** Yield all maps, or those with a tag. */
  async *list(tag?: string, sending?: Sending): AsyncGenerator<ScanMap> {
    const query = new URLSearchParams(tag ? { tag } : {});
    for (;;) {
      const reply = await request(this.#access, "GET", `/maps?${query}`, undefined, sending);
      const { items, next_cursor } = (await reply.json()) as { items: ScanMap[]; next_cursor: string | null };
      yield* items;
      if (!next_cursor) return;
      query.set("cursor", next_cursor);
    }
  }

  async delete(id: string, sending?: Sending): Promise<void> {
    await request(this.#access, "DELETE", `/maps/${part(id)}`, undefined, sending);
  }
}

class Batches {
  readonly #access: Access;

  constructor(access: Access) {
    this.#access = access;
  }

  /** Place many photos, each by itself; they keep their names. */
  async create(photos: readonly File[], place: Place, options?: BatchOptions, sending?: Sending): Promise<Batch> {
    return (await request(this.#access, "POST", "/batches", formOf(photos, place, options), sending)).json() as Promise<Batch>;
  }

  /** Return a batch with one page of its items. */
  async get(id: string, cursor?: string, sending?: Sending): Promise<Batch> {
    const query = new URLSearchParams(cursor ? { cursor } : {});
    return (await request(this.#access, "GET", `/batches/${part(id)}?${query}`, undefined, sending)).json() as Promise<Batch>;
  }

  /** Return the batch once it is `done`. */
  wait(id: string, onUpdate?: (batch: Batch) => void, sending?: Sending): Promise<Batch> {
    return poll(() => this.get(id, undefined, sending), ({ status }) => status === "done", onUpdate, sending?.signal);
  }

  /** Return a zip with the photos placed so far. format: such as `colmap` or `potree`. */
  async export(id: string, format: string, more: Record<string, string> = {}, sending?: Sending): Promise<Blob> {
    const query = new URLSearchParams({ format, ...more });
    return (await request(this.#access, "GET", `/batches/${part(id)}/export?${query}`, undefined, sending)).blob();
  }

  async delete(id: string, sending?: Sending): Promise<void> {
    await request(this.#access, "DELETE", `/batches/${part(id)}`, undefined, sending);
  }
}

/** Return an address without slashes at its end; in browsers it may be relative to that of the page. */
function addressOf(url: string): string {
  const page = (globalThis as { location?: { href: string } }).location?.href;
  const address = URL.canParse(url, page) ? new URL(url, page) : null;
  if (!address?.protocol.startsWith("http")) throw new TypeError(`expected the address of a service, such as http://127.0.0.1:8000, got ${JSON.stringify(url)}`);
  return (address.origin + address.pathname).replace(/\/+$/, "");
}

/** Return an id as part of a path. */
function part(id: string): string {
  if (!id) throw new TypeError("expected an id, got none");
  return encodeURIComponent(id);
}

function formOf(images: Blob | readonly Blob[], { maps = [], tag }: Place, options: object | undefined): FormData {
  const form = new FormData();
  for (const image of images instanceof Blob ? [images] : images) {
    if (!(image instanceof Blob)) throw new TypeError("expected images as Blobs (in Node: openAsBlob of node:fs), got something else");
    form.append("image", image);
  }
  for (const id of typeof maps === "string" ? [maps] : maps) form.append("map_id", id);
  if (tag) form.append("tag", tag);
  if (options) form.append("options", jsonOf(options));
  return form;
}

/** JSON has no word for NaN and infinity, for which `JSON.stringify` writes null: a hint that is broken would be none. */
function jsonOf(options: object): string {
  return JSON.stringify(options, (name, value: unknown) => {
    if (typeof value !== "number" || Number.isFinite(value)) return value;
    throw new TypeError(`expected finite numbers in options, got ${value} as ${name}`);
  });
}

async function poll<T>(get: () => Promise<T>, isOver: (found: T) => boolean, onUpdate?: (found: T) => void, signal?: AbortSignal): Promise<T> {
  for (let pause_s = FIRST_POLL_S; ; pause_s = Math.min(1.5 * pause_s, LONGEST_POLL_S)) {
    const found = await get();
    onUpdate?.(found);
    if (isOver(found)) return found;
    await wait(pause_s, signal);
  }
}
