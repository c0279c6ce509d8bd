//! Whether decoded poses are those of a hand: what damaged values betray themselves by.

use handcast_fba::PlaneKind;
use handcast_hand::{HandPose, JointAngle, limits};

/// How far a joint may be beyond its limits, radians: recordings, and coarse quantisers, have some of it.
const BEYOND: f64 = 0.52;
/// Farthest a wrist moves, metres per second, and what is always allowed for.
const WRIST_SPEED: f64 = 4.5;
const WRIST_STEP: f64 = 0.03;
/// Fastest a hand turns, radians per second, and what is always allowed for.
const TURN_SPEED: f64 = 30.0;
const TURN_STEP: f64 = 0.2;

/// Whether `poses`, at `time` seconds, can be those of hands that had the ones of `before`, if they are known. What an
/// I plane says does not build on what was before.
pub(crate) fn is_plausible(
    before: Option<(f64, &[HandPose])>,
    time: f64,
    poses: &[HandPose],
    kind: PlaneKind,
) -> bool {
    let before = before.filter(|_| kind == PlaneKind::Predicted);
    poses.iter().all(|pose| {
        let old = before.and_then(|(at, old)| Some((at, old.iter().find(|other| other.side == pose.side)?)));
        is_a_hand(pose) && old.is_none_or(|(at, old)| follows(old, pose, time - at))
    })
}

/// Whether all joint angles are within their limits, give or take.
fn is_a_hand(pose: &HandPose) -> bool {
    JointAngle::ALL.into_iter().all(|angle| {
        let (value, limits) = (pose.angle(angle), limits(angle));
        (limits.min - BEYOND..=limits.max + BEYOND).contains(&value)
    })
}

/// Whether a hand can get from one pose to the other within so many seconds.
fn follows(before: &HandPose, after: &HandPose, seconds: f64) -> bool {
    let moved = (after.translation - before.translation).norm();
    let turned = before.rotation.angle_to(&after.rotation);
    moved <= WRIST_STEP + WRIST_SPEED * seconds && turned <= TURN_STEP + TURN_SPEED * seconds
}
