//! Hands in pictures: palms are found in the whole picture, joints in a turned crop round each; from then on the crop
//! follows the joints (Zhang et al., *MediaPipe Hands: On-device Real-time Hand Tracking*, arXiv 2006.10214, 2020).
//!
//! Joints are in the order wrist; thumb CMC, MCP, IP, tip; MCP, PIP, DIP, tip of index, middle, ring and little finger.

mod crop;
mod finder;
mod palms;
mod ready;
mod region;

pub use finder::{NetFinder, NetFinderOptions};
pub use ready::ReadyFinder;
pub use region::Region;

use image::RgbImage;

use crate::error::Result;

/// Joints of a hand.
pub const JOINTS: usize = 21;

/// A hand seen in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// Joints in pixels of the picture: to the right, down.
    pub points: [[f64; 2]; JOINTS],
    /// Joints in metres from the hand's centre: to the right, down, away from the camera.
    pub world: Option<[[f64; 3]; JOINTS]>,
    /// How sure it is that there is a hand, from 0 to 1.
    pub presence: f64,
    /// Probability that it is a right hand, the picture not being mirrored.
    pub right: f64,
    /// Where the hand was looked for.
    pub region: Region,
}

/// What finds hands in pictures.
pub trait HandFinder {
    /// The hands in the next picture of a film, taken at `time` seconds.
    ///
    /// # Errors
    /// Where the finder cannot do its work at all; a picture without hands gives none.
    fn find(&mut self, picture: &RgbImage, time: f64) -> Result<Vec<Sighting>>;
}
