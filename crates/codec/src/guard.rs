//! Whether decoded poses are those of a hand: what damaged values betray themselves by.

use std::sync::LazyLock;

use handcast_fba::PlaneKind;
use handcast_fba::plan::Leap;
use handcast_hand::{HandPose, JointAngle, Side, limits};

use crate::mapping::{PER_METRE, global_baps, tenths_per_radian};

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

/// Share of what is believed of a P plane from which on an encoder begins an I period: values are rounded, and planes left out.
const BEGINS: f64 = 0.8;

/// What places the hands, and how far it goes in P planes.
pub(crate) fn leaps() -> &'static [Leap] {
    static LEAPS: LazyLock<Vec<Leap>> = LazyLock::new(|| {
        let of = |side| {
            let [x, y, z, a, b, c] = global_baps(side);
            let leap = |baps: [_; 3], unit: f64, still: f64, speed: f64| Leap {
                baps: baps.into_iter().collect(),
                still: BEGINS * unit * still,
                per_second: BEGINS * unit * speed,
            };
            [
                leap([x, y, z], PER_METRE, WRIST_STEP, WRIST_SPEED),
                leap([a, b, c], tenths_per_radian(), TURN_STEP, TURN_SPEED),
            ]
        };
        [Side::Left, Side::Right].into_iter().flat_map(of).collect()
    });
    &LEAPS
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
