//! Axes of the joint nodes.

use nalgebra::{UnitQuaternion, Vector3};

use handcast_hand::turns::ours_from_webxr;
use handcast_hand::{HandFrames, Joint, JointAngle, Morphology, Side, Skeleton};

/// Which way the axes of the joint nodes lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum NodeAxes {
    /// +Y along the bone to the next joint, +X the axis it bends about, positive when it closes: what Blender's importer takes
    /// for the direction of a bone.
    #[default]
    Bones,
    /// Those of WebXR: −Z towards the fingertip, +Y out of the back of the hand. What a page expects that puts the joints of a
    /// headset on these nodes.
    WebXr,
}

impl NodeAxes {
    /// What files call it.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Bones => "bones",
            Self::WebXr => "webxr",
        }
    }

    /// The other way; files that say nothing have WebXR's.
    pub(super) fn of_name(name: Option<&str>) -> Option<Self> {
        [Self::Bones, Self::WebXr].into_iter().find(|axes| axes.name() == name.unwrap_or("webxr"))
    }

    /// How the node of each joint is turned in the joint's frame ([`HandFrames`]), in the order of [`Joint::ALL`]. Only the
    /// metacarpals of the long fingers depend on the person: their frames are those of the palm.
    pub(super) fn turns(self, morphology: &Morphology, side: Side) -> [UnitQuaternion<f64>; Joint::COUNT] {
        let rest = Skeleton::new(morphology, side).local_frames(&[0.0; JointAngle::COUNT]);
        let axes = match self {
            Self::WebXr => ours_from_webxr(),
            Self::Bones => UnitQuaternion::identity(),
        };
        Joint::ALL.map(|joint| along_the_bone(joint, &rest) * axes)
    }
}

/// What turns +Y of a joint's frame to the next joint of its finger.
fn along_the_bone(joint: Joint, rest: &HandFrames) -> UnitQuaternion<f64> {
    let mut children = Joint::ALL.into_iter().filter(|other| other.parent() == Some(joint));
    // Several hang on the wrist, none on a tip.
    let (Some(next), None) = (children.next(), children.next()) else { return UnitQuaternion::identity() };
    let bone = rest.get(joint).inverse_transform_point(&rest.position(next)).coords;
    UnitQuaternion::rotation_between(&Vector3::y(), &bone).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_axis_is_the_bone() {
        let cases = [(NodeAxes::Bones, Vector3::y()), (NodeAxes::WebXr, -Vector3::z())];
        for (side, (axes, axis)) in
            [Side::Left, Side::Right].into_iter().flat_map(|side| cases.map(|case| (side, case)))
        {
            let sizes = Morphology::average(0.18);
            let turns = axes.turns(&sizes, side);
            let mut angles = [0.0; JointAngle::COUNT];
            for (k, angle) in angles.iter_mut().enumerate() {
                *angle = 0.2 + 0.01 * k as f64;
            }
            let frames = Skeleton::new(&sizes, side).local_frames(&angles);
            let mut bones = 0;
            for joint in Joint::ALL {
                let Some(above) = joint.parent().filter(|&above| above != Joint::Wrist) else { continue };
                let bone = frames.position(joint) - frames.position(above);
                let along = frames.get(above).rotation * turns[above.index()] * axis;
                assert!(along.angle(&bone) < 1e-6, "{axes:?} {}", above.webxr_name());
                bones += 1;
            }
            assert_eq!(bones, 19);
        }
    }

    #[test]
    fn names_tell_them_apart() {
        for axes in [NodeAxes::Bones, NodeAxes::WebXr] {
            assert_eq!(NodeAxes::of_name(Some(axes.name())), Some(axes));
        }
        assert_eq!(NodeAxes::of_name(None), Some(NodeAxes::WebXr));
        assert_eq!(NodeAxes::of_name(Some("up")), None);
    }
}
