//! What skin shows besides its colour: the creases of fingers and palm, and the nails.
//!
//! They are finer than the surface's triangles, so they are told as shapes in the bind pose, to be looked up
//! where a picture needs them.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::{Finger, HandFrames, Joint, Morphology};

/// Points of each line of the palm.
pub const LINE_POINTS: usize = 8;

/// Widths from its middle at which nothing is left of a crease: exp(−FAR²) is 0 in `f32`.
const FAR: f32 = 10.5;

/// The creases and nails of a hand in its bind pose, metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkinMarks {
    /// Half the width of a crease.
    pub width: f32,
    /// Creases of the fingers.
    pub creases: Vec<Crease>,
    /// Thumb to little finger.
    pub nails: Vec<Nail>,
    /// The three long lines of the palm, seen from the front (x, y).
    pub lines: Vec<[[f32; 2]; LINE_POINTS]>,
}

/// A crease on the palmar side of a finger: the skin in a plane across it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crease {
    /// Middle of the finger.
    pub centre: [f32; 3],
    /// Normal of the plane, along the finger.
    pub along: [f32; 3],
    /// Where the palmar side is.
    pub palmar: [f32; 3],
    /// Radius of the finger.
    pub radius: f32,
}

/// A nail: rows of the matrix from the bind pose to a frame in which its outline is x⁴ + y⁴ = 1, y towards the
/// tip, and its face is where z > 0.25.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nail(pub [[f32; 4]; 3]);

/// What is found at one place of the skin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mark {
    /// Depth of creases, 0 to 1.
    pub crease: f32,
    /// Share of nail, 0 to 1.
    pub nail: f32,
    /// The fold around a nail, 0 to 1.
    pub fold: f32,
    /// Pale parts of a nail: its root and its free edge, 0 to 1.
    pub pale: f32,
}

/// How much red, green and blue creases and the folds around nails swallow, and nails and their pale parts add.
const CREASE: [f32; 3] = [0.22, 0.34, 0.38];
const FOLD: [f32; 3] = [0.16, 0.26, 0.28];
const NAIL: [f32; 3] = [0.04, -0.03, 0.0];
const PALE: [f32; 3] = [0.04, 0.14, 0.20];

impl Mark {
    /// What it makes of the colour of skin: linear factors. `worn` is how deep creases are stained, about 1.
    pub fn colour(&self, worn: f32) -> [f32; 3] {
        let skin = 1.0 - self.nail;
        std::array::from_fn(|k| {
            (1.0 - CREASE[k] * worn * self.crease)
                * (1.0 - FOLD[k] * self.fold * skin)
                * (1.0 + self.nail * (NAIL[k] + PALE[k] * self.pale))
        })
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// How near a place is to a line of straight pieces, both seen along z, 0 to 1: exp(−(distance / `width`)²), times what `taper`
/// makes of the share of the line that lies before the nearest place of a piece, the largest of all pieces. At `far` widths
/// nothing is left.
pub(super) fn nearness(
    line: &[[f32; 2]],
    place: [f32; 3],
    width: f32,
    far: f32,
    taper: impl Fn(f32) -> f32,
) -> f32 {
    let mut most = 0.0f32;
    let reach = (far * width).powi(2);
    for (i, pair) in line.windows(2).enumerate() {
        let (a, b) = (pair[0], pair[1]);
        let (along, off) = ([b[0] - a[0], b[1] - a[1]], [place[0] - a[0], place[1] - a[1]]);
        let square = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
        let t = ((off[0] * along[0] + off[1] * along[1]) / square).clamp(0.0, 1.0);
        let gap = [off[0] - t * along[0], off[1] - t * along[1]];
        if gap[0] * gap[0] + gap[1] * gap[1] > reach {
            continue;
        }
        let distance = gap[0].hypot(gap[1]) / width;
        let share = (i as f32 + t) / (line.len() - 1) as f32;
        most = most.max((-distance * distance).exp() * taper(share));
    }
    most
}

pub(super) fn smooth_step(from: f32, to: f32, v: f32) -> f32 {
    let t = ((v - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl SkinMarks {
    /// The marks of a right hand of these sizes, whose joints are at `bind`.
    pub(super) fn new(m: &Morphology, bind: &HandFrames) -> Self {
        let mut marks = Self { width: (0.0031 * m.hand_length) as f32, ..Self::default() };
        for finger in Finger::ALL {
            let f = m.finger(finger);
            let joints = Joint::of(finger);
            let [a, b, c] =
                [joints.len() - 4, joints.len() - 3, joints.len() - 2].map(|i| *bind.get(joints[i]));
            let between = |first: &Isometry3<f64>, second: &Isometry3<f64>| {
                let rotation = first.rotation.slerp(&second.rotation, 0.5);
                Isometry3::from_parts(second.translation, rotation)
            };
            let mut add = |frame: Isometry3<f64>, y: f64, radius: f64| {
                marks.creases.push(Crease {
                    centre: (frame * Point3::new(0.0, y, 0.0)).coords.cast::<f32>().into(),
                    along: (frame.rotation * Vector3::y()).cast::<f32>().into(),
                    palmar: (frame.rotation * Vector3::z()).cast::<f32>().into(),
                    radius: radius as f32,
                });
            };
            let gap = 0.11 * f.radii[1];
            add(between(&b, &c), 0.0, f.radii[2]);
            add(between(&a, &b), gap, f.radii[1]);
            if finger != Finger::Thumb {
                add(between(&a, &b), -gap, f.radii[1]);
                add(a, 0.47 * f.bones[0], f.radii[0]);
            }
            let r = f.radii[3];
            let bed = Point3::new(0.0, f.bones[2] - 0.72 * r, 0.0);
            let inverse = (c * nalgebra::Translation3::from(bed.coords)).inverse().to_homogeneous();
            let scale = [1.0 / (0.74 * r), 1.0 / (0.98 * r), -1.0 / r];
            marks.nails.push(Nail(std::array::from_fn(|k| {
                std::array::from_fn(|j| (inverse[(k, j)] * scale[k]) as f32)
            })));
        }
        let at = |joint: Joint| bind.position(joint).coords.xy();
        let unit = m.hand_length;
        let [index, middle, ring, little] = [Finger::Index, Finger::Middle, Finger::Ring, Finger::Pinky]
            .map(|finger| at(Joint::base(finger)));
        let wrist = at(Joint::Wrist);
        let off = |x: f64, y: f64| nalgebra::Vector2::new(x, y) * unit;
        let radial = index + off(0.055, -0.10);
        for [a, b, c] in [
            [little + off(-0.05, -0.055), (ring + middle) / 2.0 + off(0.0, -0.15), (index + middle) / 2.0],
            [radial, middle + off(0.0, -0.17), little + off(-0.02, -0.22)],
            [radial, middle + off(-0.02, -0.20), wrist + off(0.03, 0.02)],
        ] {
            marks.lines.push(std::array::from_fn(|i| {
                let t = i as f64 / (LINE_POINTS - 1) as f64;
                (a * (1.0 - t) * (1.0 - t) + b * (2.0 * t * (1.0 - t)) + c * t * t).cast::<f32>().into()
            }));
        }
        marks
    }

    /// Right to left.
    pub(super) fn mirror(&mut self) {
        for crease in &mut self.creases {
            for v in [&mut crease.centre, &mut crease.along, &mut crease.palmar] {
                v[0] = -v[0];
            }
        }
        for row in self.nails.iter_mut().flat_map(|nail| &mut nail.0) {
            row[0] = -row[0];
        }
        for point in self.lines.iter_mut().flatten() {
            point[0] = -point[0];
        }
    }

    /// What is at a place of the bind pose.
    pub fn at(&self, p: [f32; 3]) -> Mark {
        let mut mark = Mark::default();
        for c in &self.creases {
            let off = [p[0] - c.centre[0], p[1] - c.centre[1], p[2] - c.centre[2]];
            let square = dot(off, off);
            // Most are far away, which the square tells: no root of it is taken then.
            if square > 3.0 * c.radius * c.radius {
                continue;
            }
            let reach = square.sqrt() / c.radius;
            if reach < 1.6 {
                let across = dot(off, c.along) / self.width;
                if across.abs() > FAR {
                    continue;
                }
                let side = smooth_step(0.0, 0.8, dot(off, c.palmar) / c.radius);
                let depth = (-across.powi(2)).exp();
                mark.crease = mark.crease.max(depth * side * smooth_step(1.6, 1.3, reach));
            }
        }
        if p[2] > 0.0 {
            let front = smooth_step(0.0, 0.006, p[2]);
            let taper = |share| smooth_step(0.0, 0.25, share) * smooth_step(1.0, 0.7, share);
            for line in &self.lines {
                mark.crease = mark.crease.max(front * nearness(line, p, 1.2 * self.width, FAR, taper));
            }
        }
        for Nail(rows) in &self.nails {
            let [x, y, z] = rows.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3]);
            if z <= 0.25 || x.abs() > 1.5 || y.abs() > 1.5 {
                continue;
            }
            let inside = 1.0 - x.powi(4) - y.powi(4);
            let face = smooth_step(0.25, 0.45, z);
            mark.nail = mark.nail.max(face * smooth_step(0.0, 0.25, inside));
            // The fold is at the root and the sides, not at the free edge.
            let fold = (-((inside + 0.05) / 0.4).powi(2)).exp() * smooth_step(0.9, 0.3, y);
            mark.fold = mark.fold.max(face * fold);
            let root = smooth_step(-0.5, -0.72, y + 0.25 * x * x);
            let edge = smooth_step(0.62, 0.74, y + 0.2 * x * x);
            mark.pale = mark.pale.max(root.max(edge));
        }
        mark
    }
}

#[cfg(test)]
mod tests {
    use super::super::HandMesh;
    use super::*;
    use crate::Side;

    #[test]
    fn nails_are_on_the_back_of_the_ends_and_creases_on_the_palm_of_either_hand() {
        for side in [Side::Left, Side::Right] {
            let mesh = HandMesh::generate(&Morphology::default(), side).refined();
            assert_eq!((mesh.marks.creases.len(), mesh.marks.nails.len()), (18, 5));
            let ends = Finger::ALL.map(|f| Joint::of(f)[Joint::of(f).len() - 2]);
            let (mut nails, mut creases) = ([0; 5], [0; 2]);
            for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
                let mark = mesh.marks.at(*p);
                let all = [mark.crease, mark.nail, mark.fold, mark.pale];
                assert!(all.iter().all(|v| (0.0..=1.0).contains(v)), "{mark:?}");
                creases[usize::from(n[2] > 0.0)] += usize::from(mark.crease > 0.5);
                if mark.nail > 0.5 {
                    let place = Point3::from(*p).cast::<f64>();
                    let off = |joint: &Joint| (mesh.bind.position(*joint) - place).norm();
                    let finger = (0..5).min_by(|&a, &b| off(&ends[a]).total_cmp(&off(&ends[b]))).unwrap();
                    let up = -(mesh.bind.get(ends[finger]).rotation.inverse() * Vector3::from(*n).cast()).z;
                    assert!(up > 0.0, "{side:?}: a nail of finger {finger} on the palmar side");
                    nails[finger] += 1;
                }
            }
            assert!(nails.iter().all(|&n| n > 10), "{side:?}: {nails:?}");
            assert!(creases[1] > 60 && creases[0] < creases[1] / 2, "{side:?}: {creases:?}");
        }
    }
}
