//! Networks in folders, zips and packed assets.

use std::fs::File;
use std::io::{Cursor, Read, Seek};
use std::path::{Path, PathBuf};

use zip::ZipArchive;

use super::{MAX_BYTES, NetFile};
use crate::error::{Error, Result};

/// Folders are searched this deep, and this many files at most are looked at.
const DEPTH: usize = 6;
const MAX_FILES: usize = 10_000;

/// A wheel's other networks are many; those of hands say so in their names.
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

/// All networks that find hands in a file or folder.
pub(super) fn networks(path: &Path) -> Result<Vec<NetFile>> {
    let mut found = Vec::new();
    if std::fs::metadata(path).map_err(io(path))?.is_dir() {
        folder(path, &mut found)?;
    } else if extension(path) == "tflite" {
        // The other network is in a file beside it, or in a folder beside its own.
        file(path, &mut found)?;
        if found.is_empty() {
            let bytes = limited(File::open(path).map_err(io(path))?, path)?;
            crate::graph::Network::read(&bytes)?;
        }
        let own = found.first().map(|file| file.role);
        let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut others = Vec::new();
        folder(parent, &mut others)?;
        if !others.iter().any(|file| Some(file.role) != own)
            && let Some(above) = parent.parent().filter(|p| !p.as_os_str().is_empty())
        {
            for name in ["palm_detection", "hand_landmark"] {
                let _ = folder(&above.join(name), &mut others);
            }
        }
        found.extend(others.into_iter().filter(|file| Some(file.role) != own));
    } else {
        file(path, &mut found)?;
    }
    Ok(found)
}

/// What one file holds, by its extension.
fn file(path: &Path, found: &mut Vec<NetFile>) -> Result<()> {
    match extension(path).as_str() {
        "tflite" => {
            let bytes = limited(File::open(path).map_err(io(path))?, path)?;
            found.extend(NetFile::read(path, None, &bytes));
        }
        "data" => found.extend(packed(path)?),
        _ => zipped(path, File::open(path).map_err(io(path))?, "", found)?,
    }
    Ok(())
}

/// The networks below a folder. What cannot be read there is passed over.
fn folder(path: &Path, found: &mut Vec<NetFile>) -> Result<()> {
    let mut folders = vec![(path.to_owned(), 0)];
    let mut seen = 0;
    while let Some((folder, depth)) = folders.pop() {
        let entries = match std::fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(source) if depth == 0 => return Err(Error::Io { path: folder, source }),
            Err(_) => continue,
        };
        let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        paths.sort();
        for path in paths {
            seen += 1;
            if seen > MAX_FILES {
                return Ok(());
            }
            let kind = extension(&path);
            let named = path.file_name().is_some_and(|name| named_for_hands(&name.to_string_lossy()));
            if path.is_dir() {
                if depth < DEPTH {
                    folders.push((path, depth + 1));
                }
            } else if (named && ["tflite", "task", "data"].contains(&kind.as_str())) || kind == "whl" {
                let _ = file(&path, found);
            }
        }
    }
    Ok(())
}

/// A file's bytes, within the limit.
fn limited(source: impl Read, path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    source.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(io(path))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(Error::Limit { what: "bytes of a file", found: bytes.len() as u64, allowed: MAX_BYTES });
    }
    Ok(bytes)
}

/// The networks in a zip, and in the bundles in it.
fn zipped(path: &Path, source: impl Read + Seek, within: &str, found: &mut Vec<NetFile>) -> Result<()> {
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
        .collect();
    for name in names {
        let bytes = limited(archive.by_name(&name).map_err(damaged)?, path)?;
        let entry = format!("{within}{name}");
        if extension(Path::new(&name)) == "task" {
            zipped(path, Cursor::new(bytes), &format!("{entry}/"), found)?;
        } else {
            found.extend(NetFile::read(path, Some(entry), &bytes));
        }
    }
    Ok(())
}

/// The networks in a file of packed assets; the script beside it says where in it each one is.
fn packed(path: &Path) -> Result<Vec<NetFile>> {
    let script = path.with_file_name(format!(
        "{}_loader.js",
        path.file_stem().map(|stem| stem.to_string_lossy()).unwrap_or_default()
    ));
    let text = limited(File::open(&script).map_err(io(&script))?, &script)?;
    let text = String::from_utf8_lossy(&text);
    let bytes = limited(File::open(path).map_err(io(path))?, path)?;
    Ok(listed(&text)
        .filter(|(name, _, _)| name.ends_with(".tflite") && named_for_hands(name))
        .filter_map(|(name, start, end)| NetFile::read(path, Some(name), bytes.get(start..end)?))
        .collect())
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

/// The licence stated by the package that a file or folder is or is in.
pub(super) fn licence(path: &Path) -> Option<String> {
    if extension(path) == "whl" {
        let mut archive = ZipArchive::new(File::open(path).ok()?).ok()?;
        let name =
            archive.file_names().flatten().find(|name| name.ends_with(".dist-info/METADATA"))?.into_owned();
        let text = limited(archive.by_name(&name).ok()?, path).ok()?;
        return stated(&String::from_utf8_lossy(&text), "License:");
    }
    path.canonicalize().ok()?.ancestors().take(DEPTH).find_map(|folder| {
        let package = std::fs::read_to_string(folder.join("package.json")).ok();
        if let Some(text) = package {
            let rest = text.split(r#""license""#).nth(1)?;
            return rest.split('"').nth(1).map(str::to_owned);
        }
        std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path()).find_map(|path| {
            let name = path.file_name()?.to_string_lossy().into_owned();
            let metadata = name.starts_with("mediapipe-") && name.ends_with(".dist-info");
            let text = metadata.then(|| std::fs::read_to_string(path.join("METADATA")).ok())??;
            stated(&text, "License:")
        })
    })
}

/// What follows a key at the start of a line.
fn stated(text: &str, key: &str) -> Option<String> {
    text.lines().find_map(|line| line.strip_prefix(key)).map(|value| value.trim().to_owned())
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
        assert_eq!(stated("Name: x\nLicense: Apache 2.0\n", "License:").as_deref(), Some("Apache 2.0"));
    }
}
