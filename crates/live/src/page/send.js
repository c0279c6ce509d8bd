// This browser's camera to the room: pictures to a worker that tracks and encodes, its messages to the socket.

import { SenderWorker } from "./handcast-sender.js";
import * as wire from "./wire.js";
import { localTime } from "./room.js";

const [WIDTH, HEIGHT, RATE] = [640, 360, 30];
// Milliseconds that two clocks may go apart from picture to picture: some 300 millionths.
const APART = 0.01;
// Share of a picture's interval by which the room's clock is followed backwards: captures go on, and a little slower.
const BACKWARDS = 0.1;
const GONE = "The camera is gone.";
// Why there is no camera, by the name of the browser's error.
const NO_CAMERA = {
  NotAllowedError: "The browser does not let this page use the camera: allow it beside the address.",
  NotFoundError: "There is no camera.",
  NotReadableError: "The camera gives no pictures: another program may have it.",
};

export class OwnHands {
  // tell: what there is to say, as text. lost: that sending is over, and why.
  constructor(room, video, tell, lost) {
    this.room = room;
    this.video = video;
    this.tell = tell;
    this.lost = lost;
    this.on = false;
    this.pictures = 0;
    this.taken = [];
    this.sent = 0;
    this.ahead = Infinity;
    this.trouble = "Spread your five fingers once.";
  }

  async start() {
    this.tell("Asking for the camera …");
    this.stream = await navigator.mediaDevices.getUserMedia({
      audio: false, video: { width: { ideal: WIDTH }, height: { ideal: HEIGHT }, frameRate: { ideal: RATE }, facingMode: "user" },
    }).catch(error => { throw new Error(NO_CAMERA[error.name] ?? error.message); });
    const [camera] = this.stream.getVideoTracks();
    try {
      camera.addEventListener("ended", () => this.lost(GONE));
      this.video.srcObject = this.stream;
      await this.video.play();
      this.video.hidden = false;
      this.tell("Loading the tracker …");
      this.worker = new SenderWorker({ rate: RATE }, {
        onsent: (sent, of) => this.pass(sent, of),
        onerror: error => { this.trouble = error.message; },
      });
      await this.worker.ready;
      if (camera.readyState === "ended") throw new Error(GONE);
    } catch (error) {
      this.release();
      // One that is not ready may never be: it is not waited for.
      this.worker?.finish().catch(() => {});
      throw error;
    }
    this.on = true;
    [this.last, this.own, this.distance] = [0, 0, -Infinity];
    this.watch(camera).catch(error => this.lost(error.message));
  }

  // Pictures as the camera gives them, also while the page is behind another; where a browser has that in workers alone, those
  // that are shown.
  async watch(camera) {
    if (!globalThis.MediaStreamTrackProcessor) return this.next();
    const pictures = new MediaStreamTrackProcessor({ track: camera, maxBufferSize: 1 }).readable.getReader();
    while (this.on) {
      const { done, value } = await pictures.read();
      if (done) break;
      this.take(value, this.clock(value.timestamp / 1000));
    }
    return pictures.cancel();
  }

  // What the page's clock said when the camera's said `time` (milliseconds): as much later as the quickest picture came,
  // or by as much more as clocks go apart.
  clock(time) {
    this.ahead = Math.min(this.ahead + APART, performance.now() - time);
    return time + this.ahead;
  }

  next() {
    if (!this.on) return;
    this.video.requestVideoFrameCallback(async (now, facts) => {
      const picture = this.worker.busy ? null : await createImageBitmap(this.video).catch(() => null);
      this.take(picture, facts.captureTime ?? now);
      this.next();
    });
  }

  // What the room's clock says when the page's says `time` (milliseconds). It may be set back, which pictures do not follow at once.
  captured(time) {
    const own = performance.timeOrigin + time;
    const back = BACKWARDS * Math.max(0, own - this.own);
    this.own = own;
    this.distance = Math.max(this.room.offset, this.distance - back);
    return Math.max(this.last + 1, own + this.distance);
  }

  take(picture, time) {
    this.pictures += 1;
    const captured = this.captured(time);
    if (this.on && picture && this.worker.push(picture, captured)) this.last = captured;
    else picture?.close();
  }

  pass(sent, { milliseconds }) {
    this.taken.push([localTime(), milliseconds]);
    if (this.taken.length > 90) this.taken.shift();
    if (sent.poses.length) this.trouble = null;
    else if (sent.trouble) this.trouble = sent.trouble;
    for (const message of sent.messages) {
      if (wire.isHello(message)) this.hello = message;
      this.say(message);
    }
    if (this.room.wanted) {
      this.room.wanted = false;
      this.worker.requestKey();
    }
  }

  // Each connection begins with a hello, and can be read from a period's first plane on.
  say(message) {
    if (!this.room.open || !this.hello) return;
    if (this.said !== this.room.connections) {
      this.said = this.room.connections;
      if (message !== this.hello) {
        this.room.say(this.hello);
        this.worker.requestKey();
        return;
      }
    }
    this.sent += message.length;
    this.room.say(message);
  }

  // Lets go of the camera.
  release() {
    this.stream?.getTracks().forEach(track => track.stop());
    this.video.srcObject = null;
    this.video.hidden = true;
  }

  async stop() {
    this.on = false;
    this.release();
    try {
      await this.worker?.finish();
    } finally {
      if (this.hello) this.room.say(wire.end());
      this.room.own = null;
    }
    this.tell("");
  }

  // Pictures tracked a second, and milliseconds each took.
  get pace() {
    const recent = this.taken.slice(-60);
    if (recent.length < 2) return { rate: 0, milliseconds: 0 };
    const seconds = (recent.at(-1)[0] - recent[0][0]) / 1000;
    return { rate: (recent.length - 1) / Math.max(1e-3, seconds), milliseconds: recent.reduce((sum, [, ms]) => sum + ms, 0) / recent.length };
  }

  get words() {
    const { rate, milliseconds } = this.pace;
    return `${rate.toFixed(1)} pictures a second, ${milliseconds.toFixed(0)} ms each`;
  }
}
