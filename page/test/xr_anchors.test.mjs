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
