//! The plans of the I periods of a clip, and how they become a stream.

use super::super::error::EncodeError;
use super::super::state::step;
use super::super::syntax::{
    IntraParams, MAX_RANGE_CODE, PlaneHeader, PlaneKind, RangeEnd, TimeCode, range_code,
};
use super::clip::Clip;
use super::path::{self, Path};
use super::search::{codes_for, out_of_range, track};
use super::{PlanOptions, PlanReport, degrees_of, new_writer};
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask, Tie, Unit, derive};

/// The plan of one I period.
#[derive(Clone, Debug)]
pub(super) struct PeriodPlan {
    pub quant: u8,
    /// BAPs in coding order, and the way of each.
    pub paths: Vec<(Bap, Path)>,
    /// Error and λ-weighted bits together.
    pub cost: f64,
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
}

impl Plans {
    /// Plain rounding at one quantiser index.
    pub fn rounded(clip: &Clip, options: &PlanOptions, quant: u8) -> Result<Self, EncodeError> {
        let mut periods = Vec::new();
        for index in 0..clip.periods() {
            let range = clip.period(index);
            let mask = options.sendable(&clip.frames[range.start].mask);
            let mut paths = Vec::new();
            for bap in mask.in_coding_order() {
                let input: Vec<i32> =
                    clip.frames[range.clone()].iter().map(|frame| frame.value(bap)).collect();
                let weights = vec![1.0; input.len()];
                let track = track(&input, &weights, bap, quant, options, 0.0);
                let levels = path::rounded(&track);
                let codes = codes_for(path::extent(&levels), quant)
                    .ok_or_else(|| out_of_range(bap, &input, options.steps, quant))?;
                paths.push((bap, Path { levels, codes, ..Path::default() }));
            }
            periods.push(PeriodPlan { quant, paths, cost: 0.0 });
        }
        Ok(Self { periods, lambda: 0.0, skip: false, filler: Vec::new() })
    }

    /// Writes the stream and measures it.
    pub fn write(&self, clip: &Clip, options: &PlanOptions) -> Result<(Vec<u8>, PlanReport), EncodeError> {
        let mut writer = new_writer(options);
        let mut report = PlanReport {
            frames: clip.frames.len() as u64,
            seconds: clip.seconds(options.rate),
            quants: self.periods.iter().map(|period| period.quant).collect(),
            lambda: self.lambda,
            ..PlanReport::default()
        };
        report.frame_bits.reserve(clip.frames.len());
        let mut errors = Errors::default();
        let mut levels = Vec::new();
        let mut last_sent: Option<u64> = None;
        for (index, period) in self.periods.iter().enumerate() {
            let mask: BapMask = period.paths.iter().map(|(bap, _)| *bap).collect();
            report.sent = report.sent.union(&mask);
            for (offset, frame) in clip.period(index).enumerate() {
                levels.clear();
                let values = writer.values();
                levels.extend(period.paths.iter().map(|(bap, path)| {
                    let before = values[bap.index()] / step(*bap, options.steps, period.quant);
                    path.levels[offset] - if offset == 0 { 0 } else { before }
                }));
                let tick = clip.ticks[frame];
                let last = frame + 1 == clip.frames.len();
                if offset > 0 && self.skip && !last && levels.iter().all(|&level| level == 0) {
                    errors.add(clip, options.ties, frame, &BapFrame::with_values(mask, *writer.values()));
                    report.frame_bits.push(0);
                    continue;
                }
                let mut header = PlaneHeader {
                    object_mask: 2,
                    skipped: last_sent.map_or(0, |last| (tick - last - 1) as u32),
                    ..PlaneHeader::default()
                };
                last_sent = Some(tick);
                let mut bits = if offset == 0 {
                    header.kind = PlaneKind::Intra;
                    header.rate = Some(options.rate);
                    header.time_code = if options.resync { TimeCode::at(tick, options.rate) } else { None };
                    report.intra_planes += 1;
                    let params = self.params(period, mask);
                    writer.write_plane(&header, options.resync && frame > 0, Some(&params), &mut levels)?
                } else {
                    writer.write_plane(&header, false, None, &mut levels)?
                };
                report.planes += 1;
                for _ in 0..self.filler.get(frame).copied().unwrap_or(0) {
                    let empty = writer.write_empty(PlaneKind::Intra)?;
                    report.filler += empty.total();
                    bits += empty;
                }
                report.bits += bits;
                report.frame_bits.push(bits.total());
                errors.add(clip, options.ties, frame, &BapFrame::with_values(mask, *writer.values()));
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

/// Errors of the reconstruction, gathered frame by frame.
pub(super) struct Errors {
    squares: [f64; BAP_COUNT],
    max: f64,
}

impl Default for Errors {
    fn default() -> Self {
        Self { squares: [0.0; BAP_COUNT], max: 0.0 }
    }
}

impl Errors {
    /// Adds those of one frame, for which a decoder has `sent` and what `ties` derive from it.
    pub fn add(&mut self, clip: &Clip, ties: &[Tie], frame: usize, sent: &BapFrame) {
        let mut sent = *sent;
        derive::fill_in(ties, &mut sent);
        for (bap, wanted) in clip.frames[frame].iter().filter(|(bap, _)| bap.unit() == Unit::Angle) {
            let off = degrees_of(bap, i64::from(wanted) - i64::from(sent.value(bap)));
            self.squares[bap.index()] += off * off;
            self.max = self.max.max(off.abs());
        }
    }

    /// RMS over the moving angles, over all angles, and the largest error.
    pub fn measures(&self, clip: &Clip) -> (f64, f64, f64) {
        let sum: f64 = self.squares.iter().sum();
        let rms = |mask: &BapMask| {
            let given: usize = clip.frames.iter().map(|frame| frame.mask.intersection(mask).len()).sum();
            if given == 0 { 0.0 } else { (sum / given as f64).sqrt() }
        };
        (rms(&clip.moving), rms(&clip.angles), self.max)
    }
}
