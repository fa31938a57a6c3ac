/** Where the other photos of a tour lie, seen from one of them. */

import type { Vector3 } from "../api/types.ts";

export interface Stop {
  number: number;
  name: string;
  /** In the world of the renderer, metres. */
  position: Vector3;
}

export interface Direction {
  stop: Stop;
  /** Counter-clockwise from +x, radians. */
  bearing: number;
  /** Metres, heights left out. */
  distance: number;
}

/** Between two arrows: nearer ones would lie on top of each other. */
const NARROWEST = Math.PI / 4;
/** Metres; what is nearer was taken at the same place. */
const NEAREST_M = 0.05;

/** Return the nearest other stops in sight, the nearest first, at most one of those in about the same direction. sees: whether one is in sight. */
export function directionsTo(here: Stop, stops: readonly Stop[], sees: (stop: Stop) => boolean): Direction[] {
  const found: Direction[] = [];
  const all = stops.map((stop) => {
    const [x, y] = [stop.position[0] - here.position[0], stop.position[1] - here.position[1]];
    return { stop, bearing: Math.atan2(y, x), distance: Math.hypot(x, y) };
  });
  for (const each of all.sort((a, b) => a.distance - b.distance)) {
    if (each.stop.number === here.number || each.distance < NEAREST_M) continue;
    if (found.every((other) => between(other.bearing, each.bearing) >= NARROWEST) && sees(each.stop)) found.push(each);
  }
  return found;
}

function between(a: number, b: number): number {
  const turn = Math.abs(a - b) % (2 * Math.PI);
  return Math.min(turn, 2 * Math.PI - turn);
}
