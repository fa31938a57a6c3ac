/** The list of maps, looked at again while any of them is being built. */

import { shown } from "../api/problem.ts";
import { getJson } from "../api/service.ts";
import type { Place, Problem } from "../api/types.ts";
import { poll } from "./polling.ts";

const PAUSE_MS = 1200;
const IDLE_PAUSES = 5;
const PAGE = 200;

let items = $state<Place[]>([]);
let isLoaded = $state(false);
let problem = $state<Problem | null>(null);

export const maps = {
  get items(): Place[] {
    return items;
  },
  get isLoaded(): boolean {
    return isLoaded;
  },
  get problem(): Problem | null {
    return problem;
  },
  get tags(): string[] {
    return [...new Set(items.flatMap((place) => place.tags))].sort();
  },
  named(id: string): string {
    return items.find((place) => place.id === id)?.name ?? id;
  },
  /** Put a map into the list that was just made or changed. */
  put(place: Place): void {
    items = items.some((each) => each.id === place.id) ? items.map((each) => (each.id === place.id ? place : each)) : [place, ...items];
  },
  drop(id: string): void {
    items = items.filter((each) => each.id !== id);
  },
  load,
  watch(): () => void {
    let skipped = 0;
    return poll(async () => {
      const isBuilding = items.some((place) => place.status !== "ready" && place.status !== "failed");
      skipped += 1;
      if (!isLoaded || isBuilding || skipped > IDLE_PAUSES) {
        skipped = 0;
        await load();
      }
      return true;
    }, PAUSE_MS);
  },
};

async function load(): Promise<void> {
  try {
    const found: Place[] = [];
    let cursor: string | null = null;
    do {
      const page: { items: Place[]; next_cursor: string | null } = await getJson(
        `/maps?limit=${PAGE}${cursor ? `&cursor=${encodeURIComponent(cursor)}` : ""}`,
      );
      found.push(...page.items);
      cursor = page.next_cursor;
    } while (cursor);
    items = found.reverse();
    problem = null;
    isLoaded = true;
  } catch (error) {
    problem = shown(error);
  }
}
