// Opens the page of a room in headless Chromium, once or several times, and says what it shows.
// Usage: live.js CHROMIUM JOB.json
// A job: {url, pages: [{width, height, shot: FILE, hash, send: bool, hands}], seconds, video: FILE.y4m (fake camera), steps}.
// Steps are conditions on the first page's `state`; a line `step N` on standard output says that the next has come true.
// Prints one JSON object: for each page its state, what was drawn, console messages, and addresses asked for.
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
  console.log(JSON.stringify(told));
} finally {
  await Promise.all(browsers.map(browser => browser.close()));
}
