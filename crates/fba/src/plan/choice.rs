//! Chooses one of several plans of each section so that all windows are held.
//!
//! What a section costs at a price is only known when it has been planned. With several plans of each at hand, from some
//! choice on, those of one section or of two neighbours are exchanged as long as that makes less of what windows are beyond
//! their band, or less error at no more of that. Range arrays that serve several sections are counted as they were when each
//! was planned; what a choice costs is measured anew.

use std::ops::Range;
use std::sync::Arc;

use super::attempt::Made;
use super::windows::Windows;

/// Plans of a section.
pub(super) struct Variant {
    /// Bits of its frames.
    pub bits: Box<[u32]>,
    /// Squared error of its angles.
    pub error: f64,
    pub made: Arc<Made>,
}

/// Shares of its bits between which every window is to be.
const HELD: [f64; 2] = [0.952, 1.048];
/// Most that the whole clip is to cost, as a share of its bits.
const MOST: f64 = 1.02;
/// What a window beyond its band by all of its bits counts for, in the errors of the whole clip. A clip that costs more than
/// its rate counts as well.
const WEIGHT: f64 = 100.0;
/// Times all periods are gone through at most.
const PASSES: usize = 40;

/// A choice that is being improved.
struct Choice<'a> {
    windows: &'a Windows,
    /// Frames of each period, and its plans.
    periods: &'a [Range<usize>],
    menu: &'a [Vec<Variant>],
    /// The plan chosen of each period.
    chosen: Vec<usize>,
    /// Bits of each frame, and of all.
    bits: Vec<u64>,
    total: f64,
    weight: f64,
}

/// The plan of each period, beginning with the first of each.
pub(super) fn choose(windows: &Windows, periods: &[Range<usize>], menu: &[Vec<Variant>]) -> Vec<usize> {
    let bits: Vec<u64> =
        menu.iter().flat_map(|plans| plans[0].bits.iter().map(|&bits| bits.into())).collect();
    let error: f64 = menu.iter().map(|plans| plans[0].error).sum();
    let mut choice = Choice {
        windows,
        periods,
        menu,
        chosen: vec![0; periods.len()],
        total: bits.iter().map(|&bits| bits as f64).sum(),
        bits,
        weight: WEIGHT * error.max(1.0),
    };
    for _ in 0..PASSES {
        let mut better = false;
        for index in 0..periods.len() {
            better |= choice.improve(&[index]);
            if index > 0 {
                better |= choice.improve(&[index - 1, index]);
            }
        }
        if !better {
            break;
        }
    }
    choice.chosen
}

impl Choice<'_> {
    /// Takes the best plans of neighbouring periods; false if they are chosen.
    fn improve(&mut self, indices: &[usize]) -> bool {
        let before: Vec<usize> = indices.iter().map(|&index| self.chosen[index]).collect();
        let (mut best, mut least) = (before.clone(), self.cost(indices));
        let threshold = least - 1e-9 * self.weight;
        let counts: Vec<usize> = indices.iter().map(|&index| self.menu[index].len()).collect();
        for number in 0..counts.iter().product() {
            let mut rest: usize = number;
            let tried: Vec<usize> = counts
                .iter()
                .map(|count| {
                    let digit = rest % count;
                    rest /= count;
                    digit
                })
                .collect();
            self.take(indices, &tried);
            let cost = self.cost(indices);
            if cost < least.min(threshold) {
                (best, least) = (tried, cost);
            }
        }
        self.take(indices, &best);
        best != before
    }

    fn take(&mut self, indices: &[usize], plans: &[usize]) {
        for (&index, &plan) in indices.iter().zip(plans) {
            if std::mem::replace(&mut self.chosen[index], plan) == plan {
                continue;
            }
            let bits = &mut self.bits[self.periods[index].clone()];
            self.total -= bits.iter().map(|&bits| bits as f64).sum::<f64>();
            for (bits, &new) in bits.iter_mut().zip(&self.menu[index][plan].bits) {
                *bits = new.into();
            }
            self.total += bits.iter().map(|&bits| bits as f64).sum::<f64>();
        }
    }

    /// What these periods and the windows that they are in count for.
    fn cost(&self, indices: &[usize]) -> f64 {
        let (Some(&first), Some(&last)) = (indices.first(), indices.last()) else { return 0.0 };
        let frames = self.periods[first].start..self.periods[last].end;
        let near = self.windows.around(&frames);
        let sums = self.windows.sums(near.clone(), &self.bits);
        let beyond: f64 = near.zip(sums).map(|(index, sum)| self.windows.beyond(index, sum, HELD)).sum();
        let over = (self.total / self.windows.total - MOST).max(0.0);
        let error: f64 = indices.iter().map(|&index| self.menu[index][self.chosen[index]].error).sum();
        error + self.weight * (beyond + over)
    }
}
