// Plays a film in headless Chromium.
// Usage: film.js CHROMIUM FILM SECONDS...; prints one JSON object: size, duration, and of the picture at each time the levels (red,
// green, blue) at a tenth, half and nine tenths of its width and height.
import { readFileSync } from "node:fs";
import { launch } from "./browser.js";

const [executablePath, file, ...times] = process.argv.slice(2);
const browser = await launch(executablePath);
try {
  const page = await browser.newPage();
  const source = `data:video/mp4;base64,${readFileSync(file).toString("base64")}`;
  const found = await page.evaluate(async ({ source, times }) => {
    const video = document.createElement("video");
    video.muted = true;
    const event = name => new Promise((done, failed) => {
      video.addEventListener(name, done, { once: true });
      video.addEventListener("error", () => failed(new Error(video.error.message)), { once: true });
    });
    const ready = event("loadeddata");
    video.src = source;
    await ready;
    const [width, height] = [video.videoWidth, video.videoHeight];
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    const context = canvas.getContext("2d");
    const levels = [];
    for (const time of times) {
      const there = event("seeked");
      video.currentTime = time;
      await there;
      context.drawImage(video, 0, 0);
      levels.push([0.1, 0.5, 0.9].map(share => [...context.getImageData(Math.floor(share * width), Math.floor(share * height), 1, 1).data].slice(0, 3)));
    }
    return { width, height, duration: video.duration, levels };
  }, { source, times: times.map(Number) });
  console.log(JSON.stringify(found));
} finally {
  await browser.close();
}
