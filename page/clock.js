// A clock of the bridge (the time of the run, or its own), as the page estimates it: how old a message is does not depend on how long it was on its way.

/** Answers that are kept; the one that came back soonest counts. */
const SAMPLES_MAX = 10;
/** An answer may differ from the best one by this and half the time that both took, seconds. By more, the bridge's clock has been set, or stood. */
const DRIFT_S = 0.5;
/** An answer that took longer may be wrong by so much that the bridge refuses commands as late, seconds: it allows them 1 s. */
const TOOK_MAX_S = 1;

/** The bridge's clock beside the page's. All times are seconds. */
export class RunClock {
  constructor() {
    /** The newest answers: the run's time minus the page's, and how long the answer took. @type {{offset: number, tookS: number}[]} */
    this.samples = [];
  }

  /** Forgets all answers: the bridge is another one. */
  reset() { this.samples = []; }

  /**
   * Takes an answer of the bridge. The question and the answer are taken for equally long on their way (as NTP does).
   * @param {number} askedAt when the page asked @param {number} answeredAt when the answer came, both on the page's clock
   * @param {number} runTime the run's time in the answer
   */
  add(askedAt, answeredAt, runTime) {
    const [offset, tookS, best] = [runTime - (askedAt + answeredAt) / 2, answeredAt - askedAt, this.best()];
    if (best && Math.abs(offset - best.offset) > DRIFT_S + (tookS + best.tookS) / 2) this.reset();
    this.samples.push({ offset, tookS });
    if (this.samples.length > SAMPLES_MAX) this.samples.shift();
  }

  /** Returns how long the newest answer took, or null if there is none. */
  roundTrip() { return this.samples.at(-1)?.tookS ?? null; }

  /** Returns the answer that was on its way for the shortest time, or null if there is none. */
  best() {
    return this.samples.length === 0 ? null : this.samples.reduce((a, b) => (b.tookS < a.tookS ? b : a));
  }

  /** Returns the bridge's time at a time of the page, or null if it is not known so well that a command would be taken for new. */
  toBridge(/** @type {number} */ now) {
    const best = this.best();
    return best && best.tookS <= TOOK_MAX_S ? now + best.offset : null;
  }

  /** Returns when something with this stamp happened, on the page's clock: now, at the latest. */
  toPage(/** @type {number} */ stamp, /** @type {number} */ now) {
    const best = this.best();
    return best ? Math.min(now, stamp - best.offset) : now;
  }
}
