//! The designed surface: rings of quads along each finger that join a palm of rows and columns.
//!
//! The palm is a flattened tube: rows from the cut end of the forearm to the webs between the fingers, each a ring of
//! a palmar and a dorsal sheet of columns and two rims. Every long finger takes its share of the columns of the last
//! row, and shares the line of a web with its neighbour; the thumb grows out of a window in the rim of its side. All
//! faces are quads, denser at the joints; finger tips and the wrist end in grids. Each vertex looks for the flesh of
//! its own part from inside, so that fingers that touch never grow together.

use std::collections::{HashMap, HashSet};

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use super::field::{Field, Part};
use crate::{Finger, HandFrames, Joint, Morphology};

/// Columns of a long finger on either sheet of the palm.
const COLUMNS: usize = 5;
/// Quads through the thickness of palm and fingers.
const THICK: usize = 5;
/// Columns of a sheet of the palm.
const SHEET: usize = 4 * COLUMNS;
/// Quads around the palm: palmar sheet from the little finger to the thumb, radial rim, dorsal sheet, ulnar rim.
const GIRTH: usize = 2 * (SHEET + THICK);
/// Rows of the palm before the thumb's window, along the window, and from there to the webs.
const BELOW: usize = 6;
const WINDOW: usize = 8;
const ABOVE: usize = EDGES.len();
const ROWS: usize = BELOW + WINDOW + ABOVE;

/// Where each row above the window is, from the wrist (0) by way of the knuckle (1) to the web beside a finger (2), and how far its
/// radial edge has come from the thumb's web to the index finger. Rows stand closer where the knuckles bend.
const EDGES: [(f64, f64); 10] = [
    (0.62, 0.11),
    (0.73, 0.22),
    (0.83, 0.33),
    (0.91, 0.44),
    (0.96, 0.50),
    (1.00, 0.56),
    (1.25, 0.67),
    (1.50, 0.78),
    (1.76, 0.89),
    (2.00, 1.00),
];

/// Rings along the three bones of a long finger, from beyond the web: bone and share of its length; denser at joints.
const FINGER_STATIONS: [(usize, f64); 25] = [
    (0, 0.50),
    (0, 0.60),
    (0, 0.70),
    (0, 0.79),
    (0, 0.87),
    (0, 0.94),
    (1, 0.00),
    (1, 0.09),
    (1, 0.19),
    (1, 0.32),
    (1, 0.46),
    (1, 0.60),
    (1, 0.73),
    (1, 0.84),
    (1, 0.93),
    (2, 0.01),
    (2, 0.10),
    (2, 0.20),
    (2, 0.31),
    (2, 0.42),
    (2, 0.53),
    (2, 0.63),
    (2, 0.73),
    (2, 0.83),
    (2, 0.91),
];

/// Rings along the thumb beyond those that lead out of the palm.
const THUMB_STATIONS: [(usize, f64); 19] = [
    (0, 0.94),
    (1, 0.04),
    (1, 0.11),
    (1, 0.23),
    (1, 0.37),
    (1, 0.51),
    (1, 0.64),
    (1, 0.76),
    (1, 0.86),
    (1, 0.94),
    (2, 0.02),
    (2, 0.12),
    (2, 0.23),
    (2, 0.35),
    (2, 0.47),
    (2, 0.59),
    (2, 0.70),
    (2, 0.81),
    (2, 0.91),
];
/// Rings between the window in the palm's rim and the thumb's first station.
const THUMB_LEAD: usize = 5;

/// What the breadth, the palmar and the dorsal depth of a long finger are, as shares of its round flesh, by how many
/// bones lie behind: broad joints, full pads, a flat back under the nail.
const PROFILE: [(f64, [f64; 3]); 11] = [
    (0.40, [1.00, 1.06, 0.98]),
    (0.62, [1.02, 1.07, 0.95]),
    (0.80, [1.04, 1.05, 0.95]),
    (1.00, [1.08, 0.98, 1.00]),
    (1.30, [1.05, 1.04, 0.95]),
    (1.60, [1.05, 1.04, 0.94]),
    (2.00, [1.07, 0.96, 0.96]),
    (2.25, [1.06, 1.03, 0.92]),
    (2.60, [1.07, 1.03, 0.91]),
    (2.80, [1.04, 1.01, 0.95]),
    (2.92, [1.00, 1.00, 1.00]),
];
/// How much of the profile's breadth each finger has: the ring and the little finger stand further apart.
const BREADTH: [f64; 5] = [1.0, 0.45, 0.6, 1.2, 1.3];
const THUMB_PROFILE: [(f64, [f64; 3]); 7] = [
    (0.70, [1.00, 1.00, 1.00]),
    (1.00, [1.04, 1.00, 0.98]),
    (1.50, [1.00, 1.02, 0.93]),
    (2.00, [1.08, 0.96, 0.92]),
    (2.55, [1.13, 1.04, 0.86]),
    (2.80, [1.06, 1.01, 0.93]),
    (2.92, [1.00, 1.00, 1.00]),
];

/// A closed surface of quads around the bind pose of a right hand.
pub(super) struct Template {
    pub(super) points: Vec<Point3<f64>>,
    /// Which flesh each vertex lies on.
    pub(super) parts: Vec<Part>,
    /// Counter-clockwise seen from outside.
    pub(super) quads: Vec<[u32; 4]>,
    /// Texture coordinates of the corners of each quad, v downwards.
    pub(super) uvs: Vec<[[f32; 2]; 4]>,
}

/// A rectangle of the texture, in shares of its side.
#[derive(Clone, Copy)]
struct Chart {
    corner: [f64; 2],
    size: [f64; 2],
}

impl Chart {
    fn at(&self, u: f64, v: f64) -> [f32; 2] {
        [(self.corner[0] + u * self.size[0]) as f32, (self.corner[1] + v * self.size[1]) as f32]
    }
}

/// Passes in which vertices spread over the flesh, and then freely.
const SPREADING: usize = 14;
const UNFOLDING: usize = 4;
/// Rounds in which what is still folded spreads, how far around a fold, and how often in each.
const MENDING: usize = 12;
const MENDING_REACH: usize = 3;
const MENDING_PASSES: usize = 6;

/// Free space around each chart.
const GUTTER: f64 = 0.012;
/// Share of the palm's chart that the flat end of the forearm takes.
const END_SHARE: f64 = 0.10;
/// Share of a finger's chart that the grid of its tip takes.
const TIP_SHARE: f64 = 0.13;

const PALM_CHART: Chart = chart(0.0, 0.5, 0.68, 0.5);

const fn chart(x: f64, y: f64, width: f64, height: f64) -> Chart {
    Chart { corner: [x + GUTTER, y + GUTTER], size: [width - 2.0 * GUTTER, height - 2.0 * GUTTER] }
}

fn finger_chart(finger: Finger) -> Chart {
    match finger {
        Finger::Thumb => chart(0.68, 0.5, 0.32, 0.5),
        other => chart(0.25 * (other as usize as f64 - 1.0), 0.0, 0.25, 0.5),
    }
}

/// Value of a table of (place, values) between its entries, smooth; its ends hold beyond.
fn profile(table: &[(f64, [f64; 3])], at: f64) -> [f64; 3] {
    let next = table.partition_point(|(place, _)| *place <= at);
    match (next.checked_sub(1).and_then(|i| table.get(i)), table.get(next)) {
        (Some((a, low)), Some((b, high))) => {
            let t = (at - a) / (b - a);
            let t = t * t * (3.0 - 2.0 * t);
            std::array::from_fn(|k| low[k] + (high[k] - low[k]) * t)
        }
        (Some((_, values)), None) | (None, Some((_, values))) => *values,
        (None, None) => [1.0; 3],
    }
}

fn mix(a: &Point3<f64>, b: &Point3<f64>, t: f64) -> Point3<f64> {
    a + (b - a) * t
}

/// A place inside the flesh from which vertices look outwards, and the axes there: x to the thumb, y to the tips,
/// z out of the palm.
#[derive(Clone, Copy)]
struct Seat {
    place: Point3<f64>,
    turn: UnitQuaternion<f64>,
}

impl Seat {
    fn towards(&self, other: &Seat, t: f64) -> Seat {
        let turn = self.turn.try_slerp(&other.turn, t, 1e-9).unwrap_or(self.turn);
        Seat { place: mix(&self.place, &other.place, t), turn }
    }

    fn of(frame: &Isometry3<f64>, local: Point3<f64>) -> Seat {
        Seat { place: frame * local, turn: frame.rotation }
    }
}

/// Builds the surface.
struct Builder<'a> {
    m: &'a Morphology,
    frames: &'a HandFrames,
    field: &'a Field,
    template: Template,
    /// Vertices of each row of the palm, by place around it; none inside the thumb's window.
    palm: Vec<[Option<u32>; GIRTH]>,
    /// Vertices of the lines of the three webs between long fingers, from the palmar to the dorsal corner.
    webs: [[u32; THICK + 1]; 3],
    /// Vertices that may slide along the surface to spread evenly.
    loose: Vec<u32>,
}

impl Template {
    /// The surface of a hand of these sizes whose right joints are at `frames`, on the flesh `field`.
    pub(super) fn new(m: &Morphology, frames: &HandFrames, field: &Field) -> Self {
        Builder::new(m, frames, field).template
    }
}

impl<'a> Builder<'a> {
    /// All of the surface.
    fn new(m: &'a Morphology, frames: &'a HandFrames, field: &'a Field) -> Self {
        let template = Template { points: Vec::new(), parts: Vec::new(), quads: Vec::new(), uvs: Vec::new() };
        let mut builder = Builder {
            m,
            frames,
            field,
            template,
            palm: Vec::new(),
            webs: [[0; THICK + 1]; 3],
            loose: Vec::new(),
        };
        builder.add_palm();
        let rings = Finger::ALL.map(|finger| builder.add_finger(finger));
        builder.spread();
        builder.shape_fingers(&rings);
        builder.soften_fingers(&rings);
        builder.round_wrist();
        builder.close_wrist();
        builder
    }

    fn vertex(&mut self, place: Point3<f64>, part: Part) -> u32 {
        self.template.points.push(place);
        self.template.parts.push(part);
        self.template.points.len() as u32 - 1
    }

    fn quad(&mut self, corners: [u32; 4], uvs: [[f32; 2]; 4]) {
        self.template.quads.push(corners);
        self.template.uvs.push(uvs);
    }

    /// The first place where the flesh of `part` ends on the way from `from`, at most `far` away.
    fn skin(&self, from: Point3<f64>, direction: Vector3<f64>, part: Part, far: f64) -> Point3<f64> {
        let step = 0.006 * self.m.hand_length;
        let value = |t: f64| self.field.value_of(part, &(from + direction * t));
        let mut low = 0.0;
        let mut high = far;
        let mut t = 0.0;
        while t < far {
            let next = (t + step).min(far);
            if value(next) >= 0.0 {
                (low, high) = (t, next);
                break;
            }
            (t, low) = (next, next);
        }
        for _ in 0..12 {
            let middle = (low + high) / 2.0;
            if value(middle) < 0.0 { low = middle } else { high = middle }
        }
        from + direction * ((low + high) / 2.0)
    }

    /// Where the skin of the web between thumb and index finger ends: the middle of its free edge, and outwards.
    fn thumb_web(&self) -> (Point3<f64>, Vector3<f64>) {
        let m = self.m;
        let thumb = m.finger(Finger::Thumb);
        let reach = m.webs[0].min(1.2);
        let on_thumb =
            self.frames.get(Joint::ThumbMetacarpal) * Point3::new(0.0, 0.9 * reach * thumb.bones[0], 0.0);
        let index = self.frames.position(Joint::IndexProximal);
        let root = (0.90 * (1.0 - m.web_root)).min(0.95);
        let wrist = Point3::new(0.6 * (m.wrist_half_width - m.palm_radius), 0.5 * m.palm_radius, 0.0);
        let on_palm = mix(&wrist, &index, root);
        let edge = mix(&on_thumb, &on_palm, 0.5);
        let inside = mix(&wrist, &index, 0.35);
        let out = (edge - inside).try_normalize(1e-9).unwrap_or_else(Vector3::x);
        (edge, out)
    }

    /// The bottom of the gap between two long fingers, counted from index and middle finger.
    fn crotch(&self, gap: usize) -> Point3<f64> {
        let at = |finger: Finger| {
            let reach = self.m.webs[gap + 1].clamp(0.1, 0.7) * self.m.finger(finger).bones[0];
            self.frames.get(Joint::base(finger)) * Point3::new(0.0, reach, 0.0)
        };
        nalgebra::center(&at(Finger::LONG[gap]), &at(Finger::LONG[gap + 1]))
    }

    /// How far a long finger is in the palm, a share of its first bone: up to the higher of the gaps beside it.
    fn web_beside(&self, finger: Finger) -> f64 {
        let place = finger as usize - 1;
        let frame = self.frames.get(Joint::base(finger));
        let gaps = [place.checked_sub(1), (place < 3).then_some(place)].into_iter().flatten();
        let heights = gaps.map(|gap| (frame.inverse() * self.crotch(gap)).y / self.m.finger(finger).bones[0]);
        heights.fold(0.2, f64::max).min(0.75)
    }

    /// Seats along the middle of the palm for each row: along the ulnar rim, the four fingers from the little one
    /// to the index finger, and the radial rim.
    fn guides(&self) -> [[Seat; 6]; ROWS + 1] {
        let (m, frames) = (self.m, self.frames);
        let r = m.palm_radius;
        let level = UnitQuaternion::identity();
        let half = m.wrist_half_width - r;
        let at = |x: f64, y: f64| Seat { place: Point3::new(x + m.wrist_lateral, y, 0.0), turn: level };
        let (web_edge, web_out) = self.thumb_web();
        let crotch = web_edge - web_out * (0.055 * m.hand_length);
        let bottom = 0.45 * r;
        std::array::from_fn(|row| {
            let along = |finger: Finger, row: usize| -> Seat {
                let share = match finger {
                    Finger::Index => 0.9,
                    Finger::Middle => 0.3,
                    Finger::Ring => -0.3,
                    _ => -0.9,
                };
                let base = frames.get(Joint::base(finger));
                let knuckle = Seat::of(base, Point3::origin());
                let reach = self.web_beside(finger) * m.finger(finger).bones[0];
                let end = Seat::of(base, Point3::new(0.0, reach, 0.0));
                let carpal = at(share * half, bottom);
                if row <= BELOW {
                    let t = row as f64 / BELOW as f64;
                    // The flesh is round at its cut end: its outline is looked for above that.
                    return at(share * half, self.field.cut() + 0.045 * m.hand_length).towards(&carpal, t);
                }
                let bend = |t: f64| ((t - 0.72) / 0.56).clamp(0.0, 1.0);
                let t = match row - BELOW {
                    k if k <= WINDOW => 0.52 * k as f64 / WINDOW as f64,
                    k => EDGES[k - WINDOW - 1].0,
                };
                let place = if t <= 1.0 {
                    mix(&carpal.place, &knuckle.place, t)
                } else {
                    mix(&knuckle.place, &end.place, t - 1.0)
                };
                let turn = level.try_slerp(&knuckle.turn, bend(t), 1e-9).unwrap_or(level);
                Seat { place, turn }
            };
            let index = along(Finger::Index, row);
            let pinky = along(Finger::Pinky, row);
            let beside = |seat: &Seat, by: f64| Seat {
                place: seat.place + seat.turn * Vector3::new(by, 0.0, 0.0),
                ..*seat
            };
            let ulnar = {
                let width = if row <= BELOW { 0.1 * half } else { 0.35 * m.finger(Finger::Pinky).radii[0] };
                let belly = if (BELOW..=BELOW + WINDOW + 2).contains(&row) { m.ulnar_border } else { 0.0 };
                beside(&pinky, -width - 0.5 * belly)
            };
            let radial = match row {
                k if k <= BELOW => beside(&index, 0.1 * half),
                k if k <= BELOW + WINDOW => {
                    let t = (k - BELOW) as f64 / WINDOW as f64;
                    let start = at(half, bottom).place;
                    Seat { place: mix(&start, &crotch, t), turn: level }
                }
                k => {
                    let t = EDGES[k - BELOW - WINDOW - 1].1;
                    let near = beside(&index, 0.35 * m.finger(Finger::Index).radii[0]);
                    let t = 1.0 - (1.0 - t).powi(2);
                    Seat { place: mix(&crotch, &near.place, t), turn: near.turn }
                }
            };
            [ulnar, pinky, along(Finger::Ring, row), along(Finger::Middle, row), index, radial]
        })
    }

    fn add_palm(&mut self) {
        let guides = self.guides();
        let far = 0.16 * self.m.hand_length;
        let (_, web_out) = self.thumb_web();
        for (row, guide) in guides.iter().enumerate() {
            let in_window = row > BELOW && row < BELOW + WINDOW;
            let mut ring = [None; GIRTH];
            for (j, slot) in ring.iter_mut().enumerate() {
                let (seat, angle) = seat_around(guide, j);
                let rim = radial_rim(j).is_some();
                if in_window && rim {
                    continue;
                }
                let mut direction = seat.turn * Vector3::new(angle.cos(), 0.0, angle.sin());
                let corner = j == SHEET || j == SHEET + THICK;
                if row >= BELOW + WINDOW && (rim || corner) {
                    // Out of the web's edge, which turns from the thumb's web to the index finger's side.
                    let t = (row - BELOW - WINDOW).checked_sub(1).map_or(0.0, |k| EDGES[k].1);
                    let side = seat.turn * Vector3::x();
                    let out = (web_out * (1.0 - t) + side * t).try_normalize(1e-9).unwrap_or(side);
                    direction = out * angle.cos() + seat.turn * Vector3::z() * angle.sin();
                }
                let place = self.skin(seat.place, direction.normalize(), Part::Palm, far);
                let v = self.vertex(place, Part::Palm);
                *slot = Some(v);
                if row > 0 {
                    self.loose.push(v);
                }
            }
            self.palm.push(ring);
        }
        self.add_web_lines(&guides[ROWS]);
        self.join_palm();
    }

    /// The lines of the webs between the long fingers, from corner to corner through the thickness of the hand.
    fn add_web_lines(&mut self, guide: &[Seat; 6]) {
        for web in 0..3 {
            // Between the fingers of the columns from the thumb's side: index and middle first.
            let (near, far) = (&guide[4 - web], &guide[3 - web]);
            let seat = Seat { place: self.crotch(web), ..near.towards(far, 0.5) };
            let u = COLUMNS * (web + 1);
            let corners = [palmar(u), dorsal(u)].map(|j| self.palm[ROWS][j]);
            let (Some(first), Some(last)) = (corners[0], corners[1]) else { continue };
            let back = seat.place - seat.turn * Vector3::y() * (0.03 * self.m.hand_length);
            let line: [u32; THICK + 1] = std::array::from_fn(|t| {
                if t == 0 {
                    return first;
                }
                if t == THICK {
                    return last;
                }
                let angle = (70.0 - 140.0 * t as f64 / THICK as f64).to_radians();
                let direction = seat.turn * Vector3::new(0.0, angle.cos(), angle.sin());
                let place = self.skin(back, direction, Part::Palm, 0.07 * self.m.hand_length);
                let v = self.vertex(place, Part::Palm);
                self.loose.push(v);
                v
            });
            self.webs[web] = line;
        }
    }

    fn join_palm(&mut self) {
        let rows = self.palm.clone();
        let lengths = self.row_places();
        for row in 0..ROWS {
            for j in 0..GIRTH {
                let k = (j + 1) % GIRTH;
                let corners = [rows[row][j], rows[row][k], rows[row + 1][k], rows[row + 1][j]];
                let [Some(a), Some(b), Some(c), Some(d)] = corners else { continue };
                // The window is open although all its corners are there.
                if (SHEET..SHEET + THICK).contains(&j) && (BELOW..BELOW + WINDOW).contains(&row) {
                    continue;
                }
                let u = |j: usize| j as f64 / GIRTH as f64;
                let v = |row: usize| 1.0 - END_SHARE - (1.0 - END_SHARE) * lengths[row];
                let uvs = [(j, row), (j + 1, row), (j + 1, row + 1), (j, row + 1)];
                self.quad([a, b, c, d], uvs.map(|(j, row)| PALM_CHART.at(u(j), v(row))));
            }
        }
    }

    /// How far along the palm each row lies, 0 to 1, by its middle.
    fn row_places(&self) -> [f64; ROWS + 1] {
        let middle = |row: usize| -> Point3<f64> {
            let ends = [palmar(SHEET / 2), dorsal(SHEET / 2)].map(|j| self.palm[row][j]);
            let place = |v: Option<u32>| v.map_or_else(Point3::origin, |v| self.template.points[v as usize]);
            nalgebra::center(&place(ends[0]), &place(ends[1]))
        };
        let mut places = [0.0; ROWS + 1];
        for row in 1..=ROWS {
            places[row] = places[row - 1] + (middle(row) - middle(row - 1)).norm();
        }
        let total = places[ROWS].max(1e-9);
        places.map(|v| v / total)
    }

    /// The flat end of the forearm: a grid between the two sheets.
    fn close_wrist(&mut self) {
        let ring = self.palm[0];
        let get = |j: usize| ring[j % GIRTH].unwrap_or(0);
        let grid = self.grid(Part::Palm, SHEET, THICK, &get);
        // The ring is nearly straight at the grid's corners: what lies behind them keeps away.
        let middle = self.centre(&(0..GIRTH).map(&get).collect::<Vec<_>>());
        for &v in grid[1..THICK].iter().flat_map(|row| &row[1..SHEET]) {
            let p = &mut self.template.points[v as usize];
            *p = Point3::new(middle.x + 0.94 * (p.x - middle.x), p.y, middle.z + 0.8 * (p.z - middle.z));
        }
        let u = |x: usize| x as f64 / GIRTH as f64;
        let v = |y: usize| 1.0 - END_SHARE * (1.0 - y as f64 / THICK as f64);
        let uv = |x: usize, y: usize| PALM_CHART.at(u(x), v(y));
        for y in 0..THICK {
            for x in 0..SHEET {
                let corners = [grid[y][x], grid[y + 1][x], grid[y + 1][x + 1], grid[y][x + 1]];
                self.quad(corners, [uv(x, y), uv(x, y + 1), uv(x + 1, y + 1), uv(x + 1, y)]);
            }
        }
    }

    /// A grid of `wide` by `high` quads inside a ring: rows of vertices, those at its border from the ring, whose first
    /// `wide` sides are the first row.
    fn grid(&mut self, part: Part, wide: usize, high: usize, ring: &dyn Fn(usize) -> u32) -> Vec<Vec<u32>> {
        let at = |builder: &Self, v: u32| builder.template.points[v as usize];
        let mut rows = Vec::new();
        for y in 0..=high {
            let (left, right) = (ring(2 * (wide + high) - y), ring(wide + y));
            let mut row = Vec::new();
            for x in 0..=wide {
                row.push(match (x, y) {
                    (_, 0) => ring(x),
                    (_, y) if y == high => ring(2 * wide + high - x),
                    (0, _) => left,
                    (x, _) if x == wide => right,
                    _ => {
                        // A Coons patch of the border.
                        let (s, t) = (x as f64 / wide as f64, y as f64 / high as f64);
                        let (bottom, top) = (at(self, ring(x)), at(self, ring(2 * wide + high - x)));
                        let corners = [ring(0), ring(wide), ring(2 * wide + high), ring(wide + high)]
                            .map(|v| at(self, v));
                        let across = mix(&at(self, left), &at(self, right), s);
                        let through = mix(&bottom, &top, t);
                        let flat =
                            mix(&mix(&corners[0], &corners[1], s), &mix(&corners[2], &corners[3], s), t);
                        self.vertex(Point3::from(across.coords + through.coords - flat.coords), part)
                    }
                });
            }
            rows.push(row);
        }
        rows
    }

    /// The ring of the palm from which a finger grows.
    fn root_ring(&self, finger: Finger) -> Vec<u32> {
        let get = |row: usize, j: usize| self.palm[row][j % GIRTH].unwrap_or(0);
        if finger == Finger::Thumb {
            let (low, high) = (BELOW, BELOW + WINDOW);
            let (front, back) = (SHEET, SHEET + THICK);
            let mut ring: Vec<u32> = (0..WINDOW).map(|k| get(high - k, front)).collect();
            ring.extend((0..THICK).map(|t| get(low, front + t)));
            ring.extend((0..WINDOW).map(|k| get(low + k, back)));
            ring.extend((0..THICK).map(|t| get(high, back - t)));
            return ring;
        }
        let i = finger as usize - 1;
        let (near, far) = (COLUMNS * i, COLUMNS * (i + 1));
        let radial = |t: usize| if i == 0 { get(ROWS, SHEET + t) } else { self.webs[i - 1][t] };
        let ulnar = |t: usize| if i == 3 { get(ROWS, GIRTH - t) } else { self.webs[i][t] };
        let mut ring: Vec<u32> = (0..COLUMNS).map(|k| get(ROWS, palmar(far - k))).collect();
        ring.extend((0..THICK).map(radial));
        ring.extend((0..COLUMNS).map(|k| get(ROWS, dorsal(near + k))));
        ring.extend((0..THICK).map(|t| ulnar(THICK - t)));
        ring
    }

    /// Middle and axes of a finger at a station; near its joints the ring stands between the two bones.
    fn station(&self, finger: Finger, bone: usize, share: f64) -> Seat {
        let f = self.m.finger(finger);
        let joints = Joint::of(finger);
        let joints = &joints[joints.len() - 4..];
        let share = if bone == 0 && finger != Finger::Thumb {
            // Between the web and the first free joint.
            let free = 1.0 - self.web_beside(finger);
            1.0 - free + free * (0.30 + 0.70 * (share - 0.5) / 0.5)
        } else {
            share
        };
        let frame = |k: usize| self.frames.get(joints[k.min(2)]);
        let here = frame(bone);
        let length = f.bones[bone];
        let y = if bone == 2 {
            share * (length - f.radii[3]).max(0.1 * length) / 0.91 * 0.965
        } else {
            share * length
        };
        let mut turn = here.rotation;
        for (other, distance, radius) in [
            (bone.checked_sub(1), y, f.radii[bone]),
            ((bone < 2).then_some(bone + 1), length - y, f.radii[bone + 1]),
        ] {
            let Some(other) = other else { continue };
            let near = 0.5 * (1.0 - distance / (1.5 * radius)).clamp(0.0, 1.0);
            turn = turn.try_slerp(&frame(other).rotation, near, 1e-9).unwrap_or(turn);
        }
        Seat { place: here * Point3::new(0.0, y, 0.0), turn }
    }

    /// Adds a finger to its place at the palm; gives its rings.
    fn add_finger(&mut self, finger: Finger) -> Vec<Vec<u32>> {
        let part = Part::Finger(finger);
        let thumb = finger == Finger::Thumb;
        let stations: &[(usize, f64)] = if thumb { &THUMB_STATIONS } else { &FINGER_STATIONS };
        let root = self.root_ring(finger);
        let around = root.len();
        let far = 2.2 * self.m.finger(finger).radii[0];
        let first_angle = |j: usize, offset: f64| offset - std::f64::consts::TAU * j as f64 / around as f64;
        let offset = if thumb { self.thumb_offset(&root) } else { 135f64.to_radians() };
        let mut rings = vec![root.clone()];
        let mut free: Vec<Vec<u32>> = Vec::new();
        for &(bone, share) in stations {
            let seat = self.station(finger, bone, share);
            // Around its first ring the thumb has the skin to the index finger.
            let part = if thumb && free.is_empty() { Part::Palm } else { part };
            let ring: Vec<u32> = (0..around)
                .map(|j| {
                    let angle = first_angle(j, offset);
                    let direction = seat.turn * Vector3::new(angle.cos(), 0.0, angle.sin());
                    let place = self.skin(seat.place, direction, part, far);
                    self.vertex(place, part)
                })
                .collect();
            free.push(ring);
        }
        if thumb {
            rings.extend(self.thumb_lead(&root, &free[0]));
        }
        self.loose.extend(&free[0]);
        rings.extend(free);
        self.join_finger(finger, &rings);
        rings
    }

    /// The angle of the thumb's first vertex: that which turns its rings least against the window in the palm.
    fn thumb_offset(&self, root: &[u32]) -> f64 {
        let seat = self.station(Finger::Thumb, THUMB_STATIONS[0].0, THUMB_STATIONS[0].1);
        let centre: Vector3<f64> = root.iter().map(|&v| self.template.points[v as usize].coords).sum();
        let centre = centre / root.len() as f64;
        let (mut sine, mut cosine) = (0.0, 0.0);
        for (j, &v) in root.iter().enumerate() {
            let off = seat.turn.inverse() * (self.template.points[v as usize].coords - centre);
            let angle = off.z.atan2(off.x) + std::f64::consts::TAU * j as f64 / root.len() as f64;
            sine += angle.sin();
            cosine += angle.cos();
        }
        sine.atan2(cosine)
    }

    /// Rings between the window in the palm's rim and the thumb's first own ring.
    fn thumb_lead(&mut self, root: &[u32], first: &[u32]) -> Vec<Vec<u32>> {
        (1..=THUMB_LEAD)
            .map(|k| {
                let t = k as f64 / (THUMB_LEAD + 1) as f64;
                let pairs: Vec<_> = root.iter().zip(first).map(|(a, b)| (*a, *b)).collect();
                pairs
                    .into_iter()
                    .map(|(a, b)| {
                        let [a, b] = [a, b].map(|v| self.template.points[v as usize]);
                        let v = self.vertex(mix(&a, &b, t), Part::Palm);
                        self.loose.push(v);
                        v
                    })
                    .collect()
            })
            .collect()
    }

    fn join_finger(&mut self, finger: Finger, rings: &[Vec<u32>]) {
        let chart = finger_chart(finger);
        let around = rings[0].len();
        let (wide, high) = if finger == Finger::Thumb { (WINDOW, THICK) } else { (COLUMNS, THICK) };
        let mut places = vec![0.0];
        for pair in rings.windows(2) {
            places.push(places[places.len() - 1] + (self.centre(&pair[1]) - self.centre(&pair[0])).norm());
        }
        let total = places.last().copied().unwrap_or(1.0).max(1e-9);
        let v = |k: usize| 1.0 - (1.0 - TIP_SHARE) * places[k] / total;
        let u = |j: usize| j as f64 / around as f64;
        for k in 0..rings.len() - 1 {
            for j in 0..around {
                let n = (j + 1) % around;
                let corners = [rings[k][j], rings[k][n], rings[k + 1][n], rings[k + 1][j]];
                let uvs = [(j, k), (j + 1, k), (j + 1, k + 1), (j, k + 1)].map(|(j, k)| chart.at(u(j), v(k)));
                self.quad(corners, uvs);
            }
        }
        let last = rings[rings.len() - 1].clone();
        let get = |j: usize| last[j % around];
        let grid = self.grid(Part::Finger(finger), wide, high, &get);
        let (middle, axis) = (self.centre(&last), self.tip_axis(finger));
        let reach =
            last.iter().map(|&v| (self.template.points[v as usize] - middle).norm()).fold(0.0, f64::max);
        for row in &grid[1..high] {
            for &vertex in &row[1..wide] {
                // Rays fan out over a dome, so that the tip is covered evenly.
                let off = self.template.points[vertex as usize] - middle;
                let rise = (1.0 - (off.norm() / reach.max(1e-9)).powi(2)).max(0.0).sqrt();
                let direction = (off + axis * (rise * reach)).try_normalize(1e-9).unwrap_or(axis);
                let far = 3.0 * self.m.finger(finger).radii[3];
                self.template.points[vertex as usize] =
                    self.skin(middle, direction, Part::Finger(finger), far);
            }
        }
        self.loose.extend(&last);
        self.loose.extend(grid[1..high].iter().flat_map(|row| &row[1..wide]));
        let uv = |x: usize, y: usize| {
            let share = TIP_SHARE * y as f64 / high as f64;
            chart.at(u(x), TIP_SHARE - share)
        };
        for y in 0..high {
            for x in 0..wide {
                let corners = [grid[y][x], grid[y][x + 1], grid[y + 1][x + 1], grid[y + 1][x]];
                self.quad(corners, [uv(x, y), uv(x + 1, y), uv(x + 1, y + 1), uv(x, y + 1)]);
            }
        }
    }

    /// The middle of some vertices.
    fn centre(&self, ring: &[u32]) -> Point3<f64> {
        let sum: Vector3<f64> = ring.iter().map(|&v| self.template.points[v as usize].coords).sum();
        Point3::from(sum / ring.len().max(1) as f64)
    }

    /// Along the end bone of a finger.
    fn tip_axis(&self, finger: Finger) -> Vector3<f64> {
        let joints = Joint::of(finger);
        self.frames.get(joints[joints.len() - 2]) * Vector3::y()
    }

    /// Spreads the loose vertices over the flesh, along it, and at last freely, which takes folds out of the webs.
    fn spread(&mut self) {
        let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); self.template.points.len()];
        for q in &self.template.quads {
            for k in 0..4 {
                let (a, b) = (q[k], q[(k + 1) % 4]);
                if !neighbours[a as usize].contains(&b) {
                    neighbours[a as usize].push(b);
                    neighbours[b as usize].push(a);
                }
            }
        }
        let loose = std::mem::take(&mut self.loose);
        self.relax(&loose, &neighbours, SPREADING, true);
        self.relax(&loose, &neighbours, UNFOLDING, false);
        // A wide web of the thumb is held in folds by the flesh.
        for _ in 0..MENDING {
            let mut near = self.folded();
            if near.is_empty() {
                break;
            }
            for _ in 0..MENDING_REACH {
                let wider: Vec<u32> = near.iter().flat_map(|&v| &neighbours[v as usize]).copied().collect();
                near.extend(wider);
            }
            let some: Vec<u32> = loose.iter().filter(|v| near.contains(v)).copied().collect();
            self.relax(&some, &neighbours, MENDING_PASSES, false);
        }
    }

    /// Moves vertices towards the middles of their neighbours; `held` on the flesh of their parts.
    fn relax(&mut self, which: &[u32], neighbours: &[Vec<u32>], passes: usize, held: bool) {
        for _ in 0..passes {
            let moved: Vec<Point3<f64>> = which
                .iter()
                .map(|&v| {
                    let here = self.template.points[v as usize];
                    let mut p = mix(&here, &self.centre(&neighbours[v as usize]), 0.5);
                    if held {
                        let (value, gradient) = self.field.slope_of(self.template.parts[v as usize], &p);
                        let step = gradient * (value / gradient.norm_squared().max(0.05));
                        let most = 0.02 * self.m.hand_length;
                        p -= step * (most / step.norm().max(most));
                    }
                    p
                })
                .collect();
            for (&v, p) in which.iter().zip(moved) {
                self.template.points[v as usize] = p;
            }
        }
    }

    /// Vertices at edges over which the surface turns back by more than a right angle.
    fn folded(&self) -> HashSet<u32> {
        let mut sides: HashMap<[u32; 2], Vector3<f64>> = HashMap::new();
        let mut found = HashSet::new();
        for t in super::triangles_of(&self.template.points, &self.template.quads) {
            let [a, b, c] = t.map(|v| self.template.points[v as usize]);
            let normal = (b - a).cross(&(c - a));
            for k in 0..3 {
                let (from, to) = (t[k], t[(k + 1) % 3]);
                match sides.remove(&[to, from]) {
                    Some(other) if normal.dot(&other) < 0.0 => found.extend([from, to]),
                    Some(_) => {}
                    None => drop(sides.insert([from, to], normal)),
                }
            }
        }
        found
    }

    /// Gives the fingers their breadth and depth.
    fn shape_fingers(&mut self, rings: &[Vec<Vec<u32>>; 5]) {
        for (finger, rings) in Finger::ALL.into_iter().zip(rings) {
            let thumb = finger == Finger::Thumb;
            let stations: &[(usize, f64)] = if thumb { &THUMB_STATIONS } else { &FINGER_STATIONS };
            let table: &[_] = if thumb { &THUMB_PROFILE } else { &PROFILE };
            let own = rings.len() - stations.len();
            for (ring, &(bone, share)) in rings[own..].iter().zip(stations) {
                let seat = self.station(finger, bone, share);
                let mut shape = profile(table, bone as f64 + share);
                shape[0] = 1.0 + (shape[0] - 1.0) * BREADTH[finger as usize];
                for &v in ring {
                    self.scale_at(v, &seat, shape);
                }
            }
        }
    }

    /// Scales a vertex about the axis of a finger: across it, and to the palm and to the back.
    fn scale_at(&mut self, vertex: u32, seat: &Seat, [across, palmar, dorsal]: [f64; 3]) {
        let point = &mut self.template.points[vertex as usize];
        let mut off = seat.turn.inverse() * (*point - seat.place);
        off.x *= across;
        off.z *= if off.z > 0.0 { palmar } else { dorsal };
        *point = seat.place + seat.turn * off;
    }

    /// The forearm becomes a plain oval towards its cut end, whose edge is a little round.
    fn round_wrist(&mut self) {
        let m = self.m;
        let cut = self.field.cut();
        for row in 0..BELOW {
            let ring = self.palm[row];
            let places = || ring.iter().flatten().map(|&v| self.template.points[v as usize].coords);
            let low = places().fold(Vector3::repeat(f64::MAX), |a, p| a.inf(&p));
            let high = places().fold(Vector3::repeat(f64::MIN), |a, p| a.sup(&p));
            let (centre, half) = ((low + high) / 2.0, (high - low) / 2.0);
            // The last two rows make the edge.
            let (level, narrower) = match row {
                0 => (Some(cut), 0.955),
                1 => (Some(cut + 0.010 * m.hand_length), 1.0),
                2 => (Some(cut + 0.045 * m.hand_length), 1.0),
                _ => (None, 1.0),
            };
            for v in ring.iter().flatten() {
                let p = &mut self.template.points[*v as usize];
                let off = p.coords - centre;
                let angle = (off.z / half.z.max(1e-9)).atan2(off.x / half.x.max(1e-9));
                // A superellipse: flatter than an oval on palm and back.
                let bow = |v: f64| v.signum() * v.abs().powf(0.86);
                let oval = Vector3::new(half.x * bow(angle.cos()), off.y, half.z * bow(angle.sin()));
                let t = ((p.y + 0.1 * m.palm_radius) / (0.6 * cut)).clamp(0.0, 1.0);
                *p = Point3::from(centre + (off + (oval - off) * (t * t * (3.0 - 2.0 * t))) * narrower);
                p.y = level.unwrap_or(p.y);
            }
        }
    }

    /// Rounds what the bones' straight flesh leaves angular along the fingers.
    fn soften_fingers(&mut self, rings: &[Vec<Vec<u32>>; 5]) {
        for rings in rings {
            for _ in 0..4 {
                let old: Vec<Vec<Point3<f64>>> = rings
                    .iter()
                    .map(|r| r.iter().map(|&v| self.template.points[v as usize]).collect())
                    .collect();
                for k in 2..rings.len() - 1 {
                    for (j, &v) in rings[k].iter().enumerate() {
                        let (back, on, here) = (old[k - 1][j], old[k + 1][j], old[k][j]);
                        // The place on the chord at this ring's distance: rings stay where they are along the finger.
                        let chord = on - back;
                        let t = (here - back).dot(&chord) / chord.norm_squared().max(1e-18);
                        self.template.points[v as usize] =
                            mix(&here, &(back + chord * t.clamp(0.0, 1.0)), 0.35);
                    }
                }
            }
        }
    }
}

/// Place around the palm of a column of the palmar sheet, from the thumb's side.
fn palmar(u: usize) -> usize {
    SHEET - u
}

/// The same on the dorsal sheet.
fn dorsal(u: usize) -> usize {
    SHEET + THICK + u
}

/// Which of the inner lines of the radial rim a place around the palm is.
fn radial_rim(j: usize) -> Option<usize> {
    (SHEET + 1..SHEET + THICK).contains(&j).then(|| j - SHEET)
}

/// The seat of a place around the palm, and the angle of its look from the thumb's side towards the palmar one.
fn seat_around(guide: &[Seat; 6], j: usize) -> (Seat, f64) {
    use std::f64::consts::{FRAC_PI_2, PI};
    // The places between which guides of fingers lie, in columns from the thumb's side.
    let column = |u: f64| -> Seat {
        let middle = COLUMNS as f64 / 2.0;
        let [ulnar, fingers @ .., radial] = guide;
        let at = (u - middle) / COLUMNS as f64;
        if at <= 0.0 {
            return radial.towards(&fingers[3], u / middle);
        }
        if at >= 3.0 {
            return ulnar.towards(&fingers[0], (SHEET as f64 - u) / middle);
        }
        let k = at.floor() as usize;
        fingers[3 - k].towards(&fingers[(2usize).saturating_sub(k)], at - k as f64)
    };
    const FAN: f64 = 15.0 * PI / 180.0;
    let fan = |t: usize| (FRAC_PI_2 - FAN) * (1.0 - 2.0 * t as f64 / THICK as f64);
    let lean = |u: f64| {
        // Outer columns look a little outwards, so that they go over into the rims.
        let edge = (1.0 - u / 3.0).max(0.0) - (1.0 - (SHEET as f64 - u) / 3.0).max(0.0);
        FAN * edge
    };
    if j <= SHEET {
        let u = (SHEET - j) as f64;
        (column(u), FRAC_PI_2 - lean(u))
    } else if j < SHEET + THICK {
        (guide[5], fan(j - SHEET))
    } else if j <= 2 * SHEET + THICK {
        let u = (j - SHEET - THICK) as f64;
        (column(u), -FRAC_PI_2 + lean(u))
    } else {
        (guide[0], PI + fan(j - 2 * SHEET - THICK))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Side, Skeleton};

    /// How many vertices at the root of the thumb are in folds of the bind pose.
    fn folded_at_the_thumb(m: &Morphology) -> usize {
        let bind = Skeleton::new(m, Side::Right).local_frames(&super::super::designed_pose().angles);
        let field = Field::new(m, &bind);
        let builder = Builder::new(m, &bind, &field);
        let root = bind.position(Joint::ThumbProximal);
        let folded = builder.folded();
        folded.iter().filter(|&&v| (builder.template.points[v as usize] - root).norm() < 0.03).count()
    }

    #[test]
    fn webs_of_any_width_end_at_the_thumb_without_folds() {
        for (breadth, web_root) in [(1.0, 0.0), (1.0, 0.3), (1.15, 0.0), (1.15, 0.22), (1.3, 0.22)] {
            for web in [0.35, 0.6, 0.86, 1.05] {
                let mut m = Morphology { web_root, ..Morphology::default() };
                m.webs[0] = web;
                m.wrist_half_width *= breadth;
                let folded = folded_at_the_thumb(&m);
                assert_eq!(folded, 0, "breadth {breadth}, web {web} from {web_root}");
            }
        }
    }
}
