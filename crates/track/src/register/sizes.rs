//! The sizes of the hand, refined while it is tracked.
//!
//! The fit sees one picture, in which the hand may still be opening. Further frames say more: the outline of each is a
//! quadratic in pose and sizes together, from which the pose is eliminated (Schur complement); their mean, with the fit
//! as belief, gives the sizes. What is open counts most: a stretched finger is seen, and its place is certain.

use nalgebra::{SMatrix, SVector};

use super::super::model::{HandModel, ModelState};
use super::super::outline::OutlinePoint;
use super::super::projection::{COLUMNS, PARAMETERS, parameter};
use super::super::raster::Disc;
use super::{OpenState, Quadratic};
use handcast_hand::{FOREARMS, Finger, Morphology, WEB_ROOTS};

/// Sizes of a finger: place of its base (x and y), logarithms of its length, of its four radii and of its three waists,
/// and the seven places of its flesh to the side. Places are in hand lengths.
const OF_FINGER: usize = 17;
/// Sizes of the palm: four webs (bones), the root of the thumb's web, the ulnar border and the place of the wrist (hand
/// lengths), and the logarithms of the wrist's breadth and of the forearm's by comparison.
const OF_PALM: usize = 9;
const PALM: usize = 5 * OF_FINGER;
const SIZES: usize = PALM + OF_PALM;
/// Standard deviations from the sizes of the fit.
const OF_FINGER_DEVIATIONS: [f64; OF_FINGER] =
    [0.03, 0.03, 0.1, 0.16, 0.16, 0.16, 0.16, 0.16, 0.16, 0.16, 0.02, 0.02, 0.02, 0.02, 0.02, 0.02, 0.02];
/// The thumb's, by comparison: how it is turned is uncertain, too.
const OF_THUMB: f64 = 0.6;
const OF_PALM_DEVIATIONS: [f64; OF_PALM] = [0.2, 0.2, 0.2, 0.2, 0.3, 0.04, 0.04, 0.16, 0.3];
/// The same of the hand's length, which no picture shows: the fit was told it. Hand lengths.
const LENGTH_DEVIATION: f64 = 1e-4;
/// Difference of a finger's joint angle from the open hand at which either end of a piece of its outline counts half,
/// radians.
const HALF_OPEN: f64 = 0.8;
/// Frames err alike: however many there are, they count as so many.
const WORTH: f64 = 10.0;
/// Every how many frames one is looked at: neighbours say the same.
const EVERY: usize = 3;
/// Frames after which the sizes are settled.
const ENOUGH: usize = 300;
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
    /// Frames that were taken in.
    count: f64,
    /// Frames, whether looked at or not.
    seen: usize,
    frame: Box<Frame>,
}

/// One frame's quadratic in sizes and pose, but for the part in the pose alone.
#[derive(Clone, Debug)]
pub(super) struct Frame {
    /// How the projected spheres change with each size: x, y and radius, pixels.
    slopes: Vec<[[f64; 3]; SIZES]>,
    /// The lower triangle of the second derivatives.
    a: Square,
    b: Vector,
    with_pose: SMatrix<f64, SIZES, PARAMETERS>,
    beside: Vec<Disc>,
    /// What the outline of each finger counts.
    openness: [f64; 5],
}

impl Sizes {
    /// The sizes that were fitted.
    pub(super) fn new(fitted: &Morphology) -> Self {
        Self {
            fitted: fitted.clone(),
            values: Box::new(Vector::zeros()),
            a: Box::new(Square::zeros()),
            b: Box::new(Vector::zeros()),
            count: 0.0,
            seen: 0,
            frame: Box::new(Frame {
                slopes: Vec::new(),
                a: Square::zeros(),
                b: Vector::zeros(),
                with_pose: SMatrix::zeros(),
                beside: Vec::new(),
                openness: [1.0; 5],
            }),
        }
    }

    /// The hand of these sizes.
    pub(super) fn morphology(&self) -> Morphology {
        changed(&self.fitted, &self.values)
    }

    /// Counts a frame; whether to look at it.
    pub(super) fn is_due(&mut self) -> bool {
        self.seen += 1;
        self.seen <= ENOUGH && self.seen.is_multiple_of(EVERY)
    }

    /// Empties the frame, to be filled with its pairs of outline points. `model` must have these sizes and keeps them;
    /// `axis` is that of the forearm in the image, if one is seen.
    pub(super) fn begin(
        &mut self,
        model: &mut HandModel,
        state: &ModelState,
        open: &OpenState,
        axis: Option<[f64; 2]>,
    ) -> &mut Frame {
        let Frame { slopes, a, b, with_pose, beside, openness } = &mut *self.frame;
        for (openness, angles) in openness.iter_mut().zip(0..5) {
            let apart = |i: usize| (state.free[i] - open.state.free[i]).abs();
            let bent = (3 * angles..3 * angles + 3).map(apart).fold(0.0, f64::max);
            *openness = 1.0 / (1.0 + (bent / HALF_OPEN).powi(2));
        }
        slopes.clear();
        slopes.resize(model.project_with_forearm(state, axis).len(), [[0.0; 3]; SIZES]);
        let mut values = *self.values;
        for i in 0..SIZES {
            let here = values[i];
            let mut set = |model: &mut HandModel, value: f64| {
                values[i] = value;
                model.set_morphology(&changed(&self.fitted, &values));
            };
            set(model, here - STEP);
            beside.clear();
            beside.extend_from_slice(model.project_with_forearm(state, axis));
            set(model, here + STEP);
            let after = model.project_with_forearm(state, axis);
            for ((slope, after), before) in slopes.iter_mut().zip(after).zip(&*beside) {
                let by = |of: fn(&Disc) -> f64| (of(after) - of(before)) / (2.0 * STEP);
                slope[i] = [by(|d| d.x), by(|d| d.y), by(|d| d.radius)];
            }
            values[i] = here;
        }
        model.set_morphology(&changed(&self.fitted, &values));
        a.fill(0.0);
        b.fill(0.0);
        with_pose.fill(0.0);
        &mut self.frame
    }

    /// Takes in the frame, `pose` being its quadratic in the pose.
    pub(super) fn learn(&mut self, pose: &Quadratic) {
        let frame = &mut *self.frame;
        let Some(eliminated) = pose.solve(&frame.with_pose.transpose()) else { return };
        frame.a.fill_upper_triangle_with_lower_triangle();
        frame.a.gemm(-1.0, &frame.with_pose, &eliminated, 1.0);
        frame.b.gemv_tr(-1.0, &eliminated, pose.downhill(), 1.0);
        frame.b.gemv(1.0, &frame.a, &self.values, 1.0);
        *self.a += frame.a;
        *self.b += frame.b;
        self.count += 1.0;
        let share = WORTH / self.count;
        let mut a = *self.a * share;
        for i in 0..SIZES {
            a[(i, i)] += deviation(i).powi(-2);
        }
        let longer = self.longer();
        a.ger(LENGTH_DEVIATION.powi(-2), &longer, &longer, 1.0);
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
    /// What an outline point counts that moves with these fingers.
    pub(super) fn openness(&self, moves: &[(Option<Finger>, [f64; COLUMNS]); 2]) -> f64 {
        moves.iter().filter_map(|(finger, _)| *finger).map(|finger| self.openness[finger as usize]).product()
    }

    /// Adds a pair: a point of the model's outline, `distance` from the image's along `normal`, pixels. `moves` are its
    /// slopes by the pose.
    pub(super) fn add(
        &mut self,
        point: &OutlinePoint,
        (normal, distance): ([f64; 2], f64),
        weight: f64,
        moves: &[(Option<Finger>, [f64; COLUMNS]); 2],
    ) {
        let mut slopes = [0.0; SIZES];
        for (sphere, share) in point.ends().into_iter().flatten() {
            if let Some(by) = self.slopes.get(sphere) {
                for (to, by) in slopes.iter_mut().zip(point.moved(by, share, normal)) {
                    *to += by;
                }
            }
        }
        // A point moves with the sizes of a finger or two.
        let (mut places, mut count) = ([0; SIZES], 0);
        for (i, _) in slopes.iter().enumerate().filter(|(_, by)| **by != 0.0) {
            places[count] = i;
            count += 1;
        }
        for (n, &i) in places[..count].iter().enumerate() {
            let by = slopes[i] * weight;
            self.b[i] -= by * distance;
            for &j in &places[..=n] {
                self.a[(i, j)] += by * slopes[j];
            }
            for (finger, columns) in moves {
                for (column, move_by) in columns.iter().enumerate() {
                    let place = finger.map_or(column, |f| parameter(f, column));
                    self.with_pose[(i, place)] += by * move_by;
                }
            }
        }
    }
}

/// The hand whose sizes differ from `fitted` by `values`.
fn changed(fitted: &Morphology, values: &Vector) -> Morphology {
    let mut m = fitted.clone();
    let hand = fitted.hand_length;
    for finger in Finger::ALL {
        let values = &values.as_slice()[OF_FINGER * finger as usize..][..OF_FINGER];
        let f = &mut m.fingers[finger as usize];
        for (place, v) in f.base.iter_mut().zip(&values[..2]) {
            *place += v * hand;
        }
        f.place_metacarpal(finger);
        f.bones = f.bones.map(|b| b * values[2].exp());
        for (r, v) in f.radii.iter_mut().chain(&mut f.waists).zip(&values[3..10]) {
            *r *= v.exp();
        }
        for (place, v) in f.lateral.iter_mut().zip(&values[10..]) {
            *place += v * hand;
        }
    }
    let values = &values.as_slice()[PALM..];
    for (web, v) in m.webs.iter_mut().zip(values) {
        *web = (*web + v).clamp(0.0, 1.5);
    }
    m.web_root = (m.web_root + values[4]).clamp(WEB_ROOTS[0], WEB_ROOTS[1]);
    m.ulnar_border += values[5] * hand;
    m.wrist_lateral += values[6] * hand;
    m.wrist_half_width *= values[7].exp();
    m.forearm = (m.forearm * values[8].exp()).clamp(FOREARMS[0], FOREARMS[1]);
    m
}

/// Standard deviation of a size from that of the fit.
fn deviation(i: usize) -> f64 {
    match i {
        0..OF_FINGER => OF_THUMB * OF_FINGER_DEVIATIONS[i],
        OF_FINGER..PALM => OF_FINGER_DEVIATIONS[i % OF_FINGER],
        _ => OF_PALM_DEVIATIONS[i - PALM],
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::super::tests::open;
    use super::*;
    use crate::{Fit, Forearm, HandTracker, TrackerOptions};
    use handcast_hand::Side;
    use handcast_vision::Mask;

    /// The sizes found on 30 open frames of `truth`, turned in the image, after a fit that found `fitted`.
    fn found_on_open_frames(truth: &Morphology, fitted: Morphology, turn: f64) -> Morphology {
        let mut state = open().state;
        state.rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * state.rotation;
        let (side, forearm) = (Side::Right, None);
        let fit = Fit { morphology: fitted, side, state: state.clone(), forearm, iou: 1.0, evaluations: 0 };
        let mut tracker = HandTracker::new(&fit, TrackerOptions::default());
        let mut model = HandModel::new(truth, side);
        for i in 0..30 {
            let mut moved = state.clone();
            moved.wrist[0] += f64::from(i);
            let mut mask = Mask::new(400, 240);
            model.draw(&moved, [0.0, 0.0], &mut mask);
            assert!(tracker.track(&mask, None, None).unwrap().valid);
        }
        tracker.morphology().clone()
    }

    #[test]
    fn sizes_that_the_fit_missed_are_found_on_open_frames() {
        let truth = Morphology::default();
        let (shorter, wider) = (0.94_f64, 1.08_f64);
        // Not the middle finger, whose length is a part of the hand's, which the fit was told.
        let fingers = [Finger::Index, Finger::Ring, Finger::Pinky];
        let mut left = Vec::new();
        for (turn, i) in [-0.2, 0.0, 0.2].into_iter().flat_map(|turn| (0..3).map(move |i| (turn, i))) {
            let [short, wide] = [i, (i + 1) % 3].map(|i| fingers[i] as usize);
            let mut fitted = truth.clone();
            fitted.fingers[short].bones = fitted.fingers[short].bones.map(|b| shorter * b);
            fitted.fingers[wide].radii = fitted.fingers[wide].radii.map(|r| wider * r);
            let found = found_on_open_frames(&truth, fitted, turn);
            let length = found.fingers[short].length() / truth.fingers[short].length();
            let width = found.fingers[wide].radii[2] / truth.fingers[wide].radii[2];
            left.extend([length.ln().abs() / shorter.ln().abs(), width.ln().abs() / wider.ln()]);
            let middle =
                |m: &Morphology| m.finger(Finger::Middle).base[1] + m.finger(Finger::Middle).length();
            assert!((middle(&found) / middle(&truth) - 1.0).abs() < 0.005);
        }
        // Most of what the fit missed: it is believed, too.
        let mean = left.iter().sum::<f64>() / left.len() as f64;
        assert!(mean < 0.5 && left.iter().all(|&l| l < 1.0), "{mean} of {left:?}");
    }

    #[test]
    fn a_forearm_narrower_than_the_wrist_is_found() {
        let truth = Morphology { forearm: 0.7, ..Morphology::default() };
        let state = open().state;
        let side = Side::Right;
        let forearm = Forearm { cut: [160.0, 225.0], axis: [0.0, -1.0] };
        let fit = Fit {
            morphology: Morphology::default(),
            side,
            state: state.clone(),
            forearm: Some(forearm),
            iou: 1.0,
            evaluations: 0,
        };
        let mut tracker = HandTracker::new(&fit, TrackerOptions::default());
        let mut model = HandModel::new(&truth, side);
        let mut first = 0.0;
        for i in 0..30 {
            let mut moved = state.clone();
            moved.wrist[0] += f64::from(i);
            let mut arm = Mask::new(400, 240);
            model.draw(&moved, [0.0, 0.0], &mut arm);
            model.draw_forearm(&forearm, [0.0, 0.0], &mut arm);
            let hand = Mask::from_fn(400, 240, |x, y| arm.get(x, y) && y < 225);
            let tracked = tracker.track(&hand, Some(forearm), None).unwrap();
            assert!(tracked.valid);
            if i == 0 {
                first = tracked.iou;
            } else if i == 29 {
                assert!(tracked.iou > first, "{first} {}", tracked.iou);
            }
        }
        let found = tracker.morphology().forearm;
        assert!((0.6..0.85).contains(&found), "{found}");
    }
}
