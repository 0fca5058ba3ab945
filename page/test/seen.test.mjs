// The robots' maps are asked for one at a time and seldom, and their layer has the colours of those who saw a place.

import assert from "node:assert/strict";
import { test } from "node:test";
import { RobotMaps } from "../seen.js";
import { Fleet } from "../state.js";

const grid = (frame, width, height, cells, origin = { x: 0, y: 0, yaw: 0 }) => ({ stamp: 0, frame, resolution: 0.5, width, height, origin, cells: Uint8Array.from(cells) });

function fleetOf(count, cells = [100, 100]) {
  const fleet = new Fleet();
  fleet.setFigures({ robots: Array.from({ length: count }, (_, i) => ({ number: i + 1, prefix: `/robot${i + 1}/`, map_cells: cells })) }, 0);
  return fleet;
}

function recorder() {
  const calls = [];
  return { calls, subscribe: (topic) => calls.push(`+${topic}`), unsubscribe: (topic) => calls.push(`-${topic}`) };
}

test("one map is asked for at a time, the oldest first, and a large one seldom", () => {
  const [connection, fleet] = [recorder(), fleetOf(2)];
  const maps = new RobotMaps(connection);
  maps.tick(fleet, 0);
  maps.tick(fleet, 1);
  assert.deepEqual(connection.calls, ["+/robot1/map"]);
  assert.equal(maps.receive("/robot2/map", () => assert.fail(), 1), false);
  assert.equal(maps.receive("/robot1/map", () => grid("a", 1000, 1000, new Uint8Array(1_000_000)), 1), true);
  assert.deepEqual(connection.calls.slice(1), ["-/robot1/map"]);
  maps.tick(fleet, 15);
  assert.equal(connection.calls.length, 2, "a megabyte takes 20 s");
  maps.tick(fleet, 22);
  assert.equal(connection.calls.at(-1), "+/robot2/map");
  // One that never comes is given up.
  maps.tick(fleet, 50);
  assert.deepEqual(connection.calls.slice(-2), ["-/robot2/map", "+/robot1/map"]);
});

test("maps that would hold the merged map up are not asked for", () => {
  const connection = recorder();
  new RobotMaps(connection).tick(fleetOf(1, [4000, 4000]), 0);
  assert.deepEqual(connection.calls, []);
});

test("a place has the colour of the robot that saw it, and a mixture where two did", () => {
  const [fleet, maps] = [fleetOf(2), new RobotMaps(recorder())];
  fleet.merged.setWhole(grid("map", 4, 1, [0, 0, 0, 0]), 0);
  fleet.frames.set("map", "robot1/map", { x: 0, y: 0, yaw: 0 }, 0);
  // The second robot's map lies the other way round: its x axis points to the merged map's left.
  fleet.frames.set("map", "robot2/map", { x: 2, y: 0.5, yaw: Math.PI }, 0);
  maps.grids.set(1, grid("robot1/map", 3, 1, [0, 100, 255]));
  maps.grids.set(2, grid("robot2/map", 3, 1, [0, 255, 0]));
  const { pixels, width, height } = maps.layer(fleet);
  assert.deepEqual([width, height], [4, 1]);
  const rgb = [...pixels].map((pixel) => (pixel === 0 ? null : [pixel & 255, (pixel >> 8) & 255, (pixel >> 16) & 255]));
  const [first, second] = [[0xe6, 0x9f, 0x00], [0x3a, 0x9a, 0xd9]];
  const mixed = first.map((value, i) => Math.floor((value + second[i]) / 2));
  assert.deepEqual(rgb, [first, mixed, null, second]);
  assert.ok([...pixels].every((pixel) => pixel === 0 || pixel >>> 24 < 128), "the map stays legible");
});

test("a robot whose map lies nowhere yet has no colour", () => {
  const [fleet, maps] = [fleetOf(1), new RobotMaps(recorder())];
  fleet.merged.setWhole(grid("map", 2, 1, [0, 0]), 0);
  maps.grids.set(1, grid("robot1/map", 2, 1, [0, 0]));
  assert.equal(maps.layer(fleet), null);
});

test("the map of a robot that is gone is neither shown nor asked for any more", () => {
  const connection = recorder();
  const [fleet, maps] = [fleetOf(1), new RobotMaps(connection)];
  maps.asked = { robot: 1, topic: "/robot1/map", at: 0 };
  maps.grids.set(1, grid("robot1/map", 2, 1, [0, 0]));
  maps.forget(1);
  assert.deepEqual([maps.asked, maps.grids.size], [null, 0]);
  assert.equal(maps.layer(fleet), null);
});
