/** Which points lie in cells of space in which something changed, and how many of the answers that saw the cell say so. */

import type { Vector3 } from "../api/types.ts";
import type { PointChunk } from "./point_decoder.ts";

export interface SceneCell {
  /** In the world of the renderer. */
  center: Vector3;
  /** 0..1 of the answers that saw it. */
  share: number;
}

const ACROSS = 65_536;
const RED = [224, 43, 36] as const;
/** Of the colour of points that did not change, and of those that did in all answers. */
const [GREYED, REDDENED] = [0.55, 0.85];

/** Return the colours of points, greyed, and red in cells that changed. side: of a cell, metres. */
export function tintedColors({ positions, colors }: PointChunk, cells: SceneCell[], side: number): Uint32Array {
  const [x0, y0, z0] = cells[0]!.center;
  const key = (x: number, y: number, z: number): number =>
    ((Math.round((x - x0) / side) + ACROSS / 2) * ACROSS + Math.round((y - y0) / side) + ACROSS / 2) * ACROSS + Math.round((z - z0) / side);
  const shares = new Map(cells.map((cell) => [key(...cell.center), REDDENED * Math.max(0.35, cell.share)]));
  return colors.map((color, point) => {
    const [r, g, b] = [color & 255, (color >> 8) & 255, (color >> 16) & 255];
    const grey = GREYED * (0.3 * r + 0.59 * g + 0.11 * b);
    const share = shares.get(key(positions[3 * point]!, positions[3 * point + 1]!, positions[3 * point + 2]!)) ?? 0;
    const mixed = (own: number, red: number): number => (1 - share) * ((1 - GREYED) * own + grey) + share * red;
    return 0xff000000 | (mixed(b, RED[2]) << 16) | (mixed(g, RED[1]) << 8) | mixed(r, RED[0]);
  });
}
