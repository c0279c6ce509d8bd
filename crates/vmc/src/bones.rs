//! A pose as the bones of a humanoid avatar.

use handcast_hand::humanoid::{BONES, TPose};
use handcast_hand::{HandPose, Morphology, Side, Skeleton};
use nalgebra::{UnitQuaternion, Vector3};

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

/// By side, then in the order of [`handcast_hand::humanoid::JOINTS`].
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
    t_pose: TPose,
    wrist: bool,
}

impl HandBones {
    /// The bones of the hand of `side` with the sizes of `morphology`.
    pub fn new(morphology: &Morphology, side: Side) -> Self {
        Self { skeleton: Skeleton::new(morphology, side), t_pose: TPose::new(morphology, side), wrist: true }
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
        let turns = self.t_pose.turns(&self.skeleton.frames(pose));
        let (names, offsets) = (&NAMES[self.side() as usize], *self.t_pose.offsets());
        (usize::from(!self.wrist)..BONES).map(move |k| Bone {
            name: names[k],
            position: unity_position(&offsets[k]),
            rotation: unity_rotation(&turns[k]),
        })
    }
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
    use handcast_hand::humanoid::{JOINTS, above};
    use handcast_hand::{Finger, Joint, JointAngle};
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
            pose.rotation = TPose::hand(side);
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
