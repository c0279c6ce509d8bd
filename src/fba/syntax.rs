//! The syntax tables of an FBA object plane, each one function that reads or writes.
//!
//! A function takes the value to write and returns the value that now stands in the stream: with a
//! [`BitWriter`] that is the one it was given, with a [`BitReader`] the one read. So reader and writer
//! cannot disagree. Section numbers are those of `spec/fba-bitstream.md`.

use super::arith::{self, SymbolCoder};
use super::bits::{BitCounter, BitReader, BitWriter, Element, Trace};
use super::error::SyntaxError;
use crate::bap::{BAP_COUNT, BapMask, GROUP_COUNT, GROUPS, group_members};

/// First 32 bits of an FBA object.
pub const OBJECT_START: u32 = 0x0000_01ba;
/// May stand in front of a plane.
pub const PLANE_START: u32 = 0x0000_01bb;
/// Ends a stream.
pub const SEQUENCE_END: u32 = 0x0000_01b1;
/// Begins the optional visual object sequence around an FBA object.
pub const SEQUENCE_START: u32 = 0x0000_01b0;
/// User data inside that sequence.
pub const USER_DATA: u32 = 0x0000_01b2;
/// The visual object header inside that sequence.
pub const VISUAL_OBJECT: u32 = 0x0000_01b5;
/// Object start code of old drafts, still accepted.
pub const OLD_OBJECT_START: u32 = 0x0000_0101;
/// Plane start code of old drafts, still accepted.
pub const OLD_PLANE_START: u32 = 0x0000_0103;

/// Magnitude of a range end per unit of its 5-bit code, in base steps.
pub const RANGE_DELTA: i32 = 60;
/// Largest range code.
pub const MAX_RANGE_CODE: u8 = 31;

/// Multiplier of the base step for each quantiser index; index 0 means no quantisation.
pub const SCALES: [i32; 32] = [
    0, 1, 2, 3, 5, 7, 9, 11, 14, 17, 20, 23, 27, 31, 35, 39, 43, 47, 52, 57, 62, 67, 72, 77, 82, 88, 94, 100,
    106, 113, 120, 127,
];

/// Reads or writes syntax elements.
pub trait Fields {
    /// Codes the values of one arithmetic-coded part.
    type Coder<'a>: SymbolCoder
    where
        Self: 'a;

    /// An unsigned field of `width` bits, highest bit first.
    ///
    /// # Errors
    /// End of data, or a value too large for the field.
    fn u(
        &mut self,
        name: &'static str,
        subject: Option<u16>,
        width: u32,
        value: u32,
    ) -> Result<u32, SyntaxError>;

    /// Starts an arithmetic-coded part.
    ///
    /// # Errors
    /// End of data.
    fn arithmetic(&mut self) -> Result<Self::Coder<'_>, SyntaxError>;

    /// Bits from the start of the stream.
    fn bit_position(&self) -> u64;

    /// A one-bit field.
    ///
    /// # Errors
    /// End of data.
    fn flag(&mut self, name: &'static str, value: bool) -> Result<bool, SyntaxError> {
        Ok(self.u(name, None, 1, value.into())? == 1)
    }

    /// A bit that must be 1.
    ///
    /// # Errors
    /// End of data, or a 0.
    fn marker(&mut self, place: &'static str) -> Result<(), SyntaxError> {
        let bit = self.bit_position();
        if self.u("marker_bit", None, 1, 1)? == 1 { Ok(()) } else { Err(SyntaxError::Marker { bit, place }) }
    }
}

impl Fields for BitWriter {
    type Coder<'a> = arith::Encoder<'a, BitWriter>;

    fn u(
        &mut self,
        name: &'static str,
        _subject: Option<u16>,
        width: u32,
        value: u32,
    ) -> Result<u32, SyntaxError> {
        if width < 32 && value >> width != 0 {
            return Err(SyntaxError::FieldOverflow { name, value, width });
        }
        self.put(width, value);
        Ok(value)
    }

    fn arithmetic(&mut self) -> Result<Self::Coder<'_>, SyntaxError> {
        Ok(arith::Encoder::new(self))
    }

    fn bit_position(&self) -> u64 {
        self.position()
    }
}

/// Checks that values fit and counts bits, without storing any.
impl Fields for BitCounter {
    type Coder<'a> = arith::Encoder<'a, Self>;

    fn u(
        &mut self,
        name: &'static str,
        _subject: Option<u16>,
        width: u32,
        value: u32,
    ) -> Result<u32, SyntaxError> {
        if width < 32 && value >> width != 0 {
            return Err(SyntaxError::FieldOverflow { name, value, width });
        }
        self.bits += u64::from(width);
        Ok(value)
    }

    fn arithmetic(&mut self) -> Result<Self::Coder<'_>, SyntaxError> {
        Ok(arith::Encoder::new(self))
    }

    fn bit_position(&self) -> u64 {
        self.bits
    }
}

impl<'d, T: Trace> Fields for BitReader<'d, T> {
    type Coder<'a>
        = arith::Decoder<'a, 'd, T>
    where
        Self: 'a;

    fn u(
        &mut self,
        name: &'static str,
        subject: Option<u16>,
        width: u32,
        _value: u32,
    ) -> Result<u32, SyntaxError> {
        let bit = self.stream_position();
        let value = self.take(width)?;
        self.trace.element(Element { bit, width, name, subject, value: value.into() });
        Ok(value)
    }

    fn arithmetic(&mut self) -> Result<Self::Coder<'_>, SyntaxError> {
        arith::Decoder::new(self, true)
    }

    fn bit_position(&self) -> u64 {
        self.stream_position()
    }
}

/// Kind of an object plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum PlaneKind {
    /// Values coded on their own; may change masks, ranges, quantiser, rate and time code.
    Intra,
    /// Differences to the plane before.
    #[default]
    Predicted,
}

impl PlaneKind {
    /// `'I'` or `'P'`.
    pub fn letter(self) -> char {
        match self {
            Self::Intra => 'I',
            Self::Predicted => 'P',
        }
    }
}

/// A frame rate as a plane header holds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FrameRate {
    /// Whole frames per second.
    pub whole: u8,
    /// Sixteenths of a frame per second, 0 to 15.
    pub sixteenths: u8,
    /// Whether the rate is multiplied by 1000/1001.
    pub offset: bool,
}

impl FrameRate {
    /// What a decoder assumes when a stream never sends a rate.
    pub const ASSUMED: Self = Self { whole: 30, sixteenths: 0, offset: false };

    /// The codable rate nearest to `rate` frames per second, if it lies within 0.1 % of it.
    pub fn nearest(rate: f64) -> Option<Self> {
        let mut best: Option<(f64, Self)> = None;
        for offset in [false, true] {
            let units = (rate * 16.0 * if offset { 1.001 } else { 1.0 }).round();
            if !(1.0..4096.0).contains(&units) {
                continue;
            }
            let units = units as u32;
            let candidate = Self { whole: (units / 16) as u8, sixteenths: (units % 16) as u8, offset };
            let error = (candidate.per_second() - rate).abs();
            if best.is_none_or(|(least, _)| error < least) {
                best = Some((error, candidate));
            }
        }
        best.filter(|(error, _)| *error <= rate * 1e-3).map(|(_, candidate)| candidate)
    }

    /// Frames per second.
    pub fn per_second(self) -> f64 {
        let rate = f64::from(self.whole) + f64::from(self.sixteenths) / 16.0;
        if self.offset { rate * 1000.0 / 1001.0 } else { rate }
    }

    fn code<F: Fields>(f: &mut F, rate: Self) -> Result<Self, SyntaxError> {
        Ok(Self {
            whole: f.u("frame_rate", None, 8, rate.whole.into())? as u8,
            sixteenths: f.u("seconds", None, 4, rate.sixteenths.into())? as u8,
            offset: f.flag("frequency_offset", rate.offset)?,
        })
    }
}

/// A time code as a plane header holds it: whole seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TimeCode {
    /// Hours, 0 to 31.
    pub hours: u8,
    /// Minutes, 0 to 63.
    pub minutes: u8,
    /// The marker bit, 1 in a conforming stream; the vendor's encoder may write 0.
    pub marker: bool,
    /// Seconds, 0 to 63.
    pub seconds: u8,
}

impl TimeCode {
    /// The code for this many whole seconds, if the field can hold it (below 32 hours).
    pub fn from_seconds(seconds: u32) -> Option<Self> {
        let hours = seconds / 3600;
        let minutes = (seconds / 60 % 60) as u8;
        let code = Self { hours: hours as u8, minutes, marker: true, seconds: (seconds % 60) as u8 };
        (hours < 32).then_some(code)
    }

    /// The code of frame number `frame` at `rate`, if it falls on a whole second.
    pub fn at(frame: u64, rate: FrameRate) -> Option<Self> {
        let seconds = frame as f64 / rate.per_second();
        let whole = (seconds - seconds.round()).abs() < 1e-6;
        whole.then(|| Self::from_seconds(seconds.round() as u32)).flatten()
    }

    /// The time it names, in seconds.
    pub fn in_seconds(self) -> u32 {
        (u32::from(self.hours) * 60 + u32::from(self.minutes)) * 60 + u32::from(self.seconds)
    }

    fn code<F: Fields>(f: &mut F, time: Self) -> Result<Self, SyntaxError> {
        Ok(Self {
            hours: f.u("time_code_hours", None, 5, time.hours.into())? as u8,
            minutes: f.u("time_code_minutes", None, 6, time.minutes.into())? as u8,
            marker: f.flag("marker_bit", time.marker)?,
            seconds: f.u("time_code_seconds", None, 6, time.seconds.into())? as u8,
        })
    }
}

/// The header of an object plane (1.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaneHeader {
    /// I or P plane.
    pub kind: PlaneKind,
    /// Which parts follow: bit 0 the face, bit 1 the body.
    pub object_mask: u8,
    /// Frame rate, I planes only.
    pub rate: Option<FrameRate>,
    /// Time code, I planes only.
    pub time_code: Option<TimeCode>,
    /// Number of frames skipped before this one.
    pub skipped: u32,
    /// Whether the skip flag is set though no frame is skipped.
    pub explicit_skip: bool,
}

impl PlaneHeader {
    /// Whether the plane carries a face part.
    pub fn has_face(&self) -> bool {
        self.object_mask & 1 != 0
    }

    /// Whether the plane carries a body part.
    pub fn has_body(&self) -> bool {
        self.object_mask & 2 != 0
    }
}

/// Plane header with temporal header (1.3). A plane with object mask 0 has only three bits.
///
/// # Errors
/// End of data, fields too small for the values, or more than `skip_limit` skipped frames.
pub fn plane_header<F: Fields>(
    f: &mut F,
    header: &PlaneHeader,
    skip_limit: u32,
) -> Result<PlaneHeader, SyntaxError> {
    let start = f.bit_position();
    let intra = f.flag("is_intra", header.kind == PlaneKind::Intra)?;
    let kind = if intra { PlaneKind::Intra } else { PlaneKind::Predicted };
    let object_mask = f.u("fba_object_mask", None, 2, header.object_mask.into())? as u8;
    let mut out = PlaneHeader { kind, object_mask, ..PlaneHeader::default() };
    if object_mask == 0 {
        return Ok(out);
    }
    if intra {
        if f.flag("is_frame_rate", header.rate.is_some())? {
            out.rate = Some(FrameRate::code(f, header.rate.unwrap_or(FrameRate::ASSUMED))?);
        }
        if f.flag("is_time_code", header.time_code.is_some())? {
            let zero = TimeCode { hours: 0, minutes: 0, marker: true, seconds: 0 };
            out.time_code = Some(TimeCode::code(f, header.time_code.unwrap_or(zero))?);
        }
    }
    out.explicit_skip = f.flag("skip_frames", header.skipped > 0 || header.explicit_skip)?;
    if out.explicit_skip {
        let mut left = header.skipped;
        loop {
            let part = f.u("number_of_frames_to_skip", None, 4, left.min(15))?;
            left -= left.min(15);
            out.skipped += part;
            if out.skipped > skip_limit {
                return Err(SyntaxError::SkipLimit { bit: start, limit: skip_limit });
            }
            if part < 15 {
                break;
            }
        }
        out.explicit_skip = out.skipped == 0;
    }
    Ok(out)
}

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

/// How range codes become levels; sources differ (D2 in `spec/NOTES.md`). At quantiser indices 0 and 1 both
/// are the same. A stream does not say which it was made with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum RangeRule {
    /// Divided by the scale: what the reference software does.
    #[default]
    Divided,
    /// As they are: coarser quantisers reach further.
    Undivided,
}

impl RangeRule {
    /// Range end in levels for a range code at quantiser index `quant`, as a magnitude.
    pub fn levels(self, code: u8, quant: u8) -> i32 {
        range_levels(code, if self == Self::Divided { quant } else { 1 })
    }
}

/// Range end in levels for a range code at quantiser index `quant`, as a magnitude (1.5).
pub fn range_levels(code: u8, quant: u8) -> i32 {
    RANGE_DELTA * i32::from(code) / scale(quant).max(1)
}

/// Smallest code whose range reaches `magnitude` levels at quantiser index `quant`; `None` when even
/// the largest does not.
pub fn range_code(magnitude: i32, quant: u8) -> Option<u8> {
    (0..=MAX_RANGE_CODE).find(|&code| range_levels(code, quant) >= magnitude)
}

/// Multiplier of the base step at quantiser index `quant`; 0 means values are coded as they are.
pub fn scale(quant: u8) -> i32 {
    SCALES[usize::from(quant & 31)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skipped_frames_are_coded_in_nibbles() {
        for (skipped, bits) in [(0, 4), (1, 8), (14, 8), (15, 12), (30, 16), (31, 16)] {
            let header = PlaneHeader { object_mask: 2, skipped, ..PlaneHeader::default() };
            let mut writer = BitWriter::new();
            plane_header(&mut writer, &header, 100).unwrap();
            assert_eq!(writer.position(), bits);
            let bytes = writer.into_bytes();
            assert_eq!(plane_header(&mut BitReader::new(&bytes), &PlaneHeader::default(), 100), Ok(header));
        }
    }

    #[test]
    fn rates() {
        for (rate, whole, sixteenths, offset) in
            [(30.0, 30, 0, false), (29.97, 30, 0, true), (23.976, 24, 0, true), (30.5, 30, 8, false)]
        {
            assert_eq!(FrameRate::nearest(rate), Some(FrameRate { whole, sixteenths, offset }));
        }
        assert_eq!(FrameRate::nearest(0.0), None);
        assert_eq!(FrameRate::nearest(1000.0), None);
        assert_eq!(FrameRate::nearest(f64::NAN), None);
    }

    #[test]
    fn time_codes() {
        assert_eq!(TimeCode::from_seconds(86_399).map(TimeCode::in_seconds), Some(86_399));
        assert_eq!(TimeCode::from_seconds(32 * 3600), None);
    }

    #[test]
    fn ranges_divide_by_the_scale() {
        assert_eq!(range_levels(31, 1), 1860);
        assert_eq!(range_levels(31, 0), 1860);
        assert_eq!(range_levels(1, 20), 0);
        assert_eq!(range_levels(2, 20), 1);
        assert_eq!(range_code(1, 20), Some(2));
        assert_eq!(range_code(1861, 1), None);
    }
}
