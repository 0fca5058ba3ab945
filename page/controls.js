// The buttons and texts of the page that depend on the state of the fleet.

import { describeExploration, isExploring } from "./exploration.js";
import { hasGoal, isPaused } from "./goals.js";
import { element, setText } from "./panels.js";

/** The state of a connection. @typedef {{isOpen: boolean, isAnswering: boolean}} Link */

/** Returns what is said of the connections for commands and for maps: of the worse one. @param {Link} live @param {Link} maps */
export function describeConnection(live, maps) {
  if (!live.isOpen) return "no connection";
  if (!live.isAnswering) return "no answer";
  if (!maps.isOpen) return "no connection for maps";
  return maps.isAnswering ? "connected" : "no answer for maps";
}

/** Shows whether the bridge answers, and after how long. @param {Link} live @param {Link} maps @param {number | null} roundTrip seconds */
export function showConnection(live, maps, roundTrip) {
  const link = element("link");
  const text = describeConnection(live, maps);
  setText(link, text);
  link.className = `badge ${text === "connected" ? "good" : "bad"}`;
  link.title = roundTrip === null ? "" : `the bridge answered after ${(roundTrip * 1000).toFixed(0)} ms`;
}

/** Shows what exploration does; nothing if nobody has said. @param {import("./exploration.js").Exploration | null} exploration */
export function showExploration(exploration) {
  element("exploration").hidden = exploration === null;
  if (!exploration) return;
  setText(element("exploration-state"), describeExploration(exploration));
  setText(element("explore"), isExploring(exploration) ? "Stop exploring" : "Explore");
}

/** Offers what can be done with the selected robot: with its goal, and while somebody else drives it. @param {import("./state.js").Robot | null} robot @param {boolean} isStopped */
export function showButtons(robot, isStopped) {
  element("take-over").hidden = !robot?.figures.driver || robot.figures.is_mine === true;
  element("cancel-goal").hidden = !robot || !hasGoal(robot);
  element("resume-goal").hidden = !robot || !isPaused(robot) || isStopped;
}
