// A session's frames: the buttons are read in each of them.

import assert from "node:assert/strict";
import { test } from "node:test";
import { XrSession } from "../xr_session.js";

/** A session whose device does not know where it is. */
function lost() {
  const calls = [];
  const handlers = Object.fromEntries(["input", "update", "draw", "ended", "failed", "moved"].map((name) => [name, () => calls.push(name)]));
  const listeners = {};
  const session = {
    enabledFeatures: [], renderState: { baseLayer: { framebuffer: null } }, requestAnimationFrame() {}, end: async () => {},
    addEventListener: (name, listener) => { listeners[name] = listener; },
  };
  const space = { addEventListener: (name, listener) => { listeners[name] = listener; } };
  const renderer = { gl: { canvas: { addEventListener() {} } }, begin() {}, dispose: () => calls.push("dispose") };
  const xr = new XrSession(session, space, renderer, handlers);
  return { xr, calls, listeners };
}

test("while the headset does not know where it is, its buttons still stop the robots, and nothing is drawn", () => {
  const { xr, calls } = lost();
  xr.frame(0, { getViewerPose: () => null });
  assert.deepEqual(calls, ["input"]);
});

test("a floor that is set anew is told, and a session that ends gives the graphics processor's memory back", () => {
  const { calls, listeners } = lost();
  listeners.reset();
  listeners.end();
  assert.deepEqual(calls, ["moved", "ended", "dispose"]);
});
