// The page: what is shown, when, and what the keys do.

const FINGERS = [
  ["thumb", "Thumb"], ["index", "Index"], ["middle", "Middle"], ["ring", "Ring"], ["pinky", "Little"], ["all", "All"],
];
// Rows of joints across the fingers: number of the joint in names of angles, and words.
const ROWS_OF_JOINTS = [["1", "Knuckles"], ["2", "Middle joints"], ["3", "End joints"]];
const COLOURS = ["--c1", "--c2", "--c3", "--c4", "--c5", "--c6"];

// joint: number of the chosen joint in names of angles (0 palm, 1 to 3 along the finger), or null.
const state = { instant: 0, time: 0, playing: false, speed: 1, loop: true, finger: "all", row: "2", joint: null };
const named = side => `${side} hand`;
let posed = [];

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

const canvas = element("hand");
const orbit = new Orbit(reach());
const bones = new Bones(element("bones"));
const curves = new Curves(element("curves"), seek);
const bars = new Bars(element("bits"), seek);
let painter = null;
let labels = [];
let clip = null;

function say(text) {
  element("message").textContent = text ?? "";
  element("message").hidden = !text;
}

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
  bars.show(time);
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
  clip?.play(state.playing, state.speed);
  schedule();
}

function paint() {
  dirty = false;
  const dense = Math.min(2, window.devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width || !height || !hands.length) return;
  pose(state.instant);
  orbit.centre = middle();
  orbit.update(width, height);
  bones.place(orbit.matrix, posed, width, height);
  bones.paint(width, height, dense);
  if (painter) {
    const size = [Math.round(width * dense), Math.round(height * dense)];
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    painter.paint(orbit, posed);
  }
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

// Curves of the chosen finger, or of one row of joints across the fingers, of every hand.
const angle = (hand, k) => i => hand.angles[i * 29 + k] / 100;
function moves(hand, k) {
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < count; i += 1) {
    low = Math.min(low, hand.angles[i * 29 + k]);
    high = Math.max(high, hand.angles[i * 29 + k]);
  }
  return high - low >= 50 || Math.max(Math.abs(low), Math.abs(high)) >= 100;
}
const numbered = page.angles.map((a, k) => ({ ...a, k, joint: a.name.slice(a.finger.length)[0] }));
function mark(box, key, value) {
  for (const button of box.children) {
    const on = button.dataset[key] === value;
    button.setAttribute("aria-checked", on);
    button.tabIndex = on ? 0 : -1;
  }
}
// The lines of a hand: which angle, its label and colour.
function wanted() {
  if (state.finger === "all") {
    return FINGERS.slice(0, 5).map(([finger, label], c) => {
      const bend = numbered.find(a => a.finger === finger && a.name === `${finger}${state.row}_flexion`);
      return { ...bend, label: `${label} ${bend.label.split(" ")[0]}`, colour: COLOURS[c] };
    });
  }
  const own = numbered.filter(a => a.finger === state.finger);
  const moving = own.filter(a => a.joint === state.joint || hands.some(hand => moves(hand, a.k)));
  return moving.map((a, c) => ({ ...a, colour: COLOURS[c % 6] }));
}
function choose(finger, joint = null) {
  state.finger = finger;
  state.joint = joint;
  if (finger === "all" || joint === null) bones.chosen = null;
  mark(element("fingers"), "finger", finger);
  mark(element("rows"), "row", state.row);
  element("rows").hidden = finger !== "all";
  const lines = hands.flatMap((hand, h) => wanted().map(a => ({
    hand, dashed: h > 0, valid: i => hand.valid[i] === 1, value: angle(hand, a.k), label: a.label, colour: a.colour,
    strong: joint !== null && a.joint === joint, faint: joint !== null && a.joint !== joint,
  })));
  const row = ROWS_OF_JOINTS.find(([number]) => number === state.row)[1].toLowerCase();
  const what = finger === "all" ? `bend at the ${row} of the fingers` : `angles of the ${finger} finger's joints`;
  element("curves-title").textContent = finger === "all" ? `Bend at the ${row}` : "Joint angles";
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
    item.classList.toggle("strong", own[0].strong);
    for (const [n, line] of own.entries()) line.tell = v => { own[n].text = v; value.textContent = own.map(l => l.text ?? "").join(" / "); };
    return item;
  }));
  curves.set(lines);
  tell();
  redraw();
}

// The curve of the joint that was clicked; beside all joints, of all.
function pick(x, y) {
  const found = bones.at(x, y);
  if (!found || found.joint === 0) {
    if (state.joint !== null) choose(state.finger);
    return;
  }
  const thumb = found.joint < 5;
  const finger = thumb ? 0 : Math.floor(found.joint / 5);
  // Tips belong to the joint before them.
  const place = Math.min(3, thumb ? found.joint : found.joint % 5);
  bones.chosen = { hand: found.hand, joint: thumb ? place : 5 * finger + place };
  choose(FINGERS[finger][0], String(place));
}

// Numbers at the cursor.
function tell() {
  const i = state.instant;
  for (const line of curves.lines) line.tell(line.valid(i) ? `${line.value(i).toFixed(1)}°` : "–");
  if (stream?.bits) {
    const kind = ["no plane", "P plane", "I plane"][stream.kinds[i]];
    element("bits-now").textContent = `frame ${i + 1}: ${kind}, ${stream.bits[i]} bits; ${stream.mean.toFixed(0)} on average`;
  }
}

function speedUp(by) {
  const select = element("speed");
  select.selectedIndex = Math.min(select.options.length - 1, Math.max(0, select.selectedIndex + by));
  state.speed = Number(select.value);
  if (state.playing) clip?.play(true, state.speed);
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
function setSkeleton(on) {
  bones.on = on;
  element("skeleton").setAttribute("aria-pressed", on);
  document.body.classList.toggle("skeleton", on);
  redraw();
}
function resetView() {
  orbit.reset();
  redraw();
}

const perSecond = () => Math.max(1, Math.round(1 / Math.max(1e-3, step)));
const KEYS = {
  " ": () => play(!state.playing),
  ArrowLeft: event => { play(false); goTo(state.instant - (event.shiftKey ? perSecond() : 1)); },
  ArrowRight: event => { play(false); goTo(state.instant + (event.shiftKey ? perSecond() : 1)); },
  Home: () => { play(false); goTo(0); },
  End: () => { play(false); goTo(count - 1); },
  "[": () => speedUp(-1),
  "]": () => speedUp(1),
  l: () => setLoop(!state.loop),
  f: () => setFollow(!orbit.follow),
  k: () => setSkeleton(!bones.on),
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
// Without a motion there is nothing to steer.
const ALWAYS = ["?"];

document.addEventListener("keydown", event => {
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (event.ctrlKey || event.altKey || event.metaKey || element("help").open || !(count || ALWAYS.includes(key))) return;
  // Lists, and buttons under the space bar, have keys of their own.
  const at = event.target.closest?.("button, select, [role=radio]");
  if (at && (at.tagName === "SELECT" || [" ", "Enter"].includes(event.key))) return;
  if (at?.getAttribute("role") === "radio" && event.key.startsWith("Arrow")) return;
  const act = KEYS[key];
  if (!act) return;
  event.preventDefault();
  act(event);
});

element("play").addEventListener("click", () => play(!state.playing));
element("scrub").addEventListener("input", event => { play(false); goTo(Number(event.target.value)); });
element("speed").addEventListener("change", () => speedUp(0));
element("loop").addEventListener("click", () => setLoop(!state.loop));
element("follow").addEventListener("click", () => setFollow(!orbit.follow));
element("skeleton").addEventListener("click", () => setSkeleton(!bones.on));
element("reset").addEventListener("click", resetView);
element("help-button").addEventListener("click", () => element("help").showModal());
steer(canvas, orbit, redraw, pick);
new ResizeObserver(redraw).observe(canvas);
canvas.addEventListener("webglcontextlost", event => event.preventDefault());
canvas.addEventListener("webglcontextrestored", () => { painter?.prepare(); redraw(); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { curves.draw(); bars.draw(); redraw(); });

// A row of buttons of which one is chosen, by click and by arrow keys.
function radios(box, key, entries, choice, choose) {
  box.append(...entries.map(([value, label]) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = label;
    button.dataset[key] = value;
    button.setAttribute("role", "radio");
    button.addEventListener("click", () => choose(value));
    return button;
  }));
  box.addEventListener("keydown", event => {
    const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!by) return;
    event.preventDefault();
    const at = entries.findIndex(([value]) => value === choice());
    choose(entries[(at + by + entries.length) % entries.length][0]);
    box.querySelector("[aria-checked=true]").focus();
  });
}
radios(element("fingers"), "finger", FINGERS, () => state.finger, finger => choose(finger));
radios(element("rows"), "row", ROWS_OF_JOINTS, () => state.row, row => { state.row = row; choose("all"); });

function facts() {
  const seconds = end - start;
  const out = [];
  if (hands.length) out.push(hands.length > 1 ? "both hands" : named(hands[0].side));
  out.push(`${count} ${count === 1 ? "frame" : "frames"}`);
  const rate = shown.rate ?? 1 / step;
  if (count > 1) out.push(`${seconds.toFixed(1)} s`, `${rate.toFixed(rate % 1 ? 2 : 0)} frames/s`);
  if (stream && seconds > 0) out.push(`${stream.bytes} bytes`, `${((stream.bytes * 8) / seconds / 1000).toFixed(2)} kbit/s`);
  return out.join(" · ");
}

function clipOf(video) {
  element("clip").hidden = Boolean(video?.film);
  element("film").hidden = !video?.film;
  element("clip-lost").hidden = true;
  if (!video) return null;
  if (!video.film) return new Clip(element("clip"), video);
  return new Film(element("film"), video, () => {
    element("film").hidden = true;
    element("clip-lost").hidden = false;
  });
}

// Shows a motion from its first instant on.
function open(motion) {
  play(false);
  clip?.end();
  clip = null;
  take(motion);
  posed = hands.map(() => ({ frames: new Float32Array(300), rows: new Float32Array(300), valid: true }));
  bones.chosen = null;
  orbit.reach = reach();
  orbit.reset();
  // A hand that roams would be small in a picture of all its places.
  setFollow(orbit.fit(orbit.reach.all.points, 1) > 1.4 * orbit.fit(orbit.reach.one.points, 1));
  say(hands.length ? null : "There is no pose in this file.");
  if (hands.length) {
    try {
      painter ??= new Painter(canvas, []);
      painter.skin = motion.skin ? inLinearLight(motion.skin) : SKIN;
      painter.show(hands);
    } catch (error) {
      say(error.message);
      setSkeleton(true);
    }
  }
  document.body.classList.toggle("blind", hands.length > 0 && !painter);
  labels = hands.map(hand => Object.assign(document.createElement("span"), { textContent: hand.side }));
  element("labels").replaceChildren(...labels);
  clip = clipOf(motion.video);
  document.title = `${motion.title} – handcast`;
  element("title").textContent = motion.title;
  element("facts").textContent = facts();
  canvas.setAttribute("aria-label", `Moving ${hands.map(h => named(h.side)).join(" and ") || "hand"}; drag or W A S D to orbit`);
  element("clip-panel").hidden = !clip;
  element("bits-panel").hidden = !stream?.bits;
  if (stream?.bits) {
    stream.mean = stream.bits.reduce((a, b) => a + b, 0) / Math.max(1, count);
    bars.set(stream);
  }
  element("sides").hidden = hands.length < 2;
  element("notes").replaceChildren(...motion.notes.map(text => Object.assign(document.createElement("li"), { textContent: text })));
  element("scrub").max = Math.max(0, count - 1);
  document.body.classList.toggle("with-clip", Boolean(clip));
  document.body.classList.toggle("empty", !hands.length);
  for (const id of ["play", "scrub", "speed", "loop"]) element(id).disabled = count < 2 || !hands.length;
  if (hands.length) {
    choose(state.finger);
    goTo(0);
  }
}

// A dropped or chosen file; what is shown stays where it cannot be read.
async function openFile(file) {
  const told = (text, wrong = false) => {
    element("opening").textContent = text;
    element("opening").classList.toggle("wrong", wrong);
  };
  told(`Reading ${file.name} …`);
  try {
    open(await fromFile(file));
    told("");
    return true;
  } catch (error) {
    told(`${file.name}: ${error.message}`, true);
    return false;
  } finally {
    state.opened = (state.opened ?? 0) + 1;
  }
}
element("open").addEventListener("click", () => element("file").click());
element("file").addEventListener("change", event => {
  if (event.target.files[0]) openFile(event.target.files[0]);
  event.target.value = "";
});
document.addEventListener("dragover", event => {
  if (!event.dataTransfer?.types.includes("Files")) return;
  event.preventDefault();
  document.body.classList.add("dropping");
});
document.addEventListener("dragleave", event => { if (!event.relatedTarget) document.body.classList.remove("dropping"); });
document.addEventListener("drop", event => {
  document.body.classList.remove("dropping");
  if (!event.dataTransfer?.files.length) return;
  event.preventDefault();
  openFile(event.dataTransfer.files[0]).then(done => { if (done) play(true); });
});

// #frame=12 (from 0), #paused, #finger=index, #skeleton, #yaw= and #pitch= in degrees, #speed=0.5
async function begin() {
  open(await embedded());
  const wish = new URLSearchParams(location.hash.slice(1));
  if (!hands.length) return;
  if (FINGERS.some(([f]) => f === wish.get("finger"))) choose(wish.get("finger"));
  orbit.yaw = (Number(wish.get("yaw")) || 0) * (Math.PI / 180);
  orbit.pitch = (Number(wish.get("pitch")) || 0) * (Math.PI / 180);
  if (wish.has("skeleton")) setSkeleton(true);
  const speed = [...element("speed").options].findIndex(o => o.value === wish.get("speed"));
  if (speed >= 0) { element("speed").selectedIndex = speed; speedUp(0); }
  goTo(Number(wish.get("frame")) || 0);
  const still = wish.has("paused") || wish.has("frame") || matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (!still) play(true);
}

begin().catch(error => say(`This page cannot be shown: ${error.message}`)).finally(() => {
  // For tests and for the console: the state, the camera, and the picture as a data URL.
  window.handcast = {
    state: () => ({ ...state, count, skin: painter?.skin ?? null, clip: clip?.shown ?? null, lines: curves.lines.map(l => ({ label: l.label, strong: l.strong, most: Math.max(...Array.from({ length: count }, (_, i) => l.value(i))) })) }),
    camera: () => ({
      width: canvas.clientWidth, height: canvas.clientHeight, focal: canvas.clientHeight / 2 / HALF,
      eye: orbit.eye, axes: orbit.axes,
    }),
    joints: () => { paint(); return bones.places; },
    picture: () => { paint(); return canvas.toDataURL("image/png"); },
  };
});
