//! A recording of what is sent.

use std::fs::{self, File};
use std::io::{self, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use handcast_fba::syntax::SEQUENCE_END;
use handcast_formats::mp4::{MuxOptions, mux};
use handcast_live::wire::Plane;

use crate::cli::common::{ending, write_output};
use crate::cli::files::{begin_partial, set_aside, try_file};

use super::passed::{Passed, Pipe};

/// The code that ends a stream.
const END: [u8; 4] = SEQUENCE_END.to_be_bytes();

/// Where a recording goes.
pub enum Place {
    /// Into a file.
    File(PathBuf),
    /// Into a pipe, a device or standard output, plane by plane, which holds up nobody.
    Passed(Pipe),
}

/// Whether a name means standard output, whatever that is.
pub fn is_standard_output(path: &Path) -> bool {
    ["-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"].iter().any(|name| path == Path::new(name))
}

impl Place {
    /// That of this name, before the work: a file is one that can be written, a pipe is opened, which waits for its reader.
    pub fn of(path: &Path, quiet: bool) -> anyhow::Result<Self> {
        if is_standard_output(path) {
            let name = "standard output".into();
            return Ok(Self::Passed(Pipe { name, into: Box::new(io::stdout()), quiet }));
        }
        if fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
            if ending(path) == "mp4" {
                refuse!("{}: into a pipe a recording goes as the stream is, not as .mp4", path.display());
            }
            if !quiet {
                errln!("waiting for who reads {}", path.display());
            }
            let name = path.display().to_string();
            let into = File::options().write(true).open(path).with_context(|| name.clone())?;
            return Ok(Self::Passed(Pipe { name, into: Box::new(into), quiet }));
        }
        if !["fba", "mp4"].contains(&ending(path).as_str()) {
            refuse!("{}: a recording is .fba or .mp4", path.display());
        }
        try_file(path)?;
        Ok(Self::File(path.to_owned()))
    }
}

/// The planes sent. Of a file they are in NAME.partial.fba beside it, plane by plane and with the end of the stream behind the
/// last one, so that a program that is killed, and a disk that is full, leave what was recorded; in the end they are the file.
pub struct Recording {
    sink: Sink,
    /// Bytes of whole planes, and whether they end the stream.
    whole: u64,
    ended: bool,
}

enum Sink {
    Beside { path: PathBuf, partial: PathBuf, file: File },
    Passed(Passed),
}

impl Sink {
    fn name(&self) -> String {
        match self {
            Self::Beside { path, .. } => format!("the recording {}", path.display()),
            Self::Passed(into) => format!("the recording into {}", into.name()),
        }
    }

    fn add(&mut self, whole: u64, payload: &[u8], ended: bool) -> io::Result<()> {
        match self {
            Self::Beside { file, .. } => {
                file.seek(SeekFrom::Start(whole))?;
                let end: &[u8] = if ended { &[] } else { &END };
                file.write_all(&[payload, end].concat())
            }
            Self::Passed(into) => into.add(payload),
        }
    }

    /// Puts the end behind whole planes again. There is room for it: it stood there.
    fn cut(&mut self, whole: u64, ended: bool) -> io::Result<()> {
        let Self::Beside { file, .. } = self else { return Ok(()) };
        let end: &[u8] = if ended { &[] } else { &END };
        file.seek(SeekFrom::Start(whole))?;
        file.write_all(end)?;
        file.set_len(whole + end.len() as u64)
    }
}

impl Recording {
    pub fn create(place: Place) -> anyhow::Result<Self> {
        let sink = match place {
            Place::Passed(pipe) => Sink::Passed(Passed::new(pipe).context("the recording")?),
            Place::File(path) => {
                let partial = path.with_extension("partial.fba");
                if partial.is_file() {
                    set_aside(&partial, "planes")?;
                }
                let file = begin_partial(&partial)?;
                Sink::Beside { path, partial, file }
            }
        };
        Ok(Self { sink, whole: 0, ended: false })
    }

    /// Adds planes; where one cannot be written, or too many wait in a pipe for their reader, those before it are the recording.
    pub fn add(&mut self, planes: &[Plane]) -> anyhow::Result<()> {
        for Plane { payload, .. } in planes.iter().filter(|plane| !plane.payload.is_empty()) {
            let ended = payload.ends_with(&END);
            if let Err(error) = self.sink.add(self.whole, payload, ended) {
                if self.is_begun() {
                    self.sink.cut(self.whole, self.ended).context("the recording has no end")?;
                }
                return Err(error).with_context(|| self.sink.name());
            }
            self.whole += payload.len() as u64;
            self.ended = ended;
        }
        Ok(())
    }

    /// Whether a plane is in it.
    pub fn is_begun(&self) -> bool {
        self.whole > 0
    }

    /// Whether it goes into a pipe, where planes may wait for who reads them.
    pub fn is_passed(&self) -> bool {
        matches!(self.sink, Sink::Passed(_))
    }

    /// Puts the planes under the file's name, or waits until a pipe has taken those that it can. Where nothing was sent there is none,
    /// which is an error; where it cannot be written they stay beside it.
    pub fn finish(mut self) -> anyhow::Result<()> {
        if !self.is_begun() {
            bail!("there was nothing to record, so that there is no recording");
        }
        match &mut self.sink {
            Sink::Beside { path, partial, .. } => placed(path, partial)
                .with_context(|| format!("what was recorded is in {}", partial.display())),
            Sink::Passed(into) => into.finish().with_context(|| self.sink.name()),
        }
    }
}

/// Makes the file of what is beside it.
fn placed(path: &Path, partial: &Path) -> anyhow::Result<()> {
    if ending(path) == "fba" && fs::symlink_metadata(path).is_err() {
        return fs::rename(partial, path).context("the recording");
    }
    let stream = fs::read(partial).context("the recording")?;
    if ending(path) == "mp4" {
        let file = mux(&stream, &MuxOptions::default());
        write_output(path, &file.with_context(|| path.display().to_string())?)?;
    } else {
        write_output(path, &stream)?;
    }
    fs::remove_file(partial).context("the recording")
}

impl Drop for Recording {
    fn drop(&mut self) {
        if let Sink::Beside { partial, .. } = &self.sink
            && self.whole == 0
        {
            // Nobody misses an empty file.
            let _ = fs::remove_file(partial);
        }
    }
}
