// An automatic check of accessibility (axe-core, WCAG 2.2 AA) of the page: dark and light, on a desk and on a phone.

const assert = require("node:assert/strict");
const { readFileSync } = require("node:fs");
const { after, before, test } = require("node:test");
const { launch, open } = require("./page-browser.cjs");

const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"];

/** What axe-core finds on a page, as text. */
async function violations(page) {
  const found = await page.evaluate((values) => globalThis.axe.run({ runOnly: { type: "tag", values } }), TAGS);
  return found.violations.map(({ id, nodes }) => `${id}: ${nodes.map((node) => `${node.html.slice(0, 90)} (${node.failureSummary})`).join("; ")}`);
}

let browser;
before(async () => { browser = await launch(); });
after(() => browser.close());

for (const colorScheme of ["dark", "light"]) {
  for (const [name, viewport] of [["a desk", { width: 1280, height: 800 }], ["a phone", { width: 390, height: 844 }]]) {
    test(`the page is accessible in ${colorScheme} colours on ${name}`, async () => {
      const { page } = await open(browser, { colorScheme, viewport, hasTouch: viewport.width < 500 });
      await page.screenshot({ path: `${process.env.PAGE_OUT}/page-${colorScheme}-${viewport.width}.png` });
      await page.evaluate(() => document.querySelectorAll("details").forEach((details) => { details.open = true; }));
      await page.keyboard.press("Digit1");
      await page.evaluate(axe);
      assert.deepEqual(await violations(page), []);
      // As when no data come: the next ones do not bring the colours back.
      await page.evaluate(() => document.querySelectorAll(".rows").forEach((rows) => {
        rows.classList.add("stale");
        rows.classList.toggle = () => true;
      }));
      assert.deepEqual(await violations(page), []);
    });
  }
}
