//! How far fingertips are off.

use std::collections::VecDeque;

use handcast_fba::DecoderOptions;
use handcast_fba::bap::BapFrame;
use handcast_fba::plan::{ClipFrames, PlanOptions, TimedBapFrame};
use handcast_hand::{ClipHand, Finger, HandPose, Joint, Morphology, Side, Skeleton, TimedPose};

use crate::decoder::{PoseDecoder, PoseDecoderOptions};
use crate::error::StreamToPosesError;
use crate::mapping::{Profile, pose_from_frame};

/// How far the fingertips of decoded hands are from those of the poses that were encoded, over all fingers and frames. Where
/// a person's sizes are not known they are taken on the mean hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct TipError {
    /// Millimetres on average.
    pub mean_mm: f64,
    /// Millimetres that 99 of 100 stay below, to 1 %.
    pub p99_mm: f64,
    /// Millimetres at most.
    pub max_mm: f64,
}

/// Distances counted by size, in constant memory.
#[derive(Clone, Debug)]
struct Tally {
    count: u64,
    /// Metres.
    sum: f64,
    max: f32,
    /// Distances by the leading bits of their `f32`, from [`Self::LEAST`] on.
    bins: Vec<u64>,
}

impl Tally {
    /// Bits of an `f32` that a bin leaves open: bins are 1/128 of a power of two wide.
    const OPEN: u32 = 16;
    /// Metres from which on, and below which, bins tell sizes apart: 2⁻²⁰ and 2⁴.
    const LEAST: f32 = 1.0 / (1 << 20) as f32;
    const MOST: f32 = 16.0;

    fn new() -> Self {
        Self { count: 0, sum: 0.0, max: 0.0, bins: vec![0; Self::bin(Self::MOST) + 1] }
    }

    fn bin(metres: f32) -> usize {
        let place = |metres: f32| (metres.to_bits() >> Self::OPEN) as usize;
        place(metres.clamp(Self::LEAST, Self::MOST)) - place(Self::LEAST)
    }

    fn add(&mut self, metres: f32) {
        self.count += 1;
        self.sum += f64::from(metres);
        self.max = self.max.max(metres);
        self.bins[Self::bin(metres)] += 1;
    }

    /// The upper edge of the bin of the distance that this many are not above, metres.
    fn upper(&self, rank: u64) -> f32 {
        let mut below = 0;
        let found = self.bins.iter().position(|bin| {
            below += bin;
            below > rank
        });
        let first = Self::LEAST.to_bits() >> Self::OPEN;
        let edge = |bin: usize| f32::from_bits((first + bin as u32 + 1) << Self::OPEN);
        found.map_or(self.max, edge).min(self.max)
    }

    fn error(&self) -> Option<TipError> {
        let last = self.count.checked_sub(1)?;
        let [p99, max] = [self.upper(last * 99 / 100), self.max].map(|metres| 1e3 * f64::from(metres));
        Some(TipError { mean_mm: 1e3 * self.sum / self.count as f64, p99_mm: p99, max_mm: max })
    }
}

/// Fingertips, metres in the camera's frame.
type Tips = [[f32; 3]; 5];

/// Bytes of a stream that the decoder is given at a time.
const PIECE: usize = 1 << 12;

/// Decodes a stream while it is made and compares fingertips.
#[derive(Clone, Debug)]
pub(crate) struct TipMeter {
    profile: Profile,
    rate: f64,
    skeletons: [Skeleton; 2],
    decoder: PoseDecoder,
    /// Ticks that have not been decoded, and the fingertips of each hand.
    waiting: VecDeque<(u64, [Option<Tips>; 2])>,
    off: Tally,
}

impl TipMeter {
    pub fn new(plan: &PlanOptions, profile: Profile, sizes: &[ClipHand]) -> Self {
        let skeletons = [Side::Left, Side::Right].map(|side| {
            let told = sizes.iter().find(|hand| hand.side == side);
            let sizes = told.and_then(|hand| hand.morphology.clone()).filter(|m| m.validate().is_ok());
            Skeleton::new(&sizes.unwrap_or_else(Morphology::default), side)
        });
        let options = DecoderOptions { steps: plan.steps, ranges: plan.ranges, ..DecoderOptions::default() };
        let options = PoseDecoderOptions::default().with_decoder(options).with_profile(Some(profile));
        let decoder = PoseDecoder::new(options);
        let rate = plan.rate.per_second();
        Self { profile, rate, skeletons, decoder, waiting: VecDeque::new(), off: Tally::new() }
    }

    /// Takes in what was encoded.
    pub fn sent(&mut self, frame: &TimedBapFrame) {
        let tips = [Side::Left, Side::Right].map(|side| self.tips_of(&frame.baps, side));
        self.waiting.push_back(((frame.time * self.rate).round() as u64, tips));
    }

    fn tips_of(&self, frame: &BapFrame, side: Side) -> Option<Tips> {
        pose_from_frame(frame, side, self.profile).map(|pose| self.tips(&pose))
    }

    fn tips(&self, pose: &HandPose) -> Tips {
        let frames = self.skeletons[pose.side as usize].frames(pose);
        Finger::ALL.map(|finger| frames.position(Joint::tip(finger)).coords.map(|v| v as f32).into())
    }

    /// Takes in what it became.
    ///
    /// # Errors
    /// As [`PoseDecoder::push`]: none in what an encoder made.
    pub fn coded(&mut self, bytes: &[u8]) -> Result<(), StreamToPosesError> {
        let poses = self.decoder.push(bytes)?;
        self.compare(&poses);
        Ok(())
    }

    fn compare(&mut self, poses: &[TimedPose]) {
        for pose in poses {
            let tick = (pose.time * self.rate).round() as u64;
            while self.waiting.front().is_some_and(|(waiting, _)| *waiting < tick) {
                self.waiting.pop_front();
            }
            let Some((_, wanted)) = self.waiting.front().filter(|(waiting, _)| *waiting == tick) else {
                continue;
            };
            let Some(wanted) = wanted[pose.pose.side as usize] else { continue };
            let off = |(a, b): ([f32; 3], [f32; 3])| {
                a.into_iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt()
            };
            let tips = self.tips(&pose.pose);
            wanted.into_iter().zip(tips).map(off).for_each(|metres| self.off.add(metres));
        }
    }

    /// Takes in the end of a stream, and what was encoded as far as [`Self::sent`] has not been told.
    ///
    /// # Errors
    /// As [`Self::coded`].
    pub fn coded_frames(&mut self, bytes: &[u8], frames: &ClipFrames) -> Result<(), StreamToPosesError> {
        let mut frames = frames.iter();
        for piece in bytes.chunks(PIECE) {
            for pose in self.decoder.push(piece)? {
                let tick = (pose.time * self.rate).round() as u64;
                while self.waiting.back().is_none_or(|(waiting, _)| *waiting < tick) {
                    let Some(frame) = frames.next() else { break };
                    self.sent(&frame);
                }
                self.compare(std::slice::from_ref(&pose));
            }
        }
        frames.for_each(|frame| self.sent(&frame));
        Ok(())
    }

    /// What came of it; none if no hand was decoded.
    pub fn finish(mut self) -> Option<TipError> {
        // A stream without a hand has no fingertips.
        let poses = self.decoder.finish().unwrap_or_default();
        self.compare(&poses);
        self.off.error()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_tally_tells_what_sorting_does() {
        let mut metres: Vec<f32> =
            (0u32..5003).map(|n| 1e-7 * 1.004f32.powf((n * 2741 % 5003) as f32)).collect();
        let mut tally = Tally::new();
        assert_eq!(tally.error(), None);
        metres.iter().for_each(|&m| tally.add(m));
        metres.sort_by(f32::total_cmp);
        let told = tally.error().unwrap();
        let mean = metres.iter().map(|&m| f64::from(m)).sum::<f64>() / 5.003;
        assert!((told.mean_mm / mean - 1.0).abs() < 1e-9);
        assert_eq!(told.max_mm, 1e3 * f64::from(metres[5002]));
        for (rank, &exact) in
            metres.iter().enumerate().filter(|(_, m)| (Tally::LEAST..Tally::MOST).contains(*m))
        {
            let upper = tally.upper(rank as u64);
            assert!((1.0..=1.0 + 1.0 / 128.0).contains(&(upper / exact)), "{rank}: {exact} {upper}");
        }
    }
}
