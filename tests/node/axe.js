// What axe-core finds on pages, in headless Chromium.
// Usage: axe.js CHROMIUM (PAGE.html | http://…)...; prints one JSON object a page: the rules broken, by scheme of colours and width,
// with the places.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";
import { launch, until } from "./browser.js";

const [executablePath, ...pages] = process.argv.slice(2);
const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const browser = await launch(executablePath);
try {
  for (const file of pages) {
    const found = [];
    for (const [colorScheme, width] of [["light", 1280], ["dark", 1280], ["light", 390]]) {
      const context = await browser.newContext({ colorScheme, viewport: { width, height: 800 }, reducedMotion: "reduce" });
      const page = await context.newPage();
      await page.goto(/^https?:/.test(file) ? file : pathToFileURL(file).href);
      await until(page, "document.readyState === 'complete' && (!document.querySelector('#hand, #bytes') || Boolean(window.handcast))");
      await page.waitForTimeout(700);
      await page.evaluate(axe);
      const run = async state => {
        const { violations } = await page.evaluate("axe.run()");
        for (const { id, impact, nodes } of violations) {
          found.push({ state, colorScheme, width, id, impact, targets: nodes.map(n => n.target.join(" ")) });
        }
      };
      await run("as it opens");
      if (await page.locator("#help-button").count()) {
        await page.locator("#help-button").click();
        await run("with help");
      }
      await context.close();
    }
    console.log(JSON.stringify({ file, found }));
    if (found.length) process.exitCode = 1;
  }
} finally {
  await browser.close();
}
