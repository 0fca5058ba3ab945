// The QR code that `mr-slam up` prints, drawn as a terminal shows it and read back. `.ci/page` prints it into PAGE_QR.

const assert = require("node:assert/strict");
const { readFileSync } = require("node:fs");
const { after, before, test } = require("node:test");
const { launch } = require("./page-browser.cjs");

let browser;
before(async () => { browser = await launch(); });
after(() => browser.close());

/** Colours of terminals: text and background. */
const TERMINALS = { dark: ["#dddddd", "#101010"], light: ["#202020", "#fdfdfd"] };
/** Select Graphic Rendition (ECMA-48): text bright white on black. */
const WHITE_ON_BLACK = "\u001b[97;40m";

/** Draws the code as a terminal of these colours shows it, and returns the text in it. */
async function readCode(lines, [foreground, background], name) {
  const page = await browser.newPage({ viewport: { width: 700, height: 500 } });
  const escape = (text) => text.replace(/\u001b\[[\d;]*m/g, "");
  const rows = lines.map((line) => {
    const [text, ground] = line.includes(WHITE_ON_BLACK) ? ["#ffffff", "#000000"] : [foreground, background];
    return `<span style="color:${text};background:${ground};display:inline-block">${escape(line)}</span>`;
  });
  // Half blocks fill their halves of a character: 8 by 16 pixels, as modules of 8 by 8.
  await page.setContent(`<body style="margin:30px;background:${background}"><pre style="font:16px/16px 'DejaVu Sans Mono';margin:0">${rows.join("\n")}</pre>`);
  const png = await page.screenshot({ path: `${process.env.PAGE_OUT}/qr-${name}.png` });
  await page.addScriptTag({ path: require.resolve("jsqr") });
  const text = await page.evaluate(async (base64) => {
    const image = await createImageBitmap(await (await fetch(`data:image/png;base64,${base64}`)).blob());
    const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
    context.drawImage(image, 0, 0);
    const { data, width, height } = context.getImageData(0, 0, image.width, image.height);
    // Telephones' cameras read no inverted codes.
    return globalThis.jsQR(data, width, height, { inversionAttempts: "dontInvert" })?.data;
  }, png.toString("base64"));
  await page.close();
  return text;
}

for (const [name, colours] of Object.entries(TERMINALS)) {
  test(`the printed QR code leads to the printed URL, in a ${name} terminal`, async () => {
    const lines = readFileSync(process.env.PAGE_QR, "utf8").split(/\r?\n/);
    const url = lines.map((line) => /on a headset: +(https:\S+)/.exec(line)?.[1]).find(Boolean);
    const code = lines.filter((line) => /[▀▄█]{3}/.test(line));
    assert.ok(url && code.length > 10, `a URL and a code were printed: ${lines.slice(0, 8).join("\n")}`);
    assert.equal(await readCode(code, colours, name), url);
  });
}
