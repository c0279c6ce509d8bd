//! A network that is ready allocates nothing when it runs, nor does a finder after its first pictures.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::alloc::System;

use handcast_net::Network;
use handcast_net::hands::{NetFinder, NetFinderOptions};
use handcast_net::model::{Activation, Operation, Padding, Sliding};
use handcast_net::testing::{Writer, joint_network, palm_network};
use handcast_vision::sighting::HandFinder;
use image::{Rgb, RgbImage};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

fn network() -> Network {
    let plain =
        Sliding { padding: Padding::Same, stride: [1, 1], dilation: [1, 1], activation: Activation::Relu6 };
    let mut w = Writer::new();
    let x = w.input(&[1, 40, 40, 3]);
    let k = w.halves(&[24, 3, 3, 3], &[0.125; 24 * 27]);
    let a = w.operator(Operation::Conv(plain), &[Some(x), Some(k), None], &[1, 40, 40, 24]);
    let k = w.halves(&[96, 1, 1, 24], &[0.125; 24 * 96]);
    let b = w.operator(Operation::Conv(plain), &[Some(a), Some(k), None], &[1, 40, 40, 96]);
    let k = w.halves(&[1, 5, 5, 96], &[0.125; 25 * 96]);
    let b = w.operator(Operation::DepthwiseConv(plain), &[Some(b), Some(k), None], &[1, 40, 40, 96]);
    let k = w.halves(&[24, 1, 1, 96], &[0.125; 24 * 96]);
    let linear = Sliding { activation: Activation::None, ..plain };
    let b = w.operator(Operation::Conv(linear), &[Some(b), Some(k), None], &[1, 40, 40, 24]);
    let b = w.operator(Operation::Add(Activation::None), &[Some(a), Some(b)], &[1, 40, 40, 24]);
    let size = w.integers(&[2], &[80, 80]);
    let b = w.operator(Operation::ResizeBilinear, &[Some(b), Some(size)], &[1, 80, 80, 24]);
    let axes = w.integers(&[2], &[1, 2]);
    let c = w.operator(Operation::Mean, &[Some(b), Some(axes)], &[1, 24]);
    let c = w.operator(Operation::Logistic, &[Some(c)], &[1, 24]);
    w.output(c);
    Network::read(&w.finish()).unwrap()
}

/// Both in one test: another one beside it would be counted, too.
#[test]
fn runs_and_pictures_allocate_nothing() {
    let mut network = network();
    let runs = least_allocations(|| {
        for i in 0..10 {
            network.input_mut(0).unwrap().fill(i as f32 * 0.1);
            network.run().unwrap();
        }
    });
    assert_eq!(runs, 0);
    assert!(network.output(0).unwrap().iter().all(|x| (0.5..=1.0).contains(x)));

    let [palms, joints] = [palm_network(), joint_network()].map(|net| Network::read(&net).unwrap());
    let mut finder = NetFinder::of(palms, joints, NetFinderOptions::default()).unwrap();
    let pictures = [None, Some(100), Some(104), Some(250)].map(|left| {
        let inside =
            |x: u32, y: u32| left.is_some_and(|l| (l..l + 40).contains(&x)) && (180..220).contains(&y);
        RgbImage::from_fn(384, 384, |x, y| Rgb([if inside(x, y) { 255 } else { 0 }, 0, 0]))
    });
    let mut hands = Vec::new();
    let mut count = 0;
    let mut round = || {
        for picture in &pictures {
            finder.find(picture, 0.0, &mut hands).unwrap();
            count += hands.len();
        }
    };
    round();
    assert_eq!(least_allocations(&mut round), 0);
    assert_eq!(count, 3 * (1 + ROUNDS));
}

const ROUNDS: usize = 4;

/// Allocations of the whole process in the quietest of some rounds: the test harness, on its own thread, allocates now
/// and then, what is measured in every round.
fn least_allocations(mut round: impl FnMut()) -> usize {
    let counts = (0..ROUNDS).map(|_| {
        let region = Region::new(ALLOCATOR);
        round();
        let change = region.change();
        change.allocations + change.reallocations
    });
    counts.min().unwrap()
}
