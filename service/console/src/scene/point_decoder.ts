/** Turns the bytes of a binary PLY, as they come, into arrays of points. */

import type { Vector3 } from "../api/types.ts";

const END = "end_header\n";
const MOST_HEADER_BYTES = 4096;

export interface PointArrays {
  /** (n, 3) metres from the origin that was asked for. */
  positions: Float32Array;
  /** (n, 3) sRGB. */
  colors: Uint8Array;
}

export interface PointStreamEvents {
  /** Arrays for all points; only the first `numArrived` of `onPoints` hold any. */
  onBegin(arrays: PointArrays, numPoints: number): void;
  onPoints(numArrived: number): void;
}

interface Layout {
  numPoints: number;
  headerBytes: number;
  isDouble: boolean;
}

export class PointDecoder {
  private rest = new Uint8Array(0);
  private layout: Layout | null = null;
  private arrays: PointArrays = { positions: new Float32Array(0), colors: new Uint8Array(0) };
  private numArrived = 0;
  private readonly origin: Vector3;
  private readonly events: PointStreamEvents;

  constructor(origin: Vector3, events: PointStreamEvents) {
    this.origin = origin;
    this.events = events;
  }

  take(block: Uint8Array): void {
    let bytes = this.rest.length ? joined(this.rest, block) : block;
    if (this.layout === null) {
      this.layout = layoutOf(bytes);
      if (this.layout === null) {
        this.rest = bytes.slice();
        return;
      }
      bytes = bytes.subarray(this.layout.headerBytes);
      const { numPoints } = this.layout;
      this.arrays = { positions: new Float32Array(3 * numPoints), colors: new Uint8Array(3 * numPoints) };
      this.events.onBegin(this.arrays, numPoints);
    }
    const used = this.decode(bytes, this.layout);
    this.rest = bytes.slice(used);
    this.events.onPoints(this.numArrived);
  }

  private decode(bytes: Uint8Array, { isDouble, numPoints }: Layout): number {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const size = isDouble ? 8 : 4;
    const rowBytes = 3 * size + 3;
    const count = Math.min(Math.floor(bytes.length / rowBytes), numPoints - this.numArrived);
    const { positions, colors } = this.arrays;
    let to = 3 * this.numArrived;
    for (let row = 0, at = 0; row < count; row += 1, at += rowBytes, to += 3) {
      for (let axis = 0; axis < 3; axis += 1) {
        const value = isDouble ? view.getFloat64(at + axis * size, true) : view.getFloat32(at + axis * size, true);
        positions[to + axis] = value - this.origin[axis]!;
        colors[to + axis] = bytes[at + 3 * size + axis]!;
      }
    }
    this.numArrived += count;
    return count * rowBytes;
  }
}

function layoutOf(bytes: Uint8Array): Layout | null {
  const text = new TextDecoder("latin1").decode(bytes.subarray(0, MOST_HEADER_BYTES));
  const end = text.indexOf(END);
  if (end < 0) {
    if (bytes.length >= MOST_HEADER_BYTES) throw new Error("expected the points as a PLY file, got something else");
    return null;
  }
  const count = /^element vertex (\d+)$/m.exec(text.slice(0, end));
  if (count === null) throw new Error("expected a number of points in the PLY header, got none");
  return { numPoints: Number(count[1]), headerBytes: end + END.length, isDouble: /^property double x$/m.test(text) };
}

function joined(first: Uint8Array, second: Uint8Array): Uint8Array<ArrayBuffer> {
  const all = new Uint8Array(first.length + second.length);
  all.set(first);
  all.set(second, first.length);
  return all;
}
