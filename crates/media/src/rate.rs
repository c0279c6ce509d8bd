//! The rate of a clip whose frames tell their times.

/// Shares of the intervals, in order of length, that may be the clip's own: longest first.
const USUAL: [f64; 3] = [0.5, 0.25, 0.1];
/// How far an interval may be from a multiple of the clip's own, as a share of that.
const SLACK: f64 = 0.2;
/// Share of the intervals that must be multiples.
const MOST: f64 = 0.9;
/// How many times the mean rate it may be: of a clock's finest ticks everything is a multiple.
const FASTEST: f64 = 4.0;

/// Frames per second of a camera that dropped frames now and then: most intervals of `times` (seconds, in rising order) are
/// whole multiples of the interval that belongs to it. Where there is no such interval, the mean rate; none where there
/// are not two instants.
pub(crate) fn nominal_rate(times: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|step| *step > 0.0).collect();
    let span: f64 = steps.iter().sum();
    steps.sort_by(f64::total_cmp);
    let last = steps.len().checked_sub(1)?;
    let multiple = |step: f64, period: f64| (step / period).round().max(1.0);
    let fits = |period: f64| {
        let near = |step: &&f64| (**step / period - multiple(**step, period)).abs() <= SLACK;
        span <= FASTEST * period * steps.len() as f64
            && steps.iter().filter(near).count() as f64 >= MOST * steps.len() as f64
    };
    let period = USUAL.iter().map(|share| steps[(share * last as f64) as usize]).find(|&period| fits(period));
    // Times are rounded, to milliseconds for instance: all of them together tell more than one interval.
    let frames = period.map_or(steps.len() as f64, |period| steps.iter().map(|&s| multiple(s, period)).sum());
    Some(frames / span)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rate(steps: impl IntoIterator<Item = f64>) -> f64 {
        let mut times = vec![0.0];
        times.extend(steps.into_iter().scan(0.0, |at, step| {
            *at += step;
            Some(*at)
        }));
        nominal_rate(&times).unwrap()
    }

    #[test]
    fn dropped_frames_leave_the_rate_as_it_is() {
        let dropping = (0..485).map(|i| if i % 70 == 30 { 2.0 / 30.0 } else { 1.0 / 30.0 });
        assert!((rate(dropping) - 30.0).abs() < 1e-9);
        let slower = (0..60).map(|_| 1.0 / 30.0).chain((0..80).map(|_| 0.1));
        assert!((rate(slower) - 30.0).abs() < 1e-9);
    }

    #[test]
    fn rounded_times_tell_the_rate_together() {
        let millis = (0..300).map(|i| if i % 3 == 2 { 0.034 } else { 0.033 });
        assert!((rate(millis) - 30.0).abs() < 1e-9);
        assert!((rate((0..100).map(|_| 0.04)) - 25.0).abs() < 1e-9);
    }

    #[test]
    fn times_without_a_beat_have_their_mean() {
        let uneven = (0..100).map(|i| 0.02 + 0.0007 * f64::from(i * 37 % 100));
        let mean = 100.0 / (0..100).map(|i| 0.02 + 0.0007 * f64::from(i * 37 % 100)).sum::<f64>();
        assert!((rate(uneven) - mean).abs() < 1e-9);
        // Frames that come in bursts, as recorders of network streams write them, milliseconds.
        let bursts = (0..89).map(|i| if i % 4 == 3 { 0.13 } else { 0.001 });
        let span: f64 = bursts.clone().sum();
        assert!((rate(bursts) - 89.0 / span).abs() < 1e-9);
        assert_eq!(nominal_rate(&[0.5]), None);
        assert_eq!(nominal_rate(&[0.5, 0.5]), None);
    }
}
