//! Going on where a run that was ended has stopped: its journal, and the frames that are still to be tracked.

use std::path::Path;

use anyhow::{Context, bail};
use handcast_formats::atomic::AtomicFile;
use handcast_formats::poses::{PoseReader, write_lines};
use handcast_hand::{ClipHand, Person, PoseClip, PoseHeader};
use handcast_media::{ClipInfo, Frame, FrameError, FrameSource};

use super::common::{limits, read_input};

/// Seconds behind the first pose that are tracked again, for the colours and the side to be learnt anew.
const LEARNING: f64 = 4.0;
/// Seconds before the journal's end that are tracked again, for the tracker to find the hand.
const OVERLAP: f64 = 2.0;
/// Seconds before the journal's end from which on the poses are those tracked now.
const SETTLED: f64 = 0.5;

/// Seconds before a frame at which none is.
const BETWEEN: f64 = 2e-4;

/// What a journal has, and from where on the clip is tracked.
pub struct Resumed {
    clip: PoseClip,
    /// Seconds up to which the clip's beginning is tracked again.
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
        Ok(Self { clip, learned: begin + LEARNING, from: end - OVERLAP, joint })
    }

    /// That the journal is of the same `work`: clip, options and version of the program.
    pub fn check(&self, work: &str, journal: &Path) -> anyhow::Result<()> {
        let told = self.clip.header.made_by.as_deref().unwrap_or("nothing");
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

    /// The person whose sizes the journal tells, where a hand begins behind what is tracked again. Those of others are
    /// measured anew, and better than when the journal's first lines were written.
    pub fn person(&self) -> Option<Person> {
        let begins = |hand: &ClipHand| self.clip.of(hand.side).find(|pose| pose.valid).map(|pose| pose.time);
        let late = self.clip.header.hands.iter().filter_map(begins).any(|begin| begin > self.learned);
        if late { self.clip.person() } else { None }
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
