//! Hulls of discs drawn into a packed mask, row by row.

use crate::vision::Mask;

/// A projected sphere: centre and radius in pixels, pixel centres at .5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Centre, pixels from the left edge.
    pub x: f64,
    /// Centre, pixels from the top edge.
    pub y: f64,
    /// Radius, pixels.
    pub radius: f64,
}

/// Draws convex hulls of discs. Holds the row buffers, so that drawing allocates nothing once they
/// have grown to the height of the mask.
#[derive(Clone, Debug, Default)]
pub struct Rasterizer {
    left: Vec<f64>,
    right: Vec<f64>,
}

impl Rasterizer {
    /// A rasteriser with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets every pixel of `mask` whose centre lies in the convex hull of `discs`.
    ///
    /// The hull's extent in a row is the union of the extents of the discs and of the outer tangents of
    /// each pair of discs, so neither sorting nor a polygon is needed. Discs that are not finite draw nothing.
    pub fn fill_hull(&mut self, mask: &mut Mask, discs: impl Iterator<Item = Disc> + Clone) {
        self.spans(mask.height(), discs, |y, x0, x1| mask.fill_span(y, x0, x1));
    }

    /// Gives `span(row, start, end)` for each row, below `height`, of the convex hull of `discs`: the columns
    /// whose pixel centres lie inside, end excluded. They may lie outside of any image.
    pub(super) fn spans(
        &mut self,
        height: u32,
        discs: impl Iterator<Item = Disc> + Clone,
        mut span: impl FnMut(u32, i32, i32),
    ) {
        let height = f64::from(height);
        let (mut top, mut bottom) = (f64::INFINITY, f64::NEG_INFINITY);
        for d in discs.clone() {
            if !(d.x.is_finite() && d.y.is_finite() && d.radius.is_finite()) {
                return;
            }
            top = top.min(d.y - d.radius);
            bottom = bottom.max(d.y + d.radius);
        }
        // Rows whose centre y + 0.5 lies in [top, bottom].
        let first = (top - 0.5).ceil().clamp(0.0, height) as usize;
        let end = ((bottom - 0.5).floor() + 1.0).clamp(0.0, height) as usize;
        if first >= end {
            return;
        }
        let rows = end - first;
        self.left.clear();
        self.left.resize(rows, f64::INFINITY);
        self.right.clear();
        self.right.resize(rows, f64::NEG_INFINITY);
        let mut extents = Extents { first, left: &mut self.left, right: &mut self.right };
        let mut rest = discs;
        while let Some(a) = rest.next() {
            extents.disc(a);
            for b in rest.clone() {
                extents.tangents(a, b);
            }
        }
        for (i, (&l, &r)) in self.left.iter().zip(&self.right).enumerate() {
            // Saturating casts: what is far outside is for the receiver to clip.
            span((first + i) as u32, ceil(l - 0.5), floor(r - 0.5).saturating_add(1));
        }
    }
}

struct Extents<'a> {
    first: usize,
    left: &'a mut [f64],
    right: &'a mut [f64],
}

impl Extents<'_> {
    /// Indices of the rows whose centres lie in [y0, y1].
    fn rows(&self, y0: f64, y1: f64) -> std::ops::Range<usize> {
        let rows = self.left.len() as i32;
        let inside = |row: i32| row.saturating_sub(self.first as i32).clamp(0, rows) as usize;
        let start = inside(ceil(y0 - 0.5));
        start..inside(floor(y1 - 0.5).saturating_add(1)).max(start)
    }

    fn disc(&mut self, d: Disc) {
        let rows = self.rows(d.y - d.radius, d.y + d.radius);
        let r2 = d.radius * d.radius;
        let first = (self.first + rows.start) as f64 + 0.5 - d.y;
        for ((i, l), r) in (0i32..).zip(&mut self.left[rows.clone()]).zip(&mut self.right[rows]) {
            let dy = first + f64::from(i);
            let half = (r2 - dy * dy).max(0.0).sqrt();
            lower(l, d.x - half);
            raise(r, d.x + half);
        }
    }

    /// The two outer tangent segments of a pair; none when one disc holds the other.
    fn tangents(&mut self, a: Disc, b: Disc) {
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let d2 = dx * dx + dy * dy;
        let dr = a.radius - b.radius;
        if d2 <= dr * dr {
            return;
        }
        // Unit normals n with n·(b − a) = dr.
        let along = dr / d2;
        let across = (d2 - dr * dr).sqrt() / d2;
        for side in [-across, across] {
            let (nx, ny) = (along * dx - side * dy, along * dy + side * dx);
            let (px, py) = (a.x + a.radius * nx, a.y + a.radius * ny);
            let (qx, qy) = (b.x + b.radius * nx, b.y + b.radius * ny);
            self.segment([px, py], [qx, qy], nx < 0.0);
        }
    }

    /// A piece of the outline that bounds the hull on its left, or else on its right.
    fn segment(&mut self, [px, py]: [f64; 2], [qx, qy]: [f64; 2], left: bool) {
        let rows = self.rows(py.min(qy), py.max(qy));
        if rows.is_empty() {
            return;
        }
        let slope = (qx - px) / (qy - py);
        let first = px + ((self.first + rows.start) as f64 + 0.5 - py) * slope;
        // Not by adding up the slope: the rows do not wait for each other.
        let at = |i: i32| first + f64::from(i) * slope;
        if left {
            (0..).zip(&mut self.left[rows]).for_each(|(i, l)| lower(l, at(i)));
        } else {
            (0..).zip(&mut self.right[rows]).for_each(|(i, r)| raise(r, at(i)));
        }
    }
}

/// `v.ceil() as i32`, without the call that processors before SSE 4.1 need.
fn ceil(v: f64) -> i32 {
    let t = v as i32;
    t.saturating_add(i32::from(f64::from(t) < v))
}

/// `v.floor() as i32`, likewise.
fn floor(v: f64) -> i32 {
    let t = v as i32;
    t.saturating_sub(i32::from(f64::from(t) > v))
}

/// The smaller value, for numbers that are not NaN.
fn lower(least: &mut f64, value: f64) {
    if value < *least {
        *least = value;
    }
}

/// The larger value, for numbers that are not NaN.
fn raise(most: &mut f64, value: f64) {
    if value > *most {
        *most = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// How far the point is outside the hull of the discs (negative inside): the largest signed
    /// distance to a supporting line, over the directions in which it can be attained.
    fn outside(discs: &[Disc], x: f64, y: f64) -> f64 {
        let support = |angle: f64| {
            let (s, c) = angle.sin_cos();
            let hull = discs.iter().map(|d| d.x * c + d.y * s + d.radius).fold(f64::MIN, f64::max);
            x * c + y * s - hull
        };
        let n = 360;
        let best = (0..n)
            .map(|i| std::f64::consts::TAU * f64::from(i) / f64::from(n))
            .max_by(|a, b| support(*a).total_cmp(&support(*b)))
            .unwrap();
        // The support function is smooth between samples: refine around the best one.
        let step = std::f64::consts::TAU / f64::from(n);
        let (mut lo, mut hi) = (best - step, best + step);
        for _ in 0..60 {
            let (a, b) = (lo + (hi - lo) / 3.0, hi - (hi - lo) / 3.0);
            if support(a) < support(b) { lo = a } else { hi = b }
        }
        support(0.5 * (lo + hi)).max(support(best))
    }

    fn disc() -> impl Strategy<Value = Disc> {
        (-10.0f64..50.0, -10.0f64..50.0, 0.3f64..12.0).prop_map(|(x, y, radius)| Disc { x, y, radius })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn hull_matches_brute_force(discs in prop::collection::vec(disc(), 1..6)) {
            let mut mask = Mask::new(40, 40);
            Rasterizer::new().fill_hull(&mut mask, discs.iter().copied());
            for y in 0..40 {
                for x in 0..40 {
                    let d = outside(&discs, f64::from(x) + 0.5, f64::from(y) + 0.5);
                    // Only rounding may decide pixels whose centre lies on the outline.
                    if d.abs() > 1e-6 {
                        prop_assert_eq!(mask.get(x, y), d < 0.0, "pixel {},{} at {}", x, y, d);
                    }
                }
            }
        }
    }

    #[test]
    fn rounding_is_that_of_the_library() {
        for v in [
            -2.5,
            -2.0,
            -0.5,
            -0.0,
            0.0,
            0.3,
            1.0,
            7.999,
            1e9,
            -1e9,
            1e300,
            -1e300,
            f64::INFINITY,
            f64::NEG_INFINITY,
        ] {
            assert_eq!((ceil(v), floor(v)), (v.ceil() as i32, v.floor() as i32), "{v}");
        }
    }

    #[test]
    fn numbers_that_are_not_finite_draw_nothing() {
        let mut mask = Mask::new(64, 8);
        let discs = [Disc { x: 3.0, y: 3.0, radius: 2.0 }, Disc { x: f64::NAN, y: 3.0, radius: 2.0 }];
        Rasterizer::new().fill_hull(&mut mask, discs.into_iter());
        assert!(mask.is_empty());
    }
}
