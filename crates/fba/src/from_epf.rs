//! Encodes a .bap file with exactly the choices of an .epf file, as the reference encoder does.

use thiserror::Error;

use super::error::EncodeError;
use super::syntax::{FrameRate, IntraParams, PlaneHeader, PlaneKind, RANGE_DELTA, RangeCodes, TimeCode};
use super::writer::PlaneWriter;
use crate::bap::epf::{BapLimits, EpfFrame};
use crate::bap::text::BapFile;
use crate::bap::{BAP_COUNT, BapFrame, StepTable};

/// Why a .bap file cannot be encoded as an .epf file asks.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum EpfEncodeError {
    /// The .epf file asks for something that is not implemented.
    #[error("epf frame {frame}: {what} is not supported")]
    Unsupported {
        /// Number of the .epf frame, from 0.
        frame: usize,
        /// What is missing.
        what: &'static str,
    },
    /// A frame number that the .bap file does not have.
    #[error("epf frame {frame}: the .bap file has no frame {number}")]
    NoSuchFrame {
        /// Number of the .epf frame, from 0.
        frame: usize,
        /// Frame number asked for.
        number: u32,
    },
    /// A plane that cannot be written.
    #[error("epf frame {frame}: {error}")]
    Encode {
        /// Number of the .epf frame, from 0.
        frame: usize,
        /// Why.
        error: EncodeError,
    },
}

/// Encodes the frames of `file` that `epf` names, with its masks, limits and quantisers.
///
/// Like the reference encoder it repeats the last time code, with marker bit 0, on later I planes that
/// have none of their own; and it sends all four limits of an I plane that switches on a BAP whose limits
/// were never sent. Where the .epf file gives no mask, that of the .bap frame is used.
///
/// # Errors
/// Face parts and DCT coding are not supported; a frame may be missing or not codable.
pub fn encode_epf(file: &BapFile, epf: &[EpfFrame], steps: StepTable) -> Result<Vec<u8>, EpfEncodeError> {
    let mut writer = PlaneWriter::new(steps);
    let mut params = IntraParams::default();
    let mut mask = None;
    let mut codes: [Option<RangeCodes>; 4] = [None; 4];
    let mut time_code: Option<TimeCode> = None;
    let mut sent = crate::bap::BapMask::EMPTY;
    for (number, plane) in epf.iter().enumerate() {
        let unsupported = |what| Err(EpfEncodeError::Unsupported { frame: number, what });
        if plane.object_mask & 1 != 0 {
            return unsupported("writing a face part");
        }
        if plane.dct {
            return unsupported("dct coding");
        }
        let kind = if plane.intra { PlaneKind::Intra } else { PlaneKind::Predicted };
        if plane.rate.is_some_and(|[whole, sixteenths, _]| whole == 0 && sixteenths == 0) {
            return unsupported("a rate of 0");
        }
        let wrap = |error| EpfEncodeError::Encode { frame: number, error };
        if plane.object_mask == 0 {
            writer.write_empty(kind).map_err(wrap)?;
            continue;
        }
        let frame = find(file, plane, number)?;
        let mut header = PlaneHeader {
            kind,
            object_mask: plane.object_mask,
            skipped: plane.skip.unwrap_or(0),
            explicit_skip: plane.skip.is_some(),
            ..PlaneHeader::default()
        };
        if !plane.intra {
            let levels = writer.predicted_levels(frame).to_vec();
            writer.write_predicted(&header, false, &levels).map_err(wrap)?;
            continue;
        }
        mask = plane.mask.or(mask);
        params.quant = plane.quant.unwrap_or(params.quant);
        params.male = plane.male.unwrap_or(params.male);
        params.mask = mask.map_or(frame.mask, |mask| mask.baps);
        params.explicit_groups = mask.map_or(0, |mask| mask.explicit_full);
        params.explicit_empty_groups = mask.map_or(0, |mask| mask.explicit_empty);
        for (limits, codes) in plane.limits.iter().zip(&mut codes) {
            if let Some(limits) = limits {
                *codes = Some(range_codes(limits));
            }
        }
        let force = !sent.is_empty() && !params.mask.difference(&sent).is_empty();
        params.ranges =
            std::array::from_fn(|end| codes[end].filter(|_| force || plane.limits[end].is_some()));
        if params.ranges.iter().any(Option::is_some) {
            sent = sent.union(&params.mask);
        }
        header.rate = plane.rate.map(|[whole, sixteenths, offset]| FrameRate {
            whole,
            sixteenths,
            offset: offset == 1,
        });
        header.time_code = match plane.time_code {
            Some([hours, minutes, marker, seconds]) => {
                Some(TimeCode { hours, minutes, marker: marker == 1, seconds })
            }
            None => time_code.map(|code| TimeCode { marker: false, ..code }),
        };
        time_code = header.time_code;
        let levels = writer.intra_levels(&params, frame).to_vec();
        writer.write_intra(&header, false, &params, &levels).map_err(wrap)?;
    }
    Ok(writer.finish())
}

fn find<'a>(file: &'a BapFile, plane: &EpfFrame, number: usize) -> Result<&'a BapFrame, EpfEncodeError> {
    let wanted = plane.bap_frame.unwrap_or(number as u32);
    let found = file.frames.binary_search_by_key(&wanted, |frame| frame.0);
    found
        .ok()
        .and_then(|index| file.frames.get(index))
        .map(|(_, frame)| frame)
        .ok_or(EpfEncodeError::NoSuchFrame { frame: number, number: wanted })
}

/// Codes of limits: their magnitudes in units of 60 base steps, rounded up.
fn range_codes(limits: &BapLimits) -> RangeCodes {
    let mut codes = [0; BAP_COUNT];
    for (code, limit) in codes.iter_mut().zip(limits) {
        *code = limit.unsigned_abs().div_ceil(RANGE_DELTA as u32) as u8;
    }
    codes
}
