//! Which files of a folder are inputs.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use glob::Pattern;
use handcast_formats::motion::Format;
use serde::{Deserialize, Serialize};
use walkdir::{DirEntry, WalkDir};

use crate::corpus::{CorpusError, FAILURES, MANIFEST, PAGE, REPORT, SETTINGS};
use crate::work::STREAMS;

/// Endings of clips: what is decoded in the process, and what goes through ffmpeg where that is there.
pub const CLIP_ENDINGS: [&str; 21] = [
    "mp4", "m4v", "mov", "avi", "gif", "apng", "webp", "y4m", "mkv", "webm", "mpg", "mpeg", "ts", "mts",
    "m2ts", "wmv", "flv", "3gp", "ogv", "divx", "vob",
];
/// What `run` and `demo` write into their output folder.
pub const RUN_RESULTS: [&str; 9] = [
    "poses.jsonl",
    "person.toml",
    "overlay.mp4",
    "overlay.avi",
    "hand.fba",
    "hand.glb",
    "preview.png",
    "report.json",
    "report.txt",
];
/// The clip that `demo` writes beside them.
const DEMO_CLIP: &str = "demo.avi";
/// Most bytes of a report that tells what it is of.
const LONGEST_REPORT: u64 = 1 << 24;
/// Bytes of an MPEG-2 transport packet, each of which begins with [`SYNC`] (ISO/IEC 13818-1, 2.4.3.2).
const PACKET: usize = 188;
const SYNC: u8 = 0x47;
/// Names of what is passed over that are kept.
const NAMED: usize = 25;

/// An input: a clip or a motion.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Item {
    /// Its path below the input folder, with `/`.
    pub name: String,
    /// How many bytes it has.
    pub bytes: u64,
    /// When it was last changed, nanoseconds since 1970.
    pub modified: i64,
}

impl Item {
    /// Where it is.
    pub fn path(&self, input: &Path) -> PathBuf {
        input.join(&self.name)
    }
}

/// Inputs by name, and how many other files there are.
#[derive(Debug, Default)]
pub(crate) struct Inputs {
    pub items: BTreeMap<String, Item>,
    /// What is neither clip nor motion, hidden folders as one.
    pub others: Names,
    /// Folders with results of this program, which are no inputs.
    pub results: Names,
    /// Items that cannot be looked into, and why.
    pub faults: BTreeMap<String, String>,
}

/// How many there are, and the first names of them.
#[derive(Debug, Default)]
pub(crate) struct Names {
    pub count: u64,
    pub first: Vec<String>,
}

impl Names {
    fn add(&mut self, name: String) {
        self.count += 1;
        let at = self.first.partition_point(|other| *other < name);
        if at < NAMED {
            self.first.truncate(NAMED - 1);
            self.first.insert(at, name);
        }
    }
}

impl Inputs {
    /// Takes in what cannot be looked into.
    fn fault(&mut self, name: String, why: String) {
        self.items.insert(name.clone(), Item { name: name.clone(), bytes: 0, modified: 0 });
        self.faults.insert(name, why);
    }
}

/// A name that the manifest can hold for one that it cannot.
fn lossy(below: &Path) -> String {
    below.to_string_lossy().replace('\\', "/")
}

/// Whether a file is a clip or a motion, by its name; one in `.ts` by what is in it, since TypeScript has that ending, too.
fn is_input(path: &Path) -> bool {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    match ending.as_str() {
        "ts" => is_transport_stream(path),
        ending => CLIP_ENDINGS.contains(&ending) || Format::by_name(path).is_some(),
    }
}

/// Whether a file begins with two transport packets; one that cannot be read is for who works on it to tell.
fn is_transport_stream(path: &Path) -> bool {
    let mut head = [0; PACKET + 1];
    match std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut head)) {
        Ok(()) => head[0] == SYNC && head[PACKET] == SYNC,
        Err(error) => error.kind() != std::io::ErrorKind::UnexpectedEof,
    }
}

/// The names of results that a folder has: those of a corpus, and of one clip.
fn results_in(folder: &Path) -> Vec<&'static str> {
    let mut names = Vec::new();
    if folder.join(MANIFEST).is_file() && folder.join(SETTINGS).is_dir() {
        names.extend([MANIFEST, FAILURES, REPORT, PAGE, STREAMS, SETTINGS]);
    }
    if folder.join("hand.fba").is_file() && is_of_a_clip(&folder.join(REPORT)) {
        names.extend(RUN_RESULTS);
        names.push(DEMO_CLIP);
    }
    names
}

/// Whether a report is that of `run`.
fn is_of_a_clip(report: &Path) -> bool {
    let read = || {
        let mut text = Vec::new();
        std::fs::File::open(report).ok()?.take(LONGEST_REPORT).read_to_end(&mut text).ok()?;
        serde_json::from_slice::<serde_json::Value>(&text).ok()
    };
    read().is_some_and(|report| report["clip"].is_string() && report["stream_bytes"].is_u64())
}

/// What is looked into on the way through the folders.
struct Way<'a> {
    folder: &'a Path,
    output: Option<PathBuf>,
    hidden: Vec<String>,
    /// The names of results in folders that have some.
    results: BTreeMap<PathBuf, Vec<&'static str>>,
    /// Those in which some were passed over.
    passed: BTreeSet<String>,
}

impl Way<'_> {
    /// A name below the input folder; `.` for that itself.
    fn name(&self, path: &Path) -> String {
        let below = lossy(path.strip_prefix(self.folder).unwrap_or(path));
        if below.is_empty() { ".".into() } else { below }
    }

    fn takes(&mut self, entry: &DirEntry) -> bool {
        let (path, name) = (entry.path(), entry.file_name());
        if entry.depth() > 0 {
            if name.as_encoded_bytes().starts_with(b".") {
                self.hidden.push(self.name(path));
                return false;
            }
            if entry.file_type().is_dir() && self.output.is_some() && path.canonicalize().ok() == self.output
            {
                return false;
            }
            if let Some((parent, results)) =
                path.parent().and_then(|parent| self.results.get_key_value(parent))
                && results.iter().any(|result| name == *result)
            {
                self.passed.insert(self.name(parent));
                return false;
            }
        }
        if entry.file_type().is_dir() {
            let results = results_in(path);
            if !results.is_empty() {
                self.results.insert(path.into(), results);
            }
        }
        true
    }
}

/// The inputs below `folder`, links followed; what is hidden, what is in `output`, and what this program made of clips or of a
/// corpus, is none. With patterns only what one of them fits. Of a link to a folder that it is in nothing is taken twice.
pub(crate) fn inputs(folder: &Path, output: &Path, patterns: &[Pattern]) -> Result<Inputs, CorpusError> {
    let output = output.canonicalize().ok();
    let (hidden, results, passed) = Default::default();
    let way = RefCell::new(Way { folder, output, hidden, results, passed });
    let mut found = Inputs::default();
    for entry in WalkDir::new(folder)
        .follow_links(true)
        .into_iter()
        .filter_entry(|entry| way.borrow_mut().takes(entry))
    {
        let wanted = |name: &str| patterns.is_empty() || patterns.iter().any(|pattern| pattern.matches(name));
        let entry = match entry {
            Ok(entry) => entry,
            Err(error) if error.loop_ancestor().is_some() => continue,
            Err(error) => {
                let at = error.path().and_then(|path| path.strip_prefix(folder).ok());
                let name = at.map(lossy).unwrap_or_default();
                if name.is_empty() {
                    return Err(CorpusError::Input { what: error.to_string() });
                }
                if wanted(&name) {
                    let why = error.io_error().map_or_else(|| error.to_string(), ToString::to_string);
                    found.fault(name, why);
                }
                continue;
            }
        };
        if !entry.file_type().is_file() {
            continue;
        }
        let below = entry.path().strip_prefix(folder).unwrap_or(entry.path());
        if !is_input(entry.path()) {
            found.others.add(lossy(below));
            continue;
        }
        let parts: Option<Vec<&str>> = below.iter().map(|part| part.to_str()).collect();
        let Some(name) = parts.map(|parts| parts.join("/")) else {
            let name = lossy(below);
            if wanted(&name) {
                found.fault(name, "the name is no UTF-8, which the manifest could not hold".to_owned());
            }
            continue;
        };
        if !wanted(&name) {
            found.others.add(name);
            continue;
        }
        let facts = entry.metadata().map_err(|error| CorpusError::Input { what: error.to_string() })?;
        let since = facts.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let modified = since.map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(i64::MAX));
        found.items.insert(name.clone(), Item { name, bytes: facts.len(), modified });
    }
    let Way { hidden, passed, .. } = way.into_inner();
    hidden.into_iter().for_each(|name| found.others.add(name));
    passed.into_iter().for_each(|name| found.results.add(name));
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn odd_entries_are_faults_and_stop_nothing() {
        use std::os::unix::ffi::OsStrExt as _;
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::write(at("a.mp4"), b"x").unwrap();
        symlink(".", at("self")).unwrap();
        symlink("/nonexistent", at("dangling.mp4")).unwrap();
        for name in [&b"bad\xff.avi"[..], b"bad\xff.landmarks.jsonl"] {
            std::fs::write(dir.path().join(std::ffi::OsStr::from_bytes(name)), b"x").unwrap();
        }
        let found = inputs(dir.path(), &at("out"), &[]).unwrap();
        let names: Vec<&str> = found.items.keys().map(String::as_str).collect();
        assert_eq!(names, ["a.mp4", "bad\u{fffd}.avi", "bad\u{fffd}.landmarks.jsonl", "dangling.mp4"]);
        assert_eq!(found.faults.len(), 3);
        assert!(found.faults["dangling.mp4"].contains("No such file"), "{:?}", found.faults);
    }

    #[test]
    fn clips_and_motions_are_taken_and_the_output_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for folder in ["a/b", "out/streams", ".git"] {
            std::fs::create_dir_all(at(folder)).unwrap();
        }
        for name in [
            "x.MP4",
            "a/y.pose",
            "a/b/z.landmarks.jsonl",
            "a/notes.txt",
            "out/streams/x.MP4.fba",
            ".git/c.avi",
        ] {
            std::fs::write(at(name), "1").unwrap();
        }
        let names = |patterns: &[&str]| {
            let patterns: Vec<_> = patterns.iter().map(|p| Pattern::new(p).unwrap()).collect();
            let found = inputs(dir.path(), &at("out"), &patterns).unwrap();
            (found.items.into_keys().collect::<Vec<_>>(), found.others.first)
        };
        let all = ["a/b/z.landmarks.jsonl", "a/y.pose", "x.MP4"].map(String::from).to_vec();
        assert_eq!(names(&[]), (all, [".git", "a/notes.txt"].map(String::from).to_vec()));
        assert_eq!(names(&["a/*"]).0, ["a/b/z.landmarks.jsonl", "a/y.pose"]);
        assert_eq!(names(&["*.MP4", "*.avi"]).0, ["x.MP4"]);
    }

    #[test]
    fn results_of_this_program_are_no_inputs() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for folder in ["day/clip-handcast", "old/streams", "old/settings", "other"] {
            std::fs::create_dir_all(at(folder)).unwrap();
        }
        let of_run = r#"{"clip":"clip.mp4","stream_bytes":9}"#;
        for (name, content) in [
            ("day/clip.mp4", "1"),
            ("day/clip-handcast/hand.fba", "1"),
            ("day/clip-handcast/overlay.mp4", "1"),
            ("day/clip-handcast/report.json", of_run),
            ("day/clip-handcast/mine.jsonl", "1"),
            ("old/manifest.jsonl", ""),
            ("old/report.json", "{}"),
            ("old/streams/a.mp4.fba", "1"),
            ("old/settings/1.json", "{}"),
            ("old/clip.mp4", "1"),
            // Another program's.
            ("other/hand.fba", "1"),
            ("other/report.json", "{}"),
            ("other/manifest.jsonl", "1"),
        ] {
            std::fs::write(at(name), content).unwrap();
        }
        let found = inputs(dir.path(), &at("out"), &[]).unwrap();
        let names: Vec<&str> = found.items.keys().map(String::as_str).collect();
        let own = ["day/clip-handcast/mine.jsonl", "day/clip.mp4", "old/clip.mp4"];
        assert_eq!(
            names,
            [&own[..], &["other/hand.fba", "other/manifest.jsonl", "other/report.json"]].concat()
        );
        assert_eq!((found.results.count, found.results.first.join(" ")), (2, "day/clip-handcast old".into()));
        assert_eq!(found.others.count, 0);
        // The folder itself may have some, as where it is the one for the results.
        let found = inputs(&at("old"), &at("old"), &[]).unwrap();
        assert_eq!(found.items.into_keys().collect::<Vec<_>>(), ["clip.mp4"]);
        assert_eq!(found.results.first, ["."]);
    }

    #[test]
    fn transport_streams_are_told_from_typescript() {
        let dir = tempfile::tempdir().unwrap();
        let mut packets = vec![0xff; 3 * PACKET];
        packets.iter_mut().step_by(PACKET).for_each(|byte| *byte = SYNC);
        let source = b"// Good\n".repeat(40);
        let files: [(&str, &[u8]); 4] =
            [("clip.TS", &packets), ("page.ts", &source), ("short.ts", b"G"), ("clip.m2ts", b"x")];
        for (name, bytes) in files {
            std::fs::write(dir.path().join(name), bytes).unwrap();
        }
        let found = inputs(dir.path(), &dir.path().join("out"), &[]).unwrap();
        assert_eq!(found.items.into_keys().collect::<Vec<_>>(), ["clip.TS", "clip.m2ts"]);
        assert_eq!(
            (found.others.count, found.others.first),
            (2, ["page.ts", "short.ts"].map(String::from).to_vec())
        );
    }
}
