// The merged map as the page keeps it: the whole map once, then the tiles that change.

/** @typedef {ReturnType<typeof import("./messages.js").readGrid>} Grid */
/** @typedef {ReturnType<typeof import("./messages.js").readMapTiles>} TileUpdate */
/** @typedef {{x: number, y: number, width: number, height: number}} Area cells of the map */

/** Changes that are remembered for those who draw the map. */
const CHANGES_MAX = 50;
/** A value of a cell of which nothing is known. */
const UNKNOWN = 255;

/** The merged map, and what changed in it. */
export class MergedMap {
  constructor() {
    /** @type {Grid | null} */
    this.grid = null;
    /** Counts changes. */
    this.version = 0;
    /** When the map was so, seconds of the page. @type {number | null} */
    this.at = null;
    /** Whether the whole map must be asked for: there is none, or an update was missed. */
    this.needsWhole = true;
    /** Number of the last update on this connection. @type {number | null} */
    this.last = null;
    /** The newest changes; without areas, the whole map changed. @type {{version: number, areas: Area[] | null}[]} */
    this.changes = [];
  }

  /** Begins anew on another connection; what is shown stays. */
  begin() {
    this.needsWhole = true;
    this.last = null;
  }

  /** Forgets the map: the run is another one. */
  clear() {
    this.begin();
    this.grid = null;
    this.at = null;
    this.version += 1;
    this.changes = [];
  }

  /** @param {Area[] | null} areas @param {number} at */
  record(areas, at) {
    this.version += 1;
    this.at = at;
    this.changes.push({ version: this.version, areas });
    if (this.changes.length > CHANGES_MAX) this.changes.shift();
  }

  /** Takes the whole map. @param {Grid} grid @param {number} at */
  setWhole(grid, at) {
    this.grid = grid;
    this.needsWhole = false;
    this.record(null, at);
  }

  /** Takes an update. Throws a RangeError if a tile lies outside of the map. @param {TileUpdate} update @param {number} at */
  applyTiles(update, at) {
    const isMissed = update.base === 0 || (this.last !== null && this.last !== update.base);
    this.last = update.number;
    // Tiles that came before the whole map was sent are in it.
    if (isMissed) this.needsWhole = true;
    if (isMissed || !this.grid) return;
    const areas = isSamePlace(this.grid, update) ? update.tiles : null;
    const grid = areas ? this.grid : moveGrid(this.grid, update);
    if (!grid) {
      this.needsWhole = true;
      return;
    }
    for (const { x, y, width, height, cells } of update.tiles) {
      if (x + width > grid.width || y + height > grid.height) throw new RangeError("a tile lies outside of its map");
      for (let row = 0; row < height; row += 1) {
        grid.cells.set(cells.subarray(row * width, (row + 1) * width), (y + row) * grid.width + x);
      }
    }
    this.grid = grid;
    grid.stamp = update.stamp;
    this.record(areas, at);
  }

  /** Returns the areas that changed since a version, or null if the whole map may have. @returns {Area[] | null} */
  changedSince(/** @type {number} */ version) {
    const changes = this.changes.filter((change) => change.version > version);
    if (changes.length !== this.version - version) return null;
    /** @type {Area[]} */
    const areas = [];
    for (const change of changes) {
      if (!change.areas) return null;
      areas.push(...change.areas);
    }
    return areas;
  }
}

/** @param {Grid} grid @param {TileUpdate} update */
function isSamePlace(grid, { width, height, resolution, origin }) {
  return grid.width === width && grid.height === height && grid.resolution === resolution
    && grid.origin.x === origin.x && grid.origin.y === origin.y && grid.origin.yaw === origin.yaw;
}

/** Returns a map with the size and place of an update, or null if its cells are others. @param {Grid} grid @param {TileUpdate} update */
function moveGrid(grid, { stamp, frame, width, height, resolution, origin }) {
  if (grid.resolution !== resolution || grid.origin.yaw !== origin.yaw) return null;
  const [c, s] = [Math.cos(origin.yaw), Math.sin(origin.yaw)];
  const [dx, dy] = [origin.x - grid.origin.x, origin.y - grid.origin.y];
  // By how many cells the new origin lies behind the old one.
  const offset = [(c * dx + s * dy) / resolution, (c * dy - s * dx) / resolution];
  const [column, row] = offset.map(Math.round);
  if (offset.some((cells) => Math.abs(cells - Math.round(cells)) > 0.01)) return null;
  const cells = new Uint8Array(width * height).fill(UNKNOWN);
  const [first, end] = [Math.max(0, -column), Math.min(width, grid.width - column)];
  for (let y = Math.max(0, -row); y < Math.min(height, grid.height - row) && first < end; y += 1) {
    const from = (y + row) * grid.width + column;
    cells.set(grid.cells.subarray(from + first, from + end), y * width + first);
  }
  return { stamp, frame, resolution, width, height, origin, cells };
}
