//! Holding a rate over every ten seconds of a clip.
//!
//! Each frame has a price per bit. A window of ten seconds that costs too much raises the price of all its
//! frames, one that costs too little lowers it, and the periods in which prices changed are planned anew. As errors then
//! weigh the same wherever no window asks for something else, no more is evened out than has to be. What is still beyond
//! its band is mended by a choice among several plans of each period. Too much counts for more than too little, and
//! frames in which there is less to say than the rate has room for are not missed. The live encoder's stream is taken if it
//! is better.

use std::ops::Range;
use std::sync::Arc;

use super::super::error::EncodeError;
use super::super::state::step;
use super::attempt::{Attempt, Made, PRICES, Prices, Recipe};
use super::choice::{Variant, choose};
use super::clip::Clip;
use super::live::write_live;
use super::options::{GRACE, PlanOptions};
use super::path::{Search, Way};
use super::plans::{PeriodPlan, Plans};
use super::report::PlanReport;
use super::search::{Goal, Planner};
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
/// What the logarithms of the prices then differ by, at the start and at the end of each period, between the plans that are
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
    let mut planner = Planner::new(clip, options);
    if windows.spans.is_empty() {
        // An I plane alone is more than a moment's bits.
        let rate = kbit_per_s * (GRACE / clip.seconds).max(1.0);
        let plans = planner.search(Goal::Rate(rate))?;
        let (stream, report) = plans.write(clip, options)?;
        return Ok(Held { stream, report, plans: Some(plans) });
    }
    let mut plans = planner.hold(&windows, kbit_per_s)?;
    let mut planned = plans.write(clip, options)?;
    plans.filler = windows.filler(&planned.1.frame_bits);
    if plans.filler.iter().any(|&planes| planes > 0) {
        planned = plans.write(clip, options)?;
    }
    // Values that lag behind for a moment may be the only way to hold a low rate.
    let (stream, mut report, plans) = match write_live(clip, options) {
        Ok((stream, report)) if better(&windows, &report, &planned.1) => (stream, report, None),
        _ => (planned.0, planned.1, Some(plans)),
    };
    let resting = windows.resting.iter().filter(|&&rests| rests).count();
    report.resting_seconds = resting as f64 / options.rate.per_second();
    report.windows_missed = Some(windows.judge(&report.frame_bits).missed);
    Ok(Held { stream, report, plans })
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
        let mut last = self.attempt(windows, self.by_period(prices), None)?;
        let mut best = last.clone();
        for round in 0..ROUNDS {
            if best.excess == 0.0 && best.used > USED {
                break;
            }
            let part = if round == 0 { 1.0 } else { PART };
            let before: Vec<f64> = last.frame_prices().collect();
            let next = windows.next(self.forecast(&before, &last.bits), true);
            let prices = before.iter().zip(next).map(|(price, next)| price + part * (next - price));
            last = self.attempt(windows, self.by_period(prices.collect()), Some(&last))?;
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
        let mut plans = self.together(&best.periods);
        plans.lambda = (best.frame_prices().sum::<f64>() / self.clip.len() as f64).exp();
        Ok(plans)
    }

    /// Adds plans at prices that differ by `changes` from those of `best` to the `menu` of each period, and the best
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
            let attempt = self.attempt(windows, prices, Some(best))?;
            menu.iter_mut().zip(self.variants(&attempt)).for_each(|(plans, variant)| plans.push(variant));
        }
        let frames: Vec<Range<usize>> =
            (0..self.clip.periods()).map(|index| self.clip.period(index)).collect();
        let chosen = choose(windows, &frames, menu);
        let chosen: Vec<&Variant> = menu.iter().zip(chosen).map(|(plans, plan)| &plans[plan]).collect();
        let prices = chosen.iter().map(|variant| variant.prices.clone()).collect();
        let periods = self.remake(&chosen, best)?;
        let found = self.account(windows, prices, periods)?;
        if found.beats(best) {
            menu.iter_mut().zip(self.variants(&found)).for_each(|(plans, variant)| plans.insert(0, variant));
            *best = found;
        }
        Ok(())
    }

    /// The plans that these were, of which those of `best` are at hand.
    fn remake(&mut self, chosen: &[&Variant], best: &Attempt) -> Result<Vec<Arc<Made>>, EncodeError> {
        chosen.iter().enumerate().for_each(|(index, variant)| self.weigh(index, &variant.recipe.prices));
        self.each_period(|search, index| {
            let recipe = &chosen[index].recipe;
            if best.periods[index].recipe.is(recipe) {
                return Ok(Arc::clone(&best.periods[index]));
            }
            let plan = self.cheapest(search, index, 1.0, recipe.quant..=recipe.quant)?;
            Ok(Arc::new(Made { plan, recipe: recipe.clone() }))
        })
    }

    /// What is kept of the plan of each period.
    fn variants<'v>(&'v self, attempt: &'v Attempt) -> impl Iterator<Item = Variant> + 'v {
        (0..self.clip.periods()).map(|index| attempt.variant(index, self.clip.period(index)))
    }

    /// The prices of each period.
    fn by_period(&self, prices: Vec<f64>) -> Vec<Prices> {
        let of_one = |index| prices[self.clip.period(index)].iter().copied().collect();
        (0..self.clip.periods()).map(of_one).collect()
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

    /// The plans at these prices, and what they cost.
    fn attempt(
        &mut self,
        windows: &Windows,
        prices: Vec<Prices>,
        before: Option<&Attempt>,
    ) -> Result<Attempt, EncodeError> {
        let known = |index: usize| before.and_then(|before| before.periods.get(index));
        prices.iter().enumerate().for_each(|(index, prices)| self.weigh(index, prices));
        let periods =
            self.each_period(|search, index| self.follow(search, index, &prices[index], known(index)))?;
        self.account(windows, prices, periods)
    }

    /// What these plans cost.
    fn account(
        &mut self,
        windows: &Windows,
        prices: Vec<Prices>,
        periods: Vec<Arc<Made>>,
    ) -> Result<Attempt, EncodeError> {
        let (_, report) = self.together(&periods).write(self.clip, self.options)?;
        let bits = report.frame_bits;
        let [excess, most] = windows.excess(&bits);
        let used = most.max(bits.iter().sum::<u64>() as f64 / windows.total);
        let errors: Vec<f64> =
            periods.iter().enumerate().map(|(index, made)| self.error(index, &made.plan)).collect();
        Ok(Attempt { prices, periods, bits, excess, used, error: errors.iter().sum(), errors })
    }

    fn together(&mut self, periods: &[Arc<Made>]) -> Plans {
        periods.iter().enumerate().for_each(|(index, made)| self.weigh(index, &made.recipe.prices));
        let periods = periods.iter().map(|made| made.plan.clone()).collect();
        let mut plans = Plans { periods, lambda: 1.0, skip: true, filler: Vec::new() };
        self.drop_useless(&mut plans);
        plans
    }

    /// Errors count for less where a bit is dear.
    fn weigh(&mut self, index: usize, prices: &Prices) {
        for (weight, price) in self.weights[self.clip.period(index)].iter_mut().zip(prices.iter()) {
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

    /// The plan of a period at these prices: the one before, if they have not changed.
    fn follow(
        &self,
        search: &mut Search,
        index: usize,
        prices: &Prices,
        before: Option<&Arc<Made>>,
    ) -> Result<Arc<Made>, EncodeError> {
        if let Some(made) = before.filter(|made| !made.is_stale(prices)) {
            return Ok(Arc::clone(made));
        }
        let mean = (prices.iter().sum::<f64>() / self.clip.period(index).len() as f64).exp();
        let fits = index_of_step((mean / LAMBDA_PER_STEP).sqrt(), self.options.steps);
        let near = fits.saturating_sub(1).max(*QUANTS.start())..=(fits + 1).min(*QUANTS.end());
        let quants = match before {
            // Another quantiser is a leap in what the period costs, so it changes no further than it must.
            Some(made) => [made.plan.quant.clamp(*near.start(), *near.end()); 2],
            None => [*near.start(), *near.end()],
        };
        let plan = match self.cheapest(search, index, 1.0, quants[0]..=quants[1]) {
            Err(EncodeError::OutOfRange { .. }) => self.cheapest(search, index, 1.0, QUANTS)?,
            plan => plan?,
        };
        let recipe = Recipe { prices: prices.clone(), quant: plan.quant };
        Ok(Arc::new(Made { plan, recipe }))
    }
}
