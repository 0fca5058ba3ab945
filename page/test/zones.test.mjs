// Exclusion zones: read, drawn with the pointer, removed by a click.

import assert from "node:assert/strict";
import { test } from "node:test";
import { CdrReader, CdrWriter } from "../cdr.js";
import { Fleet } from "../state.js";
import { contains, readZones, ZoneTool } from "../zones.js";

const text = (value) => new DataView(new CdrWriter().string(value).done().buffer);
const SQUARE = { number: 3, corners_m: [[0, 0], [2, 0], [2, 2], [0, 2]] };

test("zones are read, and what is no zone is left out", () => {
  const fleet = new Fleet();
  fleet.receive("/exclusion_zones", text(JSON.stringify({ zones: [SQUARE, { number: 4, corners_m: [[null, 1]] }, { number: "x" }] })), 0);
  assert.deepEqual(fleet.zones.map(({ number, corners }) => [number, corners.length]), [[3, 4]]);
  assert.equal(contains(fleet.zones[0], { x: 1, y: 1 }), true);
  assert.equal(contains(fleet.zones[0], { x: 3, y: 1 }), false);
  assert.throws(() => readZones(text("{")), RangeError);
  assert.throws(() => readZones(text("{}")), RangeError);
});

test("a dragged rectangle becomes a zone, a click removes the one below it, and the tool does nothing while it is off", () => {
  const sent = [];
  const { zones } = readZones(text(JSON.stringify({ zones: [SQUARE] })));
  const tool = new ZoneTool({ zones: () => zones, publish: (topic, type, payload) => sent.push({ topic, type, payload }), show: () => {} });
  assert.equal(tool.press({ x: 0, y: 0 }), false);
  tool.toggle();
  assert.equal(tool.press({ x: 1, y: 1 }), true);
  tool.move({ x: 3, y: -1 });
  tool.release();
  assert.deepEqual([sent[0].topic, sent[0].type], ["/exclusion_zones/add", "geometry_msgs/msg/PolygonStamped"]);
  const reader = new CdrReader(new DataView(sent[0].payload.buffer));
  assert.deepEqual([reader.header().frame, reader.u32()], ["map", 4]);
  assert.deepEqual([reader.f32(), reader.f32(), reader.f32(), reader.f32(), reader.f32()], [1, 1, 0, 3, 1]);
  tool.press({ x: 1, y: 1 });
  tool.release();
  assert.equal(sent[1].topic, "/exclusion_zones/remove");
  assert.equal(new CdrReader(new DataView(sent[1].payload.buffer)).i32(), 3);
  tool.press({ x: 9, y: 9 });
  tool.release();
  tool.press({ x: 1, y: 1 });
  tool.cancel();
  tool.release();
  assert.equal(sent.length, 2);
});
