//! A second decoder, as small as possible and written from `spec/fba-bitstream.md` alone, against the
//! library's encoder: random masks, ranges, quantisers and values.
//!
//! It shares nothing with the library but the table of BAPs, and knows only streams without face part.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;

use handcast_fba::bap::{BAP_COUNT, Bap, BapFrame, BapMask, StepTable};
use handcast_fba::syntax::{IntraParams, PlaneHeader};
use handcast_fba::{Decoder, DecoderOptions, PlaneKind, PlaneWriter};
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

struct Minimal<'a> {
    bytes: &'a [u8],
    at: usize,
    groups: Vec<Vec<u16>>,
    on: Vec<u16>,
    quant: usize,
    ranges: BTreeMap<u16, [i64; 4]>,
    counts: BTreeMap<u16, Vec<u64>>,
    values: BTreeMap<u16, i64>,
}

impl Minimal<'_> {
    fn u(&mut self, width: usize) -> i64 {
        (0..width).fold(0, |value, _| {
            let bit = self.bytes[self.at / 8] >> (7 - self.at % 8) & 1;
            self.at += 1;
            value * 2 + i64::from(bit)
        })
    }

    /// Whether the end code stands here behind its stuffing.
    fn ended(&self) -> bool {
        let boundary = (self.at / 8 + 1) * 8;
        let bit = |at: usize| self.bytes[at / 8] >> (7 - at % 8) & 1;
        (self.at..boundary).all(|at| bit(at) == u8::from(at != self.at))
            && self.bytes.get(boundary / 8..boundary / 8 + 4) == Some(&[0, 0, 1, 0xb1])
    }

    fn plane(&mut self) -> BTreeMap<u16, i64> {
        let intra = self.u(1) == 1;
        assert_eq!(self.u(2), 2);
        if intra && self.u(1) == 1 {
            self.u(13);
        }
        if intra && self.u(1) == 1 {
            self.u(18);
        }
        if self.u(1) == 1 {
            while self.u(4) == 15 {}
        }
        if intra {
            self.parameters();
        }
        self.data(intra);
        self.on.iter().map(|bap| (*bap, self.values[bap])).collect()
    }

    fn parameters(&mut self) {
        self.quant = self.u(5) as usize;
        self.on.clear();
        for group in self.groups.clone() {
            assert_eq!(self.u(1), 1);
            match self.u(2) {
                0 => {}
                1 => {
                    for bap in group {
                        if self.u(1) == 1 {
                            self.on.push(bap);
                        }
                    }
                }
                3 => self.on.extend(group),
                other => panic!("mask type {other}"),
            }
        }
        self.u(1);
        assert_eq!(self.u(1), 0);
        let flags: Vec<i64> = (0..4).map(|_| self.u(1)).collect();
        let scale = SCALES[self.quant].max(1);
        for (end, _) in flags.iter().enumerate().filter(|(_, flag)| **flag == 1) {
            for group in self.groups.clone() {
                for (position, bap) in group.into_iter().enumerate() {
                    if position % 4 == 0 {
                        assert_eq!(self.u(1), 1);
                    }
                    if self.on.contains(&bap) {
                        let code = self.u(5);
                        self.ranges.entry(bap).or_insert([0; 4])[end] = 60 * code / scale;
                    }
                }
            }
        }
        for bap in &self.on {
            let [_, _, max, min] = self.ranges[bap];
            self.counts.insert(*bap, vec![1; (max + min + 1) as usize]);
        }
    }

    fn data(&mut self, intra: bool) {
        // All data bits of the rest, unstuffed, with their positions; sections 1.8.
        let mut bits = Vec::new();
        let mut zeros = 0;
        let mut at = self.at;
        let raw = |at: usize| self.bytes.get(at / 8).map_or(0, |byte| byte >> (7 - at % 8) & 1);
        while bits.len() < 20_000 && at < self.bytes.len() * 8 + 64 {
            if zeros == 22 {
                at += 1;
                zeros = 0;
            }
            let bit = raw(at);
            at += 1;
            zeros = if bit == 1 { 0 } else { zeros + 1 };
            bits.push((u64::from(bit), at));
        }
        let mut next = 16;
        let (mut low, mut high) = (0u64, 65535u64);
        let mut value = bits[..16].iter().fold(0, |value, bit| value * 2 + bit.0);
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
                value = 2 * (value - subtract) + bits[next].0;
                next += 1;
            }
            let step = match SCALES[self.quant] {
                0 => 1,
                scale => scale * i64::from(Bap::new(bap).unwrap().base_step(StepTable::Standard)),
            };
            let level = symbol as i64 - if intra { i_min } else { p_min };
            let before = if intra { 0 } else { self.values[&bap] };
            self.values.insert(bap, before + level * step);
            if !intra {
                let counts = self.counts.get_mut(&bap).unwrap();
                if counts.iter().sum::<u64>() == 16383 {
                    counts.iter_mut().for_each(|count| *count = count.div_ceil(2));
                }
                counts[symbol] += 1;
            }
        }
        self.at = bits[next - 14 - 1].1;
    }
}

fn minimal(bytes: &[u8]) -> Vec<BTreeMap<u16, i64>> {
    assert_eq!(&bytes[..4], [0, 0, 1, 0xba]);
    let mut decoder = Minimal {
        bytes,
        at: 32,
        groups: groups(),
        on: Vec::new(),
        quant: 0,
        ranges: BTreeMap::new(),
        counts: BTreeMap::new(),
        values: BTreeMap::new(),
    };
    let mut planes = Vec::new();
    while !decoder.ended() {
        planes.push(decoder.plane());
    }
    planes
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn two_decoders_and_the_encoder_agree(periods in prop::collection::vec(period(), 1..4), extreme in 0u8..4) {
        let mut writer = PlaneWriter::new(StepTable::Standard);
        let mut expected = Vec::new();
        for (baps, quant, seeds) in &periods {
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
                let mut state = *seed;
                let layout = if number == 0 { writer.layout_after(&params) } else { writer.layout() };
                let levels: Vec<i32> = layout.slots().iter().map(|slot| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    let [min, max] = slot.range(kind);
                    match extreme {
                        0 => max,
                        1 => min,
                        _ => min + ((state >> 33) % (max - min + 1) as u64) as i32,
                    }
                }).collect();
                let header = PlaneHeader { object_mask: 2, skipped: (seed % 40) as u32, ..PlaneHeader::default() };
                if number == 0 {
                    writer.write_intra(&header, false, &params, &levels).unwrap();
                } else {
                    writer.write_predicted(&header, false, &levels).unwrap();
                }
                let frame = BapFrame::with_values(mask, *writer.values());
                expected.push(frame.iter().map(|(bap, value)| (bap.number(), i64::from(value))).collect::<BTreeMap<_, _>>());
            }
        }
        let stream = writer.finish();
        prop_assert_eq!(&minimal(&stream), &expected);
        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(&stream).unwrap();
        let mut frames = Vec::new();
        while let Some(frame) = decoder.next_frame().unwrap() {
            let values = frame.baps.iter().map(|(bap, value)| (bap.number(), i64::from(value)));
            frames.push(values.collect::<BTreeMap<_, _>>());
        }
        prop_assert_eq!(frames, expected);
    }
}
