/** Reads the stream of a map's points: a binary PLY whose points come in random order, so that what has arrived shows the whole scan. */

import { request } from "../api/service.ts";
import type { Vector3 } from "../api/types.ts";
import { PointDecoder, type PointStreamEvents } from "./point_decoder.ts";

const PAUSE_MS = 120;

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
  let [arrived, said] = [0, 0];
  const decoder = new PointDecoder(origin, { onBegin: events.onBegin, onPoints: (count) => (arrived = count) });
  for (;;) {
    const { done, value } = await reader.read();
    if (value) decoder.take(value);
    // Each time they are said to have come they are drawn: not for every block of the network.
    if (done || performance.now() - said > PAUSE_MS) {
      events.onPoints(arrived);
      said = performance.now();
    }
    if (done) return;
  }
}
