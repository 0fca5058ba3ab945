// Parts of the page that fail keep no other one from what it shows.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Isolation } from "../isolation.js";

test("a part that fails is said once, until it succeeds or fails otherwise; the others go on", () => {
  const [said, done] = [[], []];
  const isolation = new Isolation((text) => said.push(text));
  let error = "a number is missing";
  for (let round = 0; round < 5; round += 1) {
    if (round === 2) error = "";
    if (round === 3) error = "a number is missing";
    isolation.run("the edges", () => { if (error) throw new TypeError(error); });
    isolation.run("the robots", () => done.push(round));
  }
  assert.deepEqual(done, [0, 1, 2, 3, 4]);
  assert.deepEqual(said, Array(2).fill("the edges cannot be shown: a number is missing"));
});
