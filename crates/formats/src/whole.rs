//! Files that are read as a whole.

use std::cell::Cell;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::rc::Rc;

use handcast_limits::{Excess, Limit, Limits};
use thiserror::Error;

/// Why a file could not be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WholeError {
    /// Reading failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// It has more bytes than allowed.
    #[error(transparent)]
    Excess(#[from] Excess),
}

/// Reads a file. One that says how long it is gets so much memory and is refused by that; of a pipe or device no more is
/// read than [`Limits::piped_bytes`].
///
/// # Errors
/// See [`WholeError`].
pub fn read_whole(path: &Path, limits: &Limits) -> Result<Vec<u8>, WholeError> {
    let file = File::open(path)?;
    let found = file.metadata()?;
    if !found.is_file() {
        return read_piped(file, limits);
    }
    limits.check(Limit::Bytes, found.len() as f64)?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(found.len()).unwrap_or(usize::MAX)).map_err(out_of_memory)?;
    // It may grow while it is read.
    file.take(found.len()).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads to the end of what does not say how long it is.
///
/// # Errors
/// See [`WholeError`].
pub fn read_piped(reader: impl Read, limits: &Limits) -> Result<Vec<u8>, WholeError> {
    let mut bytes = Vec::new();
    reader.take(limits.piped_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    limits.check_count(Limit::PipedBytes, bytes.len())?;
    Ok(bytes)
}

/// A reader that counts bytes, and fails beyond [`Limits::bytes`].
pub struct Counted<R> {
    reader: R,
    limits: Limits,
    count: Rc<Cell<u64>>,
}

impl<R> Counted<R> {
    /// A reader of what `reader` reads.
    pub fn new(reader: R, limits: &Limits) -> Self {
        Self { reader, limits: limits.clone(), count: Rc::default() }
    }

    /// How many bytes it has read.
    pub fn count(&self) -> Rc<Cell<u64>> {
        Rc::clone(&self.count)
    }
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.reader.read(buffer)?;
        self.count.set(self.count.get() + count as u64);
        self.limits.check(Limit::Bytes, self.count.get() as f64).map_err(io::Error::other)?;
        Ok(count)
    }
}

fn out_of_memory(_: std::collections::TryReserveError) -> io::Error {
    io::ErrorKind::OutOfMemory.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_files_are_refused_by_their_size_and_pipes_by_what_comes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, b"12345").unwrap();
        let limits = Limits::default().with_bytes(5);
        assert_eq!(read_whole(&path, &limits).unwrap(), b"12345");
        let refused = |error: WholeError| matches!(error, WholeError::Excess(_));
        assert!(refused(read_whole(&path, &Limits::default().with_bytes(4)).unwrap_err()));
        assert!(refused(read_piped(io::repeat(0), &limits).unwrap_err()));
        #[cfg(unix)]
        assert!(refused(read_whole(Path::new("/dev/zero"), &limits).unwrap_err()));
        assert!(matches!(read_whole(&dir.path().join("none"), &limits), Err(WholeError::Io(_))));
    }
}
