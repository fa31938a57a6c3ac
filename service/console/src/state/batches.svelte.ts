/** Batches that this browser began: their ids alone, because the service keeps the rest. */

import type { Batch } from "../api/types.ts";
import { type Upload, upload } from "../api/upload.ts";
import type { QueryTarget } from "./queries.svelte.ts";

export interface KnownBatch {
  id: string;
  begun: string;
  numImages: number;
  mapIds: string[];
}

const ENTRY = "panoloc-batches";
const MOST = 50;

let items = $state<KnownBatch[]>(read());

function read(): KnownBatch[] {
  try {
    const found: unknown = JSON.parse(localStorage.getItem(ENTRY) ?? "[]");
    return Array.isArray(found) ? (found as KnownBatch[]).filter((each) => typeof each.id === "string") : [];
  } catch {
    return [];
  }
}

function write(next: KnownBatch[]): void {
  items = next.slice(0, MOST);
  localStorage.setItem(ENTRY, JSON.stringify(items));
}

export const batches = {
  get items(): KnownBatch[] {
    return items;
  },
  begin(photos: File[], target: QueryTarget, onProgress: (share: number) => void): Upload<Batch> {
    const form = new FormData();
    const cameras = target.hfovDeg ? [{ model: "pinhole", hfov_deg: target.hfovDeg }] : undefined;
    form.append("options", JSON.stringify({ hints: target.hints ?? undefined, cameras }));
    if (target.tag) form.append("tag", target.tag);
    else for (const id of target.mapIds) form.append("map_id", id);
    const isArchive = photos.length === 1 && photos[0]!.name.toLowerCase().endsWith(".zip");
    for (const photo of photos) form.append(isArchive ? "archive" : "image", photo, photo.name);
    return upload<Batch>({ path: "/batches", form, onProgress });
  },
  note(batch: Batch): void {
    const known = { id: batch.id, begun: batch.created_at, numImages: batch.num_images, mapIds: batch.map_ids };
    write([known, ...items.filter((each) => each.id !== batch.id)]);
  },
  forget(id: string): void {
    write(items.filter((each) => each.id !== id));
  },
};
