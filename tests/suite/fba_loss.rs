//! Damaged streams with resynchronisation points: no panic, and every I period that was not hit comes
//! out exact.

use handcast_fba::bap::{Bap, BapFrame};
use handcast_fba::bits::{BitReader, BitWriter};
use handcast_fba::inspect::Inspector;
use handcast_fba::{DecodedFrame, Decoder, DecoderOptions, Encoder, EncoderConfig, PlaneKind};

const SEEDS: u64 = 1000;
const FRAMES: u32 = 120;
const PERIOD: u32 = 20;

/// A small generator (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn chance(&mut self, one_in: f64) -> bool {
        (self.next() >> 11) as f64 / ((1u64 << 53) as f64) < 1.0 / one_in
    }
}

fn stream(seed: u64) -> Vec<u8> {
    let mut random = Random(seed);
    let config = EncoderConfig { resync: true, intra_interval: PERIOD, quant: 8, ..EncoderConfig::default() };
    let mut encoder = Encoder::new(config).unwrap();
    let baps: Vec<Bap> = (0..12).map(|i| Bap::new(124 + 2 * i * 2 + (seed % 2) as u16).unwrap()).collect();
    let mut values = vec![0i32; baps.len()];
    for _ in 0..FRAMES {
        for value in &mut values {
            *value = (*value + (random.next() % 6001) as i32 - 3000).clamp(-60_000, 60_000);
        }
        let frame: BapFrame = baps.iter().copied().zip(values.iter().copied()).collect();
        encoder.write_frame(&frame).unwrap();
    }
    encoder.finish()
}

/// All frames that come out, errors passed over.
fn survive(bytes: &[u8], chunk: usize) -> Vec<DecodedFrame> {
    let mut decoder = Decoder::new(DecoderOptions::default());
    let mut frames = Vec::new();
    let mut drain = |decoder: &mut Decoder| {
        loop {
            match decoder.next_frame() {
                Ok(Some(frame)) => frames.push(frame),
                Ok(None) => break,
                Err(_) => {}
            }
        }
    };
    for piece in bytes.chunks(chunk) {
        decoder.push(piece).unwrap();
        drain(&mut decoder);
    }
    decoder.finish();
    drain(&mut decoder);
    assert!(decoder.is_ended());
    frames
}

/// Bits of the planes of each I period, start code included: first bit of the I plane's start code, one
/// past its last plane, and what decodes from it.
fn periods(bytes: &[u8]) -> Vec<(u64, u64, Vec<DecodedFrame>)> {
    let mut periods: Vec<(u64, u64, Vec<DecodedFrame>)> = Vec::new();
    for plane in Inspector::new(bytes, DecoderOptions::default()) {
        let plane = plane.unwrap();
        if plane.frame.kind == PlaneKind::Intra {
            let start = plane.elements[0].bit;
            periods.push((start, plane.frame.end_bit, Vec::new()));
        }
        let last = periods.last_mut().unwrap();
        last.1 = plane.frame.end_bit;
        last.2.push(plane.frame);
    }
    periods
}

/// Whether the values of `period` come out one after the other.
fn contains(frames: &[DecodedFrame], period: &[DecodedFrame]) -> bool {
    let same = |(a, b): (&DecodedFrame, &DecodedFrame)| a.kind == b.kind && a.baps == b.baps;
    frames.windows(period.len()).any(|window| window.iter().zip(period).all(same))
}

/// A stream of `periods` without the planes that `kept` leaves out.
fn without(bytes: &[u8], periods: &[(u64, u64, Vec<DecodedFrame>)], kept: &[Vec<bool>]) -> Vec<u8> {
    let mut writer = BitWriter::new();
    writer.put(32, 0x1ba);
    for (number, ((_, _, planes), kept)) in periods.iter().zip(kept).enumerate() {
        for (plane, _) in planes.iter().zip(kept).filter(|(_, kept)| **kept) {
            if plane.kind == PlaneKind::Intra && number > 0 {
                writer.start_code(0x1bb);
            }
            let mut reader = BitReader::new(bytes);
            reader.set_position(plane.first_bit);
            for _ in plane.first_bit..plane.end_bit {
                writer.put(1, reader.take(1).unwrap());
            }
        }
    }
    writer.start_code(0x1b1);
    writer.into_bytes()
}

#[test]
fn dropped_planes() {
    for seed in 0..SEEDS {
        let bytes = stream(seed);
        let periods = periods(&bytes);
        for (number, one_in) in [100.0, 20.0, 5.0].into_iter().enumerate() {
            let mut random = Random(seed * 3 + number as u64);
            let kept: Vec<Vec<bool>> = periods
                .iter()
                .map(|(_, _, planes)| planes.iter().map(|_| !random.chance(one_in)).collect())
                .collect();
            let frames = survive(&without(&bytes, &periods, &kept), 64);
            for ((_, _, planes), kept) in periods.iter().zip(&kept) {
                if kept.iter().all(|&kept| kept) {
                    assert!(
                        contains(&frames, planes),
                        "seed {seed}, 1 in {one_in}: a whole period is missing"
                    );
                }
            }
        }
    }
}

/// Seconds of a processor that this thread has had, where the system tells: what else runs does not count.
fn busy() -> f64 {
    static BEGIN: std::sync::LazyLock<std::time::Instant> = std::sync::LazyLock::new(std::time::Instant::now);
    // What it has had since the last tick of the clock is counted now.
    std::thread::yield_now();
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|told| told.split(' ').next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| BEGIN.elapsed().as_secs_f64(), |spent| 1e-9 * spent)
}

/// Decoding time grows no faster than the input, however damaged: sixteen times the bytes take about sixteen times
/// as long. Were only a fifteenth of the time of the short stream quadratic, the time per byte would double.
#[test]
fn time_is_linear() {
    let damaged = |copies: usize| {
        let mut random = Random(5);
        let mut bytes: Vec<u8> = (0..copies as u64).flat_map(|copy| stream(copy % 4)).collect();
        // No end codes, which would end it; damage everywhere; and long stretches that promise a start code.
        for at in 0..bytes.len() {
            if random.chance(40.0) {
                bytes[at] = [0, 0, 1, 0xbb, 0xff][random.next() as usize % 5];
            }
            if bytes[at..].starts_with(&[0, 0, 1, 0xb1]) {
                bytes[at + 3] = 0xbb;
            }
        }
        bytes
    };
    let seconds = |bytes: &[u8]| {
        let start = busy();
        for chunk in [64, 1 << 12, usize::MAX] {
            let mut decoder = Decoder::new(DecoderOptions::default());
            for piece in bytes.chunks(chunk) {
                decoder.push(piece).unwrap();
                while !matches!(decoder.next_frame(), Ok(None)) {}
            }
            decoder.finish();
            while !decoder.is_ended() {
                let _ = decoder.next_frame();
            }
        }
        busy() - start
    };
    let (short, long) = (damaged(50), damaged(800));
    let bytes = long.len() as f64 / short.len() as f64;
    // Whatever else the machine does only makes a measurement longer: the least of each counts, and a busy machine
    // takes more of them.
    let mut least = [f64::INFINITY; 2];
    let mut ratio = f64::INFINITY;
    for round in 0..20 {
        for _ in 0..4 {
            least[0] = least[0].min(seconds(&short));
        }
        least[1] = least[1].min(seconds(&long));
        ratio = least[1] / least[0] / bytes;
        if round > 1 && ratio < 2.0 {
            break;
        }
    }
    assert!(ratio < 2.0, "time per byte grew by a factor of {ratio:.2}");
}

#[test]
fn flipped_bytes() {
    for seed in 0..SEEDS {
        let mut random = Random(seed);
        let mut bytes = stream(seed);
        let periods = periods(&bytes);
        let mut hits = Vec::new();
        for (index, byte) in bytes.iter_mut().enumerate().skip(4) {
            if random.chance(1000.0) {
                *byte ^= (random.next() % 255 + 1) as u8;
                hits.push(index as u64 * 8);
            }
        }
        let frames = survive(&bytes, usize::MAX);
        assert_eq!(frames, survive(&bytes, 7), "seed {seed}: depends on the cut");
        for (number, (start, end, planes)) in periods.iter().enumerate() {
            // The first period has no start code of its own but the object's; the bits read ahead of a
            // plane may lie in the byte behind it, but do not change it.
            let from = if number == 0 { 0 } else { *start };
            if !hits.iter().any(|hit| hit + 8 > from && *hit < *end) {
                assert!(
                    contains(&frames, planes),
                    "seed {seed}: period {number} was not hit, but is missing"
                );
            }
        }
    }
}

#[test]
fn cut_tails() {
    for seed in 0..SEEDS {
        let mut random = Random(seed);
        let bytes = stream(seed % 50);
        let cut = (random.next() % bytes.len() as u64) as usize;
        let whole: Vec<DecodedFrame> = periods(&bytes).into_iter().flat_map(|period| period.2).collect();
        let frames = survive(&bytes[..cut], 16);
        let expected = whole.iter().filter(|plane| plane.end_bit <= cut as u64 * 8).count();
        assert_eq!(frames, whole[..expected], "seed {seed}: cut at byte {cut} of {}", bytes.len());
    }
}

#[test]
fn concealment_holds_the_pose() {
    let mut bytes = stream(3);
    let (start, _, _) = periods(&bytes)[2].clone();
    let at = (start / 8) as usize + 12;
    bytes[at..at + 8].fill(0);
    let mut decoder = Decoder::new(DecoderOptions { conceal: true, ..DecoderOptions::default() });
    decoder.push(&bytes).unwrap();
    let mut held = 0;
    let mut before: Option<DecodedFrame> = None;
    while let Some(frame) = decoder.next_frame().unwrap() {
        if frame.damage.is_some() {
            assert_eq!(frame.baps, before.unwrap().baps);
            held += 1;
        }
        before = Some(frame);
    }
    assert_eq!(held, 1);
    assert!(decoder.is_ended());
}
