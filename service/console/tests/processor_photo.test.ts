import assert from "node:assert/strict";
import { test } from "node:test";

import type { CameraOfImage } from "../src/api/types.ts";
import { type Rotation, viewRotation } from "../src/scene/frames.ts";
import { blend, drawPhoto, type PhotoPixels } from "../src/scene/paint/processor_photo.ts";

const LEVEL: Rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
const SIZE = 101;

/** A photo whose pixels are their own column + 1000 * row + 1. */
function numbered(model: CameraOfImage["model"], width: number, height: number, hfov_deg: number): PhotoPixels {
  return { width, height, camera: { model, hfov_deg }, cameraFromMap: LEVEL, pixels: new Uint32Array(width * height).map((_, at) => 1 + (at % width) + 1000 * Math.floor(at / width)) };
}

function seen(photo: PhotoPixels, looking: Rotation, halfDeg: number): (column: number, row: number) => [number, number] | null {
  const layer = new Uint32Array(SIZE * SIZE);
  drawPhoto(layer, SIZE, SIZE, photo, viewRotation(looking), Math.tan((halfDeg / 180) * Math.PI));
  return (column, row) => {
    const value = layer[row * SIZE + column]!;
    return value === 0 ? null : [(value - 1) % 1000, Math.floor((value - 1) / 1000)];
  };
}

test("the middle of a view ahead is the middle of a panorama, and what is to the left is left of it", () => {
  const at = seen(numbered("equirectangular", 720, 360, 360), LEVEL, 45);
  assert.deepEqual(at(50, 50), [360, 180]);
  // 45° less half a pixel to the left, and up.
  assert.ok(Math.abs(at(0, 50)![0] - 270) <= 2, String(at(0, 50)));
  assert.ok(Math.abs(at(50, 0)![1] - 90) <= 2, String(at(50, 0)));
});

test("behind the camera a panorama closes without a gap", () => {
  const at = seen(numbered("equirectangular", 720, 360, 360), [[-1, 0, 0], [0, -1, 0], [0, 0, 1]], 45);
  for (let column = 0; column < SIZE; column += 1) assert.notEqual(at(column, 50), null);
});

for (const model of ["pinhole", "opencv", "opencv_fisheye", "cylindrical"] as const) {
  test(`a photo of a ${model} camera ends at its edges and shows nothing behind it`, () => {
    const photo = numbered(model, 400, 200, 60);
    const at = seen(photo, LEVEL, 45);
    assert.deepEqual(at(50, 50), [200, 100]);
    assert.equal(at(1, 50), null);
    assert.equal(at(50, 1), null);
    const [edge] = at(50 - Math.round(50 * Math.tan((29 / 180) * Math.PI)), 50)!;
    assert.ok(edge < 14, String(edge));
    assert.equal(seen(photo, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]], 45)(50, 50), null);
  });
}

test("a photo laid half over points is half of both, and leaves those that it does not show", () => {
  const out = new Uint32Array(2);
  blend(out, new Uint32Array([0xff204060, 0xff204060]), new Uint32Array([0xff604020, 0]), 0.5);
  assert.deepEqual([...out].map((each) => each.toString(16)), ["ff404040", "ff204060"]);
});
