// README's way to drive: the demo, a robot's number, T, and a key that is held. `.ci/page` starts the demo.

const assert = require("node:assert/strict");
const { after, before, test } = require("node:test");
const { WAIT, launch, open, waitForDriver } = require("./page-browser.cjs");

let browser;
before(async () => { browser = await launch(); });
after(() => browser.close());

test("a robot of the demo is taken from its operator and driven as README says", async () => {
  const { page, errors } = await open(browser, { robots: 3 });
  await page.keyboard.press("Digit1");
  await page.keyboard.press("KeyT");
  await page.keyboard.down("KeyA");
  await waitForDriver(page, 1, "^you$");
  const begun = await page.evaluate(() => mixedReality.operator.fleet.robots.get(1).pose.yaw);
  await page.waitForFunction((from) => {
    const turned = mixedReality.operator.fleet.robots.get(1).pose.yaw - from;
    return Math.abs(Math.atan2(Math.sin(turned), Math.cos(turned))) > 0.5;
  }, begun, WAIT);
  await page.keyboard.up("KeyA");
  assert.deepEqual(errors, []);
  console.log(`# driven ${((Date.now() - Number(process.env.PAGE_BEGUN)) / 1000).toFixed(1)} s after the demo's start`);
});
