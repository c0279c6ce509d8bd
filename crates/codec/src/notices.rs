//! What is worth saying of what was coded, in words: the command prints it, the Python package warns of it.

use handcast_fba::plan::{PlanReport, Target};
use handcast_hand::{PoseClip, TimedPose};

use super::clip::poses_keep;
use super::mapping::{Profile, REACH};

/// Largest error in degrees up to which a bit rate counts as held without harm.
const HARMLESS: f64 = 5.0;
/// How many times as coarse as asked a motion may be before it is told, and live, where that is met on average, of motion that
/// does not leap.
const ROOM: [f64; 2] = [1.05, 1.5];

/// What a stream in this profile will not have of poses: wrists that are farther off than it says, and that a hand was lost.
pub fn of_poses(clip: &PoseClip, profile: Profile) -> Vec<String> {
    let far = |frame: &&TimedPose| frame.valid && frame.pose.translation.amax() > REACH;
    let far = if profile == Profile::Hand { clip.frames.iter().filter(far).count() } else { 0 };
    let far = (far > 0).then(|| {
        format!(
            "in {far} poses the wrist is more than {REACH} m from the camera, which is as far as a stream says; it is \
             brought nearer along its line of sight"
        )
    });
    let lost = clip.frames.iter().filter(|frame| !frame.valid).count();
    let lost = (1..clip.frames.len()).contains(&lost).then(|| {
        format!("{lost} poses are of a lost hand: the last one seen is held, and the stream does not say so")
    });
    far.into_iter().chain(lost).collect()
}

/// That poses are not on the ticks of `rate` frames a second.
pub fn of_times(clip: &PoseClip, rate: f64) -> Option<String> {
    (!poses_keep(clip, rate)).then(|| {
        format!(
            "the poses come at uneven times or at another rate, and are interpolated at {rate:.2} frames/s"
        )
    })
}

/// That what an encoder aimed at was missed.
pub fn of_report(aim: Target, live: bool, report: &PlanReport) -> Option<String> {
    let (rms, worst, mean) = (report.rms_degrees, report.max_degrees, report.kbit_per_s());
    match aim {
        Target::Rms(wanted) if rms > ROOM[usize::from(live)] * wanted => {
            Some(format!("{wanted}° RMS could not be reached: it is {rms:.2}°"))
        }
        Target::Bitrate(wanted) => {
            let [least, most] = report.window_kbit_per_s.unwrap_or([mean; 2]);
            if most > 1.05 * wanted || report.windows_missed > Some(0) {
                let found = match report.window_kbit_per_s {
                    Some(_) => format!("{least:.2} to {most:.2} kbit/s over ten seconds"),
                    None => format!("{mean:.2} kbit/s, of so short a clip"),
                };
                return Some(format!(
                    "{wanted} kbit/s could not be held: {found}, with errors up to {worst:.1} degrees"
                ));
            }
            (worst > HARMLESS).then(|| {
                format!("{wanted} kbit/s could not be held without errors of up to {worst:.1} degrees")
            })
        }
        _ => None,
    }
}

/// What there was besides one whole stream: bytes before its first I plane that were passed over, further streams, and bytes
/// behind the end.
pub fn of_stream(passed_over: Option<u64>, streams: u32, trailing: u64) -> Vec<String> {
    let before = passed_over.map(|bytes| {
        format!("begins in the middle of a stream: {bytes} bytes before its next I plane are passed over")
    });
    let further = (streams > 1).then(|| format!("{streams} streams, one behind the other"));
    let behind =
        (trailing > 0).then(|| format!("{trailing} bytes behind the end code are no stream and left out"));
    [before, further, behind].into_iter().flatten().collect()
}
