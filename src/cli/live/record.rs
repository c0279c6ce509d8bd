//! A recording of what is sent.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use handcast_formats::atomic::AtomicFile;
use handcast_formats::mp4::{MuxOptions, mux};
use handcast_live::wire::Plane;

use crate::cli::common::{ending, write_output};

/// Where the planes go.
enum Place {
    /// Into a file beside the one that is wanted.
    Stream(Box<AtomicFile>),
    /// Into memory, to be wrapped at the end.
    Mp4(PathBuf, Vec<u8>),
}

/// The planes sent, in a file that gets its name at the end.
pub struct Recording(Place, u64);

impl Recording {
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        let kind = ending(path);
        if !["fba", "mp4"].contains(&kind.as_str()) {
            refuse!("{}: a recording is .fba or .mp4", path.display());
        }
        if kind == "mp4" {
            return Ok(Self(Place::Mp4(path.to_owned(), Vec::new()), 0));
        }
        let file = AtomicFile::create(path).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(Self(Place::Stream(Box::new(file)), 0))
    }

    pub fn add(&mut self, planes: &[Plane]) -> anyhow::Result<()> {
        for plane in planes {
            self.1 += plane.payload.len() as u64;
            match &mut self.0 {
                Place::Stream(file) => file.write_all(&plane.payload).context("the recording")?,
                Place::Mp4(_, bytes) => bytes.extend(&plane.payload),
            }
        }
        Ok(())
    }

    /// Puts what could be written under its name.
    pub fn rescue(self) -> anyhow::Result<()> {
        match self.0 {
            Place::Stream(file) => file.commit_written().context("the recording"),
            Place::Mp4(..) => self.finish(),
        }
    }

    /// Puts the file under its name. Where nothing was sent there is none.
    pub fn finish(self) -> anyhow::Result<()> {
        if self.1 == 0 {
            errln!("handcast: nothing was sent, so that there is no recording");
            return Ok(());
        }
        match self.0 {
            Place::Stream(file) => file.commit().context("the recording"),
            Place::Mp4(path, bytes) => {
                let file = mux(&bytes, &MuxOptions::default()).with_context(|| path.display().to_string())?;
                write_output(&path, &file)
            }
        }
    }
}
