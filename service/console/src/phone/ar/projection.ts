/** From points of a room to where a view of WebXR shows them, and back. */

import { inverse, motionOf, transform, type Vector, type View } from "../../../../../clients/js/src/index.ts";

/** left, top: shares of the view, from its corner. */
export interface Spot {
  left: number;
  top: number;
}

export interface Seen extends Spot {
  distance_m: number;
}

/** Return where a view shows a point of its session; null for one that is not in it. */
export function seenAt(point: Vector, { projectionMatrix: p, transform: pose }: View): Seen | null {
  const { x, y, z } = transform(inverse(motionOf(pose)), point);
  const clip = (row: number): number => p[row]! * x + p[row + 4]! * y + p[row + 8]! * z + p[row + 12]!; // column by column
  const [left, top] = [(1 + clip(0) / clip(3)) / 2, (1 - clip(1) / clip(3)) / 2];
  const isSeen = clip(3) > 0 && left >= 0 && left <= 1 && top >= 0 && top <= 1;
  return isSeen ? { left, top, distance_m: Math.hypot(x, y, z) } : null;
}

/** Return the point of the session that a view shows there, at a distance from the camera. */
export function pointAt({ left, top }: Spot, distance_m: number, { projectionMatrix: p, transform: pose }: View): Vector {
  const [x, y] = [(2 * left - 1 + p[8]!) / p[0]!, (1 - 2 * top + p[9]!) / p[5]!];
  const scale = distance_m / Math.hypot(x, y, 1);
  return transform(motionOf(pose), { x: x * scale, y: y * scale, z: -scale });
}

/** Return what `scanPoint` is the inverse of: a point of a map with y up, in the map's own frame with z up. */
export function ownPoint({ x, y, z }: Vector): Vector {
  return { x, y: -z, z: y };
}
