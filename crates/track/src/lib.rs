//! Projection, rasterisation, objectives, optimisers, open-hand fit and the frame-to-frame tracker.

mod appearance;
mod confidence;
mod cover;
mod evidence;
mod fit;
mod model;
mod objective;
mod outline;
pub mod pipeline;
mod projection;
mod raster;
mod register;
mod search;
mod simplex;
mod smooth;
mod tracker;

pub use confidence::Confidence;
pub use evidence::{Evidence, SizeMismatch};
pub use fit::{Fit, FitOptions, OpenHand, View, fit_open_hand};
pub use model::{Camera, HandModel, ModelState};
pub use objective::{Forearm, NonOverlap, Window};
pub use raster::{Disc, Rasterizer};
pub use register::{Belief, BeliefOptions, OpenState, Registered, Registration, RegistrationOptions};
pub use search::{Optimiser, Outcome, Problem, Search};
pub use simplex::Downhill;
pub use smooth::{PoseSmoother, SmoothOptions, jitter};
pub use tracker::{HandTracker, LOST_IOU, TrackedState, TrackerOptions};
