//! The adaptive arithmetic coder of the predictive mode (`spec/fba-bitstream.md` section 1.8).
//!
//! Frequencies are cumulative from the end: `C(k)` counts symbols `k` to `N − 1`, so symbol 0 sits at
//! the top of the coding interval and `C(N) = 0`.

use super::bits::{BitReader, BitSink, Element, Trace};
use super::error::SyntaxError;

const QUARTER: u32 = 16384;
const HALF: u32 = 32768;
const THREE_QUARTERS: u32 = 49152;
const TOP: u32 = 65535;
/// At this total all counts of a model are halved before the next one is added.
const TOTAL_LIMIT: u16 = 16383;
/// After so many zero bits a `1` is stuffed, so that the data cannot imitate a start code.
const ZERO_RUN: u32 = 22;
/// Entries passed over at a time when a symbol is searched.
const SCAN: usize = 16;
/// Bits the decoder has consumed beyond those the encoder wrote, at the end of a coded part.
const READ_AHEAD: u64 = 14;

/// Symbol frequencies in cumulative form.
pub trait Model {
    /// Number of symbols.
    fn symbols(&self) -> usize;
    /// Sum of all counts, `C(0)`.
    fn total(&self) -> u32;
    /// `(C(k + 1), C(k))` for symbol `k < symbols()`.
    fn bounds(&self, symbol: usize) -> (u32, u32);
    /// The symbol `k` with `C(k + 1) <= cumulative < C(k)`, for `cumulative < total()`.
    fn find(&self, cumulative: u32) -> usize;
}

/// Every symbol counted once: what an I value is coded with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flat(pub u32);

impl Model for Flat {
    fn symbols(&self) -> usize {
        self.0 as usize
    }

    fn total(&self) -> u32 {
        self.0
    }

    fn bounds(&self, symbol: usize) -> (u32, u32) {
        let above = self.0 - symbol as u32;
        (above - 1, above)
    }

    fn find(&self, cumulative: u32) -> usize {
        (self.0 - 1 - cumulative) as usize
    }
}

/// A view of one adaptive model: `C(0)` to `C(N)`, so one entry more than there are symbols.
#[derive(Clone, Copy, Debug)]
pub struct Adaptive<'a>(&'a [u16]);

impl<'a> Adaptive<'a> {
    /// The model whose cumulative counts are `cumulative` (at least two entries, descending to 0).
    pub fn new(cumulative: &'a [u16]) -> Self {
        debug_assert!(cumulative.len() >= 2 && cumulative.last() == Some(&0));
        Self(cumulative)
    }
}

impl Model for Adaptive<'_> {
    fn symbols(&self) -> usize {
        self.0.len() - 1
    }

    fn total(&self) -> u32 {
        u32::from(self.0[0])
    }

    fn bounds(&self, symbol: usize) -> (u32, u32) {
        (u32::from(self.0[symbol + 1]), u32::from(self.0[symbol]))
    }

    fn find(&self, cumulative: u32) -> usize {
        // Two plain scans: the branches of a binary search are harder to predict. C(N) = 0 stops both.
        let above = |at: usize| self.0.get(at).is_some_and(|&count| u32::from(count) > cumulative);
        let mut symbol = 0;
        while above(symbol + SCAN) {
            symbol += SCAN;
        }
        while above(symbol + 1) {
            symbol += 1;
        }
        symbol
    }
}

/// Sets every count of a cumulative table to one.
pub fn reset(cumulative: &mut [u16]) {
    for (count, left) in cumulative.iter_mut().rev().zip(0..) {
        *count = left;
    }
}

/// Adds one to the count of `symbol`, halving all counts first when the total has reached its limit.
pub fn update(cumulative: &mut [u16], symbol: usize) {
    if cumulative.first() == Some(&TOTAL_LIMIT) {
        halve(cumulative);
    }
    // A plain prefix loop vectorises; `benches/codec.rs` measures it against a Fenwick tree and block sums.
    for count in cumulative.iter_mut().take(symbol + 1) {
        *count += 1;
    }
}

/// Replaces every count `n` by `(n + 1) / 2`.
#[cold]
fn halve(cumulative: &mut [u16]) {
    let mut below = 0;
    let mut sum = 0;
    for count in cumulative.iter_mut().rev().skip(1) {
        let own = *count - below;
        below = *count;
        sum += own.div_ceil(2);
        *count = sum;
    }
}

/// Codes symbols in one direction: an [`Encoder`] writes the symbol it is given, a [`Decoder`]
/// ignores that and returns the one it reads.
pub trait SymbolCoder {
    /// Codes one symbol with `model`; `symbol` must be below `model.symbols()`.
    ///
    /// # Errors
    /// A decoder fails at the end of its data.
    fn symbol<M: Model>(&mut self, model: &M, symbol: usize) -> Result<usize, SyntaxError>;

    /// Tells the trace, if there is one, what the last symbol meant.
    fn note(&mut self, _name: &'static str, _subject: u16, _value: i64) {}

    /// Ends the coded part: flushes, or steps back over the bits read ahead.
    ///
    /// # Errors
    /// A decoder reports data that no encoder writes.
    fn finish(self) -> Result<(), SyntaxError>;
}

/// Writes symbols to a bit sink.
#[derive(Debug)]
pub struct Encoder<'a, S> {
    sink: &'a mut S,
    low: u32,
    high: u32,
    pending: u32,
    zeros: u32,
}

impl<'a, S: BitSink> Encoder<'a, S> {
    /// Starts a coded part.
    pub fn new(sink: &'a mut S) -> Self {
        Self { sink, low: 0, high: TOP, pending: 0, zeros: 0 }
    }

    fn data_bit(&mut self, bit: bool) {
        if self.zeros == ZERO_RUN {
            self.sink.bit(true);
            self.zeros = 0;
        }
        self.sink.bit(bit);
        self.zeros = if bit { 0 } else { self.zeros + 1 };
    }

    fn bit_and_pending(&mut self, bit: bool) {
        self.data_bit(bit);
        for _ in 0..std::mem::take(&mut self.pending) {
            self.data_bit(!bit);
        }
    }
}

impl<S: BitSink> SymbolCoder for Encoder<'_, S> {
    fn symbol<M: Model>(&mut self, model: &M, symbol: usize) -> Result<usize, SyntaxError> {
        let (below, above) = model.bounds(symbol);
        let total = model.total();
        let length = self.high - self.low + 1;
        self.high = self.low + length * above / total - 1;
        self.low += length * below / total;
        loop {
            if self.high < HALF {
                self.bit_and_pending(false);
            } else if self.low >= HALF {
                self.bit_and_pending(true);
                self.low -= HALF;
                self.high -= HALF;
            } else if self.low >= QUARTER && self.high < THREE_QUARTERS {
                self.pending += 1;
                self.low -= QUARTER;
                self.high -= QUARTER;
            } else {
                return Ok(symbol);
            }
            self.low *= 2;
            self.high = self.high * 2 + 1;
        }
    }

    fn finish(mut self) -> Result<(), SyntaxError> {
        self.pending += 1;
        self.bit_and_pending(self.low >= QUARTER);
        Ok(())
    }
}

/// Reads symbols from a bit reader.
#[derive(Debug)]
pub struct Decoder<'a, 'd, T> {
    reader: &'a mut BitReader<'d, T>,
    low: u32,
    high: u32,
    value: u32,
    zeros: u32,
    /// Data bits consumed, stuffed ones not counted.
    consumed: u64,
    /// `consumed` when the last stuffed bit was dropped.
    last_stuffed: Option<u64>,
    /// `consumed` and bit offset at the first zero found in place of a stuffed one.
    violation: Option<(u64, u64)>,
    check_flush: bool,
    /// Bit offset of the first data bit, and shifts reported so far, for the trace.
    start: u64,
    reported: u64,
}

impl<'a, 'd, T> Decoder<'a, 'd, T> {
    /// Starts a coded part; with `check_flush` its end must be as an [`Encoder`] writes it.
    ///
    /// # Errors
    /// [`SyntaxError::UnexpectedEnd`] when there are not 16 data bits.
    pub fn new(reader: &'a mut BitReader<'d, T>, check_flush: bool) -> Result<Self, SyntaxError> {
        let start = reader.stream_position();
        let mut decoder = Self {
            reader,
            low: 0,
            high: TOP,
            value: 0,
            zeros: 0,
            consumed: 0,
            last_stuffed: None,
            violation: None,
            check_flush,
            start,
            reported: 0,
        };
        for _ in 0..16 {
            decoder.value = decoder.value << 1 | decoder.data_bit()?;
        }
        Ok(decoder)
    }

    #[inline]
    fn data_bit(&mut self) -> Result<u32, SyntaxError> {
        if self.zeros == ZERO_RUN {
            let bit = self.reader.stream_position();
            if !self.reader.bit()? && self.violation.is_none() {
                self.violation = Some((self.consumed, bit));
            }
            self.last_stuffed = Some(self.consumed);
            self.zeros = 0;
        }
        let bit = self.reader.bit()?;
        self.zeros = if bit { 0 } else { self.zeros + 1 };
        self.consumed += 1;
        Ok(u32::from(bit))
    }
}

impl<T: Trace> SymbolCoder for Decoder<'_, '_, T> {
    fn symbol<M: Model>(&mut self, model: &M, _symbol: usize) -> Result<usize, SyntaxError> {
        let total = model.total();
        let length = self.high - self.low + 1;
        let cumulative = ((self.value - self.low + 1) * total - 1) / length;
        let symbol = model.find(cumulative);
        let (below, above) = model.bounds(symbol);
        self.high = self.low + length * above / total - 1;
        self.low += length * below / total;
        loop {
            let subtract = if self.high < HALF {
                0
            } else if self.low >= HALF {
                HALF
            } else if self.low >= QUARTER && self.high < THREE_QUARTERS {
                QUARTER
            } else {
                return Ok(symbol);
            };
            self.low = (self.low - subtract) * 2;
            self.high = (self.high - subtract) * 2 + 1;
            self.value = (self.value - subtract) * 2 + self.data_bit()?;
        }
    }

    fn note(&mut self, name: &'static str, subject: u16, value: i64) {
        let shifts = self.consumed - 16;
        self.reader.trace.element(Element {
            bit: self.start + self.reported,
            width: (shifts - self.reported) as u32,
            name,
            subject: Some(subject),
            value,
        });
        self.reported = shifts;
    }

    /// Sets the reader to just behind the last bit the encoder wrote. The bits read ahead belong to
    /// what follows: what looks like a stuffing violation among them is none.
    fn finish(self) -> Result<(), SyntaxError> {
        let written = self.consumed - READ_AHEAD;
        let stuffed_ahead = self.last_stuffed.is_some_and(|at| at >= written);
        let end = self.reader.position() - READ_AHEAD - u64::from(stuffed_ahead);
        self.reader.set_position(end);
        if let Some((at, bit)) = self.violation
            && at < written
        {
            return Err(SyntaxError::Stuffing { bit });
        }
        let flush = if self.low < QUARTER { 0b01 } else { 0b10 };
        if self.check_flush && self.value >> 14 != flush {
            return Err(SyntaxError::Flush { bit: self.reader.stream_position() });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fba::bits::{BitCounter, BitWriter};
    use proptest::prelude::*;

    /// The same model with plain counts.
    struct Counts(Vec<u32>);

    impl Counts {
        fn update(&mut self, symbol: usize) {
            if self.0.iter().sum::<u32>() == 16383 {
                self.0.iter_mut().for_each(|count| *count = count.div_ceil(2));
            }
            self.0[symbol] += 1;
        }

        fn cumulative(&self) -> Vec<u16> {
            (0..=self.0.len()).map(|k| self.0[k..].iter().sum::<u32>() as u16).collect()
        }
    }

    fn fresh(symbols: usize) -> Vec<u16> {
        let mut table = vec![0; symbols + 1];
        reset(&mut table);
        table
    }

    #[test]
    fn tables_follow_plain_counts_through_halvings() {
        for symbols in [1, 2, 5, 121] {
            let mut table = fresh(symbols);
            let mut counts = Counts(vec![1; symbols]);
            let mut state = 1u32;
            for step in 0..40_000 {
                assert_eq!(u32::from(table[0]), counts.0.iter().sum::<u32>());
                if step % 1000 == 0 {
                    assert_eq!(table, counts.cumulative());
                }
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let symbol = (state >> 16) as usize % symbols * usize::from(state >> 30 != 0);
                update(&mut table, symbol);
                counts.update(symbol);
            }
            assert_eq!(table, counts.cumulative());
        }
    }

    #[test]
    fn find_inverts_bounds() {
        let mut table = fresh(7);
        [3, 3, 3, 0, 6].iter().for_each(|&symbol| update(&mut table, symbol));
        for symbol in 0..7 {
            let model = Adaptive::new(&table);
            let (below, above) = model.bounds(symbol);
            (below..above).for_each(|cumulative| assert_eq!(model.find(cumulative), symbol));
            let (below, above) = Flat(7).bounds(symbol);
            (below..above).for_each(|cumulative| assert_eq!(Flat(7).find(cumulative), symbol));
        }
    }

    proptest! {
        /// Several parts one behind the other, each followed by a few raw bits, come back exactly,
        /// also with the long runs of zeros that the last symbol of a large model makes.
        #[test]
        fn parts_come_back(
            parts in prop::collection::vec(
                (prop::collection::vec((1usize..200, any::<prop::sample::Index>(), any::<bool>()), 0..60), 0u32..16),
                1..8,
            )
        ) {
            let mut writer = BitWriter::new();
            let mut counter = BitCounter::default();
            for (symbols, tail) in &parts {
                let start = writer.position();
                let counted = counter.bits;
                let mut encoder = Encoder::new(&mut writer);
                let mut counting = Encoder::new(&mut counter);
                for (size, index, extreme) in symbols {
                    let symbol = if *extreme { size - 1 } else { index.index(*size) };
                    encoder.symbol(&Flat(*size as u32), symbol).unwrap();
                    counting.symbol(&Flat(*size as u32), symbol).unwrap();
                }
                encoder.finish().unwrap();
                counting.finish().unwrap();
                prop_assert_eq!(writer.position() - start, counter.bits - counted);
                writer.put(4, *tail);
            }
            writer.put(32, 0);
            let bytes = writer.into_bytes();
            let mut reader = BitReader::new(&bytes);
            for (symbols, tail) in &parts {
                let mut decoder = Decoder::new(&mut reader, true).unwrap();
                for (size, index, extreme) in symbols {
                    let symbol = if *extreme { size - 1 } else { index.index(*size) };
                    prop_assert_eq!(decoder.symbol(&Flat(*size as u32), 0).unwrap(), symbol);
                }
                decoder.finish().unwrap();
                prop_assert_eq!(reader.take(4).unwrap(), *tail);
            }
        }
    }
}
