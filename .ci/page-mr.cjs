// Mixed reality on an emulated Quest 3, in a scanned room that is also the world of a real fleet. `.ci/page` starts both.

const assert = require("node:assert/strict");
const { execFileSync } = require("node:child_process");
const { after, before, test } = require("node:test");
const { chromium } = require("playwright-core");
const { serveFiles, BROWSER_ARGS } = require("./page-browser.cjs");
const { Headset, SIZE, STARTS, WAIT, inXr, room } = require("./page-headset.cjs");

const { PAGE_URL: url, PAGE_OUT: out, PAGE_EMULATOR: emulator, PAGE_PROGRAM: program, PAGE_RUN: run } = process.env;
/** Colours of the robots, which their upper plates have. */
const COLOURS = [[230, 159, 0], [58, 154, 217]];
const ARGS = [...BROWSER_ARGS, "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"];

let browser;
/** The headset of all tests but the first. */
let headset;
before(async () => {
  browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ARGS });
});
after(() => browser.close());

/** The middle of a robot's upper plates in the room, metres: behind the axle, under the LiDAR. */
const plate = ([x, y, yaw]) => inXr(x - 0.032 * Math.cos(yaw), y - 0.032 * Math.sin(yaw), 0.13);

test("the table hides a robot by depth or by the room's mesh, and by neither it does not", async () => {
  const counts = {};
  for (const [name, lacks] of [["nothing", ["depth-sensing", "mesh-detection"]], ["mesh", ["depth-sensing"]], ["depth", []]]) {
    const other = await Headset.open(browser, { lacks });
    await other.enter();
    const [x, y] = STARTS[1];
    await other.look(inXr(-1.2, 2.6, 0.9), inXr(x, y, 0.1));
    // Near, and without the panel above the robot, which nothing hides.
    await other.page.evaluate(() => {
      globalThis.quest.device.fovy = 0.4;
      globalThis.mixedReality.panels = () => [];
    });
    await other.frames(3);
    counts[name] = (await other.find(COLOURS[1])).count;
    await other.close();
  }
  assert.ok(counts.nothing > 100, JSON.stringify(counts));
  assert.ok(counts.mesh < counts.nothing * 0.05, JSON.stringify(counts));
  assert.ok(counts.depth < counts.nothing * 0.05, JSON.stringify(counts));
});

test("both robots are where the simulator has them", async () => {
  headset = await Headset.open(browser);
  await headset.enter();
  await headset.look(inXr(0.2, -1.1, 1.5), inXr(0.1, 0.6, 0));
  await headset.page.evaluate(() => { globalThis.mixedReality.panels = () => []; });
  await headset.frames(3);
  for (const [i, start] of STARTS.entries()) {
    const wanted = headset.project(plate(start));
    let found = await headset.find(COLOURS[i]);
    // A robot of which a busy machine's browser has heard nothing for a second is grey.
    for (let attempt = 0; attempt < 20 && found.count <= 30; attempt += 1) found = await headset.find(COLOURS[i]);
    assert.ok(found.count > 30, `robot ${i + 1} has ${found.count} pixels`);
    const away = Math.hypot(found.x - wanted.x, found.y - wanted.y);
    // The middle of what is seen in its colour: a wheel's hub lies beside the plates, and the LiDAR hides a part of them.
    assert.ok(away < 10, `robot ${i + 1} is at ${JSON.stringify(found)} instead of ${JSON.stringify(wanted)}`);
  }
  await headset.page.evaluate(() => {
    delete globalThis.mixedReality.panels;
    globalThis.quest.show();
  });
  await headset.frames(2);
  await headset.page.screenshot({ path: `${out}/page-mr.png` });
  await headset.page.evaluate(() => { globalThis.quest.device.sem.meshesVisible = false; });
});

test("the thumbstick drives the robot that a trigger selected, and only it, while the grip is held", async () => {
  const poses = () => headset.page.evaluate(() => [...globalThis.mixedReality.operator.fleet.robots.values()].map(({ pose }) => ({ ...pose })));
  await headset.tap(inXr(STARTS[1][0], STARTS[1][1], 0.1));
  await headset.page.waitForFunction(() => document.querySelector("#target").textContent.includes("robot2"), null, WAIT);
  await headset.aim(inXr(0, 2, 2));
  const before = await poses();
  await headset.stick(0, -1);
  await headset.frames(3);
  assert.equal(await headset.driver(2), "nobody", "without the grip");
  await headset.button("squeeze", 1);
  await headset.page.waitForFunction(() => document.querySelectorAll(".robot")[1].textContent.includes("Driveryou"), null, WAIT);
  assert.equal(await headset.driver(1), "nobody");
  await headset.page.waitForFunction(([x, y]) => {
    const { pose } = globalThis.mixedReality.operator.fleet.robots.get(2);
    return Math.hypot(pose.x - x, pose.y - y) > 0.15;
  }, [before[1].x, before[1].y], WAIT);
  await headset.button("squeeze", 0);
  await headset.stick(0, 0);
  await headset.page.waitForFunction(() => document.querySelectorAll(".robot")[1].textContent.includes("Drivernobody"), null, WAIT);
  const moved = (await poses()).map(({ x, y }, i) => Math.hypot(x - before[i].x, y - before[i].y));
  assert.ok(moved[0] < 0.02, `the other robot moved ${moved[0]} m`);
});

test("a bare left hand drives while it pinches, and opening it or losing it stops the robot", async () => {
  const { page } = headset;
  const hand = (change) => page.evaluate(([pinch, place, isSeen]) => {
    const { left } = globalThis.quest.device.hands;
    left.connected = isSeen;
    left.updatePinchValue(pinch);
    left.position.set(...place);
  }, change).then(() => headset.frames(3));
  const isHeld = () => page.evaluate(() => globalThis.mixedReality.controls.hand.held !== null);
  const isDriver = (who) => page.waitForFunction((wanted) => document.querySelectorAll(".robot")[1].textContent.includes(`Driver${wanted}`), who, WAIT);
  await page.keyboard.press("Digit2");
  await headset.look(inXr(0.2, -1.1, 1.5), inXr(0.1, 0.6, 0.6));
  await page.evaluate(() => { globalThis.quest.device.primaryInputMode = "hand"; });
  const { from, yaw } = headset.eye;
  const place = (ahead) => [from[0] - 0.2 - ahead * Math.sin(yaw), from[1] - 0.4, from[2] - 0.3 - ahead * Math.cos(yaw)];
  await hand([0, place(0), true]);
  assert.equal(await isHeld(), false, "an open hand holds nothing");
  await hand([1, place(0), true]);
  assert.equal(await isHeld(), true, "a pinch holds");
  const before = await page.evaluate(() => ({ ...globalThis.mixedReality.operator.fleet.robots.get(2).pose }));
  // Towards the viewer is backwards: there the robot has just come from.
  await hand([1, place(-0.09), true]);
  await isDriver("you");
  await page.waitForFunction(([x, y]) => {
    const { pose } = globalThis.mixedReality.operator.fleet.robots.get(2);
    return Math.hypot(pose.x - x, pose.y - y) > 0.05;
  }, [before.x, before.y], WAIT);
  await hand([1, place(-0.09), false]);
  await isDriver("nobody");
  // Found again while it is closed, it holds nothing until it has been open.
  await hand([1, place(0), true]);
  assert.equal(await isHeld(), false, "a hand that is found closed");
  await hand([0, place(0), true]);
  await hand([1, place(0), true]);
  assert.equal(await isHeld(), true);
  await hand([0, place(0), true]);
  assert.equal(await isHeld(), false, "an open hand lets go");
  assert.equal(await headset.driver(1), "nobody");
  await page.evaluate(() => { globalThis.quest.device.primaryInputMode = "controller"; });
  await headset.frames(2);
});

test("from life-size to the table to the view from the selected robot, which is below the viewer then", async () => {
  await headset.page.keyboard.press("Digit1");
  await headset.look(inXr(0.2, -1.1, 1.5), inXr(0.1, 0.6, 0.6));
  await headset.frames(2);
  const view = (wanted) => headset.page.waitForFunction((name) => globalThis.mixedReality.nextView() === name, wanted, WAIT);
  await headset.press("Table-top");
  await view("Robot view");
  await headset.page.evaluate(() => globalThis.mixedReality.changeView());
  await view("Life-size");
  await headset.frames(3);
  await headset.page.screenshot({ path: `${out}/page-mr-robot.png` });
  const [below, robots] = await headset.page.evaluate(() => {
    const { xrFromMap, fromRobot, operator } = globalThis.mixedReality;
    const { x, y } = operator.fleet.robots.get(fromRobot.view.robot).pose;
    return [[0, 1, 2].map((row) => xrFromMap[row] * x + xrFromMap[4 + row] * y + xrFromMap[12 + row]), fromRobot.view.robot];
  });
  assert.equal(robots, 1);
  const { from } = headset.eye;
  assert.ok(Math.hypot(below[0] - from[0], below[1], below[2] - from[2]) < 0.05, `the robot is at ${below}, the viewer at ${from}`);
  // When another robot is selected, the view is from that one.
  await headset.page.keyboard.press("Digit2");
  await headset.page.waitForFunction(() => globalThis.mixedReality.fromRobot.view.robot === 2, null, WAIT);
  await headset.page.evaluate(() => globalThis.mixedReality.changeView());
  await view("Table-top");
});

test("the panel above a robot expands when the viewer looks at it or comes near, and shrinks again", async () => {
  const { page } = headset;
  const isLarge = (wanted) => page.waitForFunction((large) => globalThis.mixedReality.robotPanels.get(1)?.isLarge === large, wanted, WAIT);
  const panel = () => page.evaluate(() => [...globalThis.mixedReality.robotPanels.get(1).matrix.slice(12, 15)]);
  const [x, y] = STARTS[0];
  // From two metres away, at the ceiling, and behind the fleet's panel.
  const from = inXr(x, y + 2, 1.4);
  await headset.look(from, [from[0], 3, from[2] - 1]);
  await headset.frames(2);
  await isLarge(false);
  await headset.look(from, await panel());
  await isLarge(true);
  await page.screenshot({ path: `${out}/page-mr-gaze.png` });
  await headset.look(from, [from[0], 3, from[2] - 1]);
  await isLarge(false);
  const near = inXr(x, y + 0.5, 1.4);
  await headset.look(near, [near[0], 3, near[2] - 1]);
  await isLarge(true);
  await headset.look(from, [from[0], 3, from[2] - 1]);
  await isLarge(false);
});

test("the alignment of map and room is kept from session to session", async () => {
  const { page } = headset;
  const before = await page.evaluate(() => globalThis.mixedReality.placement.pose);
  assert.ok(Math.hypot(before.x, before.y) > 0.01 || Math.abs(before.yaw) > 0.01, "it was aligned");
  await page.evaluate(() => {
    globalThis.mixedReality.xr.end();
    globalThis.mixedReality.placement.pose = { x: 9, y: 9, yaw: 0 };
  });
  await page.waitForSelector('#reality[aria-pressed="false"]', { state: "attached", ...WAIT });
  await headset.look(inXr(0, -1, 1.6), inXr(0, 2, 1.6));
  await page.click("#reality");
  await page.waitForSelector('#reality[aria-pressed="true"]', { state: "attached", ...WAIT });
  await page.waitForFunction(({ x, y, yaw }) => {
    const { pose } = globalThis.mixedReality.placement;
    return Math.hypot(pose.x - x, pose.y - y) < 0.01 && Math.abs(pose.yaw - yaw) < 0.01;
  }, before, WAIT);
});

test("a button stops all robots, and the controllers are felt", async () => {
  await headset.page.evaluate(() => {
    globalThis.felt = 0;
    for (const { gamepad } of globalThis.quest.device.activeInputs.map((input) => input.inputSource)) {
      for (const actuator of gamepad?.hapticActuators ?? []) actuator.pulse = async () => { globalThis.felt += 1; return true; };
    }
  });
  await headset.button("b-button", 1);
  await headset.button("b-button", 0);
  await headset.page.waitForSelector("#release:not([hidden])", { state: "attached", ...WAIT });
  await headset.page.waitForFunction(() => globalThis.felt >= 2, null, WAIT);
  // So are alarms: what is new and urgent, and each once.
  await headset.page.evaluate(() => {
    const { fleet } = globalThis.mixedReality.operator;
    const attention = fleet.attention.bind(fleet);
    globalThis.felt = 0;
    fleet.attention = (...args) => [{ rank: 1, robot: 1, text: "lost" }, ...attention(...args)];
  });
  await headset.page.waitForFunction(() => globalThis.felt >= 2, null, WAIT);
  await headset.frames(3);
  assert.equal(await headset.page.evaluate(() => globalThis.felt), 2, "an alarm that stays is felt once");
  await headset.page.evaluate(() => { delete globalThis.mixedReality.operator.fleet.attention; });
  await headset.page.waitForFunction(() => globalThis.mixedReality.buttonPlace("Release stop") !== null, null, WAIT);
  await headset.press("Release stop");
  await headset.page.waitForSelector("#release[hidden]", { state: "attached", ...WAIT });
});

test("a grip that is held when the stop is released drives nothing until it is held anew", async () => {
  const { page } = headset;
  const isDriver = (who) => page.waitForFunction((wanted) => document.querySelector(".robot").textContent.includes(`Driver${wanted}`), who, WAIT);
  await page.keyboard.press("Digit1");
  await headset.stick(1, 0);
  await headset.button("squeeze", 1);
  await isDriver("you");
  await page.keyboard.press("Escape");
  await page.waitForSelector("#release:not([hidden]):enabled", { state: "attached", ...WAIT });
  await page.evaluate(() => document.querySelector("#release").click());
  await page.waitForSelector("#release[hidden]", { state: "attached", ...WAIT });
  await page.waitForFunction(() => globalThis.mixedReality.noticeText(true).startsWith("let go"), null, WAIT);
  await isDriver("nobody");
  await headset.button("squeeze", 0);
  await headset.frames(3);
  await headset.button("squeeze", 1);
  await isDriver("you");
  await headset.button("squeeze", 0);
  await headset.stick(0, 0);
  await isDriver("nobody");
});

test("sockets that break when the session starts and again and again, as they do on headsets, are opened and the session goes on", async () => {
  const other = await Headset.open(browser, { breaksAtStart: true });
  await other.look(inXr(0, -1, 1.6), inXr(0, 2, 1.6));
  await other.page.click("#reality");
  await other.page.waitForFunction(() => globalThis.broken > 0, null, WAIT);
  // On headsets 30 s lie between two breaks; the page counts no time from one to the next.
  for (let round = 0; round < 3; round += 1) {
    await other.page.waitForFunction(() => document.querySelector("#link").textContent === "connected", null, WAIT);
    // Scans come that were taken after the break.
    await other.page.waitForFunction(() => {
      const robots = [...globalThis.mixedReality.operator.fleet.robots.values()];
      return globalThis.mixedReality.xr !== null && robots.every(({ scan }) => scan && scan.stamp > (globalThis.newestScan ?? 0));
    }, null, WAIT);
    if (round === 2) break;
    const broken = await other.page.evaluate(() => {
      globalThis.newestScan = Math.max(...[...globalThis.mixedReality.operator.fleet.robots.values()].map(({ scan }) => scan.stamp));
      globalThis.breakSockets();
      return globalThis.broken;
    });
    assert.ok(broken >= 2 * (round + 2), `${broken} sockets broke`);
    await other.page.waitForFunction(() => document.querySelector("#link").textContent !== "connected", null, WAIT);
  }
  await other.frames(2);
  await other.close();
});

test("/selfcheck shows what the device gives in a session", async () => {
  const context = await browser.newContext({ viewport: SIZE });
  await serveFiles(context, url);
  const page = await context.newPage();
  await page.addInitScript({ path: emulator });
  await page.goto(`${url}/selfcheck`);
  await page.evaluate((scanned) => globalThis.quest.enter(scanned), room);
  await page.click("#session:not([disabled])");
  const fact = async (name, text) => page.waitForFunction(([of, wanted]) => document.querySelector(`[data-fact="${of}"]`)?.textContent.includes(wanted), [name, text], WAIT);
  await fact("Mixed reality", "yes");
  await fact("Hides by", "depth");
  await fact("Frames per second", "");
  await context.close();
});

test("the headset's room becomes the robots' when the operator accepts it at the laptop, and lies where the room is", async () => {
  // Another session, whose map was aligned with nothing.
  const other = await Headset.open(browser);
  const { page } = other;
  await other.look(inXr(0, -1, 1.6), inXr(0, 2, 1.6));
  await page.click("#reality");
  await page.waitForSelector('#reality[aria-pressed="true"]', { state: "attached", ...WAIT });
  await page.waitForFunction(() => globalThis.mixedReality.buttonPlace("Use my room") !== null, null, WAIT);
  await other.press("Use my room");
  await page.waitForFunction(() => document.querySelector("#items").textContent.includes("offers its room"), null, WAIT);
  assert.equal(await page.evaluate(() => globalThis.mixedReality.operator.fleet.runs), 1, "nothing happens before it is accepted");
  const accept = () => execFileSync(program, ["room", "--run-dir", run, "accept"], { encoding: "utf8" });
  assert.match(accept(), /starts again in the headset's room of \d/);
  assert.throws(accept, "it is accepted once");
  await page.waitForFunction(() => {
    const { fleet } = globalThis.mixedReality.operator;
    return fleet.runs === 2 && [...fleet.robots.values()].every((robot) => robot.scan && robot.pose) && fleet.map;
  }, null, WAIT);
  await other.frames(3);
  const { x, y, yaw } = await page.evaluate(() => globalThis.mixedReality.placement.pose);
  assert.ok(Math.hypot(x, y) < 0.01 && Math.abs(yaw + Math.PI / 2) < 0.01, `the map is at ${x}, ${y}, ${yaw}`);
  // The robots' scans end at the room's surfaces: between the walls of the scan.
  const box = await page.evaluate(() => {
    const { fleet } = globalThis.mixedReality.operator;
    const { origin, width, height, resolution } = fleet.map;
    return [origin.x, origin.y, width * resolution, height * resolution];
  });
  assert.ok(box[2] > 2 && box[2] < 9 && box[3] > 2 && box[3] < 9, `the map is of another room: ${box}`);
  await page.waitForFunction(() => !document.querySelector("#items").textContent.includes("offers its room"), null, WAIT);
  await other.look(inXr(0.2, -1.1, 1.5), inXr(0.1, 0.6, 0));
  await page.evaluate(() => { globalThis.quest.show(); });
  await other.frames(2);
  await page.screenshot({ path: `${out}/page-mr-my-room.png` });
  assert.deepEqual(other.errors.filter((text) => !text.includes("WebSocket")), []);
  await other.close();
});

// While the fleet starts again, the browser reports the sockets that it cannot open.
test("no error was reported", () => assert.deepEqual(headset.errors.filter((text) => !text.includes("WebSocket")), []));
