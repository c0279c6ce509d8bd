//! Pictures in which skin has lost its colour, or shows little of it.

use std::fmt;

use handcast_vision::Silhouette;
use image::{Rgb, RgbImage};

/// How much of skin, or of a picture without any, is as bright as a picture can be, and how much is dark: over-exposed skin has no
/// colour of its own, dark skin little beside the noise. Says so where it is much.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exposure {
    /// Share of pixels, 0 to 1.
    pub clipped: f64,
    /// Share of pixels that are dark, 0 to 1.
    pub dark: f64,
}

impl Exposure {
    /// Level from which on a channel is as bright as it can be, but for compression.
    const BRIGHTEST: u8 = 248;
    /// Share from which on a picture is over-exposed.
    const MUCH: f64 = 0.25;
    /// Level that no channel of a dark pixel reaches: a quarter of the brightest.
    const DARK: u8 = 64;
    /// Share from which on a picture is dark: the hand, too.
    const ALL: f64 = 0.99;

    /// Of these parts, or of all of the picture if there are none.
    pub(super) fn of(image: &RgbImage, parts: &[Silhouette]) -> Self {
        let clipped = |pixel: &Rgb<u8>| pixel.0.iter().any(|level| *level >= Self::BRIGHTEST);
        let (mut count, mut dark, mut all) = (0usize, 0usize, 0usize);
        let mut add = |pixel: &Rgb<u8>| {
            all += 1;
            count += usize::from(clipped(pixel));
            dark += usize::from(pixel.0.iter().all(|level| *level < Self::DARK));
        };
        if parts.is_empty() {
            image.pixels().for_each(&mut add);
        } else {
            let places = parts.iter().flat_map(|part| part.arm.pixels());
            places.filter_map(|(x, y)| image.get_pixel_checked(x, y)).for_each(add);
        }
        let [clipped, dark] = [count, dark].map(|n| n as f64 / all.max(1) as f64);
        Self { clipped, dark }
    }
}

impl fmt::Display for Exposure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.dark >= Self::ALL {
            return f.write_str("; the picture is dark there: more light, or a longer exposure, shows colours above the noise");
        }
        if self.clipped < Self::MUCH {
            return Ok(());
        }
        let percent = (100.0 * self.clipped).round();
        write!(
            f,
            "; {percent} % of the skin or picture there is over-exposed: less light, or a shorter exposure, keeps colours apart"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_vision::Mask;

    #[test]
    fn skin_counts_before_what_is_behind_it() {
        let picture = |skin: [u8; 3], wall: [u8; 3]| {
            RgbImage::from_fn(40, 30, |x, _| Rgb(if x < 20 { skin } else { wall }))
        };
        let mask = Mask::from_fn(40, 30, |x, _| x < 20);
        let part = Silhouette { hand: mask.clone(), arm: mask, wrist: None, palm: None, clipped: false };
        let (skin, burnt, white) = ([220, 170, 140], [255, 235, 210], [255, 255, 255]);
        let told = |skin, wall, parts: &[Silhouette]| Exposure::of(&picture(skin, wall), parts).to_string();
        assert_eq!(told(skin, white, std::slice::from_ref(&part)), "");
        assert!(
            told(burnt, [90; 3], &[part]).starts_with("; 100 % of the skin or picture there is over-exposed")
        );
        assert!(told(skin, white, &[]).starts_with("; 50 % of"));
        assert_eq!(told(skin, [200; 3], &[]), "");
        assert!(told([40, 28, 22], [30; 3], &[]).starts_with("; the picture is dark"));
        assert_eq!(told(skin, [10; 3], &[]), "");
    }
}
