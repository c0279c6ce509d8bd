//! Joint angles as a table of comma-separated values (RFC 4180), a row for each hand and instant.
//!
//! ```text
//! time,hand,x,y,z,qx,qy,qz,qw,pinky0_flexion,pinky1_flexion,…
//! 0.033333,right,0.010000,-0.200000,-0.500000,0.0000000,0.0000000,0.0000000,1.0000000,3.2000,41.0500,…
//! ```
//!
//! The first line names the columns. Time is in seconds; x to qw are the wrist's position (m) and rotation in the
//! camera frame of the poses; angles are degrees by name. Written are all 29 angles of valid poses, and behind them a
//! column `confidence` where a pose has one. Where the times do not tell the motion's rate, a last column `rate` has it,
//! the same in all rows, frames per second.
//!
//! Tables of other programs are read, too: columns in any order and case, with others between them; cells apart by
//! semicolons or tabs, with decimal commas; lines before the first one that begin with `#`; UTF-16. Angles without a column
//! are 0. An empty cell of the wrist or an angle says that the hand is lost there.

use std::f64::consts::PI;
use std::io::Write;

use csv::{ReaderBuilder, StringRecord, Trim};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use thiserror::Error;

use super::{Format, Keeps, Lost, Motion, WriteError, WriteOptions, Writer};
use crate::batches::write_each;
use crate::decimal::push_fixed;
use crate::landmarks::side_named;
use crate::lines::text_of;
use handcast_codec::clip_rate;
use handcast_hand::clip::MAX_RATE;
use handcast_hand::{
    ClipHand, FrameCheck, HandPose, JointAngle, MAX_TIME, PoseClip, PoseHeader, Side, TimedPose,
};
use handcast_limits::{Limit, Limits, quoted};

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "csv",
    name: "table of angles",
    kind: "table",
    ending: ".csv",
    hands: 2,
    sniff,
    read: |bytes, limits| {
        let table = read_within(&text_of(bytes), limits)?;
        let (angles, notes) = (table.angles(), table.notes());
        Ok(Motion { angles, notes, ..Motion::of(&FORMAT, table.clip) }.into())
    },
    write: Some(Writer {
        keeps: Keeps { sizes: false, ..Keeps::all(Lost::LeftOut) },
        write: |clip, _: &WriteOptions, out| write_csv(clip, out).map(|()| Vec::new()),
    }),
};

/// The columns before the angles, all of which must be there.
const FIXED: [&str; 9] = ["time", "hand", "x", "y", "z", "qx", "qy", "qz", "qw"];
/// The column of how sure poses are, 0 to 1.
const CONFIDENCE: &str = "confidence";
/// The column of the motion's rate, frames per second, where times are uneven.
const RATE: &str = "rate";
/// Digits after the point: of times and positions, of rotations, of angles, of confidence, and of rates.
const DIGITS: [u32; 5] = [6, 7, 4, 3, 6];
/// By which share a rate is another than the times tell.
const OTHER_RATE: f64 = 1e-3;
/// How far into a file its columns are looked for, bytes.
const SNIFFED: usize = 4096;
/// What programs write where there is no number, besides nothing and `NaN`.
const NO_NUMBER: [&str; 4] = ["na", "<na>", "null", "none"];
/// Most names in a message.
const TOLD: usize = 4;
/// Numbers of which one at least must be so large, and one angle move so much, in so many poses, for all to look like radians.
const RADIANS: f64 = 0.3;
const ENOUGH_POSES: usize = 10;

/// What is wrong with a table.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TableError {
    /// The first line does not name the columns.
    #[error("table: the first line must name the columns: {what}")]
    Header {
        /// What is wrong with it.
        what: String,
    },
    /// A row is wrong.
    #[error("table: line {line}: {what}")]
    Row {
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// There is no row.
    #[error("table: no row below the names of the columns")]
    Empty,
}

/// Whether the first line names at least when a pose is and of which hand.
fn sniff(bytes: &[u8]) -> bool {
    let text = text_of(&bytes[..bytes.len().min(SNIFFED)]);
    let line = heading(&text).1;
    let mut cells = line.split(char::from(separator(line))).map(|cell| cell.trim().trim_matches('"').trim());
    let [time, hand, ..] = FIXED;
    cells.clone().any(|cell| cell.eq_ignore_ascii_case(time))
        && cells.any(|cell| cell.eq_ignore_ascii_case(hand))
}

/// The line with the names of the columns, behind blank lines and notes, and the byte it begins at.
fn heading(text: &str) -> (usize, &str) {
    let note = |line: &&str| line.trim().is_empty() || line.starts_with('#');
    let begins = text.split_inclusive('\n').take_while(note).map(str::len).sum();
    let rest = &text[begins..];
    (begins, rest.find(['\r', '\n']).map_or(rest, |end| &rest[..end]))
}

/// What stands between the cells: that of which there is most between the names.
fn separator(line: &str) -> u8 {
    let count = |separator: &u8| line.bytes().filter(|byte| byte == separator).count();
    // The last of equals is taken.
    b"\t;,".iter().copied().max_by_key(count).unwrap_or(b',')
}

/// Reads a table.
///
/// # Errors
/// See [`TableError`].
pub fn read_csv(text: &str) -> Result<PoseClip, TableError> {
    read_within(text, &Limits::default()).map(|table| table.clip)
}

fn read_within(text: &str, limits: &Limits) -> Result<Table, TableError> {
    let text = text.trim_start_matches('\u{feff}');
    let (begins, line) = heading(text);
    let separator = separator(line);
    // Rows of another length are told from each other here, with how long they should be.
    let mut builder = ReaderBuilder::new();
    builder.flexible(true).trim(Trim::All).delimiter(separator);
    let mut reader = builder.from_reader(&text.as_bytes()[begins..]);
    let names = reader.headers().map_err(|e| TableError::Header { what: e.to_string() })?;
    let mut table = Table::new(names, separator != b',')?;
    let (mut cells, mut check) = (StringRecord::new(), FrameCheck::default());
    loop {
        let at = begins as u64 + reader.position().byte();
        let wrong = |what: String| TableError::Row { line: line_at(text, at), what };
        if !reader.read_record(&mut cells).map_err(|e| wrong(e.to_string()))? {
            break;
        }
        if cells.iter().all(str::is_empty) {
            continue;
        }
        let row = table.row(&cells).map_err(wrong)?;
        let clip = &mut table.clip;
        clip.header.rate = clip.header.rate.or(row.rate);
        let instants = (clip.frames.len() + 1) / clip.header.hands.len().max(1);
        limits.check_count(Limit::Instants, instants).map_err(|excess| wrong(excess.to_string()))?;
        let side = row.frame.pose.side;
        if clip.header.hand(side).is_none() {
            clip.header.hands.push(ClipHand { side, morphology: None });
        }
        check.check(&clip.header, &row.frame).map_err(|e| wrong(e.to_string()))?;
        if row.empty != 0 {
            table.empty.push((clip.frames.len(), at, row.empty));
        }
        clip.frames.push(row.frame);
    }
    if table.clip.frames.is_empty() { Err(TableError::Empty) } else { Ok(table.finished(text)) }
}

/// The number, from 1, of the first line with anything in it from this byte on.
fn line_at(text: &str, byte: u64) -> usize {
    let (before, after) = text.as_bytes().split_at(text.len().min(byte as usize));
    let blank = after.len() - after.trim_ascii_start().len();
    let lines = |bytes: &[u8]| bytes.iter().filter(|b| **b == b'\n').count();
    1 + lines(before) + lines(&after[..blank])
}

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Column {
    Time,
    Hand,
    /// A number of the wrist: those of its place, then of its rotation.
    Wrist(usize),
    Angle(JointAngle),
    Confidence,
    Rate,
    PassedOver,
}

/// How many numbers the wrist has.
const WRIST: usize = FIXED.len() - 2;
/// The bits of those of its rotation.
const ROTATION: u64 = 0b111_1000;

impl Column {
    /// The column of a name in lower case.
    fn named(name: &str) -> Self {
        match FIXED.iter().position(|fixed| *fixed == name) {
            Some(0) => Self::Time,
            Some(1) => Self::Hand,
            Some(i) => Self::Wrist(i - 2),
            None if name == CONFIDENCE => Self::Confidence,
            None if name == RATE => Self::Rate,
            None => JointAngle::from_name(name).map_or(Self::PassedOver, Self::Angle),
        }
    }

    /// The bit of a column without whose number there is no pose, 0 of others.
    fn bit(self) -> u64 {
        match self {
            Self::Wrist(i) => 1 << i,
            Self::Angle(angle) => 1 << (WRIST + angle as usize),
            _ => 0,
        }
    }
}

/// What a row says.
struct Row {
    frame: TimedPose,
    /// The motion's rate, where it tells that.
    rate: Option<f64>,
    /// The bits of the columns in which it has no number.
    empty: u64,
}

/// A table as it is read.
struct Table {
    columns: Vec<Column>,
    /// Whether numbers may have commas.
    decimal_commas: bool,
    passed_over: Vec<String>,
    clip: PoseClip,
    /// The poses whose rows have empty cells: number, byte, bits of the columns.
    empty: Vec<(usize, u64, u64)>,
    /// The bits of the columns that have a number in some row.
    filled: u64,
    /// Poses that are lost, and the line of the first.
    lost: Option<(usize, usize)>,
}

impl Table {
    fn new(names: &StringRecord, decimal_commas: bool) -> Result<Self, TableError> {
        let wrong = |what: String| Err(TableError::Header { what });
        let lower: Vec<String> = names.iter().map(str::to_ascii_lowercase).collect();
        let columns: Vec<Column> = lower.iter().map(|name| Column::named(name)).collect();
        let missing: Vec<&str> =
            FIXED.into_iter().filter(|name| !lower.iter().any(|found| found == name)).collect();
        if !missing.is_empty() {
            return wrong(format!("without {}; needed are {}", several(&missing), FIXED.join(", ")));
        }
        let other = |(column, _): &(&Column, _)| **column == Column::PassedOver;
        let passed_over = columns.iter().zip(names).filter(other).map(|(_, name)| quoted(name));
        let passed_over: Vec<String> = passed_over.collect();
        if !columns.iter().any(|column| matches!(column, Column::Angle(_))) {
            let among = match passed_over.as_slice() {
                [] => String::new(),
                names => format!(" among {}", several(names)),
            };
            return wrong(format!("no joint angle{among}, such as index2_flexion"));
        }
        for (i, column) in columns.iter().enumerate() {
            if *column != Column::PassedOver && columns[..i].contains(column) {
                return wrong(format!("{} is there twice", quoted(&lower[i])));
            }
        }
        let clip = PoseClip { header: PoseHeader::default(), frames: Vec::new() };
        Ok(Self { columns, decimal_commas, passed_over, clip, empty: Vec::new(), filled: 0, lost: None })
    }

    /// The number in a cell, where there is one.
    fn number(&self, cell: &str) -> Result<Option<f64>, String> {
        let parsed = match cell.parse::<f64>() {
            Err(_) if self.decimal_commas => cell.replacen(',', ".", 1).parse::<f64>(),
            parsed => parsed,
        };
        match parsed {
            Ok(v) if v.is_nan() => Ok(None),
            Ok(v) if v.abs() <= MAX_TIME => Ok(Some(v)),
            Err(_) if cell.is_empty() || NO_NUMBER.iter().any(|none| cell.eq_ignore_ascii_case(none)) => {
                Ok(None)
            }
            _ => Err(format!("{} is not a number from -1e10 to 1e10", quoted(cell))),
        }
    }

    fn row(&mut self, cells: &StringRecord) -> Result<Row, String> {
        if cells.len() != self.columns.len() {
            return Err(format!("{} cells, expected {}", cells.len(), self.columns.len()));
        }
        let (mut wrist, mut empty) = ([0.0; WRIST], 0);
        let (mut pose, mut time) = (HandPose::neutral(Side::Left), None);
        let (mut confidence, mut rate) = (None, None);
        for (column, cell) in self.columns.iter().zip(cells) {
            let number = match column {
                Column::PassedOver => continue,
                Column::Hand => {
                    pose.side = side(cell)?;
                    continue;
                }
                _ => self.number(cell)?,
            };
            match (column, number) {
                (Column::Time, told) => time = told,
                (Column::Wrist(i), Some(value)) => wrist[*i] = value,
                (Column::Angle(angle), Some(degrees)) => pose.set(*angle, degrees.to_radians()),
                // What range it may have is for the check of any pose.
                (Column::Confidence, told) => confidence = told,
                (Column::Rate, Some(told)) if !(told > 0.0 && told <= MAX_RATE) => {
                    return Err(format!("rate is {told}, allowed above 0 to {MAX_RATE}"));
                }
                (Column::Rate, told) => rate = told,
                (column, _) => empty |= column.bit(),
            }
        }
        self.filled |= !empty;
        let [x, y, z, i, j, k, w] = wrist;
        pose.translation = Vector3::new(x, y, z);
        let rotation = Quaternion::new(w, i, j, k);
        // Without all of its numbers it is none.
        if empty & ROTATION == 0 {
            // Programs that handle tables round numbers.
            if !(0.98..=1.02).contains(&rotation.norm()) {
                return Err(format!("the rotation has norm {:.3}, allowed 0.98 to 1.02", rotation.norm()));
            }
            pose.rotation = UnitQuaternion::new_normalize(rotation);
        }
        let time = time.ok_or("it has no time")?;
        Ok(Row { frame: TimedPose { confidence, ..TimedPose::new(time, pose) }, rate, empty })
    }

    /// The table when all rows are read. An angle that has no number in any of them is as one without a column; elsewhere
    /// the hand is lost where a number is missing.
    fn finished(mut self, text: &str) -> Self {
        let needed = self.filled | ((1 << WRIST) - 1);
        let lost = std::mem::take(&mut self.empty).into_iter().filter(|(_, _, empty)| empty & needed != 0);
        for (number, at, _) in lost {
            let frame = &mut self.clip.frames[number];
            *frame = TimedPose::lost(frame.time, frame.pose.side);
            let (count, _) = self.lost.get_or_insert_with(|| (0, line_at(text, at)));
            *count += 1;
        }
        self
    }

    /// The angles it tells, or those it does not.
    fn told(&self, told: bool) -> impl Iterator<Item = JointAngle> {
        let filled = |angle: JointAngle| {
            let column = Column::Angle(angle);
            self.columns.contains(&column) && self.filled & column.bit() != 0
        };
        JointAngle::ALL.into_iter().filter(move |angle| filled(*angle) == told)
    }

    fn angles(&self) -> Vec<JointAngle> {
        self.told(true).collect()
    }

    /// What is worth saying of how it was read.
    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if !self.passed_over.is_empty() {
            notes.push(format!(
                "passed over, since poses have no such columns: {}",
                several(&self.passed_over)
            ));
        }
        let untold: Vec<&str> = self.told(false).map(JointAngle::name).collect();
        if !untold.is_empty() {
            notes.push(format!("angles that are not told, and taken for 0°: {}", several(&untold)));
        }
        if let Some((count, line)) = self.lost {
            let all = self.clip.frames.len();
            notes.push(format!(
                "{count} of {all} rows have empty cells (the first is line {line}): the hand is lost there"
            ));
        }
        if self.like_radians() {
            notes.push("all angles are within ±3.14, like radians: they are taken for degrees".into());
        }
        notes
    }

    /// Whether the angles move, and are all as small as in radians.
    fn like_radians(&self) -> bool {
        let valid = || self.clip.frames.iter().filter(|frame| frame.valid);
        let (mut least, mut most) =
            ([f64::INFINITY; JointAngle::COUNT], [f64::NEG_INFINITY; JointAngle::COUNT]);
        for frame in valid() {
            for ((angle, least), most) in frame.pose.angles.iter().zip(&mut least).zip(&mut most) {
                (*least, *most) = (least.min(*angle), most.max(*angle));
            }
        }
        let ranges = || least.iter().zip(&most).map(|(a, b)| [a.to_degrees(), b.to_degrees()]);
        let largest = ranges().flatten().map(f64::abs).fold(0.0, f64::max);
        valid().count() >= ENOUGH_POSES
            && (RADIANS..=PI).contains(&largest)
            && ranges().any(|[a, b]| b - a > RADIANS)
    }
}

fn side(cell: &str) -> Result<Side, String> {
    // Those that are written need no copy in lower case.
    let own = [Side::Left, Side::Right].into_iter().find(|side| side.name() == cell);
    own.or_else(|| side_named(cell))
        .ok_or_else(|| format!("hand is {}, allowed left and right", quoted(cell)))
}

/// The first of these names, and how many more there are.
fn several(names: &[impl AsRef<str>]) -> String {
    let told: Vec<&str> = names.iter().take(TOLD).map(AsRef::as_ref).collect();
    match names.len() - told.len() {
        0 => told.join(", "),
        more => format!("{} and {more} more", told.join(", ")),
    }
}

/// Writes a table of the valid poses.
///
/// # Errors
/// [`WriteError::Empty`], [`WriteError::Io`].
pub fn write_csv(clip: &PoseClip, mut out: impl Write) -> Result<(), WriteError> {
    if !clip.frames.iter().any(|f| f.valid) {
        return Err(WriteError::Empty);
    }
    let frames: Vec<&TimedPose> = clip.frames.iter().filter(|f| f.valid).collect();
    let sure = frames.iter().any(|frame| frame.confidence.is_some());
    let names = FIXED.into_iter().chain(JointAngle::ALL.map(JointAngle::name));
    let rate = untold_rate(clip);
    let names: Vec<&str> =
        names.chain(sure.then_some(CONFIDENCE)).chain(rate.is_some().then_some(RATE)).collect();
    writeln!(out, "{}", names.join(","))?;
    Ok(write_each(&frames, &mut out, |text, _, frame| push_row(text, frame, sure, rate))?)
}

/// The rate of a clip, where its times tell another one.
fn untold_rate(clip: &PoseClip) -> Option<f64> {
    let rate = clip.header.rate?;
    let header = PoseHeader { rate: None, ..clip.header.clone() };
    let valid = clip.frames.iter().filter(|frame| frame.valid).cloned().collect();
    let told = clip_rate(&PoseClip { header, frames: valid });
    ((told / rate - 1.0).abs() > OTHER_RATE).then_some(rate)
}

/// The row of a pose, `sure` with its confidence, and with a rate where there is one: no cell needs quotes.
fn push_row(text: &mut Vec<u8>, frame: &TimedPose, sure: bool, rate: Option<f64>) {
    let [of_places, of_rotations, of_angles, of_confidence, of_rates] = DIGITS;
    let (t, q) = (frame.pose.translation, frame.pose.rotation.coords);
    push_fixed(text, frame.time, of_places);
    text.push(b',');
    text.extend_from_slice(frame.pose.side.name().as_bytes());
    let places = t.iter().map(|v| (*v, of_places)).chain(q.iter().map(|v| (*v, of_rotations)));
    let angles = frame.pose.angles.iter().map(|angle| (angle.to_degrees(), of_angles));
    for (value, digits) in places.chain(angles) {
        text.push(b',');
        push_fixed(text, value, digits);
    }
    if sure {
        text.push(b',');
        if let Some(confidence) = frame.confidence {
            push_fixed(text, confidence, of_confidence);
        }
    }
    if let Some(rate) = rate {
        text.push(b',');
        push_fixed(text, rate, of_rates);
    }
    text.push(b'\n');
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::tests::{clip, worst};

    #[test]
    fn a_rate_that_uneven_times_do_not_tell_is_in_a_column() {
        let mut uneven = clip(&[Side::Right]);
        let table = |clip: &PoseClip| {
            let mut text = Vec::new();
            write_csv(clip, &mut text).unwrap();
            String::from_utf8(text).unwrap()
        };
        assert!(!table(&uneven).contains(RATE));
        for (i, frame) in uneven.frames.iter_mut().enumerate() {
            frame.time *= 1.4;
            frame.time += 0.3 / 25.0 * (2.3 * i as f64).sin();
        }
        let text = table(&uneven);
        assert!(text.lines().next().unwrap().ends_with(",rate"), "{text}");
        assert!(text.lines().skip(1).all(|line| line.ends_with(",25.000000")), "{text}");
        assert_eq!(read_csv(&text).unwrap().header.rate, Some(25.0));
        let refused = read_csv(&text.replace(",25.000000", ",-1")).unwrap_err().to_string();
        assert!(refused.contains("line 2: rate is -1, allowed above 0"), "{refused}");
    }

    #[test]
    fn both_hands_round_trip_within_the_digits_written() {
        let both = clip(&[Side::Left, Side::Right]);
        let mut text = Vec::new();
        write_csv(&both, &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        assert!(worst(&both, &read_csv(&text).unwrap()) < 0.51e-4f64.to_radians());
        assert_eq!(text.lines().count(), 1 + both.frames.len());
        let mut lines = text.lines().map(|l| l.split(',').collect::<Vec<_>>());
        let header = lines.next().unwrap();
        assert_eq!((header.len(), header[0], header[9]), (38, "time", "pinky0_flexion"));
        let row = lines.nth(7).unwrap();
        let column = header.iter().position(|h| *h == "index2_flexion").unwrap();
        let expected = both.frames[7].pose.angle(JointAngle::Index2Flexion).to_degrees();
        assert!((row[column].parse::<f64>().unwrap() - expected).abs() < 1e-4);
        assert!(matches!(write_csv(&PoseClip::default(), Vec::new()), Err(WriteError::Empty)));
        // As a spreadsheet may save it.
        let quoted: String = text.lines().map(|l| format!("\"{}\"\r\n", l.replace(',', "\",\""))).collect();
        assert_eq!(read_csv(&format!("\u{feff}{quoted}")), read_csv(&text));
        assert_eq!(Format::sniffed(quoted.as_bytes()), Some(&FORMAT));
    }

    #[test]
    fn confidence_has_a_column_where_a_pose_has_some() {
        let mut clip = clip(&[Side::Left]);
        for (i, frame) in clip.frames.iter_mut().enumerate() {
            frame.confidence = (i % 5 != 0).then_some(i as f64 / 32.0);
            frame.valid = i != 7;
        }
        let mut text = Vec::new();
        write_csv(&clip, &mut text).unwrap();
        let back = read_csv(&String::from_utf8(text).unwrap()).unwrap();
        let seen: Vec<_> = clip.frames.iter().filter(|frame| frame.valid).collect();
        assert_eq!(back.frames.len(), seen.len());
        for (given, read) in seen.into_iter().zip(&back.frames) {
            assert_eq!(given.confidence.is_some(), read.confidence.is_some());
            let off = given.confidence.unwrap_or(0.0) - read.confidence.unwrap_or(0.0);
            assert!(off.abs() < 0.51e-3 && (given.time - read.time).abs() < 1e-6);
        }
    }

    #[test]
    fn rows_that_are_wrong_are_named() {
        let head = "time,hand,x,y,z,qx,qy,qz,qw,index2_flexion\n";
        let clip = read_csv(&format!("{head}0,left,0,0,0,0,0,0,1,90\n\n  \n0.1, left,1,2,3,0,0,0,0.99,45\n"))
            .unwrap();
        assert_eq!(clip.frames.len(), 2);
        assert!((clip.frames[1].pose.angle(JointAngle::Index2Flexion).to_degrees() - 45.0).abs() < 1e-9);
        for (text, words) in [
            (
                String::new(),
                "first line must name the columns: without time, hand, x, y and 5 more; needed are time",
            ),
            (head.replace("qz", "qq"), "without qz; needed"),
            (head.replace("index2", "index9"), "no joint angle among \"index9_flexion\", such as"),
            (head.replace(",index2_flexion", ""), "no joint angle, such as"),
            (head.to_owned(), "no row"),
            (
                head.replace("index2_flexion", "index2_flexion,Index2_Flexion"),
                "\"index2_flexion\" is there twice",
            ),
            (format!("{head}0,left,0,0,0,0,0,0,1\n"), "line 2: 9 cells, expected 10"),
            (format!("{head}0,left,0,0,0,0,0,0,1,1\n\n\n0,left\n"), "line 5: 2 cells"),
            (format!("\n{head}\r\n0,left"), "line 4: 2 cells"),
            (format!("{head}0,both,0,0,0,0,0,0,1,1\n"), "both"),
            (format!("{head}0,left,0,0,0,0,0,0,0,1\n"), "norm 0.000, allowed 0.98 to 1.02"),
            (format!("{head}0,left,0,0,0,0,0,0,2,1\n"), "norm 2.000, allowed 0.98 to 1.02"),
            (format!("{head}0,left,0,0,0,0,0,0,1,inf\n"), "line 2: \"inf\" is not a number"),
            (format!("{head}0,left,0,0,0,0,0,0,1,one\n"), "line 2: \"one\" is not a number"),
            (format!("# a note\n{head}NaN,left,0,0,0,0,0,0,1,1\n"), "line 3: it has no time"),
            (
                head.replace("index2", "confidence,index2") + "0,left,0,0,0,0,0,0,1,1.5,1\n",
                "line 2: confidence",
            ),
            (
                format!("{head}1,left,0,0,0,0,0,0,1,1\n1,left,0,0,0,0,0,0,1,1\n"),
                "line 3: t is 1 s, not after 1 s",
            ),
        ] {
            let message = read_csv(&text).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn tables_as_other_programs_write_them_are_read() {
        let clip = clip(&[Side::Left, Side::Right]);
        let text = Format::by_id("csv").unwrap().write(&clip, &WriteOptions::default()).unwrap().bytes;
        let plain = String::from_utf8(text).unwrap();
        let expected = read_csv(&plain).unwrap();
        let row = |line: &str, cells: &dyn Fn(&mut Vec<String>)| {
            let mut list: Vec<String> = line.split(',').map(str::to_owned).collect();
            cells(&mut list);
            list.join(",")
        };
        let each = |cells: &dyn Fn(&mut Vec<String>)| -> String {
            plain.lines().map(|line| row(line, cells) + "\n").collect()
        };
        let wide = |units: &dyn Fn(u16) -> [u8; 2], text: &str| -> Vec<u8> {
            [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(units).collect()
        };
        let semicolons = plain.replace(',', ";").replace('.', ",");
        for (what, bytes) in [
            ("reversed", each(&|cells| cells.reverse()).into_bytes()),
            ("semicolons", semicolons.clone().into_bytes()),
            ("tabs", plain.replace(',', "\t").into_bytes()),
            ("notes", format!("# by hand\n\n#\n{plain}").into_bytes()),
            ("little-endian", wide(&u16::to_le_bytes, &semicolons)),
            ("big-endian", wide(&u16::to_be_bytes, &plain)),
            ("sides", plain.replace("left", "L").replace("right", "Right").into_bytes()),
            ("names", plain.replacen("time,hand,x", " Time , HAND,X", 1).into_bytes()),
        ] {
            assert_eq!(Format::sniffed(&bytes), Some(&FORMAT), "{what}");
            let motion = Motion::parse("-".as_ref(), &bytes).unwrap();
            assert_eq!((&motion.clip, motion.notes), (&expected, vec![]), "{what}");
            assert_eq!(motion.angles, JointAngle::ALL, "{what}");
        }
        let numbered = plain.lines().enumerate().map(|(i, line)| format!("{i},{line},A\n"));
        let numbered = numbered.collect::<String>().replacen("0,", ",", 1).replacen(",A", ",label", 1);
        let motion = Motion::parse("-".as_ref(), numbered.as_bytes()).unwrap();
        assert_eq!(motion.clip, expected);
        assert_eq!(motion.notes, ["passed over, since poses have no such columns: \"\", \"label\""]);
    }

    #[test]
    fn what_is_not_told_is_a_hand_lost_or_an_angle_of_0() {
        let rows = |cells: [&str; 4]| -> String {
            let row = |(i, cell): (usize, &str)| format!("{i},left,{cell}\n");
            cells.into_iter().enumerate().map(row).collect()
        };
        let head = "time,hand,x,y,z,qx,qy,qz,qw,index2_flexion,thumb1_flexion\n";
        let text = head.to_owned()
            + &rows([
                "1,2,3,0,0,0,1,40,",
                "1,2,3,0,0,0,1,NaN,NA",
                "1,2,null,0,0,0,1,40,",
                "1,2,3,,,,,40,none",
            ]);
        let motion = Motion::parse("-".as_ref(), text.as_bytes()).unwrap();
        let valid: Vec<bool> = motion.clip.frames.iter().map(|frame| frame.valid).collect();
        assert_eq!(valid, [true, false, false, false]);
        assert_eq!(motion.angles, [JointAngle::Index2Flexion]);
        assert_eq!(
            motion.notes,
            [
                "angles that are not told, and taken for 0°: pinky0_flexion, pinky1_flexion, pinky1_abduction, \
                 pinky1_twisting and 24 more",
                "3 of 4 rows have empty cells (the first is line 3): the hand is lost there",
            ]
        );
    }

    #[test]
    fn radians_are_noticed() {
        let told = |size: f64| {
            let mut clip = clip(&[Side::Right]);
            for frame in &mut clip.frames {
                frame.pose.angles.iter_mut().for_each(|angle| *angle *= size);
            }
            let text = Format::by_id("csv").unwrap().write(&clip, &WriteOptions::default()).unwrap().bytes;
            Motion::parse("-".as_ref(), &text).unwrap().notes
        };
        let radians = PI / 180.0;
        assert_eq!(told(radians), ["all angles are within ±3.14, like radians: they are taken for degrees"]);
        for size in [1.0, 0.1, 0.1 * radians, 0.0] {
            assert_eq!(told(size), [""; 0], "{size}");
        }
    }
}
