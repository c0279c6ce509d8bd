//! A frame-by-frame encoder without look-ahead.

use super::arith::{Adaptive, Model};
use super::error::EncodeError;
use super::state::{Slot, round_level};
use super::syntax::{
    FrameRate, IntraParams, MAX_RANGE_CODE, PlaneHeader, PlaneKind, TimeCode, range_code, range_levels,
};
use super::writer::{PlaneBits, PlaneWriter};
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask, StepTable, Unit};

/// How to encode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderConfig {
    /// Base steps; the decoder must be told the same.
    pub steps: StepTable,
    /// Frame rate, sent with every I plane.
    pub rate: FrameRate,
    /// Quantiser index, 0 to 31. The step of a finger bend is 0.073° times the scale of the index.
    pub quant: u8,
    /// Frames from one I plane to the next; 0 sends only those that are needed.
    pub intra_interval: u32,
    /// Start code and time code with every I plane, so that a decoder can resume there after damage.
    pub resync: bool,
    /// Squared degrees of error that saving one bit may cost; 0 rounds to the nearest level.
    pub lambda: f64,
    /// Leave out frames in which nothing is worth changing; the next plane says how many. Decoders hold the
    /// pose meanwhile. BAPs that were never different from 0 are left out, too.
    pub sparse: bool,
    /// Largest error of a value in degrees ([`degrees_per_unit`]) before an I plane is sent because the
    /// P ranges are too narrow.
    pub max_lag: f64,
    /// Profile and level indication of a visual object sequence around the object, if one is wanted.
    pub wrapper: Option<u8>,
}

impl Default for EncoderConfig {
    /// Standard steps, 30 frames/s, quantiser index 10, an I plane every 150 frames, plain rounding.
    fn default() -> Self {
        Self {
            steps: StepTable::Standard,
            rate: FrameRate::ASSUMED,
            quant: 10,
            intra_interval: 150,
            resync: false,
            lambda: 0.0,
            sparse: false,
            max_lag: 2.0,
            wrapper: None,
        }
    }
}

/// Degrees that one unit of a BAP counts for in error measures. Angles are what they are. A millimetre
/// and a unit of an extension BAP (for hand streams 1 mm or 0.1°) count as a tenth of a degree.
pub fn degrees_per_unit(bap: Bap) -> f64 {
    match bap.unit() {
        Unit::Angle => 1e-5f64.to_degrees(),
        Unit::Millimetre | Unit::Extension => 0.1,
    }
}

/// Encodes frames as they come; every frame becomes one plane.
///
/// ```
/// use handcast::bap::{Bap, BapFrame};
/// use handcast::fba::{Decoder, DecoderOptions, Encoder, EncoderConfig};
///
/// let bend = Bap::from_name("r_index1_flexion").unwrap();
/// let mut encoder = Encoder::new(EncoderConfig { quant: 1, ..EncoderConfig::default() })?;
/// for value in [0, -10_000, -20_000] {
///     encoder.write_frame(&[(bend, value)].into_iter().collect())?;
/// }
/// let stream = encoder.finish();
///
/// let mut decoder = Decoder::new(DecoderOptions::default());
/// decoder.push(&stream)?;
/// let mut values = Vec::new();
/// while let Some(frame) = decoder.next_frame()? {
///     values.push(frame.baps.get(bend).unwrap());
/// }
/// assert_eq!(values, [0, -9_984, -19_968]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Encoder {
    config: EncoderConfig,
    writer: PlaneWriter,
    params: IntraParams,
    levels: Vec<i32>,
    /// Frames since the last I plane, it included.
    since_intra: u32,
    /// Frames given so far, skipped ones included.
    frames: u64,
    skipped: u32,
    reach: Reach,
    worthy: BapMask,
    /// A BAP that is not sent must be.
    urgent: bool,
    bits: PlaneBits,
    planes: u64,
}

/// Largest P levels seen, as magnitudes, by BAP index.
#[derive(Clone, Debug)]
struct Reach {
    ever: [i32; BAP_COUNT],
    /// BAPs for which a whole I period has been seen.
    known: BapMask,
}

/// Degrees per second that the P ranges of a bend allow for at first.
const FIRST_BEND_SPEED: f64 = 390.0;
/// Degrees per second that the P ranges of other BAPs allow for at first.
const FIRST_SPEED: f64 = 270.0;
/// Degrees from which on a BAP is worth sending.
const WORTH_SENDING: f64 = 0.05;
/// Bits of a P plane around its values: header and flush, less what skipping it adds to the next header.
const PLANE_OVERHEAD: f64 = 4.0;

impl Encoder {
    /// An encoder at the start of a stream.
    ///
    /// # Errors
    /// A parameter outside its range.
    pub fn new(config: EncoderConfig) -> Result<Self, EncodeError> {
        let refuse = |what, value: f64, allowed| Err(EncodeError::Parameter { what, value, allowed });
        if config.quant > 31 {
            return refuse("quantiser index", config.quant.into(), "0 to 31");
        }
        if config.rate.sixteenths > 15 || config.rate.per_second() <= 0.0 {
            return refuse("frame rate", config.rate.per_second(), "1/16 to 255 15/16");
        }
        if !(config.lambda >= 0.0 && config.lambda.is_finite()) {
            return refuse("lambda", config.lambda, "finite and not negative");
        }
        if config.max_lag.is_nan() || config.max_lag <= 0.0 {
            return refuse("largest lag", config.max_lag, "positive");
        }
        let writer = match config.wrapper {
            Some(profile) => PlaneWriter::with_visual_wrapper(config.steps, profile),
            None => PlaneWriter::new(config.steps),
        };
        Ok(Self {
            config,
            writer,
            params: IntraParams { ranges: [Some([0; BAP_COUNT]); 4], ..IntraParams::default() },
            levels: Vec::with_capacity(BAP_COUNT),
            since_intra: 0,
            frames: 0,
            skipped: 0,
            reach: Reach { ever: [0; BAP_COUNT], known: BapMask::EMPTY },
            worthy: BapMask::EMPTY,
            urgent: false,
            bits: PlaneBits::default(),
            planes: 0,
        })
    }

    /// Encodes one frame: the BAPs in its mask. An I plane is sent first of all, when the interval is
    /// over, when the mask changes, and when a movement leaves the P ranges. The result says what the plane
    /// cost; nothing for a frame left out under [`EncoderConfig::sparse`].
    ///
    /// # Errors
    /// [`EncodeError::OutOfRange`] for a value that no I plane can carry; the frame is then not encoded
    /// and the encoder stays usable.
    pub fn write_frame(&mut self, frame: &BapFrame) -> Result<PlaneBits, EncodeError> {
        let due = self.config.intra_interval > 0 && self.since_intra >= self.config.intra_interval;
        let mask = self.wanted_mask(frame, due || self.planes == 0);
        let changed = self.planes == 0 || self.writer.layout().mask() != mask;
        let bits = if due || changed || !self.predict(frame) {
            let mask = self.wanted_mask(frame, true);
            self.write_intra(frame, mask)?
        } else if self.config.sparse && self.levels.iter().all(|&level| level == 0) {
            self.skip_frame();
            return Ok(PlaneBits::default());
        } else {
            self.write_predicted()?
        };
        self.frames += 1;
        self.planes += 1;
        self.skipped = 0;
        self.bits += bits;
        Ok(bits)
    }

    fn write_predicted(&mut self) -> Result<PlaneBits, EncodeError> {
        let header = PlaneHeader { object_mask: 2, skipped: self.skipped, ..PlaneHeader::default() };
        let bits = self.writer.write_predicted(&header, false, &self.levels)?;
        self.since_intra += 1;
        Ok(bits)
    }

    /// The BAPs to send: all that are given, or under [`EncoderConfig::sparse`] those that ever moved away
    /// from 0. A BAP that does so for the first time waits for the next I plane if it can.
    fn wanted_mask(&mut self, frame: &BapFrame, intra: bool) -> BapMask {
        if !self.config.sparse {
            return frame.mask;
        }
        for (bap, value) in frame.iter() {
            let away = f64::from(value).abs() * degrees_per_unit(bap);
            if away > WORTH_SENDING {
                self.worthy.insert(bap);
                self.urgent |= away > self.config.max_lag && !self.mask().contains(bap);
            }
        }
        if intra || self.urgent || !self.mask().difference(&frame.mask).is_empty() {
            self.urgent = false;
            frame.mask.intersection(&self.worthy)
        } else {
            self.mask()
        }
    }

    /// Leaves one frame out; the next plane says so.
    pub fn skip_frame(&mut self) {
        self.frames += 1;
        self.since_intra += 1;
        if self.planes > 0 {
            self.skipped += 1;
        }
    }

    /// The values a decoder has now.
    pub fn reconstruction(&self) -> BapFrame {
        BapFrame::with_values(self.writer.layout().mask(), *self.writer.values())
    }

    /// The value of `bap` that a decoder has now.
    pub fn value(&self, bap: Bap) -> i32 {
        self.writer.values()[bap.index()]
    }

    /// Where the bits went so far.
    pub fn bits(&self) -> PlaneBits {
        self.bits
    }

    /// Planes written so far.
    pub fn planes(&self) -> u64 {
        self.planes
    }

    /// The BAPs sent.
    pub fn mask(&self) -> BapMask {
        self.writer.layout().mask()
    }

    /// Squared degrees one bit may cost, from the next frame on.
    pub fn set_lambda(&mut self, lambda: f64) {
        self.config.lambda = lambda.max(0.0);
    }

    /// Moves the bytes finished so far to the end of `out`.
    pub fn take_bytes(&mut self, out: &mut Vec<u8>) {
        self.writer.take_bytes(out);
    }

    /// Ends the stream and returns the bytes not taken yet. If the last frames were left out, a plane
    /// without change stands for the last of them, so that the stream has its full length.
    pub fn finish(mut self) -> Vec<u8> {
        if self.skipped > 0 && self.planes > 0 {
            self.skipped -= 1;
            self.levels.clear();
            self.levels.resize(self.writer.layout().slots().len(), 0);
            // No change is always in range, so this cannot fail.
            if let Ok(bits) = self.write_predicted() {
                self.bits += bits;
            }
        }
        self.writer.finish()
    }

    /// Chooses the levels of a P plane; false if the ranges are too narrow for it.
    fn predict(&mut self, frame: &BapFrame) -> bool {
        self.levels.clear();
        let mut fits = true;
        for slot in self.writer.layout().slots() {
            let before = self.writer.values()[slot.bap.index()];
            let wanted = i64::from(frame.value(slot.bap)) - i64::from(before);
            let level = self.level(slot, wanted);
            let lag = (wanted - i64::from(level) * i64::from(slot.step)) as f64 * degrees_per_unit(slot.bap);
            let rounded = round_level(wanted, slot.step);
            let reached = &mut self.reach.ever[slot.bap.index()];
            *reached = rounded.abs().max(*reached);
            fits &= level == rounded || lag.abs() <= self.config.max_lag;
            self.levels.push(level);
        }
        if self.config.sparse && fits {
            self.drop_poor_plane(frame);
        }
        fits
    }

    /// Drops all changes of a plane that together do not pay for its header and flush.
    fn drop_poor_plane(&mut self, frame: &BapFrame) {
        let mut gain = -self.config.lambda * PLANE_OVERHEAD;
        let mut all_may_wait = true;
        for (slot, &level) in self.writer.layout().slots().iter().zip(&self.levels) {
            let model = Adaptive::new(self.writer.models().table(slot));
            let (below, above) = model.bounds((level - slot.predicted[0]) as usize);
            gain -= self.config.lambda * (f64::from(model.total()) / f64::from(above - below)).log2();
            if level != 0 {
                let value = self.writer.values()[slot.bap.index()];
                let wanted = i64::from(frame.value(slot.bap)) - i64::from(value);
                let off = |level: i32| {
                    (wanted - i64::from(level) * i64::from(slot.step)) as f64 * degrees_per_unit(slot.bap)
                };
                gain += off(0).powi(2) - off(level).powi(2);
                all_may_wait &= off(0).abs() <= self.config.max_lag;
            }
        }
        if gain < 0.0 && all_may_wait {
            self.levels.fill(0);
        }
    }

    /// The level whose error and cost are least together.
    fn level(&self, slot: &Slot, wanted: i64) -> i32 {
        let [min, max] = slot.predicted;
        let nearest = round_level(wanted, slot.step).clamp(min, max);
        if nearest == 0 || self.config.lambda == 0.0 {
            return nearest;
        }
        let model = Adaptive::new(self.writer.models().table(slot));
        let cost = |level: i32| {
            let error =
                (wanted - i64::from(level) * i64::from(slot.step)) as f64 * degrees_per_unit(slot.bap);
            let (below, above) = model.bounds((level - min) as usize);
            let bits = (f64::from(model.total()) / f64::from(above - below)).log2();
            error * error + self.config.lambda * bits
        };
        let candidates = [nearest, nearest - nearest.signum(), 0];
        let best =
            candidates.into_iter().map(|level| (cost(level), level)).min_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or(nearest, |(_, level)| level)
    }

    fn write_intra(&mut self, frame: &BapFrame, mask: BapMask) -> Result<PlaneBits, EncodeError> {
        self.params.quant = self.config.quant;
        self.params.mask = mask;
        self.choose_ranges(frame, mask)?;
        let header = PlaneHeader {
            kind: PlaneKind::Intra,
            object_mask: 2,
            rate: Some(self.config.rate),
            time_code: self.time_code(),
            skipped: self.skipped,
            explicit_skip: false,
        };
        self.levels.clear();
        self.levels.extend_from_slice(self.writer.intra_levels(&self.params, frame));
        let start_code = self.config.resync && self.planes > 0;
        let bits = self.writer.write_intra(&header, start_code, &self.params, &self.levels)?;
        if self.since_intra >= self.config.intra_interval {
            self.reach.known = self.reach.known.union(&mask);
        }
        self.since_intra = 1;
        Ok(bits)
    }

    /// The time code of a plane that falls on a whole second.
    fn time_code(&self) -> Option<TimeCode> {
        let seconds = self.frames as f64 / self.config.rate.per_second();
        let whole = (seconds - seconds.round()).abs() < 1e-6;
        (self.config.resync && whole).then(|| TimeCode::from_seconds(seconds.round() as u32)).flatten()
    }

    /// P levels that a BAP about which nothing is known may need.
    fn first_reach(&self, bap: Bap) -> i32 {
        let bends = bap.info().is_some_and(|info| info.name.ends_with("flexion"));
        let speed = if bends { FIRST_BEND_SPEED } else { FIRST_SPEED };
        let step = f64::from(super::state::step(bap, self.config.steps, self.config.quant));
        (speed / self.config.rate.per_second() / (step * degrees_per_unit(bap))).ceil().clamp(1.0, 1860.0)
            as i32
    }

    /// I ranges that just hold the values; P ranges that reach as far as anything seen so far, and at first
    /// a little further than hands usually need.
    fn choose_ranges(&mut self, frame: &BapFrame, mask: BapMask) -> Result<(), EncodeError> {
        let quant = self.config.quant;
        for bap in mask.iter() {
            let value = frame.value(bap);
            let level = round_level(value.into(), super::state::step(bap, self.config.steps, quant));
            let intra = |magnitude: i32| {
                range_code(magnitude, quant).ok_or_else(|| {
                    let reach = i64::from(range_levels(MAX_RANGE_CODE, quant))
                        * i64::from(super::state::step(bap, self.config.steps, quant));
                    EncodeError::OutOfRange { bap, value, min: -reach, max: reach }
                })
            };
            let reach = self.reach.ever[bap.index()] + 1;
            let first = self.first_reach(bap);
            let reach = reach.max(if self.reach.known.contains(bap) { first / 2 } else { first });
            let predicted = range_code(reach, quant).unwrap_or(MAX_RANGE_CODE);
            let codes = [intra(level.max(0))?, intra(-level.min(0))?, predicted, predicted];
            for (array, code) in self.params.ranges.iter_mut().zip(codes) {
                if let Some(array) = array {
                    array[bap.index()] = code;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fba::{Decoder, DecoderOptions, SyntaxError};
    use proptest::prelude::*;

    fn decode(stream: &[u8]) -> Result<Vec<BapFrame>, SyntaxError> {
        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(stream)?;
        decoder.finish();
        let mut frames = Vec::new();
        while let Some(frame) = decoder.next_frame()? {
            frames.push(frame.baps);
        }
        Ok(frames)
    }

    #[test]
    fn parameters_are_checked() {
        let rate = FrameRate { whole: 0, sixteenths: 0, offset: false };
        for config in [
            EncoderConfig { quant: 32, ..EncoderConfig::default() },
            EncoderConfig { rate, ..EncoderConfig::default() },
            EncoderConfig { lambda: f64::NAN, ..EncoderConfig::default() },
        ] {
            assert!(Encoder::new(config).is_err());
        }
    }

    #[test]
    fn values_beyond_the_largest_range_are_refused() {
        let mut encoder = Encoder::new(EncoderConfig::default()).unwrap();
        let bap = Bap::new(162).unwrap();
        let far: BapFrame = [(bap, 300_000)].into_iter().collect();
        assert!(matches!(encoder.write_frame(&far), Err(EncodeError::OutOfRange { .. })));
        let near: BapFrame = [(bap, 100_000)].into_iter().collect();
        encoder.write_frame(&near).unwrap();
        assert_eq!(decode(&encoder.finish()).unwrap().len(), 1);
    }

    #[test]
    fn skipped_frames_move_the_clock() {
        let mut encoder = Encoder::new(EncoderConfig::default()).unwrap();
        let frame: BapFrame = [(Bap::new(162).unwrap(), 0)].into_iter().collect();
        encoder.write_frame(&frame).unwrap();
        (0..20).for_each(|_| encoder.skip_frame());
        encoder.write_frame(&frame).unwrap();
        let stream = encoder.finish();
        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(&stream).unwrap();
        decoder.next_frame().unwrap();
        assert_eq!(decoder.next_frame().unwrap().unwrap().time, 0.7);
    }

    proptest! {
        /// Whatever moves however far, the decoder has what the encoder thinks it has, and never
        /// further from the input than the step and the lag allow.
        #[test]
        fn decoder_follows_encoder(
            quant in 1u8..32,
            interval in 0u32..20,
            resync: bool,
            wrapper in prop::option::of(0x61u8..0x65),
            lambda in prop_oneof![Just(0.0), 0.0f64..1.0],
            frames in prop::collection::vec(
                (prop::collection::btree_set(prop_oneof![123u16..181, 187u16..199], 1..6), any::<u32>()), 1..40),
        ) {
            let config = EncoderConfig {
                quant, intra_interval: interval, resync, wrapper, lambda, max_lag: 3.0, sparse: false,
                ..EncoderConfig::default()
            };
            let mut encoder = Encoder::new(config).unwrap();
            let mut expected = Vec::new();
            let mut mask: Vec<Bap> = Vec::new();
            for (number, (baps, seed)) in frames.iter().enumerate() {
                if number % 8 == 0 {
                    mask = baps.iter().map(|&number| Bap::new(number).unwrap()).collect();
                }
                let mut state = *seed;
                let frame: BapFrame = mask.iter().map(|&bap| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    let limit = if bap.is_extension() { 1_700 } else { 100_000 };
                    let range = if state >> 30 == 0 { limit } else { limit / 50 };
                    (bap, (state >> 8) as i32 % (range + 1) - range / 2)
                }).collect();
                encoder.write_frame(&frame).unwrap();
                let step = |bap: Bap| bap.base_step(StepTable::Standard) * crate::fba::syntax::scale(quant);
                for (bap, value) in encoder.reconstruction().iter() {
                    let error = f64::from(value - frame.value(bap)).abs();
                    let most = f64::from(step(bap)) / 2.0 + 1.0 + 3.0 / degrees_per_unit(bap);
                    prop_assert!(error <= most, "{} off by {}", bap, error);
                }
                expected.push(encoder.reconstruction());
            }
            let bits = encoder.bits().total();
            let stream = encoder.finish();
            prop_assert!(stream.len() as u64 * 8 <= bits + 32 + 8 + 32 + 120);
            prop_assert_eq!(decode(&stream).unwrap(), expected);
        }
    }
}
