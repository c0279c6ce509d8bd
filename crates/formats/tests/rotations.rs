//! Rotations of joints that files say are those of the model, over all that a hand can do.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::f64::consts::FRAC_PI_2;

use handcast_formats::motion::{Format, Motion, WriteOptions};
use handcast_hand::{
    ClipHand, HandFrames, HandPose, Joint, JointAngle, JointAngles, Morphology, PoseClip, PoseHeader, Side,
    Skeleton, TimedPose, limits,
};
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

/// Farthest that a rotation of a joint may be off, radians: a hundredth of a degree.
const ALLOWED: f64 = 1.745e-4;

/// The formats that say rotations, or the angles behind them. BAPs say the wrist in tenths of a degree.
const FORMATS: [&str; 6] = ["glb", "bvh", "webxr", "jsonl", "json", "csv"];

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

/// The wrist turned anyhow, often by right angles.
fn wrist() -> impl Strategy<Value = UnitQuaternion<f64>> {
    let part = prop_oneof![Just(0.0), Just(FRAC_PI_2), -3.1..3.1f64];
    [part.clone(), part.clone(), part].prop_map(|[x, y, z]| {
        let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::from_scaled_axis(axis * angle);
        about(Vector3::z(), z) * about(Vector3::x(), x) * about(Vector3::y(), y)
    })
}

fn frames(pose: &HandPose) -> HandFrames {
    Skeleton::new(&Morphology::default(), pose.side).frames(pose)
}

/// Without the surface, which takes a second to make: no rotation is in it.
fn bare() -> WriteOptions {
    let mut options = WriteOptions::default();
    options.gltf.animation_only = true;
    options
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_format_keeps_every_rotation(
        poses in prop::collection::vec((angles(), wrist(), angles(), wrist()), 2..5),
    ) {
        let mut clip = PoseClip { header: PoseHeader { rate: Some(25.0), ..PoseHeader::default() }, frames: vec![] };
        for side in [Side::Left, Side::Right] {
            clip.header.hands.push(ClipHand { side, morphology: None });
            for (n, (left, left_wrist, right, right_wrist)) in poses.iter().enumerate() {
                let (angles, rotation) = if side == Side::Left { (left, left_wrist) } else { (right, right_wrist) };
                let pose = HandPose { angles: *angles, rotation: *rotation, ..HandPose::neutral(side) };
                clip.frames.push(TimedPose::new(n as f64 / 25.0, pose));
            }
        }
        for id in FORMATS {
            let file = Format::by_id(id).unwrap().write(&clip, &bare()).unwrap();
            let back = Motion::parse("-".as_ref(), &file.bytes).unwrap().clip;
            for side in [Side::Left, Side::Right] {
                prop_assert_eq!(back.of(side).count(), poses.len());
                for (n, (a, b)) in clip.of(side).zip(back.of(side)).enumerate() {
                    let (wanted, found) = (frames(&a.pose), frames(&b.pose));
                    for joint in Joint::ALL {
                        let off = wanted.get(joint).rotation.angle_to(&found.get(joint).rotation);
                        prop_assert!(off < ALLOWED, "{id}, {side:?} {joint:?}, frame {n}: {:.4}°", off.to_degrees());
                    }
                }
            }
        }
    }
}

/// A knuckle that bends through a right angle, abducted and twisted: the angles come back too, and the same from each
/// format.
#[test]
fn angles_run_on_through_a_right_angle() {
    for side in [Side::Left, Side::Right] {
        let mut clip = PoseClip { header: PoseHeader::one(side, None, Some(25.0)), frames: Vec::new() };
        for n in 0..=400 {
            let t = f64::from(n) / 400.0;
            let pose = HandPose::neutral(side)
                .with_degrees(JointAngle::Ring1Flexion, 80.0 + 20.0 * t)
                .with_degrees(JointAngle::Ring1Abduction, 20.0 - 4.0 * t)
                .with_degrees(JointAngle::Ring1Twisting, 12.0 * t + 4.0);
            clip.frames.push(TimedPose::new(f64::from(n) / 25.0, pose));
        }
        let options = if side == Side::Left { bare() } else { WriteOptions::default() };
        for id in FORMATS {
            let file = Format::by_id(id).unwrap().write(&clip, &options).unwrap();
            let back = Motion::parse("-".as_ref(), &file.bytes).unwrap().clip;
            for (a, b) in clip.frames.iter().zip(&back.frames) {
                for angle in [JointAngle::Ring1Flexion, JointAngle::Ring1Abduction, JointAngle::Ring1Twisting]
                {
                    let off = (a.pose.angle(angle) - b.pose.angle(angle)).to_degrees().abs();
                    assert!(off < 0.2, "{id}, {side:?} {angle:?} at {} s: {off:.3}°", a.time);
                }
            }
        }
    }
}
