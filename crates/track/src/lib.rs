//! Projection, rasterisation, objectives, minimisers, open-hand fit and the frame-to-frame tracker.

mod appearance;
mod camera;
mod confidence;
mod cover;
mod evidence;
mod fit;
mod forearm;
mod model;
mod normal_equations;
mod objective;
mod outline;
pub mod pipeline;
mod projection;
mod raster;
mod register;
mod search;
mod simplex;
mod state;
mod tracker;

pub use appearance::AppearanceTuning;
pub use camera::PinholeCamera;
pub use confidence::{Confidence, ConfidenceTuning};
pub use evidence::{Evidence, EvidenceTuning, SizeMismatch};
pub use fit::{FingerPriorTuning, Fit, FitOptions, FitTuning, OpenHand, View, fit_open_hand};
pub use forearm::Forearm;
pub use model::HandModel;
pub use normal_equations::SolverTuning;
pub use objective::{NonOverlap, Window};
pub use raster::{ProjectedDisc, Rasterizer};
pub use register::{
    ContactTuning, FlowTuning, HypothesisTuning, OpenState, PairingTuning, PostureTuning, Prior, PriorTuning,
    Registered, Registration, RegistrationOptions, RegistrationTuning, RoundTuning, SizesTuning,
};
pub use search::{Optimiser, Outcome, Problem, Search};
pub use simplex::Downhill;
pub use state::{HAND_LENGTH, ModelState};
pub use tracker::{HandTracker, LOST_IOU, TrackedState, TrackerOptions, TrackerTuning};
