//! The background where it stands still: the mean colour of each pixel that a hand does not cover.

use image::RgbImage;

use super::mask::Mask;
use super::tuning::tuning;

tuning! {
    /// How a background that stands still is learnt.
    pub struct StillTuning {
        /// Pictures in which a pixel must have been seen uncovered before it tells anything.
        ["pictures", "chosen by eye"]
        pub known_after: u16 = 4,
        /// Most pictures that its mean is made of: the light changes slowly.
        ["pictures", "chosen: a second of video"]
        pub memory: u16 = 30,
        /// Difference of a channel from the mean up to which a pixel is as it was.
        ["levels", "chosen by eye: noise of small cameras"]
        pub same: f32 = 18.0,
        /// Pictures in a row in which a pixel must differ before what is there is taken for the background.
        ["pictures", "chosen: a second of video"]
        pub replaced_after: u16 = 30,
        /// Share of the known pixels that must differ for the camera to have moved.
        ["1", "chosen by eye"]
        pub moved: f64 = 0.25,
        /// Least standard deviation of a channel.
        ["levels", "chosen by eye: compressed video"]
        pub least_noise: f32 = 3.0,
        /// Log-likelihood ratio of a colour that is just the background's.
        ["nat", "chosen by eye"]
        pub same_ratio: f32 = -2.5,
        /// Largest log-likelihood ratio of one that differs: shadows differ, too.
        ["nat", "chosen by eye"]
        pub other_ratio: f32 = 3.0,
    }
}

/// One pixel.
#[derive(Clone, Copy, Debug, Default)]
struct Pixel {
    mean: [f32; 3],
    /// Pictures it is the mean of.
    seen: u16,
    /// Pictures in a row in which it has differed.
    differs: u16,
}

impl Pixel {
    /// Learns a colour that nothing covers. Gives how far it is off the mean, where it is the background's.
    fn learn(&mut self, rgb: [f32; 3], t: &StillTuning) -> Option<[f32; 3]> {
        let off: [f32; 3] = std::array::from_fn(|c| rgb[c] - self.mean[c]);
        if self.seen == 0 || self.differs >= t.replaced_after {
            *self = Self { mean: rgb, seen: 1, differs: 0 };
            return None;
        }
        if off.iter().any(|d| d.abs() > t.same) {
            self.differs += 1;
            return None;
        }
        self.seen = (self.seen + 1).min(t.memory);
        self.differs = 0;
        let share = 1.0 / f32::from(self.seen);
        (0..3).for_each(|c| self.mean[c] += share * off[c]);
        Some(off)
    }
}

/// Learns the background of pictures from a camera that does not move, and tells what stands in front of it.
#[derive(Clone, Debug, Default)]
pub struct StillBackground {
    tuning: StillTuning,
    width: u32,
    height: u32,
    pixels: Vec<Pixel>,
    /// Mean variance of a channel.
    variance: f32,
}

impl StillBackground {
    /// A background of which nothing is known.
    pub fn new(tuning: StillTuning) -> Self {
        Self { tuning, ..Self::default() }
    }

    /// Learns from a picture of which `covered` is not background. Where so much differs that the camera must have
    /// moved, or the size does, it begins anew.
    pub fn learn(&mut self, image: &RgbImage, covered: &Mask) {
        let t = self.tuning;
        if image.dimensions() != (self.width, self.height) || self.has_moved(image, covered) {
            (self.width, self.height) = image.dimensions();
            self.pixels.clear();
            self.pixels.resize(self.width as usize * self.height as usize, Pixel::default());
            self.variance = t.least_noise * t.least_noise;
        }
        let (mut squares, mut count) = (0.0f32, 0.0f32);
        let rows = self.pixels.chunks_exact_mut(self.width.max(1) as usize);
        for (y, (row, values)) in
            rows.zip(image.as_raw().chunks_exact(3 * self.width.max(1) as usize)).enumerate()
        {
            let words = covered.row(y as u32);
            for (word, (row, values)) in
                words.iter().zip(row.chunks_mut(64).zip(values.as_chunks::<3>().0.chunks(64)))
            {
                if *word == u64::MAX {
                    continue;
                }
                for (x, (pixel, rgb)) in row.iter_mut().zip(values).enumerate() {
                    if word >> x & 1 == 0
                        && let Some(off) = pixel.learn(rgb.map(f32::from), &t)
                    {
                        squares += off.iter().map(|d| d * d).sum::<f32>();
                        count += 3.0;
                    }
                }
            }
        }
        if count > 0.0 {
            let floor = t.least_noise * t.least_noise;
            self.variance += 0.2 * ((squares / count).max(floor) - self.variance);
        }
    }

    /// Whether much of what is known differs from the picture.
    fn has_moved(&self, image: &RgbImage, covered: &Mask) -> bool {
        let (mut known, mut differ) = (0u32, 0u32);
        for y in (0..self.height).step_by(4) {
            for x in (0..self.width).step_by(4) {
                let Some(pixel) = self.pixels.get((y * self.width + x) as usize) else { continue };
                if pixel.seen < self.tuning.known_after || covered.get(x, y) {
                    continue;
                }
                let rgb = image.get_pixel(x, y).0.map(f32::from);
                known += 1;
                let off = (0..3).any(|c| (rgb[c] - pixel.mean[c]).abs() > self.tuning.same);
                differ += u32::from(off);
            }
        }
        f64::from(differ) > self.tuning.moved * f64::from(known.max(64))
    }

    /// What is known of one row of pictures, from pixel `x` on; nothing beyond the last.
    pub(crate) fn row(&self, x: u32, y: u32) -> StillRow<'_> {
        let (width, x) = (self.width as usize, x as usize);
        let pixels = self.pixels.get(y as usize * width + x..(y as usize + 1) * width).unwrap_or(&[]);
        StillRow { tuning: self.tuning, pixels, per_square: 0.5 / (3.0 * self.variance) }
    }

    /// Share of the pixels whose background is known, 0 to 1.
    pub fn known(&self) -> f64 {
        let known = self.pixels.iter().filter(|p| p.seen >= self.tuning.known_after).count();
        known as f64 / self.pixels.len().max(1) as f64
    }
}

/// One row of a background.
pub(crate) struct StillRow<'a> {
    tuning: StillTuning,
    pixels: &'a [Pixel],
    /// Half the inverse of the variance of three channels.
    per_square: f32,
}

impl StillRow<'_> {
    /// Adds the log-likelihood ratio that something stands in front of the background to those of the pixels of the row,
    /// of these colours; 0 where the background is not known.
    pub(crate) fn add_ratios(&self, colours: &[[u8; 3]], ratios: &mut [f32]) {
        for ((ratio, &rgb), pixel) in ratios.iter_mut().zip(colours).zip(self.pixels) {
            *ratio += self.ratio_at(pixel, rgb);
        }
    }

    // Comparisons, not `min`, which asks for NaN: this runs for every pixel.
    fn ratio_at(&self, pixel: &Pixel, rgb: [u8; 3]) -> f32 {
        let StillTuning { known_after, same_ratio, other_ratio, .. } = self.tuning;
        let [r, g, b]: [f32; 3] = std::array::from_fn(|c| f32::from(rgb[c]) - pixel.mean[c]);
        let ratio = same_ratio + (r * r + g * g + b * b) * self.per_square;
        let ratio = if ratio < other_ratio { ratio } else { other_ratio };
        if pixel.seen >= known_after { ratio } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(hand_at: Option<u32>, shift: u32) -> RgbImage {
        RgbImage::from_fn(64, 48, |x, y| match hand_at {
            Some(at) if (at..at + 12).contains(&x) && y > 20 => image::Rgb([200, 150, 120]),
            _ => image::Rgb([((x + shift) * 13 % 200) as u8, (y * 5) as u8, 90]),
        })
    }

    #[test]
    fn what_stands_in_front_differs_and_a_moved_camera_is_noticed() {
        let mut still = StillBackground::new(StillTuning::default());
        let box_at = |at: u32| Mask::from_fn(64, 48, |x, _| (at.saturating_sub(3)..at + 15).contains(&x));
        for at in [5, 5, 5, 5, 40, 40, 40, 40] {
            still.learn(&scene(Some(at), 0), &box_at(at));
        }
        assert!(still.known() > 0.9, "{}", still.known());
        let now = scene(Some(20), 0);
        let ratio_of = |still: &StillBackground, x, y, rgb| {
            let mut ratio = [0.0];
            still.row(x, y).add_ratios(&[rgb], &mut ratio);
            ratio[0]
        };
        let ratio = |still: &StillBackground, x: u32, y: u32| ratio_of(still, x, y, now.get_pixel(x, y).0);
        assert!(ratio(&still, 25, 30) > 1.0);
        assert!(ratio(&still, 50, 30) < -1.0 && ratio(&still, 8, 30) < -1.0);
        assert_eq!(ratio_of(&still, 64, 0, [0; 3]), 0.0);
        assert_eq!(ratio_of(&still, 0, 48, [0; 3]), 0.0);
        still.learn(&scene(None, 7), &Mask::new(64, 48));
        assert_eq!(still.known(), 0.0);
    }
}
