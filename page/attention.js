// What needs the operator's attention.

import { batteryItem } from "./battery.js";
import { numberOf, robotsOf } from "./edges.js";
import { STALE_S } from "./state.js";

/** Time for which a jump is told, seconds. */
const JUMP_SHOWN_S = 60;
/** Time from which a robot that stands without a goal and a driver needs attention, seconds. */
const IDLE_S = 120;

/**
 * Returns what needs the operator's attention, the most urgent first. An item's key stays the same while it is about the same
 * thing, though its numbers change.
 * @param {import("./state.js").Fleet} fleet @param {number} now @param {boolean} isConnected
 */
export function attentionOf(fleet, now, isConnected) {
  /** @type {{rank: number, robot: number | null, text: string, key: string}[]} */
  const items = [];
  const addOfFleet = (/** @type {number} */ rank, /** @type {string} */ kind, /** @type {string} */ text) => {
    items.push({ rank, robot: null, text, key: kind });
  };
  if (!isConnected) addOfFleet(0, "connection", "no connection to the bridge");
  if (fleet.isStopped) addOfFleet(1, "stop", "emergency stop is set");
  const offer = fleet.figures.room_offer;
  if (offer) addOfFleet(2, "room", `${offer.address} offers its room as the world: at the laptop, mr-slam room accept or refuse`);
  for (const robot of fleet.robots.values()) {
    const add = (/** @type {number} */ rank, /** @type {string} */ kind, /** @type {string} */ text) => {
      items.push({ rank, robot: robot.number, text, key: `${kind} ${robot.number}` });
    };
    const age = robot.scanAge(now);
    const { slam, is_merged: isMerged, is_map_old: isMapOld, map_age_s: mapAge } = robot.figures;
    if (slam === "lost" || slam === "relocalizing") add(2, "lost", `SLAM is ${slam}`);
    if (age === null) add(3, "scan", "no scan yet");
    else if (age > STALE_S) add(3, "scan", `no scan for ${age.toFixed(0)} s`);
    const battery = batteryItem(robot.figures.battery);
    if (battery) add(battery.rank, battery.kind, battery.text);
    const { state, reason } = robot.navigation ?? {};
    if (state === "failed") add(3, "goal", `its goal was given up: ${reason}`);
    if (state === "blocked") add(4, "way", `its way is blocked: ${reason}`);
    if (!slam && age !== null && age <= STALE_S) add(4, "silent", "what its SLAM does is not known: it does not answer");
    if (slam === "paused") add(2, "paused", "SLAM is paused: nothing is mapped");
    if (slam === "unconfirmed") add(3, "unconfirmed", "its scans have not confirmed the pose that it was given");
    if (slam === "unreliable") add(2, "unreliable", "its map may be wrong");
    if (slam === "degenerate") add(4, "degenerate", "SLAM is degenerate");
    if (isMapOld === true) add(3, "map", `its part of the map is ${mapAge.toFixed(0)} s old`);
    const { jump } = robot;
    if (jump && now - jump.at < JUMP_SHOWN_S) add(3, `jump ${jump.count}`, describeJump(jump));
    const idleS = robot.idleS(now);
    if (idleS > IDLE_S && fleet.figures.is_replay !== true) add(6, "idle", `stands without a goal for ${Math.floor(idleS / 60)} min`);
    if (isMerged === false) add(5, "merge", "its map is not merged");
  }
  for (const edge of fleet.edges.filter(({ state }) => state === "dropped")) {
    const [robot, other] = robotsOf(edge);
    const text = `its map is no longer joined with that of ${other}: they contradict each other`;
    items.push({ rank: 4, robot, text, key: `edge ${robot} ${other}` });
  }
  for (const edge of fleet.edges.filter(({ contradicted }) => contradicted)) {
    const [robot, other] = robotsOf(edge);
    const places = `${edge.contradicted_submaps} of ${edge.compared_submaps} places`;
    items.push({ rank: 2, robot, text: `its map and that of ${other} contradict each other in ${places}: one is deformed, or lies wrong`, key: `bent ${robot} ${other}` });
  }
  if (fleet.areEdgesUnsaved) addOfFleet(4, "edges unsaved", "merging cannot save its state: what is pinned or undone is lost when it is started again");
  for (const robot of fleet.contradictedStarts.map(numberOf)) {
    items.push({ rank: 4, robot, text: "its given start contradicts the maps: its place comes from the maps", key: `start ${robot}` });
  }
  if (fleet.exploration?.state === "failed") addOfFleet(3, "exploration", `exploration failed: ${fleet.exploration.reason}`);
  return items.sort((a, b) => a.rank - b.rank || (a.robot ?? 0) - (b.robot ?? 0));
}

/** @param {{m: number, rad: number}} jump */
function describeJump({ m, rad }) {
  return `its pose jumped by ${m.toFixed(1)} m and ${(rad * 180 / Math.PI).toFixed(0)}°: look whether its map fits`;
}
