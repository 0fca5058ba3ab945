// Driving by hand: what is shown is what is sent, within the robot's limits, to the topics of the robot that is there now.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Driving } from "../driving.js";
import { Fleet } from "../state.js";

/** A gamepad whose dead man's switch is held and whose stick is pushed forward. */
const HELD_PAD = { mapping: "standard", index: 0, id: "pad", axes: [0, -1], buttons: Array.from({ length: 8 }, () => ({ pressed: true })) };

/** Driving of one robot in a browser of the test's: with or without a connection, focus and a gamepad. */
function page() {
  const state = { isConnected: true, isStopped: false, driver: null, hasFocus: true, pad: null, headset: null };
  Object.defineProperty(globalThis, "document", { value: { hasFocus: () => state.hasFocus }, configurable: true });
  Object.defineProperty(globalThis, "navigator", { value: { getGamepads: () => (Array.isArray(state.pad) ? state.pad : [state.pad]) }, configurable: true });
  const fleet = new Fleet();
  const robot = (prefix) => fleet.setFigures({ robots: [{ number: 1, prefix, linear_max_m_s: 0.15, angular_max_rad_s: 1.5 }] }, 0);
  robot("/robot1/");
  const sent = [];
  const driving = new Driving({
    fleet, selected: () => 1, headset: () => state.headset,
    situation: () => ({ isStopped: state.isStopped, isConnected: true, robot: "1 1", driver: state.driver }),
    publish: (topic, _type, payload) => {
      const view = new DataView(payload.buffer, payload.byteOffset);
      if (state.isConnected) sent.push([topic, view.getFloat64(4, true), view.getFloat64(4 + 40, true)]);
      return state.isConnected;
    },
  });
  driving.observe();
  return { state, driving, sent, robot };
}

test("the velocity that is shown is the one that is sent, and none is shown that is not", () => {
  const { state, driving, sent } = page();
  driving.press("KeyW", false);
  driving.press("KeyD", false);
  driving.press("ShiftLeft", false);
  assert.deepEqual(driving.tick(), { linear: 0.15, angular: -1.5 });
  assert.deepEqual(sent.at(-1), ["/robot1/cmd_vel", 0.15, -1.5]);
  driving.release("ShiftLeft");
  const { linear, angular } = driving.tick();
  assert.ok(Math.abs(linear - 0.09) < 1e-9 && Math.abs(angular + 0.9) < 1e-9);
  state.isConnected = false;
  assert.deepEqual(driving.tick(), { linear: 0, angular: 0 }, "it was not sent");
});

test("velocities go to the topic of the robot that has the number now", () => {
  const { driving, sent, robot } = page();
  robot("/alice/");
  driving.press("KeyW", false);
  driving.tick();
  assert.equal(sent.at(-1)[0], "/alice/cmd_vel");
});

test("a key that repeats is not pressed anew", () => {
  const { driving } = page();
  driving.press("KeyW", false);
  driving.releaseKeys();
  driving.press("KeyW", true);
  assert.equal(driving.tick().linear, 0);
  driving.release("KeyW");
  driving.press("KeyW", false);
  assert.ok(driving.tick().linear > 0);
});

test("a press that ends between two velocities counts as rest", () => {
  const { state, driving } = page();
  driving.press("KeyW", false);
  state.isStopped = true;
  driving.tick();
  state.isStopped = false;
  assert.equal(driving.tick().linear, 0);
  assert.equal(driving.isWaiting, true);
  driving.release("KeyW");
  driving.press("KeyW", false);
  assert.ok(driving.tick().linear > 0);
});

test("a gamepad that is held while the window has no focus, or when it is found, must be let go first", () => {
  const { state, driving } = page();
  const open = { ...HELD_PAD, buttons: [] };
  state.pad = HELD_PAD;
  assert.equal(driving.tick().linear, 0, "found while it is held");
  state.pad = open;
  driving.tick();
  state.pad = HELD_PAD;
  assert.equal(driving.tick().linear, 0.15);
  state.hasFocus = false;
  assert.equal(driving.tick().linear, 0);
  state.hasFocus = true;
  assert.equal(driving.tick().linear, 0, "held all the time");
  state.pad = open;
  driving.tick();
  state.pad = HELD_PAD;
  assert.equal(driving.tick().linear, 0.15);
});

test("a key that was held while somebody else drove drives nothing when the lease ends", () => {
  const { state, driving, sent } = page();
  state.driver = "other";
  driving.press("KeyW", false);
  assert.deepEqual([driving.tick().linear, driving.isRefused, driving.isWaiting], [0, true, false]);
  assert.equal(sent.length, 0, "nothing is tried that could be taken when the lease ends");
  state.driver = null;
  for (let i = 0; i < 100; i += 1) assert.equal(driving.tick().linear, 0);
  assert.equal(driving.isWaiting, true);
  driving.release("KeyW");
  driving.press("KeyW", false);
  assert.equal(driving.tick().linear > 0, true);
});

test("after a takeover a new press drives before the bridge names the new driver, but not for ever", () => {
  const { state, driving } = page();
  state.driver = "other";
  driving.press("KeyD", false);
  driving.tick();
  driving.takeOver();
  assert.equal(driving.tick().angular, 0, "it was held before");
  driving.release("KeyD");
  driving.press("KeyW", false);
  assert.ok(driving.tick().linear > 0);
  // The bridge names nobody else meanwhile: the takeover came to nothing.
  for (let i = 0; i < 60; i += 1) driving.tick();
  assert.equal(driving.tick().linear, 0);
  state.driver = null;
  assert.equal(driving.tick().linear, 0);
});

for (const known of /** @type {const} */ ([null, "me"])) test(`a takeover drives when the other driver is named late, after ${known ?? "nobody"}`, () => {
  const { state, driving } = page();
  state.driver = known;
  driving.takeOver();
  driving.press("KeyW", false);
  assert.ok(driving.tick().linear > 0);
  // The figures of before the takeover name the driver who was taken over.
  state.driver = "other";
  assert.ok(driving.tick().linear > 0);
  state.driver = "me";
  assert.ok(driving.tick().linear > 0);
  state.driver = "other";
  assert.equal(driving.tick().linear, 0, "somebody has taken it back");
});

test("a refusal ends a takeover, and a takeover that succeeded is over", () => {
  const { state, driving } = page();
  state.driver = "other";
  driving.takeOver();
  driving.press("KeyW", false);
  assert.ok(driving.tick().linear > 0);
  driving.refuse();
  assert.equal(driving.tick().linear, 0);
  driving.release("KeyW");
  driving.takeOver();
  driving.press("KeyW", false);
  state.driver = "me";
  assert.ok(driving.tick().linear > 0);
  state.driver = "other";
  assert.equal(driving.tick().linear, 0, "somebody has taken it back");
});

/** A gamepad that is held, or let go. */
const pad = (index, isHeld, mapping = "standard") => ({ ...HELD_PAD, index, id: `pad ${index}`, mapping, buttons: HELD_PAD.buttons.map(() => ({ pressed: isHeld })) });

test("a gamepad whose buttons the browser does not know drives nothing, and hides none that it knows", () => {
  const { state, driving } = page();
  state.pad = [pad(0, false, "")];
  driving.tick();
  state.pad = [pad(0, true, "")];
  assert.equal(driving.tick().linear, 0, "which button is the dead man's switch is not known");
  state.pad = [pad(0, true, ""), null, pad(1, false)];
  driving.tick();
  driving.tick();
  state.pad = [pad(0, true, ""), null, pad(1, true)];
  assert.ok(driving.tick().linear > 0);
});

test("what a gamepad holds when it takes the place of another one must be let go", () => {
  const { state, driving } = page();
  const hold = (...pads) => {
    state.pad = pads;
    return driving.tick().linear;
  };
  for (const [others, next] of [[[pad(0, true)], [pad(1, true)]], [[pad(0, true), pad(1, false)], [pad(0, false), pad(1, true)]]]) {
    hold(...others.map(({ index }) => pad(index, false)));
    hold(...others.map(({ index }) => pad(index, false)));
    assert.ok(hold(...others) > 0);
    assert.equal(hold(...next), 0);
    assert.equal(hold(...next), 0, "it stays so");
    hold(...next.map(({ index }) => pad(index, false)));
    assert.ok(hold(...next) > 0);
  }
});
