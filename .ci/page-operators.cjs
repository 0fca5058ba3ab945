// Several operators of one fleet: two pages and a ros_tcp client contend for a robot. `.ci/page` starts the fleet.

const assert = require("node:assert/strict");
const { execFileSync } = require("node:child_process");
const net = require("node:net");
const { after, before, test } = require("node:test");
const { WAIT, driverOf, launch, open, waitForDriver, waitForText, watchSpeed } = require("./page-browser.cjs");

const { PAGE_PORT: port, PAGE_PROGRAM: program, PAGE_RUN: run } = process.env;
let browser;
before(async () => { browser = await launch(); });
after(() => browser.close());

/** A ros_tcp client, such as Unity's. */
class TcpClient {
  static async connect() {
    const client = new TcpClient();
    client.socket = net.connect({ port: Number(port), host: "127.0.0.1", noDelay: true });
    client.notices = "";
    client.socket.on("data", (data) => { client.notices += data.toString("latin1"); });
    client.socket.on("error", () => {});
    await new Promise((resolve) => { client.socket.once("connect", resolve); });
    client.address = `127.0.0.1:${client.socket.localPort}`;
    return client;
  }

  send(name, payload) {
    const [head, length] = [Buffer.alloc(4), Buffer.alloc(4)];
    head.writeUInt32LE(Buffer.byteLength(name));
    length.writeUInt32LE(payload.length);
    this.socket.write(Buffer.concat([head, Buffer.from(name), length, payload]));
  }

  publish(topic, type) { this.send("__publish", Buffer.from(JSON.stringify({ topic, message_name: type }))); }

  /** Drives a robot at this turning rate, rad/s, until it is stopped. */
  drive(topic, turning) {
    this.publish(topic, "geometry_msgs/Twist");
    const message = Buffer.alloc(4 + 48);
    message[1] = 1;
    message.writeDoubleLE(turning, 4 + 40);
    this.timer = setInterval(() => this.send(topic, message), 50);
  }

  takeControl(robot) {
    this.publish("/take_control", "std_msgs/Int32");
    const message = Buffer.alloc(8);
    message[1] = 1;
    message.writeInt32LE(robot, 4);
    this.send("/take_control", message);
  }

  close() {
    clearInterval(this.timer);
    this.socket.destroy();
  }
}

test("two pages and a ros_tcp client contend for a robot: one drives, all know who, and it is taken over on request alone", async () => {
  const [{ page: first, errors }, { page: second }] = [await open(browser), await open(browser)];
  for (const page of [first, second]) await page.keyboard.press("Digit1");
  await first.keyboard.down("KeyA");
  await waitForDriver(first, 1, "^you$");
  await waitForDriver(second, 1, "^127\\.0\\.0\\.1:");

  // The second page is refused, and says by whom.
  await second.keyboard.down("KeyD");
  await waitForText(second, "#hint", "drives this robot. Press T");
  await second.waitForSelector("#take-over:visible", WAIT);
  assert.equal(await driverOf(first, 1), "you");

  // So is the ros_tcp client.
  const client = await TcpClient.connect();
  client.drive("/cmd_vel_1", 0.5);
  const begun = Date.now();
  while (!client.notices.includes("is driven by") && Date.now() - begun < WAIT.timeout) await new Promise((resolve) => { setTimeout(resolve, 20); });
  assert.match(client.notices, /is driven by/);
  assert.equal(await driverOf(first, 1), "you");

  // The second page takes it over, and holds its key anew; the first one holds its key still and is refused now.
  await second.keyboard.up("KeyD");
  await second.keyboard.press("KeyT");
  await second.keyboard.down("KeyD");
  await waitForDriver(second, 1, "^you$");
  await waitForDriver(first, 1, "^127\\.0\\.0\\.1:");
  await waitForText(first, "#hint", "drives this robot. Press T");

  // The client takes it over from the page: both show the same driver.
  client.takeControl(1);
  for (const page of [first, second]) await waitForDriver(page, 1, `^${client.address}$`);

  // Whoever is gone drives no longer.
  await first.keyboard.up("KeyA");
  await second.keyboard.up("KeyD");
  client.close();
  for (const page of [first, second]) await waitForDriver(page, 1, "^nobody$");
  assert.deepEqual(errors, []);
});

test("the robot obeys the operator who took it over, and no one else", async () => {
  const observer = await watchSpeed(browser);
  const [{ page: first }, { page: second }] = [await open(browser), await open(browser)];
  const goes = (sign) => observer.waitForFunction((wanted) => globalThis.speeds.at(-1)?.[1] * wanted > 0.04, sign, WAIT).catch(async (error) => {
    const hints = await Promise.all([first, second].map((page) => page.textContent("#hint")));
    throw new Error(`${error.message}\nthe operators read: ${hints.join(" | ")}`);
  });
  for (const page of [first, second]) await page.keyboard.press("Digit1");
  await first.keyboard.down("KeyS");
  await goes(-1);
  await second.keyboard.press("KeyT");
  await second.keyboard.down("KeyW");
  await goes(1);
  // The first operator holds the key still: for a second the robot never obeys it again.
  await waitForDriver(first, 1, "^127");
  await first.waitForTimeout(1000);
  const backward = await observer.evaluate(() => globalThis.speeds.slice(-15).filter(([, v]) => v < -0.02).length);
  assert.equal(backward, 0);
  await second.keyboard.up("KeyW");
  await first.keyboard.up("KeyS");
});

/** Figures of `mr-slam status`, as the panels show them. */
function telemetry() {
  const status = JSON.parse(execFileSync(program, ["status", "--run-dir", run, "--json"], { encoding: "utf8" }));
  const known = ([free, occupied, , , , , resolution]) => `${((free + occupied) * resolution ** 2).toFixed(1)} m²`;
  return {
    robots: status.robots.map(({ state, scans_lost: lost, closures, map: { slam_stats: map, coverage } }) => ({
      state, Lost: String(lost), Closures: String(closures), Known: known(map), Cover: `${(coverage * 100).toFixed(0)} %`, Map: `${map[4]} × ${map[5]}`,
    })),
    mapped: known(status.merged_map.slam_stats),
  };
}

/** The same figures, as the page shows them. */
function panels(page) {
  return page.evaluate(() => ({
    robots: [...document.querySelectorAll(".robot")].map((panel) => {
      const rows = Object.fromEntries([...panel.querySelectorAll("dt")].map((heading) => [heading.textContent, heading.nextElementSibling.textContent]));
      const { Lost, Closures, Known, Cover, Map: cells } = rows;
      return { state: panel.querySelector(".badge").textContent, Lost, Closures, Known, Cover, Map: cells };
    }),
    mapped: document.querySelector("#fleet dd").textContent.split(",")[0],
  }));
}

test("the panels show what telemetry counts", async () => {
  const { page } = await open(browser);
  let [shown, counted] = [null, null];
  // Both change once a second, not at the same moment; robots that stand come to rest.
  for (let attempt = 0; attempt < 20; attempt += 1) {
    counted = telemetry();
    shown = await panels(page);
    if (JSON.stringify(shown) === JSON.stringify(counted)) break;
    await page.waitForTimeout(500);
  }
  assert.deepEqual(shown, counted);
  assert.ok(Number.parseFloat(shown.mapped) > 1);
});
