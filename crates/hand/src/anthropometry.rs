//! Which sizes go together: the 21 anthropometric constraints of the paper's 3.2 and 4.1.
//!
//! Eq. (1): (ratio − δ) L ≤ length ≤ (ratio + δ) L, L being the hand's length. The table is
//! `spec/anthropometry.csv`, with the source of each row. The δ the paper prints for eight of them are a
//! few thousandths, less than real hands differ: they are kept as printed ([`Bounds::Printed`]), and
//! [`Bounds::Persons`] allows a spread of our own, wide enough for healthy adults.

use std::fmt;

use thiserror::Error;

use super::morphology::BONE_RATIOS;
use super::{Finger, Morphology};

/// A finger begins on the outside a little beyond the centre of its joint: by this share of its first
/// phalanx. It reconciles the paper's finger lengths with the bones (middle finger: 0.512 against 0.544).
pub const ROOT: f64 = 0.12;

/// A size that one of the 21 constraints is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// Breadth of the palm at the knuckles of index and little finger, skin to skin.
    PalmWidth,
    /// Wrist to the root of the middle finger.
    PalmLength,
    /// Root to tip of a finger; of the thumb its two phalanges.
    FingerLength(Finger),
    /// A phalanx, 1 next to the palm; the thumb has two.
    Phalanx(Finger, usize),
}

impl Measure {
    /// The name in the table, e.g. `index_phalanx2`.
    pub fn name(self) -> String {
        match self {
            Measure::PalmWidth => "palm_width".into(),
            Measure::PalmLength => "palm_length".into(),
            Measure::FingerLength(f) => format!("{}_length", f.name()),
            Measure::Phalanx(f, k) => format!("{}_phalanx{k}", f.name()),
        }
    }

    /// Its value on a hand, metres.
    pub fn of(self, m: &Morphology) -> f64 {
        match self {
            Measure::PalmWidth => {
                let (index, pinky) = (m.finger(Finger::Index), m.finger(Finger::Pinky));
                (index.base_vector() - pinky.base_vector()).norm() + index.radii[0] + pinky.radii[0]
            }
            Measure::PalmLength => {
                let middle = m.finger(Finger::Middle);
                middle.base[1] + ROOT * middle.bones[0]
            }
            Measure::FingerLength(finger) => outer_length(finger, &m.finger(finger).bones),
            Measure::Phalanx(finger, k) => phalanges(finger, &m.finger(finger).bones)[k - 1],
        }
    }
}

impl fmt::Display for Measure {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Measure::PalmWidth => f.write_str("palm width"),
            Measure::PalmLength => f.write_str("palm length"),
            Measure::FingerLength(finger) => write!(f, "length of the {}", long_name(*finger)),
            Measure::Phalanx(finger, k) => {
                write!(f, "{} phalanx of the {}", ["1st", "2nd", "3rd"][(k - 1).min(2)], long_name(*finger))
            }
        }
    }
}

fn long_name(finger: Finger) -> &'static str {
    ["thumb", "index finger", "middle finger", "ring finger", "little finger"][finger as usize]
}

/// The bones that are phalanges: not the thumb's metacarpal.
fn phalanges(finger: Finger, bones: &[f64; 3]) -> &[f64] {
    if finger == Finger::Thumb { &bones[1..] } else { bones }
}

/// Root to tip, from the bones.
fn outer_length(finger: Finger, bones: &[f64; 3]) -> f64 {
    let p = phalanges(finger, bones);
    p.iter().sum::<f64>() - ROOT * p[0]
}

/// One row of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constraint {
    /// What it is about.
    pub measure: Measure,
    /// Mean, as a fraction of the hand's length.
    pub ratio: f64,
    /// δ as the paper prints it.
    pub printed: Option<f64>,
    /// δ that healthy adults keep (ours).
    pub spread: f64,
}

/// The 21 constraints: palm, finger lengths, phalanges; `spec/anthropometry.csv` has the sources.
pub const CONSTRAINTS: [Constraint; 21] = {
    use Finger::*;
    use Measure::*;
    const fn row(measure: Measure, ratio: f64, printed: Option<f64>, spread: f64) -> Constraint {
        Constraint { measure, ratio, printed, spread }
    }
    [
        row(PalmWidth, 0.440, Some(0.007), 0.060),
        row(PalmLength, 0.496, Some(0.003), 0.060),
        row(FingerLength(Thumb), 0.330, None, 0.060),
        row(FingerLength(Index), 0.449, Some(0.002), 0.055),
        row(FingerLength(Middle), 0.512, Some(0.004), 0.055),
        row(FingerLength(Ring), 0.494, Some(0.007), 0.060),
        row(FingerLength(Pinky), 0.390, None, 0.060),
        row(Phalanx(Thumb, 1), 0.196, None, 0.040),
        row(Phalanx(Thumb, 2), 0.158, None, 0.045),
        row(Phalanx(Index, 1), 0.245, Some(0.001), 0.040),
        row(Phalanx(Index, 2), 0.143, None, 0.030),
        row(Phalanx(Index, 3), 0.097, None, 0.025),
        row(Phalanx(Middle, 1), 0.266, None, 0.040),
        row(Phalanx(Middle, 2), 0.170, Some(0.003), 0.035),
        row(Phalanx(Middle, 3), 0.108, None, 0.030),
        row(Phalanx(Ring, 1), 0.244, None, 0.040),
        row(Phalanx(Ring, 2), 0.165, None, 0.035),
        row(Phalanx(Ring, 3), 0.107, Some(0.003), 0.030),
        row(Phalanx(Pinky, 1), 0.204, None, 0.045),
        row(Phalanx(Pinky, 2), 0.117, None, 0.030),
        row(Phalanx(Pinky, 3), 0.093, None, 0.025),
    ]
};

/// How far a size may lie from its mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bounds {
    /// As healthy adults do.
    #[default]
    Persons,
    /// By the δ the paper prints, where it prints one.
    Printed,
}

/// A constraint that a hand does not keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Violation {
    /// The size.
    pub measure: Measure,
    /// Its value, metres.
    pub value: f64,
    /// The hand's length, metres.
    pub hand_length: f64,
    /// Smallest allowed value, metres.
    pub min: f64,
    /// Largest allowed value, metres.
    pub max: f64,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let mm = |v: f64| v * 1e3;
        write!(
            f,
            "{} is {:.1} mm; on a hand of {:.0} mm it is usually {:.1} to {:.1} mm",
            self.measure,
            mm(self.value),
            mm(self.hand_length),
            mm(self.min),
            mm(self.max)
        )
    }
}

/// The constraints of eq. (1) that a hand does not keep.
pub fn check(morphology: &Morphology, bounds: Bounds) -> Vec<Violation> {
    let hand_length = morphology.hand_length;
    let violation = |c: &Constraint| {
        let delta = match bounds {
            Bounds::Persons => c.spread,
            Bounds::Printed => c.printed?,
        };
        let value = c.measure.of(morphology);
        let (min, max) = ((c.ratio - delta) * hand_length, (c.ratio + delta) * hand_length);
        let inside = (min..=max).contains(&value);
        (!inside).then_some(Violation { measure: c.measure, value, hand_length, min, max })
    };
    CONSTRAINTS.iter().filter_map(violation).collect()
}

/// Why bones cannot be completed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CompletionError {
    /// The bones that were measured leave no room for the others.
    #[error(
        "anthropometry: the {} is {:.1} mm long, and its measured bones leave {:.1} mm for the others",
        long_name(*finger),
        length * 1e3,
        left * 1e3
    )]
    NoRoom {
        /// Which finger.
        finger: Finger,
        /// Its measured length from root to tip, metres.
        length: f64,
        /// What the measured bones leave, metres.
        left: f64,
    },
}

/// The three bones of a finger, metres, from what was measured of it: bones that were not measured share
/// what the finger's length (root to tip; of the thumb without its metacarpal) leaves, in the proportion
/// of their means; without a length they get their mean share of the hand's length.
///
/// # Errors
/// [`CompletionError::NoRoom`] when less than a fifth of their mean share is left for them.
pub fn complete(
    finger: Finger,
    hand_length: f64,
    length: Option<f64>,
    measured: [Option<f64>; 3],
) -> Result<[f64; 3], CompletionError> {
    let mean = BONE_RATIOS[finger as usize].map(|r| r * hand_length);
    let mut bones: [f64; 3] = std::array::from_fn(|k| measured[k].unwrap_or(mean[k]));
    let Some(length) = length else { return Ok(bones) };
    let first = if finger == Finger::Thumb { 1 } else { 0 };
    let (mut left, mut share) = (length, 0.0);
    for k in first..3 {
        let weight = if k == first { 1.0 - ROOT } else { 1.0 };
        match measured[k] {
            Some(bone) => left -= weight * bone,
            None => share += weight * mean[k],
        }
    }
    if share > 0.0 {
        if !left.is_finite() || left < 0.2 * share {
            return Err(CompletionError::NoRoom { finger, length, left });
        }
        for k in first..3 {
            if measured[k].is_none() {
                bones[k] = mean[k] * left / share;
            }
        }
    }
    Ok(bones)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_table_is_the_one_in_spec() {
        let mut rows = include_str!("../../../spec/anthropometry.csv").lines().skip(1);
        for c in CONSTRAINTS {
            let row = rows.next().unwrap();
            let mut columns = row.splitn(5, ',');
            let mut column = || columns.next().unwrap();
            assert_eq!(column(), c.measure.name());
            assert_eq!(column().parse::<f64>().unwrap(), c.ratio, "{row}");
            assert_eq!(column().parse::<f64>().ok(), c.printed, "{row}");
            assert_eq!(column().parse::<f64>().unwrap(), c.spread, "{row}");
            assert_eq!(column().contains("paper 3.2"), c.printed.is_some(), "{row}");
        }
        assert_eq!(rows.next(), None);
        let count = |f: fn(&Measure) -> bool| CONSTRAINTS.iter().filter(|c| f(&c.measure)).count();
        assert_eq!(count(|m| matches!(m, Measure::FingerLength(_))), 5);
        assert_eq!(count(|m| matches!(m, Measure::Phalanx(..))), 14);
        assert_eq!(CONSTRAINTS.iter().filter(|c| c.printed.is_some()).count(), 8);
    }

    #[test]
    fn the_table_agrees_with_the_mean_bones() {
        for c in CONSTRAINTS {
            if let Measure::Phalanx(finger, k) = c.measure {
                assert_eq!(phalanges(finger, &BONE_RATIOS[finger as usize])[k - 1], c.ratio);
            }
        }
    }

    #[test]
    fn the_mean_hand_keeps_every_constraint_with_room() {
        for length in [0.15, 0.189, 0.22] {
            let m = Morphology::average(length);
            for c in CONSTRAINTS {
                let off = (c.measure.of(&m) / length - c.ratio).abs();
                assert!(off < 0.2 * c.spread, "{}: {off}", c.measure);
            }
        }
    }

    #[test]
    fn violations_speak_plainly() {
        let mut m = Morphology::average(0.2);
        m.fingers[1].bones[0] *= 1.3;
        let found = check(&m, Bounds::Persons);
        let text: Vec<_> = found.iter().map(ToString::to_string).collect();
        assert_eq!(text.len(), 2, "{text:?}");
        assert!(text[0].starts_with("length of the index finger is 1"), "{text:?}");
        assert_eq!(
            text[1],
            "1st phalanx of the index finger is 63.7 mm; on a hand of 200 mm it is usually 41.0 to 57.0 mm"
        );
        assert!(check(&m, Bounds::Printed).len() >= 2);
    }

    proptest! {
        #[test]
        fn completion_meets_the_measured_length(
            hand in 0.15f64..0.22,
            factor in 0.8f64..1.2,
            known in prop::array::uniform3(any::<bool>()),
            f in 0usize..5,
        ) {
            let finger = Finger::ALL[f];
            let mean = BONE_RATIOS[f].map(|r| r * hand);
            let length = factor * outer_length(finger, &mean);
            let measured = [0, 1, 2].map(|k| known[k].then_some(mean[k]));
            let Ok(bones) = complete(finger, hand, Some(length), measured) else { return Ok(()) };
            for k in 0..3 {
                prop_assert!(!known[k] || bones[k] == mean[k]);
                prop_assert!(bones[k] > 0.0);
            }
            let first = usize::from(finger == Finger::Thumb);
            if known[first..].iter().any(|k| !k) {
                prop_assert!((outer_length(finger, &bones) - length).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn bones_longer_than_the_finger_are_refused() {
        let error = complete(Finger::Ring, 0.19, Some(0.08), [Some(0.05), Some(0.04), None]).unwrap_err();
        assert!(error.to_string().contains("the ring finger is 80.0 mm long"), "{error}");
    }
}
