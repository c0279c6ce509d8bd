//! Poses to streams and files, and back.

use std::path::PathBuf;

use handcast::codec::mapping::Profile;
use handcast::formats::motion::{Format, Motion, WriteOptions, at_even_times};
use handcast::{PlanOptions, encode_poses};
use handcast_limits::Limits;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::clip::Clip;
use crate::options::target;
use crate::{Error, wrong};

/// The poses of a clip as a stream.
#[pyfunction]
#[pyo3(signature = (clip, *, target_rms=None, max_error=None, max_error_mm=None, bitrate=None, quant=None, intra=5.0,
    resync=false))]
#[expect(clippy::too_many_arguments, reason = "keywords")]
pub fn encode<'py>(
    py: Python<'py>,
    clip: &Clip,
    target_rms: Option<f64>,
    max_error: Option<f64>,
    max_error_mm: Option<f64>,
    bitrate: Option<f64>,
    quant: Option<u8>,
    intra: f64,
    resync: bool,
) -> PyResult<Bound<'py, PyBytes>> {
    let mode = target(target_rms, max_error, max_error_mm, bitrate, quant)?;
    let plan = PlanOptions { mode, intra_seconds: intra, resync, ..PlanOptions::default() };
    let poses = &clip.poses;
    let encoded = py.detach(|| encode_poses(poses, Profile::Hand, &plan)).map_err(|error| wrong(&error))?;
    Ok(PyBytes::new(py, &encoded.stream))
}

/// A stream as poses, with the sizes that it carries.
#[pyfunction]
pub fn decode(py: Python<'_>, stream: &[u8]) -> PyResult<Clip> {
    let decoded = py.detach(|| handcast::decode(stream)).map_err(|error| wrong(&error))?;
    Ok(decoded.clip().clone().into())
}

/// The poses in any file that holds a motion.
#[pyfunction]
pub fn load(py: Python<'_>, path: PathBuf) -> PyResult<Clip> {
    let read = || -> PyResult<_> {
        let limits = Limits::default();
        let motion = Motion::read_within(&path, &limits).map_err(|error| wrong(&error))?;
        if motion.keyed {
            return at_even_times(motion.clip, &limits).map_err(|error| wrong(&error));
        }
        Ok(motion.clip)
    };
    Ok(py.detach(read)?.into())
}

/// The poses as a file of a format.
#[pyfunction]
pub fn to_format<'py>(py: Python<'py>, clip: &Clip, format: &str) -> PyResult<Bound<'py, PyBytes>> {
    let known = Format::by_id(format).filter(|found| Format::written().any(|other| other == *found));
    let found = known.ok_or_else(|| {
        let names: Vec<&str> = Format::written().map(|format| format.id).collect();
        Error::new_err(format!("format is {format:?}, allowed are {}", names.join(", ")))
    })?;
    let poses = &clip.poses;
    let written =
        py.detach(|| found.write(poses, &WriteOptions::default())).map_err(|error| wrong(&error))?;
    Ok(PyBytes::new(py, &written.bytes))
}
