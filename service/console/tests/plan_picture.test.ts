import assert from "node:assert/strict";
import { test } from "node:test";

import { closeHoles } from "../src/plan/plan_picture.ts";

const RED = 0xff0000ff;
const BLUE = 0xffff0000;

/** Return a square of red and blue columns in the middle of an empty picture. */
function picture(): Uint32Array {
  const pixels = new Uint32Array(20 * 20);
  for (let row = 5; row < 15; row += 1) for (let column = 5; column < 15; column += 1) pixels[row * 20 + column] = column < 10 ? RED : BLUE;
  return pixels;
}

test("small gaps get the colour around them", () => {
  const pixels = picture();
  const whole = pixels.slice();
  for (const hole of [7 * 20 + 7, 7 * 20 + 8, 8 * 20 + 7, 12 * 20 + 12]) pixels[hole] = 0;
  closeHoles(pixels, 20, 20);
  assert.deepEqual(pixels, whole);
});

test("between two colours it is their mean", () => {
  const pixels = picture();
  for (let row = 5; row < 15; row += 1) pixels[row * 20 + 10] = row === 9 ? 0 : RED;
  closeHoles(pixels, 20, 20);
  // Three blue ones and five red ones around it.
  assert.equal(pixels[9 * 20 + 10], (255 * 2 ** 24 + 96 * 2 ** 16 + 159) >>> 0);
});

test("what lies outside stays empty", () => {
  const pixels = picture();
  closeHoles(pixels, 20, 20);
  assert.deepEqual(pixels, picture());
});
