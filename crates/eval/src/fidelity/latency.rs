//! How long each stage takes for a frame.

use std::time::{Duration, Instant};

use serde::Serialize;

use super::round_trip::FidelityError;
use super::summary::{mean, percentile};
use handcast_codec::for_hands;
use handcast_codec::mapping::{PoseMapper, Profile, pose_from_frame};
use handcast_codec::{PosesToStreamError, StreamToPosesError, bap_frames};
use handcast_fba::bap::BapFrame;
use handcast_fba::plan::{LiveEncoder, PlanOptions};
use handcast_fba::{Decoder, DecoderOptions};
use handcast_hand::{HandMesh, HandPose, PoseClip, Side, Skeleton, SkinnedSurface};
use handcast_track::pipeline::FrameTimings;

/// Milliseconds a stage takes for a frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageLatency {
    /// The stage.
    pub stage: &'static str,
    /// Frames timed.
    pub frames: usize,
    /// Mean.
    pub mean_ms: f64,
    /// Median.
    pub p50_ms: f64,
    /// 95th percentile.
    pub p95_ms: f64,
}

impl StageLatency {
    fn new(stage: &'static str, times: &[Duration]) -> Self {
        let ms: Vec<f64> = times.iter().map(|t| 1e3 * t.as_secs_f64()).collect();
        Self {
            stage,
            frames: ms.len(),
            mean_ms: mean(&ms),
            p50_ms: percentile(&ms, 0.5),
            p95_ms: percentile(&ms, 0.95),
        }
    }
}

/// The stages from pixels to poses.
pub fn of_tracking(timings: &FrameTimings) -> Vec<StageLatency> {
    vec![
        StageLatency::new("read a frame", &timings.decode),
        StageLatency::new("segment", &timings.segment),
        StageLatency::new("track", &timings.track),
    ]
}

/// The stages from poses to a skinned mesh, frame by frame as a live link runs them: mapping, the live encoder, the
/// decoder fed with each frame's bytes, mapping back, and skinning of each hand.
///
/// # Errors
/// [`FidelityError::Encode`], [`FidelityError::Decode`].
pub fn of_link(
    clip: &PoseClip,
    profile: Profile,
    plan: &PlanOptions,
) -> Result<Vec<StageLatency>, FidelityError> {
    // Each instant with a pose of every hand, lost ones held.
    let frames = bap_frames(clip, profile)?;
    let sides: Vec<Side> = clip.header.hands.iter().map(|h| h.side).collect();
    let poses = |baps: &BapFrame| -> Vec<HandPose> {
        sides.iter().filter_map(|&side| pose_from_frame(baps, side, profile)).collect()
    };
    let instants: Vec<Vec<HandPose>> = frames.iter().map(|f| poses(&f.baps)).collect();
    let models: Vec<(HandMesh, Skeleton)> = clip
        .header
        .hands
        .iter()
        .map(|h| {
            let morphology = h.morphology.clone().unwrap_or_default();
            (HandMesh::generate(&morphology, h.side), Skeleton::new(&morphology, h.side))
        })
        .collect();
    let mut mapper = PoseMapper::new(profile);
    let live = PlanOptions { live: true, ..for_hands(*plan) };
    let mut encoder = LiveEncoder::new(&live).map_err(PosesToStreamError::from)?;
    let options = DecoderOptions { steps: plan.steps, ranges: plan.ranges, ..DecoderOptions::default() };
    let mut decoder = Decoder::new(options);
    let mut bytes = Vec::new();
    let mut surface = SkinnedSurface::default();
    let mut times: [Vec<Duration>; 5] = Default::default();
    for hands in &instants {
        let mut clock = Instant::now();
        let mut lap = |stage: usize| {
            let now = Instant::now();
            if let Some(list) = times.get_mut(stage) {
                list.push(now - clock);
            }
            clock = now;
        };
        let frame = mapper.frame(hands);
        lap(0);
        encoder.write_frame(&frame).map_err(PosesToStreamError::from)?;
        bytes.clear();
        encoder.take_bytes(&mut bytes);
        lap(1);
        decoder.push(&bytes).map_err(StreamToPosesError::from)?;
        let mut shown = None;
        while let Some(plane) = decoder.next_frame().map_err(StreamToPosesError::from)? {
            shown = Some(plane);
        }
        lap(2);
        // The last bits of a plane may only come with the next.
        let Some(plane) = shown else { continue };
        let found = poses(&plane.baps);
        lap(3);
        for pose in &found {
            let model = models.iter().find(|(_, skeleton)| skeleton.side() == pose.side);
            if let Some((mesh, skeleton)) = model {
                mesh.skin(&skeleton.frames(pose), &mut surface);
            }
        }
        lap(4);
    }
    let names = ["pose to BAPs", "encode, live", "decode", "BAPs to pose", "skin the mesh"];
    Ok(names.into_iter().zip(&times).map(|(name, times)| StageLatency::new(name, times)).collect())
}
