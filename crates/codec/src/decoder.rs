//! The bytes of a stream to poses, as they come.

use handcast_fba::bap::{Bap, BapFrame, BapMask, derive};
use handcast_fba::{DecodedFrame, Decoder, DecoderOptions, PlaneKind, SyntaxError};
use handcast_hand::{ClipHand, HandPose, Morphology, PoseHeader, Side, TimedPose};
use handcast_limits::{DEFAULT, Limits};

use crate::damage::Damage;
use crate::error::{StreamToPosesError, is_passed_over};
use crate::guard::{Reach, follow};
use crate::mapping::{
    Profile, anchor_baps, global_baps, old_global_baps, pose_from_frame, sides, wrist_baps,
};
use crate::person::{differ, hands_of_record, skin_tone_of_record};
use crate::ties::hand_ties;
use crate::timeline::Timeline;

/// How a stream is decoded to poses.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PoseDecoderOptions {
    /// How its planes are decoded, and whether the hand model fills in what is not sent.
    pub decoder: DecoderOptions,
    /// Where position and rotation of a hand travel; none takes extension BAPs if any of a hand are sent, else the
    /// wrist's.
    pub profile: Option<Profile>,
    /// BAPs that the stream is known to send sooner or later.
    pub sent: BapMask,
    /// Most poses that the bytes of one call may make; a plane beyond it is refused.
    pub poses_at_once: usize,
    /// Most instants of a stream that is decoded as a whole.
    pub instants: usize,
    /// Whether poses that no hand takes, and leaps of the wrist, count as damage where damage is passed over
    /// ([`DecoderOptions::conceal`]): values are then not believed before the next I plane. Where joints of a sound stream
    /// have been, or two I planes in a row say that they are, they are believed.
    pub guarded: bool,
}

impl Default for PoseDecoderOptions {
    /// The decoder's defaults, guarded; at most as many poses at once as [`Limits::instants`].
    fn default() -> Self {
        Self {
            decoder: DecoderOptions::default(),
            profile: None,
            sent: BapMask::EMPTY,
            poses_at_once: DEFAULT.instants as usize,
            instants: DEFAULT.instants as usize,
            guarded: true,
        }
    }
}

impl PoseDecoderOptions {
    /// Sets how planes are decoded.
    pub fn with_decoder(self, decoder: DecoderOptions) -> Self {
        Self { decoder, ..self }
    }

    /// Sets where position and rotation of a hand travel.
    pub fn with_profile(self, profile: Option<Profile>) -> Self {
        Self { profile, ..self }
    }

    /// Sets the BAPs that the stream is known to send sooner or later: what that tells of hands, profile and angles left
    /// to the hand model then holds from the first plane on.
    pub fn with_sent(self, sent: BapMask) -> Self {
        Self { sent, ..self }
    }

    /// Sets how many poses the bytes of one call may make.
    pub fn with_poses_at_once(self, poses_at_once: usize) -> Self {
        Self { poses_at_once, ..self }
    }

    /// Sets how many poses the bytes of one call, and instants all of them, may make.
    pub fn with_limits(self, limits: &Limits) -> Self {
        let instants = usize::try_from(limits.instants).unwrap_or(usize::MAX);
        Self { poses_at_once: instants, instants, ..self }
    }

    /// Sets whether poses that no hand takes count as damage.
    pub fn with_guarded(self, guarded: bool) -> Self {
        Self { guarded, ..self }
    }
}

/// Decodes a stream to the poses of every hand it moves, as its bytes come.
///
/// Each plane gives a pose of each hand. Ticks that the encoder skipped repeat the pose before; the plane before them
/// says how many they are, and gives them with its own. How the bytes are cut makes no difference to what comes out in
/// the end.
///
/// What a stream sends shows plane by plane: a hand has poses from the plane on that first gives one of its joint
/// angles, and is taken to leave an angle to the hand model as long as none has been sent. Where all of the stream is at
/// hand, [`decode_poses`](crate::decode_poses) knows the latter from the start.
///
/// Bytes that begin in the middle of a stream are passed over up to its next I plane ([`Self::passed_over`]); streams
/// that follow one another come out as one, in which each shows the hands that it sends. With [`DecoderOptions::conceal`] a hand keeps its last pose from damage on
/// to the next I plane: on each tick between, not valid, with a confidence that fades from 1 to 0 in [`FADE`] seconds.
#[derive(Clone, Debug)]
pub struct PoseDecoder {
    options: PoseDecoderOptions,
    decoder: Decoder,
    /// BAPs sent so far, by any stream, those known beforehand included; and what of them each stream has sent, by its
    /// number.
    sent: BapMask,
    by_stream: Vec<(usize, BapMask)>,
    /// Whether those of streams that have ended are kept.
    keeps: bool,
    /// What each stream is known to send sooner or later, from decoding it before.
    foreseen: Vec<(usize, BapMask)>,
    /// Number of the stream that is decoded, the BAPs that it is known to send, and those sent so far.
    stream: usize,
    known: BapMask,
    seen: BapMask,
    /// The hands of the stream, and those of all so far.
    present: Vec<Side>,
    hands: Vec<Side>,
    profile: Profile,
    derived: BapMask,
    /// What streams that have ended left to the hand model.
    derived_before: BapMask,
    /// Poses of the plane before.
    held: Option<Held>,
    /// Poses to be handed out.
    poses: Vec<TimedPose>,
    /// Room for the poses of a plane.
    spare: Vec<HandPose>,
    totals: PlaneTotals,
    damage: Damage,
    reach: Reach,
    /// Whether the last I plane was taken for damage for its joint angles.
    doubted: bool,
    revised: bool,
    timeline: Timeline,
    /// Sizes of each hand that streams have told so far, the first and the last ones, and whether any were seen to be others
    /// than the first.
    sizes: [Option<[Morphology; 2]>; 2],
    resized: [bool; 2],
    /// What was wrong before the first plane.
    before: Option<SyntaxError>,
}

/// Seconds in which the confidence in a held pose fades.
pub const FADE: f64 = 1.0;
/// Longest time after damage that is filled with held poses, seconds.
const LONGEST_HOLD: f64 = 10.0;

/// The poses of a plane.
#[derive(Clone, Debug)]
struct Held {
    /// Seconds.
    time: f64,
    /// Frames per second behind it.
    rate: f64,
    /// Seconds of the plane that told the poses.
    told: f64,
    /// Seconds up to which planes without damage hold them.
    good: f64,
    valid: bool,
    poses: Vec<HandPose>,
}

/// What the planes of a stream add up to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct PlaneTotals {
    /// Planes, held ones that stand in for damage included.
    pub planes: usize,
    /// I planes among them.
    pub intra_planes: usize,
    /// Bits of all planes, start codes between them left out.
    pub bits: u64,
    /// Least and largest quantiser index.
    pub quants: Option<[u8; 2]>,
    /// Seconds of the first plane, and of the last frame that the last plane stands for.
    pub times: Option<[f64; 2]>,
}

impl PlaneTotals {
    fn add(&mut self, plane: &DecodedFrame, time: f64, rate: f64) {
        self.planes += 1;
        self.intra_planes += usize::from(plane.kind == PlaneKind::Intra);
        self.bits += plane.end_bit.saturating_sub(plane.first_bit);
        let [least, most] = self.quants.unwrap_or([plane.quant; 2]);
        self.quants = Some([least.min(plane.quant), most.max(plane.quant)]);
        let last = time + f64::from(plane.skipped) / rate;
        self.times = Some([self.times.map_or(time, |[first, _]| first), last]);
    }
}

impl PoseDecoder {
    /// A decoder at the start of a stream.
    pub fn new(options: PoseDecoderOptions) -> Self {
        let mut decoder = Self {
            decoder: Decoder::new(options.decoder),
            sent: BapMask::EMPTY,
            by_stream: Vec::new(),
            keeps: false,
            foreseen: Vec::new(),
            stream: 0,
            known: BapMask::EMPTY,
            seen: BapMask::EMPTY,
            present: Vec::new(),
            hands: Vec::new(),
            profile: Profile::default(),
            derived: BapMask::EMPTY,
            derived_before: BapMask::EMPTY,
            held: None,
            poses: Vec::new(),
            spare: Vec::new(),
            totals: PlaneTotals::default(),
            damage: Damage::default(),
            reach: Reach::default(),
            doubted: false,
            revised: false,
            timeline: Timeline::default(),
            sizes: [None, None],
            resized: [false; 2],
            before: None,
            options,
        };
        decoder.learn(decoder.options.sent);
        decoder
    }

    /// The same, to be asked for another one [`again`](Self::again).
    pub(crate) fn keeping(self) -> Self {
        Self { keeps: true, ..self }
    }

    /// A decoder of a stream that another one has decoded: what that learnt of it holds from the first plane on.
    pub(crate) fn again(self) -> Self {
        let mut decoder = Self::new(self.options).keeping();
        decoder.foreseen = self.by_stream;
        decoder.foresee();
        decoder
    }

    /// Takes the next bytes of the stream, and gives the poses that are known now.
    ///
    /// # Errors
    /// What is wrong with the stream. Poses known before it come with the next call, and decoding goes on at the next
    /// start code with an I plane behind it: `push(&[])` resumes with what is there. With
    /// [`DecoderOptions::conceal`] nothing but the limits is an error behind the first plane: of bytes beyond
    /// [`SyntaxError::BufferLimit`] nothing is taken, of a plane beyond [`StreamToPosesError::TooManyPoses`] no pose.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Vec<TimedPose>, StreamToPosesError> {
        self.decoder.push(bytes)?;
        self.drain()?;
        Ok(std::mem::take(&mut self.poses))
    }

    /// As [`Self::push`], of bytes that end with a plane, as a transport that sends planes one by one knows: its poses
    /// do not wait for what follows.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn push_whole(&mut self, bytes: &[u8]) -> Result<Vec<TimedPose>, StreamToPosesError> {
        self.decoder.push_whole(bytes)?;
        self.drain()?;
        Ok(std::mem::take(&mut self.poses))
    }

    /// Says that no more bytes come, and gives the poses still missing.
    ///
    /// # Errors
    /// As [`Self::push`]; besides [`StreamToPosesError::NoPlane`] and [`StreamToPosesError::NoHand`].
    pub fn finish(&mut self) -> Result<Vec<TimedPose>, StreamToPosesError> {
        self.decoder.finish();
        self.drain()?;
        let planes = self.totals.planes;
        match (planes, self.hands.is_empty()) {
            (0, _) => Err(self.before.take().map_or(StreamToPosesError::NoPlane, Into::into)),
            (_, true) => Err(StreamToPosesError::NoHand { planes }),
            _ => Ok(std::mem::take(&mut self.poses)),
        }
    }

    /// The hands seen so far, with the sizes of each that a stream has told last; the tone of skin that the stream in force has
    /// told, and its rate.
    pub fn header(&self) -> PoseHeader {
        let mut header = header_of(&self.hands, self.rate());
        let mut told = hands_of_record(self.decoder.record());
        for hand in &mut header.hands {
            let now = told.iter_mut().find(|told| told.side == hand.side);
            let before = self.sizes[hand.side as usize].as_ref().map(|[_, last]| last);
            hand.morphology = now.and_then(|told| told.morphology.take()).or_else(|| before.cloned());
        }
        header.skin_tone = skin_tone_of_record(self.decoder.record());
        header
    }

    /// The hands seen so far.
    pub fn hands(&self) -> &[Side] {
        &self.hands
    }

    /// Frames per second in force.
    pub fn rate(&self) -> f64 {
        self.decoder.rate().per_second()
    }

    /// Where position and rotation of a hand travel, as far as planes have shown.
    pub fn profile(&self) -> Profile {
        self.profile
    }

    /// The same as the masks of the planes tell, whatever the options say; `None` where neither travels.
    pub fn carried_profile(&self) -> Option<Profile> {
        carried_profile(&self.sent)
    }

    /// BAPs that are not sent, but filled in by the hand model, as far as planes have shown.
    pub fn derived(&self) -> BapMask {
        self.derived_before.union(&self.derived)
    }

    /// BAPs sent so far.
    pub fn sent(&self) -> BapMask {
        self.sent
    }

    /// What the planes so far add up to.
    pub fn totals(&self) -> PlaneTotals {
        self.totals
    }

    /// Damage that was passed over, with [`DecoderOptions::conceal`].
    pub fn damage(&self) -> &Damage {
        &self.damage
    }

    /// Whether a plane has told something of the profile or the hand model's part that would have changed poses of planes
    /// before it: decoded again with what is [`sent`](PoseDecoderOptions::sent) they come out so.
    pub fn is_revised(&self) -> bool {
        self.revised
    }

    /// Bytes before the first plane, where they began in the middle of a stream or with damage.
    pub fn passed_over(&self) -> Option<u64> {
        self.decoder.joined().map(|bit| bit / 8)
    }

    /// Streams that were decoded one behind the other, and bytes behind the last that begin no further one.
    pub fn streams(&self) -> (u32, u64) {
        (self.decoder.objects(), self.decoder.trailing())
    }

    /// The hands of which streams one behind the other tell sizes that a viewer sees to be different (a joint is off by more
    /// than 2 mm along one axis, a bone or the hand in length): the header has those that were told last.
    pub fn resized(&self) -> Vec<Side> {
        [Side::Left, Side::Right].into_iter().filter(|&side| self.resized[side as usize]).collect()
    }

    /// Whether values are not to be believed: between damage and the next I plane.
    pub fn is_lost(&self) -> bool {
        self.held.as_ref().is_some_and(|held| !held.valid)
    }

    /// Says that bytes were lost here, and gives what poses that tells of: see [`Decoder::lose`].
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn lose(&mut self) -> Result<Vec<TimedPose>, StreamToPosesError> {
        self.decoder.lose();
        self.push(&[])
    }

    /// Whether the end code, or the end of the data, has been reached.
    pub fn is_ended(&self) -> bool {
        self.decoder.is_ended()
    }

    fn drain(&mut self) -> Result<(), StreamToPosesError> {
        let before = self.poses.len();
        loop {
            let wary = self.before.is_some() || self.options.decoder.conceal;
            match self.decoder.next_frame() {
                Ok(Some(plane)) => self.take(plane, before)?,
                Ok(None) => {
                    self.damage.abandoned = self.decoder.abandoned();
                    return Ok(());
                }
                Err(error) if self.totals.planes == 0 && is_passed_over(&error, wary) => {
                    self.before.get_or_insert(error);
                }
                Err(error) if self.options.decoder.conceal && self.totals.planes > 0 => {
                    self.damage.add(error)
                }
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Takes in a plane of a call that found so many poses waiting `before`.
    fn take(&mut self, mut plane: DecodedFrame, before: usize) -> Result<(), StreamToPosesError> {
        let stream = self.decoder.objects() as usize;
        if stream != self.stream {
            self.begin(stream);
        }
        self.learn(plane.baps.mask);
        let wary = self.options.decoder.conceal;
        let time = self.timeline.place(&plane, self.rate(), wary);
        let room = std::mem::take(&mut self.spare);
        let poses = self.poses_of(&plane, room);
        if wary
            && self.options.guarded
            && plane.damage.is_none()
            && !self.is_plausible(&poses, time, plane.kind)
        {
            self.decoder.distrust();
            plane.damage = Some(SyntaxError::Implausible { bit: plane.first_bit });
        }
        let limit = self.options.poses_at_once;
        let ticks = self.ticks_before(time);
        let more = (ticks as usize)
            .saturating_add(plane.skipped as usize)
            .saturating_add(1)
            .saturating_mul(self.present.len());
        if (self.poses.len() - before).saturating_add(more) > limit {
            return Err(StreamToPosesError::TooManyPoses { limit });
        }
        self.hold(ticks);
        let (rate, valid) = (self.rate(), plane.damage.is_none());
        self.totals.add(&plane, time, rate);
        if let Some(error) = plane.damage {
            self.damage.add(error);
        }
        let mut held = match self.held.take() {
            Some(held) if !valid => {
                self.spare = poses;
                Held { time, rate, valid, ..held }
            }
            held => {
                self.spare = held.map_or_else(Vec::new, |held| held.poses);
                Held { time, rate, told: time, good: time, valid, poses }
            }
        };
        self.poses.extend((0..=plane.skipped).flat_map(|tick| held.at(tick)));
        let behind = f64::from(plane.skipped) / rate;
        held.time += behind;
        if valid {
            held.good += behind;
        }
        self.held = Some(held);
        Ok(())
    }

    /// Whether `poses`, at `time` seconds, can be those of the hands so far. Those of sound streams may leap, and go beyond
    /// the joints' limits by and by; where some of it was damaged already that is suspicious. I planes do not build on what
    /// was before, and two of them in a row, or the first plane, are believed any angle.
    fn is_plausible(&mut self, poses: &[HandPose], time: f64, kind: PlaneKind) -> bool {
        let sound = self.damage.count() == 0;
        let intra = kind == PlaneKind::Intra;
        let within = self.reach.holds(poses);
        let told = !within && intra && (self.held.is_none() || self.doubted);
        if intra {
            self.doubted = !within && !told;
        }
        if told || (within && sound) {
            self.reach.widen(poses);
        }
        let before = self.held.as_ref().filter(|held| held.valid && !sound && !intra);
        told || (within && before.is_none_or(|held| follow(&held.poses, poses, time - held.told)))
    }

    /// The poses of a plane, in room that is not needed any more.
    fn poses_of(&self, plane: &DecodedFrame, mut room: Vec<HandPose>) -> Vec<HandPose> {
        let derive = !self.derived.is_empty();
        let hand = |&side: &Side| hand_of(&plane.baps, &self.known, derive, side, self.profile);
        room.clear();
        room.extend(self.present.iter().filter_map(hand));
        room
    }

    /// Ticks that no plane stands for between damage and a plane at `time`.
    fn ticks_before(&self, time: f64) -> u32 {
        match &self.held {
            Some(held) if !held.valid => {
                let gap = (time - held.time).min(LONGEST_HOLD);
                ((gap * held.rate).round() as u32).saturating_sub(1)
            }
            _ => 0,
        }
    }

    /// Repeats the poses of the plane before at so many ticks.
    fn hold(&mut self, ticks: u32) {
        if let Some(held) = &self.held {
            self.poses.extend((1..=ticks).flat_map(|tick| held.at(tick)));
        }
    }

    /// Takes in that another stream begins, of this number.
    fn begin(&mut self, stream: usize) {
        self.stream = stream;
        for told in hands_of_record(self.decoder.record()) {
            let side = told.side as usize;
            let Some(sizes) = told.morphology else { continue };
            let first = self.sizes[side].take().map_or_else(|| sizes.clone(), |[first, _]| first);
            self.resized[side] |= differ(&first, &sizes);
            self.sizes[side] = Some([first, sizes]);
        }
        self.derived_before = self.derived_before.union(&self.derived);
        self.present.clear();
        (self.known, self.seen) = (BapMask::EMPTY, BapMask::EMPTY);
        self.learn(self.options.sent);
        self.foresee();
    }

    /// Takes in what the stream is known to send sooner or later.
    fn foresee(&mut self) {
        let found = self.foreseen.binary_search_by_key(&self.stream, |(stream, _)| *stream);
        if let Some((_, foreseen)) = found.ok().and_then(|place| self.foreseen.get(place)) {
            self.known = self.known.union(foreseen);
        }
        self.tell();
    }

    /// Takes in that the stream sends the BAPs of `mask`.
    fn learn(&mut self, mask: BapMask) {
        if mask.difference(&self.seen).is_empty() {
            return;
        }
        let before = (self.derived, self.profile);
        let some = !self.seen.is_empty();
        self.seen = self.seen.union(&mask);
        self.sent = self.sent.union(&mask);
        match self.by_stream.last_mut() {
            Some((stream, seen)) if *stream == self.stream => *seen = self.seen,
            _ => {
                if !self.keeps {
                    self.by_stream.clear();
                }
                self.by_stream.push((self.stream, self.seen));
            }
        }
        self.present = sides(&self.seen).collect();
        self.hands = sides(&self.sent).collect();
        let more = !mask.difference(&self.known).is_empty();
        self.known = self.known.union(&mask);
        if more {
            self.tell();
            // Whatever else is sent from now on was 0 before, with or without the hand model.
            let overruled = !before.0.intersection(&self.seen).is_empty();
            self.revised |= some && (overruled || before.1 != self.profile);
        }
    }

    /// What follows from the BAPs that the stream is known to send.
    fn tell(&mut self) {
        self.profile = self.options.profile.unwrap_or_else(|| told_profile(&self.known));
        if !self.options.decoder.sent_only {
            self.derived = derive::left_to_model(hand_ties(), &self.known);
        }
    }
}

impl Held {
    fn at(&self, tick: u32) -> impl Iterator<Item = TimedPose> + '_ {
        let time = self.time + f64::from(tick) / self.rate;
        let confidence = (!self.valid).then(|| (1.0 - (time - self.good) / FADE).clamp(0.0, 1.0));
        self.poses.iter().map(move |pose| TimedPose {
            valid: self.valid,
            confidence,
            ..TimedPose::new(time, pose.clone())
        })
    }
}

pub(crate) fn header_of(hands: &[Side], rate: f64) -> PoseHeader {
    let hands = hands.iter().map(|&side| ClipHand { side, morphology: None }).collect();
    PoseHeader { rate: Some(rate), hands, ..PoseHeader::default() }
}

/// Extension BAPs when there are any of a hand, else the wrist's.
pub(crate) fn told_profile(all: &BapMask) -> Profile {
    carried_profile(all).unwrap_or(Profile::Hand)
}

/// The same; `None` where neither is sent.
fn carried_profile(all: &BapMask) -> Option<Profile> {
    let has = |baps: &[Bap]| baps.iter().any(|&b| all.contains(b));
    let extension = sides(all)
        .any(|side| has(&global_baps(side)) || has(&anchor_baps(side)) || has(&old_global_baps(side)));
    let wrist = sides(all).any(|side| has(&wrist_baps(side)));
    if extension { Some(Profile::Hand) } else { wrist.then_some(Profile::Arm) }
}

/// The pose of one hand; a BAP of `all` that is masked off keeps the last value it had.
pub(crate) fn hand_of(
    frame: &BapFrame,
    all: &BapMask,
    derive: bool,
    side: Side,
    profile: Profile,
) -> Option<HandPose> {
    let mut frame = BapFrame::with_values(*all, *frame.values());
    if derive {
        derive::fill_in(hand_ties(), &mut frame);
    }
    pose_from_frame(&frame, side, profile)
}
