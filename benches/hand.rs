//! Forward kinematics and Jacobian of one hand: `cargo bench --bench hand`.

#![allow(missing_docs)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use handcast::hand::{HandPose, Jacobian, Joint, Morphology, Side, Skeleton};

fn hand(c: &mut Criterion) {
    let skeleton = Skeleton::new(&Morphology::default(), Side::Left);
    let mut pose = HandPose::neutral(Side::Left);
    for (i, angle) in pose.angles.iter_mut().enumerate() {
        *angle = 0.3 + 0.02 * i as f64;
    }
    c.bench_function("forward kinematics", |b| b.iter(|| skeleton.frames(black_box(&pose))));
    c.bench_function("kinematics and axes", |b| b.iter(|| Jacobian::new(&skeleton, black_box(&pose))));
    c.bench_function("jacobian of 25 joints", |b| {
        b.iter(|| {
            let jacobian = Jacobian::new(&skeleton, black_box(&pose));
            for joint in Joint::ALL {
                black_box(jacobian.joint(joint));
            }
        });
    });
}

criterion_group!(benches, hand);
criterion_main!(benches);
