/** The scan from above, painted pixel by pixel: it needs no WebGL, and a click on it is a place. */

import type { MapStats, Vector3 } from "../api/types.ts";
import type { PointChunk } from "../scene/point_decoder.ts";
import type { Section } from "./floors.ts";

const LONGER_SIDE_PX = 420;
const MARGIN = 0.03;
/** Holes that are closed: empty pixels so many of whose neighbours are not, so often over. An edge has three, an inner corner five. */
const CLOSING_NEIGHBOURS = 5;
const CLOSING_PASSES = 4;
const SPREAD = [-1, 0, 1].flatMap((dx) => [-1, 0, 1].map((dy) => [dx, dy] as const));

/** Where the plan lies: metres in the map's own frame, x to the right, y up. */
export interface PlanFrame {
  left: number;
  top: number;
  width: number;
  height: number;
}

export function planFrame(stats: MapStats): PlanFrame {
  const { min, max } = stats.bounds;
  const margin = MARGIN * Math.max(max[0] - min[0], max[1] - min[1]);
  return { left: min[0] - margin, top: max[1] + margin, width: max[0] - min[0] + 2 * margin, height: max[1] - min[1] + 2 * margin };
}

/** Paint the points of a section onto a canvas that is made as large as they need. */
export function paintPlan(canvas: HTMLCanvasElement, chunks: PointChunk[], origin: Vector3, stats: MapStats, { bottom, top }: Section): void {
  const frame = planFrame(stats);
  const perMetre = LONGER_SIDE_PX / Math.max(frame.width, frame.height);
  const [width, height] = [Math.max(1, Math.round(frame.width * perMetre)), Math.max(1, Math.round(frame.height * perMetre))];
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d")!;
  const picture = context.createImageData(width, height);
  const heights = new Float32Array(width * height).fill(-Infinity);
  const [lowest, highest] = [bottom - origin[2], top - origin[2]];
  const pixels = new Uint32Array(picture.data.buffer);
  for (const { positions, colors } of chunks) {
    for (let point = 0, at = 0; point < colors.length; point += 1, at += 3) {
      const z = positions[at + 2]!;
      if (z < lowest || z > highest) continue;
      const column = Math.floor((positions[at]! + origin[0] - frame.left) * perMetre);
      const row = Math.floor((frame.top - positions[at + 1]! - origin[1]) * perMetre);
      // A point is three pixels wide, so that floors close.
      for (const [dx, dy] of SPREAD) {
        if (column + dx < 0 || column + dx >= width || row + dy < 0 || row + dy >= height) continue;
        const pixel = (row + dy) * width + column + dx;
        if (z <= heights[pixel]!) continue;
        heights[pixel] = z;
        pixels[pixel] = colors[point]!;
      }
    }
  }
  closeHoles(pixels, width, height);
  context.putImageData(picture, 0, 0);
}

/** Give small gaps between points the mean colour around them: floors have few points for their size. pixels: 0 where empty. */
export function closeHoles(pixels: Uint32Array, width: number, height: number): void {
  for (let pass = 0; pass < CLOSING_PASSES; pass += 1) {
    const before = pixels.slice();
    for (let row = 1; row < height - 1; row += 1) {
      for (let column = 1; column < width - 1; column += 1) {
        const pixel = row * width + column;
        if (before[pixel]) continue;
        const around = SPREAD.map(([dx, dy]) => before[pixel + dy * width + dx]!).filter(Boolean);
        if (around.length >= CLOSING_NEIGHBOURS) pixels[pixel] = meanColor(around);
      }
    }
  }
}

function meanColor(colors: number[]): number {
  return [0, 8, 16, 24].reduce((mean, shift) => mean + Math.round(colors.reduce((sum, color) => sum + ((color >>> shift) & 255), 0) / colors.length) * 2 ** shift, 0);
}
