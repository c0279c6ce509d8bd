// Joint frames as rows of 3 x 4 matrices; 4 x 4 matrices column by column, as WebGL takes them.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const unit = a => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };

// out = a b
function joinRows(out, o, a, i, b, j) {
  for (let r = 0; r < 3; r += 1) {
    const [x, y, z, w] = [a[i + 4 * r], a[i + 4 * r + 1], a[i + 4 * r + 2], a[i + 4 * r + 3]];
    for (let c = 0; c < 4; c += 1) {
      out[o + 4 * r + c] = x * b[j + c] + y * b[j + 4 + c] + z * b[j + 8 + c] + (c === 3 ? w : 0);
    }
  }
}

// Frame of every joint of a hand in the world at an instant, 25 x 12 numbers.
function worldFrames(hand, instant, out) {
  if (hand.frames) {
    out.set(hand.frames.subarray(instant * 300, (instant + 1) * 300));
    return out;
  }
  const own = new Float32Array(12);
  for (let j = 0; j < 25; j += 1) {
    const q = (instant * 25 + j) * 4;
    let [x, y, z, w] = hand.rotations.subarray(q, q + 4);
    const n = Math.hypot(x, y, z, w) || 1;
    x /= n; y /= n; z /= n; w /= n;
    const parent = hand.parents[j];
    const place = parent < 0 ? hand.wrist.subarray(instant * 3) : hand.offsets.subarray(j * 3);
    own.set([
      1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), place[0],
      2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), place[1],
      2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), place[2],
    ]);
    if (parent < 0) out.set(own, j * 12); else joinRows(out, j * 12, out, parent * 12, own, 0);
  }
  return out;
}

const jointPlace = (frames, j) => [frames[j * 12 + 3], frames[j * 12 + 7], frames[j * 12 + 11]];

// What moves the surface at rest to the joints' frames.
function skinRows(hand, frames, out) {
  for (let j = 0; j < 25; j += 1) joinRows(out, j * 12, frames, j * 12, hand.inverse_bind, j * 12);
  return out;
}

// From the world to a camera at `eye` with the axes right, up, back.
function viewMatrix(right, up, back, eye) {
  return new Float32Array([
    right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(back, eye), 1,
  ]);
}

// Perspective with half the picture's height at a distance of 1 being `half`.
function perspective(half, aspect, near, far) {
  const f = 1 / half;
  return new Float32Array([
    f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0,
  ]);
}

// Parallel projection of a cube of half side `r` in front of the camera's origin.
const parallel = r => new Float32Array([1 / r, 0, 0, 0, 0, 1 / r, 0, 0, 0, 0, -1 / r, 0, 0, 0, 0, 1]);

function product(a, b) {
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c += 1) {
    for (let r = 0; r < 4; r += 1) {
      for (let k = 0; k < 4; k += 1) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    }
  }
  return out;
}

// Where a point falls, x and y in -1..1, y upwards; null behind the camera.
function project(m, [x, y, z]) {
  const row = r => m[r] * x + m[4 + r] * y + m[8 + r] * z + m[12 + r];
  return row(3) > 0 ? [row(0) / row(3), row(1) / row(3)] : null;
}
