import assert from "node:assert/strict";
import { test } from "node:test";

import { camerasOf } from "../src/state/view_angle.ts";

test("an angle of view is sent as what is known of it", () => {
  assert.equal(camerasOf(null), undefined);
  assert.deepEqual(camerasOf(69), [{ model: "pinhole", unless_panorama: true, hfov_deg: 69 }]);
  assert.deepEqual(camerasOf([45, 90]), [{ model: "pinhole", unless_panorama: true, hfov_range_deg: [45, 90] }]);
});
