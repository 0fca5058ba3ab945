// The panels beside the map: robots, fleet, attention, messages.

import { describeBattery } from "./battery.js";
import { format, percent } from "./format.js";
import { describeNavigation } from "./goals.js";
import { STALE_S } from "./state.js";
import { shapePath } from "./view.js";

/** @typedef {import("./state.js").Fleet} Fleet */
/** @typedef {import("./state.js").Robot} Robot */

/** @typedef {ReturnType<Fleet["attention"]>[number]} Item */

/** Messages that are kept. */
const LOG_MAX = 30;
/** Items of attention that are shown. */
const ITEMS_MAX = 8;

/** Returns an element of the page. @returns {HTMLElement} */
export function element(/** @type {string} */ id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found;
}

/** Sets a text if it differs, so that screen readers and selections are left alone. */
export function setText(/** @type {Element} */ of, /** @type {string} */ text) {
  if (of.textContent !== text) of.textContent = text;
}

/** @param {string} name @param {string} [className] @param {string} [text] */
function create(name, className = "", text = "") {
  const made = document.createElement(name);
  made.className = className;
  made.textContent = text;
  return made;
}

/** Rows of a robot's panel: heading, whether it is wide, and the text; null hides the row. @type {[string, boolean, (robot: Robot, now: number) => string | null][]} */
export const ROBOT_ROWS = [
  ["Driver", true, ({ figures }) => (figures.is_mine ? "you" : figures.driver ?? "nobody")],
  ["Goal", true, (robot) => describeNavigation(robot)],
  ["Battery", true, ({ figures }) => describeBattery(figures.battery)],
  ["Scans", false, ({ figures }) => format(figures.scan_hz, 1, " Hz")],
  ["Lost", false, ({ figures }) => format(figures.scans_lost)],
  ["Counted", false, ({ figures }) => format(figures.counted_s, 0, " s")],
  ["Age", false, (robot, now) => format(robot.scanAge(now), 2, " s")],
  ["Map age", false, ({ figures }) => format(figures.maps_age_s, 1, " s")],
  ["Known", false, ({ figures }) => format(figures.known_m2, 1, " m²")],
  ["Cover", false, ({ figures }) => percent(figures.coverage)],
  ["Map", false, ({ figures }) => figures.map_cells?.join(" × ") ?? "–"],
  ["σ x, y", false, ({ deviation }) => (deviation ? `${(Math.max(deviation.x, deviation.y) * 100).toFixed(1)} cm` : "–")],
  ["σ yaw", false, ({ deviation }) => (deviation ? `${(deviation.yaw * 180 / Math.PI).toFixed(2)}°` : "–")],
  ["To pose", false, ({ figures }) => format(figures.scan_to_pose_ms?.[0], 1, " ms")],
  ["To map", false, ({ figures }) => format(figures.scan_to_map_ms?.[0], 0, " ms")],
  ["To screen", false, (robot) => format(robot.toScreenMs(), 0, " ms")],
  ["Closures", false, ({ figures }) => format(figures.closures)],
  ["Map age", false, ({ figures }) => format(figures.map_age_s, 1, " s")],
  ["Merged", false, ({ figures }) => (figures.is_merged === undefined || figures.is_merged === null ? "–" : figures.is_merged ? "yes" : "no")],
];

/** The panel of each robot, which is also the button that selects it. */
export class RobotPanels {
  /** @param {(number: number) => void} onSelect */
  constructor(onSelect) {
    this.onSelect = onSelect;
    /** @type {Map<number, {item: HTMLElement, button: HTMLElement, state: HTMLElement, values: HTMLElement[], rows: HTMLElement}>} */
    this.panels = new Map();
  }

  /** @param {Robot} robot */
  add(robot) {
    const button = create("button", "robot");
    button.setAttribute("type", "button");
    const icon = document.createElement("canvas");
    drawIcon(icon, robot);
    const state = create("span", "badge");
    const rows = create("dl", "rows");
    const values = ROBOT_ROWS.map(([heading, isWide]) => {
      const value = create("dd", isWide ? "wide" : "");
      rows.append(create("dt", "", heading), value);
      return value;
    });
    const name = create("span", "name", `${robot.number} · ${robot.name}`);
    button.append(icon, name, state, rows);
    button.addEventListener("click", () => this.onSelect(robot.number));
    const item = create("li");
    item.append(button);
    const next = Math.min(...[...this.panels.keys()].filter((number) => number > robot.number));
    element("robots").insertBefore(item, this.panels.get(next)?.item ?? null);
    this.panels.set(robot.number, { item, button, state, values, rows });
  }

  /** Removes the panel of a robot that the fleet no longer has. @param {Robot} robot */
  remove({ number }) {
    this.panels.get(number)?.item.remove();
    this.panels.delete(number);
  }

  /** @param {Fleet} fleet @param {number | null} selected @param {number} now */
  update(fleet, selected, now) {
    for (const robot of fleet.robots.values()) {
      const panel = this.panels.get(robot.number);
      if (!panel) continue;
      panel.button.setAttribute("aria-pressed", String(robot.number === selected));
      const age = robot.scanAge(now);
      const isStale = age === null || age > STALE_S;
      panel.rows.classList.toggle("stale", isStale);
      const text = age === null ? "no data" : isStale ? `stale, ${age.toFixed(0)} s` : robot.figures.slam ?? "–";
      setText(panel.state, text);
      panel.state.classList.toggle("good", !isStale && robot.figures.slam === "tracking");
      panel.state.classList.toggle("bad", isStale || !["tracking", undefined, null].includes(robot.figures.slam));
      ROBOT_ROWS.forEach(([, , value], i) => {
        const text = value(robot, now);
        const [shown, heading] = [panel.values[i], /** @type {HTMLElement} */ (panel.values[i].previousElementSibling)];
        shown.hidden = heading.hidden = text === null;
        setText(shown, text ?? "");
      });
      panel.values[0].classList.toggle("mine", robot.figures.is_mine === true);
    }
  }
}

/** @param {HTMLCanvasElement} canvas @param {Robot} robot */
function drawIcon(canvas, robot) {
  canvas.width = canvas.height = 68;
  canvas.setAttribute("aria-hidden", "true");
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.translate(34, 34);
  context.rotate(-Math.PI / 2);
  context.fillStyle = robot.colour;
  shapePath(context, robot.corners, 22);
  context.fill();
  context.rotate(Math.PI / 2);
  context.fillStyle = "#10151c";
  context.font = "bold 24px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(String(robot.number), 0, 2);
}

/** Rows of the fleet's panel. @type {[string, (fleet: Fleet, now: number) => string][]} */
export const FLEET_ROWS = [
  ["Mapped", ({ figures }) => `${format(figures.merged_known_m2, 1, " m²")}${typeof figures.room_coverage === "number" ? `, ${percent(figures.room_coverage)} of the room` : ""}`],
  ["Map", ({ map }) => (map ? `${map.width} × ${map.height} cells of ${(map.resolution * 100).toFixed(0)} cm` : "–")],
  ["Map changed", (fleet, now) => format(fleet.merged.at === null ? null : now - fleet.merged.at, 1, " s ago")],
  ["Maps agree", ({ figures }) => `${percent(figures.consistency, 1)}${typeof figures.null_consistency === "number" ? `, by chance ${percent(figures.null_consistency, 1)}` : ""}`],
  ["Overlapping pairs", ({ figures }) => format(figures.overlapping_pairs)],
];

/** The figures of the fleet, and the plot of the mapped area. */
export class FleetPanel {
  constructor() {
    const list = element("fleet");
    this.values = FLEET_ROWS.map(([heading]) => {
      const value = create("dd");
      list.append(create("dt", "", heading), value);
      return value;
    });
    this.drawn = 0;
  }

  /** @param {Fleet} fleet @param {number} now */
  update(fleet, now) {
    FLEET_ROWS.forEach(([, value], i) => setText(this.values[i], value(fleet, now)));
    const newest = fleet.area.at(-1)?.at ?? 0;
    if (newest !== this.drawn) {
      this.drawn = newest;
      plot(/** @type {HTMLCanvasElement} */ (element("area")), fleet.area);
    }
  }
}

/** Plots the mapped area over time. @param {HTMLCanvasElement} canvas @param {{at: number, m2: number}[]} points */
function plot(canvas, points) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.scale(ratio, ratio);
  const colour = (/** @type {string} */ name) => getComputedStyle(canvas).getPropertyValue(name).trim();
  const [first, last] = [points[0], points[points.length - 1]];
  const most = Math.max(1, ...points.map((point) => point.m2));
  if (points.length === 0) return;
  const span = Math.max(10, last.at - first.at);
  context.strokeStyle = colour("--line");
  context.strokeRect(0.5, 0.5, width - 1, height - 1);
  context.fillStyle = colour("--muted");
  context.font = "11px system-ui, sans-serif";
  context.fillText(`${most.toFixed(0)} m²`, 5, 13);
  context.textAlign = "right";
  context.fillText(`${span.toFixed(0)} s`, width - 5, height - 5);
  context.strokeStyle = colour("--accent");
  context.lineWidth = 2;
  context.beginPath();
  for (const { at, m2 } of points) {
    context.lineTo(2 + ((at - first.at) / span) * (width - 4), height - 3 - (m2 / most) * (height - 20));
  }
  context.stroke();
}

/** The list of what needs the operator's attention. */
export class AttentionList {
  /** @param {(robot: number) => void} onGoTo */
  constructor(onGoTo) {
    this.onGoTo = onGoTo;
    this.shown = "";
    /** Items that the operator has acknowledged; an item that ends and comes again is shown again. @type {Set<string>} */
    this.acknowledged = new Set();
  }

  /** Begins anew with another run: nothing of it was acknowledged. */
  clear() {
    this.shown = "";
    this.acknowledged.clear();
  }

  /** @param {ReturnType<Fleet["attention"]>} items @param {Fleet} fleet */
  update(items, fleet) {
    const present = new Set(items.map(({ key }) => key));
    for (const key of this.acknowledged) if (!present.has(key)) this.acknowledged.delete(key);
    items = items.filter((item) => !this.acknowledged.has(item.key));
    const rows = items.slice(0, ITEMS_MAX);
    const shown = JSON.stringify([rows.map(({ key }) => key), this.acknowledged.size]);
    const list = element("items");
    if (shown === this.shown) {
      // Numbers alone have changed: the buttons stay, and with them the focus and a click that is under way.
      rows.forEach((item, i) => this.rename(list.children[i], titleOf(item, fleet)));
      return;
    }
    this.shown = shown;
    const active = document.activeElement;
    const focused = active instanceof HTMLElement && list.contains(active) ? active.dataset.key ?? "" : null;
    list.replaceChildren();
    if (items.length === 0) list.append(create("li", "calm", this.acknowledged.size === 0 ? "nothing" : `nothing new, ${this.acknowledged.size} acknowledged`));
    for (const item of rows) list.append(this.row(item, fleet));
    if (focused === null) return;
    // Never another item's first button: that would select its robot.
    const buttons = [...list.querySelectorAll("button")];
    (buttons.find((button) => button.dataset.key === focused) ?? buttons.find((button) => button.className === "acknowledge"))?.focus();
  }

  /** @param {Element} row @param {string} title */
  rename(row, title) {
    const [goTo, acknowledge] = row.children;
    setText(/** @type {HTMLElement} */ (goTo ?? row), title);
    acknowledge?.setAttribute("aria-label", `Acknowledge: ${title}`);
  }

  /** Returns the row of an item: about a robot a button that goes there, and one that acknowledges. @param {Item} item @param {Fleet} fleet */
  row({ robot, text, key }, fleet) {
    const row = create("li");
    if (robot === null) {
      row.textContent = text;
      return row;
    }
    const title = titleOf({ robot, text }, fleet);
    const [goTo, acknowledge] = [create("button", "", title), create("button", "acknowledge", "✓")];
    goTo.dataset.key = `go ${key}`;
    acknowledge.dataset.key = `acknowledge ${key}`;
    acknowledge.setAttribute("aria-label", `Acknowledge: ${title}`);
    acknowledge.title = "Acknowledge: hide this until it comes again";
    [goTo, acknowledge].forEach((button) => button.setAttribute("type", "button"));
    goTo.addEventListener("click", () => this.onGoTo(robot));
    acknowledge.addEventListener("click", () => this.acknowledged.add(key));
    row.append(goTo, acknowledge);
    return row;
  }
}

/** Returns what an item of attention says. @param {{robot: number | null, text: string}} item @param {Fleet} fleet */
function titleOf({ robot, text }, fleet) {
  return robot === null ? text : `${robot} · ${fleet.robots.get(robot)?.name ?? ""}: ${text}`;
}

/** Adds a message to the log. */
export function logMessage(/** @type {string} */ text, isError = false) {
  const list = element("log");
  const item = create("li", isError ? "error" : "");
  item.append(create("time", "", new Date().toLocaleTimeString()), document.createTextNode(text));
  list.prepend(item);
  while (list.children.length > LOG_MAX) list.lastElementChild?.remove();
}
