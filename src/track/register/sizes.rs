//! The sizes of the hand, refined on further open frames.
//!
//! The fit sees one picture, in which the hand may still be opening. Later frames in which the hand is open say more:
//! the outline of each is a quadratic in pose and sizes together, from which the pose is eliminated (Schur complement);
//! their mean, with the fit as belief, gives the sizes.

use nalgebra::{SMatrix, SVector};

use super::super::model::{HandModel, ModelState};
use super::super::outline::OutlinePoint;
use super::super::projection::{COLUMNS, PARAMETERS, parameter};
use super::super::raster::Disc;
use super::Quadratic;
use crate::hand::{Finger, Morphology};

/// Sizes of a finger: place of its base (x and y; hand lengths), logarithms of its length and of four radii.
const OF_FINGER: usize = 7;
/// The sizes: those of the fingers, the four webs (bones), and the logarithm of the wrist's breadth.
const SIZES: usize = 5 * OF_FINGER + 5;
/// Place of the webs.
const WEBS: usize = 5 * OF_FINGER;
/// Standard deviations of the sizes of a finger, of a web and of the wrist's breadth from those of the fit.
const OF_FINGER_DEVIATIONS: [f64; OF_FINGER] = [0.015, 0.015, 0.05, 0.08, 0.08, 0.08, 0.08];
const WEB_DEVIATION: f64 = 0.1;
const WRIST_DEVIATION: f64 = 0.08;
/// The same of the hand's length, which no picture shows: the fit was told it. Hand lengths.
const LENGTH_DEVIATION: f64 = 1e-4;
/// Every how many open frames one is looked at: neighbours say the same.
const EVERY: usize = 3;
/// Frames after which the sizes are settled.
const ENOUGH: usize = 30;
/// Difference by which derivatives are taken.
const STEP: f64 = 1e-4;

type Square = SMatrix<f64, SIZES, SIZES>;
type Vector = SVector<f64, SIZES>;

/// What is known of the sizes.
#[derive(Clone, Debug)]
pub(super) struct Sizes {
    fitted: Morphology,
    /// Changes from the fit.
    values: Box<Vector>,
    /// Sums over the frames of second derivatives and, with the sign turned, of slopes, around the fit.
    a: Box<Square>,
    b: Box<Vector>,
    /// Open frames, whether looked at or not.
    seen: usize,
}

/// One frame's quadratic in sizes and pose, but for the part in the pose alone.
pub(super) struct Frame {
    /// How the projected spheres change with each size: x, y and radius, pixels.
    slopes: Vec<[[f64; 3]; SIZES]>,
    a: Square,
    b: Vector,
    with_pose: SMatrix<f64, SIZES, PARAMETERS>,
}

impl Sizes {
    /// The sizes that were fitted.
    pub(super) fn new(fitted: &Morphology) -> Self {
        Self {
            fitted: fitted.clone(),
            values: Box::new(Vector::zeros()),
            a: Box::new(Square::zeros()),
            b: Box::new(Vector::zeros()),
            seen: 0,
        }
    }

    /// The hand of these sizes.
    pub(super) fn morphology(&self) -> Morphology {
        changed(&self.fitted, &self.values)
    }

    /// Counts an open frame; whether to look at it.
    pub(super) fn is_due(&mut self) -> bool {
        self.seen += 1;
        self.seen <= EVERY * ENOUGH && self.seen.is_multiple_of(EVERY)
    }

    /// A frame, to be filled with its pairs of outline points. `model` must have these sizes and keeps them.
    pub(super) fn frame(&self, model: &mut HandModel, state: &ModelState) -> Frame {
        let mut slopes = vec![[[0.0; 3]; SIZES]; model.project(state).len()];
        let mut beside = Vec::with_capacity(slopes.len());
        for i in 0..SIZES {
            let set = |model: &mut HandModel, step: f64| {
                let mut values = *self.values;
                values[i] += step;
                model.set_morphology(&changed(&self.fitted, &values));
            };
            set(model, -STEP);
            beside.clear();
            beside.extend_from_slice(model.project(state));
            set(model, STEP);
            for ((slope, after), before) in slopes.iter_mut().zip(model.project(state)).zip(&beside) {
                let by = |of: fn(&Disc) -> f64| (of(after) - of(before)) / (2.0 * STEP);
                slope[i] = [by(|d| d.x), by(|d| d.y), by(|d| d.radius)];
            }
        }
        model.set_morphology(&self.morphology());
        Frame { slopes, a: Square::zeros(), b: Vector::zeros(), with_pose: SMatrix::zeros() }
    }

    /// Takes in a frame, `pose` being its quadratic in the pose.
    pub(super) fn learn(&mut self, frame: &Frame, pose: &Quadratic) {
        let Some(eliminated) = pose.solve(&frame.with_pose.transpose()) else { return };
        let a = frame.a - frame.with_pose * eliminated;
        *self.a += a;
        *self.b += frame.b - eliminated.transpose() * pose.downhill() + a * *self.values;
        // Frames err alike: the mean counts as much as one.
        let share = EVERY as f64 / self.seen as f64;
        let mut a = *self.a * share;
        for i in 0..SIZES {
            a[(i, i)] += deviation(i).powi(-2);
        }
        let longer = self.longer();
        a += longer * longer.transpose() / (LENGTH_DEVIATION * LENGTH_DEVIATION);
        let Some(factor) = a.cholesky() else { return };
        let values = factor.solve(&(*self.b * share));
        if changed(&self.fitted, &values).validate().is_ok() {
            *self.values = values;
        }
    }

    /// How the hand's length, in hand lengths, changes with the sizes.
    fn longer(&self) -> Vector {
        let mut longer = Vector::zeros();
        let first = OF_FINGER * Finger::Middle as usize;
        longer[first + 1] = 1.0;
        longer[first + 2] = self.fitted.finger(Finger::Middle).length() / self.fitted.hand_length;
        longer
    }
}

impl Frame {
    /// Adds a pair: a point of the model's outline, `distance` from the image's along `normal`, pixels. `moves` are its
    /// slopes by the pose.
    pub(super) fn add(
        &mut self,
        point: &OutlinePoint,
        (normal, distance): ([f64; 2], f64),
        weight: f64,
        moves: &[(Option<Finger>, [f64; COLUMNS]); 2],
    ) {
        let mut slopes = Vector::zeros();
        for (sphere, share) in point.ends().into_iter().flatten() {
            if let Some(by) = self.slopes.get(sphere) {
                slopes += Vector::from(point.moved(by, share, normal));
            }
        }
        self.b -= slopes * (weight * distance);
        self.a += slopes * slopes.transpose() * weight;
        for (finger, columns) in moves {
            for (column, by) in columns.iter().enumerate().filter(|(_, by)| **by != 0.0) {
                let place = finger.map_or(column, |f| parameter(f, column));
                let mut to = self.with_pose.column_mut(place);
                to += slopes * (weight * by);
            }
        }
    }
}

/// The hand whose sizes differ from `fitted` by `values`.
fn changed(fitted: &Morphology, values: &Vector) -> Morphology {
    let mut m = fitted.clone();
    for finger in Finger::ALL {
        let values = &values.as_slice()[OF_FINGER * finger as usize..][..OF_FINGER];
        let f = &mut m.fingers[finger as usize];
        for (place, v) in f.base.iter_mut().zip(&values[..2]) {
            *place += v * fitted.hand_length;
        }
        f.place_metacarpal(finger);
        f.bones = f.bones.map(|b| b * values[2].exp());
        for (r, v) in f.radii.iter_mut().zip(&values[3..]) {
            *r *= v.exp();
        }
    }
    for (web, v) in m.webs.iter_mut().zip(&values.as_slice()[WEBS..]) {
        *web = (*web + v).clamp(0.0, 1.5);
    }
    m.wrist_half_width *= values[SIZES - 1].exp();
    m
}

/// Standard deviation of a size from that of the fit.
fn deviation(i: usize) -> f64 {
    match i {
        0..WEBS => OF_FINGER_DEVIATIONS[i % OF_FINGER],
        i if i + 1 < SIZES => WEB_DEVIATION,
        _ => WRIST_DEVIATION,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::Side;
    use crate::track::{Fit, Tracker, TrackerOptions};
    use crate::vision::Mask;

    #[test]
    fn sizes_that_the_fit_missed_are_found_on_open_frames() {
        let truth = Morphology::default();
        let mut fitted = truth.clone();
        let (index, ring) = (Finger::Index as usize, Finger::Ring as usize);
        fitted.fingers[index].bones = fitted.fingers[index].bones.map(|b| 0.94 * b);
        fitted.fingers[ring].radii = fitted.fingers[ring].radii.map(|r| 1.08 * r);
        let mut free = [0.0; 15];
        for (finger, degrees) in Finger::LONG.into_iter().zip([10.0f64, 0.0, 8.0, 18.0]) {
            free[3 * finger as usize + 1] = degrees.to_radians();
        }
        let state = ModelState { free, ..ModelState::facing([160.0, 210.0], 900.0) };
        let (side, forearm) = (Side::Right, None);
        let fit = Fit { morphology: fitted, side, state: state.clone(), forearm, iou: 1.0, evaluations: 0 };
        let mut tracker = Tracker::new(&fit, TrackerOptions::default());
        let mut model = HandModel::new(&truth, side);
        for i in 0..30 {
            let mut moved = state.clone();
            moved.wrist[0] += f64::from(i);
            let mut mask = Mask::new(400, 240);
            model.draw(&moved, [0.0, 0.0], &mut mask);
            assert!(tracker.track(&mask, None, None).valid);
        }
        let found = tracker.morphology();
        let (length, width) = (
            found.fingers[index].length() / truth.fingers[index].length() - 1.0,
            found.fingers[ring].radii[2] / truth.fingers[ring].radii[2] - 1.0,
        );
        // The fit missed 6 % and 8 % and is believed, too: half a pixel of width is less than what outlines err by.
        assert!(length.abs() < 0.025 && width.abs() < 0.055, "{length} {width}");
        let middle = |m: &Morphology| m.finger(Finger::Middle).base[1] + m.finger(Finger::Middle).length();
        assert!((middle(found) / middle(&truth) - 1.0).abs() < 0.005);
    }
}
