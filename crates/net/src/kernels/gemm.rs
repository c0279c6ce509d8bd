//! Rows of one matrix times packed weights: convolutions with windows of one pixel, and those whose windows are laid
//! out as rows first.

use pulp::{Arch, Simd, WithSimd};

use super::{Finish, load, store};

/// At most so many rows are computed together.
const ROWS: usize = 8;

/// Inputs of a block of rows stay within the first-level cache while all weights pass by.
const BLOCK: usize = 6 << 10;

/// Weights of `outputs` x `inputs`, packed for registers of `lanes` floats: panels of two registers of outputs (the last
/// of one where the number is odd), and in a panel the registers of each input in turn.
#[derive(Clone, Debug)]
pub(crate) struct Gemm {
    inputs: usize,
    outputs: usize,
    lanes: usize,
    panels: Vec<f32>,
    bias: Vec<f32>,
    finish: Finish,
}

impl Gemm {
    /// Packs `weights`, `outputs` rows of `inputs` numbers. Biases are as many as outputs, or none.
    pub fn new(
        arch: Arch,
        weights: &[f32],
        inputs: usize,
        bias: &[f32],
        outputs: usize,
        finish: Finish,
    ) -> Self {
        let lanes = super::lanes(arch);
        let padded = outputs.next_multiple_of(lanes);
        let mut panels = Vec::with_capacity(padded * inputs);
        let mut first = 0;
        while first < padded {
            let width = (2 * lanes).min(padded - first);
            for input in 0..inputs {
                panels.extend(
                    (first..first + width)
                        .map(|output| if output < outputs { weights[output * inputs + input] } else { 0.0 }),
                );
            }
            first += width;
        }
        let mut bias = bias.to_vec();
        bias.resize(padded, 0.0);
        Self { inputs, outputs, lanes, panels, bias, finish: finish.padded(padded) }
    }

    pub fn inputs(&self) -> usize {
        self.inputs
    }

    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// `output[row] = finish(weights * input[row] + bias + added[row])`; `added` may be empty.
    pub fn run(&self, arch: Arch, input: &[f32], added: &[f32], output: &mut [f32]) {
        let rows = output.len() / self.outputs;
        arch.dispatch(Run { gemm: self, rows, input, added, output });
    }
}

struct Run<'a> {
    gemm: &'a Gemm,
    rows: usize,
    input: &'a [f32],
    added: &'a [f32],
    output: &'a mut [f32],
}

impl WithSimd for Run<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let gemm = self.gemm;
        debug_assert_eq!(gemm.lanes, S::F32_LANES);
        // Accumulators, weights and a broadcast input fit the registers.
        let most = if S::REGISTER_COUNT >= 32 { ROWS } else { ROWS - 2 };
        let block = (BLOCK / gemm.inputs).max(most).next_multiple_of(most);
        let padded = gemm.bias.len();
        for first in (0..self.rows).step_by(block) {
            let rows = block.min(self.rows - first);
            let tiles = rows.div_ceil(most);
            for channel in (0..padded).step_by(2 * S::F32_LANES) {
                for tile in 0..tiles {
                    let from = first + rows * tile / tiles;
                    let count = first + rows * (tile + 1) / tiles - from;
                    if channel + S::F32_LANES < padded {
                        self.rows_of::<S, 2>(simd, from, count, channel);
                    } else {
                        self.rows_of::<S, 1>(simd, from, count, channel);
                    }
                }
            }
        }
    }
}

impl Run<'_> {
    #[inline(always)]
    fn rows_of<S: Simd, const N: usize>(&mut self, simd: S, from: usize, count: usize, channel: usize) {
        match count {
            1 => self.tile::<S, 1, N>(simd, from, channel),
            2 => self.tile::<S, 2, N>(simd, from, channel),
            3 => self.tile::<S, 3, N>(simd, from, channel),
            4 => self.tile::<S, 4, N>(simd, from, channel),
            5 => self.tile::<S, 5, N>(simd, from, channel),
            6 => self.tile::<S, 6, N>(simd, from, channel),
            7 => self.tile::<S, 7, N>(simd, from, channel),
            _ => self.tile::<S, 8, N>(simd, from, channel),
        }
    }

    /// `M` rows from `from` on times the panel of `N` registers that starts with output `channel`.
    #[inline(always)]
    fn tile<S: Simd, const M: usize, const N: usize>(&mut self, simd: S, from: usize, channel: usize) {
        let gemm = self.gemm;
        let inputs = gemm.inputs;
        let panel = &gemm.panels[channel * inputs..][..N * S::F32_LANES * inputs];
        let (panel, _) = S::as_simd_f32s(panel).0.as_chunks::<N>();
        let rows: [&[f32]; M] = std::array::from_fn(|i| &self.input[(from + i) * inputs..][..panel.len()]);
        let bias: [S::f32s; N] = std::array::from_fn(|j| load::<S>(&gemm.bias, channel + j * S::F32_LANES));
        let mut sums = [bias; M];
        for k in 0..panel.len() {
            let weights = panel[k];
            for i in 0..M {
                let x = simd.splat_f32s(rows[i][k]);
                for j in 0..N {
                    sums[i][j] = simd.mul_add_e_f32s(x, weights[j], sums[i][j]);
                }
            }
        }
        let width = (N * S::F32_LANES).min(gemm.outputs - channel);
        for (i, sums) in sums.into_iter().enumerate() {
            let at = (from + i) * gemm.outputs + channel;
            let added = if self.added.is_empty() { None } else { Some(&self.added[at..at + width]) };
            finish::<S, N>(simd, &gemm.finish, channel, sums, added, &mut self.output[at..at + width]);
        }
    }
}

/// Adds, finishes and stores the sums of one row; `output` is as long as there are channels.
#[inline(always)]
fn finish<S: Simd, const N: usize>(
    simd: S,
    finish: &Finish,
    channel: usize,
    mut sums: [S::f32s; N],
    added: Option<&[f32]>,
    output: &mut [f32],
) {
    let whole = output.len() == N * S::F32_LANES;
    if let Some(added) = added {
        for (j, sum) in sums.iter_mut().enumerate() {
            let at = j * S::F32_LANES;
            let more = if whole { load::<S>(added, at) } else { partial_load(simd, added, at) };
            *sum = simd.add_f32s(*sum, more);
        }
    }
    let done = finish.apply(simd, sums, channel);
    for (j, value) in done.into_iter().enumerate() {
        let at = j * S::F32_LANES;
        if whole || at + S::F32_LANES <= output.len() {
            store::<S>(output, at, value);
        } else if let Some(rest) = output.get_mut(at..) {
            simd.partial_store_f32s(rest, value);
        }
    }
}

#[inline(always)]
fn partial_load<S: Simd>(simd: S, slice: &[f32], at: usize) -> S::f32s {
    let end = (at + S::F32_LANES).min(slice.len());
    simd.partial_load_f32s(slice.get(at..end).unwrap_or(&[]))
}
