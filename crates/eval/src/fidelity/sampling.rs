//! What it costs to put a motion of uneven times on the even ticks of a stream.

use super::compare::{CompareOptions, HandDifference, compare};
use handcast_codec::{on_ticks, poses_keep};
use handcast_hand::PoseClip;

/// How far a motion is off, hand by hand, when it is interpolated at ticks of `rate` frames per second and back at its own
/// instants; nothing where its poses stay as they are ([`poses_keep`]).
pub fn sampling(clip: &PoseClip, rate: f64) -> Vec<HandDifference> {
    if poses_keep(clip, rate) {
        return Vec::new();
    }
    let options = CompareOptions { keyed: [false, true], reference: true, ..CompareOptions::default() };
    compare(clip, &on_ticks(clip, rate, 0.0), &options).hands
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fidelity::{Seam, round_trip};
    use handcast_codec::mapping::Profile;
    use handcast_fba::plan::PlanOptions;
    use handcast_hand::{HandPose, JointAngle, MAX_GAP, PoseHeader, Side, TimedPose};

    fn shaking(time: impl Fn(usize) -> f64) -> PoseClip {
        let pose = |i: usize| {
            let degrees = if i.is_multiple_of(2) { 10.0 } else { 20.0 };
            let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index2Flexion, degrees);
            TimedPose::new(time(i), pose)
        };
        let header = PoseHeader::one(Side::Right, None, Some(30.0));
        PoseClip { header, frames: (0..100).map(pose).collect() }
    }

    #[test]
    fn only_uneven_times_cost_something() {
        assert!(sampling(&shaking(|i| i as f64 / 30.0), 30.0).is_empty());
        // Frames that a camera dropped.
        assert!(sampling(&shaking(|i| (i + i / 40) as f64 / 30.0), 30.0).is_empty());
        // A clock of 29.97 on ticks of 30.
        assert!(sampling(&shaking(|i| i as f64 / 29.97), 30.0).is_empty());
        let uneven = sampling(&shaking(|i| (i as f64 + 0.4 * (i % 3) as f64) / 30.0), 30.0);
        let worst = uneven[0].worst().unwrap();
        assert_eq!(worst.joint, "index2_flexion");
        assert!((2.0..10.0).contains(&worst.max.value), "{}", worst.max.value);
    }

    #[test]
    fn promises_are_kept_where_frames_were_dropped_and_a_hand_came_late() {
        let mut clip = shaking(|i| (i + i / 9) as f64 / 30.0);
        let trip = |clip: &PoseClip| {
            round_trip(clip, Profile::Hand, &PlanOptions::default(), MAX_GAP).unwrap().seams
        };
        let named = |seams: &[Seam]| seams.iter().map(|seam| (seam.name, seam.kept)).collect::<Vec<_>>();
        let seams = trip(&clip);
        assert!(named(&seams).iter().all(|(name, kept)| *name != "sampling" && *kept), "{seams:?}");
        clip.frames[..60].iter_mut().for_each(|pose| pose.valid = false);
        let seams = trip(&clip);
        assert!(named(&seams).iter().all(|(_, kept)| *kept), "{seams:?}");
        // Clocks of another beat are told of.
        assert_eq!(named(&trip(&shaking(|i| i as f64 / 25.0)))[0].0, "sampling");
    }
}
