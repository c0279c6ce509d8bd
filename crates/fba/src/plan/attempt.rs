//! Plans of a whole clip at prices per bit that differ from frame to frame, what they cost, and what they can be made
//! again from: of an hour, whole plans are too large to keep as many as are chosen from.

use std::ops::Range;
use std::sync::Arc;

use super::choice::Variant;
use super::plans::PeriodPlan;

/// Bounds of prices, squared degrees per bit. At the lower one the finest quantiser is used.
pub(super) const PRICES: [f64; 2] = [1e-3, 1e3];
/// Change of a price, as a logarithm, from which on a section is planned anew.
const STALE: f64 = 0.01;

/// Logarithms of the prices of the frames of a section.
#[derive(Clone)]
pub(super) struct Prices {
    base: Arc<[f64]>,
    /// What they differ by from those, at the start and at the end of the section.
    change: Option<[f64; 2]>,
}

impl FromIterator<f64> for Prices {
    fn from_iter<I: IntoIterator<Item = f64>>(prices: I) -> Self {
        Self { base: prices.into_iter().collect(), change: None }
    }
}

impl Prices {
    /// These prices, which have no change yet, with one.
    pub fn changed(&self, change: [f64; 2]) -> Self {
        Self { base: Arc::clone(&self.base), change: Some(change) }
    }

    pub fn iter(&self) -> impl Iterator<Item = f64> + '_ {
        let count = self.base.len() as f64;
        let [low, high] = PRICES.map(f64::ln);
        self.base.iter().enumerate().map(move |(frame, &price)| match self.change {
            Some([start, end]) => {
                let change = start + (end - start) * frame as f64 / count;
                (price + change).clamp(low, high)
            }
            None => price,
        })
    }
}

/// What the plans of a section are made from, and always the same.
#[derive(Clone)]
pub(super) struct Recipe {
    pub prices: Prices,
    pub quant: u8,
}

impl Recipe {
    /// Whether both are one, and not just alike.
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.prices.base, &other.prices.base)
            && self.prices.change == other.prices.change
            && self.quant == other.quant
    }
}

/// The plans of the periods of a section, which have one quantiser, and what they were made from.
pub(super) struct Made {
    pub plans: Vec<PeriodPlan>,
    pub recipe: Recipe,
}

impl Made {
    /// Whether prices have changed so that it is to be made again.
    pub fn is_stale(&self, prices: &Prices) -> bool {
        self.recipe.prices.iter().zip(prices.iter()).any(|(a, b)| (a - b).abs() > STALE)
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
    /// What windows are beyond the band, and the most that one of them costs, or the whole clip, as a share.
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

    /// The price of each frame of the clip.
    pub fn frame_prices(&self) -> impl Iterator<Item = f64> + '_ {
        self.prices.iter().flat_map(Prices::iter)
    }

    /// What is kept of the plans of a section with these frames.
    pub fn variant(&self, index: usize, frames: Range<usize>) -> Variant {
        Variant {
            // No plane has as many bits as that.
            bits: self.bits[frames].iter().map(|&bits| bits.try_into().unwrap_or(u32::MAX)).collect(),
            error: self.errors[index],
            prices: self.prices[index].clone(),
            recipe: self.sections[index].recipe.clone(),
        }
    }
}
