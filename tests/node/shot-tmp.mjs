import { chromium } from "playwright-core";
import { until } from "./browser.js";
const [url, prefix, ...sizes] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
for (const colorScheme of ["light", "dark"]) for (const size of sizes) {
  const [width, height] = size.split("x").map(Number);
  const page = await (await browser.newContext({ viewport: { width, height }, colorScheme, hasTouch: width < 500, isMobile: width < 500 })).newPage();
  page.on("console", m => console.log(m.text())); page.on("pageerror", e => console.log(String(e)));
  await page.goto(url);
  await until(page, "window.handcast?.state().hands.length >= 1", 60000).catch(e => console.log(e.message));
  await page.waitForTimeout(9000);
  await page.screenshot({ path: `${prefix}-${colorScheme}-${size}.png` });
  if (width < 500) await page.screenshot({ path: `${prefix}-${colorScheme}-${size}-full.png`, fullPage: true });
  await page.close();
}
await browser.close();
