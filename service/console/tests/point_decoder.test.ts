import assert from "node:assert/strict";
import { test } from "node:test";

import { PointDecoder, type PointArrays } from "../src/scene/point_decoder.ts";

function ply(points: [number, number, number][], kind: "float" | "double"): Uint8Array {
  const header = `ply\nformat binary_little_endian 1.0\nelement vertex ${points.length}\n${["x", "y", "z"].map((axis) => `property ${kind} ${axis}\n`).join("")}property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n`;
  const size = kind === "float" ? 4 : 8;
  const body = new DataView(new ArrayBuffer(points.length * (3 * size + 3)));
  points.forEach((point, row) => {
    const at = row * (3 * size + 3);
    point.forEach((value, axis) => (size === 4 ? body.setFloat32(at + axis * 4, value, true) : body.setFloat64(at + axis * 8, value, true)));
    [10, 20, 30 + row].forEach((value, channel) => body.setUint8(at + 3 * size + channel, value));
  });
  return new Uint8Array([...new TextEncoder().encode(header), ...new Uint8Array(body.buffer)]);
}

function decoded(bytes: Uint8Array, blockBytes: number, origin: [number, number, number]): [PointArrays, number] {
  let arrays: PointArrays = { positions: new Float32Array(0), colors: new Uint8Array(0) };
  let arrived = 0;
  const decoder = new PointDecoder(origin, { onBegin: (given) => (arrays = given), onPoints: (count) => (arrived = count) });
  for (let at = 0; at < bytes.length; at += blockBytes) decoder.take(bytes.subarray(at, at + blockBytes));
  return [arrays, arrived];
}

for (const blockBytes of [1, 7, 100, 10_000]) {
  test(`points arrive whole however the stream is cut, here every ${blockBytes} bytes`, () => {
    const [arrays, arrived] = decoded(ply([[1, 2, 3], [4, 5, 6], [7, 8, 9]], "float"), blockBytes, [1, 1, 1]);
    assert.equal(arrived, 3);
    assert.deepEqual([...arrays.positions], [0, 1, 2, 3, 4, 5, 6, 7, 8]);
    assert.deepEqual([...arrays.colors], [10, 20, 30, 10, 20, 31, 10, 20, 32]);
  });
}

test("survey coordinates keep their millimetres", () => {
  const [arrays] = decoded(ply([[500_000.125, 5_800_000.001, 31]], "double"), 64, [500_000, 5_800_000, 0]);
  assert.ok(Math.abs(arrays.positions[1]! - 0.001) < 1e-6);
});

test("what is no PLY is refused", () => {
  assert.throws(() => decoded(new Uint8Array(5000).fill(65), 5000, [0, 0, 0]), /expected the points as a PLY file/);
});
