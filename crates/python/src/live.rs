//! Both ends of a live stream: poses to planes as they come, and planes to poses.

use std::sync::{Mutex, PoisonError};

use handcast::codec::{LivePlane, LivePoseEncoder, LivePoseEncoderOptions};
use handcast::hand::ClipHand;
use handcast::{
    DecoderOptions, Morphology, PlanOptions, PoseDecoder, PoseDecoderOptions, PoseHeader, Side, Target,
    TimedPose,
};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::arrays::bytes;
use crate::clip::{Given, Pose};
use crate::options::{check_intra, rate as checked_rate, target, whole};
use crate::threads::with_threads;
use crate::{Error, wrong};

/// Poses to the bytes of a live stream, as they come.
///
/// rate: frames per second, those of the camera. One aim at most: target_rms in degrees (0.5 by default), max_error of an angle in
/// degrees, max_error_mm of a fingertip in millimetres, bitrate in kbit/s, quant 0 to 31. intra: seconds between the planes at which
/// a reader can begin.
///
/// A hand that comes, and one that stays away for three seconds, begin another stream behind the one before. Raises Error that
/// names the argument.
#[pyclass(frozen, module = "handcast")]
pub struct LiveEncoder {
    state: Mutex<Encoding>,
}

struct Encoding {
    encoder: LivePoseEncoder,
    rate: f64,
    /// Seconds of the last instant, and of the last whose time was told.
    last: Option<f64>,
    told: Option<f64>,
}

impl Encoding {
    /// The planes of an instant. Without poses and a time it is a frame behind the one before; before any there is nothing to
    /// be coded. Times that are told must not go back behind others that were.
    fn push(
        &mut self,
        poses: &[TimedPose],
        time: Option<f64>,
        known: &PoseHeader,
    ) -> PyResult<Vec<LivePlane>> {
        let told = time.or(poses.last().map(|pose| pose.time));
        let time = match (told, self.last) {
            (None, None) => return Ok(Vec::new()),
            (None, Some(last)) => last + self.rate.recip(),
            (Some(time), _) if !time.is_finite() => {
                return Err(Error::new_err(format!("time is {time}, allowed finite seconds")));
            }
            (Some(time), last) => {
                if let Some(told) = self.told.filter(|told| time <= *told) {
                    return Err(Error::new_err(format!(
                        "time is {time} s, not after the {told} s of the push before"
                    )));
                }
                last.map_or(time, |last| time.max(last))
            }
        };
        let planes = with_threads(|| self.encoder.push(time, poses, known));
        let planes = planes.map_err(|error| Error::new_err(format!("poses at {time} s: {error}")))?;
        (self.last, self.told) = (Some(time), told.or(self.told));
        Ok(planes)
    }
}

fn joined(planes: impl IntoIterator<Item = LivePlane>) -> Vec<u8> {
    planes.into_iter().flat_map(|plane| plane.bytes).collect()
}

#[pymethods]
impl LiveEncoder {
    #[new]
    #[pyo3(signature = (*, rate=30.0, target_rms=None, max_error=None, max_error_mm=None, bitrate=None, quant=None, intra=5.0))]
    fn new(
        rate: f64,
        target_rms: Option<f64>,
        max_error: Option<f64>,
        max_error_mm: Option<f64>,
        bitrate: Option<f64>,
        quant: Option<f64>,
        intra: f64,
    ) -> PyResult<Self> {
        let rate = checked_rate("rate", rate)?;
        check_intra("intra", intra)?;
        let given = target_rms.or(max_error).or(max_error_mm).or(bitrate).or(quant);
        let aimed = target(target_rms, max_error, max_error_mm, bitrate, quant)?;
        let own = LivePoseEncoderOptions::default();
        let mode: Target = if given.is_some() { aimed } else { own.plan.mode };
        let plan = PlanOptions { mode, intra_seconds: intra, ..own.plan };
        let encoder = LivePoseEncoder::new(own.with_rate(rate).with_plan(plan));
        Ok(Self { state: Mutex::new(Encoding { encoder, rate, last: None, told: None }) })
    }

    /// The bytes (whole planes, none while nothing moves) of an instant: poses as Tracker.push gives them, or Hands of arrays,
    /// one hand or two; none where no hand is seen. Poses of several instants are in order, the last ones being of this
    /// instant. time: seconds, by default those of the last pose, or a frame after the push before. skin_tone: 1 to 10.
    #[pyo3(signature = (poses, time=None, *, skin_tone=None))]
    fn push<'py>(
        &self,
        py: Python<'py>,
        poses: &Bound<'py, PyAny>,
        time: Option<f64>,
        skin_tone: Option<f64>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let skin_tone = skin_tone.map(|tone| whole("skin_tone", tone, [1, 10])).transpose()?;
        let mut known = PoseHeader { skin_tone, ..PoseHeader::default() };
        let mut timed: Vec<TimedPose> = Vec::new();
        for (k, given) in poses.try_iter()?.enumerate() {
            let given = given?;
            let kind = given.get_type();
            let given: Given<'_> = given.extract().map_err(|_| {
                pyo3::exceptions::PyTypeError::new_err(format!("poses[{k}] is {kind}, allowed Pose and Hand"))
            })?;
            let (side, sizes) = given.person();
            if let Some(sizes) = sizes {
                known.hands.retain(|hand| hand.side != side);
                known.hands.push(ClipHand { side, morphology: Some(sizes) });
            }
            timed.extend_from_slice(given.poses());
        }
        timed.sort_by(|a, b| a.time.total_cmp(&b.time));
        let made = py.detach(|| {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            state.push(&timed, time, &known).map(joined)
        })?;
        Ok(PyBytes::new(py, &made))
    }

    /// Has the next plane be one at which a reader can begin, as soon as the rate has room for it.
    fn request_intra(&self) {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).encoder.request_intra();
    }

    /// The bytes that end the stream; none before a hand was seen. Poses may be pushed again: they begin another.
    fn finish<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let end = py.detach(|| self.state.lock().unwrap_or_else(PoisonError::into_inner).encoder.finish());
        Ok(PyBytes::new(py, &joined(end.map_err(|error| wrong(&error))?)))
    }

    /// The hands ("left", "right") that the stream carries at the moment.
    #[getter]
    fn hands(&self) -> Vec<&'static str> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.encoder.hands().iter().map(|side| side.name()).collect()
    }
}

/// The bytes of a live stream to poses, as they come in pieces of any length.
///
/// It may begin in the middle of a stream: what is before its next I plane is passed over. With conceal, damage is no error: a
/// hand keeps its last pose, not valid and with less and less confidence, up to the next I plane.
#[pyclass(frozen, module = "handcast")]
pub struct LiveDecoder {
    decoder: Mutex<PoseDecoder>,
}

impl LiveDecoder {
    /// Works on the decoder without Python's lock, and gives its poses with the sizes it knows.
    fn with(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut PoseDecoder) -> Result<Vec<TimedPose>, handcast::codec::StreamToPosesError> + Send,
    ) -> PyResult<Vec<Pose>> {
        py.detach(|| {
            let mut decoder = self.decoder.lock().unwrap_or_else(PoisonError::into_inner);
            let poses = work(&mut decoder).map_err(|error| wrong(&error))?;
            let header = decoder.header();
            let sizes = |side: Side| -> Option<Morphology> { header.hand(side)?.morphology.clone() };
            Ok(poses.into_iter().map(|pose| Pose::new(pose.clone(), sizes(pose.pose.side))).collect())
        })
    }
}

#[pymethods]
impl LiveDecoder {
    #[new]
    #[pyo3(signature = (*, conceal=true))]
    fn new(conceal: bool) -> Self {
        let options = DecoderOptions { conceal, ..DecoderOptions::default() };
        let decoder = PoseDecoder::new(PoseDecoderOptions::default().with_decoder(options));
        Self { decoder: Mutex::new(decoder) }
    }

    /// The poses (list of Pose) that are known with these bytes (bytes, bytearray, memoryview). whole: they end with a plane, as
    /// what LiveEncoder.push gives does: its poses do not wait for what follows.
    #[pyo3(signature = (data, *, whole=false))]
    fn push(&self, py: Python<'_>, data: &Bound<'_, PyAny>, whole: bool) -> PyResult<Vec<Pose>> {
        let data = bytes("data", data)?;
        self.with(py, |decoder| if whole { decoder.push_whole(&data) } else { decoder.push(&data) })
    }

    /// Says that bytes are missing here, as a transport that loses some knows; the poses (list of Pose) that were known.
    fn lose(&self, py: Python<'_>) -> PyResult<Vec<Pose>> {
        self.with(py, PoseDecoder::lose)
    }

    /// No more bytes come: the poses (list of Pose) that are left. Raises Error where there was no plane, or no hand.
    fn finish(&self, py: Python<'_>) -> PyResult<Vec<Pose>> {
        self.with(py, PoseDecoder::finish)
    }

    /// Frames per second of the stream.
    #[getter]
    fn rate(&self) -> f64 {
        self.decoder.lock().unwrap_or_else(PoisonError::into_inner).rate()
    }

    /// Tone of the skin, 1 (lightest) to 10; None where the stream has told none.
    #[getter]
    fn skin_tone(&self) -> Option<u8> {
        self.decoder.lock().unwrap_or_else(PoisonError::into_inner).header().skin_tone
    }
}
