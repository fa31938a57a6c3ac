import assert from "node:assert/strict";
import { test } from "node:test";

import type { Vector3 } from "../src/api/types.ts";
import { pickPoint, type Ray } from "../src/scene/pick.ts";
import type { PointChunk } from "../src/scene/point_decoder.ts";

const PIXEL = (2 * Math.tan(Math.PI / 8)) / 900;
/** As points are drawn: one and a half times as wide as they are apart. */
const WIDTH = 0.03;

function chunkOf(points: Vector3[]): PointChunk {
  return { positions: new Float32Array(points.flat()), colors: new Uint32Array(points.length).fill(0xffffffff) };
}

/** Points at random on the wall x = `away`, two metres to each side. */
function wall(away: number, count = 40_000): Vector3[] {
  let state = 1;
  const random = (): number => (state = (state * 48271) % 2147483647) / 2147483647;
  return Array.from({ length: count }, () => [away, 4 * random() - 2, 4 * random() - 2]);
}

function rayTo(target: Vector3, more: Partial<Ray> = {}): Ray {
  const origin = more.origin ?? [0, 0, 0];
  const direction = target.map((value, axis) => value - origin[axis]!) as Vector3;
  const length = Math.hypot(...direction);
  return { origin, direction: direction.map((value) => value / length) as Vector3, near: 0.03, far: 20, cut: Infinity, pixel: PIXEL, ...more };
}

function apart(a: Vector3 | null, b: Vector3): number {
  assert.ok(a, "nothing was hit");
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

test("a click on a wall is where the ray meets it, whatever lies between its points", () => {
  for (const target of [[3, 0.123, 0.456], [3, -1.5, 0.9], [3, 1.2, -1.7]] as Vector3[]) {
    assert.ok(apart(pickPoint([chunkOf(wall(3))], rayTo(target), WIDTH), target) < 0.001);
  }
});

test("a click on a wall seen at an angle of fifteen degrees is as exact", () => {
  const target: Vector3 = [3, 0.2, 0.1];
  const origin: Vector3 = [3 - 2 * Math.sin(Math.PI / 12), 0.2 - 2 * Math.cos(Math.PI / 12), 0.1];
  assert.ok(apart(pickPoint([chunkOf(wall(3))], rayTo(target, { origin }), WIDTH), target) < 0.001);
});

test("what is in front is hit, not what is behind it", () => {
  const picked = pickPoint([chunkOf(wall(6)), chunkOf(wall(2))], rayTo([2, 0.3, 0.3]), WIDTH);
  assert.ok(apart(picked, [2, 0.3, 0.3]) < 0.001);
});

test("what is cut away or nearer than is drawn is not hit", () => {
  const points = chunkOf([...wall(6), ...wall(2).filter(([, , z]) => z > 0)]);
  assert.ok(apart(pickPoint([points], rayTo([6, 0.3, 0.3], { cut: 0 }), WIDTH) ?? [6, 0.3, 0.3], [6, 0.3, 0.3]) < 0.001);
  assert.ok(apart(pickPoint([points], rayTo([6, 0.3, 0.3], { near: 3 }), WIDTH), [6, 0.3, 0.3]) < 0.001);
});

test("in a corner, where there is no plane, the nearest point is taken", () => {
  const floor = wall(0).map(([, a, b]) => [3 - Math.abs(a), b, -1] as Vector3);
  const picked = pickPoint([chunkOf([...wall(3).filter(([, , z]) => z > -1), ...floor])], rayTo([3, 0.1, -1]), WIDTH);
  assert.ok(apart(picked, [3, 0.1, -1]) < WIDTH);
});

test("a single pole is hit where it stands, and empty space is not hit", () => {
  const pole = chunkOf([[2, 0.5, 0.1]]);
  assert.ok(apart(pickPoint([pole], rayTo([2, 0.503, 0.1]), WIDTH), [2, 0.5, 0.1]) < 1e-6);
  assert.equal(pickPoint([pole], rayTo([2, -0.5, 0.1]), WIDTH), null);
});
