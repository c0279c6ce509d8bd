//! AVI files of JPEG pictures.

use std::fs::File;
use std::io::{self, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};

use super::{ClipInfo, Frame, FrameError, FrameSource, OpenOptions, animation, check_size};
use handcast_limits::Limits;
use handcast_picture::Shrinker;

/// Largest compressed picture accepted, in bytes.
const MAX_CHUNK: u32 = 1 << 26;
/// Deepest nesting of lists looked into.
const MAX_DEPTH: usize = 4;

/// Frames of an AVI file with Motion JPEG, read forwards.
pub(super) struct MjpegSource {
    name: String,
    reader: BufReader<File>,
    length: u64,
    info: ClipInfo,
    period: f64,
    stream: u32,
    /// End of the list of pictures.
    end: u64,
    shrinker: Shrinker,
    limits: Limits,
    chunk: Vec<u8>,
    index: usize,
    /// Pictures so far, those included that are shown once more.
    tick: usize,
}

/// What the headers say.
#[derive(Default)]
struct Headers {
    frames: Option<u32>,
    micros: u32,
    streams: u32,
    /// Number, codec, scale and rate of the first video stream.
    video: Option<(u32, [u8; 4], u32, u32)>,
    size: Option<(u32, u32)>,
    compression: [u8; 4],
    movi: Option<(u64, u64)>,
}

impl MjpegSource {
    pub(super) fn open(path: &Path, name: &str, options: &OpenOptions) -> Result<Self, FrameError> {
        let io = |source| FrameError::Io { path: name.to_owned(), source };
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut reader = BufReader::new(file);
        let mut headers = Headers::default();
        walk(&mut reader, 12, length, 0, &mut headers).map_err(|source| match source.kind() {
            io::ErrorKind::UnexpectedEof => {
                FrameError::Truncated { path: name.to_owned(), what: "the AVI headers are cut".to_owned() }
            }
            _ => io(source),
        })?;
        let malformed = |what: &str| FrameError::Malformed { path: name.to_owned(), what: what.to_owned() };
        let Some((stream, handler, scale, rate)) = headers.video else {
            return Err(malformed("the AVI file has no video stream"));
        };
        let codec = if headers.compression == [0; 4] { handler } else { headers.compression };
        if !codec.eq_ignore_ascii_case(b"MJPG") {
            let printable: String =
                codec.iter().map(|&b| if b.is_ascii_graphic() { b as char } else { '?' }).collect();
            return Err(FrameError::UnsupportedCodec {
                path: name.to_owned(),
                codec: format!("AVI with codec {printable}"),
                hint: String::new(),
            });
        }
        let Some((start, end)) = headers.movi else {
            return Err(FrameError::Truncated {
                path: name.to_owned(),
                what: "the AVI file has no list of pictures".to_owned(),
            });
        };
        let (width, height) = headers.size.ok_or_else(|| malformed("the AVI stream has no picture size"))?;
        let (width, height) = check_size(name, u64::from(width), u64::from(height), &options.limits)?;
        let period = match (scale, rate, headers.micros) {
            (1.., 1.., _) => f64::from(scale) / f64::from(rate),
            (_, _, 1..) => f64::from(headers.micros) * 1e-6,
            _ => 1.0 / options.rate,
        };
        reader.seek(SeekFrom::Start(start)).map_err(io)?;
        Ok(Self {
            name: name.to_owned(),
            reader,
            length,
            info: ClipInfo {
                width,
                height,
                rate: Some(1.0 / period),
                frames: headers.frames.map(|n| n as usize),
                format: "avi mjpeg".to_owned(),
                ..ClipInfo::default()
            },
            period,
            stream,
            end,
            shrinker: Shrinker::new(options.max_side),
            limits: options.limits.clone(),
            chunk: Vec::new(),
            index: 0,
            tick: 0,
        })
    }
}

impl MjpegSource {
    /// Goes to the next list of pictures, if there is one: files above a gigabyte have several, each in a RIFF of its own
    /// (OpenDML).
    fn next_list(&mut self) -> io::Result<bool> {
        let mut at = self.end;
        while at + 12 <= self.length {
            go_to(&mut self.reader, at)?;
            let (kind, size) = chunk_header(&mut self.reader)?;
            let mut name = [0u8; 4];
            self.reader.read_exact(&mut name)?;
            if &kind == b"LIST" && &name == b"movi" {
                self.end = end_of(at, size, self.length);
                return Ok(true);
            }
            // What is in a RIFF comes behind its name.
            at = if &kind == b"RIFF" { at + 12 } else { behind(at, size) };
        }
        Ok(false)
    }
}

impl FrameSource for MjpegSource {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn set_max_side(&mut self, side: u32) {
        self.shrinker.limit(side);
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let truncated = |index: usize, path: &str| FrameError::Truncated {
            path: path.to_owned(),
            what: format!("frame {index} is cut"),
        };
        loop {
            let io = |source| FrameError::Io { path: self.name.clone(), source };
            let at = self.reader.stream_position().map_err(io)?;
            if at + 8 > self.end {
                match self.next_list() {
                    Ok(true) => continue,
                    Ok(false) => return Ok(None),
                    Err(source) => return Err(FrameError::Io { path: self.name.clone(), source }),
                }
            }
            if at + 8 > self.length {
                return Err(truncated(self.index, &self.name));
            }
            let (kind, size) = chunk_header(&mut self.reader).map_err(io)?;
            if &kind == b"LIST" {
                // A group of chunks; its members follow after the name of the list.
                self.reader.seek_relative(4).map_err(io)?;
                continue;
            }
            let padded = i64::from(size) + i64::from(size & 1);
            let digits = std::str::from_utf8(&kind[..2]).ok().and_then(|t| t.parse::<u32>().ok());
            if digits != Some(self.stream) || !matches!(&kind[2..], b"dc" | b"db") {
                self.reader.seek_relative(padded).map_err(io)?;
                continue;
            }
            if size == 0 {
                // The picture before is shown once more.
                self.tick += 1;
                self.info.frames = self.info.frames.map(|told| told.saturating_sub(1));
                continue;
            }
            if at + 8 + u64::from(size) > self.length {
                return Err(truncated(self.index, &self.name));
            }
            if size > MAX_CHUNK {
                let what = format!("frame {} has {size} bytes; allowed are {MAX_CHUNK}", self.index);
                return Err(FrameError::Malformed { path: self.name.clone(), what });
            }
            self.chunk.resize(size as usize, 0);
            self.reader.read_exact(&mut self.chunk).map_err(io)?;
            self.reader.seek_relative(padded - i64::from(size)).map_err(io)?;
            let wrong = |error| animation::translate(&self.name, error);
            let mut reader = ImageReader::with_format(Cursor::new(&self.chunk), ImageFormat::Jpeg);
            reader.limits(animation::decoder_limits(&self.limits));
            let decoder = reader.into_decoder().map_err(wrong)?;
            // Before memory is taken for what it says.
            if decoder.dimensions() != (self.info.width, self.info.height) {
                let what = format!("frame {} has another size than the stream", self.index);
                return Err(FrameError::Malformed { path: self.name.clone(), what });
            }
            let image = DynamicImage::from_decoder(decoder).map(DynamicImage::into_rgb8).map_err(wrong)?;
            let image = self.shrinker.rgb(image);
            let frame = Frame { index: self.index, time: self.tick as f64 * self.period, image };
            self.index += 1;
            self.tick += 1;
            return Ok(Some(frame));
        }
    }
}

fn chunk_header(reader: &mut impl Read) -> io::Result<([u8; 4], u32)> {
    let mut head = [0u8; 8];
    reader.read_exact(&mut head)?;
    let [a, b, c, d, size @ ..] = head;
    Ok(([a, b, c, d], u32::from_le_bytes(size)))
}

/// Where the chunk behind one at `at` begins.
fn behind(at: u64, size: u32) -> u64 {
    at + 8 + u64::from(size) + u64::from(size & 1)
}

/// Where a list ends that begins at `at`: what is written into a pipe, or was broken off, does not tell, and goes on to the end.
fn end_of(at: u64, size: u32, end: u64) -> u64 {
    let told = !matches!(size, 0 | u32::MAX);
    if told { behind(at, size) } else { end }
}

/// Goes to a place without reading anew what has been read ahead: small chunks are many.
fn go_to(reader: &mut BufReader<File>, at: u64) -> io::Result<()> {
    let here = reader.stream_position()?;
    reader.seek_relative(at.wrapping_sub(here).cast_signed())
}

/// Looks through the chunks of `start..end` for headers, without reading the pictures.
fn walk(
    reader: &mut BufReader<File>,
    start: u64,
    end: u64,
    depth: usize,
    found: &mut Headers,
) -> io::Result<()> {
    let mut at = start;
    while at + 8 <= end && found.movi.is_none() {
        go_to(reader, at)?;
        let (kind, size) = chunk_header(reader)?;
        let next = behind(at, size);
        match &kind {
            b"LIST" => {
                let mut name = [0u8; 4];
                reader.read_exact(&mut name)?;
                let inside = (at + 12, next);
                match &name {
                    b"movi" => found.movi = Some((inside.0, end_of(at, size, end))),
                    b"hdrl" | b"strl" | b"odml" if depth < MAX_DEPTH => {
                        walk(reader, inside.0, inside.1.min(end), depth + 1, found)?;
                    }
                    _ => {}
                }
            }
            b"avih" => {
                let words = read_words::<10>(reader)?;
                found.micros = words[0];
                found.frames = (words[4] > 0).then_some(words[4]);
            }
            b"dmlh" => {
                // Of all lists of pictures; the one above is of the first.
                let [frames] = read_words::<1>(reader)?;
                found.frames = found.frames.max((frames > 0).then_some(frames));
            }
            b"strh" => {
                let words = read_words::<12>(reader)?;
                let number = found.streams;
                found.streams += 1;
                if words[0].to_le_bytes() == *b"vids" && found.video.is_none() {
                    found.video = Some((number, words[1].to_le_bytes(), words[5], words[6]));
                }
            }
            b"strf" if found.size.is_none() && found.video.is_some_and(|v| v.0 + 1 == found.streams) => {
                let words = read_words::<5>(reader)?;
                // A negative height marks rows from the top down, which JPEG has anyway.
                found.size = Some((words[1], words[2].cast_signed().unsigned_abs()));
                found.compression = words[4].to_le_bytes();
            }
            _ => {}
        }
        at = next;
    }
    Ok(())
}

fn read_words<const N: usize>(reader: &mut impl Read) -> io::Result<[u32; N]> {
    let mut words = [0u32; N];
    for word in &mut words {
        let mut bytes = [0u8; 4];
        reader.read_exact(&mut bytes)?;
        *word = u32::from_le_bytes(bytes);
    }
    Ok(words)
}
