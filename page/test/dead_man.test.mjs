// The dead man's switch: whatever happens, nothing drives that was held before the newest stop, selection, loss of control or of the link.

import assert from "node:assert/strict";
import { test } from "node:test";
import { DEVICES, DeadMan } from "../dead_man.js";

const FREE = { isStopped: false, isConnected: true, robot: "1 1", driver: null };
const FULL = { forward: 1, left: 0 };
const ZERO = { forward: 0, left: 0 };
const none = () => Object.fromEntries(DEVICES.map((device) => [device, null]));
const only = (device, deflection = FULL) => ({ ...none(), [device]: deflection });

/** A switch of which everything was let go. */
function released(situation = FREE) {
  const deadMan = new DeadMan();
  deadMan.observe(situation, none());
  return deadMan;
}

/** Returns what drives after a look at this situation and these devices. */
function drive(deadMan, situation, deflections) {
  deadMan.observe(situation, deflections);
  return deadMan.pass(deflections);
}

/** What makes a held control one that must be let go, as situations that follow each other. */
const EVENTS = {
  "a stop that was released": [{ ...FREE, isStopped: true }],
  "a lost connection": [{ ...FREE, isConnected: false }],
  "the selection of another robot": [{ ...FREE, robot: "1 2" }],
  "another run": [{ ...FREE, robot: null }],
  "another driver": [{ ...FREE, driver: "me" }, { ...FREE, driver: "other" }],
  "a driver that was there before": [{ ...FREE, driver: "other" }],
};

for (const [name, situations] of Object.entries(EVENTS)) {
  test(`after ${name} each device drives only when it was let go and is held anew`, () => {
    for (const device of DEVICES) {
      const deadMan = released();
      assert.deepEqual(drive(deadMan, FREE, only(device)), FULL);
      for (const situation of situations) deadMan.observe(situation, only(device));
      for (let i = 0; i < 3; i += 1) assert.equal(drive(deadMan, FREE, only(device)), null, device);
      assert.equal(deadMan.isWaiting(only(device)), true);
      drive(deadMan, FREE, none());
      assert.deepEqual(drive(deadMan, FREE, only(device)), FULL, device);
    }
  });
}

test("what is let go and held anew while the stop is set does not drive when it is released", () => {
  const deadMan = released();
  const stopped = { ...FREE, isStopped: true };
  for (const deflections of [only("keys"), none(), only("keys")]) assert.equal(drive(deadMan, stopped, deflections), null);
  assert.equal(drive(deadMan, FREE, only("keys")), null);
});

test("a stick in its middle is at rest, opposite keys are not", () => {
  for (const device of DEVICES) {
    const deadMan = released({ ...FREE, isStopped: true });
    drive(deadMan, FREE, only(device, ZERO));
    assert.deepEqual(drive(deadMan, FREE, only(device)), device === "keys" ? null : FULL, device);
  }
});

test("a device that is not heard is not known to be at rest, and drives nothing", () => {
  const [deadMan, unheard] = [released(), { ...none(), headset: undefined }];
  drive(deadMan, FREE, only("headset"));
  assert.equal(drive(deadMan, FREE, unheard), null);
  assert.deepEqual(drive(deadMan, FREE, only("headset")), FULL, "frames have stopped for a moment");
  drive(deadMan, { ...FREE, isStopped: true }, only("headset"));
  drive(deadMan, FREE, unheard);
  assert.equal(drive(deadMan, FREE, only("headset")), null);
  drive(deadMan, FREE, none());
  deadMan.lock("headset");
  assert.equal(drive(deadMan, FREE, only("headset")), null);
});

test("a device that must be let go keeps no other one from driving", () => {
  const deadMan = released();
  drive(deadMan, { ...FREE, robot: "1 2" }, only("keys"));
  const both = { ...only("keys"), stick: { forward: -1, left: 0 } };
  assert.deepEqual(drive(deadMan, { ...FREE, robot: "1 2" }, both), { forward: -1, left: 0 });
});

test("what is held while somebody else drives does not drive when the lease ends, or after a takeover, until it was let go", () => {
  for (const device of DEVICES) for (const next of [null, "me"]) {
    const deadMan = released({ ...FREE, driver: "other" });
    assert.equal(drive(deadMan, { ...FREE, driver: "other" }, only(device)), null, "nothing is sent");
    assert.equal(deadMan.isRefused, true);
    for (let i = 0; i < 3; i += 1) assert.equal(drive(deadMan, { ...FREE, driver: next }, only(device)), null, `${device}, ${next}`);
    assert.equal(deadMan.isWaiting(only(device)), true);
    drive(deadMan, { ...FREE, driver: next }, none());
    assert.deepEqual(drive(deadMan, { ...FREE, driver: next }, only(device)), FULL);
  }
});

test("what the bridge refuses must be let go, and a refusal of something else stops nobody who drives", () => {
  for (const device of DEVICES) {
    const deadMan = released();
    assert.deepEqual(drive(deadMan, FREE, only(device)), FULL, "that somebody else drives is not known yet");
    deadMan.refuse();
    for (let i = 0; i < 3; i += 1) assert.equal(drive(deadMan, FREE, only(device)), null, device);
    drive(deadMan, FREE, none());
    drive(deadMan, { ...FREE, driver: "me" }, only(device));
    deadMan.refuse();
    assert.deepEqual(drive(deadMan, { ...FREE, driver: "me" }, only(device)), FULL, "such as a zone");
  }
});

/** A generator of numbers from 0 to 1 (mulberry32). */
function randomOf(seed) {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

/** Changes the situation or a device at random, rarely both. */
function change(random, situation, deflections) {
  const pick = (values) => values[Math.floor(random() * values.length)];
  const changes = [
    () => { situation.isStopped = pick([true, false, false]); },
    () => { situation.isConnected = pick([true, true, false]); },
    () => { situation.robot = pick(["1 1", "1 2", "2 1", null]); },
    () => { situation.driver = pick(["me", "other", null]); },
  ];
  if (random() < 0.3) pick(changes)();
  if (random() < 0.6) deflections[pick(DEVICES)] = pick([null, undefined, ZERO, FULL, { forward: 0, left: -0.5 }]);
}

test("whatever the order of events, a deflection drives only if its device was at rest since the newest of them", () => {
  let driven = 0;
  for (let seed = 1; seed <= 300; seed += 1) {
    const random = randomOf(seed);
    const deadMan = new DeadMan();
    const [situation, deflections] = [{ ...FREE }, none()];
    // The devices that were at rest, by the definition: forgotten at each event.
    const [rested, before] = [new Set(), { robot: null }];
    for (let step = 0; step < 200; step += 1) {
      change(random, situation, deflections);
      const isBlocked = situation.isStopped || !situation.isConnected || situation.robot === null || situation.driver === "other";
      const isOther = before.robot !== situation.robot;
      if (isBlocked || isOther) rested.clear();
      if (random() < 0.05) {
        deadMan.refuse();
        if (deadMan.situation.driver !== "me") rested.clear();
      }
      before.robot = situation.robot;
      for (const device of DEVICES) {
        const held = deflections[device];
        if (!isBlocked && (held === null || (held && device !== "keys" && !held.forward && !held.left))) rested.add(device);
      }
      const passed = drive(deadMan, { ...situation }, { ...deflections });
      const may = isBlocked ? undefined : DEVICES.find((device) => deflections[device] && rested.has(device));
      assert.deepEqual(passed, may === undefined ? null : deflections[may], `seed ${seed}, step ${step}`);
      if (passed && (passed.forward || passed.left)) driven += 1;
    }
  }
  assert.ok(driven > 1000, `${driven} velocities: the property says something`);
});
