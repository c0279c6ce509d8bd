//! The sizes of the hand, refined while it is tracked.
//!
//! The fit sees one picture, in which the hand may still be opening. Further frames say more: the outline of each makes
//! normal equations of pose and sizes together, from which the pose is eliminated (Schur complement); their mean, with
//! the fit as prior, gives the sizes. What is open counts most: a stretched finger is seen, and its place is certain.

use std::ops::Range;

use nalgebra::{SMatrix, SVector};

use super::super::model::HandModel;
use super::super::normal_equations::{NormalEquations, SolverTuning};
use super::super::outline::OutlinePoint;
use super::super::projection::{COLUMNS, PARAMETERS, parameter};
use super::super::raster::ProjectedDisc;
use super::super::state::ModelState;
use super::prior::OpenState;
use handcast_hand::{FOREARMS, Finger, Morphology, WEB_LENGTHS, WEB_ROOTS};
use handcast_vision::tuning::tuning;

tuning! {
    /// How the sizes are refined: standard deviations from those of the fit, and how much the frames count.
    pub struct SizesTuning {
        /// Of the place of a finger's base.
        ["hand lengths", "spec/registration.md 5, Sizes; handcast bench track CLIP --no-methods"]
        pub base: f64 = 0.03,
        /// Of the logarithm of a finger's length.
        ["1", "spec/registration.md 5, Sizes; handcast bench track CLIP --no-methods"]
        pub length: f64 = 0.1,
        /// Of the logarithm of a bone's length by comparison with its finger's, where a finder sees the joints.
        ["1", "spread of phalanges, spec/anthropometry.csv"]
        pub bone: f64 = 0.1,
        /// Of the place of the thumb's base, and of its bones, where a finder sees the joints.
        ["hand lengths, 1", "what finders call its CMC joint lies 7 % from the model's"]
        pub thumb_joints: f64 = 0.1,
        /// Of the logarithms of a finger's radii and waists.
        ["1", "spec/registration.md 5, Sizes; handcast bench track CLIP --no-methods"]
        pub radius: f64 = 0.16,
        /// Of how far to the side of the bones the flesh lies.
        ["hand lengths", "spec/registration.md 5, Sizes; handcast bench track CLIP --no-methods"]
        pub lateral: f64 = 0.02,
        /// Factor of the thumb's deviations: how it is turned is uncertain, and its flesh would make up for it.
        ["1", "spec/experiments.md, Forearm breadth"]
        pub thumb: f64 = 0.6,
        /// Of a web.
        ["bones", "spec/registration.md 5, Sizes"]
        pub web: f64 = 0.2,
        /// Of where the thumb's web meets the palm.
        ["1", "spec/registration.md 5, Sizes"]
        pub web_root: f64 = 0.3,
        /// Of the ulnar border and of the wrist's place to the side.
        ["hand lengths", "spec/registration.md 5, Sizes"]
        pub border: f64 = 0.04,
        /// Of the logarithm of the wrist's breadth.
        ["1", "spec/registration.md 5, Sizes"]
        pub wrist: f64 = 0.16,
        /// Of the logarithm of the forearm's breadth over the wrist's.
        ["1", "spec/experiments.md, Forearm breadth"]
        pub forearm: f64 = 0.3,
        /// Of the hand's length, which no picture shows: the fit was told it.
        ["hand lengths", "none: small enough to hold it"]
        pub hand_length: f64 = 1e-4,
        /// Difference of a finger's joint angle from the open hand at which either end of a piece of its outline has
        /// half its weight.
        ["rad", "spec/experiments.md, Finer sizes and image motion"]
        pub half_open: f64 = 0.8,
        /// Frames err alike: however many there are, they count as so many.
        ["frames", "spec/experiments.md, Finer sizes and image motion"]
        pub effective_frames: f64 = 10.0,
        /// Every how many frames one is taken: neighbours say the same.
        ["frames", "spec/registration.md 5, Sizes"]
        pub every: usize = 3,
        /// Frames after which the sizes are settled.
        ["frames", "spec/registration.md 5, Sizes"]
        pub enough: usize = 300,
    }
}

/// Places of a finger's sizes among its own: its base (x and y), the logarithms of its length, of its four radii and of
/// its three waists, and the seven places of its flesh to the side. Places are in hand lengths.
const BASE: Range<usize> = 0..2;
const LENGTH: usize = BASE.end;
const RADII: Range<usize> = LENGTH + 1..LENGTH + 8;
const LATERAL: Range<usize> = RADII.end..RADII.end + 7;
const OF_FINGER: usize = LATERAL.end;
/// Places of the palm's sizes among its own: four webs (bones), the root of the thumb's web, the ulnar border and the
/// place of the wrist (hand lengths), and the logarithms of the wrist's breadth and of the forearm's by comparison.
const WEBS: Range<usize> = 0..4;
const WEB_ROOT: usize = WEBS.end;
const ULNAR_BORDER: usize = WEB_ROOT + 1;
const WRIST_LATERAL: usize = ULNAR_BORDER + 1;
const WRIST: usize = WRIST_LATERAL + 1;
const FOREARM: usize = WRIST + 1;
/// Where the palm's sizes begin: those of the fingers come first.
const PALM: usize = Finger::COUNT * OF_FINGER;
/// How many sizes outlines tell.
const OUTLINE: usize = PALM + FOREARM + 1;
/// Then come those that joints tell besides: the logarithms of each finger's three bones by comparison with its length.
const BONES: usize = 3;
const SIZES: usize = OUTLINE + BONES * Finger::COUNT;
/// Difference by which derivatives are taken.
const STEP: f64 = 1e-4;

type Square = SMatrix<f64, SIZES, SIZES>;
type Vector = SVector<f64, SIZES>;

/// What is known of the sizes.
#[derive(Clone, Debug)]
pub(super) struct Sizes {
    tuning: SizesTuning,
    fitted: Morphology,
    /// Changes from the fit.
    values: Box<Vector>,
    /// Sums over the frames of their normal equations, around the fit.
    a: Box<Square>,
    b: Box<Vector>,
    /// Frames that were taken in.
    count: f64,
    /// Frames, whether looked at or not.
    seen: usize,
    frame: Box<SizeEquations>,
}

/// One frame's normal equations in sizes and pose, but for the part in the pose alone.
#[derive(Clone, Debug)]
pub(super) struct SizeEquations {
    /// Derivatives of the projected spheres by each size: x, y and radius, pixels.
    jacobian: Vec<[[f64; 3]; SIZES]>,
    /// The lower triangle of the information matrix.
    a: Square,
    b: Vector,
    with_pose: SMatrix<f64, SIZES, PARAMETERS>,
    /// The projected spheres a little beside.
    beside: Vec<ProjectedDisc>,
    /// Weight of the outline of each finger.
    openness: [f64; Finger::COUNT],
    /// Whether joints have been seen.
    joints: bool,
}

impl Sizes {
    /// The sizes that were fitted.
    pub(super) fn new(tuning: SizesTuning, fitted: &Morphology) -> Self {
        Self {
            tuning,
            fitted: fitted.clone(),
            values: Box::new(Vector::zeros()),
            a: Box::new(Square::zeros()),
            b: Box::new(Vector::zeros()),
            count: 0.0,
            seen: 0,
            frame: Box::new(SizeEquations {
                jacobian: Vec::new(),
                a: Square::zeros(),
                b: Vector::zeros(),
                with_pose: SMatrix::zeros(),
                beside: Vec::new(),
                openness: [1.0; Finger::COUNT],
                joints: false,
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
        self.seen <= self.tuning.enough && self.seen.is_multiple_of(self.tuning.every)
    }

    /// Empties the frame, to be filled with its pairs of outline points. `model` must have these sizes and keeps them;
    /// `axis` is that of the forearm in the image, if one is seen; `joints` says whether a finder sees them.
    pub(super) fn begin(
        &mut self,
        model: &mut HandModel,
        state: &ModelState,
        open: &OpenState,
        (axis, joints): (Option<[f64; 2]>, bool),
    ) -> &mut SizeEquations {
        self.frame.joints |= joints;
        let told = if self.frame.joints { SIZES } else { OUTLINE };
        let SizeEquations { jacobian, a, b, with_pose, beside, openness, .. } = &mut *self.frame;
        for (openness, finger) in openness.iter_mut().zip(Finger::ALL) {
            let apart = |i: usize| (state.free[i] - open.state.free[i]).abs();
            let bent = finger.range().map(apart).fold(0.0, f64::max);
            *openness = 1.0 / (1.0 + (bent / self.tuning.half_open).powi(2));
        }
        jacobian.clear();
        jacobian.resize(model.project_with_forearm(state, axis).len(), [[0.0; 3]; SIZES]);
        let mut values = *self.values;
        for i in 0..told {
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
            for ((slope, after), before) in jacobian.iter_mut().zip(after).zip(&*beside) {
                let by = |of: fn(&ProjectedDisc) -> f64| (of(after) - of(before)) / (2.0 * STEP);
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

    /// Takes in the frame, `pose` being its normal equations in the pose.
    pub(super) fn learn(&mut self, solver: &SolverTuning, pose: &NormalEquations) {
        let values = match self.frame.joints {
            true => self.solved::<SIZES>(solver, pose),
            false => self.solved::<OUTLINE>(solver, pose),
        };
        if let Some(values) = values
            && changed(&self.fitted, &values).validate().is_ok()
        {
            *self.values = values;
        }
    }

    /// The first `N` sizes after the frame, those beyond as they are; `None` where nothing can be solved.
    #[inline(never)]
    fn solved<const N: usize>(&mut self, solver: &SolverTuning, pose: &NormalEquations) -> Option<Vector> {
        let with_pose = self.frame.with_pose.fixed_rows::<N>(0).into_owned();
        let eliminated = pose.solve(solver, &with_pose.transpose())?;
        let mut frame_a = self.frame.a.fixed_view::<N, N>(0, 0).into_owned();
        let mut frame_b = self.frame.b.fixed_rows::<N>(0).into_owned();
        frame_a.fill_upper_triangle_with_lower_triangle();
        frame_a.gemm(-1.0, &with_pose, &eliminated, 1.0);
        frame_b.gemv_tr(-1.0, &eliminated, pose.right_side(), 1.0);
        frame_b.gemv(1.0, &frame_a, &self.values.fixed_rows::<N>(0).into_owned(), 1.0);
        let mut sum_a = self.a.fixed_view_mut::<N, N>(0, 0);
        sum_a += &frame_a;
        let mut sum_b = self.b.fixed_rows_mut::<N>(0);
        sum_b += &frame_b;
        self.count += 1.0;
        let share = self.tuning.effective_frames / self.count;
        let mut a = self.a.fixed_view::<N, N>(0, 0) * share;
        for i in 0..N {
            a[(i, i)] += deviation(&self.tuning, i, self.frame.joints).powi(-2);
        }
        let longer = self.longer().fixed_rows::<N>(0).into_owned();
        // Rounded once: powi would round the square, too.
        let information = self.tuning.hand_length.powf(-2.0);
        a.ger(information, &longer, &longer, 1.0);
        let found = a.cholesky()?.solve(&(self.b.fixed_rows::<N>(0) * share));
        let mut values = *self.values;
        values.fixed_rows_mut::<N>(0).copy_from(&found);
        Some(values)
    }

    /// Gradient of the hand's length, in hand lengths, by the sizes.
    fn longer(&self) -> Vector {
        let mut longer = Vector::zeros();
        let first = OF_FINGER * Finger::Middle as usize;
        longer[first + BASE.end - 1] = 1.0;
        let middle = self.fitted.finger(Finger::Middle);
        longer[first + LENGTH] = middle.length() / self.fitted.hand_length;
        for (i, bone) in middle.bones.into_iter().enumerate() {
            longer[OUTLINE + BONES * Finger::Middle as usize + i] = bone / self.fitted.hand_length;
        }
        longer
    }
}

impl SizeEquations {
    /// Weight of an outline point that moves with these fingers.
    pub(super) fn openness(&self, by_pose: &[(Option<Finger>, [f64; COLUMNS]); 2]) -> f64 {
        by_pose
            .iter()
            .filter_map(|(finger, _)| *finger)
            .map(|finger| self.openness[finger as usize])
            .product()
    }

    /// Adds a pair: a point of the model's outline, `distance` from the image's along `normal`, pixels. `by_pose` is
    /// its gradient by the pose.
    pub(super) fn add(
        &mut self,
        point: &OutlinePoint,
        (normal, distance): ([f64; 2], f64),
        weight: f64,
        by_pose: &[(Option<Finger>, [f64; COLUMNS]); 2],
    ) {
        let mut gradient = [0.0; SIZES];
        for (sphere, share) in point.ends().into_iter().flatten() {
            if let Some(by) = self.jacobian.get(sphere) {
                for (to, by) in gradient.iter_mut().zip(point.moved(by, share, normal)) {
                    *to += by;
                }
            }
        }
        self.add_residual(&gradient, distance, weight, by_pose);
    }

    /// Adds a joint that a finder has seen: the spheres it moves with and their shares, the axis of the image along which
    /// it is `residual` pixels off, its weight as of an open hand, and the gradient by the pose.
    pub(super) fn add_joint(
        &mut self,
        (spheres, axis): ([(usize, f64); 2], usize),
        residual: f64,
        weight: f64,
        by_pose: &(Option<Finger>, [f64; COLUMNS]),
    ) {
        let mut gradient = [0.0; SIZES];
        for (sphere, share) in spheres {
            let Some(by) = self.jacobian.get(sphere) else { return };
            gradient.iter_mut().zip(by).for_each(|(to, by)| *to += share * by[axis]);
        }
        // Joints do not move with the flesh round them.
        for finger in 0..Finger::COUNT {
            gradient[OF_FINGER * finger..][LATERAL].fill(0.0);
        }
        let openness = by_pose.0.map_or(1.0, |finger| self.openness[finger as usize]);
        self.add_residual(&gradient, residual, weight * openness, &[*by_pose]);
    }

    fn add_residual(
        &mut self,
        gradient: &[f64; SIZES],
        distance: f64,
        weight: f64,
        by_pose: &[(Option<Finger>, [f64; COLUMNS])],
    ) {
        // A point moves with the sizes of a finger or two.
        let (mut places, mut count) = ([0; SIZES], 0);
        for (i, _) in gradient.iter().enumerate().filter(|(_, by)| **by != 0.0) {
            places[count] = i;
            count += 1;
        }
        for (n, &i) in places[..count].iter().enumerate() {
            let by = gradient[i] * weight;
            self.b[i] -= by * distance;
            for &j in &places[..=n] {
                self.a[(i, j)] += by * gradient[j];
            }
            for (finger, columns) in by_pose {
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
        let bones = &values.as_slice()[OUTLINE + BONES * finger as usize..][..BONES];
        let values = &values.as_slice()[OF_FINGER * finger as usize..][..OF_FINGER];
        let f = &mut m.fingers[finger as usize];
        for (place, v) in f.base.iter_mut().zip(&values[BASE]) {
            *place += v * hand;
        }
        f.place_metacarpal(finger);
        for (bone, v) in f.bones.iter_mut().zip(bones) {
            *bone *= (values[LENGTH] + v).exp();
        }
        for (r, v) in f.radii.iter_mut().chain(&mut f.waists).zip(&values[RADII]) {
            *r *= v.exp();
        }
        for (place, v) in f.lateral.iter_mut().zip(&values[LATERAL]) {
            *place += v * hand;
        }
    }
    let values = &values.as_slice()[PALM..];
    for (web, v) in m.webs.iter_mut().zip(&values[WEBS]) {
        *web = (*web + v).clamp(WEB_LENGTHS[0], WEB_LENGTHS[1]);
    }
    m.web_root = (m.web_root + values[WEB_ROOT]).clamp(WEB_ROOTS[0], WEB_ROOTS[1]);
    m.ulnar_border += values[ULNAR_BORDER] * hand;
    m.wrist_lateral += values[WRIST_LATERAL] * hand;
    m.wrist_half_width *= values[WRIST].exp();
    m.forearm = (m.forearm * values[FOREARM].exp()).clamp(FOREARMS[0], FOREARMS[1]);
    m
}

/// Standard deviation of a size from that of the fit.
fn deviation(t: &SizesTuning, i: usize, joints: bool) -> f64 {
    match i {
        0..OF_FINGER if joints && BASE.contains(&i) => t.thumb_joints,
        0..OF_FINGER => t.thumb * finger_deviation(t, i),
        OF_FINGER..PALM => finger_deviation(t, i % OF_FINGER),
        OUTLINE.. if i < OUTLINE + BONES => t.thumb_joints,
        OUTLINE.. => t.bone,
        _ => palm_deviation(t, i - PALM),
    }
}

fn finger_deviation(t: &SizesTuning, i: usize) -> f64 {
    match i {
        _ if BASE.contains(&i) => t.base,
        LENGTH => t.length,
        _ if RADII.contains(&i) => t.radius,
        _ => t.lateral,
    }
}

fn palm_deviation(t: &SizesTuning, i: usize) -> f64 {
    match i {
        WEB_ROOT => t.web_root,
        ULNAR_BORDER | WRIST_LATERAL => t.border,
        WRIST => t.wrist,
        FOREARM => t.forearm,
        _ => t.web,
    }
}
