//! Motions on rigs made elsewhere.

use std::path::{Path, PathBuf};

use crate::common::glb::{clip, container, document, node, world_transforms};
use crate::common::shared;
use handcast_gltf::{
    Clip, ExportOptions, GltfError, ImportOptions, Imported, ImportedHand, JointMap, JointNames, NodeAxes,
    Retargeted, RigError, check_rig, export, import, import_poses, retarget,
};
use handcast_hand::{Finger, HandPose, Joint, JointAngle, Side, Skeleton};
use handcast_limits::Limits;
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};

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
    assert!(told.contains("no hand found: joints are named \"bone 0\""), "{told}");
    assert!(told.contains("and 9 more; a joint map says"), "{told}");
}

/// A file as other programs would have written it: without anything that says where it comes from.
fn stripped(glb: &[u8]) -> Vec<u8> {
    changed(glb, |json| {
        json["asset"] = json!({ "version": "2.0" });
        for node in json["nodes"].as_array_mut().unwrap() {
            node.as_object_mut().unwrap().remove("extras");
        }
    })
}

/// How far joint angles and the wrist's turn are off at most, degrees.
fn worst(clip: &Clip, hands: &[ImportedHand]) -> f64 {
    let mut worst = 0.0f64;
    assert_eq!(hands.len(), clip.hands.len());
    for hand in hands {
        let truth = clip.hands.iter().find(|h| h.poses[0].1.side == hand.side).unwrap();
        assert_eq!(hand.poses.len(), truth.poses.len());
        for ((time, pose), (true_time, true_pose)) in hand.poses.iter().zip(&truth.poses) {
            assert!((time - true_time).abs() < 1e-6);
            worst = worst.max(pose.rotation.angle_to(&true_pose.rotation));
            for angle in &hand.angles {
                worst = worst.max((pose.angle(*angle) - true_pose.angle(*angle)).abs());
            }
        }
    }
    worst.to_degrees()
}

fn read(glb: &[u8]) -> Imported {
    import(glb, &ImportOptions::default()).unwrap()
}

#[test]
fn rigs_of_any_program_are_read_by_their_names() {
    let clip = clip(&[Side::Left, Side::Right], 25);
    for names in JointNames::ALL {
        let rig = own_rig(&[Side::Left, Side::Right], names);
        let theirs = stripped(&put(&clip, &rig).glb);
        let found = read(&theirs);
        let off = worst(&clip, &found.hands);
        println!("{names:?}: {off:.1e}°");
        assert!(off < 1e-3, "{names:?}: {off}°");
        assert!(found.placed);
        assert!(
            found
                .notes
                .iter()
                .any(|note| note.contains("left hand are measured on the rig at rest: 180 mm long"))
        );
        for (hand, truth) in found.hands.iter().zip(&clip.hands) {
            // The sizes are the rig's, so that joints are where it has them.
            let [ours, theirs] = [&truth.morphology, hand.morphology.as_ref().unwrap()]
                .map(|sizes| Skeleton::new(sizes, hand.side).frames(&hand.poses[20].1));
            for joint in Joint::ALL {
                let apart = (ours.position(joint) - theirs.position(joint)).norm();
                assert!(apart < 1e-4, "{}: {apart} m", joint.webxr_name());
            }
        }
        // Steps hold each pose to the next.
        let steps = changed(&theirs, |json| {
            for sampler in json["animations"][0]["samplers"].as_array_mut().unwrap() {
                sampler["interpolation"] = "STEP".into();
            }
        });
        assert!(worst(&clip, &read(&steps).hands) < 1e-3);
        // Scales that keep still, and an animation of something else before it.
        let scaled = changed(&theirs, |json| {
            let animation = json["animations"][0].clone();
            let path = |channel: &Value| channel["target"]["path"] == "translation";
            let channel = animation["channels"].as_array().unwrap().iter().find(|c| path(c)).unwrap();
            let mut scale = json["nodes"][0].clone();
            scale["name"] = "Lamp".into();
            scale.as_object_mut().unwrap().remove("children");
            let lamp = json["nodes"].as_array().unwrap().len();
            json["nodes"].as_array_mut().unwrap().push(scale);
            let mut channel = channel.clone();
            channel["target"]["node"] = lamp.into();
            let other = json!({ "name": "lamp", "channels": [channel], "samplers": animation["samplers"] });
            json["animations"] = json!([other, animation]);
        });
        let found = read(&scaled);
        assert!(worst(&clip, &found.hands) < 1e-3);
        assert!(found.notes.iter().any(|note| note.contains("animation 2 of 2")), "{:?}", found.notes);
    }
}

/// The file with a further track in its animation, of keys at `times`.
fn with_track(glb: &[u8], nodes: &[usize], path: &str, times: &[f32], rows: &[&[f32]]) -> Vec<u8> {
    let (length, mut json) = document(glb);
    let mut chunk = glb[28 + length..].to_vec();
    let mut accessor = |numbers: &[f32], count: usize, kind: &str| {
        let view = json["bufferViews"].as_array().unwrap().len();
        let view_of = json!({ "buffer": 0, "byteOffset": chunk.len(), "byteLength": 4 * numbers.len() });
        json["bufferViews"].as_array_mut().unwrap().push(view_of);
        chunk.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        let accessors = json["accessors"].as_array_mut().unwrap();
        accessors.push(json!({ "bufferView": view, "componentType": 5126, "count": count, "type": kind }));
        accessors.len() - 1
    };
    let input = accessor(times, times.len(), "SCALAR");
    let output = accessor(&rows.concat(), rows.len(), if rows[0].len() == 4 { "VEC4" } else { "VEC3" });
    json["buffers"][0]["byteLength"] = chunk.len().into();
    let animation = &mut json["animations"][0];
    let samplers = animation["samplers"].as_array_mut().unwrap();
    samplers.push(json!({ "input": input, "output": output }));
    let sampler = samplers.len() - 1;
    for node in nodes {
        let channel = json!({ "sampler": sampler, "target": { "node": node, "path": path } });
        animation["channels"].as_array_mut().unwrap().push(channel);
    }
    container(&json, &chunk)
}

/// Scales that a file has for each of its bones, as those of Blender do.
#[test]
fn scales_that_keep_still_are_taken_and_others_refused() {
    let clip = clip(&[Side::Right], 5);
    let theirs = stripped(&put(&clip, &own_rig(&[Side::Right], JointNames::Mixamo)).glb);
    let joints: Vec<usize> = (0..25).collect();
    let with = |scale: [f32; 3]| with_track(&theirs, &joints, "scale", &[0.0], &[&scale]);
    assert!(worst(&clip, &read(&with([1.0; 3])).hands) < 1e-3);
    let refused = import_poses(&with([1.0, 2.0, 1.0])).unwrap_err().to_string();
    assert!(refused.contains("scaled by amounts that are not equal"), "{refused}");
}

#[test]
fn joints_scaled_by_nothing_are_refused_in_words() {
    let clip = clip(&[Side::Right], 5);
    let ours = export(&clip, &ExportOptions::default()).unwrap();
    let scaled = |scale: f32| with_track(&ours, &[0], "scale", &[0.0], &[&[scale; 3]]);
    let message = import_poses(&scaled(0.0)).unwrap_err().to_string();
    assert!(message.contains("node 0 (\"wrist\") is scaled by amounts that are not equal"), "{message}");
    assert!(worst(&clip, &import_poses(&scaled(1.0)).unwrap()) < 1e-3);
    // A tip carries nothing.
    let theirs = stripped(&put(&clip, &own_rig(&[Side::Right], JointNames::Mixamo)).glb);
    for glb in [&ours, &theirs] {
        let tip = with_track(glb, &[Joint::IndexTip.index()], "scale", &[0.0], &[&[1.0, 0.0, 2.0]]);
        assert!(worst(&clip, &import_poses(&tip).unwrap()) < 1e-3);
    }
}

/// Each a little above nothing, together nothing that numbers tell.
#[test]
fn scales_within_one_another_that_vanish_are_refused() {
    let clip = clip(&[Side::Right], 5);
    let within = |glb: &[u8], scale: f64, count: usize| {
        let mut top = 0;
        let glb = changed(glb, |json| {
            for _ in 0..count {
                top = put_above(json, &[top], json!({ "scale": vec![scale; 3] }));
            }
        });
        (glb, top)
    };
    let rig = own_rig(&[Side::Right], JointNames::Mixamo);
    let message = wrong(&within(&rig, 0.0, 40).0, None);
    assert!(message.contains("is scaled by less than 1e-30 in all"), "{message}");
    let theirs = stripped(&put(&clip, &rig).glb);
    assert!(import_poses(&within(&theirs, 0.0, 40).0).unwrap_err().to_string().contains("less than 1e-30"));
    let (moved, top) = within(&theirs, 1.0, 5);
    let nodes: Vec<usize> = (top - 4..=top).collect();
    let moved = with_track(&moved, &nodes, "scale", &[0.0], &[&[1e-8; 3]]);
    assert!(import_poses(&moved).unwrap_err().to_string().contains("less than 1e-30"));
}

#[test]
fn channels_are_one_for_each_way_to_move_and_their_keys_are_counted() {
    let clip = clip(&[Side::Left, Side::Right], 5);
    let theirs = stripped(&put(&clip, &own_rig(&[Side::Left, Side::Right], JointNames::Mixamo)).glb);
    let joints: Vec<usize> = (0..52).collect();
    let times: Vec<f32> = (0..3000).map(|k| k as f32 / 100.0).collect();
    let rows = vec![&[1.0f32; 3][..]; times.len()];
    let scaled = with_track(&theirs, &joints, "scale", &times, &rows);
    let options = |instants: u64| {
        let mut options = ImportOptions::default();
        options.limits = options.limits.with_instants(instants);
        options
    };
    assert!(import(&scaled, &options(3010)).is_ok());
    let wrists = moved_nodes(&theirs, "translation");
    let others: Vec<usize> = (0..52).filter(|node| !wrists.contains(&(*node as u64))).collect();
    let both = with_track(&scaled, &others, "translation", &times, &rows);
    import(&both, &options(110_000)).unwrap();
    let message = import(&both, &options(3010)).unwrap_err().to_string();
    assert!(message.contains("keys in the channels of an animation, allowed at most"), "{message}");
    let twice = with_track(&scaled, &[3], "scale", &[0.0], &[&[1.0; 3]]);
    let message = import_poses(&twice).unwrap_err().to_string();
    assert!(message.contains("two channels scale node 3, allowed is one"), "{message}");
}

#[test]
fn the_animation_that_turns_a_hand_is_read() {
    let clip = clip(&[Side::Right], 5);
    let theirs = stripped(&put(&clip, &own_rig(&[Side::Right], JointNames::Mixamo)).glb);
    for path in ["translation", "weights"] {
        let with = changed(&with_track(&theirs, &[0], path, &[0.0], &[&[0.0; 3]]), |json| {
            let animation = json["animations"][0].clone();
            let (channels, samplers) = (&animation["channels"], &animation["samplers"]);
            let last = |list: &Value| list.as_array().unwrap().last().unwrap().clone();
            let (mut channel, sampler) = (last(channels), last(samplers));
            channel["sampler"] = 0.into();
            json["animations"][0]["channels"].as_array_mut().unwrap().pop();
            json["animations"]
                .as_array_mut()
                .unwrap()
                .insert(0, json!({ "name": "x".repeat(99), "channels": [channel], "samplers": [sampler] }));
        });
        let found = read(&with);
        assert!(worst(&clip, &found.hands) < 1e-3, "{path}");
        assert!(found.notes.iter().any(|note| note.contains("animation 2 of 2")), "{:?}", found.notes);
    }
}

/// Of two hands of ours another program has renamed a joint.
#[test]
fn a_hand_that_was_changed_is_not_left_out_without_a_word() {
    let clip = clip(&[Side::Left, Side::Right], 5);
    let ours = export(&clip, &ExportOptions::default()).unwrap();
    let renamed = |from: Joint, to: &str| {
        let from = JointNames::default().name(from, Side::Left, 2);
        changed(&ours, |json| rename(json, |name| if name == from { to.into() } else { name.into() }))
    };
    let found = import(&renamed(Joint::IndexTip, "fingertip"), &ImportOptions::default()).unwrap();
    assert!(found.hands.len() == 2 && worst(&clip, &found.hands) < 1e-3);
    let found = import(&renamed(Joint::IndexProximal, "knuckle"), &ImportOptions::default()).unwrap();
    assert_eq!(found.hands.len(), 1);
    let told = found.notes.iter().any(|note| note.contains("left hand: no joint is the index-finger"));
    assert!(told, "{:?}", found.notes);
}

/// Meshes matter to poses only for what is visible.
#[test]
fn meshes_that_lie_beyond_the_file_are_passed_over() {
    let clip = clip(&[Side::Right], 5);
    let theirs = stripped(&put(&clip, &own_rig(&[Side::Right], JointNames::Mixamo)).glb);
    for (list, field, number) in [
        ("accessors", "count", 1u64 << 62),
        ("accessors", "byteOffset", u64::MAX - 8),
        ("bufferViews", "byteOffset", u64::MAX - 8),
    ] {
        let damaged = changed(&theirs, |json| {
            let mut at = json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"].as_u64().unwrap();
            if list == "bufferViews" {
                at = json["accessors"][at as usize]["bufferView"].as_u64().unwrap();
            }
            json[list][at as usize][field] = number.into();
        });
        let read = import_poses(&damaged);
        assert!(worst(&clip, &read.unwrap()) < 1e-3, "{list} {field}");
    }
}

#[test]
fn a_camera_goes_along_with_a_body_that_walks() {
    let clip = clip(&[Side::Left, Side::Right], 26);
    let upright = body(UnitQuaternion::identity());
    let node = |name: &str| {
        let (_, json) = document(&upright);
        json["nodes"].as_array().unwrap().iter().position(|node| node["name"] == name).unwrap()
    };
    let walking = stripped(&put(&clip, &upright).glb);
    let steps = [[0.0, 1.0, 0.0], [0.3, 1.0, 2.0f32]];
    let rows: Vec<&[f32]> = steps.iter().map(|row| row.as_slice()).collect();
    let walking = with_track(&walking, &[node("mixamorig:Hips")], "translation", &[0.0, 1.0], &rows);
    // Arms that rest are carried along, and say nothing.
    let found = read(&walking);
    assert!(!found.placed && worst(&clip, &found.hands) < 1e-3);
    let turned = UnitQuaternion::from_scaled_axis(Vector3::new(0.2, 0.1, 0.5));
    let turns = [UnitQuaternion::identity(), turned].map(|turn| <[f32; 4]>::from(turn.coords.cast::<f32>()));
    let rows: Vec<&[f32]> = turns.iter().map(|row| row.as_slice()).collect();
    let waving = with_track(&walking, &[node("mixamorig:LeftForeArm")], "rotation", &[0.0, 1.0], &rows);
    let found = read(&waving);
    assert!(found.placed && found.notes.iter().any(|note| note.contains("a camera 1.5 m before the hips")));
    for (hand, track) in found.hands.iter().zip(&clip.hands) {
        let ((_, pose), (_, truth)) = (&hand.poses[25], &track.poses[25]);
        let (arm, x) =
            if hand.side == Side::Left { (turned, 1.0) } else { (UnitQuaternion::identity(), -1.0) };
        assert!(pose.rotation.angle_to(&(arm * truth.rotation)) < 1e-5);
        let place = Vector3::new(0.4 * x, 0.4, -1.5) + arm * Vector3::new(0.25 * x, -0.1, 0.05);
        assert!((pose.translation - place).norm() < 1e-5, "{} {place}", pose.translation);
        for angle in JointAngle::ALL {
            assert!((pose.angle(angle) - truth.angle(angle)).abs() < 1e-5, "{}", angle.name());
        }
    }
}

/// Nodes stand as in the first frame: skins say how joints rest.
#[test]
fn joints_that_stand_posed_rest_as_their_skin_is_bound() {
    let clip = clip(&[Side::Left, Side::Right], 30);
    for (axes, quantize) in [(NodeAxes::Bones, false), (NodeAxes::WebXr, true)] {
        let mut options = ExportOptions::default();
        (options.texture, options.axes, options.quantize) = (None, axes, quantize);
        let found = read(&stripped(&export(&clip, &options).unwrap()));
        let off = worst(&clip, &found.hands);
        assert!(off < if quantize { 0.01 } else { 0.001 }, "{axes:?}: {off}°");
        for hand in &found.hands {
            let length = hand.morphology.as_ref().unwrap().hand_length;
            assert!((length - 0.18).abs() < 1e-4, "{length} m");
        }
    }
}

/// A further skin, of one finger, is bound in another pose.
#[test]
fn a_hand_rests_as_one_skin_is_bound() {
    let clip = clip(&[Side::Right], 30);
    let mut options = ExportOptions::default();
    options.texture = None;
    let two = changed(&stripped(&export(&clip, &options).unwrap()), |json| {
        let of_index = &json["skins"][0]["joints"].as_array().unwrap()[Joint::IndexMetacarpal.index()..][..5];
        let skin =
            json!({ "joints": of_index, "inverseBindMatrices": json["skins"][0]["inverseBindMatrices"] });
        json["skins"].as_array_mut().unwrap().push(skin);
    });
    let off = worst(&clip, &read(&two).hands);
    assert!(off < 1e-3, "{off}°");
    // A tip that the skin lacks keeps still on the bone before it.
    let bare = changed(&stripped(&export(&clip, &options).unwrap()), |json| {
        json["meshes"] = json!([]);
        json["nodes"].as_array_mut().unwrap().iter_mut().for_each(|node| {
            let node = node.as_object_mut().unwrap();
            let _ = (node.remove("mesh"), node.remove("skin"));
        });
        let tip = json["skins"][0]["joints"].as_array_mut().unwrap().pop().unwrap();
        json["skins"].as_array_mut().unwrap().push(json!({ "joints": [tip] }));
    });
    let off = worst(&clip, &read(&bare).hands);
    assert!(off < 1e-3, "{off}°");
}

/// What moved a rig comes back whatever pose its nodes stand in.
#[test]
fn rigs_that_stand_posed_are_read_back() {
    let moving = clip(&[Side::Right], 40);
    let mut posed = moving.clone();
    posed.hands[0].poses.drain(..30);
    let mut options = ExportOptions::default();
    (options.texture, options.names) = (None, JointNames::OpenXr);
    let rig = export(&posed, &options).unwrap();
    let off = worst(&moving, &read(&put(&moving, &rig).glb).hands);
    assert!(off < 1e-3, "{off}°");
}

/// A palm of other proportions than the mean hand's must not twist knuckles at right angles.
#[test]
fn another_persons_fist_keeps_its_fingers_straight() {
    let mut clip = clip(&[Side::Right], 2);
    let track = &mut clip.hands[0];
    for finger in [Finger::Index, Finger::Ring, Finger::Pinky] {
        track.morphology.fingers[finger as usize].base[1] *= 0.97;
    }
    track.morphology.fingers[Finger::Middle as usize].base[0] += 0.002;
    let fist = |k: usize| {
        let mut pose = HandPose::neutral(Side::Right);
        Finger::LONG.into_iter().for_each(|finger| pose.set(finger.base_flexion(), 0.04 * k as f64));
        (0.04 * k as f64, pose)
    };
    track.poses = (0..=40).map(fist).collect();
    let found = read(&stripped(&put(&clip, &own_rig(&[Side::Right], JointNames::OpenXr)).glb));
    for ((_, pose), (_, truth)) in found.hands[0].poses.iter().zip(&clip.hands[0].poses) {
        for angle in JointAngle::ALL {
            let off = (pose.angle(angle) - truth.angle(angle)).to_degrees();
            assert!(off.abs() < 6.0, "{}: {off}°", angle.name());
        }
    }
}

/// Bones that other programs keep apart lose no angle, and what the rig has no bone for is not claimed.
#[test]
fn what_a_rig_has_no_bone_for_is_told_and_not_claimed() {
    let clip = clip(&[Side::Right], 25);
    let lacks = |name: &str| name.contains("Metacarpal") && !name.contains("Thumb") || name.ends_with("Tip");
    let rig = changed(&own_rig(&[Side::Right], JointNames::Vrm), |json| {
        rename(json, |name| if lacks(name) { format!("x{}", name.len()) } else { name.into() });
    });
    let moved = put(&clip, &rig);
    let [lacking] = moved.lacking.as_slice() else { panic!("{:?}", moved.lacking) };
    assert!(lacking.contains("no bone of its own for pinky0_flexion (up to 4°)"), "{lacking}");
    for glb in [moved.glb.clone(), stripped(&moved.glb)] {
        let found = read(&glb);
        let hand = &found.hands[0];
        assert_eq!(hand.angles.len(), JointAngle::COUNT - 4);
        assert!(!hand.angles.contains(&JointAngle::Pinky0Flexion));
        let (_, truth) = &clip.hands[0].poses[20];
        let off = (hand.poses[20].1.angle(JointAngle::Index2Flexion)
            - truth.angle(JointAngle::Index2Flexion))
        .abs();
        assert!(off < 1e-4, "{off}");
    }
}

/// The nodes of a file in another order.
fn renumbered(glb: &[u8]) -> Vec<u8> {
    changed(glb, |json| {
        let nodes = json["nodes"].as_array_mut().unwrap();
        let last = nodes.len() as u64 - 1;
        nodes.reverse();
        let turn = |number: &mut Value| *number = (last - number.as_u64().unwrap()).into();
        let all = |list: &mut Value| list.as_array_mut().into_iter().flatten().for_each(turn);
        json["nodes"].as_array_mut().unwrap().iter_mut().for_each(|node| {
            if let Some(children) = node.get_mut("children") {
                all(children);
            }
        });
        json["scenes"].as_array_mut().unwrap().iter_mut().for_each(|scene| all(&mut scene["nodes"]));
        for skin in json["skins"].as_array_mut().unwrap() {
            all(&mut skin["joints"]);
            skin.as_object_mut().unwrap().remove("skeleton");
        }
        for channel in json["animations"][0]["channels"].as_array_mut().unwrap() {
            turn(&mut channel["target"]["node"]);
        }
    })
}

#[test]
fn nodes_that_another_program_numbered_anew_are_found_by_name() {
    let clip = clip(&[Side::Left, Side::Right], 10);
    for names in [JointNames::WebXr, JointNames::Mixamo] {
        let moved = put(&clip, &own_rig(&[Side::Left, Side::Right], names)).glb;
        assert!(worst(&clip, &read(&renumbered(&moved)).hands) < 1e-3, "{names:?}");
    }
    // By a map alone: the file says what they are called.
    let one = self::clip(&[Side::Right], 10);
    let (rig, map) = strange_rig(&own_rig(&[Side::Right], JointNames::WebXr));
    let moved = retarget(&one, &rig, None, Some(&map), &ExportOptions::default()).unwrap().glb;
    assert!(worst(&one, &read(&renumbered(&moved)).hands) < 1e-3);
    // And of a file that says nothing by a map.
    let mut options = ImportOptions::default();
    options.map = Some(&map);
    let found = import(&stripped(&renumbered(&moved)), &options).unwrap();
    assert!(worst(&one, &found.hands) < 1e-3);
}

#[test]
fn a_pose_that_keeps_still_keeps_its_rate_and_its_end() {
    let mut still = clip(&[Side::Right], 300);
    let (_, pose) = still.hands[0].poses[40].clone();
    still.hands[0].poses.iter_mut().for_each(|(_, p)| *p = pose.clone());
    still.rate = Some(25.0);
    let rig = own_rig(&[Side::Right], JointNames::Mixamo);
    // Also where the pose is that of the rig at rest.
    let mut rest = still.clone();
    let (_, at_rest) = import_poses(&rig).unwrap()[0].poses[0].clone();
    rest.hands[0].poses.iter_mut().for_each(|(_, p)| *p = at_rest.clone());
    for clip in [still, rest] {
        let found = read(&put(&clip, &rig).glb);
        assert_eq!(found.rate, Some(25.0));
        let times: Vec<f64> = found.hands[0].poses.iter().map(|(time, _)| *time).collect();
        assert_eq!((times[0], times[times.len() - 1]), (0.0, 11.96));
        assert!(times.len() < 10, "{times:?}");
    }
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

/// The document of a rig, changed.
fn changed(rig: &[u8], change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let (length, mut json) = document(rig);
    change(&mut json);
    container(&json, &rig[28 + length..])
}

fn rename(json: &mut Value, name: impl Fn(&str) -> String) {
    for node in json["nodes"].as_array_mut().unwrap() {
        node["name"] = name(node["name"].as_str().unwrap_or_default()).into();
    }
}

/// A node above `below`, all of them at the top of the scene before.
fn put_above(json: &mut Value, below: &[usize], mut node: Value) -> usize {
    let number = json["nodes"].as_array().unwrap().len();
    node["children"] = json!(below);
    json["nodes"].as_array_mut().unwrap().push(node);
    let top = json["scenes"][0]["nodes"].as_array_mut().unwrap();
    top.retain(|node| !below.contains(&(node.as_u64().unwrap() as usize)));
    top.push(number.into());
    number
}

fn wrong(rig: &[u8], map: Option<&str>) -> String {
    let map = map.map(|map| JointMap::parse(map).unwrap());
    let moved = retarget(&clip(&[Side::Right], 3), rig, None, map.as_ref(), &ExportOptions::default());
    moved.unwrap_err().to_string()
}

/// Nodes that the animation moves this way.
fn moved_nodes(glb: &[u8], path: &str) -> Vec<u64> {
    let (_, json) = document(glb);
    let channels = json["animations"][0]["channels"].as_array().unwrap().iter();
    let of_path = channels.filter(|channel| channel["target"]["path"] == path);
    of_path.map(|channel| channel["target"]["node"].as_u64().unwrap()).collect()
}

/// The thumb's bones as Unity and VRM 0 call them.
fn unity(name: &str) -> String {
    name.replace("ThumbProximal", "ThumbIntermediate").replace("ThumbMetacarpal", "ThumbProximal")
}

#[test]
fn thumbs_of_unity_make_the_same_gesture() {
    let clip = clip(&[Side::Left, Side::Right], 20);
    let rig = changed(&own_rig(&[Side::Left, Side::Right], JointNames::Vrm), |json| rename(json, unity));
    let moved = put(&clip, &rig);
    assert_gesture(&clip, &moved.glb, &|joint, side| unity(&JointNames::Vrm.name(joint, side, 2)));
    let headless = changed(&own_rig(&[Side::Right], JointNames::Mixamo), |json| {
        rename(json, |name| name.replace("HandThumb1", "x"));
    });
    assert!(wrong(&headless, None).contains("no joint is the thumb-metacarpal"));
    // Beside a whole hand it is left out, which is said; a map may have a thumb of two bones.
    let one_whole = changed(&own_rig(&[Side::Left, Side::Right], JointNames::Mixamo), |json| {
        rename(json, |name| name.replace("RightHandThumb1", "x"));
    });
    let notes = put(&clip, &one_whole).notes;
    assert!(
        notes.iter().any(|note| note.contains("right hand: no joint is the thumb-metacarpal")),
        "{notes:?}"
    );
    let (rig, _) = strange_rig(&own_rig(&[Side::Right], JointNames::WebXr));
    let line = |joint: Joint| format!("\"#{}\" = \"{}\"\n", joint.index(), joint.webxr_name());
    let two = Joint::ALL.into_iter().filter(|joint| *joint != Joint::ThumbMetacarpal).map(line);
    let map = format!("hand = \"right\"\n[joints]\n{}", two.collect::<String>());
    let map = JointMap::parse(&map).unwrap();
    assert!(retarget(&clip, &rig, None, Some(&map), &ExportOptions::default()).is_ok());
}

#[test]
fn what_an_avatar_says_of_its_bones_comes_before_names() {
    let clip = clip(&[Side::Left, Side::Right], 20);
    let own = own_rig(&[Side::Left, Side::Right], JointNames::Vrm);
    // Bones have misleading names, or none that tells.
    let shuffled = |joint: Joint, side: Side| format!("mixamorig:{}Hand{}", side.name(), 30 + joint.index());
    for version in 0..2 {
        let avatar = |count: usize| {
            changed(&own, |json| {
                let nodes = json["nodes"].as_array_mut().unwrap();
                let names: Vec<String> =
                    nodes.iter().map(|n| n["name"].as_str().unwrap_or_default().to_owned()).collect();
                let known =
                    |name: &String| !name.contains("Tip") && name.contains("ight") | name.contains("eft");
                let bones = names.iter().enumerate().filter(|(_, name)| known(name));
                let bones: Vec<(usize, &String)> = bones.take(count).collect();
                json["extensions"] = if version == 0 {
                    let bone = |(node, name): &(usize, &String)| json!({ "bone": unity(name), "node": node });
                    let bones: Vec<Value> = bones.iter().map(bone).collect();
                    json!({ "VRM": { "humanoid": { "humanBones": bones } } })
                } else {
                    let bones: serde_json::Map<_, _> =
                        bones.iter().map(|(node, name)| ((*name).clone(), json!({ "node": node }))).collect();
                    json!({ "VRMC_vrm": { "humanoid": { "humanBones": bones } } })
                };
                for (joint, side) in
                    [Side::Left, Side::Right].into_iter().flat_map(|s| Joint::ALL.map(|j| (j, s)))
                {
                    let name = JointNames::Vrm.name(joint, side, 2);
                    let node = names.iter().position(|n| *n == name).unwrap();
                    let tip = name.contains("Tip");
                    json["nodes"][node]["name"] = if tip { name } else { shuffled(joint, side) }.into();
                }
            })
        };
        let moved = put(&clip, &avatar(usize::MAX));
        assert_gesture(&clip, &moved.glb, &|joint, side| {
            let name = JointNames::Vrm.name(joint, side, 2);
            if name.contains("Tip") { name } else { shuffled(joint, side) }
        });
        assert!(worst(&clip, &read(&stripped(&moved.glb)).hands) < 1e-3);
        assert!(wrong(&avatar(3), None).contains("no joint is the"));
    }
    let beyond = changed(&own, |json| {
        json["extensions"] =
            json!({ "VRM": { "humanoid": { "humanBones": [{ "bone": "head", "node": 999 }] } } });
    });
    let notes = put(&clip, &beyond).notes;
    assert!(notes.iter().any(|note| note.contains("bone \"head\" of the avatar is node 999")), "{notes:?}");
}

#[test]
fn tolerances_are_metres_of_the_world_at_any_scale() {
    let clip = clip(&[Side::Right], 60);
    let rig = own_rig(&[Side::Right], JointNames::WebXr);
    let mut options = ExportOptions::default();
    options.rotation_tolerance = 0.004;
    options.translation_tolerance = 0.0004;
    let keys = |scale: f64| -> usize {
        let scaled = changed(&rig, |json| {
            for number in json["nodes"]
                .as_array_mut()
                .unwrap()
                .iter_mut()
                .flat_map(|n| n["translation"].as_array_mut())
                .flatten()
            {
                *number = (number.as_f64().unwrap() / scale).into();
            }
            put_above(json, &[0], json!({ "name": "Armature", "scale": [scale, scale, scale] }));
        });
        let moved = retarget(&clip, &scaled, None, None, &options).unwrap();
        assert_eq!(moved.notes, [""; 0]);
        for (time, pose) in &clip.hands[0].poses {
            let off =
                world_transforms(&moved.glb, *time)["wrist"].translation.vector * scale - pose.translation;
            assert!(off.norm() < 0.00041, "scale {scale}: {} m", off.norm());
        }
        let theirs = &read(&stripped(&moved.glb)).hands[0];
        let length = theirs.morphology.as_ref().unwrap().hand_length;
        assert!((length - 0.18).abs() < 1e-5, "scale {scale}: {length} m");
        assert!((theirs.poses[0].1.translation - clip.hands[0].poses[0].1.translation).norm() < 1e-5);
        // Fingers stay where they rest.
        assert_eq!(moved_nodes(&moved.glb, "translation"), [0]);
        let (_, json) = document(&moved.glb);
        let channels = json["animations"][0]["channels"].as_array().unwrap();
        let shift = channels.iter().find(|channel| channel["target"]["path"] == "translation").unwrap();
        let sampler = &json["animations"][0]["samplers"][shift["sampler"].as_u64().unwrap() as usize];
        json["accessors"][sampler["input"].as_u64().unwrap() as usize]["count"].as_u64().unwrap() as usize
    };
    let plain = keys(1.0);
    assert!(plain < 40, "{plain}");
    for scale in [100.0, 0.01] {
        assert!(keys(scale).abs_diff(plain) <= 1, "{} keys, {plain} without a scale", keys(scale));
    }
}

/// Without a skin nodes tell how the hand rests, and the motion which one it is.
#[test]
fn motions_without_mesh_or_origin_are_read_back() {
    for side in [Side::Left, Side::Right] {
        let mut clip = clip(&[side], 60);
        // It begins with a fist.
        clip.hands[0].poses[0].1.angles[JointAngle::Index2Flexion.index()] = 1.7;
        clip.hands[0].poses[0].1.angles[JointAngle::Middle2Flexion.index()] = 1.7;
        let mut options = ExportOptions::default();
        options.animation_only = true;
        let found = read(&stripped(&export(&clip, &options).unwrap()));
        assert_eq!(found.hands[0].side, side);
        let off = worst(&clip, &found.hands);
        assert!(off < 0.02, "{side:?}: {off}°");
    }
}

#[test]
fn wrists_move_in_the_unit_that_the_rig_is_made_in() {
    let clip = clip(&[Side::Right], 60);
    let rig = own_rig(&[Side::Right], JointNames::WebXr);
    for (unit, word) in [(0.01, "0.01 m"), (0.001, "0.001 m")] {
        let scale = 1.0 / unit;
        let scaled = changed(&rig, |json| {
            put_above(json, &[0], json!({ "name": "Armature", "scale": [scale, scale, scale] }));
        });
        let moved = put(&clip, &scaled);
        assert!(moved.notes.len() == 1 && moved.notes[0].contains(word), "{:?}", moved.notes);
        for (time, pose) in &clip.hands[0].poses {
            // Below the scale.
            let at = world_transforms(&moved.glb, *time)["wrist"].translation.vector;
            assert!((at * (scale * unit) - pose.translation).norm() < 1e-5, "{unit}: {at}");
        }
        for glb in [moved.glb.clone(), stripped(&moved.glb)] {
            let theirs = &read(&glb).hands[0].poses;
            for ((_, ours), (_, theirs)) in clip.hands[0].poses.iter().zip(theirs) {
                assert!((ours.translation - theirs.translation).norm() < 1e-5, "{unit}");
            }
        }
    }
}

#[test]
fn joints_that_carry_the_mesh_come_before_controls() {
    let clip = clip(&[Side::Right], 10);
    let rig = own_rig(&[Side::Right], JointNames::Mixamo);
    // Controls of the same names without weights, first in the file's second skin.
    let with_controls = |weighted: &dyn Fn(&str) -> String| {
        changed(&rig, |json| {
            let controls: Vec<Value> = json["nodes"].as_array().unwrap()[..25].to_vec();
            rename(json, weighted);
            let first = json["nodes"].as_array().unwrap().len();
            for mut control in controls {
                for child in control["children"].as_array_mut().into_iter().flatten() {
                    *child = (child.as_u64().unwrap() + first as u64).into();
                }
                json["nodes"].as_array_mut().unwrap().push(control);
            }
            json["scenes"][0]["nodes"].as_array_mut().unwrap().push(first.into());
            let joints: Vec<usize> = (first..first + 25).collect();
            json["skins"].as_array_mut().unwrap().push(json!({ "joints": joints }));
        })
    };
    let moved = put(&clip, &with_controls(&|name| format!("DEF-{name}")));
    assert!(moved_nodes(&moved.glb, "rotation").iter().all(|node| *node < 25));
    assert_eq!(moved.notes, [""; 0]);
    let moved = put(&clip, &with_controls(&|name| format!("b{}", name.len())));
    assert!(moved_nodes(&moved.glb, "rotation").iter().all(|node| *node > 25));
    assert!(moved.notes[0].contains("nothing visible moves"), "{:?}", moved.notes);
}

#[test]
fn only_what_looks_like_an_arm_holds_the_wrist() {
    let clip = clip(&[Side::Right], 10);
    let rig = own_rig(&[Side::Right], JointNames::Mixamo);
    let hung = |name: &str, place: [f64; 3], joint: bool| {
        let rig = changed(&rig, |json| {
            let above = put_above(json, &[0], json!({ "name": name, "translation": place }));
            if joint {
                json["skins"].as_array_mut().unwrap().push(json!({ "joints": [above] }));
            }
        });
        put(&clip, &rig)
    };
    // The wrist rests at 1, 2, 3.
    for (name, place, joint) in
        [("Root", [0.0; 3], true), ("Armature", [1.0, 2.0, 3.0], true), ("Bone", [0.0; 3], false)]
    {
        let moved = hung(name, place, joint);
        assert_eq!(moved_nodes(&moved.glb, "translation"), [0], "{name}");
        assert_eq!(moved.notes, [""; 0]);
    }
    for joint in [true, false] {
        let moved = hung("RightForeArm", [0.0; 3], joint);
        assert_eq!(moved_nodes(&moved.glb, "translation"), [0; 0]);
        assert_eq!(moved.notes, ["the right wrist only turns, since it hangs on an arm (\"RightForeArm\")"]);
    }
    // Two bones as long as those of an arm, of any name and in no skin.
    let chain = changed(&rig, |json| {
        json["nodes"][0]["translation"] = json!([0.25, 0.0, 0.0]);
        let lower = put_above(json, &[0], json!({ "name": "b2", "translation": [0.27, 0.0, 0.0] }));
        put_above(json, &[lower], json!({ "name": "b1", "translation": [0.1, 1.4, 0.0] }));
    });
    assert_eq!(moved_nodes(&put(&clip, &chain).glb, "translation"), [0; 0]);
}

/// Two hands on the arms of a body that stands in the world turned like this.
fn body(turn: UnitQuaternion<f64>) -> Vec<u8> {
    changed(&own_rig(&[Side::Left, Side::Right], JointNames::Mixamo), |json| {
        let wrists: Vec<usize> = [Side::Left, Side::Right]
            .into_iter()
            .map(|side| {
                let name = JointNames::Mixamo.name(Joint::Wrist, side, 2);
                json["nodes"].as_array().unwrap().iter().position(|node| node["name"] == *name).unwrap()
            })
            .collect();
        let mut below = Vec::new();
        for (wrist, (side, word)) in wrists.into_iter().zip([(1.0, "Left"), (-1.0, "Right")]) {
            json["nodes"][wrist]["translation"] = json!([0.25 * side, -0.1, 0.05]);
            let arm =
                json!({ "name": format!("mixamorig:{word}ForeArm"), "translation": [0.4 * side, 0.4, 0.0] });
            below.push(put_above(json, &[wrist], arm));
        }
        below.push(put_above(
            json,
            &[],
            json!({ "name": "mixamorig:Head", "translation": [0.0, 0.6, 0.02] }),
        ));
        let q = turn.coords;
        let hips = json!({ "name": "mixamorig:Hips", "rotation": [q.x, q.y, q.z, q.w] });
        let hips = put_above(json, &below, hips);
        json["skins"].as_array_mut().unwrap().push(json!({ "joints": [hips, hips - 1] }));
    })
}

#[test]
fn hands_turn_with_the_body_they_hang_on() {
    let clip = clip(&[Side::Left, Side::Right], 20);
    let upright = put(&clip, &body(UnitQuaternion::identity()));
    let about = |axis: Vector3<f64>, quarters: f64| {
        UnitQuaternion::from_scaled_axis(axis * (quarters * std::f64::consts::FRAC_PI_2))
    };
    for turn in [
        about(Vector3::y(), 2.0),
        about(Vector3::x(), 1.0),
        about(Vector3::y(), -1.0),
        about(Vector3::y(), 0.0),
        // Bodies may face anywhere.
        about(Vector3::y(), 10.0 / 90.0),
        about(Vector3::y(), 0.5),
        about(Vector3::y(), 135.0 / 90.0),
        about(Vector3::y(), -3.75),
    ] {
        let moved = put(&clip, &body(turn));
        assert_eq!(moved.notes, ["both wrists only turn, since they hang on arms"]);
        for time in [0.0, 0.4] {
            let (ours, theirs) = (world_transforms(&upright.glb, time), world_transforms(&moved.glb, time));
            for (name, here) in ours.iter().filter(|(name, _)| name.starts_with("mixamorig")) {
                let off = (turn * here.rotation).angle_to(&theirs[name].rotation).to_degrees();
                assert!(off < 1e-3, "{name}, turned by {turn}: {off}°");
            }
        }
        // An arm that rests says nothing of where the hand is.
        let found = read(&moved.glb);
        assert!(!found.placed);
        assert!(worst(&clip, &read(&stripped(&moved.glb)).hands) < 1e-3, "turned by {turn}");
        for hand in found.hands {
            let truth = clip.hands.iter().find(|h| h.poses[0].1.side == hand.side).unwrap();
            for ((_, pose), (_, true_pose)) in hand.poses.iter().zip(&truth.poses) {
                assert!(pose.rotation.angle_to(&true_pose.rotation) < 1e-3);
            }
        }
    }
}

/// An arm may point anywhere at rest: of one hand the shoulder tells which way the body faces.
#[test]
fn a_body_with_one_hand_is_told_by_its_shoulder() {
    let clip = clip(&[Side::Right], 5);
    let one = |shoulder: bool| {
        changed(&own_rig(&[Side::Right], JointNames::Mixamo), |json| {
            let name = JointNames::Mixamo.name(Joint::Wrist, Side::Right, 2);
            let wrist = json["nodes"].as_array().unwrap().iter().position(|n| n["name"] == *name).unwrap();
            // Forwards.
            json["nodes"][wrist]["translation"] = json!([0.0, 0.0, 0.25]);
            let elbow = json!({ "name": "mixamorig:RightForeArm", "translation": [0.0, 0.0, 0.3] });
            let mut below = put_above(json, &[wrist], elbow);
            if shoulder {
                let upper = json!({ "name": "mixamorig:RightArm", "translation": [-0.2, 0.4, 0.0] });
                below = put_above(json, &[below], upper);
            }
            let head = json!({ "name": "mixamorig:Head", "translation": [0.0, 0.6, 0.02] });
            let head = put_above(json, &[], head);
            let hips = put_above(json, &[below, head], json!({ "name": "mixamorig:Hips" }));
            json["skins"].as_array_mut().unwrap().push(json!({ "joints": [hips, head] }));
        })
    };
    for shoulder in [true, false] {
        let (_, json) = document(&put(&clip, &one(shoulder)).glb);
        assert!(!json.to_string().contains("\"body\""), "{shoulder}");
    }
}

/// Where the weights of the first mesh lie in a file, of shares of 1 in floats.
fn weights_at(glb: &[u8]) -> usize {
    let (length, json) = document(glb);
    let accessor = json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"].as_u64().unwrap() as usize;
    let view = json["accessors"][accessor]["bufferView"].as_u64().unwrap() as usize;
    28 + length + json["bufferViews"][view]["byteOffset"].as_u64().unwrap_or(0) as usize
}

fn with_weights(rig: &[u8], vertex: usize, weights: [f32; 4]) -> Vec<u8> {
    let mut rig = rig.to_vec();
    let at = weights_at(&rig) + 16 * vertex;
    rig[at..at + 16].copy_from_slice(&weights.map(f32::to_le_bytes).concat());
    rig
}

#[test]
fn weights_that_do_not_add_up_are_scaled_and_named() {
    let rig = own_rig(&[Side::Right], JointNames::WebXr);
    let rig = with_weights(&rig, 3, [0.5, 0.25, 0.0, 0.0]);
    let rig = with_weights(&rig, 5, [0.0; 4]);
    let moved = put(&clip(&[Side::Right], 3), &rig);
    let vertex = |vertex: usize| -> Vec<f32> {
        let at = weights_at(&moved.glb) + 16 * vertex;
        let numbers = moved.glb[at..at + 16].chunks_exact(4);
        numbers.map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
    };
    assert_eq!(vertex(3), [2.0 / 3.0, 1.0 / 3.0, 0.0, 0.0]);
    assert_eq!(vertex(5), [1.0, 0.0, 0.0, 0.0]);
    let [note] = moved.notes.as_slice() else { panic!("{:?}", moved.notes) };
    for words in ["primitive 0: weights of 2 of", "vertex 3 add up to 0.75"] {
        assert!(note.contains(words), "{note}");
    }
    assert!(wrong(&with_weights(&rig, 7, [1.5, -0.5, 0.0, 0.0]), None).contains("vertex 7: weight -0.5"));
    assert!(wrong(&with_weights(&rig, 7, [f32::NAN, 0.0, 0.0, 0.0]), None).contains("not finite"));
    // Weights that are part of several sets cannot be right for all of them.
    let shared = changed(&rig, |json| {
        let mut other = json["meshes"][0]["primitives"][0].clone();
        for word in ["WEIGHTS", "JOINTS"] {
            other["attributes"][format!("{word}_1")] = other["attributes"][format!("{word}_0")].clone();
        }
        json["meshes"][0]["primitives"].as_array_mut().unwrap().push(other);
    });
    assert!(wrong(&shared, None).contains("stand in other sets of weights, too"));
}

#[test]
#[ignore = "needs the shared material and npm ci --prefix tests/node"]
fn the_validator_finds_nothing_in_mended_weights() {
    let source = shared("data/meshes/x-invalid-weights.glb");
    let mut map = "hand = \"right\"\n[joints]\nPalm = \"wrist\"\n".to_owned();
    for (letter, finger) in [("F1", "index"), ("F2", "middle"), ("F3", "ring"), ("F4", "pinky")] {
        for (bone, word) in [("a", "proximal"), ("b", "intermediate"), ("c", "distal")] {
            map += &format!("{letter}{bone} = \"{finger}-finger-phalanx-{word}\"\n");
        }
    }
    let map = JointMap::parse(&map).unwrap();
    let rig = std::fs::read(&source).unwrap();
    let moved =
        retarget(&clip(&[Side::Right], 3), &rig, None, Some(&map), &ExportOptions::default()).unwrap();
    assert!(moved.notes[0].contains("those of vertex 10 add up to 0"), "{:?}", moved.notes);
    let folder = tempfile::tempdir().unwrap();
    let made = folder.path().join("made.glb");
    std::fs::write(&made, &moved.glb).unwrap();
    let pair = format!("{}<{}", made.display(), source.display());
    let output = node("validate.js", &[Path::new(&pair)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
fn maps_find_joints_by_number_and_refuse_what_is_ambiguous() {
    let clip = clip(&[Side::Right], 5);
    let (rig, _) = strange_rig(&own_rig(&[Side::Right], JointNames::WebXr));
    let line = |joint: Joint| format!("\"#{}\" = \"{}\"\n", joint.index(), joint.webxr_name());
    let numbers = format!("hand = \"right\"\n[joints]\n{}", Joint::ALL.map(line).concat());
    let map = JointMap::parse(&numbers).unwrap();
    let moved = retarget(&clip, &rig, None, Some(&map), &ExportOptions::default()).unwrap();
    assert_gesture(&clip, &moved.glb, &|joint, _| format!("bone {}", joint.index()));
    assert!(wrong(&rig, Some("[right]\n\"#99\" = \"wrist\"")).contains("node 99 of 2"));
    // A mesh of the same name, before the joint, is not meant; another joint may be.
    let line = |joint: Joint| format!("\"bone {}\" = \"{}\"\n", joint.index(), joint.webxr_name());
    let named = format!("hand = \"right\"\n[joints]\n{}", Joint::ALL.map(line).concat());
    let map = JointMap::parse(&named).unwrap();
    let meshes = changed(&rig, |json| json["nodes"][25]["name"] = "bone 3".into());
    let moved = retarget(&clip, &meshes, None, Some(&map), &ExportOptions::default()).unwrap();
    assert!(!moved_nodes(&moved.glb, "rotation").contains(&25));
    let twice = changed(&rig, |json| json["nodes"][4]["name"] = "bone 3".into());
    assert!(
        wrong(&twice, Some(&named))
            .contains("2 nodes are named \"bone 3\": say which by its number, \"#3\", \"#4\"")
    );
}

#[test]
fn errors_list_the_joints_that_look_like_a_hands() {
    let rig = own_rig(&[Side::Right], JointNames::WebXr);
    let odd = changed(&rig, |json| {
        rename(
            json,
            |name| if name == "ring-finger-tip" { "RingThing".into() } else { format!("x{}", name.len()) },
        );
    });
    assert!(wrong(&odd, None).contains("joints are named \"RingThing\", \"x"), "{}", wrong(&odd, None));
    let skinless = changed(&rig, |json| {
        json.as_object_mut().unwrap().remove("skins");
        json["nodes"][25].as_object_mut().unwrap().remove("skin");
    });
    assert!(wrong(&skinless, None).contains("no node is a joint of a skin"), "{}", wrong(&skinless, None));
    let packed = changed(&rig, |json| json["extensionsRequired"] = json!(["KHR_meshopt_compression"]));
    assert!(wrong(&packed, None).contains("needs KHR_meshopt_compression, which is not read"));
}

#[test]
fn animations_of_the_rig_leave_nothing_behind() {
    let clip = clip(&[Side::Right], 30);
    let rig = own_rig(&[Side::Right], JointNames::WebXr);
    let mut options = ExportOptions::default();
    options.animation = "wave".into();
    let once = retarget(&clip, &rig, None, None, &options).unwrap().glb;
    let long = put(&self::clip(&[Side::Right], 400), &rig).glb;
    let again = retarget(&clip, &long, None, None, &options).unwrap().glb;
    let (_, first) = document(&once);
    let (_, second) = document(&again);
    assert_eq!(first["animations"][0]["name"], "wave");
    assert_eq!(first["animations"], second["animations"]);
    for list in ["buffers", "bufferViews", "accessors", "meshes", "skins"] {
        assert_eq!(first[list], second[list], "{list}");
    }
    assert_gesture(&clip, &again, &|joint, _| joint.webxr_name().into());
    // What an extension might use stays.
    let unknown = changed(&long, |json| json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]));
    let kept = put(&clip, &unknown).glb;
    assert!(kept.len() > again.len() + 10_000);
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

/// A flat hand without a thumb, whose bones point along y, is its own mirror image: only the map tells its side.
#[test]
fn a_hand_that_may_be_either_needs_its_side_in_the_map() {
    let mut nodes = vec![json!({ "name": "root", "children": [] })];
    let mut joints = "\n[joints]\nroot = \"wrist\"\n".to_owned();
    for (finger, name) in ["index", "middle", "ring", "pinky"].into_iter().enumerate() {
        let first = nodes.len();
        nodes[0]["children"].as_array_mut().unwrap().push(first.into());
        for (k, part) in
            ["phalanx-proximal", "phalanx-intermediate", "phalanx-distal"].into_iter().enumerate()
        {
            let place = if k == 0 { [0.03 - 0.02 * finger as f64, 0.09, 0.0] } else { [0.0, 0.03, 0.0] };
            let mut node = json!({ "name": format!("{finger}{k}"), "translation": place });
            if k < 2 {
                node["children"] = json!([first + k + 1]);
            }
            nodes.push(node);
            joints += &format!("{finger}{k} = \"{name}-finger-{part}\"\n");
        }
    }
    let document =
        json!({ "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": nodes });
    let rig = container(&document, &[]);
    let sides = |hand: &str| {
        let map = JointMap::parse(&format!("{hand}{joints}")).unwrap();
        check_rig(&rig, None, Some(&map), &Limits::default()).map(|checked| checked.sides)
    };
    let error = sides("").unwrap_err();
    assert!(matches!(error, GltfError::Rig(RigError::NoSide)), "{error}");
    assert!(error.to_string().contains("a line hand = \"right\" before [joints]"), "{error}");
    assert_eq!(sides("hand = \"right\"").unwrap(), [Side::Right]);
    assert_eq!(sides("hand = \"left\"").unwrap(), [Side::Left]);
    let error = JointMap::parse(&format!("hand = \"both\"{joints}")).unwrap_err().to_string();
    assert!(
        error.contains("hand = \"both\"") && error.contains("left") && error.contains("right"),
        "{error}"
    );
}
