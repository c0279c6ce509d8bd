//! Operators that read each number once or a few times. They are loops the compiler turns into SIMD.

use pulp::Arch;

use super::{Picture, Window};

/// `output = clamp(a + b)`.
pub(crate) fn add(arch: Arch, a: &[f32], b: &[f32], (low, high): (f32, f32), output: &mut [f32]) {
    arch.dispatch(
        #[inline(always)]
        || {
            for ((out, a), b) in output.iter_mut().zip(a).zip(b) {
                *out = (a + b).max(low).min(high);
            }
        },
    );
}

/// Negative numbers times the slope of their channel.
pub(crate) fn prelu(arch: Arch, input: &[f32], slopes: &[f32], output: &mut [f32]) {
    arch.dispatch(
        #[inline(always)]
        || {
            let rows = input.chunks_exact(slopes.len()).zip(output.chunks_exact_mut(slopes.len()));
            for (input, output) in rows {
                for ((out, x), slope) in output.iter_mut().zip(input).zip(slopes) {
                    *out = x.max(0.0) + x.min(0.0) * slope;
                }
            }
        },
    );
}

/// 1 / (1 + exp(-x)).
pub(crate) fn logistic(input: &[f32], output: &mut [f32]) {
    for (out, x) in output.iter_mut().zip(input) {
        *out = 1.0 / (1.0 + (-x).exp());
    }
}

/// The largest number of each channel in each window, limited to a range.
pub(crate) fn max_pool(
    arch: Arch,
    from: (Picture, &[f32]),
    window: &Window,
    (low, high): (f32, f32),
    to: (Picture, &mut [f32]),
) {
    let ((from, input), (to, output)) = (from, to);
    let channels = from.channels;
    arch.dispatch(
        #[inline(always)]
        || {
            for (row, line) in output.chunks_exact_mut(to.row()).enumerate() {
                for (column, out) in line.chunks_exact_mut(channels).enumerate() {
                    out.fill(low);
                    for y in samples(row, window, 0, from.rows) {
                        for x in samples(column, window, 1, from.columns) {
                            let input = &input[(y * from.columns + x) * channels..][..channels];
                            for (out, x) in out.iter_mut().zip(input) {
                                *out = out.max(*x);
                            }
                        }
                    }
                    for out in out {
                        *out = out.min(high);
                    }
                }
            }
        },
    );
}

/// The samples of window `position` along one axis that are in the picture.
pub(crate) fn samples(
    position: usize,
    window: &Window,
    axis: usize,
    size: usize,
) -> impl Iterator<Item = usize> + use<> {
    let (stride, dilation, before) = (window.stride[axis], window.dilation[axis], window.before[axis]);
    (0..window.kernel[axis])
        .map(move |k| position * stride + k * dilation)
        .filter(move |at| (before..before + size).contains(at))
        .map(move |at| at - before)
}

/// The mean of each channel.
pub(crate) fn mean(arch: Arch, input: &[f32], output: &mut [f32]) {
    let channels = output.len();
    let share = channels as f32 / input.len() as f32;
    arch.dispatch(
        #[inline(always)]
        || {
            output.fill(0.0);
            for pixel in input.chunks_exact(channels) {
                for (out, x) in output.iter_mut().zip(pixel) {
                    *out += x;
                }
            }
            for out in output {
                *out *= share;
            }
        },
    );
}

/// Zeros around a tensor of four dimensions: sizes, and how many before each.
pub(crate) fn pad(
    input: &[f32],
    shape: [usize; 4],
    before: [usize; 4],
    output: &mut [f32],
    padded: [usize; 4],
) {
    output.fill(0.0);
    let [_, rows, columns, channels] = shape;
    for (line, input) in input.chunks_exact(channels).enumerate() {
        let at = [line / columns / rows, line / columns % rows, line % columns];
        let to = (0..3).fold(0, |to, axis| to * padded[axis] + at[axis] + before[axis]);
        output[to * padded[3] + before[3]..][..channels].copy_from_slice(input);
    }
}

/// Puts `input`, runs of `part` numbers, into runs of `whole` numbers from `first` on.
pub(crate) fn concatenate(input: &[f32], part: usize, output: &mut [f32], whole: usize, first: usize) {
    for (input, output) in input.chunks_exact(part).zip(output.chunks_exact_mut(whole)) {
        output[first..first + part].copy_from_slice(input);
    }
}

/// Linear interpolation between the centres of pixels along both axes.
#[derive(Clone, Debug)]
pub(crate) struct Resize {
    from: Picture,
    to: Picture,
    rows: Vec<(usize, usize, f32)>,
    columns: Vec<(usize, usize, f32)>,
}

impl Resize {
    pub fn new(from: Picture, to: Picture) -> Self {
        Self { from, to, rows: taps(from.rows, to.rows), columns: taps(from.columns, to.columns) }
    }

    pub fn run(&self, arch: Arch, input: &[f32], output: &mut [f32]) {
        let Picture { columns, channels, .. } = self.from;
        let pixel = |y: usize, x: usize| &input[(y * columns + x) * channels..][..channels];
        arch.dispatch(
            #[inline(always)]
            || {
                for (line, &(top, bottom, down)) in output.chunks_exact_mut(self.to.row()).zip(&self.rows) {
                    for (out, &(left, right, over)) in line.chunks_exact_mut(channels).zip(&self.columns) {
                        let upper = pixel(top, left).iter().zip(pixel(top, right));
                        let lower = pixel(bottom, left).iter().zip(pixel(bottom, right));
                        for ((out, (a, b)), (c, d)) in out.iter_mut().zip(upper).zip(lower) {
                            let upper = a + (b - a) * over;
                            let lower = c + (d - c) * over;
                            *out = upper + (lower - upper) * down;
                        }
                    }
                }
            },
        );
    }
}

/// For each output the two inputs it lies between and the share of the second.
fn taps(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let scale = from as f32 / to as f32;
    (0..to)
        .map(|i| {
            let centre = (i as f32 + 0.5) * scale - 0.5;
            let low = centre.floor();
            let clamp = |v: f32| v.clamp(0.0, (from - 1) as f32) as usize;
            (clamp(low), clamp(low + 1.0), centre - low)
        })
        .collect()
}
