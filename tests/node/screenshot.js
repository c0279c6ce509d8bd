// Loads a GLB in three.js in headless Chromium and writes what a pinhole camera at the origin, looking
// along -Z, sees of its animation at some times.
// Usage: screenshot.js CHROMIUM FILE.glb WIDTH HEIGHT FOCAL_PIXELS TIME=OUT.png ...
// Prints one JSON object: node count, clip length, console messages. Exit code 1 if anything went wrong.
import { createServer } from "node:http";
import { readFileSync, writeFileSync } from "node:fs";
import { dirname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const [executablePath, file, width, height, focal, ...shots] = process.argv.slice(2);
const here = dirname(fileURLToPath(import.meta.url));
const page_html = `<!doctype html><style>body{margin:0}</style><canvas id="c"></canvas>
<script type="importmap">{"imports":{"three":"/three/build/three.module.js","three/addons/":"/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
const [width, height, focal] = [${Number(width)}, ${Number(height)}, ${Number(focal)}];
const renderer = new THREE.WebGLRenderer({ canvas: document.getElementById("c"), antialias: true, preserveDrawingBuffer: true });
renderer.setSize(width, height);
renderer.setClearColor(0xffffff);
const scene = new THREE.Scene();
scene.add(new THREE.HemisphereLight(0xffffff, 0x998877, 1.6));
const sun = new THREE.DirectionalLight(0xffffff, 2);
sun.position.set(-0.55, 0.75, 0.75);
scene.add(sun);
const fov = 2 * Math.atan(height / 2 / focal) * 180 / Math.PI;
const camera = new THREE.PerspectiveCamera(fov, width / height, 0.01, 50);
const gltf = await new GLTFLoader().loadAsync("/file.glb");
scene.add(gltf.scene);
gltf.scene.traverse(o => { o.frustumCulled = false; });
const mixer = new THREE.AnimationMixer(gltf.scene);
for (const clip of gltf.animations) { const a = mixer.clipAction(clip); a.clampWhenFinished = true; a.setLoop(THREE.LoopOnce); a.play(); }
let nodes = 0;
gltf.scene.traverse(() => { nodes += 1; });
window.facts = { nodes, animations: gltf.animations.length, duration: gltf.animations[0]?.duration };
window.shot = time => { mixer.setTime(time); renderer.render(scene, camera); return renderer.domElement.toDataURL("image/png"); };
window.ready = true;
</script>`;

const server = createServer((request, response) => {
  const path = normalize(decodeURIComponent(new URL(request.url, "http://x").pathname));
  const send = (type, body) => { response.writeHead(200, { "content-type": type }); response.end(body); };
  try {
    if (path === "/") return send("text/html", page_html);
    if (path === "/file.glb") return send("model/gltf-binary", readFileSync(file));
    if (path.startsWith("/three/")) return send("text/javascript", readFileSync(join(here, "node_modules", path)));
  } catch { /* not found */ }
  response.writeHead(404);
  response.end();
});
await new Promise(done => server.listen(0, "127.0.0.1", done));
const browser = await chromium.launch({
  executablePath,
  args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
const messages = [];
try {
  const page = await browser.newPage();
  page.on("console", m => { if (["error", "warning"].includes(m.type()) && !/GPU stall|favicon|404/.test(m.text())) messages.push(m.text()); });
  page.on("pageerror", e => messages.push(String(e)));
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  await page.waitForFunction("window.ready", undefined, { timeout: 60000 });
  for (const shot of shots) {
    const [time, out] = shot.split("=");
    const url = await page.evaluate(t => window.shot(t), Number(time));
    writeFileSync(out, Buffer.from(url.split(",")[1], "base64"));
  }
  console.log(JSON.stringify({ ...(await page.evaluate("window.facts")), messages }));
  process.exitCode = messages.length ? 1 : 0;
} finally {
  await browser.close();
  server.close();
}
