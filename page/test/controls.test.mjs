// What is said of the connections.

import assert from "node:assert/strict";
import { test } from "node:test";
import { describeConnection } from "../controls.js";

test("of the two connections the worse one is told, and that for commands first", () => {
  const [good, silent, closed] = [[true, true], [true, false], [false, false]].map(([isOpen, isAnswering]) => ({ isOpen, isAnswering }));
  assert.equal(describeConnection(good, good), "connected");
  assert.deepEqual([describeConnection(good, silent), describeConnection(good, closed)], ["no answer for maps", "no connection for maps"]);
  for (const maps of [good, silent, closed]) {
    assert.deepEqual([describeConnection(silent, maps), describeConnection(closed, maps)], ["no answer", "no connection"]);
  }
});
