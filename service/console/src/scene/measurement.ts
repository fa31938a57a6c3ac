/** Lengths, heights and areas of points that were picked, metres; and what a scale bar and a north arrow show. */

import type { Place, Vector3 } from "../api/types.ts";
import { distance } from "./pick.ts";

export interface Measurement {
  /** Along all points. */
  length: number;
  /** From the first point to the last one: on a plan, and upwards. */
  horizontal: number;
  height: number;
  /** Of the polygon of all points, on the plane that suits them best; null for fewer than three. */
  area: number | null;
}

export function measured(points: readonly Vector3[]): Measurement {
  const [first, last] = [points[0]!, points.at(-1)!];
  return {
    length: points.slice(1).reduce((sum, point, index) => sum + distance(points[index]!, point), 0),
    horizontal: Math.hypot(last[0] - first[0], last[1] - first[1]),
    height: last[2] - first[2],
    area: points.length < 3 ? null : areaOf(points),
  };
}

/** Half the length of the sum of cross products, from the first point so that large coordinates cost no digits (Newell). */
function areaOf(points: readonly Vector3[]): number {
  const corners = points.map((point) => point.map((value, axis) => value - points[0]![axis]!) as Vector3);
  const sum: Vector3 = [0, 0, 0];
  for (const [index, a] of corners.entries()) {
    const b = corners[(index + 1) % corners.length]!;
    sum[0] += a[1] * b[2] - a[2] * b[1];
    sum[1] += a[2] * b[0] - a[0] * b[2];
    sum[2] += a[0] * b[1] - a[1] * b[0];
  }
  return Math.hypot(...sum) / 2;
}

/** Return the longest of 1, 2, 5, 10, … metres that fits, and its pixels. */
export function scaleBar(metresPerPixel: number, mostPixels: number): { metres: number; pixels: number } {
  const most = metresPerPixel * mostPixels;
  const power = 10 ** Math.floor(Math.log10(most));
  const metres = power * ([5, 2].find((step) => step * power <= most) ?? 1);
  return { metres, pixels: metres / metresPerPixel };
}

/** Return which way north is in a map, counter-clockwise from +x, radians, and what it is called. */
export function northOf({ georeference, coordinate_system }: Place): { angle: number; letter: string; name: string } {
  if (georeference) return { angle: Math.PI / 2 + (georeference.heading_deg / 180) * Math.PI, letter: "N", name: "True north" };
  if (coordinate_system) return { angle: Math.PI / 2, letter: "N", name: "Grid north" };
  return { angle: Math.PI / 2, letter: "y", name: "The map's y axis" };
}
