// What the operator's hands do: keys, a gamepad and the stick on the screen become a velocity.
//
// Every control is a dead man's switch: a robot moves only while something is held.

/** Deflection of a gamepad's stick that counts as none, 0 to 1. */
const DEADZONE = 0.12;
/** Buttons of a gamepad that must be held to drive (standard mapping): the right shoulder and the right trigger. */
const GAMEPAD_DEAD_MAN = [5, 7];
/** Share of the largest speed for keys, unless Shift is held. */
const KEY_SHARE = 0.6;

/** @typedef {{forward: number, left: number}} Deflection each from -1 to 1 */

/** Keys that drive, by `KeyboardEvent.code`: forward and left. @type {Record<string, [number, number]>} */
const DRIVE_KEYS = {
  KeyW: [1, 0], ArrowUp: [1, 0], KeyS: [-1, 0], ArrowDown: [-1, 0],
  KeyA: [0, 1], ArrowLeft: [0, 1], KeyD: [0, -1], ArrowRight: [0, -1],
};

/** Returns whether a key drives. */
export function isDriveKey(/** @type {string} */ code) { return code in DRIVE_KEYS; }

/** Returns the deflection of the keys that are held, or null if none drives. */
export function keyDeflection(/** @type {Set<string>} */ held) {
  const driving = [...held].filter(isDriveKey);
  if (driving.length === 0) return null;
  const share = held.has("ShiftLeft") || held.has("ShiftRight") ? 1 : KEY_SHARE;
  const sum = (/** @type {0 | 1} */ axis) => driving.reduce((total, code) => total + DRIVE_KEYS[code][axis], 0);
  return { forward: share * clamp(sum(0)), left: share * clamp(sum(1)) };
}

/**
 * Returns the deflection of a gamepad's left stick while its dead man's switch is held, else null.
 * @param {{axes: readonly number[], buttons: readonly {pressed: boolean}[]} | null} gamepad
 */
export function gamepadDeflection(gamepad) {
  if (!gamepad || !GAMEPAD_DEAD_MAN.some((button) => gamepad.buttons[button]?.pressed)) return null;
  const [x = 0, y = 0] = gamepad.axes;
  return { forward: withDeadzone(-y), left: withDeadzone(-x) };
}

/** Buttons and axes of a headset's controller (xr-standard mapping): the grip, and the thumbstick. */
const GRIP = 1;
const THUMBSTICK = [2, 3];

/**
 * Returns the deflection of a headset's thumbstick while the grip is held, else null.
 * @param {{axes: readonly number[], buttons: readonly {pressed: boolean}[]}} gamepad
 */
export function thumbstickDeflection({ axes, buttons }) {
  if (!buttons[GRIP]?.pressed) return null;
  const [x, y] = THUMBSTICK.map((axis) => axes[axis] ?? 0);
  return stickDeflection(x, y);
}

/** Returns the deflection of a stick on the screen whose knob is so far from its middle, in radii. */
export function stickDeflection(/** @type {number} */ x, /** @type {number} */ y) {
  return { forward: withDeadzone(clamp(-y)), left: withDeadzone(clamp(-x)) };
}

/** Returns 0 for a small deflection, and continues from there. */
export function withDeadzone(/** @type {number} */ value) {
  const size = Math.abs(value);
  if (!(size > DEADZONE)) return 0;
  return (Math.sign(value) * Math.min(1, size) - Math.sign(value) * DEADZONE) / (1 - DEADZONE);
}

function clamp(/** @type {number} */ value) { return Math.min(1, Math.max(-1, value)); }

/** Zeros that are sent after the last velocity: one may be lost. */
const ZEROS = 3;

/** Decides what is sent to which robot at each tick. A robot that was driven gets zeros when nothing is held any more. */
export class Driver {
  constructor() {
    /** @type {number | null} */
    this.driven = null;
    this.zeros = 0;
  }

  /**
   * Returns the velocities to send now, as shares of the largest: of the robot that is driven, and zeros.
   * @param {Deflection | null} deflection what is held @param {number | null} selected the selected robot
   */
  tick(deflection, selected) {
    /** @type {{robot: number, forward: number, left: number}[]} */
    const commands = [];
    const target = deflection ? selected : null;
    if (this.driven !== null && this.driven !== target) {
      commands.push({ robot: this.driven, forward: 0, left: 0 });
      this.zeros -= 1;
      if (this.zeros <= 0 || target !== null) this.driven = null;
    }
    if (deflection && target !== null) {
      commands.push({ robot: target, ...deflection });
      this.driven = target;
      this.zeros = ZEROS;
    }
    return commands;
  }
}
