//! Whole clips to streams and back.

use std::borrow::Borrow;

use handcast_fba::bap::{BapFrames, BapMask, TimedBapFrame, derive};
use handcast_fba::plan::{PlanOptions, PlanReport};
use handcast_fba::{DecodedFrame, Decoder, DecoderOptions, FrameRate, Record, SyntaxError};
use handcast_hand::{Bridged, MAX_FRAMES, MAX_GAP, PoseClip, Side, TimedPose};
use handcast_limits::{Excess, Limit, Limits};

use crate::beat::rate_of_rounded;
use crate::damage::Damage;
use crate::decoder::{PlaneTotals, PoseDecoder, PoseDecoderOptions, hand_of, header_of, told_profile};
use crate::encoder::{Holder, Moment, PoseEncoder, Ready};
use crate::error::{PosesToStreamError, StreamToPosesError, is_passed_over};
use crate::mapping::{Profile, sides};
use crate::person::{differ, hands_of_record};
use crate::ties::hand_ties;
use crate::tips::TipError;

/// The hands of which a clip has poses, left before right.
pub(crate) fn hands_of(clip: &PoseClip) -> Vec<Side> {
    let has = |side: &Side| clip.of(*side).next().is_some();
    [Side::Left, Side::Right].into_iter().filter(has).collect()
}

/// The BAP frames of a clip, one for each instant at which any of its hands has a pose.
///
/// A hand that is lost, or has no pose at an instant, keeps its last valid pose, but where a gap is bridged
/// ([`Absence::Bridged`](handcast_hand::Absence::Bridged)); before its first valid
/// pose it already has that one. So the masks never change and no frame is dropped. One that has none at all is left out.
///
/// # Errors
/// [`PosesToStreamError::Empty`] when no hand has a valid pose.
pub fn bap_frames(clip: &PoseClip, profile: Profile) -> Result<Vec<TimedBapFrame>, PosesToStreamError> {
    let mut order: Vec<&TimedPose> = clip.frames.iter().collect();
    order.sort_by(|a, b| a.time.total_cmp(&b.time));
    let start = order.first().map_or(0.0, |f| f.time);
    let mut holder = Holder::new(&hands_of(clip), profile);
    let mut frames = Vec::new();
    for group in order.chunk_by(|a, b| b.time - a.time < 1e-6) {
        let mut moment = Moment::at(group[0].time - start);
        group.iter().for_each(|timed| moment.put(timed));
        holder.take(moment);
        frames.extend(std::iter::from_fn(|| holder.next().map(Ready::frame)));
    }
    holder.settle();
    frames.extend(std::iter::from_fn(|| holder.next().map(Ready::frame)));
    if holder.is_complete() {
        Ok(frames)
    } else {
        Err(PosesToStreamError::Empty { frames: clip.frames.len() })
    }
}

/// The frame rate of a clip: what its header says, else that of the times of its first hand that has two, else 30. It is the
/// beat that rounded times have (milliseconds, say), else the inverse of the median interval.
pub fn clip_rate(clip: &PoseClip) -> f64 {
    if let Some(rate) = clip.header.rate {
        return rate;
    }
    let told = clip.header.hands.iter().map(|hand| hand.side);
    let rate = |side: Side| {
        let times: Vec<f64> = clip.of(side).map(|f| f.time).collect();
        let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).collect();
        steps.sort_by(f64::total_cmp);
        let rough = 1.0 / steps.get(steps.len() / 2)?;
        Some(rate_of_rounded(&times, rough).unwrap_or(rough))
    };
    told.chain([Side::Right, Side::Left]).find_map(rate).unwrap_or(30.0)
}

/// The clip on the even ticks of a stream of `rate` frames per second, from 0. Clips with the beat of that rate keep their
/// poses, each on the tick nearest to it, and where frames were dropped the ticks stay empty; others, such as recordings
/// with uneven times, are interpolated at the ticks. Gaps of up to `max_gap` seconds are bridged then ([`Bridged`]); of 0 none.
pub fn on_ticks(clip: &PoseClip, rate: f64, max_gap: f64) -> PoseClip {
    let mut out = PoseClip { header: clip.header.clone(), frames: Vec::with_capacity(clip.frames.len()) };
    out.header.rate = Some(rate);
    out.frames.extend(tracks_on_ticks(clip, rate, max_gap).into_iter().flatten());
    out
}

/// The poses of [`on_ticks`] one by one, in order of time: as a [`PoseEncoder`] takes them.
pub fn poses_on_ticks(
    clip: &PoseClip,
    rate: f64,
    max_gap: f64,
) -> impl Iterator<Item = TimedPose> + Send + '_ {
    let [mut left, mut right] = tracks_on_ticks(clip, rate, max_gap).map(Iterator::peekable);
    std::iter::from_fn(move || match (left.peek(), right.peek()) {
        (Some(l), Some(r)) if r.time < l.time => right.next(),
        (Some(_), _) => left.next(),
        _ => right.next(),
    })
}

/// Whether [`on_ticks`] keeps the poses of a clip as they are, but for one in some hundreds where its clock is faster than the
/// ticks.
pub fn poses_keep(clip: &PoseClip, rate: f64) -> bool {
    own_ticks_of(clip, rate).iter().all(Result::is_ok)
}

/// A while in which a hand has no poses, between two of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// Time of the pose before, seconds.
    pub from: f64,
    /// Time of the pose behind, seconds.
    pub to: f64,
    /// Poses that are missing, at least one.
    pub frames: usize,
}

impl Gap {
    /// From one of its frames to the next, seconds.
    pub fn step(&self) -> f64 {
        (self.to - self.from) / (self.frames + 1) as f64
    }
}

/// How many steps neighbouring poses must be apart for one to be missing between them.
const GAP: f64 = 1.5;
/// Of uneven times, which share of the intervals is no gap.
const USUAL: f64 = 0.9;

/// The gaps in the poses of a hand, in order: intervals of more than 1.5 steps, which are those of the clip's rate, or, where
/// its times are uneven, as long as all but a tenth of the hand's intervals.
pub fn gaps(clip: &PoseClip, side: Side) -> Vec<Gap> {
    let mut times: Vec<f64> = clip.of(side).map(|frame| frame.time).collect();
    times.sort_by(f64::total_cmp);
    let rate = clip_rate(clip);
    let step = if poses_keep(clip, rate) {
        1.0 / rate
    } else {
        let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps.get((USUAL * steps.len() as f64) as usize).copied().unwrap_or_default().max(1.0 / rate)
    };
    let wide = times.windows(2).filter(|pair| pair[1] - pair[0] > GAP * step);
    let gap = |pair: &[f64]| {
        let frames = ((pair[1] - pair[0]) / step).round() as usize - 1;
        Gap { from: pair[0], to: pair[1], frames }
    };
    wide.map(gap).collect()
}

/// A tick of its own for each pose of the left hand, and of the right one, or where they are in ticks. Poses of one instant have
/// one tick, whichever hand they are of.
fn own_ticks_of(clip: &PoseClip, rate: f64) -> [Result<Vec<Option<f64>>, Vec<f64>>; 2] {
    let times: Vec<(f64, Side)> = clip.frames.iter().map(|f| (f.time, f.pose.side)).collect();
    let start = times.iter().map(|(time, _)| *time).fold(f64::INFINITY, f64::min);
    let tick = |time: f64| (time - start) * rate;
    let mut all: Vec<f64> = times.iter().map(|(time, _)| tick(*time)).collect();
    all.sort_by(f64::total_cmp);
    all.dedup_by(|b, a| *b - *a < 1e-6 * rate);
    let shared = own_ticks(&all);
    [Side::Left, Side::Right].map(|side| {
        let own = times.iter().filter(|(_, of)| *of == side).map(|(time, _)| tick(*time));
        if let Some(ticks) = &shared {
            // Those of a hand are among those of the clip: each at the one before, or the next, mostly.
            let mut near = 0;
            let at = |t: f64| {
                let is_before = |a: &f64| *a < t - 1e-6 * rate;
                let is_first = |&n: &usize| {
                    all[..n].last().is_none_or(is_before) && !all[n..].first().is_some_and(is_before)
                };
                let next = (near..all.len().min(near + 2)).find(is_first);
                near = next.unwrap_or_else(|| all.partition_point(is_before));
                ticks.get(near).copied().flatten()
            };
            return Ok(own.map(at).collect());
        }
        // Hands that come at different times.
        let own: Vec<f64> = own.collect();
        own_ticks(&own).ok_or(own)
    })
}

/// The poses of each hand on the ticks, with gaps bridged.
pub(crate) fn tracks_on_ticks(
    clip: &PoseClip,
    rate: f64,
    max_gap: f64,
) -> [Bridged<'static, Box<dyn Iterator<Item = TimedPose> + Send + '_>>; 2] {
    let [left, right] = own_ticks_of(clip, rate);
    let step = ticks_a_frame(clip, rate).map_or(1.0, f64::from) / rate;
    [(Side::Left, left), (Side::Right, right)].map(|(side, ticks)| {
        let track: Box<dyn Iterator<Item = _> + Send> = match ticks {
            Ok(own) => {
                let at = move |(f, tick): (&TimedPose, Option<f64>)| {
                    tick.map(|k| TimedPose { time: k / rate, ..f.clone() })
                };
                Box::new(clip.of(side).zip(own).filter_map(at))
            }
            Err(ticks) => {
                let delay = ticks.first().map_or(0.0, |tick| tick.round() / rate);
                let resampled = clip.resampled(side, rate, f64::INFINITY);
                Box::new(resampled.into_iter().map(move |f| TimedPose { time: f.time + delay, ..f }))
            }
        };
        Bridged::new(track, step, max_gap)
    })
}

/// How many ticks there are to a frame of the clip where a stream of `rate` frames per second carries it since none can have
/// its own rate: those between frames miss no pose.
pub(crate) fn ticks_a_frame(clip: &PoseClip, rate: f64) -> Option<u32> {
    let (carrying, ticks) = FrameRate::carrying(clip_rate(clip))?;
    (ticks > 1 && carrying.per_second() == rate).then_some(ticks)
}

/// How far a pose is from the tick that it has, at most, seconds; of clips that keep their poses.
pub(crate) fn farthest_tick(clip: &PoseClip, rate: f64) -> f64 {
    let start = clip.frames.iter().map(|f| f.time).fold(f64::INFINITY, f64::min);
    let hands = [Side::Left, Side::Right].into_iter().zip(own_ticks_of(clip, rate));
    let off = hands.flat_map(|(side, ticks)| {
        let ticks = ticks.unwrap_or_default().into_iter();
        clip.of(side).zip(ticks).filter_map(move |(f, tick)| Some((tick? / rate - (f.time - start)).abs()))
    });
    off.fold(0.0, f64::max)
}

/// How far an interval may be from a multiple of a tick, and a pose from its own tick, in ticks.
const UNEVEN: f64 = 0.25;
const FAR: f64 = 0.75;
/// How much slower or faster the clock may be, as a share.
const BESIDE: f64 = 0.005;
/// Share of the intervals that may be further off; poses of which one may go without a tick.
const FEW: f64 = 0.05;
const PER_DROPPED: usize = 500;

/// A tick of its own for each of the instants (in ticks, in order), where they have the beat of the ticks. A clock that is a
/// little faster than the ticks has an instant too many now and then.
fn own_ticks(instants: &[f64]) -> Option<Vec<Option<f64>>> {
    let steps = || instants.windows(2).map(|w| w[1] - w[0]);
    let uneven = steps().filter(|step| (step - step.round().max(1.0)).abs() > UNEVEN).count();
    let drift: f64 = steps().map(|step| step - step.round().max(1.0)).sum();
    let count = instants.len() as f64;
    if uneven as f64 > FEW * count || drift.abs() > (BESIDE * count).max(FAR) {
        return None;
    }
    let mut next = 0.0f64;
    let own: Vec<Option<f64>> = instants
        .iter()
        .map(|&instant| {
            let tick = instant.round().max(next);
            (tick - instant <= FAR).then(|| {
                next = tick + 1.0;
                tick
            })
        })
        .collect();
    let dropped = own.iter().filter(|tick| tick.is_none()).count();
    (dropped * PER_DROPPED <= own.len()).then_some(own)
}

/// A clip as a stream.
#[derive(Clone, Debug)]
pub struct EncodedClip {
    /// The stream.
    pub stream: Vec<u8>,
    /// What it costs and how far off it is.
    pub report: PlanReport,
    /// How far its fingertips are off; none of a stream in which no hand moves.
    pub tips: Option<TipError>,
    /// What was encoded: the clip on the ticks of the stream, with gaps bridged.
    pub clip: PoseClip,
    /// Poses of all hands that were interpolated in gaps.
    pub bridged: usize,
}

/// Encodes a clip with look-ahead (or frame by frame, as `options.live` says), on the even ticks of its
/// own rate ([`clip_rate`], [`on_ticks`]); `options.rate` is not used. With look-ahead gaps of up to [`MAX_GAP`] are bridged.
///
/// # Errors
/// See [`PosesToStreamError`].
pub fn encode_poses(
    clip: &PoseClip,
    profile: Profile,
    options: &PlanOptions,
) -> Result<EncodedClip, PosesToStreamError> {
    encode_bridged(clip, profile, options, MAX_GAP)
}

/// As [`encode_poses`], with gaps of up to `max_gap` seconds bridged; of 0 none, and live neither, where what comes behind a gap
/// is not known.
///
/// # Errors
/// See [`PosesToStreamError`].
pub fn encode_bridged(
    clip: &PoseClip,
    profile: Profile,
    options: &PlanOptions,
    max_gap: f64,
) -> Result<EncodedClip, PosesToStreamError> {
    let max_gap = if options.live { 0.0 } else { max_gap };
    let mut encoder = PoseEncoder::for_clip(clip, profile, options)?;
    let times = || clip.frames.iter().map(|f| f.time);
    let seconds = times().fold(f64::NEG_INFINITY, f64::max) - times().fold(f64::INFINITY, f64::min);
    if seconds * encoder.rate() >= MAX_FRAMES as f64 {
        return Err(PosesToStreamError::Span { seconds, rate: encoder.rate() });
    }
    let mut stream = encoder.push_all(poses_on_ticks(clip, encoder.rate(), max_gap))?;
    let clip = on_ticks(clip, encoder.rate(), max_gap);
    let end = encoder.finish()?;
    stream.extend(end.bytes);
    Ok(EncodedClip { stream, report: end.report, tips: end.tips, clip, bridged: end.bridged })
}

/// A decoded stream.
#[derive(Clone, Debug)]
pub struct DecodedStream {
    /// The poses, one for each hand and tick of the stream's clock from the first plane on; ticks that the
    /// encoder skipped repeat the pose before.
    pub clip: PoseClip,
    /// What its planes add up to.
    pub totals: PlaneTotals,
    /// Frames per second of the stream.
    pub rate: f64,
    /// How position and rotation of the hand travelled.
    pub profile: Profile,
    /// The same as the masks of its planes tell, whatever the options say; `None` where neither travels.
    pub carried: Option<Profile>,
    /// BAPs that were not sent, but filled in by the hand model.
    pub derived: BapMask,
    /// Damage that was passed over, with `conceal`; else none.
    pub damage: Damage,
    /// Bytes before the first plane, where the data begin in the middle of a stream or with damage.
    pub passed_over: Option<u64>,
    /// Streams that follow one another, as one clip.
    pub streams: u32,
    /// Bytes behind the last stream's end code that begin no further one.
    pub trailing: u64,
    /// The hands of which these streams tell different sizes ([`PoseDecoder::resized`]): the header has those that were told
    /// last.
    pub resized: Vec<Side>,
}

/// The BAPs of a whole stream.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct DecodedBaps {
    /// Those of every plane that could be decoded, with `conceal` held ones for those that could not; behind them what the
    /// last plane stands for at the end, if frames are skipped after it.
    pub frames: BapFrames,
    /// Number of planes.
    pub planes: usize,
    /// Frames per second.
    pub rate: f64,
    /// What travelled with the stream; see [`hands_of_record`](crate::hands_of_record).
    pub record: Record,
    /// Damage that was passed over, with `conceal`.
    pub damage: Damage,
    /// Bytes before the first plane, where the data begin in the middle of a stream or with damage.
    pub passed_over: Option<u64>,
    /// Streams that follow one another.
    pub streams: u32,
    /// Bytes behind the last stream's end code that begin no further one.
    pub trailing: u64,
    /// The hands of which these streams tell different sizes: the record is the last stream's.
    pub resized: Vec<Side>,
}

/// Bytes of a stream that a decoder is given at a time.
const PIECE: usize = 1 << 16;

/// Decodes every plane of a whole stream.
///
/// # Errors
/// The first error of the decoder; with `options.conceal` nothing after the first plane is an error.
pub fn decode_planes(bytes: &[u8], options: DecoderOptions) -> Result<Vec<DecodedFrame>, SyntaxError> {
    let mut planes = Vec::new();
    each_plane(bytes, options, |_, plane| {
        planes.push(plane);
        Ok::<(), SyntaxError>(())
    })?;
    Ok(planes)
}

/// Decodes the BAPs of a whole stream of no more planes than allowed instants.
///
/// # Errors
/// Those of [`decode_planes`], and [`StreamToPosesError::TooManyPoses`].
pub fn decode_baps(
    bytes: &[u8],
    options: DecoderOptions,
    limits: &Limits,
) -> Result<DecodedBaps, StreamToPosesError> {
    let limit = usize::try_from(limits.instants).unwrap_or(usize::MAX);
    let (mut found, mut last) = (DecodedBaps::default(), None);
    let mut records: Vec<Record> = Vec::new();
    let (decoder, damage) = each_plane(bytes, options, |decoder, plane| {
        if !records.contains(decoder.record()) && records.len() < MAX_RECORDS {
            records.push(*decoder.record());
        }
        if found.planes == limit {
            return Err(StreamToPosesError::TooManyPoses { limit });
        }
        found.planes += 1;
        let frame = TimedBapFrame { time: plane.time, baps: plane.baps };
        found.frames.push(&frame);
        last = Some((frame, plane.skipped));
        Ok(())
    })?;
    found.rate = decoder.rate().per_second();
    if let Some((frame, skipped @ 1..)) = last {
        found.frames.push(&TimedBapFrame { time: frame.time + f64::from(skipped) / found.rate, ..frame });
    }
    found.record = *decoder.record();
    found.damage = damage;
    found.passed_over = decoder.joined().map(|bit| bit / 8);
    found.streams = decoder.objects();
    found.trailing = decoder.trailing();
    found.resized = resized(&records);
    Ok(found)
}

/// Records of joined streams that are compared with one another.
const MAX_RECORDS: usize = 64;

/// The hands of which these records tell different sizes.
fn resized(records: &[Record]) -> Vec<Side> {
    let differs = |side: &Side| {
        let hands = records.iter().flat_map(hands_of_record).filter(|hand| hand.side == *side);
        let mut sizes = hands.filter_map(|hand| hand.morphology);
        sizes.next().is_some_and(|first| sizes.any(|other| differ(&first, &other)))
    };
    [Side::Left, Side::Right].into_iter().filter(differs).collect()
}

/// Gives `take` every plane of a whole stream, until it refuses one: the decoder at the end, and what was passed over.
fn each_plane<E: From<SyntaxError>>(
    bytes: &[u8],
    options: DecoderOptions,
    mut take: impl FnMut(&Decoder, DecodedFrame) -> Result<(), E>,
) -> Result<(Decoder, Damage), E> {
    let (mut decoder, mut damage) = (Decoder::new(options), Damage::default());
    let (mut before, mut any, mut ended) = (None, false, false);
    let mut pieces = bytes.chunks(PIECE);
    loop {
        match decoder.next_frame() {
            Ok(Some(plane)) => {
                any = true;
                plane.damage.iter().for_each(|error| damage.add(error.clone()));
                take(&decoder, plane)?;
            }
            Ok(None) => match pieces.next() {
                Some(piece) => decoder.push(piece)?,
                None if ended => break,
                None => {
                    decoder.finish();
                    ended = true;
                }
            },
            Err(error) if !any && is_passed_over(&error, before.is_some() || options.conceal) => {
                before.get_or_insert(error);
            }
            Err(error) if !any || !options.conceal => return Err(error.into()),
            Err(error) => damage.add(error),
        }
    }
    damage.abandoned = decoder.abandoned();
    match before {
        Some(error) if !any => Err(error.into()),
        _ => Ok((decoder, damage)),
    }
}

/// Decodes a whole stream to poses of every hand it moves. `profile` tells where position and rotation
/// travelled; `None` takes extension BAPs when the stream has them, else the wrist's.
///
/// What any plane of a stream tells of the profile and of angles left to the hand model holds from its first plane on; its
/// hands are there from the plane on that first sends a joint angle of theirs.
///
/// # Errors
/// See [`StreamToPosesError`].
pub fn decode_poses(
    bytes: &[u8],
    profile: Option<Profile>,
    options: DecoderOptions,
) -> Result<DecodedStream, StreamToPosesError> {
    decode_poses_within(bytes, PoseDecoderOptions::default().with_decoder(options).with_profile(profile))
}

/// As [`decode_poses`], of a stream of no more instants than the options allow.
///
/// # Errors
/// See [`StreamToPosesError`].
pub fn decode_poses_within(
    bytes: &[u8],
    options: PoseDecoderOptions,
) -> Result<DecodedStream, StreamToPosesError> {
    let most = options.instants;
    let mut decoder = PoseDecoder::new(options).keeping();
    let mut frames = decode_all(&mut decoder, bytes, most)?;
    if decoder.is_revised() {
        // Let go before as many are made again.
        drop(frames);
        decoder = decoder.again();
        frames = decode_all(&mut decoder, bytes, most)?;
    }
    Ok(DecodedStream {
        clip: PoseClip { header: decoder.header(), frames },
        totals: decoder.totals(),
        rate: decoder.rate(),
        profile: decoder.profile(),
        carried: decoder.carried_profile(),
        derived: decoder.derived(),
        damage: decoder.damage().clone(),
        passed_over: decoder.passed_over(),
        streams: decoder.streams().0,
        trailing: decoder.streams().1,
        resized: decoder.resized(),
    })
}

fn decode_all(
    decoder: &mut PoseDecoder,
    bytes: &[u8],
    most: usize,
) -> Result<Vec<TimedPose>, StreamToPosesError> {
    let mut poses: Vec<TimedPose> = Vec::new();
    let mut take = |decoder: &PoseDecoder, more: Vec<TimedPose>| {
        let hands = decoder.hands().len().max(1);
        if (poses.len() + more.len()) / hands > most {
            return Err(StreamToPosesError::TooManyPoses { limit: most });
        }
        poses.extend(more);
        Ok(())
    };
    for piece in bytes.chunks(PIECE) {
        let more = decoder.push(piece)?;
        take(decoder, more)?;
    }
    let more = decoder.finish()?;
    take(decoder, more)?;
    Ok(poses)
}

/// Longest gap between frames of BAP text that holds the frame before it, seconds.
const LONGEST_HOLD: f64 = 10.0;

/// The poses of every hand in BAP frames, from the first on that has a joint angle of it; they need not come from a stream,
/// and there are none where they move no hand. Gaps of
/// up to ten seconds hold the pose before them, on the ticks of `rate`. `profile` as for [`decode_poses`]; with
/// `derive` the hand model fills in end joints that are left to it. Gives the profile, too.
pub fn poses_from_frames(
    frames: impl IntoIterator<Item: Borrow<TimedBapFrame>> + Clone,
    rate: f64,
    profile: Option<Profile>,
    derive: bool,
) -> (PoseClip, Profile) {
    let frames = || frames.clone().into_iter();
    let all = frames().fold(BapMask::EMPTY, |mask, frame| mask.union(&frame.borrow().baps.mask));
    let hands: Vec<Side> = sides(&all).collect();
    let profile = profile.unwrap_or_else(|| told_profile(&all));
    let derive = derive && !derive::left_to_model(hand_ties(), &all).is_empty();
    let mut clip = PoseClip { header: header_of(&hands, rate), frames: Vec::new() };
    let mut times = frames().map(|frame| frame.borrow().time);
    times.next();
    let mut sent = BapMask::EMPTY;
    let mut shown: Vec<Side> = Vec::new();
    for frame in frames() {
        let frame: &TimedBapFrame = frame.borrow();
        if !frame.baps.mask.difference(&sent).is_empty() {
            sent = sent.union(&frame.baps.mask);
            shown = sides(&sent).collect();
        }
        let gap = times.next().map_or(0.0, |next| next - frame.time);
        let held = held_between(gap, rate);
        for tick in 0..=held {
            let poses = shown.iter().filter_map(|&side| hand_of(&frame.baps, &all, derive, side, profile));
            clip.frames.extend(poses.map(|pose| TimedPose::new(frame.time + f64::from(tick) / rate, pose)));
        }
    }
    (clip, profile)
}

/// As [`poses_from_frames`], of no more instants than allowed.
///
/// # Errors
/// [`Excess`] of instants, held ones included.
pub fn poses_from_frames_within(
    frames: &BapFrames,
    rate: f64,
    limits: &Limits,
) -> Result<(PoseClip, Profile), Excess> {
    let mut instants = frames.len() as f64;
    let times = || frames.times().iter();
    for (time, next) in times().zip(times().skip(1)) {
        instants += f64::from(held_between(next - time, rate));
    }
    limits.check(Limit::Instants, instants)?;
    Ok(poses_from_frames(frames, rate, None, true))
}

/// Ticks of `rate` between two frames that are `gap` seconds apart.
fn held_between(gap: f64, rate: f64) -> u32 {
    if gap <= LONGEST_HOLD { (gap * rate).round().max(1.0) as u32 - 1 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{PoseMapper, pose_from_frame};
    use handcast_fba::plan::{Target, encode_clip};
    use handcast_hand::shapes::{ShapeLibrary, Spelling, SpellingTempo};
    use handcast_hand::{ClipHand, Finger, HandPose, Joint, JointAngle, Morphology, Skeleton};
    use nalgebra::{UnitQuaternion, Vector3};

    fn clip(sides: &[Side]) -> PoseClip {
        let mut clip = PoseClip::default();
        clip.header.rate = Some(30.0);
        for i in 0..60 {
            for &side in sides {
                let t = f64::from(i) / 30.0;
                let mut pose = HandPose::neutral(side)
                    .with_degrees(JointAngle::Index1Flexion, 40.0 * (2.0 * t).sin().powi(2))
                    .with_degrees(JointAngle::Thumb1Abduction, 20.0 * t);
                pose.translation = Vector3::new(0.05 * t, 0.1, -0.6);
                pose.rotation = UnitQuaternion::from_euler_angles(0.1, 0.4 * t, 0.0);
                clip.frames.push(TimedPose::new(t, pose));
            }
        }
        clip
    }

    #[test]
    fn both_hands_come_back_at_every_frame() {
        let clip = clip(&[Side::Left, Side::Right]);
        let EncodedClip { stream, report, .. } =
            encode_poses(&clip, Profile::Hand, &PlanOptions::default()).unwrap();
        assert_eq!(report.frames, 60);
        let decoded = decode_poses(&stream, None, DecoderOptions::default()).unwrap();
        assert_eq!(decoded.profile, Profile::Hand);
        for side in [Side::Left, Side::Right] {
            let (a, b): (Vec<_>, Vec<_>) = (clip.of(side).collect(), decoded.clip.of(side).collect());
            assert_eq!(a.len(), b.len());
            for (a, b) in a.iter().zip(&b) {
                assert!((a.time - b.time).abs() < 1e-6);
                assert!((a.pose.translation - b.pose.translation).norm() < 0.03);
                assert!(a.pose.rotation.angle_to(&b.pose.rotation).to_degrees() < 4.0);
                for angle in JointAngle::ALL {
                    assert!((a.pose.angle(angle) - b.pose.angle(angle)).to_degrees().abs() < 2.6);
                }
            }
        }
    }

    #[test]
    fn a_lost_hand_holds_its_last_pose() {
        let mut clip = clip(&[Side::Right]);
        let held = clip.frames[20].pose.clone();
        for frame in &mut clip.frames[21..40] {
            frame.valid = false;
            frame.pose = HandPose::neutral(Side::Right);
        }
        let frames = bap_frames(&clip, Profile::Hand).unwrap();
        assert_eq!(frames.len(), 60);
        let back = pose_from_frame(&frames[30].baps, Side::Right, Profile::Hand).unwrap();
        let angle = JointAngle::Index1Flexion;
        assert!((back.angle(angle) - held.angle(angle)).abs() < 1e-4);
        for frame in &mut clip.frames {
            frame.valid = false;
        }
        assert!(matches!(bap_frames(&clip, Profile::Hand), Err(PosesToStreamError::Empty { .. })));
    }

    /// Frames in which a hand is lost neither add to what is told nor let those in which it is seen be worse.
    #[test]
    fn errors_are_those_of_the_hands_that_are_seen() {
        let mut clip = clip(&[Side::Left, Side::Right]);
        for frame in &mut clip.frames {
            let tick = (frame.time * 30.0).round() as u32;
            frame.valid = if frame.pose.side == Side::Left { tick % 10 < 3 } else { tick != 7 };
        }
        for live in [false, true] {
            let plan = PlanOptions { live, mode: Target::Rms(0.4), ..PlanOptions::default() };
            let EncodedClip { stream, report, tips, .. } = encode_poses(&clip, Profile::Hand, &plan).unwrap();
            let decoded = decode_poses(&stream, None, DecoderOptions::default()).unwrap().clip;
            assert_eq!(decoded.frames.len(), clip.frames.len());
            let (mut sum, mut frames, mut most) = (0.0, 0, 0.0f64);
            for side in [Side::Left, Side::Right] {
                for (given, shown) in clip.of(side).zip(decoded.of(side)).filter(|(given, _)| given.valid) {
                    let off = |angle| (given.pose.angle(angle) - shown.pose.angle(angle)).to_degrees();
                    sum += JointAngle::ALL.into_iter().map(|angle| off(angle).powi(2)).sum::<f64>();
                    frames += 1;
                    let skeleton = Skeleton::new(&Morphology::default(), side);
                    let [a, b] = [given, shown].map(|frame| skeleton.frames(&frame.pose));
                    let tip = |finger| {
                        (a.position(Joint::tip(finger)) - b.position(Joint::tip(finger))).norm() * 1e3
                    };
                    most = Finger::ALL.into_iter().map(tip).fold(most, f64::max);
                }
            }
            // Two angles of each hand move; the wrist's do not count.
            let rms = (sum / f64::from(2 * frames)).sqrt();
            assert!((report.rms_degrees - rms).abs() < 2e-3, "{live}: {} {rms}", report.rms_degrees);
            assert!(live || (0.35..=0.4).contains(&rms), "{rms}");
            assert!((tips.unwrap().max_mm - most).abs() < 1e-2, "{live}: {tips:?} {most}");
        }
    }

    /// What places a hand does not wait while fingers spend the rate: neither where it first turns nor where it leaps.
    #[test]
    fn a_hand_that_turns_or_leaps_is_told_of_at_a_rate() {
        for (from, turn, kbit_per_s) in [(10, 1.7, 1.0), (10, 1.7, 1.5), (200, 2.4, 3.0), (200, 2.4, 1.5)] {
            let mut clip = PoseClip::default();
            clip.header.rate = Some(30.0);
            for i in 0..300 {
                let t = f64::from(i) / 30.0;
                let bend = |angle: f64| 40.0 * (5.0 * t + angle).sin().powi(2);
                let mut pose = HandPose::neutral(Side::Right)
                    .with_degrees(JointAngle::Index1Flexion, bend(0.0))
                    .with_degrees(JointAngle::Middle1Flexion, bend(0.6))
                    .with_degrees(JointAngle::Ring2Flexion, bend(1.2));
                let share = (f64::from(i - from) / 6.0).clamp(0.0, 1.0);
                pose.rotation = UnitQuaternion::from_euler_angles(turn * share, 0.0, 0.0);
                clip.frames.push(TimedPose::new(t, pose));
            }
            let plan =
                PlanOptions { live: true, mode: Target::Bitrate(kbit_per_s), ..PlanOptions::default() };
            let EncodedClip { stream, report, .. } = encode_poses(&clip, Profile::Hand, &plan).unwrap();
            assert_eq!(report.windows_missed, Some(0));
            let shown = decode_poses(&stream, None, DecoderOptions::default()).unwrap().clip;
            let off =
                |(a, b): (&TimedPose, &TimedPose)| a.pose.rotation.angle_to(&b.pose.rotation).to_degrees();
            let offs: Vec<f64> = clip.frames.iter().zip(&shown.frames).map(off).collect();
            let lagging = offs.iter().filter(|off| **off > 30.0).count();
            assert!(lagging <= 3, "{from} {turn} {kbit_per_s}: {lagging}");
        }
    }

    /// A word that is spelled, with what `place` makes of each pose.
    fn spelled(text: &str, place: impl Fn(f64, &mut HandPose)) -> PoseClip {
        let library = ShapeLibrary::builtin().unwrap();
        let spelling = Spelling::new(&library, text, Side::Right, SpellingTempo::default()).unwrap();
        let frames = (0..=(spelling.duration() * 30.0) as u32).map(|frame| {
            let time = f64::from(frame) / 30.0;
            let mut pose = spelling.pose(time);
            place(time, &mut pose);
            TimedPose::new(time, pose)
        });
        PoseClip::of_frames(frames, Some(30.0))
    }

    fn coded(clip: &PoseClip, mode: Target, live: bool, resync: bool) -> EncodedClip {
        let plan = PlanOptions { mode, live, resync, ..PlanOptions::default() };
        let coded = encode_poses(clip, Profile::Hand, &plan).unwrap();
        let PlanReport { rms_degrees, max_degrees, .. } = coded.report;
        let kbit_per_s = coded.report.kbit_per_s();
        println!(
            "{mode:?}, live {live}: {kbit_per_s:.2} kbit/s, {rms_degrees:.2}°, {max_degrees:.1}° at most"
        );
        coded
    }

    /// A wrist that goes far has another anchor of place twice a second, and an I plane for each.
    #[test]
    fn a_hand_that_goes_far_is_held_at_a_rate() {
        let clip = spelled("THE QUICK BROWN FOX JUMPS OVER THE LAZY DOG", |time, pose| {
            pose.translation.x += 0.5 * (std::f64::consts::PI * time).sin();
        });
        for (kbit_per_s, rms) in [(2.0, 1.1), (1.0, 5.0)] {
            let report = coded(&clip, Target::Bitrate(kbit_per_s), false, false).report;
            assert!(report.rms_degrees < rms && report.windows_missed == Some(0), "{}", report.rms_degrees);
        }
        let live = coded(&clip, Target::Bitrate(2.2), true, true);
        assert!(live.report.rms_degrees < 3.2 && live.report.windows_missed == Some(0));
        assert!(live.tips.unwrap().p99_mm < 80.0, "{:?}", live.tips);
        for resync in [false, true] {
            let report = coded(&clip, Target::default(), true, resync).report;
            assert!(report.kbit_per_s() < 4.45, "{}", report.kbit_per_s());
        }
    }

    /// Where bits are scarce, ranges that were sent once serve further I planes.
    #[test]
    fn low_rates_are_not_spent_on_ranges() {
        let clip = spelled("HELLO", |_, _| ());
        let report = coded(&clip, Target::Bitrate(0.7), false, false).report;
        assert!(report.rms_degrees < 4.3 && report.kbit_per_s() <= 0.7, "{}", report.rms_degrees);
    }

    /// The error that is aimed at is that of joint angles: where none moves the wrist is not let go.
    #[test]
    fn a_hand_that_only_turns_is_not_coarse() {
        let mut clip = clip(&[Side::Right]);
        for (i, frame) in clip.frames.iter_mut().enumerate() {
            frame.pose = HandPose::neutral(Side::Right);
            frame.pose.rotation = UnitQuaternion::from_euler_angles(0.0, 0.105 * i as f64, 0.0);
        }
        let whole = coded(&clip, Target::default(), false, false).stream;
        let shown = decode_poses(&whole, None, DecoderOptions::default()).unwrap().clip;
        let off = |(a, b): (&TimedPose, &TimedPose)| a.pose.rotation.angle_to(&b.pose.rotation).to_degrees();
        let mean = clip.frames.iter().zip(&shown.frames).map(off).sum::<f64>() / clip.frames.len() as f64;
        assert!(mean < 1.5, "{mean}° at {} bytes", whole.len());
        // Nor where it is coded when it comes.
        let turns = (0..300).map(|i| {
            let time = f64::from(i) / 30.0;
            let mut pose = HandPose::neutral(Side::Right);
            pose.rotation =
                UnitQuaternion::from_euler_angles(0.5 * (2.0 * time).sin(), 0.9 * (3.0 * time).sin(), 0.0);
            TimedPose::new(time, pose)
        });
        let tips =
            coded(&PoseClip::of_frames(turns, Some(30.0)), Target::default(), true, true).tips.unwrap();
        assert!(tips.mean_mm < 2.5 && tips.p99_mm < 7.0, "{tips:?}");
    }

    /// Of a stream, or of several one behind the other, a hand is there from where it is sent to where the stream ends.
    #[test]
    fn hands_are_there_from_where_they_are_sent() {
        let part = |sides: &[Side]| {
            let plan = PlanOptions::default();
            encode_poses(&clip(sides), Profile::Hand, &plan).unwrap().stream
        };
        let parts = [&[Side::Right][..], &[Side::Left, Side::Right], &[Side::Left]].map(part);
        let decoded = decode_poses(&parts.concat(), None, DecoderOptions::default()).unwrap();
        let span = |side: Side| {
            let times: Vec<f64> = decoded.clip.of(side).map(|frame| frame.time).collect();
            (times.len(), (times[0] * 30.0).round() as u32)
        };
        assert_eq!((decoded.streams, span(Side::Left), span(Side::Right)), (3, (120, 60), (120, 0)));
        assert!(decoded.clip.frames.iter().all(|frame| frame.pose.translation.z < -0.5));
        assert_eq!(decoded.clip.header.hands.len(), 2);
        assert!(decoded.resized.is_empty());
        // A mask that grows within a stream.
        let mut mapper = PoseMapper::new(Profile::Hand);
        let frames: Vec<TimedBapFrame> = (0..60)
            .map(|i| {
                let poses: Vec<HandPose> = clip(&[Side::Left, Side::Right]).frames[2 * i..2 * i + 2]
                    .iter()
                    .map(|frame| frame.pose.clone())
                    .collect();
                let seen = if i < 25 { &poses[..1] } else { &poses[..] };
                TimedBapFrame { time: i as f64 / 30.0, baps: mapper.frame(seen) }
            })
            .collect();
        let (stream, _) = encode_clip(&frames, &PlanOptions::default()).unwrap();
        let decoded = decode_poses(&stream, None, DecoderOptions::default()).unwrap().clip;
        let (of_text, _) = poses_from_frames(&frames, 30.0, None, true);
        for clip in [&decoded, &of_text] {
            assert_eq!((clip.of(Side::Left).count(), clip.of(Side::Right).count()), (60, 35));
        }
    }

    /// Of two people one behind the other a clip has the sizes of the second alone.
    #[test]
    fn streams_of_other_sizes_are_told() {
        let part = |sides: &[Side], length: Option<f64>| {
            let mut clip = clip(sides);
            clip.header.hands = sides
                .iter()
                .map(|&side| ClipHand { side, morphology: length.map(Morphology::average) })
                .collect();
            encode_poses(&clip, Profile::Hand, &PlanOptions::default()).unwrap().stream
        };
        let resized = |parts: &[Vec<u8>]| {
            let decoded = decode_poses(&parts.concat(), None, DecoderOptions::default()).unwrap();
            let sizes = decoded.clip.header.hand(Side::Right).unwrap().morphology.clone();
            (decoded.resized, sizes.map(|sizes| (1e3 * sizes.hand_length).round()))
        };
        let both = [Side::Left, Side::Right];
        let [unknown, small, large] = [None, Some(0.15), Some(0.2)].map(|length| part(&both[1..], length));
        let pair = part(&both, Some(0.15));
        assert_eq!(resized(std::slice::from_ref(&small)), (vec![], Some(150.0)));
        assert_eq!(resized(&[unknown.clone(), small.clone(), small.clone()]), (vec![], Some(150.0)));
        assert_eq!(resized(&[small.clone(), unknown, pair.clone()]), (vec![], Some(150.0)));
        assert_eq!(resized(&[small.clone(), large.clone()]), (vec![Side::Right], Some(200.0)));
        assert_eq!(resized(&[large.clone(), pair]), (vec![Side::Right], Some(150.0)));
        // The last stream tells the other hand alone.
        let left = part(&both[..1], Some(0.17));
        assert_eq!(resized(&[small.clone(), large, left]), (vec![Side::Right], Some(200.0)));
        let unsized_left = part(&both[..1], None);
        assert_eq!(resized(&[small, unsized_left]), (vec![], Some(150.0)));
    }

    /// The sizes of two hands are written in coarser steps than those of one, or as those that both have on average.
    #[test]
    fn sizes_that_are_rounded_otherwise_are_no_others() {
        let part = |sides: &[Side], off: f64| {
            let mut clip = clip(sides);
            let mut number = 0.0;
            let mut sized = |side: Side| {
                let mut sizes = Morphology::average(0.18);
                for value in sizes
                    .fingers
                    .iter_mut()
                    .flat_map(|finger| finger.bones.iter_mut().chain(&mut finger.base))
                {
                    number += 1.0;
                    *value += off * f64::sin(3.0 * number);
                }
                ClipHand { side, morphology: Some(sizes) }
            };
            // The right hand has the same sizes beside a left one, whose sizes are others.
            let mut hands = vec![sized(Side::Right), sized(Side::Left)];
            hands.retain(|hand| sides.contains(&hand.side));
            clip.header.hands = hands;
            encode_poses(&clip, Profile::Hand, &PlanOptions::default()).unwrap().stream
        };
        let both = [Side::Left, Side::Right];
        let told = |parts: [Vec<u8>; 2]| {
            let [alone, ..] = parts.each_ref().map(|stream| {
                let decoded = decode_poses(stream, None, DecoderOptions::default()).unwrap();
                decoded.clip.header.hand(Side::Right).unwrap().morphology.clone()
            });
            let decoded = decode_poses(&parts.concat(), None, DecoderOptions::default()).unwrap();
            (decoded.resized, alone == decoded.clip.header.hand(Side::Right).unwrap().morphology)
        };
        for off in [5e-4, 1.3e-3, 2e-3] {
            let [(first, same), (second, _)] = [[&both[1..], &both], [&both, &both[1..]]]
                .map(|hands| told(hands.map(|hands| part(hands, off))));
            assert_eq!((first, second), (vec![], vec![]), "{off}");
            assert!(!same || off < 2e-3);
        }
        let [small, large] = [0.0, 3e-3].map(|off| part(&both[1..], off));
        assert_eq!(told([small, large]).0, [Side::Right]);
    }

    /// A stream that is joined in its middle counts, and what damage takes from a stream to its end is told.
    #[test]
    fn what_is_missing_is_told() {
        let plan = PlanOptions { resync: true, intra_seconds: 1.0, ..PlanOptions::default() };
        let stream = encode_poses(&clip(&[Side::Right]), Profile::Hand, &plan).unwrap().stream;
        let joined = [&stream[20..], &stream[..]].concat();
        let options = DecoderOptions::default();
        let decoded = decode_poses(&joined, None, options).unwrap();
        let baps = decode_baps(&joined, options, &Limits::default()).unwrap();
        assert!(decoded.passed_over.is_some() && baps.passed_over.is_some());
        assert_eq!((decoded.streams, baps.streams), (2, 2));
        let second = stream.windows(4).rposition(|code| code == [0, 0, 1, 0xbb]).unwrap();
        // In the first period the next I plane makes it good, in the last one nothing does.
        for (places, lost) in [(second - 60..second - 20, false), (second + 100..stream.len() - 20, true)] {
            let mut told = 0;
            for at in places {
                let mut wrong = stream.clone();
                wrong[at] ^= 0x55;
                let options = DecoderOptions { conceal: true, ..options };
                let decoded = decode_poses(&wrong, None, options).unwrap();
                let baps = decode_baps(&wrong, options, &Limits::default()).unwrap();
                for damage in [&decoded.damage, &baps.damage].into_iter().filter(|damage| damage.count() > 0)
                {
                    let notices = crate::notices::of_damage(damage, "pose is").join(" ");
                    assert_eq!(damage.abandoned() > 0, lost, "{at} of {}: {notices}", stream.len());
                    assert_eq!(
                        notices.contains("no I plane that a start code marks follows"),
                        lost,
                        "{notices}"
                    );
                    told += 1;
                }
            }
            assert!(told > 10, "{told}");
        }
    }

    /// Wrists that turn round and round are counted from the other side before no value reaches them.
    #[test]
    fn a_hand_may_turn_more_than_once_in_the_arm_profile() {
        for (side, way) in [(Side::Right, 0.2), (Side::Left, -0.2)] {
            let mut clip = clip(&[side]);
            for (i, frame) in clip.frames.iter_mut().enumerate() {
                frame.pose.rotation = UnitQuaternion::from_euler_angles(0.0, way * i as f64, 0.0);
            }
            for live in [false, true] {
                let plan = PlanOptions { live, mode: Target::MaxError(1.0), ..PlanOptions::default() };
                let coded = encode_poses(&clip, Profile::Arm, &plan).unwrap();
                let shown = decode_poses(&coded.stream, None, DecoderOptions::default()).unwrap().clip;
                for (a, b) in clip.frames.iter().zip(&shown.frames) {
                    let off = a.pose.rotation.angle_to(&b.pose.rotation).to_degrees();
                    assert!(off < 1.8, "{side:?} live {live}: {off}° at {} s", a.time);
                }
            }
        }
    }

    /// A hand that comes back elsewhere, after a rest or at once, is not taken for damage.
    #[test]
    fn leaps_of_a_sound_stream_are_believed() {
        for (away, side, turn) in
            [(0, 0.15, 0.0), (0, 0.4, 0.0), (40, 0.19, 0.0), (40, 0.3, 1.5), (0, 0.0, 1.4)]
        {
            let mut clip = clip(&[Side::Right]);
            for (i, frame) in clip.frames.iter_mut().enumerate() {
                frame.valid = !(10..10 + away).contains(&i);
                if i >= 10 + away {
                    frame.pose.translation.x += side;
                    frame.pose.rotation *= UnitQuaternion::from_euler_angles(0.0, 0.0, turn);
                }
            }
            for (live, resync) in [(false, false), (false, true), (true, true)] {
                let plan = PlanOptions { live, resync, ..PlanOptions::default() };
                let stream = encode_poses(&clip, Profile::Hand, &plan).unwrap().stream;
                let options = DecoderOptions { conceal: true, ..DecoderOptions::default() };
                let decoded = decode_poses(&stream, None, options).unwrap();
                assert!(decoded.damage.count() == 0, "{away} {side} {turn} {live}: {:?}", decoded.damage);
                assert_eq!(decoded.clip.frames.len(), 60);
                assert!(decoded.clip.frames.iter().all(|frame| frame.valid));
                let last = &decoded.clip.frames[59].pose;
                assert!((last.translation - clip.frames[59].pose.translation).norm() < 0.03);
            }
        }
    }

    #[test]
    fn a_hand_that_is_never_seen_is_left_out() {
        let mut clip = clip(&[Side::Left, Side::Right]);
        clip.header.hands =
            [Side::Left, Side::Right].map(|side| ClipHand { side, morphology: None }).to_vec();
        clip.frames.iter_mut().for_each(|frame| frame.valid = frame.pose.side == Side::Right);
        for live in [false, true] {
            let plan = PlanOptions { live, ..PlanOptions::default() };
            let stream = encode_poses(&clip, Profile::Hand, &plan).unwrap().stream;
            let decoded = decode_poses(&stream, None, DecoderOptions::default()).unwrap().clip;
            assert_eq!(decoded.frames.len(), 60);
            assert!(decoded.of(Side::Left).next().is_none());
        }
        let frames = bap_frames(&clip, Profile::Hand).unwrap();
        assert_eq!(frames.len(), 60);
        assert!(frames.iter().all(|frame| pose_from_frame(&frame.baps, Side::Left, Profile::Hand).is_none()));
    }

    #[test]
    fn uneven_times_are_put_on_even_ticks() {
        let mut clip = clip(&[Side::Right]);
        for (i, frame) in clip.frames.iter_mut().enumerate() {
            frame.time += 0.5 + if i % 3 == 1 { 0.012 } else { 0.0 };
        }
        let even = on_ticks(&clip, 30.0, 0.0);
        assert_eq!(even.frames.len(), 60);
        for (i, frame) in even.frames.iter().enumerate() {
            assert!((frame.time - i as f64 / 30.0).abs() < 1e-9);
        }
        assert!(encode_poses(&clip, Profile::Hand, &PlanOptions::default()).is_ok());
    }

    #[test]
    fn dropped_frames_leave_ticks_empty() {
        let mut dropping = clip(&[Side::Right]);
        dropping.frames.remove(20);
        // Times as a camera gives them.
        for frame in &mut dropping.frames {
            frame.time = (frame.time * 1000.0).round() / 1000.0;
        }
        assert!(poses_keep(&dropping, 30.0));
        let ticked = on_ticks(&dropping, 30.0, 0.0);
        assert_eq!(ticked.frames.len(), 59);
        for (own, placed) in dropping.frames.iter().zip(&ticked.frames) {
            assert_eq!(own.pose, placed.pose);
            assert!((own.time - placed.time).abs() < 1e-3);
        }
        for (max_gap, live) in [(0.0, false), (0.25, true), (0.25, false)] {
            let plan = PlanOptions { live, mode: Target::MaxError(0.3), ..PlanOptions::default() };
            let coded = encode_bridged(&dropping, Profile::Hand, &plan, max_gap).unwrap();
            let decoded = decode_poses(&coded.stream, None, DecoderOptions::default()).unwrap().clip;
            assert_eq!(decoded.frames.len(), 60);
            let [before, there, behind] = [19, 20, 21].map(|i| &decoded.frames[i].pose);
            if max_gap == 0.0 || live {
                assert_eq!((there, coded.bridged), (before, 0));
                continue;
            }
            let [given, added, next] = [19, 20, 21].map(|i| &coded.clip.frames[i]);
            assert_eq!((coded.bridged, added.valid), (1, false));
            assert_eq!(added.pose, given.pose.interpolated(&next.pose, 0.5));
            let off = there.angles.iter().zip(&added.pose.angles).map(|(a, b)| (a - b).abs().to_degrees());
            assert!(off.fold(0.0, f64::max) < 0.31 && there != before && there != behind);
        }
    }

    #[test]
    fn rates_that_no_stream_has_keep_their_poses_and_times() {
        for rate in [0.05, 0.07, 0.3, 1.1, 3.3, 20.0 / 3.0, 100.0 / 11.0, 10.1] {
            let mut slow = clip(&[Side::Left, Side::Right]);
            slow.header.rate = Some(rate);
            slow.frames.iter_mut().for_each(|frame| frame.time *= 30.0 / rate);
            // A frame that is missing is bridged where that is asked for.
            slow.frames.retain(|frame| (frame.time * rate).round() != 20.0);
            for (live, max_gap) in [(false, 0.0), (true, 0.0), (false, 2.5 / rate)] {
                let plan = PlanOptions { live, mode: Target::MaxError(0.3), ..PlanOptions::default() };
                let coded = encode_bridged(&slow, Profile::Hand, &plan, max_gap).unwrap();
                assert_eq!(coded.bridged, if max_gap > 0.0 { 2 } else { 0 }, "{rate}");
                let decoded = decode_poses(&coded.stream, None, DecoderOptions::default()).unwrap();
                let (shown, tick) = (&decoded.clip, 1.0 / decoded.rate);
                assert!(crate::notices::of_times(&slow, decoded.rate).unwrap().contains("of which one in "));
                for frame in &slow.frames {
                    let at = |pose: &&TimedPose| (pose.time - frame.time).abs() <= 0.51 * tick;
                    let near: Vec<&TimedPose> = shown.of(frame.pose.side).filter(at).collect();
                    let off = |pose: &&TimedPose| {
                        let pairs = frame.pose.angles.iter().zip(&pose.pose.angles);
                        pairs.map(|(a, b)| (a - b).abs().to_degrees()).fold(0.0, f64::max)
                    };
                    assert!(near.iter().any(|pose| off(pose) < 0.31), "{rate} {}", frame.time);
                }
                let end = |clip: &PoseClip| clip.frames.last().map_or(0.0, |frame| frame.time);
                assert!((end(shown) - end(&slow)).abs() <= tick, "{rate}");
            }
        }
    }

    /// What is interpolated counts in no error, and clips without gaps are coded as ever.
    #[test]
    fn bridged_gaps_are_in_no_account() {
        let whole = clip(&[Side::Left, Side::Right]);
        let coded = |clip: &PoseClip, max_gap: f64| {
            encode_bridged(clip, Profile::Hand, &PlanOptions::default(), max_gap).unwrap()
        };
        assert_eq!(coded(&whole, 0.0).stream, coded(&whole, 1.0).stream);
        let mut lost = whole.clone();
        for frame in lost.frames.iter_mut().filter(|frame| frame.pose.side == Side::Left) {
            let tick = (frame.time * 30.0).round() as usize;
            frame.valid = !(20..24).contains(&tick) && !(40..50).contains(&tick);
        }
        let bridged = coded(&lost, 0.25);
        assert_eq!(bridged.bridged, 4);
        let decoded = decode_poses(&bridged.stream, None, DecoderOptions::default()).unwrap().clip;
        let mut worst = 0.0f64;
        for (given, shown) in lost.of(Side::Left).zip(decoded.of(Side::Left)).filter(|(given, _)| given.valid)
        {
            let off = given.pose.angles.iter().zip(&shown.pose.angles).map(|(a, b)| (a - b).abs());
            worst = off.fold(worst, f64::max);
        }
        for (given, shown) in lost.of(Side::Right).zip(decoded.of(Side::Right)) {
            let off = given.pose.angles.iter().zip(&shown.pose.angles).map(|(a, b)| (a - b).abs());
            worst = off.fold(worst, f64::max);
        }
        let told = bridged.report.max_degrees;
        assert!((worst.to_degrees() - told).abs() < 1e-3, "{} {told}", worst.to_degrees());
    }

    #[test]
    fn a_clock_beside_the_ticks_keeps_the_poses() {
        let instants = |rate: f64| (0..3000).map(|i| f64::from(i) * 30.0 / rate).collect::<Vec<_>>();
        let ticks = |rate| own_ticks(&instants(rate));
        let slower = ticks(29.97).unwrap();
        assert!(slower.iter().all(Option::is_some) && slower[2999] == Some(3002.0));
        let faster = ticks(30.03).unwrap();
        assert_eq!(faster.iter().filter(|tick| tick.is_none()).count(), 3);
        for rate in [29.97, 30.03] {
            let (own, at) = (ticks(rate).unwrap(), instants(rate));
            assert!(own.iter().zip(&at).all(|(k, t)| k.is_none_or(|k| (k - t).abs() <= FAR)));
            assert!(own.iter().flatten().zip(own.iter().flatten().skip(1)).all(|(a, b)| b > a));
        }
        for rate in [25.0, 29.0, 31.0, 60.0] {
            assert_eq!(ticks(rate), None, "{rate}");
        }
    }

    #[test]
    fn hands_of_one_instant_share_a_tick() {
        let mut both = clip(&[Side::Left, Side::Right]);
        let frames = std::mem::take(&mut both.frames);
        for i in 0..1000 {
            for pose in frames.iter().take(if i > 600 { 2 } else { 1 }) {
                both.frames.push(TimedPose { time: f64::from(i) / 30.03, ..pose.clone() });
            }
        }
        assert!(poses_keep(&both, 30.0));
        let ticked = on_ticks(&both, 30.0, 0.0);
        let times = |side| ticked.of(side).map(|f| f.time).collect::<Vec<_>>();
        let left = times(Side::Left);
        assert!(times(Side::Right).iter().all(|time| left.contains(time)));
    }

    #[test]
    fn streams_without_hands_are_refused() {
        assert!(matches!(
            decode_poses(&[], None, DecoderOptions::default()),
            Err(StreamToPosesError::NoPlane | StreamToPosesError::Syntax(_))
        ));
    }

    #[test]
    fn a_hand_whose_fingers_rest_is_not_lost() {
        for sides in [&[Side::Right][..], &[Side::Left, Side::Right]] {
            let mut given = clip(sides);
            // The last one waves alone.
            let resting = sides[sides.len() - 1];
            for frame in given.frames.iter_mut().filter(|frame| frame.pose.side == resting) {
                frame.pose.angles = [0.0; 29];
            }
            for live in [false, true] {
                let plan = PlanOptions { live, ..PlanOptions::default() };
                let stream = encode_poses(&given, Profile::Hand, &plan).unwrap().stream;
                let decoded = decode_poses(&stream, None, DecoderOptions::default()).unwrap().clip;
                for (given, found) in given.of(resting).zip(decoded.of(resting)) {
                    let off = (given.pose.translation - found.pose.translation).norm();
                    assert!(off < 0.03, "{off} m at {} s, live {live}", given.time);
                    assert_eq!(found.pose.angles, [0.0; 29]);
                }
                assert_eq!(decoded.of(resting).count(), given.of(resting).count(), "live {live}");
            }
        }
    }

    #[test]
    fn a_hand_that_is_not_worth_a_bit_is_there_and_its_error_is_told() {
        let twitch = |degrees: f64| {
            let pose = |i: u32, side| {
                let bend = if i.is_multiple_of(2) { 0.0 } else { degrees };
                let pose = HandPose::neutral(side).with_degrees(JointAngle::Index1Flexion, bend);
                TimedPose::new(f64::from(i) / 30.0, pose)
            };
            let frames = (0..60).flat_map(|i| [pose(i, Side::Left), pose(i, Side::Right)]);
            PoseClip::of_frames(frames, Some(30.0))
        };
        for (degrees, mode) in
            [(0.0, Target::default()), (3.0, Target::MaxError(10.0)), (3.0, Target::Rms(50.0))]
        {
            for (profile, live) in [Profile::Hand, Profile::Arm]
                .into_iter()
                .flat_map(|profile| [(profile, false), (profile, true)])
            {
                let plan = PlanOptions { mode, live, ..PlanOptions::default() };
                let encoded = encode_poses(&twitch(degrees), profile, &plan).unwrap();
                let decoded = decode_poses(&encoded.stream, None, DecoderOptions::default()).unwrap().clip;
                assert_eq!((decoded.of(Side::Left).count(), decoded.of(Side::Right).count()), (60, 60));
                let bend = |frame: &TimedPose| frame.pose.angle(JointAngle::Index1Flexion).to_degrees();
                let given = twitch(degrees);
                let pairs = given.of(Side::Left).zip(decoded.of(Side::Left));
                let off = pairs.map(|(a, b)| (bend(a) - bend(b)).abs()).fold(0.0, f64::max);
                let told = encoded.report.max_degrees;
                assert!((told - off).abs() < 0.01, "{told}° told, {off}° off");
            }
        }
    }

    #[test]
    fn values_beyond_all_levels_are_named() {
        let mut given = clip(&[Side::Right]);
        given.frames[17].pose.set(JointAngle::Index1Flexion, -3.0);
        let refused = |quant: u8, live: bool| {
            let plan = PlanOptions { mode: Target::Quant(quant), live, ..PlanOptions::default() };
            encode_poses(&given, Profile::Hand, &plan).unwrap_err().to_string()
        };
        let said = refused(1, false);
        assert!(said.starts_with("frame 17: bap 162 (r_index1_flexion)") && said.contains("°"), "{said}");
        assert!(said.ends_with("and at no quantiser index further"), "{said}");
        let said = refused(0, false);
        assert!(said.contains("changing by") && said.contains("a p value reaches"), "{said}");
        assert!(said.ends_with("at a higher quantiser index further"), "{said}");
        given.frames[0].pose.set(JointAngle::Index1Flexion, -3.0);
        for live in [false, true] {
            let plan = PlanOptions { mode: Target::Quant(1), live, ..PlanOptions::default() };
            let said = encode_poses(&given, Profile::Hand, &plan).unwrap_err().to_string();
            assert!(said.starts_with("frame 0: bap 162 (r_index1_flexion) at "), "{said}");
        }
    }

    #[test]
    fn numbers_that_are_none_are_refused() {
        let wrong = |edit: fn(&mut TimedPose)| {
            let mut given = clip(&[Side::Right]);
            edit(&mut given.frames[17]);
            encode_poses(&given, Profile::Hand, &PlanOptions::default()).unwrap_err().to_string()
        };
        assert!(wrong(|frame| frame.time = f64::NAN).contains("pose 17: the time is NaN"));
        assert!(wrong(|frame| frame.time = f64::INFINITY).contains("pose 17: the time is inf"));
        assert!(wrong(|frame| frame.pose.translation.y = f64::NAN).contains("a coordinate of the wrist"));
        assert!(wrong(|frame| frame.pose.angles[3] = f64::NAN).contains("a joint angle is NaN"));
        let mut long = clip(&[Side::Right]);
        long.frames[59].time = 1e9;
        let said = encode_poses(&long, Profile::Hand, &PlanOptions::default()).unwrap_err().to_string();
        assert!(said.contains("1000000000 s at "), "{said}");
        let mut back = clip(&[Side::Right]);
        back.frames[17].time = 0.2;
        let said = encode_poses(&back, Profile::Hand, &PlanOptions::default()).unwrap_err().to_string();
        assert!(said.starts_with("encode: the time of pose 17 is 0.2 s"), "{said}");
        // Nor does counting them take for ever.
        let mut given = clip(&[Side::Right]);
        given.frames[59].time = f64::NAN;
        assert_eq!(given.resampled(Side::Right, 30.0, 1.0).len(), 1);
    }

    #[test]
    fn the_rate_is_that_of_a_hand_that_has_one() {
        let mut given = clip(&[Side::Left]);
        given.header.rate = None;
        assert!((clip_rate(&given) - 30.0).abs() < 1e-6);
        given.frames.iter_mut().for_each(|frame| frame.time /= 4.0);
        assert!((clip_rate(&given) - 120.0).abs() < 1e-6);
        let lone = TimedPose::new(0.0, HandPose::neutral(Side::Right));
        given.header.hands =
            [Side::Right, Side::Left].map(|side| ClipHand { side, morphology: None }).to_vec();
        given.frames.push(lone);
        assert!((clip_rate(&given) - 120.0).abs() < 1e-6);
    }
}
