//! A clip on the ticks of a stream's clock, cut into I periods.

use super::super::error::EncodeError;
use super::super::state::step;
use super::super::syntax::{FrameRate, MAX_RANGE_CODE, range_levels};
use super::options::{NO_FRAMES, PlanOptions};
use crate::bap::{BAP_COUNT, Bap, BapFrame, BapMask, StepTable, TimedBapFrame};

/// Puts frames on the ticks of a stream's clock, the first of them on tick 0.
#[derive(Clone, Debug)]
pub(super) struct Ticker {
    /// Frames per second.
    rate: f64,
    /// Time of the first frame.
    first: Option<f64>,
    last: Option<u64>,
    /// Time of the last frame.
    time: f64,
    /// Frames given, those refused included.
    given: u64,
}

/// Ticks between two frames, at most: what a decoder accepts as skipped frames.
pub const MAX_GAP: u64 = 65_535;

impl Ticker {
    pub fn new(rate: FrameRate) -> Self {
        Self { rate: rate.per_second(), first: None, last: None, time: 0.0, given: 0 }
    }

    /// The tick that a frame of this time is nearest to, and the one that it gets: times that jitter may put two frames on one tick;
    /// the second then moves to the next.
    fn placed(&self, time: f64) -> (f64, f64) {
        let wanted = ((time - self.first.unwrap_or(time)) * self.rate).round();
        (wanted, self.last.map_or(0.0, |last| wanted.max(last as f64 + 1.0)))
    }

    /// Whether there is no tick for a frame that comes behind the last one, since frames come faster than ticks.
    pub fn is_ahead(&self, time: f64) -> bool {
        let (wanted, tick) = self.placed(time);
        self.last.is_some() && time > self.time && tick - wanted > 1.0
    }

    /// Tick of the frame that comes next.
    pub fn tick(&mut self, time: f64) -> Result<u64, EncodeError> {
        let frame = self.given;
        self.given += 1;
        let refused = |allowed| Err(EncodeError::Time { frame, time, allowed });
        if !time.is_finite() {
            return refused("finite numbers");
        }
        let first = self.first.unwrap_or(time);
        let (wanted, tick) = self.placed(time);
        let gap = self.last.map_or(0.0, |last| tick - last as f64);
        if self.last.is_some() && time < self.time {
            return refused("times from that of the frame before on");
        }
        if tick - wanted > 1.0 {
            return refused("times about a tick after that of the frame before");
        }
        if gap > MAX_GAP as f64 {
            return refused("times at most 65535 ticks after that of the frame before");
        }
        (self.first, self.time) = (Some(first), time);
        self.last = Some(tick as u64);
        Ok(tick as u64)
    }

    /// Tick of the frame that came last.
    pub fn last(&self) -> Option<u64> {
        self.last
    }

    /// Length of a stream that ends with that frame.
    pub fn seconds(&self) -> f64 {
        self.last.map_or(0.0, |last| (last + 1) as f64 / self.rate)
    }
}

/// The frames of an I period, which all give the same BAPs.
#[derive(Clone, Debug)]
struct Period {
    /// Number of the first frame in the clip.
    start: usize,
    /// Whether it begins out of turn, for the sake of a leap.
    leaps: bool,
    /// BAPs given.
    mask: BapMask,
    /// The values of each of them over the period, in ascending order of number.
    columns: Box<[i32]>,
    /// BAPs of each frame that only hold a value; empty if none does.
    held: Box<[BapMask]>,
}

impl Period {
    /// A period of frames whose values lie one behind the other.
    fn new(start: usize, leaps: bool, mask: BapMask, rows: &[i32], held: &[BapMask]) -> Self {
        let width = mask.len().max(1);
        let column = |column: usize| rows.iter().copied().skip(column).step_by(width);
        let held = if held.iter().all(BapMask::is_empty) { Box::default() } else { held.into() };
        Self { start, leaps, mask, columns: (0..mask.len()).flat_map(column).collect(), held }
    }
}

/// The frames of a clip on the ticks of the stream's clock, cut into I periods.
#[derive(Clone, Debug)]
pub(super) struct Clip {
    /// Tick of each frame, from 0.
    pub ticks: Vec<u64>,
    /// Length in seconds.
    pub seconds: f64,
    periods: Vec<Period>,
}

impl Clip {
    /// Number of frames.
    pub fn len(&self) -> usize {
        self.ticks.len()
    }

    pub fn periods(&self) -> usize {
        self.periods.len()
    }

    /// Numbers of the frames of a period.
    pub fn period(&self, index: usize) -> std::ops::Range<usize> {
        let end = self.periods.get(index + 1).map_or(self.ticks.len(), |next| next.start);
        self.periods[index].start..end
    }

    /// Whether a period begins out of turn, for the sake of a leap.
    pub fn leaps(&self, index: usize) -> bool {
        self.periods[index].leaps
    }

    /// Numbers of the periods of each section: one that begins in its turn, and those behind it that begin for the sake
    /// of a leap.
    pub fn sections(&self) -> Vec<std::ops::Range<usize>> {
        let mut starts: Vec<usize> =
            (0..self.periods()).filter(|&index| !self.periods[index].leaps).collect();
        starts.push(self.periods());
        starts.windows(2).map(|pair| pair[0]..pair[1]).collect()
    }

    /// Numbers of the frames of a section.
    pub fn frames_of(&self, section: &std::ops::Range<usize>) -> std::ops::Range<usize> {
        self.period(section.start).start..self.period(section.end - 1).end
    }

    /// BAPs that the frames of a period give.
    pub fn mask(&self, index: usize) -> BapMask {
        self.periods[index].mask
    }

    /// The values of a BAP that the frames of a period give; none of any other.
    pub fn column(&self, index: usize, bap: Bap) -> &[i32] {
        let frames = self.period(index).len();
        let period = &self.periods[index];
        match period.mask.iter().position(|other| other == bap) {
            Some(column) => &period.columns[column * frames..(column + 1) * frames],
            None => &[],
        }
    }

    /// What the frame `offset` of a period gives, in ascending order of number.
    pub fn row(&self, index: usize, offset: usize) -> impl Iterator<Item = (Bap, i32)> + '_ {
        let frames = self.period(index).len();
        let period = &self.periods[index];
        period.mask.iter().zip(period.columns.iter().skip(offset).step_by(frames)).map(|(b, &v)| (b, v))
    }

    /// What the frame `offset` of a period holds of values that are not known.
    pub fn held(&self, index: usize, offset: usize) -> BapMask {
        self.periods[index].held.get(offset).copied().unwrap_or(BapMask::EMPTY)
    }

    /// A clip of `count` of its periods, evenly spread, one behind the other; none of a clip that has not more than twice
    /// as many.
    pub fn sample(&self, count: usize) -> Option<Self> {
        if self.periods() <= 2 * count {
            return None;
        }
        let (mut ticks, mut periods) = (Vec::new(), Vec::new());
        let mut next = 0;
        for index in (0..count).map(|share| (2 * share + 1) * self.periods() / (2 * count)) {
            let frames = self.period(index);
            periods.push(Period { start: ticks.len(), leaps: false, ..self.periods[index].clone() });
            let begin = self.ticks[frames.start];
            let end = self.ticks.get(frames.end).map_or(self.ticks[frames.end - 1] + 1, |&tick| tick);
            ticks.extend(self.ticks[frames].iter().map(|tick| tick - begin + next));
            next += end - begin;
        }
        let all = self.ticks.last().map_or(1, |last| last + 1);
        Some(Self { ticks, seconds: self.seconds * next as f64 / all as f64, periods })
    }

    /// The frames of a period, and what they hold.
    pub fn rows(&self, index: usize) -> impl Iterator<Item = (BapFrame, BapMask)> + '_ {
        let mask = self.periods[index].mask;
        (0..self.period(index).len()).map(move |offset| {
            let mut values = [0; BAP_COUNT];
            self.row(index, offset).for_each(|(bap, value)| values[bap.index()] = value);
            (BapFrame::with_values(mask, values), self.held(index, offset))
        })
    }

    /// All frames with their ticks, and what they hold.
    pub fn frames(&self) -> impl Iterator<Item = (u64, BapFrame, BapMask)> + '_ {
        let rows = (0..self.periods()).flat_map(|index| self.rows(index));
        self.ticks.iter().zip(rows).map(|(tick, (frame, held))| (*tick, frame, held))
    }
}

/// Gathers the frames of a clip.
#[derive(Clone, Debug)]
pub(super) struct ClipBuilder {
    steps: StepTable,
    anchors: BapMask,
    resync: bool,
    ticker: Ticker,
    /// Ticks from one I period to the next, and the tick at which the next begins at the latest.
    interval: u64,
    next_cut: u64,
    ticks: Vec<u64>,
    periods: Vec<Period>,
    /// The period that has not ended: its first frame, whether it begins with a leap, its BAPs, their values and which of
    /// them are held, frame by frame.
    start: usize,
    leaps: bool,
    mask: BapMask,
    rows: Vec<i32>,
    held: Vec<BapMask>,
}

impl ClipBuilder {
    /// As [`Ticker::is_ahead`].
    pub fn is_ahead(&self, time: f64) -> bool {
        self.ticker.is_ahead(time)
    }

    pub fn new(options: &PlanOptions) -> Self {
        let interval = (options.intra_seconds * options.rate.per_second()).round().max(1.0) as u64;
        Self {
            steps: options.steps,
            anchors: options.anchors,
            resync: options.resync,
            ticker: Ticker::new(options.rate),
            interval,
            next_cut: interval,
            ticks: Vec::new(),
            periods: Vec::new(),
            start: 0,
            leaps: false,
            mask: BapMask::EMPTY,
            rows: Vec::new(),
            held: Vec::new(),
        }
    }

    /// Takes the next frame, in which some values are only held.
    pub fn push(&mut self, frame: &TimedBapFrame, held: &BapMask) -> Result<(), EncodeError> {
        let tick = self.ticker.tick(frame.time)?;
        let first = self.ticks.is_empty();
        let changed = !first && self.mask != frame.baps.mask;
        let leaps = !first && !changed && self.jumps(&frame.baps);
        if tick >= self.next_cut || changed || leaps {
            self.end_period();
            // One that comes not long before the next is due takes its place.
            let soon = leaps && !self.resync && tick + self.interval / 2 >= self.next_cut;
            self.leaps = leaps && !soon && tick < self.next_cut;
            if soon {
                self.next_cut = tick + self.interval;
            }
            while self.next_cut <= tick {
                self.next_cut += self.interval;
            }
        }
        self.mask = frame.baps.mask;
        self.rows.extend(frame.baps.iter().map(|(_, value)| value));
        self.held.push(*held);
        self.ticks.push(tick);
        Ok(())
    }

    /// Whether a BAP changes by more than a P plane may carry, or an anchor does: the frame then begins an I period.
    /// Rotation vectors change so where they pass to the other way round.
    fn jumps(&self, frame: &BapFrame) -> bool {
        let before = &self.rows[self.rows.len() - self.mask.len()..];
        frame.iter().zip(before).any(|((bap, value), &before)| {
            let reach =
                0.9 * f64::from(range_levels(MAX_RANGE_CODE, 1)) * f64::from(step(bap, self.steps, 1));
            (f64::from(value) - f64::from(before)).abs() > reach
                || value != before && self.anchors.contains(bap)
        })
    }

    fn end_period(&mut self) {
        self.periods.push(Period::new(self.start, self.leaps, self.mask, &self.rows, &self.held));
        self.rows.clear();
        self.held.clear();
        self.start = self.ticks.len();
    }

    /// The clip of all frames.
    pub fn finish(mut self) -> Result<Clip, EncodeError> {
        if self.ticks.is_empty() {
            return Err(NO_FRAMES);
        }
        self.end_period();
        Ok(Clip { seconds: self.ticker.seconds(), ticks: self.ticks, periods: self.periods })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bap(number: u16) -> Bap {
        Bap::new(number).unwrap()
    }

    fn frame(time: f64, values: &[(u16, i32)]) -> TimedBapFrame {
        TimedBapFrame { time, baps: values.iter().map(|&(number, value)| (bap(number), value)).collect() }
    }

    /// What goes in comes out, whatever the periods are.
    #[test]
    fn frames_are_kept_period_by_period() {
        let options = PlanOptions { intra_seconds: 0.1, ..PlanOptions::default() };
        let given = [
            frame(2.0, &[(126, 5), (130, -7)]),
            frame(2.04, &[(126, 6), (130, -8)]),
            // The mask changes, a value jumps, an interval is over.
            frame(2.07, &[(130, 9)]),
            frame(2.1, &[(130, 900_000)]),
            frame(2.21, &[(130, 900_001)]),
            frame(2.24, &[]),
        ];
        let mut builder = ClipBuilder::new(&options);
        let held =
            |number: usize| if number == 1 { [bap(130)].into_iter().collect() } else { BapMask::EMPTY };
        given.iter().enumerate().for_each(|(n, frame)| builder.push(frame, &held(n)).unwrap());
        let clip = builder.finish().unwrap();
        assert_eq!(clip.ticks, [0, 1, 2, 3, 6, 7]);
        assert_eq!(clip.frames().map(|(_, baps, _)| baps).collect::<Vec<_>>(), given.map(|frame| frame.baps));
        assert!(clip.frames().enumerate().all(|(n, (.., found))| found == held(n)));
        let periods: Vec<_> = (0..clip.periods()).map(|index| clip.period(index)).collect();
        assert_eq!(periods, [0..2, 2..3, 3..4, 4..5, 5..6]);
        assert_eq!(clip.column(0, bap(130)), [-7, -8]);
        assert_eq!(clip.column(1, bap(126)), [0; 0]);
        assert_eq!(clip.mask(5 - 1), BapMask::EMPTY);
        assert_eq!(clip.sections(), [0..1, 1..2, 2..3, 3..4, 4..5]);
        assert!((clip.seconds - 8.0 / 30.0).abs() < 1e-12);
    }

    /// Another anchor begins a period out of turn, unless the next is due soon: it then begins in its place.
    #[test]
    fn leaps_share_the_section_that_they_are_in() {
        let anchors: BapMask = [bap(215)].into_iter().collect();
        for resync in [false, true] {
            let options = PlanOptions { intra_seconds: 1.0, anchors, resync, ..PlanOptions::default() };
            let mut builder = ClipBuilder::new(&options);
            for tick in 0..70 {
                let leapt = [5, 20].into_iter().filter(|&leap| leap <= tick).count();
                let given = frame(f64::from(tick) / 30.0, &[(126, tick), (215, 254 * leapt as i32)]);
                builder.push(&given, &BapMask::EMPTY).unwrap();
            }
            let clip = builder.finish().unwrap();
            let starts: Vec<usize> = (0..clip.periods()).map(|index| clip.period(index).start).collect();
            if resync {
                assert_eq!(starts, [0, 5, 20, 30, 60]);
                assert_eq!(clip.sections(), [0..3, 3..4, 4..5]);
            } else {
                assert_eq!(starts, [0, 5, 20, 50]);
                assert_eq!(clip.sections(), [0..2, 2..3, 3..4]);
            }
            assert_eq!(clip.frames_of(&clip.sections()[0]), 0..starts[clip.sections()[0].end]);
        }
    }

    #[test]
    fn two_frames_on_one_tick_part_and_leaps_are_refused() {
        let mut ticker = Ticker::new(FrameRate::ASSUMED);
        let ticks = [0.0, 0.033, 0.034, 0.1].map(|time| ticker.tick(time).unwrap());
        assert_eq!(ticks, [0, 1, 2, 3]);
        let mut refused = |time| ticker.tick(time).unwrap_err().to_string();
        assert!(refused(0.05).starts_with("the time of frame 4 is 0.05 s"));
        assert!(refused(0.099).contains("times from that of the frame before on"));
        assert!(refused(5000.0).contains("65535 ticks"));
        assert!(refused(f64::NAN).starts_with("the time of frame 7 is NaN s, allowed are finite numbers"));
        assert!(refused(f64::NEG_INFINITY).contains("finite"));
        assert_eq!(ticker.tick(0.14), Ok(4));
    }
}
