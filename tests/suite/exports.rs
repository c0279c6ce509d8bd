//! The kinds of files `handcast decode` and its relatives write, through the command itself.

use std::path::{Path, PathBuf};

use crate::common::command::{done, handcast, misused, path, refused, text};
use crate::common::glb::{document, motion, node};
use crate::common::shared;
use handcast_formats::motion::{Format, Motion};
use handcast_formats::poses::{read_poses, write_poses};
use handcast_hand::{
    ClipHand, Joint, JointAngle, Morphology, PoseClip, PoseHeader, Side, Skeleton, TimedPose,
};

/// A stream with these hands, and the poses that come out of it.
fn stream(folder: &Path, sides: &[Side]) -> (PathBuf, PoseClip) {
    let mut header = PoseHeader { rate: Some(25.0), ..PoseHeader::default() };
    header.hands = sides.iter().map(|&side| ClipHand { side, morphology: None }).collect();
    let frames = sides.iter().flat_map(|&s| motion(s, 50)).map(|(t, pose)| TimedPose::new(t, pose)).collect();
    let name = |ending: &str| folder.join(format!("{}.{ending}", sides.len()));
    let (poses, fba, decoded) = (name("jsonl"), name("fba"), name("decoded.jsonl"));
    write_poses(&poses, &PoseClip { header, frames }).unwrap();
    done(&["encode", path(&poses), "-o", path(&fba)]);
    done(&["decode", path(&fba), "-o", path(&decoded)]);
    (fba, read_poses(&decoded).unwrap())
}

/// What `handcast decode` makes of a stream of one right hand under the name `name`, and the poses that are in it.
fn decoded(folder: &Path, name: &str, more: &[&str]) -> (PathBuf, PoseClip) {
    let (fba, clip) = stream(folder, &[Side::Right]);
    let out = folder.join(name);
    done(&[&["decode", path(&fba), "-o", path(&out)], more].concat());
    (out, clip)
}

#[test]
fn every_format_is_written_by_its_ending_or_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let (fba, clip) = stream(folder.path(), &[Side::Left, Side::Right]);
    let out = |name: &str| folder.path().join(name);
    for name in ["x.glb", "x.jsonl", "x.json", "x.csv", "x.bvh", "x.webxr.json", "x.bap"] {
        done(&["decode", path(&fba), "-o", path(&out(name))]);
    }
    let read = |name: &str| std::fs::read_to_string(out(name)).unwrap();
    assert_eq!(read("x.csv").lines().count(), 1 + clip.frames.len());
    let json: serde_json::Value = serde_json::from_str(&read("x.json")).unwrap();
    assert_eq!(json["frames"].as_array().unwrap().len(), clip.frames.len());
    let angle = json["frames"][7]["angles"]["index2_flexion"].as_f64().unwrap();
    let expected = clip.frames[7].pose.angle(JointAngle::Index2Flexion).to_degrees();
    assert!((angle - expected).abs() < 1e-4, "degrees by name: {angle}, {expected}");
    let webxr: serde_json::Value = serde_json::from_str(&read("x.webxr.json")).unwrap();
    assert_eq!(webxr["frames"][0]["hands"][1]["joints"].as_array().unwrap().len(), 25);
    // The same by name, to standard output.
    assert_eq!(done(&["decode", path(&fba), "-o", "-", "--to", "csv", "-q"]), read("x.csv"));
    // Landmarks hold one hand.
    let marks = out("x.landmarks.jsonl");
    refused(&["decode", path(&fba), "-o", path(&marks)], &marks, &["one hand"]);
    done(&["decode", path(&fba), "-o", path(&marks), "--only", "left"]);
    assert!(read("x.landmarks.jsonl").lines().next().unwrap().contains("\"left\""));
    // Half the frames.
    done(&["decode", path(&fba), "-o", path(&out("slow.csv")), "--fps", "12.5"]);
    assert_eq!(read("slow.csv").lines().count(), 1 + 2 * 25);
    for wrong in [&["--fps", "0"][..], &["--map", "x.toml"], &["--names", "elvish"], &["--tolerance", "-1"]] {
        let none = out("y.glb");
        let args = [&["decode", path(&fba), "-o", path(&none)][..], wrong].concat();
        assert_eq!(handcast(&args).status.code(), Some(2), "{wrong:?}");
    }
}

#[test]
fn every_export_is_read_again_by_every_reader() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name);
    let (fba, clip) = stream(folder.path(), &[Side::Left, Side::Right]);
    for format in Format::written() {
        // Whatever it is called: what is in it tells.
        let (file, again) = (out(&format!("{}.file", format.id)), out(&format!("{}.fba", format.id)));
        let more: &[&str] = match format.id {
            // No reader of poses looks at the surface.
            "glb" => &["--anim-only"],
            _ if format.hands == 1 => &["--only", "right"],
            _ => &[],
        };
        done(&[&["decode", path(&fba), "-o", path(&file), "--to", format.id], more].concat());
        done(&["encode", path(&file), "-o", path(&again), "-q"]);
        done(&["view", path(&file), "-o", path(&out("x.html"))]);
        if format.hands == 1 || format.id == "pose" {
            // Its points do not tell all that moves here.
            let back = Motion::read(&again).unwrap();
            assert_eq!(back.clip.of(Side::Right).count(), clip.of(Side::Right).count());
            assert_eq!(back.clip.header.hands.len(), format.hands);
            continue;
        }
        if format.id == "vrma" {
            // Avatars have no metacarpals; what they tell is tested in `vrma.rs`.
            done(&["compare", path(&file), path(&again)]);
            continue;
        }
        // The format keeps what the stream said; coding it anew adds what the encoder's defaults allow.
        done(&["compare", path(&fba), path(&file), "--tolerance", "0.05"]);
        done(&["compare", path(&file), path(&again)]);
    }
    done(&["encode", path(&fba), "-o", path(&out("anew.fba")), "--quant", "6"]);
    done(&["compare", path(&fba), path(&out("anew.fba")), "--tolerance", "10"]);
}

#[test]
fn the_stream_is_described_in_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let (glb, clip) = decoded(folder.path(), "x.glb", &[]);
    let more = ["--quantize", "--tolerance", "0.2", "--names", "vrm"];
    let (small, _) = decoded(folder.path(), "small.glb", &more);
    let facts = document(&std::fs::read(&glb).unwrap()).1["asset"]["extras"]["handcast"].clone();
    let size = std::fs::metadata(folder.path().join("1.fba")).unwrap().len();
    assert_eq!(facts["stream_bytes"].as_u64(), Some(size));
    assert_eq!(facts["frames_per_second"].as_f64(), Some(25.0));
    let number = |key: &str| facts[key].as_u64().unwrap();
    let seconds = clip.frames.len() as f64 / 25.0;
    let kbit_per_s = facts["kbit_per_s"].as_f64().unwrap();
    assert!((kbit_per_s - 8e-3 * size as f64 / seconds).abs() < 1e-9, "{facts}");
    assert!(number("planes") > 10 && number("intra_planes") >= 1, "{facts}");
    assert!(facts["quantiser_indices"][0].as_u64() <= facts["quantiser_indices"][1].as_u64());
    assert_eq!(facts["hands"][0]["side"], "right");
    let bytes = |p: &Path| std::fs::metadata(p).unwrap().len();
    assert!(bytes(&small) * 10 < bytes(&glb) * 7, "{} of {}", bytes(&small), bytes(&glb));
}

/// How far joints that 21 landmarks have are apart at most, metres; both clips have the same frames.
fn apart(clip: &PoseClip, back: &PoseClip, side: Side) -> f64 {
    let skeleton = Skeleton::new(back.header.hand(side).unwrap().morphology.as_ref().unwrap(), side);
    let ours = Skeleton::new(&Morphology::default(), side);
    assert_eq!(clip.of(side).count(), back.of(side).count());
    let mut worst = 0.0f64;
    for (a, b) in clip.of(side).zip(back.of(side)) {
        assert!((a.time - b.time).abs() < 1e-9);
        let (a, b) = (ours.frames(&a.pose), skeleton.frames(&b.pose));
        for joint in handcast_hand::landmarks::LANDMARKS_21 {
            worst = worst.max((a.position(joint) - b.position(joint)).norm());
        }
    }
    println!("{} hand there and back: joints off by {:.2} mm at most", side.name(), worst * 1e3);
    worst
}

#[test]
fn exported_landmarks_are_imported_again() {
    let folder = tempfile::tempdir().unwrap();
    let (marks, clip) = decoded(folder.path(), "x.landmarks.jsonl", &[]);
    let back = folder.path().join("back.jsonl");
    done(&["import", path(&marks), "-o", path(&back)]);
    let worst = apart(&clip, &read_poses(&back).unwrap(), Side::Right);
    // The importer keeps angles inside what joints can do; the motion does not always.
    assert!(worst < 0.004, "{worst} m");
}

#[test]
fn webxr_shaped_frames_are_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (fba, clip) = stream(folder.path(), &[Side::Left, Side::Right]);
    let both = at("both.webxr.json");
    done(&["decode", path(&fba), "-o", path(&both)]);
    let back = Motion::read(&both).unwrap();
    assert!(back.placed);
    // Rotations are in the file: every angle comes back, whatever sizes are measured from the joints.
    for side in [Side::Left, Side::Right] {
        assert_eq!(clip.of(side).count(), back.clip.of(side).count());
        for (a, b) in clip.of(side).zip(back.clip.of(side)) {
            for angle in JointAngle::ALL {
                let off = (a.pose.angle(angle) - b.pose.angle(angle)).abs();
                assert!(off < 2e-5, "{} {} at {} s: {off} rad", side.name(), angle.name(), a.time);
            }
            assert!(a.pose.rotation.angle_to(&b.pose.rotation) < 2e-5);
            assert!((a.pose.translation - b.pose.translation).norm() < 1e-6);
        }
    }
    let compared = handcast(&["compare", path(&fba), path(&both), "--tolerance", "360"]);
    assert!(text(&compared.stdout).contains("joint positions"), "{}", text(&compared.stderr));
    done(&["view", path(&both), "-o", path(&at("both.html"))]);
    // Poses are imported hand by hand.
    done(&["import", path(&both), "-o", path(&at("x.jsonl"))]);
    let imported = read_poses(&at("x.jsonl")).unwrap();
    assert!([Side::Left, Side::Right].iter().all(|&side| imported.of(side).count() == 50));
    let one = at("one.webxr.json");
    done(&["decode", path(&fba), "-o", path(&one), "--only", "left"]);
    done(&["import", path(&one), "-o", path(&at("one.jsonl"))]);
    assert_eq!(read_poses(&at("one.jsonl")).unwrap().of(Side::Left).count(), 50);
}

#[test]
#[ignore = "needs Node and npm ci --prefix tests/node"]
fn another_reader_of_bvh_finds_the_joints() {
    let folder = tempfile::tempdir().unwrap();
    for sides in [&[Side::Right][..], &[Side::Left, Side::Right]] {
        let (fba, clip) = stream(folder.path(), sides);
        let bvh = folder.path().join("x.bvh");
        done(&["decode", path(&fba), "-o", path(&bvh), "--names", "mpeg4"]);
        let frames = [0usize, 20, 40];
        let words: Vec<String> = frames.iter().map(|f| f.to_string()).collect();
        let mut arguments: Vec<&Path> = vec![&bvh];
        arguments.extend(words.iter().map(Path::new));
        let output = node("bvh.js", &arguments);
        assert!(output.status.success(), "{}", text(&output.stderr));
        let found: Vec<serde_json::Value> =
            text(&output.stdout).lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        for (frame, found) in frames.into_iter().zip(&found) {
            for &side in sides {
                let pose = &clip.of(side).nth(frame).unwrap().pose;
                let expected = Skeleton::new(&Morphology::default(), side).frames(pose);
                for joint in Joint::ALL.into_iter().filter(|j| !j.webxr_name().ends_with("tip")) {
                    let name = handcast_gltf::JointNames::Mpeg4.name(joint, side, 1);
                    let at = |k: usize| found[&name][0][k].as_f64().unwrap();
                    let off = expected.position(joint) - nalgebra::Point3::new(at(0), at(1), at(2));
                    assert!(off.norm() < 1e-5, "{name} in frame {frame}: {} m", off.norm());
                }
            }
        }
    }
}

#[test]
fn a_gltf_of_json_holds_everything_and_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (fba, _) = stream(folder.path(), &[Side::Left, Side::Right]);
    let poses = |name: &str| {
        done(&["import", path(&at(name)), "-o", path(&at("back.jsonl")), "-q"]);
        std::fs::read_to_string(at("back.jsonl")).unwrap()
    };
    for more in [&["--anim-only"][..], &["--quantize", "--tolerance", "0.1"]] {
        for name in ["x.glb", "x.gltf"] {
            done(&[&["decode", path(&fba), "-o", path(&at(name))], more].concat());
        }
        assert_eq!(poses("x.glb"), poses("x.gltf"));
    }
    // As others store it: with its data beside it.
    let glb = std::fs::read(at("x.glb")).unwrap();
    let (length, mut json) = document(&glb);
    json["buffers"][0]["uri"] = "the%20data.bin".into();
    std::fs::write(at("the data.bin"), &glb[28 + length..]).unwrap();
    std::fs::write(at("theirs.gltf"), json.to_string()).unwrap();
    assert_eq!(poses("x.glb"), poses("theirs.gltf"));
    std::fs::remove_file(at("the data.bin")).unwrap();
    refused(
        &["import", path(&at("theirs.gltf")), "-o", path(&at("none.jsonl"))],
        &at("none.jsonl"),
        &["the data.bin"],
    );
}

#[test]
#[ignore = "needs Node and npm ci --prefix tests/node"]
fn the_validator_finds_nothing_in_documents_of_json_and_animations_for_avatars() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (fba, _) = stream(folder.path(), &[Side::Left, Side::Right]);
    done(&["pose", "spread", "-o", path(&at("pose.gltf"))]);
    done(&["decode", path(&fba), "-o", path(&at("small.gltf")), "--quantize"]);
    done(&["decode", path(&fba), "-o", path(&at("rig.gltf")), "--mesh", path(&at("small.gltf"))]);
    done(&["import", path(&at("2.jsonl")), "-o", path(&at("palms.vrma"))]);
    let files = ["pose.gltf", "small.gltf", "rig.gltf", "palms.vrma"].map(at);
    let output = node("validate.js", &files.each_ref().map(|file| file.as_path()));
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
}

#[test]
fn rigs_of_unknown_names_are_read_by_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (fba, _) = stream(folder.path(), &[Side::Right]);
    done(&["decode", path(&fba), "-o", path(&at("x.glb")), "--anim-only", "--names", "mixamo"]);
    let glb = std::fs::read(at("x.glb")).unwrap();
    let (length, mut json) = document(&glb);
    json["asset"].as_object_mut().unwrap().remove("extras");
    let mut map = "hand = \"right\"\n[joints]\n".to_owned();
    for (node, joint) in json["nodes"].as_array_mut().unwrap().iter_mut().zip(Joint::ALL) {
        let name = format!("F{}", joint.index());
        map += &format!("{name} = \"{}\"\n", joint.webxr_name());
        node["name"] = name.into();
        node.as_object_mut().unwrap().remove("extras");
    }
    std::fs::write(at("theirs.glb"), crate::common::glb::container(&json, &glb[28 + length..])).unwrap();
    std::fs::write(at("joints.toml"), map).unwrap();
    let (theirs, map, out) = (at("theirs.glb"), at("joints.toml"), at("out.jsonl"));
    refused(&["import", path(&theirs), "-o", path(&out)], &out, &["\"F0\"", "and 9 more", "--map FILE.toml"]);
    done(&["import", path(&theirs), "-o", path(&out), "--map", path(&map), "-q"]);
    done(&["compare", path(&at("x.glb")), path(&out), "--tolerance", "0.01"]);
    done(&["encode", path(&theirs), "-o", path(&at("theirs.fba")), "--map", path(&map), "-q"]);
    misused(
        &["import", path(&fba), "-o", path(&at("y.jsonl")), "--map", path(&map)],
        &at("y.jsonl"),
        &["--map"],
    );
    misused(
        &["decode", path(&fba), "-o", path(&at("y.glb")), "--map", path(&map)],
        &at("y.glb"),
        &["--mesh"],
    );
}

#[test]
fn a_name_that_says_another_kind_than_asked_for_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (fba, _) = stream(folder.path(), &[Side::Right]);
    let file = folder.path().join("x.glb");
    let out = handcast(&["decode", path(&fba), "-o", path(&file), "--to", "csv"]);
    assert!(out.status.success());
    assert_eq!(
        text(&out.stderr).matches("--to csv is what is written, though the name ends as one of .glb").count(),
        1
    );
    let out = handcast(&["decode", path(&fba), "-o", path(&file), "--to", "glb", "--anim-only"]);
    assert!(!text(&out.stderr).contains("--to"));
}

#[test]
#[ignore = "needs the shared material"]
fn rigs_made_elsewhere_are_read_without_what_we_say_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for rig in ["openxr-right.gltf", "webxr-right.glb"] {
        let rig = shared("data/meshes").join(rig);
        done(&["import", "fixtures/demo.poses.jsonl", "-o", path(&at("x.glb")), "--mesh", path(&rig)]);
        let glb = std::fs::read(at("x.glb")).unwrap();
        let (length, mut json) = document(&glb);
        json["asset"] = serde_json::json!({ "version": "2.0" });
        std::fs::write(at("theirs.glb"), crate::common::glb::container(&json, &glb[28 + length..])).unwrap();
        let printed =
            done(&["compare", "fixtures/demo.poses.jsonl", path(&at("theirs.glb")), "--tolerance", "0.001"]);
        println!("{printed}");
    }
}

#[test]
fn pose_and_spell_write_the_same_kinds() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name);
    for name in ["a.glb", "a.bvh", "a.csv", "a.webxr.json", "a.landmarks.jsonl", "a.json", "a.png"] {
        done(&["pose", "asl:A", "-o", path(&out(name)), "--hand", "left"]);
    }
    done(&["spell", "HI", "-o", path(&out("h.glb")), "--fps", "15", "--quantize", "--names", "hanim"]);
    let (_, json) = document(&std::fs::read(out("h.glb")).unwrap());
    assert_eq!(json["nodes"][0]["name"], "r_radiocarpal");
}

#[test]
fn what_is_worth_saying_of_a_rig_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (fba, _) = stream(folder.path(), &[Side::Left, Side::Right]);
    let (plain, rig, moved) = (at("plain.glb"), at("rig.gltf"), at("wave hello.glb"));
    done(&["decode", path(&fba), "-o", path(&plain), "--only", "left", "--anim-only", "--names", "vrm"]);
    let (_, mut json) = document(&std::fs::read(&plain).unwrap());
    assert_eq!(json["animations"][0]["name"], "plain");
    // A hand on an arm, without any data.
    for part in ["animations", "accessors", "bufferViews", "buffers"] {
        json.as_object_mut().unwrap().remove(part);
    }
    let nodes = json["nodes"].as_array_mut().unwrap();
    let joints: Vec<usize> = (0..nodes.len()).collect();
    nodes.push(serde_json::json!({ "name": "leftLowerArm", "children": [0] }));
    json["scenes"][0]["nodes"] = serde_json::json!([nodes.len() - 1]);
    json["skins"] = serde_json::json!([{ "joints": joints }]);
    // With the mark of UTF-8 that some editors put first.
    std::fs::write(&rig, format!("\u{feff}{json}")).unwrap();
    let out = handcast(&["decode", path(&fba), "-o", path(&moved), "--mesh", path(&rig)]);
    let said = text(&out.stderr);
    assert!(out.status.success(), "{said}");
    for words in ["only its left hand moves", "wave hello.glb: left hand, ", "the left wrist only turns"] {
        assert_eq!(said.matches(words).count(), 1, "{words}: {said}");
    }
    let (_, json) = document(&std::fs::read(&moved).unwrap());
    assert_eq!(json["animations"][0]["name"], "wave hello");
    // Nothing is said of a rig that is not written.
    let out = handcast(&["decode", path(&fba), "-o", path(&at("x.csv")), "--mesh", path(&rig)]);
    assert!(!text(&out.stderr).contains("only turns"));
}

#[test]
#[ignore = "needs the shared material"]
fn spelled_words_move_rigs_made_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name);
    let meshes = shared("data/meshes");
    let moved = out("moved.glb");
    let rig = meshes.join("openxr-left.gltf");
    done(&["spell", "HI", "-o", path(&moved), "--hand", "left", "--mesh", path(&rig), "--tolerance", "0.2"]);
    let (_, json) = document(&std::fs::read(&moved).unwrap());
    assert!(json["asset"]["extras"]["handcast"]["rig_generator"].as_str().unwrap().contains("Blender"));
    let none = out("none.glb");
    let right = meshes.join("webxr-right.glb");
    let spell = |mesh: &Path, words: &[&str]| {
        refused(&["spell", "HI", "-o", path(&none), "--hand", "left", "--mesh", path(mesh)], &none, words);
    };
    spell(&right, &["webxr-right.glb", "a right one"]);
    spell(&meshes.join("x-invalid-weights.glb"), &["no hand found", "joints are named \"Palm\""]);
    spell(&meshes.join("nothing.glb"), &["nothing.glb"]);
}
