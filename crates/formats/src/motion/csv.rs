//! The table of joint angles that [`crate::export::csv`] writes.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use thiserror::Error;

use handcast_hand::clip::MAX_FRAMES;
use handcast_hand::{ClipHand, HandPose, JointAngle, PoseClip, PoseHeader, Side, TimedPose};

/// What is wrong with a table.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TableError {
    /// The first line does not name the columns.
    #[error(
        "table: the first line must name the columns time, hand, x, y, z, qx, qy, qz, qw and joint angles; {what}"
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

/// The columns before the angles.
const FIXED: [&str; 9] = ["time", "hand", "x", "y", "z", "qx", "qy", "qz", "qw"];

/// Reads a table: seconds, hand, the wrist's position (m) and rotation, and joint angles in degrees by name, in
/// any choice and order; angles without a column are 0.
///
/// # Errors
/// See [`TableError`].
pub fn read_csv(text: &str) -> Result<PoseClip, TableError> {
    let mut lines = text.lines().enumerate().map(|(i, l)| (i + 1, l)).filter(|(_, l)| !l.trim().is_empty());
    let names: Vec<&str> = lines.next().map_or_else(Vec::new, |(_, l)| l.split(',').map(str::trim).collect());
    if names.get(..FIXED.len()) != Some(&FIXED) {
        return Err(TableError::Header {
            what: format!("it begins {:?}", names.iter().take(9).collect::<Vec<_>>()),
        });
    }
    let angles = names[FIXED.len()..].iter().map(|name| {
        JointAngle::from_name(name)
            .ok_or_else(|| TableError::Header { what: format!("{name:?} is no joint angle") })
    });
    let angles: Vec<JointAngle> = angles.collect::<Result<_, _>>()?;
    let mut clip = PoseClip { header: PoseHeader::default(), frames: Vec::new() };
    for (line, text) in lines {
        let frame = row(text, &angles).map_err(|what| TableError::Row { line, what })?;
        if clip.frames.len() == MAX_FRAMES {
            return Err(TableError::Row { line, what: format!("more than the {MAX_FRAMES} poses allowed") });
        }
        let side = frame.pose.side;
        if clip.header.hand(side).is_none() {
            clip.header.hands.push(ClipHand { side, morphology: None });
        }
        clip.frames.push(frame);
    }
    if clip.frames.is_empty() { Err(TableError::Empty) } else { Ok(clip) }
}

fn row(text: &str, angles: &[JointAngle]) -> Result<TimedPose, String> {
    let cells: Vec<&str> = text.split(',').map(str::trim).collect();
    if cells.len() != FIXED.len() + angles.len() {
        return Err(format!("{} cells, expected {}", cells.len(), FIXED.len() + angles.len()));
    }
    let number = |cell: &str| match cell.parse::<f64>() {
        Ok(v) if v.is_finite() && v.abs() <= 1e9 => Ok(v),
        _ => Err(format!("{cell:?} is not a number from -1e9 to 1e9")),
    };
    let side = [Side::Left, Side::Right].into_iter().find(|s| s.name() == cells[1]);
    let mut pose =
        HandPose::neutral(side.ok_or_else(|| format!("hand is {:?}, allowed left and right", cells[1]))?);
    pose.translation = Vector3::new(number(cells[2])?, number(cells[3])?, number(cells[4])?);
    let [x, y, z, w] = [number(cells[5])?, number(cells[6])?, number(cells[7])?, number(cells[8])?];
    pose.rotation =
        UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-3).ok_or("the rotation is zero")?;
    for (&angle, cell) in angles.iter().zip(&cells[FIXED.len()..]) {
        pose.set(angle, number(cell)?.to_radians());
    }
    Ok(TimedPose::new(number(cells[0])?, pose))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_are_wrong_are_named() {
        let head = "time,hand,x,y,z,qx,qy,qz,qw,index2_flexion\n";
        let clip =
            read_csv(&format!("{head}0,left,0,0,0,0,0,0,1,90\n\n0.1,left,1,2,3,0,0,0,2,45\n")).unwrap();
        assert!((clip.frames[1].pose.angle(JointAngle::Index2Flexion).to_degrees() - 45.0).abs() < 1e-9);
        for (text, words) in [
            (String::new(), "first line"),
            (head.replace("index2", "index9"), "no joint angle"),
            (head.to_owned(), "no row"),
            (format!("{head}0,left,0,0,0,0,0,0,1\n"), "9 cells"),
            (format!("{head}0,both,0,0,0,0,0,0,1,1\n"), "both"),
            (format!("{head}0,left,0,0,0,0,0,0,0,1\n"), "zero"),
            (format!("{head}0,left,0,0,0,0,0,0,1,nan\n"), "line 2"),
        ] {
            let message = read_csv(&text).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}
