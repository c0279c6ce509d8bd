//! In steady state neither encoder nor decoder allocates.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::alloc::System;

use handcast_codec::mapping::{Profile, hand_mask};
use handcast_codec::{PoseDecoder, PoseDecoderOptions, PoseEncoder, PoseEncoderOptions};
use handcast_fba::bap::{Bap, BapFrame};
use handcast_fba::plan::{PlanOptions, Target};
use handcast_fba::{Decoder, DecoderOptions, Encoder, EncoderConfig};
use handcast_hand::{HandPose, JointAngle, Side, TimedPose};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// A hand that opens and closes.
fn frame(number: u32) -> BapFrame {
    let value = |bap: Bap| {
        let phase = f64::from(number) * 0.1 + f64::from(bap.number());
        let size = if bap.is_extension() { 300.0 } else { 40_000.0 };
        (phase.sin() * size) as i32
    };
    hand_mask(Side::Right, Profile::Hand).iter().map(|bap| (bap, value(bap))).collect()
}

fn no_allocation_per_frame() {
    let mut encoder = Encoder::new(EncoderConfig::default()).unwrap();
    let mut stream = Vec::with_capacity(1 << 20);
    let frames: Vec<BapFrame> = (0..900).map(frame).collect();
    for frame in &frames[..300] {
        encoder.write_frame(frame).unwrap();
        encoder.take_bytes(&mut stream);
    }
    let region = Region::new(ALLOCATOR);
    for frame in &frames[300..] {
        encoder.write_frame(frame).unwrap();
        encoder.take_bytes(&mut stream);
    }
    assert_eq!(region.change().allocations + region.change().reallocations, 0, "encoder");
    stream.extend(encoder.finish());

    let mut decoder = Decoder::new(DecoderOptions::default());
    let pieces: Vec<&[u8]> = stream.chunks(100).collect();
    let (first, rest) = pieces.split_at(pieces.len() * 2 / 3);
    let mut count = 0;
    let mut drain = |decoder: &mut Decoder, pieces: &[&[u8]]| {
        for piece in pieces {
            decoder.push(piece).unwrap();
            while let Some(frame) = decoder.next_frame().unwrap() {
                count += u32::from(frame.damage.is_none());
            }
        }
    };
    drain(&mut decoder, first);
    let region = Region::new(ALLOCATOR);
    drain(&mut decoder, rest);
    assert_eq!(region.change().allocations + region.change().reallocations, 0, "decoder");
    assert_eq!(count, 900);
}

/// An hour of motion goes through encoder and decoder in the memory of its first seconds.
fn an_hour_in_constant_memory() {
    let mut encoder = Encoder::new(EncoderConfig { resync: true, ..EncoderConfig::default() }).unwrap();
    let mut decoder = Decoder::new(DecoderOptions::default());
    let mut bytes = Vec::new();
    let mut decoded = 0u32;
    let mut run = |from: u32, to: u32| {
        for number in from..to {
            encoder.write_frame(&frame(number)).unwrap();
            encoder.take_bytes(&mut bytes);
            decoder.push(&bytes).unwrap();
            bytes.clear();
            while let Some(frame) = decoder.next_frame().unwrap() {
                decoded += u32::from(frame.damage.is_none());
            }
        }
    };
    run(0, 600);
    let region = Region::new(ALLOCATOR);
    run(600, 3600 * 30);
    assert!(grown(&region) < 16 << 10, "{} bytes more are held", grown(&region));
    assert!(decoded > 3600 * 30 - 5);
}

fn pose(number: u32) -> TimedPose {
    let bend = 0.5 + 0.5 * (f64::from(number) * 0.1).sin();
    let mut pose = HandPose::neutral(Side::Right);
    JointAngle::ALL.into_iter().for_each(|angle| pose.set(angle, 0.3 * bend));
    TimedPose::new(f64::from(number) / 30.0, pose)
}

/// Poses that wait for their plan, and the account of a live stream.
fn pushed_poses_take_little_memory() {
    const POSES: u32 = 30 * 600;
    let plan = PlanOptions { mode: Target::Quant(10), ..PlanOptions::default() };
    let mut stream = Vec::new();
    for (live, most) in [(false, 200), (true, 40)] {
        let options = PoseEncoderOptions::default().with_plan(PlanOptions { live, ..plan });
        let mut encoder = PoseEncoder::new(options).unwrap();
        stream = Vec::with_capacity(1 << 20);
        let region = Region::new(ALLOCATOR);
        (0..POSES).for_each(|number| stream.extend(encoder.push(&pose(number)).unwrap()));
        let each = grown(&region) / i64::from(POSES);
        assert!(each < most, "live {live}: {each} bytes for each pose");
        stream.extend(encoder.finish().unwrap().bytes);
    }
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
    let (first, rest) = stream.split_at(stream.len() / 10);
    let mut decode = |bytes: &[u8]| bytes.chunks(100).map(|b| decoder.push(b).unwrap().len()).sum::<usize>();
    let mut poses = decode(first);
    let region = Region::new(ALLOCATOR);
    poses += decode(rest);
    assert!(grown(&region) < 16 << 10, "decoder: {} bytes more are held", grown(&region));
    assert_eq!(poses, POSES as usize);
}

fn grown(region: &Region<System>) -> i64 {
    let change = region.change();
    change.bytes_allocated as i64 - change.bytes_deallocated as i64
}

/// Without a harness, whose threads allocate, too.
fn main() {
    no_allocation_per_frame();
    an_hour_in_constant_memory();
    pushed_poses_take_little_memory();
}
