//! How many fingers a tracker's poses stretch out, against what is known of a clip.
//!
//! Labels of a clip are a text file: a line `FIRST-LAST FINGERS` for each range of frames (from 0, the last
//! one included) in which so many fingers are clearly shown; `#` begins a comment. Frames in no range are not
//! counted.

use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};

use serde::Serialize;
use thiserror::Error;

use handcast_formats::lines::LineReader;

/// Most bytes in a line of labels.
const MAX_LINE_BYTES: usize = 4096;
/// Most ranges in a file.
pub const MAX_RANGES: usize = 100_000;

/// How often 0, 1, … 5 fingers were said.
pub type Said = [usize; 6];

/// Frames that show one number of fingers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CountRange {
    /// The first frame, from 0.
    pub first: usize,
    /// The last frame.
    pub last: usize,
    /// The fingers stretched out, 0 to 5.
    pub fingers: usize,
}

/// The ranges of a clip, in order of time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CountLabels(Vec<CountRange>);

/// Why labels could not be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LabelError {
    /// The file could not be opened or read.
    #[error("labels: {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A line is wrong.
    #[error("labels: {path}: line {line}: {what}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and what was allowed.
        what: String,
    },
}

impl CountLabels {
    /// Reads a file of labels.
    ///
    /// # Errors
    /// See [`LabelError`].
    pub fn read(path: &Path) -> Result<Self, LabelError> {
        read_labels(path, Self::parse)
    }

    /// Reads labels from their text.
    ///
    /// # Errors
    /// Number of the line, from 1, and what is wrong with it.
    pub fn parse(text: impl BufRead) -> Result<Self, (usize, String)> {
        let fingers = |word: &str| match word.parse::<u32>() {
            Ok(n) if n > 5 => Some(Err(format!("{n} fingers, allowed 0 to 5"))),
            Ok(n) => Some(Ok(n as usize)),
            Err(_) => None,
        };
        let ranges = parse_ranges(text, ("FIRST-LAST FINGERS", "120-150 3"), fingers)?;
        Ok(Self(
            ranges.into_iter().map(|(first, last, fingers)| CountRange { first, last, fingers }).collect(),
        ))
    }

    /// The ranges.
    pub fn ranges(&self) -> &[CountRange] {
        &self.0
    }

    /// Counts how often `said` (the number of fingers of a frame; `None` where nothing is said of it) is right.
    pub fn score(&self, said: impl Fn(usize) -> Option<usize>) -> CountReport {
        let score = |range: &CountRange| {
            let mut counts = Said::default();
            for fingers in (range.first..=range.last).filter_map(&said) {
                counts[fingers.min(5)] += 1;
            }
            let frames = range.last - range.first + 1;
            RangeCounts {
                first: range.first,
                last: range.last,
                fingers: range.fingers,
                frames,
                missed: frames - counts.iter().sum::<usize>(),
                right: counts[range.fingers],
                said: counts,
            }
        };
        let ranges: Vec<_> = self.0.iter().map(score).collect();
        let sum = |of: fn(&RangeCounts) -> usize| ranges.iter().map(of).sum();
        let [frames, missed, right] = [sum(|r| r.frames), sum(|r| r.missed), sum(|r| r.right)];
        CountReport { frames, missed, right, share: share(right, frames), ranges }
    }
}

pub(super) fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

/// Labels of the file, which `parse` reads.
pub(super) fn read_labels<T>(
    path: &Path,
    parse: impl FnOnce(BufReader<File>) -> Result<T, (usize, String)>,
) -> Result<T, LabelError> {
    let file = File::open(path).map_err(|source| LabelError::Io { path: path.into(), source })?;
    parse(BufReader::new(file)).map_err(|(line, what)| LabelError::Line { path: path.into(), line, what })
}

/// First frames, last frames, and what they show.
pub(super) type Ranges<T> = Vec<(usize, usize, T)>;

/// Lines of ranges of frames and what they show, in order of time; `form` is what a line looks like, and an example.
/// `shown` reads what is shown: `None` where it is not of the form.
pub(super) fn parse_ranges<T>(
    text: impl BufRead,
    form: (&str, &str),
    shown: impl Fn(&str) -> Option<Result<T, String>>,
) -> Result<Ranges<T>, (usize, String)> {
    let mut lines = LineReader::new(text, MAX_LINE_BYTES);
    let mut ranges = Ranges::new();
    loop {
        let line = match lines.next_line() {
            Ok(Some(line)) => line.split('#').next().unwrap_or_default().trim(),
            Ok(None) => break,
            Err(e) => return Err((lines.number(), e.describe(MAX_LINE_BYTES))),
        };
        if line.is_empty() {
            continue;
        }
        let last = ranges.last().map(|(_, last, _)| *last);
        let range = parse_line(line, last, form, &shown).map_err(|what| (lines.number(), what))?;
        if ranges.len() == MAX_RANGES {
            return Err((lines.number(), format!("more than the {MAX_RANGES} ranges allowed")));
        }
        ranges.push(range);
    }
    match ranges.is_empty() {
        true => Err((1, format!("no ranges, expected lines such as {}", form.1))),
        false => Ok(ranges),
    }
}

fn parse_line<T>(
    line: &str,
    before: Option<usize>,
    (form, example): (&str, &str),
    shown: impl Fn(&str) -> Option<Result<T, String>>,
) -> Result<(usize, usize, T), String> {
    let wrong = || format!("{line:?}, expected {form} such as {example}");
    let mut words = line.split_whitespace();
    let (Some(frames), Some(word), None) = (words.next(), words.next(), words.next()) else {
        return Err(wrong());
    };
    let (first, last) = frames.split_once('-').unwrap_or((frames, frames));
    let number = |text: &str| text.parse::<u32>().map(|v| v as usize).map_err(|_| wrong());
    let (first, last, shown) = (number(first)?, number(last)?, shown(word).ok_or_else(wrong)?);
    if last < first {
        return Err(format!("the range ends at {last}, before its first frame {first}"));
    }
    if let Some(before) = before.filter(|before| first <= *before) {
        return Err(format!("begins at frame {first}, allowed is after {before}, as the ranges before it"));
    }
    Ok((first, last, shown?))
}

/// What was counted in the ranges of a clip.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CountReport {
    /// Frames in the ranges.
    pub frames: usize,
    /// Those of which nothing was said: none of them is right.
    pub missed: usize,
    /// Those with the right number.
    pub right: usize,
    /// Their share, 0 to 1; `None` without frames.
    pub share: Option<f64>,
    /// Range by range.
    pub ranges: Vec<RangeCounts>,
}

/// What was counted in one range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct RangeCounts {
    /// The first frame, from 0.
    pub first: usize,
    /// The last frame.
    pub last: usize,
    /// The fingers shown.
    pub fingers: usize,
    /// Frames in it.
    pub frames: usize,
    /// Those of which nothing was said.
    pub missed: usize,
    /// Those with the right number.
    pub right: usize,
    /// Frames by the number that was said.
    pub said: Said,
}

/// How often two observers of a clip say the same number of fingers.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CountAgreement {
    /// Frames that both looked at.
    pub frames: usize,
    /// Those in which they agree.
    pub alike: usize,
    /// Their share, 0 to 1; `None` without frames.
    pub share: Option<f64>,
    /// By the number the reference says, what the other said.
    pub by_reference: [Said; 6],
}

impl CountAgreement {
    /// From pairs of numbers, the reference's first, 0 to 5 each.
    pub fn of(pairs: impl Iterator<Item = (usize, usize)>) -> Self {
        let mut out = Self::default();
        for (reference, other) in pairs {
            out.frames += 1;
            out.alike += usize::from(reference == other);
            out.by_reference[reference.min(5)][other.min(5)] += 1;
        }
        out.share = share(out.alike, out.frames);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_and_scored() {
        let labels = CountLabels::parse(&b"# first round\n0-1 0\n\n7-9 1 # index\n 12 5\n"[..]).unwrap();
        assert_eq!(labels.ranges()[1], CountRange { first: 7, last: 9, fingers: 1 });
        let report = labels.score(|i| (i < 9).then_some(usize::from(i == 0) + usize::from(i == 7)));
        assert_eq!((report.frames, report.missed, report.right), (6, 2, 2));
        assert_eq!(report.share, Some(1.0 / 3.0));
        assert_eq!(report.ranges[0].said, [1, 1, 0, 0, 0, 0]);
        assert_eq!((report.ranges[1].missed, report.ranges[2].missed), (1, 1));
        assert_eq!(labels.score(|_| None).share, Some(0.0));
    }

    #[test]
    fn wrong_lines_are_named() {
        let wrong = |text: &str| CountLabels::parse(text.as_bytes()).unwrap_err();
        assert_eq!(wrong("").1, "no ranges, expected lines such as 120-150 3");
        for line in ["1-2", "a-2 3", "1-2 3 4", "-1 3", "1-2-3 3", "1-2 x", "99999999999-99999999999 1"] {
            let (number, what) = wrong(&format!("# x\n{line}"));
            assert_eq!(number, 2);
            assert!(what.contains("expected FIRST-LAST FINGERS"), "{line}: {what}");
        }
        assert_eq!(wrong("1-2 6"), (1, "6 fingers, allowed 0 to 5".into()));
        assert_eq!(wrong("5-2 1"), (1, "the range ends at 2, before its first frame 5".into()));
        let (number, what) = wrong("1-5 1\n5-6 2");
        assert_eq!(number, 2);
        assert!(what.contains("begins at frame 5, allowed is after 5"), "{what}");
    }

    #[test]
    fn agreement_is_counted_by_what_the_reference_says() {
        let both = CountAgreement::of([(1, 1), (1, 2), (5, 5), (5, 5)].into_iter());
        assert_eq!((both.frames, both.alike, both.share), (4, 3, Some(0.75)));
        assert_eq!((both.by_reference[1], both.by_reference[5][5]), ([0, 1, 1, 0, 0, 0], 2));
    }
}
