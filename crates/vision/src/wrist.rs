//! Where the hand ends and the forearm begins.

mod options;
mod palm;
mod section;

pub use options::{BluntEndTuning, CutTuning, ForearmTuning, PalmTuning, WristTuning};
use palm::{blunt_end, entry, first_palm, inscribed_circles};
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
/// The arm is followed from its far end, the fingers, to the side where it leaves the picture (or to its blunt
/// end); the palm is the first large inscribed circle on the way, and the wrist the narrowest place behind it.
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
    let largest = circles.iter().map(|c| c.radius).fold(0.0, f64::max);
    let large: Vec<InscribedCircle> =
        circles.iter().filter(|c| c.radius > tuning.palm.min_radius * largest).copied().collect();
    let centroid = arm.centroid()?;
    // A finger that touches the border is no forearm.
    let from_border = entry(arm).filter(|(_, chord)| *chord > tuning.palm.min_entry * largest);
    let (towards, forearm) = match (from_border, prior) {
        (Some((at, _)), _) => (unit(minus(centroid, at))?, true),
        (None, Some(wrist)) => (wrist.axis, false),
        (None, None) => (blunt_end(&circles, centroid, &tuning.blunt_end)?, false),
    };
    let mut axis = towards;
    let mut palm = first_palm(&large, axis, &tuning.palm)?;
    if let Some((at, _)) = from_border {
        // The centroid lies to one side in a spread hand; from the palm the forearm's direction is known better.
        axis = unit(minus(palm.centre, at)).unwrap_or(axis);
        palm = first_palm(&large, axis, &tuning.palm)?;
    }
    if forearm {
        axis = forearm_direction(arm, &palm, axis, tuning);
    }
    Some((narrowest_section(arm, &palm, axis, prior, tuning), palm))
}
