// Triangles of what is drawn in mixed reality, in ROS's axes: x ahead, y to the left, z up. Metres.

/**
 * @typedef {object} Mesh triangles, each corner with 7 numbers: position, normal, share of the robot's colour
 * @property {Float32Array} vertices
 * @property {number} count corners
 */

/** Numbers of a corner. */
export const VERTEX_NUMBERS = 7;

/** Corners of a disc: 24 look round from a metre away. */
const ROUND = 24;

/** Collects triangles. */
export class MeshBuilder {
  constructor() {
    /** @type {number[]} */
    this.numbers = [];
  }

  /** @param {number[]} position @param {number[]} normal @param {number} tint */
  corner(position, normal, tint) { this.numbers.push(...position, ...normal, tint); }

  /** Adds a quad, its corners counter-clockwise from outside. @param {number[][]} corners @param {number[]} normal @param {number} tint */
  quad(corners, normal, tint) {
    for (const i of [0, 1, 2, 0, 2, 3]) this.corner(corners[i], normal, tint);
  }

  /** Adds a box. @param {number[]} centre @param {number[]} size @param {number} [tint] */
  box(centre, size, tint = 0) {
    for (let axis = 0; axis < 3; axis += 1) {
      for (const side of [-1, 1]) {
        const [u, v] = side > 0 ? [(axis + 1) % 3, (axis + 2) % 3] : [(axis + 2) % 3, (axis + 1) % 3];
        const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => {
          const corner = [...centre];
          corner[axis] += (side * size[axis]) / 2;
          corner[u] += (a * size[u]) / 2;
          corner[v] += (b * size[v]) / 2;
          return corner;
        });
        const normal = [0, 0, 0];
        normal[axis] = side;
        this.quad(corners, normal, tint);
      }
    }
    return this;
  }

  /**
   * Adds a cylinder. @param {number[]} centre @param {number} radius @param {number} height
   * @param {{axis?: 1 | 2, tint?: number, sides?: number, turn?: number}} [options] its axis is y (1) or z (2)
   */
  cylinder(centre, radius, height, { axis = 2, tint = 0, sides = ROUND, turn = 0 } = {}) {
    const [u, v] = axis === 2 ? [0, 1] : [2, 0];
    const at = (/** @type {number} */ angle, /** @type {number} */ end) => {
      const corner = [...centre];
      corner[axis] += (end * height) / 2;
      corner[u] += radius * Math.cos(angle);
      corner[v] += radius * Math.sin(angle);
      return corner;
    };
    for (let i = 0; i < sides; i += 1) {
      const [from, to] = [turn + (2 * Math.PI * i) / sides, turn + (2 * Math.PI * (i + 1)) / sides];
      const normal = [0, 0, 0];
      normal[u] = Math.cos((from + to) / 2);
      normal[v] = Math.sin((from + to) / 2);
      this.quad([at(from, -1), at(to, -1), at(to, 1), at(from, 1)], normal, tint);
      for (const end of [-1, 1]) {
        const cap = [0, 0, 0];
        cap[axis] = end;
        const middle = [...centre];
        middle[axis] += (end * height) / 2;
        const rim = end > 0 ? [at(from, end), at(to, end)] : [at(to, end), at(from, end)];
        for (const corner of [middle, ...rim]) this.corner(corner, cap, tint);
      }
    }
    return this;
  }

  /** Adds a flat ring on the floor. @param {number} inner @param {number} outer @param {number} [dashes] with gaps, if any */
  ring(inner, outer, dashes = 0) {
    const sides = ROUND * 2;
    for (let i = 0; i < sides; i += 1) {
      if (dashes > 0 && Math.floor((i * dashes * 2) / sides) % 2 === 1) continue;
      const [from, to] = [(2 * Math.PI * i) / sides, (2 * Math.PI * (i + 1)) / sides];
      const at = (/** @type {number} */ r, /** @type {number} */ angle) => [r * Math.cos(angle), r * Math.sin(angle), 0];
      this.quad([at(inner, from), at(outer, from), at(outer, to), at(inner, to)], [0, 0, 1], 1);
    }
    return this;
  }

  /** @returns {Mesh} */
  done() {
    return { vertices: new Float32Array(this.numbers), count: this.numbers.length / VERTEX_NUMBERS };
  }
}

/** Height of a Burger, metres (ROBOTIS e-Manual: 138 x 178 x 192 mm). */
export const BURGER_HEIGHT_M = 0.192;
/** Height of the LiDAR's plane above the floor, metres (`turtlebot3_burger.urdf`: base_scan). */
export const SCAN_HEIGHT_M = 0.182;
/** Radius of the circle around base_footprint that contains a Burger, metres. */
export const BURGER_RADIUS_M = 0.124;

/**
 * Returns a TurtleBot3 Burger in `base_footprint`: the origin is on the floor between the wheels.
 *
 * Wheels and LiDAR are where `turtlebot3_burger.urdf` has them; length, width and height are the e-Manual's.
 */
export function burger() {
  const builder = new MeshBuilder();
  const middle = -0.032;
  for (const side of [-1, 1]) {
    // Radius 33 mm, 160 mm apart, 18 mm wide.
    builder.cylinder([0, side * 0.08, 0.033], 0.033, 0.018, { axis: 1, tint: 0.06 });
    builder.cylinder([0, side * 0.0895, 0.033], 0.017, 0.002, { axis: 1, tint: 1 });
  }
  builder.box([-0.081, 0, 0.008], [0.02, 0.02, 0.012], 0.06);
  // Four plates, 138 mm across, on posts. The upper ones carry the robot's colour.
  [[0.02, 0.15], [0.062, 0.15], [0.105, 1], [0.15, 1]].forEach(([z, tint]) => {
    builder.cylinder([middle, 0, z], 0.0735, 0.005, { sides: 8, turn: Math.PI / 8, tint });
  });
  for (const [x, y] of [[0.045, 0.045], [0.045, -0.045], [-0.045, 0.045], [-0.045, -0.045]]) {
    builder.cylinder([middle + x, y, 0.085], 0.004, 0.13, { sides: 8, tint: 0.5 });
  }
  // Battery, boards.
  builder.box([middle, 0, 0.041], [0.1, 0.07, 0.032], 0.2);
  builder.box([middle, 0, 0.072], [0.085, 0.075, 0.012], 0.1);
  builder.box([middle, 0, 0.115], [0.085, 0.056, 0.012], 0.1);
  // LiDAR: its base, and the turning head.
  builder.cylinder([-0.017, 0, 0.16], 0.05, 0.016, { tint: 0.04 });
  builder.cylinder([middle, 0, 0.18], 0.036, 0.024, { tint: 0.02 });
  // What is ahead: a nose in the robot's colour.
  builder.box([0.043, 0, 0.1525], [0.02, 0.03, 0.006], 1);
  return builder.done();
}

/** Returns the ring around the selected robot, on the floor. */
export function selectionRing() { return new MeshBuilder().ring(0.165, 0.19, 12).done(); }

/** Returns a ring of radius 1 that shows where a ray meets the floor, scaled as it is needed. */
export function cursorRing() { return new MeshBuilder().ring(0.75, 1).done(); }

/** Returns a thin bar of length 1 along x: the ray of a controller. */
export function ray() { return new MeshBuilder().box([0.5, 0, 0], [1, 0.004, 0.004], 1).done(); }

/**
 * Returns a ribbon on the floor along a trail. @param {readonly {x: number, y: number}[]} points @param {number} width metres
 * @returns {Mesh}
 */
export function ribbon(points, width) {
  const builder = new MeshBuilder();
  /** @type {number[][] | null} */
  let last = null;
  for (let i = 0; i < points.length; i += 1) {
    const [before, after] = [points[Math.max(0, i - 1)], points[Math.min(points.length - 1, i + 1)]];
    const length = Math.hypot(after.x - before.x, after.y - before.y) || 1;
    const [nx, ny] = [(-(after.y - before.y) / length) * (width / 2), ((after.x - before.x) / length) * (width / 2)];
    const { x, y } = points[i];
    const edge = [[x + nx, y + ny, 0], [x - nx, y - ny, 0]];
    if (last) builder.quad([last[1], edge[1], edge[0], last[0]], [0, 0, 1], 1);
    last = edge;
  }
  return builder.done();
}
