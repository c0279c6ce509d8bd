//! The header of an object plane (1.3): kind, object mask, frame rate, time code, skipped frames.

use super::super::error::SyntaxError;
use super::Fields;

/// Kind of an object plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum PlaneKind {
    /// Values coded on their own; may change masks, ranges, quantiser, rate and time code.
    Intra,
    /// Differences to the plane before.
    #[default]
    Predicted,
}

impl PlaneKind {
    /// `'I'` or `'P'`.
    pub fn letter(self) -> char {
        match self {
            Self::Intra => 'I',
            Self::Predicted => 'P',
        }
    }
}

/// A frame rate as a plane header holds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FrameRate {
    /// Whole frames per second.
    pub whole: u8,
    /// Sixteenths of a frame per second, 0 to 15.
    pub sixteenths: u8,
    /// Whether the rate is multiplied by 1000/1001.
    pub offset: bool,
}

/// How far a codable rate may be from the one that it stands for, as a share, and up to where it counts as the same.
const NEAR: f64 = 1e-3;
const EXACT: f64 = 1e-5;
/// How much a frame may slip against ticks that are a multiple of its rate, ticks.
const SLIP: f64 = 4e-3;
/// Slowest rate that is carried, and the multiple up to which the same rate is looked for, frames per second.
const SLOWEST: f64 = 1.0 / 128.0;
const USUAL: f64 = 32.0;

impl FrameRate {
    /// What a decoder assumes when a stream never sends a rate.
    pub const ASSUMED: Self = Self { whole: 30, sixteenths: 0, offset: false };

    /// The codable rate nearest to `rate` frames per second, if it lies within 0.1 % of it.
    pub fn nearest(rate: f64) -> Option<Self> {
        let mut best: Option<(f64, Self)> = None;
        for offset in [false, true] {
            let units = (rate * 16.0 * if offset { 1.001 } else { 1.0 }).round();
            if !(1.0..4096.0).contains(&units) {
                continue;
            }
            let units = units as u32;
            let candidate = Self { whole: (units / 16) as u8, sixteenths: (units % 16) as u8, offset };
            let error = (candidate.per_second() - rate).abs();
            if best.is_none_or(|(least, _)| error < least) {
                best = Some((error, candidate));
            }
        }
        best.filter(|(error, _)| *error <= rate * NEAR).map(|(_, candidate)| candidate)
    }

    /// The codable rate on whose ticks frames at `rate` per second come, and how many of its ticks there are to a frame: of
    /// one that no codable rate is near to, a multiple.  `None` below 1/128 and above 255 15/16.
    pub fn carrying(rate: f64) -> Option<(Self, u32)> {
        let fits = |near: f64| {
            let at = move |ticks: &u32| {
                let found = Self::nearest(rate * f64::from(*ticks))?;
                let off = (found.per_second() / (rate * f64::from(*ticks)) - 1.0).abs();
                (off <= near && off * f64::from(*ticks) <= SLIP).then_some((found, *ticks))
            };
            move |most: f64| {
                (2..).take_while(move |ticks| f64::from(*ticks) * rate <= most).find_map(|n| at(&n))
            }
        };
        if !(SLOWEST..256.0).contains(&rate) {
            return None;
        }
        let one = Self::nearest(rate).map(|found| (found, 1));
        one.or_else(|| fits(EXACT)(USUAL)).or_else(|| fits(NEAR)(256.0))
    }

    /// Frames per second.
    pub fn per_second(self) -> f64 {
        let rate = f64::from(self.whole) + f64::from(self.sixteenths) / 16.0;
        if self.offset { rate * 1000.0 / 1001.0 } else { rate }
    }

    fn code<F: Fields>(f: &mut F, rate: Self) -> Result<Self, SyntaxError> {
        Ok(Self {
            whole: f.u("frame_rate", None, 8, rate.whole.into())? as u8,
            sixteenths: f.u("seconds", None, 4, rate.sixteenths.into())? as u8,
            offset: f.flag("frequency_offset", rate.offset)?,
        })
    }
}

/// A time code as a plane header holds it: whole seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TimeCode {
    /// Hours, 0 to 31.
    pub hours: u8,
    /// Minutes, 0 to 63.
    pub minutes: u8,
    /// The marker bit, 1 in a conforming stream; the vendor's encoder may write 0.
    pub marker: bool,
    /// Seconds, 0 to 63.
    pub seconds: u8,
}

impl TimeCode {
    /// The code for this many whole seconds, if the field can hold it (below 32 hours).
    pub fn from_seconds(seconds: u32) -> Option<Self> {
        let hours = seconds / 3600;
        let minutes = (seconds / 60 % 60) as u8;
        let code = Self { hours: hours as u8, minutes, marker: true, seconds: (seconds % 60) as u8 };
        (hours < 32).then_some(code)
    }

    /// The code of frame number `frame` at `rate`, if it falls on a whole second.
    pub fn at(frame: u64, rate: FrameRate) -> Option<Self> {
        let seconds = frame as f64 / rate.per_second();
        let whole = (seconds - seconds.round()).abs() < 1e-6;
        whole.then(|| Self::from_seconds(seconds.round() as u32)).flatten()
    }

    /// The time it names, in seconds.
    pub fn in_seconds(self) -> u32 {
        (u32::from(self.hours) * 60 + u32::from(self.minutes)) * 60 + u32::from(self.seconds)
    }

    fn code<F: Fields>(f: &mut F, time: Self) -> Result<Self, SyntaxError> {
        Ok(Self {
            hours: f.u("time_code_hours", None, 5, time.hours.into())? as u8,
            minutes: f.u("time_code_minutes", None, 6, time.minutes.into())? as u8,
            marker: f.flag("marker_bit", time.marker)?,
            seconds: f.u("time_code_seconds", None, 6, time.seconds.into())? as u8,
        })
    }
}

/// The header of an object plane (1.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaneHeader {
    /// I or P plane.
    pub kind: PlaneKind,
    /// Which parts follow: bit 0 the face, bit 1 the body.
    pub object_mask: u8,
    /// Frame rate, I planes only.
    pub rate: Option<FrameRate>,
    /// Time code, I planes only.
    pub time_code: Option<TimeCode>,
    /// Number of frames skipped after this one.
    pub skipped: u32,
    /// Whether the skip flag is set though no frame is skipped.
    pub explicit_skip: bool,
}

impl PlaneHeader {
    /// Whether the plane carries a face part.
    pub fn has_face(&self) -> bool {
        self.object_mask & 1 != 0
    }

    /// Whether the plane carries a body part.
    pub fn has_body(&self) -> bool {
        self.object_mask & 2 != 0
    }
}

/// Plane header with temporal header (1.3). A plane with object mask 0 has only three bits.
///
/// # Errors
/// End of data, fields too small for the values, or more than `skip_limit` skipped frames.
pub fn plane_header<F: Fields>(
    f: &mut F,
    header: &PlaneHeader,
    skip_limit: u32,
) -> Result<PlaneHeader, SyntaxError> {
    let start = f.bit_position();
    let intra = f.flag("is_intra", header.kind == PlaneKind::Intra)?;
    let kind = if intra { PlaneKind::Intra } else { PlaneKind::Predicted };
    let object_mask = f.u("fba_object_mask", None, 2, header.object_mask.into())? as u8;
    let mut out = PlaneHeader { kind, object_mask, ..PlaneHeader::default() };
    if object_mask == 0 {
        return Ok(out);
    }
    if intra {
        if f.flag("is_frame_rate", header.rate.is_some())? {
            out.rate = Some(FrameRate::code(f, header.rate.unwrap_or(FrameRate::ASSUMED))?);
        }
        if f.flag("is_time_code", header.time_code.is_some())? {
            let zero = TimeCode { hours: 0, minutes: 0, marker: true, seconds: 0 };
            out.time_code = Some(TimeCode::code(f, header.time_code.unwrap_or(zero))?);
        }
    }
    out.explicit_skip = f.flag("skip_frames", header.skipped > 0 || header.explicit_skip)?;
    if out.explicit_skip {
        let mut left = header.skipped;
        loop {
            let part = f.u("number_of_frames_to_skip", None, 4, left.min(15))?;
            left -= left.min(15);
            out.skipped += part;
            if out.skipped > skip_limit {
                return Err(SyntaxError::SkipLimit { bit: start, limit: skip_limit });
            }
            if part < 15 {
                break;
            }
        }
        out.explicit_skip = out.skipped == 0;
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::super::super::bits::{BitReader, BitWriter};
    use super::*;

    #[test]
    fn skipped_frames_are_coded_in_nibbles() {
        for (skipped, bits) in [(0, 4), (1, 8), (14, 8), (15, 12), (30, 16), (31, 16)] {
            let header = PlaneHeader { object_mask: 2, skipped, ..PlaneHeader::default() };
            let mut writer = BitWriter::new();
            plane_header(&mut writer, &header, 100).unwrap();
            assert_eq!(writer.position(), bits);
            let bytes = writer.into_bytes();
            assert_eq!(plane_header(&mut BitReader::new(&bytes), &PlaneHeader::default(), 100), Ok(header));
        }
    }

    #[test]
    fn rates() {
        for (rate, whole, sixteenths, offset) in
            [(30.0, 30, 0, false), (29.97, 30, 0, true), (23.976, 24, 0, true), (30.5, 30, 8, false)]
        {
            assert_eq!(FrameRate::nearest(rate), Some(FrameRate { whole, sixteenths, offset }));
        }
        assert_eq!(FrameRate::nearest(0.0), None);
        assert_eq!(FrameRate::nearest(1000.0), None);
        assert_eq!(FrameRate::nearest(f64::NAN), None);
    }

    #[test]
    fn rates_between_codable_ones_are_carried_by_a_multiple() {
        let carried = |rate: f64| FrameRate::carrying(rate).map(|(found, ticks)| (found.per_second(), ticks));
        for (rate, per_second, ticks) in [
            (30.0, 30.0, 1),
            (6.25, 6.25, 1),
            (20.0 / 3.0, 20.0, 3),
            (100.0 / 11.0, 18.1875, 2),
            (3.3, 16.5, 5),
            (0.3, 1.5, 5),
            (0.07, 1.75, 25),
        ] {
            assert_eq!(carried(rate), Some((per_second, ticks)), "{rate}");
        }
        for thousandths in (8..20_000).step_by(7) {
            let rate = f64::from(thousandths) * 1e-3;
            let (per_second, ticks) = carried(rate).unwrap();
            assert!((per_second / f64::from(ticks) / rate - 1.0).abs() <= 1e-3, "{rate}");
        }
        for rate in [0.0, -1.0, 0.007, 256.0, 1000.0, f64::NAN, f64::INFINITY] {
            assert_eq!(carried(rate), None, "{rate}");
        }
    }

    #[test]
    fn time_codes() {
        assert_eq!(TimeCode::from_seconds(86_399).map(TimeCode::in_seconds), Some(86_399));
        assert_eq!(TimeCode::from_seconds(32 * 3600), None);
    }
}
