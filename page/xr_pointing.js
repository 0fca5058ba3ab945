// What a ray of a controller or a hand meets: a robot, a panel, or the plane of the map.

import { floorHit } from "./coordinates.js";
import { transformPoint } from "./matrix.js";
import { BURGER_HEIGHT_M } from "./models.js";

/** @typedef {import("./state.js").Robot} Robot */
/** @typedef {import("./xr_input.js").Ray} Ray */
/** @typedef {import("./xr_panels.js").Panel} Panel */
/** @typedef {[number, number, number]} Vector */

/** A ray selects a robot if it passes so near, metres, and this share of its distance more. */
const PICK_M = 0.16;
const PICK_SHARE = 0.015;
/** Smallest scale of the map at which robots are picked as on it: a smaller map has robots that nobody hits. */
const PICK_SCALE_MIN = 0.3;
/** Length of a ray that meets nothing, metres. */
export const RAY_M = 3;

/** Returns the point of a ray so far along it, metres. @param {Ray} ray @param {number} length @returns {Vector} */
export function pointOn({ origin, direction }, length) {
  return /** @type {Vector} */ (origin.map((value, i) => value + length * direction[i]));
}

/**
 * Returns the robot that a ray passes, the nearest to it, and where it is in WebXR.
 * @param {Ray} ray @param {Iterable<Robot>} robots @param {Parameters<typeof transformPoint>[0]} xrFromMap @param {number} scale of the map
 * @returns {{robot: Robot, at: Vector} | null}
 */
export function robotAt({ origin, direction }, robots, xrFromMap, scale) {
  let best = null;
  let least = Infinity;
  for (const robot of robots) {
    if (!robot.pose) continue;
    const at = transformPoint(xrFromMap, [robot.pose.x, robot.pose.y, BURGER_HEIGHT_M / 2]);
    const to = at.map((value, i) => value - origin[i]);
    const along = to[0] * direction[0] + to[1] * direction[1] + to[2] * direction[2];
    const beside = Math.sqrt(Math.max(0, to[0] ** 2 + to[1] ** 2 + to[2] ** 2 - along ** 2));
    if (along <= 0 || beside > PICK_M * Math.max(PICK_SCALE_MIN, scale) + PICK_SHARE * along || beside >= least) continue;
    [best, least] = [{ robot, at }, beside];
  }
  return best;
}

/** Returns the panel that a ray meets first, and where. @param {Ray} ray @param {Panel[]} panels */
export function panelAt({ origin, direction }, panels) {
  const hits = panels.flatMap((panel) => {
    const hit = panel.hit(origin, direction);
    return hit ? [{ panel, hit }] : [];
  });
  return hits.sort((a, b) => a.hit.distance - b.hit.distance)[0] ?? null;
}

/** Returns where a ray meets the plane at a height, in WebXR. @param {Ray} ray @param {number} height metres @returns {Vector | null} */
export function planeAt({ origin, direction }, height) {
  const hit = floorHit([origin[0], origin[1] - height, origin[2]], direction);
  return hit && [hit[0], height, hit[2]];
}
