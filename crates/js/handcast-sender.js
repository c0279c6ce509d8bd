// A camera's pictures to the planes of a live stream, in WebAssembly. See handcast.d.ts for types and README.md for use.

import {
  HandcastError, bytesOf, check, choice, copy, flag, framesAt, give, instantiate, locate, named, optionsOf, sideNumber, sizesAt,
} from "./handcast.js";

const FAILED = 0xffffffff;
// The least and the most of options that are numbers.
const RANGES = { rate: [1 / 16, 255], rms: [0.01, 180], handLength: [0.05, 0.4], fieldOfView: [5, 150], analysisSide: [64, 4096] };
const OPTIONS = ["side", "view", "mirror", "anyStart", ...Object.keys(RANGES)];

/** An option that is a number; 0 is the default. */
function ranged(options, name) {
  const given = options[name] ?? 0;
  const [least, most] = RANGES[name];
  if (given !== 0 && !(typeof given === "number" && given >= least && given <= most)) {
    throw new HandcastError(`${name} is ${named(given)}, allowed are ${least} to ${most}, and 0 for the default`);
  }
  return given;
}

/** The tracker and encoder: a class around their module, for the thread that calls. */
export async function loadSender(source = new URL("handcast_sender.wasm", import.meta.url)) {
  const wasm = await instantiate(source, "sender");
  const forgotten = new FinalizationRegistry(number => wasm.sender_free(number));

  class Sender {
    #number;

    constructor(given) {
      const options = optionsOf(given, OPTIONS, "a sender");
      const { side, view, mirror = false, anyStart = false } = options;
      const [rate, rms, handLength, fieldOfView, analysisSide] = Object.keys(RANGES).map(name => ranged(options, name));
      const sees = (side == null ? 0 : 1 + sideNumber(side)) | (view == null ? 0 : 4 << choice(view, ["palm", "back"], "view"));
      const flags = flag(mirror, "mirror") | (flag(anyStart, "anyStart") << 1);
      this.#number = wasm.sender_new(rate, rms, sees, flags, handLength, fieldOfView, analysisSide);
      forgotten.register(this, this.#number, this);
    }

    get #own() {
      if (this.#number === FAILED) throw new HandcastError("this sender has been freed");
      return this.#number;
    }

    push(rgba, width, height, captureTime) {
      const own = this.#own;
      for (const [side, what] of [[width, "width"], [height, "height"]]) {
        if (!(Number.isInteger(side) && side > 0 && side <= 0xffff)) {
          throw new HandcastError(`${what} is ${named(side)}, allowed are 1 to 65535`);
        }
      }
      give(wasm, bytesOf(rgba, "pixels"));
      return this.#sent(wasm.sender_push(own, width, height, captureTime));
    }

    requestKey() {
      wasm.sender_request_intra(this.#own);
    }

    finish() {
      return this.#sent(wasm.sender_finish(this.#own));
    }

    #sent(outcome) {
      check(wasm, outcome);
      const count = wasm.sender_planes();
      const table = copy(wasm, Uint32Array, wasm.sender_table(), count * 5);
      const hello = wasm.sender_hello();
      let payloads = 0;
      let length = hello;
      for (let i = 0; i < count; i += 1) {
        payloads += table[5 * i + 3];
        length += table[5 * i + 3] + table[5 * i + 4];
      }
      const bytes = copy(wasm, Uint8Array, wasm.sender_bytes(), length);
      const [planes, keys, messages] = [[], [], hello ? [bytes.slice(payloads, payloads + hello)] : []];
      let [at, message] = [0, payloads + hello];
      for (let i = 0; i < count; i += 1) {
        const [flags, , , size, messageSize] = table.subarray(5 * i, 5 * i + 5);
        planes.push(bytes.slice(at, (at += size)));
        keys.push((flags & 1) !== 0);
        messages.push(bytes.slice(message, (message += messageSize)));
      }
      const poses = framesAt(wasm, wasm.sender_times(), wasm.sender_rows(), wasm.sender_poses(), []);
      const trouble = wasm.sender_trouble() ? new TextDecoder().decode(copy(wasm, Uint8Array, wasm.message(), wasm.message_len())) : null;
      return { planes, keys, messages, poses, trouble };
    }

    sizes(side) {
      const address = wasm.sender_sizes(this.#own, sideNumber(side));
      return address ? sizesAt(wasm, address, 1) : null;
    }

    get skinTone() {
      return wasm.sender_skin_tone(this.#own) || null;
    }

    free() {
      forgotten.unregister(this);
      wasm.sender_free(this.#number);
      this.#number = FAILED;
    }
  }
  return { Sender };
}

/**
 * A sender in a worker of its own. Pictures are dropped while it is busy, never queued: `push` says whether one was taken.
 */
export class SenderWorker {
  #worker;
  #started = false;
  #busy = true;
  #keyWanted = false;
  // What finish() has promised, and how the worker's answer settles it.
  #finished;
  #answer;

  constructor(options = {}, { onsent, onerror, wasm, worker } = {}) {
    if (!worker && typeof Worker === "undefined") {
      throw new HandcastError("there are no web workers here: loadSender() works on the thread that calls");
    }
    this.#worker = worker ?? new Worker(new URL("sender-worker.js", import.meta.url), { type: "module" });
    this.ready = new Promise((resolve, reject) => {
      const fail = (error, of) => {
        if (!this.#started) {
          this.#worker.terminate();
          reject(error);
        } else if (this.#answer && (of === "finish" || !of)) {
          this.#answer.reject(error);
        } else {
          (onerror ?? console.error)(error);
        }
      };
      this.#worker.onmessage = ({ data }) => {
        const { kind, of, sent } = data;
        if (kind === "sent" || of === "picture") this.#busy = false;
        if (kind === "failed") fail(new HandcastError(data.message), of);
        if (kind === "sent") onsent?.(sent, data);
        if (kind === "finished") this.#answer.resolve(sent);
        if (kind !== "ready") return;
        this.#started = true;
        this.#busy = false;
        if (this.#keyWanted) this.requestKey();
        resolve();
      };
      this.#worker.onerror = event => fail(new HandcastError(event.message || "the worker does not start"));
      this.#start(options, wasm).catch(fail);
    });
  }

  // An address is the page's, whatever place the worker has.
  async #start(options, wasm) {
    if (typeof wasm === "string" || wasm instanceof URL) wasm = (await locate(wasm)).href;
    this.#worker.postMessage({ kind: "start", options, wasm });
  }

  /** Whether a picture would be dropped. */
  get busy() {
    return this.#busy || this.#finished !== undefined;
  }

  /** Takes a VideoFrame, ImageBitmap or ImageData (which goes to the worker) captured at so many milliseconds. */
  push(picture, captureTime) {
    if (this.busy) return false;
    const moved = picture?.data ? picture.data.buffer : picture;
    this.#worker.postMessage({ kind: "picture", picture, captureTime }, [moved]);
    this.#busy = true;
    return true;
  }

  requestKey() {
    this.#keyWanted = !this.#started;
    if (this.#started) this.#worker.postMessage({ kind: "key" });
  }

  /** Ends the stream, and the worker. */
  finish() {
    this.#finished ??= this.#end();
    return this.#finished;
  }

  async #end() {
    await this.ready;
    try {
      return await new Promise((resolve, reject) => {
        this.#answer = { resolve, reject };
        this.#worker.postMessage({ kind: "finish" });
      });
    } finally {
      this.#worker.terminate();
    }
  }
}
