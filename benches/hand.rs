//! Forward kinematics, Jacobian, constraints and landmark solver of one hand: `cargo bench --bench hand`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, missing_docs)]

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use handcast_hand::landmarks::{JointPoints, LANDMARKS_21, PoseSolver, SolverOptions};
use handcast_hand::{Domain, Finger, HandPose, Jacobian, Joint, Morphology, Side, Skeleton};
use nalgebra::{UnitQuaternion, Vector3};

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

/// A hand that opens, closes and turns, its joints seen with up to 2 mm of error.
fn recording(frames: usize) -> Vec<JointPoints> {
    let skeleton = Skeleton::new(&Morphology::default(), Side::Right);
    let mut seed = 1u64;
    let mut noise = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5) * 0.004
    };
    (0..frames)
        .map(|i| {
            let s = 0.5 - 0.5 * (0.05 * i as f64).cos();
            let mut pose = HandPose::neutral(Side::Right);
            pose.rotation = UnitQuaternion::from_euler_angles(s, 2.0 * s, -s);
            for (f, finger) in Finger::ALL.into_iter().enumerate() {
                pose.set(finger.base_flexion(), s);
                pose.set(finger.abduction(), 0.2 * (1.0 - s));
                pose.set(finger.middle_flexion(), 1.4 * s + 0.02 * f as f64);
                pose.set(finger.end_flexion(), 0.8 * s);
            }
            let joints = skeleton.frames(&pose);
            let mut points = [None; 25];
            for joint in LANDMARKS_21 {
                points[joint.index()] =
                    Some(joints.position(joint) + Vector3::new(noise(), noise(), noise()));
            }
            points
        })
        .collect()
}

fn landmarks(c: &mut Criterion) {
    let frames = recording(500);
    let mut group = c.benchmark_group("landmarks");
    group.throughput(Throughput::Elements(frames.len() as u64));
    for tie in [false, true] {
        let options = SolverOptions { tie, ..SolverOptions::default() };
        group.bench_function(if tie { "tied" } else { "free" }, |b| {
            b.iter(|| {
                let mut solver = PoseSolver::new(&Morphology::default(), Side::Right, options.clone());
                for points in &frames {
                    black_box(solver.solve(points).ok());
                }
            });
        });
    }
    group.finish();
    let domain = Domain::full();
    let outside: Vec<f64> = (0..29).map(|i| if i % 3 == 0 { -0.5 } else { 1.5 }).collect();
    c.bench_function("projection of 29 angles", |b| b.iter(|| domain.project(black_box(&outside))));
}

criterion_group!(benches, hand, landmarks);
criterion_main!(benches);
