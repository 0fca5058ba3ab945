import assert from "node:assert/strict";
import { test } from "node:test";
import { SCALES, answerText } from "../tlx.js";

test("an answer has all six ratings, and is none before", () => {
  const ratings = new Map();
  for (const [key] of SCALES) {
    assert.equal(answerText(ratings), null);
    ratings.set(key, 5 * ratings.size);
  }
  assert.deepEqual(JSON.parse(answerText(ratings) ?? ""), {
    mental_demand: 0, physical_demand: 5, temporal_demand: 10, performance: 15, effort: 20, frustration: 25,
  });
});
