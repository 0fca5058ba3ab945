// The operator's page: connections, controls and panels around one fleet.

import { GoalTool, hasGoal, headingOf } from "./goals.js";
import { Driver, gamepadDeflection, isDriveKey, keyDeflection, stickDeflection } from "./input.js";
import { EdgePanel, writeEdgeCommand } from "./edges.js";
import { describeExploration, isExploring } from "./exploration.js";
import { MeasureTool } from "./measure.js";
import { ZoneTool } from "./zones.js";
import { readGrid, writeBool, writeEmpty, writeInt, writeTwist } from "./messages.js";
import { AttentionList, FleetPanel, RobotPanels, element, logMessage, setText } from "./panels.js";
import { attachPointers } from "./pointers.js";
import { RobotMaps } from "./seen.js";
import { Fleet, MAP } from "./state.js";
import { Connection } from "./transport.js";
import { View } from "./view.js";
import { MixedReality } from "./xr.js";
import { isMixedRealityOffered } from "./xr_session.js";

/** Period of velocities, ms: 20 Hz. The bridge stops a robot 300 ms after the last one. */
const COMMAND_MS = 50;
/** Period at which panels are brought up to date, ms. */
const PANEL_MS = 200;
/** Period at which the bridge is asked for the run's time, ms. */
const TICK_MS = 1000;
/** A connection on which nothing comes for so long is shown as one that does not answer, ms. */
const SILENT_MS = 1500;
/** The parameter with the state of the fleet. */
const FLEET_PARAMETER = "/mr_slam/fleet";
/** The level of a status that says that something was refused. */
const ERROR = 2;

const now = () => performance.now() / 1000;
const fleet = new Fleet();
const view = new View(/** @type {HTMLCanvasElement} */ (element("view")));
const driver = new Driver();
/** @type {number | null} */
let selected = null;
/** When the emergency stop was asked for, seconds, until the bridge has confirmed it. @type {number | null} */
let stopAskedAt = null;
let panelsDue = 0;

const panels = new RobotPanels(select);
const fleetPanel = new FleetPanel();
const attention = new AttentionList(goTo);
const url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/`;

/** Commands, transforms, scans and states: nothing large, so that nothing waits. */
const live = new Connection(url, {
  message: receive,
  state: (isOpen) => {
    if (isOpen) fleet.clock.reset();
    showLink();
  },
  time: (askedAt, answeredAt, runTime) => {
    if (!fleet.setRunTime(askedAt / 1000, answeredAt / 1000, runTime)) return;
    robotMaps.clear();
    logMessage("the fleet has started again");
  },
  status: (level, text) => logMessage(text, level === ERROR),
  parameter: (name, value) => {
    if (name !== FLEET_PARAMETER) return;
    for (const robot of fleet.setFigures(value, now())) addRobot(robot);
  },
});
live.subscribeParameters();
["/emergency_stop", "/tf_static", "/tf", "/merge_edges", "/explore/state", "/exclusion_zones"].forEach((topic) => live.subscribe(topic));

/** Maps have a connection of their own: they delay neither commands nor transforms. */
const maps = new Connection(url, {
  message: (topic, data) => {
    if (robotMaps.receive(topic, () => readGrid(data), now())) fleet.seen = robotMaps.layer(fleet);
    else receive(topic, data);
    followMap();
  },
  state: (isOpen) => {
    if (isOpen) fleet.merged.begin();
    followMap();
  },
});
maps.subscribe("/merged_map_tiles");
const robotMaps = new RobotMaps(maps);

/** Asks for the whole map while it is needed; then its tiles are enough. */
function followMap() {
  if (fleet.merged.needsWhole) maps.subscribe("/merged_map");
  else maps.unsubscribe("/merged_map");
}

setInterval(() => {
  [live, maps].forEach((connection) => connection.tick());
  robotMaps.tick(fleet, now());
}, TICK_MS);

function showLink() {
  const link = element("link");
  const isSilent = live.silence() > SILENT_MS;
  setText(link, !live.isOpen ? "no connection" : isSilent ? "no answer" : "connected");
  link.className = `badge ${live.isOpen && !isSilent ? "good" : "bad"}`;
  const roundTrip = fleet.clock.roundTrip();
  link.title = roundTrip === null ? "" : `the bridge answered after ${(roundTrip * 1000).toFixed(0)} ms`;
}

/** @param {string} topic @param {DataView} data */
function receive(topic, data) {
  try {
    fleet.receive(topic, data, now());
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    logMessage(`${topic}: ${error.message}`, true);
  }
  if (topic === "/emergency_stop") showStop();
}

/** @param {import("./state.js").Robot} robot */
function addRobot(robot) {
  panels.add(robot);
  for (const topic of ["odom", "scan", "pose", "plan", "navigation_state"]) live.subscribe(robot.prefix + topic);
  // One robot needs no choice; of several the operator chooses.
  if (fleet.robots.size === 1) select(robot.number);
}

/** @param {number | null} number */
function select(number) {
  if (number !== null && !fleet.robots.has(number)) return;
  selected = number;
  if (view.followed !== null) view.followed = number;
  const robot = number === null ? null : fleet.robots.get(number);
  const target = element("target");
  setText(target, robot ? `selected: ${robot.number} · ${robot.name}` : "no robot selected");
  element("drive").style.borderColor = robot ? robot.colour : "";
  panelsDue = 0;
}

/** @param {number} number */
function goTo(number) {
  const pose = fleet.robots.get(number)?.pose;
  select(number);
  if (!pose) return;
  setFits(false);
  view.camera.center = { x: pose.x, y: pose.y };
}

// --- Emergency stop ---

function stop() {
  if (fleet.figures.is_replay === true) return;
  stopAskedAt = now();
  const isSent = live.publish("/emergency_stop", "std_msgs/msg/Bool", writeBool(true), true);
  if (!isSent) logMessage("the emergency stop could not be sent: no connection", true);
}

function showStop() {
  const isStopped = fleet.isStopped === true;
  element("stop").classList.toggle("set", isStopped);
  element("release").hidden = !isStopped;
  if (isStopped && stopAskedAt !== null) {
    logMessage(`emergency stop set, confirmed after ${((now() - stopAskedAt) * 1000).toFixed(0)} ms`);
    stopAskedAt = null;
  }
}

element("stop").addEventListener("click", stop);
function release() {
  live.publish("/emergency_stop_release", "std_msgs/msg/Empty", writeEmpty(), true);
}

element("release").addEventListener("click", release);

// --- Driving ---

/** @type {Set<string>} */
const held = new Set();
/** @type {import("./input.js").Deflection | null} */
let stick = null;

function releaseAll() {
  held.clear();
  releaseStick();
}

function releaseStick() {
  stick = null;
  element("stick").classList.remove("held");
  element("knob").style.transform = "";
}

setInterval(() => {
  const gamepad = document.hasFocus() ? [...navigator.getGamepads()].find((pad) => pad !== null) ?? null : null;
  const isStopped = fleet.isStopped === true;
  const deflection = isStopped || fleet.figures.is_replay === true ? null : reality.drive() ?? stick ?? keyDeflection(held) ?? gamepadDeflection(gamepad);
  let shown = { linear: 0, angular: 0 };
  for (const { robot: number, forward, left } of driver.tick(deflection, selected)) {
    const robot = fleet.robots.get(number);
    if (!robot) continue;
    const { linear_max_m_s: linearMax = 0, angular_max_rad_s: angularMax = 0 } = robot.figures;
    const [linear, angular] = [forward * linearMax, left * angularMax];
    live.publish(`${robot.prefix}cmd_vel`, "geometry_msgs/msg/Twist", writeTwist(linear, angular));
    if (number === selected) shown = { linear, angular };
  }
  setText(element("velocity"), isStopped ? "emergency stop" : `${shown.linear.toFixed(2)} m/s, ${shown.angular.toFixed(1)} rad/s`);
}, COMMAND_MS);

const stickElement = element("stick");
stickElement.addEventListener("pointerdown", (event) => {
  stickElement.setPointerCapture(event.pointerId);
  moveStick(event);
});
stickElement.addEventListener("pointermove", (event) => {
  if (stickElement.hasPointerCapture(event.pointerId)) moveStick(event);
});
["pointerup", "pointercancel", "lostpointercapture"].forEach((name) => stickElement.addEventListener(name, releaseStick));

/** @param {PointerEvent} event */
function moveStick(event) {
  const box = stickElement.getBoundingClientRect();
  const radius = box.width / 2;
  let [x, y] = [(event.clientX - box.left - radius) / radius, (event.clientY - box.top - radius) / radius];
  const length = Math.hypot(x, y);
  if (length > 1) [x, y] = [x / length, y / length];
  stick = stickDeflection(x, y);
  stickElement.classList.add("held");
  element("knob").style.transform = `translate(${x * radius * 0.62}px, ${y * radius * 0.62}px)`;
}

function takeOver() {
  if (selected !== null) live.publish("/take_control", "std_msgs/msg/Int32", writeInt(selected), true);
}

element("take-over").addEventListener("click", takeOver);

// --- Goals ---

const goals = new GoalTool({
  frame: MAP,
  publish: (topic, type, payload, isUrgent) => live.publish(topic, type, payload, isUrgent),
  robot: () => (selected === null ? null : fleet.robots.get(selected) ?? null),
  log: logMessage,
  show: (isOn) => {
    if (isOn) measure.toggle(false);
    if (isOn) zones.toggle(false);
    element("goal").setAttribute("aria-pressed", String(isOn));
    element("view").classList.toggle("aiming", isOn);
  },
});
element("goal").addEventListener("click", () => goals.toggle());

const measure = new MeasureTool((isOn) => {
  if (isOn && goals.isOn) goals.toggle();
  if (isOn) zones.toggle(false);
  element("measure").setAttribute("aria-pressed", String(isOn));
  element("view").classList.toggle("measuring", isOn);
});
view.measure = measure;
element("measure").addEventListener("click", () => measure.toggle());
const zones = new ZoneTool({
  zones: () => fleet.zones,
  publish: (topic, type, payload, isUrgent) => live.publish(topic, type, payload, isUrgent),
  show: (isOn) => {
    if (isOn && goals.isOn) goals.toggle();
    if (isOn) measure.toggle(false);
    element("zone").setAttribute("aria-pressed", String(isOn));
    element("view").classList.toggle("measuring", isOn);
  },
});
view.zones = zones;
element("zone").addEventListener("click", () => zones.toggle());
element("cancel-goal").addEventListener("click", () => goals.command("cancel"));
element("resume-goal").addEventListener("click", () => goals.command("resume"));

/** Offers what can be done with the selected robot's goal. */
function showGoal() {
  const robot = selected === null ? null : fleet.robots.get(selected);
  element("cancel-goal").hidden = !robot || !hasGoal(robot);
  element("resume-goal").hidden = robot?.navigation?.state !== "paused" || fleet.isStopped === true;
}

// --- Exploration and merge edges ---

element("explore").addEventListener("click", () => {
  live.publish("/explore/resume", "std_msgs/msg/Bool", writeBool(!isExploring(fleet.exploration)), true);
});

function showExploration() {
  element("exploration").hidden = fleet.exploration === null;
  if (!fleet.exploration) return;
  setText(element("exploration-state"), describeExploration(fleet.exploration));
  setText(element("explore"), isExploring(fleet.exploration) ? "Stop exploring" : "Explore");
}

const edgePanel = new EdgePanel(element("edge-list"), element("edges"), (command, edge) => {
  live.publish("/merge_edge_command", "std_msgs/msg/String", writeEdgeCommand(command, edge), true);
});

// --- Keys ---

/** @type {Record<string, () => void>} */
const KEYS = {
  Escape: stop,
  KeyT: takeOver,
  KeyG: () => goals.toggle(),
  KeyM: () => measure.toggle(),
  KeyZ: () => zones.toggle(),
  KeyF: () => setFits(true),
  KeyC: toggleFollow,
  Equal: () => zoom(1.25),
  NumpadAdd: () => zoom(1.25),
  Minus: () => zoom(0.8),
  NumpadSubtract: () => zoom(0.8),
  BracketLeft: () => selectNext(-1),
  BracketRight: () => selectNext(1),
};

/** @param {number} step */
function selectNext(step) {
  const numbers = [...fleet.robots.keys()].sort((a, b) => a - b);
  if (numbers.length === 0) return;
  const place = selected === null ? (step > 0 ? -1 : 0) : numbers.indexOf(selected);
  select(numbers[(place + step + numbers.length) % numbers.length]);
}

window.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const digit = /^(?:Digit|Numpad)([1-9])$/.exec(event.code);
  if (isDriveKey(event.code) || event.code.startsWith("Shift")) {
    held.add(event.code);
    if (isDriveKey(event.code)) event.preventDefault();
  } else if (event.repeat) {
    return;
  } else if (digit) {
    select(Number(digit[1]));
  } else if (event.code in KEYS) {
    event.preventDefault();
    KEYS[event.code]();
  }
});
window.addEventListener("keyup", (event) => held.delete(event.code));
window.addEventListener("blur", releaseAll);
document.addEventListener("visibilitychange", () => { if (document.hidden) releaseAll(); });

// --- Mixed reality ---

const reality = new MixedReality({
  fleet, select, selectNext, stop, release, takeOver, log: logMessage, now,
  selected: () => selected,
  isConnected: () => live.isOpen,
  floorSelected: (point) => {
    const robot = selected === null ? null : fleet.robots.get(selected);
    if (robot) goals.send(robot, { ...point, yaw: headingOf(point, point, 0, robot.pose) });
  },
}, (isOn) => { element("reality").setAttribute("aria-pressed", String(isOn)); });

// Tests and the browser's console look in here.
Object.assign(globalThis, { mixedReality: reality, mapView: view });
element("reality").addEventListener("click", () => { reality.start(); });
isMixedRealityOffered().then((isOffered) => { element("reality").hidden = !isOffered; });

// --- View ---

/** @param {boolean} fits */
function setFits(fits) {
  view.fits = fits;
  if (fits) view.followed = null;
  showTools();
}

function toggleFollow() {
  if (selected === null && view.followed === null) {
    logMessage("select the robot to follow first", true);
    return;
  }
  view.followed = view.followed === null ? selected : null;
  view.fits = false;
  showTools();
}

/** @param {number} factor @param {{x: number, y: number}} [pixel] */
function zoom(factor, pixel = { x: view.camera.width / 2, y: view.camera.height / 2 }) {
  view.fits = false;
  view.camera.zoom(factor, pixel);
  showTools();
}

function showTools() {
  element("fit").setAttribute("aria-pressed", String(view.fits));
  element("follow").setAttribute("aria-pressed", String(view.followed !== null));
}

element("fit").addEventListener("click", () => setFits(true));
element("follow").addEventListener("click", toggleFollow);
element("zoom-in").addEventListener("click", () => zoom(1.25));
element("zoom-out").addEventListener("click", () => zoom(0.8));

attachPointers({ view, fleet, goals, measure, zones, select, zoom, show: showTools });

// --- Drawing ---

function showHint() {
  const hint = element("hint");
  const robot = selected === null ? null : fleet.robots.get(selected);
  let text = "";
  const isReplay = fleet.figures.is_replay === true;
  document.body.classList.toggle("replay", isReplay);
  if (isReplay && live.isOpen) text = "Replay of a recording: nothing drives. The keys in its terminal pause it and change its speed.";
  else if (!live.isOpen) text = "No connection to the bridge: robots are at rest. Trying again …";
  else if (live.silence() > SILENT_MS) text = "The bridge does not answer: robots are at rest. What is shown is old.";
  else if (fleet.isStopped) text = "Emergency stop is set. Release it at the top to drive on.";
  else if (selected === null && fleet.robots.size > 1 && driver.driven === null && (stick || held.size > 0)) text = "Select a robot first.";
  else if (robot?.figures.driver && !robot.figures.is_mine && (stick || [...held].some(isDriveKey))) text = `${robot.figures.driver} drives this robot. Press T to take it over.`;
  hint.hidden = text === "";
  setText(hint, text);
}

/** Offers to take the selected robot over while somebody else drives it. */
function showTakeOver() {
  const figures = selected === null ? null : fleet.robots.get(selected)?.figures;
  element("take-over").hidden = !figures?.driver || figures.is_mine;
}

function frame() {
  const time = now();
  view.drawnGoal = goals.pose();
  view.draw(fleet, selected, time);
  if (time >= panelsDue) {
    panelsDue = time + PANEL_MS / 1000;
    panels.update(fleet, selected, time);
    fleetPanel.update(fleet, time);
    attention.update(fleet.attention(time, live.isOpen), fleet);
    edgePanel.update(fleet.edges);
    showExploration();
    showLink();
    showHint();
    showTakeOver();
    showGoal();
  }
  requestAnimationFrame(frame);
}
requestAnimationFrame(frame);
showTools();
