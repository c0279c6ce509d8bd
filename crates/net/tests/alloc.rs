//! A network that is ready allocates nothing when it runs.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::alloc::System;

use handcast_net::Network;
use handcast_net::model::{Activation, Operation, Padding, Sliding};
use handcast_net::testing::Writer;
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

#[test]
fn a_run_allocates_nothing() {
    let mut network = network();
    let region = Region::new(ALLOCATOR);
    for i in 0..10 {
        network.input_mut(0).unwrap().fill(i as f32 * 0.1);
        network.run().unwrap();
    }
    let change = region.change();
    assert_eq!(change.allocations + change.reallocations, 0);
    assert!(network.output(0).unwrap().iter().all(|x| (0.5..=1.0).contains(x)));
}
