// The JavaScript package in headless Chromium.
// Usage: web.js CHROMIUM STREAM.fba PICTURE.png [PICTURES.rgba WIDTH HEIGHT RATE]
// Plays STREAM in examples/three.html and takes a picture of it; decodes it in a page; sends raw pictures through a worker,
// as fast as it takes them; and does with workers what is not meant. Prints one JSON object: decoded (poses and a sum of their
// numbers), corners of the surface, sent (pictures, keys, decoded poses, milliseconds each took, pictures a second), misused (what
// came of it), messages of the console.
import { createServer } from "node:http";
import { createReadStream, readFileSync, statSync } from "node:fs";
import { dirname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";
import { complaints, launch } from "./browser.js";

const [executablePath, stream, picture, pictures, width, height, rate] = process.argv.slice(2);
const here = dirname(fileURLToPath(import.meta.url));
const TYPES = { html: "text/html", js: "text/javascript", wasm: "application/wasm" };
const places = [
  ["/node_modules/handcast/", join(here, "../../crates/js/")],
  ["/node_modules/", join(here, "node_modules/")],
  ["/examples/", join(here, "../../examples/")],
];
const server = createServer((request, response) => {
  const path = normalize(decodeURIComponent(new URL(request.url, "http://x").pathname)).replace("/examples/node_modules/", "/node_modules/");
  const send = (type, body) => { response.writeHead(200, { "content-type": type }); response.end(body); };
  try {
    if (path === "/") return send("text/html", "<!doctype html><title>handcast</title>");
    if (path.endsWith("/hand.fba")) return send("application/octet-stream", readFileSync(stream));
    if (path === "/pictures") {
      const size = width * height * 4;
      const start = Number(new URL(request.url, "http://x").searchParams.get("n")) * size;
      response.writeHead(200, { "content-type": "application/octet-stream" });
      return createReadStream(pictures, { start, end: start + size - 1 }).pipe(response);
    }
    const [prefix, folder] = places.find(([prefix]) => path.startsWith(prefix));
    return send(TYPES[path.split(".").at(-1)], readFileSync(join(folder, path.slice(prefix.length))));
  } catch { /* not found */ }
  response.writeHead(404);
  response.end();
});
await new Promise(done => server.listen(0, "127.0.0.1", done));
const origin = `http://127.0.0.1:${server.address().port}`;
const browser = await launch(executablePath);

async function decode() {
  const { load, loadSurface } = await import("/node_modules/handcast/handcast.js");
  const { Decoder } = await load();
  const surface = await loadSurface();
  const decoder = new Decoder();
  const frames = [...decoder.push(await (await fetch("/hand.fba")).arrayBuffer()), ...decoder.finish()];
  const hands = frames.flatMap(frame => frame.hands);
  const sum = hands.reduce((total, { angles, joints }) => [...angles, ...joints].reduce((a, b) => a + b, total), 0);
  const skin = surface(hands[0].side, decoder.sizes(hands[0].side));
  return { poses: hands.length, sum, corners: skin.triangles.length, vertices: skin.vertices.length / 32 };
}

async function send([count, width, height, rate]) {
  const { load } = await import("/node_modules/handcast/handcast.js");
  const { SenderWorker } = await import("/node_modules/handcast/handcast-sender.js");
  const { Decoder } = await load();
  const decoder = new Decoder();
  const facts = { pictures: 0, keys: 0, poses: 0, dropped: 0, troubles: [] };
  const took = [];
  let step;
  const worker = new SenderWorker({ rate }, {
    onsent({ planes, keys, trouble }, { milliseconds }) {
      took.push(milliseconds);
      facts.keys += keys.filter(Boolean).length;
      if (trouble) facts.troubles.push(trouble);
      for (const plane of planes) facts.poses += decoder.pushPlane(plane).length;
      step();
    },
    onerror(error) { facts.troubles.push(error.message); step(); },
  });
  await worker.ready;
  const begun = performance.now();
  for (let n = 0; n < count; n += 1) {
    const pixels = new Uint8ClampedArray(await (await fetch(`/pictures?n=${n}`)).arrayBuffer());
    const bitmap = await createImageBitmap(new ImageData(pixels, width, height));
    const done = new Promise(resolve => { step = resolve; });
    if (!worker.push(bitmap, 1000 + (n * 1000) / rate)) throw new Error("a picture was dropped");
    if (n === 0 && worker.push(bitmap, 1000)) throw new Error("a picture was queued");
    if (n === count >> 1) worker.requestKey();
    await done;
    facts.pictures += 1;
  }
  facts.seconds = (performance.now() - begun) / 1000;
  await worker.finish();
  const steady = took.slice(took.length / 3 | 0).sort((a, b) => a - b);
  facts.median = steady[steady.length >> 1];
  facts.p95 = steady[Math.floor(steady.length * 0.95)];
  facts.steadyPerSecond = 1000 * steady.length / steady.reduce((a, b) => a + b, 0);
  facts.longest = Math.max(...took);
  return facts;
}

async function misuse() {
  const { SenderWorker } = await import("/node_modules/handcast/handcast-sender.js");
  const patience = new Promise(done => setTimeout(done, 30000, "nothing"));
  const outcome = promise => Promise.race([patience, promise.then(sent => (sent ? sent.planes.length : "done"), error => error.message)]);
  const picture = () => new ImageData(96, 64);
  const start = async (options, means) => {
    const worker = new SenderWorker(options, means);
    worker.requestKey();
    const ends = [worker.finish(), worker.finish()];
    return { taken: worker.push(picture(), 0), same: ends[0] === ends[1], ready: await outcome(worker.ready), end: await outcome(ends[0]), busy: worker.busy };
  };
  const facts = {
    early: await start(),
    missing: await start({}, { wasm: "none.wasm" }),
    wrong: await start({}, { wasm: new URL("/node_modules/handcast/handcast_decoder.wasm", location) }),
    uncloned: await start({ rate: () => 30 }),
    refused: await start({ rate: -1 }),
    threw: [],
    errors: [],
  };
  let step;
  const worker = new SenderWorker({}, {
    wasm: "node_modules/handcast/handcast_sender.wasm",
    onsent: () => step("sent"),
    onerror: error => { facts.errors.push(error.message); step("error"); },
  });
  await worker.ready;
  const closed = await createImageBitmap(picture());
  const frame = new VideoFrame(closed, { timestamp: 0 });
  const gone = picture();
  structuredClone(gone.data, { transfer: [gone.data.buffer] });
  closed.close();
  frame.close();
  for (const wrong of [{}, undefined, 5, closed, frame, gone, document.body]) {
    try {
      worker.push(wrong, 0);
      facts.threw.push(false);
    } catch {
      facts.threw.push(!worker.busy);
    }
  }
  const pushed = (...given) => new Promise(done => {
    step = what => done([what, worker.busy]);
    if (!worker.push(...given)) done("dropped");
  });
  const fresh = await createImageBitmap(picture());
  facts.pushed = [await pushed(picture(), 1000), await pushed(picture(), 1000), await pushed(new VideoFrame(fresh, { timestamp: 0 }), 1040), await pushed(fresh, 1080)];
  facts.end = [await outcome(worker.finish()), worker.push(picture(), 2000), worker.busy];
  return facts;
}

try {
  const page = await browser.newPage({ viewport: { width: 400, height: 300 } });
  const messages = complaints(page, /GPU stall|favicon|404/);
  await page.goto(`${origin}/examples/three.html`);
  await page.waitForSelector("canvas", { timeout: 60000 });
  await page.waitForTimeout(1500);
  await page.screenshot({ path: picture });
  await page.goto(origin);
  const decoded = await page.evaluate(decode);
  const count = pictures ? Math.floor(statSync(pictures).size / (width * height * 4)) : 0;
  const sent = pictures && await page.evaluate(send, [count, Number(width), Number(height), Number(rate)]);
  const misused = await page.evaluate(misuse);
  console.log(JSON.stringify({ decoded, sent, misused, messages }));
} finally {
  await browser.close();
  server.close();
}
