// 4 x 4 matrices in columns, as WebGL and WebXR have them, and vectors of three numbers.

/** @typedef {Float32Array} Matrix */
/** @typedef {[number, number, number]} Vector */

/** @returns {Matrix} */
export function identity() { return new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]); }

/** Returns a b. @param {ArrayLike<number>} a @param {ArrayLike<number>} b @returns {Matrix} */
export function multiply(a, b) {
  const product = new Float32Array(16);
  for (let column = 0; column < 4; column += 1) {
    for (let row = 0; row < 4; row += 1) {
      let sum = 0;
      for (let i = 0; i < 4; i += 1) sum += a[i * 4 + row] * b[column * 4 + i];
      product[column * 4 + row] = sum;
    }
  }
  return product;
}

/** @param {number} x @param {number} y @param {number} z @returns {Matrix} */
export function translation(x, y, z) { return new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1]); }

/** @param {number} x @param {number} y @param {number} z @returns {Matrix} */
export function scaling(x, y = x, z = x) { return new Float32Array([x, 0, 0, 0, 0, y, 0, 0, 0, 0, z, 0, 0, 0, 0, 1]); }

/** @returns {Matrix} */
export function rotationAboutY(/** @type {number} */ angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return new Float32Array([c, 0, -s, 0, 0, 1, 0, 0, s, 0, c, 0, 0, 0, 0, 1]);
}

/** Returns the inverse of a rotation with a translation. @param {ArrayLike<number>} m @returns {Matrix} */
export function rigidInverse(m) {
  const moved = (/** @type {number} */ i) => -(m[i] * m[12] + m[i + 1] * m[13] + m[i + 2] * m[14]);
  return new Float32Array([
    m[0], m[4], m[8], 0, m[1], m[5], m[9], 0, m[2], m[6], m[10], 0, moved(0), moved(4), moved(8), 1,
  ]);
}

/** Returns a point moved by a matrix. @param {ArrayLike<number>} m @returns {Vector} */
export function transformPoint(m, /** @type {Vector} */ [x, y, z]) {
  const row = (/** @type {number} */ i) => m[i] * x + m[i + 4] * y + m[i + 8] * z + m[i + 12];
  return [row(0), row(1), row(2)];
}

/** Returns a direction turned by a matrix. @param {ArrayLike<number>} m @returns {Vector} */
export function transformDirection(m, /** @type {Vector} */ [x, y, z]) {
  const row = (/** @type {number} */ i) => m[i] * x + m[i + 4] * y + m[i + 8] * z;
  return [row(0), row(1), row(2)];
}

/** Returns the matrix of what stands upright at a point and looks at another. @param {Vector} at @param {Vector} eye @returns {Matrix} */
export function facing(at, eye) {
  return multiply(translation(...at), rotationAboutY(Math.atan2(eye[0] - at[0], eye[2] - at[2])));
}

/** @param {Vector} a @param {Vector} b */
export function distance(a, b) { return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]); }

/**
 * Returns where a ray meets the plane z = 0 of a matrix's frame, in that frame, or null.
 * @param {ArrayLike<number>} matrix rigid @param {Vector} origin @param {Vector} direction
 * @returns {{x: number, y: number, distance: number} | null}
 */
export function planeHit(matrix, origin, direction) {
  const inverse = rigidInverse(matrix);
  const from = transformPoint(inverse, origin);
  const along = transformDirection(inverse, direction);
  const length = -from[2] / along[2];
  if (!(length > 0) || !Number.isFinite(length)) return null;
  return { x: from[0] + length * along[0], y: from[1] + length * along[1], distance: length };
}
