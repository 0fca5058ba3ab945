// Figures as the panels write them.

import assert from "node:assert/strict";
import { test } from "node:test";
import { format, percent } from "../format.js";

test("what is not known is a dash and never a zero", () => {
  for (const unknown of [null, undefined, NaN, Infinity]) {
    assert.equal(format(unknown, 1, " m"), "–");
    assert.equal(percent(unknown), "–");
  }
  assert.equal(format(0, 1, " m"), "0.0 m");
  assert.equal(percent(0), "0 %");
  assert.equal(percent(0.985, 1), "98.5 %");
});
