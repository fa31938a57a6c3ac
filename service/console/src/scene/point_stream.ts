/** Reads the stream of a map's points: a binary PLY whose points come in random order, so that what has arrived shows the whole scan. */

import { request } from "../api/service.ts";
import type { Vector3 } from "../api/types.ts";
import { PointDecoder, type PointStreamEvents } from "./point_decoder.ts";

/** Read the points of a map into arrays that fill while they come. */
export async function readPoints(
  mapId: string,
  maxPoints: number,
  origin: Vector3,
  events: PointStreamEvents,
  signal: AbortSignal,
): Promise<void> {
  const response = await request(`/maps/${encodeURIComponent(mapId)}/points?format=ply&max_points=${maxPoints}`, { signal });
  const reader = response.body!.getReader();
  const decoder = new PointDecoder(origin, events);
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    decoder.take(value);
  }
}
