//! GLB files in three.js, in headless Chromium, beside the program's own pictures of the same poses.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common::glb::{chromium, clip, node, posed_surface, world_transforms};
use crate::common::shared;
use handcast_gltf::{Clip, ExportOptions, JointNames, export, retarget};
use handcast_hand::landmarks::measure;
use handcast_hand::{Finger, HandMesh, HandPose, Joint, Side, Skeleton, SkinnedSurface};
use handcast_render::{Camera, Raster, Surface, contact_sheet, hand_surface};
use nalgebra::{UnitQuaternion, Vector3};

const SIZE: (u32, u32) = (600, 500);
const FOCAL: f64 = 1050.0;
const FRAMES: [usize; 3] = [0, 20, 41];

/// A motion before the camera: each hand at its place, palm or back to the viewer.
fn before_the_camera(sides: &[Side]) -> Clip {
    let mut clip = clip(sides, 60);
    let several = clip.hands.len() > 1;
    for hand in &mut clip.hands {
        for (time, pose) in &mut hand.poses {
            let x = match (several, pose.side) {
                (false, _) => 0.0,
                (true, Side::Left) => -0.12,
                (true, Side::Right) => 0.12,
            };
            pose.translation = Vector3::new(x + 0.03 * time.sin(), -0.08, -0.8);
            pose.rotation = UnitQuaternion::from_euler_angles(0.1, 0.3 * time.sin(), 0.2 * *time);
        }
    }
    clip
}

/// A file to show, and the motion in it.
struct Case {
    name: String,
    glb: Vec<u8>,
    clip: Clip,
    /// A rig made elsewhere: our hand is only sized like it.
    rig: bool,
    /// How far its joints may be from ours, metres.
    off: f64,
}

/// The sizes of a rig at rest, with which our hand should look like it.
fn sized_like(rig: &[u8], side: Side, name: &dyn Fn(Joint) -> String, mut clip: Clip) -> Clip {
    // Any motion will do: distances are the rig's own.
    let still = retarget(&clip, rig, None, None, &ExportOptions::default()).unwrap();
    let frames: Vec<_> = clip.hands[0]
        .poses
        .iter()
        .map(|(time, _)| {
            let world = world_transforms(&still.glb, *time);
            Joint::ALL.map(|j| Some(world[&name(j)].translation.vector.into()))
        })
        .collect();
    clip.hands[0].morphology = measure(&frames, side).unwrap();
    clip
}

/// What gltfpack (npm) makes of a GLB: meshopt's compression, names of nodes kept.
fn packed(glb: &[u8]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let [from, to] = ["in.glb", "out.glb"].map(|name| folder.path().join(name));
    std::fs::write(&from, glb).unwrap();
    let packer = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/node/node_modules/.bin/gltfpack");
    let mut command = Command::new(packer);
    let done = command.arg("-i").arg(from).arg("-o").arg(&to).args(["-cc", "-kn", "-af", "0"]).status();
    assert!(done.unwrap().success(), "{command:?}");
    std::fs::read(to).unwrap()
}

fn our_hands() -> Vec<Case> {
    let mut quantized = ExportOptions::default();
    quantized.quantize = true;
    quantized.names = JointNames::OpenXr;
    quantized.rotation_tolerance = 0.002;
    let both = before_the_camera(&[Side::Left, Side::Right]);
    let glb = |options: &ExportOptions| export(&both, options).unwrap();
    let small = packed(&glb(&quantized));
    assert!(small.len() < glb(&quantized).len() * 2 / 3, "{} bytes", small.len());
    vec![
        Case {
            name: "ours".into(),
            glb: glb(&ExportOptions::default()),
            clip: both.clone(),
            rig: false,
            off: 1e-5,
        },
        Case { name: "quantized".into(), glb: glb(&quantized), clip: both.clone(), rig: false, off: 1e-5 },
        // Rotations have 12 bits there.
        Case { name: "packed".into(), glb: small, clip: both.clone(), rig: false, off: 5e-4 },
    ]
}

fn rigs_made_elsewhere() -> Vec<Case> {
    let meshes = shared("data/meshes");
    let mut cases = Vec::new();
    for side in [Side::Left, Side::Right] {
        for (kind, ending) in [("webxr", "glb"), ("openxr", "gltf")] {
            let name = format!("{kind}-{}", side.name());
            let rig = std::fs::read(meshes.join(format!("{name}.{ending}"))).unwrap();
            let label = |joint: Joint| match kind {
                "webxr" => joint.webxr_name().to_owned(),
                _ => JointNames::OpenXr.name(joint, side, 1),
            };
            let clip = sized_like(&rig, side, &label, before_the_camera(&[side]));
            let glb = retarget(&clip, &rig, None, None, &ExportOptions::default()).unwrap().glb;
            cases.push(Case { name, glb, clip, rig: true, off: f64::INFINITY });
        }
    }
    cases
}

/// Which pixels the program's own renderer covers.
fn silhouette(clip: &Clip, frame: usize) -> Vec<bool> {
    let mut raster = Raster::new(SIZE.0, SIZE.1, 3);
    for hand in &clip.hands {
        let pose: &HandPose = &hand.poses[frame].1;
        let mesh = HandMesh::generate(&hand.morphology, pose.side);
        let mut skinned = SkinnedSurface::default();
        mesh.skin(&Skeleton::new(&hand.morphology, pose.side).frames(pose), &mut skinned);
        raster.draw(&hand_surface(&mesh, &skinned), &Camera::pinhole(SIZE, FOCAL));
    }
    raster.coverage(1).into_iter().map(|c| c >= 128).collect()
}

/// The same of the mesh in a GLB.
fn silhouette_of_rig(glb: &[u8], time: f64) -> Vec<bool> {
    let (positions, triangles) = posed_surface(glb, time);
    let normals = vec![[0.0, 0.0, 1.0]; positions.len()];
    let surface = Surface {
        positions: &positions,
        normals: &normals,
        triangles: &triangles,
        tints: &[],
        grain: &[],
        palms: &[],
        layer: 1,
    };
    let mut raster = Raster::new(SIZE.0, SIZE.1, 3);
    raster.draw(&surface, &Camera::pinhole(SIZE, FOCAL));
    raster.coverage(1).into_iter().map(|c| c >= 128).collect()
}

/// Intersection over union of the pixels that count.
fn overlap(a: &[bool], b: &[bool], counts: impl Fn(usize) -> bool) -> f64 {
    let pairs = || a.iter().zip(b).enumerate().filter(|(at, _)| counts(*at)).map(|(_, pair)| pair);
    let both = pairs().filter(|(a, b)| **a && **b).count();
    both as f64 / pairs().filter(|(a, b)| **a || **b).count() as f64
}

/// Whether a pixel lies on the hand's side of the wrist: rigs end below it wherever they like.
fn beyond_the_wrist(pose: &HandPose, pixel: usize) -> bool {
    let (x, y) = ((pixel as u32 % SIZE.0) as f64 + 0.5, (pixel as u32 / SIZE.0) as f64 + 0.5);
    let depth = -pose.translation.z;
    let centre = [f64::from(SIZE.0) / 2.0, f64::from(SIZE.1) / 2.0];
    let point = Vector3::new((x - centre[0]) / FOCAL * depth, (centre[1] - y) / FOCAL * depth, -depth);
    (pose.rotation * Vector3::y()).dot(&(point - pose.translation)) > 0.02
}

/// Where the picture of a frame of a case is.
fn taken(folder: &Path, case: usize, frame: usize) -> PathBuf {
    folder.join(format!("{case}-{frame}.png"))
}

/// Takes pictures of all cases in three.js, into `folder`.
fn photograph(folder: &Path, cases: &[Case]) {
    let mut arguments: Vec<PathBuf> = vec![chromium()];
    arguments.extend([SIZE.0.to_string(), SIZE.1.to_string(), FOCAL.to_string()].map(PathBuf::from));
    for (k, case) in cases.iter().enumerate() {
        let file = folder.join(format!("{}.glb", case.name));
        std::fs::write(&file, &case.glb).unwrap();
        arguments.push(file);
        for i in FRAMES {
            let time = case.clip.hands[0].poses[i].0;
            arguments.push(format!("{time}={}", taken(folder, k, i).display()).into());
        }
    }
    let arguments: Vec<&Path> = arguments.iter().map(PathBuf::as_path).collect();
    let output = node("screenshot.js", &arguments);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    let facts: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(facts.len(), cases.len());
    for (case, facts) in cases.iter().zip(&facts) {
        assert_eq!(facts["animations"], 1, "{}", case.name);
        let last = case.clip.hands[0].poses.last().unwrap().0;
        assert!((facts["duration"].as_f64().unwrap() - last).abs() < 1e-3, "{}: {facts}", case.name);
        if !case.rig {
            assert_lines(case, &facts["drawn"]);
        }
    }
}

/// The skeletons that three.js draws of our own hands are lines from joint to joint, at rest in the first pose.
fn assert_lines(case: &Case, drawn: &serde_json::Value) {
    let lines: Vec<Vec<[f64; 3]>> = serde_json::from_value(drawn.clone()).unwrap();
    assert_eq!(lines.len(), case.clip.hands.len(), "{}", case.name);
    for hand in &case.clip.hands {
        let pose = &hand.poses[0].1;
        let frames = Skeleton::new(&hand.morphology, pose.side).frames(pose);
        for joint in Joint::ALL {
            let Some(above) = joint.parent() else { continue };
            let ends = [joint, above].map(|joint| frames.position(joint).coords);
            let is_ours = |line: &&[[f64; 3]; 2]| {
                line.iter().zip(&ends).all(|(there, here)| (Vector3::from(*there) - here).norm() < case.off)
            };
            let found =
                lines.iter().filter(|ends| ends.as_chunks().0.iter().any(|line| is_ours(&line))).count();
            assert_eq!(found, 1, "{}: {} {}", case.name, pose.side.name(), joint.webxr_name());
        }
    }
}

/// Pictures by three.js show each case where our renderer does. `sheet` names a picture to look at, of what differs.
fn assert_same_silhouettes(cases: &[Case], sheet: &str) {
    let folder = tempfile::tempdir().unwrap();
    photograph(folder.path(), cases);
    let mut pictures = Vec::new();
    for (k, case) in cases.iter().enumerate() {
        for i in FRAMES {
            let mut theirs = image::open(taken(folder.path(), k, i)).unwrap().to_rgba8();
            // Skin is far from white in blue: half covered is half way. Rigs are grey, and shine.
            let white = if case.rig { 240 } else { 190 };
            let shown: Vec<bool> = theirs.pixels().map(|p| p.0[2] < white).collect();
            let own = silhouette(&case.clip, i);
            let (time, pose) = &case.clip.hands[0].poses[i];
            let found = if case.rig {
                // Drawn by the program, the rig itself is there; our hand of its size makes the same gesture.
                let same = overlap(&shown, &silhouette_of_rig(&case.glb, *time), |_| true);
                let like = overlap(&shown, &own, |at| beyond_the_wrist(pose, at));
                assert!(same > 0.97, "{} frame {i}: {same}", case.name);
                // Its flesh is another: what tells is that other moments of our hand fit less.
                let others = FRAMES.iter().filter(|&&other| other != i).map(|&other| {
                    overlap(&shown, &silhouette(&case.clip, other), |at| beyond_the_wrist(pose, at))
                });
                let other = others.fold(0.0, f64::max);
                assert!(like > 0.8 && like > other + 0.1, "{} frame {i}: {like}, {other}", case.name);
                [same, like]
            } else {
                let same = overlap(&shown, &own, |_| true);
                assert!(same > 0.98, "{} frame {i}: {same}", case.name);
                [same; 2]
            };
            println!(
                "{} frame {i}: overlap of silhouettes {:.4}, with our hand {:.4}",
                case.name, found[0], found[1]
            );
            for (pixel, _) in
                theirs.pixels_mut().zip(own.iter().zip(&shown)).filter(|(_, (o, s))| **o && !**s)
            {
                pixel.0 = [255, 210, 60, 255];
            }
            pictures.push(theirs);
        }
    }
    if let Some(folder) = std::env::var_os("HANDCAST_TEST_PICTURES") {
        let all = contact_sheet(&pictures, 3, 2, image::Rgba([0, 0, 0, 255]));
        all.save(Path::new(&folder).join(sheet)).unwrap();
    }
}

#[test]
#[ignore = "needs Chromium and npm ci --prefix tests/node"]
fn three_js_shows_the_hand_where_the_own_renderer_does() {
    assert_same_silhouettes(&our_hands(), "three.png");
}

#[test]
#[ignore = "needs the shared material, Chromium and npm ci --prefix tests/node"]
fn three_js_shows_rigs_made_elsewhere_where_the_own_renderer_does() {
    assert_same_silhouettes(&rigs_made_elsewhere(), "three-rigs.png");
}

#[test]
fn fingers_of_the_motion_bend() {
    // The pictures above would prove little of a hand that hardly moves.
    let clip = before_the_camera(&[Side::Right]);
    let bend = |i: usize| clip.hands[0].poses[i].1.angle(Finger::Index.middle_flexion());
    assert!(FRAMES.iter().any(|&i| (bend(i) - bend(FRAMES[0])).abs() > 0.5));
}
