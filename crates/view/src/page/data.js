// What the library put into the page. T instants, 25 joints, 29 joint angles; see src/view/hand.rs.

const element = id => document.getElementById(id);

function bytes(text) {
  const characters = atob(text);
  const out = new Uint8Array(characters.length);
  for (let i = 0; i < out.length; i += 1) out[i] = characters.charCodeAt(i);
  return out;
}

const numbers = (Type, text) => new Type(bytes(text).buffer);

const page = JSON.parse(element("data").textContent);
const times = numbers(Float64Array, page.times);
const count = times.length;
// How long the last instant lasts: as long as most.
const steps = Array.from(times.subarray(1), (t, i) => t - times[i]).sort((a, b) => a - b);
const step = steps.length ? steps[steps.length >> 1] : 0.04;
const start = count ? times[0] : 0;
const end = count ? times[count - 1] + step : 0;

const hands = page.hands.map(hand => ({
  ...hand,
  vertices: bytes(hand.vertices),
  triangles: numbers(hand.wide ? Uint32Array : Uint16Array, hand.triangles),
  offsets: numbers(Float32Array, hand.offsets),
  inverse_bind: numbers(Float32Array, hand.inverse_bind),
  rotations: numbers(Int16Array, hand.rotations),
  wrist: numbers(Float32Array, hand.wrist),
  valid: bytes(hand.valid),
  angles: numbers(Int16Array, hand.angles),
}));

const stream = page.stream && {
  bytes: page.stream.bytes,
  bits: numbers(Uint32Array, page.stream.bits),
  kinds: bytes(page.stream.kinds),
};
if (stream) stream.mean = stream.bits.reduce((a, b) => a + b, 0) / Math.max(1, count);

// Number of the instant that is shown at a time: the last that has begun.
function instantAt(time) {
  let [low, high] = [0, count];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time + 1e-6) low = middle; else high = middle;
  }
  return low;
}
