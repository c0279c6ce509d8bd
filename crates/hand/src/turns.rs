//! Joint angles from the rotations of joints: how the files of other programs say a pose.
//!
//! A joint's *turn* is its rotation in the frame of the joint above it, in the axes of
//! [`HandFrames`](super::HandFrames). Files differ in the axes of a joint ([`ours_from_webxr`]) and in how they write
//! a rotation ([`turns_zxy`]).

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::pose::mirror_rotation;
use super::{Finger, HandPose, Joint, JointAngle, Morphology, Side, Skeleton};

/// From a WebXR joint frame to ours: x to −x, y to −z, z to −y.
pub fn ours_from_webxr() -> UnitQuaternion<f64> {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // A half turn about (0, 1, −1).
    UnitQuaternion::new_unchecked(Quaternion::new(0.0, 0.0, half, -half))
}

/// Joint angles from the rotations of joints, pose by pose.
///
/// Where a knuckle is bent by a right angle, abduction and twisting turn about the same axis, and near it a file's last
/// digits decide how a turn is shared between them: twisting is then taken as in the pose before, as far as these digits
/// leave it open.
#[derive(Clone, Debug)]
pub struct PosesFromTurns {
    side: Side,
    /// Angles (z, x, y) of the thumb's first joint in the neutral pose.
    thumb: [f64; 3],
    /// Last angle of each finger's base joint (z, x, y) of the pose before.
    twists: [f64; Finger::COUNT],
}

impl PosesFromTurns {
    /// Of a hand of this side, from an untwisted pose on.
    pub fn new(side: Side) -> Self {
        let neutral = Skeleton::new(&Morphology::default(), Side::Right).local_frames(&[0.0; 29]);
        let joints = Joint::of(Finger::Thumb);
        let thumb = turns_zxy(&neutral.get(joints[joints.len() - 4]).rotation, [0.0; 2], 0.0);
        Self { side, thumb, twists: [thumb[2], 0.0, 0.0, 0.0, 0.0] }
    }

    /// The joint angles behind the rotation of each joint in the frame of the one above it, in our axes; the wrist
    /// stays where it is.
    pub fn pose(&mut self, turned: impl Fn(Joint) -> UnitQuaternion<f64>) -> HandPose {
        let mut pose = HandPose::neutral(self.side);
        // Of a right hand.
        let rotation = |joint: Joint| match self.side {
            Side::Right => turned(joint),
            Side::Left => mirror_rotation(&turned(joint)),
        };
        let about_x = |q: UnitQuaternion<f64>| wrap(2.0 * q.i.atan2(q.w));
        for (finger, twist) in Finger::ALL.into_iter().zip(&mut self.twists) {
            let joints = Joint::of(finger);
            let chain = &joints[joints.len() - 4..];
            let rest = if finger == Finger::Thumb { [self.thumb[0], self.thumb[2]] } else { [0.0; 2] };
            let [first, second, third] = turns_zxy(&rotation(chain[0]), rest, *twist);
            *twist = third;
            match finger.palm_flexion() {
                None => {
                    let [z, _, y] = self.thumb;
                    pose.set(finger.base_flexion(), wrap(first - z));
                    pose.set(finger.abduction(), second);
                    pose.set(finger.twisting(), wrap(third - y));
                }
                Some(palm) => {
                    pose.set(palm, about_x(rotation(joints[0])));
                    let radial = matches!(finger, Finger::Index | Finger::Middle);
                    pose.set(finger.abduction(), if radial { -first } else { first });
                    pose.set(finger.base_flexion(), second);
                    pose.set(finger.twisting(), third);
                }
            }
            let bends: [(JointAngle, Joint); 2] =
                [(finger.middle_flexion(), chain[1]), (finger.end_flexion(), chain[2])];
            for (angle, joint) in bends {
                pose.set(angle, about_x(rotation(joint)));
            }
        }
        pose
    }
}

/// An angle in −π..=π.
fn wrap(a: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    a - turn * (a / turn).round()
}

/// What files round rotations to, radians, and the cosine of x below which that shows in z and y.
const ROUNDED: f64 = 1.5e-7;
const SINGULAR: f64 = 0.05;

/// Angles (z, x, y), radians, with R = Rz Rx Ry, to a millionth of a radian in all. Of the two solutions the one that turns
/// less about z and y from `rest` (z, y): fingers bend past 90° but are never abducted that far. Where x is about a right
/// angle, y as near to `y_near` as that millionth allows.
pub fn turns_zxy(q: &UnitQuaternion<f64>, rest: [f64; 2], y_near: f64) -> [f64; 3] {
    let m = q.to_rotation_matrix();
    let sin_x = m[(2, 1)].clamp(-1.0, 1.0);
    let cos_x = m[(0, 1)].hypot(m[(1, 1)]);
    let solve = |sign: f64| {
        let z = (-m[(0, 1)] * sign).atan2(m[(1, 1)] * sign);
        let y = (-m[(2, 0)] * sign).atan2(m[(2, 2)] * sign);
        [z, sin_x.atan2(cos_x * sign), y]
    };
    let (near, far) = (solve(1.0), solve(-1.0));
    let turned = |[z, _, y]: [f64; 3]| wrap(z - rest[0]).hypot(wrap(y - rest[1]));
    let [z, x, y] = if turned(near) <= turned(far) { near } else { far };
    if cos_x > SINGULAR {
        return [z, x, y];
    }
    let open = ROUNDED / cos_x.max(ROUNDED * 1e-2);
    let y = wrap(y + wrap(y_near - y).clamp(-open, open));
    // Rz Rx.
    let m = (q * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -y)).to_rotation_matrix();
    [m[(1, 0)].atan2(m[(0, 0)]), m[(2, 1)].atan2(m[(2, 2)]), y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{JointAngles, limits};
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    fn turned([z, x, y]: [f64; 3]) -> UnitQuaternion<f64> {
        let axis = |v: Vector3<f64>, a: f64| UnitQuaternion::from_scaled_axis(v * a);
        axis(Vector3::z(), z) * axis(Vector3::x(), x) * axis(Vector3::y(), y)
    }

    /// Angles over all of their limits, many of them at and about a right angle.
    fn angles() -> impl Strategy<Value = JointAngles> {
        let near = prop_oneof![Just(0.0), -1e-9..1e-9f64, -1e-6..1e-6f64, -1e-3..1e-3f64];
        let share = prop::collection::vec((0.0..=1.0f64, prop::option::of(near)), JointAngle::COUNT);
        share.prop_map(|shares| {
            std::array::from_fn(|k| {
                let limits = limits(JointAngle::ALL[k]);
                let (share, near) = shares[k];
                let inside = limits.min + share * (limits.max - limits.min);
                near.map(|near| FRAC_PI_2 + near).filter(|&angle| angle <= limits.max).unwrap_or(inside)
            })
        })
    }

    proptest! {
        #[test]
        fn turns_are_found_again(z in -1.2f64..1.2, x in -2.0f64..2.0, y in -1.2f64..1.2) {
            prop_assume!(x.cos().abs() > SINGULAR);
            let found = turns_zxy(&turned([z, x, y]), [0.0; 2], 0.0);
            for (a, b) in found.into_iter().zip([z, x, y]) {
                prop_assert!((a - b).abs() < 1e-9, "{found:?}");
            }
        }

        /// At right angles as well, and y is what it was before as far as it is open.
        #[test]
        fn rotations_are_found_again(
            z in -3.1f64..3.1, off in prop_oneof![Just(0.0), -1e-7..1e-7f64, -1e-2..1e-2f64, -3.0..3.0f64],
            y in -1.5f64..1.5, near in -1.5f64..1.5,
        ) {
            let rotation = turned([z, FRAC_PI_2 + off, y]);
            let found = turns_zxy(&rotation, [0.0; 2], near);
            prop_assert!(turned(found).angle_to(&rotation) < 2e-6, "{found:?}");
            if off.abs() < 1e-8 {
                prop_assert!((found[2] - near).abs() < 1e-3, "{found:?}");
            }
        }

        /// Poses over all of the domain, and pieces of motion that end in them.
        #[test]
        fn poses_are_found_again(angles in angles(), before in angles(), left: bool) {
            let side = if left { Side::Left } else { Side::Right };
            let skeleton = Skeleton::new(&Morphology::default(), side);
            let mut reader = PosesFromTurns::new(side);
            for share in [0.0, 0.9, 0.99, 0.999, 1.0] {
                let angles = std::array::from_fn(|k| before[k] + share * (angles[k] - before[k]));
                let frames = skeleton.local_frames(&angles);
                let pose = reader.pose(|joint| match joint.parent() {
                    Some(above) => frames.get(above).rotation.inverse() * frames.get(joint).rotation,
                    None => frames.get(joint).rotation,
                });
                let found = skeleton.local_frames(&pose.angles);
                for joint in Joint::ALL {
                    let off = frames.get(joint).rotation.angle_to(&found.get(joint).rotation);
                    prop_assert!(off < 1e-5, "{joint:?}: {off}");
                }
            }
        }
    }

    #[test]
    fn webxr_axes_in_our_frame() {
        let c = ours_from_webxr();
        for (webxr, ours) in [
            (Vector3::x(), -Vector3::x()),
            (Vector3::y(), -Vector3::z()),
            (Vector3::z(), -Vector3::<f64>::y()),
        ] {
            assert!((c * webxr - ours).norm() < 1e-12);
        }
    }
}
