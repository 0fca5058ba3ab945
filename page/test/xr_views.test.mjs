// The views of mixed reality beside life-size.

import assert from "node:assert/strict";
import { test } from "node:test";
import { transform } from "../geometry.js";
import { RobotView, tablePlacement } from "../xr_views.js";

/** Where a point of the map is in the room, as the scene draws it. */
const inRoom = ({ pose, scale }, { x, y }) => transform(pose, { x: x * scale, y: y * scale });
const near = (a, b) => assert.ok(Math.hypot(a.x - b.x, a.y - b.y) < 1e-9, `${JSON.stringify(a)} instead of ${JSON.stringify(b)}`);

test("the robot of the view stays below the viewer, and its heading is ahead at first", () => {
  const viewer = { x: 1, y: -2, yaw: 0.7 };
  const robot = { x: 3, y: 5, yaw: -1.1 };
  const view = new RobotView(1, robot, viewer, 1.6);
  assert.equal(view.scale, 6.4);
  near(inRoom(view.placement(robot), robot), viewer);
  // A metre ahead of the robot is 6.4 m ahead of the viewer.
  near(inRoom(view.placement(robot), transform(robot, { x: 1, y: 0 })), transform(viewer, { x: 6.4, y: 0 }));
});

test("the map moves and does not turn while the robot does", () => {
  const viewer = { x: 0, y: 0, yaw: 0 };
  const view = new RobotView(1, { x: 0, y: 0, yaw: 0 }, viewer, 1.25);
  const later = view.placement({ x: 1, y: 0, yaw: 2 });
  near(inRoom(later, { x: 1, y: 0 }), viewer);
  near(inRoom(later, { x: 2, y: 0 }), { x: 5, y: 0 });
});

test("the map is enlarged within limits", () => {
  const scaleOf = (eyeHeight) => new RobotView(1, { x: 0, y: 0, yaw: 0 }, { x: 0, y: 0, yaw: 0 }, eyeHeight).scale;
  assert.deepEqual([scaleOf(-1), scaleOf(0.3), scaleOf(9)], [3, 3, 10]);
});

test("the table holds the whole map before the viewer", () => {
  const viewer = { x: 2, y: 1, yaw: 0.4 };
  const box = { minX: -10, maxX: 20, minY: 0, maxY: 5 };
  const table = tablePlacement(box, viewer);
  assert.ok(Math.abs(table.scale - 0.03) < 1e-12);
  near(inRoom(table, { x: 5, y: 2.5 }), transform(viewer, { x: 0.8, y: 0 }));
});
