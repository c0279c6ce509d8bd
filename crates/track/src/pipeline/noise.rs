//! Noise of pictures, which hides hands from networks and colours alike.

use image::RgbImage;
use image::imageops::blur;

use super::NoiseTuning;
use handcast_vision::light::{LightTuning, gain};

/// What the second differences below make of noise of a standard deviation of 1, and of a deviation the median of
/// absolute values.
const GAIN: f64 = 6.0;
const MEDIAN: f64 = 0.6745;
/// Largest of them.
const LARGEST: usize = 8 * 255;

/// Takes the noise off a picture that has much of it: a blur that leaves [`NoiseTuning::left`]. Others stay as they are. With
/// a finder noise counts as bright as that sees dark pictures.
pub(super) fn quieted(picture: RgbImage, finder: bool, tuning: &NoiseTuning) -> RgbImage {
    let brighter = if finder { gain(&picture, &LightTuning::default()) } else { 1.0 };
    let noise = noise_of(&picture, tuning.looks) * f64::from(brighter);
    if noise <= tuning.much {
        return picture;
    }
    // White noise behind a Gaussian of deviation s has 1 / (2 √π s) of its own.
    let deviation = noise / (2.0 * std::f64::consts::PI.sqrt() * tuning.left.max(0.1));
    blur(&picture, deviation.min(tuning.widest) as f32)
}

/// Standard deviation of the noise of a picture, levels of green: by what a Laplacian leaves that no plane nor saddle shows
/// (Immerkær, "Fast noise variance estimation", 1996), its median, since edges and fur are no noise.
fn noise_of(picture: &RgbImage, looks: u32) -> f64 {
    let (width, height) = picture.dimensions();
    let step = (width.max(height) / looks.max(1)).max(1) as usize;
    let green = |x: u32, y: u32| i32::from(picture.get_pixel(x, y).0[1]);
    let (mut counts, mut all) = ([0u32; LARGEST + 1], 0);
    for y in (1..height.saturating_sub(1)).step_by(step) {
        for x in (1..width.saturating_sub(1)).step_by(step) {
            let corners =
                green(x - 1, y - 1) + green(x + 1, y - 1) + green(x - 1, y + 1) + green(x + 1, y + 1);
            let sides = green(x, y - 1) + green(x - 1, y) + green(x + 1, y) + green(x, y + 1);
            let left = (corners - 2 * sides + 4 * green(x, y)).unsigned_abs() as usize;
            counts[left.min(LARGEST)] += 1;
            all += 1;
        }
    }
    let mut below = 0;
    let median = counts.iter().position(|count| {
        below += count;
        2 * below > all
    });
    median.unwrap_or(0) as f64 / (GAIN * MEDIAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slope with a bright square and noise that is nearly normal, of a standard deviation.
    fn picture(deviation: f64) -> RgbImage {
        let mut state = 7u32;
        let mut uniform = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24) - 0.5
        };
        RgbImage::from_fn(320, 240, |x, y| {
            let inside = (100..200).contains(&x) && (60..180).contains(&y);
            let level = if inside { 190.0 } else { 60.0 + 0.1 * f64::from(x) };
            image::Rgb([(); 3].map(|()| {
                let normal: f64 = (0..12).map(|_| uniform()).sum();
                (level + deviation * normal).round().clamp(0.0, 255.0) as u8
            }))
        })
    }

    #[test]
    fn noise_is_measured_beside_edges() {
        for deviation in [0.0, 4.0, 10.0, 25.0] {
            let found = noise_of(&picture(deviation), 80);
            assert!((found - deviation).abs() < 0.1 * deviation + 0.5, "{deviation}: {found}");
        }
        assert_eq!(noise_of(&RgbImage::new(2, 2), 80), 0.0);
        assert_eq!(noise_of(&RgbImage::new(1, 300), 80), 0.0);
    }

    #[test]
    fn noisy_pictures_alone_are_blurred() {
        let tuning = NoiseTuning::default();
        let calm = picture(3.0);
        assert_eq!(quieted(calm.clone(), true, &tuning), calm);
        // The same noise in the dark hides more.
        let dark =
            RgbImage::from_fn(320, 240, |x, y| image::Rgb(calm.get_pixel(x, y).0.map(|level| level / 5)));
        assert_eq!(quieted(dark.clone(), true, &tuning), dark);
        let grainy = RgbImage::from_fn(320, 240, |x, y| {
            image::Rgb([0, 1, 2].map(|c| dark.get_pixel(x, y).0[c] + calm.get_pixel(x, y).0[c] % 8))
        });
        assert_ne!(quieted(grainy.clone(), true, &tuning), grainy);
        assert_eq!(quieted(grainy.clone(), false, &tuning), grainy);
        let quiet = quieted(picture(15.0), false, &tuning);
        let (clean, edge) = (picture(0.0), 4);
        let mut off = Vec::new();
        for (x, y, pixel) in quiet.enumerate_pixels() {
            let near = |at: u32, from: u32, to: u32| at + edge > from && at < to + edge;
            if !(near(x, 100, 200) && near(y, 60, 180)) || (near(x, 110, 190) && near(y, 70, 170)) {
                off.push((f64::from(pixel.0[1]) - f64::from(clean.get_pixel(x, y).0[1])).powi(2));
            }
        }
        let rms = (off.iter().sum::<f64>() / off.len() as f64).sqrt();
        assert!(rms < 1.3 * tuning.left, "{rms}");
    }
}
