import assert from "node:assert/strict";
import { test } from "node:test";
import { RunClock } from "../clock.js";

test("before the first answer a message is as old as its arrival", () => {
  assert.equal(new RunClock().toPage(3, 100), 100);
});

test("the age of a message is that of its stamp, however long it was on its way", () => {
  const clock = new RunClock();
  // The run began 40 s after the page; both ways take 0.15 s.
  clock.add(50, 50.3, 10.15);
  assert.ok(Math.abs(clock.toPage(10, 50.4) - 50) < 1e-9);
  assert.equal(clock.toPage(99, 50.4), 50.4, "nothing is from the future");
});

test("an answer that was held up on one way does not shift the clock", () => {
  const clock = new RunClock();
  clock.add(50, 50.02, 10.01);
  for (let i = 1; i < 10; i += 1) clock.add(50 + i, 51.2 + i, 11.19 + i);
  assert.ok(Math.abs(clock.toPage(12, 60) - 52) < 1e-9);
  assert.ok(Math.abs((clock.roundTrip() ?? 0) - 1.2) < 1e-9);
  clock.add(70, 70.02, 40.01);
  clock.reset();
  assert.equal(clock.roundTrip(), null);
});

test("a bridge whose clock was set, or stood, is believed at once; a slow answer alone changes nothing", () => {
  for (let setBy = -60; setBy <= 60; setBy += 0.5) {
    const clock = new RunClock();
    for (let i = 0; i < 5; i += 1) clock.add(i, i + 0.01, 1000 + i);
    // The answer took two seconds: nearly all of it one way.
    clock.add(10, 12, 1011.9 + setBy);
    const estimated = 12 - clock.toPage(1012, 12);
    if (setBy > 3) assert.ok(Math.abs(estimated - setBy) <= 1, `${setBy} s: ${estimated}`);
    // A command must not be refused as late for the sake of one slow answer: the time is not known until a quick one comes.
    if (Math.abs(setBy) > 3) assert.equal(clock.toBridge(12), null);
    else if (setBy === 0) assert.ok(Math.abs(clock.toBridge(12) - 1012) < 0.01);
    clock.add(13, 13.02, 1013.01 + setBy);
    if (setBy === 0 || Math.abs(setBy) > 3) assert.ok(Math.abs(clock.toBridge(14) - 1014 - setBy) < 0.1, `${setBy} s`);
  }
});
