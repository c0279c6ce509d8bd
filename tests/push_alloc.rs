//! However many frames are pushed, the tracker keeps no more.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::alloc::System;

use handcast_eval::synth::{ScriptedMotion, Synth, SynthOptions};
use handcast_media::Frame;
use handcast_track::pipeline::{ClipOptions, Tracker};
use image::RgbImage;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Without a harness, whose threads allocate, too.
fn main() {
    let mut o = SynthOptions::default();
    (o.motion, o.frames, o.size) = (ScriptedMotion::Fist, 20, (160, 120));
    let synth = Synth::new(o).unwrap();
    let pictures: Vec<RgbImage> = (0..20).map(|i| synth.render(i).image).collect();
    let mut tracker = Tracker::new(ClipOptions::default());
    let (mut pushed, mut poses) = (0, 0);
    let mut pass = |times: usize| {
        let region = Region::new(ALLOCATOR);
        for picture in pictures.iter().cycle().take(times * pictures.len()) {
            let frame = Frame { index: pushed, time: pushed as f64 / 30.0, image: picture.clone() };
            poses += tracker.push(frame).unwrap().len();
            pushed += 1;
        }
        assert!(poses == pushed, "{poses} poses of {pushed} frames");
        let change = region.change();
        change.bytes_allocated as i64 - change.bytes_deallocated as i64
    };
    // Colours, fit and lead-in, and buffers that grow to what these frames need.
    pass(6);
    let grown = pass(10);
    assert!(grown.abs() < 2048, "{grown} bytes in 200 frames of {} bytes", 160 * 120 * 3);
}
