//! What persists between the planes of one object: masks, ranges, quantiser, adaptive models and
//! reconstructed values. Encoder and decoder keep the same state and change it by the same functions.

use super::arith::{self, Adaptive, Flat, Model, SymbolCoder};
use super::error::SyntaxError;
use super::syntax::{
    IntraParams, MAX_RANGE_CODE, PlaneKind, RANGE_DELTA, RangeEnd, RangeRule, range_levels, scale,
};
use crate::bap::{BAP_COUNT, Bap, BapMask, StepTable, coding_order};

/// A BAP that is switched on, with what its coding needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// The BAP.
    pub bap: Bap,
    /// Quantiser step in the unit of the value: base step times scale, or 1 at quantiser index 0.
    pub step: i32,
    /// Smallest and largest level of an I value.
    pub intra: [i32; 2],
    /// Smallest and largest level of a P difference.
    pub predicted: [i32; 2],
    /// First entry of its P model in [`Models`].
    model: usize,
}

impl Slot {
    /// Smallest and largest level in a plane of this kind.
    pub fn range(&self, kind: PlaneKind) -> [i32; 2] {
        match kind {
            PlaneKind::Intra => self.intra,
            PlaneKind::Predicted => self.predicted,
        }
    }

    fn predicted_symbols(&self) -> usize {
        symbols(self.predicted)
    }

    /// Where its P model lies in [`Models`].
    fn table(&self) -> std::ops::Range<usize> {
        self.model..self.model + arith::table_length(self.predicted_symbols())
    }
}

fn symbols([min, max]: [i32; 2]) -> usize {
    (max - min + 1) as usize
}

/// Ranges ever sent for one BAP, in levels, by [`RangeEnd`]. They are stored as divided by the scale
/// in force when they were sent.
type SentRanges = [Option<i16>; 4];

/// The coding parameters in force: what an I plane sets.
#[derive(Clone, Debug)]
pub struct Layout {
    steps: StepTable,
    rule: RangeRule,
    quant: u8,
    mask: BapMask,
    sent: [SentRanges; BAP_COUNT],
    slots: Vec<Slot>,
}

impl Layout {
    /// Nothing switched on, no range sent.
    pub fn new(steps: StepTable, rule: RangeRule) -> Self {
        Self {
            steps,
            rule,
            quant: 1,
            mask: BapMask::EMPTY,
            sent: [[None; 4]; BAP_COUNT],
            slots: Vec::with_capacity(BAP_COUNT),
        }
    }

    /// The base steps in use.
    pub fn steps(&self) -> StepTable {
        self.steps
    }

    /// Quantiser index in force.
    pub fn quant(&self) -> u8 {
        self.quant
    }

    /// BAPs switched on.
    pub fn mask(&self) -> BapMask {
        self.mask
    }

    /// The BAPs switched on, in coding order.
    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// Makes this the layout that an I plane with `params` sets up when `before` was in force.
    ///
    /// A range end never sent is the table's default, rounded out to a multiple of 60 and divided
    /// by the scale in force now (or not, as the [`RangeRule`] says).
    pub fn follow(&mut self, before: &Self, params: &IntraParams) {
        self.steps = before.steps;
        self.rule = before.rule;
        self.quant = params.quant;
        self.mask = params.mask;
        self.sent = before.sent;
        self.slots.clear();
        let mut model = 0;
        for bap in coding_order().filter(|&bap| params.mask.contains(bap)) {
            let sent = &mut self.sent[bap.index()];
            for end in RangeEnd::ALL {
                if let Some(codes) = &params.ranges[end as usize] {
                    sent[end as usize] = Some(self.rule.levels(codes[bap.index()], params.quant) as i16);
                }
            }
            let end = |end: RangeEnd| match sent[end as usize] {
                Some(levels) => i32::from(levels),
                None => self.rule.levels(default_code(bap, end), params.quant),
            };
            let slot = Slot {
                bap,
                step: step(bap, self.steps, params.quant),
                intra: [-end(RangeEnd::IntraMin), end(RangeEnd::IntraMax)],
                predicted: [-end(RangeEnd::PredictedMin), end(RangeEnd::PredictedMax)],
                model,
            };
            model += arith::table_length(slot.predicted_symbols());
            self.slots.push(slot);
        }
    }
}

/// Quantiser step of `bap` at quantiser index `quant`; 1 where the scale is 0 (no quantisation).
pub fn step(bap: Bap, steps: StepTable, quant: u8) -> i32 {
    match scale(quant) {
        0 => 1,
        scale => bap.base_step(steps) * scale,
    }
}

/// Code of a default limit: its magnitude in units of 60 base steps, rounded up.
pub fn default_code(bap: Bap, end: RangeEnd) -> u8 {
    let limit = match end {
        RangeEnd::IntraMax => bap.intra_limits()[1],
        RangeEnd::IntraMin => bap.intra_limits()[0],
        RangeEnd::PredictedMax => bap.predicted_limits()[1],
        RangeEnd::PredictedMin => bap.predicted_limits()[0],
    };
    limit.unsigned_abs().div_ceil(RANGE_DELTA as u32) as u8
}

/// The P models of all slots of a layout, in one piece of memory.
#[derive(Clone, Debug, Default)]
pub struct Models {
    tables: Vec<u16>,
}

impl Models {
    /// Fresh models, every count one, for `layout`.
    pub fn reset(&mut self, layout: &Layout) {
        self.tables.resize(layout.slots.last().map_or(0, |slot| slot.table().end), 0);
        for slot in &layout.slots {
            arith::reset(self.table_mut(slot));
        }
    }

    /// The model of one slot.
    pub fn model(&self, slot: &Slot) -> Adaptive<'_> {
        Adaptive::new(&self.tables[slot.table()])
    }

    fn table_mut(&mut self, slot: &Slot) -> &mut [u16] {
        &mut self.tables[slot.table()]
    }

    /// Counts the levels of one P plane.
    pub fn update(&mut self, layout: &Layout, levels: &[i32]) {
        for (slot, &level) in layout.slots.iter().zip(levels) {
            arith::update(self.table_mut(slot), (level - slot.predicted[0]) as usize);
        }
    }
}

/// The arithmetic-coded values of one plane (1.8): `levels` gives those to write, or receives those
/// read. Models are used as they are; [`Models::update`] follows when the plane is complete.
///
/// # Errors
/// A level outside its range when writing; end of data or damaged data when reading.
pub fn bap_values<C: SymbolCoder>(
    mut coder: C,
    kind: PlaneKind,
    layout: &Layout,
    models: &Models,
    levels: &mut [i32],
) -> Result<(), SyntaxError> {
    let name = if kind == PlaneKind::Intra { "bap_i_value" } else { "bap_p_value" };
    for (slot, level) in layout.slots.iter().zip(levels) {
        let [min, max] = slot.range(kind);
        // When reading, the level handed in means nothing; any symbol of the model will do.
        let given = (*level - min).clamp(0, max - min) as usize;
        let symbol = match kind {
            PlaneKind::Intra => code(&mut coder, &Flat(symbols([min, max]) as u32), given)?,
            PlaneKind::Predicted => code(&mut coder, &models.model(slot), given)?,
        };
        *level = symbol as i32 + min;
        coder.note(name, slot.bap.number(), i64::from(*level));
    }
    coder.finish()
}

fn code<C: SymbolCoder, M: Model>(coder: &mut C, model: &M, symbol: usize) -> Result<usize, SyntaxError> {
    coder.symbol(model, symbol)
}

/// Checks that every level can be coded in a plane of this kind.
///
/// # Errors
/// [`SyntaxError::Level`] for the first that cannot.
pub fn check_levels(layout: &Layout, kind: PlaneKind, levels: &[i32]) -> Result<(), SyntaxError> {
    for (slot, &level) in layout.slots.iter().zip(levels) {
        let [min, max] = slot.range(kind);
        if level < min || level > max {
            return Err(SyntaxError::Level { level, min, max });
        }
    }
    Ok(())
}

/// Adds a plane's levels to the reconstructed values `values` (by BAP index); nothing is changed on
/// error.
///
/// # Errors
/// [`SyntaxError::Overflow`] when a value leaves the 32-bit range; `bit` is where the plane begins.
pub fn reconstruct(
    layout: &Layout,
    kind: PlaneKind,
    levels: &[i32],
    values: &mut [i32; BAP_COUNT],
    bit: u64,
) -> Result<(), SyntaxError> {
    let value = |slot: &Slot, level: i32, before: i32| {
        let base = if kind == PlaneKind::Intra { 0 } else { before };
        level
            .checked_mul(slot.step)
            .and_then(|change| base.checked_add(change))
            .ok_or(SyntaxError::Overflow { bit, bap: slot.bap.number() })
    };
    for (slot, &level) in layout.slots.iter().zip(levels) {
        value(slot, level, values[slot.bap.index()])?;
    }
    for (slot, &level) in layout.slots.iter().zip(levels) {
        let before = values[slot.bap.index()];
        values[slot.bap.index()] = value(slot, level, before)?;
    }
    Ok(())
}

/// Level of `difference` with plain rounding, as the vendor's encoder does it: 0 up to half a step
/// (integer half), else `(|difference| + step / 2) / step` with the sign restored.
pub fn round_level(difference: i64, step: i32) -> i32 {
    let step = i64::from(step.max(1));
    let magnitude = difference.abs();
    if magnitude <= step / 2 {
        return 0;
    }
    let level = ((magnitude + step / 2) / step).min(i64::from(i32::MAX)) as i32;
    if difference < 0 { -level } else { level }
}

/// Level of an I value: its rounded one, but the one below where only that lies in the largest range at `quant`.
pub fn intra_level(value: i32, step: i32, quant: u8) -> i32 {
    let level = round_level(value.into(), step);
    let most = range_levels(MAX_RANGE_CODE, quant);
    let scaled = i64::from(value).abs() * i64::from(scale(quant).max(1));
    let reach = i64::from(range_levels(MAX_RANGE_CODE, 1)) * i64::from(step);
    if scaled <= reach { level.clamp(-most, most) } else { level }
}
