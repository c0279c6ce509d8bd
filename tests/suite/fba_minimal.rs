//! A second decoder, as small as possible and written from `spec/fba-bitstream.md` alone, against the
//! library's encoder: random masks, ranges, quantisers and values.
//!
//! It shares nothing with the library but the table of BAPs, and knows only streams without face part.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use handcast_fba::bap::{BAP_COUNT, Bap, BapFrame, BapMask, StepTable};
use handcast_fba::syntax::{IntraParams, PlaneHeader};
use handcast_fba::{Decoder, DecoderOptions, PlaneKind, PlaneWriter, SyntaxError};
use proptest::prelude::*;

const SCALES: [i64; 32] = [
    0, 1, 2, 3, 5, 7, 9, 11, 14, 17, 20, 23, 27, 31, 35, 39, 43, 47, 52, 57, 62, 67, 72, 77, 82, 88, 94, 100,
    106, 113, 120, 127,
];

/// Section 1.6, written as ranges.
fn groups() -> Vec<Vec<u16>> {
    let text = "1 2 3|4 6 10 14|5 7 11 15|8 12 16 18 20 22|9 13 17 19 21 23|32 34 36 38 42|33 35 37 39 43|\
        24 26 28 30 40 44 46|25 27 29 31 41 45 47|48-50 60-62 87-89 114-116|54-56 72-74 99-101 108-110 120-122|\
        57-59 66-68 81-83 93-95 105-107 117-119|63-65 69-71 75-77 90-92 102-104 111-113|51-53 78-80 84-86 96-98|\
        125 131 133 137 143 145 149 155 157 161 167 169 171 173 177 179|\
        126 132 134 138 144 146 150 156 158 162 168 170 172 174 178 180|\
        123 127 129 135 139 141 147 151 153 159 163 165 175|124 128 130 136 140 142 148 152 154 160 164 166 176|\
        181-186|187-208|209-230|231-252|253-274|275-296";
    let members = |part: &str| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        first.parse::<u16>().unwrap()..=last.parse().unwrap()
    };
    text.split('|').map(|group| group.split_whitespace().flat_map(members).collect()).collect()
}

/// Why the second decoder goes no further.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stop {
    /// The end code.
    Done,
    /// The data end before.
    Cut,
    /// The rules are broken.
    Damaged,
    /// The rules allow what it does not know.
    Unknown,
}

/// The values of a plane's BAPs, and the frames skipped after it.
type Shown = (BTreeMap<u16, i64>, u32);

struct Minimal<'a> {
    bytes: &'a [u8],
    at: usize,
    groups: &'static [Vec<u16>],
    begun: bool,
    on: Vec<u16>,
    quant: usize,
    ranges: BTreeMap<u16, [i64; 4]>,
    counts: BTreeMap<u16, Vec<u64>>,
    values: BTreeMap<u16, i64>,
}

impl Minimal<'_> {
    fn bit(&self, at: usize) -> Option<u8> {
        Some(self.bytes.get(at / 8)? >> (7 - at % 8) & 1)
    }

    fn u(&mut self, width: usize) -> Result<i64, Stop> {
        (0..width).try_fold(0, |value, _| {
            let bit = self.bit(self.at).ok_or(Stop::Cut)?;
            self.at += 1;
            Ok(value * 2 + i64::from(bit))
        })
    }

    fn marker(&mut self) -> Result<(), Stop> {
        if self.u(1)? == 1 { Ok(()) } else { Err(Stop::Damaged) }
    }

    /// The start code that stands here behind its stuffing, or where the data are aligned without any.
    fn code(&self) -> Option<u8> {
        let boundary = (self.at / 8 + 1) * 8;
        let stuffed = (self.at..boundary).all(|at| self.bit(at) == Some(u8::from(at != self.at)));
        let places = [stuffed.then_some(boundary), self.at.is_multiple_of(8).then_some(self.at)];
        places.into_iter().flatten().find_map(|at| match self.bytes.get(at / 8..at / 8 + 4)? {
            // Reserved ones (ISO/IEC 14496-2, table 6-3) are levels that look like a start code.
            [0, 0, 1, code] if !(0x30..0xb0).contains(code) => Some(*code),
            _ => None,
        })
    }

    /// `None` for a plane that says nothing.
    fn plane(&mut self) -> Result<Option<Shown>, Stop> {
        let intra = self.u(1)? == 1;
        let object_mask = self.u(2)?;
        match object_mask {
            0 => return Ok(None),
            2 => {}
            _ => return Err(Stop::Unknown),
        }
        if intra && self.u(1)? == 1 {
            self.u(13)?;
        }
        if intra && self.u(1)? == 1 {
            self.u(18)?;
        }
        let mut skipped = 0;
        if self.u(1)? == 1 {
            loop {
                let more = self.u(4)? as u32;
                skipped += more;
                if more < 15 {
                    break;
                }
            }
        }
        if intra {
            self.parameters()?;
        } else if !self.begun {
            return Err(Stop::Damaged);
        }
        self.data(intra)?;
        self.begun = true;
        Ok(Some((self.on.iter().map(|bap| (*bap, self.values[bap])).collect(), skipped)))
    }

    fn parameters(&mut self) -> Result<(), Stop> {
        self.quant = self.u(5)? as usize;
        self.on.clear();
        for group in self.groups {
            self.marker()?;
            match self.u(2)? {
                0 => {}
                1 => {
                    for &bap in group {
                        if self.u(1)? == 1 {
                            self.on.push(bap);
                        }
                    }
                }
                3 => self.on.extend(group),
                _ => return Err(Stop::Damaged),
            }
        }
        self.u(1)?;
        if self.u(1)? == 1 {
            return Err(Stop::Unknown);
        }
        let mut flags = [0; 4];
        for flag in &mut flags {
            *flag = self.u(1)?;
        }
        let scale = SCALES[self.quant].max(1);
        for (end, _) in flags.iter().enumerate().filter(|(_, flag)| **flag == 1) {
            for group in self.groups {
                for (position, bap) in group.iter().enumerate() {
                    if position % 4 == 0 {
                        self.marker()?;
                    }
                    if self.on.contains(bap) {
                        let code = self.u(5)?;
                        // What was never sent has defaults, which it does not know.
                        self.ranges.entry(*bap).or_insert([-1; 4])[end] = 60 * code / scale;
                    }
                }
            }
        }
        for bap in &self.on {
            let ranges = self.ranges.get(bap).filter(|ranges| ranges.iter().all(|end| *end >= 0));
            let [_, _, max, min] = ranges.ok_or(Stop::Unknown)?;
            self.counts.insert(*bap, vec![1; (max + min + 1) as usize]);
        }
        Ok(())
    }

    /// All data bits of the rest, unstuffed, with the places behind them, and where a bit that should be stuffed is not
    /// (section 1.8).
    fn data_bits(&self) -> (Vec<(u64, usize)>, Option<usize>) {
        let mut bits = Vec::new();
        let (mut zeros, mut at, mut unstuffed) = (0, self.at, None);
        while bits.len() < 20_000 && at < self.bytes.len() * 8 + 64 {
            if zeros == 22 {
                if self.bit(at) == Some(0) {
                    unstuffed = unstuffed.or(Some(bits.len()));
                }
                at += 1;
                zeros = 0;
            }
            let bit = self.bit(at).unwrap_or(0);
            at += 1;
            zeros = if bit == 1 { 0 } else { zeros + 1 };
            bits.push((u64::from(bit), at));
        }
        (bits, unstuffed)
    }

    fn data(&mut self, intra: bool) -> Result<(), Stop> {
        let (bits, unstuffed) = self.data_bits();
        let mut next = 16;
        let (mut low, mut high) = (0u64, 65535u64);
        let mut value = bits.get(..16).ok_or(Stop::Cut)?.iter().fold(0, |value, bit| value * 2 + bit.0);
        for bap in self.on.clone() {
            let [i_max, i_min, _, p_min] = self.ranges[&bap];
            let flat = vec![1u64; (i_max + i_min + 1) as usize];
            let counts = if intra { &flat } else { &self.counts[&bap] };
            let total: u64 = counts.iter().sum();
            let length = high - low + 1;
            let wanted = ((value - low + 1) * total - 1) / length;
            let mut above = total;
            let mut symbol = 0;
            while above - counts[symbol] > wanted {
                above -= counts[symbol];
                symbol += 1;
            }
            let below = above - counts[symbol];
            high = low + length * above / total - 1;
            low += length * below / total;
            loop {
                let subtract = if high < 32768 {
                    0
                } else if low >= 32768 {
                    32768
                } else if low >= 16384 && high < 49152 {
                    16384
                } else {
                    break;
                };
                low = 2 * (low - subtract);
                high = 2 * (high - subtract) + 1;
                value = 2 * (value - subtract) + bits.get(next).ok_or(Stop::Cut)?.0;
                next += 1;
            }
            let step = match SCALES[self.quant] {
                0 => 1,
                scale => scale * i64::from(Bap::new(bap).unwrap().base_step(StepTable::Standard)),
            };
            let level = symbol as i64 - if intra { i_min } else { p_min };
            let before = if intra { 0 } else { self.values[&bap] };
            self.values.insert(bap, before + level * step);
            if i32::try_from(before + level * step).is_err() {
                return Err(Stop::Damaged);
            }
            if !intra {
                let counts = self.counts.get_mut(&bap).unwrap();
                if counts.iter().sum::<u64>() == 16383 {
                    counts.iter_mut().for_each(|count| *count = count.div_ceil(2));
                }
                counts[symbol] += 1;
            }
        }
        self.at = bits[next - 14 - 1].1;
        if self.at > self.bytes.len() * 8 {
            return Err(Stop::Cut);
        }
        // The flush: a bit that says in which quarter low is, and its opposite.
        let flush = if low < 16384 { 1 } else { 2 };
        let sound = value >> 14 == flush && unstuffed.is_none_or(|unstuffed| unstuffed >= next - 14);
        if sound { Ok(()) } else { Err(Stop::Damaged) }
    }
}

/// What the second decoder makes of a stream, and why it goes no further.
fn minimal(bytes: &[u8]) -> (Vec<Shown>, Stop) {
    static GROUPS: OnceLock<Vec<Vec<u16>>> = OnceLock::new();
    if bytes.get(..4) != Some(&[0, 0, 1, 0xba]) {
        return (Vec::new(), Stop::Unknown);
    }
    let mut decoder = Minimal {
        bytes,
        at: 32,
        groups: GROUPS.get_or_init(groups),
        begun: false,
        on: Vec::new(),
        quant: 0,
        ranges: BTreeMap::new(),
        counts: BTreeMap::new(),
        values: BTreeMap::new(),
    };
    let mut planes = Vec::new();
    loop {
        match decoder.code() {
            Some(0xb1) => return (planes, Stop::Done),
            Some(_) => return (planes, Stop::Unknown),
            None => {}
        }
        match decoder.plane() {
            Ok(shown) => planes.extend(shown),
            Err(stop) => return (planes, stop),
        }
    }
}

/// What the library makes of a stream up to its end or the first fault.
fn library(bytes: &[u8]) -> (Vec<Shown>, Option<SyntaxError>) {
    let mut decoder = Decoder::new(DecoderOptions::default());
    decoder.push(bytes).unwrap();
    decoder.finish();
    let mut frames = Vec::new();
    loop {
        match decoder.next_frame() {
            Ok(Some(frame)) => {
                let values = frame.baps.iter().map(|(bap, value)| (bap.number(), i64::from(value)));
                frames.push((values.collect(), frame.skipped));
            }
            Ok(None) => return (frames, None),
            Err(error) => return (frames, Some(error)),
        }
    }
}

/// One I period: BAPs with their four range codes, quantiser index, and a seed for levels.
type Period = (BTreeMap<u16, [u8; 4]>, u8, Vec<u64>);

fn period() -> impl Strategy<Value = Period> {
    let codes = prop_oneof![prop::array::uniform4(0u8..=2), prop::array::uniform4(0u8..=31)];
    (
        prop_oneof![
            prop::collection::btree_map(1u16..=296, codes.clone(), 0..12),
            prop::collection::btree_map(123u16..=198, codes, 20..60),
        ],
        0u8..32,
        prop::collection::vec(any::<u64>(), 1..20),
    )
}

/// A stream of periods, and what its planes show; `extreme` 0 and 1 take the ends of all ranges.
fn written(periods: &[Period], extreme: u8) -> (Vec<u8>, Vec<Shown>) {
    let mut writer = PlaneWriter::new(StepTable::Standard);
    let mut expected = Vec::new();
    for (baps, quant, seeds) in periods {
        let mut ranges = [[0; BAP_COUNT]; 4];
        let mut mask = BapMask::EMPTY;
        for (&number, codes) in baps {
            let bap = Bap::new(number).unwrap();
            mask.insert(bap);
            for (array, code) in ranges.iter_mut().zip(codes) {
                array[bap.index()] = *code;
            }
        }
        let params = IntraParams { quant: *quant, mask, ranges: ranges.map(Some), ..IntraParams::default() };
        for (number, seed) in seeds.iter().enumerate() {
            let kind = if number == 0 { PlaneKind::Intra } else { PlaneKind::Predicted };
            let mut dice = Dice(*seed);
            let layout = if number == 0 { writer.layout_after(&params) } else { writer.layout() };
            let level = |[min, max]: [i32; 2], dice: &mut Dice| match extreme {
                0 => max,
                1 => min,
                _ => min + dice.below((max - min + 1) as u64) as i32,
            };
            let levels: Vec<i32> =
                layout.slots().iter().map(|slot| level(slot.range(kind), &mut dice)).collect();
            let skipped = (seed % 40) as u32;
            let header = PlaneHeader { object_mask: 2, skipped, ..PlaneHeader::default() };
            if number == 0 {
                writer.write_intra(&header, false, &params, &levels).unwrap();
            } else {
                writer.write_predicted(&header, false, &levels).unwrap();
            }
            let frame = BapFrame::with_values(mask, *writer.values());
            let values = frame.iter().map(|(bap, value)| (bap.number(), i64::from(value)));
            expected.push((values.collect(), skipped));
        }
    }
    (writer.finish(), expected)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn two_decoders_and_the_encoder_agree(periods in prop::collection::vec(period(), 1..4), extreme in 0u8..4) {
        let (stream, expected) = written(&periods, extreme);
        let (frames, error) = library(&stream);
        prop_assert_eq!(error, None);
        prop_assert_eq!(&frames, &expected);
        prop_assert_eq!(minimal(&stream), (expected, Stop::Done));
    }
}

/// A generator of numbers, each the upper half of a state.
struct Dice(u64);

impl Dice {
    fn below(&mut self, count: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % count.max(1)
    }
}

/// A small stream: its cost is what many of them take.
fn small_stream(dice: &mut Dice) -> Vec<u8> {
    let periods: Vec<Period> = (0..1 + dice.below(2))
        .map(|_| {
            let baps = (0..dice.below(10)).map(|_| {
                let widest = if dice.below(2) == 0 { 3 } else { 32 };
                (1 + dice.below(296) as u16, [0; 4].map(|_| dice.below(widest) as u8))
            });
            let baps = baps.collect();
            let quant = dice.below(32) as u8;
            (baps, quant, (0..1 + dice.below(6)).map(|_| dice.below(1 << 31) << 20).collect())
        })
        .collect();
    written(&periods, dice.below(8) as u8).0
}

/// A stream with some bits or bytes changed, left out or put in, or its end cut off.
fn mutated(stream: &[u8], dice: &mut Dice) -> Vec<u8> {
    let mut bytes = stream.to_vec();
    for _ in 0..1 + dice.below(3) {
        let at = dice.below(bytes.len() as u64) as usize;
        match dice.below(8) {
            0 => bytes[at] = dice.below(256) as u8,
            1 => bytes[at] = [0, 0xff, 0x7f, 1][dice.below(4) as usize],
            2 => drop(bytes.remove(at)),
            3 => bytes.insert(at, dice.below(256) as u8),
            4 => bytes.truncate(at.max(1)),
            _ => bytes[at] ^= 1 << dice.below(8),
        }
        if bytes.is_empty() {
            break;
        }
    }
    bytes
}

/// Whether both say the same of a stream: the same planes, and an end where the other has one.
fn agree(bytes: &[u8]) -> Result<&'static str, String> {
    let (frames, error) = library(bytes);
    let (planes, stop) = minimal(bytes);
    let common = frames.len().min(planes.len());
    let told =
        || format!("library {} {error:?}, second {} {stop:?}: {bytes:02x?}", frames.len(), planes.len());
    if frames[..common] != planes[..common] {
        return Err(format!("other planes: {}", told()));
    }
    let same = frames.len() == planes.len();
    match (&error, stop) {
        (_, Stop::Unknown) if planes.len() <= frames.len() => Ok("beyond the second"),
        (None, Stop::Done) if same => Ok("sound"),
        (Some(SyntaxError::UnexpectedEnd { .. }), Stop::Cut) if same => Ok("cut"),
        // The library looks for start codes inside a plane, and for the end of the data, before it believes it.
        (Some(SyntaxError::Overrun { .. }), _) if frames.len() <= planes.len() => Ok("start code inside"),
        (Some(_), Stop::Damaged | Stop::Cut) if same => Ok("damaged"),
        _ => Err(told()),
    }
}

/// Compares so many mutated streams; how often what was found.
fn compared(count: u64, seed: u64) -> BTreeMap<&'static str, u64> {
    let mut dice = Dice(seed);
    let (mut stream, mut found) = (Vec::new(), BTreeMap::new());
    for number in 0..count {
        if number % 20 == 0 {
            stream = small_stream(&mut dice);
        }
        let what = agree(&mutated(&stream, &mut dice));
        *found.entry(what.unwrap_or_else(|what| panic!("stream {number}: {what}"))).or_default() += 1;
    }
    found
}

#[test]
fn two_decoders_agree_on_mutated_streams() {
    let found = compared(20_000, 1);
    println!("{found:?}");
    assert!(["sound", "cut", "damaged"].iter().all(|what| found[what] > 100), "{found:?}");
}

/// As many as `HANDCAST_STREAMS` says, by default 10^6, from the seed `HANDCAST_SEED`, by default 2.
#[test]
#[ignore = "needs minutes"]
fn two_decoders_agree_on_many_mutated_streams() {
    let number = |name, usual| std::env::var(name).map_or(usual, |text| text.parse().unwrap());
    let (count, seed) = (number("HANDCAST_STREAMS", 1_000_000), number("HANDCAST_SEED", 2));
    println!("{count} streams from seed {seed}: {:?}", compared(count, seed));
}
