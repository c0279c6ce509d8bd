//! The way from a clip to poses: frames, silhouettes, open-hand fits, registration, in bounded memory.
//!
//! Frames are pushed into a [`Tracker`], or [`track_clip`] reads them from a source. The frames before a hand first
//! opens are kept (silhouettes packed, the latest pictures whole, older ones as JPEG) until the fit is made
//! and are then tracked backwards from it.
//!
//! Up to two hands are tracked, each by its own [`HandTracker`](crate::HandTracker). Every part of a picture
//! that is coloured like skin is followed by its place; it becomes a hand when it has once been seen open, so a face
//! or a piece of furniture does not. Hands that touch make one silhouette: both then hold their last pose until
//! they part.

mod clip;
mod clock;
mod contest;
mod exposure;
mod hands;
mod noise;
mod sighted;
mod silhouettes;
mod skin;
mod stage;
mod start;
mod still;
mod tracker;
mod trails;
mod tuning;

use std::time::Duration;

use image::RgbImage;
use thiserror::Error;

use crate::{
    ConfidenceTuning, Fit, FitTuning, HandModel, ModelState, OpenHand, PinholeCamera, SizeMismatch,
    TrackedState, TrackerOptions, View,
};
use handcast_hand::smooth::SmoothOptions;
use handcast_hand::{Absence, ClipHand, MorphologyError, PoseHeader, TimedPose};
use handcast_hand::{HandPose, Morphology, Person, Side};
use handcast_limits::{Excess, Limits};
use handcast_media::FrameError;
use handcast_vision::sighting::FindError;
use handcast_vision::{GuidedTuning, HandParts, PartsError, SegmentOptions, Silhouette, VisionError};

pub use clip::{
    ClipEnd, ClipTimings, FrameTimings, TrackedClip, TrackedHand, check_length, track_clip, track_frames,
};
pub use exposure::Exposure;
pub use sighted::FinderSource;
pub use still::{Stages, StillError, StillFit, StillOptions, StillTimings, fit_still};
pub use tracker::Tracker;
pub use tuning::{
    ClipTuning, ContestTuning, HandsTuning, NoiseTuning, SightedTuning, StartTuning, TrailTuning,
};

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
    /// Frames from which the colours are learnt; where a finder looks for hands the newest of those that have come when it has
    /// seen one.
    pub learning_frames: usize,
    /// Whether colours are learnt from the next ones as long as these show no skin, and anew as long as no hand is found;
    /// without, no skin is an error at once, and so is what opens and is no hand.
    pub learn_again: bool,
    /// Frames that may pass before the hand opens.
    pub max_lead_in: usize,
    /// Segmentation.
    pub segment: SegmentOptions,
    /// What sees where hands are; without, they are told by their colour and outline alone. Ready masks come before
    /// it.
    pub finder: Option<FinderSource>,
    /// Segmentation round the hands that it sees.
    pub guided: GuidedTuning,
    /// Registration and loss.
    pub tracker: TrackerOptions,
    /// The open-hand fit.
    pub fit: FitTuning,
    /// What the confidence is made of.
    pub confidence: ConfidenceTuning,
    /// What surrounds them.
    pub tuning: ClipTuning,
    /// How many instants and seconds a clip may have, which are those of its poses; frames that are pushed into a
    /// [`Tracker`] may be any number.
    pub limits: Limits,
}

/// What tracking starts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Start {
    /// The first frames in which a hand is open; if none is and the person's sizes are known, any posture.
    #[default]
    Open,
    /// An open hand where the first frames ([`StartTuning::any_after`]) show one; else the first frame with a
    /// silhouette, in whatever posture the hand is: the person's sizes are then those given, or the mean ones.
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
            learn_again: true,
            max_lead_in: 1800,
            segment: SegmentOptions::default(),
            finder: None,
            guided: GuidedTuning::default(),
            tracker: TrackerOptions::default(),
            fit: FitTuning::default(),
            confidence: ConfidenceTuning::default(),
            tuning: ClipTuning::default(),
            limits: Limits::default(),
        }
    }
}

/// Lengths of hands, metres, and what cameras see, degrees.
const HAND_LENGTHS: std::ops::RangeInclusive<f64> = 0.05..=0.40;
const FIELDS_OF_VIEW: std::ops::RangeInclusive<f64> = 1.0..=170.0;

impl ClipOptions {
    /// That the numbers are such that poses can come of them.
    ///
    /// # Errors
    /// [`ClipError::Option`] and [`ClipError::Person`].
    pub fn check(&self) -> Result<(), ClipError> {
        let numbers = [
            ("hand length", self.hand_length, HAND_LENGTHS, "0.05 to 0.40 m"),
            ("field of view", self.field_of_view, FIELDS_OF_VIEW, "1 to 170 degrees"),
        ];
        for (what, value, range, allowed) in numbers {
            if !range.contains(&value) {
                return Err(ClipError::Option { what, value, allowed });
            }
        }
        self.person.as_ref().map_or(Ok(()), |person| person.morphology.validate()).map_err(ClipError::Person)
    }
}

/// Why a clip could not be tracked.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ClipError {
    /// Reading the clip failed.
    #[error(transparent)]
    Frames(#[from] FrameError),
    /// The clip is longer than allowed.
    #[error(transparent)]
    Excess(#[from] Excess),
    /// An option is out of range.
    #[error("{what} is {value}, allowed is {allowed}")]
    Option {
        /// Which.
        what: &'static str,
        /// What it is.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The person's sizes are none.
    #[error("the person's sizes: {0}")]
    Person(MorphologyError),
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
         {nearest}: {reason}){exposure}", if *.limited { " (as many as are waited for)" } else { "" }
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
        /// How much of the skin there has lost its colour.
        exposure: Exposure,
    },
    /// No hand was found in any frame.
    #[error("no hand in {frames} frames{}: {reason}{exposure}", if *.limited { " (as many as are waited for)" } else { "" })]
    NoHand {
        /// Frames that were looked at.
        frames: usize,
        /// Whether the clip goes on: no more frames are waited for.
        limited: bool,
        /// What was found in the last of them.
        reason: VisionError,
        /// How much of the picture has lost its colour there.
        exposure: Exposure,
    },
    /// The fit did not converge to a hand.
    #[error(
        "frame {index}: what opens like a hand there is none, or none that the model fits (overlap {iou:.2}, at least \
         {least:.2} is needed)"
    )]
    BadFit {
        /// The open frame.
        index: usize,
        /// Intersection over union.
        iou: f64,
        /// What was asked for.
        least: f64,
    },
    /// There are fewer masks than frames.
    #[error("mask {masks}: there is no mask for frame {index}")]
    NoMask {
        /// Where masks come from.
        masks: String,
        /// The frame.
        index: usize,
    },
    /// A mask belongs to another picture.
    #[error("mask {index} has another shape than the frame: {} x {} and {} x {} pixels when scaled alike", mask.0, mask.1, picture.0, picture.1)]
    MaskSize {
        /// Number of the frame.
        index: usize,
        /// Width and height of the mask at the analysis size.
        mask: (u32, u32),
        /// Width and height of the frame at the analysis size.
        picture: (u32, u32),
    },
    /// Some frames came with a mask and some without.
    #[error("frame {index}: all frames must come with a mask, or none")]
    MixedMasks {
        /// The first that is unlike those before.
        index: usize,
    },
    /// A frame has another size than the first.
    #[error("frame {index}: picture of {} x {} pixels after pictures of {} x {}", size.0, size.1, first.0, first.1)]
    Size {
        /// Number of the frame.
        index: usize,
        /// Its width and height.
        size: (u32, u32),
        /// Width and height of the frames before.
        first: (u32, u32),
    },
    /// A frame comes before the one ahead of it.
    #[error("frame {index}: its time, {time} s, is before that of the frame ahead of it, {before} s")]
    Order {
        /// Number of the frame.
        index: usize,
        /// Its time, seconds.
        time: f64,
        /// The time of the frame ahead of it, seconds.
        before: f64,
    },
    /// A frame has no time.
    #[error("frame {index}: its time is {time}; allowed are finite numbers of seconds")]
    Time {
        /// Number of the frame.
        index: usize,
        /// What it says.
        time: f64,
    },
    /// A picture and its silhouette do not fit together.
    #[error("frame {index}: {reason}")]
    Unlike {
        /// Number of the frame.
        index: usize,
        /// Their sizes.
        reason: SizeMismatch,
    },
    /// The finder of hands failed.
    #[error("frame {index}: {reason}")]
    Find {
        /// Number of the frame.
        index: usize,
        /// Why.
        reason: FindError,
    },
    /// A picture could not be kept until its turn.
    #[error("frame {index}: its picture cannot be kept: {what}")]
    Keep {
        /// Number of the frame.
        index: usize,
        /// Why.
        what: String,
    },
    /// A frame was pushed into a tracker that had been finished, or had failed.
    #[error("the tracker has ended: it takes no more frames")]
    Ended,
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
    /// The picture at the analysis size, without much noise.
    pub image: &'a RgbImage,
    /// What segmentation found, hands or not, or why nothing.
    pub parts: Result<&'a [Silhouette], &'a VisionError>,
    /// The hands, in the order in which they were found.
    pub hands: Vec<FrameHand<'a>>,
    /// Time spent on it, its share of what is done once left out.
    pub spent: StageTimes,
}

/// Time spent working in the stages of tracking.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StageTimes {
    /// Segmentation, and learning the colours.
    pub segment: Duration,
    /// Parts, fits and registration.
    pub track: Duration,
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

impl HandFrame {
    /// The pose as it stands in pose files.
    pub fn timed(&self, time: f64) -> TimedPose {
        TimedPose {
            time,
            pose: self.pose.clone(),
            confidence: Some(self.confidence),
            iou: Some(self.tracked.iou),
            valid: self.tracked.valid,
            why: self.absent,
        }
    }
}

/// Receives what happens while a clip is tracked.
pub trait ClipSink {
    /// A frame has been read and segmented; they come in order, before they are tracked, also where there is no hand.
    ///
    /// # Errors
    /// A message; tracking stops with [`ClipError::Sink`].
    fn read(&mut self, _index: usize) -> Result<(), String> {
        Ok(())
    }

    /// A hand has been found and fitted; its frames follow.
    fn fitted(&mut self, _start: &HandStart) {}

    /// A frame has been tracked; they come in order of time.
    ///
    /// # Errors
    /// A message; tracking stops with [`ClipError::Sink`].
    fn tracked(&mut self, frame: TrackedFrame<'_>) -> Result<(), String>;
}

/// Nobody looks on.
impl ClipSink for () {
    fn tracked(&mut self, _: TrackedFrame<'_>) -> Result<(), String> {
        Ok(())
    }
}

/// How a hand was found.
#[derive(Clone, Debug)]
pub struct HandStart {
    /// Number of the frame from which it is tracked, forwards and backwards.
    pub frame: usize,
    /// The fit of the open hand; `None` where tracking started from another posture.
    pub fit: Option<Fit>,
    /// About how the open hand would look there, of a hand that a finder saw in another posture.
    pub seen: Option<ModelState>,
    /// Left or right.
    pub side: Side,
    /// Palm or back.
    pub view: View,
    /// Whether side and view were assumed: a silhouette cannot tell a right palm from a left back.
    pub assumed: bool,
    /// The sizes of the hand, metres.
    pub morphology: Morphology,
    /// The camera, at the analysis size.
    pub camera: PinholeCamera,
}

impl HandStart {
    /// What a frame has of the hand before it is found: its fit where there is one, far away.
    pub fn not_yet(&self) -> HandFrame {
        hands::not_yet(self)
    }
}

/// The header of a pose file of these hands.
fn header<'a>(
    hands: impl IntoIterator<Item = &'a HandStart>,
    rate: Option<f64>,
    skin_tone: Option<u8>,
) -> PoseHeader {
    let info = |start: &HandStart| ClipHand { side: start.side, morphology: Some(start.morphology.clone()) };
    PoseHeader { rate, hands: hands.into_iter().map(info).collect(), skin_tone, ..PoseHeader::default() }
}

/// The fit's starting point in the parts that vision found.
fn open_hand(parts: &HandParts) -> OpenHand {
    OpenHand {
        wrist: parts.wrist,
        tips: std::array::from_fn(|i| parts.fingers[i].tip),
        directions: std::array::from_fn(|i| parts.fingers[i].axis),
        radii: std::array::from_fn(|i| parts.fingers[i].radius),
    }
}
