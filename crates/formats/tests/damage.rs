//! Damaged streams, streams joined in their middle and streams one behind the other, in every format that is written.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use handcast_codec::mapping::Profile;
use handcast_codec::{DecodedStream, StreamToPosesError, decode_planes, decode_poses, encode_poses};
use handcast_fba::plan::PlanOptions;
use handcast_fba::{DecodedFrame, DecoderOptions};
use handcast_formats::motion::{Format, Motion, WriteOptions};
use handcast_hand::{HandPose, JointAngle, PoseClip, PoseHeader, Side, TimedPose};
use nalgebra::{UnitQuaternion, Vector3};

const FRAMES: usize = 150;

fn clip() -> PoseClip {
    let pose = |n: usize| {
        let t = n as f64 / 30.0;
        let mut pose = HandPose::neutral(Side::Right);
        for (k, angle) in JointAngle::ALL.into_iter().enumerate().filter(|(k, _)| k % 3 != 1) {
            pose.set(angle, 0.1 + 0.2 * (1.7 * t + k as f64).sin());
        }
        pose.translation = Vector3::new(0.1 * t.sin(), 0.05 * t.cos(), -0.5);
        pose.rotation = UnitQuaternion::from_euler_angles(0.3 * t.sin(), 0.2, 0.1 * t);
        TimedPose::new(t, pose)
    };
    let frames = (0..FRAMES).map(pose).collect();
    PoseClip { header: PoseHeader::one(Side::Right, None, Some(30.0)), frames }
}

fn stream(resync: bool) -> Vec<u8> {
    let plan = PlanOptions { resync, intra_seconds: 1.0, ..PlanOptions::default() };
    encode_poses(&clip(), Profile::Hand, &plan).unwrap().stream
}

fn concealed(bytes: &[u8]) -> Result<DecodedStream, StreamToPosesError> {
    decode_poses(bytes, None, DecoderOptions { conceal: true, ..DecoderOptions::default() })
}

/// How a trial writes: the surface of the hand, which no damage reaches and which takes a second to make, in the first alone.
fn writing(trial: usize) -> WriteOptions {
    let mut options = WriteOptions::default();
    options.gltf.animation_only = trial > 0;
    options
}

/// splitmix64.
fn random(state: &mut u64) -> usize {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (z ^ (z >> 31)) as usize
}

#[test]
fn every_format_is_written_for_every_damage() {
    let sound = [true, false].map(stream);
    let planes = decode_planes(&sound[1], DecoderOptions::default()).unwrap();
    let mut state = 7;
    let (mut held, mut lost) = (0, 0);
    for trial in 0..72 {
        let mut bytes = sound[trial % 2].clone();
        let at = if trial < 16 { trial / 2 } else { random(&mut state) % bytes.len() };
        bytes[at] ^= (1 + random(&mut state) % 255) as u8;
        let decoded = match concealed(&bytes) {
            Ok(decoded) => decoded,
            // Without start codes the ranges of the first I plane serve those that follow.
            Err(error) if trial % 2 == 1 && 8 * (at as u64) < planes[0].end_bit => {
                lost += 1;
                assert!(error.to_string().contains("bit"), "byte {at}: {error}");
                continue;
            }
            Err(error) => panic!("byte {at}: {error}"),
        };
        decoded.clip.check().unwrap();
        let [first, last] = decoded.totals.times.unwrap();
        assert!(last - first < 60.0, "byte {at}: from {first} to {last} s");
        // Without start codes what comes before the damage is sure.
        let before = |plane: &&DecodedFrame| plane.end_bit <= 8 * at as u64;
        let least = if trial % 2 == 0 { 100 } else { planes.iter().filter(before).count() };
        held += usize::from(decoded.clip.frames.iter().any(|frame| !frame.valid));
        for format in Format::written() {
            let file = format.write(&decoded.clip, &writing(trial));
            let file = file.unwrap_or_else(|error| panic!("{}, byte {at}: {error}", format.name));
            let back = Motion::parse("-".as_ref(), &file.bytes);
            let back = back.unwrap_or_else(|error| panic!("{}, byte {at}: {error}", format.name));
            let count = back.clip.frames.len();
            assert!(count >= least, "{}, byte {at}: {count} of at least {least}", format.name);
        }
    }
    assert!(held > 48, "{held} of 72 damages show");
    assert!(lost < 8, "{lost} of 36 streams without start codes are lost");
}

#[test]
fn joining_at_any_byte_goes_on_at_the_next_i_plane() {
    let bytes = stream(true);
    let whole = decode_poses(&bytes, None, DecoderOptions::default()).unwrap();
    assert_eq!((whole.passed_over, whole.streams, whole.trailing), (None, 1, 0));
    let intra = whole.totals.intra_planes;
    assert!(intra >= 5);
    let mut starts = std::collections::BTreeSet::new();
    let mut tails = 0;
    for cut in (1..bytes.len()).step_by(7) {
        let Ok(tail) = decode_poses(&bytes[cut..], None, DecoderOptions::default()) else {
            tails += 1;
            continue;
        };
        assert!(tail.passed_over.is_some() && tail.damage.count() == 0);
        let count = tail.clip.frames.len();
        let mut same = whole.clip.frames[FRAMES - count..].iter().zip(&tail.clip.frames);
        assert!(same.all(|(a, b)| a.pose == b.pose), "cut at {cut}");
        starts.insert(count);
    }
    // Only behind the last I plane there is none to join at.
    assert!(tails * 7 < bytes.len() / 3, "{tails}");
    assert!(starts.len() + 1 >= intra, "{} of {intra} I planes", starts.len());
}

#[test]
fn what_follows_an_end_code_is_decoded_or_told() {
    let bytes = stream(true);
    let twice = [&bytes[..], &bytes].concat();
    let both = decode_poses(&twice, None, DecoderOptions::default()).unwrap();
    assert_eq!((both.streams, both.trailing, both.clip.frames.len()), (2, 0, 2 * FRAMES));
    both.clip.check().unwrap();
    let (first, second) = both.clip.frames.split_at(FRAMES);
    assert!(first.iter().zip(second).all(|(a, b)| a.pose == b.pose));
    assert!((second[0].time - 5.0).abs() < 1e-9, "{}", second[0].time);

    let more = [&bytes[..], b"words"].concat();
    let told = decode_poses(&more, None, DecoderOptions::default()).unwrap();
    assert_eq!((told.streams, told.trailing, told.clip.frames.len()), (1, 5, FRAMES));
}
