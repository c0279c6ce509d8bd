//! Short gaps in a motion, bridged: where a hand was lost for a moment, or pictures were dropped, it goes from the pose before
//! to the one behind. What comes before the first valid pose, behind the last one and in longer gaps stays as it is.

use std::collections::VecDeque;

use crate::clip::{Absence, PoseClip, TimedPose};
use crate::pose::Side;

/// Longest gap that is bridged where nothing else is said, from one valid pose to the next, seconds: there fingertips are 10 mm
/// from where they were on average, half as far as with the pose before held (`handcast bench gaps`).
pub const MAX_GAP: f64 = 0.25;
/// How much longer a gap may seem by the rounding of its times, seconds.
const ROUNDING: f64 = 1e-6;
/// How near another hand's time must be for a pose to be put at it, frames.
const BESIDE: f64 = 0.25;

/// The poses of one hand, with short gaps bridged.
#[derive(Clone, Debug)]
pub struct Bridged<'a, I> {
    poses: I,
    /// Seconds between frames.
    step: f64,
    max_gap: f64,
    /// Times of all hands, at which added poses are put.
    times: &'a [f64],
    /// The last valid pose.
    before: Option<TimedPose>,
    /// Poses that go out next, and those of a gap that is not over.
    ready: VecDeque<TimedPose>,
    gap: VecDeque<TimedPose>,
}

impl<'a, I: Iterator<Item = TimedPose>> Bridged<'a, I> {
    /// Bridges gaps in `poses`, those of one hand in order of time. Between two valid ones at most `max_gap` seconds apart those
    /// that are not valid get the pose on the way (angles and place linear, rotation on the great circle), and so do frames
    /// without any, `step` seconds each. They stay not valid, as [`Absence::Bridged`]; those that are added have confidence 0
    /// where the others have one. With a `max_gap` of 0 all poses stay as they are.
    pub fn new(poses: I, step: f64, max_gap: f64) -> Self {
        let (ready, gap) = (VecDeque::new(), VecDeque::new());
        Self { poses, step, max_gap, times: &[], before: None, ready, gap }
    }

    /// Takes the next pose, and lets go of what is known then; false where there are no more.
    fn take(&mut self) -> bool {
        let Some(pose) = self.poses.next() else {
            self.ready.append(&mut self.gap);
            return false;
        };
        let near = |before: &TimedPose| {
            pose.time > before.time && pose.time - before.time <= self.max_gap + ROUNDING
        };
        let near = self.before.as_ref().is_some_and(near);
        if !pose.valid && near {
            self.gap.push_back(pose);
            return true;
        }
        if let (true, Some(before)) = (near, &self.before) {
            let (step, times) = (self.step, self.times);
            let mut last = before.time;
            for lost in self.gap.drain(..) {
                add(before, [last, lost.time], &pose, step, times, &mut self.ready);
                last = lost.time;
                self.ready.push_back(between(before, &pose, lost));
            }
            add(before, [last, pose.time], &pose, step, times, &mut self.ready);
        } else {
            self.ready.append(&mut self.gap);
        }
        if pose.valid {
            self.before = Some(pose.clone());
        }
        self.ready.push_back(pose);
        true
    }
}

impl<I: Iterator<Item = TimedPose>> Iterator for Bridged<'_, I> {
    type Item = TimedPose;

    fn next(&mut self) -> Option<TimedPose> {
        if self.max_gap <= 0.0 {
            return self.poses.next();
        }
        while self.ready.is_empty() && self.take() {}
        self.ready.pop_front()
    }
}

/// Adds poses for the frames that are missing between two times.
fn add(
    before: &TimedPose,
    [from, to]: [f64; 2],
    behind: &TimedPose,
    step: f64,
    times: &[f64],
    out: &mut VecDeque<TimedPose>,
) {
    let frames = ((to - from) / step).round();
    for frame in 1..frames as usize {
        let time = from + (to - from) * frame as f64 / frames;
        let at = times.partition_point(|other| *other < time);
        let beside = [at.checked_sub(1), Some(at)].into_iter().flatten().filter_map(|at| times.get(at));
        let beside = beside.copied().min_by(|a, b| (a - time).abs().total_cmp(&(b - time).abs()));
        let time = beside.filter(|other| (other - time).abs() < BESIDE * step).unwrap_or(time);
        let mut added = TimedPose::lost(time, before.pose.side);
        added.confidence = before.confidence.and(behind.confidence).map(|_| 0.0);
        out.push_back(between(before, behind, added));
    }
}

/// A pose that is not valid, on the way between two that are.
fn between(before: &TimedPose, behind: &TimedPose, lost: TimedPose) -> TimedPose {
    let share = (lost.time - before.time) / (behind.time - before.time);
    let pose = before.pose.interpolated(&behind.pose, share.clamp(0.0, 1.0));
    TimedPose { pose, why: Some(Absence::Bridged), ..lost }
}

impl PoseClip {
    /// The clip with short gaps of its hands bridged ([`Bridged`]): frames are those of `rate` a second; what is added is at the
    /// time of the other hand's pose where that is near.
    #[must_use]
    pub fn bridged(&self, rate: f64, max_gap: f64) -> Self {
        let mut times: Vec<f64> = self.frames.iter().map(|frame| frame.time).collect();
        times.sort_by(f64::total_cmp);
        let mut frames: Vec<TimedPose> = [Side::Left, Side::Right]
            .into_iter()
            .flat_map(|side| Bridged {
                times: &times,
                ..Bridged::new(self.of(side).cloned(), 1.0 / rate, max_gap)
            })
            .collect();
        if frames.iter().all(|frame| frame.why != Some(Absence::Bridged)) {
            return self.clone();
        }
        frames.sort_by(|a, b| a.time.total_cmp(&b.time));
        Self { header: self.header.clone(), frames }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HandPose, JointAngle, PoseHeader};
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    const RATE: f64 = 30.0;

    /// A hand that moves, turns and bends evenly, each by so much a frame.
    fn at(frame: usize, side: Side) -> TimedPose {
        let by = frame as f64;
        let mut pose = HandPose::neutral(side).with_degrees(JointAngle::Index2Flexion, by);
        pose.translation = Vector3::new(0.01 * by, 0.0, -0.5);
        pose.rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.02 * by);
        TimedPose { confidence: Some(0.8), ..TimedPose::new(by / RATE, pose) }
    }

    fn clip(frames: impl IntoIterator<Item = TimedPose>) -> PoseClip {
        PoseClip {
            header: PoseHeader::one(Side::Right, None, Some(RATE)),
            frames: frames.into_iter().collect(),
        }
    }

    fn is_on_the_way(pose: &TimedPose) -> bool {
        let expected = at((pose.time * RATE).round() as usize, pose.pose.side).pose;
        pose.pose.rotation.angle_to(&expected.rotation) < 1e-9
            && (pose.pose.translation - expected.translation).norm() < 1e-9
            && pose.pose.angles.iter().zip(&expected.angles).all(|(a, b)| (a - b).abs() < 1e-9)
    }

    #[test]
    fn what_is_lost_or_missing_for_a_moment_is_on_the_way() {
        let mut gaps = clip((0..30).map(|i| at(i, Side::Right)));
        for i in [0, 10, 11, 20, 29] {
            gaps.frames[i] =
                TimedPose { why: Some(Absence::Lost), ..TimedPose::lost(i as f64 / RATE, Side::Right) };
        }
        // Frames 5, 6 and 12 are missing, too: 10 to 12 are one gap of both kinds.
        gaps.frames.retain(|frame| ![5, 6, 12].contains(&((frame.time * RATE).round() as usize)));
        let whole = gaps.bridged(RATE, MAX_GAP);
        assert_eq!(whole.frames.len(), 30);
        for (i, frame) in whole.frames.iter().enumerate() {
            assert!((frame.time * RATE - i as f64).abs() < 1e-9, "{i}");
            let bridged = [5, 6, 10, 11, 12, 20].contains(&i);
            let lost = [0, 29].contains(&i);
            let why = if bridged { Some(Absence::Bridged) } else { lost.then_some(Absence::Lost) };
            assert_eq!((frame.valid, frame.why), (!bridged && !lost, why), "{i}");
            assert!(lost || is_on_the_way(frame), "{i}");
            // What its maker said stays.
            let added = [5, 6, 12].contains(&i);
            let confidence = if added { Some(0.0) } else { (!bridged && !lost).then_some(0.8) };
            assert_eq!(frame.confidence, confidence, "{i}");
        }
    }

    #[test]
    fn longer_gaps_stay() {
        for (missing, bridged) in [(6, true), (7, false)] {
            let gap = clip((0..30).filter(|i| !(10..10 + missing).contains(i)).map(|i| at(i, Side::Right)));
            assert_eq!(gap.bridged(RATE, MAX_GAP).frames.len() == 30, bridged);
            assert!(gap.bridged(RATE, MAX_GAP) == gap || bridged);
            assert_eq!(gap.bridged(RATE, 0.0), gap);
            let mut lost = clip((0..30).map(|i| at(i, Side::Right)));
            lost.frames[10..10 + missing].iter_mut().for_each(|frame| frame.valid = false);
            let whole = lost.bridged(RATE, MAX_GAP);
            assert_eq!(whole != lost, bridged);
        }
        // Six frames of 24 a second are a quarter of a second, whatever rounding does.
        let slow = |i: usize| TimedPose { time: 100.0 + i as f64 / 24.0, ..at(i, Side::Right) };
        let gap = clip((0..20).filter(|i| !(5..10).contains(i)).map(slow));
        assert_eq!(gap.bridged(24.0, MAX_GAP).frames.len(), 20);
    }

    #[test]
    fn added_poses_are_at_the_times_of_the_other_hand() {
        let late = |i: usize| 0.004 * (i % 2) as f64;
        let timed = |i: usize, side: Side| TimedPose { time: i as f64 / RATE + late(i), ..at(i, side) };
        let both = clip((0..20).flat_map(|i| [timed(i, Side::Left), timed(i, Side::Right)]));
        let mut gaps = both.clone();
        gaps.frames.retain(|frame| frame.pose.side == Side::Right || !(0.31..0.41).contains(&frame.time));
        assert_eq!(gaps.frames.len(), 37);
        let whole = gaps.bridged(RATE, MAX_GAP);
        assert!(
            whole
                .frames
                .iter()
                .map(|f| (f.time, f.pose.side))
                .eq(both.frames.iter().map(|f| (f.time, f.pose.side)))
        );
    }

    proptest! {
        /// Valid poses stay as they are and where they are, and nothing is added before, behind or in long gaps.
        #[test]
        fn nothing_valid_changes(
            kinds in prop::collection::vec(0u8..3, 0..60),
            max_gap in 0.0..0.5,
        ) {
            let pose = |(i, kind): (usize, &u8)| match kind {
                0 => Some(at(i, Side::Right)),
                1 => Some(TimedPose { valid: false, ..at(2 * i, Side::Right) }).map(|p| TimedPose { time: i as f64 / RATE, ..p }),
                _ => None,
            };
            let gaps = clip(kinds.iter().enumerate().filter_map(pose));
            let whole = gaps.bridged(RATE, max_gap);
            let valid = |clip: &PoseClip| clip.frames.iter().filter(|f| f.valid).cloned().collect::<Vec<_>>();
            prop_assert_eq!(valid(&whole), valid(&gaps));
            let seen: Vec<f64> = gaps.frames.iter().filter(|f| f.valid).map(|f| f.time).collect();
            let mut times = whole.frames.iter().map(|f| f.time);
            prop_assert!(times.clone().zip(times.by_ref().skip(1)).all(|(a, b)| b - a > 0.9 / RATE));
            for frame in whole.frames.iter().filter(|f| !f.valid) {
                let at = seen.partition_point(|time| *time < frame.time);
                let near = at > 0 && at < seen.len() && seen[at] - seen[at - 1] <= max_gap + ROUNDING;
                prop_assert_eq!(frame.why == Some(Absence::Bridged), near);
                prop_assert!(!near || is_on_the_way(frame));
                prop_assert!(near || gaps.frames.contains(frame));
            }
            // No frame is left between two that are bridged.
            for pair in seen.windows(2).filter(|pair| pair[1] - pair[0] <= max_gap + ROUNDING) {
                let inside = whole.frames.iter().filter(|f| f.time > pair[0] && f.time < pair[1]).count();
                prop_assert_eq!(inside, ((pair[1] - pair[0]) * RATE).round() as usize - 1);
            }
        }
    }
}
