//! Sightings that are ready: recorded ones, or those of another program.

use image::RgbImage;

use super::{FindError, HandFinder, Sighting};

/// Gives the sightings nearest in time.
#[derive(Clone, Debug, Default)]
pub struct ReadySightings {
    frames: Vec<(f64, Vec<Sighting>)>,
    tolerance: f64,
    /// Width of the pictures in whose pixels they are; `None` where these are the finder's.
    width: Option<u32>,
}

impl ReadySightings {
    /// Sightings with the times they are of, in seconds, in any order; those farther than `tolerance` seconds from a
    /// picture are not of it. Times that are no numbers are passed over.
    pub fn new(frames: impl IntoIterator<Item = (f64, Vec<Sighting>)>, tolerance: f64) -> Self {
        let mut frames: Vec<_> = frames.into_iter().filter(|(time, _)| time.is_finite()).collect();
        frames.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { frames, tolerance, width: None }
    }

    /// Takes the pixels for those of pictures of this width; the pictures that are looked at may be smaller.
    #[must_use]
    pub fn in_pictures_of(mut self, width: u32) -> Self {
        self.width = Some(width).filter(|w| *w > 0);
        self
    }
}

impl HandFinder for ReadySightings {
    fn find(&mut self, picture: &RgbImage, time: f64, hands: &mut Vec<Sighting>) -> Result<(), FindError> {
        hands.clear();
        let after = self.frames.partition_point(|(t, _)| *t < time);
        let around = &self.frames[after.saturating_sub(1)..(after + 1).min(self.frames.len())];
        let distance = |frame: &(f64, Vec<Sighting>)| (frame.0 - time).abs();
        let nearest = around.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        if let Some((_, found)) = nearest.filter(|frame| distance(frame) <= self.tolerance) {
            let factor = self.width.map_or(1.0, |width| f64::from(picture.width()) / f64::from(width));
            hands.extend(found.iter().map(|hand| hand.scaled(factor)));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sighting::Region;

    fn sighting(presence: f64) -> Sighting {
        let points = [[presence, 0.0]; 21];
        let region = Region { centre: [0.0; 2], side: 1.0, angle: 0.0 };
        Sighting { points, world: None, presence, right: 1.0, region, age: 0 }
    }

    #[test]
    fn the_nearest_in_time_is_given() {
        let frames = [(0.2, vec![sighting(0.2)]), (0.0, vec![sighting(0.0)]), (0.1, Vec::new())];
        let mut finder = ReadySightings::new(frames, 0.02);
        let picture = RgbImage::new(1, 1);
        let mut hands = vec![sighting(9.0)];
        let mut at = |time| {
            finder.find(&picture, time, &mut hands).unwrap();
            hands.clone()
        };
        assert_eq!(at(0.01), [sighting(0.0)]);
        assert_eq!(at(0.19), [sighting(0.2)]);
        let mut wide = finder.clone().in_pictures_of(2);
        wide.find(&picture, 0.2, &mut hands).unwrap();
        assert_eq!((hands[0].points[3], hands[0].region.side), ([0.1, 0.0], 0.5));
        let mut at = |time| {
            finder.find(&picture, time, &mut hands).unwrap();
            hands.clone()
        };
        for time in [0.11, 0.05, 9.0, f64::NAN] {
            assert!(at(time).is_empty(), "{time}");
        }
        let mut none = ReadySightings::default();
        none.find(&picture, 0.0, &mut hands).unwrap();
        assert!(hands.is_empty());
    }

    #[test]
    fn distance_is_the_mean_over_joints() {
        let (a, mut b) = (sighting(0.0), sighting(0.0));
        assert_eq!(a.distance(&b), 0.0);
        b.points[3] = [3.0, 4.0];
        assert!((a.distance(&b) - 5.0 / 21.0).abs() < 1e-12);
    }
}
