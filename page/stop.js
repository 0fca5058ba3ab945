// The emergency stop as one page asks for it: sent again on each new connection until the fleet confirms it.

/** A stop that is not confirmed for so long is shown to the operator, seconds. */
const CONFIRM_S = 0.5;
/** A release is not taken for so long after a stop was asked for or set, seconds: it may be the second press of a stop. */
const RELEASE_AFTER_S = 1;

/** An emergency stop that was asked for, until it is confirmed or released. */
export class EmergencyStop {
  /** @param {() => boolean} send sends the stop; returns whether it was sent @param {(text: string, isError?: boolean) => void} log */
  constructor(send, log) {
    this.send = send;
    this.log = log;
    /** When it was asked for, seconds. @type {number | null} */
    this.askedAt = null;
    /** When a stop was asked for here, or was set by anyone, last: seconds. */
    this.newestAt = -Infinity;
  }

  /** Asks for the stop. @param {number} now seconds */
  ask(now) {
    this.askedAt = now;
    this.newestAt = now;
    if (!this.send()) this.log("no connection: the emergency stop is sent as soon as there is one", true);
  }

  /** Sends a stop that is not confirmed again. Call it when a connection opens. */
  repeat() { if (this.askedAt !== null) this.send(); }

  /** The fleet has said that the stop is set: each time that it does. What it said before a stop was asked for confirms nothing. @param {number} now seconds */
  confirm(now) {
    this.newestAt = now;
    if (this.askedAt === null) return;
    this.log(`emergency stop set, confirmed after ${((now - this.askedAt) * 1000).toFixed(0)} ms`);
    this.askedAt = null;
  }

  /** Whether a release is meant: no stop was asked for or set just now. @param {number} now seconds */
  mayRelease(now) { return now - this.newestAt >= RELEASE_AFTER_S; }

  /** The operator releases the stop, whoever set it. */
  forget() { this.askedAt = null; }

  /** Whether it was asked for here, and is neither confirmed nor released. */
  get isAsked() { return this.askedAt !== null; }

  /** Whether the stop should have been confirmed, and is not. @param {number} now seconds */
  isUnconfirmed(now) { return this.askedAt !== null && now - this.askedAt > CONFIRM_S; }
}
