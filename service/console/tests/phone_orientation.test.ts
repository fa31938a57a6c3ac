import assert from "node:assert/strict";
import { test } from "node:test";

import { angleBetween, cameraOrientation, lookOf, type Quaternion, signed, yawOf } from "../src/phone/orientation.ts";

/** Rotate by the sandwich product, written out independently of the module: v + 2w (q × v) + 2 q × (q × v). */
function rotated([x, y, z, w]: Quaternion, v: [number, number, number]): number[] {
  const cross = (a: number[], b: number[]): number[] => [a[1]! * b[2]! - a[2]! * b[1]!, a[2]! * b[0]! - a[0]! * b[2]!, a[0]! * b[1]! - a[1]! * b[0]!];
  const once = cross([x, y, z], v);
  const twice = cross([x, y, z], once);
  return v.map((value, axis) => value + 2 * w * once[axis]! + 2 * twice[axis]!);
}

function close(found: readonly number[], expected: readonly number[]): void {
  found.forEach((value, axis) => assert.ok(Math.abs(value - expected[axis]!) < 1e-9, `${found} is not ${expected}`));
}

// Alpha, beta, gamma, angle of the screen; where the camera looks, and what is up in its picture. Session: x east, y up, z south.
const POSES: [string, [number, number, number, number], number[], number[]][] = [
  ["flat on a table, top to the north", [0, 0, 0, 0], [0, -1, 0], [0, 0, -1]],
  ["upright, looking north", [0, 90, 0, 0], [0, 0, -1], [0, 1, 0]],
  ["upright, looking west", [90, 90, 0, 0], [-1, 0, 0], [0, 1, 0]],
  ["upright, looking east", [270, 90, 0, 0], [1, 0, 0], [0, 1, 0]],
  ["upright, looking north and up by 30 degrees", [0, 120, 0, 0], [0, 0.5, -Math.sqrt(0.75)], [0, Math.sqrt(0.75), 0.5]],
  // Gamma −90: the right edge is up. The phone was turned to the left, and the page to the right on it.
  ["on its left edge, looking east", [0, 0, -90, 90], [1, 0, 0], [0, 1, 0]],
  ["on its right edge, looking west", [0, 0, 90, 270], [-1, 0, 0], [0, 1, 0]],
];

for (const [name, [alpha, beta, gamma, screen], look, up] of POSES) {
  test(`a phone ${name} sees what it should, with the right side up`, () => {
    const found = cameraOrientation(alpha, beta, gamma, screen);
    close(rotated(found, [0, 0, -1]), look);
    close(rotated(found, [0, 1, 0]), up);
    close(lookOf(found), look);
  });
}

test("turning a phone to the left raises its yaw by as much", () => {
  for (const [from, to] of [[10, 70], [350, 30]] as const) {
    const yaw = (alpha: number): number => yawOf(lookOf(cameraOrientation(alpha, 85, 3, 0)));
    const left = signed(yaw(to) - yaw(from));
    assert.ok(Math.abs(left - signed(to - from)) < 1e-9);
  }
});

test("turning the page on an unmoved phone turns its picture and not its look", () => {
  const [upright, turned] = [0, 90].map((angle) => cameraOrientation(20, 80, 5, angle)) as [Quaternion, Quaternion];
  assert.ok(angleBetween(lookOf(upright), lookOf(turned)) < 1e-6);
  // The right of the turned page is the bottom of the upright one.
  close(rotated(turned, [1, 0, 0]), rotated(upright, [0, -1, 0]));
});
