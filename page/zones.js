// Exclusion zones: areas of the map that navigation keeps robots out of. The operator draws and removes them.

import { CdrWriter } from "./cdr.js";
import { readString, writeInt } from "./messages.js";

/** @typedef {import("./geometry.js").Point} Point */
/** @typedef {{number: number, corners: Point[]}} Zone an area, its corners in `map`, metres */

/** Side below which a drawn rectangle is a click, metres. */
const SIDE_MIN_M = 0.05;

/** Reads `/exclusion_zones`, a std_msgs/String with JSON. @returns {{zones: Zone[], refusal: string | null}} */
export function readZones(/** @type {DataView} */ view) {
  let json;
  try {
    json = JSON.parse(readString(view));
  } catch {
    throw new RangeError("the exclusion zones are not JSON");
  }
  if (!Array.isArray(json?.zones)) throw new RangeError("the exclusion zones have no list");
  const isCorner = (/** @type {any} */ corner) => Number.isFinite(corner?.[0]) && Number.isFinite(corner?.[1]);
  const isZone = (/** @type {any} */ zone) => Number.isInteger(zone?.number) && Array.isArray(zone.corners_m) && zone.corners_m.every(isCorner);
  const zones = json.zones.filter(isZone).map((/** @type {any} */ { number, corners_m: corners }) => ({
    number, corners: corners.map((/** @type {number[]} */ [x, y]) => ({ x, y })),
  }));
  return { zones, refusal: typeof json.refusal === "string" ? json.refusal : null };
}

/** Writes a geometry_msgs/PolygonStamped without a stamp. @param {string} frame @param {Point[]} corners */
export function writePolygon(frame, corners) {
  const writer = new CdrWriter().i32(0).u32(0).string(frame).u32(corners.length);
  corners.forEach(({ x, y }) => writer.f32(x).f32(y).f32(0));
  return writer.done();
}

/** Returns whether a point lies in a zone: a ray from it crosses the sides an odd number of times. @param {Zone} zone @param {Point} at */
export function contains({ corners }, at) {
  let isInside = false;
  corners.forEach((a, index) => {
    const b = corners[(index + 1) % corners.length];
    if ((a.y > at.y) !== (b.y > at.y) && at.x < ((b.x - a.x) * (at.y - a.y)) / (b.y - a.y) + a.x) isInside = !isInside;
  });
  return isInside;
}

/** The tool that draws zones as rectangles; a click removes the zone below it. */
export class ZoneTool {
  /**
   * @param {object} of
   * @param {() => Zone[]} of.zones
   * @param {(topic: string, type: string, payload: Uint8Array, isLateWorthy?: boolean) => void} of.publish
   * @param {(isOn: boolean) => void} of.show
   */
  constructor(of) {
    this.of = of;
    this.isOn = false;
    /** The opposite corners of the rectangle that is being drawn. @type {{from: Point, to: Point} | null} */
    this.drawn = null;
  }

  get isHeld() { return this.drawn !== null; }

  toggle(isOn = !this.isOn) {
    this.isOn = isOn;
    this.drawn = null;
    this.of.show(isOn);
  }

  /** Begins a rectangle; returns false if the tool is off. */
  press(/** @type {Point} */ at) {
    if (!this.isOn) return false;
    this.drawn = { from: at, to: at };
    return true;
  }

  move(/** @type {Point} */ to) {
    if (this.drawn) this.drawn.to = to;
  }

  /** Gives up the rectangle that is being drawn. */
  cancel() { this.drawn = null; }

  /** Ends a rectangle: adds the zone, or removes the newest one below a click. */
  release() {
    if (!this.drawn) return;
    const { from, to } = this.drawn;
    this.drawn = null;
    if (Math.min(Math.abs(to.x - from.x), Math.abs(to.y - from.y)) >= SIDE_MIN_M) {
      this.of.publish("/exclusion_zones/add", "geometry_msgs/msg/PolygonStamped", writePolygon("map", rectangle(from, to)), true);
      return;
    }
    const zone = this.of.zones().findLast((candidate) => contains(candidate, to));
    if (zone) this.of.publish("/exclusion_zones/remove", "std_msgs/msg/Int32", writeInt(zone.number));
  }

  /** @param {CanvasRenderingContext2D} context @param {import("./geometry.js").Camera} camera @param {{alarm: string}} colours @param {boolean} isShown whether zones are shown: while they are drawn or removed they always are */
  draw(context, camera, colours, isShown = true) {
    if (isShown || this.isOn) this.of.zones().forEach((zone) => drawArea(context, camera, zone.corners, colours.alarm));
    if (this.drawn) drawArea(context, camera, rectangle(this.drawn.from, this.drawn.to), colours.alarm);
  }
}

/** @param {Point} from @param {Point} to @returns {Point[]} */
function rectangle(from, to) { return [from, { x: to.x, y: from.y }, to, { x: from.x, y: to.y }]; }

/** Draws an area with a dashed border and stripes: it is told from walls without its colour. @param {CanvasRenderingContext2D} context @param {import("./geometry.js").Camera} camera @param {Point[]} corners @param {string} colour */
function drawArea(context, camera, corners, colour) {
  const pixels = corners.map((corner) => camera.toScreen(corner));
  context.save();
  context.strokeStyle = context.fillStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  pixels.forEach(({ x, y }) => context.lineTo(x, y));
  context.closePath();
  context.setLineDash([6, 4]);
  context.stroke();
  context.globalAlpha = 0.15;
  context.fill();
  context.clip();
  context.globalAlpha = 0.5;
  context.lineWidth = 1;
  context.setLineDash([]);
  context.beginPath();
  const [xs, ys] = [pixels.map(({ x }) => Math.min(Math.max(x, 0), camera.width)), pixels.map(({ y }) => Math.min(Math.max(y, 0), camera.height))];
  const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  for (let x = left - (bottom - top); x < right; x += 10) {
    context.moveTo(x, bottom);
    context.lineTo(x + bottom - top, top);
  }
  context.stroke();
  context.restore();
}
