//! A stream taken out of an MP4 file.

use handcast_fba::syntax::{OBJECT_START, OLD_OBJECT_START};

use super::boxes::{Boxes, TAGS, VISUAL, u32_at, u64_at};
use super::{Mp4Error, malformed, shown};

/// The FBA stream of the first track that holds one; `None` where none does, or the bytes are no MP4 file.
///
/// # Errors
/// [`Mp4Error`] for a track with such a stream whose table of samples is damaged.
pub fn stream_in(file: &[u8]) -> Result<Option<Vec<u8>>, Mp4Error> {
    if !super::is_mp4(file) {
        return Ok(None);
    }
    let Some(moov) = Boxes::new(file).find(b"moov")? else { return Ok(None) };
    for track in Boxes::new(moov.content) {
        let track = track?;
        if &track.kind != b"trak" {
            continue;
        }
        if let Some(stream) = stream_of(track.content, file)? {
            return Ok(Some(stream));
        }
    }
    Ok(None)
}

/// Seconds from the beginning of an MP4 file to that of its stream, by the edit list of the track (8.6.6) and the times of its
/// samples; 0 of any other file, and where they cannot be read.
pub fn starts_at(file: &[u8]) -> f64 {
    starts(file, |track| matches!(fba_in(track), Ok(Some(_))))
}

/// Seconds from the beginning of an MP4 file to its first pictures, likewise.
pub fn pictures_start_at(file: &[u8]) -> f64 {
    starts(file, is_of_pictures)
}

/// Seconds from the beginning of an MP4 file to the end of its first pictures, as the track says (8.3.2); none where it does not,
/// and of any other file.
pub fn pictures_end_at(file: &[u8]) -> Option<f64> {
    let (track, scale) = first_track(file, is_of_pictures)?;
    let head = path(track, &[b"tkhd"]).ok().flatten()?;
    let ticks = match head.first() {
        Some(1) => u64_at(head, 28).filter(|&ticks| ticks != u64::MAX)?,
        _ => u32_at(head, 20).filter(|&ticks| ticks != u32::MAX)?.into(),
    };
    // Without an edit list it is how long the pictures are shown.
    let before = if shown::is_edited(track) { 0.0 } else { shown::begins(track, scale) };
    (ticks > 0).then(|| before + ticks as f64 / f64::from(scale))
}

/// Whether a track shows pictures.
fn is_of_pictures(track: &[u8]) -> bool {
    let handler = path(track, &[b"mdia", b"hdlr"]).ok().flatten();
    handler.and_then(|handler| handler.get(8..12)) == Some(b"vide")
}

/// Ticks a second, as the header of a movie or of a track's media says.
pub fn time_scale(header: &[u8]) -> Option<u32> {
    u32_at(header, if header.first() == Some(&1) { 20 } else { 12 }).filter(|&scale| scale > 0)
}

/// The first track of an MP4 file that is `wanted`, and the ticks a second of the movie.
fn first_track(file: &[u8], wanted: impl Fn(&[u8]) -> bool) -> Option<(&[u8], u32)> {
    let moov = Boxes::new(file).find(b"moov").ok().flatten().filter(|_| super::is_mp4(file))?;
    let mut tracks = Boxes::new(moov.content).flatten().filter(|found| &found.kind == b"trak");
    let track = tracks.find(|track| wanted(track.content))?;
    Some((track.content, time_scale(path(moov.content, &[b"mvhd"]).ok()??)?))
}

/// Seconds before the first of the tracks that are `wanted` shows anything.
fn starts(file: &[u8], wanted: impl Fn(&[u8]) -> bool) -> f64 {
    first_track(file, wanted).map_or(0.0, |(track, scale)| shown::begins(track, scale))
}

/// Whether a file is an MP4 file whose only track is an FBA stream.
pub fn is_stream_alone(file: &[u8]) -> bool {
    let tracks = |moov: &[u8]| Boxes::new(moov).flatten().filter(|found| &found.kind == b"trak").count();
    let moov = Boxes::new(file).find(b"moov").ok().flatten();
    moov.is_some_and(|moov| tracks(moov.content) == 1) && matches!(stream_in(file), Ok(Some(_)))
}

/// The content of a box along a path.
pub fn path<'a>(bytes: &'a [u8], kinds: &[&[u8; 4]]) -> Result<Option<&'a [u8]>, Mp4Error> {
    let mut here = bytes;
    for kind in kinds {
        let Some(found) = Boxes::new(here).find(kind)? else { return Ok(None) };
        here = found.content;
    }
    Ok(Some(here))
}

/// The stream of a track, if it is one of FBA.
fn stream_of(track: &[u8], file: &[u8]) -> Result<Option<Vec<u8>>, Mp4Error> {
    let Some(found) = fba_in(track)? else { return Ok(None) };
    let mut stream = found.header.to_vec();
    samples(found.table, file, &mut stream)?;
    Ok(Some(stream))
}

/// A track of FBA.
struct Fba<'a> {
    /// The tables of its samples.
    table: &'a [u8],
    /// What stands before the first of them.
    header: &'a [u8],
}

/// A track, if it is one of FBA.
fn fba_in(track: &[u8]) -> Result<Option<Fba<'_>>, Mp4Error> {
    let Some(table) = path(track, &[b"mdia", b"minf", b"stbl"])? else { return Ok(None) };
    let Some(entries) = Boxes::new(table).find(b"stsd")? else { return Ok(None) };
    let Some(entry) = Boxes::new(entries.content.get(8..).unwrap_or_default()).find(b"mp4v")? else {
        return Ok(None);
    };
    // What stands before the boxes of an entry of pictures.
    let Some(esds) = Boxes::new(entry.content.get(78..).unwrap_or_default()).find(b"esds")? else {
        return Ok(None);
    };
    let Some(header) = specific_info(esds.content.get(4..).unwrap_or_default()) else { return Ok(None) };
    // Headers of pictures have no object start code of FBA.
    let is_fba = header.windows(4).any(|window| window == OBJECT_START.to_be_bytes());
    if !is_fba && header != OLD_OBJECT_START.to_be_bytes() {
        return Ok(None);
    }
    Ok(Some(Fba { table, header }))
}

/// What a decoder is told, of a stream of MPEG-4 visual.
fn specific_info(bytes: &[u8]) -> Option<&[u8]> {
    let (stream, _) = descriptor(bytes, TAGS[0])?;
    let flags = *stream.get(2)?;
    let depends = if flags & 0x80 != 0 { 2 } else { 0 };
    let url = if flags & 0x40 != 0 { 1 + usize::from(*stream.get(3 + depends)?) } else { 0 };
    let clock = if flags & 0x20 != 0 { 2 } else { 0 };
    let (decoder, _) = descriptor(stream.get(3 + depends + url + clock..)?, TAGS[1])?;
    if decoder.first() != VISUAL.first() {
        return None;
    }
    descriptor(decoder.get(13..)?, TAGS[2]).map(|(info, _)| info)
}

/// The content of the descriptor with this tag, which stands first, and what follows.
fn descriptor(bytes: &[u8], tag: u8) -> Option<(&[u8], &[u8])> {
    let (&found, mut rest) = bytes.split_first()?;
    let mut length = 0usize;
    for _ in 0..4 {
        let (&byte, behind) = rest.split_first()?;
        rest = behind;
        length = length << 7 | usize::from(byte & 0x7f);
        if byte & 0x80 == 0 {
            break;
        }
    }
    (found == tag).then_some(rest.split_at_checked(length)?)
}

/// Appends all samples of a track.
fn samples(table: &[u8], file: &[u8], out: &mut Vec<u8>) -> Result<(), Mp4Error> {
    let content = |kind: &[u8; 4]| -> Result<Option<&[u8]>, Mp4Error> {
        Ok(Boxes::new(table).find(kind)?.and_then(|found| found.content.get(4..)))
    };
    let missing = || malformed("the track of the stream has no table of samples");
    let sizes = content(b"stsz")?.ok_or_else(missing)?;
    let runs = content(b"stsc")?.ok_or_else(missing)?;
    let (chunks, wide) = match (content(b"stco")?, content(b"co64")?) {
        (Some(chunks), _) => (chunks, false),
        (_, Some(chunks)) => (chunks, true),
        _ => return Err(missing()),
    };
    let number =
        |bytes: &[u8], at: usize| u32_at(bytes, at).ok_or_else(|| malformed("a table of samples is cut"));
    let (fixed, count) = (number(sizes, 0)?, number(sizes, 4)?);
    let mut sample = 0u32;
    for chunk in 0..number(chunks, 0)? {
        let place = 4 + chunk as usize * if wide { 8 } else { 4 };
        let offset = if wide { u64_at(chunks, place) } else { u32_at(chunks, place).map(u64::from) };
        let mut at = offset.ok_or_else(|| malformed("a table of samples is cut"))?;
        for _ in 0..samples_in(runs, chunk)? {
            if sample == count {
                return Ok(());
            }
            let length = if fixed > 0 { fixed } else { number(sizes, 8 + sample as usize * 4)? };
            let lies = usize::try_from(at).ok().and_then(|at| file.get(at..)?.get(..length as usize));
            let outside = || malformed(format!("sample {} lies outside of the file", sample + 1));
            out.extend_from_slice(lies.ok_or_else(outside)?);
            if out.len() > file.len() {
                return Err(malformed("samples of the stream lie over one another"));
            }
            at += u64::from(length);
            sample += 1;
        }
    }
    if sample == count { Ok(()) } else { Err(malformed("chunks hold fewer samples than there are")) }
}

/// Samples in a chunk, counted from 0: the last run that begins before it says.
fn samples_in(runs: &[u8], chunk: u32) -> Result<u32, Mp4Error> {
    let cut = || malformed("a table of samples is cut");
    let count = u32_at(runs, 0).ok_or_else(cut)? as usize;
    let entries = runs.get(4..).and_then(|rest| rest.get(..count.checked_mul(12)?)).ok_or_else(cut)?;
    let begins = |at: usize| u32_at(entries, at * 12).unwrap_or(0);
    // Runs are in order.
    let (mut low, mut high) = (0, count);
    while low < high {
        let middle = usize::midpoint(low, high);
        if begins(middle) <= chunk + 1 { low = middle + 1 } else { high = middle }
    }
    let run = low.checked_sub(1).ok_or_else(cut)?;
    u32_at(entries, run * 12 + 4).ok_or_else(cut)
}
