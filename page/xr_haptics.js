// Vibration of the controllers: when the emergency stop is set, and when something newly needs attention.

import { pulse } from "./xr_input.js";

/** Ranks of attention up to which a new item is an alarm. */
const ALARM_RANK = 3;
/** Strength and length of the controllers' pulses, ms. */
const STOP_PULSE = /** @type {const} */ ([1, 400]);
const ALARM_PULSE = /** @type {const} */ ([0.5, 150]);

/** Lets the controllers vibrate once at each change. */
export class HapticAlerts {
  constructor() {
    this.wasStopped = false;
    /** Keys of the alarms that the controllers vibrated for. @type {Set<string>} */
    this.alarms = new Set();
  }

  /** Lets them vibrate if the stop was set, or something new needs attention. @param {any} session @param {boolean} isStopped @param {{rank: number, key: string}[]} attention */
  update(session, isStopped, attention) {
    if (isStopped && !this.wasStopped) pulse(session, ...STOP_PULSE);
    this.wasStopped = isStopped;
    const alarms = new Set(attention.filter(({ rank }) => rank <= ALARM_RANK).map(({ key }) => key));
    if ([...alarms].some((alarm) => !this.alarms.has(alarm))) pulse(session, ...ALARM_PULSE);
    this.alarms = alarms;
  }
}
