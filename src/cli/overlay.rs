//! The overlay of a tracked clip: drawn as frames come, compressed and written on a thread of its own.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use handcast_formats::atomic::AtomicFile;
use handcast_media::avi::MjpegWriter;
#[cfg(feature = "h264")]
use handcast_media::film::{FilmWriter, TICKS, USUAL_RATE};
use handcast_render::draw_overlay;
use handcast_track::pipeline::TrackedFrame;
use image::RgbImage;

use super::common::ending;

/// Pictures that may wait for the writer.
const AHEAD: usize = 8;
/// Shortest time that a picture of a film is shown, seconds.
#[cfg(feature = "h264")]
const SHORTEST: f64 = 0.001;
/// Longest time, seconds, for which a picture is written again and again, as an .avi has it, and for which the last one is shown,
/// whose time nothing tells.
const LONGEST: f64 = 10.0;
/// JPEG quality.
const QUALITY: u8 = 80;

/// The overlay while it is made. Dropped without [`Overlay::finish`], it leaves nothing.
pub struct Overlay {
    path: PathBuf,
    /// Pictures a second, where their times do not tell.
    rate: f64,
    /// Begun with the first picture, which tells the size.
    writer: Option<Writer>,
    size: (u32, u32),
    drawing: Duration,
}

/// An overlay that is complete but not yet under its name.
pub struct Finished {
    pub file: AtomicFile,
    /// Time spent drawing and writing it.
    pub time: Duration,
    /// Width and height, pixels.
    size: (u32, u32),
}

impl Finished {
    /// How large it is, where that is not the clip's size.
    pub fn in_words(&self, clip: (u32, u32)) -> String {
        let [(width, height), (of_clip, high)] = [self.size, clip];
        if self.size == clip {
            return String::new();
        }
        format!(", {width}x{height}, as the pictures of {of_clip}x{high} were looked at")
    }
}

impl Overlay {
    /// An overlay to be put at `path`, of about `rate` frames per second: films show each frame as long as the clip does.
    pub fn new(path: PathBuf, rate: f64) -> Self {
        Self { path, rate, writer: None, size: (0, 0), drawing: Duration::ZERO }
    }

    /// Draws a frame and hands it to the writer. Fails with what went wrong in writing the frames before.
    pub fn draw(&mut self, frame: &mut TrackedFrame<'_>) -> anyhow::Result<()> {
        let begun = Instant::now();
        let picture = draw_overlay(frame);
        self.drawing += begun.elapsed();
        let writer = match &mut self.writer {
            Some(writer) => writer,
            empty => {
                self.size = picture.dimensions();
                let video = Video::begin(&self.path, self.rate, picture.dimensions())?;
                empty.insert(Writer::start(video, self.rate)?)
            }
        };
        writer.write(picture, frame.time)
    }

    /// Waits for the writer and completes the file; there is none of a clip without frames.
    pub fn finish(self) -> anyhow::Result<Option<Finished>> {
        let Some(mut writer) = self.writer else { return Ok(None) };
        let (video, writing) = writer.join()?;
        Ok(Some(Finished { file: video.finish()?, time: self.drawing + writing, size: self.size }))
    }
}

/// The endings of names of overlays, best first.
pub const ENDINGS: &[&str] = if cfg!(feature = "h264") { &["mp4", "avi"] } else { &["avi"] };

/// Whether an overlay can have this name.
pub fn check(path: &Path) -> anyhow::Result<()> {
    let known = ENDINGS.contains(&ending(path).as_str());
    let allowed = ENDINGS.join(", .");
    let lacking = if cfg!(feature = "h264") { "" } else { "; this program is built without H.264" };
    if !known {
        refuse!("{}: cannot write such an overlay, allowed are .{allowed}{lacking}", path.display());
    }
    Ok(())
}

/// A video in the making: H.264, or pictures as JPEG.
enum Video {
    #[cfg(feature = "h264")]
    Film(Box<FilmWriter<AtomicFile>>),
    /// With the time that one picture takes, and the time by which those written are behind, seconds.
    Jpeg { video: MjpegWriter<AtomicFile>, period: f64, behind: f64 },
}

impl Video {
    fn begin(path: &Path, rate: f64, size: (u32, u32)) -> anyhow::Result<Self> {
        let file = AtomicFile::create(path)?;
        #[cfg(feature = "h264")]
        if ending(path) == "mp4" {
            let film = FilmWriter::new(file, size, rate.clamp(0.1, 1000.0), USUAL_RATE)?;
            return Ok(Self::Film(Box::new(film)));
        }
        let told = MjpegWriter::<AtomicFile>::rate_of(rate);
        let video = MjpegWriter::new(file, size, told, QUALITY)?;
        Ok(Self::Jpeg { video, period: rate.recip(), behind: 0.0 })
    }

    /// Appends a picture that is shown for so many seconds.
    fn write(&mut self, picture: &RgbImage, seconds: f64) -> anyhow::Result<()> {
        match self {
            #[cfg(feature = "h264")]
            Self::Film(film) => {
                film.write(picture, (seconds.max(SHORTEST) * f64::from(TICKS)).round() as u32)?;
            }
            Self::Jpeg { video, period, behind } => {
                video.write(picture)?;
                *behind += seconds.clamp(0.0, LONGEST) - *period;
                // Where the clip dropped frames, the one before is shown on.
                while *behind > 0.5 * *period {
                    video.write(picture)?;
                    *behind -= *period;
                }
            }
        }
        Ok(())
    }

    fn finish(self) -> anyhow::Result<AtomicFile> {
        Ok(match self {
            #[cfg(feature = "h264")]
            Self::Film(film) => film.finish()?,
            Self::Jpeg { video, .. } => video.finish()?,
        })
    }
}

/// A video, and the time spent on it.
type Written = anyhow::Result<(Video, Duration)>;

/// The thread that writes.
struct Writer {
    /// Pictures and the times at which they are shown first, seconds.
    pictures: Option<SyncSender<(RgbImage, f64)>>,
    thread: Option<JoinHandle<Written>>,
}

impl Writer {
    fn start(video: Video, rate: f64) -> anyhow::Result<Self> {
        let (pictures, receiver) = sync_channel(AHEAD);
        let thread =
            Builder::new().name("overlay".to_owned()).spawn(move || write_all(video, &receiver, rate))?;
        Ok(Self { pictures: Some(pictures), thread: Some(thread) })
    }

    fn write(&mut self, picture: RgbImage, time: f64) -> anyhow::Result<()> {
        if self.pictures.as_ref().is_some_and(|pictures| pictures.send((picture, time)).is_ok()) {
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

fn write_all(mut video: Video, pictures: &Receiver<(RgbImage, f64)>, rate: f64) -> Written {
    let mut time = Duration::ZERO;
    let mut write = |picture: &RgbImage, seconds: f64| {
        let begun = Instant::now();
        let written = video.write(picture, seconds);
        time += begun.elapsed();
        written
    };
    // A picture is shown until the next one comes, the last as long as the one before it.
    let (mut waits, mut shown) = (None, 1.0 / rate);
    for (picture, at) in pictures {
        if let Some((before, since)) = waits.replace((picture, at)) {
            shown = at - since;
            write(&before, shown)?;
        }
    }
    if let Some((picture, _)) = waits {
        write(&picture, shown.min(LONGEST))?;
    }
    Ok((video, time))
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_track::pipeline::StageTimes;
    use std::io::Cursor;

    fn picture(number: u32, width: u32) -> RgbImage {
        RgbImage::from_fn(width, 24, |x, y| image::Rgb([x, y, number].map(|v| (v * 5 % 251) as u8)))
    }

    fn draw(overlay: &mut Overlay, index: usize, image: &RgbImage) -> anyhow::Result<()> {
        draw_at(overlay, index, 0.0, image)
    }

    fn draw_at(overlay: &mut Overlay, index: usize, time: f64, image: &RgbImage) -> anyhow::Result<()> {
        let spent = StageTimes::default();
        overlay.draw(&mut TrackedFrame { index, time, image, parts: Ok(&[]), hands: Vec::new(), spent })
    }

    fn is_empty(folder: &Path) -> bool {
        std::fs::read_dir(folder).unwrap().next().is_none()
    }

    #[test]
    fn the_file_is_what_one_thread_writes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("overlay.avi");
        let mut overlay = Overlay::new(path.clone(), 30.0);
        let rate = MjpegWriter::<AtomicFile>::rate_of(30.0);
        let mut alone = MjpegWriter::new(Cursor::new(Vec::new()), (40, 24), rate, QUALITY).unwrap();
        for i in 0..3 * AHEAD {
            let image = picture(i as u32, 40);
            draw(&mut overlay, i, &image).unwrap();
            alone.write(&image).unwrap();
        }
        overlay.finish().unwrap().unwrap().file.commit().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), alone.finish().unwrap().into_inner());
    }

    #[test]
    fn a_picture_is_shown_until_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let times = [0.0, 0.5, 95.25, 96.0];
        let shown = |name: &str| {
            let path = folder.path().join(name);
            let mut overlay = Overlay::new(path.clone(), 4.0);
            for (i, time) in times.into_iter().enumerate() {
                draw_at(&mut overlay, i, time, &picture(40 * i as u32, 40)).unwrap();
            }
            overlay.finish().unwrap().unwrap().file.commit().unwrap();
            let open = handcast_media::OpenOptions::default().with_ffmpeg(None);
            let mut source = handcast_media::open(&path, &open).unwrap();
            let mut times = Vec::new();
            while let Some(frame) = source.next_frame().unwrap() {
                times.push(frame.time);
            }
            times
        };
        if cfg!(feature = "h264") {
            let found = shown("x.mp4");
            assert_eq!(found.len(), 4);
            assert!(found.iter().zip(times).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
        }
        // Four a second, as often as it takes: of the long one no more than ten seconds.
        let found = shown("x.avi");
        assert_eq!(found.len(), 2 + 40 + 3 + 3, "{found:?}");
    }

    #[test]
    fn faults_of_the_writer_end_the_work_and_leave_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("overlay.avi");
        let mut overlay = Overlay::new(path.clone(), 30.0);
        draw(&mut overlay, 0, &picture(0, 40)).unwrap();
        draw(&mut overlay, 1, &picture(1, 48)).unwrap();
        // The thread may take its time; at most the pictures that may wait are taken before it is seen.
        let seen = (2..AHEAD + 4).find_map(|i| draw(&mut overlay, i, &picture(0, 40)).err());
        let error = seen.unwrap_or_else(|| overlay.finish().err().unwrap());
        assert!(error.to_string().contains("picture of 48 x 24 pixels in a video of 40 x 24"), "{error:#}");
        assert!(is_empty(folder.path()));
        let mut dropped = Overlay::new(path, 30.0);
        draw(&mut dropped, 0, &picture(0, 40)).unwrap();
        drop(dropped);
        assert!(is_empty(folder.path()));
        assert!(Overlay::new(folder.path().join("none.avi"), 30.0).finish().unwrap().is_none());
    }
}
