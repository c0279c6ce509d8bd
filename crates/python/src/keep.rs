//! Poses as Python keeps and copies them: a header in JSON and a table of numbers, without loss.

use std::sync::Arc;

use handcast::formats::motion::BapTrack;
use handcast::hand::ClipHand;
use handcast::hand::clip::Absence;
use handcast::{HandPose, JointAngle, PoseClip, PoseHeader, Side, TimedPose};
use nalgebra::{Quaternion, Unit, Vector3};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::clip::{Clip, Hand, Pose};
use crate::{Error, wrong};

/// Numbers of a pose before its angles.
const BEFORE: usize = 13;
const COLUMNS: usize = BEFORE + JointAngle::COUNT;
const ABSENCES: [Absence; 4] = [Absence::Lost, Absence::Touching, Absence::NotYet, Absence::Bridged];

/// What makes the object again, and of what.
pub type Kept<'py, A> = PyResult<(Bound<'py, PyAny>, A)>;
/// A header and the rows of poses.
pub type Parts<'py> = (String, Bound<'py, PyArray2<f64>>);

/// A function of this module that makes a kept object again.
pub fn maker<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("handcast._handcast")?.getattr(name)
}

/// A header and poses as they are kept.
pub fn parts<'py>(py: Python<'py>, header: &PoseHeader, poses: &[TimedPose]) -> PyResult<Parts<'py>> {
    let told = (header.rate, &header.hands, &header.made_by, header.skin_tone);
    let text = serde_json::to_string(&told).map_err(|error| wrong(&error))?;
    let rows: Vec<f64> = poses.iter().flat_map(row).collect();
    let rows = Array2::from_shape_vec((poses.len(), COLUMNS), rows).map_err(|error| wrong(&error))?;
    Ok((text, rows.into_pyarray(py)))
}

fn row(timed: &TimedPose) -> impl Iterator<Item = f64> {
    let TimedPose { time, pose, confidence, iou, valid, why } = timed;
    let why = why.and_then(|why| ABSENCES.iter().position(|other| *other == why));
    let [x, y, z] = pose.translation.into();
    let [i, j, k, w] = pose.rotation.coords.into();
    let side = f64::from(u8::from(pose.side == Side::Right));
    let head: [f64; BEFORE] = [
        *time,
        side,
        f64::from(u8::from(*valid)),
        why.map_or(-1.0, |at| at as f64),
        confidence.unwrap_or(f64::NAN),
        iou.unwrap_or(f64::NAN),
        x,
        y,
        z,
        i,
        j,
        k,
        w,
    ];
    head.into_iter().chain(pose.angles)
}

fn pose_of(row: &[f64]) -> Option<TimedPose> {
    let (&[time, side, valid, why, confidence, iou, x, y, z, i, j, k, w], angles) =
        row.split_first_chunk()?;
    let mut pose = HandPose::neutral(if side == 1.0 { Side::Right } else { Side::Left });
    pose.translation = Vector3::new(x, y, z);
    // It is of length 1 to the last digit that it was kept with.
    pose.rotation = Unit::new_unchecked(Quaternion::new(w, i, j, k));
    pose.angles = angles.try_into().ok()?;
    let mut timed = TimedPose::new(time, pose);
    timed.confidence = Some(confidence).filter(|value| !value.is_nan());
    timed.iou = Some(iou).filter(|value| !value.is_nan());
    timed.valid = valid == 1.0;
    timed.why = ABSENCES.get(why as usize).copied().filter(|_| why >= 0.0);
    Some(timed)
}

/// What [`parts`] kept.
fn clip_of(header: &str, rows: &PyReadonlyArray2<'_, f64>) -> PyResult<PoseClip> {
    type Told = (Option<f64>, Vec<ClipHand>, Option<String>, Option<u8>);
    let told: Told = serde_json::from_str(header).map_err(|error| wrong(&error))?;
    let (rate, hands, made_by, skin_tone) = told;
    let rows = rows.as_array();
    let frames: Option<Vec<TimedPose>> = rows.rows().into_iter().map(|row| pose_of(&row.to_vec())).collect();
    let frames = frames.ok_or_else(|| Error::new_err(format!("rows have {COLUMNS} numbers")))?;
    let clip = PoseClip { header: PoseHeader { rate, hands, made_by, skin_tone }, frames };
    clip.check().map_err(|error| wrong(&error))?;
    Ok(clip)
}

/// A clip that was kept.
#[pyfunction(name = "_clip")]
pub fn kept_clip(header: &str, rows: PyReadonlyArray2<'_, f64>, baps: Option<&str>) -> PyResult<Clip> {
    let baps = baps.map(BapTrack::from_text).transpose().map_err(|error| wrong(&error))?;
    Ok(Clip::with_baps(clip_of(header, &rows)?, baps))
}

/// A hand that was kept.
#[pyfunction(name = "_hand")]
pub fn kept_hand(header: &str, rows: PyReadonlyArray2<'_, f64>) -> PyResult<Hand> {
    let PoseClip { mut header, frames } = clip_of(header, &rows)?;
    let hand = header.hands.pop().ok_or_else(|| Error::new_err("no hand was kept"))?;
    Ok(Hand { side: hand.side, sizes: hand.morphology, poses: Arc::new(frames) })
}

/// A pose that was kept.
#[pyfunction(name = "_pose")]
pub fn kept_pose(header: &str, rows: PyReadonlyArray2<'_, f64>) -> PyResult<Pose> {
    let PoseClip { mut header, mut frames } = clip_of(header, &rows)?;
    let timed = frames.pop().ok_or_else(|| Error::new_err("no pose was kept"))?;
    Ok(Pose::new(timed, header.hands.pop().and_then(|hand| hand.morphology)))
}
