//! The way from a clip to poses: frames, silhouettes, open-hand fit, registration, in bounded memory.
//!
//! Frames are decoded and segmented on threads of their own, ahead of the tracker. The frames before the
//! hand first opens are kept (silhouettes packed, pictures as JPEG) until the fit is made and are then
//! tracked backwards from it.

mod overlay;
mod still;

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use image::RgbImage;
use thiserror::Error;

use crate::hand::{Morphology, Person, Side};
use crate::io::frames::{Frame, FrameError, FrameSource, Prefetch};
use crate::io::poses::{PoseHeader, TimedPose};
use crate::track::{
    Camera, Fit, FitOptions, Forearm, HandModel, LOST_IOU, OpenHand, TrackedState, Tracker, TrackerOptions,
    View, fit_open_hand,
};
use crate::vision::{
    HandParts, Mask, PartsError, SegmentOptions, Segmenter, Silhouette, VisionError, find_parts,
};

pub use overlay::{draw_overlay, draw_stages};
pub use still::{Stages, StillError, StillFit, StillOptions, StillTimings, fit_still};

/// Longest side of the pictures that are analysed, pixels.
pub const ANALYSIS_SIDE: u32 = 640;

/// How a clip is tracked.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ClipOptions {
    /// Sizes of the person, to be used instead of those the fit finds.
    pub person: Option<Person>,
    /// Left or right hand, when it is known.
    pub side: Option<Side>,
    /// Palm or back, when it is known.
    pub view: Option<View>,
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

impl Default for ClipOptions {
    fn default() -> Self {
        Self {
            person: None,
            side: None,
            view: None,
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
         camera (nearest was frame {nearest}: {reason})", if *.limited { " (as many as are waited for)" } else { "" }
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
    /// What segmentation found, or why nothing.
    pub silhouette: Result<&'a Silhouette, &'a VisionError>,
    /// What the tracker found.
    pub tracked: &'a TrackedState,
    /// The model, to project or draw it.
    pub model: &'a mut HandModel,
}

/// Receives what happens while a clip is tracked.
pub trait ClipSink {
    /// A frame has been read and segmented; they come in order, before they are tracked.
    fn read(&mut self, _index: usize) {}

    /// The open hand has been found and fitted.
    fn fitted(&mut self, _start: &ClipStart) {}

    /// A frame has been tracked; they come in order of time.
    ///
    /// # Errors
    /// A message; tracking stops with [`ClipError::Sink`].
    fn tracked(&mut self, frame: TrackedFrame<'_>) -> Result<(), String>;
}

/// What the open frame told.
#[derive(Clone, Debug)]
pub struct ClipStart {
    /// Number of the frame that was fitted.
    pub frame: usize,
    /// The fit.
    pub fit: Fit,
    /// Palm or back.
    pub view: View,
    /// Whether palm or back was assumed: a silhouette cannot tell a right palm from a left back.
    pub assumed: bool,
    /// The camera, at the analysis size.
    pub camera: Camera,
}

/// A clip as poses.
#[derive(Clone, Debug)]
pub struct TrackedClip {
    /// The open frame and its fit.
    pub start: ClipStart,
    /// Frames per second, where known.
    pub rate: Option<f64>,
    /// Times and states of all frames.
    pub frames: Vec<(f64, TrackedState)>,
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
    /// Parts, fit and registration.
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
    /// Registration.
    pub track: Vec<Duration>,
}

impl TrackedClip {
    /// Left or right.
    pub fn side(&self) -> Side {
        self.start.fit.side
    }

    /// The sizes of the hand.
    pub fn morphology(&self) -> &Morphology {
        &self.start.fit.morphology
    }

    /// The header of a pose file for these poses.
    pub fn header(&self) -> PoseHeader {
        PoseHeader::one(self.side(), Some(self.morphology().clone()), self.rate)
    }

    /// Frame `i` as a pose in the camera frame. Confidence grows from 0 at the overlap where the hand
    /// counts as lost to 1 at 0.95.
    pub fn pose(&self, i: usize) -> Option<TimedPose> {
        let (time, tracked) = self.frames.get(i)?;
        let pose = tracked.state.to_pose(self.side(), &self.start.camera);
        let confidence =
            if tracked.valid { ((tracked.iou - LOST_IOU) / (0.95 - LOST_IOU)).clamp(0.0, 1.0) } else { 0.0 };
        Some(TimedPose {
            time: *time,
            pose,
            confidence: Some(confidence),
            iou: Some(tracked.iou),
            valid: tracked.valid,
        })
    }

    /// All frames as poses.
    pub fn poses(&self) -> Vec<TimedPose> {
        (0..self.frames.len()).filter_map(|i| self.pose(i)).collect()
    }

    /// Frames in which the hand was found.
    pub fn tracked_frames(&self) -> usize {
        self.frames.iter().filter(|(_, t)| t.valid).count()
    }

    /// Mean and smallest intersection over union, over all frames (a lost frame counts with what it had).
    pub fn iou(&self) -> (f64, f64) {
        let n = self.frames.len().max(1) as f64;
        let sum: f64 = self.frames.iter().map(|(_, t)| t.iou).sum();
        (sum / n, self.frames.iter().map(|(_, t)| t.iou).fold(1.0, f64::min))
    }
}

/// Tracks the hand in `source`. `masks`, when given, delivers one ready mask for each frame (white is
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
    let clocks = Clocks::default();
    let timed = TimedSource { source, clock: clocks.decode.clone() };
    let frames = Prefetch::new(timed, 4)?;
    let (sender, receiver) = sync_channel(4);
    std::thread::scope(|scope| {
        let clock = &clocks.segment;
        let worker = std::thread::Builder::new()
            .name("segment".to_owned())
            .spawn_scoped(scope, move || segment_all(frames, masks, options, clock, &sender))
            .map_err(|_| ClipError::Thread)?;
        let tracked = Run { options, sink, track: Duration::ZERO, steps: Vec::new() }.clip(&receiver, rate);
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

#[derive(Default)]
struct Clocks {
    decode: Arc<Clock>,
    segment: Clock,
}

/// Time spent in a stage.
#[derive(Default)]
struct Clock {
    total: AtomicU64,
    frames: Mutex<Vec<Duration>>,
}

impl Clock {
    /// Time spent on something else than a frame.
    fn charge(&self, since: Instant) {
        self.total.fetch_add(since.elapsed().as_nanos() as u64, Ordering::Relaxed);
    }

    /// Time spent on a frame.
    fn charge_frame(&self, since: Instant) {
        self.charge(since);
        if let Ok(mut frames) = self.frames.lock() {
            frames.push(since.elapsed());
        }
    }

    fn read(&self) -> (Duration, Vec<Duration>) {
        let frames = self.frames.lock().map(|frames| frames.clone()).unwrap_or_default();
        (Duration::from_nanos(self.total.load(Ordering::Relaxed)), frames)
    }
}

/// A source that counts the time it takes.
struct TimedSource<S> {
    source: S,
    clock: Arc<Clock>,
}

impl<S: FrameSource> FrameSource for TimedSource<S> {
    fn info(&self) -> &crate::io::frames::ClipInfo {
        self.source.info()
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let start = Instant::now();
        let frame = self.source.next_frame();
        if matches!(frame, Ok(Some(_))) {
            self.clock.charge_frame(start);
        }
        frame
    }
}

/// A frame and its silhouette.
struct Segmented {
    frame: Frame,
    silhouette: Result<Silhouette, VisionError>,
}

/// Learns the colours from the first frames, then sends every frame with its silhouette.
fn segment_all(
    mut frames: Prefetch,
    masks: Option<Box<dyn FrameSource>>,
    options: &ClipOptions,
    clock: &Clock,
    sender: &SyncSender<Segmented>,
) -> Result<(), ClipError> {
    if let Some(mut masks) = masks {
        while let Some(frame) = frames.next_frame()? {
            let index = frame.index;
            let mask = masks.next_frame()?.ok_or_else(|| ClipError::Mask {
                path: masks.info().format.clone(),
                what: format!("there is no mask for frame {index}"),
            })?;
            let start = Instant::now();
            let gray = image::imageops::grayscale(&mask.image);
            let silhouette = Silhouette::from_gray(&gray, &options.segment);
            clock.charge_frame(start);
            if let Ok(s) = &silhouette
                && (s.hand.width(), s.hand.height()) != frame.image.dimensions()
            {
                return Err(ClipError::Mask {
                    path: masks.info().format.clone(),
                    what: format!("mask {index} has another shape than the frame"),
                });
            }
            if sender.send(Segmented { frame, silhouette }).is_err() {
                return Ok(());
            }
        }
        return Ok(());
    }
    let mut first = VecDeque::new();
    while first.len() < options.learning_frames.max(1) {
        match frames.next_frame()? {
            Some(frame) => first.push_back(frame),
            None => break,
        }
    }
    if first.is_empty() {
        return Ok(());
    }
    let start = Instant::now();
    let stride = first.len().div_ceil(16);
    let samples: Vec<RgbImage> = first.iter().step_by(stride).map(|f| f.image.clone()).collect();
    let mut segmenter = Segmenter::learn(&samples, options.segment.clone())
        .map_err(|reason| ClipError::Learn { frames: first.len(), reason })?;
    drop(samples);
    clock.charge(start);
    loop {
        let frame = match first.pop_front() {
            Some(frame) => frame,
            None => match frames.next_frame()? {
                Some(frame) => frame,
                None => return Ok(()),
            },
        };
        let start = Instant::now();
        let silhouette = segmenter.segment(&frame.image);
        clock.charge_frame(start);
        if sender.send(Segmented { frame, silhouette }).is_err() {
            return Ok(());
        }
    }
}

/// Frames after the first open one among which the best is fitted: the hand may still be opening.
const CANDIDATES: usize = 12;
/// Overlap a fit must reach.
const LEAST_FIT: f64 = 0.80;

struct Run<'a> {
    options: &'a ClipOptions,
    sink: &'a mut dyn ClipSink,
    track: Duration,
    steps: Vec<Duration>,
}

/// A frame that waits for the fit.
struct Waiting {
    index: usize,
    time: f64,
    jpeg: Vec<u8>,
    silhouette: Result<Silhouette, VisionError>,
    open: Option<OpenHand>,
}

impl Waiting {
    fn image(&self) -> Result<RgbImage, ClipError> {
        from_jpeg(&self.jpeg).ok_or_else(|| ClipError::Sink("a kept picture is damaged".into()))
    }
}

impl Run<'_> {
    fn clip(&mut self, receiver: &Receiver<Segmented>, rate: Option<f64>) -> Result<TrackedClip, ClipError> {
        let waiting = self.wait_for_open_hand(receiver)?;
        let begun = Instant::now();
        let (at, start) = self.fit(&waiting)?;
        let mut tracker_options = self.options.tracker.clone();
        tracker_options.camera = Some(start.camera);
        let mut tracker = Tracker::new(&start.fit, tracker_options);
        self.track += begun.elapsed();
        self.sink.fitted(&start);
        // What was before the open hand is tracked backwards from it, and delivered in order of time.
        let mut before = Vec::with_capacity(at);
        for w in waiting[..at].iter().rev() {
            before.push(self.step(&mut tracker, &w.silhouette, &w.image()?, &start));
        }
        tracker.rewind();
        let mut frames = Vec::new();
        for w in waiting {
            let image = w.image()?;
            let tracked = match before.pop() {
                Some(tracked) => tracked,
                None => self.step(&mut tracker, &w.silhouette, &image, &start),
            };
            self.deliver(w.index, w.time, &image, &w.silhouette, &tracked, &mut tracker)?;
            frames.push((w.time, tracked));
        }
        while let Ok(Segmented { frame, silhouette }) = receiver.recv() {
            self.sink.read(frame.index);
            let tracked = self.step(&mut tracker, &silhouette, &frame.image, &start);
            self.deliver(frame.index, frame.time, &frame.image, &silhouette, &tracked, &mut tracker)?;
            frames.push((frame.time, tracked));
        }
        let frames_timed = FrameTimings { track: std::mem::take(&mut self.steps), ..FrameTimings::default() };
        let timings = ClipTimings { track: self.track, frames: frames_timed, ..ClipTimings::default() };
        Ok(TrackedClip { start, rate, frames, timings })
    }

    fn wait_for_open_hand(&mut self, receiver: &Receiver<Segmented>) -> Result<Vec<Waiting>, ClipError> {
        let mut waiting: Vec<Waiting> = Vec::new();
        let mut first_open = None;
        let mut nearest: Option<(usize, PartsError)> = None;
        let mut last_error = None;
        let mut limited = false;
        while let Ok(Segmented { frame, silhouette }) = receiver.recv() {
            self.sink.read(frame.index);
            let begun = Instant::now();
            let mut open = None;
            match &silhouette {
                Ok(s) => match find_parts(s) {
                    Ok(parts) => open = Some(open_hand(&parts)),
                    Err(reason) => {
                        if nearest.as_ref().is_none_or(|(_, r)| fingers_seen(&reason) > fingers_seen(r)) {
                            nearest = Some((frame.index, reason));
                        }
                    }
                },
                Err(error) => last_error = Some(error.clone()),
            }
            if open.is_some() && first_open.is_none() {
                first_open = Some(waiting.len());
            }
            let jpeg =
                to_jpeg(&frame.image).ok_or_else(|| ClipError::Sink("a picture could not be kept".into()))?;
            waiting.push(Waiting { index: frame.index, time: frame.time, jpeg, silhouette, open });
            self.track += begun.elapsed();
            if first_open.is_some_and(|k| waiting.len() >= k + CANDIDATES) {
                break;
            }
            if first_open.is_none() && waiting.len() >= self.options.max_lead_in.max(1) {
                limited = true;
                break;
            }
        }
        if first_open.is_some() {
            return Ok(waiting);
        }
        let frames = waiting.len();
        Err(match (nearest, last_error) {
            (Some((nearest, reason)), _) => ClipError::NeverOpen { frames, limited, nearest, reason },
            (None, Some(reason)) => ClipError::NoHand { frames, reason },
            (None, None) => ClipError::Empty,
        })
    }

    /// Fits the model to every candidate and keeps the best; gives its place in `waiting`.
    fn fit(&self, waiting: &[Waiting]) -> Result<(usize, ClipStart), ClipError> {
        let o = self.options;
        let length = o.person.as_ref().map_or(o.hand_length, |p| p.morphology.hand_length);
        let mut fit_options = FitOptions { hand_length: length, ..FitOptions::default() };
        let mut best: Option<(usize, Fit, View, bool, Camera)> = None;
        for (i, w) in waiting.iter().enumerate() {
            let (Some(open), Ok(silhouette)) = (&w.open, &w.silhouette) else { continue };
            let right = open.thumb_right();
            let (side, view, assumed) = View::settle(o.side, o.view, right);
            let camera = Camera::with_field_of_view(
                silhouette.hand.width(),
                silhouette.hand.height(),
                o.field_of_view,
            );
            fit_options.camera = Some(camera);
            let forearm = silhouette.wrist.as_ref().map(Forearm::from);
            let fit = fit_open_hand(&silhouette.hand, forearm, open, side, view, &fit_options);
            if let Some(fit) = fit
                && best.as_ref().is_none_or(|(_, b, ..)| fit.iou > b.iou)
            {
                best = Some((i, fit, view, assumed, camera));
            }
        }
        let (i, mut fit, view, assumed, camera) = best.ok_or(ClipError::Empty)?;
        let index = waiting[i].index;
        if fit.iou < LEAST_FIT {
            return Err(ClipError::BadFit { index, iou: fit.iou, least: LEAST_FIT });
        }
        if let Some(person) = &o.person {
            fit.morphology = person.morphology.clone();
        }
        Ok((i, ClipStart { frame: index, fit, view, assumed, camera }))
    }

    fn step(
        &mut self,
        tracker: &mut Tracker,
        silhouette: &Result<Silhouette, VisionError>,
        image: &RgbImage,
        start: &ClipStart,
    ) -> TrackedState {
        let begun = Instant::now();
        let tracked = match silhouette {
            Ok(s) => tracker.track(&s.hand, s.wrist.as_ref().map(Forearm::from), Some(image)),
            Err(_) => tracker.track(&Mask::new(start.camera.width, start.camera.height), None, None),
        };
        self.steps.push(begun.elapsed());
        self.track += begun.elapsed();
        tracked
    }

    fn deliver(
        &mut self,
        index: usize,
        time: f64,
        image: &RgbImage,
        silhouette: &Result<Silhouette, VisionError>,
        tracked: &TrackedState,
        tracker: &mut Tracker,
    ) -> Result<(), ClipError> {
        let frame = TrackedFrame {
            index,
            time,
            image,
            silhouette: silhouette.as_ref(),
            tracked,
            model: tracker.model_mut(),
        };
        self.sink.tracked(frame).map_err(ClipError::Sink)
    }
}

/// How many free fingers stood in the way of an open hand.
fn fingers_seen(reason: &PartsError) -> usize {
    match reason {
        PartsError::FingersClosed { found } | PartsError::FingersMissing { found } => *found,
        _ => 0,
    }
}

/// The fit's starting point in the parts that vision found.
fn open_hand(parts: &HandParts) -> OpenHand {
    OpenHand {
        wrist: [parts.wrist.0, parts.wrist.1],
        tips: std::array::from_fn(|i| [parts.fingers[i].tip.0, parts.fingers[i].tip.1]),
        directions: std::array::from_fn(|i| [parts.fingers[i].axis.0, parts.fingers[i].axis.1]),
        radii: std::array::from_fn(|i| parts.fingers[i].radius),
    }
}

fn to_jpeg(image: &RgbImage) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 88).encode_image(image).ok()?;
    Some(bytes)
}

fn from_jpeg(bytes: &[u8]) -> Option<RgbImage> {
    Some(image::load_from_memory_with_format(bytes, image::ImageFormat::Jpeg).ok()?.to_rgb8())
}
