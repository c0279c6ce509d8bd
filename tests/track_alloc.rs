//! In steady state neither tracker nor confidence allocates.

#![allow(clippy::unwrap_used)]

use std::alloc::System;

use handcast::synth::{Motion, Synth, SynthOptions};
use handcast::track::{Confidence, LOST_IOU, Tracker, TrackerOptions};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// One test, as what is counted is counted for the whole process.
#[test]
fn a_tracked_frame_allocates_nothing() {
    let mut options = SynthOptions::default();
    (options.motion, options.frames, options.size) = (Motion::Fist, 24, (320, 240));
    let synth = Synth::new(options).unwrap();
    let frames: Vec<_> =
        (0..24).map(|i| (synth.silhouette(i), synth.forearm(i), synth.render(i).image)).collect();
    let fit = synth.true_fit(&frames[0].0, frames[0].1);
    let mut options = TrackerOptions::default();
    options.camera = Some(synth.track_camera());
    let mut tracker = Tracker::new(&fit, options);
    let mut confidence = Confidence::new(&fit.morphology, fit.side, LOST_IOU);
    let mut pass = |sure: &mut f64| {
        for (silhouette, forearm, image) in &frames {
            let tracked = tracker.track(silhouette, *forearm, Some(image));
            *sure += confidence.of(&tracked);
        }
        tracker.rewind();
    };
    let mut sure = 0.0;
    // The buffers grow to what these frames need.
    pass(&mut sure);
    pass(&mut sure);
    let region = Region::new(ALLOCATOR);
    pass(&mut sure);
    let change = region.change();
    assert_eq!(change.allocations + change.reallocations, 0, "in 24 frames");
    assert!(sure > 30.0, "{sure}");
}
