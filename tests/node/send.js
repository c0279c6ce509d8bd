// Tracks raw pictures with the WebAssembly sender, and decodes the planes it makes.
// Usage: send.js PICTURES.rgba WIDTH HEIGHT RATE OUT KEY OPTIONS.json
// Asks for an I plane before picture KEY. Writes JSON to OUT: poses (time, side, lost, angles, wrist) as tracked and as
// decoded, which planes are keys by picture, planes in base64, sizes, troubles. Prints how long pictures took.
import { openSync, readSync, writeFileSync } from "node:fs";
import { load } from "../../crates/js/handcast.js";
import { loadSender } from "../../crates/js/handcast-sender.js";

const [file, width, height, rate, out, key, options] = process.argv.slice(2);
const { Decoder } = await load();
const { Sender } = await loadSender();
const sender = new Sender({ rate: Number(rate), ...JSON.parse(options) });
const decoder = new Decoder();
const picture = new Uint8Array(width * height * 4);
const input = openSync(file);
const [tracked, decoded, keys, planes, troubles, took] = [[], [], [], [], [], []];
const note = list => ({ time, hands }) => {
  for (const { side, lost, angles, wrist } of hands) list.push({ time, side, lost, angles: [...angles], wrist: [...wrist] });
};
for (let frame = 0; readSync(input, picture) === picture.length; frame += 1) {
  if (frame === Number(key)) sender.requestKey();
  const begun = performance.now();
  const sent = sender.push(picture, Number(width), Number(height), 1000 + (frame * 1000) / rate);
  took.push(performance.now() - begun);
  sent.poses.forEach(note(tracked));
  if (sent.keys.some(Boolean)) keys.push(frame);
  if (sent.trouble) troubles.push(sent.trouble);
  for (const plane of sent.planes) {
    planes.push([frame, Buffer.from(plane).toString("base64")]);
    // Times are from the first picture with a plane on; pictures without one are decoded as held.
    const from = planes[0][0] / rate;
    decoder.pushPlane(plane).forEach(({ time, hands }) => note(decoded)({ time: from + time, hands }));
  }
}
const sizes = ["left", "right"].map(side => sender.sizes(side)?.handLength ?? null);
const told = ["left", "right"].map(side => decoder.sizes(side).handLength);
writeFileSync(out, JSON.stringify({ tracked, decoded, keys, planes, sizes, told, troubles }));
const steady = took.slice(Math.floor(took.length / 3)).sort((a, b) => a - b);
const sum = list => list.reduce((a, b) => a + b, 0);
console.log(JSON.stringify({
  pictures: took.length,
  perSecond: (1000 * took.length) / sum(took),
  steadyPerSecond: (1000 * steady.length) / sum(steady),
  median: steady[steady.length >> 1],
  p95: steady[Math.floor(steady.length * 0.95)],
  longest: Math.max(...took),
}));
