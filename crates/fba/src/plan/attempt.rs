//! Plans of a whole clip at prices per bit that differ from frame to frame, and what they cost. All that are chosen from are
//! kept whole: an hour at 2.2 kbit/s takes 164 MB to encode.

use std::ops::Range;
use std::sync::Arc;

use super::plans::PeriodPlan;

/// Bounds of prices, squared degrees per bit. At the lower one the finest quantiser is used.
pub(super) const PRICES: [f64; 2] = [1e-3, 1e3];
/// Change of a price, as a logarithm, from which on a section is planned anew.
const STALE: f64 = 0.01;

/// Logarithms of the prices of the frames of a section.
pub(super) type Prices = Arc<[f64]>;

/// The mean of some logarithms of prices; 0 of none.
pub(super) fn mean(prices: &[f64]) -> f64 {
    prices.iter().sum::<f64>() / prices.len().max(1) as f64
}

/// Prices that differ by `change` from others, at the start and at the end of the section.
pub(super) fn changed(prices: &Prices, [start, end]: [f64; 2]) -> Prices {
    let count = prices.len() as f64;
    let [low, high] = PRICES.map(f64::ln);
    let change = |(frame, &price): (usize, &f64)| {
        (price + start + (end - start) * frame as f64 / count).clamp(low, high)
    };
    prices.iter().enumerate().map(change).collect()
}

/// The plans of the periods of a section, which have one quantiser, and what they were made from.
pub(super) struct Made {
    pub plans: Vec<PeriodPlan>,
    pub prices: Prices,
    pub quant: u8,
}

impl Made {
    /// Whether prices have changed so that it is to be made again.
    pub fn is_stale(&self, prices: &Prices) -> bool {
        self.prices.iter().zip(prices.iter()).any(|(a, b)| (a - b).abs() > STALE)
    }
}

/// Plans at some prices, and what they cost.
#[derive(Clone)]
pub(super) struct Attempt {
    /// By section ([`Clip::sections`](super::clip::Clip::sections)).
    pub prices: Vec<Prices>,
    pub sections: Vec<Arc<Made>>,
    /// Of each frame.
    pub bits: Vec<u64>,
    /// What windows are beyond the band, and the clip beyond what it may cost; the most that one of them costs, or the whole
    /// clip, as a share.
    pub excess: f64,
    pub used: f64,
    /// Squared degrees, of all sections and of each.
    pub error: f64,
    pub errors: Vec<f64>,
}

impl Attempt {
    pub fn beats(&self, other: &Self) -> bool {
        self.excess < other.excess || self.excess == other.excess && self.error < other.error
    }

    /// The price of each frame of the clip, as a logarithm.
    pub fn frame_prices(&self) -> impl Iterator<Item = f64> + '_ {
        self.prices.iter().flat_map(|prices| prices.iter().copied())
    }

    /// The mean of these.
    pub fn mean_price(&self) -> f64 {
        self.frame_prices().sum::<f64>() / self.bits.len().max(1) as f64
    }

    /// Bits of some frames: no plane has as many as would not do.
    pub fn bits_of(&self, frames: Range<usize>) -> Box<[u32]> {
        self.bits[frames].iter().map(|&bits| bits.try_into().unwrap_or(u32::MAX)).collect()
    }
}
