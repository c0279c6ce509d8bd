//! When a track is shown: its edit list (8.6.6), and when its samples are composed (8.6.1).

use handcast_iso::{Edit, Runs, behind_dates, edit, path};

/// Whether a track tells which parts of it are shown, and when.
pub fn is_edited(track: &[u8]) -> bool {
    matches!(path(track, &[b"edts", b"elst"]), Ok(Some(_)))
}

/// Seconds of a movie of `scale` ticks a second at which the first sample of a track is shown; what cannot be read of the
/// track counts as 0.
pub fn begins(track: &[u8], scale: u32) -> f64 {
    let edit = edit(track).ok().flatten().unwrap_or_default();
    edit.at as f64 / f64::from(scale) + into(track, &edit, scale).unwrap_or(0.0)
}

/// Seconds from where an edit begins to the first sample in it.
fn into(track: &[u8], edit: &Edit, scale: u32) -> Option<f64> {
    let ticks = path(track, &[b"mdia", b"mdhd"]).ok().flatten()?;
    let ticks = behind_dates(ticks).ok().filter(|&ticks| ticks > 0)?;
    let table = path(track, &[b"mdia", b"minf", b"stbl"]).ok()??;
    let durations = Runs::of(path(table, &[b"stts"]).ok()??, "stts").ok()?;
    let shifts = path(table, &[b"ctts"]).ok()?.map(|table| Runs::of(table, "ctts")).transpose().ok()?;
    let times = edit.shown(ticks, scale);
    let (from, to) = (i128::from(times.start), i128::from(times.end));
    let samples = Samples { durations, shifts, clock: 0 };
    let first = samples.filter_map(|samples| samples.first_in(from, to)).min()?;
    Some((first - from) as f64 / f64::from(ticks))
}

/// Samples with an even step, ticks of the track.
struct Run {
    count: u32,
    first: i128,
    step: u32,
}

impl Run {
    /// When the first of them is shown that is shown between two times.
    fn first_in(&self, from: i128, to: i128) -> Option<i128> {
        let step = i128::from(self.step);
        let before = match (from - self.first, step) {
            (..=0, _) => 0,
            (_, 0) => return None,
            (short, step) => (short + step - 1) / step,
        };
        let time = self.first + before * step;
        (before < i128::from(self.count) && time < to).then_some(time)
    }
}

/// The samples of a track in runs; memory and time are those of its tables, however many they say there are.
struct Samples<'a> {
    durations: Runs<'a>,
    /// From when a sample is decoded to when it is shown; no time at all where there is no table.
    shifts: Option<Runs<'a>>,
    /// When the next one is decoded.
    clock: i128,
}

impl Iterator for Samples<'_> {
    type Item = Run;

    fn next(&mut self) -> Option<Run> {
        let (mut count, step) = self.durations.run()?;
        let mut shift = 0;
        if let Some(shifts) = &mut self.shifts {
            let (same, value) = shifts.run()?;
            (count, shift) = (count.min(same), value.cast_signed());
            shifts.pass(count);
        }
        self.durations.pass(count);
        let first = self.clock + i128::from(shift);
        self.clock += i128::from(count) * i128::from(step);
        Some(Run { count, first, step })
    }
}
