import assert from "node:assert/strict";
import { test } from "node:test";

import { handBody, likelyHeight, roughPlace } from "../src/state/hand_pose.ts";

test("a pose that was turned left by a quarter looks along y", () => {
  const body = handBody("map_1", { position: [1, 2, 3], yawDeg: 90, upDeg: 0, leanDeg: 0 }) as { pose: { map_from_camera: { position_m: object; quaternion: { z: number; w: number } } } };
  const { position_m, quaternion } = body.pose.map_from_camera;
  assert.deepEqual(position_m, { x: 1, y: 2, z: 3 });
  assert.ok(Math.abs(quaternion.z - Math.SQRT1_2) < 1e-9 && Math.abs(quaternion.w - Math.SQRT1_2) < 1e-9);
});

test("of a camera that leans to the right, the left side is up", () => {
  const { rotation } = roughPlace({ position: [0, 0, 0], yawDeg: 0, upDeg: 0, leanDeg: 10 });
  assert.ok(rotation[2][1] > 0.17);
});

test("pairs are sent as they were clicked", () => {
  const body = handBody("map_1", [{ pixel: [10, 20], position: [1, 2, 3] }]);
  assert.deepEqual(body, { map_id: "map_1", pairs: [{ pixel: [10, 20], position_m: [1, 2, 3] }] });
});

test("a camera stands as high as the others, or as eyes above the floor", () => {
  assert.equal(likelyHeight([1.7, 1.2, 1.4], 0, 3), 1.4);
  assert.equal(likelyHeight([], 10, 13), 11.5);
  assert.equal(likelyHeight([], 0, 1), 0.6);
});
