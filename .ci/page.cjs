// The operator's page in Debian's Chromium, against a real fleet. `.ci/page` starts both.

const assert = require("node:assert/strict");
const { execFileSync } = require("node:child_process");
const { readFileSync, readdirSync } = require("node:fs");
const { after, before, test } = require("node:test");
const { chromium } = require("playwright-core");

const { PAGE_URL: url, PAGE_RUN: run, PAGE_OUT: out } = process.env;
/** What has not come by then never comes, ms. */
const WAIT = { timeout: 30_000 };
let browser;

before(async () => {
  browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox"] });
});
after(() => browser.close());

/** Opens the page and waits for the robots; errors of the page fail the test at its end. */
async function open(options = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, colorScheme: "dark", ...options });
  const page = await context.newPage();
  const errors = [];
  page.on("pageerror", (error) => errors.push(error.message));
  page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
  await page.goto(url);
  await page.waitForFunction(() => document.querySelectorAll(".robot .badge.good").length === 2, null, WAIT);
  return { page, errors };
}

const driverOf = (page, robot) => page.locator(".robot").nth(robot - 1).locator("dd").first();
async function waitForText(page, selector, text) {
  await page.waitForFunction(([of, wanted]) => document.querySelector(of).textContent.includes(wanted), [selector, text], WAIT);
}

test("the page shows every robot and the map, and reports no error", async () => {
  const { page, errors } = await open();
  await page.waitForFunction(() => document.querySelector("#fleet").textContent.includes("cells of"), null, WAIT);
  // Free floor is drawn: a colour that is neither the background's nor a robot's.
  await page.waitForFunction(() => {
    const canvas = document.querySelector("#view");
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let free = 0;
    for (let i = 0; i < data.length; i += 4) free += data[i] === 0x2b && data[i + 1] === 0x37 && data[i + 2] === 0x45;
    return free > 2000;
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
  assert.equal(await driverOf(page, 1).textContent(), "nobody");
  assert.match(await page.textContent("#velocity"), /-[1-9.]+ rad/);
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

test("the emergency stop is set by a key, is confirmed, and is released separately", async () => {
  const { page } = await open();
  await page.keyboard.press("Escape");
  await page.waitForSelector("#release:visible", WAIT);
  await waitForText(page, "#log", "confirmed after");
  await page.keyboard.press("Escape");
  await page.click("#release");
  await page.waitForSelector("#release", { state: "hidden", ...WAIT });
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

test("the page connects again when the bridge is killed", async () => {
  const { page } = await open();
  const bridge = readdirSync("/proc").filter((pid) => /^\d+$/.test(pid)).find((pid) => {
    try {
      const line = readFileSync(`/proc/${pid}/cmdline`, "utf8").split("\0");
      return line[2] === "bridge" && line.includes(run);
    } catch {
      return false;
    }
  });
  execFileSync("kill", ["-9", bridge]);
  await waitForText(page, "#link", "no connection");
  await waitForText(page, "#link", "connected");
  await page.waitForFunction(() => document.querySelectorAll(".robot .badge.good").length === 2, null, WAIT);
});
