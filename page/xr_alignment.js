// The alignment of the map to the room: begun with a robot, kept by an anchor, and valid for one run and one map.
//
// It says where a robot's own map lies in the room. The merged map follows from that robot's place in it: so it lies right after a
// correction of the merging, and nowhere once that robot's map is no longer in the merged map.

import { alignMap, pointToXr, poseFromXr } from "./coordinates.js";
import { compose, invert } from "./geometry.js";
import { multiply, rotationAboutY, translation } from "./matrix.js";
import { KeptAnchor } from "./xr_anchors.js";

/** @typedef {import("./geometry.js").Pose} Pose */
/** @typedef {import("./state.js").Fleet} Fleet */
/** @typedef {[number, number, number]} Vector */
/** What is stored with the anchor: the run, a frame of the fleet, and the anchor's pose in it. @typedef {{run: string | null, frame: string, inFrame: Pose}} Aligned */

/** Where the map lies in the room, as the operator has shown. */
export class Alignment {
  /** @param {Fleet} fleet @param {KeptAnchor} [anchor] */
  constructor(fleet, anchor = new KeptAnchor("map")) {
    this.fleet = fleet;
    this.anchor = anchor;
    /** The steps of an alignment that is under way. @type {{frame: string, inFrame: Pose, inMap: Pose, name: string, place: Vector | null} | null} */
    this.steps = null;
  }

  /** Begins an alignment with a robot. @param {import("./state.js").Robot} robot @returns {boolean} whether its place is known */
  begin(robot) {
    const { pose } = robot;
    const frame = this.fleet.mapFrameOf(robot);
    const link = frame && this.fleet.find(frame);
    if (!pose || !frame || !link) return false;
    this.steps = { frame, inFrame: compose(invert(link), pose), inMap: { ...pose }, name: robot.name, place: null };
    return true;
  }

  /** Gives up an alignment that is under way. */
  cancel() { this.steps = null; }

  /**
   * Takes the next point of the alignment. @param {Vector} point on the floor @param {any} frame of the session @param {any} space
   * @returns {Promise<boolean> | null} whether it will be there in the next session; null while another point is needed
   */
  take(point, frame, space) {
    const { steps } = this;
    if (!steps) return null;
    if (!steps.place) {
      steps.place = point;
      return null;
    }
    const map = alignMap(steps.inMap, steps.place, point);
    if (!map) return null;
    this.steps = null;
    // The anchor stands where the robot was pointed at: there it is exact.
    const { x, y, yaw } = compose(map, steps.inMap);
    const [ax, , az] = pointToXr([x, y, 0]);
    return this.put(frame, space, multiply(translation(ax, 0, az), rotationAboutY(yaw)), steps.frame, steps.inFrame);
  }

  /**
   * Takes where a frame of the fleet lies. @param {any} frame of the session @param {any} space @param {Float32Array} matrix of the anchor
   * @param {string} of the fleet's frame @param {Pose} inFrame the anchor's pose in it @returns {Promise<boolean>} whether it will be there in the next session
   */
  put(frame, space, matrix, of, inFrame) {
    return this.anchor.put(frame, space, matrix, /** @type {Aligned} */ ({ run: this.fleet.run, frame: of, inFrame }));
  }

  /** Returns the pose of `map` on the floor, or null if the map must be aligned. @param {any} frame of the session @param {any} space @returns {Pose | null} */
  pose(frame, space) {
    const aligned = /** @type {Aligned | null} */ (this.anchor.data);
    if (!aligned?.inFrame || aligned.run !== this.fleet.run) return null;
    const [link, matrix] = [this.fleet.find(aligned.frame), this.anchor.matrix(frame, space)];
    return link && matrix && compose(poseFromXr(matrix), invert(compose(link, aligned.inFrame)));
  }
}
