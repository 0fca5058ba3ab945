// Fleets that follow each other on one port, below a page that stays open. It starts them itself.

const assert = require("node:assert/strict");
const { spawn } = require("node:child_process");
const { openSync, readFileSync, rmSync } = require("node:fs");
const { after, before, test } = require("node:test");
const { setTimeout: sleep } = require("node:timers/promises");
const { WAIT, launch, open, waitForRobots } = require("./page-browser.cjs");

const { PAGE_OUT: out, PAGE_PROGRAM: program, PAGE_RUN: folder } = process.env;
let browser;
const fleets = [];
before(async () => { browser = await launch(); });
after(async () => {
  await browser.close();
  await Promise.all(fleets.map(end));
});

/** Starts a fleet whose page is on this port; 0: any. Returns it with the URL of its page. */
async function start(name, port, options) {
  const [log, run] = [`${out}/runs-${name}.log`, `${folder}-${name}`];
  const output = openSync(log, "w");
  const process = spawn(program, ["up", "--port", "0", "--page", String(port), "--seconds", "600", "--run-dir", run, ...options], { stdio: ["ignore", output, output] });
  const fleet = { process, run, url: "" };
  fleets.push(fleet);
  for (const begun = Date.now(); Date.now() - begun < WAIT.timeout; await sleep(200)) {
    fleet.url = /http:\/\/localhost:\d+/.exec(readFileSync(log, "utf8"))?.[0] ?? "";
    if (fleet.url) return fleet;
  }
  throw new Error(`the fleet ${name} printed no URL`);
}

/** Ends a fleet, and waits until it has ended. */
async function end(fleet) {
  const ended = new Promise((resolve) => { fleet.process.once("exit", resolve); });
  if (fleet.process.exitCode === null && fleet.process.kill("SIGINT")) await ended;
  rmSync(fleet.run, { recursive: true, force: true });
}

/** What a page shows of robots. */
const shown = (page) => page.evaluate(() => ({
  names: [...document.querySelectorAll(".robot .name")].map((name) => name.textContent),
  target: document.querySelector("#target").textContent,
  attention: document.querySelector("#items").textContent,
}));

test("a page that stays open shows the fleet that is there, and drives its robots", async () => {
  const first = await start("first", 0, ["--robots", "3", "--explore"]);
  const { page } = await open(browser, { base: first.url, robots: 3 });
  await page.waitForFunction(() => {
    const { fleet } = mixedReality.operator;
    return fleet.map && [...fleet.robots.values()].every(({ trail }) => trail.length > 2);
  }, null, WAIT);
  await page.keyboard.press("Digit3");
  // A page that slept knows an early time of its run: that of the next one is not behind it.
  await page.evaluate(() => {
    const { fleet } = mixedReality.operator;
    fleet.setRunTime = (askedAt, answeredAt, runTime) => { fleet.clock.add(askedAt, answeredAt, runTime); return false; };
    globalThis.oldEnd = performance.now() / 1000;
  });
  await end(first);
  const second = await start("second", new URL(first.url).port, ["--robots", "2", "--names", "alice,bob", "--room", "flat:3"]);
  assert.equal(second.url, first.url);
  await page.waitForFunction(() => document.querySelectorAll(".robot").length === 2, null, WAIT);
  await waitForRobots(page, 2);
  const { names, target, attention } = await shown(page);
  assert.deepEqual(names, ["1 · alice", "2 · bob"]);
  assert.equal(target, "no robot selected");
  assert.doesNotMatch(attention, /robot\d/);
  await page.waitForFunction(() => mixedReality.operator.fleet.map && mixedReality.operator.fleet.area.length > 0, null, WAIT);
  const left = await page.evaluate(() => {
    const { fleet } = mixedReality.operator;
    const robots = [...fleet.robots.values()];
    return { isExploring: fleet.exploration?.state === "exploring", trails: robots.map(({ trail }) => trail.length), isNew: fleet.area.every(({ at }) => at > globalThis.oldEnd) };
  });
  // Nobody drives in the second fleet.
  assert.deepEqual(left, { isExploring: false, trails: [1, 1], isNew: true });
  await page.screenshot({ path: `${out}/page-runs.png` });

  await page.keyboard.press("Digit1");
  const yaw = () => page.evaluate(() => mixedReality.operator.fleet.robots.get(1).pose.yaw);
  const begun = await yaw();
  await page.keyboard.down("KeyA");
  await page.waitForFunction((from) => Math.abs(mixedReality.operator.fleet.robots.get(1).pose.yaw - from) > 0.2, begun, WAIT);
  await page.keyboard.up("KeyA");
});
