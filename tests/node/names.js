// Opens pages whose names are markup in headless Chromium, and says what came of it.
// Usage: names.js CHROMIUM JOBS.json
// A job: {url, ready: expression}. Each page is opened with its policy and, to see that names are text without it,
// with the policy lifted.
// Prints one JSON object a job and opening: whether anything was run, dialogs, console messages, elements that names made,
// texts, and whether a script that is put into the page afterwards runs.
import { readFileSync } from "node:fs";
import { complaints, launch, until } from "./browser.js";

const [executablePath, list] = process.argv.slice(2);
const browser = await launch(executablePath);

// What a name that is taken for markup would leave behind.
const made = `document.querySelectorAll("[onerror], [onload], [onclick], img[src='x'], iframe, base").length`;
const texts = `[...document.querySelectorAll("title, h1, p, li, footer")].map(e => e.textContent)`;

// A script, a handler, a style, and a request, put in as a flaw would.
async function tryPolicy(page) {
  await page.evaluate(`{
    const script = document.createElement("script");
    script.textContent = "window.hostile = true";
    document.body.append(script);
    const box = document.createElement("div");
    box.innerHTML = '<img src="data:," onerror="window.hostile = true"><p id="styled" style="width: 7px">';
    document.body.append(box);
    fetch("http://127.0.0.1:9/x").catch(() => {});
  }`);
  await page.waitForTimeout(300);
}

async function open(job, bypassCSP) {
  const context = await browser.newContext({ viewport: { width: 640, height: 480 }, bypassCSP });
  const page = await context.newPage();
  const messages = complaints(page, /GPU stall/);
  const dialogs = [];
  page.on("dialog", dialog => { dialogs.push(dialog.message()); dialog.dismiss(); });
  const requests = [];
  page.on("request", r => { if (!/^(data|blob):/.test(r.url())) requests.push(r.url()); });
  await page.goto(job.url);
  await until(page, job.ready ?? "document.readyState === 'complete'");
  await page.waitForTimeout(500);
  const before = messages.slice();
  const [hostile, elements, shown] = [await page.evaluate("window.hostile ?? null"), await page.evaluate(made), await page.evaluate(texts)];
  const asked = requests.slice();
  await tryPolicy(page);
  const runs = await page.evaluate("window.hostile ?? null");
  const styled = await page.evaluate(`document.getElementById("styled").style.width`);
  const fetched = requests.some(url => url.startsWith("http://127.0.0.1:9/"));
  await context.close();
  return { lifted: bypassCSP, hostile, dialogs, messages: before, elements, texts: shown, requests: asked, runs, styled, fetched };
}

try {
  for (const job of JSON.parse(readFileSync(list, "utf8"))) {
    for (const lifted of [false, true]) console.log(JSON.stringify(await open(job, lifted)));
  }
} finally {
  await browser.close();
}
