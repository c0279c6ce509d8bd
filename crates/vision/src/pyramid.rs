//! Pictures at several sizes.

/// A picture, and the same at a half and a quarter of its size: what moves far in the picture moves little
/// in the smallest (Burt & Adelson 1983; for motion Bouguet 2000).
///
/// Places are pixels of the picture itself, pixel centres at .5; beyond its edge it goes on as at the edge. Reused from
/// picture to picture.
#[derive(Clone, Debug, Default)]
pub struct Pyramid {
    levels: [Level; Pyramid::LEVELS],
}

#[derive(Clone, Debug, Default)]
struct Level {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

/// A picture at a place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PyramidSample {
    /// Its value, between pixel centres linear in both directions.
    pub value: f32,
    /// Its change to the right and down, by a pixel of the picture itself.
    pub gradient: [f32; 2],
}

impl Pyramid {
    /// Its pictures, the first among them.
    pub const LEVELS: usize = 3;

    /// Loads the picture whose rows of `width` values are `values`; a last row that is not full is left out.
    pub fn load(&mut self, width: usize, values: impl Iterator<Item = f32>) {
        let [base, ..] = &mut self.levels;
        base.values.clear();
        base.values.extend(values);
        base.width = width;
        base.height = base.values.len().checked_div(width).unwrap_or(0);
        for k in 1..Self::LEVELS {
            let (finer, coarser) = self.levels.split_at_mut(k);
            if let (Some(from), Some(to)) = (finer.last(), coarser.first_mut()) {
                from.halve_into(to);
            }
        }
    }

    /// The picture of `level` (0 is the picture itself) at a place; zeros without a picture or level.
    pub fn sample(&self, level: usize, at: [f32; 2]) -> PyramidSample {
        let Some(picture) = self.levels.get(level).filter(|l| !l.values.is_empty()) else {
            return PyramidSample::default();
        };
        let size = (1 << level) as f32;
        let sample = picture.sample(at.map(|v| v / size - 0.5));
        PyramidSample { gradient: sample.gradient.map(|v| v / size), ..sample }
    }
}

impl Level {
    /// The means of squares of two pixels; those at an odd edge stand for two.
    fn halve_into(&self, to: &mut Self) {
        (to.width, to.height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        to.values.clear();
        for y in 0..to.height {
            for x in 0..to.width {
                let (x0, x1) = (2 * x, (2 * x + 1).min(self.width - 1));
                let (y0, y1) = (2 * y * self.width, (2 * y + 1).min(self.height - 1) * self.width);
                let corners = [y0 + x0, y0 + x1, y1 + x0, y1 + x1];
                let sum: f32 = corners.into_iter().filter_map(|i| self.values.get(i)).sum();
                to.values.push(0.25 * sum);
            }
        }
    }

    /// At a place whose whole numbers are pixel centres.
    fn sample(&self, at: [f32; 2]) -> PyramidSample {
        let [x, y] = [(at[0], self.width), (at[1], self.height)].map(|(v, n)| v.clamp(0.0, (n - 1) as f32));
        let (left, top) = (x as usize, y as usize);
        let (fx, fy) = (x - left as f32, y - top as f32);
        let row = |k: isize| {
            let y = top.saturating_add_signed(k).min(self.height - 1) * self.width;
            let at = |k: isize| {
                let i = y + left.saturating_add_signed(k).min(self.width - 1);
                self.values.get(i).copied().unwrap_or(0.0)
            };
            // Half a pixel to either side: the gradient between neighbours, smoothed.
            let [a, b, c, d] = [at(-1), at(0), at(1), at(2)];
            let value = b + fx * (c - b);
            (value, 0.5 * ((1.0 - fx) * (c - a) + fx * (d - b)))
        };
        let [a, b, c, d] = [row(-1), row(0), row(1), row(2)];
        let mix = |b: f32, c: f32| b + fy * (c - b);
        let down = 0.5 * ((1.0 - fy) * (c.0 - a.0) + fy * (d.0 - b.0));
        PyramidSample { value: mix(b.0, c.0), gradient: [mix(b.1, c.1), down] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [37, 26];

    fn picture(x: f32, y: f32) -> f32 {
        100.0 + 30.0 * (0.21 * x + 0.4).sin() + 20.0 * (0.17 * y - 0.11 * x).cos()
    }

    fn loaded(value: impl Fn(usize, usize) -> f32) -> Pyramid {
        let mut pyramid = Pyramid::default();
        let [width, height] = SIZE;
        pyramid.load(width, (0..width * height).map(|i| value(i % width, i / width)));
        pyramid
    }

    #[test]
    fn pixels_of_a_level_are_means_of_squares_of_the_picture() {
        let value = |x: usize, y: usize| ((7 * x + 13 * y) % 31) as f32;
        let pyramid = loaded(value);
        for level in 0..Pyramid::LEVELS {
            let side = 1 << level;
            // Whole squares; what an odd edge stands for is told in `halve_into`.
            for (x, y) in (0..SIZE[1] / side).flat_map(|y| (0..SIZE[0] / side).map(move |x| (x, y))) {
                let cells = (0..side * side).map(|i| value(side * x + i % side, side * y + i / side));
                let mean = cells.sum::<f32>() / (side * side) as f32;
                let middle = [x, y].map(|v| (v as f32 + 0.5) * side as f32);
                let found = pyramid.sample(level, middle).value;
                assert!((found - mean).abs() < 1e-3, "{level} {x} {y}: {found} {mean}");
            }
        }
    }

    #[test]
    fn a_sample_is_the_plain_bilinear_one() {
        let value = |x: usize, y: usize| ((5 * x * x + 3 * y) % 23) as f32;
        let pyramid = loaded(value);
        for i in 0..400 {
            let at = [0.5 + 0.09 * i as f32, 0.5 + (0.37 * i as f32) % 25.0];
            let (mut value_there, mut weights) = (0.0, 0.0);
            for (x, y) in (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (x, y))) {
                let near = |v: f32, c: usize| (1.0 - (v - c as f32 - 0.5).abs()).max(0.0);
                let weight = near(at[0], x) * near(at[1], y);
                (value_there, weights) = (value_there + weight * value(x, y), weights + weight);
            }
            let found = pyramid.sample(0, at).value;
            assert!(weights > 0.99 && (found - value_there).abs() < 1e-2, "{at:?} {found} {value_there}");
        }
    }

    #[test]
    fn slopes_are_those_of_the_picture_at_every_level() {
        let pyramid = loaded(|x, y| picture(x as f32 + 0.5, y as f32 + 0.5));
        for level in 0..3 {
            for (x, y) in [(12.3, 11.8), (20.0, 14.5), (24.9, 12.1)] {
                let gradient = |a: f32, b: f32| (a - b) / 0.2;
                let expected = [
                    gradient(picture(x + 0.1, y), picture(x - 0.1, y)),
                    gradient(picture(x, y + 0.1), picture(x, y - 0.1)),
                ];
                let found = pyramid.sample(level, [x, y]).gradient;
                for (a, b) in found.iter().zip(expected) {
                    assert!((a - b).abs() < 0.25 + 0.5 * level as f32, "{level} {x} {y}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn beyond_the_edge_it_goes_on_and_without_a_picture_it_is_zero() {
        let mut pyramid = loaded(|x, _| x as f32);
        assert_eq!(pyramid.sample(0, [-5.0, 3.0]).value, 0.0);
        assert_eq!(pyramid.sample(0, [1e9, 1e9]).value, 36.0);
        assert_eq!(pyramid.sample(Pyramid::LEVELS, [3.0, 3.0]), PyramidSample::default());
        pyramid.load(0, std::iter::empty());
        assert_eq!(pyramid.sample(0, [3.0, 3.0]), PyramidSample::default());
    }
}
