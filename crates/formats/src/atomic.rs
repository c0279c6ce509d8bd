//! Output files that appear whole or not at all.

use std::ffi::OsString;
use std::fs::{File, FileType, OpenOptions, TryLockError};
use std::io::{self, BufWriter, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempPath};

use crate::unfinished::{Kind, Unfinished};

/// A file that is written beside its destination and put in its place by [`AtomicFile::commit`]. It has the permissions of
/// any new file.
///
/// Only a regular file is replaced. Through a symbolic link its target is written; into a pipe or a device what was
/// written goes at the commit.
///
/// Dropped without `commit`, it leaves nothing: neither the destination nor the file beside it. The same holds where a
/// program that is told to end calls [`crate::unfinished::remove_all`]. Errors name the destination.
#[derive(Debug)]
pub struct AtomicFile {
    destination: PathBuf,
    // Closed before it is removed.
    file: BufWriter<File>,
    place: Place,
}

/// How the content gets to its destination.
#[derive(Debug)]
enum Place {
    /// By renaming the file beside it.
    Renamed { beside: TempPath, to: PathBuf, guard: Unfinished },
    /// By copying into a pipe or a device.
    Copied { into: File },
}

/// Most symbolic links that are followed one after the other.
const MAX_LINKS: usize = 40;

impl AtomicFile {
    /// Creates the file beside `destination`, in the same directory; a pipe or device is opened, which for a pipe waits
    /// for its reader.
    ///
    /// # Errors
    /// `destination` names no file, or its directory cannot be written.
    pub fn create(destination: impl AsRef<Path>) -> io::Result<Self> {
        let destination = destination.as_ref().to_path_buf();
        let (file, place) = Self::begin(&destination).map_err(|error| told(&destination, error))?;
        Ok(Self { destination, file: BufWriter::new(file), place })
    }

    fn begin(destination: &Path) -> io::Result<(File, Place)> {
        if destination.file_name().is_none() {
            return Err(io::Error::new(ErrorKind::InvalidInput, "the output path names no file"));
        }
        match std::fs::metadata(destination) {
            Ok(found) if found.is_dir() => {
                return Err(io::Error::new(ErrorKind::IsADirectory, "the output path is a directory"));
            }
            Ok(found) if is_passed_on(found.file_type()) => {
                let into = OpenOptions::new().write(true).open(destination)?;
                return Ok((tempfile::tempfile()?, Place::Copied { into }));
            }
            _ => {}
        }
        let to = target(destination)?;
        let mut hidden = OsString::from(".");
        hidden.push(to.file_name().unwrap_or_default());
        hidden.push(".");
        let mut builder = Builder::new();
        builder.prefix(&hidden).suffix(".part");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            // Less the umask; without this only the owner could read it.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let folder = to.parent().filter(|folder| !folder.as_os_str().is_empty());
        let make = || builder.tempfile_in(folder.unwrap_or(Path::new(".")));
        let (file, guard) = Unfinished::made(Kind::File, make, |file| file.path().to_path_buf());
        let (file, beside) = file.map_err(unnamed)?.into_parts();
        // One that is replaced stays as private as it was.
        if let Ok(before) = std::fs::metadata(&to) {
            file.set_permissions(before.permissions())?;
        }
        Ok((file, Place::Renamed { beside, to, guard }))
    }

    /// The path the file will have after [`AtomicFile::commit`].
    pub fn destination(&self) -> &Path {
        &self.destination
    }

    /// Flushes, and puts the file in place of whatever stood at the destination.
    ///
    /// # Errors
    /// Writing or renaming failed; a regular file at the destination is then as it was before.
    pub fn commit(self) -> io::Result<()> {
        let Self { destination, file, place } = self;
        let finish = || -> io::Result<()> {
            let mut file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
            match place {
                Place::Renamed { beside, to, guard } => {
                    drop(file);
                    guard.done(|| beside.persist(to))?;
                }
                Place::Copied { mut into } => {
                    file.seek(SeekFrom::Start(0))?;
                    io::copy(&mut file, &mut into)?;
                    into.flush()?;
                }
            }
            Ok(())
        };
        finish().map_err(|error| told(&destination, error))
    }

    /// Writes `bytes` to `destination` in one step.
    ///
    /// # Errors
    /// As [`AtomicFile::create`] and [`AtomicFile::commit`].
    pub fn write_all_to(destination: impl AsRef<Path>, bytes: &[u8]) -> io::Result<()> {
        let mut file = Self::create(destination)?;
        file.write_all(bytes)?;
        file.commit()
    }
}

/// Takes a file for this program until it is closed; false where another one has it. Where a file system has no locks nobody
/// is asked.
#[must_use]
pub fn claim(file: &File) -> bool {
    !matches!(file.try_lock(), Err(TryLockError::WouldBlock))
}

/// Whether what is written to such a file goes elsewhere, so that there is nothing to replace.
fn is_passed_on(kind: FileType) -> bool {
    !kind.is_file() && !kind.is_dir()
}

/// Where symbolic links lead, also where there is nothing yet.
fn target(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_path_buf();
    for _ in 0..MAX_LINKS {
        if !std::fs::symlink_metadata(&path).is_ok_and(|found| found.is_symlink()) {
            return Ok(path);
        }
        let next = std::fs::read_link(&path)?;
        // A relative target counts from the link's folder; an absolute one replaces it.
        path = path.parent().map_or_else(|| next.clone(), |folder| folder.join(&next));
    }
    Err(io::Error::other("too many symbolic links"))
}

/// An error that names the file it is about.
fn told(path: &Path, error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// An error without the path that `tempfile` adds, which is that of the hidden file.
fn unnamed(error: io::Error) -> io::Error {
    match error.to_string().split_once(" at path ") {
        Some((what, _)) => io::Error::new(error.kind(), what.to_owned()),
        None => error,
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes).map_err(|error| told(&self.destination, error))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush().map_err(|error| told(&self.destination, error))
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to).map_err(|error| told(&self.destination, error))
    }
}

impl Read for AtomicFile {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.flush()?;
        self.file.get_mut().read(bytes).map_err(|error| told(&self.destination, error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn entries(dir: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn nothing_stands_there_before_commit_and_only_the_file_after() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bin");
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"hello").unwrap();
        file.seek(SeekFrom::Start(0)).unwrap();
        file.write_all(b"J").unwrap();
        assert!(!path.exists());
        file.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"Jello");
        assert_eq!(entries(dir.path()), ["a.bin"]);
    }

    #[test]
    fn a_dropped_file_leaves_the_old_one_untouched() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.bin");
        AtomicFile::write_all_to(&path, b"old").unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"new").unwrap();
        drop(file);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(entries(dir.path()), ["a.bin"]);
    }

    #[test]
    #[cfg(unix)]
    fn it_has_the_permissions_of_any_new_file() {
        use std::os::unix::fs::PermissionsExt as _;
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::write(at("plain"), b"").unwrap();
        AtomicFile::write_all_to(at("atomic"), b"").unwrap();
        let mode = |name: &str| fs::metadata(at(name)).unwrap().permissions().mode();
        assert_eq!(mode("atomic"), mode("plain"));
    }

    #[test]
    fn a_file_that_cannot_be_renamed_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let file = AtomicFile::create(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(file.commit().is_err());
        assert_eq!(entries(dir.path()), ["a"]);
        let missing = AtomicFile::create(dir.path().join("none/b")).unwrap_err();
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
        assert!(!missing.to_string().contains(".part"), "{missing}");
    }

    #[test]
    #[cfg(unix)]
    fn links_are_written_through_and_devices_into() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::create_dir(at("there")).unwrap();
        fs::write(at("there/old"), b"old").unwrap();
        symlink("there/old", at("link")).unwrap();
        symlink("link", at("chain")).unwrap();
        symlink("there/new", at("dangling")).unwrap();
        symlink("loop", at("loop")).unwrap();
        AtomicFile::write_all_to(at("chain"), b"through").unwrap();
        AtomicFile::write_all_to(at("dangling"), b"made").unwrap();
        assert_eq!(fs::read(at("there/old")).unwrap(), b"through");
        assert_eq!(fs::read(at("there/new")).unwrap(), b"made");
        for link in ["link", "chain", "dangling"] {
            assert!(fs::symlink_metadata(at(link)).unwrap().is_symlink(), "{link}");
        }
        assert!(AtomicFile::create(at("loop")).is_err());
        symlink("/dev/null", at("nowhere")).unwrap();
        let mut file = AtomicFile::create(at("nowhere")).unwrap();
        file.write_all(b"hello").unwrap();
        file.seek(SeekFrom::Start(1)).unwrap();
        file.commit().unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
        assert_eq!(entries(&at("there")), ["new", "old"]);
    }

    #[test]
    fn errors_name_the_destination() {
        let dir = tempfile::tempdir().unwrap();
        for path in [dir.path().join("none/x.bin"), dir.path().to_path_buf()] {
            let message = AtomicFile::create(&path).unwrap_err().to_string();
            assert!(message.starts_with(&format!("{}: ", path.display())), "{message}");
        }
    }

    #[test]
    fn a_directory_or_a_missing_directory_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        assert!(AtomicFile::create(dir.path()).is_err());
        assert!(AtomicFile::create(dir.path().join("no/such/dir/a")).is_err());
    }
}
