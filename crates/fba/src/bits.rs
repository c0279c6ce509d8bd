//! Reading and writing single bits, most significant bit first.

use super::error::SyntaxError;

/// Receives bits: a [`BitWriter`] keeps them, a [`BitCounter`] only counts them.
pub trait BitSink {
    /// Takes the low `width` bits of `bits` (`width` ≤ 32, higher ones are 0), highest first.
    fn bits(&mut self, width: u32, bits: u32);

    /// Takes one bit.
    fn bit(&mut self, bit: bool) {
        self.bits(1, bit.into());
    }
}

/// Counts bits without storing them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BitCounter {
    /// Number of bits received.
    pub bits: u64,
}

impl BitSink for BitCounter {
    fn bits(&mut self, width: u32, _bits: u32) {
        self.bits += u64::from(width);
    }
}

/// Appends bits to a growing byte buffer.
#[derive(Clone, Debug, Default)]
pub struct BitWriter {
    bytes: Vec<u8>,
    /// Bits of the unfinished last byte, in the low `pending` bits.
    partial: u8,
    pending: u32,
    /// Bits handed out by [`BitWriter::take_bytes`] before those in `bytes`.
    taken: u64,
    /// The last four finished bytes.
    last: u32,
    /// Whether data have come out as a start code.
    imitates: bool,
}

/// A state of a [`BitWriter`] to go back to, until bytes are taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Checkpoint {
    length: usize,
    partial: u8,
    pending: u32,
    last: u32,
}

/// The codes that end a plane, or begin one, wherever they stand.
const START_CODES: [u32; 3] = [0x1ba, 0x1bb, 0x1b1];

impl BitWriter {
    /// An empty writer.
    pub fn new() -> Self {
        Self::default()
    }

    /// Appends the low `width` bits of `value` (`width` ≤ 32), highest first.
    pub fn put(&mut self, width: u32, value: u32) {
        let width = width.min(32);
        self.bits(width, (u64::from(value) & ((1 << width) - 1)) as u32);
    }

    /// Writes stuffing and a start code. Those the syntax knows count as imitated when they come about in
    /// any other way.
    pub fn start_code(&mut self, code: u32) {
        self.stuff();
        self.aligned_start_code(code);
    }

    /// The same without stuffing, at a byte boundary.
    pub fn aligned_start_code(&mut self, code: u32) {
        self.put(32, code);
        self.imitates = false;
    }

    /// Whether what was written since the last start code or checkpoint contains a start code by chance.
    pub(crate) fn imitates(&self) -> bool {
        self.imitates
    }

    pub(crate) fn checkpoint(&mut self) -> Checkpoint {
        self.imitates = false;
        Checkpoint { length: self.bytes.len(), partial: self.partial, pending: self.pending, last: self.last }
    }

    /// Takes back what was written since.
    pub(crate) fn roll_back(&mut self, to: &Checkpoint) {
        self.bytes.truncate(to.length);
        (self.partial, self.pending, self.last) = (to.partial, to.pending, to.last);
        self.imitates = false;
    }

    /// Number of bits written so far, counting those already taken.
    pub fn position(&self) -> u64 {
        self.taken + self.bytes.len() as u64 * 8 + u64::from(self.pending)
    }

    /// Writes the stuffing that precedes a start code: a `0`, then `1`s to the byte boundary; a
    /// whole byte 0x7F when already aligned.
    pub fn stuff(&mut self) {
        self.bit(false);
        while self.pending != 0 {
            self.bit(true);
        }
    }

    /// Moves all finished bytes to the end of `out`; an unfinished last byte stays.
    pub fn take_bytes(&mut self, out: &mut Vec<u8>) {
        self.taken += self.bytes.len() as u64 * 8;
        out.append(&mut self.bytes);
    }

    /// The finished bytes not taken yet.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// All bytes not taken yet, the last one filled up with zeros.
    pub fn into_bytes(mut self) -> Vec<u8> {
        while self.pending != 0 {
            self.bit(false);
        }
        self.bytes
    }
}

impl BitSink for BitWriter {
    #[inline]
    fn bits(&mut self, width: u32, bits: u32) {
        let all = u64::from(self.partial) << width | u64::from(bits);
        self.pending += width;
        while self.pending >= 8 {
            self.pending -= 8;
            let byte = (all >> self.pending) as u8;
            self.bytes.push(byte);
            self.last = self.last << 8 | u32::from(byte);
            self.imitates |= START_CODES.contains(&self.last);
        }
        self.partial = (all & ((1 << self.pending) - 1)) as u8;
    }
}

/// One syntax element as read from a stream; what `inspect` lists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Element {
    /// Bit offset in the stream. For an arithmetic-coded value: the first bit whose value it fixed.
    pub bit: u64,
    /// Width in bits. For an arithmetic-coded value: the number of bits it fixed, often 0.
    pub width: u32,
    /// Name of the element in the standard's syntax tables, or our own name where it has none.
    pub name: &'static str,
    /// The BAP, FAP or group the element belongs to, if any.
    pub subject: Option<u16>,
    /// Its value.
    pub value: i64,
}

/// Is told every syntax element that a reader reads.
pub trait Trace {
    /// Called after each element.
    fn element(&mut self, element: Element);
}

/// A [`Trace`] that ignores everything.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoTrace;

impl Trace for NoTrace {
    #[inline(always)]
    fn element(&mut self, _element: Element) {}
}

impl Trace for Vec<Element> {
    fn element(&mut self, element: Element) {
        self.push(element);
    }
}

/// Reads bits from a byte slice.
#[derive(Debug)]
pub struct BitReader<'a, T = NoTrace> {
    data: &'a [u8],
    position: u64,
    /// Bit offset of `data` in the stream, for errors and traces.
    base: u64,
    /// What bits beyond the end read as; without it they are an error.
    padding: Option<bool>,
    pub(crate) trace: T,
}

impl<'a> BitReader<'a> {
    /// A reader at the first bit of `data`.
    pub fn new(data: &'a [u8]) -> Self {
        Self::with_trace(data, 0, 0, None, NoTrace)
    }
}

impl<'a, T> BitReader<'a, T> {
    pub(crate) fn with_trace(
        data: &'a [u8],
        position: u64,
        base: u64,
        padding: Option<bool>,
        trace: T,
    ) -> Self {
        Self { data, position, base, padding, trace }
    }

    /// Bits read so far, or the position last set, within the slice.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Position in the stream: the offset of the slice plus the position in it.
    pub fn stream_position(&self) -> u64 {
        self.base + self.position
    }

    /// Moves to `position` bits from the start of the slice.
    pub fn set_position(&mut self, position: u64) {
        self.position = position;
    }

    /// Reads one bit.
    ///
    /// # Errors
    /// [`SyntaxError::UnexpectedEnd`] at the end of the slice.
    #[inline]
    pub fn bit(&mut self) -> Result<bool, SyntaxError> {
        let bit = match self.data.get((self.position >> 3) as usize) {
            Some(byte) => byte >> (7 - (self.position & 7)) & 1 == 1,
            None => self.padding.ok_or(SyntaxError::UnexpectedEnd { bit: self.stream_position() })?,
        };
        self.position += 1;
        Ok(bit)
    }

    /// Reads `width` bits (≤ 32), highest first.
    ///
    /// # Errors
    /// [`SyntaxError::UnexpectedEnd`] when fewer are left.
    pub fn take(&mut self, width: u32) -> Result<u32, SyntaxError> {
        let mut value = 0;
        for _ in 0..width {
            value = value << 1 | u32::from(self.bit()?);
        }
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_put_is_taken(fields in prop::collection::vec((0u32..=32, any::<u32>()), 0..50)) {
            let mut writer = BitWriter::new();
            let mut taken = Vec::new();
            for (index, &(width, value)) in fields.iter().enumerate() {
                writer.put(width, value);
                if index % 7 == 3 {
                    writer.take_bytes(&mut taken);
                }
            }
            let bits = writer.position();
            prop_assert_eq!(bits, fields.iter().map(|field| u64::from(field.0)).sum::<u64>());
            taken.extend(writer.into_bytes());
            let mut reader = BitReader::new(&taken);
            for &(width, value) in &fields {
                let expected = if width == 0 { 0 } else { value << (32 - width) >> (32 - width) };
                prop_assert_eq!(reader.take(width).unwrap(), expected);
            }
            prop_assert_eq!(reader.position(), bits);
        }
    }

    #[test]
    fn stuffing_is_a_zero_then_ones() {
        let mut writer = BitWriter::new();
        writer.stuff();
        writer.put(3, 0b101);
        writer.stuff();
        writer.put(7, 0);
        writer.stuff();
        assert_eq!(writer.into_bytes(), [0x7f, 0b1010_1111, 0]);
    }

    #[test]
    fn the_end_is_an_error_that_says_where() {
        let mut reader = BitReader::new(&[0xff]);
        assert_eq!(reader.take(8), Ok(0xff));
        assert_eq!(reader.take(1), Err(SyntaxError::UnexpectedEnd { bit: 8 }));
    }
}
