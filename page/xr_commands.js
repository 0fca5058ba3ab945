// The buttons of the fleet's panel in mixed reality, and what they may do with the page.

import { hasGoal, isPaused } from "./goals.js";

/** @typedef {import("./state.js").Fleet} Fleet */

/**
 * What the page lets mixed reality do. @typedef {object} Operator
 * @property {Fleet} fleet @property {() => number | null} selected @property {(number: number | null) => void} select
 * @property {(step: number) => void} selectNext @property {() => void} stop @property {() => void} release
 * @property {() => void} takeOver @property {() => boolean} isConnected
 * @property {() => boolean} mayRelease whether a release of the stop is meant: none was asked for or set just now
 * @property {(what: "cancel" | "resume") => void} command gives the selected robot's goal up, or drives on to it
 * @property {() => boolean} isStopUnconfirmed @property {() => boolean} mustLetGo whether what is held drives only after it was let go
 * @property {() => boolean} isRefused whether something is held and somebody else drives the robot @property {(text: string, isError?: boolean) => void} log
 * @property {() => number} now seconds
 * @property {(point: {x: number, y: number}) => void} floorSelected a point of `map` was pointed at: for goals
 */

/**
 * Returns the buttons of the fleet's panel, each at its own place; null where there is nothing to do now. So no button takes the place of
 * another one that is being pressed: the second press of a stop releases nothing.
 * @param {import("./xr.js").MixedReality} reality @returns {(import("./xr_panels.js").Command | null)[]}
 */
export function commandsOf(reality) {
  const { operator, operator: { fleet }, alignment: { steps } } = reality;
  const robot = fleet.robots.get(operator.selected() ?? -1);
  const isOthers = robot?.figures.driver && !robot.figures.is_mine;
  const isStopped = fleet.isStopped === true;
  return [
    { text: "Stop all", press: operator.stop, isDanger: true, isOn: isStopped },
    { text: steps ? "Cancel" : "Align map", press: () => reality.beginAlignment(), isOn: steps !== null },
    isStopped && operator.mayRelease() ? { text: "Release stop", press: operator.release } : null,
    robot && hasGoal(robot) ? { text: "Cancel goal", press: () => operator.command("cancel") } : null,
    robot && isPaused(robot) && !isStopped ? { text: "Drive on", press: () => operator.command("resume") } : null,
    isOthers ? { text: "Take over", press: operator.takeOver } : null,
    { text: reality.nextView(), press: () => reality.changeView() },
    { text: "Use my room", press: () => reality.roomSender.ask() },
    { text: "Leave", press: () => reality.xr?.end() },
  ];
}
