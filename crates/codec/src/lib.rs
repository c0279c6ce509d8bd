//! Poses to an FBA stream and back: the BAP mapping and the bitstream in one step.
//!
//! Three poses encoded, and decoded again:
//!
//! ```
//! use handcast_codec::mapping::Profile;
//! use handcast_codec::{decode_poses, encode_poses};
//! use handcast_fba::DecoderOptions;
//! use handcast_fba::plan::{PlanOptions, RateMode};
//! use handcast_hand::{HandPose, JointAngle, PoseClip, Side, TimedPose};
//!
//! let bend = JointAngle::Index2Flexion;
//! let mut clip = PoseClip::default();
//! clip.header.rate = Some(30.0);
//! for (frame, degrees) in [0.0, 20.0, 45.0].into_iter().enumerate() {
//!     let pose = HandPose::neutral(Side::Right).with_degrees(bend, degrees);
//!     clip.frames.push(TimedPose::new(frame as f64 / 30.0, pose));
//! }
//! let options = PlanOptions { mode: RateMode::MaxError(1.0), ..PlanOptions::default() };
//! let encoded = encode_poses(&clip, Profile::Hand, &options)?;
//!
//! let decoded = decode_poses(&encoded.stream, None, DecoderOptions::default())?;
//! assert_eq!(decoded.clip.frames.len(), 3);
//! let last = decoded.clip.frames[2].pose.angle(bend).to_degrees();
//! assert!((last - 45.0).abs() <= 1.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Streamed, frame by frame, without waiting for the end on either side:
//!
//! ```
//! use handcast_codec::mapping::{PoseMapper, Profile, pose_from_frame};
//! use handcast_codec::ties::hand_ties;
//! use handcast_fba::plan::{LiveEncoder, PlanOptions};
//! use handcast_fba::{Decoder, DecoderOptions};
//! use handcast_hand::{HandPose, JointAngle, Side};
//!
//! let mut mapper = PoseMapper::new(Profile::Hand);
//! let options = PlanOptions { live: true, ties: hand_ties(), ..PlanOptions::default() };
//! let mut encoder = LiveEncoder::new(&options)?;
//! let mut decoder = Decoder::new(DecoderOptions::default());
//! let (mut bytes, mut poses) = (Vec::new(), Vec::new());
//! for degrees in [0.0, 20.0, 45.0] {
//!     let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index2Flexion, degrees);
//!     encoder.write_frame(&mapper.frame(&[pose]))?;
//!     encoder.take_bytes(&mut bytes); // over the wire
//!     decoder.push(&bytes)?;
//!     bytes.clear();
//!     while let Some(plane) = decoder.next_frame()? {
//!         poses.extend(pose_from_frame(&plane.baps, Side::Right, Profile::Hand));
//!     }
//! }
//! decoder.push(&encoder.finish())?;
//! while let Some(plane) = decoder.next_frame()? {
//!     poses.extend(pose_from_frame(&plane.baps, Side::Right, Profile::Hand));
//! }
//! assert_eq!(poses.len(), 2); // nothing but a resting hand is in the first plane: it has no joint angle
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod mapping;
pub mod ties;

use mapping::{PoseMapper, Profile, global_baps, pose_from_frame, sides, wrist_baps};
use ties::hand_ties;

use handcast_fba::bap::{BapFrame, BapMask, derive};
use handcast_fba::plan::{PlanOptions, PlanReport, TimedBapFrame, encode_clip};
use handcast_fba::{DecodedFrame, Decoder, DecoderOptions, EncodeError, FrameRate, SyntaxError};
use handcast_hand::{ClipHand, HandPose, PoseClip, PoseHeader, Side, TimedPose};
use thiserror::Error;

/// Why poses could not be encoded.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PosesToStreamError {
    /// There is no pose to encode.
    #[error("encode: no valid pose among {frames} frames")]
    Empty {
        /// Frames given.
        frames: usize,
    },
    /// The frame rate cannot be written in a stream.
    #[error("encode: frame rate {rate} per second, allowed 1/16 to 255 15/16")]
    Rate {
        /// Frames per second.
        rate: f64,
    },
    /// The encoder refused.
    #[error(transparent)]
    Encode(#[from] EncodeError),
}

/// Why a stream could not be decoded to poses.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum StreamToPosesError {
    /// The stream is damaged or uses what is not supported.
    #[error(transparent)]
    Syntax(#[from] SyntaxError),
    /// The stream holds no plane at all.
    #[error("decode: the stream holds no object plane")]
    NoPlane,
    /// The stream moves no hand.
    #[error("decode: none of the {planes} planes has a joint angle of a hand")]
    NoHand {
        /// Planes decoded.
        planes: usize,
    },
}

/// The BAP frames of a clip, one for each instant at which any of its hands has a pose.
///
/// A hand that is lost, or has no pose at an instant, keeps its last valid pose; before its first valid
/// pose it already has that one. So the masks never change and no frame is dropped.
///
/// # Errors
/// [`PosesToStreamError::Empty`] when a hand has no valid pose at all.
pub fn bap_frames(clip: &PoseClip, profile: Profile) -> Result<Vec<TimedBapFrame>, PosesToStreamError> {
    let mut current: Vec<HandPose> = Vec::new();
    for side in [Side::Left, Side::Right] {
        if clip.of(side).next().is_some() {
            let first = clip.of(side).find(|f| f.valid);
            current.push(first.ok_or(PosesToStreamError::Empty { frames: clip.frames.len() })?.pose.clone());
        }
    }
    if current.is_empty() {
        return Err(PosesToStreamError::Empty { frames: clip.frames.len() });
    }
    let mut order: Vec<&TimedPose> = clip.frames.iter().collect();
    order.sort_by(|a, b| a.time.total_cmp(&b.time));
    let start = order.first().map_or(0.0, |f| f.time);
    let mut mapper = PoseMapper::new(profile);
    let mut frames = Vec::new();
    for group in order.chunk_by(|a, b| b.time - a.time < 1e-6) {
        for timed in group.iter().filter(|f| f.valid) {
            if let Some(slot) = current.iter_mut().find(|p| p.side == timed.pose.side) {
                slot.clone_from(&timed.pose);
            }
        }
        frames.push(TimedBapFrame { time: group[0].time - start, baps: mapper.frame(&current) });
    }
    Ok(frames)
}

/// The frame rate of a clip: what its header says, else the inverse of the median interval.
pub fn clip_rate(clip: &PoseClip) -> f64 {
    if let Some(rate) = clip.header.rate {
        return rate;
    }
    let side = clip.header.hands.first().map_or(Side::Right, |h| h.side);
    let times: Vec<f64> = clip.of(side).map(|f| f.time).collect();
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).map_or(30.0, |d| 1.0 / d)
}

/// The clip on the even ticks of a stream of `rate` frames per second, from 0. Clips whose frames lie
/// within a quarter of a tick of it keep their poses; others, such as recordings with uneven times, are
/// interpolated at the ticks.
pub fn on_ticks(clip: &PoseClip, rate: f64) -> PoseClip {
    let start = clip.frames.iter().map(|f| f.time).fold(f64::INFINITY, f64::min);
    let even = |track: &[&TimedPose]| {
        let ticks: Vec<f64> = track.iter().map(|f| (f.time - start) * rate).collect();
        ticks.iter().all(|t| (t - t.round()).abs() <= 0.25)
            && ticks.windows(2).all(|w| w[1].round() > w[0].round())
    };
    let mut out = PoseClip { header: clip.header.clone(), frames: Vec::with_capacity(clip.frames.len()) };
    out.header.rate = Some(rate);
    for side in [Side::Left, Side::Right] {
        let track: Vec<&TimedPose> = clip.of(side).collect();
        if even(&track) {
            out.frames.extend(
                track
                    .iter()
                    .map(|f| TimedPose { time: ((f.time - start) * rate).round() / rate, ..(*f).clone() }),
            );
        } else {
            let delay = track.first().map_or(0.0, |f| ((f.time - start) * rate).round() / rate);
            let resampled = clip.resampled(side, rate, f64::INFINITY);
            out.frames.extend(resampled.into_iter().map(|f| TimedPose { time: f.time + delay, ..f }));
        }
    }
    out
}

/// A clip as a stream.
#[derive(Clone, Debug)]
pub struct EncodedClip {
    /// The stream.
    pub stream: Vec<u8>,
    /// What it costs and how far off it is.
    pub report: PlanReport,
    /// What was encoded: the clip on the ticks of the stream.
    pub clip: PoseClip,
}

/// Encodes a clip with look-ahead (or frame by frame, as `options.live` says), on the even ticks of its
/// own rate ([`clip_rate`], [`on_ticks`]); `options.rate` is not used.
///
/// # Errors
/// See [`PosesToStreamError`].
pub fn encode_poses(
    clip: &PoseClip,
    profile: Profile,
    options: &PlanOptions,
) -> Result<EncodedClip, PosesToStreamError> {
    let rate = clip_rate(clip);
    let rate = FrameRate::nearest(rate).ok_or(PosesToStreamError::Rate { rate })?;
    let clip = on_ticks(clip, rate.per_second());
    let frames = bap_frames(&clip, profile)?;
    let (stream, report) = encode_clip(&frames, &PlanOptions { rate, ties: hand_ties(), ..*options })?;
    Ok(EncodedClip { stream, report, clip })
}

/// A decoded stream.
#[derive(Clone, Debug)]
pub struct DecodedStream {
    /// The poses, one for each hand and tick of the stream's clock from the first plane on; ticks that the
    /// encoder skipped repeat the pose before.
    pub clip: PoseClip,
    /// The planes as decoded.
    pub planes: Vec<DecodedFrame>,
    /// Frames per second of the stream.
    pub rate: f64,
    /// How position and rotation of the hand travelled.
    pub profile: Profile,
    /// BAPs that were not sent, but filled in by the hand model.
    pub derived: BapMask,
    /// Damage that was passed over, with `conceal`; else empty.
    pub damage: Vec<SyntaxError>,
}

/// The planes of a whole stream.
#[derive(Clone, Debug)]
pub struct DecodedPlanes {
    /// Every plane that could be decoded; with `conceal` held ones for those that could not.
    pub planes: Vec<DecodedFrame>,
    /// Frames per second.
    pub rate: f64,
    /// Why decoding stopped before the end code, with `conceal`.
    pub cut: Option<SyntaxError>,
}

/// Decodes every plane of a whole stream.
///
/// # Errors
/// The first error of the decoder; with `options.conceal` nothing after the first plane is an error.
pub fn decode_planes(bytes: &[u8], options: DecoderOptions) -> Result<DecodedPlanes, SyntaxError> {
    let mut decoder = Decoder::new(options);
    let mut planes = Vec::new();
    let mut all = || {
        for piece in bytes.chunks(1 << 16) {
            decoder.push(piece)?;
            while let Some(plane) = decoder.next_frame()? {
                planes.push(plane);
            }
        }
        decoder.finish();
        while let Some(plane) = decoder.next_frame()? {
            planes.push(plane);
        }
        Ok(())
    };
    let cut = match all() {
        Err(error) if planes.is_empty() || !options.conceal => return Err(error),
        result => result.err(),
    };
    Ok(DecodedPlanes { planes, rate: decoder.rate().per_second(), cut })
}

/// Decodes a whole stream to poses of every hand it moves. `profile` tells where position and rotation
/// travelled; `None` takes extension BAPs when the stream has them, else the wrist's.
///
/// # Errors
/// See [`StreamToPosesError`].
pub fn decode_poses(
    bytes: &[u8],
    profile: Option<Profile>,
    options: DecoderOptions,
) -> Result<DecodedStream, StreamToPosesError> {
    let DecodedPlanes { planes, rate, cut } = decode_planes(bytes, options)?;
    if planes.is_empty() {
        return Err(StreamToPosesError::NoPlane);
    }
    let all = planes.iter().fold(BapMask::EMPTY, |mask, p| mask.union(&p.baps.mask));
    let hands: Vec<Side> = sides(&all).collect();
    if hands.is_empty() {
        return Err(StreamToPosesError::NoHand { planes: planes.len() });
    }
    let derived = if options.sent_only { BapMask::EMPTY } else { derive::left_to_model(hand_ties(), &all) };
    let profile = profile.unwrap_or_else(|| told_profile(&all));
    let mut clip = PoseClip { header: header_of(&hands, rate), frames: Vec::new() };
    let mut damage = Vec::new();
    for (i, plane) in planes.iter().enumerate() {
        damage.extend(plane.damage.clone());
        let held = planes.get(i + 1).map_or(0, |next| next.skipped);
        for tick in 0..=held {
            let time = plane.time + f64::from(tick) / rate;
            for &side in &hands {
                if let Some(pose) = hand_of(&plane.baps, &all, !derived.is_empty(), side, profile) {
                    clip.frames
                        .push(TimedPose { valid: plane.damage.is_none(), ..TimedPose::new(time, pose) });
                }
            }
        }
    }
    damage.extend(cut);
    Ok(DecodedStream { clip, planes, rate, profile, derived, damage })
}

/// Longest gap between frames of BAP text that holds the frame before it, seconds.
const LONGEST_HOLD: f64 = 10.0;

/// The poses of every hand in BAP frames, which need not come from a stream; none where they move no hand. Gaps of
/// up to ten seconds hold the pose before them, on the ticks of `rate`. `profile` as for [`decode_poses`]; with
/// `derive` the hand model fills in end joints that are left to it. Gives the profile, too.
pub fn poses_from_frames(
    frames: &[TimedBapFrame],
    rate: f64,
    profile: Option<Profile>,
    derive: bool,
) -> (PoseClip, Profile) {
    let all = frames.iter().fold(BapMask::EMPTY, |mask, f| mask.union(&f.baps.mask));
    let hands: Vec<Side> = sides(&all).collect();
    let profile = profile.unwrap_or_else(|| told_profile(&all));
    let derive = derive && !derive::left_to_model(hand_ties(), &all).is_empty();
    let mut clip = PoseClip { header: header_of(&hands, rate), frames: Vec::new() };
    for (i, frame) in frames.iter().enumerate() {
        let gap = frames.get(i + 1).map_or(0.0, |next| next.time - frame.time);
        let held = if gap <= LONGEST_HOLD { (gap * rate).round().max(1.0) as u32 - 1 } else { 0 };
        for tick in 0..=held {
            let poses = hands.iter().filter_map(|&side| hand_of(&frame.baps, &all, derive, side, profile));
            clip.frames.extend(poses.map(|pose| TimedPose::new(frame.time + f64::from(tick) / rate, pose)));
        }
    }
    (clip, profile)
}

fn header_of(hands: &[Side], rate: f64) -> PoseHeader {
    let hands = hands.iter().map(|&side| ClipHand { side, morphology: None }).collect();
    PoseHeader { rate: Some(rate), hands, made_by: None }
}

/// Extension BAPs when there are any of a hand, else the wrist's.
fn told_profile(all: &BapMask) -> Profile {
    let has = |baps: &[handcast_fba::bap::Bap]| baps.iter().any(|&b| all.contains(b));
    let extension = sides(all).any(|side| has(&global_baps(side)));
    let wrist = sides(all).any(|side| has(&wrist_baps(side)));
    if wrist && !extension { Profile::Arm } else { Profile::Hand }
}

/// The pose of one hand; a BAP that is masked off keeps the last value it had.
fn hand_of(frame: &BapFrame, all: &BapMask, derive: bool, side: Side, profile: Profile) -> Option<HandPose> {
    let mut values = [0; handcast_fba::bap::BAP_COUNT];
    for bap in all.iter() {
        values[bap.index()] = frame.value(bap);
    }
    let mut frame = BapFrame::with_values(*all, values);
    if derive {
        derive::fill_in(hand_ties(), &mut frame);
    }
    pose_from_frame(&frame, side, profile)
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::JointAngle;
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

    #[test]
    fn uneven_times_are_put_on_even_ticks() {
        let mut clip = clip(&[Side::Right]);
        for (i, frame) in clip.frames.iter_mut().enumerate() {
            frame.time += 0.5 + if i % 3 == 1 { 0.012 } else { 0.0 };
        }
        let even = on_ticks(&clip, 30.0);
        assert_eq!(even.frames.len(), 60);
        for (i, frame) in even.frames.iter().enumerate() {
            assert!((frame.time - i as f64 / 30.0).abs() < 1e-9);
        }
        assert!(encode_poses(&clip, Profile::Hand, &PlanOptions::default()).is_ok());
    }

    #[test]
    fn streams_without_hands_are_refused() {
        assert!(matches!(
            decode_poses(&[], None, DecoderOptions::default()),
            Err(StreamToPosesError::NoPlane | StreamToPosesError::Syntax(_))
        ));
    }
}
