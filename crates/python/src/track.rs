//! Pictures to poses.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use handcast::{
    ClipOptions, ClipSink, Frame, OpenOptions, PoseClip, TimedPose, TrackedFrame, open, track_clip,
};
use image::RgbImage;
use numpy::PyReadonlyArray3;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::clip::{Clip, Pose};
use crate::options::{TrackWords, rate as checked_rate};
use crate::{Error, missing_file, notices, wrong, wrong_file};

/// Lets Python's signals end the work: Ctrl-C.
struct Signals {
    raised: Option<PyErr>,
}

impl Signals {
    fn look(&mut self) -> Result<(), String> {
        Python::attach(|py| py.check_signals()).map_err(|error| {
            let text = error.to_string();
            self.raised = Some(error);
            text
        })
    }
}

impl ClipSink for Signals {
    // Where there is no hand, frames are read alone.
    fn read(&mut self, _: usize) -> Result<(), String> {
        self.look()
    }

    fn tracked(&mut self, _: TrackedFrame<'_>) -> Result<(), String> {
        self.look()
    }
}

/// The poses of the hands in a clip, and what is worth saying of its pictures.
fn of_file(path: &Path, rate: Option<f64>, options: &ClipOptions) -> PyResult<(PoseClip, Vec<String>)> {
    if path.as_os_str() == "-" {
        return Err(Error::new_err("-: standard input is Python's; push its frames into a Tracker"));
    }
    let mut opening = OpenOptions::default();
    if let Some(rate) = rate {
        opening = opening.with_rate(rate);
    }
    let source = open(path, &opening).map_err(|error| match error {
        handcast::media::FrameError::NotFound { .. } => missing_file(path),
        other => wrong_file(path, &other),
    })?;
    let mut told = source.info().notices();
    let mut signals = Signals { raised: None };
    let tracked = track_clip(source, None, options, &mut signals);
    let clip = tracked.map_err(|error| signals.raised.take().unwrap_or_else(|| wrong_file(path, &error)))?;
    told.extend(clip.shortfall.clone());
    Ok((PoseClip { header: clip.header(), frames: clip.poses() }, told))
}

/// A picture of an array H×W×3 of bytes, RGB.
fn picture(array: &Bound<'_, PyAny>) -> PyResult<RgbImage> {
    let shape = || "a frame is an array of height x width x 3 bytes (uint8), RGB".to_owned();
    let array: PyReadonlyArray3<'_, u8> = array.extract().map_err(|_| Error::new_err(shape()))?;
    let array = array.as_array();
    let (height, width, channels) = array.dim();
    let allowed = 1..=handcast::media::MAX_SIDE as usize;
    if channels != 3 || !allowed.contains(&height) || !allowed.contains(&width) {
        return Err(Error::new_err(format!("{}; this one is {height} x {width} x {channels}", shape())));
    }
    let bytes = array.iter().copied().collect();
    RgbImage::from_raw(width as u32, height as u32, bytes).ok_or_else(|| Error::new_err(shape()))
}

/// The poses of the hands in a clip, a file or frames.
#[pyfunction]
#[pyo3(signature = (source, fps, words))]
pub fn track(
    py: Python<'_>,
    source: &Bound<'_, PyAny>,
    fps: Option<f64>,
    words: &Bound<'_, PyDict>,
) -> PyResult<Clip> {
    let options = TrackWords::of(words)?.options(py)?;
    let rate = fps.map(|fps| checked_rate("fps", fps)).transpose()?;
    if let Ok(path) = source.extract::<PathBuf>() {
        let (clip, told) = py.detach(|| of_file(&path, rate, &options))?;
        notices::warn(py, &told)?;
        return Ok(clip.into());
    }
    let rate = rate.unwrap_or(30.0);
    let mut tracker = handcast::Tracker::new(options);
    let mut frames: Vec<TimedPose> = Vec::new();
    for (index, array) in source.try_iter()?.enumerate() {
        let frame = Frame { index, time: index as f64 / rate, image: picture(&array?)? };
        frames.extend(py.detach(|| tracker.push(frame)).map_err(|error| wrong(&error))?);
        py.check_signals()?;
    }
    frames.extend(py.detach(|| tracker.finish()).map_err(|error| wrong(&error))?);
    Ok(PoseClip { header: tracker.header(Some(rate)), frames }.into())
}

/// Frames in, poses out.
#[pyclass(frozen, module = "handcast")]
pub struct Tracker {
    state: Mutex<State>,
}

struct State {
    tracker: handcast::Tracker,
    rate: f64,
    next: usize,
    /// No frame came with a time of its own.
    even: bool,
}

impl Tracker {
    /// Works on the state without Python's lock; another thread waits for its turn.
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut State) -> T + Send) -> T {
        py.detach(|| work(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

impl State {
    fn told(&self, poses: Vec<TimedPose>) -> Vec<Pose> {
        let header = self.tracker.header(None);
        let sizes = |pose: &TimedPose| header.hand(pose.pose.side).and_then(|hand| hand.morphology.clone());
        poses.into_iter().map(|pose| Pose::new(pose.clone(), sizes(&pose))).collect()
    }
}

#[pymethods]
impl Tracker {
    #[new]
    #[pyo3(signature = (fps, words))]
    fn new(py: Python<'_>, fps: f64, words: &Bound<'_, PyDict>) -> PyResult<Self> {
        let options = TrackWords::of(words)?.options(py)?;
        let state = State {
            tracker: handcast::Tracker::new(options),
            rate: checked_rate("fps", fps)?,
            next: 0,
            even: true,
        };
        Ok(Self { state: Mutex::new(state) })
    }

    #[pyo3(signature = (frame, time=None))]
    fn push(&self, py: Python<'_>, frame: &Bound<'_, PyAny>, time: Option<f64>) -> PyResult<Vec<Pose>> {
        let image = picture(frame)?;
        self.with(py, |state| {
            state.even &= time.is_none();
            let time = time.unwrap_or(state.next as f64 / state.rate);
            let poses = state
                .tracker
                .push(Frame { index: state.next, time, image })
                .map_err(|error| wrong(&error))?;
            state.next += 1;
            Ok(state.told(poses))
        })
    }

    fn finish(&self, py: Python<'_>) -> PyResult<Vec<Pose>> {
        self.with(py, |state| {
            let poses = state.tracker.finish().map_err(|error| wrong(&error))?;
            Ok(state.told(poses))
        })
    }

    #[getter]
    fn skin_tone(&self, py: Python<'_>) -> Option<u8> {
        self.with(py, |state| state.tracker.header(None).skin_tone)
    }

    fn clip(&self, py: Python<'_>, poses: Vec<PyRef<'_, Pose>>) -> PyResult<Clip> {
        let frames = poses.iter().map(|pose| pose.timed().clone()).collect();
        let header = self.with(py, |state| state.tracker.header(state.even.then_some(state.rate)));
        let clip = PoseClip { header, frames };
        clip.check().map_err(|error| wrong(&error))?;
        Ok(clip.into())
    }
}
