//! Motions on rigs made elsewhere.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::field_reassign_with_default)]

mod common;

use std::path::{Path, PathBuf};

use common::glb::{clip, container, document, node, world_transforms};
use common::shared;
use handcast_gltf::{
    Clip, ExportOptions, GltfError, JointMap, JointNames, Retargeted, export, import_poses, retarget,
};
use handcast_hand::{Finger, HandPose, Joint, JointAngle, Side, Skeleton};
use nalgebra::{UnitQuaternion, Vector3};

fn put(clip: &Clip, rig: &[u8]) -> Retargeted {
    retarget(clip, rig, None, None, &ExportOptions::default()).unwrap()
}

/// A rig of our own: the built-in hand, resting in a slightly bent pose anywhere in space.
fn own_rig(sides: &[Side], names: JointNames) -> Vec<u8> {
    let mut rest = clip(sides, 2);
    for (_, pose) in rest.hands.iter_mut().flat_map(|h| &mut h.poses) {
        *pose = HandPose { rotation: pose.rotation, ..HandPose::neutral(pose.side) };
        for finger in Finger::ALL {
            pose.set(finger.base_flexion(), 0.2);
            pose.set(finger.middle_flexion(), 0.3);
            pose.set(finger.abduction(), 0.1);
        }
        pose.rotation = UnitQuaternion::from_euler_angles(0.4, -1.0, 2.0);
        pose.translation = Vector3::new(1.0, 2.0, 3.0);
    }
    let mut options = ExportOptions::default();
    options.names = names;
    // Rigs of the tests have pictures of their own, or none.
    options.texture = None;
    export(&rest, &options).unwrap()
}

/// Every bone of every finger points where forward kinematics says, at some frames; the wrist is where it is.
fn assert_gesture(clip: &Clip, glb: &[u8], name: &dyn Fn(Joint, Side) -> String) {
    for hand in &clip.hands {
        let side = hand.poses[0].1.side;
        let skeleton = Skeleton::new(&hand.morphology, side);
        for (time, pose) in hand.poses.iter().step_by(9) {
            let world = world_transforms(glb, *time);
            let frames = skeleton.frames(pose);
            let at = |joint: Joint| world[&name(joint, side)].translation.vector;
            assert!((at(Joint::Wrist) - pose.translation).norm() < 1e-4);
            for finger in Finger::ALL {
                let joints = Joint::of(finger);
                let chain = &joints[joints.len() - 4..];
                for pair in chain.windows(2) {
                    let bone = (at(pair[1]) - at(pair[0])).normalize();
                    let ours = (frames.position(pair[1]) - frames.position(pair[0])).normalize();
                    let off = (bone - ours).norm();
                    assert!(off < 1e-4, "{} at {time}: {off}", pair[0].webxr_name());
                }
                for triple in chain.windows(3) {
                    let bend = |p: [Vector3<f64>; 3]| (p[1] - p[0]).angle(&(p[2] - p[1]));
                    let [a, b, c] = [triple[0], triple[1], triple[2]];
                    let ours = bend([a, b, c].map(|j| frames.position(j).coords));
                    assert!((bend([a, b, c].map(at)) - ours).abs() < 2e-4);
                }
            }
        }
    }
}

#[test]
fn on_our_own_hand_the_motion_is_our_own() {
    for names in JointNames::ALL {
        let clip = clip(&[Side::Left, Side::Right], 40);
        let rig = own_rig(&[Side::Right, Side::Left], names);
        let moved = put(&clip, &rig);
        assert_eq!(moved.sides, [Side::Left, Side::Right]);
        assert_gesture(&clip, &moved.glb, &|joint, side| names.name(joint, side, 2));
        for hand in &clip.hands {
            let side = hand.poses[0].1.side;
            let (time, pose) = &hand.poses[30];
            let frames = Skeleton::new(&hand.morphology, side).frames(pose);
            let world = world_transforms(&moved.glb, *time);
            for joint in Joint::ALL {
                // The same sizes: joints are not only alike but in the same places.
                let off =
                    world[&names.name(joint, side, 2)].translation.vector - frames.position(joint).coords;
                assert!(off.norm() < 1e-4, "{names:?} {}: {} m", joint.webxr_name(), off.norm());
            }
        }
    }
}

/// Joint angles read back out of a moved rig are those that moved it.
fn assert_read_back(clip: &Clip, glb: &[u8]) {
    let hands = import_poses(glb).unwrap();
    for hand in &hands {
        let truth = clip.hands.iter().find(|h| h.poses[0].1.side == hand.side).unwrap();
        assert_eq!(hand.poses.len(), truth.poses.len());
        for ((time, pose), (true_time, true_pose)) in hand.poses.iter().zip(&truth.poses) {
            assert!((time - true_time).abs() < 1e-6);
            assert!((pose.translation - true_pose.translation).norm() < 1e-4);
            assert!(pose.rotation.angle_to(&true_pose.rotation) < 1e-3);
            for angle in JointAngle::ALL {
                let off = (pose.angle(angle) - true_pose.angle(angle)).to_degrees().abs();
                assert!(off < 0.05, "{} at {time}: {off} degrees", angle.name());
            }
        }
    }
}

/// The rig with names that only a map tells, and the map.
fn strange_rig(rig: &[u8]) -> (Vec<u8>, JointMap) {
    let (length, mut json) = document(rig);
    let mut map = "hand = \"right\"\n[joints]\n".to_owned();
    for (i, joint) in Joint::ALL.into_iter().enumerate() {
        json["nodes"][i]["name"] = format!("bone {i}").into();
        json["nodes"][i].as_object_mut().unwrap().remove("extras");
        map += &format!("\"bone {i}\" = \"{}\"\n", joint.webxr_name());
    }
    (container(&json, &rig[28 + length..]), JointMap::parse(&map).unwrap())
}

#[test]
fn poses_come_back_from_a_moved_rig() {
    for names in [JointNames::WebXr, JointNames::Vrm] {
        let clip = clip(&[Side::Left, Side::Right], 25);
        let moved = put(&clip, &own_rig(&[Side::Left, Side::Right], names));
        assert_eq!(import_poses(&moved.glb).unwrap().len(), 2);
        assert_read_back(&clip, &moved.glb);
    }
    let clip = clip(&[Side::Right], 25);
    let (rig, map) = strange_rig(&own_rig(&[Side::Right], JointNames::WebXr));
    let moved = retarget(&clip, &rig, None, Some(&map), &ExportOptions::default()).unwrap();
    assert_eq!(import_poses(&moved.glb).unwrap().len(), 1);
    assert_read_back(&clip, &moved.glb);
    let told = import_poses(&rig).unwrap_err().to_string();
    assert!(told.contains("no hand that this program wrote or moved"), "{told}");
}

#[test]
fn a_wrist_on_an_arm_only_turns() {
    let rig = own_rig(&[Side::Right], JointNames::WebXr);
    let (length, mut json) = document(&rig);
    let nodes = json["nodes"].as_array_mut().unwrap();
    let arm = nodes.len();
    // A turned arm of twice the size.
    nodes.push(serde_json::json!({
        "name": "arm", "children": [0], "matrix": [0, 0, -2, 0, 0, 2, 0, 0, 2, 0, 0, 0, 5, 6, 7, 1]
    }));
    json["scenes"][0]["nodes"] = serde_json::json!([arm, arm - 1]);
    json["skins"].as_array_mut().unwrap().push(serde_json::json!({ "joints": [arm] }));
    let clip = clip(&[Side::Right], 30);
    let moved = put(&clip, &container(&json, &rig[28 + length..]));
    let (_, made) = document(&moved.glb);
    let channels = made["animations"][0]["channels"].as_array().unwrap();
    let paths = |node: usize| -> Vec<&str> {
        let of = |c: &&serde_json::Value| c["target"]["node"].as_u64() == Some(node as u64);
        channels.iter().filter(of).map(|c| c["target"]["path"].as_str().unwrap()).collect()
    };
    assert_eq!((paths(0), paths(arm)), (vec!["rotation"], vec![]));
    // Orientations in the world are ours: of the same rig without its arm, but for where the wrist is.
    let free = put(&clip, &rig);
    let fingers = |glb: &[u8]| -> Vec<serde_json::Value> {
        let (_, json) = document(glb);
        let all = json["animations"][0]["channels"].as_array().unwrap().clone();
        all.into_iter().filter(|c| c["target"]["node"] != 0).map(|c| c["target"].clone()).collect()
    };
    assert_eq!(fingers(&moved.glb), fingers(&free.glb), "fingers need no translations");
    json["nodes"][arm]["matrix"][0] = 1.into();
    let sheared =
        retarget(&clip, &container(&json, &rig[28 + length..]), None, None, &ExportOptions::default());
    assert!(sheared.unwrap_err().to_string().contains("scales that are not equal"));
}

/// A rig whose files lie side by side, and what names its joints.
struct Scattered {
    folder: tempfile::TempDir,
    rig: Vec<u8>,
    /// Lines of a map of joints.
    lines: String,
    map: JointMap,
}

impl Scattered {
    fn new(side: Side) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = scattered(&own_rig(&[side], JointNames::WebXr), folder.path());
        let line = |joint: Joint| format!("bone{} = \"{}\"\n", joint.index(), joint.webxr_name());
        let lines: String = Joint::ALL.into_iter().map(line).collect();
        let map = JointMap::parse(&format!("hand = \"{}\"\n[joints]\n{lines}", side.name())).unwrap();
        Self { rig: std::fs::read(path).unwrap(), folder, lines, map }
    }

    /// `clip` on the rig, its other files looked for in `folder`.
    fn moved(
        &self,
        clip: &Clip,
        folder: Option<&Path>,
        map: Option<&JointMap>,
    ) -> Result<Retargeted, GltfError> {
        retarget(clip, &self.rig, folder, map, &ExportOptions::default())
    }
}

/// The rig as a .gltf with its buffer and a picture beside it, its joints renamed.
fn scattered(glb: &[u8], folder: &Path) -> PathBuf {
    let (length, mut json) = document(glb);
    std::fs::write(folder.join("the data.bin"), &glb[28 + length..]).unwrap();
    image::RgbImage::from_pixel(2, 2, image::Rgb([9, 99, 199])).save(folder.join("skin.png")).unwrap();
    json["buffers"][0]["uri"] = "the%20data.bin".into();
    json["images"] = serde_json::json!([{ "uri": "skin.png" }]);
    json["textures"] = serde_json::json!([{ "source": 0 }]);
    json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = serde_json::json!({ "index": 0 });
    json["materials"][0]["extras"] = serde_json::json!({ "keep": "me" });
    for (i, node) in json["nodes"].as_array_mut().unwrap().iter_mut().enumerate() {
        node["name"] = format!("bone{i}").into();
    }
    let path = folder.join("rig.gltf");
    std::fs::write(&path, serde_json::to_vec(&json).unwrap()).unwrap();
    path
}

#[test]
fn a_map_names_the_joints_and_everything_is_embedded() {
    let rig = Scattered::new(Side::Left);
    let clip = clip(&[Side::Left], 30);
    let moved = rig.moved(&clip, Some(rig.folder.path()), Some(&rig.map)).unwrap();
    assert_gesture(&clip, &moved.glb, &|joint, _| format!("bone{}", joint.index()));
    let (_, json) = document(&moved.glb);
    assert_eq!(json["images"][0]["mimeType"], "image/png");
    assert!(json["images"][0]["uri"].is_null() && json["buffers"][0]["uri"].is_null());
    assert_eq!(json["materials"][0]["extras"]["keep"], "me");
    assert_eq!(json["animations"].as_array().unwrap().len(), 1);
    assert!(json["asset"]["generator"].as_str().unwrap().starts_with("handcast "));
}

#[test]
#[ignore = "needs Node and npm ci --prefix tests/node"]
fn the_validator_finds_nothing_in_what_was_embedded() {
    let rig = Scattered::new(Side::Left);
    let moved = rig.moved(&clip(&[Side::Left], 30), Some(rig.folder.path()), Some(&rig.map)).unwrap();
    let made = rig.folder.path().join("made.glb");
    std::fs::write(&made, &moved.glb).unwrap();
    let output = node("validate.js", &[&made]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
fn wrong_maps_and_missing_files_are_named() {
    let rig = Scattered::new(Side::Left);
    let clip = clip(&[Side::Left], 30);
    let inside = Some(rig.folder.path());
    let run = |folder: Option<&Path>, map: Option<&JointMap>| -> String {
        rig.moved(&clip, folder, map).unwrap_err().to_string()
    };
    let mapped = |map: &str| run(inside, Some(&JointMap::parse(map).unwrap()));
    assert!(run(inside, None).contains("no hand found"));
    assert!(run(None, Some(&rig.map)).contains("\"the data.bin\""));
    assert!(mapped("[left]\nbone99 = \"wrist\"").contains("no node is named \"bone99\""));
    assert!(mapped("[left]\nbone0 = \"wrist\"").contains("no joint is the index-finger-phalanx"));
    assert!(mapped(&format!("hand = \"right\"\n[joints]\n{}", rig.lines)).contains("a right one"));
    std::fs::write(rig.folder.path().join("the data.bin"), [0; 64]).unwrap();
    assert!(run(inside, Some(&rig.map)).contains("64 bytes"));
}

const RIGS: [(&str, Side); 4] = [
    ("webxr-left.glb", Side::Left),
    ("webxr-right.glb", Side::Right),
    ("openxr-left.gltf", Side::Left),
    ("openxr-right.gltf", Side::Right),
];

/// The name a joint has in one of them.
fn name_in(file: &str, joint: Joint, side: Side) -> String {
    if file.starts_with("webxr") {
        joint.webxr_name().into()
    } else {
        JointNames::OpenXr.name(joint, side, 1)
    }
}

#[test]
#[ignore = "needs the shared material"]
fn rigs_made_elsewhere_make_the_same_gesture_and_keep_their_sizes() {
    let meshes = shared("data/meshes");
    for (file, side) in RIGS {
        let rig = std::fs::read(meshes.join(file)).unwrap();
        let both = clip(&[Side::Left, Side::Right], 40);
        let moved = put(&both, &rig);
        assert_eq!(moved.sides, [side], "{file}: its side is told");
        let clip = clip(&[side], 40);
        let moved = put(&clip, &rig);
        assert_gesture(&clip, &moved.glb, &|joint, side| name_in(file, joint, side));
        assert_read_back(&clip, &moved.glb);
        // Distances of neighbouring joints are those of the rig, in every frame.
        let (a, b) = (world_transforms(&moved.glb, 0.0), world_transforms(&moved.glb, 1.2));
        for joint in Joint::ALL {
            let Some(above) = joint.parent() else { continue };
            let length = |world: &std::collections::HashMap<String, nalgebra::Isometry3<f64>>| {
                let at = |j: Joint| world[&name_in(file, j, side)].translation.vector;
                (at(joint) - at(above)).norm()
            };
            assert!((length(&a) - length(&b)).abs() < 1e-5, "{file}: {}", joint.webxr_name());
        }
    }
}

#[test]
#[ignore = "needs the shared material and npm ci --prefix tests/node"]
fn the_validator_finds_nothing_new_in_rigs_made_elsewhere() {
    let meshes = shared("data/meshes");
    let folder = tempfile::tempdir().unwrap();
    let mut made = Vec::new();
    for (file, side) in RIGS {
        let moved = put(&clip(&[side], 40), &std::fs::read(meshes.join(file)).unwrap());
        let path = folder.path().join(format!("{file}.glb"));
        std::fs::write(&path, &moved.glb).unwrap();
        // The validator takes GLB and glTF alike; the source may have warnings of its own.
        made.push(format!("{}<{}", path.display(), meshes.join(file).display()));
    }
    let made: Vec<&Path> = made.iter().map(Path::new).collect();
    let output = node("validate.js", &made);
    println!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
#[ignore = "needs the shared material"]
fn weights_that_do_not_add_up_are_named() {
    let rig = std::fs::read(shared("data/meshes/x-invalid-weights.glb")).unwrap();
    let error = retarget(&clip(&[Side::Right], 3), &rig, None, None, &ExportOptions::default());
    let message = error.unwrap_err().to_string();
    for words in ["weights not normalised", "vertex 10", "add up to 0", "allowed 1 ± "] {
        assert!(message.contains(words), "{message}");
    }
}

#[test]
fn damaged_rigs_are_refused_or_used_but_never_panic() {
    let clip = clip(&[Side::Right], 3);
    let rig = own_rig(&[Side::Right], JointNames::WebXr);
    let options = ExportOptions::default();
    for n in (0..rig.len()).step_by(1999) {
        assert!(retarget(&clip, &rig[..n], None, None, &options).is_err());
    }
    let moved = put(&clip, &rig).glb;
    let mut state = 7u64;
    for round in 0..300 {
        let file = if round % 2 == 0 { &rig } else { &moved };
        let (length, _) = document(file);
        let mut bytes = file.clone();
        for _ in 0..2 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let at = 20 + (state >> 33) as usize % length;
            // Digits into other digits: numbers, indices and offsets go wrong, the text stays JSON.
            if let Some(k) = (at..20 + length).find(|&k| bytes[k].is_ascii_digit()) {
                bytes[k] = b'0' + (state >> 20) as u8 % 10;
            }
        }
        let _ = retarget(&clip, &bytes, None, None, &options);
        let _ = import_poses(&bytes);
    }
}
