// Goals: what the pointer draws, what is sent, and what navigation says of it.

import assert from "node:assert/strict";
import { test } from "node:test";
import { CdrReader, CdrWriter } from "../cdr.js";
import { GoalTool, describeNavigation, expireGoals, hasGoal, headingOf, planInMap, refuseGoal, unacceptedGoal } from "../goals.js";
import { writePoseStamped } from "../messages.js";
import { Fleet } from "../state.js";

const view = (/** @type {Uint8Array} */ bytes) => new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
const text = (/** @type {object} */ value) => view(new CdrWriter().string(JSON.stringify(value)).done());

function fleetOfOne() {
  const fleet = new Fleet();
  fleet.setFigures({ robots: [{ number: 1, prefix: "/robot1/" }] }, 0);
  return { fleet, robot: fleet.robots.get(1) };
}

/** A nav_msgs/Path in a frame. */
function path(frame, points) {
  const to = new CdrWriter().i32(0).i32(0).string(frame).i32(points.length);
  for (const [x, y] of points) {
    to.i32(0).i32(0).string(frame);
    [x, y, 0, 0, 0, 0, 1].forEach((value) => to.f64(value));
  }
  return view(to.done());
}

test("a goal is written as PoseStamped", () => {
  const from = new CdrReader(view(writePoseStamped("map", { x: 1.5, y: -2, yaw: Math.PI / 2 })));
  assert.deepEqual(from.header(), { stamp: 0, frame: "map" });
  assert.deepEqual(from.vector(), { x: 1.5, y: -2, z: 0 });
  const { x, y, z, w } = from.quaternion();
  assert.ok(x === 0 && y === 0 && Math.abs(z - Math.SQRT1_2) < 1e-12 && Math.abs(w - Math.SQRT1_2) < 1e-12);
});

test("a drag gives the heading, a click faces away from the robot", () => {
  assert.equal(headingOf({ x: 0, y: 0 }, { x: 0, y: 1 }, 40, { x: 5, y: 5 }), Math.PI / 2);
  assert.equal(headingOf({ x: 2, y: 0 }, { x: 2, y: 0.1 }, 3, { x: 1, y: 0 }), 0);
});

test("the tool sends one goal to the selected robot and switches itself off", () => {
  const { robot } = fleetOfOne();
  const sent = [];
  let selected = null;
  const tool = new GoalTool({
    frame: "map", robot: () => selected, log: () => {}, show: () => {},
    publish: (topic, type) => sent.push([topic, type]) > 0,
  });
  assert.equal(tool.press({ x: 1, y: 1 }), false, "it is off");
  tool.toggle();
  tool.press({ x: 1, y: 1 });
  tool.release();
  assert.deepEqual(sent, [], "no robot is selected");
  selected = robot;
  tool.toggle();
  tool.press({ x: 1, y: 1 });
  tool.move({ x: 1, y: 0 }, 50);
  assert.ok(Math.abs(tool.pose().yaw + Math.PI / 2) < 1e-12);
  tool.release();
  assert.deepEqual(sent, [["/robot1/goal_pose", "geometry_msgs/msg/PoseStamped"]]);
  assert.equal(tool.isOn, false);
});

test("a goal is not accepted until navigation says so", () => {
  const { fleet, robot } = fleetOfOne();
  fleet.receive("/robot1/navigation_state", text({ state: "reached", goal: 4 }), 0);
  robot.sentGoal = { pose: { x: 1, y: 0, yaw: 0 }, after: 4, isAccepted: false };
  fleet.receive("/robot1/navigation_state", text({ state: "reached", goal: 4 }), 0);
  assert.equal(describeNavigation(robot), "goal not accepted yet; before: reached");
  fleet.receive("/robot1/navigation_state", text({ state: "driving", goal: 5, remaining_m: 2.44, reason: "" }), 0);
  assert.equal(unacceptedGoal(robot), null);
  assert.equal(describeNavigation(robot), "driving, 2.4 m to go");
  fleet.receive("/robot1/navigation_state", text({ state: "waiting", goal: 5, waits_for: "robot2" }), 0);
  assert.equal(describeNavigation(robot), "waiting for robot2");
});

test("a plan is shown in the map while its goal lasts", () => {
  const { fleet, robot } = fleetOfOne();
  fleet.frames.set("map", "map_1", { x: 10, y: 0, yaw: 0 }, 0);
  fleet.receive("/robot1/plan", path("map_1", [[0, 0], [1, 0]]), 0);
  assert.equal(planInMap(robot, fleet), null, "no goal");
  fleet.receive("/robot1/navigation_state", text({ state: "driving" }), 0);
  assert.ok(hasGoal(robot));
  assert.deepEqual(planInMap(robot, fleet).map(({ x }) => x), [10, 11]);
  fleet.receive("/robot1/plan", path("nowhere", [[0, 0]]), 0);
  assert.equal(planInMap(robot, fleet), null, "its frame is not known");
});

test("what navigation gives up needs attention", () => {
  const { fleet } = fleetOfOne();
  fleet.receive("/robot1/navigation_state", text({ state: "failed", reason: "no way leads to the goal" }), 0);
  const items = fleet.attention(0, true).map(({ text: item }) => item);
  assert.ok(items.includes("its goal was given up: no way leads to the goal"), String(items));
});

test("a state that is not one is refused", () => {
  const { fleet } = fleetOfOne();
  for (const message of [view(new CdrWriter().string("{").done()), text({}), text({ state: 1 }), text(null)]) {
    assert.throws(() => fleet.receive("/robot1/navigation_state", message, 0), RangeError);
  }
});

test("a goal that is refused, or that nothing accepts in time, is forgotten; one that was accepted is not", () => {
  const { robot } = fleetOfOne();
  const sentAt = (at, isAccepted = false) => { robot.sentGoal = { pose: { x: 1, y: 0, yaw: 0 }, after: 4, isAccepted, at }; };
  sentAt(100);
  assert.deepEqual([expireGoals([robot], 105), unacceptedGoal(robot) !== null], [[], true]);
  assert.deepEqual([expireGoals([robot], 111), unacceptedGoal(robot)], [[robot], null]);
  sentAt(100, true);
  assert.deepEqual([expireGoals([robot], 1000), robot.sentGoal !== null], [[], true]);
  sentAt(100);
  refuseGoal([robot], "'/robot1/cmd_vel': somebody drives it");
  assert.ok(unacceptedGoal(robot));
  refuseGoal([robot], "'/robot1/goal_pose': the emergency stop is set");
  assert.equal(unacceptedGoal(robot), null);
});
