//! Numbers as text that a page decodes to typed arrays.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;

/// Bytes in base64 (RFC 4648, with padding).
pub(super) fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let value = group.iter().fold(0u32, |v, &b| v << 8 | u32::from(b)) << (8 * (3 - group.len()));
        for k in 0..4 {
            let digit = ALPHABET[(value >> (18 - 6 * k)) as usize & 63];
            text.push(if k <= group.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

/// Bytes deflated (RFC 1950), in base64.
pub(super) fn deflated(bytes: &[u8]) -> String {
    let mut out = ZlibEncoder::new(Vec::new(), Compression::best());
    // A vector takes what it is given.
    let packed = out.write_all(bytes).and_then(|()| out.finish());
    base64(&packed.unwrap_or_default())
}

/// Numbers deflated, in base64, little-endian.
pub(super) fn array<T, const N: usize>(
    values: impl IntoIterator<Item = T>,
    bytes: fn(T) -> [u8; N],
) -> String {
    deflated(&values.into_iter().flat_map(bytes).collect::<Vec<u8>>())
}

/// −1..=1 as a normalised short.
pub(super) fn short(v: f64) -> i16 {
    (v.clamp(-1.0, 1.0) * 32767.0).round() as i16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_as_in_the_standard() {
        let words = [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")];
        for (plain, coded) in words {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn numbers_come_back() {
        assert_eq!(inflated(&array([1.0f32, -2.0], f32::to_le_bytes)), [0, 0, 128, 63, 0, 0, 0, 192]);
    }
}

#[cfg(test)]
pub(super) use testing::inflated;

#[cfg(test)]
mod testing {
    use std::io::Read;

    /// What a text in base64 stands for.
    pub(crate) fn bytes(text: &str) -> Vec<u8> {
        let value = |c: u8| match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' => 62,
            _ => 63,
        };
        let mut out = Vec::new();
        for group in text.trim_end_matches('=').as_bytes().chunks(4) {
            let bits =
                group.iter().fold(0u32, |v, &c| v << 6 | u32::from(value(c))) << (6 * (4 - group.len()));
            out.extend(&bits.to_be_bytes()[1..group.len()]);
        }
        out
    }

    /// What was deflated.
    pub(crate) fn inflated(text: &str) -> Vec<u8> {
        let mut out = Vec::new();
        flate2::read::ZlibDecoder::new(&bytes(text)[..]).read_to_end(&mut out).unwrap();
        out
    }
}
