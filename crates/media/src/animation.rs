//! Still and animated pictures: PNG, JPEG, GIF, WebP, BMP, PNM.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

#[cfg(feature = "pictures")]
use image::AnimationDecoder;
#[cfg(feature = "pictures")]
use image::codecs::{gif::GifDecoder, png::PngDecoder, webp::WebPDecoder};
use image::{
    DynamicImage, Frames, ImageDecoder, ImageError, ImageFormat, ImageReader, Rgb, RgbImage, RgbaImage,
};

use super::prefetch::Prefetch;
use super::{ClipInfo, Frame, FrameError, FrameSource, OpenOptions, check_size, wrong_size};
use handcast_limits::{Limit, Limits};
use handcast_picture::Shrinker;

/// What players show for a frame that says it lasts no time.
const DEFAULT_DELAY: f64 = 0.1;

/// Opens a picture as a source of one frame, or of all its frames if it moves.
pub(super) fn open(
    path: &Path,
    name: &str,
    format: ImageFormat,
    options: &OpenOptions,
) -> Result<Box<dyn FrameSource>, FrameError> {
    let label = format.extensions_str().first().copied().unwrap_or("picture");
    let limits = &options.limits;
    check_parts(path, format)?;
    let Some(animation) =
        open_animation(path, format, limits).map_err(|error| failed(path, error, limits))?
    else {
        let image = picture(path, reader_of(path, format, limits)?, limits)?;
        let (width, height) = image.dimensions();
        let info = ClipInfo {
            width,
            height,
            frames: Some(1),
            format: format!("{label} picture"),
            ..ClipInfo::default()
        };
        let shrinker = Shrinker::new(options.max_side);
        return Ok(Box::new(StillSource { info, image: Some(image), shrinker }));
    };
    let (width, height) = check_size(name, u64::from(animation.size.0), u64::from(animation.size.1), limits)?;
    drop(animation);
    let info = ClipInfo { width, height, format: format!("{label} animation"), ..ClipInfo::default() };
    let (path, limits) = (path.to_path_buf(), limits.clone());
    // The decoders of `image` cannot move between threads, so the whole decoding lives on one.
    let mut source = Prefetch::from_producer(info, 2, move |max_side, send| {
        if let Err(error) = play(&path, format, &limits, Shrinker::new(max_side), send) {
            send(Err(failed(&path, error, &limits)));
        }
        None
    });
    if let Some(side) = options.max_side {
        source.set_max_side(side);
    }
    Ok(Box::new(source))
}

struct Animation {
    size: (u32, u32),
    frames: Frames<'static>,
}

/// `None` when the picture does not move.
#[cfg(feature = "pictures")]
fn open_animation(
    path: &Path,
    format: ImageFormat,
    limits: &Limits,
) -> Result<Option<Animation>, ImageError> {
    let reader = BufReader::new(File::open(path)?);
    let limits = decoder_limits(limits);
    Ok(match format {
        ImageFormat::Gif => {
            let mut decoder = GifDecoder::new(reader)?;
            decoder.set_limits(limits)?;
            Some(Animation { size: decoder.dimensions(), frames: decoder.into_frames() })
        }
        ImageFormat::Png => {
            let decoder = PngDecoder::with_limits(reader, limits)?;
            let size = decoder.dimensions();
            if decoder.is_apng()? {
                Some(Animation { size, frames: decoder.apng()?.into_frames() })
            } else {
                None
            }
        }
        ImageFormat::WebP => {
            let mut decoder = WebPDecoder::new(reader)?;
            decoder.set_limits(limits)?;
            if decoder.has_animation() {
                Some(Animation { size: decoder.dimensions(), frames: decoder.into_frames() })
            } else {
                None
            }
        }
        _ => None,
    })
}

/// Without the formats that can move, no picture does.
#[cfg(not(feature = "pictures"))]
fn open_animation(_: &Path, _: ImageFormat, _: &Limits) -> Result<Option<Animation>, ImageError> {
    Ok(None)
}

fn play(
    path: &Path,
    format: ImageFormat,
    limits: &Limits,
    mut shrinker: Shrinker,
    send: &dyn Fn(Result<Frame, FrameError>) -> bool,
) -> Result<(), ImageError> {
    let Some(animation) = open_animation(path, format, limits)? else { return Ok(()) };
    let mut time = 0.0;
    for (index, frame) in animation.frames.enumerate() {
        let frame = frame?;
        let (numerator, denominator) = frame.delay().numer_denom_ms();
        let delay = f64::from(numerator) / f64::from(denominator.max(1)) / 1000.0;
        let image = shrinker.rgb(on_white(frame.buffer()));
        if !send(Ok(Frame { index, time, image })) {
            return Ok(());
        }
        time += if delay > 0.0 { delay } else { DEFAULT_DELAY };
    }
    Ok(())
}

/// Transparent pixels show white, as on a page.
fn on_white(image: &RgbaImage) -> RgbImage {
    RgbImage::from_fn(image.width(), image.height(), |x, y| {
        let [r, g, b, a] = image.get_pixel(x, y).0;
        let over = |v: u8| ((u32::from(v) * u32::from(a) + 255 * (255 - u32::from(a)) + 127) / 255) as u8;
        Rgb([over(r), over(g), over(b)])
    })
}

struct StillSource {
    info: ClipInfo,
    image: Option<RgbImage>,
    shrinker: Shrinker,
}

impl FrameSource for StillSource {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    fn set_max_side(&mut self, side: u32) {
        self.shrinker.limit(side);
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        Ok(self.image.take().map(|image| Frame { index: 0, time: 0.0, image: self.shrinker.rgb(image) }))
    }
}

/// The same limits in the words of `image`.
pub(super) fn decoder_limits(limits: &Limits) -> image::Limits {
    let side = u32::try_from(limits.side).unwrap_or(u32::MAX);
    let mut told = image::Limits::default();
    told.max_image_width = Some(side);
    told.max_image_height = Some(side);
    // Sixteen bits of four channels at most, and as much again for the decoder.
    told.max_alloc = Some(limits.pixels.saturating_mul(16));
    told
}

/// What pictures are decoded from.
trait Input: BufRead + Seek {}

impl<T: BufRead + Seek> Input for T {}

fn unreadable(path: &Path, source: io::Error) -> FrameError {
    let path = path.display().to_string();
    match source.kind() {
        io::ErrorKind::NotFound => FrameError::NotFound { path },
        _ => FrameError::Io { path, source },
    }
}

/// A reader of a picture of whatever format, whose parts have been checked.
fn reader(path: &Path, limits: &Limits) -> Result<ImageReader<Box<dyn Input>>, FrameError> {
    let found = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let Some(format) = found.map_err(|source| unreadable(path, source))?.format() else {
        let what = "no picture format begins like this".to_owned();
        return Err(FrameError::NotAVideo { path: path.display().to_string(), what });
    };
    check_parts(path, format)?;
    reader_of(path, format, limits)
}

/// The same of a picture whose parts have been checked. Of a JPEG, which its decoder takes in as a whole, it has nothing
/// behind the end.
fn reader_of(
    path: &Path,
    format: ImageFormat,
    limits: &Limits,
) -> Result<ImageReader<Box<dyn Input>>, FrameError> {
    let file = File::open(path).map_err(|source| unreadable(path, source))?;
    let input: Box<dyn Input> = match format {
        ImageFormat::Jpeg => Box::new(whole_jpeg(path, file, limits)?),
        _ => Box::new(BufReader::new(file)),
    };
    let mut reader = ImageReader::with_format(input, format);
    reader.limits(decoder_limits(limits));
    Ok(reader)
}

/// A JPEG from its beginning to its end. Decoders fill with grey what is missing of a picture that is cut, which is refused
/// here.
fn whole_jpeg(path: &Path, file: File, limits: &Limits) -> Result<io::Take<BufReader<File>>, FrameError> {
    let io = |source| FrameError::Io { path: path.display().to_string(), source };
    let length = file.metadata().map_err(io)?.len();
    let mut file = BufReader::with_capacity(1 << 16, file);
    let Some(end) = end_of_jpeg(&mut file, limits.bytes).map_err(io)? else {
        // It may be that there is one behind as many bytes as allowed.
        limits
            .check(Limit::Bytes, length as f64)
            .map_err(|excess| FrameError::Excess { path: path.display().to_string(), excess })?;
        let what = "the picture is cut: it has no end".to_owned();
        return Err(FrameError::Malformed { path: path.display().to_string(), what });
    };
    file.rewind().map_err(io)?;
    Ok(file.take(end))
}

/// Where a JPEG ends, which begins at byte 0: behind the first end of image that lies in no segment (ISO/IEC 10918-1, B.1.1 and
/// B.2). There may be anything behind it: a film, another picture. `None` where there is none within `most` bytes.
fn end_of_jpeg(file: &mut (impl BufRead + Seek), most: u64) -> io::Result<Option<u64>> {
    let (mut at, mut in_scan) = (0u64, false);
    loop {
        // Whatever is no marker is data of a scan, or nothing that decoders know.
        at += file.skip_until(0xff)? as u64;
        let mut code = 0xff;
        while code == 0xff {
            let Some([next]) = next_of(file)? else { return Ok(None) };
            (code, at) = (next, at + 1);
        }
        if at > most {
            return Ok(None);
        }
        let has_length = match code {
            0xd9 => return Ok(Some(at)),
            // A byte of data, single markers.
            0x00 | 0x01 | 0xd0..=0xd8 => false,
            // What else may stand in a scan is damage, which decoders pass over.
            _ => !in_scan || matches!(code, 0xc4 | 0xcc | 0xda..=0xdf | 0xe0..=0xef | 0xfe),
        };
        if has_length {
            let Some(length) = next_of(file)? else { return Ok(None) };
            let length = u16::from_be_bytes(length).max(2);
            file.seek_relative(i64::from(length) - 2)?;
            at += u64::from(length);
        }
        in_scan |= code == 0xda;
    }
}

/// The next bytes, `None` at the end.
fn next_of<const N: usize>(file: &mut impl Read) -> io::Result<Option<[u8; N]>> {
    match next_bytes(file) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
        bytes => bytes.map(Some),
    }
}

/// What decoders take for granted, and would break down or swell by where it does not hold.
fn check_parts(path: &Path, format: ImageFormat) -> Result<(), FrameError> {
    let found = match format {
        ImageFormat::Png => odd_palette(path),
        ImageFormat::WebP => odd_picture(path),
        _ => Ok(None),
    };
    match found {
        Ok(None) => Ok(()),
        // Cut files are the decoder's to tell.
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(()),
        Ok(Some(what)) => Err(FrameError::Malformed { path: path.display().to_string(), what }),
        Err(source) => Err(FrameError::Io { path: path.display().to_string(), source }),
    }
}

/// Bytes of the palette of a PNG, three a colour, of 256 colours at most.
const LARGEST_PALETTE: u32 = 768;

/// What is wrong with the palette of a PNG.
fn odd_palette(path: &Path) -> io::Result<Option<String>> {
    let mut file = BufReader::new(File::open(path)?);
    file.seek_relative(8)?;
    loop {
        let [a, b, c, d, kind @ ..] = next_bytes::<8>(&mut file)?;
        let length = u32::from_be_bytes([a, b, c, d]);
        match &kind {
            b"PLTE" if length % 3 != 0 || length > LARGEST_PALETTE => {
                let allowed = "allowed 3 for each of at most 256 colours";
                return Ok(Some(format!("the palette has {length} bytes, {allowed}")));
            }
            b"PLTE" | b"IDAT" | b"IEND" => return Ok(None),
            // With its checksum.
            _ => file.seek_relative(i64::from(length) + 4)?,
        }
    }
}

/// What is wrong with the sizes in a WebP file, for which room is made before they are compared: no picture may be larger
/// than its canvas or of another size than its frame, no other part larger than the file.
fn odd_picture(path: &Path) -> io::Result<Option<String>> {
    let mut file = BufReader::new(File::open(path)?);
    let whole = file.get_ref().metadata()?.len();
    let mut canvas: Option<[u32; 2]> = None;
    let mut at = 12;
    loop {
        let part = WebpPart::read(&mut file, at)?;
        let mut parts = vec![part];
        if part.kind == *b"ANMF" {
            // A picture, or transparency and a picture; whatever their lengths, the decoder goes on behind the frame.
            let mut inner = at + 24;
            while parts.len() < 3 && inner + 8 <= part.end {
                let Ok(within) = WebpPart::read(&mut file, inner) else { break };
                parts.push(within);
                inner = within.end;
            }
        }
        for found in &parts {
            if !found.is_picture() && found.length > whole {
                return Ok(Some(format!("a part of {} bytes in a file of {whole}", found.length)));
            }
            let Some([width, height]) = found.size else { continue };
            if let Some([most, highest]) = canvas.filter(|&[most, highest]| width > most || height > highest)
            {
                return Ok(Some(format!("a picture of {width}×{height} on a canvas of {most}×{highest}")));
            }
            if let Some([w, h]) = part.size.filter(|&size| found.is_picture() && size != [width, height]) {
                return Ok(Some(format!("a picture of {width}×{height} in a frame of {w}×{h}")));
            }
        }
        if part.kind == *b"VP8X" {
            canvas = canvas.or(part.size);
        }
        at = part.end;
    }
}

/// A part of a WebP file.
#[derive(Clone, Copy)]
struct WebpPart {
    kind: [u8; 4],
    /// Bytes of what it holds.
    length: u64,
    /// Where the next part begins.
    end: u64,
    /// Width and height, of canvas, frames and pictures.
    size: Option<[u32; 2]>,
}

impl WebpPart {
    fn is_picture(&self) -> bool {
        matches!(&self.kind, b"VP8 " | b"VP8L")
    }

    fn read(file: &mut (impl Read + Seek), at: u64) -> io::Result<Self> {
        file.seek(SeekFrom::Start(at))?;
        let [kind @ .., a, b, c, d] = next_bytes::<8>(file)?;
        let length = u64::from(u32::from_le_bytes([a, b, c, d]));
        let three = |w: [u8; 3]| u32::from_le_bytes([w[0], w[1], w[2], 0]) + 1;
        let size = match &kind {
            b"VP8X" => {
                let [_, _, _, _, w0, w1, w2, h0, h1, h2] = next_bytes::<10>(file)?;
                Some([three([w0, w1, w2]), three([h0, h1, h2])])
            }
            b"ANMF" => {
                let [_, _, _, _, _, _, w0, w1, w2, h0, h1, h2] = next_bytes::<12>(file)?;
                Some([three([w0, w1, w2]), three([h0, h1, h2])])
            }
            b"VP8 " => {
                let [.., w0, w1, h0, h1] = next_bytes::<10>(file)?;
                Some([[w0, w1], [h0, h1]].map(|v| u32::from(u16::from_le_bytes(v) & 0x3fff)))
            }
            b"VP8L" => {
                let [_, bits @ ..] = next_bytes::<5>(file)?;
                let bits = u32::from_le_bytes(bits);
                Some([bits, bits >> 14].map(|v| (v & 0x3fff) + 1))
            }
            _ => None,
        };
        Ok(Self { kind, length, end: at + 8 + length + length % 2, size })
    }
}

fn next_bytes<const N: usize>(file: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// Width and height, turned as the picture asks for.
pub(super) fn dimensions(path: &Path, limits: &Limits) -> Result<(u32, u32), FrameError> {
    let fail = |error| failed(path, error, limits);
    let mut decoder = reader(path, limits)?.into_decoder().map_err(fail)?;
    let (width, height) = decoder.dimensions();
    use image::metadata::Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    let turned =
        matches!(decoder.orientation().map_err(fail)?, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH);
    Ok(if turned { (height, width) } else { (width, height) })
}

/// Reads one picture, turned as it asks for; of an animation the first frame.
///
/// # Errors
/// The file is missing, damaged, no picture, or too large.
pub(super) fn read_picture(path: &Path, limits: &Limits) -> Result<RgbImage, FrameError> {
    picture(path, reader(path, limits)?, limits)
}

fn picture(
    path: &Path,
    reader: ImageReader<Box<dyn Input>>,
    limits: &Limits,
) -> Result<RgbImage, FrameError> {
    let name = path.display().to_string();
    let fail = |error| failed(path, error, limits);
    let mut decoder = reader.into_decoder().map_err(fail)?;
    let (width, height) = decoder.dimensions();
    check_size(&name, u64::from(width), u64::from(height), limits)?;
    let orientation = decoder.orientation().map_err(fail)?;
    let mut image = DynamicImage::from_decoder(decoder).map_err(fail)?;
    image.apply_orientation(orientation);
    Ok(match image {
        DynamicImage::ImageRgb8(rgb) => rgb,
        other if other.color().has_alpha() => on_white(&other.to_rgba8()),
        other => other.to_rgb8(),
    })
}

/// The variant of [`FrameError`] for an error of `image` about a file.
fn failed(path: &Path, error: ImageError, limits: &Limits) -> FrameError {
    let name = path.display().to_string();
    let too_large = matches!(error, ImageError::Limits(_));
    match too_large.then(|| stated_size(path, limits)).flatten() {
        Some((width, height)) => wrong_size(&name, width.into(), height.into(), limits),
        None => translate(&name, error),
    }
}

/// The size that the header of a picture states, whatever it is.
fn stated_size(path: &Path, limits: &Limits) -> Option<(u32, u32)> {
    let mut reader = reader(path, limits).ok()?;
    reader.no_limits();
    reader.into_dimensions().ok()
}

/// The variant of [`FrameError`] for an error of `image`.
pub(super) fn translate(name: &str, error: ImageError) -> FrameError {
    let path = name.to_owned();
    match error {
        ImageError::IoError(source) if source.kind() == io::ErrorKind::UnexpectedEof => {
            FrameError::Truncated { path, what: "the picture data ends too early".to_owned() }
        }
        ImageError::IoError(source) => FrameError::Io { path, source },
        ImageError::Unsupported(error) => {
            FrameError::UnsupportedCodec { path, codec: error.to_string(), hint: String::new() }
        }
        ImageError::Limits(error) => FrameError::Malformed { path, what: error.to_string() },
        other => FrameError::Malformed { path, what: other.to_string() },
    }
}
