//! Which fingers a hand stretches out, as one counts on them.

use nalgebra::Point3;

use super::landmarks::JointPoints;
use super::{Finger, HandPose, Joint, Morphology, Skeleton};

/// A long finger counts as stretched out when its tip is beyond its MCP joint by more than this share of the
/// finger's length (the sum of its three bones), measured along the line from the wrist to that joint. So a
/// relaxed finger counts, and one that is bent like a hook, or straight but at a right angle to the palm, does not.
pub const LEAST_REACH: f64 = 0.5;

/// The thumb counts as stretched out when its tip is more than so many times as far from the base of the little
/// finger (its MCP joint) as the thumb's own MCP joint is: straight beside the hand or away from it. Bent towards the
/// index finger or across the palm it does not. Of the hand shapes in `hand-shapes.toml` the most relaxed thumb reaches
/// 1.34 (`rest`), the least of those stretched out 1.41 (`flat`); wide of the palm it is 1.5.
pub const THUMB_OUT: f64 = 1.36;

/// Whether each finger of a pose is stretched out, in the order of [`Finger::ALL`], by [`LEAST_REACH`] and
/// [`THUMB_OUT`]; joints are those of a hand of mean sizes, so that only the joint angles decide.
///
/// ```
/// use handcast_hand::{HandPose, JointAngle, Side, extended_fingers};
///
/// let pose = HandPose::neutral(Side::Left).with_degrees(JointAngle::Middle2Flexion, 100.0);
/// assert_eq!(extended_fingers(&pose)[1..], [true, false, true, true]);
/// ```
pub fn extended_fingers(pose: &HandPose) -> [bool; 5] {
    let frames = Skeleton::new(&Morphology::default(), pose.side).local_frames(&pose.angles);
    Finger::ALL.map(|finger| stretched(finger, |joint| Some(frames.position(joint))).unwrap_or(false))
}

/// The same of joints in space, in any unit; `None` where a joint that decides is missing.
pub fn extended_fingers_of(points: &JointPoints) -> [Option<bool>; 5] {
    Finger::ALL.map(|finger| stretched(finger, |joint| points[joint.index()]))
}

/// How many fingers of a pose are stretched out, 0 to 5: see [`extended_fingers`].
pub fn count_extended(pose: &HandPose) -> usize {
    extended_fingers(pose).into_iter().filter(|out| *out).count()
}

/// How many fingers are stretched out where these joints are; `None` where one that decides is missing.
pub fn count_extended_of(points: &JointPoints) -> Option<usize> {
    extended_fingers_of(points).into_iter().try_fold(0, |count, out| Some(count + usize::from(out?)))
}

fn stretched(finger: Finger, at: impl Fn(Joint) -> Option<Point3<f64>>) -> Option<bool> {
    let tip = at(Joint::tip(finger))?;
    if finger == Finger::Thumb {
        let little = at(Joint::base(Finger::Pinky))?;
        return Some((tip - little).norm() > THUMB_OUT * (at(Joint::ThumbProximal)? - little).norm());
    }
    // From the MCP joint to the tip.
    let joints: Option<Vec<_>> = Joint::of(finger)[1..].iter().map(|&joint| at(joint)).collect();
    let joints = joints?;
    let length: f64 = joints.windows(2).map(|bone| (bone[1] - bone[0]).norm()).sum();
    let base = joints.first()?;
    let along = (base - at(Joint::Wrist)?).try_normalize(f64::MIN_POSITIVE)?;
    Some((tip - base).dot(&along) > LEAST_REACH * length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::JointAngle;
    use crate::Side;
    use crate::shapes::ShapeLibrary;

    #[test]
    fn named_shapes_show_what_their_names_say() {
        let library = ShapeLibrary::builtin().unwrap();
        let expected = [
            ("fist", "00000"),
            ("asl:S", "00000"),
            ("rest", "01111"),
            // The thumb lies against the index finger: how far its tip reaches does not tell it from a bent one.
            ("asl:A", "00000"),
            ("flat", "11111"),
            ("asl:0", "00000"),
            ("asl:X", "00000"),
            ("point", "01000"),
            ("asl:1", "01000"),
            ("asl:2", "01100"),
            // The three of American Sign Language has the thumb.
            ("asl:3", "11100"),
            ("asl:W", "01110"),
            ("asl:4", "01111"),
            ("asl:5", "11111"),
            ("spread", "11111"),
            ("asl:7", "01101"),
            ("asl:9", "00111"),
            ("asl:L", "11000"),
            ("asl:Y", "10001"),
            ("asl:10", "10000"),
        ];
        for (name, fingers) in expected {
            for side in [Side::Left, Side::Right] {
                let pose = library.get(name).unwrap().pose(side);
                let shown = extended_fingers(&pose).map(|out| if out { '1' } else { '0' });
                assert_eq!(shown.iter().collect::<String>(), fingers, "{name}");
                assert_eq!(count_extended(&pose), fingers.matches('1').count());
                let frames = Skeleton::new(&Morphology::average(0.2), side).frames(&pose);
                let mut points = Joint::ALL.map(|joint| Some(frames.position(joint)));
                assert_eq!(count_extended_of(&points), Some(fingers.matches('1').count()), "{name}");
                points[Joint::MiddleTip.index()] = None;
                assert_eq!((extended_fingers_of(&points)[2], count_extended_of(&points)), (None, None));
            }
        }
    }

    #[test]
    fn hooks_and_right_angles_are_not_stretched_out() {
        let bent = |mcp: f64, pip: f64| {
            let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, mcp);
            let pose = pose.with_degrees(JointAngle::Index2Flexion, pip);
            extended_fingers(&pose.with_degrees(JointAngle::Index3Flexion, pip / 1.5))[1]
        };
        assert!(bent(0.0, 0.0) && bent(20.0, 30.0) && bent(40.0, 0.0));
        assert!(!bent(90.0, 0.0) && !bent(0.0, 95.0) && !bent(45.0, 45.0));
    }
}
