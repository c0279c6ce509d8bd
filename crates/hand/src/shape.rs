//! The simple shape of the hand: convex hulls of spheres on the skeleton (paper fig. 7a).
//!
//! A tapered capsule is the hull of two spheres, the palm the hull of seven. Under orthographic or weak
//! perspective projection a hull of spheres becomes the convex hull of discs, which rasterises fast.

use nalgebra::{Point3, Vector3};

use super::pose::mirror_vector;
use super::{Finger, HandFrames, Joint, Morphology, Side};

/// Most spheres in one primitive.
pub const MAX_HULL_SPHERES: usize = 7;

/// Spheres of a finger: at its base, its two joints and near its tip, then half way along its three bones; and its hulls,
/// the halves of those bones.
const OF_FINGER: usize = 7;
const HULLS: usize = 6;
/// Index of the first sphere of the thumb; those of the wrist, radial and ulnar, come before it.
const FINGERS: usize = 2;
/// Index of the sphere at the ulnar border of the palm; the two of each web follow: of the thumb's web the one on
/// the thumb and the one at the palm, of the others that on the finger nearer to the thumb first.
const ULNAR: usize = FINGERS + 5 * OF_FINGER;
const WEBS: usize = ULNAR + 1;
const SPHERES: usize = WEBS + 8;

/// A sphere fixed to a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// The joint that carries it.
    pub joint: Joint,
    /// Centre in the joint's frame, metres.
    pub offset: Point3<f64>,
    /// Radius, metres.
    pub radius: f64,
}

/// The convex hull of a few spheres.
#[derive(Clone, Debug, PartialEq)]
pub struct Primitive {
    /// Two to [`MAX_HULL_SPHERES`] indices into [`Shape::spheres`].
    pub spheres: Vec<u8>,
}

/// Spheres and the hulls they span.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    spheres: [Sphere; SPHERES],
    primitives: Vec<Primitive>,
}

impl Shape {
    /// Index of the palm's hull.
    pub const PALM: usize = 5 * HULLS;
    /// The hull of a piece of forearm: the spheres at the wrist, and its two other ends, radial and ulnar, whose
    /// indices follow those of [`Shape::spheres`].
    pub const FOREARM: [u8; 4] = [0, 1, SPHERES as u8, SPHERES as u8 + 1];

    /// The primitives of a hand of these sizes: six capsules a finger, the palm, the webs between the
    /// fingers and the ball of the thumb.
    pub fn primitives_of(morphology: &Morphology, side: Side) -> Self {
        Self { spheres: spheres_of(morphology, side), primitives: primitives() }
    }

    /// Gives it other sizes; the primitives are of the same spheres as before.
    pub fn resize(&mut self, morphology: &Morphology, side: Side) {
        self.spheres = spheres_of(morphology, side);
    }

    /// The spheres.
    pub fn spheres(&self) -> &[Sphere] {
        &self.spheres
    }

    /// Indices of the two spheres that end the palm at the wrist, radial and ulnar.
    pub fn wrist_spheres(&self) -> [usize; 2] {
        [0, 1]
    }

    /// Indices of the spheres of a finger at the ends of its bones, from the palm outwards.
    pub fn finger_spheres(finger: Finger) -> [usize; 4] {
        std::array::from_fn(|k| FINGERS + OF_FINGER * finger as usize + k)
    }

    /// The finger, and its bone from the palm outwards, that a hull is a half of; `None` for those of the palm.
    pub fn bone(primitive: usize) -> Option<(Finger, usize)> {
        Finger::ALL.get(primitive / HULLS).map(|&finger| (finger, primitive % HULLS / 2))
    }

    /// The hulls.
    pub fn primitives(&self) -> &[Primitive] {
        &self.primitives
    }

    /// The indices of the spheres of each hull.
    pub fn hulls(&self) -> impl Iterator<Item = &[u8]> {
        self.primitives.iter().map(|p| &p.spheres[..])
    }

    /// Where the spheres are when the joints stand at `frames`: centres and radii, in the order of
    /// [`Shape::spheres`], in the space of `frames`.
    pub fn placed<'a>(&'a self, frames: &'a HandFrames) -> impl Iterator<Item = (Point3<f64>, f64)> + 'a {
        self.spheres.iter().map(|s| (frames.get(s.joint) * s.offset, s.radius))
    }
}

/// Index of the sphere half way along a bone of a finger, from the palm outwards.
fn waist(finger: Finger, bone: usize) -> usize {
    Shape::finger_spheres(finger)[0] + 4 + bone
}

fn spheres_of(m: &Morphology, side: Side) -> [Sphere; SPHERES] {
    let at = Point3::new;
    let sphere = |joint, offset, radius| Sphere { joint, offset, radius };
    let r = m.palm_radius;
    let wrist = [1.0, -1.0].map(|side| at(m.wrist_lateral + side * (m.wrist_half_width - r), 0.35 * r, 0.0));
    let mut spheres = [sphere(Joint::Wrist, wrist[0], r); SPHERES];
    spheres[1].offset = wrist[1];
    for finger in Finger::ALL {
        let f = m.finger(finger);
        let joints = Joint::of(finger);
        let joints = &joints[joints.len() - 4..];
        let tip = (f.bones[2] - f.radii[3]).max(0.0);
        for (k, y) in [0.0, 0.0, 0.0, tip].into_iter().enumerate() {
            spheres[Shape::finger_spheres(finger)[k]] =
                sphere(joints[k.min(2)], at(f.lateral[k], y, 0.0), f.radii[k]);
        }
        for (k, length) in [f.bones[0], f.bones[1], tip].into_iter().enumerate() {
            let radius = f.waists[k] * 0.5 * (f.radii[k] + f.radii[k + 1]);
            spheres[waist(finger, k)] = sphere(joints[k], at(f.lateral[4 + k], 0.5 * length, 0.0), radius);
        }
    }
    let [thumb, index, .., pinky] = &m.fingers;
    let little = Point3::from(pinky.base);
    let along = little - wrist[1];
    let out = Vector3::new(-along.y, along.x, 0.0).try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
    let border = wrist[1] + along * BORDER + out * m.ulnar_border;
    spheres[ULNAR] = sphere(Joint::Wrist, border, r + BORDER * (pinky.radii[0] - r));
    let web = |finger: Finger, gap: usize, share: f64| {
        let f = m.finger(finger);
        sphere(Joint::base(finger), at(0.0, m.webs[gap] * f.bones[0], 0.0), share * f.radii[1])
    };
    let root = Point3::from(index.base).coords.lerp(&Point3::from(thumb.base).coords, m.web_root);
    spheres[WEBS] = web(Finger::Thumb, 0, 0.7);
    spheres[WEBS + 1] = sphere(Joint::Wrist, root.into(), index.radii[0]);
    for gap in 1..4 {
        for (k, finger) in Finger::ALL[gap..gap + 2].iter().enumerate() {
            spheres[WEBS + 2 * gap + k] = web(*finger, gap, 0.75);
        }
    }
    if side == Side::Left {
        for s in &mut spheres {
            s.offset = Point3::from(mirror_vector(s.offset.coords));
        }
    }
    spheres
}

/// Where the flesh below the little finger stands out: share of the way from the wrist to the finger's base.
const BORDER: f64 = 0.45;

fn primitives() -> Vec<Primitive> {
    let mut primitives = Vec::new();
    let mut hull = |spheres: &[usize]| {
        debug_assert!((2..=MAX_HULL_SPHERES).contains(&spheres.len()));
        primitives.push(Primitive { spheres: spheres.iter().map(|&i| i as u8).collect() });
    };
    for finger in Finger::ALL {
        let ends = Shape::finger_spheres(finger);
        for k in 0..3 {
            hull(&[ends[k], waist(finger, k)]);
            hull(&[waist(finger, k), ends[k + 1]]);
        }
    }
    let [cmc, index, middle, ring, pinky] = Finger::ALL.map(|f| Shape::finger_spheres(f)[0]);
    let [radial, ulnar] = [0, 1];
    // At `Shape::PALM`.
    hull(&[radial, ulnar, ULNAR, index, middle, ring, pinky]);
    for (gap, knuckles) in [[index, middle], [middle, ring], [ring, pinky]].into_iter().enumerate() {
        let web = WEBS + 2 * (gap + 1);
        hull(&[knuckles[0], knuckles[1], web, web + 1]);
    }
    hull(&[cmc, WEBS, WEBS + 1]);
    hull(&[cmc, radial, middle]);
    primitives
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::JointAngle;
    use crate::Skeleton;

    #[test]
    fn left_shape_is_the_mirror_image() {
        let m = Morphology::default();
        let angles = std::array::from_fn(|i| 0.02 * i as f64);
        let place = |side| -> Vec<_> {
            let frames = Skeleton::new(&m, side).local_frames(&angles);
            Shape::primitives_of(&m, side).placed(&frames).collect()
        };
        for ((r, rr), (l, lr)) in place(Side::Right).into_iter().zip(place(Side::Left)) {
            assert!((r.x + l.x).abs() + (r.y - l.y).abs() + (r.z - l.z).abs() < 1e-12);
            assert_eq!(rr, lr);
        }
    }

    #[test]
    fn the_hulls_are_where_they_are_looked_for() {
        let shape = Shape::primitives_of(&Morphology::default(), Side::Right);
        assert_eq!(shape.primitives()[Shape::PALM].spheres.len(), MAX_HULL_SPHERES);
        for (i, primitive) in shape.primitives().iter().enumerate() {
            let Some((finger, bone)) = Shape::bone(i) else {
                assert!(i >= Shape::PALM);
                continue;
            };
            for &s in &primitive.spheres {
                let sphere = shape.spheres()[usize::from(s)];
                let joint = Joint::of(finger).iter().rev().nth(3 - bone).copied().unwrap();
                let next = Joint::of(finger).iter().rev().nth(2 - bone).copied().unwrap();
                assert!(sphere.joint == joint || sphere.joint == next, "{i} {s}");
            }
        }
        assert_eq!(Shape::FOREARM.map(usize::from), [0, 1, shape.spheres().len(), shape.spheres().len() + 1]);
        assert_eq!(Shape::FOREARM[..2], shape.wrist_spheres().map(|i| i as u8));
        assert!(shape.primitives().iter().flat_map(|p| &p.spheres).all(|&s| usize::from(s) < SPHERES));
    }

    #[test]
    fn the_middle_fingertip_is_a_hand_length_from_the_wrist() {
        let m = Morphology::default();
        let frames = Skeleton::new(&m, Side::Right).local_frames(&[0.0; JointAngle::COUNT]);
        let top = Shape::primitives_of(&m, Side::Right)
            .placed(&frames)
            .map(|(c, r)| c.y + r)
            .fold(f64::MIN, f64::max);
        assert!((top - m.hand_length).abs() < 1e-9);
    }
}
