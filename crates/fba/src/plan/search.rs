//! Searches the plans of a clip.

use std::ops::{Range, RangeInclusive};
use std::sync::Arc;

use super::super::encoder::degrees_per_unit;
use super::super::error::EncodeError;
use super::super::reach::out_of_range;
use super::super::state::{intra_level, step};
use super::super::syntax::{MAX_RANGE_CODE, PlaneKind, range_code, range_levels};
use super::clip::Clip;
use super::options::{Levels, PlanOptions, Target, refused};
use super::path::{self, Company, Factorials, Path, Search, Track, Way, codes_for, track};
use super::plans::{PeriodPlan, Plans};
use super::ranges::Runs;
use super::report::PlanReport;
use super::share::{self, workers};
use crate::bap::{BAP_COUNT, Bap, BapMask, Unit, derive};

/// The quantiser indices that each period may have.
type Quants<'a> = dyn Fn(usize) -> RangeInclusive<u8> + Sync + 'a;

/// Searches the plans of a clip.
pub(super) struct Planner<'a> {
    pub(super) clip: &'a Clip,
    pub(super) options: &'a PlanOptions,
    /// As [`Clip::sections`].
    pub(super) sections: Vec<Range<usize>>,
    factorials: Factorials,
    /// What the squared error of each frame counts for.
    pub(super) weights: Vec<f64>,
    /// Which periods send range arrays, once that is settled.
    pub(super) runs: Option<Arc<Runs>>,
}

/// Quantiser indices worth trying.
const QUANTS: RangeInclusive<u8> = 1..=24;
/// Half the largest base step of an angle, in degrees: what the finest quantiser can promise for all.
const FINEST_BOUND: f64 = 0.1467;
/// Where the search for the best one begins.
const FIRST_QUANT: u8 = 8;
/// Bounds of the search for λ, squared degrees per bit.
const LAMBDAS: [f64; 2] = [1e-4, 16.0];

/// The largest λ that rates are looked for with where none of those reaches them.
const COARSEST: f64 = 1e4;

/// λ where an RMS error is aimed at, over its square, at most. What is measured is the error of angles that move: without a bound
/// a hand whose fingers rest would have its wrist as coarse as can be. Motion of all fingers ends at 0.6 to 5.
const COARSEST_PER_RMS: f64 = 10.0;

/// What a search of λ aims at.
#[derive(Clone, Copy, Debug)]
pub(super) enum Goal {
    /// At most this error, at the least rate.
    Rms(f64),
    /// At most this rate, at the least error.
    Rate(f64),
}

impl Goal {
    fn fits(self, report: &PlanReport) -> bool {
        match self {
            Self::Rms(degrees) => report.rms_degrees <= degrees,
            Self::Rate(kbit_per_s) => report.kbit_per_s() <= kbit_per_s,
        }
    }

    /// What is measured, as a share of what is aimed at.
    fn share(self, report: &PlanReport) -> f64 {
        match self {
            Self::Rms(degrees) => report.rms_degrees / degrees,
            Self::Rate(kbit_per_s) => report.kbit_per_s() / kbit_per_s,
        }
    }

    /// The power of λ that it usually goes with.
    fn slope(self) -> f64 {
        match self {
            Self::Rms(_) => 0.45,
            Self::Rate(_) => -0.35,
        }
    }

    /// Whether a larger λ makes a fitting result better.
    fn wants_larger(self) -> bool {
        matches!(self, Self::Rms(_))
    }

    /// The λ at the end of the search.
    fn farthest(self) -> f64 {
        match self {
            Self::Rms(_) => LAMBDAS[0],
            Self::Rate(_) => COARSEST,
        }
    }

    /// The largest λ that its plans may have.
    fn coarsest(self) -> f64 {
        match self {
            Self::Rms(degrees) => COARSEST_PER_RMS * degrees * degrees,
            Self::Rate(_) => f64::INFINITY,
        }
    }

    /// What is to be small.
    fn score(self, report: &PlanReport) -> f64 {
        match self {
            Self::Rms(_) => report.bytes as f64,
            Self::Rate(_) => report.rms_degrees,
        }
    }
}

/// Share of an aim that is near enough, and the share that is aimed at.
const NEAR: f64 = 0.996;
const AIMED: f64 = 0.998;
/// Share of an interval of λ, as logarithms, that the next one tried is off its ends at least.
const INSIDE: f64 = 0.08;

/// What the last two λ tried led to: logarithms of λ and of what the goal measures, as a share of the aim.
#[derive(Default)]
struct Tried {
    last: Option<[f64; 2]>,
    before: Option<[f64; 2]>,
}

impl Tried {
    /// Takes in a λ, and gives the share of the aim that it led to.
    fn note(&mut self, goal: Goal, lambda: f64, report: &PlanReport) -> f64 {
        let share = goal.share(report);
        self.before = self.last.replace([lambda.ln(), share.ln()]);
        share
    }

    /// The λ that should lead to the aim, within bounds: along the line through the last two, or of a usual slope.
    fn next(&self, goal: Goal, [low, high]: [f64; 2]) -> f64 {
        let [low, high] = [low.ln(), high.ln()];
        let slope = |last: [f64; 2]| match self.before {
            Some(before) if (last[0] - before[0]).abs() > 1e-9 => {
                let slope = (last[1] - before[1]) / (last[0] - before[0]);
                if slope * goal.slope() > 0.0 { slope } else { goal.slope() }
            }
            _ => goal.slope(),
        };
        let line = self.last.map(|last| last[0] + (AIMED.ln() - last[1]) / slope(last));
        let middle = 0.5 * (low + high);
        let room = (0.5 - INSIDE) * (high - low);
        let wanted = line.filter(|line| line.is_finite()).unwrap_or(middle);
        wanted.clamp(middle - room, middle + room).exp()
    }
}

/// The best plans met by a search.
#[derive(Default)]
struct Candidate {
    plans: Option<Plans>,
    score: f64,
    /// Quantiser indices that periods could choose from.
    quants: Option<RangeInclusive<u8>>,
    lambda: f64,
}

impl Candidate {
    /// Bounds of a search near this candidate.
    fn lambdas(&self) -> [f64; 2] {
        match self.plans {
            Some(_) => [self.lambda * 0.5, self.lambda * 2.0],
            None => LAMBDAS,
        }
    }
}
/// Bits of a P plane around its values: header and flush.
const PLANE_BITS: f64 = 6.0;
/// Bits that a run of skipped frames adds to the next header.
const SKIP_BITS: f64 = 4.0;
/// Bits of a BAP in the range arrays of an I plane.
const RANGE_BITS: f64 = 20.0;
/// Periods of a sample of a clip of more than twice as many.
const SAMPLED: usize = 16;
/// Frames of a clip from which on it is planned on several threads.
const WORTH_A_THREAD: usize = 60;
/// Times the ways of all BAPs are searched in turn, given those of the others.
const SWEEPS: usize = 3;

impl<'a> Planner<'a> {
    pub fn new(clip: &'a Clip, options: &'a PlanOptions) -> Self {
        let longest = (0..clip.periods()).map(|index| clip.period(index).len()).max().unwrap_or(0);
        let symbols = 2 * range_levels(MAX_RANGE_CODE, 1) as usize + 1;
        Self {
            clip,
            options,
            sections: clip.sections(),
            factorials: Factorials::new(longest + symbols),
            weights: vec![1.0; clip.len()],
            runs: None,
        }
    }

    /// The best plans that reach the goal, or those that come nearest. What suits a long clip is looked for in a sample.
    pub fn search(&self, goal: Goal) -> Result<Plans, EncodeError> {
        let near = match self.clip.sample(SAMPLED) {
            Some(sample) => self.near(goal, &Planner::new(&sample, self.options).best(goal)?)?,
            None => Candidate::default(),
        };
        let best = if near.plans.is_some() { near } else { self.best(goal)? };
        match best.plans {
            Some(plans) if plans.lambda > goal.coarsest() => self.plans(goal.coarsest(), &|_| QUANTS),
            Some(plans) => Ok(plans),
            None => self.plans(goal.farthest(), &|_| QUANTS),
        }
    }

    /// The best plans that reach the goal: first the best quantiser index for the whole clip is
    /// found, walking from a middling one while it gets better, then each period may differ from it.
    fn best(&self, goal: Goal) -> Result<Candidate, EncodeError> {
        let mut best = Candidate::default();
        let mut ends = [FIRST_QUANT; 2];
        self.bisect(&|_| FIRST_QUANT..=FIRST_QUANT, LAMBDAS, goal, &mut best)?;
        for (end, direction) in ends.iter_mut().zip([-1i8, 1]) {
            while let Some(quant) = end.checked_add_signed(direction).filter(|q| QUANTS.contains(q)) {
                let before = best.score;
                self.bisect(&|_| quant..=quant, best.lambdas(), goal, &mut best)?;
                *end = quant;
                if best.plans.is_some() && best.score >= before {
                    break;
                }
            }
        }
        if self.clip.periods() > 1 && self.options.choices.quantisers {
            let quants = around(best.quants.as_ref().map_or(FIRST_QUANT, |quants| *quants.start()));
            self.bisect(&|_| quants.clone(), best.lambdas(), goal, &mut best)?;
        }
        if best.plans.is_none() && goal.farthest() > LAMBDAS[1] {
            // One quantiser, so that ranges serve all periods, and from the coarsest on, which costs least.
            for quant in QUANTS.rev() {
                let before = best.score;
                self.bisect(&|_| quant..=quant, [LAMBDAS[1], goal.farthest()], goal, &mut best)?;
                if best.plans.is_some() && best.score >= before && before > 0.0 {
                    break;
                }
            }
        }
        Ok(best)
    }

    /// The best plans that reach the goal with about the λ and the quantiser indices that suit a sample.
    fn near(&self, goal: Goal, sample: &Candidate) -> Result<Candidate, EncodeError> {
        let mut best = Candidate::default();
        let Some(quants) = &sample.quants else { return Ok(best) };
        let plans = match self.plans(sample.lambda, &|_| quants.clone()) {
            Err(EncodeError::OutOfRange { .. }) => return Ok(best),
            plans => plans?,
        };
        let chosen: Vec<u8> = plans.periods.iter().map(|period| period.quant).collect();
        self.bisect_from(
            Some(plans),
            &|index| chosen[index]..=chosen[index],
            sample.lambdas(),
            goal,
            &mut best,
        )?;
        Ok(best)
    }

    /// Looks for the λ at which the goal is just reached with quantiser indices from `quants`, and keeps the
    /// best result met on the way.
    fn bisect(
        &self,
        quants: &Quants<'_>,
        lambdas: [f64; 2],
        goal: Goal,
        best: &mut Candidate,
    ) -> Result<(), EncodeError> {
        self.bisect_from(None, quants, lambdas, goal, best)
    }

    /// The same, where the plans at the first λ are made already.
    fn bisect_from(
        &self,
        mut first: Option<Plans>,
        quants: &Quants<'_>,
        [mut low, mut high]: [f64; 2],
        goal: Goal,
        best: &mut Candidate,
    ) -> Result<(), EncodeError> {
        let mut tried = Tried::default();
        while high / low > 1.03 {
            let next = || self.plans(tried.next(goal, [low, high]), quants);
            let plans = match first.take().map_or_else(next, Ok) {
                // Some other index may reach what these cannot.
                Err(EncodeError::OutOfRange { .. }) => return Ok(()),
                plans => plans?,
            };
            let lambda = plans.lambda;
            let (_, report) = plans.write(self.clip, self.options)?;
            let fits = goal.fits(&report);
            if fits == goal.wants_larger() {
                low = lambda;
            } else {
                high = lambda;
            }
            let share = tried.note(goal, lambda, &report);
            let score = goal.score(&report);
            if fits && (best.plans.is_none() || score < best.score) {
                *best = Candidate { score, quants: Some(quants(0)), lambda, plans: Some(plans) };
            }
            if fits && share > NEAR {
                break;
            }
        }
        Ok(())
    }

    /// The plans that spend the least bits within the bound, of a long clip with quantiser indices about those that do so
    /// in a sample.
    pub fn bounded(&self, degrees: f64) -> Result<Plans, EncodeError> {
        let lambda = 0.3 * degrees * degrees;
        let Some(sample) = self.clip.sample(SAMPLED) else { return self.plans(lambda, &|_| QUANTS) };
        let sample = Planner::new(&sample, self.options).plans(lambda, &|_| QUANTS)?;
        let chosen = || sample.periods.iter().map(|period| period.quant);
        let least = chosen().min().map_or(*QUANTS.start(), |quant| *around(quant).start());
        let most = chosen().max().map_or(*QUANTS.end(), |quant| *around(quant).end());
        match self.plans(lambda, &|_| least..=most) {
            Err(EncodeError::OutOfRange { .. }) => self.plans(lambda, &|_| QUANTS),
            plans => plans,
        }
    }

    /// The best plans at a price per bit, with the quantiser indices that `quants` gives for each period.
    fn plans(&self, lambda: f64, quants: &Quants<'_>) -> Result<Plans, EncodeError> {
        let cheapest = |search: &mut Search, index: usize| {
            self.cheapest(search, index..index + 1, lambda, quants(index))
        };
        let periods = self.each(self.clip.periods(), cheapest)?.into_iter().flatten().collect();
        let choices = self.options.choices;
        let mut plans = Plans { periods, lambda, skip: choices.skips, filler: Vec::new(), runs: None };
        if choices.masks {
            self.drop_useless(&mut plans);
        }
        Ok(plans)
    }

    /// What `work` makes of each number below `count`, of a period or a section, in their order: they do not depend on each
    /// other, and are shared out among the processor's cores.
    pub(super) fn each<T: Send>(
        &self,
        count: usize,
        work: impl Fn(&mut Search, usize) -> Result<T, EncodeError> + Sync + Send,
    ) -> Result<Vec<T>, EncodeError> {
        let threads = if self.clip.len() < WORTH_A_THREAD { 1 } else { workers().min(count).max(1) };
        let shares = share::each(threads, |share| {
            let mut search = Search::default();
            let [first, last] = [share, share + 1].map(|share| share * count / threads);
            (first..last).map(|index| work(&mut search, index)).collect::<Vec<_>>()
        });
        shares.into_iter().flatten().collect()
    }

    /// The best plans of some periods with the same one of `quants`.
    pub(super) fn cheapest(
        &self,
        search: &mut Search,
        periods: Range<usize>,
        lambda: f64,
        quants: RangeInclusive<u8>,
    ) -> Result<Vec<PeriodPlan>, EncodeError> {
        let plans = quants.filter_map(|quant| self.with_quant(search, periods.clone(), quant, lambda));
        if let Some(best) = plans.min_by(|a, b| cost(a).total_cmp(&cost(b))) {
            return Ok(best);
        }
        let frames =
            periods.flat_map(|index| self.clip.period(index).zip(0..).map(move |(_, at)| (index, at)));
        let largest = frames.flat_map(|(index, offset)| {
            let frame = self.clip.period(index).start + offset;
            self.clip.row(index, offset).map(move |(bap, value)| (frame, bap, value))
        });
        let (frame, bap, value) =
            largest.max_by_key(|(.., value)| value.unsigned_abs()).ok_or(EncodeError::NoIntra)?;
        if self.promises_bound() && self.options.bound() < FINEST_BOUND {
            let what = "largest error";
            return Err(refused(what, self.options.bound(), "at least 0.15 degrees for all angles"));
        }
        Err(out_of_range(bap, PlaneKind::Intra, value, self.options.steps, *QUANTS.start()).at(frame))
    }

    /// Whether no error may be larger than the bound: not where the rate is given.
    fn promises_bound(&self) -> bool {
        !matches!(self.options.mode, Target::Bitrate(_))
    }

    /// The plans of some periods at one quantiser index; `None` if they cannot be coded so.
    fn with_quant(
        &self,
        search: &mut Search,
        mut periods: Range<usize>,
        quant: u8,
        lambda: f64,
    ) -> Option<Vec<PeriodPlan>> {
        periods.try_fold(Vec::new(), |mut plans, index| {
            plans.push(self.period(search, index, quant, lambda)?);
            Some(plans)
        })
    }

    /// Takes out the BAPs that cost more than the error of leaving them at 0.
    pub(super) fn drop_useless(&self, plans: &mut Plans) {
        let mut gain = [0.0; BAP_COUNT];
        let mut needed = BapMask::EMPTY;
        for (index, period) in plans.periods.iter().enumerate() {
            let weights = &self.weights[self.clip.period(index)];
            // Ranges are not sent anew for a leap.
            let ranges = if self.clip.leaps(index) && !self.options.resync { 0.0 } else { RANGE_BITS };
            for (bap, way) in &period.ways {
                let anchor = self.options.anchors.contains(*bap);
                for (&value, weight) in self.clip.column(index, *bap).iter().zip(weights) {
                    let off = self.options.off(*bap, value.into());
                    gain[bap.index()] -= weight * (off * self.options.worth(*bap)).powi(2);
                    if off.abs() > self.options.bound() || anchor && value != 0 {
                        needed.insert(*bap);
                    }
                }
                if anchor {
                    gain[bap.index()] = 0.0;
                    continue;
                }
                gain[bap.index()] += way.cost(plans.lambda) + plans.lambda * ranges;
            }
        }
        let sent = plans.periods.iter().flat_map(|period| period.ways.iter().map(|(bap, _)| *bap));
        let sent: BapMask = sent.collect();
        let mut kept: BapMask =
            sent.iter().filter(|&bap| needed.contains(bap) || gain[bap.index()] < 0.0).collect();
        for limb in self.options.limbs {
            let known = kept.iter().any(|bap| limb.contains(bap));
            let there = sent.iter().filter(|&bap| limb.contains(bap) && !self.options.anchors.contains(bap));
            let cheapest = there.min_by(|a, b| gain[a.index()].total_cmp(&gain[b.index()]));
            cheapest.filter(|_| !known).into_iter().for_each(|bap| kept.insert(bap));
        }
        let kept = kept.union(&derive::companions(self.options.ties, &sent, &kept));
        for period in &mut plans.periods {
            period.ways.retain(|(bap, _)| kept.contains(*bap));
        }
    }

    /// Plans one period at one quantiser index; `None` if it cannot be coded so.
    fn period(&self, search: &mut Search, index: usize, quant: u8, lambda: f64) -> Option<PeriodPlan> {
        let frames = self.clip.period(index);
        let mask = self.options.sendable(&self.clip.mask(index));
        let inputs: Vec<(Bap, &[i32])> =
            mask.in_coding_order().map(|bap| (bap, self.clip.column(index, bap))).collect();
        // Where the step is so coarse that rounding alone may break the bound, the bound cannot be promised.
        let too_coarse = |(bap, input): &(Bap, &[i32])| {
            let degrees = degrees_per_unit(*bap);
            let half_step = 0.5 * f64::from(step(*bap, self.options.steps, quant)) * degrees;
            bap.unit() == Unit::Angle
                && half_step > self.options.bound()
                && input.iter().any(|&value| f64::from(value).abs() * degrees > self.options.bound())
        };
        if self.promises_bound() && inputs.iter().any(too_coarse) {
            return None;
        }
        let count = frames.len();
        let weights = &self.weights[frames];
        let mut active = vec![0u32; count];
        let mut paths: Vec<Path> = Vec::with_capacity(inputs.len());
        // At first every plane is sent; later sweeps find out which need not be.
        let everyone = vec![1u32; count];
        for (bap, input) in &inputs {
            let track = track(input, weights, *bap, quant, self.options, lambda);
            let company = Company { others: &everyone, alone: 0.0 };
            let path = self.one(search, &track, &company, quant, None)?;
            mark(&path, &mut active, true);
            paths.push(path);
        }
        let mut others = vec![0u32; count];
        if !self.options.choices.skips {
            active.clone_from(&everyone);
        }
        let sweeps = if self.options.choices.skips { SWEEPS } else { 1 };
        for _ in 1..sweeps {
            let zeros = zero_bits(search, &paths, &active, quant);
            for ((bap, input), path) in inputs.iter().zip(&mut paths) {
                mark(path, &mut active, false);
                others.clone_from(&active);
                let track = track(input, weights, *bap, quant, self.options, lambda);
                let company = Company { others: &others, alone: PLANE_BITS + zeros };
                if let Some(found) = self.one(search, &track, &company, quant, Some(path)) {
                    *path = found;
                }
                mark(path, &mut active, true);
            }
        }
        let sent = active.iter().skip(1).filter(|&&changes| changes > 0).count();
        let runs = active.windows(2).skip(1).filter(|pair| pair[0] == 0 && pair[1] > 0).count();
        let overhead = PLANE_BITS * sent as f64 + SKIP_BITS * runs as f64;
        let mut cost = lambda * (overhead + RANGE_BITS * paths.len() as f64);
        for (path, (bap, input)) in paths.iter_mut().zip(&inputs) {
            let reach = path.codes.map(|code| range_levels(code, quant));
            path.bits = search.bits(&path.levels, &active, reach, &self.factorials);
            let track = track(input, weights, *bap, quant, self.options, lambda);
            cost += path.error + lambda * path.bits;
            if !self.options.anchors.contains(*bap) {
                cost += path::excess(&track, &path.levels);
            }
        }
        let ways = inputs.iter().zip(&paths).map(|((bap, _), path)| (*bap, Way::from(path))).collect();
        Some(PeriodPlan { quant, frames: self.clip.period(index).len(), ways, cost })
    }

    /// The best way of one BAP, with the P ranges that suit it.
    fn one(
        &self,
        search: &mut Search,
        track: &Track<'_>,
        company: &Company<'_>,
        quant: u8,
        before: Option<&Path>,
    ) -> Option<Path> {
        if self.options.anchors.contains(track.bap) {
            return path::resting(track);
        }
        if !track.input.iter().all(|&value| is_codable(value, track)) {
            return None;
        }
        if self.options.choices.levels != Levels::Searched {
            return search.plain(track, company, &self.factorials, self.options.choices.levels);
        }
        search.prepare(track);
        let guess = before.map_or_else(|| path::rounded(track), |path| path.levels.clone());
        let start = match before {
            Some(path) => path.codes,
            None => codes_for(path::extent(&guess), quant)?,
        };
        let mut attempt = |codes: [u8; 2], guess: &[i32]| {
            let reach = codes.map(|code| range_levels(code, quant));
            let mut path = search.best(track, company, &self.factorials, reach, guess)?;
            path.codes = codes;
            Some(path)
        };
        let mut best = attempt(start, &guess)?;
        loop {
            let tight = codes_for(path::extent(&best.levels), quant)?;
            let mut better = None;
            let tried =
                [tight, [tight[0].saturating_sub(1), tight[1]], [tight[0], tight[1].saturating_sub(1)]];
            let count = if self.options.choices.narrow_ranges { tried.len() } else { 1 };
            for codes in tried.into_iter().take(count) {
                if codes == best.codes {
                    continue;
                }
                let Some(path) = attempt(codes, &best.levels) else { continue };
                let excess = |path: &Path| path::excess(track, &path.levels);
                let cost = path.cost(track.lambda) + excess(&path);
                if cost < best.cost(track.lambda) + excess(&best) - 1e-9 {
                    better = Some(path);
                    break;
                }
            }
            match better {
                Some(path) => best = path,
                None => return Some(best),
            }
        }
    }
}

/// Error and λ-weighted bits of several plans together.
fn cost(plans: &[PeriodPlan]) -> f64 {
    plans.iter().map(|plan| plan.cost).sum()
}

/// A quantiser index and its neighbours.
fn around(quant: u8) -> RangeInclusive<u8> {
    quant.saturating_sub(1).max(*QUANTS.start())..=(quant + 1).min(*QUANTS.end())
}

/// Whether an I plane carries the value.
fn is_codable(value: i32, track: &Track<'_>) -> bool {
    range_code(intra_level(value, track.step, track.quant).abs(), track.quant).is_some()
}

/// Bits that all unchanged BAPs together add to a plane.
fn zero_bits(search: &mut Search, paths: &[Path], active: &[u32], quant: u8) -> f64 {
    let zero = |path: &Path| {
        let reach = path.codes.map(|code| range_levels(code, quant));
        search.zero_bits(&path.levels, active, reach)
    };
    paths.iter().map(zero).sum()
}

/// Counts the changes of a path into `active`, or out of it.
fn mark(path: &Path, active: &mut [u32], add: bool) {
    for (pair, changes) in path.levels.windows(2).zip(active.iter_mut().skip(1)) {
        if pair[0] != pair[1] {
            *changes = if add { *changes + 1 } else { changes.saturating_sub(1) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::clip::ClipBuilder;
    use super::*;
    use crate::bap::TimedBapFrame;

    /// Bends that grow slower and larger to and fro.
    fn clip(periods: u32, options: &PlanOptions) -> Clip {
        let bends = [126, 130, 132].map(|number| Bap::new(number).unwrap());
        let mut builder = ClipBuilder::new(options);
        for frame in 0..15 * periods {
            let t = f64::from(frame);
            let value = |n: usize| {
                let size = 50_000.0 * (1.2 + (t * 0.003 * (n + 1) as f64).sin());
                (size * (t * 0.11 / (n + 1) as f64).sin()) as i32
            };
            let baps = bends.iter().enumerate().map(|(n, &bap)| (bap, value(n))).collect();
            builder.push(&TimedBapFrame { time: t / 30.0, baps }, &BapMask::EMPTY).unwrap();
        }
        builder.finish().unwrap()
    }

    #[test]
    fn a_sample_tells_what_suits_a_long_clip() {
        let options = PlanOptions { intra_seconds: 0.5, ..PlanOptions::default() };
        let clip = clip(60, &options);
        let planner = Planner::new(&clip, &options);
        for degrees in [0.25, 0.5, 1.0] {
            let goal = Goal::Rms(degrees);
            let report = |plans: Plans| plans.write(&clip, &options).unwrap().1;
            let found = report(planner.search(goal).unwrap());
            let thorough = report(planner.best(goal).unwrap().plans.unwrap());
            assert!(goal.fits(&found) && goal.share(&found) > 0.95, "{}", found.rms_degrees);
            let share = found.bytes as f64 / thorough.bytes as f64;
            assert!(share < 1.02, "{share} of the bytes at {degrees} degrees");
            let bounds = PlanOptions { mode: Target::MaxError(degrees), ..options };
            let planner = Planner::new(&clip, &bounds);
            let found = report(planner.bounded(degrees).unwrap());
            let thorough = report(planner.plans(0.3 * degrees * degrees, &|_| QUANTS).unwrap());
            assert!(found.max_degrees <= degrees, "{}", found.max_degrees);
            let share = found.bytes as f64 / thorough.bytes as f64;
            assert!(share < 1.02, "{share} of the bytes within {degrees} degrees");
        }
    }

    #[test]
    fn a_sample_is_spread_over_the_clip() {
        let options = PlanOptions { intra_seconds: 0.5, ..PlanOptions::default() };
        assert!(clip(32, &options).sample(16).is_none());
        let clip = clip(33, &options);
        let sample = clip.sample(16).unwrap();
        assert_eq!((sample.periods(), sample.len()), (16, 240));
        assert_eq!(sample.ticks, (0..240).collect::<Vec<_>>());
        assert!((sample.seconds - 8.0).abs() < 1e-9);
        for index in 0..16 {
            let of = (2 * index + 1) * 33 / 32;
            for bap in sample.mask(index).iter() {
                assert_eq!(sample.column(index, bap), clip.column(of, bap));
            }
        }
    }
}
