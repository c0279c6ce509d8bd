//! The face part (FAPs) of an object plane: parsed so that the body part behind it can be found
//! (`spec/fba-bitstream.md` section 2). Its values are kept, but none is ever written, and no face is animated.

use super::arith::{self, Adaptive, Flat, SymbolCoder};
use super::error::SyntaxError;
use super::syntax::{Fields, PlaneKind, RANGE_DELTA, RangeEnd};

/// Number of FAPs.
pub const FAP_COUNT: usize = 68;
/// Sizes of the ten coding groups; FAPs are numbered through them.
const GROUP_SIZES: [usize; 10] = [2, 16, 12, 8, 4, 5, 3, 10, 4, 4];
/// FAP 1 (viseme) and FAP 2 (expression) have a block of their own each.
const HIGH_LEVEL: usize = 2;

/// Base steps of FAPs 3 to 68, run-length coded: count, step.
const STEPS: [(usize, i32); 13] = [
    (1, 4),
    (10, 2),
    (9, 1),
    (4, 128),
    (4, 1),
    (6, 2),
    (2, 1),
    (4, 2),
    (4, 1),
    (1, 512),
    (3, 170),
    (10, 2),
    (8, 1),
];

/// Base step of FAP `number` (3 to 68).
fn base_step(number: usize) -> i32 {
    let mut first = 3;
    for (count, step) in STEPS {
        if number < first + count {
            return step;
        }
        first += count;
    }
    1
}

/// Parameters of the face part that an I plane sets.
#[derive(Clone, Debug, PartialEq, Eq)]
struct FaceParams {
    quant: u8,
    mask: [bool; FAP_COUNT],
    types: [u8; GROUP_SIZES.len()],
    male: bool,
    /// Ranges in levels by [`RangeEnd`], divided by the quantiser in force when sent.
    sent: [[Option<i16>; 4]; FAP_COUNT],
}

/// One coded symbol of the face part.
#[derive(Clone, Copy, Debug)]
struct Slot {
    /// FAP number, 1 to 68.
    fap: u16,
    block: Block,
    intra: [i32; 2],
    predicted: [i32; 2],
    model: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Block {
    Viseme,
    Expression,
    LowLevel,
}

impl Block {
    /// Names of the raw bits behind the block.
    fn raw_bits(self) -> &'static [&'static str] {
        match self {
            Self::Viseme => &["viseme_def"],
            Self::Expression => &["init_face", "expression_def"],
            Self::LowLevel => &[],
        }
    }
}

/// Face parameters, models and values of one object.
#[derive(Clone, Debug)]
pub(super) struct FaceState {
    params: FaceParams,
    next_params: FaceParams,
    slots: Vec<Slot>,
    next_slots: Vec<Slot>,
    tables: Vec<u16>,
    levels: Vec<i32>,
    values: [i32; FAP_COUNT],
    started: bool,
}

impl Slot {
    fn predicted_symbols(&self) -> usize {
        (self.predicted[1] - self.predicted[0]) as usize + 1
    }

    /// Where its P model lies among the tables.
    fn table(&self) -> std::ops::Range<usize> {
        self.model..self.model + arith::table_length(self.predicted_symbols())
    }
}

impl FaceState {
    pub fn new() -> Self {
        let params = FaceParams {
            quant: 1,
            mask: [false; FAP_COUNT],
            types: [0; 10],
            male: false,
            sent: [[None; 4]; FAP_COUNT],
        };
        Self {
            next_params: params.clone(),
            params,
            slots: Vec::new(),
            next_slots: Vec::new(),
            tables: Vec::new(),
            levels: Vec::new(),
            values: [0; FAP_COUNT],
            started: false,
        }
    }

    /// Numbers and values of the low-level FAPs switched on.
    pub fn values(&self) -> impl Iterator<Item = (usize, i32)> + '_ {
        (HIGH_LEVEL..FAP_COUNT).filter(|&fap| self.params.mask[fap]).map(|fap| (fap + 1, self.values[fap]))
    }

    /// Parses the face part of a plane; only scratch is changed.
    pub fn parse<F: Fields>(&mut self, f: &mut F, kind: PlaneKind, start: u64) -> Result<(), SyntaxError> {
        if kind == PlaneKind::Intra {
            self.next_params = self.params.clone();
            face_params(f, &mut self.next_params)?;
            lay_out(&self.next_params, &mut self.next_slots, f.bit_position())?;
        } else if !self.started {
            return Err(SyntaxError::NoIntra { bit: start });
        }
        let slots = if kind == PlaneKind::Intra { &self.next_slots } else { &self.slots };
        self.levels.clear();
        for block in [Block::Viseme, Block::Expression, Block::LowLevel] {
            if block != Block::LowLevel && !slots.iter().any(|slot| slot.block == block) {
                continue;
            }
            let mut coder = f.arithmetic()?;
            for slot in slots.iter().filter(|slot| slot.block == block) {
                let level = if kind == PlaneKind::Intra {
                    let [min, max] = slot.intra;
                    coder.symbol(&Flat((max - min + 1) as u32), 0)? as i32 + min
                } else {
                    let table = &self.tables[slot.table()];
                    coder.symbol(&Adaptive::new(table), 0)? as i32 + slot.predicted[0]
                };
                let name = if kind == PlaneKind::Intra { "fap_i_value" } else { "fap_p_value" };
                coder.note(name, slot.fap, level.into());
                self.levels.push(level);
            }
            coder.finish()?;
            for name in block.raw_bits() {
                f.flag(name, false)?;
            }
        }
        Ok(())
    }

    /// Takes over the part parsed last.
    pub fn commit(&mut self, kind: PlaneKind) {
        if kind == PlaneKind::Intra {
            std::mem::swap(&mut self.params, &mut self.next_params);
            std::mem::swap(&mut self.slots, &mut self.next_slots);
            self.tables.resize(self.slots.last().map_or(0, |slot| slot.table().end), 0);
            for slot in &self.slots {
                arith::reset(&mut self.tables[slot.table()]);
            }
            self.started = true;
        }
        for (slot, &level) in self.slots.iter().zip(&self.levels) {
            if kind == PlaneKind::Predicted {
                let table = &mut self.tables[slot.table()];
                arith::update(table, (level - slot.predicted[0]) as usize);
            }
            if slot.block == Block::LowLevel {
                let fap = usize::from(slot.fap);
                let change = level.saturating_mul(base_step(fap) * i32::from(self.params.quant.max(1)));
                let before = if kind == PlaneKind::Intra { 0 } else { self.values[fap - 1] };
                self.values[fap - 1] = before.saturating_add(change);
            }
        }
    }

    /// Refuses P planes until the next I plane.
    pub fn lose(&mut self) {
        self.started = false;
    }
}

/// Quantiser, masks, gender, coding type, range flags and range arrays of the face part.
fn face_params<F: Fields>(f: &mut F, params: &mut FaceParams) -> Result<(), SyntaxError> {
    params.quant = f.u("fap_quant", None, 5, params.quant.into())? as u8;
    let mut fap = 0;
    for (group, size) in GROUP_SIZES.into_iter().enumerate() {
        f.marker("fap masks")?;
        let number = Some(group as u16 + 1);
        let kind = f.u("fap_mask_type", number, 2, params.types[group].into())? as u8;
        params.types[group] = kind;
        for on in &mut params.mask[fap..fap + size] {
            *on = match kind {
                0 => false,
                3 => true,
                _ => f.u("fap_group_mask", number, 1, (*on).into())? == 1,
            };
        }
        fap += size;
    }
    params.male = f.flag("fba_suggested_gender", params.male)?;
    let bit = f.bit_position();
    if f.flag("fap_object_coding_type", false)? {
        return Err(SyntaxError::Unsupported { bit, what: "dct coding of faps (coding type 1)" });
    }
    let mut announced = [false; 4];
    for end in RangeEnd::ALL {
        announced[end as usize] = f.flag(end.flag_name(), false)?;
    }
    for end in RangeEnd::ALL.into_iter().filter(|&end| announced[end as usize]) {
        let mut fap = HIGH_LEVEL;
        for size in GROUP_SIZES.into_iter().skip(1) {
            for position in 0..size {
                if position % 4 == 0 {
                    f.marker("fap new min/max block")?;
                }
                if params.mask[fap] {
                    let code = f.u("fap_new_limit", Some(fap as u16 + 1), 5, 0)?;
                    let levels = RANGE_DELTA * code as i32 / i32::from(params.quant.max(1));
                    params.sent[fap][end as usize] = Some(levels as i16);
                }
                fap += 1;
            }
        }
    }
    Ok(())
}

/// The symbols of the face part in coding order.
fn lay_out(params: &FaceParams, slots: &mut Vec<Slot>, bit: u64) -> Result<(), SyntaxError> {
    slots.clear();
    let mut model = 0;
    let mut push = |fap: usize, block, intra: [i32; 2], predicted: [i32; 2]| {
        let slot = Slot { fap: fap as u16, block, intra, predicted, model };
        model = slot.table().end;
        slots.push(slot);
    };
    let quant = i32::from(params.quant.max(1));
    let intensity = (63 + quant / 2) / quant;
    if params.mask[0] {
        for max in [14, 14, intensity] {
            push(1, Block::Viseme, [0, max], [-max, max]);
        }
    }
    if params.mask[1] {
        for max in [6, intensity, 6, intensity] {
            push(2, Block::Expression, [0, max], [-max, max]);
        }
    }
    for fap in (HIGH_LEVEL..FAP_COUNT).filter(|&fap| params.mask[fap]) {
        let [Some(i_max), Some(i_min), Some(p_max), Some(p_min)] = params.sent[fap] else {
            return Err(SyntaxError::Unsupported { bit, what: "a face part whose ranges were never sent" });
        };
        push(fap + 1, Block::LowLevel, [-i32::from(i_min), i_max.into()], [-i32::from(p_min), p_max.into()]);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_and_steps_cover_all_faps() {
        assert_eq!(GROUP_SIZES.iter().sum::<usize>(), FAP_COUNT);
        assert_eq!(STEPS.iter().map(|run| run.0).sum::<usize>(), FAP_COUNT - HIGH_LEVEL);
        assert_eq!(
            [3, 4, 13, 14, 23, 47, 48, 51, 61, 68].map(base_step),
            [4, 2, 2, 1, 128, 512, 170, 2, 1, 1]
        );
        let markers: usize = GROUP_SIZES.iter().skip(1).map(|size| size.div_ceil(4)).sum();
        assert_eq!(markers, 18);
    }
}
