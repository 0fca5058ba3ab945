// Controllers in mixed reality: buttons act once, and a stopped frame loop does not drive.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Controls, pulse } from "../xr_input.js";

const source = (handedness, pressed, axes = [0, 0, 0, 0], actuator = null) => ({
  handedness,
  targetRayMode: "tracked-pointer",
  targetRaySpace: handedness,
  gamepad: { axes, buttons: Array.from({ length: 6 }, (_, i) => ({ pressed: pressed.includes(i) })), hapticActuators: actuator ? [actuator] : [] },
});
const matrix = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1]);
const frame = { getPose: (space) => (space === "right" ? { transform: { matrix } } : null) };

function controls() {
  const calls = [];
  const act = (name) => () => calls.push(name);
  return { calls, it: new Controls({ next: act("next"), previous: act("previous"), stop: act("stop"), changeView: act("view") }) };
}

test("a button acts once until it is pressed again", () => {
  const { it, calls } = controls();
  const session = (...inputSources) => ({ visibilityState: "visible", inputSources });
  it.readButtons(session(source("right", [4])));
  it.readButtons(session(source("right", [4])));
  it.readButtons(session(source("right", [])));
  it.readButtons(session(source("right", [4]), source("left", [4, 5])));
  assert.deepEqual(calls, ["next", "next", "previous", "stop"]);
});

test("the right thumbstick drives with the grip; the left one never does", () => {
  const { it } = controls();
  const visible = (...inputSources) => ({ visibilityState: "visible", inputSources });
  it.update(visible(source("left", [1], [0, 0, 0, -1])), frame, null, 0);
  assert.equal(it.drive(0), null);
  it.update(visible(source("right", [], [0, 0, 0, -1])), frame, null, 0.5);
  assert.equal(it.drive(0.5), null);
  it.update(visible(source("right", [1], [0, 0, 0, -1])), frame, null, 1);
  assert.deepEqual(it.drive(1.1), { forward: 1, left: 0 });
});

test("a robot is not driven by frames that have stopped, nor while the system's menu is open", () => {
  const { it } = controls();
  const driving = [source("right", [1], [0, 0, 0, -1])];
  it.update({ visibilityState: "visible", inputSources: [source("right", [])] }, frame, null, 0.9);
  it.update({ visibilityState: "visible", inputSources: driving }, frame, null, 1);
  assert.ok(it.drive(1.1));
  assert.equal(it.drive(1.25), undefined, "the headset was taken off: the grip is not known to be open");
  it.update({ visibilityState: "visible-blurred", inputSources: driving }, frame, null, 2);
  assert.equal(it.drive(2), null);
  it.update({ visibilityState: "visible", inputSources: [] }, frame, null, 3);
  assert.equal(it.drive(3), null, "the controller is gone");
});

test("a grip that was held while it was not seen drives only after it was open", () => {
  const { it } = controls();
  const update = (pressed, visibilityState = "visible") => {
    it.update({ visibilityState, inputSources: pressed ? [source("right", pressed, [0, 0, 0, -1])] : [] }, frame, null, 1);
    return it.drive(1);
  };
  assert.equal(update([1]), null, "held when the session begins");
  for (const unseen of [() => update([1], "visible-blurred"), () => update(null)]) {
    assert.equal(update([]), null);
    assert.deepEqual(update([1]), { forward: 1, left: 0 });
    unseen();
    assert.equal(update([1]), null);
  }
});

test("rays are those of tracked inputs, ahead along their negative z axis", () => {
  const { it } = controls();
  it.update({ visibilityState: "visible", inputSources: [source("left", []), source("right", [])] }, frame, null, 0);
  assert.deepEqual(it.rays.map(({ origin, direction }) => [origin, direction.map((value) => value + 0)]), [[[1, 2, 3], [0, 0, -1]]]);
});

test("a pulse reaches every controller that can vibrate", () => {
  const felt = [];
  const actuator = { pulse: (...args) => { felt.push(args); return Promise.reject(new Error("asleep")); } };
  pulse({ inputSources: [source("left", [], [], actuator), source("right", []), { hand: {} }, source("right", [], [], actuator)] }, 0.5, 100);
  assert.deepEqual(felt, [[0.5, 100], [0.5, 100]]);
});

test("after a gap without frames, as of a headset that was taken off, the grip drives only when it was open", () => {
  for (let gapS = 0; gapS <= 5; gapS += 0.25) {
    const { it } = controls();
    const update = (pressed, now) => {
      it.update({ visibilityState: "visible", inputSources: [source("right", pressed, [0, 0, 0, -1])] }, frame, null, now);
      return it.drive(now);
    };
    update([], 10);
    assert.ok(update([1], 10.1));
    const after = 10.1 + gapS;
    assert.equal(update([1], after) !== null, gapS <= 1, `a gap of ${gapS} s`);
    update([], after + 0.1);
    assert.ok(update([1], after + 0.2), "it was open");
  }
});
