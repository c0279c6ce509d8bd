//! What can be wrong with a stream, and what can be wrong with a request to make one.

use thiserror::Error;

use crate::bap::{Bap, Unit};
use crate::encoder::degrees_per_unit;
use crate::syntax::{OBJECT_START, PlaneKind, SEQUENCE_START};

/// What a caller can do about an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The data end too early: with more of them it may work.
    Incomplete,
    /// The data are not what the syntax allows. A decoder goes on at the next start code with an I plane behind it,
    /// or conceals what is lost ([`DecoderOptions::conceal`](super::DecoderOptions::conceal)).
    Damaged,
    /// The data ask for more than a limit that the caller set: a higher one may help.
    Limit,
    /// Legal, but not implemented.
    Unsupported,
    /// A request to write cannot be met: it must be changed, as the error says.
    Request,
}

/// Something in a stream that is not as the syntax says, or that this decoder does not do.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum SyntaxError {
    /// The data end inside a syntax element, or before the end code.
    #[error("unexpected end of the data at bit {bit}")]
    UnexpectedEnd {
        /// Bit offset at which more data were needed.
        bit: u64,
    },
    /// The data do not begin with an FBA object: they are none, or the middle of one.
    #[error(
        "not an fba stream: the first 32 bits are {found:#010x}, expected the start code {SEQUENCE_START:#010x} of a visual object \
         sequence or {OBJECT_START:#010x} of an fba object"
    )]
    NoObject {
        /// What stands there.
        found: u32,
    },
    /// A start code that has no place in an FBA stream stands in front of the object.
    #[error("bit {bit}: unexpected start code {found:#010x} before the fba object")]
    UnexpectedStartCode {
        /// Bit offset of the code.
        bit: u64,
        /// The code.
        found: u32,
    },
    /// A marker bit is 0.
    #[error("bit {bit}: marker bit in {place} is 0, must be 1")]
    Marker {
        /// Bit offset of the marker.
        bit: u64,
        /// The syntax table it stands in.
        place: &'static str,
    },
    /// A mask type that is not allowed for BAPs.
    #[error("bit {bit}: bap_mask_type of group {group} is 2, allowed are 0, 1 and 3")]
    MaskType {
        /// Bit offset of the field.
        bit: u64,
        /// Group, 1 to 24.
        group: u16,
    },
    /// Legal syntax that this decoder does not implement.
    #[error("bit {bit}: {what} is not supported")]
    Unsupported {
        /// Bit offset of the element that asks for it.
        bit: u64,
        /// What is missing.
        what: &'static str,
    },
    /// A P plane before any I plane of the same object part.
    #[error("bit {bit}: p plane without an i plane before it")]
    NoIntra {
        /// Bit offset of the plane.
        bit: u64,
    },
    /// 22 zero bits in the arithmetic data are not followed by the 1 that must be stuffed there.
    #[error("bit {bit}: arithmetic data hold 23 zero bits in a row, at most 22 are allowed")]
    Stuffing {
        /// Bit offset of the 23rd zero.
        bit: u64,
    },
    /// The arithmetic data do not end with the two flush bits that every encoder writes.
    #[error("bit {bit}: arithmetic data do not end as the coder's flush does; the plane is damaged")]
    Flush {
        /// Bit offset of the end of the plane.
        bit: u64,
    },
    /// A plane runs over a start code.
    #[error("bit {bit}: the plane runs over a start code at bit {code}; it is damaged")]
    Overrun {
        /// Bit offset of the plane.
        bit: u64,
        /// Bit offset of the start code.
        code: u64,
    },
    /// The transport lost data here ([`Decoder::lose`](super::Decoder::lose)).
    #[error("bit {bit}: data were lost here")]
    Lost {
        /// Bits before the loss.
        bit: u64,
    },
    /// Values that are legal, but that whoever knows what they move does not believe
    /// ([`Decoder::distrust`](super::Decoder::distrust)).
    #[error("bit {bit}: a pose that no hand takes, or a leap of the wrist; the plane is damaged")]
    Implausible {
        /// Bit offset of the plane.
        bit: u64,
    },
    /// More skipped frames than [`DecoderLimits`](super::DecoderLimits) allow.
    #[error("bit {bit}: more than {limit} frames skipped at once")]
    SkipLimit {
        /// Bit offset of the plane.
        bit: u64,
        /// The limit.
        limit: u32,
    },
    /// Accumulated differences leave the 32-bit range.
    #[error("bit {bit}: value of bap {bap} leaves the 32-bit range")]
    Overflow {
        /// Bit offset of the plane.
        bit: u64,
        /// The BAP.
        bap: u16,
    },
    /// More data pushed than [`DecoderLimits`](super::DecoderLimits) allow to be held.
    #[error("{held} bytes wait to be decoded, at most {limit} are allowed")]
    BufferLimit {
        /// Bytes that would be held.
        held: usize,
        /// The limit.
        limit: usize,
    },
    /// A field is given a value that its width cannot hold (writing only).
    #[error("{name} is {value}, but the field has {width} bits")]
    FieldOverflow {
        /// Name of the field.
        name: &'static str,
        /// Value asked for.
        value: u32,
        /// Width of the field.
        width: u32,
    },
    /// A level outside the range in force (writing only).
    #[error("level {level} is outside the range {min}..={max}")]
    Level {
        /// The level.
        level: i32,
        /// Smallest codable level.
        min: i32,
        /// Largest codable level.
        max: i32,
    },
}

impl SyntaxError {
    /// What a caller can do about it.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::UnexpectedEnd { .. } => ErrorKind::Incomplete,
            Self::NoObject { .. }
            | Self::UnexpectedStartCode { .. }
            | Self::Marker { .. }
            | Self::MaskType { .. }
            | Self::NoIntra { .. }
            | Self::Stuffing { .. }
            | Self::Flush { .. }
            | Self::Overrun { .. }
            | Self::Lost { .. }
            | Self::Implausible { .. }
            | Self::Overflow { .. } => ErrorKind::Damaged,
            Self::SkipLimit { .. } | Self::BufferLimit { .. } => ErrorKind::Limit,
            Self::Unsupported { .. } => ErrorKind::Unsupported,
            Self::FieldOverflow { .. } | Self::Level { .. } => ErrorKind::Request,
        }
    }
}

/// Why a frame could not be encoded or an encoder not be set up.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// A parameter is outside its field's range.
    #[error("{what} is {value}, allowed is {allowed}")]
    Parameter {
        /// The parameter.
        what: &'static str,
        /// The value given.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A time that a frame cannot have.
    #[error("the time of frame {frame} is {time} s, allowed are {allowed}")]
    Time {
        /// Number of the frame, from 0, among those given.
        frame: u64,
        /// Seconds.
        time: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A value that no I plane can carry at this quantiser index, or a change that no P plane can.
    #[error(
        "{}bap {bap} {} {value}{} cannot be coded: {} value reaches {min} to {max}, {}",
        frame.map_or_else(String::new, |frame| format!("frame {frame}: ")),
        if *kind == PlaneKind::Intra { "at" } else { "changing by" },
        in_degrees(*bap, *value),
        if *kind == PlaneKind::Intra { "an i" } else { "a p" },
        if *further { "at a higher quantiser index further" } else { "and at no quantiser index further" },
    )]
    OutOfRange {
        /// The BAP.
        bap: Bap,
        /// The value, or the change, in the BAP's unit.
        value: i32,
        /// Smallest codable value.
        min: i64,
        /// Largest codable value.
        max: i64,
        /// Whether it is a value or a change.
        kind: PlaneKind,
        /// Whether a higher quantiser index reaches further.
        further: bool,
        /// Number of the frame, from 0, where it is known.
        frame: Option<u64>,
    },
    /// The number of levels handed over does not match the mask.
    #[error("{given} levels given for {expected} baps")]
    LevelCount {
        /// Number given.
        given: usize,
        /// Number of BAPs switched on.
        expected: usize,
    },
    /// The bits of a plane would look like a start code, which a decoder could take for one.
    #[error("the plane at bit {bit} would contain the bits of a start code")]
    Imitation {
        /// First bit of the plane.
        bit: u64,
    },
    /// A P plane was asked for before the first I plane.
    #[error("the first plane must be an i plane")]
    NoIntra,
    /// The syntax does not allow what was asked.
    #[error(transparent)]
    Syntax(#[from] SyntaxError),
}

impl EncodeError {
    /// The same error, of the frame of this number unless it has one.
    pub(crate) fn at(mut self, number: usize) -> Self {
        if let Self::OutOfRange { frame, .. } = &mut self {
            frame.get_or_insert(number as u64);
        }
        self
    }

    /// What a caller can do about it.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Syntax(error) => error.kind(),
            Self::Parameter { .. }
            | Self::Time { .. }
            | Self::OutOfRange { .. }
            | Self::LevelCount { .. }
            | Self::Imitation { .. }
            | Self::NoIntra => ErrorKind::Request,
        }
    }
}

/// The value of an angle in words.
fn in_degrees(bap: Bap, value: i32) -> String {
    let angle = bap.unit() == Unit::Angle;
    if angle { format!(" ({:.1}°)", f64::from(value) * degrees_per_unit(bap)) } else { String::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Decoder, DecoderOptions, example_stream};

    fn first_error(bytes: &[u8], options: DecoderOptions) -> Option<ErrorKind> {
        let mut decoder = Decoder::new(options);
        let mut all = || {
            decoder.push(bytes)?;
            decoder.finish();
            while decoder.next_frame()?.is_some() {}
            Ok(())
        };
        all().err().map(|error: SyntaxError| error.kind())
    }

    #[test]
    fn kinds_say_what_helps() {
        let stream = example_stream();
        let options = DecoderOptions::default();
        assert_eq!(first_error(stream, options), None);
        assert_eq!(first_error(&stream[..40], options), Some(ErrorKind::Incomplete));
        assert_eq!(first_error(&stream[1..], options), Some(ErrorKind::Damaged));
        let mut narrow = options;
        narrow.limits.buffered_bytes = 10;
        assert_eq!(first_error(stream, narrow), Some(ErrorKind::Limit));
        let level = SyntaxError::Level { level: 9, min: -1, max: 1 };
        assert_eq!(EncodeError::from(level).kind(), ErrorKind::Request);
        assert_eq!(EncodeError::NoIntra.kind(), ErrorKind::Request);
    }
}
