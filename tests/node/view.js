// Opens pages of `handcast view` in headless Chromium and does what a list says.
// Usage: view.js CHROMIUM JOBS.json
// A job: {page, width, height, hash, dark, still, blind (no WebGL 2), slow (five pictures a second are drawn,
// and those of a clip come half a second late), served (from a server that says it is of this type), damaged
// (there is nothing but words, which are its only step), steps}. Steps: {press}, {scrub}, {wheel},
// {drag: [dx, dy]}, {pinch: factor}, {click: [selector, share of the width]}, {wait: ms}, {shot: FILE},
// {picture: FILE}, {pixel: selector}, {drop: FILE}, {joint: [hand, number]} (clicks it), {check: selector}, {film: seconds to wait}.
// Prints one JSON object a job: what each step left behind, console messages, and what was asked of any network.
import { createServer } from "node:http";
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { complaints, launch, until } from "./browser.js";

const [executablePath, list] = process.argv.slice(2);
const browser = await launch(executablePath);

// Two fingers that move apart by a factor, in the middle of the hand.
async function pinch(page, factor) {
  const client = await page.context().newCDPSession(page);
  const box = await page.locator("#hand").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const fingers = gap => [{ x: x - gap / 2, y, id: 0 }, { x: x + gap / 2, y, id: 1 }];
  await client.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: fingers(80) });
  for (const share of [0.25, 0.5, 0.75, 1]) {
    const touchPoints = fingers(80 * (1 + (factor - 1) * share));
    await client.send("Input.dispatchTouchEvent", { type: "touchMove", touchPoints });
  }
  await client.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
}

async function act(page, step) {
  if (step.press) await page.keyboard.press(step.press);
  if (step.scrub !== undefined) await page.locator("#scrub").fill(String(step.scrub));
  if (step.pinch) await pinch(page, step.pinch);
  if (step.wait) await page.waitForTimeout(step.wait);
  if (step.click) {
    const box = await page.locator(step.click[0]).boundingBox();
    await page.mouse.click(box.x + box.width * step.click[1], box.y + box.height / 2);
  }
  if (step.drop) {
    const [name, text] = [step.drop.split("/").at(-1), readFileSync(step.drop).toString("base64")];
    const before = await page.evaluate("window.handcast.state().opened ?? 0");
    await page.evaluate(({ name, text }) => {
      const content = Uint8Array.from(atob(text), c => c.charCodeAt(0));
      const dataTransfer = new DataTransfer();
      dataTransfer.items.add(new File([content], name));
      document.body.dispatchEvent(new DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
    }, { name, text });
    await until(page, `window.handcast.state().opened > ${before}`);
  }
  if (step.joint) {
    const [hand, joint] = step.joint;
    const place = await page.evaluate(`window.handcast.joints()[${hand}][${joint}]`);
    const box = await page.locator("#hand").boundingBox();
    await page.mouse.click(box.x + place[0], box.y + place[1]);
  }
  if (step.check) await page.locator(step.check).click();
  if (step.film) {
    await until(page, `document.getElementById("film").readyState >= 2 && !document.getElementById("film").seeking && window.handcast.state().clip !== null`);
    await page.waitForTimeout(step.film * 1000);
  }
  if (step.drag || step.wheel) {
    const box = await page.locator("#hand").boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.move(x, y);
    if (step.wheel) await page.mouse.wheel(0, step.wheel);
    if (step.drag) {
      await page.mouse.down();
      await page.mouse.move(x + step.drag[0], y + step.drag[1], { steps: 4 });
      await page.mouse.up();
    }
  }
  if (step.shot) await page.screenshot({ path: step.shot });
  if (step.picture) {
    const url = await page.evaluate("window.handcast.picture()");
    writeFileSync(step.picture, Buffer.from(url.split(",")[1], "base64"));
  }
  await page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))");
  const found = await page.evaluate(`({
    ...window.handcast.state(), camera: window.handcast.camera(),
    overflow: document.documentElement.scrollWidth - innerWidth,
    message: document.getElementById("message").hidden ? null : document.getElementById("message").textContent,
    labels: [...document.querySelectorAll("#labels span")].map(l => l.textContent),
    facts: document.getElementById("facts").textContent,
    notes: [...document.querySelectorAll("#notes li")].map(note => note.textContent),
    title: document.title,
    opening: document.getElementById("opening").textContent,
    curves: document.getElementById("curves-title").textContent,
    hidden: ["clip-panel", "bits-panel", "rows", "film"].filter(id => document.getElementById(id).closest("[hidden]")),
    bones: (() => {
      const bones = document.getElementById("bones");
      if (!bones.width) return 0;
      const pixels = bones.getContext("2d").getImageData(0, 0, bones.width, bones.height).data;
      return pixels.filter((value, i) => i % 4 === 3 && value > 0).length;
    })(),
  })`);
  if (step.pixel) {
    found.pixel = await page.evaluate(selector => {
      const canvas = document.querySelector(selector);
      if (canvas.tagName === "VIDEO") {
        const copy = Object.assign(document.createElement("canvas"), { width: canvas.videoWidth, height: canvas.videoHeight });
        copy.getContext("2d").drawImage(canvas, 0, 0);
        return [...copy.getContext("2d").getImageData(copy.width >> 1, copy.height >> 1, 1, 1).data];
      }
      const at = [canvas.width >> 1, canvas.height >> 1];
      return [...canvas.getContext("2d").getImageData(at[0], at[1], 1, 1).data];
    }, step.pixel);
  }
  return found;
}

try {
  for (const job of JSON.parse(readFileSync(list, "utf8"))) {
    const requests = [];
    const context = await browser.newContext({
      viewport: { width: job.width, height: job.height },
      colorScheme: job.dark ? "dark" : "light",
      reducedMotion: job.still ? "reduce" : "no-preference",
      hasTouch: true,
    });
    const page = await context.newPage();
    // The second is about how this test reads what was drawn.
    const messages = complaints(page, /GPU stall|willReadFrequently/);
    page.on("request", r => { if (!/^(data|blob):/.test(r.url())) requests.push(r.url()); });
    if (job.blind) {
      await page.addInitScript(() => {
        const real = HTMLCanvasElement.prototype.getContext;
        HTMLCanvasElement.prototype.getContext = function (kind, ...rest) { return kind === "webgl2" ? null : real.call(this, kind, ...rest); };
      });
    }
    if (job.slow) {
      await page.addInitScript(() => {
        window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 200);
        const real = window.createImageBitmap.bind(window);
        window.createImageBitmap = (...given) => real(...given).then(p => new Promise(done => setTimeout(done, 500, p)));
      });
    }
    const server = job.served && createServer((_, response) => {
      response.writeHead(200, { "content-type": job.served });
      response.end(readFileSync(job.page));
    });
    if (server) await new Promise(done => server.listen(0, "127.0.0.1", done));
    const address = server ? `http://127.0.0.1:${server.address().port}/` : pathToFileURL(job.page).href;
    await page.goto(address + (job.hash ? `#${job.hash}` : ""));
    await until(page, job.damaged ? "Boolean(document.querySelector('body > [role=alert]'))" : "Boolean(window.handcast)");
    const steps = job.damaged ? [await page.evaluate("document.body.innerText")] : [];
    for (const step of job.steps) steps.push(await act(page, step));
    console.log(JSON.stringify({ steps, messages, requests: requests.length }));
    await context.close();
    server?.close();
  }
} finally {
  await browser.close();
}
