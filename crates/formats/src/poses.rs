//! The project's own pose file: JSON lines, one header and then one line for each hand and instant.
//!
//! ```text
//! {"format":"handcast-poses","version":1,"rate":30.0,"hands":[{"side":"right","morphology":{…}}]}
//! {"t":0.0333,"hand":"right","wrist":{"translation":[x,y,z],"rotation":[x,y,z,w]},
//!  "angles":{"index1_flexion":12.3},"confidence":0.9,"iou":0.93}
//! ```
//!
//! Times are seconds, translations metres, rotations unit quaternions, angles degrees; angles that are
//! left out are zero. A line with `"valid":false` is an instant at which the hand was lost: it keeps its
//! place in time, and its pose, when there is one, is only a guess; `"why"` may say more: `"lost"`,
//! `"touching"` (it and the other hand are one silhouette, and both hold their last pose) or `"not-yet"` (it has
//! not been seen open so far). Lines of one hand are in order of
//! time; the lines of two hands may be mixed in any way.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::atomic::AtomicFile;
use super::lines::LineReader;
use handcast_hand::{HandPose, Morphology, PoseData, Side};

/// The `format` of the header.
pub const FORMAT: &str = "handcast-poses";
/// The `version` of the header.
pub const VERSION: u32 = 1;
/// Most bytes in one line.
pub const MAX_LINE_BYTES: usize = 64 * 1024;
/// Most poses a [`PoseClip`] reads from one file.
pub const MAX_FRAMES: usize = 4_000_000;
/// Most hands in one file.
pub const MAX_HANDS: usize = 2;

/// Why a hand has no pose of its own at an instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Absence {
    /// It was not found.
    Lost,
    /// It touches or covers the other hand, and the two cannot be told apart.
    Touching,
    /// It has not been seen open yet.
    NotYet,
}

/// One hand at one instant of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedPose {
    /// Seconds from the start.
    pub time: f64,
    /// The pose; where `valid` is false, a guess or the neutral pose.
    pub pose: HandPose,
    /// How sure its maker was, 0 to 1.
    pub confidence: Option<f64>,
    /// Non-overlap turned round: intersection over union of model and image silhouette, 0 to 1.
    pub iou: Option<f64>,
    /// False where the hand was lost.
    pub valid: bool,
    /// Why it was, where that is known.
    pub why: Option<Absence>,
}

impl TimedPose {
    /// A valid pose about which nothing else is known.
    pub fn new(time: f64, pose: HandPose) -> Self {
        Self { time, pose, confidence: None, iou: None, valid: true, why: None }
    }

    /// An instant at which the hand was lost; the pose is neutral.
    pub fn lost(time: f64, side: Side) -> Self {
        Self { valid: false, ..Self::new(time, HandPose::neutral(side)) }
    }
}

/// What the header says of one hand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HandTrackInfo {
    /// Left or right.
    pub side: Side,
    /// Its sizes, where they are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub morphology: Option<Morphology>,
}

/// The header: what holds for the whole file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseHeader {
    /// Frames per second, where the time base is even.
    pub rate: Option<f64>,
    /// The hands whose poses follow: one, or left and right.
    pub hands: Vec<HandTrackInfo>,
    /// What made the poses, in words.
    pub made_by: Option<String>,
}

impl PoseHeader {
    /// The header of a file with one hand.
    pub fn one(side: Side, morphology: Option<Morphology>, rate: Option<f64>) -> Self {
        Self { rate, hands: vec![HandTrackInfo { side, morphology }], made_by: None }
    }

    /// The entry of a hand.
    pub fn hand(&self, side: Side) -> Option<&HandTrackInfo> {
        self.hands.iter().find(|h| h.side == side)
    }
}

/// Why a pose file could not be read or written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PosesError {
    /// The file could not be opened.
    #[error("poses: {path}: {source}")]
    Open {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Reading or writing failed.
    #[error("poses: {0}")]
    Io(#[from] io::Error),
    /// A line is wrong.
    #[error("poses: line {line}: {what}")]
    Line {
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// A pose that was to be written is not usable.
    #[error("poses: frame {frame}: {what}")]
    Frame {
        /// Frame number, from 0.
        frame: usize,
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// More than a reader takes.
    #[error("poses: more than the {MAX_FRAMES} poses allowed")]
    TooManyFrames,
}

#[derive(Serialize, Deserialize)]
struct HeaderLine {
    format: String,
    version: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rate: Option<f64>,
    hands: Vec<HandTrackInfo>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    made_by: Option<String>,
}

#[derive(Serialize, Deserialize)]
struct FrameLine {
    t: f64,
    #[serde(flatten)]
    pose: PoseData,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    confidence: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    iou: Option<f64>,
    #[serde(default = "yes", skip_serializing_if = "is_true")]
    valid: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    why: Option<Absence>,
}

fn yes() -> bool {
    true
}

fn is_true(v: &bool) -> bool {
    *v
}

fn check_header(header: &PoseHeader) -> Result<(), String> {
    if let Some(rate) = header.rate
        && !(rate > 0.0 && rate <= 10_000.0)
    {
        return Err(format!("rate is {rate}, allowed 0 to 10000 frames per second"));
    }
    if header.hands.is_empty() || header.hands.len() > MAX_HANDS {
        return Err(format!("{} hands, allowed 1 or {MAX_HANDS}", header.hands.len()));
    }
    if header.hands.len() == 2 && header.hands[0].side == header.hands[1].side {
        return Err(format!("the {} hand appears twice", header.hands[0].side.name()));
    }
    for hand in &header.hands {
        if let Some(m) = &hand.morphology {
            m.validate().map_err(|e| format!("{} hand: {e}", hand.side.name()))?;
        }
    }
    Ok(())
}

/// Order in time and sound values, shared by reader and writer.
#[derive(Default)]
struct FrameCheck {
    last: [Option<f64>; 2],
}

impl FrameCheck {
    fn check(&mut self, header: &PoseHeader, frame: &TimedPose) -> Result<(), String> {
        let side = frame.pose.side;
        if header.hand(side).is_none() {
            return Err(format!("the {} hand is not named in the header", side.name()));
        }
        if !(-1e9..=1e9).contains(&frame.time) {
            return Err(format!("t is {}, allowed -1e9 to 1e9 s", frame.time));
        }
        let last = &mut self.last[side as usize];
        if let Some(last) = *last
            && frame.time <= last
        {
            return Err(format!("t is {} s, not after {last} s of the {} hand", frame.time, side.name()));
        }
        *last = Some(frame.time);
        for (what, value) in [("confidence", frame.confidence), ("iou", frame.iou)] {
            if let Some(v) = value
                && !(0.0..=1.0).contains(&v)
            {
                return Err(format!("{what} is {v}, allowed 0 to 1"));
            }
        }
        if !frame.pose.is_finite() {
            return Err("the pose is not finite".into());
        }
        Ok(())
    }
}

/// Reads a pose file frame by frame.
pub struct PoseReader<R> {
    lines: LineReader<R>,
    header: PoseHeader,
    check: FrameCheck,
    failed: bool,
}

impl PoseReader<BufReader<File>> {
    /// Opens a file.
    ///
    /// # Errors
    /// [`PosesError::Open`], and those of [`PoseReader::new`].
    pub fn open(path: &Path) -> Result<Self, PosesError> {
        let file = File::open(path).map_err(|source| PosesError::Open { path: path.into(), source })?;
        Self::new(BufReader::new(file))
    }
}

impl<R: BufRead> PoseReader<R> {
    /// Reads the header.
    ///
    /// # Errors
    /// [`PosesError::Line`] when the first line is no header of this format and version.
    pub fn new(reader: R) -> Result<Self, PosesError> {
        let mut lines = LineReader::new(reader, MAX_LINE_BYTES);
        let header = match lines.next_line() {
            Ok(Some(text)) => parse_header(text),
            Ok(None) => Err("the file is empty".into()),
            Err(e) => Err(e.describe(MAX_LINE_BYTES)),
        };
        let header = header.map_err(|what| PosesError::Line { line: lines.number(), what })?;
        Ok(Self { lines, header, check: FrameCheck::default(), failed: false })
    }

    /// The header.
    pub fn header(&self) -> &PoseHeader {
        &self.header
    }

    fn next_frame(&mut self) -> Result<Option<TimedPose>, String> {
        let max = self.lines.max_bytes();
        let Some(text) = self.lines.next_line().map_err(|e| e.describe(max))? else {
            return Ok(None);
        };
        let line: FrameLine = serde_json::from_str(text).map_err(|e| json_message(&e))?;
        let pose = HandPose::try_from(line.pose)?;
        let frame = TimedPose {
            time: line.t,
            pose,
            confidence: line.confidence,
            iou: line.iou,
            valid: line.valid,
            why: line.why,
        };
        self.check.check(&self.header, &frame)?;
        Ok(Some(frame))
    }
}

impl<R: BufRead> Iterator for PoseReader<R> {
    type Item = Result<TimedPose, PosesError>;

    /// The next pose; after an error, none.
    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        match self.next_frame() {
            Ok(frame) => frame.map(Ok),
            Err(what) => {
                self.failed = true;
                Some(Err(PosesError::Line { line: self.lines.number(), what }))
            }
        }
    }
}

fn parse_header(text: &str) -> Result<PoseHeader, String> {
    #[derive(Deserialize)]
    struct Format {
        format: Option<String>,
        version: Option<u32>,
    }
    let format: Format = serde_json::from_str(text).map_err(|e| json_message(&e))?;
    if format.format.as_deref() != Some(FORMAT) {
        return Err(format!("format is {:?}, expected {FORMAT:?}", format.format.unwrap_or_default()));
    }
    if format.version != Some(VERSION) {
        return Err(format!("version is {:?}, expected {VERSION}", format.version));
    }
    let line: HeaderLine = serde_json::from_str(text).map_err(|e| json_message(&e))?;
    let header = PoseHeader { rate: line.rate, hands: line.hands, made_by: line.made_by };
    check_header(&header)?;
    Ok(header)
}

/// serde_json's message without its own line number, which is always 1 here.
pub(crate) fn json_message(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let what = match text.rfind(" at line ") {
        Some(at) => format!("{}, column {}", &text[..at], error.column()),
        None => text,
    };
    if error.is_data() { what } else { format!("not JSON: {what}") }
}

/// Writes a pose file frame by frame.
pub struct PoseWriter<W: Write> {
    writer: W,
    header: PoseHeader,
    check: FrameCheck,
    frames: usize,
}

impl PoseWriter<AtomicFile> {
    /// Creates a file and writes the header. The file appears when what [`PoseWriter::finish`] gives back
    /// is committed.
    ///
    /// # Errors
    /// [`PosesError::Open`], and those of [`PoseWriter::new`].
    pub fn create(path: &Path, header: PoseHeader) -> Result<Self, PosesError> {
        let file =
            AtomicFile::create(path).map_err(|source| PosesError::Open { path: path.into(), source })?;
        Self::new(file, header)
    }
}

impl<W: Write> PoseWriter<W> {
    /// Writes the header.
    ///
    /// # Errors
    /// [`PosesError::Line`] for a header a reader would refuse, [`PosesError::Io`].
    pub fn new(mut writer: W, header: PoseHeader) -> Result<Self, PosesError> {
        check_header(&header).map_err(|what| PosesError::Line { line: 1, what })?;
        let line = HeaderLine {
            format: FORMAT.into(),
            version: VERSION,
            rate: header.rate,
            hands: header.hands.clone(),
            made_by: header.made_by.clone(),
        };
        write_line(&mut writer, &line)?;
        Ok(Self { writer, header, check: FrameCheck::default(), frames: 0 })
    }

    /// Writes one pose. Angles are rounded to 1e-5 degree, translations to 0.1 micrometre, quaternion
    /// components to 1e-8 and times to a microsecond: far below what a stream carries.
    ///
    /// # Errors
    /// [`PosesError::Frame`] for a pose a reader would refuse, [`PosesError::Io`].
    pub fn write(&mut self, frame: &TimedPose) -> Result<(), PosesError> {
        let time = (frame.time * 1e6).round() / 1e6;
        let rounded = TimedPose { time, ..frame.clone() };
        self.check
            .check(&self.header, &rounded)
            .map_err(|what| PosesError::Frame { frame: self.frames, what })?;
        let line = FrameLine {
            t: time,
            pose: PoseData::from(&frame.pose),
            confidence: frame.confidence,
            iou: frame.iou,
            valid: frame.valid,
            why: frame.why,
        };
        write_line(&mut self.writer, &line)?;
        self.frames += 1;
        Ok(())
    }

    /// Flushes, and gives the writer back.
    ///
    /// # Errors
    /// [`PosesError::Io`].
    pub fn finish(mut self) -> Result<W, PosesError> {
        self.writer.flush()?;
        Ok(self.writer)
    }
}

fn write_line(writer: &mut impl Write, value: &impl Serialize) -> Result<(), PosesError> {
    serde_json::to_writer(&mut *writer, value).map_err(io::Error::from)?;
    writer.write_all(b"\n")?;
    Ok(())
}

/// A whole pose file in memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseClip {
    /// The header.
    pub header: PoseHeader,
    /// The poses of all hands, in the order of the file.
    pub frames: Vec<TimedPose>,
}

impl PoseClip {
    /// Reads a file.
    ///
    /// # Errors
    /// See [`PosesError`].
    pub fn read(path: &Path) -> Result<Self, PosesError> {
        Self::from_reader(PoseReader::open(path)?)
    }

    /// Reads what is left of a reader.
    ///
    /// # Errors
    /// See [`PosesError`].
    pub fn from_reader<R: BufRead>(mut reader: PoseReader<R>) -> Result<Self, PosesError> {
        let mut frames = Vec::new();
        for frame in &mut reader {
            if frames.len() == MAX_FRAMES {
                return Err(PosesError::TooManyFrames);
            }
            frames.push(frame?);
        }
        Ok(Self { header: reader.header, frames })
    }

    /// Writes a file.
    ///
    /// # Errors
    /// See [`PosesError`].
    pub fn write(&self, path: &Path) -> Result<(), PosesError> {
        let mut writer = PoseWriter::create(path, self.header.clone())?;
        for frame in &self.frames {
            writer.write(frame)?;
        }
        Ok(writer.finish()?.commit()?)
    }

    /// The poses of one hand, in order of time.
    pub fn of(&self, side: Side) -> impl Iterator<Item = &TimedPose> {
        self.frames.iter().filter(move |f| f.pose.side == side)
    }

    /// The valid poses of all hands at instants `rate` a second, counted from the first of any hand; each hand
    /// from its first pose to its last, gaps bridged. Empty for a rate that is not positive.
    pub fn even(&self, rate: f64) -> Self {
        let mut out = Self { header: self.header.clone(), frames: Vec::new() };
        out.header.rate = Some(rate);
        let valid = |side: Side| self.of(side).filter(|f| f.valid);
        let start = self.frames.iter().filter(|f| f.valid).map(|f| f.time).fold(f64::INFINITY, f64::min);
        if !rate.is_finite() || rate <= 0.0 {
            return out;
        }
        for side in [Side::Left, Side::Right] {
            let track: Vec<&TimedPose> = valid(side).collect();
            let (Some(first), Some(last)) = (track.first(), track.last()) else { continue };
            // A tick within a thousandth of an end counts as the end.
            let from = ((first.time - start) * rate - 1e-3).ceil().max(0.0) as usize;
            let to = ((last.time - start) * rate + 1e-3).floor() as usize;
            let mut at = 0;
            for tick in (from..=to).take(MAX_FRAMES) {
                let time = start + tick as f64 / rate;
                let (a, b, s) = neighbours(&track, &mut at, time);
                out.frames.push(between(a, b, s, time, true));
            }
        }
        out
    }

    /// One hand at the instants `0, 1/rate, 2/rate, …` after its first pose: angles and translations
    /// interpolated linearly, rotations on the great circle. An instant is valid when both neighbours
    /// are; between poses more than `max_gap` seconds apart the hand counts as lost.
    pub fn resampled(&self, side: Side, rate: f64, max_gap: f64) -> Vec<TimedPose> {
        let track: Vec<&TimedPose> = self.of(side).collect();
        let (Some(first), Some(last)) = (track.first(), track.last()) else { return Vec::new() };
        if !rate.is_finite() || rate <= 0.0 {
            return Vec::new();
        }
        let count =
            ((last.time - first.time) * rate + 1e-9).floor().min(MAX_FRAMES as f64 - 1.0) as usize + 1;
        let mut at = 0;
        (0..count)
            .map(|i| {
                let time = i as f64 / rate;
                let t = first.time + time;
                let (a, b, s) = neighbours(&track, &mut at, t);
                between(a, b, s, time, b.time - a.time <= max_gap)
            })
            .collect()
    }
}

/// The poses before and after an instant of a track that is not empty, and how far it is from one to the
/// other. `at` is where the search begins; instants must not go back.
fn neighbours<'a>(track: &[&'a TimedPose], at: &mut usize, time: f64) -> (&'a TimedPose, &'a TimedPose, f64) {
    while *at + 2 < track.len() && track[*at + 1].time <= time {
        *at += 1;
    }
    let (a, b) = (track[*at], track[(*at + 1).min(track.len() - 1)]);
    let span = b.time - a.time;
    (a, b, if span > 0.0 { ((time - a.time) / span).clamp(0.0, 1.0) } else { 0.0 })
}

fn between(a: &TimedPose, b: &TimedPose, s: f64, time: f64, near: bool) -> TimedPose {
    let mix = |x: Option<f64>, y: Option<f64>| Some(x? + s * (y? - x?));
    let valid = match s {
        0.0 => a.valid,
        1.0 => b.valid,
        _ => near && a.valid && b.valid,
    };
    TimedPose {
        time,
        pose: a.pose.interpolated(&b.pose, s),
        confidence: mix(a.confidence, b.confidence),
        iou: mix(a.iou, b.iou),
        valid,
        why: if s < 0.5 { a.why.or(b.why) } else { b.why.or(a.why) }.filter(|_| !valid),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::JointAngle;
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    const HEADER: &str = r#"{"format":"handcast-poses","version":1,"hands":[{"side":"right"}]}"#;

    fn read(text: &str) -> Result<PoseClip, PosesError> {
        PoseReader::new(text.as_bytes()).and_then(PoseClip::from_reader)
    }

    fn refused(text: &str) -> String {
        read(text).unwrap_err().to_string()
    }

    proptest! {
        #[test]
        fn clips_round_trip(
            frames in prop::collection::vec(
                (prop::array::uniform29(-2.0f64..2.0), prop::array::uniform6(-2.0f64..2.0), any::<bool>()),
                0..6,
            ),
        ) {
            let header = PoseHeader {
                rate: Some(30.0),
                hands: vec![
                    HandTrackInfo { side: Side::Left, morphology: Some(Morphology::default()) },
                    HandTrackInfo { side: Side::Right, morphology: None },
                ],
                made_by: Some("a test".into()),
            };
            let mut writer = PoseWriter::new(Vec::new(), header.clone()).unwrap();
            let mut written = Vec::new();
            for (i, (angles, global, left)) in frames.into_iter().enumerate() {
                let pose = HandPose {
                    side: if left { Side::Left } else { Side::Right },
                    translation: Vector3::new(global[0], global[1], global[2]),
                    rotation: UnitQuaternion::from_scaled_axis(Vector3::new(global[3], global[4], global[5])),
                    angles,
                };
                let frame = TimedPose { confidence: Some(0.5), valid: i != 2, ..TimedPose::new(i as f64 / 30.0, pose) };
                writer.write(&frame).unwrap();
                written.push(frame);
            }
            let clip = read(std::str::from_utf8(&writer.finish().unwrap()).unwrap()).unwrap();
            prop_assert_eq!(&clip.header, &header);
            prop_assert_eq!(clip.frames.len(), written.len());
            for (a, b) in clip.frames.iter().zip(&written) {
                prop_assert!((a.time - b.time).abs() <= 5.1e-7);
                prop_assert_eq!((a.valid, a.confidence, a.iou, a.pose.side), (b.valid, b.confidence, b.iou, b.pose.side));
                prop_assert!((a.pose.translation - b.pose.translation).amax() <= 5.1e-8);
                prop_assert!(a.pose.rotation.angle_to(&b.pose.rotation) < 1e-7);
                for (x, y) in a.pose.angles.iter().zip(&b.pose.angles) {
                    prop_assert!((x - y).to_degrees().abs() <= 5.1e-6);
                }
            }
        }
    }

    proptest! {
        #[test]
        fn damaged_files_never_panic(at in 0usize..400, byte in any::<u8>(), cut in 0usize..400) {
            let mut bytes =
                format!("{HEADER}\n{{\"t\":0,\"hand\":\"right\",\"angles\":{{\"index1_flexion\":5}}}}\n").into_bytes();
            let n = bytes.len();
            bytes[at % n] = byte;
            bytes.truncate(n - cut % n);
            if let Ok(reader) = PoseReader::new(&bytes[..]) {
                for frame in reader.flatten() {
                    prop_assert!(frame.pose.is_finite());
                }
            }
        }
    }

    #[test]
    fn errors_name_the_line() {
        assert!(refused("").contains("line 1: the file is empty"));
        assert!(refused(r#"{"format":"landmarks21"}"#).contains("landmarks21"));
        assert!(refused(&HEADER.replace(":1,", ":2,")).contains("version is Some(2), expected 1"));
        assert!(refused(&HEADER.replace(r#"{"side":"right"}"#, "")).contains("0 hands"));
        let frame = |line: &str| refused(&format!("{HEADER}\n\n{line}\n"));
        assert!(frame("{").starts_with("poses: line 3: "));
        assert!(frame(r#"{"t":0,"hand":"left"}"#).contains("left hand is not named in the header"));
        assert!(frame(r#"{"t":0,"hand":"right","iou":1.5}"#).contains("iou is 1.5, allowed 0 to 1"));
        assert!(frame(r#"{"t":0,"hand":"right","angles":{"x":1}}"#).contains("no joint angle is called"));
        let text = frame("{\"t\":1,\"hand\":\"right\"}\n{\"t\":1,\"hand\":\"right\"}");
        assert!(text.starts_with("poses: line 4: t is 1 s, not after 1 s"), "{text}");
        let long = format!("{{\"t\":0,\"hand\":\"right\",\"x\":\"{}\"}}", "y".repeat(MAX_LINE_BYTES));
        assert!(frame(&long).contains("longer than the 65536 bytes allowed"));
    }

    #[test]
    fn a_reader_stops_at_the_first_error() {
        let text = format!("{HEADER}\n{{\n{{\"t\":0,\"hand\":\"right\"}}\n");
        let mut reader = PoseReader::new(text.as_bytes()).unwrap();
        assert!(reader.next().unwrap().is_err());
        assert!(reader.next().is_none());
    }

    #[test]
    fn resampling_interpolates_and_marks_gaps() {
        let at = |t: f64| {
            let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, 10.0 * t);
            TimedPose::new(t, pose)
        };
        let clip = PoseClip {
            header: PoseHeader::one(Side::Right, None, None),
            frames: vec![at(1.0), at(1.5), at(3.0), at(3.1)],
        };
        let out = clip.resampled(Side::Right, 4.0, 0.6);
        assert_eq!(out.len(), 9);
        for (i, frame) in out.iter().enumerate() {
            assert_eq!(frame.time, i as f64 * 0.25);
            let expected = 10.0 * (1.0 + frame.time);
            assert!((frame.pose.angle(JointAngle::Index1Flexion).to_degrees() - expected).abs() < 1e-9);
            assert_eq!(frame.valid, i <= 2 || i == 8, "{i}");
        }
        assert!(clip.resampled(Side::Left, 4.0, 0.6).is_empty());
    }
}
