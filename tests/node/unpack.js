// Takes meshopt compression (EXT_meshopt_compression, as gltfpack -cc writes it) off GLB files, so that readers
// without it can be asked what is in them.
// Usage: unpack.js IN.glb OUT.glb [IN.glb OUT.glb ...]
import { readFileSync, writeFileSync } from "node:fs";
import { MeshoptDecoder } from "three/addons/libs/meshopt_decoder.module.js";

const EXTENSION = "EXT_meshopt_compression";

/** The JSON and the binary chunk of a GLB. */
function split(file) {
  const bytes = readFileSync(file);
  const json = bytes.readUInt32LE(12);
  const text = bytes.subarray(20, 20 + json).toString("utf8");
  const start = 20 + json;
  const bin = start < bytes.length ? bytes.subarray(start + 8, start + 8 + bytes.readUInt32LE(start)) : Buffer.alloc(0);
  return [JSON.parse(text), bin];
}

function join(document, bin) {
  let text = Buffer.from(JSON.stringify(document));
  text = Buffer.concat([text, Buffer.alloc(-text.length & 3, " ")]);
  const head = Buffer.alloc(20);
  head.write("glTF", 0);
  head.writeUInt32LE(2, 4);
  head.writeUInt32LE(28 + text.length + bin.length, 8);
  head.writeUInt32LE(text.length, 12);
  head.write("JSON", 16);
  const next = Buffer.alloc(8);
  next.writeUInt32LE(bin.length, 0);
  next.write("BIN\0", 4);
  return Buffer.concat([head, text, next, bin]);
}

function unpack(document, bin) {
  const parts = [];
  let at = 0;
  for (const view of document.bufferViews ?? []) {
    const packed = view.extensions?.[EXTENSION];
    let data;
    if (packed) {
      const from = packed.byteOffset ?? 0;
      data = Buffer.alloc(packed.count * packed.byteStride);
      const source = bin.subarray(from, from + packed.byteLength);
      MeshoptDecoder.decodeGltfBuffer(data, packed.count, packed.byteStride, source, packed.mode, packed.filter);
      delete view.extensions[EXTENSION];
    } else {
      const from = view.byteOffset ?? 0;
      data = bin.subarray(from, from + view.byteLength);
    }
    const padded = Buffer.concat([data, Buffer.alloc(-data.length & 3)]);
    Object.assign(view, { buffer: 0, byteOffset: at, byteLength: data.length });
    at += padded.length;
    parts.push(padded);
  }
  document.buffers = [{ byteLength: at }];
  for (const list of ["extensionsUsed", "extensionsRequired"]) {
    document[list] = document[list]?.filter(name => name !== EXTENSION);
    if (!document[list]?.length) delete document[list];
  }
  return Buffer.concat(parts);
}

await MeshoptDecoder.ready;
const files = process.argv.slice(2);
for (let i = 0; i + 1 < files.length; i += 2) {
  const [document, bin] = split(files[i]);
  const plain = unpack(document, bin);
  writeFileSync(files[i + 1], join(document, plain));
}
