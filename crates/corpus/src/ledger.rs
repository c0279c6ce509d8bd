//! Files of JSON lines that a run appends to and that the next one goes on with.

use std::collections::{HashMap, HashSet};
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use handcast_formats::atomic::AtomicFile;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::corpus::CorpusError;

/// Longest line, bytes: names and errors are shorter.
const LONGEST: u64 = 1 << 16;

/// A file of lines, each of an input. Where one has several, as long as a run goes on or when it was ended, the last holds.
/// It is open only while a line is added: on some systems an open file cannot be replaced.
#[derive(Debug)]
pub(crate) struct Ledger {
    path: PathBuf,
}

fn wrong(path: &Path, source: io::Error) -> CorpusError {
    CorpusError::Output { path: path.display().to_string(), source }
}

/// The whole lines of a file that may not be there; of a last line that was cut nothing is told. `each` takes its number
/// from 1, where it begins, and its bytes without the end.
fn lines(
    path: &Path,
    mut each: impl FnMut(usize, u64, &[u8]) -> Result<(), CorpusError>,
) -> Result<u64, CorpusError> {
    let file = match File::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(0),
        file => file.map_err(|error| wrong(path, error))?,
    };
    let mut reader = BufReader::new(file);
    let (mut line, mut at) = (Vec::new(), 0u64);
    for number in 1.. {
        line.clear();
        let count =
            reader.by_ref().take(LONGEST).read_until(b'\n', &mut line).map_err(|error| wrong(path, error))?;
        if line.pop() != Some(b'\n') {
            // A run was ended while it wrote this line; a longer one is none of ours.
            if count as u64 == LONGEST {
                return Err(CorpusError::Line {
                    path: path.display().to_string(),
                    number,
                    what: format!("longer than {LONGEST} bytes"),
                });
            }
            break;
        }
        each(number, at, &line)?;
        at += count as u64;
    }
    Ok(at)
}

/// Reads a file of lines.
pub(crate) fn each<T: DeserializeOwned>(path: &Path, mut of: impl FnMut(T)) -> Result<(), CorpusError> {
    lines(path, |number, _, line| {
        of(parsed(path, number, line)?);
        Ok(())
    })?;
    Ok(())
}

/// What each line has.
#[derive(serde::Deserialize)]
struct Named {
    name: String,
}

/// Where the last line of each name begins, and how long it is with its end.
fn last_lines(path: &Path) -> Result<HashMap<String, (u64, usize)>, CorpusError> {
    let mut last = HashMap::new();
    lines(path, |number, at, line| {
        let Named { name } = parsed(path, number, line)?;
        last.insert(name, (at, line.len() + 1));
        Ok(())
    })?;
    Ok(last)
}

fn parsed<T: DeserializeOwned>(path: &Path, number: usize, line: &[u8]) -> Result<T, CorpusError> {
    serde_json::from_slice(line).map_err(|error| CorpusError::Line {
        path: path.display().to_string(),
        number,
        what: error.to_string(),
    })
}

impl Ledger {
    /// Opens a file of lines, which may be missing: lines for which `keep` gives none are left out, and so are one that was
    /// cut when a run was ended and those that others of their name follow.
    pub fn open<T: DeserializeOwned + Serialize>(
        path: &Path,
        mut keep: impl FnMut(T) -> Option<T>,
    ) -> Result<Self, CorpusError> {
        let last = last_lines(path)?;
        let last: HashSet<u64> = last.into_values().map(|(at, _)| at).collect();
        let mut kept = AtomicFile::create(path).map_err(|error| wrong(path, error))?;
        lines(path, |number, at, line| {
            if last.contains(&at)
                && let Some(line) = keep(parsed(path, number, line)?)
            {
                write_line(&mut kept, &line).map_err(|error| wrong(path, error))?;
            }
            Ok(())
        })?;
        kept.commit().map_err(|error| wrong(path, error))?;
        Ok(Self { path: path.into() })
    }

    /// Adds a line, in one step: all of it, or, where the disk is full, nothing.
    pub fn add(&mut self, line: &impl Serialize) -> Result<(), CorpusError> {
        let add = || -> io::Result<()> {
            let mut bytes = Vec::new();
            write_line(&mut bytes, line)?;
            let mut file = OpenOptions::new().write(true).open(&self.path)?;
            let end = file.seek(SeekFrom::End(0))?;
            // The next line would go on with what there is of this one.
            file.write_all(&bytes).inspect_err(|_| drop(file.set_len(end)))
        };
        add().map_err(|error| wrong(&self.path, error))
    }

    /// Puts the last lines of names that are wanted in the order of the names.
    pub fn sort(&mut self, wanted: impl Fn(&str) -> bool) -> Result<(), CorpusError> {
        let mut index: Vec<(String, (u64, usize))> = last_lines(&self.path)?.into_iter().collect();
        index.retain(|(name, _)| wanted(name));
        index.sort();
        let rewrite = || -> io::Result<()> {
            let mut from = File::open(&self.path)?;
            let mut to = AtomicFile::create(&self.path)?;
            let mut line = Vec::new();
            for (_, (at, length)) in index {
                line.resize(length, 0);
                from.seek(SeekFrom::Start(at))?;
                from.read_exact(&mut line)?;
                to.write_all(&line)?;
            }
            drop(from);
            to.commit()
        };
        rewrite().map_err(|error| wrong(&self.path, error))
    }
}

fn write_line(out: &mut impl Write, line: &impl Serialize) -> io::Result<()> {
    let mut bytes = serde_json::to_vec(line)?;
    bytes.push(b'\n');
    out.write_all(&bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn names(path: &Path) -> Vec<String> {
        let mut names = Vec::new();
        each(path, |line: Value| names.push(line["name"].as_str().unwrap().to_owned())).unwrap();
        names
    }

    #[test]
    fn a_cut_line_is_gone_and_what_is_kept_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.jsonl");
        let mut ledger = Ledger::open(&path, Some::<Value>).unwrap();
        for name in ["c", "a", "b"] {
            ledger.add(&json!({ "name": name })).unwrap();
        }
        let mut text = std::fs::read_to_string(&path).unwrap();
        text.push_str("{\"name\":\"d");
        std::fs::write(&path, text).unwrap();
        assert_eq!(names(&path), ["c", "a", "b"]);
        let keep = |line: Value| (line["name"] != "a").then_some(line);
        let mut ledger = Ledger::open(&path, keep).unwrap();
        ledger.add(&json!({ "name": "a" })).unwrap();
        assert_eq!(names(&path), ["c", "b", "a"]);
        ledger.sort(|_| true).unwrap();
        ledger.add(&json!({ "name": "e" })).unwrap();
        assert_eq!(names(&path), ["a", "b", "c", "e"]);
        ledger.add(&json!({ "name": "b", "new": true })).unwrap();
        let mut ledger = Ledger::open(&path, Some::<Value>).unwrap();
        assert_eq!(names(&path), ["a", "c", "e", "b"]);
        ledger.add(&json!({ "name": "a" })).unwrap();
        ledger.sort(|name| name != "c").unwrap();
        assert_eq!(names(&path), ["a", "b", "e"]);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn between_lines_the_file_is_closed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.jsonl");
        let mut ledger = Ledger::open(&path, Some::<Value>).unwrap();
        ledger.add(&json!({ "name": "a" })).unwrap();
        let open = std::fs::read_dir("/proc/self/fd").unwrap().flatten();
        let open = open.filter_map(|entry| std::fs::read_link(entry.path()).ok());
        assert_eq!(open.filter(|file| file == &path.canonicalize().unwrap()).count(), 0);
        ledger.sort(|_| true).unwrap();
        assert_eq!(names(&path), ["a"]);
    }

    #[test]
    fn a_damaged_line_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.jsonl");
        std::fs::write(&path, "{\"name\":\"a\"}\nwords\n{\"name\":\"b\"}\n").unwrap();
        let error = Ledger::open(&path, Some::<Value>).unwrap_err().to_string();
        assert!(error.contains("m.jsonl: line 2"), "{error}");
        std::fs::write(&path, "x".repeat(70_000)).unwrap();
        assert!(each(&path, |_: Value| ()).is_err());
    }
}
