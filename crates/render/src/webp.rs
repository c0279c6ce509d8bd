//! Animated WebP: lossless pictures in the container (WebP container specification, "Extended File Format").

use std::io::{self, Write};

use image::codecs::webp::WebPEncoder;
use image::{ImageEncoder, ImageError, RgbaImage};

/// Longest side of a picture, pixels: 14 bits of a lossless picture, less one.
const MAX_SIDE: u32 = 1 << 14;
/// Longest time of a picture, milliseconds.
const MAX_MILLISECONDS: u32 = (1 << 24) - 1;
/// Bits of the header's flags: the file is an animation, some pixel is transparent.
const FLAGS: u8 = 0b10 | 0b1_0000;

/// Pictures of one size and how long each is shown, for a file that repeats them for ever.
#[derive(Debug)]
pub struct WebpAnimation {
    size: (u32, u32),
    frames: Vec<u8>,
}

impl WebpAnimation {
    /// An animation without pictures yet, of pictures of `size` pixels.
    ///
    /// # Errors
    /// A side of 0 or more than 16384 pixels.
    pub fn new(size: (u32, u32)) -> io::Result<Self> {
        let allowed = 1..=MAX_SIDE;
        if !allowed.contains(&size.0) || !allowed.contains(&size.1) {
            let what =
                format!("webp: pictures of {} x {} pixels, allowed 1 to {MAX_SIDE} a side", size.0, size.1);
            return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
        }
        Ok(Self { size, frames: Vec::new() })
    }

    /// Adds a picture, shown for `milliseconds` (1 at least, 4.6 hours at most).
    ///
    /// # Errors
    /// The picture has another size, or the encoder fails.
    pub fn push(&mut self, picture: &RgbaImage, milliseconds: u32) -> Result<(), ImageError> {
        let wrong = |what: &str| ImageError::IoError(io::Error::new(io::ErrorKind::InvalidInput, what));
        if picture.dimensions() != self.size {
            return Err(wrong("webp: pictures of an animation have one size"));
        }
        let mut still = Vec::new();
        let encoder = WebPEncoder::new_lossless(&mut still);
        encoder.write_image(picture, self.size.0, self.size.1, image::ExtendedColorType::Rgba8)?;
        let bits =
            lossless_chunk(&still).ok_or_else(|| wrong("webp: the still encoder wrote no VP8L chunk"))?;
        let mut body = Vec::with_capacity(bits.len() + 16);
        // At the top left corner; its place is 0, 0.
        body.extend([0; 6]);
        body.extend(three_bytes(self.size.0 - 1));
        body.extend(three_bytes(self.size.1 - 1));
        body.extend(three_bytes(milliseconds.clamp(1, MAX_MILLISECONDS)));
        // The picture takes the place of what was there, transparent pixels too.
        body.push(0b10);
        chunk(&mut body, b"VP8L", bits);
        chunk(&mut self.frames, b"ANMF", &body);
        Ok(())
    }

    /// Writes the file.
    ///
    /// # Errors
    /// Writing fails, or there are more than 4 GB.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let mut head = Vec::new();
        let mut canvas = vec![FLAGS, 0, 0, 0];
        canvas.extend(three_bytes(self.size.0 - 1));
        canvas.extend(three_bytes(self.size.1 - 1));
        chunk(&mut head, b"VP8X", &canvas);
        // Transparent background, endless repetition.
        chunk(&mut head, b"ANIM", &[0; 6]);
        let length = u32::try_from(4 + head.len() + self.frames.len())
            .map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, "webp: more than 4 GB of pictures"))?;
        out.write_all(b"RIFF")?;
        out.write_all(&length.to_le_bytes())?;
        out.write_all(b"WEBP")?;
        out.write_all(&head)?;
        out.write_all(&self.frames)
    }
}

fn three_bytes(v: u32) -> [u8; 3] {
    let [a, b, c, _] = v.to_le_bytes();
    [a, b, c]
}

fn chunk(out: &mut Vec<u8>, name: &[u8; 4], body: &[u8]) {
    out.extend(name);
    out.extend((body.len() as u32).to_le_bytes());
    out.extend(body);
    if !body.len().is_multiple_of(2) {
        out.push(0);
    }
}

/// The body of the VP8L chunk of a still picture's file.
fn lossless_chunk(file: &[u8]) -> Option<&[u8]> {
    let mut rest = file.get(12..)?;
    loop {
        let (head, tail) = rest.split_at_checked(8)?;
        let length = u32::from_le_bytes(head.get(4..8)?.try_into().ok()?) as usize;
        if head.starts_with(b"VP8L") {
            return tail.get(..length);
        }
        rest = tail.get(length + length % 2..)?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::webp::WebPDecoder;
    use image::{AnimationDecoder, Rgba};

    #[test]
    fn pictures_and_times_come_back() {
        let picture = |i: u8| {
            RgbaImage::from_fn(17, 9, |x, y| {
                Rgba([i * 40, x as u8 * 9, y as u8 * 20, if x < 8 { 255 } else { i * 60 }])
            })
        };
        let mut animation = WebpAnimation::new((17, 9)).unwrap();
        let times = [40, 33, 1000];
        for (i, time) in times.into_iter().enumerate() {
            animation.push(&picture(i as u8 + 1), time).unwrap();
        }
        assert!(animation.push(&RgbaImage::new(3, 9), 40).is_err());
        let mut file = Vec::new();
        animation.write(&mut file).unwrap();
        assert_eq!(file.len(), u32::from_le_bytes(file[4..8].try_into().unwrap()) as usize + 8);
        let decoder = WebPDecoder::new(io::Cursor::new(&file)).unwrap();
        assert!(decoder.has_animation());
        let frames: Vec<_> = decoder.into_frames().collect::<Result<_, _>>().unwrap();
        assert_eq!(frames.len(), 3);
        for (i, frame) in frames.iter().enumerate() {
            assert_eq!(frame.delay().numer_denom_ms(), (times[i], 1));
            assert_eq!(frame.buffer(), &picture(i as u8 + 1), "picture {i}");
        }
    }

    #[test]
    fn impossible_sizes_are_refused() {
        assert!(WebpAnimation::new((0, 9)).is_err() && WebpAnimation::new((9, 16385)).is_err());
    }
}
