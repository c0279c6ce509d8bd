//! What a frame costs at several sizes, and whether later frames cost more than earlier ones.

use std::fmt::Write as _;
use std::time::Instant;

use anyhow::Context;
use handcast_eval::synth::{ScriptedMotion, Synth, SynthOptions};
use handcast_track::{Forearm, HandTracker, TrackerOptions};
use handcast_vision::{SegmentOptions, Segmenter};
use serde::Serialize;

/// Sizes that are measured, each with four times the pixels of the one before.
const SIZES: [(u32, u32); 4] = [(160, 120), (320, 240), (640, 480), (1280, 960)];
/// Pictures from which colours are learnt.
const LEARNT: usize = 6;

/// Milliseconds a frame at one size.
#[derive(Debug, Serialize)]
pub struct Cost {
    pub size: (u32, u32),
    pub frames: usize,
    pub segment_ms: f64,
    pub track_ms: f64,
    /// Tracking, of the first half of the frames and of the second, which shows the first once more.
    pub halves_ms: [f64; 2],
}

/// Segments and tracks `frames` rendered frames of the demo motion twice over, at each size.
pub fn measure(frames: usize, seed: u64) -> anyhow::Result<Vec<Cost>> {
    let each = SIZES.into_iter().map(|size| {
        let mut o = SynthOptions::default();
        o.motion = ScriptedMotion::Demo;
        (o.frames, o.size, o.seed) = (frames, size, seed);
        let synth = Synth::new(o)?;
        let pictures: Vec<_> = (0..frames).map(|i| synth.render(i).image).collect();
        let samples: Vec<_> = pictures.iter().step_by(frames.div_ceil(LEARNT)).cloned().collect();
        let options = SegmentOptions::default().with_max_side(size.0);
        let mut segmenter = Segmenter::learn(&samples, options).context("the colours cannot be learnt")?;
        let begun = Instant::now();
        let found: Vec<_> = pictures.iter().map(|p| segmenter.segment_all(p)).collect();
        let segment = begun.elapsed();
        let found: Vec<_> = found.into_iter().map(|s| s.ok().and_then(|s| s.into_iter().next())).collect();
        let first = found.first().cloned().flatten().context("no hand in the first frame")?;
        let mut options = TrackerOptions::default();
        options.camera = Some(synth.track_camera());
        let forearm = first.wrist.as_ref().map(Forearm::from);
        let mut tracker = HandTracker::new(&synth.true_fit(&first.hand, forearm), options);
        let mut pass = || {
            let begun = Instant::now();
            for (picture, silhouette) in pictures.iter().zip(&found) {
                if let Some(s) = silhouette {
                    tracker.track(&s.hand, s.wrist.as_ref().map(Forearm::from), Some(picture))?;
                }
            }
            anyhow::Ok(1e3 * begun.elapsed().as_secs_f64() / frames as f64)
        };
        // The buffers grow in a pass that does not count.
        pass()?;
        let halves_ms = [pass()?, pass()?];
        Ok(Cost {
            size,
            frames: 2 * frames,
            segment_ms: 1e3 * segment.as_secs_f64() / frames as f64,
            track_ms: 0.5 * (halves_ms[0] + halves_ms[1]),
            halves_ms,
        })
    });
    each.collect()
}

/// The costs as a table.
pub fn text(costs: &[Cost]) -> String {
    let mut t = String::new();
    let _ = writeln!(
        t,
        "{:<11} {:>8} {:>10} {:>8} {:>9} {:>8} {:>11} {:>11}",
        "size", "pixels", "segment ms", "ns/pixel", "track ms", "ns/pixel", "first half", "second half"
    );
    for c in costs {
        let pixels = f64::from(c.size.0) * f64::from(c.size.1);
        let per_pixel = |ms: f64| 1e6 * ms / pixels;
        let _ = writeln!(
            t,
            "{:<11} {pixels:>8} {:>10.2} {:>8.1} {:>9.2} {:>8.1} {:>11.2} {:>11.2}",
            format!("{}x{}", c.size.0, c.size.1),
            c.segment_ms,
            per_pixel(c.segment_ms),
            c.track_ms,
            per_pixel(c.track_ms),
            c.halves_ms[0],
            c.halves_ms[1]
        );
    }
    t
}
