//! The programs in `examples/` run on what the repository carries and write what they promise.

use std::path::{Path, PathBuf};
use std::process::Command;

use handcast::Side;

const EXAMPLES: [&str; 4] = ["as_it_happens", "clip_to_stream", "round_trip", "stream_to_hand"];

/// The program as `cargo test` has built it beside the tests.
fn built(name: &str) -> PathBuf {
    let here = std::env::current_exe().unwrap();
    let folder = here.parent().and_then(Path::parent).unwrap().join("examples");
    let program = folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    assert!(program.is_file(), "{} is not built: `cargo test --examples --no-run`", program.display());
    program
}

/// What the example prints, started in the repository.
fn run(name: &str, arguments: &[&Path]) -> String {
    let mut command = Command::new(built(name));
    let out = command.args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

#[test]
fn every_example_is_run_here() {
    let folder = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("examples")).unwrap();
    let mut names: Vec<_> = folder.map(|entry| entry.unwrap().path()).collect();
    // Pages are opened by `web.rs`.
    names.retain(|path| path.extension().is_some_and(|ending| ending == "rs"));
    names.sort();
    let names: Vec<_> = names.iter().map(|path| path.file_stem().unwrap().to_str().unwrap()).collect();
    assert_eq!(names, EXAMPLES);
}

#[test]
fn frames_become_poses_bytes_and_poses() {
    let lines = run("as_it_happens", &[]);
    let lines: Vec<&str> = lines.lines().collect();
    let form = |line: &&str| line.contains(" s: index finger bent by ") && line.ends_with('°');
    assert!(lines.iter().all(form), "{lines:?}");
    assert_eq!(lines.len(), 150, "{lines:?}");
}

/// A clip that ends while colours are still learnt is tracked when it has ended.
#[test]
fn no_pose_of_a_short_clip_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("short.avi");
    let mut synth = Command::new(env!("CARGO_BIN_EXE_handcast"));
    let made = synth.args(["synth", "--frames", "40", "-o"]).arg(&clip).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let stream = folder.path().join("short.fba");
    let said = run("clip_to_stream", &[&clip, &stream]);
    assert!(said.contains(": 40 poses in "), "{said}");
    assert_eq!(run("as_it_happens", &[&clip]).lines().count(), 40);
}

#[test]
fn a_clip_becomes_a_stream_and_the_stream_a_hand() {
    let folder = tempfile::tempdir().unwrap();
    let (stream, hand) = (folder.path().join("hand.fba"), folder.path().join("hand.glb"));
    let said = run("clip_to_stream", &[Path::new("fixtures/demo.avi"), &stream]);
    let bytes = std::fs::read(&stream).unwrap();
    assert_eq!(said, format!("fixtures/demo.avi: 150 poses in {} bytes\n", bytes.len()));
    assert_eq!(handcast::decode(&bytes).unwrap().clip().of(Side::Right).count(), 150);

    let said = run("stream_to_hand", &[&stream, &hand]);
    assert_eq!(said, "150 poses at 25 frames/s\n");
    assert!(std::fs::read(&hand).unwrap().starts_with(b"glTF"));
}

#[test]
fn what_coding_costs_falls_with_the_error_allowed() {
    let lines = run("round_trip", &[]);
    let bytes = |line: &str| line.split(": ").nth(1)?.split(' ').next()?.parse::<usize>().ok();
    let bytes: Vec<usize> = lines.lines().map(|line| bytes(line).unwrap()).collect();
    assert!(bytes.len() == 4 && bytes[0] > bytes[1], "{lines}");
}
