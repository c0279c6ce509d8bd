//! Damaged files give errors that say what and where; none of them stops the program.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use handcast_net::model::{Activation, NetworkLimits, Operation, Padding, Sliding};
use handcast_net::testing::Writer;
use handcast_net::{Error, Network};

const PLAIN: Sliding =
    Sliding { padding: Padding::Same, stride: [1, 1], dilation: [1, 1], activation: Activation::Relu };

/// A network with every operator.
fn everything() -> Vec<u8> {
    let mut w = Writer::new();
    let x = w.input(&[1, 4, 4, 2]);
    let k = w.halves(&[4, 3, 3, 2], &[0.5; 72]);
    let a = w.operator(
        Operation::Conv(Sliding { stride: [2, 2], ..PLAIN }),
        &[Some(x), Some(k), None],
        &[1, 2, 2, 4],
    );
    let slopes = w.floats(&[1, 1, 4], &[0.25; 4]);
    let a = w.operator(Operation::Prelu, &[Some(a), Some(slopes)], &[1, 2, 2, 4]);
    let taps = w.halves(&[1, 3, 3, 4], &[0.5; 36]);
    let b = w.operator(Operation::DepthwiseConv(PLAIN), &[Some(a), Some(taps), None], &[1, 2, 2, 4]);
    let k = w.floats(&[4, 1, 1, 4], &[0.5; 16]);
    let b = w.operator(Operation::Conv(PLAIN), &[Some(b), Some(k), None], &[1, 2, 2, 4]);
    let b = w.operator(Operation::Add(Activation::None), &[Some(a), Some(b)], &[1, 2, 2, 4]);
    let c = w.operator(Operation::MaxPool(PLAIN, [2, 2]), &[Some(b)], &[1, 2, 2, 4]);
    let amounts = w.integers(&[4, 2], &[0, 0, 1, 0, 0, 1, 0, 2]);
    let c = w.operator(Operation::Pad, &[Some(c), Some(amounts)], &[1, 3, 3, 6]);
    let size = w.integers(&[2], &[5, 5]);
    let d = w.operator(Operation::ResizeBilinear, &[Some(c), Some(size)], &[1, 5, 5, 6]);
    let axes = w.integers(&[2], &[1, 2]);
    let e = w.operator(Operation::Mean, &[Some(d), Some(axes)], &[1, 6]);
    let k = w.halves(&[3, 6], &[0.5; 18]);
    let e = w.operator(Operation::FullyConnected(Activation::None), &[Some(e), Some(k), None], &[1, 3]);
    let f = w.operator(Operation::Logistic, &[Some(e)], &[1, 3]);
    let g = w.operator(Operation::Reshape, &[Some(b)], &[1, 16]);
    let g = w.operator(Operation::Concatenation(1), &[Some(g), Some(e)], &[1, 19]);
    w.output(f);
    w.output(g);
    w.finish()
}

struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % n
    }
}

/// How many files are tried; more with the environment variable `HANDCAST_MUTATIONS`.
fn mutations() -> usize {
    std::env::var("HANDCAST_MUTATIONS").ok().and_then(|text| text.parse().ok()).unwrap_or(100_000)
}

#[test]
fn damaged_files_give_errors_or_run() {
    let whole = everything();
    let limits = NetworkLimits::default()
        .with_elements(1 << 12)
        .with_total_elements(1 << 14)
        .with_multiplications(1 << 20);
    assert!(Network::read_within(&whole, &limits).is_ok());
    let mut random = Random(1);
    let (mut failed, mut ran) = (0, 0);
    for _ in 0..mutations() {
        let mut bytes = whole.clone();
        for _ in 0..1 + random.below(4) {
            let at = random.below(bytes.len());
            match random.below(5) {
                0 => bytes[at] = random.below(256) as u8,
                1 => bytes[at] ^= 1 << random.below(8),
                2 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][random.below(5)],
                3 => {
                    let from = random.below(bytes.len());
                    let count = random.below(16).min(bytes.len() - at.max(from));
                    bytes.copy_within(from..from + count, at);
                }
                _ => bytes.truncate(at.max(8)),
            }
        }
        match Network::read_within(&bytes, &limits) {
            Ok(mut network) => {
                network.run().unwrap();
                ran += 1;
            }
            Err(error) => {
                assert!(!error.to_string().is_empty());
                failed += 1;
            }
        }
    }
    assert!(failed > 100 && ran > 100, "{failed} failed, {ran} ran");
}

#[test]
fn every_shortened_file_gives_an_error() {
    let whole = everything();
    for length in 0..whole.len() {
        // What is missing may be padding behind the last value only.
        if whole[length..].iter().any(|&b| b != 0) {
            assert!(Network::read(&whole[..length]).is_err(), "{length} of {} bytes", whole.len());
        }
    }
}

fn message(w: &Writer) -> String {
    Network::read(&w.finish()).unwrap_err().to_string()
}

#[test]
fn errors_name_the_operator_and_what_is_wrong() {
    let mut w = Writer::new();
    let x = w.input(&[1, 4, 4, 2]);
    let k = w.floats(&[1, 1, 1, 3], &[0.0; 3]);
    let y = w.operator(Operation::Conv(PLAIN), &[Some(x), Some(k), None], &[1, 4, 4, 1]);
    w.output(y);
    assert_eq!(message(&w), "network: operator 0 (CONV_2D): weights for 3 of 2 channels");

    let mut w = Writer::new();
    let x = w.input(&[1, 4]);
    let y = w.operator(Operation::Reshape, &[Some(x)], &[1, 5]);
    w.output(y);
    assert_eq!(message(&w), "network: operator 0 (RESHAPE): makes [1, 5] of [1, 4]");

    let mut w = Writer::new();
    let x = w.input(&[1, 4]);
    let y = w.operator(Operation::Logistic, &[Some(x)], &[1, 4]);
    let z = w.operator(Operation::Add(Activation::None), &[Some(y), Some(y + 2)], &[1, 4]);
    let _ = w.operator(Operation::Logistic, &[Some(z)], &[1, 4]);
    w.output(z);
    assert_eq!(message(&w), "network: operator 1 (ADD): input 1 (tensor 3) is used before it is made");

    let mut w = Writer::new();
    let x = w.input(&[1, 2, 2, 1]);
    let k = w.floats(&[1, 3, 3, 1], &[0.0; 9]);
    let valid = Sliding { padding: Padding::Valid, ..PLAIN };
    let y = w.operator(Operation::Conv(valid), &[Some(x), Some(k), None], &[1, 1, 1, 1]);
    w.output(y);
    assert_eq!(message(&w), "network: operator 0 (CONV_2D): a window of 3 pixels on a picture of 2");
}

#[test]
fn sizes_are_limited_before_memory_is_taken() {
    let mut w = Writer::new();
    let x = w.input(&[1, 60_000, 60_000, 600]);
    w.output(x);
    assert!(matches!(Network::read(&w.finish()), Err(Error::Limit { .. })));

    let mut w = Writer::new();
    let x = w.input(&[1, 200, 200, 64]);
    let k = w.floats(&[64, 5, 5, 64], &vec![0.0; 64 * 64 * 25]);
    let mut y = x;
    for _ in 0..10 {
        y = w.operator(Operation::Conv(PLAIN), &[Some(y), Some(k), None], &[1, 200, 200, 64]);
    }
    w.output(y);
    assert!(matches!(Network::read(&w.finish()), Err(Error::Limit { what: "multiplications", .. })));
}
