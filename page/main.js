// The operator's page: connections, controls and panels around one fleet.

import { GoalTool, expireGoals, headingOf, refuseGoal } from "./goals.js";
import { Driving, attachStick, situationOf } from "./driving.js";
import { EdgePanel, writeEdgeCommand } from "./edges.js";
import { showButtons, showConnection, showExploration } from "./controls.js";
import { isExploring } from "./exploration.js";
import { Isolation } from "./isolation.js";
import { hintText } from "./hint.js";
import { attachKeys, nextRobot } from "./keys.js";
import { MapCursor } from "./map_cursor.js";
import { MapTools } from "./map_tools.js";
import { MapView } from "./map_view.js";
import { MeasureTool } from "./measure.js";
import { ZoneTool } from "./zones.js";
import { readGrid, writeBool, writeEmpty, writeInt } from "./messages.js";
import { AttentionList, FleetPanel, RobotPanels, element, logMessage, setText } from "./panels.js";
import { attachPointers } from "./pointers.js";
import { SetPoseTool } from "./pose_tool.js";
import { RobotMaps } from "./seen.js";
import { Fleet, MAP } from "./state.js";
import { StopButtons } from "./stop_buttons.js";
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
const mapView = new MapView(view, () => selected, logMessage);
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
    if (isOpen) stopButtons.asked.repeat();
    driving.observe();
    showLink();
  },
  time: (askedAt, answeredAt, runTime) => {
    if (live.run !== fleet.run || !fleet.setRunTime(askedAt / 1000, answeredAt / 1000, runTime)) return;
    // What this run had latched came before its time: it is asked for again.
    live.renew();
    beginRun();
  },
  status: (level, text) => {
    if (level !== ERROR) return logMessage(text);
    driving.refuse();
    refuseGoal(fleet.robots.values(), text);
    return warn(text);
  },
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
  stopButtons.show();
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

/**
 * Publishes a command, and says so if it cannot be sent. While the bridge does not answer, only what is worth carrying out late is sent:
 * what begins a motion would begin it when nobody expects it any more.
 * @param {string} topic @param {string} type @param {Uint8Array} payload @param {boolean} [isLateWorthy]
 */
function send(topic, type, payload, isLateWorthy = false) {
  const isSent = (isLateWorthy || isAnswering()) && live.publish(topic, type, payload, isLateWorthy);
  if (!isSent) warn(`${topic} was not sent: ${live.isOpen ? "the bridge does not answer" : "no connection"}`);
  return isSent;
}

/** Whether something has come lately on a connection. @param {Connection} connection */
const isConnected = (connection) => connection.isOpen && connection.silence() <= SILENT_MS;
/** Whether the bridge has answered lately to commands, and its time is known, which commands carry. */
const isAnswering = () => isConnected(live) && live.clock.toBridge(now()) !== null;

setInterval(() => {
  [live, maps].forEach((connection) => connection.tick());
  robotMaps.tick(fleet, now());
}, TICK_MS);

const showLink = () => showConnection(
  { isOpen: live.isOpen, isAnswering: isAnswering() }, { isOpen: maps.isOpen, isAnswering: isConnected(maps) }, fleet.clock.roundTrip(),
);

/** Returns the robot with a number; null if nobody has it. @param {number | null} number */
const robotOf = (number) => (number === null ? null : fleet.robots.get(number) ?? null);

/** @param {string} topic @param {DataView} data */
function receive(topic, data) {
  try {
    fleet.receive(topic, data, now());
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    logMessage(`${topic}: ${error.message}`, true);
    return;
  }
  if (topic === "/emergency_stop") stopButtons.receive();
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
  mapView.show();
}

/** @param {number | null} number */
function select(number) {
  if (number !== null && !fleet.robots.has(number)) return;
  selected = number;
  driving.observe();
  if (view.followed !== null) view.followed = number;
  const robot = robotOf(number);
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
  mapView.setFits(false);
  view.camera.center = { x: pose.x, y: pose.y };
}

// --- Emergency stop ---

const stopButtons = new StopButtons({
  fleet, now, log: logMessage, changed: () => driving.observe(),
  sendStop: () => live.publish("/emergency_stop", "std_msgs/msg/Bool", writeBool(true), true),
  sendRelease: () => send("/emergency_stop_release", "std_msgs/msg/Empty", writeEmpty()),
});

// --- Driving ---

/** @type {Driving} */
const driving = new Driving({
  fleet,
  selected: () => selected,
  situation: () => situationOf(fleet, robotOf(selected), stopButtons.asked.isAsked, isAnswering()),
  headset: () => reality.drive(),
  publish: (topic, type, payload) => live.publish(topic, type, payload),
});
const releaseStick = attachStick(element("stick"), element("knob"), driving);

function releaseAll() {
  driving.releaseKeys();
  releaseStick();
}

setInterval(() => {
  const { linear, angular } = driving.tick();
  setText(element("velocity"), fleet.isStopped === true ? "emergency stop" : `${linear.toFixed(2)} m/s, ${angular.toFixed(1)} rad/s`);
}, COMMAND_MS);

function takeOver() {
  if (selected !== null && send("/take_control", "std_msgs/msg/Int32", writeInt(selected))) driving.takeOver();
}

element("take-over").addEventListener("click", takeOver);

// --- Tools on the map ---

const ofPoses = { frame: MAP, publish: send, robot: () => robotOf(selected), log: logMessage };
/** @type {GoalTool} */
const goals = new GoalTool({ ...ofPoses, show: (isOn) => showTool("goal", goals, isOn) });
/** @type {SetPoseTool} */
const setPose = new SetPoseTool({ ...ofPoses, show: (isOn) => showTool("set-pose", setPose, isOn) });
const measure = new MeasureTool((isOn) => showTool("measure", measure, isOn));
const zones = new ZoneTool({ zones: () => fleet.zones, publish: send, show: (isOn) => showTool("zone", zones, isOn) });
const tools = new MapTools(view.camera, goals, measure, zones, setPose);
const cursor = new MapCursor(tools, (at) => mapView.goTo(at));
Object.assign(view, { measure, zones, cursor });
element("goal").addEventListener("click", () => goals.toggle());
element("set-pose").addEventListener("click", () => setPose.toggle());
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

// --- Exploration and merge edges ---

element("explore").addEventListener("click", () => {
  const starts = !isExploring(fleet.exploration);
  send("/explore/resume", "std_msgs/msg/Bool", writeBool(starts), !starts);
});

const edgePanel = new EdgePanel(element("edge-list"), element("edges"), (command, edge) => {
  send("/merge_edge_command", "std_msgs/msg/String", writeEdgeCommand(command, edge));
});

function selectNext(/** @type {number} */ step) {
  const next = nextRobot([...fleet.robots.keys()], selected, step);
  if (next !== null) select(next);
}

attachKeys({
  driving, releaseAll, select, stop: stopButtons.stop,
  takesKey: (event) => document.activeElement === view.canvas && cursor.key(event.code, event.shiftKey, event.repeat),
  actions: {
    KeyT: takeOver,
    KeyG: () => goals.toggle(),
    KeyP: () => setPose.toggle(),
    KeyM: () => measure.toggle(),
    KeyZ: () => zones.toggle(),
    BracketLeft: () => selectNext(-1),
    BracketRight: () => selectNext(1),
    ...mapView.keys,
  },
});

// --- Mixed reality ---

const reality = new MixedReality({
  fleet, select, selectNext, stop: stopButtons.stop, release: stopButtons.release, takeOver, log: logMessage, now,
  selected: () => selected,
  isConnected: isAnswering,
  mustLetGo: () => driving.isWaiting,
  isRefused: () => driving.isRefused,
  mayRelease: () => stopButtons.asked.mayRelease(now()),
  command: (what) => goals.command(what),
  isStopUnconfirmed: () => stopButtons.asked.isUnconfirmed(now()),
  floorSelected: (point) => {
    const robot = robotOf(selected);
    if (robot) goals.send(robot, { ...point, yaw: headingOf(point, point, 0, robot.pose) });
  },
}, (isOn) => { element("reality").setAttribute("aria-pressed", String(isOn)); });

// Tests and the browser's console look in here.
Object.assign(globalThis, { mixedReality: reality, mapView: view });
element("reality").addEventListener("click", () => { reality.start(); });
isMixedRealityOffered().then((isOffered) => { element("reality").hidden = !isOffered; });

// --- Drawing ---

attachPointers({ view, fleet, tools, select, zoom: mapView.zoom, show: mapView.show, log: logMessage });

function showHint() {
  const hint = element("hint");
  const figures = robotOf(selected)?.figures;
  const isReplay = fleet.figures.is_replay === true;
  document.body.classList.toggle("replay", isReplay);
  const text = hintText({
    isReplay, isOpen: live.isOpen, isAnswering: isAnswering(), isStopUnconfirmed: stopButtons.asked.isUnconfirmed(now()), isStopped: fleet.isStopped === true,
    mustSelect: selected === null && fleet.robots.size > 1 && driving.driver.driven === null, isHeld: driving.isHeld,
    otherDriver: figures?.driver && !figures.is_mine ? figures.driver : null, mustLetGo: driving.isWaiting, cursor: cursor.describe(),
  });
  hint.hidden = text === "";
  setText(hint, text);
}

/** Parts of the page that fail by themselves, and say so. */
const isolation = new Isolation((text) => logMessage(text, true));

/** Brings each panel up to date: one that fails keeps no other one from it. What the operator must not miss comes first. @param {number} time */
function updatePanels(time) {
  isolation.run("the connection", showLink);
  isolation.run("the hint", showHint);
  isolation.run("the emergency stop", () => stopButtons.show());
  isolation.run("the buttons", () => showButtons(robotOf(selected), fleet.isStopped === true));
  expireGoals(fleet.robots.values(), time).forEach(({ name }) => warn(`${name} has not accepted its goal: set it again`));
  isolation.run("the robots", () => panels.update(fleet, selected, time));
  isolation.run("the attention list", () => attention.update(fleet.attention(time, isAnswering()), fleet));
  isolation.run("the fleet's figures", () => fleetPanel.update(fleet, time));
  isolation.run("the exploration", () => showExploration(fleet.exploration));
  isolation.run("the joined maps", () => edgePanel.update(fleet.edges));
}

function frame() {
  // First: an error in one picture must not end all others.
  requestAnimationFrame(frame);
  const time = now();
  measure.followFrame(fleet.mapFrames);
  view.drawnGoal = goals.pose() ?? setPose.pose();
  view.draw(fleet, selected, time);
  fleet.recordDrawn(now());
  if (time >= panelsDue) {
    panelsDue = time + PANEL_MS / 1000;
    updatePanels(time);
  }
}
requestAnimationFrame(frame);
mapView.show();
view.layers.attach(element("layers"));
