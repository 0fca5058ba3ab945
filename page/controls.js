// The buttons and texts of the page that depend on the state of the fleet.

import { describeExploration, isExploring } from "./exploration.js";
import { hasGoal } from "./goals.js";
import { element, setText } from "./panels.js";

/** Shows whether the bridge answers, and after how long. @param {boolean} isOpen @param {boolean} isAnswering @param {number | null} roundTrip seconds */
export function showConnection(isOpen, isAnswering, roundTrip) {
  const link = element("link");
  setText(link, !isOpen ? "no connection" : isAnswering ? "connected" : "no answer");
  link.className = `badge ${isAnswering ? "good" : "bad"}`;
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
  element("resume-goal").hidden = robot?.navigation?.state !== "paused" || isStopped;
}
