// The headset's scan becomes a file of a room, bounded, with the floor at 0.

import assert from "node:assert/strict";
import { test } from "node:test";
import { partsOfRoom, roomFile } from "../xr_room.js";

const transform = { position: { x: 1, y: 0, z: 2, w: 1 }, orientation: { x: 0, y: 0, z: 0, w: 1 } };
const frame = (parts) => ({ ...parts, getPose: () => ({ transform }) });
const mesh = (triangles) => ({ semanticLabel: "table", meshSpace: {}, vertices: new Float32Array(9), indices: new Uint32Array(3 * triangles) });
const plane = { semanticLabel: "wall", planeSpace: {}, polygon: [{ x: 0, z: 0 }, { x: 2, z: 0 }, { x: 2, z: 1 }, { x: 0, z: 1 }] };

test("the scan alone is the room; without one it is boxes and planes", () => {
  const scanned = partsOfRoom(frame({ detectedMeshes: new Set([mesh(12), mesh(500)]), detectedPlanes: new Set([plane]) }), null);
  assert.deepEqual(scanned.map(({ indices }) => indices.length), [1500]);
  const boxes = partsOfRoom(frame({ detectedMeshes: new Set([mesh(12)]), detectedPlanes: new Set([plane]) }), null);
  assert.deepEqual(boxes.map(({ label, indices }) => [label, indices.length]), [["table", 36], ["wall", 6]]);
  assert.deepEqual([...boxes[1].vertices.slice(0, 6)], [0, 0, 0, 2, 0, 0]);
  assert.deepEqual(partsOfRoom(frame({}), null), []);
});

test("a floor with corners that go inwards covers no more than it is", () => {
  const polygon = [[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]].map(([x, z]) => ({ x, z }));
  const [{ vertices, indices }] = partsOfRoom(frame({ detectedPlanes: new Set([{ ...plane, semanticLabel: "floor", polygon }]) }), null);
  const place = (i) => [vertices[3 * indices[i]], vertices[3 * indices[i] + 2]];
  let area = 0;
  for (let i = 0; i < indices.length; i += 3) {
    const [[ax, az], [bx, bz], [cx, cz]] = [place(i), place(i + 1), place(i + 2)];
    area += Math.abs((bx - ax) * (cz - az) - (bz - az) * (cx - ax)) / 2;
  }
  assert.ok(Math.abs(area - 6) < 1e-6, `${area} m²`);
});

test("the file is scene JSON with the floor at 0", () => {
  const parts = partsOfRoom(frame({ detectedPlanes: new Set([plane]) }), null);
  const { spatialEntities: [floor, wall] } = JSON.parse(roomFile(parts));
  assert.deepEqual([floor.semanticLabel_META, floor.locatable_META.position.y], ["FLOOR", 0]);
  assert.deepEqual(wall.locatable_META.position, { x: 1, y: 0, z: 2 });
  const bytes = Buffer.from(wall.triangleMesh_META.vertices, "base64");
  assert.deepEqual([bytes.length, bytes.readFloatLE(12)], [48, 2]);
});

test("no scan, and one that is too large, are named", () => {
  assert.throws(() => roomFile([]), /Space Setup/);
  assert.throws(() => roomFile(partsOfRoom(frame({ detectedMeshes: new Set([mesh(300_001)]) }), null)), /300001 triangles/);
});
