//! Where an arm enters the picture, and the circle of its palm.

use super::{BluntEndTuning, InscribedCircle, PalmTuning};
use crate::geometry::{distance, dot, minus, pixel_centre, unit};
use crate::mask::Mask;
use crate::morphology::{Components, DistanceMap, open_disc};

/// Where the arm comes from, the middle of the longest stretch of it along the image border, and how long the chord of
/// that stretch is, pixels.
pub(super) fn entry(arm: &Mask) -> Option<([f64; 2], f64)> {
    let (w, h) = (arm.width(), arm.height());
    if w < 2 || h < 2 {
        return None;
    }
    // Once round the border, clockwise from the upper left corner.
    let border: Vec<(u32, u32)> = (0..w)
        .map(|x| (x, 0))
        .chain((1..h).map(|y| (w - 1, y)))
        .chain((0..w - 1).rev().map(|x| (x, h - 1)))
        .chain((1..h - 1).rev().map(|y| (0, y)))
        .collect();
    let inside = |i: usize| border.get(i % border.len()).is_some_and(|p| arm.get(p.0, p.1));
    let start = (0..border.len()).find(|&i| !inside(i))?;
    let (mut best, mut run) = (None, 0usize);
    for i in start..=start + border.len() {
        if inside(i) {
            run += 1;
        } else {
            if run > 0 && best.is_none_or(|(length, _)| run > length) {
                best = Some((run, i - run));
            }
            run = 0;
        }
    }
    let (length, first) = best?;
    // Across a corner the middle of the chord, not of the way round it.
    let (a, b) = (border.get(first % border.len())?, border.get((first + length - 1) % border.len())?);
    let chord = distance(pixel_centre(a.0, a.1), pixel_centre(b.0, b.1)) + 1.0;
    Some(([a.0 + b.0, a.1 + b.1].map(|sum| (f64::from(sum) + 1.0) / 2.0), chord))
}

/// The arm in a frame of background a pixel wide, and where the frame begins: what lies outside the image counts as
/// background. An arm that runs along the border would else seem as thick as it could be.
fn framed(arm: &Mask) -> Option<(Mask, [f64; 2])> {
    let bounds = arm.bounds()?;
    let inner = arm.cropped(bounds);
    let mut framed = Mask::new(inner.width() + 2, inner.height() + 2);
    for y in 0..inner.height() {
        for (start, end) in inner.runs(y) {
            framed.fill_span(y + 1, start as i32 + 1, end as i32 + 1);
        }
    }
    Some((framed, [bounds.x0, bounds.y0].map(|v| f64::from(v) - 1.0)))
}

/// The circles inscribed in the arm round each of its pixels, in row order.
pub(super) fn inscribed_circles(arm: &Mask) -> Vec<InscribedCircle> {
    let Some((framed, [left, top])) = framed(arm) else { return Vec::new() };
    let map = DistanceMap::to_value(&framed, false);
    let mut out = Vec::with_capacity(arm.area() as usize);
    for y in 0..framed.height() {
        for (start, end) in framed.runs(y) {
            for x in start..end {
                let centre = [left + f64::from(x) + 0.5, top + f64::from(y) + 0.5];
                out.push(InscribedCircle { centre, radius: f64::from(map.squared(x, y)).sqrt() - 0.5 });
            }
        }
    }
    out
}

/// The largest of the circles; one without a radius at `centroid` where there are none.
pub(super) fn largest(circles: &[InscribedCircle], centroid: [f64; 2]) -> InscribedCircle {
    let none = InscribedCircle { centre: centroid, radius: 0.0 };
    circles.iter().fold(none, |most, c| if c.radius > most.radius { *c } else { most })
}

/// Direction to the fingers from the thickest place of an arm that ends within the picture (a sleeve, an elbow, a bar at
/// the picture's edge): of its two ends the one where a disc wider than a finger does not fit into whole parts of it. Into
/// a forearm it fits, and what it leaves of the corners of its end is small. `None` where no finger stands free.
pub(super) fn fingers_of(
    arm: &Mask,
    thickest: &InscribedCircle,
    tuning: &BluntEndTuning,
) -> Option<[f64; 2]> {
    let (mut thin, [left, top]) = framed(arm)?;
    thin.subtract(&open_disc(&thin, tuning.finger_radius * thickest.radius));
    let parts = Components::of(&thin, false);
    let least = tuning.min_finger_area * thickest.radius * thickest.radius;
    let (mut n, mut sum) = (0.0, [0.0; 2]);
    for (part, y, start, end) in parts.spans() {
        if parts.list.get(part).is_some_and(|p| f64::from(p.area) >= least) {
            let length = f64::from(end - start);
            n += length;
            sum[0] += length * (left + 0.5 * f64::from(start + end));
            sum[1] += length * (top + f64::from(y) + 0.5);
        }
    }
    if n == 0.0 {
        return None;
    }
    unit(minus(sum.map(|v| v / n), thickest.centre))
}

/// The same of a fist or closed fingers. Most of a hand lies on the side of its fingers, seen from the thickest place; but
/// what is longer there than a hand is a forearm.
pub(super) fn closed_end(
    circles: &[InscribedCircle],
    thickest: &InscribedCircle,
    centroid: [f64; 2],
    tuning: &BluntEndTuning,
) -> Option<[f64; 2]> {
    let most = unit(minus(centroid, thickest.centre))?;
    let far = circles.iter().map(|c| dot(minus(c.centre, thickest.centre), most)).fold(0.0, f64::max);
    Some(if far > tuning.hand_reach * thickest.radius { most.map(|v| -v) } else { most })
}

/// The first large circle met from the far end of the arm.
pub(super) fn first_palm(
    circles: &[InscribedCircle],
    axis: [f64; 2],
    tuning: &PalmTuning,
) -> Option<InscribedCircle> {
    let along = |c: &InscribedCircle| dot(c.centre, axis);
    let high = circles.iter().map(along).fold(f64::NEG_INFINITY, f64::max);
    let low = circles.iter().map(along).fold(f64::INFINITY, f64::min);
    if low > high {
        return None;
    }
    // The largest circle for every pixel of distance along the axis.
    let none = InscribedCircle { centre: [0.0; 2], radius: 0.0 };
    let mut slices = vec![none; (high - low) as usize + 1];
    for c in circles {
        if let Some(slice) = slices.get_mut((high - along(c)) as usize)
            && c.radius > slice.radius
        {
            *slice = *c;
        }
    }
    let mut best = none;
    for (s, slice) in slices.iter().enumerate() {
        let passed = s as f64 - (high - along(&best));
        if best.radius > 0.0 && passed > tuning.closed_lead * best.radius {
            break;
        }
        let needed = if passed > tuning.lead * best.radius { tuning.closed_growth } else { 1.0 };
        if slice.radius > needed * best.radius {
            best = *slice;
        }
    }
    (best.radius > 0.0).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_enters_where_it_crosses_the_border_also_across_a_corner() {
        let bar = Mask::from_fn(100, 80, |x, y| (30..50).contains(&x) && y > 20);
        assert_eq!(entry(&bar), Some(([40.0, 80.0 - 0.5], 20.0)));
        let corner = Mask::from_fn(100, 80, |x, y| x + y < 30);
        let (at, chord) = entry(&corner).unwrap();
        assert!((at[0] - at[1]).abs() < 1e-9 && (at[0] - 15.0).abs() < 1.0, "{at:?}");
        assert!((chord - 29.0 * 2f64.sqrt() - 1.0).abs() < 1e-9, "{chord}");
        assert_eq!(entry(&Mask::from_fn(100, 80, |x, y| x > 5 && y > 5 && x < 90 && y < 70)), None);
    }

    #[test]
    fn circles_end_at_the_border_of_the_picture() {
        let all = Mask::from_fn(41, 21, |_, _| true);
        let circles = inscribed_circles(&all);
        assert_eq!(circles.len(), 41 * 21);
        let largest = circles.iter().map(|c| c.radius).fold(0.0, f64::max);
        assert_eq!(largest, 10.5);
    }

    #[test]
    fn the_palm_is_the_first_large_circle_from_the_fingers() {
        // Palm above, elbow below and larger; a web before the palm.
        let circle = |y: f64, radius: f64| InscribedCircle { centre: [0.0, y], radius };
        let circles = [circle(10.0, 12.0), circle(20.0, 20.0), circle(80.0, 14.0), circle(120.0, 30.0)];
        let palm = first_palm(&circles, [0.0, -1.0], &PalmTuning::default());
        assert_eq!(palm, Some(circles[1]));
        assert_eq!(first_palm(&[], [0.0, -1.0], &PalmTuning::default()), None);
    }
}
