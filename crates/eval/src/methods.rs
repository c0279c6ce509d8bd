//! The paper's registration methods, each by its name: what is minimised (6.2), how (6.1, 6.3), which
//! parameters and in what order (6.5), under the biomechanical constraints (6.4.4).
//!
//! [`MethodTracker`] is a frame-to-frame tracker made of one choice of each; [`FrameTracker`] is what any
//! tracker must be to be compared with it. Equations and findings are in `spec/registration.md`.

mod functional;
mod genetic;
mod jitter;
mod perturbation;
mod powell;
mod selection;
mod space;
#[cfg(test)]
mod testing;
mod tree;

pub use functional::{ContourDistance, Functional, FunctionalKind, FunctionalTuning};
pub use genetic::Genetic;
pub use perturbation::Perturbation;
pub use powell::Powell;
pub use selection::Selection;
pub use space::{Freedom, HandProblem, Order, Parameter, StepTuning};
pub use tree::Tree;

use image::RgbImage;

use handcast_hand::Domain;
use handcast_track::{
    Downhill, Fit, Forearm, HandModel, HandTracker, LOST_IOU, ModelState, NonOverlap, Optimiser,
    PinholeCamera, Search, SizeMismatch, TrackedState, Window,
};
use handcast_vision::tuning::tuning;
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
    pub camera: Option<PinholeCamera>,
    /// Seed of the methods that draw lots.
    pub seed: u64,
    /// The tuning constants.
    pub tuning: MethodTuning,
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
            tuning: MethodTuning::default(),
        }
    }
}

tuning! {
    /// What the paper leaves open of tracking by its methods.
    pub struct MethodTuning {
        /// Factor of the steps that a search is started again with (6.4.3).
        ["1", "spec/registration.md 4; handcast bench track"]
        pub larger: f64 = 2.5,
        /// A search that stopped this far above the open hand's non-overlap rate is tried from the open hand too.
        ["1", "spec/registration.md 4; handcast bench track"]
        pub hopeless: f64 = 0.1,
        /// Non-overlap rate above which the model is brought to the silhouette's centroid first (6.2.1).
        ["1", "spec/registration.md 4; handcast bench track"]
        pub no_overlap: f64 = 0.9,
        /// How far around the silhouette the model may lie: share of the silhouette's larger side.
        ["1", "chosen by eye"]
        pub margin: f64 = 0.35,
        /// What is minimised.
        pub functional: FunctionalTuning,
        /// First steps of the parameters.
        pub steps: StepTuning,
    }
}

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
            functional: options.functional.make(options.chamfer, &options.tuning.functional),
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
            let steps = chosen.iter().map(|&p| self.options.tuning.steps.of(p) * spread).collect();
            let (model, domain) = (&mut self.model, &self.domain);
            let mut problem =
                HandProblem::new(model, self.functional.as_mut(), window, domain, state, chosen, steps);
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
            spread *= self.options.tuning.larger;
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
            Ok(TrackedState {
                state: state.clone(),
                iou,
                valid: false,
                evaluations,
                restarted,
                joints_away: None,
            })
        };
        let Some(window) = Window::around(seen.silhouette, seen.forearm, self.options.tuning.margin) else {
            self.lost = true;
            return nothing(&self.last, 0.0, 0, false);
        };
        self.functional.look_at(&window);
        let mut count = 0;
        let mut start = self.last.clone();
        if self.judge.rate(&mut self.model, &start, &window) > self.options.tuning.no_overlap {
            start = self.centred(&start, seen.silhouette);
        }
        let (mut found, mut restarted) = self.register(&start, &window, &mut count);
        let hopeless = found.rate > self.open_rate + self.options.tuning.hopeless;
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
        Ok(TrackedState {
            state: found.state,
            iou: found.iou,
            valid: true,
            evaluations: count,
            restarted,
            joints_away: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::testing::check;
    use super::*;

    #[test]
    fn the_simplex_stays_in_the_domain_and_reaches_its_border() {
        check(&mut Downhill::new(1e-9, 3000), 3000, 1e-4, 0.1);
    }
}
