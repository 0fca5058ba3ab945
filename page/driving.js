// Driving by hand: what the operator holds, and the velocities that are sent for it.

import { DeadMan } from "./dead_man.js";
import { Driver, gamepadDeflection, isDriveKey, keyDeflection, stickDeflection } from "./input.js";
import { writeTwist } from "./messages.js";
import { PRIMARY_BUTTON, PRIMARY_BUTTONS } from "./pointers.js";

/** @typedef {import("./dead_man.js").Situation} Situation */
/** @typedef {import("./input.js").Deflection} Deflection */

/** The knob of the stick moves so far, in radii of the stick. */
const KNOB_SHARE = 0.62;
/** Velocities for which a takeover may take until the bridge's figures name the new driver: 2 s at 20 Hz; they come once a second. */
const TAKEOVER_TICKS = 40;

/** What driving needs of the page. @typedef {object} Surroundings
 * @property {import("./state.js").Fleet} fleet
 * @property {() => number | null} selected number of the selected robot
 * @property {() => Situation} situation
 * @property {() => Deflection | null | undefined} headset what the headset's controllers say; undefined while they are not heard
 * @property {(topic: string, type: string, payload: Uint8Array) => boolean} publish returns whether it was sent
 */

/** The keys, the stick, the gamepad and the headset of this page, and the robot that they drive. */
export class Driving {
  /** @param {Surroundings} of */
  constructor(of) {
    this.of = of;
    this.deadMan = new DeadMan();
    this.driver = new Driver();
    /** Velocities for which somebody else may still be named as the driver of a robot that was taken over. */
    this.takeoverTicks = 0;
    /** Codes of the keys that are held. @type {Set<string>} */
    this.keys = new Set();
    /** @type {Deflection | null} */
    this.stick = null;
    /** What the devices said last. @type {import("./dead_man.js").Deflections} */
    this.deflections = { headset: undefined, stick: null, keys: null, gamepad: undefined };
    /** The gamepads that are there, and which one is held, as they were last. */
    this.pads = { all: "", held: "" };
  }

  /** Looks at the situation and the devices. Call it at each change of either. Returns what the devices say. */
  observe() {
    this.deflections = { headset: this.of.headset(), stick: this.stick, keys: keyDeflection(this.keys), gamepad: this.gamepad() };
    this.deadMan.observe(this.situation(), this.deflections);
    return this.deflections;
  }

  /**
   * Returns what the gamepads say: the first one that is held. Undefined without one, and while another window hears them.
   * Where the browser does not know a gamepad's buttons, nobody knows which one is the dead man's switch: it drives nothing.
   * @returns {Deflection | null | undefined}
   */
  gamepad() {
    const pads = document.hasFocus() ? [...navigator.getGamepads()].filter((pad) => pad?.mapping === "standard") : [];
    const nameOf = (/** @type {Gamepad | null | undefined} */ pad) => (pad ? `${pad.index} ${pad.id}` : "");
    const held = pads.find((pad) => gamepadDeflection(pad) !== null);
    const [before, now] = [this.pads, { all: pads.map(nameOf).join("\n"), held: nameOf(held) }];
    this.pads = now;
    // One that has come may be held since before; and one that another takes over from has not come to rest.
    if (pads.length === 0 || now.all !== before.all || (now.held !== before.held && now.held && before.held)) this.deadMan.lock("gamepad");
    if (pads.length === 0) return undefined;
    return held ? gamepadDeflection(held) : null;
  }

  /** Returns the situation as the bridge will say it after a takeover that is under way. @returns {Situation} */
  situation() {
    const situation = this.of.situation();
    const { robot, driver } = this.deadMan.situation;
    // A takeover is over when the bridge names this operator anew: that it did so before may be what it said before somebody else took it.
    if (situation.robot !== robot || (situation.driver === "me" && driver !== "me")) this.takeoverTicks = 0;
    return this.takeoverTicks > 0 && situation.driver === "other" ? { ...situation, driver: null } : situation;
  }

  /** Takes that the operator takes the selected robot over: what is pressed from now on drives it, also where its driver is not known yet. */
  takeOver() {
    this.observe();
    this.takeoverTicks = TAKEOVER_TICKS;
    this.observe();
  }

  /** Takes that the bridge has refused something. */
  refuse() {
    this.takeoverTicks = 0;
    this.deadMan.refuse();
    this.observe();
  }

  /** Whether the operator holds a key or the stick to drive. */
  get isHeld() { return this.stick !== null || [...this.keys].some(isDriveKey); }

  /** Whether somebody else drives the selected robot, and something is held. */
  get isRefused() { return this.deadMan.isRefused && Object.values(this.deflections).some((held) => held); }

  /** Whether something is held that drives only after it was let go. */
  get isWaiting() { return this.deadMan.isWaiting(this.deflections); }

  /** Sends the velocities that are due. Returns that of the selected robot as it was sent, m/s and rad/s. */
  tick() {
    const { fleet, selected, publish } = this.of;
    const deflection = this.deadMan.pass(this.observe());
    this.takeoverTicks = Math.max(0, this.takeoverTicks - 1);
    let sent = { linear: 0, angular: 0 };
    for (const { robot: number, forward, left } of this.driver.tick(deflection, selected())) {
      const robot = fleet.robots.get(number);
      if (!robot) continue;
      const { linear_max_m_s: linearMax = 0, angular_max_rad_s: angularMax = 0 } = robot.figures;
      const [linear, angular] = [forward * linearMax, left * angularMax];
      const isSent = publish(`${robot.prefix}cmd_vel`, "geometry_msgs/msg/Twist", writeTwist(linear, angular));
      if (isSent && number === selected()) sent = { linear, angular };
    }
    return sent;
  }

  /** Takes a key that is pressed. One that repeats was pressed before. @param {string} code @param {boolean} isRepeat */
  press(code, isRepeat) {
    if (!isRepeat) this.keys.add(code);
  }

  release(/** @type {string} */ code) {
    this.keys.delete(code);
    this.observe();
  }

  releaseKeys() {
    this.keys.clear();
    this.observe();
  }

  setStick(/** @type {Deflection | null} */ deflection) {
    this.stick = deflection;
    this.observe();
  }
}

/**
 * Returns what driving by hand depends on.
 * @param {import("./state.js").Fleet} fleet @param {import("./state.js").Robot | null} robot the selected one
 * @param {boolean} isStopAsked @param {boolean} isConnected @returns {Situation}
 */
export function situationOf(fleet, robot, isStopAsked, isConnected) {
  return {
    isStopped: fleet.isStopped === true || isStopAsked || fleet.figures.is_replay === true,
    isConnected,
    robot: robot ? `${fleet.runs} ${robot.number}` : null,
    driver: !robot?.figures.driver ? null : robot.figures.is_mine ? "me" : "other",
  };
}

/** Lets the stick on the screen drive. Returns what releases it. @param {HTMLElement} stick @param {HTMLElement} knob @param {Driving} driving */
export function attachStick(stick, knob, driving) {
  /** The pointer that holds it. @type {number | null} */
  let holder = null;
  const release = () => {
    holder = null;
    driving.setStick(null);
    stick.classList.remove("held");
    knob.style.transform = "";
  };
  const move = (/** @type {PointerEvent} */ event) => {
    const box = stick.getBoundingClientRect();
    const radius = box.width / 2;
    let [x, y] = [(event.clientX - box.left - radius) / radius, (event.clientY - box.top - radius) / radius];
    const length = Math.hypot(x, y);
    if (length > 1) [x, y] = [x / length, y / length];
    driving.setStick(stickDeflection(x, y));
    stick.classList.add("held");
    knob.style.transform = `translate(${x * radius * KNOB_SHARE}px, ${y * radius * KNOB_SHARE}px)`;
  };
  stick.addEventListener("pointerdown", (event) => {
    if (event.button !== PRIMARY_BUTTON || holder !== null) return;
    holder = event.pointerId;
    stick.setPointerCapture(event.pointerId);
    move(event);
  });
  stick.addEventListener("pointermove", (event) => {
    if (event.pointerId !== holder) return;
    // While another button is held, the end of the primary one comes as a movement.
    if (event.buttons & PRIMARY_BUTTONS) move(event);
    else release();
  });
  ["pointerup", "pointercancel", "lostpointercapture"].forEach((name) => stick.addEventListener(name, (event) => {
    if (/** @type {PointerEvent} */ (event).pointerId === holder) release();
  }));
  return release;
}
