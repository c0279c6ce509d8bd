//! What is worth saying of what was coded, in words: the command prints it, the Python package warns of it.

use handcast_fba::FrameRate;
use handcast_fba::plan::{PlanReport, Target};
use handcast_hand::{Absence, Bridged, PoseClip, Side, TimedPose};

use super::clip::{clip_rate, farthest_tick, hands_of, poses_keep, ticks_a_frame, tracks_on_ticks};
use super::damage::Damage;
use super::mapping::{Profile, REACH};
use super::tips::TipError;

/// Largest error in degrees up to which a bit rate counts as held without harm.
const HARMLESS: f64 = 5.0;
/// How many times as coarse as asked a motion may be before it is told, and live, where that is met on average.
const ROOM: [f64; 2] = [1.05, 1.1];

/// Seconds from which on poses begin late: pictures beside them would be out of step.
const LATE: f64 = 0.1;
/// Seconds from which on a time is that of a clock (since 1970, say), beside which nothing is played from its start.
pub const EARLIEST_CLOCK: f64 = 86400.0;

/// What a stream in this profile will not have of poses: wrists that are farther off than it says, and that a hand was lost, had
/// no pose or came late; with gaps of up to `max_gap` seconds bridged.
pub fn of_poses(clip: &PoseClip, profile: Profile, max_gap: f64) -> Vec<String> {
    let far = |frame: &&TimedPose| frame.valid && frame.pose.translation.amax() > REACH;
    let far = if profile == Profile::Hand { clip.frames.iter().filter(far).count() } else { 0 };
    let far = (far > 0).then(|| {
        format!(
            "in {far} poses the wrist is more than {REACH} m from the camera, which is as far as a stream says; it is \
             brought nearer along its line of sight"
        )
    });
    let absences: Vec<Absences> =
        hands_of(clip).into_iter().filter_map(|side| Absences::of(clip, side, max_gap)).collect();
    let lost = absences.iter().map(|hand| hand.lost).sum::<usize>();
    let lost = (lost > 0).then(|| {
        let poses = if lost == 1 { "1 pose is" } else { &format!("{lost} poses are") };
        format!("{poses} of a lost hand: the last one seen is held, and the stream does not say so")
    });
    let bridged = absences.iter().map(|hand| hand.bridged).sum::<usize>();
    let bridged = (bridged > 0).then(|| {
        let poses = if bridged == 1 { "1 pose in a gap is" } else { &format!("{bridged} poses in gaps are") };
        format!("{poses} interpolated between those before and behind, and the stream does not say so")
    });
    let told = absences.iter().flat_map(Absences::told);
    far.into_iter().chain(bridged).chain(lost).chain(told).collect()
}

/// Frames in which a hand stands in a stream though no pose is of it.
struct Absences {
    side: Side,
    /// Seconds from the start of the clip to its first valid pose.
    first: f64,
    /// Frames before that.
    before: usize,
    /// Poses of a lost hand since.
    lost: usize,
    /// Frames without a pose of it since.
    without: usize,
    /// Those of either kind that are interpolated, in neither of these.
    bridged: usize,
}

impl Absences {
    /// Those of a hand; none where it has no valid pose, and is left out.
    fn of(clip: &PoseClip, side: Side, max_gap: f64) -> Option<Self> {
        let rate = clip_rate(clip);
        let times = || clip.frames.iter().map(|frame| frame.time);
        let start = times().fold(f64::INFINITY, f64::min);
        let end = times().fold(f64::NEG_INFINITY, f64::max);
        let seen = clip.of(side).find(|frame| frame.valid)?.time;
        let since = || clip.of(side).filter(|frame| frame.time >= seen);
        // Between uneven times poses are interpolated, of which `of_times` tells.
        let gaps = poses_keep(clip, rate);
        let (mut without, mut before) = (0, seen);
        for frame in since() {
            let frames = ((frame.time - before) * rate).round() as usize;
            without += if gaps { frames.saturating_sub(1) } else { 0 };
            before = frame.time;
        }
        without += ((end - before) * rate).round() as usize;
        let lost = since().filter(|frame| !frame.valid).count();
        let before = ((seen - start) * rate).round() as usize;
        let all = Self { side, first: seen - start, before, lost, without, bridged: 0 };
        if lost + without == 0 {
            return Some(all);
        }
        let track = match gaps {
            true => {
                let [left, right] = tracks_on_ticks(clip, rate, max_gap);
                if side == Side::Left { left } else { right }
            }
            // Nothing is missing between times that have no beat.
            false => Bridged::new(Box::new(clip.of(side).cloned()) as Box<_>, f64::INFINITY, max_gap),
        };
        Some(all.without_bridged(track))
    }

    /// The same, when those that are not valid in a track of it are looked at.
    fn without_bridged(self, track: impl Iterator<Item = TimedPose>) -> Self {
        let [mut bridged, mut lost] = [0, 0];
        for frame in track.skip_while(|frame| !frame.valid).filter(|frame| !frame.valid) {
            *if frame.why == Some(Absence::Bridged) { &mut bridged } else { &mut lost } += 1;
        }
        let lost_no_more = self.lost.saturating_sub(lost);
        let without = self.without.saturating_sub(bridged.saturating_sub(lost_no_more));
        Self { lost, without, bridged, ..self }
    }

    fn told(&self) -> Vec<String> {
        let Self { side, first, before, without, .. } = self;
        let name = side.name();
        let late = (*before > 0).then(|| {
            format!(
                "the {name} hand is first seen at {first:.2} s: the {before} frames before have it as it is then, and the \
                 stream does not say so"
            )
        });
        let without = (*without > 0).then(|| {
            format!(
                "{without} frames have no pose of the {name} hand: the last one seen is held, and the stream does not say so"
            )
        });
        late.into_iter().chain(without).collect()
    }
}

/// That poses begin late, or before 0, which a stream does not say.
pub fn of_start(clip: &PoseClip) -> Option<String> {
    let start = clip.frames.iter().map(|frame| frame.time).fold(f64::INFINITY, f64::min);
    let off = start.abs();
    let beside =
        if start < 0.0 { format!("starts {off:.2} s after it") } else { format!("must start {off:.2} s in") };
    (LATE..EARLIEST_CLOCK).contains(&off).then(|| {
        format!(
            "the poses begin at {start:.2} s, the stream with the first of them: what is played beside it {beside}"
        )
    })
}

/// What of a stream was damaged and passed over; `held` says of what the last is shown instead: "pose is", "values are".
pub fn of_damage(damage: &Damage, held: &str) -> Vec<String> {
    let first = damage.first().iter().map(|place| format!("{place}; the last {held} held"));
    let further = (damage.further() > 0).then(|| format!("{} further places are damaged", damage.further()));
    let abandoned = (damage.abandoned() > 0).then(|| {
        format!(
            "no I plane that a start code marks follows the damage (encode --resync writes such): {} bytes up to the end of \
             the stream are passed over, and what they told is missing",
            damage.abandoned()
        )
    });
    first.chain(further).chain(abandoned).collect()
}

/// That poses are not on the ticks of `rate` frames a second, or that several of these make a frame.
pub fn of_times(clip: &PoseClip, rate: f64) -> Option<String> {
    if !poses_keep(clip, rate) {
        return Some(format!(
            "the poses come at uneven times or at another rate, and are interpolated at {rate:.2} frames/s"
        ));
    }
    ticks_a_frame(clip, rate).map(|ticks| held(clip_rate(clip), rate, ticks, farthest_tick(clip, rate)))
}

/// That none of the rates that a stream can have is near to `rate` frames a second, of values that have that one.
pub fn of_rate(rate: f64) -> Option<String> {
    let (found, ticks) = FrameRate::carrying(rate).filter(|(_, ticks)| *ticks > 1)?;
    Some(held(rate, found.per_second(), ticks, 0.5 / found.per_second()))
}

/// How a rate that no stream has is sent, each frame up to `off` seconds from its time.
fn held(own: f64, rate: f64, ticks: u32, off: f64) -> String {
    format!(
        "no stream has {own:.4} frames/s: this one has {rate:.4}, of which one in {ticks} begins a frame, at most {:.1} ms \
         from its time, and the others hold it",
        off * 1e3
    )
}

/// That what an encoder aimed at was missed, by its report and how far fingertips are off.
pub fn of_report(aim: Target, live: bool, report: &PlanReport, tips: Option<TipError>) -> Option<String> {
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
        Target::TipError(wanted) => {
            let TipError { max_mm, sizes_mm, .. } = tips?;
            if max_mm <= wanted {
                return None;
            }
            let sizes = if sizes_mm > 0.0 {
                format!(
                    ", of which the sizes that the stream carries, rounded ones, make up to {sizes_mm:.2} mm alone"
                )
            } else {
                String::new()
            };
            Some(format!(
                "fingertips could not be kept within {wanted} mm: they are up to {max_mm:.2} mm off{sizes}"
            ))
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

/// That streams one behind the other tell different sizes of these hands; `shown` says which all poses have: "the last ones", say.
pub fn of_sizes(resized: &[Side], shown: &str) -> Option<String> {
    let names: Vec<&str> = resized.iter().map(|side| side.name()).collect();
    let (names, s) = (names.join(" and "), if resized.len() > 1 { "s" } else { "" });
    (!resized.is_empty()).then(|| {
        format!("its streams tell different sizes of the {names} hand{s}: all poses are shown with {shown}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{HandPose, PoseHeader};

    fn clip(sides: &[Side]) -> PoseClip {
        let header = PoseHeader::one(sides[0], None, Some(30.0));
        let pose = |i: usize, side: Side| TimedPose::new(i as f64 / 30.0, HandPose::neutral(side));
        let frames = (0..60).flat_map(|i| sides.iter().map(move |&side| pose(i, side)));
        PoseClip { header, frames: frames.collect() }
    }

    #[test]
    fn live_aims_that_are_missed_are_told() {
        let told = |aim: Target, rms_degrees: f64, max_mm: f64| {
            let report = PlanReport { rms_degrees, ..PlanReport::default() };
            of_report(aim, true, &report, Some(TipError { max_mm, ..TipError::default() })).is_some()
        };
        assert!(!told(Target::Rms(0.4), 0.43, 9.0) && told(Target::Rms(0.4), 0.45, 9.0));
        assert!(!told(Target::TipError(2.0), 9.0, 2.0) && told(Target::TipError(2.0), 9.0, 2.01));
    }

    #[test]
    fn a_late_start_is_told() {
        let mut late = clip(&[Side::Right]);
        assert_eq!(of_start(&late), None);
        late.frames.iter_mut().for_each(|frame| frame.time += 3.0);
        assert!(of_start(&late).unwrap().starts_with("the poses begin at 3.00 s"));
        late.frames.iter_mut().for_each(|frame| frame.time -= 5.5);
        assert_eq!(
            of_start(&late).unwrap(),
            "the poses begin at -2.50 s, the stream with the first of them: what is played beside it starts 2.50 s after it"
        );
        late.frames.clear();
        assert_eq!(of_start(&late), None);
    }

    #[test]
    fn frames_that_are_made_up_are_told() {
        let told = |clip: &PoseClip| of_poses(clip, Profile::Hand, 0.0);
        let whole = clip(&[Side::Right]);
        assert!(told(&whole).is_empty());
        let mut missing = whole.clone();
        missing.frames.drain(20..29);
        let said = told(&missing);
        assert!(
            said.len() == 1 && said[0].starts_with("9 frames have no pose of the right hand"),
            "{said:?}"
        );
        // Before it is first seen nothing could be held.
        let mut late = whole.clone();
        late.frames[..15].iter_mut().for_each(|frame| frame.valid = false);
        late.frames[40..42].iter_mut().for_each(|frame| frame.valid = false);
        let said = told(&late);
        assert!(said.len() == 2 && said[0].starts_with("2 poses are of a lost hand"), "{said:?}");
        assert!(
            said[1].starts_with("the right hand is first seen at 0.50 s: the 15 frames before"),
            "{said:?}"
        );
        let mut both = clip(&[Side::Left, Side::Right]);
        both.frames
            .retain(|f| f.pose.side == Side::Right || (30..50).contains(&((f.time * 30.0).round() as usize)));
        let said = told(&both);
        assert!(said.len() == 2 && said[0].starts_with("the left hand is first seen at 1.00 s"), "{said:?}");
        assert!(said[1].starts_with("10 frames have no pose of the left hand"), "{said:?}");
    }

    #[test]
    fn what_is_interpolated_is_told_once() {
        let told = |clip: &PoseClip| of_poses(clip, Profile::Hand, 0.25);
        let mut gaps = clip(&[Side::Right]);
        gaps.frames[10..13].iter_mut().for_each(|frame| frame.valid = false);
        gaps.frames[40..52].iter_mut().for_each(|frame| frame.valid = false);
        gaps.frames.drain(20..24);
        gaps.frames.drain(11..12);
        let said = told(&gaps);
        assert!(said.len() == 2 && said[0].starts_with("7 poses in gaps"), "{said:?}");
        assert!(said[1].starts_with("12 poses are of a lost hand"), "{said:?}");
        let said = of_poses(&gaps, Profile::Hand, 0.0);
        assert!(said[0].starts_with("14 poses are") && said[1].starts_with("5 frames have"), "{said:?}");
        // At times without a beat as well.
        for (i, frame) in gaps.frames.iter_mut().enumerate() {
            frame.time += 0.4 / 30.0 * (2.3 * i as f64).sin();
        }
        assert!(!poses_keep(&gaps, 30.0));
        let said = told(&gaps);
        assert!(
            said.len() == 2 && said[0].starts_with("2 poses in gaps") && said[1].starts_with("12 poses"),
            "{said:?}"
        );
    }

    /// A clock a little slower than the ticks leaves one empty now and then, in which nothing is missing.
    #[test]
    fn a_slow_clock_misses_nothing() {
        let mut slow = clip(&[Side::Right]);
        slow.frames.iter_mut().for_each(|frame| frame.time *= 30.0 / 29.97);
        assert!(of_poses(&slow, Profile::Hand, 0.25).is_empty());
    }

    #[test]
    fn different_sizes_are_told_by_hand() {
        assert_eq!(of_sizes(&[], "the last ones"), None);
        assert!(of_sizes(&[Side::Left], "the last ones").unwrap().contains("of the left hand: all"));
        let both = of_sizes(&[Side::Left, Side::Right], "one of them").unwrap();
        assert!(both.contains("left and right hands") && both.ends_with("with one of them"), "{both}");
    }

    #[test]
    fn an_aim_that_sizes_alone_miss_is_told_with_what_they_make() {
        let report = PlanReport::default();
        let tips = TipError { max_mm: 1.9, sizes_mm: 1.25, ..TipError::default() };
        let said = of_report(Target::TipError(1.0), false, &report, Some(tips)).unwrap();
        assert!(
            said.contains("within 1 mm") && said.contains("1.90 mm off") && said.contains("1.25 mm alone"),
            "{said}"
        );
        assert_eq!(of_report(Target::TipError(2.0), false, &report, Some(tips)), None);
        let without_sizes = TipError { sizes_mm: 0.0, ..tips };
        let said = of_report(Target::TipError(1.0), false, &report, Some(without_sizes)).unwrap();
        assert!(!said.contains("sizes"), "{said}");
    }
}
