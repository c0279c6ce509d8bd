//! The syntax tables of an FBA object plane, each one function that reads or writes.
//!
//! A function takes the value to write and returns the value that now stands in the stream: with a
//! [`BitWriter`](super::bits::BitWriter) that is the one it was given, with a [`BitReader`](super::bits::BitReader) the one read. So reader and writer
//! cannot disagree. Section numbers are those of `spec/fba-bitstream.md`.

mod fields;
mod header;
mod intra;

pub use fields::{Field, Fields};
pub use header::{FrameRate, PlaneHeader, PlaneKind, TimeCode, plane_header};
pub use intra::{IntraMarks, IntraParams, RangeCodes, RangeEnd, intra_params};

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
    fn ranges_divide_by_the_scale() {
        assert_eq!(range_levels(31, 1), 1860);
        assert_eq!(range_levels(31, 0), 1860);
        assert_eq!(range_levels(1, 20), 0);
        assert_eq!(range_levels(2, 20), 1);
        assert_eq!(range_code(1, 20), Some(2));
        assert_eq!(range_code(1861, 1), None);
    }
}
