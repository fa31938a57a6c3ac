/** The points of a scan, as many as have come. Any number of them from the front is a fair sample. */

import { type SceneCell, tintedColors } from "./change_tint.ts";
import type { PointChunk } from "./point_decoder.ts";

const SAMPLED = 20_000;
const CELLS_ACROSS = 64;
/** A point is drawn somewhat wider than its distance to the next, so that surfaces close. */
const OVERLAP = 1.5;
/** The coarse sample behind the others is wider still: it closes the gaps that chance leaves. */
const COARSE_OVERLAP = 2.4;

export class ScanPoints {
  readonly chunks: PointChunk[] = [];
  /** Of the whole scan, whether they have come or not. */
  readonly total: number;
  private numArrived = 0;
  private areaM2 = 1e-6;
  private changes: { cells: SceneCell[]; side: number } = { cells: [], side: 0 };
  private tinted: Uint32Array[] = [];

  constructor(total: number) {
    this.total = total;
  }

  get numPoints(): number {
    return this.numArrived;
  }

  /** Return chunks with about so many points from the front, or all that have come. */
  sample(count: number): PointChunk[] {
    let left = count;
    return this.chunks.filter(({ colors }) => (left -= colors.length) + colors.length > 0);
  }

  add(chunk: PointChunk): void {
    if (!this.chunks.length) this.areaM2 = surfaceOf(chunk.positions, Math.min(SAMPLED, chunk.colors.length));
    this.chunks.push(chunk);
    this.numArrived += chunk.colors.length;
  }

  /** Tint points in cells in which something changed, and grey the others; without cells all have their own colours. */
  tint(cells: SceneCell[], side: number): void {
    this.changes = { cells, side };
    this.tinted = [];
  }

  /** Return the colours of a chunk, tinted where it is wanted; worked out when they are first asked for. */
  colorsOf(index: number): Uint32Array {
    const chunk = this.chunks[index]!;
    const { cells, side } = this.changes;
    if (!cells.length || side <= 0) return chunk.colors;
    return (this.tinted[index] ??= tintedColors(chunk, cells, side));
  }

  /** Return how wide points are drawn, in metres, so that so many of them close surfaces. */
  widthOf(count: number): number {
    return OVERLAP * Math.sqrt(this.areaM2 / Math.max(1, count));
  }

  /** Return how wide points of a coarse sample of so many are drawn behind the others, in metres. */
  coarseWidthOf(count: number): number {
    return (COARSE_OVERLAP / OVERLAP) * this.widthOf(count);
  }
}

/** Estimate the area of a scan's surfaces: cells of a coarse grid that hold points, each about one cell's side wide. */
function surfaceOf(positions: Float32Array, count: number): number {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let at = 0; at < 3 * count; at += 1) {
    low[at % 3] = Math.min(low[at % 3]!, positions[at]!);
    high[at % 3] = Math.max(high[at % 3]!, positions[at]!);
  }
  const side = Math.max(...high.map((value, axis) => value - low[axis]!), 1e-3) / CELLS_ACROSS;
  const cells = new Set<number>();
  for (let at = 0; at < 3 * count; at += 3) {
    const [x, y, z] = [0, 1, 2].map((axis) => Math.floor((positions[at + axis]! - low[axis]!) / side)) as [number, number, number];
    cells.add((x * 128 + y) * 128 + z);
  }
  return Math.max(cells.size * side * side, 1e-6);
}
