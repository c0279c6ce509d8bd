//! Files of other programs come in through the command, and go out to them.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common::command::{done, handcast, path, refused, text};
use crate::common::python::with_package;
use crate::common::shared;
use handcast_formats::poses::{read_poses, write_poses};
use handcast_hand::landmarks::{LANDMARKS_21, mediapipe_21};
use handcast_hand::{
    ClipHand, Finger, HandPose, Joint, JointAngle, Morphology, PoseClip, PoseHeader, Side, Skeleton,
    TimedPose,
};
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};

const SIZE: [f64; 2] = [1280.0, 720.0];
const SIDES: [Side; 2] = [Side::Left, Side::Right];

#[test]
fn streams_whose_sizes_a_file_has_no_place_for_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| path(&folder.path().join(name)).to_owned();
    write_poses(folder.path().join("poses.jsonl").as_path(), &clip(&[Side::Right])).unwrap();
    done(&["encode", &file("poses.jsonl"), "-o", &file("s.fba")]);
    for (name, said) in [("x.bap", true), ("x.csv", true), ("x.json", false)] {
        let out = handcast(&["decode", &file("s.fba"), "-o", &file(name)]);
        assert_eq!(
            text(&out.stderr).contains("has no place for the person's sizes"),
            said,
            "{name}: {out:?}"
        );
    }
}

/// Of a mean hand, whose palm is cupped.
#[test]
fn import_and_encode_make_the_same_poses() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| path(&folder.path().join(name)).to_owned();
    let mut cupped = clip(&[Side::Right]);
    cupped.header.hands[0].morphology = None;
    for (i, frame) in cupped.frames.iter_mut().enumerate() {
        let bend = 0.1 - 0.1 * (0.3 * i as f64).cos();
        frame.pose.set(JointAngle::Ring0Flexion, 0.6 * bend);
        frame.pose.set(JointAngle::Pinky0Flexion, bend);
    }
    write_poses(folder.path().join("poses.jsonl").as_path(), &cupped).unwrap();
    for name in ["x.bvh", "x.webxr.json", "x.landmarks.jsonl", "x.pose", "x.csv", "x.json", "x.bap", "x.glb"]
    {
        done(&["import", &file("poses.jsonl"), "-o", &file(name)]);
        done(&["import", &file(name), "-o", &file("a.jsonl")]);
        done(&["encode", &file(name), "-o", &file("b.fba"), "--quant", "1"]);
        done(&["compare", &file("a.jsonl"), &file("b.fba"), "--tolerance", "0.3"]);
    }
}

/// A hand before the camera, its fingers bent in turn.
fn hand(side: Side, i: usize) -> HandPose {
    let s = |k: f64| 0.5 - 0.5 * (0.15 * i as f64 + k).cos();
    let mut pose = HandPose::neutral(side);
    let out = if side == Side::Left { 1.0 } else { -1.0 };
    pose.rotation = UnitQuaternion::from_euler_angles(0.4 * s(0.0), 0.5 * s(1.0), 0.3 * s(2.0));
    pose.translation = Vector3::new(out * -0.12 + 0.04 * s(1.5), -0.06, -0.5 - 0.08 * s(0.5));
    for (k, finger) in Finger::LONG.into_iter().enumerate() {
        pose.set(finger.base_flexion(), 0.9 * s(k as f64));
        pose.set(finger.middle_flexion(), 1.1 * s(k as f64));
        pose.set(finger.end_flexion(), 0.7 * s(k as f64));
    }
    pose
}

/// Both hands, 40 frames at 25 a second.
fn clip(sides: &[Side]) -> PoseClip {
    let sizes = Some(Morphology::average(0.185));
    let hands = sides.iter().map(|&side| ClipHand { side, morphology: sizes.clone() }).collect();
    let frames =
        (0..40).flat_map(|i| sides.iter().map(move |&s| TimedPose::new(i as f64 / 25.0, hand(s, i))));
    PoseClip {
        header: PoseHeader { rate: Some(25.0), hands, ..PoseHeader::default() },
        frames: frames.collect(),
    }
}

/// The joints of a pose as MediaPipe has them: shares of the picture with depths, and metres about the middle.
fn seen(pose: &HandPose) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    let frames = Skeleton::new(&Morphology::average(0.185), pose.side).frames(pose);
    let joints = mediapipe_21(|joint| frames.position(joint));
    let focal = 0.5 * SIZE[0] / 30f64.to_radians().tan();
    let picture = joints.map(|p| {
        let depth = (joints[0].z - p.z) * focal / -joints[0].z / SIZE[0];
        [0.5 - focal * p.x / p.z / SIZE[0], 0.5 + focal * p.y / p.z / SIZE[1], depth]
    });
    let middle = joints.iter().map(|p| p.coords).sum::<Vector3<f64>>() / 21.0;
    let world = joints.map(|p| p - middle).map(|p| [p.x, -p.y, -p.z]);
    (picture.to_vec(), world.to_vec())
}

fn named(points: &[[f64; 3]]) -> Value {
    points.iter().map(|[x, y, z]| json!({ "x": x, "y": y, "z": z })).collect()
}

/// The hands at an instant of [`clip`], as the tasks for the web print them.
fn result(clip: &PoseClip, time: f64, names: [&str; 2]) -> Value {
    let hands: Vec<_> = clip.frames.iter().filter(|f| f.time == time).map(|f| &f.pose).collect();
    let of = |k: usize| -> Value {
        hands.iter().map(|pose| if k == 0 { named(&seen(pose).0) } else { named(&seen(pose).1) }).collect()
    };
    let name = |side: Side| names[side as usize];
    let category = |pose: &&HandPose| json!([{ "score": 0.9, "index": 0, "categoryName": name(pose.side) }]);
    json!({
        "timestamp": time * 1000.0,
        "handedness": hands.iter().map(category).collect::<Vec<_>>(),
        "landmarks": of(0),
        "worldLandmarks": of(1),
    })
}

fn results(clip: &PoseClip, names: [&str; 2]) -> Vec<Value> {
    (0..40).map(|i| result(clip, i as f64 / 25.0, names)).collect()
}

/// Middle of the angles by which bends differ and wrists are turned, degrees, and of the wrists' distances, metres.
fn apart(a: &PoseClip, b: &PoseClip) -> [f64; 3] {
    let mut off = [Vec::new(), Vec::new(), Vec::new()];
    for side in SIDES {
        assert_eq!(a.of(side).count(), b.of(side).count(), "{side:?}");
        for (a, b) in a.of(side).zip(b.of(side)) {
            assert!((a.time - b.time).abs() < 1e-6 && b.valid);
            for finger in Finger::LONG {
                for angle in [finger.base_flexion(), finger.middle_flexion(), finger.end_flexion()] {
                    off[0].push((a.pose.angle(angle) - b.pose.angle(angle)).abs().to_degrees());
                }
            }
            off[1].push(a.pose.rotation.angle_to(&b.pose.rotation).to_degrees());
            off[2].push((a.pose.translation - b.pose.translation).norm());
        }
    }
    off.map(median)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Imports a file, and gives the poses and what the command said.
fn imported(folder: &Path, name: &str, content: &str, more: &[&str]) -> (PoseClip, String) {
    let (file, out) = (folder.join(name), folder.join(format!("{name}.jsonl")));
    std::fs::write(&file, content).unwrap();
    let run = handcast(&[&["import", path(&file), "-o", path(&out)], more].concat());
    assert!(run.status.success(), "{}", text(&run.stderr));
    (read_poses(&out).unwrap(), text(&run.stderr))
}

#[test]
fn results_of_mediapipe_come_out_the_right_way_up() {
    let folder = tempfile::tempdir().unwrap();
    let truth = clip(&SIDES);
    let all = results(&truth, ["Left", "Right"]);
    let lines: Vec<String> = all.iter().map(Value::to_string).collect();
    let sized = format!("{{\"width\":1280,\"height\":720}}\n{}", lines.join("\n"));
    for (name, content, more, placed) in [
        ("list.json", json!(all).to_string(), &[][..], false),
        ("lines.jsonl", lines.join("\n"), &["--image-size", "1280x720"], true),
        ("sized.json", sized, &[], true),
    ] {
        let (poses, said) = imported(folder.path(), name, &content, more);
        assert!(said.contains("axes mediapipe (as files of this format have them)"), "{said}");
        let [bends, turned, moved] = apart(&truth, &poses);
        println!("{name}: bends {bends:.3}°, wrist {turned:.3}°, {:.2} mm", 1e3 * moved);
        assert!(bends < 1.0 && turned < 2.0, "{name}: {bends}° {turned}°");
        assert_eq!(moved < 0.01, placed, "{name}: {moved} m");
        assert!(poses.frames.iter().all(|frame| frame.confidence == Some(0.9)));
    }
    // Upside down and back to front, where that is asked for.
    let (poses, said) =
        imported(folder.path(), "b.json", &json!(all).to_string(), &["--input-axes", "webxr"]);
    assert!(said.contains("axes webxr (as asked)"), "{said}");
    assert!(apart(&truth, &poses)[1] > 150.0);
    // One of the two.
    let (poses, _) = imported(folder.path(), "c.json", &json!(all).to_string(), &["--hand", "left"]);
    assert_eq!((poses.header.hands.len(), poses.header.hands[0].side), (1, Side::Left));
}

#[test]
fn names_of_a_mirrored_picture_are_exchanged_where_the_shape_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let truth = clip(&SIDES);
    let content = json!(results(&truth, ["Right", "Left"])).to_string();
    let (poses, said) = imported(folder.path(), "a.json", &content, &[]);
    assert!(said.contains("the hand called left fits as a right one"), "{said}");
    let [bends, turned, _] = apart(&truth, &poses);
    assert!(bends < 1.0 && turned < 2.0, "{bends}° {turned}°");
}

#[test]
fn joints_in_pictures_alone_give_the_pose_under_a_camera() {
    let folder = tempfile::tempdir().unwrap();
    let truth = clip(&[Side::Left]);
    let called = |name: &str, deep: bool, pixels: bool| -> String {
        let result = |frame: &TimedPose| {
            let scale = if pixels { SIZE } else { [1.0, 1.0] };
            let points = seen(&frame.pose).0.into_iter().map(|[x, y, z]| {
                let mut point = json!({ "x": x * scale[0], "y": y * scale[1] });
                if deep {
                    point["z"] = json!(z * scale[0]);
                }
                point
            });
            let points: Vec<Value> = points.collect();
            format!("{}\n", json!({ "t": frame.time, "landmarks": [points], "handedness": [name] }))
        };
        truth.frames.iter().map(result).collect()
    };
    let lines = |deep: bool, pixels: bool| called("Left", deep, pixels);
    let size = ["--image-size", "1280x720", "--hand-length-mm", "185"];
    for (deep, pixels) in [(true, false), (true, true), (false, true)] {
        let (poses, said) = imported(folder.path(), "flat.jsonl", &lines(deep, pixels), &size);
        assert!(said.contains("seen in pictures alone, by a camera of 60°"), "{said}");
        let [bends, turned, moved] = apart(&truth, &poses);
        println!(
            "deep {deep}, pixels {pixels}: bends {bends:.2}°, wrist {turned:.2}°, {:.1} mm",
            1e3 * moved
        );
        assert!(bends < 3.0 && turned < 5.0 && moved < 0.02, "{bends}° {turned}° {moved} m");
    }
    // Names are those of mirrored pictures here, too.
    let (poses, said) = imported(folder.path(), "called.jsonl", &called("Right", true, false), &size);
    assert!(said.contains("the hand called right fits as a left one"), "{said}");
    let [bends, turned, _] = apart(&truth, &poses);
    assert!(bends < 3.0 && turned < 5.0, "{bends}° {turned}°");
    // A camera that sees half as much stands twice as far away.
    let narrow = [&size[..], &["--fov", "32.2"]].concat();
    let (poses, _) = imported(folder.path(), "narrow.jsonl", &lines(true, false), &narrow);
    let depth = median(poses.frames.iter().map(|frame| -frame.pose.translation.z).collect());
    assert!((0.9..1.3).contains(&depth), "{depth} m");
    let file = folder.path().join("sizeless.jsonl");
    std::fs::write(&file, lines(true, false)).unwrap();
    let out = folder.path().join("none.jsonl");
    refused(&["import", path(&file), "-o", path(&out)], &out, &["sizeless.jsonl", "--image-size", "picture"]);
}

#[test]
fn what_is_wrong_with_foreign_files_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_poses(&at("good.jsonl"), &clip(&SIDES)).unwrap();
    done(&["encode", path(&at("good.jsonl")), "-o", path(&at("good.fba"))]);
    done(&["decode", path(&at("good.fba")), "-o", path(&at("good.pose"))]);
    let whole = std::fs::read(at("good.pose")).unwrap();
    std::fs::write(at("cut.pose"), &whole[..whole.len() - 9]).unwrap();
    let mut huge = whole.clone();
    // The number of frames, behind the header.
    let body = whole.len() - 40 * 2 * 2 * 21 * 4 * 4 - 6;
    huge[body..body + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    std::fs::write(at("huge.pose"), &huge).unwrap();
    std::fs::write(at("short.json"), r#"{"landmarks":[[{"x":0.1,"y":0.2}]],"handedness":[]}"#).unwrap();
    let out = at("out.jsonl");
    for (name, words) in [
        ("cut.pose", &["cut.pose", "bytes", "follow the header"][..]),
        ("huge.pose", &["huge.pose", "4294967295 instants, allowed at most 110000"]),
        ("short.json", &["short.json", "result 0", "1 points, expected 21"]),
    ] {
        refused(&["import", path(&at(name)), "-o", path(&out)], &out, words);
        let stream = at("out.fba");
        refused(&["encode", path(&at(name)), "-o", path(&stream)], &stream, words);
    }
    let good = at("good.pose");
    for wrong in [["--axes", "up"], ["--image-size", "1280"], ["--fov", "0"]] {
        let args = [&["import", path(&good), "-o", path(&out)][..], &wrong].concat();
        assert_eq!(handcast(&args).status.code(), Some(2), "{wrong:?}");
    }
    // Two hands, with their places and sizes.
    let said = done(&["import", path(&at("good.pose")), "-o", path(&out)]);
    assert!(said.is_empty());
    let [bends, turned, moved] = apart(&clip(&SIDES), &read_poses(&out).unwrap());
    assert!(bends < 2.0 && turned < 2.0 && moved < 0.005, "{bends}° {turned}° {moved} m");
}

/// The turn that brings the palm of a mean hand onto five joints (Kabsch).
fn palm_turn(points: &[Point3<f64>], side: Side) -> UnitQuaternion<f64> {
    let rest = Skeleton::new(&Morphology::default(), side).local_frames(&[0.0; JointAngle::COUNT]);
    let palm = [0usize, 5, 9, 13, 17];
    let ours = palm.map(|i| rest.position(LANDMARKS_21[i]).coords);
    let theirs = palm.map(|i| points[i].coords);
    let mean = |all: &[Vector3<f64>; 5]| all.iter().sum::<Vector3<f64>>() / 5.0;
    let (a, b) = (mean(&ours), mean(&theirs));
    let mut h = Matrix3::zeros();
    for (x, y) in ours.iter().zip(&theirs) {
        h += (y - b) * (x - a).transpose();
    }
    let svd = h.svd(true, true);
    let (u, v) = (svd.u.unwrap(), svd.v_t.unwrap());
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v).determinant().signum()));
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * sign * v))
}

/// Angles between the bones of the long fingers behind their knuckles, degrees; less than zero where they are bent
/// backwards, which the line of the knuckles tells.
fn bends(points: &[Point3<f64>], side: Side) -> Vec<f64> {
    let across = (points[5] - points[17]) * if side == Side::Left { -1.0 } else { 1.0 };
    let of = |finger: usize, k: usize| {
        let at = 5 + 4 * finger + k;
        let (a, b) = (points[at + 1] - points[at], points[at + 2] - points[at + 1]);
        a.angle(&b).to_degrees().copysign(a.cross(&b).dot(&across))
    };
    (0..4).flat_map(|finger| [of(finger, 0), of(finger, 1)]).collect()
}

fn solved_bends(pose: &HandPose) -> Vec<f64> {
    let of = |finger: Finger| [finger.middle_flexion(), finger.end_flexion()];
    Finger::LONG.into_iter().flat_map(of).map(|angle| pose.angle(angle).to_degrees()).collect()
}

/// A recording of MediaPipe, its points turned the right way up by hand, and the tasks' JSON of it.
fn recording(name: &str) -> (Vec<Vec<Point3<f64>>>, String, String) {
    let lines =
        std::fs::read_to_string(shared(&format!("data/motion/landmarks/{name}.landmarks.jsonl"))).unwrap();
    let size = match name {
        "counting" => [544.0, 960.0],
        "finger-flexions" => [1280.0, 720.0],
        _ => [620.0, 1080.0],
    };
    let (mut points, mut tasks) = (Vec::new(), Vec::new());
    for line in lines.lines().skip(1) {
        let frame: Value = serde_json::from_str(line).unwrap();
        let read = |list: &Value| -> Vec<Vec<f64>> { serde_json::from_value(list.clone()).unwrap() };
        let (world, image) = (read(&frame["points"]), read(&frame["image"]));
        points.push(world.iter().map(|p| Point3::new(p[0], -p[1], -p[2])).collect());
        let object = |p: &Vec<f64>| json!({ "x": p[0], "y": p[1], "z": p[2] });
        let share = |p: &Vec<f64>| json!({ "x": p[0] / size[0], "y": p[1] / size[1] });
        tasks.push(json!({
            "timestamp_ms": 1000.0 * frame["t"].as_f64().unwrap(),
            "hand_landmarks": [image.iter().map(share).collect::<Vec<_>>()],
            "hand_world_landmarks": [world.iter().map(object).collect::<Vec<_>>()],
        }));
    }
    (points, json!(tasks).to_string(), lines)
}

#[test]
#[ignore = "needs the shared material"]
fn recordings_of_mediapipe_are_solved_as_directly() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["counting", "finger-flexions", "fingerspelling"] {
        let (points, tasks, lines) = recording(name);
        for (kind, content) in [("json", &tasks), ("landmarks.jsonl", &lines)] {
            let (poses, said) = imported(folder.path(), &format!("{name}.{kind}"), content, &[]);
            assert!(said.contains("axes mediapipe"), "{said}");
            let side = poses.header.hands[0].side;
            let (mut turned, mut bent) = (Vec::new(), Vec::new());
            for (frame, points) in poses.frames.iter().zip(&points) {
                turned.push(frame.pose.rotation.angle_to(&palm_turn(points, side)).to_degrees());
                let off = solved_bends(&frame.pose)
                    .into_iter()
                    .zip(bends(points, side))
                    .map(|(a, b)| (a - b).abs());
                bent.extend(off);
            }
            assert_eq!(poses.frames.len(), points.len());
            let [turned, bent] = [turned, bent].map(median);
            println!("{name}.{kind}: {} hand, wrist {turned:.2}°, bends {bent:.2}°: {said}", side.name());
            assert!(turned < 10.0 && bent < 3.0, "{name}: {turned}° {bent}°");
        }
    }
}

#[test]
#[ignore = "needs Python and its package index"]
fn pose_format_reads_and_writes_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut truth = clip(&SIDES);
    // Lost for some frames, unsure in others.
    for (i, frame) in truth.frames.iter_mut().enumerate() {
        frame.confidence = Some(if i % 3 == 0 { 0.25 } else { 0.75 });
        frame.valid = !(20..26).contains(&i);
    }
    write_poses(&at("poses.jsonl"), &truth).unwrap();
    let whole: PathBuf = at("poses.jsonl");
    done(&["import", path(&landmarks(folder.path(), &truth)), "-o", path(&at("one.pose")), "-q"]);
    std::fs::write(at("both.pose"), pose_file(&truth)).unwrap();
    assert!(whole.exists());
    let python = with_package("pose-format", "0.15.0", "pose_format");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/pose.py");
    for version in ["both.pose", "one.pose", "old.pose"] {
        if version == "old.pose" {
            std::fs::write(at(version), old_pose_file(&truth)).unwrap();
        }
        let out = Command::new(&python).arg(&script).args([at(version), at("again.pose")]).output().unwrap();
        assert!(out.status.success(), "{}", text(&out.stderr));
        let read: Value = serde_json::from_slice(&out.stdout).unwrap();
        assert_eq!(read["fps"].as_f64(), Some(25.0));
        check_python(&read, if version == "one.pose" { &SIDES[1..] } else { &SIDES }, &truth, version);
        // What it wrote says the same here as what it read.
        for (from, to) in [(version, "a.jsonl"), ("again.pose", "b.jsonl")] {
            done(&["import", path(&at(from)), "-o", path(&at(to)), "-q"]);
        }
        let [a, b] = ["a.jsonl", "b.jsonl"].map(|name| read_poses(&at(name)).unwrap());
        assert_eq!(a.frames, b.frames, "{version}");
        assert!(
            a.frames.iter().filter(|frame| frame.confidence == Some(0.25)).count() > 10
                || version == "one.pose"
        );
    }
}

/// A file of landmarks with the right hand alone.
fn landmarks(folder: &Path, clip: &PoseClip) -> PathBuf {
    let file = folder.join("one.landmarks.jsonl");
    let mut one = clip.clone();
    one.header.hands.retain(|hand| hand.side == Side::Right);
    one.frames.retain(|frame| frame.pose.side == Side::Right && frame.valid);
    let mut bytes = Vec::new();
    handcast_formats::landmarks::points::write_landmarks(&one, &Morphology::default(), &mut bytes).unwrap();
    std::fs::write(&file, bytes).unwrap();
    file
}

fn pose_file(clip: &PoseClip) -> Vec<u8> {
    let format = handcast_formats::motion::Format::by_id("pose").unwrap();
    format.write(clip, &handcast_formats::motion::WriteOptions::default()).unwrap().bytes
}

fn old_pose_file(clip: &PoseClip) -> Vec<u8> {
    use handcast_formats::landmarks::pose_format::{PoseVersion, write_pose};
    let mut bytes = Vec::new();
    write_pose(clip, &Morphology::default(), 25.0, PoseVersion::V0_1, &mut bytes).unwrap();
    bytes
}

/// That what Python read are the joints of the clip.
fn check_python(read: &Value, sides: &[Side], truth: &PoseClip, name: &str) {
    let components = read["components"].as_array().unwrap();
    let names: Vec<&str> = components.iter().map(|c| c[0].as_str().unwrap()).collect();
    let expected = ["LANDMARKS", "WORLD_LANDMARKS"].map(|kind| {
        sides
            .iter()
            .map(move |side| format!("{}_HAND_{kind}", side.name().to_uppercase()))
            .collect::<Vec<_>>()
    });
    assert_eq!(names, expected.concat(), "{name}");
    assert_eq!(components[0][2][8], "INDEX_FINGER_TIP");
    if name == "one.pose" {
        return;
    }
    let number = |list: &Value, frame: usize, point: usize| list[frame][0][point].clone();
    for (k, side) in sides.iter().enumerate() {
        let skeleton = Skeleton::new(&Morphology::average(0.185), *side);
        for (i, frame) in truth.of(*side).enumerate() {
            let joints = skeleton.frames(&frame.pose);
            let places = mediapipe_21(|joint| joints.position(joint));
            for (j, (joint, p)) in LANDMARKS_21.into_iter().zip(places).enumerate() {
                let point = 21 * (sides.len() + k) + j;
                let sure = number(&read["confidence"], i, point).as_f64().unwrap();
                let expected = if frame.valid { frame.confidence.unwrap() } else { 0.0 };
                assert!((sure - expected).abs() < 1e-6, "{name}: frame {i}: {sure}, {expected}");
                let at: [f64; 3] = serde_json::from_value(number(&read["data"], i, point)).unwrap();
                let off = (Vector3::from(at) - Vector3::new(p.x, -p.y, -p.z)).norm();
                assert!(
                    !frame.valid || off < 1e-6,
                    "{name}: frame {i}, {}: {off} m",
                    Joint::webxr_name(joint)
                );
            }
        }
    }
}
