// Places in the room that are kept: by an anchor of the device, whose handle the browser stores.

/** Beginning of the names in the browser's storage. */
const PREFIX = "mr-slam.anchor.";

/** A place in the room with a text that belongs to it, kept from session to session where the device can. */
export class KeptAnchor {
  /** @param {string} name @param {Storage} [storage] */
  constructor(name, storage = localStorage) {
    this.key = PREFIX + name;
    this.storage = storage;
    /** @type {any} */
    this.anchor = null;
    /** Where it is if the device has no anchors: for this session only. @type {Float32Array | null} */
    this.fixed = null;
    /** What was stored with it. @type {any} */
    this.data = null;
  }

  /** Takes the anchor of an earlier session. Returns whether there is one. @param {any} session */
  async restore(session) {
    this.anchor = null;
    this.fixed = null;
    try {
      const stored = JSON.parse(this.storage.getItem(this.key) ?? "null");
      if (!stored?.handle || !session.restorePersistentAnchor) return false;
      const anchor = await session.restorePersistentAnchor(stored.handle);
      // It came late, and was put elsewhere meanwhile.
      if (this.fixed !== null) return false;
      this.anchor = anchor;
      this.data = stored.data;
      return true;
    } catch {
      // The device has forgotten it, as it does when its rooms are cleared.
      this.storage.removeItem(this.key);
      return false;
    }
  }

  /**
   * Puts it at another place. @param {any} frame of the session @param {any} space @param {Float32Array} matrix rigid
   * @param {any} data @returns {Promise<boolean>} whether it will be there in the next session
   */
  async put(frame, space, matrix, data) {
    this.fixed = matrix;
    this.data = data;
    this.anchor?.delete?.();
    this.anchor = null;
    this.storage.removeItem(this.key);
    if (!frame.createAnchor) return false;
    try {
      const anchor = await frame.createAnchor(rigidTransform(matrix), space);
      this.anchor = anchor;
      if (!anchor.requestPersistentHandle) return false;
      const handle = await anchor.requestPersistentHandle();
      this.storage.setItem(this.key, JSON.stringify({ handle, data }));
      return true;
    } catch {
      return false;
    }
  }

  /** Returns where it is now, or null if that is not known. @param {any} frame @param {any} space @returns {Float32Array | null} */
  matrix(frame, space) {
    if (!this.anchor) return this.fixed;
    return frame.getPose(this.anchor.anchorSpace, space)?.transform.matrix ?? this.fixed;
  }
}

/** Returns a matrix as WebXR's transform. It turns about the vertical axis only. @param {Float32Array} matrix */
function rigidTransform(matrix) {
  const half = Math.atan2(matrix[8], matrix[0]) / 2;
  const position = { x: matrix[12], y: matrix[13], z: matrix[14], w: 1 };
  const RigidTransform = /** @type {any} */ (globalThis).XRRigidTransform;
  return new RigidTransform(position, { x: 0, y: Math.sin(half), z: 0, w: Math.cos(half) });
}
