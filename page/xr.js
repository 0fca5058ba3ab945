// Mixed reality: the fleet on the real floor, its panels in the room, and the operator's hands.

import { pointFromXr, pointToXr, poseFromXr, xrFromFrame } from "./coordinates.js";
import { invert, transform } from "./geometry.js";
import { facing, transformDirection, transformPoint } from "./matrix.js";
import { Alignment } from "./xr_alignment.js";
import { KeptAnchor } from "./xr_anchors.js";
import { commandsOf } from "./xr_commands.js";
import { HapticAlerts } from "./xr_haptics.js";
import { Controls, isDrivingHand, rayOf } from "./xr_input.js";
import { FleetPanel, RobotPanel } from "./xr_panels.js";
import { RAY_M, panelAt, planeAt, pointOn, robotAt } from "./xr_pointing.js";
import { RoomSender } from "./xr_room.js";
import { Scene, channels } from "./xr_scene.js";
import { XrSession, requestSession } from "./xr_session.js";
import { RobotView, tablePlacement } from "./xr_views.js";

/** @typedef {import("./state.js").Fleet} Fleet */
/** @typedef {import("./state.js").Robot} Robot */
/** @typedef {import("./geometry.js").Pose} Pose */
/** @typedef {import("./xr_scene.js").Placement} Placement */
/** @typedef {import("./xr_scene.js").Pointer} Pointer */
/** @typedef {import("./xr_input.js").Ray} Ray */
/** @typedef {[number, number, number]} Vector */

/** @typedef {import("./xr_commands.js").Operator} Operator */

/** Time that a device has to restore the anchors of an earlier session before the page goes on, ms. */
const RESTORE_MS = 3000;
/** Period at which panels are painted, seconds. */
const PANEL_S = 0.25;
/** Where panels stand at first, seen from the viewer: metres ahead, to the left, below the eyes. */
const PANEL_AT = { ahead: 1.25, left: 0.55, below: 0.1 };
/** Time for which the fleet's panel shows what has failed, seconds. */
const WARNING_S = 6;

/** Mixed reality of one page. */
export class MixedReality {
  /** @param {Operator} operator @param {(isOn: boolean) => void} changed */
  constructor(operator, changed) {
    this.operator = operator;
    this.changed = changed;
    /** @type {XrSession | null} */
    this.xr = null;
    /** What has failed lately. @type {{text: string, until: number} | null} */
    this.warning = null;
    this.alignment = new Alignment(operator.fleet);
    /** Whether it is known where the map lies in this room. */
    this.isAligned = false;
    this.panelAnchor = new KeptAnchor("panel");
    this.controls = new Controls({
      next: () => operator.selectNext(1), previous: () => operator.selectNext(-1),
      stop: operator.stop, changeView: () => this.changeView(),
    });
    /** Where the map is. @type {Placement} */
    this.placement = { pose: { x: 0, y: 0, yaw: 0 }, scale: 1, height: 0 };
    /** The table-top view, if it is shown. @type {Placement | null} */
    this.table = null;
    /** The view from a robot, if it is shown, and where the map is then. @type {{view: RobotView, placement: Placement} | null} */
    this.fromRobot = null;
    this.notice = "";
    this.roomSender = new RoomSender((text) => { this.notice = text; });
    /** @type {Map<number, RobotPanel>} */
    this.robotPanels = new Map();
    /** @type {Pointer[]} */
    this.pointers = [];
    this.panelsDue = 0;
    /** The run that is shown, as the fleet counts them. */
    this.run = operator.fleet.runs;
    this.haptics = new HapticAlerts();
  }

  /** Begins a session. */
  async start() {
    /** @type {any} */
    let session = null;
    try {
      session = await requestSession();
      let hasEnded = false;
      const xr = await XrSession.begin(session, {
        input: () => this.controls.readButtons(session), moved: () => this.floorMoved(),
        update: (frame, viewer) => this.update(frame, viewer), draw: () => this.draw(),
        ended: () => { hasEnded = true; this.ended(); }, failed: (error) => this.operator.log(`mixed reality: ${error.message}`, true),
      });
      // Devices restore anchors while frames are drawn: nothing is shown until they have, or take too long.
      const restored = Promise.all([this.alignment.anchor.restore(session), this.panelAnchor.restore(session)]);
      await Promise.race([restored, new Promise((resolve) => { setTimeout(resolve, RESTORE_MS); })]);
      if (hasEnded) return;
      this.scene = new Scene(xr.renderer);
      this.fleetPanel = new FleetPanel(xr.renderer);
      this.robotPanels.clear();
      // What is held while the system's menu is open, or the headset is off, may be let go unseen.
      session.addEventListener("visibilitychange", () => this.controls.release());
      session.addEventListener("select", (/** @type {any} */ event) => {
        const ray = rayOf(event.frame, event.inputSource, xr.space);
        if (ray && !isDrivingHand(event.inputSource)) this.select(ray, event.frame);
      });
      this.xr = xr;
      this.changed(true);
    } catch (error) {
      this.operator.log(`mixed reality cannot start: ${/** @type {Error} */ (error).message}`, true);
      // One that has begun would stay empty before the operator's eyes.
      session?.end().catch(() => {});
    }
  }

  ended() {
    this.xr = null;
    this.showLifeSize();
    this.alignment.cancel();
    this.controls.release();
    this.changed(false);
  }

  /** The headset's floor has other coordinates, as after "reset view": what was fixed in the old ones is put anew. */
  floorMoved() {
    [this.alignment.anchor, this.panelAnchor].forEach((anchor) => anchor.forgetFixed());
    this.alignment.cancel();
    this.showLifeSize();
  }

  /** Returns what the thumbstick says, or null outside of a session. */
  drive() { return this.xr ? this.controls.drive(this.operator.now()) : null; }

  /** Where the map is drawn now. */
  get shown() { return this.fromRobot?.placement ?? this.table ?? this.placement; }

  // --- Frames ---

  /** @param {any} frame @param {any} viewer */
  update(frame, viewer) {
    const { xr, operator: { fleet }, scene } = this;
    if (!xr || !scene) return;
    const now = this.operator.now();
    this.followRun();
    const { matrix } = viewer.transform;
    const eye = /** @type {Vector} */ ([matrix[12], matrix[13], matrix[14]]);
    const gaze = transformDirection(matrix, [0, 0, -1]);
    this.controls.update(xr.session, frame, xr.space, now, poseFromXr(matrix).yaw);
    this.roomSender.update(frame, xr.space, fleet.runs, this.alignment);
    const aligned = this.alignment.pose(frame, xr.space);
    this.isAligned = aligned !== null;
    if (aligned) this.placement.pose = aligned;
    this.viewerPose = poseFromXr(matrix);
    this.eyeHeight = eye[1];
    this.updateRobotView();
    this.xrFromMap = xrFromFrame(this.shown.pose, this.shown.scale, this.shown.height);
    scene.update(fleet, now);
    this.updatePanels(frame, eye, gaze, now);
    this.pointers = this.controls.rays.map((ray) => this.pointerOf(ray));
    this.haptics.update(xr.session, fleet.isStopped === true, fleet.attention(now, this.operator.isConnected()));
  }

  /** Forgets what was begun with a run that has ended, and the robots that the fleet no longer has. */
  followRun() {
    const { runs, robots } = this.operator.fleet;
    for (const [number, panel] of this.robotPanels) {
      if (robots.has(number)) continue;
      panel.dispose();
      this.robotPanels.delete(number);
    }
    if (runs === this.run) return;
    this.run = runs;
    this.alignment.cancel();
    this.showLifeSize();
  }

  draw() {
    const { xr, scene, operator, xrFromMap } = this;
    if (!xr || !scene || !xrFromMap) return;
    scene.draw(operator.fleet, operator.selected(), operator.now(), xrFromMap, this.fromRobot?.view.robot ?? null);
    xr.renderer.setOnTop(true);
    const place = xr.renderer.eye?.place ?? [0, 0, 0];
    const distance = (/** @type {import("./xr_panels.js").Panel} */ { matrix }) => (matrix ? Math.hypot(matrix[12] - place[0], matrix[13] - place[1], matrix[14] - place[2]) : 0);
    this.panels().sort((a, b) => distance(b) - distance(a)).forEach((panel) => panel.draw());
    const robot = operator.fleet.robots.get(operator.selected() ?? -1);
    const colour = robot ? channels(robot.colour) : /** @type {Vector} */ ([1, 1, 1]);
    for (const pointer of this.pointers) scene.drawPointer(pointer, colour);
    const { held } = this.controls.hand;
    if (held) scene.drawPointer({ origin: held.from, direction: [0, 0, 0], end: held.at, isOnFloor: false }, colour);
    xr.renderer.setOnTop(false);
  }

  panels() {
    // The panel of the robot that is looked from would be around the viewer's head.
    const ofRobots = [...this.robotPanels].filter(([number]) => number !== this.fromRobot?.view.robot).map(([, panel]) => panel);
    return [...ofRobots, ...(this.fleetPanel ? [this.fleetPanel] : [])];
  }

  /** @param {any} frame @param {Vector} eye @param {Vector} gaze @param {number} now */
  updatePanels(frame, eye, gaze, now) {
    const { xr, fleetPanel, operator: { fleet } } = this;
    if (!xr || !fleetPanel) return;
    const kept = this.panelAnchor.matrix(frame, xr.space);
    if (kept) fleetPanel.matrix = kept;
    else this.putPanel(frame, eye);
    const isDue = now >= this.panelsDue;
    if (isDue) {
      this.panelsDue = now + PANEL_S;
      const isConnected = this.operator.isConnected();
      const text = this.noticeText(isConnected);
      const items = fleet.attention(now, isConnected);
      fleetPanel.show(fleet, now, { text, isGood: isConnected && !this.alignment.steps && !this.mustAlign && !fleet.isStopped }, items, commandsOf(this), this.operator.select);
    }
    const ahead = fleetPanel.hit(eye, gaze) ? null : gaze;
    for (const robot of fleet.robots.values()) this.updateRobotPanel(robot, eye, ahead, now, isDue);
  }

  /** @param {Robot} robot @param {Vector} eye @param {Vector | null} gaze @param {number} now @param {boolean} isDue */
  updateRobotPanel(robot, eye, gaze, now, isDue) {
    let panel = this.robotPanels.get(robot.number);
    if (!robot.pose || !this.xr || !this.xrFromMap) {
      if (panel) panel.matrix = null;
      return;
    }
    if (!panel) {
      panel = new RobotPanel(this.xr.renderer);
      this.robotPanels.set(robot.number, panel);
    }
    panel.place(transformPoint(this.xrFromMap, [robot.pose.x, robot.pose.y, 0]), eye, gaze, now, this.shown.scale);
    const select = () => this.operator.select(robot.number);
    if (isDue || panel.shown === "") panel.show(robot, robot.number === this.operator.selected(), now, select);
  }

  /** Puts the fleet's panel before the viewer, and keeps it there. @param {any} frame @param {Vector} eye */
  putPanel(frame, eye) {
    const place = transform(/** @type {Pose} */ (this.viewerPose), { x: PANEL_AT.ahead, y: PANEL_AT.left });
    const [x, , z] = pointToXr([place.x, place.y, 0]);
    const matrix = facing([x, eye[1] - PANEL_AT.below, z], eye);
    if (this.xr) this.panelAnchor.put(frame, this.xr.space, matrix, null);
    if (this.fleetPanel) this.fleetPanel.matrix = matrix;
  }

  /** Shows a text on the fleet's panel for some seconds. */
  warn(/** @type {string} */ text) { this.warning = { text, until: this.operator.now() + WARNING_S }; }

  noticeText(/** @type {boolean} */ isConnected) {
    if (this.operator.isStopUnconfirmed()) return "the emergency stop is not confirmed";
    if (!isConnected) return "no connection: you drive nothing, robots with goals drive on";
    const { steps } = this.alignment;
    if (steps) return steps.place ? `point straight ahead of ${steps.name}` : `point where ${steps.name} stands`;
    if (this.operator.fleet.isStopped) return "emergency stop is set";
    if (this.operator.isRefused()) return "somebody else drives this robot: take it over";
    if (this.operator.mustLetGo()) return "let go, and hold again to drive";
    if (this.warning && this.operator.now() < this.warning.until) return this.warning.text;
    if (this.mustAlign) return "align the map: where it lies in this room is not known";
    return this.notice || "connected";
  }

  /** Whether the map is shown in life size and nobody has said where it lies. */
  get mustAlign() { return !this.isAligned && this.shown === this.placement; }

  // --- Pointing ---

  /** Returns the robot that a ray passes, the nearest to it. @param {Ray} ray */
  robotAt(ray) { return this.xrFromMap ? robotAt(ray, this.operator.fleet.robots.values(), this.xrFromMap, this.shown.scale) : null; }

  /** Returns the panel that a ray meets first, and where. @param {Ray} ray */
  panelAt(ray) { return panelAt(ray, this.panels()); }

  /** Returns where a ray meets the plane of the map, in WebXR. @param {Ray} ray @returns {Vector | null} */
  planeAt(ray) { return planeAt(ray, (this.alignment.steps ? this.placement : this.shown).height); }

  /** Returns what a ray points at, to be drawn. @param {Ray} ray @returns {Pointer} */
  pointerOf(ray) {
    const panel = this.panelAt(ray);
    if (panel) return { ...ray, end: pointOn(ray, panel.hit.distance), isOnFloor: false };
    const robot = this.alignment.steps ? null : this.robotAt(ray);
    if (robot) return { ...ray, end: robot.at, isOnFloor: false };
    const floor = this.planeAt(ray);
    return { ...ray, end: floor ?? pointOn(ray, RAY_M), isOnFloor: floor !== null };
  }

  /** A trigger was pulled, or fingers pinched. @param {Ray} ray @param {any} frame */
  select(ray, frame) {
    const panel = this.panelAt(ray);
    if (panel) {
      panel.panel.buttonAt(panel.hit)?.press();
      this.panelsDue = 0;
      return;
    }
    if (this.alignment.steps) {
      const place = this.planeAt(ray);
      if (place) this.alignTo(place, frame);
      return;
    }
    const robot = this.robotAt(ray);
    if (robot) {
      this.operator.select(robot.robot.number);
      this.panelsDue = 0;
      return;
    }
    const point = this.planeAt(ray);
    if (point && this.mustAlign) this.warn("align the map first: where this is in it is not known");
    else if (point) this.operator.floorSelected(this.mapPoint(point));
  }

  /** Returns a point of the map's plane in `map`. @param {Vector} point in WebXR */
  mapPoint(point) {
    const { pose, scale } = this.shown;
    const [x, y] = pointFromXr(point);
    const inMap = transform(invert(pose), { x, y });
    // The table's frame has its scale about its own origin.
    return { x: inMap.x / scale, y: inMap.y / scale };
  }

  /** Returns where a button of the fleet's panel is in WebXR, or null: for tests. @param {string} text @returns {Vector | null} */
  buttonPlace(text) {
    const panel = this.fleetPanel;
    const button = panel?.buttons.find((known) => known.text === text);
    return panel?.matrix && button ? transformPoint(panel.matrix, panel.placeOf(button)) : null;
  }

  // --- Where the map is ---

  /** Begins to align the map to the room with the selected robot, or gives it up. */
  beginAlignment() {
    const { fleet, selected } = this.operator;
    const robot = fleet.robots.get(selected() ?? fleet.robots.keys().next().value ?? -1);
    this.showLifeSize();
    if (this.alignment.steps) {
      this.alignment.cancel();
      this.notice = "";
    } else if (!robot || !this.alignment.begin(robot)) {
      this.notice = robot ? `where ${robot.name} is in the map is not known` : "there is no robot to align with";
    }
  }

  /** Takes the next point of the alignment. @param {Vector} point on the floor @param {any} frame */
  alignTo(point, frame) {
    if (!this.xr) return;
    const kept = this.alignment.take(point, frame, this.xr.space);
    if (!kept) return;
    this.notice = "aligned";
    kept.then((isKept) => { if (!isKept) this.notice = "aligned for this session: the headset does not keep it"; });
  }

  showLifeSize() {
    this.table = null;
    this.fromRobot = null;
    if (this.xr) this.xr.isHiding = true;
  }

  /** Returns the name of the view that comes next: life-size, on a table, from a robot. */
  nextView() {
    if (this.fromRobot) return "Life-size";
    return this.table ? "Robot view" : "Table-top";
  }

  /** Changes to the next view. Without a selected robot there is no view from one. */
  changeView() {
    const [box, next, viewer] = [this.operator.fleet.box(), this.nextView(), this.viewerPose];
    const pose = this.operator.fleet.robots.get(this.operator.selected() ?? -1)?.pose;
    this.showLifeSize();
    if (next === "Table-top" && box && viewer) this.table = tablePlacement(box, viewer);
    else if (next === "Robot view" && pose) this.viewFromRobot();
    else if (next === "Robot view") this.notice = "select a robot for the view from it";
  }

  /** Begins the view from the selected robot. */
  viewFromRobot() {
    const number = this.operator.selected();
    const pose = this.operator.fleet.robots.get(number ?? -1)?.pose;
    if (number === null || !pose || !this.viewerPose) return;
    const view = new RobotView(number, pose, this.viewerPose, this.eyeHeight ?? 0);
    this.fromRobot = { view, placement: view.placement(pose) };
    // The real room is not that of the enlarged map: it hides nothing.
    if (this.xr) this.xr.isHiding = false;
  }

  /** Moves the map as the robot drives, and changes to another robot with the selection. */
  updateRobotView() {
    if (!this.fromRobot) return;
    const pose = this.operator.fleet.robots.get(this.fromRobot.view.robot)?.pose;
    if (this.operator.selected() !== this.fromRobot.view.robot) this.viewFromRobot();
    else if (pose) this.fromRobot.placement = this.fromRobot.view.placement(pose);
  }
}
