import assert from "node:assert/strict";
import { test } from "node:test";

import { naturally } from "../src/state/natural_order.ts";

test("numbers in names count as numbers", () => {
  const names = ["pano_19.jpg", "pano_2.jpg", "Pano_1.jpg", "a/10.jpg", "a/9.jpg"].map((name) => ({ name }));
  assert.deepEqual(naturally(names).map(({ name }) => name), ["a/9.jpg", "a/10.jpg", "Pano_1.jpg", "pano_2.jpg", "pano_19.jpg"]);
});
