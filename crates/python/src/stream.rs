//! Poses to streams and files, and back.

use std::path::PathBuf;
use std::sync::{Arc, LazyLock};

use handcast::codec::encode_bridged;
use handcast::codec::mapping::Profile;
use handcast::formats::motion::{Format, Motion, WriteOptions, at_even_times, even_rate};
use handcast::gltf::{ExportOptions, Skins};
use handcast::{DecoderOptions, PlanOptions, decode_poses};
use handcast_limits::Limits;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::arrays::bytes;
use crate::clip::Clip;
use crate::options::{check_gap, check_intra, target};
use crate::wait::apart;
use crate::{Error, notices, wrong, wrong_file};

/// The clip as an FBA stream, the bytes of `handcast encode`.
///
/// One aim at most: target_rms in degrees (0.4 by default), max_error of an angle in degrees (0.15 to 180), max_error_mm of
/// a fingertip in millimetres (0.75 to 1000), bitrate in kbit/s, quant 0 to 31. intra: seconds between I planes; resync:
/// each of them can be started at, as with live, which plans without look-ahead. sizes=False leaves out the person's sizes
/// and tone of skin. Gaps of up to max_gap seconds between two valid poses are interpolated, longer ones hold the last pose; so
/// do all with live, or 0. What load() read of a stream or BAP text is coded anew from its BAPs.
///
/// Warns (HandcastWarning) of wrists out of reach, of lost poses, which the stream interpolates or holds as if they were seen, of times that
/// are resampled, that begin late, and of aims that were missed. Raises Error for what cannot be coded. Ctrl-C ends the wait.
#[pyfunction]
#[pyo3(signature = (clip, *, target_rms=None, max_error=None, max_error_mm=None, bitrate=None, quant=None, intra=5.0,
    resync=false, live=false, sizes=true, max_gap=0.25))]
#[expect(clippy::too_many_arguments, reason = "keywords")]
pub fn encode<'py>(
    py: Python<'py>,
    clip: &Clip,
    target_rms: Option<f64>,
    max_error: Option<f64>,
    max_error_mm: Option<f64>,
    bitrate: Option<f64>,
    quant: Option<f64>,
    intra: f64,
    resync: bool,
    live: bool,
    sizes: bool,
    max_gap: f64,
) -> PyResult<Bound<'py, PyBytes>> {
    let mode = target(target_rms, max_error, max_error_mm, bitrate, quant)?;
    check_intra("intra", intra)?;
    let max_gap = if live { 0.0 } else { check_gap("max_gap", max_gap)? };
    let resync = resync || live;
    let plan = PlanOptions { mode, live, intra_seconds: intra, resync, ..PlanOptions::default() };
    let (mut poses, baps) = (Arc::clone(&clip.poses), clip.baps.clone());
    if !sizes {
        Arc::make_mut(&mut poses).header.forget_person();
    }
    let (stream, report, tips, mut said) = apart(py, move || match baps {
        Some(baps) => {
            let (stream, report) = baps.encode(&poses.header, plan).map_err(|error| wrong(&error))?;
            Ok((stream, report, None, Vec::new()))
        }
        None => {
            let said = notices::of_clip(&poses, max_gap);
            let made =
                encode_bridged(&poses, Profile::Hand, &plan, max_gap).map_err(|error| wrong(&error))?;
            Ok((made.stream, made.report, made.tips, said))
        }
    })?;
    said.extend(notices::of_report(mode, live, &report, tips));
    notices::warn(py, &said)?;
    Ok(PyBytes::new(py, &stream))
}

/// A whole FBA stream (bytes, bytearray, memoryview) as poses, of hands of the sizes that it carries.
///
/// Warns (HandcastWarning) of bytes before and behind the stream, of further streams, which become one clip, and where these
/// tell different sizes of a hand, of which the clip has the last. Raises Error where it is cut, damaged or moves no hand; with
/// conceal a hand keeps its last pose from damage on to where a decoder can start again, these poses are not valid, and what
/// was damaged is warned of.
#[pyfunction]
#[pyo3(signature = (stream, *, conceal=false))]
pub fn decode(py: Python<'_>, stream: &Bound<'_, PyAny>, conceal: bool) -> PyResult<Clip> {
    let stream = bytes("stream", stream)?;
    let options = DecoderOptions { conceal, ..DecoderOptions::default() };
    let decoded = apart(py, move || decode_poses(&stream, None, options).map_err(|error| wrong(&error)))?;
    notices::warn(py, &notices::of_damage(&decoded.damage, "pose is"))?;
    notices::warn(py, &notices::of_stream(decoded.passed_over, decoded.streams, decoded.trailing))?;
    notices::warn(py, &Vec::from_iter(notices::of_sizes(&decoded.resized, "the last ones")))?;
    Ok(decoded.clip.into())
}

/// The poses in a motion file, of all kinds that `handcast encode` reads; keys are put on even times.
///
/// Warns (HandcastWarning) of uneven times that are interpolated, and where joint positions leave open which hand it is; of a
/// stream not of what decode() warns of. Raises Error where the content is wrong, FileNotFoundError and other OSError where it
/// cannot be read.
#[pyfunction]
pub fn load(py: Python<'_>, path: PathBuf) -> PyResult<Clip> {
    let (clip, said) = apart(py, move || {
        let limits = Limits::default();
        let motion = Motion::read_within(&path, &limits).map_err(|error| wrong_file(&path, &error))?;
        let mut said = motion.notes;
        if !motion.keyed {
            return Ok((Clip::with_baps(motion.clip, motion.baps), said));
        }
        said.extend(notices::of_times(&motion.clip, even_rate(&motion.clip)));
        let even = at_even_times(motion.clip, &limits).map_err(|error| wrong(&error))?;
        Ok((Clip::from(even), said))
    })?;
    notices::warn(py, &said)?;
    Ok(clip)
}

/// Surfaces and textures of the hands that were written last, for as long as the module is loaded: making them takes longer than
/// all the rest of a GLB.
static SKINS: LazyLock<Skins> = LazyLock::new(Skins::default);

/// The clip as bytes of a file: "glb", "gltf", "jsonl", "json", "csv", "bvh", "vrma", "webxr", "landmarks", "pose", "bap".
///
/// Raises Error for other formats, and for clips that a format cannot hold.
#[pyfunction]
pub fn to_format<'py>(py: Python<'py>, clip: &Clip, format: &str) -> PyResult<Bound<'py, PyBytes>> {
    let known = Format::by_id(format).filter(|found| Format::written().any(|other| other == *found));
    let found = known.ok_or_else(|| {
        let names: Vec<&str> = Format::written().map(|format| format.id).collect();
        Error::new_err(format!("format is {format:?}, allowed are {}", names.join(", ")))
    })?;
    let poses = Arc::clone(&clip.poses);
    let mut gltf = ExportOptions::default();
    gltf.skins = SKINS.clone();
    let options = WriteOptions::default().with_gltf(gltf);
    let written = apart(py, move || found.write(&poses, &options).map_err(|error| wrong(&error)))?;
    notices::warn(py, &written.notes)?;
    Ok(PyBytes::new(py, &written.bytes))
}

/// The clip as bytes of a GLB file: an animated, skinned hand for each hand.
#[pyfunction]
pub fn to_glb<'py>(py: Python<'py>, clip: &Clip) -> PyResult<Bound<'py, PyBytes>> {
    to_format(py, clip, "glb")
}

/// The clip as bytes of a .pose file (pose-format 0.2): 21 landmarks a hand as MediaPipe Holistic has them.
#[pyfunction]
pub fn to_pose_format<'py>(py: Python<'py>, clip: &Clip) -> PyResult<Bound<'py, PyBytes>> {
    to_format(py, clip, "pose")
}
