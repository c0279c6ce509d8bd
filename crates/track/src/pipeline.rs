//! The way from a clip to poses: frames, silhouettes, open-hand fits, registration, in bounded memory.
//!
//! Frames are decoded and segmented on threads of their own, ahead of the trackers. The frames before a
//! hand first opens are kept (silhouettes packed, pictures as JPEG) until the fit is made and are then
//! tracked backwards from it.
//!
//! Up to two hands are tracked, each by its own [`Tracker`](crate::Tracker). Every part of a picture that
//! is coloured like skin is followed by its place; it becomes a hand when it has once been seen open, so a face
//! or a piece of furniture does not. Hands that touch make one silhouette: both then hold their last pose until
//! they part.

mod clip;
mod hands;
mod overlay;
mod silhouettes;
mod start;
mod still;
mod trails;

use std::sync::mpsc::sync_channel;
use std::time::Duration;

use image::RgbImage;
use thiserror::Error;

use crate::{Camera, Fit, HandModel, OpenHand, SmoothOptions, TrackedState, TrackerOptions, View, jitter};
use handcast_hand::{Absence, ClipHand, HandPose, Morphology, Person, PoseHeader, Side, TimedPose};
use handcast_media::{FrameError, FrameSource};
use handcast_vision::{HandParts, PartsError, SegmentOptions, Silhouette, VisionError};

pub use overlay::{GOOD_CONFIDENCE, draw_overlay, draw_stages};
pub use still::{Stages, StillError, StillFit, StillOptions, StillTimings, fit_still};

/// Longest side of the pictures that are analysed, pixels.
pub const ANALYSIS_SIDE: u32 = 640;

/// How a clip is tracked.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ClipOptions {
    /// Sizes of the person, to be used instead of those the fit finds.
    pub person: Option<Person>,
    /// Left or right hand, when only that one is wanted; without, both are looked for.
    pub side: Option<Side>,
    /// Palm or back, when it is known.
    pub view: Option<View>,
    /// Whether the clip is a mirrored selfie view: its pictures (and masks) are mirrored back before anything
    /// else, so that the poses are those of the real hand.
    pub mirror: bool,
    /// What tracking starts from.
    pub start: Start,
    /// Smoothing of the poses; without, they are as registered.
    pub smooth: Option<SmoothOptions>,
    /// Threads for the trackers of two hands: 1 or 2. The result does not depend on it.
    pub threads: usize,
    /// Wrist to middle fingertip, metres.
    pub hand_length: f64,
    /// Angle that the longer side of the image sees, degrees; sets the depth of the hand.
    pub field_of_view: f64,
    /// Frames from which the colours are learnt.
    pub learning_frames: usize,
    /// Frames that may pass before the hand opens.
    pub max_lead_in: usize,
    /// Segmentation.
    pub segment: SegmentOptions,
    /// Registration and loss.
    pub tracker: TrackerOptions,
}

/// What tracking starts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Start {
    /// The first frames in which a hand is open; if none is and the person's sizes are known, any posture.
    #[default]
    Open,
    /// The first frame with a silhouette, in whatever posture the hand is; the person's sizes are those given,
    /// or the mean ones.
    Any,
}

impl Default for ClipOptions {
    fn default() -> Self {
        Self {
            person: None,
            side: None,
            view: None,
            mirror: false,
            start: Start::Open,
            smooth: None,
            threads: 2,
            hand_length: 0.189,
            field_of_view: 60.0,
            learning_frames: 48,
            max_lead_in: 1800,
            segment: SegmentOptions::default(),
            tracker: TrackerOptions::default(),
        }
    }
}

/// Why a clip could not be tracked.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ClipError {
    /// Reading the clip failed.
    #[error(transparent)]
    Frames(#[from] FrameError),
    /// A frame could not be segmented.
    #[error("frame {index}: {reason}")]
    Vision {
        /// Number of the frame, from 0.
        index: usize,
        /// Why.
        reason: VisionError,
    },
    /// Colours could not be learnt.
    #[error("first {frames} frames: {reason}")]
    Learn {
        /// How many frames were looked at.
        frames: usize,
        /// Why.
        reason: VisionError,
    },
    /// There are no frames.
    #[error("the clip has no frames")]
    Empty,
    /// The hand never opened, so there is nothing to fit the model to.
    #[error(
        "the hand is never open in {frames} frames{}: spread the five fingers once, palm or back to the \
         camera, or give the person's sizes, with which tracking starts from any posture (nearest was frame \
         {nearest}: {reason})", if *.limited { " (as many as are waited for)" } else { "" }
    )]
    NeverOpen {
        /// Frames that were looked at.
        frames: usize,
        /// Whether the clip goes on after them.
        limited: bool,
        /// The frame that came nearest to an open hand.
        nearest: usize,
        /// What was missing there.
        reason: PartsError,
    },
    /// No hand was found in any frame.
    #[error("no hand in {frames} frames: {reason}")]
    NoHand {
        /// Frames that were looked at.
        frames: usize,
        /// What was found in the last of them.
        reason: VisionError,
    },
    /// The fit did not converge to a hand.
    #[error(
        "frame {index}: the model fits the open hand badly (overlap {iou:.2}, at least {least:.2} is needed)"
    )]
    BadFit {
        /// The open frame.
        index: usize,
        /// Intersection over union.
        iou: f64,
        /// What was asked for.
        least: f64,
    },
    /// A ready mask could not be used.
    #[error("mask {path}: {what}")]
    Mask {
        /// The file.
        path: String,
        /// What is wrong.
        what: String,
    },
    /// The receiver of the frames failed.
    #[error("{0}")]
    Sink(String),
    /// The system gives no thread, or one died.
    #[error("a worker thread failed")]
    Thread,
}

/// One frame of a clip, tracked.
pub struct TrackedFrame<'a> {
    /// Number of the frame, from 0.
    pub index: usize,
    /// Presentation time, seconds.
    pub time: f64,
    /// The picture at the analysis size.
    pub image: &'a RgbImage,
    /// What segmentation found, hands or not, or why nothing.
    pub parts: Result<&'a [Silhouette], &'a VisionError>,
    /// The hands, in the order of [`TrackedClip::hands`].
    pub hands: Vec<FrameHand<'a>>,
}

/// A hand in a frame.
pub struct FrameHand<'a> {
    /// The silhouette it was registered on; `None` where there was none of its own.
    pub silhouette: Option<&'a Silhouette>,
    /// What was found.
    pub found: &'a HandFrame,
    /// How it is seen.
    pub start: &'a HandStart,
    /// The model, to project or draw it.
    pub model: &'a mut HandModel,
}

/// What was found of one hand in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct HandFrame {
    /// What the tracker says; where the hand is absent, its last state.
    pub tracked: TrackedState,
    /// The pose in the camera frame, smoothed if that was asked for.
    pub pose: HandPose,
    /// How far the pose can be trusted, 0 to 1: see [`crate::Confidence`].
    pub confidence: f64,
    /// Why the hand was not found, where it was not.
    pub absent: Option<Absence>,
}

/// Receives what happens while a clip is tracked.
pub trait ClipSink {
    /// A frame has been read and segmented; they come in order, before they are tracked.
    fn read(&mut self, _index: usize) {}

    /// A hand has been found and fitted; its frames follow.
    fn fitted(&mut self, _start: &HandStart) {}

    /// A frame has been tracked; they come in order of time.
    ///
    /// # Errors
    /// A message; tracking stops with [`ClipError::Sink`].
    fn tracked(&mut self, frame: TrackedFrame<'_>) -> Result<(), String>;
}

/// How a hand was found.
#[derive(Clone, Debug)]
pub struct HandStart {
    /// Number of the frame from which it is tracked, forwards and backwards.
    pub frame: usize,
    /// The fit of the open hand; `None` where tracking started from another posture.
    pub fit: Option<Fit>,
    /// Left or right.
    pub side: Side,
    /// Palm or back.
    pub view: View,
    /// Whether side and view were assumed: a silhouette cannot tell a right palm from a left back.
    pub assumed: bool,
    /// The sizes of the hand, metres.
    pub morphology: Morphology,
    /// The camera, at the analysis size.
    pub camera: Camera,
}

/// One hand through a clip.
#[derive(Clone, Debug)]
pub struct HandTrack {
    /// How it was found.
    pub start: HandStart,
    /// All frames of the clip.
    pub frames: Vec<HandFrame>,
}

impl HandTrack {
    /// Frames in which the hand was found.
    pub fn tracked_frames(&self) -> usize {
        self.frames.iter().filter(|f| f.tracked.valid).count()
    }

    /// The frames in which it was absent for the reason `why`.
    pub fn absent(&self, why: Absence) -> impl Iterator<Item = usize> + '_ {
        let here = move |(_, f): &(usize, &HandFrame)| f.absent == Some(why);
        self.frames.iter().enumerate().filter(here).map(|(i, _)| i)
    }

    /// Mean and smallest intersection over union, and the frame of the smallest. A lost frame counts with
    /// what it had; those in which the hand was not there yet, or touched the other, do not count.
    pub fn iou(&self) -> (f64, f64, usize) {
        let (mut sum, mut count, mut worst) = (0.0, 0usize, (1.0, 0));
        for (i, f) in self.frames.iter().enumerate() {
            if matches!(f.absent, Some(Absence::Touching | Absence::NotYet)) {
                continue;
            }
            sum += f.tracked.iou;
            count += 1;
            if f.tracked.iou < worst.0 {
                worst = (f.tracked.iou, i);
            }
        }
        (sum / count.max(1) as f64, worst.0, worst.1)
    }

    /// Unsteadiness of the poses before and after smoothing, degrees: see [`crate::jitter`].
    pub fn jitter(&self) -> Option<(f64, f64)> {
        let (side, camera) = (self.start.side, &self.start.camera);
        let of = |pose: &dyn Fn(&HandFrame) -> HandPose| {
            let found = self.frames.iter().map(|f| f.tracked.valid.then(|| pose(f)));
            jitter(&found.collect::<Vec<_>>())
        };
        Some((of(&|f| f.tracked.state.to_pose(side, camera))?, of(&|f| f.pose.clone())?))
    }
}

/// A clip as poses.
#[derive(Clone, Debug)]
pub struct TrackedClip {
    /// The hands: one, or left and right, in the order in which they were found.
    pub hands: Vec<HandTrack>,
    /// Presentation times of the frames, seconds.
    pub times: Vec<f64>,
    /// Frames per second, where known.
    pub rate: Option<f64>,
    /// Time spent in each stage.
    pub timings: ClipTimings,
}

/// Time spent working in each stage, waiting left out. Stages run side by side.
#[derive(Clone, Debug, Default)]
pub struct ClipTimings {
    /// Decoding frames.
    pub decode: Duration,
    /// Segmentation, and learning the colours.
    pub segment: Duration,
    /// Parts, fits and registration.
    pub track: Duration,
    /// The same of single frames.
    pub frames: FrameTimings,
}

/// Time each stage took for a frame, one entry a frame, in the order in which frames were worked on. What is done
/// once for a clip (learning colours, the fit) is left out.
#[derive(Clone, Debug, Default)]
pub struct FrameTimings {
    /// Decoding.
    pub decode: Vec<Duration>,
    /// Segmentation.
    pub segment: Vec<Duration>,
    /// Registration of all hands.
    pub track: Vec<Duration>,
}

impl TrackedClip {
    /// The header of a pose file for these poses.
    pub fn header(&self) -> PoseHeader {
        let info =
            |h: &HandTrack| ClipHand { side: h.start.side, morphology: Some(h.start.morphology.clone()) };
        PoseHeader { rate: self.rate, hands: self.hands.iter().map(info).collect(), made_by: None }
    }

    /// All frames of all hands as poses in the camera frame, in order of time.
    pub fn poses(&self) -> Vec<TimedPose> {
        let mut poses = Vec::with_capacity(self.times.len() * self.hands.len());
        for (i, &time) in self.times.iter().enumerate() {
            for frame in self.hands.iter().filter_map(|h| h.frames.get(i)) {
                poses.push(TimedPose {
                    time,
                    pose: frame.pose.clone(),
                    confidence: Some(frame.confidence),
                    iou: Some(frame.tracked.iou),
                    valid: frame.tracked.valid,
                    why: frame.absent,
                });
            }
        }
        poses
    }
}

/// Tracks the hands in `source`. `masks`, when given, delivers one ready mask for each frame (white is
/// hand) and takes the place of segmentation.
///
/// # Errors
/// See [`ClipError`]. A frame without a silhouette in the middle of the clip is no error: it is
/// reported as lost.
pub fn track_clip(
    source: impl FrameSource + 'static,
    masks: Option<Box<dyn FrameSource>>,
    options: &ClipOptions,
    sink: &mut dyn ClipSink,
) -> Result<TrackedClip, ClipError> {
    let rate = source.info().rate;
    let clocks = silhouettes::Clocks::default();
    let frames = silhouettes::ahead(source, options.mirror, &clocks)?;
    let (sender, receiver) = sync_channel(4);
    std::thread::scope(|scope| {
        let clock = &clocks.segment;
        let worker = std::thread::Builder::new()
            .name("segment".to_owned())
            .spawn_scoped(scope, move || silhouettes::segment_all(frames, masks, options, clock, &sender))
            .map_err(|_| ClipError::Thread)?;
        let tracked = clip::Run::new(options, sink).clip(&receiver, rate);
        // Lets the worker stop when the tracker has given up.
        drop(receiver);
        let worked = worker.join().map_err(|_| ClipError::Thread)?;
        // A failure of the source explains whatever the tracker missed after it.
        worked?;
        let mut clip = tracked?;
        (clip.timings.decode, clip.timings.frames.decode) = clocks.decode.read();
        (clip.timings.segment, clip.timings.frames.segment) = clocks.segment.read();
        Ok(clip)
    })
}

/// Overlap a fit must reach.
const LEAST_FIT: f64 = 0.80;

/// The fit's starting point in the parts that vision found.
fn open_hand(parts: &HandParts) -> OpenHand {
    OpenHand {
        wrist: parts.wrist,
        tips: std::array::from_fn(|i| parts.fingers[i].tip),
        directions: std::array::from_fn(|i| parts.fingers[i].axis),
        radii: std::array::from_fn(|i| parts.fingers[i].radius),
    }
}
