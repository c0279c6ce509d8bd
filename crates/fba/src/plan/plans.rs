//! The plans of the I periods of a clip, and how they become a stream.

use std::sync::Arc;

use super::super::error::EncodeError;
use super::super::reach::out_of_range;
use super::super::state::step;
use super::super::syntax::{
    IntraParams, MAX_RANGE_CODE, PlaneHeader, PlaneKind, RangeCodes, TimeCode, range_levels,
};
use super::super::writer::PlaneWriter;
use super::clip::Clip;
use super::options::{PlanOptions, degrees_of, new_writer};
use super::path::{self, Changes, Path, Way, codes_for, track};
use super::ranges::{Runs, params, sent_arrays};
use super::report::PlanReport;
use super::{share, windows};
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask, Unit, derive};

/// The plan of one I period.
#[derive(Clone, Debug)]
pub(super) struct PeriodPlan {
    pub quant: u8,
    /// How many frames it has, though nothing of them may be sent.
    pub frames: usize,
    /// BAPs in coding order, and the way of each.
    pub ways: Vec<(Bap, Way)>,
    /// Error and λ-weighted bits together.
    pub cost: f64,
}

impl PeriodPlan {
    /// Its frames as a decoder has them, from these values on; what is left to its model is filled in.
    fn frames(&self, before: &[i32; BAP_COUNT], options: &PlanOptions) -> impl Iterator<Item = BapFrame> {
        let mask = self.ways.iter().map(|(bap, _)| *bap).collect();
        let mut frame = BapFrame::with_values(mask, *before);
        let steps = self.ways.iter().map(|(bap, _)| step(*bap, options.steps, self.quant));
        let mut ways: Vec<_> =
            self.ways.iter().zip(steps).map(|((bap, way), step)| (*bap, step, way.levels())).collect();
        (0..self.frames).map(move |_| {
            for (bap, step, levels) in &mut ways {
                frame.set(*bap, levels.next().unwrap_or(0) * *step);
            }
            let mut coded = frame;
            derive::fill_in(options.ties, &mut coded);
            coded
        })
    }
}

/// Plans of all periods of a clip.
#[derive(Clone, Debug)]
pub(super) struct Plans {
    pub periods: Vec<PeriodPlan>,
    pub lambda: f64,
    /// Whether planes without any change are left out.
    pub skip: bool,
    /// How many planes that say nothing follow that of each frame; empty if none do anywhere.
    pub filler: Vec<u32>,
    /// Which periods send range arrays, where that is settled.
    pub runs: Option<Arc<Runs>>,
}

impl Plans {
    /// Plain rounding at one quantiser index.
    pub fn rounded(clip: &Clip, options: &PlanOptions, quant: u8) -> Result<Self, EncodeError> {
        let period = |index| -> Result<_, EncodeError> {
            let weights = vec![1.0; clip.period(index).len()];
            let mut ways = Vec::new();
            for bap in options.sendable(&clip.mask(index)).in_coding_order() {
                let input = clip.column(index, bap);
                let track = track(input, &weights, bap, quant, options, 0.0);
                let levels = path::rounded(&track);
                let first = clip.period(index).start;
                check(bap, input, &levels, quant, options).map_err(|(at, error)| error.at(first + at))?;
                let codes = codes_for(path::extent(&levels), quant).unwrap_or([MAX_RANGE_CODE; 2]);
                ways.push((bap, Way::from(&Path { levels, codes, ..Path::default() })));
            }
            Ok(PeriodPlan { quant, frames: clip.period(index).len(), ways, cost: 0.0 })
        };
        let periods = share::each(clip.periods(), period).into_iter().collect::<Result<_, _>>()?;
        Ok(Self { periods, lambda: 0.0, skip: false, filler: Vec::new(), runs: None })
    }

    /// Whether a plane is sent at each frame: at the first one of each period, and at those that change something.
    fn sent(&self, clip: &Clip) -> Vec<bool> {
        let mut sent = vec![!self.skip; clip.len()];
        for (index, period) in self.periods.iter().enumerate() {
            let sent = &mut sent[clip.period(index)];
            sent[0] = true;
            for (_, way) in &period.ways {
                way.mark(sent);
            }
        }
        sent
    }

    /// The range arrays that the I plane of each period sends, whose frames have planes or none, and which do.
    fn arrays(
        &self,
        sent: &[bool],
        clip: &Clip,
        options: &PlanOptions,
    ) -> (Vec<[Option<RangeCodes>; 4]>, Runs) {
        let planes = |index| sent[clip.period(index)].iter().skip(1).filter(|&&sent| sent).count();
        let planes: Vec<usize> = (0..clip.periods()).map(planes).collect();
        sent_arrays(&self.periods, &planes, &|index| clip.leaps(index), options, self.runs.as_deref())
    }

    /// Which periods send range arrays.
    pub fn runs(&self, clip: &Clip, options: &PlanOptions) -> Runs {
        self.arrays(&self.sent(clip), clip, options).1
    }

    /// Writes the stream and measures it.
    pub fn write(&self, clip: &Clip, options: &PlanOptions) -> Result<(Vec<u8>, PlanReport), EncodeError> {
        let write = || -> Result<_, EncodeError> {
            let mut pen = Pen::new(self, clip, options);
            (0..self.periods.len()).try_for_each(|index| pen.write_period(index))?;
            Ok(pen.finish())
        };
        let (written, errors) = share::both(write, || self.errors(clip, options));
        let (stream, mut report) = written?;
        errors.report(&mut report);
        let rate = options.rate.per_second();
        report.window_kbit_per_s = windows::extremes(&clip.ticks, &report.frame_bits, rate);
        Ok((stream, report))
    }

    /// Errors of what a decoder will have. Frame by frame: sums in another order would differ in their last bits, and what is
    /// searched for with them.
    fn errors(&self, clip: &Clip, options: &PlanOptions) -> Errors {
        let mut errors = Errors::default();
        for (index, before) in self.values_before(options).iter().enumerate() {
            errors.leave(options.left_to_model(&clip.mask(index)));
            for (offset, coded) in self.periods[index].frames(before, options).enumerate() {
                let held = clip.held(index, offset);
                errors.add(clip.row(index, offset).filter(|(bap, _)| !held.contains(*bap)), &coded);
            }
        }
        errors
    }

    /// What `work` makes of each I period, given its number and its frames as a decoder will have them; of several at a
    /// time.
    pub fn each_period<T: Send>(
        &self,
        options: &PlanOptions,
        work: impl Fn(usize, &mut dyn Iterator<Item = BapFrame>) -> T + Sync + Send,
    ) -> Vec<T> {
        let before = self.values_before(options);
        share::each(self.periods.len(), |index| {
            work(index, &mut self.periods[index].frames(&before[index], options))
        })
    }

    /// The values that a decoder has when each I period begins: what it does not switch on keeps them.
    fn values_before(&self, options: &PlanOptions) -> Vec<[i32; BAP_COUNT]> {
        let values = self.periods.iter().scan([0; BAP_COUNT], |values, period| {
            let before = *values;
            for (bap, way) in &period.ways {
                values[bap.index()] = way.last() * step(*bap, options.steps, period.quant);
            }
            Some(before)
        });
        values.collect()
    }
}

/// That planes carry these levels of a BAP, the first as a value and the others as changes: else what cannot be coded, and
/// where.
fn check(
    bap: Bap,
    input: &[i32],
    levels: &[i32],
    quant: u8,
    options: &PlanOptions,
) -> Result<(), (usize, EncodeError)> {
    let most = range_levels(MAX_RANGE_CODE, quant);
    let beyond = |kind, value| out_of_range(bap, kind, value, options.steps, quant);
    if let (Some(level), Some(&value)) = (levels.first(), input.first())
        && level.abs() > most
    {
        return Err((0, beyond(PlaneKind::Intra, value)));
    }
    let far = levels.windows(2).position(|pair| (pair[1] - pair[0]).abs() > most);
    far.map_or(Ok(()), |at| Err((at + 1, beyond(PlaneKind::Predicted, input[at + 1] - input[at]))))
}

/// Plans as they are written.
struct Pen<'a> {
    plans: &'a Plans,
    clip: &'a Clip,
    options: &'a PlanOptions,
    writer: PlaneWriter,
    report: PlanReport,
    /// Levels of a plane, and the reconstruction that is planned at its frame, in steps, by BAP in coding order.
    levels: Vec<i32>,
    planned: Vec<i32>,
    /// Whether a plane is sent at each frame of the clip, and the range arrays of each I plane.
    sent: Vec<bool>,
    arrays: Vec<[Option<RangeCodes>; 4]>,
}

impl<'a> Pen<'a> {
    fn new(plans: &'a Plans, clip: &'a Clip, options: &'a PlanOptions) -> Self {
        let report = PlanReport {
            frames: clip.len() as u64,
            seconds: clip.seconds,
            quants: plans.periods.iter().map(|period| period.quant).collect(),
            lambda: plans.lambda,
            frame_bits: Vec::with_capacity(clip.len()),
            ..PlanReport::default()
        };
        let sent = plans.sent(clip);
        Self {
            plans,
            clip,
            options,
            arrays: plans.arrays(&sent, clip, options).0,
            writer: new_writer(options),
            report,
            levels: Vec::new(),
            planned: Vec::new(),
            sent,
        }
    }

    fn write_period(&mut self, index: usize) -> Result<(), EncodeError> {
        let period = &self.plans.periods[index];
        let mask: BapMask = period.ways.iter().map(|(bap, _)| *bap).collect();
        self.report.sent = self.report.sent.union(&mask);
        self.planned.clear();
        self.planned.extend(period.ways.iter().map(|(_, way)| way.first));
        let mut changes: Vec<Changes<'_>> = period.ways.iter().map(|(_, way)| way.changes()).collect();
        for (offset, frame) in self.clip.period(index).enumerate() {
            let values = self.writer.values();
            let ways =
                period.ways.iter().zip(changes.iter_mut().filter_map(Iterator::next)).zip(&mut self.planned);
            self.levels.clear();
            self.levels.extend(ways.map(|(((bap, _), change), planned)| {
                *planned += change;
                let before = values[bap.index()] / step(*bap, self.options.steps, period.quant);
                *planned - if offset == 0 { 0 } else { before }
            }));
            if offset > 0 {
                // One that was changed, lest a plane imitate a start code, may be beyond what a plane can take back.
                let slots = self.writer.layout().slots();
                for (level, slot) in self.levels.iter_mut().zip(slots) {
                    let [min, max] = slot.range(PlaneKind::Predicted);
                    *level = (*level).clamp(min, max);
                }
            }
            let turn = !self.clip.leaps(index);
            let bits = match offset {
                0 => self.write_plane(frame, Some((&params(period, mask, self.arrays[index]), turn)))?,
                _ if self.sent[frame] => self.write_plane(frame, None)?,
                _ => 0,
            };
            self.report.frame_bits.push(bits);
        }
        Ok(())
    }

    /// Frames skipped after the plane of `frame`.
    fn skipped(&self, frame: usize) -> u32 {
        let ticks = &self.clip.ticks;
        let rest = &self.sent[frame + 1..];
        let next = frame + 1 + rest.iter().position(|&sent| sent).unwrap_or(rest.len());
        let end = ticks.last().map_or(0, |last| last + 1);
        (ticks.get(next).copied().unwrap_or(end) - ticks[frame] - 1) as u32
    }

    /// Writes the plane of a frame, an I plane if it has parameters, in its turn or not, and what follows it to fill a rate
    /// up.
    fn write_plane(
        &mut self,
        frame: usize,
        params: Option<(&IntraParams, bool)>,
    ) -> Result<u64, EncodeError> {
        let tick = self.clip.ticks[frame];
        let mut header =
            PlaneHeader { object_mask: 2, skipped: self.skipped(frame), ..PlaneHeader::default() };
        let resync = self.options.resync;
        if let Some((_, turn)) = params {
            header.kind = PlaneKind::Intra;
            header.rate = (turn || resync).then_some(self.options.rate);
            header.time_code = if resync { TimeCode::at(tick, self.options.rate) } else { None };
            self.report.intra_planes += 1;
        }
        let start_code = params.is_some() && resync && frame > 0;
        let mut bits = self.writer.write_plane(
            &header,
            start_code,
            params.map(|(params, _)| params),
            &mut self.levels,
        )?;
        self.report.planes += 1;
        for _ in 0..self.plans.filler.get(frame).copied().unwrap_or(0) {
            let empty = self.writer.write_empty(PlaneKind::Intra)?;
            self.report.filler += empty.total();
            bits += empty;
        }
        self.report.bits += bits;
        Ok(bits.total())
    }

    fn finish(self) -> (Vec<u8>, PlanReport) {
        let mut report = self.report;
        let stream = self.writer.finish();
        report.bytes = stream.len();
        (stream, report)
    }
}

/// Errors of the reconstructed angles, gathered frame by frame.
#[derive(Clone, Debug)]
pub(super) struct Errors {
    /// Sums of squared degrees.
    squares: [f64; BAP_COUNT],
    /// Frames that give each angle.
    given: [u64; BAP_COUNT],
    /// Angles ever different from 0, and all angles given.
    moving: BapMask,
    angles: BapMask,
    /// Angles that are left to the decoder's model.
    derived: BapMask,
    /// Largest of each angle, degrees.
    max: [f64; BAP_COUNT],
}

impl Default for Errors {
    fn default() -> Self {
        Self {
            squares: [0.0; BAP_COUNT],
            given: [0; BAP_COUNT],
            moving: BapMask::EMPTY,
            angles: BapMask::EMPTY,
            derived: BapMask::EMPTY,
            max: [0.0; BAP_COUNT],
        }
    }
}

impl Errors {
    /// Takes in that these angles are left to the decoder's model.
    pub fn leave(&mut self, derived: BapMask) {
        self.derived = self.derived.union(&derived);
    }

    /// Adds those of one frame of `wanted` values, for which a decoder has `coded`.
    pub fn add(&mut self, wanted: impl Iterator<Item = (Bap, i32)>, coded: &BapFrame) {
        for (bap, wanted) in wanted.filter(|(bap, _)| bap.unit() == Unit::Angle) {
            let off = degrees_of(bap, i64::from(wanted) - i64::from(coded.value(bap)));
            self.squares[bap.index()] += off * off;
            self.given[bap.index()] += 1;
            self.max[bap.index()] = self.max[bap.index()].max(off.abs());
            self.angles.insert(bap);
            if wanted != 0 {
                self.moving.insert(bap);
            }
        }
    }

    /// Says what they come to.
    pub fn report(&self, report: &mut PlanReport) {
        // Angles that are always 0 in the input may be off, and count with those that move.
        let rms = |of: &BapMask, over: &BapMask| {
            let given: u64 = over.iter().map(|bap| self.given[bap.index()]).sum();
            let sum = of.iter().fold(0.0, |sum, bap| sum + self.squares[bap.index()]);
            if given == 0 { 0.0 } else { (sum / given as f64).sqrt() }
        };
        let max = |mask: &BapMask| mask.iter().map(|bap| self.max[bap.index()]).fold(0.0, f64::max);
        let sent = self.angles.difference(&self.derived);
        report.rms_degrees = rms(&sent, &self.moving.difference(&self.derived));
        report.rms_all_degrees = rms(&sent, &sent);
        report.max_degrees = max(&sent);
        let derived = (!self.derived.is_empty()).then_some(&self.derived);
        report.derived_degrees = derived.map(|mask| [rms(mask, mask), max(mask)]);
    }
}
