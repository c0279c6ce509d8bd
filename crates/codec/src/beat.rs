//! The rate behind times that were rounded.

/// What times may have been rounded to, seconds, coarsest first: hundredths (GIF), milliseconds (phones, MediaPipe, logs).
const ROUNDED_TO: [f64; 2] = [0.01, 0.001];
/// How far a time may be from a multiple of what it was rounded to, seconds.
const EXACT: f64 = 1e-7;
/// Share of the beat that rounding may be: beyond it beats cannot be counted.
const LARGEST: f64 = 0.35;
/// How near a rate must be to a usual one to be taken for it, as a share, and the usual ones that are no whole numbers.
const BESIDE: f64 = 2e-3;
const BROADCAST: [f64; 5] = [24.0, 30.0, 48.0, 60.0, 120.0];

/// Frames per second of `times` (seconds, in order) that have a beat but for their rounding: the usual rate near to `rough` that
/// all of them agree with, or their mean one. `None` where they are not rounded, or have no beat.
pub(crate) fn rate_of_rounded(times: &[f64], rough: f64) -> Option<f64> {
    let (first, last) = (*times.first()?, *times.last()?);
    // Seconds since 1970 have digits of their own to spare.
    let exact = EXACT.max(4.0 * f64::EPSILON * last.abs());
    let is_multiple = |t: f64, unit: f64| ((t / unit).round() * unit - t).abs() < exact;
    if last <= first {
        return None;
    }
    let usable = |unit: &f64| unit * rough <= LARGEST && times.iter().all(|&t| is_multiple(t, *unit));
    let unit = ROUNDED_TO.into_iter().find(usable)?;
    let counted = |rate: f64| times.windows(2).map(move |w| ((w[1] - w[0]) * rate).round());
    let mean = |rate: f64| counted(rate).sum::<f64>() / (last - first);
    // Long gaps are counted right once the rate is.
    let mean = mean(mean(rough));
    let agrees = |rate: f64| {
        let mut beats = 0.0;
        times[1..].iter().zip(counted(rate)).all(|(t, count)| {
            beats += count;
            // Both that time and the first one are rounded.
            count >= 1.0 && (t - first - beats / rate).abs() <= unit + exact
        })
    };
    let broadcast = BROADCAST.map(|rate| rate * 1000.0 / 1001.0);
    let usual = [mean.round(), (2.0 * mean).round() / 2.0].into_iter().chain(broadcast);
    let mut near = usual.filter(|rate| *rate > 0.0 && (mean / rate - 1.0).abs() < BESIDE).chain([mean]);
    near.find(|&rate| agrees(rate))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clip::clip_rate;
    use handcast_hand::{HandPose, PoseClip, Side, TimedPose};

    fn found(times: impl IntoIterator<Item = f64>) -> f64 {
        let pose = |t| TimedPose::new(t, HandPose::neutral(Side::Right));
        clip_rate(&PoseClip::of_frames(times.into_iter().map(pose), None))
    }

    fn rounded(rate: f64, unit: f64, frames: impl IntoIterator<Item = u32>) -> Vec<f64> {
        frames.into_iter().map(|i| (f64::from(i) / rate / unit).round() * unit).collect()
    }

    #[test]
    fn times_in_milliseconds_tell_the_rate() {
        for rate in [
            12.5,
            15.0,
            24_000.0 / 1001.0,
            25.0,
            30_000.0 / 1001.0,
            30.0,
            50.0,
            60_000.0 / 1001.0,
            60.0,
            120.0,
        ] {
            assert_eq!(found(rounded(rate, 0.001, 0..300)), rate);
            assert_eq!(
                found(rounded(rate, 0.001, (0..300).filter(|i| i % 7 != 3 && !(40..90).contains(i)))),
                rate
            );
        }
        assert_eq!(found(rounded(30.0, 0.01, 0..60)), 30.0);
        assert_eq!(found(rounded(30.0, 0.001, 0..300).into_iter().map(|t| 1.7e9 + t)), 30.0);
        // One that is not usual has its mean.
        let odd = found(rounded(27.3, 0.001, 0..300));
        assert!((odd / 27.3 - 1.0).abs() < 2e-4, "{odd}");
    }

    #[test]
    fn times_that_are_not_rounded_or_have_no_beat_are_let_be() {
        let exact = |i: u32| f64::from(i) / 30.31;
        assert!((found((0..90).map(exact)) - 30.31).abs() < 1e-9);
        let uneven = |i: u32| f64::from(i * 33 + (i * 37) % 11) / 1000.0;
        let mut steps: Vec<f64> = (0..89).map(|i| uneven(i + 1) - uneven(i)).collect();
        steps.sort_by(f64::total_cmp);
        assert_eq!(found((0..90).map(uneven)), 1.0 / steps[44]);
        assert_eq!(rate_of_rounded(&[0.5], 30.0), None);
        assert_eq!(rate_of_rounded(&[], 30.0), None);
    }
}
