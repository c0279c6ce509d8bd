//! Which range arrays the I planes of a clip send.
//!
//! Ranges stay in force until they are sent again, so an array may serve several I periods of the same BAPs and the same
//! quantiser: wider than most of them need, but sent once. For each array the periods are cut into runs so that the bits of
//! the array and those that too wide ranges cost are least.

use super::super::syntax::{IntraParams, MAX_RANGE_CODE, RangeCodes, RangeEnd, range_code, range_levels};
use super::options::PlanOptions;
use super::path::Factorials;
use super::plans::PeriodPlan;
use crate::bap::{BAP_COUNT, Bap, BapMask};

/// Bits of the markers of an array, and of each of its codes.
const ARRAY_BITS: f64 = 83.0;
const CODE_BITS: f64 = 5.0;
/// Share of the arrays that an I period of the same quantiser does without.
const SAVED: f64 = 0.75;
/// Most I periods that an array serves: of those that begin in their turn, and of all.
const LONGEST: usize = 12;
const MOST: usize = 96;

/// Whether an array may serve several I periods: where a decoder may start everything must be said.
fn lasting(options: &PlanOptions) -> bool {
    options.choices.lasting_ranges && !options.resync
}

/// Bits that a period with so many BAPs saves where the arrays sent before serve it.
pub(super) fn saved_bits(options: &PlanOptions, baps: usize) -> f64 {
    if lasting(options) {
        SAVED * RangeEnd::ALL.len() as f64 * (ARRAY_BITS + CODE_BITS * baps as f64)
    } else {
        0.0
    }
}

/// What a period needs.
struct Need {
    quant: u8,
    mask: BapMask,
    /// By BAP: largest and smallest level of I values and of P differences as its codes give them, by
    /// [`RangeEnd`].
    levels: Vec<(Bap, [i32; 4])>,
    /// P planes.
    planes: usize,
    /// Whether it begins out of turn, for the sake of a leap.
    leaps: bool,
}

/// Numbers of the periods that send each array, by [`RangeEnd`], in ascending order.
pub(super) type Runs = [Vec<usize>; 4];

/// The arrays that the I plane of each period sends, and where. `planes` has the number of P planes of each, `leaps` tells
/// which begin out of turn; `known` has periods that send them in any case, and no others do unless they must.
pub(super) fn sent_arrays(
    periods: &[PeriodPlan],
    planes: &[usize],
    leaps: &dyn Fn(usize) -> bool,
    options: &PlanOptions,
    known: Option<&Runs>,
) -> (Vec<[Option<RangeCodes>; 4]>, Runs) {
    let need = |(index, (period, &planes))| Need::of(period, planes, leaps(index));
    let needs: Vec<Need> = periods.iter().zip(planes).enumerate().map(need).collect();
    let mut sent = vec![[None; 4]; needs.len()];
    let longest = planes.iter().copied().max().unwrap_or(0);
    let symbols = 2 * range_levels(MAX_RANGE_CODE, 0) as usize + 1;
    let runs_allowed = lasting(options) && needs.len() > 1;
    let searched = runs_allowed && known.is_none();
    let factorials = Factorials::new(if searched { longest + symbols } else { 0 });
    let runs = RangeEnd::ALL.map(|end| end as usize).map(|end| match known {
        _ if !runs_allowed => (0..needs.len()).collect(),
        None => run_starts(&needs, end, &factorials),
        Some(known) => (0..needs.len())
            .filter(|&index| {
                known[end].binary_search(&index).is_ok()
                    || index == 0
                    || !needs[index].follows(&needs[index - 1])
            })
            .collect(),
    });
    for (end, starts) in runs.iter().enumerate() {
        let ends = starts.iter().skip(1).copied().chain([needs.len()]);
        for (&start, behind) in starts.iter().zip(ends) {
            sent[start][end] = Some(codes(&needs[start..behind], end));
        }
    }
    (sent, runs)
}

impl Need {
    fn of(period: &PeriodPlan, planes: usize, leaps: bool) -> Self {
        let levels = period.ways.iter().map(|(bap, way)| {
            let code = |magnitude| range_code(magnitude, period.quant).unwrap_or(MAX_RANGE_CODE);
            let codes = [code(way.first.max(0)), code(-way.first.min(0)), way.codes[0], way.codes[1]];
            (*bap, codes.map(|code| range_levels(code, period.quant)))
        });
        let mask = period.ways.iter().map(|(bap, _)| *bap).collect();
        Self { quant: period.quant, mask, levels: levels.collect(), planes, leaps }
    }

    /// Whether arrays of the period before may serve it.
    fn follows(&self, before: &Self) -> bool {
        self.mask == before.mask && self.quant == before.quant
    }

    /// Bits that it costs if ranges reach to `levels` at one end.
    fn waste(&self, end: usize, levels: &[i32], factorials: &Factorials) -> f64 {
        let of_one = |((_, needed), &levels): (&(Bap, [i32; 4]), &i32)| {
            let fit = (needed[end] + needed[end ^ 1] + 1) as usize;
            let wide = fit + (levels - needed[end]) as usize;
            if wide == fit {
                0.0
            } else if end < 2 {
                (wide as f64 / fit as f64).log2()
            } else {
                factorials.spread(self.planes, wide) - factorials.spread(self.planes, fit)
            }
        };
        self.levels.iter().zip(levels).map(of_one).sum()
    }
}

/// Codes of the narrowest array that serves these periods.
fn codes(needs: &[Need], end: usize) -> RangeCodes {
    let mut codes = [0; BAP_COUNT];
    for need in needs {
        for (bap, levels) in &need.levels {
            let code = range_code(levels[end], need.quant).unwrap_or(MAX_RANGE_CODE);
            codes[bap.index()] = codes[bap.index()].max(code);
        }
    }
    codes
}

/// The first period of each run of one array.
fn run_starts(needs: &[Need], end: usize, factorials: &Factorials) -> Vec<usize> {
    // Bits up to each period, and the run that ends before it.
    let mut least = vec![(f64::INFINITY, 0usize); needs.len() + 1];
    least[0].0 = 0.0;
    for start in 0..needs.len() {
        let first = &needs[start];
        let array = least[start].0 + ARRAY_BITS + CODE_BITS * first.levels.len() as f64;
        let mut widest: Vec<i32> = first.levels.iter().map(|(_, levels)| levels[end]).collect();
        let (mut waste, mut turns) = (0.0, 0);
        for (length, need) in needs[start..].iter().take(MOST).enumerate() {
            turns += usize::from(!need.leaps || length == 0);
            if !need.follows(first) || turns > LONGEST {
                break;
            }
            let mut wider = false;
            for (widest, (_, levels)) in widest.iter_mut().zip(&need.levels) {
                wider |= *widest < levels[end];
                *widest = (*widest).max(levels[end]);
            }
            let run = &needs[if wider { start } else { start + length }..=start + length];
            let more: f64 = run.iter().map(|need| need.waste(end, &widest, factorials)).sum();
            waste = if wider { more } else { waste + more };
            let bits = array + waste;
            let known = &mut least[start + length + 1];
            if bits < known.0 {
                *known = (bits, start);
            }
        }
    }
    let mut starts = Vec::new();
    let mut behind = needs.len();
    while behind > 0 {
        behind = least[behind].1;
        starts.push(behind);
    }
    starts.reverse();
    starts
}

/// What the I plane of a period says before its values.
pub(super) fn params(period: &PeriodPlan, mask: BapMask, ranges: [Option<RangeCodes>; 4]) -> IntraParams {
    IntraParams { quant: period.quant, mask, ranges, ..IntraParams::default() }
}

#[cfg(test)]
mod tests {
    use super::super::path::{Path, Way};
    use super::*;
    use crate::bap::Bap;

    fn period(quant: u8, first: i32, codes: [u8; 2]) -> PeriodPlan {
        let way = Way::from(&Path { levels: vec![first; 100], codes, ..Path::default() });
        let ways = (123..153).filter_map(Bap::new).map(|bap| (bap, way.clone())).collect();
        PeriodPlan { quant, frames: 1, ways, cost: 0.0 }
    }

    #[test]
    fn arrays_serve_periods_that_need_much_the_same() {
        let periods = [
            period(8, 20, [1, 1]),
            period(8, 24, [1, 1]),
            period(8, 16, [1, 1]),
            // Another quantiser needs all anew.
            period(9, 16, [1, 1]),
            period(9, 16, [1, 20]),
        ];
        let planes = [90; 5];
        let options = PlanOptions::default();
        let (sent, runs) = sent_arrays(&periods, &planes, &|_| false, &options, None);
        let which: Vec<[bool; 4]> = sent.iter().map(|arrays| arrays.map(|codes| codes.is_some())).collect();
        assert_eq!(which[..3], [[true; 4], [false; 4], [false; 4]]);
        assert_eq!(which[3], [true; 4]);
        // A range of 20 codes in place of one costs more than to send it.
        assert_eq!(which[4], [false, false, false, true]);
        let index = periods[0].ways[0].0.index();
        let code = |period: usize, end: usize| sent[period][end].map(|codes| codes[index]);
        assert_eq!([code(0, 2), code(0, 3), code(4, 3)], [Some(1), Some(1), Some(20)]);
        assert!(range_levels(code(0, 0).unwrap(), 8) >= 24);
        assert_eq!(sent_arrays(&periods, &planes, &|_| false, &options, Some(&runs)), (sent, runs));
        let resync = PlanOptions { resync: true, ..options };
        let (all, _) = sent_arrays(&periods, &planes, &|_| false, &resync, None);
        assert!(all.iter().flatten().all(Option::is_some));
    }
}
