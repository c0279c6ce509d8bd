//! Frames in, poses out.

use image::GrayImage;

use super::silhouettes::{Search, Seeker, Segmented, Silhouettes};
use super::stage::HandStage;
use super::{ClipError, ClipOptions, ClipSink, HandStart, StageTimes, TrackedFrame, header};
use handcast_hand::{PoseHeader, TimedPose};
use handcast_media::Frame;
use handcast_vision::Segmenter;

/// Tracks the hands in frames that are pushed into it one by one.
///
/// Poses come late where they must: the colours of skin are learnt from the first
/// [`ClipOptions::learning_frames`] frames, anew every so many while no hand is found, and a hand is tracked once it has
/// been seen open, from there back to the first frame and forwards; where a finder looks for hands these frames are the newest ones
/// until it has seen one; of one hand of which neither side nor view is told up to
/// [`ContestTuning::undecided`](super::ContestTuning::undecided) frames more are waited for, to see which it is. After
/// that each frame gives its poses at once. Frames are kept only until then, at most [`ClipOptions::max_lead_in`] of
/// them before the hand opens; however many come, nothing else grows. All work is done in the calls, on the thread
/// that makes them; only two hands are tracked side by side, where [`ClipOptions::threads`] allows.
///
/// Frames may have any size, all the same: they are shrunk to the analysis size
/// ([`SegmentOptions::max_side`](handcast_vision::SegmentOptions::max_side)) by area averaging.
/// [`track_clip`](super::track_clip) gives the same poses of the same pictures; sources that decode YCbCr average it
/// before they convert it, which gives slightly other pictures than pushing theirs in full size.
///
/// ```no_run
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use handcast_media::{FrameSource, OpenOptions, open};
/// use handcast_track::pipeline::{ClipOptions, Tracker};
///
/// let mut source = open("clip.mp4", &OpenOptions::default())?;
/// let mut tracker = Tracker::new(ClipOptions::default());
/// while let Some(frame) = source.next_frame()? {
///     for pose in tracker.push(frame)? {
///         println!("{:.3} s: {:?}", pose.time, pose.pose.translation);
///     }
/// }
/// let rest = tracker.finish()?;
/// # Ok(())
/// # }
/// ```
pub struct Tracker {
    silhouettes: Silhouettes,
    hands: HandStage,
    /// Finished, or failed.
    ended: bool,
}

impl Tracker {
    /// A tracker that has seen nothing.
    pub fn new(options: ClipOptions) -> Self {
        Self { silhouettes: Silhouettes::new(&options), hands: HandStage::new(&options), ended: false }
    }

    /// Takes the next frame; gives the poses that are known now, in order of time, those of one frame in the order
    /// of [`Tracker::hands`]. Frames are numbered as they come, whatever their `index`.
    ///
    /// # Errors
    /// See [`ClipError`]. A frame of another size than those before, or whose time is none or goes back, is not taken;
    /// after another error nothing more can be pushed.
    pub fn push(&mut self, frame: Frame) -> Result<Vec<TimedPose>, ClipError> {
        let mut poses = Poses::default();
        self.push_to(frame, None, &mut poses)?;
        Ok(poses.0)
    }

    /// As [`Tracker::push`], of a frame whose silhouette is ready: white (128 and above) is hand, with or without
    /// forearm. All frames have a mask or none has; masks have the shape of the frames.
    ///
    /// # Errors
    /// Those of [`Tracker::push`].
    pub fn push_with_mask(&mut self, frame: Frame, mask: GrayImage) -> Result<Vec<TimedPose>, ClipError> {
        let mut poses = Poses::default();
        self.push_to(frame, Some(mask), &mut poses)?;
        Ok(poses.0)
    }

    /// As [`Tracker::push`] and, with a mask, [`Tracker::push_with_mask`]; `sink` gets all there is to know of the
    /// frames whose poses are known now, as soon as they are.
    ///
    /// # Errors
    /// Those of [`Tracker::push`], and [`ClipError::Sink`].
    pub fn push_to(
        &mut self,
        frame: Frame,
        mask: Option<GrayImage>,
        sink: &mut dyn ClipSink,
    ) -> Result<(), ClipError> {
        if !self.ended {
            self.hands.options().check()?;
            self.silhouettes.check(&frame)?;
        }
        let (silhouettes, hands) = self.begin()?;
        silhouettes.push(frame, mask, &mut Direct { hands, sink })?;
        self.ended = false;
        Ok(())
    }

    /// No more frames come: gives the poses that are left. A clip that is shorter than what the tracker waits for is
    /// tracked here.
    ///
    /// # Errors
    /// See [`ClipError`]: that there was no hand is often known only now.
    pub fn finish(&mut self) -> Result<Vec<TimedPose>, ClipError> {
        let mut poses = Poses::default();
        self.finish_to(&mut poses)?;
        Ok(poses.0)
    }

    /// As [`Tracker::finish`] for a sink.
    ///
    /// # Errors
    /// Those of [`Tracker::finish`], and [`ClipError::Sink`].
    pub fn finish_to(&mut self, sink: &mut dyn ClipSink) -> Result<(), ClipError> {
        let (silhouettes, hands) = self.begin()?;
        silhouettes.finish(&mut Direct { hands: &mut *hands, sink: &mut *sink })?;
        hands.finish(sink)
    }

    /// The stages, for work after which the tracker has ended unless it is said otherwise.
    fn begin(&mut self) -> Result<(&mut Silhouettes, &mut HandStage), ClipError> {
        if std::mem::replace(&mut self.ended, true) {
            return Err(ClipError::Ended);
        }
        Ok((&mut self.silhouettes, &mut self.hands))
    }

    /// The hands found so far, one, or left and right, with their sizes as refined so far. The second may come
    /// late: poses of it then begin there.
    pub fn hands(&self) -> Vec<HandStart> {
        self.hands.hands()
    }

    /// The header of a pose file of the hands found so far, for frames at `rate` per second.
    pub fn header(&self, rate: Option<f64>) -> PoseHeader {
        header(&self.hands(), rate, self.hands.skin_tone())
    }

    /// Time spent so far.
    pub fn times(&self) -> StageTimes {
        StageTimes { segment: self.silhouettes.time(), track: self.hands.time() }
    }
}

/// The second stage on the same thread.
struct Direct<'a> {
    hands: &'a mut HandStage,
    sink: &'a mut dyn ClipSink,
}

impl Seeker for Direct<'_> {
    type Error = ClipError;

    fn take(&mut self, segmented: Segmented) -> Result<(), ClipError> {
        self.hands.push(segmented, self.sink)
    }

    fn search(&mut self, last: bool) -> Result<Search, ClipError> {
        self.hands.search(last, self.sink)
    }

    fn seek_again(
        &mut self,
        learnt: Box<Segmenter>,
        since: usize,
    ) -> Result<Option<Box<Segmenter>>, ClipError> {
        self.hands.seek_again(learnt, since)
    }
}

/// Keeps the poses.
#[derive(Default)]
struct Poses(Vec<TimedPose>);

impl ClipSink for Poses {
    fn tracked(&mut self, frame: TrackedFrame<'_>) -> Result<(), String> {
        self.0.extend(frame.hands.iter().map(|hand| hand.found.timed(frame.time)));
        Ok(())
    }
}
