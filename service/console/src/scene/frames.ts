/**
 * Poses between the service and the renderer. The only module that knows both conventions.
 *
 * The service: map z up, camera x forward, y left, z up; `matrix` is map_from_camera. three.js: a camera looks along −z, its y is up.
 * The world of the renderer keeps the map's axes (z up), moved by `origin`, so that large coordinates survive 32 bits.
 */

import type { Pose, Vector3 } from "../api/types.ts";

/** Rows of a 3 x 3 matrix. */
export type Rotation = [Vector3, Vector3, Vector3];

export type Frame = "ros" | "opencv" | "webxr" | "unity";
export const FRAMES: readonly Frame[] = ["ros", "opencv", "webxr", "unity"];

const IDENTITY: Rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
const Y_UP: Rotation = [[1, 0, 0], [0, 0, 1], [0, -1, 0]];
const CAMERA_AXES: Record<Frame, Rotation> = {
  ros: IDENTITY,
  opencv: [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
  webxr: [[0, -1, 0], [0, 0, 1], [-1, 0, 0]],
  unity: [[0, -1, 0], [0, 0, 1], [1, 0, 0]],
};
const MAP_AXES: Record<Frame, Rotation> = { ros: IDENTITY, opencv: IDENTITY, webxr: Y_UP, unity: [[1, 0, 0], [0, 0, 1], [0, 1, 0]] };

/** A place in the scene: where, and how a camera is turned there (map_from_camera, x forward). */
export interface Place3 {
  position: Vector3;
  rotation: Rotation;
}

/** Return a pose of the service (frame `ros`) in the world of the renderer. */
export function placeOf(pose: Pose, origin: Vector3): Place3 {
  const { position_m: p, matrix } = pose.map_from_camera;
  const rotation = [0, 1, 2].map((row) => [0, 1, 2].map((column) => matrix[row]?.[column] ?? 0)) as Rotation;
  return { position: [p.x - origin[0], p.y - origin[1], p.z - origin[2]], rotation };
}

/** Return the rotation of a three.js camera that looks as the photographed one did. */
export function viewRotation(rotation: Rotation): Rotation {
  return times(rotation, transposed(CAMERA_AXES.webxr));
}

/** Return the rotation of a level camera; yaw: counter-clockwise from +x, pitch: up positive, radians. */
export function levelRotation(yaw: number, pitch: number): Rotation {
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return [[cy * cp, -sy, -cy * sp], [sy * cp, cy, -sy * sp], [sp, 0, cp]];
}

/** Return (yaw, pitch up) of the direction that a camera looks in, radians. */
export function directionAngles(rotation: Rotation): [number, number] {
  const forward: Vector3 = [rotation[0][0], rotation[1][0], rotation[2][0]];
  return [Math.atan2(forward[1], forward[0]), Math.asin(Math.max(-1, Math.min(1, forward[2])))];
}

/** Return a pose of frame `ros` as text in another frame, as the service would have answered it. */
export function poseText(pose: Pose, frame: Frame): string {
  const place = placeOf(pose, [0, 0, 0]);
  const rotation = times(times(MAP_AXES[frame], place.rotation), transposed(CAMERA_AXES[frame]));
  const [x, y, z] = applied(MAP_AXES[frame], place.position);
  const [qx, qy, qz, qw] = quaternionOf(rotation);
  const matrix = [...rotation.map((row, index) => [...row, [x, y, z][index] ?? 0]), [0, 0, 0, 1]];
  return JSON.stringify({ frame, map_from_camera: { position_m: { x, y, z }, quaternion: { x: qx, y: qy, z: qz, w: qw }, matrix } }, null, 2);
}

export function times(a: Rotation, b: Rotation): Rotation {
  return a.map((row) => [0, 1, 2].map((column) => row[0] * b[0][column]! + row[1] * b[1][column]! + row[2] * b[2][column]!)) as Rotation;
}

export function transposed(a: Rotation): Rotation {
  return [0, 1, 2].map((row) => [0, 1, 2].map((column) => a[column]![row]!)) as Rotation;
}

export function applied(a: Rotation, v: Vector3): Vector3 {
  return a.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]) as Vector3;
}

/** Return the unit quaternion (x, y, z, w), w >= 0, of a rotation (Shepperd's method). */
export function quaternionOf(r: Rotation): [number, number, number, number] {
  const trace = r[0][0] + r[1][1] + r[2][2];
  const squares = [r[0][0], r[1][1], r[2][2], trace];
  const largest = squares.indexOf(Math.max(...squares));
  let q: [number, number, number, number];
  if (largest === 3) {
    q = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1], 1 + trace];
  } else {
    const [i, j, k] = [largest, (largest + 1) % 3, (largest + 2) % 3] as [number, number, number];
    q = [0, 0, 0, r[k]![j]! - r[j]![k]!];
    q[i] = 1 + 2 * r[i]![i]! - trace;
    q[j] = r[j]![i]! + r[i]![j]!;
    q[k] = r[k]![i]! + r[i]![k]!;
  }
  const scale = (q[3] < 0 ? -1 : 1) / Math.hypot(...q);
  return q.map((value) => value * scale) as [number, number, number, number];
}
