// The keyboard: keys that drive, keys that select a robot, and keys for the page's buttons.

import { isDriveKey } from "./input.js";

/** What keys do. @typedef {object} Keyboard
 * @property {import("./driving.js").Driving} driving
 * @property {() => void} releaseAll lets go of everything that drives
 * @property {(number: number) => void} select
 * @property {() => void} stop sets the emergency stop
 * @property {(event: KeyboardEvent) => boolean} takesKey whether the map has taken the key
 * @property {Record<string, () => void>} actions what a key does, by its code
 */

/** Returns whether a key moves what has the focus: in the panels beside the map arrows scroll. @param {KeyboardEvent} event */
function scrolls({ code, target }) {
  const panel = /** @type {HTMLElement | null} */ (target)?.closest?.("aside, [role=log]");
  return code.startsWith("Arrow") && Boolean(panel);
}

/** Lets the keyboard act. What could keep the release of a key from the page lets go of all. @param {Keyboard} of */
export function attachKeys(of) {
  window.addEventListener("keydown", (event) => press(of, event));
  window.addEventListener("keyup", (event) => of.driving.release(event.code));
  window.addEventListener("blur", of.releaseAll);
  window.addEventListener("contextmenu", of.releaseAll);
  document.addEventListener("visibilitychange", () => { if (document.hidden) of.releaseAll(); });
}

/** @param {Keyboard} of @param {KeyboardEvent} event */
function press({ driving, select, stop, takesKey, actions }, event) {
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
  if (takesKey(event)) {
    event.preventDefault();
    return;
  }
  if (scrolls(event)) return;
  const digit = /^(?:Digit|Numpad)([1-9])$/.exec(event.code);
  if (isDriveKey(event.code) || event.code.startsWith("Shift")) {
    driving.press(event.code, event.repeat);
    if (isDriveKey(event.code)) event.preventDefault();
  } else if (event.repeat) {
    return;
  } else if (digit) {
    select(Number(digit[1]));
  } else if (event.code in actions) {
    event.preventDefault();
    actions[event.code]();
  }
}

/** Returns the number of the robot that comes next, or null without robots. @param {number[]} numbers @param {number | null} selected @param {number} step 1 or -1 */
export function nextRobot(numbers, selected, step) {
  if (numbers.length === 0) return null;
  const sorted = [...numbers].sort((a, b) => a - b);
  const place = selected === null ? (step > 0 ? -1 : 0) : sorted.indexOf(selected);
  return sorted[(place + step + sorted.length) % sorted.length];
}
