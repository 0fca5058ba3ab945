// Poses, the tree of frames, and the view from above.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Camera, FrameTree, compose, invert, transform, wrap, yawOf } from "../geometry.js";

/** Numbers that look random and are the same each time. */
function* numbers(seed = 1) {
  let state = seed;
  for (;;) {
    state = (state * 1103515245 + 12345) % 2147483648;
    yield state / 1073741824 - 1;
  }
}

function close(a, b, message) { assert.ok(Math.abs(a - b) < 1e-9, `${message ?? ""} ${a} ${b}`); }

test("a pose and its inverse are the identity, and composing keeps distances", () => {
  const next = numbers();
  for (let i = 0; i < 200; i += 1) {
    const [x, y, yaw, px, py] = Array.from({ length: 5 }, () => next.next().value * 10);
    const pose = { x, y, yaw: wrap(yaw) };
    const identity = compose(pose, invert(pose));
    close(identity.x, 0);
    close(identity.y, 0);
    close(Math.sin(identity.yaw), 0);
    const point = transform(pose, { x: px, y: py });
    close(Math.hypot(point.x - x, point.y - y), Math.hypot(px, py));
    const back = transform(invert(pose), point);
    close(back.x, px);
    close(back.y, py);
  }
});

test("the heading of a rotation about the vertical axis", () => {
  for (const yaw of [-3, -1, 0, 0.5, 3]) close(yawOf({ x: 0, y: 0, z: Math.sin(yaw / 2), w: Math.cos(yaw / 2) }), yaw);
});

test("a frame is found through its ancestors", () => {
  const tree = new FrameTree();
  tree.set("map", "odom", { x: 1, y: 0, yaw: Math.PI / 2 });
  tree.set("odom", "base", { x: 2, y: 0, yaw: 0 });
  const pose = tree.find("map", "base");
  close(pose.x, 1);
  close(pose.y, 2);
  assert.equal(tree.find("map", "other"), null);
  assert.equal(tree.find("other", "base"), null);
});

test("frames in a circle are not followed for ever", () => {
  const tree = new FrameTree();
  tree.set("a", "b", { x: 0, y: 0, yaw: 0 });
  tree.set("b", "a", { x: 0, y: 0, yaw: 0 });
  assert.equal(tree.find("map", "a"), null);
});

test("the screen and the plane are mirrored in y alone, and a zoom keeps the point below the pointer", () => {
  const camera = new Camera();
  [camera.width, camera.height] = [800, 600];
  assert.deepEqual(camera.toScreen({ x: 0, y: 1 }), { x: 400, y: 300 - camera.scale });
  const next = numbers(7);
  for (let i = 0; i < 100; i += 1) {
    const pixel = { x: next.next().value * 400 + 400, y: next.next().value * 300 + 300 };
    const before = camera.toWorld(pixel);
    camera.zoom(1.3 ** Math.round(next.next().value * 3), pixel);
    const after = camera.toWorld(pixel);
    close(before.x, after.x);
    close(before.y, after.y);
    camera.pan(next.next().value * 50, next.next().value * 50);
  }
});

test("a rectangle that is fitted is on the screen", () => {
  const camera = new Camera();
  [camera.width, camera.height] = [375, 500];
  camera.fit({ minX: -3, minY: 0, maxX: 12, maxY: 4 });
  for (const point of [{ x: -3, y: 0 }, { x: 12, y: 4 }]) {
    const { x, y } = camera.toScreen(point);
    assert.ok(x >= 0 && x <= 375 && y >= 0 && y <= 500, `${x} ${y}`);
  }
  camera.fit({ minX: 0, minY: 0, maxX: 4, maxY: 20 }, { top: 50, bottom: 150 });
  assert.ok(camera.toScreen({ x: 0, y: 20 }).y >= 50 && camera.toScreen({ x: 0, y: 0 }).y <= 350);
});
