//! A recording of what is sent.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use handcast_formats::mp4::{MuxOptions, mux};
use handcast_live::wire::Plane;

use crate::cli::common::{ending, write_output};
use crate::cli::files::{begin_partial, set_aside, try_file};

/// The planes sent: NAME.partial.fba beside the file that is wanted, plane by plane, so that a program that is killed leaves what it
/// has recorded; in the end the file.
pub struct Recording {
    path: PathBuf,
    partial: PathBuf,
    file: File,
    /// Bytes of whole planes.
    whole: u64,
}

impl Recording {
    /// That there can be a recording of this name, before the work.
    pub fn check(path: &Path) -> anyhow::Result<()> {
        if !["fba", "mp4"].contains(&ending(path).as_str()) {
            refuse!("{}: a recording is .fba or .mp4", path.display());
        }
        try_file(path)
    }

    pub fn create(path: &Path) -> anyhow::Result<Self> {
        let partial = path.with_extension("partial.fba");
        if partial.is_file() {
            set_aside(&partial, "planes")?;
        }
        let file = begin_partial(&partial)?;
        Ok(Self { path: path.to_owned(), partial, file, whole: 0 })
    }

    pub fn add(&mut self, planes: &[Plane]) -> anyhow::Result<()> {
        for plane in planes {
            self.file.write_all(&plane.payload).context("the recording")?;
            self.whole += plane.payload.len() as u64;
        }
        Ok(())
    }

    /// Whether a plane is in it.
    pub fn is_begun(&self) -> bool {
        self.whole > 0
    }

    /// Puts the planes that are whole under the file's name. Where nothing was sent there is none; where it cannot be written
    /// they stay beside it.
    pub fn finish(self) -> anyhow::Result<()> {
        if !self.is_begun() {
            errln!("handcast: there was nothing to record, so that there is no recording");
            return Ok(());
        }
        self.placed().with_context(|| format!("what was recorded is in {}", self.partial.display()))
    }

    fn placed(&self) -> anyhow::Result<()> {
        self.file.set_len(self.whole).context("the recording")?;
        if ending(&self.path) == "fba" && fs::symlink_metadata(&self.path).is_err() {
            return fs::rename(&self.partial, &self.path).context("the recording");
        }
        let stream = fs::read(&self.partial).context("the recording")?;
        if ending(&self.path) == "mp4" {
            let file = mux(&stream, &MuxOptions::default());
            write_output(&self.path, &file.with_context(|| self.path.display().to_string())?)?;
        } else {
            write_output(&self.path, &stream)?;
        }
        fs::remove_file(&self.partial).context("the recording")
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        if self.whole == 0 {
            // Nobody misses an empty file.
            let _ = fs::remove_file(&self.partial);
        }
    }
}
