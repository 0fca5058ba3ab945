// The alignment of map and room holds for its run, and while the map that it was made with is in the merged map.

import assert from "node:assert/strict";
import { test } from "node:test";
import { pointToXr } from "../coordinates.js";
import { Fleet } from "../state.js";
import { Alignment } from "../xr_alignment.js";
import { KeptAnchor } from "../xr_anchors.js";

const noStorage = { getItem: () => null, setItem() {}, removeItem() {} };

/** A fleet with a robot in its own map, which lies in the merged map, and an alignment with it. */
function aligned() {
  const fleet = new Fleet();
  fleet.setRun("run 1");
  fleet.setFigures({ robots: [{ number: 1, prefix: "/robot1/" }] }, 0);
  const robot = Object.assign(fleet.robots.get(1), { baseFrame: "base", pose: { x: 3, y: 1, yaw: 0 } });
  const link = (x, stamp) => fleet.frames.set("map", "map_1", { x, y: 0, yaw: 0 }, stamp);
  link(1, 1);
  fleet.frames.set("map_1", "odom", { x: 2, y: 1, yaw: 0 }, 1);
  fleet.frames.set("odom", "base", { x: 0, y: 0, yaw: 0 }, 1);
  fleet.framesAt = 1;
  const alignment = new Alignment(fleet, new KeptAnchor("map", noStorage));
  assert.equal(alignment.begin(robot), true);
  // The robot stands at (10, 20) of the floor, and looks along its y axis.
  assert.equal(alignment.take(pointToXr([10, 20, 0]), {}, null), null);
  const kept = alignment.take(pointToXr([10, 21, 0]), {}, null);
  return { fleet, alignment, kept, link };
}

const near = (pose, wanted) => assert.ok(["x", "y", "yaw"].every((of) => Math.abs(pose[of] - wanted[of]) < 1e-6), JSON.stringify(pose));

test("the map lies so that the robot is where it was pointed at, and a device that keeps nothing says so", async () => {
  const { alignment, kept } = aligned();
  near(alignment.pose({}, null), { x: 11, y: 17, yaw: Math.PI / 2 });
  assert.equal(await kept, false);
});

test("a correction of the merged map moves it in the room, and leaves the robot's map where it is", () => {
  const { alignment, link } = aligned();
  link(4, 1);
  near(alignment.pose({}, null), { x: 11, y: 14, yaw: Math.PI / 2 });
});

test("in another run, and while the robot's map is not in the merged map, the map must be aligned", () => {
  const { fleet, alignment } = aligned();
  fleet.framesAt = 100;
  assert.equal(alignment.pose({}, null), null);
  fleet.framesAt = 1;
  assert.ok(alignment.pose({}, null));
  fleet.run = "run 2";
  assert.equal(alignment.pose({}, null), null);
});

test("without an anchor nothing is known after the floor has got other coordinates", () => {
  const { alignment } = aligned();
  alignment.anchor.forgetFixed();
  assert.equal(alignment.pose({}, null), null);
});

test("what an earlier version stored, without a run, aligns nothing", () => {
  const { alignment } = aligned();
  alignment.anchor.data = { x: 1, y: 2, yaw: 0 };
  assert.equal(alignment.pose({}, null), null);
});
