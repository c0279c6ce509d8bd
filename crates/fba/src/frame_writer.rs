//! Planes written frame by frame: what encoders that code each frame when it comes have in common.

use super::bits::BitCounter;
use super::error::EncodeError;
use super::state::Models;
use super::syntax::{IntraParams, PlaneHeader, PlaneKind, intra_params, plane_header};
use super::writer::{PlaneBits, PlaneWriter, count_bits};
use crate::bap::{BAP_COUNT, BapFrame};

/// Header of a P plane with a body part.
const P_HEADER: PlaneHeader = PlaneHeader {
    kind: PlaneKind::Predicted,
    object_mask: 2,
    rate: None,
    time_code: None,
    skipped: 0,
    explicit_skip: false,
};

/// Frames that a plane may skip for decoders to take it, by [`DecoderLimits`](super::DecoderLimits).
const MOST_SKIPPED: u32 = 65_535;

/// Bits of a header that says that no frame is skipped, over those of one that says nothing of it.
const EXPLICIT_SKIP: u64 = 4;

/// Bits of the planes that say nothing, three each, from this place to the end of a byte.
fn filled(place: u64) -> u64 {
    // Eight of them end where they began.
    3 * (3 * ((8 - place % 8) % 8) % 8)
}

/// A plane that stands for frames left out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Still {
    /// How many.
    pub frames: u32,
    pub bits: u64,
}

/// A plane writer with the levels of the next plane and the account of frames, planes and bits so far.
#[derive(Clone, Debug)]
pub(super) struct FrameWriter {
    pub(super) writer: PlaneWriter,
    /// Levels of the plane to be written, in coding order.
    pub(super) levels: Vec<i32>,
    frames: u64,
    /// Frames left out since the last plane.
    skipped: u32,
    /// Levels of a plane without change.
    still: Vec<i32>,
    last_still: Option<Still>,
    planes: u64,
    bits: PlaneBits,
}

impl FrameWriter {
    pub(super) fn new(writer: PlaneWriter) -> Self {
        let levels = Vec::with_capacity(BAP_COUNT);
        Self {
            writer,
            levels,
            frames: 0,
            skipped: 0,
            still: Vec::with_capacity(BAP_COUNT),
            last_still: None,
            planes: 0,
            bits: PlaneBits::default(),
        }
    }

    /// Frames given so far, those left out included.
    pub(super) fn frames(&self) -> u64 {
        self.frames
    }

    /// Planes written so far.
    pub(super) fn planes(&self) -> u64 {
        self.planes
    }

    /// Where the bits went so far.
    pub(super) fn bits(&self) -> PlaneBits {
        self.bits
    }

    /// The values a decoder has now.
    pub(super) fn reconstruction(&self) -> BapFrame {
        BapFrame::with_values(self.writer.layout().mask(), *self.writer.values())
    }

    /// Leaves one frame out. A plane says how many are skipped after it, so a plane without change comes for the first
    /// of those left out, and says how many they were, when the next plane is written.
    pub(super) fn skip(&mut self) {
        self.frames += 1;
        if self.planes > 0 {
            self.skipped += 1;
        }
        if self.skipped > MOST_SKIPPED {
            // No change is always in range, so this cannot fail.
            let _ = self.write_still();
        }
    }

    /// Writes `levels` as an I plane with `params`, or without them as a P plane; before it the plane that stands for
    /// frames left out.
    pub(super) fn write(
        &mut self,
        header: &PlaneHeader,
        start_code: bool,
        params: Option<&IntraParams>,
    ) -> Result<PlaneBits, EncodeError> {
        let mut bits = self.write_skipped()?;
        bits += self.write_plane(header, start_code, params)?;
        Ok(bits)
    }

    /// Writes the plane that stands for frames left out, if there are any, before another.
    fn write_skipped(&mut self) -> Result<PlaneBits, EncodeError> {
        let frames = self.skipped;
        let bits = self.write_still()?;
        self.last_still = (frames > 0).then(|| Still { frames, bits: bits.total() });
        Ok(bits)
    }

    /// Writes `levels`, behind what stands for frames left out.
    fn write_plane(
        &mut self,
        header: &PlaneHeader,
        start_code: bool,
        params: Option<&IntraParams>,
    ) -> Result<PlaneBits, EncodeError> {
        if params.is_none() {
            // Where the still plane had to change a value, this one takes it back.
            for (level, still) in self.levels.iter_mut().zip(&self.still) {
                *level -= still;
            }
        }
        let plane = self.writer.write_plane(header, start_code, params, &mut self.levels)?;
        self.frames += 1;
        self.planes += 1;
        self.bits += plane;
        Ok(plane)
    }

    /// Writes a plane without change for the frames left out, if there are any.
    fn write_still(&mut self) -> Result<PlaneBits, EncodeError> {
        self.still.clear();
        let Some(skipped) = self.skipped.checked_sub(1) else { return Ok(PlaneBits::default()) };
        self.still.resize(self.writer.layout().slots().len(), 0);
        let header = PlaneHeader { skipped, ..P_HEADER };
        let bits = self.writer.write_plane(&header, false, None, &mut self.still)?;
        self.skipped = 0;
        self.planes += 1;
        self.bits += bits;
        Ok(bits)
    }

    /// Bits of a P plane with `levels`; none if they are all 0, as it is then left out.
    pub(super) fn price(&mut self) -> Result<f64, EncodeError> {
        if self.levels.iter().all(|&level| level == 0) { Ok(0.0) } else { self.price_still() }
    }

    /// Bits of a P plane with `levels`, also if they are all 0.
    pub(super) fn price_still(&mut self) -> Result<f64, EncodeError> {
        let mut counter = BitCounter::default();
        plane_header(&mut counter, &P_HEADER, u32::MAX)?;
        let values =
            count_bits(self.writer.layout(), self.writer.models(), PlaneKind::Predicted, &mut self.levels)?;
        Ok((counter.bits + values) as f64)
    }

    /// What came before the plane written last.
    pub(super) fn last_still(&self) -> Option<Still> {
        self.last_still
    }

    /// Bits of the values of a P plane without change.
    pub(super) fn price_zeros(&mut self) -> Result<f64, EncodeError> {
        self.still.clear();
        self.still.resize(self.writer.layout().slots().len(), 0);
        let (layout, models) = (self.writer.layout(), self.writer.models());
        Ok(count_bits(layout, models, PlaneKind::Predicted, &mut self.still)? as f64)
    }

    /// Bits of the plane that stands for the frames left out.
    pub(super) fn owed(&mut self) -> Result<u64, EncodeError> {
        let Some(skipped) = self.skipped.checked_sub(1) else { return Ok(0) };
        let mut counter = BitCounter::default();
        plane_header(&mut counter, &PlaneHeader { skipped, ..P_HEADER }, u32::MAX)?;
        self.still.clear();
        self.still.resize(self.writer.layout().slots().len(), 0);
        let (layout, models) = (self.writer.layout(), self.writer.models());
        Ok(counter.bits + count_bits(layout, models, PlaneKind::Predicted, &mut self.still)?)
    }

    /// Bits of an I plane with `params` and `levels`, all told.
    pub(super) fn price_intra(
        &mut self,
        header: &PlaneHeader,
        params: &IntraParams,
    ) -> Result<f64, EncodeError> {
        let mut counter = BitCounter::default();
        plane_header(&mut counter, header, u32::MAX)?;
        intra_params(&mut counter, &mut params.clone())?;
        // I values have no adaptive models.
        let models = Models::default();
        let values =
            count_bits(self.writer.layout_after(params), &models, PlaneKind::Intra, &mut self.levels)?;
        Ok((counter.bits + values) as f64)
    }

    /// Writes planes without any part, which say nothing and take three bits, up to a byte's end.
    pub(super) fn align(&mut self) -> Result<PlaneBits, EncodeError> {
        let mut bits = PlaneBits::default();
        while !self.writer.position().is_multiple_of(8) {
            // I planes: their bits are not all 0, so any number of them cannot imitate a start code.
            bits += self.writer.write_empty(PlaneKind::Intra)?;
        }
        self.bits += bits;
        Ok(bits)
    }

    /// Writes `levels` as a P plane, behind which [`Self::align`] has little to do: where fewer bits are left to a byte's end
    /// then, its header says that no frame is skipped, which takes four bits more.
    pub(super) fn write_aligned(&mut self) -> Result<PlaneBits, EncodeError> {
        let mut bits = self.write_skipped()?;
        let end = self.writer.position() + self.price_still()? as u64;
        let explicit_skip = EXPLICIT_SKIP + filled(end + EXPLICIT_SKIP) < filled(end);
        bits += self.write_plane(&PlaneHeader { explicit_skip, ..P_HEADER }, false, None)?;
        Ok(bits)
    }

    /// Writes `levels` as a P plane.
    pub(super) fn write_predicted(&mut self) -> Result<PlaneBits, EncodeError> {
        self.write(&P_HEADER, false, None)
    }

    /// Ends the stream and returns the bytes not taken yet. If the last frames were left out, a plane
    /// without change stands for them, so that the stream has its full length.
    pub(super) fn finish(mut self) -> Vec<u8> {
        // No change is always in range, so this cannot fail.
        let _ = self.write_still();
        self.writer.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bap::Bap;
    use crate::plan::{LiveEncoder, PlanOptions, Target};

    /// Bits that planes of all lengths take more where each ends with a byte: 6.5 in the middle, 10.5 with planes that say nothing
    /// alone.
    #[test]
    fn bytes_are_filled_with_little() {
        let baps: Vec<Bap> = (1..=3).filter_map(|k| Bap::from_name(&format!("r_index{k}_flexion"))).collect();
        let frame = |n: i32| -> BapFrame {
            let bend = |k: usize| -20_000 - ((n * (k as i32 + 3)) % 41 - 20).abs() * 300;
            baps.iter().enumerate().map(|(k, &bap)| (bap, bend(k))).collect()
        };
        let bits = [true, false].map(|aligned| {
            let options = PlanOptions { mode: Target::Quant(4), aligned, ..PlanOptions::default() };
            let mut encoder = LiveEncoder::new(&options).unwrap();
            (0..1000).map(|n| encoder.write_frame(&frame(n)).unwrap().total()).sum::<u64>()
        });
        let filled = (bits[0] - bits[1]) as f64 / 1000.0;
        assert!((5.5..7.5).contains(&filled), "{filled}");
    }

    #[test]
    fn planes_that_say_nothing_fill_bytes() {
        for place in 0..16 {
            let bits = filled(place);
            assert!(
                bits.is_multiple_of(3) && (place + bits).is_multiple_of(8) && bits < 24,
                "{place}: {bits}"
            );
        }
    }
}
