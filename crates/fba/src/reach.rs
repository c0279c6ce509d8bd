//! Ranges chosen without look-ahead: I ranges that hold the values, P ranges learnt from what was needed.

use super::error::EncodeError;
use super::state::{intra_level, round_level, step};
use super::syntax::{
    IntraParams, MAX_RANGE_CODE, PlaneKind, RANGE_DELTA, RangeEnd, range_code, range_levels,
};
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask, StepTable};

/// The coarsest quantiser index.
const MAX_QUANT: u8 = 31;

/// How far each BAP has moved from plane to plane.
#[derive(Clone, Debug)]
pub(super) struct Reach {
    /// Largest changes upwards and downwards in this I period, as magnitudes in the unit of the BAP.
    now: [[i32; 2]; BAP_COUNT],
    /// The same of the periods before.
    before: [[i32; 2]; BAP_COUNT],
    /// BAPs for which a whole I period has been seen.
    known: BapMask,
}

impl Reach {
    pub fn new() -> Self {
        Self { now: [[0; 2]; BAP_COUNT], before: [[0; 2]; BAP_COUNT], known: BapMask::EMPTY }
    }

    /// Takes note of a change that was wanted.
    pub fn note(&mut self, bap: Bap, change: i64) {
        let end = usize::from(change < 0);
        let reached = &mut self.now[bap.index()][end];
        *reached = change.unsigned_abs().min(i32::MAX as u64).max(u64::from(reached.unsigned_abs())) as i32;
    }

    /// Ends an I period in which the BAPs of `mask` were on; what was needed earlier keeps the share `keep`.
    pub fn end_period(&mut self, mask: &BapMask, keep: f64) {
        for bap in mask.iter() {
            let ends = self.before[bap.index()].iter_mut().zip(&mut self.now[bap.index()]);
            ends.for_each(|(before, now)| {
                *before = (*now).max((keep * f64::from(*before)) as i32);
                *now = 0;
            });
        }
        self.known = self.known.union(mask);
    }

    /// Whether a whole I period of the BAP has been seen.
    pub fn knows(&self, bap: Bap) -> bool {
        self.known.contains(bap)
    }

    /// Largest changes seen, upwards and downwards.
    pub fn seen(&self, bap: Bap) -> [i32; 2] {
        let [now, before] = [self.now[bap.index()], self.before[bap.index()]];
        [now[0].max(before[0]), now[1].max(before[1])]
    }
}

/// That a value, or in a P plane a change, is beyond what any range holds at this quantiser index.
pub(super) fn out_of_range(
    bap: Bap,
    kind: PlaneKind,
    value: i32,
    steps: StepTable,
    quant: u8,
) -> EncodeError {
    let reach = |quant| i64::from(range_levels(MAX_RANGE_CODE, quant)) * i64::from(step(bap, steps, quant));
    let max = reach(quant);
    let further = (quant + 1..=MAX_QUANT).any(|quant| reach(quant) > max);
    EncodeError::OutOfRange { bap, value, min: -max, max, kind, further, frame: None }
}

/// Codes of the I range that just holds `value` at quantiser index `quant`: maximum and minimum.
///
/// # Errors
/// [`EncodeError::OutOfRange`] when no range does.
pub(super) fn intra_codes(bap: Bap, value: i32, steps: StepTable, quant: u8) -> Result<[u8; 2], EncodeError> {
    let step = step(bap, steps, quant);
    let level = intra_level(value, step, quant);
    let code = |magnitude: i32| {
        range_code(magnitude, quant).ok_or_else(|| out_of_range(bap, PlaneKind::Intra, value, steps, quant))
    };
    Ok([code(level.max(0))?, code(-level.min(0))?])
}

/// That an I plane can carry all values of a frame, with this quantiser index or a coarser one.
///
/// # Errors
/// [`EncodeError::OutOfRange`] for the first that none can.
pub(super) fn check_reach(frame: &BapFrame, steps: StepTable, quant: u8) -> Result<(), EncodeError> {
    let carried = |bap, value, quant| intra_codes(bap, value, steps, quant).map(drop);
    frame.iter().try_for_each(|(bap, value)| {
        let coarser = |error| (quant + 1..=MAX_QUANT).find_map(|q| carried(bap, value, q).ok()).ok_or(error);
        carried(bap, value, quant).or_else(coarser)
    })
}

/// Code of a P range end that holds changes of `reach` units, or the largest there is.
pub(super) fn predicted_code(bap: Bap, reach: i32, steps: StepTable, quant: u8) -> u8 {
    // In base steps first and rounded up, so that a coarser quantiser does not reach less far.
    let base = reach.unsigned_abs().div_ceil(bap.base_step(steps).unsigned_abs().max(1));
    let code = base.div_ceil(RANGE_DELTA as u32).min(MAX_RANGE_CODE.into()) as u8;
    let levels = round_level(reach.into(), step(bap, steps, quant));
    code.max(range_code(levels, quant).unwrap_or(MAX_RANGE_CODE))
}

/// Sets the ranges of all BAPs in `params.mask`: I ranges that just hold the values of `frame`, and P
/// ranges that hold changes of `reach` units upwards and downwards.
///
/// # Errors
/// [`EncodeError::OutOfRange`] for a value that no I range holds.
pub(super) fn set_ranges(
    params: &mut IntraParams,
    frame: &BapFrame,
    steps: StepTable,
    reach: impl Fn(Bap) -> [i32; 2],
) -> Result<(), EncodeError> {
    let quant = params.quant;
    for bap in params.mask.iter() {
        let intra = intra_codes(bap, frame.value(bap), steps, quant)?;
        let predicted = reach(bap).map(|reach| predicted_code(bap, reach, steps, quant));
        let codes = [intra[0], intra[1], predicted[0], predicted[1]];
        for (end, code) in RangeEnd::ALL.into_iter().zip(codes) {
            params.ranges[end as usize].get_or_insert([0; BAP_COUNT])[bap.index()] = code;
        }
    }
    Ok(())
}
