// The tools on the map (goal, pose, distance, zone), as pointers and keys use them: press, move, release.

/** @typedef {import("./geometry.js").Point} Point */

/** At most one of the tools is on. Points are in the map, metres. */
export class MapTools {
  /**
   * @param {import("./geometry.js").Camera} camera
   * @param {import("./goals.js").GoalTool} goals
   * @param {import("./measure.js").MeasureTool} measure
   * @param {import("./zones.js").ZoneTool} zones
   * @param {import("./pose_tool.js").PoseTool} setPose
   */
  constructor(camera, goals, measure, zones, setPose) {
    this.camera = camera;
    this.goals = goals;
    this.measure = measure;
    this.zones = zones;
    this.setPose = setPose;
  }

  /** The tools that draw a pose. */
  get poses() { return [this.goals, this.setPose]; }

  /** The one whose pose is being drawn, if there is one. */
  get drawing() { return this.poses.find(({ drawn }) => drawn !== null); }

  /** Whether a tool is on. */
  get isOn() { return this.poses.some((tool) => tool.isOn) || this.measure.isOn || this.zones.isOn; }

  /** Whether something is being drawn. */
  get isHeld() { return this.drawing !== undefined || this.measure.isHeld || this.zones.isHeld; }

  /** Switches all tools off but one. */
  switchOffAllBut(/** @type {unknown} */ tool) {
    for (const other of this.poses) if (tool !== other && other.isOn) other.toggle();
    if (tool !== this.measure && this.measure.isOn) this.measure.toggle(false);
    if (tool !== this.zones && this.zones.isOn) this.zones.toggle(false);
  }

  /** Begins to draw; returns false if no tool is on. */
  press(/** @type {Point} */ at) { return this.measure.press(at) || this.zones.press(at) || this.poses.some((tool) => tool.press(at)); }

  move(/** @type {Point} */ to) {
    if (this.measure.isHeld) this.measure.move(to);
    else if (this.zones.isHeld) this.zones.move(to);
    else if (this.drawing?.drawn) {
      const [from, end] = [this.camera.toScreen(this.drawing.drawn.from), this.camera.toScreen(to)];
      this.drawing.move(to, Math.hypot(end.x - from.x, end.y - from.y));
    }
  }

  /** Ends what is being drawn: sends the goal, the pose or the zone, keeps the line. */
  release() {
    if (this.measure.isHeld) this.measure.release();
    else if (this.zones.isHeld) this.zones.release();
    else this.drawing?.release();
  }

  /** Ends what is being drawn, at a place outside of the map. Returns what is not sent because of that, for the operator; null if nothing was to be. */
  releaseOutside() {
    const what = this.goals.drawn ? "goal" : this.setPose.drawn ? "pose" : this.zones.isHeld ? "zone" : null;
    this.cancel();
    return what && `the ${what} was not sent: its drag ended outside of the map`;
  }

  /** Gives up what is being drawn. */
  cancel() {
    this.poses.forEach((tool) => tool.cancelDrawing());
    this.measure.release();
    this.zones.cancel();
  }
}
