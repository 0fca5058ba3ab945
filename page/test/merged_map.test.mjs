// The merged map that the page keeps from tiles.

import assert from "node:assert/strict";
import { test } from "node:test";
import { MergedMap } from "../merged_map.js";

const info = (width, height, x = 0, y = 0) => ({ stamp: 1, frame: "map", resolution: 0.5, width, height, origin: { x, y, yaw: 0 } });
const whole = (width, height, cells) => ({ ...info(width, height), cells: Uint8Array.from(cells) });
const tile = (x, y, width, height, cells) => ({ x, y, width, height, cells: Uint8Array.from(cells) });

test("a tile changes its cells alone, and its area is all that must be drawn", () => {
  const map = new MergedMap();
  assert.equal(map.needsWhole, true);
  map.setWhole(whole(3, 2, [0, 0, 0, 0, 0, 0]), 1);
  assert.equal(map.needsWhole, false);
  const { version } = map;
  map.applyTiles({ ...info(3, 2), number: 7, base: 6, tiles: [tile(1, 0, 2, 2, [1, 2, 3, 4])] }, 2);
  assert.deepEqual([...map.grid.cells], [0, 1, 2, 0, 3, 4]);
  assert.deepEqual(map.changedSince(version).map(({ x, y, width, height }) => [x, y, width, height]), [[1, 0, 2, 2]]);
  assert.equal(map.changedSince(0), null, "who has drawn nothing draws all of it");
  assert.equal(map.at, 2);
});

test("a missed update asks for the whole map, and the tiles after it are good again", () => {
  const map = new MergedMap();
  map.setWhole(whole(1, 1, [0]), 1);
  const update = (number, base, value) => map.applyTiles({ ...info(1, 1), number, base, tiles: [tile(0, 0, 1, 1, [value])] }, 1);
  update(3, 2, 5);
  update(5, 4, 9);
  assert.deepEqual([map.needsWhole, map.grid.cells[0]], [true, 5]);
  map.setWhole(whole(1, 1, [9]), 2);
  update(6, 5, 11);
  assert.deepEqual([map.needsWhole, map.grid.cells[0]], [false, 11]);
  update(7, 0, 12);
  assert.equal(map.needsWhole, true, "an update without a base: the cells are others");
});

test("a map that grows keeps its cells where they are, and the rest is unknown", () => {
  const map = new MergedMap();
  map.setWhole(whole(2, 2, [1, 2, 3, 4]), 1);
  // A column and a row more at the lower left; the last column is gone.
  map.applyTiles({ ...info(2, 3, -0.5, -0.5), number: 1, base: 9, tiles: [] }, 1);
  assert.deepEqual([...map.grid.cells], [255, 255, 255, 1, 255, 3]);
  assert.equal(map.changedSince(1), null);
  // Far away nothing is left.
  map.applyTiles({ ...info(1, 1, 40, 0), number: 2, base: 1, tiles: [tile(0, 0, 1, 1, [7])] }, 1);
  assert.deepEqual([...map.grid.cells], [7]);
  map.applyTiles({ ...info(1, 1, 40.2, 0), number: 3, base: 2, tiles: [] }, 1);
  assert.equal(map.needsWhole, true, "cells that do not coincide");
});

test("a tile outside of its map is refused", () => {
  const map = new MergedMap();
  map.setWhole(whole(2, 2, [0, 0, 0, 0]), 1);
  const broken = { ...info(2, 2), number: 1, base: 0, tiles: [tile(1, 1, 2, 1, [5, 5])] };
  map.applyTiles(broken, 1);
  assert.throws(() => map.applyTiles({ ...broken, number: 2, base: 1 }, 1), RangeError);
});

test("another connection begins with the whole map, and what is shown stays", () => {
  const map = new MergedMap();
  map.setWhole(whole(1, 1, [3]), 1);
  map.begin();
  assert.deepEqual([map.needsWhole, map.grid.cells[0]], [true, 3]);
});
