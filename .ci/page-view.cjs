// The operator's view and the attention list in Chromium, against a real fleet. `.ci/page` starts both.

const assert = require("node:assert/strict");
const { after, before, test } = require("node:test");
const { WAIT, launch, open, waitForText } = require("./page-browser.cjs");

const { PAGE_OUT: out } = process.env;
/** Half the side of the square in the middle of the map in which a followed robot is looked for, pixels. */
const MIDDLE_PX = 10;
/** Colours of the first two robots. */
const COLOURS = [[0xe6, 0x9f, 0x00], [0x3a, 0x9a, 0xd9]];
let browser;
before(async () => { browser = await launch(); });
after(() => browser.close());

/** Returns the share of a robot's colour in the middle of the map, 0 to 1. */
function shareInTheMiddle(page, robot) {
  return page.evaluate(([half, colour]) => {
    const canvas = document.querySelector("#view");
    const [x, y] = [canvas.width / 2 - half, canvas.height / 2 - half].map(Math.round);
    const { data } = canvas.getContext("2d").getImageData(x, y, 2 * half, 2 * half);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) if (colour.every((value, k) => Math.abs(data[i + k] - value) < 3)) count += 1;
    return count / (data.length / 4);
  }, [MIDDLE_PX, COLOURS[robot - 1]]);
}

/** Returns where a robot is in the map, metres. */
const poseOf = (page, robot) => page.evaluate((number) => ({ ...mixedReality.operator.fleet.robots.get(number).pose }), robot);

test("the view follows a robot that drives, changes with the selection, and ends when the map is moved", async () => {
  const { page, errors } = await open(browser);
  // Without a selected robot nothing is followed, and the page says why.
  await page.keyboard.press("KeyC");
  await waitForText(page, "#log", "select the robot to follow first");
  assert.equal(await page.getAttribute("#fit", "aria-pressed"), "true");

  await page.keyboard.press("Digit1");
  for (let i = 0; i < 3; i += 1) await page.keyboard.press("Equal");
  await page.keyboard.press("KeyC");
  assert.equal(await page.getAttribute("#follow", "aria-pressed"), "true");
  const begun = await poseOf(page, 1);
  await page.keyboard.down("KeyS");
  const shares = [];
  await page.waitForFunction(({ x, y }) => {
    const pose = mixedReality.operator.fleet.robots.get(1).pose;
    return Math.hypot(pose.x - x, pose.y - y) > 0.15;
  }, begun, WAIT);
  for (let i = 0; i < 5; i += 1) {
    shares.push(await shareInTheMiddle(page, 1));
    await page.waitForTimeout(50);
  }
  await page.keyboard.up("KeyS");
  assert.ok(shares.every((share) => share > 0.3), `the robot is in the middle while it drives: ${shares}`);
  await page.screenshot({ path: `${out}/page-follow.png` });

  // The other robot, once it is selected.
  await page.keyboard.press("Digit2");
  await page.waitForFunction(() => mapView.followed === 2, null, WAIT);
  await page.waitForTimeout(100);
  assert.ok(await shareInTheMiddle(page, 2) > 0.3);
  assert.ok(await shareInTheMiddle(page, 1) < 0.3);

  // A hand on the map ends it: the robot is where the map was drawn to.
  const box = await page.locator("#view").boundingBox();
  const middle = { x: box.x + box.width / 2, y: box.y + box.height / 2 };
  await page.mouse.move(middle.x, middle.y);
  await page.mouse.down();
  await page.mouse.move(middle.x + 150, middle.y + 80, { steps: 4 });
  await page.mouse.up();
  assert.equal(await page.getAttribute("#follow", "aria-pressed"), "false");
  await page.waitForTimeout(100);
  assert.equal(await shareInTheMiddle(page, 2), 0);
  assert.deepEqual(errors, []);
});

test("an alarm that is acknowledged is hidden until it comes again, and leads to its robot", async () => {
  const { page, errors } = await open(browser);
  const alarm = page.locator("#items li", { hasText: "its way is blocked" });
  /** Sends the second robot out of the room. */
  const sendAway = () => page.evaluate(() => {
    const { operator } = mixedReality;
    operator.select(2);
    operator.floorSelected({ x: 60, y: 60 });
  });
  await sendAway();
  await alarm.waitFor(WAIT);
  await page.screenshot({ path: `${out}/page-alarm.png` });

  // Its text leads to the robot.
  await page.keyboard.press("Digit1");
  await alarm.locator("button").first().click();
  await waitForText(page, "#target", "2 ·");
  const [at, middle] = await page.evaluate(() => {
    const { camera } = mapView;
    return [camera.toScreen(mixedReality.operator.fleet.robots.get(2).pose), { x: camera.width / 2, y: camera.height / 2 }];
  });
  assert.ok(Math.hypot(at.x - middle.x, at.y - middle.y) < 5, "the map shows the robot in the middle");

  // Acknowledged, it stays away while it lasts.
  await alarm.locator("button.acknowledge").click();
  await alarm.waitFor({ state: "detached", ...WAIT });
  await waitForText(page, "#items", "nothing new, 1 acknowledged");
  await page.waitForTimeout(1000);
  assert.equal(await alarm.count(), 0);
  const state = () => page.evaluate(() => mixedReality.operator.fleet.robots.get(2).navigation?.state);
  assert.equal(await state(), "blocked", "the alarm lasts, though it is hidden");

  // It ends, and comes again.
  await page.evaluate(() => {
    const { operator } = mixedReality;
    operator.floorSelected(operator.fleet.robots.get(2).pose);
  });
  await page.waitForFunction(() => mixedReality.operator.fleet.robots.get(2).navigation?.state !== "blocked", null, WAIT);
  await page.waitForFunction(() => document.querySelector("#items").textContent === "nothing", null, WAIT);
  await sendAway();
  await alarm.waitFor(WAIT);
  assert.deepEqual(errors, []);
});

test("a goal and a zone are set by keyboard alone, and the arrows drive nothing meanwhile", async () => {
  const { page, errors } = await open(browser);
  await page.keyboard.press("Digit1");
  await waitForText(page, "#target", "1 ·");
  const hasFocus = () => page.evaluate(() => document.activeElement.id);
  // As a person finds it who has no pointer: the button, then the map.
  await page.focus("#goal");
  await page.keyboard.press("Enter");
  assert.equal(await hasFocus(), "view");
  // The robot is where the cursor is sent to: its goal is reached at once, wherever it stands.
  await page.evaluate(() => {
    const { fleet } = mixedReality.operator;
    const { x, y } = fleet.robots.get(1).pose;
    mapView.cursor.at = { x, y: y + 0.1 };
  });
  for (const key of ["ArrowDown", "Enter", "Enter"]) await page.keyboard.press(key);
  await page.waitForFunction(() => mixedReality.operator.fleet.robots.get(1).sentGoal?.isAccepted, null, WAIT);
  assert.equal(await page.textContent("#velocity"), "0.00 m/s, 0.0 rad/s");
  assert.equal(await page.getAttribute("#goal", "aria-pressed"), "false");

  await page.keyboard.press("KeyZ");
  await page.evaluate(() => { mapView.cursor.at = { x: 40, y: 40 }; });
  await page.keyboard.press("Enter");
  await page.keyboard.press("Shift+ArrowRight");
  await page.keyboard.press("Shift+ArrowUp");
  await waitForText(page, "#hint", "41.0 m, 41.0 m: arrows draw");
  await page.screenshot({ path: `${out}/page-cursor.png` });
  await page.keyboard.press("Enter");
  const zones = () => page.evaluate(() => mixedReality.operator.fleet.zones.length);
  await page.waitForFunction(() => mixedReality.operator.fleet.zones.length === 1, null, WAIT);
  // Enter twice at one place removes the zone there.
  await page.evaluate(() => { mapView.cursor.at = { x: 40.5, y: 40.5 }; });
  await page.keyboard.press("Enter");
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => mixedReality.operator.fleet.zones.length === 0, null, WAIT);
  assert.equal(await zones(), 0);
  assert.deepEqual(errors, []);
});

test("only the primary button acts on the map, and a drag that ends beside the map sends nothing", async () => {
  const { page, errors } = await open(browser);
  await page.keyboard.press("Digit1");
  await waitForText(page, "#target", "1 ·");
  const box = await page.locator("#view").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const state = () => page.evaluate(() => [mixedReality.operator.fleet.robots.get(1).sentGoal, mixedReality.operator.fleet.zones.length, { ...mapView.camera.center }]);
  for (const tool of ["KeyG", "KeyZ", "KeyF"]) {
    await page.keyboard.press(tool);
    await page.evaluate(() => { mapView.fits = false; });
    const before = await state();
    for (const button of ["right", "middle"]) {
      await page.mouse.move(x, y);
      await page.mouse.down({ button });
      await page.mouse.move(x + 60, y + 60, { steps: 3 });
      await page.mouse.up({ button });
    }
    assert.deepEqual(await state(), before, tool);
    if (tool === "KeyZ") await page.keyboard.press(tool);
  }
  const stick = await page.locator("#stick").boundingBox();
  await page.mouse.move(stick.x + stick.width / 2, stick.y + 8);
  await page.mouse.down({ button: "right" });
  await page.waitForTimeout(150);
  assert.match(await page.textContent("#velocity"), /^0.00 m/);
  await page.mouse.up({ button: "right" });

  for (const [tool, what] of [["KeyG", "goal"], ["KeyZ", "zone"]]) {
    const before = await state();
    await page.keyboard.press(tool);
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width + 40, y + 80, { steps: 4 });
    await page.mouse.up();
    await waitForText(page, "#log", `the ${what} was not sent`);
    assert.deepEqual(await state(), before, what);
    await page.keyboard.press(tool);
  }
  assert.deepEqual(errors, []);
});

test("the attention list keeps its buttons and the focus while its numbers change", async () => {
  const { page } = await open(browser);
  const kept = await page.evaluate(async () => {
    const { fleet } = mixedReality.operator;
    let age = 1;
    fleet.attention = () => [1, 2].map((robot) => ({ rank: 3, robot, text: `no scan for ${age} s`, key: `scan ${robot}` }));
    const shows = async (text) => { while (!document.querySelector("#items").textContent.includes(text)) await new Promise(requestAnimationFrame); };
    await shows("for 1 s");
    const button = document.querySelectorAll("#items .acknowledge")[1];
    button.focus();
    age = 2;
    await shows("for 2 s");
    return [button.isConnected, document.activeElement === button];
  });
  assert.deepEqual(kept, [true, true]);
});
