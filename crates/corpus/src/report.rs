//! What is worth looking at of a corpus, as facts.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use crate::corpus::{CorpusError, FAILURES, MANIFEST};
use crate::ledger::each;
use crate::line::{Entry, Failure, Kind};

/// How many clips a list has.
const LISTED: usize = 25;
/// How many kinds of failures and of notices, and names of each, are told.
const REASONS: usize = 25;
/// How many of them are in the text.
const TOLD: usize = 3;
/// How many names of files that are no inputs are in the text.
const OTHERS: usize = 5;

/// One run. The fields are keys of `report.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Run {
    /// Inputs found.
    pub inputs: u64,
    /// Other files in the input folder, and hidden files and folders.
    pub others: u64,
    /// The first names of them, in order.
    pub other_names: Vec<String>,
    /// Folders in which results of this program were passed over.
    pub results: u64,
    /// The first names of them, in order.
    pub result_names: Vec<String>,
    /// Inputs that had their stream before.
    pub before: u64,
    /// Inputs that had a stream that was made with other settings, or by another version, and were to be done anew.
    pub otherwise: u64,
    /// Inputs that had failed before, and were not tried again.
    pub failed_before: u64,
    /// Streams made.
    pub done: u64,
    /// Among them those of clips that were tracked; the others are of motions.
    pub done_clips: u64,
    /// Inputs that failed now.
    pub failed: u64,
    /// Seconds of motion in the streams made.
    pub done_seconds: f64,
    /// How many were worked on at a time; 0 where workers elsewhere did it.
    pub jobs: u64,
    /// How long it took.
    pub wall_seconds: f64,
}

impl Run {
    /// Clips tracked in an hour, neither motions nor failures counted; `None` where no clip was.
    pub fn clips_per_hour(&self) -> Option<f64> {
        (self.done_clips > 0).then(|| 3600.0 * self.done_clips as f64 / self.wall_seconds.max(1e-9))
    }
}

/// Shares of a value's range, and what lies outside.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Histogram {
    /// Upper end of the range; it begins at 0.
    pub to: f64,
    /// Clips in each share; the last has those beyond, too.
    pub counts: Vec<u64>,
}

impl Histogram {
    fn new(to: f64, parts: usize) -> Self {
        Self { to, counts: vec![0; parts] }
    }

    fn add(&mut self, value: f64) {
        let last = self.counts.len() - 1;
        let part = (value / self.to * self.counts.len() as f64).max(0.0) as usize;
        self.counts[part.min(last)] += 1;
    }
}

/// Inputs of which the same words tell something.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Said {
    /// The words, without the input's name: those of the first, where others have other numbers in them.
    pub words: String,
    /// How many.
    pub count: u64,
    /// The first names.
    pub names: Vec<String>,
}

/// A corpus: everything in the manifest and in the failures. The fields are the keys of `report.json`.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// Program and version.
    pub made_by: String,
    /// The input folder.
    pub input: String,
    /// [`Settings::digest`](crate::Settings::digest) of the last run.
    pub settings: String,
    /// Streams.
    pub clips: u64,
    /// Streams of clips that were tracked.
    pub tracked_clips: u64,
    /// Inputs without a stream.
    pub failures: u64,
    /// Seconds of all streams.
    pub seconds: f64,
    /// Bytes of all streams.
    pub bytes: u64,
    /// Bytes of all inputs that have a stream.
    pub input_bytes: u64,
    /// Kilobits per second of all streams.
    pub kbit_per_s: f64,
    /// Confidence on average over the seconds of clips that say one.
    pub confidence: Option<f64>,
    /// Streams that were made with other settings, or by another version, of inputs that are gone or were not asked for: they
    /// are left as they are, and counted in nothing else here.
    pub otherwise: u64,
    /// Streams of which there are notices.
    pub noticed: u64,
    /// The last run.
    pub run: Run,
    pub(crate) confidences: Histogram,
    pub(crate) rates: Histogram,
    /// Clips of the least confidence, or of which least was tracked.
    pub worst: Vec<Entry>,
    /// Streams of the highest rates.
    pub costliest: Vec<Entry>,
    pub(crate) reasons: Vec<Said>,
    pub(crate) notices: Vec<Said>,
}

/// The first of all by an order, without holding them all.
struct First {
    entries: Vec<Entry>,
    order: fn(&Entry, &Entry) -> Ordering,
}

impl First {
    fn add(&mut self, entry: &Entry) {
        let at = self.entries.partition_point(|other| (self.order)(other, entry).is_le());
        if at < LISTED {
            self.entries.truncate(LISTED - 1);
            self.entries.insert(at, entry.clone());
        }
    }
}

/// What is said of inputs, by its words.
#[derive(Default)]
struct Kinds(BTreeMap<String, Said>);

impl Kinds {
    fn add(&mut self, words: &str, name: &str) {
        let words = words.replace(&format!("{name}: "), "");
        // Numbers differ from clip to clip where what is said does not.
        let key: String = words.chars().filter(|c| !c.is_ascii_digit()).collect();
        if self.0.len() >= 10 * REASONS && !self.0.contains_key(&key) {
            return;
        }
        let said = self.0.entry(key).or_insert_with(|| Said { words, count: 0, names: Vec::new() });
        said.count += 1;
        if said.names.len() < REASONS {
            said.names.push(name.into());
        }
    }

    /// The most frequent ones.
    fn most(self) -> Vec<Said> {
        let mut all: Vec<Said> = self.0.into_values().collect();
        all.sort_by_key(|said| std::cmp::Reverse(said.count));
        all.truncate(REASONS);
        all
    }
}

/// Confidence, less where the hand was not seen throughout.
fn worth(entry: &Entry) -> f64 {
    entry.confidence.unwrap_or(1.0) * entry.tracked
}

impl Report {
    /// Reads what the output folder has.
    pub(crate) fn of(input: &Path, output: &Path, settings: &str, run: &Run) -> Result<Self, CorpusError> {
        let mut report = Self {
            made_by: crate::MADE_BY.into(),
            input: input.display().to_string(),
            settings: settings.into(),
            clips: 0,
            tracked_clips: 0,
            failures: 0,
            seconds: 0.0,
            bytes: 0,
            input_bytes: 0,
            kbit_per_s: 0.0,
            confidence: None,
            otherwise: 0,
            noticed: 0,
            run: run.clone(),
            confidences: Histogram::new(1.0, 20),
            rates: Histogram::new(8.0, 16),
            worst: Vec::new(),
            costliest: Vec::new(),
            reasons: Vec::new(),
            notices: Vec::new(),
        };
        let mut worst = First { entries: Vec::new(), order: |a, b| worth(a).total_cmp(&worth(b)) };
        let mut costliest =
            First { entries: Vec::new(), order: |a, b| b.kbit_per_s.total_cmp(&a.kbit_per_s) };
        let (mut sum, mut over) = (0.0, 0.0);
        let (mut reasons, mut notices) = (Kinds::default(), Kinds::default());
        each(&output.join(MANIFEST), |entry: Entry| {
            if entry.settings != settings || entry.made_by != crate::MADE_BY {
                report.otherwise += 1;
                return;
            }
            report.noticed += u64::from(!entry.notices.is_empty());
            entry.notices.iter().for_each(|notice| notices.add(notice, &entry.name));
            report.clips += 1;
            report.tracked_clips += u64::from(entry.kind == Kind::Clip);
            report.seconds += entry.seconds;
            report.bytes += entry.bytes;
            report.input_bytes += entry.input_bytes;
            report.rates.add(entry.kbit_per_s);
            if let Some(confidence) = entry.confidence {
                report.confidences.add(confidence);
                sum += confidence * entry.seconds;
                over += entry.seconds;
            }
            if entry.confidence.is_some() || entry.tracked < 1.0 {
                worst.add(&entry);
            }
            costliest.add(&entry);
        })?;
        each(&output.join(FAILURES), |failure: Failure| {
            report.failures += 1;
            reasons.add(&failure.error, &failure.name);
        })?;
        report.kbit_per_s =
            if report.seconds > 0.0 { report.bytes as f64 * 8e-3 / report.seconds } else { 0.0 };
        report.confidence = (over > 0.0).then(|| sum / over);
        report.worst = worst.entries;
        report.costliest = costliest.entries;
        report.reasons = reasons.most();
        report.notices = notices.most();
        Ok(report)
    }
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let run = &self.run;
        let Run { inputs, done, failed, before, failed_before, .. } = run;
        writeln!(
            f,
            "{}: {inputs} inputs; {done} done, {failed} failed, {before} done before, {failed_before} failed before{}",
            self.input,
            if *failed_before > 0 { ", which --retry tries again" } else { "" }
        )?;
        if done + failed > 0 {
            let speed = run.clips_per_hour().map_or_else(|| "–".to_owned(), |clips| format!("{clips:.0}"));
            writeln!(f, "  speed       {:.1} s, {speed} clips an hour", run.wall_seconds)?;
        }
        let named = |count: u64, names: &[String]| {
            let more = if count > OTHERS as u64 { " …" } else { "" };
            format!("{}{more}", names.iter().take(OTHERS).map(String::as_str).collect::<Vec<_>>().join(", "))
        };
        if run.others > 0 {
            let names = named(run.others, &run.other_names);
            writeln!(f, "  passed over {} that are neither clip nor motion: {names}", run.others)?;
        }
        if run.results > 0 {
            let (s, names) = (if run.results > 1 { "s" } else { "" }, named(run.results, &run.result_names));
            writeln!(f, "  passed over results of this program in {} folder{s}: {names}", run.results)?;
        }
        writeln!(
            f,
            "  streams     {} of {}, {} bytes, {:.2} kbit/s; the inputs have {} bytes",
            self.clips,
            crate::page::length(self.seconds),
            self.bytes,
            self.kbit_per_s,
            self.input_bytes
        )?;
        if self.otherwise > 0 {
            writeln!(
                f,
                "  left        {} made with other settings, of inputs that are gone or not asked for; not counted above",
                self.otherwise
            )?;
        }
        if let Some(confidence) = self.confidence {
            writeln!(f, "  sure        confidence {confidence:.2} on average")?;
        }
        for reason in self.reasons.iter().take(TOLD) {
            let first = reason.names.first().map_or("", String::as_str);
            match reason.count {
                1 => writeln!(f, "  failed      {first}: {}", reason.words)?,
                count => writeln!(f, "  failed      {count}, the first {first}: {}", reason.words)?,
            }
        }
        let told: u64 = self.reasons.iter().take(TOLD).map(|reason| reason.count).sum();
        let more = self.failures.saturating_sub(told);
        if more > 0 {
            writeln!(f, "  failed      {more} more for other reasons, which report.json tells")?;
        }
        if self.noticed > 0 {
            writeln!(
                f,
                "  notices     of {} of the streams: see report.html, or \"notices\" in the lines of manifest.jsonl",
                self.noticed
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_tracked_clips_count_in_clips_an_hour() {
        let run = Run { done: 3, failed: 5, wall_seconds: 3600.0, ..Run::default() };
        assert_eq!(run.clips_per_hour(), None);
        assert_eq!(Run { done_clips: 2, ..run }.clips_per_hour(), Some(2.0));
    }

    #[test]
    fn values_fall_into_their_shares() {
        let mut histogram = Histogram::new(2.0, 4);
        [0.0, 0.49, 0.5, 1.99, 2.0, 99.0, -1.0].into_iter().for_each(|value| histogram.add(value));
        assert_eq!(histogram.counts, [3, 1, 0, 3]);
    }
}
