//! Holding a rate over every ten seconds of a clip.
//!
//! Each frame has a price per bit. A window of ten seconds that costs too much raises the price of all its
//! frames, one that costs too little lowers it, and the periods in which prices changed are planned anew, until
//! every window is within its band, or no better prices are found. As errors then weigh the same wherever no window
//! asks for something else, no more is evened out than has to be. Too much counts for more than too little, and a
//! window in which prices are as low as they go may cost too little.

use std::ops::Range;

use super::super::error::EncodeError;
use super::plans::{PeriodPlan, Plans};
use super::search::{Goal, Planner};
use super::steering::{FIRST_LAMBDA, QUANTS, index_of_step};
use super::{GRACE, WINDOW};

/// Shares of its bits between which every window is to be kept, and between which it is planned to be.
const HELD: [f64; 2] = [0.951, 1.049];
const PLANNED: [f64; 2] = [0.962, 1.038];
/// The same for the clip as a whole, as far as no window is in the way.
const MEAN: [f64; 2] = [0.99, 0.996];
/// Times plans are made anew at most, and times on end without a better result.
const ROUNDS: usize = 24;
const PATIENCE: usize = 8;
/// Rounds in which prices are evened out before windows change them.
const LEVEL: usize = 10;
/// Part of the way to the next prices that is gone after the first time, and what it is multiplied with when that
/// did better, or did not.
const PART: f64 = 0.6;
const LONGER: f64 = 1.5;
const SHORTER: f64 = 0.8;
/// The largest share too little that counts: windows in which there is no more to say do not hide the others.
const TOO_LITTLE: f64 = 0.05;
/// What a share too much counts for in shares too little.
const TOO_MUCH: f64 = 20.0;
/// Times all windows are looked at to find the next prices.
const SWEEPS: usize = 30;
/// Sweeps after which steps are half as long.
const SLOWER: f64 = 6.0;
/// Frames from one window that is looked at then to the next.
const APART: usize = 5;
/// How many bits of P planes follow a price: the power of it that they fall with.
const ELASTICITY: f64 = 0.5;
/// Largest change of a price in one round, as a logarithm, and the one from which on a period is planned anew.
const STRIDE: f64 = 1.0;
const STALE: f64 = 0.01;
/// One frame in so many at the lowest price says that there is no more to say in a window.
const RESTS: usize = 20;
/// Bits that a frame left out counts for.
const LEFT_OUT: f64 = 1.0;
/// Bounds of prices, squared degrees per bit. At the lower one the finest quantiser is used.
const PRICES: [f64; 2] = [1e-3, 1e3];
/// λ over the squared step of a finger bend at which plans end when any step may be chosen.
const LAMBDA_PER_STEP: f64 = 0.35;

/// The windows of a clip that the rate is held in.
struct Windows {
    /// Frames of each, moving on.
    spans: Vec<Range<usize>>,
    /// Bits of a window, and of the whole clip.
    bits: f64,
    total: f64,
}

impl Windows {
    /// Windows that begin with a frame or right behind it: no other costs more, or less.
    fn new(ticks: &[u64], rate: f64, kbit_per_s: f64) -> Self {
        let window = (WINDOW * rate).round().max(1.0) as u64;
        let first = (GRACE * rate).floor() as u64;
        let end = ticks.last().map_or(0, |last| last + 1);
        let mut spans: Vec<Range<usize>> = Vec::new();
        for start in ticks.iter().flat_map(|&tick| [tick, tick + 1]) {
            if start < first || start + window > end {
                continue;
            }
            let span = ticks.partition_point(|&tick| tick < start)
                ..ticks.partition_point(|&tick| tick < start + window);
            if spans.last() != Some(&span) {
                spans.push(span);
            }
        }
        let per_tick = kbit_per_s * 1000.0 / rate;
        Self { spans, bits: per_tick * window as f64, total: per_tick * end as f64 }
    }

    /// Shares by which windows cost too much and too little, those of all windows together. Too much is worse, as
    /// too little may be all there is to say.
    fn excess(&self, bits: &[u64], prices: &[f64]) -> f64 {
        let mut sums = Running::default();
        let beyond = |span| {
            sums.move_to(span, |frame| bits[frame] as f64);
            let share = sums.sum / self.bits;
            if share < HELD[0] && rests(span, prices) {
                return 0.0;
            }
            TOO_MUCH * (share - HELD[1]).max(0.0) + (HELD[0] - share).clamp(0.0, TOO_LITTLE)
        };
        self.spans.iter().map(beyond).sum()
    }
}

/// Least and most kilobits per second of any window; none if the clip is too short for one.
pub(super) fn extremes(ticks: &[u64], bits: &[u64], rate: f64) -> Option<[f64; 2]> {
    let windows = Windows::new(ticks, rate, 1.0);
    let mut sums = Running::default();
    windows.spans.iter().fold(None, |found, span| {
        sums.move_to(span, |frame| bits[frame] as f64);
        let rate = sums.sum / windows.bits;
        Some(found.map_or([rate; 2], |[least, most]: [f64; 2]| [least.min(rate), most.max(rate)]))
    })
}

/// The sum over a span that moves on.
#[derive(Default)]
struct Running {
    span: Range<usize>,
    sum: f64,
}

impl Running {
    fn move_to(&mut self, span: &Range<usize>, value: impl Fn(usize) -> f64) {
        self.sum += (self.span.end..span.end).map(&value).sum::<f64>();
        self.sum -= (self.span.start..span.start).map(&value).sum::<f64>();
        self.span = span.clone();
    }
}

/// Whether a price, as a logarithm, is as low as it goes.
fn at_floor(price: f64) -> bool {
    price < PRICES[0].ln() + 0.1
}

/// Whether a window holds so many frames at the lowest price that it may cost too little.
fn rests(span: &Range<usize>, prices: &[f64]) -> bool {
    prices[span.clone()].iter().filter(|&&price| at_floor(price)).count() * RESTS > span.len()
}

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
    fn level(&mut self) {
        let bits: f64 = self.moving.iter().sum();
        let sum: f64 = self.prices.iter().zip(&self.moving).map(|(price, bits)| price * bits).sum();
        for frame in (0..self.prices.len()).filter(|&frame| !at_floor(self.before[frame])) {
            self.set(frame, sum / bits);
        }
    }

    fn sum(&self, span: Range<usize>) -> [f64; 2] {
        [&self.fixed, &self.moving].map(|bits| bits[span.clone()].iter().sum())
    }

    /// Changes the prices of all frames of each span so that it costs between `least` and `most` bits, if it
    /// does not, or by a `step` of that. True if all do.
    fn hold(&mut self, spans: &[Range<usize>], [least, most]: [f64; 2], step: f64) -> bool {
        let mut held = true;
        let mut at = 0..0;
        let mut sum = [0.0; 2];
        for span in spans {
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
        let all = std::slice::from_ref(&whole);
        let spans: Vec<Range<usize>> = self.spans.iter().step_by(APART).cloned().collect();
        let lively: Vec<Range<usize>> =
            spans.iter().filter(|span| !rests(span, forecast.before)).cloned().collect();
        let [low, high] = PLANNED.map(|share| share * self.bits);
        if level {
            forecast.level();
        }
        for sweep in 0..SWEEPS {
            // Ever smaller steps, as there may be no prices at which all are held.
            let step = 1.0 / (1.0 + sweep as f64 / SLOWER);
            // What comes last counts most: too much is worse than too little.
            let held = [
                // Later only what is near a window that is not held changes: each plan made anew costs a little more
                // or less than foreseen.
                !level || forecast.hold(all, MEAN.map(|share| share * self.total), step),
                forecast.hold(&lively, [low, f64::INFINITY], step),
                forecast.hold(&spans, [0.0, high], 1.0),
            ];
            if held == [true; 3] {
                break;
            }
        }
        forecast.prices
    }
}

/// Plans at some prices, and what they cost.
struct Attempt {
    prices: Vec<f64>,
    periods: Vec<Made>,
    bits: Vec<u64>,
    excess: f64,
}

/// The plan of a period, and the prices it was made for.
#[derive(Clone)]
struct Made {
    plan: PeriodPlan,
    prices: Vec<f64>,
}

impl Planner<'_> {
    /// Plans that spend `kbit_per_s` in every window, or in the whole of a clip too short for one.
    pub fn hold(&mut self, kbit_per_s: f64) -> Result<Plans, EncodeError> {
        let rate = self.options.rate.per_second();
        let windows = Windows::new(&self.clip.ticks, rate, kbit_per_s);
        if windows.spans.is_empty() {
            return self.search(Goal::Rate(kbit_per_s));
        }
        let price = (FIRST_LAMBDA / kbit_per_s.powi(3)).clamp(PRICES[0], PRICES[1]).ln();
        let mut best = self.attempt(&windows, vec![price; self.clip.frames.len()], None)?;
        let (mut part, mut since) = (1.0, 0);
        for round in 0..ROUNDS {
            if best.excess == 0.0 || since > PATIENCE {
                break;
            }
            let first = round < LEVEL;
            let next = windows.next(self.forecast(&best.prices, &best.bits), first);
            let prices = best.prices.iter().zip(next).map(|(price, next)| price + part * (next - price));
            let found = self.attempt(&windows, prices.collect(), Some(&best))?;
            since = if found.excess < 0.99 * best.excess { 0 } else { since + 1 };
            // First prices find their height; then only what is better is kept, and where nothing is, smaller steps are
            // made from there.
            if first {
                (part, since) = (PART, 0);
            } else {
                part = if since == 0 { (LONGER * part).min(1.0) } else { SHORTER * part };
            }
            if first || found.excess < best.excess {
                best = found;
            }
        }
        let mut plans = self.together(&best.periods);
        plans.lambda = (best.prices.iter().sum::<f64>() / best.prices.len() as f64).exp();
        Ok(plans)
    }

    /// The plans at these prices, and what they cost.
    fn attempt(
        &mut self,
        windows: &Windows,
        prices: Vec<f64>,
        before: Option<&Attempt>,
    ) -> Result<Attempt, EncodeError> {
        let periods: Vec<Made> = (0..self.clip.periods())
            .map(|index| self.follow(index, &prices, before.and_then(|before| before.periods.get(index))))
            .collect::<Result<_, _>>()?;
        let (_, report) = self.together(&periods).write(self.clip, self.options)?;
        let excess = windows.excess(&report.frame_bits, &prices);
        Ok(Attempt { prices, periods, bits: report.frame_bits, excess })
    }

    fn together(&mut self, periods: &[Made]) -> Plans {
        periods.iter().enumerate().for_each(|(index, made)| self.weigh(index, &made.prices));
        let periods = periods.iter().map(|made| made.plan.clone()).collect();
        let mut plans = Plans { periods, lambda: 1.0, skip: true };
        self.drop_useless(&mut plans);
        plans
    }

    /// Errors count for less where a bit is dear.
    fn weigh(&mut self, index: usize, prices: &[f64]) {
        for (weight, price) in self.weights[self.clip.period(index)].iter_mut().zip(prices) {
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
    fn follow(&mut self, index: usize, prices: &[f64], before: Option<&Made>) -> Result<Made, EncodeError> {
        let frames = self.clip.period(index);
        let prices = &prices[frames];
        let stale = |made: &Made| made.prices.iter().zip(prices).any(|(a, b)| (a - b).abs() > STALE);
        if let Some(made) = before.filter(|made| !stale(made)) {
            return Ok(made.clone());
        }
        self.weigh(index, prices);
        let mean = (prices.iter().sum::<f64>() / prices.len() as f64).exp();
        let fits = index_of_step((mean / LAMBDA_PER_STEP).sqrt(), self.options.steps);
        let near = fits.saturating_sub(1).max(*QUANTS.start())..=(fits + 1).min(*QUANTS.end());
        let quants = match before {
            // Another quantiser is a leap in what the period costs, so it changes no further than it must.
            Some(made) => [made.plan.quant.clamp(*near.start(), *near.end()); 2],
            None => [*near.start(), *near.end()],
        };
        let plan = match self.cheapest(index, 1.0, quants[0]..=quants[1]) {
            Err(EncodeError::OutOfRange { .. }) => self.cheapest(index, 1.0, QUANTS)?,
            plan => plan?,
        };
        Ok(Made { plan, prices: prices.to_vec() })
    }
}
