//! Poses that a tracker gives to the planes of a sender, as a transport takes them.
//!
//! ```
//! use handcast_hand::{HandPose, PoseHeader, Side, TimedPose};
//! use handcast_live::sender::{LivePoseEncoderOptions, PoseSender};
//!
//! let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
//! let pose = TimedPose::new(0.0, HandPose::neutral(Side::Right));
//! let planes = sender.push(0.0, 1000, &[pose], &PoseHeader::default())?;
//! assert!(planes[0].opens() && planes[0].payload.starts_with(&[0, 0, 1]));
//! # Ok::<(), handcast_codec::PosesToStreamError>(())
//! ```

pub use handcast_codec::LivePoseEncoderOptions;
use handcast_codec::{LivePlane, LivePoseEncoder, PosesToStreamError};
use handcast_hand::{PoseHeader, Side, TimedPose};

use crate::transport::Hello;
use crate::wire::{MAX_PAYLOAD, Plane};

/// Makes planes of poses: those of a [`LivePoseEncoder`], counted and with their times. On the wire one stream follows the
/// other.
#[derive(Debug)]
pub struct PoseSender {
    encoder: LivePoseEncoder,
    /// What was announced last, and whether it is to be.
    hello: Hello,
    changed: bool,
    /// The hands that were lost in the last plane.
    lost: [bool; 2],
    /// Period and index of the last plane.
    at: Option<(u16, u16)>,
}

/// The poses of the newest instant, of some in order of their times: of those before it nobody wants to know any more.
pub fn newest(poses: &[TimedPose]) -> &[TimedPose] {
    let last = poses.last().map_or(0.0, |pose| pose.time);
    &poses[poses.partition_point(|pose| pose.time < last)..]
}

impl PoseSender {
    /// One that has sent nothing.
    pub fn new(options: LivePoseEncoderOptions) -> Self {
        let hello = Hello { hands: [false; 2], record: Vec::new() };
        Self { encoder: LivePoseEncoder::new(options), hello, changed: false, lost: [false; 2], at: None }
    }

    /// Takes the poses of an instant and what is known of the hands, as [`LivePoseEncoder::push`] does, and gives the planes
    /// that are ready. `time_ms` is the instant on the clock of the room; poses of instants before it are of no interest any
    /// more.
    ///
    /// # Errors
    /// As [`LivePoseEncoder::push`].
    pub fn push(
        &mut self,
        seconds: f64,
        time_ms: u32,
        poses: &[TimedPose],
        known: &PoseHeader,
    ) -> Result<Vec<Plane>, PosesToStreamError> {
        let made = self.encoder.push(seconds, newest(poses), known)?;
        let hands = [Side::Left, Side::Right].map(|side| self.encoder.hands().contains(&side));
        let record = self.encoder.record();
        if self.hello.hands != hands || self.hello.record != record {
            self.hello = Hello { hands, record: record.to_vec() };
            self.changed = true;
        }
        let lost = self.encoder.lost();
        let news = std::mem::replace(&mut self.lost, lost) != lost;
        let mut planes: Vec<Plane> = made.into_iter().filter_map(|made| self.plane(made, time_ms)).collect();
        if planes.is_empty() && news {
            // Nothing has moved, but whether a hand is seen.
            planes.extend(self.plane(LivePlane { bytes: Vec::new(), opens: false }, time_ms));
        }
        Ok(planes)
    }

    fn plane(&mut self, made: LivePlane, time_ms: u32) -> Option<Plane> {
        let (period, index) = match (self.at, made.opens) {
            (Some((period, _)), true) => (period.wrapping_add(1), 0),
            (None, true) => (0, 0),
            (Some((period, index)), false) => (period, index.checked_add(1)?),
            // What no period has opened for cannot be read.
            (None, false) => return None,
        };
        self.at = Some((period, index));
        debug_assert!(made.bytes.len() <= MAX_PAYLOAD);
        Some(Plane { period, index, time_ms, lost: self.lost, payload: made.bytes, ..Plane::default() })
    }

    /// What is to be announced, where it has changed since the last call.
    pub fn take_hello(&mut self) -> Option<Hello> {
        std::mem::take(&mut self.changed).then(|| self.hello.clone())
    }

    /// Makes the next plane open a period.
    pub fn request_intra(&mut self) {
        self.encoder.request_intra();
    }

    /// Ends the stream: gives its last planes.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn finish(&mut self, time_ms: u32) -> Result<Vec<Plane>, PosesToStreamError> {
        let made = self.encoder.finish()?;
        Ok(made.into_iter().filter_map(|made| self.plane(made, time_ms)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_codec::{PoseDecoder, PoseDecoderOptions};
    use handcast_fba::DecoderOptions;
    use handcast_hand::{ClipHand, HandPose, JointAngle, Morphology};

    fn pose(side: Side, frame: u32, moves: bool) -> TimedPose {
        let bend = if moves { 30.0 + 25.0 * (f64::from(frame) * 0.1).sin() } else { 30.0 };
        let pose = HandPose::neutral(side).with_degrees(JointAngle::Index1Flexion, bend);
        TimedPose::new(f64::from(frame) / 30.0, pose)
    }

    fn push(sender: &mut PoseSender, frame: u32, poses: &[TimedPose]) -> Vec<Plane> {
        push_toned(sender, frame, poses, None)
    }

    fn push_toned(
        sender: &mut PoseSender,
        frame: u32,
        poses: &[TimedPose],
        skin_tone: Option<u8>,
    ) -> Vec<Plane> {
        let sizes = ClipHand { side: Side::Right, morphology: Some(Morphology::average(0.17)) };
        let known = PoseHeader { hands: vec![sizes], skin_tone, ..PoseHeader::default() };
        sender.push(f64::from(frame) / 30.0, frame * 33, poses, &known).unwrap()
    }

    /// Checks that periods and planes are counted without a gap.
    fn check(planes: &[Plane]) {
        assert!(planes[0].opens());
        for pair in planes.windows(2) {
            let next = (pair[0].period, pair[0].index + 1);
            let opens = (pair[0].period.wrapping_add(1), 0);
            assert!([next, opens].contains(&(pair[1].period, pair[1].index)), "{pair:?}");
        }
    }

    #[test]
    fn planes_are_decoded_when_they_come() {
        let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        let mut planes = Vec::new();
        for frame in 0..400 {
            let truth = pose(Side::Right, frame, true);
            if frame == 70 {
                sender.request_intra();
            }
            let made = push(&mut sender, frame, std::slice::from_ref(&truth));
            assert!(frame != 70 || made.iter().any(Plane::opens));
            for plane in &made {
                let shown = decoder.push_whole(&plane.payload).unwrap();
                let off = |shown: &TimedPose| {
                    shown.pose.angle(JointAngle::Index1Flexion) - truth.pose.angle(JointAngle::Index1Flexion)
                };
                assert!(shown.last().is_none_or(|shown| off(shown).abs() < 0.06));
            }
            planes.extend(made);
        }
        check(&planes);
        assert!(planes.iter().filter(|plane| plane.opens()).count() >= 3);
        let told = decoder.header().hands[0].morphology.clone().unwrap();
        assert!((told.hand_length - 0.17).abs() < 1e-3);
        // Who comes at a later period knows as much.
        let from = planes.iter().rposition(Plane::opens).unwrap();
        let conceal = DecoderOptions { conceal: true, ..DecoderOptions::default() };
        let mut late = PoseDecoder::new(PoseDecoderOptions::default().with_decoder(conceal));
        let shown = late.push_whole(&planes[from].payload).unwrap();
        assert_eq!(shown.len(), 1);
        assert!(late.header().hands[0].morphology.is_some());
    }

    #[test]
    fn hands_come_and_go() {
        let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        let (mut planes, mut hellos) = (Vec::new(), Vec::new());
        for frame in 0..400 {
            let mut poses = vec![pose(Side::Right, frame, true)];
            if (50..150).contains(&frame) {
                poses.push(pose(Side::Left, frame, true));
            }
            let made = push(&mut sender, frame, &poses);
            hellos.extend(sender.take_hello().map(|hello| (frame, hello.hands)));
            let mut shown = Vec::new();
            for plane in &made {
                shown = decoder.push_whole(&plane.payload).unwrap();
            }
            let left = shown.iter().any(|pose| pose.pose.side == Side::Left);
            assert!(shown.is_empty() || left || !(50..235).contains(&frame), "{frame}");
            planes.extend(made);
        }
        check(&planes);
        let expected = [(0, [false, true]), (50, [true, true]), (239, [false, true])];
        assert_eq!(
            hellos.iter().map(|(_, hands)| *hands).collect::<Vec<_>>(),
            expected.map(|(_, hands)| hands)
        );
        assert!((235..245).contains(&hellos[2].0), "{hellos:?}");
        assert!(planes.iter().any(|plane| plane.lost == [true, false]));
        planes.extend(sender.finish(0).unwrap());
        assert!(planes.last().unwrap().payload.ends_with(&[0, 0, 1, 0xb1]));
        let stream: Vec<u8> = planes.iter().flat_map(|plane| plane.payload.clone()).collect();
        let whole = handcast_codec::decode_poses(&stream, None, DecoderOptions::default());
        assert!(whole.unwrap().clip.frames.len() >= 400);
    }

    #[test]
    fn a_hand_that_is_lost_at_rest_is_told() {
        let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
        for frame in 0..40 {
            push(&mut sender, frame, &[pose(Side::Right, frame, false)]);
        }
        let lost = push(&mut sender, 40, &[TimedPose::lost(0.0, Side::Right)]);
        assert_eq!((lost.len(), lost[0].lost, lost[0].payload.len()), (1, [false, true], 0));
        assert!(push(&mut sender, 41, &[TimedPose::lost(0.0, Side::Right)]).is_empty());
        let back = push(&mut sender, 42, &[pose(Side::Right, 42, false)]);
        assert_eq!(back[0].lost, [false; 2]);
    }

    #[test]
    fn before_a_hand_is_seen_nothing_is_sent() {
        let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
        assert!(push(&mut sender, 0, &[]).is_empty());
        assert!(push(&mut sender, 1, &[TimedPose::lost(0.0, Side::Left)]).is_empty());
        assert!(sender.take_hello().is_none() && sender.finish(0).unwrap().is_empty());
    }

    /// The record of the first stream has no tone; once it is known another begins at once, and later ones wait.
    #[test]
    fn the_tone_of_the_skin_travels_when_it_is_known() {
        let mut sender = PoseSender::new(LivePoseEncoderOptions::default());
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        let mut told = Vec::new();
        for frame in 0..260 {
            let tone = [None, Some(4), Some(5)][(frame as usize / 10).min(2)];
            for plane in push_toned(&mut sender, frame, &[pose(Side::Right, frame, true)], tone) {
                decoder.push_whole(&plane.payload).unwrap();
                let tone = decoder.header().skin_tone;
                if told.last() != Some(&tone) {
                    told.push(tone);
                }
            }
        }
        assert_eq!(told, [None, Some(4), Some(5)]);
        let sizes = decoder.header().hand(Side::Right).and_then(|hand| hand.morphology.clone());
        assert!((sizes.unwrap().hand_length - 0.17).abs() < 1e-3);
    }
}
