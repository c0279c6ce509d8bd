//! A clip from its source to its poses: the stages on threads of their own.

use std::sync::mpsc::{Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use image::imageops::grayscale;

use super::clock::Instant;
use super::silhouettes::{Search, Seeker, Segmented, Silhouettes};
use super::stage::HandStage;
use super::{ClipError, ClipOptions, ClipSink, HandFrame, HandStart, StageTimes, TrackedFrame, header};
use crate::View;
use handcast_hand::{PoseHeader, TimedPose};
use handcast_limits::{Excess, Limit, Limits};
use handcast_media::{ClipInfo, Frame, FrameError, FrameSource, Prefetch};
use handcast_vision::Segmenter;

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
    /// What of the clip could not be shown ([`FrameSource::shortfall`]).
    pub shortfall: Option<String>,
    /// Most hands that a finder saw in a frame beside the two that are tracked at most.
    pub further: usize,
    /// Time spent in each stage.
    pub timings: ClipTimings,
}

/// What is known of a clip at its end, besides its frames.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ClipEnd {
    /// The hands, in the order in which they were found.
    pub hands: Vec<HandStart>,
    /// Frames per second, where known.
    pub rate: Option<f64>,
    /// Tone of the skin, 1 (lightest) to 10, where a hand was sure.
    pub skin_tone: Option<u8>,
    /// What of the clip could not be shown ([`FrameSource::shortfall`]).
    pub shortfall: Option<String>,
    /// Most hands that a finder saw in a frame beside the two that are tracked at most.
    pub further: usize,
    /// Time spent in each stage; of single frames nothing.
    pub timings: ClipTimings,
}

impl ClipEnd {
    /// The header of a pose file for the poses of the clip.
    pub fn header(&self) -> PoseHeader {
        header(&self.hands, self.rate, self.skin_tone)
    }

    /// What is worth saying of its hands, where they are said to show this face.
    pub fn notices(&self, view: Option<View>) -> Vec<String> {
        notices(&self.hands, view, self.further)
    }
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

    /// What is worth saying of its hands, where they are said to show this face.
    pub fn notices(&self, view: Option<View>) -> Vec<String> {
        notices(self.hands.iter().map(|hand| &hand.start), view, self.further)
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

fn notices<'a>(
    hands: impl IntoIterator<Item = &'a HandStart>,
    view: Option<View>,
    further: usize,
) -> Vec<String> {
    let s = if further > 1 { "s" } else { "" };
    let further = (further > 0).then(|| {
        format!(
            "at least {further} further hand{s} are seen beside the two that are tracked at most, and passed over"
        )
    });
    let hands = hands.into_iter();
    let others = hands.filter_map(|hand| Some((view.filter(|view| *view != hand.view)?, hand)));
    let others = others.map(|(view, hand)| {
        format!(
            "--view says {}, but thumb and fingers of the {} hand show its {}: that is what is tracked",
            view.name(),
            hand.side.name(),
            hand.view.name()
        )
    });
    further.into_iter().chain(others).collect()
}

/// That a clip is no longer than `limits` allow, where that is known before it is read.
///
/// # Errors
/// [`Excess`] of instants or seconds.
pub fn check_length(source: &(impl FrameSource + ?Sized), limits: &Limits) -> Result<(), Excess> {
    let Some(times) = source.times() else { return Ok(()) };
    let seconds = times.first().zip(times.last()).map_or(0.0, |(first, last)| last - first);
    check_extent(limits, times.len(), seconds)
}

/// That so many frames over so many seconds are allowed.
fn check_extent(limits: &Limits, frames: usize, seconds: f64) -> Result<(), Excess> {
    limits.check_count(Limit::Instants, frames)?;
    limits.check(Limit::Seconds, seconds)
}

/// Tracks the hands in `source`. `masks`, when given, delivers one ready mask for each frame (white is
/// hand) and takes the place of segmentation. Both are asked for pictures of the analysis size
/// ([`FrameSource::set_max_side`]).
///
/// Frames are decoded and segmented on threads of their own, ahead of the trackers. The poses are those that
/// [`Tracker`](super::Tracker) gives of the same pictures; of a hand that is found late there are also the frames
/// before, as [`Absence::NotYet`](handcast_hand::Absence::NotYet).
///
/// # Errors
/// See [`ClipError`]; of a clip longer than [`ClipOptions::limits`] before the work where it is known so early. A frame
/// without a silhouette in the middle of the clip is no error: it is reported as lost.
pub fn track_clip(
    source: impl FrameSource + 'static,
    masks: Option<Box<dyn FrameSource>>,
    options: &ClipOptions,
    sink: &mut dyn ClipSink,
) -> Result<TrackedClip, ClipError> {
    let clock = Clock { each: Some(Vec::new()), ..Clock::default() };
    let mut kept = Keeper { sink, times: Vec::new(), found: Vec::new(), spent: Vec::new() };
    let (end, clock) = track_on(source, masks, options, &mut kept, clock)?;
    let frames = FrameTimings {
        segment: kept.spent.iter().map(|s| s.segment).collect(),
        track: kept.spent.iter().map(|s| s.track).collect(),
        decode: clock.each.unwrap_or_default(),
    };
    let timings = ClipTimings { frames, ..end.timings };
    let hands = end.hands.into_iter().zip(kept.found);
    let hands = hands.map(|(start, frames)| TrackedHand { start, frames }).collect();
    let ClipEnd { rate, skin_tone, shortfall, further, .. } = end;
    Ok(TrackedClip { hands, times: kept.times, rate, skin_tone, shortfall, further, timings })
}

/// Tracks as [`track_clip`] does, and keeps nothing of the frames, which `sink` gets: memory does not grow with the
/// clip. Of a hand that is found late the frames before are [`HandStart::not_yet`].
///
/// # Errors
/// See [`track_clip`].
pub fn track_frames(
    source: impl FrameSource + 'static,
    masks: Option<Box<dyn FrameSource>>,
    options: &ClipOptions,
    sink: &mut dyn ClipSink,
) -> Result<ClipEnd, ClipError> {
    track_on(source, masks, options, sink, Clock::default()).map(|(end, _)| end)
}

fn track_on(
    mut source: impl FrameSource + 'static,
    mut masks: Option<Box<dyn FrameSource>>,
    options: &ClipOptions,
    sink: &mut dyn ClipSink,
    clock: Clock,
) -> Result<(ClipEnd, Clock), ClipError> {
    options.check()?;
    check_length(&source, &options.limits)?;
    source.set_max_side(options.segment.max_side);
    if let Some(masks) = &mut masks {
        masks.set_max_side(options.segment.max_side);
    }
    let rate = source.info().rate;
    let clock = Arc::new(Mutex::new(clock));
    let frames = Prefetch::new(TimedSource { source, clock: clock.clone() }, AHEAD);
    let (sender, receiver) = sync_channel(AHEAD);
    std::thread::scope(|scope| {
        let silhouettes = Silhouettes::new(options);
        let length = Length { limits: &options.limits, count: 0, first: 0.0 };
        let worker = std::thread::Builder::new()
            .name("segment".to_owned())
            .spawn_scoped(scope, move || segment(frames, masks, length, silhouettes, Remote(sender)))
            .map_err(|_| ClipError::Thread)?;
        let mut stage = HandStage::new(options);
        // A worker that does not listen to answers any more has failed, and says why.
        let mut tracked = receiver.iter().try_for_each(|message| match message {
            Message::Take(segmented) => stage.push(segmented, sink),
            Message::Search(last, answer) => answer.send(stage.search(last, sink)?).or(Ok(())),
            Message::SeekAgain(learnt, since, answer) => {
                answer.send(stage.seek_again(learnt, since)?).or(Ok(()))
            }
        });
        if tracked.is_ok() {
            tracked = stage.finish(sink);
        }
        // Lets the worker stop when the tracker has given up.
        drop(receiver);
        // A failure of the source explains whatever the tracker missed after it.
        let (segment, shortfall, further) = worker.join().map_err(|_| ClipError::Thread)??;
        tracked?;
        let clock = clock.lock().map(|mut clock| std::mem::take(&mut *clock)).unwrap_or_default();
        let timings =
            ClipTimings { decode: clock.sum, segment, track: stage.time(), frames: FrameTimings::default() };
        let end =
            ClipEnd { hands: stage.hands(), rate, skin_tone: stage.skin_tone(), shortfall, further, timings };
        Ok((end, clock))
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

/// What the first stage says to the second, which works on another thread.
enum Message {
    Take(Segmented),
    /// Whether this was the last frame.
    Search(bool, Sender<Search>),
    SeekAgain(Box<Segmenter>, usize, Sender<Option<Box<Segmenter>>>),
}

/// The second stage as the first sees it.
struct Remote(SyncSender<Message>);

impl Remote {
    fn send(&self, message: Message) -> Result<(), Stop> {
        self.0.send(message).map_err(|_| Stop::Unheard)
    }

    fn ask<T>(&self, question: impl FnOnce(Sender<T>) -> Message) -> Result<T, Stop> {
        let (sender, answer) = channel();
        self.send(question(sender))?;
        answer.recv().map_err(|_| Stop::Unheard)
    }
}

impl Seeker for Remote {
    type Error = Stop;

    fn take(&mut self, segmented: Segmented) -> Result<(), Stop> {
        self.send(Message::Take(segmented))
    }

    fn search(&mut self, last: bool) -> Result<Search, Stop> {
        self.ask(|answer| Message::Search(last, answer))
    }

    fn seek_again(&mut self, learnt: Box<Segmenter>, since: usize) -> Result<Option<Box<Segmenter>>, Stop> {
        self.ask(|answer| Message::SeekAgain(learnt, since, answer))
    }
}

/// Segments all frames, with their masks where there are some, and sends them on. Gives the time it took, what of the clip
/// could not be shown, and how many hands were seen beside those that are tracked.
fn segment(
    mut frames: Prefetch,
    mut masks: Option<Box<dyn FrameSource>>,
    mut length: Length<'_>,
    mut silhouettes: Silhouettes,
    mut next: Remote,
) -> Result<(Duration, Option<String>, usize), ClipError> {
    let mut all = || -> Result<(), Stop> {
        while let Some(frame) = frames.next_frame().map_err(ClipError::from)? {
            length.add(frame.time).map_err(ClipError::from)?;
            let mask = masks.as_mut().map(|masks| mask_for(&frame, masks.as_mut())).transpose()?;
            silhouettes.push(frame, mask, &mut next)?;
        }
        silhouettes.finish(&mut next)
    };
    match all() {
        Ok(()) | Err(Stop::Unheard) => Ok((silhouettes.time(), frames.shortfall(), silhouettes.further())),
        Err(Stop::Failed(error)) => Err(error),
    }
}

/// How long a clip is as far as it has been read.
struct Length<'a> {
    limits: &'a Limits,
    count: usize,
    /// Seconds at which its first frame is shown.
    first: f64,
}

impl Length<'_> {
    /// Counts a frame that is shown at so many seconds.
    fn add(&mut self, time: f64) -> Result<(), Excess> {
        self.first = if self.count == 0 { time } else { self.first };
        self.count += 1;
        check_extent(self.limits, self.count, time - self.first)
    }
}

/// The mask of a frame: of its number, where the clip has left out pictures or is a part.
fn mask_for(frame: &Frame, masks: &mut dyn FrameSource) -> Result<image::GrayImage, ClipError> {
    loop {
        match masks.next_frame()? {
            Some(mask) if mask.index < frame.index => {}
            Some(mask) if mask.index == frame.index => return Ok(grayscale(&mask.image)),
            _ => return Err(ClipError::NoMask { masks: masks.info().format.clone(), index: frame.index }),
        }
    }
}

/// Time that frames took.
#[derive(Default)]
struct Clock {
    sum: Duration,
    /// Each of them, where that is wanted.
    each: Option<Vec<Duration>>,
}

/// A source that counts the time its frames take.
struct TimedSource<S> {
    source: S,
    clock: Arc<Mutex<Clock>>,
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
        if let (Ok(Some(_)), Ok(mut clock)) = (&frame, self.clock.lock()) {
            let time = begun.elapsed();
            clock.sum += time;
            clock.each.iter_mut().for_each(|each| each.push(time));
        }
        frame
    }

    fn shortfall(&self) -> Option<String> {
        self.source.shortfall()
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
        self.found.push(vec![start.not_yet(); self.times.len()]);
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
