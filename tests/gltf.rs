//! GLB files as others read them: the Khronos validator, and the `gltf` crate.

#![allow(clippy::unwrap_used, clippy::panic, clippy::field_reassign_with_default)]

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use handcast::gltf::{Clip, ExportOptions, HandTrack, export, import_poses};
use handcast::hand::{
    Domain, Finger, HandMesh, HandPose, Joint, JointAngle, Morphology, Side, Skeleton, SkinnedSurface,
};
use handcast::render::{Camera, Raster, contact_sheet, hand_surface};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// A motion that uses every angle of every finger and the whole of the wrist.
fn motion(side: Side, frames: usize) -> Vec<(f64, HandPose)> {
    (0..frames)
        .map(|i| {
            let t = i as f64 / 25.0;
            let wave = |a: f64, b: f64| 0.5 - 0.5 * (a * t + b).cos();
            let mut pose = HandPose::neutral(side);
            let mut free = [0.0; 15];
            for (k, angle) in Domain::FREE.into_iter().enumerate() {
                let top = if angle.name().ends_with("abduction") { 0.12 } else { 0.9 };
                free[k] = top * wave(2.0 + 0.1 * k as f64, k as f64);
            }
            pose.angles = Domain::expand(&free);
            pose.set(JointAngle::Pinky0Flexion, 0.2 * wave(1.0, 0.3));
            pose.set(JointAngle::Index1Twisting, 0.1 * wave(1.3, 0.1));
            pose.set(JointAngle::Thumb1Twisting, 0.2 * wave(1.7, 0.2));
            // Turns on past 180 degrees, where quaternion signs would flip.
            pose.rotation = UnitQuaternion::from_euler_angles(0.3 * t, 1.1 * t, 1.9 * t);
            pose.translation = Vector3::new(0.1 * t.sin(), 0.05 * t, -0.7 + 0.02 * t);
            (t, pose)
        })
        .collect()
}

fn track(side: Side, frames: usize) -> HandTrack {
    HandTrack { morphology: Morphology::average(0.18), poses: motion(side, frames) }
}

fn clip(sides: &[Side], frames: usize) -> Clip {
    Clip { hands: sides.iter().map(|&s| track(s, frames)).collect() }
}

/// Transforms of all named nodes in the world at each key time of `file`, tracks sampled at their keys.
fn world_transforms(glb: &[u8], time: f64) -> HashMap<String, Isometry3<f64>> {
    let file = gltf::Gltf::from_slice(glb).unwrap();
    let blob = file.blob.as_deref().unwrap();
    let mut local: HashMap<usize, (Vector3<f64>, UnitQuaternion<f64>)> = HashMap::new();
    let quaternion =
        |[x, y, z, w]: [f32; 4]| UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z).cast::<f64>());
    for node in file.nodes() {
        let (t, r, _) = node.transform().decomposed();
        local.insert(node.index(), (Vector3::from(t).cast(), quaternion(r)));
    }
    for channel in file.animations().next().unwrap().channels() {
        let reader = channel.reader(|_| Some(blob));
        let times: Vec<f64> = reader.read_inputs().unwrap().map(f64::from).collect();
        let after = times.partition_point(|t| *t <= time + 1e-6);
        let (a, b) = (after.saturating_sub(1), after.min(times.len() - 1));
        let share = if a == b { 0.0 } else { (time - times[a]) / (times[b] - times[a]) };
        let entry = local.get_mut(&channel.target().node().index()).unwrap();
        match reader.read_outputs().unwrap() {
            gltf::animation::util::ReadOutputs::Rotations(r) => {
                let keys: Vec<_> = r.into_f32().map(quaternion).collect();
                entry.1 = keys[a].slerp(&keys[b], share);
            }
            gltf::animation::util::ReadOutputs::Translations(t) => {
                let keys: Vec<_> = t.map(|v| Vector3::from(v).cast::<f64>()).collect();
                entry.0 = keys[a].lerp(&keys[b], share);
            }
            _ => panic!("unexpected track"),
        }
    }
    fn visit(
        node: &gltf::Node,
        above: Isometry3<f64>,
        local: &HashMap<usize, (Vector3<f64>, UnitQuaternion<f64>)>,
        out: &mut HashMap<String, Isometry3<f64>>,
    ) {
        let (t, r) = local[&node.index()];
        let here = above * Isometry3::from_parts(Translation3::from(t), r);
        assert!(out.insert(node.name().unwrap().to_owned(), here).is_none(), "names are unique");
        for child in node.children() {
            visit(&child, here, local, out);
        }
    }
    let mut out = HashMap::new();
    for node in file.default_scene().unwrap().nodes() {
        visit(&node, Isometry3::identity(), &local, &mut out);
    }
    out
}

/// Every joint of every hand at every key: position and orientation as forward kinematics has them.
fn assert_kinematics(clip: &Clip, glb: &[u8], tolerance: f64) {
    // WebXR axes in ours: x to -x, y to -z, z to -y.
    let to_webxr = nalgebra::Matrix3::new(-1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, -1.0, 0.0);
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
                let axes = expected.rotation.to_rotation_matrix().matrix() * to_webxr;
                let turn = (found.rotation.to_rotation_matrix().matrix() - axes).abs().max();
                assert!(turn < tolerance, "{name} at {time}: axes {turn} off");
            }
        }
    }
}

#[test]
fn nodes_follow_forward_kinematics() {
    for sides in [vec![Side::Right], vec![Side::Left], vec![Side::Left, Side::Right]] {
        let clip = clip(&sides, 60);
        assert_kinematics(&clip, &export(&clip, &ExportOptions::default()).unwrap(), 1e-4);
    }
}

#[test]
fn poses_come_back() {
    let clip = clip(&[Side::Right, Side::Left], 80);
    let hands = import_poses(&export(&clip, &ExportOptions::default()).unwrap()).unwrap();
    assert_eq!(hands.len(), 2);
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
fn left_out_keys_are_reproduced_within_the_tolerance() {
    let clip = clip(&[Side::Right], 120);
    let full = export(&clip, &ExportOptions::default()).unwrap();
    let mut options = ExportOptions::default();
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
    let clip = Clip { hands: vec![HandTrack { morphology: Morphology::default(), poses }] };
    let glb = export(&clip, &ExportOptions::default()).unwrap();
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
fn wrong_clips_are_refused() {
    let options = ExportOptions::default();
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

/// Runs a script of tests/node; `None` (or a panic in CI) where Node or its packages are missing.
fn node(script: &str, arguments: &[&Path]) -> Option<std::process::Output> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/node");
    let installed = folder.join("node_modules").is_dir();
    let output = installed
        .then(|| Command::new("node").arg(folder.join(script)).args(arguments).output().ok())
        .flatten();
    if output.is_none() {
        let missing = "node or tests/node/node_modules is missing (npm ci in tests/node)";
        assert!(std::env::var_os("CI").is_none(), "{missing}");
        println!("skipped: {missing}");
    }
    output
}

#[test]
fn the_khronos_validator_finds_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut animation_only = ExportOptions::default();
    animation_only.animation_only = true;
    let mut reduced = ExportOptions::default();
    reduced.rotation_tolerance = 0.01;
    let still = Clip {
        hands: vec![HandTrack {
            morphology: Morphology::default(),
            poses: vec![(0.0, HandPose::neutral(Side::Right))],
        }],
    };
    let files: Vec<_> = [
        ("right", clip(&[Side::Right], 40), ExportOptions::default()),
        ("left", clip(&[Side::Left], 40), ExportOptions::default()),
        ("both", clip(&[Side::Left, Side::Right], 40), ExportOptions::default()),
        ("animation-only", clip(&[Side::Left, Side::Right], 40), animation_only),
        ("reduced", clip(&[Side::Right], 40), reduced),
        ("still", still, ExportOptions::default()),
    ]
    .into_iter()
    .map(|(name, clip, options)| {
        let path = folder.path().join(format!("{name}.glb"));
        std::fs::write(&path, export(&clip, &options).unwrap()).unwrap();
        path
    })
    .collect();
    let paths: Vec<&Path> = files.iter().map(|p| p.as_path()).collect();
    let Some(output) = node("validate.js", &paths) else { return };
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

/// Chromium to test with: `HANDCAST_CHROMIUM`, or where systems put it.
fn chromium() -> Option<PathBuf> {
    let named = std::env::var_os("HANDCAST_CHROMIUM").map(PathBuf::from);
    let usual = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    named.into_iter().chain(usual.map(PathBuf::from)).find(|p| p.is_file())
}

#[test]
fn three_js_shows_the_hand_where_the_own_renderer_does() {
    let Some(chromium) = chromium() else {
        println!("skipped: no chromium (set HANDCAST_CHROMIUM)");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let size = (600u32, 500u32);
    let focal = 1050.0;
    let mut clip = clip(&[Side::Left, Side::Right], 60);
    for (hand, x) in clip.hands.iter_mut().zip([-0.12, 0.12]) {
        for (time, pose) in &mut hand.poses {
            pose.translation = Vector3::new(x + 0.03 * time.sin(), -0.08, -0.8);
            pose.rotation = UnitQuaternion::from_euler_angles(0.1, 0.3 * time.sin(), 0.2 * *time);
        }
    }
    let file = folder.path().join("hands.glb");
    std::fs::write(&file, export(&clip, &ExportOptions::default()).unwrap()).unwrap();
    let frames = [0usize, 20, 41];
    let out = |i: usize| folder.path().join(format!("{i}.png"));
    let numbers = [size.0.to_string(), size.1.to_string(), focal.to_string()];
    let shots: Vec<String> =
        frames.iter().map(|&i| format!("{}={}", clip.hands[0].poses[i].0, out(i).display())).collect();
    let mut arguments = vec![chromium.as_path(), file.as_path()];
    arguments.extend(numbers.iter().chain(&shots).map(Path::new));
    let Some(output) = node("screenshot.js", &arguments) else { return };
    let text = String::from_utf8_lossy(&output.stdout);
    println!("{text}{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    let facts: serde_json::Value = serde_json::from_str(text.trim()).unwrap();
    assert_eq!(facts["animations"], 1);
    let camera = Camera::pinhole(size, focal);
    let mut pictures = Vec::new();
    for i in frames {
        let theirs = image::open(out(i)).unwrap().to_rgba8();
        let mut raster = Raster::new(size.0, size.1, 3);
        for hand in &clip.hands {
            let pose = &hand.poses[i].1;
            let mesh = HandMesh::generate(&hand.morphology, pose.side);
            let mut skinned = SkinnedSurface::default();
            mesh.skin(&Skeleton::new(&hand.morphology, pose.side).frames(pose), &mut skinned);
            raster.draw(&hand_surface(&mesh, &skinned), &camera);
        }
        let ours = raster.coverage(1);
        let (mut both, mut either) = (0, 0);
        for (pixel, own) in theirs.pixels().zip(&ours) {
            // Skin is far from white in blue: half covered is half way.
            let (a, b) = (pixel.0[2] < 190, *own >= 128);
            both += u32::from(a && b);
            either += u32::from(a || b);
        }
        let iou = f64::from(both) / f64::from(either);
        println!("frame {i}: overlap of silhouettes {iou:.4}");
        assert!(iou > 0.98, "frame {i}: {iou}");
        pictures.push(theirs);
    }
    if let Some(pictures_folder) = std::env::var_os("HANDCAST_TEST_PICTURES") {
        let sheet = contact_sheet(&pictures, 3, 2, image::Rgba([0, 0, 0, 255]));
        sheet.save(Path::new(&pictures_folder).join("three.png")).unwrap();
    }
}
