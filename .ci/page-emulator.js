// An emulated Quest 3 for the tests of mixed reality. `.ci/page` bundles it with its libraries and puts it before the page.

import { XRDevice, metaQuest3 } from "iwer";
import { SyntheticEnvironmentModule } from "@iwer/sem";

/** Views from 1.6 m above the floor, with the field of view that a screen shows well. */
const lacks = globalThis.questLacks ?? [];
const quest3 = { ...metaQuest3, supportedFeatures: metaQuest3.supportedFeatures.filter((feature) => !lacks.includes(feature)) };
const device = new XRDevice(quest3, { stereoEnabled: false, fovy: 1.2 });
device.installRuntime({ forceInstall: true });

/** Pixels of the session's layer after the page has drawn a frame, if somebody waits for them. */
let waiting = [];
const requestFrame = XRSession.prototype.requestAnimationFrame;
XRSession.prototype.requestAnimationFrame = function request(callback) {
  return requestFrame.call(this, (time, frame) => {
    callback(time, frame);
    const gl = frame.session.renderState.baseLayer?.context;
    if (!gl || waiting.length === 0) return;
    const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    const pixels = new Uint8Array(width * height * 4);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    waiting.forEach((resolve) => resolve({ width, height, pixels }));
    waiting = [];
  });
};

globalThis.quest = {
  device,
  /** Begins to emulate a scanned room. The module needs the document's body. */
  enter(room) {
    device.installSEM(SyntheticEnvironmentModule);
    device.sem.loadEnvironment(room);
  },
  /** Shows the scanned room behind what the page draws. It costs much time. */
  show() { device.sem.meshesVisible = true; },
  /** Returns the pixels of the next frame as the page drew it, without the room. */
  pixels: () => new Promise((resolve) => waiting.push(resolve)),
  /**
   * Counts opaque pixels of a colour in the shades that light makes of it, and returns their middle: from the left and from the
   * top. Flat things (points, panels) have the colour itself.
   */
  async find(colour) {
    const { width, height, pixels } = await globalThis.quest.pixels();
    const square = colour.reduce((sum, value) => sum + value * value, 0);
    let [count, x, y] = [0, 0, 0];
    for (let i = 0; i < pixels.length; i += 4) {
      const pixel = [pixels[i], pixels[i + 1], pixels[i + 2]];
      const shade = pixel.reduce((sum, value, k) => sum + value * colour[k], 0) / square;
      const away = pixel.reduce((sum, value, k) => sum + Math.abs(value - shade * colour[k]), 0);
      if (pixels[i + 3] < 250 || away > 12 || shade < 0.55 || shade > 0.96) continue;
      count += 1;
      x += (i / 4) % width;
      y += height - 1 - Math.floor(i / 4 / width);
    }
    return { count, x: x / count, y: y / count };
  },
};
