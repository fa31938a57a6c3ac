import assert from "node:assert/strict";
import { test } from "node:test";

import type { Vector3 } from "../src/api/types.ts";
import { ScanPoints } from "../src/scene/scan_points.ts";
import { isClear } from "../src/scene/sight.ts";

/** A room of 8 x 4 x 3 metres, with a wall at x = 4 that has a door at y > 3, as points at random. */
function twoRooms(count: number): ScanPoints {
  let state = 7;
  const random = (): number => (state = (state * 48271) % 2147483647) / 2147483647;
  const points: Vector3[] = [];
  while (points.length < count) {
    const [x, y, z] = [8 * random(), 4 * random(), 3 * random()];
    const face = Math.floor(5 * random());
    if (face === 4 && y > 3) continue;
    points.push(([[x, y, 0], [x, y, 3], [x, 0, z], [x, 4, z], [4, y, z]] as Vector3[])[face]!);
  }
  const found = new ScanPoints(count);
  found.add({ positions: new Float32Array(points.flat()), colors: new Uint32Array(count) });
  return found;
}

test("a wall is in the way, a door and the open room are not", () => {
  for (const count of [20_000, 300_000]) {
    const rooms = twoRooms(count);
    assert.equal(isClear(rooms, [2, 1, 1.5], [6, 1.5, 1.5]), false);
    assert.equal(isClear(rooms, [2, 3.5, 1.5], [6, 3.5, 1.5]), true);
    assert.equal(isClear(rooms, [1, 1, 1.5], [3, 3, 1.4]), true);
  }
});
