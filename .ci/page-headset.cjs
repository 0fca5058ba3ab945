// An operator with an emulated Quest 3 in a scanned room, for the tests of mixed reality.

const { readFileSync } = require("node:fs");
const { explainWaits, serveFiles, waitForRobots } = require("./page-browser.cjs");

const { PAGE_URL: url, PAGE_ROOM: roomFile, PAGE_EMULATOR: emulator } = process.env;
/** What has not come by then never comes, ms: the emulator draws few frames a second on a busy machine. */
const WAIT = { timeout: 40_000 };
/** Starts of the two robots in the room, as `.ci/page` configures them: x, y, yaw. `map` is the room's frame. */
const STARTS = JSON.parse(process.env.PAGE_STARTS);
const SIZE = { width: 600, height: 400 };
/** Field of view from top to bottom, as the emulator has it. */
const FOV_Y = 1.2;
const room = JSON.parse(readFileSync(roomFile, "utf8"));
const floor = room.spatialEntities.find((entity) => entity.semanticLabel_META === "FLOOR").locatable_META.position.y;
// The headset's floor is at 0; the scan has it elsewhere.
for (const entity of room.spatialEntities) entity.locatable_META.position.y -= floor;

/** A point of the room's file (x, z-up) in WebXR. */
const inXr = (x, y, z = 0) => [x, z, -y];
/** Returns the rotation from straight ahead to a direction, without roll. */
function towards(from, to) {
  const [x, y, z] = to.map((value, i) => value - from[i]);
  const [yaw, pitch] = [Math.atan2(-x, -z), Math.atan2(y, Math.hypot(x, z))];
  const [cp, sp, cy, sy] = [Math.cos(pitch / 2), Math.sin(pitch / 2), Math.cos(yaw / 2), Math.sin(yaw / 2)];
  return { x: cy * sp, y: sy * cp, z: -sy * sp, w: cy * cp, yaw, pitch };
}

/** One operator with a headset. */
class Headset {
  static async open(browser, { lacks = [], breaksAtStart = false } = {}) {
    const context = await browser.newContext({ viewport: SIZE, colorScheme: "dark" });
    await serveFiles(context, url);
    const headset = new Headset();
    const page = (headset.page = await context.newPage());
    headset.errors = [];
    page.on("pageerror", (error) => headset.errors.push(error.message));
    page.on("console", (message) => message.type() === "error" && headset.errors.push(message.text()));
    await page.addInitScript((missing) => { globalThis.questLacks = missing; }, lacks);
    await page.addInitScript({ path: emulator });
    if (breaksAtStart) await page.addInitScript(() => {
      const [Socket, sockets] = [globalThis.WebSocket, new Set()];
      globalThis.broken = 0;
      globalThis.WebSocket = class extends Socket {
        constructor(...args) {
          super(...args);
          sockets.add(this);
        }
      };
      const request = XRSystem.prototype.requestSession;
      XRSystem.prototype.requestSession = async function start(...args) {
        const session = await request.apply(this, args);
        globalThis.breakSockets();
        return session;
      };
      globalThis.breakSockets = () => {
        for (const socket of sockets) if (socket.readyState === 1) { socket.close(); globalThis.broken += 1; }
      };
    });
    await page.goto(url);
    await page.evaluate((scanned) => globalThis.quest.enter(scanned), room);
    explainWaits(page, headset.errors);
    await waitForRobots(page, 2, WAIT);
    return headset;
  }

  /** Enters mixed reality, aligned with the room by two taps at the first robot. */
  async enter() {
    await this.look(inXr(0, -1, 1.6), inXr(0, 2, 1.6));
    await this.page.keyboard.press("Digit1");
    await this.page.click("#reality");
    await this.page.waitForSelector('#reality[aria-pressed="true"]', { state: "attached", ...WAIT });
    await this.press("Align map");
    const [x, y, yaw] = STARTS[0];
    await this.tap(inXr(x, y));
    await this.tap(inXr(x + 1.5 * Math.cos(yaw), y + 1.5 * Math.sin(yaw)));
    await this.frames(2);
  }

  /** Waits until the page has drawn so many frames. */
  async frames(count) {
    for (let i = 0; i < count; i += 1) await this.page.evaluate(() => globalThis.quest.pixels().then(() => 0));
  }

  async look(from, to) {
    this.eye = { from, ...towards(from, to) };
    await this.page.evaluate(([place, q]) => {
      globalThis.quest.device.position.set(...place);
      globalThis.quest.device.quaternion.set(q.x, q.y, q.z, q.w);
    }, [from, this.eye]);
  }

  /** Points the right controller from beside the viewer. */
  async aim(to) {
    const from = [this.eye.from[0] + 0.2, this.eye.from[1] - 0.4, this.eye.from[2] - 0.1];
    await this.page.evaluate(([place, q]) => {
      const { right } = globalThis.quest.device.controllers;
      right.position.set(...place);
      right.quaternion.set(q.x, q.y, q.z, q.w);
    }, [from, towards(from, to)]);
  }

  async button(name, value) {
    await this.page.evaluate(([id, to]) => globalThis.quest.device.controllers.right.updateButtonValue(id, to), [name, value]);
    await this.frames(2);
  }

  async tap(to) {
    await this.aim(to);
    await this.frames(2);
    await this.button("trigger", 1);
    await this.button("trigger", 0);
  }

  /** Taps a button of the fleet's panel, which stands before where the session began. */
  async press(text) {
    const at = await this.page.evaluate((wanted) => globalThis.mixedReality.buttonPlace(wanted), text);
    await this.tap(at);
  }

  async stick(x, y) {
    await this.page.evaluate(([ax, ay]) => globalThis.quest.device.controllers.right.updateAxes("thumbstick", ax, ay), [x, y]);
  }

  find(colour) { return this.page.evaluate((c) => globalThis.quest.find(c), colour); }

  /** Returns where a point of the room is on the screen, pixels. */
  project(point) {
    const { from, yaw, pitch } = this.eye;
    const [x, y, z] = point.map((value, i) => value - from[i]);
    const [right, ahead] = [x * Math.cos(yaw) - z * Math.sin(yaw), -x * Math.sin(yaw) - z * Math.cos(yaw)];
    const [up, depth] = [y * Math.cos(pitch) - ahead * Math.sin(pitch), ahead * Math.cos(pitch) + y * Math.sin(pitch)];
    const scale = SIZE.height / 2 / Math.tan(FOV_Y / 2);
    return { x: SIZE.width / 2 + (scale * right) / depth, y: SIZE.height / 2 - (scale * up) / depth };
  }

  driver(robot) { return this.page.locator(".robot").nth(robot - 1).locator("dd").first().textContent(); }
  close() { return this.page.context().close(); }
}

module.exports = { Headset, SIZE, STARTS, WAIT, inXr, room };
