//! The overlay of a tracked clip: drawn as frames come, compressed and written on a thread of its own.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use handcast::io::atomic::AtomicFile;
use handcast::io::avi::MjpegWriter;
use handcast::pipeline::{TrackedFrame, draw_overlay};
use image::RgbImage;

/// Pictures that may wait for the writer.
const AHEAD: usize = 8;
/// JPEG quality.
const QUALITY: u8 = 80;

/// The overlay while it is made. Dropped without [`Overlay::finish`], it leaves nothing.
pub struct Overlay {
    path: PathBuf,
    rate: f64,
    /// Begun with the first picture, which tells the size.
    writer: Option<Writer>,
    drawing: Duration,
}

/// An overlay that is complete but not yet under its name.
pub struct Finished {
    pub file: AtomicFile,
    /// Time spent drawing and writing it.
    pub time: Duration,
}

impl Overlay {
    /// An overlay to be put at `path`, of `rate` frames per second.
    pub fn new(path: PathBuf, rate: f64) -> Self {
        Self { path, rate, writer: None, drawing: Duration::ZERO }
    }

    /// Draws a frame and hands it to the writer. Fails with what went wrong in writing the frames before.
    pub fn draw(&mut self, frame: &mut TrackedFrame<'_>) -> anyhow::Result<()> {
        let begun = Instant::now();
        let picture = draw_overlay(frame);
        self.drawing += begun.elapsed();
        let writer = match &mut self.writer {
            Some(writer) => writer,
            empty => {
                let file = AtomicFile::create(&self.path)?;
                let rate = MjpegWriter::<AtomicFile>::rate_of(self.rate);
                empty.insert(Writer::start(MjpegWriter::new(file, picture.dimensions(), rate, QUALITY)?)?)
            }
        };
        writer.write(picture)
    }

    /// Waits for the writer and completes the file; there is none of a clip without frames.
    pub fn finish(self) -> anyhow::Result<Option<Finished>> {
        let Some(mut writer) = self.writer else { return Ok(None) };
        let (video, writing) = writer.join()?;
        Ok(Some(Finished { file: video.finish()?, time: self.drawing + writing }))
    }
}

/// A video, and the time spent on it.
type Written = anyhow::Result<(MjpegWriter<AtomicFile>, Duration)>;

/// The thread that writes.
struct Writer {
    pictures: Option<SyncSender<RgbImage>>,
    thread: Option<JoinHandle<Written>>,
}

impl Writer {
    fn start(video: MjpegWriter<AtomicFile>) -> anyhow::Result<Self> {
        let (pictures, receiver) = sync_channel(AHEAD);
        let thread = Builder::new().name("overlay".to_owned()).spawn(move || write_all(video, &receiver))?;
        Ok(Self { pictures: Some(pictures), thread: Some(thread) })
    }

    fn write(&mut self, picture: RgbImage) -> anyhow::Result<()> {
        if self.pictures.as_ref().is_some_and(|pictures| pictures.send(picture).is_ok()) {
            return Ok(());
        }
        // Nobody listens any more: the thread has ended with an error.
        self.join().and_then(|_| Err(broke_down()))
    }

    /// Waits until all pictures are written.
    fn join(&mut self) -> Written {
        // The thread ends when no more pictures can come.
        self.pictures = None;
        self.thread.take().and_then(|thread| thread.join().ok()).unwrap_or_else(|| Err(broke_down()))
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // Takes the unfinished file away before the program can end.
        let _ = self.join();
    }
}

fn broke_down() -> anyhow::Error {
    anyhow!("the thread that writes it broke down")
}

fn write_all(mut video: MjpegWriter<AtomicFile>, pictures: &Receiver<RgbImage>) -> Written {
    let mut time = Duration::ZERO;
    for picture in pictures {
        let begun = Instant::now();
        video.write(&picture)?;
        time += begun.elapsed();
    }
    Ok((video, time))
}
