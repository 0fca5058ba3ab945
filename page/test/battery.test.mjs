// Batteries of robots: what the panels and the list of attention say of them.

import assert from "node:assert/strict";
import { test } from "node:test";
import { batteryItem, describeBattery } from "../battery.js";
import { ROBOT_ROWS } from "../panels.js";
import { Fleet } from "../state.js";
import { rowsOf } from "../xr_panels.js";

const robots = (battery) => [{ number: 1, prefix: "/robot1/", slam: "tracking", battery }];
const fleetWith = (battery) => {
  const fleet = new Fleet();
  fleet.setFigures({ robots: robots(battery) }, 0);
  fleet.robots.get(1).scanAt = 0;
  return fleet;
};

test("a battery is described by what is known of it", () => {
  assert.equal(describeBattery({ charge: 0.42, voltage_v: 11.26, age_s: 0 }), "42 %, 11.3 V");
  assert.equal(describeBattery({ voltage_v: 11.26, age_s: 0 }), "11.3 V");
  assert.equal(describeBattery({ charge: 0.1999, level: "low", age_s: 0 }), "19 %, low");
  assert.equal(describeBattery({ charge: 0.29, age_s: 0 }), "29 %", "0.29 * 100 is less than 29");
  assert.equal(describeBattery({ charge: 0, level: "critical", age_s: 0 }), "0 %, almost empty");
  assert.equal(describeBattery({ charge: 0.05, is_charging: true, age_s: 0 }), "5 %, charging");
  assert.equal(describeBattery({ last_charge: 0.08, age_s: 45 }), "not known, was 8 %, 45 s ago");
  assert.equal(describeBattery({ age_s: 45 }), "not known, 45 s ago");
});

test("a robot that sends no battery has no row of it", () => {
  for (const none of [undefined, null]) {
    assert.equal(describeBattery(none), null);
    assert.equal(batteryItem(none), null);
    assert.ok(!rowsOf(fleetWith(none).robots.get(1), 0).some(([heading]) => heading === "Battery"));
  }
  const rows = rowsOf(fleetWith({ charge: 0.42, age_s: 0 }).robots.get(1), 0);
  assert.equal(rows.length, ROBOT_ROWS.length);
  assert.deepEqual(rows.find(([heading]) => heading === "Battery"), ["Battery", "42 %"]);
});

test("a low charge needs attention, an almost empty one before most others, and a full or charging one none", () => {
  const items = (battery) => fleetWith(battery).attention(0, true).map(({ rank, text, key }) => [rank, text, key]);
  assert.deepEqual(items({ charge: 0.17, level: "low", age_s: 0 }), [[3, "battery is low: 17 %", "battery low 1"]]);
  assert.deepEqual(items({ charge: 0.08, level: "critical", age_s: 0 }), [[1, "battery is almost empty: 8 %", "battery critical 1"]]);
  for (const calm of [{ charge: 0.5, last_charge: 0.5, age_s: 0 }, { charge: 0.05, is_charging: true, age_s: 0 }, { voltage_v: 10.2, age_s: 0 }, { age_s: 60 }]) {
    assert.deepEqual(items(calm), [], JSON.stringify(calm));
  }
  // One that is acknowledged as low comes again when it is almost empty: its key is another.
  assert.deepEqual(items({ last_charge: 0.08, age_s: 45 }), [[4, "says nothing of its battery for 45 s, which had 8 %", "battery silent 1"]]);
});
