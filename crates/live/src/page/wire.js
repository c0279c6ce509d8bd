// The messages of a room: see spec/live.md.

const VERSION = 3;
const [PLANE, HELLO, WELCOME, END, INTRA, PING, PONG, REFUSED] = [0, 1, 2, 3, 4, 5, 6, 7];
const [SHORT, TO_THE_END] = [0x80, 0x40];
// Milliseconds that four bits tell, from this on, and what says that a byte tells them.
const [COMMON, OWN_TIME] = [28, 15];
// The same of a plane behind another in a message, of which the upper two bits of the first byte tell.
const [NEXT, NEXT_MASK, NEXT_TO_THE_END, NEXT_COMMON, NEXT_OWN_TIME] = [0x40, 0xc0, 0x20, 20, 31];

class Reader {
  constructor(buffer) {
    this.view = new DataView(buffer);
    this.at = 0;
  }
  get left() { return this.view.byteLength - this.at; }
  get more() { return this.left > 0; }
  u8() { return this.view.getUint8(this.at++); }
  u16() { this.at += 2; return this.view.getUint16(this.at - 2); }
  u32() { this.at += 4; return this.view.getUint32(this.at - 4); }
  u64() { this.at += 8; return this.view.getBigUint64(this.at - 8); }
  bytes(length) {
    this.at += length;
    return new Uint8Array(this.view.buffer, this.at - length, length).slice();
  }
  payload() {
    let length = 0;
    for (let shift = 0; shift < 21; shift += 7) {
      const byte = this.u8();
      length |= (byte & 0x7f) << shift;
      if (!(byte & 0x80)) break;
    }
    return this.bytes(length);
  }
}

// Reads the messages of one connection; a short plane goes on from the one before of its sender.
export class Expander {
  #before = new Map();

  read(buffer) {
    const r = new Reader(buffer);
    const messages = [];
    while (r.more) messages.push(this.#message(r, messages.at(-1)));
    return messages;
  }

  #message(r, last) {
    const first = r.u8();
    if (first & SHORT) return this.#keep(this.#short(first, r));
    if ((first & NEXT_MASK) === NEXT) return this.#keep(this.#next(first, r, last));
    if (first >> 4 !== VERSION) throw new Error(`The room speaks version ${first >> 4}, this page version ${VERSION}: load it again.`);
    const kind = first & 0x0f;
    switch (kind) {
      case PLANE: {
        const [sender, flags] = [r.u8(), r.u8()];
        const [period, index, time] = [r.u16(), r.u16(), r.u32()];
        const lost = { left: Boolean(flags & 2), right: Boolean(flags & 4) };
        return this.#keep({ kind: "plane", sender, period, index, time, replay: Boolean(flags & 1), lost, payload: r.payload() });
      }
      case HELLO: {
        const [sender, hands] = [r.u8(), r.u8()];
        return { kind: "hello", sender, hands: ["left", "right"].filter((_, i) => hands & (1 << i)), record: r.bytes(r.u8()) };
      }
      case WELCOME: return { kind: "welcome", sender: r.u8() };
      case END: return { kind: "end", sender: r.u8(), gone: r.u8() === 1 };
      case INTRA: return { kind: "intra", sender: r.u8() };
      case PING: return { kind: "ping", mark: r.u64() };
      case PONG: return { kind: "pong", mark: Number(r.u64()), clock: Number(r.u64()) / 1000 };
      case REFUSED: return { kind: "refused", full: r.u8() === 1 };
      default: throw new Error(`message of kind ${kind}`);
    }
  }

  #short(first, r) {
    const sender = first & 0x0f;
    const second = r.u8();
    const time = second & 0x0f;
    const passed = time === OWN_TIME ? r.u8() : COMMON + time;
    const payload = first & TO_THE_END ? r.bytes(r.left) : r.payload();
    const before = this.#before.get(sender);
    const next = (before?.index ?? -1) + 1;
    const goesOn = before && (before.period & 3) === ((first >> 4) & 3) && (next & 15) === second >> 4;
    if (!goesOn) return { kind: "gap", sender };
    return { ...before, index: next, time: (before.time + passed) >>> 0, payload };
  }

  // What follows a plane that does not go on does not either.
  #next(first, r, last) {
    const time = first & 0x1f;
    const passed = time === NEXT_OWN_TIME ? r.u8() : NEXT_COMMON + time;
    const payload = first & NEXT_TO_THE_END ? r.bytes(r.left) : r.payload();
    if (last?.kind !== "plane") return { kind: "gap", sender: last?.sender ?? 0 };
    return { ...last, index: last.index + 1, time: (last.time + passed) >>> 0, payload };
  }

  #keep(message) {
    this.#before.set(message.sender, message.kind === "plane" ? message : undefined);
    return message;
  }
}

const packed = (length, fill) => {
  const view = new DataView(new ArrayBuffer(length));
  fill(view);
  return new Uint8Array(view.buffer);
};

export const ping = mark => packed(9, view => { view.setUint8(0, (VERSION << 4) | PING); view.setBigUint64(1, BigInt(Math.round(mark))); });
export const intra = sender => new Uint8Array([(VERSION << 4) | INTRA, sender]);
export const end = () => new Uint8Array([(VERSION << 4) | END, 0, 0]);
export const hello = (hands, record) =>
  new Uint8Array([(VERSION << 4) | HELLO, 0, Number(hands.includes("left")) | (Number(hands.includes("right")) << 1), record.length, ...record]);

export const isHello = message => !(message[0] & SHORT) && (message[0] & 0x0f) === HELLO;

// A plane in its long form, as a sender says it to the room.
export function plane({ period, index, time, lost, payload }) {
  const length = [];
  for (let rest = payload.length; ; rest >>= 7) {
    length.push(rest >= 0x80 ? (rest & 0x7f) | 0x80 : rest);
    if (rest < 0x80) break;
  }
  const flags = (lost?.left ? 2 : 0) | (lost?.right ? 4 : 0);
  const head = packed(11, view => {
    view.setUint8(0, (VERSION << 4) | PLANE);
    view.setUint8(2, flags);
    view.setUint16(3, period & 0xffff);
    view.setUint16(5, index);
    view.setUint32(7, time >>> 0);
  });
  const bytes = new Uint8Array(11 + length.length + payload.length);
  bytes.set(head);
  bytes.set(length, 11);
  bytes.set(payload, 11 + length.length);
  return bytes;
}
