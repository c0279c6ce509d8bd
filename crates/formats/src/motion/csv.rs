//! Joint angles as a table of comma-separated values (RFC 4180), a row for each hand and instant.
//!
//! ```text
//! time,hand,x,y,z,qx,qy,qz,qw,pinky0_flexion,pinky1_flexion,…
//! 0.033333,right,0.010000,-0.200000,-0.500000,0.0000000,0.0000000,0.0000000,1.0000000,3.2000,41.0500,…
//! ```
//!
//! The first line names the columns. Time is in seconds; x to qw are the wrist's position (m) and rotation in the
//! camera frame of the poses; angles are degrees by name. Written are all 29 angles of valid poses, and behind them a
//! column `confidence` where a pose has one; read are any choice and order of them, those without a column are 0. Where the
//! times do not tell the motion's rate, a last column `rate` has it, the same in all rows, frames per second.

use std::io::Write;

use csv::{ReaderBuilder, StringRecord, Trim};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use thiserror::Error;

use super::{Format, Keeps, Lost, Motion, WriteError, WriteOptions, Writer};
use crate::batches::write_each;
use crate::decimal::push_fixed;
use handcast_codec::clip_rate;
use handcast_hand::clip::MAX_RATE;
use handcast_hand::{
    ClipHand, FrameCheck, HandPose, JointAngle, MAX_TIME, PoseClip, PoseHeader, Side, TimedPose,
};
use handcast_limits::{Limit, Limits};

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "csv",
    name: "table of angles",
    kind: "table",
    ending: ".csv",
    hands: 2,
    sniff: |bytes| [&b"time,hand,"[..], b"\"time\",\"hand\","].iter().any(|first| bytes.starts_with(first)),
    read: |bytes, limits| {
        Ok(Motion::of(&FORMAT, read_within(&String::from_utf8_lossy(bytes), limits)?).into())
    },
    write: Some(Writer {
        keeps: Keeps { sizes: false, ..Keeps::all(Lost::LeftOut) },
        write: |clip, _: &WriteOptions, out| write_csv(clip, out).map(|()| Vec::new()),
    }),
};

/// The columns before the angles.
const FIXED: [&str; 9] = ["time", "hand", "x", "y", "z", "qx", "qy", "qz", "qw"];
/// The column of how sure poses are, 0 to 1.
const CONFIDENCE: &str = "confidence";
/// The column of the motion's rate, frames per second, where times are uneven.
const RATE: &str = "rate";
/// Digits after the point: of times and positions, of rotations, of angles, of confidence, and of rates.
const DIGITS: [u32; 5] = [6, 7, 4, 3, 6];
/// By which share a rate is another than the times tell.
const OTHER_RATE: f64 = 1e-3;

/// What is wrong with a table.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TableError {
    /// The first line does not name the columns.
    #[error(
        "table: the first line must name the columns time, hand, x, y, z, qx, qy, qz, qw, then joint angles and confidence; {what}"
    )]
    Header {
        /// What it says instead.
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

/// Reads a table.
///
/// # Errors
/// See [`TableError`].
pub fn read_csv(text: &str) -> Result<PoseClip, TableError> {
    read_within(text, &Limits::default())
}

fn read_within(text: &str, limits: &Limits) -> Result<PoseClip, TableError> {
    // Rows of another length are told from each other here, with how long they should be.
    let mut reader = ReaderBuilder::new().flexible(true).trim(Trim::All).from_reader(text.as_bytes());
    let names = reader.headers().map_err(|e| TableError::Header { what: e.to_string() })?;
    let columns = columns(names)?;
    let mut clip = PoseClip { header: PoseHeader::default(), frames: Vec::new() };
    let (mut cells, mut check) = (StringRecord::new(), FrameCheck::default());
    loop {
        let begins = reader.position().byte();
        let wrong = |what: String| TableError::Row { line: line_at(text, begins), what };
        if !reader.read_record(&mut cells).map_err(|e| wrong(e.to_string()))? {
            break;
        }
        if cells.iter().all(str::is_empty) {
            continue;
        }
        let (frame, rate) = row(&cells, &columns).map_err(wrong)?;
        clip.header.rate = clip.header.rate.or(rate);
        let instants = (clip.frames.len() + 1) / clip.header.hands.len().max(1);
        limits.check_count(Limit::Instants, instants).map_err(|excess| wrong(excess.to_string()))?;
        let side = frame.pose.side;
        if clip.header.hand(side).is_none() {
            clip.header.hands.push(ClipHand { side, morphology: None });
        }
        check.check(&clip.header, &frame).map_err(|e| wrong(e.to_string()))?;
        clip.frames.push(frame);
    }
    if clip.frames.is_empty() { Err(TableError::Empty) } else { Ok(clip) }
}

/// The number, from 1, of the first line with anything in it from this byte on.
fn line_at(text: &str, byte: u64) -> usize {
    let (before, after) = text.as_bytes().split_at(text.len().min(byte as usize));
    let blank = after.len() - after.trim_ascii_start().len();
    let lines = |bytes: &[u8]| bytes.iter().filter(|b| **b == b'\n').count();
    1 + lines(before) + lines(&after[..blank])
}

/// What a column behind the fixed ones holds.
#[derive(Clone, Copy)]
enum Column {
    Angle(JointAngle),
    Confidence,
    Rate,
}

fn columns(names: &StringRecord) -> Result<Vec<Column>, TableError> {
    if !names.iter().take(FIXED.len()).eq(FIXED) {
        let found: Vec<&str> = names.iter().take(FIXED.len()).collect();
        return Err(TableError::Header { what: format!("it begins {found:?}") });
    }
    let column = |name: &str| match JointAngle::from_name(name) {
        Some(angle) => Ok(Column::Angle(angle)),
        None if name == CONFIDENCE => Ok(Column::Confidence),
        None if name == RATE => Ok(Column::Rate),
        None => Err(TableError::Header { what: format!("{name:?} is no joint angle") }),
    };
    for (i, name) in names.iter().enumerate() {
        if names.iter().take(i).any(|before| before == name) {
            return Err(TableError::Header { what: format!("{name:?} is there twice") });
        }
    }
    names.iter().skip(FIXED.len()).map(column).collect()
}

/// A pose, and the motion's rate where the row tells it.
fn row(cells: &StringRecord, columns: &[Column]) -> Result<(TimedPose, Option<f64>), String> {
    if cells.len() != FIXED.len() + columns.len() {
        return Err(format!("{} cells, expected {}", cells.len(), FIXED.len() + columns.len()));
    }
    let number = |cell: &str| match cell.parse::<f64>() {
        Ok(v) if v.is_finite() && v.abs() <= MAX_TIME => Ok(v),
        _ => Err(format!("{cell:?} is not a number from -1e10 to 1e10")),
    };
    let side = [Side::Left, Side::Right].into_iter().find(|s| s.name() == &cells[1]);
    let mut pose =
        HandPose::neutral(side.ok_or_else(|| format!("hand is {:?}, allowed left and right", &cells[1]))?);
    pose.translation = Vector3::new(number(&cells[2])?, number(&cells[3])?, number(&cells[4])?);
    let [x, y, z, w] = [number(&cells[5])?, number(&cells[6])?, number(&cells[7])?, number(&cells[8])?];
    let rotation = Quaternion::new(w, x, y, z);
    // Programs that handle tables round numbers.
    if !(0.98..=1.02).contains(&rotation.norm()) {
        return Err(format!("the rotation has norm {:.3}, allowed 0.98 to 1.02", rotation.norm()));
    }
    pose.rotation = UnitQuaternion::new_normalize(rotation);
    let (mut confidence, mut rate) = (None, None);
    for (column, cell) in columns.iter().zip(cells.iter().skip(FIXED.len())) {
        match column {
            Column::Angle(angle) => pose.set(*angle, number(cell)?.to_radians()),
            // What range it may have is for the check of any pose.
            Column::Confidence | Column::Rate if cell.is_empty() => {}
            Column::Confidence => confidence = Some(number(cell)?),
            Column::Rate => {
                let told = number(cell)?;
                if !(told > 0.0 && told <= MAX_RATE) {
                    return Err(format!("rate is {told}, allowed above 0 to {MAX_RATE}"));
                }
                rate = Some(told);
            }
        }
    }
    Ok((TimedPose { confidence, ..TimedPose::new(number(&cells[0])?, pose) }, rate))
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
            (String::new(), "first line"),
            (head.replace("index2", "index9"), "no joint angle"),
            (head.to_owned(), "no row"),
            (
                head.replace("index2_flexion", "index2_flexion,index2_flexion"),
                "\"index2_flexion\" is there twice",
            ),
            (format!("{head}0,left,0,0,0,0,0,0,1\n"), "line 2: 9 cells, expected 10"),
            (format!("{head}0,left,0,0,0,0,0,0,1,1\n\n\n0,left\n"), "line 5: 2 cells"),
            (format!("\n{head}\r\n0,left"), "line 4: 2 cells"),
            (format!("{head}0,both,0,0,0,0,0,0,1,1\n"), "both"),
            (format!("{head}0,left,0,0,0,0,0,0,0,1\n"), "norm 0.000, allowed 0.98 to 1.02"),
            (format!("{head}0,left,0,0,0,0,0,0,2,1\n"), "norm 2.000, allowed 0.98 to 1.02"),
            (format!("{head}0,left,0,0,0,0,0,0,1,nan\n"), "line 2"),
            (
                head.replace("index2_flexion", "confidence") + "0,left,0,0,0,0,0,0,1,1.5\n",
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
}
