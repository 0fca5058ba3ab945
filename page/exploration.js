// Exploration: robots that map the building by themselves, what is left for them, and how long it takes.

import { readString } from "./messages.js";

/**
 * What exploration does, as `/explore/state` says.
 * @typedef {object} Exploration
 * @property {string} state @property {string} reason @property {number | null} knownM2 @property {number | null} leastS
 * @property {number | null} mostS @property {string[]} robots @property {{x: number, y: number}[]} left
 * places in the merged map with unknown space beside them, metres @property {number} leftCount all such places, in other maps too
 */

/** States in which robots explore, or will again by themselves. */
const RUNNING = ["exploring", "waiting", "returning"];

/** Reads `/explore/state`, a std_msgs/String with JSON. @returns {Exploration} */
export function readExploration(/** @type {DataView} */ view) {
  let json;
  try {
    json = JSON.parse(readString(view));
  } catch {
    throw new RangeError("the state of exploration is not JSON");
  }
  const { state, reason = "", known_m2: knownM2 = null, least_s: leastS = null, most_s: mostS = null, robots = [], left = [], left_count: leftCount = 0 } = json ?? {};
  if (typeof state !== "string" || !Array.isArray(left) || !Number.isInteger(leftCount) || !Array.isArray(robots)) throw new RangeError("the state of exploration has no state");
  const isPlace = (/** @type {any} */ place) => place?.frame === "map" && Number.isFinite(place.x_m) && Number.isFinite(place.y_m);
  const places = left.filter(isPlace).map(({ x_m: x, y_m: y }) => ({ x, y }));
  return { state, reason, knownM2, leastS, mostS, robots, left: places, leftCount };
}

/** Returns whether robots explore now. @param {Exploration | null} exploration */
export function isExploring(exploration) { return RUNNING.includes(exploration?.state ?? ""); }

/** Returns what exploration does, what is left and how long that takes. @param {Exploration} exploration */
export function describeExploration({ state, reason, leastS, mostS, leftCount }) {
  const parts = [state + (reason ? `: ${reason}` : "")];
  if (leftCount > 0) parts.push(`${leftCount} ${leftCount === 1 ? "place" : "places"} left`);
  if (leastS !== null && mostS !== null) parts.push(`done in ${duration(leastS)} to ${duration(mostS)}`);
  return parts.join(" · ");
}

/** Returns seconds as a short text. */
export function duration(/** @type {number} */ seconds) {
  return seconds < 100 ? `${seconds.toFixed(0)} s` : `${(seconds / 60).toFixed(seconds < 600 ? 1 : 0)} min`;
}
