// The hint: the most important reason why nothing drives is said, whatever else holds.

import assert from "node:assert/strict";
import { test } from "node:test";
import { hintText } from "../hint.js";

const FREE = {
  isReplay: false, isOpen: true, isAnswering: true, isStopUnconfirmed: false, isStopped: false, mustSelect: false, isHeld: false, otherDriver: null,
  mustLetGo: false, cursor: "",
};

test("each reason has its text, and an earlier one comes before a later one", () => {
  const held = { isHeld: true };
  const reasons = [
    [{ isOpen: false }, /No connection/], [{ isAnswering: false }, /does not answer/], [{ isStopUnconfirmed: true }, /not confirmed/],
    [{ isStopped: true }, /Emergency stop is set/], [{ ...held, mustSelect: true }, /Select a robot/],
    [{ ...held, otherDriver: "10.0.0.8" }, /^10\.0\.0\.8 drives this robot\. Press T/], [{ mustLetGo: true }, /Let go/], [{ cursor: "Enter sets" }, /^Enter sets$/],
  ];
  assert.equal(hintText(FREE), "");
  for (const [i, [reason, wanted]] of reasons.entries()) {
    const later = Object.assign({}, ...reasons.slice(i).map(([other]) => other).reverse());
    assert.match(hintText({ ...FREE, ...reason }), wanted);
    assert.match(hintText({ ...FREE, ...later }), wanted);
  }
  assert.match(hintText({ ...FREE, isReplay: true }), /Replay/);
  assert.match(hintText({ ...FREE, isReplay: true, isOpen: false }), /No connection/);
  assert.equal(hintText({ ...FREE, otherDriver: "10.0.0.8" }), "", "nobody holds anything");
});
