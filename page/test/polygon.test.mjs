// Triangles of a polygon cover it once, also around corners that go inwards.

import assert from "node:assert/strict";
import { test } from "node:test";
import { triangulate } from "../polygon.js";

const of = (...numbers) => numbers.map(([x, z]) => ({ x, z }));
function areaOf(corners, triangles) {
  let sum = 0;
  for (let i = 0; i < triangles.length; i += 3) {
    const [a, b, c] = triangles.slice(i, i + 3).map((k) => corners[k]);
    sum += Math.abs((b.x - a.x) * (c.z - a.z) - (b.z - a.z) * (c.x - a.x)) / 2;
  }
  return sum;
}

test("an L-shaped floor has its own area, and not that of its hull, in either direction", () => {
  const floor = of([0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]);
  for (const corners of [floor, [...floor].reverse()]) {
    const triangles = triangulate(corners);
    assert.equal(triangles.length, 3 * 4);
    assert.ok(Math.abs(areaOf(corners, triangles) - 6) < 1e-9);
  }
});

test("any star-shaped outline is covered once", () => {
  let seed = 7;
  const random = () => { seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0; return seed / 2 ** 32; };
  for (let round = 0; round < 200; round += 1) {
    const count = 3 + Math.floor(random() * 30);
    const corners = Array.from({ length: count }, (_, i) => {
      const [radius, angle] = [0.5 + 2.5 * random(), (2 * Math.PI * i) / count];
      return { x: radius * Math.cos(angle), z: radius * Math.sin(angle) };
    });
    const area = corners.reduce((sum, a, i) => sum + (a.x * corners[(i + 1) % count].z - a.z * corners[(i + 1) % count].x) / 2, 0);
    assert.ok(Math.abs(areaOf(corners, triangulate(corners)) - area) < 1e-9, `round ${round}`);
  }
});

test("what encloses nothing, or has too many corners, has no triangles", () => {
  assert.deepEqual(triangulate(of([0, 0], [1, 0])), []);
  assert.deepEqual(triangulate(Array.from({ length: 501 }, (_, i) => ({ x: Math.cos(i), z: Math.sin(i) }))), []);
  const many = Array.from({ length: 100 }, (_, i) => ({ x: i, z: 0 }));
  assert.equal(areaOf(many, triangulate(many)), 0);
});
