//! Which parts of the top-hat are fingers, and where their axes lie.

use super::{FingerPart, FingerTuning, centres};
use crate::geometry::{distance, dot, facing, line_direction, mean, minus, moved, quarter_turn};
use crate::mask::Mask;
use crate::wrist::{InscribedCircle, cross_section};

/// The finger whose free part is `part`; `None` if it is not shaped like one.
pub(super) fn measure(
    hand: &Mask,
    palm: &InscribedCircle,
    part: &Mask,
    tuning: &FingerTuning,
) -> Option<FingerPart> {
    let points = centres(part);
    let anchor = mean(&points);
    let direction = facing(line_direction(&points)?, minus(anchor, palm.centre));
    let mut axis = Axis { anchor, direction, radius: 0.0 };
    for _ in 0..tuning.rounds {
        axis = axis.refined(hand, palm, axis.extent(points.iter()), tuning)?;
    }
    let (low, high) = axis.ends(&points, tuning);
    let [base, tip] = [low, high].map(|s| moved(axis.anchor, axis.direction, s));
    let finger = FingerPart { base, tip, axis: axis.direction, length: high - low, radius: axis.radius };
    is_finger(&finger, palm, tuning).then_some(finger)
}

/// The axis of a finger, and its radius.
struct Axis {
    anchor: [f64; 2],
    direction: [f64; 2],
    radius: f64,
}

impl Axis {
    /// The range of points along the axis, from the anchor.
    fn extent<'a>(&self, points: impl Iterator<Item = &'a [f64; 2]>) -> (f64, f64) {
        let along = points.map(|p| dot(minus(*p, self.anchor), self.direction));
        along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    }

    /// The line through the middles of the cross-sections between `low` and `high`, half their median width: it
    /// follows a finger better than the inertia axis of its free part, which the slanting base turns.
    fn refined(
        &self,
        hand: &Mask,
        palm: &InscribedCircle,
        (low, high): (f64, f64),
        tuning: &FingerTuning,
    ) -> Option<Self> {
        let mut middles = Vec::new();
        let mut widths = Vec::new();
        for k in 0..tuning.sections {
            let share = (k as f64 + 0.5) / tuning.sections as f64;
            let s = low + (high - low) * (tuning.sections_from + tuning.sections_span * share);
            let at = moved(self.anchor, self.direction, s);
            let section = cross_section(hand, at, self.direction, tuning.reach * palm.radius);
            let Some((left, right)) = section else { continue };
            let middle = 0.5 * (left + right);
            let narrow = right - left < tuning.max_width * palm.radius;
            if narrow && middle.abs() < tuning.max_offset * palm.radius {
                middles.push(moved(at, quarter_turn(self.direction), middle));
                widths.push(right - left);
            }
        }
        if middles.len() < tuning.min_sections {
            return None;
        }
        widths.sort_by(f64::total_cmp);
        let median = widths.get(widths.len() / 2).copied().unwrap_or(0.0);
        let direction = facing(line_direction(&middles)?, self.direction);
        Some(Self { anchor: mean(&middles), direction, radius: 0.5 * median })
    }

    /// Base and tip along the axis, from the anchor.
    fn ends(&self, points: &[[f64; 2]], tuning: &FingerTuning) -> (f64, f64) {
        // The base is where the middle of the finger leaves the palm, not the deepest corner of the residue.
        let near_axis = |p: &&[f64; 2]| {
            let off = dot(minus(**p, self.anchor), quarter_turn(self.direction));
            off.abs() < tuning.base_offset * self.radius.max(1.0)
        };
        let inner = self.extent(points.iter().filter(near_axis));
        let (low, high) = if inner.0 < inner.1 { inner } else { self.extent(points.iter()) };
        // Pixels are squares: the outline lies half a pixel beyond the outermost centre.
        (low - 0.5, high + 0.5)
    }
}

/// Whether it has the proportions of a finger and points away from the palm.
fn is_finger(finger: &FingerPart, palm: &InscribedCircle, tuning: &FingerTuning) -> bool {
    let from_palm = |p: [f64; 2]| distance(p, palm.centre) / palm.radius;
    let (base, tip) = (from_palm(finger.base), from_palm(finger.tip));
    let [thinnest, thickest] = tuning.radii.map(|r| r * palm.radius);
    tip > tuning.min_tip
        && tip > base + tuning.min_outward
        && finger.length > tuning.min_elongation * 2.0 * finger.radius
        && finger.length > tuning.min_length * palm.radius
        && finger.radius < thickest
        && finger.radius > thinnest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A palm with a finger to the right; the part is what lies beyond the palm.
    fn finger_of(width: f64, length: f64) -> Option<FingerPart> {
        let palm = InscribedCircle { centre: [60.0, 60.0], radius: 40.0 };
        let beyond = |x: u32| f64::from(x) + 0.5 > 100.0;
        let inside = |x: u32, y: u32| {
            let (x, y) = (f64::from(x) + 0.5 - 60.0, f64::from(y) + 0.5 - 60.0);
            x.hypot(y) < 40.0 || (0.0..40.0 + length).contains(&x) && y.abs() < 0.5 * width
        };
        let hand = Mask::from_fn(240, 120, inside);
        let part = Mask::from_fn(240, 120, |x, y| beyond(x) && inside(x, y));
        measure(&hand, &palm, &part, &FingerTuning::default())
    }

    #[test]
    fn a_bar_on_a_palm_is_a_finger_of_its_size() {
        let finger = finger_of(18.0, 60.0).unwrap();
        assert!(distance(finger.base, [100.0, 60.0]) < 1.0, "{finger:?}");
        assert!(distance(finger.tip, [160.0, 60.0]) < 1.0, "{finger:?}");
        assert!(distance(finger.axis, [1.0, 0.0]) < 1e-6, "{finger:?}");
        assert!((finger.radius - 9.0).abs() < 0.6 && (finger.length - 60.0).abs() < 1.0, "{finger:?}");
    }

    #[test]
    fn stumps_slabs_and_threads_are_not_fingers() {
        assert_eq!(finger_of(18.0, 14.0), None);
        assert_eq!(finger_of(50.0, 52.0), None);
        assert_eq!(finger_of(3.0, 60.0), None);
    }
}
