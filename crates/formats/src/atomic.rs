//! Output files that appear whole or not at all.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// A file written beside its destination and renamed onto it by [`AtomicFile::commit`].
///
/// Dropped without `commit`, it leaves nothing: neither the destination nor the file beside it.
#[derive(Debug)]
pub struct AtomicFile {
    destination: PathBuf,
    beside: PathBuf,
    file: Option<BufWriter<File>>,
}

impl AtomicFile {
    /// Creates the file beside `destination`, in the same directory.
    ///
    /// # Errors
    /// `destination` names no file, or its directory cannot be written.
    pub fn create(destination: impl AsRef<Path>) -> io::Result<Self> {
        // Two writers of one destination, in one process or two, must not share the file beside it.
        static SERIAL: AtomicU32 = AtomicU32::new(0);
        let destination = destination.as_ref().to_path_buf();
        let Some(name) = destination.file_name() else {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "the output path names no file"));
        };
        if destination.is_dir() {
            return Err(io::Error::new(io::ErrorKind::IsADirectory, "the output path is a directory"));
        }
        let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
        let mut hidden = OsString::from(".");
        hidden.push(name);
        hidden.push(format!(".{}-{serial}.part", std::process::id()));
        let beside = destination.with_file_name(hidden);
        let file = OpenOptions::new().read(true).write(true).create_new(true).open(&beside)?;
        Ok(Self { destination, beside, file: Some(BufWriter::new(file)) })
    }

    /// The path the file will have after [`AtomicFile::commit`].
    pub fn destination(&self) -> &Path {
        &self.destination
    }

    /// Flushes, and puts the file in place of whatever stood at the destination.
    ///
    /// # Errors
    /// Writing or renaming failed; the destination is then as it was before.
    pub fn commit(mut self) -> io::Result<()> {
        if let Some(file) = self.file.take() {
            let done = file.into_inner().map_err(io::IntoInnerError::into_error).and_then(|file| {
                drop(file);
                fs::rename(&self.beside, &self.destination)
            });
            if done.is_err() {
                // The first error is the one to report.
                let _ = fs::remove_file(&self.beside);
            }
            done?;
        }
        Ok(())
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

    fn inner(&mut self) -> io::Result<&mut BufWriter<File>> {
        self.file.as_mut().ok_or_else(|| io::Error::other("the file is already in place"))
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.inner()?.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner()?.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner()?.seek(to)
    }
}

impl Read for AtomicFile {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let inner = self.inner()?;
        inner.flush()?;
        inner.get_mut().read(bytes)
    }
}

impl Drop for AtomicFile {
    fn drop(&mut self) {
        if let Some(file) = self.file.take() {
            drop(file.into_parts());
            // Nothing can be reported from here, and a missing file is what is wanted.
            let _ = fs::remove_file(&self.beside);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn a_directory_or_a_missing_directory_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        assert!(AtomicFile::create(dir.path()).is_err());
        assert!(AtomicFile::create(dir.path().join("no/such/dir/a")).is_err());
    }
}
