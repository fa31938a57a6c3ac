/**
 * How the rear camera of a phone is turned, from what browsers say of the phone.
 *
 * Browsers say (W3C Device Orientation): phone to Earth is Rz(alpha) Rx(beta) Ry(gamma). Earth: x east, y north, z up, or turned about z. The
 * phone: x right, y up, z out of a screen held upright. `screen.orientation.angle`: by how much the page is turned against that screen.
 * Sent to the service (`webxr`): the camera has x right, y up and looks along −z; the session has y up.
 */

import type { Vector3 } from "../api/types.ts";

/** x, y, z, w; length one. */
export type Quaternion = [number, number, number, number];

const X: Vector3 = [1, 0, 0];
const Y: Vector3 = [0, 1, 0];
const Z: Vector3 = [0, 0, 1];

/** Return session_from_camera, of pictures as the page shows them. */
export function cameraOrientation(alphaDeg: number, betaDeg: number, gammaDeg: number, screenDeg: number): Quaternion {
  const turns: [Vector3, number][] = [[X, -90], [Z, alphaDeg], [X, betaDeg], [Y, gammaDeg], [Z, -screenDeg]];
  return turns.map(([axis, degrees]) => turned(axis, degrees)).reduce(product);
}

/** Return the direction that a camera looks in, in the axes of the session. */
export function lookOf([x, y, z, w]: Quaternion): Vector3 {
  return [-2 * (x * z + w * y), -2 * (y * z - w * x), -(1 - 2 * (x * x + y * y))];
}

/** Return the yaw of a direction in degrees: counter-clockwise seen from above. */
export function yawOf([x, , z]: Vector3): number {
  return (Math.atan2(-z, x) * 180) / Math.PI;
}

/** Return the angle between two directions of length one, degrees. */
export function angleBetween(a: Vector3, b: Vector3): number {
  const cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  return (Math.acos(Math.min(1, Math.max(-1, cosine))) * 180) / Math.PI;
}

/** Return an angle in degrees as one from −180 to 180. */
export function signed(degrees: number): number {
  return ((((degrees + 180) % 360) + 360) % 360) - 180;
}

function turned(axis: Vector3, degrees: number): Quaternion {
  const half = (degrees * Math.PI) / 360;
  return [axis[0] * Math.sin(half), axis[1] * Math.sin(half), axis[2] * Math.sin(half), Math.cos(half)];
}

function product([ax, ay, az, aw]: Quaternion, [bx, by, bz, bw]: Quaternion): Quaternion {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}
