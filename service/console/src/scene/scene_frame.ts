/** The origin of the renderer's world: near the scan, so that 32 bits suffice however far away the map's own origin is. */

import type { MapStats, Vector3 } from "../api/types.ts";

export function sceneOrigin(stats: MapStats): Vector3 {
  const { min, max } = stats.bounds;
  return min.map((low, axis) => Math.round((low + max[axis]!) / 2)) as Vector3;
}

export function sceneBounds(stats: MapStats, origin: Vector3): { min: Vector3; max: Vector3 } {
  const moved = (corner: Vector3): Vector3 => corner.map((value, axis) => value - origin[axis]!) as Vector3;
  return { min: moved(stats.bounds.min), max: moved(stats.bounds.max) };
}
