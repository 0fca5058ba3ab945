// What mixed reality shows of the fleet: the map on the floor, trails, scans, robots, and the selected one's ring.

import { transform } from "./geometry.js";
import { hasGoal, planInMap } from "./goals.js";
import { facing, multiply, rotationAboutY, scaling, translation } from "./matrix.js";
import { SCAN_HEIGHT_M, VERTEX_NUMBERS, burger, cursorRing, ray, ribbon, selectionRing } from "./models.js";
import { colourCells } from "./view.js";
import { Marks } from "./xr_marks.js";
import { XR_FROM_ROS } from "./coordinates.js";

/** @typedef {import("./matrix.js").Matrix} Matrix */
/** @typedef {import("./renderer.js").Renderer} Renderer */
/** @typedef {import("./renderer.js").Drawable} Drawable */
/** @typedef {import("./state.js").Fleet} Fleet */
/** @typedef {import("./state.js").Robot} Robot */
/** @typedef {import("./geometry.js").Pose} Pose */
/** @typedef {[number, number, number]} Vector */

/**
 * Where the map is in the room. @typedef {object} Placement
 * @property {Pose} pose of `map` on the floor @property {number} scale 1 is life-size @property {number} height above the floor, metres
 */

/** What points at something. @typedef {{origin: Vector, direction: Vector, end: Vector, isOnFloor: boolean}} Pointer */

/** Heights above the floor at which flat things are drawn, metres, so that they do not flicker. */
const MAP_HEIGHT_M = 0.004;
/** Height of the robots' colours above the floor, metres: over the map, under the trails. */
const SEEN_HEIGHT_M = MAP_HEIGHT_M + 0.001;
const TRAIL_HEIGHT_M = 0.008;
const RING_HEIGHT_M = 0.012;
/** Width of a trail, metres. */
const TRAIL_WIDTH_M = 0.022;
/** Width of a plan, metres. */
const PLAN_WIDTH_M = 0.05;
/** Size of a scan's point, metres. */
const POINT_M = 0.022;
/** Shortest time between two uploads of a trail, seconds. */
const TRAIL_PERIOD_S = 0.3;
/** Colours of free and occupied cells, multiplied by their opacity: red, green, blue, opacity, 0 to 255. */
const FREE_PIXEL = pixel(90, 170, 235, 0.2);
const OCCUPIED_PIXEL = pixel(255, 255, 255, 0.85);
/** The grey of what is stale. */
const STALE = [0.52, 0.57, 0.63];
/** Opacity of the part of the selected robot that real things hide. */
const HIDDEN_OPACITY = 0.28;

/** Returns a pixel in memory, little-endian. @param {number} red @param {number} green @param {number} blue @param {number} opacity */
function pixel(red, green, blue, opacity) {
  const [r, g, b, a] = [red * opacity, green * opacity, blue * opacity, 255 * opacity].map(Math.round);
  return ((a << 24) | (b << 16) | (g << 8) | r) >>> 0;
}

/** Returns red, green and blue of `#rrggbb`, 0 to 1. @returns {Vector} */
export function channels(/** @type {string} */ colour) {
  const value = Number.parseInt(colour.slice(1), 16);
  return [((value >> 16) & 255) / 255, ((value >> 8) & 255) / 255, (value & 255) / 255];
}

/** Returns the matrix of a robot in `map`. @param {Pose} pose */
function robotMatrix({ x, y, yaw }, z = 0) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return new Float32Array([c, s, 0, 0, -s, c, 0, 0, 0, 0, 1, 0, x, y, z, 1]);
}

/** The drawables of one robot. */
class RobotDrawables {
  /** @param {Renderer} renderer */
  constructor(renderer) {
    this.scan = renderer.createPlaces(new Float32Array(0));
    this.trail = renderer.createMesh({ vertices: new Float32Array(0), count: 0 });
    /** @type {unknown} */
    this.shownScan = null;
    /** @type {unknown} */
    this.shownTrail = null;
    this.trailAt = -Infinity;
    this.plan = renderer.createMesh({ vertices: new Float32Array(0), count: 0 });
    /** @type {unknown} */
    this.shownPlan = null;
    /** Where the plan's frame was when it was shown. */
    this.planAt = "";
  }
}

/** Draws the fleet with a renderer. */
export class Scene {
  /** @param {Renderer} renderer */
  constructor(renderer) {
    this.renderer = renderer;
    this.burger = renderer.createMesh(burger());
    this.ring = renderer.createMesh(selectionRing());
    this.cursor = renderer.createMesh(cursorRing());
    this.ray = renderer.createMesh(ray());
    this.map = renderer.createTexture(renderer.gl.TEXTURE_2D, renderer.gl.LINEAR_MIPMAP_LINEAR);
    this.marks = new Marks(renderer);
    this.shownMap = 0;
    /** Whether the texture holds the map: not one that is too large for it. */
    this.hasMap = false;
    this.seen = renderer.createTexture(renderer.gl.TEXTURE_2D, renderer.gl.LINEAR_MIPMAP_LINEAR);
    /** The layer of colours that is shown. @type {import("./seen.js").Layer | null} */
    this.shownSeen = null;
    /** @type {Map<number, RobotDrawables>} */
    this.robots = new Map();
  }

  /** Takes what has changed since the last frame. @param {Fleet} fleet @param {number} now */
  update(fleet, now) {
    if (fleet.merged.version !== this.shownMap) this.updateMap(fleet);
    if (fleet.seen !== this.shownSeen) this.updateSeen(fleet.seen);
    this.marks.update(fleet);
    for (const [number, drawables] of this.robots) {
      if (fleet.robots.has(number)) continue;
      [drawables.scan, drawables.trail, drawables.plan].forEach((drawable) => this.renderer.delete(drawable));
      this.robots.delete(number);
    }
    for (const robot of fleet.robots.values()) {
      let drawables = this.robots.get(robot.number);
      if (!drawables) {
        drawables = new RobotDrawables(this.renderer);
        this.robots.set(robot.number, drawables);
      }
      if (robot.scan !== drawables.shownScan) {
        drawables.shownScan = robot.scan;
        this.renderer.update(drawables.scan, scanPoints(robot), 3);
      }
      // A trail that is laid elsewhere has other points, and one of a robot that is not in the map is not shown.
      const trail = fleet.isPlaced(robot) ? robot.trail : [];
      const last = trail.at(-1);
      if (last !== drawables.shownTrail && now - drawables.trailAt >= TRAIL_PERIOD_S) {
        drawables.shownTrail = last;
        drawables.trailAt = now;
        this.renderer.update(drawables.trail, ribbon(trail, TRAIL_WIDTH_M).vertices, VERTEX_NUMBERS);
      }
      // A plan is in the robot's map: it lies elsewhere when that map does.
      const plan = hasGoal(robot) ? robot.plan : null;
      const at = plan && fleet.find(plan.frame);
      const key = plan && at ? `${at.x} ${at.y} ${at.yaw}` : "";
      if (plan !== drawables.shownPlan || key !== drawables.planAt) {
        Object.assign(drawables, { shownPlan: plan, planAt: key });
        this.renderer.update(drawables.plan, ribbon(planInMap(robot, fleet) ?? [], PLAN_WIDTH_M).vertices, VERTEX_NUMBERS);
      }
    }
  }

  /** @param {Fleet} fleet */
  updateMap({ merged }) {
    const areas = this.shownMap === 0 ? null : merged.changedSince(this.shownMap);
    this.shownMap = merged.version;
    const { gl } = this.renderer;
    const map = merged.grid;
    const hadMap = this.hasMap;
    this.hasMap = map !== null && map.width > 0 && Math.max(map.width, map.height) <= gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (!map || !this.hasMap) return;
    gl.bindTexture(gl.TEXTURE_2D, this.map);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    for (const area of (hadMap && areas) || [{ x: 0, y: 0, width: map.width, height: map.height }]) {
      const { x, y, width, height } = area;
      const pixels = new Uint32Array(width * height);
      colourCells(map, area, pixels, FREE_PIXEL, OCCUPIED_PIXEL);
      const bytes = new Uint8Array(pixels.buffer);
      if (hadMap && areas) gl.texSubImage2D(gl.TEXTURE_2D, 0, x, y, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
      else gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    }
    gl.generateMipmap(gl.TEXTURE_2D);
  }

  /**
   * Draws one view. @param {Fleet} fleet @param {number | null} selected @param {number} now @param {Matrix} xrFromMap
   * @param {number | null} [unseen] the robot from which the map is seen
   */
  draw(fleet, selected, now, xrFromMap, unseen = null) {
    const { renderer } = this;
    renderer.setCovers(false);
    this.drawMap(fleet, xrFromMap);
    this.marks.draw(xrFromMap, Math.hypot(xrFromMap[0], xrFromMap[1], xrFromMap[2]));
    for (const robot of fleet.robots.values()) {
      const drawables = this.robots.get(robot.number);
      if (!drawables) continue;
      const [r, g, b] = channels(robot.colour);
      const floor = multiply(xrFromMap, translation(0, 0, TRAIL_HEIGHT_M));
      if (drawables.trail.count > 0) renderer.drawMesh(drawables.trail, floor, [r, g, b, 0.6], { light: 0 });
      if (drawables.plan.count > 0) renderer.drawMesh(drawables.plan, floor, [r, g, b, 1], { light: 0 });
    }
    const chosen = selected === null ? null : fleet.robots.get(selected);
    if (chosen?.pose && chosen.number !== unseen) this.drawSelection(chosen, now, xrFromMap);
    renderer.setCovers(true);
    for (const robot of fleet.robots.values()) this.drawRobot(robot, now, xrFromMap, robot.number !== unseen);
  }

  /** @param {Fleet} fleet @param {Matrix} xrFromMap */
  drawMap({ map, seen }, xrFromMap) {
    if (!map || map.width === 0 || !this.hasMap) return;
    this.drawRaster(this.map, map, MAP_HEIGHT_M, xrFromMap);
    if (seen) this.drawRaster(this.seen, seen, SEEN_HEIGHT_M, xrFromMap);
  }

  /** @param {WebGLTexture} texture @param {{origin: Pose, resolution: number, width: number, height: number}} raster @param {number} height @param {Matrix} xrFromMap */
  drawRaster(texture, raster, height, xrFromMap) {
    const size = scaling(raster.width * raster.resolution, raster.height * raster.resolution, 1);
    this.renderer.drawImage(texture, multiply(xrFromMap, multiply(robotMatrix(raster.origin, height), size)));
  }

  /** Shows another layer of colours. @param {import("./seen.js").Layer | null} layer */
  updateSeen(layer) {
    this.shownSeen = layer;
    if (!layer) return;
    const { gl } = this.renderer;
    const { width, height, pixels } = layer;
    const bytes = new Uint8Array(pixels.slice().buffer);
    // Textures have colours times opacity.
    for (let i = 0; i < bytes.length; i += 4) for (let k = 0; k < 3; k += 1) bytes[i + k] = (bytes[i + k] * bytes[i + 3]) / 255;
    gl.bindTexture(gl.TEXTURE_2D, this.seen);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    gl.generateMipmap(gl.TEXTURE_2D);
  }

  /** Draws the ring, and the robot's shape through what hides it. @param {Robot} robot @param {number} now @param {Matrix} xrFromMap */
  drawSelection(robot, now, xrFromMap) {
    const { renderer } = this;
    const pose = /** @type {Pose} */ (robot.pose);
    const [r, g, b] = colourOf(robot, now);
    renderer.setOnTop(true);
    const matrix = multiply(xrFromMap, robotMatrix({ ...pose, yaw: now * 0.5 }, RING_HEIGHT_M));
    renderer.drawMesh(this.ring, matrix, [1, 1, 1, 0.95], { light: 0, ignoresDepth: true });
    const hidden = multiply(xrFromMap, robotMatrix(pose));
    renderer.drawMesh(this.burger, hidden, [r, g, b, HIDDEN_OPACITY * 0.5], { light: 0, ignoresDepth: true });
    renderer.setOnTop(false);
  }

  /** @param {Robot} robot @param {number} now @param {Matrix} xrFromMap @param {boolean} isSeen whether more than its scan is */
  drawRobot(robot, now, xrFromMap, isSeen) {
    const drawables = this.robots.get(robot.number);
    if (!drawables) return;
    const [r, g, b] = colourOf(robot, now);
    // In an enlarged map, points grow too.
    const scale = Math.hypot(xrFromMap[0], xrFromMap[1], xrFromMap[2]);
    if (robot.scan) this.renderer.drawPoints(drawables.scan, xrFromMap, [r, g, b, 0.95], POINT_M * Math.max(1, scale / 2));
    if (!robot.pose || !isSeen) return;
    this.renderer.drawMesh(this.burger, multiply(xrFromMap, robotMatrix(robot.pose)), [r, g, b, 1]);
  }

  /** Draws the ray of a controller or a hand, and where it ends. @param {Pointer} pointer @param {Vector} colour */
  drawPointer({ origin, end, isOnFloor }, [r, g, b]) {
    const { renderer } = this;
    const along = [end[0] - origin[0], end[1] - origin[1], end[2] - origin[2]];
    const length = Math.hypot(along[0], along[1], along[2]) || 1;
    // The bar lies along x: its frame turns about y, then about z.
    const [c, s] = [Math.hypot(along[0], along[2]) / length, along[1] / length];
    const tilt = new Float32Array([c, s, 0, 0, -s, c, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
    const turned = multiply(translation(...origin), rotationAboutY(Math.atan2(-along[2], along[0])));
    renderer.drawMesh(this.ray, multiply(multiply(turned, tilt), scaling(length, 1, 1)), [r, g, b, 0.8], { light: 0, ignoresDepth: true });
    const flat = multiply(multiply(translation(...end), XR_FROM_ROS), scaling(0.05));
    const upright = multiply(facing(end, origin), scaling(0.02));
    renderer.drawMesh(this.cursor, isOnFloor ? flat : upright, [r, g, b, 0.95], { light: 0, ignoresDepth: true });
  }
}

/** Returns a robot's colour, grey if its pose is stale. @param {Robot} robot @param {number} now @returns {Vector} */
function colourOf(robot, now) { return /** @type {Vector} */ (robot.isStale(now) ? STALE : channels(robot.colour)); }

/** Returns the points of a robot's newest scan in `map`. @param {Robot} robot */
export function scanPoints({ scan, scanPose }) {
  if (!scan || !scanPose) return new Float32Array(0);
  /** @type {number[]} */
  const points = [];
  scan.ranges.forEach((range, i) => {
    if (!(range >= scan.rangeMin && range <= scan.rangeMax)) return;
    const angle = scan.angleMin + i * scan.angleStep;
    const { x, y } = transform(scanPose, { x: range * Math.cos(angle), y: range * Math.sin(angle) });
    points.push(x, y, SCAN_HEIGHT_M);
  });
  return new Float32Array(points);
}
