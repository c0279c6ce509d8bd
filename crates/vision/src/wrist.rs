//! Where the hand ends and the forearm begins.

mod options;
mod palm;
mod section;

pub use options::{BluntEndTuning, CutTuning, ForearmTuning, PalmTuning, WristTuning};
use palm::{closed_end, entry, fingers_of, first_palm, inscribed_circles, largest};
pub(super) use section::cross_section;
use section::{forearm_direction, narrowest_section};

use super::geometry::{dot, minus, moved, quarter_turn, unit};
use super::mask::Mask;
use super::morphology::Components;

/// The wrist in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrist {
    /// Middle of the cut, in pixels.
    pub centre: [f64; 2],
    /// Unit vector from the forearm to the hand.
    pub axis: [f64; 2],
    /// Length of the cut within the arm, in pixels.
    pub width: f64,
}

impl Wrist {
    /// Signed distance of a point to the cut, in pixels: positive on the hand's side.
    pub fn side(&self, point: [f64; 2]) -> f64 {
        dot(minus(point, self.centre), self.axis)
    }

    /// The two ends of the cut.
    pub fn ends(&self) -> [[f64; 2]; 2] {
        let half = 0.5 * self.width;
        [half, -half].map(|s| moved(self.centre, quarter_turn(self.axis), s))
    }
}

/// A circle inscribed in a silhouette: the largest round its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InscribedCircle {
    /// Centre, pixels.
    pub centre: [f64; 2],
    /// Radius, pixels: the centre's distance to the background.
    pub radius: f64,
}

/// Cuts the forearm from an arm.
///
/// The arm is followed from its far end, the fingers, to the side where it leaves the picture, or to the end without
/// fingers where it ends within the picture; the palm is the first large inscribed circle on the way, and the wrist the narrowest place behind it.
/// `prior`, the wrist of the frame before, pulls the cut towards itself. Gives the hand, and the wrist if there is a
/// forearm or an end of one; without, the hand is the arm.
pub fn cut_forearm(arm: &Mask, prior: Option<&Wrist>, tuning: &WristTuning) -> (Mask, Option<Wrist>) {
    let cut = cut_arm(arm, prior, tuning);
    (cut.hand, cut.wrist)
}

/// An arm cut at the wrist.
pub(super) struct ArmCut {
    pub(super) hand: Mask,
    pub(super) wrist: Option<Wrist>,
    /// The largest circle inscribed in the palm.
    pub(super) palm: Option<InscribedCircle>,
}

/// As [`cut_forearm`], with the palm.
pub(super) fn cut_arm(arm: &Mask, prior: Option<&Wrist>, tuning: &WristTuning) -> ArmCut {
    match find_wrist(arm, prior, tuning) {
        Some((Some(wrist), palm)) => {
            ArmCut { hand: hand_side(arm, &wrist, &palm), wrist: Some(wrist), palm: Some(palm) }
        }
        Some((None, palm)) => ArmCut { hand: arm.clone(), wrist: None, palm: Some(palm) },
        None => ArmCut { hand: arm.clone(), wrist: None, palm: None },
    }
}

/// The part of `arm` beyond the wrist that holds the palm.
fn hand_side(arm: &Mask, wrist: &Wrist, palm: &InscribedCircle) -> Mask {
    let mut beyond = Mask::new(arm.width(), arm.height());
    for y in 0..arm.height() {
        for (start, end) in arm.runs(y) {
            // The cut crosses a row once: solve for x instead of testing every pixel.
            let row = f64::from(y) + 0.5;
            let at = |x: u32| wrist.side([f64::from(x) + 0.5, row]) > 0.0;
            let (first, last) = (at(start), at(end - 1));
            if first && last {
                beyond.fill_span(y, start as i32, end as i32);
            } else if first || last {
                let crossing =
                    wrist.centre[0] - (row - wrist.centre[1]) * wrist.axis[1] / wrist.axis[0] - 0.5;
                let (from, to) = if first {
                    (start as i32, crossing.ceil() as i32)
                } else {
                    (crossing.floor() as i32 + 1, end as i32)
                };
                beyond.fill_span(y, from.max(start as i32), to.min(end as i32));
            }
        }
    }
    let parts = Components::of(&beyond, true);
    let [px, py] = palm.centre.map(|v| v as u32);
    let chosen = parts
        .spans()
        .find(|&(_, y, start, end)| y == py && (start..end).contains(&px))
        .map(|span| span.0)
        .or(parts.largest());
    let mut hand = Mask::new(arm.width(), arm.height());
    parts.draw(&mut hand, |i, _| Some(i) == chosen);
    hand
}

/// The wrist and the palm's circle.
fn find_wrist(
    arm: &Mask,
    prior: Option<&Wrist>,
    tuning: &WristTuning,
) -> Option<(Option<Wrist>, InscribedCircle)> {
    let circles = inscribed_circles(arm);
    let centroid = arm.centroid()?;
    let thickest = largest(&circles, centroid);
    let large: Vec<InscribedCircle> =
        circles.iter().filter(|c| c.radius > tuning.palm.min_radius * thickest.radius).copied().collect();
    let at_border = entry(arm);
    // A finger that touches the border is no forearm.
    let from_border = at_border.filter(|(_, chord)| *chord > tuning.palm.min_entry * thickest.radius);
    let (mut axis, prior) = match from_border {
        Some((at, _)) => (unit(minus(centroid, at))?, prior),
        None => {
            let fingers = fingers_of(arm, &thickest, &tuning.blunt_end);
            // Of an arm that is in the picture as a whole, fingers tell the end better than the frame before.
            let agrees = |wrist: &&Wrist| {
                let along = fingers.map(|f| dot(f, wrist.axis)).filter(|_| at_border.is_none());
                along.is_none_or(|cosine| cosine > tuning.blunt_end.turned)
            };
            let prior = prior.filter(agrees);
            let closed = || closed_end(&circles, &thickest, centroid, &tuning.blunt_end);
            (prior.map(|wrist| wrist.axis).or(fingers).or_else(closed)?, prior)
        }
    };
    let mut palm = first_palm(&large, axis, &tuning.palm)?;
    if let Some((at, _)) = from_border {
        // The centroid lies to one side in a spread hand; from the palm the forearm's direction is known better.
        axis = unit(minus(palm.centre, at)).unwrap_or(axis);
        palm = first_palm(&large, axis, &tuning.palm)?;
    }
    // What touches the border without entering there has merged with something, and has no forearm to follow.
    if from_border.is_some() || at_border.is_none() {
        axis = forearm_direction(arm, &palm, axis, tuning);
    }
    Some((narrowest_section(arm, &palm, axis, prior, tuning), palm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance;

    const SIZE: [f64; 2] = [160.0, 240.0];

    /// Whether a capsule holds a point.
    fn capsule(p: [f64; 2], a: [f64; 2], b: [f64; 2], radius: f64) -> bool {
        let (d, ap) = (minus(b, a), minus(p, a));
        let t = (dot(ap, d) / dot(d, d)).clamp(0.0, 1.0);
        distance(ap, d.map(|v| v * t)) < radius
    }

    /// A hand with its palm at (80, 90), of 24 pixels, above a forearm that gets wider and ends in the row `end`; open or
    /// a fist; upside down where `turned`.
    fn arm(open: bool, end: f64, turned: bool) -> Mask {
        let fingers: [([f64; 2], [f64; 2], f64); 5] = [
            ([64.0, 100.0], [36.0, 72.0], 6.0),
            ([66.0, 76.0], [54.0, 34.0], 6.0),
            ([76.0, 72.0], [74.0, 26.0], 6.0),
            ([88.0, 74.0], [96.0, 32.0], 6.0),
            ([97.0, 82.0], [116.0, 48.0], 5.0),
        ];
        Mask::from_fn(SIZE[0] as u32, SIZE[1] as u32, |x, y| {
            let p = [f64::from(x) + 0.5, f64::from(y) + 0.5];
            let p = if turned { minus(SIZE, p) } else { p };
            let forearm =
                p[1] > 90.0 && p[1] < end && (p[0] - 80.0).abs() < 15.0 + 0.08 * (p[1] - 112.0).max(0.0);
            forearm
                || capsule(p, [80.0, 86.0], [80.0, 92.0], 24.0)
                || open && fingers.iter().any(|&(a, b, radius)| capsule(p, a, b, radius))
        })
    }

    /// Where the palm lies in the pictures.
    fn palm_at(turned: bool) -> [f64; 2] {
        let at = [80.0, 89.0];
        if turned { minus(SIZE, at) } else { at }
    }

    fn assert_cut(cut: &ArmCut, turned: bool, what: &str) {
        let (wrist, palm) = (cut.wrist.unwrap(), cut.palm.unwrap());
        let up = if turned { [0.0, 1.0] } else { [0.0, -1.0] };
        assert!(distance(palm.centre, palm_at(turned)) < 6.0, "{what}: {palm:?}");
        assert!(dot(wrist.axis, up) > 0.97, "{what}: {wrist:?}");
        let behind = -dot(minus(wrist.centre, palm.centre), up);
        assert!((16.0..40.0).contains(&behind), "{what}: {wrist:?}");
    }

    #[test]
    fn the_hand_is_the_end_with_fingers_wherever_the_arm_ends() {
        let tuning = WristTuning::default();
        for turned in [false, true] {
            // At the border, a row before it, before a bar, near the wrist.
            for end in [240.0, 239.0, 238.0, 220.0, 180.0, 150.0] {
                let cut = cut_arm(&arm(true, end, turned), None, &tuning);
                assert_cut(&cut, turned, &format!("{end} {turned}"));
                assert!(cut.hand.area() < 5500, "{}", cut.hand.area());
            }
        }
    }

    #[test]
    fn an_arm_longer_than_a_hand_ends_in_a_fist() {
        for turned in [false, true] {
            assert_cut(&cut_arm(&arm(false, 236.0, turned), None, &WristTuning::default()), turned, "fist");
        }
    }

    #[test]
    fn fingers_overrule_a_wrist_at_the_other_end() {
        let tuning = WristTuning::default();
        for turned in [false, true] {
            let arm = arm(true, 236.0, turned);
            let right = cut_arm(&arm, None, &tuning).wrist.unwrap();
            let wrong = Wrist { centre: minus(SIZE, palm_at(turned)), axis: right.axis.map(|v| -v), ..right };
            let cut = cut_arm(&arm, Some(&wrong), &tuning);
            assert_cut(&cut, turned, "other end");
            // A wrist that agrees is kept to.
            let kept = cut_arm(&arm, Some(&right), &tuning).wrist.unwrap();
            assert!(distance(kept.centre, right.centre) < 2.0, "{kept:?} {right:?}");
        }
    }
}
