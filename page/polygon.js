// Triangulation of simple polygons by ear clipping (Meisters, 1975).

/** @typedef {{x: number, z: number}} Corner */

/** Most corners of a polygon: the work grows with their cube at worst. */
const CORNERS_MAX = 500;

/** Returns twice the area of a triangle, positive if its corners go counter-clockwise in x and z. @param {Corner} a @param {Corner} b @param {Corner} c */
function turn(a, b, c) { return (b.x - a.x) * (c.z - a.z) - (b.z - a.z) * (c.x - a.x); }

/** Returns whether the middle one of three corners can be cut off: no other corner lies in the triangle. @param {Corner[]} corners @param {number[]} triangle @param {number[]} rest */
function isEar(corners, triangle, rest) {
  const [a, b, c] = triangle.map((i) => corners[i]);
  const convexity = turn(a, b, c);
  // A corner on a straight edge takes no area with it.
  if (convexity <= 0) return convexity === 0;
  const isInside = (/** @type {Corner} */ p) => turn(a, b, p) >= 0 && turn(b, c, p) >= 0 && turn(c, a, p) >= 0;
  const isCorner = (/** @type {Corner} */ p) => [a, b, c].some(({ x, z }) => x === p.x && z === p.z);
  return !rest.some((i) => !isCorner(corners[i]) && isInside(corners[i]));
}

/**
 * Returns the numbers of the corners of a polygon's triangles, three for each. Empty if the polygon encloses nothing in one piece.
 * @param {Corner[]} corners @returns {number[]}
 */
export function triangulate(corners) {
  if (corners.length < 3 || corners.length > CORNERS_MAX) return [];
  const area = corners.reduce((sum, a, i) => {
    const b = corners[(i + 1) % corners.length];
    return sum + a.x * b.z - a.z * b.x;
  }, 0);
  const rest = corners.map((_, i) => i);
  if (area < 0) rest.reverse();
  /** @type {number[]} */
  const triangles = [];
  while (rest.length > 2) {
    const around = (/** @type {number} */ i) => [rest[(i + rest.length - 1) % rest.length], rest[i], rest[(i + 1) % rest.length]];
    const ear = rest.findIndex((_, i) => isEar(corners, around(i), rest));
    if (ear < 0) return [];
    triangles.push(...around(ear));
    rest.splice(ear, 1);
  }
  return triangles;
}
