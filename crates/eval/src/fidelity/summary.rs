//! Samples in a few numbers.

use serde::Serialize;

/// The largest of several values, and where it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Worst {
    /// The value.
    pub value: f64,
    /// Number of the frame, from 0.
    pub frame: usize,
    /// Seconds from the first frame.
    pub time: f64,
}

impl Worst {
    /// Takes a value in, if it is the largest so far.
    pub fn add(&mut self, value: f64, frame: usize, time: f64) {
        if value > self.value {
            *self = Self { value, frame, time };
        }
    }
}

/// How large values are that should be small.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub p95: f64,
    /// The largest.
    pub max: Worst,
    #[serde(skip)]
    values: Vec<f64>,
}

impl Spread {
    /// Takes a value in; [`Spread::settle`] works out mean and percentile.
    pub(super) fn add(&mut self, value: f64, frame: usize, time: f64) {
        self.values.push(value);
        self.max.add(value, frame, time);
    }

    /// Works out mean and percentile, and forgets the values.
    pub(super) fn settle(&mut self) {
        self.mean = mean(&self.values);
        self.p95 = percentile(&self.values, 0.95);
        self.values = Vec::new();
    }
}

/// The mean; 0 of nothing.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |sum, value| sum + value) / values.len().max(1) as f64
}

/// The smallest value that at least `share` of the values do not exceed; 0 of nothing.
pub(super) fn percentile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads_tell_mean_percentile_and_place() {
        let mut spread = Spread::default();
        for i in 0..100usize {
            spread.add(i as f64, i, i as f64 / 10.0);
        }
        spread.settle();
        assert_eq!((spread.mean, spread.p95), (49.5, 94.0));
        assert_eq!((spread.max.frame, spread.max.time), (99, 9.9));
        assert_eq!((mean(&[]), percentile(&[], 0.5)), (0.0, 0.0));
    }
}
