//! Arrays of NumPy: `.npy` files, and `.npz`, a zip of them.

use std::io::{Cursor, Read};

use handcast_limits::{Limit, Limits};
use zip::ZipArchive;

/// Numbers in rows, or texts.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Array {
    /// Its lengths, the outermost first.
    pub shape: Vec<usize>,
    /// The numbers, row by row.
    pub data: Vec<f64>,
    /// The texts, where it is one of texts.
    pub texts: Vec<String>,
}

/// Bytes of the headers of a zip's entry before its name, and what every zip begins with.
const LOCAL_HEADER: usize = 30;
const ZIP: &[u8] = b"PK\x03\x04";
/// What every `.npy` file begins with, and the longest header that is read.
const NPY: &[u8] = b"\x93NUMPY";
const LONGEST_HEADER: usize = 4096;
/// Most lengths of an array.
const MOST_LENGTHS: usize = 8;

/// A zip whose first entry is an array.
pub(super) fn sniff(bytes: &[u8]) -> bool {
    let length = bytes.get(26..28).map_or(0, |l| usize::from(l[0]) | usize::from(l[1]) << 8);
    let name = bytes.get(LOCAL_HEADER..).and_then(|rest| rest.get(..length));
    bytes.starts_with(ZIP) && name.is_some_and(|name| name.ends_with(b".npy"))
}

/// A lone array.
pub(super) fn is_array(bytes: &[u8]) -> bool {
    bytes.starts_with(NPY)
}

/// The array of a file of one.
///
/// # Errors
/// What is no array of numbers, and more of them than allowed.
pub(super) fn alone(bytes: &[u8], limits: &Limits) -> Result<Array, String> {
    let mut room = Room { bytes: 0, numbers: 0, most: NUMBERS + bytes.len() / 2 };
    npy(bytes, &mut room, limits)?.ok_or_else(|| "an array of objects, allowed are numbers".into())
}

/// Numbers that are held of a file, besides one for each two of its bytes: compressed ones may have any number.
const NUMBERS: usize = 1 << 21;

/// The arrays of a file that `wanted` names. Arrays of objects, which only Python can read, are left out.
///
/// # Errors
/// What is no zip of arrays, and more bytes or numbers than allowed once inflated.
pub(super) fn arrays(
    bytes: &[u8],
    wanted: impl Fn(&str) -> bool,
    limits: &Limits,
) -> Result<Vec<(String, Array)>, String> {
    let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(|e| format!("no zip: {e}"))?;
    let mut out = Vec::new();
    let mut room = Room { bytes: 0, numbers: 0, most: NUMBERS + bytes.len() / 2 };
    for i in 0..zip.len() {
        let entry = zip.by_index(i).map_err(|e| format!("entry {i}: {e}"))?;
        let entry_name = entry.name().map_err(|e| format!("entry {i}: {e}"))?;
        let Some(name) = entry_name.strip_suffix(".npy").map(str::to_owned) else { continue };
        drop(entry_name);
        if !wanted(&name) {
            continue;
        }
        if let Some(array) = npy(entry, &mut room, limits).map_err(|what| format!("{name}.npy: {what}"))? {
            out.push((name, array));
        }
    }
    Ok(out)
}

/// What the arrays of a file hold so far, and may.
struct Room {
    bytes: usize,
    numbers: usize,
    most: usize,
}

impl Room {
    /// Takes so many numbers, or bytes of texts.
    fn take(&mut self, numbers: usize, bytes: usize, limits: &Limits) -> Result<(), String> {
        self.bytes = self.bytes.saturating_add(bytes);
        limits.check_count(Limit::Bytes, self.bytes).map_err(|excess| excess.to_string())?;
        self.numbers = self.numbers.saturating_add(numbers.max(bytes / 8));
        if self.numbers > self.most {
            return Err(format!(
                "{} numbers, allowed at most {} in a file of its size",
                self.numbers, self.most
            ));
        }
        Ok(())
    }
}

/// An array; `None` for one of objects.
fn npy(mut file: impl Read, room: &mut Room, limits: &Limits) -> Result<Option<Array>, String> {
    let mut read = |length: usize, what: &str| {
        let mut bytes = Vec::with_capacity(length);
        file.by_ref().take(length as u64).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
        if bytes.len() == length { Ok(bytes) } else { Err(what.to_owned()) }
    };
    let start = read(NPY.len() + 2, "no array of NumPy")?;
    let version = start.strip_prefix(NPY).ok_or("no array of NumPy")?;
    let length = match version {
        [1, _] => 2,
        [2 | 3, _] => 4,
        _ => return Err("a version of NumPy's format that is not known".into()),
    };
    let cut = "it ends in its header";
    let length = read(length, cut)?.iter().rev().fold(0, |length, &byte| length << 8 | usize::from(byte));
    if length > LONGEST_HEADER {
        return Err(format!("a header of {length} bytes, allowed at most {LONGEST_HEADER}"));
    }
    let header = read(length, cut)?;
    let header = String::from_utf8_lossy(&header);
    let kind = after(&header, "descr").and_then(quoted).ok_or("its header tells no simple type")?;
    let columns_first = after(&header, "fortran_order").is_some_and(|rest| rest.starts_with("True"));
    let shape = after(&header, "shape").and_then(shape).ok_or("its header tells no shape")?;
    let count =
        shape.iter().try_fold(1usize, |n, m| n.checked_mul(*m)).ok_or("more numbers than there can be")?;
    let Some(size) = size_of(kind)? else { return Ok(None) };
    let bytes = count.checked_mul(size).ok_or("more numbers than there can be")?;
    room.take(count, bytes, limits)?;
    let data = read(bytes, &format!("it ends before its {count} values"))?;
    // At its end the checksum is looked at.
    file.read(&mut [0]).map_err(|e| e.to_string())?;
    let mut array = values(kind, size, &data, count);
    if columns_first && shape.len() > 1 {
        array.data = by_rows(&array.data, &shape);
    }
    array.shape = shape;
    Ok(Some(array))
}

/// What stands behind a key of the header, which is a dictionary of Python.
fn after<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let at = ["'", "\""].into_iter().find_map(|quote| {
        let named = format!("{quote}{key}{quote}");
        Some(header.find(&named)? + named.len())
    })?;
    Some(header[at..].trim_start().strip_prefix(':')?.trim_start())
}

fn quoted(text: &str) -> Option<&str> {
    let quote = text.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    text[1..].split(quote).next()
}

fn shape(text: &str) -> Option<Vec<usize>> {
    let inside = text.strip_prefix('(')?.split(')').next()?;
    let lengths =
        inside.split(',').map(str::trim).filter(|part| !part.is_empty()).map(|part| part.parse().ok());
    let lengths: Vec<usize> = lengths.collect::<Option<_>>()?;
    (lengths.len() <= MOST_LENGTHS).then_some(lengths)
}

/// The order of the bytes and the letters of a type.
fn split(kind: &str) -> (&str, &str) {
    kind.split_at(kind.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(0))
}

/// Bytes of a value of a type of NumPy; `None` for objects.
fn size_of(kind: &str) -> Result<Option<usize>, String> {
    Ok(Some(match split(kind).1 {
        "f2" | "i2" | "u2" => 2,
        "f4" | "i4" | "u4" => 4,
        "f8" | "i8" | "u8" => 8,
        "i1" | "u1" | "b1" | "?" => 1,
        "O" => return Ok(None),
        text if text.starts_with(['U', 'S']) => {
            let of_one = if text.starts_with('U') { 4 } else { 1 };
            text[1..]
                .parse::<usize>()
                .ok()
                .and_then(|n| n.checked_mul(of_one))
                .ok_or("a type that is not known")?
        }
        other => return Err(format!("values of type {other:.20?}, allowed are numbers and texts")),
    }))
}

/// So many values of a type of NumPy.
fn values(kind: &str, size: usize, data: &[u8], count: usize) -> Array {
    let (order, kind) = split(kind);
    let big = order == ">";
    if kind.starts_with(['U', 'S']) {
        let text = |value: &[u8]| -> String {
            let letters: Vec<u8> = if kind.starts_with('U') {
                value.iter().step_by(4).copied().collect()
            } else {
                value.to_vec()
            };
            String::from_utf8_lossy(&letters).trim_end_matches('\0').to_owned()
        };
        let texts = if size == 0 {
            vec![String::new(); count.min(1)]
        } else {
            data.chunks_exact(size).map(text).collect()
        };
        return Array { texts, ..Array::default() };
    }
    let number = |value: &[u8]| {
        let mut bytes = [0u8; 8];
        for (to, from) in bytes.iter_mut().zip(value) {
            *to = *from;
        }
        if big {
            bytes[..size].reverse();
        }
        let whole = u64::from_le_bytes(bytes);
        let signed = || (whole as i64) << (64 - 8 * size) >> (64 - 8 * size);
        match &kind[..1] {
            "f" => match size {
                2 => half(whole as u16),
                4 => f64::from(f32::from_bits(whole as u32)),
                _ => f64::from_bits(whole),
            },
            "i" => signed() as f64,
            _ => whole as f64,
        }
    };
    Array { data: data.chunks_exact(size).map(number).collect(), ..Array::default() }
}

/// IEEE 754 binary16.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    let size = match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1024.0 + fraction) * 2f64.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}

/// Numbers whose first index runs first, put so that the last one does.
fn by_rows(data: &[f64], shape: &[usize]) -> Vec<f64> {
    let mut index = vec![0usize; shape.len()];
    let mut out = Vec::with_capacity(data.len());
    for _ in 0..data.len() {
        let (mut at, mut stride) = (0, 1);
        for (i, length) in index.iter().zip(shape) {
            at += i * stride;
            stride *= length;
        }
        out.push(data.get(at).copied().unwrap_or(f64::NAN));
        for (i, length) in index.iter_mut().zip(shape).rev() {
            *i += 1;
            if *i < *length {
                break;
            }
            *i = 0;
        }
    }
    out
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::io::Write;
    use zip::write::SimpleFileOptions;

    fn file(kind: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let mut header = format!("{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}");
        while !(10 + header.len() + 1).is_multiple_of(64) {
            header.push(' ');
        }
        header.push('\n');
        let mut out = NPY.to_vec();
        out.extend([1, 0]);
        out.extend((header.len() as u16).to_le_bytes());
        out.extend(header.bytes());
        out.extend(data);
        out
    }

    /// An array of doubles as NumPy writes it.
    pub(in crate::landmarks) fn doubles(shape: &str, data: &[f64]) -> Vec<u8> {
        file("<f8", "False", shape, &data.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())
    }

    /// A zip of arrays, deflated as by `savez_compressed`.
    pub(in crate::landmarks) fn zipped(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, file) in files {
            let options = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
            zip.start_file(format!("{name}.npy"), options).unwrap();
            zip.write_all(file).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    fn read_alone(file: &[u8]) -> Result<Option<Array>, String> {
        npy(file, &mut Room { bytes: 0, numbers: 0, most: 10_000 }, &Limits::default())
    }

    #[test]
    fn types_and_orders_are_read() {
        let read = |file: Vec<u8>| read_alone(&file).unwrap().unwrap();
        assert_eq!(read(doubles("(2, 3)", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])).data[4], 5.0);
        let columns =
            file("<f8", "True", "(2, 3)", &[1.0, 4.0, 2.0, 5.0, 3.0, 6.0].map(f64::to_le_bytes).concat());
        assert_eq!(read(columns), read(doubles("(2, 3)", &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])));
        assert_eq!(
            read(file(">f4", "False", "(2,)", &[1.5f32, -2.0].map(f32::to_be_bytes).concat())).data,
            [1.5, -2.0]
        );
        assert_eq!(
            read(file("<i2", "False", "(2,)", &[-3i16, 9].map(i16::to_le_bytes).concat())).data,
            [-3.0, 9.0]
        );
        assert_eq!(read(file("|b1", "False", "()", &[1])).data, [1.0]);
        assert_eq!(
            read(file("<f2", "False", "(3,)", &[0, 0x3c, 0, 0xc0, 1, 0])).data,
            [1.0, -2.0, 2f64.powi(-24)]
        );
        let text: Vec<u8> = "left\0".chars().flat_map(|c| (c as u32).to_le_bytes()).collect();
        assert_eq!(read(file("<U5", "False", "()", &text)).texts, ["left"]);
        assert_eq!(read_alone(&file("|O", "False", "()", b"pickle")).unwrap(), None);
    }

    #[test]
    fn damaged_arrays_are_refused() {
        for (file, words) in [
            (b"none".to_vec(), "no array of NumPy"),
            (doubles("(9999999999, 9999999999, 9999999999)", &[]), "more numbers than there can be"),
            (doubles("(4,)", &[1.0]), "it ends before its 4 values"),
            (doubles("(5000, 3)", &[]), "15000 numbers, allowed at most 10000"),
            (file("<U9999", "False", "(3,)", &[]), "14998 numbers, allowed at most 10000"),
            (doubles("x", &[]), "no shape"),
            (file("<c16", "False", "()", &[0; 16]), "type \"c16\""),
            (NPY.iter().copied().chain([1, 0, 255, 255]).collect(), "a header of 65535 bytes"),
        ] {
            let message = read_alone(&file).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
        let all = |_: &str| true;
        let whole = zipped(&[("a", doubles("(1000,)", &[0.0; 1000]))]);
        assert!(sniff(&whole) && !sniff(b"PK\x03\x04"));
        assert_eq!(arrays(&whole, all, &Limits::default()).unwrap()[0].1.data.len(), 1000);
        assert_eq!(arrays(&whole, |name| name == "b", &Limits::default()).unwrap(), []);
        let message = arrays(&whole, all, &Limits::default().with_bytes(2000)).unwrap_err();
        assert!(message.contains("a.npy: ") && message.contains("allowed at most"), "{message}");
        for cut in [10, 60, whole.len() / 2, whole.len() - 1] {
            arrays(&whole[..cut], all, &Limits::default()).unwrap_err();
        }
    }
}
