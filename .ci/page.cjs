// The operator's page in Debian's Chromium, against a real fleet. `.ci/page` starts both.

const assert = require("node:assert/strict");
const { readFileSync, readdirSync } = require("node:fs");
const { after, afterEach, before, test } = require("node:test");
const { gzipSync } = require("node:zlib");
const { chromium } = require("playwright-core");
const { BROWSER_ARGS, CHROMIUM, WAIT, driverOf, launch, open: openOn, url, waitForDriver, waitForRobots, waitForText, watchSpeed: watchSpeedOn } = require("./page-browser.cjs");

const { PAGE_RUN: run, PAGE_OUT: out } = process.env;
let browser;
before(async () => { browser = await launch(); });
// Fourteen pages that stay open and draw would take both cores.
afterEach(() => Promise.all(browser.contexts().map((context) => context.close())));
after(() => browser.close());

const open = (options, on = browser) => openOn(on, options);
const watchSpeed = () => watchSpeedOn(browser);

test("the page shows every robot and the map, and reports no error", async () => {
  const { page, errors } = await open();
  await page.waitForFunction(() => document.querySelector("#fleet").textContent.includes("cells of"), null, WAIT);
  // Free floor is drawn, in the colour of the robot that saw it.
  await page.waitForFunction(() => {
    const canvas = document.querySelector("#view");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const [free, opacity] = [[0x2b, 0x37, 0x45], 70 / 255];
    const seen = [[0xe6, 0x9f, 0x00], [0x3a, 0x9a, 0xd9]].map((colour) => colour.map((value, k) => free[k] + opacity * (value - free[k])));
    const counts = [0, 0];
    for (let i = 0; i < data.length; i += 4) {
      seen.forEach((colour, robot) => { if (colour.every((value, k) => Math.abs(data[i + k] - value) < 3)) counts[robot] += 1; });
    }
    return counts.every((count) => count > 2000);
  }, null, WAIT);
  await page.screenshot({ path: `${out}/page-desk.png` });
  assert.deepEqual(errors, []);
});

test("it fits a phone", async () => {
  const { page, errors } = await open({ viewport: { width: 390, height: 844 }, hasTouch: true });
  const width = await page.evaluate(() => document.documentElement.scrollWidth);
  assert.ok(width <= 390, `the page is ${width} pixels wide`);
  await page.screenshot({ path: `${out}/page-phone.png` });
  assert.deepEqual(errors, []);
});

test("keys drive the selected robot alone, and nobody else drives it then", async () => {
  const { page } = await open();
  await page.keyboard.press("Digit2");
  await page.keyboard.down("KeyD");
  await page.waitForFunction(() => document.querySelectorAll(".robot")[1].textContent.includes("Driveryou"), null, WAIT);
  assert.equal(await driverOf(page, 1), "nobody");
  assert.match(await page.textContent("#velocity"), /^-?0.00 m\/s, -0.9 rad\/s$/, "three fifths of the robot's 1.5 rad/s");
  await page.keyboard.up("KeyD");
  await page.waitForFunction(() => document.querySelectorAll(".robot")[1].textContent.includes("Drivernobody"), null, WAIT);
  assert.match(await page.textContent("#velocity"), /^-?0.00 m\/s/);
});

test("a robot is selected by keyboard alone", async () => {
  const { page } = await open();
  const isSelected = () => page.evaluate(() => document.activeElement.matches(".robot"));
  for (let i = 0; i < 20 && !(await isSelected()); i += 1) await page.keyboard.press("Tab");
  assert.ok(await isSelected(), "Tab reaches a robot's panel");
  await page.keyboard.press("Enter");
  await waitForText(page, "#target", "robot1");
});

test("a goal that is drawn on the map is driven to, and a person's hand takes the robot from it", async () => {
  const { page, errors } = await open();
  await page.keyboard.press("Digit1");
  const draw = async (metres) => {
    await page.click("#goal");
    const [from, to] = await page.evaluate((ahead) => {
      const { pose: { x, y, yaw }, scan } = mixedReality.operator.fleet.robots.get(1);
      const points = [...scan.ranges].map((range, i) => [range, scan.angleMin + i * scan.angleStep]).filter(([range]) => Number.isFinite(range))
        .map(([range, angle]) => [range * Math.cos(angle), range * Math.sin(angle)]);
      // Wherever the robot stands: where nothing is in the way, as far ahead of it as can be.
      const isFree = (bearing) => points.every(([px, py]) => {
        const [along, beside] = [px * Math.cos(bearing) + py * Math.sin(bearing), py * Math.cos(bearing) - px * Math.sin(bearing)];
        return along < 0 || along > ahead + 0.5 || Math.abs(beside) > 0.3;
      });
      const bearings = Array.from({ length: 24 }, (_, i) => (i % 2 ? -1 : 1) * Math.ceil(i / 2) * Math.PI / 12);
      const bearing = bearings.find(isFree);
      if (bearing === undefined) throw new Error("obstacles all around robot1");
      const to = yaw + bearing;
      const box = document.querySelector("#view").getBoundingClientRect();
      return [ahead, ahead + 0.3].map((m) => {
        const at = mapView.camera.toScreen({ x: x + m * Math.cos(to), y: y + m * Math.sin(to) });
        return { x: at.x + box.left, y: at.y + box.top };
      });
    }, metres);
    await page.mouse.move(from.x, from.y);
    await page.mouse.down();
    await page.mouse.move(to.x, to.y);
    await page.mouse.up();
  };
  const goal = (pattern) => page.waitForFunction(
    (wanted) => new RegExp(`Goal(${wanted})`).test(document.querySelector(".robot").textContent), pattern, WAIT);
  await draw(0.4);
  await goal("driving");
  await page.screenshot({ path: `${out}/page-goal.png` });
  await goal("reached");
  await draw(0.4);
  await goal("driving");
  await page.keyboard.down("KeyD");
  await goal("paused");
  await page.keyboard.up("KeyD");
  await page.click("#cancel-goal");
  await goal("cancelled|none");
  assert.deepEqual(errors, []);
});

test("the emergency stop is set by a key, is confirmed, and is released separately", async () => {
  const { page } = await open();
  await page.keyboard.press("Escape");
  await page.waitForSelector("#release:visible", WAIT);
  await waitForText(page, "#log", "confirmed after");
  await page.keyboard.press("Escape");
  await page.click("#release");
  await page.waitForSelector("#release", { state: "hidden", ...WAIT });
});

test("the release never comes to where the stop was, and the second press of a stop releases nothing", async () => {
  const { page } = await open();
  const boxOf = (id) => page.locator(id).evaluate((of) => ((box) => [box.left, box.top, box.right, box.bottom])(of.getBoundingClientRect()));
  for (const width of [360, 390, 412, 761, 830, 1280]) {
    await page.setViewportSize({ width, height: 800 });
    const before = await boxOf("#stop");
    await page.locator("#stop").evaluate((stop) => stop.click());
    await page.waitForSelector("#release:visible", WAIT);
    await page.locator("#release").evaluate((release) => release.click());
    const [left, top, right, bottom] = await boxOf("#release");
    assert.deepEqual(await boxOf("#stop"), before, `${width} px`);
    assert.ok(right <= before[0] || left >= before[2] || bottom <= before[1] || top >= before[3], `${width} px`);
    await page.waitForSelector("#release:enabled", WAIT);
    await page.click("#release");
    await page.waitForSelector("#release", { state: "hidden", ...WAIT });
  }
});

test("an emergency stop that is pressed while the link breaks is set when it is back", async () => {
  const { page } = await open({ sockets: true });
  await page.evaluate(() => {
    globalThis.sockets.forEach((socket) => socket.close());
    dispatchEvent(new KeyboardEvent("keydown", { code: "Escape" }));
  });
  await page.waitForSelector("#release:visible", WAIT);
  await waitForText(page, "#log", "confirmed after");
  await page.click("#release");
  await page.waitForSelector("#release", { state: "hidden", ...WAIT });
});

test("a key whose release the browser may keep to itself lets go at once", async () => {
  const { page } = await open();
  await page.keyboard.press("Digit1");
  for (const end of [() => page.keyboard.press("Meta"), () => page.evaluate(() => dispatchEvent(new MouseEvent("contextmenu")))]) {
    await page.keyboard.down("KeyA");
    await waitForDriver(page, 1, "^you$");
    await end();
    await waitForDriver(page, 1, "^nobody$");
    await page.keyboard.up("KeyA");
  }
});

/** Robots whose newest velocity from this page is not zero, seen by another page. */
async function watchCommands() {
  const { page: observer } = await open();
  await observer.evaluate(async () => {
    const { Connection } = await import("./transport.js");
    globalThis.moving = new Map();
    const message = (topic, view) => {
      const twist = [4, 4 + 40].map((at) => view.getFloat64(at, true));
      globalThis.moving.set(topic, twist.some((value) => value !== 0));
    };
    const connection = new Connection(location.origin.replace("http", "ws"), { message });
    ["/robot1/cmd_vel", "/robot2/cmd_vel"].forEach((topic) => connection.subscribe(topic));
  });
  const isMoving = (robot) => observer.evaluate((topic) => globalThis.moving.get(topic) === true, `/robot${robot}/cmd_vel`);
  const waitForMoving = (robot, wanted) => observer.waitForFunction(([topic, is]) => (globalThis.moving.get(topic) === true) === is, [`/robot${robot}/cmd_vel`, wanted], WAIT);
  return { observer, isMoving, waitForMoving };
}

/** Sets the emergency stop and releases it as another client does. */
async function stopAndRelease(observer, page) {
  await observer.keyboard.press("Escape");
  await page.waitForSelector("#release:visible", WAIT);
  await observer.click("#release");
  await page.waitForSelector("#release", { state: "hidden", ...WAIT });
}

test("what is held when the emergency stop is released drives nothing until it is held anew", async () => {
  const { observer, isMoving, waitForMoving } = await watchCommands();
  const { page } = await open();
  await page.keyboard.press("Digit1");
  const box = await page.locator("#stick").boundingBox();
  const devices = [
    [() => page.keyboard.down("KeyA"), () => page.keyboard.up("KeyA")],
    [async () => {
      await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
      await page.mouse.down();
      await page.mouse.move(box.x + 5, box.y + box.height / 2, { steps: 3 });
    }, () => page.mouse.up()],
  ];
  for (const [hold, letGo] of devices) {
    await hold();
    await waitForMoving(1, true);
    await stopAndRelease(observer, page);
    await waitForText(page, "#hint", "Let go");
    assert.equal(await isMoving(1), false);
    await letGo();
    await hold();
    await waitForMoving(1, true);
    await letGo();
    await waitForMoving(1, false);
  }
});

test("a key that is held for one robot does not move another one that is selected meanwhile", async () => {
  const { isMoving, waitForMoving } = await watchCommands();
  const { page } = await open();
  await page.keyboard.press("Digit1");
  await page.keyboard.down("KeyD");
  await waitForMoving(1, true);
  await page.keyboard.press("Digit2");
  await waitForMoving(1, false);
  await waitForText(page, "#hint", "Let go");
  // As a key that is held does.
  await page.keyboard.down("KeyD");
  await page.waitForTimeout(300);
  assert.equal(await isMoving(2), false);
  await page.keyboard.up("KeyD");
  await page.keyboard.down("KeyD");
  await waitForMoving(2, true);
  await page.keyboard.up("KeyD");
  await waitForMoving(2, false);
});

test("when another run begins, what it had latched is asked for again", async () => {
  const { page } = await open();
  const isKnown = (runs) => page.waitForFunction((wanted) => {
    const { fleet } = mixedReality.operator;
    return fleet.runs === wanted && fleet.map && fleet.exploration && [...fleet.robots.values()].every((robot) => robot.pose);
  }, runs, WAIT);
  await isKnown(1);
  await page.evaluate(() => { mixedReality.operator.fleet.runTime = 1e9; });
  await isKnown(2);
});

test("the whole page has at most 120 kB, compressed file by file", () => {
  const folder = `${__dirname}/../page`;
  const files = readdirSync(folder).filter((name) => name.includes("."));
  const bytes = files.reduce((sum, name) => sum + gzipSync(readFileSync(`${folder}/${name}`), { level: 9 }).length, 0);
  assert.ok(bytes <= 120_000, `${bytes} bytes`);
});

test("a page of another origin opens no WebSocket", async () => {
  const page = await browser.newPage();
  const opened = await page.evaluate((target) => new Promise((resolve) => {
    const socket = new WebSocket(target.replace("http", "ws"), ["foxglove.sdk.v1"]);
    socket.onopen = () => resolve(true);
    socket.onerror = () => resolve(false);
  }), url);
  assert.equal(opened, false);
});

/** Lets an operator drive the first robot, ends that with `end`, and returns how long the robot went on, ms. */
async function timeToStop(observer, page, end) {
  await page.keyboard.press("Digit1");
  await page.keyboard.down("KeyS");
  await observer.waitForFunction(() => Math.abs(globalThis.speeds.at(-1)?.[1]) > 0.08, null, WAIT);
  const ended = Date.now();
  await end();
  await observer.waitForFunction((after) => globalThis.speeds.some(([at, v]) => at > after && Math.abs(v) < 0.01), ended, WAIT);
  const moving = await observer.evaluate((after) => globalThis.speeds.filter(([at, v]) => at > after && Math.abs(v) >= 0.01).map(([at]) => at), ended);
  return Math.max(0, ...moving.map((at) => at - ended));
}

/** The bridge sends zeros 300 ms after the last velocity, which `cargo bench --bench safety` measures; then the robot brakes. */
const STOP_MS = 300 + 400;

/** Turning rate that a held key wishes for, rad/s, at most. */
const TURNING_RAD_S = 1.5;

test("a robot stands when its operator's browser is killed", async () => {
  const observer = await watchSpeed();
  const server = await chromium.launchServer({ executablePath: CHROMIUM, args: BROWSER_ARGS });
  const { page } = await open({}, await chromium.connect(server.wsEndpoint()));
  // All of the browser's processes at once: it leads a group of its own.
  const took = await timeToStop(observer, page, () => process.kill(-server.process().pid, "SIGKILL"));
  assert.ok(took < STOP_MS, `${took} ms`);
});

test("a robot stands when the operator's socket breaks, and the page connects again", async () => {
  const observer = await watchSpeed();
  const { page } = await open({ sockets: true });
  const took = await timeToStop(observer, page, () => page.evaluate(() => {
    globalThis.sockets.forEach((socket) => socket.close());
    const link = document.querySelector("#link");
    new MutationObserver(() => {
      if (link.textContent === "connected") globalThis.isBack = true;
    }).observe(link, { childList: true, characterData: true, subtree: true });
    dispatchEvent(new Event("blur"));
  }));
  assert.ok(took < STOP_MS, `${took} ms`);
  // How long that takes, `page-link.cjs` measures.
  await page.waitForFunction(() => globalThis.isBack, null, WAIT);
});

test("a robot stands when the bridge is killed, and the page connects again", async () => {
  const { page } = await open();
  const pose = () => page.evaluate(() => ({ ...mixedReality.operator.fleet.robots.get(1).pose }));
  const isDriven = (who) => page.waitForFunction((wanted) => document.querySelector(".robot dd").textContent === wanted, who, WAIT);
  await page.keyboard.press("Digit1");
  await page.keyboard.down("KeyA");
  await isDriven("you");
  await page.waitForTimeout(500);
  const bridge = readdirSync("/proc").filter((pid) => /^\d+$/.test(pid)).find((pid) => {
    try {
      const line = readFileSync(`/proc/${pid}/cmdline`, "utf8").split("\0");
      return line[2] === "bridge" && line.includes(run);
    } catch {
      return false;
    }
  });
  // Keeps the last pose that comes before the bridge dies, however late this browser reads it.
  await page.evaluate(() => {
    const link = document.querySelector("#link");
    new MutationObserver(() => {
      if (link.textContent.includes("no connection")) globalThis.lastPose ??= { ...mixedReality.operator.fleet.robots.get(1).pose };
    }).observe(link, { childList: true, characterData: true, subtree: true });
  });
  process.kill(Number(bridge), "SIGKILL");
  const before = await (await page.waitForFunction(() => globalThis.lastPose, null, WAIT)).jsonValue();
  // The key is let go while nobody hears of it.
  await page.keyboard.up("KeyA");
  await waitForText(page, "#link", "connected");
  await waitForRobots(page, 2);
  // The robot has turned no further than within the time that its own dead man's switch and its brakes need.
  const after = await pose();
  const turned = Math.abs(Math.atan2(Math.sin(after.yaw - before.yaw), Math.cos(after.yaw - before.yaw)));
  assert.ok(turned < (STOP_MS / 1000) * TURNING_RAD_S, `it turned by ${turned} rad`);
});
