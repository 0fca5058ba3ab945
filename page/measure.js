// The tool that measures distances on the map.

/** @typedef {import("./geometry.js").Point} Point */

/** A distance that the operator measures between two points of the map, metres. */
export class MeasureTool {
  /** @param {(isOn: boolean) => void} show */
  constructor(show) {
    this.show = show;
    this.isOn = false;
    this.isHeld = false;
    /** @type {{from: Point, to: Point} | null} */
    this.line = null;
    /** The frame of the map in which it is drawn, as the fleet counts them. */
    this.frame = 1;
  }

  /** Forgets a distance that was measured in another frame of the map. */
  followFrame(/** @type {number} */ frame) {
    if (frame !== this.frame) [this.line, this.isHeld] = [null, false];
    this.frame = frame;
  }

  /** Switches the tool on or off; without it there is no line. */
  toggle(isOn = !this.isOn) {
    this.isOn = isOn;
    this.isHeld = false;
    this.line = null;
    this.show(isOn);
  }

  /** Begins a line; returns false if the tool is off. */
  press(/** @type {Point} */ at) {
    if (!this.isOn) return false;
    this.line = { from: at, to: at };
    this.isHeld = true;
    return true;
  }

  move(/** @type {Point} */ to) {
    if (this.line && this.isHeld) this.line.to = to;
  }

  release() { this.isHeld = false; }

  /** Returns the length of the line, metres, or null. */
  length() { return this.line ? Math.hypot(this.line.to.x - this.line.from.x, this.line.to.y - this.line.from.y) : null; }

  /** @param {CanvasRenderingContext2D} context @param {import("./geometry.js").Camera} camera @param {{text: string, background: string}} colours */
  draw(context, camera, colours) {
    const length = this.length();
    if (!this.line || length === null) return;
    const [from, to] = [camera.toScreen(this.line.from), camera.toScreen(this.line.to)];
    context.save();
    context.strokeStyle = context.fillStyle = colours.text;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(from.x, from.y);
    context.lineTo(to.x, to.y);
    context.stroke();
    for (const end of [from, to]) {
      context.beginPath();
      context.arc(end.x, end.y, 4, 0, 2 * Math.PI);
      context.fill();
    }
    const text = `${length.toFixed(2)} m`;
    context.font = "bold 14px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    const [x, y, width] = [(from.x + to.x) / 2, (from.y + to.y) / 2 - 16, context.measureText(text).width + 12];
    context.fillStyle = colours.background;
    context.fillRect(x - width / 2, y - 11, width, 22);
    context.fillStyle = colours.text;
    context.fillText(text, x, y + 1);
    context.restore();
  }
}
