//! When a track is shown: its edit list (8.6.6), and when its samples are composed (8.6.1).

use super::boxes::{u32_at, u64_at};
use super::read::{path, time_scale};

/// The first part of a track that is shown; all of it where there is no list.
#[derive(Default)]
struct Edit {
    /// When it is shown, ticks of the movie: parts before it that begin at -1 show nothing, for a while.
    at: u64,
    /// Where it begins, ticks of the track.
    start: i64,
    /// How long it is, ticks of the movie; 0 is to the end.
    duration: u64,
}

impl Edit {
    fn first(track: &[u8]) -> Self {
        let list = path(track, &[b"edts", b"elst"]).ok().flatten().unwrap_or_default();
        let is_long = list.first() == Some(&1);
        let rows = list.get(8..).unwrap_or_default().chunks_exact(if is_long { 20 } else { 12 });
        let mut at = 0u64;
        for row in rows {
            let (duration, start) = match is_long {
                true => (u64_at(row, 0), u64_at(row, 8).map(u64::cast_signed)),
                false => (u32_at(row, 0).map(u64::from), u32_at(row, 4).map(|v| v.cast_signed().into())),
            };
            let (Some(duration), Some(start)) = (duration, start) else { break };
            if start >= 0 {
                return Self { at, start, duration };
            }
            at = at.saturating_add(duration);
        }
        Self { at, ..Self::default() }
    }
}

/// Whether a track tells which parts of it are shown, and when.
pub fn is_edited(track: &[u8]) -> bool {
    matches!(path(track, &[b"edts", b"elst"]), Ok(Some(_)))
}

/// Seconds of a movie of `scale` ticks a second at which the first sample of a track is shown; what cannot be read of the
/// track counts as 0.
pub fn begins(track: &[u8], scale: u32) -> f64 {
    let edit = Edit::first(track);
    edit.at as f64 / f64::from(scale) + into(track, &edit, scale).unwrap_or(0.0)
}

/// Seconds from where an edit begins to the first sample in it.
fn into(track: &[u8], edit: &Edit, scale: u32) -> Option<f64> {
    let ticks = time_scale(path(track, &[b"mdia", b"mdhd"]).ok()??)?;
    let table = path(track, &[b"mdia", b"minf", b"stbl"]).ok()??;
    let durations = path(table, &[b"stts"]).ok()??;
    let shifts = path(table, &[b"ctts"]).ok()?;
    let from = i128::from(edit.start);
    let to = match i128::from(edit.duration) * i128::from(ticks) {
        0 => i128::MAX,
        length => from + (length + i128::from(scale) - 1) / i128::from(scale),
    };
    let first = Samples::of(durations, shifts).filter_map(|samples| samples.first_in(from, to)).min()?;
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
    durations: Counted<'a>,
    /// From when a sample is decoded to when it is shown; no time at all where there is no table.
    shifts: Option<Counted<'a>>,
    /// When the next one is decoded.
    clock: i128,
}

/// The rows of a table, each a count and a value, and how many are left of the one before them.
struct Counted<'a> {
    rows: std::slice::ChunksExact<'a, u8>,
    left: u32,
    value: u32,
}

impl<'a> Counted<'a> {
    fn of(table: &'a [u8]) -> Self {
        Self { rows: table.get(8..).unwrap_or_default().chunks_exact(8), left: 0, value: 0 }
    }

    /// How many of the next ones have the same value, and which.
    fn next(&mut self) -> Option<(u32, u32)> {
        while self.left == 0 {
            let row = self.rows.next()?;
            (self.left, self.value) = (u32_at(row, 0)?, u32_at(row, 4)?);
        }
        Some((self.left, self.value))
    }
}

impl<'a> Samples<'a> {
    fn of(durations: &'a [u8], shifts: Option<&'a [u8]>) -> Self {
        Self { durations: Counted::of(durations), shifts: shifts.map(Counted::of), clock: 0 }
    }
}

impl Iterator for Samples<'_> {
    type Item = Run;

    fn next(&mut self) -> Option<Run> {
        let (mut count, step) = self.durations.next()?;
        let mut shift = 0;
        if let Some(shifts) = &mut self.shifts {
            let (same, value) = shifts.next()?;
            (count, shift) = (count.min(same), value.cast_signed());
            shifts.left -= count;
        }
        self.durations.left -= count;
        let first = self.clock + i128::from(shift);
        self.clock += i128::from(count) * i128::from(step);
        Some(Run { count, first, step })
    }
}
