//! Joint angles from the rotations of joints: how the files of other programs say a pose.
//!
//! A joint's *turn* is its rotation in the frame of the joint above it, in the axes of
//! [`HandFrames`](super::HandFrames). Files differ in the axes of a joint ([`ours_from_webxr`]) and in how they write
//! a rotation ([`turns_zxy`]).

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::pose::mirror_rotation;
use super::{AngleLimits, Finger, HandPose, Joint, JointAngle, Morphology, Side, Skeleton, limits};

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
///
/// Files without the bones of the palm say its bend as part of the knuckle's ([`PosesFromTurns::without_palms`]).
#[derive(Clone, Debug)]
pub struct PosesFromTurns {
    side: Side,
    /// Fingers whose bone in the palm no file tells of.
    palmless: [bool; Finger::COUNT],
    /// How far off rotations may be, radians.
    off: f64,
    /// Angles (z, x, y) of the thumb's first joint in the neutral pose.
    thumb: [f64; 3],
    /// Last angle of each finger's base joint (z, x, y) of the pose before.
    twists: [f64; Finger::COUNT],
    /// The same of the last pose whose knuckle was not near a right angle.
    steady: [f64; Finger::COUNT],
}

impl PosesFromTurns {
    /// Of a hand of this side, from an untwisted pose on.
    pub fn new(side: Side) -> Self {
        let neutral = Skeleton::new(&Morphology::default(), Side::Right).local_frames(&[0.0; 29]);
        let joints = Joint::of(Finger::Thumb);
        let thumb = turns_zxy(&neutral.get(joints[joints.len() - 4]).rotation, [0.0; 2], 0.0);
        let twists = [thumb[2], 0.0, 0.0, 0.0, 0.0];
        Self { side, palmless: [false; Finger::COUNT], off: 0.0, thumb, twists, steady: twists }
    }

    /// The same where the bones in the palm of some fingers are not told of and seem to stay at rest. What their joints turn
    /// is then in the turn of the knuckle, which passes by its right angle as no knuckle does: where abduction, twisting
    /// or flexion were beyond what hands do, the palm bends by as little as brings them back. The fingers turn as told.
    #[must_use]
    pub fn without_palms(self, palmless: impl Fn(Finger) -> bool) -> Self {
        Self { palmless: Finger::ALL.map(palmless), ..self }
    }

    /// The same where rotations may be off by so many radians, since they are told against a palm that is not quite the hand's: where a
    /// knuckle is bent by about a right angle, twisting is as it was before, as far as that leaves it open.
    #[must_use]
    pub fn off_by(self, off: f64) -> Self {
        Self { off, ..self }
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
        let memory = self.twists.iter_mut().zip(&mut self.steady).zip(self.palmless);
        for (finger, ((twist, steady), palmless)) in Finger::ALL.into_iter().zip(memory) {
            let joints = Joint::of(finger);
            let chain = &joints[joints.len() - 4..];
            let base = rotation(chain[0]);
            match finger.palm_flexion() {
                None => {
                    let [z, _, y] = self.thumb;
                    let [first, second, third] = turns_zxy(&base, [z, y], *twist);
                    *twist = third;
                    pose.set(finger.base_flexion(), wrap(first - z));
                    pose.set(finger.abduction(), second);
                    pose.set(finger.twisting(), wrap(third - y));
                }
                Some(palm) => {
                    let knuckle = Knuckle { finger, palm, twist: *twist, steady: *steady, off: self.off };
                    let (bent, [first, second, third]) = if palmless {
                        knuckle.shared(&base)
                    } else {
                        (about_x(rotation(joints[0])), knuckle.turns(&base))
                    };
                    *twist = third;
                    if second.cos() > NEAR {
                        *steady = third;
                    }
                    pose.set(palm, bent);
                    pose.set(finger.abduction(), if is_radial(finger) { -first } else { first });
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

/// Whether the finger is abducted towards the thumb.
fn is_radial(finger: Finger) -> bool {
    matches!(finger, Finger::Index | Finger::Middle)
}

/// The cosine of a knuckle's flexion below which it is near a right angle.
const NEAR: f64 = 0.35;
/// How far twisting may go from what it was, radians: at a right angle and far from it. By the first twisting and
/// abduction may be beyond their limits.
const SWING: [f64; 2] = [5.0 * std::f64::consts::PI / 180.0, 30.0 * std::f64::consts::PI / 180.0];
/// What a radian of the palm's bend must take away from what is too much.
const WORTH: f64 = 0.3;
/// Bends of the palm that are tried, and halvings of the step between the best one's neighbours.
const BENDS: usize = 64;
const HALVINGS: usize = 24;

/// A knuckle whose turn holds the bend of the palm as well.
struct Knuckle {
    finger: Finger,
    palm: JointAngle,
    /// Twisting of the pose before, and of the last one that was not near a right angle.
    twist: f64,
    steady: f64,
    /// How far off turns may be.
    off: f64,
}

impl Knuckle {
    /// The angles (z, x, y) of a turn.
    fn turns(&self, turn: &UnitQuaternion<f64>) -> [f64; 3] {
        let found = turns_zxy(turn, [0.0; 2], self.twist);
        let cos = found[1].cos().abs();
        if self.off == 0.0 || cos >= NEAR {
            found
        } else {
            held(turn, found[2], self.steady, self.off / cos.max(1e-6))
        }
    }

    /// The bend of the palm and the knuckle's angles (z, x, y) that together make this turn.
    fn shared(&self, turn: &UnitQuaternion<f64>) -> (f64, [f64; 3]) {
        let at = |bent: f64| {
            let back = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -bent);
            self.turns(&(back * turn))
        };
        let straight = at(0.0);
        let far = (straight[1].cos().abs() / NEAR).min(1.0);
        let swing = SWING[0] + (SWING[1] - SWING[0]) * far * far;
        if self.excess(straight, swing) == 0.0 {
            return (0.0, straight);
        }
        let cost = |bent: f64| self.excess(at(bent), swing) + WORTH * bent.abs();
        let AngleLimits { min, max } = limits(self.palm);
        let mut step = (max - min) / BENDS as f64;
        let tried = (0..=BENDS).map(|k| min + step * k as f64).chain([0.0]).map(|bent| (cost(bent), bent));
        let Some(mut best) = tried.min_by(|a, b| a.0.total_cmp(&b.0)) else { return (0.0, straight) };
        for _ in 0..HALVINGS {
            step *= 0.5;
            let (_, middle) = best;
            for bent in [middle - step, middle + step].map(|bent| bent.clamp(min, max)) {
                let found = cost(bent);
                best = if found < best.0 { (found, bent) } else { best };
            }
        }
        (best.1, at(best.1))
    }

    /// By how much angles are beyond what is let pass, radians.
    fn excess(&self, [z, x, y]: [f64; 3], swing: f64) -> f64 {
        let beyond = |value: f64, AngleLimits { min, max }: AngleLimits, slack: f64| {
            (value - max - slack).max(min - slack - value).max(0.0)
        };
        let abduction = if is_radial(self.finger) { -z } else { z };
        beyond(x, limits(self.finger.base_flexion()), ROUNDED)
            + beyond(abduction, limits(self.finger.abduction()), SWING[0])
            + beyond(y, limits(self.finger.twisting()), SWING[0]).max(wrap(y - self.steady).abs() - swing)
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
    held(q, y, y_near, ROUNDED / cos_x.max(ROUNDED * 1e-2))
}

/// Angles (z, x, y) of a rotation whose y is as near to another one as it is open, radians.
fn held(q: &UnitQuaternion<f64>, y: f64, y_near: f64, open: f64) -> [f64; 3] {
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

    /// A palm of other proportions turns all knuckles by a little.
    #[test]
    fn what_is_off_by_a_little_does_not_twist_knuckles_at_right_angles() {
        let skeleton = Skeleton::new(&Morphology::default(), Side::Right);
        let mut reader = PosesFromTurns::new(Side::Right).off_by(0.5f64.to_radians());
        let palm = UnitQuaternion::from_euler_angles(0.0, 0.0015, 0.001);
        for k in 0..=100 {
            let bent = HandPose::neutral(Side::Right).with_degrees(JointAngle::Middle1Flexion, f64::from(k));
            let frames = skeleton.local_frames(&bent.angles);
            let pose = reader.pose(|joint| match joint.parent() {
                Some(Joint::MiddleMetacarpal) => palm * frames.get(joint).rotation,
                Some(above) => frames.get(above).rotation.inverse() * frames.get(joint).rotation,
                None => frames.get(joint).rotation,
            });
            for angle in
                [JointAngle::Middle1Flexion, JointAngle::Middle1Abduction, JointAngle::Middle1Twisting]
            {
                let off = (pose.angle(angle) - bent.angle(angle)).to_degrees();
                assert!(off.abs() < 0.5, "{} of {k}°: {off}°", angle.name());
            }
        }
    }

    /// A hand of a file that tells nothing of the bones in its palm.
    fn palmless(reader: &mut PosesFromTurns, frames: &crate::HandFrames) -> HandPose {
        let at = |joint: Joint| {
            let finger = Finger::LONG.into_iter().any(|finger| Joint::of(finger)[0] == joint);
            frames.get(if finger { Joint::Wrist } else { joint }).rotation
        };
        reader.pose(|joint| at(joint.parent().unwrap_or(joint)).inverse() * at(joint))
    }

    fn off(frames: &crate::HandFrames, found: &crate::HandFrames) -> f64 {
        let inner = Finger::LONG.map(|finger| Joint::of(finger)[0]);
        let joints = Joint::ALL.into_iter().filter(|joint| !inner.contains(joint));
        joints.map(|j| frames.get(j).rotation.angle_to(&found.get(j).rotation)).fold(0.0, f64::max)
    }

    proptest! {
        /// Fingers turn as told, by angles that hands have, where those of the hand itself were some.
        #[test]
        fn palms_that_are_not_told_bend_as_hands_do(angles in angles(), before in angles(), left: bool) {
            let side = if left { Side::Left } else { Side::Right };
            let skeleton = Skeleton::new(&Morphology::default(), side);
            let mut reader = PosesFromTurns::new(side).without_palms(|_| true);
            let untwisted = |angles: JointAngles| {
                let mut pose = HandPose { angles, ..HandPose::neutral(side) };
                Finger::LONG.into_iter().for_each(|finger| pose.set(finger.twisting(), 0.0));
                crate::Domain::full().project_pose(&pose).angles
            };
            let (angles, before) = (untwisted(angles), untwisted(before));
            for k in 0..=50 {
                let angles = std::array::from_fn(|a| before[a] + f64::from(k) / 50.0 * (angles[a] - before[a]));
                let frames = skeleton.local_frames(&angles);
                let pose = palmless(&mut reader, &frames);
                prop_assert!(off(&frames, &skeleton.local_frames(&pose.angles)) < 1e-5);
                for finger in Finger::LONG {
                    for (angle, slack) in [
                        (finger.base_flexion(), 1e-5), (finger.palm_flexion().unwrap(), 1e-9),
                        (finger.abduction(), 0.2), (finger.twisting(), 0.2),
                    ] {
                        let (limits, found) = (limits(angle), pose.angle(angle));
                        let inside = limits.min - slack <= found && found <= limits.max + slack;
                        prop_assert!(inside, "{angle:?} {:.1}°", found.to_degrees());
                    }
                }
            }
        }

        /// Palms that stay at rest are read so, over the whole domain of the knuckles.
        #[test]
        fn palms_that_rest_stay_at_rest(angles in angles(), before in angles()) {
            let skeleton = Skeleton::new(&Morphology::default(), Side::Right);
            let mut readers = [PosesFromTurns::new(Side::Right), PosesFromTurns::new(Side::Right).without_palms(|_| true)];
            let twists = Finger::LONG.map(|finger| (finger, before[finger.twisting().index()] / 6.0));
            for k in 0..=20 {
                let mut pose = HandPose::neutral(Side::Right);
                pose.angles = std::array::from_fn(|a| before[a] + f64::from(k) / 20.0 * (angles[a] - before[a]));
                for (finger, twist) in twists {
                    pose.set(finger.twisting(), twist);
                    finger.palm_flexion().into_iter().for_each(|palm| pose.set(palm, 0.0));
                }
                let frames = skeleton.local_frames(&pose.angles);
                let [told, found] = readers.each_mut().map(|reader| palmless(reader, &frames));
                prop_assert_eq!(told.angles, found.angles);
            }
        }
    }

    /// A little finger that closes with its palm: by the knuckle's turn alone it is abducted by 72° on the way.
    #[test]
    fn a_closing_finger_keeps_its_angles() {
        let skeleton = Skeleton::new(&Morphology::default(), Side::Left);
        let mut reader = PosesFromTurns::new(Side::Left).without_palms(|_| true);
        let mut before: Option<HandPose> = None;
        for k in 0..=200 {
            let t = f64::from(k) / 200.0;
            let pose = HandPose::neutral(Side::Left)
                .with_degrees(JointAngle::Pinky0Flexion, 3.0 + 23.0 * t)
                .with_degrees(JointAngle::Pinky1Flexion, 12.0 + 68.0 * t)
                .with_degrees(JointAngle::Pinky1Abduction, 15.0 * (1.0 - t));
            let frames = skeleton.local_frames(&pose.angles);
            let found = palmless(&mut reader, &frames);
            assert!(off(&frames, &skeleton.local_frames(&found.angles)) < 1e-5);
            let degrees = |pose: &HandPose, angle| pose.angle(angle).to_degrees();
            assert!((-5.0..21.0).contains(&degrees(&found, JointAngle::Pinky1Abduction)), "{t}");
            assert!(degrees(&found, JointAngle::Pinky1Twisting).abs() < 15.0, "{t}");
            for angle in JointAngle::ALL {
                let step = before.as_ref().map_or(0.0, |b| degrees(&found, angle) - degrees(b, angle));
                assert!(step.abs() < 25.0, "{angle:?} {t} {step}");
            }
            before = Some(found);
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
