//! Throughput of encoder and decoder, and of three ways to keep cumulative counts.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, missing_docs)]

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use handcast_codec::mapping::{Profile, hand_mask};
use handcast_fba::arith::{self, Adaptive, Model};
use handcast_fba::bap::{Bap, BapFrame};
use handcast_fba::{Decoder, DecoderOptions, Encoder, EncoderConfig};
use handcast_hand::Side;

const FRAMES: u32 = 3000;

/// A hand whose fingers move by turns, 29 angles and 6 global values.
fn frames() -> Vec<BapFrame> {
    let mask = hand_mask(Side::Right, Profile::Hand);
    let value = |bap: Bap, number: u32| {
        let phase = f64::from(number) * 0.08 + f64::from(bap.number() / 10);
        let size = if bap.is_extension() { 200.0 } else { 30_000.0 };
        (phase.sin().max(0.0) * size) as i32
    };
    (0..FRAMES).map(|number| mask.iter().map(|bap| (bap, value(bap, number))).collect()).collect()
}

fn encode(frames: &[BapFrame], out: &mut Vec<u8>) {
    let mut encoder = Encoder::new(EncoderConfig::default()).expect("valid configuration");
    out.clear();
    for frame in frames {
        encoder.write_frame(frame).expect("codable");
        encoder.take_bytes(out);
    }
    out.extend(encoder.finish());
}

fn decode(stream: &[u8]) -> u32 {
    let mut decoder = Decoder::new(DecoderOptions::default());
    let mut sum = 0;
    for piece in stream.chunks(4096) {
        decoder.push(piece).expect("room");
        while let Some(frame) = decoder.next_frame().expect("sound") {
            sum += u32::from(frame.quant);
        }
    }
    sum
}

fn codec(c: &mut Criterion) {
    let frames = frames();
    let mut stream = Vec::new();
    encode(&frames, &mut stream);
    let mut group = c.benchmark_group("codec");
    group.measurement_time(Duration::from_secs(3));
    group.throughput(Throughput::Elements(u64::from(FRAMES)));
    group.bench_function("encode", |b| b.iter(|| encode(black_box(&frames), &mut stream)));
    group.bench_function("decode", |b| b.iter(|| decode(black_box(&stream))));
    group.finish();
}

/// Cumulative counts in some form, as the coder uses them: one search and one update per symbol.
trait Counts {
    fn new(symbols: usize) -> Self;
    fn total(&self) -> u32;
    /// Symbol, C(k + 1) and C(k) for a cumulative count.
    fn find(&self, cumulative: u32) -> (usize, u32, u32);
    fn update(&mut self, symbol: usize);
}

/// A plain table of cumulative counts.
struct Linear(Vec<u16>);

impl Counts for Linear {
    fn new(symbols: usize) -> Self {
        Self((0..=symbols as u16).rev().collect())
    }

    fn total(&self) -> u32 {
        self.0[0].into()
    }

    fn find(&self, cumulative: u32) -> (usize, u32, u32) {
        let symbol = self.0.partition_point(|&count| u32::from(count) > cumulative) - 1;
        (symbol, self.0[symbol + 1].into(), self.0[symbol].into())
    }

    fn update(&mut self, symbol: usize) {
        self.0[..=symbol].iter_mut().for_each(|count| *count += 1);
    }
}

/// A Fenwick tree over the counts from the last symbol on.
struct Fenwick {
    tree: Vec<u16>,
    total: u32,
}

impl Fenwick {
    fn add(&mut self, mut at: usize) {
        while at < self.tree.len() {
            self.tree[at] += 1;
            at += at & at.wrapping_neg();
        }
        self.total += 1;
    }
}

impl Counts for Fenwick {
    fn new(symbols: usize) -> Self {
        let mut tree = Self { tree: vec![0; symbols + 1], total: 0 };
        (1..=symbols).for_each(|at| tree.add(at));
        tree
    }

    fn total(&self) -> u32 {
        self.total
    }

    fn find(&self, cumulative: u32) -> (usize, u32, u32) {
        let symbols = self.tree.len() - 1;
        let (mut at, mut below) = (0, 0);
        let mut step = symbols.next_power_of_two();
        while step > 0 {
            if let Some(&count) = self.tree.get(at + step)
                && below + u32::from(count) <= cumulative
            {
                at += step;
                below += u32::from(count);
            }
            step /= 2;
        }
        // Position `at + 1` from the end; its own count is the difference of two prefix sums.
        let mut above = below;
        let (mut from, to) = (at + 1, at);
        let mut own = u32::from(self.tree[from]);
        from -= from & from.wrapping_neg();
        let mut down = to;
        while down > from {
            own -= u32::from(self.tree[down]);
            down -= down & down.wrapping_neg();
        }
        above += own;
        (symbols - 1 - at, below, above)
    }

    fn update(&mut self, symbol: usize) {
        self.add(self.tree.len() - 1 - symbol);
    }
}

/// What the codec uses: counts, and sums of blocks of them.
struct Blocks(Vec<u16>);

impl Counts for Blocks {
    fn new(symbols: usize) -> Self {
        let mut table = vec![0; arith::table_length(symbols)];
        arith::reset(&mut table);
        Self(table)
    }

    fn total(&self) -> u32 {
        Adaptive::new(&self.0).total()
    }

    fn find(&self, cumulative: u32) -> (usize, u32, u32) {
        let found = Adaptive::new(&self.0).find(cumulative);
        (found.symbol, found.below, found.above)
    }

    fn update(&mut self, symbol: usize) {
        arith::update(&mut self.0, symbol);
    }
}

/// So few symbols that no counts need to be halved.
fn run<C: Counts>(symbols: usize) -> u64 {
    let mut counts = C::new(symbols);
    let mut state = 1u32;
    let mut sum = 0u64;
    for _ in 0..2000 {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let (symbol, below, above) = counts.find((state >> 8) % counts.total());
        sum += u64::from(below ^ above);
        counts.update(symbol);
    }
    sum
}

fn models(c: &mut Criterion) {
    let mut group = c.benchmark_group("model");
    group.measurement_time(Duration::from_secs(1)).warm_up_time(Duration::from_millis(500));
    group.throughput(Throughput::Elements(2000));
    for symbols in [7, 31, 121, 481, 3721] {
        assert_eq!(run::<Linear>(symbols), run::<Fenwick>(symbols));
        assert_eq!(run::<Linear>(symbols), run::<Blocks>(symbols));
        group.bench_with_input(BenchmarkId::new("linear", symbols), &symbols, |b, &n| {
            b.iter(|| run::<Linear>(n))
        });
        group.bench_with_input(BenchmarkId::new("fenwick", symbols), &symbols, |b, &n| {
            b.iter(|| run::<Fenwick>(n))
        });
        group.bench_with_input(BenchmarkId::new("blocks", symbols), &symbols, |b, &n| {
            b.iter(|| run::<Blocks>(n))
        });
    }
    group.finish();
}

criterion_group!(benches, codec, models);
criterion_main!(benches);
