// Keys: the next robot, and which keys drive, select, act, or are the map's.

import assert from "node:assert/strict";
import { test } from "node:test";
import { attachKeys, nextRobot } from "../keys.js";

test("the next robot is the next number, from the last to the first and back", () => {
  assert.equal(nextRobot([], 3, 1), null);
  assert.deepEqual([nextRobot([3, 1, 2], null, 1), nextRobot([3, 1, 2], null, -1)], [1, 3]);
  assert.deepEqual([nextRobot([3, 1, 2], 3, 1), nextRobot([3, 1, 2], 1, -1), nextRobot([3, 1, 2], 1, 1)], [1, 3, 2]);
  assert.equal(nextRobot([5], 5, -1), 5);
});

/** A keyboard of the test's, and what it has done. */
function keyboard(takesKey = () => false) {
  const [done, listeners] = [[], {}];
  const target = { addEventListener: (name, listener) => { listeners[name] = listener; } };
  Object.defineProperty(globalThis, "window", { value: target, configurable: true });
  Object.defineProperty(globalThis, "document", { value: { ...target, hidden: true }, configurable: true });
  const driving = { press: (...key) => done.push(["press", ...key]), release: (code) => done.push(["release", code]), releaseKeys: () => done.push(["releaseKeys"]) };
  attachKeys({
    driving, takesKey, releaseAll: () => done.push(["releaseAll"]), select: (number) => done.push(["select", number]), stop: () => done.push(["stop"]),
    actions: { KeyT: () => done.push(["take over"]) },
  });
  const send = (name, event) => {
    listeners[name]({ repeat: false, preventDefault: () => {}, ...event });
    return done.splice(0);
  };
  return { send, down: (code, event = {}) => send("keydown", { code, ...event }) };
}

test("each key does one thing", () => {
  const { send, down } = keyboard();
  assert.deepEqual(down("KeyW"), [["press", "KeyW", false]]);
  assert.deepEqual(down("ShiftLeft", { repeat: true }), [["press", "ShiftLeft", true]]);
  assert.deepEqual(send("keyup", { code: "KeyW" }), [["release", "KeyW"]]);
  assert.deepEqual([down("Digit2"), down("Numpad3")], [[["select", 2]], [["select", 3]]]);
  assert.deepEqual([down("Digit2", { repeat: true }), down("KeyT"), down("KeyT", { repeat: true }), down("KeyQ")], [[], [["take over"]], [], []]);
  assert.deepEqual([down("Escape"), down("Escape", { repeat: true })], [[["stop"]], []]);
});

test("what may keep the release of a key from the page lets go", () => {
  const { send, down } = keyboard();
  for (const modifier of ["ctrlKey", "metaKey", "altKey"]) assert.deepEqual(down("KeyW", { [modifier]: true }), [["releaseKeys"]]);
  for (const name of ["blur", "contextmenu", "visibilitychange"]) assert.deepEqual(send(name, {}), [["releaseAll"]]);
});

test("a key of the map's cursor drives nothing, and Escape stops all the same", () => {
  const { down } = keyboard(() => true);
  assert.deepEqual(down("ArrowUp"), []);
  assert.deepEqual(down("Escape"), [["stop"]]);
});

test("in the panels beside the map arrows scroll, and letters drive all the same", () => {
  const { down } = keyboard();
  const within = (...selectors) => ({ closest: (of) => (selectors.some((selector) => of.includes(selector)) ? {} : null) });
  for (const code of ["ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight"]) {
    assert.deepEqual(down(code, { target: within("aside") }), []);
    assert.deepEqual(down(code, { target: within() }), [["press", code, false]]);
  }
  assert.deepEqual(down("KeyW", { target: within("aside") }), [["press", "KeyW", false]]);
});
