import assert from "node:assert/strict";
import { test } from "node:test";

import { tintedColors } from "../src/scene/change_tint.ts";

const CELLS = [
  { center: [0.075, 0.075, 0.075], share: 1 },
  { center: [-1.425, 3.075, 0.375], share: 0.5 },
] satisfies { center: [number, number, number]; share: number }[];
const BLUE = 0xffff0000;

function bytesOf(color: number): [number, number, number] {
  return [color & 255, (color >> 8) & 255, (color >> 16) & 255];
}

test("points in a cell turn red, more so the more answers agree, and those beside it grey", () => {
  const positions = new Float32Array([0.01, 0.14, 0.1, 0.16, 0.01, 0.01, -1.49, 3.14, 0.31]);
  const [changed, beside, partly] = [...tintedColors({ positions, colors: new Uint32Array(3).fill(BLUE) }, CELLS, 0.15)].map(bytesOf);
  assert.ok(changed![0] > 150 && changed![2] < 80, String(changed));
  assert.ok(partly![0] > beside![0] && partly![0] < changed![0], String(partly));
  assert.equal(beside![0], beside![1]);
  assert.ok(beside![2] < 255 && beside![2] > beside![0], String(beside));
});

test("the colours themselves stay, for when nothing is to be tinted any more", () => {
  const colors = new Uint32Array([BLUE]);
  tintedColors({ positions: new Float32Array(3), colors }, CELLS, 0.15);
  assert.equal(colors[0], BLUE);
});
