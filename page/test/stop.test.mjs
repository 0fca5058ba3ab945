// The emergency stop of one page: sent until it is confirmed.

import assert from "node:assert/strict";
import { test } from "node:test";
import { EmergencyStop } from "../stop.js";

test("a stop that is asked for without a connection is sent on the next one, and once it is confirmed no more", () => {
  let [isOpen, sent] = [false, 0];
  const said = [];
  const stop = new EmergencyStop(() => { sent += isOpen ? 1 : 0; return isOpen; }, (text) => said.push(text));
  stop.repeat();
  stop.ask(10);
  assert.equal(sent, 0);
  assert.match(said[0], /no connection/);
  assert.deepEqual([stop.isUnconfirmed(10.4), stop.isUnconfirmed(10.6)], [false, true]);
  isOpen = true;
  stop.repeat();
  assert.equal(sent, 1);
  stop.confirm(12);
  assert.match(said[1], /confirmed after 2000 ms/);
  stop.repeat();
  stop.confirm(13);
  assert.deepEqual([sent, said.length, stop.isUnconfirmed(20)], [1, 2, false]);
});

test("a stop that the operator releases is not sent again, and somebody else's is no confirmation", () => {
  const said = [];
  const stop = new EmergencyStop(() => true, (text) => said.push(text));
  stop.ask(1);
  stop.forget();
  stop.confirm(90);
  assert.deepEqual(said, []);
});

test("a release counts only when no stop was asked for or set just before: it may be the second press of a stop", () => {
  for (let tenths = 0; tenths <= 30; tenths += 1) {
    const stop = new EmergencyStop(() => true, () => {});
    assert.equal(stop.mayRelease(5), true);
    stop.ask(10);
    stop.confirm(10.5);
    stop.confirm(11);
    assert.equal(stop.mayRelease(10 + tenths / 10), tenths >= 20, `${tenths}`);
  }
});
