// Marks of the map in mixed reality: the borders of areas run along all their sides.

import assert from "node:assert/strict";
import { test } from "node:test";
import { VERTEX_NUMBERS } from "../models.js";
import { Marks, bordersOf } from "../xr_marks.js";

const SQUARE = { number: 1, corners: [{ x: 0, y: 0 }, { x: 2, y: 0 }, { x: 2, y: 2 }, { x: 0, y: 2 }] };

test("a border runs along each side, the last one too", () => {
  const vertices = bordersOf([SQUARE]);
  const places = Array.from({ length: vertices.length / VERTEX_NUMBERS }, (_, i) => [vertices[i * VERTEX_NUMBERS], vertices[i * VERTEX_NUMBERS + 1]]);
  for (const isBeside of [([x]) => Math.abs(x) < 0.03, ([x]) => Math.abs(x - 2) < 0.03, ([, y]) => Math.abs(y) < 0.03, ([, y]) => Math.abs(y - 2) < 0.03]) {
    assert.ok(places.filter(isBeside).length >= 6, "two triangles");
  }
  assert.ok(places.every(([x, y]) => Math.min(Math.abs(x), Math.abs(x - 2), Math.abs(y), Math.abs(y - 2)) < 0.03));
  assert.equal(bordersOf([]).length, 0);
});

test("marks are put on the graphics processor when they change, and go when there are none", () => {
  const updates = [];
  const renderer = { createMesh: () => ({ count: 0 }), createPlaces: () => ({ count: 0 }), update: (_of, { length }) => updates.push(length > 0) };
  const marks = new Marks(renderer);
  const left = { left: [{ x: 1, y: 2 }] };
  for (const fleet of [{ zones: [SQUARE], exploration: left }, { zones: [], exploration: null }]) {
    marks.update(fleet);
    marks.update(fleet);
  }
  assert.deepEqual(updates, [true, true, false, false]);
});
