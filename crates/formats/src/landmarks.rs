//! Joint positions from other trackers, which poses are solved for ([`super::import`]).
//!
//! These formats hold them: [landmark lines](points), [WebXR-shaped frames](webxr), [still poses of WebXR](still),
//! [results of MediaPipe as JSON](mediapipe), [`.pose` files](pose_format), [MANO's parameters and the joints of programs
//! that find them](mano), [frames of a Leap Motion](leap), [recordings of IWER](iwer) and [frames of XR joints](xr).
//! `spec/landmarks.md` describes each.

pub mod axes;
mod continuity;
mod documents;
pub mod iwer;
pub mod leap;
pub mod mano;
pub mod mediapipe;
mod npz;
pub mod points;
pub mod pose_format;
pub mod still;
pub mod webxr;
pub mod xr;

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

pub use axes::{Axes, AxesSource, Camera};
pub(crate) use documents::side_named;
use nalgebra::{Point2, Point3};
use thiserror::Error;

use super::import::{ImportOptions, ImportReport, import_all, in_one_place};
use super::lines::unmarked;
use super::motion::format::NotKnown;
use super::motion::{Content, ContentError, Format, Motion, bvh, rate_notice};
use handcast_hand::landmarks::{JointPoints, from_landmarks_21, move_tips_to_ends};
use handcast_hand::{JointAngle, MAX_TIME, Side, usual_step};
use handcast_limits::{Limit, Limits};

/// Most bytes in a text that is read as a whole: all but landmark lines and WebXR-shaped frames, which are as long as motions
/// may be.
pub const MAX_DOCUMENT_BYTES: u64 = 64 << 20;
/// Largest coordinate, in the file's unit.
const MAX_COORDINATE: f64 = 1e6;

/// One frame of joint positions.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkFrame {
    /// Seconds.
    pub time: f64,
    /// Names the source gives this frame, for still poses.
    pub names: Vec<String>,
    /// Positions in the file's unit.
    pub points: JointPoints,
    /// Positions in the picture they were found in, pixels, x right, y down; `None` where the source has none.
    pub image: Option<ImagePoints>,
    /// Positions in the picture as foreign files have them, with depths where they say some.
    pub picture: Option<Box<PicturePoints>>,
    /// How sure the source is of the hand, 0 to 1, where it says so.
    pub confidence: Option<f64>,
}

impl LandmarkFrame {
    /// A frame of joints in space.
    pub fn of(time: f64, points: JointPoints) -> Self {
        Self { time, names: Vec::new(), points, image: None, picture: None, confidence: None }
    }
}

/// Unit of positions in a picture, x right, y down from its upper left corner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureUnit {
    /// Pixels; depths, too.
    Pixels,
    /// Shares of the picture's width and height; depths are shares of the width.
    Shares,
}

/// Joints in a picture, with how much farther away than the wrist each is, in the same unit.
#[derive(Clone, Debug, PartialEq)]
pub struct PicturePoints {
    /// Unit of the points.
    pub unit: PictureUnit,
    /// Whether the third coordinate, away from the camera, says something.
    pub deep: bool,
    /// Positions in the order of [`Joint::ALL`](handcast_hand::Joint::ALL).
    pub points: JointPoints,
}

/// Positions of the 25 joints in a picture, in the order of [`Joint::ALL`](handcast_hand::Joint::ALL), pixels;
/// `None` where one was not seen.
pub type ImagePoints = [Option<Point2<f64>>; 25];

/// A recording of the joints of one hand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LandmarkClip {
    /// Frames per second, where the source says so.
    pub rate: Option<f64>,
    /// Whether that is not the source's word, but taken for granted.
    pub rate_assumed: bool,
    /// Left or right, where the source says so.
    pub side: Option<Side>,
    /// Metres in one unit of the points; `None` when the source does not say.
    pub metres: Option<f64>,
    /// Where the source says it comes from.
    pub made_by: Option<String>,
    /// Number of points in a frame as the source has them: 21, 25 or 26.
    pub points_per_frame: usize,
    /// Whether the tips lie inside the fingers, as MediaPipe has them ([`handcast_hand::landmarks::TIP_INSIDE`]), and not
    /// at their ends.
    pub tips_inside: bool,
    /// Axes of the points.
    pub axes: Axes,
    /// What told the axes.
    pub axes_from: AxesSource,
    /// Whether the points lie about the hand's own middle, so that they do not say where the hand is.
    pub centred: bool,
    /// Whether the source's word for the side may be that of the hand in a mirrored picture.
    pub side_unsure: bool,
    /// Width and height of the picture, pixels, where the source says so.
    pub image_size: Option<[f64; 2]>,
    /// What is worth knowing of how the file was read.
    pub notes: Vec<String>,
    /// The frames, in order of time.
    pub frames: Vec<LandmarkFrame>,
}

impl LandmarkClip {
    /// The same at another rate, frames a second, where its own is taken for granted.
    #[must_use]
    pub fn at_rate(mut self, rate: f64) -> Self {
        if let Some(assumed) = self.rate.filter(|_| self.rate_assumed) {
            (self.rate, self.rate_assumed) = (Some(rate), false);
            self.frames.iter_mut().for_each(|frame| frame.time *= assumed / rate);
        }
        self
    }

    /// That its rate is taken for granted, where there is more than one frame.
    pub fn rate_notice(&self) -> Option<String> {
        let rate = self.rate.filter(|_| self.rate_assumed && self.frames.len() > 1)?;
        Some(rate_notice(rate))
    }

    /// That it would take far longer than hands do, where it tells times.
    pub fn pace_notice(&self) -> Option<String> {
        let times: Vec<f64> = self.frames.iter().map(|frame| frame.time).collect();
        pace_notice(&times)
    }

    /// Points of a frame with the tips at the ends of the fingers.
    pub(crate) fn to_ends(&self, mut points: JointPoints) -> JointPoints {
        if self.tips_inside {
            move_tips_to_ends(&mut points);
        }
        points
    }
}

/// Recordings in the making: one for each side that is told, and one of a hand whose side is not.
struct Sided {
    /// What all have in common.
    like: LandmarkClip,
    clips: Vec<LandmarkClip>,
    /// Seconds of the recording's frames.
    instants: Vec<f64>,
    /// Of each recording the number of the frame that it had its last hand in.
    last: Vec<usize>,
    /// Hands that are left out: beside another one of their side, and in frames with the time of the frame before.
    beside: usize,
    repeated: usize,
}

impl Sided {
    fn new(like: LandmarkClip) -> Self {
        Self { like, clips: Vec::new(), instants: Vec::new(), last: Vec::new(), beside: 0, repeated: 0 }
    }

    /// A frame of the recording, whatever hands are in it.
    fn pass(&mut self, time: f64) {
        self.instants.push(time);
    }

    /// A frame of the hand of this side. Of several of one side in an instant the first is taken; the same hand once more,
    /// as where a program reads faster than its tracker gives, is none.
    fn push(&mut self, side: Option<Side>, frame: LandmarkFrame) -> Result<(), String> {
        let at = self.clips.iter().position(|clip| clip.side == side).unwrap_or_else(|| {
            self.clips.push(LandmarkClip { side, ..self.like.clone() });
            self.last.push(0);
            self.clips.len() - 1
        });
        let before = self.clips[at].frames.last();
        if before.is_some_and(|before| before.time == frame.time) {
            if before.is_some_and(|before| before.points == frame.points) {
                return Ok(());
            }
            let same_frame = self.last[at] == self.instants.len();
            *(if same_frame { &mut self.beside } else { &mut self.repeated }) += 1;
            return Ok(());
        }
        check_time(frame.time, before)?;
        self.last[at] = self.instants.len();
        self.clips[at].frames.push(frame);
        Ok(())
    }

    /// One recording or two, the left one first.
    fn finished(self) -> Result<Vec<LandmarkClip>, String> {
        let mut clips = self.clips;
        let (beside, repeated) = (self.beside, self.repeated);
        if repeated > clips.iter().map(|clip| clip.frames.len()).sum() {
            return Err(format!("{repeated} hands are in frames with the time of the frame before"));
        }
        for clip in &mut clips {
            let beside = (beside > 0).then(|| {
                format!("{beside} hands beside another one of their side, or without a side, are left out")
            });
            let repeated = (repeated > 0).then(|| {
                format!("{repeated} hands in frames with the time of the frame before are left out")
            });
            clip.notes.extend([beside, repeated].into_iter().flatten());
        }
        tell_absences(&mut clips, self.instants);
        clips.sort_by_key(|clip| clip.side.map_or(2, |side| side as usize));
        continuity::restore(&mut clips);
        match clips.len() {
            0 => Err("no frame has a hand".into()),
            1 | 2 => Ok(clips),
            _ => Err("hands called left, hands called right, and hands without a side".into()),
        }
    }
}

/// Gives hands a frame without a point at the instants of a recording, between the first and the last one that shows them, at
/// which it does not.
fn tell_absences(clips: &mut [LandmarkClip], mut instants: Vec<f64>) {
    instants.sort_by(f64::total_cmp);
    instants.dedup();
    for clip in clips {
        let (Some(first), Some(last)) = (clip.frames.first(), clip.frames.last()) else { continue };
        let within = first.time..last.time;
        let mut all = Vec::with_capacity(clip.frames.len());
        let mut absent = instants.iter().copied().filter(|time| within.contains(time)).peekable();
        for frame in std::mem::take(&mut clip.frames) {
            while let Some(time) = absent.next_if(|time| *time < frame.time) {
                all.push(LandmarkFrame::of(time, [None; 25]));
            }
            absent.next_if(|time| *time == frame.time);
            all.push(frame);
        }
        clip.frames = all;
    }
}

/// Seconds of time stamps whose unit is not told: seconds where the middle step is below 1, milliseconds below 2000,
/// microseconds below 2 million, else nanoseconds.
fn seconds_of_stamps(stamps: &[f64]) -> f64 {
    match usual_step(stamps) {
        Some(step) if step < 1.0 => 1.0,
        Some(step) if step >= 2e6 => 1e-9,
        Some(step) if step >= 2000.0 => 1e-6,
        _ => 1e-3,
    }
}

/// From so many seconds between most of its frames on a recording is none of a hand that moves.
const SLOWEST: f64 = 5.0;

/// That frames at these times would take far longer than hands do.
pub(crate) fn pace_notice(times: &[f64]) -> Option<String> {
    let step = usual_step(times).filter(|step| *step >= SLOWEST)?;
    Some(format!("its frames are {step:.0} s apart: are its times in another unit than seconds?"))
}

/// Seconds of times that are seconds by their name: they are, unless hardly anything would move then.
fn seconds_of_times(times: &[f64]) -> f64 {
    if usual_step(times).is_some_and(|step| step >= SLOWEST) { seconds_of_stamps(times) } else { 1.0 }
}

/// Why landmarks could not be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LandmarkFileError {
    /// The file could not be opened or read.
    #[error("landmarks: {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A line is wrong.
    #[error("landmarks: {path}: line {line}: {what}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// A pose of a WebXR file is wrong, or the file as a whole.
    #[error("webxr: {path}: {what}")]
    Webxr {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        what: String,
    },
    /// The content is none that is known.
    #[error("{path}: {what}")]
    Unknown {
        /// The file.
        path: PathBuf,
        /// What was found, and what was tried.
        what: NotKnown,
    },
    /// A file of another program is wrong.
    #[error("{format}: {path}: {what}")]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Short name of the format.
        format: &'static str,
        /// What is wrong and where.
        what: String,
    },
}

impl LandmarkClip {
    /// Reads a file of any kind that has one hand.
    ///
    /// # Errors
    /// See [`LandmarkFileError`].
    pub fn read(path: &Path) -> Result<Self, LandmarkFileError> {
        let mut hands = Self::read_all(path)?;
        match (hands.pop(), hands.is_empty()) {
            (Some(hand), true) => Ok(hand),
            _ => {
                Err(LandmarkFileError::Webxr { path: path.into(), what: "two hands, allowed is one".into() })
            }
        }
    }

    /// Reads a file of any kind, told by its content: what is neither still poses nor WebXR-shaped frames are landmark
    /// lines. At least one hand, two of formats that hold two.
    ///
    /// # Errors
    /// See [`LandmarkFileError`].
    pub fn read_all(path: &Path) -> Result<Vec<Self>, LandmarkFileError> {
        Self::read_all_within(path, &Limits::default())
    }

    /// As [`LandmarkClip::read_all`], within other limits.
    ///
    /// # Errors
    /// See [`LandmarkFileError`].
    pub fn read_all_within(path: &Path, limits: &Limits) -> Result<Vec<Self>, LandmarkFileError> {
        let file = File::open(path).map_err(|source| LandmarkFileError::Io { path: path.into(), source })?;
        Self::read_all_from(path, BufReader::new(file), limits)
    }

    /// As [`LandmarkClip::read_all_within`], from any reader; `path` names it in messages.
    ///
    /// # Errors
    /// See [`LandmarkFileError`].
    pub fn read_all_from(
        path: &Path,
        mut reader: impl BufRead,
        limits: &Limits,
    ) -> Result<Vec<Self>, LandmarkFileError> {
        let io_error = |source| LandmarkFileError::Io { path: path.into(), source };
        let piece = reader.fill_buf().map_err(io_error)?;
        let mark = piece.len() - unmarked(piece).len();
        reader.consume(mark);
        let start = reader.fill_buf().map_err(io_error)?;
        let webxr = |what| LandmarkFileError::Webxr { path: path.into(), what };
        if still::sniff(start) {
            let text = whole(reader, MAX_DOCUMENT_BYTES).map_err(io_error)?;
            let clip = check_size(&text).and_then(|()| still::parse(&text, limits));
            return clip.map(|clip| vec![clip]).map_err(webxr);
        }
        if webxr::sniff(start) {
            return webxr::clips(reader, limits).map_err(webxr);
        }
        // Their header may name what other formats name.
        let lines = (points::FORMAT.sniff)(start);
        if let Some(document) = DOCUMENTS.iter().find(|d| !lines && (d.format.sniff)(start)) {
            let format = document.format.id;
            let most = if document.binary { limits.bytes } else { MAX_DOCUMENT_BYTES };
            let bytes = whole(reader, most).map_err(io_error)?;
            let clips = if document.binary {
                let checked = limits.check_count(Limit::Bytes, bytes.len());
                checked.map_err(|excess| excess.to_string()).and_then(|()| (document.parse)(&bytes, limits))
            } else {
                parsed(document.parse, &bytes, limits)
            };
            return clips.map_err(|what| LandmarkFileError::Foreign { path: path.into(), format, what });
        }
        if !lines && let Some(what) = NotKnown::joints(start) {
            return Err(LandmarkFileError::Unknown { path: path.into(), what });
        }
        let clip = points::parse(reader, limits).map_err(|(line, what)| LandmarkFileError::Line {
            path: path.into(),
            line,
            what,
        })?;
        Ok(vec![clip])
    }
}

/// A format whose files are read as a whole into recordings.
struct Document {
    format: &'static Format,
    parse: fn(&[u8], &Limits) -> Result<Vec<LandmarkClip>, String>,
    /// Whether it is no text, and may have as many bytes as any file.
    binary: bool,
}

static DOCUMENTS: [Document; 9] = [
    Document { format: &pose_format::FORMAT, parse: pose_format::parse, binary: true },
    Document { format: &mano::NPZ, parse: mano::parse_npz, binary: true },
    Document { format: &mano::NPY, parse: mano::parse_npy, binary: true },
    Document { format: &bvh::FORMAT, parse: bvh::parse_foreign, binary: true },
    Document { format: &mano::FORMAT, parse: mano::parse, binary: false },
    Document { format: &leap::FORMAT, parse: leap::parse, binary: false },
    Document { format: &iwer::FORMAT, parse: iwer::parse, binary: false },
    Document { format: &mediapipe::FORMAT, parse: mediapipe::parse, binary: false },
    Document { format: &xr::FORMAT, parse: xr::parse, binary: false },
];

/// Reads a document of a format in the table, as [`Format`] wants it.
fn read_document(
    format: &'static Format,
    parse: fn(&[u8], &Limits) -> Result<Vec<LandmarkClip>, String>,
    bytes: &[u8],
    limits: &Limits,
) -> Result<Content, ContentError> {
    let clips = parsed(parse, bytes, limits);
    Ok(Content::Joints(clips.map_err(|what| ContentError::Foreign { format: format.id, what })?))
}

/// The recordings of a text of JSON. What is no number by the name that Python writes for it is what is missing.
fn parsed(
    parse: fn(&[u8], &Limits) -> Result<Vec<LandmarkClip>, String>,
    text: &[u8],
    limits: &Limits,
) -> Result<Vec<LandmarkClip>, String> {
    check_size(text)?;
    parse(text, limits).or_else(|what| null_for_nan(text).map_or(Err(what), |text| parse(&text, limits)))
}

/// What programs write that is no JSON, in place of a number.
const NO_NUMBERS: [&[u8]; 3] = [b"NaN", b"Infinity", b"-Infinity"];

/// The text with `null` for each of [`NO_NUMBERS`]; `None` where there are none.
fn null_for_nan(text: &[u8]) -> Option<Vec<u8>> {
    let (mut out, mut rest) = (Vec::new(), text);
    let (mut quoted, mut kept) = (false, 0);
    while let Some(&byte) = rest.get(kept) {
        let none = NO_NUMBERS.iter().find(|name| !quoted && rest[kept..].starts_with(name));
        match (byte, none) {
            (_, Some(name)) => {
                out.extend_from_slice(&rest[..kept]);
                out.extend_from_slice(b"null");
                (rest, kept) = (&rest[kept + name.len()..], 0);
                continue;
            }
            (b'\\', _) if quoted => kept += 1,
            (b'"', _) => quoted = !quoted,
            _ => {}
        }
        kept += 1;
    }
    if out.is_empty() {
        return None;
    }
    out.extend_from_slice(rest);
    Some(out)
}

/// All bytes of a file, and one more than `most` of a larger one.
fn whole(reader: impl Read, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    reader.take(most.saturating_add(1)).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn check_size(text: &[u8]) -> Result<(), String> {
    if text.len() as u64 <= MAX_DOCUMENT_BYTES {
        return Ok(());
    }
    Err(format!("larger than the {MAX_DOCUMENT_BYTES} bytes allowed"))
}

/// The poses of all hands, and what solving for them found.
pub(crate) fn solved(
    format: &'static Format,
    hands: &[LandmarkClip],
    options: &ImportOptions,
) -> Result<Motion, ContentError> {
    let (clip, reports) = import_all(hands, options)?;
    // 21 points show neither twists nor how the palm bends.
    let shown =
        |angle: &JointAngle| !angle.name().ends_with("twisting") && !angle.name().contains("0_flexion");
    let mut notes: BTreeSet<String> = hands.iter().flat_map(|hand| hand.notes.clone()).collect();
    notes.extend(hands.iter().filter_map(LandmarkClip::rate_notice));
    let trembling = |report: &ImportReport| report.trembling().filter(|_| options.smooth.is_none());
    notes.extend(reports.iter().flat_map(|report| [report.notice(), trembling(report)]).flatten());
    notes.extend(in_one_place(hands, &reports));
    Ok(Motion {
        notes: notes.into_iter().collect(),
        placed: reports.iter().all(|report| report.placed),
        angles: JointAngle::ALL.into_iter().filter(shown).collect(),
        import: reports.into_iter().reduce(|all, report| all.with(&report)),
        ..Motion::of(format, clip)
    })
}

type Point = Option<[f64; 3]>;

/// Frames a second of recordings that tell neither times nor a rate.
const RATE: f64 = 30.0;

/// The time that a frame tells under this name, where frames do: all of a recording or none (`untimed`), as its first one.
fn told_time(
    told: Option<f64>,
    is_first: bool,
    untimed: &mut bool,
    name: &str,
) -> Result<Option<f64>, String> {
    *untimed |= is_first && told.is_none();
    match (told, *untimed) {
        (Some(_), true) => Err(format!("{name} is told, which the frames before do not")),
        (None, false) => Err(format!("missing field `{name}`, which the frames before tell")),
        _ => Ok(told),
    }
}

/// That a frame comes after the one before.
fn check_time(t: f64, before: Option<&LandmarkFrame>) -> Result<(), String> {
    if t.is_nan() || t.abs() > MAX_TIME {
        return Err(format!("t is {t}, allowed -1e10 to 1e10 s"));
    }
    match before {
        Some(before) if t <= before.time => {
            Err(format!("t is {t} s, not after the {} s of the frame before", before.time))
        }
        _ => Ok(()),
    }
}

/// Points of any layout, checked and put in the order of the 25 joints.
fn place(points: &[Point], count: usize) -> Result<JointPoints, String> {
    if points.len() != count {
        return Err(format!("{} points, expected {count}", points.len()));
    }
    let mut checked = [None; 26];
    for (i, (to, from)) in checked.iter_mut().zip(points).enumerate() {
        let Some(p) = from else { continue };
        if let Some(v) = p.iter().find(|v| !(-MAX_COORDINATE..=MAX_COORDINATE).contains(*v)) {
            return Err(format!("point {i} has coordinate {v}, allowed -1e6 to 1e6"));
        }
        *to = Some(Point3::from(*p));
    }
    Ok(match count {
        21 => from_landmarks_21(&std::array::from_fn(|i| checked[i])),
        // OpenXR's first joint is the middle of the palm, which follows from the others.
        26 => std::array::from_fn(|i| checked[i + 1]),
        _ => std::array::from_fn(|i| checked[i]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::WriteOptions;
    use crate::motion::tests::feasible;

    #[test]
    fn what_is_no_number_is_missing() {
        let text = br#"[{"NaN\"NaN":[NaN,-Infinity, Infinity,1]}]"#;
        assert_eq!(null_for_nan(text).unwrap(), br#"[{"NaN\"NaN":[null,null, null,1]}]"#);
        assert_eq!(null_for_nan(br#"["NaN",1]"#), None);
        let point = |k: usize| format!("{{\"x\":0.{k},\"y\":0.1,\"z\":0.2}}");
        let result = |points: Vec<String>| format!("{{\"worldLandmarks\":[[{}]]}}", points.join(","));
        let (good, mut bad) =
            ((0..21).map(point).collect::<Vec<_>>(), (0..21).map(point).collect::<Vec<_>>());
        bad[3] = "{\"x\":NaN,\"y\":NaN,\"z\":NaN}".into();
        bad[4] = "[NaN,NaN,NaN]".into();
        bad[5] = "[0.1,0.2,NaN]".into();
        let text = format!("[{},{}]", result(good), result(bad));
        let read =
            |text: &str| LandmarkClip::read_all_from("-".as_ref(), text.as_bytes(), &Limits::default());
        let clip = read(&text).unwrap().remove(0);
        assert_eq!(clip.frames[1].points.iter().flatten().count(), 18);
        let joint = |k: usize| format!("[0.0{k},0,0]");
        let mut joints: Vec<String> = (0..26).map(joint).collect();
        joints[7] = "[NaN,NaN,NaN]".into();
        let clip = read(&format!("[{{\"t\":1,\"joints\":[{}]}}]", joints.join(","))).unwrap().remove(0);
        assert_eq!(clip.frames[0].points.iter().flatten().count(), 24);
    }

    #[test]
    fn files_with_a_byte_order_mark_are_read_as_without() {
        let folder = tempfile::tempdir().unwrap();
        for id in ["webxr", "landmarks"] {
            let format = Format::by_id(id).unwrap();
            let plain = format.write(&feasible(Side::Left), &WriteOptions::default()).unwrap().bytes;
            let path = folder.path().join(id);
            let read = |bytes: &[u8]| {
                std::fs::write(&path, bytes).unwrap();
                LandmarkClip::read_all(&path).unwrap()
            };
            assert_eq!(read(&plain), read(&["\u{feff}".as_bytes(), &plain].concat()), "{id}");
        }
    }
}
