//! GLB files as others read them: the Khronos validator, and the `gltf` crate.

use crate::common::glb::{clip, container, document, motion, node, world_transforms};
use handcast_gltf::{
    Clip, ExportOptions, HandTrack, ImportedHand, JointNames, NodeAxes, export, export_vrma, import_poses,
};
use handcast_hand::{Finger, HandPose, Joint, JointAngle, Morphology, Side, Skeleton};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// Every joint of every hand at every key: position and orientation as forward kinematics has them.
fn assert_kinematics(clip: &Clip, glb: &[u8], axes: NodeAxes, tolerance: f64) {
    // WebXR axes in ours: x to -x, y to -z, z to -y.
    let to_webxr = nalgebra::Matrix3::new(-1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, -1.0, 0.0);
    let ours = nalgebra::Matrix3::identity();
    for hand in &clip.hands {
        let side = hand.poses[0].1.side;
        let skeleton = Skeleton::new(&hand.morphology, side);
        for (time, pose) in hand.poses.iter().step_by(7) {
            let world = world_transforms(glb, *time);
            let frames = skeleton.frames(pose);
            for joint in Joint::ALL {
                let name = match (clip.hands.len(), side) {
                    (1, _) => joint.webxr_name().to_owned(),
                    (_, side) => format!("{}-{}", side.name(), joint.webxr_name()),
                };
                let (found, expected) = (world[&name], frames.get(joint));
                let shift = (found.translation.vector - expected.translation.vector).norm();
                assert!(shift < tolerance, "{name} at {time}: {shift} m off");
                let turned = found.rotation.to_rotation_matrix();
                if joint.webxr_name().ends_with("finger-metacarpal") {
                    // Its frame is the palm's, its node lies along the bone.
                    let next = frames.position(Joint::ALL[joint.index() + 1]) - frames.position(joint);
                    let along = if axes == NodeAxes::Bones { Vector3::y() } else { -Vector3::z() };
                    assert!((turned * along).angle(&next) < tolerance, "{name} at {time}");
                    continue;
                }
                let axes = if axes == NodeAxes::Bones { ours } else { to_webxr };
                let turn =
                    (turned.matrix() - expected.rotation.to_rotation_matrix().matrix() * axes).abs().max();
                assert!(turn < tolerance, "{name} at {time}: axes {turn} off");
            }
        }
    }
}

/// The default ones, without the textures, which take a second or two to make.
fn untextured() -> ExportOptions {
    let mut options = ExportOptions::default();
    options.texture = None;
    options
}

#[test]
fn nodes_follow_forward_kinematics() {
    for sides in [vec![Side::Right], vec![Side::Left], vec![Side::Left, Side::Right]] {
        let clip = clip(&sides, 60);
        for axes in [NodeAxes::Bones, NodeAxes::WebXr] {
            let mut options = untextured();
            options.axes = axes;
            assert_kinematics(&clip, &export(&clip, &options).unwrap(), axes, 1e-4);
        }
    }
}

#[test]
fn poses_come_back() {
    let mut clip = clip(&[Side::Right, Side::Left], 80);
    // The bones of this palm lie otherwise than the mean hand's.
    for base in clip
        .hands
        .iter_mut()
        .flat_map(|hand| &mut hand.morphology.fingers[1..])
        .map(|finger| &mut finger.base)
    {
        base[0] *= 1.2;
    }
    let mut webxr = untextured();
    webxr.axes = NodeAxes::WebXr;
    for options in [untextured(), webxr] {
        let glb = export(&clip, &options).unwrap();
        assert_poses(&clip, &import_poses(&glb).unwrap());
    }
}

/// The poses of a clip at its keys.
fn assert_poses(clip: &Clip, hands: &[ImportedHand]) {
    assert_eq!(hands.len(), clip.hands.len());
    for hand in hands {
        let track = clip.hands.iter().find(|h| h.poses[0].1.side == hand.side).unwrap();
        assert_eq!(hand.poses.len(), track.poses.len());
        assert_eq!(hand.morphology.as_ref(), Some(&track.morphology));
        for ((t, found), (time, pose)) in hand.poses.iter().zip(&track.poses) {
            assert!((t - time).abs() < 1e-6);
            assert!((found.translation - pose.translation).norm() < 1e-6);
            assert!(found.rotation.angle_to(&pose.rotation) < 1e-5);
            for angle in JointAngle::ALL {
                let error = (found.angle(angle) - pose.angle(angle)).abs();
                assert!(error < 1e-4, "{} at {time}: {error}", angle.name());
            }
        }
    }
}

#[test]
fn files_that_do_not_say_their_axes_have_those_of_webxr() {
    let clip = clip(&[Side::Right, Side::Left], 20);
    let mut options = untextured();
    options.axes = NodeAxes::WebXr;
    let changed = |options: &ExportOptions, axes: Option<&str>, sizes: bool| {
        let glb = export(&clip, options).unwrap();
        let (length, mut json) = document(&glb);
        for node in json["nodes"].as_array_mut().unwrap() {
            let Some(extras) = node.get_mut("extras").and_then(|extras| extras.as_object_mut()) else {
                continue;
            };
            extras.remove("axes");
            extras.extend(axes.map(|axes| ("axes".to_owned(), axes.into())));
        }
        if !sizes {
            json["asset"]["extras"] = serde_json::Value::Null;
        }
        import_poses(&container(&json, &glb[28 + length..]))
    };
    assert_poses(&clip, &changed(&options, None, true).unwrap());
    let refused = changed(&options, Some("up"), true).unwrap_err().to_string();
    assert!(refused.contains("\"up\", allowed bones, webxr"), "{refused}");
    // Axes that another program has changed are seen.
    assert_poses(&clip, &changed(&untextured(), Some("webxr"), true).unwrap());
    // Without sizes nodes along the bones are read as those of any rig, from how they stand.
    let found = changed(&untextured(), Some("bones"), false).unwrap();
    for (hand, track) in found.iter().zip([&clip.hands[1], &clip.hands[0]]) {
        assert_eq!(hand.side, track.poses[0].1.side);
        for ((_, found), (_, pose)) in hand.poses.iter().zip(&track.poses) {
            let off = found.angle(JointAngle::Index2Flexion) - pose.angle(JointAngle::Index2Flexion);
            assert!(off.abs() < 1e-4, "{off}");
        }
    }
}

#[test]
fn quantised_files_of_every_convention_come_back() {
    let clip = clip(&[Side::Left, Side::Right], 30);
    let plain = export(&clip, &untextured()).unwrap();
    for names in JointNames::ALL {
        let mut options = untextured();
        options.names = names;
        options.quantize = true;
        let glb = export(&clip, &options).unwrap();
        assert!(glb.len() * 10 < plain.len() * 7, "{} of {}", glb.len(), plain.len());
        let hands = import_poses(&glb).unwrap();
        assert_eq!(hands.len(), 2, "{names:?}");
        for hand in hands {
            let track = clip.hands.iter().find(|h| h.poses[0].1.side == hand.side).unwrap();
            for ((_, found), (time, pose)) in hand.poses.iter().zip(&track.poses) {
                for angle in JointAngle::ALL {
                    let error = (found.angle(angle) - pose.angle(angle)).abs();
                    assert!(error < 5e-4, "{} at {time}: {error}", angle.name());
                }
            }
        }
    }
    // A single hand bears the same names, but for those of WebXR.
    let mut options = untextured();
    options.names = JointNames::OpenXr;
    let left = crate::common::glb::clip(&[Side::Left], 5);
    let glb = export(&left, &options).unwrap();
    assert_eq!(import_poses(&glb).unwrap()[0].side, Side::Left);
    let world = world_transforms(&glb, 0.0);
    assert_eq!(world.len(), 27, "26 joints and the mesh");
    let at = |name: &str| world[name].translation.vector;
    let middle = (at("Middle_Metacarpal_L") + at("Middle_Proximal_L")) / 2.0;
    assert!((at("Palm_L") - middle).norm() < 1e-6);
}

#[test]
fn dropping_keys_makes_no_file_larger() {
    let clip = clip(&[Side::Left, Side::Right], 40);
    for quantize in [false, true] {
        let size = |degrees: f64| {
            let mut options = untextured();
            options.animation_only = true;
            options.quantize = quantize;
            options.rotation_tolerance = degrees.to_radians();
            options.translation_tolerance = 0.1 * degrees.to_radians();
            export(&clip, &options).unwrap().len()
        };
        let sizes = [0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0].map(size);
        assert!(sizes.is_sorted_by(|a, b| a >= b), "{sizes:?}");
        assert!(sizes[6] < sizes[0], "{sizes:?}");
    }
}

#[test]
fn left_out_keys_are_reproduced_within_the_tolerance() {
    let clip = clip(&[Side::Right], 120);
    let full = export(&clip, &untextured()).unwrap();
    let mut options = untextured();
    options.rotation_tolerance = 0.3f64.to_radians();
    options.translation_tolerance = 2e-4;
    let small = export(&clip, &options).unwrap();
    assert!(small.len() < full.len() - 15_000, "{} of {}", small.len(), full.len());
    let file = gltf::Gltf::from_slice(&small).unwrap();
    let blob = file.blob.as_deref().unwrap();
    let complete = gltf::Gltf::from_slice(&full).unwrap();
    let complete_blob = complete.blob.as_deref().unwrap();
    let quaternions = |c: &gltf::animation::Channel,
                       blob: &[u8]|
     -> Option<Vec<(f64, UnitQuaternion<f64>)>> {
        let reader = c.reader(|_| Some(blob));
        let gltf::animation::util::ReadOutputs::Rotations(r) = reader.read_outputs()? else { return None };
        let keys = r
            .into_f32()
            .map(|[x, y, z, w]| UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z).cast::<f64>()));
        Some(reader.read_inputs()?.map(f64::from).zip(keys).collect())
    };
    let mut compared = 0;
    for (a, b) in
        file.animations().next().unwrap().channels().zip(complete.animations().next().unwrap().channels())
    {
        assert_eq!(a.target().node().name(), b.target().node().name());
        let Some(kept) = quaternions(&a, blob) else { continue };
        for (time, expected) in quaternions(&b, complete_blob).unwrap() {
            let after = kept.partition_point(|(t, _)| *t <= time).min(kept.len() - 1);
            let (from, to) = (kept[after.saturating_sub(1)], kept[after]);
            let share = if after == 0 { 0.0 } else { (time - from.0) / (to.0 - from.0) };
            let error = from.1.slerp(&to.1, share).angle_to(&expected);
            assert!(error <= options.rotation_tolerance + 1e-5, "{error}");
            compared += 1;
        }
    }
    assert!(compared > 120 * 15);
}

#[test]
fn still_joints_have_no_track() {
    let mut poses = motion(Side::Right, 10);
    for (_, pose) in &mut poses {
        *pose = HandPose { translation: pose.translation, ..HandPose::neutral(Side::Right) }
            .with_degrees(JointAngle::Index1Flexion, 40.0 * pose.translation.x);
    }
    let clip =
        Clip { hands: vec![HandTrack { morphology: Morphology::default(), poses }], ..Clip::default() };
    let glb = export(&clip, &untextured()).unwrap();
    let file = gltf::Gltf::from_slice(&glb).unwrap();
    let moved: Vec<_> = file
        .animations()
        .next()
        .unwrap()
        .channels()
        .map(|c| c.target().node().name().unwrap().to_owned())
        .collect();
    assert_eq!(moved, ["wrist", "index-finger-phalanx-proximal"]);
    assert_eq!(file.animations().count(), 1);
    assert_eq!(file.skins().next().unwrap().joints().count(), 25);
    assert_eq!(file.materials().count(), 1);
    assert_eq!(
        file.as_json().asset.generator.as_deref(),
        Some(concat!("handcast ", env!("CARGO_PKG_VERSION")))
    );
}

#[test]
fn hands_have_textures_and_files_stay_small() {
    let still = |sides: &[Side]| {
        let hands = sides.iter().map(|&side| HandTrack {
            morphology: Morphology::default(),
            poses: vec![(0.0, HandPose::neutral(side))],
        });
        Clip { hands: hands.collect(), ..Clip::default() }
    };
    let mut quantized = ExportOptions::default();
    quantized.quantize = true;
    let mut plain_colour = ExportOptions::default();
    plain_colour.texture = None;
    for (options, most) in [(ExportOptions::default(), 1_500_000), (quantized, 300_000)] {
        let glb = export(&still(&[Side::Right]), &options).unwrap();
        println!("{} bytes", glb.len());
        assert!(glb.len() <= most, "{} bytes, allowed {most}", glb.len());
        // The reader refuses the extension of quantised files as one it does not know.
        let read = |glb: &[u8]| gltf::Gltf::from_slice_without_validation(glb).unwrap();
        let file = read(&glb);
        let skin = file.materials().next().unwrap();
        let pbr = skin.pbr_metallic_roughness();
        assert!(pbr.base_color_texture().is_some() && pbr.metallic_roughness_texture().is_some());
        assert!(skin.normal_texture().is_some() && skin.occlusion_texture().is_some());
        assert_eq!(file.images().count(), 3);
        // Both hands of a person share them.
        let both = export(&still(&[Side::Left, Side::Right]), &options).unwrap();
        assert_eq!(read(&both).images().count(), 3);
    }
    let glb = export(&still(&[Side::Left]), &plain_colour).unwrap();
    assert_eq!(gltf::Gltf::from_slice(&glb).unwrap().images().count(), 0);
}

#[test]
fn wrong_clips_are_refused() {
    let options = untextured();
    let message = |clip: &Clip| export(clip, &options).unwrap_err().to_string();
    assert!(message(&Clip::default()).contains("the clip is empty"));
    assert!(message(&clip(&[Side::Left, Side::Left], 3)).contains("several tracks of the left hand"));
    let mut backwards = clip(&[Side::Right], 5);
    backwards.hands[0].poses[3].0 = 0.01;
    assert!(message(&backwards).contains("pose 3"));
    let mut infinite = clip(&[Side::Right], 5);
    infinite.hands[0].poses[2].1.angles[4] = f64::NAN;
    assert!(message(&infinite).contains("pose 2"));
    for bytes in [&b""[..], b"glTF", b"{\"asset\":{\"version\":\"2.0\"}}"] {
        assert!(import_poses(bytes).is_err());
    }
    // Truncated anywhere: an error, never a panic.
    let glb = export(&clip(&[Side::Right], 3), &options).unwrap();
    for n in (0..glb.len()).step_by(997) {
        assert!(import_poses(&glb[..n]).is_err());
    }
}

#[test]
#[ignore = "needs Node and npm ci --prefix tests/node"]
fn the_khronos_validator_finds_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut animation_only = ExportOptions::default();
    animation_only.animation_only = true;
    let mut reduced = ExportOptions::default();
    reduced.rotation_tolerance = 0.01;
    let mut quantized = reduced.clone();
    quantized.quantize = true;
    let mut openxr = ExportOptions::default();
    openxr.names = JointNames::OpenXr;
    let still = Clip {
        hands: vec![HandTrack {
            morphology: Morphology::default(),
            poses: vec![(0.0, HandPose::neutral(Side::Right))],
        }],
        ..Clip::default()
    };
    let files: Vec<_> = [
        ("right", clip(&[Side::Right], 40), ExportOptions::default()),
        ("left", clip(&[Side::Left], 40), ExportOptions::default()),
        ("both", clip(&[Side::Left, Side::Right], 40), ExportOptions::default()),
        ("animation-only", clip(&[Side::Left, Side::Right], 40), animation_only),
        ("reduced", clip(&[Side::Right], 40), reduced),
        ("quantized", clip(&[Side::Left, Side::Right], 40), quantized),
        ("openxr", clip(&[Side::Left, Side::Right], 40), openxr),
        ("still", still, ExportOptions::default()),
    ]
    .into_iter()
    .map(|(name, clip, options)| {
        let path = folder.path().join(format!("{name}.glb"));
        std::fs::write(&path, export(&clip, &options).unwrap()).unwrap();
        path
    })
    .chain(std::iter::once({
        let path = folder.path().join("avatars.vrma");
        let both = clip(&[Side::Left, Side::Right], 40);
        std::fs::write(&path, export_vrma(&both, &ExportOptions::default()).unwrap()).unwrap();
        path
    }))
    .collect();
    let paths: Vec<&std::path::Path> = files.iter().map(|p| p.as_path()).collect();
    let output = node("validate.js", &paths);
    let text = String::from_utf8_lossy(&output.stdout);
    println!("{text}{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{text}");
    assert_eq!(text.lines().count(), files.len());
}

#[test]
fn finger_names_follow_webxr() {
    for finger in Finger::LONG {
        for joint in Joint::of(finger) {
            assert!(joint.webxr_name().starts_with(&format!("{}-finger-", finger.name())));
        }
    }
}
