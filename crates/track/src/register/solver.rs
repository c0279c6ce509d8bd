//! One search: rounds of pairing outlines, solving for a step and taking it, and the cost of what was found.

use std::ops::Range;

use super::super::appearance::{Appearance, Explained, ShadedModel};
use super::super::evidence::Evidence;
use super::super::model::HandModel;
use super::super::normal_equations::{NormalEquations, PointSums};
use super::super::objective::NonOverlap;
use super::super::outline::{self, OutlinePoint};
use super::super::projection::{ProjectedSphere, SCALE};
use super::super::state::{HAND_LENGTH, ModelState};
use super::columns::Columns;
use super::geometry::dot;
use super::landmarks::{JointPlaces, Landmarks};
use super::options::{PairingTuning, RegistrationTuning};
use super::prior::Prior;
use super::{contact, sizes};
use handcast_hand::{Domain, Shape};

/// The outcome for one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registered {
    /// Non-overlap rate (eq. 7).
    pub rate: f64,
    /// Intersection over union.
    pub iou: f64,
    /// What postures are compared by: the negative logarithm of their probability, but for a constant.
    pub cost: f64,
    /// Share of the picture's residuals that is not noise, 0 to 1; 0 without a picture.
    pub beyond_noise: f64,
}

/// What one frame is registered with.
pub(super) struct Scene<'a> {
    pub(super) model: &'a mut HandModel,
    pub(super) evidence: &'a Evidence,
    pub(super) prior: &'a Prior<'a>,
}

/// Searches. Holds the buffers, so that it allocates nothing once they have grown.
#[derive(Clone, Debug)]
pub(super) struct Solver {
    pub(super) tuning: RegistrationTuning,
    pub(super) domain: Domain,
    pub(super) objective: NonOverlap,
    pub(super) appearance: Appearance,
    landmarks: Landmarks,
    spheres: Vec<ProjectedSphere>,
    outline: Vec<OutlinePoint>,
    columns: Columns,
}

impl Solver {
    pub(super) fn new(tuning: RegistrationTuning) -> Self {
        Self {
            domain: Domain::free(),
            objective: NonOverlap::default(),
            appearance: Appearance::new(tuning.appearance),
            landmarks: Landmarks::new(tuning.landmarks),
            spheres: Vec::new(),
            outline: Vec::new(),
            columns: Columns::default(),
            tuning,
        }
    }

    /// Searches from a hypothesis, unless its first rounds lead nowhere near, and keeps what it finds where
    /// that costs less than `best` at `state`.
    pub(super) fn try_hypothesis(
        &mut self,
        scene: &mut Scene<'_>,
        mut hypothesis: ModelState,
        state: &mut ModelState,
        best: &mut Registered,
    ) {
        let t = self.tuning.rounds;
        let first = t.pruned_after.min(t.most);
        if self.refine(scene, &mut hypothesis, 0..first, None).cost > best.cost + t.pruned_beyond {
            return;
        }
        let found = self.refine(scene, &mut hypothesis, first..t.most, None);
        if found.cost < best.cost {
            (*state, *best) = (hypothesis, found);
        }
    }

    /// Learns the relief of the hand of `state`.
    pub(super) fn learn_relief(&mut self, model: &HandModel, evidence: &Evidence, state: &ModelState) {
        model.project_moving(state, &mut self.spheres);
        self.appearance.learn(&shaded(model, &self.spheres, state, evidence));
    }

    /// Learns where a finder has the joints of the hand of `state`.
    pub(super) fn learn_joints(&mut self, model: &HandModel, seen: &JointPlaces, state: &ModelState) {
        self.landmarks.learn(model, state, seen);
    }

    /// Mean distance of the joints seen from those of the model, hand lengths; `None` where none were.
    pub(super) fn joints_away(
        &self,
        model: &HandModel,
        evidence: &Evidence,
        state: &ModelState,
    ) -> Option<f64> {
        Some(self.landmarks.distance(model, state, evidence.joints()?))
    }

    /// Moves `state` in these rounds of all. `first` are the normal equations of the first of them, if known.
    pub(super) fn refine(
        &mut self,
        scene: &mut Scene<'_>,
        state: &mut ModelState,
        rounds: Range<usize>,
        mut first: Option<&NormalEquations>,
    ) -> Registered {
        let t = self.tuning.rounds;
        let last = (t.most.max(2) - 1) as f64;
        let mut settled = false;
        for round in rounds {
            let progress = round as f64 / last;
            if settled && progress <= t.shaded_from {
                continue;
            }
            let equations = match first.take() {
                Some(equations) => equations,
                None => &self.linearise(scene, state, progress, None),
            };
            let moved = self.step(equations, scene.prior, state);
            if moved < t.precision && progress > t.shaded_from {
                break;
            }
            settled = moved < t.settled;
        }
        self.score(scene, state)
    }

    /// How well `state` agrees with the evidence and with the prior.
    pub(super) fn score(&mut self, scene: &mut Scene<'_>, state: &ModelState) -> Registered {
        let t = &self.tuning;
        let rate = self.objective.rate(scene.model, state, scene.evidence.window());
        let iou = self.objective.last_iou(scene.evidence.window());
        let mut cost = t.rate * rate + scene.prior.cost(&t.prior, scene.evidence, state);
        scene.model.project_moving(state, &mut self.spheres);
        cost += contact::cost(&self.spheres, &t.contact);
        if let Some(seen) = scene.evidence.joints() {
            cost += self.landmarks.cost((scene.model, &self.spheres), state, seen);
        }
        let mut explained = Explained::default();
        if t.appearance.compared_samples > 0.0 && scene.evidence.has_picture() {
            explained = self.appearance.rate(&shaded(scene.model, &self.spheres, state, scene.evidence));
        }
        cost += explained.cost;
        Registered { rate, iou, cost, beyond_noise: explained.beyond_noise }
    }

    /// The normal equations around `state`; `progress` goes from 0 in the first round to 1 in the last. `sizes`, if
    /// given, is filled with the pairs of outline points.
    pub(super) fn linearise(
        &mut self,
        scene: &mut Scene<'_>,
        state: &ModelState,
        progress: f64,
        mut sizes: Option<&mut sizes::SizeEquations>,
    ) -> NormalEquations {
        let window = scene.evidence.window();
        self.objective.rate(scene.model, state, window);
        let turns = scene.model.project_moving(state, &mut self.spheres);
        if let Some(forearm) = window.forearm() {
            scene.model.add_forearm(state, forearm.axis, &mut self.spheres);
        }
        self.trace(scene, state);
        let mut equations = self.pair(scene.evidence, state, progress, sizes.as_deref_mut()).into_equations();
        if let (Some(sizes), Some(seen)) = (sizes, scene.evidence.joints()) {
            self.landmarks.add_to_sizes(sizes, (scene.model, &self.spheres), state, seen);
        }
        let t = &self.tuning;
        scene.prior.add_to(&mut equations, &t.prior, scene.evidence, state);
        contact::add_to(&mut equations, &self.spheres, &t.contact);
        if let Some(seen) = scene.evidence.joints() {
            self.landmarks.add_to(&mut equations, (scene.model, &self.spheres), state, seen);
        }
        if progress > t.rounds.shaded_from && scene.evidence.has_picture() {
            let shaded = shaded(scene.model, &self.spheres, state, scene.evidence);
            self.appearance.add_to(&mut equations, &shaded, &turns);
        }
        equations
    }

    /// Traces the outline of the model as last drawn and projected.
    fn trace(&mut self, scene: &Scene<'_>, state: &ModelState) {
        let window = scene.evidence.window();
        let forearm = window.forearm().map(|_| &Shape::FOREARM[..]);
        outline::trace(
            scene.model.shape().hulls().chain(forearm),
            &self.spheres,
            (self.objective.drawn(), window.origin()),
            self.tuning.pairing.spacing * (HAND_LENGTH * state.scale),
            &mut self.outline,
        );
        if let Some(forearm) = window.forearm() {
            let cut = self.tuning.evidence.cut;
            self.outline.retain(|p| forearm.side(p.position) > cut);
        }
    }

    /// Pairs the points of the model's outline with the nearest of the image's, and those with the nearest of the
    /// model's.
    fn pair(
        &mut self,
        evidence: &Evidence,
        state: &ModelState,
        progress: f64,
        sizes: Option<&mut sizes::SizeEquations>,
    ) -> PointSums {
        let hand = HAND_LENGTH * state.scale;
        let PairingTuning { spacing, image_spacing, facing, noise, correlation, outlier } =
            self.tuning.pairing;
        let mut pairs = Pairs {
            spheres: &self.spheres,
            outlier: hand * outlier[0] * (outlier[1] / outlier[0]).powf(progress),
            per_pixel: 1.0 / (correlation * hand) / (noise * hand).powi(2),
            sums: PointSums::new(),
            sizes,
        };
        for p in &self.outline {
            if let Some(q) = evidence.nearest(p.position)
                && dot(q.normal.map(f64::from), p.normal) > facing
            {
                pairs.add(p, q.position.map(f64::from), q.normal.map(f64::from), p.length);
            }
        }
        let per_pixel = evidence.points_per_pixel();
        let stride = (image_spacing * spacing * hand * per_pixel).round().max(1.0);
        self.columns.load(&self.outline);
        let mut near = None;
        for q in evidence.points().iter().step_by(stride as usize) {
            near = self.columns.nearest(q, facing as f32, near);
            if let Some(p) = near.and_then(|i| self.outline.get(i)) {
                pairs.add(p, q.position.map(f64::from), q.normal.map(f64::from), stride / per_pixel);
            }
        }
        pairs.sums
    }

    /// Moves `state` by the solution of the normal equations, but not too far, and inside the constraints, on the way
    /// to the open hand; gives the largest movement (hand lengths, radians).
    pub(super) fn step(&self, equations: &NormalEquations, prior: &Prior<'_>, state: &mut ModelState) -> f64 {
        let step = equations.constrained_step(&self.tuning.solver, &state.free, self.domain.half_spaces());
        let hand = HAND_LENGTH * state.scale;
        let moved = step.iter().enumerate().map(|(i, v)| v.abs() / if i < SCALE { hand } else { 1.0 });
        let most = moved.fold(0.0, f64::max);
        let shrink = (self.tuning.rounds.longest_step / most).min(1.0);
        *state = state.stepped(&step.map(|v| v * shrink));
        self.bring_inside(prior, state);
        most
    }

    /// Brings the free angles inside the constraints, on the way to the open hand.
    pub(super) fn bring_inside(&self, prior: &Prior<'_>, state: &mut ModelState) {
        state.bring_inside(&self.domain, &prior.open.state.free);
    }
}

/// The model of `state`, projected to `spheres`, in front of the picture.
fn shaded<'a>(
    model: &'a HandModel,
    spheres: &'a [ProjectedSphere],
    state: &ModelState,
    evidence: &'a Evidence,
) -> ShadedModel<'a> {
    ShadedModel { primitives: model.shape().primitives(), spheres, scale: state.scale, evidence }
}

/// Pairs of outline points as residuals.
struct Pairs<'a> {
    spheres: &'a [ProjectedSphere],
    /// Distance at which a pair counts as an outlier, pixels.
    outlier: f64,
    /// Information of a pixel of outline, 1 / pixels².
    per_pixel: f64,
    sums: PointSums,
    sizes: Option<&'a mut sizes::SizeEquations>,
}

impl Pairs<'_> {
    /// Adds the distance of `p` from the image's outline at `position`, along its normal.
    fn add(&mut self, p: &OutlinePoint, position: [f64; 2], normal: [f64; 2], length: f64) {
        let away = [p.position[0] - position[0], p.position[1] - position[1]];
        let robust = (1.0 + dot(away, away) / (self.outlier * self.outlier)).powi(-2);
        let mut weight = robust * self.per_pixel * length;
        let (gradient, distance) = (p.gradient(self.spheres, normal), dot(away, normal));
        if let Some(sizes) = &mut self.sizes {
            weight *= sizes.openness(&gradient);
            sizes.add(p, (normal, distance), weight, &gradient);
        }
        self.sums.add(&gradient, distance, weight);
    }
}
