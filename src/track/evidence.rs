//! What one frame offers to registration: the outline of the silhouette with a map to its nearest point,
//! and the luminance inside it.

use image::RgbImage;

use super::objective::{Forearm, Window};
use crate::vision::{Contour, ContourPoint, Mask};

/// Side of a cell of the map to the nearest outline point, pixels.
const CELL: usize = 2;
/// No outline point.
const NONE: u16 = u16::MAX;

/// The evidence in one frame. Positions are pixels of the image. Reused from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    window: Window,
    contour: Contour,
    /// Outline points that show the hand's own outline: not the cut from the forearm, not the border.
    points: Vec<ContourPoint>,
    /// For each cell of the window the nearest of `points`.
    nearest: Vec<u16>,
    cells: (usize, usize),
    luma: Vec<u8>,
    luma_size: (usize, usize),
    /// Mean luminance of each cell; empty without a picture.
    coarse: Vec<f32>,
}

impl Evidence {
    /// Loads the frame whose silhouette is `silhouette`, cut from its forearm at `forearm`; false, and
    /// nothing loaded, when it is empty. `image`, when given, has the size of the silhouette.
    pub fn load(&mut self, silhouette: &Mask, forearm: Option<Forearm>, image: Option<&RgbImage>) -> bool {
        if !self.window.reload(silhouette, forearm, 0.25) {
            return false;
        }
        let [x0, y0] = self.window.origin().map(|v| v as f32);
        let (width, height) = (silhouette.width() as f32, silhouette.height() as f32);
        self.contour.trace(self.window.silhouette());
        self.points.clear();
        for p in self.contour.points() {
            let position = [p.position[0] + x0, p.position[1] + y0];
            let [x, y] = position;
            let inside = x > 1.5 && y > 1.5 && x < width - 1.5 && y < height - 1.5;
            let of_hand = forearm.is_none_or(|f| f.side([f64::from(x), f64::from(y)]) > 3.0);
            if inside && of_hand && self.points.len() < usize::from(NONE) {
                self.points.push(ContourPoint { position, ..*p });
            }
        }
        self.map_nearest();
        self.luma.clear();
        self.luma_size = (0, 0);
        if let Some(image) = image.filter(|i| i.dimensions() == (silhouette.width(), silhouette.height())) {
            let (w, h) = (self.window.silhouette().width(), self.window.silhouette().height());
            self.luma_size = (w as usize, h as usize);
            for y in 0..h {
                let start = ((y + y0 as u32) as usize * image.width() as usize + x0 as usize) * 3;
                let row = image.as_raw().get(start..start + 3 * w as usize).unwrap_or(&[]);
                let luma = |p: &[u8; 3]| {
                    ((77 * u32::from(p[0]) + 150 * u32::from(p[1]) + 29 * u32::from(p[2])) >> 8) as u8
                };
                self.luma.extend(row.as_chunks().0.iter().map(luma));
            }
        }
        self.coarse.clear();
        if !self.luma.is_empty() {
            let (w, h) = self.luma_size;
            for y in 0..self.cells.1 {
                for x in 0..self.cells.0 {
                    let at = |dx: usize, dy: usize| {
                        let (x, y) = ((CELL * x + dx).min(w - 1), (CELL * y + dy).min(h - 1));
                        self.luma.get(y * w + x).map_or(0.0, |&v| f32::from(v))
                    };
                    self.coarse.push(0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)));
                }
            }
        }
        true
    }

    /// Mean luminance of the squares of two pixels of the window, row by row, and the length of a row; empty
    /// without a picture.
    pub(super) fn coarse_luma(&self) -> (&[f32], usize) {
        (&self.coarse, self.cells.0)
    }

    /// The silhouette and its window.
    pub fn window(&self) -> &Window {
        &self.window
    }

    /// The points of the hand's outline.
    pub fn points(&self) -> &[ContourPoint] {
        &self.points
    }

    /// The outline point nearest to `at`, pixels; `None` far outside the window, or when there are none.
    pub fn nearest(&self, at: [f64; 2]) -> Option<&ContourPoint> {
        let [x0, y0] = self.window.origin();
        let cell = |v: f64, n: usize| {
            let c = (v / CELL as f64).floor();
            // A margin: what leaves the window by a little is still drawn back.
            (c >= -16.0 && c < n as f64 + 16.0).then(|| (c.max(0.0) as usize).min(n.saturating_sub(1)))
        };
        let (x, y) = (cell(at[0] - x0, self.cells.0)?, cell(at[1] - y0, self.cells.1)?);
        self.points.get(usize::from(*self.nearest.get(y * self.cells.0 + x)?))
    }

    /// Luminance, 0 to 255, between the four pixels around `at`; `None` outside the window or without
    /// a picture.
    pub fn luma(&self, at: [f64; 2]) -> Option<f64> {
        let [x0, y0] = self.window.origin();
        let (x, y) = (at[0] - x0 - 0.5, at[1] - y0 - 0.5);
        let (w, h) = self.luma_size;
        if !(x >= 0.0 && y >= 0.0 && x < w as f64 - 1.0 && y < h as f64 - 1.0) {
            return None;
        }
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = (x - i as f64, y - j as f64);
        let at = |k: usize| self.luma.get(k).map(|&v| f64::from(v));
        let k = j * w + i;
        let top = at(k)? * (1.0 - fx) + at(k + 1)? * fx;
        let bottom = at(k + w)? * (1.0 - fx) + at(k + w + 1)? * fx;
        Some(top * (1.0 - fy) + bottom * fy)
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
        let mut pass = |x: usize, y: usize, neighbours: [(isize, isize); 4]| {
            let mut best = nearest[y * cw + x];
            let mut least = distance(best, x, y);
            for (dx, dy) in neighbours {
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
        for y in 0..ch {
            for x in 0..cw {
                pass(x, y, [(-1, 0), (-1, -1), (0, -1), (1, -1)]);
            }
            for x in (0..cw).rev() {
                pass(x, y, [(1, 0), (-1, -1), (0, -1), (1, -1)]);
            }
        }
        for y in (0..ch).rev() {
            for x in (0..cw).rev() {
                pass(x, y, [(1, 0), (-1, 1), (0, 1), (1, 1)]);
            }
            for x in 0..cw {
                pass(x, y, [(-1, 0), (-1, 1), (0, 1), (1, 1)]);
            }
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
    fn the_map_leads_to_the_nearest_point() {
        let mut evidence = Evidence::default();
        assert!(evidence.load(&silhouette(), None, None));
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
        assert!(evidence.load(&silhouette(), Some(forearm), None));
        assert!(evidence.points().iter().all(|p| p.position[1] < 97.5));
        let band = Mask::from_fn(160, 120, |x, _| (40..80).contains(&x));
        assert!(evidence.load(&band, None, None));
        assert!(evidence.points().iter().all(|p| p.position[1] > 1.0 && p.position[1] < 119.0));
        assert!(!evidence.load(&Mask::new(160, 120), None, None));
    }

    #[test]
    fn luminance_is_read_at_image_positions() {
        let image = RgbImage::from_fn(160, 120, |x, _| image::Rgb([x as u8; 3]));
        let mut evidence = Evidence::default();
        assert!(evidence.load(&silhouette(), None, Some(&image)));
        assert!((evidence.luma([70.5, 50.5]).unwrap() - 70.0).abs() < 0.01);
        assert!((evidence.luma([71.0, 50.5]).unwrap() - 70.5).abs() < 0.01);
        assert_eq!(evidence.luma([2.0, 2.0]), None);
    }
}
