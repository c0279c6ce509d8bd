//! Sightings that are ready: recorded ones, or those of another program.

use image::RgbImage;

use super::{HandFinder, Sighting};
use crate::error::Result;

/// Gives the sightings nearest in time.
#[derive(Clone, Debug, Default)]
pub struct ReadyFinder {
    frames: Vec<(f64, Vec<Sighting>)>,
    tolerance: f64,
}

impl ReadyFinder {
    /// Sightings with the times they are of, in seconds; those farther than `tolerance` seconds from a picture are not
    /// of it.
    pub fn new(frames: impl IntoIterator<Item = (f64, Vec<Sighting>)>, tolerance: f64) -> Self {
        let mut frames: Vec<_> = frames.into_iter().filter(|(time, _)| time.is_finite()).collect();
        frames.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { frames, tolerance }
    }
}

impl HandFinder for ReadyFinder {
    fn find(&mut self, _picture: &RgbImage, time: f64) -> Result<Vec<Sighting>> {
        let after = self.frames.partition_point(|(t, _)| *t < time);
        let around = &self.frames[after.saturating_sub(1)..(after + 1).min(self.frames.len())];
        let distance = |frame: &(f64, Vec<Sighting>)| (frame.0 - time).abs();
        let nearest = around.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        Ok(nearest.filter(|frame| distance(frame) <= self.tolerance).map(|f| f.1.clone()).unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hands::Region;

    fn sighting(presence: f64) -> Sighting {
        let points = [[presence, 0.0]; 21];
        let region = Region { centre: [0.0; 2], side: 1.0, angle: 0.0 };
        Sighting { points, world: None, presence, right: 1.0, region }
    }

    #[test]
    fn the_nearest_in_time_is_given() {
        let frames = [(0.2, vec![sighting(0.2)]), (0.0, vec![sighting(0.0)]), (0.1, Vec::new())];
        let mut finder = ReadyFinder::new(frames, 0.02);
        let picture = RgbImage::new(1, 1);
        let mut at = |time| finder.find(&picture, time).unwrap();
        assert_eq!(at(0.01), [sighting(0.0)]);
        assert_eq!(at(0.19), [sighting(0.2)]);
        assert!(at(0.11).is_empty());
        assert!(at(0.05).is_empty());
        assert!(at(9.0).is_empty());
        assert!(ReadyFinder::default().find(&picture, 0.0).unwrap().is_empty());
    }
}
