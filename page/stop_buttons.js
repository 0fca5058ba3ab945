// The buttons of the emergency stop: one sets it, the other one releases it, each at its own place.

import { element } from "./panels.js";
import { EmergencyStop } from "./stop.js";

/** Sets and releases the emergency stop of the fleet, and shows whether it is set. */
export class StopButtons {
  /**
   * @param {object} of
   * @param {import("./state.js").Fleet} of.fleet @param {() => number} of.now seconds
   * @param {(text: string, isError?: boolean) => void} of.log
   * @param {() => void} of.changed a stop was asked for, or set, or released
   * @param {() => boolean} of.sendStop returns whether it was sent @param {() => boolean} of.sendRelease
   */
  constructor(of) {
    this.of = of;
    /** The stop that was asked for here. */
    this.asked = new EmergencyStop(of.sendStop, of.log);
    element("stop").addEventListener("click", this.stop);
    element("release").addEventListener("click", this.release);
  }

  /** Asks for the stop, also for one that is set: only what comes afterwards confirms it. */
  stop = () => {
    const { fleet, now, changed } = this.of;
    if (fleet.figures.is_replay === true) return;
    this.asked.ask(now());
    changed();
    this.show();
  };

  /** Releases the stop, unless one was asked for or set just now. */
  release = () => {
    if (this.asked.mayRelease(this.of.now()) && this.of.sendRelease()) this.asked.forget();
  };

  /** Takes that the fleet has said whether the stop is set. */
  receive() {
    if (this.of.fleet.isStopped === true) this.asked.confirm(this.of.now());
    this.show();
    this.of.changed();
  }

  /** Shows whether the stop is set, and offers its release; not at once, so that the second press of a stop releases nothing. */
  show() {
    const isStopped = this.of.fleet.isStopped === true;
    element("stop").classList.toggle("set", isStopped);
    const button = /** @type {HTMLButtonElement} */ (element("release"));
    button.hidden = !isStopped;
    button.disabled = !this.asked.mayRelease(this.of.now());
  }
}
