//! What one frame offers to registration: the outline of the silhouette with a map to its nearest point,
//! and the luminance inside it.

use image::RgbImage;
use thiserror::Error;

use super::forearm::Forearm;
use super::objective::Window;
use super::register::JointPlaces;
use handcast_vision::tuning::tuning;
use handcast_vision::{Contour, ContourPoint, Halves, Mask};

/// Side of a cell of the map to the nearest outline point and of the mean luminance, pixels.
pub(super) const CELL: usize = 2;
/// No outline point.
const NONE: u16 = u16::MAX;

/// The picture of a frame has another size than its silhouette. Both are width and height, pixels.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error(
    "picture of {} x {} pixels with a silhouette of {} x {}; both must have one size",
    picture.0, picture.1, silhouette.0, silhouette.1
)]
pub struct SizeMismatch {
    /// Of the picture.
    pub picture: (u32, u32),
    /// Of the silhouette.
    pub silhouette: (u32, u32),
}

impl SizeMismatch {
    /// Compares the sizes.
    pub(super) fn check(silhouette: &Mask, image: Option<&RgbImage>) -> Result<(), Self> {
        let silhouette = (silhouette.width(), silhouette.height());
        match image.map(RgbImage::dimensions) {
            Some(picture) if picture != silhouette => Err(Self { picture, silhouette }),
            _ => Ok(()),
        }
    }
}

/// How far outside the window, in cells, the nearest outline point is still told: what leaves the window by a little is
/// drawn back.
const OUTSIDE: f64 = 16.0;
/// Weights of red, green and blue in luminance, of 256 (ITU-R BT.601).
const LUMA: [u32; 3] = [77, 150, 29];

tuning! {
    /// Which outline of the image is the hand's own.
    pub struct EvidenceTuning {
        /// How far around the silhouette the model may lie: share of the silhouette's larger side.
        ["1", "chosen by eye"]
        pub margin: f64 = 0.25,
        /// Distance from the image's border up to which an outline is the border's.
        ["pixels", "chosen by eye: the border's own outline lies within one"]
        pub border: f64 = 1.5,
        /// Distance from the forearm's cut up to which an outline is the cut's.
        ["pixels", "chosen by eye"]
        pub cut: f64 = 3.0,
    }
}

/// The evidence in one frame. Positions are pixels of the image, reduced. Reused from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    tuning: EvidenceTuning,
    reduced: Mask,
    window: Window,
    contour: Contour,
    /// Outline points that show the hand's own outline: not the cut from the forearm, not the border.
    points: Vec<ContourPoint>,
    /// Points along a pixel of outline.
    per_pixel: f64,
    /// For each cell of the window the nearest of `points`.
    nearest: Vec<u16>,
    cells: (usize, usize),
    /// Share of each cell that the silhouette covers, and mean luminance of those that it meets; empty without a picture.
    covered: Vec<f32>,
    coarse: Vec<f32>,
    /// Joints that a finder has seen.
    joints: Option<JointPlaces>,
}

impl Evidence {
    /// Evidence that is chosen in this way; nothing is loaded.
    pub fn new(tuning: EvidenceTuning) -> Self {
        Self { tuning, ..Self::default() }
    }

    /// Loads the frame whose silhouette is `silhouette`, cut from its forearm at `forearm`, at 1/`factor` of
    /// its size; false, and nothing loaded, when it is empty. `image`, when given, has the size of the
    /// silhouette.
    ///
    /// # Errors
    /// `image` has another size.
    pub fn load(
        &mut self,
        silhouette: &Mask,
        forearm: Option<Forearm>,
        image: Option<&RgbImage>,
        factor: u32,
    ) -> Result<bool, SizeMismatch> {
        SizeMismatch::check(silhouette, image)?;
        let factor = factor.max(1);
        silhouette.reduce_into(factor, Halves::EveryOther, &mut self.reduced);
        let forearm = forearm.map(|f| f.reduced(factor));
        if !self.window.reload(&self.reduced, forearm, self.tuning.margin) {
            return Ok(false);
        }
        let (width, height) = (self.reduced.width() as f32, self.reduced.height() as f32);
        // Followed at full size: a pixel of the reduced silhouette is wider than what fingers are off by.
        self.contour.trace(silhouette);
        self.per_pixel = f64::from(factor);
        let (border, cut) = (self.tuning.border as f32, self.tuning.cut);
        self.points.clear();
        for p in self.contour.points() {
            let position = p.position.map(|v| v / factor as f32);
            let [x, y] = position;
            let inside = x > border && y > border && x < width - border && y < height - border;
            let of_hand = forearm.is_none_or(|f| f.side([f64::from(x), f64::from(y)]) > cut);
            if inside && of_hand && self.points.len() < usize::from(NONE) {
                self.points.push(ContourPoint { position, ..*p });
            }
        }
        self.map_nearest();
        self.covered.clear();
        self.coarse.clear();
        if let Some(image) = image {
            self.load_luma(image, factor);
        }
        Ok(true)
    }

    /// Adds the joints that a finder has seen in the frame, pixels of an image `factor` times the size of the reduced
    /// one, or none.
    pub fn set_joints(&mut self, joints: Option<&JointPlaces>, factor: u32) {
        self.joints = joints.map(|joints| joints.map(|p| p.map(|v| v / f64::from(factor.max(1)))));
    }

    /// The joints that a finder has seen, pixels of the reduced image.
    pub(super) fn joints(&self) -> Option<&JointPlaces> {
        self.joints.as_ref()
    }

    /// The share of each cell that the silhouette covers, and the mean luminance of the pixels of `image` where it covers any.
    fn load_luma(&mut self, image: &RgbImage, factor: u32) {
        let (cw, ch) = self.cells;
        let silhouette = self.window.silhouette();
        self.covered.resize(cw * ch, 0.0);
        for y in 0..silhouette.height() {
            let row = &mut self.covered[y as usize / CELL * cw..][..cw];
            for (start, end) in silhouette.runs(y) {
                (start..end).for_each(|x| row[x as usize / CELL] += 1.0 / (CELL * CELL) as f32);
            }
        }
        let [x0, y0] = self.window.origin().map(|v| v as usize * factor as usize);
        let side = CELL * factor as usize;
        let (width, height) = (image.width() as usize, image.height() as usize);
        self.coarse.resize(cw * ch, 0.0);
        let cells = self.coarse.iter_mut().zip(&self.covered).enumerate();
        for (i, (mean, _)) in cells.filter(|(_, (_, covered))| **covered > 0.0) {
            let (top, left) = (y0 + i / cw * side, x0 + i % cw * side);
            let (start, end) = (left.min(width), (left + side).min(width));
            let (mut sums, mut count) = ([0u32; 3], 0);
            for y in top..(top + side).min(height) {
                let row = image.as_raw().get(3 * (y * width + start)..3 * (y * width + end));
                let row = row.unwrap_or(&[]).as_chunks::<3>().0;
                for p in row {
                    sums.iter_mut().zip(p).for_each(|(sum, &v)| *sum += u32::from(v));
                }
                count += 256 * row.len() as u32;
            }
            let sum: u32 = sums.iter().zip(LUMA).map(|(sum, weight)| weight * sum).sum();
            *mean = sum as f32 / count.max(1) as f32;
        }
    }

    /// Mean luminance of the squares of two pixels of the window that the silhouette meets (0 of the others), row by row, and
    /// the length of a row; empty without a picture.
    pub(super) fn coarse_luma(&self) -> (&[f32], usize) {
        (&self.coarse, self.cells.0)
    }

    /// Share of each of these squares that the silhouette covers, 0 to 1.
    pub(super) fn covered(&self) -> &[f32] {
        &self.covered
    }

    /// Whether there is a picture.
    pub(super) fn has_picture(&self) -> bool {
        !self.coarse.is_empty()
    }

    /// The whole silhouette, reduced.
    pub(super) fn silhouette(&self) -> &Mask {
        &self.reduced
    }

    /// The part of the silhouette around the hand.
    pub fn window(&self) -> &Window {
        &self.window
    }

    /// The points of the hand's outline.
    pub fn points(&self) -> &[ContourPoint] {
        &self.points
    }

    /// How many of the points there are along a pixel.
    pub(super) fn points_per_pixel(&self) -> f64 {
        self.per_pixel
    }

    /// The outline point nearest to `at`, pixels; `None` far outside the window, or when there are none.
    pub fn nearest(&self, at: [f64; 2]) -> Option<&ContourPoint> {
        let [x0, y0] = self.window.origin();
        let cell = |v: f64, n: usize| {
            let c = v / CELL as f64;
            (c >= -OUTSIDE && c < n as f64 + OUTSIDE).then(|| (c.max(0.0) as usize).min(n.saturating_sub(1)))
        };
        let (x, y) = (cell(at[0] - x0, self.cells.0)?, cell(at[1] - y0, self.cells.1)?);
        self.points.get(usize::from(*self.nearest.get(y * self.cells.0 + x)?))
    }

    /// Fills the map by passing the nearest point on from neighbour to neighbour, down and up (Danielsson
    /// 1980): the point found is nearest but for rare ties of a fraction of a pixel.
    fn map_nearest(&mut self) {
        let silhouette = self.window.silhouette();
        let (cw, ch) =
            ((silhouette.width() as usize).div_ceil(CELL), (silhouette.height() as usize).div_ceil(CELL));
        self.cells = (cw, ch);
        self.nearest.clear();
        self.nearest.resize(cw * ch, NONE);
        let [x0, y0] = self.window.origin().map(|v| v as f32);
        let Self { nearest, points, .. } = self;
        let distance = |index: u16, x: usize, y: usize| {
            points.get(usize::from(index)).map_or(f32::INFINITY, |p| {
                let centre = |c: usize| (CELL * c) as f32 + 0.5 * CELL as f32;
                let (dx, dy) = (p.position[0] - x0 - centre(x), p.position[1] - y0 - centre(y));
                dx * dx + dy * dy
            })
        };
        for (i, p) in points.iter().enumerate() {
            let cell = |v: f32, n: usize| ((v / CELL as f32) as usize).min(n - 1);
            let (x, y) = (cell(p.position[0] - x0, cw), cell(p.position[1] - y0, ch));
            let slot = &mut nearest[y * cw + x];
            if distance(i as u16, x, y) < distance(*slot, x, y) {
                *slot = i as u16;
            }
        }
        let mut pass = |x: usize, y: usize, neighbours: &[(isize, isize)]| {
            let mut best = nearest[y * cw + x];
            let mut least = distance(best, x, y);
            for &(dx, dy) in neighbours {
                let (nx, ny) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
                if nx < cw && ny < ch {
                    let candidate = nearest[ny * cw + nx];
                    if candidate != NONE && candidate != best {
                        let d = distance(candidate, x, y);
                        if d < least {
                            (best, least) = (candidate, d);
                        }
                    }
                }
            }
            nearest[y * cw + x] = best;
        };
        // What the row before says is known after the first way along a row.
        for y in 0..ch {
            (0..cw).for_each(|x| pass(x, y, &[(-1, 0), (-1, -1), (0, -1), (1, -1)]));
            (0..cw).rev().for_each(|x| pass(x, y, &[(1, 0)]));
        }
        for y in (0..ch).rev() {
            (0..cw).rev().for_each(|x| pass(x, y, &[(1, 0), (-1, 1), (0, 1), (1, 1)]));
            (0..cw).for_each(|x| pass(x, y, &[(-1, 0)]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn silhouette() -> Mask {
        // Two fingers on a palm.
        Mask::from_fn(160, 120, |x, y| {
            ((50..100).contains(&x) && (60..100).contains(&y))
                || ((54..64).contains(&x) && (15..61).contains(&y))
                || ((80..92).contains(&x) && (25..61).contains(&y))
        })
    }

    #[test]
    fn a_picture_of_another_size_is_refused() {
        let mut evidence = Evidence::default();
        let image = RgbImage::new(80, 60);
        let wrong = SizeMismatch { picture: (80, 60), silhouette: (160, 120) };
        assert_eq!(evidence.load(&silhouette(), None, Some(&image), 1), Err(wrong));
        assert!(wrong.to_string().contains("picture of 80 x 60 pixels with a silhouette of 160 x 120"));
    }

    #[test]
    fn the_map_leads_to_the_nearest_point() {
        let mut evidence = Evidence::default();
        assert!(evidence.load(&silhouette(), None, None, 1).unwrap());
        for y in (2..118).step_by(3) {
            for x in (30..120).step_by(3) {
                let at = [f64::from(x), f64::from(y)];
                let away = |p: &ContourPoint| {
                    (f64::from(p.position[0]) - at[0]).hypot(f64::from(p.position[1]) - at[1])
                };
                let least = evidence.points().iter().map(away).fold(f64::INFINITY, f64::min);
                let found = away(evidence.nearest(at).unwrap());
                // The map answers for the middle of a cell, at most 1.5 pixels away.
                assert!(found - least < 3.0, "{at:?}: {found} {least}");
            }
        }
    }

    #[test]
    fn the_cut_and_the_border_are_no_outline_of_the_hand() {
        let mut evidence = Evidence::default();
        let forearm = Forearm { cut: [75.0, 100.0], axis: [0.0, -1.0] };
        assert!(evidence.load(&silhouette(), Some(forearm), None, 1).unwrap());
        assert!(evidence.points().iter().all(|p| p.position[1] < 97.5));
        let band = Mask::from_fn(160, 120, |x, _| (40..80).contains(&x));
        assert!(evidence.load(&band, None, None, 1).unwrap());
        assert!(evidence.points().iter().all(|p| p.position[1] > 1.0 && p.position[1] < 119.0));
        assert!(!evidence.load(&Mask::new(160, 120), None, None, 1).unwrap());
    }

    #[test]
    fn luminance_is_the_mean_of_cells_at_any_size() {
        let image = RgbImage::from_fn(160, 120, |x, _| image::Rgb([x as u8; 3]));
        let mut evidence = Evidence::default();
        for factor in [1, 2] {
            assert!(evidence.load(&silhouette(), None, Some(&image), factor).unwrap());
            let (luma, width) = evidence.coarse_luma();
            let left = evidence.window().origin()[0] * f64::from(factor);
            let mut seen = 0;
            for (i, (&v, &covered)) in luma.iter().zip(evidence.covered()).enumerate() {
                let middle = left + ((i % width) as f64 + 0.5) * f64::from(2 * factor) - 0.5;
                assert_eq!(covered > 0.0, v > 0.0);
                assert!(covered == 0.0 || (f64::from(v) - middle).abs() < 0.01, "{factor}: {v} {middle}");
                seen += usize::from(covered == 1.0);
            }
            assert!(seen > 100, "{seen}");
        }
    }
}
