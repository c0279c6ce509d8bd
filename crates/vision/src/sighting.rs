//! Hands seen in pictures as plain data, and the trait of what sees them. The tracker knows these alone; networks, files
//! and other programs are finders behind the trait.
//!
//! Joints are in the order wrist; thumb CMC, MCP, IP, tip; MCP, PIP, DIP, tip of index, middle, ring and little finger.
//! Places in pictures are in pixels to the right and down, centres of pixels at .5.

mod ready;
mod region;

pub use ready::ReadySightings;
pub use region::{Region, overlap};

use std::error::Error;
use std::fmt::Debug;

use image::RgbImage;

/// Joints of a hand.
pub const JOINTS: usize = 21;

/// A hand seen in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// Joints in pixels of the picture: to the right, down. They may lie outside of it.
    pub points: [[f64; 2]; JOINTS],
    /// Joints in metres from the hand's centre, in the picture's axes: to the right, down, away from the camera.
    pub world: Option<[[f64; 3]; JOINTS]>,
    /// How sure it is that there is a hand, from 0 to 1.
    pub presence: f64,
    /// Probability that it is a right hand, the picture not being mirrored.
    pub right: f64,
    /// Where the hand was looked for.
    pub region: Region,
    /// Pictures since the joints were looked for: 0 where they are those of this picture, more where the motion before
    /// was gone on with.
    pub age: usize,
}

impl Sighting {
    /// The middle of the four knuckles, in pixels.
    pub fn knuckles(&self) -> [f64; 2] {
        [0, 1].map(|k| [5, 9, 13, 17].iter().map(|&i| self.points[i][k]).sum::<f64>() / 4.0)
    }

    /// Length of the stretched hand by its joints in space, in metres: from the wrist along the middle finger. `None`
    /// without them.
    pub fn world_length(&self) -> Option<f64> {
        let world = self.world.as_ref()?;
        let bone =
            |(a, b): (usize, usize)| (0..3).map(|k| (world[a][k] - world[b][k]).powi(2)).sum::<f64>().sqrt();
        Some([(0, 9), (9, 10), (10, 11), (11, 12)].map(bone).iter().sum())
    }

    /// The same in a picture of so many times the size.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let by = |p: [f64; 2]| p.map(|v| v * factor);
        let Region { centre, side, angle } = self.region;
        let region = Region { centre: by(centre), side: side * factor, angle };
        Self { points: self.points.map(by), region, ..self.clone() }
    }

    /// Mean distance of the joints from those of another sighting, in pixels.
    pub fn distance(&self, other: &Self) -> f64 {
        let pairs = self.points.iter().zip(&other.points);
        pairs.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum::<f64>() / JOINTS as f64
    }
}

/// Why a finder cannot do its work.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct FindError(#[from] Box<dyn Error + Send + Sync>);

impl FindError {
    /// An error of a finder of any kind.
    pub fn new(source: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self(source.into())
    }
}

/// What finds hands in the pictures of a film, one after the other.
pub trait HandFinder: Debug + Send {
    /// Writes the hands in the next picture, taken at `time` seconds, over what `hands` holds. Those that were followed
    /// from the picture before come first, in the same order; a picture without hands leaves none.
    ///
    /// # Errors
    /// Where the finder cannot do its work at all; `hands` is empty then.
    fn find(&mut self, picture: &RgbImage, time: f64, hands: &mut Vec<Sighting>) -> Result<(), FindError>;

    /// Writes over `hands` those of `after`, the hands of a picture that comes behind this one, which this one shows near the
    /// same places, whatever has been found in it before; the pictures that [`Self::find`] is given go on as if this had not
    /// been asked. One that cannot tell writes none.
    ///
    /// # Errors
    /// As [`Self::find`].
    fn look_back(
        &mut self,
        _picture: &RgbImage,
        _after: &[Sighting],
        hands: &mut Vec<Sighting>,
    ) -> Result<(), FindError> {
        hands.clear();
        Ok(())
    }

    /// How many hands it saw in the last picture besides those that it gave, as far as it looked for any.
    fn further(&self) -> usize {
        0
    }

    /// Forgets the pictures before: the next one is of another film, or of another time.
    fn reset(&mut self) {}
}

impl<F: HandFinder + ?Sized> HandFinder for Box<F> {
    fn find(&mut self, picture: &RgbImage, time: f64, hands: &mut Vec<Sighting>) -> Result<(), FindError> {
        (**self).find(picture, time, hands)
    }

    fn look_back(
        &mut self,
        picture: &RgbImage,
        after: &[Sighting],
        hands: &mut Vec<Sighting>,
    ) -> Result<(), FindError> {
        (**self).look_back(picture, after, hands)
    }

    fn further(&self) -> usize {
        (**self).further()
    }

    fn reset(&mut self) {
        (**self).reset();
    }
}
