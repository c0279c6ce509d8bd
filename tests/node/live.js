// Opens the page of a room in headless Chromium, once or several times, and says what it shows.
// Usage: live.js CHROMIUM JOB.json
// A job: {url, pages: [{width, height, shot: FILE, hash, send: bool, hands}], seconds, video: FILE.y4m (fake camera), steps, again}.
// Steps are conditions on the first page's `state`; a line `step N` on standard output says that the next has come true.
// `again`: so many times the first page is opened anew in its browser, which then runs, with nothing kept of the times before.
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
  if (job.again) {
    await pages[0].page.context().close();
    told[0].again = [];
    for (let n = 0; n < job.again; n += 1) told[0].again.push(await joined(browsers[0], job.pages[0]));
  }
  console.log(JSON.stringify(told));
} finally {
  await Promise.all(browsers.map(browser => browser.close()));
}
