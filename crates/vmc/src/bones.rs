//! A pose as the bones of a humanoid avatar.

use handcast_hand::{HandFrames, HandPose, Joint, JointAngle, Morphology, Side, Skeleton};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Bones of a hand: the hand itself and three of each finger.
pub const BONES: usize = 16;

/// Length of the forearm over that of the hand: 0.146 and 0.108 of a person's height (Drillis and Contini 1966).
const FOREARM: f64 = 0.146 / 0.108;

/// The joints where the bones begin, hand first, from the thumb outwards.
const JOINTS: [Joint; BONES] = [
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

/// Names of Unity's `HumanBodyBones` with a word for the side before each.
macro_rules! names {
    ($side:literal) => {
        [
            concat!($side, "Hand"),
            concat!($side, "ThumbProximal"),
            concat!($side, "ThumbIntermediate"),
            concat!($side, "ThumbDistal"),
            concat!($side, "IndexProximal"),
            concat!($side, "IndexIntermediate"),
            concat!($side, "IndexDistal"),
            concat!($side, "MiddleProximal"),
            concat!($side, "MiddleIntermediate"),
            concat!($side, "MiddleDistal"),
            concat!($side, "RingProximal"),
            concat!($side, "RingIntermediate"),
            concat!($side, "RingDistal"),
            concat!($side, "LittleProximal"),
            concat!($side, "LittleIntermediate"),
            concat!($side, "LittleDistal"),
        ]
    };
}

/// By side, then in the order of [`JOINTS`].
const NAMES: [[&str; BONES]; 2] = [names!("Left"), names!("Right")];

/// A bone as `/VMC/Ext/Bone/Pos` has it: against the bone above it, in Unity's axes (left-handed, x right, y up, the avatar
/// faces +z).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bone {
    /// Its name among Unity's `HumanBodyBones`.
    pub name: &'static str,
    /// Offset at rest, metres.
    pub position: [f32; 3],
    /// Rotation from the T-pose, x, y, z, w with w not negative.
    pub rotation: [f32; 4],
}

/// What turns poses of one hand into bones.
#[derive(Clone, Debug)]
pub struct HandBones {
    skeleton: Skeleton,
    /// Orientations of the joints in the T-pose, in the axes of VRM 1.0: right-handed, y up, the avatar faces +z and its left is +x.
    /// A person before the camera who faces it has these axes in the camera frame of [`HandPose`].
    rest: [UnitQuaternion<f64>; BONES],
    offsets: [[f32; 3]; BONES],
    wrist: bool,
}

impl HandBones {
    /// The bones of the hand of `side` with the sizes of `morphology`.
    pub fn new(morphology: &Morphology, side: Side) -> Self {
        let skeleton = Skeleton::new(morphology, side);
        let neutral = skeleton.local_frames(&[0.0; JointAngle::COUNT]);
        let pose = t_pose(side);
        let rest = JOINTS.map(|joint| pose * neutral.get(joint).rotation);
        let outward = if side == Side::Left { 1.0 } else { -1.0 };
        let forearm = Vector3::new(outward * FOREARM * morphology.hand_length, 0.0, 0.0);
        let mut bone = 0;
        let offsets = JOINTS.map(|joint| {
            let offset = match above(bone) {
                None => forearm,
                Some(parent) => pose * (neutral.position(joint) - neutral.position(JOINTS[parent])),
            };
            bone += 1;
            unity_position(&offset)
        });
        Self { skeleton, rest, offsets, wrist: true }
    }

    /// Whether the hand's own rotation is among the bones (default), or those of the fingers alone.
    #[must_use]
    pub fn with_wrist(mut self, wrist: bool) -> Self {
        self.wrist = wrist;
        self
    }

    /// Left or right.
    pub fn side(&self) -> Side {
        self.skeleton.side()
    }

    /// The bones of a pose, the hand first: 16, or 15 without the wrist. The pose's joint angles are taken as this side's.
    pub fn bones(&self, pose: &HandPose) -> impl Iterator<Item = Bone> + use<> {
        let frames = self.skeleton.frames(pose);
        let turns = self.turns(&frames);
        let (names, offsets) = (&NAMES[self.side() as usize], self.offsets);
        (usize::from(!self.wrist)..BONES).map(move |k| Bone {
            name: names[k],
            position: offsets[k],
            rotation: unity_rotation(&turns[k]),
        })
    }

    /// Rotations from the T-pose, each in the axes of the bone above it.
    fn turns(&self, frames: &HandFrames) -> [UnitQuaternion<f64>; BONES] {
        let world: [_; BONES] =
            std::array::from_fn(|k| frames.get(JOINTS[k]).rotation * self.rest[k].inverse());
        std::array::from_fn(|k| above(k).map_or(world[k], |parent| world[parent].inverse() * world[k]))
    }
}

/// The bone that carries a bone; `None` for the hand.
fn above(bone: usize) -> Option<usize> {
    match bone {
        0 => None,
        first if first % 3 == 1 => Some(0),
        other => Some(other - 1),
    }
}

/// From the hand frame to the T-pose: fingers outward, palm down, thumb forward.
fn t_pose(side: Side) -> UnitQuaternion<f64> {
    let outward = if side == Side::Left { Vector3::x() } else { -Vector3::x() };
    // The hand frame of a left hand is the mirror image of a right one's: its thumb is at −x.
    let x = if side == Side::Left { -Vector3::z() } else { Vector3::z() };
    let axes = Matrix3::from_columns(&[x, outward, -Vector3::y()]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

/// Mirrored in the plane x = 0, which makes the axes left-handed.
fn unity_position(v: &Vector3<f64>) -> [f32; 3] {
    [-v.x, v.y, v.z].map(|v| v as f32)
}

fn unity_rotation(q: &UnitQuaternion<f64>) -> [f32; 4] {
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [q.i, -q.j, -q.k, q.w].map(|v| (sign * v) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::Finger;
    use nalgebra::{Isometry3, Quaternion, Translation3};
    use proptest::prelude::*;

    /// The bones of a packet put together again, in the axes of VRM 1.0: frames of the 16 bones with the elbow at the origin.
    fn put_together(bones: &[Bone]) -> Vec<Isometry3<f64>> {
        let mut world: Vec<Isometry3<f64>> = Vec::new();
        for (k, bone) in bones.iter().enumerate() {
            let [x, y, z] = bone.position.map(f64::from);
            let [i, j, l, w] = bone.rotation.map(f64::from);
            let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, -j, -l));
            let local = Isometry3::from_parts(Translation3::new(-x, y, z), turn);
            world.push(above(k).map_or(local, |parent| world[parent] * local));
        }
        world
    }

    fn side(left: bool) -> Side {
        if left { Side::Left } else { Side::Right }
    }

    proptest! {
        #[test]
        fn directions_of_bones_are_those_of_the_pose(
            angles in prop::array::uniform29(-1.2f64..1.2),
            turn in prop::array::uniform3(-2.0f64..2.0),
            left in any::<bool>(),
        ) {
            let mut pose = HandPose::neutral(side(left));
            pose.angles = angles;
            pose.rotation = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
            let sizes = Morphology::average(0.18);
            let bones: Vec<Bone> = HandBones::new(&sizes, pose.side).bones(&pose).collect();
            let found = put_together(&bones);
            let frames = Skeleton::new(&sizes, pose.side).frames(&pose);
            for finger in Finger::ALL {
                let joints = Joint::of(finger);
                for pair in joints[joints.len() - 4..].windows(2).take(2) {
                    let at = |joint: Joint| JOINTS.iter().position(|j| *j == joint).unwrap();
                    let theirs = found[at(pair[1])].translation.vector - found[at(pair[0])].translation.vector;
                    let ours = frames.position(pair[1]) - frames.position(pair[0]);
                    prop_assert!((theirs - ours).norm() < 1e-6, "{:?}: {theirs} {ours}", pair[0]);
                }
            }
        }
    }

    #[test]
    fn the_neutral_hand_is_the_t_pose() {
        for (side, outward) in [(Side::Left, 1.0), (Side::Right, -1.0)] {
            let mut pose = HandPose::neutral(side);
            pose.rotation = t_pose(side);
            let hand = HandBones::new(&Morphology::default(), side);
            let bones: Vec<Bone> = hand.bones(&pose).collect();
            for bone in &bones {
                assert!(bone.rotation[3] > 1.0 - 1e-6, "{bone:?} is not turned");
            }
            let found = put_together(&bones);
            let along = |from: usize, to: usize| {
                (found[to].translation.vector - found[from].translation.vector).normalize()
            };
            for first in [4, 7, 10, 13] {
                assert!((along(first, first + 1) - Vector3::x() * outward).norm() < 1e-6);
            }
            let thumb = Vector3::new(outward, 0.0, 1.0).normalize();
            assert!((along(1, 2) - thumb).norm() < 1e-6, "the thumb is forward and outward");
            assert_eq!(bones[0].position[0] < 0.0, side == Side::Left, "left is -x in Unity");
            assert!(bones.iter().all(|b| b.name.starts_with(if side == Side::Left {
                "Left"
            } else {
                "Right"
            })));
        }
    }

    #[test]
    fn a_closing_finger_turns_about_unitys_z() {
        // Palms are down and fingers along x: closing turns down, in a left-handed frame against the sense on the right.
        for (side, sign) in [(Side::Left, 1.0), (Side::Right, -1.0)] {
            let pose = HandPose::neutral(side).with_degrees(JointAngle::Index2Flexion, 60.0);
            let bones: Vec<Bone> = HandBones::new(&Morphology::default(), side).bones(&pose).collect();
            let [x, y, z, w] = bones[5].rotation;
            assert_eq!(&bones[5].name[bones[5].name.len() - 17..], "IndexIntermediate");
            assert!((z - sign * 0.5).abs() < 1e-6 && (w - 0.75f32.sqrt()).abs() < 1e-6, "{:?}", bones[5]);
            assert!(x.abs() < 1e-6 && y.abs() < 1e-6);
        }
    }

    #[test]
    fn without_the_wrist_there_are_the_fingers() {
        let hand = HandBones::new(&Morphology::default(), Side::Right).with_wrist(false);
        let bones: Vec<Bone> = hand.bones(&HandPose::neutral(Side::Right)).collect();
        assert_eq!((bones.len(), bones[0].name), (BONES - 1, "RightThumbProximal"));
    }
}
