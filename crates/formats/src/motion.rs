//! Any file with the motion of hands: one table of formats, [`FORMATS`], by which all of them are read and written.
//!
//! ```no_run
//! use handcast_formats::motion::{Format, Motion, WriteOptions};
//!
//! let motion = Motion::read("hand.glb".as_ref())?;
//! println!("{}, {} poses", motion.format.name, motion.clip.frames.len());
//! let table = Format::by_name("hand.csv".as_ref()).unwrap().write(&motion.clip, &WriteOptions::default())?;
//! std::fs::write("hand.csv", table.bytes)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A further format is a module with its reader, its writer and its row of the table, and the row's place in
//! [`FORMATS`]. What a file is, its content tells; its name does where the content does not.

mod bap;
pub(crate) mod bvh;
mod csv;
pub(crate) mod format;
mod glb;
mod json;
mod notes;
mod stream;
mod vrma;

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::import::{ImportOptions, ImportReport};
use super::landmarks::{LandmarkClip, pace_notice, solved};
use super::lines::unmarked;
use super::poses::{PosesError, json_message};
use super::whole::{WholeError, read_whole};
use handcast_codec::mapping::Profile;
use handcast_codec::{
    PosesToStreamError, StreamToPosesError, clip_rate, for_hands, poses_from_frames_within, record_of,
};
use handcast_fba::bap::BapFrame;
use handcast_fba::bap::text::{self, TextError};
use handcast_fba::bap::{BapFrames, TimedBapFrame};
use handcast_fba::plan::{PlanOptions, PlanReport, encode_clip};
use handcast_fba::{DecoderOptions, FrameRate};
use handcast_gltf::{ExportOptions, GltfError};
use handcast_hand::clip::MAX_RATE;
use handcast_hand::landmarks::LandmarkError;
use handcast_hand::{
    FrameCheck, JointAngle, MAX_FRAMES, Morphology, PoseClip, PoseHeader, Side, Skeleton, TimedPose,
};
use handcast_limits::{Excess, Limit, Limits};

pub use bvh::{BvhError, read_bvh, write_bvh};
pub use csv::{TableError, read_csv, write_csv};
pub(crate) use format::Writer;
pub use format::{FORMATS, Format};
pub use glb::{Rig, clip_from_glb, write_glb};
pub use json::{read_json, write_json};
pub(crate) use notes::{Keeps, Lost, Times};

/// The BAP frames of a stream or BAP text.
#[derive(Clone, Debug, PartialEq)]
pub struct BapTrack {
    /// Frames per second.
    pub rate: f64,
    /// The frames; skipped ones are left out.
    pub frames: BapFrames,
}

impl BapTrack {
    /// Reads BAP text.
    ///
    /// # Errors
    /// Those of [`text::Reader`].
    pub fn from_text(words: &str) -> Result<Self, TextError> {
        let reader = text::Reader::new(words)?;
        let rate = reader.rate();
        let timed = |(number, baps): (u32, BapFrame)| TimedBapFrame { time: f64::from(number) / rate, baps };
        Ok(Self { rate, frames: reader.map(|frame| frame.map(timed)).collect::<Result<_, _>>()? })
    }

    /// The frames as a new stream, with what `header` tells of the person.
    ///
    /// # Errors
    /// [`PosesToStreamError::Rate`] and [`PosesToStreamError::Encode`].
    pub fn encode(
        &self,
        header: &PoseHeader,
        plan: PlanOptions,
    ) -> Result<(Vec<u8>, PlanReport), PosesToStreamError> {
        let (rate, _) = FrameRate::carrying(self.rate).ok_or(PosesToStreamError::Rate { rate: self.rate })?;
        let record = record_of(&header.hands, header.skin_tone);
        Ok(encode_clip(&self.frames, &PlanOptions { rate, record, ..for_hands(plan) })?)
    }

    /// The frames as BAP text, numbered by their times.
    pub fn to_text(&self, name: &str) -> String {
        let mut out = Vec::new();
        // Writing to memory does not fail.
        let _ = self.write_text(name, &mut out);
        String::from_utf8_lossy(&out).into_owned()
    }

    /// Writes [`Self::to_text`].
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_text(&self, name: &str, out: impl io::Write) -> io::Result<()> {
        let frames = self.frames.iter().map(|frame| ((frame.time * self.rate).round() as u32, frame.baps));
        text::write_frames(name, self.rate, frames, out)
    }
}

/// What was read.
#[derive(Clone, Debug)]
pub struct Motion {
    /// What the file is.
    pub format: &'static Format,
    /// The poses; none when a stream or BAP text moves no hand.
    pub clip: PoseClip,
    /// The BAPs behind them, of streams and BAP text.
    pub baps: Option<BapTrack>,
    /// Whether it says where the wrist is: not in profile `arm`, nor in joint positions without a unit.
    pub placed: bool,
    /// Whether instants between two poses of the file are defined by interpolation, so that poses may be missing where
    /// interpolation gives them back.
    pub keyed: bool,
    /// Whether its times go by a rate that is taken for granted, since the file tells neither.
    pub rate_assumed: bool,
    /// The joint angles it tells, in the order of [`JointAngle::ALL`].
    pub angles: Vec<JointAngle>,
    /// What solving for poses found, of joint positions.
    pub import: Option<ImportReport>,
    /// What is worth saying of how it was read: what was left out, say.
    pub notes: Vec<String>,
}

/// Why a motion could not be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MotionError {
    /// The file could not be opened or read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// There is nothing in it.
    #[error("{path}: the file is empty")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// Neither content nor name is that of a motion.
    #[error("{path}: no kind of motion this program reads; allowed are {}", Format::endings())]
    Kind {
        /// The file.
        path: PathBuf,
    },
    /// Content that is none of the formats there are, and is known to be something else.
    #[error("{path}: {what}")]
    Unknown {
        /// The file.
        path: PathBuf,
        /// What was found, and what was tried.
        what: format::NotKnown,
    },
    /// The content is wrong.
    #[error("{path}: {reason}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        reason: ContentError,
    },
}

/// What is wrong with the content of a file.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ContentError {
    /// More than a reader takes.
    #[error(transparent)]
    Excess(#[from] Excess),
    /// A stream.
    #[error(transparent)]
    Stream(#[from] StreamToPosesError),
    /// A stream in an MP4 file.
    #[error(transparent)]
    Mp4(#[from] crate::mp4::Mp4Error),
    /// BAP text.
    #[error(transparent)]
    BapText(#[from] TextError),
    /// A GLB.
    #[error(transparent)]
    Glb(#[from] GltfError),
    /// A BVH file.
    #[error(transparent)]
    Bvh(#[from] BvhError),
    /// A table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Poses.
    #[error(transparent)]
    Poses(#[from] PosesError),
    /// A document of poses that is no JSON.
    #[error("poses: line {}: {}", .0.line(), json_message(.0))]
    Json(#[from] serde_json::Error),
    /// A document of poses without a list of frames.
    #[error("poses: the document has no list \"frames\"")]
    NoFrames,
    /// JSON that is of none of the formats.
    #[error(
        "JSON of no kind that is known: poses have a list \"frames\", landmark lines \"format\":\"landmarks21\", WebXR hands \
         \"format\":\"webxr-hands\", WebXR still poses are a list of objects, MediaPipe's results have a list named \
         landmarks, keypoints or alike"
    )]
    UnknownJson,
    /// A line of landmarks.
    #[error("landmarks: line {line}: {what}")]
    LandmarkLine {
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// WebXR poses or frames.
    #[error("webxr: {what}")]
    Webxr {
        /// What is wrong and where.
        what: String,
    },
    /// A file of another program.
    #[error("{format}: {what}")]
    Foreign {
        /// Short name of the format.
        format: &'static str,
        /// What is wrong and where.
        what: String,
    },
    /// Joint positions that are not those of a hand.
    #[error(transparent)]
    Landmarks(#[from] LandmarkError),
    /// Of several hands none is the one asked for.
    #[error("no hand is called {}", .side.name())]
    NoHand {
        /// The one asked for.
        side: Side,
    },
    /// A frame rate that no motion has.
    #[error("{rate} frames per second, allowed above 0 to {MAX_RATE}")]
    Rate {
        /// The rate.
        rate: f64,
    },
    /// There is no plane or frame.
    #[error("it holds no frame")]
    Empty,
}

/// What a file tells.
#[derive(Debug)]
pub enum Content {
    /// Poses.
    Poses(Box<Motion>),
    /// Joint positions, from which poses are to be solved.
    Joints(Vec<LandmarkClip>),
}

impl From<Motion> for Content {
    fn from(motion: Motion) -> Self {
        Self::Poses(Box::new(motion))
    }
}

impl Content {
    /// Reads the content of a file of any format, as [`Motion::parse_within`] does, files beside a `.gltf` included,
    /// without solving.
    ///
    /// # Errors
    /// See [`MotionError`].
    pub fn parse_within(path: &Path, bytes: &[u8], limits: &Limits) -> Result<Self, MotionError> {
        Self::of(path, bytes, limits).map(|(_, told)| told)
    }

    fn of(path: &Path, bytes: &[u8], limits: &Limits) -> Result<(&'static Format, Self), MotionError> {
        let bytes = unmarked(bytes);
        if bytes.is_empty() {
            return Err(MotionError::Empty { path: path.into() });
        }
        if let Some(what) = format::NotKnown::of(bytes) {
            return Err(MotionError::Unknown { path: path.into(), what });
        }
        let format = Format::of(path, bytes).ok_or_else(|| MotionError::Kind { path: path.into() })?;
        let read = || {
            limits.check_count(Limit::Bytes, bytes.len())?;
            let bytes =
                if *format == glb::DOCUMENT { glb::with_files(path, bytes, limits)? } else { bytes.into() };
            Ok(match (format.read)(&bytes, limits)? {
                Self::Poses(motion) => motion.sound(limits)?.into(),
                joints => joints,
            })
        };
        let told = read().map_err(|reason| MotionError::Content { path: path.into(), reason })?;
        Ok((format, told))
    }
}

impl Motion {
    /// Whether it has a pose where a hand is lost, too, held or interpolated, since its format cannot say that it is.
    pub fn bridges_lost(&self) -> bool {
        self.baps.is_some() || self.format.write.is_some_and(|writer| writer.keeps.lost == Lost::Bridged)
    }

    /// Reads a file of any format.
    ///
    /// # Errors
    /// See [`MotionError`].
    pub fn read(path: &Path) -> Result<Self, MotionError> {
        Self::read_within(path, &Limits::default())
    }

    /// As [`Motion::read`], within other limits.
    ///
    /// # Errors
    /// See [`MotionError`].
    pub fn read_within(path: &Path, limits: &Limits) -> Result<Self, MotionError> {
        let bytes = read_whole(path, limits).map_err(|error| match error {
            WholeError::Io(source) => MotionError::Io { path: path.into(), source },
            WholeError::Excess(excess) => MotionError::Content { path: path.into(), reason: excess.into() },
        })?;
        Self::parse_within(path, &bytes, limits)
    }

    /// Reads the content of a file of any format, without a byte order mark. `path` names it in messages, and tells what
    /// it is where the content does not. Files that a `.gltf` refers to are opened in the folder of `path` or below: for bytes
    /// of strangers its folder is to hold nothing else, or not to be there.
    ///
    /// # Errors
    /// See [`MotionError`].
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, MotionError> {
        Self::parse_within(path, bytes, &Limits::default())
    }

    /// As [`Motion::parse`], files beside a `.gltf` included, within other limits.
    ///
    /// # Errors
    /// See [`MotionError`].
    pub fn parse_within(path: &Path, bytes: &[u8], limits: &Limits) -> Result<Self, MotionError> {
        Self::parse_imported(path, bytes, &ImportOptions::default(), limits)
    }

    /// The same; poses of joint positions are solved for as `options` say, those of the hand that they tell where there are
    /// several. Poses that are there already are as they are.
    ///
    /// # Errors
    /// See [`MotionError`].
    pub fn parse_imported(
        path: &Path,
        bytes: &[u8],
        options: &ImportOptions,
        limits: &Limits,
    ) -> Result<Self, MotionError> {
        let (format, told) = Content::of(path, bytes, limits)?;
        match told {
            Content::Poses(motion) => Ok(*motion),
            Content::Joints(mut hands) => {
                if let (Some(side), true) = (options.side, hands.len() > 1) {
                    hands.retain(|hand| hand.side == Some(side));
                    if hands.is_empty() {
                        return Err(MotionError::Content {
                            path: path.into(),
                            reason: ContentError::NoHand { side },
                        });
                    }
                }
                let motion = solved(format, &hands, options).and_then(|motion| motion.sound(limits));
                motion.map_err(|reason| MotionError::Content { path: path.into(), reason })
            }
        }
    }

    /// The same; a stream is decoded as `options` say.
    ///
    /// # Errors
    /// See [`MotionError`].
    pub fn parse_decoded(
        path: &Path,
        bytes: &[u8],
        options: DecoderOptions,
        limits: &Limits,
    ) -> Result<Self, MotionError> {
        if bytes.is_empty() || Format::of(path, bytes).is_none_or(|format| format.id != "fba") {
            return Self::parse_within(path, bytes, limits);
        }
        let motion = stream::read(bytes, options, limits).and_then(|motion| motion.sound(limits));
        motion.map_err(|reason| MotionError::Content { path: path.into(), reason })
    }

    /// The same, if it may be so long, and its poses are sound.
    fn sound(self, limits: &Limits) -> Result<Self, ContentError> {
        self.check(limits)?;
        check_poses(&self.clip)?;
        Ok(self.paced())
    }

    /// The same with a note that it would take far longer than hands do.
    fn paced(mut self) -> Self {
        let mut times: Vec<f64> = self.clip.frames.iter().map(|pose| pose.time).collect();
        times.dedup();
        self.notes.extend(pace_notice(&times));
        self
    }

    /// What holds for any format: how many instants there are, and how long the motion is.
    fn check(&self, limits: &Limits) -> Result<(), Excess> {
        let frames = &self.clip.frames;
        limits.check_count(Limit::Instants, frames.len() / self.clip.header.hands.len().max(1))?;
        limits.check(Limit::Seconds, span(&self.clip))
    }

    pub(crate) fn of(format: &'static Format, clip: PoseClip) -> Self {
        Self {
            format,
            clip,
            baps: None,
            placed: true,
            keyed: false,
            rate_assumed: false,
            angles: JointAngle::ALL.to_vec(),
            import: None,
            notes: Vec::new(),
        }
    }

    /// The same at another rate, frames a second, where its own is taken for granted.
    #[must_use]
    pub fn at_rate(mut self, rate: f64) -> Self {
        if let Some(assumed) = self.clip.header.rate.filter(|_| self.rate_assumed) {
            let notice = self.rate_notice();
            self.notes.retain(|note| Some(note) != notice.as_ref());
            (self.clip.header.rate, self.rate_assumed) = (Some(rate), false);
            self.clip.frames.iter_mut().for_each(|pose| pose.time *= assumed / rate);
        }
        self
    }

    /// That its rate is taken for granted, where there is more than one frame.
    pub fn rate_notice(&self) -> Option<String> {
        let rate = self.clip.header.rate.filter(|_| self.rate_assumed && self.clip.frames.len() > 1)?;
        Some(rate_notice(rate))
    }

    fn from_baps(format: &'static Format, baps: BapTrack, limits: &Limits) -> Result<Self, ContentError> {
        if baps.frames.is_empty() {
            return Err(ContentError::Empty);
        }
        let (clip, profile) = poses_from_frames_within(&baps.frames, baps.rate, limits)?;
        Ok(Self { placed: profile == Profile::Hand, baps: Some(baps), ..Self::of(format, clip) })
    }
}

/// That a rate is taken for granted.
pub(crate) fn rate_notice(rate: f64) -> String {
    format!("it tells no times: {rate} frames a second are taken for granted")
}

/// Seconds from the first pose of a clip to its last.
pub fn span(clip: &PoseClip) -> f64 {
    let times = || clip.frames.iter().map(|frame| frame.time);
    (times().fold(f64::NEG_INFINITY, f64::max) - times().fold(f64::INFINITY, f64::min)).max(0.0)
}

/// A rate that makes too many instants of a clip.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("{:.3} frames/s over {seconds:.1} s: {excess}", rate)]
pub struct SpanError {
    /// Frames per second.
    pub rate: f64,
    /// From the first pose to the last.
    pub seconds: f64,
    /// What is too much.
    pub excess: Excess,
}

/// Makes sure that `rate` makes no more instants of a clip than allowed, and than are ever made ([`MAX_FRAMES`]).
///
/// # Errors
/// [`SpanError`].
pub fn check_span(clip: &PoseClip, rate: f64, limits: &Limits) -> Result<(), SpanError> {
    let seconds = span(clip);
    // The last one is none of the steps.
    let instants = limits.instants.min(MAX_FRAMES as u64 - 1);
    limits.clone().with_instants(instants).check_span(seconds, rate).map_err(|excess| SpanError {
        rate,
        seconds,
        excess,
    })
}

/// Highest rate of [`at_even_times`], frames per second: what a stream has.
const MAX_EVEN_RATE: f64 = 255.0;

/// How far keys may be from the beat of the others, in intervals, and a rate from a whole number that is meant.
const OFF_BEAT: f64 = 0.1;
/// Share of the intervals that must be on the beat for there to be one.
const MOST_ON_BEAT: f64 = 0.9;
const NEARLY_WHOLE: f64 = 1e-3;

/// Frames per second of poses at keys, of which some may have been left out: those of their beat, where they have one.
pub fn even_rate(clip: &PoseClip) -> f64 {
    let rough = clip_rate(clip);
    let mut times: Vec<f64> = clip.frames.iter().map(|f| f.time).collect();
    times.sort_by(f64::total_cmp);
    times.dedup_by(|b, a| (*b - *a) * rough < OFF_BEAT);
    let intervals = times.windows(2).map(|pair| (pair[1] - pair[0]) * rough);
    let on_beat: Vec<f64> =
        intervals.filter(|interval| (interval - interval.round()).abs() < OFF_BEAT).collect();
    // A time that is late by itself takes two intervals off the beat.
    let many = on_beat.len() as f64 >= MOST_ON_BEAT * times.len().saturating_sub(1) as f64;
    let (count, length) = (on_beat.iter().map(|v| v.round()).sum::<f64>(), on_beat.iter().sum::<f64>());
    let beat = if many && count > 0.0 { count / length * rough } else { rough.round() };
    let whole = (beat - beat.round()).abs() < NEARLY_WHOLE;
    (if whole { beat.round() } else { beat }).clamp(1.0, MAX_EVEN_RATE)
}

/// Poses at keys ([`Motion::keyed`]), of which some may have been left out, back on an even time base ([`even_rate`]): as they
/// are encoded. They begin where they did.
///
/// # Errors
/// [`SpanError`].
pub fn at_even_times(mut clip: PoseClip, limits: &Limits) -> Result<PoseClip, SpanError> {
    let rate = even_rate(&clip);
    check_span(&clip, rate, limits)?;
    let sides: Vec<_> = clip.header.hands.iter().map(|h| h.side).collect();
    let start = clip.frames.iter().map(|f| f.time).fold(f64::INFINITY, f64::min);
    let at_ticks = |side: Side| {
        let first = clip.of(side).map(|f| f.time).fold(f64::INFINITY, f64::min);
        // One that comes later begins on a tick of the other's.
        let late = ((first - start) * rate).round() / rate;
        let even = clip.resampled(side, rate, f64::INFINITY).into_iter();
        even.map(move |pose| TimedPose { time: start + late + pose.time, ..pose })
    };
    clip.frames = sides.into_iter().flat_map(at_ticks).collect();
    clip.header.rate = Some(rate);
    Ok(clip)
}

/// How poses are written; each format takes what concerns it.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct WriteOptions {
    /// Sizes of hands whose header says none.
    pub morphology: Morphology,
    /// Frames per second of formats with even frames; `None` for the clip's own ([`clip_rate`]).
    pub rate: Option<f64>,
    /// How glTF is written. Its names of joints are those of BVH, too.
    pub gltf: ExportOptions,
    /// A hand to move in place of the built-in one, in glTF.
    pub rig: Option<Rig>,
    /// Name of the motion, one word, where the format has a place for it.
    pub title: String,
    /// How many frames a rate may make of a clip.
    pub limits: Limits,
}

impl Default for WriteOptions {
    fn default() -> Self {
        Self {
            morphology: Morphology::default(),
            rate: None,
            gltf: ExportOptions::default(),
            rig: None,
            title: "poses".into(),
            limits: Limits::default(),
        }
    }
}

impl WriteOptions {
    /// Sets [`WriteOptions::morphology`].
    #[must_use]
    pub fn with_morphology(self, morphology: Morphology) -> Self {
        Self { morphology, ..self }
    }

    /// Sets [`WriteOptions::rate`].
    #[must_use]
    pub fn with_rate(self, rate: Option<f64>) -> Self {
        Self { rate, ..self }
    }

    /// Sets [`WriteOptions::gltf`].
    #[must_use]
    pub fn with_gltf(self, gltf: ExportOptions) -> Self {
        Self { gltf, ..self }
    }

    /// Sets [`WriteOptions::rig`].
    #[must_use]
    pub fn with_rig(self, rig: Option<Rig>) -> Self {
        Self { rig, ..self }
    }

    /// Sets [`WriteOptions::title`].
    #[must_use]
    pub fn with_title(self, title: impl Into<String>) -> Self {
        Self { title: title.into(), ..self }
    }

    /// Sets [`WriteOptions::limits`].
    #[must_use]
    pub fn with_limits(self, limits: Limits) -> Self {
        Self { limits, ..self }
    }

    /// Frames a second of a format with even frames, of which there are not too many.
    pub(crate) fn rate_of(&self, clip: &PoseClip) -> Result<f64, WriteError> {
        let rate = self.rate.unwrap_or_else(|| clip_rate(clip));
        if !(rate > 0.0 && rate <= MAX_RATE) {
            return Err(WriteError::Rate { rate });
        }
        self.limits.check_span(span(clip), rate)?;
        Ok(rate)
    }
}

/// A file to write.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Its content.
    pub bytes: Vec<u8>,
    /// What is worth saying of it: what was left out, say.
    pub notes: Vec<String>,
}

impl From<Vec<u8>> for Written {
    fn from(bytes: Vec<u8>) -> Self {
        Self { bytes, notes: Vec::new() }
    }
}

/// That header and poses are sound, whoever made them.
fn check_poses(clip: &PoseClip) -> Result<(), PosesError> {
    clip.header.check().map_err(PosesError::Header)?;
    let mut check = FrameCheck::default();
    clip.frames.iter().enumerate().try_for_each(|(frame, pose)| {
        let checked = check.check(&clip.header, pose);
        checked.map_err(|error| PosesError::Frame { frame, what: error.to_string() })
    })
}

/// Why poses cannot be written in a format.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WriteError {
    /// There is no valid pose.
    #[error("export: no valid pose")]
    Empty,
    /// The format holds one hand.
    #[error("export: {format} holds one hand, the clip has two: choose one")]
    TwoHands {
        /// Name of the format.
        format: &'static str,
    },
    /// The frame rate is no rate.
    #[error("export: {rate} frames per second, allowed above 0 to {MAX_RATE}")]
    Rate {
        /// The rate.
        rate: f64,
    },
    /// The rate makes more frames than allowed.
    #[error("export: {0}")]
    Excess(#[from] Excess),
    /// The format is read only.
    #[error("export: {format} is read, but not written")]
    ReadOnly {
        /// Name of the format.
        format: &'static str,
    },
    /// The clip is not sound.
    #[error(transparent)]
    Poses(#[from] PosesError),
    /// Poses became no BAPs.
    #[error(transparent)]
    Baps(#[from] PosesToStreamError),
    /// Poses became no glTF.
    #[error(transparent)]
    Glb(#[from] GltfError),
    /// The rig cannot be moved.
    #[error("{path}: {reason}")]
    Rig {
        /// The rig.
        path: PathBuf,
        /// Why.
        reason: GltfError,
    },
    /// Numbers became no JSON.
    #[error("export: {0}")]
    Json(#[from] serde_json::Error),
    /// Writing failed.
    #[error("export: {0}")]
    Io(#[from] std::io::Error),
}

/// The hands with a valid pose.
pub(crate) fn sides(clip: &PoseClip) -> Vec<Side> {
    [Side::Left, Side::Right].into_iter().filter(|&s| clip.of(s).any(|f| f.valid)).collect()
}

/// The poses of a clip at even ticks from its first instant on, for files with a row a tick.
pub(crate) struct Ticks {
    /// As [`PoseClip::even`] makes it.
    pub even: PoseClip,
    /// Ticks from the first instant to the last, both included.
    pub count: usize,
    start: f64,
    rate: f64,
}

impl Ticks {
    /// # Errors
    /// [`WriteError::Rate`]; [`WriteError::Excess`] of instants; [`WriteError::Empty`] without a valid pose.
    pub fn of(clip: &PoseClip, rate: f64) -> Result<Self, WriteError> {
        if !(rate > 0.0 && rate <= MAX_RATE) {
            return Err(WriteError::Rate { rate });
        }
        let most = Limits::default().with_instants(MAX_FRAMES as u64 - 1);
        most.check(Limit::Instants, (span(clip) * rate).floor().max(0.0))?;
        let even = clip.even(rate);
        let start = even.frames.iter().map(|f| f.time).fold(f64::INFINITY, f64::min);
        let mut ticks = Self { even, count: 0, start, rate };
        let last = ticks.even.frames.iter().map(|f| ticks.at(f.time)).max().ok_or(WriteError::Empty)?;
        ticks.count = last + 1;
        Ok(ticks)
    }

    /// The tick of an instant.
    pub fn at(&self, time: f64) -> usize {
        ((time - self.start) * self.rate).round() as usize
    }
}

/// The skeleton of a hand of a clip; of unknown sizes those of `fallback`.
pub(crate) fn skeleton(clip: &PoseClip, side: Side, fallback: &Morphology) -> Skeleton {
    let info = clip.header.hand(side).and_then(|h| h.morphology.as_ref());
    Skeleton::new(info.unwrap_or(fallback), side)
}

/// Rounded to this many digits after the point; minus zero becomes zero.
pub(crate) fn rounded(value: f64, digits: i32) -> f64 {
    let unit = 10f64.powi(digits);
    (value * unit).round() / unit + 0.0
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use handcast_hand::{ClipHand, Domain, HandPose, PoseHeader};
    use nalgebra::{UnitQuaternion, Vector3};

    pub(crate) fn clip(sides: &[Side]) -> PoseClip {
        let mut clip = PoseClip { header: PoseHeader::default(), frames: Vec::new() };
        clip.header.rate = Some(25.0);
        for &side in sides {
            clip.header.hands.push(ClipHand { side, morphology: None });
            for i in 0..30 {
                let t = f64::from(i) / 25.0;
                let mut pose = HandPose::neutral(side);
                for (k, angle) in JointAngle::ALL.into_iter().enumerate() {
                    let size = if angle.name().ends_with("2_flexion") { 1.5 } else { 0.3 };
                    pose.set(angle, size * (0.5 - 0.5 * (2.0 * t + k as f64).cos()));
                }
                pose.rotation = UnitQuaternion::from_euler_angles(0.9 * t, 2.5 * t, 3.0 * t);
                pose.translation = Vector3::new(0.1 * t, -0.2, -0.5 + t);
                clip.frames.push(TimedPose::new(t, pose));
            }
        }
        clip
    }

    /// How far two motions are apart at most: joint angles and the wrist's rotation (radians), its position (metres).
    pub(crate) fn apart(a: &PoseClip, b: &PoseClip) -> [f64; 3] {
        assert_eq!(a.frames.len(), b.frames.len());
        let mut most = [0.0f64; 3];
        for side in [Side::Left, Side::Right] {
            assert_eq!(a.of(side).count(), b.of(side).count());
            for (a, b) in a.of(side).zip(b.of(side)) {
                assert!((a.time - b.time).abs() < 1e-5);
                let off = |angle| (a.pose.angle(angle) - b.pose.angle(angle)).abs();
                let turned = a.pose.rotation.angle_to(&b.pose.rotation);
                let moved = (a.pose.translation - b.pose.translation).norm();
                let angles = JointAngle::ALL.into_iter().map(off).fold(0.0, f64::max);
                for (most, off) in most.iter_mut().zip([angles, turned, moved]) {
                    *most = most.max(off);
                }
            }
        }
        most
    }

    /// How far joint angles are apart at most, radians, where the wrist is as good as the same.
    pub(crate) fn worst(a: &PoseClip, b: &PoseClip) -> f64 {
        let [angles, turned, moved] = apart(a, b);
        assert!(turned < 1e-5 && moved < 1e-5, "{turned} rad, {moved} m");
        angles
    }

    /// Both hands, the right one a little later, moving every angle, the wrist past half a turn.
    pub(crate) fn two_hands() -> PoseClip {
        let mut clip = PoseClip { header: PoseHeader::default(), frames: Vec::new() };
        clip.header.rate = Some(25.0);
        for (side, from) in [(Side::Left, 0), (Side::Right, 3)] {
            clip.header.hands.push(ClipHand { side, morphology: Some(Morphology::average(0.17)) });
            for i in from..40 {
                let t = f64::from(i) / 25.0;
                let mut pose = HandPose::neutral(side);
                for (k, angle) in JointAngle::ALL.into_iter().enumerate() {
                    let size = if angle.name().ends_with("2_flexion") { 1.7 } else { 0.3 };
                    pose.set(angle, size * (0.5 - 0.5 * (2.0 * t + k as f64).cos()));
                }
                pose.rotation = UnitQuaternion::from_euler_angles(0.9 * t, 2.5 * t, 3.0 * t);
                pose.translation = Vector3::new(0.1 * t, -0.2, -0.5 + t);
                clip.frames.push(TimedPose::new(t, pose));
            }
        }
        clip
    }

    /// What each format keeps of a motion: largest error of joint angles and wrist (radians), and of its place (metres).
    const PRECISION: [(&str, [f64; 3]); 11] = [
        // Rotations in f32, and nothing of places.
        ("vrma", [4e-7, 2e-7, f64::INFINITY]),
        // Rotations and positions in f32.
        ("glb", [2e-7, 2e-7, 1e-7]),
        ("gltf", [2e-7, 2e-7, 1e-7]),
        // Degrees to five digits, quaternions to eight, metres to seven.
        ("jsonl", [0.9e-7, 2e-8, 0.9e-7]),
        ("json", [0.9e-7, 2e-8, 0.9e-7]),
        // Degrees to four digits, quaternions to seven, metres to six.
        ("csv", [0.9e-6, 2e-7, 0.9e-6]),
        // Degrees to five digits, about each axis; metres to six.
        ("bvh", [3e-7, 3e-7, 0.9e-6]),
        // Quaternions and metres to seven digits.
        ("webxr", [6e-7, 2e-7, 0.9e-7]),
        // Metres to seven digits, at the ends of bones of some centimetres.
        ("landmarks", [2e-5, 5e-6, 5e-7]),
        // Metres in f32.
        ("pose", [2e-5, 5e-6, 5e-7]),
        // Joint angles in 1e-5, the wrist in tenths of a degree and in millimetres.
        ("bap", [0.6e-5, 1.6e-3, 0.9e-3]),
    ];

    /// Times of single precision, some of them left out.
    #[test]
    fn more_instants_than_are_ever_made_are_refused() {
        let mut clip = clip(&[Side::Right]);
        let last = clip.frames.len() - 1;
        clip.frames[last].time = 1e6;
        let refused = |text: String| assert!(text.contains("instants, allowed at most 3999999"), "{text}");
        refused(Ticks::of(&clip, 25.0).err().unwrap().to_string());
        let limits = Limits::default().with_instants(u64::MAX).with_seconds(f64::INFINITY);
        refused(check_span(&clip, 25.0, &limits).unwrap_err().to_string());
    }

    #[test]
    fn keys_tell_the_rate_of_their_beat() {
        for rate in [1.0, 12.5, 14.985, 23.976, 25.0, 30_000.0 / 1001.0, 30.0, 59.94, 119.88, 250.0] {
            let mut clip = clip(&[Side::Right]);
            let pose = clip.frames[3].pose.clone();
            let time = |i: u32| f64::from((f64::from(i) / rate) as f32);
            let kept = (0..300).filter(|i| i % 7 != 3 && i % 11 != 4);
            clip.frames = kept.map(|i| TimedPose::new(5.0 + time(i), pose.clone())).collect();
            clip.header.rate = None;
            let found = even_rate(&clip);
            assert!((found / rate - 1.0).abs() < 1e-5, "{rate}: {found}");
            let even = at_even_times(clip, &Limits::default()).unwrap();
            assert_eq!((even.header.rate, even.frames.len()), (Some(found), 300), "{rate}");
        }
        // Of a hand that comes later too.
        for format in ["glb", "vrma"] {
            let mut two = two_hands();
            two.frames.retain(|frame| frame.pose.side == Side::Right || frame.time > 0.5);
            let mut options = WriteOptions::default();
            options.gltf.animation_only = true;
            let file = Format::by_id(format).unwrap().write(&two, &options).unwrap();
            let read = Motion::parse("x".as_ref(), &file.bytes).unwrap();
            let even = at_even_times(read.clip, &Limits::default()).unwrap();
            for side in [Side::Left, Side::Right] {
                assert_eq!(even.of(side).count(), two.of(side).count());
                for (given, found) in two.of(side).zip(even.of(side)) {
                    assert!((given.time - found.time).abs() < 1e-5, "{} {}", given.time, found.time);
                }
            }
        }
        // One late time of fifty.
        let mut late = clip(&[Side::Right]);
        let pose = late.frames[3].pose.clone();
        let time = |i: u32| (f64::from(i) + if i == 20 { 0.4 } else { 0.0 }) * 1001.0 / 30_000.0;
        late.frames = (0..50).map(|i| TimedPose::new(time(i), pose.clone())).collect();
        late.header.rate = None;
        assert!((even_rate(&late) / (30_000.0 / 1001.0) - 1.0).abs() < 1e-9, "{}", even_rate(&late));
        // No beat at all.
        let mut uneven = clip(&[Side::Right]);
        uneven.header.rate = None;
        for (i, frame) in uneven.frames.iter_mut().enumerate() {
            frame.time += 0.4 / 30.0 * (2.3 * i as f64).sin();
        }
        let found = even_rate(&uneven);
        assert!(found == found.round() && (20.0..40.0).contains(&found), "{found}");
    }

    /// Whatever keys are left out, and whenever it begins.
    #[test]
    fn poses_that_keep_still_or_begin_late_keep_their_times() {
        for (format, start) in [("glb", 1.2), ("vrma", 1.2), ("gltf", 0.0), ("glb", -3.0), ("vrma", 1.7e9)] {
            let mut still = clip(&[Side::Right]);
            let pose = still.frames[3].pose.clone();
            let time = |i: u32| start + f64::from(i) / 30.0;
            still.frames = (0..300).map(|i| TimedPose::new(time(i), pose.clone())).collect();
            still.header.rate = Some(30.0);
            let mut options = WriteOptions::default();
            options.gltf.animation_only = true;
            let file = Format::by_id(format).unwrap().write(&still, &options).unwrap();
            let read = Motion::parse("x".as_ref(), &file.bytes).unwrap();
            assert!(read.clip.frames.len() < 10, "{format}");
            let even = at_even_times(read.clip, &Limits::default()).unwrap();
            assert_eq!((even.header.rate, even.frames.len()), (Some(30.0), 300), "{format} from {start}");
            for (given, found) in still.frames.iter().zip(&even.frames) {
                assert!((given.time - found.time).abs() < 1e-6, "{format}: {} {}", given.time, found.time);
            }
        }
    }

    /// A motion inside what joints can do, with those angles that joint positions tell.
    pub(crate) fn feasible(side: Side) -> PoseClip {
        let domain = Domain::full();
        let mut clip = clip(&[side]);
        for frame in &mut clip.frames {
            for angle in JointAngle::ALL {
                let seen = !angle.name().ends_with("twisting") && !angle.name().contains("0_flexion");
                frame.pose.set(angle, if seen { 0.5 * frame.pose.angle(angle) } else { 0.0 });
            }
            frame.pose = domain.project_pose(&frame.pose);
        }
        clip
    }

    #[test]
    fn every_format_that_is_written_gives_its_angles_back() {
        for format in Format::written() {
            let (_, precision) = PRECISION.into_iter().find(|(id, _)| *id == format.id).expect("its row");
            let clips = match (format.hands, format.id) {
                (1, _) => [Side::Left, Side::Right].map(feasible).to_vec(),
                (_, "pose" | "vrma") => {
                    let [left, right] = [Side::Left, Side::Right].map(feasible);
                    let mut both = left.clone();
                    both.header.hands.extend(right.header.hands.clone());
                    both.frames.extend(right.frames.clone());
                    vec![left, right, both]
                }
                _ => vec![clip(&[Side::Left, Side::Right]), clip(&[Side::Left]), clip(&[Side::Right])],
            };
            for (number, clip) in clips.into_iter().enumerate() {
                let mut options = WriteOptions::default();
                // The surface, which takes a second to make, once.
                options.gltf.animation_only = number < 2;
                let written = format.write(&clip, &options).unwrap();
                // Whatever it is called.
                let back = Motion::parse("x.doc".as_ref(), &written.bytes).unwrap();
                assert_eq!(back.format, format);
                let off = apart(&clip, &back.clip);
                println!("{}: {off:?}", format.id);
                assert!(off.iter().zip(precision).all(|(off, most)| *off < most), "{}: {off:?}", format.id);
                assert_eq!(back.placed, format.id != "vrma", "{}", format.id);
                let again = format.write(&clip, &options).unwrap();
                assert_eq!(written, again, "{}", format.id);
            }
        }
    }

    #[test]
    fn poses_of_a_lost_hand_are_told_by_the_file_or_by_a_note() {
        let mut clip = feasible(Side::Left);
        let seen = clip.frames.len() - 12;
        clip.frames[9..21].iter_mut().for_each(|frame| frame.valid = false);
        let mut options = WriteOptions::default();
        options.gltf.animation_only = true;
        for format in Format::written() {
            let written = format.write(&clip, &options).unwrap();
            let back = Motion::parse("x.doc".as_ref(), &written.bytes).unwrap().clip.frames;
            let lost = back.iter().filter(|frame| !frame.valid).count();
            match format.write.unwrap().keeps.lost {
                Lost::Told => assert!(lost >= 10, "{}: {lost}", format.id),
                Lost::LeftOut => assert_eq!((lost, back.len()), (0, seen), "{}", format.id),
                Lost::Bridged => assert_eq!(lost, 0, "{}", format.id),
            }
            let said = written.notes.iter().any(|note| note.starts_with("12 of 30 poses are of a lost hand"));
            assert_eq!(said, lost == 0, "{}: {:?}", format.id, written.notes);
        }
        // One that comes later.
        let mut two = two_hands();
        two.frames.retain(|frame| frame.pose.side == Side::Right || frame.time > 0.5);
        for format in Format::written().filter(|format| format.hands == 2) {
            let notes = format.write(&two, &options).unwrap().notes;
            let said =
                notes.iter().any(|note| note.starts_with("the left hand is there from 0.52 to 1.56 s"));
            assert_eq!(said, format.write.unwrap().keeps.lost == Lost::Bridged, "{}: {notes:?}", format.id);
        }
    }

    #[test]
    fn texts_with_a_byte_order_mark_are_read_as_without() {
        for format in Format::written().filter(|format| !["glb", "vrma", "pose"].contains(&format.id)) {
            let clip = feasible(Side::Left);
            let plain = format.write(&clip, &WriteOptions::default()).unwrap().bytes;
            let marked = ["\u{feff}".as_bytes(), &plain].concat();
            assert_eq!(Format::sniffed(&marked), Some(format), "{}", format.id);
            let [plain, marked] = [plain, marked].map(|bytes| Motion::parse("-".as_ref(), &bytes).unwrap());
            assert_eq!(plain.clip, marked.clip, "{}", format.id);
            assert_eq!(plain.import.is_some(), marked.import.is_some(), "{}", format.id);
        }
        let empty = Motion::parse("a.csv".as_ref(), "\u{feff}".as_bytes()).unwrap_err();
        assert!(matches!(empty, MotionError::Empty { .. }), "{empty}");
    }

    #[test]
    fn what_is_read_only_says_so() {
        for format in FORMATS.into_iter().filter(|format| format.write.is_none()) {
            let refused = format.write(&clip(&[Side::Left]), &WriteOptions::default()).unwrap_err();
            assert!(matches!(refused, WriteError::ReadOnly { .. }), "{refused}");
        }
        for format in Format::written() {
            assert!(format.write(&PoseClip::default(), &WriteOptions::default()).is_err(), "{}", format.id);
        }
    }

    #[test]
    fn broken_files_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, text, words) in [
            ("a.fba", "nothing", "bit"),
            ("a.bap", "", "the file is empty"),
            ("b.bap", "\n", "header"),
            ("a.glb", "glTF", "gltf"),
            ("a.bvh", "HIERARCHY", "bvh"),
            ("a.csv", "time,hand\n", "table"),
            ("a.json", "{\"format\":\"handcast-poses\"\n}", "frames"),
            ("a.jsonl", "{}\n", "no names in it, is none of the formats"),
            ("a.jsonl", "{\"format\":\"handcast-poses\"}\n", "poses"),
            ("c.jsonl", "{\"x\":1,\"y\":{\"z\":[]}}\n", "names \"x\", \"y\""),
            ("b.jsonl", "{\"format\":\"landmarks21\"}\n", "landmarks"),
            ("b.json", "[{}]", "none of the formats"),
            ("b.json", "[{\"jointPositions\":[]}]", "webxr: missing field"),
            ("c.json", "{\"format\":\"webxr-hands\"}", "webxr: unit is missing"),
            ("a.landmarks.jsonl", "words", "landmarks: line 1: not JSON"),
            ("a.txt", "x", "allowed are .glb, .jsonl, .json, .csv, .bvh"),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            let message = Motion::read(&path).unwrap_err().to_string();
            assert!(message.contains(words) && message.contains(name), "{message}");
        }
        let missing = Motion::read(&folder.path().join("none.fba")).unwrap_err().to_string();
        assert!(missing.contains("none.fba"), "{missing}");
    }
}
