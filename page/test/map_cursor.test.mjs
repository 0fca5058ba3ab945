// The cursor on the map: goals, distances and zones by keyboard alone.

import assert from "node:assert/strict";
import { test } from "node:test";
import { CdrReader } from "../cdr.js";
import { Camera } from "../geometry.js";
import { GoalTool } from "../goals.js";
import { MapCursor } from "../map_cursor.js";
import { MapTools } from "../map_tools.js";
import { MeasureTool } from "../measure.js";
import { readPose } from "../messages.js";
import { SetPoseTool } from "../pose_tool.js";
import { Fleet } from "../state.js";
import { ZoneTool } from "../zones.js";

function map() {
  const fleet = new Fleet();
  fleet.setFigures({ robots: [{ number: 1, prefix: "/robot1/" }] }, 0);
  /** @type {{topic: string, payload: Uint8Array}[]} */
  const sent = [];
  const publish = (topic, _type, payload) => sent.push({ topic, payload }) > 0;
  const camera = Object.assign(new Camera(), { width: 800, height: 600, center: { x: 1, y: 2 } });
  const goals = new GoalTool({ frame: "map", publish, robot: () => fleet.robots.get(1), log: () => {}, show: () => {} });
  const zones = new ZoneTool({ zones: () => [], publish, show: () => {} });
  const tools = new MapTools(camera, goals, new MeasureTool(() => {}), zones, new SetPoseTool({ frame: "map", publish, robot: () => fleet.robots.get(1), log: () => {}, show: () => {} }));
  /** @type {{x: number, y: number}[]} */
  const revealed = [];
  return { tools, cursor: new MapCursor(tools, (at) => revealed.push(at)), sent, revealed };
}

const press = (cursor, ...codes) => codes.map((code) => cursor.key(code, false));

test("keys are the cursor's only while a tool is on", () => {
  const { cursor, tools } = map();
  assert.deepEqual(press(cursor, "ArrowUp", "Enter"), [false, false]);
  assert.equal(cursor.describe(), "");
  tools.goals.toggle();
  assert.deepEqual(press(cursor, "ArrowUp", "KeyW"), [true, false]);
  assert.match(cursor.describe(), /^1\.0 m, 2\.1 m: arrows move/);
});

test("a goal is set with its heading", () => {
  const { cursor, tools, sent } = map();
  tools.goals.toggle();
  press(cursor, "ArrowRight", "Enter", "ArrowUp", "ArrowUp", "ArrowUp", "ArrowUp", "Enter");
  assert.equal(sent[0].topic, "/robot1/goal_pose");
  const from = new CdrReader(new DataView(sent[0].payload.buffer));
  from.header();
  const { x, y } = from.vector();
  assert.ok(Math.abs(x - 1.1) < 1e-9 && Math.abs(y - 2) < 1e-9, `${x}, ${y}`);
  assert.ok(Math.abs(from.quaternion().z - Math.SQRT1_2) < 1e-9, "it faces up");
  assert.equal(tools.isOn, false);
});

test("a key that is held sets nothing: it may be the one that switched the tool on", () => {
  const { cursor, tools, sent } = map();
  tools.goals.toggle();
  for (let repeat = 0; repeat < 3; repeat += 1) assert.equal(cursor.key("Enter", false, true), true);
  assert.deepEqual([sent.length, tools.isHeld], [0, false]);
  cursor.key("ArrowUp", false, true);
  assert.ok(cursor.at !== null, "arrows repeat");
});

test("a zone is drawn, and one that is given up is not sent", () => {
  const { cursor, tools, sent } = map();
  tools.zones.toggle();
  press(cursor, "Enter", "ArrowRight", "ArrowDown", "Backspace", "Enter", "Delete");
  assert.deepEqual(sent, []);
  press(cursor, "Enter", "ArrowRight", "ArrowDown", "Enter");
  assert.equal(sent[0].topic, "/exclusion_zones/add");
});

test("a distance is measured, and one tool switches the others off", () => {
  const { cursor, tools } = map();
  tools.measure.toggle();
  cursor.key("Enter", false);
  cursor.key("ArrowRight", true);
  cursor.key("Enter", false);
  assert.ok(Math.abs(tools.measure.length() - 1) < 1e-9);
  tools.zones.toggle();
  tools.switchOffAllBut(tools.zones);
  assert.deepEqual([tools.measure.isOn, tools.zones.isOn], [false, true]);
});

test("a cursor that leaves the screen is shown", () => {
  const { cursor, tools, revealed } = map();
  tools.measure.toggle();
  for (let step = 0; step < 11; step += 1) cursor.key("ArrowRight", true);
  assert.ok(revealed.length === 1 && revealed[0].x > 11, JSON.stringify(revealed));
});

test("what is drawn to a place outside of the map is not sent, and says so", () => {
  const { tools, sent } = map();
  const draw = () => {
    tools.press({ x: 1, y: 2 });
    tools.move({ x: 3, y: 4 });
    return tools.releaseOutside();
  };
  assert.equal(tools.releaseOutside(), null, "nothing is drawn");
  tools.goals.toggle();
  assert.match(draw(), /^the goal was not sent/);
  assert.deepEqual([tools.isHeld, tools.isOn], [false, true], "it can be drawn again");
  tools.goals.toggle();
  tools.zones.toggle(true);
  assert.match(draw(), /^the zone was not sent/);
  tools.zones.toggle(false);
  tools.measure.toggle(true);
  assert.equal(draw(), null);
  assert.ok(tools.measure.length() > 2, "a distance stays");
  assert.deepEqual(sent, []);
});

test("a pose of a robot is set with its heading, and by a click alone with the one that it has", () => {
  const { cursor, tools, sent } = map();
  tools.setPose.toggle();
  press(cursor, "ArrowRight", "Enter", "ArrowUp", "ArrowUp", "ArrowUp", "ArrowUp", "Enter");
  tools.setPose.of.robot().pose = { x: 0, y: 0, yaw: Math.PI };
  tools.setPose.toggle();
  press(cursor, "Enter", "Enter");
  assert.deepEqual(sent.map(({ topic }) => topic), ["/robot1/initialpose", "/robot1/initialpose"]);
  const [up, kept] = sent.map(({ payload }) => readPose(new DataView(payload.buffer)));
  assert.ok(Math.hypot(up.pose.x - 1.1, up.pose.y - 2, up.pose.yaw - Math.PI / 2) < 1e-9, JSON.stringify(up));
  assert.ok(Math.abs(Math.abs(kept.pose.yaw) - Math.PI) < 1e-9);
  assert.deepEqual([up.frame, up.deviation], ["map", { x: 0.5, y: 0.5, yaw: 0.26 }]);
  assert.equal(tools.isOn, false);
});
