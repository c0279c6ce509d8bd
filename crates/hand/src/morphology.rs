//! The sizes of one person's hand.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{Finger, Side};

/// Sizes of one hand in metres, in the hand frame of a right hand (see [`crate`]). Angles play
/// no part here: every finger points along +Y, the thumb 45° towards +X, as in the standard's neutral pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Morphology {
    /// Wrist centre to the tip of the straight middle finger.
    pub hand_length: f64,
    /// Half the thickness of the palm.
    pub palm_radius: f64,
    /// Half the breadth of the wrist.
    pub wrist_half_width: f64,
    /// How far the skin between two neighbours reaches, as a fraction of the first bone after their
    /// bases: thumb and index, index and middle, middle and ring, ring and little finger.
    pub webs: [f64; 4],
    /// Where the skin between thumb and index finger meets the palm: 0 at the index finger's base, 1 at the thumb's.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub web_root: f64,
    /// How far the flesh below the little finger stands out beyond the straight line from its base to the wrist.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub ulnar_border: f64,
    /// How far to the thumb's side the middle of the wrist's breadth lies.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub wrist_lateral: f64,
    /// Breadth of the forearm a tenth of a hand length behind the wrist, as a fraction of the wrist's.
    #[serde(default = "as_broad", skip_serializing_if = "is_as_broad")]
    pub forearm: f64,
    /// Thumb, index, middle, ring and little finger; in files a table by [`Finger::name`].
    #[serde(with = "by_name")]
    pub fingers: [FingerMorphology; 5],
}

/// The five fingers as a table with their names.
mod by_name {
    use super::FingerMorphology;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Fingers<T> {
        thumb: T,
        index: T,
        middle: T,
        ring: T,
        pinky: T,
    }

    pub(super) fn serialize<S: Serializer>(fingers: &[FingerMorphology; 5], s: S) -> Result<S::Ok, S::Error> {
        let [thumb, index, middle, ring, pinky] = fingers;
        Fingers { thumb, index, middle, ring, pinky }.serialize(s)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<[FingerMorphology; 5], D::Error> {
        let Fingers { thumb, index, middle, ring, pinky } = Fingers::deserialize(d)?;
        Ok([thumb, index, middle, ring, pinky])
    }
}

/// Sizes of one finger in metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FingerMorphology {
    /// Where the metacarpal begins, relative to the wrist: the centre of the palm-end bend (`x0` of the
    /// standard); of the thumb the CMC joint.
    pub metacarpal: [f64; 3],
    /// The MCP joint of a long finger, relative to the wrist. Of the thumb the CMC joint again: its
    /// chain of three bones starts there.
    pub base: [f64; 3],
    /// Lengths of the three bones from `base` on: proximal, middle and distal phalanx; of the thumb
    /// metacarpal, proximal and distal phalanx.
    pub bones: [f64; 3],
    /// Radii at `base`, at the two joints after it and near the tip.
    pub radii: [f64; 4],
    /// Radii half way along the bones, as fractions of the mean of those at their ends.
    #[serde(default = "straight", skip_serializing_if = "is_straight")]
    pub waists: [f64; 3],
    /// How far to the thumb's side of the bones the middle of the flesh lies: at `base`, at the two joints after
    /// it, near the tip, and half way along the three bones.
    #[serde(default, skip_serializing_if = "are_zero")]
    pub lateral: [f64; 7],
}

fn straight() -> [f64; 3] {
    [1.0; 3]
}

fn is_straight(waists: &[f64; 3]) -> bool {
    *waists == straight()
}

fn as_broad() -> f64 {
    1.0
}

fn is_as_broad(forearm: &f64) -> bool {
    *forearm == as_broad()
}

fn is_zero(size: &f64) -> bool {
    *size == 0.0
}

fn are_zero(sizes: &[f64; 7]) -> bool {
    sizes.iter().all(is_zero)
}

/// One person's hand, as a person file holds it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// A name, or none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The hand that was measured; the sizes serve for both.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hand: Option<Side>,
    /// The sizes, metres.
    pub morphology: Morphology,
}

/// Why a morphology cannot be used.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MorphologyError {
    /// A size is not a finite number inside the allowed interval.
    #[error("morphology: {what} is {value} m, allowed {min} to {max} m")]
    Size {
        /// Which size.
        what: String,
        /// Its value, metres.
        value: f64,
        /// Smallest allowed value, metres.
        min: f64,
        /// Largest allowed value, metres.
        max: f64,
    },
    /// A fraction is not a finite number inside the allowed interval.
    #[error("morphology: {what} is {value}, allowed {} to {}", allowed[0], allowed[1])]
    Fraction {
        /// Which fraction.
        what: String,
        /// Its value.
        value: f64,
        /// Smallest and largest allowed value.
        allowed: [f64; 2],
    },
}

/// Bone lengths as fractions of hand length, thumb to little finger (Buchholz, Armstrong & Goldstein
/// 1992, the table the paper's 3.2 quotes from: index 1st 0.245, middle 2nd 0.170, ring 3rd 0.107).
pub(super) const BONE_RATIOS: [[f64; 3]; 5] = [
    [0.251, 0.196, 0.158],
    [0.245, 0.143, 0.097],
    [0.266, 0.170, 0.108],
    [0.244, 0.165, 0.107],
    [0.204, 0.117, 0.093],
];

/// Radii at the four stations of a finger as fractions of hand length: half the joint breadths of
/// hand anthropometry (proximal joint of the index about 20 mm on a hand of 188 mm), tips slimmer.
const RADIUS_RATIOS: [[f64; 4]; 5] = [
    [0.074, 0.060, 0.055, 0.043],
    [0.056, 0.051, 0.044, 0.037],
    [0.056, 0.051, 0.045, 0.038],
    [0.054, 0.048, 0.042, 0.036],
    [0.050, 0.042, 0.037, 0.031],
];

/// A long finger of the standard's suggested body (`spec/suggested-joints.csv`), metres in the hand frame: x,
/// and y of its joints 0 to 3. The joint 1 is the knuckle.
const SUGGESTED_LONG: [(f64, [f64; 4]); 4] = [
    (0.0230, [0.0670, 0.0879, 0.1334, 0.1559]),
    (-0.0020, [0.0647, 0.0858, 0.1404, 0.1666]),
    (-0.0282, [0.0627, 0.0831, 0.1359, 0.1601]),
    (-0.0521, [0.0556, 0.0756, 0.1170, 0.1345]),
];
/// x and y of the three joints of its thumb.
const SUGGESTED_THUMB: [[f64; 2]; 3] = [[0.0033, 0.0195], [0.0611, 0.0773], [0.0760, 0.0922]];
/// z of all joints of its hand but the wrist.
const SUGGESTED_PALMAR: f64 = 0.0060;

/// Palm breadth over hand length (paper 3.2). The suggested body's knuckles lie 0.40 of the hand's length
/// apart from index to little finger, which with the flesh around them makes a palm of 0.51; hands measured
/// with markers have 0.33 (spec/hand-model.md), which makes the paper's 0.44.
const PALM_WIDTH_RATIO: f64 = 0.440;

/// Smallest and largest of [`Morphology::webs`].
pub const WEB_LENGTHS: [f64; 2] = [0.0, 1.5];
/// Smallest and largest [`Morphology::web_root`].
pub const WEB_ROOTS: [f64; 2] = [-0.5, 0.9];
/// Smallest and largest [`Morphology::forearm`].
pub const FOREARMS: [f64; 2] = [0.4, 1.6];

/// Where the metacarpal of a knuckle begins when nobody measured it: the metacarpals fan out from the
/// carpal bones.
pub(super) fn metacarpal_of(mcp: [f64; 3]) -> [f64; 3] {
    [mcp[0] * 0.55, mcp[1] * 0.25, mcp[2] * 0.5]
}

impl Default for Morphology {
    /// The mean adult hand, 0.189 m from wrist to middle fingertip.
    fn default() -> Self {
        Self::average(0.189)
    }
}

impl Morphology {
    /// Shortest and longest hand, metres.
    pub const LENGTHS: [f64; 2] = [0.05, 0.40];

    /// Mean proportions at a hand length in metres: knuckles of the standard's suggested body drawn
    /// together to the mean palm's breadth, phalanges and radii in the ratios of published anthropometry.
    pub fn average(hand_length: f64) -> Self {
        let knuckles = SUGGESTED_LONG.map(|(x, y)| [x, y[1], SUGGESTED_PALMAR]);
        // The suggested palm and the phalanx ratios meet at this length: palm + 0.544 L = L.
        let suggested_length = knuckles[1][1] / (1.0 - 0.544);
        let palm = hand_length / suggested_length;
        let [index, .., pinky] = knuckles;
        let between = (PALM_WIDTH_RATIO - RADIUS_RATIOS[1][0] - RADIUS_RATIOS[4][0]) * suggested_length;
        let narrowing = (between.powi(2) - (index[1] - pinky[1]).powi(2)).sqrt() / (index[0] - pinky[0]);
        let fingers = std::array::from_fn(|f| {
            let (metacarpal, base) = if f == 0 {
                let cmc = [0.0180 * palm, 0.0190 * palm, 0.0080 * palm];
                (cmc, cmc)
            } else {
                let [x, y, z] = knuckles[f - 1].map(|v| v * palm);
                let mcp = [x * narrowing, y, z];
                (metacarpal_of(mcp), mcp)
            };
            FingerMorphology {
                metacarpal,
                base,
                bones: BONE_RATIOS[f].map(|r| r * hand_length),
                radii: RADIUS_RATIOS[f].map(|r| r * hand_length),
                waists: straight(),
                lateral: [0.0; 7],
            }
        });
        Self {
            hand_length,
            palm_radius: 0.068 * hand_length,
            wrist_half_width: 0.150 * hand_length,
            webs: [0.85, 0.36, 0.36, 0.36],
            web_root: 0.0,
            ulnar_border: 0.0,
            wrist_lateral: 0.0,
            forearm: as_broad(),
            fingers,
        }
    }

    /// The hand of the standard's suggested body: joint centres exactly as suggested. The standard leaves out
    /// the tips, so end phalanges have the mean's proportions, as have breadths and thicknesses.
    ///
    /// It is no likely hand (a thumb with bones of 82 and 21 mm; a palm of half the hand's length), hence
    /// not the default: see `spec/hand-model.md`.
    pub fn suggested_body() -> Self {
        let end = |finger: usize, hand_length: f64| BONE_RATIOS[finger][2] * hand_length;
        let hand_length = SUGGESTED_LONG[1].1[3] / (1.0 - BONE_RATIOS[2][2]);
        let mut out = Self::average(hand_length);
        let [cmc, mcp, ip] = SUGGESTED_THUMB;
        let between = |a: [f64; 2], b: [f64; 2]| (b[0] - a[0]).hypot(b[1] - a[1]);
        let [thumb, long @ ..] = &mut out.fingers;
        thumb.base = [cmc[0], cmc[1], SUGGESTED_PALMAR];
        thumb.metacarpal = thumb.base;
        thumb.bones = [between(cmc, mcp), between(mcp, ip), end(0, hand_length)];
        for (i, (finger, (x, y))) in long.iter_mut().zip(SUGGESTED_LONG).enumerate() {
            finger.metacarpal = [x, y[0], SUGGESTED_PALMAR];
            finger.base = [x, y[1], SUGGESTED_PALMAR];
            finger.bones = [y[2] - y[1], y[3] - y[2], end(i + 1, hand_length)];
        }
        out
    }

    /// The sizes of one finger.
    pub fn finger(&self, finger: Finger) -> &FingerMorphology {
        &self.fingers[finger as usize]
    }

    /// Every length multiplied by `factor`.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let mut out = self.clone();
        let of_palm = [
            &mut out.hand_length,
            &mut out.palm_radius,
            &mut out.wrist_half_width,
            &mut out.ulnar_border,
            &mut out.wrist_lateral,
        ];
        of_palm.into_iter().for_each(|v| *v *= factor);
        for finger in &mut out.fingers {
            let sizes = finger.metacarpal.iter_mut().chain(&mut finger.base).chain(&mut finger.bones);
            for v in sizes.chain(&mut finger.radii).chain(&mut finger.lateral) {
                *v *= factor;
            }
        }
        out
    }

    /// Checks that every size is finite and of human order: a hand of 5 to 40 cm, bones and radii
    /// positive and no longer than the hand.
    ///
    /// # Errors
    /// [`MorphologyError::Size`] for the first size outside its interval.
    pub fn validate(&self) -> Result<(), MorphologyError> {
        // Names are made for the message only: the fit validates thousands of hands.
        let check = |what: &dyn Fn() -> String, value: f64, min: f64, max: f64| {
            if value.is_finite() && (min..=max).contains(&value) {
                Ok(())
            } else {
                Err(MorphologyError::Size { what: what(), value, min, max })
            }
        };
        check(&|| "hand_length".into(), self.hand_length, Self::LENGTHS[0], Self::LENGTHS[1])?;
        let hand = self.hand_length;
        check(&|| "palm_radius".into(), self.palm_radius, 0.01 * hand, 0.5 * hand)?;
        check(&|| "wrist_half_width".into(), self.wrist_half_width, 0.02 * hand, 0.5 * hand)?;
        check(&|| "ulnar_border".into(), self.ulnar_border, -0.1 * hand, 0.1 * hand)?;
        check(&|| "wrist_lateral".into(), self.wrist_lateral, -0.1 * hand, 0.1 * hand)?;
        let fraction = |what: &dyn Fn() -> String, value: f64, allowed: [f64; 2]| {
            if value.is_finite() && (allowed[0]..=allowed[1]).contains(&value) {
                Ok(())
            } else {
                Err(MorphologyError::Fraction { what: what(), value, allowed })
            }
        };
        for (i, web) in self.webs.into_iter().enumerate() {
            fraction(&|| format!("webs[{i}]"), web, WEB_LENGTHS)?;
        }
        fraction(&|| "web_root".into(), self.web_root, WEB_ROOTS)?;
        fraction(&|| "forearm".into(), self.forearm, FOREARMS)?;
        for (finger, f) in Finger::ALL.into_iter().zip(&self.fingers) {
            let sizes = |of: &str, values: &[f64], min: f64, max: f64| {
                let named = |i: usize| format!("{} {of}[{i}]", finger.name());
                values.iter().enumerate().try_for_each(|(i, &v)| check(&|| named(i), v, min, max))
            };
            sizes("metacarpal", &f.metacarpal, -hand, hand)?;
            sizes("base", &f.base, -hand, hand)?;
            sizes("bones", &f.bones, 0.01 * hand, hand)?;
            sizes("radii", &f.radii, 0.005 * hand, 0.3 * hand)?;
            sizes("lateral", &f.lateral, -0.1 * hand, 0.1 * hand)?;
            for (i, waist) in f.waists.into_iter().enumerate() {
                fraction(&|| format!("{} waists[{i}]", finger.name()), waist, [0.3, 2.0])?;
            }
        }
        Ok(())
    }
}

impl FingerMorphology {
    /// Puts the metacarpal where it is likely to begin for the finger's base; of the thumb that is its base.
    pub fn place_metacarpal(&mut self, finger: Finger) {
        self.metacarpal = if finger == Finger::Thumb { self.base } else { metacarpal_of(self.base) };
    }

    /// Length from base to tip, metres.
    pub fn length(&self) -> f64 {
        self.bones.iter().sum()
    }

    /// `base` as a vector.
    pub fn base_vector(&self) -> Vector3<f64> {
        Vector3::from(self.base)
    }

    /// `metacarpal` as a vector.
    pub fn metacarpal_vector(&self) -> Vector3<f64> {
        Vector3::from(self.metacarpal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn average_hand_measures_its_length() {
        for length in [0.16, 0.189, 0.21] {
            let m = Morphology::average(length);
            let middle = m.finger(Finger::Middle);
            assert!((middle.base[1] + middle.length() - length).abs() < 1e-9);
            m.validate().unwrap();
        }
    }

    #[test]
    fn scaling_scales_everything() {
        let mut m = Morphology::average(0.2);
        let mut n = Morphology::average(0.1);
        (m.fingers[3].lateral[4], n.fingers[3].lateral[4]) = (0.004, 0.002);
        (m.ulnar_border, n.ulnar_border) = (0.004, 0.002);
        let n = n.scaled(2.0);
        let flat = |m: &Morphology| -> Vec<f64> {
            let mut v = vec![m.hand_length, m.palm_radius, m.wrist_half_width, m.ulnar_border];
            for f in &m.fingers {
                v.extend(
                    f.metacarpal.iter().chain(&f.base).chain(&f.bones).chain(&f.radii).chain(&f.lateral),
                );
            }
            v
        };
        for (a, b) in flat(&m).iter().zip(flat(&n)) {
            assert!((a - b).abs() < 1e-12);
        }
    }

    #[test]
    fn bad_sizes_are_named() {
        let mut m = Morphology::default();
        m.fingers[2].bones[1] = f64::NAN;
        let message = m.validate().unwrap_err().to_string();
        assert!(message.contains("middle bones[1]"), "{message}");
    }
}
