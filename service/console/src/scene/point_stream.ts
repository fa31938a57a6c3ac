/** Reads the stream of a map's points: a binary PLY whose points come in random order, so that what has arrived shows the whole scan. */

import { request } from "../api/service.ts";
import type { Vector3 } from "../api/types.ts";
import { width } from "../state/width.svelte.ts";
import { type PointChunk, PointDecoder } from "./point_decoder.ts";

/** What `GET /maps/{id}/points` has at most, and what phones take. */
const [MOST_POINTS, MOST_PHONE_POINTS] = [10_000_000, 1_500_000];

export function mostScenePoints(): number {
  return width.isNarrow ? MOST_PHONE_POINTS : MOST_POINTS;
}

export interface PointStreamEvents {
  /** Called once, with the points of the whole stream. */
  onBegin(numPoints: number): void;
  /** Called for each chunk; the next one is not read before this has ended, so that drawing keeps its time. */
  onChunk(chunk: PointChunk): Promise<void> | void;
}

const expected = new Map<string, Promise<Response>>();

/**
 * Ask for the points of a map that will be read in a moment, while what the map is is still being asked for.
 * Return what gives them up again, where nobody has begun to read them.
 */
export function expectPoints(mapId: string, maxPoints: number): () => void {
  const path = pathOf(mapId, maxPoints);
  const ended = new AbortController();
  const coming = request(path, { signal: ended.signal });
  coming.catch(() => undefined);
  expected.set(path, coming);
  return () => {
    if (expected.get(path) !== coming) return;
    expected.delete(path);
    ended.abort();
  };
}

/** Read the points of a map, chunk by chunk. */
export async function readPoints(mapId: string, maxPoints: number, origin: Vector3, events: PointStreamEvents, signal: AbortSignal): Promise<void> {
  const path = pathOf(mapId, maxPoints);
  const early = expected.get(path);
  expected.delete(path);
  const anew = (): Promise<Response> => request(path, { signal });
  // Asked for too early, before the map was ready: then once more.
  const reader = (await (early?.catch(anew) ?? anew())).body!.getReader();
  signal.addEventListener("abort", () => void reader.cancel().catch(() => undefined));
  const decoder = new PointDecoder(origin);
  let isBegun = false;
  for (;;) {
    const { done, value } = await reader.read();
    if (signal.aborted) return;
    const chunks = value ? decoder.take(value) : [];
    if (!isBegun && decoder.numPoints !== null) {
      isBegun = true;
      events.onBegin(decoder.numPoints);
    }
    for (const chunk of chunks) await events.onChunk(chunk);
    if (done) return;
  }
}

function pathOf(mapId: string, maxPoints: number): string {
  return `/maps/${encodeURIComponent(mapId)}/points?format=ply&max_points=${maxPoints}`;
}
