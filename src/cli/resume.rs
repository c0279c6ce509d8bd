//! Going on where a run that was ended has stopped: its journal, and the frames that are still to be tracked.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use anyhow::{Context, bail};
use handcast_formats::atomic::AtomicFile;
use handcast_formats::poses::{PoseReader, write_lines};
use handcast_hand::{ClipHand, PoseClip, PoseHeader, Side};
use handcast_media::{ClipInfo, Frame, FrameError, FrameSource};

use super::common::{limits, read_input};

/// Seconds behind the first pose that are tracked again, for the colours and the side to be learnt anew.
const LEARNING: f64 = 4.0;
/// Seconds before the journal's end that are tracked again, for the tracker to find the hand.
const OVERLAP: f64 = 2.0;
/// Seconds before the journal's end from which on the poses are those tracked now.
const SETTLED: f64 = 0.5;
/// Seconds that are worth being left out: what is tracked without a gap is as without a stop.
const WORTH: f64 = 2.0;

/// Seconds before a frame at which none is.
const BETWEEN: f64 = 2e-4;

/// What stands in a journal between what it is of and how many seconds of the clip told which hands there are.
const FOUND: &str = ", hands found by second ";

/// What a journal's header says made it: the `work`, and the time of the newest frame read when its hands were found.
pub fn told(work: &str, found: f64) -> String {
    format!("{work}{FOUND}{found:.3}")
}

/// What a journal is of, and the seconds that are tracked again for its hands to be found as they were.
fn taken_apart(told: &str) -> (&str, Option<f64>) {
    match told.rsplit_once(FOUND) {
        Some((work, found)) => (work, found.parse().ok().filter(|found: &f64| found.is_finite())),
        None => (told, None),
    }
}

/// What is tracked now shows other hands than the journal.
#[derive(Debug, thiserror::Error)]
#[error(
    "--resume: the rest of the clip shows a {now} hand where {journal} has a {before} one: track it anew, without --resume, \
     and say with --hand and --view which hand it is"
)]
pub struct OtherHands {
    journal: String,
    before: &'static str,
    now: &'static str,
}

/// What a journal has, and from where on the clip is tracked.
pub struct Resumed {
    clip: PoseClip,
    /// Seconds up to which the clip's beginning is tracked again: all that told which hands there are.
    learned: f64,
    /// Seconds from which on it is tracked.
    from: f64,
    /// Seconds from which on poses are new.
    joint: f64,
}

impl Resumed {
    /// Reads a journal; its last line may be cut.
    pub fn read(journal: &Path) -> anyhow::Result<Self> {
        if !journal.exists() {
            bail!(
                "--resume: there is no {}, in which a run that was ended leaves its poses",
                journal.display()
            );
        }
        let bytes = read_input(journal, None)?;
        let whole = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
        let name = || journal.display().to_string();
        let reader = PoseReader::new(bytes.get(..whole).unwrap_or_default()).with_context(name)?;
        let mut clip = reader.into_clip_within(limits()).with_context(name)?;
        let end = clip.frames.iter().map(|pose| pose.time).fold(0.0, f64::max);
        let begin = clip.frames.iter().find(|pose| pose.valid).map_or(end, |pose| pose.time);
        // Between frames: times in files are rounded.
        let settled = clip.frames.iter().map(|pose| pose.time).find(|time| *time >= end - SETTLED);
        let joint = settled.map_or(0.0, |time| (time - BETWEEN).max(0.0));
        clip.frames.retain(|pose| pose.time < joint);
        // Poses before a hand opens are filled in backwards: they do not tell when it was found.
        let (_, found) = taken_apart(clip.header.made_by.as_deref().unwrap_or_default());
        let learned = found.unwrap_or(end).max(begin + LEARNING);
        let from = if end - OVERLAP < learned + WORTH { 0.0 } else { end - OVERLAP };
        Ok(Self { clip, learned, from, joint })
    }

    /// That the journal is of the same `work`: clip, options and version of the program.
    pub fn check(&self, work: &str, journal: &Path) -> anyhow::Result<()> {
        let (told, _) = taken_apart(self.clip.header.made_by.as_deref().unwrap_or("nothing"));
        if told != work {
            bail!(
                "--resume: {} is of another clip, or was made with other options or another version: it says “{told}”, this \
                 would be “{work}”",
                journal.display()
            );
        }
        Ok(())
    }

    /// Leaves the poses that are kept in the journal, whole.
    pub fn keep(&self, journal: &Path) -> anyhow::Result<()> {
        AtomicFile::write_all_to(journal, &write_lines(&self.clip)?).context("cannot write")
    }

    /// That the hands tracked now are those of the journal, or more: of it one may have gone, or one have come, not both.
    ///
    /// # Errors
    /// [`OtherHands`].
    pub fn check_hands(&self, now: &[Side], journal: &Path) -> Result<(), OtherHands> {
        let before = &self.clip.header;
        let gone = before.hands.iter().map(|hand| hand.side).find(|side| !now.contains(side));
        let come = now.iter().find(|side| before.hand(**side).is_none());
        match gone.zip(come) {
            Some((gone, come)) => Err(OtherHands {
                journal: journal.display().to_string(),
                before: gone.name(),
                now: come.name(),
            }),
            None => Ok(()),
        }
    }

    /// The hands of the journal.
    pub fn hands(&self) -> Vec<ClipHand> {
        self.clip.header.hands.clone()
    }

    /// Adds the journal's hands to a header that has them not.
    pub fn add_hands(&self, header: &mut PoseHeader) {
        let missing = self.clip.header.hands.iter().filter(|hand| header.hand(hand.side).is_none());
        let missing: Vec<_> = missing.cloned().collect();
        header.hands.extend(missing);
    }

    /// Seconds from which on poses are new.
    pub fn joint(&self) -> f64 {
        self.joint
    }

    /// The frames that are to be tracked.
    pub fn rest(&self, source: Box<dyn FrameSource>) -> Box<dyn FrameSource> {
        let mut info = source.info().clone();
        // How many there are is known of an even rate only.
        let left_out = info.rate.map(|rate| ((self.from - self.learned).max(0.0) * rate) as usize);
        info.frames = info.frames.zip(left_out).map(|(all, out)| all.saturating_sub(out));
        Box::new(Rest { source, info, learned: self.learned, from: self.from, index: 0 })
    }

    /// The poses of the journal, and behind them those tracked now.
    pub fn joined(self, mut tracked: PoseClip) -> PoseClip {
        tracked.frames.retain(|pose| pose.time >= self.joint);
        self.add_hands(&mut tracked.header);
        let mut frames = self.clip.frames;
        frames.append(&mut tracked.frames);
        PoseClip { header: tracked.header, frames }
    }
}

/// What is told of a clip while it is read: the time of the newest frame, seconds, and at its end what of it could not be
/// shown.
#[derive(Clone, Default)]
pub struct Newest {
    time: Arc<AtomicU64>,
    shortfall: Arc<OnceLock<String>>,
}

impl Newest {
    /// A clip whose frames set the time.
    pub fn watch(&self, source: Box<dyn FrameSource>) -> Box<dyn FrameSource> {
        Box::new(Watched { source, newest: self.clone() })
    }

    /// Seconds; 0 before the first frame.
    pub fn time(&self) -> f64 {
        f64::from_bits(self.time.load(Ordering::Relaxed))
    }

    /// What of the clip could not be shown, where it has been read to its end.
    pub fn shortfall(&self) -> Option<&str> {
        self.shortfall.get().map(String::as_str)
    }
}

/// A clip that tells how far it has been read.
struct Watched {
    source: Box<dyn FrameSource>,
    newest: Newest,
}

impl FrameSource for Watched {
    fn info(&self) -> &ClipInfo {
        self.source.info()
    }

    fn set_max_side(&mut self, side: u32) {
        self.source.set_max_side(side);
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let frame = self.source.next_frame()?;
        match &frame {
            Some(frame) => self.newest.time.store(frame.time.to_bits(), Ordering::Relaxed),
            None => {
                let shortfall = self.source.shortfall();
                shortfall.into_iter().for_each(|told| drop(self.newest.shortfall.set(told)));
            }
        }
        Ok(frame)
    }

    fn shortfall(&self) -> Option<String> {
        self.source.shortfall()
    }
}

/// A clip without the frames between its beginning and where tracking goes on.
struct Rest {
    source: Box<dyn FrameSource>,
    info: ClipInfo,
    learned: f64,
    from: f64,
    index: usize,
}

impl FrameSource for Rest {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn set_max_side(&mut self, side: u32) {
        self.source.set_max_side(side);
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        loop {
            let Some(frame) = self.source.next_frame()? else { return Ok(None) };
            if frame.time <= self.learned || frame.time >= self.from {
                let index = self.index;
                self.index += 1;
                return Ok(Some(Frame { index, ..frame }));
            }
        }
    }

    fn shortfall(&self) -> Option<String> {
        self.source.shortfall()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{HandPose, TimedPose};

    /// A journal of one right hand in twelve seconds.
    fn journal(told: &str) -> Resumed {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.partial.jsonl");
        let mut header = PoseHeader::one(Side::Right, None, Some(10.0));
        header.made_by = Some(told.to_owned());
        let pose = |i| TimedPose::new(f64::from(i) / 10.0, HandPose::neutral(Side::Right));
        let clip = PoseClip { header, frames: (0..=120).map(pose).collect() };
        std::fs::write(&path, write_lines(&clip).unwrap()).unwrap();
        let resumed = Resumed::read(&path).unwrap();
        resumed.check("a work", &path).unwrap();
        assert!(resumed.check("another", &path).is_err());
        resumed
    }

    #[test]
    fn what_told_the_hands_is_tracked_again() {
        let learned = |told: &str| journal(told).learned;
        assert_eq!(learned(&told("a work", 5.9)), 5.9);
        assert_eq!(learned(&told("a work", 0.5)), LEARNING);
        // Where nothing tells, all is.
        assert_eq!(learned("a work"), 12.0);
        // A short gap is none.
        assert_eq!([7.9, 8.1].map(|found| journal(&told("a work", found)).from), [10.0, 0.0]);
    }

    #[test]
    fn other_hands_are_not_joined() {
        let resumed = journal(&told("a work", 0.5));
        let check = |now: &[Side]| resumed.check_hands(now, Path::new("x.partial.jsonl"));
        for fine in [&[Side::Right][..], &[Side::Right, Side::Left], &[]] {
            assert!(check(fine).is_ok(), "{fine:?}");
        }
        let error = check(&[Side::Left]).unwrap_err().to_string();
        assert!(error.contains("a left hand where x.partial.jsonl has a right one"), "{error}");
    }
}
