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
/// Bits the decoder has consumed beyond those the encoder wrote, at the end of a coded part.
const READ_AHEAD: u64 = 14;

/// Symbol frequencies in cumulative form.
pub trait Model {
    /// Sum of all counts, `C(0)`.
    fn total(&self) -> u32;
    /// `(C(k + 1), C(k))` for symbol `k`.
    fn bounds(&self, symbol: usize) -> (u32, u32);
    /// The symbol `k` with `C(k + 1) <= cumulative < C(k)`, for `cumulative < total()`.
    fn find(&self, cumulative: u32) -> Found;
}

/// A symbol `k` found by [`Model::find`], and its bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    /// The symbol.
    pub symbol: usize,
    /// `C(k + 1)`.
    pub below: u32,
    /// `C(k)`.
    pub above: u32,
}

/// Every symbol counted once: what an I value is coded with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flat(pub u32);

impl Model for Flat {
    fn total(&self) -> u32 {
        self.0
    }

    fn bounds(&self, symbol: usize) -> (u32, u32) {
        let above = self.0 - symbol as u32;
        (above - 1, above)
    }

    fn find(&self, cumulative: u32) -> Found {
        Found { symbol: (self.0 - 1 - cumulative) as usize, below: cumulative, above: cumulative + 1 }
    }
}

/// Symbols in a block of a model table.
const BLOCK: usize = 16;

/// A view of one adaptive model: counts with the sums of blocks of them, so that an update touches three
/// numbers and a search few.
///
/// The table of a model with `N` symbols in `B` blocks of 16 is the total, the `B` sums, and the `N`
/// counts. `benches/codec.rs` measures it against cumulative counts, in a plain table and in a Fenwick tree.
#[derive(Clone, Copy, Debug)]
pub struct Adaptive<'a> {
    total: u16,
    sums: &'a [u16],
    counts: &'a [u16],
}

/// Entries of the table of a model with so many symbols.
pub fn table_length(symbols: usize) -> usize {
    1 + symbols.div_ceil(BLOCK) + symbols
}

/// Number of blocks in a table of this length.
fn blocks(length: usize) -> usize {
    length.saturating_sub(1).div_ceil(BLOCK + 1)
}

impl<'a> Adaptive<'a> {
    /// The model with this table, which [`reset`] has filled.
    pub fn new(table: &'a [u16]) -> Self {
        let (total, rest) = table.split_first().unwrap_or((&0, &[]));
        let (sums, counts) = rest.split_at(blocks(table.len()));
        Self { total: *total, sums, counts }
    }

    /// The count of `symbol`.
    pub fn count(&self, symbol: usize) -> u16 {
        self.counts.get(symbol).copied().unwrap_or(0)
    }
}

/// Ones in the first so many places of a block.
static FIRST: [[u16; BLOCK]; BLOCK] = {
    let mut first = [[0; BLOCK]; BLOCK];
    let mut many = 0;
    while many < BLOCK {
        let mut place = 0;
        while place < many {
            first[many][place] = u16::MAX;
            place += 1;
        }
        many += 1;
    }
    first
};

/// Sum of the first `many` counts of a block, which are not all.
#[inline]
fn sum_of_first(counts: &[u16], many: usize) -> u32 {
    match (counts.first_chunk::<BLOCK>(), FIRST.get(many)) {
        // All of them at once: quicker than a loop that ends here or there.
        (Some(block), Some(first)) => {
            block.iter().zip(first).map(|(count, first)| count & first).sum::<u16>().into()
        }
        _ => counts.iter().take(many).map(|&count| u32::from(count)).sum(),
    }
}

impl Model for Adaptive<'_> {
    fn total(&self) -> u32 {
        self.total.into()
    }

    #[inline]
    fn bounds(&self, symbol: usize) -> (u32, u32) {
        let block = symbol / BLOCK;
        let mut above = self.total();
        for &sum in self.sums.get(..block).unwrap_or_default() {
            above = above.wrapping_sub(sum.into());
        }
        above = above
            .wrapping_sub(sum_of_first(self.counts.get(block * BLOCK..).unwrap_or_default(), symbol % BLOCK));
        (above.wrapping_sub(self.count(symbol).into()), above)
    }

    fn find(&self, cumulative: u32) -> Found {
        let mut above = self.total();
        let mut block = 0;
        while let Some(&sum) = self.sums.get(block) {
            let below = above.wrapping_sub(sum.into());
            if below <= cumulative {
                break;
            }
            above = below;
            block += 1;
        }
        let mut symbol = block * BLOCK;
        while let Some(&count) = self.counts.get(symbol) {
            let below = above.wrapping_sub(count.into());
            if below <= cumulative {
                return Found { symbol, below, above };
            }
            above = below;
            symbol += 1;
        }
        // C(N) = 0 ends the search before this.
        Found { symbol: symbol.saturating_sub(1), below: 0, above: 1 }
    }
}

/// Sets every count of the table of a model to one.
pub fn reset(table: &mut [u16]) {
    let blocks = blocks(table.len());
    let Some((total, rest)) = table.split_first_mut() else { return };
    let (sums, counts) = rest.split_at_mut(blocks);
    counts.fill(1);
    *total = counts.len() as u16;
    for (sum, block) in sums.iter_mut().zip(counts.chunks(BLOCK)) {
        *sum = block.len() as u16;
    }
}

/// Adds one to the count of `symbol`, halving all counts first when the total has reached its limit.
pub fn update(table: &mut [u16], symbol: usize) {
    let blocks = blocks(table.len());
    let Some((total, rest)) = table.split_first_mut() else { return };
    let (sums, counts) = rest.split_at_mut(blocks);
    if *total == TOTAL_LIMIT {
        *total = halve(sums, counts);
    }
    if let (Some(sum), Some(count)) = (sums.get_mut(symbol / BLOCK), counts.get_mut(symbol)) {
        *total += 1;
        *sum += 1;
        *count += 1;
    }
}

/// Replaces every count `n` by `(n + 1) / 2`; the result is the new total.
#[cold]
fn halve(sums: &mut [u16], counts: &mut [u16]) -> u16 {
    for (sum, block) in sums.iter_mut().zip(counts.chunks_mut(BLOCK)) {
        block.iter_mut().for_each(|count| *count = count.div_ceil(2));
        *sum = block.iter().sum();
    }
    sums.iter().sum()
}

/// Codes symbols in one direction: an [`Encoder`] writes the symbol it is given, a [`Decoder`]
/// ignores that and returns the one it reads.
pub trait SymbolCoder {
    /// Codes one symbol with `model`; `symbol` must be one the model has.
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

    /// Writes the low `width` bits of `bits` (`width` ≤ 16), highest first.
    #[inline]
    fn data_bits(&mut self, width: u32, bits: u32) {
        if self.zeros + width <= ZERO_RUN {
            self.sink.bits(width, bits);
            self.zeros = if bits == 0 { self.zeros + width } else { bits.trailing_zeros() };
        } else {
            (0..width).rev().for_each(|place| self.data_bit(bits >> place & 1 == 1));
        }
    }

    #[cold]
    fn data_bit(&mut self, bit: bool) {
        if self.zeros == ZERO_RUN {
            self.sink.bit(true);
            self.zeros = 0;
        }
        self.sink.bit(bit);
        self.zeros = if bit { 0 } else { self.zeros + 1 };
    }

    /// Writes bits behind the first of which those that were pending come.
    #[inline]
    fn bits_and_pending(&mut self, width: u32, bits: u32) {
        if self.pending == 0 {
            return self.data_bits(width, bits);
        }
        let first = bits >> (width - 1);
        self.data_bits(1, first);
        for _ in 0..std::mem::take(&mut self.pending) {
            self.data_bits(1, first ^ 1);
        }
        self.data_bits(width - 1, bits & ((1 << (width - 1)) - 1));
    }
}

impl<S: BitSink> SymbolCoder for Encoder<'_, S> {
    fn symbol<M: Model>(&mut self, model: &M, symbol: usize) -> Result<usize, SyntaxError> {
        let (below, above) = model.bounds(symbol);
        let total = model.total();
        let length = self.high - self.low + 1;
        self.high = self.low + length * above / total - 1;
        self.low += length * below / total;
        // The leading bits in which both ends agree are known: doubling shifts them out.
        let known = ((self.low ^ self.high) << 16).leading_zeros().min(16);
        if known > 0 {
            self.bits_and_pending(known, self.low >> (16 - known));
            self.low = self.low << known & TOP;
            self.high = (self.high << known | ((1 << known) - 1)) & TOP;
        }
        // Behind the first bit, those in which the lower end has a 1 and the upper end a 0 are pending: they bring both
        // into the middle half, and doubling about its middle shifts them out.
        let middle = ((self.low & !self.high) << 17).leading_ones();
        self.pending += middle;
        self.low = self.low << middle & (HALF - 1);
        self.high = (self.high << middle | ((1 << middle) - 1)) & (HALF - 1) | HALF;
        Ok(symbol)
    }

    fn finish(mut self) -> Result<(), SyntaxError> {
        self.pending += 1;
        self.bits_and_pending(1, u32::from(self.low >= QUARTER));
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
        let Found { symbol, below, above } = model.find(cumulative);
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
    use crate::bits::{BitCounter, BitWriter};
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

    /// The same coder with a bit at a time.
    struct Plain<'a>(Encoder<'a, BitWriter>);

    impl Plain<'_> {
        fn bit_and_pending(&mut self, bit: bool) {
            self.0.data_bit(bit);
            (0..std::mem::take(&mut self.0.pending)).for_each(|_| self.0.data_bit(!bit));
        }

        fn symbol(&mut self, model: &impl Model, symbol: usize) {
            let (below, above) = model.bounds(symbol);
            let length = self.0.high - self.0.low + 1;
            self.0.high = self.0.low + length * above / model.total() - 1;
            self.0.low += length * below / model.total();
            loop {
                let base = if self.0.high < HALF {
                    self.bit_and_pending(false);
                    0
                } else if self.0.low >= HALF {
                    self.bit_and_pending(true);
                    HALF
                } else if self.0.low >= QUARTER && self.0.high < THREE_QUARTERS {
                    self.0.pending += 1;
                    QUARTER
                } else {
                    return;
                };
                self.0.low = (self.0.low - base) * 2;
                self.0.high = (self.0.high - base) * 2 + 1;
            }
        }
    }

    fn fresh(symbols: usize) -> Vec<u16> {
        let mut table = vec![0; table_length(symbols)];
        reset(&mut table);
        table
    }

    /// `C(0)` to `C(N)` as a table has them.
    fn cumulative(table: &[u16], symbols: usize) -> Vec<u16> {
        let model = Adaptive::new(table);
        (0..symbols).map(|symbol| model.bounds(symbol).1 as u16).chain([0]).collect()
    }

    #[test]
    fn tables_follow_plain_counts_through_halvings() {
        for symbols in [1, 2, 5, 15, 16, 17, 121, 3721] {
            let mut table = fresh(symbols);
            let mut counts = Counts(vec![1; symbols]);
            let mut state = 1u32;
            for step in 0..40_000 {
                if step % 1000 == 0 {
                    assert_eq!(cumulative(&table, symbols), counts.cumulative());
                }
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let symbol = (state >> 16) as usize % symbols * usize::from(state >> 30 != 0);
                update(&mut table, symbol);
                counts.update(symbol);
            }
            assert_eq!(cumulative(&table, symbols), counts.cumulative());
        }
    }

    #[test]
    fn find_inverts_bounds() {
        fn check(model: &impl Model, symbols: usize) {
            let mut end = 0;
            for symbol in (0..symbols).rev() {
                let (below, above) = model.bounds(symbol);
                assert_eq!(below, end);
                (below..above).for_each(|cumulative| {
                    assert_eq!(model.find(cumulative), Found { symbol, below, above });
                });
                end = above;
            }
            assert_eq!(model.total(), end);
        }
        for symbols in [1, 7, 16, 33, 121] {
            let mut table = fresh(symbols);
            [3, 3, 3, 0, 6, 32, 99].iter().for_each(|&symbol: &usize| update(&mut table, symbol % symbols));
            check(&Adaptive::new(&table), symbols);
            check(&Flat(symbols as u32), symbols);
        }
    }

    proptest! {
        #[test]
        fn bits_are_those_that_come_one_by_one(
            symbols in prop::collection::vec((1usize..9000, any::<prop::sample::Index>(), 0u8..3), 0..300),
        ) {
            let mut sinks = [BitWriter::new(), BitWriter::new()];
            let [quick, plain] = &mut sinks;
            let mut quick = Encoder::new(quick);
            let mut plain = Plain(Encoder::new(plain));
            for (size, index, place) in symbols {
                // Those in the middle make bits that are pending, the last ones zeros.
                let symbol = [index.index(size), size / 2, size - 1][usize::from(place)];
                quick.symbol(&Flat(size as u32), symbol).unwrap();
                plain.symbol(&Flat(size as u32), symbol);
                prop_assert_eq!(
                    (quick.low, quick.high, quick.pending, quick.zeros),
                    (plain.0.low, plain.0.high, plain.0.pending, plain.0.zeros)
                );
            }
            let [quick, plain] = sinks;
            prop_assert_eq!(quick.position(), plain.position());
            prop_assert_eq!(quick.into_bytes(), plain.into_bytes());
        }

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
