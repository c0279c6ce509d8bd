//! Which fingers a pose shows stretched out, as one counts on them.

use super::{Finger, HandPose, Joint, Morphology, Skeleton};

/// A long finger counts as stretched out while its MCP and PIP joints together bend less than this, degrees:
/// less than half of what they bend in a fist. A joint bent backwards does not make up for the other.
pub const MOST_BENT_DEG: f64 = 80.0;

/// The thumb counts as stretched out when its tip is more than so many times as far from the base of the little
/// finger (its MCP joint) as the thumb's own MCP joint is: it then stands away from the palm. Beside the index
/// finger or across the palm it does not, however straight it is.
pub const THUMB_OUT: f64 = 1.2;

/// Whether each finger of a pose is stretched out, in the order of [`Finger::ALL`], by [`MOST_BENT_DEG`] and
/// [`THUMB_OUT`]; distances are those of a hand of mean sizes, so that only the joint angles decide.
///
/// ```
/// use handcast::hand::{HandPose, JointAngle, Side, extended_fingers};
///
/// let point = HandPose::neutral(Side::Left).with_degrees(JointAngle::Middle2Flexion, 100.0);
/// assert_eq!(extended_fingers(&point), [false, true, false, true, true]);
/// ```
pub fn extended_fingers(pose: &HandPose) -> [bool; 5] {
    Finger::ALL.map(|finger| match finger {
        Finger::Thumb => thumb_out(pose),
        _ => {
            let bend =
                pose.angle(finger.base_flexion()).max(0.0) + pose.angle(finger.middle_flexion()).max(0.0);
            bend.to_degrees() < MOST_BENT_DEG
        }
    })
}

/// How many fingers of a pose are stretched out, 0 to 5: see [`extended_fingers`].
pub fn count_extended(pose: &HandPose) -> usize {
    extended_fingers(pose).into_iter().filter(|out| *out).count()
}

fn thumb_out(pose: &HandPose) -> bool {
    let frames = Skeleton::new(&Morphology::default(), pose.side).local_frames(&pose.angles);
    let little = frames.position(Joint::base(Finger::Pinky));
    let from_little = |joint| (frames.position(joint) - little).norm();
    from_little(Joint::tip(Finger::Thumb)) > THUMB_OUT * from_little(Joint::ThumbProximal)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Side;
    use crate::hand::shapes::ShapeLibrary;

    #[test]
    fn named_shapes_show_what_their_names_say() {
        let library = ShapeLibrary::builtin().unwrap();
        let expected = [
            ("fist", "00000"),
            ("asl:S", "00000"),
            ("asl:A", "00000"),
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
            // The thumb lies along the index finger.
            ("flat", "01111"),
        ];
        for (name, fingers) in expected {
            for side in [Side::Left, Side::Right] {
                let pose = library.get(name).unwrap().pose(side);
                let shown = extended_fingers(&pose).map(|out| if out { '1' } else { '0' });
                assert_eq!(shown.iter().collect::<String>(), fingers, "{name}");
                assert_eq!(count_extended(&pose), fingers.matches('1').count());
            }
        }
    }
}
