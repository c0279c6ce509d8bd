//! What is worth saying of work that was done, as the command says it.

use std::ffi::CString;

use handcast::codec::mapping::REACH;
use handcast::codec::{clip_rate, poses_keep};
use handcast::fba::FrameRate;
use handcast::{DecodedStream, PlanReport, PoseClip, Target, TimedPose};
use pyo3::prelude::*;

use crate::HandcastWarning;

/// Passes them on as warnings of the line that called.
pub fn warn(py: Python<'_>, notices: &[String]) -> PyResult<()> {
    let kind = py.get_type::<HandcastWarning>();
    notices.iter().try_for_each(|notice| PyErr::warn(py, &kind, &CString::new(notice.as_str())?, 1))
}

/// What a stream will not have of a clip as it is.
pub fn of_clip(clip: &PoseClip) -> Vec<String> {
    let mut notices = Vec::new();
    let far = |frame: &&TimedPose| frame.valid && frame.pose.translation.amax() > REACH;
    let far = clip.frames.iter().filter(far).count();
    if far > 0 {
        notices.push(format!(
            "in {far} poses the wrist is more than {REACH} m from the camera, which is as far as a stream says; it is \
             brought nearer along its line of sight"
        ));
    }
    let lost = clip.frames.iter().filter(|frame| !frame.valid).count();
    if (1..clip.frames.len()).contains(&lost) {
        notices.push(format!(
            "{lost} poses are of a lost hand: the last one seen is held, and the stream does not say so"
        ));
    }
    notices.extend(FrameRate::nearest(clip_rate(clip)).and_then(|rate| of_times(clip, rate.per_second())));
    notices
}

/// That poses are not on the ticks of a rate.
pub fn of_times(clip: &PoseClip, rate: f64) -> Option<String> {
    (!poses_keep(clip, rate)).then(|| {
        format!(
            "the poses come at uneven times or at another rate, and are interpolated at {rate:.2} frames/s"
        )
    })
}

/// Largest error in degrees up to which a bit rate counts as held without harm.
const HARMLESS: f64 = 5.0;

/// That an aim was missed.
pub fn of_report(aim: Target, report: &PlanReport) -> Option<String> {
    let (rms, worst, mean) = (report.rms_degrees, report.max_degrees, report.kbit_per_s());
    match aim {
        Target::Rms(wanted) if rms > 1.05 * wanted => {
            Some(format!("{wanted}° RMS could not be reached: it is {rms:.2}°"))
        }
        Target::Bitrate(wanted) => {
            let [least, most] = report.window_kbit_per_s.unwrap_or([mean; 2]);
            if most > 1.05 * wanted || report.windows_missed > Some(0) {
                let found = format!("{least:.2} to {most:.2} kbit/s, with errors up to {worst:.1} degrees");
                return Some(format!("{wanted} kbit/s could not be held: {found}"));
            }
            let without =
                format!("{wanted} kbit/s could not be held without errors of up to {worst:.1} degrees");
            (worst > HARMLESS).then_some(without)
        }
        _ => None,
    }
}

/// What there was besides one whole stream.
pub fn of_stream(decoded: &DecodedStream) -> Vec<String> {
    let before = decoded.passed_over.map(|bytes| {
        format!("begins in the middle of a stream: {bytes} bytes before its next I plane are passed over")
    });
    let streams = decoded.streams;
    let further = (streams > 1).then(|| format!("{streams} streams, one behind the other"));
    let trailing = decoded.trailing;
    let behind =
        (trailing > 0).then(|| format!("{trailing} bytes behind the end code are no stream and left out"));
    [before, further, behind].into_iter().flatten().collect()
}
