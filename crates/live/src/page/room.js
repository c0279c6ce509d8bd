// A room: its clock, its senders, and when each pose is due.

import * as wire from "./wire.js";

// Milliseconds of this page's clock since 1970, finer than Date.now().
export const localTime = () => performance.timeOrigin + performance.now();
// Signed difference of two times modulo 2^32.
const since = (a, b) => (a - b) | 0;

// Transits of which the quickest tells when a pose is due.
const TRANSITS = 300;

export class Quickest {
  constructor(most) {
    this.most = most;
    this.list = [];
  }
  add(time, value) {
    this.list.push([time, value]);
    if (this.list.length > this.most) this.list.shift();
  }
  get least() { return this.list.reduce((a, b) => (b[0] < a[0] ? b : a), [Infinity, null]); }
  // Time by which this share of the list is slower than the quickest, at most.
  spread(share) {
    const times = this.list.map(([time]) => time).sort((a, b) => a - b);
    return times.length ? times[Math.min(times.length - 1, Math.floor(share * times.length))] - times[0] : 0;
  }
}

// What one sender has sent, decoded, and waiting to be shown.
class Sender {
  constructor(number, room) {
    this.number = number;
    this.room = room;
    this.decoder = new room.handcast.Decoder();
    this.sides = [];
    this.queue = [];
    this.shown = null;
    this.at = null;
    this.transits = new Quickest(TRANSITS);
    this.damaged = false;
    this.bits = 0;
    this.planes = 0;
  }

  free() { this.decoder.free(); }

  plane(message, now) {
    const opens = message.index === 0;
    const follows = this.at && this.at.period === message.period && this.at.index + 1 === message.index;
    const next = this.at && opens && ((this.at.period + 1) & 0xffff) === message.period;
    if (!follows && !opens) return this.gap();
    if (!follows && !next && this.at) this.decoder.lose();
    this.at = { period: message.period, index: message.index };
    this.damaged = false;
    this.planes += 1;
    if (!message.replay) this.bits += message.payload.length * 8;
    const hands = this.take(this.decoder.pushPlane(message.payload));
    const lost = message.lost;
    if (message.replay) {
      if (hands) this.shown = { hands, lost, time: message.time };
      return;
    }
    const transit = since(now >>> 0, message.time);
    // The last plane of a replay is as old as the hand has been at rest.
    if (transit < 5000) this.transits.add(transit, null);
    const before = this.queue.at(-1) ?? this.shown;
    const shown = hands ?? before?.hands;
    if (shown) this.queue.push({ hands: shown, lost, time: message.time, arrived: now });
    // Pages that nobody looks at draw nothing: what others have overtaken is not kept for them.
    while (this.isDue(1, now)) this.queue.shift();
  }

  // The hands of the last instant, if there is any.
  take(frames) { return frames.at(-1)?.hands ?? null; }

  gap() {
    if (!this.damaged) {
      this.damaged = true;
      this.at = null;
      this.room.say(wire.intra(this.number));
    }
  }

  // Milliseconds that poses wait so that late ones come in time.
  get buffer() {
    const { buffer } = this.room;
    return buffer === "auto" ? Math.min(80, Math.max(0, this.transits.spread(0.95))) : buffer;
  }

  // Whether the pose at a place of the queue is due.
  isDue(place, now) {
    if (this.queue.length <= place) return false;
    const [quickest] = this.transits.least;
    const wait = Number.isFinite(quickest) ? quickest + this.buffer : 0;
    return since(now >>> 0, this.queue[place].time) >= wait;
  }

  // Goes on to the newest pose that is due.
  advance(now) {
    let due = null;
    while (this.isDue(0, now)) due = this.queue.shift();
    if (due) this.shown = due;
    return due;
  }
}

// Senders and what they say, whatever way it comes by: `makeLink(room)` gives the link, which has `open`, `by`, `say(bytes)`,
// and tells the room by `opened`, `heard`, `take` and `closed`. The way is opened while the decoder still loads.
export class Room {
  constructor(makeLink, tell) {
    this.handcast = null;
    // What came before the decoder, and when; none where there is no decoder to be had.
    this.early = [];
    this.deaf = false;
    this.tell = tell;
    this.senders = new Map();
    this.offset = 0;
    this.trip = 0;
    this.buffer = "auto";
    this.own = null;
    this.wanted = false;
    this.bytes = 0;
    this.messages = 0;
    // Number of the connection: what was said to one before is forgotten.
    this.connections = 0;
    this.link = makeLink(this);
  }

  // The decoder is there: what came before it is taken now.
  decodes(handcast) {
    this.handcast = handcast;
    this.early.splice(0).forEach(([message, came]) => this.take(message, came));
  }

  // The room's clock, milliseconds.
  now() { return localTime() + this.offset; }

  get open() { return Boolean(this.link?.open); }

  say(bytes) { if (this.open) this.link.say(bytes); }

  opened() {
    this.connections += 1;
    this.tell("open");
  }

  heard(bytes) {
    this.bytes += bytes;
    this.messages += 1;
  }

  closed(why) {
    this.own = null;
    this.early = [];
    for (const number of [...this.senders.keys()]) this.leave(number);
    this.tell("closed", why);
  }

  take(message, now) {
    if (!this.handcast) {
      if (!this.deaf) this.early.push([message, now]);
      return;
    }
    switch (message.kind) {
      case "plane": this.sender(message.sender).plane(message, now); break;
      case "gap": this.sender(message.sender).gap(); break;
      case "hello": this.sender(message.sender).sides = message.hands; this.tell("senders"); break;
      case "welcome": this.own = message.sender; break;
      case "end": this.leave(message.sender); this.tell("end", message); break;
      case "intra": this.wanted = true; break;
      case "refused":
        this.tell("refused", message.full ? "The room is full: no more hands can be sent to it." : "Nobody but the room itself sends here.");
        break;
    }
  }

  sender(number) {
    let sender = this.senders.get(number);
    if (!sender) {
      sender = new Sender(number, this);
      this.senders.set(number, sender);
      this.tell("senders");
    }
    return sender;
  }

  leave(number) {
    this.senders.get(number)?.free();
    this.senders.delete(number);
    this.tell("senders");
  }
}
