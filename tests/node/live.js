// Opens the page of a room in headless Chromium, once or several times, and says what it shows.
// Usage: live.js CHROMIUM JOB.json
// A job: {url, pages: [{width, height, shot: FILE, hash, send: bool, hands}], seconds, video: FILE.y4m (fake camera), steps, again,
// smooth, lose}.
// Steps are conditions on the first page's `state`; a line `step N` on standard output says that the next has come true.
// `again`: so many times the first page is opened anew in its browser, which then runs, with nothing kept of the times before.
// `smooth`: sizes of the first page's view at which its picture with samples is compared with that without; `lose`: once more when
// its context has been lost and given back.
// Prints one JSON object: for each page its state, what was drawn, console messages, and addresses asked for; of the first also
// `again`, how long each of these times took to the first hand.
import { readFileSync } from "node:fs";
import { chromium } from "playwright-core";
import { complaints, until } from "./browser.js";

const [executablePath, file] = process.argv.slice(2);
const job = JSON.parse(readFileSync(file, "utf8"));
const args = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
if (job.video) {
  args.push("--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream", `--use-file-for-fake-video-capture=${job.video}`);
}
const browsers = [];

// Milliseconds that a page of a running browser takes to its first hand, from asking for the room.
async function joined(browser, { width, height, hash }) {
  const context = await browser.newContext({ viewport: { width, height }, hasTouch: true });
  const page = await context.newPage();
  await page.goto(job.url + (hash ?? ""));
  await until(page, "window.handcast && window.handcast.state().joined !== null", job.patience);
  const took = await page.evaluate("window.handcast.state().joined");
  await context.close();
  return took;
}

// How a page's picture with samples differs from the one without, of the same moment.
function smoothed() {
  const { room, painter, picture, sharpness } = window.handcast;
  const now = room.now();
  room.now = () => now;
  // What is in the picture changes by and by, but for the first one.
  document.getElementById("reset").click();
  sharpness.share = 1;
  const canvas = document.getElementById("hand");
  const pixels = () => {
    picture();
    const copy = document.createElement("canvas");
    [copy.width, copy.height] = [canvas.width, canvas.height];
    const context = copy.getContext("2d");
    context.drawImage(canvas, 0, 0);
    return context.getImageData(0, 0, copy.width, copy.height).data;
  };
  const smooth = pixels();
  const { samples } = painter();
  painter().samples = null;
  const rough = pixels();
  painter().samples = samples;
  delete room.now;
  const told = { size: [canvas.width, canvas.height], covered: 0, smooth: 0, rough: 0, within: 0, differ: 0 };
  const partly = alpha => alpha > 0 && alpha < 255;
  let inside = 0;
  for (let i = 0; i < smooth.length; i += 4) {
    const [a, b] = [smooth[i + 3], rough[i + 3]];
    if (b) told.covered += 1;
    if (partly(a)) told.smooth += 1;
    if (partly(b)) told.rough += 1;
    if ((a === 255 && b === 0) || (a === 0 && b === 255)) told.differ += 1;
    if (a !== 255 || b !== 255) continue;
    inside += 1;
    for (let k = 0; k < 3; k += 1) told.within += Math.abs(smooth[i + k] - rough[i + k]) / 3;
  }
  told.within /= inside;
  told.differ /= told.covered;
  return samples ? told : { ...told, smooth: 0 };
}

// A page's context is lost and given back. Meanwhile hands are sketched.
async function lose() {
  const { painter, state } = window.handcast;
  const context = painter().gl.getExtension("WEBGL_lose_context");
  const frames = async ready => {
    for (let n = 0; n < 600 && !ready(); n += 1) await new Promise(requestAnimationFrame);
    if (!ready()) throw new Error("the context is lost for good");
  };
  // It can be given back once the page has been told.
  const told = new Promise(done => document.getElementById("hand").addEventListener("webglcontextlost", done));
  context.loseContext();
  await told;
  await frames(() => painter().gl.isContextLost() && !document.getElementById("sketch").hidden);
  await new Promise(done => setTimeout(done));
  context.restoreContext();
  await frames(() => !painter().gl.isContextLost() && state().hands.length && document.getElementById("sketch").hidden);
}

try {
  const pages = [];
  for (const wanted of job.pages) {
    // Each in a browser of its own: drawn without a GPU, pages of one browser hold each other up for half a minute.
    const browser = await chromium.launch({ executablePath, args });
    browsers.push(browser);
    const context = await browser.newContext({ viewport: { width: wanted.width, height: wanted.height }, hasTouch: true });
    const page = await context.newPage();
    const messages = complaints(page, /GPU stall/);
    const requests = [];
    page.on("request", r => { if (!/^(data|blob):/.test(r.url())) requests.push(r.url()); });
    const begun = Date.now();
    await page.goto(job.url + (wanted.hash ?? ""));
    await until(page, "window.handcast?.state().open");
    if (wanted.send) await page.click("#send");
    const hands = wanted.hands ?? job.hands ?? 1;
    await until(page, `window.handcast.state().hands.length >= ${hands}`, job.patience);
    await until(page, "window.handcast.state().joined !== null", job.patience);
    pages.push({ page, messages, requests, wanted, joined: Date.now() - begun });
  }
  for (const [number, step] of (job.steps ?? []).entries()) {
    await until(pages[0].page, `(state => ${step})(window.handcast.state())`, job.patience);
    console.log(`step ${number}`);
  }
  await pages[0].page.waitForTimeout(1000 * (job.seconds ?? 3));
  const told = [];
  for (const { page, messages, requests, wanted, joined } of pages) {
    const state = await page.evaluate("window.handcast.state()");
    const drawn = await page.evaluate("window.handcast.drawn()");
    const overflow = await page.evaluate("document.documentElement.scrollWidth - innerWidth");
    const text = await page.evaluate("[...document.querySelectorAll('.readout, #facts')].map(e => e.textContent)");
    if (wanted.shot) await page.screenshot({ path: wanted.shot });
    told.push({ state, drawn, messages, requests, joined, overflow, text });
  }
  if (job.smooth) {
    const [{ page }] = pages;
    told[0].smooth = [];
    for (const [width, height] of job.smooth) {
      await page.setViewportSize({ width, height });
      await page.waitForTimeout(500);
      told[0].smooth.push(await page.evaluate(smoothed));
    }
    if (job.lose) {
      await page.evaluate(lose);
      told[0].smooth.push(await page.evaluate(smoothed));
    }
  }
  if (job.again) {
    await pages[0].page.context().close();
    told[0].again = [];
    for (let n = 0; n < job.again; n += 1) told[0].again.push(await joined(browsers[0], job.pages[0]));
  }
  console.log(JSON.stringify(told));
} finally {
  await Promise.all(browsers.map(browser => browser.close()));
}
