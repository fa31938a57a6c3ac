import assert from "node:assert/strict";
import { test } from "node:test";

import { isSureEnough, sentence, sureWords, verdictWords } from "../src/state/words.ts";

test("what was placed by hand says so and passes any least confidence", () => {
  const byHand = { confidence: 0.01, placed_by: "hand" } as const;
  const found = { confidence: 0.4, placed_by: "engine" } as const;
  assert.deepEqual([byHand, found].map((answer) => verdictWords({ ...answer, status: "localized" })), ["Placed by hand", "Doubtful"]);
  assert.deepEqual([byHand, found].map(sureWords), ["by hand", "40\u00a0%"]);
  assert.deepEqual([byHand, found].map((answer) => isSureEnough(answer, 0.5)), [true, false]);
});

test("what the service says to programs is no part of its sentences", () => {
  const said = "cameras.0: a zoom (a crop, say): search it within bounds (hfov_range_deg, --hfov 45-90), see plan (old_plan.png) (see /docs)";
  assert.equal(sentence(said), "A zoom (a crop, say): search it within bounds, see plan (old_plan.png).");
  assert.equal(sentence("state it (geoid_undulation_m) or list it (GET /maps)"), "State it or list it.");
});
