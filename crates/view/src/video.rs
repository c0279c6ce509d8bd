//! The clip in a page: the film as it is, where browsers play it, or its frames, small and as JPEG.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use serde::Serialize;

use handcast_media::{FrameError, FrameSource};
use handcast_picture::fit_within;

/// Longest side of the pictures of a short clip, pixels.
const LARGEST: f64 = 480.0;
/// The same of a long one.
const SMALLEST: f64 = 160.0;
/// Pictures up to which a clip counts as short.
const SHORT_CLIP: f64 = 1800.0;
/// Most bytes of JPEG in one page.
const MAX_BYTES: usize = 64 << 20;
/// Quality of the JPEG.
const QUALITY: u8 = 72;

/// A clip: what the page's JSON says of it, and its bytes.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Video {
    /// The file as it is.
    Film(Film),
    /// Its frames.
    Pictures(Pictures),
}

/// A film that browsers play.
#[derive(Debug, Serialize)]
pub struct Film {
    /// The file.
    #[serde(skip)]
    bytes: Vec<u8>,
    /// Of which type it is.
    film: &'static str,
}

/// Frames of a clip.
#[derive(Debug, Serialize)]
pub struct Pictures {
    /// Width of the pictures, pixels.
    pub width: u32,
    /// Height of the pictures, pixels.
    pub height: u32,
    /// Times of the pictures, seconds.
    pub times: Vec<f64>,
    /// JPEG, one picture after another.
    #[serde(skip)]
    bytes: Vec<u8>,
    /// Where each one ends in them.
    ends: Vec<usize>,
    /// What was left out, in words.
    pub note: Option<String>,
}

/// Longest side of the pictures for a motion of so many instants, pixels: 480, and less when they are more
/// than a minute of video.
pub fn picture_side(instants: usize) -> u32 {
    let share = (SHORT_CLIP / instants.max(1) as f64).sqrt();
    (LARGEST * share).clamp(SMALLEST, LARGEST).round() as u32
}

impl Video {
    /// What was left out, in words.
    pub fn note(&self) -> Option<&str> {
        match self {
            Self::Film(_) => None,
            Self::Pictures(pictures) => pictures.note.as_deref(),
        }
    }
}

impl Video {
    /// The film or the pictures, one after another.
    pub(super) fn bytes(&self) -> &[u8] {
        match self {
            Self::Film(film) => &film.bytes,
            Self::Pictures(pictures) => &pictures.bytes,
        }
    }
}

impl Film {
    /// The film in a file, where browsers play it: H.264 in MP4 of 64 MiB at most. `None` otherwise.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(path: &Path, source: &dyn FrameSource) -> io::Result<Option<Self>> {
        // Other brands, of QuickTime say, not every browser takes.
        const BRANDS: [&[u8]; 7] = [b"isom", b"iso2", b"iso4", b"iso5", b"iso6", b"mp41", b"mp42"];
        if source.info().format != "mp4 h264" {
            return Ok(None);
        }
        let mut bytes = Vec::new();
        File::open(path)?.take(MAX_BYTES as u64 + 1).read_to_end(&mut bytes)?;
        let brand = bytes.get(4..8).filter(|kind| *kind == b"ftyp").and_then(|_| bytes.get(8..12));
        let played = bytes.len() <= MAX_BYTES && brand.is_some_and(|brand| BRANDS.contains(&brand));
        Ok(played.then_some(Self { bytes, film: "video/mp4" }))
    }
}

impl Pictures {
    /// Reads those frames of `source` that are nearest to an instant of `times` (seconds, in order), until
    /// 64 MiB of JPEG are full; one picture is held at a time. Pictures are fitted into `side` pixels.
    ///
    /// # Errors
    /// What the source says, and [`FrameError::Empty`] for a clip without frames.
    pub fn read(source: &mut dyn FrameSource, times: &[f64], side: u32) -> Result<Self, FrameError> {
        let mut video =
            Self { width: 0, height: 0, times: Vec::new(), bytes: Vec::new(), ends: Vec::new(), note: None };
        let mut wanted = times.iter().peekable();
        let mut next = source.next_frame()?;
        while let Some(frame) = next {
            next = source.next_frame()?;
            let until = next.as_ref().map_or(f64::INFINITY, |n| (frame.time + n.time) / 2.0);
            let mut shown = false;
            while wanted.next_if(|t| **t < until).is_some() {
                shown = true;
            }
            if !shown {
                continue;
            }
            let (width, height) = frame.image.dimensions();
            let (w, h) = fit_within(width, height, Some(side));
            let picture = if (w, h) == (width, height) {
                frame.image
            } else {
                image::imageops::thumbnail(&frame.image, w, h)
            };
            let mut jpeg = Vec::new();
            JpegEncoder::new_with_quality(&mut jpeg, QUALITY)
                .encode(&picture, w, h, ExtendedColorType::Rgb8)
                .map_err(|e| FrameError::Option { what: format!("a picture of the clip: {e}") })?;
            if video.bytes.len() + jpeg.len() > MAX_BYTES {
                let end = frame.time;
                video.note = Some(format!("the page is full: the clip is shown up to {end:.1} s"));
                break;
            }
            (video.width, video.height) = (w, h);
            video.times.push(frame.time);
            video.bytes.extend(jpeg);
            video.ends.push(video.bytes.len());
            if wanted.peek().is_none() {
                break;
            }
        }
        if video.times.is_empty() {
            return Err(FrameError::Empty {
                path: "the clip".into(),
                what: "no frame at the times of the motion",
            });
        }
        Ok(video)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_media::{ClipInfo, Frame};
    use image::{Rgb, RgbImage};

    struct Flat(ClipInfo, usize);

    impl FrameSource for Flat {
        fn info(&self) -> &ClipInfo {
            &self.0
        }

        fn set_max_side(&mut self, _side: u32) {}

        fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
            let index = self.1;
            self.1 += 1;
            let image = RgbImage::from_pixel(640, 320, Rgb([index as u8, 90, 40]));
            Ok((index < 40).then_some(Frame { index, time: index as f64 / 20.0, image }))
        }
    }

    #[test]
    fn the_frames_nearest_to_the_instants_are_kept() {
        let info = ClipInfo { width: 640, height: 320, ..ClipInfo::default() };
        let mut source = Flat(info, 0);
        let times = [0.0, 0.04, 0.06, 0.22, 0.31];
        let video = Pictures::read(&mut source, &times, 160).unwrap();
        assert_eq!((video.width, video.height), (160, 80));
        assert_eq!(video.times, [0.0, 0.05, 0.2, 0.3]);
        let starts = [0].into_iter().chain(video.ends.iter().copied());
        assert!(starts.zip(&video.ends).all(|(start, &end)| {
            let jpeg = &video.bytes[start..end];
            jpeg.starts_with(&[0xff, 0xd8]) && jpeg.ends_with(&[0xff, 0xd9])
        }));
        assert_eq!(video.ends.last(), Some(&video.bytes.len()));
    }

    #[test]
    fn long_clips_get_small_pictures() {
        assert_eq!([0, 300, 7200, 1_000_000].map(picture_side), [480, 480, 240, 160]);
    }
}
