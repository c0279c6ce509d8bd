//! Which range arrays the I planes of a clip send.
//!
//! Ranges stay in force until they are sent again, so an array may serve several I periods of the same BAPs and the same
//! quantiser: wider than most of them need, but sent once. For each array the periods are cut into runs so that the bits of
//! the array and those that too wide ranges cost are least.

use super::super::syntax::{IntraParams, MAX_RANGE_CODE, RangeCodes, RangeEnd, range_code, range_levels};
use super::options::{PlanOptions, Target};
use super::path::Factorials;
use super::plans::PeriodPlan;
use crate::bap::{BAP_COUNT, Bap, BapMask};

/// Bits of the markers of an array, and of each of its codes.
const ARRAY_BITS: f64 = 83.0;
const CODE_BITS: f64 = 5.0;
/// Most I periods that an array serves.
const LONGEST: usize = 12;

/// What a period needs.
struct Need {
    quant: u8,
    mask: BapMask,
    /// By BAP: largest and smallest level of I values and of P differences as its codes give them, by
    /// [`RangeEnd`].
    levels: Vec<(Bap, [i32; 4])>,
    /// P planes.
    planes: usize,
}

/// The arrays that the I plane of each period sends. `planes` has the number of P planes of each.
pub(super) fn sent_arrays(
    periods: &[PeriodPlan],
    planes: &[usize],
    options: &PlanOptions,
) -> Vec<[Option<RangeCodes>; 4]> {
    let needs: Vec<Need> =
        periods.iter().zip(planes).map(|(period, &planes)| Need::of(period, planes)).collect();
    let mut sent = vec![[None; 4]; needs.len()];
    let longest = planes.iter().copied().max().unwrap_or(0);
    let symbols = 2 * range_levels(MAX_RANGE_CODE, 0) as usize + 1;
    // Where a decoder may start everything must be said; where a rate is to be held what a period costs must not depend on
    // the plans of others.
    let held = matches!(options.mode, Target::Bitrate(_));
    let runs_allowed = options.choices.lasting_ranges && !options.resync && !held && needs.len() > 1;
    let factorials = Factorials::new(if runs_allowed { longest + symbols } else { 0 });
    for end in RangeEnd::ALL.map(|end| end as usize) {
        let starts =
            if runs_allowed { run_starts(&needs, end, &factorials) } else { (0..needs.len()).collect() };
        let ends = starts.iter().skip(1).copied().chain([needs.len()]);
        for (&start, behind) in starts.iter().zip(ends) {
            sent[start][end] = Some(codes(&needs[start..behind], end));
        }
    }
    sent
}

impl Need {
    fn of(period: &PeriodPlan, planes: usize) -> Self {
        let levels = period.ways.iter().map(|(bap, way)| {
            let code = |magnitude| range_code(magnitude, period.quant).unwrap_or(MAX_RANGE_CODE);
            let codes = [code(way.first.max(0)), code(-way.first.min(0)), way.codes[0], way.codes[1]];
            (*bap, codes.map(|code| range_levels(code, period.quant)))
        });
        let mask = period.ways.iter().map(|(bap, _)| *bap).collect();
        Self { quant: period.quant, mask, levels: levels.collect(), planes }
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
        for (length, need) in needs[start..].iter().take(LONGEST).enumerate() {
            if need.mask != first.mask || need.quant != first.quant {
                break;
            }
            for (widest, (_, levels)) in widest.iter_mut().zip(&need.levels) {
                *widest = (*widest).max(levels[end]);
            }
            let run = &needs[start..=start + length];
            let bits = array + run.iter().map(|need| need.waste(end, &widest, factorials)).sum::<f64>();
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
        let sent = sent_arrays(&periods, &planes, &options);
        let which: Vec<[bool; 4]> = sent.iter().map(|arrays| arrays.map(|codes| codes.is_some())).collect();
        assert_eq!(which[..3], [[true; 4], [false; 4], [false; 4]]);
        assert_eq!(which[3], [true; 4]);
        // A range of 20 codes in place of one costs more than to send it.
        assert_eq!(which[4], [false, false, false, true]);
        let index = periods[0].ways[0].0.index();
        let code = |period: usize, end: usize| sent[period][end].map(|codes| codes[index]);
        assert_eq!([code(0, 2), code(0, 3), code(4, 3)], [Some(1), Some(1), Some(20)]);
        assert!(range_levels(code(0, 0).unwrap(), 8) >= 24);
        let resync = PlanOptions { resync: true, ..options };
        let all = sent_arrays(&periods, &planes, &resync);
        assert!(all.iter().flatten().all(Option::is_some));
    }
}
