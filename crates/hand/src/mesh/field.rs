//! The hand's flesh as an implicit function: tapered capsules and sheets joined by smooth minima, with
//! soft bumps for knuckles, pads and creases. Negative inside; metres; right hand.

use nalgebra::{Point3, Vector3};

use crate::{Finger, HandFrames, Joint, Morphology};

/// A solid around a line segment or a triangle whose radius varies linearly.
#[derive(Clone, Debug)]
enum Solid {
    /// Capsule from `a` to `a + ab` with radii `ra` to `rb`; `scale` is 1 / |ab|².
    Cone { a: Point3<f64>, ab: Vector3<f64>, scale: f64, ra: f64, rb: f64 },
    /// Everything within `r` of a triangle.
    Sheet { corners: [Point3<f64>; 3], r: f64 },
}

impl Solid {
    fn cone(a: Point3<f64>, b: Point3<f64>, ra: f64, rb: f64) -> Self {
        let ab = b - a;
        Solid::Cone { a, ab, scale: 1.0 / ab.norm_squared().max(1e-18), ra, rb }
    }

    fn distance(&self, p: &Point3<f64>) -> f64 {
        match self {
            Solid::Cone { a, ab, scale, ra, rb } => {
                let ap = p - a;
                let t = (ap.dot(ab) * scale).clamp(0.0, 1.0);
                (ap - ab * t).norm() - (ra + (rb - ra) * t)
            }
            Solid::Sheet { corners, r } => triangle_distance(p, corners) - r,
        }
    }
}

fn triangle_distance(p: &Point3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> f64 {
    let edge = |from: &Point3<f64>, to: &Point3<f64>| {
        let d = to - from;
        let t = ((p - from).dot(&d) / d.norm_squared().max(1e-18)).clamp(0.0, 1.0);
        (p - from - d * t).norm()
    };
    let normal = (b - a).cross(&(c - a));
    let inside = |from: &Point3<f64>, to: &Point3<f64>| (to - from).cross(&normal).dot(&(p - from)) <= 0.0;
    if inside(a, b) && inside(b, c) && inside(c, a) && normal.norm_squared() > 0.0 {
        (p - a).dot(&normal).abs() / normal.norm()
    } else {
        edge(a, b).min(edge(b, c)).min(edge(c, a))
    }
}

/// A Gaussian swelling (positive) or dent (negative): its height is `amount`.
#[derive(Clone, Debug)]
struct Bump {
    centre: Point3<f64>,
    inverse_square: f64,
    amount: f64,
}

/// A place where the palm stands out, or is hollow where its height is negative; metres.
pub(super) struct Swelling {
    pub(super) centre: Point3<f64>,
    pub(super) reach: f64,
    pub(super) height: f64,
}

/// What an open hand shows: the balls of thumb and little finger, the hollow between them, the pads under the gaps of the
/// fingers, and on the back the hollows between the knuckles.
pub(super) fn relief(m: &Morphology, frames: &HandFrames) -> Vec<Swelling> {
    let r = m.palm_radius;
    let out = |p: Point3<f64>, by: f64| p + Vector3::new(0.0, 0.0, by * r);
    let thumb = |t: f64, x: f64| {
        frames.get(Joint::ThumbMetacarpal) * Point3::new(x * r, t * m.finger(Finger::Thumb).bones[0], 0.0)
    };
    let carpal = Point3::new(r - m.wrist_half_width, 0.35 * r, 0.0);
    let pinky = frames.position(Joint::PinkyProximal);
    let heel = |t: f64, x: f64| carpal + (pinky - carpal) * t + Vector3::new(x * r, 0.0, 0.0);
    let knuckles = Finger::LONG.map(|finger| frames.position(Joint::base(finger)));
    let ray = nalgebra::center(&knuckles[1], &knuckles[2]).coords;
    let mut found: Vec<_> = [
        (out(thumb(0.20, -0.3), 1.0), 1.3, 0.46),
        (out(thumb(0.55, -0.2), 0.9), 1.2, 0.42),
        (out(heel(0.18, 0.25), 0.95), 1.3, 0.44),
        (out(heel(0.52, 0.15), 0.9), 1.1, 0.30),
        (out(heel(0.30, -0.9), 0.2), 1.3, 0.40),
        (Point3::new(0.1 * r, 0.3 * r, r), 0.8, -0.22),
        (out(Point3::from(ray * 0.42), 1.0), 1.1, -0.28),
        (out(Point3::from(ray * 0.68), 1.0), 1.2, -0.30),
    ]
    .into();
    for pair in knuckles.windows(2) {
        let gap = nalgebra::center(&pair[0], &pair[1]);
        found.extend([(out(gap, 0.85), 0.6, 0.14), (out(gap, -0.7), 0.55, -0.12)]);
    }
    let swelling = |(centre, reach, height)| Swelling { centre, reach: reach * r, height: height * r };
    found.into_iter().map(swelling).collect()
}

/// The implicit hand in one pose.
pub(super) struct Field {
    palm: Vec<Solid>,
    fingers: Vec<Solid>,
    bumps: Vec<Bump>,
    /// The arm ends at this y.
    cut: f64,
    /// Hand length, the unit of the blending radii.
    unit: f64,
}

/// A part of the hand, whose flesh is looked at without that of the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    /// The palm with the roots of the fingers.
    Palm,
    /// One finger beyond the webs.
    Finger(Finger),
}

/// Bumps end where their exponent reaches this: at 3e-4 of their height.
const BUMP_END: f64 = 8.0;

/// min(a, b) with a fillet of size `k`.
fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0);
    a.min(b) - h * h / (4.0 * k)
}

impl Field {
    /// The flesh on `frames`, which are those of a right hand.
    pub(super) fn new(m: &Morphology, frames: &HandFrames) -> Self {
        let unit = m.hand_length;
        let mut field =
            Field { palm: Vec::new(), fingers: Vec::new(), bumps: Vec::new(), cut: -0.17 * unit, unit };
        for finger in Finger::ALL {
            field.add_finger(m, frames, finger);
        }
        field.add_palm(m, frames);
        field.add_thumb_root(m, frames);
        field.add_wrist(m);
        field
    }

    /// The same flesh with these swellings.
    pub(super) fn with_relief(mut self, relief: &[Swelling]) -> Self {
        for Swelling { centre, reach, height } in relief {
            self.bump(*centre, *reach, *height);
        }
        self
    }

    fn bump(&mut self, centre: Point3<f64>, reach: f64, amount: f64) {
        self.bumps.push(Bump { centre, inverse_square: 1.0 / (reach * reach), amount });
    }

    fn add_finger(&mut self, m: &Morphology, frames: &HandFrames, finger: Finger) {
        let f = m.finger(finger);
        let joints = Joint::of(finger);
        let joints = &joints[joints.len() - 4..];
        let r = f.radii;
        let at = |k: usize, y: f64, z: f64| frames.get(joints[k]) * Point3::new(0.0, y, z);
        let end = (f.bones[2] - r[3]).max(0.0);
        let spine = [at(0, 0.0, 0.0), at(1, 0.0, 0.0), at(2, 0.0, 0.0), at(2, end, 0.0)];
        // The root is inside the palm's flesh too, where the fillet of the two swells.
        let flesh = [if finger == Finger::Thumb { r[0] } else { 0.90 * r[0] }, r[1], r[2], r[3]];
        for k in 0..3 {
            self.fingers.push(Solid::cone(spine[k], spine[k + 1], flesh[k], flesh[k + 1]));
        }
        // Dorsal knuckles stand out, palmar creases run in, the flesh between them is full.
        self.bump(at(1, 0.0, -0.9 * r[1]), 0.8 * r[1], 0.08 * r[1]);
        self.bump(at(2, 0.0, -0.9 * r[2]), 0.7 * r[2], 0.04 * r[2]);
        self.bump(at(1, 0.0, 1.0 * r[1]), 0.5 * r[1], -0.07 * r[1]);
        self.bump(at(2, 0.0, 1.0 * r[2]), 0.45 * r[2], -0.06 * r[2]);
        self.bump(at(1, 0.5 * f.bones[1], 0.9 * r[1]), 0.9 * r[1], 0.07 * r[1]);
        if finger != Finger::Thumb {
            self.bump(at(0, 0.62 * f.bones[0], 0.9 * r[1]), 1.1 * r[1], 0.08 * r[1]);
            self.bump(at(0, 0.55 * f.bones[0], -0.9 * r[1]), 1.2 * r[1], -0.05 * r[1]);
            self.bump(at(0, -0.1 * r[0], -0.85 * r[0]), 0.85 * r[0], 0.10 * r[0]);
        }
        // The pulp of the fingertip is full, its back is flat under the nail.
        self.bump(at(2, end - 0.3 * r[3], 0.9 * r[3]), 1.2 * r[3], 0.10 * r[3]);
        self.bump(at(2, end + 0.1 * r[3], -r[3]), 1.0 * r[3], -0.16 * r[3]);
    }

    /// The metacarpals, the flesh between them and the webs between the fingers.
    fn add_palm(&mut self, m: &Morphology, frames: &HandFrames) {
        let r = m.palm_radius;
        let carpal_x = m.wrist_half_width - r;
        let carpal = |t: f64| Point3::new(carpal_x * (1.0 - 2.0 * t), 0.35 * r, 0.0);
        // `webs` is where the skin ends in the middle of a gap; the fillet reaches the rest of the way.
        let web = |finger: Finger, gap: usize, share: f64| {
            let f = m.finger(finger);
            let share = share * m.webs[gap].min(1.0);
            frames.get(Joint::base(finger)) * Point3::new(0.0, share * f.bones[0], 0.12 * f.radii[1])
        };
        for (i, finger) in Finger::LONG.into_iter().enumerate() {
            let f = m.finger(finger);
            let start = carpal(i as f64 / 3.0);
            let knuckle = frames.position(Joint::base(finger));
            self.palm.push(Solid::cone(start, knuckle, 0.80 * r, 0.86 * f.radii[0]));
            if i == 3 {
                continue;
            }
            let next = Finger::LONG[i + 1];
            let g = m.finger(next);
            let gap = i + 1;
            let (p, q) = (web(finger, gap, 0.40), web(next, gap, 0.40));
            let between = Point3::from((p.coords + q.coords) / 2.0);
            let start = carpal((i as f64 + 0.5) / 3.0);
            let thin = 0.5 * (f.radii[1] + g.radii[1]);
            self.palm.push(Solid::cone(start, between, 0.72 * r, 0.74 * thin));
            let (p, q) = (web(finger, gap, 0.82), web(next, gap, 0.82));
            self.palm.push(Solid::cone(p, q, 0.52 * f.radii[1], 0.52 * g.radii[1]));
        }
        let middle = frames.position(Joint::MiddleProximal);
        let ring = frames.position(Joint::RingProximal);
        let centre = Point3::from((middle.coords + ring.coords) * 0.5 * 0.58);
        self.bump(centre + Vector3::new(0.0, 0.0, 1.05 * r), 1.5 * r, -0.22 * r);
        // The pads at the finger roots close the hollow towards the fingers.
        for finger in Finger::LONG {
            let pad = frames.get(Joint::base(finger)) * Point3::new(0.0, 0.1 * r, 0.85 * r);
            self.bump(pad, 0.85 * r, 0.10 * r);
        }
        // The heel of the little finger's side (hypothenar).
        let pinky = frames.position(Joint::PinkyProximal);
        let heel = |t: f64, z: f64| carpal(1.0) + (pinky - carpal(1.0)) * t + Vector3::new(0.12 * r, 0.0, z);
        self.palm.push(Solid::cone(heel(0.02, 0.30 * r), heel(0.62, 0.22 * r), 0.84 * r, 0.74 * r));
    }

    /// The ball of the thumb and the sheet of skin to the index finger.
    fn add_thumb_root(&mut self, m: &Morphology, frames: &HandFrames) {
        let r = m.palm_radius;
        let thumb = m.finger(Finger::Thumb);
        let on_thumb =
            |t: f64, z: f64| frames.get(Joint::ThumbMetacarpal) * Point3::new(0.0, t * thumb.bones[0], z);
        let index = frames.position(Joint::IndexProximal);
        let wrist = Point3::new(0.6 * (m.wrist_half_width - r), 0.5 * r, 0.15 * r);
        let along_index = |t: f64| wrist + (index - wrist) * t;
        let ball = thumb.radii[0];
        self.palm.push(Solid::cone(wrist, on_thumb(0.45, 0.0), 0.80 * r, 0.92 * ball));
        let heel = Point3::new(0.45 * m.wrist_half_width, 0.9 * r, 0.35 * r);
        let hollow = on_thumb(0.55, 0.0) + (along_index(0.45) - on_thumb(0.55, 0.0)) * 0.30;
        self.palm.push(Solid::cone(heel, hollow + Vector3::new(0.0, 0.0, 0.25 * r), 0.74 * r, 0.80 * r));
        let reach = m.webs[0].min(1.2);
        let root = (0.90 * (1.0 - m.web_root)).min(0.95);
        let corners = [on_thumb(0.10, 0.0), on_thumb(0.97 * reach, 0.0), along_index(root)];
        self.palm.push(Solid::Sheet { corners, r: 0.52 * thumb.radii[1] });
        let corners = [along_index(0.2), on_thumb(0.5, 0.0), along_index(0.62)];
        self.palm.push(Solid::Sheet { corners, r: 0.62 * r });
    }

    /// The wrist and a stub of the forearm, oval, to be cut flat at `self.cut`.
    fn add_wrist(&mut self, m: &Morphology) {
        let r = m.palm_radius;
        let half = m.wrist_half_width;
        let end = self.cut - 2.0 * half;
        for side in [-1.0, 1.0] {
            let x = side * (half - 1.06 * r);
            self.palm.push(Solid::cone(
                Point3::new(x, 1.2 * r, 0.0),
                Point3::new(1.15 * x, end, 0.0),
                0.84 * r,
                1.15 * r,
            ));
        }
        self.palm.push(Solid::cone(
            Point3::new(0.0, 1.2 * r, 0.05 * r),
            Point3::new(0.0, end, 0.0),
            1.05 * r,
            1.40 * r,
        ));
    }

    /// Blending radii of the palm's solids, of the fingers' solids, and of palm and fingers.
    fn fillets(&self) -> [f64; 3] {
        [0.036, 0.007, 0.026].map(|k| k * self.unit)
    }

    /// Where the arm ends, metres.
    pub(super) fn cut(&self) -> f64 {
        self.cut
    }

    /// Signed size at `p` of the field of one part, metres: near its surface about the distance.
    pub(super) fn value_of(&self, part: Part, p: &Point3<f64>) -> f64 {
        // Three solids a finger, in their order.
        let own = self.fingers.iter().enumerate().filter(|(i, _)| match part {
            Part::Palm => i % 3 == 0 || *i == 1,
            Part::Finger(finger) => i / 3 == finger as usize,
        });
        // Webs would swell the fingers beside them.
        let palm = self.palm.iter().filter(|_| part == Part::Palm);
        let [k_palm, k_finger, k_join] = self.fillets();
        let palm = palm.fold(f64::MAX, |d, s| smooth_min(d, s.distance(p), k_palm));
        let fingers = own.fold(f64::MAX, |d, (_, s)| smooth_min(d, s.distance(p), k_finger));
        let mut d = smooth_min(palm, fingers, k_join);
        for b in &self.bumps {
            let q = (p - b.centre).norm_squared() * b.inverse_square;
            if q < BUMP_END {
                d -= b.amount * (-q).exp();
            }
        }
        // The flat end of the stub, its rim rounded.
        -smooth_min(-d, p.y - self.cut, 0.04 * self.unit)
    }

    /// Value and gradient of one part.
    pub(super) fn slope_of(&self, part: Part, p: &Point3<f64>) -> (f64, Vector3<f64>) {
        let e = 2e-4 * self.unit;
        let gradient =
            Self::CORNERS.map(|c| Vector3::from(c) * self.value_of(part, &(p + Vector3::from(c) * e)));
        (self.value_of(part, p), gradient.iter().sum::<Vector3<f64>>() / (4.0 * e))
    }

    /// Directions in which differences are taken.
    const CORNERS: [[f64; 3]; 4] = [[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, 1.0, 1.0]];
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn triangle_distance_equals_a_fine_sampling(v in prop::array::uniform12(-1.0f64..1.0)) {
            let p = |i: usize| Point3::new(v[i], v[i + 1], v[i + 2]);
            let corners = [p(3), p(6), p(9)];
            let mut best = f64::MAX;
            let n = 120;
            for i in 0..=n {
                for j in 0..=n - i {
                    let (s, t) = (i as f64 / n as f64, j as f64 / n as f64);
                    let q = corners[0] + (corners[1] - corners[0]) * s + (corners[2] - corners[0]) * t;
                    best = best.min((p(0) - q).norm());
                }
            }
            let d = triangle_distance(&p(0), &corners);
            prop_assert!(d <= best + 1e-9 && best <= d + 0.04, "{d} {best}");
        }
    }

    #[test]
    fn smooth_minimum_only_fills() {
        for (a, b) in [(0.0, 0.0), (1.0, 0.2), (-0.3, 0.1), (f64::MAX, 0.4)] {
            let s = smooth_min(a, b, 0.5);
            assert!(s <= f64::min(a, b) && s >= f64::min(a, b) - 0.125);
        }
    }
}
