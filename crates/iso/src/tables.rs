//! The tables of a track: where its samples lie, runs of values, which part of it is shown.

use std::iter::Peekable;
use std::ops::Range;
use std::slice::ChunksExact;

use crate::{Damage, Found, child, damage, needed, number, path, u32_at, u64_at, unsigned};

/// The rows, of `width` bytes each, at least 1, of a table whose count is at byte 4 of its box and whose rows follow it.
///
/// # Errors
/// The table says more rows than it has.
pub fn rows<'a>(table: &'a [u8], name: &str, width: usize) -> Found<ChunksExact<'a, u8>> {
    let count = number(table, 4)? as usize;
    let rows = count.checked_mul(width).and_then(|bytes| table.get(8..)?.get(..bytes));
    match rows {
        Some(rows) => Ok(rows.chunks_exact(width.max(1))),
        None => damage(format!("the table {name} says {count} entries, more than it has")),
    }
}

/// A value for each sample, from a table whose rows are a count and a value, such as `stts` and `ctts` (8.6.1). However many
/// samples the rows tell of, they take no memory.
#[derive(Clone, Debug)]
pub struct Runs<'a> {
    rows: ChunksExact<'a, u8>,
    left: u32,
    value: u32,
}

impl<'a> Runs<'a> {
    /// Of the content of a table's box.
    ///
    /// # Errors
    /// The table says more rows than it has.
    pub fn of(table: &'a [u8], name: &str) -> Found<Self> {
        Ok(Self { rows: rows(table, name, 8)?, left: 0, value: 0 })
    }

    /// How many samples from the next one on have the same value, at least one, and which; none behind the last.
    pub fn run(&mut self) -> Option<(u32, u32)> {
        while self.left == 0 {
            let row = self.rows.next()?;
            (self.left, self.value) = (u32_at(row, 0)?, u32_at(row, 4)?);
        }
        Some((self.left, self.value))
    }

    /// Goes on by so many samples of the run.
    pub fn pass(&mut self, count: u32) {
        self.left = self.left.saturating_sub(count);
    }
}

impl Iterator for Runs<'_> {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        let (_, value) = self.run()?;
        self.pass(1);
        Some(value)
    }
}

/// Where the samples of a track lie, byte and length of each (8.7.3 to 8.7.5). Nothing says that they lie within the file.
#[derive(Clone, Debug)]
pub struct Places<'a> {
    count: u32,
    fixed: u32,
    sizes: ChunksExact<'a, u8>,
    chunks: ChunksExact<'a, u8>,
    runs: Peekable<ChunksExact<'a, u8>>,
    chunk: u32,
    /// Samples of a chunk, by the last run that has begun.
    held: Option<u32>,
    /// Samples that are left, of all and of the chunk, and where the next one begins.
    left: u32,
    left_in_chunk: u32,
    at: u64,
}

impl<'a> Places<'a> {
    /// Of the content of a box `stbl`.
    ///
    /// # Errors
    /// Tables are missing, or say more entries than they have.
    pub fn of(stbl: &'a [u8]) -> Found<Self> {
        let sizes = needed(stbl, b"stsz")?;
        let (fixed, count) = (number(sizes, 4)?, number(sizes, 8)?);
        let wanted = if fixed > 0 { Some(0) } else { (count as usize).checked_mul(4) };
        let listed = wanted.and_then(|bytes| sizes.get(12..)?.get(..bytes));
        let Some(listed) = listed else {
            return damage(format!("the table stsz says {count} entries, more than it has"));
        };
        let chunks = match (child(stbl, b"stco")?, child(stbl, b"co64")?) {
            (Some(places), _) => rows(places, "stco", 4)?,
            (None, Some(places)) => rows(places, "co64", 8)?,
            (None, None) => return damage("there is neither a box stco nor co64"),
        };
        let runs = rows(needed(stbl, b"stsc")?, "stsc", 12)?.peekable();
        Ok(Self {
            count,
            fixed,
            sizes: listed.chunks_exact(4),
            chunks,
            runs,
            chunk: 0,
            held: None,
            left: count,
            left_in_chunk: 0,
            at: 0,
        })
    }

    /// How many samples there are.
    pub fn samples(&self) -> u32 {
        self.count
    }

    /// The least that all of them have together, bytes: what a length that is told once for all makes of their count.
    pub fn least(&self) -> u64 {
        u64::from(self.fixed).saturating_mul(self.count.into())
    }

    fn next_place(&mut self) -> Found<(u64, u32)> {
        while self.left_in_chunk == 0 {
            let few = || Damage("chunks hold fewer samples than there are".to_owned());
            let place = self.chunks.next().ok_or_else(few)?;
            self.chunk = self.chunk.saturating_add(1);
            let chunk = self.chunk;
            while let Some(run) = self.runs.next_if(|run| u32_at(run, 0).is_some_and(|first| first <= chunk))
            {
                self.held = u32_at(run, 4);
            }
            let first = || Damage("the table stsc does not begin with the first chunk".to_owned());
            (self.at, self.left_in_chunk) = (unsigned(place), self.held.ok_or_else(first)?);
        }
        let size =
            if self.fixed > 0 { self.fixed } else { number(self.sizes.next().unwrap_or_default(), 0)? };
        let at = self.at;
        self.at = at.saturating_add(size.into());
        self.left_in_chunk -= 1;
        Ok((at, size))
    }
}

impl Iterator for Places<'_> {
    type Item = Found<(u64, u32)>;

    fn next(&mut self) -> Option<Self::Item> {
        self.left = self.left.checked_sub(1)?;
        let place = self.next_place();
        if place.is_err() {
            self.left = 0;
        }
        Some(place)
    }
}

/// The first part of a track that is shown (8.6.6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Edit {
    /// When it is shown, ticks of the movie: parts before it that begin at -1 show nothing, for a while.
    pub at: u64,
    /// Where it begins, ticks of the track.
    pub start: i64,
    /// How long it is, ticks of the movie; 0 is to the end.
    pub duration: u64,
    /// How many parts are shown.
    pub parts: usize,
}

impl Edit {
    /// The times at which samples are in it, ticks of a track of `scale` a second in a movie of `movie_scale`, at least 1.
    pub fn shown(&self, scale: u32, movie_scale: u32) -> Range<i64> {
        let ticks = u128::from(self.duration) * u128::from(scale);
        match i64::try_from(ticks.div_ceil(movie_scale.max(1).into())) {
            Ok(ticks @ 1..) => self.start..self.start.saturating_add(ticks),
            _ => self.start..i64::MAX,
        }
    }
}

/// Which part of a track is shown first, by the content of its box `trak`; none where it has no list of them. Where the list
/// shows nothing, what would come behind it.
///
/// # Errors
/// The list is damaged.
pub fn edit(trak: &[u8]) -> Found<Option<Edit>> {
    let Some(list) = path(trak, &[b"edts", b"elst"])? else { return Ok(None) };
    let is_long = list.first() == Some(&1);
    let (mut edit, mut at) = (Edit::default(), 0u64);
    for row in rows(list, "elst", if is_long { 20 } else { 12 })? {
        let (start, duration) = match is_long {
            true => (u64_at(row, 8).map(u64::cast_signed), u64_at(row, 0)),
            false => (u32_at(row, 4).map(|start| start.cast_signed().into()), u32_at(row, 0).map(u64::from)),
        };
        let cut = || Damage("the table elst is cut".to_owned());
        let (start, duration) = start.zip(duration).ok_or_else(cut)?;
        if start >= 0 {
            edit = if edit.parts == 0 { Edit { at, start, duration, parts: 0 } } else { edit };
            edit.parts += 1;
        }
        at = at.saturating_add(duration);
    }
    Ok(Some(if edit.parts == 0 { Edit { at, ..edit } } else { edit }))
}
