/** All photos that were placed in a map: those of this tab, and those of the batches that the service keeps. */

import type { Answer, Batch, Place } from "../api/types.ts";
import { batches, readBatch } from "./batches.svelte.ts";
import { naturally } from "./natural_order.ts";
import { posesIn } from "./poses.ts";
import { queries, type Query } from "./queries.svelte.ts";
import { isSureEnough } from "./words.ts";

export interface PlacedPhoto {
  name: string;
  answer: Answer;
  /** Of this tab; null for one of a batch. */
  query: Query | null;
  batch: { id: string; name: string; number: number } | null;
}

export interface PhotoFilter {
  /** "" for all, "tab" for those of this tab, else the id of a batch. */
  from: string;
  /** "" for all. */
  status: "" | "localized" | "ambiguous" | "not_localized";
  leastConfidence: number;
}

export const ALL: PhotoFilter = { from: "", status: "", leastConfidence: 0 };
const entryOf = (mapId: string): string => `panoloc-filter-${mapId}`;

/** Return the filter of a map as it was before the page was loaded. */
export function keptFilter(mapId: string): PhotoFilter {
  return { ...ALL, ...(JSON.parse(sessionStorage.getItem(entryOf(mapId)) ?? "{}") as Partial<PhotoFilter>) };
}

export function keepFilter(mapId: string, filter: PhotoFilter): void {
  sessionStorage.setItem(entryOf(mapId), JSON.stringify(filter));
}

export function passes({ answer, batch }: PlacedPhoto, filter: PhotoFilter): boolean {
  const isFrom = filter.from === "" || filter.from === (batch?.id ?? "tab");
  return isFrom && (filter.status === "" || answer.status === filter.status) && isSureEnough(answer, filter.leastConfidence);
}

export class PlacedPhotos {
  private read = $state.raw<Record<string, { batch: Batch; photos: PlacedPhoto[] }>>({});
  private readonly mapId: string;

  constructor(mapId: string) {
    this.mapId = mapId;
  }

  /** In natural order, those of this tab first. */
  get items(): PlacedPhoto[] {
    const own = queries.ofMap(this.mapId).flatMap((query) => (query.answer ? [{ name: query.photo.name, answer: query.answer, query, batch: null }] : []));
    return [...own, ...Object.values(this.read).flatMap(({ photos }) => photos)].filter(({ answer }) => posesIn(answer, this.mapId).length > 0);
  }

  get batches(): Batch[] {
    return Object.values(this.read).filter(({ photos }) => photos.length > 0).map(({ batch }) => batch);
  }

  /** Read the batches that may have photos in the map, again as long as they are not done. */
  async refresh(place: Place): Promise<void> {
    await batches.load();
    const mayBeHere = batches.items.filter(({ map_ids, tag }) => (tag ? place.tags.includes(tag) : !map_ids.length || map_ids.includes(place.id)));
    const known = this.read;
    const found = await Promise.all(
      mayBeHere.map(async ({ id }) => {
        if (known[id]?.batch.status === "done") return [id, known[id]] as const;
        const { batch, items } = await readBatch(id);
        const photos = naturally(items).flatMap(({ name, number, answer }) => (answer && answer.map_id === this.mapId ? [{ name, answer, query: null, batch: { id, name: batch.name, number } }] : []));
        return [id, { batch, photos }] as const;
      }),
    );
    this.read = Object.fromEntries(found);
  }
}
