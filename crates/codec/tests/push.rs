//! Poses pushed one by one give the stream of the whole clip, and bytes cut anyhow give its poses.

#![allow(clippy::unwrap_used)]

use handcast_codec::for_hands;
use handcast_codec::mapping::{PoseMapper, Profile, hand_mask, pose_from_frame, sides};
use handcast_codec::ties::hand_ties;
use handcast_codec::{
    Damage, PoseDecoder, PoseDecoderOptions, PoseEncoder, PoseEncoderOptions, PosesToStreamError,
    StreamToPosesError, bap_frames, decode_baps, decode_planes, decode_poses, encode_poses, on_ticks,
    poses_on_ticks,
};
use handcast_fba::bap::{BapFrame, BapMask, derive};
use handcast_fba::plan::{LiveEncoder, PlanOptions, PlanReport, Target, encode_clip};
use handcast_fba::{DecoderOptions, Encoder, EncoderConfig, ErrorKind, FrameRate, SyntaxError};
use handcast_hand::{HandPose, JointAngle, MAX_GAP, PoseClip, PoseHeader, Side, TimedPose};
use handcast_limits::Limits;
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

const RATE: f64 = 30.0;
const SIDES: [Side; 2] = [Side::Left, Side::Right];

/// A hand that bends, rests and turns by turns.
fn pose(side: Side, frame: usize) -> HandPose {
    let t = frame as f64 / RATE;
    let bend = if (frame / 20).is_multiple_of(2) { 30.0 } else { 30.0 + 40.0 * (3.0 * t).sin().powi(2) };
    let mut pose = HandPose::neutral(side)
        .with_degrees(JointAngle::Index1Flexion, bend)
        .with_degrees(JointAngle::Ring2Flexion, 0.5 * bend)
        .with_degrees(JointAngle::Ring3Flexion, bend / 3.0)
        .with_degrees(JointAngle::Thumb1Abduction, 20.0);
    pose.translation = Vector3::new(0.05 * t, 0.1, -0.6);
    pose.rotation = UnitQuaternion::from_euler_angles(0.1, 0.2 * t, 0.0);
    pose
}

fn clip(sides: &[Side], frames: usize) -> PoseClip {
    let mut clip = PoseClip::default();
    clip.header.rate = Some(RATE);
    for frame in 0..frames {
        clip.frames.extend(sides.iter().map(|&side| TimedPose::new(frame as f64 / RATE, pose(side, frame))));
    }
    clip
}

fn plan(mode: Target, live: bool) -> PlanOptions {
    PlanOptions { mode, live, intra_seconds: 1.0, ..PlanOptions::default() }
}

fn live() -> PlanOptions {
    plan(Target::Rms(0.5), true)
}

/// Frames around one that cannot be coded count as they do where poses come one by one.
#[test]
fn poses_taken_together_are_all_measured_around_one_that_cannot_be_coded() {
    let mut clip = clip(&SIDES[1..], 600);
    clip.frames[300].pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, 1e9);
    let mut one_by_one = encoder(&SIDES[1..], live());
    let mut bytes = Vec::new();
    let mut errors = Vec::new();
    for pose in &clip.frames {
        match one_by_one.push(pose) {
            Ok(ready) => bytes.extend(ready),
            Err(error) => errors.push(error.to_string()),
        }
    }
    let mut together = encoder(&SIDES[1..], live());
    let refused = together.push_all(clip.frames.iter().cloned()).unwrap_err().to_string();
    assert_eq!(errors, [refused]);
    let [one, other] = [one_by_one, together].map(|encoder| encoder.finish().unwrap());
    bytes.extend(one.bytes);
    assert_eq!((bytes, one.report, one.tips), (other.bytes, other.report, other.tips));
}

/// The instants before the first pose of the second hand wait for it.
#[test]
fn a_hand_that_comes_late_has_its_first_pose_from_the_start() {
    let mut clip = clip(&SIDES, 600);
    clip.frames.iter_mut().take(1198).for_each(|frame| frame.valid = frame.pose.side == Side::Right);
    for plan in [live(), plan(Target::Quant(8), false)] {
        let mut one_by_one = encoder(&SIDES, plan);
        let mut together = encoder(&SIDES, plan);
        let mut bytes = Vec::new();
        clip.frames.iter().for_each(|pose| bytes.extend(one_by_one.push(pose).unwrap()));
        assert_eq!(together.push_all(clip.frames.iter().cloned()).unwrap(), bytes);
        let [one, other] = [one_by_one, together].map(|encoder| encoder.finish().unwrap());
        assert_eq!((&one.bytes, &one.report, one.tips), (&other.bytes, &other.report, other.tips));
        bytes.extend(one.bytes);
        let decoded = decode_poses(&bytes, None, DecoderOptions::default()).unwrap().clip;
        let [left, right] = SIDES.map(|side| decoded.of(side).count());
        assert_eq!((left, right), (600, 600));
    }
}

/// What is made and measured on another core meanwhile is the same, however many poses there are, up to the first that is
/// refused.
#[test]
fn poses_taken_together_give_the_bytes_and_the_account_of_one_by_one() {
    for (sides, frames) in [(&SIDES[..], 700), (&SIDES[1..], 256), (&SIDES[1..], 3)] {
        let mut clip = clip(sides, frames);
        clip.frames.iter_mut().skip(5).step_by(31).for_each(|frame| frame.valid = false);
        for plan in [live(), plan(Target::Quant(8), true), plan(Target::Quant(8), false)] {
            let mut one_by_one = encoder(sides, plan);
            let mut bytes = Vec::new();
            clip.frames.iter().for_each(|pose| bytes.extend(one_by_one.push(pose).unwrap()));
            let mut together = encoder(sides, plan);
            let all = together.push_all(clip.frames.iter().cloned()).unwrap();
            assert_eq!(all, bytes);
            let [one, other] = [one_by_one, together].map(|encoder| encoder.finish().unwrap());
            assert_eq!((one.bytes, one.report, one.tips), (other.bytes, other.report, other.tips));
        }
    }
    let mut clip = clip(&SIDES[1..], 600);
    clip.frames[400].pose.side = Side::Left;
    let mut encoder = encoder(&SIDES[1..], live());
    let refused = encoder.push_all(clip.frames[..500].iter().cloned()).unwrap_err();
    assert!(matches!(refused, PosesToStreamError::Hand { side: Side::Left }), "{refused}");
    // What was ready comes with the next call, and it goes on behind.
    let rest = encoder.push_all(clip.frames[500..].iter().cloned()).unwrap();
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
    let mut shown = decoder.push(&[rest, encoder.finish().unwrap().bytes].concat()).unwrap();
    shown.extend(decoder.finish().unwrap());
    assert_eq!(shown.len(), 600);
}

fn encoder(sides: &[Side], plan: PlanOptions) -> PoseEncoder {
    PoseEncoder::new(PoseEncoderOptions::default().with_hands(sides).with_rate(RATE).with_plan(plan)).unwrap()
}

/// All poses of a stream whose bytes come in pieces of these sizes, over and over, and what went wrong.
fn decoded(
    stream: &[u8],
    sizes: &[usize],
    options: DecoderOptions,
) -> (Vec<TimedPose>, Vec<String>, PoseDecoder) {
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default().with_decoder(options));
    let (mut poses, mut errors) = (Vec::new(), Vec::new());
    let mut sizes = sizes.iter().copied().cycle();
    let mut rest = stream;
    while !rest.is_empty() {
        let (piece, behind) = rest.split_at(sizes.next().unwrap_or(1).clamp(1, rest.len()));
        rest = behind;
        let mut found = decoder.push(piece);
        while let Err(error) = found {
            errors.push(error.to_string());
            found = decoder.push(&[]);
        }
        poses.extend(found.unwrap());
    }
    loop {
        match decoder.finish() {
            Ok(last) => poses.extend(last),
            Err(StreamToPosesError::Syntax(error)) => {
                errors.push(error.to_string());
                continue;
            }
            Err(error) => errors.push(error.to_string()),
        }
        return (poses, errors, decoder);
    }
}

#[test]
fn live_poses_give_their_bytes_at_once() {
    let clip = clip(&SIDES, 90);
    let whole = encode_poses(&clip, Profile::Hand, &live()).unwrap();
    let mut encoder = encoder(&SIDES, live());
    let (mut stream, mut silent) = (Vec::new(), 0);
    for (number, pose) in clip.frames.iter().enumerate() {
        let bytes = encoder.push(pose).unwrap();
        // The left hand alone completes no tick.
        assert!(number % 2 == 1 || bytes.is_empty(), "{number}");
        silent += usize::from(number % 2 == 1 && bytes.is_empty());
        stream.extend(bytes);
    }
    assert!(silent < 60, "{silent} of 90 planes gave nothing");
    let end = encoder.finish().unwrap();
    stream.extend(end.bytes);
    assert_eq!(stream, whole.stream);
    assert_eq!(end.report, whole.report);
    assert_eq!(end.report.bytes, stream.len());
}

#[test]
fn with_look_ahead_all_comes_at_the_end() {
    let clip = clip(&[Side::Right], 60);
    let plan = plan(Target::MaxError(1.0), false);
    let mut encoder = encoder(&[Side::Right], plan);
    assert!(clip.frames.iter().all(|pose| encoder.push(pose).unwrap().is_empty()));
    let end = encoder.finish().unwrap();
    let whole = encode_poses(&clip, Profile::Hand, &plan).unwrap();
    assert_eq!(end.bytes, whole.stream);
    assert_eq!(end.report, whole.report);
}

#[test]
fn nothing_is_said_before_every_hand_has_been_seen() {
    let mut clip = clip(&SIDES, 60);
    clip.frames
        .iter_mut()
        .filter(|f| f.pose.side == Side::Right && f.time < 0.99)
        .for_each(|f| f.valid = false);
    let whole = encode_poses(&clip, Profile::Hand, &live()).unwrap();
    let mut encoder = encoder(&SIDES, live());
    let mut stream = Vec::new();
    for pose in &clip.frames {
        let bytes = encoder.push(pose).unwrap();
        assert!(pose.time > 0.99 || bytes.is_empty());
        assert!(pose.time < 0.99 || !stream.is_empty() || pose.pose.side == Side::Left || !bytes.is_empty());
        stream.extend(bytes);
    }
    stream.extend(encoder.finish().unwrap().bytes);
    assert_eq!(stream, whole.stream);
    assert_eq!(decode_poses(&stream, None, DecoderOptions::default()).unwrap().clip.frames.len(), 120);
}

/// Cameras of two hands do not tick together.
#[test]
fn hands_that_come_a_little_apart_share_a_plane() {
    let mut encoder = encoder(&SIDES, live());
    let mut stream = Vec::new();
    for frame in 0..30 {
        for (side, off) in [(Side::Right, 0.002), (Side::Left, -0.003)] {
            let time = 7.0 + frame as f64 / RATE + if frame == 0 { 0.0 } else { off };
            stream.extend(encoder.push(&TimedPose::new(time, pose(side, frame))).unwrap());
        }
    }
    let end = encoder.finish().unwrap();
    assert_eq!((end.report.frames, end.report.seconds), (30, 1.0));
}

#[test]
fn a_pose_that_cannot_be_coded_is_left_out_and_the_next_goes_on() {
    for options in [live(), plan(Target::Quant(10), true)] {
        let mut encoder = encoder(&[Side::Right], options);
        let mut stream = Vec::new();
        for frame in 0..40 {
            let mut pose = pose(Side::Right, frame);
            if frame == 0 || frame == 30 {
                // More than any I plane can say of a bend; frame 30 begins a period.
                pose.set(JointAngle::Index1Flexion, 60.0);
            }
            match encoder.push(&TimedPose::new(frame as f64 / RATE, pose)) {
                Ok(bytes) => stream.extend(bytes),
                Err(error) => {
                    assert!(frame == 0 || frame == 30, "{frame}: {error}");
                    assert_eq!(error.kind(), ErrorKind::Request);
                }
            }
        }
        let end = encoder.finish().unwrap();
        assert_eq!(end.report.frames, 38);
        stream.extend(end.bytes);
        let back = decode_poses(&stream, None, DecoderOptions::default()).unwrap();
        // The first plane is at time 0; it was frame 1.
        assert_eq!(back.clip.frames.len(), 39);
    }
}

#[test]
fn what_makes_no_stream_is_refused() {
    let refused = |options: PoseEncoderOptions| PoseEncoder::new(options).map(|_| ()).unwrap_err();
    let base = PoseEncoderOptions::default;
    assert!(matches!(refused(base().with_rate(400.0)), PosesToStreamError::Rate { .. }));
    assert_eq!(refused(base().with_hands(&[])).kind(), ErrorKind::Request);
    assert!(PoseEncoder::new(base().with_plan(plan(Target::Quant(40), false))).is_err());

    let mut encoder = encoder(&[Side::Right], live());
    let left = TimedPose::new(0.0, HandPose::neutral(Side::Left));
    assert!(matches!(encoder.push(&left), Err(PosesToStreamError::Hand { side: Side::Left })));
    assert!(encoder.push(&TimedPose::lost(f64::NAN, Side::Right)).is_err());
    encoder.push(&TimedPose::lost(0.0, Side::Right)).unwrap();
    assert!(matches!(encoder.finish(), Err(PosesToStreamError::Empty { frames: 1 })));
    for options in [live(), plan(Target::Quant(3), false)] {
        let mut encoder = self::encoder(&[Side::Right], options);
        encoder.push(&TimedPose::new(1.0, pose(Side::Right, 0))).unwrap();
        encoder.push(&TimedPose::new(1.5, pose(Side::Right, 15))).unwrap();
        assert!(encoder.push(&TimedPose::new(1.2, pose(Side::Right, 6))).is_err());
        encoder.push(&TimedPose::new(1.6, pose(Side::Right, 18))).unwrap();
        assert_eq!(encoder.finish().unwrap().report.frames, 3);
    }
}

#[test]
fn skipped_ticks_come_with_the_plane_that_stands_for_them() {
    let frame = |n: usize| PoseMapper::new(Profile::Hand).frame(&[pose(Side::Right, n)]);
    let mut encoder = Encoder::new(EncoderConfig { resync: true, ..EncoderConfig::default() }).unwrap();
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
    let mut bytes = Vec::new();
    let mut counts = Vec::new();
    for n in [0, 20, 25, 27] {
        if n == 25 {
            (0..4).for_each(|_| encoder.skip_frame());
        }
        encoder.write_frame(&frame(n)).unwrap();
        encoder.take_bytes(&mut bytes);
        counts.push(decoder.push(&std::mem::take(&mut bytes)).unwrap());
    }
    counts.push(decoder.push(&encoder.finish()).unwrap());
    // A plane shows when a bit or two of what follows it have come.
    let counts: Vec<usize> = counts.iter().map(Vec::len).collect();
    assert_eq!(counts, [0, 1, 5, 1, 1]);
    assert_eq!(decoder.finish().unwrap(), []);
    assert!(decoder.is_ended() && !decoder.is_revised());
    assert_eq!(decoder.header().hands.len(), 1);
    // One without change is there for the frames left out.
    assert_eq!(decoder.totals().planes, 5);
}

#[test]
fn errors_say_what_can_be_done() {
    let stream = encode_poses(&clip(&[Side::Right], 40), Profile::Hand, &live()).unwrap().stream;
    let decode = |bytes: &[u8], options| decode_poses(bytes, None, options).map(|_| ()).unwrap_err().kind();
    let plain = DecoderOptions::default();
    assert_eq!(decode(&[], plain), ErrorKind::Incomplete);
    assert_eq!(decode(&stream[..stream.len() / 2], plain), ErrorKind::Incomplete);
    let mut damaged = stream.clone();
    let middle = damaged.len() / 2;
    damaged[middle..middle + 8].fill(0);
    assert_eq!(decode(&damaged, plain), ErrorKind::Damaged);
    assert_eq!(decode(b"these are the words of no stream", plain), ErrorKind::Damaged);
    let mut narrow = plain;
    narrow.limits.buffered_bytes = 8;
    assert_eq!(decode(&stream, narrow), ErrorKind::Limit);
    assert_eq!(SyntaxError::Unsupported { bit: 0, what: "dct" }.kind(), ErrorKind::Unsupported);
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default().with_poses_at_once(30));
    assert_eq!(decoder.push(&stream).unwrap_err().kind(), ErrorKind::Limit);
    assert!(decoder.push(&[]).unwrap().len() >= 25);
}

/// Streams one behind the other, each damaged, without an end.
#[test]
fn damage_without_end_is_counted_and_only_its_beginning_kept() {
    let resync = PlanOptions { resync: true, ..live() };
    let sound = encode_poses(&clip(&[Side::Right], 40), Profile::Hand, &resync).unwrap().stream;
    let mut damaged = sound.clone();
    let middle = damaged.len() / 2;
    damaged[middle..middle + 8].fill(0);
    let conceal = DecoderOptions { conceal: true, ..DecoderOptions::default() };
    let mut decoder = PoseDecoder::new(PoseDecoderOptions::default().with_decoder(conceal));
    decoder.push(&sound).unwrap();
    let mut first = Vec::new();
    for _ in 0..4 * Damage::MOST {
        decoder.push(&damaged).unwrap();
        if first.len() < 10 {
            first = decoder.damage().first().to_vec();
        }
    }
    let damage = decoder.damage();
    assert!(damage.count() >= 3 * Damage::MOST, "{}", damage.count());
    assert_eq!((damage.first().len(), damage.further()), (Damage::MOST, damage.count() - Damage::MOST));
    assert!(!first.is_empty() && damage.first().starts_with(&first));
}

/// The poses of a stream by the planes of all of it.
fn by_planes(stream: &[u8], given: Option<Profile>, sent_only: bool) -> (Vec<TimedPose>, BapMask) {
    let planes = decode_planes(stream, DecoderOptions::default()).unwrap();
    let rate = decode_baps(stream, DecoderOptions::default(), &Limits::default()).unwrap().rate;
    let all = planes.iter().fold(BapMask::EMPTY, |mask, plane| mask.union(&plane.baps.mask));
    let derived = if sent_only { BapMask::EMPTY } else { derive::left_to_model(hand_ties(), &all) };
    let arm = hand_mask(Side::Left, Profile::Arm).union(&hand_mask(Side::Right, Profile::Arm));
    let hand = hand_mask(Side::Left, Profile::Hand).union(&hand_mask(Side::Right, Profile::Hand));
    let has = |mask: BapMask| !mask.intersection(&all).is_empty();
    let told =
        if has(arm.difference(&hand)) && !has(hand.difference(&arm)) { Profile::Arm } else { Profile::Hand };
    let (mut poses, mut sent) = (Vec::new(), BapMask::EMPTY);
    for plane in planes {
        sent = sent.union(&plane.baps.mask);
        for tick in 0..=plane.skipped {
            for side in sides(&sent) {
                let mut frame: BapFrame = all.iter().map(|bap| (bap, plane.baps.value(bap))).collect();
                if !derived.is_empty() {
                    derive::fill_in(hand_ties(), &mut frame);
                }
                let pose = pose_from_frame(&frame, side, given.unwrap_or(told)).unwrap();
                poses.push(TimedPose::new(plane.time + f64::from(tick) / rate, pose));
            }
        }
    }
    (poses, derived)
}

/// Masks that grow: fingers wake up one by one, the right hand last.
fn waking(derived: bool, profile: Profile) -> Vec<u8> {
    let options = PlanOptions { derive: derived, ties: hand_ties(), ..live() };
    let mut encoder = LiveEncoder::new(&options).unwrap();
    let mut mapper = PoseMapper::new(profile);
    for n in 0..120 {
        let angle = |from: usize| if n < from { 0.0 } else { 0.5 * ((n - from) as f64 * 0.2).sin() + 0.5 };
        let mut left = HandPose::neutral(Side::Left);
        left.set(JointAngle::Index2Flexion, angle(20));
        left.set(JointAngle::Thumb1Flexion, angle(40));
        let mut right = HandPose::neutral(Side::Right);
        right.set(JointAngle::Ring2Flexion, angle(70));
        right.set(JointAngle::Ring3Flexion, angle(90));
        right.rotation = UnitQuaternion::from_euler_angles(angle(100), 0.0, 0.0);
        encoder.write_frame(&mapper.frame(&[left, right])).unwrap();
    }
    encoder.finish()
}

#[test]
fn a_whole_stream_is_decoded_by_what_all_its_planes_tell() {
    let mut streams = Vec::new();
    for profile in [Profile::Hand, Profile::Arm] {
        for derive in [false, true] {
            streams.push(waking(derive, profile));
            for mode in [Target::Rms(0.5), Target::Quant(8)] {
                let options = PlanOptions { derive, ..plan(mode, false) };
                streams.push(encode_poses(&clip(&SIDES, 60), profile, &options).unwrap().stream);
            }
        }
    }
    // An end joint is sent only after poses had it from the hand model.
    let mut encoder = Encoder::new(EncoderConfig::default()).unwrap();
    for n in 0..20 {
        let mut frame = PoseMapper::new(Profile::Hand).frame(&[pose(Side::Right, 20 + n)]);
        if n < 10 {
            frame.mask = frame.mask.difference(&derive::driven(hand_ties()));
        }
        encoder.write_frame(&frame).unwrap();
    }
    streams.push(encoder.finish());
    let mut revised = 0;
    for stream in &streams {
        for sent_only in [false, true] {
            for profile in [None, Some(Profile::Hand)] {
                let options = DecoderOptions { sent_only, ..DecoderOptions::default() };
                let found = decode_poses(stream, profile, options).unwrap();
                let (poses, derived) = by_planes(stream, profile, sent_only);
                assert_eq!(found.clip.frames, poses);
                assert_eq!(found.derived, derived);
                revised += usize::from(decoded(stream, &[999], options).2.is_revised());
            }
        }
    }
    assert!(revised >= 4, "{revised}: nothing was tested");
}

/// Which frames of which hand are lost, and how poses jitter.
fn recording() -> impl Strategy<Value = PoseClip> {
    let lost = prop::collection::vec((any::<[bool; 2]>(), any::<[bool; 2]>(), -0.3..0.3f64), 5..50);
    (lost, 0..3usize).prop_map(|(frames, hands)| {
        let hands = [&SIDES[..], &SIDES[..1], &SIDES[1..]][hands];
        let mut clip = PoseClip::default();
        clip.header.rate = Some(RATE);
        for (number, (lost, missing, jitter)) in frames.iter().enumerate() {
            for &side in hands {
                let timed = TimedPose {
                    valid: !lost[side as usize],
                    ..TimedPose::new((number as f64 + jitter) / RATE, pose(side, number))
                };
                // A frame without any pose is one that is not there.
                if !missing[side as usize] || number.is_multiple_of(3) {
                    clip.frames.push(timed);
                }
            }
        }
        clip
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// The encoder's own holding and ticking give what a pass over the whole clip gives.
    #[test]
    fn pushes_equal_a_pass_over_the_clip(clip in recording(), live: bool, arm: bool) {
        let profile = if arm { Profile::Arm } else { Profile::Hand };
        let options = for_hands(PlanOptions { rate: FrameRate::ASSUMED, ..plan(Target::Quant(9), live) });
        let max_gap = if live { 0.0 } else { MAX_GAP };
        let ticked = on_ticks(&clip, RATE, max_gap);
        let mut inorder: Vec<&TimedPose> = ticked.frames.iter().collect();
        inorder.sort_by(|a, b| a.time.total_cmp(&b.time));
        prop_assert!(poses_on_ticks(&clip, RATE, max_gap).eq(inorder.into_iter().cloned()));
        let pushed = encode_poses(&clip, profile, &options);
        match bap_frames(&ticked, profile) {
            Ok(frames) => {
                let (stream, report) = encode_clip(&frames, &options).unwrap();
                let pushed = pushed.unwrap();
                prop_assert_eq!(pushed.stream, stream);
                // Errors are those of frames in which hands are seen; of BAPs alone nobody knows that.
                let PlanReport { rms_degrees, rms_all_degrees, max_degrees, .. } = report;
                let told = PlanReport { rms_degrees, rms_all_degrees, max_degrees, ..pushed.report };
                prop_assert_eq!(told, report);
                prop_assert_eq!(pushed.clip, ticked);
            }
            Err(_) => prop_assert!(pushed.is_err_and(|error| error.kind() == ErrorKind::Incomplete)),
        }
    }

    /// How bytes are cut makes no difference, in sound streams and damaged ones.
    #[test]
    fn chunking_makes_no_difference(
        clip in recording(),
        sizes in prop::collection::vec(1usize..40, 1..6),
        damage in prop::option::of((any::<prop::sample::Index>(), 0u8..8)),
        conceal: bool,
    ) {
        let plan = PlanOptions { resync: true, ..live() };
        let Ok(encoded) = encode_poses(&clip, Profile::Hand, &plan) else { return Ok(()) };
        let mut stream = encoded.stream;
        if let Some((at, bit)) = damage {
            let at = at.index(stream.len());
            stream[at] ^= 1 << bit;
        }
        let options = DecoderOptions { conceal, ..DecoderOptions::default() };
        let (poses, errors, decoder) = decoded(&stream, &[usize::MAX], options);
        for sizes in [&sizes[..], &[1]] {
            let (cut, other_errors, other) = decoded(&stream, sizes, options);
            prop_assert_eq!(&cut, &poses);
            prop_assert_eq!(&other_errors, &errors);
            prop_assert_eq!(other.damage(), decoder.damage());
            prop_assert_eq!(other.totals(), decoder.totals());
            prop_assert_eq!(other.header(), decoder.header());
        }
        if damage.is_none() {
            prop_assert!(errors.is_empty(), "{:?}", errors);
            let whole = decode_poses(&stream, None, options).unwrap();
            prop_assert!(decoder.is_revised() || whole.clip.frames == poses);
        }
    }
}

/// Planes that end with a byte are decoded when they come, not with the plane behind them.
#[test]
fn aligned_planes_give_their_poses_at_once() {
    let clip = clip(&SIDES, 200);
    let plan = PlanOptions { aligned: true, resync: true, ..live() };
    let (mut encoder, mut decoder) = (encoder(&SIDES, plan), PoseDecoder::new(PoseDecoderOptions::default()));
    let (mut stream, mut planes) = (Vec::new(), 0);
    for poses in clip.frames.chunks(2) {
        let bytes: Vec<u8> = poses.iter().flat_map(|pose| encoder.push(pose).unwrap()).collect();
        let shown = decoder.push_whole(&bytes).unwrap();
        stream.extend(bytes.iter());
        if bytes.is_empty() {
            assert!(shown.is_empty());
            continue;
        }
        planes += 1;
        let last = &shown[shown.len() - 2..];
        for (shown, pose) in last.iter().zip(poses) {
            assert!((shown.time - pose.time).abs() < 1e-6, "{} {}", shown.time, pose.time);
            let off =
                shown.pose.angle(JointAngle::Index1Flexion) - pose.pose.angle(JointAngle::Index1Flexion);
            assert!(off.to_degrees().abs() < 3.0, "{} {off}", pose.time);
        }
    }
    assert!(planes > 60, "{planes}");
    stream.extend(encoder.finish().unwrap().bytes);
    assert_eq!(decode_poses(&stream, None, DecoderOptions::default()).unwrap().clip.frames.len(), 400);
}

#[test]
fn an_i_plane_comes_when_it_is_asked_for() {
    let clip = clip(&[Side::Right], 90);
    let plan = PlanOptions { aligned: true, resync: true, intra_seconds: 60.0, ..live() };
    let mut encoder = encoder(&[Side::Right], plan);
    let mut opened = Vec::new();
    for (number, pose) in clip.frames.iter().enumerate() {
        if number == 50 {
            encoder.request_intra();
        }
        let bytes = encoder.push(pose).unwrap();
        if bytes.windows(4).any(|window| window == [0, 0, 1, 0xbb]) {
            opened.push(number);
            // Somebody who joins here sees the hand at once.
            let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
            assert!(!decoder.push_whole(&bytes).unwrap().is_empty());
        }
    }
    assert!(opened.contains(&50), "{opened:?}");
}

/// Joints of a sound stream may leave their limits by and by; of a damaged one they come back with its second I plane.
#[test]
fn joints_of_sound_streams_may_leave_their_limits() {
    let header = PoseHeader::one(Side::Right, None, Some(25.0));
    let bend = JointAngle::ALL.into_iter().find(|angle| angle.name() == "thumb1_abduction").unwrap();
    let bent = |frame: usize| {
        let mut pose = HandPose::neutral(Side::Right);
        pose.angles[bend.index()] = 0.012 * frame.min(150) as f64;
        TimedPose::new(frame as f64 / 25.0, pose)
    };
    let clip = PoseClip { header, frames: (0..230).map(bent).collect() };
    let plan = PlanOptions { intra_seconds: 1.0, resync: true, ..PlanOptions::default() };
    let stream = encode_poses(&clip, Profile::Hand, &plan).unwrap().stream;
    let conceal = DecoderOptions { conceal: true, ..DecoderOptions::default() };
    let options = || PoseDecoderOptions::default().with_decoder(conceal);
    let decode = |bytes: &[u8]| {
        let mut decoder = PoseDecoder::new(options());
        let mut poses = decoder.push(bytes).unwrap();
        poses.extend(decoder.finish().unwrap());
        (poses, decoder.damage().count())
    };
    let (poses, damage) = decode(&stream);
    assert_eq!((poses.len(), damage), (230, 0));
    assert!(poses.iter().all(|pose| pose.valid));
    // The joint is beyond its limits when the stream is joined in its second half, and when that begins with damage.
    let (tail, _) = decode(&stream[stream.len() * 2 / 3..]);
    assert!(!tail.is_empty() && tail.iter().all(|pose| pose.valid), "{}", tail.len());
    let damaged: Vec<_> = (2..6)
        .map(|share| stream.len() * share / 12)
        .map(|at| decode(&[&stream[..at], &stream[at + 7..]].concat()))
        .collect();
    assert!(damaged.iter().any(|(_, damage)| *damage > 0));
    let last = |poses: &[TimedPose]| poses.last().unwrap().valid;
    assert!(damaged.iter().all(|(poses, _)| last(poses)), "two I planes in a row are not believed");
}

/// Clocks of cameras are not that of the stream.
#[test]
fn poses_faster_than_the_stream_are_thinned() {
    for (rate, stream, kept) in
        [(30.03, 30.0, 5994), (30.0, 29.97, 5994), (60.0, 30.0, 3000), (29.97, 30.0, 6000)]
    {
        let mut encoder = PoseEncoder::new(PoseEncoderOptions::live(stream)).unwrap();
        let mut bytes = Vec::new();
        for i in 0..6000 {
            let bent = 40.0 * (0.1 * f64::from(i)).sin().abs();
            let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, bent);
            bytes.extend(encoder.push(&TimedPose::new(f64::from(i) / rate, pose)).unwrap());
        }
        let end = encoder.finish().unwrap();
        assert!(end.report.frames.abs_diff(kept) <= 2, "{rate} into {stream}: {} frames", end.report.frames);
    }
}

/// Whatever a bit says, time goes on.
#[test]
fn times_go_on_whichever_bit_is_wrong() {
    let options = PlanOptions { resync: true, ..plan(Target::Rms(2.0), false) };
    let stream = encode_poses(&clip(&[Side::Right], 70), Profile::Hand, &options).unwrap().stream;
    for bit in 0..8 * stream.len() {
        let mut wrong = stream.clone();
        wrong[bit / 8] ^= 0x80 >> (bit % 8);
        let mut decoder = PoseDecoder::new(PoseDecoderOptions::default());
        let mut last = f64::NEG_INFINITY;
        let mut poses = decoder.push(&wrong).unwrap_or_default();
        poses.extend(decoder.finish().unwrap_or_default());
        for pose in poses.iter().take(1000) {
            assert!(pose.time > last, "bit {bit}: {} s after {last} s", pose.time);
            last = pose.time;
        }
    }
}
