//! Forward kinematics of the hand (eqs. 11-13 of the paper).

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::pose::{mirror_rotation, mirror_vector};
use super::{Finger, HandPose, Morphology, Side};

/// The 25 joints of a hand in WebXR order. A joint's frame sits at the base of the bone it names; the
/// four tips sit at the ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum Joint {
    Wrist,
    ThumbMetacarpal,
    ThumbProximal,
    ThumbDistal,
    ThumbTip,
    IndexMetacarpal,
    IndexProximal,
    IndexIntermediate,
    IndexDistal,
    IndexTip,
    MiddleMetacarpal,
    MiddleProximal,
    MiddleIntermediate,
    MiddleDistal,
    MiddleTip,
    RingMetacarpal,
    RingProximal,
    RingIntermediate,
    RingDistal,
    RingTip,
    PinkyMetacarpal,
    PinkyProximal,
    PinkyIntermediate,
    PinkyDistal,
    PinkyTip,
}

impl Joint {
    /// All 25, wrist first.
    pub const ALL: [Joint; 25] = {
        use Joint::*;
        [
            Wrist,
            ThumbMetacarpal,
            ThumbProximal,
            ThumbDistal,
            ThumbTip,
            IndexMetacarpal,
            IndexProximal,
            IndexIntermediate,
            IndexDistal,
            IndexTip,
            MiddleMetacarpal,
            MiddleProximal,
            MiddleIntermediate,
            MiddleDistal,
            MiddleTip,
            RingMetacarpal,
            RingProximal,
            RingIntermediate,
            RingDistal,
            RingTip,
            PinkyMetacarpal,
            PinkyProximal,
            PinkyIntermediate,
            PinkyDistal,
            PinkyTip,
        ]
    };

    /// The four joints of the thumb, or the five of a long finger, from the palm to the tip.
    pub fn of(finger: Finger) -> &'static [Joint] {
        match finger {
            Finger::Thumb => &Self::ALL[1..5],
            Finger::Index => &Self::ALL[5..10],
            Finger::Middle => &Self::ALL[10..15],
            Finger::Ring => &Self::ALL[15..20],
            Finger::Pinky => &Self::ALL[20..25],
        }
    }

    /// The tip of a finger.
    pub fn tip(finger: Finger) -> Joint {
        [Joint::ThumbTip, Joint::IndexTip, Joint::MiddleTip, Joint::RingTip, Joint::PinkyTip][finger as usize]
    }

    /// The joint where the finger's chain of three bones starts: MCP, or CMC of the thumb.
    pub fn base(finger: Finger) -> Joint {
        [
            Joint::ThumbMetacarpal,
            Joint::IndexProximal,
            Joint::MiddleProximal,
            Joint::RingProximal,
            Joint::PinkyProximal,
        ][finger as usize]
    }

    /// The joint whose bone carries this one; `None` for the wrist.
    pub fn parent(self) -> Option<Joint> {
        match self {
            Joint::Wrist => None,
            Joint::ThumbMetacarpal
            | Joint::IndexMetacarpal
            | Joint::MiddleMetacarpal
            | Joint::RingMetacarpal
            | Joint::PinkyMetacarpal => Some(Joint::Wrist),
            other => Some(Self::ALL[other as usize - 1]),
        }
    }

    /// Position in [`Joint::ALL`].
    pub fn index(self) -> usize {
        self as usize
    }

    /// The name WebXR gives it (WebXR Hand Input, `XRHandJoint`).
    pub fn webxr_name(self) -> &'static str {
        [
            "wrist",
            "thumb-metacarpal",
            "thumb-phalanx-proximal",
            "thumb-phalanx-distal",
            "thumb-tip",
            "index-finger-metacarpal",
            "index-finger-phalanx-proximal",
            "index-finger-phalanx-intermediate",
            "index-finger-phalanx-distal",
            "index-finger-tip",
            "middle-finger-metacarpal",
            "middle-finger-phalanx-proximal",
            "middle-finger-phalanx-intermediate",
            "middle-finger-phalanx-distal",
            "middle-finger-tip",
            "ring-finger-metacarpal",
            "ring-finger-phalanx-proximal",
            "ring-finger-phalanx-intermediate",
            "ring-finger-phalanx-distal",
            "ring-finger-tip",
            "pinky-finger-metacarpal",
            "pinky-finger-phalanx-proximal",
            "pinky-finger-phalanx-intermediate",
            "pinky-finger-phalanx-distal",
            "pinky-finger-tip",
        ][self as usize]
    }
}

/// Position and orientation of the 25 joints. Axes of a joint at zero angles: those of the hand frame
/// (+Y along a long finger's bone, +Z out of the palm); of the thumb +Y along its bones and +Z the side
/// its pad faces. Bending a joint turns its own frame about its +X.
#[derive(Clone, Debug, PartialEq)]
pub struct HandFrames(pub [Isometry3<f64>; 25]);

impl HandFrames {
    /// The frame of a joint.
    pub fn get(&self, joint: Joint) -> &Isometry3<f64> {
        &self.0[joint.index()]
    }

    /// The position of a joint, metres.
    pub fn position(&self, joint: Joint) -> Point3<f64> {
        Point3::from(self.0[joint.index()].translation.vector)
    }
}

/// The thumb's resting direction in the palm plane, from +Y towards +X (spec 2.6: thumb 1 to thumb 2).
pub(super) const THUMB_REST: f64 = std::f64::consts::FRAC_PI_4;
/// How far the thumb's bending axis is turned about the thumb from that of the fingers: the pad of a
/// relaxed thumb faces the index finger rather than the viewer of the palm.
pub(super) const THUMB_PRONATION: f64 = -80.0 * std::f64::consts::PI / 180.0;

/// The articulated structure of one hand: joint offsets taken from a [`Morphology`], mirrored for a left
/// hand. Shapes are kept apart ([`super::Shape`]), as in the paper's 4.1.
#[derive(Clone, Debug)]
pub struct Skeleton {
    side: Side,
    /// Metacarpal and base of each finger in the right-hand frame, and bone lengths.
    fingers: [FingerChain; 5],
}

#[derive(Clone, Debug)]
struct FingerChain {
    metacarpal: Vector3<f64>,
    base_from_metacarpal: Vector3<f64>,
    bones: [f64; 3],
    /// Sign of the rotation about +Z for a positive abduction.
    abduction_sign: f64,
}

impl Skeleton {
    /// The skeleton of `side` with the sizes of `morphology`.
    pub fn new(morphology: &Morphology, side: Side) -> Self {
        let fingers = std::array::from_fn(|i| {
            let f = &morphology.fingers[i];
            FingerChain {
                metacarpal: f.metacarpal_vector(),
                base_from_metacarpal: f.base_vector() - f.metacarpal_vector(),
                bones: f.bones,
                abduction_sign: if i <= 2 { -1.0 } else { 1.0 },
            }
        });
        Self { side, fingers }
    }

    /// Left or right.
    pub fn side(&self) -> Side {
        self.side
    }

    /// Joint frames in the hand frame of this side: the global part of the pose is left out.
    pub fn local_frames(&self, angles: &[f64; 29]) -> HandFrames {
        let mut frames = [Isometry3::identity(); 25];
        for finger in Finger::ALL {
            self.chain(finger, angles, &mut frames);
        }
        if self.side == Side::Left {
            for frame in &mut frames {
                frame.translation.vector = mirror_vector(frame.translation.vector);
                frame.rotation = mirror_rotation(&frame.rotation);
            }
        }
        HandFrames(frames)
    }

    /// Joint frames in the camera frame (eq. 13: X(p) = M(p) X, M as in eq. 12).
    pub fn frames(&self, pose: &HandPose) -> HandFrames {
        let mut frames = self.local_frames(&pose.angles);
        let global = pose.isometry();
        for frame in &mut frames.0 {
            *frame = global * *frame;
        }
        frames
    }

    /// Right-hand frames of one finger.
    fn chain(&self, finger: Finger, angles: &[f64; 29], frames: &mut [Isometry3<f64>; 25]) {
        let chain = &self.fingers[finger as usize];
        let angle = |a: super::JointAngle| angles[a.index()];
        let joints = Joint::of(finger);
        let mut out = |joint: Joint, position: Vector3<f64>, rotation: UnitQuaternion<f64>| {
            frames[joint.index()] = Isometry3::from_parts(Translation3::from(position), rotation);
        };
        let flexion = angle(finger.base_flexion());
        let abduction = angle(finger.abduction());
        let twisting = angle(finger.twisting());
        let (mut position, mut rotation, first) = match finger.palm_flexion() {
            None => {
                let rotation =
                    rot_z(flexion - THUMB_REST) * rot_x(abduction) * rot_y(THUMB_PRONATION + twisting);
                (chain.metacarpal, rotation, 0)
            }
            Some(palm) => {
                let palm = rot_x(angle(palm));
                out(joints[0], chain.metacarpal, palm);
                let rotation =
                    palm * rot_z(chain.abduction_sign * abduction) * rot_x(flexion) * rot_y(twisting);
                (chain.metacarpal + palm * chain.base_from_metacarpal, rotation, 1)
            }
        };
        out(joints[first], position, rotation);
        for (k, bend) in [angle(finger.middle_flexion()), angle(finger.end_flexion())].into_iter().enumerate()
        {
            position += rotation * Vector3::new(0.0, chain.bones[k], 0.0);
            rotation *= rot_x(bend);
            out(joints[first + 1 + k], position, rotation);
        }
        position += rotation * Vector3::new(0.0, chain.bones[2], 0.0);
        out(joints[first + 3], position, rotation);
    }
}

fn rot_x(a: f64) -> UnitQuaternion<f64> {
    let (s, c) = (0.5 * a).sin_cos();
    UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(c, s, 0.0, 0.0))
}

fn rot_y(a: f64) -> UnitQuaternion<f64> {
    let (s, c) = (0.5 * a).sin_cos();
    UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(c, 0.0, s, 0.0))
}

fn rot_z(a: f64) -> UnitQuaternion<f64> {
    let (s, c) = (0.5 * a).sin_cos();
    UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(c, 0.0, 0.0, s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::JointAngle;
    use nalgebra::Matrix4;
    use proptest::prelude::*;

    /// The same chain as products of homogeneous matrices, straight from eqs. 11-13.
    fn matrix_twin(m: &Morphology, pose: &HandPose, finger: Finger) -> Vec<Vector3<f64>> {
        let rot = |axis: Vector3<f64>, a: f64| Matrix4::from_scaled_axis(axis * a);
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        let shift = |v: Vector3<f64>| Matrix4::new_translation(&v);
        let f = m.finger(finger);
        let a = |j: JointAngle| pose.angle(j);
        let base = match finger.palm_flexion() {
            None => {
                shift(f.base_vector())
                    * rot(z, a(finger.base_flexion()) - THUMB_REST)
                    * rot(x, a(finger.abduction()))
                    * rot(y, THUMB_PRONATION + a(finger.twisting()))
            }
            Some(palm) => {
                let sign = if matches!(finger, Finger::Ring | Finger::Pinky) { 1.0 } else { -1.0 };
                shift(f.metacarpal_vector())
                    * rot(x, a(palm))
                    * shift(f.base_vector() - f.metacarpal_vector())
                    * rot(z, sign * a(finger.abduction()))
                    * rot(x, a(finger.base_flexion()))
                    * rot(y, a(finger.twisting()))
            }
        };
        let second = base * shift(y * f.bones[0]) * rot(x, a(finger.middle_flexion()));
        let third = second * shift(y * f.bones[1]) * rot(x, a(finger.end_flexion()));
        let tip = third * shift(y * f.bones[2]);
        let mirror = match pose.side {
            Side::Right => Matrix4::identity(),
            Side::Left => Matrix4::new_nonuniform_scaling(&Vector3::new(-1.0, 1.0, 1.0)),
        };
        let global = pose.isometry().to_homogeneous() * mirror;
        [base, second, third, tip].iter().map(|m| (global * m).column(3).xyz()).collect()
    }

    proptest! {
        #[test]
        fn quaternion_chain_equals_matrix_chain(
            angles in prop::array::uniform29(-1.5f64..1.5),
            global in prop::array::uniform6(-2.0f64..2.0),
            left in any::<bool>(),
        ) {
            let m = Morphology::default();
            let pose = HandPose {
                side: if left { Side::Left } else { Side::Right },
                translation: Vector3::new(global[0], global[1], global[2]),
                rotation: UnitQuaternion::from_scaled_axis(Vector3::new(global[3], global[4], global[5])),
                angles,
            };
            let frames = Skeleton::new(&m, pose.side).frames(&pose);
            for finger in Finger::ALL {
                let joints = Joint::of(finger);
                let twin = matrix_twin(&m, &pose, finger);
                for (joint, expected) in joints[joints.len() - 4..].iter().zip(twin) {
                    prop_assert!((frames.position(*joint).coords - expected).norm() < 1e-12);
                }
            }
        }

        #[test]
        fn left_is_the_mirror_image_of_right(angles in prop::array::uniform29(-1.5f64..1.5)) {
            let m = Morphology::default();
            let right = Skeleton::new(&m, Side::Right).local_frames(&angles);
            let left = Skeleton::new(&m, Side::Left).local_frames(&angles);
            for joint in Joint::ALL {
                let (r, l) = (right.position(joint), left.position(joint));
                prop_assert!((r.x + l.x).abs() < 1e-12 && (r.y - l.y).abs() < 1e-12 && (r.z - l.z).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn signs_are_anatomical() {
        let m = Morphology::default();
        let skeleton = Skeleton::new(&m, Side::Right);
        let rest = skeleton.local_frames(&[0.0; 29]);
        let moved = |angle: JointAngle| {
            let pose = HandPose::neutral(Side::Right).with_degrees(angle, 30.0);
            skeleton.local_frames(&pose.angles)
        };
        for finger in Finger::LONG {
            for angle in [finger.base_flexion(), finger.middle_flexion(), finger.end_flexion()] {
                let tip = moved(angle).position(Joint::tip(finger)) - rest.position(Joint::tip(finger));
                assert!(tip.z > 0.0 && tip.y < 0.0, "{} closes towards the palm", angle.name());
            }
            let tip =
                moved(finger.abduction()).position(Joint::tip(finger)) - rest.position(Joint::tip(finger));
            let towards_thumb = matches!(finger, Finger::Index | Finger::Middle);
            assert_eq!(tip.x > 0.0, towards_thumb, "{}", finger.name());
        }
        let thumb = |angle| moved(angle).position(Joint::ThumbTip) - rest.position(Joint::ThumbTip);
        assert!(thumb(JointAngle::Thumb1Flexion).x < 0.0, "closing brings the thumb to the fingers");
        assert!(thumb(JointAngle::Thumb1Abduction).z > 0.0, "abduction leaves the palm plane");
        for bend in [JointAngle::Thumb2Flexion, JointAngle::Thumb3Flexion] {
            assert!(thumb(bend).x < 0.0 && thumb(bend).z > 0.0);
        }
    }

    #[test]
    fn parents_come_before_children() {
        for joint in Joint::ALL {
            assert!(joint.parent().is_none_or(|p| p < joint));
        }
    }
}
