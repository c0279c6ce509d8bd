//! What is done and what is to do: the output folder, held by one run at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use std::time::Instant;

use glob::Pattern;
use handcast_formats::atomic::{AtomicFile, claim};
use sha2::{Digest, Sha256};
use thiserror::Error;
use walkdir::WalkDir;

use crate::inputs::{Item, inputs};
use crate::ledger::Ledger;
use crate::line::{Entry, Failure, Kind, Outcome};
use crate::report::{Report, Run};
use crate::settings::{Settings, hex};
use crate::work::{STREAMS, Worker, stream_name};

/// Why a run cannot go on. What is wrong with a single input is an [`Outcome::Failed`] instead.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CorpusError {
    /// The input folder cannot be listed.
    #[error("{what}")]
    Input {
        /// The file or folder, and what is wrong.
        what: String,
    },
    /// The output folder cannot be written.
    #[error("{path}: {source}")]
    Output {
        /// The file or folder.
        path: String,
        /// The system's error.
        source: io::Error,
    },
    /// Another run works in the output folder.
    #[error("{path}: another run is at work in this folder")]
    Busy {
        /// The folder.
        path: String,
    },
    /// The manifest or the failures have a line that is none of theirs.
    #[error("{path}: line {number}: {what}")]
    Line {
        /// The file.
        path: String,
        /// The line's number, from 1.
        number: usize,
        /// What is wrong.
        what: String,
    },
}

pub(crate) const MANIFEST: &str = "manifest.jsonl";
pub(crate) const FAILURES: &str = "failures.jsonl";
pub(crate) const REPORT: &str = "report.json";
pub(crate) const PAGE: &str = "report.html";
pub(crate) const SETTINGS: &str = "settings";

/// Which inputs are done, of those there are.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct Choice {
    /// Inputs whose name fits one of these; all where there is none.
    pub only: Vec<Pattern>,
    /// Read all inputs and streams to see whether they have changed. Else inputs whose size and time are the same, and
    /// streams whose size is, count as they were.
    pub checksum: bool,
    /// Try inputs again that failed.
    pub retry: bool,
}

/// A run: holds the output folder, knows what is to do, and keeps its lines.
#[derive(Debug)]
pub struct Corpus {
    input: PathBuf,
    output: PathBuf,
    settings: String,
    todo: Vec<Item>,
    manifest: Ledger,
    failures: Ledger,
    /// Inputs with lines of streams that failed now.
    gone: BTreeSet<String>,
    run: Run,
    begun: Instant,
    /// Held until the run has ended, in whatever way.
    _lock: File,
}

impl Corpus {
    /// Makes the output folder or goes on with it, and looks at the inputs. Streams that are to be made anew, and their
    /// lines, stay until they are or fail.
    ///
    /// # Errors
    /// See [`CorpusError`].
    pub fn open(
        input: &Path,
        output: &Path,
        settings: &Settings,
        choice: &Choice,
    ) -> Result<Self, CorpusError> {
        let wrong = |path: &Path| {
            let path = path.display().to_string();
            move |source| CorpusError::Output { path, source }
        };
        if !input.is_dir() {
            return Err(CorpusError::Input { what: format!("{}: no such folder", input.display()) });
        }
        for folder in [output.to_path_buf(), output.join(STREAMS), output.join(SETTINGS)] {
            std::fs::create_dir_all(&folder).map_err(wrong(&folder))?;
        }
        let lock = output.join(".lock");
        let lock_file =
            File::options().create(true).truncate(false).write(true).open(&lock).map_err(wrong(&lock))?;
        if !claim(&lock_file) {
            return Err(CorpusError::Busy { path: output.display().to_string() });
        }
        remove_unfinished(output)?;
        let found = inputs(input, output, &choice.only)?;
        let digest = settings.digest();
        let told = output.join(SETTINGS).join(format!("{digest}.json"));
        let text = serde_json::to_string_pretty(settings).unwrap_or_default() + "\n";
        AtomicFile::write_all_to(&told, text.as_bytes()).map_err(wrong(&told))?;

        let mut run = Run {
            inputs: found.items.len() as u64,
            others: found.others.count,
            other_names: found.others.first,
            results: found.results.count,
            result_names: found.results.first,
            ..Run::default()
        };
        let mut known = Known {
            input,
            output,
            settings: &digest,
            checksum: choice.checksum,
            todo: found.items,
            otherwise: 0,
        };
        let manifest = Ledger::open(&output.join(MANIFEST), |entry| known.entry(entry))?;
        run.otherwise = known.otherwise;
        run.before = run.inputs - known.todo.len() as u64;
        let failures = Ledger::open(&output.join(FAILURES), |failure| known.failure(failure, choice.retry))?;
        run.failed_before = run.inputs - known.todo.len() as u64 - run.before;
        let given_up: Vec<Outcome> = found
            .faults
            .iter()
            .filter_map(|(name, why)| Some(Outcome::given_up(&known.todo.remove(name)?, &digest, why)))
            .collect();
        let todo = known.todo.into_values().collect();
        let mut corpus = Self {
            input: input.into(),
            output: output.into(),
            settings: digest,
            todo,
            manifest,
            failures,
            gone: BTreeSet::new(),
            run,
            begun: Instant::now(),
            _lock: lock_file,
        };
        given_up.iter().try_for_each(|outcome| corpus.record(outcome))?;
        Ok(corpus)
    }

    /// What is to do, in the order of names.
    pub fn todo(&self) -> &[Item] {
        &self.todo
    }

    /// Inputs that there are.
    pub fn inputs(&self) -> u64 {
        self.run.inputs
    }

    /// Inputs that have a stream already.
    pub fn done_before(&self) -> u64 {
        self.run.before
    }

    /// Inputs whose stream was made with other settings, or by another version, and is made anew.
    pub fn done_otherwise(&self) -> u64 {
        self.run.otherwise
    }

    /// Inputs that failed before and are not tried again.
    pub fn failed_before(&self) -> u64 {
        self.run.failed_before
    }

    /// [`Settings::digest`] of the settings.
    pub fn settings(&self) -> &str {
        &self.settings
    }

    /// Keeps what became of an input.
    ///
    /// # Errors
    /// [`CorpusError::Output`].
    pub fn record(&mut self, outcome: &Outcome) -> Result<(), CorpusError> {
        match outcome {
            Outcome::Done(entry) => {
                self.run.done += 1;
                self.run.done_clips += u64::from(entry.kind == Kind::Clip);
                self.run.done_seconds += entry.seconds;
                self.manifest.add(entry)
            }
            Outcome::Failed(failure) => {
                self.run.failed += 1;
                self.failures.add(failure)?;
                let stream = self.output.join(stream_name(&failure.name));
                match std::fs::remove_file(&stream) {
                    Err(source) if source.kind() == io::ErrorKind::NotFound => return Ok(()),
                    removed => removed.map_err(|source| CorpusError::Output {
                        path: stream.display().to_string(),
                        source,
                    })?,
                }
                self.gone.insert(failure.name.clone());
                Ok(())
            }
        }
    }

    /// Does all there is to do with `jobs` threads; `each` is told what became of each input, in the order in which they
    /// are done.
    ///
    /// # Errors
    /// [`CorpusError::Output`], on which the run ends.
    pub fn run(
        &mut self,
        worker: &Worker,
        jobs: usize,
        each: &mut dyn FnMut(&Item, &Outcome),
    ) -> Result<(), CorpusError> {
        let todo = std::mem::take(&mut self.todo);
        let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
        let (sender, receiver) = channel();
        let mut failed = None;
        std::thread::scope(|scope| {
            let work = || {
                let sender = sender.clone();
                let (todo, next, stop) = (&todo, &next, &stop);
                scope.spawn(move || {
                    while !stop.load(Ordering::Relaxed) {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        let Some(item) = todo.get(index) else { break };
                        // The receiver lives as long as the scope.
                        let _ = sender.send((index, worker.work(item)));
                    }
                })
            };
            let threads: Vec<_> = (0..jobs.clamp(1, todo.len().max(1))).map(|_| work()).collect();
            drop(sender);
            for (index, outcome) in receiver {
                if failed.is_some() {
                    // What others have done by now is for the next run to do.
                    continue;
                }
                let kept = outcome.and_then(|outcome| {
                    self.record(&outcome)?;
                    if let Some(item) = todo.get(index) {
                        each(item, &outcome);
                    }
                    Ok(())
                });
                if let Err(error) = kept {
                    stop.store(true, Ordering::Relaxed);
                    failed = Some(error);
                }
            }
            for thread in threads {
                thread.join().unwrap_or_else(|broken| resume_unwind(broken));
            }
        });
        self.run.jobs = jobs as u64;
        failed.map_or(Ok(()), Err)
    }

    /// Puts the lines in order, and writes `report.json` and `report.html`.
    ///
    /// # Errors
    /// See [`CorpusError`].
    pub fn finish(mut self) -> Result<Report, CorpusError> {
        let Self { gone, manifest, .. } = &mut self;
        manifest.sort(|name| !gone.contains(name))?;
        self.failures.sort(|_| true)?;
        self.run.wall_seconds = self.begun.elapsed().as_secs_f64();
        let report = Report::of(&self.input, &self.output, &self.settings, &self.run)?;
        let json = serde_json::to_string_pretty(&report).unwrap_or_default();
        for (name, text) in [(REPORT, json), (PAGE, crate::page::page(&report))] {
            let path = self.output.join(name);
            AtomicFile::write_all_to(&path, text.as_bytes())
                .map_err(|source| CorpusError::Output { path: path.display().to_string(), source })?;
        }
        Ok(report)
    }
}

/// What is known of inputs while the lines are read.
struct Known<'a> {
    input: &'a Path,
    output: &'a Path,
    settings: &'a str,
    checksum: bool,
    todo: BTreeMap<String, Item>,
    /// Those whose stream was made with other settings, or by another version.
    otherwise: u64,
}

impl Known<'_> {
    /// The line of a stream that is there; where it holds its input is not to be done.
    fn entry(&mut self, mut entry: Entry) -> Option<Entry> {
        let Some(item) = self.todo.get(&entry.name) else { return Some(entry) };
        if !self.is_whole(&self.output.join(stream_name(&item.name)), &entry) {
            return None;
        }
        if !self.is_of(&entry.made_by, &entry.settings) {
            self.otherwise += 1;
        } else if self.same(item, entry.input_bytes, entry.modified, &entry.sha256) {
            entry.modified = item.modified;
            entry.input_bytes = item.bytes;
            self.todo.remove(&entry.name);
        }
        Some(entry)
    }

    /// The line of a failure, if it holds and is not to be tried again.
    fn failure(&mut self, mut failure: Failure, retry: bool) -> Option<Failure> {
        let Some(item) = self.todo.get(&failure.name) else {
            // Of those there are but not asked for it is kept.
            return self.input.join(&failure.name).exists().then_some(failure);
        };
        let sha256 = failure.sha256.as_deref().unwrap_or_default();
        let holds = !retry
            && self.is_of(&failure.made_by, &failure.settings)
            && self.same(item, failure.input_bytes, failure.modified, sha256);
        if holds {
            failure.modified = item.modified;
            self.todo.remove(&failure.name);
        }
        holds.then_some(failure)
    }

    /// Whether a stream is there as it was made, as far as is looked.
    fn is_whole(&self, stream: &Path, entry: &Entry) -> bool {
        std::fs::metadata(stream).is_ok_and(|found| found.is_file() && found.len() == entry.bytes)
            && (!self.checksum || digest_of(stream).is_ok_and(|found| found == entry.stream_sha256))
    }

    fn is_of(&self, made_by: &str, settings: &str) -> bool {
        made_by == crate::MADE_BY && settings == self.settings
    }

    /// Whether an input has the content that a line is of.
    fn same(&self, item: &Item, bytes: u64, modified: i64, sha256: &str) -> bool {
        if (item.bytes, item.modified) == (bytes, modified) && !self.checksum {
            return true;
        }
        digest_of(&item.path(self.input)).is_ok_and(|found| found == sha256)
    }
}

/// The SHA-256 of a file.
pub(crate) fn digest_of(path: &Path) -> io::Result<String> {
    let mut file = File::open(path)?;
    let mut hash = Sha256::new();
    let mut piece = vec![0; 1 << 16];
    loop {
        match io::Read::read(&mut file, &mut piece)? {
            0 => return Ok(hex(&hash.finalize())),
            count => hash.update(&piece[..count]),
        }
    }
}

/// Takes away the files beside streams, settings, lines and reports that a run that was ended has left.
fn remove_unfinished(output: &Path) -> Result<(), CorpusError> {
    let top = WalkDir::new(output).max_depth(1).into_iter();
    let inside = [STREAMS, SETTINGS].map(|folder| WalkDir::new(output.join(folder)).into_iter());
    for entry in top.chain(inside.into_iter().flatten()) {
        let entry = entry.map_err(|error| CorpusError::Output {
            path: output.display().to_string(),
            source: error.into(),
        })?;
        let name = entry.file_name().to_string_lossy();
        // At the top there may be what is not of this program.
        let ours = entry.path().parent() != Some(output)
            || [MANIFEST, FAILURES, REPORT, PAGE].iter().any(|of| name.starts_with(&format!(".{of}.")));
        if entry.file_type().is_file() && name.starts_with('.') && name.ends_with(".part") && ours {
            std::fs::remove_file(entry.path())
                .map_err(|source| CorpusError::Output { path: entry.path().display().to_string(), source })?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_killed_run_left_is_taken_away_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for folder in ["streams/a", "settings", "other"] {
            std::fs::create_dir_all(at(folder)).unwrap();
        }
        let left = [
            ".manifest.jsonl.x1.part",
            ".report.html.x2.part",
            "streams/a/.b.fba.x3.part",
            "settings/.c.part",
        ];
        let kept = ["manifest.jsonl", ".mine.part", "other/.d.part", "streams/a/b.fba"];
        for file in left.iter().chain(&kept) {
            std::fs::write(at(file), b"").unwrap();
        }
        remove_unfinished(dir.path()).unwrap();
        assert!(left.iter().all(|file| !at(file).exists()) && kept.iter().all(|file| at(file).exists()));
    }
}
