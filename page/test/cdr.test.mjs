// Reading and writing ROS messages in CDR.

import assert from "node:assert/strict";
import { test } from "node:test";
import { CdrReader, CdrWriter } from "../cdr.js";
import { readBool, readGrid, readScan, readTransforms, writeBool, writeEmpty, writeInt, writeTwist } from "../messages.js";

/** Writes a message field by field, with CDR's alignment. */
class Message extends CdrWriter {
  u32(value) { return this.number(4, (view) => view.setUint32(0, value, true)); }
  f32(value) { return this.number(4, (view) => view.setFloat32(0, value, true)); }
  string(text) {
    const bytes = new TextEncoder().encode(`${text}\0`);
    this.u32(bytes.length);
    this.bytes.push(...bytes);
    return this;
  }
  header(seconds, frame) { return this.i32(Math.floor(seconds)).u32(Math.round((seconds % 1) * 1e9)).string(frame); }
  view() { return new DataView(this.done().buffer); }
}

test("a twist has the bytes that ROS 2 gives it", () => {
  const bytes = writeTwist(0.1, -1.5);
  assert.equal(bytes.length, 4 + 6 * 8);
  assert.deepEqual([...bytes.slice(0, 4)], [0, 1, 0, 0]);
  const from = new CdrReader(new DataView(bytes.buffer));
  assert.deepEqual(from.vector(), { x: 0.1, y: 0, z: 0 });
  assert.deepEqual(from.vector(), { x: 0, y: 0, z: -1.5 });
});

test("short messages have the bytes that ROS 2 gives them", () => {
  assert.deepEqual([...writeBool(true)], [0, 1, 0, 0, 1]);
  assert.deepEqual([...writeInt(-2)], [0, 1, 0, 0, 254, 255, 255, 255]);
  assert.deepEqual([...writeEmpty()], [0, 1, 0, 0, 0]);
  assert.equal(readBool(new DataView(writeBool(true).buffer)), true);
});

test("numbers are aligned from the end of the header, whatever stands before them", () => {
  const message = new Message().header(12.5, "base_scan_1");
  for (const value of [-Math.PI, Math.PI, 0.5, 0, 0.1, 0.12, 3.5]) message.f32(value);
  message.u32(3).f32(1).f32(2).f32(Infinity).u32(0);
  const scan = readScan(message.view());
  assert.equal(scan.stamp, 12.5);
  assert.equal(scan.frame, "base_scan_1");
  assert.ok(Math.abs(scan.rangeMax - 3.5) < 1e-6 && Math.abs(scan.angleStep - 0.5) < 1e-6);
  assert.deepEqual([...scan.ranges], [1, 2, Infinity]);
});

test("a transform is the pose of the child in the parent", () => {
  const message = new Message().u32(1).header(3, "map").string("odom_2");
  [1, 2, 0, 0, 0, Math.SQRT1_2, Math.SQRT1_2].forEach((value) => message.f64(value));
  const [transform] = readTransforms(message.view());
  assert.deepEqual([transform.parent, transform.child, transform.stamp], ["map", "odom_2", 3]);
  assert.ok(Math.abs(transform.pose.yaw - Math.PI / 2) < 1e-9);
  assert.deepEqual([transform.pose.x, transform.pose.y], [1, 2]);
});

function grid(width, height, cells) {
  const message = new Message().header(1, "map").i32(0).u32(0).f32(0.05).u32(width).u32(height);
  [-1, -2, 0, 0, 0, 0, 1].forEach((value) => message.f64(value));
  message.u32(cells.length);
  message.bytes.push(...cells);
  return message.view();
}

test("a map has its cells row by row, and unknown ones are 255", () => {
  const map = readGrid(grid(2, 2, [0, 100, 255, 0]));
  assert.deepEqual([map.width, map.height, map.origin.x, map.origin.y, map.origin.yaw], [2, 2, -1, -2, 0]);
  assert.deepEqual([...map.cells], [0, 100, 255, 0]);
  assert.throws(() => readGrid(grid(2, 3, [0, 100])), RangeError);
});

test("a message that is cut off is an error at every length", () => {
  const whole = new Uint8Array(grid(2, 2, [0, 100, 255, 0]).buffer);
  for (let length = 0; length < whole.length; length += 1) {
    assert.throws(() => readGrid(new DataView(whole.slice(0, length).buffer)), RangeError, `${length} bytes`);
  }
});

test("a length that cannot be true allocates nothing", () => {
  const message = new Message().u32(0xffffffff).view();
  assert.throws(() => readTransforms(message), RangeError);
});
