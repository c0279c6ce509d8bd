//! The colour of the skin in a clip.

use handcast_hand::nearest_skin_tone;
use image::RgbImage;

use super::TrackedFrame;

/// Hands that are looked at, those of one frame in so many, and how sure they must be.
const HANDS: usize = 64;
const EVERY: usize = 4;
const SURE: f64 = 0.5;
/// Half a side of the square that is looked at, in radii of the palm's circle, and its places a side.
const HALF: f64 = 0.6;
const PLACES: usize = 12;

/// What palms and backs of hands look like where light falls on them.
pub(super) struct SkinSamples {
    colours: Vec<[u8; 3]>,
}

impl SkinSamples {
    /// Nothing seen yet.
    pub fn new() -> Self {
        Self { colours: Vec::with_capacity(HANDS) }
    }

    /// Looks at the hands of a frame.
    pub fn take(&mut self, frame: &TrackedFrame<'_>) {
        if !frame.index.is_multiple_of(EVERY) {
            return;
        }
        for hand in frame.hands.iter().filter(|h| h.found.tracked.valid && h.found.confidence >= SURE) {
            let Some(silhouette) = hand.silhouette else { continue };
            let Some(palm) = silhouette.palm else { continue };
            let inside = |x, y| {
                x < silhouette.hand.width() && y < silhouette.hand.height() && silhouette.hand.get(x, y)
            };
            if self.colours.len() < HANDS {
                self.colours.extend(lit(frame.image, palm.centre, HALF * palm.radius, inside));
            }
        }
    }

    /// The tone of skin, 1 to 10; `None` where no hand was sure.
    pub fn tone(&self) -> Option<u8> {
        let middle = |k: usize| {
            let mut values: Vec<u8> = self.colours.iter().map(|c| c[k]).collect();
            values.sort_unstable();
            values.get(values.len() / 2).copied()
        };
        Some(nearest_skin_tone([middle(0)?, middle(1)?, middle(2)?]))
    }
}

/// The colour in a square that a quarter of its places are brighter than: shadows are not skin, and neither are highlights.
fn lit(image: &RgbImage, centre: [f64; 2], half: f64, inside: impl Fn(u32, u32) -> bool) -> Option<[u8; 3]> {
    let place = |k: usize, centre: f64| centre + half * (2.0 * k as f64 / (PLACES - 1) as f64 - 1.0);
    let mut colours = [[0; 3]; PLACES * PLACES];
    let mut count = 0;
    for (i, j) in (0..PLACES).flat_map(|j| (0..PLACES).map(move |i| (i, j))) {
        let (x, y) = (place(i, centre[0]), place(j, centre[1]));
        if x < 0.0 || y < 0.0 || !inside(x as u32, y as u32) {
            continue;
        }
        if let Some(pixel) = image.get_pixel_checked(x as u32, y as u32) {
            colours[count] = pixel.0;
            count += 1;
        }
    }
    let colours = &mut colours[..count];
    colours.sort_unstable_by_key(|c| 2 * u32::from(c[0]) + 5 * u32::from(c[1]) + u32::from(c[2]));
    colours.get(count * 3 / 4).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shadows_highlights_and_background_do_not_count() {
        let image = RgbImage::from_fn(40, 40, |x, y| {
            image::Rgb(match (x, y) {
                (0..20, _) => [0, 0, 255],
                (_, 0..24) => [226, 176, 148],
                (_, 24..27) => [255; 3],
                _ => [90, 60, 50],
            })
        });
        assert_eq!(lit(&image, [20.0, 20.0], 19.0, |x, _| x >= 20), Some([226, 176, 148]));
        assert_eq!(lit(&image, [-90.0, 500.0], 19.0, |_, _| true), None);
        let mut samples = SkinSamples::new();
        assert_eq!(samples.tone(), None);
        samples.colours = vec![[9; 3], [226, 176, 148], [255; 3]];
        assert_eq!(samples.tone(), Some(3));
    }
}
