// What the page says of a robot's battery, as the bridge knows it.

/** @typedef {{charge?: number, voltage_v?: number, is_charging?: boolean, level?: "low" | "critical", last_charge?: number, age_s: number}} Battery */

/** Words for what is urgent: a colour alone is not seen by everybody. */
const LEVELS = { low: "low", critical: "almost empty" };

/** Returns a charge in percent, rounded down: no warning contradicts it. @param {number} share 0 to 1 */
const percentOf = (share) => `${Math.floor(share * 100 + 1e-9)} %`;

/** Returns the state of a battery in a few words, or null if the robot has sent none. @param {Battery | null | undefined} battery */
export function describeBattery(battery) {
  if (!battery) return null;
  const { charge, voltage_v: volts, is_charging: isCharging, level } = battery;
  const words = [];
  if (charge !== undefined) words.push(percentOf(charge));
  if (volts !== undefined) words.push(`${volts.toFixed(1)} V`);
  if (words.length === 0) return `not known${beforeOf(battery)}, ${battery.age_s} s ago`;
  if (isCharging) words.push("charging");
  if (level) words.push(LEVELS[level]);
  return words.join(", ");
}

/** Returns what an old state said. @param {Battery} battery */
function beforeOf({ last_charge: before }) { return before === undefined ? "" : `, was ${percentOf(before)}`; }

/**
 * Returns what of a battery needs the operator's attention, with its rank, or null if nothing does.
 * @param {Battery | null | undefined} battery @returns {{rank: number, kind: string, text: string} | null}
 */
export function batteryItem(battery) {
  if (!battery) return null;
  const { charge, level, last_charge: before, age_s: ageS } = battery;
  if (level && charge !== undefined) return { rank: level === "critical" ? 1 : 3, kind: `battery ${level}`, text: `battery is ${LEVELS[level]}: ${percentOf(charge)}` };
  // A robot whose battery has run out falls silent: what it said last may say why.
  if (charge === undefined && before !== undefined) return { rank: 4, kind: "battery silent", text: `says nothing of its battery for ${ageS} s, which had ${percentOf(before)}` };
  return null;
}
