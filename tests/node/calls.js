// Calls the JavaScript package wrongly, and looks whether it says so; and rightly with every kind of bytes.
// Usage: calls.js STREAM.fba
import assert from "node:assert/strict";
import { copyFileSync, mkdtempSync, readFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { HandcastError, applyToXRHand, load, loadSurface } from "../../crates/js/handcast.js";
import { SenderWorker, loadSender } from "../../crates/js/handcast-sender.js";

const file = name => new URL(`../../crates/js/handcast_${name}.wasm`, import.meta.url);
const bytes = Uint8Array.from(readFileSync(process.argv[2]));
const isError = words => error => error instanceof HandcastError && (assert.match(error.message, words), true);
const refused = (call, words) => assert.throws(call, isError(words));
const fails = (promise, words) => assert.rejects(promise, isError(words));

const { Decoder, averageSizes, skinColour } = await load();
const surface = await loadSurface();
const { Sender } = await loadSender();

// Modules.
await fails(load(file("surface")), /wanted is handcast_decoder\.wasm.*this is handcast_surface\.wasm/);
await fails(loadSurface(file("sender")), /wanted is handcast_surface\.wasm.*handcast_sender\.wasm/);
await fails(loadSender(readFileSync(file("decoder"))), /wanted is handcast_sender\.wasm.*handcast_decoder\.wasm/);
await fails(load(Uint8Array.of(0, 97, 115, 109, 1, 0, 0, 0)), /none of handcast's modules/);
await fails(load(Uint8Array.of(1, 2, 3)), /no module/);
await fails(load(5), /handcast_decoder\.wasm; its bytes are 5, allowed/);
await fails(load(new Response("<!doctype html>")), /what the server sent is a page, not a module/);
await fails(load("none.wasm"), /^file:.*none\.wasm: ENOENT/);
await fails(load("http://[::1"), /is no address/);
// A relative address is the working folder's.
const folder = mkdtempSync(join(tmpdir(), "handcast-"));
copyFileSync(file("decoder"), join(folder, "own.wasm"));
process.chdir(folder);
await load("own.wasm");
await load(new WebAssembly.Module(readFileSync(file("decoder"))));
await load(new Response(readFileSync(file("decoder"))));

// Bytes, whatever they lie in.
const instants = given => {
  const decoder = new Decoder({ strict: true });
  return decoder.push(given).length + decoder.finish().length;
};
const wide = new Uint8Array(bytes.length + 16).fill(1);
wide.set(bytes, 8);
const shared = new SharedArrayBuffer(bytes.length);
new Uint8Array(shared).set(bytes);
const views = [
  bytes, bytes.buffer, Buffer.from(bytes), shared, new Uint8Array(shared), new DataView(wide.buffer, 8, bytes.length),
  new Int8Array(wide.buffer, 8, bytes.length), wide.subarray(8, 8 + bytes.length),
];
assert(instants(bytes) > 100);
for (const view of views) assert.equal(instants(view), instants(bytes));
for (const view of views) assert.deepEqual(new Decoder().pushPlane(view), new Decoder().pushPlane(bytes));
assert(new Decoder().pushPlane(bytes.buffer).length > 100);
const gone = Uint8Array.of(1);
structuredClone(gone, { transfer: [gone.buffer] });
const decoder = new Decoder();
for (const method of ["push", "pushPlane"]) {
  for (const [given, words] of [
    [undefined, "undefined"], [null, "null"], ["abcd", '"abcd"'], [5, "5"], [new Blob(["abcd"]), "Blob"], [Promise.resolve(bytes), "Promise"],
    [[0, 0, 1], "Array"], [{}, "Object"], [Symbol("s"), "Symbol"], [() => bytes, "a function"], [Object.create(null), "an object"],
  ]) refused(() => decoder[method](given), new RegExp(`bytes are ${words}.*allowed are Uint8Array, ArrayBuffer`));
  refused(() => decoder[method](gone), /bytes are not there/);
}

// Options, poses and sizes.
for (const given of [null, "strict", [], 5]) refused(() => new Decoder(given), /options of a decoder are .*, allowed is an object with strict, /);
refused(() => new Decoder({ stric: true }), /options of a decoder have "stric", allowed/);
refused(() => surface("left", averageSizes(), { Fine: true }), /options of a surface have "Fine"/);
assert.deepEqual([skinColour(null), skinColour(undefined), skinColour(1).length], [null, null, 3]);
for (const tone of [0, 11, 2.5, "a"]) refused(() => skinColour(tone), /tone is .*, allowed are 1 to 10/);
// Each array can be given away without the others.
const [first, second] = new Decoder().push(bytes);
structuredClone(first.hands[0].joints, { transfer: [first.hands[0].joints.buffer] });
assert.deepEqual([first.hands[0].angles.length, first.hands[0].wrist.length, second.hands[0].joints.length], [29, 16, 400]);
assert.equal(second.hands[0].joints.buffer.byteLength, 1600);
refused(() => applyToXRHand({ joints: {} }, {}), /the pose is Object, allowed/);
refused(() => applyToXRHand({}, second.hands[0]), /the hand to pose is Object, allowed/);
refused(() => new Decoder({ strict: "yes" }), /strict is "yes", allowed are false and true/);
refused(() => decoder.sizes("up"), /side is "up", allowed are "left" and "right"/);
const angles = new Array(29).fill(0.1);
assert.equal(decoder.pose("left", angles, [1, 2, 3]).joints[13], 2);
assert.deepEqual(decoder.pose("left", Float64Array.from(angles)), decoder.pose("left", angles));
refused(() => decoder.pose("left", angles.slice(1), [1, 2, 3]), /angles: 28 numbers, allowed are 29 numbers/);
refused(() => decoder.pose("left", angles, [1, 2]), /translation: 2 numbers, allowed are 3/);
refused(() => decoder.pose("left", angles, { x: 1, y: 2, z: 3 }), /translation: Object, allowed are 3/);
refused(() => decoder.pose("left", angles, [1, 2, 3], [0, 0, 1]), /rotation: 3 numbers, allowed are 4/);
refused(() => decoder.pose("left", angles, [1, NaN, 3]), /translation: NaN at 1, allowed are finite numbers/);
refused(() => decoder.pose("left"), /angles: undefined, allowed are 29/);
refused(() => decoder.setSizes("left"), /sizes: undefined, allowed are \d+ numbers/);
refused(() => decoder.setSizes("left", [1, 2]), /sizes: 2 numbers, allowed are \d+ numbers/);
refused(() => decoder.setSizes("left", averageSizes().numbers.map(() => 9)), /sizes that no hand has/);
refused(() => surface("left", "sizes"), /sizes: "sizes", allowed are/);
decoder.setSizes("left", averageSizes(0.2));

// The sender.
for (const [options, words] of [
  [{ side: "up" }, /side is "up", allowed are "left" and "right"/], [{ view: "x" }, /view is "x", allowed are "palm" and "back"/],
  [{ rate: -1 }, /rate is -1, allowed are 0\.0625 to 255, and 0 for the default/], [{ rate: "30" }, /rate is "30"/], [{ rms: NaN }, /rms is NaN/],
  [{ handLength: 19 }, /handLength is 19, allowed are 0\.05 to 0\.4/], [{ fieldOfView: 200 }, /5 to 150/], [{ analysisSide: 8 }, /64 to 4096/],
  [{ mirror: 1 }, /mirror is 1, allowed are false and true/], [null, /options of a sender are null/], [{ fps: 30 }, /options of a sender have "fps"/],
]) refused(() => new Sender(options), words);
const sender = new Sender({ rate: 25, rms: 0, side: "right", view: "back", mirror: true, anyStart: false, handLength: 0, fieldOfView: 60, analysisSide: 320 });
const grey = new Uint8ClampedArray(96 * 64 * 4).fill(90);
assert.deepEqual(sender.push(grey, 96, 64, 1000).planes, []);
refused(() => sender.push({ data: grey }, 96, 64, 1040), /pixels are Object/);
for (const width of [0, -1, 1.5, "96", undefined]) refused(() => sender.push(grey, width, 64, 1040), /width is .*, allowed are 1 to 65535/);
refused(() => sender.push(grey, 96, 63, 1040), /96 × 63 pixels has 24576 bytes/);

// What has been freed.
for (const [freed, words, calls] of [
  [decoder, /this decoder has been freed/, [
    d => d.push(bytes), d => d.pushPlane(bytes), d => d.lose(), d => d.finish(), d => d.facts, d => d.sizes("left"), d => d.pose("left", angles),
    d => d.setSizes("left", averageSizes()),
  ]],
  [sender, /this sender has been freed/, [
    s => s.push(grey, 96, 64, 1080), s => s.requestKey(), s => s.finish(), s => s.sizes("left"), s => s.skinTone,
  ]],
]) {
  freed.free();
  freed.free();
  for (const call of calls) refused(() => call(freed), words);
}

// Node has no workers of the web.
refused(() => new SenderWorker(), /no web workers here/);

// A worker's answers, by one that is told what to answer.
function played() {
  const heard = [];
  const worker = { terminated: false, postMessage: message => heard.push(message.kind), terminate: () => { worker.terminated = true; } };
  const errors = [];
  const sender = new SenderWorker({}, { worker, onerror: error => errors.push(error.message) });
  return { worker, sender, heard, errors, say: data => worker.onmessage({ data }) };
}
const turn = () => new Promise(done => setTimeout(done));
{
  const { worker, sender, heard, errors, say } = played();
  sender.requestKey();
  say({ kind: "ready" });
  assert.deepEqual([sender.busy, heard], [false, ["start", "key"]]);
  assert(sender.push({ data: grey }, 0));
  say({ kind: "failed", message: "no key", of: "key" });
  assert.deepEqual([sender.busy, errors], [true, ["no key"]]);
  say({ kind: "failed", message: "no picture", of: "picture" });
  assert.deepEqual([sender.busy, errors], [false, ["no key", "no picture"]]);
  sender.requestKey();
  assert.deepEqual(heard, ["start", "key", "picture", "key"]);
  const end = sender.finish();
  await turn();
  say({ kind: "failed", message: "no end", of: "finish" });
  await fails(end, /^no end$/);
  assert(worker.terminated && sender.finish() === end && !sender.push({ data: grey }, 1));
}
{
  const { worker, sender, heard, say } = played();
  const end = sender.finish();
  await turn();
  assert.deepEqual(heard, ["start"]);
  say({ kind: "ready" });
  await turn();
  worker.onerror({ message: "broken" });
  await fails(end, /^broken$/);
}
{
  const { worker, sender } = played();
  worker.onerror({});
  await fails(sender.finish(), /the worker does not start/);
  await fails(sender.ready, /the worker does not start/);
  assert(worker.terminated);
}
