//! Turned squares of a picture as the input of a network.

use handcast_vision::sighting::Region;
use image::RgbImage;

/// What is outside of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Border {
    /// Black.
    Black,
    /// The nearest pixel.
    Nearest,
}

/// Fills `side` x `side` pixels of three numbers from 0 to 1 with a region of the picture, interpolated linearly, its levels
/// multiplied by `gain`. The networks were made with crops whose first pixel is centred on the region's edge, not half a pixel inside.
pub(super) fn crop(
    picture: &RgbImage,
    region: &Region,
    (border, gain): (Border, f32),
    side: usize,
    output: &mut [f32],
) {
    let (sin, cos) = region.angle.sin_cos();
    let step = region.side / side as f64;
    let [dx, dy] = [cos * step, sin * step];
    let view = View {
        data: picture.as_raw(),
        width: i64::from(picture.width()),
        height: i64::from(picture.height()),
        border,
        scale: gain * (1.0 / 255.0),
        most: if gain > 1.0 { 1.0 } else { f32::INFINITY },
    };
    for (row, line) in output.chunks_exact_mut(3 * side).enumerate() {
        // Pixel numbers: centres of pixels at whole numbers.
        let [x, y] = region.point([0.0, row as f64 / side as f64]).map(|v| v - 0.5);
        for (column, out) in line.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let along = column as f64;
            *out = view.sample(x + along * dx, y + along * dy);
        }
    }
}

struct View<'a> {
    data: &'a [u8],
    width: i64,
    height: i64,
    border: Border,
    /// Number for a level, and the largest.
    scale: f32,
    most: f32,
}

impl View<'_> {
    /// Colour at a place in pixel numbers.
    #[inline]
    fn sample(&self, x: f64, y: f64) -> [f32; 3] {
        let (left, top) = (floor(x), floor(y));
        let (over, down) = ((x - left as f64) as f32, (y - top as f64) as f32);
        let inside = left >= 0 && top >= 0 && left + 1 < self.width && top + 1 < self.height;
        let corners = if inside {
            let at = 3 * (top * self.width + left) as usize;
            let below = at + 3 * self.width as usize;
            let upper = self.data.get(at..at + 6).unwrap_or(&[0; 6]);
            let lower = self.data.get(below..below + 6).unwrap_or(&[0; 6]);
            [
                [upper[0], upper[1], upper[2]],
                [upper[3], upper[4], upper[5]],
                [lower[0], lower[1], lower[2]],
                [lower[3], lower[4], lower[5]],
            ]
        } else {
            [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| self.pixel(left + i, top + j))
        };
        std::array::from_fn(|c| {
            let [a, b, e, f] = corners.map(|pixel| f32::from(pixel[c]));
            let upper = a + (b - a) * over;
            let lower = e + (f - e) * over;
            ((upper + (lower - upper) * down) * self.scale).min(self.most)
        })
    }

    fn pixel(&self, x: i64, y: i64) -> [u8; 3] {
        let (near_x, near_y) = (x.clamp(0, self.width - 1), y.clamp(0, self.height - 1));
        if self.border == Border::Black && (near_x, near_y) != (x, y) {
            return [0; 3];
        }
        let at = 3 * (near_y * self.width + near_x) as usize;
        self.data.get(at..at + 3).and_then(|p| p.try_into().ok()).unwrap_or([0; 3])
    }
}

/// The whole number below: `f64::floor` is a call where the processor is not known to have an instruction for it.
#[inline]
fn floor(value: f64) -> i64 {
    let near = value as i64;
    near - i64::from(near as f64 > value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_of_the_picture_s_own_size_is_the_picture() {
        let picture = RgbImage::from_fn(8, 8, |x, y| image::Rgb([x as u8 * 10, y as u8 * 10, 7]));
        let region = Region { centre: [4.5, 4.5], side: 8.0, angle: 0.0 };
        let mut out = vec![0.0; 8 * 8 * 3];
        crop(&picture, &region, (Border::Nearest, 1.0), 8, &mut out);
        let expected: Vec<f32> = picture.as_raw().iter().map(|&v| f32::from(v) / 255.0).collect();
        assert!(out.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn borders_are_black_or_repeat() {
        let picture = RgbImage::from_pixel(4, 4, image::Rgb([255; 3]));
        let region = Region { centre: [2.5, 2.5], side: 16.0, angle: 0.3 };
        let mut black = vec![0.5; 16 * 16 * 3];
        crop(&picture, &region, (Border::Black, 1.0), 16, &mut black);
        assert_eq!(black[0], 0.0);
        assert_eq!(black[(8 * 16 + 8) * 3], 1.0);
        let mut near = vec![0.5; 16 * 16 * 3];
        crop(&picture, &region, (Border::Nearest, 1.0), 16, &mut near);
        assert!(near.iter().all(|&v| v == 1.0));
    }

    #[test]
    fn a_gain_makes_it_brighter_up_to_white() {
        let picture = RgbImage::from_pixel(8, 8, image::Rgb([20, 50, 90]));
        let region = Region { centre: [4.5, 4.5], side: 4.0, angle: 0.0 };
        let mut out = vec![0.0; 4 * 4 * 3];
        crop(&picture, &region, (Border::Nearest, 4.0), 4, &mut out);
        let expected = [80.0 / 255.0, 200.0 / 255.0, 1.0];
        assert!(out[..3].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{:?}", &out[..3]);
    }

    #[test]
    fn a_quarter_turn_turns_the_picture_back() {
        let picture = RgbImage::from_fn(9, 9, |x, y| image::Rgb([x as u8 * 20, y as u8 * 20, 0]));
        let region = Region { centre: [4.5, 4.5], side: 8.0, angle: std::f64::consts::FRAC_PI_2 };
        let mut out = vec![0.0; 8 * 8 * 3];
        crop(&picture, &region, (Border::Nearest, 1.0), 8, &mut out);
        // The region's up is the picture's right.
        for (i, pixel) in out.as_chunks::<3>().0.iter().enumerate() {
            let (x, y) = (i % 8, i / 8);
            assert!((pixel[0] * 255.0 - (8 - y) as f32 * 20.0).abs() < 1e-3);
            assert!((pixel[1] * 255.0 - x as f32 * 20.0).abs() < 1e-3);
        }
    }
}
