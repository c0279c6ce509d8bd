//! The tables of an MP4 or MOV file (ISO/IEC 14496-12): where each compressed picture lies, and when it is shown.
//!
//! Boxes and tables are those of [`handcast_iso`]; here it is checked that pictures lie within the file.

use std::io::{self, Read, Seek, SeekFrom};

use handcast_iso::{
    Damage, Edit, Head, Places, Runs, all, behind_dates, child, children, edit, entry_boxes, is_of_pictures,
    needed, number, u16_at, u32_at, u64_at,
};
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

impl From<Damage> for Fault {
    fn from(Damage(what): Damage) -> Self {
        Self::Malformed(what)
    }
}

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
    for trak in all(&moov, b"trak") {
        let trak = match trak {
            Ok(trak) => trak,
            // What is wrong behind a track of pictures is of no matter.
            Err(_) if other.is_some() => break,
            Err(damage) => return Err(cut.map_or(damage.into(), Fault::Truncated)),
        };
        match Track::read(trak, limits, length)? {
            Ok(track) => {
                chosen = Some(track);
                break;
            }
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
        true => behind_dates(needed(&moov, b"mvhd")?)?.max(1),
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
        let Some(head) = Head::read(&head) else { break };
        let size = head.size.unwrap_or(length - at);
        if size < head.header as u64 {
            return malformed(format!("the box at byte {at} says it has {size} bytes"));
        }
        if size > length - at {
            let left = length - at;
            if &head.kind == b"moov" {
                take(&head.kind, at, left);
            }
            let kind = head.name();
            return Ok(Some(format!("the box {kind} at byte {at} says {size} bytes; {left} are left")));
        }
        take(&head.kind, at, size);
        at += size;
        // What has been read ahead stays: small boxes are many.
        let behind = size.cast_signed().saturating_sub(wanted as i64);
        file.seek_relative(behind).map_err(Fault::Io)?;
    }
    Ok(None)
}

/// Most bytes of an outermost box that is read as a whole: tables of some days of pictures.
const MOST_TABLES: u64 = 256 << 20;

/// What is in an outermost box.
fn content(file: &mut (impl Read + Seek), (at, size): (u64, u64)) -> Found<Vec<u8>> {
    if size > MOST_TABLES {
        let what = format!("the box at byte {at} has {size} bytes of tables, allowed are {MOST_TABLES}");
        return Err(Fault::Malformed(what));
    }
    file.seek(SeekFrom::Start(at)).map_err(Fault::Io)?;
    let mut whole = Vec::new();
    whole.try_reserve_exact(usize::try_from(size).unwrap_or(usize::MAX)).map_err(|_| {
        Fault::Malformed(format!("the box at byte {at} has {size} bytes, more than there is memory"))
    })?;
    file.take(size).read_to_end(&mut whole).map_err(Fault::Io)?;
    let header = Head::read(&whole).map_or(whole.len(), |head| head.header);
    whole.drain(..header.min(whole.len()));
    Ok(whole)
}

/// A track with H.264 while its pictures are gathered.
struct Track {
    id: u32,
    movie: Movie,
    /// Where the time of decoding stands behind the last picture, ticks.
    clock: i64,
    /// The part that is shown, where the track tells one. Lists of several, which show parts again or in another order, count as
    /// none: all is shown once.
    edit: Option<Edit>,
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
            return Ok(Err(codec_name(&entry.kind, is_of_pictures(mdia)?)));
        }
        let (id, matrix) = track_header(needed(trak, b"tkhd")?)?;
        let timescale = behind_dates(needed(mdia, b"mdhd")?)?;
        let size = |at: usize| {
            u16_at(entry.content, at).ok_or_else(|| Fault::Malformed("the entry avc1 is cut".to_owned()))
        };
        let boxes = entry_boxes(entry.content);
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
        let mut track = Self { id, movie, clock: 0, edit: edit(trak)?.filter(|edit| edit.parts == 1) };
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
        let places = Places::of(table)?;
        let count = places.samples();
        limits.check(Limit::Pictures, f64::from(count)).map_err(Fault::Excess)?;
        if places.least() > length {
            let least = places.least();
            return Err(Fault::Truncated(format!(
                "{count} pictures of {least} bytes together lie beyond the end"
            )));
        }
        let mut durations = Runs::of(needed(table, b"stts")?, "stts")?;
        let mut shifts = child(table, b"ctts")?.map(|ctts| Runs::of(ctts, "ctts")).transpose()?;
        self.movie.pictures.reserve_exact(count as usize);
        for place in places {
            let (at, size) = place?;
            let short =
                |name| Fault::Malformed(format!("the table {name} is of fewer pictures than there are"));
            let duration = durations.next().ok_or_else(|| short("stts"))?;
            let shift = match &mut shifts {
                Some(shifts) => i64::from(shifts.next().ok_or_else(|| short("ctts"))?.cast_signed()),
                None => 0,
            };
            self.add(at, size.into(), shift, duration);
        }
        Ok(())
    }

    /// The pictures of a fragment (8.8) that begins at byte `start` of the file.
    fn add_fragment(&mut self, moof: &[u8], start: u64, defaults: &[Defaults], limits: &Limits) -> Found<()> {
        let mut end = start;
        for traf in all(moof, b"traf") {
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
            for run in all(traf, b"trun") {
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
            Ok(Some(number(run, place - 4)?))
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
        let times = edit.shown(self.movie.timescale, timescale);
        for picture in &mut self.movie.pictures {
            picture.shown = times.contains(&picture.time);
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
    let matrix = if tkhd.first() == Some(&1) { 52 } else { 40 };
    let entry = |at: usize| number(tkhd, matrix + at).map(u32::cast_signed);
    Ok((behind_dates(tkhd)?, [entry(0)?, entry(4)?, entry(12)?, entry(16)?]))
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
    all(mvex, b"trex").map(|trex| of(trex?)).collect()
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
