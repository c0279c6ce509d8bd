//! What a page holds beside its text: bytes one after another, deflated, as UTF-16.
//!
//! A page is UTF-16 from its byte order mark on, because in it bytes take hardly more room than they are (base64 in UTF-8: a
//! third). The mark outweighs whatever a server says of the character set (WHATWG HTML, 13.2.3.2), and what stands for bytes are
//! characters, which stay what they are in a page that is written anew in UTF-8.

use std::io::Write;
use std::ops::Range;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde::{Serialize, Serializer};

/// Bits that a group of [`UNITS`] units holds: digits of base 29, the first one first, are a number of [`UPPER`] bits, and each
/// unit has [`LOWER`] more.
const GROUP: usize = UPPER + UNITS * LOWER;
/// 29 to the power of 7 is a little more than 2 to the power of 34.
const UNITS: usize = 7;
const UPPER: usize = 34;
const LOWER: usize = 11;
/// Units of 2048 in a row are a digit. Those that are not used have control characters, ASCII and what ends an element (the first),
/// surrogates (the 27th), the byte order mark and what is no character (the last).
const BASE: u64 = 29;

/// Where bytes are among the [`Parts`] of a page; in its JSON the first and how many.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Part(Range<usize>);

impl Serialize for Part {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        [self.0.start, self.0.len()].serialize(to)
    }
}

/// Bytes that a page's JSON names by their place.
#[derive(Debug, Default)]
pub(super) struct Parts(Vec<u8>);

impl Parts {
    /// Takes bytes in.
    pub(super) fn add(&mut self, bytes: &[u8]) -> Part {
        self.add_all(bytes.iter().map(|&byte| [byte]))
    }

    /// Takes numbers in, little-endian.
    pub(super) fn numbers<T, const N: usize>(
        &mut self,
        values: impl IntoIterator<Item = T>,
        bytes: fn(T) -> [u8; N],
    ) -> Part {
        self.add_all(values.into_iter().map(bytes))
    }

    fn add_all<const N: usize>(&mut self, bytes: impl Iterator<Item = [u8; N]>) -> Part {
        let first = self.0.len();
        self.0.extend(bytes.flatten());
        Part(first..self.0.len())
    }

    /// The bytes, the JSON that names them, and its length (32 bits, little-endian).
    ///
    /// # Errors
    /// There is no such JSON.
    pub(super) fn and(self, json: &impl Serialize) -> serde_json::Result<Vec<u8>> {
        let mut body = self.0;
        let first = body.len();
        serde_json::to_writer(&mut body, json)?;
        let length = u32::try_from(body.len() - first).map_err(serde::ser::Error::custom)?;
        body.extend(length.to_le_bytes());
        Ok(body)
    }
}

/// The file of a page.
#[derive(Debug)]
pub(super) struct PageFile(Vec<u8>);

impl PageFile {
    /// An empty one.
    pub(super) fn new() -> Self {
        Self(vec![0xff, 0xfe])
    }

    /// Adds text.
    pub(super) fn text(&mut self, text: &str) {
        self.units(text.encode_utf16());
    }

    /// Adds an element with bytes, deflated as `level` says (RFC 1950). It is a script of no language, which browsers leave alone.
    pub(super) fn bytes(&mut self, id: &str, bytes: &[u8], level: Compression) {
        let mut out = ZlibEncoder::new(Vec::new(), level);
        // A vector takes what it is given.
        let packed = out.write_all(bytes).and_then(|()| out.finish()).unwrap_or_default();
        let length = packed.len();
        self.text(&format!(
            "<script type=\"application/octet-stream\" id=\"{id}\" data-length=\"{length}\">"
        ));
        self.0.reserve(2 * UNITS * (8 * length).div_ceil(GROUP));
        self.units(groups(&packed).flatten());
        self.text("</script>\n");
    }

    fn units(&mut self, units: impl Iterator<Item = u16>) {
        self.0.extend(units.flat_map(u16::to_le_bytes));
    }

    /// Its bytes.
    pub(super) fn finish(self) -> Vec<u8> {
        self.0
    }
}

/// Bytes as groups of units; behind the last byte there are zeros.
fn groups(bytes: &[u8]) -> impl Iterator<Item = [u16; UNITS]> {
    let mut rest = bytes.iter();
    let (mut value, mut held) = (0u64, 0);
    let mut bits = move |count: usize| {
        while held < count {
            value = value << 8 | u64::from(rest.next().copied().unwrap_or_default());
            held += 8;
        }
        held -= count;
        let bits = value >> held;
        value &= (1 << held) - 1;
        bits
    };
    (0..(8 * bytes.len()).div_ceil(GROUP)).map(move |_| {
        let mut number = bits(UPPER);
        let mut group = [0; UNITS];
        for unit in group.iter_mut().rev() {
            let digit = number % BASE;
            number /= BASE;
            *unit = (digit + if digit < 26 { 1 } else { 2 }) << LOWER;
        }
        group.map(|upper| (upper | bits(LOWER)) as u16)
    })
}

/// −1..=1 as a normalised short.
pub(super) fn short(v: f64) -> i16 {
    (v.clamp(-1.0, 1.0) * 32767.0).round() as i16
}

#[cfg(test)]
mod tests {
    use super::testing::{packed, text};
    use super::*;

    /// Bytes of every kind, of any length.
    #[test]
    fn bytes_come_back() {
        let mut word = 1u32;
        let mut noise = || {
            word = word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (word >> 24) as u8
        };
        let noise: Vec<u8> = (0..5000).map(|_| noise()).collect();
        for bytes in [&[][..], &[0], &[255; 14], &[0; 300], b"</script><!--", &noise, &noise[..4997]] {
            for level in [Compression::none(), Compression::best()] {
                let mut file = PageFile::new();
                file.text("<p>±𝄞");
                file.bytes("x", bytes, level);
                let text = text(&file.finish());
                assert!(text.starts_with("<p>±𝄞<script"));
                assert_eq!(packed(&text, "x"), bytes);
            }
        }
    }

    #[test]
    fn bytes_are_characters_that_mean_nothing_else_and_hardly_more_of_them() {
        let bytes: Vec<u8> = (0..=65535u16).flat_map(u16::to_le_bytes).collect();
        let units: Vec<u16> = groups(&bytes).flatten().collect();
        assert!((2 * units.len()) as f64 / (bytes.len() as f64) < 1.0091);
        for unit in units {
            assert!((0x800..0xd800).contains(&unit) || (0xe000..0xf800).contains(&unit), "{unit:x}");
        }
    }

    #[test]
    fn parts_are_where_the_json_says() {
        let mut parts = Parts::default();
        let named = [parts.add(b"ab"), parts.numbers([1.0f32, -2.0], f32::to_le_bytes), parts.add(b"")];
        let body = parts.and(&named).unwrap();
        assert_eq!(body, b"ab\0\0\x80?\0\0\0\xc0[[0,2],[2,8],[10,0]]\x14\0\0\0");
    }
}

#[cfg(test)]
pub(super) mod testing {
    use super::*;
    use std::io::Read;

    /// The text of a page.
    pub(crate) fn text(page: &[u8]) -> String {
        let units: Vec<u16> = page.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect();
        assert_eq!((units[0], page.len() % 2), (0xfeff, 0));
        String::from_utf16(&units[1..]).unwrap()
    }

    /// The bytes in an element of it.
    pub(crate) fn packed(text: &str, id: &str) -> Vec<u8> {
        let (_, rest) = text.split_once(&format!(" id=\"{id}\" data-length=\"")).unwrap();
        let (length, rest) = rest.split_once("\">").unwrap();
        let units: Vec<u16> = rest.split_once('<').unwrap().0.encode_utf16().collect();
        let mut bits = Vec::new();
        let mut put = |number: u64, count: usize| bits.extend((0..count).rev().map(|k| number >> k & 1));
        for group in units.chunks(UNITS) {
            let digit = |unit: &u16| (1..32).filter(|k| ![27, 31].contains(k)).position(|k| k == unit >> 11);
            put(group.iter().fold(0, |n, unit| n * BASE + digit(unit).unwrap() as u64), UPPER);
            group.iter().for_each(|&unit| put(u64::from(unit) & 0x7ff, LOWER));
        }
        let byte = |bits: &[u64; 8]| bits.iter().fold(0, |byte, &bit| byte << 1 | bit as u8);
        let mut bytes: Vec<u8> = bits.as_chunks::<8>().0.iter().map(byte).collect();
        assert!(bytes.len() < length.parse::<usize>().unwrap() + 14);
        bytes.truncate(length.parse().unwrap());
        let mut out = Vec::new();
        flate2::read::ZlibDecoder::new(&bytes[..]).read_to_end(&mut out).unwrap();
        out
    }

    impl Parts {
        /// The bytes of a part.
        pub(crate) fn of(&self, part: &Part) -> &[u8] {
            &self.0[part.0.clone()]
        }
    }
}
