//! YUV4MPEG2: a text header, then raw planes, as video tools write it into a pipe.

use std::io::{self, BufRead, BufReader, Read};

use super::yuv::{Chroma, Converter, YuvMatrix};
use super::{ClipInfo, Frame, FrameError, FrameSource, OpenOptions, check_size};

/// Longest header line accepted; the usual one has 60 bytes.
const MAX_LINE: usize = 4096;

/// Frames of a Y4M stream, read forwards only.
pub(super) struct Y4mSource {
    name: String,
    reader: BufReader<Box<dyn Read + Send>>,
    info: ClipInfo,
    rate: f64,
    chroma: Chroma,
    converter: Converter,
    planes: Vec<u8>,
    alpha: bool,
    index: usize,
}

/// The planes of a colour space, and whether there is one of opacity.
fn planes_of(colour: &str) -> Option<(Chroma, bool)> {
    let planes = |log2_x, log2_y, left| Chroma::Planes { log2_x, log2_y, left };
    Some(match colour {
        "420jpeg" => (planes(1, 1, false), false),
        "420" | "420mpeg2" | "420paldv" => (planes(1, 1, true), false),
        "422" => (planes(1, 0, true), false),
        "444" => (planes(0, 0, false), false),
        "444alpha" => (planes(0, 0, false), true),
        "411" => (planes(2, 0, true), false),
        "mono" => (Chroma::Mono, false),
        _ => return None,
    })
}

impl Y4mSource {
    /// Reads the header. `matrix` overrides what the header says or leaves open.
    pub(super) fn open(
        reader: Box<dyn Read + Send>,
        name: &str,
        options: &OpenOptions,
        matrix: Option<YuvMatrix>,
    ) -> Result<Self, FrameError> {
        let mut reader = BufReader::with_capacity(1 << 16, reader);
        let line = read_line(&mut reader, name)?;
        let malformed = |what: String| FrameError::Malformed { path: name.to_owned(), what };
        if line.is_empty() {
            return Err(FrameError::Empty { path: name.to_owned(), what: "no bytes" });
        }
        let text = std::str::from_utf8(&line).unwrap_or_default();
        let mut fields = text.trim_end_matches('\n').split(' ');
        if fields.next() != Some("YUV4MPEG2") {
            let what = "a pipe must carry Y4M, which begins with YUV4MPEG2".to_owned();
            return Err(FrameError::NotAVideo { path: name.to_owned(), what });
        }
        let (mut width, mut height, mut rate) = (0u64, 0u64, None);
        let (mut colour, mut full_range) = ("420jpeg", false);
        for field in fields.filter(|f| !f.is_empty()) {
            let mut letters = field.chars();
            let key = letters.next();
            let value = letters.as_str();
            match key {
                Some('W') => width = number(value).map_err(malformed)?,
                Some('H') => height = number(value).map_err(malformed)?,
                Some('F') => rate = ratio(value).map_err(malformed)?,
                Some('C') => colour = value,
                Some('X') => full_range |= value == "COLORRANGE=FULL",
                Some('I') if !matches!(value, "p" | "?") => {
                    return Err(FrameError::UnsupportedCodec {
                        path: name.to_owned(),
                        codec: format!("interlaced Y4M (I{value})"),
                        hint: "; make frames of its fields first: ffmpeg -i CLIP -vf yadif OUT.mp4"
                            .to_owned(),
                    });
                }
                _ => {}
            }
        }
        let (width, height) = check_size(name, width, height, &options.limits)?;
        let Some((chroma, alpha)) = planes_of(colour) else {
            return Err(FrameError::UnsupportedCodec {
                path: name.to_owned(),
                codec: format!("Y4M colour space C{colour}"),
                hint: "; supported are 420, 422, 444, 411 and mono of 8 bits".to_owned(),
            });
        };
        let matrix = matrix.unwrap_or(YuvMatrix { full_range, ..YuvMatrix::assumed_for(width, height) });
        let rate = rate.unwrap_or(options.rate);
        let size = chroma.size(width, height);
        let luma = width as usize * height as usize;
        let length = luma * if alpha { 2 } else { 1 } + 2 * size.0 as usize * size.1 as usize;
        Ok(Self {
            name: name.to_owned(),
            reader,
            info: ClipInfo {
                width,
                height,
                rate: Some(rate),
                format: format!("y4m {colour}"),
                ..ClipInfo::default()
            },
            rate,
            chroma,
            converter: Converter::new((width, height), chroma, matrix, options.max_side),
            planes: vec![0; length],
            alpha,
            index: 0,
        })
    }

    /// Tells where its pictures come from, and the seconds of the file at which they begin.
    pub(super) fn set_origin(&mut self, format: String, start: f64) {
        self.info.format = format;
        self.info.start = start;
    }
}

impl FrameSource for Y4mSource {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn set_max_side(&mut self, side: u32) {
        self.converter.limit(side);
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let line = read_line(&mut self.reader, &self.name)?;
        if line.is_empty() {
            return Ok(None);
        }
        if !line.starts_with(b"FRAME") {
            let what = format!("frame {}: the line FRAME is missing", self.index);
            return Err(FrameError::Malformed { path: self.name.clone(), what });
        }
        self.reader.read_exact(&mut self.planes).map_err(|source| match source.kind() {
            io::ErrorKind::UnexpectedEof => FrameError::Truncated {
                path: self.name.clone(),
                what: format!("frame {} is shorter than {} bytes", self.index, self.planes.len()),
            },
            _ => FrameError::Io { path: self.name.clone(), source },
        })?;
        let luma = self.info.width as usize * self.info.height as usize;
        let size = self.chroma.size(self.info.width, self.info.height);
        let chroma = size.0 as usize * size.1 as usize;
        debug_assert_eq!(self.planes.len(), luma * if self.alpha { 2 } else { 1 } + 2 * chroma);
        let (y, rest) = self.planes.split_at(luma);
        let (cb, rest) = rest.split_at(chroma);
        let Some(image) = self.converter.convert(y, cb, rest) else { return Ok(None) };
        let frame = Frame { index: self.index, time: self.index as f64 / self.rate, image };
        self.index += 1;
        Ok(Some(frame))
    }
}

/// A line with its end; empty at the end of the input.
fn read_line(reader: &mut impl BufRead, name: &str) -> Result<Vec<u8>, FrameError> {
    let mut line = Vec::new();
    reader
        .by_ref()
        .take(MAX_LINE as u64)
        .read_until(b'\n', &mut line)
        .map_err(|source| FrameError::Io { path: name.to_owned(), source })?;
    if line.last().is_some_and(|&b| b != b'\n') {
        if line.starts_with(b"YUV4MPEG2") || line.starts_with(b"FRAME") || b"FRAME".starts_with(&line) {
            let what = "a header line has no end".to_owned();
            return Err(FrameError::Truncated { path: name.to_owned(), what });
        }
        // The caller names what it expected instead.
        line.truncate(16);
    }
    Ok(line)
}

fn number(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("header: {text:?} is not a number"))
}

/// `a:b` as a rate; `0:0` means unknown.
fn ratio(text: &str) -> Result<Option<f64>, String> {
    let wrong = || format!("header: {text:?} is not a frame rate");
    let (a, b) = text.split_once(':').ok_or_else(wrong)?;
    let (a, b): (u32, u32) = (a.parse().map_err(|_| wrong())?, b.parse().map_err(|_| wrong())?);
    Ok((a > 0 && b > 0).then(|| f64::from(a) / f64::from(b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(bytes: &[u8]) -> Result<Y4mSource, FrameError> {
        Y4mSource::open(Box::new(io::Cursor::new(bytes.to_vec())), "test", &OpenOptions::default(), None)
    }

    #[test]
    fn frames_times_and_colours() {
        for (colour, chroma) in [("420jpeg", 2), ("422", 4), ("444", 8), ("mono", 0)] {
            let mut bytes = format!("YUV4MPEG2 W4 H2 F30000:1001 Ip A1:1 C{colour}\n").into_bytes();
            for luma in [16u8, 235] {
                bytes.extend_from_slice(b"FRAME\n");
                bytes.extend(std::iter::repeat_n(luma, 8));
                bytes.extend(std::iter::repeat_n(128, 2 * chroma));
            }
            let mut source = open(&bytes).unwrap();
            assert_eq!((source.info().width, source.info().height), (4, 2));
            let first = source.next_frame().unwrap().unwrap();
            assert_eq!((first.index, first.time), (0, 0.0));
            assert!(first.image.pixels().all(|p| p.0 == [0, 0, 0]));
            let second = source.next_frame().unwrap().unwrap();
            assert!((second.time - 1001.0 / 30000.0).abs() < 1e-12);
            assert!(second.image.pixels().all(|p| p.0 == [255, 255, 255]));
            assert!(source.next_frame().unwrap().is_none());
        }
    }

    #[test]
    fn faults_have_their_own_errors() {
        assert!(matches!(open(b""), Err(FrameError::Empty { .. })));
        assert!(matches!(open(b"hello\n"), Err(FrameError::NotAVideo { .. })));
        assert!(matches!(open(b"YUV4MPEG2 W4"), Err(FrameError::Truncated { .. })));
        assert!(matches!(open(b"YUV4MPEG2 W4 H2 It\n"), Err(FrameError::UnsupportedCodec { .. })));
        assert!(matches!(open(b"YUV4MPEG2 W4 H2 C420p10\n"), Err(FrameError::UnsupportedCodec { .. })));
        assert!(matches!(open(b"YUV4MPEG2 W4 H0\n"), Err(FrameError::Size { .. })));
        assert!(matches!(open(b"YUV4MPEG2 W99999999 H99999999\n"), Err(FrameError::Size { .. })));
        assert!(matches!(open(b"YUV4MPEG2 Wx H2\n"), Err(FrameError::Malformed { .. })));
        let mut short = open(b"YUV4MPEG2 W4 H2\nFRAME\n0123").unwrap();
        assert!(matches!(short.next_frame(), Err(FrameError::Truncated { .. })));
        assert!(matches!(short.next_frame(), Ok(None)));
        let mut wrong = open(b"YUV4MPEG2 W4 H2\nGRAME\n0123").unwrap();
        assert!(matches!(wrong.next_frame(), Err(FrameError::Malformed { .. })));
    }
}
