// Hand motion streams (MPEG-4 FBA) in JavaScript. See handcast.d.ts for types and README.md for use.

/** The 25 joints, in the order of WebXR. */
export const JOINT_NAMES = ["wrist", "thumb-metacarpal", "thumb-phalanx-proximal", "thumb-phalanx-distal", "thumb-tip"];
for (const finger of ["index", "middle", "ring", "pinky"]) {
  const bones = ["metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip"];
  JOINT_NAMES.push(...bones.map(bone => `${finger}-finger-${bone}`));
}

/** The 29 joint angles, in the order of `angles`. */
export const ANGLE_NAMES = [];
for (const finger of ["pinky", "ring", "middle", "index"]) {
  const angles = ["0_flexion", "1_flexion", "1_abduction", "1_twisting", "2_flexion", "3_flexion"];
  ANGLE_NAMES.push(...angles.map(angle => finger + angle));
}
ANGLE_NAMES.push(...["1_flexion", "1_abduction", "1_twisting", "2_flexion", "3_flexion"].map(angle => `thumb${angle}`));

/** Joint that carries each joint, -1 for the wrist. */
export const PARENTS = JOINT_NAMES.map((name, i) => (i === 0 ? -1 : name.endsWith("metacarpal") ? 0 : i - 1));

const SIDES = ["left", "right"];
// The modules by what each alone exports.
const MODULES = { decoder: "decoder_new", surface: "surface", sender: "sender_new" };
const FAILED = 0xffffffff;
// Bytes that go to the decoder at once, and poses that come back at once: bounds on its memory.
const PIECE = 1 << 16;
const ROWS = 256;
// Numbers of a pose, and where angles, wrist and joints begin: src/row.rs.
const [ROW, ANGLES, WRIST, JOINTS] = [449, 4, 33, 49];

/** What went wrong with a stream, or with what was asked for. */
export class HandcastError extends Error {
  name = "HandcastError";
}

/** What was given in place of something else, in a word or two. */
export function named(given) {
  if (typeof given === "string") return JSON.stringify(given.slice(0, 40));
  if (typeof given === "object" && given !== null) return given.constructor?.name || "an object";
  return typeof given === "function" ? "a function" : String(given);
}

/** Refuses what is none of `choices`; says which it is. */
export function choice(given, choices, what) {
  const at = choices.indexOf(given);
  if (at < 0) throw new HandcastError(`${what} is ${named(given)}, allowed are ${choices.map(named).join(" and ")}`);
  return at;
}

export const sideNumber = side => choice(side, SIDES, "side");

/** An option that is on or off, as a number. */
export const flag = (given, what) => choice(given, [false, true], what);

/** Options by name: an object, and no names but these. */
export function optionsOf(given, names, what) {
  if (given === undefined) return {};
  const isObject = typeof given === "object" && given !== null && !Array.isArray(given);
  const other = isObject ? Object.keys(given).find(name => !names.includes(name)) : undefined;
  if (isObject && other === undefined) return given;
  const has = isObject ? `have ${named(other)}` : `are ${named(given)}`;
  throw new HandcastError(`options of ${what} ${has}, allowed is an object with ${names.join(", ")}`);
}

/** The bytes of a buffer, or those that a view shows of one. */
export function bytesOf(given, what) {
  const kind = Object.prototype.toString.call(given);
  if (!ArrayBuffer.isView(given) && kind !== "[object ArrayBuffer]" && kind !== "[object SharedArrayBuffer]") {
    throw new HandcastError(`${what} are ${named(given)}, allowed are Uint8Array, ArrayBuffer and other views of one`);
  }
  try {
    return ArrayBuffer.isView(given) ? new Uint8Array(given.buffer, given.byteOffset, given.byteLength) : new Uint8Array(given);
  } catch (error) {
    throw new HandcastError(`${what} are not there: ${error.message}`);
  }
}

/** So many finite numbers. */
function numbersOf(given, length, what) {
  const isList = typeof given === "object" && given !== null && (Symbol.iterator in given || "length" in given);
  const numbers = isList ? Array.from(given) : null;
  if (numbers?.length !== length) {
    throw new HandcastError(`${what}: ${isList ? `${numbers.length} numbers` : named(given)}, allowed are ${length} numbers`);
  }
  const wrong = numbers.findIndex(number => !Number.isFinite(number));
  if (wrong >= 0) throw new HandcastError(`${what}: ${named(numbers[wrong])} at ${wrong}, allowed are finite numbers`);
  return numbers;
}

// Modules of Node's own, which bundlers for browsers leave alone.
const ofNode = name => import(/* webpackIgnore: true */ /* @vite-ignore */ `node:${name}`);

/** An address as the page, the worker or, in Node, the working folder has it. */
export async function locate(address) {
  let base = globalThis.document?.baseURI ?? globalThis.location?.href;
  if (!base && globalThis.process?.versions?.node) {
    const { pathToFileURL } = await ofNode("url");
    base = pathToFileURL(`${process.cwd()}/`);
  }
  try {
    return new URL(address, base);
  } catch {
    throw new HandcastError(`${named(address)} is no address`);
  }
}

/** What lies at an address. */
async function fetched(address) {
  const url = await locate(address);
  try {
    if (url.protocol !== "file:" || !globalThis.process?.versions?.node) return await fetch(url);
    const { readFile } = await ofNode("fs/promises");
    return await readFile(url);
  } catch (error) {
    throw new HandcastError(`${url}: ${error.message}`);
  }
}

const isResponse = given => typeof Response !== "undefined" && given instanceof Response;

/** The bytes of a response, as they are compiled. */
async function responded(response, wanted) {
  if (!response.ok) throw new HandcastError(`${response.url}: ${response.status} ${response.statusText}`);
  // Compiled while it comes, where the server says what it is.
  if (WebAssembly.compileStreaming && response.headers.get("Content-Type") === "application/wasm") return response;
  const bytes = new Uint8Array(await response.arrayBuffer());
  if (bytes[0] !== 0x3c) return bytes;
  // What bundlers do to addresses is in README.md.
  throw new HandcastError(`${wanted}, and ${response.url || "what the server sent"} is a page, not a module`);
}

/** One of the modules of WebAssembly, from its bytes, its address, a response or a compiled module. */
export async function instantiate(source, name) {
  const wanted = `wanted is handcast_${name}.wasm`;
  let given = await source;
  if (typeof given === "string" || given instanceof URL) given = await fetched(given);
  if (isResponse(given)) given = await responded(given, wanted);
  if (!(given instanceof WebAssembly.Module)) {
    const compiled = isResponse(given)
      ? WebAssembly.compileStreaming(given)
      : WebAssembly.compile(bytesOf(given, `${wanted}; its bytes`));
    given = await compiled.catch(error => {
      throw new HandcastError(`${wanted}, and this is no module: ${error.message}`);
    });
  }
  const has = new Set(WebAssembly.Module.exports(given).map(each => each.name));
  if (!has.has(MODULES[name])) {
    const other = Object.keys(MODULES).find(other => has.has(MODULES[other]));
    throw new HandcastError(`${wanted}, and this is ${other ? `handcast_${other}.wasm` : "none of handcast's modules"}`);
  }
  return (await WebAssembly.instantiate(given, {})).exports;
}

/** Copies of numbers in a module's memory. */
export const copy = (wasm, Type, address, length) => new Type(wasm.memory.buffer, address, length).slice();

/** Puts bytes where a module's next call reads them. */
export function give(wasm, bytes) {
  const address = wasm.input(bytes.length);
  new Uint8Array(wasm.memory.buffer, address, bytes.length).set(bytes);
}

const giveNumbers = (wasm, numbers) => give(wasm, new Uint8Array(Float64Array.from(numbers).buffer));
const giveSizes = (wasm, sizes) => giveNumbers(wasm, numbersOf(sizes?.numbers ?? sizes, wasm.sizes_len(), "sizes"));
const NO_HAND = "sizes that no hand has: see averageSizes() for an example";

export function check(wasm, outcome) {
  if (outcome >>> 0 !== FAILED) return;
  const message = copy(wasm, Uint8Array, wasm.message(), wasm.message_len());
  throw new HandcastError(new TextDecoder().decode(message));
}

/** The sizes that lie at an address. */
export function sizesAt(wasm, address, version) {
  const numbers = copy(wasm, Float64Array, address, wasm.sizes_len());
  return { numbers, handLength: numbers[0], radii: copy(wasm, Float32Array, wasm.sizes_radii(), 25), version };
}

/** What a row has of a pose, in memory of its own: each can be kept or moved to a worker alone. */
const partsOf = row => ({
  angles: row.slice(ANGLES, WRIST),
  wrist: row.slice(WRIST, JOINTS),
  joints: row.slice(JOINTS, ROW),
});

/** Poses in a module's memory as instants: times, and the hands of each. */
export function framesAt(wasm, atTimes, atRows, count, frames) {
  const times = copy(wasm, Float64Array, atTimes, count);
  const rows = copy(wasm, Float32Array, atRows, count * ROW);
  for (let i = 0; i < count; i += 1) {
    const row = rows.subarray(i * ROW, (i + 1) * ROW);
    const side = SIDES[row[0]];
    const hand = {
      side,
      lost: row[1] !== 0,
      confidence: row[2] < 0 ? null : row[2],
      ...partsOf(row),
    };
    const last = frames.at(-1);
    if (last?.time === times[i] && last.hands.every(other => other.side !== side)) last.hands.push(hand);
    else frames.push({ time: times[i], hands: [hand] });
  }
  return frames;
}

/** The decoder: classes and functions around its module. */
export async function load(source = new URL("handcast_decoder.wasm", import.meta.url)) {
  const wasm = await instantiate(source, "decoder");
  const forgotten = new FinalizationRegistry(number => wasm.decoder_free(number));

  class Decoder {
    #number;
    #waiting = [];

    constructor(options) {
      const names = ["strict", "vendorSteps", "sentOnly"];
      const { strict = false, vendorSteps = false, sentOnly = false } = optionsOf(options, names, "a decoder");
      const flags = flag(strict, "strict") | (flag(vendorSteps, "vendorSteps") << 1) | (flag(sentOnly, "sentOnly") << 2);
      this.#number = wasm.decoder_new(flags);
      forgotten.register(this, this.#number, this);
    }

    get #own() {
      if (this.#number === FAILED) throw new HandcastError("this decoder has been freed");
      return this.#number;
    }

    push(bytes) {
      const own = this.#own;
      const all = bytesOf(bytes, "bytes");
      for (let at = 0; at < all.length; at += PIECE) {
        give(wasm, all.subarray(at, at + PIECE));
        const outcome = wasm.decoder_push(own);
        this.#take();
        check(wasm, outcome);
      }
      return this.#taken();
    }

    pushPlane(bytes) {
      const own = this.#own;
      give(wasm, bytesOf(bytes, "bytes"));
      const outcome = wasm.decoder_push_plane(own);
      this.#take();
      check(wasm, outcome);
      return this.#taken();
    }

    lose() {
      check(wasm, wasm.decoder_lose(this.#own));
      this.#take();
      return this.#taken();
    }

    finish() {
      const outcome = wasm.decoder_finish(this.#own);
      this.#take();
      check(wasm, outcome);
      return this.#taken();
    }

    #take() {
      for (let count = ROWS; count === ROWS;) {
        count = wasm.decoder_take(this.#number, ROWS);
        framesAt(wasm, wasm.decoder_times(), wasm.decoder_rows(), count, this.#waiting);
      }
    }

    #taken() {
      const frames = this.#waiting;
      this.#waiting = [];
      return frames;
    }

    get facts() {
      const facts = copy(wasm, Float64Array, wasm.decoder_facts(this.#own), 10);
      const [rate, lost, ended, planes, intraPlanes, bits, damage, , , skinTone] = facts;
      return { rate, lost: lost !== 0, ended: ended !== 0, planes, intraPlanes, bits, damage, skinTone: skinTone || null };
    }

    sizes(side) {
      const [own, number] = [this.#own, sideNumber(side)];
      const version = copy(wasm, Float64Array, wasm.decoder_facts(own), 9)[7 + number];
      return sizesAt(wasm, wasm.decoder_sizes(own, number), version);
    }

    setSizes(side, sizes) {
      const [own, number] = [this.#own, sideNumber(side)];
      giveSizes(wasm, sizes);
      if (wasm.decoder_set_sizes(own, number) >>> 0 === FAILED) throw new HandcastError(NO_HAND);
    }

    pose(side, angles, translation = [0, 0, 0], rotation = [0, 0, 0, 1]) {
      const [own, number] = [this.#own, sideNumber(side)];
      const parts = [[angles, 29, "angles"], [translation, 3, "translation"], [rotation, 4, "rotation"]];
      giveNumbers(wasm, parts.flatMap(part => numbersOf(...part)));
      const row = copy(wasm, Float32Array, wasm.decoder_pose(own, number), ROW);
      return { side, lost: false, confidence: null, ...partsOf(row) };
    }

    free() {
      forgotten.unregister(this);
      wasm.decoder_free(this.#number);
      this.#number = FAILED;
    }
  }

  const averageSizes = (handLength = 0.189) => {
    if (!(handLength >= 0.05 && handLength <= 0.4)) {
      throw new HandcastError(`a hand ${handLength} m long, allowed 0.05 to 0.4 m`);
    }
    return sizesAt(wasm, wasm.sizes_average(handLength), 0);
  };
  const skinColour = tone => {
    if (tone === null || tone === undefined) return null;
    if (!(Number.isInteger(tone) && tone >= 1 && tone <= 10)) {
      throw new HandcastError(`tone is ${named(tone)}, allowed are 1 to 10, and null`);
    }
    const colour = wasm.decoder_skin(tone);
    return [colour >> 16, (colour >> 8) & 255, colour & 255];
  };
  return { Decoder, averageSizes, skinColour, applyToXRHand, skinningRows, webxrMatrix, JOINT_NAMES, ANGLE_NAMES, PARENTS, wasm };
}

/** A function that makes the skin of a hand: a second module, which only those need who draw. */
export async function loadSurface(source = new URL("handcast_surface.wasm", import.meta.url)) {
  const wasm = await instantiate(source, "surface");
  return function surface(side, sizes, options) {
    const { fine = true } = optionsOf(options, ["fine"], "a surface");
    const number = sideNumber(side);
    giveSizes(wasm, sizes);
    const count = wasm.surface(number, flag(fine, "fine"));
    if (count === 0) throw new HandcastError(NO_HAND);
    const corners = copy(wasm, Uint32Array, wasm.surface_triangles(), wasm.surface_corners());
    const ends = copy(wasm, Uint32Array, wasm.surface_ends(), 7);
    const numbers = copy(wasm, Float32Array, wasm.surface_numbers(), ends[6]);
    const group = i => numbers.slice(i > 0 ? ends[i - 1] : 0, ends[i]);
    const wide = count > 0xffff;
    return {
      side,
      vertices: copy(wasm, Uint8Array, wasm.surface_vertices(), count * 32),
      triangles: wide ? corners : Uint16Array.from(corners),
      wide,
      parents: PARENTS,
      cube: group(0),
      crease_width: group(1)[0],
      creases: group(2),
      nails: group(3),
      lines: group(4),
      offsets: group(5),
      inverse_bind: group(6),
    };
  };
}

/** Where the skin's vertices go: three rows (x, y, z) of four numbers a joint, from the surface at rest to the world. */
export function skinningRows(joints, inverseBind, rows = new Float32Array(300)) {
  for (let joint = 0; joint < 25; joint += 1) {
    for (let row = 0; row < 3; row += 1) {
      for (let column = 0; column < 4; column += 1) {
        let sum = column === 3 ? joints[joint * 16 + 12 + row] : 0;
        for (let k = 0; k < 3; k += 1) sum += joints[joint * 16 + k * 4 + row] * inverseBind[joint * 12 + k * 4 + column];
        rows[joint * 12 + row * 4 + column] = sum;
      }
    }
  }
  return rows;
}

/** The matrix of a joint with the axes of WebXR: -z along the bone, y out of the back of the hand. */
export function webxrMatrix(joints, joint, out = new Float32Array(16)) {
  const at = joint * 16;
  for (let k = 0; k < 4; k += 1) {
    out[k] = -joints[at + k];
    out[4 + k] = -joints[at + 8 + k];
    out[8 + k] = -joints[at + 4 + k];
    out[12 + k] = joints[at + 12 + k];
  }
  return out;
}

/**
 * Poses a hand of WebXR as the browser would: `target` is what three.js's `renderer.xr.getHand()` gives (or any object
 * with `joints` by name), or a function that is told each joint.
 */
export function applyToXRHand(target, hand, { radii, createJoint } = {}) {
  if (hand?.joints?.length !== 400) throw new HandcastError(`the pose is ${named(hand)}, allowed are hands with 400 numbers of joints`);
  if (typeof target !== "function" && !target?.joints) {
    throw new HandcastError(`the hand to pose is ${named(target)}, allowed are objects with joints by name, and functions`);
  }
  const matrix = new Float32Array(16);
  JOINT_NAMES.forEach((name, i) => {
    webxrMatrix(hand.joints, i, matrix);
    const radius = radii?.[i];
    if (typeof target === "function") return target(name, matrix, radius);
    let joint = target.joints[name];
    if (!joint && createJoint) {
      joint = target.joints[name] = createJoint(name);
      target.add?.(joint);
    }
    if (!joint) return undefined;
    joint.matrixAutoUpdate = false;
    joint.matrix.fromArray(matrix);
    joint.matrix.decompose(joint.position, joint.quaternion, joint.scale);
    joint.matrixWorldNeedsUpdate = true;
    if (radius !== undefined) joint.jointRadius = radius;
    joint.visible = true;
    return joint;
  });
}
