//! A frame-by-frame encoder without look-ahead.

use super::error::EncodeError;
use super::frame_writer::FrameWriter;
use super::reach::{Reach, set_ranges};
use super::state::{round_level, step};
use super::syntax::{FrameRate, IntraParams, PlaneHeader, PlaneKind, RangeRule, TimeCode};
use super::writer::{PlaneBits, PlaneWriter};
use crate::bap::{Bap, BapFrame, BapMask, PER_RADIAN, StepTable, Unit};

/// How to encode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderConfig {
    /// Base steps; the decoder must be told the same.
    pub steps: StepTable,
    /// How a decoder reads range codes; it must be told the same.
    pub ranges: RangeRule,
    /// Frame rate, sent with every I plane.
    pub rate: FrameRate,
    /// Quantiser index, 0 to 31. The step of a finger bend is 0.073° times the scale of the index.
    pub quant: u8,
    /// Frames from one I plane to the next; 0 sends only those that are needed.
    pub intra_interval: u32,
    /// Start code and time code with every I plane, so that a decoder can resume there after damage.
    pub resync: bool,
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
            ranges: RangeRule::Divided,
            rate: FrameRate::ASSUMED,
            quant: 10,
            intra_interval: 150,
            resync: false,
            max_lag: 2.0,
            wrapper: None,
        }
    }
}

/// Degrees that one unit of a BAP counts for in error measures. Angles are what they are. A millimetre
/// and a unit of an extension BAP (for hand streams 1 mm or 0.1°) count as a tenth of a degree.
pub fn degrees_per_unit(bap: Bap) -> f64 {
    match bap.unit() {
        Unit::Angle => (1.0 / PER_RADIAN).to_degrees(),
        Unit::Millimetre | Unit::Extension => 0.1,
    }
}

/// Encodes frames as they come; every frame becomes one plane.
///
/// ```
/// use handcast_fba::bap::{Bap, BapFrame};
/// use handcast_fba::{Decoder, DecoderOptions, Encoder, EncoderConfig};
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
    out: FrameWriter,
    params: IntraParams,
    /// Frames since the last I plane, it included.
    since_intra: u32,
    reach: Reach,
}

/// Degrees per second that the P ranges of a bend allow for at first.
const FIRST_BEND_SPEED: f64 = 390.0;
/// Degrees per second that the P ranges of other BAPs allow for at first.
const FIRST_SPEED: f64 = 270.0;
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
        if config.max_lag.is_nan() || config.max_lag <= 0.0 {
            return refuse("largest lag", config.max_lag, "positive");
        }
        let writer = match config.wrapper {
            Some(profile) => PlaneWriter::with_visual_wrapper(config.steps, profile),
            None => PlaneWriter::new(config.steps),
        };
        let writer = writer.with_ranges(config.ranges);
        Ok(Self {
            config,
            out: FrameWriter::new(writer),
            params: IntraParams::default(),
            since_intra: 0,
            reach: Reach::new(),
        })
    }

    /// Encodes one frame: the BAPs in its mask. An I plane is sent first of all, when the interval is
    /// over, when the mask changes, and when a movement leaves the P ranges. The result says what the plane
    /// cost.
    ///
    /// # Errors
    /// [`EncodeError::OutOfRange`] for a value that no I plane can carry; the frame is then not encoded
    /// and the encoder stays usable.
    pub fn write_frame(&mut self, frame: &BapFrame) -> Result<PlaneBits, EncodeError> {
        let due = self.config.intra_interval > 0 && self.since_intra >= self.config.intra_interval;
        let changed = self.out.planes() == 0 || self.out.writer.layout().mask() != frame.mask;
        if due || changed || !self.predict(frame) {
            self.write_intra(frame)
        } else {
            let bits = self.out.write_predicted()?;
            self.since_intra += 1;
            Ok(bits)
        }
    }

    /// Leaves one frame out. A plane without change stands for those left out on end; it is written with the next plane.
    pub fn skip_frame(&mut self) {
        self.out.skip();
        self.since_intra += 1;
    }

    /// The values a decoder has now.
    pub fn reconstruction(&self) -> BapFrame {
        self.out.reconstruction()
    }

    /// The value of `bap` that a decoder has now.
    pub fn value(&self, bap: Bap) -> i32 {
        self.out.writer.values()[bap.index()]
    }

    /// Where the bits went so far.
    pub fn bits(&self) -> PlaneBits {
        self.out.bits()
    }

    /// Planes written so far.
    pub fn planes(&self) -> u64 {
        self.out.planes()
    }

    /// The BAPs sent.
    pub fn mask(&self) -> BapMask {
        self.out.writer.layout().mask()
    }

    /// Moves the bytes finished so far to the end of `out`.
    pub fn take_bytes(&mut self, out: &mut Vec<u8>) {
        self.out.writer.take_bytes(out);
    }

    /// Ends the stream and returns the bytes not taken yet. If the last frames were left out, a plane
    /// without change stands for them, so that the stream has its full length.
    pub fn finish(self) -> Vec<u8> {
        self.out.finish()
    }

    /// Chooses the levels of a P plane; false if the ranges are too narrow for it.
    fn predict(&mut self, frame: &BapFrame) -> bool {
        self.out.levels.clear();
        let mut fits = true;
        for slot in self.out.writer.layout().slots() {
            let before = self.out.writer.values()[slot.bap.index()];
            let wanted = i64::from(frame.value(slot.bap)) - i64::from(before);
            let rounded = round_level(wanted, slot.step);
            let level = rounded.clamp(slot.predicted[0], slot.predicted[1]);
            if rounded != 0 {
                self.reach.note(slot.bap, i64::from(rounded) * i64::from(slot.step));
            }
            if level != rounded {
                let lag = wanted - i64::from(level) * i64::from(slot.step);
                fits &= (lag as f64 * degrees_per_unit(slot.bap)).abs() <= self.config.max_lag;
            }
            self.out.levels.push(level);
        }
        fits
    }

    fn write_intra(&mut self, frame: &BapFrame) -> Result<PlaneBits, EncodeError> {
        self.params.quant = self.config.quant;
        self.params.mask = frame.mask;
        self.choose_ranges(frame)?;
        let header = PlaneHeader {
            kind: PlaneKind::Intra,
            object_mask: 2,
            rate: Some(self.config.rate),
            time_code: if self.config.resync {
                TimeCode::at(self.out.frames(), self.config.rate)
            } else {
                None
            },
            ..PlaneHeader::default()
        };
        self.out.levels.clear();
        self.out.levels.extend_from_slice(self.out.writer.intra_levels(&self.params, frame));
        let start_code = self.config.resync && self.out.planes() > 0;
        let bits = self.out.write(&header, start_code, Some(&self.params))?;
        if self.since_intra >= self.config.intra_interval {
            self.reach.end_period(&frame.mask, 1.0);
        }
        self.since_intra = 1;
        Ok(bits)
    }

    /// P ranges reach a step further than anything seen so far, and at first a little further than hands
    /// usually need.
    fn choose_ranges(&mut self, frame: &BapFrame) -> Result<(), EncodeError> {
        let EncoderConfig { steps, quant, rate, .. } = self.config;
        let reach = &self.reach;
        set_ranges(&mut self.params, frame, steps, |bap| {
            let speed = if is_bend(bap) { FIRST_BEND_SPEED } else { FIRST_SPEED };
            let first = (speed / rate.per_second() / degrees_per_unit(bap)) as i32;
            let least = if reach.knows(bap) { first / 2 } else { first };
            let [up, down] = reach.seen(bap);
            [up.max(down).saturating_add(step(bap, steps, quant)).max(least); 2]
        })
    }
}

/// Whether a BAP bends a joint.
fn is_bend(bap: Bap) -> bool {
    bap.info().is_some_and(|info| info.name.ends_with("flexion"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Decoder, DecoderOptions, SyntaxError};
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
            EncoderConfig { max_lag: f64::NAN, ..EncoderConfig::default() },
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
        let times =
            std::iter::from_fn(|| decoder.next_frame().unwrap()).map(|plane| (plane.time, plane.skipped));
        assert_eq!(times.collect::<Vec<_>>(), [(0.0, 0), (1.0 / 30.0, 19), (0.7, 0)]);
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
            frames in prop::collection::vec(
                (prop::collection::btree_set(prop_oneof![123u16..181, 187u16..199], 1..6), any::<u32>()), 1..40),
        ) {
            let config = EncoderConfig {
                quant, intra_interval: interval, resync, wrapper, max_lag: 3.0, ..EncoderConfig::default()
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
                let step = |bap: Bap| bap.base_step(StepTable::Standard) * crate::syntax::scale(quant);
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
