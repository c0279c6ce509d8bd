//! Pictures in order with their times, from any of the inputs the program reads.
//!
//! [`open`] looks at the content, not at the name, and gives a [`FrameSource`]. Frames come one at a
//! time, in presentation order; a source keeps only what its decoder needs.

mod animation;
pub mod avi;
mod camera;
mod ffmpeg;
#[cfg(feature = "h264")]
pub mod film;
mod folder;
#[cfg(feature = "h264")]
mod iso;
mod mjpeg;
#[cfg(feature = "h264")]
mod mp4;
mod network;
mod prefetch;
#[cfg(feature = "h264")]
mod rate;
#[cfg(feature = "h264")]
mod sps;
mod y4m;
mod yuv;

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use handcast_limits::Limits;
use image::RgbImage;
use thiserror::Error;

pub use camera::{Camera, CameraOptions, cameras, open_camera};
pub use network::Address;
pub use prefetch::Prefetch;
pub use yuv::YuvMatrix;

/// Largest picture side that is decoded by default, in pixels.
pub const MAX_SIDE: u32 = handcast_limits::DEFAULT.side as u32;
/// Largest picture that is decoded by default, in pixels.
pub const MAX_PIXELS: u64 = handcast_limits::DEFAULT.pixels;

/// One picture of a clip.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Position in the clip, from 0, in presentation order; pictures that could not be decoded are counted as well.
    pub index: usize,
    /// Presentation time in seconds from the first frame.
    pub time: f64,
    /// The picture, scaled down if [`OpenOptions::max_side`] or [`FrameSource::set_max_side`] asked for it.
    pub image: RgbImage,
}

/// What is known of a clip before its frames are read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClipInfo {
    /// Width of the clip as it is shown (turned, and with square pixels, as the file asks for), in pixels.
    pub width: u32,
    /// Height of the clip as it is shown, in pixels.
    pub height: u32,
    /// Frames per second, of a clip that dropped frames those of its camera, the mean if they vary without a beat; `None` for a
    /// still picture or when unknown.
    pub rate: Option<f64>,
    /// Number of frames that are there to be shown, where it is known in advance: by tables or an index, or a list of files.
    pub frames: Option<usize>,
    /// Number of frames that the input says it has, where these are more: its end is missing.
    pub told: Option<usize>,
    /// What the input is, for people: `mp4 h264`, `gif`, `folder of 12 pictures`…
    pub format: String,
    /// Number of frames before the part that is read, where [`ClipInfo::frames`] tells.
    pub before: usize,
    /// Seconds of the file at which its first picture is shown, from which the times of its frames count; 0 where it tells none.
    pub start: f64,
    /// What is worth saying of it: pictures that seem to be missing, say.
    pub notes: Vec<String>,
}

/// Seconds of a file from which on it is told that its pictures begin late.
const LATE: f64 = 0.1;

impl ClipInfo {
    /// What is worth saying of it, in words: its [notes](Self::notes), and when its pictures begin if that is late.
    pub fn notices(&self) -> Vec<String> {
        let late = (self.start >= LATE).then(|| {
            format!(
                "its pictures begin {:.3} s into the file; times of poses count from the first one",
                self.start
            )
        });
        late.into_iter().chain(self.notes.iter().cloned()).collect()
    }
}

/// Pictures in presentation order.
pub trait FrameSource: Send {
    /// Size, rate, number of frames and format.
    fn info(&self) -> &ClipInfo;

    /// Asks for pictures box-filtered down so that the longer side is at most `side` pixels (at least 16), as
    /// [`OpenOptions::max_side`] does; a smaller side asked for before stays. To be called before the first
    /// picture is read: what comes of it later is up to the source. The info goes on telling the size as stored.
    fn set_max_side(&mut self, side: u32);

    /// When the pictures that are there are shown, seconds in rising order, where it is known in advance.
    fn times(&self) -> Option<Vec<f64>> {
        None
    }

    /// Asks for the pictures from `seconds` on, as fast as they can be had; some before that may come all the same, each with
    /// its own time and number. To be called before the first picture is read.
    ///
    /// # Errors
    /// The input cannot be read there.
    fn skip_to(&mut self, seconds: f64) -> Result<(), FrameError> {
        let _ = seconds;
        Ok(())
    }

    /// The next picture, `None` after the last.
    ///
    /// # Errors
    /// The input is damaged or uses what is not supported; after an error the source is at its end. Where [`open`] gave it,
    /// damage behind the first picture is passed over, or ends it as the [`shortfall`](Self::shortfall) then tells.
    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError>;

    /// After the last picture: what of the clip could not be shown, in words: which damage was passed over or ended it, and
    /// how many of how many pictures there were.
    fn shortfall(&self) -> Option<String> {
        None
    }
}

impl FrameSource for Box<dyn FrameSource> {
    fn info(&self) -> &ClipInfo {
        self.as_ref().info()
    }

    fn set_max_side(&mut self, side: u32) {
        self.as_mut().set_max_side(side);
    }

    fn times(&self) -> Option<Vec<f64>> {
        self.as_ref().times()
    }

    fn skip_to(&mut self, seconds: f64) -> Result<(), FrameError> {
        self.as_mut().skip_to(seconds)
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        self.as_mut().next_frame()
    }

    fn shortfall(&self) -> Option<String> {
        self.as_ref().shortfall()
    }
}

/// How to read an input.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct OpenOptions {
    /// Frames per second of inputs that do not say: folders, globs, Y4M without a rate.
    pub rate: f64,
    /// Deliver pictures box-filtered down so that the longer side is at most this; `None` keeps them.
    pub max_side: Option<u32>,
    /// The program that decodes what this crate does not; `None` forbids it.
    pub ffmpeg: Option<PathBuf>,
    /// How large pictures may be, and how many a clip's tables may list.
    pub limits: Limits,
    /// The part of the clip that is read.
    pub part: Part,
}

/// A part of a clip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Seconds from the clip's first picture on.
    pub from: f64,
    /// Seconds from the clip's first picture at which it has ended.
    pub until: f64,
    /// Whether pictures must have their numbers, though those before the part be read for that.
    pub numbered: bool,
}

impl Part {
    /// All of it.
    pub const WHOLE: Self = Self { from: 0.0, until: f64::INFINITY, numbered: false };

    /// Whether it is all of the clip.
    pub fn is_whole(&self) -> bool {
        self.from <= 0.0 && self.until == f64::INFINITY
    }

    /// The numbers of those of `times`, in rising order, that lie in it.
    fn of(&self, times: &[f64]) -> std::ops::Range<usize> {
        let at = |end: f64| times.partition_point(|time| *time < end - ROUNDED);
        at(self.from)..at(self.until).max(at(self.from))
    }

    /// Whether a time lies in it; before its first picture a clip has none.
    pub fn has(&self, time: f64) -> bool {
        (self.from <= 0.0 || time >= self.from - ROUNDED) && time < self.until - ROUNDED
    }
}

/// How far times may be rounded to lie within a part, seconds.
const ROUNDED: f64 = 1e-6;

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            rate: 30.0,
            max_side: None,
            ffmpeg: Some(PathBuf::from("ffmpeg")),
            limits: Limits::default(),
            part: Part::WHOLE,
        }
    }
}

impl OpenOptions {
    /// Sets [`OpenOptions::rate`].
    pub fn with_rate(mut self, rate: f64) -> Self {
        self.rate = rate;
        self
    }

    /// Sets [`OpenOptions::max_side`].
    pub fn with_max_side(mut self, side: u32) -> Self {
        self.max_side = Some(side);
        self
    }

    /// Sets [`OpenOptions::ffmpeg`].
    pub fn with_ffmpeg(mut self, program: Option<PathBuf>) -> Self {
        self.ffmpeg = program;
        self
    }

    /// Sets [`OpenOptions::part`].
    pub fn with_part(mut self, part: Part) -> Self {
        self.part = part;
        self
    }

    /// Sets [`OpenOptions::limits`].
    pub fn with_limits(mut self, limits: Limits) -> Self {
        self.limits = limits;
        self
    }
}

/// Why an input gave no picture.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FrameError {
    /// There is no such file, folder or match of a pattern.
    #[error("{path}: no such file or folder")]
    NotFound {
        /// The input as given.
        path: String,
    },
    /// The input has no bytes, or the folder no pictures.
    #[error("{path}: {what}")]
    Empty {
        /// The input as given.
        path: String,
        /// What is missing.
        what: &'static str,
    },
    /// A folder or a pattern has clips where pictures of one are read.
    #[error("{path}: no pictures but clips, {first} the first of them: one clip is read at a time")]
    Clips {
        /// The input as given.
        path: String,
        /// The first clip.
        first: String,
    },
    /// The content is neither a video nor a picture.
    #[error("{path}: not a video or a picture ({what})")]
    NotAVideo {
        /// The input as given.
        path: String,
        /// What the content looks like instead.
        what: String,
    },
    /// The input ends too early.
    #[error("{path}: truncated: {what}")]
    Truncated {
        /// The input as given.
        path: String,
        /// Where it ends and what should have followed.
        what: String,
    },
    /// The input breaks the rules of its format.
    #[error("{path}: damaged: {what}")]
    Malformed {
        /// The input as given.
        path: String,
        /// The rule, and where it is broken.
        what: String,
    },
    /// The input is valid but needs a decoder that is not here.
    #[error("{path}: {codec} is not decoded here{hint}")]
    UnsupportedCodec {
        /// The input as given.
        path: String,
        /// The codec or the feature of it.
        codec: String,
        /// What would help.
        hint: String,
    },
    /// A picture of a folder is of another size than those before.
    #[error("{path}: picture of {} x {} pixels after pictures of {} x {}; those of a clip are of one size", size.0, size.1, first.0, first.1)]
    OtherSize {
        /// The picture.
        path: String,
        /// Its width and height, pixels.
        size: (u32, u32),
        /// Those of the first one.
        first: (u32, u32),
    },
    /// A picture is larger than [`OpenOptions::limits`] allow, or has no pixels.
    #[error(
        "{path}: picture of {width} x {height} pixels; allowed are 1 to {side} a side and {pixels} in all"
    )]
    Size {
        /// The input as given.
        path: String,
        /// Width found.
        width: u64,
        /// Height found.
        height: u64,
        /// Largest side allowed.
        side: u64,
        /// Most pixels allowed.
        pixels: u64,
    },
    /// There is more of something than allowed.
    #[error("{path}: {excess}")]
    Excess {
        /// The input as given.
        path: String,
        /// Of what, how much, and how much is allowed.
        excess: handcast_limits::Excess,
    },
    /// The helper program failed.
    #[error("{path}: {program} failed: {message}")]
    Helper {
        /// The input as given.
        path: String,
        /// The program that was started.
        program: String,
        /// What it said last.
        message: String,
    },
    /// An option has a value that makes no sense.
    #[error("{what}")]
    Option {
        /// The option, the value and what is allowed.
        what: String,
    },
    /// Reading failed.
    #[error("{path}: {source}")]
    Io {
        /// The input as given.
        path: String,
        /// The system's error.
        source: io::Error,
    },
}

impl FrameError {
    /// What is wrong without the input's name, where it is the input that is: it ends too early, is damaged, or uses what no
    /// decoder here knows.
    fn damage(&self) -> Option<String> {
        match self {
            Self::Truncated { what, .. } => Some(format!("truncated: {what}")),
            Self::Malformed { what, .. } => Some(format!("damaged: {what}")),
            Self::UnsupportedCodec { codec, hint, .. } => Some(format!("{codec} is not decoded here{hint}")),
            Self::Helper { program, message, .. } => Some(format!("{program} failed: {message}")),
            _ => None,
        }
    }
}

/// Opens a clip, a picture, a folder, a pattern (`shots/*.png`, `shots/%03d.png`), what is at an address (`https://…`, `rtsp://…`: see
/// [`Address`]) through the helper program, or, for `-`, Y4M on standard input.
///
/// # Errors
/// One [`FrameError`] variant for each thing that can be wrong; the first frame of compressed video is
/// decoded here so that an undecodable file fails at once.
pub fn open(input: impl AsRef<Path>, options: &OpenOptions) -> Result<Box<dyn FrameSource>, FrameError> {
    check_options(options)?;
    let input = input.as_ref();
    let source = open_by_content(input, options)?;
    // A stream of the network has no end that could be missing: that it stops is an error.
    let passes = !matches!(Address::of(input), Ok(Some(Address::Stream)));
    let mut info = source.info().clone();
    let part = options.part;
    if !part.is_whole() {
        if let Some(times) = source.times() {
            let shown = part.of(&times);
            if shown.is_empty() {
                return Err(no_such_part(input, part, times.last().copied()));
            }
            (info.before, info.frames, info.told) = (shown.start, Some(shown.len()), None);
        } else {
            (info.frames, info.told) = (None, None);
        }
    }
    let name = input.to_owned();
    Ok(Box::new(Ending {
        source,
        info,
        name,
        part,
        passes,
        shown: 0,
        last: None,
        ended: false,
        reached: false,
        damage: None,
    }))
}

/// That a part of a clip, whose last picture is at `last` seconds, has none.
fn no_such_part(input: &Path, part: Part, last: Option<f64>) -> FrameError {
    // Digits in which the two differ.
    let digits = if last.is_some_and(|last| (last - part.from).abs() < 1e-3) { 6 } else { 3 };
    let until = if part.until.is_finite() { format!(" until {:.3} s", part.until) } else { String::new() };
    let last = last.map_or_else(String::new, |last| format!("; its last one is at {last:.digits$} s"));
    let what = format!("{}: no picture lies from {:.digits$} s on{until}{last}", input.display(), part.from);
    FrameError::Option { what }
}

/// The part of a source that is asked for. It has nothing more once it had no picture or an error, and damage behind the first
/// picture ends it.
struct Ending {
    source: Box<dyn FrameSource>,
    info: ClipInfo,
    name: PathBuf,
    part: Part,
    /// Whether damage ends it well.
    passes: bool,
    /// Pictures so far, and the time of the last of them.
    shown: usize,
    last: Option<f64>,
    ended: bool,
    /// Whether there was a picture behind the part.
    reached: bool,
    /// What ended it.
    damage: Option<String>,
}

impl Ending {
    /// The next picture of the part; those before it are passed over.
    fn next_of_part(&mut self) -> Result<Option<Frame>, FrameError> {
        if self.last.is_none() && self.part.from > 0.0 && !self.part.numbered {
            self.source.skip_to(self.part.from)?;
        }
        loop {
            let Some(frame) = self.source.next_frame()? else {
                return match self.shown {
                    0 if !self.part.is_whole() => Err(no_such_part(&self.name, self.part, self.last)),
                    _ => Ok(None),
                };
            };
            if frame.time >= self.part.until - ROUNDED {
                self.reached = true;
                // A source whose times jump back has nothing more, either.
                return match self.shown {
                    0 => Err(no_such_part(&self.name, self.part, None)),
                    _ => Ok(None),
                };
            }
            self.last = Some(frame.time);
            if frame.time >= self.part.from - ROUNDED {
                return Ok(Some(frame));
            }
        }
    }
}

impl FrameSource for Ending {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn set_max_side(&mut self, side: u32) {
        self.source.set_max_side(side);
    }

    fn times(&self) -> Option<Vec<f64>> {
        let times = self.source.times()?;
        times.get(self.part.of(&times)).map(<[f64]>::to_vec)
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        if self.ended {
            return Ok(None);
        }
        match self.next_of_part() {
            Ok(Some(frame)) => {
                self.shown += 1;
                return Ok(Some(frame));
            }
            Ok(None) => {}
            Err(error) => match error.damage().filter(|_| self.passes && self.shown > 0) {
                Some(damage) => self.damage = Some(damage),
                None => {
                    self.ended = true;
                    return Err(error);
                }
            },
        }
        self.ended = true;
        Ok(None)
    }

    fn shortfall(&self) -> Option<String> {
        let info = &self.info;
        let told = info.told.or(info.frames).filter(|told| self.ended && self.shown < *told);
        // What is wrong behind a part that is whole is of no matter.
        let source = self.source.shortfall().filter(|_| !self.reached || told.is_some());
        let wrong: Vec<String> = source.into_iter().chain(self.damage.clone()).collect();
        let last = self.last.unwrap_or(0.0);
        let count = match told {
            Some(told) => format!("of the {told} pictures that it tells of {} are there", self.shown),
            None if wrong.is_empty() => return None,
            None => format!("{} pictures are there, the last at {last:.3} s", self.shown),
        };
        Some(wrong.into_iter().chain([count]).collect::<Vec<_>>().join("; "))
    }
}

/// A source that took the place of another one.
#[cfg(feature = "h264")]
struct Instead {
    source: Box<dyn FrameSource>,
    why: String,
}

#[cfg(feature = "h264")]
impl FrameSource for Instead {
    fn info(&self) -> &ClipInfo {
        self.source.info()
    }

    fn set_max_side(&mut self, side: u32) {
        self.source.set_max_side(side);
    }

    fn times(&self) -> Option<Vec<f64>> {
        self.source.times()
    }

    fn skip_to(&mut self, seconds: f64) -> Result<(), FrameError> {
        self.source.skip_to(seconds)
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        self.source.next_frame()
    }

    fn shortfall(&self) -> Option<String> {
        Some(
            [Some(self.why.clone()), self.source.shortfall()]
                .into_iter()
                .flatten()
                .collect::<Vec<_>>()
                .join("; "),
        )
    }
}

fn open_by_content(path: &Path, options: &OpenOptions) -> Result<Box<dyn FrameSource>, FrameError> {
    if path == Path::new("-") {
        let source = y4m::Y4mSource::open(Box::new(io::stdin()), "standard input", options, None)?;
        return Ok(Box::new(source));
    }
    let name = path.display().to_string();
    if let Some(address) = Address::of(path)? {
        return ffmpeg::open_url(&name, address, options);
    }
    let metadata = match std::fs::metadata(path) {
        Ok(metadata) => metadata,
        // Systems say different things of names that no file can have.
        #[cfg(feature = "pictures")]
        Err(_) if name.contains(['*', '?', '[']) => {
            return Ok(Box::new(folder::FolderSource::from_pattern(&name, options)?));
        }
        Err(_) if name.contains('%') => {
            return Ok(Box::new(folder::FolderSource::from_numbered(path, options)?));
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(FrameError::NotFound { path: name });
        }
        Err(source) => return Err(FrameError::Io { path: name, source }),
    };
    if metadata.is_dir() {
        return Ok(Box::new(folder::FolderSource::from_folder(path, options)?));
    }
    let mut file = File::open(path).map_err(|source| FrameError::Io { path: name.clone(), source })?;
    if !metadata.is_file() {
        // A FIFO or a device can be read only once and only forwards: the pipe format is the only choice.
        return Ok(Box::new(y4m::Y4mSource::open(Box::new(file), &name, options, None)?));
    }
    let head = head_of(&mut file).map_err(|source| FrameError::Io { path: name.clone(), source })?;
    match sniff(&head) {
        Content::Empty => Err(FrameError::Empty { path: name, what: "the file is empty" }),
        Content::Y4m => {
            let file = File::open(path).map_err(|source| FrameError::Io { path: name.clone(), source })?;
            match y4m::Y4mSource::open(Box::new(file), &name, options, None) {
                Err(FrameError::UnsupportedCodec { codec, hint, .. }) if options.ffmpeg.is_none() => {
                    Err(FrameError::UnsupportedCodec { path: name, codec, hint })
                }
                Err(FrameError::UnsupportedCodec { codec, .. }) => ffmpeg::open(path, &name, &codec, options),
                other => Ok(Box::new(other?)),
            }
        }
        Content::Picture(format) => animation::open(path, &name, format, options),
        Content::Avi => match mjpeg::MjpegSource::open(path, &name, options) {
            Err(FrameError::UnsupportedCodec { codec, .. }) => ffmpeg::open(path, &name, &codec, options),
            other => Ok(Box::new(other?)),
        },
        Content::IsoMedia => open_iso(path, &name, options),
        Content::Other(container) => ffmpeg::open(path, &name, container, options),
        Content::Text => Err(FrameError::NotAVideo { path: name, what: "it is text".to_owned() }),
        Content::Unknown => ffmpeg::open_unknown(path, &name, options).map_err(|_| {
            let bytes: Vec<String> = head.iter().take(8).map(|b| format!("{b:02x}")).collect();
            FrameError::NotAVideo { path: name.clone(), what: format!("it begins with {}", bytes.join(" ")) }
        }),
    }
}

#[cfg(feature = "h264")]
fn open_iso(path: &Path, name: &str, options: &OpenOptions) -> Result<Box<dyn FrameSource>, FrameError> {
    // The decoder may break down on what a stranger sends, and that could not be caught.
    if cfg!(panic = "abort") {
        mp4::check(path, name, &options.limits)?;
        return ffmpeg::open(path, name, "mp4 (built with panics that abort)", options);
    }
    match mp4::Mp4Source::open(path, name, options) {
        Err(FrameError::UnsupportedCodec { codec, .. }) => ffmpeg::open(path, name, &codec, options),
        Err(error) => match (error.damage(), ffmpeg::open(path, name, "mp4", options)) {
            (Some(damage), Ok(source)) => {
                Ok(Box::new(Instead { source, why: format!("{damage}; it was read through ffmpeg") }))
            }
            _ => Err(error),
        },
        Ok(source) => Ok(Box::new(source)),
    }
}

#[cfg(not(feature = "h264"))]
fn open_iso(path: &Path, name: &str, options: &OpenOptions) -> Result<Box<dyn FrameSource>, FrameError> {
    ffmpeg::open(path, name, "mp4 (built without the feature h264)", options)
}

fn check_options(options: &OpenOptions) -> Result<(), FrameError> {
    if !(options.rate.is_finite() && options.rate > 0.0 && options.rate <= 100_000.0) {
        let what = format!("frame rate {}; allowed are rates above 0 up to 100000 per second", options.rate);
        return Err(FrameError::Option { what });
    }
    let Part { from, until, .. } = options.part;
    if !(from >= 0.0 && from.is_finite() && until > from) {
        let what = format!(
            "a part from {from} to {until} s; allowed are parts that end behind where they begin, at 0 s or later"
        );
        return Err(FrameError::Option { what });
    }
    match options.max_side {
        Some(side) if side < 16 => {
            Err(FrameError::Option { what: format!("longest side {side}; allowed are 16 pixels or more") })
        }
        _ => Ok(()),
    }
}

/// Refuses pictures that are empty or too large to hold.
fn check_size(path: &str, width: u64, height: u64, limits: &Limits) -> Result<(u32, u32), FrameError> {
    let sides = 1..=limits.side;
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(w), Ok(h))
            if sides.contains(&width)
                && sides.contains(&height)
                && width.checked_mul(height).is_some_and(|pixels| pixels <= limits.pixels) =>
        {
            Ok((w, h))
        }
        _ => Err(wrong_size(path, width, height, limits)),
    }
}

fn wrong_size(path: &str, width: u64, height: u64, limits: &Limits) -> FrameError {
    FrameError::Size { path: path.to_owned(), width, height, side: limits.side, pixels: limits.pixels }
}

/// Whether a file holds pictures by what it begins with, or may be a folder of them.
pub fn is_clip(path: &Path) -> bool {
    let holds = |content| !matches!(content, Content::Empty | Content::Text | Content::Unknown);
    let head = || head_of(&mut File::open(path)?);
    path.is_dir() || path.is_file() && head().is_ok_and(|head| holds(sniff(&head)))
}

/// The first of these files that holds a video.
fn first_video(mut files: Vec<PathBuf>) -> Option<String> {
    let holds = |path: &PathBuf| {
        let head = File::open(path).and_then(|mut file| head_of(&mut file));
        let video =
            |content| matches!(content, Content::Y4m | Content::Avi | Content::IsoMedia | Content::Other(_));
        path.is_file() && head.is_ok_and(|head| video(sniff(&head)))
    };
    files.sort();
    files.iter().find(|path| holds(path)).map(|path| path.display().to_string())
}

/// What a file begins with, as far as it tells what it is.
fn head_of(file: &mut File) -> io::Result<Vec<u8>> {
    let mut head = Vec::new();
    file.take(512).read_to_end(&mut head)?;
    Ok(head)
}

enum Content {
    Empty,
    Y4m,
    Picture(image::ImageFormat),
    Avi,
    IsoMedia,
    /// A container for which there is only the helper program.
    Other(&'static str),
    Text,
    Unknown,
}

fn sniff(head: &[u8]) -> Content {
    use image::ImageFormat::{Bmp, Gif, Jpeg, Png, Pnm, WebP};
    let at = |offset: usize, magic: &[u8]| head.get(offset..offset + magic.len()) == Some(magic);
    if head.is_empty() {
        return Content::Empty;
    }
    if at(0, b"YUV4MPEG2") {
        return Content::Y4m;
    }
    let pictures: [(&[u8], image::ImageFormat); 5] = [
        (b"\x89PNG\r\n\x1a\n", Png),
        (b"\xff\xd8\xff", Jpeg),
        (b"GIF87a", Gif),
        (b"GIF89a", Gif),
        (b"BM", Bmp),
    ];
    for (magic, format) in pictures {
        if at(0, magic) && (format != Bmp || at(6, &[0; 4])) {
            return Content::Picture(format);
        }
    }
    if at(0, b"RIFF") && at(8, b"WEBP") {
        return Content::Picture(WebP);
    }
    if at(0, b"RIFF") && at(8, b"AVI ") {
        return Content::Avi;
    }
    if head[0] == b'P' && head.len() > 2 && (b'1'..=b'6').contains(&head[1]) && head[2].is_ascii_whitespace()
    {
        return Content::Picture(Pnm);
    }
    // Pictures in the boxes of movies.
    let brands: [&[u8]; 6] = [b"avif", b"avis", b"heic", b"heix", b"mif1", b"msf1"];
    if at(4, b"ftyp") && brands.iter().any(|brand| at(8, brand)) {
        return Content::Other("AVIF or HEIC");
    }
    let iso: [&[u8]; 6] = [b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"];
    if iso.iter().any(|kind| at(4, kind)) {
        return Content::IsoMedia;
    }
    let others: [(&[u8], &str); 9] = [
        (b"II*\0", "TIFF"),
        (b"MM\0*", "TIFF"),
        (b"\0\0\0\x0cjP  ", "JPEG 2000"),
        (b"\x1a\x45\xdf\xa3", "Matroska or WebM"),
        (b"FLV\x01", "FLV"),
        (b"OggS", "Ogg"),
        (b"\x00\x00\x01\xba", "MPEG program stream"),
        (b"\x30\x26\xb2\x75\x8e\x66\xcf\x11", "ASF"),
        (b"\x00\x00\x00\x01\x67", "raw H.264"),
    ];
    for (magic, container) in others {
        if at(0, magic) {
            return Content::Other(container);
        }
    }
    if head[0] == 0x47 && at(188, b"\x47") && at(376, b"\x47") {
        return Content::Other("MPEG transport stream");
    }
    let printable = head.iter().all(|b| matches!(b, 9 | 10 | 12 | 13 | 32..=126 | 128..=255));
    // A character cut by the end of the head is still text.
    let utf8 = std::str::from_utf8(head).map_or_else(|error| error.error_len().is_none(), |_| true);
    if printable && utf8 {
        return Content::Text;
    }
    Content::Unknown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_that_the_helper_program_alone_reads_are_no_movies() {
        let heads: [(&[u8], &str); 4] = [
            (b"\0\0\0\x20ftypavif\0\0\0\0", "AVIF or HEIC"),
            (b"\0\0\0\x18ftypheic\0\0\0\0", "AVIF or HEIC"),
            (b"II*\0\x08\0\0\0", "TIFF"),
            (b"\0\0\0\x0cjP  \r\n\x87\n", "JPEG 2000"),
        ];
        for (head, name) in heads {
            assert!(matches!(sniff(head), Content::Other(found) if found == name), "{name}");
        }
        assert!(matches!(sniff(b"\0\0\0\x18ftypmp42\0\0\0\0"), Content::IsoMedia));
    }
}
