//! Frames of BAPs with their times.

use super::{BAP_COUNT, Bap, BapFrame, BapMask};

/// A frame and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedBapFrame {
    /// Seconds.
    pub time: f64,
    /// The values.
    pub baps: BapFrame,
}

/// Many frames in little memory: of each the values that are given or not 0, and masks once where they do not change.
///
/// ```
/// use handcast_fba::bap::{Bap, BapFrames, TimedBapFrame};
///
/// let bend = Bap::from_name("r_index1_flexion").unwrap();
/// let frame = |n: i32| TimedBapFrame { time: f64::from(n) / 30.0, baps: [(bend, -100 * n)].into_iter().collect() };
/// let frames: BapFrames = (0..90).map(frame).collect();
/// assert_eq!(frames.len(), 90);
/// assert!(frames.iter().eq((0..90).map(frame)));
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BapFrames {
    runs: Vec<Run>,
    /// Seconds.
    times: Vec<f64>,
    /// Values of [`Run::kept`], frame by frame, in ascending order of number.
    values: Vec<i32>,
}

/// Frames one behind the other that are kept alike.
#[derive(Clone, Debug, PartialEq)]
struct Run {
    frames: usize,
    mask: BapMask,
    /// BAPs whose values are kept: those given, and others that are not 0 in the first of the frames.
    kept: BapMask,
}

impl BapFrames {
    /// Number of frames.
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// Adds a frame behind the others.
    pub fn push(&mut self, frame: &TimedBapFrame) {
        let baps = &frame.baps;
        let told = baps.values().iter().filter(|value| **value != 0).count();
        let holds = |kept: &BapMask| told == kept.iter().filter(|bap| baps.value(*bap) != 0).count();
        match self.runs.last_mut() {
            Some(run) if run.mask == baps.mask && holds(&run.kept) => run.frames += 1,
            _ => {
                let others = Bap::all().filter(|bap| baps.value(*bap) != 0);
                let kept = baps.mask.union(&others.collect());
                self.runs.push(Run { frames: 1, mask: baps.mask, kept });
            }
        }
        self.times.push(frame.time);
        let kept = self.runs.last().map_or(BapMask::EMPTY, |run| run.kept);
        self.values.extend(kept.iter().map(|bap| baps.value(bap)));
    }

    /// The frames in order.
    pub fn iter(&self) -> Iter<'_> {
        Iter { runs: self.runs.iter(), run: None, left: 0, times: self.times.iter(), values: &self.values }
    }

    /// Seconds of the frames in order.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// The BAPs that any of the frames gives.
    pub fn mask(&self) -> BapMask {
        self.runs.iter().fold(BapMask::EMPTY, |mask, run| mask.union(&run.mask))
    }
}

impl FromIterator<TimedBapFrame> for BapFrames {
    fn from_iter<I: IntoIterator<Item = TimedBapFrame>>(frames: I) -> Self {
        let mut all = Self::default();
        all.extend(frames);
        all
    }
}

impl Extend<TimedBapFrame> for BapFrames {
    fn extend<I: IntoIterator<Item = TimedBapFrame>>(&mut self, frames: I) {
        frames.into_iter().for_each(|frame| self.push(&frame));
    }
}

impl<'a> IntoIterator for &'a BapFrames {
    type Item = TimedBapFrame;
    type IntoIter = Iter<'a>;

    fn into_iter(self) -> Iter<'a> {
        self.iter()
    }
}

/// Goes through [`BapFrames`].
#[derive(Clone, Debug)]
pub struct Iter<'a> {
    runs: std::slice::Iter<'a, Run>,
    run: Option<&'a Run>,
    /// Frames of the run that are still to come.
    left: usize,
    times: std::slice::Iter<'a, f64>,
    values: &'a [i32],
}

impl Iterator for Iter<'_> {
    type Item = TimedBapFrame;

    fn next(&mut self) -> Option<TimedBapFrame> {
        let time = *self.times.next()?;
        if self.left == 0 {
            self.run = self.runs.next();
            self.left = self.run.map_or(0, |run| run.frames);
        }
        self.left = self.left.saturating_sub(1);
        let run = self.run?;
        let mut values = [0; BAP_COUNT];
        let mut kept = 0;
        for (bap, &value) in run.kept.iter().zip(self.values) {
            values[bap.index()] = value;
            kept += 1;
        }
        self.values = self.values.get(kept..).unwrap_or_default();
        Some(TimedBapFrame { time, baps: BapFrame::with_values(run.mask, values) })
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        self.times.size_hint()
    }
}

impl ExactSizeIterator for Iter<'_> {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_goes_in_comes_out(frames in proptest::collection::vec(
            (proptest::collection::vec((0..BAP_COUNT, -2..3i32, any::<bool>()), 0..6), 1..4usize), 0..12,
        )) {
            let mut all = Vec::new();
            for (entries, times) in frames {
                let (mut mask, mut values) = (BapMask::EMPTY, [0; BAP_COUNT]);
                for (index, value, on) in entries {
                    values[index] = value;
                    mask.set(Bap::from_index(index).unwrap(), on);
                }
                for time in 0..times {
                    values.iter_mut().filter(|value| **value != 0).for_each(|value| *value += time as i32);
                    all.push(TimedBapFrame { time: all.len() as f64, baps: BapFrame::with_values(mask, values) });
                }
            }
            let packed: BapFrames = all.iter().copied().collect();
            prop_assert_eq!((packed.len(), packed.iter().len()), (all.len(), all.len()));
            prop_assert_eq!(packed.mask(), all.iter().fold(BapMask::EMPTY, |mask, f| mask.union(&f.baps.mask)));
            prop_assert!(packed.iter().eq(all));
        }
    }
}
