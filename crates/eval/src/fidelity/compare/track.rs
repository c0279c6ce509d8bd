//! The poses of one hand over time, and what they are at an instant.

use super::{Extent, SAME_TIME};
use handcast_hand::{HandPose, PoseClip, Side, TimedPose};

/// One hand of a motion, with times from the motion's first frame.
pub(super) struct Track<'a> {
    pub(super) poses: Vec<&'a TimedPose>,
    start: f64,
    /// Half an interval; as good as nothing for keyed motions.
    slack: f64,
    /// Whether it is defined between its poses.
    keyed: bool,
    /// Whether its times are uneven beside the other motion's even ones.
    uneven: bool,
    /// Whether it is interpolated at an instant, and not the nearest pose taken.
    interpolated: bool,
}

/// Longest gap that dropped frames leave, seconds: where there are poses after a longer one, they were missing.
const LONGEST_GAP: f64 = 1.0;

/// What a track has at an instant.
pub(super) enum Found {
    Pose(Box<HandPose>),
    Lost,
    Nothing,
}

impl<'a> Track<'a> {
    /// One of two motions of the same rate, or not; with times that are `uneven` beside even ones, or not.
    pub(super) fn new(
        clip: &'a PoseClip,
        side: Side,
        extent: Extent,
        [same_rate, uneven]: [bool; 2],
    ) -> Self {
        let slack = extent.rate.map_or(1e-3, |rate| 0.5 / rate + 1e-6);
        Self {
            poses: clip.of(side).collect(),
            start: extent.start,
            slack,
            keyed: extent.rate.is_none(),
            uneven,
            interpolated: uneven || !same_rate,
        }
    }

    /// Whether it is interpolated at the instants of another motion that is not.
    pub(super) fn follows(&self) -> bool {
        self.keyed || self.uneven
    }

    pub(super) fn time(&self, index: usize) -> f64 {
        self.poses.get(index).map_or(f64::INFINITY, |p| p.time - self.start)
    }

    /// The nearest pose, at most half an interval away.
    fn nearest(&self, time: f64) -> Found {
        let after = self.poses.partition_point(|p| p.time - self.start <= time);
        let distance = |i: usize| (self.time(i) - time).abs();
        let before = after.saturating_sub(1);
        let index = if distance(after) < distance(before) { after } else { before };
        match self.poses.get(index) {
            Some(pose) if distance(index) <= self.slack => match pose.valid {
                true => Found::Pose(Box::new(pose.pose.clone())),
                false => Found::Lost,
            },
            _ => Found::Nothing,
        }
    }

    /// The pose at an instant between two poses.
    fn between(&self, time: f64) -> Found {
        let after = self.poses.partition_point(|p| p.time - self.start <= time);
        let (Some(a), b) = (self.poses.get(after.saturating_sub(1)), self.poses.get(after)) else {
            return Found::Nothing;
        };
        let near = |p: &TimedPose| (p.time - self.start - time).abs() <= self.slack;
        match b {
            Some(b) if after > 0 => {
                // Times of glTF are 32-bit: a key is meant where it nearly is.
                let s = ((time - self.time(after - 1)) / (b.time - a.time)).clamp(0.0, 1.0);
                let at = |pose: &TimedPose| (pose.time - self.start - time).abs() < SAME_TIME;
                match (a.valid, b.valid) {
                    (true, false) if at(a) => Found::Pose(Box::new(a.pose.clone())),
                    (false, true) if at(b) => Found::Pose(Box::new(b.pose.clone())),
                    (true, true) => Found::Pose(Box::new(a.pose.interpolated(&b.pose, s))),
                    _ => Found::Lost,
                }
            }
            _ if !near(a) => Found::Nothing,
            _ if !a.valid => Found::Lost,
            _ => Found::Pose(Box::new(a.pose.clone())),
        }
    }

    pub(super) fn at(&self, time: f64) -> Found {
        if self.interpolated { self.between(time) } else { self.nearest(time) }
    }

    /// Frames for which `other` has nothing at all. A lost one, and one in a gap of it that holds the pose before it, as
    /// decoders do where frames were skipped, tell nothing that could be missing.
    pub(super) fn without(&self, other: &Track) -> usize {
        if self.keyed {
            return 0;
        }
        let in_gap = |time: f64| {
            let after = other.poses.partition_point(|p| p.time - other.start <= time);
            after > 0 && other.time(after) - other.time(after - 1) <= LONGEST_GAP
        };
        let holds = |i: usize| {
            let before = i.checked_sub(1).and_then(|before| self.poses.get(before));
            let same = |(a, b): (&&TimedPose, &&TimedPose)| a.valid == b.valid && a.pose == b.pose;
            in_gap(self.time(i)) && before.zip(self.poses.get(i)).is_some_and(same)
        };
        // Ticks end before the last of uneven times.
        let near =
            |time: f64| self.uneven && matches!(other.at(time - self.slack), Found::Pose(_) | Found::Lost);
        let nothing = |time: f64| matches!(other.at(time), Found::Nothing) && !near(time);
        let missing = |i: &usize| nothing(self.time(*i)) && !holds(*i);
        (0..self.poses.len()).filter(|&i| self.poses[i].valid).filter(missing).count()
    }
}
