// The connection to a room: its clock, its senders, and when each pose is due.

import * as wire from "./wire.js";

// Milliseconds of this page's clock since 1970, finer than Date.now().
export const localTime = () => performance.timeOrigin + performance.now();
// Signed difference of two times modulo 2^32.
const since = (a, b) => (a - b) | 0;

// Pings of which the quickest tells the room's clock, and transits of which the quickest tells when a pose is due.
const PINGS = 12;
const TRANSITS = 300;

class Quickest {
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
    if (!follows && !next && this.at) this.take(this.decoder.lose());
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

  // Goes on to the newest pose that is due.
  advance(now) {
    const [quickest] = this.transits.least;
    const wait = Number.isFinite(quickest) ? quickest + this.buffer : 0;
    let due = null;
    while (this.queue.length && since(now >>> 0, this.queue[0].time) >= wait) due = this.queue.shift();
    if (due) this.shown = due;
    return due;
  }
}

export class Room {
  constructor(handcast, url, tell) {
    this.handcast = handcast;
    this.url = url;
    this.tell = tell;
    this.senders = new Map();
    this.pings = new Quickest(PINGS);
    this.offset = 0;
    this.buffer = "auto";
    this.own = null;
    this.wanted = false;
    this.bytes = 0;
    this.messages = 0;
    this.wait = 250;
    this.connect();
    setInterval(() => this.ping(), 1000);
  }

  // The room's clock, milliseconds.
  now() { return localTime() + this.offset; }

  get open() { return this.socket?.readyState === WebSocket.OPEN; }

  connect() {
    const socket = new WebSocket(this.url);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    const expander = new wire.Expander();
    socket.addEventListener("open", () => {
      this.wait = 250;
      this.pings = new Quickest(PINGS);
      this.ping();
      this.tell("open");
    });
    socket.addEventListener("message", event => {
      const now = this.now();
      this.bytes += event.data.byteLength;
      this.messages += 1;
      try {
        for (const message of expander.read(event.data)) this.take(message, now);
      } catch (error) {
        this.tell("error", error.message);
      }
    });
    socket.addEventListener("close", event => {
      this.own = null;
      for (const number of [...this.senders.keys()]) this.leave(number);
      this.tell("closed", event.wasClean ? "The room has ended." : "The room does not answer.");
      setTimeout(() => this.connect(), this.wait);
      this.wait = Math.min(3000, this.wait * 2);
    });
  }

  say(bytes) { if (this.open) this.socket.send(bytes); }

  ping() { this.say(wire.ping(localTime() * 1000)); }

  take(message, now) {
    switch (message.kind) {
      case "plane": this.sender(message.sender).plane(message, now); break;
      case "gap": this.sender(message.sender).gap(); break;
      case "hello": this.sender(message.sender).sides = message.hands; this.tell("senders"); break;
      case "welcome": this.own = message.sender; break;
      case "end": this.leave(message.sender); this.tell("end", message.gone); break;
      case "intra": this.wanted = true; break;
      case "pong": {
        const [sent, back] = [message.mark / 1000, localTime()];
        this.pings.add(back - sent, message.clock - (sent + back) / 2);
        this.offset = this.pings.least[1];
        this.trip = this.pings.least[0];
        break;
      }
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
