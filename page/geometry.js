// Poses in the plane, the tree of frames, and the view from above. Metres and radians; x to the right, y up.

/** @typedef {{x: number, y: number, yaw: number}} Pose */
/** @typedef {{x: number, y: number}} Point */

/** Returns the heading of a rotation about the vertical axis. */
export function yawOf(/** @type {{x: number, y: number, z: number, w: number}} */ q) {
  return Math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z));
}

/** Returns the pose in a frame A of what has pose `b` in a frame B, where `a` is the pose of B in A. */
export function compose(/** @type {Pose} */ a, /** @type {Pose} */ b) {
  const point = transform(a, b);
  return { x: point.x, y: point.y, yaw: wrap(a.yaw + b.yaw) };
}

/** Returns the pose of A in B, where `a` is the pose of B in A. */
export function invert(/** @type {Pose} */ a) {
  const [c, s] = [Math.cos(a.yaw), Math.sin(a.yaw)];
  return { x: -c * a.x - s * a.y, y: s * a.x - c * a.y, yaw: wrap(-a.yaw) };
}

/** Returns a point of B in A, where `a` is the pose of B in A. */
export function transform(/** @type {Pose} */ a, /** @type {Point} */ point) {
  const [c, s] = [Math.cos(a.yaw), Math.sin(a.yaw)];
  return { x: a.x + c * point.x - s * point.y, y: a.y + s * point.x + c * point.y };
}

/** Returns an angle between -pi and pi. */
export function wrap(/** @type {number} */ angle) {
  return Math.atan2(Math.sin(angle), Math.cos(angle));
}

/** Frames that may be known at a time; more are ignored. */
const FRAMES_MAX = 4096;
/** A link that is older than the newest one by more is not valid any more, seconds: the bridge repeats links of maps once a second. */
const LINK_OLD_S = 5;
/** Frames between a frame and its root; a longer way is a cycle. */
const DEPTH_MAX = 64;

/** The newest transforms between frames. */
export class FrameTree {
  constructor() {
    /** Fixed links have an infinite stamp. @type {Map<string, {parent: string, pose: Pose, stamp: number}>} */
    this.frames = new Map();
  }

  set(/** @type {string} */ parent, /** @type {string} */ child, /** @type {Pose} */ pose, stamp = 0) {
    if (this.frames.size < FRAMES_MAX || this.frames.has(child)) this.frames.set(child, { parent, pose, stamp });
  }

  /**
   * Returns the pose of a frame in one of its ancestors, or null if that is not known, or not any more.
   * @param {string} ancestor @param {string} frame @param {number} [at] the time of the fleet: a link that is much older is refused
   */
  find(ancestor, frame, at = -Infinity) {
    let pose = { x: 0, y: 0, yaw: 0 };
    for (let depth = 0; depth < DEPTH_MAX; depth += 1) {
      if (frame === ancestor) return pose;
      const known = this.frames.get(frame);
      if (!known || known.stamp < at - LINK_OLD_S) return null;
      pose = compose(known.pose, pose);
      frame = known.parent;
    }
    return null;
  }
}

/** The view from above: which part of the plane is on the screen. */
export class Camera {
  constructor() {
    /** Point in the middle of the screen, metres. */
    this.center = { x: 0, y: 0 };
    /** Pixels of a metre. */
    this.scale = 40;
    /** Size of the screen, pixels. */
    this.width = 1;
    this.height = 1;
  }

  toScreen(/** @type {Point} */ point) {
    return {
      x: this.width / 2 + (point.x - this.center.x) * this.scale,
      y: this.height / 2 - (point.y - this.center.y) * this.scale,
    };
  }

  toWorld(/** @type {Point} */ pixel) {
    return {
      x: this.center.x + (pixel.x - this.width / 2) / this.scale,
      y: this.center.y - (pixel.y - this.height / 2) / this.scale,
    };
  }

  pan(/** @type {number} */ dx, /** @type {number} */ dy) {
    this.center = { x: this.center.x - dx / this.scale, y: this.center.y + dy / this.scale };
  }

  /** Changes the scale so that the point below the pixel stays there. */
  zoom(/** @type {number} */ factor, /** @type {Point} */ pixel) {
    const before = this.toWorld(pixel);
    this.scale = Math.min(2000, Math.max(1, this.scale * factor));
    const after = this.toWorld(pixel);
    this.center = { x: this.center.x + before.x - after.x, y: this.center.y + before.y - after.y };
  }

  /**
   * Shows a rectangle whole, with some space around it, between what covers the top and the bottom of the screen.
   * @param {{minX: number, minY: number, maxX: number, maxY: number}} box metres
   * @param {{top: number, bottom: number}} covered pixels
   */
  fit(box, covered = { top: 0, bottom: 0 }) {
    const [width, height] = [Math.max(1, box.maxX - box.minX), Math.max(1, box.maxY - box.minY)];
    const free = Math.max(100, this.height - covered.top - covered.bottom);
    this.scale = Math.min(200, 0.92 * Math.min(this.width / width, free / height));
    const shift = (covered.bottom - covered.top) / (2 * this.scale);
    this.center = { x: (box.minX + box.maxX) / 2, y: (box.minY + box.maxY) / 2 - shift };
  }
}
