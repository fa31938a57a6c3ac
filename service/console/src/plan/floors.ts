/** Floors of a scan, and the part of its height that shows one of them from above. */

import type { MapStats } from "../api/types.ts";

/** Of a height that is shown: ceilings hide what is below them. */
export const SHOWN = 0.82;
/** Metres: floors are no planes. */
const BELOW_LEVEL_M = 0.3;

/** Heights, metres in the map's own frame. */
export interface Section {
  bottom: number;
  top: number;
}

/** Return the number of the floor that something at a height stands on; 0 where it is below all. */
export function floorAt({ floors = [] }: MapStats, height: number): number {
  return Math.max(floors.findLastIndex(({ level_m }) => level_m < height), 0);
}

/** Return from where to where a floor reaches; the whole scan where there are not several. */
export function storeyOf({ floors = [], bounds: { min, max } }: MapStats, number: number): Section {
  const floor = floors[number];
  if (floors.length < 2 || floor === undefined) return { bottom: min[2], top: max[2] };
  return { bottom: floor.level_m, top: floor.height_m === null ? (floors[number + 1]?.level_m ?? max[2]) : floor.level_m + floor.height_m };
}

/** Return the height on another floor, as high above that as a height is above its own, metres. */
export function heightOnFloor(stats: MapStats, height: number, number: number): number {
  return height - storeyOf(stats, floorAt(stats, height)).bottom + storeyOf(stats, number).bottom;
}

/** Return between which heights points are shown, so that a floor is seen from above. */
export function sectionOf(stats: MapStats, number: number): Section {
  const { bottom, top } = storeyOf(stats, number);
  return { bottom: number ? bottom - BELOW_LEVEL_M : -Infinity, top: bottom + SHOWN * (top - bottom) };
}

/** Return the name of each floor, with its level where there are several. */
export function floorNames({ floors = [] }: MapStats): string[] {
  return floors.map(({ level_m }, number) => `Floor ${number + 1} (${level_m.toFixed(1)} m)`);
}
