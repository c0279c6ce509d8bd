//! The outline of a silhouette as smooth closed curves.

use super::mask::Mask;
use super::tuning::tuning;

tuning! {
    /// Smoothing of boundary curves. Points are a pixel or less apart.
    pub struct ContourTuning {
        /// Half the width of the running mean that smooths a curve: of this many points before and after.
        ["points", "chosen by eye on the three real clips"]
        pub smoothing: usize = 2,
        /// How often the running mean is taken.
        ["passes", "chosen by eye on the three real clips"]
        pub passes: usize = 2,
        /// Half the length of the chord whose normal is that of the curve.
        ["points", "chosen by eye on the three real clips"]
        pub normal_reach: usize = 2,
        /// Pixel edges of the shortest curve that is not noise.
        ["pixels", "chosen by eye on the three real clips"]
        pub min_length: usize = 16,
    }
}

/// The boundary curves of a mask: those around its parts and those around its holes.
///
/// The pixel edges between inside and outside are followed with the inside on the right; their midpoints,
/// smoothed along the curve, are its points, a pixel or less apart. Reused from frame to frame, it allocates
/// nothing once its buffers have grown.
#[derive(Clone, Debug, Default)]
pub struct Contour {
    tuning: ContourTuning,
    points: Vec<ContourPoint>,
    /// For each curve the index after its last point.
    ends: Vec<usize>,
    raw: Vec<[f32; 2]>,
    sums: Vec<[f32; 2]>,
    traced: Mask,
}

/// A point of a boundary curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContourPoint {
    /// Position, pixels, pixel centres at .5.
    pub position: [f32; 2],
    /// Unit vector out of the silhouette.
    pub normal: [f32; 2],
}

impl Contour {
    /// No curves yet; those to come are smoothed by `tuning`.
    pub fn new(tuning: ContourTuning) -> Self {
        Self { tuning, ..Self::default() }
    }

    /// Points of all curves, one curve after the other.
    pub fn points(&self) -> &[ContourPoint] {
        &self.points
    }

    /// The curves, each a closed sequence of points.
    pub fn curves(&self) -> impl Iterator<Item = &[ContourPoint]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).filter_map(|(start, &end)| self.points.get(start..end))
    }

    /// Replaces the curves by those of `mask`. Curves shorter than
    /// [`ContourTuning::min_length`] are left out.
    pub fn trace(&mut self, mask: &Mask) {
        self.points.clear();
        self.ends.clear();
        self.traced.reset(mask.width(), mask.height());
        for y in 0..mask.height() {
            for (x0, x1) in mask.runs(y) {
                for x in x0..x1 {
                    // The upper edge of a pixel under an empty one starts a curve, unless one passed there.
                    if (y == 0 || !mask.get(x, y - 1)) && !self.traced.get(x, y) {
                        self.follow(mask, x, y);
                    }
                }
            }
        }
    }

    /// Follows the curve along the upper edge of pixel (x, y).
    fn follow(&mut self, mask: &Mask, x: u32, y: u32) {
        const STEPS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
        // The pixels ahead on the right and on the left of a corner, by direction.
        const RIGHT: [[i32; 2]; 4] = [[0, 0], [-1, 0], [-1, -1], [0, -1]];
        const LEFT: [[i32; 2]; 4] = [[0, -1], [0, 0], [-1, 0], [-1, -1]];
        let inside = |at: [i32; 2], by: [i32; 2]| {
            let (x, y) = (at[0] + by[0], at[1] + by[1]);
            x >= 0 && y >= 0 && mask.get(x as u32, y as u32)
        };
        let start = [x as i32, y as i32];
        let (mut at, mut direction) = (start, 0);
        self.raw.clear();
        loop {
            let step = STEPS[direction];
            if direction == 0 {
                self.traced.set(at[0] as u32, at[1] as u32, true);
            }
            self.raw.push([at[0] as f32 + 0.5 * step[0] as f32, at[1] as f32 + 0.5 * step[1] as f32]);
            at = [at[0] + step[0], at[1] + step[1]];
            if !inside(at, RIGHT[direction]) {
                direction = (direction + 1) % 4;
            } else if inside(at, LEFT[direction]) {
                direction = (direction + 3) % 4;
            }
            if at == start && direction == 0 {
                break;
            }
        }
        if self.raw.len() >= self.tuning.min_length {
            self.close();
        }
    }

    /// Smooths the raw curve and appends it.
    fn close(&mut self) {
        let n = self.raw.len();
        // No window is wider than the curve is long.
        let half = self.tuning.smoothing.min((n - 1) / 2);
        let width = (2 * half + 1) as f32;
        for _ in 0..self.tuning.passes {
            self.sums.clear();
            let mut sum = [0.0f32; 2];
            for i in 0..2 * half + 1 {
                let p = self.raw[(n + i - half) % n];
                sum = [sum[0] + p[0], sum[1] + p[1]];
            }
            for i in 0..n {
                self.sums.push([sum[0] / width, sum[1] / width]);
                let (out, new) = (self.raw[(n + i - half) % n], self.raw[(i + half + 1) % n]);
                sum = [sum[0] + new[0] - out[0], sum[1] + new[1] - out[1]];
            }
            std::mem::swap(&mut self.raw, &mut self.sums);
        }
        let reach = self.tuning.normal_reach.min(n / 2);
        for i in 0..n {
            let (before, after) = (self.raw[(n + i - reach) % n], self.raw[(i + reach) % n]);
            let (dx, dy) = (after[0] - before[0], after[1] - before[1]);
            let length = dx.hypot(dy).max(1e-6);
            self.points.push(ContourPoint { position: self.raw[i], normal: [dy / length, -dx / length] });
        }
        self.ends.push(self.points.len());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(x: f32, y: f32, radius: f32) -> impl Fn(u32, u32) -> bool {
        move |px, py| (px as f32 + 0.5 - x).hypot(py as f32 + 0.5 - y) < radius
    }

    #[test]
    fn a_disc_has_one_round_curve() {
        let mask = Mask::from_fn(80, 70, disc(40.0, 33.0, 20.0));
        let mut contour = Contour::default();
        contour.trace(&mask);
        assert_eq!(contour.curves().count(), 1);
        for p in contour.points() {
            let (dx, dy) = (p.position[0] - 40.0, p.position[1] - 33.0);
            let r = dx.hypot(dy);
            assert!((r - 20.0).abs() < 0.8, "{r}");
            assert!((dx * p.normal[0] + dy * p.normal[1]) / r > 0.95, "normals point outwards");
        }
    }

    #[test]
    fn holes_have_curves_of_their_own_with_normals_into_the_hole() {
        let (outer, inner) = (disc(45.0, 45.0, 30.0), disc(45.0, 45.0, 12.0));
        let mask = Mask::from_fn(90, 90, |x, y| outer(x, y) && !inner(x, y));
        let mut contour = Contour::default();
        contour.trace(&mask);
        assert_eq!(contour.curves().count(), 2);
        for p in contour.points() {
            let (dx, dy) = (p.position[0] - 45.0, p.position[1] - 45.0);
            let outwards = dx * p.normal[0] + dy * p.normal[1] > 0.0;
            assert_eq!(outwards, dx.hypot(dy) > 20.0);
        }
    }

    #[test]
    fn masks_that_touch_every_border_and_empty_ones_are_traced() {
        let mut contour = Contour::default();
        contour.trace(&Mask::from_fn(20, 10, |_, _| true));
        assert_eq!(contour.points().len(), 60);
        contour.trace(&Mask::new(20, 10));
        assert!(contour.points().is_empty());
    }

    #[test]
    fn every_boundary_edge_is_followed_once() {
        // Pixels that touch at corners only, in all ways.
        let mask = Mask::from_fn(32, 32, |x, y| (x * 7 + y * 13 + x * y) % 5 < 3 && x > 2 && x < 29);
        let mut contour = Contour::default();
        let mut edges = 0;
        for y in 0..32 {
            for x in 0..32 {
                if mask.get(x, y) {
                    let out = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
                    edges += out.into_iter().filter(|&(x, y)| !mask.get(x, y)).count();
                }
            }
        }
        let mut followed = 0;
        contour.points.clear();
        contour.traced = Mask::new(32, 32);
        for y in 0..32 {
            for x in 0..32 {
                if mask.get(x, y) && (y == 0 || !mask.get(x, y - 1)) && !contour.traced.get(x, y) {
                    contour.follow(&mask, x, y);
                    followed += contour.raw.len();
                }
            }
        }
        assert_eq!(followed, edges);
    }
}
