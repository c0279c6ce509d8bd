//! Hands in pictures: palms are found in the whole picture, joints in a turned crop round each; from then on the crop
//! follows the joints (Zhang et al., *MediaPipe Hands: On-device Real-time Hand Tracking*, arXiv 2006.10214, 2020).

mod crop;
mod finder;
mod palms;
mod scene;

pub use finder::{NetFinder, NetFinderOptions};
pub use handcast_vision::light::LightTuning;
