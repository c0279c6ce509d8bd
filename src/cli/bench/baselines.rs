//! What other ways to store the same motion take.

use anyhow::Context;
use handcast_fba::bap::Unit;
use handcast_fba::encoder::degrees_per_unit;
use handcast_fba::plan::TimedBapFrame;

/// Level of compression: the strongest that is in common use.
const LEVEL: i32 = 19;

/// Bytes that a clip takes in other formats. All but the integers keep more precision than the codec does.
#[derive(Clone, Copy, Debug, Default)]
pub struct Baselines {
    /// 32-bit floats: 29 angles and 6 global values a frame.
    pub f32: usize,
    /// 16-bit floats.
    pub f16: usize,
    /// 32-bit floats, the whole clip through zstd -19.
    pub f32_zstd: usize,
    /// 16-bit floats, the whole clip through zstd -19.
    pub f16_zstd: usize,
    /// Integer differences from frame to frame at the step that makes the codec's error, as bytes, the whole
    /// clip through zstd -19; by frame or by value, whichever is smaller.
    pub deltas_zstd: usize,
}

impl Baselines {
    /// Measures a clip; `rms` is the error, in degrees over the angles that are ever other than 0, that the integers may make.
    pub fn measure(frames: &[TimedBapFrame], rms: f64) -> anyhow::Result<Self> {
        let columns = columns(frames);
        let count = frames.len();
        let values = |width: usize| {
            let rows = (0..count).flat_map(|frame| columns.iter().map(move |column| column.degrees[frame]));
            let mut bytes = Vec::with_capacity(count * columns.len() * width);
            for value in rows {
                match width {
                    4 => bytes.extend((value as f32).to_le_bytes()),
                    _ => bytes.extend(half(value as f32).to_le_bytes()),
                }
            }
            bytes
        };
        let (f32, f16) = (values(4), values(2));
        Ok(Self {
            f32: f32.len(),
            f16: f16.len(),
            f32_zstd: zstd(&f32)?,
            f16_zstd: zstd(&f16)?,
            deltas_zstd: deltas(&columns, step_for(&columns, rms))?,
        })
    }
}

/// One value through time.
pub struct Column {
    /// In degrees, or what counts for as much.
    degrees: Vec<f64>,
    /// Whether it counts in the error: an angle that is ever other than 0.
    counts: bool,
}

/// The values of a clip that are ever different from 0 somewhere, by BAP.
pub fn columns(frames: &[TimedBapFrame]) -> Vec<Column> {
    let Some(first) = frames.first() else { return Vec::new() };
    let column = |bap| {
        let degrees: Vec<f64> =
            frames.iter().map(|frame| f64::from(frame.baps.value(bap)) * degrees_per_unit(bap)).collect();
        let counts = bap.unit() == Unit::Angle && degrees.iter().any(|&value| value != 0.0);
        Column { degrees, counts }
    };
    first.baps.mask.in_coding_order().map(column).collect()
}

/// Bytes of integer differences at `step` degrees after zstd -19.
pub fn deltas(columns: &[Column], step: f64) -> anyhow::Result<usize> {
    let count = columns.first().map_or(0, |column| column.degrees.len());
    let level = |column: &Column, frame: usize| (column.degrees[frame] / step).round() as i64;
    let delta = |column: &Column, frame: usize| {
        level(column, frame) - if frame == 0 { 0 } else { level(column, frame - 1) }
    };
    let (mut by_frame, mut by_value) = (Vec::new(), Vec::new());
    for frame in 0..count {
        columns.iter().for_each(|column| varint(delta(column, frame), &mut by_frame));
    }
    for column in columns {
        (0..count).for_each(|frame| varint(delta(column, frame), &mut by_value));
    }
    Ok(zstd(&by_frame)?.min(zstd(&by_value)?))
}

/// Root mean square error of rounding the values that count to multiples of `step`, degrees.
pub fn rounding_error(columns: &[Column], step: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in columns.iter().filter(|column| column.counts).flat_map(|column| &column.degrees) {
        sum += (value - (value / step).round() * step).powi(2);
        count += 1.0;
    }
    if count > 0.0 { f64::sqrt(sum / count) } else { 0.0 }
}

/// Root mean square and largest error of what comes back out of 16-bit floats, over the values that count, degrees.
pub fn half_error(columns: &[Column]) -> [f64; 2] {
    measured(columns, |column| {
        column.degrees.iter().map(|&value| f64::from(from_half(half(value as f32)))).collect()
    })
}

/// The same for integer differences at the largest step that makes no more than the error `rms`, read back out of
/// what zstd made of them.
pub fn deltas_error(columns: &[Column], rms: f64) -> anyhow::Result<[f64; 2]> {
    let step = step_for(columns, rms);
    let mut bytes = Vec::new();
    for column in columns {
        let mut last = 0;
        for value in &column.degrees {
            let level = (value / step).round() as i64;
            varint(level - last, &mut bytes);
            last = level;
        }
    }
    let packed = zstd::bulk::compress(&bytes, LEVEL).context("zstd")?;
    let mut unpacked = zstd::bulk::decompress(&packed, bytes.len()).context("zstd")?.into_iter();
    Ok(measured(columns, |column| {
        let mut level = 0;
        let next = |_| {
            level += from_varint(&mut unpacked);
            level as f64 * step
        };
        (0..column.degrees.len()).map(next).collect()
    }))
}

/// Root mean square and largest error of columns that come back, over the values that count. Asks for every column,
/// in their order.
fn measured(columns: &[Column], mut back: impl FnMut(&Column) -> Vec<f64>) -> [f64; 2] {
    let (mut sum, mut count, mut max) = (0.0, 0.0, 0.0f64);
    for column in columns {
        let decoded = back(column);
        for (value, decoded) in column.degrees.iter().zip(decoded).filter(|_| column.counts) {
            let off = (value - decoded).abs();
            sum += off * off;
            count += 1.0;
            max = max.max(off);
        }
    }
    [if count > 0.0 { f64::sqrt(sum / count) } else { 0.0 }, max]
}

/// The largest step whose rounding makes no more than this error, degrees.
fn step_for(columns: &[Column], rms: f64) -> f64 {
    let (mut low, mut high) = (0.01, 20.0);
    for _ in 0..40 {
        let middle = f64::sqrt(low * high);
        if rounding_error(columns, middle) <= rms { low = middle } else { high = middle }
    }
    low
}

/// A signed number in as few bytes as it needs, 7 bits in each.
fn varint(value: i64, out: &mut Vec<u8>) {
    let mut rest = ((value << 1) ^ (value >> 63)) as u64;
    while rest >= 0x80 {
        out.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    out.push(rest as u8);
}

/// The next number that [`varint`] wrote; 0 at the end.
fn from_varint(bytes: &mut impl Iterator<Item = u8>) -> i64 {
    let (mut value, mut shift) = (0u64, 0);
    for byte in bytes {
        value |= u64::from(byte & 0x7f) << shift;
        shift += 7;
        if byte < 0x80 || shift > 56 {
            break;
        }
    }
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

/// Bytes after zstd -19.
pub fn zstd(bytes: &[u8]) -> anyhow::Result<usize> {
    Ok(zstd::bulk::compress(bytes, LEVEL).context("zstd")?.len())
}

/// The nearest 16-bit float (ties away from zero), for values that are small and finite.
fn half(value: f32) -> u16 {
    let sign = if value < 0.0 { 0x8000 } else { 0 };
    let magnitude = value.abs();
    if magnitude < 2f32.powi(-14) {
        return sign | (magnitude * 2f32.powi(24)).round() as u16;
    }
    let bits = magnitude.min(65504.0).to_bits() + 0x1000;
    sign | ((bits >> 13) - (112 << 10)) as u16
}

/// The value of a 16-bit float that is finite.
fn from_half(bits: u16) -> f32 {
    let (exponent, fraction) = (bits >> 10 & 31, f32::from(bits & 0x3ff));
    let magnitude = match exponent {
        0 => fraction * 2f32.powi(-24),
        e => (1.0 + fraction / 1024.0) * 2f32.powi(i32::from(e) - 15),
    };
    if bits & 0x8000 == 0 { magnitude } else { -magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves() {
        for (value, bits) in
            [(0.0, 0), (1.0, 0x3c00), (-2.0, 0xc000), (0.1, 0x2e66), (65504.0, 0x7bff), (6e-8, 1)]
        {
            assert_eq!(half(value), bits, "{value}");
            assert!((from_half(bits) - value).abs() <= value.abs() / 2048.0 + 6e-8, "{value}");
        }
    }

    #[test]
    fn varints() {
        let mut bytes = Vec::new();
        [0, -1, 63, 64, -8193].into_iter().for_each(|value| varint(value, &mut bytes));
        assert_eq!(bytes, [0, 1, 126, 0x80, 1, 0x81, 0x80, 1]);
        let mut rest = bytes.into_iter();
        assert_eq!([0; 5].map(|_| from_varint(&mut rest)), [0, -1, 63, 64, -8193]);
    }

    #[test]
    fn errors_read_back_are_those_of_rounding() {
        let degrees: Vec<f64> = (0..200).map(|i| 40.0 * f64::from(i).sin()).collect();
        let columns = [Column { degrees: degrees.clone(), counts: true }, Column { degrees, counts: false }];
        let [rms, max] = deltas_error(&columns, 0.4).unwrap();
        let step = step_for(&columns, 0.4);
        assert!(
            (rms - rounding_error(&columns, step)).abs() < 1e-9 && rms <= 0.4 && max <= step / 2.0 + 1e-9
        );
        assert!(half_error(&columns)[1] < 0.02);
    }
}
