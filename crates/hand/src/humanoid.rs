//! The hand as bones of a humanoid avatar, turned from the T-pose of VRM.
//!
//! Axes are those of VRM 1.0: right-handed, y up, the avatar faces +z and its left is +x. A person who faces the camera has these
//! axes in the camera frame of [`HandPose`](super::HandPose). In the T-pose fingers point outward, palms down, thumbs forward and
//! outward by 45°: the neutral hand (VRM 1.0, `tpose.md`).

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::{HandFrames, Joint, JointAngle, Morphology, Side, Skeleton};

/// Bones of a hand: the hand itself and three of each finger.
pub const BONES: usize = 16;

/// The joints where the bones begin, hand first, from the thumb outwards.
pub const JOINTS: [Joint; BONES] = [
    Joint::Wrist,
    Joint::ThumbMetacarpal,
    Joint::ThumbProximal,
    Joint::ThumbDistal,
    Joint::IndexProximal,
    Joint::IndexIntermediate,
    Joint::IndexDistal,
    Joint::MiddleProximal,
    Joint::MiddleIntermediate,
    Joint::MiddleDistal,
    Joint::RingProximal,
    Joint::RingIntermediate,
    Joint::RingDistal,
    Joint::PinkyProximal,
    Joint::PinkyIntermediate,
    Joint::PinkyDistal,
];

/// Shares of a person's height (Drillis and Contini 1966).
mod share {
    pub const HAND: f64 = 0.108;
    pub const FOREARM: f64 = 0.146;
    pub const UPPER_ARM: f64 = 0.186;
    pub const SHOULDER: f64 = 0.129;
    pub const SHOULDER_HEIGHT: f64 = 0.818;
    pub const CHIN_HEIGHT: f64 = 0.87;
    pub const HIP: f64 = 0.0955;
    pub const HIP_HEIGHT: f64 = 0.53;
    pub const KNEE_HEIGHT: f64 = 0.285;
    pub const ANKLE_HEIGHT: f64 = 0.039;
}

/// The bone that carries a bone of [`JOINTS`]; `None` for the hand.
pub fn above(bone: usize) -> Option<usize> {
    match bone {
        0 => None,
        first if first % 3 == 1 => Some(0),
        other => Some(other - 1),
    }
}

/// A hand in the T-pose, and poses against it.
#[derive(Clone, Debug)]
pub struct TPose {
    side: Side,
    /// Orientations of the joints in the T-pose.
    rest: [UnitQuaternion<f64>; BONES],
    offsets: [Vector3<f64>; BONES],
}

impl TPose {
    /// The hand of `side` with the sizes of `morphology`.
    pub fn new(morphology: &Morphology, side: Side) -> Self {
        let neutral = Skeleton::new(morphology, side).local_frames(&[0.0; JointAngle::COUNT]);
        let pose = Self::hand(side);
        let forearm = share::FOREARM / share::HAND * morphology.hand_length;
        let offset = |bone: usize| match above(bone) {
            None => Vector3::new(outward(side) * forearm, 0.0, 0.0),
            Some(parent) => pose * (neutral.position(JOINTS[bone]) - neutral.position(JOINTS[parent])),
        };
        Self {
            side,
            rest: JOINTS.map(|joint| pose * neutral.get(joint).rotation),
            offsets: std::array::from_fn(offset),
        }
    }

    /// From the hand frame of `side` to the T-pose.
    pub fn hand(side: Side) -> UnitQuaternion<f64> {
        // The hand frame of a left hand is the mirror image of a right one's: its thumb is at −x.
        let thumb = Vector3::new(0.0, 0.0, -outward(side));
        let axes = Matrix3::from_columns(&[thumb, Vector3::x() * outward(side), -Vector3::y()]);
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
    }

    /// Left or right.
    pub fn side(&self) -> Side {
        self.side
    }

    /// Where each bone begins in the T-pose, from where the bone above it does; the hand from the elbow. Metres.
    pub fn offsets(&self) -> &[Vector3<f64>; BONES] {
        &self.offsets
    }

    /// How each bone is turned from the T-pose, against the bone above it; the hand in space.
    pub fn turns(&self, frames: &HandFrames) -> [UnitQuaternion<f64>; BONES] {
        let world: [_; BONES] =
            std::array::from_fn(|k| frames.get(JOINTS[k]).rotation * self.rest[k].inverse());
        std::array::from_fn(|k| above(k).map_or(world[k], |parent| world[parent].inverse() * world[k]))
    }

    /// The other way: orientation in space of the joint where each bone begins ([`HandFrames`]), from how the bones are turned from
    /// the T-pose, in space.
    pub fn orientations(&self, turns: &[UnitQuaternion<f64>; BONES]) -> [UnitQuaternion<f64>; BONES] {
        std::array::from_fn(|k| turns[k] * self.rest[k])
    }
}

fn outward(side: Side) -> f64 {
    if side == Side::Left { 1.0 } else { -1.0 }
}

/// A joint of the body in the T-pose: its name as VRM has it, the joint above, and its place, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyJoint {
    /// Name of the bone that begins there.
    pub name: &'static str,
    /// The joint above in the list that [`body`] gives.
    pub above: Option<usize>,
    /// Where it is; feet stand at the height 0.
    pub place: Vector3<f64>,
}

/// The bones that every humanoid of VRM has, without the hands, of a person whose hand is that long (metres); the hips come
/// first, each after the one above it.
pub fn body(hand_length: f64) -> [BodyJoint; 13] {
    let height = hand_length / share::HAND;
    let at = |name, above, x: f64, y: f64| BodyJoint { name, above, place: Vector3::new(x, y, 0.0) * height };
    let (shoulder, hip) = (share::SHOULDER, share::HIP);
    let elbow = shoulder + share::UPPER_ARM;
    [
        at("hips", None, 0.0, share::HIP_HEIGHT),
        at("spine", Some(0), 0.0, 0.5 * (share::HIP_HEIGHT + share::SHOULDER_HEIGHT)),
        at("head", Some(1), 0.0, share::CHIN_HEIGHT),
        at("leftUpperLeg", Some(0), hip, share::HIP_HEIGHT),
        at("leftLowerLeg", Some(3), hip, share::KNEE_HEIGHT),
        at("leftFoot", Some(4), hip, share::ANKLE_HEIGHT),
        at("rightUpperLeg", Some(0), -hip, share::HIP_HEIGHT),
        at("rightLowerLeg", Some(6), -hip, share::KNEE_HEIGHT),
        at("rightFoot", Some(7), -hip, share::ANKLE_HEIGHT),
        at("leftUpperArm", Some(1), shoulder, share::SHOULDER_HEIGHT),
        at("leftLowerArm", Some(9), elbow, share::SHOULDER_HEIGHT),
        at("rightUpperArm", Some(1), -shoulder, share::SHOULDER_HEIGHT),
        at("rightLowerArm", Some(11), -elbow, share::SHOULDER_HEIGHT),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HandPose;

    #[test]
    fn turns_come_back_as_orientations() {
        for side in [Side::Left, Side::Right] {
            let sizes = Morphology::average(0.18);
            let t_pose = TPose::new(&sizes, side);
            let mut pose = HandPose::neutral(side);
            pose.angles = std::array::from_fn(|k| 0.03 * k as f64 - 0.3);
            pose.rotation = UnitQuaternion::from_euler_angles(0.4, -1.0, 2.0);
            let frames = Skeleton::new(&sizes, side).frames(&pose);
            let mut world = t_pose.turns(&frames);
            for bone in 1..BONES {
                world[bone] = world[above(bone).unwrap()] * world[bone];
            }
            for (joint, found) in JOINTS.into_iter().zip(t_pose.orientations(&world)) {
                assert!(frames.get(joint).rotation.angle_to(&found) < 1e-9, "{}", joint.webxr_name());
            }
        }
    }

    #[test]
    fn a_person_is_as_tall_as_the_hand_says() {
        let joints = body(0.19);
        for (k, joint) in joints.iter().enumerate() {
            assert!(joint.above.map_or(k == 0, |above| above < k));
            let mirrored = joints.iter().any(|other| {
                (other.place - joint.place.component_mul(&Vector3::new(-1.0, 1.0, 1.0))).norm() < 1e-9
            });
            assert!(mirrored, "{}", joint.name);
        }
        assert!((joints[2].place.y - 0.87 * 0.19 / 0.108).abs() < 1e-9);
    }
}
