// Figures of the operator's page on this machine: latency of commands, time to the drawn map, size. `.ci/page OUT figures` prints them.

const { readFileSync, readdirSync, writeFileSync } = require("node:fs");
const { gzipSync } = require("node:zlib");
const { launch, open, serveFiles, url } = require("./page-browser.cjs");

/** Commands whose way is measured. */
const COMMANDS = 200;
/** Pages that are opened, one after the other. */
const OPENINGS = 10;
/** Time over which the bridge's load is measured, ms. */
const LOAD_MS = 20_000;
const percentile = (values, share) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(share * values.length))];

/** Velocities from the page, through the bridge's gate, and back as what the robot is sent: ms. The robot gets each at the same time. */
async function commandTimes(browser) {
  const { page } = await open(browser, { robots: 3 });
  const times = await page.evaluate(async (count) => {
    const { Connection } = await import("./transport.js");
    const { writeTwist } = await import("./messages.js");
    let answered = () => {};
    const connection = new Connection(location.origin.replace("http", "ws"), { message: (_, view) => answered(view.getFloat64(4 + 40, true)) });
    connection.subscribe("/robot1/cmd_vel");
    const results = [];
    for (let i = 0; i < count + 5; i += 1) {
      const turning = (i % 2 ? 1 : -1) * (0.1 + (i % 100) * 0.001);
      const at = performance.now();
      const took = new Promise((resolve) => { answered = (value) => { if (Math.abs(value - turning) < 1e-9) resolve(performance.now() - at); }; });
      while (!connection.publish("/robot1/cmd_vel", "geometry_msgs/msg/Twist", writeTwist(0, turning))) await new Promise((resolve) => { setTimeout(resolve, 20); });
      const result = await Promise.race([took, new Promise((resolve) => { setTimeout(() => resolve(1000), 1000); })]);
      // The first ones open the connection.
      if (i >= 5) results.push(result);
      await new Promise((resolve) => { setTimeout(resolve, 50); });
    }
    return results;
  }, COMMANDS);
  await page.context().close();
  return times;
}

/** From the page's address entered to the drawn map, in a browser that has nothing stored: ms. */
async function openingTimes(browser) {
  const times = [];
  for (let i = 0; i < OPENINGS; i += 1) {
    const context = await browser.newContext({ viewport: { width: 1280, height: 800 } });
    await serveFiles(context, url);
    const page = await context.newPage();
    await page.goto(url, { waitUntil: "commit" });
    await page.waitForFunction(() => globalThis.mapView?.painted.version > 0, null, { timeout: 30_000 });
    times.push(await page.evaluate(() => globalThis.mapView.painted.at));
    await context.close();
  }
  return times;
}

/** Returns the processor time that the fleet's bridge has used, seconds. */
function bridgeTime() {
  const bridge = readdirSync("/proc").filter((pid) => /^\d+$/.test(pid)).find((pid) => {
    try {
      const line = readFileSync(`/proc/${pid}/cmdline`, "utf8").split("\0");
      return line[2] === "bridge" && line.includes(process.env.PAGE_RUN);
    } catch {
      return false;
    }
  });
  // Behind the name in brackets: utime and stime are the 14th and the 15th field (proc_pid_stat(5)), in ticks of 10 ms.
  const fields = readFileSync(`/proc/${bridge}/stat`, "utf8").split(") ")[1].split(" ");
  return (Number(fields[11]) + Number(fields[12])) / 100;
}

/** Share of one core that the bridge takes while a robot is driven from the console, and without a console: 0 to 1. */
async function bridgeLoad(browser) {
  const measure = async () => {
    const [begun, before] = [performance.now(), bridgeTime()];
    await new Promise((resolve) => { setTimeout(resolve, LOAD_MS); });
    return (bridgeTime() - before) / ((performance.now() - begun) / 1000);
  };
  const alone = await measure();
  const { page } = await open(browser, { robots: 3 });
  await page.keyboard.press("Digit1");
  await page.keyboard.down("KeyA");
  const withConsole = await measure();
  await page.keyboard.up("KeyA");
  await page.context().close();
  return { alone, withConsole };
}

/** Bytes of the whole page, compressed file by file. */
function pageBytes() {
  const folder = `${__dirname}/../page`;
  const files = readdirSync(folder).filter((name) => name.includes("."));
  return files.reduce((sum, name) => sum + gzipSync(readFileSync(`${folder}/${name}`), { level: 9 }).length, 0);
}

(async () => {
  const browser = await launch();
  const load = await bridgeLoad(browser);
  const [commands, openings] = [await commandTimes(browser), await openingTimes(browser)];
  await browser.close();
  const figures = {
    command_ms: { p50: percentile(commands, 0.5), p95: percentile(commands, 0.95), max: Math.max(...commands), count: commands.length },
    page_to_map_ms: { p50: percentile(openings, 0.5), max: Math.max(...openings), count: openings.length },
    page_gzip_bytes: pageBytes(),
    bridge_core_share: { alone: load.alone, with_console: load.withConsole },
  };
  writeFileSync(`${process.env.PAGE_OUT}/page.json`, JSON.stringify(figures, null, 2));
  const ms = (value) => `${value.toFixed(1)} ms`;
  console.log(`command, page to bridge's gate and back   P50 ${ms(figures.command_ms.p50)}, P95 ${ms(figures.command_ms.p95)}, max ${ms(figures.command_ms.max)}   (${commands.length}; target P95 <= 10 ms)`);
  console.log(`page opened to map drawn                  P50 ${ms(figures.page_to_map_ms.p50)}, max ${ms(figures.page_to_map_ms.max)}   (${openings.length}; target <= 1000 ms)`);
  const percent = (share) => `${(100 * share).toFixed(1)} %`;
  console.log(`bridge, of one core                       ${percent(load.withConsole)} with one console that drives, ${percent(load.alone)} without   (target <= 8 %)`);
  console.log(`page, gzip                                ${(figures.page_gzip_bytes / 1000).toFixed(1)} kB   (target <= 120 kB)`);
})();
