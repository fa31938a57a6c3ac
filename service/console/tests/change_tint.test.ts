import assert from "node:assert/strict";
import { test } from "node:test";

import { tintPoints } from "../src/scene/change_tint.ts";

const CELLS = [
  { center: [0.075, 0.075, 0.075], share: 1 },
  { center: [-1.425, 3.075, 0.375], share: 0.5 },
] satisfies { center: [number, number, number]; share: number }[];

test("points in a cell get its tint, those beside it none", () => {
  const positions = new Float32Array([0.01, 0.14, 0.1, 0.16, 0.01, 0.01, -1.49, 3.14, 0.31]);
  const tints = new Uint8Array(3).fill(9);
  tintPoints(tints, positions, 0, 3, CELLS, 0.15);
  assert.deepEqual([...tints], [255, 0, 128]);
});

test("without cells nothing is tinted", () => {
  const tints = new Uint8Array(2).fill(9);
  tintPoints(tints, new Float32Array(6), 0, 2, [], 0);
  assert.deepEqual([...tints], [0, 0]);
});
