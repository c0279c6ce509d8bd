//! Whether anything has changed in a picture beside the hands that are followed.

use handcast_vision::sighting::Sighting;
use image::RgbImage;

/// Side of the blocks that are compared, pixels.
const BLOCK: usize = 16;
/// Rows and columns of a block that are looked at: every so many.
const EVERY: usize = 2;
/// Difference of a block's mean colour, levels, sum of three channels: more than noise, less than a hand makes.
const DIFFERENT: i32 = 12;
/// Blocks that must differ: a palm that the detector sees covers more.
const BLOCKS: usize = 2;
/// Half a side of what is a hand's, as a share of its region's side: the region is turned.
const OWN: f64 = 0.75;

/// A picture in blocks, as it was when it was last kept.
#[derive(Clone, Debug, Default)]
pub(super) struct Scene {
    size: (u32, u32),
    kept: Vec<[i32; 3]>,
    now: Vec<[i32; 3]>,
    /// What was a hand's.
    hands: Vec<([f64; 2], f64)>,
}

impl Scene {
    /// Keeps a picture with its hands.
    pub(super) fn keep(&mut self, picture: &RgbImage, hands: &[Sighting]) {
        self.size = picture.dimensions();
        blocks(picture, &mut self.kept);
        self.hands.clear();
        self.hands.extend(hands.iter().map(|hand| (hand.region.centre, OWN * hand.region.side)));
    }

    /// Whether a picture differs from the one that was kept, outside of the hands in either.
    pub(super) fn has_changed(&mut self, picture: &RgbImage, hands: &[Sighting]) -> bool {
        if picture.dimensions() != self.size {
            return true;
        }
        blocks(picture, &mut self.now);
        let columns = (self.size.0 as usize).div_ceil(BLOCK).max(1);
        let of_hand = |index: usize| {
            let at = [index % columns, index / columns].map(|v| (BLOCK * v + BLOCK / 2) as f64);
            let inside = |centre: &[f64; 2], half: f64| {
                (at[0] - centre[0]).abs() < half && (at[1] - centre[1]).abs() < half
            };
            self.hands.iter().any(|(centre, half)| inside(centre, *half))
                || hands.iter().any(|hand| inside(&hand.region.centre, OWN * hand.region.side))
        };
        let differs = |(a, b): (&[i32; 3], &[i32; 3])| {
            a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<i32>() > DIFFERENT
        };
        let pairs = self.kept.iter().zip(&self.now).enumerate();
        pairs.filter(|(i, pair)| differs(*pair) && !of_hand(*i)).take(BLOCKS).count() == BLOCKS
    }
}

/// The mean colours of a picture's blocks, row by row.
fn blocks(picture: &RgbImage, out: &mut Vec<[i32; 3]>) {
    out.clear();
    let width = picture.width() as usize;
    for rows in picture.as_raw().chunks(3 * width.max(1) * BLOCK) {
        for x in (0..width).step_by(BLOCK) {
            let end = (x + BLOCK).min(width);
            let (mut sum, mut count) = ([0; 3], 0);
            for row in rows.chunks_exact(3 * width).step_by(EVERY) {
                for pixel in row[3 * x..3 * end].as_chunks::<3>().0.iter().step_by(EVERY) {
                    (0..3).for_each(|c| sum[c] += i32::from(pixel[c]));
                    count += 1;
                }
            }
            out.push(sum.map(|v| v / count.max(1)));
        }
    }
}

#[cfg(test)]
mod tests {
    use handcast_vision::sighting::{JOINTS, Region};

    use super::*;

    fn picture(square: [u32; 2]) -> RgbImage {
        RgbImage::from_fn(200, 150, |x, y| {
            let inside = (square[0]..square[0] + 40).contains(&x) && (square[1]..square[1] + 40).contains(&y);
            if inside { image::Rgb([200, 150, 120]) } else { image::Rgb([90, (x % 200) as u8, y as u8]) }
        })
    }

    fn hand(centre: [f64; 2]) -> Sighting {
        let region = Region { centre, side: 60.0, angle: 0.0 };
        let points = [[0.0; 2]; JOINTS];
        Sighting { points, world: None, presence: 1.0, right: 1.0, region, age: 0 }
    }

    #[test]
    fn only_what_is_beside_the_hands_changes_a_scene() {
        let mut scene = Scene::default();
        assert!(scene.has_changed(&picture([20, 20]), &[]));
        scene.keep(&picture([20, 20]), &[hand([40.0, 40.0])]);
        assert!(!scene.has_changed(&picture([20, 20]), &[]));
        assert!(!scene.has_changed(&picture([30, 26]), &[hand([50.0, 46.0])]));
        assert!(scene.has_changed(&picture([120, 80]), &[hand([40.0, 40.0])]));
        assert!(!scene.has_changed(&picture([120, 80]), &[hand([140.0, 100.0])]));
        assert!(scene.has_changed(&RgbImage::new(100, 80), &[]));
        scene.keep(&RgbImage::new(0, 0), &[]);
        assert!(!scene.has_changed(&RgbImage::new(0, 0), &[]));
    }
}
