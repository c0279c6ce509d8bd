//! Forward kinematics of the hand (eqs. 11-13 of the paper).

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use super::pose::mirror_vector;
use super::{Finger, HandPose, JointAngle, JointAngles, Morphology, Side};

/// Writes the joints once: the enumeration, its list and the names WebXR gives them.
macro_rules! joints {
    ($($joint:ident $name:literal,)*) => {
        /// The 25 joints of a hand in WebXR order. A joint's frame sits at the base of the bone it names; the
        /// four tips sit at the ends.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[allow(missing_docs)]
        pub enum Joint {
            $($joint,)*
        }

        impl Joint {
            /// How many there are.
            pub const COUNT: usize = [$(Joint::$joint,)*].len();
            /// All of them, wrist first.
            pub const ALL: [Joint; Joint::COUNT] = [$(Joint::$joint,)*];

            /// The name WebXR gives it (WebXR Hand Input, `XRHandJoint`).
            pub fn webxr_name(self) -> &'static str {
                [$($name,)*][self as usize]
            }
        }
    };
}

joints! {
    Wrist "wrist",
    ThumbMetacarpal "thumb-metacarpal",
    ThumbProximal "thumb-phalanx-proximal",
    ThumbDistal "thumb-phalanx-distal",
    ThumbTip "thumb-tip",
    IndexMetacarpal "index-finger-metacarpal",
    IndexProximal "index-finger-phalanx-proximal",
    IndexIntermediate "index-finger-phalanx-intermediate",
    IndexDistal "index-finger-phalanx-distal",
    IndexTip "index-finger-tip",
    MiddleMetacarpal "middle-finger-metacarpal",
    MiddleProximal "middle-finger-phalanx-proximal",
    MiddleIntermediate "middle-finger-phalanx-intermediate",
    MiddleDistal "middle-finger-phalanx-distal",
    MiddleTip "middle-finger-tip",
    RingMetacarpal "ring-finger-metacarpal",
    RingProximal "ring-finger-phalanx-proximal",
    RingIntermediate "ring-finger-phalanx-intermediate",
    RingDistal "ring-finger-phalanx-distal",
    RingTip "ring-finger-tip",
    PinkyMetacarpal "pinky-finger-metacarpal",
    PinkyProximal "pinky-finger-phalanx-proximal",
    PinkyIntermediate "pinky-finger-phalanx-intermediate",
    PinkyDistal "pinky-finger-phalanx-distal",
    PinkyTip "pinky-finger-tip",
}

impl Joint {
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
}

/// Position and orientation of the 25 joints. Axes of a joint at zero angles: those of the hand frame
/// (+Y along a long finger's bone, +Z out of the palm); of the thumb +Y along its bones and +Z the side
/// its pad faces. Bending a joint turns its own frame about its +X.
#[derive(Clone, Debug, PartialEq)]
pub struct HandFrames(pub [Isometry3<f64>; Joint::COUNT]);

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
    fingers: [FingerChain; 5],
    /// Half the rotation about its axis that an angle of the pose stands for is `factor · angle + rest`.
    turns: [Turn; JointAngle::COUNT],
}

/// Offsets of one finger in the hand frame of its side.
#[derive(Clone, Debug)]
struct FingerChain {
    metacarpal: Vector3<f64>,
    base_from_metacarpal: Vector3<f64>,
    bones: [f64; 3],
}

#[derive(Clone, Copy, Debug)]
struct Turn {
    factor: f64,
    rest: f64,
}

impl Skeleton {
    /// The skeleton of `side` with the sizes of `morphology`.
    pub fn new(morphology: &Morphology, side: Side) -> Self {
        let place = |v: Vector3<f64>| if side == Side::Left { mirror_vector(v) } else { v };
        let fingers = morphology.fingers.each_ref().map(|f| FingerChain {
            metacarpal: place(f.metacarpal_vector()),
            base_from_metacarpal: place(f.base_vector() - f.metacarpal_vector()),
            bones: f.bones,
        });
        // In the mirror, turns about y and z change their sense.
        let sense = if side == Side::Left { -1.0 } else { 1.0 };
        let mut turns = [Turn { factor: 0.5, rest: 0.0 }; JointAngle::COUNT];
        let mut turn = |angle: JointAngle, factor: f64, rest: f64| {
            turns[angle.index()] = Turn { factor: 0.5 * sense * factor, rest: 0.5 * sense * rest };
        };
        for finger in Finger::ALL {
            let thumb = finger == Finger::Thumb;
            turn(finger.twisting(), 1.0, if thumb { THUMB_PRONATION } else { 0.0 });
            match finger {
                Finger::Thumb => turn(finger.base_flexion(), 1.0, -THUMB_REST),
                Finger::Index | Finger::Middle => turn(finger.abduction(), -1.0, 0.0),
                Finger::Ring | Finger::Pinky => turn(finger.abduction(), 1.0, 0.0),
            }
        }
        Self { side, fingers, turns }
    }

    /// Left or right.
    pub fn side(&self) -> Side {
        self.side
    }

    /// Joint frames in the hand frame of this side: the global part of the pose is left out.
    pub fn local_frames(&self, angles: &JointAngles) -> HandFrames {
        self.placed(&Isometry3::identity(), angles)
    }

    /// Joint frames in the camera frame (eq. 13: X(p) = M(p) X, M as in eq. 12).
    pub fn frames(&self, pose: &HandPose) -> HandFrames {
        self.placed(&pose.isometry(), &pose.angles)
    }

    /// Fingertips of hands of one side and of different sizes in the same pose, metres in the camera frame: those of
    /// [`Self::frames`], in less time. Of hands of both sides only those of the first one's side are right.
    ///
    /// ```
    /// use handcast_hand::{Finger, HandPose, Joint, Morphology, Side, Skeleton};
    ///
    /// let [small, large] = [0.17, 0.2].map(|length| Skeleton::new(&Morphology::average(length), Side::Left));
    /// let pose = HandPose::neutral(Side::Left);
    /// let [tips, _] = Skeleton::tips([&small, &large], &pose);
    /// assert_eq!(tips[Finger::Ring as usize], small.frames(&pose).position(Joint::RingTip));
    /// ```
    pub fn tips<const N: usize>(hands: [&Self; N], pose: &HandPose) -> [[Point3<f64>; 5]; N] {
        let mut tips = [[Point3::origin(); 5]; N];
        Self::walk(hands, &pose.isometry(), &pose.angles, |finger, _, places, _| {
            // The last of each finger is its tip.
            for (tips, place) in tips.iter_mut().zip(places) {
                tips[finger as usize] = Point3::from(*place);
            }
        });
        tips
    }

    fn placed(&self, wrist: &Isometry3<f64>, angles: &JointAngles) -> HandFrames {
        let mut frames = [*wrist; Joint::COUNT];
        Self::walk([self], wrist, angles, |_, joint, [place], turn| {
            let rotation = UnitQuaternion::new_unchecked(turn);
            frames[joint.index()] = Isometry3::from_parts(Translation3::from(*place), rotation);
        });
        HandFrames(frames)
    }

    /// The way from the wrist to the tips of hands of one side in the same pose, which differ in the lengths of bones alone. `out`
    /// takes the joints of one finger after the other, from the palm to the tip, with their places in each hand and the turn
    /// that is the same in all.
    #[inline]
    fn walk<const N: usize>(
        hands: [&Self; N],
        wrist: &Isometry3<f64>,
        angles: &JointAngles,
        mut out: impl FnMut(Finger, Joint, &[Vector3<f64>; N], Quaternion<f64>),
    ) {
        let Some(first) = hands.first() else { return };
        debug_assert!(hands.iter().all(|hand| hand.side == first.side), "hands of both sides");
        let mut halves = [0.0; JointAngle::COUNT];
        for ((half, turn), angle) in halves.iter_mut().zip(&first.turns).zip(angles) {
            *half = turn.factor * angle + turn.rest;
        }
        let turns = SinCos::of(&halves);
        let by = |angle: JointAngle| turns.get(angle);
        let axes = wrist.rotation.to_rotation_matrix();
        let root = *wrist.rotation.quaternion();
        for finger in Finger::ALL {
            let chains = hands.map(|hand| &hand.fingers[finger as usize]);
            let joints = Joint::of(finger);
            let mut places = chains.map(|chain| wrist.translation.vector + axes * chain.metacarpal);
            let (flexion, abduction) = (by(finger.base_flexion()), by(finger.abduction()));
            let (base, bent) = match finger.palm_flexion() {
                None => (turn_x(turn_z(root, flexion), abduction), 0),
                Some(palm) => {
                    let bone = turn_x(root, by(palm));
                    out(finger, joints[0], &places, bone);
                    for (place, chain) in places.iter_mut().zip(chains) {
                        *place += UnitQuaternion::new_unchecked(bone) * chain.base_from_metacarpal;
                    }
                    (turn_x(turn_z(bone, abduction), flexion), 1)
                }
            };
            let mut turn = turn_y(base, by(finger.twisting()));
            let along = |places: &mut [Vector3<f64>; N], turn: &Quaternion<f64>, k: usize| {
                for (place, chain) in places.iter_mut().zip(chains) {
                    *place += along_y(turn, chain.bones[k]);
                }
            };
            out(finger, joints[bent], &places, turn);
            let bends = [by(finger.middle_flexion()), by(finger.end_flexion())];
            for (k, bend) in bends.into_iter().enumerate() {
                along(&mut places, &turn, k);
                turn = turn_x(turn, bend);
                out(finger, joints[bent + 1 + k], &places, turn);
            }
            along(&mut places, &turn, 2);
            out(finger, joints[bent + 3], &places, turn);
        }
    }
}

/// Sines and cosines of half the rotations of the 29 angles.
struct SinCos {
    sin: JointAngles,
    cos: JointAngles,
}

impl SinCos {
    /// Largest argument of the power series: a rotation by 137°, beyond every limit of a joint.
    const RANGE: f64 = 1.2;

    /// By their power series, all at once so that the compiler can use vector registers: one call of the
    /// library's sine each would cost more than all the rest of the kinematics. Up to [`Self::RANGE`] the
    /// first term left out is below 1e-17.
    fn of(halves: &JointAngles) -> Self {
        let mut out = Self { sin: [0.0; JointAngle::COUNT], cos: [0.0; JointAngle::COUNT] };
        if !halves.iter().all(|h| h.abs() <= Self::RANGE) {
            for (i, half) in halves.iter().enumerate() {
                (out.sin[i], out.cos[i]) = half.sin_cos();
            }
            return out;
        }
        for ((sin, cos), &h) in out.sin.iter_mut().zip(&mut out.cos).zip(halves) {
            let square = h * h;
            // Σ (−x²)ᵏ / (n)!, each factor dividing by the next two numbers.
            let (mut s, mut c) = (1.0, 1.0);
            for n in [18.0, 16.0, 14.0, 12.0, 10.0, 8.0, 6.0, 4.0, 2.0] {
                s = 1.0 - square * s * (1.0 / (n * (n + 1.0)));
                c = 1.0 - square * c * (1.0 / (n * (n - 1.0)));
            }
            (*sin, *cos) = (h * s, c);
        }
        out
    }

    fn get(&self, angle: JointAngle) -> [f64; 2] {
        [self.sin[angle.index()], self.cos[angle.index()]]
    }
}

/// q · exp(½ φ i): the rotation `q` followed, in its own frame, by one about x. The last argument is sin ½φ, cos ½φ.
fn turn_x(q: Quaternion<f64>, [s, c]: [f64; 2]) -> Quaternion<f64> {
    Quaternion::new(q.w * c - q.i * s, q.i * c + q.w * s, q.j * c + q.k * s, q.k * c - q.j * s)
}

/// As [`turn_x`], about y.
fn turn_y(q: Quaternion<f64>, [s, c]: [f64; 2]) -> Quaternion<f64> {
    Quaternion::new(q.w * c - q.j * s, q.i * c - q.k * s, q.j * c + q.w * s, q.k * c + q.i * s)
}

/// As [`turn_x`], about z.
fn turn_z(q: Quaternion<f64>, [s, c]: [f64; 2]) -> Quaternion<f64> {
    Quaternion::new(q.w * c - q.k * s, q.i * c + q.j * s, q.j * c - q.i * s, q.k * c + q.w * s)
}

/// The vector of this length along the y axis, turned by `q`.
fn along_y(q: &Quaternion<f64>, length: f64) -> Vector3<f64> {
    let twice = 2.0 * length;
    Vector3::new(
        twice * (q.i * q.j - q.w * q.k),
        length - twice * (q.i * q.i + q.k * q.k),
        twice * (q.j * q.k + q.w * q.i),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
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
            angles in prop::array::uniform29(-2.5f64..2.5),
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

    proptest! {
        #[test]
        fn the_power_series_are_sine_and_cosine(half in -SinCos::RANGE..SinCos::RANGE, far in any::<bool>()) {
            let mut halves = [half; JointAngle::COUNT];
            // One angle out of range takes the other way for all.
            halves[28] = if far { 3.0 } else { half };
            let turns = SinCos::of(&halves);
            prop_assert!((turns.sin[0] - half.sin()).abs() < 3e-16 && (turns.cos[0] - half.cos()).abs() < 3e-16);
            prop_assert_eq!(turns.sin[28], if far { 3.0f64.sin() } else { turns.sin[0] });
        }
    }

    #[test]
    fn signs_are_anatomical() {
        let m = Morphology::default();
        let skeleton = Skeleton::new(&m, Side::Right);
        let rest = skeleton.local_frames(&[0.0; JointAngle::COUNT]);
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
