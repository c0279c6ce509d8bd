//! The paper's registration methods, each by its name: what is minimised (6.2), how (6.1, 6.3), which
//! parameters and in what order (6.5), under the biomechanical constraints (6.4.4).
//!
//! [`MethodTracker`] is a frame-to-frame tracker made of one choice of each; [`FrameTracker`] is what any
//! tracker must be to be compared with it. Equations and findings are in `spec/registration.md`.

mod functional;
mod genetic;
mod perturbation;
mod powell;
mod selection;
mod space;
#[cfg(test)]
mod testing;
mod tree;

pub use functional::{ContourDistance, Functional, FunctionalKind};
pub use genetic::Genetic;
pub use handcast_track::{Optimiser, Outcome, Problem, Search};
pub use perturbation::Perturbation;
pub use powell::Powell;
pub use selection::Selection;
pub use space::{Freedom, HandProblem, Order, Parameter};
pub use tree::Tree;

use image::RgbImage;

use handcast_hand::Domain;
use handcast_hand::random::Random;
use handcast_track::Downhill;
use handcast_track::Fit;
use handcast_track::{Camera, HandModel, ModelState};
use handcast_track::{Forearm, NonOverlap, Window};
use handcast_track::{HandTracker, LOST_IOU, SizeMismatch, TrackedState};
use handcast_vision::{Chamfer, Mask};

/// What a tracker is given of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// The picture, when there is one.
    pub image: Option<&'a RgbImage>,
    /// The hand, cut from its forearm; empty when no hand was found.
    pub silhouette: &'a Mask,
    /// Where it was cut.
    pub forearm: Option<Forearm>,
}

/// A tracker that is given one frame after the other, the first of them the open hand it was made for.
pub trait FrameTracker {
    /// Registers the hand in the next frame.
    ///
    /// # Errors
    /// The picture has another size than the silhouette.
    fn next(&mut self, seen: &Seen) -> Result<TrackedState, SizeMismatch>;
}

impl FrameTracker for HandTracker {
    fn next(&mut self, seen: &Seen) -> Result<TrackedState, SizeMismatch> {
        self.track(seen.silhouette, seen.forearm, seen.image)
    }
}

/// An optimiser by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OptimiserKind {
    /// Downhill simplex (6.3.1), [`Downhill`].
    #[default]
    Simplex,
    /// Powell's direction set (6.3.2), [`Powell`].
    Powell,
    /// Local perturbation of single degrees of freedom, [`Perturbation`].
    Perturbation,
    /// Genetic algorithm, [`Genetic`].
    Genetic,
    /// Selection of random postures with a transition prior, [`Selection`].
    Selection,
    /// Tree search over a discretised space, [`Tree`].
    Tree,
}

impl OptimiserKind {
    /// Names and optimisers, as on the command line.
    pub const ALL: [(&'static str, Self); 6] = [
        ("simplex", Self::Simplex),
        ("powell", Self::Powell),
        ("perturbation", Self::Perturbation),
        ("genetic", Self::Genetic),
        ("selection", Self::Selection),
        ("tree", Self::Tree),
    ];

    /// The optimiser; `tolerance` ends simplex and Powell, `seed` is for those that draw lots.
    pub fn make(self, tolerance: f64, seed: u64) -> Box<dyn Optimiser> {
        match self {
            Self::Simplex => Box::new(Downhill::new(tolerance, usize::MAX)),
            Self::Powell => Box::new(Powell { tolerance, ..Powell::default() }),
            Self::Perturbation => Box::new(Perturbation::default()),
            Self::Genetic => Box::new(Genetic { seed, ..Genetic::default() }),
            Self::Selection => Box::new(Selection { seed, ..Selection::default() }),
            Self::Tree => Box::new(Tree::default()),
        }
    }
}

/// A feasible point near the feasible point `from`: each parameter changes with the chance `change`, by a
/// normal deviate of `deviation` steps; one at least changes.
fn jittered(search: &mut Search, from: &[f64], deviation: f64, change: f64, random: &mut Random) -> Vec<f64> {
    let always = random.below(from.len());
    let mut to = from.to_vec();
    for (i, v) in to.iter_mut().enumerate() {
        if i == always || f64::from(random.range(0.0, 1.0)) < change {
            *v += deviation * search.step(i) * f64::from(random.gauss());
        }
    }
    search.clip(from, &mut to);
    to
}

/// A choice of method.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct MethodOptions {
    /// What is minimised.
    pub functional: FunctionalKind,
    /// How.
    pub optimiser: OptimiserKind,
    /// Which parameters are estimated.
    pub freedom: Freedom,
    /// In what order.
    pub order: Order,
    /// Evaluations allowed to one search, shared among its minimisations by their numbers of parameters;
    /// the methods that draw lots use them up.
    pub evaluations: usize,
    /// Simplex and Powell stop when the value gains less than this fraction.
    pub tolerance: f64,
    /// What all first steps are multiplied by.
    pub spread: f64,
    /// How often a search that stopped badly is started again, from larger steps each time (6.4.3).
    pub restarts: usize,
    /// A search stopped badly when its non-overlap rate is more than this above that of the open hand.
    pub poor: f64,
    /// Steps in the contour's distance map.
    pub chamfer: Chamfer,
    /// Intersection over union below which the hand is lost.
    pub lost_iou: f64,
    /// The camera, for perspective; without, the projection is orthographic as in the paper.
    pub camera: Option<Camera>,
    /// Seed of the methods that draw lots.
    pub seed: u64,
}

impl Default for MethodOptions {
    fn default() -> Self {
        Self {
            functional: FunctionalKind::default(),
            optimiser: OptimiserKind::default(),
            freedom: Freedom::default(),
            order: Order::default(),
            evaluations: 1000,
            tolerance: 0.03,
            spread: 1.0,
            restarts: 2,
            poor: 0.01,
            chamfer: Chamfer::default(),
            lost_iou: LOST_IOU,
            camera: None,
            seed: 1,
        }
    }
}

/// What larger steps a search is started again with.
const LARGER: f64 = 2.5;
/// A search that stopped this far above the open hand's non-overlap rate is tried from the open hand too.
const HOPELESS: f64 = 0.1;
/// A model that overlaps the silhouette less than this is brought to its centroid first (6.2.1).
const NO_OVERLAP: f64 = 0.9;

/// Follows one hand by the method chosen: each frame starts where the last one ended, the first from the
/// open hand (6.4.2).
pub struct MethodTracker {
    options: MethodOptions,
    model: HandModel,
    domain: Domain,
    functional: Box<dyn Functional>,
    optimiser: Box<dyn Optimiser>,
    judge: NonOverlap,
    open: ModelState,
    /// Non-overlap rate that the open hand left.
    open_rate: f64,
    last: ModelState,
    lost: bool,
}

/// A registration of one silhouette.
struct Found {
    state: ModelState,
    value: f64,
    rate: f64,
    iou: f64,
    iterations: usize,
}

/// One search, looked at closely (fig. 17).
#[derive(Clone, Debug)]
pub struct Descent {
    /// The state found.
    pub state: ModelState,
    /// Iterations.
    pub iterations: usize,
    /// The best value after each evaluation.
    pub trace: Vec<f64>,
}

impl MethodTracker {
    /// A tracker of the fitted hand.
    pub fn new(fit: &Fit, options: MethodOptions) -> Self {
        let mut model = HandModel::new(&fit.morphology, fit.side);
        if let Some(camera) = options.camera {
            model = model.with_camera(camera);
        }
        // The fit keeps the static limits only.
        let domain = Domain::free();
        let mut open = fit.state.clone();
        for (to, from) in open.free.iter_mut().zip(domain.project(&fit.state.free)) {
            *to = from;
        }
        Self {
            functional: options.functional.make(options.chamfer),
            optimiser: options.optimiser.make(options.tolerance, options.seed),
            judge: NonOverlap::default(),
            last: open.clone(),
            open,
            open_rate: 1.0 - 2.0 * fit.iou / (1.0 + fit.iou),
            lost: false,
            model,
            domain,
            options,
        }
    }

    /// The state `start` with the centroid of the model on that of the silhouette.
    fn centred(&mut self, start: &ModelState, silhouette: &Mask) -> ModelState {
        let mut state = start.clone();
        let mut drawn = Mask::new(silhouette.width(), silhouette.height());
        self.model.draw(start, [0.0, 0.0], &mut drawn);
        let from = drawn.centroid().unwrap_or(start.wrist);
        if let Some([x, y]) = silhouette.centroid() {
            state.wrist = [start.wrist[0] + x - from[0], start.wrist[1] + y - from[1]];
        }
        state
    }

    /// The stages of one search, from `start`; adds the evaluations to `count`.
    fn search(
        &mut self,
        start: &ModelState,
        window: &Window,
        spread: f64,
        count: &mut usize,
        mut trace: Option<&mut Vec<f64>>,
    ) -> Found {
        let (mut state, mut value, mut iterations) = (start.clone(), f64::INFINITY, 0);
        let mut stages = self.options.order.stages(self.options.freedom);
        if spread > self.options.spread {
            // A search from larger steps has all parameters move together first.
            stages.splice(0..0, Order::Whole.stages(self.options.freedom));
        }
        let parameters: usize = stages.iter().map(Vec::len).sum();
        for chosen in stages {
            let mut point = vec![0.0; chosen.len()];
            let share = self.options.evaluations * chosen.len() / parameters.max(1);
            let (model, domain) = (&mut self.model, &self.domain);
            let mut problem =
                HandProblem::new(model, self.functional.as_mut(), window, domain, state, chosen, spread);
            let mut search = Search::new(&mut problem, share.max(1));
            if let Some(trace) = trace.as_deref_mut() {
                search = search.traced(trace);
            }
            let outcome = self.optimiser.minimise(&mut search, &mut point);
            value = outcome.value;
            iterations += outcome.iterations;
            *count += search.evaluations();
            state = problem.state(&point);
        }
        let rate = self.judge.rate(&mut self.model, &state, window);
        Found { rate, iou: self.judge.last_iou(window), value, iterations, state }
    }

    /// One search for the silhouette in `window` from `start`, without restart.
    pub fn descent(&mut self, start: &ModelState, window: &Window) -> Descent {
        let mut trace = Vec::new();
        self.functional.look_at(window);
        let found = self.search(start, window, self.options.spread, &mut 0, Some(&mut trace));
        Descent { state: found.state, iterations: found.iterations, trace }
    }

    /// Searches from `start`, and again from larger steps while the optimum is poor.
    fn register(&mut self, start: &ModelState, window: &Window, count: &mut usize) -> (Found, bool) {
        let mut spread = self.options.spread;
        let mut best = self.search(start, window, spread, count, None);
        let mut again = 0;
        while again < self.options.restarts && best.rate > self.open_rate + self.options.poor {
            again += 1;
            spread *= LARGER;
            let from = best.state.clone();
            let other = self.search(&from, window, spread, count, None);
            if other.value < best.value {
                best = other;
            }
        }
        (best, again > 0)
    }
}

impl FrameTracker for MethodTracker {
    fn next(&mut self, seen: &Seen) -> Result<TrackedState, SizeMismatch> {
        let nothing = |state: &ModelState, iou, evaluations, restarted| {
            Ok(TrackedState { state: state.clone(), iou, valid: false, evaluations, restarted })
        };
        let Some(window) = Window::around(seen.silhouette, seen.forearm, 0.35) else {
            self.lost = true;
            return nothing(&self.last, 0.0, 0, false);
        };
        self.functional.look_at(&window);
        let mut count = 0;
        let mut start = self.last.clone();
        if self.judge.rate(&mut self.model, &start, &window) > NO_OVERLAP {
            start = self.centred(&start, seen.silhouette);
        }
        let (mut found, mut restarted) = self.register(&start, &window, &mut count);
        let hopeless = found.rate > self.open_rate + HOPELESS;
        if self.lost || hopeless || found.iou < self.options.lost_iou {
            let open = self.open.clone();
            let start = self.centred(&open, seen.silhouette);
            let (other, again) = self.register(&start, &window, &mut count);
            if other.value < found.value {
                (found, restarted) = (other, again);
            }
        }
        self.lost = found.iou < self.options.lost_iou;
        if self.lost {
            return nothing(&self.last, found.iou, count, restarted);
        }
        self.last = found.state.clone();
        Ok(TrackedState { state: found.state, iou: found.iou, valid: true, evaluations: count, restarted })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::{ScriptedMotion, Synth, SynthOptions};
    use handcast_hand::Finger;

    fn synth(motion: ScriptedMotion, frames: usize) -> Synth {
        let options = SynthOptions { motion, frames, size: (240, 180), ..SynthOptions::default() };
        Synth::new(options).unwrap()
    }

    fn fit(synth: &Synth) -> Fit {
        synth.true_fit(&synth.model_silhouette(0), None)
    }

    fn options(synth: &Synth) -> MethodOptions {
        MethodOptions { camera: Some(synth.track_camera()), ..MethodOptions::default() }
    }

    #[test]
    fn every_method_follows_a_translation_within_the_constraints() {
        let synth = synth(ScriptedMotion::Translation, 40);
        for (name, optimiser) in OptimiserKind::ALL {
            for (kind, functional) in FunctionalKind::ALL {
                let options = MethodOptions {
                    optimiser,
                    functional,
                    freedom: Freedom::Twelve,
                    order: Order::Whole,
                    evaluations: 150,
                    ..options(&synth)
                };
                let mut tracker = MethodTracker::new(&fit(&synth), options);
                for i in 0..4 {
                    let silhouette = synth.model_silhouette(i);
                    let found =
                        tracker.next(&Seen { image: None, silhouette: &silhouette, forearm: None }).unwrap();
                    assert!(found.valid, "{name} {kind} frame {i}: {}", found.iou);
                    assert!(Domain::free().is_feasible(&found.state.free, 1e-9), "{name} {kind}");
                    let truth = synth.state(i);
                    let apart = (found.state.wrist[0] - truth.wrist[0]).abs();
                    assert!(apart < 6.0, "{name} {kind} frame {i}: {apart}");
                }
            }
        }
    }

    #[test]
    fn the_simplex_follows_the_flexion_of_a_finger() {
        let synth = synth(ScriptedMotion::FlexMiddle, 40);
        let mut tracker = MethodTracker::new(&fit(&synth), options(&synth));
        for i in 0..14 {
            let silhouette = synth.model_silhouette(i);
            let found = tracker.next(&Seen { image: None, silhouette: &silhouette, forearm: None }).unwrap();
            let bend = |s: &ModelState| {
                s.free[3 * Finger::Middle as usize] + s.free[3 * Finger::Middle as usize + 2]
            };
            let off = (bend(&found.state) - bend(&synth.state(i))).abs().to_degrees();
            assert!(found.iou > 0.95 && off < 25.0, "frame {i}: {off} degrees, {}", found.iou);
        }
    }

    #[test]
    fn a_hand_that_left_is_found_again_elsewhere() {
        let synth = synth(ScriptedMotion::Leave, 30);
        let mut tracker = MethodTracker::new(&fit(&synth), options(&synth));
        let mut lost = 0;
        for i in 0..30 {
            let silhouette = synth.model_silhouette(i);
            let found = tracker.next(&Seen { image: None, silhouette: &silhouette, forearm: None }).unwrap();
            lost += usize::from(!found.valid);
            assert!(!silhouette.is_empty() || !found.valid, "frame {i}");
            if i == 29 {
                assert!(found.iou > 0.95, "{}", found.iou);
            }
        }
        assert!((3..20).contains(&lost), "{lost}");
    }

    #[test]
    fn a_descent_is_traced() {
        let synth = synth(ScriptedMotion::FlexIndex, 40);
        let mut tracker = MethodTracker::new(&fit(&synth), options(&synth));
        let window = Window::around(&synth.model_silhouette(8), None, 0.35).unwrap();
        let Descent { trace, iterations, .. } = tracker.descent(&synth.state(6), &window);
        assert!(iterations > 10);
        assert!(trace.len() > 50 && trace[trace.len() - 1] < trace[0]);
    }
}
