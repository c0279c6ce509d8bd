//! Files that are slow to make, made once and put into the folders of many tests.

use std::ffi::OsString;
use std::fs;
use std::path::Path;

/// The files of a folder.
pub struct Files(Vec<(OsString, Vec<u8>)>);

impl Files {
    /// Those that `make` puts into an empty folder.
    pub fn made(make: impl FnOnce(&Path)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path());
        let entries = fs::read_dir(folder.path()).unwrap().map(Result::unwrap);
        Self(entries.map(|entry| (entry.file_name(), fs::read(entry.path()).unwrap())).collect())
    }

    /// Writes them into another folder.
    pub fn put(&self, folder: &Path) {
        for (name, bytes) in &self.0 {
            fs::write(folder.join(name), bytes).unwrap();
        }
    }
}
