//! Motions to export, and GLB files as other programs read them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard, PoisonError};

use handcast_gltf::{Clip, HandTrack};
use handcast_hand::{Domain, HandPose, JointAngle, Morphology, Side};
use nalgebra::{Isometry3, Matrix4, Quaternion, Translation3, UnitQuaternion, Vector3};

/// A motion that uses every angle of every finger and the whole of the wrist.
pub fn motion(side: Side, frames: usize) -> Vec<(f64, HandPose)> {
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
            // The palm bends by itself, not with the fingers.
            pose.set(JointAngle::Ring0Flexion, 0.0);
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

pub fn track(side: Side, frames: usize) -> HandTrack {
    HandTrack { morphology: Morphology::average(0.18), poses: motion(side, frames) }
}

pub fn clip(sides: &[Side], frames: usize) -> Clip {
    Clip { hands: sides.iter().map(|&s| track(s, frames)).collect(), ..Clip::default() }
}

/// Transforms of all named nodes in the world at each key time of `file`, tracks sampled at their keys.
pub fn world_transforms(glb: &[u8], time: f64) -> HashMap<String, Isometry3<f64>> {
    // The crate does not know quantised meshes, which do not matter here.
    let file = gltf::Gltf::from_slice_without_validation(glb).unwrap();
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

/// Runs a script of tests/node.
///
/// # Panics
/// Node or its packages are missing.
pub fn node(script: &str, arguments: &[&Path]) -> std::process::Output {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/node");
    assert!(folder.join("node_modules").is_dir(), "packages are missing: npm ci --prefix tests/node");
    let run = Command::new("node").arg(folder.join(script)).args(arguments).output();
    run.unwrap_or_else(|error| panic!("node: {error}"))
}

/// Chromium to test with: `HANDCAST_CHROMIUM`, or where systems put it.
///
/// # Panics
/// There is none.
pub fn chromium() -> PathBuf {
    let named = std::env::var_os("HANDCAST_CHROMIUM").map(PathBuf::from);
    let usual = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    let found = named.into_iter().chain(usual.map(PathBuf::from)).find(|p| p.is_file());
    found.unwrap_or_else(|| panic!("no Chromium: HANDCAST_CHROMIUM names one, otherwise one of {usual:?}"))
}

/// Held by whoever measures or films a browser that draws and tracks with all processors there are: one at a time.
pub fn browser_alone() -> MutexGuard<'static, ()> {
    static BROWSER: Mutex<()> = Mutex::new(());
    BROWSER.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Length of the JSON chunk of a GLB and the document in it.
pub fn document(glb: &[u8]) -> (usize, serde_json::Value) {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    (length, serde_json::from_slice(&glb[20..20 + length]).unwrap())
}

/// Vertices and triangles of the skinned mesh in a GLB at a time, skinned here.
pub fn posed_surface(glb: &[u8], time: f64) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let file = gltf::Gltf::from_slice(glb).unwrap();
    let blob = file.blob.as_deref().unwrap();
    let world = world_transforms(glb, time);
    let node = file.nodes().find(|n| n.skin().is_some()).unwrap();
    let skin = node.skin().unwrap();
    let inverse = skin.reader(|_| Some(blob)).read_inverse_bind_matrices().unwrap();
    let matrices: Vec<Matrix4<f64>> = skin
        .joints()
        .zip(inverse)
        .map(|(joint, inverse)| {
            world[joint.name().unwrap()].to_homogeneous() * Matrix4::from(inverse).cast::<f64>()
        })
        .collect();
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for primitive in node.mesh().unwrap().primitives() {
        let reader = primitive.reader(|_| Some(blob));
        let first = vertices.len() as u32;
        let joints = reader.read_joints(0).unwrap().into_u16();
        let weights = reader.read_weights(0).unwrap().into_f32();
        for ((p, joints), weights) in reader.read_positions().unwrap().zip(joints).zip(weights) {
            let p = Vector3::from(p).cast::<f64>().push(1.0);
            let moved = joints.iter().zip(weights).map(|(&j, w)| matrices[usize::from(j)] * p * f64::from(w));
            vertices.push(moved.sum::<nalgebra::Vector4<f64>>().xyz().cast::<f32>().into());
        }
        let corners: Vec<u32> = reader.read_indices().unwrap().into_u32().map(|i| i + first).collect();
        triangles.extend(corners.as_chunks::<3>().0);
    }
    (vertices, triangles)
}

/// A GLB of a document and a binary chunk.
pub fn container(json: &serde_json::Value, chunk: &[u8]) -> Vec<u8> {
    let mut text = serde_json::to_vec(json).unwrap();
    text.resize(text.len().next_multiple_of(4), b' ');
    let word = |n: usize| u32::try_from(n).unwrap().to_le_bytes();
    let total = 28 + text.len() + chunk.len();
    let head = [b"glTF".as_slice(), &word(2), &word(total), &word(text.len()), b"JSON", &text].concat();
    [head.as_slice(), &word(chunk.len()), b"BIN\0", chunk].concat()
}
