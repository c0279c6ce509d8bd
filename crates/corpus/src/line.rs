//! Lines of the manifest and of the failures.

use handcast_fba::plan::PlanReport;
use handcast_hand::{PoseClip, Side, TimedPose};
use serde::{Deserialize, Serialize};

use crate::inputs::Item;

/// What an input is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Pictures, tracked and encoded.
    Clip,
    /// A motion, encoded.
    Motion,
}

/// A stream: a line of `manifest.jsonl`. The same input, settings and version give the same line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The input's path below the input folder, with `/`.
    pub name: String,
    /// SHA-256 of the input.
    pub sha256: String,
    /// Bytes of the input.
    pub input_bytes: u64,
    /// When the input was last changed, nanoseconds since 1970.
    pub modified: i64,
    /// Whether the input was tracked.
    pub kind: Kind,
    /// The stream's path below the output folder.
    pub stream: String,
    /// Bytes of the stream.
    pub bytes: u64,
    /// SHA-256 of the stream.
    pub stream_sha256: String,
    /// Length of the stream.
    pub seconds: f64,
    /// Frames per second of the stream.
    pub rate: f64,
    /// Kilobits per second of the stream.
    pub kbit_per_s: f64,
    /// `left`, `right` or `both`.
    pub side: String,
    /// Share of the poses that are of a hand seen, 0 to 1.
    pub tracked: f64,
    /// Confidence of these poses on average, 0 to 1; none where the input says none.
    pub confidence: Option<f64>,
    /// Overlap of model and silhouette on average, 0 to 1; none of motions.
    pub overlap: Option<f64>,
    /// Coding error of the angles that are ever other than 0, degrees.
    pub rms_deg: f64,
    /// Largest coding error of an angle, degrees.
    pub max_deg: f64,
    /// What of the clip could not be shown, as it is damaged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shortfall: Option<String>,
    /// What is worth knowing of how it was read, tracked and encoded, `shortfall` included: a line each.
    #[serde(default)]
    pub notices: Vec<String>,
    /// Program and version.
    pub made_by: String,
    /// [`Settings::digest`](crate::Settings::digest); `settings/DIGEST.json` has them.
    pub settings: String,
}

/// An input without a stream: a line of `failures.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// See [`Entry::name`].
    pub name: String,
    /// SHA-256 of the input, if it could be read.
    pub sha256: Option<String>,
    /// Bytes of the input.
    pub input_bytes: u64,
    /// See [`Entry::modified`].
    pub modified: i64,
    /// What was wrong, on one line.
    pub error: String,
    /// Program and version.
    pub made_by: String,
    /// See [`Entry::settings`].
    pub settings: String,
}

/// What became of an input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// There is a stream.
    Done(Box<Entry>),
    /// There is none.
    Failed(Box<Failure>),
}

impl Outcome {
    /// Whether there is a stream.
    pub fn is_done(&self) -> bool {
        matches!(self, Self::Done(_))
    }

    /// The input's name.
    pub fn name(&self) -> &str {
        match self {
            Self::Done(entry) => &entry.name,
            Self::Failed(failure) => &failure.name,
        }
    }

    /// The failure of an input on which whoever worked on it has died or given up.
    pub fn given_up(item: &Item, settings: &str, error: &str) -> Self {
        Self::Failed(Box::new(Failure {
            name: item.name.clone(),
            sha256: None,
            input_bytes: item.bytes,
            modified: item.modified,
            error: one_line(error),
            made_by: crate::MADE_BY.into(),
            settings: settings.into(),
        }))
    }
}

/// Most characters of an error in a line.
const LONGEST: usize = 600;

/// An error as a line has it.
pub(crate) fn one_line(error: &str) -> String {
    let words: Vec<&str> = error.split_whitespace().collect();
    words.join(" ").chars().take(LONGEST).collect()
}

/// Most notices in a line.
const MOST: usize = 8;

/// Notices as a line has them.
fn lines_of(notices: &[String]) -> Vec<String> {
    let more = notices.len().saturating_sub(MOST);
    let more = (more > 0).then(|| format!("{more} more of these, which encode or track tell"));
    notices.iter().take(MOST).map(|notice| one_line(notice)).chain(more).collect()
}

/// A number with so many digits behind the point.
fn short(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    (value * scale).round() / scale
}

/// What lines tell of poses.
#[derive(Clone, Debug)]
pub(crate) struct Seen {
    side: &'static str,
    tracked: f64,
    confidence: Option<f64>,
    overlap: Option<f64>,
}

impl Seen {
    pub fn of(clip: &PoseClip) -> Self {
        let has = |side: Side| clip.of(side).next().is_some();
        let side = match (has(Side::Left), has(Side::Right)) {
            (true, true) => "both",
            (true, false) => Side::Left.name(),
            _ => Side::Right.name(),
        };
        let valid = || clip.frames.iter().filter(|frame| frame.valid);
        let mean = |of: &dyn Fn(&TimedPose) -> Option<f64>| {
            let (sum, count) = valid().filter_map(of).fold((0.0, 0u32), |(s, n), v| (s + v, n + 1));
            (count > 0).then(|| short(sum / f64::from(count), 4))
        };
        Self {
            side,
            tracked: short(valid().count() as f64 / clip.frames.len().max(1) as f64, 4),
            confidence: mean(&|frame| frame.confidence),
            overlap: mean(&|frame| frame.iou),
        }
    }
}

/// A stream that was made.
pub(crate) struct Made {
    pub kind: Kind,
    pub stream: Vec<u8>,
    pub rate: f64,
    pub report: PlanReport,
    pub seen: Seen,
    pub shortfall: Option<String>,
    pub notices: Vec<String>,
}

impl Made {
    /// The line of it.
    pub fn entry(
        &self,
        item: &Item,
        sha256: String,
        stream: String,
        digest: String,
        settings: &str,
    ) -> Entry {
        let Self { report, seen, .. } = self;
        Entry {
            name: item.name.clone(),
            sha256,
            input_bytes: item.bytes,
            modified: item.modified,
            kind: self.kind,
            stream,
            bytes: self.stream.len() as u64,
            stream_sha256: digest,
            seconds: short(report.seconds, 3),
            rate: short(self.rate, 4),
            kbit_per_s: short(report.kbit_per_s(), 3),
            side: seen.side.into(),
            tracked: seen.tracked,
            confidence: seen.confidence,
            overlap: seen.overlap,
            rms_deg: short(report.rms_degrees, 3),
            max_deg: short(report.max_degrees, 3),
            shortfall: self.shortfall.clone(),
            notices: lines_of(&self.notices),
            made_by: crate::MADE_BY.into(),
            settings: settings.into(),
        }
    }
}
