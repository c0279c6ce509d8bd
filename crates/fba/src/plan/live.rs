//! Coding each frame when it comes.

mod ranges;
mod session;

pub(super) use session::{LiveSession, write_live};

use super::super::arith::{Adaptive, Model};
use super::super::error::EncodeError;
use super::super::frame_writer::{FrameWriter, Still};
use super::super::reach::{Reach, check_reach};
use super::super::record::Record;
use super::super::state::{Slot, round_level, step};
use super::super::syntax::{IntraParams, PlaneHeader, PlaneKind, TimeCode};
use super::super::writer::PlaneBits;
use super::budget::Room;
use super::options::{PlanOptions, Target, new_writer, positive};
use super::steering::{Cause, Steering, live_quant};
use crate::bap::derive::companions;
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask, Unit};

/// An encoder without look-ahead that steers to the aim of [`PlanOptions::mode`].
///
/// Frames in which nothing is worth changing are left out; the next plane says how many. BAPs that never
/// moved away from 0 are not sent; where no rate is to be held, a hand's finger joints, but for the bends of the palm, are
/// sent as soon as one of them moves.
///
/// ```
/// use handcast_fba::bap::{Bap, BapFrame};
/// use handcast_fba::plan::{LiveEncoder, PlanOptions, Target};
///
/// let bend = Bap::from_name("r_index1_flexion").unwrap();
/// let options = PlanOptions { mode: Target::Bitrate(1.0), ..PlanOptions::default() };
/// let mut encoder = LiveEncoder::new(&options)?;
/// let mut stream = Vec::new();
/// for frame in 0..30 {
///     encoder.write_frame(&[(bend, -1_000 * frame)].into_iter().collect())?;
///     encoder.take_bytes(&mut stream); // whole bytes, ready to be sent
/// }
/// stream.extend(encoder.finish());
/// # Ok::<(), handcast_fba::error::EncodeError>(())
/// ```
#[derive(Clone, Debug)]
pub struct LiveEncoder {
    options: PlanOptions,
    /// Whether frames and BAPs may be left out.
    sparse: bool,
    /// What a start code, and what goes with it, costs at most.
    start_code_bits: f64,
    interval: u64,
    steering: Steering,
    out: FrameWriter,
    /// What errors of each BAP that is sent count for, in coding order; nothing of anchors, which P planes leave as they are.
    worths: Vec<Option<Worth>>,
    /// BAPs whose P range did not hold the last frame, and the changes wanted.
    outgrown: Vec<(Bap, i64)>,
    /// Whether one of them lags so far behind that it shows.
    urgent: bool,
    /// For how many frames each angle has been so far off that it shows, where the rate is to be held.
    late: [u32; BAP_COUNT],
    reach: Reach,
    /// Largest and smallest value of each BAP so far, 0 included.
    extent: [[i32; 2]; BAP_COUNT],
    worthy: BapMask,
    /// The frame before, where the rate is to be held.
    before: Option<BapFrame>,
    /// Frames since the last I plane with all ranges.
    since_complete: u64,
    /// Whether what was needed in the I period that is over has been looked at.
    period_ended: bool,
    /// Whether somebody wants an I plane.
    asked: bool,
    /// Frames left out of late for the I plane of a leap.
    saved: u32,
    /// Whether a hand has leapt: ranges are then to serve the I planes of further leaps.
    leapt: bool,
}

/// Largest error of an anchor, as quantisers round it.
const ANCHOR_TOLERANCE: i64 = 64;
/// Change of a value that comes of another anchor.
const LEAP: i64 = 900;
/// Seconds that are left out at most, within an I period, for the I planes of leaps.
const SAVED_SECONDS: f64 = 0.4;
/// Bits of a P plane around its values: header and flush, less what skipping it adds to the next header.
const PLANE_OVERHEAD: f64 = 4.0;
/// Bits that the changes of a plane must be worth where no rate is to be held, lest many planes say little each.
const PLANE_WORTH: f64 = 24.0;
/// Bits around the values of a plane that stands for frames left out.
const STILL_OVERHEAD: f64 = 14.0;
/// Where the rate is to be held: steps from which on the error of a value weighs more, and how much more.
const ZONE_STEPS: f64 = 1.5;
const BEYOND: f64 = 30.0;
/// How much further a value may lag behind there before ranges are sent anew, if the rate has room for them.
const LAG: f64 = 4.0;
/// Degrees by which an angle may lag there before ranges are sent anew, however lately they were, and how much further
/// what is no angle.
const SHOWN_LAG: f64 = 10.0;
const EXTRA_LAG: f64 = 4.0;
const LAGS: f64 = 0.8;
/// Seconds after which an angle that shows is overdue: it then has ranges anew at that lag at any rate, and bits count for
/// so much less of it.
const OVERDUE_SECONDS: f64 = 0.1;
const OVERDUE: f64 = 0.02;
/// Share of all that is left until a window is over that a plane may cost beyond what is its due where something shows.
const SHOWN_SHARE: f64 = 0.1;
/// Kilobits per second from which on there is room enough: all BAPs are then switched on at once.
const AMPLE: f64 = 2.0;
/// How much further an angle may lag for a moment, where an RMS error is aimed at, before ranges are sent anew: they cost
/// more than what catches up within a few frames.
const MOMENT: f64 = 2.0;
/// Planes that a value may take to catch up with a jump before an I plane is sent.
const JUMP: i64 = 12;
/// What needs of earlier I periods keep from period to period.
const MEMORY: f64 = 0.95;
/// Bits of a start code and the stuffing before it, and of a record and its start code, at most.
const START_CODE_BITS: f64 = 40.0;
const RECORD_BITS: f64 = 8.0 * (Record::MAX_WRITTEN + 4) as f64;
/// Factor between the prices per bit that are tried to meet the rate.
const DEARER: f64 = 1.5;

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
        let options = &PlanOptions { mode: options.mode.of_baps(true), ..*options };
        positive("frame rate", options.rate.per_second())?;
        Ok(Self {
            options: *options,
            sparse: !matches!(options.mode, Target::Quant(_)),
            start_code_bits: START_CODE_BITS + f64::from(u8::from(options.repeat_record)) * RECORD_BITS,
            interval: (options.intra_seconds * options.rate.per_second()).round().max(1.0) as u64,
            steering: Steering::new(options),
            out: FrameWriter::new(new_writer(options)),
            worths: Vec::with_capacity(BAP_COUNT),
            outgrown: Vec::with_capacity(BAP_COUNT),
            urgent: false,
            late: [0; BAP_COUNT],
            reach: Reach::new(),
            extent: [[0; 2]; BAP_COUNT],
            worthy: BapMask::EMPTY,
            before: None,
            since_complete: 0,
            period_ended: false,
            asked: false,
            saved: 0,
            leapt: false,
        })
    }

    /// Encodes one frame, and says what its plane cost: nothing if it is left out.
    ///
    /// # Errors
    /// [`EncodeError::OutOfRange`] for a value that no I plane can carry; the frame is then not encoded
    /// and the encoder stays usable.
    pub fn write_frame(&mut self, frame: &BapFrame) -> Result<PlaneBits, EncodeError> {
        self.write_held(frame, &BapMask::EMPTY)
    }

    /// The same for a frame in which `held` values stand for what is not known: no error of theirs is steered by.
    pub(super) fn write_held(&mut self, frame: &BapFrame, held: &BapMask) -> Result<PlaneBits, EncodeError> {
        let mut frame = *frame;
        frame.mask = self.options.sendable(&frame.mask);
        check_reach(&frame, self.options.steps, self.quant())?;
        self.note_extent(&frame);
        // Where the rate is to be held, I planes keep to their times.
        let early = self.out.planes() > 0 && self.since_complete < self.interval;
        // What a plane costs matters to a rate alone.
        let owed = if self.holds_rate() { self.out.owed()? } else { 0 };
        let leaps = self.leaps(&frame);
        self.leapt |= leaps;
        let mut bits = match self.write_needed(&frame, leaps)? {
            Some(bits) => bits,
            None if leaps => self.write_waiting(&mut frame)?,
            None => self.write_change(&frame)?,
        };
        if self.options.aligned && bits.total() > 0 {
            bits += self.out.align()?;
        }
        self.note_late(&frame);
        if self.holds_rate() {
            self.before = Some(frame);
        }
        self.since_complete += 1;
        let intra = bits.intra_values > 0;
        // A plane that stands for frames left out is at the first of them, and charged for then.
        let spent = if self.holds_rate() { bits.total() + self.out.owed()? - owed } else { 0 };
        let cause = match intra {
            true if leaps && early => Cause::Leap,
            true => Cause::Intra,
            false => Cause::Change,
        };
        if held.is_empty() {
            self.steer(&frame, spent, cause);
        } else {
            self.steer(&frame.without(held), spent, cause);
        }
        if intra && !early {
            self.steering.expect_intra(spent, self.interval - (self.since_complete - 1));
        }
        Ok(bits)
    }

    /// The I plane that is needed before any levels are chosen, if one is and the rate has room for it.
    fn write_needed(&mut self, frame: &BapFrame, leaps: bool) -> Result<Option<PlaneBits>, EncodeError> {
        // Where ranges serve several I planes, or all are to be sent soon, another I period may as well begin.
        let early = self.lasting() || !self.holds_rate() && self.since_complete * 2 > self.interval;
        if self.needs_complete(frame) || leaps && (early || self.leaps_anew(frame)) {
            self.write_intra(frame, Need::Complete)
        } else if leaps && self.holds_rate() {
            // Ranges reach further with a coarser quantiser, so that it costs nothing here.
            let quant = live_quant(&self.options, &self.steering, &self.mask());
            self.write_intra(frame, Need::Quant(quant.max(self.quant())))
        } else if leaps {
            self.write_intra(frame, Need::Ranges)
        } else if let Some(quant) = self.steering.requant(&self.options, &self.mask(), self.quant()) {
            self.write_intra(frame, Need::Quant(quant))
        } else {
            Ok(None)
        }
    }

    /// Whether an anchor is another one than was sent, or what places a hand is so far off that it has leapt: with its
    /// anchor, or by a turn.
    fn leaps(&self, frame: &BapFrame) -> bool {
        let off =
            |bap: Bap| (i64::from(self.out.writer.values()[bap.index()]) - i64::from(frame.value(bap))).abs();
        let far = |bap: Bap| match self.options.anchors.contains(bap) {
            true => off(bap) > ANCHOR_TOLERANCE,
            false => self.sparse && self.mask().contains(bap) && off(bap) > LEAP,
        };
        self.out.planes() > 0 && frame.mask.iter().any(|bap| bap.is_extension() && far(bap))
    }

    /// Whether an anchor that is another one has not been sent yet.
    fn leaps_anew(&self, frame: &BapFrame) -> bool {
        let anchors = frame.mask.intersection(&self.options.anchors).difference(&self.mask());
        anchors.iter().any(|bap| i64::from(frame.value(bap)).abs() > ANCHOR_TOLERANCE)
    }

    /// A frame whose leap must wait for an I plane. For a moment nothing else is sent, so that the rate has room for that.
    fn write_waiting(&mut self, frame: &mut BapFrame) -> Result<PlaneBits, EncodeError> {
        let most_saved = (SAVED_SECONDS * self.options.rate.per_second()).round() as u32;
        if self.saved < most_saved {
            self.saved += 1;
            self.out.skip();
            return Ok(PlaneBits::default());
        }
        self.hold_leaps(frame);
        self.write_change(frame)
    }

    /// The part of a leap that came first would show a hand elsewhere: what places it is held back until there is room
    /// for all of it.
    fn hold_leaps(&self, frame: &mut BapFrame) {
        let values = self.out.writer.values();
        let held: Vec<Bap> = frame.mask.iter().filter(|bap| bap.is_extension()).collect();
        held.into_iter().for_each(|bap| frame.set(bap, values[bap.index()]));
    }

    /// A P plane, or an I plane if the ranges are too narrow for it, or nothing.
    fn write_change(&mut self, frame: &BapFrame) -> Result<PlaneBits, EncodeError> {
        let gone = self.mask().difference(&frame.mask);
        let mut filled;
        let frame = if gone.is_empty() {
            frame
        } else {
            // What has no value any more, and no room to be switched off, stays as it is.
            filled = *frame;
            gone.iter().for_each(|bap| filled.set(bap, self.out.writer.values()[bap.index()]));
            &filled
        };
        let room = self.steering.room();
        if !self.predict(frame, room)?
            && (self.steering.affords_ranges() || self.urgent && self.steering.bears_ranges())
        {
            // Where ranges serve several I planes, another I period may as well begin.
            let late = self.since_complete * 2 > self.interval;
            let whole = if self.holds_rate() { self.options.resync } else { late || !self.options.resync };
            let need = if whole { Need::Complete } else { Need::Ranges };
            if let Some(bits) = self.write_intra(frame, need)? {
                return Ok(bits);
            }
            self.predict(frame, room)?;
        }
        if self.sparse && self.is_idle() {
            self.out.skip();
            return Ok(PlaneBits::default());
        }
        if self.options.aligned { self.out.write_aligned() } else { self.out.write_predicted() }
    }

    /// Makes the next plane an I plane that says everything, as soon as the rate has room for one.
    pub fn request_intra(&mut self) {
        self.asked = true;
    }

    /// Leaves out a frame for which there is no pose. Nothing is spent on it, not even where the rate is to be
    /// held.
    pub fn skip_frame(&mut self) {
        self.out.skip();
        self.since_complete += 1;
        self.steering.pass();
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

    /// What was written with the last frame for those left out before it.
    pub(super) fn last_still(&self) -> Option<Still> {
        self.out.last_still()
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
    /// without change stands for them, so that the stream has its full length.
    pub fn finish(self) -> Vec<u8> {
        self.out.finish()
    }

    fn steer(&mut self, frame: &BapFrame, bits: u64, cause: Cause) {
        let values = self.out.writer.values();
        self.steering.follow(frame, |bap| values[bap.index()], bits, cause);
    }

    fn holds_rate(&self) -> bool {
        matches!(self.options.mode, Target::Bitrate(_))
    }

    /// Largest error of a BAP for the sake of fewer bits, but half a step at least.
    fn zone(&self, bap: Bap) -> f64 {
        let step = self.options.off(bap, step(bap, self.options.steps, self.quant()).into());
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

    /// The same of a value that catches up as fast as its range lets it.
    fn room_to_lag(&self, bap: Bap) -> f64 {
        let brief = matches!(self.options.mode, Target::Rms(_)) && bap.unit() == Unit::Angle;
        self.room(bap) * if brief { MOMENT } else { 1.0 }
    }

    /// What errors of a BAP count for; nothing of an anchor.
    fn worth(&self, bap: Bap) -> Option<Worth> {
        (!self.options.anchors.contains(bap)).then(|| Worth {
            degrees: self.options.degrees(bap),
            worth: self.options.worth(bap),
            zone: self.zone(bap),
            beyond: if self.holds_rate() { BEYOND } else { f64::INFINITY },
            room_to_lag: self.room_to_lag(bap),
        })
    }

    /// Error from which on a value that lags behind shows, where the rate is to be held: the lower it is, the less room
    /// it has for ranges out of turn.
    fn shown_lag(&self, bap: Bap) -> f64 {
        let room = if bap.is_extension() { EXTRA_LAG } else { 1.0 };
        let scarce = if self.is_overdue(bap) { 1.0 } else { AMPLE / self.steering.kbit_per_s() };
        SHOWN_LAG * room * scarce.max(1.0)
    }

    /// Whether an angle has been off for so long that it must be made good.
    fn is_overdue(&self, bap: Bap) -> bool {
        f64::from(self.late[bap.index()]) >= OVERDUE_SECONDS * self.options.rate.per_second()
    }

    /// Takes note of angles that show to be off.
    fn note_late(&mut self, frame: &BapFrame) {
        if !self.holds_rate() {
            return;
        }
        for (bap, value) in frame.iter().filter(|(bap, _)| bap.unit() == Unit::Angle) {
            let off = i64::from(value) - i64::from(self.out.writer.values()[bap.index()]);
            let shows = self.options.off(bap, off).abs() > LAGS * SHOWN_LAG;
            let late = &mut self.late[bap.index()];
            *late = if shows { late.saturating_add(1) } else { 0 };
        }
    }

    /// Whether an I plane that says everything must be sent: it is due, or the mask changes. A BAP that
    /// moves away from 0 for the first time waits for the next I plane if it can.
    fn needs_complete(&mut self, frame: &BapFrame) -> bool {
        if self.out.planes() == 0 || self.since_complete >= self.interval || self.asked {
            return true;
        }
        let mask = self.mask();
        if !self.sparse {
            return mask != frame.mask;
        }
        let urgent = |(bap, value): (Bap, i32)| {
            let far = || self.options.off(bap, value.into()).abs() > self.room(bap);
            let overdue = || self.is_overdue(bap) && self.steering.bears_ranges();
            // A hand that turns or goes away shows at once.
            let away = || {
                let off = self.options.off(bap, value.into()).abs();
                bap.is_extension() && off > self.zone(bap) && self.steering.bears_ranges()
            };
            !mask.contains(bap) && (far() && self.steering.affords_ranges() || overdue() || away())
        };
        let gone = !mask.difference(&frame.mask).is_empty() && self.steering.affords_ranges();
        gone || frame.iter().any(urgent)
    }

    /// Chooses the levels of a P plane that `room` has room for; false if the ranges are too narrow for it.
    fn predict(&mut self, frame: &BapFrame, room: Room) -> Result<bool, EncodeError> {
        self.choose_levels(frame, self.steering.lambda());
        if self.holds_rate() {
            let limit = (room.limit - self.reserve()?).max(0.0);
            self.afford(frame, room.most.clamp(0.0, limit))?;
            let more = (room.most.max(0.0) + SHOWN_SHARE * limit).min(limit);
            if self.is_idle() && self.lags(frame) {
                // What shows may use some of what is kept for later frames.
                self.choose_levels(frame, self.steering.lambda());
                self.afford(frame, more)?;
            }
        }
        let fits = self.note_changes(frame);
        if !self.holds_rate() {
            self.widen();
        }
        Ok(fits)
    }

    /// Chooses levels of fewer and fewer bits until they cost no more than `most`.
    fn afford(&mut self, frame: &BapFrame, most: f64) -> Result<(), EncodeError> {
        let mut lambda = self.steering.lambda();
        while self.out.price()? > most {
            lambda *= DEARER;
            self.choose_levels(frame, lambda);
        }
        Ok(())
    }

    /// Whether nothing changes with the levels chosen.
    fn is_idle(&self) -> bool {
        self.out.levels.iter().all(|&level| level == 0)
    }

    /// Whether an angle is so far off what was sent that it shows.
    fn lags(&self, frame: &BapFrame) -> bool {
        let values = self.out.writer.values();
        let off = |bap: Bap| i64::from(frame.value(bap)) - i64::from(values[bap.index()]);
        let mask = self.mask();
        let angles = mask.iter().filter(|bap| !self.options.anchors.contains(*bap));
        let most = |bap: Bap| if bap.is_extension() { EXTRA_LAG * SHOWN_LAG } else { SHOWN_LAG };
        angles.into_iter().any(|bap| self.options.off(bap, off(bap)).abs() > LAGS * most(bap))
    }

    /// Bits kept for the plane that stands for frames left out after the next one.
    fn reserve(&mut self) -> Result<f64, EncodeError> {
        let bits = self.out.price_zeros()? + STILL_OVERHEAD;
        Ok((bits - self.steering.spare()).max(0.0))
    }

    /// The levels of a P plane where a bit may cost `lambda`; all 0 if it had better be left out.
    fn choose_levels(&mut self, frame: &BapFrame, lambda: f64) {
        self.out.levels.clear();
        let held = self.holds_rate();
        let mut gain = -lambda * if held { PLANE_OVERHEAD } else { PLANE_WORTH };
        let mut may_wait = true;
        // Where even that is too dear, everything waits.
        let pressing = held && lambda <= self.steering.lambda() / OVERDUE;
        for (slot, worth) in self.out.writer.layout().slots().iter().zip(&self.worths) {
            let Some(worth) = worth else {
                self.out.levels.push(0);
                continue;
            };
            let bap = slot.bap;
            let wanted = i64::from(frame.value(bap)) - i64::from(self.out.writer.values()[bap.index()]);
            let model = self.out.writer.models().model(slot);
            let overdue = held && self.is_overdue(bap);
            let price = if overdue { OVERDUE * lambda } else { lambda };
            let (level, saved) = choose(slot, wanted, &model, price, worth);
            gain += saved;
            may_wait &= held && !(overdue && pressing && level != 0) || worth.off(wanted) <= worth.zone;
            self.out.levels.push(level);
        }
        if self.sparse && may_wait && gain < 0.0 {
            self.out.levels.fill(0);
        }
    }

    /// Takes note of the changes wanted, and which left their ranges; false if values lag too far behind.
    fn note_changes(&mut self, frame: &BapFrame) -> bool {
        self.outgrown.clear();
        self.urgent = false;
        let slots = self.out.writer.layout().slots().iter();
        for ((slot, &level), worth) in slots.zip(&self.out.levels).zip(&self.worths) {
            let Some(worth) = worth else { continue };
            let bap = slot.bap;
            let wanted = i64::from(frame.value(bap)) - i64::from(self.out.writer.values()[bap.index()]);
            let clamped = slot.predicted.contains(&level) && {
                let rounded = round_level(wanted, slot.step);
                level == slot.predicted[usize::from(rounded > 0)] && rounded != level
            };
            let change = i64::from(level) * i64::from(slot.step);
            let noted = match &self.before {
                // How far values lag says nothing about how fast they move.
                Some(before) => i64::from(frame.value(bap)) - i64::from(before.value(bap)),
                _ if clamped => wanted,
                _ => change,
            };
            self.reach.note(bap, noted);
            let lags = match self.holds_rate() {
                true => {
                    let shows = clamped && worth.off(wanted - change) > self.shown_lag(bap);
                    self.urgent |= shows;
                    shows || clamped && wanted.abs() > JUMP * i64::from(level.abs()) * i64::from(slot.step)
                }
                false => worth.off(wanted - change) > worth.room_to_lag,
            };
            if lags {
                self.outgrown.push((bap, wanted));
            }
        }
        self.outgrown.is_empty()
    }

    /// An I plane, if the rate has room for it.
    fn write_intra(&mut self, frame: &BapFrame, need: Need) -> Result<Option<PlaneBits>, EncodeError> {
        let first = self.out.planes() == 0;
        let header = PlaneHeader {
            kind: PlaneKind::Intra,
            object_mask: 2,
            rate: (need == Need::Complete).then_some(self.options.rate),
            // A decoder can only start where everything is said.
            time_code: if need == Need::Complete { self.time_code() } else { None },
            ..PlaneHeader::default()
        };
        let start_code = self.options.resync && need == Need::Complete && !first;
        let Some(params) = self.params(frame, need, &header, start_code)? else { return Ok(None) };
        let bits = self.out.write(&header, start_code, Some(&params))?;
        let mut worths = std::mem::take(&mut self.worths);
        worths.clear();
        worths.extend(self.out.writer.layout().slots().iter().map(|slot| self.worth(slot.bap)));
        self.worths = worths;
        if need == Need::Complete {
            self.asked = false;
            self.steering.note_complete(bits.total() as f64);
            self.period_ended = false;
            if self.since_complete >= self.interval {
                self.saved = 0;
            }
            self.since_complete = match self.since_complete {
                since if self.holds_rate() && !first => since % self.interval,
                _ => 0,
            };
        }
        Ok(Some(bits))
    }

    /// What an I plane says that the rate has room for, and its levels. BAPs that would be switched on wait if there
    /// is no room for all of them: those nearest to 0 first.
    fn params(
        &mut self,
        frame: &BapFrame,
        need: Need,
        header: &PlaneHeader,
        start_code: bool,
    ) -> Result<Option<IntraParams>, EncodeError> {
        let mut mask = self.wanted_mask(frame);
        let due = self.since_complete >= self.interval;
        if need == Need::Complete && due && !self.period_ended {
            self.reach.end_period(&self.mask(), MEMORY);
            self.period_ended = true;
        }
        loop {
            let params = match need {
                Need::Complete => self.complete_params(frame, mask)?,
                Need::Ranges => self.changed_params(frame, self.quant())?,
                Need::Quant(quant) => self.changed_params(frame, quant)?,
            };
            self.out.levels.clear();
            self.out.levels.extend_from_slice(self.out.writer.intra_levels(&params, frame));
            if !self.holds_rate() || self.out.planes() == 0 {
                return Ok(Some(params));
            }
            let code = if start_code { self.start_code_bits } else { 0.0 };
            let bits = self.out.price_intra(header, &params)? + code;
            let new = mask.difference(&self.mask());
            let grows = need == Need::Complete && !new.is_empty();
            if bits + self.reserve()? <= self.steering.intra_limit(bits, due, grows) {
                return Ok(Some(params));
            }
            // What others drive goes with them, lest it be derived.
            let free = new.difference(&companions(self.options.ties, &mask, &mask));
            let degrees = |bap: &Bap| self.options.off(*bap, frame.value(*bap).into()).abs();
            match free.iter().min_by(|a, b| degrees(a).total_cmp(&degrees(b))) {
                Some(bap) if grows => mask.set(bap, false),
                _ => return Ok(None),
            }
        }
    }

    fn time_code(&self) -> Option<TimeCode> {
        self.options.resync.then(|| TimeCode::at(self.out.frames(), self.options.rate)).flatten()
    }
}

/// What errors of a BAP count for.
#[derive(Clone, Debug)]
struct Worth {
    /// Degrees of a unit, and what they count for.
    degrees: f64,
    worth: f64,
    /// Squared degrees beyond `zone` count `beyond` times more.
    zone: f64,
    beyond: f64,
    /// See [`LiveEncoder::room_to_lag`].
    room_to_lag: f64,
}

impl Worth {
    /// A difference in degrees.
    fn off(&self, difference: i64) -> f64 {
        (difference as f64 * self.degrees).abs()
    }

    fn error(&self, off: i64) -> f64 {
        let off = self.off(off);
        let over = off - self.zone;
        (off * self.worth).powi(2) + if over > 0.0 { self.beyond * over * over } else { 0.0 }
    }
}

/// The level of least squared error and λ-weighted bits, and what sending it instead of leaving out the plane
/// saves; negative for zeros that only keep others company. Out of range, it is the nearest.
fn choose(slot: &Slot, wanted: i64, model: &Adaptive<'_>, lambda: f64, worth: &Worth) -> (i32, f64) {
    let [min, max] = slot.predicted;
    let nearest = round_level(wanted, slot.step).clamp(min, max);
    let error = |level: i32| worth.error(wanted - i64::from(level) * i64::from(slot.step));
    let cost = |level: i32| {
        let count = model.count((level - min) as usize);
        error(level) + lambda * (f64::from(model.total()) / f64::from(count)).log2()
    };
    let (mut least, mut level) = (cost(nearest), nearest);
    let lower: &[i32] = match nearest.abs() {
        0 => &[],
        1 => &[0],
        _ => &[nearest - nearest.signum(), 0],
    };
    for &other in lower {
        let cost = cost(other);
        if cost < least {
            (least, level) = (cost, other);
        }
    }
    let plain = (wanted as f64 * worth.degrees * worth.worth).powi(2);
    let idle = plain.max(if worth.beyond.is_finite() { error(0) } else { 0.0 });
    (level, idle - least)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Target;

    /// A frame that no I plane can carry leaves no trace in what follows.
    #[test]
    fn refused_frames_change_nothing() {
        let bap = Bap::from_name("r_index1_flexion").unwrap();
        let frame = |value: i32| -> BapFrame { [(bap, value)].into_iter().collect() };
        let options = PlanOptions { mode: Target::Rms(0.5), intra_seconds: 0.5, ..PlanOptions::default() };
        let stream = |refused: bool| {
            let mut encoder = LiveEncoder::new(&options).unwrap();
            for n in 0..60 {
                if refused && n % 7 == 3 {
                    let far = encoder.write_frame(&frame(2_000_000_000));
                    assert!(matches!(far, Err(EncodeError::OutOfRange { .. })));
                }
                encoder.write_frame(&frame(-1_000 * (n % 20))).unwrap();
            }
            encoder.finish()
        };
        assert_eq!(stream(true), stream(false));
    }
}
