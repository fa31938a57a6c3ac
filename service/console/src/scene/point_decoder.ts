/** Turns the bytes of a binary PLY, as they come, into chunks of points. */

import type { Vector3 } from "../api/types.ts";

const END = "end_header\n";
const MOST_HEADER_BYTES = 4096;
/** The first chunk is a picture by itself, as soon as it is there. */
const FIRST_CHUNK = 100_000;
const CHUNK = 262_144;

export interface PointChunk {
  /** (n, 3) metres from the origin that was asked for. */
  positions: Float32Array;
  /** (n,) sRGB as bytes r, g, b, 255 in memory. */
  colors: Uint32Array;
}

interface Layout {
  numPoints: number;
  headerBytes: number;
  isDouble: boolean;
}

export class PointDecoder {
  private rest = new Uint8Array(0);
  private layout: Layout | null = null;
  private numDecoded = 0;
  private filled = 0;
  private chunk: PointChunk = chunkOf(0);
  private readonly origin: Vector3;

  constructor(origin: Vector3) {
    this.origin = origin;
  }

  /** Of the whole stream, null before its header has come. */
  get numPoints(): number | null {
    return this.layout?.numPoints ?? null;
  }

  /** Take the next bytes; return the chunks that they complete. */
  take(block: Uint8Array): PointChunk[] {
    let bytes = this.rest.length ? joined(this.rest, block) : block;
    if (this.layout === null) {
      this.layout = layoutOf(bytes);
      if (this.layout === null) {
        this.rest = bytes.slice();
        return [];
      }
      bytes = bytes.subarray(this.layout.headerBytes);
      this.chunk = chunkOf(Math.min(FIRST_CHUNK, this.layout.numPoints));
    }
    const done: PointChunk[] = [];
    const used = this.decode(bytes, this.layout, done);
    this.rest = bytes.slice(used);
    return done;
  }

  private decode(bytes: Uint8Array, { isDouble, numPoints }: Layout, done: PointChunk[]): number {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const rowBytes = isDouble ? 27 : 15;
    let count = Math.min(Math.floor(bytes.length / rowBytes), numPoints - this.numDecoded);
    let at = 0;
    while (count > 0) {
      const rows = Math.min(count, this.chunk.colors.length - this.filled);
      decodeRows(view, at, rows, isDouble, this.origin, this.chunk, this.filled);
      at += rows * rowBytes;
      count -= rows;
      this.filled += rows;
      this.numDecoded += rows;
      if (this.filled < this.chunk.colors.length) break;
      done.push(this.chunk);
      this.chunk = chunkOf(Math.min(CHUNK, numPoints - this.numDecoded));
      this.filled = 0;
    }
    return at;
  }
}

function decodeRows(view: DataView, from: number, count: number, isDouble: boolean, origin: Vector3, chunk: PointChunk, first: number): void {
  const { positions, colors } = chunk;
  const [x, y, z] = origin;
  const size = isDouble ? 8 : 4;
  for (let row = 0, at = from, to = 3 * first; row < count; row += 1, to += 3) {
    positions[to] = (isDouble ? view.getFloat64(at, true) : view.getFloat32(at, true)) - x;
    positions[to + 1] = (isDouble ? view.getFloat64(at + 8, true) : view.getFloat32(at + 4, true)) - y;
    positions[to + 2] = (isDouble ? view.getFloat64(at + 16, true) : view.getFloat32(at + 8, true)) - z;
    at += 3 * size;
    colors[first + row] = 0xff000000 | (view.getUint8(at + 2) << 16) | (view.getUint8(at + 1) << 8) | view.getUint8(at);
    at += 3;
  }
}

function chunkOf(count: number): PointChunk {
  return { positions: new Float32Array(3 * count), colors: new Uint32Array(count) };
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
