// The ROS messages that the page reads and writes.

import { CdrReader, CdrWriter } from "./cdr.js";
import { yawOf } from "./geometry.js";

/** @typedef {import("./geometry.js").Pose} Pose */

/** Reads tf2_msgs/TFMessage: each transform as the pose of the child in the parent. */
export function readTransforms(/** @type {DataView} */ view) {
  const from = new CdrReader(view);
  const count = from.length(1);
  const transforms = [];
  for (let i = 0; i < count; i += 1) {
    const { stamp, frame: parent } = from.header();
    const child = from.string();
    const { x, y } = from.vector();
    transforms.push({ stamp, parent, child, pose: { x, y, yaw: yawOf(from.quaternion()) } });
  }
  return transforms;
}

/** Reads sensor_msgs/LaserScan. */
export function readScan(/** @type {DataView} */ view) {
  const from = new CdrReader(view);
  const { stamp, frame } = from.header();
  const angleMin = from.f32();
  from.f32();
  const angleStep = from.f32();
  from.f32();
  from.f32();
  const rangeMin = from.f32();
  const rangeMax = from.f32();
  return { stamp, frame, angleMin, angleStep, rangeMin, rangeMax, ranges: from.f32s() };
}

/** Reads nav_msgs/MapMetaData. */
function readMapInfo(/** @type {CdrReader} */ from) {
  from.time();
  const resolution = from.f32();
  const width = from.u32();
  const height = from.u32();
  const { x, y } = from.vector();
  return { resolution, width, height, origin: { x, y, yaw: yawOf(from.quaternion()) } };
}

/** Reads the cells of a rectangle: 0 to 100 percent, and 255 where nothing is known. */
function readCells(/** @type {CdrReader} */ from, /** @type {number} */ count) {
  const cells = from.bytes(from.length(1));
  if (cells.length !== count) throw new RangeError("a map's size is not that of its cells");
  return cells;
}

/** Reads nav_msgs/OccupancyGrid. */
export function readGrid(/** @type {DataView} */ view) {
  const from = new CdrReader(view);
  const { stamp, frame } = from.header();
  const info = readMapInfo(from);
  return { stamp, frame, ...info, cells: readCells(from, info.width * info.height) };
}

/** Bytes of a tile without its cells. */
const TILE_BYTES_MIN = 20;

/** Reads mr_slam_msgs/MapTiles: the tiles of a map that changed, the map's size, and the numbers of this update and the one before. */
export function readMapTiles(/** @type {DataView} */ view) {
  const from = new CdrReader(view);
  const { stamp, frame } = from.header();
  const [number, base] = [from.u32(), from.u32()];
  const info = readMapInfo(from);
  const count = from.length(TILE_BYTES_MIN);
  const tiles = [];
  for (let i = 0; i < count; i += 1) {
    const [x, y, width, height] = [from.u32(), from.u32(), from.u32(), from.u32()];
    tiles.push({ x, y, width, height, cells: readCells(from, width * height) });
  }
  return { stamp, frame, number, base, ...info, tiles };
}

/** Reads the head of nav_msgs/Odometry: of which frame it is. */
export function readOdometryFrames(/** @type {DataView} */ view) {
  const from = new CdrReader(view);
  const { stamp, frame } = from.header();
  return { stamp, frame, child: from.string() };
}

/** Reads geometry_msgs/PoseWithCovarianceStamped: pose, and standard deviations of x, y (m) and heading (rad). */
export function readPose(/** @type {DataView} */ view) {
  const from = new CdrReader(view);
  const { stamp, frame } = from.header();
  const { x, y } = from.vector();
  const yaw = yawOf(from.quaternion());
  /** @type {number[]} */
  const covariance = [];
  for (let i = 0; i < 36; i += 1) covariance.push(from.f64());
  const deviation = (/** @type {number} */ i) => Math.sqrt(Math.max(0, covariance[i]));
  return { stamp, frame, pose: { x, y, yaw }, deviation: { x: deviation(0), y: deviation(7), yaw: deviation(35) } };
}

/** Reads nav_msgs/Path: its frame and the poses in it. */
export function readPath(/** @type {DataView} */ view) {
  const from = new CdrReader(view);
  const { stamp, frame } = from.header();
  const count = from.length(1);
  /** @type {Pose[]} */
  const poses = [];
  for (let i = 0; i < count; i += 1) {
    from.header();
    const { x, y } = from.vector();
    poses.push({ x, y, yaw: yawOf(from.quaternion()) });
  }
  return { stamp, frame, poses };
}

/** Reads std_msgs/String. */
export function readString(/** @type {DataView} */ view) { return new CdrReader(view).string(); }

/** Reads std_msgs/Bool. */
export function readBool(/** @type {DataView} */ view) { return new CdrReader(view).bool(); }

/** Writes geometry_msgs/Twist of a robot on the floor. */
export function writeTwist(/** @type {number} */ linear, /** @type {number} */ angular) {
  const to = new CdrWriter();
  [linear, 0, 0, 0, 0, angular].forEach((value) => to.f64(value));
  return to.done();
}

/** Writes geometry_msgs/PoseStamped of a place on the floor, without a time. */
export function writePoseStamped(/** @type {string} */ frame, /** @type {Pose} */ pose) {
  const to = new CdrWriter().i32(0).i32(0).string(frame);
  const { x, y, yaw } = pose;
  [x, y, 0, 0, 0, Math.sin(yaw / 2), Math.cos(yaw / 2)].forEach((value) => to.f64(value));
  return to.done();
}

/**
 * Writes geometry_msgs/PoseWithCovarianceStamped of a place on the floor, without a time.
 * @param {string} frame @param {Pose} pose @param {{m: number, rad: number}} sigma standard deviations
 */
export function writePoseWithCovariance(frame, { x, y, yaw }, sigma) {
  const to = new CdrWriter().i32(0).i32(0).string(frame);
  [x, y, 0, 0, 0, Math.sin(yaw / 2), Math.cos(yaw / 2)].forEach((value) => to.f64(value));
  for (let i = 0; i < 36; i += 1) to.f64(i === 0 || i === 7 ? sigma.m ** 2 : i === 35 ? sigma.rad ** 2 : 0);
  return to.done();
}

export function writeBool(/** @type {boolean} */ value) { return new CdrWriter().bool(value).done(); }
export function writeInt(/** @type {number} */ value) { return new CdrWriter().i32(value).done(); }
/** Writes std_msgs/Empty, which has one byte in ROS 2. */
export function writeEmpty() { return new CdrWriter().bool(false).done(); }
