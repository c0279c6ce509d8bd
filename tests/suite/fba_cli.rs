//! Encoder and decoder options of the command, end to end.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use handcast_codec::mapping::{Profile, hand_mask};
use handcast_codec::ties::hand_ties;
use handcast_fba::bap::BapMask;
use handcast_fba::bap::derive::driven;
use handcast_fba::{Decoder, DecoderOptions};
use handcast_hand::Side;
use serde_json::Value;

fn handcast(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_handcast")).args(args).output().expect("the command runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs the command, which must succeed, and returns what it says on standard output and error.
fn run(args: &[&str]) -> (String, String) {
    let out = handcast(args);
    assert!(out.status.success(), "{args:?}: {}", text(&out.stderr));
    (text(&out.stdout), text(&out.stderr))
}

/// A folder with poses in it: a fist that closes and opens, end joints tied to middle joints.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut lines = String::from(
            "{\"format\":\"handcast-poses\",\"version\":1,\"rate\":30.0,\"hands\":[{\"side\":\"right\"}]}\n",
        );
        for i in 0..90 {
            let bend = 54.0 - 54.0 * (f64::from(i) * 0.1).cos();
            let mut angles = String::new();
            for finger in ["index", "middle", "ring", "pinky"] {
                angles += &format!(
                    "\"{finger}1_flexion\":{},\"{finger}2_flexion\":{bend},\"{finger}3_flexion\":{},",
                    bend * 0.8,
                    bend * 2.0 / 3.0
                );
            }
            angles += &format!(
                "\"thumb1_abduction\":{},\"thumb1_flexion\":5,\"thumb2_flexion\":10",
                10.0 + 0.2 * bend
            );
            lines += &format!(
                "{{\"t\":{},\"hand\":\"right\",\"wrist\":{{\"translation\":[0,0,-0.5],\"rotation\":[0,0,0,1]}},\
                 \"angles\":{{{angles}}}}}\n",
                f64::from(i) / 30.0
            );
        }
        std::fs::write(dir.path().join("poses.jsonl"), lines).unwrap();
        Self(dir)
    }

    fn file(&self, name: &str) -> String {
        let path: PathBuf = self.0.path().join(name);
        path.to_str().unwrap().to_owned()
    }

    fn encode(&self, name: &str, options: &[&str]) -> String {
        let file = self.file(name);
        run(&[&["encode", &self.file("poses.jsonl"), "-o", &file][..], options].concat());
        file
    }
}

/// One joint angle of each pose of a file, degrees.
fn angles(file: &str, name: &str) -> Vec<f64> {
    let words = std::fs::read_to_string(Path::new(file)).unwrap();
    let value = |line: &str| {
        let pose: serde_json::Value = serde_json::from_str(line).unwrap();
        pose["angles"][name].as_f64().unwrap_or(0.0)
    };
    words.lines().skip(1).map(value).collect()
}

#[test]
fn derived_joints_are_not_sent_and_come_back() {
    let folder = Folder::new();
    for (mode, live) in
        [("--quant", &["10"][..]), ("--target-rms", &["0.4"]), ("--target-rms", &["0.4", "--live"])]
    {
        let options = [&[mode][..], live].concat();
        let all = folder.encode("all.fba", &options);
        let less = folder.encode("less.fba", &[&["--derive"][..], &options].concat());
        let size = |file: &str| std::fs::metadata(file).unwrap().len();
        assert!(size(&less) < size(&all), "{} of {}", size(&less), size(&all));

        let mut decoder = Decoder::new(DecoderOptions::default());
        decoder.push(&std::fs::read(&less).unwrap()).unwrap();
        let first = decoder.next_frame().unwrap().unwrap();
        let left: BapMask = hand_ties().iter().filter(|tie| tie.firm).map(|tie| tie.driven).collect();
        assert_eq!(
            first.baps.mask.intersection(&driven(hand_ties())),
            driven(hand_ties()).difference(&left).intersection(&hand_mask(Side::Right, Profile::Hand))
        );
        assert!(!first.baps.mask.intersection(&hand_mask(Side::Right, Profile::Hand)).is_empty());

        let back = folder.file("back.jsonl");
        run(&["decode", &less, "-o", &back]);
        let (middle, end) = (angles(&back, "ring2_flexion"), angles(&back, "ring3_flexion"));
        assert!(middle.iter().any(|&angle| angle > 80.0));
        assert!(middle.iter().zip(&end).all(|(middle, end)| (middle * 2.0 / 3.0 - end).abs() < 0.01));
        run(&["decode", &less, "-o", &back, "--sent-only"]);
        assert!(angles(&back, "ring3_flexion").iter().all(|&angle| angle == 0.0));

        let (list, _) = run(&["inspect", &less]);
        assert!(list.lines().next().unwrap().contains("left to the hand model "), "{list}");
        let (list, _) = run(&["inspect", &all]);
        assert!(!list.contains("left to the hand model"), "{list}");
        let (json, _) = run(&["inspect", "--json", &less]);
        let plane: serde_json::Value = serde_json::from_str(json.lines().last().unwrap()).unwrap();
        assert_eq!(plane["left_to_hand_model"], serde_json::json!([134, 146, 158, 170]));
    }
}

#[test]
fn the_wrapper_is_written_and_read() {
    let folder = Folder::new();
    let (bare, wrapped) = (folder.encode("a.fba", &[]), folder.encode("b.fba", &["--wrapper", "99"]));
    let (bare, bytes) = (std::fs::read(bare).unwrap(), std::fs::read(&wrapped).unwrap());
    assert_eq!(bytes[..5], [0, 0, 1, 0xb0, 99]);
    assert_eq!(bytes[bytes.len() - bare.len()..], bare[..]);
    let back = folder.file("back.jsonl");
    run(&["decode", &wrapped, "-o", &back]);
    assert_eq!(angles(&back, "index1_flexion").len(), 90);
    let (list, _) = run(&["inspect", "--verbose", &wrapped]);
    assert!(list.contains("visual_object_sequence_start_code"), "{list}");
}

#[test]
fn step_tables_and_range_rules_are_chosen_by_option() {
    let folder = Folder::new();
    let truth = angles(&folder.file("poses.jsonl"), "index1_flexion");
    let back = folder.file("back.jsonl");
    for options in [&["--steps", "visage"][..], &["--ranges", "undivided"]] {
        for mode in [&["--quant", "6"][..], &["--max-error", "1.5"], &["--target-rms", "0.4", "--live"]] {
            let file = folder.encode("x.fba", &[options, mode].concat());
            run(&[&["decode", &file, "-o", &back][..], options].concat());
            let found = angles(&back, "index1_flexion");
            assert_eq!(found.len(), truth.len());
            for (found, truth) in found.iter().zip(&truth) {
                assert!((found - truth).abs() < 2.6, "{options:?} {mode:?}: {found} of {truth}");
            }
            // Read otherwise it is nonsense, or damaged.
            let wrong = handcast(&["decode", &file, "-o", &back]);
            let said = text(&wrong.stderr);
            assert!(
                !wrong.status.success() || angles(&back, "index1_flexion") != found,
                "{options:?}: {said}"
            );
        }
    }
    // Values that no hand can have are pointed out.
    let file = folder.encode("x.fba", &["--quant", "6"]);
    let (_, said) = run(&["decode", &file, "-o", &back, "--steps", "visage"]);
    assert!(said.contains("which no hand does") && said.contains("--steps"), "{said}");
    let (_, said) = run(&["decode", &file, "-o", &back]);
    assert!(!said.contains("no hand"), "{said}");
}

#[test]
fn a_reader_that_has_had_enough_ends_the_command_quietly() {
    let folder = Folder::new();
    let (stream, poses) = (folder.encode("long.fba", &["--quant", "1"]), folder.file("poses.jsonl"));
    for args in [
        &["inspect", "--verbose", &stream][..],
        &["encode", &poses, "-o", "-", "--quiet"],
        &["pose", "--list"],
    ] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_handcast"))
            .args(args)
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let out = child.wait_with_output().unwrap();
        assert_eq!((out.status.code(), text(&out.stderr)), (Some(0), String::new()), "{args:?}");
    }
}

/// Some planes of these motions would imitate a start code: what a level is changed by for that, the next planes take back as far
/// as their ranges let them.
#[test]
fn a_hand_that_spells_and_waves_is_encoded() {
    let folder = Folder::new();
    let spelled = folder.file("hello.jsonl");
    run(&["spell", "HELLO", "-o", &spelled]);
    let spelled = std::fs::read_to_string(spelled).unwrap();
    let (header, poses) = spelled.split_once('\n').unwrap();
    let poses: Vec<Value> = poses.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    for (frames, metres, hertz) in [(360, 0.5, 0.5), (150, 1.0, 0.2)] {
        let mut lines = vec![header.to_owned()];
        for (i, mut pose) in poses.iter().cloned().cycle().take(frames).enumerate() {
            let t = i as f64 / 30.0;
            pose["t"] = t.into();
            pose["wrist"]["translation"][0] = (metres * (std::f64::consts::TAU * hertz * t).sin()).into();
            lines.push(pose.to_string());
        }
        let (waved, stream) = (folder.file("waved.jsonl"), folder.file("waved.fba"));
        std::fs::write(&waved, lines.join("\n")).unwrap();
        run(&["encode", &waved, "-o", &stream]);
        let said = handcast(&["compare", &waved, &stream, "--json"]).stdout;
        let said: Value = serde_json::from_slice(&said).unwrap();
        let wrist = said["hands"][0]["wrist_mm"]["mean"].as_f64().unwrap();
        assert!(wrist < 2.0, "{metres} m at {hertz} Hz: {wrist} mm");
    }
}

/// A value beyond all levels is named, and what helps.
#[test]
fn values_too_large_for_a_quantiser_are_named() {
    let folder = Folder::new();
    let lines = std::fs::read_to_string(folder.file("poses.jsonl")).unwrap();
    let far = folder.file("far.jsonl");
    let lines: Vec<String> = lines
        .lines()
        .enumerate()
        .map(|(number, line)| match number {
            18 => line.replace("\"thumb1_flexion\":5", "\"thumb1_flexion\":-172"),
            _ => line.to_owned(),
        })
        .collect();
    std::fs::write(&far, lines.join("\n")).unwrap();
    let stream = folder.file("far.fba");
    // What no quantiser reaches, and what the finest does not.
    let beyond = ["frame 17: ", "thumb1_flexion) at ", "(172.0°)", "at no quantiser index further"];
    let fine = ["frame ", ": bap ", "--quant 0 is too fine", "a larger one reaches further"];
    for (quant, words) in [("1", &beyond[..]), ("0", &fine)] {
        for live in [&[][..], &["--live"]] {
            let out = handcast(&[&["encode", &far, "-o", &stream, "--quant", quant][..], live].concat());
            let said = text(&out.stderr);
            assert_eq!(out.status.code(), Some(1), "{said}");
            assert!(words.iter().all(|words| said.contains(words)), "{said}");
            assert!(!Path::new(&stream).exists());
        }
    }
}
