//! BAPs that need not be sent because the hand model gives them: an end joint bends with its middle joint
//! (constraint (2) of `spec/hand-model.md`), the thumb's second joint with its first (constraint (5)).
//!
//! No field of the syntax says that a value is to be derived. The rule is: a stream that sends the driving
//! angle of a finger but not the driven one leaves it to the hand model (`spec/NOTES.md`). Our encoder
//! sends what is driven along with what drives it unless told to leave it out.

use super::mapping::{angle_bap, angle_sign};
use super::{Bap, BapFrame, BapMask};
use handcast_hand::{DIP_FROM_PIP, Finger, JointAngle, Side, thumb_mcp_from_cmc};

/// Units of an angle BAP per radian.
const PER_RADIAN: f64 = 1e5;

/// Angles that drive others, with those that they drive.
fn pairs() -> impl Iterator<Item = (JointAngle, JointAngle)> {
    let fingers = Finger::LONG.into_iter().map(|finger| (finger.middle_flexion(), finger.end_flexion()));
    fingers.chain([(JointAngle::Thumb1Flexion, JointAngle::Thumb2Flexion)])
}

/// BAPs that drive others, with those that they drive.
fn ties() -> impl Iterator<Item = (Side, [JointAngle; 2], [Bap; 2])> {
    [Side::Left, Side::Right]
        .into_iter()
        .flat_map(|side| pairs().map(move |(a, b)| (side, [a, b], [angle_bap(side, a), angle_bap(side, b)])))
}

/// The BAPs that other BAPs can drive.
pub fn driven() -> BapMask {
    ties().map(|(_, _, [_, driven])| driven).collect()
}

/// The BAPs that a decoder derives when just those of `mask` are sent.
///
/// ```
/// use handcast_codec::ties::left_to_model;
/// use crate::bap::{Bap, BapMask};
///
/// let sent: BapMask = [Bap::from_name("r_index2_flexion").unwrap()].into_iter().collect();
/// let derived: Vec<Bap> = left_to_model(&sent).iter().collect();
/// assert_eq!(derived, [Bap::from_name("r_index3_flexion").unwrap()]);
/// ```
pub fn left_to_model(mask: &BapMask) -> BapMask {
    ties()
        .filter(|(_, _, [driver, driven])| mask.contains(*driver) && !mask.contains(*driven))
        .map(|(_, _, [_, driven])| driven)
        .collect()
}

/// The BAPs of `mask` driven by others of `mask` that `keep` holds: to be sent with them, lest they be
/// derived.
pub fn companions(mask: &BapMask, keep: &BapMask) -> BapMask {
    ties()
        .filter(|(_, _, [driver, driven])| keep.contains(*driver) && mask.contains(*driven))
        .map(|(_, _, [_, driven])| driven)
        .collect()
}

/// Adds to a frame the BAPs that are left to the hand model.
pub fn fill_in(frame: &mut BapFrame) {
    let mask = frame.mask;
    for (side, [a, b], [driver, driven]) in ties() {
        if mask.contains(driver) && !mask.contains(driven) {
            let angle = angle_sign(side, a) * f64::from(frame.value(driver)) / PER_RADIAN;
            let derived =
                if a == JointAngle::Thumb1Flexion { thumb_mcp_from_cmc(angle) } else { DIP_FROM_PIP * angle };
            frame.set(driven, (angle_sign(side, b) * derived * PER_RADIAN).round() as i32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_codec::mapping::{PoseMapper, Profile, pose_from_frame};
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
            sent.mask = whole.mask.difference(&driven());
            assert_eq!(whole.mask.len() - sent.mask.len(), 5);
            let values = sent.mask.iter().map(|bap| (bap, whole.value(bap)));
            let mut frame: BapFrame = values.collect();
            fill_in(&mut frame);
            assert_eq!(frame.mask, whole.mask);
            let back = pose_from_frame(&frame, side, Profile::Hand).unwrap();
            for angle in JointAngle::ALL {
                assert!((back.angle(angle) - pose.angle(angle)).abs() < 3e-5, "{side:?} {}", angle.name());
            }
        }
    }
}
