//! Writes object planes exactly as told: every choice the syntax leaves is the caller's.

use super::arith::Encoder;
use super::bits::{BitCounter, BitWriter, Checkpoint};
use super::error::{EncodeError, SyntaxError};
use super::record::Record;
use super::state::{Layout, Models, bap_values, check_levels, intra_level, reconstruct, round_level};
use super::syntax::{
    Fields, IntraParams, OBJECT_START, PLANE_START, PlaneHeader, PlaneKind, RangeRule, SEQUENCE_END,
    SEQUENCE_START, USER_DATA, VISUAL_OBJECT, intra_params, plane_header,
};
use crate::bap::{BAP_COUNT, BapFrame, StepTable};

/// Where the bits of one plane, or of many, went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaneBits {
    /// Start codes and the stuffing in front of them.
    pub start_codes: u64,
    /// Plane headers: kind, object mask, rate, time code, skipped frames.
    pub headers: u64,
    /// Quantiser index and group masks of I planes.
    pub masks: u64,
    /// Gender, coding type, range flags and range arrays of I planes.
    pub ranges: u64,
    /// Arithmetic-coded values of I planes, without the flush.
    pub intra_values: u64,
    /// Arithmetic-coded values of P planes, without the flush.
    pub predicted_values: u64,
    /// The two bits that end each arithmetic-coded part.
    pub flush: u64,
}

impl PlaneBits {
    /// All bits.
    pub fn total(&self) -> u64 {
        self.start_codes
            + self.headers
            + self.masks
            + self.ranges
            + self.intra_values
            + self.predicted_values
            + self.flush
    }
}

impl std::ops::AddAssign for PlaneBits {
    fn add_assign(&mut self, other: Self) {
        self.start_codes += other.start_codes;
        self.headers += other.headers;
        self.masks += other.masks;
        self.ranges += other.ranges;
        self.intra_values += other.intra_values;
        self.predicted_values += other.predicted_values;
        self.flush += other.flush;
    }
}

/// Bits of an arithmetic-coded part that its flush takes.
pub(super) const FLUSH_BITS: u64 = 2;

/// Writes the planes of one FBA object with a body part.
///
/// ```
/// use handcast_fba::bap::{Bap, BapFrame, StepTable};
/// use handcast_fba::syntax::{IntraParams, PlaneHeader, PlaneKind};
/// use handcast_fba::writer::PlaneWriter;
///
/// let frame: BapFrame = [(Bap::from_name("r_index1_flexion").unwrap(), -50_000)].into_iter().collect();
/// let mut writer = PlaneWriter::new(StepTable::Standard);
/// let params = IntraParams { quant: 1, mask: frame.mask, ..IntraParams::default() };
/// let header = PlaneHeader { kind: PlaneKind::Intra, object_mask: 2, ..PlaneHeader::default() };
/// let levels = writer.intra_levels(&params, &frame).to_vec();
/// writer.write_intra(&header, false, &params, &levels)?;
/// let stream = writer.finish();
/// assert_eq!(&stream[..4], &[0, 0, 1, 0xba]);
/// # Ok::<(), handcast_fba::error::EncodeError>(())
/// ```
#[derive(Clone, Debug)]
pub struct PlaneWriter {
    bits: BitWriter,
    layout: Layout,
    next_layout: Layout,
    models: Models,
    values: [i32; BAP_COUNT],
    levels: Vec<i32>,
    started: bool,
    /// What goes before the start code of each I plane that has one.
    record: Record,
}

impl PlaneWriter {
    /// Begins a bare FBA object, as .fba files hold it.
    pub fn new(steps: StepTable) -> Self {
        Self::begin(steps, BitWriter::new())
    }

    /// Begins an FBA object inside a visual object sequence with this profile and level indication
    /// (0x63 and 0x64 are Simple FBA levels 1 and 2).
    pub fn with_visual_wrapper(steps: StepTable, profile_and_level: u8) -> Self {
        Self::with_record(steps, profile_and_level, &Record::default())
    }

    /// The same with a record, if it is not empty, as user data of the sequence.
    pub fn with_record(steps: StepTable, profile_and_level: u8, record: &Record) -> Self {
        let mut bits = BitWriter::new();
        bits.put(32, SEQUENCE_START);
        bits.put(8, profile_and_level.into());
        put_record(&mut bits, record);
        bits.put(32, VISUAL_OBJECT);
        bits.put(1, 0);
        bits.put(4, VISUAL_OBJECT_TYPE_FBA);
        bits.stuff();
        Self::begin(steps, bits)
    }

    fn begin(steps: StepTable, mut bits: BitWriter) -> Self {
        bits.put(32, OBJECT_START);
        Self {
            bits,
            layout: Layout::new(steps, RangeRule::Divided),
            next_layout: Layout::new(steps, RangeRule::Divided),
            models: Models::default(),
            values: [0; BAP_COUNT],
            levels: Vec::with_capacity(BAP_COUNT),
            started: false,
            record: Record::default(),
        }
    }

    /// The same writer with a record before the start code of each I plane that has one, so that it is known where a
    /// decoder resumes.
    pub fn repeating(self, record: &Record) -> Self {
        Self { record: *record, ..self }
    }

    /// The same writer with another reading of range codes; to be chosen before the first plane.
    pub fn with_ranges(self, rule: RangeRule) -> Self {
        let steps = self.layout.steps();
        Self { layout: Layout::new(steps, rule), next_layout: Layout::new(steps, rule), ..self }
    }

    /// The coding parameters in force.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The P models in force.
    pub fn models(&self) -> &Models {
        &self.models
    }

    /// The values a decoder has after the planes so far, by BAP index.
    pub fn values(&self) -> &[i32; BAP_COUNT] {
        &self.values
    }

    /// The coding parameters that an I plane with `params` would put in force.
    pub fn layout_after(&mut self, params: &IntraParams) -> &Layout {
        self.next_layout.follow(&self.layout, params);
        &self.next_layout
    }

    /// Levels of an I plane with `params` that come nearest to `frame`, in coding order, by plain
    /// rounding and without a look at the ranges.
    pub fn intra_levels(&mut self, params: &IntraParams, frame: &BapFrame) -> &[i32] {
        self.next_layout.follow(&self.layout, params);
        self.levels.clear();
        let level = |slot: &super::state::Slot| intra_level(frame.value(slot.bap), slot.step, params.quant);
        self.levels.extend(self.next_layout.slots().iter().map(level));
        &self.levels
    }

    /// Levels of a P plane that come nearest to `frame`, in coding order, by plain rounding and
    /// without a look at the ranges.
    pub fn predicted_levels(&mut self, frame: &BapFrame) -> &[i32] {
        self.levels.clear();
        let values = &self.values;
        self.levels.extend(self.layout.slots().iter().map(|slot| {
            let before = values[slot.bap.index()];
            round_level(i64::from(frame.value(slot.bap)) - i64::from(before), slot.step)
        }));
        &self.levels
    }

    /// Writes an I plane: header, parameters, `levels` in coding order. With `start_code` a plane
    /// start code stands in front. Nothing is written on error.
    ///
    /// # Errors
    /// A level outside its range, a field too small for its value, a wrong number of levels.
    pub fn write_intra(
        &mut self,
        header: &PlaneHeader,
        start_code: bool,
        params: &IntraParams,
        levels: &[i32],
    ) -> Result<PlaneBits, EncodeError> {
        let header = PlaneHeader { kind: PlaneKind::Intra, ..*header };
        self.next_layout.follow(&self.layout, params);
        check(&self.next_layout, PlaneKind::Intra, levels)?;
        check_fields(&header, params)?;
        let before = self.bits.checkpoint();
        let mut parts = self.write_header(&header, start_code)?;
        let start = self.bits.position();
        // Reading and writing share one function; what it gives back when writing is what went in.
        let mut params = params.clone();
        let marks = intra_params(&mut self.bits, &mut params)?;
        parts.masks = marks.masks - start;
        parts.ranges = marks.ranges - marks.masks;
        self.write_values(PlaneKind::Intra, levels, true)?;
        parts.intra_values = self.bits.position() - marks.ranges - FLUSH_BITS;
        parts.flush = FLUSH_BITS;
        self.refuse_imitation(&before)?;
        std::mem::swap(&mut self.layout, &mut self.next_layout);
        self.models.reset(&self.layout);
        reconstruct(&self.layout, PlaneKind::Intra, levels, &mut self.values, start)?;
        self.started = true;
        Ok(parts)
    }

    /// Writes a P plane: header and `levels` in coding order. Nothing is written on error.
    ///
    /// # Errors
    /// No I plane before it, a level outside its range, a wrong number of levels.
    pub fn write_predicted(
        &mut self,
        header: &PlaneHeader,
        start_code: bool,
        levels: &[i32],
    ) -> Result<PlaneBits, EncodeError> {
        if !self.started {
            return Err(EncodeError::NoIntra);
        }
        let header = PlaneHeader { kind: PlaneKind::Predicted, rate: None, time_code: None, ..*header };
        check(&self.layout, PlaneKind::Predicted, levels)?;
        let before = self.bits.checkpoint();
        let bit = self.bits.position();
        let mut parts = self.write_header(&header, start_code)?;
        let start = self.bits.position();
        self.write_values(PlaneKind::Predicted, levels, false)?;
        parts.predicted_values = self.bits.position() - start - FLUSH_BITS;
        parts.flush = FLUSH_BITS;
        self.refuse_imitation(&before)?;
        if let Err(error) = reconstruct(&self.layout, PlaneKind::Predicted, levels, &mut self.values, bit) {
            self.bits.roll_back(&before);
            return Err(error.into());
        }
        self.models.update(&self.layout, levels);
        Ok(parts)
    }

    /// Takes back the plane begun at `before` if its bits contain a start code.
    fn refuse_imitation(&mut self, before: &Checkpoint) -> Result<(), EncodeError> {
        if !self.bits.imitates() {
            return Ok(());
        }
        self.bits.roll_back(before);
        Err(EncodeError::Imitation { bit: self.bits.position() })
    }

    /// Writes an I plane with `params`, or without them a P plane, and steers clear of bits that look like a
    /// start code: if need be one of the levels is changed by one, in `levels` as well. Of a P plane one that the next plane
    /// can take back, if there is one.
    ///
    /// # Errors
    /// As [`Self::write_intra`] and [`Self::write_predicted`].
    pub fn write_plane(
        &mut self,
        header: &PlaneHeader,
        start_code: bool,
        params: Option<&IntraParams>,
        levels: &mut [i32],
    ) -> Result<PlaneBits, EncodeError> {
        let write = |writer: &mut Self, levels: &[i32]| match params {
            Some(params) => writer.write_intra(header, start_code, params, levels),
            None => writer.write_predicted(header, start_code, levels),
        };
        let mut result = write(self, levels);
        for back in [true, false] {
            for index in 0..levels.len() {
                if !matches!(result, Err(EncodeError::Imitation { .. })) {
                    return result;
                }
                let level = levels[index];
                // Towards 0 it stays in range.
                let change = if level == 0 { 1 } else { -level.signum() };
                if back != self.takes_back(params.is_some(), index, change) {
                    continue;
                }
                levels[index] = level + change;
                result = write(self, levels).or(result);
                if result.is_err() {
                    levels[index] = level;
                }
            }
        }
        result
    }

    /// Whether a P plane can take back what a level was changed by.
    fn takes_back(&self, intra: bool, index: usize, change: i32) -> bool {
        let range = self.layout.slots().get(index).map(|slot| slot.range(PlaneKind::Predicted));
        intra || range.is_some_and(|[min, max]| (min..=max).contains(&-change))
    }

    /// Writes a plane with object mask 0: three bits that change nothing.
    ///
    /// # Errors
    /// None in practice; the header always fits.
    pub fn write_empty(&mut self, kind: PlaneKind) -> Result<PlaneBits, EncodeError> {
        self.write_header(&PlaneHeader { kind, ..PlaneHeader::default() }, false)
    }

    fn write_header(&mut self, header: &PlaneHeader, start_code: bool) -> Result<PlaneBits, EncodeError> {
        let mut parts = PlaneBits::default();
        let start = self.bits.position();
        if start_code && header.kind == PlaneKind::Intra && !self.record.is_empty() {
            self.bits.stuff();
            put_record(&mut self.bits, &self.record);
            // User data go on to the next start code: stuffing would be a part of them.
            self.bits.aligned_start_code(PLANE_START);
        } else if start_code {
            self.bits.start_code(PLANE_START);
        }
        parts.start_codes = self.bits.position() - start;
        let start = self.bits.position();
        plane_header(&mut self.bits, header, u32::MAX)?;
        parts.headers = self.bits.position() - start;
        Ok(parts)
    }

    fn write_values(&mut self, kind: PlaneKind, levels: &[i32], next: bool) -> Result<(), SyntaxError> {
        // The shared function takes levels by mutable reference; this buffer keeps them unallocated.
        self.levels.clear();
        self.levels.extend_from_slice(levels);
        let layout = if next { &self.next_layout } else { &self.layout };
        let coder = self.bits.arithmetic()?;
        bap_values(coder, kind, layout, &self.models, &mut self.levels)
    }

    /// Bits written so far.
    pub fn position(&self) -> u64 {
        self.bits.position()
    }

    /// Moves the bytes finished so far to the end of `out`; for live streams.
    pub fn take_bytes(&mut self, out: &mut Vec<u8>) {
        self.bits.take_bytes(out);
    }

    /// Ends the stream with stuffing and end code, and returns the bytes not taken yet.
    pub fn finish(mut self) -> Vec<u8> {
        self.bits.start_code(SEQUENCE_END);
        self.bits.into_bytes()
    }
}

/// Writes a record, unless it is empty, at a byte boundary.
fn put_record(bits: &mut BitWriter, record: &Record) {
    if !record.is_empty() {
        bits.put(32, USER_DATA);
        record.written().for_each(|byte| bits.put(8, byte.into()));
    }
}

/// `visual_object_type` of an FBA object.
const VISUAL_OBJECT_TYPE_FBA: u32 = 4;

fn check(layout: &Layout, kind: PlaneKind, levels: &[i32]) -> Result<(), EncodeError> {
    let expected = layout.slots().len();
    if levels.len() != expected {
        return Err(EncodeError::LevelCount { given: levels.len(), expected });
    }
    Ok(check_levels(layout, kind, levels)?)
}

/// Runs the header and parameter tables over a scratch writer, so that a field that does not fit is
/// found before anything is written.
fn check_fields(header: &PlaneHeader, params: &IntraParams) -> Result<(), EncodeError> {
    let mut scratch = BitCounter::default();
    plane_header(&mut scratch, header, u32::MAX)?;
    intra_params(&mut scratch, &mut params.clone())?;
    Ok(())
}

/// Bits that `levels` cost in a plane of this kind, flush included, without writing them.
///
/// # Errors
/// A level outside its range, or a wrong number of levels.
pub fn count_bits(
    layout: &Layout,
    models: &Models,
    kind: PlaneKind,
    levels: &mut [i32],
) -> Result<u64, EncodeError> {
    check(layout, kind, levels)?;
    let mut counter = BitCounter::default();
    bap_values(Encoder::new(&mut counter), kind, layout, models, levels)?;
    Ok(counter.bits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bap::{Bap, BapMask};
    use crate::{Decoder, DecoderOptions};

    /// P planes whose values all lie at the end of their range begin with many zeros; now and then a start
    /// code comes out of it. Found by trying, for every alignment.
    #[test]
    fn start_codes_are_not_imitated() {
        let mask: BapMask = (0..8).filter_map(|index| Bap::new(126 + 2 * index)).collect();
        let params = IntraParams { quant: 10, mask, ranges: [Some([7; BAP_COUNT]); 4], ..Default::default() };
        let header = PlaneHeader { object_mask: 2, ..PlaneHeader::default() };
        let mut state = 1u32;
        let mut dodged = 0;
        for try_number in 0..30_000u32 {
            let mut writer = PlaneWriter::new(StepTable::Standard);
            let header_i = PlaneHeader { skipped: try_number % 2 * 40, ..header };
            writer.write_intra(&header_i, false, &params, &[0; 8]).unwrap();
            let mut levels: Vec<i32> = vec![21; 8];
            for level in levels.iter_mut().skip(4) {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *level = 21 - (state >> 16) as i32 % 43;
            }
            for _ in 0..try_number % 7 {
                writer.write_empty(PlaneKind::Predicted).unwrap();
            }
            let mut nudged = levels.clone();
            if let Err(error) = writer.clone().write_predicted(&header, false, &levels) {
                assert!(matches!(error, EncodeError::Imitation { .. }), "{error}");
                dodged += 1;
                writer.write_plane(&header, false, None, &mut nudged).unwrap();
                assert_eq!(nudged.iter().zip(&levels).filter(|(a, b)| a != b).count(), 1);
                let values = *writer.values();
                let mut decoder = Decoder::new(DecoderOptions::default());
                decoder.push(&writer.finish()).unwrap();
                decoder.next_frame().unwrap();
                assert_eq!(decoder.next_frame().unwrap().unwrap().baps.values(), &values);
                assert_eq!(decoder.next_frame().unwrap(), None);
                assert!(decoder.is_ended());
            }
        }
        assert!(dodged > 0, "none was met, so nothing was tested");
    }
}
