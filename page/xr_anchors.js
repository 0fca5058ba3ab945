// Places in the room that are kept: by an anchor of the device, whose handle the browser stores.

/** Beginning of the names in the browser's storage. */
const PREFIX = "mr-slam.anchor.";

/** A place in the room with data that belong to it, kept from session to session where the device can. */
export class KeptAnchor {
  /** @param {string} name @param {Storage} [storage] */
  constructor(name, storage = localStorage) {
    this.key = PREFIX + name;
    this.storage = storage;
    /** @type {any} */
    this.anchor = null;
    /** Where it is if the device has no anchors: until the headset's floor is set anew, or the session ends. @type {Float32Array | null} */
    this.fixed = null;
    /** What was stored with it. @type {any} */
    this.data = null;
    /** Counts the places: what a device answers late is about one that is no longer wanted. */
    this.sequence = 0;
  }

  /** Returns what the browser has stored, or null. @returns {{handle: string, data: any} | null} */
  stored() {
    try {
      return JSON.parse(this.storage.getItem(this.key) ?? "null");
    } catch {
      return null;
    }
  }

  /** Takes the anchor of an earlier session. Returns whether there is one. @param {any} session */
  async restore(session) {
    const sequence = this.begin(null, null);
    const stored = this.stored();
    if (!stored?.handle || !session.restorePersistentAnchor) return false;
    try {
      const anchor = await session.restorePersistentAnchor(stored.handle);
      // It came late, and was put elsewhere meanwhile.
      if (sequence !== this.sequence) return false;
      this.anchor = anchor;
      this.data = stored.data;
      return true;
    } catch {
      // The device has forgotten it, as it does when its rooms are cleared.
      if (sequence === this.sequence) this.storage.removeItem(this.key);
      return false;
    }
  }

  /** Begins with another place. Returns its number. @param {Float32Array | null} matrix @param {any} data */
  begin(matrix, data) {
    this.anchor = null;
    this.fixed = matrix;
    this.data = data;
    this.sequence += 1;
    return this.sequence;
  }

  /**
   * Puts it at another place. @param {any} frame of the session @param {any} space @param {Float32Array} matrix rigid
   * @param {any} data @returns {Promise<boolean>} whether it will be there in the next session
   */
  async put(frame, space, matrix, data) {
    const [before, stored, { session }] = [this.anchor, this.stored(), frame];
    const sequence = this.begin(matrix, data);
    before?.delete?.();
    this.storage.removeItem(this.key);
    // A device keeps a few handles only.
    if (stored?.handle) forget(session, stored.handle);
    if (!frame.createAnchor) return false;
    try {
      const anchor = await frame.createAnchor(rigidTransform(matrix), space);
      if (sequence !== this.sequence) {
        anchor.delete?.();
        return false;
      }
      this.anchor = anchor;
      if (!anchor.requestPersistentHandle) return false;
      const handle = await anchor.requestPersistentHandle();
      if (sequence !== this.sequence) {
        forget(session, handle);
        return false;
      }
      this.storage.setItem(this.key, JSON.stringify({ handle, data }));
      return true;
    } catch {
      return false;
    }
  }

  /** Forgets where it is without an anchor: the headset's floor was set anew, and its coordinates are others. */
  forgetFixed() { this.fixed = null; }

  /** Returns where it is now, or null if that is not known. @param {any} frame @param {any} space @returns {Float32Array | null} */
  matrix(frame, space) {
    if (!this.anchor) return this.fixed;
    return frame.getPose(this.anchor.anchorSpace, space)?.transform.matrix ?? this.fixed;
  }
}

/** Lets the device forget a handle. @param {any} session @param {string} handle */
function forget(session, handle) {
  // It may have been forgotten before.
  session?.deletePersistentAnchor?.(handle)?.catch?.(() => {});
}

/** Returns a matrix as WebXR's transform. It turns about the vertical axis only. @param {Float32Array} matrix */
function rigidTransform(matrix) {
  const half = Math.atan2(matrix[8], matrix[0]) / 2;
  const position = { x: matrix[12], y: matrix[13], z: matrix[14], w: 1 };
  const RigidTransform = /** @type {any} */ (globalThis).XRRigidTransform;
  return new RigidTransform(position, { x: 0, y: Math.sin(half), z: 0, w: Math.cos(half) });
}
