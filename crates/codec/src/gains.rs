//! What an error of each BAP counts for: by how far it moves fingertips.

use std::sync::LazyLock;

use handcast_fba::bap::{BAP_COUNT, Bap, BapFrame, BapMask};
use handcast_fba::encoder::degrees_per_unit;
use handcast_fba::plan::PlanOptions;
use handcast_hand::{Finger, HandPose, Joint, JointAngle, Morphology, Side, Skeleton};
use nalgebra::Point3;

use crate::mapping::{PoseMapper, Profile, anchor_baps, angle_bap, global_baps, hand_mask, pose_from_frame};
use crate::ties::hand_ties;

/// Share of what the squared errors of an angle count for that goes by how far it moves fingertips; the rest is the same
/// for all angles.
const BY_TIPS: f64 = 0.5;
/// What a move of fingertips counts for when the wrist makes it, over what it does when fingers make it: it moves all of
/// them together.
const BY_WRIST: f64 = 0.3;
/// Radians that joints are bent by in the pose of which the gains are taken: a hand at rest.
const BENT: f64 = 0.4;

/// The planner's options for hands: what the hand model derives, what errors count for, which BAPs are anchors, and by which
/// a hand is known to be there ([`sides`](crate::mapping::sides)).
pub fn for_hands(plan: PlanOptions) -> PlanOptions {
    let anchors = [Side::Left, Side::Right].into_iter().flat_map(anchor_baps).collect();
    static LIMBS: LazyLock<[BapMask; 2]> =
        LazyLock::new(|| [Side::Left, Side::Right].map(|side| hand_mask(side, Profile::Hand)));
    PlanOptions { ties: hand_ties(), gains: gains(), anchors, limbs: &*LIMBS, ..plan }
}

/// By BAP index, see [`PlanOptions::gains`]: of the mean hand, so that those of a mean angle are 1.
fn gains() -> &'static [f64] {
    static GAINS: LazyLock<Vec<f64>> = LazyLock::new(|| {
        let mut gains = vec![1.0; BAP_COUNT];
        for side in [Side::Left, Side::Right] {
            let lever = Lever::new(side);
            let angles = JointAngle::ALL.map(|angle| angle_bap(side, angle));
            let square = |bap: &Bap| lever.per_degree(*bap).powi(2);
            let mean = angles.iter().map(square).sum::<f64>() / angles.len() as f64;
            for bap in angles {
                gains[bap.index()] = (1.0 - BY_TIPS + BY_TIPS * square(&bap) / mean).sqrt();
            }
            for bap in global_baps(side) {
                gains[bap.index()] = BY_WRIST * (square(&bap) / mean).sqrt();
            }
        }
        gains
    });
    &GAINS
}

/// How far BAPs move the fingertips of the mean hand.
struct Lever {
    side: Side,
    skeleton: Skeleton,
    frame: BapFrame,
}

impl Lever {
    fn new(side: Side) -> Self {
        let mut pose = HandPose::neutral(side);
        for angle in JointAngle::ALL.into_iter().filter(|angle| angle.name().ends_with("flexion")) {
            pose.set(angle, BENT);
        }
        let frame = PoseMapper::new(Profile::Hand).frame(std::slice::from_ref(&pose));
        Self { side, skeleton: Skeleton::new(&Morphology::default(), side), frame }
    }

    /// Metres, root mean square of all tips, for what counts as a degree of a BAP ([`degrees_per_unit`]).
    fn per_degree(&self, bap: Bap) -> f64 {
        // About a degree.
        let change = (1.0 / degrees_per_unit(bap)).round() as i32;
        let mut moved = self.frame;
        moved.set(bap, moved.value(bap) + change);
        let pairs = self.tips(&self.frame).into_iter().zip(self.tips(&moved));
        let squares: f64 = pairs.map(|(a, b)| (a - b).norm_squared()).sum();
        (squares / Finger::ALL.len() as f64).sqrt() / (f64::from(change) * degrees_per_unit(bap))
    }

    fn tips(&self, frame: &BapFrame) -> [Point3<f64>; 5] {
        let pose = pose_from_frame(frame, self.side, Profile::Hand);
        let frames = self.skeleton.frames(&pose.unwrap_or_else(|| HandPose::neutral(self.side)));
        Finger::ALL.map(|finger| frames.position(Joint::tip(finger)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_more_counts_for_more() {
        let gain = |bap: Bap| gains()[bap.index()];
        for side in [Side::Left, Side::Right] {
            let angle = |angle| gain(angle_bap(side, angle));
            assert!(angle(JointAngle::Index1Flexion) > 1.3 * angle(JointAngle::Index2Flexion));
            assert!(angle(JointAngle::Index2Flexion) > 1.1 * angle(JointAngle::Index3Flexion));
            let squares: f64 = JointAngle::ALL.into_iter().map(|other| angle(other).powi(2)).sum();
            assert!((squares / JointAngle::ALL.len() as f64 - 1.0).abs() < 1e-9);
            let [x, y, z, ..] = global_baps(side).map(gain);
            assert!((x - y).abs() < 1e-9 && (y - z).abs() < 1e-9 && x > 1.0);
        }
        let sides = JointAngle::ALL.map(|angle| {
            let [left, right] = [Side::Left, Side::Right].map(|side| gain(angle_bap(side, angle)));
            (left - right).abs()
        });
        assert!(sides.into_iter().all(|off| off < 1e-3), "{sides:?}");
    }
}
