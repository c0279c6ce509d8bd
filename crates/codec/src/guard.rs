//! Whether decoded poses are those of a hand: what damaged values betray themselves by.

use handcast_hand::{HandPose, JointAngle, limits};

/// How far a joint may be beyond its limits, or beyond where it has been, radians: recordings, and coarse quantisers,
/// have some of it.
const BEYOND: f64 = 0.52;
/// Farthest a wrist moves, metres per second, and what is always allowed for.
const WRIST_SPEED: f64 = 4.5;
const WRIST_STEP: f64 = 0.03;
/// Fastest a hand turns, radians per second, and what is always allowed for.
const TURN_SPEED: f64 = 30.0;
const TURN_STEP: f64 = 0.2;

/// Where a stream's joint angles are believed: about their limits, and where they have been, for streams of other makers
/// and of landmarks go beyond.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Reach([[f64; 2]; JointAngle::COUNT]);

impl Default for Reach {
    fn default() -> Self {
        Self(JointAngle::ALL.map(limits).map(|limits| [limits.min - BEYOND, limits.max + BEYOND]))
    }
}

impl Reach {
    /// Whether all joint angles are within.
    pub fn holds(&self, poses: &[HandPose]) -> bool {
        let within = |(angle, [least, most]): (JointAngle, [f64; 2]), pose: &HandPose| {
            (least..=most).contains(&pose.angle(angle))
        };
        poses.iter().all(|pose| JointAngle::ALL.into_iter().zip(self.0).all(|range| within(range, pose)))
    }

    /// Takes in that joints have been there.
    pub fn widen(&mut self, poses: &[HandPose]) {
        for pose in poses {
            for (angle, [least, most]) in JointAngle::ALL.into_iter().zip(&mut self.0) {
                let value = pose.angle(angle);
                *least = least.min(value - BEYOND);
                *most = most.max(value + BEYOND);
            }
        }
    }
}

/// Whether hands can get from poses `before` to those `after` within so many seconds.
pub(crate) fn follow(before: &[HandPose], after: &[HandPose], seconds: f64) -> bool {
    after.iter().all(|pose| {
        let old = before.iter().find(|other| other.side == pose.side);
        old.is_none_or(|old| follows(old, pose, seconds))
    })
}

/// Whether a hand can get from one pose to the other within so many seconds.
fn follows(before: &HandPose, after: &HandPose, seconds: f64) -> bool {
    let moved = (after.translation - before.translation).norm();
    let turned = before.rotation.angle_to(&after.rotation);
    moved <= WRIST_STEP + WRIST_SPEED * seconds && turned <= TURN_STEP + TURN_SPEED * seconds
}
