// Merge edges and exploration as texts and commands.

import assert from "node:assert/strict";
import { test } from "node:test";
import { CdrReader, CdrWriter } from "../cdr.js";
import { commandsOf, describeEdge, readEdges, writeEdgeCommand } from "../edges.js";
import { describeExploration, isExploring, readExploration } from "../exploration.js";
import { MeasureTool } from "../measure.js";
import { Fleet } from "../state.js";

const text = (value) => new DataView(new CdrWriter().string(value).done().buffer);
const EDGE = { a: "robot1", b: "robot12", state: "accepted", occupied_f1: 0.834, null_f1_max: 0.3, overlap_m2: 12.34, residual_m: 0.0241, closures: 3, closures_rejected: 0 };

test("an edge shows its evidence beside chance, and what can be done with it", () => {
  const { state, evidence } = describeEdge(EDGE);
  assert.deepEqual([state, evidence], ["joined", "walls agree 83 %, by chance 30 % · 12.3 m² shared · 24 mm apart · 3 closures"]);
  assert.deepEqual(commandsOf(EDGE), ["pin", "undo"]);
  assert.deepEqual(commandsOf({ ...EDGE, state: "pinned" }), ["unpin", "undo"]);
  for (const state of ["none", "candidate", "undone", "dropped"]) assert.deepEqual(commandsOf({ ...EDGE, state }), []);
  const command = writeEdgeCommand("undo", EDGE);
  assert.equal(new CdrReader(new DataView(command.buffer)).string(), "undo 1 12");
});

test("edges that are no list are refused, and a dropped one needs attention", () => {
  assert.throws(() => readEdges(text("{")), RangeError);
  assert.throws(() => readEdges(text("{}")), RangeError);
  const fleet = new Fleet();
  fleet.receive("/merge_edges", text(JSON.stringify({ edges: [EDGE, { ...EDGE, b: "robot2", state: "dropped" }] })), 0);
  assert.deepEqual(fleet.attention(0, true).map((item) => [item.robot, item.text]), [[1, "its map is no longer joined with that of 2: they contradict each other"]]);
});

test("exploration says what it does, what is left and how long it takes", () => {
  const state = (fields) => readExploration(text(JSON.stringify({ state: "exploring", ...fields })));
  const left = [{ frame: "map", x_m: 1, y_m: 2 }, { frame: "map_2", x_m: 1, y_m: 2 }, { frame: "map", x_m: null, y_m: 2 }];
  assert.deepEqual(state({ left, left_count: 3 }).left, [{ x: 1, y: 2 }]);
  assert.equal(describeExploration(state({ left_count: 1, least_s: 30, most_s: 260 })), "exploring · 1 place left · done in 30 s to 4.3 min");
  assert.equal(describeExploration(state({ state: "failed", reason: "no map" })), "failed: no map");
  assert.deepEqual(["exploring", "waiting", "returning", "paused", "completed", "stopped", "idle"].map((name) => isExploring(state({ state: name }))), [true, true, true, false, false, false, false]);
  assert.equal(isExploring(null), false);
  assert.throws(() => readExploration(text("[]")), RangeError);
});

test("a distance is measured from press to release, and switching off removes it", () => {
  const shown = [];
  const tool = new MeasureTool((isOn) => shown.push(isOn));
  assert.equal(tool.press({ x: 0, y: 0 }), false);
  tool.toggle();
  assert.equal(tool.press({ x: 1, y: 1 }), true);
  tool.move({ x: 4, y: 5 });
  tool.release();
  tool.move({ x: 9, y: 9 });
  assert.equal(tool.length(), 5);
  tool.toggle();
  assert.deepEqual([tool.length(), shown], [null, [true, false]]);
});

test("an edge without measurements, as one that was pinned before maps overlap, is shown without them", () => {
  const unmeasured = { ...EDGE, state: "pinned", occupied_f1: null, null_f1_max: null, overlap_m2: null, residual_m: null };
  const { edges } = readEdges(text(JSON.stringify({ edges: [unmeasured, null, 7, { a: 1, b: "robot2", state: "accepted" }, EDGE] })));
  assert.equal(edges.length, 2, "what is no edge is left out");
  assert.deepEqual(edges.map((edge) => describeEdge(edge).evidence), [
    "walls agree –, by chance – · – shared · – apart · 3 closures", "walls agree 83 %, by chance 30 % · 12.3 m² shared · 24 mm apart · 3 closures",
  ]);
});

test("the operator is told that what is pinned is not kept", () => {
  const fleet = new Fleet();
  fleet.receive("/merge_edges", text(JSON.stringify({ edges: [EDGE], unsaved: true })), 0);
  assert.ok(fleet.attention(0, true).some((item) => item.text.includes("merging cannot save")));
  fleet.receive("/merge_edges", text(JSON.stringify({ edges: [EDGE], unsaved: false })), 0);
  assert.ok(!fleet.attention(0, true).some((item) => item.text.includes("merging cannot save")));
});
