// Coordinates of WebXR and of ROS. Both are right-handed, so that one is a proper rotation of the other.
//
// WebXR: x to the right, y up, z towards the viewer. ROS (REP-103): x ahead, y to the left, z up.
// "The floor's frame" is the headset's floor with ROS's axes: a pose there is x, y in metres and yaw in radians.

import { compose, invert } from "./geometry.js";
import { multiply, rotationAboutY, scaling, translation } from "./matrix.js";

/** @typedef {import("./geometry.js").Pose} Pose */
/** @typedef {[number, number, number]} Vector */
/** @typedef {{x: number, y: number, z: number, w: number}} Quaternion */

/** Rotation of ROS's axes into WebXR's, as a matrix in columns. */
export const XR_FROM_ROS = new Float32Array([0, 0, -1, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1]);

/** Returns a point of ROS in WebXR. @returns {Vector} */
export function pointToXr(/** @type {Vector} */ [x, y, z]) { return [-y, z, -x]; }

/** Returns a point of WebXR in ROS. @returns {Vector} */
export function pointFromXr(/** @type {Vector} */ [x, y, z]) { return [-z, -x, y]; }

/** Returns a rotation of ROS in WebXR. @returns {Quaternion} */
export function rotationToXr(/** @type {Quaternion} */ q) { return { x: -q.y, y: q.z, z: -q.x, w: q.w }; }

/** Returns a rotation of WebXR in ROS. @returns {Quaternion} */
export function rotationFromXr(/** @type {Quaternion} */ q) { return { x: -q.z, y: -q.x, z: q.y, w: q.w }; }

/**
 * Returns the matrix from coordinates of ROS in a frame to WebXR.
 * @param {Pose} pose the frame's, on the floor @param {number} [scale] of the frame @param {number} [height] of its origin, metres
 */
export function xrFromFrame(pose, scale = 1, height = 0) {
  const turned = multiply(translation(...pointToXr([pose.x, pose.y, height])), rotationAboutY(pose.yaw));
  return multiply(multiply(turned, scaling(scale)), XR_FROM_ROS);
}

/** Returns the pose on the floor of a frame that WebXR gives as a matrix; its height and tilt are left out. @returns {Pose} */
export function poseFromXr(/** @type {ArrayLike<number>} */ matrix) {
  const [x, y] = pointFromXr([matrix[12], matrix[13], matrix[14]]);
  // The frame's x axis of ROS is its negative z axis in WebXR.
  const [aheadX, aheadY] = pointFromXr([-matrix[8], -matrix[9], -matrix[10]]);
  return { x, y, yaw: Math.atan2(aheadY, aheadX) };
}

/**
 * Returns the pose of `map` on the floor, from a robot's pose in `map` and two points of the floor in WebXR.
 * @param {Pose} inMap the robot's pose @param {Vector} place where it stands @param {Vector} ahead a point straight ahead of it
 * @returns {Pose | null} null if the points are too close to each other to give a direction
 */
export function alignMap(inMap, place, ahead) {
  const [x, y] = pointFromXr(place);
  const [aheadX, aheadY] = pointFromXr(ahead);
  if (Math.hypot(aheadX - x, aheadY - y) < ALIGN_DISTANCE_MIN_M) return null;
  const onFloor = { x, y, yaw: Math.atan2(aheadY - y, aheadX - x) };
  return compose(onFloor, invert(inMap));
}

/** Least distance between the two points of an alignment, metres: a hand trembles by centimetres. */
export const ALIGN_DISTANCE_MIN_M = 0.2;

/**
 * Returns where a ray meets the floor, or null if it does not within the reach.
 * @param {Vector} origin @param {Vector} direction of length 1 @returns {Vector | null}
 */
export function floorHit(origin, direction, reach = FLOOR_REACH_M) {
  if (direction[1] >= -1e-6 || origin[1] <= 0) return null;
  const distance = -origin[1] / direction[1];
  if (distance > reach) return null;
  return [origin[0] + distance * direction[0], 0, origin[2] + distance * direction[2]];
}

/** Largest distance at which a ray selects on the floor, metres: beyond, a hand cannot aim. */
const FLOOR_REACH_M = 20;
