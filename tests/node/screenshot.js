// Loads GLB files in three.js in headless Chromium and writes what a pinhole camera at the origin, looking
// along -Z, sees of their animations at some times.
// Usage: screenshot.js CHROMIUM WIDTH HEIGHT FOCAL_PIXELS (FILE.glb TIME=OUT.png ...) ...
// Prints one JSON object a file: node count, clip length, the ends of the lines of its skeletons at rest, console messages. Exit code 1 if anything went wrong.
import { createServer } from "node:http";
import { readFileSync, writeFileSync } from "node:fs";
import { dirname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";
import { complaints, launch } from "./browser.js";

const [executablePath, width, height, focal, ...rest] = process.argv.slice(2);
const jobs = [];
for (const word of rest) {
  const at = word.indexOf("=");
  if (at < 0) jobs.push({ file: word, shots: [] });
  else jobs.at(-1).shots.push([Number(word.slice(0, at)), word.slice(at + 1)]);
}
const here = dirname(fileURLToPath(import.meta.url));
const page_html = `<!doctype html><style>body{margin:0}</style><canvas id="c"></canvas>
<script type="importmap">{"imports":{"three":"/three/build/three.module.js","three/addons/":"/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { MeshoptDecoder } from "three/addons/libs/meshopt_decoder.module.js";
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
const gltf = await new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).loadAsync("/file.glb?" + location.search.slice(1));
scene.add(gltf.scene);
gltf.scene.traverse(o => { o.frustumCulled = false; });
const mixer = new THREE.AnimationMixer(gltf.scene);
for (const clip of gltf.animations) { const a = mixer.clipAction(clip); a.clampWhenFinished = true; a.setLoop(THREE.LoopOnce); a.play(); }
let nodes = 0;
gltf.scene.traverse(() => { nodes += 1; });
// The skeletons as three.js draws them: from bone to bone, in the world.
gltf.scene.updateMatrixWorld(true);
const drawn = [];
gltf.scene.traverse(object => {
  if (!object.isBone || object.parent.isBone) return;
  const helper = new THREE.SkeletonHelper(object);
  helper.updateMatrixWorld(true);
  const line = helper.geometry.getAttribute("position");
  drawn.push(Array.from({ length: line.count }, (_, k) => new THREE.Vector3().fromBufferAttribute(line, k).applyMatrix4(helper.matrixWorld).toArray()));
});
window.facts = { drawn, nodes, animations: gltf.animations.length, duration: gltf.animations[0]?.duration };
window.shot = time => { mixer.setTime(time); renderer.render(scene, camera); return renderer.domElement.toDataURL("image/png"); };
window.ready = true;
</script>`;

const server = createServer((request, response) => {
  const url = new URL(request.url, "http://x");
  const path = normalize(decodeURIComponent(url.pathname));
  const send = (type, body) => { response.writeHead(200, { "content-type": type }); response.end(body); };
  try {
    if (path === "/") return send("text/html", page_html);
    if (path === "/file.glb") return send("model/gltf-binary", readFileSync(jobs[Number(url.search.slice(1))].file));
    if (path.startsWith("/three/")) return send("text/javascript", readFileSync(join(here, "node_modules", path)));
  } catch { /* not found */ }
  response.writeHead(404);
  response.end();
});
await new Promise(done => server.listen(0, "127.0.0.1", done));
const browser = await launch(executablePath);
try {
  for (const [number, { file, shots }] of jobs.entries()) {
    const page = await browser.newPage();
    const messages = complaints(page, /GPU stall|favicon|404/);
    await page.goto(`http://127.0.0.1:${server.address().port}/?${number}`);
    await page.waitForFunction("window.ready", undefined, { timeout: 60000 });
    for (const [time, out] of shots) {
      const url = await page.evaluate(t => window.shot(t), time);
      writeFileSync(out, Buffer.from(url.split(",")[1], "base64"));
    }
    console.log(JSON.stringify({ file, ...(await page.evaluate("window.facts")), messages }));
    if (messages.length) process.exitCode = 1;
    await page.close();
  }
} finally {
  await browser.close();
  server.close();
}
