//! The state of one hand: 29 joint angles and 6 global values.

use std::fmt;
use std::ops::Range;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::de::{Error as _, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

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
    /// How many there are.
    pub const COUNT: usize = 5;
    /// All five, thumb first.
    pub const ALL: [Finger; Finger::COUNT] =
        [Finger::Thumb, Finger::Index, Finger::Middle, Finger::Ring, Finger::Pinky];
    /// How many free angles each has.
    pub const FREE_ANGLES: usize = 3;
    /// The four long fingers, index first.
    pub const LONG: [Finger; 4] = [Finger::Index, Finger::Middle, Finger::Ring, Finger::Pinky];

    /// The name used in files: `thumb`, `index`, `middle`, `ring`, `pinky`.
    pub fn name(self) -> &'static str {
        ["thumb", "index", "middle", "ring", "pinky"][self as usize]
    }

    /// Its part of [`FreeAngles`](super::FreeAngles): flexion and abduction at its base, and flexion after it (PIP;
    /// of the thumb IP).
    pub fn range(self) -> Range<usize> {
        self.free_base()..self.free_base() + Self::FREE_ANGLES
    }

    /// Place of the flexion at its base among the free angles: MCP, or CMC of the thumb.
    pub fn free_base(self) -> usize {
        Self::FREE_ANGLES * self as usize
    }

    /// Place of the abduction at its base among the free angles.
    pub fn free_abduction(self) -> usize {
        self.free_base() + 1
    }

    /// Place of the flexion after its base among the free angles: PIP, or IP of the thumb.
    pub fn free_outer(self) -> usize {
        self.free_base() + 2
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
            /// How many there are.
            pub const COUNT: usize = [$(JointAngle::$name),*].len();
            /// All of them, in BAP order.
            pub const ALL: [JointAngle; JointAngle::COUNT] = [$(JointAngle::$name),*];

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

/// Values of all joint angles in the order of [`JointAngle::ALL`], radians unless it is said otherwise.
pub type JointAngles = [f64; JointAngle::COUNT];

/// One hand at one instant.
///
/// In files: `{"hand":"right","wrist":{"translation":[x,y,z],"rotation":[x,y,z,w]},"angles":{…}}`, angles
/// in degrees by name with the zeros left out, rounded to 1e-5 degree, 0.1 micrometre and 1e-8.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PoseData", into = "PoseData")]
pub struct HandPose {
    /// Left or right.
    pub side: Side,
    /// Wrist position in the camera frame, metres: +X right, +Y up, +Z towards the viewer.
    pub translation: Vector3<f64>,
    /// Rotation from the hand frame (see [`crate`]) to the camera frame.
    pub rotation: UnitQuaternion<f64>,
    /// Joint angles in radians, indexed by [`JointAngle::index`].
    pub angles: JointAngles,
}

impl HandPose {
    /// All angles zero, wrist at the origin, palm towards the viewer, fingers up.
    pub fn neutral(side: Side) -> Self {
        Self {
            side,
            translation: Vector3::zeros(),
            rotation: UnitQuaternion::identity(),
            angles: [0.0; JointAngle::COUNT],
        }
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

    /// The pose a fraction `s` of the way to `other`: angles and translation linearly, the rotation on
    /// the shorter great circle. The side is that of `self`.
    #[must_use]
    pub fn interpolated(&self, other: &Self, s: f64) -> Self {
        let turn = self.rotation.rotation_to(&other.rotation).scaled_axis();
        Self {
            side: self.side,
            translation: self.translation.lerp(&other.translation, s),
            rotation: UnitQuaternion::from_scaled_axis(turn * s) * self.rotation,
            angles: std::array::from_fn(|i| self.angles[i] + s * (other.angles[i] - self.angles[i])),
        }
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.angles.iter().all(|a| a.is_finite())
            && self.translation.iter().all(|v| v.is_finite())
            && self.rotation.coords.iter().all(|v| v.is_finite())
    }

    /// That place and angles are within what files may hold.
    pub(crate) fn check_range(&self) -> Result<(), String> {
        if let Some(v) = self.translation.iter().find(|v| !(-1000.0..=1000.0).contains(*v)) {
            return Err(format!("wrist translation {v} m, allowed -1000 to 1000 m"));
        }
        let degrees = |angle: JointAngle| self.angles[angle as usize].to_degrees();
        // A full turn is one after it has been converted there and back, too.
        let turn = -360.0 - 1e-9..=360.0 + 1e-9;
        match JointAngle::ALL.into_iter().find(|&angle| !turn.contains(&degrees(angle))) {
            Some(angle) => {
                Err(format!("{} is {} degrees, allowed -360 to 360", angle.name(), degrees(angle)))
            }
            None => Ok(()),
        }
    }
}

/// The form a [`HandPose`] has in files.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PoseData {
    /// Left or right.
    pub hand: Side,
    /// Where the wrist is.
    #[serde(default)]
    pub wrist: WristData,
    /// Joint angles.
    #[serde(default)]
    pub angles: Degrees,
}

/// Where a wrist is, in files.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct WristData {
    /// Metres.
    pub translation: [f64; 3],
    /// Unit quaternion (x, y, z, w).
    pub rotation: [f64; 4],
}

/// Joint angles in degrees; in files by name, zeros left out.
#[derive(Clone, Debug, Default)]
pub struct Degrees(pub JointAngles);

impl Default for WristData {
    fn default() -> Self {
        Self { translation: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] }
    }
}

/// Rounded to a multiple of 1/`per_unit`; minus zero becomes zero.
fn rounded(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit + 0.0
}

impl From<&HandPose> for PoseData {
    fn from(pose: &HandPose) -> Self {
        let q = pose.rotation.coords;
        Self {
            hand: pose.side,
            wrist: WristData {
                translation: pose.translation.map(|v| rounded(v, 1e7)).into(),
                rotation: [q.x, q.y, q.z, q.w].map(|v| rounded(v, 1e8)),
            },
            angles: Degrees(pose.angles.map(|a| rounded(a.to_degrees(), 1e5))),
        }
    }
}

impl From<HandPose> for PoseData {
    fn from(pose: HandPose) -> Self {
        Self::from(&pose)
    }
}

impl TryFrom<PoseData> for HandPose {
    type Error = String;

    fn try_from(data: PoseData) -> Result<Self, String> {
        let [x, y, z, w] = data.wrist.rotation;
        let rotation = Quaternion::new(w, x, y, z);
        let norm = rotation.norm();
        if !(0.999..=1.001).contains(&norm) {
            return Err(format!("wrist rotation has norm {norm}, allowed 0.999 to 1.001"));
        }
        let pose = Self {
            side: data.hand,
            translation: Vector3::from(data.wrist.translation),
            rotation: UnitQuaternion::new_normalize(rotation),
            angles: data.angles.0.map(f64::to_radians),
        };
        pose.check_range()?;
        Ok(pose)
    }
}

impl Serialize for Degrees {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for (angle, value) in JointAngle::ALL.into_iter().zip(self.0) {
            if value != 0.0 {
                map.serialize_entry(angle.name(), &value)?;
            }
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for Degrees {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(ByName)
    }
}

/// Reads angles by name.
struct ByName;

impl<'de> Visitor<'de> for ByName {
    type Value = Degrees;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a map from joint angle names to degrees")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Degrees, A::Error> {
        let mut angles = [None; JointAngle::COUNT];
        while let Some(Name(angle)) = map.next_key()? {
            if angles[angle.index()].replace(map.next_value::<f64>()?).is_some() {
                return Err(A::Error::custom(format!("{} is given twice", angle.name())));
            }
        }
        Ok(Degrees(angles.map(Option::unwrap_or_default)))
    }
}

/// The name of an angle, which is not kept.
struct Name(JointAngle);

impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_str(NameVisitor)
    }
}

struct NameVisitor;

impl Visitor<'_> for NameVisitor {
    type Value = Name;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("the name of a joint angle")
    }

    fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<Name, E> {
        let angle = JointAngle::from_name(name);
        angle.map(Name).ok_or_else(|| E::custom(format!("no joint angle is called {name:?}")))
    }
}

/// A vector mirrored in the plane x = 0.
pub fn mirror_vector(v: Vector3<f64>) -> Vector3<f64> {
    Vector3::new(-v.x, v.y, v.z)
}

/// A rotation conjugated with the mirror x → −x.
pub fn mirror_rotation(q: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
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
    fn interpolation_takes_the_short_way() {
        let mut a = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, 10.0);
        let mut b = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, 30.0);
        a.rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, 3.0);
        b.rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, -3.0);
        let mid = a.interpolated(&b, 0.5);
        assert!((mid.angle(JointAngle::Index1Flexion).to_degrees() - 20.0).abs() < 1e-12);
        assert!((mid.rotation.angle() - std::f64::consts::PI).abs() < 1e-9);
        assert!((a.interpolated(&b, 1.0).rotation.angle_to(&b.rotation)) < 1e-9);
    }

    #[test]
    fn files_name_angles_in_degrees() {
        let pose = HandPose::neutral(Side::Left).with_degrees(JointAngle::Thumb3Flexion, 12.5);
        let text = serde_json::to_string(&pose).unwrap();
        assert!(text.contains(r#""angles":{"thumb3_flexion":12.5}"#), "{text}");
        assert!(text.contains(r#""hand":"left""#), "{text}");
        assert_eq!(serde_json::from_str::<HandPose>(&text).unwrap(), pose);
        let refused = |text: &str| serde_json::from_str::<HandPose>(text).unwrap_err().to_string();
        assert!(refused(r#"{"hand":"left","angles":{"thumb4_flexion":1}}"#).contains("thumb4_flexion"));
        let twice = r#"{"hand":"left","angles":{"thumb2_flexion":1,"thumb2_flexion":2}}"#;
        assert!(refused(twice).contains("twice"));
        assert!(refused(r#"{"hand":"left","angles":{"thumb2_flexion":400}}"#).contains("400"));
        let spun = r#"{"hand":"left","wrist":{"translation":[0,0,0],"rotation":[0,0,0,2]}}"#;
        assert!(refused(spun).contains("norm 2"));
    }

    #[test]
    fn mirroring_twice_is_identity() {
        let mut pose = HandPose::neutral(Side::Right);
        pose.rotation = UnitQuaternion::from_euler_angles(0.3, -0.7, 1.1);
        pose.translation = Vector3::new(0.1, 0.2, -0.3);
        assert_eq!(pose.mirrored().mirrored(), pose);
    }
}
