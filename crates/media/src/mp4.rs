//! H.264 in MP4 and MOV, demuxed and decoded in the process.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use image::{RgbImage, imageops};
use re_mp4::{Mp4, StsdBoxContent, TrackKind};
use rusty_h264::{DecodeError, Decoder, YuvFrame};

use super::sps;
use super::yuv::{Chroma, Converter, YuvMatrix};
use super::{ClipInfo, Frame, FrameError, FrameSource, OpenOptions, check_size};

/// Largest compressed picture accepted, in bytes.
const MAX_SAMPLE: u64 = 1 << 27;
/// H.264 reorders over at most 16 pictures; more waiting means broken time stamps.
const MAX_WAITING: usize = 64;

/// One compressed picture, in decoding order.
#[derive(Clone, Copy, Debug)]
struct Sample {
    offset: u64,
    size: usize,
    /// Position in presentation order.
    rank: usize,
    /// Seconds from the first picture.
    time: f64,
}

/// Clockwise turns the file asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    None,
    Quarter,
    Half,
    ThreeQuarters,
}

/// Frames of an MP4 or MOV file with H.264.
pub(super) struct Mp4Source {
    name: String,
    file: BufReader<File>,
    info: ClipInfo,
    samples: Vec<Sample>,
    next_sample: usize,
    length_size: usize,
    parameter_sets: Vec<u8>,
    decoder: Decoder,
    converter: Option<Converter>,
    matrix: YuvMatrix,
    turn: Turn,
    max_side: Option<u32>,
    /// Decoded pictures that wait for an earlier one, by rank.
    waiting: BTreeMap<usize, (f64, RgbImage)>,
    next_rank: usize,
    index: usize,
    annex_b: Vec<u8>,
}

impl Mp4Source {
    pub(super) fn open(path: &Path, name: &str, options: &OpenOptions) -> Result<Self, FrameError> {
        let io = |source| FrameError::Io { path: name.to_owned(), source };
        let malformed = |what: String| FrameError::Malformed { path: name.to_owned(), what };
        let unsupported = |codec: String| FrameError::UnsupportedCodec {
            path: name.to_owned(),
            codec,
            hint: String::new(),
        };
        let mut file = BufReader::new(File::open(path).map_err(io)?);
        let length = file.get_ref().metadata().map_err(io)?.len();
        check_boxes(&mut file, length, name)?;
        file.seek(SeekFrom::Start(0)).map_err(io)?;
        // The demuxer indexes its tables unchecked: a panic in it means tables that contradict each other.
        let mp4 = catch_unwind(AssertUnwindSafe(|| Mp4::read(&mut file, length)))
            .map_err(|_| malformed("the tables of the movie contradict each other".to_owned()))?
            .map_err(|error| malformed(format!("mp4: {error}")))?;
        let mut other = None;
        let mut chosen = None;
        for track in mp4.tracks().values() {
            let contents = &track.trak(&mp4).mdia.minf.stbl.stsd.contents;
            match contents {
                StsdBoxContent::Avc1(avc1) if chosen.is_none() => chosen = Some((track, avc1)),
                StsdBoxContent::Unknown(four)
                    if &track.trak(&mp4).mdia.hdlr.handler_type.value == b"vide" =>
                {
                    other = Some(four.to_string());
                }
                _ if track.kind == Some(TrackKind::Video) => {
                    other = Some(match contents {
                        StsdBoxContent::Hev1(_) | StsdBoxContent::Hvc1(_) => "HEVC (H.265)".to_owned(),
                        StsdBoxContent::Av01(_) => "AV1".to_owned(),
                        StsdBoxContent::Vp08(_) => "VP8".to_owned(),
                        StsdBoxContent::Vp09(_) => "VP9".to_owned(),
                        _ => "this video codec".to_owned(),
                    });
                }
                _ => {}
            }
        }
        let Some((track, avc1)) = chosen else {
            return Err(match other {
                Some(codec) => unsupported(codec),
                None => FrameError::Empty { path: name.to_owned(), what: "the movie has no video track" },
            });
        };
        let avcc = &avc1.avcc;
        let mut parameter_sets = Vec::new();
        for unit in avcc.sequence_parameter_sets.iter().chain(&avcc.picture_parameter_sets) {
            parameter_sets.extend_from_slice(&[0, 0, 0, 1]);
            parameter_sets.extend_from_slice(&unit.bytes);
        }
        let (coded_width, coded_height) = check_size(name, u64::from(avc1.width), u64::from(avc1.height))?;
        let colour = avcc.sequence_parameter_sets.first().and_then(|set| sps::colour(&set.bytes));
        let colour = colour.unwrap_or_default();
        let assumed = YuvMatrix::assumed_for(coded_width, coded_height);
        let matrix =
            YuvMatrix { bt709: colour.bt709.unwrap_or(assumed.bt709), full_range: colour.full_range };
        let timescale = track.timescale.max(1) as f64;
        let mut order: Vec<usize> = (0..track.samples.len()).collect();
        order.sort_by_key(|&i| track.samples.get(i).map_or(0, |s| s.composition_timestamp));
        let start = order.first().and_then(|&i| track.samples.get(i)).map_or(0, |s| s.composition_timestamp);
        let mut samples = Vec::with_capacity(track.samples.len());
        for (i, sample) in track.samples.iter().enumerate() {
            let end = sample.offset.checked_add(sample.size);
            if end.is_none_or(|end| end > length) {
                let total = track.samples.len();
                let what = format!("frame {i} of {total} lies beyond the end of the file");
                return Err(FrameError::Truncated { path: name.to_owned(), what });
            }
            if sample.size > MAX_SAMPLE {
                return Err(malformed(format!(
                    "frame {i} has {} bytes; allowed are {MAX_SAMPLE}",
                    sample.size
                )));
            }
            let time = (sample.composition_timestamp - start) as f64 / timescale;
            samples.push(Sample { offset: sample.offset, size: sample.size as usize, rank: 0, time });
        }
        for (rank, &i) in order.iter().enumerate() {
            if let Some(sample) = samples.get_mut(i) {
                sample.rank = rank;
            }
        }
        if samples.is_empty() {
            return Err(FrameError::Empty { path: name.to_owned(), what: "the movie has no pictures" });
        }
        let last = samples.iter().map(|s| s.time).fold(0.0, f64::max);
        let rate = (samples.len() > 1 && last > 0.0).then(|| (samples.len() - 1) as f64 / last);
        let matrix_entries = &track.trak(&mp4).tkhd.matrix;
        let turn = turn_of([matrix_entries.a, matrix_entries.b, matrix_entries.c, matrix_entries.d]);
        let (width, height) = match turn {
            Turn::None | Turn::Half => (coded_width, coded_height),
            Turn::Quarter | Turn::ThreeQuarters => (coded_height, coded_width),
        };
        let frames = Some(samples.len());
        let mut source = Self {
            name: name.to_owned(),
            file,
            info: ClipInfo { width, height, rate, frames, format: "mp4 h264".to_owned() },
            samples,
            next_sample: 0,
            length_size: usize::from(avcc.length_size_minus_one & 3) + 1,
            parameter_sets,
            decoder: Decoder::new(),
            converter: None,
            matrix,
            turn,
            max_side: options.max_side,
            waiting: BTreeMap::new(),
            next_rank: 0,
            index: 0,
            annex_b: Vec::new(),
        };
        // What the decoder cannot do shows in the first picture.
        source.decode_next()?;
        Ok(source)
    }

    /// Decodes one sample into `waiting`.
    fn decode_next(&mut self) -> Result<(), FrameError> {
        let number = self.next_sample;
        let Some(&sample) = self.samples.get(number) else { return Ok(()) };
        self.next_sample += 1;
        let name = self.name.clone();
        let malformed = |what: String| FrameError::Malformed {
            path: name.clone(),
            what: format!("frame {number}: {what}"),
        };
        let io = |source| FrameError::Io { path: name.clone(), source };
        self.file.seek(SeekFrom::Start(sample.offset)).map_err(io)?;
        let mut data = vec![0; sample.size];
        self.file.read_exact(&mut data).map_err(io)?;
        self.annex_b.clear();
        if number == 0 {
            self.annex_b.extend_from_slice(&self.parameter_sets);
        }
        let mut rest = data.as_slice();
        while !rest.is_empty() {
            let (size, after) = rest
                .split_at_checked(self.length_size)
                .ok_or_else(|| malformed("a length field is cut".to_owned()))?;
            let size = size.iter().fold(0usize, |sum, &b| sum << 8 | usize::from(b));
            let (unit, after) = after
                .split_at_checked(size)
                .ok_or_else(|| malformed("a NAL unit is longer than its picture".to_owned()))?;
            self.annex_b.extend_from_slice(&[0, 0, 0, 1]);
            self.annex_b.extend_from_slice(unit);
            rest = after;
        }
        let (decoder, annex_b) = (&mut self.decoder, &self.annex_b);
        let decoded = catch_unwind(AssertUnwindSafe(|| decoder.decode(annex_b)))
            .map_err(|_| malformed("the decoder broke down on it".to_owned()))?;
        match decoded {
            Ok(Some(picture)) => {
                let image =
                    self.rgb_of(&picture).ok_or_else(|| malformed("it has no full planes".to_owned()))?;
                self.waiting.insert(sample.rank, (sample.time, image));
                Ok(())
            }
            // A sample without a picture leaves a gap in presentation order.
            Ok(None) => Err(malformed("it holds no picture".to_owned())),
            Err(DecodeError::Unsupported(feature)) => Err(FrameError::UnsupportedCodec {
                path: self.name.clone(),
                codec: format!("H.264 with {feature}"),
                hint: String::new(),
            }),
            Err(error) => Err(malformed(format!("h264: {error}"))),
        }
    }

    fn rgb_of(&mut self, picture: &YuvFrame) -> Option<RgbImage> {
        let size = (u32::try_from(picture.width).ok()?, u32::try_from(picture.height).ok()?);
        check_size(&self.name, u64::from(size.0), u64::from(size.1)).ok()?;
        if self.converter.is_none() {
            // ISO/IEC 14496-10, figure E-1: chroma_sample_loc_type 0 unless said otherwise.
            let chroma = Chroma::Planes { log2_x: 1, log2_y: 1, left: true };
            self.converter = Some(Converter::new(size, chroma, self.matrix, self.max_side));
            let turned = matches!(self.turn, Turn::Quarter | Turn::ThreeQuarters);
            (self.info.width, self.info.height) = if turned { (size.1, size.0) } else { size };
        }
        let image = self.converter.as_mut()?.convert(&picture.y, &picture.u, &picture.v)?;
        Some(match self.turn {
            Turn::None => image,
            Turn::Quarter => imageops::rotate90(&image),
            Turn::Half => imageops::rotate180(&image),
            Turn::ThreeQuarters => imageops::rotate270(&image),
        })
    }
}

impl FrameSource for Mp4Source {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        loop {
            if let Some((time, image)) = self.waiting.remove(&self.next_rank) {
                let frame = Frame { index: self.index, time, image };
                self.next_rank += 1;
                self.index += 1;
                return Ok(Some(frame));
            }
            if self.next_sample >= self.samples.len() {
                return Ok(None);
            }
            if self.waiting.len() > MAX_WAITING {
                return Err(FrameError::Malformed {
                    path: self.name.clone(),
                    what: format!("time stamps reorder more than {MAX_WAITING} pictures"),
                });
            }
            self.decode_next()?;
        }
    }
}

/// Walks the outer boxes, to tell a file that is cut from one that is wrong.
fn check_boxes(file: &mut BufReader<File>, length: u64, name: &str) -> Result<(), FrameError> {
    let mut at = 0u64;
    let mut movie = false;
    while at < length {
        let cut = |what: String| FrameError::Truncated { path: name.to_owned(), what };
        let io = |source| FrameError::Io { path: name.to_owned(), source };
        if at + 8 > length {
            return Err(cut(format!("a box header at byte {at} is cut")));
        }
        file.seek(SeekFrom::Start(at)).map_err(io)?;
        let mut head = [0u8; 16];
        let wanted = if at + 16 <= length { 16 } else { 8 };
        file.read_exact(&mut head[..wanted]).map_err(io)?;
        let [a, b, c, d, kind @ .., e, f, g, h, i, j, k, l] = head;
        let size = match u32::from_be_bytes([a, b, c, d]) {
            0 => length - at,
            1 => u64::from_be_bytes([e, f, g, h, i, j, k, l]),
            size => u64::from(size),
        };
        if size < 8 {
            let what = format!("the box at byte {at} says it has {size} bytes");
            return Err(FrameError::Malformed { path: name.to_owned(), what });
        }
        if size > length - at {
            let kind = String::from_utf8_lossy(&kind).into_owned();
            return Err(cut(format!(
                "the box {kind} at byte {at} says {size} bytes; {} are left",
                length - at
            )));
        }
        movie |= &kind == b"moov";
        at += size;
    }
    if movie {
        Ok(())
    } else {
        Err(FrameError::Truncated {
            path: name.to_owned(),
            what: "the box moov, which describes the movie, is missing".to_owned(),
        })
    }
}

/// From the entries a, b, c, d of the track's matrix (ISO/IEC 14496-12, 8.3.2).
fn turn_of(matrix: [i32; 4]) -> Turn {
    match matrix.map(i32::signum) {
        [0, 1, -1, 0] => Turn::Quarter,
        [-1, 0, 0, -1] => Turn::Half,
        [0, -1, 1, 0] => Turn::ThreeQuarters,
        _ => Turn::None,
    }
}
