/** Cameras and points in the scene: where each is, which way a camera looked, and which of them is under the pointer. */

import { type Camera, Vector3 as V3 } from "three";

import type { Vector3 } from "../api/types.ts";
import type { Rotation } from "./frames.ts";

export interface Marker {
  /** rotation: null for a point, which looks nowhere. */
  place: { position: Vector3; rotation: Rotation | null };
  /** A number that whoever made the marker knows it by. */
  index: number;
  isChosen: boolean;
  isUnsure: boolean;
  /** Within which the camera stood with a probability of 68 %, metres; null where that is not known. */
  radius: number | null;
  label?: string;
}

/** Return the place of a point of the map, metres in its own frame. */
export function pointPlace(at: Vector3, origin: Vector3): Marker["place"] {
  return { position: at.map((value, axis) => value - origin[axis]!) as Vector3, rotation: null };
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

const RING_CORNERS = 40;
/** Pixels: smaller rings lie below the marker itself. */
const SMALLEST_RING = 8;

/** Return the level circle around a camera within which it stood with a probability of 68 %. */
export function ringOf({ place: { position: [x, y, z] }, radius }: Marker): Vector3[] {
  return Array.from({ length: RING_CORNERS + 1 }, (_, corner) => {
    const turn = (2 * Math.PI * corner) / RING_CORNERS;
    return [x + (radius ?? 0) * Math.cos(turn), y + (radius ?? 0) * Math.sin(turn), z];
  });
}

/** Tell whether the ring of a camera is larger on the screen than its marker. project: to pixels. */
export function isRingSeen(marker: Marker, project: (at: Vector3) => [number, number] | null): boolean {
  const { place: { position: [x, y, z] }, radius } = marker;
  if (radius === null) return false;
  const [middle, east, north] = [project([x, y, z]), project([x + radius, y, z]), project([x, y + radius, z])];
  if (middle === null || east === null || north === null) return false;
  return Math.max(Math.hypot(east[0] - middle[0], east[1] - middle[1]), Math.hypot(north[0] - middle[0], north[1] - middle[1])) > SMALLEST_RING;
}
