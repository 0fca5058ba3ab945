// The buttons of the emergency stop, in a page of the test's.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Fleet } from "../state.js";
import { StopButtons } from "../stop_buttons.js";

/** A page with the two buttons, a clock of the test's, and what was sent. */
function page() {
  const listeners = {};
  const button = (id) => ({ hidden: true, disabled: false, classList: { toggle() {} }, addEventListener: (_name, listener) => { listeners[id] = listener; } });
  const buttons = { stop: button("stop"), release: button("release") };
  Object.defineProperty(globalThis, "document", { value: { getElementById: (id) => buttons[id] }, configurable: true });
  const state = { now: 0, sent: [], said: [] };
  const fleet = new Fleet();
  const it = new StopButtons({
    fleet, now: () => state.now, log: (text) => state.said.push(text), changed() {},
    sendStop: () => state.sent.push("stop") > 0, sendRelease: () => state.sent.push("release") > 0,
  });
  const told = (isStopped) => {
    fleet.isStopped = isStopped;
    it.receive();
  };
  return { buttons, state, it, told, press: (id) => listeners[id]() };
}

test("whatever is pressed within a second after a stop, the stop stays", () => {
  for (let tenths = 0; tenths < 10; tenths += 1) {
    const { buttons, state, told, press } = page();
    press("stop");
    told(true);
    state.now = tenths / 10;
    press("release");
    assert.deepEqual([state.sent, buttons.release.disabled], [["stop"], true]);
  }
});

test("a stop is released by a press that comes later", () => {
  const { buttons, state, it, told, press } = page();
  press("stop");
  state.now = 0.2;
  told(true);
  state.now = 1.3;
  it.show();
  assert.deepEqual([buttons.release.hidden, buttons.release.disabled], [false, false]);
  press("release");
  assert.deepEqual(state.sent, ["stop", "release"]);
  told(false);
  assert.equal(buttons.release.hidden, true);
});

test("a stop that is asked for while one is set is confirmed by what comes afterwards alone, and sent again until then", () => {
  const { state, it, told, press } = page();
  told(true);
  state.now = 30;
  press("stop");
  it.show();
  assert.equal(it.asked.isAsked, true, "what the page knew before may be old");
  it.asked.repeat();
  assert.deepEqual(state.sent, ["stop", "stop"]);
  told(false);
  assert.equal(it.asked.isAsked, true, "somebody released the one before");
  told(true);
  assert.equal(it.asked.isAsked, false);
});
