//! `handcast track` on the real binary: what it writes, what it refuses, two hands, mirrored clips, smoothing, loss.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::common::command::{done, handcast, misused, path, refused, text};
use handcast_formats::poses::read_poses;
use handcast_hand::{Absence, JointAngle, PoseClip, Side, TimedPose};
use handcast_media::{OpenOptions, open};
use serde_json::Value;

/// A clip as numbered pictures without loss, and its true poses.
fn synth(dir: &Path, name: &str, more: &[&str]) -> (PathBuf, PoseClip) {
    let folder = dir.join(name);
    let poses = dir.join(format!("{name}.truth.jsonl"));
    let args = ["synth", "-q", "-o", path(&folder), "--poses", path(&poses), "--background", "gradient"];
    done(&[&args[..], more].concat());
    (folder, read_poses(&poses).unwrap())
}

/// Tracks a clip; gives the report and the poses.
fn track(clip: &Path, more: &[&str]) -> (Value, PoseClip) {
    let out = clip.with_extension("tracked.jsonl");
    let report = done(&[&["track", path(clip), "-o", path(&out), "--json"], more].concat());
    (serde_json::from_str(&report).unwrap(), read_poses(&out).unwrap())
}

fn of(clip: &PoseClip, side: Side) -> Vec<TimedPose> {
    clip.of(side).cloned().collect()
}

/// Mean error of the joint angles of the valid frames, degrees.
fn error(truth: &PoseClip, found: &PoseClip, side: Side) -> f64 {
    let (truth, found) = (of(truth, side), of(found, side));
    assert_eq!(truth.len(), found.len());
    let mut errors = Vec::new();
    for (a, b) in truth.iter().zip(&found).filter(|(_, b)| b.valid) {
        for angle in JointAngle::ALL {
            errors.push((a.pose.angle(angle) - b.pose.angle(angle)).to_degrees().abs());
        }
    }
    errors.iter().sum::<f64>() / errors.len() as f64
}

const SMALL: [&str; 4] = ["--size", "240x180", "--frames", "24"];

#[test]
fn poses_come_with_confidence_overlap_and_an_overlay() {
    let dir = tempfile::tempdir().unwrap();
    let (clip, truth) = synth(dir.path(), "fist", &[&SMALL[..], &["--motion", "fist"]].concat());
    let overlay = dir.path().join("o.avi");
    let (report, poses) = track(&clip, &["--overlay", path(&overlay)]);
    assert_eq!((report["frames"].as_u64(), poses.frames.len()), (Some(24), 24));
    let hand = &report["hands"][0];
    assert_eq!((hand["hand"].as_str(), hand["tracked_frames"].as_u64()), (Some("right"), Some(24)));
    // Fingers before the palm tell that it is one.
    assert_eq!((hand["view"].as_str(), hand["view_assumed"].as_bool()), (Some("palm"), Some(false)));
    assert!(report["tracking_fps"]["track"].as_f64().unwrap() > 0.0);
    let (open_hand, fist) = (&poses.frames[1], &poses.frames[12]);
    assert!(open_hand.confidence.unwrap() > 0.8, "{open_hand:?}");
    assert!(fist.confidence.unwrap() < 0.6, "folded fingers are hardly seen: {fist:?}");
    assert!(poses.frames.iter().all(|f| f.iou.unwrap() > 0.85 && f.valid && f.why.is_none()));
    assert!(!hand["low_confidence"].as_array().unwrap().is_empty(), "{report}");
    assert!(error(&truth, &poses, Side::Right) < 12.0);
    let mut source = open(&overlay, &OpenOptions::default()).unwrap();
    let mut count = 0;
    while let Some(frame) = source.next_frame().unwrap() {
        assert_eq!(frame.image.dimensions(), (240, 180));
        count += 1;
    }
    assert_eq!(count, 24);

    // The same by other endings, and told in words.
    let csv = dir.path().join("x.csv");
    let words = done(&["track", path(&clip), "-o", path(&csv), "--hand", "left", "--view", "back"]);
    for word in ["24 of 24 frames", "left, back", "mean IoU", "confidence", "frames/s"] {
        assert!(words.contains(word), "{word}: {words}");
    }
    assert_eq!(std::fs::read_to_string(&csv).unwrap().lines().count(), 25);
    let words = done(&["track", path(&clip), "-o", path(&csv), "--hand", "right"]);
    assert!(words.contains("right, palm") && words.contains("below 0.5 in frames"), "{words}");
}

#[test]
#[cfg(feature = "h264")]
#[ignore = "needs the shared material"]
fn hands_of_real_clips_are_named_by_how_their_fingers_bend() {
    let dir = tempfile::tempdir().unwrap();
    for (name, hand, view) in [("finger-flexions", "right", "palm"), ("counting", "right", "back")] {
        let clip = crate::common::shared(&format!("data/clips/{name}.mp4"));
        let out = dir.path().join("poses.jsonl");
        let report = done(&["track", path(&clip), "-o", path(&out), "--json", "--no-net"]);
        let report: Value = serde_json::from_str(&report).unwrap();
        let found = &report["hands"][0];
        assert_eq!(
            (&found["hand"], &found["view"], &found["view_assumed"]),
            (&hand.into(), &view.into(), &false.into()),
            "{name}"
        );
    }
}

#[test]
fn a_mirrored_clip_gives_the_very_same_poses() {
    let dir = tempfile::tempdir().unwrap();
    let more = ["--size", "240x180", "--frames", "12", "--motion", "abduction"];
    let (clip, _) = synth(dir.path(), "plain", &more);
    let mirrored = dir.path().join("mirrored");
    std::fs::create_dir(&mirrored).unwrap();
    for entry in std::fs::read_dir(&clip).unwrap() {
        let from = entry.unwrap().path();
        let image = image::open(&from).unwrap().fliph();
        image.save(mirrored.join(from.file_name().unwrap())).unwrap();
    }
    let (plain, again) = (track(&clip, &[]).1, track(&mirrored, &["--mirror"]).1);
    assert_eq!(plain, again);
    let (report, other) = track(&mirrored, &[]);
    assert_eq!(report["hands"][0]["hand"], "left", "without --mirror it is taken for the other hand");
    assert_eq!(other.frames.len(), 12);
}

#[test]
fn smoothing_steadies_and_is_off_by_default() {
    let dir = tempfile::tempdir().unwrap();
    // A hand that keeps still: all that jitters is the tracker.
    let more = ["--size", "240x180", "--frames", "24", "--motion", "still", "--noise", "6"];
    let (clip, _) = synth(dir.path(), "noisy", &more);
    let (report, raw) = track(&clip, &[]);
    let jitter = |report: &Value| {
        let j = report["hands"][0]["jitter_deg"].as_array().unwrap().clone();
        (j[0].as_f64().unwrap(), j[1].as_f64().unwrap())
    };
    assert_eq!(jitter(&report).0, jitter(&report).1);
    let (report, smooth) = track(&clip, &["--smooth"]);
    let (before, after) = jitter(&report);
    assert!(after < 0.3 * before, "{before} {after}");
    assert_eq!(raw.frames[0], smooth.frames[0]);
    let (report, _) = track(&clip, &["--smooth=0.3,0"]);
    assert!(jitter(&report).1 < after);
}

#[test]
fn a_hand_may_come_after_the_frames_that_colours_are_learnt_from() {
    let dir = tempfile::tempdir().unwrap();
    let (clip, _) = synth(dir.path(), "late", &SMALL);
    // So many that they fill what is learnt from twice, and not to the end.
    const EMPTY: usize = 100;
    for i in (0..24).rev() {
        let name = |i: usize| clip.join(format!("{i:05}.png"));
        std::fs::rename(name(i), name(i + EMPTY)).unwrap();
    }
    let wall = image::RgbImage::from_pixel(240, 180, image::Rgb([90, 110, 130]));
    for i in 0..EMPTY {
        wall.save(clip.join(format!("{i:05}.png"))).unwrap();
    }
    let (report, _) = track(&clip, &[]);
    let hand = &report["hands"][0];
    assert_eq!((report["frames"].as_u64(), hand["lost"][0][0].as_u64()), (Some(124), Some(0)));
    let (tracked, overlap) = (hand["tracked_frames"].as_u64().unwrap(), hand["mean_iou"].as_f64().unwrap());
    assert!((22..=26).contains(&tracked) && overlap > 0.9, "{report}");
    // With nobody in it all frames are told of.
    for i in EMPTY..EMPTY + 24 {
        wall.save(clip.join(format!("{i:05}.png"))).unwrap();
    }
    let out = clip.with_extension("jsonl");
    refused(&["track", path(&clip), "-o", path(&out)], &out, &["first 124 frames"]);
}

#[test]
fn two_hands_are_two_touch_and_part_and_threads_do_not_matter() {
    let dir = tempfile::tempdir().unwrap();
    let size = ["--size", "320x192", "--frames", "20", "--fov", "75", "--motion", "abduction"];
    let (clip, truth) = synth(dir.path(), "two", &[&size[..], &["--two-hands"]].concat());
    let (report, poses) = track(&clip, &["--fov", "75"]);
    assert_eq!(report["hands"].as_array().map(Vec::len), Some(2), "{report}");
    assert_eq!((report["touching"].as_array().map(Vec::len), poses.frames.len()), (Some(0), 40));
    assert_eq!(poses, track(&clip, &["--fov", "75", "--threads", "1"]).1);
    let (alone, true_alone) = synth(dir.path(), "alone", &[&size[..], &["--aside", "-0.12"]].concat());
    let alone = error(&true_alone, &track(&alone, &["--fov", "75"]).1, Side::Right);
    for side in [Side::Left, Side::Right] {
        let off = error(&truth, &poses, side);
        println!("{}: {off:.2}°, alone {alone:.2}°", side.name());
        assert!(off < alone + 1.0, "{off} {alone}");
        assert!(of(&poses, side).iter().all(|f| f.valid));
    }
    // One of them alone.
    let (report, one) = track(&clip, &["--fov", "75", "--hand", "left"]);
    assert_eq!((report["hands"][0]["hand"].as_str(), one.frames.len()), (Some("left"), 20));
    assert!(error(&truth, &one, Side::Left) < alone + 1.0);
}

#[test]
fn touching_hands_hold_and_go_on_as_they_were() {
    let dir = tempfile::tempdir().unwrap();
    let more =
        ["--size", "320x192", "--frames", "32", "--fov", "75", "--motion", "still", "--two-hands", "--meet"];
    let (clip, truth) = synth(dir.path(), "meet", &more);
    let (report, poses) = track(&clip, &["--fov", "75"]);
    let touching = report["touching"].as_array().unwrap();
    assert_eq!(touching.len(), 1, "{report}");
    let stretch: Vec<usize> =
        touching[0].as_array().unwrap().iter().map(|v| v.as_u64().unwrap() as usize).collect();
    assert!((10..14).contains(&stretch[0]) && (17..22).contains(&stretch[1]), "{stretch:?}");
    for side in [Side::Left, Side::Right] {
        let (truth, found) = (of(&truth, side), of(&poses, side));
        for (i, frame) in found.iter().enumerate() {
            let held = (stretch[0]..=stretch[1]).contains(&i);
            assert_eq!((frame.why == Some(Absence::Touching), frame.valid), (held, !held), "{i}");
            if held {
                assert_eq!((frame.confidence, &frame.pose), (Some(0.0), &found[stretch[0] - 1].pose));
            } else {
                let off = (frame.pose.translation - truth[i].pose.translation).xy().norm();
                assert!(off < 0.03, "{} hand, frame {i}: {off} m off", side.name());
            }
        }
    }
    // Both go into one stream and one animated file.
    let out = dir.path().join("run");
    done(&["run", path(&clip), "-o", path(&out), "--fov", "75", "-q", "--no-pictures"]);
    let back = dir.path().join("back.jsonl");
    done(&["decode", path(&out.join("hand.fba")), "-o", path(&back), "-q"]);
    let back = read_poses(&back).unwrap();
    assert_eq!((of(&back, Side::Left).len(), of(&back, Side::Right).len()), (32, 32));
    let glb = gltf::Gltf::open(out.join("hand.glb")).unwrap();
    assert_eq!(glb.document.skins().count(), 2);
}

/// Pictures of a folder, some of them replaced, as another folder.
fn edited(from: &Path, to: &Path, chosen: impl Fn(usize) -> Option<bool>) {
    std::fs::create_dir(to).unwrap();
    let names: BTreeMap<_, _> =
        std::fs::read_dir(from).unwrap().map(|e| e.unwrap().path()).map(|p| (p.clone(), p)).collect();
    for (i, file) in names.into_keys().enumerate() {
        let target = to.join(file.file_name().unwrap());
        match chosen(i) {
            Some(true) => {
                std::fs::copy(&file, target).unwrap();
            }
            Some(false) => {
                image::RgbImage::from_pixel(240, 180, image::Rgb([150, 168, 160])).save(target).unwrap()
            }
            None => {}
        }
    }
}

#[test]
fn a_hand_that_vanishes_is_lost_and_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let (clip, _) = synth(dir.path(), "there", &[&SMALL[..], &["--motion", "translation"]].concat());
    let gaps = dir.path().join("gaps");
    edited(&clip, &gaps, |i| Some(!(9..13).contains(&i)));
    let (report, poses) = track(&gaps, &[]);
    assert_eq!(report["hands"][0]["lost"], serde_json::json!([[9, 12]]), "{report}");
    assert_eq!(poses.frames.len(), 24, "no frame is left out");
    for (i, frame) in poses.frames.iter().enumerate() {
        let gone = (9..13).contains(&i);
        assert_eq!((frame.valid, frame.why), (!gone, gone.then_some(Absence::Lost)), "{i}");
    }
    assert_eq!(poses.frames[10].confidence, Some(0.0));
    let sure = |i: usize| poses.frames[i].confidence.unwrap();
    assert!(sure(13) < 0.6 && sure(19) > 0.8, "{} {}", sure(13), sure(19));
}

#[test]
fn a_hand_that_never_opens_needs_its_sizes() {
    let dir = tempfile::tempdir().unwrap();
    let (clip, _) = synth(dir.path(), "closing", &[&SMALL[..], &["--motion", "fist"]].concat());
    let closed = dir.path().join("closed");
    edited(&clip, &closed, |i| (7..17).contains(&i).then_some(true));
    let out = dir.path().join("x.jsonl");
    refused(&["track", path(&closed), "-o", path(&out)], &out, &["never open", "--person", "handcast fit"]);
    let person = dir.path().join("person.toml");
    done(&["fit", path(&clip.join("00000.png")), "-o", path(&person), "-q"]);
    for start in [&["--person", path(&person)][..], &["--start", "any"]] {
        let (report, poses) = track(&closed, start);
        let hand = &report["hands"][0];
        assert_eq!((poses.frames.len(), hand["fit_iou"].is_null()), (10, true), "{report}");
        assert!(hand["mean_confidence"].as_f64().unwrap() < 0.7, "{report}");
    }
}

#[test]
fn wrong_requests_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("x.jsonl");
    refused(&["track", "none.mp4", "-o", path(&out)], &out, &["none.mp4", "no such file"]);
    let empty = dir.path().join("empty.avi");
    std::fs::write(&empty, b"").unwrap();
    refused(&["track", path(&empty), "-o", path(&out)], &out, &["empty.avi"]);
    let other = dir.path().join("x.docx");
    misused(&["track", path(&empty), "-o", path(&other)], &other, &[".docx", ".jsonl"]);
    let film = dir.path().join("x.mkv");
    let args = ["track", path(&empty), "-o", path(&out), "--overlay", path(&film)];
    misused(&args, &film, &["x.mkv", ".mp4", ".avi"]);
    for wrong in ["--smooth=1", "--smooth=0,0", "--hand=both", "--start=now", "--threads=3", "--fov=2"] {
        let run = handcast(&["track", path(&empty), "-o", path(&out), wrong]);
        assert_eq!(run.status.code(), Some(2), "{wrong}: {}", text(&run.stderr));
    }
}
