/** Batches: begun here, and listed as the service keeps them. */

import { shown } from "../api/problem.ts";
import { getJson } from "../api/service.ts";
import type { Batch, BatchItem, BatchOverview, Problem } from "../api/types.ts";
import { type Upload, upload } from "../api/upload.ts";
import { poll } from "./polling.ts";
import type { QueryTarget } from "./queries.svelte.ts";
import { camerasOf } from "./view_angle.ts";

const PAUSE_MS = 3000;
const PAGE = 200;

let items = $state<BatchOverview[]>([]);
let isLoaded = $state(false);
let problem = $state<Problem | null>(null);

export const batches = {
  /** The newest first. */
  get items(): BatchOverview[] {
    return items;
  },
  get isLoaded(): boolean {
    return isLoaded;
  },
  get problem(): Problem | null {
    return problem;
  },
  /** name: "" for what the service calls it. answers: ids of those that the photos have already. */
  begin(photos: File[], target: QueryTarget, name: string, onProgress: (share: number) => void, answers?: string[]): Upload<Batch> {
    const form = new FormData();
    form.append("options", JSON.stringify({ name: name || undefined, answers, hints: target.hints ?? undefined, cameras: camerasOf(target.angle) }));
    if (target.tag) form.append("tag", target.tag);
    else for (const id of target.mapIds) form.append("map_id", id);
    const isArchive = photos.length === 1 && photos[0]!.name.toLowerCase().endsWith(".zip");
    for (const photo of photos) form.append(isArchive ? "archive" : "image", photo, photo.webkitRelativePath || photo.name);
    return upload<Batch>({ path: "/batches", form, onProgress });
  },
  load,
  watch(): () => void {
    return poll(async () => {
      await load();
      return true;
    }, PAUSE_MS);
  },
};

/** Return a batch with all of its photos. */
export async function readBatch(batchId: string): Promise<{ batch: Batch; items: BatchItem[] }> {
  const items: BatchItem[] = [];
  let batch: Batch;
  let cursor: string | null = null;
  do {
    batch = await getJson<Batch>(`/batches/${encodeURIComponent(batchId)}?limit=${PAGE}${cursor ? `&cursor=${cursor}` : ""}`);
    items.push(...batch.items);
    cursor = batch.next_cursor;
  } while (cursor);
  return { batch, items };
}

async function load(): Promise<void> {
  try {
    const found: BatchOverview[] = [];
    let cursor: string | null = null;
    do {
      const page: { items: BatchOverview[]; next_cursor: string | null } = await getJson(
        `/batches?limit=${PAGE}${cursor ? `&cursor=${encodeURIComponent(cursor)}` : ""}`,
      );
      found.push(...page.items);
      cursor = page.next_cursor;
    } while (cursor);
    [items, isLoaded, problem] = [found.reverse(), true, null];
  } catch (error) {
    problem = shown(error);
  }
}
