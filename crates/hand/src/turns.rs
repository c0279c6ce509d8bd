//! Joint angles from the rotations of joints: how the files of other programs say a pose.
//!
//! A joint's *turn* is its rotation in the frame of the joint above it, in the axes of
//! [`HandFrames`](super::HandFrames). Files differ in the axes of a joint ([`ours_from_webxr`]) and in how they write
//! a rotation ([`turns_zxy`]).

use nalgebra::{Quaternion, UnitQuaternion};

use super::pose::mirror_rotation;
use super::{Finger, HandPose, Joint, JointAngle, Morphology, Side, Skeleton};

/// From a WebXR joint frame to ours: x to −x, y to −z, z to −y.
pub fn ours_from_webxr() -> UnitQuaternion<f64> {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // A half turn about (0, 1, −1).
    UnitQuaternion::new_unchecked(Quaternion::new(0.0, 0.0, half, -half))
}

/// The joint angles behind the rotation of each joint in the frame of the one above it, in our axes; the wrist
/// stays where it is.
pub fn pose_from_turns(side: Side, turned: impl Fn(Joint) -> UnitQuaternion<f64>) -> HandPose {
    let mut pose = HandPose::neutral(side);
    // Of a right hand.
    let rotation = |joint: Joint| match side {
        Side::Right => turned(joint),
        Side::Left => mirror_rotation(&turned(joint)),
    };
    let about_x = |q: UnitQuaternion<f64>| wrap(2.0 * q.i.atan2(q.w));
    let neutral = Skeleton::new(&Morphology::default(), Side::Right).local_frames(&[0.0; 29]);
    for finger in Finger::ALL {
        let joints = Joint::of(finger);
        let chain = &joints[joints.len() - 4..];
        let [first, second, third] = turns_zxy(&rotation(chain[0]));
        match finger.palm_flexion() {
            None => {
                let [z, _, y] = turns_zxy(&neutral.get(chain[0]).rotation);
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

/// An angle in −π..=π.
fn wrap(a: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    a - turn * (a / turn).round()
}

/// Angles (z, x, y), radians, with R = Rz Rx Ry. Of the two solutions the one that turns less about z and y:
/// fingers bend past 90° but are never abducted that far.
pub fn turns_zxy(q: &UnitQuaternion<f64>) -> [f64; 3] {
    let m = q.to_rotation_matrix();
    let sin_x = m[(2, 1)].clamp(-1.0, 1.0);
    let cos_x = m[(0, 1)].hypot(m[(1, 1)]);
    if cos_x < 1e-3 {
        // z and y turn about the same axis: all of it is given to z.
        return [m[(1, 0)].atan2(m[(0, 0)]), sin_x.atan2(cos_x), 0.0];
    }
    let solve = |sign: f64| {
        let z = (-m[(0, 1)] * sign).atan2(m[(1, 1)] * sign);
        let y = (-m[(2, 0)] * sign).atan2(m[(2, 2)] * sign);
        [z, sin_x.atan2(cos_x * sign), y]
    };
    let (near, far) = (solve(1.0), solve(-1.0));
    if near[0].hypot(near[2]) <= far[0].hypot(far[2]) { near } else { far }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn turns_are_found_again(z in -1.2f64..1.2, x in -2.0f64..2.0, y in -1.2f64..1.2) {
            prop_assume!((x.abs() - std::f64::consts::FRAC_PI_2).abs() > 0.01);
            let axis = |v: Vector3<f64>, a: f64| UnitQuaternion::from_scaled_axis(v * a);
            let q = axis(Vector3::z(), z) * axis(Vector3::x(), x) * axis(Vector3::y(), y);
            let found = turns_zxy(&q);
            for (a, b) in found.into_iter().zip([z, x, y]) {
                prop_assert!((a - b).abs() < 1e-9, "{found:?}");
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
