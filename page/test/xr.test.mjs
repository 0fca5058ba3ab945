// Mixed reality: each button has its own place, and the floor takes goals only where it is known what of the map it is.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Fleet } from "../state.js";
import { MixedReality } from "../xr.js";
import { commandsOf } from "../xr_commands.js";

/** Mixed reality of a page of the test's, and what it has done. */
function reality() {
  globalThis.localStorage = { getItem: () => null, setItem() {}, removeItem() {} };
  const [fleet, done, state] = [new Fleet(), [], { mayRelease: true }];
  fleet.setFigures({ robots: [{ number: 1, prefix: "/robot1/" }] }, 0);
  const operator = {
    fleet, selected: () => 1, select() {}, selectNext() {}, log() {}, now: () => 0, mayRelease: () => state.mayRelease,
    stop: () => done.push("stop"), release: () => done.push("release"), takeOver: () => done.push("take over"), command: (what) => done.push(what),
    isConnected: () => true, mustLetGo: () => false, isRefused: () => false, isStopUnconfirmed: () => false,
    floorSelected: (point) => done.push(point),
  };
  return { it: new MixedReality(operator, () => {}), fleet, robot: fleet.robots.get(1), done, state };
}

test("whatever the fleet does, no button stands where another one stood, and nothing but the stop is at its place", () => {
  const { it, fleet, robot, state } = reality();
  /** @type {Map<number, Set<string>>} */
  const texts = new Map();
  for (let bits = 0; bits < 128; bits += 1) {
    const has = (bit) => Boolean(bits & (1 << bit));
    fleet.isStopped = has(0);
    state.mayRelease = has(1);
    robot.navigation = has(2) ? { state: has(3) ? "paused" : "driving", reason: "", goal: 1, remainingM: null, waitsFor: null } : null;
    robot.figures = { driver: has(4) ? "somebody" : null, is_mine: has(5) };
    it.alignment.steps = has(6) ? { frame: "map", inFrame: { x: 0, y: 0, yaw: 0 }, inMap: { x: 0, y: 0, yaw: 0 }, name: "robot1", place: null } : null;
    commandsOf(it).forEach((command, place) => {
      if (command) texts.set(place, (texts.get(place) ?? new Set()).add(command.text));
    });
  }
  assert.deepEqual([...texts].sort(([a], [b]) => a - b).map(([, of]) => [...of].sort()), [
    ["Stop all"], ["Align map", "Cancel"], ["Release stop"], ["Cancel goal"], ["Drive on"], ["Take over"], ["Table-top"], ["Use my room"], ["Leave"],
  ]);
});

test("a stop is released only while that is meant, and a goal is given up or driven on to", () => {
  const { it, fleet, robot, done, state } = reality();
  const press = (text) => commandsOf(it).find((command) => command?.text === text)?.press();
  fleet.isStopped = true;
  state.mayRelease = false;
  press("Release stop");
  press("Stop all");
  state.mayRelease = true;
  press("Release stop");
  fleet.isStopped = false;
  robot.navigation = { state: "paused", reason: "", goal: 1, remainingM: null, waitsFor: null };
  press("Drive on");
  press("Cancel goal");
  assert.deepEqual(done, ["stop", "release", "resume", "cancel"]);
});

test("in life size a goal is set on the floor only if the map is aligned; on the table always", () => {
  const { it, done } = reality();
  const down = { origin: [0, 1, -2], direction: [0, -1, 0] };
  it.select(down, {});
  assert.deepEqual([done.length, it.noticeText(true)], [0, "align the map first: where this is in it is not known"]);
  it.table = { pose: { x: 0, y: 0, yaw: 0 }, scale: 0.5, height: 0 };
  it.select(down, {});
  assert.equal(done.length, 1);
  it.showLifeSize();
  it.isAligned = true;
  it.select(down, {});
  assert.deepEqual(done.map(({ x, y }) => [x, Math.abs(y)]), [[4, 0], [2, 0]]);
});
