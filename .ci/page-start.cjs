// Time from the start of `mr-slam up` to the merged map drawn in a browser, on this machine. `.ci/page OUT figures` prints it.

const { spawn } = require("node:child_process");
const { mkdtempSync, rmSync, writeFileSync } = require("node:fs");
const { connect, createServer } = require("node:net");
const { tmpdir } = require("node:os");
const { WAIT, launch, serveFiles } = require("./page-browser.cjs");

/** Programs that are compared, one start of each in turn. */
const PROGRAMS = [process.env.PAGE_PROGRAM, process.env.PAGE_BEFORE].filter(Boolean);
/** Fleets of each program that are started, one after the other. */
const STARTS = 10;
/** Pause between two attempts to reach the page's port, ms. */
const PAUSE_MS = 5;

/** Returns a TCP port of this machine that nobody has. */
const freePort = () => new Promise((resolve) => {
  const server = createServer();
  server.listen(0, "127.0.0.1", () => {
    const { port } = server.address();
    server.close(() => resolve(port));
  });
});

/** Returns whether somebody listens on a port; Chromium's page about a refused connection would load itself anew. */
const isOpen = (port) => new Promise((resolve) => {
  const socket = connect({ port, host: "127.0.0.1" });
  socket.once("connect", () => { socket.destroy(); resolve(true); });
  socket.once("error", () => setTimeout(resolve, PAUSE_MS, false));
});

/** Starts a fleet, and opens the page as soon as its port is open. Returns when that was and when the map was drawn, ms. */
async function start(browser, program) {
  const [folder, port] = [mkdtempSync(`${tmpdir()}/mr-slam-start-`), await freePort()];
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 } });
  await serveFiles(context, `http://localhost:${port}`);
  const page = await context.newPage();
  const begun = Date.now();
  const options = ["up", "--robots", "3", "--port", "0", "--page", String(port), "--seconds", "60", "--run-dir", `${folder}/run`];
  const fleet = spawn(program, options, { stdio: "ignore" });
  const ended = new Promise((resolve) => { fleet.once("exit", resolve); });
  try {
    while (!(await isOpen(port))) if (Date.now() - begun > WAIT.timeout) throw new Error(`${program}: no page`);
    const opened = Date.now() - begun;
    await page.goto(`http://localhost:${port}`, { waitUntil: "commit" });
    await page.waitForFunction(() => globalThis.mapView?.painted.version > 0, null, WAIT);
    const drawn = await page.evaluate(() => performance.timeOrigin + globalThis.mapView.painted.at);
    return { opened, drawn: drawn - begun };
  } finally {
    fleet.kill("SIGTERM");
    await ended;
    await context.close();
    rmSync(folder, { recursive: true, force: true });
  }
}

const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];

(async () => {
  const browser = await launch();
  const figures = Object.fromEntries(PROGRAMS.map((program) => [program, []]));
  for (let i = 0; i < STARTS; i += 1) for (const program of PROGRAMS) figures[program].push(await start(browser, program));
  await browser.close();
  writeFileSync(`${process.env.PAGE_OUT}/page-start.json`, JSON.stringify(figures, null, 2));
  for (const program of PROGRAMS) {
    const [opened, drawn] = ["opened", "drawn"].map((name) => figures[program].map((times) => times[name]));
    const ms = (value) => `${value.toFixed(0)} ms`;
    console.log(`mr-slam up started to port open            P50 ${ms(median(opened))}, max ${ms(Math.max(...opened))}   (${opened.length})`);
    console.log(`mr-slam up started to map drawn            P50 ${ms(median(drawn))}, max ${ms(Math.max(...drawn))}   (${drawn.length}; target <= 1000 ms)`);
  }
})();
