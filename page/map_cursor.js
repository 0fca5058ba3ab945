// The cursor on the map: with it the keyboard alone sets goals, measures and draws zones.

/** @typedef {import("./geometry.js").Point} Point */

/** Steps of the arrow keys: east and north, in steps. @type {Record<string, [number, number]>} */
const ARROWS = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
/** A step, and one with Shift, metres. */
const STEP_M = 0.1;
const LONG_STEP_M = 1;
/** Half the cursor's width, pixels. */
const ARM_PX = 12;

export class MapCursor {
  /** @param {import("./map_tools.js").MapTools} tools @param {(at: Point) => void} reveal shows a point that is off the screen */
  constructor(tools, reveal) {
    this.tools = tools;
    this.reveal = reveal;
    /** Where it is in the map, metres; null until a key has moved it. @type {Point | null} */
    this.at = null;
  }

  /** Puts it away, until a key moves it again. */
  hide() { this.at = null; }

  /**
   * Takes a key while the map has the focus; returns whether it was for the cursor.
   * @param {string} code @param {boolean} isLong whether Shift is held @param {boolean} isRepeat whether the key is held down since before
   */
  key(code, isLong, isRepeat = false) {
    if (!this.tools.isOn) return false;
    // Enter that is held would begin a goal and end it at once.
    if (isRepeat && !(code in ARROWS)) return true;
    const at = this.at ?? { ...this.tools.camera.center };
    if (code in ARROWS) {
      const [east, north] = ARROWS[code];
      const step = isLong ? LONG_STEP_M : STEP_M;
      this.moveTo({ x: at.x + east * step, y: at.y + north * step });
    } else if (code === "Enter" || code === "NumpadEnter") {
      this.at = at;
      if (this.tools.isHeld) this.tools.release();
      else this.tools.press(at);
    } else if (code === "Backspace" || code === "Delete") {
      this.tools.cancel();
    } else {
      return false;
    }
    return true;
  }

  /** @param {Point} at */
  moveTo(at) {
    this.at = at;
    this.tools.move(at);
    const { camera } = this.tools;
    const { x, y } = camera.toScreen(at);
    if (x < 0 || y < 0 || x > camera.width || y > camera.height) this.reveal(at);
  }

  /** Returns where it is and what the keys do, or an empty text while it is away. */
  describe() {
    if (!this.at || !this.tools.isOn) return "";
    const place = `${this.at.x.toFixed(1)} m, ${this.at.y.toFixed(1)} m`;
    return this.tools.isHeld ? `${place}: arrows draw, Enter ends, Backspace gives up` : `${place}: arrows move, with Shift far, Enter begins`;
  }

  /** @param {CanvasRenderingContext2D} context @param {import("./geometry.js").Camera} camera @param {{text: string}} colours */
  draw(context, camera, { text }) {
    if (!this.at || !this.tools.isOn) return;
    const { x, y } = camera.toScreen(this.at);
    context.strokeStyle = text;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(x - ARM_PX, y);
    context.lineTo(x + ARM_PX, y);
    context.moveTo(x, y - ARM_PX);
    context.lineTo(x, y + ARM_PX);
    context.stroke();
  }
}
