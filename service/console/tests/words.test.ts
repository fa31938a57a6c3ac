import assert from "node:assert/strict";
import { test } from "node:test";

import { isSureEnough, sureWords, verdictWords } from "../src/state/words.ts";

test("what was placed by hand says so and passes any least confidence", () => {
  const byHand = { confidence: 0.01, placed_by: "hand" } as const;
  const found = { confidence: 0.4, placed_by: "engine" } as const;
  assert.deepEqual([byHand, found].map((answer) => verdictWords({ ...answer, status: "localized" })), ["Placed by hand", "Doubtful"]);
  assert.deepEqual([byHand, found].map(sureWords), ["by hand", "40\u00a0%"]);
  assert.deepEqual([byHand, found].map((answer) => isSureEnough(answer, 0.5)), [true, false]);
});
