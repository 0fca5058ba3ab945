// Coordinates between WebXR and ROS: a proper rotation, its inverse, and the alignment of the map.

import assert from "node:assert/strict";
import { test } from "node:test";
import { alignMap, floorHit, pointFromXr, pointToXr, poseFromXr, rotationFromXr, rotationToXr, xrFromFrame } from "../coordinates.js";
import { compose, transform, wrap } from "../geometry.js";
import { facing, multiply, planeHit, rigidInverse, rotationAboutY, transformDirection, transformPoint, translation } from "../matrix.js";
import { BURGER_HEIGHT_M, VERTEX_NUMBERS, burger, ribbon } from "../models.js";

/** Numbers between -1 and 1 that look random and are the same each time. */
function* numbers(seed = 7) {
  let state = seed;
  for (;;) {
    state = (state * 1103515245 + 12345) % 2147483648;
    yield state / 1073741824 - 1;
  }
}
const next = numbers();
const random = (count, size = 10) => Array.from({ length: count }, () => next.next().value * size);
const close = (a, b, tolerance = 1e-9) => assert.ok(Math.abs(a - b) < tolerance, `${a} is not ${b}`);
const closeAll = (a, b, tolerance) => [...a].forEach((value, i) => close(value, b[i], tolerance));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** Returns a vector turned by a quaternion. */
function turn({ x, y, z, w }, v) {
  const t = cross([x, y, z], v).map((value) => 2 * value);
  const u = cross([x, y, z], t);
  return v.map((value, i) => value + w * t[i] + u[i]);
}

test("ahead, left and up are what they are in both", () => {
  assert.deepEqual(pointToXr([1, 0, 0]).map((v) => v + 0), [0, 0, -1]);
  assert.deepEqual(pointToXr([0, 1, 0]).map((v) => v + 0), [-1, 0, 0]);
  assert.deepEqual(pointToXr([0, 0, 1]).map((v) => v + 0), [0, 1, 0]);
});

test("points go there and back, and the map is a proper rotation", () => {
  for (let i = 0; i < 200; i += 1) {
    const [a, b] = [random(3), random(3)];
    closeAll(pointFromXr(pointToXr(a)), a);
    close(Math.hypot(...pointToXr(a)), Math.hypot(...a));
    // A mirror would turn the cross product round.
    closeAll(pointToXr(cross(a, b)), cross(pointToXr(a), pointToXr(b)));
  }
});

test("turning and converting commute", () => {
  for (let i = 0; i < 200; i += 1) {
    const [x, y, z, w] = random(4);
    const length = Math.hypot(x, y, z, w);
    const q = { x: x / length, y: y / length, z: z / length, w: w / length };
    const v = random(3);
    closeAll(pointToXr(turn(q, v)), turn(rotationToXr(q), pointToXr(v)));
    assert.deepEqual(rotationFromXr(rotationToXr(q)), q);
  }
});

test("a frame on the floor has the same points as its pose, and is read back", () => {
  for (let i = 0; i < 200; i += 1) {
    const [x, y, turned] = random(3);
    const pose = { x, y, yaw: wrap(turned) };
    const [px, py, pz] = random(3);
    const onFloor = transform(pose, { x: px, y: py });
    closeAll(transformPoint(xrFromFrame(pose), [px, py, pz]), pointToXr([onFloor.x, onFloor.y, pz]), 1e-4);
    const [px0, py0, pz0] = pointToXr([x, y, 0]);
    const read = poseFromXr(multiply(translation(px0, py0 + 0.3, pz0), rotationAboutY(pose.yaw)));
    closeAll([read.x, read.y, Math.sin(read.yaw - pose.yaw)], [x, y, 0], 1e-5);
  }
});

test("two taps put the map where the robot was tapped", () => {
  for (let i = 0; i < 200; i += 1) {
    const [mx, my, mturn, x, y, turned] = random(6);
    const inMap = { x: mx, y: my, yaw: wrap(mturn) };
    const onFloor = { x, y, yaw: wrap(turned) };
    const ahead = transform(onFloor, { x: 1.5, y: 0 });
    const map = alignMap(inMap, pointToXr([x, y, 0]), pointToXr([ahead.x, ahead.y, 0]));
    const robot = compose(map, inMap);
    closeAll([robot.x, robot.y, Math.sin(robot.yaw - onFloor.yaw)], [x, y, 0], 1e-9);
  }
  assert.equal(alignMap({ x: 0, y: 0, yaw: 0 }, [0, 0, 0], [0.05, 0, 0]), null, "no direction in 5 cm");
});

test("a ray meets the floor ahead, and not above the horizon", () => {
  const slanted = Math.SQRT1_2;
  closeAll(floorHit([1, 1.6, 2], [0, -slanted, -slanted]), [1, 0, 0.4]);
  assert.equal(floorHit([0, 1.6, 0], [0, 0, -1]), null);
  assert.equal(floorHit([0, 1.6, 0], [0, 1, 0]), null);
  assert.equal(floorHit([0, 1.6, 0], [0, -0.01, -0.99995]), null, "farther than one can aim");
});

test("rigid matrices are inverted, and panels face the viewer", () => {
  for (let i = 0; i < 100; i += 1) {
    const [x, y, z, angle] = random(4);
    const matrix = multiply(translation(x, y, z), rotationAboutY(angle));
    const point = random(3);
    closeAll(transformPoint(rigidInverse(matrix), transformPoint(matrix, point)), point, 1e-4);
    const eye = random(3);
    const panel = facing([x, y, z], eye);
    const normal = transformDirection(panel, [0, 0, 1]);
    const to = [eye[0] - x, 0, eye[2] - z];
    close((normal[0] * to[0] + normal[2] * to[2]) / Math.hypot(...to), 1, 1e-4);
    const hit = planeHit(panel, eye, [x - eye[0], y - eye[1], z - eye[2]]);
    closeAll([hit.x, hit.y, hit.distance], [0, 0, 1], 1e-4);
  }
});

test("a Burger has its published size and stands on the floor", () => {
  const { vertices, count } = burger();
  const corners = Array.from({ length: count }, (_, i) => [...vertices.subarray(i * VERTEX_NUMBERS, i * VERTEX_NUMBERS + 3)]);
  const extent = (axis) => [Math.min(...corners.map((c) => c[axis])), Math.max(...corners.map((c) => c[axis]))];
  const [[x0, x1], [y0, y1], [z0, z1]] = [extent(0), extent(1), extent(2)];
  close(z0, 0, 0.003);
  close(z1, BURGER_HEIGHT_M, 1e-6);
  close(y1 - y0, 0.178, 0.005);
  close(x1 - x0, 0.138, 0.025);
  assert.ok(count < 3000, `${count} corners for each robot`);
});

test("triangles face outwards", () => {
  const { vertices, count } = burger();
  for (let i = 0; i < count; i += 3) {
    const at = (k) => [...vertices.subarray((i + k) * VERTEX_NUMBERS, (i + k) * VERTEX_NUMBERS + 6)];
    const [a, b, c] = [at(0), at(1), at(2)];
    const side = (p, q) => [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
    const normal = cross(side(a, b), side(a, c));
    assert.ok(normal[0] * a[3] + normal[1] * a[4] + normal[2] * a[5] >= 0, `triangle ${i / 3}`);
  }
});

test("a ribbon is as wide as asked, and none without two points", () => {
  assert.equal(ribbon([{ x: 0, y: 0 }], 0.02).count, 0);
  const { vertices, count } = ribbon([{ x: 0, y: 0 }, { x: 1, y: 0 }, { x: 2, y: 0 }], 0.02);
  assert.equal(count, 12);
  for (let i = 0; i < count; i += 1) close(Math.abs(vertices[i * VERTEX_NUMBERS + 1]), 0.01, 1e-6);
});
