// Pointers on the map: one draws, two move the view and draw nothing.

import assert from "node:assert/strict";
import { test } from "node:test";
import { attachPointers } from "../pointers.js";

/** A map with a tool that is on, and what was done with it. */
function map(isOn = true) {
  const [listeners, done] = [{}, []];
  const canvas = { addEventListener: (name, listener) => { listeners[name] = listener; }, setPointerCapture() {} };
  Object.defineProperty(globalThis, "document", { value: { elementFromPoint: () => canvas }, configurable: true });
  const tools = {
    isHeld: false,
    press() { this.isHeld = isOn; if (isOn) done.push("press"); return isOn; },
    move() {}, release() { this.isHeld = false; done.push("send"); }, cancel() { this.isHeld = false; done.push("cancel"); },
  };
  const view = { canvas, camera: { toWorld: (at) => at, pan() {} }, robotAt: () => 7 };
  attachPointers({ view, fleet: {}, tools, select: (robot) => done.push(robot), zoom: () => done.push("zoom"), show() {}, log() {} });
  const send = (name, pointerId, x = 0) => listeners[name]({ pointerId, button: 0, buttons: 1, offsetX: x, offsetY: 0, clientX: x, clientY: 0 });
  return { send, done, tools };
}

test("one finger draws and sends", () => {
  const { send, done } = map();
  send("pointerdown", 1);
  send("pointermove", 1, 30);
  send("pointerup", 1, 30);
  assert.deepEqual(done, ["press", "send"]);
});

for (const [name, lifted] of [["first", [1, 2]], ["second", [2, 1]]]) {
  test(`two fingers send no goal and select no robot, though they do not move and the ${name} is lifted first`, () => {
    for (const isOn of [true, false]) {
      const { send, done } = map(isOn);
      send("pointerdown", 1);
      send("pointerdown", 2, 100);
      lifted.forEach((id) => send("pointerup", id));
      assert.deepEqual(done, isOn ? ["press", "cancel"] : []);
    }
  });
}

test("two fingers zoom", () => {
  const { send, done } = map();
  send("pointerdown", 1);
  send("pointerdown", 2, 100);
  send("pointermove", 2, 150);
  assert.deepEqual(done, ["press", "cancel", "zoom"]);
});

test("what the keyboard draws is not ended by a pointer", () => {
  const { send, done, tools } = map(false);
  tools.isHeld = true;
  send("pointerdown", 1);
  tools.isHeld = true;
  send("pointerup", 1);
  assert.deepEqual(done, [7]);
});
