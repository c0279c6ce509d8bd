//! What the hand model derives: an end joint bends with its middle joint (constraint (2) of
//! `spec/hand-model.md`), the thumb's second joint with its first (constraint (5)).

use std::sync::LazyLock;

use super::mapping::{angle_bap, angle_sign};
use handcast_fba::bap::PER_RADIAN;
use handcast_fba::bap::derive::Tie;
use handcast_hand::{DIP_FROM_PIP, Finger, JointAngle, Side, thumb_mcp_from_cmc};

/// The ties of both hands, left before right; of each hand fingers before thumb.
///
/// ```
/// use handcast_fba::bap::derive::left_to_model;
/// use handcast_fba::bap::{Bap, BapMask};
/// use handcast_codec::ties::hand_ties;
///
/// let sent: BapMask = [Bap::from_name("r_index2_flexion").unwrap()].into_iter().collect();
/// let derived: Vec<Bap> = left_to_model(hand_ties(), &sent).iter().collect();
/// assert_eq!(derived, [Bap::from_name("r_index3_flexion").unwrap()]);
/// ```
pub fn hand_ties() -> &'static [Tie] {
    static TIES: LazyLock<Vec<Tie>> =
        LazyLock::new(|| [Side::Left, Side::Right].into_iter().flat_map(ties_of).collect());
    &TIES
}

fn ties_of(side: Side) -> impl Iterator<Item = Tie> {
    let tie = move |[driver, driven]: [JointAngle; 2], law, firm| Tie {
        driver: angle_bap(side, driver),
        driven: angle_bap(side, driven),
        law,
        firm,
    };
    let thumb = match side {
        Side::Left => |value| derived(value, Side::Left, THUMB, thumb_mcp_from_cmc),
        Side::Right => |value| derived(value, Side::Right, THUMB, thumb_mcp_from_cmc),
    };
    // The bends of all long fingers have the same sign, on both sides.
    let finger = |value| derived(value, Side::Right, INDEX, |pip| DIP_FROM_PIP * pip);
    let fingers = Finger::LONG.map(|finger| [finger.middle_flexion(), finger.end_flexion()]);
    // Thumbs bend as they like: of tracked ones the second joint is 34° RMS off the law.
    fingers.into_iter().map(move |pair| tie(pair, finger, true)).chain([tie(THUMB, thumb, false)])
}

const INDEX: [JointAngle; 2] = [JointAngle::Index2Flexion, JointAngle::Index3Flexion];
const THUMB: [JointAngle; 2] = [JointAngle::Thumb1Flexion, JointAngle::Thumb2Flexion];

/// The BAP value of the second angle from that of the first, by a `law` in radians.
fn derived(value: i32, side: Side, [driver, driven]: [JointAngle; 2], law: fn(f64) -> f64) -> i32 {
    let angle = angle_sign(side, driver) * f64::from(value) / PER_RADIAN;
    (angle_sign(side, driven) * law(angle) * PER_RADIAN).round() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{PoseMapper, Profile, pose_from_frame};
    use handcast_fba::bap::BapFrame;
    use handcast_fba::bap::derive::{driven, fill_in};
    use handcast_hand::{Domain, HandPose};

    /// What is left out of a pose that keeps the constraints comes back as it was.
    #[test]
    fn tied_angles_come_back() {
        for side in [Side::Left, Side::Right] {
            let mut pose = HandPose::neutral(side);
            for (number, angle) in JointAngle::ALL.into_iter().enumerate() {
                pose.set(angle, 0.05 + 0.01 * number as f64);
            }
            pose.angles = Domain::expand(&Domain::reduce(&pose.angles));
            let whole = PoseMapper::new(Profile::Hand).frame(std::slice::from_ref(&pose));
            let mut sent = whole;
            sent.mask = whole.mask.difference(&driven(hand_ties()));
            assert_eq!(whole.mask.len() - sent.mask.len(), 5);
            let values = sent.mask.iter().map(|bap| (bap, whole.value(bap)));
            let mut frame: BapFrame = values.collect();
            fill_in(hand_ties(), &mut frame);
            assert_eq!(frame.mask, whole.mask);
            let back = pose_from_frame(&frame, side, Profile::Hand).unwrap();
            for angle in JointAngle::ALL {
                assert!((back.angle(angle) - pose.angle(angle)).abs() < 3e-5, "{side:?} {}", angle.name());
            }
        }
    }
}
