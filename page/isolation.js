// Parts of the page that fail by themselves: an error in one of them keeps no other one from what it shows.

/** Runs parts, and says once of each error what has failed. */
export class Isolation {
  /** @param {(text: string) => void} say */
  constructor(say) {
    this.say = say;
    /** The error that each part has, until it succeeds again. @type {Map<string, string>} */
    this.errors = new Map();
  }

  /** Runs a part. @param {string} name for the operator @param {() => void} act */
  run(name, act) {
    try {
      act();
      this.errors.delete(name);
    } catch (error) {
      const text = error instanceof Error ? error.message : String(error);
      if (this.errors.get(name) === text) return;
      this.errors.set(name, text);
      this.say(`${name} cannot be shown: ${text}`);
    }
  }
}
