import assert from "node:assert/strict";
import { test } from "node:test";

import type { Pose } from "../src/api/types.ts";
import { applied, directionAngles, levelRotation, placeOf, poseText, quaternionOf, type Rotation, viewRotation } from "../src/scene/frames.ts";

const LEVEL: Rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

function poseAt(rotation: Rotation, position: [number, number, number]): Pose {
  const [x, y, z] = position;
  const matrix = [...rotation.map((row, index) => [...row, position[index] ?? 0]), [0, 0, 0, 1]];
  return {
    frame: "ros", yaw_deg: 0, pitch_deg: 0, roll_deg: 0, heading_deg: 0, elevation_deg: 0, camera_roll_deg: 0, north: "map",
    map_from_camera: { position_m: { x, y, z }, quaternion: { x: 0, y: 0, z: 0, w: 1 }, matrix },
  };
}

function close(found: readonly number[], expected: readonly number[]): void {
  assert.equal(found.length, expected.length);
  found.forEach((value, index) => assert.ok(Math.abs(value - expected[index]!) < 1e-9, `${found} is not ${expected}`));
}

test("a three.js camera looks where the photographed one looked, with the same side up", () => {
  const rotation = viewRotation(LEVEL);
  close(applied(rotation, [0, 0, -1]), [1, 0, 0]);
  close(applied(rotation, [0, 1, 0]), [0, 0, 1]);
  close(applied(rotation, [1, 0, 0]), [0, -1, 0]);
});

test("yaw turns to the left and pitch up", () => {
  const rotation = levelRotation(Math.PI / 2, Math.PI / 6);
  close(applied(rotation, [1, 0, 0]), [0, Math.cos(Math.PI / 6), 0.5]);
  close(directionAngles(rotation), [Math.PI / 2, Math.PI / 6]);
});

test("large survey coordinates are moved before they become 32 bits", () => {
  const place = placeOf(poseAt(LEVEL, [500_001.25, 5_800_002.5, 31.75]), [500_000, 5_800_000, 30]);
  close(place.position, [1.25, 2.5, 1.75]);
});

test("a pose in webxr has y up and looks along minus z", () => {
  const said = JSON.parse(poseText(poseAt(LEVEL, [1, 2, 3]), "webxr")).map_from_camera as Pose["map_from_camera"];
  close([said.position_m.x, said.position_m.y, said.position_m.z], [1, 3, -2]);
  const rows = said.matrix.slice(0, 3).map((row) => row.slice(0, 3)) as Rotation;
  close(applied(rows, [0, 0, -1]), [1, 0, 0]);
  close(applied(rows, [0, 1, 0]), [0, 1, 0]);
});

test("quaternions of half turns and small turns have w not below zero and length one", () => {
  for (const [yaw, pitch] of [[0, 0], [Math.PI, 0], [3, 1.2], [-2.5, -0.4]] as const) {
    const q = quaternionOf(levelRotation(yaw, pitch));
    assert.ok(q[3] >= 0);
    assert.ok(Math.abs(Math.hypot(...q) - 1) < 1e-12);
  }
  close(quaternionOf(levelRotation(Math.PI / 2, 0)), [0, 0, Math.SQRT1_2, Math.SQRT1_2]);
});
