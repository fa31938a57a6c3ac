import assert from "node:assert/strict";
import { test } from "node:test";

import { Pace } from "../src/scene/paint/webgl_pace.ts";

function framesOf(pace: Pace, pointsPerMs: number, count: number): void {
  for (let frame = 0; frame < count; frame += 1) {
    const points = Math.min(10_000_000, pace.moving);
    pace.note(points, Math.max(16, points / pointsPerMs));
  }
}

test("a machine that draws slowly is asked for as many points as fit a frame, within a few frames", () => {
  const pace = new Pace();
  framesOf(pace, 1500, 8);
  assert.ok(pace.moving / 1500 < 50, `a frame of ${pace.moving} points takes ${pace.moving / 1500} ms`);
});

test("a frame that took seconds slows the next ones down", () => {
  const pace = new Pace();
  const before = pace.moving;
  pace.note(before, 3000);
  assert.ok(pace.moving < before / 2);
});

test("a machine that draws fast is asked for more until all points are drawn", () => {
  const pace = new Pace();
  framesOf(pace, 1_000_000, 60);
  assert.ok(pace.moving > 5_000_000);
});
