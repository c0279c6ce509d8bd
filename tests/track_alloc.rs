//! In steady state neither tracker nor confidence allocates.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::alloc::System;

use handcast_eval::synth::{ScriptedMotion, Synth, SynthOptions};
use handcast_track::{Confidence, Evidence, HandTracker, LOST_IOU, TrackerOptions};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Without a harness, whose threads allocate, too.
fn main() {
    let mut options = SynthOptions::default();
    (options.motion, options.frames, options.size) = (ScriptedMotion::Fist, 24, (320, 240));
    let synth = Synth::new(options).unwrap();
    let frames: Vec<_> =
        (0..24).map(|i| (synth.silhouette(i), synth.forearm(i), synth.render(i).image)).collect();
    let fit = synth.true_fit(&frames[0].0, frames[0].1);
    let mut options = TrackerOptions::default();
    options.camera = Some(synth.track_camera());
    let mut tracker = HandTracker::new(&fit, options);
    let mut confidence = Confidence::new(&fit.morphology, fit.side, LOST_IOU).within(320, 240);
    let mut evidence = Evidence::default();
    let mut pass = || {
        let (mut counts, mut sure) = ([0; 3], 0.0);
        for (silhouette, forearm, image) in &frames {
            let region = Region::new(ALLOCATOR);
            let seen = evidence.load(silhouette, *forearm, Some(image), 1).unwrap();
            counts[0] += count(&region);
            let region = Region::new(ALLOCATOR);
            let tracked = tracker.track(silhouette, *forearm, Some(image)).unwrap();
            counts[1] += count(&region);
            let region = Region::new(ALLOCATOR);
            sure += confidence.of(&tracked);
            counts[2] += count(&region);
            assert!(seen && tracked.valid);
        }
        tracker.rewind();
        (counts, sure)
    };
    // The buffers grow to what these frames need.
    pass();
    pass();
    let (counts, sure) = pass();
    assert_eq!(counts, [0; 3], "by evidence, tracker and confidence in 24 frames");
    assert!(sure > 12.0, "{sure}");
}

fn count(region: &Region<System>) -> usize {
    let change = region.change();
    change.allocations + change.reallocations
}
