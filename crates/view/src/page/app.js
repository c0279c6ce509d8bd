// The page: what is shown, when, and what the keys do.

const FINGERS = [
  ["thumb", "Thumb"], ["index", "Index"], ["middle", "Middle"], ["ring", "Ring"], ["pinky", "Little"], ["all", "All"],
];
const COLOURS = ["--c1", "--c2", "--c3", "--c4", "--c5", "--c6"];

const state = { instant: 0, time: start, playing: false, speed: 1, loop: true, finger: "all" };
const named = side => `${side} hand`;
const posed = hands.map(() => ({ frames: new Float32Array(300), rows: new Float32Array(300), valid: true }));

function pose(instant) {
  hands.forEach((hand, i) => {
    worldFrames(hand, instant, posed[i].frames);
    skinRows(hand, posed[i].frames, posed[i].rows);
    posed[i].valid = hand.valid[instant] === 1;
  });
}

// Middle of the hands: between the wrists and the roots of the middle fingers.
function middle() {
  const sum = posed.reduce((s, p) => add(add(s, jointPlace(p.frames, 0), 0.5), jointPlace(p.frames, 11), 0.5), [0, 0, 0]);
  return sum.map(v => v / Math.max(1, posed.length));
}

// Where the forearm ends, against the direction of the middle metacarpal, and its label a little further.
function below(frames, share) {
  const wrist = jointPlace(frames, 0);
  return add(wrist, add(wrist, jointPlace(frames, 11), -1), share);
}

// What the hands reach at some of the instants: in all, and around their middle at any one time.
function reach() {
  const found = [];
  for (let i = 0; i < count && hands.length; i += Math.max(1, Math.floor(count / 100))) {
    pose(i);
    const here = middle();
    for (const p of posed) {
      if (!p.valid) continue;
      for (let j = 0; j < 25; j += 1) found.push([jointPlace(p.frames, j), here]);
      found.push([below(p.frames, 0.35), here]);
    }
  }
  const edge = pick => [0, 1, 2].map(k => found.reduce((v, [p]) => pick(v, p[k]), found.length ? found[0][0][k] : 0));
  const [low, high] = [edge(Math.min), edge(Math.max)];
  const centre = low.map((v, k) => (v + high[k]) / 2);
  const set = points => ({ points, radius: points.reduce((r, p) => Math.max(r, Math.hypot(...p) + 0.05), 0.1) });
  return {
    all: { centre, ...set(found.map(([p]) => add(p, centre, -1))) },
    one: set(found.map(([p, here]) => add(p, here, -1))),
  };
}

const orbit = new Orbit(reach());
// A hand that roams would be small in a picture of all its places.
orbit.follow = orbit.fit(orbit.reach.all.points, 1) > 1.4 * orbit.fit(orbit.reach.one.points, 1);

let painter = null;
const canvas = element("hand");
function say(text) {
  element("message").textContent = text;
  element("message").hidden = false;
}
if (!hands.length) {
  say("There is no pose in this file.");
} else {
  try {
    painter = new Painter(canvas, hands);
  } catch (error) {
    say(error.message);
  }
}
const labels = hands.map(hand => {
  const label = document.createElement("span");
  label.textContent = hand.side;
  element("labels").append(label);
  return label;
});

const clip = page.video && new Clip(element("clip"), page.video);
const curves = new Curves(element("curves"), seek);
const bars = stream && new Bars(element("bits"), seek, stream);

let dirty = true;
let scheduled = false;
let before = null;
function redraw() {
  dirty = true;
  schedule();
}
function schedule() {
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame(tick);
}

function tick(now) {
  scheduled = false;
  if (state.playing) {
    const passed = before === null ? 0 : Math.min(0.25, (now - before) / 1000) * state.speed;
    before = now;
    advance(passed);
    schedule();
  } else {
    before = null;
  }
  if (dirty) paint();
}

function advance(seconds) {
  let time = state.time + seconds;
  if (time >= end) {
    if (state.loop) {
      time = start + ((time - start) % Math.max(1e-6, end - start));
    } else {
      play(false);
      time = times[count - 1];
    }
  }
  state.time = time;
  const instant = instantAt(time);
  if (instant !== state.instant) show(instant);
}

// Shows an instant; the pieces that cost little are done at once, the hand with the next frame.
function show(instant) {
  state.instant = instant;
  const time = times[instant];
  element("scrub").value = instant;
  element("scrub").setAttribute("aria-valuetext", `frame ${instant + 1} of ${count}, ${time.toFixed(2)} seconds`);
  element("clock").textContent = `${time.toFixed(2)} s · ${instant + 1}/${count}`;
  curves.show(time);
  bars?.show(time);
  clip?.show(time);
  tell();
  redraw();
}

function goTo(instant) {
  const i = Math.min(count - 1, Math.max(0, Math.round(instant)));
  state.time = times[i];
  show(i);
}
function seek(time) {
  if (count) goTo(instantAt(Math.min(end, Math.max(start, time)) + step / 2));
}

function play(on) {
  state.playing = on && count > 1;
  if (state.playing && state.instant === count - 1) goTo(0);
  document.body.classList.toggle("playing", state.playing);
  element("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  schedule();
}

function paint() {
  dirty = false;
  if (!painter) return;
  const dense = Math.min(2, window.devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width || !height) return;
  const size = [Math.round(width * dense), Math.round(height * dense)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  pose(state.instant);
  orbit.centre = middle();
  orbit.update(width, height);
  painter.paint(orbit, posed);
  labels.forEach((label, i) => {
    const at = project(orbit.matrix, below(posed[i].frames, 0.6));
    label.hidden = !at;
    label.textContent = posed[i].valid ? hands[i].side : `${hands[i].side}: lost`;
    if (!at) return;
    const x = Math.min(width - 40, Math.max(40, ((at[0] + 1) / 2) * width));
    const y = Math.min(height - 16, Math.max(16, ((1 - at[1]) / 2) * height));
    label.style.transform = `translate(-50%, -50%) translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
  });
}

// Curves of the chosen finger, of every hand.
const angle = (hand, k) => i => hand.angles[i * 29 + k] / 100;
function moves(hand, k) {
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < count; i += 1) {
    low = Math.min(low, hand.angles[i * 29 + k]);
    high = Math.max(high, hand.angles[i * 29 + k]);
  }
  return high - low >= 50 || Math.max(Math.abs(low), Math.abs(high)) >= 100;
}
function choose(finger) {
  state.finger = finger;
  for (const button of element("fingers").children) {
    const on = button.dataset.finger === finger;
    button.setAttribute("aria-checked", on);
    button.tabIndex = on ? 0 : -1;
  }
  const lines = [];
  hands.forEach((hand, h) => {
    const numbered = page.angles.map((a, k) => ({ ...a, k }));
    const line = { hand, dashed: h > 0, valid: i => hand.valid[i] === 1 };
    if (finger === "all") {
      FINGERS.slice(0, 5).forEach(([name, label], c) => {
        const bends = numbered.filter(a => a.finger === name && a.name.endsWith("flexion")).map(a => angle(hand, a.k));
        lines.push({ ...line, label, colour: COLOURS[c], value: i => bends.reduce((sum, bend) => sum + bend(i), 0) });
      });
    } else {
      const own = numbered.filter(a => a.finger === finger && hands.some(other => moves(other, a.k)));
      own.forEach((a, c) => lines.push({ ...line, label: a.label, colour: COLOURS[c % 6], value: angle(hand, a.k) }));
    }
  });
  const what = finger === "all" ? "bend of each finger, all its joints together" : `angles of the ${finger} finger`;
  element("curves-title").textContent = finger === "all" ? "Bend of each finger, all joints together" : "Joint angles";
  element("curves").setAttribute("aria-label", `${what}, degrees over time; the values at the cursor follow`);
  // One entry a name; with two hands a value each.
  const names = [...new Set(lines.map(l => l.label))];
  element("legend").replaceChildren(...names.map(label => {
    const own = lines.filter(l => l.label === label);
    const item = document.createElement("li");
    const swatch = document.createElement("i");
    swatch.style.background = `var(${own[0].colour})`;
    const value = document.createElement("b");
    item.append(swatch, label, value);
    for (const [n, line] of own.entries()) line.tell = v => { own[n].text = v; value.textContent = own.map(l => l.text ?? "").join(" / "); };
    return item;
  }));
  curves.set(lines);
  tell();
}

// Numbers at the cursor.
function tell() {
  const i = state.instant;
  for (const line of curves.lines) line.tell(line.valid(i) ? `${line.value(i).toFixed(1)}°` : "–");
  if (stream) {
    const kind = ["no plane", "P plane", "I plane"][stream.kinds[i]];
    element("bits-now").textContent = `frame ${i + 1}: ${kind}, ${stream.bits[i]} bits; ${stream.mean.toFixed(0)} on average`;
  }
}

function speedUp(by) {
  const select = element("speed");
  select.selectedIndex = Math.min(select.options.length - 1, Math.max(0, select.selectedIndex + by));
  state.speed = Number(select.value);
}
function setLoop(on) {
  state.loop = on;
  element("loop").setAttribute("aria-pressed", on);
}
function setFollow(on) {
  orbit.follow = on;
  orbit.shift = [0, 0, 0];
  element("follow").setAttribute("aria-pressed", on);
  redraw();
}
function resetView() {
  orbit.reset();
  redraw();
}

const perSecond = Math.max(1, Math.round(1 / Math.max(1e-3, step)));
const KEYS = {
  " ": () => play(!state.playing),
  ArrowLeft: event => { play(false); goTo(state.instant - (event.shiftKey ? perSecond : 1)); },
  ArrowRight: event => { play(false); goTo(state.instant + (event.shiftKey ? perSecond : 1)); },
  Home: () => { play(false); goTo(0); },
  End: () => { play(false); goTo(count - 1); },
  "[": () => speedUp(-1),
  "]": () => speedUp(1),
  l: () => setLoop(!state.loop),
  f: () => setFollow(!orbit.follow),
  0: resetView,
  "+": () => { orbit.scale(1.15); redraw(); },
  "=": () => { orbit.scale(1.15); redraw(); },
  "-": () => { orbit.scale(1 / 1.15); redraw(); },
  "?": () => element("help").showModal(),
};
for (const [key, dx, dy] of [["a", -1, 0], ["d", 1, 0], ["w", 0, -1], ["s", 0, 1]]) {
  KEYS[key] = event => {
    if (event.shiftKey) orbit.move(30 * dx, 30 * dy); else orbit.turn(0.12 * dx, 0.12 * dy);
    redraw();
  };
}
FINGERS.forEach(([finger], i) => { KEYS[i + 1] = () => choose(finger); });

document.addEventListener("keydown", event => {
  if (event.ctrlKey || event.altKey || event.metaKey || element("help").open || !count) return;
  // Lists, and buttons under the space bar, have keys of their own.
  const at = event.target.closest?.("button, select, [role=radio]");
  if (at && (at.tagName === "SELECT" || [" ", "Enter"].includes(event.key))) return;
  if (at?.getAttribute("role") === "radio" && event.key.startsWith("Arrow")) return;
  const act = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!act) return;
  event.preventDefault();
  act(event);
});

element("play").addEventListener("click", () => play(!state.playing));
element("scrub").addEventListener("input", event => { play(false); goTo(Number(event.target.value)); });
element("speed").addEventListener("change", () => speedUp(0));
element("loop").addEventListener("click", () => setLoop(!state.loop));
element("follow").addEventListener("click", () => setFollow(!orbit.follow));
element("reset").addEventListener("click", resetView);
element("help-button").addEventListener("click", () => element("help").showModal());
steer(canvas, orbit, redraw);
new ResizeObserver(redraw).observe(canvas);
canvas.addEventListener("webglcontextlost", event => event.preventDefault());
canvas.addEventListener("webglcontextrestored", () => { painter?.prepare(); redraw(); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { curves.draw(); bars?.draw(); });

element("fingers").append(...FINGERS.map(([finger, label]) => {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = label;
  button.dataset.finger = finger;
  button.setAttribute("role", "radio");
  button.addEventListener("click", () => choose(finger));
  return button;
}));
element("fingers").addEventListener("keydown", event => {
  const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
  if (!by) return;
  event.preventDefault();
  const at = FINGERS.findIndex(([finger]) => finger === state.finger);
  choose(FINGERS[(at + by + FINGERS.length) % FINGERS.length][0]);
  element("fingers").querySelector("[aria-checked=true]").focus();
});

function facts() {
  const seconds = end - start;
  const out = [];
  if (hands.length) out.push(hands.length > 1 ? "both hands" : named(hands[0].side));
  out.push(`${count} ${count === 1 ? "frame" : "frames"}`);
  if (count > 1) out.push(`${seconds.toFixed(1)} s`, `${(page.rate ?? 1 / step).toFixed(page.rate % 1 ? 2 : 0)} frames/s`);
  if (stream && seconds > 0) out.push(`${stream.bytes} bytes`, `${((stream.bytes * 8) / seconds / 1000).toFixed(2)} kbit/s`);
  return out.join(" · ");
}

document.title = `${page.title} – handcast`;
element("title").textContent = page.title;
element("facts").textContent = facts();
element("follow").setAttribute("aria-pressed", orbit.follow);
canvas.setAttribute("aria-label", `Moving ${hands.map(h => named(h.side)).join(" and ") || "hand"}; drag or W A S D to orbit`);
element("clip-panel").hidden = !clip;
element("bits-panel").hidden = !stream;
element("notes").replaceChildren(...page.notes.map(text => {
  const item = document.createElement("li");
  item.textContent = text;
  return item;
}));
if (hands.length > 1) {
  const key = document.createElement("li");
  key.textContent = "solid line: left; dashed: right";
  key.className = "key";
  element("legend").after(Object.assign(document.createElement("ul"), { className: "legend" }));
  element("legend").nextElementSibling.append(key);
}
element("scrub").max = Math.max(0, count - 1);
document.body.classList.toggle("with-clip", Boolean(clip));
document.body.classList.toggle("empty", !hands.length);

// #frame=12 (from 0), #paused, #finger=index, #yaw= and #pitch= in degrees, #speed=0.5
const wish = new URLSearchParams(location.hash.slice(1));
if (hands.length) {
  choose(FINGERS.some(([f]) => f === wish.get("finger")) ? wish.get("finger") : "all");
  orbit.yaw = (Number(wish.get("yaw")) || 0) * (Math.PI / 180);
  orbit.pitch = (Number(wish.get("pitch")) || 0) * (Math.PI / 180);
  const speed = [...element("speed").options].findIndex(o => o.value === wish.get("speed"));
  if (speed >= 0) { element("speed").selectedIndex = speed; speedUp(0); }
  goTo(Number(wish.get("frame")) || 0);
  const still = wish.has("paused") || wish.has("frame") || matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (!still) play(true);
}
for (const id of ["play", "scrub", "speed", "loop"]) element(id).disabled = count < 2 || !hands.length;

// For tests and for the console: the state, the camera, and the picture as a data URL.
window.handcast = {
  state: () => ({ ...state, count, clip: clip?.shown ?? null }),
  camera: () => ({
    width: canvas.clientWidth, height: canvas.clientHeight, focal: canvas.clientHeight / 2 / HALF,
    eye: orbit.eye, axes: orbit.axes,
  }),
  picture: () => { paint(); return canvas.toDataURL("image/png"); },
};
