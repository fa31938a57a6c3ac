/** Where the session lies in the map, as answers and the walk since say: a Kalman filter of a step and a turn at the camera. */

import { add, compose, difference, inverse, length, levelled, moved, scale, ZERO, type Motion, type Vector } from "./poses.ts";

/** `mapFromSession` with the standard deviations, per axis, of the pose of the camera that it puts into the map. */
export interface Estimate {
  mapFromSession: Motion;
  position_m: number;
  /** About the vertical, and about the two other axes. */
  yaw_rad: number;
  tilt_rad: number;
  /** How the camera drifts away in the map, metres per metre walked; its deviation per axis; and its covariance with the position. */
  drift: Vector;
  drift_std: number;
  drift_position_m: number;
  /** How far had been walked when this held. */
  walked_m: number;
}

const DEGREE = Math.PI / 180;
/** How fast a device's own tracking drifts, per metre walked, and for how many metres alike. Gravity holds the tilt. */
const DRIFT_STD = 0.01;
const ALIKE_M = 5;
const YAW_DRIFT_RAD = 0.1 * DEGREE;
/** How exactly scans and sessions that are level are so. */
const LEVEL_RAD = 0.5 * DEGREE;
/** Answers to alike views err alike, so many of them are not as exact as their mean would be. */
const LEAST_M = 0.01;
const LEAST_RAD = 0.1 * DEGREE;
/** Of an answer that gives no accuracy: radii. */
const UNKNOWN_M = 0.3;
const UNKNOWN_DEG = 5;
/** Standard deviations beyond which an answer contradicts: few true ones lie there. */
const FAR = 3;
/** The radius of 68 % in standard deviations: of three axes alike, and of directions, which err about the vertical where up is known. */
const RADIUS_OF_POSITION = 1.87;
const RADIUS_OF_YAW = 1;
const RADIUS_OF_TILT = 3;

/** Return what an answer says. walked_m: when its images were taken. */
export function measured(mapFromSession: Motion, accuracy: { position_m: number | null; orientation_deg: number | null }, walked_m: number): Estimate {
  const position_m = Math.max((accuracy.position_m ?? UNKNOWN_M) / RADIUS_OF_POSITION, LEAST_M);
  const turn_rad = (accuracy.orientation_deg ?? UNKNOWN_DEG) * DEGREE;
  const [yaw_rad, tilt_rad] = [Math.max(turn_rad / RADIUS_OF_YAW, LEAST_RAD), Math.max(turn_rad / RADIUS_OF_TILT, LEAST_RAD)];
  const drift = { drift: ZERO, drift_std: DRIFT_STD, drift_position_m: 0 };
  return { mapFromSession, position_m, yaw_rad, tilt_rad, ...drift, walked_m };
}

/** Return a first estimate: what an answer says, and that map and session are level. */
export function first(found: Estimate, sessionFromCamera: Motion): Estimate {
  const mapFromSession = levelled(compose(found.mapFromSession, sessionFromCamera), sessionFromCamera);
  return fused({ ...found, mapFromSession, position_m: Infinity, yaw_rad: Infinity, tilt_rad: LEVEL_RAD }, found, sessionFromCamera);
}

/** Return what is left of an estimate after a walk. */
export function later(known: Estimate, walked_m: number): Estimate {
  const way_m = Math.max(walked_m - known.walked_m, 0);
  const kept = Math.exp(-way_m / ALIKE_M);
  const drifting_m = ALIKE_M * (1 - kept);
  const { drift, drift_std, drift_position_m, mapFromSession } = known;
  const variance = 2 * drift_position_m * way_m + (drift_std ** 2 + known.yaw_rad ** 2) * way_m ** 2;
  return {
    ...loosened(known, Math.sqrt(Math.max(variance, 0)), YAW_DRIFT_RAD * way_m),
    mapFromSession: { ...mapFromSession, position_m: add(mapFromSession.position_m, scale(drift, drifting_m)) },
    drift: scale(drift, kept),
    drift_std: Math.hypot(drift_std * kept, DRIFT_STD * Math.sqrt(1 - kept ** 2)),
    drift_position_m: (drift_position_m + drift_std ** 2 * way_m) * kept,
    walked_m: known.walked_m + way_m,
  };
}

/** Return an estimate to which something unknown has come: standard deviations of a step and of a turn about the vertical. */
export function loosened(known: Estimate, step_m: number, yaw_rad: number): Estimate {
  return { ...known, position_m: Math.hypot(known.position_m, step_m), yaw_rad: Math.hypot(known.yaw_rad, yaw_rad) };
}

/** Return whether two estimates put a camera farther apart than chance does. */
export function areApart(a: Estimate, b: Estimate, sessionFromCamera: Motion): boolean {
  const { step_m, turn_rad } = difference(compose(b.mapFromSession, sessionFromCamera), compose(a.mapFromSession, sessionFromCamera));
  const step = length(step_m) / Math.hypot(a.position_m, b.position_m);
  const yaw = turn_rad.y / Math.hypot(a.yaw_rad, b.yaw_rad);
  const tilt = Math.hypot(turn_rad.x, turn_rad.z) / Math.hypot(a.tilt_rad, b.tilt_rad);
  return Math.max(step, Math.abs(yaw), tilt) > FAR;
}

/** Return what is known after both, each weighed by its deviations. They hold at the same time, at a camera. */
export function fused(known: Estimate, found: Estimate, sessionFromCamera: Motion): Estimate {
  const mapFromCamera = compose(known.mapFromSession, sessionFromCamera);
  const { step_m, turn_rad } = difference(compose(found.mapFromSession, sessionFromCamera), mapFromCamera);
  const [step, yaw, tilt] = (["position_m", "yaw_rad", "tilt_rad"] as const).map((name) => 1 / (1 + (found[name] / known[name]) ** 2)) as [number, number, number];
  // What is not known of the drift has moved the position as well.
  const driftGain = known.drift_position_m / (known.position_m ** 2 + found.position_m ** 2);
  const turn = { x: tilt * turn_rad.x, y: yaw * turn_rad.y, z: tilt * turn_rad.z };
  return {
    mapFromSession: compose(moved(mapFromCamera, { step_m: scale(step_m, step), turn_rad: turn }, 1), inverse(sessionFromCamera)),
    position_m: Math.max(found.position_m * Math.sqrt(step), LEAST_M),
    yaw_rad: Math.max(found.yaw_rad * Math.sqrt(yaw), LEAST_RAD),
    tilt_rad: Math.max(found.tilt_rad * Math.sqrt(tilt), LEAST_RAD),
    drift: add(known.drift, scale(step_m, driftGain)),
    drift_std: Math.sqrt(Math.max(known.drift_std ** 2 - driftGain * known.drift_position_m, 0)),
    drift_position_m: known.drift_position_m * (1 - step),
    walked_m: found.walked_m,
  };
}
