//! Holding a rate over every ten seconds of a clip.
//!
//! Each frame has a price per bit. A window of ten seconds that costs too much raises the price of all its
//! frames, one that costs too little lowers it, and the periods in which prices changed are planned anew, until
//! every window is within its band. As errors then weigh the same wherever no window asks for something else, no
//! more is evened out than has to be.

use std::ops::Range;

use super::super::error::EncodeError;
use super::plans::{PeriodPlan, Plans};
use super::search::{Goal, Planner};
use super::steering::{FIRST_LAMBDA, QUANTS, index_of_step};
use super::{GRACE, PlanReport, WINDOW};

/// Shares of its bits between which every window is to be kept, and between which it is planned to be.
const HELD: [f64; 2] = [0.954, 1.046];
const PLANNED: [f64; 2] = [0.965, 1.035];
/// The same for the clip as a whole, as far as no window is in the way.
const MEAN: [f64; 2] = [0.985, 1.0];
/// Times plans are made anew at most, and times on end without a better result.
const ROUNDS: usize = 40;
const PATIENCE: usize = 8;
/// Times all windows are looked at to find the next prices.
const SWEEPS: usize = 40;
/// How many bits of P planes follow a price: the power of it that they fall with.
const ELASTICITY: f64 = 0.5;
/// Largest change of a price in one round, as a logarithm, and the one from which on a period is planned anew.
const STRIDE: f64 = 1.0;
/// Bits that a frame left out counts for.
const LEFT_OUT: f64 = 1.0;
const STALE: f64 = 0.01;
/// Bounds of prices, squared degrees per bit. At the lower one the finest quantiser is used.
const PRICES: [f64; 2] = [1e-3, 1e3];
/// λ over the squared step of a finger bend at which plans end when any step may be chosen.
const LAMBDA_PER_STEP: f64 = 0.35;

/// How far off a quantiser index may be before another one is chosen.
const NEAR: u8 = 3;

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

    /// Bits beyond the bands, all windows and the whole clip together.
    fn excess(&self, sums: &Sums) -> f64 {
        let beyond = |span: &Range<usize>| {
            let share = sums.of(span) / self.bits;
            (share - HELD[1]).max(HELD[0] - share).max(0.0)
        };
        self.spans.iter().map(beyond).sum()
    }
}

/// Bits before each frame.
struct Sums(Vec<u64>);

impl Sums {
    fn new(bits: impl Iterator<Item = u64>) -> Self {
        let mut sums = vec![0];
        sums.extend(bits.scan(0, |sum, bits| {
            *sum += bits;
            Some(*sum)
        }));
        Self(sums)
    }

    fn of(&self, span: &Range<usize>) -> f64 {
        (self.0[span.end] - self.0[span.start]) as f64
    }

    fn total(&self) -> f64 {
        self.0.last().copied().unwrap_or(0) as f64
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
    fn level(&mut self) {
        let bits: f64 = self.moving.iter().sum();
        let sum: f64 = self.prices.iter().zip(&self.moving).map(|(price, bits)| price * bits).sum();
        (0..self.prices.len()).for_each(|frame| self.set(frame, sum / bits));
    }

    fn sum(&self, span: Range<usize>) -> [f64; 2] {
        [&self.fixed, &self.moving].map(|bits| bits[span.clone()].iter().sum())
    }

    /// Changes the prices of all frames of each span so that it costs between `least` and `most` bits, if it
    /// does not. True if all do.
    fn hold(&mut self, spans: &[Range<usize>], [least, most]: [f64; 2]) -> bool {
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
            let change = (moving.max(1.0) / (wanted - fixed).max(0.02 * wanted)).ln() / ELASTICITY;
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
    fn next(&self, mut forecast: Forecast<'_>) -> Vec<f64> {
        let all = [0..forecast.prices.len()];
        let [low, high] = PLANNED.map(|share| share * self.bits);
        forecast.level();
        for _ in 0..SWEEPS {
            // What comes last counts most: too much is worse than too little.
            let held = [
                forecast.hold(&all, MEAN.map(|share| share * self.total)),
                forecast.hold(&self.spans, [low, f64::INFINITY]),
                forecast.hold(&self.spans, [0.0, high]),
            ];
            if held == [true; 3] {
                break;
            }
        }
        forecast.prices
    }
}

/// The plan of a period, the prices it was made for, and the one its quantiser was chosen at.
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
        let mut prices = vec![price; self.clip.frames.len()];
        let mut made: Vec<Option<Made>> = (0..self.clip.periods()).map(|_| None).collect();
        let mut best: Option<([f64; 2], usize, Plans)> = None;
        for round in 0..ROUNDS {
            let plans = self.follow(&prices, &mut made)?;
            let (_, report) = plans.write(self.clip, self.options)?;
            let bits = Sums::new(report.frame_bits.iter().copied());
            let excess = windows.excess(&bits);
            let mean = bits.total() / windows.total;
            let held = excess == 0.0 && mean >= MEAN[0] && mean <= MEAN[1];
            let score = [excess, report.rms_degrees];
            if std::env::var("HOLD").is_ok() {
                let s: Vec<f64> = windows.spans.iter().map(|s| bits.of(s) / windows.bits).collect();
                eprintln!("{round} excess {excess:.3} {:.3} {:.3} mean {:.4} rms {:.4} {:?}", s.iter().copied().fold(f64::INFINITY, f64::min), s.iter().copied().fold(0.0, f64::max), bits.total() / windows.total, report.rms_degrees, report.quants);
            }
            if best.as_ref().is_none_or(|(least, ..)| score < *least) {
                best = Some((score, round, plans));
            }
            if held || best.as_ref().is_some_and(|(_, found, _)| found + PATIENCE < round) {
                break;
            }
            prices = windows.next(self.forecast(&prices, &report));
        }
        best.map(|(.., plans)| plans).ok_or(EncodeError::NoIntra)
    }

    /// I planes cost what they cost.
    fn forecast<'p>(&self, prices: &'p [f64], report: &PlanReport) -> Forecast<'p> {
        let mut moving: Vec<f64> = report.frame_bits.iter().map(|&bits| bits as f64).collect();
        let mut fixed = vec![0.0; moving.len()];
        for index in 0..self.clip.periods() {
            let frame = self.clip.period(index).start;
            std::mem::swap(&mut fixed[frame], &mut moving[frame]);
        }
        // What is left out may be sent at another price.
        moving.iter_mut().for_each(|bits| *bits = bits.max(LEFT_OUT));
        Forecast { before: prices, prices: prices.to_vec(), fixed, moving }
    }

    /// Makes the plans anew whose prices have changed.
    fn follow(&mut self, prices: &[f64], made: &mut [Option<Made>]) -> Result<Plans, EncodeError> {
        for (index, made) in made.iter_mut().enumerate() {
            let frames = self.clip.period(index);
            let wanted = &prices[frames.clone()];
            let stale = |made: &Made| made.prices.iter().zip(wanted).any(|(a, b)| (a - b).abs() > STALE);
            if made.as_ref().is_some_and(|made| !stale(made)) {
                continue;
            }
            for (weight, price) in self.weights[frames].iter_mut().zip(wanted) {
                *weight = (-price).exp();
            }
            let mean = (wanted.iter().sum::<f64>() / wanted.len() as f64).exp();
            let fits = index_of_step((mean / LAMBDA_PER_STEP).sqrt(), self.options.steps);
            let near = |made: &&Made| made.plan.quant.abs_diff(fits) <= NEAR;
            let again = made.as_ref().filter(near);
            let plan = again.and_then(|made| self.period(index, made.plan.quant, 1.0, Some(&made.plan)));
            let plan = match plan {
                Some(plan) => plan,
                None => {
                    let from = fits.saturating_sub(1).max(*QUANTS.start());
                    self.cheapest(index, 1.0, from..=(fits + 1).min(*QUANTS.end()))?
                }
            };
            *made = Some(Made { plan, prices: wanted.to_vec() });
        }
        let periods = made.iter().flatten().map(|made| made.plan.clone()).collect();
        let mut plans = Plans { periods, lambda: 1.0, skip: true };
        self.drop_useless(&mut plans);
        Ok(plans)
    }
}
