//! H.264 in MP4, written with nothing but Rust: a film that browsers, phones and slides show.

use std::io::{self, Seek, SeekFrom, Write};

use image::RgbImage;
use rusty_h264::{Encoder, EncoderConfig, Preset, YuvFrame};
use thiserror::Error;

/// Longest side of a picture, pixels: H.264, level 5.1.
const MAX_SIDE: u32 = 4096;
/// Units of the file's times in a second.
pub const TICKS: u32 = 90_000;
/// Bits a second where nothing else is asked for: a film of ten seconds stays below a megabyte.
pub const USUAL_RATE: u32 = 700_000;
/// Quantiser that the first pictures get before the rate takes over.
const FIRST_QP: u8 = 28;
/// Pictures from one that stands alone to the next, at most.
const GROUP: u32 = 120;

/// Why a film could not be written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FilmError {
    /// The size, rate or a picture makes no sense.
    #[error("mp4: {what}")]
    Parameter {
        /// The value and what is allowed.
        what: String,
    },
    /// The encoder failed.
    #[error("mp4: picture {picture}: {what}")]
    Encoder {
        /// Number of the picture from 0.
        picture: usize,
        /// What it says.
        what: String,
    },
    /// Writing failed.
    #[error("mp4: {0}")]
    Io(#[from] io::Error),
}

/// A picture in the file.
#[derive(Clone, Copy, Debug)]
struct Sample {
    bytes: u32,
    ticks: u32,
    /// Players may start here.
    sync: bool,
}

/// Writes pictures of one size as an MP4 file with one track of H.264 (High profile, 4:2:0, BT.601).
///
/// Sizes are even: the last column and row of others are left out. The index is written by [`FilmWriter::finish`].
pub struct FilmWriter<W: Write + Seek> {
    out: W,
    encoder: Encoder,
    given: (u32, u32),
    size: (u32, u32),
    samples: Vec<Sample>,
    /// Sequence and picture parameter set.
    sets: [Vec<u8>; 2],
    payload: u64,
}

/// Bytes before the first picture.
const MDAT: u64 = FTYP.len() as u64;
const FTYP: [u8; 28] = *b"\0\0\0\x1cftypisom\0\0\x02\0isomiso2mp41";

impl<W: Write + Seek> FilmWriter<W> {
    /// Begins a film of `size` pixels at about `rate` pictures a second, with `bits` a second.
    ///
    /// # Errors
    /// A parameter is out of range, or writing fails.
    pub fn new(mut out: W, size: (u32, u32), rate: f64, bits: u32) -> Result<Self, FilmError> {
        let wrong = |what| Err(FilmError::Parameter { what });
        let sides = 2..=MAX_SIDE;
        if !sides.contains(&size.0) || !sides.contains(&size.1) {
            let (w, h) = size;
            return wrong(format!("pictures of {w} x {h} pixels; allowed are 2 to {MAX_SIDE} a side"));
        }
        if !(rate > 0.0 && rate <= 1000.0) || bits == 0 {
            return wrong(format!("{rate} pictures a second of {bits} bits; allowed are above 0 to 1000"));
        }
        let even = (size.0 & !1, size.1 & !1);
        let mut options = EncoderConfig::new(even.0 as usize, even.1 as usize);
        options.preset = Preset::Balanced;
        options.qp = FIRST_QP;
        options.bitrate = bits;
        options.framerate = rate as f32;
        options.gop_size = GROUP;
        // Each picture comes out as it goes in.
        options.mbtree = false;
        options.level_idc = level(even, rate);
        let refused = |e: rusty_h264::EncodeError| FilmError::Encoder { picture: 0, what: e.to_string() };
        let encoder = Encoder::new(options).map_err(refused)?;
        out.write_all(&FTYP)?;
        // A box whose size is told by 64 bits, at the end.
        out.write_all(b"\0\0\0\x01mdat\0\0\0\0\0\0\0\0")?;
        Ok(Self {
            out,
            encoder,
            given: size,
            size: even,
            samples: Vec::new(),
            sets: Default::default(),
            payload: 0,
        })
    }

    /// Appends a picture that is shown for so many [`TICKS`].
    ///
    /// # Errors
    /// The picture has another size than the film, the encoder fails, or writing does.
    pub fn write(&mut self, picture: &RgbImage, ticks: u32) -> Result<(), FilmError> {
        if picture.dimensions() != self.given {
            let (w, h) = picture.dimensions();
            let what =
                format!("picture of {w} x {h} pixels in a film of {} x {}", self.given.0, self.given.1);
            return Err(FilmError::Parameter { what });
        }
        let unit = self.encoder.encode(&planes(picture, self.size));
        let mut sample = Sample { bytes: 0, ticks: ticks.max(1), sync: false };
        for nal in nals(&unit) {
            match nal.first().map_or(0, |head| head & 0x1f) {
                7 => self.sets[0] = nal.to_vec(),
                8 => self.sets[1] = nal.to_vec(),
                kind => {
                    sample.sync |= kind == 5;
                    self.out.write_all(&(nal.len() as u32).to_be_bytes())?;
                    self.out.write_all(nal)?;
                    sample.bytes += nal.len() as u32 + 4;
                }
            }
        }
        if sample.bytes == 0 {
            let what = "the encoder gave nothing".to_owned();
            return Err(FilmError::Encoder { picture: self.samples.len(), what });
        }
        self.payload += u64::from(sample.bytes);
        self.samples.push(sample);
        Ok(())
    }

    /// Writes the index and gives back what was written into.
    ///
    /// # Errors
    /// There is no picture, or writing fails.
    pub fn finish(mut self) -> Result<W, FilmError> {
        if self.samples.is_empty() {
            return Err(FilmError::Parameter { what: "a film without pictures".into() });
        }
        self.out.write_all(&self.movie())?;
        self.out.seek(SeekFrom::Start(MDAT + 8))?;
        self.out.write_all(&(self.payload + 16).to_be_bytes())?;
        self.out.seek(SeekFrom::End(0))?;
        Ok(self.out)
    }

    /// The index (ISO/IEC 14496-12, 8).
    fn movie(&self) -> Vec<u8> {
        let ticks: u64 = self.samples.iter().map(|sample| u64::from(sample.ticks)).sum();
        let length = u32::try_from(ticks).unwrap_or(u32::MAX).to_be_bytes();
        const UNIT: [u8; 36] = {
            // The unit matrix: 1, 1 and 2^30.
            let mut matrix = [0; 36];
            (matrix[1], matrix[17], matrix[32]) = (1, 1, 0x40);
            matrix
        };
        let (width, height) = self.size;
        let header = full(
            b"mvhd",
            0,
            &[
                &[0; 8],
                &TICKS.to_be_bytes(),
                &length,
                b"\0\x01\0\0\x01\0\0\0\0\0\0\0\0\0\0\0",
                &UNIT,
                &[0; 24],
                &[0, 0, 0, 2],
            ],
        );
        let fixed = |pixels: u32| (pixels << 16).to_be_bytes();
        let track = full(
            b"tkhd",
            3,
            &[&[0; 8], &[0, 0, 0, 1], &[0; 4], &length, &[0; 16], &UNIT, &fixed(width), &fixed(height)],
        );
        // Of no language.
        let media = full(b"mdhd", 0, &[&[0; 8], &TICKS.to_be_bytes(), &length, &[0x55, 0xc4, 0, 0]]);
        let handler = full(b"hdlr", 0, &[&[0; 4], b"vide", &[0; 12], b"film\0"]);
        let here = full(b"url ", 1, &[]);
        let data = boxed(b"dinf", &[&full(b"dref", 0, &[&[0, 0, 0, 1], &here])]);
        let information = boxed(b"minf", &[&full(b"vmhd", 1, &[&[0; 8]]), &data, &self.table()]);
        let media = boxed(b"mdia", &[&media, &handler, &information]);
        boxed(b"moov", &[&header, &boxed(b"trak", &[&track, &media])])
    }

    /// What the pictures are, how long each is shown, and where it lies.
    fn table(&self) -> Vec<u8> {
        let count = |n: usize| (n as u32).to_be_bytes();
        let (width, height) = self.size;
        let sizes = [(width as u16).to_be_bytes(), (height as u16).to_be_bytes()].concat();
        let [sequence, picture] = &self.sets;
        let lengths = [sequence, picture].map(|set| (set.len() as u16).to_be_bytes());
        // High profile: 4:2:0 of 8 bits.
        let head = [1, byte(sequence, 1), byte(sequence, 2), byte(sequence, 3), 0xff, 0xe1];
        let parameters = boxed(
            b"avcC",
            &[&head, &lengths[0], sequence, &[1], &lengths[1], picture, &[0xfd, 0xf8, 0xf8, 0]],
        );
        // BT.601 with the primaries of SMPTE 170M, limited range.
        let colour = boxed(b"colr", &[b"nclx\0\x06\0\x06\0\x06\0"]);
        let dots = [0, 72, 0, 0, 0, 72, 0, 0];
        let entry = boxed(
            b"avc1",
            &[
                &[0; 6],
                &[0, 1],
                &[0; 16],
                &sizes,
                &dots,
                &[0; 4],
                &[0, 1],
                &[0; 32],
                &[0, 24, 255, 255],
                &parameters,
                &colour,
            ],
        );
        let mut runs: Vec<(u32, u32)> = Vec::new();
        for sample in &self.samples {
            match runs.last_mut().filter(|run| run.1 == sample.ticks) {
                Some(run) => run.0 += 1,
                None => runs.push((1, sample.ticks)),
            }
        }
        let shown: Vec<u8> =
            runs.iter().flat_map(|&(n, ticks)| [n, ticks]).flat_map(u32::to_be_bytes).collect();
        let starts = self.samples.iter().enumerate().filter(|(_, sample)| sample.sync);
        let starts: Vec<u8> = starts.flat_map(|(i, _)| count(i + 1)).collect();
        let lengths: Vec<u8> = self.samples.iter().flat_map(|sample| sample.bytes.to_be_bytes()).collect();
        let all = count(self.samples.len());
        boxed(
            b"stbl",
            &[
                &full(b"stsd", 0, &[&count(1), &entry]),
                &full(b"stts", 0, &[&count(runs.len()), &shown]),
                &full(b"stss", 0, &[&count(starts.len() / 4), &starts]),
                // One chunk.
                &full(b"stsc", 0, &[&count(1), &count(1), &all, &count(1)]),
                &full(b"stsz", 0, &[&count(0), &all, &lengths]),
                &full(b"stco", 0, &[&count(1), &((MDAT + 16) as u32).to_be_bytes()]),
            ],
        )
    }
}

fn byte(bytes: &[u8], at: usize) -> u8 {
    bytes.get(at).copied().unwrap_or_default()
}

fn boxed(kind: &[u8; 4], parts: &[&[u8]]) -> Vec<u8> {
    handcast_iso::boxed(kind, &parts.concat())
}

/// A box with a version, 0, and flags.
fn full(kind: &[u8; 4], flags: u8, parts: &[&[u8]]) -> Vec<u8> {
    let version = [0, 0, 0, flags];
    let parts: Vec<&[u8]> = std::iter::once(&version[..]).chain(parts.iter().copied()).collect();
    boxed(kind, &parts)
}

/// The least level that allows such pictures (H.264, table A-1: macroblocks a picture and a second).
fn level((width, height): (u32, u32), rate: f64) -> u8 {
    const LEVELS: [(u8, u32, f64); 5] = [
        (30, 1620, 40_500.0),
        (31, 3600, 108_000.0),
        (40, 8192, 245_760.0),
        (42, 8704, 522_240.0),
        (51, 36_864, 983_040.0),
    ];
    let blocks = width.div_ceil(16) * height.div_ceil(16);
    let fits =
        |(_, picture, second): &&(u8, u32, f64)| blocks <= *picture && f64::from(blocks) * rate <= *second;
    LEVELS.iter().find(fits).map_or(52, |(level, ..)| *level)
}

/// The units between the start codes of an access unit.
fn nals(unit: &[u8]) -> Vec<&[u8]> {
    let mut starts = Vec::new();
    let mut at = 0;
    while let Some(found) = unit.get(at..).and_then(|rest| rest.windows(3).position(|w| w == [0, 0, 1])) {
        starts.push(at + found);
        at += found + 3;
    }
    let ends = starts.iter().skip(1).copied().chain([unit.len()]);
    let piece = |(start, end): (&usize, usize)| {
        let mut nal = &unit[start + 3..end];
        // The zeros belong to the next start code.
        while let [rest @ .., 0] = nal {
            nal = rest;
        }
        nal
    };
    starts.iter().zip(ends).map(piece).filter(|nal| !nal.is_empty()).collect()
}

/// A picture as planes of 4:2:0, BT.601, limited range; chroma is the mean of four pixels.
fn planes(picture: &RgbImage, (width, height): (u32, u32)) -> YuvFrame {
    let (w, h) = (width as usize, height as usize);
    let row = picture.width() as usize * 3;
    let pixels = picture.as_raw();
    let mut y = Vec::with_capacity(w * h);
    for line in pixels.chunks_exact(row).take(h) {
        y.extend(line.as_chunks::<3>().0.iter().take(w).map(|&[r, g, b]| {
            let luma = 66 * i32::from(r) + 129 * i32::from(g) + 25 * i32::from(b);
            (((luma + 128) >> 8) + 16) as u8
        }));
    }
    let (mut u, mut v) = (Vec::with_capacity(w * h / 4), Vec::with_capacity(w * h / 4));
    for pair in pixels.chunks_exact(2 * row).take(h / 2) {
        let (upper, lower) = pair.split_at(row);
        for (a, b) in upper.chunks_exact(6).zip(lower.chunks_exact(6)).take(w / 2) {
            let [r, g, b] =
                std::array::from_fn(|k| [a[k], a[k + 3], b[k], b[k + 3]].map(i32::from).iter().sum::<i32>());
            // Sums of four: two more bits.
            u.push((((-38 * r - 74 * g + 112 * b + 512) >> 10) + 128) as u8);
            v.push((((112 * r - 94 * g - 18 * b + 512) >> 10) + 128) as u8);
        }
    }
    YuvFrame { width: w, height: h, y, u, v }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    #[test]
    fn what_makes_no_film_is_refused() {
        let film = |size, rate| FilmWriter::new(Cursor::new(Vec::new()), size, rate, 1000);
        assert!(film((1, 96), 25.0).is_err() && film((64, 5000), 25.0).is_err());
        assert!(film((64, 64), 0.0).is_err() && film((64, 64), f64::NAN).is_err());
        let mut good = film((64, 64), 25.0).unwrap();
        let message = good.write(&RgbImage::new(32, 64), 1).unwrap_err().to_string();
        assert!(message.contains("32 x 64 pixels in a film of 64 x 64"), "{message}");
        assert!(good.finish().is_err());
    }

    #[test]
    fn units_are_told_by_their_start_codes() {
        let unit = [0, 0, 0, 1, 0x67, 1, 2, 0, 0, 0, 1, 0x68, 3, 0, 0, 1, 0x65, 0, 0, 3, 1];
        assert_eq!(nals(&unit), [&[0x67, 1, 2][..], &[0x68, 3], &[0x65, 0, 0, 3, 1]]);
        assert!(nals(&[]).is_empty());
        assert_eq!(
            [level((640, 360), 30.0), level((1280, 720), 30.0), level((1920, 1080), 60.0)],
            [30, 31, 42]
        );
    }
}
