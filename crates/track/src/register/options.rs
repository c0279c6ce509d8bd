//! How registration searches.

use super::super::appearance::AppearanceTuning;
use super::super::evidence::EvidenceTuning;
use super::super::normal_equations::SolverTuning;
use super::contact::ContactTuning;
use super::flow::FlowTuning;
use super::hypotheses::HypothesisTuning;
use super::landmarks::LandmarkTuning;
use super::postures::PostureTuning;
use super::prior::PriorTuning;
use super::sizes::SizesTuning;
use handcast_vision::tuning::tuning;

/// How registration searches.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RegistrationOptions {
    /// Whether the sizes of the hand are refined while it is tracked.
    pub refine_sizes: bool,
    /// Its tuning constants.
    pub tuning: RegistrationTuning,
}

impl Default for RegistrationOptions {
    fn default() -> Self {
        Self { refine_sizes: true, tuning: RegistrationTuning::default() }
    }
}

impl RegistrationOptions {
    /// Sets [`RegistrationOptions::refine_sizes`].
    #[must_use]
    pub fn with_refine_sizes(mut self, refine_sizes: bool) -> Self {
        self.refine_sizes = refine_sizes;
        self
    }

    /// Sets [`RegistrationOptions::tuning`].
    #[must_use]
    pub fn with_tuning(mut self, tuning: RegistrationTuning) -> Self {
        self.tuning = tuning;
        self
    }
}

tuning! {
    /// The tuning constants of registration. Hand lengths are those of [`HAND_LENGTH`](crate::HAND_LENGTH) in the
    /// image.
    pub struct RegistrationTuning {
        /// Which outline of the image is the hand's own.
        pub evidence: EvidenceTuning,
        /// How outlines are paired.
        pub pairing: PairingTuning,
        /// The rounds of one search.
        pub rounds: RoundTuning,
        /// How normal equations are solved.
        pub solver: SolverTuning,
        /// Cost of a non-overlap rate (eq. 7) of 1 when postures are compared: half a number of standard deviations
        /// squared.
        ["1", "spec/registration.md 5, Choice; handcast bench track --no-methods on rendered sequences"]
        pub rate: f64 = 3000.0,
        /// The prior.
        pub prior: PriorTuning,
        /// Joints seen by a finder.
        pub landmarks: LandmarkTuning,
        /// How near neighbouring fingers may come.
        pub contact: ContactTuning,
        /// Shading.
        pub appearance: AppearanceTuning,
        /// Which other hypotheses are tried, and when.
        pub hypotheses: HypothesisTuning,
        /// Known postures.
        pub postures: PostureTuning,
        /// The picture's motion.
        pub flow: FlowTuning,
        /// How the sizes of the hand are refined.
        pub sizes: SizesTuning,
    }
}

tuning! {
    /// How the outlines of model and image are paired, and what a pair tells.
    pub struct PairingTuning {
        /// Distance of points along the model's outline.
        ["hand lengths", "spec/experiments.md, Speed: 3 % instead loses 0.005 of IoU"]
        pub spacing: f64 = 0.02,
        /// The same along the image's outline, by comparison.
        ["1", "chosen by eye"]
        pub image_spacing: f64 = 2.0,
        /// Cosine of the largest angle between paired normals.
        ["1", "chosen by eye"]
        pub facing: f64 = 0.4,
        /// Standard deviation of an outline of the image.
        ["hand lengths", "spec/experiments.md, Forearm breadth; handcast bench track CLIP"]
        pub noise: f64 = 0.009,
        /// Length of outline over which its errors go together.
        ["hand lengths", "chosen by eye: two spacings"]
        pub correlation: f64 = 0.04,
        /// Distance at which a pair counts as an outlier, in the first round and in the last (Geman & McClure 1985).
        ["hand lengths", "spec/registration.md 5, Rounds"]
        pub outlier: [f64; 2] = [0.10, 0.04],
    }
}

tuning! {
    /// The rounds of pairing and solving from one hypothesis.
    pub struct RoundTuning {
        /// Most rounds.
        ["rounds", "spec/experiments.md, Speed: 8 instead gain less than 0.0005 of IoU"]
        pub most: usize = 6,
        /// A round that moves nothing by more than this is the last.
        ["hand lengths, rad", "chosen by eye"]
        pub precision: f64 = 2e-3,
        /// Longest step of a round.
        ["hand lengths, rad", "chosen by eye"]
        pub longest_step: f64 = 0.35,
        /// Share of the rounds after which shading turns the bones.
        ["1", "spec/registration.md 5, Shading: from the fourth round on"]
        pub shaded_from: f64 = 0.4,
        /// Movement in an early round after which the shaded ones begin.
        ["hand lengths, rad", "chosen by eye"]
        pub settled: f64 = 0.03,
        /// Rounds after which a hypothesis may be pruned.
        ["rounds", "spec/registration.md 5, Hypotheses"]
        pub pruned_after: usize = 3,
        /// How much more than the best a hypothesis may cost then.
        ["1", "spec/experiments.md, Pruning of hypotheses: by 60 a real fist was read as a tilted open hand"]
        pub pruned_beyond: f64 = 100.0,
    }
}
