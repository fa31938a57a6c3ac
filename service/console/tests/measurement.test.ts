import assert from "node:assert/strict";
import { test } from "node:test";

import type { Place, Vector3 } from "../src/api/types.ts";
import { measured, northOf, scaleBar } from "../src/scene/measurement.ts";

const FAR: Vector3 = [691_000, 5_334_000, 520];
const at = (x: number, y: number, z: number): Vector3 => [FAR[0] + x, FAR[1] + y, FAR[2] + z];

test("lengths add up along the points, and height and plan are from the first to the last", () => {
  const found = measured([at(0, 0, 0), at(3, 0, 4), at(3, 4, 4)]);
  assert.ok(Math.abs(found.length - 9) < 1e-9);
  assert.ok(Math.abs(found.horizontal - 5) < 1e-9);
  assert.ok(Math.abs(found.height - 4) < 1e-9);
});

test("an area is that of the polygon on its own plane, at large coordinates too", () => {
  // A square of two metres on a plane that is tilted by 45 degrees, and an L on the floor.
  const side = Math.SQRT2;
  assert.ok(Math.abs(measured([at(0, 0, 0), at(2, 0, 0), at(2, side, side), at(0, side, side)]).area! - 4) < 1e-6);
  const corners: [number, number][] = [[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]];
  assert.ok(Math.abs(measured(corners.map(([x, y]) => at(x, y, 0))).area! - 6) < 1e-6);
  assert.equal(measured([at(0, 0, 0), at(1, 0, 0)]).area, null);
});

test("a scale bar is a round length that fits", () => {
  for (const [metresPerPixel, metres] of [[0.01, 1], [0.03, 2], [0.05, 5], [0.0007, 0.05], [1, 100]] as const) {
    const bar = scaleBar(metresPerPixel, 120);
    assert.ok(Math.abs(bar.metres - metres) < 1e-9, `${metresPerPixel}: ${bar.metres}`);
    assert.ok(bar.pixels <= 120 && bar.pixels > 40);
  }
});

test("north is turned from the y axis against the clock by the heading of that axis", () => {
  // An axis that points east: north is to the left of it.
  const east = northOf({ georeference: { heading_deg: 90 }, coordinate_system: null } as unknown as Place);
  assert.ok(Math.abs(Math.cos(east.angle) + 1) < 1e-9);
  assert.equal(northOf({ georeference: null, coordinate_system: null } as unknown as Place).letter, "y");
});
