//! AVI files of JPEG pictures.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, RgbImage};

use super::{ClipInfo, Frame, FrameError, FrameSource, OpenOptions, animation, check_size};
use handcast_limits::{Excess, Limit, Limits};
use handcast_picture::Shrinker;

/// Largest compressed picture accepted, in bytes.
const MAX_CHUNK: u32 = 1 << 26;
/// Deepest nesting of lists looked into.
const MAX_DEPTH: usize = 4;

/// Frames of an AVI file with Motion JPEG.
pub(super) struct MjpegSource {
    name: String,
    reader: BufReader<File>,
    info: ClipInfo,
    period: f64,
    chunks: Vec<Chunk>,
    shrinker: Shrinker,
    limits: Limits,
    chunk: Vec<u8>,
    index: usize,
    /// What is wrong with the lists of pictures.
    cut: Option<String>,
    /// How many pictures could not be decoded, and what is wrong with the first of them.
    lost: usize,
    damage: Option<(Chunk, FrameError)>,
}

/// A compressed picture.
#[derive(Clone, Copy, Debug)]
struct Chunk {
    at: u64,
    size: u32,
    /// Pictures before it, those included that are shown once more.
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
        // Of the lists the heads of chunks alone are read.
        let mut reader = BufReader::with_capacity(1 << 10, file);
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
        let lists = Lists { length, stream, end, tick: 0, repeated: 0, chunks: Vec::new(), damage: None };
        let lists = lists.read(&mut reader, start, &options.limits).map_err(|fault| match fault {
            Fault::Io(source) => io(source),
            Fault::Excess(excess) => FrameError::Excess { path: name.to_owned(), excess },
        })?;
        if let (true, Some(what)) = (lists.chunks.is_empty(), &lists.damage) {
            return Err(FrameError::Truncated { path: name.to_owned(), what: what.clone() });
        }
        let told = headers.frames.map(|told| (told as usize).saturating_sub(lists.repeated));
        Ok(Self {
            name: name.to_owned(),
            reader: BufReader::new(reader.into_inner()),
            info: ClipInfo {
                width,
                height,
                rate: Some(1.0 / period),
                frames: Some(lists.chunks.len()),
                told: told.filter(|told| *told > lists.chunks.len()),
                format: "avi mjpeg".to_owned(),
                ..ClipInfo::default()
            },
            period,
            chunks: lists.chunks,
            cut: lists.damage,
            lost: 0,
            damage: None,
            shrinker: Shrinker::new(options.max_side),
            limits: options.limits.clone(),
            chunk: Vec::new(),
            index: 0,
        })
    }
}

impl MjpegSource {
    /// The picture of a chunk.
    fn picture(&mut self, Chunk { at, size, .. }: Chunk) -> Result<RgbImage, FrameError> {
        let malformed = |what: String| FrameError::Malformed { path: self.name.clone(), what };
        if size > MAX_CHUNK {
            return Err(malformed(format!("it has {size} bytes; allowed are {MAX_CHUNK}")));
        }
        let io = |source| FrameError::Io { path: self.name.clone(), source };
        self.chunk.resize(size as usize, 0);
        go_to(&mut self.reader, at).map_err(io)?;
        self.reader.read_exact(&mut self.chunk).map_err(io)?;
        let wrong = |error| animation::translate(&self.name, error);
        let mut reader = ImageReader::with_format(Cursor::new(&self.chunk), ImageFormat::Jpeg);
        reader.limits(animation::decoder_limits(&self.limits));
        let decoder = reader.into_decoder().map_err(wrong)?;
        // Before memory is taken for what it says.
        if decoder.dimensions() != (self.info.width, self.info.height) {
            return Err(malformed("it has another size than the stream".to_owned()));
        }
        DynamicImage::from_decoder(decoder).map(DynamicImage::into_rgb8).map_err(wrong)
    }
}

/// Why lists of pictures are not read.
enum Fault {
    Io(io::Error),
    Excess(Excess),
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// The lists of pictures of a file, while they are read.
struct Lists {
    /// Bytes of the file.
    length: u64,
    /// Number of the stream of pictures.
    stream: u32,
    /// Where the list ends.
    end: u64,
    tick: usize,
    /// How many chunks show the picture before once more.
    repeated: usize,
    chunks: Vec<Chunk>,
    damage: Option<String>,
}

impl Lists {
    /// Reads the heads of the chunks from `at` on.
    fn read(
        mut self,
        reader: &mut BufReader<impl Read + Seek>,
        mut at: u64,
        limits: &Limits,
    ) -> Result<Self, Fault> {
        loop {
            if at + 8 > self.end.min(self.length) {
                match self.next_list(reader)? {
                    Some(next) => at = next,
                    None => break,
                }
                continue;
            }
            go_to(reader, at)?;
            let (kind, size) = chunk_header(reader)?;
            if &kind == b"LIST" {
                // A group of chunks; its members follow after the name of the list.
                at += 12;
                continue;
            }
            let is_sound = is_name(&kind);
            if !is_sound || at + 8 + u64::from(size) > self.length {
                let what = if is_sound { "cut" } else { "damaged" };
                let number = self.chunks.len();
                self.damage
                    .get_or_insert_with(|| format!("frame {number} at byte {at} of the file is {what}"));
                self.tick += 1;
                match self.look_for_picture(reader, at + 1)? {
                    Some(next) => at = next,
                    None => break,
                }
                continue;
            }
            if self.is_picture(&kind) && size == 0 {
                // The picture before is shown once more.
                self.tick += 1;
                self.repeated += 1;
            } else if self.is_picture(&kind) {
                limits.check_count(Limit::Pictures, self.chunks.len() + 1).map_err(Fault::Excess)?;
                self.chunks.push(Chunk { at: at + 8, size, tick: self.tick });
                self.tick += 1;
            }
            at = behind(at, size);
        }
        Ok(self)
    }

    fn is_picture(&self, kind: &[u8]) -> bool {
        let digits = kind.get(..2).and_then(|two| std::str::from_utf8(two).ok()).and_then(|t| t.parse().ok());
        digits == Some(self.stream) && matches!(kind.get(2..4), Some(b"dc" | b"db"))
    }

    /// The next list of pictures, if there is one: files above a gigabyte have several, each in a RIFF of its own
    /// (OpenDML).
    fn next_list(&mut self, reader: &mut BufReader<impl Read + Seek>) -> io::Result<Option<u64>> {
        let mut at = self.end;
        while at + 12 <= self.length {
            go_to(reader, at)?;
            let (kind, size) = chunk_header(reader)?;
            let mut name = [0u8; 4];
            reader.read_exact(&mut name)?;
            if &kind == b"LIST" && &name == b"movi" {
                self.end = end_of(at, size, self.length);
                return Ok(Some(at + 12));
            }
            if !is_name(&kind) {
                // A recorder that broke down leaves zeros behind what it had written.
                break;
            }
            // What is in a RIFF comes behind its name.
            at = if &kind == b"RIFF" { at + 12 } else { behind(at, size) };
        }
        Ok(None)
    }

    /// Where from `from` on, in this list, the next chunk begins that has a whole JPEG picture. No more is read behind it than
    /// was before it, or stays in the reader: there may be as many places of damage as pictures.
    fn look_for_picture(
        &self,
        reader: &mut BufReader<impl Read + Seek>,
        from: u64,
    ) -> io::Result<Option<u64>> {
        const HEAD: usize = 10;
        const FAR: u64 = 1 << 12;
        let end = self.end.min(self.length);
        let is_whole = |head: &[u8], at: u64| {
            let size = head.get(4..8).and_then(|size| <[u8; 4]>::try_from(size).ok()).map(u32::from_le_bytes);
            head.ends_with(&[0xff, 0xd8])
                && self.is_picture(head)
                && size.is_some_and(|size| size > 0 && at + 8 + u64::from(size) <= end)
        };
        let (mut at, mut pieces) = (from, Vec::new());
        while at + (HEAD as u64) < end {
            go_to(reader, at)?;
            let piece = match at - from {
                ..FAR => {
                    if reader.buffer().len() < HEAD {
                        // What is left of it is read once more, with what is behind.
                        reader.seek(SeekFrom::Start(at))?;
                    }
                    reader.fill_buf()?
                }
                far => {
                    pieces.clear();
                    reader.by_ref().take(far.min(1 << 16)).read_to_end(&mut pieces)?;
                    &pieces
                }
            };
            let found = (at..).zip(piece.windows(HEAD)).find(|(at, head)| is_whole(head, *at));
            if let Some((found, _)) = found {
                return Ok(Some(found));
            }
            if piece.len() < HEAD {
                break;
            }
            at += (piece.len() + 1 - HEAD) as u64;
        }
        Ok(None)
    }
}

impl FrameSource for MjpegSource {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn set_max_side(&mut self, side: u32) {
        self.shrinker.limit(side);
    }

    fn times(&self) -> Option<Vec<f64>> {
        Some(self.chunks.iter().map(|chunk| chunk.tick as f64 * self.period).collect())
    }

    fn skip_to(&mut self, seconds: f64) -> Result<(), FrameError> {
        // With one to spare for times that are rounded.
        let at = self.chunks.partition_point(|chunk| chunk.tick as f64 * self.period < seconds);
        self.index = at.saturating_sub(1);
        Ok(())
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        while let Some(&chunk) = self.chunks.get(self.index) {
            let index = self.index;
            self.index += 1;
            match self.picture(chunk) {
                Ok(image) => {
                    let time = chunk.tick as f64 * self.period;
                    return Ok(Some(Frame { index, time, image: self.shrinker.rgb(image) }));
                }
                Err(error) if error.damage().is_some() => {
                    self.lost += 1;
                    self.damage.get_or_insert((chunk, error));
                }
                Err(error) => return Err(error),
            }
        }
        // Where there was none at all what is wrong with the first is.
        match self.damage.take_if(|_| self.lost == self.chunks.len()) {
            Some((_, error)) => Err(error),
            None => Ok(None),
        }
    }

    fn shortfall(&self) -> Option<String> {
        let more = if self.lost > 1 { format!(" (and {} more)", self.lost - 1) } else { String::new() };
        let damage = self.damage.as_ref().and_then(|(chunk, error)| {
            let time = chunk.tick as f64 * self.period;
            error.damage().map(|what| format!("frame {} at {time:.3} s: {what}{more}", chunk.tick))
        });
        let said: Vec<String> = self.cut.iter().cloned().chain(damage).collect();
        (!said.is_empty()).then(|| said.join("; "))
    }
}

fn chunk_header(reader: &mut impl Read) -> io::Result<([u8; 4], u32)> {
    let mut head = [0u8; 8];
    reader.read_exact(&mut head)?;
    let [a, b, c, d, size @ ..] = head;
    Ok(([a, b, c, d], u32::from_le_bytes(size)))
}

/// Whether a chunk may have this kind.
fn is_name(kind: &[u8; 4]) -> bool {
    kind.iter().all(|byte| byte.is_ascii_graphic() || *byte == b' ')
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
fn go_to(reader: &mut BufReader<impl Read + Seek>, at: u64) -> io::Result<()> {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A file that counts the bytes that are read of it.
    struct Counted<'a>(Cursor<&'a [u8]>, u64);

    impl Read for Counted<'_> {
        fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
            let count = self.0.read(to)?;
            self.1 += count as u64;
            Ok(count)
        }
    }

    impl Seek for Counted<'_> {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.0.seek(to)
        }
    }

    /// The chunks found of a list that begins at byte 0 and ends at `end`, and how many bytes were read.
    fn found(bytes: &[u8], end: u64) -> (Vec<(u64, u32)>, u64) {
        let length = bytes.len() as u64;
        let lists = Lists { length, stream: 0, end, tick: 0, repeated: 0, chunks: Vec::new(), damage: None };
        let mut reader = BufReader::with_capacity(1 << 10, Counted(Cursor::new(bytes), 0));
        let Ok(lists) = lists.read(&mut reader, 0, &Limits::default()) else { panic!("limits are kept") };
        (lists.chunks.iter().map(|chunk| (chunk.at, chunk.size)).collect(), reader.get_ref().1)
    }

    /// A chunk of a picture of so many bytes, which begins as one does.
    fn chunk(size: usize) -> Vec<u8> {
        [&b"00dc"[..], &(size as u32).to_le_bytes(), &[0xff, 0xd8], &vec![7; size - 2]].concat()
    }

    #[test]
    fn zeros_behind_the_lists_are_not_stepped_through() {
        let bytes = [chunk(40), vec![0; 1 << 20]].concat();
        let (chunks, read) = found(&bytes, 48);
        assert_eq!(chunks, [(8, 40)]);
        assert!(read < 4 << 10, "{read}");
        // A further list comes behind other chunks.
        let further = [&b"LIST\x34\0\0\0movi"[..], &chunk(40)].concat();
        let bytes = [chunk(40), b"JUNK\x08\0\0\0\0\0\0\0\0\0\0\0".to_vec(), further].concat();
        assert_eq!(found(&bytes, 48).0, [(8, 40), (84, 40)]);
    }

    #[test]
    fn damage_is_read_once_whatever_looks_like_a_picture() {
        let like = |size: u8| [b'0', b'0', b'd', b'c', size, 0, 0, 0, 0xff, 0xd8, 0, 0, 0, 0, 0, 0, 0, 0];
        for size in [0, 2] {
            let bytes = [vec![0; 16], like(size).repeat(10_000), chunk(5000), vec![0; 9]].concat();
            let length = bytes.len() as u64;
            let (chunks, read) = found(&bytes, length);
            assert_eq!(chunks.last(), Some(&(length - 9 - 5000, 5000)));
            assert_eq!(chunks.len(), if size == 0 { 1 } else { 10_001 });
            assert!(read < 2 * length, "{read} of {length}");
        }
    }
}
