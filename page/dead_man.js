// The dead man's switch of all input devices: what was held before an event drives nothing after it.
//
// Resetting an emergency stop must not start motion (ISO 13850). So after a stop each device must come to rest before it drives
// again. The same holds after a change of the selected robot or of the run, while somebody else drives, after a refusal, and after a
// lost connection: what is held then was meant for something else, and must not begin to drive when the other's lease ends.

/** @typedef {import("./input.js").Deflection} Deflection */
/** What each device says now; null while nothing is held, undefined while that is not known. @typedef {Record<Device, Deflection | null | undefined>} Deflections */
/** @typedef {(typeof DEVICES)[number]} Device */

/**
 * What driving by hand depends on.
 * @typedef {object} Situation
 * @property {boolean} isStopped whether an emergency stop is set or asked for
 * @property {boolean} isConnected whether the bridge answers
 * @property {string | null} robot the selected robot, by its run and its number
 * @property {"me" | "other" | null} driver who drives it, as the bridge says; "other" refuses this operator
 */

/** The input devices; of several that are held the first one drives. */
export const DEVICES = /** @type {const} */ (["headset", "stick", "keys", "gamepad"]);

/** Decides which deflection may drive. Tell it of each change at once: a change that ends before the next look counts too. */
export class DeadMan {
  constructor() {
    /** Devices that must come to rest before they drive. @type {Set<Device>} */
    this.locked = new Set(DEVICES);
    /** @type {Situation} */
    this.situation = { isStopped: false, isConnected: false, robot: null, driver: null };
  }

  /** Whether nothing drives now, whatever is held. */
  get isBlocked() { return this.situation.isStopped || !this.situation.isConnected || this.situation.robot === null || this.isRefused; }

  /** Whether the bridge refuses what this operator holds, because somebody else drives the robot. */
  get isRefused() { return this.situation.driver === "other"; }

  /** Lets a device drive only after it came to rest: it may have been held while nobody looked. @param {Device} device */
  lock(device) { this.locked.add(device); }

  /** Takes that the bridge has refused something. Where this operator is not known to drive, that may be what is held. */
  refuse() { if (this.situation.driver !== "me") DEVICES.forEach((device) => this.lock(device)); }

  /** Takes the situation and what the devices say in it. @param {Situation} situation @param {Deflections} deflections */
  observe(situation, deflections) {
    const isOther = situation.robot !== this.situation.robot;
    this.situation = situation;
    if (isOther || this.isBlocked) DEVICES.forEach((device) => this.lock(device));
    if (this.isBlocked) return;
    for (const device of this.locked) if (isAtRest(device, deflections[device])) this.locked.delete(device);
  }

  /** Returns the deflection that drives in the situation that was observed last, or null. @param {Deflections} deflections @returns {Deflection | null} */
  pass(deflections) {
    if (this.isBlocked) return null;
    const device = DEVICES.find((candidate) => deflections[candidate] && !this.locked.has(candidate));
    return (device && deflections[device]) ?? null;
  }

  /** Whether a device is held that drives only after it was let go. @param {Deflections} deflections */
  isWaiting(deflections) {
    return !this.isBlocked && DEVICES.some((device) => this.locked.has(device) && deflections[device]);
  }
}

/** Returns whether a device is at rest: let go, or not deflected. Opposite keys that are held are not. @param {Device} device @param {Deflection | null | undefined} deflection */
function isAtRest(device, deflection) {
  if (deflection === undefined) return false;
  return deflection === null || (device !== "keys" && deflection.forward === 0 && deflection.left === 0);
}
