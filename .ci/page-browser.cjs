// What the checks of the operator's page share: a browser, a page of the fleet, and what is read from it.

const { readFileSync } = require("node:fs");
const { chromium } = require("playwright-core");

const { PAGE_URL: url, PAGE_FILES: folder } = process.env;
const CHROMIUM = "/usr/bin/chromium";
/** What has not come by then never comes, ms. */
const WAIT = { timeout: 30_000 };
const TYPES = { js: "text/javascript", css: "text/css", html: "text/html", svg: "image/svg+xml" };

// Files from a folder have no address, from which Chromium lets nobody connect to this machine.
const BROWSER_ARGS = ["--no-sandbox", ...(folder ? ["--disable-features=LocalNetworkAccessChecks,LocalNetworkAccessChecksWebSockets"] : [])];

const launch = () => chromium.launch({ executablePath: CHROMIUM, args: BROWSER_ARGS });

/** Serves the page's files from a folder instead of the program's: for work on them without a build. */
async function serveFiles(context, base) {
  if (!folder) return;
  await context.route((at) => at.href.startsWith(base), (route) => {
    if (route.request().method() !== "GET") return route.continue();
    const { pathname } = new URL(route.request().url());
    const file = `${folder}/${pathname === "/" ? "index.html" : pathname === "/selfcheck" ? "selfcheck.html" : pathname}`;
    return route.fulfill({ body: readFileSync(file), contentType: TYPES[file.split(".").pop()] });
  });
}

/** Opens the page and waits for the robots; its errors are kept. */
async function open(browser, { sockets = false, base = url, robots = 2, ...options } = {}) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, colorScheme: "dark", ...options });
  await serveFiles(context, base);
  const page = await context.newPage();
  // Keeps the page's sockets, so that a test can break them.
  if (sockets) await page.addInitScript(() => {
    globalThis.sockets = new Set();
    const Socket = globalThis.WebSocket;
    globalThis.WebSocket = class extends Socket {
      constructor(...args) {
        super(...args);
        globalThis.sockets.add(this);
      }
    };
  });
  const errors = [];
  page.on("pageerror", (error) => errors.push(error.message));
  page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
  await page.goto(base);
  explainWaits(page, errors);
  await waitForRobots(page, robots);
  return { page, errors };
}

/** From now on a wait that fails says what the page shows, and its errors. */
function explainWaits(page, errors) {
  const wait = page.waitForFunction.bind(page);
  page.waitForFunction = (...args) => wait(...args).catch(async (error) => {
    throw new Error([error.message, await describe(page).catch(() => "it does not answer"), ...errors].join("\n"));
  });
}

/** Waits until all robots map. One that stands in a corridor does so too: it knows its place in one direction only. */
const waitForRobots = (page, robots, wait = WAIT) => page.waitForFunction((count) => {
  const states = [...document.querySelectorAll(".robot .badge")].map((badge) => badge.textContent);
  return states.filter((state) => ["tracking", "degenerate"].includes(state)).length === count;
}, robots, wait);

/** Says what a page shows of the link and of the robots, and whether it draws. */
const describe = (page) => page.evaluate(async () => {
  const drawn = new Promise((resolve) => { requestAnimationFrame(() => resolve("draws")); });
  const late = new Promise((resolve) => { setTimeout(resolve, 5000, "does not draw"); });
  return [await Promise.race([drawn, late]), ...[...document.querySelectorAll("#link, #fleet, #log, .robot")].map((element) => element.innerText.replaceAll("\n", " "))].join("\n");
});

/** Waits until the text of an element contains another one. */
async function waitForText(page, selector, text) {
  await page.waitForFunction(([of, wanted]) => document.querySelector(of).textContent.includes(wanted), [selector, text], WAIT);
}

/** Returns who drives a robot, as the page shows it. */
const driverOf = (page, robot) => page.locator(".robot").nth(robot - 1).locator("dd").first().textContent();

/** Waits until the page shows a driver of a robot. */
async function waitForDriver(page, robot, pattern) {
  await page.waitForFunction(([of, wanted]) => new RegExp(wanted).test(document.querySelectorAll(".robot")[of - 1].querySelector("dd").textContent), [robot, pattern], WAIT);
}

/**
 * Records a robot's speed in a page of its own, in `speeds`: when it was measured on this machine's clock, ms, and m/s. The time is the
 * stamp of the odometry plus the least delay so far, so that how late a busy browser reads a message does not count.
 */
async function watchSpeed(browser, robot = 1) {
  const { page } = await open(browser);
  await page.evaluate(async (number) => {
    const { Connection } = await import("./transport.js");
    const { CdrReader } = await import("./cdr.js");
    globalThis.speeds = [];
    let delayMs = Infinity;
    const message = (topic, view) => {
      const from = new CdrReader(view);
      const { stamp } = from.header();
      from.string();
      // Pose and its covariance, before the velocity.
      for (let i = 0; i < 7 + 36; i += 1) from.f64();
      delayMs = Math.min(delayMs, performance.timeOrigin + performance.now() - stamp * 1000);
      globalThis.speeds.push([stamp * 1000 + delayMs, from.f64()]);
    };
    new Connection(location.origin.replace("http", "ws"), { message }).subscribe(`/robot${number}/odom`);
  }, robot);
  return page;
}

module.exports = { BROWSER_ARGS, CHROMIUM, WAIT, driverOf, explainWaits, launch, open, serveFiles, url, waitForDriver, waitForRobots, waitForText, watchSpeed };
