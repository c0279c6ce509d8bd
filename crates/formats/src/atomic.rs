//! Output files that appear whole or not at all.

use std::ffi::OsString;
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::{Builder, TempPath};

/// A file written beside its destination and renamed onto it by [`AtomicFile::commit`]. It has the permissions of any
/// new file.
///
/// Dropped without `commit`, it leaves nothing: neither the destination nor the file beside it.
#[derive(Debug)]
pub struct AtomicFile {
    destination: PathBuf,
    // Closed before it is removed.
    file: BufWriter<File>,
    beside: TempPath,
}

impl AtomicFile {
    /// Creates the file beside `destination`, in the same directory.
    ///
    /// # Errors
    /// `destination` names no file, or its directory cannot be written.
    pub fn create(destination: impl AsRef<Path>) -> io::Result<Self> {
        let destination = destination.as_ref().to_path_buf();
        let Some(name) = destination.file_name() else {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "the output path names no file"));
        };
        if destination.is_dir() {
            return Err(io::Error::new(io::ErrorKind::IsADirectory, "the output path is a directory"));
        }
        let mut hidden = OsString::from(".");
        hidden.push(name);
        hidden.push(".");
        let mut builder = Builder::new();
        builder.prefix(&hidden).suffix(".part");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            // Less the umask; without this only the owner could read it.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let folder = destination.parent().filter(|folder| !folder.as_os_str().is_empty());
        let file = builder.tempfile_in(folder.unwrap_or(Path::new("."))).map_err(unnamed)?;
        let (file, beside) = file.into_parts();
        Ok(Self { destination, file: BufWriter::new(file), beside })
    }

    /// The path the file will have after [`AtomicFile::commit`].
    pub fn destination(&self) -> &Path {
        &self.destination
    }

    /// Flushes, and puts the file in place of whatever stood at the destination.
    ///
    /// # Errors
    /// Writing or renaming failed; the destination is then as it was before.
    pub fn commit(self) -> io::Result<()> {
        drop(self.file.into_inner().map_err(io::IntoInnerError::into_error)?);
        Ok(self.beside.persist(&self.destination)?)
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

/// An error without the path that `tempfile` adds, which is that of the hidden file.
fn unnamed(error: io::Error) -> io::Error {
    match error.to_string().split_once(" at path ") {
        Some((what, _)) => io::Error::new(error.kind(), what.to_owned()),
        None => error,
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

impl Read for AtomicFile {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.file.flush()?;
        self.file.get_mut().read(bytes)
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
    fn a_directory_or_a_missing_directory_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        assert!(AtomicFile::create(dir.path()).is_err());
        assert!(AtomicFile::create(dir.path().join("no/such/dir/a")).is_err());
    }
}
