//! Networks in folders, zips and packed assets.

use std::fs::File;
use std::io::{Cursor, Read, Seek};
use std::path::{Path, PathBuf};

use zip::ZipArchive;

use super::{MAX_BYTES, NetFile};
use crate::error::{Error, Result};
use crate::model::NetworkLimits;

/// Folders are searched this deep, and this many files at most are looked at.
const DEPTH: usize = 6;
const MAX_FILES: usize = 10_000;

/// So many files are read from one place at most: no package has more networks of hands.
const MAX_READ: usize = 32;

/// How a zip begins, and what a network has at its fifth byte.
const ZIP: &[u8] = b"PK";
const NETWORK: &[u8] = b"TFL3";

/// What stands for the name of a file that is given as bytes.
const MEMORY: &str = "(bytes)";

/// Other networks are many; those of hands say so in their names.
fn named_for_hands(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    name.contains("hand") || name.contains("palm")
}

fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Error + use<'_> {
    move |source| Error::Io { path: path.to_owned(), source }
}

/// Networks that find hands, and what was wrong with others that may be such.
#[derive(Debug, Default)]
pub(super) struct Found {
    pub networks: Vec<NetFile>,
    /// The first error of a network or archive among others.
    pub error: Option<Error>,
    read: usize,
}

impl Found {
    /// All networks that find hands in a file or folder. Beside a `.tflite` file the other network is looked for, too.
    ///
    /// # Errors
    /// Where the file or folder itself cannot be read, or is nothing that may hold networks, or another network.
    pub fn at(path: &Path) -> Result<Self> {
        let mut found = Self::default();
        if std::fs::metadata(path).map_err(io(path))?.is_dir() {
            found.folder(path, DEPTH).map_err(io(path))?;
            return Ok(found);
        }
        found.file(path)?;
        if begins(path)?.get(4..8) == Some(NETWORK) {
            if found.networks.is_empty() {
                let what = "a network that finds neither palms nor the joints of hands".to_owned();
                return Err(Error::Archive { path: path.to_owned(), what });
            }
            found.beside(path);
        }
        Ok(found)
    }

    /// All networks that find hands in the bytes of a file.
    ///
    /// # Errors
    /// Where the bytes are nothing that may hold networks.
    pub fn of(bytes: &[u8]) -> Result<Self> {
        let mut found = Self::default();
        let path = Path::new(MEMORY);
        if bytes.starts_with(ZIP) {
            found.zipped(path, Cursor::new(bytes), "")?;
        } else {
            found.network(path, None, bytes)?;
        }
        Ok(found)
    }

    /// Networks in the folder of a file, and in those beside it.
    fn beside(&mut self, path: &Path) {
        let own = self.networks.first().map(|file| file.role);
        let given = std::mem::take(&mut self.networks);
        let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let _ = self.folder(parent, 0);
        if !self.networks.iter().any(|file| Some(file.role) != own) {
            for name in ["palm_detection", "hand_landmark"] {
                let _ = self.folder(&parent.join("..").join(name), 0);
            }
        }
        self.networks.retain(|file| Some(file.role) != own);
        self.networks.extend(given);
    }

    /// The networks in a folder and those in it, so many levels deep. What cannot be read in it is passed over.
    fn folder(&mut self, path: &Path, levels: usize) -> std::io::Result<()> {
        let mut folders = vec![(path.to_owned(), 0)];
        let mut seen = 0;
        while let Some((folder, depth)) = folders.pop() {
            let entries = match std::fs::read_dir(&folder) {
                Ok(entries) => entries,
                Err(error) if depth == 0 => return Err(error),
                Err(_) => continue,
            };
            let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
            paths.sort();
            for path in paths {
                seen += 1;
                if seen > MAX_FILES {
                    return Ok(());
                }
                if path.is_dir() {
                    folders.extend((depth < levels).then_some((path, depth + 1)));
                } else if worth(&path) {
                    let result = self.file(&path);
                    self.note(result);
                }
            }
        }
        Ok(())
    }

    /// Counts what is about to be read.
    fn count(&mut self) -> Result<()> {
        self.read += 1;
        NetworkLimits::check("networks in one place", self.read as u64, MAX_READ as u64)
    }

    fn note(&mut self, result: Result<()>) {
        if let Err(error) = result {
            self.error.get_or_insert(error);
        }
    }

    /// What one file holds, by its first bytes.
    fn file(&mut self, path: &Path) -> Result<()> {
        self.count()?;
        let start = begins(path)?;
        let open = || File::open(path).map_err(io(path));
        if start.starts_with(ZIP) {
            self.zipped(path, open()?, "")
        } else if start.get(4..8) == Some(NETWORK) {
            self.network(path, None, &limited(open()?, path)?)
        } else if extension(path) == "data" {
            self.packed(path)
        } else {
            let what = "neither a TensorFlow Lite network nor a zip (wheel, .task) of networks".to_owned();
            Err(Error::Archive { path: path.to_owned(), what })
        }
    }

    /// Keeps a network if it is one that finds hands.
    fn network(&mut self, path: &Path, entry: Option<String>, bytes: &[u8]) -> Result<()> {
        let name = entry.as_ref().map_or_else(|| path.to_owned(), |entry| path.join(entry));
        let file = NetFile::read(path, entry, bytes)
            .map_err(|source| Error::Network { path: name, source: Box::new(source) })?;
        self.networks.extend(file);
        Ok(())
    }

    /// The networks in a zip, and in the bundles in it.
    fn zipped(&mut self, path: &Path, source: impl Read + Seek, within: &str) -> Result<()> {
        let damaged =
            |error: zip::result::ZipError| Error::Archive { path: path.to_owned(), what: error.to_string() };
        let mut archive = ZipArchive::new(source).map_err(damaged)?;
        let names: Vec<String> = archive
            .file_names()
            .flatten()
            .filter(|name| {
                let kind = extension(Path::new(name.as_ref()));
                named_for_hands(name) && (kind == "tflite" || (kind == "task" && within.is_empty()))
            })
            .map(|name| name.into_owned())
            .take(MAX_READ + 1)
            .collect();
        for name in names {
            self.count()?;
            let bytes = limited(archive.by_name(&name).map_err(damaged)?, path)?;
            let entry = format!("{within}{name}");
            let result = if extension(Path::new(&name)) == "task" {
                self.zipped(path, Cursor::new(bytes), &format!("{entry}/"))
            } else {
                self.network(path, Some(entry), &bytes)
            };
            self.note(result);
        }
        Ok(())
    }

    /// The networks in a file of packed assets; the script beside it says where in it each one is.
    fn packed(&mut self, path: &Path) -> Result<()> {
        let script = path.with_file_name(format!(
            "{}_loader.js",
            path.file_stem().map(|stem| stem.to_string_lossy()).unwrap_or_default()
        ));
        let text = limited(File::open(&script).map_err(io(&script))?, &script)?;
        let bytes = limited(File::open(path).map_err(io(path))?, path)?;
        for (name, start, end) in listed(&String::from_utf8_lossy(&text)) {
            if name.ends_with(".tflite") && named_for_hands(&name) {
                self.count()?;
                let what = format!("{name} is said to be from byte {start} to {end} of {}", bytes.len());
                let part = bytes.get(start..end);
                let part = part.ok_or_else(|| Error::Archive { path: path.to_owned(), what })?;
                let result = self.network(path, Some(name), part);
                self.note(result);
            }
        }
        Ok(())
    }
}

/// Whether a file in a folder may hold networks of hands.
fn worth(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    match extension(path).as_str() {
        "tflite" | "task" | "data" => named_for_hands(&name),
        "whl" => name.starts_with("mediapipe-"),
        _ => false,
    }
}

/// The first bytes of a file, fewer where it is shorter.
fn begins(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path).and_then(|file| file.take(8).read_to_end(&mut bytes)).map_err(io(path))?;
    Ok(bytes)
}

/// A file's bytes, within the limit.
fn limited(source: impl Read, path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    source.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(io(path))?;
    NetworkLimits::check("bytes of a file", bytes.len() as u64, MAX_BYTES)?;
    Ok(bytes)
}

/// Name, start and end of the files that a loading script lists.
fn listed(script: &str) -> impl Iterator<Item = (String, usize, usize)> + '_ {
    script.split(r#""filename":"#).skip(1).filter_map(|part| {
        let name = part.split('"').nth(1)?;
        let number = |key: &str| {
            let rest = part.split(key).nth(1)?.trim_start_matches([':', ' ']);
            rest.split(|c: char| !c.is_ascii_digit()).next()?.parse().ok()
        };
        Some((name.to_owned(), number(r#""start""#)?, number(r#""end""#)?))
    })
}

/// The licence stated by the package that a file is, or is in.
pub(super) fn licence(path: &Path) -> Option<String> {
    if path.is_file() && begins(path).ok()?.starts_with(ZIP) {
        let mut archive = ZipArchive::new(File::open(path).ok()?).ok()?;
        let name =
            archive.file_names().flatten().find(|name| name.ends_with(".dist-info/METADATA"))?.into_owned();
        return stated(&text(archive.by_name(&name).ok()?)?);
    }
    path.canonicalize().ok()?.ancestors().skip(1).take(DEPTH).find_map(|folder| {
        let package = File::open(folder.join("package.json")).ok().and_then(text);
        if let Some(package) = package.filter(|package| package.contains(r#""@mediapipe/"#)) {
            let rest = package.split(r#""license""#).nth(1)?;
            return rest.split('"').nth(1).map(str::to_owned);
        }
        std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path()).find_map(|path| {
            let name = path.file_name()?.to_string_lossy().into_owned();
            let metadata = name.starts_with("mediapipe-") && name.ends_with(".dist-info");
            stated(&text(metadata.then(|| File::open(path.join("METADATA")).ok())??)?)
        })
    })
}

/// A short text.
fn text(source: impl Read) -> Option<String> {
    let mut bytes = Vec::new();
    source.take(1 << 20).read_to_end(&mut bytes).ok()?;
    Some(String::from_utf8_lossy(&bytes).into_owned())
}

/// The licence in the metadata of a Python package.
fn stated(text: &str) -> Option<String> {
    let key = |line| ["License:", "License-Expression:"].iter().find_map(|key| str::strip_prefix(line, key));
    text.lines().find_map(key).map(|value| value.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scripts_list_packed_files() {
        let script = r#"load({"files": [{"filename": "/a/t.txt", "start": 0, "end": 11}, {"filename": "/b/palm.tflite", "start": 11, "end": 99}], "remote_package_size": 99});"#;
        let files: Vec<_> = listed(script).collect();
        assert_eq!(files, [("/a/t.txt".to_owned(), 0, 11), ("/b/palm.tflite".to_owned(), 11, 99)]);
    }

    #[test]
    fn metadata_states_a_licence() {
        assert_eq!(stated("Name: x\nLicense: Apache 2.0\n").as_deref(), Some("Apache 2.0"));
        assert_eq!(stated("Name: x\nLicense-Expression: Apache-2.0\n").as_deref(), Some("Apache-2.0"));
        assert_eq!(stated("Name: x\n"), None);
    }
}
