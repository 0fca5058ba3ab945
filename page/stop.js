// The emergency stop as one page asks for it: sent again on each new connection until the fleet confirms it.

/** A stop that is not confirmed for so long is shown to the operator, seconds. */
const CONFIRM_S = 0.5;

/** An emergency stop that was asked for, until it is confirmed or released. */
export class EmergencyStop {
  /** @param {() => boolean} send sends the stop; returns whether it was sent @param {(text: string, isError?: boolean) => void} log */
  constructor(send, log) {
    this.send = send;
    this.log = log;
    /** When it was asked for, seconds. @type {number | null} */
    this.askedAt = null;
  }

  /** Asks for the stop. @param {number} now seconds */
  ask(now) {
    this.askedAt = now;
    if (!this.send()) this.log("no connection: the emergency stop is sent as soon as there is one", true);
  }

  /** Sends a stop that is not confirmed again. Call it when a connection opens. */
  repeat() { if (this.askedAt !== null) this.send(); }

  /** The fleet has set the stop. @param {number} now seconds */
  confirm(now) {
    if (this.askedAt === null) return;
    this.log(`emergency stop set, confirmed after ${((now - this.askedAt) * 1000).toFixed(0)} ms`);
    this.askedAt = null;
  }

  /** The operator releases the stop, whoever set it. */
  forget() { this.askedAt = null; }

  /** Whether it was asked for here, and is neither confirmed nor released. */
  get isAsked() { return this.askedAt !== null; }

  /** Whether the stop should have been confirmed, and is not. @param {number} now seconds */
  isUnconfirmed(now) { return this.askedAt !== null && now - this.askedAt > CONFIRM_S; }
}
