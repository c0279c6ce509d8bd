//! What is worth saying of work that was done, as warnings.

use std::ffi::CString;

use handcast::PoseClip;
use handcast::codec::clip_rate;
use handcast::codec::mapping::Profile;
pub use handcast::codec::notices::{of_damage, of_report, of_sizes, of_stream, of_times};
use handcast::fba::FrameRate;
use pyo3::prelude::*;

use crate::HandcastWarning;

/// Passes them on as warnings of the line that called.
pub fn warn(py: Python<'_>, notices: &[String]) -> PyResult<()> {
    let kind = py.get_type::<HandcastWarning>();
    notices.iter().try_for_each(|notice| PyErr::warn(py, &kind, &CString::new(notice.as_str())?, 1))
}

/// What a stream will not have of a clip as it is, with gaps of up to so many seconds bridged.
pub fn of_clip(clip: &PoseClip, max_gap: f64) -> Vec<String> {
    let mut notices = handcast::codec::notices::of_poses(clip, Profile::Hand, max_gap);
    notices.extend(handcast::codec::notices::of_start(clip));
    notices
        .extend(FrameRate::carrying(clip_rate(clip)).and_then(|(rate, _)| of_times(clip, rate.per_second())));
    notices
}
