//! Poses that come one by one to the bytes of a stream.

use std::collections::VecDeque;

use handcast_fba::bap::{BapFrame, BapMask};

use handcast_fba::plan::{ClipEncoder, PlanOptions, PlanReport, Target, TimedBapFrame, relay};
use handcast_fba::{EncodeError, FrameRate};
use handcast_hand::{ClipHand, HandPose, PoseClip, Side, TimedPose};

use crate::clip::{clip_rate, hands_of};
use crate::error::PosesToStreamError;
use crate::gains::for_hands;
use crate::mapping::{PoseMapper, Profile, hand_mask};
use crate::person::record_of;
use crate::tips::{Places, TipError, TipMeter};

/// How poses are encoded.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PoseEncoderOptions {
    /// Where position and rotation of a hand travel.
    pub profile: Profile,
    /// What is aimed at, and whether poses are coded when they come. Its rate, ties, gains and anchors are not used.
    pub plan: PlanOptions,
    /// The hands whose poses will come: one, or left and right.
    pub hands: Vec<Side>,
    /// Hands whose sizes are known: they travel in the stream's record, if it has no other.
    pub sizes: Vec<ClipHand>,
    /// The tone of the skin, 1 to 10, where it is known: it travels in the same record.
    pub skin_tone: Option<u8>,
    /// Frames per second of the stream; the nearest sixteenth is written, or that nearest to a multiple
    /// ([`FrameRate::carrying`]).
    pub rate: f64,
}

impl Default for PoseEncoderOptions {
    /// The right hand at 30 frames/s, with [`Profile::Hand`] and [`PlanOptions::default`].
    fn default() -> Self {
        Self {
            profile: Profile::default(),
            plan: PlanOptions::default(),
            hands: vec![Side::Right],
            sizes: Vec::new(),
            skin_tone: None,
            rate: 30.0,
        }
    }
}

impl PoseEncoderOptions {
    /// The defaults (the right hand alone) at `rate` frames per second, each pose coded when it comes, with a start code at
    /// every I plane.
    pub fn live(rate: f64) -> Self {
        let plan = PlanOptions { live: true, resync: true, ..PlanOptions::default() };
        Self { rate, plan, ..Self::default() }
    }

    /// Sets where position and rotation of a hand travel.
    pub fn with_profile(self, profile: Profile) -> Self {
        Self { profile, ..self }
    }

    /// Sets the planner's options.
    pub fn with_plan(self, plan: PlanOptions) -> Self {
        Self { plan, ..self }
    }

    /// Sets the hands.
    pub fn with_hands(self, hands: &[Side]) -> Self {
        Self { hands: hands.to_vec(), ..self }
    }

    /// Sets the hands whose sizes are known.
    pub fn with_sizes(self, sizes: &[ClipHand]) -> Self {
        Self { sizes: sizes.to_vec(), ..self }
    }

    /// Sets the tone of the skin.
    pub fn with_skin_tone(self, skin_tone: Option<u8>) -> Self {
        Self { skin_tone, ..self }
    }

    /// Sets the frames per second.
    pub fn with_rate(self, rate: f64) -> Self {
        Self { rate, ..self }
    }
}

/// Millimetres that a fingertip is off at most where each joint is off by a degree at most, to begin with.
const TIP_MM_PER_DEGREE: f64 = 4.8;
/// Plans tried to keep fingertips within a bound, the share of it that is aimed at, and the share that will do.
const TIP_TRIES: usize = 8;
const TIP_MARGIN: f64 = 0.97;
const ENOUGH: f64 = 0.93;

/// The bytes a stream ends with, its account, and how far its fingertips are off.
type Finished = (Vec<u8>, PlanReport, Option<TipError>);

/// Encodes poses as they come.
///
/// A hand that is lost (`valid` false), or of which no pose comes at an instant, keeps its last valid pose; before its
/// first valid pose it already has that one. Where a gap is bridged ([`Absence::Bridged`](handcast_hand::Absence::Bridged)) it
/// goes by the pose on the way, which counts in no error. Poses are put on the ticks of the stream's clock, which begins with the
/// first of them; those of two hands on one tick share a plane.
///
/// Live ([`PlanOptions::live`]) the pose that makes a tick complete gives the bytes of its plane, from the moment on at
/// which every hand has had a valid pose: poses before wait for it. Where hands come and go before a camera,
/// [`LivePoseEncoder`](crate::LivePoseEncoder) makes encoders for those that are there. With look-ahead nothing comes
/// before the end.
///
/// ```
/// use handcast_codec::{PoseDecoder, PoseDecoderOptions, PoseEncoder, PoseEncoderOptions};
/// use handcast_fba::plan::PlanOptions;
/// use handcast_hand::{HandPose, JointAngle, Side, TimedPose};
///
/// let plan = PlanOptions { live: true, ..PlanOptions::default() };
/// let mut encoder = PoseEncoder::new(PoseEncoderOptions::default().with_plan(plan))?;
/// let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
/// let mut poses = Vec::new();
/// for frame in 0..30 {
///     let pose = HandPose::neutral(Side::Right)
///         .with_degrees(JointAngle::Index2Flexion, 20.0 + f64::from(frame));
///     let bytes = encoder.push(&TimedPose::new(f64::from(frame) / 30.0, pose))?;
///     poses.extend(decoder.push(&bytes)?); // at the other end of the wire
/// }
/// let end = encoder.finish()?;
/// poses.extend(decoder.push(&end.bytes)?);
/// poses.extend(decoder.finish()?);
/// assert_eq!(poses.len(), 30);
/// assert!(end.report.max_degrees <= 2.5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct PoseEncoder {
    front: Front,
    encoder: ClipEncoder,
    back: Back,
    /// Frames of the pose in hand.
    frames: Vec<Frame>,
    /// Bytes to be handed out.
    bytes: Vec<u8>,
    /// Millimetres that fingertips may be off, where plans are tried until they are not.
    tip_mm: Option<f64>,
}

/// The end of a stream.
#[derive(Clone, Debug)]
pub struct EncodedEnd {
    /// The bytes that pushes have not given yet: with look-ahead, the whole stream.
    pub bytes: Vec<u8>,
    /// What the stream costs and how far off it is, where hands have valid poses.
    pub report: PlanReport,
    /// How far its fingertips are off; none of a stream in which no hand moves.
    pub tips: Option<TipError>,
    /// Poses of all hands that were interpolated in gaps.
    pub bridged: usize,
}

impl PoseEncoder {
    /// An encoder at the start of a stream.
    ///
    /// # Errors
    /// A rate that a stream cannot have, no hands, a parameter of the planner outside its range.
    pub fn new(options: PoseEncoderOptions) -> Result<Self, PosesToStreamError> {
        let (rate, _) =
            FrameRate::carrying(options.rate).ok_or(PosesToStreamError::Rate { rate: options.rate })?;
        if options.hands.is_empty() {
            let allowed = "1 or 2";
            return Err(EncodeError::Parameter { what: "number of hands", value: 0.0, allowed }.into());
        }
        let mut plan = PlanOptions { rate, ..for_hands(options.plan) };
        if plan.record.is_empty() {
            let told = |hand: &&ClipHand| options.hands.contains(&hand.side);
            let sizes: Vec<ClipHand> = options.sizes.iter().filter(told).cloned().collect();
            plan.record = record_of(&sizes, options.skin_tone);
        }
        let meter = TipMeter::new(options.profile, &options.sizes, &plan.record);
        Ok(Self {
            front: Front::new(Holder::new(&options.hands, options.profile), rate.per_second()),
            encoder: ClipEncoder::new(&plan)?,
            back: Back { meter, places: Vec::new() },
            frames: Vec::new(),
            bytes: Vec::new(),
            tip_mm: match plan.mode {
                Target::TipError(mm) if !plan.live => Some(mm),
                _ => None,
            },
        })
    }

    /// An encoder for the hands and the rate of a clip ([`clip_rate`]), which takes
    /// [`poses_on_ticks`](crate::poses_on_ticks) of it at [`Self::rate`].
    ///
    /// # Errors
    /// [`PosesToStreamError::Empty`] for a clip without poses; [`PosesToStreamError::NotFinite`];
    /// [`PosesToStreamError::Time`] where a hand's poses go back; as [`Self::new`].
    pub fn for_clip(
        clip: &PoseClip,
        profile: Profile,
        plan: &PlanOptions,
    ) -> Result<Self, PosesToStreamError> {
        clip.frames.iter().enumerate().try_for_each(|(i, pose)| PosesToStreamError::check(i, pose))?;
        let mut last: [Option<f64>; 2] = [None; 2];
        for (index, pose) in clip.frames.iter().enumerate() {
            let before = last[pose.pose.side as usize].replace(pose.time);
            if before.is_some_and(|before| pose.time < before) {
                return Err(PosesToStreamError::Time { what: "pose", index, time: pose.time, before });
            }
        }
        let (hands, rate) = (hands_of(clip), clip_rate(clip));
        if hands.is_empty() {
            return Err(PosesToStreamError::Empty { frames: clip.frames.len() });
        }
        let seen = |hand: &&ClipHand| clip.of(hand.side).any(|frame| frame.valid);
        let sizes = clip.header.hands.iter().filter(seen).cloned().collect();
        let skin_tone = clip.header.skin_tone;
        Self::new(PoseEncoderOptions { profile, plan: *plan, hands, sizes, skin_tone, rate })
    }

    /// Frames per second of the stream.
    pub fn rate(&self) -> f64 {
        self.front.rate
    }

    /// Takes the next pose and gives the bytes that are ready. Poses come in order of time, those of two hands in any
    /// order within a tick. Of poses that come faster than the stream's ticks those for which there is none are left out.
    /// Live, the last bits of a plane may share a byte with the plane after it, and come with that, unless
    /// [`PlanOptions::aligned`].
    ///
    /// # Errors
    /// A pose of a hand that was not announced, a time that goes back or on too far, live a value that cannot be
    /// coded: that tick is left out. Bytes that are ready come with the next call; the encoder stays usable.
    pub fn push(&mut self, pose: &TimedPose) -> Result<Vec<u8>, PosesToStreamError> {
        self.front.take(pose)?;
        self.code()?;
        Ok(std::mem::take(&mut self.bytes))
    }

    /// Takes all poses of a clip and gives the bytes that are ready: the same as [`Self::push`] of one behind the other. Poses
    /// become frames, and fingertips are measured, on another core than the one that codes.
    ///
    /// # Errors
    /// As [`Self::push`], the first; poses behind one that is refused are not taken, and those behind one that cannot be coded
    /// only where they have become frames meanwhile.
    pub fn push_all(
        &mut self,
        poses: impl IntoIterator<Item = TimedPose, IntoIter: Send>,
    ) -> Result<Vec<u8>, PosesToStreamError> {
        let mut poses = poses.into_iter();
        let Self { front, encoder, back, bytes, .. } = self;
        let mut more: Result<bool, PosesToStreamError> = Ok(true);
        let mut written = Ok(());
        relay(
            |batch: &mut Batch| {
                batch.frames.drain(..).for_each(|frame| back.note(&frame));
                // What has become frames is coded and measured whatever is refused.
                if matches!(more, Ok(true)) {
                    more = if batch.failed { Ok(false) } else { front.fill(&mut poses, &mut batch.frames) };
                }
                !batch.frames.is_empty()
            },
            |batch| {
                let done = code(encoder, &mut batch.frames, bytes);
                batch.failed = done.is_err();
                if written.is_ok() {
                    written = done;
                }
            },
        );
        written?;
        more?;
        Ok(std::mem::take(&mut self.bytes))
    }

    /// Live, makes the next plane an I plane, as soon as the rate has room for one: see
    /// [`ClipEncoder::request_intra`].
    pub fn request_intra(&mut self) {
        self.encoder.request_intra();
    }

    /// Codes the frames that are known, and measures how far off they are.
    fn code(&mut self) -> Result<(), EncodeError> {
        let mut written = Ok(());
        while self.front.give(&mut self.frames) {
            written = written.and(code(&mut self.encoder, &mut self.frames, &mut self.bytes));
            self.frames.drain(..).for_each(|frame| self.back.note(&frame));
        }
        written
    }

    /// Ends the stream. Of two hands one that has had no valid pose is left out.
    ///
    /// # Errors
    /// [`PosesToStreamError::Empty`] when no hand has had a valid pose; with look-ahead, a value that cannot be coded.
    pub fn finish(mut self) -> Result<EncodedEnd, PosesToStreamError> {
        self.front.end_moment();
        self.code()?;
        self.front.holder.settle();
        self.code()?;
        if !self.front.holder.is_complete() {
            return Err(PosesToStreamError::Empty { frames: self.front.poses });
        }
        let bridged = self.front.holder.bridged;
        let (rest, report, tips) = match self.tip_mm {
            Some(mm) => self.aimed(mm)?,
            None => finished(self.encoder, self.back)?,
        };
        self.bytes.extend(rest);
        Ok(EncodedEnd { bytes: self.bytes, report, tips, bridged })
    }

    /// The cheapest of the plans tried that keeps fingertips within so many millimetres, or the one that comes nearest.
    fn aimed(&self, mm: f64) -> Result<Finished, EncodeError> {
        let mut degrees = mm / TIP_MM_PER_DEGREE;
        let mut best: Option<(f64, Finished)> = None;
        let mut bounds = [0.0, f64::INFINITY];
        for _ in 0..TIP_TRIES {
            let aimed = self.encoder.aimed_at(Target::MaxError(degrees))?;
            let tried = finished(aimed, self.back.clone());
            let tried = match (tried, best.is_some()) {
                // Finer than any quantiser.
                (Err(_), true) => break,
                (tried, _) => tried?,
            };
            let (most, sizes) = tried.2.map_or((0.0, 0.0), |tips| (tips.max_mm, tips.sizes_mm));
            let off = most / mm;
            bounds[usize::from(off > 1.0)] = degrees;
            let better = best.as_ref().is_none_or(|(best, plan)| match (off <= 1.0, *best <= 1.0) {
                (true, true) => tried.1.bytes < plan.1.bytes,
                (fits, fitted) => fits || !fitted && off < *best,
            });
            if better {
                best = Some((off, tried));
            }
            if (ENOUGH..=1.0).contains(&off) {
                break;
            }
            // What the sizes make is there however finely angles are coded.
            let room = (TIP_MARGIN * mm - sizes) / (most - sizes).max(1e-9);
            let next = degrees * if room > 0.0 { room } else { TIP_MARGIN / off }.clamp(0.3, 3.0);
            let inside = (bounds[0]..bounds[1]).contains(&next) && next > bounds[0];
            degrees = if inside { next } else { (bounds[0] * bounds[1]).sqrt() };
        }
        best.map(|(_, plan)| plan).ok_or(EncodeError::NoIntra)
    }
}

fn finished(encoder: ClipEncoder, back: Back) -> Result<Finished, EncodeError> {
    let Back { mut meter, places } = back;
    let none = &meter;
    let (rest, report, compared) = encoder.finish_compared(|first, frames| {
        let mut meter = none.clone();
        let places = places.iter().skip(first);
        frames
            .zip(places)
            .for_each(|([given, coded], place)| meter.add(place, [&given, &coded], &BapMask::EMPTY));
        meter
    })?;
    compared.iter().for_each(|more| meter.merge(more));
    Ok((rest, report, meter.error()))
}

/// A frame on its way through an encoder.
#[derive(Clone, Debug)]
struct Frame {
    given: TimedBapFrame,
    /// Values of hands that have no valid pose then.
    held: BapMask,
    /// What rounding took.
    place: Places,
    /// What a decoder has of it, once it is coded; none where it waits for the end.
    coded: Option<BapFrame>,
}

/// Codes frames, and leaves out those for which there is no tick and those that cannot be coded, which do not keep others from
/// it; the first of them is the error.
fn code(encoder: &mut ClipEncoder, frames: &mut Vec<Frame>, bytes: &mut Vec<u8>) -> Result<(), EncodeError> {
    let mut first = None;
    frames.retain_mut(|frame| {
        if encoder.is_ahead(frame.given.time) {
            return false;
        }
        match encoder.push_held(&frame.given, &frame.held) {
            Ok(ready) => bytes.extend(ready),
            Err(error) => {
                first.get_or_insert(error);
                return false;
            }
        }
        frame.coded = encoder.reconstruction().copied();
        true
    });
    first.map_or(Ok(()), Err)
}

/// What becomes of frames behind the encoder.
#[derive(Clone, Debug)]
struct Back {
    meter: TipMeter,
    /// What rounding takes from each frame that waits for the end.
    places: Vec<Places>,
}

impl Back {
    fn note(&mut self, frame: &Frame) {
        let Frame { given, held, place, coded } = frame;
        match coded {
            Some(coded) => self.meter.add(place, [&given.baps, coded], held),
            None => self.places.push(*place),
        }
    }
}

/// Frames that are made at a time, while others are coded.
const BATCH: usize = 128;

/// Frames on their way round.
#[derive(Default)]
struct Batch {
    frames: Vec<Frame>,
    /// Whether one of them could not be coded.
    failed: bool,
}

/// Makes frames of poses.
#[derive(Clone, Debug)]
struct Front {
    holder: Holder,
    /// Frames per second.
    rate: f64,
    /// Time of the first pose, seconds.
    start: Option<f64>,
    /// The tick that more poses may come for, and the hands whose poses have.
    moment: Option<(f64, Moment)>,
    given: [bool; 2],
    /// Time of the last pose of each hand, and the latest tick of any.
    last: [Option<f64>; 2],
    latest: Option<f64>,
    /// Poses given, those refused included, and those that were not.
    offered: usize,
    poses: usize,
}

impl Front {
    fn new(holder: Holder, rate: f64) -> Self {
        Self {
            holder,
            rate,
            start: None,
            moment: None,
            given: [false; 2],
            last: [None; 2],
            latest: None,
            offered: 0,
            poses: 0,
        }
    }

    /// Takes poses until there is a batch of frames; false where there are no more.
    fn fill(
        &mut self,
        poses: &mut impl Iterator<Item = TimedPose>,
        frames: &mut Vec<Frame>,
    ) -> Result<bool, PosesToStreamError> {
        loop {
            self.give(frames);
            if frames.len() >= BATCH {
                return Ok(true);
            }
            let Some(pose) = poses.next() else { return Ok(false) };
            self.take(&pose)?;
        }
    }

    /// Adds the frames that are known, up to a batch of them in all; whether there are any then.
    fn give(&mut self, frames: &mut Vec<Frame>) -> bool {
        let profile = self.holder.profile;
        while frames.len() < BATCH
            && let Some(ready) = self.holder.next()
        {
            frames.push(ready.into_frame(profile));
        }
        !frames.is_empty()
    }

    /// Takes the next pose.
    fn take(&mut self, pose: &TimedPose) -> Result<(), PosesToStreamError> {
        let side = pose.pose.side;
        if !self.holder.has(side) {
            return Err(PosesToStreamError::Hand { side });
        }
        let index = self.offered;
        self.offered += 1;
        PosesToStreamError::check(index, pose)?;
        self.poses += 1;
        let time = pose.time - *self.start.get_or_insert(pose.time);
        let tick = (time * self.rate).round();
        let before = self.last[side as usize];
        if before.is_some_and(|before| pose.time < before) || self.latest.is_some_and(|latest| tick < latest)
        {
            let before = self.last.iter().flatten().copied().reduce(f64::max);
            return Err(PosesToStreamError::Time { what: "pose", index, time: pose.time, before });
        }
        if self.latest.is_some_and(|latest| tick - latest > handcast_fba::plan::MAX_GAP as f64) {
            let allowed = "times at most 65535 ticks after that of the pose before";
            return Err(EncodeError::Time { frame: index as u64, time: pose.time, allowed }.into());
        }
        self.last[side as usize] = Some(pose.time);
        self.latest = Some(tick);
        if self.given[side as usize] || self.moment.as_ref().is_some_and(|(at, _)| *at != tick) {
            self.end_moment();
        }
        let (_, moment) = self.moment.get_or_insert_with(|| (tick, Moment::at(time)));
        moment.put(pose);
        self.given[side as usize] = true;
        if self.given == self.holder.hands {
            self.end_moment();
        }
        Ok(())
    }

    /// No more poses come for the tick that is being filled.
    fn end_moment(&mut self) {
        self.given = [false; 2];
        if let Some((_, moment)) = self.moment.take() {
            self.holder.take(moment);
        }
    }
}

/// A frame that is known.
pub(crate) struct Ready<'a> {
    time: f64,
    /// Values of hands that have no valid pose then.
    held: BapMask,
    /// What the frame is made of.
    poses: &'a [HandPose],
    mapper: &'a mut PoseMapper,
}

impl Ready<'_> {
    /// Its values.
    pub fn frame(self) -> TimedBapFrame {
        TimedBapFrame { time: self.time, baps: self.mapper.frame(self.poses) }
    }

    fn into_frame(self, profile: Profile) -> Frame {
        let given = TimedBapFrame { time: self.time, baps: self.mapper.frame(self.poses) };
        let place = Places::new(self.poses, &given.baps, profile);
        Frame { given, held: self.held, place, coded: None }
    }
}

/// An instant, and the poses of it that are valid or bridge a gap, left and right.
#[derive(Clone, Debug)]
pub(crate) struct Moment {
    /// Seconds from the first pose.
    time: f64,
    poses: [Option<Box<HandPose>>; 2],
    /// Which of them are valid.
    valid: [bool; 2],
}

impl Moment {
    pub fn at(time: f64) -> Self {
        Self { time, poses: [None, None], valid: [false; 2] }
    }

    /// Puts a pose in it, where there is anything to go by.
    pub fn put(&mut self, pose: &TimedPose) {
        let side = pose.pose.side as usize;
        if pose.is_shown() {
            self.poses[side] = Some(Box::new(pose.pose.clone()));
            self.valid[side] = pose.valid;
        }
    }
}

/// Makes a frame of BAPs of each instant. A hand that has no valid pose keeps its last one; before its first valid pose
/// it already has that one. So masks never change and no instant is dropped.
#[derive(Clone, Debug)]
pub(crate) struct Holder {
    profile: Profile,
    mapper: PoseMapper,
    /// Whether there is a left hand, and a right one.
    hands: [bool; 2],
    /// The first valid pose of each hand.
    first: [Option<Box<HandPose>>; 2],
    /// Instants that no frame has been made of yet.
    waiting: VecDeque<Moment>,
    /// The poses in force, left before right, once there is one of each hand.
    current: Vec<HandPose>,
    /// Poses that bridged a gap.
    bridged: usize,
}

impl Holder {
    pub fn new(hands: &[Side], profile: Profile) -> Self {
        Self {
            profile,
            mapper: PoseMapper::new(profile),
            hands: [Side::Left, Side::Right].map(|side| hands.contains(&side)),
            first: [None, None],
            waiting: VecDeque::new(),
            current: Vec::new(),
            bridged: 0,
        }
    }

    pub fn has(&self, side: Side) -> bool {
        self.hands[side as usize]
    }

    /// Whether every hand has had a valid pose.
    pub fn is_complete(&self) -> bool {
        !self.current.is_empty()
    }

    /// Takes the next instant.
    pub fn take(&mut self, moment: Moment) {
        if !self.is_complete() {
            for (hand, first) in self.first.iter_mut().enumerate() {
                if first.is_none() && moment.valid[hand] {
                    first.clone_from(&moment.poses[hand]);
                }
            }
            if (0..2).all(|hand| self.hands[hand] == self.first[hand].is_some()) {
                self.begin();
            }
        }
        self.waiting.push_back(moment);
    }

    /// No more instants come: goes without a hand that has had no valid pose, where there is another one.
    pub fn settle(&mut self) {
        if !self.is_complete() {
            self.hands = self.first.each_ref().map(Option::is_some);
            self.begin();
        }
    }

    fn begin(&mut self) {
        self.current = self.first.iter().flatten().map(|pose| (**pose).clone()).collect();
    }

    /// The next frame that is known.
    pub fn next(&mut self) -> Option<Ready<'_>> {
        if !self.is_complete() {
            return None;
        }
        self.waiting.pop_front().map(|moment| self.frame(moment))
    }

    /// The frame of an instant.
    fn frame(&mut self, moment: Moment) -> Ready<'_> {
        let mut held = BapMask::EMPTY;
        for slot in &mut self.current {
            let hand = slot.side as usize;
            if let Some(pose) = &moment.poses[hand] {
                slot.clone_from(pose);
                self.bridged += usize::from(!moment.valid[hand]);
            }
            if !moment.valid[hand] {
                held = held.union(&hand_mask(slot.side, self.profile));
            }
        }
        Ready { time: moment.time, held, poses: &self.current, mapper: &mut self.mapper }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames take ten times the room of the instants that wait.
    #[test]
    fn instants_that_wait_become_frames_by_and_by() {
        let options = PoseEncoderOptions::live(30.0).with_hands(&[Side::Left, Side::Right]);
        let mut encoder = PoseEncoder::new(options).unwrap();
        let pose = |frame: usize, side: Side| TimedPose::new(frame as f64 / 30.0, HandPose::neutral(side));
        for frame in 0..5 * BATCH {
            assert!(encoder.push(&pose(frame, Side::Right)).unwrap().is_empty());
        }
        assert!(encoder.push(&pose(5 * BATCH, Side::Left)).unwrap().is_empty());
        assert!(!encoder.push(&pose(5 * BATCH, Side::Right)).unwrap().is_empty());
        assert!(encoder.frames.capacity() <= BATCH);
        assert_eq!(encoder.finish().unwrap().report.frames as usize, 5 * BATCH + 1);
    }
}
