// The operator's page: connections, controls and panels around one fleet.

import { GoalTool, hasGoal, headingOf } from "./goals.js";
import { Driving, attachStick } from "./driving.js";
import { isDriveKey } from "./input.js";
import { EdgePanel, writeEdgeCommand } from "./edges.js";
import { describeExploration, isExploring } from "./exploration.js";
import { MapCursor } from "./map_cursor.js";
import { MapTools } from "./map_tools.js";
import { MeasureTool } from "./measure.js";
import { ZoneTool } from "./zones.js";
import { readGrid, writeBool, writeEmpty, writeInt } from "./messages.js";
import { AttentionList, FleetPanel, RobotPanels, element, logMessage, setText } from "./panels.js";
import { attachPointers } from "./pointers.js";
import { RobotMaps } from "./seen.js";
import { Fleet, MAP } from "./state.js";
import { EmergencyStop } from "./stop.js";
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
/** What the page wants to know of each robot, below its prefix. */
const ROBOT_TOPICS = ["odom", "scan", "pose", "plan", "navigation_state"];

const now = () => performance.now() / 1000;
const fleet = new Fleet();
const view = new View(/** @type {HTMLCanvasElement} */ (element("view")));
/** @type {number | null} */
let selected = null;
let panelsDue = 0;
/** The refusal of a zone that was shown last. @type {string | null} */
let shownRefusal = null;

const panels = new RobotPanels(select);
const fleetPanel = new FleetPanel();
const attention = new AttentionList(goTo);
const url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/`;

/** Commands, transforms, scans and states: nothing large, so that nothing waits. */
const live = new Connection(url, {
  message: (topic, data) => { if (live.run === fleet.run) receive(topic, data); },
  run: setRun,
  state: (isOpen) => {
    if (isOpen) fleet.clock.reset();
    if (isOpen) emergencyStop.repeat();
    driving.observe();
    showLink();
  },
  time: (askedAt, answeredAt, runTime) => {
    if (live.run !== fleet.run || !fleet.setRunTime(askedAt / 1000, answeredAt / 1000, runTime)) return;
    // What this run had latched came before its time: it is asked for again.
    live.renew();
    beginRun();
  },
  status: (level, text) => (level === ERROR ? warn(text) : logMessage(text)),
  parameter: (name, value) => {
    if (name !== FLEET_PARAMETER || live.run !== fleet.run) return;
    const { added, gone } = fleet.setFigures(value, now());
    gone.forEach(removeRobot);
    added.forEach(addRobot);
    driving.observe();
  },
});
live.subscribeParameters();
["/emergency_stop", "/tf_static", "/tf", "/merge_edges", "/explore/state", "/exclusion_zones"].forEach((topic) => live.subscribe(topic));

/** Maps have a connection of their own: they delay neither commands nor transforms. */
const maps = new Connection(url, {
  run: setRun,
  message: (topic, data) => {
    // A run that has ended says nothing more.
    if (maps.run !== fleet.run) return;
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

/** Takes the run's identity, and forgets the run before if it is another one. @param {string} run */
function setRun(run) {
  const gone = fleet.setRun(run);
  if (!gone) return;
  gone.forEach(removeRobot);
  beginRun();
}

/** Shows nothing of the run before. */
function beginRun() {
  robotMaps.clear();
  attention.clear();
  tools.cancel();
  measure.line = null;
  panelsDue = 0;
  followMap();
  showStop();
  logMessage("the fleet has started again");
}

/** Asks for the whole map while it is needed; then its tiles are enough. */
function followMap() {
  if (fleet.merged.needsWhole) maps.subscribe("/merged_map");
  else maps.unsubscribe("/merged_map");
}

/** Says what has failed: in a headset, too, where nobody sees the list of messages. */
function warn(/** @type {string} */ text) {
  logMessage(text, true);
  reality.warn(text);
}

/** Publishes a command, and says so if it cannot be sent. @param {string} topic @param {string} type @param {Uint8Array} payload */
function send(topic, type, payload) {
  const isSent = live.publish(topic, type, payload, true);
  if (!isSent) warn(`${topic} was not sent: no connection`);
  return isSent;
}

/** Whether the bridge has answered lately. */
const isAnswering = () => live.isOpen && live.silence() <= SILENT_MS;

setInterval(() => {
  [live, maps].forEach((connection) => connection.tick());
  robotMaps.tick(fleet, now());
}, TICK_MS);

function showLink() {
  const link = element("link");
  setText(link, !live.isOpen ? "no connection" : isAnswering() ? "connected" : "no answer");
  link.className = `badge ${isAnswering() ? "good" : "bad"}`;
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
  if (topic === "/exclusion_zones") showRefusal();
}

/** Says why a zone was refused, once. */
function showRefusal() {
  if (fleet.zoneRefusal && fleet.zoneRefusal !== shownRefusal) warn(fleet.zoneRefusal);
  shownRefusal = fleet.zoneRefusal;
}

/** @param {import("./state.js").Robot} robot */
function addRobot(robot) {
  panels.add(robot);
  for (const topic of ROBOT_TOPICS) live.subscribe(robot.prefix + topic);
  // One robot needs no choice; of several the operator chooses.
  if (fleet.robots.size === 1) select(robot.number);
}

/** Shows nothing more of a robot that the fleet no longer has. @param {import("./state.js").Robot} robot */
function removeRobot(robot) {
  panels.remove(robot);
  for (const topic of ROBOT_TOPICS) live.unsubscribe(robot.prefix + topic);
  robotMaps.forget(robot.number);
  if (selected === robot.number) select(null);
  showTools();
}

/** @param {number | null} number */
function select(number) {
  if (number !== null && !fleet.robots.has(number)) return;
  selected = number;
  driving.observe();
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

const emergencyStop = new EmergencyStop(() => live.publish("/emergency_stop", "std_msgs/msg/Bool", writeBool(true), true), logMessage);

function stop() {
  if (fleet.figures.is_replay === true) return;
  emergencyStop.ask(now());
  driving.observe();
  // One that is set already is not told again.
  if (fleet.isStopped === true && isAnswering()) emergencyStop.confirm(now());
}

function showStop() {
  const isStopped = fleet.isStopped === true;
  element("stop").classList.toggle("set", isStopped);
  element("release").hidden = !isStopped;
  if (isStopped) emergencyStop.confirm(now());
  driving.observe();
}

element("stop").addEventListener("click", stop);
function release() {
  emergencyStop.forget();
  send("/emergency_stop_release", "std_msgs/msg/Empty", writeEmpty());
}

element("release").addEventListener("click", release);

// --- Driving ---

/** @type {Driving} */
const driving = new Driving({
  fleet,
  selected: () => selected,
  situation,
  headset: () => reality.drive(),
  publish: (topic, type, payload) => live.publish(topic, type, payload),
});
const releaseStick = attachStick(element("stick"), element("knob"), driving);

/** Returns what driving by hand depends on. @returns {import("./dead_man.js").Situation} */
function situation() {
  const robot = selected === null ? null : fleet.robots.get(selected);
  return {
    isStopped: fleet.isStopped === true || emergencyStop.isAsked || fleet.figures.is_replay === true,
    isConnected: isAnswering(),
    robot: robot ? `${fleet.runs} ${robot.number}` : null,
    driver: !robot?.figures.driver ? null : robot.figures.is_mine ? "me" : "other",
  };
}

function releaseAll() {
  driving.releaseKeys();
  releaseStick();
}

setInterval(() => {
  const { linear, angular } = driving.tick();
  setText(element("velocity"), fleet.isStopped === true ? "emergency stop" : `${linear.toFixed(2)} m/s, ${angular.toFixed(1)} rad/s`);
}, COMMAND_MS);

function takeOver() {
  if (selected !== null) send("/take_control", "std_msgs/msg/Int32", writeInt(selected));
}

element("take-over").addEventListener("click", takeOver);

// --- Tools on the map ---

const goals = new GoalTool({
  frame: MAP,
  publish: send,
  robot: () => (selected === null ? null : fleet.robots.get(selected) ?? null),
  log: logMessage,
  show: (isOn) => showTool("goal", goals, isOn),
});
const measure = new MeasureTool((isOn) => showTool("measure", measure, isOn));
const zones = new ZoneTool({ zones: () => fleet.zones, publish: send, show: (isOn) => showTool("zone", zones, isOn) });
const tools = new MapTools(view.camera, goals, measure, zones);
const cursor = new MapCursor(tools, (at) => {
  view.followed = null;
  setFits(false);
  view.camera.center = { ...at };
});
Object.assign(view, { measure, zones, cursor });
element("goal").addEventListener("click", () => goals.toggle());
element("measure").addEventListener("click", () => measure.toggle());
element("zone").addEventListener("click", () => zones.toggle());

/** Shows whether a tool is on. With it the map has the keyboard: its arrows move the cursor and drive nothing. @param {string} name @param {unknown} tool @param {boolean} isOn */
function showTool(name, tool, isOn) {
  element(name).setAttribute("aria-pressed", String(isOn));
  cursor.hide();
  if (isOn) {
    tools.switchOffAllBut(tool);
    driving.releaseKeys();
    view.canvas.focus({ preventScroll: true });
  }
  view.canvas.classList.toggle("drawing", tools.isOn);
}

// --- Goals ---

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
  send("/explore/resume", "std_msgs/msg/Bool", writeBool(!isExploring(fleet.exploration)));
});

function showExploration() {
  element("exploration").hidden = fleet.exploration === null;
  if (!fleet.exploration) return;
  setText(element("exploration-state"), describeExploration(fleet.exploration));
  setText(element("explore"), isExploring(fleet.exploration) ? "Stop exploring" : "Explore");
}

const edgePanel = new EdgePanel(element("edge-list"), element("edges"), (command, edge) => {
  send("/merge_edge_command", "std_msgs/msg/String", writeEdgeCommand(command, edge));
});

// --- Keys ---

/** @type {Record<string, () => void>} */
const KEYS = {
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
  if (event.code === "Escape") {
    event.preventDefault();
    if (!event.repeat) stop();
    return;
  }
  // With one of these keys, or a menu, a browser may keep the release of another key to itself.
  if (event.ctrlKey || event.metaKey || event.altKey) {
    driving.releaseKeys();
    return;
  }
  if (document.activeElement === view.canvas && cursor.key(event.code, event.shiftKey, event.repeat)) {
    event.preventDefault();
    return;
  }
  const digit = /^(?:Digit|Numpad)([1-9])$/.exec(event.code);
  if (isDriveKey(event.code) || event.code.startsWith("Shift")) {
    driving.press(event.code, event.repeat);
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
window.addEventListener("keyup", (event) => driving.release(event.code));
window.addEventListener("blur", releaseAll);
window.addEventListener("contextmenu", releaseAll);
document.addEventListener("visibilitychange", () => { if (document.hidden) releaseAll(); });

// --- Mixed reality ---

const reality = new MixedReality({
  fleet, select, selectNext, stop, release, takeOver, log: logMessage, now,
  selected: () => selected,
  isConnected: isAnswering,
  mustLetGo: () => driving.isWaiting,
  isStopUnconfirmed: () => emergencyStop.isUnconfirmed(now()),
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

attachPointers({ view, fleet, tools, select, zoom, show: showTools, log: logMessage });

// --- Drawing ---

function showHint() {
  const hint = element("hint");
  const robot = selected === null ? null : fleet.robots.get(selected);
  let text = "";
  const isReplay = fleet.figures.is_replay === true;
  document.body.classList.toggle("replay", isReplay);
  if (isReplay && live.isOpen) text = "Replay of a recording: nothing drives. The keys in its terminal pause it and change its speed.";
  else if (!live.isOpen) text = "No connection to the bridge: you drive nothing. Robots with goals drive on. Trying again …";
  else if (!isAnswering()) text = "The bridge does not answer: you drive nothing, robots with goals drive on. What is shown is old.";
  else if (emergencyStop.isUnconfirmed(now())) text = "The emergency stop is not confirmed. It is sent again whenever the connection comes back.";
  else if (fleet.isStopped) text = "Emergency stop is set. Release it at the top to drive on.";
  else if (selected === null && fleet.robots.size > 1 && driving.driver.driven === null && driving.isHeld) text = "Select a robot first.";
  else if (robot?.figures.driver && !robot.figures.is_mine && driving.isHeld) text = `${robot.figures.driver} drives this robot. Press T to take it over.`;
  else if (driving.isWaiting) text = "Let go of the key, the stick or the grip, and hold it again to drive.";
  else text = cursor.describe();
  hint.hidden = text === "";
  setText(hint, text);
}

/** Offers to take the selected robot over while somebody else drives it. */
function showTakeOver() {
  const figures = selected === null ? null : fleet.robots.get(selected)?.figures;
  element("take-over").hidden = !figures?.driver || figures.is_mine;
}

function frame() {
  // First: an error in one picture must not end all others.
  requestAnimationFrame(frame);
  const time = now();
  view.drawnGoal = goals.pose();
  view.draw(fleet, selected, time);
  fleet.recordDrawn(now());
  if (time >= panelsDue) {
    panelsDue = time + PANEL_MS / 1000;
    panels.update(fleet, selected, time);
    fleetPanel.update(fleet, time);
    attention.update(fleet.attention(time, isAnswering()), fleet);
    edgePanel.update(fleet.edges);
    showExploration();
    showLink();
    showHint();
    showTakeOver();
    showGoal();
  }
}
requestAnimationFrame(frame);
showTools();
