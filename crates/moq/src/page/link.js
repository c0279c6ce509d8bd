// The way to a room on relays: a sender is a broadcast, a period a group of its track, a message a frame (spec/live.md, section 5).

import { Broadcast, Connection, Group, Path, Time } from "./moq-net.js";
import { Freshness } from "./freshness.js";
import place from "./place.js";
import { localTime } from "./room.js";
import * as wire from "./wire.js";

const TRACK = "planes";
const MOST_SENDERS = 16;
// Milliseconds: until a relay that does not answer is passed over, the only one or one of several; from one round of them to the next.
const [ALONE, DIAL, PAUSE] = [5000, 2500, 300];
// Between looks whether a relay has answered.
const LOOK = 50;
// That WebTransport has before a WebSocket is tried as well: a joiner without UDP waits no longer.
const HEAD_START = 500;
// Of silence after which a relay is asked whether it is there, and for its answer.
const [QUIET, ANSWER] = [500, 700];
// After which a sender of whom nothing comes is gone, one says its hello again, and before a track that broke off is asked for again.
const [SILENCE, REPEAT, AGAIN] = [4000, 1000, 50];

const pause = ms => new Promise(done => setTimeout(done, ms));
const root = Path.from(place.room);

export const name = place.room;
export const link = room => new RelayLink(room);

class RelayLink {
  constructor(room) {
    this.room = room;
    this.connection = null;
    this.by = null;
    this.senders = new Map();
    // Paths of those for whom there was no number.
    this.leftOut = new Set();
    this.own = null;
    this.run();
    setInterval(() => {
      this.silence();
      this.own?.repeat();
    }, 500);
  }

  get open() { return this.connection !== null; }

  // The relays in turn, for ever.
  async run() {
    for (let k = 0; ; k = (k + 1) % place.relays.length) {
      try {
        const connection = await this.dial(place.relays[k]);
        this.connection = connection;
        this.relay = place.relays[k];
        this.by = connection.transport === "webtransport" ? "WebTransport" : "WebSocket";
        this.heard = localTime();
        this.room.opened();
        await Promise.race([this.find(connection), connection.closed, this.watch(connection)]).catch(() => {});
        this.connection = null;
        connection.close();
      } catch (error) {
        console.debug(`${place.relays[k]}: ${error.message}`);
      }
      const was = this.by;
      this.by = null;
      this.own = null;
      for (const sender of this.senders.values()) sender.stop();
      this.senders.clear();
      this.leftOut.clear();
      this.room.closed("The relay does not answer.");
      // One that was lost is followed by the next at once.
      if (!was) await pause(PAUSE);
    }
  }

  async dial(relay) {
    const hashes = place.fingerprints.map(value => ({ algorithm: "sha-256", value }));
    const dialled = new AbortController();
    // In looks, not by the clock: that this page was at work for long is not the relay's fault.
    let looks = (place.relays.length > 1 ? DIAL : ALONE) / LOOK;
    const timer = setInterval(() => { if (--looks <= 0) dialled.abort(new Error("no answer")); }, LOOK);
    const options = { signal: dialled.signal, webtransport: { serverCertificateHashes: hashes }, websocket: { delay: HEAD_START } };
    try {
      return await Connection.connect(new URL(relay), options);
    } finally {
      clearInterval(timer);
    }
  }

  // Whether the relay is still there is asked where nothing comes: a killed one does not say so over UDP.
  async watch(connection) {
    for (;;) {
      await pause(QUIET / 2);
      if (localTime() - this.heard < QUIET) continue;
      const nobody = connection.consume(Path.join(root, Path.from("nobody")));
      const answer = nobody.track(TRACK).info().then(() => true, () => true);
      const there = await Promise.race([answer, pause(ANSWER).then(() => localTime() - this.heard < QUIET)]);
      nobody.close();
      if (!there) return;
    }
  }

  // Finds the senders of the room.
  async find(connection) {
    const announced = connection.announced(root);
    for (let event; (event = await announced.next()); ) {
      // Of a connection that is lost something may come late.
      if (connection !== this.connection) return;
      const { path, active } = event;
      if (path === this.own?.path) continue;
      const known = this.senders.get(path);
      if (known) known.announced = active;
      if (!active) this.leftOut.delete(path);
      else if (!known) this.admit(path);
    }
  }

  // Reads a sender, once there is a number for it.
  admit(path) {
    const number = this.number();
    if (number === null) return this.leftOut.add(path);
    this.leftOut.delete(path);
    const sender = new Sender(this, this.connection, path, number);
    this.senders.set(path, sender);
    return sender.run();
  }

  // The least number that nobody has.
  number() {
    const taken = new Set([...this.senders.values()].map(sender => sender.number).concat(this.own?.number ?? []));
    for (let n = 0; n < MOST_SENDERS; n += 1) if (!taken.has(n)) return n;
    return null;
  }

  // A sender of whom nothing comes is gone; one that is not announced any more is not waited for.
  silence() {
    for (const [path, sender] of this.senders) {
      if (localTime() - sender.heard < SILENCE) continue;
      sender.part(true);
      if (sender.announced) continue;
      sender.stop();
      this.senders.delete(path);
    }
    if (!this.open) return;
    for (const path of [...this.leftOut]) if (this.number() !== null) this.admit(path);
  }

  // What this page's own hands send. The relays do not give it back, so the room is told here.
  say(bytes) {
    const [message] = new wire.Expander().read(bytes.slice().buffer);
    // What senders are asked for is asked of the room's server; relays pass nothing back.
    if (!["hello", "plane", "end"].includes(message.kind)) return;
    if (message.kind === "hello" && !this.own) {
      this.own = this.publish();
      if (!this.own) this.room.take({ kind: "refused", full: true }, this.room.now());
    }
    if (!this.own) return;
    this.own.say(message, bytes);
    this.room.take({ ...message, sender: this.own.number }, this.room.now());
    if (message.kind === "end") this.own = null;
  }

  publish() {
    const number = this.number();
    if (number === null) return null;
    const own = new Publication(this.connection, number);
    this.room.own = number;
    return own;
  }
}

// Reads one sender.
class Sender {
  constructor(link, connection, path, number) {
    Object.assign(this, { link, connection, path, number });
    this.announced = true;
    this.heard = localTime();
    this.freshness = new Freshness();
    this.hello = null;
    this.here = false;
    this.before = -1;
    this.stopped = false;
  }

  async run() {
    while (!this.stopped) {
      try {
        this.broadcast = this.connection.consume(Path.join(root, Path.from(this.path)));
        const groups = this.broadcast.track(TRACK).subscribe({ ordered: true, latencyMax: 500 });
        for (let group; !this.stopped && (group = await groups.nextGroup()); ) {
          if (group.sequence <= this.before) continue;
          this.before = group.sequence;
          // One that breaks off is followed by the next.
          await this.group(group).catch(() => {});
        }
      } catch (error) {
        console.debug(`${this.path}: ${error.message}`);
      }
      this.broadcast?.close();
      await pause(AGAIN);
    }
  }

  stop() {
    this.stopped = true;
    this.broadcast?.close();
  }

  async group(group) {
    const expander = new wire.Expander();
    for (let frame; !this.stopped && (frame = await group.readFrame()); ) {
      this.heard = this.link.heard = localTime();
      this.link.room.heard(frame.payload.byteLength);
      for (const message of expander.read(frame.payload.slice().buffer)) this.take(message);
    }
  }

  take(message) {
    const { room } = this.link;
    switch (message.kind) {
      case "hello":
        // It is repeated where there is nothing else to say.
        if (this.here && this.hello?.hands.join() !== message.hands.join()) room.take({ ...message, sender: this.number }, room.now());
        this.hello = { ...message, sender: this.number };
        break;
      case "plane":
        for (const plane of this.freshness.push(message, localTime())) {
          if (!this.here && this.hello) room.take(this.hello, room.now());
          this.here = true;
          room.take({ ...plane, sender: this.number }, room.now());
        }
        break;
      case "end": this.part(message.gone); break;
    }
  }

  // Who comes back begins with a period.
  part(gone) {
    this.freshness.pause();
    if (this.here) this.link.room.take({ kind: "end", sender: this.number, gone }, this.link.room.now());
    this.here = false;
  }
}

// Publishes this page's hands.
class Publication {
  constructor(connection, number) {
    this.number = number;
    this.path = Path.from(`page-${[...crypto.getRandomValues(new Uint8Array(8))].map(b => b.toString(16).padStart(2, "0")).join("")}`);
    this.broadcast = new Broadcast.Producer();
    this.track = this.broadcast.createTrack(TRACK);
    // Numbers of groups grow from one run to the next.
    this.next = Date.now();
    this.group = null;
    this.hello = null;
    this.said = 0;
    connection.publish(Path.join(root, this.path), this.broadcast);
  }

  say(message, bytes) {
    switch (message.kind) {
      case "hello":
        this.hello = bytes;
        this.write(bytes);
        break;
      case "plane":
        if (message.index === 0) {
          this.open();
          this.write(new Uint8Array([...(this.hello ?? []), ...bytes]));
        } else this.write(bytes);
        break;
      case "end":
        if (!this.group) this.open();
        this.write(bytes);
        this.group.close();
        this.track.close();
        // The last frame is let through before the path is withdrawn.
        setTimeout(() => this.broadcast.close(), 200);
        break;
    }
  }

  open() {
    this.group?.close();
    this.group = new Group.Producer(this.next++);
    this.track.writeGroup(this.group);
  }

  // Says the hello again where nothing was said for long: hands that rest are there.
  repeat() {
    if (this.hello && localTime() - this.said >= REPEAT) this.write(this.hello);
  }

  // Before the first period there is nothing that a reader could begin with.
  write(payload) {
    this.said = localTime();
    this.group?.writeFrame({ payload, timestamp: Time.Timestamp.fromMillis(Math.round(localTime())) });
  }
}
