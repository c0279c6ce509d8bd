//! The ten seconds over which a rate is held, and what they cost.

use std::ops::Range;

use super::super::error::EncodeError;
use super::clip::Clip;
use super::options::{GRACE, PlanOptions, WINDOW};
use super::plans::Plans;
use super::steering::QUANTS;

/// Shares of its bits between which every window is promised to cost, and between which it is kept.
const PROMISED: [f64; 2] = [0.95, 1.05];
const HELD: [f64; 2] = [0.951, 1.049];
/// What the first seconds, which are in no window, may cost more than the rate, as a share of it: their I plane sends all.
const OPENING: f64 = 0.25;
/// Bits of a plane that says nothing.
const EMPTY_PLANE: f64 = 3.0;
/// What a share too much counts for in shares too little.
const TOO_MUCH: f64 = 20.0;
/// A frame rests if the second around it costs less than this share of what the rate gives it, however finely it is
/// coded.
const RESTS: f64 = 0.95;

/// The windows of a clip that the rate is held in.
pub(super) struct Windows {
    /// Frames of each, moving on.
    pub spans: Vec<Range<usize>>,
    /// Share of each in which there is something to say.
    pub lively: Vec<f64>,
    /// Frames in which there is not.
    pub resting: Vec<bool>,
    /// Bits of a window, and of the whole clip with what it begins with.
    pub bits: f64,
    pub total: f64,
}

impl Windows {
    /// Windows that begin with a frame or right behind it: no other costs more, or less.
    pub fn new(ticks: &[u64], rate: f64, kbit_per_s: f64) -> Self {
        let window = (WINDOW * rate).round().max(1.0) as u64;
        let first = (GRACE * rate).floor() as u64;
        let end = ticks.last().map_or(0, |last| last + 1);
        let mut spans: Vec<Range<usize>> = Vec::new();
        // Both ends only move on.
        let mut span = 0..0;
        let to =
            |from: usize, start: u64| from + ticks[from..].iter().take_while(|&&tick| tick < start).count();
        for start in ticks.iter().flat_map(|&tick| [tick, tick + 1]) {
            if start < first || start + window > end {
                continue;
            }
            span = to(span.start, start)..to(span.end, start + window);
            if spans.last() != Some(&span) {
                spans.push(span.clone());
            }
        }
        let per_tick = kbit_per_s * 1000.0 / rate;
        Self {
            lively: vec![1.0; spans.len()],
            resting: vec![false; ticks.len()],
            bits: per_tick * window as f64,
            total: per_tick * (end as f64 + OPENING * first as f64),
            spans,
        }
    }

    /// The same where a window may cost as little as it likes.
    pub fn at_most(ticks: &[u64], rate: f64, kbit_per_s: f64) -> Self {
        let mut windows = Self::new(ticks, rate, kbit_per_s);
        windows.lively.fill(0.0);
        windows
    }

    /// The same for a clip in which frames rest: what they have no use for is not missed in a window.
    pub fn of(clip: &Clip, options: &PlanOptions, kbit_per_s: f64) -> Result<Self, EncodeError> {
        let rate = options.rate.per_second();
        let mut windows = Self::new(&clip.ticks, rate, kbit_per_s);
        if windows.spans.is_empty() {
            return Ok(windows);
        }
        let (resting, predicted) = resting(clip, options, kbit_per_s * 1000.0 / rate)?;
        let mut rests = Running::default();
        for (span, lively) in windows.spans.iter().zip(&mut windows.lively) {
            rests.move_to(span, |frame| f64::from(u8::from(resting[frame])));
            // Ticks without a frame are no rest.
            let share = 1.0 - rests.sum / (WINDOW * rate).round().max(1.0);
            // There may be no I plane in what moves of a window.
            *lively = if share < 1.0 { share * predicted.max(0.0) } else { 1.0 };
        }
        windows.resting = resting;
        Ok(windows)
    }

    /// The windows that frames are in.
    pub fn around(&self, frames: &Range<usize>) -> Range<usize> {
        self.spans.partition_point(|span| span.end <= frames.start)
            ..self.spans.partition_point(|span| span.start < frames.end)
    }

    /// Bits of each of `windows`, of frames of so many `bits`.
    pub fn sums<'a>(&'a self, windows: Range<usize>, bits: &'a [u64]) -> impl Iterator<Item = f64> + 'a {
        let spans = &self.spans[windows];
        // The sum begins with an empty span there.
        let mut running = Running::at(spans.first().map_or(0, |span| span.start));
        spans.iter().map(move |span| {
            running.move_to(span, |frame| bits[frame] as f64);
            running.sum
        })
    }

    fn all_sums<'a>(&'a self, bits: &'a [u64]) -> impl Iterator<Item = f64> + 'a {
        self.sums(0..self.spans.len(), bits)
    }

    /// How well a stream keeps to the rate.
    pub fn judge(&self, bits: &[u64]) -> Judgement {
        let mut judgement = Judgement::default();
        for (sum, lively) in self.all_sums(bits).zip(&self.lively) {
            let share = sum / self.bits;
            let (over, under) = (share - PROMISED[1], PROMISED[0] * lively - share);
            judgement.missed += u64::from(over > 0.0 || under > 0.0);
            judgement.over = judgement.over.max(over);
            judgement.under = judgement.under.max(under);
        }
        judgement
    }

    /// Share by which a window of so many bits costs too much, or too little for what moves in it, at shares `held`.
    /// Too much counts for more.
    pub fn beyond(&self, span: usize, bits: f64, held: [f64; 2]) -> f64 {
        outside(bits / self.bits, self.lively[span], held)
    }

    /// The same for all of some windows, of so many bits and others.
    pub fn all_beyond(&self, windows: Range<usize>, bits: &[f64], more: &[f64], held: [f64; 2]) -> f64 {
        let (scale, lively) = (1.0 / self.bits, &self.lively[windows]);
        let beyond = bits
            .iter()
            .zip(more)
            .zip(lively)
            .map(|((bits, more), lively)| outside((bits + more) * scale, *lively, held));
        beyond.sum()
    }

    /// Planes that say nothing to follow that of each frame, so that no window costs too little for what moves in
    /// it, as far as none costs too much then. They follow frames that are sent, as late ones as can be: windows to
    /// come need them, too.
    pub fn filler(&self, bits: &[u64]) -> Vec<u32> {
        let mut sums: Vec<f64> = self.all_sums(bits).collect();
        let mut filler = vec![0; bits.len()];
        for (index, span) in self.spans.iter().enumerate() {
            for frame in span.clone().rev().filter(|&frame| bits[frame] > 0) {
                let missing = HELD[0] * self.lively[index] * self.bits - sums[index];
                if missing <= 0.0 {
                    break;
                }
                let with = &mut sums[self.around(&(frame..frame + 1))];
                let room = HELD[1] * self.bits - with.iter().copied().fold(0.0, f64::max);
                let planes = (missing / EMPTY_PLANE).ceil().min((room.max(0.0) / EMPTY_PLANE).floor());
                filler[frame] += planes as u32;
                with.iter_mut().for_each(|sum| *sum += planes * EMPTY_PLANE);
            }
        }
        filler
    }

    /// Windows that are not within the band.
    pub fn broken<'a>(&'a self, bits: &'a [u64]) -> impl Iterator<Item = Range<usize>> + 'a {
        let beyond = self.all_sums(bits).enumerate().map(|(index, sum)| self.beyond(index, sum, HELD));
        self.spans.iter().zip(beyond).filter(|(_, beyond)| *beyond > 0.0).map(|(span, _)| span.clone())
    }

    /// What all windows are beyond the band, and the largest share of its bits that one of them costs.
    pub fn excess(&self, bits: &[u64]) -> [f64; 2] {
        self.all_sums(bits).enumerate().fold([0.0; 2], |[excess, most], (index, sum)| {
            [excess + self.beyond(index, sum, HELD), most.max(sum / self.bits)]
        })
    }
}

/// What a window that costs this share of its bits is outside the shares `held`, where so much of it is lively.
fn outside(share: f64, lively: f64, held: [f64; 2]) -> f64 {
    let [over, under] = [share - held[1], held[0] * lively - share];
    // Quicker than the larger of two, which minds what is no number.
    TOO_MUCH * if over > 0.0 { over } else { 0.0 } + if under > 0.0 { under } else { 0.0 }
}

/// How well a stream keeps to a rate.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Judgement {
    /// Windows that cost more or less than promised.
    pub missed: u64,
    /// Largest shares too much, and too little for what moves in a window; none if not above 0.
    pub over: f64,
    pub under: f64,
}

/// Least and most kilobits per second of any window; none if the clip is too short for one.
pub(super) fn extremes(ticks: &[u64], bits: &[u64], rate: f64) -> Option<[f64; 2]> {
    let windows = Windows::new(ticks, rate, 1.0);
    let rates = windows.all_sums(bits).map(|sum| sum / windows.bits);
    rates.fold(None, |found, rate| {
        Some(found.map_or([rate; 2], |[least, most]: [f64; 2]| [least.min(rate), most.max(rate)]))
    })
}

/// The sum over a span that moves on.
#[derive(Default)]
struct Running {
    span: Range<usize>,
    sum: f64,
}

impl Running {
    /// The empty span that begins with this frame.
    fn at(frame: usize) -> Self {
        Self { span: frame..frame, sum: 0.0 }
    }

    fn move_to(&mut self, span: &Range<usize>, value: impl Fn(usize) -> f64) {
        self.sum += (self.span.end..span.end).map(&value).sum::<f64>();
        self.sum -= (self.span.start..span.start).map(&value).sum::<f64>();
        self.span = span.clone();
    }
}

/// Frames in which there is less to say than a rate of so many bits a tick has room for, and the share that P planes have
/// of it.
fn resting(clip: &Clip, options: &PlanOptions, per_tick: f64) -> Result<(Vec<bool>, f64), EncodeError> {
    let mut finest = Plans::rounded(clip, options, *QUANTS.start())?;
    finest.skip = true;
    let mut bits = finest.write(clip, options)?.1.frame_bits;
    let intra: u64 =
        (0..clip.periods()).map(|index| std::mem::take(&mut bits[clip.period(index).start])).sum();
    let ticks = &clip.ticks;
    let end = ticks.last().map_or(1, |last| last + 1);
    let predicted = 1.0 - intra as f64 / end as f64 / per_tick;
    let half = (0.5 * options.rate.per_second()) as u64;
    let mut sums = Running::default();
    let rests = ticks.iter().map(|&tick| {
        let span = ticks.partition_point(|&other| other + half < tick)
            ..ticks.partition_point(|&other| other <= tick + half);
        sums.move_to(&span, |frame| bits[frame] as f64);
        sums.sum < RESTS * predicted * per_tick * span.len() as f64
    });
    Ok((rests.collect(), predicted))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filler_lifts_windows_that_cost_too_little_and_no_other_above_its_band() {
        let ticks: Vec<u64> = (0..900).collect();
        let windows = Windows::new(&ticks, 30.0, 1.0);
        // A pause in the middle, a burst behind it, and every third frame left out.
        let bits: Vec<u64> = (0..900)
            .map(|frame| match frame {
                _ if frame % 3 == 2 => 0,
                400..460 => 30,
                460..520 => 58,
                _ => 50,
            })
            .collect();
        assert!(windows.judge(&bits).missed > 0);
        let filler = windows.filler(&bits);
        let filled: Vec<u64> =
            bits.iter().zip(&filler).map(|(bits, planes)| bits + 3 * u64::from(*planes)).collect();
        let judgement = windows.judge(&filled);
        assert_eq!(judgement.missed, 0, "{judgement:?}");
        assert!(bits.iter().zip(&filler).all(|(&bits, &planes)| bits > 0 || planes == 0));
        let spent: u64 = filled.iter().sum::<u64>() - bits.iter().sum::<u64>();
        assert!(spent < 600, "{spent}");
        assert!(windows.filler(&filled).iter().all(|&planes| planes == 0));
    }
}
