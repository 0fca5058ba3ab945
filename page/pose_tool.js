// Tools that draw a pose on the map: where a robot is to go, and where it is.

import { writePoseWithCovariance } from "./messages.js";

/** @typedef {import("./geometry.js").Point} Point */
/** @typedef {import("./geometry.js").Pose} Pose */
/** @typedef {import("./state.js").Robot} Robot */

/** Drag from which a pose has the heading of the drag, pixels. */
const HEADING_PX = 14;
/** Standard deviations of a pose that a person draws: metres and radians, as RViz has them. */
const DRAWN_SIGMA = { m: 0.5, rad: 0.26 };

/**
 * What a tool needs of the page. @typedef {object} Surroundings
 * @property {string} frame the frame of the map that is shown
 * @property {(topic: string, type: string, payload: Uint8Array, isLateWorthy?: boolean) => boolean} publish
 * @property {() => Robot | null} robot the selected robot
 * @property {(text: string, isError?: boolean) => void} log
 * @property {(isOn: boolean) => void} show
 */

/** Returns the heading of a pose that is drawn from one point of the map to another; without a drag that of a click. @param {Point} from @param {Point} to @param {number} pixels @param {number} ofClick */
export function drawnHeading(from, to, pixels, ofClick) {
  return pixels >= HEADING_PX ? Math.atan2(to.y - from.y, to.x - from.x) : ofClick;
}

/** A tool that draws a pose with the pointer. */
export class PoseTool {
  /** @param {Surroundings} of */
  constructor(of) {
    this.of = of;
    this.isOn = false;
    /** What is asked of an operator who has selected no robot. */
    this.wish = "";
    /** The pose that is being drawn. @type {{from: Point, to: Point, pixels: number} | null} */
    this.drawn = null;
  }

  /** Switches the tool on or off. */
  toggle() {
    this.isOn = !this.isOn;
    this.drawn = null;
    this.of.show(this.isOn);
    if (this.isOn && !this.of.robot()) this.of.log(this.wish);
  }

  /** Begins a pose at a point of the map; returns false if the tool is off. */
  press(/** @type {Point} */ at) {
    if (!this.isOn) return false;
    this.drawn = { from: at, to: at, pixels: 0 };
    return true;
  }

  move(/** @type {Point} */ to, /** @type {number} */ pixels) {
    if (this.drawn) this.drawn = { ...this.drawn, to, pixels };
  }

  /** Returns the pose that is being drawn, or null. @returns {Pose | null} */
  pose() {
    const robot = this.of.robot();
    if (!this.drawn || !robot) return null;
    const { from, to, pixels } = this.drawn;
    return { ...from, yaw: drawnHeading(from, to, pixels, this.clickHeading(from, robot)) };
  }

  /** Sends the pose that was drawn, and switches the tool off. */
  release() {
    const pose = this.pose();
    const robot = this.of.robot();
    if (this.drawn) this.toggle();
    if (pose && robot) this.send(robot, pose);
  }

  /** Forgets the pose that is being drawn. */
  cancelDrawing() { this.drawn = null; }

  /** Returns the heading of a pose that was clicked and not dragged. @param {Point} _at @param {Robot} _robot */
  clickHeading(_at, _robot) { return 0; }

  /** Sends a pose to a robot. @param {Robot} _robot @param {Pose} _pose */
  send(_robot, _pose) {}
}

/** The tool that tells a robot where it is: one that is lost, or was carried away. */
export class SetPoseTool extends PoseTool {
  wish = "select a robot, then show where it is";

  /** Without a drag it keeps its heading. @param {Point} _at @param {Robot} robot */
  clickHeading(_at, robot) { return robot.pose?.yaw ?? 0; }

  /** @param {Robot} robot @param {Pose} pose */
  send(robot, pose) {
    const message = writePoseWithCovariance(this.of.frame, pose, DRAWN_SIGMA);
    const isSent = this.of.publish(`${robot.prefix}initialpose`, "geometry_msgs/msg/PoseWithCovarianceStamped", message);
    if (isSent) this.of.log(`${robot.name} was told that it is at ${pose.x.toFixed(1)} m, ${pose.y.toFixed(1)} m`);
  }
}
