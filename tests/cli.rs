//! The command itself: what it writes, what it says, how it fails.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use std::path::Path;

use common::command::{handcast, misused, path, refused, text};
use common::shared;

fn report(dir: &Path) -> serde_json::Value {
    let bytes = std::fs::read(dir.join("report.json")).expect("a report");
    serde_json::from_slice(&bytes).expect("JSON")
}

#[test]
fn the_demo_makes_every_result_and_its_stream_comes_back() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("demo");
    let run = handcast(&["demo", "-o", path(&out)]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    assert!(text(&run.stdout).contains("150 of 150 frames tracked"), "{}", text(&run.stdout));
    for name in [
        "hand.fba",
        "hand.glb",
        "poses.jsonl",
        "person.toml",
        "overlay.mp4",
        "preview.png",
        "report.json",
        "report.txt",
    ] {
        assert!(out.join(name).metadata().unwrap().len() > 100, "{name}");
    }
    let report = report(&out);
    assert_eq!(report["frames"], 150);
    let hand = &report["hands"][0];
    assert_eq!(hand["tracked_frames"], 150);
    assert!(hand["mean_iou"].as_f64().unwrap() > 0.95, "{report}");
    assert!(hand["worst_iou"].as_f64().unwrap() > 0.85, "{report}");
    assert!(report["coding_rms_deg"].as_f64().unwrap() <= 0.5);
    assert!(report["kbit_per_s"].as_f64().unwrap() < 3.0);
    assert!(report["truth"]["mean_deg"].as_f64().unwrap() < 12.0, "{report}");
    let bytes = std::fs::metadata(out.join("hand.fba")).unwrap().len();
    assert_eq!(report["stream_bytes"].as_u64(), Some(bytes));

    let (fba, jsonl) = (out.join("hand.fba"), dir.path().join("back.jsonl"));
    for target in ["back.jsonl", "back.json", "back.glb", "back.bap"] {
        let run = handcast(&["decode", path(&fba), "-o", path(&dir.path().join(target))]);
        assert!(run.status.success(), "{target}: {}", text(&run.stderr));
    }
    let document: serde_json::Value =
        serde_json::from_slice(&std::fs::read(dir.path().join("back.json")).unwrap()).unwrap();
    assert_eq!(document["frames"].as_array().map(Vec::len), Some(150));
    // Poses, BAP text and GLB encode again.
    for source in [jsonl, dir.path().join("back.bap"), out.join("hand.glb")] {
        let again = dir.path().join("again.fba");
        let run = handcast(&["encode", path(&source), "-o", path(&again), "--quant", "4"]);
        assert!(run.status.success(), "{}: {}", source.display(), text(&run.stderr));
        let run = handcast(&["inspect", path(&again)]);
        assert!(run.status.success() && text(&run.stdout).lines().count() > 100, "{}", text(&run.stderr));
    }
}

#[test]
fn wrong_inputs_are_named_and_leave_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let p = dir.path().join(name);
        std::fs::write(&p, bytes).unwrap();
        p
    };
    let out = dir.path().join("out");
    let run = |input: &Path, words: &[&str]| refused(&["run", path(input), "-o", path(&out)], &out, words);
    run(&dir.path().join("none.mp4"), &["none.mp4", "no such file"]);
    run(&file("empty.mp4", b""), &["empty.mp4", "empty"]);
    run(&file("text.mp4", b"this is no video at all, only words\n"), &["text.mp4"]);

    let x = dir.path().join("x.glb");
    let decode = |input: &Path, words: &[&str]| refused(&["decode", path(input), "-o", path(&x)], &x, words);
    decode(&dir.path().join("none.fba"), &["none.fba"]);
    decode(&file("empty.fba", b""), &["empty.fba"]);
    decode(&file("text.fba", b"words, not a stream\n"), &["text.fba"]);
    let other = dir.path().join("x.docx");
    misused(&["decode", path(&file("y.fba", b"")), "-o", path(&other)], &other, &[".docx", ".glb"]);

    let fba = dir.path().join("x.fba");
    let encode =
        |input: &Path, words: &[&str]| refused(&["encode", path(input), "-o", path(&fba)], &fba, words);
    encode(&file("bad.jsonl", b"{\"format\":\"other\"}\n"), &["bad.jsonl", "line 1"]);
    encode(&file("bad.bap", b"3.2 wave 25 1\n0 1 2\n0 1\n"), &["bad.bap"]);
    encode(&file("bad.xyz", b"?"), &[".xyz"]);
}

#[test]
fn a_cut_stream_fails_and_conceals_on_request() {
    let dir = tempfile::tempdir().unwrap();
    let poses = dir.path().join("p.jsonl");
    let mut lines = String::from(
        "{\"format\":\"handcast-poses\",\"version\":1,\"rate\":30.0,\"hands\":[{\"side\":\"right\"}]}\n",
    );
    for i in 0..60 {
        lines += &format!(
            "{{\"t\":{},\"hand\":\"right\",\"wrist\":{{\"translation\":[0,0,-0.5],\"rotation\":[0,0,0,1]}},\
             \"angles\":{{\"index1_flexion\":{}}}}}\n",
            f64::from(i) / 30.0,
            f64::from(i)
        );
    }
    std::fs::write(&poses, lines).unwrap();
    let fba = dir.path().join("p.fba");
    assert!(handcast(&["encode", path(&poses), "-o", path(&fba)]).status.success());
    let bytes = std::fs::read(&fba).unwrap();
    let cut = dir.path().join("cut.fba");
    std::fs::write(&cut, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let out = dir.path().join("cut.jsonl");
    refused(&["decode", path(&cut), "-o", path(&out)], &out, &["cut.fba"]);
    let run = handcast(&["decode", path(&cut), "-o", path(&out), "--conceal"]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    assert!(std::fs::read_to_string(&out).unwrap().lines().count() > 10);
}

#[test]
fn usage_errors_have_exit_code_2() {
    for args in [&["run"][..], &["decode"], &["encode", "a", "-o", "b", "--quant", "32"], &["frobnicate"]] {
        assert_eq!(handcast(args).status.code(), Some(2), "{args:?}");
    }
}

#[test]
#[ignore = "needs the shared material"]
fn a_real_clip_is_tracked_and_coded() {
    let dir = tempfile::tempdir().unwrap();
    let clip = shared("data/clips/finger-flexions.mp4");
    let out = dir.path().join("flexions");
    let run = handcast(&["run", path(&clip), "-o", path(&out), "--no-pictures"]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let report = report(&out);
    let hand = &report["hands"][0];
    assert_eq!((report["frames"].as_u64(), hand["tracked_frames"].as_u64()), (Some(300), Some(300)));
    assert!(hand["mean_iou"].as_f64().unwrap() >= 0.90, "{report}");
    assert!(report["kbit_per_s"].as_f64().unwrap() < 3.0, "{report}");
    assert!(report["coding_rms_deg"].as_f64().unwrap() <= 0.5, "{report}");
    assert_eq!(hand["hand"], "right");
    assert_eq!(report["hands"].as_array().map(Vec::len), Some(1));
}

#[test]
#[ignore = "needs the shared material"]
fn a_real_clip_without_an_open_hand_is_refused_for_that() {
    let dir = tempfile::tempdir().unwrap();
    let clip = shared("data/clips/fingerspelling.mp4");
    let out = dir.path().join("spelling");
    refused(&["run", path(&clip), "-o", path(&out)], &out, &["never open", "160 frames"]);
}
