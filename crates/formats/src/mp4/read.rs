//! A stream taken out of an MP4 file.

use handcast_fba::syntax::{OBJECT_START, OLD_OBJECT_START};
use handcast_iso::{
    Found, Places, all, behind_dates, child, entry_boxes, is_of_pictures, outermost, path, u32_at, u64_at,
};

use super::boxes::{TAGS, VISUAL};
use super::{Mp4Error, malformed, shown};

/// The FBA stream of the first track that holds one; `None` where none does, or the bytes are no MP4 file.
///
/// # Errors
/// [`Mp4Error`] for a track with such a stream whose table of samples is damaged.
pub fn stream_in(file: &[u8]) -> Result<Option<Vec<u8>>, Mp4Error> {
    if !super::is_mp4(file) {
        return Ok(None);
    }
    let Some(moov) = movie(file)? else { return Ok(None) };
    for track in all(moov, b"trak") {
        if let Some(stream) = stream_of(track?, file)? {
            return Ok(Some(stream));
        }
    }
    Ok(None)
}

/// What is in the first box `moov` of a file.
fn movie(file: &[u8]) -> Found<Option<&[u8]>> {
    outermost(file).find_map(|found| found.map(|outer| outer.of(b"moov")).transpose()).transpose()
}

/// Seconds from the beginning of an MP4 file to that of its stream, by the edit list of the track (8.6.6) and the times of its
/// samples; 0 of any other file, and where they cannot be read.
pub fn starts_at(file: &[u8]) -> f64 {
    starts(file, |track| matches!(fba_in(track), Ok(Some(_))))
}

/// Seconds from the beginning of an MP4 file to its first pictures, likewise.
pub fn pictures_start_at(file: &[u8]) -> f64 {
    starts(file, shows_pictures)
}

/// Seconds from the beginning of an MP4 file to the end of its first pictures, as the track says (8.3.2); none where it does not,
/// and of any other file.
pub fn pictures_end_at(file: &[u8]) -> Option<f64> {
    let (track, scale) = first_track(file, shows_pictures)?;
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
fn shows_pictures(track: &[u8]) -> bool {
    child(track, b"mdia").ok().flatten().is_some_and(|mdia| is_of_pictures(mdia) == Ok(true))
}

/// The first track of an MP4 file that is `wanted`, and the ticks a second of the movie.
fn first_track(file: &[u8], wanted: impl Fn(&[u8]) -> bool) -> Option<(&[u8], u32)> {
    let moov = movie(file).ok().flatten().filter(|_| super::is_mp4(file))?;
    let track = all(moov, b"trak").flatten().find(|track| wanted(track))?;
    let scale = behind_dates(child(moov, b"mvhd").ok().flatten()?).ok()?;
    (scale > 0).then_some((track, scale))
}

/// Seconds before the first of the tracks that are `wanted` shows anything.
fn starts(file: &[u8], wanted: impl Fn(&[u8]) -> bool) -> f64 {
    first_track(file, wanted).map_or(0.0, |(track, scale)| shown::begins(track, scale))
}

/// Whether a file is an MP4 file whose only track is an FBA stream.
pub fn is_stream_alone(file: &[u8]) -> bool {
    let moov = movie(file).ok().flatten();
    moov.is_some_and(|moov| all(moov, b"trak").flatten().count() == 1)
        && matches!(stream_in(file), Ok(Some(_)))
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
    let entries = child(table, b"stsd")?.and_then(|entries| entries.get(8..)).unwrap_or_default();
    let Some(entry) = child(entries, b"mp4v")? else { return Ok(None) };
    let Some(esds) = child(entry_boxes(entry), b"esds")? else { return Ok(None) };
    let Some(header) = specific_info(esds.get(4..).unwrap_or_default()) else { return Ok(None) };
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
    for (number, place) in Places::of(table)?.enumerate() {
        let (at, length) = place?;
        let lies = usize::try_from(at).ok().and_then(|at| file.get(at..)?.get(..length as usize));
        let outside = || malformed(format!("sample {} lies outside of the file", number + 1));
        out.extend_from_slice(lies.ok_or_else(outside)?);
        if out.len() > file.len() {
            return Err(malformed("samples of the stream lie over one another"));
        }
    }
    Ok(())
}
