//! What to aim at, and how.

use super::super::encoder::degrees_per_unit;
use super::super::error::EncodeError;
use super::super::record::Record;
use super::super::syntax::{FrameRate, RangeRule};
use super::super::writer::PlaneWriter;
#[cfg(doc)]
use super::{LiveEncoder, PlanReport};
use crate::bap::{Bap, BapMask, StepTable, Tie, Unit, derive};

/// What to aim at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// This quantiser index and plain rounding; every frame is sent.
    Quant(u8),
    /// No angle ever further off than this many degrees, at the least rate.
    MaxError(f64),
    /// No fingertip further off than this many millimetres. Who encodes poses knows where fingertips are, and tries
    /// several largest errors; of BAPs alone one is taken with which hands mostly keep it, and of frames that are coded
    /// when they come.
    TipError(f64),
    /// This many kilobits per second, at the least error. Live, no ten seconds after the first two cost more than
    /// five percent above it, whatever moves: the price of a bit follows, slowly, what moved of late, values lag
    /// while a motion takes more than the rate gives, and an I plane waits if there is no room for it. What a motion has
    /// no use for is not spent. Frames left out by [`LiveEncoder::skip_frame`] are not made up for, nor I planes that do
    /// not recur every ten seconds (other intervals than 1, 2, 2.5, 5 and 10 s) and take more than a tenth of them; and
    /// the plane that closes a stream whose last frames were left out comes on top.
    ///
    /// Offline, the price of a bit follows what each ten seconds cost, and plans are exchanged, until they are within
    /// five percent of the rate or nothing better is found; planes that say nothing ([`PlanReport::filler`]) make up for
    /// what is still missing of them.
    /// Where the hand rests so that even the finest quantiser has less to say they cost less, and are not filled up.
    /// [`PlanReport::windows_missed`], [`PlanReport::resting_seconds`] and [`PlanReport::window_kbit_per_s`] say what
    /// was reached. The live encoder's stream is taken if it is better: if its error is less, windows beyond the
    /// bounds making it count for more. In a clip too short for ten seconds to be held the mean is an upper bound.
    Bitrate(f64),
    /// A root mean square error of the moving angles of this many degrees, at the least rate.
    Rms(f64),
}

/// Millimetres that a fingertip is off at most where each joint is off by a degree at most: with look-ahead, and live.
const TIP_MM_PER_DEGREE: [f64; 2] = [4.8, 7.0];

impl Target {
    /// What is aimed at in terms of BAPs.
    pub(super) fn of_baps(self, live: bool) -> Self {
        match self {
            Self::TipError(mm) => Self::MaxError(mm / TIP_MM_PER_DEGREE[usize::from(live)]),
            other => other,
        }
    }
}

impl Default for Target {
    /// 0.4° RMS.
    fn default() -> Self {
        Self::Rms(0.4)
    }
}

/// How to encode a clip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanOptions {
    /// Base steps; the decoder must be told the same.
    pub steps: StepTable,
    /// How a decoder reads range codes; it must be told the same. Codes are chosen for
    /// [`RangeRule::Divided`]; read undivided they reach further than they need to.
    pub ranges: RangeRule,
    /// Frame rate of the stream. Frames are put on its ticks.
    pub rate: FrameRate,
    /// What to aim at.
    pub mode: Target,
    /// Code each frame when it comes, without look-ahead.
    pub live: bool,
    /// Seconds from one I plane to the next; with `resync` a decoder can start at each of them.
    pub intra_seconds: f64,
    /// Largest error of an angle in degrees, steeply priced beyond. [`Target::MaxError`] has its own;
    /// coarse aims of the other modes go beyond it. Live, where an RMS error is aimed at, an angle that moves faster than its
    /// range may be twice as far off until it has caught up.
    pub max_error: f64,
    /// Start code, time code and all ranges with every I plane, so that a decoder can start there, or resume after
    /// damage. Without, ranges serve several I planes.
    pub resync: bool,
    /// What the decoder's model derives ([`crate::bap::derive`]): where such a BAP must keep a value of its own, it
    /// is sent along with its driver. Empty for a decoder that derives nothing.
    pub ties: &'static [Tie],
    /// What an error of each BAP counts for beside the plain degrees of [`degrees_per_unit`], by index: a joint that
    /// moves much more than one that moves little. Empty where all count alike. Errors of angles are reported, and
    /// bounded, in plain degrees.
    pub gains: &'static [f64],
    /// BAPs of which a coarse value will do, and that move others by a leap when they change: an I plane begins then.
    pub anchors: BapMask,
    /// Parts of the body: where BAPs of one are given at least one is sent, so that a decoder knows that it is there.
    pub limbs: &'static [BapMask],
    /// Leave out what `ties` derive that are firm.
    pub derive: bool,
    /// Profile and level indication of a visual object sequence around the object, if one is wanted.
    pub wrapper: Option<u8>,
    /// What travels as user data of that sequence; it is there where there is a record, of Simple FBA if `wrapper` says
    /// nothing.
    pub record: Record,
    /// Send the record again with each I plane that has a start code.
    pub repeat_record: bool,
    /// Live, end each plane at a byte's end: planes without any part fill it up, half a byte to two bytes and a half.
    pub aligned: bool,
    /// What a plan with look-ahead chooses.
    pub choices: Choices,
}

/// What a plan with look-ahead chooses of all that the syntax leaves to an encoder: everything, unless it is to be measured
/// what a choice is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choices {
    /// Where levels come from.
    pub levels: Levels,
    /// P ranges may be too narrow for some changes, which then take several planes.
    pub narrow_ranges: bool,
    /// BAPs that are not worth their bits are switched off.
    pub masks: bool,
    /// I periods have quantisers of their own.
    pub quantisers: bool,
    /// A range array may serve several I periods.
    pub lasting_ranges: bool,
    /// Frames in which nothing changes have no plane.
    pub skips: bool,
}

impl Default for Choices {
    fn default() -> Self {
        Self {
            levels: Levels::Searched,
            narrow_ranges: true,
            masks: true,
            quantisers: true,
            lasting_ranges: true,
            skips: true,
        }
    }
}

/// How levels are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Levels {
    /// Those of the cheapest way through an I period.
    Searched,
    /// Frame by frame the cheapest of the nearest, the one nearer to 0, and 0.
    DeadZone,
    /// The nearest.
    Rounded,
}

impl Default for PlanOptions {
    /// [`Target::default`] at 30 frames/s, an I plane every five seconds.
    fn default() -> Self {
        Self {
            steps: StepTable::Standard,
            ranges: RangeRule::Divided,
            rate: FrameRate::ASSUMED,
            mode: Target::default(),
            live: false,
            intra_seconds: 5.0,
            max_error: 2.5,
            resync: false,
            ties: &[],
            gains: &[],
            anchors: BapMask::EMPTY,
            limbs: &[],
            derive: false,
            wrapper: None,
            record: Record::default(),
            repeat_record: false,
            aligned: false,
            choices: Choices::default(),
        }
    }
}

impl PlanOptions {
    /// Refuses parameters outside their ranges.
    pub(super) fn check(&self) -> Result<(), EncodeError> {
        positive("frame rate", self.rate.per_second())?;
        positive("seconds between i planes", self.intra_seconds)?;
        positive("largest error", self.max_error)?;
        match self.mode {
            Target::Quant(quant) if quant > 31 => Err(refused("quantiser index", quant.into(), "0 to 31")),
            Target::Quant(_) => Ok(()),
            Target::MaxError(degrees) => positive("largest error", degrees),
            Target::TipError(mm) => positive("largest error of a fingertip", mm),
            Target::Rms(degrees) => positive("rms error", degrees),
            Target::Bitrate(kbit_per_s) => positive("bit rate", kbit_per_s),
        }
    }

    /// What may be sent of `mask`.
    pub(super) fn sendable(&self, mask: &BapMask) -> BapMask {
        if !self.derive {
            return *mask;
        }
        let firm: BapMask = self.ties.iter().filter(|tie| tie.firm).map(|tie| tie.driven).collect();
        let kept = mask.difference(&firm);
        // What nothing drives must be sent.
        kept.union(&mask.difference(&derive::left_to_model(self.ties, &kept)))
    }

    /// What of `mask` is left out, for the decoder's model to derive.
    pub(super) fn left_to_model(&self, mask: &BapMask) -> BapMask {
        mask.difference(&self.sendable(mask))
    }

    /// Largest error of an angle, degrees.
    pub(super) fn bound(&self) -> f64 {
        match self.mode {
            Target::MaxError(degrees) => degrees,
            Target::Rms(degrees) => self.max_error.max(WORST_PER_RMS * degrees),
            _ => self.max_error,
        }
    }

    /// Largest error of a BAP in the degrees of [`Self::degrees`]. Only angles are bound; others get more room.
    pub(super) fn room(&self, bap: Bap) -> f64 {
        let promised = matches!(self.mode, Target::MaxError(_));
        if promised || bap.unit() == Unit::Angle { self.bound() } else { EXTRA_ROOM * self.bound() }
    }

    fn gain(&self, bap: Bap) -> f64 {
        self.gains.get(bap.index()).copied().unwrap_or(1.0)
    }

    /// Degrees that a unit of a BAP is bounded by: plain ones of an angle, of others what they count for.
    pub(super) fn degrees(&self, bap: Bap) -> f64 {
        let plain = degrees_per_unit(bap);
        if bap.unit() == Unit::Angle { plain } else { plain * self.gain(bap) }
    }

    /// What the error in those degrees counts for.
    pub(super) fn worth(&self, bap: Bap) -> f64 {
        if bap.unit() == Unit::Angle { self.gain(bap) } else { 1.0 }
    }

    /// A difference of values in the degrees of [`Self::degrees`].
    pub(super) fn off(&self, bap: Bap, difference: i64) -> f64 {
        difference as f64 * self.degrees(bap)
    }

    /// A difference of values as it counts in what is made small.
    pub(super) fn felt(&self, bap: Bap, difference: i64) -> f64 {
        self.off(bap, difference) * self.worth(bap)
    }
}

/// Largest error of an angle over the RMS error aimed at, where that is above [`PlanOptions::max_error`].
pub(super) const WORST_PER_RMS: f64 = 5.0;
/// Largest error of what is no angle, over that of an angle.
const EXTRA_ROOM: f64 = 4.0;
/// Seconds over which a rate is held.
pub(super) const WINDOW: f64 = 10.0;
/// Seconds at the start that no such window needs to hold.
pub(super) const GRACE: f64 = 2.0;
/// Degrees of error per root of λ that are allowed where the rate is given: a dear bit buys room.
pub(super) const ROOM_PER_LAMBDA: f64 = 4.0;

/// A difference of values as an error measure: degrees, or what counts for as much.
pub(super) fn degrees_of(bap: Bap, difference: i64) -> f64 {
    difference as f64 * degrees_per_unit(bap)
}

/// Profile and level indication of Simple FBA, level 1.
const SIMPLE_FBA: u8 = 0x63;

pub(super) fn new_writer(options: &PlanOptions) -> PlaneWriter {
    let told = (!options.record.is_empty()).then_some(SIMPLE_FBA);
    let writer = match options.wrapper.or(told) {
        Some(profile) => PlaneWriter::with_record(options.steps, profile, &options.record),
        None => PlaneWriter::new(options.steps),
    };
    let writer = if options.repeat_record { writer.repeating(&options.record) } else { writer };
    writer.with_ranges(options.ranges)
}

/// A clip without frames.
pub(super) const NO_FRAMES: EncodeError =
    EncodeError::Parameter { what: "number of frames", value: 0.0, allowed: "at least 1" };

pub(super) fn refused(what: &'static str, value: f64, allowed: &'static str) -> EncodeError {
    EncodeError::Parameter { what, value, allowed }
}

pub(super) fn positive(what: &'static str, value: f64) -> Result<(), EncodeError> {
    if value > 0.0 && value.is_finite() { Ok(()) } else { Err(refused(what, value, "positive")) }
}
