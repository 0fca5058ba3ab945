// Goals: where a robot is to go, as the operator draws it on the map, and what its navigation says of it.

import { readPath, readString, writeEmpty, writePoseStamped } from "./messages.js";
import { PoseTool, drawnHeading } from "./pose_tool.js";

/** @typedef {import("./geometry.js").Point} Point */
/** @typedef {import("./geometry.js").Pose} Pose */
/** @typedef {import("./state.js").Robot} Robot */

/** A goal that nothing has accepted for so long was lost or refused, seconds. */
const ACCEPT_S = 10;
/** States in which a robot has a goal, and a plan or none. */
const ACTIVE = ["planning", "driving", "waiting", "blocked", "recovering", "paused"];

/**
 * What navigation does with a robot.
 * @typedef {{state: string, reason: string, goal: number, remainingM: number | null, waitsFor: number | null}} Navigation
 */

/** Reads what navigation does, a std_msgs/String with JSON. @returns {Navigation} */
export function readNavigation(/** @type {DataView} */ view) {
  let json;
  try {
    json = JSON.parse(readString(view));
  } catch {
    throw new RangeError("the state of navigation is not JSON");
  }
  const { state, reason = "", goal = 0, remaining_m: remainingM = null, waits_for: waitsFor = null } = json ?? {};
  if (typeof state !== "string" || typeof reason !== "string") throw new RangeError("the state of navigation has no state");
  return { state, reason, goal: Number(goal), remainingM, waitsFor };
}

/** Takes a message of a robot's navigation; returns whether it was one. */
export function receiveNavigation(/** @type {Robot} */ robot, /** @type {string} */ topic, /** @type {DataView} */ view) {
  if (topic === "plan") robot.plan = readPath(view);
  else if (topic === "navigation_state") {
    const navigation = readNavigation(view);
    if (robot.sentGoal && navigation.goal !== robot.sentGoal.after) robot.sentGoal.isAccepted = true;
    robot.navigation = navigation;
  } else return false;
  return true;
}

/** Returns whether a robot is on its way to a goal. */
export function hasGoal(/** @type {Robot} */ robot) { return ACTIVE.includes(robot.navigation?.state ?? ""); }

/** Returns whether a robot waits for the operator before it drives on to its goal. */
export function isPaused(/** @type {Robot} */ robot) { return robot.navigation?.state === "paused"; }

/** Returns the poses of the plan that a robot follows, in the map, or null. @returns {Pose[] | null} */
export function planInMap(/** @type {Robot} */ robot, /** @type {import("./state.js").Fleet} */ fleet) {
  const { plan } = robot;
  const place = plan && hasGoal(robot) ? fleet.placeIn(plan.frame) : null;
  return plan && place && plan.poses.length > 0 ? plan.poses.map(place) : null;
}

/** Returns a goal that was sent from here and that nothing has accepted yet, or null. @returns {Pose | null} */
export function unacceptedGoal(/** @type {Robot} */ robot) {
  return robot.sentGoal && !robot.sentGoal.isAccepted ? robot.sentGoal.pose : null;
}

/** Forgets goals that nothing has accepted in time; returns their robots. @param {Iterable<Robot>} robots @param {number} now seconds */
export function expireGoals(robots, now) {
  const late = [...robots].filter((robot) => unacceptedGoal(robot) && now - (robot.sentGoal?.at ?? now) > ACCEPT_S);
  for (const robot of late) robot.sentGoal = null;
  return late;
}

/** Forgets a goal that the bridge has refused: its message begins with the topic. @param {Iterable<Robot>} robots @param {string} text */
export function refuseGoal(robots, text) {
  for (const robot of robots) if (text.startsWith(`'${robot.prefix}goal_pose'`)) robot.sentGoal = null;
}

/** Returns what navigation does, as a short text. */
export function describeNavigation(/** @type {Robot} */ robot) {
  const state = describeState(robot);
  if (!unacceptedGoal(robot)) return state;
  return state === "none" ? "goal not accepted yet" : `goal not accepted yet; before: ${state}`;
}

/** Returns what navigation said last. @param {Robot} robot */
function describeState({ navigation }) {
  if (!navigation || navigation.state === "idle") return "none";
  const { state, reason, remainingM, waitsFor } = navigation;
  const parts = [state + (waitsFor === null ? "" : ` for ${waitsFor}`)];
  if (state === "driving" && typeof remainingM === "number") parts.push(`${remainingM.toFixed(1)} m to go`);
  if (reason !== "") parts.push(reason);
  return parts.join(", ");
}

/** Returns the heading of a goal that is drawn from one point of the map to another. */
export function headingOf(/** @type {Point} */ from, /** @type {Point} */ to, /** @type {number} */ pixels, /** @type {Point | null} */ robot) {
  return drawnHeading(from, to, pixels, robot ? Math.atan2(from.y - robot.y, from.x - robot.x) : 0);
}

/** The tool that draws goals with the pointer. */
export class GoalTool extends PoseTool {
  wish = "select a robot, then set its goal";

  /** Without a drag a goal faces away from the robot. @param {Point} at @param {Robot} robot */
  clickHeading(at, robot) { return headingOf(at, at, 0, robot.pose); }

  /** Sends a goal to a robot. */
  send(/** @type {Robot} */ robot, /** @type {Pose} */ pose) {
    const message = writePoseStamped(this.of.frame, pose);
    if (!this.of.publish(`${robot.prefix}goal_pose`, "geometry_msgs/msg/PoseStamped", message)) return;
    robot.sentGoal = { pose, after: robot.navigation?.goal ?? 0, isAccepted: false, at: performance.now() / 1000 };
  }

  /** Gives the selected robot's goal up, or drives on to it. @param {"cancel" | "resume"} what */
  command(what) {
    const robot = this.of.robot();
    if (!robot) return;
    const isSent = this.of.publish(`${robot.prefix}${what}_navigation`, "std_msgs/msg/Empty", writeEmpty(), what === "cancel");
    if (isSent) robot.sentGoal = null;
  }
}

/**
 * Draws a robot's plan and goal on a canvas.
 * @param {CanvasRenderingContext2D} context @param {import("./geometry.js").Camera} camera
 * @param {Robot} robot @param {import("./state.js").Fleet} fleet
 */
export function drawGoal(context, camera, robot, fleet) {
  const unaccepted = unacceptedGoal(robot);
  if (unaccepted) drawMark(context, camera, unaccepted, robot.colour, true);
  const poses = planInMap(robot, fleet);
  if (!poses) return;
  context.strokeStyle = robot.colour;
  context.lineWidth = 3;
  context.setLineDash([8, 6]);
  context.beginPath();
  for (const pose of poses) {
    const { x, y } = camera.toScreen(pose);
    context.lineTo(x, y);
  }
  context.stroke();
  context.setLineDash([]);
  if (!unaccepted) drawMark(context, camera, poses[poses.length - 1], robot.colour, false);
}

/**
 * Draws a ring with an arrow; dashed while nothing has accepted the goal.
 * @param {CanvasRenderingContext2D} context @param {import("./geometry.js").Camera} camera
 * @param {Pose} pose @param {string} colour @param {boolean} isDashed
 */
export function drawMark(context, camera, pose, colour, isDashed) {
  const { x, y } = camera.toScreen(pose);
  context.save();
  context.translate(x, y);
  context.rotate(-pose.yaw);
  context.strokeStyle = colour;
  context.lineWidth = 3;
  if (isDashed) context.setLineDash([4, 4]);
  context.beginPath();
  context.arc(0, 0, 10, 0, 2 * Math.PI);
  context.moveTo(10, 0);
  context.lineTo(24, 0);
  context.moveTo(18, -6);
  context.lineTo(24, 0);
  context.lineTo(18, 6);
  context.stroke();
  context.restore();
}
