// What the page knows of the fleet, and what it says of it.

import assert from "node:assert/strict";
import { test } from "node:test";
import { CdrWriter } from "../cdr.js";
import { writeBool } from "../messages.js";
import { Fleet } from "../state.js";

const FIGURES = {
  robots: [
    { number: 1, prefix: "/robot1/", slam: "tracking", is_merged: true },
    { number: 2, prefix: "/robot2/", slam: "tracking", is_merged: true },
  ],
  merged_known_m2: 5,
};

/** A message of one transform. */
function transform(parent, child, x, y, stamp = 1) {
  return transforms([[parent, child, x, y]], stamp);
}

/** A message with several transforms: parent, child, x and y of each. */
function transforms(links, stamp) {
  const message = new CdrWriter();
  const u32 = (value) => message.number(4, (view) => view.setUint32(0, value, true));
  const string = (text) => {
    u32(text.length + 1);
    message.bytes.push(...new TextEncoder().encode(`${text}\0`));
  };
  u32(links.length);
  for (const [parent, child, x, y] of links) {
    message.i32(stamp);
    u32(0);
    string(parent);
    string(child);
    [x, y, 0, 0, 0, 0, 1].forEach((value) => message.f64(value));
  }
  return new DataView(message.done().buffer);
}

function fleetWithPose() {
  const fleet = new Fleet();
  fleet.setFigures(FIGURES, 0);
  fleet.robots.get(1).baseFrame = "base_footprint_1";
  fleet.receive("/tf", transform("map", "odom_1", 1, 0), 1);
  fleet.receive("/tf", transform("odom_1", "base_footprint_1", 2, 3), 1);
  return fleet;
}

test("robots are found once, with their own colours and shapes", () => {
  const fleet = new Fleet();
  assert.deepEqual(fleet.setFigures(FIGURES, 0).added.map((robot) => robot.name), ["robot1", "robot2"]);
  assert.deepEqual(fleet.setFigures(FIGURES, 1), { added: [], gone: [] });
  const [first, second] = fleet.robots.values();
  assert.ok(first.colour !== second.colour && first.corners !== second.corners);
  assert.deepEqual(fleet.area, [{ at: 0, m2: 5 }, { at: 1, m2: 5 }]);
});

test("a robot's pose is that of its base in the map", () => {
  const robot = fleetWithPose().robots.get(1);
  assert.deepEqual(robot.pose, { x: 3, y: 3, yaw: 0 });
  assert.equal(robot.trail.length, 1);
});

test("a correction that moves a robot far is a jump, for a minute; driving and small corrections are none", () => {
  const fleet = fleetWithPose();
  const jumps = (now) => fleet.attention(now, true).filter(({ key }) => key.startsWith("jump")).map(({ key, text }) => [key, text]);
  fleet.receive("/tf", transform("odom_1", "base_footprint_1", 5, 3), 2);
  fleet.receive("/tf", transform("map", "odom_1", 1.2, 0), 3);
  fleet.receive("/tf", transform("odom_1", "base_footprint_1", 5, 3), 3);
  assert.deepEqual(jumps(3), []);
  fleet.receive("/tf", transform("map", "odom_1", 2.2, 0), 4);
  fleet.receive("/tf", transform("odom_1", "base_footprint_1", 5, 3), 4);
  assert.deepEqual(jumps(4), [["jump 1 1", "its pose jumped by 1.0 m and 0°: look whether its map fits"]]);
  fleet.receive("/tf", transform("odom_1", "base_footprint_1", 5, 3), 5);
  assert.equal(jumps(5).length, 1);
  assert.deepEqual(jumps(65), []);
});

test("a robot that stands without a goal and a driver for long is idle", () => {
  const fleet = fleetWithPose();
  const robot = fleet.robots.get(1);
  const isIdle = (now) => fleet.attention(now, true).some(({ key }) => key === "idle 1");
  assert.equal(isIdle(120), false);
  assert.equal(isIdle(125), true);
  robot.figures = { ...robot.figures, driver: "10.0.0.1:5" };
  assert.equal(isIdle(125), false, "somebody drives it");
  robot.figures = { ...robot.figures, driver: null };
  robot.navigation = { state: "blocked", reason: "", goal: 1, remainingM: null, waitsFor: null };
  assert.equal(isIdle(125), false, "it has a goal");
  robot.navigation = null;
  fleet.receive("/tf", transform("odom_1", "base_footprint_1", 2.2, 3), 125);
  assert.equal(isIdle(126), false, "it has moved");
});

test("the way of scans to the screen is their median, each scan once", () => {
  const { robots } = fleetWithPose();
  const robot = robots.get(1);
  const fleet = Object.assign(new Fleet(), { robots });
  fleet.recordDrawn(1);
  assert.equal(robot.toScreenMs(), null);
  [[1, 1.02], [1, 1.5], [2, 2.03], [3, 3.5]].forEach(([at, drawn]) => {
    robot.scanAt = at;
    fleet.recordDrawn(drawn);
  });
  assert.ok(Math.abs(robot.toScreenMs() - 30) < 1e-6, String(robot.toScreenMs()));
});

test("a pose becomes stale when no transform of the robot comes, whatever others send", () => {
  const fleet = fleetWithPose();
  fleet.receive("/tf", transform("map", "odom_1", 1, 0), 5);
  fleet.receive("/tf", transform("odom_2", "base_footprint_2", 2, 3), 5);
  const robot = fleet.robots.get(1);
  assert.equal(robot.isStale(1.5), false);
  assert.equal(robot.isStale(5), true);
  assert.deepEqual(robot.pose, { x: 3, y: 3, yaw: 0 }, "it stays where it was seen last");
});

test("what is lost comes before what is late, and a link that is down before everything", () => {
  const fleet = new Fleet();
  fleet.setFigures({ robots: [{ ...FIGURES.robots[0], is_merged: false }, { ...FIGURES.robots[1], slam: "lost" }] }, 0);
  fleet.robots.get(1).scanAt = 0;
  fleet.robots.get(2).scanAt = 10;
  const texts = fleet.attention(10, false).map((item) => `${item.robot ?? ""} ${item.text}`);
  assert.deepEqual(texts, [
    " no connection to the bridge", "2 SLAM is lost", "1 no scan for 10 s", "1 its map is not merged",
  ]);
});

test("two things about one robot are two items, and each keeps its key while its numbers change", () => {
  const fleet = new Fleet();
  fleet.setFigures({ robots: [{ ...FIGURES.robots[0], map_age_s: 12.3, is_map_old: true }] }, 0);
  fleet.robots.get(1).scanAt = 0;
  const keys = (now) => fleet.attention(now, true).filter(({ robot }) => robot === 1).map(({ key }) => key);
  assert.deepEqual(keys(10), ["scan 1", "map 1"], "both are of rank 3: acknowledging one must not hide the other");
  assert.deepEqual(keys(11), keys(10));
});

test("a map whose SLAM process is silent is said to be old", () => {
  const fleet = new Fleet();
  fleet.setFigures({ robots: [{ ...FIGURES.robots[0], map_age_s: 12.3, is_map_old: true }, { ...FIGURES.robots[1], map_age_s: 0.4, is_map_old: false }] }, 0);
  fleet.robots.get(1).scanAt = fleet.robots.get(2).scanAt = 0;
  assert.deepEqual(fleet.attention(0, true).map((item) => `${item.robot} ${item.text}`), ["1 its part of the map is 12 s old"]);
});

test("the emergency stop is known only when the bridge has said so", () => {
  const fleet = new Fleet();
  assert.equal(fleet.isStopped, null);
  fleet.receive("/emergency_stop", new DataView(writeBool(true).buffer), 0);
  assert.equal(fleet.isStopped, true);
  assert.equal(fleet.attention(0, true)[0].text, "emergency stop is set");
});

test("a broken message changes nothing", () => {
  const fleet = fleetWithPose();
  assert.throws(() => fleet.receive("/merged_map", new DataView(new ArrayBuffer(20)), 2), RangeError);
  assert.equal(fleet.map, null);
});

test("a run's time that is behind is another run: what belongs to the old one is forgotten", () => {
  const fleet = new Fleet();
  fleet.setFigures({ robots: [{ number: 1, prefix: "/robot1/" }], merged_known_m2: 3 }, 0);
  const robot = fleet.robots.get(1);
  robot.trail.push({ x: 1, y: 1 });
  robot.pose = { x: 1, y: 1, yaw: 0 };
  fleet.merged.setWhole({ stamp: 0, frame: "map", resolution: 1, width: 1, height: 1, origin: { x: 0, y: 0, yaw: 0 }, cells: new Uint8Array(1) }, 0);
  const version = fleet.merged.version;
  assert.equal(fleet.setRunTime(1, 1, 60), false);
  assert.equal(fleet.setRunTime(2, 2, 0), false, "a bridge that has just begun does not know the time");
  assert.equal(fleet.setRunTime(3, 3, 59), false, "late answers");
  assert.ok(robot.pose && fleet.map);
  assert.equal(fleet.setRunTime(4, 4, 2), true);
  assert.deepEqual([fleet.runs, robot.pose, robot.trail, fleet.map, fleet.area], [2, null, [], null, []]);
  assert.ok(fleet.merged.needsWhole && fleet.merged.version > version);
  assert.equal(fleet.robots.get(1), robot, "its panel stays");
});

test("another identity is another run, whatever its time: nothing of the old one is left", () => {
  const fleet = fleetWithPose();
  assert.equal(fleet.setRun("7-42"), null, "the first identity is that of the run that is shown");
  fleet.setRunTime(1, 1, 60);
  fleet.receive("/emergency_stop", new DataView(writeBool(true).buffer), 1);
  fleet.exploration = { state: "exploring" };
  assert.equal(fleet.setRun("7-42"), null, "a bridge that has started again");
  assert.deepEqual([fleet.runs, fleet.robots.size, fleet.area.length], [1, 2, 1]);
  const gone = fleet.setRun("8-43");
  assert.deepEqual(gone.map(({ name }) => name), ["robot1", "robot2"]);
  assert.deepEqual([fleet.runs, fleet.robots.size, fleet.area, fleet.figures], [2, 0, [], {}]);
  assert.deepEqual([fleet.isStopped, fleet.exploration, fleet.map, fleet.box()], [null, null, null, null]);
  assert.deepEqual(fleet.attention(2, true), []);
  assert.equal(fleet.setRunTime(2, 2, 61), false, "its time is its own");
  assert.equal(fleet.setRunTime(3, 3, 1), true);
});

test("robots that the fleet no longer has are gone, and one of another name is another robot", () => {
  const fleet = fleetWithPose();
  const second = fleet.robots.get(2);
  const { added, gone } = fleet.setFigures({ robots: [{ number: 1, prefix: "/alice/", slam: "tracking" }, FIGURES.robots[1]] }, 1);
  assert.deepEqual([added.map(({ name }) => name), gone.map(({ name }) => name)], [["alice"], ["robot1"]]);
  const alice = fleet.robots.get(1);
  assert.deepEqual([alice.prefix, alice.pose, alice.trail], ["/alice/", null, []]);
  assert.equal(fleet.robots.get(2), second);
  assert.deepEqual(fleet.setFigures({ robots: [FIGURES.robots[1]] }, 2).gone, [alice]);
  assert.deepEqual([...fleet.robots.keys()], [2]);
  assert.ok(fleet.attention(100, true).every(({ robot }) => robot !== 1));
});

/** A fleet whose first robot has a map of its own in the merged map. */
function fleetWithOwnMap() {
  const fleet = new Fleet();
  fleet.setFigures(FIGURES, 0);
  fleet.robots.get(1).baseFrame = "base_footprint_1";
  /** Takes the links of a time: that of the robot's map, if it is given. */
  const at = (stamp, map, x = 0) => {
    if (map !== null) fleet.receive("/tf", transform("map", "map_1", map, 0, stamp), stamp);
    fleet.receive("/tf", transform("map_1", "odom_1", 0, 0, stamp), stamp);
    fleet.receive("/tf", transform("odom_1", "base_footprint_1", x, 0, stamp), stamp);
  };
  return { fleet, robot: fleet.robots.get(1), at };
}

test("a robot whose map is no longer in the merged map becomes stale, and what is in its map has no place", () => {
  const { fleet, robot, at } = fleetWithOwnMap();
  at(1, 5);
  assert.deepEqual(robot.pose, { x: 5, y: 0, yaw: 0 });
  for (let stamp = 2; stamp <= 6; stamp += 1) at(stamp, null, stamp);
  assert.equal(robot.isStale(6), false, "the link is repeated once a second");
  for (let stamp = 7; stamp <= 9; stamp += 1) at(stamp, null, stamp);
  assert.equal(robot.isStale(9), true);
  assert.deepEqual([fleet.isPlaced(robot), fleet.placeIn("map_1"), fleet.placeIn("map") !== null], [false, null, true]);
  at(10, 5, 10);
  assert.deepEqual([robot.isStale(10), fleet.isPlaced(robot)], [false, true]);
});

test("a fixed link is valid for ever, and times of others' frames make none old", () => {
  const { fleet, robot, at } = fleetWithOwnMap();
  fleet.receive("/tf_static", transform("base_footprint_1", "base_scan_1", 1, 0, 0), 1);
  at(1000, 5);
  for (const [parent, child] of [["world", "camera"], ["map", "dock"], ["base_footprint_1", "gripper"]]) {
    fleet.receive("/tf", transform(parent, child, 0, 0, 2_000_000_000), 1000);
  }
  at(1001, null);
  assert.equal(fleet.mapFrames, 1);
  assert.equal(robot.isStale(1001), false);
  assert.deepEqual(fleet.placeIn("base_scan_1")({ x: 0, y: 0, yaw: 0 }), { x: 6, y: 0, yaw: 0 });
});

test("a trail moves with the map that it was driven in", () => {
  const { robot, at } = fleetWithOwnMap();
  at(1, 5);
  at(2, 5, 1);
  assert.deepEqual(robot.trail, [{ x: 5, y: 0 }, { x: 6, y: 0 }]);
  at(3, 7, 1);
  assert.deepEqual(robot.trail.slice(0, 2), [{ x: 7, y: 0 }, { x: 8, y: 0 }]);
});

test("the frame of the map is another one when all maps in it have jumped, or none of them was in it before", () => {
  const { fleet, at } = fleetWithOwnMap();
  at(1, 5);
  at(2, 5.1);
  assert.equal(fleet.mapFrames, 1, "a correction of centimetres");
  at(3, 8);
  assert.equal(fleet.mapFrames, 2);
  fleet.robots.get(2).baseFrame = "base_footprint_2";
  fleet.receive("/tf", transforms([["map_2", "odom_2", 0, 0], ["odom_2", "base_footprint_2", 0, 0]], 4), 4);
  assert.equal(fleet.mapFrames, 2);
  // Each robot's pose comes with the link of its own map alone: that is not all that is in the merged map.
  for (let stamp = 5; stamp < 9; stamp += 1) {
    for (const robot of [1, 2]) {
      fleet.receive("/tf", transforms([["map", `map_${robot}`, 8, 0], [`map_${robot}`, `odom_${robot}`, 0, 0]], stamp), stamp);
    }
  }
  assert.equal(fleet.mapFrames, 2);
  fleet.receive("/tf", transform("map", "map_2", 8, 0, 9), 9);
  assert.equal(fleet.mapFrames, 3);
  fleet.receive("/tf", transform("map", "odom_1", 50, 0, 5), 5);
  assert.equal(fleet.mapFrames, 3, "a robot's odometry is no map");
});

test("a robot whose name begins with another one's keeps its own messages", () => {
  const fleet = new Fleet();
  const prefixes = ["/", "/lab/", "/lab/alice/", "/lab/alice2/"];
  fleet.setFigures({ robots: prefixes.map((prefix, i) => ({ number: i + 1, prefix })) }, 0);
  assert.deepEqual([...fleet.robots.values()].map(({ name }) => name), ["robot", "lab", "lab/alice", "lab/alice2"]);
  for (const prefix of prefixes) {
    const { robot, rest } = fleet.robotOfTopic(`${prefix}scan`);
    assert.deepEqual([robot.prefix, rest], [prefix, "scan"]);
  }
});

test("a bridge that has just begun does not know the time, and makes nothing look new", () => {
  const fleet = new Fleet();
  fleet.setRunTime(100, 100, 1000);
  fleet.clock.reset();
  fleet.setRunTime(110, 110, 0);
  fleet.setRunTime(111, 111, 1011);
  assert.equal(fleet.clock.toPage(1001, 111), 101, "ten seconds old");
});

test("a robot whose scans come while nothing is known of its SLAM needs attention", () => {
  const fleet = new Fleet();
  fleet.setFigures({ robots: [{ number: 1, prefix: "/robot1/" }, { number: 2, prefix: "/robot2/", slam: "tracking" }] }, 0);
  fleet.robots.forEach((robot) => { robot.scanAt = 10; });
  assert.deepEqual(fleet.attention(10, true).map(({ key }) => key), ["silent 1"]);
});
