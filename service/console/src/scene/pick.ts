/** Finds the place of the scan under a pixel: where the ray through it meets the surface that the points around it form. */

import type { Vector3 } from "../api/types.ts";
import type { PointChunk } from "./point_decoder.ts";

/** From the camera into the scene, in the world of the renderer. */
export interface Ray {
  origin: Vector3;
  /** Unit length. */
  direction: Vector3;
  /** Metres before the camera at which points begin to be drawn. */
  near: number;
  /** No point is farther away than so many metres. */
  far: number;
  /** Points above this height are hidden. */
  cut: number;
  /** Width of a pixel one metre before the camera, metres. */
  pixel: number;
}

/** Radius of what a click hits: pixels, and widths of points as they are drawn. */
const [HIT_PX, HIT_WIDTHS] = [2, 1];
/** Radius of the piece of surface around it: as above. */
const [AROUND_PX, AROUND_WIDTHS] = [6, 3];
const FEWEST_OF_PLANE = 6;
/** Of a plane: standard deviation across it, as a share of that along it; and the sine of the angle at which a ray still meets it. */
const [FLATTEST, STEEPEST] = [0.15, 0.12];

interface Near {
  at: Vector3;
  along: number;
  /** Metres from the ray. */
  aside: number;
}

/** Return the place where a ray first meets the scan, null where it meets nothing. width: of points as they are drawn, metres. */
export function pickPoint(chunks: readonly PointChunk[], ray: Ray, width: number): Vector3 | null {
  const near = pointsAround(chunks, ray, AROUND_WIDTHS * width, AROUND_PX * ray.pixel);
  const touch = (along: number): number => Math.max(HIT_WIDTHS * width, HIT_PX * ray.pixel * along);
  const hit = near.filter(({ along, aside }) => aside <= touch(along));
  const front = (hit.length ? hit : near).reduce<Near | null>((first, each) => (first && first.along <= each.along ? first : each), null);
  if (front === null) return null;
  const reach = Math.max(AROUND_WIDTHS * width, AROUND_PX * ray.pixel * front.along);
  const surface = near.filter(({ at }) => distance(at, front.at) <= reach);
  const met = meetPlane(surface.map(({ at }) => at), ray);
  // Beyond its points a plane is a guess.
  if (met !== null && near.some(({ at, along }) => distance(at, met) <= touch(along))) return met;
  return surface.reduce((best, each) => (best.aside <= each.aside ? best : each)).at;
}

/** Return where a ray begins and which way it goes. */
export function rayBetween(from: Vector3, to: Vector3): Pick<Ray, "origin" | "direction"> {
  const away = distance(from, to);
  return { origin: from, direction: to.map((value, axis) => (value - from[axis]!) / away) as Vector3 };
}

export function distance(a: Vector3, b: Vector3): number {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

/** Return the points within `metres`, or `perMetre` times their distance, of a ray. */
export function pointsAround(chunks: readonly PointChunk[], ray: Ray, metres: number, perMetre: number): Near[] {
  const { origin, direction, near, far, cut } = ray;
  const found: Near[] = [];
  const look = (positions: Float32Array, at: number): void => {
    const [x, y, z] = [positions[at]!, positions[at + 1]!, positions[at + 2]!];
    const along = (x - origin[0]) * direction[0] + (y - origin[1]) * direction[1] + (z - origin[2]) * direction[2];
    const aside = Math.sqrt(Math.max(0, (x - origin[0]) ** 2 + (y - origin[1]) ** 2 + (z - origin[2]) ** 2 - along * along));
    if (along >= near && z <= cut && aside <= Math.max(metres, perMetre * along)) found.push({ at: [x, y, z], along, aside });
  };
  // Of ten million points all but few lie outside an upright slab along the ray, which one comparison tells.
  const length = Math.hypot(direction[0], direction[1]);
  const [u, v] = length > 1e-6 ? [-direction[1] / length, direction[0] / length] : [1, 0];
  const offset = u * origin[0] + v * origin[1];
  const half = Math.max(metres, perMetre * far);
  for (const { positions } of chunks) {
    const end = positions.length;
    for (let at = 0; at < end; at += 3) {
      if (Math.abs(positions[at]! * u + positions[at + 1]! * v - offset) <= half) look(positions, at);
    }
  }
  return found;
}

/** Return where a ray meets the plane through points, null where they form none or the ray grazes it. */
function meetPlane(points: Vector3[], { origin, direction }: Ray): Vector3 | null {
  if (points.length < FEWEST_OF_PLANE) return null;
  const mean = [0, 1, 2].map((axis) => points.reduce((sum, point) => sum + point[axis]!, 0) / points.length) as Vector3;
  const spread = (a: number, b: number): number => points.reduce((sum, point) => sum + (point[a]! - mean[a]!) * (point[b]! - mean[b]!), 0) / points.length;
  const [xx, xy, xz, yy, yz, zz] = [spread(0, 0), spread(0, 1), spread(0, 2), spread(1, 1), spread(1, 2), spread(2, 2)];
  // Of a flat covariance, the adjugate is the normal times its transpose: its longest column.
  const columns: Vector3[] = [
    [yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy],
    [xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz],
    [xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy],
  ];
  const longest = columns.reduce((best, each) => (Math.hypot(...best) >= Math.hypot(...each) ? best : each));
  const length = Math.hypot(...longest);
  if (length === 0) return null;
  const [nx, ny, nz] = longest.map((value) => value / length) as Vector3;
  const across = nx * nx * xx + ny * ny * yy + nz * nz * zz + 2 * (nx * ny * xy + nx * nz * xz + ny * nz * yz);
  const facing = nx * direction[0] + ny * direction[1] + nz * direction[2];
  if (across > FLATTEST * FLATTEST * (xx + yy + zz) || Math.abs(facing) < STEEPEST) return null;
  const along = (nx * (mean[0] - origin[0]) + ny * (mean[1] - origin[1]) + nz * (mean[2] - origin[2])) / facing;
  return origin.map((value, axis) => value + along * direction[axis]!) as Vector3;
}
