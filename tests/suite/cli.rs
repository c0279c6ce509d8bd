//! The command itself: what it writes, what it says, how it fails.

use std::path::Path;
use std::process::{Command, Output};

use crate::common::command::{handcast, misused, path, program, refused, text};
use crate::common::shared;

/// Runs the command in a folder.
fn run_in(folder: &Path, args: &[&str]) -> Output {
    Command::new(program()).current_dir(folder).args(args).env("HANDCAST_NET", "none").output().unwrap()
}

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

/// Which hand a clip shows is known when it has been tracked: what does not need the rig is written all the same.
#[test]
fn a_rig_of_the_other_hand_costs_its_own_file_alone() {
    let dir = tempfile::tempdir().unwrap();
    let [rig, out] = ["left.glb", "out"].map(|name| dir.path().join(name));
    let made = handcast(&["pose", "A", "--hand", "left", "-o", path(&rig)]);
    assert!(made.status.success(), "{}", text(&made.stderr));
    let first = handcast(&["demo", "-o", path(&out), "--no-pictures", "--quiet"]);
    assert!(first.status.success(), "{}", text(&first.stderr));
    std::fs::remove_file(out.join("report.json")).unwrap();
    let run = handcast(&["demo", "-o", path(&out), "--no-pictures", "--quiet", "--mesh", path(&rig)]);
    let message = text(&run.stderr);
    assert_eq!(run.status.code(), Some(1), "{message}");
    assert!(message.contains("left") && message.contains("hand.glb left by an earlier run"), "{message}");
    assert_eq!(report(&out)["frames"], 150);
    assert!(report(&out)["fps"]["gltf"].is_null());
}

/// Clips of one name have one folder where none is told.
#[test]
fn results_of_another_clip_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("clip-handcast");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("report.json"), br#"{"clip": "a/clip.avi"}"#).unwrap();
    let run = |clip: &str| {
        let run = std::process::Command::new(program()).current_dir(dir.path()).args(["run", clip]).output();
        let run = run.unwrap();
        (run.status.code(), text(&run.stderr).to_owned())
    };
    let (code, message) = run("clip.avi");
    assert_eq!(code, Some(2), "{message}");
    assert!(message.contains("clip-handcast has the results of a/clip.avi: name a folder"), "{message}");
    let (code, message) = run("a/clip.avi");
    assert_eq!(code, Some(1), "{message}");
    assert!(message.contains("no such file"), "{message}");
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
fn first_tries_say_how_it_is_written() {
    for (args, words) in [
        (
            &["demo.avi"][..],
            "demo.avi is a clip: handcast run demo.avi -o DIR (all results), or handcast track",
        ),
        (&["hand.fba"], "handcast decode hand.fba -o hand.glb"),
        (
            &["track", "demo.avi", "out.jsonl"],
            "outputs are named with -o: handcast track demo.avi -o out.jsonl",
        ),
        (&["encode", "a.jsonl", "-o", "b.fba", "--rms", "1"], "--target-rms"),
        (&["run", "clip.mp4", "--fps", "60"], "--input-fps"),
    ] {
        let run = handcast(args);
        let said = text(&run.stderr);
        assert_eq!(run.status.code(), Some(2), "{args:?}: {said}");
        assert!(said.contains(words) && !said.contains("as a value"), "{args:?}: {said}");
    }
    let help = text(&handcast(&["run", "--help"]).stdout);
    assert!(
        help.contains("Examples:\n  handcast run clip.mp4") && help.contains("Exit codes: 0 done"),
        "{help}"
    );
    assert!(!text(&handcast(&["run", "-h"]).stdout).contains("--max-bytes"));
    assert!(text(&handcast(&["demo", "-h"]).stdout).contains("[default: handcast-demo]"));
}

#[test]
fn results_without_a_folder_get_one_that_is_named_after_the_clip() {
    let dir = tempfile::tempdir().unwrap();
    let clip = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/demo.avi");
    let run = run_in(dir.path(), &["run", path(&clip), "--no-pictures"]);
    let said = text(&run.stderr);
    assert!(run.status.success(), "{said}");
    assert!(said.contains("run writes into the folder demo-handcast; -o DIR names another one"), "{said}");
    assert!(dir.path().join("demo-handcast").join("hand.fba").exists());
    // What fails leaves none.
    let run = run_in(dir.path(), &["run", "none.mp4", "-q"]);
    assert_eq!(run.status.code(), Some(1));
    assert!(!text(&run.stderr).contains("writes into"), "{}", text(&run.stderr));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}

#[test]
fn what_was_drawn_is_said_unless_that_is_not_wanted() {
    let dir = tempfile::tempdir().unwrap();
    for (name, more, words) in [
        ("r.gif", ["--frames", "4"], "r.gif: 4 pictures, "),
        ("r.png", ["--frames", "3"], "r.png: 3 pictures\n"),
        ("s.png", ["--at", "1"], "s.png: 1 picture\n"),
    ] {
        let out = dir.path().join(name);
        let start = ["render", "fixtures/demo.poses.jsonl", "-o", path(&out), "--size", "48x40"];
        let run = handcast(&[&start[..], &more].concat());
        let said = text(&run.stderr);
        assert!(run.status.success() && said.contains(words), "{name}: {said}");
        let run = handcast(&[&start[..], &more, &["-q"]].concat());
        assert!(run.status.success() && run.stderr.is_empty(), "{name}: {}", text(&run.stderr));
    }
}

#[test]
fn true_poses_go_to_standard_output_where_that_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let args = ["synth", "-o", "clip.avi", "--poses", "-", "--frames", "3", "--size", "64x48", "-q"];
    let run = run_in(dir.path(), &args);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let lines = text(&run.stdout);
    assert!(lines.starts_with("{\"format\":\"handcast-poses\"") && lines.lines().count() == 4, "{lines}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
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
