// The views of mixed reality beside life-size: the whole map on a table, and the view from a robot.

import { transform } from "./geometry.js";

/** @typedef {import("./geometry.js").Pose} Pose */
/** @typedef {import("./xr_scene.js").Placement} Placement */

/** Size of the table-top map, and its height above the floor, metres. */
const TABLE_M = 0.9;
const TABLE_HEIGHT_M = 0.75;
const TABLE_AHEAD_M = 0.8;
/** Height of the eyes above the floor of the map in the view from a robot, metres: just above its LiDAR. */
const ROBOT_EYE_M = 0.25;
/** The map is enlarged so much at least and at most: somebody may sit, or the floor may be unknown. */
const ROBOT_SCALE = { least: 3, most: 10 };

/** Returns a pose of the map, drawn with a scale, at which a point of it is at a place of the room. @returns {Pose} */
function poseWith(/** @type {{x: number, y: number}} */ point, /** @type {{x: number, y: number}} */ place, /** @type {number} */ yaw, /** @type {number} */ scale) {
  const at = transform({ x: 0, y: 0, yaw }, { x: point.x * scale, y: point.y * scale });
  return { x: place.x - at.x, y: place.y - at.y, yaw };
}

/**
 * Returns the place of the whole map on a table before the viewer.
 * @param {{minX: number, maxX: number, minY: number, maxY: number}} box around the map @param {Pose} viewer @returns {Placement}
 */
export function tablePlacement(box, viewer) {
  const scale = Math.min(1, TABLE_M / Math.max(1, box.maxX - box.minX, box.maxY - box.minY));
  const middle = { x: (box.minX + box.maxX) / 2, y: (box.minY + box.maxY) / 2 };
  const place = transform(viewer, { x: TABLE_AHEAD_M, y: 0 });
  return { pose: poseWith(middle, place, viewer.yaw - Math.PI / 2, scale), scale, height: TABLE_HEIGHT_M };
}

/** The view from a robot: the map is enlarged and moves as the robot drives. It does not turn, because that makes people ill. */
export class RobotView {
  /** @param {number} robot its number @param {Pose} robotPose @param {Pose} viewer @param {number} eyeHeight metres */
  constructor(robot, robotPose, viewer, eyeHeight) {
    this.robot = robot;
    this.viewer = { ...viewer };
    this.scale = Math.min(ROBOT_SCALE.most, Math.max(ROBOT_SCALE.least, eyeHeight / ROBOT_EYE_M));
    /** Ahead of the robot is ahead of the viewer when the view begins. */
    this.yaw = viewer.yaw - robotPose.yaw;
  }

  /** Returns where the map is while the robot has this pose. @param {Pose} robotPose @returns {Placement} */
  placement(robotPose) {
    return { pose: poseWith(robotPose, this.viewer, this.yaw, this.scale), scale: this.scale, height: 0 };
  }
}
