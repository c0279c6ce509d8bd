//! Pictures scaled by area averaging.

use std::ops::Range;

use image::{GrayImage, ImageBuffer, Pixel, RgbImage};

/// The size with the same shape whose longer side is at most `max_side`; never larger than given.
pub fn fit_within(width: u32, height: u32, max_side: Option<u32>) -> (u32, u32) {
    let longer = width.max(height);
    match max_side {
        Some(side) if side > 0 && longer > side => {
            let scaled =
                |v: u32| ((f64::from(v) * f64::from(side) / f64::from(longer)).round() as u32).max(1);
            (scaled(width), scaled(height))
        }
        _ => (width, height),
    }
}

const WEIGHT_BITS: u32 = 14;

/// One output sample: the first input sample it takes and where its weights are.
#[derive(Clone, Copy, Debug)]
struct Taps {
    first: usize,
    weights: usize,
    count: usize,
}

/// Weights along one axis; each set adds up to `1 << WEIGHT_BITS` exactly.
#[derive(Clone, Debug)]
struct Axis {
    taps: Vec<Taps>,
    weights: Vec<u16>,
    identity: bool,
    /// How far apart the first input samples of the first outputs are, and how many outputs these are: all have as
    /// many taps and the same weights.
    stride: usize,
    alike: usize,
    doubled: Option<Doubled>,
    few: Option<Vec<FewTaps>>,
}

/// Most input samples of an output that is made of few.
const FEW: usize = 4;

/// As [`Taps`], of few input samples: those that are missing count nothing.
#[derive(Clone, Copy, Debug)]
struct FewTaps {
    first: u32,
    weights: [u16; FEW],
}

/// Outputs of a picture that becomes twice as large: every second one is made alike, one input sample further on.
#[derive(Clone, Debug)]
struct Doubled {
    /// The outputs.
    outputs: Range<usize>,
    /// Of the first two, the first of two input samples and their weights.
    first: [(usize, [u16; 2]); 2],
}

impl Axis {
    /// Output sample `i` covers `[i, i + 1) * step + offset` of the input: box-filtered when `step` is at
    /// least 1, else interpolated at its centre.
    fn new(input: usize, output: usize, step: f64, offset: f64) -> Self {
        let mut axis = Self {
            taps: Vec::with_capacity(output),
            weights: Vec::new(),
            identity: true,
            stride: 0,
            alike: 0,
            doubled: None,
            few: None,
        };
        let last = (input as isize - 1).max(0);
        let mut share: Vec<f64> = Vec::new();
        for i in 0..output {
            let (low, high) = if step >= 1.0 {
                (i as f64 * step + offset, (i + 1) as f64 * step + offset)
            } else {
                // A window one sample wide round the centre overlaps two samples in just the proportions
                // of linear interpolation.
                let centre = (i as f64 + 0.5) * step + offset;
                (centre - 0.5, centre + 0.5)
            };
            let clamp = |k: isize| k.clamp(0, last) as usize;
            let from = low.floor() as isize;
            let to = (high - 1e-9).floor() as isize;
            let first = clamp(from);
            share.clear();
            share.resize(clamp(to) - first + 1, 0.0);
            for k in from..=to {
                let overlap = (high.min((k + 1) as f64) - low.max(k as f64)).max(0.0);
                // The border is repeated outside the image.
                share[clamp(k) - first] += overlap / (high - low);
            }
            let start = push_weights(&mut axis.weights, &share);
            let count = share.len();
            axis.identity &= first == i && count == 1;
            axis.taps.push(Taps { first, weights: start, count });
        }
        axis.identity &= input == output;
        axis.stride = axis.taps.get(1).map_or(0, |second| second.first);
        axis.alike = (0..output).take_while(|&i| axis.is_alike(i)).count();
        axis.doubled = if step == 0.5 { axis.doubled(input) } else { None };
        axis.few = axis.taps.iter().map(|taps| axis.few(taps)).collect();
        axis
    }

    /// Taps that are few; `None` if they are not.
    fn few(&self, taps: &Taps) -> Option<FewTaps> {
        let mut weights = [0; FEW];
        weights.get_mut(..taps.count)?.copy_from_slice(self.weights(taps));
        Some(FewTaps { first: u32::try_from(taps.first).ok()?, weights })
    }

    /// The outputs between those of the border, where the picture becomes twice as large.
    fn doubled(&self, input: usize) -> Option<Doubled> {
        // Two samples, of which the second may count nothing.
        let pair = |i: usize| {
            let taps = self.taps.get(i)?;
            let weights = match *self.weights(taps) {
                [a] => [a, 0],
                [a, b] => [a, b],
                _ => return None,
            };
            (taps.first + 1 < input).then_some((taps.first, weights))
        };
        let begin = 2;
        let first = [pair(begin)?, pair(begin + 1)?];
        let alike = |i: usize| {
            let (at, weights) = first[(i - begin) % 2];
            pair(i) == Some((at + (i - begin) / 2, weights))
        };
        let count = (begin..self.taps.len()).take_while(|&i| alike(i)).count() / 2 * 2;
        Some(Doubled { outputs: begin..begin + count, first })
    }

    /// The weights of some taps.
    fn weights(&self, taps: &Taps) -> &[u16] {
        &self.weights[taps.weights..taps.weights + taps.count]
    }

    /// Whether output `i` is made like the first, `stride` input samples for each output further on.
    fn is_alike(&self, i: usize) -> bool {
        let (taps, first) = (&self.taps[i], &self.taps[0]);
        taps.first == i * self.stride && self.weights(taps) == self.weights(first)
    }
}

/// Appends `share` in fixed point, the rounding error going to the largest weight.
fn push_weights(weights: &mut Vec<u16>, share: &[f64]) -> usize {
    let start = weights.len();
    let one = 1u16 << WEIGHT_BITS;
    weights.extend(share.iter().map(|s| (s * f64::from(one)).round() as u16));
    let added = &mut weights[start..];
    let sum: u16 = added.iter().sum();
    if let Some(largest) = added.iter_mut().max() {
        *largest = (*largest + one).saturating_sub(sum);
    }
    start
}

/// Scales 8-bit pictures of one fixed size to another by area averaging (bilinear when enlarging).
#[derive(Clone, Debug)]
pub struct Resampler {
    input: (usize, usize),
    channels: usize,
    x: Axis,
    y: Axis,
    sums: Vec<u32>,
    row: Vec<u16>,
}

impl Resampler {
    /// From `input` to `output` pixels, `channels` interleaved samples each.
    pub fn new(input: (u32, u32), output: (u32, u32), channels: usize) -> Self {
        let step = (
            f64::from(input.0) / f64::from(output.0.max(1)),
            f64::from(input.1) / f64::from(output.1.max(1)),
        );
        Self::with_steps(input, output, channels, step, (0.0, 0.0))
    }

    /// As [`Resampler::new`], for planes whose sampling grid is shifted or does not end with the picture.
    pub fn with_steps(
        input: (u32, u32),
        output: (u32, u32),
        channels: usize,
        step: (f64, f64),
        offset: (f64, f64),
    ) -> Self {
        let input = (input.0 as usize, input.1 as usize);
        Self {
            input,
            channels,
            x: Axis::new(input.0, output.0 as usize, step.0, offset.0),
            y: Axis::new(input.1, output.1 as usize, step.1, offset.1),
            sums: Vec::new(),
            row: Vec::new(),
        }
    }

    /// Whether output and input are the same sample for sample.
    pub fn is_identity(&self) -> bool {
        self.x.identity && self.y.identity
    }

    /// Scales `input` into `output`; both are tightly packed and of the sizes given to `new`.
    pub fn run(&mut self, input: &[u8], output: &mut [u8]) {
        let channels = self.channels;
        let stride = self.input.0 * channels;
        if input.len() < stride * self.input.1 || stride == 0 {
            return;
        }
        if self.is_identity() {
            let length = output.len().min(input.len());
            output[..length].copy_from_slice(&input[..length]);
            return;
        }
        let out_stride = self.x.taps.len() * channels;
        if out_stride == 0 {
            return;
        }
        // What is missing of few samples beyond the last one counts nothing.
        self.row.resize(stride + FEW, 0);
        for (taps, out) in self.y.taps.iter().zip(output.chunks_exact_mut(out_stride)) {
            // Rows first: whole rows are summed by vector instructions, and the columns then see fewer rows.
            let lines = &input[taps.first * stride..(taps.first + taps.count) * stride];
            rows(self.y.weights(taps), lines, &mut self.sums, &mut self.row[..stride]);
            if channels == 1 {
                if let Some(doubled) = &self.x.doubled {
                    let Range { start, end } = doubled.outputs;
                    doubled_columns(doubled, &self.row, &mut out[start..end]);
                    columns::<1>(&self.x, 0..start, &self.row, out);
                    columns::<1>(&self.x, end..out.len(), &self.row, out);
                } else {
                    let alike = even_columns(&self.x, &self.row, out);
                    match &self.x.few {
                        Some(few) => few_columns(&few[alike..], &self.row, &mut out[alike..]),
                        None => columns::<1>(&self.x, alike..out.len(), &self.row, out),
                    }
                }
            } else {
                columns::<3>(&self.x, 0..self.x.taps.len(), &self.row, out);
            }
        }
    }
}

/// The weighted sum of the rows in `lines` in 8.8 fixed point.
fn rows(weights: &[u16], lines: &[u8], sums: &mut Vec<u32>, row: &mut [u16]) {
    const ROUND: u32 = 1 << (WEIGHT_BITS - 9);
    let stride = row.len();
    match *weights {
        [_] => {
            for (value, &sample) in row.iter_mut().zip(lines) {
                *value = u16::from(sample) << 8;
            }
        }
        [a, b] => {
            let (first, second) = lines.split_at(stride);
            for ((value, &s), &t) in row.iter_mut().zip(first).zip(second) {
                let sum = ROUND + u32::from(s) * u32::from(a) + u32::from(t) * u32::from(b);
                *value = (sum >> (WEIGHT_BITS - 8)) as u16;
            }
        }
        _ => {
            sums.clear();
            sums.resize(stride, ROUND);
            for (line, &weight) in lines.chunks_exact(stride).zip(weights) {
                for (sum, &sample) in sums.iter_mut().zip(line) {
                    *sum += u32::from(sample) * u32::from(weight);
                }
            }
            for (value, &sum) in row.iter_mut().zip(&*sums) {
                *value = (sum >> (WEIGHT_BITS - 8)) as u16;
            }
        }
    }
}

const HALF: u32 = 1 << (WEIGHT_BITS + 7);

/// A sample from its weighted sum.
fn rounded(sum: u32) -> u8 {
    (sum >> (WEIGHT_BITS + 8)).min(255) as u8
}

/// As [`columns`] for the outputs of one channel that are made alike, if they are made in one of the usual ways: the
/// picture a half or a third as wide, or shifted by part of a sample. Gives how many there were.
fn even_columns(axis: &Axis, row: &[u16], out: &mut [u8]) -> usize {
    let Some(first) = axis.taps.first() else { return 0 };
    let out = &mut out[..axis.alike];
    match *axis.weights(first) {
        [a, b] if axis.stride == 1 => {
            for ((pixel, &s), &t) in out.iter_mut().zip(row).zip(&row[1..]) {
                *pixel = rounded(HALF + u32::from(s) * u32::from(a) + u32::from(t) * u32::from(b));
            }
        }
        [a, b] if axis.stride == 2 => {
            for (pixel, &[s, t]) in out.iter_mut().zip(row.as_chunks().0) {
                *pixel = rounded(HALF + u32::from(s) * u32::from(a) + u32::from(t) * u32::from(b));
            }
        }
        [a, b, c] if axis.stride == 3 => {
            for (pixel, &[s, t, u]) in out.iter_mut().zip(row.as_chunks().0) {
                let sum = u32::from(s) * u32::from(a) + u32::from(t) * u32::from(b);
                *pixel = rounded(HALF + sum + u32::from(u) * u32::from(c));
            }
        }
        _ => return 0,
    }
    axis.alike
}

/// As [`columns`] for the outputs of one channel between the borders of a picture that becomes twice as large.
fn doubled_columns(doubled: &Doubled, row: &[u16], out: &mut [u8]) {
    let [(even, [a, b]), (odd, [c, d])] = doubled.first;
    let weigh = |s: u16, a: u16, t: u16, b: u16| {
        rounded(HALF + u32::from(s) * u32::from(a) + u32::from(t) * u32::from(b))
    };
    let (even, odd) = (&row[even..], &row[odd..]);
    let samples = even.iter().zip(&even[1..]).zip(odd.iter().zip(&odd[1..]));
    for ([first, second], ((&s, &t), (&u, &v))) in out.as_chunks_mut().0.iter_mut().zip(samples) {
        *first = weigh(s, a, t, b);
        *second = weigh(u, c, v, d);
    }
}

/// As [`columns`] for outputs of one channel that are made of few samples.
fn few_columns(few: &[FewTaps], row: &[u16], out: &mut [u8]) {
    for (pixel, taps) in out.iter_mut().zip(few) {
        let Some(samples) = row.get(taps.first as usize..).and_then(|s| s.first_chunk::<FEW>()) else {
            return;
        };
        let sum = (0..FEW).map(|k| u32::from(samples[k]) * u32::from(taps.weights[k])).sum::<u32>();
        *pixel = rounded(HALF + sum);
    }
}

/// These outputs of a row of samples in 8.8 fixed point.
fn columns<const CHANNELS: usize>(axis: &Axis, outputs: Range<usize>, row: &[u16], out: &mut [u8]) {
    let pixels = axis.taps.iter().zip(out.chunks_exact_mut(CHANNELS));
    for (taps, pixel) in pixels.skip(outputs.start).take(outputs.len()) {
        let samples = &row[taps.first * CHANNELS..(taps.first + taps.count) * CHANNELS];
        let mut sums = [HALF; CHANNELS];
        for (sample, &weight) in samples.chunks_exact(CHANNELS).zip(axis.weights(taps)) {
            for c in 0..CHANNELS {
                sums[c] += u32::from(sample[c]) * u32::from(weight);
            }
        }
        for c in 0..CHANNELS {
            pixel[c] = rounded(sums[c]);
        }
    }
}

/// Shrinks pictures, by area averaging, so that their longer side has at most a given number of pixels.
///
/// Pictures that are small enough are handed back as they are.
#[derive(Clone, Debug, Default)]
pub struct Shrinker {
    max_side: Option<u32>,
    resampler: Option<Resampler>,
}

impl Shrinker {
    /// For pictures whose longer side is to have at most `max_side` pixels; `None` keeps them as they are.
    pub fn new(max_side: Option<u32>) -> Self {
        Self { max_side, resampler: None }
    }

    /// The most pixels of the longer side.
    pub fn max_side(&self) -> Option<u32> {
        self.max_side
    }

    /// Lowers the most pixels of the longer side to `side`; a limit that is lower already stays.
    pub fn limit(&mut self, side: u32) {
        let side = self.max_side.map_or(side, |own| own.min(side));
        *self = Self::new(Some(side));
    }

    /// A picture in colour.
    pub fn rgb(&mut self, image: RgbImage) -> RgbImage {
        self.shrink(image)
    }

    /// A picture in shades of grey: what [`Shrinker::rgb`] gives where red, green and blue are alike.
    pub fn gray(&mut self, image: GrayImage) -> GrayImage {
        self.shrink(image)
    }

    fn shrink<P: Pixel<Subpixel = u8>>(&mut self, image: ImageBuffer<P, Vec<u8>>) -> ImageBuffer<P, Vec<u8>> {
        let (size, channels) = (image.dimensions(), usize::from(P::CHANNEL_COUNT));
        let target = fit_within(size.0, size.1, self.max_side);
        if target == size {
            return image;
        }
        let input = (size.0 as usize, size.1 as usize);
        let fresh = || Resampler::new(size, target, channels);
        let resampler = self.resampler.get_or_insert_with(fresh);
        if (resampler.input, resampler.channels) != (input, channels) {
            *resampler = fresh();
        }
        let mut out = ImageBuffer::new(target.0, target.1);
        resampler.run(image.as_raw(), &mut out);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Area averaging straight from its definition.
    fn slow(input: &[u8], size: (u32, u32), target: (u32, u32)) -> Vec<f64> {
        let step = (f64::from(size.0) / f64::from(target.0), f64::from(size.1) / f64::from(target.1));
        let overlap = |low: f64, k: u32, step: f64| {
            ((low + step).min(f64::from(k) + 1.0) - low.max(f64::from(k))).max(0.0) / step
        };
        let mut out = Vec::new();
        for y in 0..target.1 {
            for x in 0..target.0 {
                let mut sum = 0.0;
                for v in 0..size.1 {
                    let wy = overlap(f64::from(y) * step.1, v, step.1);
                    if wy > 0.0 {
                        for u in 0..size.0 {
                            let wx = overlap(f64::from(x) * step.0, u, step.0);
                            sum += wx * wy * f64::from(input[(v * size.0 + u) as usize]);
                        }
                    }
                }
                out.push(sum);
            }
        }
        out
    }

    proptest! {
        #[test]
        fn shrinking_is_area_averaging(
            w in 1u32..40, h in 1u32..30, fx in 0.1f64..1.0, fy in 0.1f64..1.0, seed in any::<u64>()
        ) {
            let target = ((f64::from(w) * fx).ceil() as u32, (f64::from(h) * fy).ceil() as u32);
            let mut state = seed;
            let input: Vec<u8> = (0..w * h).map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8
            }).collect();
            let mut out = vec![0; (target.0 * target.1) as usize];
            Resampler::new((w, h), target, 1).run(&input, &mut out);
            for (got, want) in out.iter().zip(slow(&input, (w, h), target)) {
                prop_assert!((f64::from(*got) - want).abs() < 0.6, "{got} {want}");
            }
        }
    }

    /// Halves, thirds, doubles and shifts have loops of their own, which must give what the general one gives.
    #[test]
    fn outputs_that_are_made_alike_are_made_like_others() {
        let widths = [
            (64, 32, 2.0, 0.0),
            (65, 32, 2.0, 0.0),
            (96, 32, 3.0, 0.0),
            (48, 48, 1.0, 0.25),
            (90, 31, 2.0, 0.0),
            (20, 47, 0.4, 0.0),
            (32, 64, 0.5, 0.0),
            (32, 64, 0.5, 0.25),
            (33, 65, 0.5, 0.25),
            (96, 64, 1.5, 0.0),
            (97, 64, 97.0 / 64.0, 0.0),
            (330, 64, 330.0 / 64.0, 0.0),
        ];
        let (mut ways, mut twice, mut fews) = (0, 0, 0);
        for (input, output, step, offset) in widths {
            let axis = Axis::new(input, output, step, offset);
            let sample = |i: usize| if i < input { (i * 7919 + i * i * 613) as u16 & 0xff00 } else { 0 };
            let row: Vec<u16> = (0..input + FEW).map(sample).collect();
            let (mut fast, mut slow) = (vec![0; output], vec![0; output]);
            let done = even_columns(&axis, &row, &mut fast);
            columns::<1>(&axis, 0..output, &row, &mut slow);
            assert_eq!(fast[..done], slow[..done], "{input} to {output}");
            ways += usize::from(done > 0);
            if let Some(few) = &axis.few {
                few_columns(few, &row, &mut fast);
                assert_eq!(fast, slow, "{input} to {output}");
                fews += 1;
            }
            if let Some(doubled) = &axis.doubled {
                let Range { start, end } = doubled.outputs.clone();
                doubled_columns(doubled, &row, &mut fast[start..end]);
                assert_eq!(fast[start..end], slow[start..end], "{input} to {output}");
                assert!(start == 2 && end + 3 >= output, "{start} to {end} of {output}");
                twice += 1;
            }
        }
        assert!(ways >= 4 && twice == 3 && fews == widths.len() - 1, "{fews}");
    }

    #[test]
    fn grey_pictures_shrink_like_grey_pictures_in_colour() {
        let value = |x: u32, y: u32| ((x * 37 + y * y * 11) % 256) as u8;
        for size in [(64, 40), (90, 31), (33, 77), (20, 20)] {
            let gray = GrayImage::from_fn(size.0, size.1, |x, y| image::Luma([value(x, y)]));
            let rgb = RgbImage::from_fn(size.0, size.1, |x, y| image::Rgb([value(x, y); 3]));
            let mut shrinker = Shrinker::new(None);
            assert_eq!(shrinker.gray(gray.clone()), gray);
            shrinker.limit(32);
            shrinker.limit(50);
            assert_eq!(shrinker.max_side(), Some(32));
            let (gray, rgb) = (shrinker.gray(gray), shrinker.rgb(rgb));
            assert_eq!(gray.dimensions(), fit_within(size.0, size.1, Some(32)));
            assert!(gray.pixels().zip(rgb.pixels()).all(|(g, c)| c.0 == [g.0[0]; 3]), "{size:?}");
        }
    }

    #[test]
    fn sizes_fit() {
        assert_eq!(fit_within(1280, 720, Some(640)), (640, 360));
        assert_eq!(fit_within(544, 960, Some(640)), (363, 640));
        assert_eq!(fit_within(100, 50, Some(640)), (100, 50));
        assert_eq!(fit_within(100, 50, None), (100, 50));
        assert_eq!(fit_within(10_000, 1, Some(100)), (100, 1));
    }
}
