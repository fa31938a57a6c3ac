import assert from "node:assert/strict";
import { test } from "node:test";

import { PerspectiveCamera } from "three";

import { clear, drawPoints, type Picture, pictureOf, type Projection } from "../src/scene/paint/processor_points.ts";

const [BACKGROUND, RED, GREEN] = [0xff000000, 0xff0000ff, 0xff00ff00];
const SIZE = 101;

/** A camera at the origin that looks along +y, 90° wide. */
function projection(cut = Infinity): Projection {
  const camera = new PerspectiveCamera(90, 1, 0.1, 100);
  camera.up.set(0, 0, 1);
  camera.lookAt(0, 1, 0);
  camera.updateMatrixWorld();
  return { clipFromScene: camera.projectionMatrix.multiply(camera.matrixWorldInverse).elements, near: 0.1, cut, pixelsPerRadian: SIZE / 2 };
}

function drawn(points: [number, number, number][], colors: number[], width = 0, behind = 0, by = projection()): Picture {
  const picture = pictureOf(SIZE, SIZE);
  clear(picture, BACKGROUND);
  drawPoints(picture, by, new Float32Array(points.flat()), new Uint32Array(colors), 0, points.length, width, behind);
  return picture;
}

function pixelsOf(picture: Picture, color: number): [number, number][] {
  return [...picture.pixels.entries()].filter(([, value]) => value === color).map(([at]) => [at % SIZE, Math.floor(at / SIZE)]);
}

test("a point is drawn where the camera sees it", () => {
  assert.deepEqual(pixelsOf(drawn([[0, 2, 0]], [RED]), RED), [[50, 50]]);
  // Half way to the right edge and half way up.
  assert.deepEqual(pixelsOf(drawn([[1, 2, 1]], [RED]), RED), [[75, 25]]);
});

test("what is behind the camera, beside the picture or above the cut is not drawn", () => {
  assert.equal(pixelsOf(drawn([[0, -2, 0], [9, 2, 0], [-9, 2, 0], [0, 2, 9]], [RED, RED, RED, RED]), RED).length, 0);
  assert.equal(pixelsOf(drawn([[0, 2, 0.5]], [RED], 0, 0, projection(0.4)), RED).length, 0);
});

test("the nearer point hides the other, whichever comes first", () => {
  const [near, far] = [[0, 2, 0], [0, 3, 0]] as [[number, number, number], [number, number, number]];
  assert.equal(pixelsOf(drawn([near, far], [RED, GREEN]), GREEN).length, 0);
  assert.equal(pixelsOf(drawn([far, near], [GREEN, RED]), GREEN).length, 0);
});

test("a wide point is a square about its middle, smaller when farther away, and ends at the edge", () => {
  const near = pixelsOf(drawn([[0, 2, 0]], [RED], 0.2), RED);
  assert.deepEqual([near.length, near[0], near.at(-1)], [25, [48, 48], [52, 52]]);
  assert.equal(pixelsOf(drawn([[0, 4, 0]], [RED], 0.2), RED).length, 9);
  const edge = pixelsOf(drawn([[-1.99, 2, 0]], [RED], 0.4), RED);
  assert.ok(edge.length > 0 && edge.every(([column]) => column < 8), String(edge));
});

test("coarse points moved behind fill gaps alone", () => {
  const picture = drawn([[0, 2, 0]], [RED]);
  drawPoints(picture, projection(), new Float32Array([0, 2, 0]), new Uint32Array([GREEN]), 0, 1, 0.12, 0.1);
  assert.deepEqual(pixelsOf(picture, RED), [[50, 50]]);
  assert.equal(pixelsOf(picture, GREEN).length, 8);
});
