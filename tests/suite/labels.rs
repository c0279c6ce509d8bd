//! `handcast bench labels` and `handcast track --joints` from the command line.

use crate::common::command::{done, handcast, path, refused};
use crate::common::shared;
use handcast_formats::poses::{read_poses, write_poses};
use handcast_hand::count_extended;
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
