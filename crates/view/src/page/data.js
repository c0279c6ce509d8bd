// What the library put into the page, and what is shown now. T instants, 25 joints, 29 joint angles; see src/hand.rs.

const element = id => document.getElementById(id);

// What the page shows, its bytes by their places, and those of the clip as a blob (unpack.js).
const { page, part, clip: clipBytes } = window.handcastPage;

// A part as numbers.
const numbers = (Type, place) => new Type(part(place).slice().buffer);

// The modules that make the surface of a hand and decode streams, each once it is asked for.
const once = make => { let made = null; return () => (made ??= make()); };
const surfaces = once(async () => loadSurface(part(page.surface)));
const decoding = once(async () => load(part(page.decoder)));

// What is shown: a motion of one hand or two, on common instants.
let shown = null;
let times = new Float64Array(0);
let count = 0;
// How long the last instant lasts: as long as most.
let step = 0.04;
let start = 0;
let end = 0;
let hands = [];
let stream = null;

function take(motion) {
  shown = motion;
  ({ times, hands, stream } = motion);
  count = times.length;
  const steps = Array.from(times.subarray(1), (t, i) => t - times[i]).sort((a, b) => a - b);
  step = steps.length ? steps[steps.length >> 1] : 0.04;
  start = count ? times[0] : 0;
  end = count ? times[count - 1] + step : 0;
}

// The motion in the page's data.
async function embedded() {
  const found = await Promise.all(page.hands.map(async hand => ({
    ...(await surfaces())(hand.side, numbers(Float64Array, hand.sizes)),
    rotations: numbers(Int16Array, hand.rotations),
    wrist: numbers(Float32Array, hand.wrist),
    valid: part(hand.valid),
    angles: numbers(Int16Array, hand.angles),
  })));
  const cost = page.stream && {
    bytes: page.stream.bytes,
    bits: numbers(Uint32Array, page.stream.bits),
    kinds: part(page.stream.kinds),
  };
  const { title, rate, skin } = page;
  let { video, notes } = page;
  try {
    if (video) video = { ...video, bytes: await clipBytes() };
  } catch {
    video = null;
    notes = [...notes, "the clip in this page is damaged"];
  }
  return { title, rate, skin, video, notes, times: numbers(Float64Array, page.times), hands: found, stream: cost };
}

// Number of the instant that is shown at a time: the last that has begun.
function instantAt(time) {
  let [low, high] = [0, count];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time + 1e-6) low = middle; else high = middle;
  }
  return low;
}
