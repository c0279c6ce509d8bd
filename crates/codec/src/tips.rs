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
    /// Millimetres that 99 of 100 stay below.
    pub p99_mm: f64,
    /// Millimetres at most.
    pub max_mm: f64,
}

impl TipError {
    fn of(mut metres: Vec<f32>) -> Option<Self> {
        let last = metres.len().checked_sub(1)?;
        let sum: f64 = metres.iter().copied().map(f64::from).sum();
        let max = metres.iter().copied().fold(0.0, f32::max);
        let (_, p99, _) = metres.select_nth_unstable_by(last * 99 / 100, f32::total_cmp);
        let [p99, max] = [*p99, max].map(|metres| 1e3 * f64::from(metres));
        Some(Self { mean_mm: 1e3 * sum / (last + 1) as f64, p99_mm: p99, max_mm: max })
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
    /// Metres.
    off: Vec<f32>,
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
        Self { profile, rate, skeletons, decoder, waiting: VecDeque::new(), off: Vec::new() }
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
            self.off.extend(wanted.into_iter().zip(self.tips(&pose.pose)).map(off));
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
        TipError::of(self.off)
    }
}
