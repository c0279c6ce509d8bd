//! Hands that come and go to the bytes of streams that follow one another, for as long as that takes.

use handcast_fba::plan::{PlanOptions, Target};
use handcast_fba::syntax::SEQUENCE_END;
use handcast_hand::{HandPose, PoseHeader, Side, TimedPose};

use crate::encoder::{PoseEncoder, PoseEncoderOptions};
use crate::error::PosesToStreamError;
use crate::mapping::Profile;
use crate::person::record_of;

/// A hand that has not been seen for so many seconds, while another is, is not sent any more.
const FORGET: f64 = 3.0;
/// Seconds of a stream after which another tone of skin begins the next: tones settle while hands are looked at.
const SETTLED: f64 = 5.0;
/// Ticks after which a stream ends and the next begins, so that what an encoder knows of a stream does not grow: ten minutes
/// at 30 frames/s.
const LONGEST: u64 = 18_000;
/// Ticks that poses may be ahead of the clock: cameras do not keep to theirs.
const AHEAD: u64 = 1;

/// Seconds by which poses of one instant are apart at most.
const SAME_TIME: f64 = 1e-6;

/// How hands are encoded live.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LivePoseEncoderOptions {
    /// Frames per second of the streams, those of the camera; the nearest sixteenth is written.
    pub rate: f64,
    /// Where position and rotation of a hand travel.
    pub profile: Profile,
    /// What is aimed at. Poses are coded when they come, planes end with a byte, and each period is one to begin at with
    /// the person's record, whatever it says.
    pub plan: PlanOptions,
}

impl Default for LivePoseEncoderOptions {
    /// At 30 frames/s with 0.5° RMS and a period every ten seconds: who wants one earlier asks for it.
    fn default() -> Self {
        let plan = PlanOptions { mode: Target::Rms(0.5), intra_seconds: 10.0, ..PlanOptions::default() };
        Self { rate: 30.0, profile: Profile::default(), plan }
    }
}

impl LivePoseEncoderOptions {
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

/// A piece of a live stream, to be sent at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LivePlane {
    /// The bytes: whole planes of the stream, or what ends it.
    pub bytes: Vec<u8>,
    /// Whether it begins a period (an I plane behind a start code): a reader may join here.
    pub opens: bool,
}

/// The stream that is being made.
#[derive(Clone, Debug)]
struct Current {
    encoder: PoseEncoder,
    hands: Vec<Side>,
    record: Vec<u8>,
    skin_tone: Option<u8>,
    /// Tick of the last poses, once there are some, and seconds of the first.
    tick: Option<u64>,
    start: f64,
}

/// Encodes the hands that a camera sees, as they come and go.
///
/// A stream carries the hands seen when it begins. A hand that comes, one that stays away for three seconds while the
/// other does not, and a tone of skin that becomes known end it and begin another; so do 18000 frames. A
/// [`PoseDecoder`](crate::PoseDecoder) reads them one behind the other. Of poses that come faster than the streams' frames those for which
/// there is none are left out.
///
/// ```
/// use handcast_codec::{LivePoseEncoder, LivePoseEncoderOptions, PoseDecoder, PoseDecoderOptions};
/// use handcast_hand::{HandPose, PoseHeader, Side, TimedPose};
///
/// let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
/// let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
/// for frame in 0..60 {
///     let time = f64::from(frame) / 30.0;
///     let seen = if frame < 30 { vec![Side::Left] } else { vec![Side::Left, Side::Right] };
///     let poses: Vec<_> = seen.iter().map(|&side| TimedPose::new(time, HandPose::neutral(side))).collect();
///     for plane in encoder.push(time, &poses, &PoseHeader::default())? {
///         decoder.push(&plane.bytes)?;
///     }
/// }
/// assert_eq!(encoder.hands(), [Side::Left, Side::Right]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct LivePoseEncoder {
    options: LivePoseEncoderOptions,
    current: Option<Current>,
    /// Seconds at which each hand was seen last.
    seen: [Option<f64>; 2],
    /// The last valid pose of each, which a stream begins with where the hand is lost just then.
    latest: [Option<HandPose>; 2],
    lost: [bool; 2],
    known: PoseHeader,
    /// Planes that are to be given.
    ready: Vec<LivePlane>,
    /// Instants given, and seconds of the last.
    instants: usize,
    last: Option<f64>,
}

impl LivePoseEncoder {
    /// One that has seen no hand.
    pub fn new(options: LivePoseEncoderOptions) -> Self {
        Self {
            options,
            current: None,
            seen: [None; 2],
            latest: [None, None],
            lost: [false; 2],
            known: PoseHeader::default(),
            ready: Vec::new(),
            instants: 0,
            last: None,
        }
    }

    /// Takes what a tracker gives at an instant (`time`, in seconds on a clock that does not go back), and gives the
    /// planes that are ready: mostly one, none while nothing moves. Poses of several instants, which may have waited for an
    /// open hand, come in order of their times, the last ones being of this instant. Of `known` the sizes of the hands
    /// and the tone of the skin travel with the streams that begin from now on; what it leaves out stays as it was said
    /// before.
    ///
    /// # Errors
    /// A time that is no number or goes back, of which nothing is taken; a rate that a stream cannot have, a pose that cannot be
    /// coded: that instant, and those behind it, are left out. Planes that are ready come with the next call.
    pub fn push(
        &mut self,
        time: f64,
        poses: &[TimedPose],
        known: &PoseHeader,
    ) -> Result<Vec<LivePlane>, PosesToStreamError> {
        let before = self.last;
        self.check(time, poses)?;
        self.learn(known);
        if let Err(error) = self.instants_of(time, poses) {
            // A time that was not taken is none that others follow.
            self.last = before;
            return Err(error);
        }
        Ok(std::mem::take(&mut self.ready))
    }

    /// Makes the planes of all instants, the last of which is at `time`.
    fn instants_of(&mut self, time: f64, poses: &[TimedPose]) -> Result<(), PosesToStreamError> {
        if poses.is_empty() {
            return self.instant(time, poses);
        }
        let last = poses.iter().map(|pose| pose.time).fold(f64::NEG_INFINITY, f64::max);
        for instant in poses.chunk_by(|a, b| (b.time - a.time).abs() < SAME_TIME) {
            self.instant(time - (last - instant[0].time), instant)?;
        }
        Ok(())
    }

    /// That time goes on, from instant to instant and from pose to pose.
    fn check(&mut self, time: f64, poses: &[TimedPose]) -> Result<(), PosesToStreamError> {
        let index = self.instants;
        self.instants += 1;
        let refused = |what, time, before| Err(PosesToStreamError::Time { what, index, time, before });
        // False of what is no number.
        let follows =
            |time: f64, before: Option<f64>| time.is_finite() && before.is_none_or(|before| time >= before);
        if !follows(time, self.last) {
            return refused("instant", time, self.last);
        }
        let mut before = None;
        for pose in poses {
            if !follows(pose.time, before.map(|before: f64| before - SAME_TIME)) {
                return refused("a pose of instant", pose.time, before);
            }
            before = Some(pose.time);
        }
        self.last = Some(time);
        Ok(())
    }

    /// Makes the planes of one instant.
    fn instant(&mut self, time: f64, poses: &[TimedPose]) -> Result<(), PosesToStreamError> {
        let mut given: [Option<&TimedPose>; 2] = [None; 2];
        for pose in poses.iter().filter(|pose| pose.valid) {
            given[pose.pose.side as usize].get_or_insert(pose);
        }
        let seen = self.seen;
        self.planes_of(time, given).inspect_err(|_| self.seen = seen)
    }

    /// The same, of the poses of the left hand and of the right one.
    fn planes_of(&mut self, time: f64, given: [Option<&TimedPose>; 2]) -> Result<(), PosesToStreamError> {
        for (seen, _) in self.seen.iter_mut().zip(given).filter(|(_, given)| given.is_some()) {
            *seen = Some(time);
        }
        let hands = self.hands_at(time);
        if hands.is_empty() {
            return Ok(());
        }
        if self.current.as_ref().is_some_and(|current| self.is_over(current, &hands)) {
            self.end()?;
        }
        self.lost =
            [Side::Left, Side::Right].map(|side| hands.contains(&side) && given[side as usize].is_none());
        let mut current = match self.current.take() {
            Some(current) => current,
            None => self.begin(hands, time)?,
        };
        let begins = current.tick.is_none();
        let pushed = current.push(time, given, &self.latest, &mut self.ready);
        // A stream whose first poses are refused would wait for others.
        self.current = (pushed.is_ok() || !begins).then_some(current);
        pushed?;
        for (latest, given) in self.latest.iter_mut().zip(given) {
            *latest = given.map(|given| given.pose.clone()).or(latest.take());
        }
        Ok(())
    }

    fn learn(&mut self, known: &PoseHeader) {
        for hand in known.hands.iter().filter(|hand| hand.morphology.is_some()) {
            self.known.hands.retain(|before| before.side != hand.side);
            self.known.hands.push(hand.clone());
        }
        self.known.skin_tone = known.skin_tone.or(self.known.skin_tone);
    }

    fn is_over(&self, current: &Current, hands: &[Side]) -> bool {
        let settled = (SETTLED * self.options.rate) as u64;
        let toned = current.skin_tone == self.known.skin_tone
            || current.skin_tone.is_some() && current.tick < Some(settled);
        current.hands != hands || current.tick > Some(LONGEST) || !toned
    }

    /// The hands that are sent: those seen, but for one that has stayed away while the other has not.
    fn hands_at(&mut self, time: f64) -> Vec<Side> {
        let last = self.seen.iter().flatten().copied().fold(f64::NEG_INFINITY, f64::max);
        for seen in &mut self.seen {
            *seen = seen.filter(|&at| last - at < FORGET || time - last >= FORGET);
        }
        [Side::Left, Side::Right].into_iter().filter(|&side| self.seen[side as usize].is_some()).collect()
    }

    fn begin(&self, hands: Vec<Side>, start: f64) -> Result<Current, PosesToStreamError> {
        let skin_tone = self.known.skin_tone;
        let told = self.known.hands.iter().filter(|hand| hands.contains(&hand.side));
        let record = record_of(&told.cloned().collect::<Vec<_>>(), skin_tone);
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
            .with_hands(&hands);
        let encoder = PoseEncoder::new(options)?;
        let record = record.bytes().to_vec();
        Ok(Current { encoder, hands, record, skin_tone, tick: None, start })
    }

    /// The hands that travel now; none before one has been seen.
    pub fn hands(&self) -> &[Side] {
        self.current.as_ref().map_or(&[], |current| &current.hands)
    }

    /// Of the hands that travel, left and right, those that had no valid pose at the last instant.
    pub fn lost(&self) -> [bool; 2] {
        self.lost
    }

    /// The person's record of the stream (`spec/fba-bitstream.md`), empty where nothing was known when it began.
    pub fn record(&self) -> &[u8] {
        self.current.as_ref().map_or(&[], |current| &current.record)
    }

    /// Makes the next plane open a period, as soon as the rate has room for one.
    pub fn request_intra(&mut self) {
        if let Some(current) = &mut self.current {
            current.encoder.request_intra();
        }
    }

    /// Ends the stream, and gives what ends it, behind planes that are ready: mostly one; none before a hand has been seen. A
    /// hand that comes later begins another.
    ///
    /// # Errors
    /// As [`Self::push`]; planes that are ready come with the next call.
    pub fn finish(&mut self) -> Result<Vec<LivePlane>, PosesToStreamError> {
        self.end()?;
        Ok(std::mem::take(&mut self.ready))
    }

    /// Ends the stream; what ends it is then ready.
    fn end(&mut self) -> Result<(), PosesToStreamError> {
        let Some(current) = self.current.take() else { return Ok(()) };
        self.ready.extend(cut(&current.encoder.finish()?.bytes));
        Ok(())
    }
}

impl Current {
    /// Puts the planes that are ready at the end of `ready`, those before an error as well.
    fn push(
        &mut self,
        time: f64,
        given: [Option<&TimedPose>; 2],
        latest: &[Option<HandPose>; 2],
        ready: &mut Vec<LivePlane>,
    ) -> Result<(), PosesToStreamError> {
        let tick = ((time - self.start) * self.encoder.rate()).round() as u64;
        // Without a pose of each hand all would wait until there is one.
        let begun = self.tick.is_some();
        let held = |side: Side| latest[side as usize].clone().filter(|_| !begun);
        let next = self.tick.map_or(0, |last| last.saturating_add(1));
        if next > tick.saturating_add(AHEAD) {
            return Ok(());
        }
        let tick = next.max(tick);
        self.tick = Some(tick);
        let time = tick as f64 / self.encoder.rate();
        for &side in &self.hands {
            let pose = given[side as usize].cloned().unwrap_or_else(|| match held(side) {
                Some(pose) => TimedPose::new(time, pose),
                None => TimedPose::lost(time, side),
            });
            ready.extend(cut(&self.encoder.push(&TimedPose { time, ..pose })?));
        }
        Ok(())
    }
}

/// The planes of what an encoder gives of one instant: what stands for frames left out before it, or ends the stream, and from a
/// start code on the plane that begins a period.
fn cut(bytes: &[u8]) -> Vec<LivePlane> {
    let begins = |code: &[u8]| code[..3] == [0, 0, 1] && code[3] != SEQUENCE_END as u8;
    let at = bytes.windows(4).position(begins).unwrap_or(bytes.len());
    let (before, period) = bytes.split_at(at);
    let planes = [(before, false), (period, true)].into_iter().filter(|(bytes, _)| !bytes.is_empty());
    planes.map(|(bytes, opens)| LivePlane { bytes: bytes.to_vec(), opens }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PoseDecoder, PoseDecoderOptions};
    use handcast_hand::{ClipHand, JointAngle, Morphology};

    fn pose(side: Side, time: f64, bend: f64) -> TimedPose {
        TimedPose::new(time, HandPose::neutral(side).with_degrees(JointAngle::Index1Flexion, bend))
    }

    #[test]
    fn a_stream_ends_so_that_nothing_grows() {
        let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        let (mut ends, mut last) = (0, 0.0);
        for frame in 0..LONGEST + 100 {
            let time = frame as f64 / 30.0;
            let bend = 30.0 + 25.0 * (time * 3.0).sin();
            for plane in encoder.push(time, &[pose(Side::Left, time, bend)], &PoseHeader::default()).unwrap()
            {
                ends += usize::from(plane.bytes.ends_with(&[0, 0, 1, 0xb1]));
                for shown in decoder.push(&plane.bytes).unwrap() {
                    assert!(shown.time >= last && shown.pose.side == Side::Left);
                    last = shown.time;
                }
            }
        }
        assert_eq!(ends, 1);
        assert!((last - (LONGEST + 99) as f64 / 30.0).abs() < 0.1, "{last}");
    }

    /// Cameras do not keep to the rate of a stream, and what is sent keeps to their clock all the same.
    #[test]
    fn streams_keep_to_the_clock_of_the_camera() {
        for camera in [15.0, 29.0, 29.97, 30.5, 60.0, 125.0] {
            let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
            let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
            let mut last: Option<TimedPose> = None;
            for frame in 0..(60.0 * camera) as u32 {
                // A little early or late.
                let time = (f64::from(frame) + 0.3 * f64::from(frame).sin()) / camera;
                let bend = 30.0 + 25.0 * (time * 3.0).sin();
                for plane in
                    encoder.push(time, &[pose(Side::Left, time, bend)], &PoseHeader::default()).unwrap()
                {
                    for shown in decoder.push_whole(&plane.bytes).unwrap() {
                        assert!(last.as_ref().is_none_or(|last| shown.time > last.time));
                        let late = time - shown.time;
                        let off = shown.pose.angle(JointAngle::Index1Flexion).to_degrees()
                            - (30.0 + 25.0 * (shown.time * 3.0).sin());
                        assert!(
                            late > -0.05 && off.abs() < 6.0,
                            "{camera}/s: {late} s late, {off}° off at {time}"
                        );
                        last = Some(shown);
                    }
                }
            }
            assert!(last.is_some_and(|last| (last.time - 60.0).abs() < 0.2), "{camera}/s");
        }
    }

    /// A tracker gives the poses of pictures that waited for an open hand together.
    #[test]
    fn poses_that_waited_come_one_behind_the_other() {
        let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        let waited: Vec<_> =
            (0..10).map(|n| pose(Side::Right, f64::from(n) / 30.0, f64::from(n) * 5.0)).collect();
        let planes = encoder.push(7.3, &waited, &PoseHeader::default()).unwrap();
        let shown: Vec<_> =
            planes.iter().flat_map(|plane| decoder.push_whole(&plane.bytes).unwrap()).collect();
        assert_eq!(shown.len(), 10);
        for (given, shown) in waited.iter().zip(&shown) {
            assert!((given.time - shown.time).abs() < 1e-6);
            let off =
                given.pose.angle(JointAngle::Index1Flexion) - shown.pose.angle(JointAngle::Index1Flexion);
            assert!(off.to_degrees().abs() < 1.0, "{off}");
        }
    }

    /// Of an instant in which one hand cannot be coded what was ready comes later, with what ends the stream at the latest.
    #[test]
    fn nothing_that_is_ready_is_lost() {
        let bent = |time: f64| pose(Side::Left, time, 1e9);
        for ended in [false, true] {
            let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
            let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
            let mut shown = Vec::new();
            let known = PoseHeader::default();
            for frame in 0..30 {
                let time = f64::from(frame) / 30.0;
                for plane in encoder.push(time, &[pose(Side::Left, time, f64::from(frame))], &known).unwrap()
                {
                    shown.extend(decoder.push_whole(&plane.bytes).unwrap());
                }
            }
            // The last of what waited cannot be coded, as its period begins.
            let mut waited: Vec<TimedPose> =
                (30..150).map(|n| pose(Side::Left, f64::from(n) / 30.0, f64::from(n % 40))).collect();
            waited.push(bent(5.0));
            assert!(encoder.push(5.0, &waited, &known).is_err());
            if ended {
                for plane in encoder.finish().unwrap() {
                    assert_eq!(plane.opens, plane.bytes.starts_with(&[0, 0, 1]));
                    shown.extend(decoder.push(&plane.bytes).unwrap());
                }
                assert!(encoder.finish().unwrap().is_empty());
            } else {
                for plane in encoder.push(5.1, &[pose(Side::Left, 5.1, 3.0)], &known).unwrap() {
                    shown.extend(decoder.push_whole(&plane.bytes).unwrap());
                }
            }
            let last = shown.last().map_or(0.0, |pose| pose.time);
            assert!(shown.len() >= 150 && last > 4.9, "{} up to {last} s", shown.len());
        }
    }

    /// A tone that becomes known begins another stream while one hand is away: nobody waits for that hand.
    #[test]
    fn a_stream_that_begins_while_a_hand_is_away_opens_at_once() {
        let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        for frame in 0..60 {
            let time = f64::from(frame) / 30.0;
            let bend = f64::from(frame);
            let both = [pose(Side::Left, time, bend), pose(Side::Right, time, 40.0)];
            let poses = if frame < 30 { &both[..] } else { &both[..1] };
            let known = PoseHeader { skin_tone: (frame >= 40).then_some(4), ..PoseHeader::default() };
            let planes = encoder.push(time, poses, &known).unwrap();
            if frame == 40 {
                assert_eq!(planes.iter().map(|plane| plane.opens).collect::<Vec<_>>(), [false, true]);
            }
            let shown: Vec<_> =
                planes.iter().flat_map(|plane| decoder.push_whole(&plane.bytes).unwrap()).collect();
            let [left, right] = [Side::Left, Side::Right]
                .map(|side| shown.iter().filter(|pose| pose.pose.side == side).count());
            assert!(frame != 40 || (left, right) == (1, 1), "{left}, {right}");
            let right = shown.iter().filter(|pose| pose.pose.side == Side::Right);
            for pose in right {
                let off = pose.pose.angle(JointAngle::Index1Flexion).to_degrees() - 40.0;
                assert!(off.abs() < 1.0, "{frame}: {off}");
            }
            assert_eq!(encoder.lost(), [false, frame >= 30]);
        }
    }

    /// Poses that cannot be coded are none that a stream begins with, or that others wait for.
    #[test]
    fn a_stream_begins_without_what_is_refused() {
        let right = |frame: u32| pose(Side::Right, f64::from(frame) / 30.0, f64::from(frame));
        for [bend, before] in [[f64::NAN, 0.0], [1e9, 0.0], [f64::NAN, 1.0], [1e9, 1.0]] {
            let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
            let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
            let before = before as u32 * 15;
            let mut shown = Vec::new();
            for frame in 0..60 {
                let time = f64::from(frame) / 30.0;
                let refused = frame == before;
                let poses = match refused {
                    true => vec![right(frame), pose(Side::Left, time, bend)],
                    false => vec![right(frame)],
                };
                let planes = encoder.push(time, &poses, &PoseHeader::default());
                assert_eq!(planes.is_err(), refused, "{bend} at {before}: {frame}");
                for plane in planes.unwrap_or_default() {
                    shown.extend(decoder.push_whole(&plane.bytes).unwrap());
                }
                assert!(refused || encoder.hands() == [Side::Right]);
            }
            assert!(shown.len() >= 58, "{bend} at {before}: {}", shown.len());
            assert!(shown.iter().all(|pose| pose.pose.side == Side::Right));
        }
    }

    /// What a consumer begins at begins a period, also among planes that waited for the end.
    #[test]
    fn planes_that_wait_for_the_end_keep_to_their_periods() {
        let own = LivePoseEncoderOptions::default();
        let plan = PlanOptions { intra_seconds: 2.0, ..own.plan };
        let mut encoder = LivePoseEncoder::new(own.with_plan(plan));
        let known = PoseHeader::default();
        // Instants that came in one push, the last of which cannot be coded.
        let mut waited: Vec<TimedPose> =
            (0..400).map(|n| pose(Side::Left, f64::from(n) / 30.0, f64::from(n % 40))).collect();
        waited.push(pose(Side::Left, 14.0, 1e9));
        assert!(encoder.push(14.0, &waited, &known).is_err());
        let planes = encoder.finish().unwrap();
        let opening = planes.iter().filter(|plane| plane.opens).count();
        assert!((5..=12).contains(&opening), "{opening}");
        assert!(planes[0].opens && planes[planes.len() - 1].bytes.ends_with(&[0, 0, 1, 0xb1]));
        for plane in planes.iter().filter(|plane| plane.opens) {
            let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
            assert!(!decoder.push_whole(&plane.bytes).unwrap().is_empty());
        }
    }

    #[test]
    fn bytes_are_cut_where_a_period_begins() {
        let plane = |code: u8| [&[0, 0, 1, code][..], &[7; 5]].concat();
        let told = |bytes: &[u8]| -> Vec<(usize, bool)> {
            cut(bytes).iter().map(|plane| (plane.bytes.len(), plane.opens)).collect()
        };
        let header = [plane(0xb0), plane(0xb2), plane(0xb5), plane(0xba)].concat();
        assert_eq!(told(&[]), []);
        assert_eq!(told(&[7; 3]), [(3, false)]);
        assert_eq!(told(&plane(0xb1)), [(9, false)]);
        assert_eq!(told(&header), [(36, true)]);
        let ended = [&[7; 3], &plane(0xb2)[..], &plane(0xbb), &plane(0xb1)].concat();
        assert_eq!(told(&ended), [(3, false), (27, true)]);
    }

    #[test]
    fn times_that_are_none_or_go_back_are_refused() {
        let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
        let mut push = |time: f64, poses: &[TimedPose]| {
            encoder.push(time, poses, &PoseHeader::default()).map_err(|error| error.to_string())
        };
        assert!(push(f64::NAN, &[]).unwrap_err().starts_with("encode: the time of instant 0 is NaN s"));
        push(1.0, &[pose(Side::Left, 1.0, 5.0)]).unwrap();
        assert!(push(f64::INFINITY, &[]).unwrap_err().contains("instant 2 is inf s"));
        let said = push(0.5, &[pose(Side::Left, 0.5, 5.0)]).unwrap_err();
        assert!(said.contains("instant 3 is 0.5 s") && said.contains("from 1 s on"), "{said}");
        let back = [pose(Side::Left, 1.2, 5.0), pose(Side::Left, 1.1, 5.0)];
        assert!(push(1.2, &back).unwrap_err().contains("a pose of instant 4 is 1.1 s"));
        assert!(push(1.3, &[pose(Side::Left, f64::NAN, 5.0)]).unwrap_err().contains("NaN"));
        push(1.3, &[pose(Side::Left, 1.3, 5.0)]).unwrap();
    }

    #[test]
    fn a_time_too_far_ahead_binds_none_behind_it() {
        let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
        let mut push = |time: f64| encoder.push(time, &[pose(Side::Left, time, 5.0)], &PoseHeader::default());
        push(1.0).unwrap();
        for far in [9e3, 1e300] {
            let said = push(far).unwrap_err().to_string();
            assert!(said.contains("65535 ticks"), "{said}");
            push(1.0 + 1e-3 * far.log10()).unwrap();
        }
        let options = PoseEncoderOptions::live(30.0).with_hands(&[Side::Left]);
        let mut encoder = PoseEncoder::new(options).unwrap();
        encoder.push(&pose(Side::Left, 0.0, 5.0)).unwrap();
        encoder.push(&pose(Side::Left, 5e3, 5.0)).unwrap_err();
        encoder.push(&pose(Side::Left, 0.1, 6.0)).unwrap();
    }

    #[test]
    fn sizes_that_were_said_once_travel_with_later_streams() {
        let mut encoder = LivePoseEncoder::new(LivePoseEncoderOptions::default());
        let hand = ClipHand { side: Side::Left, morphology: Some(Morphology::average(0.17)) };
        let known = PoseHeader { hands: vec![hand], ..PoseHeader::default() };
        encoder.push(0.0, &[pose(Side::Left, 0.0, 10.0)], &known).unwrap();
        let record = encoder.record().to_vec();
        assert!(!record.is_empty());
        assert_eq!(encoder.finish().unwrap().len(), 1);
        assert!(encoder.record().is_empty() && encoder.finish().unwrap().is_empty());
        encoder.push(0.1, &[pose(Side::Left, 0.1, 10.0)], &PoseHeader::default()).unwrap();
        assert_eq!(encoder.record(), record);
    }
}
