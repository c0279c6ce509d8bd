//! Start codes: what begins and ends an object, and where to go on after damage.

use super::super::bits::{BitReader, Element, NoTrace, Trace};
use super::super::error::SyntaxError;
use super::super::record::{MARK, Record};
use super::super::syntax::{
    OBJECT_START, OLD_OBJECT_START, OLD_PLANE_START, PLANE_START, SEQUENCE_END, SEQUENCE_START, USER_DATA,
    VISUAL_OBJECT,
};
use super::{Decoder, Stage};

/// Bits in a start code.
pub(super) const CODE_BITS: u64 = 32;
/// What stands at a position between planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ahead {
    /// A plane, without start code.
    Plane,
    /// A start code, and the bit position behind it.
    Code(u32, u64),
    /// Too little data to tell.
    Unknown,
}

/// Where a record ends.
pub(super) enum RecordEnd {
    /// There is none.
    None,
    /// Too little data to tell.
    Unknown,
    At(usize),
}

impl Decoder {
    /// Reads the object start code, and the visual object sequence around it if there is one. False
    /// when more data are needed.
    pub(super) fn start<T: Trace>(&mut self, trace: &mut T) -> Result<bool, SyntaxError> {
        let Some(code) = self.code_at(self.position) else { return Ok(false) };
        let behind = self.position + CODE_BITS;
        let mut next = behind;
        let mut stage = Stage::Start;
        match code {
            OBJECT_START | OLD_OBJECT_START => {
                stage = Stage::Planes;
                self.objects += 1;
            }
            SEQUENCE_START => next += 8,
            USER_DATA => stage = Stage::UserData,
            VISUAL_OBJECT => {
                let Some(header) = self.visual_object(behind) else { return Ok(false) };
                next = header;
            }
            // The data begin at an I plane, or at the record before it.
            PLANE_START | OLD_PLANE_START if self.objects == 0 => {
                self.damage(self.position);
                return Err(SyntaxError::NoObject { found: code });
            }
            _ if self.position == 0 && self.dropped == 0 => {
                // A start code of another kind of stream; damage would look like it.
                self.foreign = code >> 8 == 1 && !self.options.conceal;
                self.damage(self.position);
                return Err(SyntaxError::NoObject { found: code });
            }
            _ => {
                let bit = self.stream_bit(self.position);
                self.damage(self.position);
                return Err(SyntaxError::UnexpectedStartCode { bit, found: code });
            }
        }
        if self.bit_count() < next {
            return Ok(false);
        }
        self.stage = stage;
        self.note_code(trace, code, behind);
        self.pass_code(next);
        Ok(true)
    }

    /// Position behind the visual object header that begins at `position`, with its stuffing.
    fn visual_object(&self, position: u64) -> Option<u64> {
        let mut reader = BitReader::with_trace(&self.data, position, 0, None, NoTrace);
        let mut header = || {
            if reader.bit()? {
                reader.take(7)?;
            }
            reader.take(4)?;
            Ok::<_, SyntaxError>(reader.position())
        };
        let end = header().ok()?;
        // Stuffing: up to the byte boundary, a whole byte when aligned.
        let behind = (end / 8 + 1) * 8;
        (behind <= self.bit_count()).then_some(behind)
    }

    /// Where the record ends that begins at a byte of `data`, if one does.
    pub(super) fn record_end(&self, from: usize) -> RecordEnd {
        let data = self.data.get(from..).unwrap_or_default();
        let data = &data[..data.len().min(Record::MAX_WRITTEN + 3)];
        let known = data.len().min(MARK.len());
        if data[..known] != MARK[..known] {
            return RecordEnd::None;
        }
        match data.windows(3).position(|window| window == [0, 0, 1]) {
            Some(length) => RecordEnd::At(from + length),
            None if self.finished || data.len() == Record::MAX_WRITTEN + 3 => RecordEnd::None,
            None => RecordEnd::Unknown,
        }
    }

    /// Takes in the record behind the start code of user data passed last.
    pub(super) fn pass_record(&mut self) {
        if let RecordEnd::At(end) = self.record_end(self.floor) {
            self.keep_record(self.floor..end);
            self.pass_code(end as u64 * 8);
        }
    }

    /// Takes in the record in user data, if there is one.
    pub(super) fn keep_record(&mut self, data: std::ops::Range<usize>) {
        if let Some(record) = self.data.get(data).and_then(Record::read) {
            self.record = record;
        }
    }

    /// What stands at `position`: a start code behind proper stuffing (or at a byte boundary), or a plane.
    pub(super) fn look_ahead(&self, position: u64) -> Ahead {
        let count = self.bit_count();
        let bit = |at: u64| self.data.get((at / 8) as usize).map(|byte| byte >> (7 - at % 8) & 1 == 1);
        let matches = |code_start: u64, stuffed: bool| {
            if stuffed {
                for at in position..code_start {
                    match bit(at) {
                        Some(bit) if bit == (at != position) => {}
                        Some(_) => return Ahead::Plane,
                        None => return Ahead::Unknown,
                    }
                }
            }
            // 23 zeros and a one, then the code itself; the first bit that differs settles it.
            for at in code_start..code_start + 24 {
                match bit(at) {
                    Some(bit) if bit == (at == code_start + 23) => {}
                    Some(_) => return Ahead::Plane,
                    None => return Ahead::Unknown,
                }
            }
            if code_start + CODE_BITS > count {
                return Ahead::Unknown;
            }
            match self.code_at(code_start) {
                Some(
                    code @ (OBJECT_START | OLD_OBJECT_START | PLANE_START | OLD_PLANE_START | SEQUENCE_END),
                ) => Ahead::Code(code, code_start + CODE_BITS),
                // Other user data do not occur here, so this is not taken for a plane by chance.
                Some(USER_DATA) => match self.record_end((code_start + CODE_BITS) as usize / 8) {
                    RecordEnd::At(_) => Ahead::Code(USER_DATA, code_start + CODE_BITS),
                    RecordEnd::None => Ahead::Plane,
                    RecordEnd::Unknown => Ahead::Unknown,
                },
                _ => Ahead::Plane,
            }
        };
        let stuffed = matches((position / 8 + 1) * 8, true);
        if stuffed == Ahead::Plane && position.is_multiple_of(8) { matches(position, false) } else { stuffed }
    }

    /// First byte at or behind `floor` where a start code prefix and its code byte stand. What was
    /// searched in vain is not searched again.
    pub(super) fn find_code(&mut self) -> Option<usize> {
        let from = self.floor.max(self.searched);
        let rest = self.data.get(from..).unwrap_or_default();
        let found = rest.windows(4).position(|window| matches!(window, [0, 0, 1, _]));
        self.searched = from + found.unwrap_or(rest.len().saturating_sub(3));
        found.map(|offset| from + offset)
    }

    pub(super) fn code_at(&self, position: u64) -> Option<u32> {
        let at = (position / 8) as usize;
        let bytes = self.data.get(at..at.checked_add(4)?)?;
        Some(bytes.iter().fold(0, |code, &byte| code << 8 | u32::from(byte)))
    }

    pub(super) fn pass_code(&mut self, behind: u64) {
        self.position = behind;
        self.floor = (behind / 8) as usize;
    }

    pub(super) fn note_code<T: Trace>(&self, trace: &mut T, code: u32, behind: u64) {
        let name = match code {
            OBJECT_START | OLD_OBJECT_START => "fba_object_start_code",
            PLANE_START | OLD_PLANE_START => "fba_object_plane_start_code",
            SEQUENCE_END => "visual_object_sequence_end_code",
            SEQUENCE_START => "visual_object_sequence_start_code",
            USER_DATA => "user_data_start_code",
            _ => "visual_object_start_code",
        };
        let bit = self.stream_bit(behind - CODE_BITS);
        trace.element(Element { bit, width: 32, name, subject: None, value: code.into() });
    }
}
