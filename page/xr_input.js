// Controllers and hands in mixed reality: what drives, what is pressed, where it points.

import { thumbstickDeflection } from "./input.js";
import { transformDirection } from "./matrix.js";
import { DRIVING_HAND, HandStick } from "./xr_hands.js";

/** @typedef {import("./input.js").Deflection} Deflection */
/** @typedef {[number, number, number]} Vector */
/** @typedef {{origin: Vector, direction: Vector}} Ray */

/** Buttons of a controller (xr-standard mapping, Touch Plus). */
const STICK = 3;
const LOWER = 4;
const UPPER = 5;
/** The deflection of a frame counts for so long, seconds: frames stop when the headset is taken off. */
const FRESH_S = 0.2;
/**
 * After so long without a frame that knows where the headset is, seconds, it was not worn: what is held drives only after it was
 * open. Shorter gaps are those of a device that is slow for a moment.
 */
const UNWORN_S = 1;

/** What buttons do. @typedef {{next: () => void, previous: () => void, stop: () => void, changeView: () => void}} Actions */

/** Reads the input sources of a session. */
export class Controls {
  /** @param {Actions} actions */
  constructor(actions) {
    this.actions = actions;
    /** Buttons that were down in the last frame. @type {Set<string>} */
    this.down = new Set();
    /** @type {Deflection | null} */
    this.deflection = null;
    this.deflectionAt = -Infinity;
    /** Whether the right grip drives only after it was open: it may have been held while it was not seen. */
    this.mustOpenGrip = true;
    /** @type {Ray[]} */
    this.rays = [];
    this.hand = new HandStick();
  }

  /** Lets go of the grip and of the hand, until they have been open. */
  release() {
    this.mustOpenGrip = true;
    this.hand.release();
  }

  /** Takes the buttons of a frame, also of one in which the headset does not know where it is: they stop robots. @param {any} session */
  readButtons(session) {
    if (session.visibilityState !== "visible") return;
    const down = new Set();
    for (const { gamepad, handedness, hand } of session.inputSources) {
      if (!gamepad || hand) continue;
      gamepad.buttons.forEach((/** @type {any} */ button, /** @type {number} */ i) => {
        if (button.pressed) down.add(`${handedness} ${i}`);
      });
    }
    const pressed = [...down].filter((button) => !this.down.has(button));
    this.down = down;
    pressed.forEach((button) => this.press(button));
  }

  /**
   * Takes what drives and points in a frame. @param {any} session @param {any} frame @param {any} space @param {number} now seconds
   * @param {number} [heading] where the viewer looks, radians about WebXR's y axis
   */
  update(session, frame, space, now, heading = 0) {
    this.rays = [];
    this.deflection = null;
    if (now - this.deflectionAt > UNWORN_S) this.release();
    this.deflectionAt = now;
    if (session.visibilityState !== "visible") {
      this.release();
      return;
    }
    /** @type {Deflection | null | undefined} */
    let byGrip;
    for (const source of session.inputSources) {
      const ray = source.targetRayMode === "tracked-pointer" && !isDrivingHand(source) ? rayOf(frame, source, space) : null;
      if (ray) this.rays.push(ray);
      const { gamepad, handedness } = source;
      if (!gamepad || source.hand) continue;
      if (handedness === "right") byGrip = thumbstickDeflection(gamepad);
    }
    this.mustOpenGrip = byGrip === undefined || (this.mustOpenGrip && byGrip !== null);
    this.deflection = this.mustOpenGrip ? null : byGrip ?? null;
    // A controller in the right hand drives before a bare left hand.
    const byHand = this.hand.update(session, frame, space, heading);
    this.deflection ??= byHand;
  }

  press(/** @type {string} */ button) {
    const { next, previous, stop, changeView } = this.actions;
    /** @type {Record<string, () => void>} */
    const meanings = {
      [`right ${LOWER}`]: next, [`left ${LOWER}`]: previous,
      [`right ${UPPER}`]: stop, [`left ${UPPER}`]: stop, [`left ${STICK}`]: changeView,
    };
    meanings[button]?.();
  }

  /** Returns what the thumbstick says now, null if its dead man's switch is open, or undefined if frames have stopped. */
  drive(/** @type {number} */ now) { return now - this.deflectionAt > FRESH_S ? undefined : this.deflection; }
}

/** Returns whether a source is the bare hand that drives: it points at nothing. @param {any} source */
export function isDrivingHand({ hand, handedness }) { return Boolean(hand) && handedness === DRIVING_HAND; }

/** Returns the ray of an input source, or null if it is not tracked. @param {any} frame @param {any} source @param {any} space @returns {Ray | null} */
export function rayOf(frame, source, space) {
  const pose = frame.getPose(source.targetRaySpace, space);
  if (!pose) return null;
  const { matrix } = pose.transform;
  return { origin: [matrix[12], matrix[13], matrix[14]], direction: transformDirection(matrix, [0, 0, -1]) };
}

/** Lets all controllers of a session vibrate. @param {any} session @param {number} strength 0 to 1 @param {number} ms */
export function pulse(session, strength, ms) {
  for (const { gamepad } of session.inputSources) {
    const actuator = gamepad?.hapticActuators?.[0];
    // It is refused while the controller sleeps.
    actuator?.pulse?.(strength, ms)?.catch?.(() => {});
  }
}
