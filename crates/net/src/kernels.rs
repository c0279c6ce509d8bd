//! Operators on rows of channels. Pictures are row by row, pixel by pixel, channels together.

mod depthwise;
mod gemm;
mod simple;

pub(crate) use depthwise::{Depthwise, Picture, Window};
pub(crate) use gemm::Gemm;
pub(crate) use simple::{Resize, add, concatenate, logistic, max_pool, mean, pad, prelu};

use pulp::{Arch, Simd, WithSimd};

/// What is done with a result before it is stored.
#[derive(Clone, Debug)]
pub(crate) enum Finish {
    /// Limited to an interval.
    Clamp(f32, f32),
    /// Negative results are multiplied by the slope of their channel.
    Slopes(Vec<f32>),
}

impl Finish {
    /// The same with slopes of `channels` channels padded to whole registers.
    fn padded(self, channels: usize) -> Self {
        match self {
            Self::Slopes(mut slopes) => {
                slopes.resize(channels, 0.0);
                Self::Slopes(slopes)
            }
            clamp => clamp,
        }
    }

    /// Applied to the registers of the channels from `channel` on.
    #[inline(always)]
    fn apply<S: Simd, const N: usize>(&self, simd: S, values: [S::f32s; N], channel: usize) -> [S::f32s; N] {
        match self {
            Self::Clamp(low, high) => {
                let (low, high) = (simd.splat_f32s(*low), simd.splat_f32s(*high));
                values.map(|v| simd.min_f32s(simd.max_f32s(v, low), high))
            }
            Self::Slopes(slopes) => {
                let zero = simd.splat_f32s(0.0);
                let mut done = values;
                for (j, v) in done.iter_mut().enumerate() {
                    let slope = load::<S>(slopes, channel + j * S::F32_LANES);
                    *v = simd.mul_add_e_f32s(simd.min_f32s(*v, zero), slope, simd.max_f32s(*v, zero));
                }
                done
            }
        }
    }
}

/// The register that starts at `slice[at]`.
#[inline(always)]
fn load<S: Simd>(slice: &[f32], at: usize) -> S::f32s {
    S::as_simd_f32s(&slice[at..at + S::F32_LANES]).0[0]
}

/// Stores one register at `slice[at]`.
#[inline(always)]
fn store<S: Simd>(slice: &mut [f32], at: usize, value: S::f32s) {
    S::as_mut_simd_f32s(&mut slice[at..at + S::F32_LANES]).0[0] = value;
}

/// How many floats a register of this processor holds.
pub(crate) fn lanes(arch: Arch) -> usize {
    struct Lanes;
    impl WithSimd for Lanes {
        type Output = usize;

        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F32_LANES
        }
    }
    arch.dispatch(Lanes)
}
