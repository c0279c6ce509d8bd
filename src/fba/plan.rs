//! Rate control: which quantiser, masks, ranges and levels to send for the wanted rate or error.
//!
//! Offline, every I period is planned as a whole: for each BAP the cheapest way through the period is
//! searched (see `path`), for several quantiser indices, at a price λ per bit that is the same for the
//! whole clip. λ is then set so that the clip meets its target. All of it stays within the standard's
//! predictive mode, so any decoder reads the result.

mod live;
mod path;

pub use live::LiveEncoder;

use std::ops::RangeInclusive;

use path::{Company, Factorials, Path, Search, Track};

use super::encoder::degrees_per_unit;
use super::error::EncodeError;
use super::state::step;
use super::syntax::{
    FrameRate, IntraParams, MAX_RANGE_CODE, PlaneHeader, PlaneKind, RangeEnd, TimeCode, range_code,
    range_levels,
};
use super::writer::{PlaneBits, PlaneWriter};
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask, StepTable, Unit};

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
    /// This many kilobits per second, at the least error.
    Bitrate(f64),
    /// A root mean square error of the moving angles of this many degrees, at the least rate.
    TargetRms(f64),
}

/// How to encode a clip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanOptions {
    /// Base steps; the decoder must be told the same.
    pub steps: StepTable,
    /// Frame rate of the stream. Frames are put on its ticks.
    pub rate: FrameRate,
    /// What to aim at.
    pub mode: RateMode,
    /// Code each frame when it comes, without look-ahead.
    pub live: bool,
    /// Seconds from one I plane to the next; at each of them a decoder can start.
    pub intra_seconds: f64,
    /// Largest error of an angle in degrees, whatever the mode; steeply priced beyond.
    pub max_error: f64,
    /// Start code and time code with every I plane, so that a decoder can resume there after damage.
    pub resync: bool,
    /// BAPs not to send because the decoder's hand model derives them.
    pub derived: BapMask,
    /// Profile and level indication of a visual object sequence around the object, if one is wanted.
    pub wrapper: Option<u8>,
}

impl Default for PlanOptions {
    /// 0.5° RMS at 30 frames/s, an I plane every five seconds.
    fn default() -> Self {
        Self {
            steps: StepTable::Standard,
            rate: FrameRate::ASSUMED,
            mode: RateMode::TargetRms(0.5),
            live: false,
            intra_seconds: 5.0,
            max_error: 2.5,
            resync: false,
            derived: BapMask::EMPTY,
            wrapper: None,
        }
    }
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
/// use handcast::bap::{Bap, BapFrame};
/// use handcast::fba::plan::{PlanOptions, TimedBapFrame, encode_clip};
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
/// # Ok::<(), handcast::fba::error::EncodeError>(())
/// ```
pub fn encode_clip(
    frames: &[TimedBapFrame],
    options: &PlanOptions,
) -> Result<(Vec<u8>, PlanReport), EncodeError> {
    let clip = Clip::new(frames, options)?;
    if options.live {
        return write_live(&clip, options);
    }
    let plans = match options.mode {
        RateMode::Quant(quant) => {
            if quant > 31 {
                return Err(refused("quantiser index", quant.into(), "0 to 31"));
            }
            Plans::rounded(&clip, options, quant)?
        }
        RateMode::MaxError(degrees) => {
            positive("largest error", degrees)?;
            let options = PlanOptions { max_error: degrees, ..*options };
            Planner::new(&clip, &options).bounded(degrees)?
        }
        RateMode::TargetRms(degrees) => {
            positive("rms error", degrees)?;
            Planner::new(&clip, options).search(Goal::Rms(degrees))?
        }
        RateMode::Bitrate(kbit_per_s) => {
            positive("bit rate", kbit_per_s)?;
            let mut plans = Plans { periods: Vec::new(), lambda: 0.0, skip: true };
            for index in 0..clip.periods() {
                let part = clip.part(index);
                let found = Planner::new(&part, options).search(Goal::Rate(kbit_per_s))?;
                plans.lambda += found.lambda / clip.periods() as f64;
                plans.periods.extend(found.periods);
            }
            plans
        }
    };
    plans.write(&clip, options)
}

/// Encodes a clip frame by frame, as if the frames came one by one.
fn write_live(clip: &Clip, options: &PlanOptions) -> Result<(Vec<u8>, PlanReport), EncodeError> {
    let mut encoder = LiveEncoder::new(options)?;
    let mut report = PlanReport {
        frames: clip.frames.len() as u64,
        seconds: clip.seconds(options.rate),
        ..PlanReport::default()
    };
    let mut errors = Errors::default();
    let mut before = None;
    for (index, (frame, &tick)) in clip.frames.iter().zip(&clip.ticks).enumerate() {
        for _ in before.map_or(tick, |before| before + 1)..tick {
            encoder.skip_frame();
        }
        before = Some(tick);
        let bits = encoder.write_frame(frame)?;
        report.intra_planes += u64::from(bits.masks > 0);
        report.sent = report.sent.union(&encoder.encoder().mask());
        errors.add(clip, index, encoder.encoder().reconstruction().values());
    }
    report.lambda = encoder.lambda();
    report.planes = encoder.encoder().planes();
    report.bits = encoder.encoder().bits();
    let stream = encoder.finish();
    report.bytes = stream.len();
    (report.rms_degrees, report.rms_all_degrees, report.max_degrees) = errors.measures(clip);
    Ok((stream, report))
}

fn refused(what: &'static str, value: f64, allowed: &'static str) -> EncodeError {
    EncodeError::Parameter { what, value, allowed }
}

fn positive(what: &'static str, value: f64) -> Result<(), EncodeError> {
    if value > 0.0 && value.is_finite() { Ok(()) } else { Err(refused(what, value, "positive")) }
}

/// The frames of a clip on the ticks of the stream's clock, cut into I periods.
struct Clip {
    frames: Vec<BapFrame>,
    /// Tick of each frame, from 0.
    ticks: Vec<u64>,
    /// First frame of each period, and the number of frames.
    cuts: Vec<usize>,
    /// Angles ever different from 0, and all angles given.
    moving: BapMask,
    angles: BapMask,
    /// Tick behind the last frame.
    end: Option<u64>,
}

/// Whether a BAP changes by more than a P plane may carry: the frame then begins an I period. Rotation
/// vectors do so where they pass to the other way round.
fn jumps(before: &BapFrame, frame: &BapFrame, steps: StepTable) -> bool {
    frame.iter().any(|(bap, value)| {
        let reach = 0.9 * f64::from(range_levels(MAX_RANGE_CODE, 1)) * f64::from(step(bap, steps, 1));
        (f64::from(value) - f64::from(before.value(bap))).abs() > reach
    })
}

/// Ticks between two frames, at most: what a decoder accepts as skipped frames.
const MAX_GAP: u64 = 65_535;

impl Clip {
    fn new(frames: &[TimedBapFrame], options: &PlanOptions) -> Result<Self, EncodeError> {
        positive("frame rate", options.rate.per_second())?;
        positive("seconds between i planes", options.intra_seconds)?;
        positive("largest error", options.max_error)?;
        let first = frames.first().ok_or(refused("number of frames", 0.0, "at least 1"))?;
        let mut clip = Self {
            frames: Vec::with_capacity(frames.len()),
            ticks: Vec::with_capacity(frames.len()),
            cuts: vec![0],
            moving: BapMask::EMPTY,
            angles: BapMask::EMPTY,
            end: None,
        };
        let rate = options.rate.per_second();
        let interval = (options.intra_seconds * rate).round().max(1.0) as u64;
        let mut next_cut = interval;
        for frame in frames {
            let wanted = ((frame.time - first.time) * rate).round();
            let last = clip.ticks.last().copied();
            // Times that jitter may put two frames on one tick; the second then moves to the next.
            let tick = last.map_or(0.0, |last| wanted.max(last as f64 + 1.0));
            let gap = last.map_or(0.0, |last| tick - last as f64);
            if !(tick - wanted <= 1.0 && gap <= MAX_GAP as f64) {
                return Err(refused("time of a frame", frame.time, "about a tick after the frame before"));
            }
            let tick = tick as u64;
            let changed = clip.frames.last().is_some_and(|before| {
                before.mask != frame.baps.mask || jumps(before, &frame.baps, options.steps)
            });
            if tick >= next_cut || changed {
                clip.cuts.push(clip.frames.len());
                while next_cut <= tick {
                    next_cut += interval;
                }
            }
            clip.frames.push(frame.baps);
            clip.ticks.push(tick);
            for (bap, value) in frame.baps.iter().filter(|(bap, _)| bap.unit() == Unit::Angle) {
                clip.angles.insert(bap);
                if value != 0 {
                    clip.moving.insert(bap);
                }
            }
        }
        clip.cuts.push(clip.frames.len());
        clip.end = clip.ticks.last().map(|last| last + 1);
        Ok(clip)
    }

    fn periods(&self) -> usize {
        self.cuts.len() - 1
    }

    fn period(&self, index: usize) -> std::ops::Range<usize> {
        self.cuts[index]..self.cuts[index + 1]
    }

    /// One period as a clip of its own.
    fn part(&self, index: usize) -> Self {
        let range = self.period(index);
        let first = self.ticks.get(range.start).copied().unwrap_or(0);
        // What lies between the last frame and the next period belongs to this one.
        let end = self.ticks.get(range.end).copied().or(self.end).unwrap_or(first);
        Self {
            frames: self.frames[range.clone()].to_vec(),
            ticks: self.ticks[range.clone()].iter().map(|tick| tick - first).collect(),
            cuts: vec![0, range.len()],
            moving: self.moving,
            angles: self.angles,
            end: Some(end - first),
        }
    }

    fn seconds(&self, rate: FrameRate) -> f64 {
        self.end.map_or(0.0, |end| end as f64 / rate.per_second())
    }
}

/// The plan of one I period.
#[derive(Clone, Debug)]
struct PeriodPlan {
    quant: u8,
    /// BAPs in coding order, and the way of each.
    paths: Vec<(Bap, Path)>,
    /// Error and λ-weighted bits together.
    cost: f64,
}

/// Plans of all periods of a clip.
#[derive(Clone, Debug)]
struct Plans {
    periods: Vec<PeriodPlan>,
    lambda: f64,
    /// Whether planes without any change are left out.
    skip: bool,
}

impl Plans {
    /// Plain rounding at one quantiser index.
    fn rounded(clip: &Clip, options: &PlanOptions, quant: u8) -> Result<Self, EncodeError> {
        let mut periods = Vec::new();
        for index in 0..clip.periods() {
            let range = clip.period(index);
            let mask = clip.frames[range.start].mask.difference(&options.derived);
            let mut paths = Vec::new();
            for bap in mask.in_coding_order() {
                let input: Vec<i32> =
                    clip.frames[range.clone()].iter().map(|frame| frame.value(bap)).collect();
                let track = track(&input, bap, quant, options, 0.0);
                let levels = path::rounded(&track);
                let codes = codes_for(path::extent(&levels), quant)
                    .ok_or_else(|| out_of_range(bap, &input, options.steps, quant))?;
                paths.push((bap, Path { levels, codes, ..Path::default() }));
            }
            periods.push(PeriodPlan { quant, paths, cost: 0.0 });
        }
        Ok(Self { periods, lambda: 0.0, skip: false })
    }

    /// Writes the stream and measures it.
    fn write(&self, clip: &Clip, options: &PlanOptions) -> Result<(Vec<u8>, PlanReport), EncodeError> {
        let mut writer = match options.wrapper {
            Some(profile) => PlaneWriter::with_visual_wrapper(options.steps, profile),
            None => PlaneWriter::new(options.steps),
        };
        let mut report = PlanReport {
            frames: clip.frames.len() as u64,
            seconds: clip.seconds(options.rate),
            quants: self.periods.iter().map(|period| period.quant).collect(),
            lambda: self.lambda,
            ..PlanReport::default()
        };
        let mut errors = Errors::default();
        let mut levels = Vec::new();
        let mut last_sent: Option<u64> = None;
        for (index, period) in self.periods.iter().enumerate() {
            let mask: BapMask = period.paths.iter().map(|(bap, _)| *bap).collect();
            report.sent = report.sent.union(&mask);
            for (offset, frame) in clip.period(index).enumerate() {
                levels.clear();
                levels.extend(period.paths.iter().map(|(_, path)| {
                    path.levels[offset] - if offset == 0 { 0 } else { path.levels[offset - 1] }
                }));
                let tick = clip.ticks[frame];
                let last = frame + 1 == clip.frames.len();
                if offset > 0 && self.skip && !last && levels.iter().all(|&level| level == 0) {
                    errors.add(clip, frame, writer.values());
                    continue;
                }
                let mut header = PlaneHeader {
                    object_mask: 2,
                    skipped: last_sent.map_or(0, |last| (tick - last - 1) as u32),
                    ..PlaneHeader::default()
                };
                last_sent = Some(tick);
                let bits = if offset == 0 {
                    header.kind = PlaneKind::Intra;
                    header.rate = Some(options.rate);
                    header.time_code = time_code(tick, options);
                    report.intra_planes += 1;
                    let params = self.params(period, mask);
                    writer.write_intra(&header, options.resync && frame > 0, &params, &levels)?
                } else {
                    writer.write_predicted(&header, false, &levels)?
                };
                report.bits += bits;
                report.planes += 1;
                errors.add(clip, frame, writer.values());
            }
        }
        let stream = writer.finish();
        report.bytes = stream.len();
        (report.rms_degrees, report.rms_all_degrees, report.max_degrees) = errors.measures(clip);
        Ok((stream, report))
    }

    fn params(&self, period: &PeriodPlan, mask: BapMask) -> IntraParams {
        let mut ranges = [[0; BAP_COUNT]; 4];
        for (bap, path) in &period.paths {
            let first = path.levels.first().copied().unwrap_or(0);
            let code = |magnitude| range_code(magnitude, period.quant).unwrap_or(MAX_RANGE_CODE);
            ranges[RangeEnd::IntraMax as usize][bap.index()] = code(first.max(0));
            ranges[RangeEnd::IntraMin as usize][bap.index()] = code(-first.min(0));
            ranges[RangeEnd::PredictedMax as usize][bap.index()] = path.codes[0];
            ranges[RangeEnd::PredictedMin as usize][bap.index()] = path.codes[1];
        }
        IntraParams { quant: period.quant, mask, ranges: ranges.map(Some), ..IntraParams::default() }
    }
}

/// The time code of a plane on a whole second, in streams that one can resume in.
fn time_code(tick: u64, options: &PlanOptions) -> Option<TimeCode> {
    let seconds = tick as f64 / options.rate.per_second();
    let whole = (seconds - seconds.round()).abs() < 1e-6;
    (options.resync && whole).then(|| TimeCode::from_seconds(seconds.round() as u32)).flatten()
}

/// Errors of the reconstruction, gathered frame by frame.
struct Errors {
    squares: [f64; BAP_COUNT],
    max: f64,
}

impl Default for Errors {
    fn default() -> Self {
        Self { squares: [0.0; BAP_COUNT], max: 0.0 }
    }
}

impl Errors {
    fn add(&mut self, clip: &Clip, frame: usize, values: &[i32; BAP_COUNT]) {
        for (bap, wanted) in clip.frames[frame].iter().filter(|(bap, _)| bap.unit() == Unit::Angle) {
            let off = (i64::from(wanted) - i64::from(values[bap.index()])) as f64 * degrees_per_unit(bap);
            self.squares[bap.index()] += off * off;
            self.max = self.max.max(off.abs());
        }
    }

    /// RMS over the moving angles, over all angles, and the largest error.
    fn measures(&self, clip: &Clip) -> (f64, f64, f64) {
        let sum: f64 = self.squares.iter().sum();
        let rms = |mask: &BapMask| {
            let given: usize = clip.frames.iter().map(|frame| frame.mask.intersection(mask).len()).sum();
            if given == 0 { 0.0 } else { (sum / given as f64).sqrt() }
        };
        (rms(&clip.moving), rms(&clip.angles), self.max)
    }
}

fn track<'a>(input: &'a [i32], bap: Bap, quant: u8, options: &PlanOptions, lambda: f64) -> Track<'a> {
    let step = step(bap, options.steps, quant);
    let degrees = degrees_per_unit(bap);
    // A bound below half a step cannot be kept. Only angles are bound in degrees; what counts in tenths
    // of a degree for want of a better measure gets more room.
    let room = if bap.unit() == Unit::Angle { options.max_error } else { 4.0 * options.max_error };
    Track { input, step, degrees, bound: room.max(0.5 * f64::from(step) * degrees), lambda }
}

fn codes_for([up, down]: [i32; 2], quant: u8) -> Option<[u8; 2]> {
    Some([range_code(up, quant)?, range_code(down, quant)?])
}

fn out_of_range(bap: Bap, input: &[i32], steps: StepTable, quant: u8) -> EncodeError {
    let reach = i64::from(range_levels(MAX_RANGE_CODE, quant)) * i64::from(step(bap, steps, quant));
    let value = input.iter().copied().max_by_key(|value| value.unsigned_abs()).unwrap_or(0);
    EncodeError::OutOfRange { bap, value, min: -reach, max: reach }
}

/// Searches the plans of a clip.
struct Planner<'a> {
    clip: &'a Clip,
    options: &'a PlanOptions,
    factorials: Factorials,
    search: Search,
    /// BAPs that are not worth sending.
    off: BapMask,
}

/// Quantiser indices worth trying.
const QUANTS: RangeInclusive<u8> = 1..=24;
/// Half the largest base step of an angle, in degrees: what the finest quantiser can promise for all.
const FINEST_BOUND: f64 = 0.1467;
/// Where the search for the best one begins.
const FIRST_QUANT: u8 = 8;
/// Bounds of the search for λ, squared degrees per bit.
const LAMBDAS: [f64; 2] = [1e-4, 16.0];

/// What a search of λ aims at.
#[derive(Clone, Copy, Debug)]
enum Goal {
    /// At most this error, at the least rate.
    Rms(f64),
    /// At most this rate, at the least error.
    Rate(f64),
}

impl Goal {
    fn fits(self, report: &PlanReport) -> bool {
        match self {
            Self::Rms(degrees) => report.rms_degrees <= degrees,
            Self::Rate(kbit_per_s) => report.kbit_per_s() <= kbit_per_s,
        }
    }

    /// Whether a larger λ makes a fitting result better.
    fn wants_larger(self) -> bool {
        matches!(self, Self::Rms(_))
    }

    /// What is to be small.
    fn score(self, report: &PlanReport) -> f64 {
        match self {
            Self::Rms(_) => report.bytes as f64,
            Self::Rate(_) => report.rms_degrees,
        }
    }
}

/// The best plans met by a search.
#[derive(Default)]
struct Candidate {
    plans: Option<Plans>,
    score: f64,
    quant: Option<u8>,
    lambda: f64,
}

impl Candidate {
    /// Bounds of a search near this candidate.
    fn lambdas(&self) -> [f64; 2] {
        match self.plans {
            Some(_) => [self.lambda * 0.5, self.lambda * 2.0],
            None => LAMBDAS,
        }
    }
}
/// Bits of a P plane around its values: header and flush.
const PLANE_BITS: f64 = 6.0;
/// Bits that a run of skipped frames adds to the next header.
const SKIP_BITS: f64 = 4.0;
/// Bits of a BAP in the range arrays of an I plane.
const RANGE_BITS: f64 = 20.0;
/// Times the ways of all BAPs are searched in turn, given those of the others.
const SWEEPS: usize = 3;

impl<'a> Planner<'a> {
    fn new(clip: &'a Clip, options: &'a PlanOptions) -> Self {
        let longest = (0..clip.periods()).map(|index| clip.period(index).len()).max().unwrap_or(0);
        let symbols = 2 * range_levels(MAX_RANGE_CODE, 1) as usize + 1;
        Self {
            clip,
            options,
            factorials: Factorials::new(longest + symbols),
            search: Search::default(),
            off: options.derived,
        }
    }

    /// The best plans that reach the goal: first the best quantiser index for the whole clip is
    /// found, walking from a middling one while it gets better, then each period may differ from it.
    fn search(&mut self, goal: Goal) -> Result<Plans, EncodeError> {
        let mut best = Candidate::default();
        let mut ends = [FIRST_QUANT; 2];
        self.bisect(FIRST_QUANT..=FIRST_QUANT, LAMBDAS, goal, &mut best)?;
        for (end, direction) in ends.iter_mut().zip([-1i8, 1]) {
            while let Some(quant) = end.checked_add_signed(direction).filter(|q| QUANTS.contains(q)) {
                let before = best.score;
                self.bisect(quant..=quant, best.lambdas(), goal, &mut best)?;
                *end = quant;
                if best.plans.is_some() && best.score >= before {
                    break;
                }
            }
        }
        if self.clip.periods() > 1 {
            let quant = best.quant.unwrap_or(FIRST_QUANT);
            let window = quant.saturating_sub(1).max(*QUANTS.start())..=(quant + 1).min(*QUANTS.end());
            self.bisect(window, best.lambdas(), goal, &mut best)?;
        }
        match best.plans {
            Some(plans) => Ok(plans),
            // Out of reach: as near as it goes.
            None => self.plans(LAMBDAS[usize::from(!goal.wants_larger())], QUANTS),
        }
    }

    /// Looks for the λ at which the goal is just reached with quantiser indices from `quants`, and keeps the
    /// best result met on the way.
    fn bisect(
        &mut self,
        quants: RangeInclusive<u8>,
        [mut low, mut high]: [f64; 2],
        goal: Goal,
        best: &mut Candidate,
    ) -> Result<(), EncodeError> {
        while high / low > 1.03 {
            let lambda = (low * high).sqrt();
            let plans = match self.plans(lambda, quants.clone()) {
                // Some other index may reach what these cannot.
                Err(EncodeError::OutOfRange { .. }) => return Ok(()),
                plans => plans?,
            };
            let (_, report) = plans.write(self.clip, self.options)?;
            let fits = goal.fits(&report);
            if fits == goal.wants_larger() {
                low = lambda;
            } else {
                high = lambda;
            }
            let score = goal.score(&report);
            if fits && (best.plans.is_none() || score < best.score) {
                *best = Candidate { score, quant: Some(*quants.start()), lambda, plans: Some(plans) };
            }
        }
        Ok(())
    }

    /// The plans that spend the least bits within the bound.
    fn bounded(&mut self, degrees: f64) -> Result<Plans, EncodeError> {
        self.plans(0.3 * degrees * degrees, QUANTS)
    }

    /// The best plans at a price per bit.
    fn plans(&mut self, lambda: f64, quants: RangeInclusive<u8>) -> Result<Plans, EncodeError> {
        let mut periods = Vec::with_capacity(self.clip.periods());
        for index in 0..self.clip.periods() {
            let mut best: Option<PeriodPlan> = None;
            for quant in quants.clone() {
                let Some(plan) = self.period(index, quant, lambda) else { continue };
                if best.as_ref().is_none_or(|best| plan.cost < best.cost) {
                    best = Some(plan);
                }
            }
            let Some(best) = best else {
                let frames = self.clip.period(index);
                let largest = self.clip.frames[frames].iter().flat_map(BapFrame::iter);
                let (bap, value) =
                    largest.max_by_key(|(_, value)| value.unsigned_abs()).ok_or(EncodeError::NoIntra)?;
                if self.options.max_error < FINEST_BOUND {
                    let what = "largest error";
                    return Err(refused(
                        what,
                        self.options.max_error,
                        "at least 0.15 degrees for all angles",
                    ));
                }
                return Err(out_of_range(bap, &[value], self.options.steps, 1));
            };
            periods.push(best);
        }
        let mut plans = Plans { periods, lambda, skip: true };
        self.drop_useless(&mut plans);
        Ok(plans)
    }

    /// Takes out the BAPs that cost more than the error of leaving them at 0.
    fn drop_useless(&self, plans: &mut Plans) {
        let mut gain = [0.0; BAP_COUNT];
        let mut needed = BapMask::EMPTY;
        for (index, period) in plans.periods.iter().enumerate() {
            for (bap, path) in &period.paths {
                for frame in self.clip.period(index) {
                    let off = f64::from(self.clip.frames[frame].value(*bap)) * degrees_per_unit(*bap);
                    gain[bap.index()] -= off * off;
                    if off.abs() > self.options.max_error {
                        needed.insert(*bap);
                    }
                }
                gain[bap.index()] += path.cost(plans.lambda) + plans.lambda * RANGE_BITS;
            }
        }
        for period in &mut plans.periods {
            period.paths.retain(|(bap, _)| needed.contains(*bap) || gain[bap.index()] < 0.0);
        }
    }

    /// Plans one period at one quantiser index; `None` if it cannot be coded so.
    fn period(&mut self, index: usize, quant: u8, lambda: f64) -> Option<PeriodPlan> {
        let frames = self.clip.period(index);
        let mask = self.clip.frames[frames.start].mask.difference(&self.off);
        let inputs: Vec<(Bap, Vec<i32>)> = mask
            .in_coding_order()
            .map(|bap| (bap, self.clip.frames[frames.clone()].iter().map(|f| f.value(bap)).collect()))
            .collect();
        // Where the step is so coarse that rounding alone may break the bound, the bound cannot be promised.
        let too_coarse = |(bap, input): &(Bap, Vec<i32>)| {
            let degrees = degrees_per_unit(*bap);
            let half_step = 0.5 * f64::from(step(*bap, self.options.steps, quant)) * degrees;
            bap.unit() == Unit::Angle
                && half_step > self.options.max_error
                && input.iter().any(|&value| f64::from(value).abs() * degrees > self.options.max_error)
        };
        if inputs.iter().any(too_coarse) {
            return None;
        }
        let count = frames.len();
        let mut active = vec![0u32; count];
        let mut paths: Vec<Path> = Vec::with_capacity(inputs.len());
        // At first every plane is sent; later sweeps find out which need not be.
        let everyone = vec![1u32; count];
        for (bap, input) in &inputs {
            let track = track(input, *bap, quant, self.options, lambda);
            let company = Company { others: &everyone, alone: 0.0 };
            let path = self.one(&track, &company, quant, None)?;
            mark(&path, &mut active, true);
            paths.push(path);
        }
        let mut others = vec![0u32; count];
        for _ in 1..SWEEPS {
            let zeros = self.zero_bits(&paths, &active, quant);
            for ((bap, input), path) in inputs.iter().zip(&mut paths) {
                mark(path, &mut active, false);
                others.clone_from(&active);
                let track = track(input, *bap, quant, self.options, lambda);
                let company = Company { others: &others, alone: PLANE_BITS + zeros };
                if let Some(found) = self.one(&track, &company, quant, Some(path)) {
                    *path = found;
                }
                mark(path, &mut active, true);
            }
        }
        let sent = active.iter().skip(1).filter(|&&changes| changes > 0).count();
        let runs = active.windows(2).skip(1).filter(|pair| pair[0] == 0 && pair[1] > 0).count();
        let overhead = PLANE_BITS * sent as f64 + SKIP_BITS * runs as f64;
        let mut cost = lambda * (overhead + RANGE_BITS * paths.len() as f64);
        for (path, (bap, input)) in paths.iter_mut().zip(&inputs) {
            let reach = path.codes.map(|code| range_levels(code, quant));
            path.bits = self.search.bits(&path.levels, &active, reach, &self.factorials);
            let track = track(input, *bap, quant, self.options, lambda);
            cost += path.error + lambda * path.bits + path::excess(&track, &path.levels);
        }
        let paths = inputs.into_iter().map(|(bap, _)| bap).zip(paths).collect();
        Some(PeriodPlan { quant, paths, cost })
    }

    /// Bits that all unchanged BAPs together add to a plane.
    fn zero_bits(&mut self, paths: &[Path], active: &[u32], quant: u8) -> f64 {
        let zero = |path: &Path| {
            let reach = path.codes.map(|code| range_levels(code, quant));
            self.search.zero_bits(&path.levels, active, reach)
        };
        paths.iter().map(zero).sum()
    }

    /// The best way of one BAP, with the P ranges that suit it.
    fn one(
        &mut self,
        track: &Track<'_>,
        company: &Company<'_>,
        quant: u8,
        before: Option<&Path>,
    ) -> Option<Path> {
        let guess = before.map_or_else(|| path::rounded(track), |path| path.levels.clone());
        let start = match before {
            Some(path) => path.codes,
            None => codes_for(path::extent(&guess), quant)?,
        };
        if guess.iter().any(|&level| range_code(level.abs(), quant).is_none()) {
            return None;
        }
        let mut attempt = |codes: [u8; 2], guess: &[i32]| {
            let reach = codes.map(|code| range_levels(code, quant));
            let mut path = self.search.best(track, company, &self.factorials, reach, guess)?;
            path.codes = codes;
            Some(path)
        };
        let mut best = attempt(start, &guess)?;
        loop {
            let tight = codes_for(path::extent(&best.levels), quant)?;
            let mut better = None;
            for codes in
                [tight, [tight[0].saturating_sub(1), tight[1]], [tight[0], tight[1].saturating_sub(1)]]
            {
                if codes == best.codes {
                    continue;
                }
                let Some(path) = attempt(codes, &best.levels) else { continue };
                let excess = |path: &Path| path::excess(track, &path.levels);
                let cost = path.cost(track.lambda) + excess(&path);
                if cost < best.cost(track.lambda) + excess(&best) - 1e-9 {
                    better = Some(path);
                    break;
                }
            }
            match better {
                Some(path) => best = path,
                None => return Some(best),
            }
        }
    }
}

/// Counts the changes of a path into `active`, or out of it.
fn mark(path: &Path, active: &mut [u32], add: bool) {
    for (pair, changes) in path.levels.windows(2).zip(active.iter_mut().skip(1)) {
        if pair[0] != pair[1] {
            *changes = if add { *changes + 1 } else { changes.saturating_sub(1) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fba::{Decoder, DecoderOptions};

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
