// The view from above: the merged map, and the robots with their scans and trails, on a canvas.

import { Camera, transform } from "./geometry.js";
import { drawGoal, drawMark } from "./goals.js";
import { Layers } from "./layers.js";

/** @typedef {import("./state.js").Fleet} Fleet */
/** @typedef {import("./state.js").Robot} Robot */

/** Radius of a TurtleBot3 Burger, metres. */
const ROBOT_RADIUS_M = 0.105;
/** A robot is drawn at least so large, pixels. */
const ROBOT_RADIUS_MIN_PX = 9;
/** Percent from which a cell is occupied, and up to which it is free (map_server). */
export const OCCUPIED = 65;
export const FREE = 25;

/** On a narrower map the controls lie above and below it, pixels. */
const NARROW_PX = 560;
/** Height of the controls above and below, pixels. */
const COVERED_PX = { top: 92, bottom: 190 };

/** Draws a fleet on a canvas. */
export class View {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    this.camera = new Camera();
    /** Robot in the middle of the screen, or null. @type {number | null} */
    this.followed = null;
    /** Whether the whole map is shown, also when it grows. */
    this.fits = true;
    this.mapImage = document.createElement("canvas");
    this.seenImage = document.createElement("canvas");
    /** The layer of colours that is painted. @type {import("./seen.js").Layer | null} */
    this.paintedSeen = null;
    /** Colours and version of the map that is painted, and since when there is one, ms of the page. */
    this.painted = { colours: "", version: 0, at: 0 };
    this.layers = new Layers();
    /** The goal that the operator is drawing. @type {import("./geometry.js").Pose | null} */
    this.drawnGoal = null;
    /** The distance that the operator measures. @type {import("./measure.js").MeasureTool | null} */
    this.measure = null;
    /** The areas to keep robots out of. @type {import("./zones.js").ZoneTool | null} */
    this.zones = null;
    /** The keyboard's cursor on the map. @type {import("./map_cursor.js").MapCursor | null} */
    this.cursor = null;
  }

  /** Takes the canvas's size on the screen. */
  resize() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.canvas;
    const [width, height] = [Math.round(clientWidth * ratio), Math.round(clientHeight * ratio)];
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.camera.width = clientWidth;
    this.camera.height = clientHeight;
  }

  /** Reads the colours of the theme. */
  colours() {
    const style = getComputedStyle(this.canvas);
    const colour = (/** @type {string} */ name) => style.getPropertyValue(name).trim();
    return {
      background: colour("--map-unknown"),
      free: colour("--map-free"),
      occupied: colour("--map-occupied"),
      line: colour("--map-line"),
      text: colour("--text"),
      stale: colour("--stale"),
      alarm: colour("--danger"),
    };
  }

  /** @param {Fleet} fleet @param {number | null} selected @param {number} now */
  draw(fleet, selected, now) {
    this.resize();
    const followed = this.followed === null ? null : fleet.robots.get(this.followed)?.pose;
    if (followed) this.camera.center = { x: followed.x, y: followed.y };
    const box = this.fits ? fleet.box() : null;
    if (box) this.camera.fit(box, this.camera.width < NARROW_PX ? COVERED_PX : undefined);
    const colours = this.colours();
    const { context, camera, layers } = this;
    context.fillStyle = colours.background;
    context.fillRect(0, 0, camera.width, camera.height);
    this.drawMap(fleet, colours);
    this.zones?.draw(context, camera, colours, layers.has("zones"));
    this.drawMetres(colours);
    const robots = [...fleet.robots.values()].sort((a, b) => Number(a.number === selected) - Number(b.number === selected));
    if (layers.has("trails")) robots.filter((robot) => fleet.isPlaced(robot)).forEach((robot) => this.drawTrail(robot));
    if (layers.has("scans")) robots.forEach((robot) => this.drawScan(robot, now, colours));
    if (layers.has("left")) this.drawPlacesLeft(fleet, colours);
    if (layers.has("goals")) robots.forEach((robot) => drawGoal(context, camera, robot, fleet));
    if (this.drawnGoal) drawMark(context, camera, this.drawnGoal, colours.text, true);
    robots.forEach((robot) => this.drawRobot(robot, robot.number === selected, now, colours));
    this.measure?.draw(context, camera, colours);
    this.cursor?.draw(context, camera, colours);
  }

  /** Marks the places that exploration has not reached yet. @param {Fleet} fleet @param {ReturnType<View["colours"]>} colours */
  drawPlacesLeft(fleet, colours) {
    const { context, camera } = this;
    context.strokeStyle = colours.text;
    context.lineWidth = 2;
    for (const place of fleet.exploration?.left ?? []) {
      const { x, y } = camera.toScreen(place);
      context.beginPath();
      context.rect(x - 5, y - 5, 10, 10);
      context.stroke();
    }
  }

  /** @param {Fleet} fleet @param {ReturnType<View["colours"]>} colours */
  drawMap(fleet, colours) {
    const { map } = fleet;
    if (!map || map.width === 0 || map.height === 0) return;
    const { merged } = fleet;
    const theme = `${colours.free} ${colours.occupied}`;
    if (merged.version !== this.painted.version || theme !== this.painted.colours) {
      const areas = theme === this.painted.colours ? merged.changedSince(this.painted.version) : null;
      this.paintCells(map, areas, colours);
      this.painted = { colours: theme, version: merged.version, at: this.painted.at || performance.now() };
    }
    this.drawRaster(this.mapImage, map);
    if (fleet.seen && this.layers.has("seen")) this.drawSeen(fleet.seen);
  }

  /** Draws the colours of the robots that saw the map. @param {import("./seen.js").Layer} layer */
  drawSeen(layer) {
    if (layer !== this.paintedSeen) {
      const { width, height, pixels } = layer;
      Object.assign(this.seenImage, { width, height });
      const image = new ImageData(width, height);
      new Uint32Array(image.data.buffer).set(pixels);
      this.seenImage.getContext("2d")?.putImageData(image, 0, 0);
      this.paintedSeen = layer;
    }
    this.drawRaster(this.seenImage, layer);
  }

  /** @param {HTMLCanvasElement} image @param {{origin: import("./geometry.js").Pose, resolution: number}} raster where its first cell lies, and their size */
  drawRaster(image, { origin, resolution }) {
    const { context, camera } = this;
    const corner = camera.toScreen(origin);
    context.save();
    context.translate(corner.x, corner.y);
    context.rotate(-origin.yaw);
    const scale = resolution * camera.scale;
    context.scale(scale, -scale);
    context.imageSmoothingEnabled = scale < 1;
    context.drawImage(image, 0, 0);
    context.restore();
  }

  /**
   * Paints cells of the map: those of some areas, or all.
   * @param {NonNullable<Fleet["map"]>} map @param {import("./merged_map.js").Area[] | null} areas
   * @param {ReturnType<View["colours"]>} colours
   */
  paintCells(map, areas, colours) {
    if (!areas) {
      this.mapImage.width = map.width;
      this.mapImage.height = map.height;
    }
    const context = /** @type {CanvasRenderingContext2D} */ (this.mapImage.getContext("2d"));
    const [free, occupied] = [pixelOf(colours.free), pixelOf(colours.occupied)];
    for (const { x, y, width, height } of areas ?? [{ x: 0, y: 0, width: map.width, height: map.height }]) {
      const image = context.createImageData(width, height);
      colourCells(map, { x, y, width, height }, new Uint32Array(image.data.buffer), free, occupied);
      context.putImageData(image, x, y);
    }
  }

  /** Draws the bar that shows how long a metre is. */
  drawMetres(/** @type {ReturnType<View["colours"]>} */ colours) {
    const { context, camera } = this;
    const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find((metres) => metres * camera.scale >= 60) ?? 100;
    const [x, y, length] = [16, camera.height - 18, step * camera.scale];
    context.strokeStyle = colours.text;
    context.fillStyle = colours.text;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(x, y - 5);
    context.lineTo(x, y);
    context.lineTo(x + length, y);
    context.lineTo(x + length, y - 5);
    context.stroke();
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "left";
    context.fillText(`${step} m`, x + 4, y - 7);
  }

  drawTrail(/** @type {Robot} */ robot) {
    const { context, camera } = this;
    if (robot.trail.length < 2) return;
    context.strokeStyle = robot.colour;
    context.globalAlpha = 0.45;
    context.lineWidth = 2;
    context.beginPath();
    for (const point of robot.trail) {
      const { x, y } = camera.toScreen(point);
      context.lineTo(x, y);
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  /** @param {Robot} robot @param {number} now @param {ReturnType<View["colours"]>} colours */
  drawScan(robot, now, colours) {
    const { scan, scanPose } = robot;
    if (!scan || !scanPose) return;
    const { context, camera } = this;
    context.fillStyle = robot.isStale(now) ? colours.stale : robot.colour;
    const size = Math.max(2, Math.min(4, camera.scale * 0.04));
    for (let i = 0; i < scan.ranges.length; i += 1) {
      const range = scan.ranges[i];
      if (!(range >= scan.rangeMin && range <= scan.rangeMax)) continue;
      const angle = scan.angleMin + i * scan.angleStep;
      const point = transform(scanPose, { x: range * Math.cos(angle), y: range * Math.sin(angle) });
      const { x, y } = camera.toScreen(point);
      context.fillRect(x - size / 2, y - size / 2, size, size);
    }
  }

  /** @param {Robot} robot @param {boolean} isSelected @param {number} now @param {ReturnType<View["colours"]>} colours */
  drawRobot(robot, isSelected, now, colours) {
    if (!robot.pose) return;
    const { context, camera } = this;
    const { x, y } = camera.toScreen(robot.pose);
    const radius = Math.max(ROBOT_RADIUS_MIN_PX, ROBOT_RADIUS_M * camera.scale);
    const isStale = robot.isStale(now);
    context.save();
    context.translate(x, y);
    if (isSelected) {
      context.strokeStyle = colours.text;
      context.lineWidth = 2;
      context.setLineDash([5, 4]);
      context.beginPath();
      context.arc(0, 0, radius + 8, 0, 2 * Math.PI);
      context.stroke();
      context.setLineDash([]);
    }
    context.rotate(-robot.pose.yaw);
    context.fillStyle = isStale ? colours.stale : robot.colour;
    context.strokeStyle = "#10151c";
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(radius * 0.6, -radius * 0.5);
    context.lineTo(radius * 1.75, 0);
    context.lineTo(radius * 0.6, radius * 0.5);
    context.closePath();
    context.fill();
    context.stroke();
    shapePath(context, robot.corners, radius);
    context.fill();
    context.stroke();
    context.rotate(robot.pose.yaw);
    context.fillStyle = "#10151c";
    context.font = `bold ${Math.max(11, Math.min(20, radius))}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(String(robot.number), 0, 0.5);
    if (isStale) {
      context.fillStyle = colours.text;
      context.font = "12px system-ui, sans-serif";
      context.fillText(`${(robot.poseAge(now) ?? 0).toFixed(0)} s old`, 0, radius + 16);
    }
    context.restore();
  }

  /** Returns the number of the robot below a pixel, or null. @param {Fleet} fleet */
  robotAt(fleet, /** @type {{x: number, y: number}} */ pixel) {
    let best = null;
    let distance = Math.max(22, ROBOT_RADIUS_M * this.camera.scale * 1.5);
    for (const robot of fleet.robots.values()) {
      if (!robot.pose) continue;
      const at = this.camera.toScreen(robot.pose);
      const d = Math.hypot(at.x - pixel.x, at.y - pixel.y);
      if (d < distance) [best, distance] = [robot.number, d];
    }
    return best;
  }
}

/** Begins the path of a disc, or of a polygon with a corner ahead. */
export function shapePath(/** @type {CanvasRenderingContext2D} */ context, corners = 0, radius = 10) {
  context.beginPath();
  if (corners === 0) {
    context.arc(0, 0, radius, 0, 2 * Math.PI);
    return;
  }
  // Polygons are larger, so that the number fits in.
  const size = radius * (corners === 3 ? 1.45 : 1.15);
  for (let i = 0; i < corners; i += 1) {
    const angle = (2 * Math.PI * i) / corners + (corners === 4 ? Math.PI / 4 : 0);
    context.lineTo(size * Math.cos(angle), size * Math.sin(angle));
  }
  context.closePath();
}

/**
 * Fills the pixels of an area of a map; they are 0 where nothing is known.
 * @param {NonNullable<Fleet["map"]>} map @param {import("./merged_map.js").Area} area @param {Uint32Array} pixels
 * @param {number} free @param {number} occupied pixels of a free and of an occupied cell
 */
export function colourCells(map, area, pixels, free, occupied) {
  for (let row = 0; row < area.height; row += 1) {
    const from = (area.y + row) * map.width + area.x;
    for (let column = 0; column < area.width; column += 1) {
      const cell = map.cells[from + column];
      if (cell > 100) continue;
      if (cell >= OCCUPIED) pixels[row * area.width + column] = occupied;
      else if (cell <= FREE) pixels[row * area.width + column] = free;
    }
  }
}

/** Returns a colour, `#rrggbb`, as a pixel of an image in memory (little-endian RGBA). */
function pixelOf(/** @type {string} */ colour) {
  const value = Number.parseInt(colour.slice(1, 7), 16);
  const [red, green, blue] = [(value >> 16) & 255, (value >> 8) & 255, value & 255];
  return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}
