//! Rate control without look-ahead: each frame is coded when it comes.

use super::super::encoder::{Encoder, EncoderConfig, degrees_per_unit};
use super::super::error::EncodeError;
use super::super::writer::PlaneBits;
use super::{PlanOptions, RateMode};
use crate::bap::{BapFrame, BapMask, Unit};

/// An [`Encoder`] that steers its λ to the aim of [`PlanOptions::mode`].
///
/// ```
/// use handcast::bap::{Bap, BapFrame};
/// use handcast::fba::plan::{LiveEncoder, PlanOptions, RateMode};
///
/// let bend = Bap::from_name("r_index1_flexion").unwrap();
/// let options = PlanOptions { mode: RateMode::Bitrate(1.0), ..PlanOptions::default() };
/// let mut encoder = LiveEncoder::new(&options)?;
/// let mut stream = Vec::new();
/// for frame in 0..30 {
///     encoder.write_frame(&[(bend, -1_000 * frame)].into_iter().collect())?;
///     encoder.take_bytes(&mut stream); // whole bytes, ready to be sent
/// }
/// stream.extend(encoder.finish());
/// # Ok::<(), handcast::fba::error::EncodeError>(())
/// ```
#[derive(Clone, Debug)]
pub struct LiveEncoder {
    encoder: Encoder,
    aim: Aim,
    derived: BapMask,
    lambda: f64,
    /// Angles ever different from 0.
    moving: BapMask,
    /// Squared error and number of values so far, and of late.
    error: [Average; 2],
    /// Bits spent beyond the aim, I planes spread over their period.
    surplus: f64,
    /// Bits of I planes not charged yet, and what is charged per frame.
    owed: [f64; 2],
    interval: f64,
}

#[derive(Clone, Copy, Debug)]
enum Aim {
    Fixed,
    /// Mean square error, squared degrees.
    Error(f64),
    /// Bits per frame, and frames per second.
    Bits(f64, f64),
}

/// Sum of squares and number of values.
#[derive(Clone, Copy, Debug, Default)]
struct Average {
    sum: f64,
    count: f64,
}

impl Average {
    fn add(&mut self, sum: f64, count: f64, keep: f64) {
        self.sum = self.sum * keep + sum;
        self.count = self.count * keep + count;
    }

    fn mean(&self) -> f64 {
        if self.count > 0.0 { self.sum / self.count } else { 0.0 }
    }
}

/// Quantiser index where the aim does not name one; the search over whole clips mostly ends here.
const LIVE_QUANT: u8 = 9;
/// What the recent error keeps from frame to frame: a memory of about three seconds.
const KEEP: f64 = 0.989;

impl LiveEncoder {
    /// An encoder at the start of a stream.
    ///
    /// # Errors
    /// A parameter outside its range.
    pub fn new(options: &PlanOptions) -> Result<Self, EncodeError> {
        let rate = options.rate.per_second();
        let mut config = EncoderConfig {
            steps: options.steps,
            rate: options.rate,
            intra_interval: (options.intra_seconds * rate).round().max(1.0) as u32,
            resync: options.resync,
            wrapper: options.wrapper,
            quant: LIVE_QUANT,
            sparse: true,
            max_lag: options.max_error,
            ..EncoderConfig::default()
        };
        let (aim, lambda) = match options.mode {
            RateMode::Quant(quant) => {
                config.quant = quant;
                config.sparse = false;
                (Aim::Fixed, 0.0)
            }
            RateMode::MaxError(degrees) => {
                config.quant = quant_for(options, 1.2 * degrees);
                config.max_lag = degrees;
                (Aim::Fixed, 0.3 * degrees * degrees)
            }
            RateMode::TargetRms(degrees) => {
                config.quant = quant_for(options, 2.5 * degrees);
                (Aim::Error(degrees * degrees), 0.4 * degrees * degrees)
            }
            RateMode::Bitrate(kbit_per_s) => (Aim::Bits(kbit_per_s * 1000.0 / rate, rate), 0.2),
        };
        config.lambda = lambda;
        Ok(Self {
            interval: f64::from(config.intra_interval),
            encoder: Encoder::new(config)?,
            aim,
            derived: options.derived,
            lambda,
            moving: BapMask::EMPTY,
            error: [Average::default(); 2],
            surplus: 0.0,
            owed: [0.0; 2],
        })
    }

    /// Encodes one frame; see [`Encoder::write_frame`].
    ///
    /// # Errors
    /// A value that cannot be coded.
    pub fn write_frame(&mut self, frame: &BapFrame) -> Result<PlaneBits, EncodeError> {
        let mut frame = *frame;
        frame.mask = frame.mask.difference(&self.derived);
        let bits = self.encoder.write_frame(&frame)?;
        self.steer(&frame, &bits);
        Ok(bits)
    }

    /// Leaves out a frame for which there is no pose.
    pub fn skip_frame(&mut self) {
        self.encoder.skip_frame();
    }

    /// Squared degrees a bit may cost at the moment.
    pub fn lambda(&self) -> f64 {
        self.lambda
    }

    /// The encoder behind it.
    pub fn encoder(&self) -> &Encoder {
        &self.encoder
    }

    /// Moves the bytes finished so far to the end of `out`.
    pub fn take_bytes(&mut self, out: &mut Vec<u8>) {
        self.encoder.take_bytes(out);
    }

    /// Ends the stream and returns the bytes not taken yet.
    pub fn finish(self) -> Vec<u8> {
        self.encoder.finish()
    }

    fn steer(&mut self, frame: &BapFrame, bits: &PlaneBits) {
        match self.aim {
            Aim::Fixed => return,
            Aim::Error(target) => {
                let (mut sum, mut count) = (0.0, 0.0);
                for (bap, value) in frame.iter().filter(|(bap, _)| bap.unit() == Unit::Angle) {
                    if value != 0 {
                        self.moving.insert(bap);
                    }
                    if self.moving.contains(bap) {
                        let off =
                            (f64::from(value) - f64::from(self.encoder.value(bap))) * degrees_per_unit(bap);
                        sum += off * off;
                        count += 1.0;
                    }
                }
                self.error[0].add(sum, count, 1.0);
                self.error[1].add(sum, count, KEEP);
                let [all, late] = self.error.map(|average| average.mean());
                let pull = 1.0 - (0.5 * (all + late)).max(all) / target;
                self.lambda = (self.lambda * (0.05 * pull).exp()).clamp(1e-3 * target, 16.0 * target);
            }
            Aim::Bits(target, rate) => {
                let total = bits.total() as f64;
                if bits.intra_values > 0 {
                    self.owed[0] += total;
                    self.owed[1] = self.owed[0] / self.interval;
                }
                let part = self.owed[1].min(self.owed[0]);
                self.owed[0] -= part;
                let spent = part + if bits.intra_values > 0 { 0.0 } else { total };
                self.surplus += spent - target;
                // Half a second's worth of surplus moves λ by a factor of e; saved bits are not hoarded for
                // more than a second.
                let second = target * rate;
                self.surplus = self.surplus.max(-second);
                self.lambda = (0.3 * (2.0 * self.surplus / second).exp()).clamp(1e-3, 64.0);
            }
        }
        self.encoder.set_lambda(self.lambda);
    }
}

/// The quantiser index whose step for a finger bend comes nearest to `degrees`.
fn quant_for(options: &PlanOptions, degrees: f64) -> u8 {
    let bend = crate::bap::Bap::from_name("r_index1_flexion");
    let base = bend.map_or(128, |bap| bap.base_step(options.steps));
    let off = |quant: u8| {
        let step = f64::from(base * super::super::syntax::scale(quant)) * 1e-5f64.to_degrees();
        (step / degrees).ln().abs()
    };
    (1..=31).min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(LIVE_QUANT)
}
