//! Registration by gradients: damped Gauss-Newton on the distances between the outlines of the model and of
//! the image, from several hypotheses.
//!
//! In each round the points of the model's outline are paired with the nearest points of the silhouette's
//! outline, and those of the silhouette's with the nearest of the model's. The distances along the normals,
//! robustly weighted (Geman & McClure 1985), and the prior ([`Prior`]) make normal equations in the 22 parameters;
//! their solution under the biomechanical constraints is the step to the next state.
//!
//! Outlines have many local minima: a finger that looks shorter may be bent towards the camera or away from
//! it, and a fist looks like a tilted hand. Other postures are therefore tried where they might explain the
//! silhouette as well, and compared by non-overlap rate (eq. 7), prior and shading. In the later rounds shading
//! turns the bones, too.

mod columns;
mod contact;
mod flow;
mod geometry;
mod hypotheses;
mod landmarks;
mod options;
mod postures;
mod prior;
mod sizes;
mod solver;
#[cfg(test)]
mod testing;

pub use contact::ContactTuning;
pub use flow::FlowTuning;
pub use hypotheses::HypothesisTuning;
pub use landmarks::{JointPlaces, LandmarkTuning};
pub use options::{PairingTuning, RegistrationOptions, RegistrationTuning, RoundTuning};
pub use postures::PostureTuning;
pub use prior::{OpenState, Prior, PriorTuning};
pub use sizes::SizesTuning;
pub use solver::Registered;

use super::appearance::Relief;
use super::evidence::Evidence;
use super::model::HandModel;
use super::normal_equations::NormalEquations;
use super::state::ModelState;
use flow::FlowTracker;
use hypotheses::Hypotheses;
pub(super) use hypotheses::largest_difference;
use postures::PostureLibrary;
use sizes::Sizes;
use solver::{Scene, Solver};

/// Frames among which the hypotheses are divided while none is unlikely: each of these has its turn.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Turn {
    /// The last state, and the thumb across the palm.
    LastState,
    /// Hands whose fingers close together.
    Closing,
    /// Known postures.
    Known,
}

impl Turn {
    const ALL: [Self; 3] = [Self::LastState, Self::Closing, Self::Known];

    fn of(frame: usize) -> Self {
        Self::ALL[frame % Self::ALL.len()]
    }
}

/// What the frames so far have come to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Progress {
    mean_cost: Option<f64>,
    frame: usize,
}

/// What is known of the side of the hand that faces the camera.
#[derive(Clone, Debug, Default)]
pub(super) struct Face {
    library: Option<PostureLibrary>,
    relief: Relief,
}

/// Registers a model on evidence. Holds the buffers, so that it allocates nothing once they have grown.
#[derive(Clone, Debug)]
pub struct Registration {
    refine_sizes: bool,
    solver: Solver,
    flow: FlowTracker,
    hypotheses: Hypotheses,
    /// Those of the model, once a hand has been seen.
    sizes: Option<Sizes>,
    /// Mean cost of the last frames.
    mean_cost: Option<f64>,
    /// Frames registered.
    frame: usize,
}

impl Registration {
    /// A registration with these options.
    pub fn new(options: RegistrationOptions) -> Self {
        let RegistrationOptions { refine_sizes, tuning } = options;
        Self {
            refine_sizes,
            solver: Solver::new(tuning),
            flow: FlowTracker::new(tuning.flow),
            hypotheses: Hypotheses::default(),
            sizes: None,
            mean_cost: None,
            frame: 0,
        }
    }

    /// Evaluations of the non-overlap rate so far.
    pub fn evaluations(&self) -> usize {
        self.solver.objective.evaluations()
    }

    /// Moves `state`, the last one, to where model and evidence agree best: from the predicted state and, in most frames
    /// unless that leads to where a finder has seen the joints, from the same with fingers in other postures, and from what
    /// was found with one finger folded more or less; and, in turns while the frame costs no more than the last ones, from
    /// the last state, from a thumb bent across the palm, from hands whose fingers close together, and from known postures
    /// with similar silhouettes.
    pub fn register(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        prior: &Prior<'_>,
        state: &mut ModelState,
    ) -> Registered {
        self.register_beside(model, evidence, prior, state, None)
    }

    /// As [`Registration::register`], from one more hypothesis: it is judged like the others.
    pub fn register_beside(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        prior: &Prior<'_>,
        state: &mut ModelState,
        other: Option<ModelState>,
    ) -> Registered {
        let scene = &mut Scene { model, evidence, prior };
        let solver = &mut self.solver;
        let last = std::mem::replace(state, prior.predicted.clone());
        let first = solver.linearise(scene, state, 0.0, None);
        let mut best = solver.refine(scene, state, 0..solver.tuning.rounds.most, Some(&first));
        if let Some(other) = other {
            solver.try_hypothesis(scene, other, state, &mut best);
        }
        self.frame += 1;
        // Where a finder has seen the hand like this, other postures are mostly worse.
        let LandmarkTuning { agrees, tried_every, .. } = solver.tuning.landmarks;
        let agree = solver.joints_away(scene.model, evidence, state).is_some_and(|away| away < agrees);
        if !agree || self.frame.is_multiple_of(tried_every.max(1)) {
            self.try_others((last, &first), scene, state, &mut best);
        }
        let t = self.solver.tuning.hypotheses;
        let mean = self.mean_cost.get_or_insert(best.cost);
        *mean += if best.cost < *mean { t.mean_falls } else { t.mean_rises } * (best.cost - *mean);
        best
    }

    /// Tries the other hypotheses, and keeps what costs less than `best` at `state`; `first` are the normal equations around
    /// the predicted state, `last` is the last one.
    fn try_others(
        &mut self,
        (last, first): (ModelState, &NormalEquations),
        scene: &mut Scene<'_>,
        state: &mut ModelState,
        best: &mut Registered,
    ) {
        let Self { solver, hypotheses, .. } = self;
        let (prior, t) = (scene.prior, solver.tuning.hypotheses);
        let unlikely = self.mean_cost.is_none_or(|mean| best.cost > mean + t.unlikely_beyond);
        let turn = Turn::of(self.frame);
        let due = |hypotheses: Turn| unlikely || turn == hypotheses;
        if due(Turn::LastState) && largest_difference(&last.free, &prior.predicted.free) > t.moving {
            solver.try_hypothesis(scene, last, state, best);
        }
        if let Some(bent) = hypotheses::bent_fingers(solver, scene, prior.predicted, first) {
            solver.try_hypothesis(scene, bent, state, best);
        }
        hypotheses::try_folded(solver, scene, state, best);
        if due(Turn::Closing)
            && let Some(closing) = hypotheses::closing_hand(solver, scene, state, best.rate)
        {
            solver.try_hypothesis(scene, closing, state, best);
        }
        if due(Turn::LastState) && state.thumb_mcp.abs() > t.thumb_beyond {
            let thumb = hypotheses::bent_thumb(solver, scene, state);
            solver.try_hypothesis(scene, thumb, state, best);
        }
        if due(Turn::Known) {
            hypotheses.try_known(solver, scene, state, best);
        }
    }

    /// What the last frames have come to, to be gone back to behind a search that nothing came of.
    pub(super) fn progress(&self) -> Progress {
        Progress { mean_cost: self.mean_cost, frame: self.frame }
    }

    /// Goes back there.
    pub(super) fn go_back(&mut self, to: Progress) {
        (self.mean_cost, self.frame) = (to.mean_cost, to.frame);
    }

    /// Exchanges what is known of the side of the hand that faces the camera: silhouettes and creases of a palm are not those
    /// of its back.
    pub(super) fn exchange_face(&mut self, face: &mut Face) {
        std::mem::swap(&mut self.hypotheses.library, &mut face.library);
        std::mem::swap(&mut self.solver.appearance.relief, &mut face.relief);
    }

    /// Forgets the mean cost and what the hand looked like: every hypothesis is tried on the next frame.
    pub fn forget(&mut self) {
        self.mean_cost = None;
        self.flow.forget();
    }

    /// Learns the relief of the hand of `state` where it is nearly open, and refines the sizes of `model`. Whether they
    /// changed.
    pub(super) fn learn(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        open: &OpenState,
        state: &ModelState,
    ) -> bool {
        let solver = &mut self.solver;
        let bent = largest_difference(&state.free, &open.state.free);
        if let Some(seen) = evidence.joints()
            && bent <= solver.tuning.landmarks.learnt_within
        {
            solver.learn_joints(model, seen, state);
        }
        if evidence.has_picture() && bent <= solver.tuning.appearance.learnt_within {
            solver.learn_relief(model, evidence, state);
        }
        if !self.refine_sizes {
            return false;
        }
        let tuning = solver.tuning.sizes;
        let mut sizes = self.sizes.take().unwrap_or_else(|| Sizes::new(tuning, model.morphology()));
        let due = sizes.is_due();
        if due {
            let axis = evidence.window().forearm().map(|f| f.axis);
            let frame = sizes.begin(model, state, open, (axis, evidence.joints().is_some()));
            let prior = Prior { predicted: state, open };
            let scene = &mut Scene { model, evidence, prior: &prior };
            let pose = solver.linearise(scene, state, 1.0, Some(frame));
            sizes.learn(&solver.tuning.solver, &pose);
            model.set_morphology(&sizes.morphology());
        }
        self.sizes = Some(sizes);
        due
    }

    /// Mean distance of the joints seen in the frame from those of the model, hand lengths; `None` where none were.
    pub(super) fn joints_away(
        &self,
        model: &HandModel,
        evidence: &Evidence,
        state: &ModelState,
    ) -> Option<f64> {
        self.solver.joints_away(model, evidence, state)
    }

    /// Keeps what the hand of `state` looks like, for [`Registration::follow`].
    pub(super) fn remember(&mut self, model: &HandModel, evidence: &Evidence, state: &ModelState) {
        self.flow.remember(model, evidence, state);
    }

    /// The state to which the picture has moved since the last frame, whose state is the one that `prior` predicts;
    /// `None` without a picture, or when none was kept.
    pub(super) fn follow(
        &mut self,
        model: &mut HandModel,
        evidence: &Evidence,
        prior: &Prior<'_>,
    ) -> Option<ModelState> {
        self.flow.follow(&self.solver, &Scene { model, evidence, prior })
    }
}

#[cfg(test)]
mod tests {
    use super::testing::open;
    use super::*;
    use handcast_hand::{Domain, Finger, Morphology, Side};
    use handcast_vision::Mask;
    use nalgebra::UnitQuaternion;

    /// Tracks a motion of the true state from the open hand in steps and gives the last outcome and the truth.
    fn follow(frames: usize, motion: impl Fn(f64, &mut ModelState)) -> (Registered, ModelState, ModelState) {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let mut registration = Registration::new(RegistrationOptions::default());
        let mut evidence = Evidence::default();
        let open = open();
        let mut state = open.state.clone();
        let mut last = None;
        for i in 1..=frames {
            let mut truth = open.state.clone();
            motion(i as f64 / frames as f64, &mut truth);
            let mut image = Mask::new(320, 240);
            model.draw(&truth, [0.0, 0.0], &mut image);
            assert!(evidence.load(&image, None, None, 1).unwrap());
            let predicted = state.clone();
            let prior = Prior { predicted: &predicted, open: &open };
            let found = registration.register(&mut model, &evidence, &prior, &mut state);
            assert!(Domain::free().is_feasible(&state.free, 1e-9));
            last = Some((found, truth));
        }
        let (found, truth) = last.unwrap();
        (found, state, truth)
    }

    #[test]
    fn follows_translation_and_rotation() {
        let (found, state, truth) = follow(6, |t, s| {
            s.wrist[0] += 25.0 * t;
            s.rotation = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.3 * t);
        });
        assert!(found.iou > 0.97, "{}", found.iou);
        assert!((state.wrist[0] - truth.wrist[0]).abs() < 1.5);
        let off = (state.rotation * truth.rotation.inverse()).scaled_axis();
        // A silhouette shows turns in its plane; tilts it hardly shows.
        assert!(off.z.abs() < 0.02 && off.x.hypot(off.y) < 0.1, "{off:?}");
    }

    #[test]
    fn follows_the_flexion_of_each_finger() {
        for finger in [Finger::Index, Finger::Middle, Finger::Ring] {
            let [base, outer] = [finger.free_base(), finger.free_outer()];
            let (found, state, truth) = follow(10, |t, s| {
                s.free[base] = 0.9 * t;
                s.free[finger.free_abduction()] *= 1.0 - 0.9 * t / std::f64::consts::FRAC_PI_2;
                s.free[outer] = 1.1 * t;
                // Eq. (4): the middle finger comes along.
                let middle = &mut s.free[Finger::Middle.free_base()];
                *middle = middle.max(0.5 * t);
            });
            assert!(found.iou > 0.98, "{} {}", finger.name(), found.iou);
            // The finger's end is in front of the palm: without a picture only the prior tells how far it is bent.
            let off = |k: usize| (state.free[k] - truth.free[k]).abs();
            assert!(off(base) < 0.25 && off(outer) < 0.5, "{} {:?}", finger.name(), state.free);
        }
    }

    #[test]
    fn a_hand_that_has_jumped_to_a_fist_is_found() {
        let (found, state, truth) = follow(1, |_, s| {
            for finger in Finger::LONG {
                s.free[finger.range()].copy_from_slice(&[1.3, 0.0, 1.6]);
            }
        });
        assert!(found.iou > 0.9, "{}", found.iou);
        for finger in Finger::LONG {
            let base = finger.free_base();
            assert!((state.free[base] - truth.free[base]).abs() < 0.4, "{:?}", state.free);
        }
    }
}
