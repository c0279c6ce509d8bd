// The way to a room of the embedded server: a WebSocket, dialled again when it breaks.

import { Quickest, localTime } from "./room.js";
import * as wire from "./wire.js";

// Code of a connection that is closed because of what was sent.
const BROKEN = 1002;
// Code of one whose room ends.
const ENDED = 1001;
// Milliseconds in which a room answers a ping, and in which it is reached: browsers wait for minutes.
const [PATIENCE, DIAL] = [3000, 5000];
// Milliseconds after which it is dialled anew where there is a reason to.
const STALE = 1000;
// Milliseconds from one try to reach it to the next, at first and at most.
const [SOON, LATE] = [250, 3000];
// Pings of which the quickest tells the room's clock.
const PINGS = 12;

export const name = location.pathname.split("/").pop() || "hand";

export function link(room) {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  // Another token is another way in.
  addEventListener("hashchange", () => location.reload());
  const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
  return new SocketLink(room, `${scheme}://${location.host}/${name}/live?token=${encodeURIComponent(token)}`);
}

class SocketLink {
  by = "WebSocket";

  constructor(room, url) {
    this.room = room;
    this.url = url;
    this.pings = new Quickest(PINGS);
    this.wait = SOON;
    this.ended = false;
    this.connect();
    setInterval(() => this.ping(), 1000);
    // What was dialled before leads nowhere then.
    addEventListener("online", () => this.hurry());
    document.addEventListener("visibilitychange", () => { if (!document.hidden) this.hurry(); });
  }

  get open() { return this.socket?.readyState === WebSocket.OPEN; }

  connect() {
    clearTimeout(this.timer);
    const socket = new WebSocket(this.url);
    this.socket = socket;
    this.dialled = localTime();
    this.timer = setTimeout(() => this.giveUp(), DIAL);
    socket.binaryType = "arraybuffer";
    const expander = new wire.Expander();
    let opened = false;
    socket.addEventListener("open", () => {
      if (socket !== this.socket) return socket.close();
      opened = true;
      clearTimeout(this.timer);
      this.asked = this.heard = localTime();
      this.ended = false;
      this.wait = SOON;
      this.pings = new Quickest(PINGS);
      this.ping();
      this.room.opened();
    });
    socket.addEventListener("message", event => {
      if (socket !== this.socket) return;
      const now = this.room.now();
      this.heard = localTime();
      this.room.heard(event.data.byteLength);
      try {
        for (const message of expander.read(event.data)) {
          if (message.kind === "pong") this.pong(message);
          else this.room.take(message, now);
        }
      } catch (error) {
        this.room.tell("error", error.message);
      }
    });
    socket.addEventListener("close", event => {
      // Of one that was given up it comes late.
      if (socket !== this.socket) return;
      this.ended ||= event.wasClean || event.code === ENDED;
      const why = this.ended ? "The room has ended." : "The room does not answer.";
      this.room.closed(event.code === BROKEN ? `The room has closed the connection: ${event.reason}.` : why);
      if (!opened) this.askWhy();
      this.redial();
    });
  }

  redial() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.connect(), this.wait);
    this.wait = Math.min(LATE, this.wait * 2);
  }

  // The network, or somebody who looks, is back: what is open is asked whether it still leads there, else it is dialled anew.
  hurry() {
    if (this.open) return this.ping();
    this.wait = SOON;
    const fresh = this.socket?.readyState === WebSocket.CONNECTING && localTime() - this.dialled < STALE;
    return fresh ? undefined : this.giveUp();
  }

  // Browsers do not tell why there is no socket.
  async askWhy() {
    const request = { method: "HEAD", signal: AbortSignal.timeout(2000) };
    const reply = await fetch(this.url.replace(/^ws/, "http"), request).catch(() => undefined);
    if (reply?.status === 403 && !this.open) {
      this.room.closed("The room lets nobody in without its token: is the address whole?");
    }
  }

  say(bytes) { this.socket.send(bytes); }

  ping() {
    if (!this.open) return;
    const now = localTime();
    // What was asked since the room was heard is not answered: the room stands still, or the way to it is cut.
    if (this.heard < this.asked && now - this.asked > PATIENCE) return this.giveUp();
    if (this.heard >= this.asked) this.asked = now;
    this.say(wire.ping(now * 1000));
  }

  giveUp() {
    const dead = this.socket;
    this.socket = undefined;
    dead?.close();
    this.room.closed(this.ended ? "The room has ended." : "The room does not answer.");
    this.redial();
  }

  pong({ mark, clock }) {
    const [sent, back] = [mark / 1000, localTime()];
    this.pings.add(back - sent, clock - (sent + back) / 2);
    [this.room.trip, this.room.offset] = this.pings.least;
  }
}
