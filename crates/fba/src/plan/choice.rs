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
    let error: f64 = menu.iter().map(|plans| plans[0].error).sum();
    let mut choice = Choice::new(windows, sections, menu);
    for weight in WEIGHTS {
        choice.improve_all(weight * error.max(1.0));
    }
    choice.chosen
}

impl<'a> Choice<'a> {
    /// The first plan of each section.
    fn new(windows: &'a Windows, sections: &'a [Range<usize>], menu: &'a [Vec<Variant>]) -> Self {
        let bits: Vec<u64> =
            menu.iter().flat_map(|plans| plans[0].bits.iter().map(|&bits| bits.into())).collect();
        Self {
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
        }
    }

    /// Goes through all sections, as long as some plans of them are better at this weight.
    fn improve_all(&mut self, weight: f64) {
        self.weight = weight;
        let count = self.sections.len();
        for _ in 0..PASSES {
            let mut better = false;
            // Of a clip of one section there is no pair.
            for index in usize::from(count > 1)..count {
                better |= self.improve(index.checked_sub(1), index);
            }
            if !better {
                break;
            }
        }
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of a section.
    const LONG: usize = 210;

    fn variant(level: u32, error: f64) -> Variant {
        // A plane that sends all, and some that send more than others.
        let bits = (0..LONG as u32).map(|frame| if frame == 0 { 6 * level } else { level + frame % 7 });
        let made = Made { plans: Vec::new(), prices: Arc::new([]), quant: 8 };
        Variant { bits: bits.collect(), error, made: Arc::new(made) }
    }

    /// Windows of 10 s at 30 frames/s, in each of which 36 bits a frame are to be spent, of clips of some sections, and their
    /// frames.
    fn windows(sections: usize) -> (Windows, Vec<Range<usize>>) {
        let ticks: Vec<u64> = (0..(sections * LONG) as u64).collect();
        let frames = (0..sections).map(|index| index * LONG..(index + 1) * LONG).collect();
        (Windows::new(&ticks, 30.0, 1.08), frames)
    }

    /// Menus of plans that cost less as their errors are larger, hardly in step.
    fn menus(sections: usize, plans: usize, seed: u32) -> Vec<Vec<Variant>> {
        let mut state = seed;
        let mut random = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 16) % below
        };
        let mut plan = |_| {
            let level = 20 + random(26);
            variant(level, f64::from(2000 / level + random(12)))
        };
        (0..sections).map(|_| (0..plans).map(&mut plan).collect()).collect()
    }

    /// What a choice costs at a weight, counted from nothing.
    fn cost(windows: &Windows, menu: &[Vec<Variant>], chosen: &[usize], weight: f64) -> f64 {
        let plans = || menu.iter().zip(chosen).map(|(plans, &plan)| &plans[plan]);
        let bits: Vec<u64> = plans().flat_map(|plan| plan.bits.iter().map(|&bits| u64::from(bits))).collect();
        let sum = |span: &Range<usize>| bits[span.clone()].iter().sum::<u64>() as f64;
        let spans = windows.spans.iter().enumerate();
        let beyond: f64 = spans.map(|(index, span)| windows.beyond(index, sum(span), HELD)).sum();
        let over = (sum(&(0..bits.len())) / windows.total - MOST).max(0.0);
        plans().map(|plan| plan.error).sum::<f64>() + weight * (beyond + over)
    }

    #[test]
    fn of_two_sections_the_best_pair_is_chosen() {
        let (windows, frames) = windows(2);
        let mut moved = 0;
        for seed in 0..40 {
            let menu = menus(2, 6, seed);
            let errors: f64 = menu.iter().map(|plans| plans[0].error).sum();
            for weight in WEIGHTS.map(|weight| weight * errors) {
                let mut choice = Choice::new(&windows, &frames, &menu);
                choice.improve_all(weight);
                let pairs = (0..36).map(|pair| cost(&windows, &menu, &[pair / 6, pair % 6], weight));
                let least = pairs.fold(f64::INFINITY, f64::min);
                let found = cost(&windows, &menu, &choice.chosen, weight);
                assert!(found <= least + 1e-6 * weight, "{found} for {least} with {seed} at {weight}");
                moved += u32::from(choice.chosen != [0, 0]);
            }
        }
        assert!(moved > 60, "{moved}");
    }

    #[test]
    fn no_choice_is_worse_than_the_one_it_begins_with() {
        let (windows, frames) = windows(7);
        for seed in 0..20 {
            let menu = menus(7, 5, seed);
            let mut choice = Choice::new(&windows, &frames, &menu);
            for weight in [3.0, 1000.0, 30.0, 1e5] {
                let before = cost(&windows, &menu, &choice.chosen, weight);
                choice.improve_all(weight);
                let after = cost(&windows, &menu, &choice.chosen, weight);
                assert!(after <= before + 1e-6 * weight, "{after} after {before} with {seed} at {weight}");
            }
        }
    }

    #[test]
    fn windows_are_held_where_a_choice_holds_them() {
        let (windows, frames) = windows(2);
        // Nothing but the third and the second together is in the band, though others have less error.
        let plan = |(level, error): &(u32, f64)| variant(*level, *error);
        let menu = [[(45, 1.0), (20, 9.0), (32, 6.0)], [(45, 1.0), (32, 6.0), (26, 7.0)]];
        let menu = menu.map(|plans| plans.iter().map(plan).collect::<Vec<_>>());
        let held =
            |chosen: &[usize]| cost(&windows, &menu, chosen, 1.0) == cost(&windows, &menu, chosen, 0.0);
        let all: Vec<[usize; 2]> =
            (0..9).map(|pair| [pair / 3, pair % 3]).filter(|pair| held(pair)).collect();
        assert_eq!(all, [[2, 1]]);
        assert_eq!(choose(&windows, &frames, &menu), [2, 1]);
    }
}
