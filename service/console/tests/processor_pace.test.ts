import assert from "node:assert/strict";
import { test } from "node:test";

import { ProcessorPace } from "../src/scene/paint/processor_pace.ts";

/** Draw pictures on a machine that needs so long for one of full size; return how long the last one took. */
function lastOf(pace: ProcessorPace, count: number, fullMs: number): number {
  let taken = 0;
  for (let picture = 0; picture < count; picture += 1) {
    taken = 8 + fullMs * pace.fineness ** 2;
    pace.note(taken);
  }
  return taken;
}

test("a fast machine gets pictures as fine as the page", () => {
  const pace = new ProcessorPace();
  lastOf(pace, 100, 15);
  assert.equal(pace.fineness, 1);
});

test("a slow machine gets coarser pictures, until more than twenty a second come", () => {
  const pace = new ProcessorPace();
  assert.ok(lastOf(pace, 100, 300) < 50);
  assert.ok(pace.fineness < 0.6);
});

test("one picture that came late changes nothing", () => {
  const pace = new ProcessorPace();
  lastOf(pace, 100, 15);
  pace.note(900);
  assert.equal(pace.fineness, 1);
});

test("a coarser picture has fewer points, as dense as before", () => {
  const pace = new ProcessorPace();
  assert.equal(pace.numPoints(100_000) / 100_000, pace.numPoints(400_000) / 400_000);
});
