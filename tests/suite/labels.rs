//! `handcast bench labels` and `handcast track --joints` from the command line.

use std::path::Path;

use crate::common::command::{done, handcast, path, refused};
use crate::common::shared;
use handcast_formats::poses::{read_poses, write_poses};
use handcast_hand::landmarks::LANDMARKS_21;
use handcast_hand::{Side, Skeleton, count_extended};
use serde_json::Value;

const DEMO_POSES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/demo.poses.jsonl");
const DEMO_CLIP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/demo.avi");

#[test]
fn poses_are_held_against_labels() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (poses, letters, counts) = (at("i.jsonl"), at("i.letters"), at("i.counts"));
    done(&["pose", "asl:I", "-o", path(&poses)]);
    std::fs::write(&letters, "0 I\n").unwrap();
    std::fs::write(&counts, "0 1\n").unwrap();
    let labels = ["bench", "labels", path(&poses), "--letters", path(&letters), "--counts", path(&counts)];
    let report: Value = serde_json::from_str(&done(&[&labels[..], &["--json"]].concat())).unwrap();
    assert_eq!(report["letters"]["ranges"][0]["said"], serde_json::json!([["I", 1]]));
    assert_eq!(report["counts"]["share"], 1.0);
    assert!(done(&labels).contains("I shown, nearest in 100.0 % of   1 frames: I×1"));
    // A hand that is not seen shows nothing that is right.
    let mut clip = read_poses(&poses).unwrap();
    clip.frames[0].valid = false;
    write_poses(&poses, &clip).unwrap();
    let said = done(&labels);
    for part in
        ["as labelled in 0.0 % of 1 frames, 1 without a hand", "nearest in   0.0 % of   1 frames, 1 without"]
    {
        assert!(said.contains(part), "{said}");
    }
    std::fs::write(&letters, "0 ?\n").unwrap();
    let wrong = ["bench", "labels", DEMO_POSES, "--letters", path(&letters)];
    refused(&wrong, &at("nothing"), &["i.letters: line 1: '?', allowed A to Z"]);
}

#[test]
fn spelled_letters_are_where_their_labels_say() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (poses, labels) = (at("x.jsonl"), at("x.letters"));
    done(&["spell", "Vowel 5", "-o", path(&poses), "--labels", path(&labels)]);
    let args = ["bench", "labels", path(&poses), "--letters", path(&labels), "--json"];
    let report: Value = serde_json::from_str(&done(&args)).unwrap();
    assert_eq!(report["letters"]["ranges"].as_array().unwrap().len(), 5);
    assert_eq!(report["letters"]["share"], 1.0, "{report}");
    assert!(
        std::fs::read_to_string(labels)
            .unwrap()
            .lines()
            .any(|line| line.starts_with("# ") && line.ends_with(" 5"))
    );
    // Lines that are left out shift all behind them.
    let mut gap = read_poses(&poses).unwrap();
    gap.frames.drain(10..15);
    write_poses(&at("gap.jsonl"), &gap).unwrap();
    let labels = at("x.letters");
    let gap = at("gap.jsonl");
    let timed = ["bench", "labels", path(&gap), "--letters", path(&labels), "--frames", path(&poses)];
    let shifted = handcast(&timed[..5]);
    let said = crate::common::command::text(&shifted.stderr);
    assert!(said.contains("5 frames have no pose, the first of them behind 0.300 s"), "{said}");
    assert_eq!(crate::common::command::text(&handcast(&timed).stderr), "");
    // Digits are notes alone.
    let out = handcast(&["spell", "42", "-o", path(&poses), "--labels", path(&labels)]);
    let said = crate::common::command::text(&out.stderr);
    assert!(out.status.success() && said.contains("no letter A to Z is held"), "{said}");
}

#[test]
fn frames_are_found_by_their_times() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (rows, counts) = (at("rows.csv"), at("x.counts"));
    let mut clip = read_poses(DEMO_POSES.as_ref()).unwrap();
    let labelled = 20..60;
    let lines = labelled.clone().map(|i| format!("{i} {}\n", count_extended(&clip.frames[i].pose)));
    std::fs::write(&counts, lines.collect::<String>()).unwrap();
    // Lost ones are no rows of a table.
    clip.frames.iter_mut().step_by(4).for_each(|frame| frame.valid = false);
    let poses = at("lost.jsonl");
    write_poses(&poses, &clip).unwrap();
    done(&["import", path(&poses), "-o", path(&rows)]);
    let args = ["bench", "labels", path(&rows), "--counts", path(&counts), "--json", "--frames", DEMO_POSES];
    let report: Value = serde_json::from_str(&done(&args)).unwrap();
    assert_eq!(
        (&report["counts"]["frames"], &report["counts"]["missed"]),
        (&40.into(), &10.into()),
        "{report}"
    );
    assert_eq!(report["counts"]["share"], 0.75);
}

#[test]
fn joints_without_places_in_the_picture_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (joints, poses) = (at("i.landmarks.jsonl"), at("poses.jsonl"));
    done(&["pose", "asl:I", "-o", path(&joints)]);
    let track = ["track", DEMO_CLIP, "--joints", path(&joints), "-o", path(&poses)];
    refused(&track, &poses, &["i.landmarks.jsonl", "no frame has `image`"]);
    assert_eq!(handcast(&[&track[..], &["--no-net"]].concat()).status.code(), Some(2));
}

/// The first `count` of the true joints of the built-in clip, from the beginning again behind its end: their places in its
/// pictures moved by so many pixels, their times stretched.
fn write_joints(file: &Path, count: usize, [right, stretched]: [f64; 2]) {
    let clip = read_poses(DEMO_POSES.as_ref()).unwrap();
    let morphology = clip.header.hands[0].morphology.clone().unwrap();
    let skeleton = Skeleton::new(&morphology, Side::Right);
    let focal = 240.0 / 30f64.to_radians().tan();
    let line = |i: usize| {
        let frames = skeleton.frames(&clip.frames[i % clip.frames.len()].pose);
        let image = LANDMARKS_21.map(|joint| {
            let p = frames.position(joint);
            [240.0 - focal * p.x / p.z + right, 180.0 + focal * p.y / p.z]
        });
        format!("{}\n", serde_json::json!({ "t": 0.04 * i as f64 * stretched, "image": image }))
    };
    let header = r#"{"format":"landmarks21","order":"mediapipe","unit":"m","fps":25,"hand":"right"}"#;
    std::fs::write(file, format!("{header}\n") + &(0..count).map(line).collect::<String>()).unwrap();
}

#[test]
fn joints_of_another_clip_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (joints, poses) = (at("i.landmarks.jsonl"), at("poses.jsonl"));
    let track = ["track", DEMO_CLIP, "--joints", path(&joints), "-o", path(&poses), "-q"];
    let said = |more: &[&str]| {
        let out = handcast(&[&track[..], more].concat());
        assert!(out.status.success(), "{}", crate::common::command::text(&out.stderr));
        crate::common::command::text(&out.stderr)
    };
    // Its own, all of them, some, and those of more than a part.
    write_joints(&joints, 150, [0.0, 1.0]);
    assert_eq!(said(&[]), "");
    assert_eq!(said(&["--until", "3"]), "");
    write_joints(&joints, 90, [0.0, 1.0]);
    assert_eq!(said(&[]), "");
    refused(
        &[&track[..], &["--from", "5"]].concat(),
        &at("none"),
        &["i.landmarks.jsonl", "none of them between"],
    );
    // A third of a hand beside it.
    write_joints(&joints, 150, [60.0, 1.0]);
    let words = said(&[]);
    assert!(words.contains("hand lengths off") && words.contains("of this clip?"), "{words}");
    // Slower, and more of them.
    write_joints(&joints, 150, [0.0, 1.5]);
    let words = said(&[]);
    assert!(words.contains("behind the clip's last picture at 5.96 s"), "{words}");
    write_joints(&joints, 160, [0.0, 1.0]);
    refused(&track, &at("none"), &["i.landmarks.jsonl", "160 pictures for the 150 of the clip"]);
    // Of pictures of another shape, which their file tells.
    let square = at("square.pose");
    done(&["import", DEMO_POSES, "-o", path(&square)]);
    let track = ["track", DEMO_CLIP, "--joints", path(&square), "-o", path(&poses)];
    refused(&track, &at("none"), &["square.pose", "1000 x 1000", "480 x 360", "of another shape"]);
}

#[test]
#[ignore = "needs the shared clips"]
fn joints_of_another_of_the_shared_clips_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let poses = folder.path().join("poses.jsonl");
    let names = ["counting", "finger-flexions", "fingerspelling"];
    for (clip, joints) in names.iter().flat_map(|clip| names.map(|joints| (*clip, joints))) {
        let own = clip == joints;
        let clip = shared(&format!("data/clips/{clip}.mp4"));
        let joints = shared(&format!("data/motion/landmarks/{joints}.landmarks.jsonl"));
        let out = handcast(&["track", path(&clip), "--joints", path(&joints), "-o", path(&poses), "-q"]);
        let said = crate::common::command::text(&out.stderr);
        assert_eq!(said.is_empty(), own, "{} {}: {said}", clip.display(), joints.display());
        assert!(own || said.contains("clip"), "{said}");
    }
}

#[test]
#[ignore = "needs the shared clips"]
fn joints_of_another_tracker_find_the_hand() {
    let folder = tempfile::tempdir().unwrap();
    let poses = folder.path().join("spelling.jsonl");
    let clip = shared("data/clips/fingerspelling.mp4");
    let joints = shared("data/motion/landmarks/fingerspelling.landmarks.jsonl");
    let report = done(&["track", path(&clip), "--joints", path(&joints), "-o", path(&poses), "--json"]);
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["hands"][0]["tracked_frames"], 160);
    assert!(report["hands"][0]["mean_iou"].as_f64().unwrap() > 0.93);
}
