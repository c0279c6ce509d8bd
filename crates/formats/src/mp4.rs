//! FBA streams in MP4 files (ISO/IEC 14496-12 and -14): a track of MPEG-4 visual, `mp4v` with `esds`, object type 0x20.
//!
//! What stands before the first plane, sequence header, user data and object start code, is the track's
//! DecoderSpecificInfo; each plane is a sample, I planes behind a start code are sync samples. Planes do not end with bytes: a sample has the
//! bytes that its plane completes, and a start code begins one. Put together, DecoderSpecificInfo and samples are the stream
//! to the byte. Own boxes, because muxers at hand write tracks of pictures only.
//!
//! ```
//! use handcast_formats::mp4::{MuxOptions, mux, stream_in};
//!
//! let stream = handcast_fba::example_stream();
//! let file = mux(stream, &MuxOptions::default())?;
//! assert_eq!(stream_in(&file)?.as_deref(), Some(stream));
//! # Ok::<(), handcast_formats::mp4::Mp4Error>(())
//! ```

mod boxes;
mod clip;
mod read;
mod shown;

use std::borrow::Cow;

use handcast_fba::inspect::Inspector;
use handcast_fba::{DecoderOptions, FrameRate, PlaneKind, SyntaxError};
use handcast_iso::Damage;
use thiserror::Error;

use boxes::Out;
pub use read::{is_stream_alone, pictures_end_at, pictures_start_at, starts_at, stream_in};

/// Most bytes of an MP4 file that may be a stream and no clip, as is taken for granted of larger ones: a day of a stream
/// has fewer.
pub const STREAM_ALONE_BYTES: u64 = 1 << 25;

/// How a stream is put into a file.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct MuxOptions {
    /// How the stream is read, to find its planes.
    pub decoder: DecoderOptions,
    /// Seconds at which the stream begins; beside a clip, from its first picture on.
    pub start: f64,
    /// An MP4 file whose tracks come along, untouched.
    pub clip: Option<Vec<u8>>,
}

impl MuxOptions {
    /// Sets how the stream is read.
    #[must_use]
    pub fn with_decoder(self, decoder: DecoderOptions) -> Self {
        Self { decoder, ..self }
    }

    /// Sets the seconds at which the stream begins, 0 or more; beside a clip, from its first picture on.
    #[must_use]
    pub fn with_start(self, start: f64) -> Self {
        Self { start, ..self }
    }

    /// Sets the file whose tracks come along.
    #[must_use]
    pub fn with_clip(self, clip: Option<Vec<u8>>) -> Self {
        Self { clip, ..self }
    }
}

/// Why a stream could not be put into an MP4 file, or be taken out.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Mp4Error {
    /// The stream is damaged.
    #[error(transparent)]
    Stream(#[from] SyntaxError),
    /// The stream has no plane.
    #[error("mp4: the stream holds no object plane")]
    Empty,
    /// Boxes are damaged or missing.
    #[error("mp4: {what}")]
    Malformed {
        /// What is wrong and where.
        what: String,
    },
    /// The file is of a kind that is not done.
    #[error("mp4: {what} not supported")]
    Unsupported {
        /// What.
        what: &'static str,
    },
}

impl From<Damage> for Mp4Error {
    fn from(Damage(what): Damage) -> Self {
        Self::Malformed { what }
    }
}

pub(crate) fn malformed(what: impl Into<String>) -> Mp4Error {
    Mp4Error::Malformed { what: what.into() }
}

/// The stream of a file: `bytes` themselves unless they are an MP4 file with a stream.
///
/// # Errors
/// [`Mp4Error`] of an MP4 file with a damaged track, or none.
pub fn unwrapped(bytes: &[u8]) -> Result<Cow<'_, [u8]>, Mp4Error> {
    if !is_mp4(bytes) {
        return Ok(Cow::Borrowed(bytes));
    }
    let none = || malformed("the file has no track with an FBA stream");
    stream_in(bytes)?.map(Cow::Owned).ok_or_else(none)
}

/// Whether a file begins as MP4 files do.
pub fn is_mp4(bytes: &[u8]) -> bool {
    bytes.get(4..8) == Some(b"ftyp")
}

/// The samples of a stream.
struct Samples {
    /// Bytes before the first.
    header: usize,
    /// Length in bytes, duration in ticks, whether a reader may begin with it.
    list: Vec<(u32, u32, bool)>,
    /// Ticks a second.
    timescale: u32,
}

/// Cuts a stream into samples.
fn samples(stream: &[u8], options: DecoderOptions) -> Result<Samples, Mp4Error> {
    let mut inspector = Inspector::new(stream, options);
    let mut planes: Vec<(u64, u64, f64, bool)> = Vec::new();
    let mut skipped = 0;
    for plane in inspector.by_ref() {
        let frame = plane?.frame;
        if frame.object_mask == 0 {
            // Filler goes with the plane before it.
            if let Some(last) = planes.last_mut() {
                last.1 = frame.end_bit;
            }
            continue;
        }
        // An I plane that says all a reader needs has a start code before it, or is the first.
        let end = planes.last().map(|plane| plane.1);
        let sync = frame.kind == PlaneKind::Intra && end.is_none_or(|end| frame.first_bit >= end + 32);
        planes.push((frame.first_bit, frame.end_bit, frame.time, sync));
        skipped = frame.skipped;
    }
    let rate = inspector.decoder().rate();
    let (timescale, tick) = ticks(rate);
    let &(first, ..) = planes.first().ok_or(Mp4Error::Empty)?;
    let header = first / 8;
    let mut list = Vec::with_capacity(planes.len());
    let mut at = header;
    for (number, &(_, end, time, intra)) in planes.iter().enumerate() {
        let next = planes.get(number + 1);
        let stop = match next {
            None => stream.len() as u64,
            // Between planes there is nothing, or stuffing and a start code.
            Some(&(first, ..)) if first >= end + 32 => end / 8 + 1,
            Some(_) => end / 8,
        };
        let seconds = next.map_or(0.0, |next| next.2 - time);
        let duration = (seconds * f64::from(timescale)).round().clamp(0.0, u32::MAX.into()) as u32;
        // The last plane stands for the frames skipped after it, too.
        let last = tick.saturating_mul(skipped.saturating_add(1));
        list.push(((stop - at) as u32, if next.is_some() { duration } else { last }, intra));
        at = stop;
    }
    Ok(Samples { header: header as usize, list, timescale })
}

/// Ticks a second, and of a frame.
fn ticks(rate: FrameRate) -> (u32, u32) {
    let sixteenths = u32::from(rate.whole) * 16 + u32::from(rate.sixteenths);
    (sixteenths.max(1) * 1000, if rate.offset { 16_016 } else { 16_000 })
}

/// Puts a stream into an MP4 file, beside the tracks of [`MuxOptions::clip`] if one is given.
///
/// # Errors
/// [`Mp4Error::Stream`] and [`Mp4Error::Empty`] of the stream; the others of the clip.
pub fn mux(stream: &[u8], options: &MuxOptions) -> Result<Vec<u8>, Mp4Error> {
    let samples = samples(stream, options.decoder)?;
    let clip = options.clip.as_deref().map(clip::Clip::parse).transpose()?;
    let scale = clip.as_ref().map_or(samples.timescale, |clip| clip.timescale);
    let id = clip.as_ref().map_or(1, |clip| clip.next_track);
    let start = options.start + options.clip.as_deref().map_or(0.0, read::pictures_start_at);
    let (head, media) = stream.split_at(samples.header);
    let mut file = Out::default();
    file.of(b"ftyp", |out| {
        out.bytes(b"isom");
        out.u32(0x200);
        [b"isom", b"iso2", b"avc1", b"mp41", b"mp42"].into_iter().for_each(|brand| out.bytes(brand));
    });
    // Offsets do not change the length of what holds them.
    let moov = |at: u64| -> Result<Vec<u8>, Mp4Error> {
        let kept = clip.as_ref().map_or(0, clip::Clip::media_length);
        let track = track(&samples, head, (id, scale), start, at + kept + MDAT_HEADER);
        let duration = seconds(&samples, start) * f64::from(scale);
        let mut out = Out::default();
        match &clip {
            Some(clip) => clip.moov(&mut out, at, duration as u64, &track)?,
            None => out.of(b"moov", |out| {
                boxes::mvhd(out, scale, duration as u64, id + 1);
                out.bytes(&track);
            }),
        }
        Ok(out.into_bytes())
    };
    let before = file.len();
    let length = moov(0)?.len() as u64;
    file.bytes(&moov(before + length)?);
    if let Some(clip) = &clip {
        clip.media(&mut file);
    }
    // A length of 64 bits, always.
    file.u32(1);
    file.bytes(b"mdat");
    file.u64(MDAT_HEADER + media.len() as u64);
    file.bytes(media);
    Ok(file.into_bytes())
}

/// Bytes of a media box before its content.
const MDAT_HEADER: u64 = 16;

/// Seconds to the end of the last sample.
fn seconds(samples: &Samples, start: f64) -> f64 {
    let ticks: u64 = samples.list.iter().map(|sample| u64::from(sample.1)).sum();
    start.max(0.0) + ticks as f64 / f64::from(samples.timescale)
}

/// The track of a stream whose samples begin at byte `at` of the file; `scale`: ticks a second of the movie.
fn track(samples: &Samples, header: &[u8], (id, scale): (u32, u32), start: f64, at: u64) -> Vec<u8> {
    let ticks: u64 = samples.list.iter().map(|sample| u64::from(sample.1)).sum();
    let movie = |seconds: f64| (seconds * f64::from(scale)).round() as u64;
    let length = movie(seconds(samples, 0.0));
    let mut out = Out::default();
    out.of(b"trak", |out| {
        boxes::tkhd(out, id, length.saturating_add(movie(start)));
        if start > 0.0 {
            out.of(b"edts", |out| {
                let long = boxes::is_long(length) || boxes::is_long(movie(start));
                out.full(b"elst", boxes::version_of(long), |out| {
                    out.u32(2);
                    // Nothing (-1) at first, then all of it.
                    for (duration, from) in [(movie(start), u64::MAX), (length, 0)] {
                        out.time(duration, long);
                        out.time(from, long);
                        out.u32(1 << 16);
                    }
                });
            });
        }
        out.of(b"mdia", |out| {
            boxes::mdhd(out, samples.timescale, ticks);
            boxes::hdlr(out, b"vide", "FBA stream");
            out.of(b"minf", |out| {
                out.full(b"vmhd", 1, |out| out.zeros(8));
                boxes::dinf(out);
                out.of(b"stbl", |out| sample_table(out, samples, header, at));
            });
        });
    });
    out.into_bytes()
}

fn sample_table(out: &mut Out, samples: &Samples, header: &[u8], at: u64) {
    let longest = samples.list.iter().map(|sample| sample.0).max().unwrap_or(0);
    let bits = 8.0 * samples.list.iter().map(|sample| f64::from(sample.0)).sum::<f64>();
    let rate = (bits / seconds(samples, 0.0).max(1e-3)) as u32;
    out.full(b"stsd", 0, |out| {
        out.u32(1);
        boxes::mp4v(out, header, longest, rate);
    });
    out.full(b"stts", 0, |out| {
        let runs: Vec<_> = samples.list.chunk_by(|a, b| a.1 == b.1).collect();
        out.u32(runs.len() as u32);
        for run in runs {
            out.u32(run.len() as u32);
            out.u32(run[0].1);
        }
    });
    out.full(b"stss", 0, |out| {
        let sync = samples.list.iter().enumerate().filter(|(_, sample)| sample.2);
        let numbers: Vec<u32> = sync.map(|(number, _)| number as u32 + 1).collect();
        out.u32(numbers.len() as u32);
        numbers.into_iter().for_each(|number| out.u32(number));
    });
    out.full(b"stsc", 0, |out| [1, 1, samples.list.len() as u32, 1].into_iter().for_each(|v| out.u32(v)));
    out.full(b"stsz", 0, |out| {
        out.u32(0);
        out.u32(samples.list.len() as u32);
        samples.list.iter().for_each(|sample| out.u32(sample.0));
    });
    out.full(b"co64", 0, |out| {
        out.u32(1);
        out.u64(at);
    });
}

#[cfg(test)]
mod tests;
