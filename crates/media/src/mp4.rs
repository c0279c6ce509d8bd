//! H.264 in MP4 and MOV, demuxed and decoded in the process.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use handcast_limits::Limits;
use image::RgbImage;
use image::imageops::{self, FilterType};
use rusty_h264::{DecodeError, Decoder, YuvFrame};

use super::ffmpeg;
use super::iso::{self, Fault, Movie};
use super::rate::nominal_rate;
use super::sps;
use super::yuv::{Chroma, Converter, YuvMatrix};
use super::{ClipInfo, Frame, FrameError, FrameSource, OpenOptions, check_size};

/// Largest compressed picture accepted, in bytes.
const MAX_SAMPLE: u64 = 1 << 27;
/// H.264 reorders over at most 16 pictures; more waiting means broken time stamps.
const MAX_WAITING: usize = 64;
/// Pixels that H.264 holds at its highest level, in pictures of 16 by 16 (ISO/IEC 14496-10, table A-1: MaxDpbMbs): more
/// waiting means the same.
const MAX_WAITING_PIXELS: u64 = 696_320 * 256;

/// One compressed picture, in decoding order.
#[derive(Clone, Copy, Debug)]
struct Sample {
    offset: u64,
    size: usize,
    /// Position in presentation order, where it is shown.
    rank: Option<usize>,
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

impl Turn {
    /// Width and height after the turn.
    fn size(self, (width, height): (u32, u32)) -> (u32, u32) {
        match self {
            Self::None | Self::Half => (width, height),
            Self::Quarter | Self::ThreeQuarters => (height, width),
        }
    }
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
    /// The first picture, until a frame is asked for: the size of frames may still change.
    first: Option<Decoded>,
    converter: Option<Converter>,
    matrix: YuvMatrix,
    /// Shares to which width and height are shrunk, so that pixels become square.
    square: [f64; 2],
    turn: Turn,
    max_side: Option<u32>,
    /// Decoded pictures that wait for an earlier one, by rank.
    waiting: BTreeMap<usize, (f64, RgbImage)>,
    next_rank: usize,
    annex_b: Vec<u8>,
    /// In which way the file is cut.
    cut: Option<String>,
    /// Pictures that could not be decoded: their ranks until their turn has come, how many, and what is wrong with the first.
    lost: BTreeSet<usize>,
    lost_in_all: usize,
    damage: Option<String>,
    /// Whether the decoder has had nothing yet.
    is_fresh: bool,
    /// When pictures are shown, by rank.
    times: Vec<f64>,
    /// What goes on in place of the decoder, where the helper program has been asked for that.
    helper: Option<Box<dyn FrameSource>>,
    asked: bool,
    path: PathBuf,
    options: OpenOptions,
}

/// A picture out of the decoder, and where it belongs.
struct Decoded {
    /// Position in decoding order.
    number: usize,
    sample: Sample,
    picture: YuvFrame,
}

/// That the tables of a file are sound; files with other codecs pass.
///
/// # Errors
/// As [`Mp4Source::open`], but for those of the decoder.
pub(super) fn check(path: &Path, name: &str, limits: &Limits) -> Result<(), FrameError> {
    match opened(path, name, limits) {
        Err(FrameError::UnsupportedCodec { .. }) => Ok(()),
        checked => checked.map(|_| ()),
    }
}

/// A file and its tables.
fn opened(path: &Path, name: &str, limits: &Limits) -> Result<(BufReader<File>, Movie), FrameError> {
    let io = |source| FrameError::Io { path: name.to_owned(), source };
    let mut file = BufReader::new(File::open(path).map_err(io)?);
    let length = file.get_ref().metadata().map_err(io)?.len();
    let movie = read_movie(&mut file, length, name, limits)?;
    Ok((file, movie))
}

impl Mp4Source {
    pub(super) fn open(path: &Path, name: &str, options: &OpenOptions) -> Result<Self, FrameError> {
        let (file, movie) = opened(path, name, &options.limits)?;
        let mut parameter_sets = Vec::new();
        for unit in movie.sequence_sets.iter().chain(&movie.picture_sets) {
            check_unit(name, unit, &options.limits)?;
            parameter_sets.extend_from_slice(&[0, 0, 0, 1]);
            parameter_sets.extend_from_slice(unit);
        }
        let coded = check_size(name, u64::from(movie.width), u64::from(movie.height), &options.limits)?;
        let vui = movie.sequence_sets.first().and_then(|set| sps::vui(set)).unwrap_or_default();
        let assumed = YuvMatrix::assumed_for(coded.0, coded.1);
        let matrix = YuvMatrix { bt709: vui.bt709.unwrap_or(assumed.bt709), full_range: vui.full_range };
        let samples = samples_of(&movie, name)?;
        let mut times: Vec<f64> = samples.iter().filter(|s| s.rank.is_some()).map(|s| s.time).collect();
        times.sort_by(f64::total_cmp);
        let rate = nominal_rate(&times);
        let (turn, square) = (turn_of(movie.matrix), square(movie.pixel.or(vui.pixel).unwrap_or([1; 2])));
        let (width, height) = turn.size(shrunk(coded, square));
        let mut source = Self {
            name: name.to_owned(),
            file,
            info: ClipInfo {
                width,
                height,
                rate,
                frames: Some(times.len()),
                format: "mp4 h264".to_owned(),
                start: movie.start,
                told: movie.told,
                ..ClipInfo::default()
            },
            samples,
            next_sample: 0,
            length_size: movie.length_size,
            parameter_sets,
            decoder: Decoder::new(),
            first: None,
            converter: None,
            matrix,
            square,
            turn,
            max_side: options.max_side,
            waiting: BTreeMap::new(),
            next_rank: 0,
            annex_b: Vec::new(),
            cut: movie.cut.clone(),
            lost: BTreeSet::new(),
            lost_in_all: 0,
            damage: None,
            is_fresh: true,
            times,
            helper: None,
            asked: false,
            path: path.to_owned(),
            options: options.clone(),
        };
        source.decode_first()?;
        Ok(source)
    }

    /// Decodes the first picture: what the decoder cannot do shows in it. Where it is damaged the helper program takes the
    /// clip, or else the first picture is one behind it.
    fn decode_first(&mut self) -> Result<(), FrameError> {
        let mut wrong = None;
        let first = loop {
            match self.decode_next() {
                Ok(first) => break first,
                Err(error @ FrameError::Malformed { .. }) if self.next_sample < self.samples.len() => {
                    if wrong.is_none() && self.ask_helper(&error) {
                        return Ok(());
                    }
                    self.pass_over(&error);
                    wrong.get_or_insert(error);
                }
                Err(error) => return Err(wrong.unwrap_or(error)),
            }
        };
        let size = self.size_of(&first)?;
        (self.info.width, self.info.height) = self.turn.size(shrunk(size, self.square));
        self.first = Some(first);
        Ok(())
    }

    /// Lets the helper program go on behind the pictures that were given, if it can.
    fn ask_helper(&mut self, error: &FrameError) -> bool {
        if self.asked || self.options.ffmpeg.is_none() {
            return false;
        }
        self.asked = true;
        let options = OpenOptions { max_side: self.max_side, ..self.options.clone() };
        let Ok(helper) = ffmpeg::open(&self.path, &self.name, "mp4", &options) else { return false };
        let [ours, its] = [&self.info, helper.info()].map(|info| (info.width, info.height));
        if self.next_rank == 0 {
            (self.info.width, self.info.height) = its;
        } else if ours != its {
            return false;
        }
        self.damage = error.damage().map(|what| format!("{what}; from there on it was read through ffmpeg"));
        self.waiting.clear();
        self.helper = Some(helper);
        true
    }

    /// The next picture of the helper program behind those that were given.
    fn helped(&mut self) -> Result<Option<Frame>, FrameError> {
        let Some(helper) = &mut self.helper else { return Ok(None) };
        while let Some(frame) = helper.next_frame()? {
            let after = self.times.partition_point(|time| *time < frame.time);
            let off = |rank: &usize| self.times.get(*rank).map_or(f64::INFINITY, |t| (t - frame.time).abs());
            let nearest =
                [after.saturating_sub(1), after].into_iter().min_by(|a, b| off(a).total_cmp(&off(b)));
            let rank = nearest.unwrap_or(after);
            if let Some(time) = self.times.get(rank).filter(|_| rank >= self.next_rank) {
                self.next_rank = rank + 1;
                return Ok(Some(Frame { index: rank, time: *time, ..frame }));
            }
        }
        Ok(None)
    }

    /// Leaves out the picture that was tried last.
    fn pass_over(&mut self, error: &FrameError) {
        let rank = self.next_sample.checked_sub(1).and_then(|at| self.samples.get(at)).and_then(|s| s.rank);
        if let Some(rank) = rank {
            self.lost.insert(rank);
            self.lost_in_all += 1;
        }
        if self.damage.is_none() {
            self.damage = error.damage();
        }
    }

    /// An error in the compressed picture with this number, in decoding order.
    fn malformed(&self, number: usize, what: impl std::fmt::Display) -> FrameError {
        let at =
            self.samples.get(number).map_or_else(String::new, |s| format!(" at {:.3} s", s.time.max(0.0)));
        FrameError::Malformed { path: self.name.clone(), what: format!("frame {number}{at}: {what}") }
    }

    /// Decodes the next sample; there must be one.
    fn decode_next(&mut self) -> Result<Decoded, FrameError> {
        let number = self.next_sample;
        let Some(&sample) = self.samples.get(number) else {
            return Err(self.malformed(number, "there is none"));
        };
        self.next_sample += 1;
        self.read_sample(number, sample)?;
        let (decoder, annex_b) = (&mut self.decoder, &self.annex_b);
        let Ok(decoded) = catch_unwind(AssertUnwindSafe(|| decoder.decode(annex_b))) else {
            self.decoder = Decoder::new();
            self.is_fresh = true;
            return Err(self.malformed(number, "the decoder broke down on it"));
        };
        self.is_fresh = false;
        match decoded {
            Ok(Some(picture)) => Ok(Decoded { number, sample, picture }),
            // A sample without a picture leaves a gap in presentation order.
            Ok(None) => Err(self.malformed(number, "it holds no picture")),
            Err(DecodeError::Unsupported(feature)) => Err(FrameError::UnsupportedCodec {
                path: self.name.clone(),
                codec: format!("H.264 with {feature}"),
                hint: String::new(),
            }),
            Err(error) => Err(self.malformed(number, format_args!("h264: {error}"))),
        }
    }

    /// Reads a sample into `annex_b`: start codes in place of lengths, the parameter sets before what a decoder gets first.
    fn read_sample(&mut self, number: usize, sample: Sample) -> Result<(), FrameError> {
        let name = &self.name;
        let io = |source| FrameError::Io { path: name.clone(), source };
        self.file.seek(SeekFrom::Start(sample.offset)).map_err(io)?;
        let mut data = vec![0; sample.size];
        self.file.read_exact(&mut data).map_err(io)?;
        self.annex_b.clear();
        if self.is_fresh {
            self.annex_b.extend_from_slice(&self.parameter_sets);
        }
        let mut rest = data.as_slice();
        while !rest.is_empty() {
            let (size, after) = rest
                .split_at_checked(self.length_size)
                .ok_or_else(|| self.malformed(number, "a length field is cut"))?;
            let size = size.iter().fold(0usize, |sum, &b| sum << 8 | usize::from(b));
            let (unit, after) = after
                .split_at_checked(size)
                .ok_or_else(|| self.malformed(number, "a NAL unit is longer than its picture"))?;
            check_unit(&self.name, unit, &self.options.limits)?;
            self.annex_b.extend_from_slice(&[0, 0, 0, 1]);
            self.annex_b.extend_from_slice(unit);
            rest = after;
        }
        Ok(())
    }

    /// Whether decoding can begin with a sample: its first slice is one of an IDR picture (ISO/IEC 14496-10, table 7-1).
    fn stands_alone(&mut self, number: usize) -> bool {
        const SLICE: u8 = 1;
        const SLICE_OF_IDR: u8 = 5;
        let Some(sample) = self.samples.get(number).copied() else { return false };
        let mut at = 0usize;
        while at + self.length_size < sample.size {
            let mut head = vec![0; self.length_size + 1];
            let place = SeekFrom::Start(sample.offset + at as u64);
            if self.file.seek(place).and_then(|_| self.file.read_exact(&mut head)).is_err() {
                return false;
            }
            let Some((&kind, size)) = head.split_last() else { return false };
            match kind & 31 {
                SLICE_OF_IDR => return true,
                SLICE..SLICE_OF_IDR => return false,
                _ => {}
            }
            let size = size.iter().fold(0usize, |sum, &b| sum << 8 | usize::from(b));
            at = at.saturating_add(self.length_size).saturating_add(size);
        }
        false
    }

    /// Width and height of a decoded picture, before any turn.
    fn size_of(&self, decoded: &Decoded) -> Result<(u32, u32), FrameError> {
        check_size(
            &self.name,
            decoded.picture.width as u64,
            decoded.picture.height as u64,
            &self.options.limits,
        )
    }

    /// Puts a decoded picture among those that wait for their turn.
    fn keep(&mut self, decoded: Decoded) -> Result<(), FrameError> {
        let size = self.size_of(&decoded)?;
        let Some(rank) = decoded.sample.rank else { return Ok(()) };
        let (matrix, max_side) = (self.matrix, self.max_side);
        let converter = self.converter.get_or_insert_with(|| {
            // ISO/IEC 14496-10, figure E-1: chroma_sample_loc_type 0 unless said otherwise.
            let chroma = Chroma::Planes { log2_x: 1, log2_y: 1, left: true };
            Converter::new(size, chroma, matrix, max_side)
        });
        let picture = &decoded.picture;
        let Some(image) = converter.convert(&picture.y, &picture.u, &picture.v) else {
            return Err(self.malformed(decoded.number, "it has no full planes"));
        };
        let image = if self.square == [1.0; 2] {
            image
        } else {
            let (width, height) = shrunk(image.dimensions(), self.square);
            imageops::resize(&image, width, height, FilterType::Triangle)
        };
        let image = match self.turn {
            Turn::None => image,
            Turn::Quarter => imageops::rotate90(&image),
            Turn::Half => imageops::rotate180(&image),
            Turn::ThreeQuarters => imageops::rotate270(&image),
        };
        self.waiting.insert(rank, (decoded.sample.time, image));
        Ok(())
    }
}

impl FrameSource for Mp4Source {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn set_max_side(&mut self, side: u32) {
        self.max_side = Some(self.max_side.map_or(side, |own| own.min(side)));
    }

    fn times(&self) -> Option<Vec<f64>> {
        Some(self.times.clone())
    }

    fn skip_to(&mut self, seconds: f64) -> Result<(), FrameError> {
        if let Some(helper) = &mut self.helper {
            helper.skip_to(seconds)?;
            self.next_rank = self.times.partition_point(|time| *time < seconds).saturating_sub(1);
            return Ok(());
        }
        let wanted = |sample: &Sample| sample.rank.is_some() && sample.time >= seconds - 1e-3;
        let Some(mut begin) = self.samples.iter().position(wanted) else { return Ok(()) };
        while begin >= self.next_sample && !self.stands_alone(begin) {
            begin -= 1;
        }
        // What has been decoded already leads there.
        if begin < self.next_sample {
            return Ok(());
        }
        let Some(rank) = self.samples.get(begin..).unwrap_or_default().iter().filter_map(|s| s.rank).min()
        else {
            return Ok(());
        };
        (self.next_sample, self.next_rank) = (begin, rank);
        (self.decoder, self.is_fresh, self.first) = (Decoder::new(), true, None);
        self.lost.clear();
        Ok(())
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        if self.helper.is_some() {
            return self.helped();
        }
        if let Some(first) = self.first.take() {
            self.keep(first)?;
        }
        loop {
            while self.lost.remove(&self.next_rank) {
                self.next_rank += 1;
            }
            if let Some((time, image)) = self.waiting.remove(&self.next_rank) {
                let frame = Frame { index: self.next_rank, time, image };
                self.next_rank += 1;
                return Ok(Some(frame));
            }
            if self.next_sample >= self.samples.len() {
                return Ok(None);
            }
            let pixels = |(_, image): &(f64, RgbImage)| u64::from(image.width()) * u64::from(image.height());
            if self.waiting.len() > MAX_WAITING
                || self.waiting.values().map(pixels).sum::<u64>() > MAX_WAITING_PIXELS
            {
                let what = format!("time stamps reorder {} pictures or more", self.waiting.len());
                return Err(FrameError::Malformed { path: self.name.clone(), what });
            }
            match self.decode_next().and_then(|next| self.keep(next)) {
                Ok(()) => {}
                Err(error @ (FrameError::Malformed { .. } | FrameError::UnsupportedCodec { .. })) => {
                    if self.ask_helper(&error) {
                        return self.helped();
                    }
                    let FrameError::Malformed { .. } = error else { return Err(error) };
                    self.pass_over(&error);
                }
                Err(error) => return Err(error),
            }
        }
    }

    fn shortfall(&self) -> Option<String> {
        let lost = match self.lost_in_all {
            0 => None,
            1 => Some("a picture could not be decoded".to_owned()),
            lost => Some(format!("{lost} pictures could not be decoded, the first")),
        };
        let damage = match (lost, &self.damage) {
            (Some(lost), Some(damage)) => Some(format!("{lost}: {damage}")),
            (lost, damage) => lost.or_else(|| damage.clone()),
        };
        let cut = self.cut.as_ref().map(|cut| format!("truncated: {cut}"));
        let its = self.helper.as_ref().and_then(|helper| helper.shortfall());
        let said: Vec<String> = [cut, damage, its].into_iter().flatten().collect();
        (!said.is_empty()).then(|| said.join("; "))
    }
}

/// Refuses a sequence parameter set of pictures that are too large, before the decoder takes memory for them.
fn check_unit(name: &str, unit: &[u8], limits: &Limits) -> Result<(), FrameError> {
    if unit.first().is_none_or(|head| head & 31 != SEQUENCE_SET) {
        return Ok(());
    }
    match sps::size(unit) {
        Some((width, height)) => check_size(name, width, height, limits).map(|_| ()),
        None => Ok(()),
    }
}

/// The type of a NAL unit with a sequence parameter set (ISO/IEC 14496-10, table 7-1).
const SEQUENCE_SET: u8 = 7;

/// The tables of the movie.
fn read_movie(
    file: &mut BufReader<File>,
    length: u64,
    name: &str,
    limits: &Limits,
) -> Result<Movie, FrameError> {
    let path = || name.to_owned();
    iso::read(file, length, limits).map_err(|fault| match fault {
        Fault::Io(source) => FrameError::Io { path: path(), source },
        Fault::Truncated(what) => FrameError::Truncated { path: path(), what },
        Fault::Malformed(what) => FrameError::Malformed { path: path(), what },
        Fault::Codec(codec) => FrameError::UnsupportedCodec { path: path(), codec, hint: String::new() },
        Fault::Missing(what) => FrameError::Empty { path: path(), what },
        Fault::Excess(excess) => FrameError::Excess { path: path(), excess },
    })
}

/// The compressed pictures of a movie with their places in presentation order.
fn samples_of(movie: &Movie, name: &str) -> Result<Vec<Sample>, FrameError> {
    let timescale = f64::from(movie.timescale);
    let mut samples = Vec::with_capacity(movie.pictures.len());
    for (i, picture) in movie.pictures.iter().enumerate() {
        if picture.size > MAX_SAMPLE {
            let what = format!("frame {i} has {} bytes; allowed are {MAX_SAMPLE}", picture.size);
            return Err(FrameError::Malformed { path: name.to_owned(), what });
        }
        let time = picture.time as f64 / timescale;
        samples.push(Sample { offset: picture.offset, size: picture.size as usize, rank: None, time });
    }
    let shown = movie.pictures.iter().enumerate().filter(|(_, picture)| picture.shown);
    let mut order: Vec<(i64, usize)> = shown.map(|(i, picture)| (picture.time, i)).collect();
    order.sort_unstable();
    // Of two at one instant players show the later one: the other lasts no time.
    order.reverse();
    order.dedup_by_key(|(time, _)| *time);
    order.reverse();
    for (rank, &(_, i)) in order.iter().enumerate() {
        if let Some(sample) = samples.get_mut(i) {
            sample.rank = Some(rank);
        }
    }
    if order.is_empty() {
        let what =
            if samples.is_empty() { "the movie has no pictures" } else { "the movie shows no picture" };
        return Err(FrameError::Empty { path: name.to_owned(), what });
    }
    Ok(samples)
}

/// Shares of width and height at which pixels of this shape are square; they are where their shape makes no sense.
fn square([width, height]: [u32; 2]) -> [f64; 2] {
    let ratio = f64::from(width) / f64::from(height);
    match ratio {
        0.1..1.0 => [ratio, 1.0],
        1.0..10.0 => [1.0, ratio.recip()],
        _ => [1.0; 2],
    }
}

fn shrunk((width, height): (u32, u32), [across, down]: [f64; 2]) -> (u32, u32) {
    let size = |side: u32, share: f64| ((f64::from(side) * share).round() as u32).max(1);
    (size(width, across), size(height, down))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_become_square_without_growing() {
        assert_eq!(shrunk((720, 576), square([16, 11])), (720, 396));
        assert_eq!(shrunk((720, 480), square([8, 9])), (640, 480));
        for senseless in [[0, 0], [0, 1], [1, 0], [1, 1000], [1, 1]] {
            assert_eq!(square(senseless), [1.0, 1.0]);
        }
    }
}
