//! Holding a rate over every ten seconds of a clip.
//!
//! Each frame has a price per bit. A window of ten seconds that costs too much raises the price of all its
//! frames, one that costs too little lowers it, and the sections in which prices changed are planned anew: I periods, each
//! with those that begin for the sake of a leap in it, which share its quantiser, so that its ranges serve them. As errors then
//! weigh the same wherever no window asks for something else, no more is evened out than has to be.
//!
//! Another quantiser needs all range arrays, at 1 kbit/s a tenth of what ten seconds may cost. So once prices are about right,
//! the quantiser of each section is settled, few of them and with no change that is not worth its leap, and which I planes send
//! which arrays. From there on the bits of a plan hardly depend on its neighbours (arrays that several I planes
//! share are as wide as the widest of them needs), how they follow a price is
//! learnt section by section, and what is still beyond its band is mended by a choice among all plans made of each
//! section, near such windows of more of them, in the end everywhere of some for less error. Too much counts for more than
//! too little, and frames in which there is less to say than the rate has room for are not missed. The live encoder's stream
//! is taken if it is better.

use std::ops::Range;
use std::sync::Arc;

use super::super::error::EncodeError;
use super::super::state::step;
use super::attempt::{Attempt, Made, PRICES, Prices, changed, mean};
use super::choice::{MOST, Variant, choose};
use super::clip::Clip;
use super::live::write_live;
use super::options::{GRACE, PlanOptions};
use super::path::{Search, Way};
use super::plans::{PeriodPlan, Plans};
use super::ranges::saved_bits;
use super::report::PlanReport;
use super::search::{Goal, Planner};
use super::steering::{FIRST_LAMBDA, QUANTS, bend_step};
use super::windows::Windows;
use crate::bap::Bap;

/// Shares of its bits between which every window is planned to be.
const PLANNED: [f64; 2] = [0.962, 1.038];
/// The same for the clip as a whole, as far as no window is in the way.
const MEAN: [f64; 2] = [0.99, 0.996];
/// The share of its bits that a clip, or a window of it, must use where it can.
const USED: f64 = 0.985;
/// The last round of prices before which quantisers and range arrays may be settled again, the rounds that are made from then
/// on at most, and how many of these look at the clip as a whole.
const SETTLING: usize = 3;
const SINCE: usize = 4;
const WHOLE: usize = 2;
/// Change of the mean price, as a logarithm, after which they are settled again.
const DRIFT: f64 = 0.4;
/// Part of the way to the next prices that is gone after the first round.
const PART: f64 = 0.8;
/// What the logarithms of the prices then differ by, at the start and at the end of each section, between the plans that are
/// chosen from.
const MENUS: [[[f64; 2]; 6]; 4] = [
    [[-1.0, -1.0], [-0.5, -0.5], [-0.2, -0.2], [0.2, 0.2], [0.5, 0.5], [1.0, 1.0]],
    [[-1.0, 1.0], [1.0, -1.0], [-0.4, 0.4], [0.4, -0.4], [-0.3, -0.3], [0.3, 0.3]],
    [[-0.8, 0.0], [0.8, 0.0], [0.0, -0.8], [0.0, 0.8], [-0.1, -0.1], [0.1, 0.1]],
    [[-0.4, 0.2], [0.4, -0.2], [0.2, -0.4], [-0.2, 0.4], [-0.15, -0.15], [0.15, 0.15]],
];
/// The same for all sections in the end, so that there is less error where windows have room.
const FINE: [[[f64; 2]; 4]; 3] = [
    [[-0.6, -0.6], [0.6, 0.6], [-0.6, 0.6], [0.6, -0.6]],
    [[-0.3, -0.3], [0.3, 0.3], [-0.3, 0.3], [0.3, -0.3]],
    [[-0.15, -0.15], [0.15, 0.15], [-0.2, 0.2], [0.2, -0.2]],
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
/// How bits of P planes follow a price: the power of it that they fall with, as long as plans have not told, and its bounds.
const ELASTICITY: f64 = 0.45;
const ELASTICITIES: [f64; 2] = [0.15, 0.9];
/// Change of a section's mean price, as a logarithm, from which on its plans tell.
const TELLS: f64 = 0.1;
/// Times a choice is made, with what it led to, at most.
const CHOICES: usize = 4;
/// Largest change of a price in one round, as a logarithm.
const STRIDE: f64 = 1.0;
/// Bits that a frame left out counts for.
const LEFT_OUT: f64 = 1.0;
/// λ over the squared step of a finger bend at which plans end when any step may be chosen: both are tried for a clip of few
/// sections, the first for others.
const LAMBDAS_PER_STEP: [f64; 2] = [0.24, 0.35];
const FEW: usize = 16;
/// Share of its bits that a section costs more with another step than that, over the squared logarithm of how many times as
/// large it is.
const MISFIT: f64 = 1.0;
/// Share of a window's bits that range arrays may be to count for as much as they are when quantisers are chosen, and the
/// least and most of them that they count for: a leap in what windows cost is worse where it is larger.
const LEAP: f64 = 0.09;
const LEAPS: [f64; 2] = [0.15, 1.0];

/// What frames will cost at other prices.
struct Forecast<'a> {
    /// Logarithms of the prices that bits were spent at last, and of the next ones.
    before: &'a [f64],
    prices: Vec<f64>,
    /// Bits that no price changes, those that follow it, at the next prices, and the power of it that these fall with.
    fixed: Vec<f64>,
    moving: Vec<f64>,
    elasticity: Vec<f64>,
}

impl Forecast<'_> {
    fn set(&mut self, frame: usize, price: f64) {
        let before = self.before[frame];
        let price = price.clamp(before - STRIDE, before + STRIDE).clamp(PRICES[0].ln(), PRICES[1].ln());
        self.moving[frame] *= (self.elasticity[frame] * (self.prices[frame] - price)).exp();
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

    /// Of a span: bits that no price changes, those that do, and how many more these are where a price falls by a little, over
    /// that.
    fn sum(&self, span: Range<usize>) -> [f64; 3] {
        let moving = self.moving[span.clone()].iter().zip(&self.elasticity[span.clone()]);
        let [bits, more] =
            moving.fold([0.0; 2], |[bits, more], (moving, power)| [bits + moving, more + power * moving]);
        [self.fixed[span].iter().sum(), bits, more]
    }

    /// Changes the prices of all frames of each span so that it costs between the bits given with it, if it does
    /// not, or by a `step` of that. True if all do.
    fn hold<'s>(&mut self, spans: impl Iterator<Item = (&'s Range<usize>, [f64; 2])>, step: f64) -> bool {
        let mut held = true;
        let mut at = 0..0;
        let mut sum = [0.0; 3];
        for (span, [least, most]) in spans {
            let (come, gone) = (self.sum(at.end..span.end), self.sum(at.start..span.start));
            sum = [0, 1, 2].map(|part| sum[part] + come[part] - gone[part]);
            at = span.clone();
            let [fixed, moving, more] = sum;
            let wanted = (fixed + moving).clamp(least, most);
            if wanted == fixed + moving {
                continue;
            }
            held = false;
            let power = (more / moving).clamp(ELASTICITIES[0], ELASTICITIES[1]);
            let change = (moving.max(1.0) / (wanted - fixed).max(0.02 * wanted)).ln() / power * step;
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
    let [usual, other] = LAMBDAS_PER_STEP.map(|per_step| Aim { kbit_per_s, per_step });
    let mut best = planned(clip, options, &windows, usual)?;
    if clip.sections().len() <= FEW
        && let Ok(found) = planned(clip, options, &windows, other)
        && better(&windows, &found.report, &best.report)
    {
        best = found;
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

/// What plans are to spend, and λ over the squared step of a finger bend that quantisers go by.
#[derive(Clone, Copy)]
struct Aim {
    kbit_per_s: f64,
    per_step: f64,
}

/// The plans that spend what is aimed at in every window, filled up where there is too little to say.
fn planned(clip: &Clip, options: &PlanOptions, windows: &Windows, aim: Aim) -> Result<Held, EncodeError> {
    let mut plans = Planner::new(clip, options).hold(windows, aim)?;
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
    /// Plans that spend what is aimed at in every window.
    fn hold(&mut self, windows: &Windows, aim: Aim) -> Result<Plans, EncodeError> {
        let price = (FIRST_LAMBDA / aim.kbit_per_s.powi(3)).clamp(PRICES[0], PRICES[1]).ln();
        let floor = PRICES[0].ln();
        let prices = windows.resting.iter().map(|&rests| if rests { floor } else { price }).collect();
        let mut last = self.first_attempt(windows, self.by_section(prices), aim)?;
        let mut best = last.clone();
        let mut menu = self.menu(&last);
        let mut responses = vec![Response::default(); self.sections.len()];
        // The mean price at which quantisers and arrays were settled, and rounds since.
        let mut settled: Option<f64> = None;
        let mut since = 0;
        for round in 0..=SETTLING + SINCE {
            if best.excess == 0.0 && best.used > USED || since == SINCE {
                break;
            }
            let mean = last.mean_price();
            let drifted = settled.is_none_or(|settled| (settled - mean).abs() > DRIFT);
            if (1..=SETTLING).contains(&round) && drifted {
                (settled, since) = (Some(mean), 0);
                last = self.settle(windows, last.prices, aim)?;
                best = last.clone();
                menu = self.menu(&last);
                responses.iter_mut().for_each(|response| response.last = None);
            }
            self.note(&mut responses, &last);
            let part = if round == 0 { 1.0 } else { PART };
            let before: Vec<f64> = last.frame_prices().collect();
            let forecast = self.forecast(&before, &last.bits, &responses);
            let next = windows.next(forecast, since < WHOLE);
            let prices = before.iter().zip(next).map(|(price, next)| price + part * (next - price));
            let attempt = self.attempt(windows, self.by_section(prices.collect()), &last)?;
            self.add(&mut menu, &attempt, &last);
            last = attempt;
            if last.beats(&best) {
                best = last.clone();
            }
            since += usize::from(settled.is_some());
        }
        drop(last);
        for (plans, made) in menu.iter_mut().zip(&best.sections) {
            let first = plans.iter().position(|plan| Arc::ptr_eq(&plan.made, made)).unwrap_or(0);
            plans.swap(0, first);
        }
        self.choose(windows, &mut best, &mut menu)?;
        for changes in MENUS {
            if best.excess > 0.0 {
                let near = self.unheld(windows, &best);
                self.vary(windows, &best, &mut menu, &near, &changes)?;
                self.choose(windows, &mut best, &mut menu)?;
            }
        }
        for changes in FINE {
            let all = vec![true; self.sections.len()];
            self.vary(windows, &best, &mut menu, &all, &changes)?;
            self.choose(windows, &mut best, &mut menu)?;
        }
        let mut plans = self.together(&best.sections);
        plans.lambda = best.mean_price().exp();
        Ok(plans)
    }

    /// The plans at these prices with quantisers that go with them. From there on sections keep these, and I planes send the
    /// range arrays that they send now, so that what they cost is known.
    fn settle(&mut self, windows: &Windows, prices: Vec<Prices>, aim: Aim) -> Result<Attempt, EncodeError> {
        self.runs = None;
        let settled = self.first_attempt(windows, prices, aim)?;
        self.runs = Some(Arc::new(self.together(&settled.sections).runs(self.clip, self.options)));
        Ok(settled)
    }

    /// Takes in how the bits of P planes of each section follow its price.
    fn note(&self, responses: &mut [Response], attempt: &Attempt) {
        for (index, frames) in self.frames_of_sections().enumerate() {
            let made = &attempt.sections[index];
            let intra = self.sections[index].clone().map(|index| self.clip.period(index).start);
            let bits: u64 = attempt.bits[frames].iter().sum();
            let intra: u64 = intra.map(|frame| attempt.bits[frame]).sum();
            responses[index].note(mean(&made.prices), (bits - intra) as f64);
        }
    }

    /// The plans of an attempt, to choose from.
    fn menu(&self, attempt: &Attempt) -> Vec<Vec<Variant>> {
        self.variants(attempt).map(|variant| vec![variant]).collect()
    }

    /// Adds the plans of an attempt to the menu of each section, if they are others than those of the one before.
    fn add(&self, menu: &mut [Vec<Variant>], attempt: &Attempt, before: &Attempt) {
        for (index, variant) in self.variants(attempt).enumerate() {
            if !Arc::ptr_eq(&variant.made, &before.sections[index]) {
                menu[index].push(variant);
            }
        }
    }

    /// Whether each section is in a window that is not held: all are, where only the clip as a whole costs too much.
    fn unheld(&self, windows: &Windows, attempt: &Attempt) -> Vec<bool> {
        let mut near = vec![false; self.clip.len()];
        windows.broken(&attempt.bits).for_each(|span| near[span].fill(true));
        if near.iter().all(|&near| !near) {
            near.fill(true);
        }
        self.frames_of_sections().map(|frames| near[frames].iter().any(|&near| near)).collect()
    }

    /// Adds plans at prices that differ by `changes` from those of `best` to the menus of sections, where they are `near`.
    fn vary(
        &mut self,
        windows: &Windows,
        best: &Attempt,
        menu: &mut [Vec<Variant>],
        near: &[bool],
        changes: &[[f64; 2]],
    ) -> Result<(), EncodeError> {
        for &change in changes {
            let prices = best.prices.iter().zip(near);
            let prices = prices.map(|(base, near)| if *near { changed(base, change) } else { base.clone() });
            let attempt = self.attempt(windows, prices.collect(), best)?;
            self.add(menu, &attempt, best);
        }
        Ok(())
    }

    /// Makes the best choice among the menu of each section `best` if it is better than that, and puts it in the first place.
    fn choose(
        &mut self,
        windows: &Windows,
        best: &mut Attempt,
        menu: &mut [Vec<Variant>],
    ) -> Result<(), EncodeError> {
        let frames: Vec<Range<usize>> = self.frames_of_sections().collect();
        let mut before = Vec::new();
        for _ in 0..CHOICES {
            let chosen = choose(windows, &frames, menu);
            if chosen == before || chosen.iter().all(|&plan| plan == 0) {
                break;
            }
            let plans = || menu.iter().zip(&chosen).map(|(plans, &plan)| &plans[plan]);
            let prices = plans().map(|variant| variant.made.prices.clone()).collect();
            let sections = plans().map(|variant| Arc::clone(&variant.made)).collect();
            let found = self.account(windows, prices, sections)?;
            // Beside these neighbours I planes may send other arrays.
            for (index, frames) in frames.iter().enumerate() {
                menu[index][chosen[index]].bits = found.bits_of(frames.clone());
            }
            before = chosen;
            if found.beats(best) {
                menu.iter_mut().zip(&before).for_each(|(plans, &plan)| plans.swap(0, plan));
                *best = found;
                before.fill(0);
            }
        }
        // What the best plans cost is known beside each other.
        for (plans, frames) in menu.iter_mut().zip(&frames) {
            plans[0].bits = best.bits_of(frames.clone());
        }
        Ok(())
    }

    /// What is kept of the plans of each section.
    fn variants<'v>(&'v self, attempt: &'v Attempt) -> impl Iterator<Item = Variant> + 'v {
        let variant = |(index, frames)| Variant {
            bits: attempt.bits_of(frames),
            error: attempt.errors[index],
            made: Arc::clone(&attempt.sections[index]),
        };
        self.frames_of_sections().enumerate().map(variant)
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

    /// The plans at these prices, and what they cost, beginning with no others.
    fn first_attempt(
        &mut self,
        windows: &Windows,
        prices: Vec<Prices>,
        aim: Aim,
    ) -> Result<Attempt, EncodeError> {
        prices.iter().enumerate().for_each(|(index, prices)| self.weigh(index, prices));
        let quants = self.quants(windows, &prices, aim);
        let made = self.each(self.sections.len(), |search, index| {
            self.make(search, index, &prices[index], quants[index])
        })?;
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
        let share = bits.iter().sum::<u64>() as f64 / windows.total;
        let (excess, used) = (excess + (share - MOST).max(0.0), most.max(share));
        let error = |(section, made): (&Range<usize>, &Arc<Made>)| {
            section.clone().zip(&made.plans).map(|(index, plan)| self.error(index, plan)).sum()
        };
        let errors: Vec<f64> = self.sections.iter().zip(&sections).map(error).collect();
        Ok(Attempt { prices, sections, bits, excess, used, error: errors.iter().sum(), errors })
    }

    fn together(&mut self, sections: &[Arc<Made>]) -> Plans {
        sections.iter().enumerate().for_each(|(index, made)| self.weigh(index, &made.prices));
        let periods = sections.iter().flat_map(|made| made.plans.iter().cloned()).collect();
        let mut plans =
            Plans { periods, lambda: 1.0, skip: true, filler: Vec::new(), runs: self.runs.clone() };
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
    fn forecast<'p>(&self, prices: &'p [f64], bits: &[u64], responses: &[Response]) -> Forecast<'p> {
        let mut moving: Vec<f64> = bits.iter().map(|&bits| bits as f64).collect();
        let mut fixed = vec![0.0; moving.len()];
        for index in 0..self.clip.periods() {
            let frame = self.clip.period(index).start;
            std::mem::swap(&mut fixed[frame], &mut moving[frame]);
        }
        // What is left out may be sent at another price.
        moving.iter_mut().for_each(|bits| *bits = bits.max(LEFT_OUT));
        let powers = self.frames_of_sections().zip(responses);
        let elasticity = powers.flat_map(|(frames, response)| frames.map(|_| response.elasticity)).collect();
        Forecast { before: prices, prices: prices.to_vec(), fixed, moving, elasticity }
    }

    /// The plans of a section at these prices: the ones before, if they have not changed. Another quantiser is a leap in what
    /// it costs, so it keeps its own.
    fn follow(
        &self,
        search: &mut Search,
        index: usize,
        prices: &Prices,
        before: &Arc<Made>,
    ) -> Result<Arc<Made>, EncodeError> {
        if before.is_stale(prices) {
            self.make(search, index, prices, before.quant)
        } else {
            Ok(Arc::clone(before))
        }
    }

    /// The plans of a section at these prices with this quantiser, or with the best one if it is out of reach of that.
    fn make(
        &self,
        search: &mut Search,
        index: usize,
        prices: &Prices,
        quant: u8,
    ) -> Result<Arc<Made>, EncodeError> {
        let section = self.sections[index].clone();
        let plans = self.cheapest(search, section.clone(), 1.0, quant..=quant);
        let plans = plans.or_else(|_| self.cheapest(search, section, 1.0, QUANTS))?;
        let quant = plans.first().map_or(quant, |plan| plan.quant);
        Ok(Arc::new(Made { plans, prices: prices.clone(), quant }))
    }

    /// The quantiser of each section: one that goes with its prices, or that of the one before where that is not far off, as
    /// another needs all range arrays, which is a leap in what a window costs.
    fn quants(&self, windows: &Windows, prices: &[Prices], aim: Aim) -> Vec<u8> {
        let steps: Vec<f64> = QUANTS.map(|quant| bend_step(quant, self.options.steps).ln()).collect();
        let arrays = saved_bits(self.options, self.options.sendable(&self.clip.mask(0)).len());
        let change = arrays * (arrays / (LEAP * windows.bits)).powi(2).clamp(LEAPS[0], LEAPS[1]);
        let frame = windows.total / self.clip.len() as f64;
        // Least bits up to each section with each quantiser, and where the one before it has another, which.
        let mut least = vec![0.0; steps.len()];
        let mut others: Vec<Vec<usize>> = Vec::with_capacity(prices.len());
        for prices in prices {
            let (best, bits) = smallest(&least);
            let from = least
                .iter()
                .enumerate()
                .map(|(quant, &stay)| if stay > bits + change { best } else { quant });
            others.push(from.collect());
            let wanted = 0.5 * (mean(prices) - aim.per_step.ln());
            for (least, step) in least.iter_mut().zip(&steps) {
                *least =
                    least.min(bits + change) + MISFIT * frame * prices.len() as f64 * (step - wanted).powi(2);
            }
        }
        let (mut quant, _) = smallest(&least);
        let mut quants: Vec<u8> = Vec::with_capacity(prices.len());
        for others in others.iter().rev() {
            quants.push(QUANTS.start() + quant as u8);
            quant = others[quant];
        }
        quants.reverse();
        quants
    }
}

/// The number of the smallest of some values, and that.
fn smallest(values: &[f64]) -> (usize, f64) {
    let least = values.iter().copied().enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
    least.unwrap_or((0, f64::INFINITY))
}

/// How bits of the P planes of a section follow its price: the last of its plans that told, and the power of the price that
/// they fall with.
#[derive(Clone, Copy)]
struct Response {
    last: Option<[f64; 2]>,
    elasticity: f64,
}

impl Default for Response {
    fn default() -> Self {
        Self { last: None, elasticity: ELASTICITY }
    }
}

impl Response {
    /// Takes in the bits of plans at a mean price, as a logarithm.
    fn note(&mut self, price: f64, bits: f64) {
        let here = [price, bits.max(1.0).ln()];
        let Some(last) = self.last else {
            self.last = Some(here);
            return;
        };
        if (here[0] - last[0]).abs() > TELLS {
            let power = (last[1] - here[1]) / (here[0] - last[0]);
            self.elasticity = 0.5 * (self.elasticity + power.clamp(ELASTICITIES[0], ELASTICITIES[1]));
            self.last = Some(here);
        }
    }
}
