//! Motion JPEG in AVI: a video that every player shows, written with nothing but a JPEG encoder.

use std::io::{self, Seek, SeekFrom, Write};

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, RgbImage};
use thiserror::Error;

/// Sizes in RIFF are 32 bits; players of AVI without extensions stop at 2 GiB.
const MAX_BYTES: u64 = (1 << 31) - (1 << 20);
const HEADER_LIST: u32 = 4 + (8 + 56) + (8 + STREAM_LIST);
const STREAM_LIST: u32 = 4 + (8 + 56) + (8 + 40);
/// Position of the chunk that lists the pictures.
const MOVI_AT: u64 = 12 + 8 + HEADER_LIST as u64;

/// Why a video could not be written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum AviError {
    /// The size, rate or quality makes no sense.
    #[error("avi: {what}")]
    Parameter {
        /// The value and what is allowed.
        what: String,
    },
    /// The file would grow beyond what AVI can address.
    #[error("avi: the video is longer than {MAX_BYTES} bytes")]
    TooLong,
    /// The JPEG encoder failed.
    #[error("avi: frame {frame}: {source}")]
    Jpeg {
        /// Number of the frame from 0.
        frame: u32,
        /// The encoder's error.
        source: image::ImageError,
    },
    /// Writing failed.
    #[error("avi: {0}")]
    Io(#[from] io::Error),
}

/// Writes pictures of one size, one after another, as an AVI file with an index.
///
/// The frame count and sizes are filled in by [`MjpegWriter::finish`].
#[derive(Debug)]
pub struct MjpegWriter<W: Write + Seek> {
    out: W,
    size: (u32, u32),
    quality: u8,
    /// Offset from the list's name, and size, of each picture.
    index: Vec<(u32, u32)>,
    written: u64,
    largest: u32,
    jpeg: Vec<u8>,
}

impl<W: Write + Seek> MjpegWriter<W> {
    /// Begins a video of `size` pixels at `rate` frames per second (as a fraction), JPEG quality 1 to 100.
    ///
    /// # Errors
    /// A parameter is out of range, or writing fails.
    pub fn new(mut out: W, size: (u32, u32), rate: (u32, u32), quality: u8) -> Result<Self, AviError> {
        let sides = 1..=65_500;
        if !sides.contains(&size.0) || !sides.contains(&size.1) {
            let what = format!("picture of {} x {} pixels; allowed are 1 to 65500 a side", size.0, size.1);
            return Err(AviError::Parameter { what });
        }
        if rate.0 == 0 || rate.1 == 0 {
            return Err(AviError::Parameter { what: format!("frame rate {}/{}", rate.0, rate.1) });
        }
        if !(1..=100).contains(&quality) {
            return Err(AviError::Parameter { what: format!("quality {quality}; allowed are 1 to 100") });
        }
        write_header(&mut out, size, rate)?;
        let written = MOVI_AT + 12;
        Ok(Self { out, size, quality, index: Vec::new(), written, largest: 0, jpeg: Vec::new() })
    }

    /// The fraction for a rate in frames per second, exact for the usual ones (25, 29.97, 30 …).
    pub fn rate_of(frames_per_second: f64) -> (u32, u32) {
        let ntsc = (frames_per_second * 1.001).round();
        if frames_per_second.fract() != 0.0 && (ntsc / 1.001 - frames_per_second).abs() < 0.005 {
            return (ntsc as u32 * 1000, 1001);
        }
        (((frames_per_second * 1000.0).round().clamp(1.0, 4e9)) as u32, 1000)
    }

    /// Appends a picture.
    ///
    /// # Errors
    /// The picture has another size than the video, the video grows too long, or writing fails.
    pub fn write(&mut self, image: &RgbImage) -> Result<(), AviError> {
        if image.dimensions() != self.size {
            let (w, h) = image.dimensions();
            let what = format!("picture of {w} x {h} pixels in a video of {} x {}", self.size.0, self.size.1);
            return Err(AviError::Parameter { what });
        }
        let frame = self.index.len() as u32;
        self.jpeg.clear();
        JpegEncoder::new_with_quality(&mut self.jpeg, self.quality)
            .encode(image.as_raw(), self.size.0, self.size.1, ExtendedColorType::Rgb8)
            .map_err(|source| AviError::Jpeg { frame, source })?;
        let size = self.jpeg.len() as u64;
        let padded = size + size % 2;
        // Room for this picture, its index entry and those before it.
        if self.written + padded + 8 + 16 * (self.index.len() as u64 + 2) > MAX_BYTES {
            return Err(AviError::TooLong);
        }
        if size % 2 == 1 {
            self.jpeg.push(0);
        }
        self.out.write_all(b"00dc")?;
        self.out.write_all(&(size as u32).to_le_bytes())?;
        self.out.write_all(&self.jpeg)?;
        self.index.push(((self.written - MOVI_AT - 8) as u32, size as u32));
        self.largest = self.largest.max(size as u32);
        self.written += padded + 8;
        Ok(())
    }

    /// Number of pictures written.
    pub fn frames(&self) -> usize {
        self.index.len()
    }

    /// Writes the index, completes the header and gives the output back.
    ///
    /// # Errors
    /// Writing fails.
    pub fn finish(mut self) -> Result<W, AviError> {
        let entries = self.index.len() as u32;
        self.out.write_all(b"idx1")?;
        self.out.write_all(&(entries * 16).to_le_bytes())?;
        for (offset, size) in &self.index {
            // 0x10: a key frame, as every JPEG picture is.
            self.out.write_all(b"00dc")?;
            for word in [0x10, *offset, *size] {
                self.out.write_all(&word.to_le_bytes())?;
            }
        }
        let end = self.written + 8 + u64::from(entries) * 16;
        let patches = [
            (4, (end - 8) as u32),
            (32 + 16, entries),
            (32 + 28, self.largest),
            (108 + 32, entries),
            (108 + 36, self.largest),
            (MOVI_AT + 4, (self.written - MOVI_AT - 8) as u32),
        ];
        for (at, value) in patches {
            self.out.seek(SeekFrom::Start(at))?;
            self.out.write_all(&value.to_le_bytes())?;
        }
        self.out.seek(SeekFrom::Start(end))?;
        self.out.flush()?;
        Ok(self.out)
    }
}

fn write_header(out: &mut impl Write, (width, height): (u32, u32), rate: (u32, u32)) -> io::Result<()> {
    let micros = (f64::from(rate.1) * 1e6 / f64::from(rate.0)).round() as u32;
    let four = |kind: &[u8; 4]| u32::from_le_bytes(*kind);
    let words: &[u32] = &[
        four(b"RIFF"),
        0,
        four(b"AVI "),
        four(b"LIST"),
        HEADER_LIST,
        four(b"hdrl"),
        // Period, bytes a second, padding, flags (0x10: has an index), frames, first frame, streams,
        // buffer, width, height, reserved.
        four(b"avih"),
        56,
        micros,
        0,
        0,
        0x10,
        0,
        0,
        1,
        0,
        width,
        height,
        0,
        0,
        0,
        0,
        four(b"LIST"),
        STREAM_LIST,
        four(b"strl"),
        // Type, codec, flags, priority, first frame, scale, rate, start, length, buffer, quality (-1:
        // default), sample size, rectangle.
        four(b"strh"),
        56,
        four(b"vids"),
        four(b"MJPG"),
        0,
        0,
        0,
        rate.1,
        rate.0,
        0,
        0,
        0,
        u32::MAX,
        0,
        0,
        (height << 16) | (width & 0xffff),
        // Size of this header, width, height, planes and bits, codec, bytes of an uncompressed picture.
        four(b"strf"),
        40,
        40,
        width,
        height,
        (24 << 16) | 1,
        four(b"MJPG"),
        width.wrapping_mul(height).wrapping_mul(3),
        0,
        0,
        0,
        0,
        four(b"LIST"),
        4,
        four(b"movi"),
    ];
    for word in words {
        out.write_all(&word.to_le_bytes())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    #[test]
    fn the_parts_add_up() {
        let mut writer = MjpegWriter::new(Cursor::new(Vec::new()), (33, 17), (25, 1), 90).unwrap();
        for level in [10u8, 200, 90] {
            writer.write(&RgbImage::from_pixel(33, 17, image::Rgb([level; 3]))).unwrap();
        }
        let bytes = writer.finish().unwrap().into_inner();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(word(4) + 8, bytes.len());
        let movi = MOVI_AT as usize;
        assert_eq!(&bytes[movi + 8..movi + 12], b"movi");
        let index = movi + 8 + word(movi + 4);
        assert_eq!(&bytes[index..index + 4], b"idx1");
        assert_eq!(word(index + 4), 48);
        for entry in 0..3 {
            let offset = word(index + 8 + entry * 16 + 8);
            assert_eq!(&bytes[movi + 8 + offset..][..4], b"00dc");
            assert_eq!(&bytes[movi + 8 + offset + 8..][..2], [0xff, 0xd8]);
        }
        assert_eq!((&bytes[32 - 8..32 - 4], word(32 + 16)), (&b"avih"[..], 3));
        assert_eq!((&bytes[108 - 8..108 - 4], word(108 + 32)), (&b"strh"[..], 3));
    }

    #[test]
    fn wrong_parameters_are_named() {
        let new = |size, rate, quality| MjpegWriter::new(Cursor::new(Vec::new()), size, rate, quality);
        assert!(matches!(new((0, 1), (1, 1), 80), Err(AviError::Parameter { .. })));
        assert!(matches!(new((1, 1), (0, 1), 80), Err(AviError::Parameter { .. })));
        assert!(matches!(new((1, 1), (1, 1), 0), Err(AviError::Parameter { .. })));
        let mut writer = new((4, 4), (25, 1), 80).unwrap();
        assert!(matches!(writer.write(&RgbImage::new(5, 4)), Err(AviError::Parameter { .. })));
    }

    #[test]
    fn usual_rates_are_exact() {
        type Writer = MjpegWriter<Cursor<Vec<u8>>>;
        assert_eq!(Writer::rate_of(25.0), (25_000, 1000));
        assert_eq!(Writer::rate_of(29.97), (30_000, 1001));
        assert_eq!(Writer::rate_of(23.976), (24_000, 1001));
        assert_eq!(Writer::rate_of(12.5), (12_500, 1000));
    }
}
