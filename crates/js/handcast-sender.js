// A camera's pictures to the planes of a live stream, in WebAssembly. See handcast.d.ts for types and README.md for use.

import { HandcastError, check, copy, framesAt, give, instantiate, sideNumber, sizesAt } from "./handcast.js";

const SEES = { left: 1, right: 2, palm: 4, back: 8 };

/** The tracker and encoder: a class around their module, for the thread that calls. */
export async function loadSender(source = new URL("handcast_sender.wasm", import.meta.url)) {
  const wasm = await instantiate(source);
  const forgotten = new FinalizationRegistry(number => wasm.sender_free(number));

  class Sender {
    #number;

    constructor(options = {}) {
      const { rate = 0, rms = 0, side, view, mirror = false, anyStart = false } = options;
      const { handLength = 0, fieldOfView = 0, analysisSide = 0 } = options;
      const sees = (SEES[side] ?? 0) | (SEES[view] ?? 0);
      const flags = Number(mirror) | (Number(anyStart) << 1);
      this.#number = wasm.sender_new(rate, rms, sees, flags, handLength, fieldOfView, analysisSide);
      forgotten.register(this, this.#number, this);
    }

    push(rgba, width, height, captureTime) {
      give(wasm, rgba);
      return this.#sent(wasm.sender_push(this.#number, width, height, captureTime));
    }

    requestKey() {
      wasm.sender_request_intra(this.#number);
    }

    finish() {
      return this.#sent(wasm.sender_finish(this.#number));
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
      const address = wasm.sender_sizes(this.#number, sideNumber(side));
      return address ? sizesAt(wasm, address, 1) : null;
    }

    get skinTone() {
      return wasm.sender_skin_tone(this.#number) || null;
    }

    free() {
      forgotten.unregister(this);
      wasm.sender_free(this.#number);
      this.#number = 0xffffffff;
    }
  }
  return { Sender };
}

/**
 * A sender in a worker of its own. Pictures are dropped while it is busy, never queued: `push` says whether one was taken.
 */
export class SenderWorker {
  #worker;
  #busy = true;
  #done;

  constructor(options = {}, { onsent, onerror, wasm, worker } = {}) {
    this.#worker = worker ?? new Worker(new URL("sender-worker.js", import.meta.url), { type: "module" });
    this.ready = new Promise((resolve, reject) => {
      this.#worker.onmessage = ({ data }) => {
        if (data.kind === "failed") {
          const error = new HandcastError(data.message);
          if (data.starting) reject(error);
          else (onerror ?? console.error)(error);
          if (data.starting) return;
        }
        this.#busy = false;
        if (data.kind === "ready") resolve();
        if (data.kind === "sent") onsent?.(data.sent, data);
        if (data.kind === "finished") this.#done?.(data.sent);
      };
      this.#worker.onerror = event => reject(new HandcastError(event.message ?? "the worker does not start"));
    });
    this.#worker.postMessage({ kind: "start", options, wasm });
  }

  /** Whether a picture would be dropped. */
  get busy() {
    return this.#busy;
  }

  /** Takes a VideoFrame, ImageBitmap or ImageData (which goes to the worker) captured at so many milliseconds. */
  push(picture, captureTime) {
    if (this.#busy) return false;
    this.#busy = true;
    const moved = picture.data ? picture.data.buffer : picture;
    this.#worker.postMessage({ kind: "picture", picture, captureTime }, [moved]);
    return true;
  }

  requestKey() {
    this.#worker.postMessage({ kind: "key" });
  }

  /** Ends the stream, and the worker. */
  async finish() {
    const sent = await new Promise(done => {
      this.#done = done;
      this.#worker.postMessage({ kind: "finish" });
    });
    this.#worker.terminate();
    return sent;
  }
}
