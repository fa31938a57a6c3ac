import assert from "node:assert/strict";
import { test } from "node:test";
import { compose, difference, inverse, length, matrixOf, moved, rotationOf, rotationVector, transform, type Motion } from "../src/poses.ts";
import { anchor, scanPoint } from "../src/three.ts";
import { Group, Vector3 } from "three";

const near = (found: readonly number[], wanted: readonly number[]): void =>
  found.forEach((value, index) => assert.ok(Math.abs(value - wanted[index]!) < 1e-9, `${found} is not ${wanted}`));
const a: Motion = { position_m: { x: 1, y: -2, z: 0.5 }, quaternion: rotationOf({ x: 0.3, y: -1.1, z: 0.7 }) };
const b: Motion = { position_m: { x: -0.2, y: 0.4, z: 3 }, quaternion: rotationOf({ x: -2, y: 0.5, z: 0.1 }) };
const point = { x: 0.7, y: -0.3, z: 1.9 };

test("motions compose, invert and divide", () => {
  near(Object.values(transform(compose(a, b), point)), Object.values(transform(a, transform(b, point))));
  near(Object.values(transform(inverse(a), transform(a, point))), Object.values(point));
  near(Object.values(rotationVector(a.quaternion)), [0.3, -1.1, 0.7]);
  near(Object.values(rotationVector(rotationOf({ x: 0, y: 4, z: 0 }))), [0, 4 - 2 * Math.PI, 0]);
  const way = difference(a, b);
  assert.ok(length(difference(moved(b, way, 1), a).turn_rad) < 1e-9);
  assert.ok(Math.abs(length(difference(moved(b, way, 0.5), b).turn_rad) - length(way.turn_rad) / 2) < 1e-9);
});

test("the quarter turn about the vertical takes forward to the left", () => {
  near(Object.values(transform({ position_m: { x: 0, y: 0, z: 0 }, quaternion: rotationOf({ x: 0, y: Math.PI / 2, z: 0 }) }, { x: 0, y: 0, z: -1 })), [-1, 0, 0]);
});

test("three.js shows content of the scan where the map is, and nothing while that is not known", () => {
  const group = new Group();
  group.add(new Group());
  group.children[0]!.position.copy(scanPoint(1, 2, 3) as Vector3);
  anchor(group, { sessionFromMap: null });
  assert.equal(group.visible, false);
  anchor(group, { sessionFromMap: a });
  group.updateMatrixWorld();
  assert.equal(group.visible, true);
  near(group.children[0]!.getWorldPosition(new Vector3()).toArray(), Object.values(transform(a, { x: 1, y: 3, z: -2 })));
  near(matrixOf(a).slice(12), [1, -2, 0.5, 1]);
});
