/** Rigid motions as the service sends them: x_a = quaternion · x_b + position_m. Metres, unit quaternions, right-handed axes. */

export interface Vector {
  x: number;
  y: number;
  z: number;
}

export interface Quaternion extends Vector {
  w: number;
}

/** A motion between two frames, named target first: `mapFromSession` maps coordinates of the session to those of the map. */
export type Motion = {
  position_m: Vector;
  quaternion: Quaternion;
};

export const ZERO: Vector = { x: 0, y: 0, z: 0 };
export const IDENTITY: Motion = { position_m: ZERO, quaternion: { ...ZERO, w: 1 } };

export const add = (a: Vector, b: Vector): Vector => ({ x: a.x + b.x, y: a.y + b.y, z: a.z + b.z });
export const scale = (a: Vector, factor: number): Vector => ({ x: a.x * factor, y: a.y * factor, z: a.z * factor });
export const subtract = (a: Vector, b: Vector): Vector => add(a, scale(b, -1));
export const length = (a: Vector): number => Math.hypot(a.x, a.y, a.z);

/** Return the product: first b, then a. */
export function multiply(a: Quaternion, b: Quaternion): Quaternion {
  return {
    x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
    y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
    z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
    w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
  };
}

export const conjugate = (q: Quaternion): Quaternion => ({ x: -q.x, y: -q.y, z: -q.z, w: q.w });

export function rotate(q: Quaternion, v: Vector): Vector {
  const { x, y, z } = multiply(multiply(q, { ...v, w: 0 }), conjugate(q));
  return { x, y, z };
}

/** Return the rotation vector of a unit quaternion: its axis times its angle in radians, at most π. */
export function rotationVector(q: Quaternion): Vector {
  const sine = length(q);
  const angle = 2 * Math.atan2(sine, Math.abs(q.w));
  return scale(q, sine < 1e-12 ? 0 : (angle * (q.w < 0 ? -1 : 1)) / sine);
}

export function rotationOf(vector: Vector): Quaternion {
  const angle = length(vector);
  return { ...scale(vector, angle < 1e-12 ? 0.5 : Math.sin(angle / 2) / angle), w: Math.cos(angle / 2) };
}

/** Return the motion that maps by b and then by a. Products of many rotations stay of unit length. */
export function compose(a: Motion, b: Motion): Motion {
  const q = multiply(a.quaternion, b.quaternion);
  const norm = Math.hypot(q.x, q.y, q.z, q.w);
  return { position_m: transform(a, b.position_m), quaternion: { ...scale(q, 1 / norm), w: q.w / norm } };
}

export const transform = (motion: Motion, point: Vector): Vector => add(motion.position_m, rotate(motion.quaternion, point));

export function inverse({ position_m, quaternion }: Motion): Motion {
  const back = conjugate(quaternion);
  return { position_m: scale(rotate(back, position_m), -1), quaternion: back };
}

/** How far two motions are apart: as a step of the position, and a rotation vector, in the axes of the target. */
export interface Difference {
  step_m: Vector;
  turn_rad: Vector;
}

export function difference(to: Motion, from: Motion): Difference {
  const turn_rad = rotationVector(multiply(to.quaternion, conjugate(from.quaternion)));
  return { step_m: subtract(to.position_m, from.position_m), turn_rad };
}

/** Return the motion that is this share of the way from `from`. */
export function moved(from: Motion, { step_m, turn_rad }: Difference, share: number): Motion {
  return {
    position_m: add(from.position_m, scale(step_m, share)),
    quaternion: multiply(rotationOf(scale(turn_rad, share)), from.quaternion),
  };
}

/** Return the motion from a session to a map, both with y up, that puts a camera of the session where it is in the map. */
export function levelled(mapFromCamera: Motion, sessionFromCamera: Motion): Motion {
  const { y, w } = compose(mapFromCamera, inverse(sessionFromCamera)).quaternion;
  const quaternion = rotationOf({ ...ZERO, y: 2 * Math.atan2(y, w) });
  return { position_m: subtract(mapFromCamera.position_m, rotate(quaternion, sessionFromCamera.position_m)), quaternion };
}

/** Whether a motion has no NaN and nothing infinite. */
export const isFiniteMotion = ({ position_m, quaternion }: Motion): boolean =>
  Number.isFinite(length(position_m) + length(quaternion) + quaternion.w);

/** Return the 4 x 4 matrix column by column, as WebGL, WebXR and three.js have it. */
export function matrixOf({ position_m: p, quaternion: q }: Motion): number[] {
  const columns = [rotate(q, { x: 1, y: 0, z: 0 }), rotate(q, { x: 0, y: 1, z: 0 }), rotate(q, { x: 0, y: 0, z: 1 })];
  return [...columns.flatMap(({ x, y, z }) => [x, y, z, 0]), p.x, p.y, p.z, 1];
}
