// Anchors of an earlier session are taken over, unless something was put elsewhere meanwhile.

import assert from "node:assert/strict";
import { test } from "node:test";
import { KeptAnchor } from "../xr_anchors.js";

/** A browser's storage with one anchor. */
function storage() {
  const items = new Map([["mr-slam.anchor.map", JSON.stringify({ handle: "h", data: { x: 1 } })]]);
  return { getItem: (key) => items.get(key) ?? null, setItem: (key, value) => items.set(key, value), removeItem: (key) => items.delete(key) };
}

test("an anchor of an earlier session is restored with its data", async () => {
  const [kept, anchor] = [new KeptAnchor("map", storage()), {}];
  assert.equal(await kept.restore({ restorePersistentAnchor: async () => anchor }), true);
  assert.deepEqual([kept.anchor, kept.data], [anchor, { x: 1 }]);
});

test("an anchor that is restored late does not take the place of a newer one", async () => {
  const kept = new KeptAnchor("map", storage());
  let arrive = () => {};
  const restored = kept.restore({ restorePersistentAnchor: () => new Promise((resolve) => { arrive = resolve; }) });
  const matrix = new Float32Array(16);
  await kept.put({}, null, matrix, { x: 2 });
  arrive({});
  assert.equal(await restored, false);
  assert.deepEqual([kept.matrix({}, null), kept.data], [matrix, { x: 2 }]);
});

test("an anchor that the device has forgotten is forgotten", async () => {
  const of = storage();
  const kept = new KeptAnchor("map", of);
  assert.equal(await kept.restore({ restorePersistentAnchor: () => Promise.reject(new Error("gone")) }), false);
  assert.equal(of.getItem("mr-slam.anchor.map"), null);
});

/** A device whose answers come when the test says so. */
function device() {
  const [waiting, forgotten, deleted] = [[], [], []];
  globalThis.XRRigidTransform = class {};
  const session = { deletePersistentAnchor: async (handle) => { forgotten.push(handle); } };
  const frame = {
    session,
    createAnchor: () => new Promise((resolve) => {
      const name = `anchor ${waiting.length}`;
      waiting.push(() => resolve({ name, delete: () => deleted.push(name), requestPersistentHandle: async () => `handle of ${name}` }));
    }),
  };
  return { frame, forgotten, deleted, answer: (i) => waiting[i]() };
}

test("an anchor that comes after a newer place was chosen is deleted, and the old handle is forgotten", async () => {
  const { frame, forgotten, deleted, answer } = device();
  const of = storage();
  const kept = new KeptAnchor("map", of);
  const [first, second] = [kept.put(frame, null, new Float32Array(16), "first"), kept.put(frame, null, new Float32Array(16), "second")];
  assert.deepEqual(forgotten, ["h"], "that of the session before");
  answer(1);
  assert.equal(await second, true);
  answer(0);
  assert.equal(await first, false);
  assert.deepEqual([kept.anchor.name, deleted, JSON.parse(of.getItem("mr-slam.anchor.map"))], ["anchor 1", ["anchor 0"], { handle: "handle of anchor 1", data: "second" }]);
});
