//! Chooses one of several plans of each section so that all windows are held.
//!
//! What a section costs at a price is only known when it has been planned. With several plans of each at hand, from some
//! choice on, those of one section or of two neighbours are exchanged as long as that makes less of what windows are beyond
//! their band, or less error at no more of that. First windows count for little beside errors and then for ever more: a
//! choice that holds them all at once is seldom one of little error. Range arrays that serve several sections are counted as
//! they were when each was planned; what a choice costs is measured anew.

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

impl Variant {
    /// Bits of all its frames.
    fn total(&self) -> f64 {
        self.bits.iter().map(|&bits| f64::from(bits)).sum()
    }
}

/// Shares of its bits between which every window is to be.
const HELD: [f64; 2] = [0.952, 1.048];
/// Most that the whole clip is to cost, as a share of its bits.
pub(super) const MOST: f64 = 1.02;
/// What a window beyond its band by all of its bits counts for, in the errors of the whole clip, one after the other. A clip
/// that costs more than its rate counts as well.
const WEIGHTS: [f64; 3] = [0.3, 5.0, 100.0];
/// Times all sections are gone through at most, with each weight.
const PASSES: usize = 40;

/// A choice that is being improved.
struct Choice<'a> {
    windows: &'a Windows,
    /// Frames of each section, and its plans.
    sections: &'a [Range<usize>],
    menu: &'a [Vec<Variant>],
    /// The plan chosen of each section.
    chosen: Vec<usize>,
    /// Bits of each frame, and of all.
    bits: Vec<u64>,
    total: f64,
    weight: f64,
    /// Bits of each window near the sections that are looked at, without them, with the plan tried of the first, and what
    /// the plans of each have in them, plan by plan.
    rest: Vec<f64>,
    with: Vec<f64>,
    parts: [Vec<f64>; 2],
}

/// The plan of each section, beginning with the first of each.
pub(super) fn choose(windows: &Windows, sections: &[Range<usize>], menu: &[Vec<Variant>]) -> Vec<usize> {
    let bits: Vec<u64> =
        menu.iter().flat_map(|plans| plans[0].bits.iter().map(|&bits| bits.into())).collect();
    let error: f64 = menu.iter().map(|plans| plans[0].error).sum();
    let mut choice = Choice {
        windows,
        sections,
        menu,
        chosen: vec![0; sections.len()],
        total: bits.iter().map(|&bits| bits as f64).sum(),
        bits,
        weight: 0.0,
        rest: Vec::new(),
        with: Vec::new(),
        parts: [Vec::new(), Vec::new()],
    };
    for weight in WEIGHTS {
        choice.weight = weight * error.max(1.0);
        for _ in 0..PASSES {
            let mut better = false;
            for index in 0..sections.len() {
                // Of a clip of one section there is no pair.
                if index > 0 || sections.len() == 1 {
                    better |= choice.improve(index.checked_sub(1), index);
                }
            }
            if !better {
                break;
            }
        }
    }
    choice.chosen
}

impl Choice<'_> {
    /// Takes the best plans of a section and the one before it, if any; false if they are chosen.
    fn improve(&mut self, first: Option<usize>, second: usize) -> bool {
        let begin = self.sections[first.unwrap_or(second)].start;
        let near = self.windows.around(&(begin..self.sections[second].end));
        let total = self.look_at(&near, first, second);
        let plans = |index: usize| self.menu[index].iter().map(|plan| (plan.total(), plan.error));
        let firsts: Vec<(f64, f64)> = first.map_or_else(|| vec![(0.0, 0.0)], |index| plans(index).collect());
        let seconds: Vec<(f64, f64)> = plans(second).collect();
        let before = (first.map_or(0, |index| self.chosen[index]), self.chosen[second]);
        // Those that are chosen come first: others must be better by something.
        let (mut best, mut least) = (before, f64::INFINITY);
        let others = (0..firsts.len()).flat_map(|one| (0..seconds.len()).map(move |other| (one, other)));
        let mut with = usize::MAX;
        for (one, other) in std::iter::once(before).chain(others) {
            let (bits, error) = (firsts[one].0 + seconds[other].0, firsts[one].1 + seconds[other].1);
            let cost = error + self.weight * ((total + bits) / self.windows.total - MOST).max(0.0);
            if cost >= least {
                continue;
            }
            if std::mem::replace(&mut with, one) != one {
                self.add_first(one);
            }
            let parts = &self.parts[1][other * near.len()..(other + 1) * near.len()];
            let beyond = self.windows.all_beyond(near.clone(), &self.with, parts, HELD);
            let cost = cost + self.weight * beyond;
            if cost < least {
                best = (one, other);
                least = if least.is_infinite() { cost - 1e-9 * self.weight } else { cost };
            }
        }
        first.into_iter().for_each(|index| self.take(index, best.0));
        self.take(second, best.1);
        best != before
    }

    /// Works out what the plans of these sections have in the windows near them, and what these have of others: the bits of
    /// all of those.
    fn look_at(&mut self, near: &Range<usize>, first: Option<usize>, second: usize) -> f64 {
        self.rest.clear();
        self.rest.extend(self.windows.sums(near.clone(), &self.bits));
        let mut total = self.total;
        for (index, parts) in [first, Some(second)].into_iter().zip(&mut self.parts) {
            parts.clear();
            let Some(index) = index else { continue };
            for plan in &self.menu[index] {
                add_parts(&self.windows.spans[near.clone()], &self.sections[index], &plan.bits, parts);
            }
            let chosen = self.chosen[index];
            total -= self.menu[index][chosen].total();
            let gone = &parts[chosen * near.len()..];
            self.rest.iter_mut().zip(gone).for_each(|(rest, gone)| *rest -= gone);
        }
        total
    }

    /// Sets what the windows have with a plan of the first section that is looked at, if any.
    fn add_first(&mut self, plan: usize) {
        self.with.clone_from(&self.rest);
        let parts = self.parts[0].chunks_exact(self.rest.len().max(1)).nth(plan);
        self.with.iter_mut().zip(parts.into_iter().flatten()).for_each(|(with, more)| *with += more);
    }

    fn take(&mut self, index: usize, plan: usize) {
        let before = std::mem::replace(&mut self.chosen[index], plan);
        if before != plan {
            let [before, plan] = [before, plan].map(|plan| &self.menu[index][plan]);
            let bits = &mut self.bits[self.sections[index].clone()];
            bits.iter_mut().zip(&plan.bits).for_each(|(bits, &new)| *bits = new.into());
            self.total += plan.total() - before.total();
        }
    }
}

/// Appends what a section of these frames and bits has in each of some windows.
fn add_parts(spans: &[Range<usize>], frames: &Range<usize>, bits: &[u32], parts: &mut Vec<f64>) {
    let (mut begin, mut end, mut sum) = (0, 0, 0.0);
    for span in spans {
        let [first, behind] =
            [span.start, span.end].map(|frame| frame.clamp(frames.start, frames.end) - frames.start);
        sum += bits[end..behind].iter().map(|&bits| f64::from(bits)).sum::<f64>();
        sum -= bits[begin..first].iter().map(|&bits| f64::from(bits)).sum::<f64>();
        (begin, end) = (first, behind);
        parts.push(sum);
    }
}
