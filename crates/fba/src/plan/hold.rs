//! Holding a rate over every ten seconds of a clip.
//!
//! Each frame has a price per bit. A window of ten seconds that costs too much raises the price of all its
//! frames, one that costs too little lowers it, and the sections in which prices changed are planned anew: I periods, each
//! with those that begin for the sake of a leap in it, which share its quantiser, so that its ranges serve them. As errors then
//! weigh the same wherever no window asks for something else, no more is evened out than has to be. What is still beyond
//! its band is mended by a choice among several plans of each section. Too much counts for more than too little, and
//! frames in which there is less to say than the rate has room for are not missed. The live encoder's stream is taken if it
//! is better.

use std::ops::{Range, RangeInclusive};
use std::sync::Arc;

use super::super::error::EncodeError;
use super::super::state::step;
use super::attempt::{Attempt, Made, PRICES, Prices, Recipe};
use super::choice::{Variant, choose};
use super::clip::Clip;
use super::live::write_live;
use super::options::{Choices, GRACE, PlanOptions};
use super::path::{Search, Way};
use super::plans::{PeriodPlan, Plans};
use super::ranges::saved_bits;
use super::report::PlanReport;
use super::search::{Goal, Planner, cost};
use super::steering::{FIRST_LAMBDA, QUANTS, index_of_step};
use super::windows::Windows;
use crate::bap::Bap;

/// Shares of its bits between which every window is planned to be.
const PLANNED: [f64; 2] = [0.962, 1.038];
/// The same for the clip as a whole, as far as no window is in the way.
const MEAN: [f64; 2] = [0.99, 0.996];
/// The share of its bits that a clip, or a window of it, must use where it can.
const USED: f64 = 0.985;
/// Times prices are made anew at most, and part of the way to the next ones that is gone after the first time.
const ROUNDS: usize = 10;
const PART: f64 = 0.6;
/// What the logarithms of the prices then differ by, at the start and at the end of each section, between the plans that are
/// chosen from.
const MENUS: [[[f64; 2]; 6]; 4] = [
    [[-1.0, -1.0], [-0.5, -0.5], [-0.2, -0.2], [0.2, 0.2], [0.5, 0.5], [1.0, 1.0]],
    [[-1.0, 1.0], [1.0, -1.0], [-0.4, 0.4], [0.4, -0.4], [-0.3, -0.3], [0.3, 0.3]],
    [[-0.8, 0.0], [0.8, 0.0], [0.0, -0.8], [0.0, 0.8], [-0.1, -0.1], [0.1, 0.1]],
    [[-0.4, 0.2], [0.4, -0.2], [0.2, -0.4], [-0.2, 0.4], [-0.15, -0.15], [0.15, 0.15]],
];
/// What the share by which a window is beyond its bounds adds to the error of a stream, in parts of it.
const TOO_MUCH: f64 = 1000.0;
const TOO_LITTLE: f64 = 50.0;
/// Times all windows are looked at to find the next prices.
const SWEEPS: usize = 30;
/// Sweeps after which steps are half as long.
const SLOWER: f64 = 6.0;
/// Frames from one window that is looked at then to the next.
const APART: usize = 5;
/// How many bits of P planes follow a price: the power of it that they fall with.
const ELASTICITY: f64 = 0.5;
/// Largest change of a price in one round, as a logarithm.
const STRIDE: f64 = 1.0;
/// Bits that a frame left out counts for.
const LEFT_OUT: f64 = 1.0;
/// λ over the squared step of a finger bend at which plans end when any step may be chosen.
const LAMBDA_PER_STEP: f64 = 0.35;

/// What frames will cost at other prices.
struct Forecast<'a> {
    /// Logarithms of the prices that bits were spent at last, and of the next ones.
    before: &'a [f64],
    prices: Vec<f64>,
    /// Bits that no price changes, and those that follow it, at the next prices.
    fixed: Vec<f64>,
    moving: Vec<f64>,
}

impl Forecast<'_> {
    fn set(&mut self, frame: usize, price: f64) {
        let before = self.before[frame];
        let price = price.clamp(before - STRIDE, before + STRIDE).clamp(PRICES[0].ln(), PRICES[1].ln());
        self.moving[frame] *= (ELASTICITY * (self.prices[frame] - price)).exp();
        self.prices[frame] = price;
    }

    /// Puts all prices where they are on average: what windows needed before they may no longer need.
    fn level(&mut self, resting: &[bool]) {
        let bits: f64 = self.moving.iter().sum();
        let sum: f64 = self.prices.iter().zip(&self.moving).map(|(price, bits)| price * bits).sum();
        for frame in (0..self.prices.len()).filter(|&frame| !resting[frame]) {
            self.set(frame, sum / bits);
        }
    }

    fn sum(&self, span: Range<usize>) -> [f64; 2] {
        [&self.fixed, &self.moving].map(|bits| bits[span.clone()].iter().sum())
    }

    /// Changes the prices of all frames of each span so that it costs between the bits given with it, if it does
    /// not, or by a `step` of that. True if all do.
    fn hold<'s>(&mut self, spans: impl Iterator<Item = (&'s Range<usize>, [f64; 2])>, step: f64) -> bool {
        let mut held = true;
        let mut at = 0..0;
        let mut sum = [0.0; 2];
        for (span, [least, most]) in spans {
            let (come, gone) = (self.sum(at.end..span.end), self.sum(at.start..span.start));
            sum = [0, 1].map(|part| sum[part] + come[part] - gone[part]);
            at = span.clone();
            let [fixed, moving] = sum;
            let wanted = (fixed + moving).clamp(least, most);
            if wanted == fixed + moving {
                continue;
            }
            held = false;
            let change = (moving.max(1.0) / (wanted - fixed).max(0.02 * wanted)).ln() / ELASTICITY * step;
            for frame in span.clone() {
                self.set(frame, self.prices[frame] + change);
            }
            sum = self.sum(span.clone());
        }
        held
    }
}

impl Windows {
    /// Prices at which every window is within its band, as far as can be said from what the last ones led to.
    fn next(&self, mut forecast: Forecast<'_>, level: bool) -> Vec<f64> {
        let whole = 0..forecast.prices.len();
        let mean = MEAN.map(|share| share * self.total);
        let [low, high] = PLANNED.map(|share| share * self.bits);
        let spans = || self.spans.iter().zip(&self.lively).step_by(APART);
        if level {
            forecast.level(&self.resting);
        }
        for sweep in 0..SWEEPS {
            // Ever smaller steps, as there may be no prices at which all are held.
            let step = 1.0 / (1.0 + sweep as f64 / SLOWER);
            // What comes last counts most: too much is worse than too little.
            let held = [
                // Later only what is near a window that is not held changes: each plan made anew costs a little more
                // or less than foreseen.
                !level || forecast.hold(std::iter::once((&whole, mean)), step),
                forecast.hold(spans().map(|(span, lively)| (span, [low * lively, f64::INFINITY])), step),
                forecast.hold(spans().map(|(span, _)| (span, [0.0, high])), 1.0),
            ];
            if held == [true; 3] {
                break;
            }
        }
        forecast.prices
    }
}

/// A stream that holds a rate.
pub(super) struct Held {
    pub stream: Vec<u8>,
    pub report: PlanReport,
    /// The plans that it follows; none where it is coded frame by frame.
    pub plans: Option<Plans>,
}

/// The stream that spends `kbit_per_s` in every window, or in the whole of a clip too short for one: in that of less than
/// [`GRACE`] seconds what they would have.
pub(super) fn held(clip: &Clip, options: &PlanOptions, kbit_per_s: f64) -> Result<Held, EncodeError> {
    let windows = Windows::of(clip, options, kbit_per_s)?;
    if windows.spans.is_empty() {
        // An I plane alone is more than a moment's bits.
        let rate = kbit_per_s * (GRACE / clip.seconds).max(1.0);
        let plans = Planner::new(clip, options).search(Goal::Rate(rate))?;
        let (stream, report) = plans.write(clip, options)?;
        return Ok(Held { stream, report, plans: Some(plans) });
    }
    let mut best = planned(clip, options, &windows, kbit_per_s)?;
    if options.choices.lasting_ranges && windows.judge(&best.report.frame_bits).missed > 0 {
        // What each period costs is better known where its ranges serve no other.
        let choices = Choices { lasting_ranges: false, ..options.choices };
        if let Ok(other) = planned(clip, &PlanOptions { choices, ..*options }, &windows, kbit_per_s)
            && better(&windows, &other.report, &best.report)
        {
            best = other;
        }
    }
    // Values that lag behind for a moment may be the only way to hold a low rate.
    if let Ok((stream, report)) = write_live(clip, options)
        && better(&windows, &report, &best.report)
    {
        best = Held { stream, report, plans: None };
    }
    let Held { stream, mut report, plans } = best;
    let resting = windows.resting.iter().filter(|&&rests| rests).count();
    report.resting_seconds = resting as f64 / options.rate.per_second();
    report.windows_missed = Some(windows.judge(&report.frame_bits).missed);
    Ok(Held { stream, report, plans })
}

/// The plans that spend `kbit_per_s` in every window, filled up where there is too little to say.
fn planned(
    clip: &Clip,
    options: &PlanOptions,
    windows: &Windows,
    kbit_per_s: f64,
) -> Result<Held, EncodeError> {
    let mut plans = Planner::new(clip, options).hold(windows, kbit_per_s)?;
    let (mut stream, mut report) = plans.write(clip, options)?;
    plans.filler = windows.filler(&report.frame_bits);
    if plans.filler.iter().any(|&planes| planes > 0) {
        (stream, report) = plans.write(clip, options)?;
    }
    Ok(Held { stream, report, plans: Some(plans) })
}

/// Whether a stream is better than another: by its error, which counts for more as windows are beyond their bounds.
fn better(windows: &Windows, one: &PlanReport, other: &PlanReport) -> bool {
    let [one, other] = [one, other].map(|report| {
        let judgement = windows.judge(&report.frame_bits);
        report.rms_degrees * (1.0 + TOO_MUCH * judgement.over + TOO_LITTLE * judgement.under)
    });
    one < other
}

impl Planner<'_> {
    /// Plans that spend `kbit_per_s` in every window.
    fn hold(&mut self, windows: &Windows, kbit_per_s: f64) -> Result<Plans, EncodeError> {
        let price = (FIRST_LAMBDA / kbit_per_s.powi(3)).clamp(PRICES[0], PRICES[1]).ln();
        let floor = PRICES[0].ln();
        let prices = windows.resting.iter().map(|&rests| if rests { floor } else { price }).collect();
        let mut last = self.first_attempt(windows, self.by_section(prices))?;
        let mut best = last.clone();
        for round in 0..ROUNDS {
            if best.excess == 0.0 && best.used > USED {
                break;
            }
            let part = if round == 0 { 1.0 } else { PART };
            let before: Vec<f64> = last.frame_prices().collect();
            let next = windows.next(self.forecast(&before, &last.bits), true);
            let prices = before.iter().zip(next).map(|(price, next)| price + part * (next - price));
            last = self.attempt(windows, self.by_section(prices.collect()), &last)?;
            if last.beats(&best) {
                best = last.clone();
            }
        }
        drop(last);
        let mut menu: Vec<Vec<Variant>> = self.variants(&best).map(|variant| vec![variant]).collect();
        for changes in MENUS {
            if best.excess > 0.0 {
                self.choose(windows, &mut best, &mut menu, &changes)?;
            }
        }
        let mut plans = self.together(&best.sections);
        plans.lambda = (best.frame_prices().sum::<f64>() / self.clip.len() as f64).exp();
        Ok(plans)
    }

    /// Adds plans at prices that differ by `changes` from those of `best` to the `menu` of each section, and the best
    /// choice among all of them: in the first place, and as `best`, if it is better than that.
    fn choose(
        &mut self,
        windows: &Windows,
        best: &mut Attempt,
        menu: &mut [Vec<Variant>],
        changes: &[[f64; 2]],
    ) -> Result<(), EncodeError> {
        let bases: Vec<Prices> = best.prices.iter().map(|prices| prices.iter().collect()).collect();
        for &change in changes {
            let prices = bases.iter().map(|base| base.changed(change)).collect();
            let attempt = self.attempt(windows, prices, best)?;
            menu.iter_mut().zip(self.variants(&attempt)).for_each(|(plans, variant)| plans.push(variant));
        }
        let frames: Vec<Range<usize>> = self.frames_of_sections().collect();
        let chosen = choose(windows, &frames, menu);
        let chosen: Vec<&Variant> = menu.iter().zip(chosen).map(|(plans, plan)| &plans[plan]).collect();
        let prices = chosen.iter().map(|variant| variant.prices.clone()).collect();
        let sections = self.remake(&chosen, best)?;
        let found = self.account(windows, prices, sections)?;
        if found.beats(best) {
            menu.iter_mut().zip(self.variants(&found)).for_each(|(plans, variant)| plans.insert(0, variant));
            *best = found;
        }
        Ok(())
    }

    /// The plans that these were, of which those of `best` are at hand.
    fn remake(&mut self, chosen: &[&Variant], best: &Attempt) -> Result<Vec<Arc<Made>>, EncodeError> {
        chosen.iter().enumerate().for_each(|(index, variant)| self.weigh(index, &variant.recipe.prices));
        self.each(self.sections.len(), |search, index| {
            let recipe = &chosen[index].recipe;
            if best.sections[index].recipe.is(recipe) {
                return Ok(Arc::clone(&best.sections[index]));
            }
            let plans =
                self.cheapest(search, self.sections[index].clone(), 1.0, recipe.quant..=recipe.quant)?;
            Ok(Arc::new(Made { plans, recipe: recipe.clone() }))
        })
    }

    /// What is kept of the plans of each section.
    fn variants<'v>(&'v self, attempt: &'v Attempt) -> impl Iterator<Item = Variant> + 'v {
        self.frames_of_sections().enumerate().map(|(index, frames)| attempt.variant(index, frames))
    }

    fn frames_of_sections(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.sections.iter().map(|section| self.clip.frames_of(section))
    }

    /// The prices of each section.
    fn by_section(&self, prices: Vec<f64>) -> Vec<Prices> {
        self.frames_of_sections().map(|frames| prices[frames].iter().copied().collect()).collect()
    }

    /// Squared degrees that the angles of a period are off.
    fn error(&self, index: usize, plan: &PeriodPlan) -> f64 {
        let of_one = |(bap, way): &(Bap, Way)| {
            let step = i64::from(step(*bap, self.options.steps, plan.quant));
            let off = |(&value, level): (&i32, i32)| {
                self.options.felt(*bap, i64::from(value) - i64::from(level) * step).powi(2)
            };
            self.clip.column(index, *bap).iter().zip(way.levels()).map(off).sum::<f64>()
        };
        let exact = |(bap, _): &&(Bap, Way)| !self.options.anchors.contains(*bap);
        plan.ways.iter().filter(exact).map(of_one).sum()
    }

    /// The plans at these prices, and what they cost, beginning with no others: the quantiser of each section is one that fits
    /// its prices, and that of the one before where ranges that serve both are worth more.
    fn first_attempt(&mut self, windows: &Windows, prices: Vec<Prices>) -> Result<Attempt, EncodeError> {
        prices.iter().enumerate().for_each(|(index, prices)| self.weigh(index, prices));
        let menu = self.each(self.sections.len(), |search, index| {
            let section = self.sections[index].clone();
            let near = self.quants_near(&prices[index]);
            let plans = near.filter_map(|quant| self.with_quant(search, section.clone(), quant, 1.0));
            let plans: Vec<_> = plans.collect();
            if plans.is_empty() { Ok(vec![self.cheapest(search, section, 1.0, QUANTS)?]) } else { Ok(plans) }
        })?;
        let chosen = smooth(&menu, self.options);
        let made = menu.into_iter().zip(chosen).zip(&prices).filter_map(|((mut plans, chosen), prices)| {
            let plans = plans.swap_remove(chosen);
            let recipe = Recipe { prices: prices.clone(), quant: plans.first()?.quant };
            Some(Arc::new(Made { plans, recipe }))
        });
        let made = made.collect();
        self.account(windows, prices, made)
    }

    /// The plans at these prices, and what they cost, where those `before` are known.
    fn attempt(
        &mut self,
        windows: &Windows,
        prices: Vec<Prices>,
        before: &Attempt,
    ) -> Result<Attempt, EncodeError> {
        prices.iter().enumerate().for_each(|(index, prices)| self.weigh(index, prices));
        let sections = self.each(self.sections.len(), |search, index| {
            self.follow(search, index, &prices[index], &before.sections[index])
        })?;
        self.account(windows, prices, sections)
    }

    /// What these plans cost.
    fn account(
        &mut self,
        windows: &Windows,
        prices: Vec<Prices>,
        sections: Vec<Arc<Made>>,
    ) -> Result<Attempt, EncodeError> {
        let (_, report) = self.together(&sections).write(self.clip, self.options)?;
        let bits = report.frame_bits;
        let [excess, most] = windows.excess(&bits);
        let used = most.max(bits.iter().sum::<u64>() as f64 / windows.total);
        let error = |(section, made): (&Range<usize>, &Arc<Made>)| {
            section.clone().zip(&made.plans).map(|(index, plan)| self.error(index, plan)).sum()
        };
        let errors: Vec<f64> = self.sections.iter().zip(&sections).map(error).collect();
        Ok(Attempt { prices, sections, bits, excess, used, error: errors.iter().sum(), errors })
    }

    fn together(&mut self, sections: &[Arc<Made>]) -> Plans {
        sections.iter().enumerate().for_each(|(index, made)| self.weigh(index, &made.recipe.prices));
        let periods = sections.iter().flat_map(|made| made.plans.iter().cloned()).collect();
        let mut plans = Plans { periods, lambda: 1.0, skip: true, filler: Vec::new() };
        self.drop_useless(&mut plans);
        plans
    }

    /// Errors count for less where a bit is dear.
    fn weigh(&mut self, index: usize, prices: &Prices) {
        let frames = self.clip.frames_of(&self.sections[index]);
        for (weight, price) in self.weights[frames].iter_mut().zip(prices.iter()) {
            *weight = (-price).exp();
        }
    }

    /// I planes cost what they cost.
    fn forecast<'p>(&self, prices: &'p [f64], bits: &[u64]) -> Forecast<'p> {
        let mut moving: Vec<f64> = bits.iter().map(|&bits| bits as f64).collect();
        let mut fixed = vec![0.0; moving.len()];
        for index in 0..self.clip.periods() {
            let frame = self.clip.period(index).start;
            std::mem::swap(&mut fixed[frame], &mut moving[frame]);
        }
        // What is left out may be sent at another price.
        moving.iter_mut().for_each(|bits| *bits = bits.max(LEFT_OUT));
        Forecast { before: prices, prices: prices.to_vec(), fixed, moving }
    }

    /// The plans of a section at these prices: the ones before, if they have not changed.
    fn follow(
        &self,
        search: &mut Search,
        index: usize,
        prices: &Prices,
        before: &Arc<Made>,
    ) -> Result<Arc<Made>, EncodeError> {
        if !before.is_stale(prices) {
            return Ok(Arc::clone(before));
        }
        let near = self.quants_near(prices);
        // Another quantiser is a leap in what the section costs, so it changes no further than it must.
        let quant = before.recipe.quant.clamp(*near.start(), *near.end());
        let section = self.sections[index].clone();
        let plans = match self.cheapest(search, section.clone(), 1.0, quant..=quant) {
            Err(EncodeError::OutOfRange { .. }) => self.cheapest(search, section, 1.0, QUANTS)?,
            plans => plans?,
        };
        let quant = plans.first().map_or(quant, |plan| plan.quant);
        Ok(Arc::new(Made { plans, recipe: Recipe { prices: prices.clone(), quant } }))
    }

    /// The quantiser indices that go with prices.
    fn quants_near(&self, prices: &Prices) -> RangeInclusive<u8> {
        let mean = (prices.iter().sum::<f64>() / prices.iter().count().max(1) as f64).exp();
        let fits = index_of_step((mean / LAMBDA_PER_STEP).sqrt(), self.options.steps);
        fits.saturating_sub(1).max(*QUANTS.start())..=(fits + 1).min(*QUANTS.end())
    }
}

/// Which of its plans each section follows so that they cost least, with the ranges that sections of other quantisers than
/// the one before must send.
fn smooth(menu: &[Vec<Vec<PeriodPlan>>], options: &PlanOptions) -> Vec<usize> {
    // Least cost of each plan of a section, and the plan before it.
    let mut ways: Vec<Vec<(f64, usize)>> = Vec::with_capacity(menu.len());
    let quant = |plans: &[PeriodPlan]| plans.first().map(|plan| (plan.quant, plan.ways.len()));
    for (index, section) in menu.iter().enumerate() {
        let reached = section.iter().map(|plans| {
            let before = index.checked_sub(1).map_or(&[][..], |before| &menu[before]);
            let known = ways.last().map_or(&[][..], Vec::as_slice);
            let from = before.iter().zip(known).enumerate().map(|(number, (before, (least, _)))| {
                let saved = if quant(before) == quant(plans) {
                    saved_bits(options, plans[0].ways.len())
                } else {
                    0.0
                };
                (least - saved, number)
            });
            let (least, number) = from.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0));
            (least + cost(plans), number)
        });
        let reached = reached.collect();
        ways.push(reached);
    }
    let last = ways.last().and_then(|ways| (0..ways.len()).min_by(|&a, &b| ways[a].0.total_cmp(&ways[b].0)));
    let mut chosen = last.unwrap_or(0);
    let mut all = Vec::with_capacity(ways.len());
    for ways in ways.iter().rev() {
        all.push(chosen);
        chosen = ways[chosen].1;
    }
    all.reverse();
    all
}
