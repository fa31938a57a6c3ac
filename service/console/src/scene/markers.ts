/** Cameras in the scene: where each stood, which way it looked, and which of them is under the pointer. */

import { type Camera, Vector3 as V3 } from "three";

import type { Place3 } from "./frames.ts";

export interface Marker {
  place: Place3;
  /** A number that whoever made the marker knows it by. */
  index: number;
  isChosen: boolean;
  isUnsure: boolean;
}

/** Radius as a share of half the view's height, so that a marker can be hit from afar. */
export const MARKER_SIZE = 0.018;
/** Metres; a marker nearer than this is where the viewer stands. */
export const NEAREST_M = 0.25;

/** Return the marker under a point of the screen (-1..1 both ways), null where there is none. */
export function markerAt(markers: Marker[], pointer: [number, number], camera: Camera, aspect: number): Marker | null {
  let [nearest, best]: [Marker | null, number] = [null, 0.045];
  for (const marker of markers) {
    const seen = new V3(...marker.place.position);
    if (camera.position.distanceTo(seen) < NEAREST_M) continue;
    seen.project(camera);
    const distance = Math.hypot((seen.x - pointer[0]) * aspect, seen.y - pointer[1]);
    if (seen.z < 1 && distance < best) [nearest, best] = [marker, distance];
  }
  return nearest;
}
