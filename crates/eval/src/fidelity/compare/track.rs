//! The poses of one hand over time, and what they are at an instant.

use super::{CompareOptions, Extent, SAME_TIME, alike};
use handcast_codec::{Gap, gaps};
use handcast_hand::{HandPose, PoseClip, Side, TimedPose, nearest_in_time};

/// One hand of a motion, with times from the motion's first frame.
pub(super) struct Track<'a> {
    pub(super) poses: Vec<&'a TimedPose>,
    /// Those of them that are valid.
    valid: Vec<&'a TimedPose>,
    /// Where poses are missing; none in keyed motions.
    gaps: Vec<Gap>,
    start: f64,
    /// Half an interval; as good as nothing for keyed motions.
    slack: f64,
    /// Whether it is defined between its poses.
    keyed: bool,
    /// Whether its times are uneven beside the other motion's even ones.
    uneven: bool,
    /// Whether it has several ticks to a frame of the other motion.
    carries: bool,
    /// Whether it is interpolated at an instant, and not the nearest pose taken.
    interpolated: bool,
    /// Whether it has poses where a hand is lost, too, since its format cannot say so.
    bridges: bool,
}

/// What one of two motions is, as the other sees it.
#[derive(Clone, Copy)]
pub(super) struct Kind {
    /// Whether the frames of one are those of the other: at the same rate, or at one that carries the other's.
    pub nearest: bool,
    /// Whether its times are uneven beside the other's even ones.
    pub uneven: bool,
    /// Whether it has several ticks to a frame of the other.
    pub carries: bool,
    /// Whether it has poses where a hand is lost, too.
    pub bridges: bool,
}

/// Frames of one hand that the other motion has not.
#[derive(Default)]
pub(super) struct Missing {
    /// All of them.
    pub frames: usize,
    /// Those at which the other one has the hand lost.
    pub lost: usize,
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
    pub(super) fn new(clip: &'a PoseClip, side: Side, extent: Extent, kind: Kind) -> Self {
        let slack = extent.rate.map_or(1e-3, |rate| 0.5 / rate + 1e-6);
        Self {
            poses: clip.of(side).collect(),
            valid: clip.of(side).filter(|pose| pose.valid).collect(),
            gaps: if extent.rate.is_some() { gaps(clip, side) } else { Vec::new() },
            start: extent.start,
            slack,
            keyed: extent.rate.is_none(),
            uneven: kind.uneven,
            carries: kind.carries,
            interpolated: kind.uneven || !kind.nearest,
            bridges: kind.bridges,
        }
    }

    /// Whether the instants that count are those of another motion that does not follow.
    pub(super) fn follows(&self) -> bool {
        self.keyed || self.uneven || self.carries
    }

    pub(super) fn time(&self, index: usize) -> f64 {
        self.poses.get(index).map_or(f64::INFINITY, |p| p.time - self.start)
    }

    /// The nearest pose, at most half an interval away.
    fn nearest(&self, time: f64) -> Found {
        let nearest = nearest_in_time(&self.poses, time, |pose| pose.time - self.start);
        match nearest.map(|at| &self.poses[at]) {
            Some(pose) if (pose.time - self.start - time).abs() <= self.slack => match pose.valid {
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

    /// Whether the hand is lost at an instant: of poses that are interpolated both about it, as one that is valid tells as much.
    fn is_lost_at(&self, time: f64) -> bool {
        if !self.interpolated {
            return matches!(self.nearest(time), Found::Lost);
        }
        let after = self.poses.partition_point(|p| p.time - self.start <= time);
        let lost = |i: usize| self.poses.get(i).is_some_and(|pose| !pose.valid);
        after > 0 && lost(after - 1) && (lost(after) || after == self.poses.len())
    }

    /// The valid poses before and after an instant.
    fn about(&self, time: f64) -> [Option<&'a TimedPose>; 2] {
        let after = self.valid.partition_point(|p| p.time - self.start <= time);
        let (before, behind) = self.valid.split_at(after);
        [before.last(), behind.first()].map(|pose| pose.copied())
    }

    /// Whether a pose at an instant at which `other` has the hand lost is what a format makes of it that cannot say so: the
    /// pose of `other` before or after it (or what this motion has there), or one between.
    fn bridges(&self, other: &Track, time: f64, pose: &HandPose, options: &CompareOptions) -> bool {
        if !self.bridges {
            return false;
        }
        let about = other.about(time);
        let edges = about.into_iter().flatten();
        let own = edges.clone().filter_map(|edge| match self.at(edge.time - other.start) {
            Found::Pose(pose) => Some(*pose),
            _ => None,
        });
        let between = match about {
            [Some(a), Some(b)] => {
                let share = (time + other.start - a.time) / (b.time - a.time);
                Some(a.pose.interpolated(&b.pose, share))
            }
            _ => None,
        };
        let like = |edge: &HandPose| alike(edge, pose, options);
        edges.clone().any(|edge| like(&edge.pose)) || own.chain(between).any(|edge| like(&edge))
    }

    /// The frames in a gap of a motion that begins at `start` in which this one has a pose, other than that before the gap.
    fn moving_in(&self, gap: &Gap, start: f64) -> usize {
        let at = |time: f64| match self.at(time - start) {
            Found::Pose(pose) => Some(pose),
            _ => None,
        };
        let before = at(gap.from).filter(|_| gap.to - gap.from <= LONGEST_GAP);
        let moves =
            |k: &usize| at(gap.from + *k as f64 * gap.step()).is_some_and(|pose| Some(pose) != before);
        (1..=gap.frames).filter(moves).count()
    }

    /// Valid frames for which `other` has no valid one. One in a gap of it that holds the pose before it, as decoders do where
    /// frames were skipped, tells nothing that could be missing, nor does one that bridges where the hand is lost. A keyed
    /// motion has the frames that are missing in the gaps of the other.
    pub(super) fn without(&self, other: &Track, options: &CompareOptions) -> Missing {
        let mut missing = Missing::default();
        if self.keyed {
            missing.frames = other.gaps.iter().map(|gap| self.moving_in(gap, other.start)).sum();
            return missing;
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
        // Ticks end before the last of uneven times, and those of a frame behind its middle.
        let back = if self.carries { other.slack } else { self.slack };
        let near = |time: f64| {
            (self.uneven || self.carries) && matches!(other.at(time - back), Found::Pose(_) | Found::Lost)
        };
        let nothing = |time: f64| matches!(other.at(time), Found::Nothing) && !near(time);
        for (i, timed) in self.poses.iter().enumerate().filter(|(_, timed)| timed.valid) {
            let time = self.time(i);
            if other.is_lost_at(time) && !self.bridges(other, time, &timed.pose, options) {
                missing.frames += 1;
                missing.lost += 1;
            } else if nothing(time) && !holds(i) {
                missing.frames += 1;
            }
        }
        missing
    }
}
