//! A clip from its source to its poses: the stages on threads of their own.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use image::imageops::grayscale;

use super::clock::Instant;
use super::hands::not_yet;
use super::silhouettes::{Segmented, Silhouettes};
use super::stage::HandStage;
use super::{ClipError, ClipOptions, ClipSink, HandFrame, HandStart, StageTimes, TrackedFrame, header};
use handcast_hand::HandPose;
use handcast_hand::smooth::jitter;
use handcast_hand::{Absence, PoseHeader, TimedPose};
use handcast_media::{ClipInfo, Frame, FrameError, FrameSource, Prefetch};

/// Frames that may wait between two threads.
const AHEAD: usize = 4;

/// One hand through a clip.
#[derive(Clone, Debug)]
pub struct TrackedHand {
    /// How it was found.
    pub start: HandStart,
    /// All frames of the clip.
    pub frames: Vec<HandFrame>,
}

impl TrackedHand {
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

    /// Unsteadiness of the poses before and after smoothing, degrees: see [`handcast_hand::smooth::jitter`].
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
    pub hands: Vec<TrackedHand>,
    /// Presentation times of the frames, seconds.
    pub times: Vec<f64>,
    /// Frames per second, where known.
    pub rate: Option<f64>,
    /// Tone of the skin, 1 (lightest) to 10, where a hand was sure.
    pub skin_tone: Option<u8>,
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

/// Time each stage took for a frame, one entry a frame, in order of time. What is done once for a clip (learning
/// colours, the fit) is left out.
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
        header(self.hands.iter().map(|hand| &hand.start), self.rate, self.skin_tone)
    }

    /// All frames of all hands as poses in the camera frame, in order of time.
    pub fn poses(&self) -> Vec<TimedPose> {
        let mut poses = Vec::with_capacity(self.times.len() * self.hands.len());
        for (i, &time) in self.times.iter().enumerate() {
            poses.extend(self.hands.iter().filter_map(|h| h.frames.get(i)).map(|frame| frame.timed(time)));
        }
        poses
    }
}

/// Tracks the hands in `source`. `masks`, when given, delivers one ready mask for each frame (white is
/// hand) and takes the place of segmentation. Both are asked for pictures of the analysis size
/// ([`FrameSource::set_max_side`]).
///
/// Frames are decoded and segmented on threads of their own, ahead of the trackers. The poses are those that
/// [`Tracker`](super::Tracker) gives of the same pictures; of a hand that is found late there are also the frames
/// before, as [`Absence::NotYet`].
///
/// # Errors
/// See [`ClipError`]. A frame without a silhouette in the middle of the clip is no error: it is
/// reported as lost.
pub fn track_clip(
    mut source: impl FrameSource + 'static,
    mut masks: Option<Box<dyn FrameSource>>,
    options: &ClipOptions,
    sink: &mut dyn ClipSink,
) -> Result<TrackedClip, ClipError> {
    source.set_max_side(options.segment.max_side);
    if let Some(masks) = &mut masks {
        masks.set_max_side(options.segment.max_side);
    }
    let rate = source.info().rate;
    let clock = Arc::new(Mutex::new(Vec::new()));
    let frames = Prefetch::new(TimedSource { source, clock: clock.clone() }, AHEAD);
    let (sender, receiver) = sync_channel(AHEAD);
    std::thread::scope(|scope| {
        let silhouettes = Silhouettes::new(options);
        let worker = std::thread::Builder::new()
            .name("segment".to_owned())
            .spawn_scoped(scope, move || segment(frames, masks, silhouettes, &sender))
            .map_err(|_| ClipError::Thread)?;
        let mut stage = HandStage::new(options);
        let mut kept = Keeper { sink, times: Vec::new(), found: Vec::new(), spent: Vec::new() };
        let mut tracked = receiver.iter().try_for_each(|segmented| stage.push(segmented, &mut kept));
        if tracked.is_ok() {
            tracked = stage.finish(&mut kept);
        }
        // Lets the worker stop when the tracker has given up.
        drop(receiver);
        // A failure of the source explains whatever the tracker missed after it.
        let segment = worker.join().map_err(|_| ClipError::Thread)??;
        tracked?;
        let decode = clock.lock().map(|times| times.clone()).unwrap_or_default();
        let frames = FrameTimings {
            segment: kept.spent.iter().map(|s| s.segment).collect(),
            track: kept.spent.iter().map(|s| s.track).collect(),
            decode,
        };
        let timings =
            ClipTimings { decode: frames.decode.iter().sum(), segment, track: stage.time(), frames };
        let hands = stage.hands().into_iter().zip(kept.found);
        let hands = hands.map(|(start, frames)| TrackedHand { start, frames }).collect();
        Ok(TrackedClip { hands, times: kept.times, rate, skin_tone: stage.skin_tone(), timings })
    })
}

/// Why the first stage stops.
enum Stop {
    Failed(ClipError),
    /// Nobody listens any more.
    Unheard,
}

impl From<ClipError> for Stop {
    fn from(error: ClipError) -> Self {
        Self::Failed(error)
    }
}

/// Segments all frames, with their masks where there are some, and sends them on. Gives the time it took.
fn segment(
    mut frames: Prefetch,
    mut masks: Option<Box<dyn FrameSource>>,
    mut silhouettes: Silhouettes,
    sender: &SyncSender<Segmented>,
) -> Result<Duration, ClipError> {
    let send = |segmented| sender.send(segmented).map_err(|_| Stop::Unheard);
    let mut all = || -> Result<(), Stop> {
        while let Some(frame) = frames.next_frame().map_err(ClipError::from)? {
            let mask = masks.as_mut().map(|masks| mask_for(&frame, masks.as_mut())).transpose()?;
            silhouettes.push(frame, mask, send)?;
        }
        silhouettes.finish(send)
    };
    match all() {
        Ok(()) | Err(Stop::Unheard) => Ok(silhouettes.time()),
        Err(Stop::Failed(error)) => Err(error),
    }
}

fn mask_for(frame: &Frame, masks: &mut dyn FrameSource) -> Result<image::GrayImage, ClipError> {
    match masks.next_frame()? {
        Some(mask) => Ok(grayscale(&mask.image)),
        None => Err(ClipError::NoMask { masks: masks.info().format.clone(), index: frame.index }),
    }
}

/// A source that counts the time each frame takes.
struct TimedSource<S> {
    source: S,
    clock: Arc<Mutex<Vec<Duration>>>,
}

impl<S: FrameSource> FrameSource for TimedSource<S> {
    fn info(&self) -> &ClipInfo {
        self.source.info()
    }

    fn set_max_side(&mut self, side: u32) {
        self.source.set_max_side(side);
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let begun = Instant::now();
        let frame = self.source.next_frame();
        if let (Ok(Some(_)), Ok(mut times)) = (&frame, self.clock.lock()) {
            times.push(begun.elapsed());
        }
        frame
    }
}

/// Keeps what was found of each frame, and passes all on.
struct Keeper<'a> {
    sink: &'a mut dyn ClipSink,
    times: Vec<f64>,
    found: Vec<Vec<HandFrame>>,
    spent: Vec<StageTimes>,
}

impl ClipSink for Keeper<'_> {
    fn read(&mut self, index: usize) -> Result<(), String> {
        self.sink.read(index)
    }

    fn fitted(&mut self, start: &HandStart) {
        self.found.push(vec![not_yet(start); self.times.len()]);
        self.sink.fitted(start);
    }

    fn tracked(&mut self, frame: TrackedFrame<'_>) -> Result<(), String> {
        self.times.push(frame.time);
        self.spent.push(frame.spent);
        for (found, hand) in self.found.iter_mut().zip(&frame.hands) {
            found.push(hand.found.clone());
        }
        self.sink.tracked(frame)
    }
}
