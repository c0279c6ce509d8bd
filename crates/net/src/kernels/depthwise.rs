//! Convolution of each channel by itself.

use pulp::{Arch, Simd, WithSimd};

use super::{Finish, load, store};

/// Rows, columns, channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Picture {
    pub rows: usize,
    pub columns: usize,
    pub channels: usize,
}

impl Picture {
    pub fn len(&self) -> usize {
        self.rows * self.columns * self.channels
    }

    /// Numbers of one row.
    pub fn row(&self) -> usize {
        self.columns * self.channels
    }
}

/// A window of weights for each channel, packed for registers: blocks of channels, in a block the registers of the
/// window's samples in turn.
#[derive(Clone, Debug)]
pub(crate) struct Depthwise {
    pub input: Picture,
    pub output: Picture,
    kernel: [usize; 2],
    stride: [usize; 2],
    dilation: [usize; 2],
    before: [usize; 2],
    lanes: usize,
    weights: Vec<f32>,
    bias: Vec<f32>,
    finish: Finish,
}

/// How a window moves; sizes are rows, columns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    pub kernel: [usize; 2],
    pub stride: [usize; 2],
    pub dilation: [usize; 2],
    /// Rows and columns of border before the picture.
    pub before: [usize; 2],
}

impl Depthwise {
    /// `weights` are window row, window column, channel.
    pub fn new(
        arch: Arch,
        input: Picture,
        output: Picture,
        window: Window,
        weights: &[f32],
        bias: &[f32],
        finish: Finish,
    ) -> Self {
        let lanes = super::lanes(arch);
        let channels = input.channels;
        let padded = channels.next_multiple_of(lanes);
        let mut packed = Vec::with_capacity(weights.len() / channels * padded);
        for block in (0..padded).step_by(lanes) {
            let first = start(block, channels, lanes);
            for tap in weights.chunks_exact(channels) {
                packed.extend((first..first + lanes).map(|c| tap.get(c).copied().unwrap_or(0.0)));
            }
        }
        let mut bias = bias.to_vec();
        bias.resize(padded, 0.0);
        let Window { kernel, stride, dilation, before } = window;
        let finish = finish.padded(padded);
        Self { input, output, kernel, stride, dilation, before, lanes, weights: packed, bias, finish }
    }

    /// Output row `row`; input row `i` is row `i % ring` of `input`, so that a producer may keep only those in use.
    pub fn run_row(&self, arch: Arch, input: &[f32], ring: usize, row: usize, output: &mut [f32]) {
        arch.dispatch(Row { depthwise: self, input, ring, row, output });
    }

    /// Input rows that output row `row` needs.
    pub fn needs(&self, row: usize) -> std::ops::Range<usize> {
        let first = (row * self.stride[0]) as isize - self.before[0] as isize;
        let last = first + ((self.kernel[0] - 1) * self.dilation[0]) as isize;
        let limit = |v: isize| v.clamp(0, self.input.rows as isize) as usize;
        limit(first)..limit(last + 1)
    }

    /// Rows from the first to the last sample of a window.
    pub fn span(&self) -> usize {
        (self.kernel[0] - 1) * self.dilation[0] + 1
    }
}

/// Where the register of a block of channels starts: the last one overlaps the one before instead of ending in nothing.
#[inline(always)]
fn start(block: usize, channels: usize, lanes: usize) -> usize {
    block.min(channels.saturating_sub(lanes))
}

struct Row<'a> {
    depthwise: &'a Depthwise,
    input: &'a [f32],
    ring: usize,
    row: usize,
    output: &'a mut [f32],
}

impl WithSimd for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let d = self.depthwise;
        debug_assert_eq!(d.lanes, S::F32_LANES);
        let size = d.kernel[0] * d.kernel[1] * S::F32_LANES;
        let channels = d.input.channels;
        for block in (0..channels).step_by(S::F32_LANES) {
            let weights = S::as_simd_f32s(&d.weights[block / S::F32_LANES * size..][..size]).0;
            let channel = start(block, channels, S::F32_LANES);
            match (d.kernel[1], d.stride[1], d.dilation[1]) {
                _ if channels < S::F32_LANES => self.any::<S>(simd, channel, weights),
                (3, 1, 1) => self.dense::<S, 3, 8, 6, 4, 3>(simd, channel, weights),
                (5, 1, 1) => self.dense::<S, 5, 10, 8, 6, 5>(simd, channel, weights),
                (3, 2, 1) => self.strided::<S, 3, 9, 5, 3>(simd, channel, weights),
                (5, 2, 1) => self.strided::<S, 5, 11, 7, 5>(simd, channel, weights),
                _ => self.any::<S>(simd, channel, weights),
            }
        }
    }
}

impl Row<'_> {
    /// All columns of windows at every pixel, for one register of channels. Several at a time: each input is loaded once
    /// for all windows over it. `P` … `P1` are
    /// the columns under 6, 4, 2 and 1 windows of `K` columns.
    #[inline(always)]
    fn dense<S: Simd, const K: usize, const P: usize, const P4: usize, const P2: usize, const P1: usize>(
        &mut self,
        simd: S,
        channel: usize,
        weights: &[S::f32s],
    ) {
        let columns = self.depthwise.output.columns;
        let mut column = 0;
        while column < columns {
            column += match columns - column {
                6.. => self.tile::<S, K, 1, 6, P>(simd, channel, weights, column),
                4.. => self.tile::<S, K, 1, 4, P4>(simd, channel, weights, column),
                2.. => self.tile::<S, K, 1, 2, P2>(simd, channel, weights, column),
                _ => self.tile::<S, K, 1, 1, P1>(simd, channel, weights, column),
            };
        }
    }

    /// The same for windows at every second pixel.
    #[inline(always)]
    fn strided<S: Simd, const K: usize, const P4: usize, const P2: usize, const P1: usize>(
        &mut self,
        simd: S,
        channel: usize,
        weights: &[S::f32s],
    ) {
        let columns = self.depthwise.output.columns;
        let mut column = 0;
        while column < columns {
            column += match columns - column {
                4.. => self.tile::<S, K, 2, 4, P4>(simd, channel, weights, column),
                2.. => self.tile::<S, K, 2, 2, P2>(simd, channel, weights, column),
                _ => self.tile::<S, K, 2, 1, P1>(simd, channel, weights, column),
            };
        }
    }

    /// `T` windows of `K` columns next to each other, over `P` columns of input. Returns `T`.
    #[inline(always)]
    fn tile<S: Simd, const K: usize, const STRIDE: usize, const T: usize, const P: usize>(
        &mut self,
        simd: S,
        channel: usize,
        weights: &[S::f32s],
        column: usize,
    ) -> usize {
        const { assert!(P == (T - 1) * STRIDE + K) };
        let d = self.depthwise;
        let Picture { columns, channels, .. } = d.input;
        let mut sums = [load::<S>(&d.bias, channel); T];
        let (taps, _) = weights.as_chunks::<K>();
        let top = (self.row * d.stride[0]) as isize - d.before[0] as isize;
        let left = (column * STRIDE) as isize - d.before[1] as isize;
        let inside = left >= 0 && left as usize + P <= columns;
        for (i, &taps) in taps.iter().enumerate() {
            let row = top + (i * d.dilation[0]) as isize;
            if row < 0 || row >= d.input.rows as isize {
                continue;
            }
            let line = &self.input[row as usize % self.ring * columns * channels..][..columns * channels];
            let values: [S::f32s; P] = if inside {
                let line = &line[left as usize * channels..][..P * channels];
                std::array::from_fn(|p| load::<S>(line, p * channels + channel))
            } else {
                std::array::from_fn(|p| match left + p as isize {
                    x if x >= 0 && x < columns as isize => load::<S>(line, x as usize * channels + channel),
                    _ => simd.splat_f32s(0.0),
                })
            };
            for (t, sum) in sums.iter_mut().enumerate() {
                for (j, &tap) in taps.iter().enumerate() {
                    *sum = simd.mul_add_e_f32s(values[t * STRIDE + j], tap, *sum);
                }
            }
        }
        for (t, sum) in sums.into_iter().enumerate() {
            let [value] = d.finish.apply(simd, [sum], channel);
            store::<S>(self.output, (column + t) * channels + channel, value);
        }
        T
    }

    /// Any window, and channels that do not fill a register.
    #[inline(always)]
    fn any<S: Simd>(&mut self, simd: S, channel: usize, weights: &[S::f32s]) {
        let d = self.depthwise;
        let Picture { columns, channels, .. } = d.input;
        let width = S::F32_LANES.min(channels - channel);
        let top = (self.row * d.stride[0]) as isize - d.before[0] as isize;
        for column in 0..d.output.columns {
            let left = (column * d.stride[1]) as isize - d.before[1] as isize;
            let mut sum = load::<S>(&d.bias, channel);
            for (i, taps) in weights.chunks_exact(d.kernel[1]).enumerate() {
                let row = top + (i * d.dilation[0]) as isize;
                if row < 0 || row >= d.input.rows as isize {
                    continue;
                }
                let line = &self.input[row as usize % self.ring * columns * channels..][..columns * channels];
                for (j, &tap) in taps.iter().enumerate() {
                    let x = left + (j * d.dilation[1]) as isize;
                    if x >= 0 && x < columns as isize {
                        let value = simd.partial_load_f32s(&line[x as usize * channels + channel..][..width]);
                        sum = simd.mul_add_e_f32s(value, tap, sum);
                    }
                }
            }
            let done = d.finish.apply(simd, [sum], channel)[0];
            simd.partial_store_f32s(&mut self.output[column * channels + channel..][..width], done);
        }
    }
}
