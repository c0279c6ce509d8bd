//! The tables of an MP4 or MOV file (ISO/IEC 14496-12): where each compressed picture lies, and when it is shown.
//!
//! Every number is checked where it is read: boxes lie within what holds them, tables within their boxes, pictures within
//! the file; a count takes memory only when the bytes behind it are there.

use std::io::{self, Read, Seek, SeekFrom};

use handcast_limits::{Excess, Limit, Limits};

/// Why a file has no tables.
#[derive(Debug)]
pub(super) enum Fault {
    Io(io::Error),
    Truncated(String),
    Malformed(String),
    /// A codec without a decoder here.
    Codec(String),
    /// What is not in the file.
    Missing(&'static str),
    Excess(Excess),
}

type Found<T> = Result<T, Fault>;

fn malformed<T>(what: impl Into<String>) -> Found<T> {
    Err(Fault::Malformed(what.into()))
}

/// A compressed picture, in decoding order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Picture {
    pub(super) offset: u64,
    pub(super) size: u64,
    /// When it is shown, in ticks of [`Movie::timescale`]; the first one shown is at 0.
    pub(super) time: i64,
    /// Whether it is shown at all: others are there for those that are coded after them.
    pub(super) shown: bool,
}

impl Picture {
    /// Whether it lies in a file of so many bytes.
    fn is_within(&self, length: u64) -> bool {
        self.offset.checked_add(self.size).is_some_and(|end| end <= length)
    }
}

/// A track of H.264.
#[derive(Debug)]
pub(super) struct Movie {
    pub(super) width: u16,
    pub(super) height: u16,
    /// Ticks a second, at least 1.
    pub(super) timescale: u32,
    /// Entries a, b, c, d of the track's matrix (8.3.2).
    pub(super) matrix: [i32; 4],
    /// Width and height of a pixel, in parts of one another, where the file tells (12.1.4).
    pub(super) pixel: Option<[u32; 2]>,
    /// Bytes of the lengths before NAL units.
    pub(super) length_size: usize,
    /// Sequence and picture parameter sets, NAL units.
    pub(super) sequence_sets: Vec<Vec<u8>>,
    pub(super) picture_sets: Vec<Vec<u8>>,
    pub(super) pictures: Vec<Picture>,
    /// Seconds of the movie at which the first of them is shown.
    pub(super) start: f64,
    /// How many of its pictures would be shown, where some are beyond the end of the file.
    pub(super) told: Option<usize>,
    /// In which way the file is cut or its tables are damaged, where it is.
    pub(super) cut: Option<String>,
}

/// Reads the tables of the first track with H.264 of a file of so many bytes.
pub(super) fn read(file: &mut (impl Read + Seek), length: u64, limits: &Limits) -> Found<Movie> {
    let (mut movie, mut fragments) = (None, Vec::new());
    let mut cut = outer_boxes(file, length, |kind, at, size| match kind {
        b"moov" => movie = Some((at, size)),
        b"moof" => fragments.push((at, size)),
        _ => {}
    })?;
    let Some(place) = movie else {
        let cut = cut.map_or_else(String::new, |what| format!(": {what}"));
        return Err(Fault::Truncated(format!("the box moov, which describes the movie, is missing{cut}")));
    };
    let moov = content(file, place)?;
    let mut chosen: Option<Track> = None;
    let mut other = None;
    for found in children(&moov) {
        let found = match found {
            Ok(found) => found,
            // What is wrong behind the track is of no matter.
            Err(_) if chosen.is_some() || other.is_some() => break,
            Err(fault) => return Err(cut.map_or(fault, Fault::Truncated)),
        };
        let Some(trak) = found.of(b"trak") else { continue };
        match Track::read(trak, limits, length)? {
            Ok(track) if chosen.as_ref().is_none_or(|before| track.id < before.id) => chosen = Some(track),
            Ok(_) => {}
            Err(codec) => other = other.or(codec),
        }
    }
    let Some(mut track) = chosen else {
        return Err(other.map_or(Fault::Missing("the movie has no video track"), Fault::Codec));
    };
    let in_whole = fragments.is_empty();
    if !in_whole {
        let defaults = fragment_defaults(&moov)?;
        for (at, size) in fragments {
            let moof = content(file, (at, size))?;
            match track.add_fragment(&moof, at, &defaults, limits) {
                Err(Fault::Malformed(what)) if !track.movie.pictures.is_empty() => {
                    cut = Some(format!("the fragment at byte {at}: {what}"));
                    break;
                }
                added => added?,
            }
        }
    }
    let timescale = match track.edit.is_some() {
        true => {
            let mvhd = needed(&moov, b"mvhd")?;
            number(mvhd, if mvhd.first() == Some(&1) { 20 } else { 12 })?.max(1)
        }
        false => 1,
    };
    if let (Some(edit), true) = (track.edit, in_whole) {
        track.hide_outside(edit, timescale);
    }
    track.keep_whole(length, cut)?;
    Ok(track.finish(timescale))
}

/// Walks the outermost boxes: their kinds, where they begin, and their sizes. Gives in which way the file is cut, where it is;
/// of a movie's box that is cut there is what is left.
fn outer_boxes(
    file: &mut (impl Read + Seek),
    length: u64,
    mut take: impl FnMut(&[u8; 4], u64, u64),
) -> Found<Option<String>> {
    let mut at = 0u64;
    file.seek(SeekFrom::Start(at)).map_err(Fault::Io)?;
    while at < length {
        if at + 8 > length {
            return Ok(Some(format!("a box header at byte {at} is cut")));
        }
        let mut head = [0u8; 16];
        let wanted = if at + 16 <= length { 16 } else { 8 };
        file.read_exact(head.get_mut(..wanted).unwrap_or_default()).map_err(Fault::Io)?;
        let [a, b, c, d, kind @ .., e, f, g, h, i, j, k, l] = head;
        let (header, size) = match u32::from_be_bytes([a, b, c, d]) {
            0 => (8, length - at),
            1 => (16, u64::from_be_bytes([e, f, g, h, i, j, k, l])),
            size => (8, u64::from(size)),
        };
        if size < header {
            return malformed(format!("the box at byte {at} says it has {size} bytes"));
        }
        if size > length - at {
            let left = length - at;
            if &kind == b"moov" {
                take(&kind, at, left);
            }
            let kind = String::from_utf8_lossy(&kind);
            return Ok(Some(format!("the box {kind} at byte {at} says {size} bytes; {left} are left")));
        }
        take(&kind, at, size);
        at += size;
        // What has been read ahead stays: small boxes are many.
        let behind = size.cast_signed().saturating_sub(wanted as i64);
        file.seek_relative(behind).map_err(Fault::Io)?;
    }
    Ok(None)
}

/// What is in an outermost box.
fn content(file: &mut (impl Read + Seek), (at, size): (u64, u64)) -> Found<Vec<u8>> {
    file.seek(SeekFrom::Start(at)).map_err(Fault::Io)?;
    let mut whole = Vec::new();
    whole.try_reserve_exact(usize::try_from(size).unwrap_or(usize::MAX)).map_err(|_| {
        Fault::Malformed(format!("the box at byte {at} has {size} bytes, more than there is memory"))
    })?;
    file.take(size).read_to_end(&mut whole).map_err(Fault::Io)?;
    let header = if whole.starts_with(&[0, 0, 0, 1]) { 16 } else { 8 };
    whole.drain(..header.min(whole.len()));
    Ok(whole)
}

/// A box inside another.
#[derive(Clone, Copy)]
struct Inner<'a> {
    kind: [u8; 4],
    content: &'a [u8],
}

impl<'a> Inner<'a> {
    fn of(self, kind: &[u8; 4]) -> Option<&'a [u8]> {
        (&self.kind == kind).then_some(self.content)
    }
}

/// The boxes in a box. Only an outermost one may leave its size open, so that each step goes on by eight bytes or more.
fn children(bytes: &[u8]) -> impl Iterator<Item = Found<Inner<'_>>> {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let found = inner(rest);
        rest = match &found {
            Ok((_, behind)) => behind,
            Err(_) => &[],
        };
        Some(found.map(|(inner, _)| inner))
    })
}

fn inner(rest: &[u8]) -> Found<(Inner<'_>, &[u8])> {
    let kind = rest.get(4..8).and_then(|kind| <[u8; 4]>::try_from(kind).ok());
    let (Some(told), Some(kind)) = (u32_at(rest, 0), kind) else {
        return malformed("the header of an inner box is cut");
    };
    let (header, size) = match told {
        1 => (16, u64_at(rest, 8).unwrap_or(0)),
        size => (8, u64::from(size)),
    };
    let split =
        usize::try_from(size).ok().filter(|&size| size >= header).and_then(|s| rest.split_at_checked(s));
    let Some((whole, behind)) = split else {
        let name = String::from_utf8_lossy(&kind).into_owned();
        return malformed(format!("the inner box {name} says it has {size} bytes; {} are left", rest.len()));
    };
    Ok((Inner { kind, content: whole.get(header..).unwrap_or_default() }, behind))
}

/// The content of the first box of a kind, if there is one.
fn child<'a>(bytes: &'a [u8], kind: &[u8; 4]) -> Found<Option<&'a [u8]>> {
    children(bytes).find_map(|found| found.map(|inner| inner.of(kind)).transpose()).transpose()
}

/// The same of a box that must be there.
fn needed<'a>(bytes: &'a [u8], kind: &[u8; 4]) -> Found<&'a [u8]> {
    let name = String::from_utf8_lossy(kind).into_owned();
    child(bytes, kind)?.ok_or_else(|| Fault::Malformed(format!("there is no box {name}")))
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(bytes.get(at..at.checked_add(2)?)?.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_be_bytes(bytes.get(at..at.checked_add(8)?)?.try_into().ok()?))
}

/// A number that must be there.
fn number(bytes: &[u8], at: usize) -> Found<u32> {
    u32_at(bytes, at).ok_or_else(|| Fault::Malformed("a box is cut".to_owned()))
}

/// The rows, of `width` bytes each, of a table whose count is at byte 4 of its box and whose rows follow it.
fn rows<'a>(table: &'a [u8], name: &str, width: usize) -> Found<impl Iterator<Item = &'a [u8]> + use<'a>> {
    let count = number(table, 4)? as usize;
    let rows = count.checked_mul(width).and_then(|bytes| table.get(8..)?.get(..bytes));
    let Some(rows) = rows else {
        return malformed(format!("the table {name} says {count} entries, more than it has"));
    };
    Ok(rows.chunks_exact(width))
}

/// A value for each of a run of pictures, from rows of a count and a value.
struct Runs<'a, I: Iterator<Item = &'a [u8]>> {
    rows: I,
    left: u32,
    value: u32,
}

impl<'a, I: Iterator<Item = &'a [u8]>> Runs<'a, I> {
    fn new(rows: I) -> Self {
        Self { rows, left: 0, value: 0 }
    }
}

impl<'a, I: Iterator<Item = &'a [u8]>> Iterator for Runs<'a, I> {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        while self.left == 0 {
            let row = self.rows.next()?;
            (self.left, self.value) = (u32_at(row, 0)?, u32_at(row, 4)?);
        }
        self.left -= 1;
        Some(self.value)
    }
}

/// A track with H.264 while its pictures are gathered.
struct Track {
    id: u32,
    movie: Movie,
    /// Where the time of decoding stands behind the last picture, ticks.
    clock: i64,
    /// The part that is shown, where the track tells one.
    edit: Option<Edit>,
}

/// A part of a track that is shown (8.6.6).
#[derive(Clone, Copy)]
struct Edit {
    /// When it is shown, ticks of the movie.
    at: u64,
    /// Where it begins, ticks of the track.
    start: i64,
    /// How long it is, ticks of the movie; 0 is to the end.
    duration: u64,
}

/// The one part of a track that is shown. Lists of several, which show parts again or in another order, count as none: all
/// is shown once.
fn edit(trak: &[u8]) -> Found<Option<Edit>> {
    let Some(edts) = child(trak, b"edts")? else { return Ok(None) };
    let Some(elst) = child(edts, b"elst")? else { return Ok(None) };
    let long = elst.first() == Some(&1);
    let cut = || Fault::Malformed("the table elst is cut".to_owned());
    let mut parts = rows(elst, "elst", if long { 20 } else { 12 })?.map(|row| {
        let (start, duration) = match long {
            true => (u64_at(row, 8).map(u64::cast_signed), u64_at(row, 0)),
            false => (u32_at(row, 4).map(|start| start.cast_signed().into()), u32_at(row, 0).map(u64::from)),
        };
        start.zip(duration).map(|(start, duration)| Edit { at: 0, start, duration }).ok_or_else(cut)
    });
    // One that begins at -1 shows nothing, for a while.
    let (mut shown, mut at) = (None, 0u64);
    while let Some(part) = parts.next().transpose()? {
        if part.start >= 0 && shown.replace(Edit { at, ..part }).is_some() {
            return Ok(None);
        }
        at = at.saturating_add(part.duration);
    }
    Ok(shown)
}

impl Track {
    /// A track, or the name of another codec of its pictures; `None` for what is no video.
    fn read(trak: &[u8], limits: &Limits, length: u64) -> Found<Result<Self, Option<String>>> {
        let mdia = needed(trak, b"mdia")?;
        let table = needed(needed(mdia, b"minf")?, b"stbl")?;
        let entries = needed(table, b"stsd")?.get(8..).unwrap_or_default();
        let Some(entry) = children(entries).next().transpose()? else {
            return malformed("a track says nothing of its codec");
        };
        if &entry.kind != b"avc1" {
            let handler = child(mdia, b"hdlr")?.and_then(|hdlr| hdlr.get(8..12));
            return Ok(Err(codec_name(&entry.kind, handler == Some(b"vide"))));
        }
        let (id, matrix) = track_header(needed(trak, b"tkhd")?)?;
        let mdhd = needed(mdia, b"mdhd")?;
        let timescale = number(mdhd, if mdhd.first() == Some(&1) { 20 } else { 12 })?;
        let size = |at: usize| {
            u16_at(entry.content, at).ok_or_else(|| Fault::Malformed("the entry avc1 is cut".to_owned()))
        };
        // What stands before the boxes of an entry of pictures (12.1.3).
        let boxes = entry.content.get(78..).unwrap_or_default();
        let avcc = needed(boxes, b"avcC")?;
        let pixel = match child(boxes, b"pasp")? {
            Some(pasp) => Some([number(pasp, 0)?, number(pasp, 4)?]),
            None => None,
        };
        let sets =
            ParameterSets::read(avcc).ok_or_else(|| Fault::Malformed("the box avcC is cut".to_owned()))?;
        let movie = Movie {
            width: size(24)?,
            height: size(26)?,
            timescale: timescale.max(1),
            matrix,
            pixel,
            length_size: sets.length_size,
            sequence_sets: sets.sequence,
            picture_sets: sets.picture,
            pictures: Vec::new(),
            start: 0.0,
            told: None,
            cut: None,
        };
        let mut track = Self { id, movie, clock: 0, edit: edit(trak)? };
        track.add_table(table, limits, length)?;
        Ok(Ok(track))
    }

    /// Adds a picture at the clock, which goes on by `duration`.
    fn add(&mut self, offset: u64, size: u64, shift: i64, duration: u32) {
        let time = self.clock.saturating_add(shift);
        self.movie.pictures.push(Picture { offset, size, time, shown: true });
        self.clock = self.clock.saturating_add(i64::from(duration));
    }

    /// The pictures of the table of samples (8.5 to 8.7).
    fn add_table(&mut self, table: &[u8], limits: &Limits, length: u64) -> Found<()> {
        let sizes = needed(table, b"stsz")?;
        let (fixed, count) = (number(sizes, 4)?, number(sizes, 8)?);
        limits.check(Limit::Pictures, f64::from(count)).map_err(Fault::Excess)?;
        let listed = sizes.get(12..).unwrap_or_default();
        if fixed == 0 && (count as usize).checked_mul(4).is_none_or(|bytes| bytes > listed.len()) {
            return malformed(format!("the table stsz says {count} entries, more than it has"));
        }
        if u64::from(fixed).saturating_mul(count.into()) > length {
            return Err(Fault::Truncated(format!("{count} pictures of {fixed} bytes lie beyond the end")));
        }
        let mut durations = Runs::new(rows(needed(table, b"stts")?, "stts", 8)?);
        let mut shifts = match child(table, b"ctts")? {
            Some(ctts) => Some(Runs::new(rows(ctts, "ctts", 8)?)),
            None => None,
        };
        let mut chunks = chunks(table)?;
        self.movie.pictures.reserve_exact(count as usize);
        let (mut left, mut at) = (0u32, 0u64);
        for picture in 0..count {
            while left == 0 {
                let few = || Fault::Malformed("chunks hold fewer pictures than there are".to_owned());
                (at, left) = chunks.next().ok_or_else(few)??;
            }
            let size = if fixed > 0 { fixed } else { number(listed, picture as usize * 4)? };
            let short =
                |name| Fault::Malformed(format!("the table {name} is of fewer pictures than there are"));
            let duration = durations.next().ok_or_else(|| short("stts"))?;
            let shift = match &mut shifts {
                Some(shifts) => i64::from(shifts.next().ok_or_else(|| short("ctts"))?.cast_signed()),
                None => 0,
            };
            self.add(at, size.into(), shift, duration);
            at = at.saturating_add(size.into());
            left -= 1;
        }
        Ok(())
    }

    /// The pictures of a fragment (8.8) that begins at byte `start` of the file.
    fn add_fragment(&mut self, moof: &[u8], start: u64, defaults: &[Defaults], limits: &Limits) -> Found<()> {
        let mut end = start;
        for traf in children(moof).filter_map(|found| found.map(|b| b.of(b"traf")).transpose()) {
            let traf = traf?;
            let header = FragmentHeader::read(needed(traf, b"tfhd")?, defaults)?;
            let base = header.base.unwrap_or(if header.from_moof { start } else { end });
            if header.id == self.id
                && let Some(tfdt) = child(traf, b"tfdt")?
            {
                let time =
                    if tfdt.first() == Some(&1) { u64_at(tfdt, 4) } else { u32_at(tfdt, 4).map(u64::from) };
                let time = time.ok_or_else(|| Fault::Malformed("the box tfdt is cut".to_owned()))?;
                self.clock = i64::try_from(time).unwrap_or(i64::MAX);
            }
            end = base;
            for run in children(traf).filter_map(|found| found.map(|b| b.of(b"trun")).transpose()) {
                end = self.add_run(run?, &header, base, end, limits)?;
            }
        }
        Ok(())
    }

    /// The pictures of a run (8.8.8), from byte `at` on where it does not say; where the run ends.
    fn add_run(
        &mut self,
        run: &[u8],
        header: &FragmentHeader,
        base: u64,
        at: u64,
        limits: &Limits,
    ) -> Found<u64> {
        let (flags, count) = (number(run, 0)?, number(run, 4)?);
        let mut place = 8;
        let mut next = |wanted: u32| -> Found<Option<u32>> {
            if flags & wanted == 0 {
                return Ok(None);
            }
            place += 4;
            number(run, place - 4).map(Some)
        };
        let mut at = match next(0x1)? {
            Some(offset) => base.saturating_add_signed(offset.cast_signed().into()),
            None => at,
        };
        next(0x4)?;
        let ours = header.id == self.id;
        let listed = flags & 0xf00 != 0;
        if !ours && !listed {
            return Ok(at.saturating_add(u64::from(header.size).saturating_mul(count.into())));
        }
        let all = self.movie.pictures.len().saturating_add(count as usize);
        limits.check_count(Limit::Pictures, all).map_err(Fault::Excess)?;
        for _ in 0..count {
            let duration = next(0x100)?.unwrap_or(header.duration);
            let size = next(0x200)?.unwrap_or(header.size);
            next(0x400)?;
            let shift = next(0x800)?.unwrap_or(0).cast_signed();
            if ours {
                self.add(at, size.into(), shift.into(), duration);
            }
            at = at.saturating_add(size.into());
        }
        Ok(at)
    }

    /// Pictures before and behind an edit are not shown. A movie has `timescale` ticks a second.
    fn hide_outside(&mut self, edit: Edit, timescale: u32) {
        let ticks = u128::from(edit.duration) * u128::from(self.movie.timescale);
        let ticks = ticks.div_ceil(u128::from(timescale));
        let end = match i64::try_from(ticks) {
            Ok(ticks @ 1..) => edit.start.saturating_add(ticks),
            _ => i64::MAX,
        };
        for picture in &mut self.movie.pictures {
            picture.shown = (edit.start..end).contains(&picture.time);
        }
    }

    /// Leaves out the pictures from the first one on that does not lie within the file, which is cut in the way told, or whose
    /// tables are damaged.
    fn keep_whole(&mut self, length: u64, cut: Option<String>) -> Found<()> {
        let pictures = &mut self.movie.pictures;
        let all = pictures.len();
        let whole = pictures.iter().take_while(|picture| picture.is_within(length)).count();
        if whole < all {
            let beyond = format!("frame {whole} of {all} lies beyond the end of the file");
            if whole == 0 {
                return Err(Fault::Truncated(cut.map_or(beyond.clone(), |cut| format!("{beyond}: {cut}"))));
            }
            self.movie.told = Some(pictures.iter().filter(|picture| picture.shown).count());
            pictures.truncate(whole);
            self.movie.cut = Some(cut.unwrap_or(beyond));
        } else {
            if let (true, Some(cut)) = (all == 0, &cut) {
                return Err(Fault::Truncated(cut.clone()));
            }
            self.movie.cut = cut;
        }
        Ok(())
    }

    /// The movie, of `timescale` ticks a second; the first of its pictures that is shown is at 0.
    fn finish(mut self, timescale: u32) -> Movie {
        let pictures = &mut self.movie.pictures;
        let shown = pictures.iter().filter(|picture| picture.shown);
        let first = shown.map(|picture| picture.time).min().unwrap_or(0);
        pictures.iter_mut().for_each(|picture| picture.time = picture.time.saturating_sub(first));
        let (at, from) = self.edit.map_or((0, 0), |edit| (edit.at, edit.start));
        let into = first.saturating_sub(from) as f64 / f64::from(self.movie.timescale);
        self.movie.start = at as f64 / f64::from(timescale) + into.max(0.0);
        self.movie
    }
}

/// Number and matrix of a track (8.3.2).
fn track_header(tkhd: &[u8]) -> Found<(u32, [i32; 4])> {
    let (id, matrix) = if tkhd.first() == Some(&1) { (20, 52) } else { (12, 40) };
    let entry = |at: usize| number(tkhd, matrix + at).map(u32::cast_signed);
    Ok((number(tkhd, id)?, [entry(0)?, entry(4)?, entry(12)?, entry(16)?]))
}

/// What people call a codec; `None` of what is no video.
fn codec_name(kind: &[u8; 4], is_video: bool) -> Option<String> {
    Some(match kind {
        b"hev1" | b"hvc1" => "HEVC (H.265)".to_owned(),
        b"av01" => "AV1".to_owned(),
        b"vp08" => "VP8".to_owned(),
        b"vp09" => "VP9".to_owned(),
        other if is_video => other.escape_ascii().to_string(),
        _ => return None,
    })
}

/// Where each chunk begins, and how many pictures it holds (8.7.4, 8.7.5).
fn chunks(table: &[u8]) -> Found<impl Iterator<Item = Found<(u64, u32)>> + '_> {
    let (places, name, width) = match (child(table, b"stco")?, child(table, b"co64")?) {
        (Some(places), _) => (places, "stco", 4),
        (None, Some(places)) => (places, "co64", 8),
        (None, None) => return malformed("there is neither a box stco nor co64"),
    };
    let places = rows(places, name, width)?;
    let mut runs = rows(needed(table, b"stsc")?, "stsc", 12)?.peekable();
    let mut held = None;
    Ok(places.zip(1u32..).map(move |(place, chunk)| {
        while let Some(run) = runs.next_if(|run| u32_at(run, 0).is_some_and(|first| first <= chunk)) {
            held = u32_at(run, 4);
        }
        let at = if width == 8 { u64_at(place, 0) } else { u32_at(place, 0).map(u64::from) };
        match at.zip(held) {
            Some(found) => Ok(found),
            None => malformed("the table stsc does not begin with the first chunk"),
        }
    }))
}

/// The box avcC (ISO/IEC 14496-15, 5.3.3.1).
struct ParameterSets {
    length_size: usize,
    sequence: Vec<Vec<u8>>,
    picture: Vec<Vec<u8>>,
}

impl ParameterSets {
    fn read(avcc: &[u8]) -> Option<Self> {
        let length_size = usize::from(avcc.get(4)? & 3) + 1;
        let mut at = 6;
        let sequence = sets(avcc, &mut at, avcc.get(5)? & 31)?;
        at += 1;
        let count = *avcc.get(at - 1)?;
        let picture = sets(avcc, &mut at, count)?;
        Some(Self { length_size, sequence, picture })
    }
}

/// So many NAL units with a length before each, from byte `at` on, which goes on behind them.
fn sets(avcc: &[u8], at: &mut usize, count: u8) -> Option<Vec<Vec<u8>>> {
    let mut set = || {
        let length = usize::from(u16_at(avcc, *at)?);
        let bytes = avcc.get(*at + 2..*at + 2 + length)?;
        *at += 2 + length;
        Some(bytes.to_vec())
    };
    (0..count).map(|_| set()).collect()
}

/// What holds for the pictures of a track in fragments that do not say otherwise (8.8.3).
struct Defaults {
    id: u32,
    duration: u32,
    size: u32,
}

fn fragment_defaults(moov: &[u8]) -> Found<Vec<Defaults>> {
    let Some(mvex) = child(moov, b"mvex")? else { return Ok(Vec::new()) };
    let of = |trex: &[u8]| {
        Ok(Defaults { id: number(trex, 4)?, duration: number(trex, 12)?, size: number(trex, 16)? })
    };
    let boxes = children(mvex).filter_map(|found| found.map(|b| b.of(b"trex")).transpose());
    boxes.map(|trex| of(trex?)).collect()
}

/// The box tfhd (8.8.7).
struct FragmentHeader {
    id: u32,
    base: Option<u64>,
    from_moof: bool,
    duration: u32,
    size: u32,
}

impl FragmentHeader {
    fn read(tfhd: &[u8], defaults: &[Defaults]) -> Found<Self> {
        let (flags, id) = (number(tfhd, 0)?, number(tfhd, 4)?);
        let mut at = 8;
        let mut field = |flag: u32, width: usize| -> Found<Option<u64>> {
            if flags & flag == 0 {
                return Ok(None);
            }
            at += width;
            let value = if width == 8 { u64_at(tfhd, at - 8) } else { u32_at(tfhd, at - 4).map(u64::from) };
            value.map(Some).ok_or_else(|| Fault::Malformed("the box tfhd is cut".to_owned()))
        };
        let base = field(0x1, 8)?;
        field(0x2, 4)?;
        let (duration, size) = (field(0x8, 4)?, field(0x10, 4)?);
        let told = defaults.iter().find(|defaults| defaults.id == id);
        let or = |value: Option<u64>, default: fn(&Defaults) -> u32| {
            value.and_then(|v| u32::try_from(v).ok()).or_else(|| told.map(default)).unwrap_or(0)
        };
        Ok(Self {
            id,
            base,
            from_moof: flags & 0x2_0000 != 0,
            duration: or(duration, |d| d.duration),
            size: or(size, |d| d.size),
        })
    }
}

#[cfg(test)]
mod tests;
