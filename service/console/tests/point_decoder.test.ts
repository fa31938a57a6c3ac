import assert from "node:assert/strict";
import { test } from "node:test";

import { PointDecoder } from "../src/scene/point_decoder.ts";

function ply(points: [number, number, number][], kind: "float" | "double"): Uint8Array {
  const header = `ply\nformat binary_little_endian 1.0\nelement vertex ${points.length}\n${["x", "y", "z"].map((axis) => `property ${kind} ${axis}\n`).join("")}property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n`;
  const size = kind === "float" ? 4 : 8;
  const start = new TextEncoder().encode(header);
  const bytes = new Uint8Array(start.length + points.length * (3 * size + 3));
  bytes.set(start);
  const body = new DataView(bytes.buffer, start.length);
  points.forEach((point, row) => {
    const at = row * (3 * size + 3);
    point.forEach((value, axis) => (size === 4 ? body.setFloat32(at + axis * 4, value, true) : body.setFloat64(at + axis * 8, value, true)));
    [10, 20, row % 251].forEach((value, channel) => body.setUint8(at + 3 * size + channel, value));
  });
  return bytes;
}

/** Return positions and colours, and how many points each chunk has. */
function decoded(bytes: Uint8Array, blockBytes: number, origin: [number, number, number]): { positions: number[]; colors: number[]; sizes: number[] } {
  const found = { positions: [] as number[], colors: [] as number[], sizes: [] as number[] };
  const decoder = new PointDecoder(origin);
  for (let at = 0; at < bytes.length; at += blockBytes) {
    for (const chunk of decoder.take(bytes.subarray(at, at + blockBytes))) {
      for (const value of chunk.positions) found.positions.push(value);
      for (const value of chunk.colors) found.colors.push(value);
      found.sizes.push(chunk.colors.length);
    }
  }
  return found;
}

for (const blockBytes of [1, 7, 100, 10_000]) {
  test(`points arrive whole however the stream is cut, here every ${blockBytes} bytes`, () => {
    const { positions, colors } = decoded(ply([[1, 2, 3], [4, 5, 6], [7, 8, 9]], "float"), blockBytes, [1, 1, 1]);
    assert.deepEqual(positions, [0, 1, 2, 3, 4, 5, 6, 7, 8]);
    assert.deepEqual(colors, [0, 1, 2].map((row) => (0xff000000 | (row << 16) | (20 << 8) | 10) >>> 0));
  });
}

test("a long stream comes as a small first chunk and larger ones, in order and without a gap", () => {
  const points = Array.from({ length: 400_001 }, (_, row) => [row, 0, 0] as [number, number, number]);
  const { positions, sizes } = decoded(ply(points, "float"), 65_536, [0, 0, 0]);
  assert.ok(sizes.length > 2 && sizes[0]! < sizes[1]!, String(sizes));
  assert.equal(positions.length, 3 * points.length);
  assert.ok(points.every(([x], row) => positions[3 * row] === x));
});

test("survey coordinates keep their millimetres", () => {
  const { positions } = decoded(ply([[500_000.125, 5_800_000.001, 31]], "double"), 64, [500_000, 5_800_000, 0]);
  assert.ok(Math.abs(positions[1]! - 0.001) < 1e-6);
});

test("what is no PLY is refused", () => {
  assert.throws(() => decoded(new Uint8Array(5000).fill(65), 5000, [0, 0, 0]), /expected the points as a PLY file/);
});
