//! The simple shape of the hand: convex hulls of spheres on the skeleton (paper fig. 7a).
//!
//! A tapered capsule is the hull of two spheres, the palm the hull of six. Under orthographic or weak
//! perspective projection a hull of spheres becomes the convex hull of discs, which rasterises fast.

use nalgebra::Point3;

use super::pose::mirror_vector;
use super::{Finger, HandFrames, Joint, Morphology, Side};

/// Most spheres in one primitive.
pub const MAX_HULL_SPHERES: usize = 6;

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
    spheres: Vec<Sphere>,
    primitives: Vec<Primitive>,
}

impl Shape {
    /// The primitives of a hand of these sizes: three capsules a finger, the palm, the webs between the
    /// fingers and the ball of the thumb.
    pub fn primitives_of(morphology: &Morphology, side: Side) -> Self {
        let mut shape = Shape { spheres: Vec::new(), primitives: Vec::new() };
        let m = morphology;
        let r = m.palm_radius;
        let at = Point3::new;
        let wrist_x = m.wrist_half_width - r;
        let wrist_radial = shape.sphere(Joint::Wrist, at(wrist_x, 0.35 * r, 0.0), r);
        let wrist_ulnar = shape.sphere(Joint::Wrist, at(-wrist_x, 0.35 * r, 0.0), r);
        let mut knuckles = [0u8; 5];
        for finger in Finger::ALL {
            let f = m.finger(finger);
            let joints = Joint::of(finger);
            let joints = &joints[joints.len() - 4..];
            let s0 = shape.sphere(joints[0], Point3::origin(), f.radii[0]);
            let s1 = shape.sphere(joints[1], Point3::origin(), f.radii[1]);
            let s2 = shape.sphere(joints[2], Point3::origin(), f.radii[2]);
            let tip = at(0.0, (f.bones[2] - f.radii[3]).max(0.0), 0.0);
            let s3 = shape.sphere(joints[2], tip, f.radii[3]);
            for pair in [[s0, s1], [s1, s2], [s2, s3]] {
                shape.hull(&pair);
            }
            knuckles[finger as usize] = s0;
        }
        let [cmc, index, middle, ring, pinky] = knuckles;
        shape.hull(&[wrist_radial, wrist_ulnar, index, middle, ring, pinky]);
        for gap in 1..4 {
            let mut web = |finger: Finger| {
                let f = m.finger(finger);
                let centre = at(0.0, m.webs[gap] * f.bones[0], 0.0);
                shape.sphere(Joint::base(finger), centre, 0.75 * f.radii[1])
            };
            let (a, b) = (web(Finger::ALL[gap]), web(Finger::ALL[gap + 1]));
            shape.hull(&[knuckles[gap], knuckles[gap + 1], a, b]);
        }
        let thumb = m.finger(Finger::Thumb);
        let thumb_web = at(0.0, m.webs[0] * thumb.bones[0], 0.0);
        let thumb_web = shape.sphere(Joint::ThumbMetacarpal, thumb_web, 0.7 * thumb.radii[1]);
        shape.hull(&[cmc, thumb_web, index]);
        shape.hull(&[cmc, wrist_radial, middle]);
        if side == Side::Left {
            for s in &mut shape.spheres {
                s.offset = Point3::from(mirror_vector(s.offset.coords));
            }
        }
        shape
    }

    fn sphere(&mut self, joint: Joint, offset: Point3<f64>, radius: f64) -> u8 {
        self.spheres.push(Sphere { joint, offset, radius });
        (self.spheres.len() - 1) as u8
    }

    fn hull(&mut self, spheres: &[u8]) {
        debug_assert!((2..=MAX_HULL_SPHERES).contains(&spheres.len()));
        self.primitives.push(Primitive { spheres: spheres.to_vec() });
    }

    /// The spheres.
    pub fn spheres(&self) -> &[Sphere] {
        &self.spheres
    }

    /// Indices of the two spheres that end the palm at the wrist, radial and ulnar.
    pub fn wrist_spheres(&self) -> [usize; 2] {
        [0, 1]
    }

    /// Indices of the spheres of a finger, from the palm outwards: the ends of its three capsules.
    pub fn finger_spheres(finger: Finger) -> [usize; 4] {
        std::array::from_fn(|k| 2 + 4 * finger as usize + k)
    }

    /// The finger, and its bone from the palm outwards, that a hull is; `None` for those of the palm.
    pub fn bone(primitive: usize) -> Option<(Finger, usize)> {
        Finger::ALL.get(primitive / 3).map(|&finger| (finger, primitive % 3))
    }

    /// The hulls.
    pub fn primitives(&self) -> &[Primitive] {
        &self.primitives
    }

    /// Where the spheres are when the joints stand at `frames`: centres and radii, in the order of
    /// [`Shape::spheres`], in the space of `frames`.
    pub fn placed<'a>(&'a self, frames: &'a HandFrames) -> impl Iterator<Item = (Point3<f64>, f64)> + 'a {
        self.spheres.iter().map(|s| (frames.get(s.joint) * s.offset, s.radius))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Skeleton;

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
    fn the_middle_fingertip_is_a_hand_length_from_the_wrist() {
        let m = Morphology::default();
        let frames = Skeleton::new(&m, Side::Right).local_frames(&[0.0; 29]);
        let top = Shape::primitives_of(&m, Side::Right)
            .placed(&frames)
            .map(|(c, r)| c.y + r)
            .fold(f64::MIN, f64::max);
        assert!((top - m.hand_length).abs() < 1e-9);
    }
}
