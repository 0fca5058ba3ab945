// What the page knows of the fleet: robots, their frames, scans and figures, the merged map. No drawing, no clock.

import { attentionOf } from "./attention.js";
import { RunClock } from "./clock.js";
import { FrameTree, compose, invert, transform, wrap } from "./geometry.js";
import { readEdges } from "./edges.js";
import { readExploration } from "./exploration.js";
import { readZones } from "./zones.js";
import { hasGoal, receiveNavigation } from "./goals.js";
import { MergedMap } from "./merged_map.js";
import { readBool, readGrid, readMapTiles, readOdometryFrames, readPose, readScan, readTransforms } from "./messages.js";

/** @typedef {import("./geometry.js").Pose} Pose */
/** @typedef {import("./geometry.js").Point} Point */

/** The frame of the merged map. */
export const MAP = "map";
/** Colours that differ for colour-blind eyes too (Okabe and Ito), for dark and light backgrounds. */
export const COLOURS = ["#e69f00", "#3a9ad9", "#00a877", "#cc79a7", "#d55e00", "#8a7fe0", "#b5a800", "#7fb3c8"];
/** Shapes: number of corners; 0 is a disc. */
export const SHAPES = [0, 3, 4, 5, 6];
/** Data older than this is stale, seconds: a scan comes ten times a second. */
export const STALE_S = 1;
/** Points of a trail; the oldest are dropped. */
const TRAIL_MAX = 4000;
/** Distance between the points of a trail, metres. */
const TRAIL_STEP_M = 0.04;
/** Points of the plot of the mapped area, one a second. */
const AREA_MAX = 3600;
/** A run's time that is behind by more than this is another run's, seconds. */
const BACKWARD_S = 2;

/** A correction of SLAM or merging that moves a robot by more than this in one step is a jump: metres, radians. Others are centimetres. */
const JUMP = { m: 0.3, rad: 0.26 };
/** Turn below which a robot stands, radians. */
const REST_RAD = 0.05;
/** Scans whose way to the screen is kept. */
const DRAWN_MAX = 20;

/** One robot. */
export class Robot {
  /** @param {number} number from 1 @param {string} prefix beginning of its topics' names, such as `/robot1/` */
  constructor(number, prefix) {
    this.number = number;
    this.prefix = prefix;
    this.name = prefix.replace(/^\/+|\/+$/g, "") || "robot";
    this.colour = COLOURS[(number - 1) % COLOURS.length];
    this.corners = SHAPES[(number - 1) % SHAPES.length];
    /** @type {any} the newest figures of the bridge */
    this.figures = {};
    /** @type {ReturnType<typeof readScan> | null} */
    this.scan = null;
    /** Where the scanner was in the map when the scan came. @type {Pose | null} */
    this.scanPose = null;
    /** When the scan was taken, seconds of the page. @type {number | null} */
    this.scanAt = null;
    /** Pose in the map. @type {Pose | null} */
    this.pose = null;
    /** When the robot was there, seconds of the page. @type {number | null} */
    this.poseAt = null;
    this.baseFrame = "";
    /** Pose of the odometry's frame in the map: what SLAM and merging correct. @type {Pose | null} */
    this.odometryInMap = null;
    /** The newest jump of its pose, and how many there were. @type {{m: number, rad: number, at: number, count: number} | null} */
    this.jump = null;
    /** Where the robot came to rest, and when, seconds of the page. @type {{pose: Pose, at: number} | null} */
    this.rest = null;
    /** The newest scan that was drawn, and how long the newest ones took from the scanner to the screen, ms. @type {{at: number | null, tookMs: number[]}} */
    this.drawn = { at: null, tookMs: [] };
    /** @type {{x: number, y: number, yaw: number} | null} */
    this.deviation = null;
    /** @type {Point[]} */
    this.trail = [];
    /** The planned path. @type {ReturnType<typeof import("./messages.js").readPath> | null} */
    this.plan = null;
    /** @type {import("./goals.js").Navigation | null} */
    this.navigation = null;
    /** The goal that was sent from this page, the number of the goal before it, and when, seconds. @type {{pose: Pose, after: number, isAccepted: boolean, at: number} | null} */
    this.sentGoal = null;
  }

  /** Returns the age of the newest scan, seconds, or null if there is none. */
  scanAge(/** @type {number} */ now) { return this.scanAt === null ? null : now - this.scanAt; }
  poseAge(/** @type {number} */ now) { return this.poseAt === null ? null : now - this.poseAt; }

  /** Returns the median time from the scanner to the screen, ms, or null if no scan was drawn. */
  toScreenMs() {
    const sorted = [...this.drawn.tookMs].sort((a, b) => a - b);
    return sorted[Math.floor(sorted.length / 2)] ?? null;
  }

  /** Returns for how long the robot has stood without a goal and a driver, seconds. */
  idleS(/** @type {number} */ now) {
    return this.rest && !hasGoal(this) && !this.figures.driver ? now - this.rest.at : 0;
  }

  isStale(/** @type {number} */ now) { return (this.poseAge(now) ?? Infinity) > STALE_S; }
}

/** The fleet. Times are seconds of the page's own clock. */
export class Fleet {
  constructor() {
    /** @type {Map<number, Robot>} */
    this.robots = new Map();
    this.frames = new FrameTree();
    /** The newest stamp of the robots and their maps, seconds of the run: what is much older is not valid any more. */
    this.framesAt = -Infinity;
    /** The maps in the merged map, as they were said last. @type {Map<string, Pose>} */
    this.mapLinks = new Map();
    /** Counts how often the frame of the merged map became another one: what was drawn in it lies elsewhere then. */
    this.mapFrames = 1;
    this.clock = new RunClock();
    this.merged = new MergedMap();
    /** Which robot saw what of the map. @type {import("./seen.js").Layer | null} */
    this.seen = null;
    /** Counts the runs: another one begins when the fleet starts again in another room. */
    this.runs = 1;
    /** Identity of the run, as the bridge says it; null before it has. @type {string | null} */
    this.run = null;
    /** The run's time when the bridge was asked last, seconds. */
    this.runTime = 0;
    /** How the robots' maps lie to each other. @type {import("./edges.js").Edge[]} */
    this.edges = [];
    /** Names of the robots whose given start the maps contradict. @type {string[]} */
    this.contradictedStarts = [];
    /** Whether merging cannot save the edges, and what the operator said of them. */
    this.areEdgesUnsaved = false;
    /** What exploration does, or null if nobody has said. @type {import("./exploration.js").Exploration | null} */
    this.exploration = null;
    /** The areas that navigation keeps robots out of. @type {import("./zones.js").Zone[]} */
    this.zones = [];
    /** Why the newest change of the zones was refused. @type {string | null} */
    this.zoneRefusal = null;
    /** @type {boolean | null} */
    this.isStopped = null;
    /** @type {any} */
    this.figures = {};
    /** Known area of the merged map over time. @type {{at: number, m2: number}[]} */
    this.area = [];
  }

  /** The merged map, or null if there is none yet. */
  get map() { return this.merged.grid; }

  /**
   * Takes the run's time from an answer of the bridge. Returns whether another run has begun: its time is behind.
   * @param {number} askedAt @param {number} answeredAt seconds of the page @param {number} runTime seconds
   */
  setRunTime(askedAt, answeredAt, runTime) {
    // A bridge that has just begun does not know the time yet.
    if (runTime <= 0) return false;
    const isAnother = runTime < this.runTime - BACKWARD_S;
    if (isAnother) this.restart();
    this.runTime = runTime;
    this.clock.add(askedAt, answeredAt, runTime);
    return isAnother;
  }

  /**
   * Takes the run's identity from the bridge. Returns the robots of the run that has ended, if this is another one; null otherwise.
   * @param {string} run @returns {Robot[] | null}
   */
  setRun(run) {
    const isAnother = this.run !== null && run !== this.run;
    this.run = run;
    if (!isAnother) return null;
    this.restart();
    const gone = [...this.robots.values()];
    this.robots.clear();
    Object.assign(this, { figures: {}, isStopped: null, zoneRefusal: null });
    return gone;
  }

  /** Forgets what belongs to the run that has ended. */
  restart() {
    this.runs += 1;
    this.runTime = 0;
    this.clock.reset();
    this.framesAt = -Infinity;
    this.mapLinks = new Map();
    this.frames = new FrameTree();
    this.merged.clear();
    Object.assign(this, { seen: null, edges: [], contradictedStarts: [], areEdgesUnsaved: false, exploration: null, zones: [], area: [] });
    for (const robot of this.robots.values()) {
      const { number, prefix, figures } = robot;
      Object.assign(robot, new Robot(number, prefix), { figures });
    }
  }

  /** Takes the state of the fleet as the bridge tells it; returns the robots that are new, and those that the fleet no longer has. */
  setFigures(/** @type {any} */ figures, /** @type {number} */ now) {
    this.figures = figures;
    /** @type {Map<number, string>} */
    const prefixes = new Map(figures.robots.map((/** @type {any} */ { number, prefix }) => [number, prefix]));
    // One of another name is another robot.
    const gone = [...this.robots.values()].filter(({ number, prefix }) => prefixes.get(number) !== prefix);
    gone.forEach(({ number }) => this.robots.delete(number));
    const added = [];
    for (const row of figures.robots) {
      let robot = this.robots.get(row.number);
      if (!robot) {
        robot = new Robot(row.number, row.prefix);
        this.robots.set(row.number, robot);
        added.push(robot);
      }
      robot.figures = row;
    }
    const last = this.area.at(-1);
    if (typeof figures.merged_known_m2 === "number" && (!last || now - last.at >= 1)) {
      this.area.push({ at: now, m2: figures.merged_known_m2 });
      if (this.area.length > AREA_MAX) this.area.shift();
    }
    return { added, gone };
  }

  /** Takes a message. Throws a RangeError if it is not one of its type. */
  receive(/** @type {string} */ topic, /** @type {DataView} */ view, /** @type {number} */ now) {
    if (topic === "/tf" || topic === "/tf_static") return this.receiveTransforms(view, now, topic === "/tf_static");
    if (topic === "/emergency_stop") {
      this.isStopped = readBool(view);
      return undefined;
    }
    if (topic === "/merged_map") {
      const grid = readGrid(view);
      this.merged.setWhole(grid, this.clock.toPage(grid.stamp, now));
      return undefined;
    }
    if (topic === "/merged_map_tiles") {
      const update = readMapTiles(view);
      this.merged.applyTiles(update, this.clock.toPage(update.stamp, now));
      return undefined;
    }
    if (topic === "/merge_edges") {
      ({ edges: this.edges, starts: this.contradictedStarts, unsaved: this.areEdgesUnsaved } = readEdges(view));
      return undefined;
    }
    if (topic === "/exclusion_zones") {
      const { zones, refusal } = readZones(view);
      Object.assign(this, { zones, zoneRefusal: refusal });
      return undefined;
    }
    if (topic === "/explore/state") {
      this.exploration = readExploration(view);
      return undefined;
    }
    const named = this.robotOfTopic(topic);
    if (named) this.receiveOfRobot(named.robot, named.rest, view, now);
    return undefined;
  }

  /** Returns the robot that a topic belongs to, and the rest of its name. Of names that begin alike it is the longest. @param {string} topic */
  robotOfTopic(topic) {
    const robots = [...this.robots.values()].filter(({ prefix }) => topic.startsWith(prefix));
    if (robots.length === 0) return null;
    const robot = robots.reduce((a, b) => (b.prefix.length > a.prefix.length ? b : a));
    return { robot, rest: topic.slice(robot.prefix.length) };
  }

  /** @param {DataView} view @param {number} now @param {boolean} isStatic */
  receiveTransforms(view, now, isStatic) {
    /** Newest stamps of the frames. @type {Map<string, number>} */
    const changed = new Map();
    const mapLinks = new Map();
    const [parents, bases, robotMaps] = [new Set(), new Set(), new Set()];
    for (const robot of this.robots.values()) {
      bases.add(robot.baseFrame);
      robotMaps.add(this.mapFrameOf(robot));
    }
    for (const { parent, child, pose, stamp } of readTransforms(view)) {
      parents.add(parent);
      const before = this.frames.frames.get(child);
      this.frames.set(parent, child, pose, isStatic ? Infinity : stamp);
      changed.set(child, stamp);
      // Others may publish frames with times of another clock.
      if (!isStatic && bases.has(child)) this.framesAt = Math.max(this.framesAt, stamp);
      if (parent === MAP && !isStatic && robotMaps.has(child)) mapLinks.set(child, pose);
      if (parent === MAP && before?.parent === MAP) this.moveTrails(child, compose(pose, invert(before.pose)));
    }
    // With what lies below one of the maps it is the pose of one robot, and not the set of all maps.
    if (![...mapLinks.keys()].some((map) => parents.has(map))) this.followMapFrame(mapLinks);
    for (const robot of this.robots.values()) {
      // A robot is where its odometry says: only that shows that the pose is new.
      const stamp = changed.get(robot.baseFrame);
      if (stamp !== undefined) this.updatePose(robot, this.clock.toPage(stamp, now));
    }
  }

  /**
   * Takes all robots' maps in the merged map. Its frame is another one if none of them was in it before, or if all of those have jumped.
   * @param {Map<string, Pose>} maps
   */
  followMapFrame(maps) {
    if (maps.size === 0) return;
    const stays = (/** @type {[string, Pose]} */ [frame, pose]) => {
      const before = this.mapLinks.get(frame);
      return before !== undefined && !isJump(compose(pose, invert(before)));
    };
    if (this.mapLinks.size > 0 && ![...maps].some(stays)) this.mapFrames += 1;
    this.mapLinks = maps;
  }

  /** Returns whether a robot's own map is in the merged map now: only then its trail lies where it drove. @param {Robot} robot */
  isPlaced(robot) {
    const frame = this.mapFrameOf(robot);
    return frame !== null && this.find(frame) !== null;
  }

  /** Moves the trails of the robots in a map that is laid elsewhere in the merged map. @param {string} frame of the map @param {Pose} by */
  moveTrails(frame, by) {
    if (Math.hypot(by.x, by.y) < TRAIL_STEP_M && Math.abs(by.yaw) < REST_RAD) return;
    for (const robot of this.robots.values()) {
      if (this.mapFrameOf(robot) === frame) robot.trail = robot.trail.map((point) => transform(by, point));
    }
  }

  /** Returns the frame of a robot's own map, or `map` if it has none; null if it is not known. @param {Robot} robot @returns {string | null} */
  mapFrameOf(robot) {
    const odometry = this.frames.frames.get(robot.baseFrame)?.parent;
    return odometry === undefined ? null : this.frames.frames.get(odometry)?.parent ?? null;
  }

  updatePose(/** @type {Robot} */ robot, /** @type {number} */ at) {
    const odometry = this.frames.frames.get(robot.baseFrame);
    const odometryInMap = odometry ? this.find(odometry.parent) : null;
    if (!odometry || !odometryInMap) return;
    const pose = compose(odometryInMap, odometry.pose);
    if (robot.odometryInMap) {
      // Where the robot would be without the newest correction.
      const before = compose(robot.odometryInMap, odometry.pose);
      const [m, rad] = [Math.hypot(pose.x - before.x, pose.y - before.y), Math.abs(wrap(pose.yaw - before.yaw))];
      if (m > JUMP.m || rad > JUMP.rad) robot.jump = { m, rad, at, count: (robot.jump?.count ?? 0) + 1 };
    }
    Object.assign(robot, { odometryInMap, pose, poseAt: at });
    const { rest } = robot;
    const hasMoved = !rest || Math.hypot(pose.x - rest.pose.x, pose.y - rest.pose.y) > TRAIL_STEP_M || Math.abs(wrap(pose.yaw - rest.pose.yaw)) > REST_RAD;
    if (hasMoved) robot.rest = { pose, at };
    const last = robot.trail.at(-1);
    if (!last || Math.hypot(pose.x - last.x, pose.y - last.y) >= TRAIL_STEP_M) {
      robot.trail.push({ x: pose.x, y: pose.y });
      if (robot.trail.length > TRAIL_MAX) robot.trail.shift();
    }
  }

  /** Records that everything known was drawn: how long the newest scans took from the scanner to the screen. */
  recordDrawn(/** @type {number} */ now) {
    for (const { drawn, scanAt } of this.robots.values()) {
      if (scanAt === null || scanAt === drawn.at) continue;
      drawn.at = scanAt;
      drawn.tookMs.push((now - scanAt) * 1000);
      if (drawn.tookMs.length > DRAWN_MAX) drawn.tookMs.shift();
    }
  }

  /** @param {Robot} robot @param {string} topic @param {DataView} view @param {number} now */
  receiveOfRobot(robot, topic, view, now) {
    if (topic === "scan") {
      robot.scan = readScan(view);
      robot.scanPose = this.find(robot.scan.frame);
      robot.scanAt = this.clock.toPage(robot.scan.stamp, now);
    } else if (topic === "odom") {
      if (robot.baseFrame === "") robot.baseFrame = readOdometryFrames(view).child;
    } else if (topic === "pose") {
      robot.deviation = readPose(view).deviation;
    } else {
      receiveNavigation(robot, topic, view);
    }
  }

  /** Returns the pose of a frame in the map, or null if it is not known, or not any more. @param {string} frame */
  find(frame) { return this.frames.find(MAP, frame, this.framesAt); }

  /** Returns what takes poses of a frame to the map, or null if the frame's place is not known. */
  placeIn(/** @type {string} */ frame) {
    const place = this.find(frame);
    return place ? (/** @type {Pose} */ pose) => compose(place, pose) : null;
  }

  /** Returns a rectangle around the map and the robots, or null if nothing is known. */
  box() {
    const points = [...this.robots.values()].flatMap((robot) => (robot.pose ? [robot.pose] : []));
    const map = this.map;
    if (map && map.width > 0) {
      const [width, height] = [map.width * map.resolution, map.height * map.resolution];
      points.push(map.origin, { ...map.origin, x: map.origin.x + width, y: map.origin.y + height });
    }
    if (points.length === 0) return null;
    const [xs, ys] = [points.map((p) => p.x), points.map((p) => p.y)];
    return { minX: Math.min(...xs), maxX: Math.max(...xs), minY: Math.min(...ys), maxY: Math.max(...ys) };
  }

  /** Returns what needs the operator's attention, the most urgent first. @param {number} now @param {boolean} isConnected */
  attention(now, isConnected) { return attentionOf(this, now, isConnected); }
}

/** Returns whether a correction is more than the usual ones. @param {Pose} by */
function isJump(by) { return Math.hypot(by.x, by.y) > JUMP.m || Math.abs(wrap(by.yaw)) > JUMP.rad; }
