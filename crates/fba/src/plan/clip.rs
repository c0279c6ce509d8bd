//! A clip on the ticks of a stream's clock, cut into I periods.

use super::super::error::EncodeError;
use super::super::state::step;
use super::super::syntax::{FrameRate, MAX_RANGE_CODE, range_levels};
use super::{PlanOptions, TimedBapFrame, refused};
use crate::bap::{BapFrame, BapMask, StepTable, Unit};

/// The frames of a clip on the ticks of the stream's clock, cut into I periods.
pub(super) struct Clip {
    pub frames: Vec<BapFrame>,
    /// Tick of each frame, from 0.
    pub ticks: Vec<u64>,
    /// First frame of each period, and the number of frames.
    cuts: Vec<usize>,
    /// Angles ever different from 0, and all angles given.
    pub moving: BapMask,
    pub angles: BapMask,
}

/// Whether a BAP changes by more than a P plane may carry: the frame then begins an I period. Rotation
/// vectors do so where they pass to the other way round.
fn jumps(before: &BapFrame, frame: &BapFrame, steps: StepTable) -> bool {
    frame.iter().any(|(bap, value)| {
        let reach = 0.9 * f64::from(range_levels(MAX_RANGE_CODE, 1)) * f64::from(step(bap, steps, 1));
        (f64::from(value) - f64::from(before.value(bap))).abs() > reach
    })
}

/// Ticks between two frames, at most: what a decoder accepts as skipped frames.
const MAX_GAP: u64 = 65_535;

impl Clip {
    pub fn new(frames: &[TimedBapFrame], options: &PlanOptions) -> Result<Self, EncodeError> {
        let first = frames.first().ok_or(refused("number of frames", 0.0, "at least 1"))?;
        let mut clip = Self {
            frames: Vec::with_capacity(frames.len()),
            ticks: Vec::with_capacity(frames.len()),
            cuts: vec![0],
            moving: BapMask::EMPTY,
            angles: BapMask::EMPTY,
        };
        let rate = options.rate.per_second();
        let interval = (options.intra_seconds * rate).round().max(1.0) as u64;
        let mut next_cut = interval;
        for frame in frames {
            let wanted = ((frame.time - first.time) * rate).round();
            let last = clip.ticks.last().copied();
            // Times that jitter may put two frames on one tick; the second then moves to the next.
            let tick = last.map_or(0.0, |last| wanted.max(last as f64 + 1.0));
            let gap = last.map_or(0.0, |last| tick - last as f64);
            if !(tick - wanted <= 1.0 && gap <= MAX_GAP as f64) {
                return Err(refused("time of a frame", frame.time, "about a tick after the frame before"));
            }
            let tick = tick as u64;
            let changed = clip.frames.last().is_some_and(|before| {
                before.mask != frame.baps.mask || jumps(before, &frame.baps, options.steps)
            });
            if tick >= next_cut || changed {
                clip.cuts.push(clip.frames.len());
                while next_cut <= tick {
                    next_cut += interval;
                }
            }
            clip.frames.push(frame.baps);
            clip.ticks.push(tick);
            for (bap, value) in frame.baps.iter().filter(|(bap, _)| bap.unit() == Unit::Angle) {
                clip.angles.insert(bap);
                if value != 0 {
                    clip.moving.insert(bap);
                }
            }
        }
        clip.cuts.push(clip.frames.len());
        Ok(clip)
    }

    pub fn periods(&self) -> usize {
        self.cuts.len() - 1
    }

    pub fn period(&self, index: usize) -> std::ops::Range<usize> {
        self.cuts[index]..self.cuts[index + 1]
    }

    pub fn seconds(&self, rate: FrameRate) -> f64 {
        self.ticks.last().map_or(0.0, |last| (last + 1) as f64 / rate.per_second())
    }
}
