//! The state of one hand: 29 joint angles and 6 global values.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Which hand of the person.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The person's left hand.
    Left,
    /// The person's right hand.
    Right,
}

impl Side {
    /// `"left"` or `"right"`.
    pub fn name(self) -> &'static str {
        match self {
            Side::Left => "left",
            Side::Right => "right",
        }
    }

    /// The other hand.
    pub fn other(self) -> Self {
        match self {
            Side::Left => Side::Right,
            Side::Right => Side::Left,
        }
    }
}

/// The five fingers, from the thumb outwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Finger {
    /// Thumb.
    Thumb,
    /// Index finger.
    Index,
    /// Middle finger.
    Middle,
    /// Ring finger.
    Ring,
    /// Little finger, `pinky` in the standard.
    Pinky,
}

impl Finger {
    /// All five, thumb first.
    pub const ALL: [Finger; 5] = [Finger::Thumb, Finger::Index, Finger::Middle, Finger::Ring, Finger::Pinky];
    /// The four long fingers, index first.
    pub const LONG: [Finger; 4] = [Finger::Index, Finger::Middle, Finger::Ring, Finger::Pinky];

    /// The name used in files: `thumb`, `index`, `middle`, `ring`, `pinky`.
    pub fn name(self) -> &'static str {
        ["thumb", "index", "middle", "ring", "pinky"][self as usize]
    }

    /// Bend at the palm end (MPEG-4 `x0_flexion`); the thumb has none.
    pub fn palm_flexion(self) -> Option<JointAngle> {
        use JointAngle::*;
        match self {
            Finger::Thumb => None,
            Finger::Index => Some(Index0Flexion),
            Finger::Middle => Some(Middle0Flexion),
            Finger::Ring => Some(Ring0Flexion),
            Finger::Pinky => Some(Pinky0Flexion),
        }
    }

    /// Flexion at the base of the finger: MCP, or CMC of the thumb.
    pub fn base_flexion(self) -> JointAngle {
        use JointAngle::*;
        [Thumb1Flexion, Index1Flexion, Middle1Flexion, Ring1Flexion, Pinky1Flexion][self as usize]
    }

    /// Abduction at the base of the finger: MCP, or CMC of the thumb.
    pub fn abduction(self) -> JointAngle {
        use JointAngle::*;
        [Thumb1Abduction, Index1Abduction, Middle1Abduction, Ring1Abduction, Pinky1Abduction][self as usize]
    }

    /// Twisting at the base of the finger.
    pub fn twisting(self) -> JointAngle {
        use JointAngle::*;
        [Thumb1Twisting, Index1Twisting, Middle1Twisting, Ring1Twisting, Pinky1Twisting][self as usize]
    }

    /// Flexion of the middle joint: PIP, or MCP of the thumb.
    pub fn middle_flexion(self) -> JointAngle {
        use JointAngle::*;
        [Thumb2Flexion, Index2Flexion, Middle2Flexion, Ring2Flexion, Pinky2Flexion][self as usize]
    }

    /// Flexion of the end joint: DIP, or IP of the thumb.
    pub fn end_flexion(self) -> JointAngle {
        use JointAngle::*;
        [Thumb3Flexion, Index3Flexion, Middle3Flexion, Ring3Flexion, Pinky3Flexion][self as usize]
    }
}

macro_rules! joint_angles {
    ($($name:ident = $text:literal),* $(,)?) => {
        /// The 29 joint angles of one hand, in the order of their BAP numbers (123 + 2 i on the left,
        /// 124 + 2 i on the right). `0` is the palm end of a finger, `1` its base (MCP; CMC of the
        /// thumb), `2` the middle joint (PIP; MCP of the thumb), `3` the end joint (DIP; IP of the thumb).
        ///
        /// Signs: flexion is positive when the finger closes (thumb base: when the thumb moves in the
        /// palm plane towards the fingers); abduction is positive away from the middle finger's axis,
        /// for the middle finger towards the thumb, for the thumb out of the palm plane; twisting is
        /// positive counter-clockwise about the bone seen from the tip of a right hand, mirrored on a left.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[allow(missing_docs)]
        pub enum JointAngle { $($name),* }

        impl JointAngle {
            /// All 29, in BAP order.
            pub const ALL: [JointAngle; 29] = [$(JointAngle::$name),*];

            /// The name used in files, e.g. `index1_flexion`.
            pub fn name(self) -> &'static str {
                match self { $(JointAngle::$name => $text),* }
            }

            /// The angle of that name.
            pub fn from_name(name: &str) -> Option<Self> {
                match name { $($text => Some(JointAngle::$name),)* _ => None }
            }
        }
    };
}

joint_angles! {
    Pinky0Flexion = "pinky0_flexion",
    Pinky1Flexion = "pinky1_flexion",
    Pinky1Abduction = "pinky1_abduction",
    Pinky1Twisting = "pinky1_twisting",
    Pinky2Flexion = "pinky2_flexion",
    Pinky3Flexion = "pinky3_flexion",
    Ring0Flexion = "ring0_flexion",
    Ring1Flexion = "ring1_flexion",
    Ring1Abduction = "ring1_abduction",
    Ring1Twisting = "ring1_twisting",
    Ring2Flexion = "ring2_flexion",
    Ring3Flexion = "ring3_flexion",
    Middle0Flexion = "middle0_flexion",
    Middle1Flexion = "middle1_flexion",
    Middle1Abduction = "middle1_abduction",
    Middle1Twisting = "middle1_twisting",
    Middle2Flexion = "middle2_flexion",
    Middle3Flexion = "middle3_flexion",
    Index0Flexion = "index0_flexion",
    Index1Flexion = "index1_flexion",
    Index1Abduction = "index1_abduction",
    Index1Twisting = "index1_twisting",
    Index2Flexion = "index2_flexion",
    Index3Flexion = "index3_flexion",
    Thumb1Flexion = "thumb1_flexion",
    Thumb1Abduction = "thumb1_abduction",
    Thumb1Twisting = "thumb1_twisting",
    Thumb2Flexion = "thumb2_flexion",
    Thumb3Flexion = "thumb3_flexion",
}

impl JointAngle {
    /// Position in [`JointAngle::ALL`] and in [`HandPose::angles`].
    pub fn index(self) -> usize {
        self as usize
    }
}

/// One hand at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct HandPose {
    /// Left or right.
    pub side: Side,
    /// Wrist position in the camera frame, metres: +X right, +Y up, +Z towards the viewer.
    pub translation: Vector3<f64>,
    /// Rotation from the hand frame (see [`crate::hand`]) to the camera frame.
    pub rotation: UnitQuaternion<f64>,
    /// Joint angles in radians, indexed by [`JointAngle::index`].
    pub angles: [f64; 29],
}

impl HandPose {
    /// All angles zero, wrist at the origin, palm towards the viewer, fingers up.
    pub fn neutral(side: Side) -> Self {
        Self { side, translation: Vector3::zeros(), rotation: UnitQuaternion::identity(), angles: [0.0; 29] }
    }

    /// The angle in radians.
    pub fn angle(&self, which: JointAngle) -> f64 {
        self.angles[which.index()]
    }

    /// Sets an angle, in radians.
    pub fn set(&mut self, which: JointAngle, radians: f64) {
        self.angles[which.index()] = radians;
    }

    /// The same pose with one angle replaced, in degrees.
    #[must_use]
    pub fn with_degrees(mut self, which: JointAngle, degrees: f64) -> Self {
        self.set(which, degrees.to_radians());
        self
    }

    /// The global part: hand frame to camera frame (T and R of eq. 11).
    pub fn isometry(&self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::from(self.translation), self.rotation)
    }

    /// The mirror image in the plane x = 0: a left hand for a right one, the same joint angles.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        Self {
            side: self.side.other(),
            translation: mirror_vector(self.translation),
            rotation: mirror_rotation(&self.rotation),
            angles: self.angles,
        }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.angles.iter().all(|a| a.is_finite())
            && self.translation.iter().all(|v| v.is_finite())
            && self.rotation.coords.iter().all(|v| v.is_finite())
    }
}

/// A vector mirrored in the plane x = 0.
pub(crate) fn mirror_vector(v: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(-v.x, v.y, v.z)
}

/// A rotation conjugated with the mirror x → −x.
pub(crate) fn mirror_rotation(q: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(q.w, q.i, -q.j, -q.k))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_found() {
        for (i, angle) in JointAngle::ALL.into_iter().enumerate() {
            assert_eq!(angle.index(), i);
            assert_eq!(JointAngle::from_name(angle.name()), Some(angle));
        }
        assert_eq!(JointAngle::from_name("index4_flexion"), None);
    }

    #[test]
    fn finger_accessors_name_their_finger() {
        for finger in Finger::ALL {
            for angle in [
                finger.base_flexion(),
                finger.abduction(),
                finger.twisting(),
                finger.middle_flexion(),
                finger.end_flexion(),
            ] {
                assert!(angle.name().starts_with(finger.name()));
            }
        }
    }

    #[test]
    fn mirroring_twice_is_identity() {
        let mut pose = HandPose::neutral(Side::Right);
        pose.rotation = UnitQuaternion::from_euler_angles(0.3, -0.7, 1.1);
        pose.translation = Vector3::new(0.1, 0.2, -0.3);
        assert_eq!(pose.mirrored().mirrored(), pose);
    }
}
