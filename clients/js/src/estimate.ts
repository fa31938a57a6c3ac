/** Where the session lies in the map, as answers and the walk since say: a Kalman filter of a step and a turn at the camera. */

import { compose, difference, inverse, length, moved, type Difference, type Motion } from "./poses.ts";

/** `mapFromSession` with the standard deviations of the pose of the camera that it puts into the map, per axis. */
export interface Estimate {
  mapFromSession: Motion;
  position_m: number;
  turn_rad: number;
  /** How far had been walked when this held. */
  walked_m: number;
}

/** How fast a device's own tracking drifts: per metre walked. Phones: half a percent to two, a degree in ten to fifty metres. */
const DRIFT = 0.01;
const TURN_DRIFT_RAD_PER_M = 0.001;
/** Answers from alike views err alike, so many of them are not as exact as their mean would be. */
const LEAST_POSITION_M = 0.01;
const LEAST_TURN_RAD = 0.003;
/** Standard deviations beyond which an answer contradicts; the share of true ones beyond is below a hundredth. */
const FAR = 3.5;
/** Of a normal distribution in three dimensions, the radius of 68 % in standard deviations. */
const RADIUS_68 = 1.87;

/** Return the standard deviation per axis that an answer's `accuracy` means. */
const deviationOf = (radius: number | null, unknown: number, least: number): number => Math.max((radius ?? unknown) / RADIUS_68, least);

/** Return the measurement in an answer. walked_m: when its images were taken. */
export function measured(mapFromSession: Motion, accuracy: { position_m: number | null; orientation_deg: number | null }, walked_m: number): Estimate {
  const position_m = deviationOf(accuracy.position_m, 0.3, LEAST_POSITION_M);
  const turn_rad = (deviationOf(accuracy.orientation_deg, 5, LEAST_TURN_RAD * (180 / Math.PI)) * Math.PI) / 180;
  return { mapFromSession, position_m, turn_rad, walked_m };
}

/** Return what is left of an estimate after a walk. Drift keeps its direction for a while, so it grows with the way, not its root. */
export function later(known: Estimate, walked_m: number): Estimate {
  const way_m = Math.max(walked_m - known.walked_m, 0);
  const grown = loosened(known, (DRIFT + known.turn_rad) * way_m, TURN_DRIFT_RAD_PER_M * way_m);
  return { ...grown, walked_m: known.walked_m + way_m };
}

/** Return an estimate to which something unknown has come: deviations of a step and a turn. */
export function loosened(known: Estimate, step_m: number, turn_rad: number): Estimate {
  return { ...known, position_m: Math.hypot(known.position_m, step_m), turn_rad: Math.hypot(known.turn_rad, turn_rad) };
}

/** How far two estimates put a camera apart, and whether that is more than chance. */
export function compared(a: Estimate, b: Estimate, sessionFromCamera: Motion): { apart: Difference; isFar: boolean } {
  const apart = difference(compose(b.mapFromSession, sessionFromCamera), compose(a.mapFromSession, sessionFromCamera));
  const steps = length(apart.step_m) / Math.hypot(a.position_m, b.position_m);
  const turns = length(apart.turn_rad) / Math.hypot(a.turn_rad, b.turn_rad);
  return { apart, isFar: Math.max(steps, turns) > FAR };
}

/** Return what is known after both, each weighed by its deviation. They hold at the same time, at a camera. */
export function fused(known: Estimate, found: Estimate, sessionFromCamera: Motion): Estimate {
  const { apart } = compared(known, found, sessionFromCamera);
  const gain = known.position_m ** 2 / (known.position_m ** 2 + found.position_m ** 2);
  const turnGain = known.turn_rad ** 2 / (known.turn_rad ** 2 + found.turn_rad ** 2);
  const mapFromCamera = moved(compose(known.mapFromSession, sessionFromCamera), apart, gain, turnGain);
  return {
    mapFromSession: compose(mapFromCamera, inverse(sessionFromCamera)),
    position_m: Math.max(known.position_m * Math.sqrt(1 - gain), LEAST_POSITION_M),
    turn_rad: Math.max(known.turn_rad * Math.sqrt(1 - turnGain), LEAST_TURN_RAD),
    walked_m: found.walked_m,
  };
}
