//! Poses that a tracker gives to the planes of a sender, as a transport takes them.
//!
//! ```
//! use handcast_hand::{HandPose, Side, TimedPose};
//! use handcast_live::sender::{PoseSender, SenderOptions};
//!
//! let mut sender = PoseSender::new(SenderOptions::default());
//! let pose = TimedPose::new(0.0, HandPose::neutral(Side::Right));
//! let planes = sender.push(0.0, 1000, &[pose], &[])?;
//! assert!(planes[0].opens() && planes[0].payload.starts_with(&[0, 0, 1]));
//! # Ok::<(), handcast_codec::PosesToStreamError>(())
//! ```

use handcast_codec::mapping::Profile;
use handcast_codec::{PoseEncoder, PoseEncoderOptions, PosesToStreamError, record_of};
use handcast_fba::plan::{PlanOptions, Target};
use handcast_hand::{ClipHand, Side, TimedPose};

use crate::transport::Hello;
use crate::wire::{MAX_PAYLOAD, Plane};

/// A hand that has not been seen for so many seconds, while another is, is not sent any more.
const FORGET: f64 = 3.0;
/// Seconds of a stream after which another tone of skin begins the next: tones settle while hands are looked at.
const SETTLED: f64 = 5.0;
/// Ticks after which a stream ends and the next begins, so that what an encoder knows of a stream does not grow.
const LONGEST: u64 = 18_000;

/// How poses are sent.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct SenderOptions {
    /// Frames per second of the stream: those of the camera.
    pub rate: f64,
    /// Where position and rotation of a hand travel.
    pub profile: Profile,
    /// What is aimed at. Poses are coded when they come, planes end with a byte, and each period is one to begin at with
    /// the person's record, whatever it says.
    pub plan: PlanOptions,
}

impl Default for SenderOptions {
    /// At 30 frames/s with 0.5° RMS.
    fn default() -> Self {
        let plan = PlanOptions { mode: Target::Rms(0.5), ..PlanOptions::default() };
        Self { rate: 30.0, profile: Profile::default(), plan }
    }
}

impl SenderOptions {
    /// Sets the frames per second.
    pub fn with_rate(self, rate: f64) -> Self {
        Self { rate, ..self }
    }

    /// Sets where position and rotation of a hand travel.
    pub fn with_profile(self, profile: Profile) -> Self {
        Self { profile, ..self }
    }

    /// Sets what is aimed at.
    pub fn with_plan(self, plan: PlanOptions) -> Self {
        Self { plan, ..self }
    }
}

/// The stream that is being made.
#[derive(Debug)]
struct Current {
    encoder: PoseEncoder,
    hands: Vec<Side>,
    skin_tone: Option<u8>,
    /// Tick of the last poses, and seconds of the first.
    tick: u64,
    start: f64,
}

/// Makes planes of poses. A hand that comes, or stays away, and a tone of skin that becomes known begin another stream; on the
/// wire one follows the other.
#[derive(Debug)]
pub struct PoseSender {
    options: SenderOptions,
    current: Option<Current>,
    /// Seconds at which each hand was seen last.
    seen: [Option<f64>; 2],
    lost: [bool; 2],
    sizes: Vec<ClipHand>,
    skin_tone: Option<u8>,
    hello: Option<Hello>,
    /// Period and index of the last plane.
    at: Option<(u16, u16)>,
}

impl PoseSender {
    /// One that has sent nothing.
    pub fn new(options: SenderOptions) -> Self {
        Self {
            options,
            current: None,
            seen: [None; 2],
            lost: [false; 2],
            sizes: Vec::new(),
            skin_tone: None,
            hello: None,
            at: None,
        }
    }

    /// Says what the tone of the skin is, 1 to 10, as far as it is known: it travels with the sizes.
    pub fn set_skin_tone(&mut self, skin_tone: Option<u8>) {
        self.skin_tone = skin_tone.or(self.skin_tone);
    }

    /// Takes the poses of an instant, of each hand one at most, and gives the planes that are ready: mostly one, none
    /// while nothing moves. `seconds` is the instant on any clock that does not go back, `time_ms` on that of the room.
    /// `sizes` are those of the hands as far as they are known.
    ///
    /// # Errors
    /// A rate that a stream cannot have, a pose that cannot be coded: that instant is left out.
    pub fn push(
        &mut self,
        seconds: f64,
        time_ms: u32,
        poses: &[TimedPose],
        sizes: &[ClipHand],
    ) -> Result<Vec<Plane>, PosesToStreamError> {
        for pose in poses.iter().filter(|pose| pose.valid) {
            self.seen[pose.pose.side as usize] = Some(seconds);
        }
        let hands = self.hands(seconds);
        if hands.is_empty() {
            return Ok(Vec::new());
        }
        let mut planes = Vec::new();
        let settled = (SETTLED * self.options.rate) as u64;
        let toned = |c: &Current| c.skin_tone == self.skin_tone || c.skin_tone.is_some() && c.tick < settled;
        let over = |c: &Current| c.hands != hands || c.tick > LONGEST || !toned(c);
        if self.current.as_ref().is_some_and(over) {
            planes.extend(self.end_stream(time_ms)?);
        }
        let lost = [Side::Left, Side::Right].map(|side| {
            let valid = |pose: &TimedPose| pose.pose.side == side && pose.valid;
            hands.contains(&side) && !poses.iter().any(valid)
        });
        let changed = std::mem::replace(&mut self.lost, lost) != lost;
        if self.current.is_none() {
            self.begin_stream(&hands, seconds, sizes)?;
        }
        let mut bytes = Vec::new();
        if let Some(current) = &mut self.current {
            let tick = ((seconds - current.start) * current.encoder.rate()).round();
            current.tick = (current.tick + 1).max(tick as u64);
            let time = current.tick as f64 / current.encoder.rate();
            for &side in &current.hands {
                let pose = poses.iter().find(|pose| pose.pose.side == side && pose.valid);
                let pose = pose.cloned().unwrap_or_else(|| TimedPose::lost(time, side));
                bytes.extend(current.encoder.push(&TimedPose { time, ..pose })?);
            }
        }
        self.cut(bytes, time_ms, &mut planes);
        if planes.is_empty() && changed {
            // Nothing has moved, but whether a hand is seen.
            planes.extend(self.plane(Vec::new(), time_ms, false));
        }
        Ok(planes)
    }

    /// The hands that are sent: those seen, but for one that has stayed away while the other has not.
    fn hands(&mut self, seconds: f64) -> Vec<Side> {
        let last = self.seen.iter().flatten().copied().fold(f64::NEG_INFINITY, f64::max);
        for seen in &mut self.seen {
            *seen = seen.filter(|&at| last - at < FORGET || seconds - last >= FORGET);
        }
        [Side::Left, Side::Right].into_iter().filter(|&side| self.seen[side as usize].is_some()).collect()
    }

    fn begin_stream(
        &mut self,
        hands: &[Side],
        start: f64,
        sizes: &[ClipHand],
    ) -> Result<(), PosesToStreamError> {
        self.sizes = sizes.iter().filter(|hand| hands.contains(&hand.side)).cloned().collect();
        let record = record_of(&self.sizes, self.skin_tone);
        let plan = PlanOptions {
            live: true,
            resync: true,
            repeat_record: !record.is_empty(),
            aligned: true,
            record,
            ..self.options.plan
        };
        let options = PoseEncoderOptions::live(self.options.rate)
            .with_profile(self.options.profile)
            .with_plan(plan)
            .with_hands(hands);
        let encoder = PoseEncoder::new(options)?;
        self.current =
            Some(Current { encoder, hands: hands.to_vec(), skin_tone: self.skin_tone, tick: 0, start });
        let hands = [Side::Left, Side::Right].map(|side| hands.contains(&side));
        self.hello = Some(Hello { hands, record: record.bytes().to_vec() });
        Ok(())
    }

    /// The last plane of a stream.
    fn end_stream(&mut self, time_ms: u32) -> Result<Vec<Plane>, PosesToStreamError> {
        let Some(current) = self.current.take() else { return Ok(Vec::new()) };
        let end = current.encoder.finish()?;
        Ok(self.plane(end.bytes, time_ms, false).into_iter().collect())
    }

    /// The planes of an encoder's bytes: before a start code what stands for frames left out in the period before.
    fn cut(&mut self, bytes: Vec<u8>, time_ms: u32, planes: &mut Vec<Plane>) {
        let code = bytes.windows(3).position(|window| window == [0, 0, 1]);
        let (before, opening) = bytes.split_at(code.unwrap_or(bytes.len()));
        for (part, opens) in [(before, false), (opening, true)] {
            if !part.is_empty() {
                planes.extend(self.plane(part.to_vec(), time_ms, opens));
            }
        }
    }

    fn plane(&mut self, payload: Vec<u8>, time_ms: u32, opens: bool) -> Option<Plane> {
        let (period, index) = match (self.at, opens) {
            (Some((period, _)), true) => (period.wrapping_add(1), 0),
            (None, true) => (0, 0),
            (Some((period, index)), false) => (period, index.checked_add(1)?),
            // What no period has opened for cannot be read.
            (None, false) => return None,
        };
        self.at = Some((period, index));
        debug_assert!(payload.len() <= MAX_PAYLOAD);
        Some(Plane { period, index, time_ms, lost: self.lost, payload, ..Plane::default() })
    }

    /// What is to be announced, where it has changed since the last call.
    pub fn take_hello(&mut self) -> Option<Hello> {
        self.hello.take()
    }

    /// Makes the next plane open a period.
    pub fn request_intra(&mut self) {
        if let Some(current) = &mut self.current {
            current.encoder.request_intra();
        }
    }

    /// Ends the stream: gives its last plane.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn finish(&mut self, time_ms: u32) -> Result<Vec<Plane>, PosesToStreamError> {
        self.end_stream(time_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_codec::{PoseDecoder, PoseDecoderOptions};
    use handcast_fba::DecoderOptions;
    use handcast_hand::{HandPose, JointAngle, Morphology};

    fn pose(side: Side, frame: u32, moves: bool) -> TimedPose {
        let bend = if moves { 30.0 + 25.0 * (f64::from(frame) * 0.1).sin() } else { 30.0 };
        let pose = HandPose::neutral(side).with_degrees(JointAngle::Index1Flexion, bend);
        TimedPose::new(f64::from(frame) / 30.0, pose)
    }

    fn push(sender: &mut PoseSender, frame: u32, poses: &[TimedPose]) -> Vec<Plane> {
        let sizes = ClipHand { side: Side::Right, morphology: Some(Morphology::average(0.17)) };
        sender.push(f64::from(frame) / 30.0, frame * 33, poses, &[sizes]).unwrap()
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
        let mut sender = PoseSender::new(SenderOptions::default());
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        let mut planes = Vec::new();
        for frame in 0..320 {
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
        let mut sender = PoseSender::new(SenderOptions::default());
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
        let mut sender = PoseSender::new(SenderOptions::default());
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
        let mut sender = PoseSender::new(SenderOptions::default());
        assert!(push(&mut sender, 0, &[]).is_empty());
        assert!(push(&mut sender, 1, &[TimedPose::lost(0.0, Side::Left)]).is_empty());
        assert!(sender.take_hello().is_none() && sender.finish(0).unwrap().is_empty());
    }

    /// The record of the first stream has no tone; once it is known another begins at once, and later ones wait.
    #[test]
    fn the_tone_of_the_skin_travels_when_it_is_known() {
        let mut sender = PoseSender::new(SenderOptions::default());
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        let mut told = Vec::new();
        for frame in 0..260 {
            sender.set_skin_tone([None, Some(4), Some(5)][(frame as usize / 10).min(2)]);
            for plane in push(&mut sender, frame, &[pose(Side::Right, frame, true)]) {
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
