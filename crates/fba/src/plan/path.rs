//! The cheapest way of one BAP through one I period: which levels to send so that squared error plus
//! λ times bits is least.
//!
//! The code length that an adaptive model gives to a sequence of symbols depends only on how often each
//! occurs: with `N` symbols, counts `c` and `n` symbols in all it is
//! `log2((n + N − 1)! / ((N − 1)! ∏ c!))`. For given symbol costs the best path is found by dynamic
//! programming over reconstruction levels near the input; costs are then taken from the path's own
//! counts, and so on until the sum no longer falls.

use super::super::state::{intra_level, round_level, step};
use super::super::syntax::{MAX_RANGE_CODE, range_code, range_levels};
use super::options::{Levels, PlanOptions, ROOM_PER_LAMBDA, Target};
use crate::bap::Bap;

/// What stays the same over all tries for one BAP in one period.
#[derive(Clone, Copy, Debug)]
pub(super) struct Track<'a> {
    pub bap: Bap,
    /// Input values, and what the squared error of each counts for.
    pub input: &'a [i32],
    pub weights: &'a [f64],
    /// Quantiser step, in the unit of the input.
    pub step: i32,
    /// Quantiser index.
    pub quant: u8,
    /// Degrees per unit of the input, and what they count for.
    pub degrees: f64,
    pub worth: f64,
    /// Largest error wanted, degrees; further off costs steeply.
    pub bound: f64,
    /// Squared degrees that being beyond the bound costs in any case: where it is a promise.
    pub over: f64,
    /// Squared degrees per bit.
    pub lambda: f64,
}

/// Whether the planes of a period are sent for the sake of other BAPs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Company<'a> {
    /// Number of other BAPs that change, by frame.
    pub others: &'a [u32],
    /// Bits of a plane that is sent for this BAP alone.
    pub alone: f64,
}

/// A way through a period.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Path {
    /// Reconstruction at each frame, in steps.
    pub levels: Vec<i32>,
    /// Range codes of the P model: magnitudes of maximum and minimum in units of the code.
    pub codes: [u8; 2],
    /// Weighted sum of squared errors, squared degrees.
    pub error: f64,
    /// Bits of the values, model and range costs included.
    pub bits: f64,
}

impl Path {
    pub fn cost(&self, lambda: f64) -> f64 {
        self.error + lambda * self.bits
    }
}

/// A way through a period as it is kept: most frames change nothing, so that only those that do are written down.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Way {
    /// Reconstruction at the first frame, in steps.
    pub first: i32,
    /// Frames of the period.
    frames: u32,
    /// For each change how many frames without one are before it, and how many steps it is, signs folded in: both as
    /// digits of seven bits, the lowest first, of which all but the last of a number have the highest bit set.
    changes: Box<[u8]>,
    /// As those of [`Path`].
    pub codes: [u8; 2],
    pub error: f64,
    pub bits: f64,
}

impl Way {
    pub fn cost(&self, lambda: f64) -> f64 {
        self.error + lambda * self.bits
    }

    /// Change at each frame from the frame before it, in steps: 0 at the first, and behind the last.
    pub fn changes(&self) -> Changes<'_> {
        let mut changes = Changes { packed: self.changes.iter(), zeros: 0, change: 0 };
        changes.read();
        changes
    }

    /// Marks the frames with a change.
    pub fn mark(&self, sent: &mut [bool]) {
        let mut changes = self.changes();
        let mut frame = 0;
        loop {
            frame = changes.zeros.try_into().map_or(usize::MAX, |zeros| frame.saturating_add(zeros));
            match sent.get_mut(frame) {
                Some(sent) => *sent = true,
                None => return,
            }
            frame += 1;
            changes.read();
        }
    }

    /// Reconstruction at the last frame, in steps.
    pub fn last(&self) -> i32 {
        self.levels().last().unwrap_or(self.first)
    }

    /// Reconstruction at each frame, in steps.
    pub fn levels(&self) -> impl Iterator<Item = i32> + '_ {
        let mut level = self.first;
        self.changes().take(self.frames as usize).map(move |change| {
            level += change;
            level
        })
    }
}

impl From<&Path> for Way {
    fn from(path: &Path) -> Self {
        let mut packed = Vec::new();
        let mut zeros = 1;
        for change in path.levels.windows(2).map(|pair| pair[1] - pair[0]) {
            if change == 0 {
                zeros += 1;
                continue;
            }
            pack(&mut packed, std::mem::take(&mut zeros));
            pack(&mut packed, ((change << 1) ^ (change >> 31)) as u32);
        }
        Self {
            first: path.levels.first().copied().unwrap_or(0),
            frames: path.levels.len() as u32,
            changes: packed.into(),
            codes: path.codes,
            error: path.error,
            bits: path.bits,
        }
    }
}

/// Appends a number in digits of seven bits.
fn pack(packed: &mut Vec<u8>, mut number: u32) {
    while number >= 0x80 {
        packed.push(number as u8 | 0x80);
        number >>= 7;
    }
    packed.push(number as u8);
}

/// The changes of a [`Way`], frame by frame; it does not end.
#[derive(Clone, Debug)]
pub(super) struct Changes<'a> {
    packed: std::slice::Iter<'a, u8>,
    /// Frames without a change before the next one, and that.
    zeros: u32,
    change: i32,
}

impl Changes<'_> {
    fn number(&mut self) -> Option<u32> {
        let mut number = 0;
        for shift in (0..32).step_by(7) {
            let digit = *self.packed.next()?;
            number |= u32::from(digit & 0x7F) << shift;
            if digit < 0x80 {
                break;
            }
        }
        Some(number)
    }

    fn read(&mut self) {
        let next = self.number().zip(self.number());
        let (zeros, folded) = next.unwrap_or((u32::MAX, 0));
        self.zeros = zeros;
        self.change = (folded >> 1) as i32 ^ -((folded & 1) as i32);
    }
}

impl Iterator for Changes<'_> {
    type Item = i32;

    fn next(&mut self) -> Option<i32> {
        if self.zeros > 0 {
            self.zeros -= 1;
            return Some(0);
        }
        let change = self.change;
        self.read();
        Some(change)
    }
}

/// log2 of factorials.
#[derive(Clone, Debug)]
pub(super) struct Factorials(Vec<f64>);

impl Factorials {
    pub fn new(largest: usize) -> Self {
        let mut sum = 0.0;
        let mut table = vec![0.0];
        table.extend((1..=largest).map(|n| {
            sum += (n as f64).log2();
            sum
        }));
        Self(table)
    }

    fn get(&self, n: usize) -> f64 {
        self.0.get(n).copied().unwrap_or(f64::INFINITY)
    }

    /// The part of an adaptive model's bits that depends on the number of its symbols, for `total` of them in all.
    pub fn spread(&self, total: usize, symbols: usize) -> f64 {
        self.get(total + symbols - 1) - self.get(symbols - 1)
    }

    /// Bits an adaptive model with `counts.len()` symbols needs for symbols that occur so often.
    pub fn code_length(&self, counts: &[u32]) -> f64 {
        let total: usize = counts.iter().map(|&count| count as usize).sum();
        let symbols = counts.len();
        self.get(total + symbols - 1)
            - self.get(symbols - 1)
            - counts.iter().map(|&count| self.get(count as usize)).sum::<f64>()
    }
}

/// Work space of the search.
#[derive(Clone, Debug, Default)]
pub(super) struct Search {
    /// Of the track that was prepared last: the level nearest to each input value, what each level near it costs (rows of
    /// [`lanes`] that end with one that no level has), and how many of these there are to each side.
    centres: Vec<i32>,
    penalties: Vec<f64>,
    width: i32,
    /// Price of each change within the range, in frames that are sent anyway, and in others.
    prices: [Vec<f64>; 2],
    /// Least cost of each level near each input value, in rows as above.
    costs: Vec<f64>,
    counts: Vec<u32>,
    counts_before: Vec<u32>,
    symbol_cost: Vec<f64>,
}

/// Reconstructions up to this many steps from the input are tried.
const MAX_REACH: i32 = 5;
/// Times the symbol costs are taken from the path found.
const ROUNDS: usize = 4;
/// Squared degrees per squared degree beyond the bound.
const BEYOND: f64 = 1e5;

impl Search {
    /// The best path with P ranges `reach` (largest and smallest level, as magnitudes), starting from the
    /// symbol counts of `guess`. `None` if the ranges do not let any path through.
    pub fn best(
        &mut self,
        track: &Track<'_>,
        company: &Company<'_>,
        factorials: &Factorials,
        reach: [i32; 2],
        guess: &[i32],
    ) -> Option<Path> {
        let mut best: Option<Path> = None;
        self.count(guess, company, reach);
        for _ in 0..ROUNDS {
            self.set_costs();
            let path = self.walk(track, company, reach)?;
            std::mem::swap(&mut self.counts, &mut self.counts_before);
            self.count(&path, company, reach);
            let mut found = Path { error: error(track, &path), levels: path, ..Path::default() };
            found.bits = factorials.code_length(&self.counts) + intra_bits(found.levels.first().copied());
            found.bits += self.plane_bits(&found.levels, company);
            if best.as_ref().is_some_and(|best| best.cost(track.lambda) <= found.cost(track.lambda)) {
                break;
            }
            best = Some(found);
            // The same counts lead the same way.
            if self.counts == self.counts_before {
                break;
            }
        }
        best
    }

    /// The way that is taken without looking ahead.
    pub fn plain(
        &mut self,
        track: &Track<'_>,
        company: &Company<'_>,
        factorials: &Factorials,
        levels: Levels,
    ) -> Option<Path> {
        let levels = match levels {
            Levels::DeadZone => dead_zone(track, extent(&rounded(track))),
            Levels::Searched | Levels::Rounded => rounded(track),
        };
        let codes = codes_for(extent(&levels), track.quant)?;
        self.count(&levels, company, codes.map(|code| range_levels(code, track.quant)));
        let bits = factorials.code_length(&self.counts) + intra_bits(levels.first().copied());
        Some(Path { error: error(track, &levels), bits, levels, codes })
    }

    /// Bits of planes that only this BAP needs.
    fn plane_bits(&self, levels: &[i32], company: &Company<'_>) -> f64 {
        let alone = levels
            .windows(2)
            .zip(company.others.iter().skip(1))
            .filter(|(pair, others)| pair[0] != pair[1] && **others == 0)
            .count();
        alone as f64 * company.alone
    }

    /// Counts the symbols of a path. A frame in which no BAP changes is skipped and has none.
    fn count(&mut self, levels: &[i32], company: &Company<'_>, reach: [i32; 2]) {
        self.counts.clear();
        self.counts.resize((reach[0] + reach[1] + 1) as usize, 0);
        for (pair, others) in levels.windows(2).zip(company.others.iter().skip(1)) {
            let level = (pair[1] - pair[0]).clamp(-reach[1], reach[0]);
            if level != 0 || *others > 0 {
                self.counts[(level + reach[1]) as usize] += 1;
            }
        }
    }

    fn set_costs(&mut self) {
        let total = self.counts.iter().sum::<u32>() as usize + self.counts.len();
        self.symbol_cost.clear();
        self.symbol_cost
            .extend(self.counts.iter().map(|&count| (total as f64 / (f64::from(count) + 1.0)).log2()));
    }

    /// Works out what does not depend on ranges and symbol costs, for searches along this track.
    pub fn prepare(&mut self, track: &Track<'_>) {
        let width = (track.bound / (f64::from(track.step) * track.degrees)).ceil() as i32;
        self.width = width.clamp(1, MAX_REACH);
        self.centres.clear();
        self.centres.extend(track.input.iter().map(|&value| round_level(value.into(), track.step)));
        self.penalties.clear();
        for ((&value, &weight), &centre) in track.input.iter().zip(track.weights).zip(&self.centres) {
            for level in centre - self.width..=centre + self.width {
                let off =
                    (i64::from(value) - i64::from(level) * i64::from(track.step)) as f64 * track.degrees;
                let beyond = (off.abs() - track.bound).max(0.0);
                let over = if beyond > 0.0 { track.over } else { 0.0 };
                self.penalties.push(weight * (off * track.worth).powi(2) + BEYOND * beyond * beyond + over);
            }
            self.penalties.push(f64::INFINITY);
        }
    }

    /// The price of each change within `reach`.
    fn set_prices(&mut self, track: &Track<'_>, company: &Company<'_>, reach: [i32; 2]) {
        for (alone, prices) in self.prices.iter_mut().enumerate() {
            prices.clear();
            let more = if alone == 0 { 0.0 } else { company.alone };
            prices.extend(self.symbol_cost.iter().map(|bits| track.lambda * (bits + more)));
            if alone == 1 {
                prices[reach[1] as usize] = 0.0;
            }
        }
    }

    /// Dynamic programming over reconstructions within reach of the input of the track prepared.
    fn walk(&mut self, track: &Track<'_>, company: &Company<'_>, reach: [i32; 2]) -> Option<Vec<i32>> {
        self.set_prices(track, company, reach);
        match self.width {
            1 => self.spread::<{ lanes(1) }>(track, company, reach)?,
            2 => self.spread::<{ lanes(2) }>(track, company, reach)?,
            3 => self.spread::<{ lanes(3) }>(track, company, reach)?,
            4 => self.spread::<{ lanes(4) }>(track, company, reach)?,
            _ => self.spread::<{ lanes(MAX_REACH) }>(track, company, reach)?,
        }
        self.retrace(company, reach)
    }

    /// Sets the least cost of each level near each input value, of `N` as [`lanes`] has them.
    fn spread<const N: usize>(
        &mut self,
        track: &Track<'_>,
        company: &Company<'_>,
        reach: [i32; 2],
    ) -> Option<()> {
        let width = self.width;
        let (rows, _) = self.penalties.as_chunks::<N>();
        let (&first, &start) = (rows.first()?, self.centres.first()?);
        let most = range_levels(MAX_RANGE_CODE, track.quant);
        // The costs of the frame before, between levels that cannot be.
        let mut before = [[f64::INFINITY; N]; 3];
        before[1] = first;
        for (level, cost) in (start - width..=start + width).zip(&mut before[1]) {
            let price = track.lambda * intra_bits(Some(level));
            *cost = if level.abs() > most { f64::INFINITY } else { *cost + price };
        }
        self.costs.clear();
        self.costs.extend_from_slice(&before[1]);
        let mut last = start;
        for ((&here, penalties), &others) in self.centres.iter().zip(rows).zip(company.others).skip(1) {
            let prices = &self.prices[usize::from(others == 0)];
            let moved = here - last;
            // A change leads from the level that lies `moved` less the change higher in the row before.
            let [low, high] = [(moved - 2 * width).max(-reach[1]), (moved + 2 * width).min(reach[0])];
            let mut least = [f64::INFINITY; N];
            let padded = before.as_flattened();
            for change in low..=high {
                let from = N.wrapping_add_signed((moved - change) as isize);
                let price = prices[(change + reach[1]) as usize];
                for (least, cost) in least.iter_mut().zip(&padded[from..from + N]) {
                    let sum = cost + price;
                    *least = if sum < *least { sum } else { *least };
                }
            }
            for ((cost, least), penalty) in before[1].iter_mut().zip(least).zip(penalties) {
                *cost = least + penalty;
            }
            self.costs.extend_from_slice(&before[1]);
            last = here;
        }
        Some(())
    }

    /// The way that led to the least of the last costs; of several, that of the lowest levels, from the last on.
    fn retrace(&self, company: &Company<'_>, reach: [i32; 2]) -> Option<Vec<i32>> {
        let states = (2 * self.width + 1) as usize;
        let rows = self.costs.chunks_exact(states + 1).map(|row| &row[..states]);
        let mut rows = rows.zip(&self.centres).zip(company.others).rev();
        let ((row, &centre), mut others) = rows.next()?;
        let (state, cost) = row.iter().copied().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
        if !cost.is_finite() {
            return None;
        }
        let mut level = centre - self.width + state as i32;
        let mut levels = vec![level; self.centres.len()];
        let places = levels.iter_mut().rev().skip(1);
        for (((row, &centre), here), place) in rows.zip(places) {
            let prices = &self.prices[usize::from(*others == 0)];
            let mut least = (f64::INFINITY, level);
            for (from, cost) in (centre - self.width..).zip(row) {
                let change = usize::try_from(level - from + reach[1]).ok();
                let sum = change.and_then(|change| prices.get(change)).map_or(f64::INFINITY, |p| cost + p);
                if sum < least.0 {
                    least = (sum, from);
                }
            }
            (level, others) = (least.1, here);
            *place = level;
        }
        Some(levels)
    }
}

/// Levels up to `width` steps to each side of one, and another that makes their number even: the processor takes them by
/// twos.
const fn lanes(width: i32) -> usize {
    2 * width as usize + 2
}

/// Bits of an I value whose range just holds it.
fn intra_bits(level: Option<i32>) -> f64 {
    (f64::from(level.unwrap_or(0).abs()) + 1.0).log2()
}

/// Weighted sum of squared errors of a path, squared degrees.
fn error(track: &Track<'_>, levels: &[i32]) -> f64 {
    let square = |((&value, &weight), &level): ((&i32, &f64), &i32)| {
        let off = (i64::from(value) - i64::from(level) * i64::from(track.step)) as f64 * track.degrees;
        weight * (off * track.worth).powi(2)
    };
    track.input.iter().zip(track.weights).zip(levels).map(square).sum()
}

/// Plain rounding.
pub(super) fn rounded(track: &Track<'_>) -> Vec<i32> {
    let mut levels: Vec<i32> =
        track.input.iter().map(|&value| round_level(value.into(), track.step)).collect();
    if let (Some(level), Some(&value)) = (levels.first_mut(), track.input.first()) {
        *level = intra_level(value, track.step, track.quant);
    }
    levels
}

/// Frame by frame the change of least error and bits, of the nearest, the one nearer to 0, and 0.
fn dead_zone(track: &Track<'_>, reach: [i32; 2]) -> Vec<i32> {
    let symbol = |change: i32| (change + reach[1]) as usize;
    let mut counts = vec![1.0; symbol(reach[0]) + 1];
    let mut level = track.input.first().map_or(0, |&value| intra_level(value, track.step, track.quant));
    let mut levels = vec![level];
    for (&value, &weight) in track.input.iter().zip(track.weights).skip(1) {
        let off = |level: i32| (i64::from(value) - i64::from(level) * i64::from(track.step)) as f64;
        let total: f64 = counts.iter().sum();
        let nearest = (round_level(value.into(), track.step) - level).clamp(-reach[1], reach[0]);
        let cost = |change: &i32| {
            let off = off(level + change) * track.degrees;
            let beyond = (off.abs() - track.bound).max(0.0);
            let bits = (total / counts[symbol(*change)]).log2();
            weight * (off * track.worth).powi(2) + BEYOND * beyond * beyond + track.lambda * bits
        };
        let tried = [nearest, nearest - nearest.signum(), 0];
        let change = tried.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).unwrap_or(0);
        counts[symbol(change)] += 1.0;
        level += change;
        levels.push(level);
    }
    levels
}

/// The way of a BAP that keeps its first value, to the nearest step: `None` where no I plane carries that. What it is off
/// by does not count.
pub(super) fn resting(track: &Track<'_>) -> Option<Path> {
    let level = intra_level(*track.input.first()?, track.step, track.quant);
    range_code(level.abs(), track.quant)?;
    Some(Path { levels: vec![level; track.input.len()], bits: intra_bits(Some(level)), ..Path::default() })
}

/// Largest and smallest change of a path, as magnitudes.
pub(super) fn extent(levels: &[i32]) -> [i32; 2] {
    levels.windows(2).fold([0, 0], |[up, down], pair| {
        let change = pair[1] - pair[0];
        [up.max(change), down.max(-change)]
    })
}

/// What is priced beyond the bound, squared degrees.
pub(super) fn excess(track: &Track<'_>, levels: &[i32]) -> f64 {
    let beyond = |(&value, &level): (&i32, &i32)| {
        let off = (i64::from(value) - i64::from(level) * i64::from(track.step)) as f64 * track.degrees;
        let beyond = (off.abs() - track.bound).max(0.0);
        BEYOND * beyond * beyond + if beyond > 0.0 { track.over } else { 0.0 }
    };
    track.input.iter().zip(levels).map(beyond).sum()
}

impl Search {
    /// Bits of a path when the frames in which `active` is 0 are skipped.
    pub fn bits(&mut self, levels: &[i32], active: &[u32], reach: [i32; 2], factorials: &Factorials) -> f64 {
        self.count(levels, &Company { others: active, alone: 0.0 }, reach);
        factorials.code_length(&self.counts) + intra_bits(levels.first().copied())
    }

    /// Bits that an unchanged value of this path costs.
    pub fn zero_bits(&mut self, levels: &[i32], active: &[u32], reach: [i32; 2]) -> f64 {
        self.count(levels, &Company { others: active, alone: 0.0 }, reach);
        self.set_costs();
        self.symbol_cost.get(reach[1] as usize).copied().unwrap_or(0.0)
    }
}

/// What the search for the way of one BAP starts from.
pub(super) fn track<'a>(
    input: &'a [i32],
    weights: &'a [f64],
    bap: Bap,
    quant: u8,
    options: &PlanOptions,
    lambda: f64,
) -> Track<'a> {
    let step = step(bap, options.steps, quant);
    // A bound below half a step cannot be kept.
    let mut bound = options.room(bap).max(0.5 * options.off(bap, step.into()));
    if matches!(options.mode, Target::Bitrate(_)) {
        let least = weights.iter().copied().fold(f64::INFINITY, f64::min);
        bound = bound.max(ROOM_PER_LAMBDA * (lambda / least).sqrt());
    }
    let over = if matches!(options.mode, Target::MaxError(_)) { BROKEN_PROMISE } else { 0.0 };
    let (degrees, worth) = (options.degrees(bap), options.worth(bap));
    Track { bap, input, weights, step, quant, degrees, worth, bound, over, lambda }
}

/// Squared degrees that a largest error asked for and exceeded costs, by however little.
const BROKEN_PROMISE: f64 = 1e6;

pub(super) fn codes_for([up, down]: [i32; 2], quant: u8) -> Option<[u8; 2]> {
    Some([range_code(up, quant)?, range_code(down, quant)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Levels add up far beyond what a change may be.
    #[test]
    fn a_kept_path_has_its_levels() {
        let levels: Vec<i32> = (0..100).map(|frame| 90_000 + 1860 * (50 - (frame - 50i32).abs())).collect();
        let path = Path { levels, codes: [3, 4], error: 1.5, bits: 20.0 };
        let way = Way::from(&path);
        assert_eq!(way.levels().collect::<Vec<_>>(), path.levels);
        assert_eq!(way.changes().take(2).collect::<Vec<_>>(), [0, 1860]);
        assert_eq!(way.changes().skip(99).take(3).collect::<Vec<_>>(), [-1860, 0, 0]);
        assert_eq!((way.codes, way.cost(2.0)), (path.codes, path.cost(2.0)));
    }

    /// Rests longer than a digit holds, changes of every size and sign, and periods of a frame or none.
    #[test]
    fn any_changes_are_unpacked_as_they_were() {
        let frames = |levels: Vec<i32>| {
            let way = Way::from(&Path { levels: levels.clone(), ..Path::default() });
            assert_eq!(way.levels().collect::<Vec<_>>(), levels);
        };
        frames(vec![]);
        frames(vec![-7]);
        frames(vec![5; 300]);
        for size in [1, 63, 64, 65, 8191, 8192, 1 << 20] {
            for rest in [1, 126, 127, 128, 129, 20_000] {
                let level = |frame: usize| if (frame / rest).is_multiple_of(2) { -size } else { size };
                frames((0..4 * rest + 1).map(level).collect());
            }
        }
    }
}
