//! One step of a run: reads ranges of the arena, writes another.

use std::ops::Range;
use std::slice::GetDisjointMutError;

use pulp::Arch;

use crate::kernels::{self, Depthwise, Gemm, Picture, Resize, Window};

/// Numbers of a picture's rows that are handed from one part of a step to the next at a time.
pub(super) const BAND: usize = 8 << 10;

#[derive(Clone, Debug)]
pub(super) enum Work {
    /// Convolution with a window of one pixel, or a matrix product.
    Gemm(Gemm),
    /// Convolution with a larger window: each row of windows is laid out, then multiplied.
    Windows {
        input: Picture,
        output: Picture,
        window: Window,
        gemm: Gemm,
    },
    /// Convolution of channels by themselves; between convolutions of one pixel where those are joined to it.
    Depthwise {
        before: Option<Gemm>,
        depthwise: Depthwise,
        after: Option<Gemm>,
    },
    Add((f32, f32)),
    AddConstant(Vec<f32>, (f32, f32)),
    Prelu(Vec<f32>),
    MaxPool {
        input: Picture,
        output: Picture,
        window: Window,
        range: (f32, f32),
    },
    Mean,
    Pad {
        shape: [usize; 4],
        before: [usize; 4],
        padded: [usize; 4],
    },
    Resize(Resize),
    Logistic,
    /// Copies runs of `part` numbers into runs of `whole` from `first` on.
    Part {
        part: usize,
        whole: usize,
        first: usize,
    },
}

#[derive(Clone, Debug)]
pub(super) struct Step {
    pub work: Work,
    pub input: Range<usize>,
    /// A second input: what is added.
    pub other: Option<Range<usize>>,
    pub output: Range<usize>,
}

impl Step {
    pub fn name(&self) -> &'static str {
        match &self.work {
            Work::Gemm(_) => "convolution",
            Work::Windows { .. } => "convolution with windows",
            Work::Depthwise { before: None, after: None, .. } => "depthwise convolution",
            Work::Depthwise { before: None, .. } => "depthwise + convolution",
            Work::Depthwise { after: None, .. } => "convolution + depthwise",
            Work::Depthwise { .. } => "convolution + depthwise + convolution",
            Work::Add(_) | Work::AddConstant(..) => "add",
            Work::Prelu(_) => "prelu",
            Work::MaxPool { .. } => "max pool",
            Work::Mean => "mean",
            Work::Pad { .. } => "pad",
            Work::Resize(_) => "resize",
            Work::Logistic => "logistic",
            Work::Part { .. } => "concatenation",
        }
    }

    /// Numbers of scratch memory it needs.
    pub fn scratch(&self) -> usize {
        match &self.work {
            Work::Windows { output, gemm, .. } => output.columns * gemm.inputs(),
            Work::Depthwise { before, depthwise, after } => {
                before.as_ref().map_or(0, |_| ring(depthwise) * depthwise.input.row())
                    + after.as_ref().map_or(0, |_| band(depthwise) * depthwise.output.row())
            }
            _ => 0,
        }
    }

    pub fn run(&self, arch: Arch, arena: &mut [f32], scratch: &mut [f32]) -> Result<(), GetDisjointMutError> {
        let output = self.output.clone();
        let (input, other, output) = match self.other.clone() {
            Some(other) if other != self.input => {
                let [input, other, output] = arena.get_disjoint_mut([self.input.clone(), other, output])?;
                (&*input, &*other, output)
            }
            same => {
                let [input, output] = arena.get_disjoint_mut([self.input.clone(), output])?;
                (&*input, if same.is_some() { &*input } else { &[][..] }, output)
            }
        };
        self.work(arch, input, other, output, scratch);
        Ok(())
    }

    fn work(&self, arch: Arch, input: &[f32], other: &[f32], output: &mut [f32], scratch: &mut [f32]) {
        match &self.work {
            Work::Gemm(gemm) => gemm.run(arch, input, other, output),
            Work::Windows { input: from, output: to, window, gemm } => {
                windows(arch, (*from, input), window, gemm, other, (*to, output), scratch);
            }
            Work::Depthwise { before, depthwise, after } => {
                let parts = Parts { before: before.as_ref(), depthwise, after: after.as_ref() };
                parts.run(arch, input, other, output, scratch);
            }
            Work::Add(range) => kernels::add(arch, input, other, *range, output),
            Work::AddConstant(constant, range) => kernels::add(arch, input, constant, *range, output),
            Work::Prelu(slopes) => kernels::prelu(arch, input, slopes, output),
            Work::MaxPool { input: from, output: to, window, range } => {
                kernels::max_pool(arch, (*from, input), window, *range, (*to, output));
            }
            Work::Mean => kernels::mean(arch, input, output),
            Work::Pad { shape, before, padded } => kernels::pad(input, *shape, *before, output, *padded),
            Work::Resize(resize) => resize.run(arch, input, output),
            Work::Logistic => kernels::logistic(input, output),
            Work::Part { part, whole, first } => kernels::concatenate(input, *part, output, *whole, *first),
        }
    }
}

/// The part of what is added that belongs to a range of the output.
fn part(other: &[f32], range: Range<usize>) -> &[f32] {
    if other.is_empty() { other } else { &other[range] }
}

/// Convolution row by row: the windows of a row become the rows of a matrix.
fn windows(
    arch: Arch,
    (from, input): (Picture, &[f32]),
    window: &Window,
    gemm: &Gemm,
    other: &[f32],
    (to, output): (Picture, &mut [f32]),
    scratch: &mut [f32],
) {
    let channels = from.channels;
    let taps = window.kernel[1] * channels;
    let scratch = &mut scratch[..to.columns * gemm.inputs()];
    for (row, out) in output.chunks_exact_mut(to.row()).enumerate() {
        for (column, windows) in scratch.chunks_exact_mut(gemm.inputs()).enumerate() {
            let left = (column * window.stride[1]) as isize - window.before[1] as isize;
            for (i, line) in windows.chunks_exact_mut(taps).enumerate() {
                let y =
                    (row * window.stride[0] + i * window.dilation[0]) as isize - window.before[0] as isize;
                if y < 0 || y >= from.rows as isize {
                    line.fill(0.0);
                    continue;
                }
                let source = &input[y as usize * from.row()..][..from.row()];
                let inside = left >= 0 && left as usize + window.kernel[1] <= from.columns;
                if window.dilation[1] == 1 && inside {
                    line.copy_from_slice(&source[left as usize * channels..][..taps]);
                    continue;
                }
                for (j, pixel) in line.chunks_exact_mut(channels).enumerate() {
                    let x = left + (j * window.dilation[1]) as isize;
                    if x >= 0 && x < from.columns as isize {
                        pixel.copy_from_slice(&source[x as usize * channels..][..channels]);
                    } else {
                        pixel.fill(0.0);
                    }
                }
            }
        }
        gemm.run(arch, scratch, part(other, row * to.row()..(row + 1) * to.row()), out);
    }
}

/// Rows of the depthwise result that go on to the next convolution together.
fn band(depthwise: &Depthwise) -> usize {
    (BAND / depthwise.output.row()).clamp(1, depthwise.output.rows)
}

/// Rows kept of the first convolution's result.
fn ring(depthwise: &Depthwise) -> usize {
    depthwise.span().min(depthwise.input.rows)
}

/// A depthwise convolution and the convolutions of one pixel joined to it. Rows go from one to the next while they are
/// in the nearest cache; the results in between are never whole in memory.
struct Parts<'a> {
    before: Option<&'a Gemm>,
    depthwise: &'a Depthwise,
    after: Option<&'a Gemm>,
}

impl Parts<'_> {
    fn run(&self, arch: Arch, input: &[f32], other: &[f32], output: &mut [f32], scratch: &mut [f32]) {
        let depthwise = self.depthwise;
        let ring = if self.before.is_some() { ring(depthwise) } else { depthwise.input.rows };
        let (kept, scratch) = scratch.split_at_mut(self.before.map_or(0, |_| ring * depthwise.input.row()));
        let mut made = 0;
        let width = depthwise.output.row();
        let mut one = |row: usize, out: &mut [f32]| match self.before {
            None => depthwise.run_row(arch, input, ring, row, out),
            Some(before) => {
                let needed = made..depthwise.needs(row).end.max(made);
                made = needed.end;
                for row in needed {
                    let from = row * depthwise.input.columns * before.inputs();
                    let line = &input[from..][..depthwise.input.columns * before.inputs()];
                    let at = row % ring * depthwise.input.row();
                    before.run(arch, line, &[], &mut kept[at..][..depthwise.input.row()]);
                }
                depthwise.run_row(arch, kept, ring, row, out);
            }
        };
        let Some(after) = self.after else {
            for (row, out) in output.chunks_exact_mut(width).enumerate() {
                one(row, out);
            }
            return;
        };
        let band = band(depthwise);
        let to = depthwise.output.columns * after.outputs();
        for (number, out) in output.chunks_mut(band * to).enumerate() {
            let rows = out.len() / to;
            for (i, line) in scratch[..rows * width].chunks_exact_mut(width).enumerate() {
                one(number * band + i, line);
            }
            let from = number * band * to;
            after.run(arch, &scratch[..rows * width], part(other, from..from + out.len()), out);
        }
    }
}
