//! Recordings of other programs come in: MANO, Leap Motion, and what is none of them.

use std::fs::File;
use std::path::Path;
use std::process::Command;

use crate::common::command::{done, handcast, misused, path, program, refused, text};
use crate::common::python::with_package;
use crate::common::shared;
use handcast_formats::poses::read_poses;
use handcast_hand::landmarks::LANDMARKS_21;
use handcast_hand::{HandPose, JointAngle, Morphology, PoseClip, Side, Skeleton};
use nalgebra::Point3;
use serde_json::{Value, json};

/// Mean and largest distance of the joints of poses from places, metres.
fn off(clip: &PoseClip, places: &[Vec<[f64; 3]>]) -> [f64; 2] {
    let hand = &clip.header.hands[0];
    let skeleton = Skeleton::new(hand.morphology.as_ref().unwrap(), hand.side);
    assert_eq!(clip.frames.len(), places.len());
    let (mut sum, mut most, mut count) = (0.0, 0.0f64, 0);
    for (frame, places) in clip.frames.iter().zip(places) {
        assert!(frame.valid);
        let joints = skeleton.frames(&frame.pose);
        for (joint, place) in LANDMARKS_21.into_iter().zip(places) {
            let distance = (joints.position(joint) - Point3::from(*place)).norm();
            (sum, most, count) = (sum + distance, most.max(distance), count + 1);
        }
    }
    [sum / f64::from(count), most]
}

#[test]
#[ignore = "needs NumPy from its index"]
fn rotations_of_mano_are_where_forward_kinematics_of_numpy_puts_them() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| path(&folder.path().join(name)).to_owned();
    let python = with_package("numpy", "2.4.6", "numpy");
    let script = |rest: &str| {
        let out = Command::new(&python)
            .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/python/mano.py"))
            .args([rest, path(folder.path())])
            .output()
            .unwrap();
        assert!(out.status.success(), "{}", text(&out.stderr));
        text(&out.stdout)
    };
    script("-");
    done(&["import", &file("flat.npz"), "-o", &file("flat.landmarks.jsonl"), "-q"]);
    let joints: Vec<Vec<[f64; 3]>> = serde_json::from_str(&script(&file("flat.landmarks.jsonl"))).unwrap();
    let imported = |name: &str| {
        done(&["import", &file(name), "-o", &file("poses.jsonl"), "-q"]);
        read_poses(Path::new(&file("poses.jsonl"))).unwrap()
    };
    let whole = imported("whole.npz");
    for name in ["whole.npz", "parts.npz", "matrices.npz", "mean.npz", "joints.npz"] {
        let clip = imported(name);
        assert_eq!((clip.header.rate, clip.header.hands[0].side), (Some(25.0), Side::Right), "{name}");
        let [mean, most] = off(&clip, &joints);
        println!("{name}: {:.2} mm on average, {:.2} mm at most", mean * 1e3, most * 1e3);
        assert!(mean < 2e-3 && most < 1e-2, "{name}: {mean}, {most}");
    }
    // The same bends of the other hand, whose wrist is not told.
    let left = imported("left.npz");
    assert_eq!(left.header.hands[0].side, Side::Left);
    for (left, right) in left.frames.iter().zip(&whole.frames) {
        for angle in [JointAngle::Index1Flexion, JointAngle::Middle2Flexion, JointAngle::Pinky2Flexion] {
            let off = (left.pose.angle(angle) - right.pose.angle(angle)).abs();
            assert!(off < 0.02, "{}: {off}", angle.name());
        }
    }
    let out = folder.path().join("none.jsonl");
    refused(&["import", &file("objects.npz"), "-o", path(&out)], &out, &["objects.npz", "neither rotations"]);
    // Other commands read it as well.
    done(&["encode", &file("parts.npz"), "-o", &file("hand.fba")]);
}

/// An array of NumPy's own format, of doubles.
fn npy(shape: &str, data: &[f64]) -> Vec<u8> {
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    while !(11 + header.len()).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let length = (header.len() as u16).to_le_bytes();
    let numbers: Vec<u8> = data.iter().flat_map(|v| v.to_le_bytes()).collect();
    [b"\x93NUMPY\x01\0", &length[..], header.as_bytes(), &numbers].concat()
}

#[test]
fn lone_arrays_are_joints_at_the_rate_that_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let [array, out] = ["hand.npy", "poses.jsonl"].map(|name| folder.path().join(name));
    let hand = |i: usize, side: Side| {
        let mut pose = HandPose::neutral(side);
        pose.set(JointAngle::Index1Flexion, 0.05 * i as f64);
        let frames = Skeleton::new(&Morphology::default(), side).frames(&pose);
        LANDMARKS_21.map(|joint| frames.position(joint)).into_iter().flat_map(|p| [p.x, -p.y, -p.z])
    };
    let rows: Vec<f64> =
        (0..10).flat_map(|i| hand(i, Side::Right).chain(hand(i, Side::Left)).collect::<Vec<_>>()).collect();
    std::fs::write(&array, npy("(10, 2, 21, 3)", &rows)).unwrap();
    let said = handcast(&["import", path(&array), "-o", path(&out)]);
    assert!(text(&said.stderr).contains("30 frames a second are taken for granted; --input-fps"), "{said:?}");
    done(&["import", path(&array), "-o", path(&out), "--input-fps", "60"]);
    let clip = read_poses(&out).unwrap();
    assert_eq!((clip.header.rate, clip.header.hands.len(), clip.frames.len()), (Some(60.0), 2, 20));
    let last = clip.of(Side::Right).last().unwrap();
    assert!((last.time - 9.0 / 60.0).abs() < 1e-6, "{}", last.time);
    assert!((last.pose.angle(JointAngle::Index1Flexion) - 0.45).abs() < 0.02);
    std::fs::write(&array, npy("(10, 126)", &rows)).unwrap();
    let none = folder.path().join("none.jsonl");
    refused(&["import", path(&array), "-o", path(&none)], &none, &["10 × 126", "21 × 3", "42 × 3"]);
    misused(
        &["import", path(&array), "-o", path(&none), "--map", "joints.toml"],
        &none,
        &["--map without --mesh names joints of a .glb or .gltf"],
    );
}

/// Joints that tremble as those of learned trackers do cost bits, and there is something to be done about it.
#[test]
fn encode_tells_how_trembling_joints_are_steadied() {
    let folder = tempfile::tempdir().unwrap();
    let skeleton = Skeleton::new(&Morphology::default(), Side::Right);
    let written = |name: &str, metres: f64| {
        let mut state = 7u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            metres * (f64::from(state >> 16) / 32768.0 - 1.0)
        };
        let joints = |frame: i32| {
            let bend = 30.0 + 20.0 * (0.1 * f64::from(frame)).sin();
            let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index1Flexion, bend);
            let placed = skeleton.frames(&pose);
            LANDMARKS_21.map(|joint| placed.position(joint)).map(|p| [p.x, -p.y, -p.z].map(|v| v + noise()))
        };
        let points: Vec<[[f64; 3]; 21]> = (0..60).map(joints).collect();
        let file = folder.path().join(name);
        std::fs::write(&file, npy("(60, 21, 3)", points.as_flattened().as_flattened())).unwrap();
        file
    };
    let out = folder.path().join("hand.fba");
    let said = |joints: &Path, more: &[&str]| {
        let out = handcast(&[&["encode", path(joints), "-o", path(&out)], more].concat());
        assert!(out.status.success());
        text(&out.stderr)
    };
    let trembling = written("trembling.npy", 2e-3);
    let told = said(&trembling, &[]);
    assert!(told.contains("joint angles tremble by") && told.contains("import --smooth steadies"), "{told}");
    // What is worth knowing is said all the same, the report is not.
    let quiet = said(&trembling, &["-q"]);
    assert!(quiet.lines().all(|line| line.starts_with("handcast: ")) && told.starts_with(&quiet), "{quiet}");
    assert!(!said(&written("still.npy", 0.0), &[]).contains("--smooth"));
}

/// A frame as LeapJS has it of 21 joints in metres, the thumb first.
fn leap_frame(t: f64, points: &[[f64; 3]]) -> Value {
    let mm = |k: usize| points[k].map(|v| v * 1e3);
    let fingers = (0..5).map(|f| {
        let at = |k: usize| mm(1 + 4 * f + k);
        // A thumb's first bone has no length; the metacarpals of the others are not in the recordings.
        json!({ "type": f, "handId": 1, "id": 10 + f, "mcpPosition": at(0), "pipPosition": at(1),
                "dipPosition": at(2), "btipPosition": at(3) })
    });
    json!({ "timestamp": t * 1e6, "hands": [{ "id": 1, "wrist": mm(0) }], "pointables": fingers.collect::<Vec<_>>() })
}

#[test]
#[ignore = "needs the shared material"]
fn recordings_of_a_leap_motion_are_the_same_as_its_frames() {
    let folder = tempfile::tempdir().unwrap();
    let [frames, a, b] = ["frames.json", "a.jsonl", "b.jsonl"].map(|name| folder.path().join(name));
    let mut recordings = 0;
    for entry in std::fs::read_dir(shared("data/motion/leap")).unwrap() {
        let recording = entry.unwrap().path();
        let lines = std::fs::read_to_string(&recording).unwrap();
        let frame = |line: &str| {
            let line: Value = serde_json::from_str(line).unwrap();
            let points: Vec<[f64; 3]> = serde_json::from_value(line["points"].clone()).unwrap();
            leap_frame(line["t"].as_f64().unwrap(), &points)
        };
        let document =
            json!({ "metadata": {}, "frames": lines.lines().skip(1).map(frame).collect::<Vec<_>>() });
        std::fs::write(&frames, document.to_string()).unwrap();
        done(&["import", path(&recording), "-o", path(&a), "-q"]);
        done(&["import", path(&frames), "-o", path(&b), "-q"]);
        let compared: Value =
            serde_json::from_str(&done(&["compare", path(&a), path(&b), "--json", "--tolerance", "0.01"]))
                .unwrap();
        println!("{}: {compared}", recording.display());
        recordings += 1;
    }
    assert_eq!(recordings, 5);
}

#[test]
fn json_that_is_none_of_the_formats_is_told_by_its_names() {
    let folder = tempfile::tempdir().unwrap();
    let (input, out) = (folder.path().join("other.json"), folder.path().join("out.jsonl"));
    std::fs::write(&input, "{\"skeleton\": [1, 2], \"version\": {\"format\": 3}}").unwrap();
    let names = [
        "other.json: JSON with the names \"skeleton\", \"version\" is none of the formats",
        "MediaPipe",
        "Leap",
    ];
    for command in ["import", "encode", "view", "render", "compare"] {
        let picture = folder.path().join("out.png");
        let (stream, page) = (folder.path().join("out.fba"), folder.path().join("out.html"));
        let extra = match command {
            "encode" => vec!["-o", path(&stream)],
            "compare" => vec![path(&input)],
            "render" => vec!["-o", path(&picture)],
            "view" => vec!["-o", path(&page)],
            _ => vec!["-o", path(&out)],
        };
        let args = [vec![command, path(&input)], extra].concat();
        refused(&args, &out, &names);
        assert!(!stream.exists() && !page.exists());
    }
}

#[test]
fn completions_and_manual_name_every_subcommand() {
    let help = done(&["--help"]);
    let listed = help.lines().skip_while(|line| !line.starts_with("Commands:")).skip(1);
    let names: Vec<&str> = listed
        .take_while(|line| !line.is_empty())
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .collect();
    assert!(names.len() > 15 && names.contains(&"import"), "{names:?}");
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = done(&["completions", shell]);
        assert!(names.iter().all(|name| script.contains(name)), "{shell}");
    }
    let folder = tempfile::tempdir().unwrap();
    let pages = folder.path().join("man");
    done(&["man", "-o", path(&pages)]);
    for page in names.iter().map(|name| format!("handcast-{name}.1")).chain(["handcast.1".to_owned()]) {
        let text = std::fs::read_to_string(pages.join(&page)).unwrap();
        assert!(text.contains(".TH") && text.contains("SYNOPSIS"), "{page}");
    }
    assert_eq!(handcast(&["completions", "csh"]).status.code(), Some(2));
}

/// What this program wrote is written as it is, whichever format it went through.
#[test]
fn motions_of_this_program_are_written_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| path(&folder.path().join(name)).to_owned();
    done(&["spell", "HI", "-o", &file("hi.jsonl"), "--hand", "left"]);
    for ending in ["glb", "bvh", "vrma", "webxr.json", "csv", "json", "bap", "fba"] {
        let (there, back) = (file(&format!("hi.{ending}")), file("back.jsonl"));
        match ending {
            "fba" => done(&["encode", &file("hi.jsonl"), "-o", &there, "-q", "--max-error", "0.15"]),
            _ => done(&["import", &file("hi.jsonl"), "-o", &there]),
        };
        done(&["import", &there, "-o", &back]);
        done(&["compare", &file("hi.jsonl"), &back, "--tolerance", "0.2"]);
    }
    // Keys that were left out are joined.
    done(&["import", &file("hi.jsonl"), "-o", &file("few.glb"), "--tolerance", "1"]);
    done(&["import", &file("few.glb"), "-o", &file("few.jsonl")]);
    let frames = |name: &str| read_poses(Path::new(&file(name))).unwrap().frames.len();
    assert_eq!(frames("few.jsonl"), frames("hi.jsonl"));
    // A hand that is asked for is taken, or missed.
    done(&[
        "import",
        &file("hi.bvh"),
        "-o",
        &file("back.jsonl"),
        "--hand",
        "left",
        "--save-person",
        &file("p.toml"),
    ]);
    refused(
        &["import", &file("hi.webxr.json"), "-o", &file("none.jsonl"), "--hand", "right"],
        &folder.path().join("none.jsonl"),
        &["no hand is called right"],
    );
    // Positions are there as well, where solving is asked for.
    done(&["import", &file("hi.webxr.json"), "-o", &file("tied.jsonl"), "--tie"]);
    let x = folder.path().join("x.jsonl");
    misused(
        &["import", &file("hi.glb"), "--tie", "-o", path(&x)],
        &x,
        &["hi.glb has poses, which are written as they are"],
    );
    // The same from standard input.
    let input = File::open(file("hi.bvh")).unwrap();
    let piped = Command::new(program()).args(["import", "-", "-o", path(&x)]).stdin(input).status().unwrap();
    assert!(piped.success());
    done(&["compare", &file("hi.jsonl"), path(&x), "--tolerance", "0.001"]);
}

/// What is not on the grid of the header's frame rates goes through all the same, at its times.
#[test]
fn rates_that_no_stream_has_come_back_at_their_times() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (given, hand, slow) = (at("given.jsonl"), at("hand.fba"), at("slow.jsonl"));
    let wrist = r#""wrist":{"translation":[0,0,-0.5],"rotation":[0,0,0,1]}"#;
    for rate in [0.3, 3.3, 20.0 / 3.0, 100.0 / 11.0] {
        let mut lines = format!(
            "{{\"format\":\"handcast-poses\",\"version\":1,\"rate\":{rate},\"hands\":[{{\"side\":\"right\"}}]}}\n"
        );
        let bend = |i: u32| f64::from(i * 37 % 60);
        for i in 0..30u32 {
            let (t, bend) = (f64::from(i) / rate, bend(i));
            lines += &format!(
                "{{\"t\":{t:.6},\"hand\":\"right\",{wrist},\"angles\":{{\"index1_flexion\":{bend}}}}}\n"
            );
        }
        std::fs::write(at("given.jsonl"), lines).unwrap();
        for live in [&["--live"][..], &[]] {
            let args = ["encode", path(&given), "-o", path(&hand), "--max-error", "0.3"];
            let out = handcast(&[&args[..], live].concat());
            let said = text(&out.stderr);
            assert!(out.status.success() && said.contains("no stream has"), "{said}");
            done(&["decode", path(&hand), "-o", path(&at("back.jsonl"))]);
            let back = read_poses(&at("back.jsonl")).unwrap();
            for i in 0..30u32 {
                // In the middle of the time for which it is shown.
                let time = (f64::from(i) + 0.45) / rate;
                let shown = back.frames.iter().rev().find(|pose| pose.time <= time).unwrap();
                let off = shown.pose.angle(JointAngle::Index1Flexion).to_degrees() - bend(i);
                assert!(off.abs() < 0.31, "{rate}: {off} in frame {i}");
            }
        }
        done(&["compare", path(&given), path(&hand)]);
        done(&["fidelity", path(&given), "-q"]);
    }
    let header =
        "{\"format\":\"handcast-poses\",\"version\":1,\"rate\":0.001,\"hands\":[{\"side\":\"right\"}]}\n";
    std::fs::write(at("slow.jsonl"), format!("{header}{{\"t\":0,\"hand\":\"right\",{wrist}}}\n")).unwrap();
    let none = at("slow.fba");
    let args = ["encode", path(&slow), "-o", path(&none)];
    refused(&args, &none, &["at least 1/128", "more.jsonl --fps 1"]);
}

#[test]
fn frames_without_times_go_by_the_rate_that_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let poses = at("hand.jsonl");
    done(&["spell", "HI", "-o", path(&poses)]);
    let webxr = at("hand.webxr.json");
    done(&["import", path(&poses), "-o", path(&webxr), "-q"]);
    let mut document: Value = serde_json::from_str(&std::fs::read_to_string(&webxr).unwrap()).unwrap();
    let frames = document["frames"].as_array_mut().unwrap();
    frames.iter_mut().for_each(|frame| drop(frame.as_object_mut().unwrap().remove("time")));
    let count = frames.len();
    let hands: Vec<Value> = frames.iter().map(|frame| frame["hands"][0].clone()).collect();
    document.as_object_mut().unwrap().remove("fps");
    for (name, content) in [
        ("list.json", json!(hands)),
        ("frames.json", json!({ "frames": hands })),
        ("bare.webxr.json", document),
    ] {
        std::fs::write(at(name), content.to_string()).unwrap();
        let import = |more: &[&str]| {
            let out =
                handcast(&[&["import", path(&at(name)), "-o", path(&at("out.jsonl"))][..], more].concat());
            assert!(out.status.success(), "{name}: {}", text(&out.stderr));
            let clip = read_poses(&at("out.jsonl")).unwrap();
            (clip.frames.len(), clip.frames.last().unwrap().time, text(&out.stderr))
        };
        let (frames, last, said) = import(&[]);
        assert!(frames == count && (last - (count - 1) as f64 / 30.0).abs() < 1e-5, "{name}: {last}");
        assert!(
            said.contains("30 frames a second are taken for granted; --input-fps tells"),
            "{name}: {said}"
        );
        let (_, last, said) = import(&["--input-fps", "72"]);
        assert!((last - (count - 1) as f64 / 72.0).abs() < 1e-5, "{name}: {last}");
        assert!(!said.contains("changes nothing") && !said.contains("taken for granted"), "{name}: {said}");
    }
}

#[test]
fn two_outputs_are_not_both_standard_output() {
    let out = handcast(&["spell", "HI", "-o", "-", "--to", "bvh", "--labels", "-"]);
    let said = text(&out.stderr);
    assert!(!out.status.success() && out.stdout.is_empty(), "{said}");
    assert!(said.contains("two outputs, and one standard output"), "{said}");
}
