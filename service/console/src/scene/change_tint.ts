/** Which points lie in cells of space in which something changed, and how many of the answers that saw the cell say so. */

import type { Vector3 } from "../api/types.ts";

export interface SceneCell {
  /** In the world of the renderer. */
  center: Vector3;
  /** 0..1 of the answers that saw it. */
  share: number;
}

const ACROSS = 65_536;

/** Write the tint (0..255) of points from `first` to `last` into `tints`. side: of a cell, metres. */
export function tintPoints(tints: Uint8Array, positions: Float32Array, first: number, last: number, cells: SceneCell[], side: number): void {
  const base = cells[0]?.center;
  if (base === undefined || side <= 0) {
    tints.fill(0, first, last);
    return;
  }
  const key = (x: number, y: number, z: number): number =>
    ((Math.round((x - base[0]) / side) + ACROSS / 2) * ACROSS + Math.round((y - base[1]) / side) + ACROSS / 2) * ACROSS + Math.round((z - base[2]) / side);
  const shares = new Map(cells.map((cell) => [key(...cell.center), Math.round(255 * Math.max(0.35, cell.share))]));
  for (let point = first, at = 3 * first; point < last; point += 1, at += 3) {
    tints[point] = shares.get(key(positions[at]!, positions[at + 1]!, positions[at + 2]!)) ?? 0;
  }
}
