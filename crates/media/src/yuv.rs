//! Planar YCbCr to RGB, scaled down on the way.

use image::RgbImage;

use handcast_picture::{Resampler, fit_within};

/// Which primaries the luma weights are for (ITU-R BT.601 or BT.709), and the range of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct YuvMatrix {
    /// BT.709 instead of BT.601.
    pub bt709: bool,
    /// Samples use 0..=255 instead of 16..=235 (luma) and 16..=240 (chroma).
    pub full_range: bool,
}

impl YuvMatrix {
    /// What players assume when a stream does not say: BT.709 from 720 lines up, BT.601 below.
    pub fn assumed_for(width: u32, height: u32) -> Self {
        Self { bt709: width.min(height) >= 720, full_range: false }
    }
}

/// How the chroma planes lie on the luma plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Chroma {
    /// No chroma planes.
    Mono,
    /// Subsampled by these powers of two; `left`: horizontally on the left luma sample, not between two.
    Planes { log2_x: u32, log2_y: u32, left: bool },
}

impl Chroma {
    /// Size of one chroma plane.
    pub(super) fn size(self, width: u32, height: u32) -> (u32, u32) {
        match self {
            Self::Mono => (0, 0),
            Self::Planes { log2_x, log2_y, .. } => {
                (width.div_ceil(1 << log2_x), height.div_ceil(1 << log2_y))
            }
        }
    }
}

/// Converts the planes of one clip's pictures.
#[derive(Debug)]
pub(super) struct Converter {
    size: (u32, u32),
    target: (u32, u32),
    chroma: Chroma,
    matrix: YuvMatrix,
    max_side: Option<u32>,
    table: Table,
    luma: Resampler,
    chroma_resampler: Resampler,
    scaled: [Vec<u8>; 3],
}

/// Fixed-point coefficients, 16 fractional bits.
#[derive(Clone, Copy, Debug)]
struct Table {
    luma_offset: i32,
    luma: i32,
    red_cr: i32,
    green_cb: i32,
    green_cr: i32,
    blue_cb: i32,
}

impl Table {
    fn new(matrix: YuvMatrix) -> Self {
        // ITU-R BT.601-7, 2.5.1 and BT.709-6, item 3.2.
        let (kr, kb) = if matrix.bt709 { (0.2126, 0.0722) } else { (0.299, 0.114) };
        let kg = 1.0 - kr - kb;
        let (luma_offset, y, c) =
            if matrix.full_range { (0, 1.0, 1.0) } else { (16, 255.0 / 219.0, 255.0 / 224.0) };
        let fixed = |v: f64| (v * 65536.0).round() as i32;
        Self {
            luma_offset,
            luma: fixed(y),
            red_cr: fixed(c * 2.0 * (1.0 - kr)),
            green_cb: fixed(-c * 2.0 * kb * (1.0 - kb) / kg),
            green_cr: fixed(-c * 2.0 * kr * (1.0 - kr) / kg),
            blue_cb: fixed(c * 2.0 * (1.0 - kb)),
        }
    }

    fn rgb(self, y: u8, cb: u8, cr: u8) -> [u8; 3] {
        let y = (i32::from(y) - self.luma_offset) * self.luma + 32768;
        let (cb, cr) = (i32::from(cb) - 128, i32::from(cr) - 128);
        let clip = |v: i32| (v >> 16).clamp(0, 255) as u8;
        [
            clip(y + self.red_cr * cr),
            clip(y + self.green_cb * cb + self.green_cr * cr),
            clip(y + self.blue_cb * cb),
        ]
    }
}

impl Converter {
    /// For pictures of `width` × `height`, delivered with the longer side at most `max_side`.
    pub(super) fn new(
        (width, height): (u32, u32),
        chroma: Chroma,
        matrix: YuvMatrix,
        max_side: Option<u32>,
    ) -> Self {
        let target = fit_within(width, height, max_side);
        let step = (f64::from(width) / f64::from(target.0), f64::from(height) / f64::from(target.1));
        let (divisor, offset) = match chroma {
            Chroma::Mono => ((1.0, 1.0), 0.0),
            Chroma::Planes { log2_x, log2_y, left } => {
                let divisor = (f64::from(1u32 << log2_x), f64::from(1u32 << log2_y));
                (divisor, if left && log2_x > 0 { 0.5 - 0.5 / divisor.0 } else { 0.0 })
            }
        };
        Self {
            size: (width, height),
            target,
            chroma,
            matrix,
            max_side,
            table: Table::new(matrix),
            luma: Resampler::new((width, height), target, 1),
            chroma_resampler: Resampler::with_steps(
                // Without chroma there is nothing to scale, but an axis needs a sample.
                if chroma == Chroma::Mono { (width, height) } else { chroma.size(width, height) },
                target,
                1,
                (step.0 / divisor.0, step.1 / divisor.1),
                (offset, 0.0),
            ),
            scaled: Default::default(),
        }
    }

    /// Lowers the most pixels of the longer side to `side`; a limit that is lower already stays.
    pub(super) fn limit(&mut self, side: u32) {
        let side = self.max_side.map_or(side, |own| own.min(side));
        *self = Self::new(self.size, self.chroma, self.matrix, Some(side));
    }

    /// The planes as RGB; `None` when a plane is shorter than its size says.
    pub(super) fn convert(&mut self, y: &[u8], cb: &[u8], cr: &[u8]) -> Option<RgbImage> {
        let luma_length = self.size.0 as usize * self.size.1 as usize;
        let chroma_size = self.chroma.size(self.size.0, self.size.1);
        let chroma_length = chroma_size.0 as usize * chroma_size.1 as usize;
        let y = y.get(..luma_length)?;
        let (cb, cr) = (cb.get(..chroma_length)?, cr.get(..chroma_length)?);
        let mut out = RgbImage::new(self.target.0, self.target.1);
        let pixels = self.target.0 as usize * self.target.1 as usize;
        let [sy, scb, scr] = &mut self.scaled;
        let y = scaled_plane(&mut self.luma, y, sy, pixels);
        if self.chroma == Chroma::Mono {
            for (pixel, &y) in out.as_chunks_mut_rgb().zip(y) {
                pixel.copy_from_slice(&self.table.rgb(y, 128, 128));
            }
        } else {
            let cb = scaled_plane(&mut self.chroma_resampler, cb, scb, pixels);
            let cr = scaled_plane(&mut self.chroma_resampler, cr, scr, pixels);
            for (((pixel, &y), &cb), &cr) in out.as_chunks_mut_rgb().zip(y).zip(cb).zip(cr) {
                pixel.copy_from_slice(&self.table.rgb(y, cb, cr));
            }
        }
        Some(out)
    }
}

/// `plane` itself when it needs no scaling, else its scaled copy in `buffer`.
fn scaled_plane<'a>(
    resampler: &mut Resampler,
    plane: &'a [u8],
    buffer: &'a mut Vec<u8>,
    pixels: usize,
) -> &'a [u8] {
    if resampler.is_identity() {
        return plane;
    }
    buffer.resize(pixels, 0);
    resampler.run(plane, buffer);
    buffer
}

trait RgbChunks {
    fn as_chunks_mut_rgb(&mut self) -> std::slice::ChunksExactMut<'_, u8>;
}

impl RgbChunks for RgbImage {
    fn as_chunks_mut_rgb(&mut self) -> std::slice::ChunksExactMut<'_, u8> {
        self.chunks_exact_mut(3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reference_colours() {
        // EBU 75 % red bar in limited BT.601 and BT.709 (ITU-R BT.801 and BT.709 bars).
        let bars = [
            (YuvMatrix { bt709: false, full_range: false }, [65, 100, 212], [191, 0, 0]),
            (YuvMatrix { bt709: true, full_range: false }, [51, 109, 212], [191, 0, 0]),
            (YuvMatrix { bt709: false, full_range: true }, [255, 128, 128], [255, 255, 255]),
            (YuvMatrix { bt709: true, full_range: false }, [235, 128, 128], [255, 255, 255]),
            (YuvMatrix { bt709: true, full_range: false }, [16, 128, 128], [0, 0, 0]),
        ];
        for (matrix, [y, cb, cr], want) in bars {
            let got = Table::new(matrix).rgb(y, cb, cr);
            for c in 0..3 {
                assert!((i32::from(got[c]) - want[c]).abs() <= 1, "{matrix:?} {got:?} {want:?}");
            }
        }
    }

    #[test]
    fn a_linear_ramp_stays_linear_through_left_sited_chroma() {
        // Cb rises by 2 a luma pixel; left-sited samples sit on even luma pixels.
        let (w, h) = (32u32, 4u32);
        let chroma = Chroma::Planes { log2_x: 1, log2_y: 1, left: true };
        let cb: Vec<u8> = (0..16 * 2).map(|i| 64 + (i % 16) as u8 * 4).collect();
        let matrix = YuvMatrix { bt709: false, full_range: true };
        let mut converter = Converter::new((w, h), chroma, matrix, None);
        let image = converter.convert(&[128; 128], &cb, &[128; 32]).unwrap();
        for x in 2..30 {
            let want = 128.0 + 1.772 * (64.0 + 2.0 * f64::from(x) - 128.0);
            let got = f64::from(image.get_pixel(x, 1).0[2]);
            assert!((got - want.clamp(0.0, 255.0)).abs() <= 1.5, "{x}: {got} {want}");
        }
    }

    #[test]
    fn short_planes_are_refused() {
        let chroma = Chroma::Planes { log2_x: 1, log2_y: 1, left: false };
        let mut converter = Converter::new((4, 4), chroma, YuvMatrix::assumed_for(4, 4), None);
        assert!(converter.convert(&[0; 16], &[0; 3], &[0; 4]).is_none());
        assert!(converter.convert(&[0; 16], &[0; 4], &[0; 4]).is_some());
    }
}
