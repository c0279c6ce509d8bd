//! Hulls of discs drawn into a packed mask, row by row.

use handcast_vision::Mask;

/// A projected sphere: centre and radius in pixels, pixel centres at .5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProjectedDisc {
    /// Centre, pixels from the left edge.
    pub x: f64,
    /// Centre, pixels from the top edge.
    pub y: f64,
    /// Radius, pixels.
    pub radius: f64,
}

impl ProjectedDisc {
    /// How far it reaches along a unit vector, pixels.
    pub(super) fn support(&self, n: [f64; 2]) -> f64 {
        self.x * n[0] + self.y * n[1] + self.radius
    }

    /// The point of its outline in the direction of a unit vector.
    pub(super) fn edge(&self, n: [f64; 2]) -> [f64; 2] {
        [self.x + self.radius * n[0], self.y + self.radius * n[1]]
    }

    /// Outward normals of the two outer tangents of this disc and another; `None` when one holds the other.
    pub(super) fn tangents(&self, other: &Self) -> Option<[[f64; 2]; 2]> {
        let (dx, dy) = (other.x - self.x, other.y - self.y);
        let square = dx * dx + dy * dy;
        let narrowing = self.radius - other.radius;
        if square <= narrowing * narrowing {
            return None;
        }
        let along = narrowing / square;
        let across = (square - narrowing * narrowing).sqrt() / square;
        Some([-across, across].map(|c| [along * dx - c * dy, along * dy + c * dx]))
    }
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
    /// pairs of discs, so neither sorting nor a polygon is needed. Discs that are not finite draw nothing.
    pub fn fill_hull(&mut self, mask: &mut Mask, discs: impl Iterator<Item = ProjectedDisc> + Clone) {
        self.spans(mask.height(), discs, |y, x0, x1| mask.fill_span(y, x0, x1));
    }

    /// Gives `span(row, start, end)` for each row, below `height`, of the convex hull of `discs`: the columns
    /// whose pixel centres lie inside, end excluded. They may lie outside of any image.
    pub(super) fn spans(
        &mut self,
        height: u32,
        discs: impl Iterator<Item = ProjectedDisc> + Clone,
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
        let mut pair = discs.clone();
        if let (Some(a), Some(b), None) = (pair.next(), pair.next(), pair.next()) {
            extents.pair(a, b);
        } else {
            extents.hull(discs);
        }
        for (i, (&l, &r)) in self.left.iter().zip(&self.right).enumerate() {
            span((first + i) as u32, nearest(l), nearest(r));
        }
    }
}

struct Extents<'a> {
    first: usize,
    left: &'a mut [f64],
    right: &'a mut [f64],
}

impl Extents<'_> {
    /// Index of the first row whose centre is below `y`; one whose centre is at `y` counts as either.
    fn row(&self, y: f64) -> usize {
        (nearest(y) - self.first as i32).clamp(0, self.left.len() as i32) as usize
    }

    /// The union of the extents of the discs and of the tangents that no disc reaches beyond.
    fn hull(&mut self, discs: impl Iterator<Item = ProjectedDisc> + Clone) {
        let mut rest = discs.clone();
        while let Some(a) = rest.next() {
            self.disc(a);
            for b in rest.clone() {
                for n in a.tangents(&b).into_iter().flatten() {
                    let limit = a.support(n) + 1e-9;
                    if discs.clone().all(|d| d.support(n) <= limit) {
                        self.segment(a.edge(n), b.edge(n), n[0] < 0.0);
                    }
                }
            }
        }
    }

    fn disc(&mut self, d: ProjectedDisc) {
        let start = self.row(d.y - d.radius);
        let rows = start..self.row(d.y + d.radius).max(start);
        let half = half_widths(&d, self.first + rows.start);
        for ((i, l), r) in (0i32..).zip(&mut self.left[rows.clone()]).zip(&mut self.right[rows]) {
            let half = half(i);
            lower(l, d.x - half);
            raise(r, d.x + half);
        }
    }

    /// A piece of the outline that bounds the hull on its left, or else on its right.
    fn segment(&mut self, p: [f64; 2], q: [f64; 2], left: bool) {
        let rows = self.row(p[1].min(q[1]))..self.row(p[1].max(q[1]));
        let at = line(p, q, self.first + rows.start);
        if left {
            (0..).zip(&mut self.left[rows]).for_each(|(i, l)| lower(l, at(i)));
        } else {
            (0..).zip(&mut self.right[rows]).for_each(|(i, r)| raise(r, at(i)));
        }
    }

    /// The hull of two discs, every row of either border once: down the border an arc, a tangent and an arc follow one
    /// another.
    fn pair(&mut self, a: ProjectedDisc, b: ProjectedDisc) {
        let mut tangents = a.tangents(&b);
        if let Some([upper, lower]) = &mut tangents
            && upper[1] > lower[1]
        {
            std::mem::swap(upper, lower);
        }
        let rows = self.left.len();
        for sign in [-1.0, 1.0] {
            // Of two that reach as far the smaller is inside.
            let reach = |d: &ProjectedDisc| (d.support([sign, 0.0]), d.radius);
            let (mut from, mut disc) = (0, if reach(&b) > reach(&a) { b } else { a });
            for n in tangents.into_iter().flatten().filter(|n| (n[0] < 0.0) == (sign < 0.0)) {
                let down = sign * (n[0] * (b.y - a.y) - n[1] * (b.x - a.x)) > 0.0;
                let (above, below) = if down { (a, b) } else { (b, a) };
                let (p, q) = (above.edge(n), below.edge(n));
                let start = self.row(p[1]).max(from);
                let end = self.row(q[1]).max(start);
                self.arc(sign, from..start, &above);
                let at = line(p, q, self.first + start);
                let border = if sign < 0.0 { &mut self.left } else { &mut self.right };
                (0..).zip(&mut border[start..end]).for_each(|(i, v)| *v = at(i));
                (from, disc) = (end, below);
            }
            self.arc(sign, from..rows, &disc);
        }
    }

    /// The border of a disc in these rows: on the left, sign −1, or on the right, 1.
    fn arc(&mut self, sign: f64, rows: std::ops::Range<usize>, d: &ProjectedDisc) {
        let half = half_widths(d, self.first + rows.start);
        let border = if sign < 0.0 { &mut self.left } else { &mut self.right };
        (0..).zip(&mut border[rows]).for_each(|(i, v)| *v = d.x + sign * half(i));
    }
}

/// Half the width of a disc in row `first` and those that follow.
fn half_widths(d: &ProjectedDisc, first: usize) -> impl Fn(i32) -> f64 + use<> {
    let square = d.radius * d.radius;
    let top = first as f64 + 0.5 - d.y;
    move |i| {
        let dy = top + f64::from(i);
        (square - dy * dy).max(0.0).sqrt()
    }
}

/// Where the line through two points is in row `first` and those that follow. Not by adding up its slope: the rows do
/// not wait for each other.
fn line([px, py]: [f64; 2], [qx, qy]: [f64; 2], first: usize) -> impl Fn(i32) -> f64 {
    let slope = (qx - px) / (qy - py);
    let start = px + (first as f64 + 0.5 - py) * slope;
    move |i| start + f64::from(i) * slope
}

/// The nearest whole number, the even one of two, for numbers that are not NaN: what is far outside of any image stays
/// far outside. Also the first pixel whose centre is beyond `v`; one whose centre is at `v` belongs to either side. A sum
/// whose last bit is worth 1, since processors before SSE 4.1 need a call to round.
fn nearest(v: f64) -> i32 {
    const ONES: f64 = (1u64 << 52) as f64 * 1.5;
    (v.clamp(-1e9, 1e9) + ONES).to_bits() as i32
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
    fn outside(discs: &[ProjectedDisc], x: f64, y: f64) -> f64 {
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

    fn disc() -> impl Strategy<Value = ProjectedDisc> {
        (-10.0f64..50.0, -10.0f64..50.0, 0.3f64..12.0).prop_map(|(x, y, radius)| ProjectedDisc {
            x,
            y,
            radius,
        })
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
    fn discs_inside_others_leave_their_border() {
        let spans = |discs: &[ProjectedDisc]| {
            let mut found = Vec::new();
            Rasterizer::new().spans(30, discs.iter().copied(), |y, x0, x1| found.push((y, x0, x1)));
            found
        };
        let disc = |x, radius| ProjectedDisc { x, y: 10.0, radius };
        let large = disc(10.0, 10.0);
        // One that touches the border from inside, where it reaches as far, and one of less than nothing.
        for other in [disc(19.0, 1.0), disc(1.0, 1.0), disc(12.0, 3.0)] {
            assert_eq!(spans(&[other, large]), spans(&[large]));
            assert_eq!(spans(&[large, other]), spans(&[large]));
        }
        assert_eq!(spans(&[large, disc(12.0, 5.0), disc(10.0, -3.0)]), spans(&[large]));
    }

    #[test]
    fn rounding_is_that_of_the_library() {
        for v in [
            -2.5,
            -2.0,
            -1.501,
            -0.5,
            -0.0,
            0.0,
            0.3,
            0.5,
            0.501,
            1.0,
            7.999,
            1e8 + 0.4,
            -1e8 - 0.6,
            1e9,
            -1e9,
        ] {
            assert_eq!(nearest(v), v.round_ties_even() as i32, "{v}");
        }
        for far in [1e300, f64::INFINITY] {
            assert_eq!((nearest(far), nearest(-far)), (1_000_000_000, -1_000_000_000));
        }
    }

    #[test]
    fn numbers_that_are_not_finite_draw_nothing() {
        let mut mask = Mask::new(64, 8);
        let discs = [
            ProjectedDisc { x: 3.0, y: 3.0, radius: 2.0 },
            ProjectedDisc { x: f64::NAN, y: 3.0, radius: 2.0 },
        ];
        Rasterizer::new().fill_hull(&mut mask, discs.into_iter());
        assert!(mask.is_empty());
    }
}
