//! The way there and back, each seam with its tolerance:
//! clip → poses → BAPs → bits → BAPs → poses → glTF → poses.

use std::path::Path;

use crate::common::command::{done, handcast, misused, path, refused, text};
use crate::common::shared;
use handcast_codec::mapping::{Profile, angle_bap};
use handcast_codec::{EncodedClip, bap_frames, decode_poses, encode_poses, poses_from_frames};
use handcast_eval::fidelity::{
    CompareOptions, Comparison, FidelityOptions, GLB_DEG, HALF_UNIT_DEG, Promise, angle_error, compare,
    measure, measure_clip, mirrored, round_trip,
};
use handcast_eval::synth::{ScriptedMotion, Synth, SynthOptions};
use handcast_fba::DecoderOptions;
use handcast_fba::bap::StepTable;
use handcast_fba::bap::text::{self as bap_text, BapFile};
use handcast_fba::plan::{PlanOptions, Target};
use handcast_fba::state::step;
use handcast_formats::motion::Motion;
use handcast_formats::poses::{read_poses, write_poses};
use handcast_gltf::{Clip, ExportOptions, HandTrack, export};
use handcast_hand::{JointAngle, MAX_GAP, PoseClip, PoseHeader, Side, TimedPose};
use handcast_media::{ClipInfo, Frame, FrameError, FrameSource};
use handcast_track::pipeline::ClipOptions;

/// The poses of a scripted motion, 3 s at 25 frames/s.
fn scripted(name: &str, side: Side) -> PoseClip {
    let mut options = SynthOptions::default();
    options.motion = ScriptedMotion::from_name(name).unwrap();
    options.frames = 75;
    options.side = side;
    let synth = Synth::new(options).unwrap();
    let o = synth.options();
    let header = PoseHeader::one(o.side, Some(o.morphology.clone()), Some(o.rate));
    let frames = (0..synth.frames()).map(|i| TimedPose::new(synth.time(i), synth.pose(i))).collect();
    PoseClip { header, frames }
}

fn demo() -> PoseClip {
    read_poses(&Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/demo.poses.jsonl")).unwrap()
}

/// Motions by name.
type Motions = Vec<(&'static str, PoseClip)>;

fn made_up() -> Motions {
    vec![("fist, right", scripted("fist", Side::Right)), ("signs, left", scripted("signs", Side::Left))]
}

/// Recordings, brought to 30 frames/s.
fn recorded() -> Motions {
    let read = |name| {
        let file = shared(&format!("data/motion/{name}.landmarks.jsonl"));
        (name, Motion::read(&file).unwrap().clip.even(30.0))
    };
    ["leap/pinch", "markers/index-flexion-trial0"].map(read).into()
}

/// Each seam is tried on both.
macro_rules! tried {
    ($($seam:ident)*) => {
        mod on_made_up_motion {
            $(#[test] fn $seam() { super::$seam(super::made_up()); })*
        }
        mod on_recorded_motion {
            $(#[test] #[ignore = "needs the shared material"] fn $seam() { super::$seam(super::recorded()); })*
        }
    };
}

tried! {
    poses_to_baps_and_back
    baps_to_text_and_back
    baps_to_bits_and_back_by_plain_rounding
    baps_to_bits_and_back_as_planned
    poses_to_gltf_and_back
    the_whole_way_keeps_every_promise_for_either_hand
}

fn same_count(clip: &PoseClip, found: &Comparison) {
    assert_eq!(found.hands.iter().map(|h| h.frames).sum::<usize>(), clip.frames.len());
    assert!(found.is_complete());
}

/// A synthetic clip that is drawn when it is asked for.
struct Drawn {
    synth: Synth,
    info: ClipInfo,
    next: usize,
}

impl FrameSource for Drawn {
    fn info(&self) -> &ClipInfo {
        &self.info
    }

    /// It is drawn at one size.
    fn set_max_side(&mut self, _side: u32) {}

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let index = self.next;
        self.next += 1;
        Ok((index < self.synth.frames()).then(|| Frame {
            index,
            time: self.synth.time(index),
            image: self.synth.render(index).image,
        }))
    }
}

/// The first seam. A phalanx of 45 mm that lies in the picture plane is some 21 pixels long here; bent by 25° it looks 2
/// pixels shorter, which is what noise and segmentation move an outline by. So single angles are known to about 25°,
/// and on average to a third of that.
#[test]
fn clip_to_poses() {
    let mut options = SynthOptions::default();
    options.motion = ScriptedMotion::from_name("fist").unwrap();
    options.frames = 50;
    options.size = (320, 240);
    let synth = Synth::new(options).unwrap();
    let o = synth.options();
    let mut truth = PoseClip {
        header: PoseHeader::one(o.side, Some(o.morphology.clone()), Some(o.rate)),
        frames: Vec::new(),
    };
    truth.frames.extend((0..synth.frames()).map(|i| TimedPose::new(synth.time(i), synth.pose(i))));
    let info = ClipInfo {
        width: o.size.0,
        height: o.size.1,
        rate: Some(o.rate),
        frames: Some(synth.frames()),
        format: "drawn".into(),
        ..ClipInfo::default()
    };
    let mut read = 0;
    let source = Drawn { synth, info, next: 0 };
    let measured =
        measure_clip(source, None, &ClipOptions::default(), Some(&truth), &mut |n| read = n).unwrap();
    let (seam, report) = (&measured.seam, &measured.seam.report);
    println!("{report}");
    assert_eq!((read, seam.frame_iou.len(), seam.frame_deg.as_ref().unwrap().len()), (50, 50, 50));
    assert!(seam.lost.is_empty());
    assert!(report.angle_mean_deg.unwrap() < 25.0 / 3.0 && report.angle_p95_deg.unwrap() < 25.0);
    // A pixel all round a hand of 100 × 60 pixels is 5 % of its area.
    assert!(report.iou_mean > 0.93, "{}", report.iou_mean);
    assert!(!measured.moments.is_empty());
    // One set of joint angles, whoever measures: those that are ever other than 0 in the truth.
    let poses = PoseClip { header: measured.clip.header(), frames: measured.clip.poses() };
    let off = angle_error(&truth, &poses, 25.0);
    assert_eq!(off.angles + 6, report.dofs.len());
    assert!((off.mean_deg - report.angle_mean_deg.unwrap()).abs() < 1e-9, "{off:?}");
    let worst = seam.worst_angles.unwrap();
    assert_eq!((measured.moments[0].frame, measured.moments[0].badness), (worst.frame, worst.value));
}

/// A BAP counts in 1e-5 rad, a translation in mm, a rotation vector in 0.1°: half a unit is lost.
fn poses_to_baps_and_back(motions: Motions) {
    for (name, clip) in motions {
        for clip in [&clip, &mirrored(&clip)] {
            let frames = bap_frames(clip, Profile::Hand).unwrap();
            let (back, profile) = poses_from_frames(&frames, clip.header.rate.unwrap(), None, false);
            assert_eq!(profile, Profile::Hand);
            let found = compare(clip, &back, &CompareOptions::default());
            same_count(clip, &found);
            let hand = &found.hands[0];
            assert!(found.max_deg() <= HALF_UNIT_DEG, "{name}: {}", found.max_deg());
            let mm = hand.wrist_mm.as_ref().unwrap().max.value;
            assert!(mm <= 0.5 * 3f64.sqrt() + 1e-9, "{name}: {mm} mm");
            let turned = hand.wrist_deg.as_ref().unwrap().max.value;
            assert!(turned <= 0.05 * 3f64.sqrt() + 1e-6, "{name}: {turned} deg");
        }
    }
}

/// Text holds the integers in full: nothing is lost.
fn baps_to_text_and_back(motions: Motions) {
    for (name, clip) in motions {
        let rate = clip.header.rate.unwrap();
        let frames = bap_frames(&clip, Profile::Hand).unwrap();
        let numbered = frames.iter().map(|f| ((f.time * rate).round() as u32, f.baps)).collect();
        let file = BapFile { version: "3.2".into(), name: "test".into(), rate, frames: numbered };
        assert_eq!(bap_text::read(&bap_text::write(&file)).unwrap(), file, "{name}");
    }
}

/// Plain rounding: half a quantiser step of each joint, and half a unit for the integer behind it.
fn baps_to_bits_and_back_by_plain_rounding(motions: Motions) {
    for (name, clip) in motions {
        for quant in [1u8, 8, 31] {
            let options = PlanOptions { mode: Target::Quant(quant), ..PlanOptions::default() };
            let EncodedClip { stream, clip: sent, .. } =
                encode_poses(&clip, Profile::Hand, &options).unwrap();
            let back = decode_poses(&stream, None, DecoderOptions::default()).unwrap();
            let found = compare(&sent, &back.clip, &CompareOptions::default());
            same_count(&sent, &found);
            for hand in &found.hands {
                for joint in &hand.joints {
                    let angle = JointAngle::from_name(&joint.joint).unwrap();
                    let step = step(angle_bap(hand.side, angle), StepTable::Standard, quant);
                    let limit = (0.5 * f64::from(step) + 0.5) * 1e-5f64.to_degrees();
                    assert!(joint.max.value <= limit + 1e-9, "{name}, {quant}: {joint:?}, allowed {limit}");
                }
            }
        }
    }
}

/// Planned: the error asked for, and a decoder that agrees with the encoder about it to the last bit.
fn baps_to_bits_and_back_as_planned(motions: Motions) {
    let aims = [Target::Rms(0.4), Target::MaxError(1.0), Target::Bitrate(1.2)];
    for (name, clip) in motions {
        for (mode, live) in aims.into_iter().zip([false, false, true]) {
            let options = PlanOptions { mode, live, ..PlanOptions::default() };
            let EncodedClip { stream, clip: sent, report, .. } =
                encode_poses(&clip, Profile::Hand, &options).unwrap();
            let back = decode_poses(&stream, None, DecoderOptions::default()).unwrap();
            let (exact, _) = poses_from_frames(
                &bap_frames(&sent, Profile::Hand).unwrap(),
                back.rate,
                Some(Profile::Hand),
                false,
            );
            let found = compare(&exact, &back.clip, &CompareOptions::default());
            same_count(&sent, &found);
            let hand = &found.hands[0];
            // The measure here goes through radians and back.
            assert!((hand.moving_rms_deg.unwrap() - report.rms_degrees).abs() < 1e-6, "{name} {mode:?}");
            assert!((found.max_deg() - report.max_degrees).abs() < 1e-6, "{name} {mode:?}");
            match mode {
                Target::Rms(aim) => {
                    assert!(report.rms_degrees <= aim, "{name}: {}", report.rms_degrees)
                }
                Target::MaxError(aim) => {
                    assert!(report.max_degrees <= aim, "{name}: {}", report.max_degrees)
                }
                _ => {}
            }
        }
    }
}

/// All keys: 32-bit quaternions. Shorts: 6e-5 rad a rotation. Dropped keys: the tolerance they were dropped with. Of a
/// knuckle's three angles each may be off by more than its rotation is, the more it is bent; hinges are not.
fn poses_to_gltf_and_back(motions: Motions) {
    let folder = tempfile::tempdir().unwrap();
    for (number, (name, clip)) in motions.into_iter().enumerate() {
        for (quantize, tolerance, limit) in [
            (false, 0.0, GLB_DEG),
            (true, 0.0, 6e-5f64.to_degrees()),
            (true, 0.1, 0.1 + 6e-5f64.to_degrees()),
        ] {
            let mut options = ExportOptions::default();
            options.texture = None;
            options.quantize = quantize;
            options.rotation_tolerance = f64::to_radians(tolerance);
            options.translation_tolerance = 1e-4;
            let info = &clip.header.hands[0];
            let poses = clip.frames.iter().map(|f| (f.time, f.pose.clone())).collect();
            let track = HandTrack { morphology: info.morphology.clone().unwrap_or_default(), poses };
            let glb = export(&Clip { hands: vec![track], ..Clip::default() }, &options).unwrap();
            let file = folder.path().join(format!("{number}.glb"));
            std::fs::write(&file, glb).unwrap();
            let back = Motion::read(&file).unwrap();
            let exact = Motion { clip: clip.clone(), keyed: false, ..back.clone() };
            let found = compare(&clip, &back.clip, &CompareOptions::of(&exact, &back));
            same_count(&clip, &found);
            let hand = &found.hands[0];
            for joint in &hand.joints {
                let hinge =
                    ["2_flexion", "3_flexion", "0_flexion"].iter().any(|end| joint.joint.ends_with(end));
                if hinge || !quantize {
                    assert!(joint.max.value <= limit + 1e-6, "{name}, {tolerance}: {joint:?}");
                }
            }
            // Of the whole hand nothing shows: three joints in a row, some 8 cm from the knuckle.
            let tips = hand.fingertips_mm.as_ref().unwrap().max.value;
            assert!(tips <= 3.0 * limit.to_radians() * 80.0 + 1e-3, "{name}, {tolerance}: {tips} mm");
            assert!(
                hand.wrist_deg.as_ref().unwrap().max.value <= limit + 1e-6
                    && hand.wrist_mm.as_ref().unwrap().max.value <= 0.11
            );
        }
    }
}

/// Whatever the encoder is asked for, what it promises is kept.
#[test]
fn promises_of_every_mode_are_kept() {
    let clip = scripted("fist", Side::Left);
    let modes = [Target::Quant(12), Target::MaxError(1.0), Target::Bitrate(1.5), Target::Rms(0.6)];
    for (mode, profile) in modes.into_iter().flat_map(|m| [(m, Profile::Hand), (m, Profile::Arm)]) {
        for (live, derive) in [(false, false), (true, false), (false, true)] {
            let plan = PlanOptions { mode, live, derive, ..PlanOptions::default() };
            let trip = round_trip(&clip, profile, &plan, MAX_GAP).unwrap();
            for seam in &trip.seams {
                assert!(
                    seam.kept,
                    "{plan:?}, {profile:?}: {} {:?} {}",
                    seam.name,
                    seam.promise,
                    seam.max_deg()
                );
                let placed = seam.hands.iter().all(|h| h.wrist_mm.is_some());
                assert_eq!(placed, profile == Profile::Hand);
            }
        }
    }
}

/// The whole way: no more than the sum of the steps, for either hand.
fn the_whole_way_keeps_every_promise_for_either_hand(motions: Motions) {
    for (name, clip) in motions {
        let plan = PlanOptions { mode: Target::Rms(0.4), ..PlanOptions::default() };
        let trips =
            [&clip, &mirrored(&clip)].map(|clip| round_trip(clip, Profile::Hand, &plan, MAX_GAP).unwrap());
        for trip in &trips {
            for seam in &trip.seams {
                assert!(seam.kept, "{name}: {} {:?} {}", seam.name, seam.promise, seam.max_deg());
            }
            let whole = trip.seams.last().unwrap();
            assert!(matches!(whole.promise, Promise::RmsDeg(limit) if limit < 0.42), "{:?}", whole.promise);
        }
        // The mirrored motion is the same numbers with other signs: the same bits, the same error.
        let [one, other] = &trips;
        let apart = compare(&one.decoded.clip, &mirrored(&other.decoded.clip), &CompareOptions::default());
        println!(
            "{name}: {} and {} bytes, {:.4}° and {:.4}° RMS, {:.4}° apart",
            one.encoded.stream.len(),
            other.encoded.stream.len(),
            one.encoded.report.rms_degrees,
            other.encoded.report.rms_degrees,
            apart.max_deg()
        );
        let [a, b] = [one, other].map(|t| t.encoded.stream.len() as f64);
        assert!((a / b - 1.0).abs() < 0.05, "{name}: {a} and {b} bytes");
    }
}

#[test]
fn the_account_of_bits_adds_up() {
    let clip = scripted("fist", Side::Right);
    let (report, trip) = measure("fist", &clip, &FidelityOptions::default()).unwrap();
    let total = 8 * trip.encoded.stream.len() as u64;
    assert_eq!(report.stream.by_use.iter().map(|b| b.bits).sum::<u64>(), total);
    assert_eq!(report.stream.by_group.iter().map(|b| b.bits).sum::<u64>(), total);
    assert!(
        report.stream.by_group.iter().any(|b| b.name == "wrist position"),
        "{:?}",
        report.stream.by_group
    );
    assert_eq!(report.stream.frame_bits.len(), report.frames);
    let curve = report.curve.unwrap();
    // Coarser steps cost less and are further off.
    for pair in curve.quantisers.windows(2) {
        assert!(pair[1].bytes <= pair[0].bytes && pair[1].rms_deg >= pair[0].rms_deg, "{pair:?}");
    }
    for (point, aim) in curve.planned.iter().zip(handcast_eval::fidelity::AIMS) {
        assert!(point.rms_deg <= aim + 1e-9 && point.aim_deg == Some(aim));
    }
    assert_eq!(report.latency.len(), 5);
    // Frames that are skipped are not decoded.
    assert!(report.latency.iter().all(|l| l.frames > 20 && l.p50_ms <= l.p95_ms), "{:?}", report.latency);
    let symmetry = report.symmetry.unwrap();
    assert!((symmetry.rms_deg[0] - symmetry.rms_deg[1]).abs() < 0.05, "{symmetry:?}");
}

/// Also where no stream has their rate: it then has several ticks to a frame, and holds it.
#[test]
fn streams_are_the_poses_that_they_were_made_of_at_odd_rates() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let (poses, stream) = (file("a.jsonl"), file("a.fba"));
    let demo = read_poses("fixtures/demo.poses.jsonl".as_ref()).unwrap();
    for (rate, carried) in [(6.67, true), (20.0 / 3.0, true), (9.09, true), (12.5, false), (7.3, false)] {
        let mut clip = demo.clone();
        clip.header.rate = Some(rate);
        clip.frames.iter_mut().for_each(|frame| frame.time *= 25.0 / rate);
        write_poses(&poses, &clip).unwrap();
        done(&["encode", path(&poses), "-o", path(&stream), "-q"]);
        for [a, b] in [[&stream, &poses], [&poses, &stream]] {
            let report = done(&["compare", path(a), path(b), "--json"]);
            let report: serde_json::Value = serde_json::from_str(&report).unwrap();
            assert_eq!(report["hands"][0]["frames"], 150, "{rate}");
            assert_eq!(
                report["carrier"],
                serde_json::json!([carried && a == &stream, carried && b == &stream])
            );
        }
    }
}

#[test]
fn compare_tells_what_differs_and_answers_by_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    write_poses(&file("a.jsonl"), &demo()).unwrap();
    done(&["encode", path(&file("a.jsonl")), "-o", path(&file("a.fba")), "-q"]);
    for name in ["b.glb", "b.bap", "b.csv", "b.bvh", "b.json", "b.landmarks.jsonl"] {
        done(&["decode", path(&file("a.fba")), "-o", path(&file(name)), "-q"]);
    }
    let compared = |a: &str, b: &str, more: &[&str]| {
        let [a, b] = [file(a), file(b)];
        handcast(&[&["compare", path(&a), path(&b)][..], more].concat())
    };
    // The stream and what was decoded from it; joint positions show less, and through another model.
    for (name, tolerance) in
        [("b.bap", "0"), ("b.csv", "0.001"), ("b.json", "0.001"), ("b.bvh", "0.01"), ("b.glb", "0.02")]
    {
        let out = compared("a.fba", name, &["--tolerance", tolerance]);
        assert_eq!(out.status.code(), Some(0), "{name}: {}{}", text(&out.stdout), text(&out.stderr));
    }
    let marks = compared("a.fba", "b.landmarks.jsonl", &["--json", "--tolerance", "10"]);
    let facts: serde_json::Value = serde_json::from_slice(&marks.stdout).unwrap();
    assert!(facts["left_out"].as_array().unwrap().iter().any(|a| a == "index1_twisting"), "{facts}");
    assert_eq!(facts["b"]["kind"], "landmarks");
    let baps = text(&compared("a.fba", "b.bap", &[]).stdout);
    assert!(baps.contains("BAPs: the same in all"), "{baps}");

    // What coding changed.
    let out = compared("a.jsonl", "a.fba", &[]);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stdout));
    let out = compared("a.jsonl", "a.fba", &["--tolerance", "0.2"]);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stdout).contains("first divergence: frame"), "{}", text(&out.stdout));
    assert_eq!(text(&compared("a.jsonl", "a.fba", &["-q"]).stdout), "");

    // One joint of one frame; a frame less; the other hand; other values on the wire.
    let mut changed = demo();
    let pose = &mut changed.frames[42].pose;
    pose.set(JointAngle::Ring2Flexion, pose.angle(JointAngle::Ring2Flexion) + 0.1);
    write_poses(&file("joint.jsonl"), &changed).unwrap();
    let out = compared("a.jsonl", "joint.jsonl", &["--json"]);
    let facts: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!((out.status.code(), &facts["same"]), (Some(1), &serde_json::json!(false)));
    assert_eq!(facts["first_divergence"]["frame"], 42);
    assert_eq!(facts["first_divergence"]["joint"], "ring2_flexion");
    assert_eq!(facts["hands"][0]["joints"].as_array().unwrap().len(), 29);
    let mut shorter = demo();
    shorter.frames.truncate(100);
    write_poses(&file("short.jsonl"), &shorter).unwrap();
    let out = compared("a.jsonl", "short.jsonl", &[]);
    assert_eq!(out.status.code(), Some(1));
    for words in ["frame counts differ, 150 and 100", "50 frames of A have none in B", "--partial"] {
        assert!(text(&out.stdout).contains(words), "{}", text(&out.stdout));
    }
    assert_eq!(compared("a.jsonl", "short.jsonl", &["--partial"]).status.code(), Some(0));
    write_poses(&file("left.jsonl"), &mirrored(&demo())).unwrap();
    let out = compared("a.jsonl", "left.jsonl", &["--partial"]);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stdout).contains("no hand in common"), "{}", text(&out.stdout));
    done(&["encode", path(&file("a.jsonl")), "-o", path(&file("coarse.fba")), "--quant", "20", "-q"]);
    let out = text(&compared("a.fba", "coarse.fba", &[]).stdout);
    assert!(out.contains("BAPs: they part at frame"), "{out}");

    // Bad input and bad usage.
    let none = file("none");
    std::fs::write(file("bad.fba"), b"no stream").unwrap();
    refused(&["compare", path(&file("a.fba")), path(&file("bad.fba"))], &none, &["bad.fba"]);
    refused(&["compare", path(&file("a.fba")), path(&file("missing.glb"))], &none, &["missing.glb"]);
    refused(&["compare", path(&file("a.fba")), path(&file("a.txt"))], &none, &["a.txt"]);
    for wrong in [&["a.fba"][..], &["a.fba", "b.fba", "--tolerance", "-1"], &["a", "b", "--tolerance", "x"]] {
        assert_eq!(handcast(&[&["compare"][..], wrong].concat()).status.code(), Some(2), "{wrong:?}");
    }
}

#[test]
fn frames_that_one_has_not_are_a_difference_whichever_comes_first() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    write_poses(&file("a.jsonl"), &demo()).unwrap();
    done(&["encode", path(&file("a.jsonl")), "-o", path(&file("a.fba")), "-q"]);
    let compared = |a: &str, b: &str, more: &[&str]| {
        let [a, b] = [file(a), file(b)];
        handcast(&[&["compare", path(&a), path(&b)][..], more].concat())
    };
    // A hand that one has lost; a stream cannot say so, and holds it.
    let mut lost = demo();
    lost.frames[60..100].iter_mut().for_each(|frame| frame.valid = false);
    write_poses(&file("lost.jsonl"), &lost).unwrap();
    for (a, b, note) in [
        ("a.jsonl", "lost.jsonl", "in 40 frames of A the hand is lost in B"),
        ("lost.jsonl", "a.jsonl", "in 40 frames of B the hand is lost in A"),
    ] {
        let out = compared(a, b, &[]);
        assert_eq!(out.status.code(), Some(1), "{}", text(&out.stdout));
        assert!(text(&out.stdout).contains(note), "{}", text(&out.stdout));
        assert_eq!(compared(a, b, &["--partial"]).status.code(), Some(0));
    }
    done(&["encode", path(&file("lost.jsonl")), "-o", path(&file("lost.fba")), "-q"]);
    for (a, b) in [("lost.jsonl", "lost.fba"), ("lost.fba", "lost.jsonl")] {
        let out = compared(a, b, &[]);
        assert_eq!(out.status.code(), Some(0), "{}", text(&out.stdout));
    }
    assert_eq!(compared("lost.jsonl", "a.fba", &[]).status.code(), Some(1));

    // Every second frame, at half the rate.
    let mut half = demo();
    half.header.rate = half.header.rate.map(|rate| 0.5 * rate);
    half.frames = half.frames.into_iter().step_by(2).collect();
    write_poses(&file("half.jsonl"), &half).unwrap();
    for (a, b) in [("a.jsonl", "half.jsonl"), ("half.jsonl", "a.jsonl")] {
        let out = compared(a, b, &["--tolerance", "20"]);
        assert_eq!(out.status.code(), Some(1), "{}", text(&out.stdout));
        assert!(text(&out.stdout).contains("but rates differ"), "{}", text(&out.stdout));
    }
}

#[test]
fn fidelity_writes_a_page_that_needs_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let clip = file("clip.avi");
    let small = ["--size", "240x180", "--frames", "30", "--motion", "fist", "-q"];
    done(&[&["synth", "-o", path(&clip)][..], &small].concat());
    let page = file("report.html");
    let json = done(&["fidelity", path(&clip), "-o", path(&page), "--json", "--no-curve"]);
    let facts: serde_json::Value = serde_json::from_str(&json).unwrap();
    // The true poses beside the clip were found.
    assert_eq!(facts["tracking"]["frame_deg"].as_array().unwrap().len(), 30);
    assert!(
        facts["tracking"]["mirror"]["iou_mean"][1].as_f64().unwrap() > 0.9,
        "{}",
        facts["tracking"]["mirror"]
    );
    assert_eq!(facts["latency"].as_array().unwrap().len(), 8);
    assert_eq!(facts["seams"].as_array().unwrap().len(), 5);
    assert!(facts.get("curve").is_none());
    let html = std::fs::read_to_string(&page).unwrap();
    let other = html.replace("http://www.w3.org/2000/svg", "");
    for word in ["http://", "https://", "<link", "src=\"/", "@import", "url("] {
        assert!(!other.contains(word), "{word} in the page");
    }
    assert!(html.contains("prefers-color-scheme") && html.contains("name=\"viewport\""));
    assert!(html.matches("<svg").count() >= 3 && html.matches("data:image/").count() >= 12);
    let inside = html.split("id=\"facts\">").nth(1).unwrap().split("</script>").next().unwrap();
    let inside: serde_json::Value = serde_json::from_str(&inside.replace("<\\/", "</")).unwrap();
    assert_eq!(inside, facts);

    // Poses, as text and as a file of facts.
    let poses = file("clip.poses.jsonl");
    let text_report = done(&["fidelity", path(&poses), "-o", path(&file("facts.json")), "--no-curve"]);
    for words in ["coding", "glTF", "kbit/s", "other hand", "latency"] {
        assert!(text_report.contains(words), "{text_report}");
    }
    let facts: serde_json::Value =
        serde_json::from_slice(&std::fs::read(file("facts.json")).unwrap()).unwrap();
    assert!(facts.get("tracking").is_none() && facts["frames"] == 30);

    // Bad input and bad usage.
    let none = file("none.html");
    std::fs::write(file("bad.jsonl"), "{}\n").unwrap();
    refused(&["fidelity", path(&file("bad.jsonl")), "-o", path(&none)], &none, &["format"]);
    refused(&["fidelity", path(&file("missing.mp4")), "-o", path(&none)], &none, &["missing.mp4"]);
    misused(&["fidelity", path(&poses), "-o", path(&file("x.pdf"))], &file("x.pdf"), &[".html"]);
    misused(&["fidelity", path(&poses), "--truth", path(&poses), "-o", path(&none)], &none, &["--truth"]);
    assert_eq!(handcast(&["fidelity", path(&poses), "--quant", "40"]).status.code(), Some(2));
}

#[test]
fn what_is_not_known_is_not_counted() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let (clip, poses) = (file("clip.avi"), file("clip.poses.jsonl"));
    let small = ["--size", "240x180", "--frames", "30", "--motion", "fist", "-q"];
    done(&[&["synth", "-o", path(&clip)][..], &small].concat());
    // A truth of ten frames that begins later.
    let mut some = read_poses(&poses).unwrap();
    some.frames.truncate(10);
    some.frames.iter_mut().for_each(|frame| frame.time += 5.5);
    write_poses(&file("some.jsonl"), &some).unwrap();
    let truth = path(&file("some.jsonl")).to_owned();
    let against = |more: &[&str]| {
        done(&[&["fidelity", path(&clip), "--truth", &truth, "--no-curve", "--no-mirror"][..], more].concat())
    };
    let said = against(&[]);
    for words in ["truth       in 10 of 30 frames", "starts at 0.000 s, its truth at 5.500 s"] {
        assert!(said.contains(words), "{said}");
    }
    let known: serde_json::Value = serde_json::from_str(&against(&["--json"])).unwrap();
    let report = &known["tracking"]["report"];
    let counted = ["frames", "truth_frames", "visible_frames"].map(|key| report[key].as_u64().unwrap());
    assert_eq!(counted, [30, 10, 10], "{report}");
    assert_eq!(known["tracking"]["starts"], serde_json::json!([0.0, 5.5]));
    // One of another clip: longer, or of a hand elsewhere.
    let told = |poses: &PoseClip| {
        write_poses(&file("some.jsonl"), poses).unwrap();
        handcast(&["fidelity", path(&clip), "--truth", &truth, "--no-curve", "--no-mirror", "-q"])
    };
    let own = read_poses(&poses).unwrap();
    assert_eq!(text(&told(&own).stderr), "");
    let mut moved = own.clone();
    moved.frames.iter_mut().for_each(|frame| frame.pose.translation.x += 0.15);
    let out = told(&moved);
    let words = text(&out.stderr);
    assert!(out.status.success() && words.contains("the true wrist is seen 0.8 hand lengths off"), "{words}");
    let (mut longer, end) = (own.clone(), own.frames.len() as f64 / 25.0);
    longer.frames.extend(own.frames.into_iter().map(|frame| TimedPose { time: frame.time + end, ..frame }));
    let out = told(&longer);
    let words = text(&out.stderr);
    assert!(!out.status.success() && words.contains("true poses of 60 pictures for the 30"), "{words}");

    // Without losses there is nothing that could be wrong.
    let none_lost = done(&["fidelity", path(&poses), "--loss", "0%", "--seeds", "1", "--json"]);
    let none_lost: serde_json::Value = serde_json::from_str(&none_lost).unwrap();
    for key in ["recovery_s", "wrong_rms_deg", "wrong_unmarked_share", "unmarked_max_deg"] {
        assert!(none_lost[key].is_null(), "{key}: {none_lost}");
    }
}

fn table_of_sizes(more: &[&str]) -> serde_json::Value {
    serde_json::from_str(&done(&[&["bench", "sizes", "--json"][..], more].concat())).unwrap()
}

fn in_table(table: &serde_json::Value, format: &str, key: &str) -> f64 {
    let row = table["rows"].as_array().unwrap().iter().find(|r| r["format"] == format);
    row.unwrap_or_else(|| panic!("{format} in {table}"))[key].as_f64().unwrap()
}

/// No format is further off than the stream, which is what sizes are divided by.
fn assert_same_error(table: &serde_json::Value) {
    let ours = in_table(table, "FBA stream", "rms_deg");
    assert!(ours <= 0.5 && in_table(table, "FBA stream", "ratio") == 1.0);
    let rows = table["rows"].as_array().unwrap();
    for row in rows.iter().filter(|r| !r["format"].as_str().unwrap().starts_with("FBA")) {
        assert!(row["rms_deg"].as_f64().unwrap() <= ours + 1e-6, "{row}");
    }
}

#[test]
fn sizes_are_compared_at_the_same_error() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("no-gltfpack");
    let table = table_of_sizes(&["--gltfpack", path(&missing)]);
    assert!(table["left_out"][0].as_str().unwrap().starts_with("gltfpack"), "{table}");
    assert_same_error(&table);
    assert!(in_table(&table, "raw f32, JSON", "ratio") > 20.0);
    assert!(in_table(&table, "raw f32, binary", "ratio") > 20.0);
    refused(&["bench", "sizes", path(folder.path())], &missing, &["no motion"]);
    refused(&["bench", "sizes", path(&missing)], &missing, &["no-gltfpack"]);
}

#[test]
#[ignore = "needs Node and npm ci --prefix tests/node"]
fn gltfpack_is_compared_at_the_same_error() {
    let table = table_of_sizes(&[]);
    assert_eq!(table["left_out"], serde_json::json!([]));
    assert_same_error(&table);
    assert!(in_table(&table, "GLB through gltfpack -cc", "ratio") > 3.0);
}
