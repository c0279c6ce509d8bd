//! Rate control: which quantiser, masks, ranges and levels to send for the wanted rate or error.
//!
//! Offline, every I period is planned as a whole: for each BAP the cheapest way through the period is
//! searched (see `path`), for several quantiser indices, at a price λ per bit. λ is the same for the whole clip
//! and set so that the clip meets its target; only where a rate is to be held it differs from frame to frame
//! (see `hold`). All of it stays within the standard's predictive mode, so any decoder reads the result.

mod attempt;
mod budget;
mod choice;
mod clip;
mod encoder;
mod hold;
mod live;
mod options;
mod path;
mod plans;
mod ranges;
mod report;
mod search;
mod share;
mod steering;
mod windows;

pub use clip::MAX_GAP;
pub use encoder::{ClipEncoder, encode_clip};
pub use live::LiveEncoder;
pub use options::{Choices, Levels, PlanOptions, Target};
pub use report::PlanReport;
#[doc(hidden)]
pub use share::relay;

pub use crate::bap::TimedBapFrame;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bap::{Bap, StepTable};
    use crate::encoder::degrees_per_unit;
    use crate::state::step;
    use crate::syntax::{MAX_RANGE_CODE, range_levels};
    use crate::{Decoder, DecoderOptions};

    /// Bends that rest and move by turns, eight seconds at 30 frames/s.
    fn clip() -> Vec<TimedBapFrame> {
        let value = |tick: i32, finger: i32| {
            let phase = (tick + 13 * finger) % 60;
            let share = f64::from(phase.min(12)) / 12.0;
            let smooth = share * share * (3.0 - 2.0 * share);
            let target = f64::from((tick + 13 * finger) / 60 % 2 * 2 - 1);
            let noise = f64::from((tick * 7919 + finger * 104_729) % 401 - 200);
            (target * (2.0 * smooth - 1.0) * 40_000.0 + noise) as i32
        };
        let frame = |tick: i32| {
            (0..6)
                .filter_map(|finger| Some((Bap::new(126 + 6 * finger as u16)?, value(tick, finger))))
                .collect()
        };
        (0..240).map(|tick| TimedBapFrame { time: f64::from(tick) / 30.0, baps: frame(tick) }).collect()
    }

    /// RMS and largest error in degrees of a stream, seen from outside: each input frame against the
    /// last plane at or before it.
    fn measure(stream: &[u8], clip: &[TimedBapFrame]) -> (f64, f64) {
        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(stream).unwrap();
        let mut planes = Vec::new();
        while let Some(plane) = decoder.next_frame().unwrap() {
            planes.push(plane);
        }
        let (mut sum, mut count, mut max) = (0.0, 0.0, 0.0f64);
        for frame in clip {
            let plane = planes.iter().rfind(|plane| plane.time <= frame.time + 1e-6).unwrap();
            for (bap, value) in frame.baps.iter() {
                let off = f64::from(value - plane.baps.value(bap)) * degrees_per_unit(bap);
                sum += off * off;
                count += 1.0;
                max = max.max(off.abs());
            }
        }
        ((sum / count).sqrt(), max)
    }

    /// Most frames in a row in which the same angle of a stream is off by more than so many degrees.
    fn longest_off(stream: &[u8], clip: &[TimedBapFrame], degrees: f64) -> usize {
        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(stream).unwrap();
        let planes: Vec<_> = std::iter::from_fn(|| decoder.next_frame().unwrap()).collect();
        let mut rows = [0; crate::bap::BAP_COUNT];
        let mut longest = 0;
        for frame in clip {
            let plane = planes.iter().rfind(|plane| plane.time <= frame.time + 1e-6).unwrap();
            for (bap, value) in frame.baps.iter() {
                let off = f64::from(value - plane.baps.value(bap)) * degrees_per_unit(bap);
                let row = &mut rows[bap.index()];
                *row = if off.abs() > degrees { *row + 1 } else { 0 };
                longest = longest.max(*row);
            }
        }
        longest
    }

    #[test]
    fn aims_are_met_and_reported_truly() {
        let clip = clip();
        let plan = |mode, live| {
            let options = PlanOptions { mode, live, ..PlanOptions::default() };
            let (stream, report) = encode_clip(&clip, &options).unwrap();
            let (rms, max) = measure(&stream, &clip);
            assert!((rms - report.rms_degrees).abs() < 1e-9, "{mode:?}");
            assert!((max - report.max_degrees).abs() < 1e-9, "{mode:?}");
            assert_eq!(stream.len(), report.bytes);
            assert_eq!(
                report.bits.total().div_ceil(8) + 9 - report.bytes as u64,
                u64::from(report.bits.total() % 8 != 0)
            );
            report
        };
        let rounded = plan(Target::Quant(10), false);
        let aimed = plan(Target::Rms(rounded.rms_degrees), false);
        assert!(aimed.rms_degrees <= rounded.rms_degrees);
        assert!(aimed.bytes < rounded.bytes, "{} of {}", aimed.bytes, rounded.bytes);
        let bounded = plan(Target::MaxError(1.0), false);
        assert!(bounded.max_degrees <= 1.0);
        let rate = plan(Target::Bitrate(0.6), false);
        assert!((0.5..=0.6).contains(&rate.kbit_per_s()), "{}", rate.kbit_per_s());
        plan(Target::Rms(0.5), true);
        assert!(plan(Target::MaxError(1.5), true).max_degrees <= 1.5);
    }

    /// At coarse quantisers no level is left for the end of the largest range: the one below it does.
    #[test]
    fn the_end_of_the_largest_range_is_coded_at_any_quantiser() {
        let turn = Bap::new(198).unwrap();
        let value = |tick: i32| if tick < 120 { 1860 } else { -1860 };
        let clip: Vec<TimedBapFrame> = (0..240)
            .map(|tick| {
                let baps = [(turn, value(tick)), (Bap::new(126).unwrap(), 30 * (tick % 50))];
                TimedBapFrame { time: f64::from(tick) / 30.0, baps: baps.into_iter().collect() }
            })
            .collect();
        let coarse = (0..32).map(Target::Quant);
        for mode in coarse.chain([Target::Rms(6.0), Target::Bitrate(0.3), Target::MaxError(9.0)]) {
            for live in [false, true] {
                let options = PlanOptions { mode, live, ..PlanOptions::default() };
                let (stream, _) = encode_clip(&clip, &options).unwrap();
                let mut decoder = Decoder::new(DecoderOptions::default());
                decoder.push(&stream).unwrap();
                let first = decoder.next_frame().unwrap().unwrap().baps.value(turn);
                assert!((1860 - first).abs() <= 127, "{mode:?}, live {live}: {first}");
            }
        }
    }

    /// An angle at the very end of its range, which some quantisers do not carry, is no reason to hold no rate, whatever error
    /// is asked for with it.
    #[test]
    fn a_rate_is_held_where_a_quantiser_does_not_reach() {
        let bend = Bap::new(132).unwrap();
        let end = range_levels(MAX_RANGE_CODE, 1) * step(bend, StepTable::Standard, 1) + 1;
        let mut clip = clip();
        let later: Vec<_> =
            clip.iter().map(|frame| TimedBapFrame { time: frame.time + 8.0, ..*frame }).collect();
        clip.extend(later);
        clip[200..260].iter_mut().for_each(|frame| frame.baps.set(bend, end));
        for clip in [&clip[..240], &clip] {
            for kbit_per_s in [0.6, 2.0, 6.0] {
                for max_error in [0.1, 2.5] {
                    let mode = Target::Bitrate(kbit_per_s);
                    let options = PlanOptions { mode, max_error, ..PlanOptions::default() };
                    let (_, report) = encode_clip(clip, &options).unwrap();
                    let rate = report.kbit_per_s() / kbit_per_s;
                    assert!(rate <= 1.05, "{rate} of {kbit_per_s} kbit/s");
                }
            }
        }
    }

    /// Live, a leap by 100° leaves no angle off by more than 10° for more than 0.3 s at any rate from 1 kbit/s on.
    #[test]
    fn leaps_are_made_good() {
        let leaping = Bap::new(132).unwrap();
        let moving = clip();
        for leaps in [[2, 120], [45, 160]] {
            let frame = |(tick, frame): (usize, &TimedBapFrame)| {
                let bent = leaps.iter().filter(|&&leap| tick >= leap).count() % 2;
                let mut frame = *frame;
                frame.baps.set(leaping, -175_000 * bent as i32 + frame.baps.value(leaping) / 10);
                frame
            };
            let clip: Vec<TimedBapFrame> = moving.iter().enumerate().map(frame).collect();
            for kbit_per_s in [1.0, 1.5, 2.2, 5.0] {
                let options =
                    PlanOptions { mode: Target::Bitrate(kbit_per_s), live: true, ..PlanOptions::default() };
                let (stream, _) = encode_clip(&clip, &options).unwrap();
                let longest = longest_off(&stream, &clip, 10.0);
                assert!(longest <= 9, "{longest} frames at {kbit_per_s} kbit/s, leaps at {leaps:?}");
            }
        }
    }

    #[test]
    fn nonsense_is_refused() {
        let clip = clip();
        for mode in [Target::Quant(32), Target::Rms(0.0), Target::Bitrate(f64::NAN), Target::MaxError(-1.0)] {
            assert!(encode_clip(&clip, &PlanOptions { mode, ..PlanOptions::default() }).is_err(), "{mode:?}");
        }
        assert!(encode_clip([] as [TimedBapFrame; 0], &PlanOptions::default()).is_err());
        let backwards: Vec<TimedBapFrame> = clip.into_iter().rev().collect();
        assert!(encode_clip(&backwards, &PlanOptions::default()).is_err());
    }
}
