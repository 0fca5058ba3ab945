// Which robot saw what: the robots' own maps, as a layer in their colours over the merged map.
//
// A robot's map is asked for now and then, one at a time, and no oftener than its size allows: the merged map does not wait.

import { compose, invert } from "./geometry.js";

/** @typedef {import("./state.js").Fleet} Fleet */
/** @typedef {import("./geometry.js").Pose} Pose */
/** @typedef {ReturnType<typeof import("./messages.js").readGrid>} Grid */
/** @typedef {{origin: Pose, resolution: number, width: number, height: number, pixels: Uint32Array, version: number}} Layer */

/** Shortest time between two requests for maps, seconds. */
const PERIOD_S = 2;
/** What robots' maps may take of the connection, bytes per second: a small part of a headset's Wi-Fi. */
const BYTES_PER_S = 50_000;
/** A map that is not here after this time is asked for again, seconds. */
const PATIENCE_S = 20;
/** Larger maps are not asked for, cells: each would hold the merged map up for seconds. */
const CELLS_MAX = 4_000_000;
/** Cells of the layer times robots, at most: its computation takes some tens of milliseconds. */
const LOOKUPS_MAX = 2_000_000;
const UNKNOWN = 255;
/** Opacity of the colours, 0 to 255: walls and free floor stay legible. */
const OPACITY = 70;

/** Asks for the robots' maps, one after the other. */
export class RobotMaps {
  /** @param {{subscribe: (topic: string) => void, unsubscribe: (topic: string) => void}} connection */
  constructor(connection) {
    this.connection = connection;
    /** The map that is asked for. @type {{robot: number, topic: string, at: number} | null} */
    this.asked = null;
    /** When the next one is asked for, seconds. */
    this.due = 0;
    /** When each robot's map came last, seconds. @type {Map<number, number>} */
    this.cameAt = new Map();
    /** The newest maps by the robots' numbers. @type {Map<number, Grid>} */
    this.grids = new Map();
    /** Counts changes. */
    this.version = 0;
  }

  /** Asks for the map that is oldest here, if one is due. Call it about once a second. @param {Fleet} fleet @param {number} now */
  tick(fleet, now) {
    if (this.asked && now - this.asked.at > PATIENCE_S) this.end();
    if (this.asked || now < this.due) return;
    const robots = [...fleet.robots.values()].filter(({ figures: { map_cells: cells } }) => cells && cells[0] * cells[1] <= CELLS_MAX);
    if (robots.length === 0) return;
    const age = (/** @type {number} */ number) => this.cameAt.get(number) ?? -Infinity;
    const { number, prefix } = robots.reduce((a, b) => (age(b.number) < age(a.number) ? b : a));
    this.asked = { robot: number, topic: `${prefix}map`, at: now };
    this.due = now + PERIOD_S;
    this.cameAt.set(number, now);
    this.connection.subscribe(this.asked.topic);
  }

  /** Takes a map. Returns whether it was asked for. @param {string} topic @param {() => Grid} read @param {number} now */
  receive(topic, read, now) {
    if (topic !== this.asked?.topic) return false;
    const { robot } = this.asked;
    this.end();
    const grid = read();
    this.grids.set(robot, grid);
    this.due = now + Math.max(PERIOD_S, grid.cells.length / BYTES_PER_S);
    this.version += 1;
    return true;
  }

  end() {
    if (this.asked) this.connection.unsubscribe(this.asked.topic);
    this.asked = null;
  }

  /** Forgets the map of a robot that the fleet no longer has. @param {number} robot */
  forget(robot) {
    if (this.asked?.robot === robot) this.end();
    this.grids.delete(robot);
    this.cameAt.delete(robot);
    this.version += 1;
  }

  /** Forgets all maps: the run is another one. */
  clear() {
    this.end();
    this.grids.clear();
    this.cameAt.clear();
    this.version += 1;
  }

  /**
   * Returns the layer over a merged map: in each cell the colour of the robot that knows it, mixed where several do.
   * @param {Fleet} fleet @returns {Layer | null} null if there is nothing to show
   */
  layer(fleet) {
    const { map } = fleet;
    const known = [...this.grids].flatMap(([number, grid]) => {
      const place = fleet.placeIn(grid.frame);
      const robot = fleet.robots.get(number);
      return map && place && robot ? [{ grid, colour: robot.colour, cellOf: cellsOf(map.origin, place(grid.origin), grid.resolution) }] : [];
    });
    if (!map || known.length === 0) return null;
    const step = Math.max(1, Math.ceil(Math.sqrt((map.width * map.height * known.length) / LOOKUPS_MAX)));
    const [width, height, resolution] = [Math.ceil(map.width / step), Math.ceil(map.height / step), map.resolution * step];
    const pixels = new Uint32Array(width * height);
    const colours = known.map(({ colour }) => [1, 3, 5].map((at) => Number.parseInt(colour.slice(at, at + 2), 16)));
    for (let row = 0; row < height; row += 1) {
      for (let column = 0; column < width; column += 1) {
        let [red, green, blue, count] = [0, 0, 0, 0];
        known.forEach(({ grid, cellOf }, i) => {
          if (!isKnown(grid, cellOf, (column + 0.5) * resolution, (row + 0.5) * resolution)) return;
          [red, green, blue, count] = [red + colours[i][0], green + colours[i][1], blue + colours[i][2], count + 1];
        });
        if (count > 0) pixels[row * width + column] = ((OPACITY << 24) | ((blue / count) << 16) | ((green / count) << 8) | (red / count)) >>> 0;
      }
    }
    return { origin: map.origin, resolution, width, height, pixels, version: this.version };
  }
}

/** Returns what takes a point of the merged map's raster, metres, to cells of a robot's map: cosine, sine, and offset over the cell's length. */
function cellsOf(/** @type {Pose} */ from, /** @type {Pose} */ to, /** @type {number} */ resolution) {
  const { x, y, yaw } = compose(invert(to), from);
  return { c: Math.cos(yaw) / resolution, s: Math.sin(yaw) / resolution, x: x / resolution, y: y / resolution };
}

/** @param {Grid} grid @param {ReturnType<typeof cellsOf>} to @param {number} x @param {number} y */
function isKnown({ width, height, cells }, to, x, y) {
  const column = Math.floor(to.c * x - to.s * y + to.x);
  const row = Math.floor(to.s * x + to.c * y + to.y);
  return column >= 0 && row >= 0 && column < width && row < height && cells[row * width + column] !== UNKNOWN;
}
