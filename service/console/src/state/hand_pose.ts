/** What a person says of a photo that he places: a pose that he drags and turns, or pairs of points. */

import type { Vector3 } from "../api/types.ts";
import { levelRotation, type Place3, quaternionOf, times } from "../scene/frames.ts";

/** Pixels of the photo as it is seen, from its upper left corner, in its full size. */
export type Pixel = [number, number];

export interface Pair {
  pixel: Pixel;
  position: Vector3;
}

/** Degrees: where the middle of the image looks, counter-clockwise from the map's x axis, and how far up; and how far the right side is down. */
export interface RoughPose {
  position: Vector3;
  yawDeg: number;
  upDeg: number;
  leanDeg: number;
}

export const FEWEST_PAIRS = 3;
const [EYE_M, SHARE_OF_HEIGHT] = [1.5, 0.6];

const RAD = Math.PI / 180;

export function roughPlace({ position, yawDeg, upDeg, leanDeg }: RoughPose, origin: Vector3 = [0, 0, 0]): Place3 {
  const [c, s] = [Math.cos(leanDeg * RAD), Math.sin(leanDeg * RAD)];
  const rotation = times(levelRotation(yawDeg * RAD, upDeg * RAD), [[1, 0, 0], [0, c, -s], [0, s, c]]);
  return { position: position.map((value, axis) => value - origin[axis]!) as Vector3, rotation };
}

/** Return the body of a request that places a photo. */
export function handBody(mapId: string, said: RoughPose | readonly Pair[]): Record<string, unknown> {
  if (!("yawDeg" in said)) return { map_id: mapId, pairs: said.map(({ pixel, position }) => ({ pixel, position_m: position })) };
  const { position, rotation } = roughPlace(said);
  const [x, y, z, w] = quaternionOf(rotation);
  const map_from_camera = { position_m: { x: position[0], y: position[1], z: position[2] }, quaternion: { x, y, z, w } };
  return { map_id: mapId, pose: { frame: "ros", map_from_camera } };
}

/** Return a likely height of a camera: that of the other photos, else of eyes above the floor, within the scan. */
export function likelyHeight(others: readonly number[], bottom: number, top: number): number {
  if (others.length) return [...others].sort((a, b) => a - b)[Math.floor(others.length / 2)]!;
  return bottom + Math.min(EYE_M, SHARE_OF_HEIGHT * (top - bottom));
}
