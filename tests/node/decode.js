// Decodes streams with the WebAssembly decoder, in pieces.
// Usage: decode.js JOBS.json
// A job: {file, piece (bytes at once), strict, vendor (base steps), skip (bytes left out at the front), out}. Writes 8 bytes of
// time and 449 numbers of 4 bytes a pose to `out` (side, lost, confidence, 0, angles, wrist, joints), and prints one JSON
// object a job: poses, facts, sizes of both hands, error (a message or null).
import { readFileSync, writeFileSync } from "node:fs";
import { load } from "../../crates/js/handcast.js";

const { Decoder } = await load();
for (const { file, piece, strict, vendor, skip, out } of JSON.parse(readFileSync(process.argv[2], "utf8"))) {
  const decoder = new Decoder({ strict, vendorSteps: vendor });
  const bytes = readFileSync(file).subarray(skip);
  const frames = [];
  let error = null;
  try {
    for (let at = 0; at < bytes.length; at += piece) frames.push(...decoder.push(bytes.subarray(at, at + piece)));
    frames.push(...decoder.finish());
  } catch (thrown) {
    error = thrown.message;
  }
  const rows = [];
  for (const { time, hands } of frames) {
    for (const { side, lost, confidence, angles, wrist, joints } of hands) {
      const row = new DataView(new ArrayBuffer(8 + 449 * 4));
      row.setFloat64(0, time, true);
      const numbers = [Number(side === "right"), Number(lost), confidence ?? -1, 0, ...angles, ...wrist, ...joints];
      numbers.forEach((number, i) => row.setFloat32(8 + 4 * i, number, true));
      rows.push(Buffer.from(row.buffer));
    }
  }
  writeFileSync(out, Buffer.concat(rows));
  const sizes = ["left", "right"].map(side => [...decoder.sizes(side).numbers]);
  console.log(JSON.stringify({ poses: rows.length, facts: decoder.facts, sizes, error }));
  decoder.free();
}
