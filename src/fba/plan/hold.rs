//! Holding a rate over every ten seconds of a clip.
//!
//! Each frame has a price per bit. A window of ten seconds that costs too much raises the price of all its
//! frames, one that costs too little lowers it, and the periods in which prices changed are planned anew, until
//! every window is within its band, or no better prices are found. As errors then weigh the same wherever no window
//! asks for something else, no more is evened out than has to be. Too much counts for more than too little, and a
//! window in which prices are as low as they go may cost too little.

use std::ops::Range;

use super::super::error::EncodeError;
use super::super::state::step;
use super::choice::{Variant, choose};
use super::path::Path;
use super::plans::{PeriodPlan, Plans};
use super::search::{Goal, Planner};
use super::steering::{FIRST_LAMBDA, QUANTS, index_of_step};
use super::{GRACE, WINDOW, degrees_of};
use crate::bap::{Bap, BapFrame};

/// Shares of its bits between which every window is to be kept, and between which it is planned to be.
const HELD: [f64; 2] = [0.951, 1.049];
const PLANNED: [f64; 2] = [0.962, 1.038];
/// The same for the clip as a whole, as far as no window is in the way.
const MEAN: [f64; 2] = [0.99, 0.996];
/// The share of its bits that a clip, or a window of it, must use where it can.
const USED: f64 = 0.985;
/// Times prices are made anew at most, and part of the way to the next ones that is gone after the first time.
const ROUNDS: usize = 10;
const PART: f64 = 0.6;
/// What the logarithms of the prices then differ by between the plans of a period that are chosen from.
const MENUS: [[f64; 6]; 2] = [[-1.0, -0.5, -0.2, 0.2, 0.5, 1.0], [-0.4, -0.2, -0.1, 0.1, 0.2, 0.4]];
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
/// A frame rests if the second around it costs less than this share of what the rate gives it, however finely it is
/// coded.
const RESTS: f64 = 0.95;
/// Bits that a frame left out counts for.
const LEFT_OUT: f64 = 1.0;
/// Bounds of prices, squared degrees per bit. At the lower one the finest quantiser is used.
const PRICES: [f64; 2] = [1e-3, 1e3];
/// λ over the squared step of a finger bend at which plans end when any step may be chosen.
const LAMBDA_PER_STEP: f64 = 0.35;

/// The windows of a clip that the rate is held in.
pub(super) struct Windows {
    /// Frames of each, moving on.
    pub spans: Vec<Range<usize>>,
    /// Share of each in which there is something to say.
    pub lively: Vec<f64>,
    /// Frames in which there is not.
    resting: Vec<bool>,
    /// Bits of a window, and of the whole clip.
    pub bits: f64,
    pub total: f64,
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
        Self {
            lively: vec![1.0; spans.len()],
            resting: vec![false; ticks.len()],
            bits: per_tick * window as f64,
            total: per_tick * end as f64,
            spans,
        }
    }

    /// Takes note of the frames that rest.
    fn rest(&mut self, resting: Vec<bool>) {
        let mut sums = Running::default();
        for (span, lively) in self.spans.iter().zip(&mut self.lively) {
            sums.move_to(span, |frame| f64::from(u8::from(resting[frame])));
            *lively = 1.0 - sums.sum / span.len().max(1) as f64;
        }
        self.resting = resting;
    }

    /// Share by which a window of so many bits costs too much, or too little for what moves in it, at shares `held`.
    /// Too much counts for more.
    pub fn beyond(&self, span: usize, bits: f64, held: [f64; 2]) -> f64 {
        let share = bits / self.bits;
        TOO_MUCH * (share - held[1]).max(0.0) + (held[0] * self.lively[span] - share).max(0.0)
    }

    /// What all windows are beyond the band, and the largest share of its bits that one of them costs.
    fn excess(&self, bits: &[u64]) -> [f64; 2] {
        let mut sums = Running::default();
        self.spans.iter().enumerate().fold([0.0; 2], |[excess, most], (index, span)| {
            sums.move_to(span, |frame| bits[frame] as f64);
            [excess + self.beyond(index, sums.sum, HELD), most.max(sums.sum / self.bits)]
        })
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
pub(super) struct Running {
    span: Range<usize>,
    pub sum: f64,
}

impl Running {
    /// The empty span that begins with this frame.
    pub fn at(frame: usize) -> Self {
        Self { span: frame..frame, sum: 0.0 }
    }

    pub fn move_to(&mut self, span: &Range<usize>, value: impl Fn(usize) -> f64) {
        self.sum += (self.span.end..span.end).map(&value).sum::<f64>();
        self.sum -= (self.span.start..span.start).map(&value).sum::<f64>();
        self.span = span.clone();
    }
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

/// Plans at some prices, and what they cost.
#[derive(Clone)]
struct Attempt {
    prices: Vec<f64>,
    periods: Vec<Made>,
    bits: Vec<u64>,
    /// What windows are beyond the band, and the most that one of them costs, or the whole clip, as a share.
    excess: f64,
    used: f64,
    /// Squared degrees.
    error: f64,
}

impl Attempt {
    fn beats(&self, other: &Self) -> bool {
        self.excess < other.excess || self.excess == other.excess && self.error < other.error
    }
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
        let mut windows = Windows::new(&self.clip.ticks, rate, kbit_per_s);
        if windows.spans.is_empty() {
            return self.search(Goal::Rate(kbit_per_s));
        }
        windows.rest(self.resting(kbit_per_s * 1000.0 / rate)?);
        let price = (FIRST_LAMBDA / kbit_per_s.powi(3)).clamp(PRICES[0], PRICES[1]).ln();
        let floor = PRICES[0].ln();
        let prices = windows.resting.iter().map(|&rests| if rests { floor } else { price }).collect();
        let mut last = self.attempt(&windows, prices, None)?;
        let mut best = last.clone();
        for round in 0..ROUNDS {
            if best.excess == 0.0 && best.used > USED {
                break;
            }
            let part = if round == 0 { 1.0 } else { PART };
            let next = windows.next(self.forecast(&last.prices, &last.bits), true);
            let prices = last.prices.iter().zip(next).map(|(price, next)| price + part * (next - price));
            last = self.attempt(&windows, prices.collect(), Some(&last))?;
            if last.beats(&best) {
                best = last.clone();
            }
        }
        for changes in MENUS {
            if best.excess > 0.0 {
                best = self.choose(&windows, best, &changes)?;
            }
        }
        let mut plans = self.together(&best.periods);
        plans.lambda = (best.prices.iter().sum::<f64>() / best.prices.len() as f64).exp();
        Ok(plans)
    }

    /// Frames in which there is less to say than the rate has room for.
    fn resting(&self, per_tick: f64) -> Result<Vec<bool>, EncodeError> {
        let mut finest = Plans::rounded(self.clip, self.options, *QUANTS.start())?;
        finest.skip = true;
        let (_, report) = finest.write(self.clip, self.options)?;
        let ticks = &self.clip.ticks;
        let mut bits = report.frame_bits;
        let mut intra = 0;
        for index in 0..self.clip.periods() {
            intra += std::mem::take(&mut bits[self.clip.period(index).start]);
        }
        let end = ticks.last().map_or(1, |last| last + 1);
        let room = RESTS * (per_tick - intra as f64 / end as f64);
        let half = (0.5 * self.options.rate.per_second()) as u64;
        let mut sums = Running::default();
        let rests = ticks.iter().map(|&tick| {
            let span = ticks.partition_point(|&other| other + half < tick)
                ..ticks.partition_point(|&other| other <= tick + half);
            sums.move_to(&span, |frame| bits[frame] as f64);
            sums.sum < room * span.len() as f64
        });
        Ok(rests.collect())
    }

    /// The best choice among plans at these prices and at others that differ by `changes`.
    fn choose(&mut self, windows: &Windows, best: Attempt, changes: &[f64]) -> Result<Attempt, EncodeError> {
        let mut attempts = Vec::with_capacity(changes.len());
        for change in changes {
            let prices =
                best.prices.iter().map(|price| (price + change).clamp(PRICES[0].ln(), PRICES[1].ln()));
            attempts.push(self.attempt(windows, prices.collect(), Some(&best))?);
        }
        attempts.insert(0, best);
        let frames: Vec<Range<usize>> =
            (0..self.clip.periods()).map(|index| self.clip.period(index)).collect();
        let menu: Vec<Vec<Variant>> = frames
            .iter()
            .enumerate()
            .map(|(index, frames)| {
                let variant = |attempt: &Attempt| Variant {
                    bits: attempt.bits[frames.clone()].to_vec(),
                    error: self.error(index, &attempt.periods[index].plan),
                };
                attempts.iter().map(variant).collect()
            })
            .collect();
        let chosen = choose(windows, &frames, &menu);
        let mut prices = Vec::with_capacity(self.clip.frames.len());
        let mut periods = Vec::with_capacity(frames.len());
        for ((index, frames), plan) in frames.iter().enumerate().zip(chosen) {
            prices.extend_from_slice(&attempts[plan].prices[frames.clone()]);
            periods.push(attempts[plan].periods[index].clone());
        }
        let found = self.account(windows, prices, periods)?;
        let best = attempts.swap_remove(0);
        Ok(if found.beats(&best) { found } else { best })
    }

    /// Squared degrees that the angles of a period are off.
    fn error(&self, index: usize, plan: &PeriodPlan) -> f64 {
        let frames = &self.clip.frames[self.clip.period(index)];
        let of_one = |(bap, path): &(Bap, Path)| {
            let step = i64::from(step(*bap, self.options.steps, plan.quant));
            let off = |(frame, &level): (&BapFrame, &i32)| {
                degrees_of(*bap, i64::from(frame.value(*bap)) - i64::from(level) * step).powi(2)
            };
            frames.iter().zip(&path.levels).map(off).sum::<f64>()
        };
        plan.paths.iter().map(of_one).sum()
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
        self.account(windows, prices, periods)
    }

    /// What these plans cost.
    fn account(
        &mut self,
        windows: &Windows,
        prices: Vec<f64>,
        periods: Vec<Made>,
    ) -> Result<Attempt, EncodeError> {
        let (_, report) = self.together(&periods).write(self.clip, self.options)?;
        let bits = report.frame_bits;
        let [excess, most] = windows.excess(&bits);
        let used = most.max(bits.iter().sum::<u64>() as f64 / windows.total);
        let error = periods.iter().enumerate().map(|(index, made)| self.error(index, &made.plan)).sum();
        Ok(Attempt { prices, periods, bits, excess, used, error })
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
