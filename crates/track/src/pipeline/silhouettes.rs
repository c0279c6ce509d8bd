//! From frames to silhouettes, on threads of their own.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use image::RgbImage;
use image::imageops::{flip_horizontal_in_place, grayscale};

use super::{ClipError, ClipOptions};
use handcast_media::{ClipInfo, Frame, FrameError, FrameSource, Prefetch};
use handcast_vision::{Segmenter, Silhouette, VisionError};

/// Time spent decoding and segmenting.
#[derive(Default)]
pub(super) struct Clocks {
    pub(super) decode: Arc<Clock>,
    pub(super) segment: Clock,
}

/// Time spent in a stage.
#[derive(Default)]
pub(super) struct Clock {
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

    /// All of it, and that of single frames.
    pub(super) fn read(&self) -> (Duration, Vec<Duration>) {
        let frames = self.frames.lock().map(|frames| frames.clone()).unwrap_or_default();
        (Duration::from_nanos(self.total.load(Ordering::Relaxed)), frames)
    }
}

/// Decodes `source` ahead, mirrored if asked for.
pub(super) fn ahead(
    source: impl FrameSource + 'static,
    mirror: bool,
    clocks: &Clocks,
) -> Result<Prefetch, FrameError> {
    Prefetch::new(TimedSource { source, mirror, clock: clocks.decode.clone() }, 4)
}

/// A source that mirrors its pictures, if asked for, and counts the time it takes.
struct TimedSource<S> {
    source: S,
    mirror: bool,
    clock: Arc<Clock>,
}

impl<S: FrameSource> FrameSource for TimedSource<S> {
    fn info(&self) -> &ClipInfo {
        self.source.info()
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let start = Instant::now();
        let mut frame = self.source.next_frame();
        if let (true, Ok(Some(frame))) = (self.mirror, &mut frame) {
            flip_horizontal_in_place(&mut frame.image);
        }
        if matches!(frame, Ok(Some(_))) {
            self.clock.charge_frame(start);
        }
        frame
    }
}

/// A frame and the silhouettes in it.
pub(super) struct Segmented {
    pub(super) frame: Frame,
    /// Parts that may be hands, largest first; never empty.
    pub(super) parts: Result<Vec<Silhouette>, VisionError>,
}

/// Sends every frame with its silhouettes: those of the masks where there are some, else those of skin, whose
/// colours are learnt from the first frames.
pub(super) fn segment_all(
    frames: Prefetch,
    masks: Option<Box<dyn FrameSource>>,
    options: &ClipOptions,
    clock: &Clock,
    sender: &SyncSender<Segmented>,
) -> Result<(), ClipError> {
    match masks {
        Some(masks) => with_masks(frames, masks, options, clock, sender),
        None => by_colour(frames, options, clock, sender),
    }
}

fn with_masks(
    mut frames: Prefetch,
    mut masks: Box<dyn FrameSource>,
    options: &ClipOptions,
    clock: &Clock,
    sender: &SyncSender<Segmented>,
) -> Result<(), ClipError> {
    while let Some(frame) = frames.next_frame()? {
        let index = frame.index;
        let wrong = |what| ClipError::Mask { path: masks.info().format.clone(), what };
        let missing = wrong(format!("there is no mask for frame {index}"));
        let shape = wrong(format!("mask {index} has another shape than the frame"));
        let mask = masks.next_frame()?.ok_or(missing)?;
        let start = Instant::now();
        let mut gray = grayscale(&mask.image);
        if options.mirror {
            flip_horizontal_in_place(&mut gray);
        }
        let parts = Silhouette::all_from_gray(&gray, &options.segment);
        clock.charge_frame(start);
        let size = frame.image.dimensions();
        if parts.iter().flatten().any(|s| (s.hand.width(), s.hand.height()) != size) {
            return Err(shape);
        }
        if sender.send(Segmented { frame, parts }).is_err() {
            break;
        }
    }
    Ok(())
}

fn by_colour(
    mut frames: Prefetch,
    options: &ClipOptions,
    clock: &Clock,
    sender: &SyncSender<Segmented>,
) -> Result<(), ClipError> {
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
    let mut segmenter = Segmenter::learn(&samples, options.segment)
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
        let parts = segmenter.segment_all(&frame.image);
        clock.charge_frame(start);
        if sender.send(Segmented { frame, parts }).is_err() {
            return Ok(());
        }
    }
}
