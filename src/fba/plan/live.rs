//! Coding each frame when it comes.

use super::super::arith::{Adaptive, Model};
use super::super::encoder::degrees_per_unit;
use super::super::error::EncodeError;
use super::super::frame_writer::FrameWriter;
use super::super::reach::{Reach, intra_codes, predicted_code, set_ranges};
use super::super::state::{Slot, round_level, step};
use super::super::syntax::{
    IntraParams, PlaneHeader, PlaneKind, RangeCodes, RangeEnd, TimeCode, range_levels,
};
use super::super::writer::PlaneBits;
use super::steering::{Steering, live_quant};
use super::{PlanOptions, RateMode, degrees_of, new_writer, positive};
use crate::bap::derive::companions;
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask};

/// An encoder without look-ahead that steers to the aim of [`PlanOptions::mode`].
///
/// Frames in which nothing is worth changing are left out; the next plane says how many. BAPs that never
/// moved away from 0 are not sent.
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
    options: PlanOptions,
    /// Whether frames and BAPs may be left out.
    sparse: bool,
    interval: u64,
    steering: Steering,
    out: FrameWriter,
    /// BAPs whose P range did not hold the last frame, and the changes wanted.
    outgrown: Vec<(Bap, i64)>,
    reach: Reach,
    worthy: BapMask,
    /// Frames since the last I plane with all ranges.
    since_complete: u64,
}

/// Degrees from which on a BAP is worth sending.
const WORTH_SENDING: f64 = 0.05;
/// Bits of a P plane around its values: header and flush, less what skipping it adds to the next header.
const PLANE_OVERHEAD: f64 = 4.0;
/// What a change that left its range is multiplied with to give the next range.
const WIDENING: f64 = 1.5;
/// Share of that for other BAPs of the same kind.
const KINSHIP: f64 = 0.4;
/// What the largest change seen is multiplied with when ranges are chosen anew.
const MARGIN: f64 = 1.3;
/// Where the rate is to be held: steps that a value may be off by to save bits, and how much further it may
/// lag behind while a motion is faster than its P range or planes are left out.
const ZONE_STEPS: f64 = 1.5;
const LAG: f64 = 4.0;
/// What needs of earlier I periods keep from period to period.
const MEMORY: f64 = 0.95;

/// BAPs that move alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Knuckles and middle joints.
    Bend,
    /// End joints of the fingers.
    End,
    Pivot,
    Twist,
    Other,
}

impl Kind {
    fn of(bap: Bap) -> Self {
        match bap.info().map_or("", |info| info.name) {
            name if name.ends_with("3_flexion") => Self::End,
            name if name.ends_with("flexion") => Self::Bend,
            name if name.ends_with("pivot") => Self::Pivot,
            name if name.ends_with("twisting") => Self::Twist,
            _ => Self::Other,
        }
    }

    /// Degrees per second that P ranges allow for at first.
    fn first_speed(self) -> f64 {
        match self {
            Self::Bend => 390.0,
            Self::Pivot | Self::Twist => 270.0,
            Self::End => 220.0,
            Self::Other => 110.0,
        }
    }
}

/// Why an I plane is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Need {
    /// It is due, or the mask changes: it says everything.
    Complete,
    /// A value left its range: it says what changes.
    Ranges,
    /// The rate asks for another quantiser: it says that, and which ranges change.
    Quant(u8),
}

impl LiveEncoder {
    /// An encoder at the start of a stream.
    ///
    /// # Errors
    /// A parameter outside its range.
    pub fn new(options: &PlanOptions) -> Result<Self, EncodeError> {
        options.check()?;
        positive("frame rate", options.rate.per_second())?;
        Ok(Self {
            options: *options,
            sparse: !matches!(options.mode, RateMode::Quant(_)),
            interval: (options.intra_seconds * options.rate.per_second()).round().max(1.0) as u64,
            steering: Steering::new(options),
            out: FrameWriter::new(new_writer(options)),
            outgrown: Vec::with_capacity(BAP_COUNT),
            reach: Reach::new(),
            worthy: BapMask::EMPTY,
            since_complete: 0,
        })
    }

    /// Encodes one frame, and says what its plane cost: nothing if it is left out.
    ///
    /// # Errors
    /// [`EncodeError::OutOfRange`] for a value that no I plane can carry; the frame is then not encoded
    /// and the encoder stays usable.
    pub fn write_frame(&mut self, frame: &BapFrame) -> Result<PlaneBits, EncodeError> {
        let mut frame = *frame;
        frame.mask = self.options.sendable(&frame.mask);
        let complete = self.needs_complete(&frame);
        // Where the rate is to be held, I planes keep to their times.
        let early = self.out.planes() > 0 && self.since_complete < self.interval;
        let bits = if complete {
            self.write_intra(&frame, Need::Complete)?
        } else if let Some(quant) = self.steering.requant(&self.options, &self.mask(), self.quant()) {
            self.write_intra(&frame, Need::Quant(quant))?
        } else if !self.predict(&frame) {
            let late = self.since_complete * 2 > self.interval && !self.holds_rate();
            self.write_intra(&frame, if late || self.options.resync { Need::Complete } else { Need::Ranges })?
        } else if self.sparse && self.out.levels.iter().all(|&level| level == 0) {
            self.skip_frame();
            self.steer(&frame, &PlaneBits::default(), false);
            return Ok(PlaneBits::default());
        } else {
            self.out.write_predicted()?
        };
        self.since_complete += 1;
        self.steer(&frame, &bits, bits.intra_values > 0 && !early);
        Ok(bits)
    }

    /// Leaves out a frame for which there is no pose.
    pub fn skip_frame(&mut self) {
        self.out.skip();
        self.since_complete += 1;
    }

    /// Squared degrees a bit may cost at the moment.
    pub fn lambda(&self) -> f64 {
        self.steering.lambda()
    }

    /// The BAPs sent.
    pub fn mask(&self) -> BapMask {
        self.out.writer.layout().mask()
    }

    /// Quantiser index in force.
    pub fn quant(&self) -> u8 {
        self.out.writer.layout().quant()
    }

    /// The values a decoder has now.
    pub fn reconstruction(&self) -> BapFrame {
        self.out.reconstruction()
    }

    /// Where the bits went so far.
    pub fn bits(&self) -> PlaneBits {
        self.out.bits()
    }

    /// Planes written so far.
    pub fn planes(&self) -> u64 {
        self.out.planes()
    }

    /// Moves the bytes finished so far to the end of `out`.
    pub fn take_bytes(&mut self, out: &mut Vec<u8>) {
        self.out.writer.take_bytes(out);
    }

    /// Ends the stream and returns the bytes not taken yet. If the last frames were left out, a plane
    /// without change stands for the last of them, so that the stream has its full length.
    pub fn finish(self) -> Vec<u8> {
        self.out.finish()
    }

    fn steer(&mut self, frame: &BapFrame, bits: &PlaneBits, scheduled: bool) {
        let values = self.out.writer.values();
        self.steering.follow(frame, |bap| values[bap.index()], bits, scheduled);
    }

    fn holds_rate(&self) -> bool {
        matches!(self.options.mode, RateMode::Bitrate(_))
    }

    /// Largest error of a BAP for the sake of fewer bits, but half a step at least.
    fn zone(&self, bap: Bap) -> f64 {
        let step = degrees_of(bap, step(bap, self.options.steps, self.quant()).into());
        self.options.room(bap).max(if self.holds_rate() { ZONE_STEPS * step } else { 0.5 * step })
    }

    /// Largest error of a BAP before an I plane is sent. Where the rate is to be held, values rather lag
    /// behind for a moment.
    fn room(&self, bap: Bap) -> f64 {
        if self.holds_rate() {
            LAG * self.options.room(bap).max(self.zone(bap) / 2.0)
        } else {
            self.zone(bap)
        }
    }

    /// Whether an I plane that says everything must be sent: it is due, or the mask changes. A BAP that
    /// moves away from 0 for the first time waits for the next I plane if it can.
    fn needs_complete(&mut self, frame: &BapFrame) -> bool {
        if self.out.planes() == 0 || self.since_complete >= self.interval {
            return true;
        }
        let mask = self.mask();
        if !self.sparse {
            return mask != frame.mask;
        }
        let urgent = |(bap, value): (Bap, i32)| {
            !mask.contains(bap) && degrees_of(bap, value.into()).abs() > self.room(bap)
        };
        !mask.difference(&frame.mask).is_empty() || frame.iter().any(urgent)
    }

    /// Chooses the levels of a P plane; false if the ranges are too narrow for it.
    fn predict(&mut self, frame: &BapFrame) -> bool {
        self.out.levels.clear();
        let lambda = self.steering.lambda();
        let mut fits = true;
        let mut gain = -lambda * PLANE_OVERHEAD;
        let mut may_wait = true;
        let presses = self.steering.presses();
        self.outgrown.clear();
        for slot in self.out.writer.layout().slots() {
            let bap = slot.bap;
            let wanted = i64::from(frame.value(bap)) - i64::from(self.out.writer.values()[bap.index()]);
            let step = i64::from(slot.step);
            let zone = self.zone(bap);
            let room = self.room(bap);
            let model = self.out.writer.models().model(slot);
            let (level, saved) = choose(slot, wanted, &model, lambda, zone);
            gain += saved;
            let lag = degrees_of(bap, wanted - i64::from(level) * step).abs();
            if lag > room {
                fits = false;
                self.outgrown.push((bap, wanted));
            }
            let rounded = round_level(wanted, slot.step);
            let clamped = level == slot.predicted[usize::from(rounded > 0)] && rounded != level;
            self.reach.note(bap, if clamped { wanted } else { i64::from(level) * step });
            may_wait &= degrees_of(bap, wanted).abs() <= if presses { room } else { zone };
            self.out.levels.push(level);
        }
        if self.sparse && fits && may_wait && (gain < 0.0 || presses) {
            self.out.levels.fill(0);
        }
        self.widen();
        fits
    }

    /// Widens the ranges of BAPs that outgrew them, both ways, as what goes one way comes back; and those of
    /// the other BAPs of their kind to some degree, as fingers move together.
    fn widen(&mut self) {
        let mask = self.mask();
        for &(bap, wanted) in &self.outgrown {
            let wide = (wanted as f64 * WIDENING) as i64;
            let kin = (wide as f64 * KINSHIP) as i64;
            for other in mask.iter().filter(|other| Kind::of(*other) == Kind::of(bap)) {
                let reach = if other == bap { wide } else { kin };
                self.reach.note(other, reach);
                self.reach.note(other, -reach);
            }
        }
    }

    fn write_intra(&mut self, frame: &BapFrame, need: Need) -> Result<PlaneBits, EncodeError> {
        let params = match need {
            Need::Complete => self.complete_params(frame)?,
            Need::Ranges => self.changed_params(frame, self.quant())?,
            Need::Quant(quant) => self.changed_params(frame, quant)?,
        };
        let header = PlaneHeader {
            kind: PlaneKind::Intra,
            object_mask: 2,
            rate: (need == Need::Complete).then_some(self.options.rate),
            time_code: self.time_code(),
            ..PlaneHeader::default()
        };
        self.out.levels.clear();
        self.out.levels.extend_from_slice(self.out.writer.intra_levels(&params, frame));
        let first = self.out.planes() == 0;
        let start_code = self.options.resync && !first;
        let bits = self.out.write(&header, start_code, Some(&params))?;
        if need == Need::Complete {
            self.since_complete = match self.since_complete {
                since if self.holds_rate() && !first => since % self.interval,
                _ => 0,
            };
        }
        Ok(bits)
    }

    fn time_code(&self) -> Option<TimeCode> {
        self.options.resync.then(|| TimeCode::at(self.out.frames(), self.options.rate)).flatten()
    }

    /// Mask, quantiser and all ranges anew.
    fn complete_params(&mut self, frame: &BapFrame) -> Result<IntraParams, EncodeError> {
        if self.since_complete >= self.interval {
            self.reach.end_period(&self.mask(), MEMORY);
        }
        for (bap, value) in frame.iter() {
            if degrees_of(bap, value.into()).abs() > WORTH_SENDING {
                self.worthy.insert(bap);
            }
        }
        let mask = match self.sparse {
            true => frame.mask.intersection(&self.worthy).union(&companions(&frame.mask, &self.worthy)),
            false => frame.mask,
        };
        let quant = live_quant(&self.options, &self.steering, &mask);
        let mut params = IntraParams { quant, mask, ..IntraParams::default() };
        set_ranges(&mut params, frame, self.options.steps, |bap| self.wanted_reach(bap, quant))?;
        if mask.is_empty() {
            params.ranges = [Some([0; BAP_COUNT]); 4];
        }
        Ok(params)
    }

    /// What P ranges should reach, upwards and downwards.
    fn wanted_reach(&self, bap: Bap, quant: u8) -> [i32; 2] {
        let first = Kind::of(bap).first_speed() / self.options.rate.per_second();
        let first = (first / degrees_per_unit(bap)) as i32;
        let step = step(bap, self.options.steps, quant);
        let least = if self.reach.knows(bap) { step } else { first.max(step) };
        self.reach.seen(bap).map(|reach| ((f64::from(reach) * MARGIN) as i32).max(least))
    }

    /// The quantiser, and only the range arrays in which a BAP outgrew its code; those are renewed as a
    /// whole.
    fn changed_params(&self, frame: &BapFrame, quant: u8) -> Result<IntraParams, EncodeError> {
        let mask = self.mask();
        let mut params = IntraParams { quant, mask, ..IntraParams::default() };
        let steps = self.options.steps;
        let mut wanted: [RangeCodes; 4] = [[0; BAP_COUNT]; 4];
        let mut outgrown = [false; 4];
        for slot in self.out.writer.layout().slots() {
            let bap = slot.bap;
            let intra = intra_codes(bap, frame.value(bap), steps, quant)?;
            let seen = self.reach.seen(bap).map(|reach| predicted_code(bap, reach, steps, quant));
            let reach = self.wanted_reach(bap, quant).map(|reach| predicted_code(bap, reach, steps, quant));
            let needed = [intra[0], intra[1], seen[0], seen[1]];
            let codes = [intra[0], intra[1], reach[0], reach[1]];
            // What persists are levels: a coarser quantiser makes them reach further.
            let known = [slot.intra[1], -slot.intra[0], slot.predicted[1], -slot.predicted[0]];
            for end in RangeEnd::ALL.map(|end| end as usize) {
                wanted[end][bap.index()] = codes[end];
                outgrown[end] |= known[end] < range_levels(needed[end], quant);
            }
        }
        for (range, (codes, outgrown)) in params.ranges.iter_mut().zip(wanted.into_iter().zip(outgrown)) {
            *range = outgrown.then_some(codes);
        }
        Ok(params)
    }
}

/// The level of least squared error and λ-weighted bits among those off by `bound` degrees at most, and what
/// sending it instead of leaving out the plane saves; negative for zeros that only keep others company. Out
/// of range, it is the nearest.
fn choose(slot: &Slot, wanted: i64, model: &Adaptive<'_>, lambda: f64, bound: f64) -> (i32, f64) {
    let [min, max] = slot.predicted;
    let nearest = round_level(wanted, slot.step).clamp(min, max);
    let off = |level: i32| degrees_of(slot.bap, wanted - i64::from(level) * i64::from(slot.step)).abs();
    let cost = |level: i32| {
        let (below, above) = model.bounds((level - min) as usize);
        off(level).powi(2) + lambda * (f64::from(model.total()) / f64::from(above - below)).log2()
    };
    let candidates = [nearest - nearest.signum(), 0].into_iter().filter(|&level| off(level) <= bound);
    let (least, level) = candidates.fold((cost(nearest), nearest), |best, level| {
        let cost = cost(level);
        if cost < best.0 { (cost, level) } else { best }
    });
    (level, off(0).powi(2) - least)
}
