// Headless Chromium that draws WebGL in software, and what its pages complain about.
import { chromium } from "playwright-core";

/** Starts Chromium. */
export function launch(executablePath) {
  return chromium.launch({
    executablePath,
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
}

/** Errors and warnings of a page, as they come; those that match `harmless` are left out. */
export function complaints(page, harmless) {
  const messages = [];
  page.on("console", m => { if (["error", "warning"].includes(m.type()) && !harmless.test(m.text())) messages.push(m.text()); });
  page.on("pageerror", e => messages.push(String(e)));
  return messages;
}

/** Waits until an expression is true of a page. Policies of pages forbid `eval`, which Playwright's own waiting needs. */
export async function until(page, condition, patience = 60_000) {
  for (const end = Date.now() + patience; ; ) {
    if (await page.evaluate(condition)) return;
    if (Date.now() > end) throw new Error(`${condition} does not come true: ${JSON.stringify(await page.evaluate("window.handcast?.state()"))}`);
    await new Promise(done => setTimeout(done, 20));
  }
}
