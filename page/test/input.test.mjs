// Keys, gamepad and stick: a robot moves only while something is held.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Driver, gamepadDeflection, keyDeflection, stickDeflection, thumbstickDeflection, withDeadzone } from "../input.js";

test("keys drive while they are held, and opposite keys cancel", () => {
  assert.equal(keyDeflection(new Set()), null);
  assert.equal(keyDeflection(new Set(["ShiftLeft"])), null);
  assert.deepEqual(keyDeflection(new Set(["KeyW"])), { forward: 0.6, left: 0 });
  assert.deepEqual(keyDeflection(new Set(["KeyW", "ShiftLeft", "KeyD"])), { forward: 1, left: -1 });
  assert.deepEqual(keyDeflection(new Set(["KeyW", "ArrowDown"])), { forward: 0, left: 0 });
});

test("a gamepad drives only while its dead man's switch is held", () => {
  const pad = (pressed) => ({ axes: [0, -1], buttons: Array.from({ length: 8 }, (_, i) => ({ pressed: pressed.includes(i) })) });
  assert.equal(gamepadDeflection(null), null);
  assert.equal(gamepadDeflection(pad([])), null);
  assert.equal(gamepadDeflection(pad([0])), null);
  assert.deepEqual(gamepadDeflection(pad([5])), { forward: 1, left: 0 });
});

test("a headset's thumbstick drives only while the grip is held, behind the deadzone, up to one", () => {
  const pad = (pressed, x, y) => ({ axes: [1, 1, x, y], buttons: Array.from({ length: 6 }, (_, i) => ({ pressed: pressed.includes(i) })) });
  assert.equal(thumbstickDeflection(pad([], 0, -1)), null);
  assert.equal(thumbstickDeflection(pad([0, 2, 3, 4, 5], 0, -1)), null, "other buttons are no dead man's switch");
  assert.deepEqual(thumbstickDeflection(pad([1], 0, -1)), { forward: 1, left: 0 });
  assert.deepEqual(thumbstickDeflection(pad([1], -1, 0.05)), { forward: 0, left: 1 });
  assert.deepEqual(thumbstickDeflection(pad([1], 3, -9)), { forward: 1, left: -1 });
  assert.deepEqual(thumbstickDeflection(pad([1], NaN, NaN)), { forward: 0, left: 0 });
  assert.deepEqual(thumbstickDeflection({ axes: [], buttons: [] }), null);
});

test("a deflection begins at zero behind the deadzone and ends at one", () => {
  assert.equal(withDeadzone(0.1), 0);
  assert.equal(withDeadzone(NaN), 0);
  assert.ok(withDeadzone(0.13) > 0 && withDeadzone(0.13) < 0.02);
  assert.equal(withDeadzone(1), 1);
  assert.equal(withDeadzone(-7), -1);
  assert.deepEqual(stickDeflection(0, -1), { forward: 1, left: 0 });
  assert.deepEqual(stickDeflection(-1, 0), { forward: 0, left: 1 });
});

test("a robot that is let go gets zeros, and then nothing", () => {
  const driver = new Driver();
  const hold = { forward: 1, left: 0 };
  assert.deepEqual(driver.tick(null, 1), []);
  assert.deepEqual(driver.tick(hold, null), [], "no robot is selected");
  assert.deepEqual(driver.tick(hold, 1), [{ robot: 1, forward: 1, left: 0 }]);
  for (let i = 0; i < 3; i += 1) assert.deepEqual(driver.tick(null, 1), [{ robot: 1, forward: 0, left: 0 }]);
  assert.deepEqual(driver.tick(null, 1), []);
});

test("the robot before stops when another one is selected while driving", () => {
  const driver = new Driver();
  const hold = { forward: 1, left: 0 };
  driver.tick(hold, 1);
  assert.deepEqual(driver.tick(hold, 2), [{ robot: 1, forward: 0, left: 0 }, { robot: 2, forward: 1, left: 0 }]);
  assert.deepEqual(driver.tick(hold, 2), [{ robot: 2, forward: 1, left: 0 }]);
});
