/** What the eye meets in the scan: under a point of the view, or between two places. */

import { type PerspectiveCamera, Vector3 as V3 } from "three";

import type { Vector3 } from "../api/types.ts";
import { distance, pickPoint, pointsAround, type Ray, rayBetween } from "./pick.ts";
import type { ScanPoints } from "./scan_points.ts";

/** Points that a line of sight is looked for in: a fair sample, quickly searched. */
const SIGHT_POINTS = 1_000_000;
/** Metres around either end of a line of sight that hide nothing: the camera's own stand, and what it leans on. */
const MARGIN_M = 0.4;
/** Points so near a line of sight, and so many of them, are a surface and no stray ones. */
const [WIDEST_M, FEWEST] = [0.06, 2];

/** Return where the scan is under a point of the view (-1..1 both ways), null where there is none. height: of the view, pixels. */
export function pickUnder(points: ScanPoints, camera: PerspectiveCamera, [x, y]: [number, number], height: number, limits: Pick<Ray, "far" | "cut">): Vector3 | null {
  camera.updateMatrixWorld();
  const ray = rayBetween(camera.position.toArray(), new V3(x, y, 0.5).unproject(camera).toArray());
  const pixel = (2 * Math.tan((camera.fov / 360) * Math.PI)) / Math.max(1, height);
  return pickPoint(points.chunks, { ...ray, ...limits, near: camera.near, pixel }, points.widthOf(points.numPoints));
}

/** Tell whether nothing of the scan lies between two places. */
export function isClear(points: ScanPoints, from: Vector3, to: Vector3): boolean {
  const far = distance(from, to) - MARGIN_M;
  const ray = { ...rayBetween(from, to), near: MARGIN_M, far, cut: Infinity, pixel: 0 };
  const width = points.widthOf(Math.min(SIGHT_POINTS, points.numPoints));
  const inTheWay = pointsAround(points.sample(SIGHT_POINTS), ray, Math.min(WIDEST_M, 0.75 * width), 0);
  return inTheWay.filter(({ along }) => along < far).length < FEWEST;
}
