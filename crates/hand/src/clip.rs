//! The poses of one hand or two over time, as tracked, decoded or read from a file.
//!
//! ```
//! use handcast_hand::{HandPose, JointAngle, PoseClip, PoseHeader, Side, TimedPose};
//!
//! let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, 30.0);
//! let clip = PoseClip {
//!     header: PoseHeader::one(Side::Right, None, Some(30.0)),
//!     frames: vec![TimedPose::new(0.0, pose.clone()), TimedPose::new(0.1, pose)],
//! };
//! clip.check()?;
//! assert_eq!(clip.resampled(Side::Right, 20.0, 1.0).len(), 3);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{HandPose, Morphology, MorphologyError, Person, Side, skin_tone};

/// Most instants of a hand at a rate: [`PoseClip::even`] and [`PoseClip::resampled`] make no more, and who calls them refuses
/// what would have more.
pub const MAX_FRAMES: usize = 4_000_000;
/// Most hands in a clip.
pub const MAX_HANDS: usize = 2;
/// Highest frame rate, per second.
pub const MAX_RATE: f64 = 10_000.0;
/// Latest instant, seconds; the earliest is its negative.
pub const MAX_TIME: f64 = 1e10;
/// How near to an end of a motion a tick counts as the end, ticks: files whose times are single precision end an hour
/// of 30 frames a second 0.004 early or late.
const NEAR_END: f64 = 0.01;

/// Why a hand has no pose of its own at an instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Absence {
    /// It was not found.
    Lost,
    /// It touches or covers the other hand, and the two cannot be told apart.
    Touching,
    /// It has not been seen open yet.
    NotYet,
    /// It was not found, or there was no picture; the pose given is on the way from the one before to the one behind
    /// ([`Bridged`](crate::Bridged)).
    Bridged,
}

/// One hand at one instant of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedPose {
    /// Seconds from the start.
    pub time: f64,
    /// The pose; where `valid` is false, a guess or the neutral pose.
    pub pose: HandPose,
    /// How sure its maker was, 0 to 1.
    pub confidence: Option<f64>,
    /// Non-overlap turned round: intersection over union of model and image silhouette, 0 to 1.
    pub iou: Option<f64>,
    /// False where the hand was lost.
    pub valid: bool,
    /// Why it was, where that is known.
    pub why: Option<Absence>,
}

/// The step in the middle of those between instants, which are in order; `None` of less than two.
pub fn usual_step(times: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// The number of the one of `items`, which are in order of time, that is nearest to an instant, the earlier of two; `None` of no
/// items.
pub fn nearest_in_time<T>(items: &[T], instant: f64, time: impl Fn(&T) -> f64) -> Option<usize> {
    let after = items.partition_point(|item| time(item) < instant);
    let off = |at: &usize| (time(&items[*at]) - instant).abs();
    (after.saturating_sub(1)..items.len().min(after + 1)).min_by(|a, b| off(a).total_cmp(&off(b)))
}

impl TimedPose {
    /// A valid pose about which nothing else is known.
    pub fn new(time: f64, pose: HandPose) -> Self {
        Self { time, pose, confidence: None, iou: None, valid: true, why: None }
    }

    /// An instant at which the hand was lost; the pose is neutral.
    pub fn lost(time: f64, side: Side) -> Self {
        Self { valid: false, ..Self::new(time, HandPose::neutral(side)) }
    }

    /// Whether a stream goes by its pose: it is valid, or stands between two that are.
    pub fn is_shown(&self) -> bool {
        self.valid || self.why == Some(Absence::Bridged)
    }
}

/// One hand of a clip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClipHand {
    /// Left or right.
    pub side: Side,
    /// Its sizes, where they are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub morphology: Option<Morphology>,
}

/// What holds for a whole clip.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseHeader {
    /// Frames per second, where the time base is even.
    pub rate: Option<f64>,
    /// The hands whose poses follow: one, or left and right.
    pub hands: Vec<ClipHand>,
    /// What made the poses, in words.
    pub made_by: Option<String>,
    /// The tone of the skin, 1 (lightest) to 10, where it is known.
    pub skin_tone: Option<u8>,
}

impl PoseHeader {
    /// The header of a clip of one hand.
    pub fn one(side: Side, morphology: Option<Morphology>, rate: Option<f64>) -> Self {
        Self { rate, hands: vec![ClipHand { side, morphology }], ..Self::default() }
    }

    /// The entry of a hand.
    pub fn hand(&self, side: Side) -> Option<&ClipHand> {
        self.hands.iter().find(|h| h.side == side)
    }

    /// Leaves out what is of the person, not of the motion: sizes and the tone of the skin.
    pub fn forget_person(&mut self) {
        self.hands.iter_mut().for_each(|hand| hand.morphology = None);
        self.skin_tone = None;
    }

    /// The colour of the skin (sRGB), where its tone is known.
    pub fn skin(&self) -> Option<[u8; 3]> {
        self.skin_tone.and_then(skin_tone)
    }

    /// That rate, hands, sizes and tone are sound.
    ///
    /// # Errors
    /// See [`PoseClipError`].
    pub fn check(&self) -> Result<(), PoseClipError> {
        if let Some(rate) = self.rate
            && !(rate > 0.0 && rate <= MAX_RATE)
        {
            return Err(PoseClipError::Rate { rate });
        }
        if self.hands.is_empty() || self.hands.len() > MAX_HANDS {
            return Err(PoseClipError::Hands { count: self.hands.len() });
        }
        if let [a, b] = self.hands.as_slice()
            && a.side == b.side
        {
            return Err(PoseClipError::Twice { side: a.side });
        }
        for hand in &self.hands {
            let sizes = hand.morphology.as_ref().map_or(Ok(()), Morphology::validate);
            sizes.map_err(|source| PoseClipError::Sizes { side: hand.side, source })?;
        }
        if let Some(tone) = self.skin_tone
            && self.skin().is_none()
        {
            return Err(PoseClipError::SkinTone { tone });
        }
        Ok(())
    }
}

/// What is wrong with a clip.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum PoseClipError {
    /// The frame rate is out of range.
    #[error("rate is {rate}, allowed above 0 to {MAX_RATE} frames per second")]
    Rate {
        /// Frames per second.
        rate: f64,
    },
    /// There is no hand, or there are too many.
    #[error("{count} hands, allowed 1 or {MAX_HANDS}")]
    Hands {
        /// How many.
        count: usize,
    },
    /// Both hands are of one side.
    #[error("the {} hand appears twice", side.name())]
    Twice {
        /// Which.
        side: Side,
    },
    /// Sizes cannot be those of a hand.
    #[error("{} hand: {source}", side.name())]
    Sizes {
        /// Which hand.
        side: Side,
        /// Which size.
        source: MorphologyError,
    },
    /// There is no such tone of skin.
    #[error("skin_tone is {tone}, allowed 1 to 10")]
    SkinTone {
        /// The tone.
        tone: u8,
    },
    /// A pose is of a hand that the header does not name.
    #[error("the {} hand is not named in the header", side.name())]
    Unnamed {
        /// Which hand.
        side: Side,
    },
    /// An instant is out of range.
    #[error("t is {time}, allowed -1e10 to 1e10 s")]
    Time {
        /// Seconds.
        time: f64,
    },
    /// An instant does not come after the one before it of the same hand.
    #[error("t is {time} s, not after {before} s of the {} hand", side.name())]
    Order {
        /// Seconds.
        time: f64,
        /// Seconds of the pose before.
        before: f64,
        /// Which hand.
        side: Side,
    },
    /// A share is none.
    #[error("{what} is {value}, allowed 0 to 1")]
    Share {
        /// `confidence` or `iou`.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A number of a pose is not finite.
    #[error("the pose is not finite")]
    NotFinite,
    /// A number of a pose is out of range.
    #[error("{what}")]
    Range {
        /// Which, its value and what is allowed.
        what: String,
    },
}

/// Checks the poses of a clip one by one: order in time and sound values.
#[derive(Clone, Debug, Default)]
pub struct FrameCheck {
    last: [Option<f64>; 2],
}

impl FrameCheck {
    /// That `frame` may follow those checked so far in a clip with this header.
    ///
    /// # Errors
    /// See [`PoseClipError`].
    pub fn check(&mut self, header: &PoseHeader, frame: &TimedPose) -> Result<(), PoseClipError> {
        self.check_at(frame.time, header, frame)
    }

    /// As [`Self::check`], of `frame` at another time.
    ///
    /// # Errors
    /// See [`PoseClipError`].
    pub fn check_at(
        &mut self,
        time: f64,
        header: &PoseHeader,
        frame: &TimedPose,
    ) -> Result<(), PoseClipError> {
        let side = frame.pose.side;
        if header.hand(side).is_none() {
            return Err(PoseClipError::Unnamed { side });
        }
        if !(-MAX_TIME..=MAX_TIME).contains(&time) {
            return Err(PoseClipError::Time { time });
        }
        let last = &mut self.last[side as usize];
        if let Some(before) = *last
            && time <= before
        {
            return Err(PoseClipError::Order { time, before, side });
        }
        *last = Some(time);
        for (what, value) in [("confidence", frame.confidence), ("iou", frame.iou)] {
            if let Some(value) = value
                && !(0.0..=1.0).contains(&value)
            {
                return Err(PoseClipError::Share { what, value });
            }
        }
        if !frame.pose.is_finite() {
            return Err(PoseClipError::NotFinite);
        }
        frame.pose.check_range().map_err(|what| PoseClipError::Range { what })
    }
}

/// Poses of one hand or two over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseClip {
    /// What holds for all of them.
    pub header: PoseHeader,
    /// The poses of all hands; those of one hand are in order of time.
    pub frames: Vec<TimedPose>,
}

impl PoseClip {
    /// A clip of these poses, in order of time for each hand, at `rate` frames per second where the time base is even.
    pub fn of_frames(frames: impl IntoIterator<Item = TimedPose>, rate: Option<f64>) -> Self {
        let frames: Vec<TimedPose> = frames.into_iter().collect();
        let seen = |side: &Side| frames.iter().any(|f| f.pose.side == *side);
        let hands = [Side::Left, Side::Right].into_iter().filter(seen);
        let hands = hands.map(|side| ClipHand { side, morphology: None }).collect();
        Self { header: PoseHeader { rate, hands, ..PoseHeader::default() }, frames }
    }

    /// The person whose hand the header gives sizes of: the first such hand.
    pub fn person(&self) -> Option<Person> {
        self.header.hands.iter().find_map(|hand| {
            let morphology = hand.morphology.clone()?;
            Some(Person { name: None, hand: Some(hand.side), morphology })
        })
    }

    /// That header and poses are sound.
    ///
    /// # Errors
    /// See [`PoseClipError`].
    pub fn check(&self) -> Result<(), PoseClipError> {
        self.header.check()?;
        let mut check = FrameCheck::default();
        self.frames.iter().try_for_each(|frame| check.check(&self.header, frame))
    }

    /// Moves all poses on by so many seconds.
    pub fn shift(&mut self, seconds: f64) {
        self.frames.iter_mut().for_each(|frame| frame.time += seconds);
    }

    /// The poses of one hand, in order of time.
    pub fn of(&self, side: Side) -> impl Iterator<Item = &TimedPose> {
        self.frames.iter().filter(move |f| f.pose.side == side)
    }

    /// The poses of all hands at instants `rate` a second, counted from the first of any hand; each hand that is valid
    /// somewhere from its first pose to its last. Where it is lost it is not valid, and goes from the valid pose before to the
    /// one behind, or keeps what there is of them; where it has no poses it is bridged. Empty for a rate that is not positive.
    pub fn even(&self, rate: f64) -> Self {
        let mut out = Self { header: self.header.clone(), frames: Vec::new() };
        out.header.rate = Some(rate);
        let start = self.frames.iter().map(|f| f.time).fold(f64::INFINITY, f64::min);
        if !rate.is_finite() || rate <= 0.0 {
            return out;
        }
        for side in [Side::Left, Side::Right] {
            let all: Vec<&TimedPose> = self.of(side).collect();
            let track: Vec<&TimedPose> = self.of(side).filter(|f| f.valid).collect();
            let (Some(first), Some(last), false) = (all.first(), all.last(), track.is_empty()) else {
                continue;
            };
            let from = ((first.time - start) * rate - NEAR_END).ceil().max(0.0) as usize;
            let to = ((last.time - start) * rate + NEAR_END).floor() as usize;
            let (mut at, mut at_valid) = (0, 0);
            for tick in (from..=to).take(MAX_FRAMES) {
                let time = start + tick as f64 / rate;
                let (a, b, s) = neighbours(&all, &mut at, time);
                let mut there = between(a, b, s, time, true);
                if !there.valid {
                    let (a, b, s) = neighbours(&track, &mut at_valid, time);
                    there.pose = a.pose.interpolated(&b.pose, s);
                }
                out.frames.push(there);
            }
        }
        out
    }

    /// One hand at the instants `0, 1/rate, 2/rate, …` after its first pose: angles and translations
    /// interpolated linearly, rotations on the great circle. An instant is valid when both neighbours
    /// are; between poses more than `max_gap` seconds apart the hand counts as lost.
    pub fn resampled(&self, side: Side, rate: f64, max_gap: f64) -> Vec<TimedPose> {
        let track: Vec<&TimedPose> = self.of(side).collect();
        let (Some(first), Some(last)) = (track.first(), track.last()) else { return Vec::new() };
        if !rate.is_finite() || rate <= 0.0 {
            return Vec::new();
        }
        let count = ((last.time - first.time) * rate + NEAR_END).floor().clamp(0.0, MAX_FRAMES as f64 - 1.0)
            as usize
            + 1;
        let mut at = 0;
        (0..count)
            .map(|i| {
                let time = i as f64 / rate;
                let t = first.time + time;
                let (a, b, s) = neighbours(&track, &mut at, t);
                between(a, b, s, time, b.time - a.time <= max_gap)
            })
            .collect()
    }
}

/// The poses before and after an instant of a track that is not empty, and how far it is from one to the
/// other. `at` is where the search begins; instants must not go back.
fn neighbours<'a>(track: &[&'a TimedPose], at: &mut usize, time: f64) -> (&'a TimedPose, &'a TimedPose, f64) {
    while *at + 2 < track.len() && track[*at + 1].time <= time {
        *at += 1;
    }
    let (a, b) = (track[*at], track[(*at + 1).min(track.len() - 1)]);
    let span = b.time - a.time;
    (a, b, if span > 0.0 { ((time - a.time) / span).clamp(0.0, 1.0) } else { 0.0 })
}

fn between(a: &TimedPose, b: &TimedPose, s: f64, time: f64, near: bool) -> TimedPose {
    let mix = |x: Option<f64>, y: Option<f64>| Some(x? + s * (y? - x?));
    let valid = match s {
        0.0 => a.valid,
        1.0 => b.valid,
        _ => near && a.valid && b.valid,
    };
    TimedPose {
        time,
        pose: a.pose.interpolated(&b.pose, s),
        confidence: mix(a.confidence, b.confidence),
        iou: mix(a.iou, b.iou),
        valid,
        why: if s < 0.5 { a.why.or(b.why) } else { b.why.or(a.why) }.filter(|_| !valid),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::JointAngle;

    #[test]
    fn resampling_interpolates_and_marks_gaps() {
        let at = |t: f64| {
            let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, 10.0 * t);
            TimedPose::new(t, pose)
        };
        let clip = PoseClip {
            header: PoseHeader::one(Side::Right, None, None),
            frames: vec![at(1.0), at(1.5), at(3.0), at(3.1)],
        };
        let out = clip.resampled(Side::Right, 4.0, 0.6);
        assert_eq!(out.len(), 9);
        for (i, frame) in out.iter().enumerate() {
            assert_eq!(frame.time, i as f64 * 0.25);
            let expected = 10.0 * (1.0 + frame.time);
            assert!((frame.pose.angle(JointAngle::Index1Flexion).to_degrees() - expected).abs() < 1e-9);
            assert_eq!(frame.valid, i <= 2 || i == 8, "{i}");
        }
        assert!(clip.resampled(Side::Left, 4.0, 0.6).is_empty());
    }

    #[test]
    fn even_instants_are_lost_where_the_hand_is() {
        let at = |i: u32| {
            let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, f64::from(i));
            let valid = !matches!(i, 0..=4 | 10..=14 | 25..);
            let pose = if valid { pose } else { HandPose::neutral(Side::Right) };
            TimedPose { valid, ..TimedPose::new(0.04 * f64::from(i), pose) }
        };
        let clip = PoseClip {
            header: PoseHeader::one(Side::Right, None, Some(25.0)),
            frames: (0..30).map(at).collect(),
        };
        for rate in [25.0, 50.0] {
            let even = clip.even(rate);
            let per = (rate / 25.0) as usize;
            assert_eq!(even.frames.len(), 29 * per + 1);
            for (k, frame) in even.frames.iter().enumerate() {
                let i = k as f64 / per as f64;
                assert!((frame.time - 0.04 * i).abs() < 1e-9);
                // An instant between a pose and none is none.
                let valid = [i.floor(), i.ceil()].into_iter().all(|i| at(i as u32).valid);
                assert_eq!(frame.valid, valid, "{i} at {rate}");
                let bend = frame.pose.angle(JointAngle::Index1Flexion).to_degrees();
                assert!((bend - i.clamp(5.0, 24.0)).abs() < 1e-9, "{bend} at {i}");
            }
        }
        let never = PoseClip { frames: (0..4).map(at).collect(), ..clip };
        assert!(never.even(25.0).frames.is_empty());
    }

    #[test]
    fn times_of_single_precision_keep_the_last_instant() {
        for last in [70, 30 * 3600 - 1] {
            let at = |i: u32| TimedPose::new(f64::from(i as f32 / 30.0), HandPose::neutral(Side::Right));
            let clip = PoseClip {
                header: PoseHeader::one(Side::Right, None, None),
                frames: vec![at(0), at(1), at(last)],
            };
            assert_eq!(clip.resampled(Side::Right, 30.0, 9.0).len(), last as usize + 1);
            assert_eq!(clip.even(30.0).frames.len(), last as usize + 1);
        }
    }

    #[test]
    fn unsound_clips_are_named() {
        let right = PoseClip {
            header: PoseHeader::one(Side::Right, None, Some(30.0)),
            frames: vec![TimedPose::new(0.0, HandPose::neutral(Side::Right))],
        };
        assert_eq!(right.check(), Ok(()));
        let refused = |change: &dyn Fn(&mut PoseClip)| {
            let mut clip = right.clone();
            change(&mut clip);
            clip.check().unwrap_err()
        };
        assert_eq!(refused(&|c| c.header.rate = Some(0.0)), PoseClipError::Rate { rate: 0.0 });
        assert_eq!(refused(&|c| c.header.hands.clear()), PoseClipError::Hands { count: 0 });
        let twice = |c: &mut PoseClip| c.header.hands.push(c.header.hands[0].clone());
        assert_eq!(refused(&twice), PoseClipError::Twice { side: Side::Right });
        let small = Morphology { hand_length: 0.001, ..Morphology::default() };
        let sizes = |c: &mut PoseClip| c.header.hands[0].morphology = Some(small.clone());
        assert!(matches!(refused(&sizes), PoseClipError::Sizes { side: Side::Right, .. }));
        assert_eq!(
            refused(&|c| c.frames[0].pose.side = Side::Left),
            PoseClipError::Unnamed { side: Side::Left }
        );
        assert_eq!(refused(&|c| c.frames[0].time = 2e10), PoseClipError::Time { time: 2e10 });
        let again = PoseClipError::Order { time: 0.0, before: 0.0, side: Side::Right };
        assert_eq!(refused(&|c| c.frames.push(c.frames[0].clone())), again);
        let share = PoseClipError::Share { what: "iou", value: 1.5 };
        assert_eq!(refused(&|c| c.frames[0].iou = Some(1.5)), share);
        assert_eq!(refused(&|c| c.frames[0].pose.angles[3] = f64::NAN), PoseClipError::NotFinite);
    }
}
