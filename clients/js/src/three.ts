/** For three.js, which this package does not load. */

import { matrixOf, type Vector } from "./poses.ts";
import type { Tracker } from "./tracker.ts";

/** The parts of an Object3D that are set here. */
export interface Anchored {
  visible: boolean;
  matrixAutoUpdate: boolean;
  matrixWorldNeedsUpdate: boolean;
  readonly matrix: { fromArray(elements: number[]): unknown };
}

/** Put an object where the map is, in every frame: what it contains has the map's coordinates. Hidden while that is not known. */
export function anchor(object: Anchored, tracker: Pick<Tracker, "sessionFromMap">): void {
  const found = tracker.sessionFromMap;
  object.visible = found !== null;
  object.matrixAutoUpdate = false;
  if (!found) return;
  object.matrix.fromArray(matrixOf(found));
  object.matrixWorldNeedsUpdate = true;
}

/** Return where a point of the scan, with z up, is in the map's coordinates with y up, those of WebXR and three.js. */
export function scanPoint(x: number, y: number, z: number): Vector {
  return { x, y: z, z: -y };
}
