//! What the body part of an I plane says before its values (1.4, 1.5): quantiser, masks, ranges.

use super::super::error::SyntaxError;
use super::Fields;
use crate::bap::{BAP_COUNT, BapMask, GROUP_COUNT, GROUPS, group_members};

/// New range codes for all BAPs: entry `n − 1` belongs to BAP `n`.
pub type RangeCodes = [u8; BAP_COUNT];

/// The four range arrays in stream order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RangeEnd {
    /// Largest I value.
    IntraMax = 0,
    /// Smallest I value.
    IntraMin = 1,
    /// Largest P difference.
    PredictedMax = 2,
    /// Smallest P difference.
    PredictedMin = 3,
}

impl RangeEnd {
    /// All four, in the order in which they are coded.
    pub const ALL: [Self; 4] = [Self::IntraMax, Self::IntraMin, Self::PredictedMax, Self::PredictedMin];

    /// Name of the flag that announces the array.
    pub fn flag_name(self) -> &'static str {
        ["is_i_new_max", "is_i_new_min", "is_p_new_max", "is_p_new_min"][self as usize]
    }

    fn value_name(self) -> &'static str {
        ["i_new_max", "i_new_min", "p_new_max", "p_new_min"][self as usize]
    }
}

/// What the body part of an I plane says before its values (1.4).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IntraParams {
    /// Quantiser index, 0 to 31.
    pub quant: u8,
    /// BAPs switched on.
    pub mask: BapMask,
    /// Groups that are coded with an explicit mask although all their BAPs are on.
    pub explicit_groups: u32,
    /// Groups that are coded with an explicit mask although none of their BAPs is on.
    pub explicit_empty_groups: u32,
    /// Suggested gender: true is male.
    pub male: bool,
    /// New range codes, by [`RangeEnd`].
    pub ranges: [Option<RangeCodes>; 4],
}

impl Default for IntraParams {
    fn default() -> Self {
        Self {
            quant: 1,
            mask: BapMask::EMPTY,
            explicit_groups: 0,
            explicit_empty_groups: 0,
            male: false,
            ranges: [None; 4],
        }
    }
}

/// Bit positions of the sections of a coded body part, in stream order; a report of where bits go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IntraMarks {
    /// End of quantiser index and group masks.
    pub masks: u64,
    /// End of gender, coding type, range flags and range arrays.
    pub ranges: u64,
}

/// Quantiser index, masks, gender, coding type, range flags and range arrays of an I plane (1.4, 1.5).
/// `params` gives the values to write and receives those read.
///
/// # Errors
/// End of data, a marker that is 0, mask type 2, or DCT coding, which is not implemented.
pub fn intra_params<F: Fields>(f: &mut F, params: &mut IntraParams) -> Result<IntraMarks, SyntaxError> {
    params.quant = f.u("bap_quant", None, 5, params.quant.into())? as u8;
    bap_masks(f, params)?;
    let masks = f.bit_position();
    params.male = f.flag("fba_suggested_gender", params.male)?;
    let bit = f.bit_position();
    if f.flag("bap_object_coding_type", false)? {
        return Err(SyntaxError::Unsupported { bit, what: "dct coding of baps (coding type 1)" });
    }
    for end in RangeEnd::ALL {
        let codes = &mut params.ranges[end as usize];
        match (f.flag(end.flag_name(), codes.is_some())?, codes.is_some()) {
            (true, false) => *codes = Some([0; BAP_COUNT]),
            (false, true) => *codes = None,
            _ => {}
        }
    }
    for end in RangeEnd::ALL {
        if let Some(codes) = &mut params.ranges[end as usize] {
            new_minmax(f, &params.mask, end, codes)?;
        }
    }
    Ok(IntraMarks { masks, ranges: f.bit_position() })
}

/// Group masks (1.4).
fn bap_masks<F: Fields>(f: &mut F, params: &mut IntraParams) -> Result<(), SyntaxError> {
    let mut mask = BapMask::EMPTY;
    let (mut explicit_full, mut explicit_empty) = (0, 0);
    for (group, members) in GROUPS.iter().enumerate() {
        let number = Some(group as u16 + 1);
        f.marker("bap masks")?;
        let size = members.len();
        let on = group_members(group).filter(|&bap| params.mask.contains(bap)).count();
        let kind = if on == size && params.explicit_groups >> group & 1 == 0 {
            3
        } else if on == 0 && params.explicit_empty_groups >> group & 1 == 0 {
            0
        } else {
            1
        };
        let bit = f.bit_position();
        match f.u("bap_mask_type", number, 2, kind)? {
            0 => {}
            1 => {
                let mut count = 0;
                for bap in group_members(group) {
                    let bit =
                        f.u("bap_group_mask", Some(bap.number()), 1, params.mask.contains(bap).into())?;
                    mask.set(bap, bit == 1);
                    count += bit as usize;
                }
                explicit_full |= u32::from(count == size) << group;
                explicit_empty |= u32::from(count == 0) << group;
            }
            3 => group_members(group).for_each(|bap| mask.insert(bap)),
            _ => return Err(SyntaxError::MaskType { bit, group: group as u16 + 1 }),
        }
    }
    params.mask = mask;
    params.explicit_groups = explicit_full;
    params.explicit_empty_groups = explicit_empty;
    Ok(())
}

/// One array of the new min/max block (1.5).
fn new_minmax<F: Fields>(
    f: &mut F,
    mask: &BapMask,
    end: RangeEnd,
    codes: &mut RangeCodes,
) -> Result<(), SyntaxError> {
    for group in 0..GROUP_COUNT {
        for (position, bap) in group_members(group).enumerate() {
            if position % 4 == 0 {
                f.marker("new min/max block")?;
            }
            if mask.contains(bap) {
                let code = &mut codes[bap.index()];
                *code = f.u(end.value_name(), Some(bap.number()), 5, (*code).into())? as u8;
            }
        }
    }
    Ok(())
}
