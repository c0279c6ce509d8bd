//! Square pictures as PNG (ISO/IEC 15948): 8 bits a channel, with a palette where 256 colours suffice.

use miniz_oxide::deflate::compress_to_vec_zlib;

/// Effort of the compressor, of 10.
const LEVEL: u8 = 6;

/// The file of a picture of `side` pixels a side, rows from the top.
pub(super) fn encode(side: usize, pixels: &[[u8; 3]]) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let palette = palette(pixels);
    let colour_type = if palette.is_some() { 3 } else { 2 };
    let length = (side as u32).to_be_bytes();
    chunk(&mut out, b"IHDR", &[&length[..], &length[..], &[8, colour_type, 0, 0, 0]].concat());
    let mut rows = Vec::with_capacity(pixels.len() * 3 + side);
    match &palette {
        Some(palette) => {
            chunk(&mut out, b"PLTE", palette.as_flattened());
            for row in pixels.chunks(side.max(1)) {
                rows.push(0);
                // The palette is sorted and holds every colour.
                rows.extend(row.iter().map(|c| palette.binary_search(c).unwrap_or(0) as u8));
            }
        }
        None => {
            let mut above = vec![0; side * 3];
            for row in pixels.chunks(side.max(1)) {
                let row = row.as_flattened();
                rows.extend(filtered(row, &above));
                above.copy_from_slice(row);
            }
        }
    }
    chunk(&mut out, b"IDAT", &compress_to_vec_zlib(&rows, LEVEL));
    chunk(&mut out, b"IEND", &[]);
    out
}

/// The colours in order; `None` for more than 256.
fn palette(pixels: &[[u8; 3]]) -> Option<Vec<[u8; 3]>> {
    let mut colours = std::collections::BTreeSet::new();
    for pixel in pixels {
        colours.insert(*pixel);
        if colours.len() > 256 {
            return None;
        }
    }
    Some(colours.into_iter().collect())
}

/// A row behind its filter's number: that of Sub, Up and Paeth which leaves the smallest differences.
fn filtered(row: &[u8], above: &[u8]) -> Vec<u8> {
    let left = |i: usize| if i < 3 { 0 } else { row[i - 3] };
    let corner = |i: usize| if i < 3 { 0 } else { above[i - 3] };
    let predicted: [(u8, &dyn Fn(usize) -> u8); 3] =
        [(1, &left), (2, &|i| above[i]), (4, &|i| paeth(left(i), above[i], corner(i)))];
    let candidates = predicted.map(|(number, predict)| {
        let rest: Vec<u8> = row.iter().enumerate().map(|(i, v)| v.wrapping_sub(predict(i))).collect();
        let size: u32 = rest.iter().map(|&v| u32::from(v.min(v.wrapping_neg()))).sum();
        (size, number, rest)
    });
    let [first, ..] = &candidates;
    let best = candidates.iter().fold(first, |best, c| if c.0 < best.0 { c } else { best });
    let mut out = vec![best.1];
    out.extend(&best.2);
    out
}

fn paeth(left: u8, above: u8, corner: u8) -> u8 {
    let [a, b, c] = [left, above, corner].map(i16::from);
    let guess = a + b - c;
    let [pa, pb, pc] = [a, b, c].map(|v| (guess - v).abs());
    if pa <= pb && pa <= pc {
        left
    } else if pb <= pc {
        above
    } else {
        corner
    }
}

fn chunk(out: &mut Vec<u8>, kind: &[u8; 4], data: &[u8]) {
    out.extend((data.len() as u32).to_be_bytes());
    let start = out.len();
    out.extend(kind);
    out.extend(data);
    let sum = crc(&out[start..]);
    out.extend(sum.to_be_bytes());
}

/// The check sum of PNG, bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    let mut sum = u32::MAX;
    for byte in bytes {
        sum ^= u32::from(*byte);
        for _ in 0..8 {
            sum = if sum & 1 == 1 { sum >> 1 ^ 0xEDB8_8320 } else { sum >> 1 };
        }
    }
    !sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_sums_are_those_of_the_standard() {
        assert_eq!(crc(b"IEND"), 0xAE42_6082);
        assert_eq!(crc(b"123456789"), 0xCBF4_3926);
    }

    /// Undoes what a reader would undo.
    fn decode(file: &[u8], side: usize) -> Vec<[u8; 3]> {
        let (mut at, mut palette, mut data) = (8, Vec::new(), Vec::new());
        while at < file.len() {
            let length = u32::from_be_bytes(file[at..at + 4].try_into().unwrap()) as usize;
            let (kind, body) = (&file[at + 4..at + 8], &file[at + 8..at + 8 + length]);
            match kind {
                b"PLTE" => palette = body.as_chunks::<3>().0.to_vec(),
                b"IDAT" => data = miniz_oxide::inflate::decompress_to_vec_zlib(body).unwrap(),
                _ => {}
            }
            at += 12 + length;
        }
        let width = if palette.is_empty() { 3 * side } else { side };
        let mut above = vec![0u8; width];
        let mut out = Vec::new();
        for row in data.chunks(width + 1) {
            let mut line = row[1..].to_vec();
            for i in 0..width {
                let left = if i < 3 { 0 } else { line[i - 3] };
                let corner = if i < 3 { 0 } else { above[i - 3] };
                let guess = match row[0] {
                    0 => 0,
                    1 => left,
                    2 => above[i],
                    _ => paeth(left, above[i], corner),
                };
                line[i] = line[i].wrapping_add(guess);
            }
            above.clone_from(&line);
            if palette.is_empty() {
                out.extend(line.as_chunks::<3>().0);
            } else {
                out.extend(line.iter().map(|&i| palette[usize::from(i)]));
            }
        }
        out
    }

    #[test]
    fn pictures_come_back() {
        for colours in [200u32, 5000] {
            let pixel = |i: u32| {
                let v = i.wrapping_mul(2_654_435_761) >> 7;
                [(i / 31) as u8, ((i % colours) % 199) as u8, (v % colours / 20) as u8]
            };
            let pixels: Vec<[u8; 3]> = (0..60 * 60).map(pixel).collect();
            assert_eq!(decode(&encode(60, &pixels), 60), pixels);
        }
        let plain = encode(32, &[[7, 8, 9]; 1024]);
        assert_eq!(decode(&plain, 32), [[7, 8, 9]; 1024]);
        assert!(plain.len() < 120);
    }
}
