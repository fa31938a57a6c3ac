import assert from "node:assert/strict";
import { test } from "node:test";

import type { MapStats } from "../src/api/types.ts";
import { floorAt, heightOnFloor, sectionOf, storeyOf } from "../src/plan/floors.ts";

const bounds = { min: [0, 0, -0.2], max: [10, 8, 8] };
const none = { bounds, floors: [] } as unknown as MapStats;
const three = { bounds, floors: [{ level_m: 0, height_m: 2.5 }, { level_m: 2.9, height_m: null }, { level_m: 5.8, height_m: null }] } as unknown as MapStats;

test("what stands on a floor belongs to it, what lies below all to the lowest", () => {
  assert.deepEqual([-5, 1.6, 2.8, 4.4, 7].map((height) => floorAt(three, height)), [0, 0, 0, 1, 2]);
  assert.equal(floorAt(none, 1.6), 0);
});

test("a storey ends at its ceiling, at the next floor, or with the scan", () => {
  assert.deepEqual([0, 1, 2].map((number) => storeyOf(three, number)), [{ bottom: 0, top: 2.5 }, { bottom: 2.9, top: 5.8 }, { bottom: 5.8, top: 8 }]);
  assert.deepEqual(storeyOf(none, 0), { bottom: -0.2, top: 8 });
});

test("a camera keeps its height above the floor when it goes to another one", () => {
  assert.equal(heightOnFloor(three, 1.5, 1).toFixed(6), "4.400000");
  assert.equal(heightOnFloor(three, 4.4, 0).toFixed(6), "1.500000");
  assert.equal(heightOnFloor(none, 1.6, 0).toFixed(6), "1.600000");
});

test("a section shows its floor, and neither its ceiling nor the storey below", () => {
  for (const [number, level] of [[0, 0], [1, 2.9], [2, 5.8]] as const) {
    const { bottom, top } = sectionOf(three, number);
    assert.ok(bottom < level - 0.1 && top > level + 1.6, String(number));
    assert.ok(top < storeyOf(three, number).top - 0.2, String(number));
    if (number) assert.ok(bottom > storeyOf(three, number - 1).top - 0.6, String(number));
  }
});
