// The page: draws the hands of everybody in the room when they are due, and says how long they took.

import { load, loadSurface, skinningRows } from "./handcast.js";
import { link, name } from "./link.js";
import { Room } from "./room.js";
import { Sharpness } from "./sharpness.js";
import { Strip } from "./strip.js";

const element = id => document.getElementById(id);
const wish = new URLSearchParams(location.hash.slice(1));

// What is the same is not written again: a screen reader would read it out again.
function write(id, text) {
  if (element(id).textContent !== text) element(id).textContent = text;
}
function say(text) {
  write("message", text);
  element("message").hidden = !text;
}

// A hand of a sender: where its joints are now, and its surface once that is there.
class Shown {
  constructor(side, version, fine) {
    this.side = side;
    this.version = version;
    this.fine = fine;
    this.frames = new Float32Array(300);
    this.rows = new Float32Array(300);
    this.valid = true;
    this.joints = new Float32Array(400);
    this.colour = PLAIN_SKIN;
  }

  get worn() { return Boolean(this.vertices); }

  // joints: 25 matrices column by column, moved aside and up by so much.
  pose(joints, [aside, up]) {
    this.joints.set(joints);
    for (let j = 0; j < 25; j += 1) {
      this.joints[j * 16 + 12] += aside;
      this.joints[j * 16 + 13] += up;
      for (let r = 0; r < 3; r += 1) {
        for (let c = 0; c < 4; c += 1) this.frames[j * 12 + r * 4 + c] = this.joints[j * 16 + c * 4 + r];
      }
    }
    if (this.worn) skinningRows(this.joints, this.inverse_bind, this.rows);
  }
}

// Metres between the middles of two senders, beside and above one another.
const APART = [0.34, 0.32];
// Milliseconds that skins wait for a sketch of the first hand.
const LONGEST_SKETCH = 1000;
// Share of the way to a smaller view that is gone at each picture.
const CALM = 0.02;
// Pixels a metre up to which the fewer triangles of the plain surface look as round as those of the fine one: their edges of
// 2.4 mm around a finger of 8 mm leave it by 0.09 mm, which is then half a pixel.
const PLAIN = 5500;

const canvas = element("hand");
const labels = new Map();
const orbit = new Orbit({ all: { centre: [0, 0, -0.6], points: [[0.15, 0.15, 0], [-0.15, -0.15, 0]], radius: 0.3 }, one: { points: [], radius: 0.3 } });
let box = null;
const sketch = new Sketch(element("sketch"));
let painter = null;
let surface = null;
let room = null;
const shownHands = new Map();
const drawn = [];
const latency = new Strip(element("latency"), "ms", 50);
const rate = new Strip(element("rate"), "kbit/s", 2);

// What is in the picture, larger at once and smaller by and by.
function frame(hands) {
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (const hand of hands) {
    for (let j = 0; j < 25; j += 1) {
      jointPlace(hand.frames, j).forEach((v, k) => { low[k] = Math.min(low[k], v); high[k] = Math.max(high[k], v); });
    }
  }
  if (low[0] > high[0]) return;
  const ease = (old, now, outwards) => (outwards ? now : old + CALM * (now - old));
  box = box
    ? { low: low.map((v, k) => ease(box.low[k], v, v < box.low[k])), high: high.map((v, k) => ease(box.high[k], v, v > box.high[k])) }
    : { low, high };
  const centre = box.low.map((v, k) => (v + box.high[k]) / 2);
  const half = box.high.map((v, k) => v - centre[k]);
  const points = [-1, 1].flatMap(x => [-1, 1].flatMap(y => [-1, 1].map(z => [x * half[0], y * half[1], z * half[2]])));
  orbit.reach.all = { centre, points, radius: Math.hypot(...half) + 0.1 };
}

// Whether hands are so large that their fine surfaces are seen; without a graphics card those would not come in time. They stay
// until hands are a good deal smaller, since each change makes surfaces anew.
let fine = false;
function lookAtSize(pixels) {
  fine = Boolean(painter?.hasCard) && pixels / (2 * HALF * orbit.distance) > (fine ? 0.7 : 1) * PLAIN;
}

// How many senders stand beside one another where they are largest on this stage: all of them on a wide one.
function columns(senders, [width, height]) {
  const large = n => Math.min(width / (n * APART[0]), height / (Math.ceil(senders / n) * APART[1]));
  let best = senders;
  for (let n = senders - 1; n > 0; n -= 1) if (large(n) > large(best)) best = n;
  return best;
}

// Whether there is one.
let seen = false;
// The hands of everybody, as far as they have been seen.
function handsNow() {
  const senders = [...room.senders.values()].filter(sender => sender.shown).sort((a, b) => a.number - b.number);
  const hands = [];
  const across = columns(senders.length, stage[0] ? stage : [canvas.clientWidth, canvas.clientHeight]);
  const rows = Math.ceil(senders.length / across);
  senders.forEach((sender, n) => {
    const row = Math.floor(n / across);
    const beside = Math.min(across, senders.length - row * across);
    const at = [((n % across) - (beside - 1) / 2) * APART[0], ((rows - 1) / 2 - row) * APART[1]];
    for (const { side, joints, lost } of sender.shown.hands) {
      if (sender.sides.length && !sender.sides.includes(side)) continue;
      const key = `${sender.number} ${side}`;
      const sizes = sender.decoder.sizes(side);
      let hand = shownHands.get(key);
      if (!hand || hand.owner !== sender || hand.version !== sizes.version || hand.fine !== fine) {
        hand = new Shown(side, sizes.version, fine);
        hand.owner = sender;
        shownHands.set(key, hand);
      }
      if (surface && painter && !hand.worn) Object.assign(hand, surface(side, sizes, { fine }));
      const { skinTone } = sender.decoder.facts;
      if (hand.tone !== skinTone) {
        const colour = room.handcast.skinColour(skinTone);
        hand.tone = skinTone;
        hand.colour = colour ?? PLAIN_SKIN;
        hand.skin = colour && inLinearLight(colour);
      }
      hand.pose(joints, at);
      hand.valid = !(lost || sender.damaged || sender.shown.lost[side]);
      hand.key = key;
      hands.push(hand);
    }
  });
  for (const key of shownHands.keys()) if (!hands.some(hand => hand.key === key)) shownHands.delete(key);
  if (seen !== hands.length > 0) {
    seen = !seen;
    told("hands");
  }
  return hands;
}

function label(hands, width, height) {
  for (const [key, span] of labels) {
    if (hands.some(hand => hand.key === key)) continue;
    span.remove();
    labels.delete(key);
  }
  for (const hand of hands) {
    let span = labels.get(hand.key);
    if (!span) {
      span = document.createElement("span");
      labels.set(hand.key, span);
      element("labels").append(span);
    }
    const wrist = jointPlace(hand.frames, 0);
    const at = project(orbit.matrix, add(wrist, add(wrist, jointPlace(hand.frames, 11), -1), 0.6));
    const whose = hand.owner.number === room.own ? "my " : room.senders.size > 1 ? `${hand.owner.number + 1}: ` : "";
    const text = `${whose}${hand.side}${hand.valid ? "" : ": lost"}`;
    if (span.textContent !== text) span.textContent = text;
    span.hidden = !at;
    if (!at) continue;
    const x = Math.min(width - 40, Math.max(40, ((at[0] + 1) / 2) * width));
    const y = Math.min(height - 16, Math.max(16, ((1 - at[1]) / 2) * height));
    span.style.transform = `translate(-50%, -50%) translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
  }
}

const sharpness = new Sharpness();

// Size of the stage, as the page is laid out.
let stage = [0, 0];
let handsSeen = "";
// When the room was asked for; whether a hand has been drawn, and milliseconds until the picture with it was, from there and
// since the page was opened.
let asked = 0;
let begun = false;
let joined = null;
let opened = null;
// What the graphics card passes behind the first skin, and milliseconds until it has.
let behindFirst = null;
let skinned = null;
// Pictures that the graphics card has not passed yet: its sync, and what was drawn in each.
let passing = [];
// The screen shows with its next picture at the earliest what has been passed by then.
function lookAtPassing() {
  const now = room?.now() >>> 0;
  while (passing.length && painter.gl.getSyncParameter(passing[0].sync, painter.gl.SYNC_STATUS) === painter.gl.SIGNALED) {
    const { sync, poses } = passing.shift();
    for (const pose of poses) pose.shown = (now - pose.time) | 0;
    painter.gl.deleteSync(sync);
  }
}

function paint(force) {
  const now = room.now();
  let due = null;
  const poses = [];
  for (const sender of room.senders.values()) {
    const next = sender.advance(now);
    if (!next) continue;
    due = next;
    const took = ((now >>> 0) - next.time) | 0;
    // What has been at rest for long is old, not late.
    if (took < 5000) poses.push({ sender: sender.number, time: next.time, latency: took, shown: null, skinned: skinned !== null, transit: Math.round(next.arrived - now) + took });
  }
  const hands = handsNow();
  const seen = hands.map(hand => `${hand.key} ${hand.valid} ${hand.version} ${hand.tone} ${hand.worn} ${hand.fine}`).join();
  if (!due && !force && seen === handsSeen) return;
  handsSeen = seen;
  const dense = Math.min(2, window.devicePixelRatio || 1) * sharpness.share;
  const [width, height] = stage[0] ? stage : [canvas.clientWidth, canvas.clientHeight];
  if (!width || !height) return;
  for (const pose of poses) latency.add(pose.latency);
  drawn.push(...poses);
  drawn.splice(0, drawn.length - 2000);
  const size = [width, height].map(side => Math.max(1, Math.round(side * dense)));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  frame(hands);
  orbit.update(width, height);
  lookAtSize(size[1]);
  const worn = Boolean(painter) && !painter.gl.isContextLost() && hands.every(hand => hand.worn);
  if (worn) {
    painter.show(hands);
    painter.paint(orbit, hands);
    painted = true;
    const sync = poses.length ? painter.gl.fenceSync(painter.gl.SYNC_GPU_COMMANDS_COMPLETE, 0) : null;
    if (sync) passing.push({ sync, poses });
    if (hands.length && skinned === null) behindFirst ??= painter.gl.fenceSync(painter.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
  }
  if (worn && skinned !== null) sketch.clear(); else sketch.paint(orbit.matrix, hands, width, height, dense);
  label(hands, width, height);
  begun ||= hands.length > 0;
}

// Whether the first hand has been drawn, and the first skin.
function lookAtFirst() {
  if (between) {
    between = false;
  } else if (begun && joined === null) {
    opened = performance.now();
    joined = opened - asked;
    beforeSkins.go();
  }
  if (!behindFirst || painter.gl.getSyncParameter(behindFirst, painter.gl.SYNC_STATUS) !== painter.gl.SIGNALED) return;
  skinned = performance.now() - asked;
  painter.gl.deleteSync(behindFirst);
  behindFirst = null;
  sketch.clear();
}

// Browsers that start give their first picture late: a first hand that is there before it is drawn at once, and shown with it.
const EARLY = 8;
// Whether it was drawn between two of the screen's pictures, of which the next one shows it.
let between = false;
const early = setInterval(() => {
  if (!begun && !ticked && room?.handcast) {
    paint(true);
    between = begun;
  }
  if (begun || ticked) clearInterval(early);
}, EARLY);

let force = true;
// Whether skins were drawn for the last picture of the screen, and when that was.
let painted = false;
let ticked = 0;
function tick(at) {
  if (skinned !== null) sharpness.next(at - ticked, painted);
  [painted, ticked] = [false, at];
  lookAtFirst();
  lookAtPassing();
  if (room) paint(force);
  force = false;
  requestAnimationFrame(tick);
}
const redraw = () => { force = true; };

// Without this the page says that it has not come whole.
document.body.classList.add("whole");

// Once a second: rates, and what there is to say.
let before = null;
const quantile = (list, share) => [...list].sort((a, b) => a - b)[Math.min(list.length - 1, Math.floor(share * list.length))];
function second() {
  if (!room) return;
  const senders = [...room.senders.values()];
  const now = { time: performance.now(), bits: senders.reduce((sum, s) => sum + s.bits, 0), bytes: room.bytes };
  if (before) {
    const seconds = (now.time - before.time) / 1000;
    const payload = Math.max(0, now.bits - before.bits) / seconds / 1000;
    const all = ((now.bytes - before.bytes) * 8) / seconds / 1000;
    rate.add(payload);
    element("rate-now").textContent = `${payload.toFixed(2)} kbit/s of motion, ${all.toFixed(2)} with its headers`;
  }
  before = now;
  const recent = drawn.slice(-90).map(d => d.latency);
  element("latency-now").textContent = recent.length
    ? `median ${quantile(recent, 0.5)} ms, 95 % within ${quantile(recent, 0.95)} ms${room.trip ? `; clocks agree to ${(room.trip / 2).toFixed(1)} ms` : ""}`
    : "";
  const buffer = Math.max(0, ...senders.map(sender => sender.buffer));
  element("buffer-now").textContent = `Poses wait ${Math.round(buffer)} ms, so that late ones are drawn in time.`;
  if (room.buffer === "auto") element("buffer").value = buffer;
  latency.draw();
  rate.draw();
  facts();
}

// Why hands are sketched alone.
let unskinned = "";
// Who has gone last, and until when that is said, unless one of that number is there again.
let leaving = { words: "", sender: null, until: 0 };
function facts() {
  const hands = [...shownHands.values()].length;
  const many = (n, what) => `${n} ${what}${n === 1 ? "" : "s"}`;
  const there = room.open ? `${many(room.senders.size, "sender")}, ${many(hands, "hand")}, by ${room.link.by}` : "not connected";
  const back = room.senders.has(leaving.sender);
  const gone = room.senders.size && !back && performance.now() < leaving.until ? leaving.words : "";
  write("facts", [there, gone, unskinned].filter(Boolean).join(". "));
}

// Milliseconds for which it is said beside those who stay that a sender has gone.
const PARTED = 10_000;
let parted = "";
// Why no hand can be shown here.
let broken = "";
function told(what, more) {
  if (broken) return say(broken);
  if (what === "refused") return refused(more);
  if (what === "end") {
    const how = more.gone ? "is gone: its connection broke" : "has left";
    parted = `The sender ${how}.`;
    leaving = { words: `Sender ${more.sender + 1} ${how}`, sender: more.sender, until: performance.now() + PARTED };
  }
  if (what === "error" || what === "closed") say(more);
  // Until there is a connection again it stays said why there is none.
  else if (room?.open) {
    const none = room.senders.size ? "No hand has been seen yet." : parted || "Nobody sends yet.";
    say(seen && room.senders.size ? "" : none);
  }
  if (room) facts();
  redraw();
  return undefined;
}

element("title").textContent = `Room ${name}`;
document.title = `${name} – handcast live`;
element("reset").addEventListener("click", () => { orbit.reset(); box = null; redraw(); });
const toggleFull = () => (document.fullscreenElement ? document.exitFullscreen() : element("stage").requestFullscreen?.());
element("full").hidden = !document.fullscreenEnabled;
element("full").addEventListener("click", toggleFull);
document.addEventListener("fullscreenchange", () => {
  element("full").setAttribute("aria-pressed", Boolean(document.fullscreenElement));
  redraw();
});
function setBuffer() {
  const auto = element("auto").checked;
  element("buffer").disabled = auto;
  room.buffer = auto ? "auto" : Number(element("buffer").value);
}
element("auto").addEventListener("change", setBuffer);
element("buffer").addEventListener("input", setBuffer);
const KEYS = {
  f: toggleFull, 0: () => element("reset").click(),
  a: () => orbit.turn(-0.12, 0), d: () => orbit.turn(0.12, 0), w: () => orbit.turn(0, -0.12), s: () => orbit.turn(0, 0.12),
  "+": () => orbit.scale(1.15), "=": () => orbit.scale(1.15), "-": () => orbit.scale(1 / 1.15),
};
document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  // Of the stage alone: words that are spoken, or meant for a button, press no keys here.
  if (![document.body, element("stage"), canvas].includes(event.target)) return;
  KEYS[event.key.toLowerCase()]?.();
  redraw();
});
steer(canvas, orbit, redraw);
new ResizeObserver(() => {
  stage = [canvas.clientWidth, canvas.clientHeight];
  redraw();
}).observe(canvas);
canvas.addEventListener("webglcontextlost", event => { event.preventDefault(); redraw(); });
canvas.addEventListener("webglcontextrestored", () => { [passing, behindFirst] = [[], null]; painter?.prepare(); redraw(); });

// A hand that is there is shown as a sketch before the graphics card compiles what skins are drawn with, which lets nothing else
// be done; in a room without one a second is waited at most.
const beforeSkins = {};
beforeSkins.over = new Promise(go => { beforeSkins.go = go; });
asked = performance.now();
room = new Room(link, told);
try {
  room.decodes(await load("./handcast_decoder.wasm"));
} catch (error) {
  room.deaf = true;
  room.early = [];
  broken = `This browser cannot decode hands: ${error.message}`;
  say(broken);
  throw error;
}
if (wish.has("buffer")) {
  element("auto").checked = false;
  element("buffer").value = wish.get("buffer");
  setBuffer();
}
// This browser's camera, once somebody has sent from it.
let own = { on: false };
if (element("send").hidden) {
  // The page of a room whose host alone sends has said so.
} else if (navigator.mediaDevices?.getUserMedia) {
  element("send").disabled = false;
} else {
  write("send-now", isSecureContext ? "This browser gives no camera." : "A camera needs https: the room is to be opened with --tls.");
}
function showSending() {
  element("send").setAttribute("aria-pressed", own.on);
  element("send").textContent = own.on ? "Stop sending" : "Send my hands";
}
element("send").addEventListener("click", async () => {
  element("send").disabled = true;
  try {
    if (own.on) {
      await own.stop();
    } else {
      const { OwnHands } = await import("./send.js");
      own = new OwnHands(room, element("own"), text => write("send-now", text), refused);
      await own.start();
    }
  } catch (error) {
    write("send-now", error.message);
  }
  element("send").disabled = false;
  showSending();
});
async function refused(why) {
  if (own.on) await own.stop();
  showSending();
  write("send-now", why);
}
setInterval(() => {
  second();
  if (own.on) write("send-now", own.trouble ?? "");
  write("send-pace", own.on && !own.trouble ? own.words : "");
}, 1000);
requestAnimationFrame(tick);
async function dress() {
  await Promise.race([beforeSkins.over, new Promise(go => setTimeout(go, LONGEST_SKETCH))]);
  try {
    const skins = loadSurface("./handcast_surface.wasm");
    // Whether it failed is looked at below.
    skins.catch(() => {});
    painter = new Painter(canvas, [], { swift: true, card: wish.has("card") });
    surface = await skins;
  } catch (error) {
    unskinned = error.message;
    facts();
  }
  redraw();
}
dress();

// For tests and for the console.
window.handcast = {
  room,
  sharpness,
  painter: () => painter,
  drawn: () => drawn.slice(),
  state: () => ({
    open: room.open, by: room.link.by, connections: room.connections, own: room.own, senders: [...room.senders.keys()], buffer: Math.max(0, ...[...room.senders.values()].map(s => s.buffer)),
    hands: [...shownHands.values()].map(hand => ({
      sender: hand.owner.number, side: hand.side, valid: hand.valid, wrist: [...jointPlace(hand.frames, 0)], tip: [...jointPlace(hand.frames, 9)],
      sizes: hand.version, tone: hand.tone,
    })),
    planes: [...room.senders.values()].reduce((sum, s) => sum + s.planes, 0), trip: room.trip, offset: room.offset, joined, opened, skinned, sharpness: sharpness.share,
    sending: own.on && own.pace, message: element("message").hidden ? null : element("message").textContent, facts: element("facts").textContent,
  }),
  picture: () => { paint(true); return canvas.toDataURL("image/png"); },
};
