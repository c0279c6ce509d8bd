//! Pictures that are darker than what networks were made with.

use image::RgbImage;

use crate::tuning::tuning;

tuning! {
    /// How much brighter dark pictures become before networks look at them.
    pub struct LightTuning {
        /// Level that the brightest pixels of a picture, a hundredth of it, have at least: below, all is made brighter by the
        /// same factor until they have it.
        ["levels", "chosen: pictures of normal light have 180 and more, and stay as they are"]
        pub bright: f32 = 140.0,
        /// Most that levels are multiplied by: beyond is noise.
        ["1", "chosen: noise of 4 levels becomes 32"]
        pub most: f32 = 8.0,
        /// Share of the pixels that are the brightest.
        ["1", "a hand that can be found covers more"]
        pub brightest: f64 = 0.01,
        /// Rows and columns that are looked at.
        ["1 / longer side", "chosen for speed: some thousand pixels"]
        pub looks: u32 = 80,
    }
}

/// By how much the levels of a picture are to be multiplied: 1 where it is bright enough.
pub fn gain(picture: &RgbImage, tuning: &LightTuning) -> f32 {
    let (width, height) = picture.dimensions();
    let step = (width.max(height) / tuning.looks.max(1)).max(1) as usize;
    let mut counts = [0u32; 256];
    let mut all = 0u32;
    for row in picture.as_raw().chunks_exact(3 * (width.max(1) as usize)).step_by(step) {
        for &[r, g, b] in row.as_chunks::<3>().0.iter().step_by(step) {
            // Skin is brightest in red, also where blue is dark.
            if let Some(count) = counts.get_mut(usize::from(r.max(g).max(b))) {
                *count += 1;
                all += 1;
            }
        }
    }
    let least = (tuning.brightest * f64::from(all)).max(1.0) as u32;
    let mut above = 0;
    let level = counts.iter().rposition(|count| {
        above += count;
        above >= least
    });
    match level {
        Some(level) if level > 0 => (tuning.bright / level as f32).clamp(1.0, tuning.most.max(1.0)),
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    /// A wall of a level with a hand of another on a fiftieth of it.
    fn picture(wall: u8, hand: u8) -> RgbImage {
        RgbImage::from_fn(400, 300, |x, y| {
            Rgb(if (100..160).contains(&x) && (100..140).contains(&y) {
                [hand, hand / 2, hand / 3]
            } else {
                [wall; 3]
            })
        })
    }

    #[test]
    fn dark_pictures_alone_become_brighter() {
        let tuning = LightTuning::default();
        for (wall, hand) in [(120, 200), (0, 200), (250, 40), (150, 30), (5, 140)] {
            assert_eq!(gain(&picture(wall, hand), &tuning), 1.0, "{wall} {hand}");
        }
        assert_eq!(gain(&picture(20, 25), &tuning), 5.6);
        assert_eq!(gain(&picture(50, 20), &tuning), 2.8);
        assert_eq!(gain(&picture(2, 3), &tuning), tuning.most);
        for (width, height) in [(0, 0), (3, 0), (1, 1), (70, 1)] {
            assert_eq!(gain(&RgbImage::new(width, height), &tuning), 1.0);
        }
    }
}
