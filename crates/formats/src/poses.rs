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
//! `"touching"` (it and the other hand are one silhouette, and both hold their last pose), `"not-yet"` (it has
//! not been seen open so far) or `"bridged"` (it is on the way from the valid pose before to the one behind). Lines of one hand are in order of
//! time; the lines of two hands may be mixed in any way.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::atomic::AtomicFile;
use super::batches::write_each;
use super::decimal::push_number;
use super::lines::{BlockReader, LineReader, line_text, pieces};
use super::motion::{Format, Keeps, Lost, Motion, WriteOptions, Writer};
use handcast_hand::clip::MAX_HANDS;
use handcast_hand::{
    Absence, ClipHand, Degrees, FrameCheck, HandPose, JointAngle, PoseClip, PoseClipError, PoseData,
    PoseHeader, Side, TimedPose, WristData,
};
use handcast_limits::{Excess, Limit, Limits};

/// Its row of the table of formats.
pub(crate) static FORMAT: Format = Format {
    id: "jsonl",
    name: "poses",
    kind: "poses",
    ending: ".jsonl",
    hands: MAX_HANDS,
    sniff: is_lines,
    read: |bytes, limits| Ok(Motion::of(&FORMAT, PoseReader::new(bytes)?.into_clip_within(limits)?).into()),
    write: Some(Writer {
        keeps: Keeps::all(Lost::Told),
        write: |clip, _: &WriteOptions, out| {
            write_all(PoseWriter::new(out, clip.header.clone())?, clip)?;
            Ok(Vec::new())
        },
    }),
};

/// The `format` of the header.
pub const NAME: &str = "handcast-poses";
/// The `version` of the header.
pub const VERSION: u32 = 1;
/// Most bytes in one line.
pub const MAX_LINE_BYTES: usize = 64 * 1024;

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
    /// What holds for all poses is not usable.
    #[error("poses: {0}")]
    Header(PoseClipError),
    /// A pose that was to be written is not usable.
    #[error("poses: frame {frame}: {what}")]
    Frame {
        /// Frame number, from 0.
        frame: usize,
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// More than a reader takes.
    #[error("poses: {0}")]
    Excess(#[from] Excess),
}

/// What a header or document says it is.
#[derive(Deserialize)]
pub(super) struct Tag {
    format: Option<String>,
    version: Option<u32>,
    /// Of a document.
    frames: Option<IgnoredAny>,
}

impl Tag {
    pub(super) fn check(self) -> Result<(), String> {
        let format = self.format.unwrap_or_default();
        if format != NAME {
            return Err(format!("format is {format:?}, expected {NAME:?}"));
        }
        if self.version != Some(VERSION) {
            let told = self.version.map_or_else(|| "missing".to_owned(), |version| version.to_string());
            return Err(format!("version is {told}, allowed is {VERSION}"));
        }
        Ok(())
    }
}

/// Whether the first line is a header: that of lines, since it holds no frames.
pub(super) fn is_lines(bytes: &[u8]) -> bool {
    let start = bytes.trim_ascii_start();
    let start = start.get(..MAX_LINE_BYTES).unwrap_or(start);
    let first = start.split(|&b| b == b'\n').next().unwrap_or_default();
    let header = serde_json::from_slice::<Tag>(first);
    header.is_ok_and(|header| header.format.as_deref() == Some(NAME) && header.frames.is_none())
}

/// What a document says of its poses: a header, and whether there are any.
#[derive(Deserialize)]
pub(super) struct DocumentHead {
    format: Option<String>,
    version: Option<u32>,
    rate: Option<f64>,
    hands: Option<Vec<ClipHand>>,
    made_by: Option<String>,
    skin_tone: Option<u8>,
    frames: Option<IgnoredAny>,
}

impl DocumentHead {
    pub(super) fn has_frames(&self) -> bool {
        self.frames.is_some()
    }

    /// The header, if it is one of this format and version, and sound.
    pub(super) fn header(self) -> Result<PoseHeader, String> {
        Tag { format: self.format, version: self.version, frames: None }.check()?;
        let hands = self.hands.ok_or("missing field `hands`")?;
        let header = PoseHeader { rate: self.rate, hands, made_by: self.made_by, skin_tone: self.skin_tone };
        header.check().map(|()| header).map_err(|e| e.to_string())
    }
}

#[derive(Serialize, Deserialize)]
pub(super) struct HeaderLine {
    format: String,
    version: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rate: Option<f64>,
    hands: Vec<ClipHand>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    made_by: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    skin_tone: Option<u8>,
}

impl HeaderLine {
    pub(super) fn header(self) -> Result<PoseHeader, PoseClipError> {
        let Self { rate, hands, made_by, skin_tone, .. } = self;
        let header = PoseHeader { rate, hands, made_by, skin_tone };
        header.check().map(|()| header)
    }
}

/// A pose as a line has it.
#[derive(Deserialize)]
#[serde(try_from = "FrameData")]
pub(super) struct FrameLine(pub TimedPose);

/// The words of a line. Not flattened from a pose's, which would hold all of them in between.
#[derive(Deserialize)]
struct FrameData {
    t: f64,
    hand: Side,
    wrist: Option<WristData>,
    #[serde(default)]
    angles: Degrees,
    confidence: Option<f64>,
    iou: Option<f64>,
    #[serde(default = "yes")]
    valid: bool,
    why: Option<Absence>,
}

impl TryFrom<FrameData> for FrameLine {
    type Error = String;

    fn try_from(line: FrameData) -> Result<Self, String> {
        let FrameData { t: time, hand, wrist, angles, confidence, iou, valid, why } = line;
        // A hand that was lost may be nowhere.
        let wrist = wrist.or_else(|| (!valid).then(WristData::default)).ok_or("missing field `wrist`")?;
        let pose = HandPose::try_from(PoseData { hand, wrist, angles })?;
        Ok(Self(TimedPose { time, pose, confidence, iou, valid, why }))
    }
}

fn yes() -> bool {
    true
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

    /// Everything that is left.
    ///
    /// # Errors
    /// See [`PosesError`].
    pub fn into_clip(self) -> Result<PoseClip, PosesError> {
        self.into_clip_within(&Limits::default())
    }

    /// As [`PoseReader::into_clip`], within other limits.
    ///
    /// # Errors
    /// See [`PosesError`].
    pub fn into_clip_within(self, limits: &Limits) -> Result<PoseClip, PosesError> {
        let Self { lines, header, check, .. } = self;
        let mut clip = ClipReader { header, check, number: lines.number(), frames: Vec::new(), limits };
        let mut blocks = BlockReader::behind(lines);
        let (mut block, mut next, mut parsed) = (Vec::new(), Vec::new(), Vec::new());
        let mut read = blocks.fill(&mut block, BLOCK_BYTES);
        loop {
            // The next lines are read, and poses taken in, while these are looked at; behind lines that cannot be read no more are.
            let mut taken = Ok(());
            let mut behind = Ok(false);
            let before = std::mem::take(&mut parsed);
            beside(
                block.len() > PIECE_BYTES,
                || {
                    taken = clip.take(before);
                    if matches!(read, Ok(true)) {
                        behind = blocks.fill(&mut next, BLOCK_BYTES);
                    }
                },
                || parsed = parse_block(&block),
            );
            taken?;
            if let Ok(true) = read {
                read = behind;
                std::mem::swap(&mut block, &mut next);
                continue;
            }
            clip.take(parsed)?;
            read.map_err(|error| PosesError::Line {
                line: clip.number + 1,
                what: error.describe(MAX_LINE_BYTES),
            })?;
            return Ok(PoseClip { header: clip.header, frames: clip.frames });
        }
    }

    fn next_frame(&mut self) -> Result<Option<TimedPose>, String> {
        let max = self.lines.max_bytes();
        loop {
            let Some(text) = self.lines.next_line().map_err(|e| e.describe(max))? else {
                return Ok(None);
            };
            let line = parse_line(text)?;
            if let Some(frame) = self.accept(line)? {
                return Ok(Some(frame));
            }
        }
    }

    /// Takes in a line: a pose that may follow, or nothing for a further header.
    fn accept(&mut self, line: Line) -> Result<Option<TimedPose>, String> {
        accept(&mut self.header, &mut self.check, line)
    }
}

/// Takes in a line behind those that were `check`ed: a pose that may follow, or nothing for a further header, which is in force
/// from there on.
fn accept(header: &mut PoseHeader, check: &mut FrameCheck, line: Line) -> Result<Option<TimedPose>, String> {
    match line {
        Line::Frame(frame) => {
            check.check(header, &frame).map_err(|e| e.to_string())?;
            Ok(Some(frame))
        }
        // A hand that was found later.
        Line::Header(further) => {
            if let Some(lost) = header.hands.iter().find(|hand| further.hand(hand.side).is_none()) {
                return Err(format!("a further header leaves out the {} hand", lost.side.name()));
            }
            *header = further;
            Ok(None)
        }
    }
}

/// Bytes of lines that are read at a time, and of pieces of them that a core looks at.
const BLOCK_BYTES: usize = 1 << 20;
const PIECE_BYTES: usize = 1 << 17;

/// Does both, side by side where it `pays`, `here` on this thread.
fn beside(pays: bool, here: impl FnOnce(), there: impl FnOnce() + Send) {
    if pays {
        rayon::in_place_scope(|scope| {
            scope.spawn(|_| there());
            here();
        });
    } else {
        here();
        there();
    }
}

/// What is in the lines of a piece.
struct Piece {
    /// How many lines it has, and what those say that are not blank, by their number in it, up to the first that is wrong.
    count: usize,
    lines: Vec<(usize, Line)>,
    /// That one.
    wrong: Option<(usize, String)>,
}

impl Piece {
    fn parsed(text: &[u8]) -> Self {
        let mut piece = Self { count: 0, lines: Vec::new(), wrong: None };
        for line in pieces(text, 0) {
            piece.count += 1;
            let text = line_text(line, MAX_LINE_BYTES).map_err(|e| e.describe(MAX_LINE_BYTES));
            match text.and_then(|text| text.map(parse_line).transpose()) {
                Ok(Some(line)) => piece.lines.push((piece.count, line)),
                Ok(None) => {}
                Err(what) => {
                    piece.wrong = Some((piece.count, what));
                    break;
                }
            }
        }
        piece
    }
}

/// What is in the pieces of a block, looked at on several cores.
fn parse_block(block: &[u8]) -> Vec<Piece> {
    let pieces: Vec<&[u8]> = pieces(block, PIECE_BYTES).collect();
    pieces.into_par_iter().map(Piece::parsed).collect()
}

/// The poses of a whole file on their way into a clip.
struct ClipReader<'a> {
    header: PoseHeader,
    check: FrameCheck,
    /// Number of the line before those that are to come.
    number: usize,
    frames: Vec<TimedPose>,
    limits: &'a Limits,
}

impl ClipReader<'_> {
    /// Takes in the pieces that come next.
    fn take(&mut self, pieces: Vec<Piece>) -> Result<(), PosesError> {
        for Piece { count, lines, wrong } in pieces {
            for (number, line) in lines {
                let failed = |what| PosesError::Line { line: self.number + number, what };
                let accepted = accept(&mut self.header, &mut self.check, line);
                let Some(frame) = accepted.map_err(failed)? else { continue };
                let instants = (self.frames.len() + 1) / self.header.hands.len().max(1);
                self.limits.check_count(Limit::Instants, instants)?;
                self.frames.push(frame);
            }
            if let Some((number, what)) = wrong {
                return Err(PosesError::Line { line: self.number + number, what });
            }
            self.number += count;
        }
        Ok(())
    }
}

/// What a line says.
#[expect(clippy::large_enum_variant, reason = "nearly all are frames")]
enum Line {
    Frame(TimedPose),
    Header(PoseHeader),
}

fn parse_line(text: &str) -> Result<Line, String> {
    if text.starts_with(HEADER_START) {
        return parse_header(text).map(Line::Header);
    }
    let FrameLine(frame) = serde_json::from_str(text).map_err(|e| json_message(&e))?;
    Ok(Line::Frame(frame))
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

/// How a header line begins.
const HEADER_START: &str = "{\"format\":";

fn parse_header(text: &str) -> Result<PoseHeader, String> {
    let tag: Tag = serde_json::from_str(text).map_err(|e| json_message(&e))?;
    tag.check()?;
    let line: HeaderLine = serde_json::from_str(text).map_err(|e| json_message(&e))?;
    line.header().map_err(|e| e.to_string())
}

/// serde_json's message without its own line number, which is always 1 here.
pub(crate) fn json_message(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let what = match text.rfind(" at line ") {
        Some(at) => format!("{}, column {}", &text[..at], error.column()),
        None => text,
    };
    match what.strip_prefix("expected value") {
        _ if error.is_data() => what,
        Some(at) => format!(
            "not JSON: expected value (NaN and Infinity are none, null stands for what is missing){at}"
        ),
        None => format!("not JSON: {what}"),
    }
}

/// Writes a pose file frame by frame.
pub struct PoseWriter<W: Write> {
    writer: W,
    header: PoseHeader,
    check: FrameCheck,
    frames: usize,
    /// The line being made.
    line: Vec<u8>,
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

fn write_header(writer: &mut impl Write, header: &PoseHeader) -> Result<(), PosesError> {
    header.check().map_err(|e| PosesError::Line { line: 1, what: e.to_string() })?;
    let line = HeaderLine {
        format: NAME.into(),
        version: VERSION,
        rate: header.rate,
        hands: header.hands.clone(),
        made_by: header.made_by.clone(),
        skin_tone: header.skin_tone,
    };
    write_line(writer, &line)
}

impl<W: Write> PoseWriter<W> {
    /// Writes the header.
    ///
    /// # Errors
    /// [`PosesError::Line`] for a header a reader would refuse, [`PosesError::Io`].
    pub fn new(mut writer: W, header: PoseHeader) -> Result<Self, PosesError> {
        write_header(&mut writer, &header)?;
        Ok(Self { writer, header, check: FrameCheck::default(), frames: 0, line: Vec::new() })
    }

    /// Writes one pose. Angles are rounded to 1e-5 degree, translations to 0.1 micrometre, quaternion
    /// components to 1e-8 and times to a microsecond: far below what a stream carries.
    ///
    /// # Errors
    /// [`PosesError::Frame`] for a pose a reader would refuse, [`PosesError::Io`].
    pub fn write(&mut self, frame: &TimedPose) -> Result<(), PosesError> {
        self.accept(frame)?;
        self.line.clear();
        push_frame(&mut self.line, frame);
        self.line.push(b'\n');
        Ok(self.writer.write_all(&self.line)?)
    }

    /// Checks that a pose may follow.
    fn accept(&mut self, frame: &TimedPose) -> Result<(), PosesError> {
        let time = (frame.time * 1e6).round() / 1e6;
        let checked = self.check.check_at(time, &self.header, frame);
        checked.map_err(|e| PosesError::Frame { frame: self.frames, what: e.to_string() })?;
        self.frames += 1;
        Ok(())
    }

    /// The header in force.
    pub fn header(&self) -> &PoseHeader {
        &self.header
    }

    /// Writes the header anew, because a further hand was found; poses of it may follow.
    ///
    /// # Errors
    /// As [`PoseWriter::new`].
    pub fn announce(&mut self, header: PoseHeader) -> Result<(), PosesError> {
        write_header(&mut self.writer, &header)?;
        self.header = header;
        Ok(())
    }

    /// Passes on what has been written.
    ///
    /// # Errors
    /// [`PosesError::Io`].
    pub fn flush(&mut self) -> Result<(), PosesError> {
        Ok(self.writer.flush()?)
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

/// Checks the poses of a clip as a reader does, with times to the microsecond.
///
/// # Errors
/// [`PosesError::Frame`].
pub(super) fn check_frames(clip: &PoseClip) -> Result<(), PosesError> {
    let mut writer = PoseWriter::new(io::sink(), clip.header.clone())?;
    clip.frames.iter().try_for_each(|frame| writer.accept(frame))
}

/// The words of a pose, as [`FrameLine`] reads them: times to the microsecond, numbers as [`HandPose`] rounds them.
pub(super) fn push_frame(out: &mut Vec<u8>, frame: &TimedPose) {
    let pose = &frame.pose;
    out.extend_from_slice(b"{\"t\":");
    push_number(out, frame.time, 6);
    out.extend_from_slice(b",\"hand\":\"");
    out.extend_from_slice(pose.side.name().as_bytes());
    out.extend_from_slice(b"\",\"wrist\":{\"translation\":");
    push_list(out, pose.translation.as_slice(), 7);
    out.extend_from_slice(b",\"rotation\":");
    push_list(out, pose.rotation.coords.as_slice(), 8);
    out.extend_from_slice(b"},\"angles\":{");
    let mut before: &[u8] = b"\"";
    for (angle, value) in JointAngle::ALL.into_iter().zip(pose.angles) {
        let degrees = value.to_degrees();
        // What is rounded to 0 is left out.
        if degrees.abs() * 1e5 >= 0.5 {
            out.extend_from_slice(before);
            out.extend_from_slice(angle.name().as_bytes());
            out.extend_from_slice(b"\":");
            push_number(out, degrees, 5);
            before = b",\"";
        }
    }
    out.push(b'}');
    for (name, share) in [("confidence", frame.confidence), ("iou", frame.iou)] {
        if let Some(share) = share {
            // As short as it can be said; a share is finite.
            out.extend_from_slice(format!(",\"{name}\":{share:?}").as_bytes());
        }
    }
    if !frame.valid {
        out.extend_from_slice(b",\"valid\":false");
    }
    if let Some(why) = frame.why {
        let why = match why {
            Absence::Lost => "lost",
            Absence::Touching => "touching",
            Absence::NotYet => "not-yet",
            Absence::Bridged => "bridged",
        };
        out.extend_from_slice(format!(",\"why\":\"{why}\"").as_bytes());
    }
    out.push(b'}');
}

fn push_list(out: &mut Vec<u8>, values: &[f64], digits: u32) {
    let mut before = b'[';
    for &value in values {
        out.push(before);
        push_number(out, value, digits);
        before = b',';
    }
    out.push(b']');
}

fn write_line(writer: &mut impl Write, value: &impl Serialize) -> Result<(), PosesError> {
    serde_json::to_writer(&mut *writer, value).map_err(io::Error::from)?;
    writer.write_all(b"\n")?;
    Ok(())
}

/// Reads a whole file.
///
/// # Errors
/// See [`PosesError`].
pub fn read_poses(path: &Path) -> Result<PoseClip, PosesError> {
    PoseReader::open(path)?.into_clip()
}

/// Writes a whole file, which appears once it is complete.
///
/// # Errors
/// See [`PosesError`].
pub fn write_poses(path: &Path, clip: &PoseClip) -> Result<(), PosesError> {
    Ok(write_all(PoseWriter::create(path, clip.header.clone())?, clip)?.commit()?)
}

/// The lines of a whole file.
///
/// # Errors
/// See [`PosesError`].
pub fn write_lines(clip: &PoseClip) -> Result<Vec<u8>, PosesError> {
    write_all(PoseWriter::new(Vec::new(), clip.header.clone())?, clip)
}

fn write_all<W: Write>(mut writer: PoseWriter<W>, clip: &PoseClip) -> Result<W, PosesError> {
    clip.frames.iter().try_for_each(|frame| writer.accept(frame))?;
    write_each(&clip.frames, &mut writer.writer, |out, _, frame| {
        push_frame(out, frame);
        out.push(b'\n');
    })?;
    writer.finish()
}

/// Copies pose lines, as [`PoseWriter`] wrote them, behind a header that is known only at their end, in place of those
/// they have. `before` gives what instants have of a hand before its first line; of two hands the lines of an instant
/// lie together.
///
/// # Errors
/// [`PosesError::Line`], [`PosesError::Io`].
pub fn copy_lines<W: Write>(
    lines: impl BufRead,
    header: &PoseHeader,
    out: W,
    before: impl Fn(Side, f64) -> Option<TimedPose>,
) -> Result<W, PosesError> {
    /// What is looked at of a line; a header has neither.
    #[derive(Deserialize)]
    struct Place {
        t: Option<f64>,
        hand: Option<Side>,
    }
    let mut reader = LineReader::new(lines, MAX_LINE_BYTES);
    let mut writer = PoseWriter::new(out, header.clone())?;
    let mut missing: Vec<Side> = header.hands.iter().map(|hand| hand.side).collect();
    let mut instant = None;
    loop {
        let next = reader.next_line().map_err(|e| e.describe(MAX_LINE_BYTES));
        let parsed = next.and_then(|line| match line {
            Some(line) => serde_json::from_str(line).map(|at| Some((line, at))).map_err(|e| e.to_string()),
            None => Ok(None),
        });
        let (line, place) = match parsed {
            Ok(Some((line, place))) => (Some(line), place),
            Ok(None) => (None, Place { t: None, hand: None }),
            Err(what) => return Err(PosesError::Line { line: reader.number(), what }),
        };
        if line.is_some() && place.t.is_none() {
            continue;
        }
        if let Some(time) = instant.filter(|_| place.t != instant) {
            missing.iter().filter_map(|&side| before(side, time)).try_for_each(|pose| writer.write(&pose))?;
        }
        let Some(line) = line else { return writer.finish() };
        instant = place.t;
        missing.retain(|&side| Some(side) != place.hand);
        writer.writer.write_all(line.as_bytes())?;
        writer.writer.write_all(b"\n")?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::Morphology;
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    const HEADER: &str = r#"{"format":"handcast-poses","version":1,"hands":[{"side":"right"}]}"#;

    fn read(text: &str) -> Result<PoseClip, PosesError> {
        PoseReader::new(text.as_bytes()).and_then(PoseReader::into_clip)
    }

    fn refused(text: &str) -> String {
        read(text).unwrap_err().to_string()
    }

    #[test]
    fn lines_get_another_header_and_what_was_before() {
        let hand = |side| ClipHand { side, morphology: None };
        let one = PoseHeader::one(Side::Right, None, None);
        let both = PoseHeader {
            hands: vec![hand(Side::Right), hand(Side::Left)],
            skin_tone: Some(3),
            ..one.clone()
        };
        let here = |time, side| TimedPose::new(time, HandPose::neutral(side));
        let mut journal = PoseWriter::new(Vec::new(), one).unwrap();
        journal.write(&here(0.0, Side::Right)).unwrap();
        journal.write(&here(0.1, Side::Right)).unwrap();
        journal.announce(PoseHeader { skin_tone: None, ..both.clone() }).unwrap();
        for (time, side) in [(0.2, Side::Right), (0.2, Side::Left), (0.3, Side::Right)] {
            journal.write(&here(time, side)).unwrap();
        }
        let before =
            |side, time| Some(TimedPose { why: Some(Absence::NotYet), ..TimedPose::lost(time, side) });
        let copied = copy_lines(&journal.finish().unwrap()[..], &both, Vec::new(), before).unwrap();
        let missing = |time| before(Side::Left, time).unwrap();
        let frames = vec![
            here(0.0, Side::Right),
            missing(0.0),
            here(0.1, Side::Right),
            missing(0.1),
            here(0.2, Side::Right),
            here(0.2, Side::Left),
            here(0.3, Side::Right),
        ];
        let expected = write_lines(&PoseClip { header: both.clone(), frames }).unwrap();
        assert_eq!(String::from_utf8(copied), String::from_utf8(expected));
        let cut = copy_lines(format!("{}\n{{\"t\":1", pose_at(0)).as_bytes(), &both, Vec::new(), before);
        assert!(cut.unwrap_err().to_string().contains("line 2"));
    }

    /// A line of a right hand.
    fn pose_at(time: i64) -> String {
        let wrist = r#"{"translation":[0,0,0],"rotation":[0,0,0,1]}"#;
        format!("{{\"t\":{time},\"hand\":\"right\",\"wrist\":{wrist}}}")
    }

    #[test]
    fn hands_that_were_lost_need_no_wrist() {
        let clip = read(&format!("{HEADER}\n{{\"t\":0,\"hand\":\"right\",\"valid\":false}}\n")).unwrap();
        assert!(!clip.frames[0].valid);
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
                    ClipHand { side: Side::Left, morphology: Some(Morphology::default()) },
                    ClipHand { side: Side::Right, morphology: None },
                ],
                made_by: Some("a test".into()),
                skin_tone: Some(7),
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
                format!("{HEADER}\n{}\n", pose_at(0).replace("}}", "},\"angles\":{\"index1_flexion\":5}}")).into_bytes();
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
        assert!(refused(&HEADER.replace(":1,", ":2,")).contains("version is 2, allowed is 1"));
        assert!(refused(&HEADER.replace(r#"{"side":"right"}"#, "")).contains("0 hands"));
        let frame = |line: &str| refused(&format!("{HEADER}\n\n{line}\n"));
        assert!(frame("{").starts_with("poses: line 3: "));
        assert!(frame(&pose_at(0).replace("right", "left")).contains("left hand is not named in the header"));
        let bare = frame(r#"{"t":0,"hand":"right","Wrist":{}}"#);
        assert!(bare.contains("line 3: missing field `wrist`"), "{bare}");
        assert!(frame(&pose_at(0).replace("}}", "},\"iou\":1.5}")).contains("iou is 1.5, allowed 0 to 1"));
        assert!(frame(r#"{"t":0,"hand":"right","angles":{"x":1}}"#).contains("no joint angle is called"));
        let text = frame(&format!("{}\n{}", pose_at(1), pose_at(1)));
        assert!(text.starts_with("poses: line 4: t is 1 s, not after 1 s"), "{text}");
        let long = format!("{{\"t\":0,\"hand\":\"right\",\"x\":\"{}\"}}", "y".repeat(MAX_LINE_BYTES));
        assert!(frame(&long).contains("longer than the 65536 bytes allowed"));
    }

    /// Whole files are read in pieces: the same poses and errors as line by line, whichever piece they are in.
    #[test]
    fn whole_files_are_read_as_line_by_line() {
        let count = 5 * BLOCK_BYTES / 4 / 60;
        let line = |n: usize| {
            let bend = n % 90;
            let line =
                pose_at(n as i64).replace("}}", &format!("}},\"angles\":{{\"index1_flexion\":{bend}}}}}"));
            line + &"\n".repeat(if n.is_multiple_of(1000) { 8 } else { 1 })
        };
        let lines: Vec<String> = (0..count).map(line).collect();
        let both = |lines: &[String], header: &str| {
            let text = format!("{header}\n{}", lines.concat());
            let one_by_one: Result<Vec<TimedPose>, _> = PoseReader::new(text.as_bytes()).unwrap().collect();
            let whole = read(&text).map(|clip| clip.frames);
            assert_eq!(
                whole.as_ref().map_err(PosesError::to_string),
                one_by_one.as_ref().map_err(PosesError::to_string)
            );
            whole.map(|frames| frames.len()).map_err(|error| error.to_string())
        };
        assert_eq!(both(&lines, HEADER), Ok(count));
        let windows: Vec<String> = lines.iter().map(|line| line.replace('\n', "\r\n")).collect();
        assert_eq!(both(&windows, HEADER), Ok(count));
        for at in [0, 1, count / 9, count / 2, count - 2, count - 1] {
            for wrong in [
                "{\n",
                "\u{0}\n",
                &format!("{}\n{}", pose_at(-1), pose_at(-1)),
                &"y".repeat(70_000),
                &"y".repeat(3 << 20),
            ] {
                let mut lines = lines.clone();
                lines[at] = wrong.into();
                let number = 2 + lines[..at].concat().matches('\n').count();
                let told = both(&lines, HEADER).unwrap_err();
                let second = usize::from(wrong.contains("-1") && at == 0);
                assert!(told.starts_with(&format!("poses: line {}: ", number + second)), "{at}: {told}");
            }
            let mut lines = lines.clone();
            lines[at] = lines[at].trim_end().to_owned();
            lines.truncate(at + 1);
            assert_eq!(both(&lines, HEADER), Ok(at + 1));
            lines.insert(at, HEADER.replace("right", "left") + "\n");
            assert!(both(&lines, HEADER).unwrap_err().contains("a further header leaves out the right hand"));
        }
        let limits = Limits::default().with_instants(count as u64 - 1);
        let text = format!("{HEADER}\n{}", lines.concat());
        let whole = PoseReader::new(text.as_bytes()).unwrap().into_clip_within(&limits);
        assert!(matches!(whole, Err(PosesError::Excess(_))));
    }

    #[test]
    fn a_reader_stops_at_the_first_error() {
        let text = format!("{HEADER}\n{{\n{}\n", pose_at(0));
        let mut reader = PoseReader::new(text.as_bytes()).unwrap();
        assert!(reader.next().unwrap().is_err());
        assert!(reader.next().is_none());
    }
}
