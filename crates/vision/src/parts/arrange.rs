//! The order of five fingers, and what the hand measures with them.

use super::{Chirality, FingerPart, HandParts, InertiaAxis, PartsError, PartsTuning, ThumbTuning, centres};
use crate::geometry::{
    cross, crossing, distance, dot, facing, line_direction, mean, minus, moved, pixel_centre, unit,
};
use crate::mask::Mask;
use crate::segment::Silhouette;
use crate::wrist::{InscribedCircle, cross_section};

/// Puts five fingers in order and measures what follows from it; `rest` is the hand without them.
pub(super) fn arrange(
    silhouette: &Silhouette,
    mut fingers: [FingerPart; 5],
    rest: Mask,
    thumb: Option<Chirality>,
    tuning: &PartsTuning,
) -> Result<HandParts, PartsError> {
    let palm = silhouette.palm.ok_or(PartsError::NoHand)?;
    let ahead = ahead(silhouette, &fingers, &palm).ok_or(PartsError::NoHand)?;
    sort_round(&mut fingers, &palm, ahead);
    let (chirality, thumb_margin) = side_of_thumb(&fingers, &palm, thumb, &tuning.thumb)?;
    if chirality == Chirality::RightPalmOrLeftBack {
        fingers.reverse();
    }
    let [first, four @ ..] = &fingers;
    let inertia = inertia_without(&silhouette.hand, first, ahead, &tuning.thumb).ok_or(PartsError::NoHand)?;
    let wrist_by_axes = wrist_by_axes(&inertia, four, &palm, tuning);
    let wrist = silhouette.wrist.map_or(wrist_by_axes, |w| w.centre);
    let webs = mean(&four.map(|f| f.base));
    let axis = unit(minus(webs, wrist)).unwrap_or(inertia.direction);
    let level = [0, 1].map(|i| 0.5 * (webs[i] + palm.centre[i]));
    let palm_width = cross_section(&rest, level, axis, tuning.width_reach * palm.radius)
        .map_or(2.0 * palm.radius, |(left, right)| right - left);
    let free = fingers.iter().zip(tuning.free_lengths);
    let shown = free.map(|(f, full)| (f.length / (full * palm.radius)).min(1.0));
    Ok(HandParts {
        palm_length: distance(fingers[2].base, wrist),
        openness: shown.sum::<f64>() / 5.0,
        fingers,
        palm: rest,
        palm_circle: palm,
        palm_width,
        wrist,
        wrist_by_axes,
        axis,
        inertia,
        chirality,
        thumb_margin,
    })
}

/// Direction away from the wrist if it is known, else towards the middle of the fingers: either way the gap in the
/// circle of fingers lies behind.
fn ahead(silhouette: &Silhouette, fingers: &[FingerPart], palm: &InscribedCircle) -> Option<[f64; 2]> {
    match &silhouette.wrist {
        Some(wrist) => Some(wrist.axis),
        None => unit(fingers.iter().fold([0.0; 2], |sum, f| moved(sum, minus(f.base, palm.centre), 1.0))),
    }
}

/// Sorts fingers by the direction of their bases from the palm's centre, clockwise on the screen.
fn sort_round(fingers: &mut [FingerPart], palm: &InscribedCircle, ahead: [f64; 2]) {
    let angle = |f: &FingerPart| {
        let d = minus(f.base, palm.centre);
        cross(ahead, d).atan2(dot(ahead, d))
    };
    fingers.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
}

/// The side of the thumb, and by how much it stands off farther than the little finger, palm radii; of fingers sorted
/// clockwise.
fn side_of_thumb(
    [first, second, middle, fourth, last]: &[FingerPart; 5],
    palm: &InscribedCircle,
    known: Option<Chirality>,
    tuning: &ThumbTuning,
) -> Result<(Chirality, f64), PartsError> {
    let stands_off = |outer: &FingerPart, neighbour: &FingerPart| {
        let gap = distance(outer.base, neighbour.base) / palm.radius;
        let turn = cross(outer.axis, neighbour.axis).atan2(dot(outer.axis, neighbour.axis)).abs();
        let height = dot(minus(outer.base, palm.centre), middle.axis) / palm.radius;
        gap + tuning.turn_weight * turn - tuning.height_weight * height
    };
    let (left, right) = (stands_off(first, second), stands_off(last, fourth));
    let margin = (left - right).abs();
    if margin > tuning.max_margin {
        return Err(PartsError::FingersMissing { found: 4 });
    }
    // Seen with the fingers up, the last clockwise is on the right.
    let seen = if right > left { Chirality::RightPalmOrLeftBack } else { Chirality::LeftPalmOrRightBack };
    let chirality = if margin >= tuning.min_margin { Some(seen) } else { known };
    Ok((chirality.ok_or(PartsError::ThumbUnclear)?, margin))
}

/// Inertia axis of a hand without its thumb, within a right angle of `ahead`.
fn inertia_without(
    hand: &Mask,
    thumb: &FingerPart,
    ahead: [f64; 2],
    tuning: &ThumbTuning,
) -> Option<InertiaAxis> {
    let mut rest = hand.clone();
    rest.subtract(&Mask::from_fn(hand.width(), hand.height(), |x, y| {
        let d = minus(pixel_centre(x, y), thumb.base);
        dot(d, thumb.axis) > 0.0 && cross(d, thumb.axis).abs() < tuning.half_width * thumb.radius
    }));
    let direction = facing(line_direction(&centres(&rest))?, ahead);
    Some(InertiaAxis { centroid: rest.centroid()?, direction })
}

/// The wrist as the mean of the crossings of the hand's inertia axis with the axes of the four fingers (paper, 5.1);
/// a radius behind the palm's centre where none of them crosses it near there.
fn wrist_by_axes(
    inertia: &InertiaAxis,
    four: &[FingerPart; 4],
    palm: &InscribedCircle,
    tuning: &PartsTuning,
) -> [f64; 2] {
    let [nearest, farthest] = tuning.crossing_range;
    let hand = [inertia.centroid, inertia.direction];
    let crossings: Vec<[f64; 2]> = four
        .iter()
        .filter_map(|f| crossing(hand, [f.base, f.axis], tuning.min_crossing))
        .filter(|p| {
            let behind = dot(minus(palm.centre, *p), inertia.direction) / palm.radius;
            (nearest..farthest).contains(&behind)
        })
        .collect();
    if crossings.is_empty() {
        return moved(palm.centre, inertia.direction, -palm.radius);
    }
    mean(&crossings)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fingers up from a palm of 40 pixels, from left to right; the first is a thumb.
    fn spread() -> [FingerPart; 5] {
        [(-130.0, 30.0), (-35.0, 60.0), (0.0, 70.0), (25.0, 60.0), (50.0, 45.0)].map(|(degrees, length)| {
            let angle = f64::to_radians(0.5 * degrees);
            let axis = [angle.sin(), -angle.cos()];
            let base = moved([100.0, 100.0], axis, if degrees < -100.0 { 38.0 } else { 48.0 });
            FingerPart { base, tip: moved(base, axis, length), axis, length, radius: 8.0 }
        })
    }

    const PALM: InscribedCircle = InscribedCircle { centre: [100.0, 100.0], radius: 40.0 };

    #[test]
    fn fingers_are_sorted_clockwise_and_the_thumb_stands_off() {
        let sorted = spread();
        let mut fingers = spread();
        (fingers[0], fingers[1], fingers[4]) = (sorted[4], sorted[0], sorted[1]);
        sort_round(&mut fingers, &PALM, [0.0, -1.0]);
        assert_eq!(fingers, sorted);
        let tuning = ThumbTuning::default();
        let (chirality, margin) = side_of_thumb(&sorted, &PALM, None, &tuning).unwrap();
        assert_eq!(chirality, Chirality::LeftPalmOrRightBack);
        assert!(margin > 0.3, "{margin}");
        // Out of the same margin, what is known decides.
        let strict = ThumbTuning { min_margin: 2.0 * margin, ..tuning };
        assert_eq!(side_of_thumb(&sorted, &PALM, None, &strict), Err(PartsError::ThumbUnclear));
        let narrow = ThumbTuning { max_margin: 0.9 * margin, ..tuning };
        let missing = PartsError::FingersMissing { found: 4 };
        assert_eq!(side_of_thumb(&sorted, &PALM, None, &narrow), Err(missing));
        let known = Chirality::RightPalmOrLeftBack;
        assert_eq!(side_of_thumb(&sorted, &PALM, Some(known), &strict), Ok((known, margin)));
    }

    #[test]
    fn the_wrist_is_where_the_axes_cross() {
        let four = [-20.0f64, -7.0, 9.0, 22.0].map(|degrees| {
            let angle = degrees.to_radians();
            let axis = [angle.sin(), -angle.cos()];
            let base = moved([100.0, 150.0], axis, 90.0);
            FingerPart { base, tip: moved(base, axis, 60.0), axis, length: 60.0, radius: 8.0 }
        });
        let inertia = InertiaAxis { centroid: [100.0, 95.0], direction: [0.0, -1.0] };
        let tuning = PartsTuning::default();
        assert!(distance(wrist_by_axes(&inertia, &four, &PALM, &tuning), [100.0, 150.0]) < 1e-9);
        // Parallel axes do not cross: a radius behind the palm's centre.
        let parallel = four.map(|f| FingerPart { axis: [0.0, -1.0], ..f });
        assert_eq!(wrist_by_axes(&inertia, &parallel, &PALM, &tuning), [100.0, 140.0]);
    }
}
