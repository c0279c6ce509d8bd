//! `handcast net`, with networks that the test writes itself.

use std::path::Path;
use std::process::{Command, Output};

use crate::common::command::{done, handcast, path, refused, text};
use handcast_net::testing::{joint_network, palm_network};

fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("palm_detection.tflite"), palm_network()).unwrap();
    std::fs::write(dir.path().join("hand_landmark.tflite"), joint_network()).unwrap();
    dir
}

/// The command where nothing is installed, with what the environment says.
fn bare(folder: &Path, variable: Option<&Path>) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_handcast"));
    command.args(["net", "--json"]).current_dir(folder).env_clear().env("HOME", folder);
    if let Some(value) = variable {
        command.env("HANDCAST_NET", value);
    }
    command.output().unwrap()
}

#[test]
fn networks_are_named_and_run() {
    let dir = folder();
    let report = done(&["net", "--net", path(dir.path())]);
    for word in
        ["palm_detection.tflite", "hand_landmark.tflite", "SHA-256", "licence not stated", "of 150 frames"]
    {
        assert!(report.contains(word), "{word:?} in {report}");
    }
    let file = dir.path().join("hand_landmark.tflite");
    let report: serde_json::Value =
        serde_json::from_str(&done(&["net", "--net", path(&file), "--lite", "--json"])).unwrap();
    assert_eq!(report["joints"]["path"], path(&file));
    assert_eq!(report["joints"]["bytes"].as_u64(), Some(joint_network().len() as u64));
    assert_eq!(report["joints"]["sha256"].as_str().map(str::len), Some(64));
    assert_eq!(report["palms"]["path"], path(&dir.path().join("palm_detection.tflite")));
    assert_eq!(report["demo"]["frames"], 150);
}

#[test]
fn the_environment_says_where_networks_are() {
    let dir = folder();
    let out = bare(dir.path(), Some(dir.path()));
    assert!(out.status.success(), "{}", text(&out.stderr));
    let out = bare(dir.path(), Some(&dir.path().join("none")));
    let message = text(&out.stderr);
    assert_eq!(out.status.code(), Some(1));
    assert!(message.contains("HANDCAST_NET: ") && message.contains("none"), "{message}");
}

#[test]
fn networks_of_the_node_package_are_found() {
    let dir = tempfile::tempdir().unwrap();
    let package = dir.path().join("node_modules/@mediapipe/hands");
    std::fs::create_dir_all(&package).unwrap();
    std::fs::write(package.join("palm.tflite"), palm_network()).unwrap();
    std::fs::write(package.join("hand.tflite"), joint_network()).unwrap();
    std::fs::write(package.join("package.json"), r#"{"name": "@mediapipe/hands", "license": "Apache-2.0"}"#)
        .unwrap();
    let inside = dir.path().join("a/b");
    std::fs::create_dir_all(&inside).unwrap();
    let out = bare(&inside, None);
    assert!(out.status.success(), "{}", text(&out.stderr));
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(report["licence"], "Apache-2.0");
}

/// Not every shell hands over what a pattern stands for.
#[test]
fn a_pattern_stands_for_one_path() {
    let dir = tempfile::tempdir().unwrap();
    let [first, second] = ["networks-1.0", "networks-2.0"].map(|name| dir.path().join(name));
    std::fs::rename(folder().keep(), &first).unwrap();
    let pattern = dir.path().join("networks-*");
    let report = done(&["net", "--net", path(&pattern), "--json"]);
    assert!(report.contains("networks-1.0"), "{report}");
    std::fs::create_dir(&second).unwrap();
    let none = dir.path().join("none");
    refused(&["net", "--net", path(&pattern)], &none, &["2 files fit", "one is expected", "networks-2.0"]);
    let other = dir.path().join("other-*");
    refused(&["net", "--net", path(&other)], &none, &["other-*", "no file fits"]);
}

#[test]
fn what_is_no_network_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let words = dir.path().join("words.txt");
    std::fs::write(&words, "no network, only words").unwrap();
    let none = dir.path().join("none");
    refused(
        &["net", "--net", path(&words)],
        &none,
        &["words.txt", "neither a TensorFlow Lite network nor a zip"],
    );
    refused(&["net", "--net", path(&none)], &none, &["none"]);
    let half = dir.path().join("hand.tflite");
    let network = joint_network();
    std::fs::write(&half, &network[..network.len() / 2]).unwrap();
    refused(&["net", "--net", path(&half)], &none, &["hand.tflite", "network"]);
    std::fs::write(&half, &network).unwrap();
    refused(&["net", "--net", path(&half)], &none, &["none that finds palms"]);
}

#[test]
fn refusals_tell_of_networks_where_none_look() {
    let dir = folder();
    let [frames, masks] = ["frames", "masks"].map(|name| dir.path().join(name));
    for (folder, colour) in [(&frames, [120, 130, 140]), (&masks, [0; 3])] {
        std::fs::create_dir(folder).unwrap();
        for number in 0..3 {
            let picture = image::RgbImage::from_pixel(64, 48, image::Rgb(colour));
            picture.save(folder.join(format!("{number}.png"))).unwrap();
        }
    }
    let out = dir.path().join("out.jsonl");
    let told = |more: [&str; 2]| {
        let track = ["track", path(&frames), "-o", path(&out)];
        let told = handcast(&[&track[..], &more].concat());
        let message = text(&told.stderr);
        assert!(told.status.code() == Some(1) && message.contains("no hand"), "{more:?}: {message}");
        message.contains("`handcast net`")
    };
    assert!(told(["--no-net", "--quiet"]));
    assert!(!told(["--net", path(dir.path())]));
    assert!(!told(["--mask", path(&masks)]));
}
