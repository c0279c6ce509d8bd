//! One hand as a page holds it: its sizes, and what it does on the page's instants.

use serde::Serialize;

use super::pack::{Part, Parts, short};
use handcast_hand::sizes::numbers;
use handcast_hand::{Joint, JointAngle, Morphology, PoseClip, Side, Skeleton, TimedPose};

/// A hand in the page's JSON; parts are little-endian numbers, T instants, 25 joints.
#[derive(Debug, Serialize)]
pub(super) struct PageHand {
    side: Side,
    /// `f64`: [`handcast_hand::sizes::numbers`], of which the page makes the surface.
    sizes: Part,
    /// T × 25 × 4 shorts: rotation of each joint against its parent (x, y, z, w); of the wrist in the world.
    rotations: Part,
    /// T × 3 `f32`: the wrist, metres.
    wrist: Part,
    /// T bytes: 1 where the pose is known, 0 where it is held or guessed.
    valid: Part,
    /// T × 29 shorts: joint angles, hundredths of a degree.
    angles: Part,
}

/// The instants of a clip: all times at which any hand has a pose, in order.
pub(super) fn instants(clip: &PoseClip) -> Vec<f64> {
    let mut times: Vec<f64> = clip.frames.iter().map(|f| f.time).collect();
    times.sort_by(f64::total_cmp);
    times.dedup_by(|later, before| *later - *before < 1e-6);
    times
}

/// The pose of a hand at each of `times`: the last one there was to go by, as streams have it, or the first; and whether it counts.
fn on_instants<'a>(track: &[&'a TimedPose], times: &[f64]) -> Vec<(&'a TimedPose, bool)> {
    let ends = track.first().zip(track.last());
    let mut at = 0;
    let mut held = track.iter().find(|pose| pose.is_shown()).or(track.first());
    times
        .iter()
        .filter_map(|&time| {
            while at + 1 < track.len() && track[at + 1].time < time + 1e-6 {
                at += 1;
                held = track.get(at).filter(|pose| pose.is_shown()).or(held);
            }
            let inside = ends.is_some_and(|(a, b)| time > a.time - 1e-6 && time < b.time + 1e-6);
            Some((*held?, track.get(at)?.valid && inside))
        })
        .collect()
}

impl PageHand {
    /// The hand of `side` in `clip`, whose poses are laid on `times`; its numbers go into `parts`.
    pub(super) fn new(
        clip: &PoseClip,
        side: Side,
        morphology: &Morphology,
        times: &[f64],
        parts: &mut Parts,
    ) -> Self {
        let track: Vec<&TimedPose> = clip.of(side).collect();
        let poses = on_instants(&track, times);
        let skeleton = Skeleton::new(morphology, side);
        let mut rotations: Vec<i16> = Vec::with_capacity(poses.len() * 100);
        let mut wrist: Vec<f32> = Vec::with_capacity(poses.len() * 3);
        for (timed, _) in &poses {
            let frames = skeleton.frames(&timed.pose);
            let quaternions = frames.in_parents().map(|f| f.rotation.coords);
            rotations.extend(quaternions.iter().flatten().map(|&v| short(v)));
            wrist.extend(frames.position(Joint::Wrist).coords.cast::<f32>().iter());
        }
        let hundredths = |radians: f64| (radians.to_degrees() * 100.0).round() as i16;
        let angles = poses.iter().flat_map(|(timed, _)| timed.pose.angles).map(hundredths);
        Self {
            side,
            sizes: parts.numbers(numbers(morphology), f64::to_le_bytes),
            rotations: parts.numbers(rotations, i16::to_le_bytes),
            wrist: parts.numbers(wrist, f32::to_le_bytes),
            valid: parts.numbers(poses.iter().map(|(_, valid)| u8::from(*valid)), u8::to_le_bytes),
            angles: parts.numbers(angles, i16::to_le_bytes),
        }
    }
}

/// The 29 joint angles: finger, name, and words for people.
pub(super) fn angle_names() -> Vec<serde_json::Value> {
    JointAngle::ALL
        .map(|angle| {
            let name = angle.name();
            let (place, what) = name.split_once('_').unwrap_or((name, ""));
            let (finger, number) = place.split_at(place.len() - 1);
            let joint = match (finger, number) {
                ("thumb", "1") => "CMC",
                ("thumb", "2") => "MCP",
                ("thumb", "3") => "IP",
                (_, "0") => "palm",
                (_, "1") => "MCP",
                (_, "2") => "PIP",
                _ => "DIP",
            };
            serde_json::json!({ "name": name, "finger": finger, "label": format!("{joint} {what}") })
        })
        .to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{Finger, HandMesh, HandPose, PackedHand};
    use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

    fn clip(side: Side, frames: usize) -> PoseClip {
        let mut clip = PoseClip::default();
        for i in 0..frames {
            let t = i as f64 / 25.0;
            let mut pose = HandPose::neutral(side);
            for (k, finger) in Finger::ALL.into_iter().enumerate() {
                pose.set(finger.base_flexion(), 0.5 * (t + k as f64).sin());
                pose.set(finger.middle_flexion(), 0.8 + 0.5 * (2.0 * t).sin());
                pose.set(finger.abduction(), 0.2 * t.cos());
            }
            pose.set(JointAngle::Pinky0Flexion, 0.1);
            pose.rotation = UnitQuaternion::from_euler_angles(t, 2.0 * t, 0.5);
            pose.translation = Vector3::new(0.1 * t, -0.1, -0.6);
            clip.frames.push(TimedPose::new(t, pose));
        }
        clip
    }

    fn floats(bytes: &[u8]) -> Vec<f64> {
        bytes.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect()
    }

    fn shorts(bytes: &[u8]) -> Vec<f64> {
        bytes.as_chunks::<2>().0.iter().map(|b| f64::from(i16::from_le_bytes(*b))).collect()
    }

    /// What the page does with the numbers, done here, ends where forward kinematics does.
    #[test]
    fn the_page_finds_every_joint_again() {
        for side in [Side::Left, Side::Right] {
            let (clip, morphology) = (clip(side, 40), Morphology::average(0.18));
            let times = instants(&clip);
            let mut parts = Parts::default();
            let hand = PageHand::new(&clip, side, &morphology, &times, &mut parts);
            let skeleton = Skeleton::new(&morphology, side);
            // What the page makes of the sizes.
            let packed = PackedHand::new(&HandMesh::generate(&morphology, side));
            let offsets: Vec<f64> = packed.offsets.as_flattened().iter().map(|&v| f64::from(v)).collect();
            let wrist = floats(parts.of(&hand.wrist));
            let rotations = shorts(parts.of(&hand.rotations));
            for (i, timed) in clip.frames.iter().enumerate() {
                let truth = skeleton.frames(&timed.pose);
                let mut world: Vec<Isometry3<f64>> = Vec::new();
                for (j, &parent) in packed.parents.iter().enumerate() {
                    let q = &rotations[(i * 25 + j) * 4..][..4];
                    let turn = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[0], q[1], q[2]));
                    let place = if parent < 0 { &wrist[i * 3..][..3] } else { &offsets[j * 3..][..3] };
                    let frame = Isometry3::from_parts(Translation3::new(place[0], place[1], place[2]), turn);
                    let above = usize::try_from(parent).map_or(Isometry3::identity(), |p| world[p]);
                    world.push(above * frame);
                    let off = world[j].translation.vector - truth.0[j].translation.vector;
                    assert!(off.norm() < 3e-5, "{side:?} {i} {j}: {off}");
                    assert!(world[j].rotation.angle_to(&truth.0[j].rotation) < 4e-4);
                }
            }
            let angles = shorts(parts.of(&hand.angles));
            let bend = JointAngle::Index2Flexion;
            let place = JointAngle::ALL.iter().position(|&a| a == bend).unwrap();
            let told = angles[7 * 29 + place] / 100.0;
            assert!((told - clip.frames[7].pose.angle(bend).to_degrees()).abs() < 0.006);
        }
    }

    #[test]
    fn hands_with_times_of_their_own_share_the_instants() {
        let mut both = clip(Side::Right, 3);
        both.frames
            .extend(clip(Side::Left, 2).frames.into_iter().map(|f| TimedPose { time: f.time + 0.02, ..f }));
        let times = instants(&both);
        assert_eq!(times.len(), 5);
        let left: Vec<&TimedPose> = both.of(Side::Left).collect();
        let seen: Vec<bool> = on_instants(&left, &times).into_iter().map(|(_, valid)| valid).collect();
        assert_eq!(seen, [false, true, true, true, false]);
    }

    #[test]
    fn where_a_hand_is_lost_the_last_pose_is_held() {
        let mut lost = clip(Side::Right, 6);
        for i in [0, 3, 4] {
            lost.frames[i] = TimedPose {
                valid: false,
                ..TimedPose::new(lost.frames[i].time, HandPose::neutral(Side::Right))
            };
        }
        let track: Vec<&TimedPose> = lost.of(Side::Right).collect();
        let held: Vec<(f64, bool)> = on_instants(&track, &instants(&lost))
            .into_iter()
            .map(|(pose, valid)| ((pose.time * 25.0).round(), valid))
            .collect();
        assert_eq!(held, [(1.0, false), (1.0, true), (2.0, true), (2.0, false), (2.0, false), (5.0, true)]);
    }

    #[test]
    fn angles_are_named_for_people() {
        let names = angle_names();
        assert_eq!(names.len(), 29);
        assert!(names.iter().any(|n| n["label"] == "PIP flexion" && n["finger"] == "pinky"));
        assert!(names.iter().any(|n| n["label"] == "CMC abduction" && n["finger"] == "thumb"));
    }
}
