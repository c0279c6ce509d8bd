//! Projection, rasterisation, objectives, optimisers, open-hand fit and the frame-to-frame tracker.

mod fit;
pub mod methods;
mod model;
mod objective;
mod raster;
mod register;
mod simplex;
mod tracker;

pub use fit::{Fit, FitOptions, OpenHand, View, fit_open_hand};
pub use model::{Camera, HandModel, ModelState};
pub use objective::{Forearm, NonOverlap, Window};
pub use raster::{Disc, Rasterizer};
pub use register::{OpenState, Registered, Registration, RegistrationOptions};
pub use simplex::Downhill;
pub use tracker::{LOST_IOU, TrackedState, Tracker, TrackerOptions};
