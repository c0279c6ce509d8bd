//! Tracks sequences and keeps what was found.

use std::time::Instant;

use anyhow::Context;
use handcast_eval::fidelity::{Observation, TrackingMeter, TrackingReport};
use handcast_eval::methods::{FrameTracker, Seen};
use handcast_hand::HandPose;
use handcast_track::{Confidence, LOST_IOU, ModelState, TrackedState};

use super::sequence::Sequence;

/// One sequence, tracked.
pub struct Measured {
    pub report: TrackingReport,
    pub found: Vec<Found>,
}

/// What was found in one frame; of a lost one, what is shown in its place.
pub struct Found {
    /// Number of the frame in the clip, or in the synthetic sequence.
    pub frame: usize,
    pub state: ModelState,
    pub pose: HandPose,
}

/// Takes in frame by frame what a tracker finds.
struct Keeper {
    meter: TrackingMeter,
    found: Vec<Found>,
}

impl Keeper {
    fn new(sequence: &Sequence) -> Self {
        let meter = TrackingMeter::new(&sequence.fit.morphology, sequence.fit.side);
        Self { meter, found: Vec::new() }
    }

    fn add(&mut self, frame: usize, tracked: TrackedState, seen: &Observation) {
        self.meter.add(seen);
        self.found.push(Found { frame, state: tracked.state, pose: seen.found.clone() });
    }

    fn end(self) -> Measured {
        Measured { report: self.meter.report(), found: self.found }
    }
}

/// Tracks each `every`-th frame of a sequence; `every` is at least 1.
pub fn measure(
    sequence: &Sequence,
    every: usize,
    tracker: &mut dyn FrameTracker,
) -> anyhow::Result<Measured> {
    let side = sequence.fit.side;
    let first = sequence.clip.as_ref().map_or(0, |clip| clip.first);
    let mut keeper = Keeper::new(sequence);
    let mut confidence = Confidence::new(&sequence.fit.morphology, side, LOST_IOU)
        .within(sequence.camera.width, sequence.camera.height);
    for (i, frame) in sequence.frames.iter().enumerate().step_by(every) {
        let seen =
            Seen { image: frame.image.as_ref(), silhouette: &frame.silhouette, forearm: frame.forearm };
        let begun = Instant::now();
        let tracked =
            tracker.next(&seen).with_context(|| format!("{}: frame {}", sequence.name, first + i))?;
        let seconds = begun.elapsed().as_secs_f64();
        let found = tracked.state.to_pose(side, &sequence.camera);
        let observation = Observation {
            truth: frame.truth.as_ref(),
            visible: Some(frame.visible),
            found: &found,
            valid: tracked.valid,
            iou: tracked.iou,
            confidence: confidence.of(&tracked),
            evaluations: tracked.evaluations,
            restarted: tracked.restarted,
            seconds,
        };
        keeper.add(first + i, tracked, &observation);
    }
    Ok(keeper.end())
}

/// What the pipeline found in a clip.
pub fn of_pipeline(sequence: &Sequence) -> Measured {
    let mut keeper = Keeper::new(sequence);
    if let Some(clip) = &sequence.clip {
        for (i, (visible, hand)) in clip.found.iter().enumerate() {
            let tracked = &hand.tracked;
            let observation = Observation {
                truth: None,
                visible: Some(*visible),
                found: &hand.pose,
                valid: tracked.valid,
                iou: tracked.iou,
                confidence: hand.confidence,
                evaluations: tracked.evaluations,
                restarted: tracked.restarted,
                seconds: clip.seconds,
            };
            keeper.add(i, tracked.clone(), &observation);
        }
    }
    keeper.end()
}
