//! Rate control: which quantiser, masks, ranges and levels to send for the wanted rate or error.
//!
//! Offline, every I period is planned as a whole: for each BAP the cheapest way through the period is
//! searched (see `path`), for several quantiser indices, at a price λ per bit. λ is the same for the whole clip
//! and set so that the clip meets its target; only where a rate is to be held it differs from frame to frame
//! (see `hold`). All of it stays within the standard's predictive mode, so any decoder reads the result.

mod budget;
mod choice;
mod clip;
mod hold;
mod live;
mod path;
mod plans;
mod search;
mod share;
mod steering;
mod windows;

pub use live::LiveEncoder;

use clip::{Clip, ClipBuilder, Ticker};
use live::LiveSession;
use plans::Plans;
use search::{Goal, Planner};

use super::encoder::degrees_per_unit;
use super::error::EncodeError;
use super::syntax::{FrameRate, RangeRule};
use super::writer::{PlaneBits, PlaneWriter};
use crate::bap::{Bap, BapFrame, BapMask, StepTable, Tie, Unit, derive};

/// A frame and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedBapFrame {
    /// Seconds.
    pub time: f64,
    /// The values.
    pub baps: BapFrame,
}

/// What to aim at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RateMode {
    /// This quantiser index and plain rounding; every frame is sent.
    Quant(u8),
    /// No angle ever further off than this many degrees, at the least rate.
    MaxError(f64),
    /// This many kilobits per second, at the least error. Live, no ten seconds after the first two cost more than
    /// five percent above it, whatever moves: values lag while a motion takes more than the rate gives, and an I
    /// plane waits if there is no room for it. They cost no less than five percent below it either: where nothing
    /// is left to improve, planes that say nothing fill the rate up ([`PlanReport::filler`]). Only frames left out
    /// by [`LiveEncoder::skip_frame`] are not made up for, nor I planes that do not recur every ten seconds (other
    /// intervals than 1, 2, 2.5, 5 and 10 s) and take more than a tenth of them; and the plane that closes a stream
    /// whose last frames were left out comes on top.
    ///
    /// Offline, the price of a bit follows what each ten seconds cost, and plans are exchanged, until they are within
    /// the same bounds or nothing better is found; planes that say nothing make up for what is still missing of them.
    /// Where the hand rests so that even the finest quantiser has less to say they cost less, and are not filled up.
    /// [`PlanReport::windows_missed`], [`PlanReport::resting_seconds`] and [`PlanReport::window_kbit_per_s`] say what
    /// was reached. The live encoder's stream is taken if it is better: if its error is less, windows beyond the
    /// bounds making it count for more. In a clip too short for ten seconds to be held the mean is an upper bound.
    Bitrate(f64),
    /// A root mean square error of the moving angles of this many degrees, at the least rate.
    TargetRms(f64),
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
    pub mode: RateMode,
    /// Code each frame when it comes, without look-ahead.
    pub live: bool,
    /// Seconds from one I plane to the next; at each of them a decoder can start.
    pub intra_seconds: f64,
    /// Largest error of an angle in degrees, steeply priced beyond. [`RateMode::MaxError`] has its own;
    /// coarse aims of the other modes go beyond it.
    pub max_error: f64,
    /// Start code and time code with every I plane, so that a decoder can resume there after damage.
    pub resync: bool,
    /// What the decoder's model derives ([`crate::bap::derive`]): where such a BAP must keep a value of its own, it
    /// is sent along with its driver. Empty for a decoder that derives nothing.
    pub ties: &'static [Tie],
    /// Leave out what `ties` derive.
    pub derive: bool,
    /// Profile and level indication of a visual object sequence around the object, if one is wanted.
    pub wrapper: Option<u8>,
}

impl Default for PlanOptions {
    /// 0.5° RMS at 30 frames/s, an I plane every five seconds.
    fn default() -> Self {
        Self {
            steps: StepTable::Standard,
            ranges: RangeRule::Divided,
            rate: FrameRate::ASSUMED,
            mode: RateMode::TargetRms(0.5),
            live: false,
            intra_seconds: 5.0,
            max_error: 2.5,
            resync: false,
            ties: &[],
            derive: false,
            wrapper: None,
        }
    }
}

impl PlanOptions {
    /// Refuses parameters outside their ranges.
    fn check(&self) -> Result<(), EncodeError> {
        positive("frame rate", self.rate.per_second())?;
        positive("seconds between i planes", self.intra_seconds)?;
        positive("largest error", self.max_error)?;
        match self.mode {
            RateMode::Quant(quant) if quant > 31 => Err(refused("quantiser index", quant.into(), "0 to 31")),
            RateMode::Quant(_) => Ok(()),
            RateMode::MaxError(degrees) => positive("largest error", degrees),
            RateMode::TargetRms(degrees) => positive("rms error", degrees),
            RateMode::Bitrate(kbit_per_s) => positive("bit rate", kbit_per_s),
        }
    }

    /// What may be sent of `mask`.
    fn sendable(&self, mask: &BapMask) -> BapMask {
        let kept = if self.derive { mask.difference(&derive::driven(self.ties)) } else { *mask };
        // What nothing drives must be sent.
        kept.union(&mask.difference(&derive::left_to_model(self.ties, &kept)))
    }

    /// Largest error of an angle, degrees.
    fn bound(&self) -> f64 {
        match self.mode {
            RateMode::MaxError(degrees) => degrees,
            RateMode::TargetRms(degrees) => self.max_error.max(WORST_PER_RMS * degrees),
            _ => self.max_error,
        }
    }

    /// Largest error of a BAP in the degrees of [`degrees_per_unit`]. Only angles are bound in degrees; what
    /// counts in tenths of a degree for want of a better measure gets more room.
    fn room(&self, bap: Bap) -> f64 {
        if bap.unit() == Unit::Angle { self.bound() } else { 4.0 * self.bound() }
    }
}

/// Largest error of an angle over the RMS error aimed at, where that is above [`PlanOptions::max_error`].
const WORST_PER_RMS: f64 = 5.0;
/// Seconds over which a rate is held.
const WINDOW: f64 = 10.0;
/// Seconds at the start that no such window needs to hold.
const GRACE: f64 = 2.0;
/// Degrees of error per root of λ that are allowed where the rate is given: a dear bit buys room.
const ROOM_PER_LAMBDA: f64 = 4.0;

/// A difference of values as an error measure: degrees, or what counts for as much.
fn degrees_of(bap: Bap, difference: i64) -> f64 {
    difference as f64 * degrees_per_unit(bap)
}

fn new_writer(options: &PlanOptions) -> PlaneWriter {
    let writer = match options.wrapper {
        Some(profile) => PlaneWriter::with_visual_wrapper(options.steps, profile),
        None => PlaneWriter::new(options.steps),
    };
    writer.with_ranges(options.ranges)
}

/// What an encoded clip costs and how far off it is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlanReport {
    /// Input frames.
    pub frames: u64,
    /// Planes sent.
    pub planes: u64,
    /// I planes among them.
    pub intra_planes: u64,
    /// Length in seconds: frames of the stream, skipped ones included, by its rate.
    pub seconds: f64,
    /// Bytes of the stream.
    pub bytes: usize,
    /// Where the bits went.
    pub bits: PlaneBits,
    /// Bits among them that say nothing and only keep a rate from falling.
    pub filler: u64,
    /// Bits spent on each input frame; 0 where none was sent.
    pub frame_bits: Vec<u64>,
    /// Least and most kilobits per second over any ten seconds after the first two; none in a shorter clip.
    pub window_kbit_per_s: Option<[f64; 2]>,
    /// Windows of ten seconds after the first two, one from each frame on and one from right behind it, that cost over
    /// five percent more than a bit rate asked for, or less; 0 in a clip too short for one. Offline, frames that
    /// rest ([`PlanReport::resting_seconds`]) do not count as too little.
    pub windows_missed: Option<u64>,
    /// Seconds in which the finest quantiser has less to say than the bit rate asked for offline has room for.
    pub resting_seconds: f64,
    /// Quantiser index of each I period.
    pub quants: Vec<u8>,
    /// λ in squared degrees per bit; 0 when plain rounding was asked for.
    pub lambda: f64,
    /// BAPs sent in at least one plane.
    pub sent: BapMask,
    /// Root mean square error in degrees over the angles that are ever different from 0 in the input,
    /// over all input frames.
    pub rms_degrees: f64,
    /// The same over all angles the input gives.
    pub rms_all_degrees: f64,
    /// Largest error of any angle, degrees.
    pub max_degrees: f64,
}

impl PlanReport {
    /// Kilobits per second.
    pub fn kbit_per_s(&self) -> f64 {
        if self.seconds > 0.0 { self.bytes as f64 * 8.0 / self.seconds / 1000.0 } else { 0.0 }
    }
}

/// Encodes a clip with look-ahead.
///
/// # Errors
/// A parameter outside its range, no frames, frames out of order, or a value that cannot be coded.
///
/// ```
/// use handcast_fba::bap::{Bap, BapFrame};
/// use handcast_fba::plan::{PlanOptions, TimedBapFrame, encode_clip};
///
/// let bend = Bap::from_name("r_index1_flexion").unwrap();
/// let frames: Vec<TimedBapFrame> = (0..90)
///     .map(|frame| {
///         let value = -70_000.0 * (f64::from(frame) * 0.05).sin().powi(2);
///         TimedBapFrame { time: f64::from(frame) / 30.0, baps: [(bend, value as i32)].into_iter().collect() }
///     })
///     .collect();
/// let (stream, report) = encode_clip(&frames, &PlanOptions::default())?;
/// assert!(report.rms_degrees <= 0.5);
/// assert_eq!(report.bytes, stream.len());
/// # Ok::<(), handcast_fba::error::EncodeError>(())
/// ```
pub fn encode_clip(
    frames: &[TimedBapFrame],
    options: &PlanOptions,
) -> Result<(Vec<u8>, PlanReport), EncodeError> {
    let mut encoder = ClipEncoder::new(options)?;
    let mut stream = Vec::new();
    for frame in frames {
        stream.extend(encoder.push(frame)?);
    }
    let (rest, report) = encoder.finish()?;
    stream.extend(rest);
    Ok((stream, report))
}

/// Encodes a clip whose frames come one by one. Live each gives the bytes of its plane at once; with look-ahead all
/// frames wait, a few bytes for each value, until the clip is whole.
///
/// ```
/// use handcast_fba::bap::Bap;
/// use handcast_fba::plan::{ClipEncoder, PlanOptions, TimedBapFrame};
///
/// let bend = Bap::from_name("r_index1_flexion").unwrap();
/// let mut encoder = ClipEncoder::new(&PlanOptions { live: true, ..PlanOptions::default() })?;
/// let mut stream = Vec::new();
/// for frame in 0..30 {
///     let baps = [(bend, -1_000 * frame)].into_iter().collect();
///     stream.extend(encoder.push(&TimedBapFrame { time: f64::from(frame) / 30.0, baps })?);
/// }
/// let (rest, report) = encoder.finish()?;
/// assert_eq!(report.bytes, stream.len() + rest.len());
/// # Ok::<(), handcast_fba::error::EncodeError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ClipEncoder {
    options: PlanOptions,
    work: Work,
}

/// What becomes of the frames of a clip.
#[derive(Clone, Debug)]
enum Work {
    /// They are coded when they come.
    Live(Ticker, Box<LiveSession>),
    /// They are gathered to be planned.
    Ahead(ClipBuilder),
}

impl ClipEncoder {
    /// An encoder of a clip without frames.
    ///
    /// # Errors
    /// A parameter outside its range.
    pub fn new(options: &PlanOptions) -> Result<Self, EncodeError> {
        options.check()?;
        let work = if options.live {
            Work::Live(Ticker::new(options.rate), Box::new(LiveSession::new(options)?))
        } else {
            Work::Ahead(ClipBuilder::new(options))
        };
        Ok(Self { options: *options, work })
    }

    /// Takes the next frame and gives the bytes that are finished: none with look-ahead. Live, the last bits of a
    /// plane may share a byte with the plane after it, and come with that.
    ///
    /// # Errors
    /// A time before that of the last frame, or too far behind it; live, [`EncodeError::OutOfRange`] for a value
    /// that cannot be coded.
    pub fn push(&mut self, frame: &TimedBapFrame) -> Result<Vec<u8>, EncodeError> {
        let mut out = Vec::new();
        match &mut self.work {
            Work::Live(ticker, session) => session.push(ticker.tick(frame.time)?, &frame.baps, &mut out)?,
            Work::Ahead(clip) => clip.push(frame)?,
        }
        Ok(out)
    }

    /// Ends the stream: gives the bytes still missing, and the account of the whole.
    ///
    /// # Errors
    /// No frames, or, with look-ahead, a value that cannot be coded.
    pub fn finish(self) -> Result<(Vec<u8>, PlanReport), EncodeError> {
        match self.work {
            Work::Live(ticker, session) => {
                ticker.last().ok_or(NO_FRAMES)?;
                let mut rest = Vec::new();
                let report = session.finish(&mut rest);
                Ok((rest, report))
            }
            Work::Ahead(clip) => write_planned(&clip.finish()?, &self.options),
        }
    }
}

/// Encodes a clip with look-ahead.
fn write_planned(clip: &Clip, options: &PlanOptions) -> Result<(Vec<u8>, PlanReport), EncodeError> {
    let (stream, mut report) = match options.mode {
        RateMode::Quant(quant) => Plans::rounded(clip, options, quant)?.write(clip, options)?,
        RateMode::MaxError(degrees) => Planner::new(clip, options).bounded(degrees)?.write(clip, options)?,
        RateMode::TargetRms(degrees) => {
            Planner::new(clip, options).search(Goal::Rms(degrees))?.write(clip, options)?
        }
        RateMode::Bitrate(kbit_per_s) => hold::held(clip, options, kbit_per_s)?,
    };
    let rate = options.rate.per_second();
    report.window_kbit_per_s = windows::extremes(&clip.ticks, &report.frame_bits, rate);
    Ok((stream, report))
}

/// A clip without frames.
const NO_FRAMES: EncodeError =
    EncodeError::Parameter { what: "number of frames", value: 0.0, allowed: "at least 1" };

fn refused(what: &'static str, value: f64, allowed: &'static str) -> EncodeError {
    EncodeError::Parameter { what, value, allowed }
}

fn positive(what: &'static str, value: f64) -> Result<(), EncodeError> {
    if value > 0.0 && value.is_finite() { Ok(()) } else { Err(refused(what, value, "positive")) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Decoder, DecoderOptions};

    /// Bends that rest and move by turns, eight seconds at 30 frames/s.
    fn clip() -> Vec<TimedBapFrame> {
        let value = |tick: i32, finger: i32| {
            let phase = (tick + 13 * finger) % 60;
            let share = f64::from(phase.min(12)) / 12.0;
            let smooth = share * share * (3.0 - 2.0 * share);
            let target = f64::from((tick + 13 * finger) / 60 % 2 * 2 - 1);
            let noise = f64::from((tick * 7919 + finger * 104_729) % 401 - 200);
            (target * (2.0 * smooth - 1.0) * 40_000.0 + noise) as i32
        };
        let frame = |tick: i32| {
            (0..6)
                .filter_map(|finger| Some((Bap::new(126 + 6 * finger as u16)?, value(tick, finger))))
                .collect()
        };
        (0..240).map(|tick| TimedBapFrame { time: f64::from(tick) / 30.0, baps: frame(tick) }).collect()
    }

    /// RMS and largest error in degrees of a stream, seen from outside: each input frame against the
    /// last plane at or before it.
    fn measure(stream: &[u8], clip: &[TimedBapFrame]) -> (f64, f64) {
        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(stream).unwrap();
        let mut planes = Vec::new();
        while let Some(plane) = decoder.next_frame().unwrap() {
            planes.push(plane);
        }
        let (mut sum, mut count, mut max) = (0.0, 0.0, 0.0f64);
        for frame in clip {
            let plane = planes.iter().rfind(|plane| plane.time <= frame.time + 1e-6).unwrap();
            for (bap, value) in frame.baps.iter() {
                let off = f64::from(value - plane.baps.value(bap)) * degrees_per_unit(bap);
                sum += off * off;
                count += 1.0;
                max = max.max(off.abs());
            }
        }
        ((sum / count).sqrt(), max)
    }

    #[test]
    fn aims_are_met_and_reported_truly() {
        let clip = clip();
        let plan = |mode, live| {
            let options = PlanOptions { mode, live, ..PlanOptions::default() };
            let (stream, report) = encode_clip(&clip, &options).unwrap();
            let (rms, max) = measure(&stream, &clip);
            assert!((rms - report.rms_degrees).abs() < 1e-9, "{mode:?}");
            assert!((max - report.max_degrees).abs() < 1e-9, "{mode:?}");
            assert_eq!(stream.len(), report.bytes);
            assert_eq!(
                report.bits.total().div_ceil(8) + 9 - report.bytes as u64,
                u64::from(report.bits.total() % 8 != 0)
            );
            report
        };
        let rounded = plan(RateMode::Quant(10), false);
        let aimed = plan(RateMode::TargetRms(rounded.rms_degrees), false);
        assert!(aimed.rms_degrees <= rounded.rms_degrees);
        assert!(aimed.bytes < rounded.bytes, "{} of {}", aimed.bytes, rounded.bytes);
        let bounded = plan(RateMode::MaxError(1.0), false);
        assert!(bounded.max_degrees <= 1.0);
        let rate = plan(RateMode::Bitrate(0.6), false);
        assert!((0.5..=0.6).contains(&rate.kbit_per_s()), "{}", rate.kbit_per_s());
        plan(RateMode::TargetRms(0.5), true);
        assert!(plan(RateMode::MaxError(1.5), true).max_degrees <= 1.5);
    }

    /// At coarse quantisers no level is left for the end of the largest range: the one below it does.
    #[test]
    fn the_end_of_the_largest_range_is_coded_at_any_quantiser() {
        let turn = Bap::new(198).unwrap();
        let value = |tick: i32| if tick < 120 { 1860 } else { -1860 };
        let clip: Vec<TimedBapFrame> = (0..240)
            .map(|tick| {
                let baps = [(turn, value(tick)), (Bap::new(126).unwrap(), 30 * (tick % 50))];
                TimedBapFrame { time: f64::from(tick) / 30.0, baps: baps.into_iter().collect() }
            })
            .collect();
        let coarse = (0..32).map(RateMode::Quant);
        for mode in coarse.chain([RateMode::TargetRms(6.0), RateMode::Bitrate(0.3), RateMode::MaxError(9.0)])
        {
            for live in [false, true] {
                let options = PlanOptions { mode, live, ..PlanOptions::default() };
                let (stream, _) = encode_clip(&clip, &options).unwrap();
                let mut decoder = Decoder::new(DecoderOptions::default());
                decoder.push(&stream).unwrap();
                let first = decoder.next_frame().unwrap().unwrap().baps.value(turn);
                assert!((1860 - first).abs() <= 127, "{mode:?}, live {live}: {first}");
            }
        }
    }

    #[test]
    fn nonsense_is_refused() {
        let clip = clip();
        for mode in [
            RateMode::Quant(32),
            RateMode::TargetRms(0.0),
            RateMode::Bitrate(f64::NAN),
            RateMode::MaxError(-1.0),
        ] {
            assert!(encode_clip(&clip, &PlanOptions { mode, ..PlanOptions::default() }).is_err(), "{mode:?}");
        }
        assert!(encode_clip(&[], &PlanOptions::default()).is_err());
        let backwards: Vec<TimedBapFrame> = clip.into_iter().rev().collect();
        assert!(encode_clip(&backwards, &PlanOptions::default()).is_err());
    }
}
