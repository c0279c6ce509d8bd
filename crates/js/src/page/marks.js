// Which triangles of a hand's surface show which of its marks (crates/hand/src/mesh/marks.rs): most show none, and looking for
// marks is what colouring them costs most. Positions at rest are linear over a triangle, so that its corners bound what is linear
// in them.

// Widths from its middle at which a crease darkens by less than half a step of eight bits.
const FAINT = 2.6;
// Numbers of a crease and of a nail, and points of a line of the palm, as u_creases, u_nails and u_lines have them.
const [CREASE, NAIL, LINE] = [12, 12, 8];

// The triangles sorted into groups, each with what it looks for: of creases and nails the rows from one on and up to one, of
// the palm's lines the points.
function byMarks(hand) {
  const count = hand.triangles.length / 3;
  const finders = [creaseFinder(hand), nailFinder(hand), lineFinder(hand)];
  const corners = cornersOf(hand);
  const groups = new Map();
  for (let t = 0; t < count; t += 1) {
    const triangle = corners(t);
    let key = 0;
    for (const find of finders) key = key * 1024 + find(triangle);
    const group = groups.get(key);
    if (group) group.push(t);
    else groups.set(key, [t]);
  }
  const sorted = new hand.triangles.constructor(hand.triangles.length);
  let first = 0;
  const ranges = [...groups].sort(([a], [b]) => a - b).map(([key, own]) => {
    const range = { first, count: own.length * 3, creases: rows(key / 1048576, 3), nails: rows(key / 1024, 3), lines: rows(key, LINE) };
    for (const t of own) {
      for (let k = 0; k < 3; k += 1) sorted[first++] = hand.triangles[3 * t + k];
    }
    return range;
  });
  return { sorted, ranges };
}

// The first of a run of marks and the one behind its last, as a number and back, times what each has.
const run = (first, end) => first * 32 + end;
const rows = (key, each) => [Math.floor(key / 32) % 32, Math.floor(key) % 32].map(at => at * each);

const square = (x, y, z = 0) => x * x + y * y + z * z;

// Gives the corners of a triangle: three places at rest behind one another, their middle, and how far they are from it.
function cornersOf({ vertices, triangles, cube }) {
  const places = new Int16Array(vertices.slice().buffer);
  const triangle = { at: new Float64Array(9), middle: new Float64Array(3), radius: 0 };
  const { at, middle } = triangle;
  return t => {
    middle.fill(0);
    for (let k = 0; k < 3; k += 1) {
      const v = triangles[3 * t + k] * 16;
      for (let i = 0; i < 3; i += 1) {
        at[3 * k + i] = cube[i] + cube[3] * Math.max(-1, places[v + i] / 32767);
        middle[i] += at[3 * k + i] / 3;
      }
    }
    const off = k => square(at[k] - middle[0], at[k + 1] - middle[1], at[k + 2] - middle[2]);
    triangle.radius = Math.sqrt(Math.max(off(0), off(3), off(6)));
    return triangle;
  };
}

// Least and most over the corners of what four numbers of `m` from `o` on are: a x + b y + c z + d.
const value = (at, k, m, o) => m[o] * at[k] + m[o + 1] * at[k + 1] + m[o + 2] * at[k + 2] + m[o + 3];
const least = (at, m, o) => Math.min(value(at, 0, m, o), value(at, 3, m, o), value(at, 6, m, o));
const most = (at, m, o) => Math.max(value(at, 0, m, o), value(at, 3, m, o), value(at, 6, m, o));

// A function of a triangle: the run of those of `many` marks that may show on it.
const finder = (many, shows) => triangle => {
  let [first, end] = [0, 0];
  for (let n = 0; n < many; n += 1) {
    if (!shows(triangle, n)) continue;
    if (!end) first = n;
    end = n + 1;
  }
  return run(first, end);
};

function creaseFinder({ creases, crease_width: width }) {
  // Across each crease, and towards its palmar side, from its middle.
  const planes = new Float64Array(creases.length);
  for (let c = 0; c < creases.length; c += CREASE) {
    for (const o of [c + 4, c + 8]) {
      planes.set(creases.subarray(o, o + 3), o);
      planes[o + 3] = -(creases[o] * creases[c] + creases[o + 1] * creases[c + 1] + creases[o + 2] * creases[c + 2]);
    }
  }
  return finder(creases.length / CREASE, ({ at, middle, radius }, n) => {
    const c = n * CREASE;
    const off = square(middle[0] - creases[c], middle[1] - creases[c + 1], middle[2] - creases[c + 2]);
    if (off > (1.6 * creases[c + 3] + radius) ** 2) return false;
    return least(at, planes, c + 4) < FAINT * width && most(at, planes, c + 4) > -FAINT * width && most(at, planes, c + 8) > 0;
  });
}

const nailFinder = ({ nails }) => finder(nails.length / NAIL, ({ at }, n) => {
  const o = n * NAIL;
  const within = k => least(at, nails, k) < 1.5 && most(at, nails, k) > -1.5;
  return within(o) && within(o + 4) && most(at, nails, o + 8) > 0.25;
});

const lineFinder = ({ lines, crease_width: width }) => finder(lines.length / 2 / LINE, ({ at, middle, radius }, n) => {
  if (Math.max(at[2], at[5], at[8]) <= 0) return false;
  const [[x, y], reach] = [middle, (FAINT * 1.2 * width + radius) ** 2];
  for (let i = 2 * n * LINE; i < 2 * (n + 1) * LINE - 2; i += 2) {
    const [dx, dy, ox, oy] = [lines[i + 2] - lines[i], lines[i + 3] - lines[i + 1], x - lines[i], y - lines[i + 1]];
    const t = Math.min(1, Math.max(0, (ox * dx + oy * dy) / Math.max(square(dx, dy), 1e-12)));
    if (square(ox - t * dx, oy - t * dy) < reach) return true;
  }
  return false;
});
