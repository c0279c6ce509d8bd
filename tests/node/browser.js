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
