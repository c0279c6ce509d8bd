//! Where the picture of the last frame has gone: optical flow of the whole model at once.
//!
//! Points of the surface that was seen keep what they looked like. The state that brings them to where the new
//! picture looks the same is found by Gauss-Newton (Lucas & Kanade 1981, with the motion of the model's
//! parameters in the place of a translation: Bregler & Malik 1998), from coarse pictures to fine ones. Beside the
//! silhouette a picture is evenly dark, so that outlines move with the flow, whatever is behind them.

use super::super::cover::{COARSE, Cover};
use super::super::evidence::Evidence;
use super::super::model::HandModel;
use super::super::normal_equations::PointSums;
use super::super::projection::{COLUMNS, FREE, ProjectedSphere};
use super::super::state::ModelState;
use super::geometry::{dot, in_plane};
use super::solver::{Scene, Solver};
use handcast_hand::{Finger, Shape};
use handcast_vision::tuning::tuning;
use handcast_vision::{Pyramid, PyramidSample};

tuning! {
    /// How the picture's motion is followed.
    pub struct FlowTuning {
        /// Most steps in each picture of a pyramid, from the cells of the evidence to those of four times their size.
        ["steps", "spec/tracking.md 8"]
        pub steps: usize = 2,
        /// A step that moves nothing by more than this is the last.
        ["hand lengths, rad", "chosen by eye"]
        pub precision: f64 = 0.003,
        /// How much darker than the mean of the hand its background is taken to be.
        ["levels", "chosen by eye"]
        pub contrast: f32 = 60.0,
        /// Every how many cells there is a point, each way.
        ["cells of 2 pixels", "spec/tracking.md 8"]
        pub stride: usize = 3,
        /// Fewest points that tell a motion.
        ["points", "chosen by eye"]
        pub fewest: usize = 30,
        /// Standard deviation of luminance that noise and light leave from one frame to the next.
        ["levels", "spec/experiments.md, Motion prediction: 6 and 10 compared"]
        pub noise: f64 = 6.0,
        /// Difference that counts as an outlier: something else is in front.
        ["levels", "chosen by eye"]
        pub outlier: f64 = 25.0,
        /// Motion of a joint angle of which half is taken: noise moves fingers that rest.
        ["rad", "spec/tracking.md 8; handcast bench track --no-methods --every N"]
        pub resting: f64 = 0.1,
        /// Independent samples of luminance as which the hand counts.
        ["samples", "spec/tracking.md 8; handcast bench track --no-methods --every N"]
        pub samples: f64 = 200.0,
    }
}

/// Length of an axis, pixels, below which it has no direction in the image.
const FORESHORTENED: f64 = 1e-6;
/// Least radius of a surface, pixels.
const THINNEST: f64 = 0.5;

/// A point of the model's surface.
#[derive(Clone, Copy, Debug)]
struct Point {
    /// The spheres of the axis that it goes with, and the share of the second.
    ends: [u8; 2],
    share: f64,
    /// Its place beside the axis in radii: along and across.
    offset: [f64; 2],
    /// Whether it is on the palm.
    palm: bool,
    /// What it looked like.
    seen: [PyramidSample; Pyramid::LEVELS],
}

/// The last picture, as seen on the model. Reused from frame to frame.
#[derive(Clone, Debug, Default)]
pub(super) struct FlowTracker {
    tuning: FlowTuning,
    picture: Pyramid,
    /// Whether `picture` is that of the present frame.
    present: bool,
    points: Vec<Point>,
    spheres: Vec<ProjectedSphere>,
    cover: Cover,
}

/// The axis of a point in the image.
struct Axis<'a> {
    ends: [&'a ProjectedSphere; 2],
    along: [f64; 2],
    across: [f64; 2],
    length: f64,
}

impl<'a> Axis<'a> {
    fn of(ends: [u8; 2], spheres: &'a [ProjectedSphere]) -> Option<Self> {
        let (a, b) = (spheres.get(usize::from(ends[0]))?, spheres.get(usize::from(ends[1]))?);
        let [x, y] = [b.disc.x - a.disc.x, b.disc.y - a.disc.y];
        let length = x.hypot(y);
        let along = if length > FORESHORTENED { [x / length, y / length] } else { [1.0, 0.0] };
        Some(Self { ends: [a, b], along, across: [-along[1], along[0]], length })
    }

    /// Share of the second end and offset in radii of what is at `at`.
    fn locate(&self, at: [f64; 2]) -> (f64, [f64; 2]) {
        let start = &self.ends[0].disc;
        let away = [at[0] - start.x, at[1] - start.y];
        let (along, across) = (dot(away, self.along), dot(away, self.across));
        let share = (along / self.length.max(FORESHORTENED)).clamp(0.0, 1.0);
        let radius = self.radius(share);
        (share, [(along - share * self.length) / radius, across / radius])
    }

    fn radius(&self, share: f64) -> f64 {
        let [a, b] = self.ends.map(|s| s.disc.radius);
        (a + share * (b - a)).max(THINNEST)
    }

    /// Where the point is, seen from its axis, pixels.
    fn beside(&self, p: &Point) -> [f64; 2] {
        let radius = self.radius(p.share);
        [0, 1].map(|k| radius * (p.offset[0] * self.along[k] + p.offset[1] * self.across[k]))
    }

    /// Where the point is, pixels.
    fn place(&self, p: &Point) -> [f64; 2] {
        let ([a, b], [x, y]) = (self.ends.map(|s| s.disc), self.beside(p));
        [a.x + p.share * (b.x - a.x) + x, a.y + p.share * (b.y - a.y) + y]
    }

    /// Derivative of the point's place along `direction` by the columns of both ends: it turns with the axis, and its
    /// distance from it grows with the radius.
    fn gradient(&self, p: &Point, direction: [f64; 2]) -> [(Option<Finger>, [f64; COLUMNS]); 2] {
        let beside = self.beside(p);
        let radius = self.radius(p.share);
        // Of an axis that points at the camera the direction in the image is uncertain.
        let turning = if self.length > radius {
            (beside[0] * direction[1] - beside[1] * direction[0]) / self.length
        } else {
            0.0
        };
        let growing = dot(beside, direction) / radius;
        let end = |s: &ProjectedSphere, share: f64, turning: f64| {
            let [x, y] = [0, 1].map(|k| share * direction[k] + turning * self.across[k]);
            let mut gradient = s.columns.map(|c| c[0] * x + c[1] * y + c[2] * share * growing);
            if p.palm {
                gradient[FREE..].fill(0.0);
            }
            (s.finger.filter(|_| !p.palm), gradient)
        };
        let [a, b] = self.ends;
        [end(a, 1.0 - p.share, -turning), end(b, p.share, turning)]
    }
}

impl FlowTracker {
    /// A tracker that has seen no picture.
    pub(super) fn new(tuning: FlowTuning) -> Self {
        Self { tuning, ..Self::default() }
    }

    /// Forgets the last picture.
    pub(super) fn forget(&mut self) {
        self.points.clear();
        self.present = false;
    }

    /// Loads the picture of `evidence`: luminance beside its mean on the hand. False when there is none.
    fn load(&mut self, evidence: &Evidence) -> bool {
        let (luma, width) = evidence.coarse_luma();
        let covered = evidence.covered();
        let cells = luma.iter().zip(covered);
        let sum: f32 = cells.clone().map(|(v, covered)| covered * v).sum();
        let area: f32 = covered.iter().sum();
        if area <= 0.0 {
            return false;
        }
        let mean = sum / area;
        let contrast = self.tuning.contrast;
        let values = cells.map(|(v, covered)| covered * (v - mean) - (1.0 - covered) * contrast);
        self.picture.load(width, values);
        true
    }

    /// Keeps what the surface of the model of `state` looks like.
    pub(super) fn remember(&mut self, model: &HandModel, evidence: &Evidence, state: &ModelState) {
        self.points.clear();
        if !std::mem::take(&mut self.present) && !self.load(evidence) {
            return;
        }
        let window = evidence.window();
        let origin = window.origin();
        model.project_moving(state, &mut self.spheres);
        let primitives = model.shape().primitives();
        self.cover.draw(primitives, &self.spheres, state.scale, window, self.tuning.stride);
        for (part, square) in self.cover.squares() {
            let palm = part == Shape::PALM;
            let cell = square.map(|v| v as f32 + 0.5);
            let place = cell.map(|v| f64::from(v) * COARSE);
            let seen = window.silhouette().get(place[0] as u32, place[1] as u32);
            if !(palm || Shape::bone(part).is_some()) || !seen {
                continue;
            }
            // The palm goes along from the wrist to the middle finger.
            let ends = match primitives.get(part).map(|p| &p.spheres[..]) {
                Some(&[radial, ..]) if palm => [radial, Shape::finger_spheres(Finger::Middle)[0] as u8],
                Some(&[a, b, ..]) => [a, b],
                _ => continue,
            };
            let Some(axis) = Axis::of(ends, &self.spheres) else { continue };
            let (share, offset) = axis.locate([place[0] + origin[0], place[1] + origin[1]]);
            let seen = std::array::from_fn(|level| self.picture.sample(level, cell));
            self.points.push(Point { ends, share, offset, palm, seen });
        }
    }

    /// The normal equations of how what the points looked like differs from the picture of `level` with the model at
    /// `state`.
    fn differences(&mut self, scene: &Scene<'_>, state: &ModelState, level: usize) -> PointSums {
        scene.model.project_moving(state, &mut self.spheres);
        let origin = scene.evidence.window().origin();
        let FlowTuning { noise, outlier, samples, .. } = self.tuning;
        let weight = samples / self.points.len() as f64 / (noise * noise);
        let mut sums = PointSums::new();
        for p in &self.points {
            let (Some(axis), Some(then)) = (Axis::of(p.ends, &self.spheres), p.seen.get(level)) else {
                continue;
            };
            let [x, y] = axis.place(p);
            let cell = [x - origin[0], y - origin[1]].map(|v| (v / COARSE) as f32);
            let now = self.picture.sample(level, cell);
            let difference = f64::from(now.value - then.value);
            // The mean of both slopes leads farther than either (Benhimane & Malis 2004).
            let gradient = [0, 1].map(|k| 0.5 * f64::from(now.gradient[k] + then.gradient[k]) / COARSE);
            let robust = (1.0 + (difference / outlier).powi(2)).powi(-2);
            sums.add(&axis.gradient(p, gradient), difference, robust * weight);
        }
        sums
    }

    /// The state to which the picture has moved since the last frame, whose state is the one that `prior` predicts;
    /// `None` without a picture, or when none was kept. Tilt and size, which motion in the image hardly shows, stay,
    /// and so do joint angles that hardly move.
    pub(super) fn follow(&mut self, solver: &Solver, scene: &Scene<'_>) -> Option<ModelState> {
        let Scene { evidence, prior, .. } = *scene;
        if self.points.len() < self.tuning.fewest || !self.load(evidence) {
            return None;
        }
        self.present = true;
        let mut state = prior.predicted.clone();
        for level in (0..Pyramid::LEVELS).rev() {
            for _ in 0..self.tuning.steps {
                let mut equations = self.differences(scene, &state, level).into_equations();
                prior.add_to(&mut equations, &solver.tuning.prior, evidence, &state);
                if solver.step(&equations, prior, &mut state) < self.tuning.precision {
                    break;
                }
            }
        }
        let last = prior.predicted;
        let resting = self.tuning.resting;
        let turned = state.rotation * last.rotation.inverse();
        for (angle, before) in state.free.iter_mut().zip(&last.free) {
            let square = (*angle - before).powi(2);
            *angle = before + (*angle - before) * square / (square + resting * resting);
        }
        Some(ModelState { scale: last.scale, rotation: in_plane(&turned) * last.rotation, ..state })
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::evidence::Evidence;
    use super::super::prior::Prior;
    use super::super::testing::open;
    use super::super::{Registration, RegistrationOptions};
    use super::*;
    use handcast_hand::{Morphology, Side};
    use handcast_vision::Mask;
    use image::{Rgb, RgbImage};
    use nalgebra::UnitQuaternion;

    /// The silhouette of a state, and a picture of it before a striped background.
    fn seen(model: &mut HandModel, state: &ModelState) -> (Mask, RgbImage) {
        let mut silhouette = Mask::new(320, 240);
        model.draw(state, [0.0, 0.0], &mut silhouette);
        let image = RgbImage::from_fn(320, 240, |x, y| {
            Rgb([if silhouette.get(x, y) { 150 } else { 40 * (x / 8 % 4) as u8 }; 3])
        });
        (silhouette, image)
    }

    fn loaded((silhouette, image): &(Mask, RgbImage), with_picture: bool) -> Evidence {
        let mut evidence = Evidence::default();
        assert!(evidence.load(silhouette, None, with_picture.then_some(image), 1).unwrap());
        evidence
    }

    /// Mean distance of the joints of two states, pixels.
    fn apart(model: &HandModel, a: &ModelState, b: &ModelState) -> f64 {
        let (a, b) = (model.joints(a), model.joints(b));
        a.iter().zip(&b).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum::<f64>() / a.len() as f64
    }

    #[test]
    fn the_hand_is_followed_to_where_it_went() {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let open = open();
        let then = open.state.clone();
        // By less than half the distance between two fingers, which look alike here.
        let moved = ModelState { wrist: [167.0, 205.0], ..then.clone() };
        let turned =
            ModelState { rotation: UnitQuaternion::from_euler_angles(0.0, 0.0, 0.07), ..then.clone() };
        let before = seen(&mut model, &then);
        for now in [moved, turned] {
            let after = seen(&mut model, &now);
            let mut registration = Registration::new(RegistrationOptions::default());
            registration.remember(&model, &loaded(&before, true), &then);
            let prior = Prior { predicted: &then, open: &open };
            let found = registration.follow(&mut model, &loaded(&after, true), &prior).unwrap();
            let (was, is) = (apart(&model, &then, &now), apart(&model, &found, &now));
            assert!(is < 0.35 * was, "{was} {is}");
        }
    }

    #[test]
    fn without_a_picture_or_after_a_loss_nothing_is_followed() {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let open = open();
        let then = open.state.clone();
        let picture = seen(&mut model, &then);
        let prior = Prior { predicted: &then, open: &open };
        for (before, after) in [(true, false), (false, true), (false, false)] {
            let mut registration = Registration::new(RegistrationOptions::default());
            registration.remember(&model, &loaded(&picture, before), &then);
            assert!(registration.follow(&mut model, &loaded(&picture, after), &prior).is_none());
        }
        let mut registration = Registration::new(RegistrationOptions::default());
        registration.remember(&model, &loaded(&picture, true), &then);
        registration.forget();
        assert!(registration.follow(&mut model, &loaded(&picture, true), &prior).is_none());
    }

    #[test]
    fn gradients_of_points_are_central_differences_of_their_places() {
        let model = HandModel::new(&Morphology::default(), Side::Right);
        let state = open().state;
        let mut spheres = Vec::new();
        model.project_moving(&state, &mut spheres);
        let place = |state: &ModelState, p: &Point| {
            let mut spheres = Vec::new();
            model.project_moving(state, &mut spheres);
            Axis::of(p.ends, &spheres).unwrap().place(p)
        };
        let [_, base, middle, _] = Shape::finger_spheres(Finger::Index).map(|i| i as u8);
        let seen = [PyramidSample::default(); Pyramid::LEVELS];
        let p = Point { ends: [base, middle], share: 0.4, offset: [0.1, 0.6], palm: false, seen };
        let axis = Axis::of(p.ends, &spheres).unwrap();
        let found = axis.locate(axis.place(&Point { offset: [0.0, 0.6], ..p }));
        assert!((found.0 - 0.4).abs() < 1e-9 && (found.1[1] - 0.6).abs() < 1e-9, "{found:?}");
        for direction in [[1.0, 0.0], [0.0, 1.0]] {
            let ends = axis.gradient(&p, direction);
            for column in 0..COLUMNS - 1 {
                let slope: f64 = ends.iter().map(|(_, gradient)| gradient[column]).sum();
                let h = 1e-5;
                let mut step = [0.0; super::super::super::projection::PARAMETERS];
                step[super::super::super::projection::parameter(Finger::Index, column)] = h;
                let plus = dot(place(&state.stepped(&step), &p), direction);
                let minus = dot(place(&state.stepped(&step.map(|v| -v)), &p), direction);
                let expected = (plus - minus) / (2.0 * h);
                assert!((slope - expected).abs() < 1e-3, "{column}: {slope} {expected}");
            }
        }
    }
}
