import assert from "node:assert/strict";
import { test } from "node:test";

import { directionsTo, type Stop } from "../src/scene/tour_directions.ts";

const everywhere = (): boolean => true;
const at = (number: number, x: number, y: number): Stop => ({ number, name: `${number}.jpg`, position: [x, y, 1.6] });

test("arrows lead to the nearest photo of each direction", () => {
  const found = directionsTo(at(0, 1, 1), [at(0, 1, 1), at(1, 4, 1), at(2, 2, 1.1), at(3, 1, -1), at(4, 1.01, 1)], everywhere);
  assert.deepEqual(found.map(({ stop }) => stop.number), [2, 3]);
  assert.ok(Math.abs(found[1]!.bearing + Math.PI / 2) < 1e-9);
  assert.ok(Math.abs(found[1]!.distance - 2) < 1e-9);
});

test("directions on both sides of the seam at half a turn are one", () => {
  assert.equal(directionsTo(at(0, 0, 0), [at(1, -1, 0.01), at(2, -2, -0.01)], everywhere).length, 1);
});

test("no arrow points through a wall: the nearest photo in sight takes its place", () => {
  const found = directionsTo(at(0, 0, 0), [at(1, 1, 0), at(2, 2, 0), at(3, 0, 3)], ({ number }) => number !== 1);
  assert.deepEqual(found.map(({ stop }) => stop.number), [2, 3]);
});

test("there are never more arrows than lie beside each other", () => {
  const around = [...Array(40).keys()].map((index) => at(index + 1, Math.cos(index), Math.sin(index)));
  const bearings = directionsTo(at(0, 0, 0), around, everywhere).map(({ bearing }) => bearing).sort((a, b) => a - b);
  assert.ok(bearings.length >= 4);
  assert.ok(bearings.every((bearing, index) => index === 0 || bearing - bearings[index - 1]! >= Math.PI / 4));
});
