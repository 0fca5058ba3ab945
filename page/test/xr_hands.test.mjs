// The left hand's pinch drives while it is held, and nothing else does.

import assert from "node:assert/strict";
import { test } from "node:test";
import { HandStick } from "../xr_hands.js";

/** A frame in which the fingertips of a hand are so far apart around a place; no place: the hand is not seen. */
const seen = (handedness, place, gap = 0.005) => {
  const hand = new Map([["thumb-tip", -gap / 2], ["index-finger-tip", gap / 2]]);
  const position = (aside) => ({ transform: { position: { x: place[0] + aside, y: place[1], z: place[2] } } });
  return [{ inputSources: [{ hand, handedness }] }, { getJointPose: (aside) => (place ? position(aside) : null) }];
};
const open = (place) => seen("left", place, 0.08);
const step = (stick, [session, frame], heading = 0) => stick.update(session, frame, null, heading);
const near = (deflection, forward, left) => {
  assert.ok(deflection && Math.abs(deflection.forward - forward) < 1e-6 && Math.abs(deflection.left - left) < 1e-6, JSON.stringify(deflection));
};

test("a pinch that moves away from the viewer drives forward, to the left it turns left", () => {
  const stick = new HandStick();
  assert.equal(step(stick, open([0, 1, 0])), null);
  near(step(stick, seen("left", [0, 1, 0])), 0, 0);
  near(step(stick, seen("left", [0, 1, -0.1])), 1, 0);
  near(step(stick, seen("left", [-0.2, 1.3, 0])), 0, 1);
  near(step(stick, seen("left", [0.005, 1, 0.005])), 0, 0);
});

test("ahead is where the viewer looked when the fingers closed", () => {
  const stick = new HandStick();
  step(stick, open([0, 1, 0]));
  // A quarter turn to the left: ahead is -x.
  step(stick, seen("left", [0, 1, 0]), Math.PI / 2);
  near(step(stick, seen("left", [-0.1, 1, 0]), 0), 1, 0);
  near(step(stick, seen("left", [0, 1, 0.1]), 0), 0, 1);
});

test("opening the fingers or losing the hand lets go, and a hand found closed must open first", () => {
  const stick = new HandStick();
  step(stick, open([0, 1, 0]));
  step(stick, seen("left", [0, 1, 0]));
  assert.notEqual(step(stick, seen("left", [0, 1, -0.1], 0.025)), null, "a little open is held still");
  assert.equal(step(stick, open([0, 1, -0.1])), null);
  near(step(stick, seen("left", [0, 1, -0.1])), 0, 0);
  assert.equal(step(stick, seen("left", null)), null, "lost");
  assert.equal(step(stick, seen("left", [0, 1, -0.2])), null, "found closed");
  step(stick, open([0, 1, -0.2]));
  near(step(stick, seen("left", [0, 1, -0.2])), 0, 0);
});

test("the other hand and controllers are no stick", () => {
  const stick = new HandStick();
  step(stick, seen("right", [0, 1, 0], 0.08));
  assert.equal(step(stick, seen("right", [0, 1, 0])), null);
  assert.equal(stick.update({ inputSources: [{ handedness: "left", hand: null }] }, {}, null, 0), null);
});
