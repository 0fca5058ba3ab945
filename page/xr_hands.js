// Driving with a bare hand in mixed reality: the left hand's pinch is a stick that is held in the air.
//
// It is a dead man's switch: whoever opens the fingers, or whose hand the headset loses, lets go.

import { stickDeflection } from "./input.js";

/** @typedef {import("./input.js").Deflection} Deflection */
/** @typedef {[number, number, number]} Vector */

/** The hand that drives; the other one points. */
export const DRIVING_HAND = "left";
/** Fingertips closer than this begin to hold, metres; farther than `open` they let go. Between them nothing changes. */
const PINCH_M = { closed: 0.015, open: 0.03 };
/** A hand that has moved so far from where it closed is a full deflection, metres. */
const FULL_M = 0.1;

/** The stick in the hand. */
export class HandStick {
  constructor() {
    /** Where the fingers closed and where they are, while they hold, in WebXR. @type {{from: Vector, at: Vector, heading: number} | null} */
    this.held = null;
    /** Whether the fingers must open before they can hold: they were closed when the hand was found. */
    this.mustOpen = true;
  }

  /** Lets go, until the fingers have been open. */
  release() {
    this.held = null;
    this.mustOpen = true;
  }

  /**
   * Takes the state of a frame. @param {any} session @param {any} frame @param {any} space
   * @param {number} heading where the viewer looks, radians about WebXR's y axis: ahead is that way when the fingers close
   * @returns {Deflection | null} null if nothing is held
   */
  update(session, frame, space, heading) {
    const source = [...session.inputSources].find(({ hand, handedness }) => hand && handedness === DRIVING_HAND);
    const tip = (/** @type {string} */ joint) => (source ? placeOf(frame.getJointPose?.(source.hand.get(joint), space)) : null);
    const [thumb, index] = [tip("thumb-tip"), tip("index-finger-tip")];
    if (!thumb || !index) {
      this.release();
      return null;
    }
    const gap = Math.hypot(...thumb.map((value, i) => value - index[i]));
    const at = /** @type {Vector} */ (thumb.map((value, i) => (value + index[i]) / 2));
    if (gap > PINCH_M.open) {
      this.held = null;
      this.mustOpen = false;
    } else if (!this.held && !this.mustOpen && gap < PINCH_M.closed) {
      this.held = { from: at, at, heading };
    }
    if (!this.held) return null;
    this.held.at = at;
    return deflectionOf(this.held);
  }
}

/** Returns how far a hand has moved to the right and towards the viewer, as a stick has. @param {{from: Vector, at: Vector, heading: number}} held */
function deflectionOf({ from, at, heading }) {
  const [x, z] = [(at[0] - from[0]) / FULL_M, (at[2] - from[2]) / FULL_M];
  const [c, s] = [Math.cos(heading), Math.sin(heading)];
  return stickDeflection(c * x - s * z, s * x + c * z);
}

/** @param {any} pose @returns {Vector | null} */
function placeOf(pose) {
  if (!pose) return null;
  const { x, y, z } = pose.transform.position;
  return [x, y, z].every(Number.isFinite) ? [x, y, z] : null;
}
