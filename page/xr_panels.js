// The panels of mixed reality: drawn on a canvas, shown as a texture, with buttons that a ray presses.

import { distance, facing, multiply, planeHit, scaling, translation } from "./matrix.js";
import { FLEET_ROWS, ROBOT_ROWS } from "./panels.js";
import { STALE_S } from "./state.js";
import { shapePath } from "./view.js";

/** @typedef {import("./matrix.js").Matrix} Matrix */
/** @typedef {import("./renderer.js").Renderer} Renderer */
/** @typedef {import("./state.js").Fleet} Fleet */
/** @typedef {import("./state.js").Robot} Robot */
/** @typedef {[number, number, number]} Vector */
/** @typedef {{x: number, y: number, width: number, height: number, press: () => void, text?: string}} Button in pixels of the panel */

/** Pixels of a metre of a panel: a line of text is then legible from two metres. */
const PIXELS_PER_M = 1000;
/** Items of attention on the fleet's panel. */
const ITEMS_MAX = 3;
/** Buttons in a row of the fleet's panel, and rows. */
const COMMANDS_IN_ROW = 3;
const COMMAND_ROWS = 3;
/** From one row of buttons to the next, pixels. */
const COMMAND_ROW_PX = 68;
const FONT = "system-ui, sans-serif";
const DARK = { surface: "rgba(16,22,30,0.9)", raised: "#243040", line: "#4a5e76", text: "#f2f6fa", muted: "#a9b8c8", danger: "#d92d3a", warning: "#ffc857", good: "#5fd38d", accent: "#6cb6f5", ink: "#10151c" };

/** A rectangle in the room with a canvas on it. */
export class Panel {
  /** @param {Renderer} renderer @param {number} width pixels @param {number} height pixels */
  constructor(renderer, width, height) {
    this.renderer = renderer;
    this.canvas = document.createElement("canvas");
    this.texture = renderer.createTexture(renderer.gl.TEXTURE_2D, renderer.gl.LINEAR_MIPMAP_LINEAR, renderer.gl.LINEAR);
    /** Of its middle; it faces its own z axis. @type {Matrix | null} */
    this.matrix = null;
    /** @type {Button[]} */
    this.buttons = [];
    this.shown = "";
    /** How much larger it is than its pixels say, so that it is legible from far away. */
    this.zoom = 1;
    this.resize(width, height);
  }

  /** @param {number} width @param {number} height */
  resize(width, height) {
    this.canvas.width = width;
    this.canvas.height = height;
    this.shown = "";
  }

  get width() { return (this.canvas.width / PIXELS_PER_M) * this.zoom; }
  get height() { return (this.canvas.height / PIXELS_PER_M) * this.zoom; }

  /** Gives its texture back. */
  dispose() {
    this.matrix = null;
    this.renderer.gl.deleteTexture(this.texture);
  }

  /** Paints the panel if what it shows has changed. @param {string} content all that it shows @param {(context: CanvasRenderingContext2D) => void} paint */
  update(content, paint) {
    if (content === this.shown) return;
    this.shown = content;
    this.buttons = [];
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    context.textBaseline = "middle";
    context.textAlign = "left";
    box(context, 2, 2, this.canvas.width - 4, this.canvas.height - 4, 18, DARK.surface, DARK.line);
    paint(context);
    const { gl } = this.renderer;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, true);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, this.canvas);
    gl.generateMipmap(gl.TEXTURE_2D);
  }

  draw() {
    if (!this.matrix) return;
    // The canvas's first row is its upper edge.
    const corner = multiply(this.matrix, translation(-this.width / 2, this.height / 2, 0));
    this.renderer.drawImage(this.texture, multiply(corner, scaling(this.width, -this.height, 1)), { ignoresDepth: true });
  }

  /** Returns where a ray meets the panel, in pixels. @param {Vector} origin @param {Vector} direction */
  hit(origin, direction) {
    const hit = this.matrix && planeHit(this.matrix, origin, direction);
    if (!hit || Math.abs(hit.x) > this.width / 2 || Math.abs(hit.y) > this.height / 2) return null;
    const scale = PIXELS_PER_M / this.zoom;
    return { x: (hit.x + this.width / 2) * scale, y: (this.height / 2 - hit.y) * scale, distance: hit.distance };
  }

  /** Returns the middle of a button in the panel's frame, metres. @param {Button} button @returns {Vector} */
  placeOf({ x, y, width, height }) {
    const metres = this.zoom / PIXELS_PER_M;
    return [(x + width / 2) * metres - this.width / 2, this.height / 2 - (y + height / 2) * metres, 0];
  }

  /** Returns the button at a pixel. @param {{x: number, y: number}} at */
  buttonAt({ x, y }) {
    return this.buttons.find((button) => x >= button.x && x <= button.x + button.width && y >= button.y && y <= button.y + button.height);
  }
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {number} width @param {number} height @param {number} radius @param {string} fill @param {string} [line] */
function box(context, x, y, width, height, radius, fill, line) {
  context.beginPath();
  context.roundRect(x, y, width, height, radius);
  context.fillStyle = fill;
  context.fill();
  if (!line) return;
  context.strokeStyle = line;
  context.lineWidth = 3;
  context.stroke();
}

/** @param {CanvasRenderingContext2D} context @param {string} text @param {number} x @param {number} y @param {string} font @param {string} colour @param {number} [widthMax] */
function write(context, text, x, y, font, colour, widthMax) {
  context.font = `${font} ${FONT}`;
  context.fillStyle = colour;
  context.fillText(text, x, y, widthMax);
}

/** Draws a robot's shape and number. @param {CanvasRenderingContext2D} context @param {Robot} robot @param {number} x @param {number} y @param {number} radius */
function icon(context, robot, x, y, radius) {
  context.save();
  context.translate(x, y);
  context.rotate(-Math.PI / 2);
  context.fillStyle = robot.colour;
  shapePath(context, robot.corners, radius);
  context.fill();
  context.restore();
  context.textAlign = "center";
  write(context, String(robot.number), x, y + 2, `bold ${Math.round(radius * 1.15)}px`, DARK.ink);
  context.textAlign = "left";
}

/** Returns what a robot does, and its colour. @param {Robot} robot @param {number} now */
function stateOf(robot, now) {
  const age = robot.scanAge(now);
  if (age === null) return ["no data", DARK.warning];
  if (age > STALE_S) return [`stale, ${age.toFixed(0)} s`, DARK.warning];
  const slam = robot.figures.slam ?? "–";
  return [slam, slam === "tracking" ? DARK.good : DARK.warning];
}

/** Returns the rows of a robot's panel that it has: heading and text. @param {Robot} robot @param {number} now @returns {[string, string][]} */
export function rowsOf(robot, now) {
  return ROBOT_ROWS.flatMap(([heading, , value]) => {
    const text = value(robot, now);
    return text === null ? [] : /** @type {[string, string][]} */ ([[heading, text]]);
  });
}

/** Sizes of a robot's panel, pixels. */
const SMALL = { width: 300, height: 84 };
const LARGE = { width: 560, height: 490 };
/** A panel expands when the viewer is so near, metres, or looks at it for so long, seconds. */
const NEAR_M = 0.8;
const GAZE_S = 0.4;
/** Beyond this distance a panel grows, metres, up to so many times its size. */
const LEGIBLE_M = 1.6;
const ZOOM_MAX = 2.5;
/** Height of a panel's lower edge above the floor at a life-size robot, metres. */
const ABOVE_M = 0.3;

/** The panel above a robot: small, and large when the viewer comes near or looks at it. */
export class RobotPanel extends Panel {
  /** @param {Renderer} renderer */
  constructor(renderer) {
    super(renderer, SMALL.width, SMALL.height);
    this.isLarge = false;
    /** Since when the viewer looks at it, seconds. @type {number | null} */
    this.gazedSince = null;
  }

  /**
   * Puts the panel above the robot, and expands it. @param {Vector} robotAt in the room @param {Vector} eye
   * @param {Vector | null} gaze direction of the view, or null if it looks at something before the panel @param {number} now @param {number} scale of the map
   */
  place(robotAt, eye, gaze, now, scale) {
    this.zoom = Math.min(ZOOM_MAX, Math.max(1, distance(robotAt, eye) / LEGIBLE_M));
    const at = /** @type {Vector} */ ([robotAt[0], robotAt[1] + ABOVE_M * Math.max(0.25, scale) + this.height / 2, robotAt[2]]);
    this.matrix = facing(at, eye);
    if (gaze && this.hit(eye, gaze)) this.gazedSince ??= now;
    else this.gazedSince = null;
    const isNear = Math.hypot(at[0] - eye[0], at[2] - eye[2]) < NEAR_M;
    const isLarge = isNear || (this.gazedSince !== null && now - this.gazedSince >= GAZE_S);
    if (isLarge === this.isLarge) return;
    this.isLarge = isLarge;
    const { width, height } = isLarge ? LARGE : SMALL;
    this.resize(width, height);
  }

  /** @param {Robot} robot @param {boolean} isSelected @param {number} now @param {() => void} select */
  show(robot, isSelected, now, select) {
    const rows = this.isLarge ? rowsOf(robot, now) : [];
    const [state, colour] = stateOf(robot, now);
    this.update(JSON.stringify([state, isSelected, robot.figures.driver, rows]), (context) => {
      const { width, height } = this.canvas;
      if (isSelected) box(context, 3, 3, width - 6, height - 6, 17, DARK.surface, "#ffffff");
      icon(context, robot, 46, 44, 27);
      write(context, robot.name, 90, 32, "600 27px", DARK.text, width - 104);
      write(context, state, 90, 61, "20px", colour, width - 104);
      rows.forEach(([heading, value], i) => {
        const y = 112 + i * ((LARGE.height - 130) / Math.max(1, rows.length - 1));
        write(context, heading, 26, y, "21px", DARK.muted);
        write(context, value, 210, y, "21px", DARK.text, width - 230);
      });
      this.buttons.push({ x: 0, y: 0, width, height, press: select });
    });
  }
}

/** A button of the fleet's panel. @typedef {{text: string, press: () => void, isDanger?: boolean, isOn?: boolean}} Command */

/** The fleet's panel: figures, the mapped area over time, what needs attention, and the commands. */
export class FleetPanel extends Panel {
  /** @param {Renderer} renderer */
  constructor(renderer) { super(renderer, 720, 524 + COMMAND_ROWS * COMMAND_ROW_PX); }

  /**
   * @param {Fleet} fleet @param {number} now @param {{text: string, isGood: boolean}} link
   * @param {ReturnType<Fleet["attention"]>} items @param {(Command | null)[]} commands @param {(robot: number) => void} select
   */
  show(fleet, now, link, items, commands, select) {
    const rows = FLEET_ROWS.map(([heading, value]) => [heading, value(fleet, now)]);
    const shown = items.slice(0, ITEMS_MAX);
    const content = [link, rows, shown, commands.map((command) => command && [command.text, command.isOn]), fleet.area.at(-1)?.at];
    this.update(JSON.stringify(content), (context) => {
      const { width, height } = this.canvas;
      write(context, "MR-SLAM", 28, 40, "bold 32px", DARK.text);
      context.textAlign = "right";
      write(context, link.text, width - 28, 42, "600 25px", link.isGood ? DARK.good : DARK.warning, width - 230);
      context.textAlign = "left";
      rows.forEach(([heading, value], i) => {
        write(context, heading, 28, 90 + i * 33, "23px", DARK.muted);
        write(context, value, 240, 90 + i * 33, "23px", DARK.text, width - 260);
      });
      plot(context, fleet.area, { x: 28, y: 248, width: width - 56, height: 82 });
      write(context, "Attention", 28, 356, "600 22px", DARK.muted);
      if (shown.length === 0) write(context, "nothing", 150, 356, "22px", DARK.muted);
      shown.forEach((item, i) => this.paintItem(context, item, fleet, 374 + i * 44, select));
      const space = (width - 56 + 12) / COMMANDS_IN_ROW;
      commands.forEach((command, i) => {
        if (!command) return;
        const [row, column] = [Math.floor(i / COMMANDS_IN_ROW), i % COMMANDS_IN_ROW];
        this.paintCommand(context, command, 28 + column * space, height - 12 - (COMMAND_ROWS - row) * COMMAND_ROW_PX, space - 12);
      });
    });
  }

  /** @param {CanvasRenderingContext2D} context @param {{robot: number | null, text: string}} item @param {Fleet} fleet @param {number} y @param {(robot: number) => void} select */
  paintItem(context, { robot, text }, fleet, y, select) {
    const width = this.canvas.width - 56;
    box(context, 28, y, width, 40, 6, DARK.raised);
    context.fillStyle = DARK.warning;
    context.fillRect(28, y, 6, 40);
    const name = robot === null ? "" : `${robot} · ${fleet.robots.get(robot)?.name ?? ""}: `;
    write(context, name + text, 46, y + 21, "22px", DARK.text, width - 30);
    if (robot !== null) this.buttons.push({ x: 28, y, width, height: 40, press: () => select(robot) });
  }

  /** @param {CanvasRenderingContext2D} context @param {Command} command @param {number} x @param {number} y @param {number} width */
  paintCommand(context, { text, press, isDanger, isOn }, x, y, width) {
    box(context, x, y, width, 60, 10, isDanger ? DARK.danger : DARK.raised, isOn ? DARK.accent : DARK.line);
    context.textAlign = "center";
    write(context, text, x + width / 2, y + 31, "600 22px", DARK.text, width - 12);
    context.textAlign = "left";
    this.buttons.push({ x, y, width, height: 60, press, text });
  }
}

/** Plots the mapped area over time. @param {CanvasRenderingContext2D} context @param {{at: number, m2: number}[]} points @param {{x: number, y: number, width: number, height: number}} frame */
function plot(context, points, { x, y, width, height }) {
  context.strokeStyle = DARK.line;
  context.lineWidth = 2;
  context.strokeRect(x, y, width, height);
  if (points.length === 0) return;
  const [first, last] = [points[0], points[points.length - 1]];
  const most = Math.max(1, ...points.map((point) => point.m2));
  const span = Math.max(10, last.at - first.at);
  context.strokeStyle = DARK.accent;
  context.lineWidth = 3;
  context.beginPath();
  for (const { at, m2 } of points) {
    context.lineTo(x + 3 + ((at - first.at) / span) * (width - 6), y + height - 4 - (m2 / most) * (height - 30));
  }
  context.stroke();
  write(context, `${most.toFixed(0)} m²`, x + 8, y + 16, "18px", DARK.muted);
  context.textAlign = "right";
  write(context, `${span.toFixed(0)} s`, x + width - 8, y + height - 14, "18px", DARK.muted);
  context.textAlign = "left";
}
