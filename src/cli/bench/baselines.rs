//! What other ways to store the same motion take.

use anyhow::Context;
use handcast::bap::Unit;
use handcast::fba::encoder::degrees_per_unit;
use handcast::fba::plan::TimedBapFrame;

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
    /// Measures a clip; `rms` is the error, in degrees over the moving angles, that the integers may make.
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
    /// Whether it counts in the error: an angle that ever moves.
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

fn zstd(bytes: &[u8]) -> anyhow::Result<usize> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves() {
        for (value, bits) in
            [(0.0, 0), (1.0, 0x3c00), (-2.0, 0xc000), (0.1, 0x2e66), (65504.0, 0x7bff), (6e-8, 1)]
        {
            assert_eq!(half(value), bits, "{value}");
        }
    }

    #[test]
    fn varints() {
        let mut bytes = Vec::new();
        [0, -1, 63, 64, -8193].into_iter().for_each(|value| varint(value, &mut bytes));
        assert_eq!(bytes, [0, 1, 126, 0x80, 1, 0x81, 0x80, 1]);
    }
}
