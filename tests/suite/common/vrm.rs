//! Avatars to move: the humanoid bones of VRM 0 and VRM 1.0 in the T-pose, without a mesh.

use std::collections::HashMap;

use handcast_hand::{Finger, HandPose, Joint, Morphology, Side, Skeleton};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};

/// Version of VRM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Vrm {
    /// Faces −z; nodes have the axes of the model.
    Zero,
    /// Faces +z; nodes may be turned as they like.
    One,
}

/// A node: its name as VRM 1.0 has it, the node above it, its place in the T-pose facing +z.
struct Node(String, Option<usize>, Vector3<f64>);

/// Body and arms, then the fingers.
fn nodes() -> Vec<Node> {
    let mut nodes: Vec<Node> = Vec::new();
    let mut put = |name: &str, above: Option<&str>, [x, y, z]: [f64; 3]| {
        let above = above.map(|above| nodes.iter().position(|n| n.0 == above).unwrap());
        nodes.push(Node(name.into(), above, Vector3::new(x, y, z)));
    };
    put("hips", None, [0.0, 0.9, 0.0]);
    for (name, above, y) in
        [("spine", "hips", 1.0), ("chest", "spine", 1.15), ("neck", "chest", 1.35), ("head", "neck", 1.45)]
    {
        put(name, Some(above), [0.0, y, 0.0]);
    }
    for (side, out) in [("left", 1.0), ("right", -1.0)] {
        let name = |bone: &str| format!("{side}{bone}");
        put(&name("UpperLeg"), Some("hips"), [0.1 * out, 0.85, 0.0]);
        put(&name("LowerLeg"), Some(&name("UpperLeg")), [0.1 * out, 0.45, 0.0]);
        put(&name("Foot"), Some(&name("LowerLeg")), [0.1 * out, 0.08, 0.0]);
        put(&name("UpperArm"), Some("chest"), [0.15 * out, 1.3, 0.0]);
        put(&name("LowerArm"), Some(&name("UpperArm")), [0.4 * out, 1.3, 0.0]);
        put(&name("Hand"), Some(&name("LowerArm")), [0.63 * out, 1.3, 0.0]);
        let thumb = [("Metacarpal", 0.0), ("Proximal", 0.03), ("Distal", 0.055), ("Tip", 0.08)];
        let mut above = name("Hand");
        for (bone, along) in thumb {
            let along = along * std::f64::consts::FRAC_1_SQRT_2;
            let name = name(&format!("Thumb{bone}"));
            put(&name, Some(&above), [(0.655 + along) * out, 1.295, 0.025 + along]);
            above = name;
        }
        for (finger, z, long) in
            [("Index", 0.025, 1.0), ("Middle", 0.004, 1.1), ("Ring", -0.015, 1.0), ("Little", -0.032, 0.8)]
        {
            let bones = [("Proximal", 0.0), ("Intermediate", 0.035), ("Distal", 0.057), ("Tip", 0.075)];
            let mut above = name("Hand");
            for (bone, along) in bones {
                let name = name(&format!("{finger}{bone}"));
                put(&name, Some(&above), [(0.72 + along * long) * out, 1.3, z]);
                above = name;
            }
        }
    }
    nodes
}

/// How a node of the avatar is turned at rest.
fn turned(version: Vrm, node: usize) -> UnitQuaternion<f64> {
    match version {
        Vrm::Zero => UnitQuaternion::identity(),
        Vrm::One => {
            let k = node as f64;
            UnitQuaternion::from_scaled_axis(Vector3::new((2.0 * k).sin(), (3.0 * k).cos(), (5.0 * k).sin()))
        }
    }
}

/// The avatar as a GLB file.
pub fn avatar(version: Vrm) -> Vec<u8> {
    let nodes = nodes();
    let face = match version {
        Vrm::Zero => UnitQuaternion::from_scaled_axis(Vector3::y() * std::f64::consts::PI),
        Vrm::One => UnitQuaternion::identity(),
    };
    let world: Vec<Isometry3<f64>> = nodes
        .iter()
        .enumerate()
        .map(|(k, node)| Isometry3::from_parts(Translation3::from(face * node.2), turned(version, k)))
        .collect();
    let described: Vec<Value> = nodes
        .iter()
        .enumerate()
        .map(|(k, node)| {
            let local = node.1.map_or(world[k], |above| world[above].inverse() * world[k]);
            let mut described = json!({
                "name": node.0,
                "translation": <[f64; 3]>::from(local.translation.vector),
                "rotation": <[f64; 4]>::from(local.rotation.coords),
            });
            let children: Vec<usize> = (0..nodes.len()).filter(|&c| nodes[c].1 == Some(k)).collect();
            if !children.is_empty() {
                described["children"] = children.into();
            }
            described
        })
        .collect();
    let bones = nodes.iter().enumerate().filter(|(_, node)| !node.0.ends_with("Tip"));
    let mut document = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": described,
    });
    match version {
        Vrm::One => {
            let bones: serde_json::Map<_, _> =
                bones.map(|(k, node)| (node.0.clone(), json!({ "node": k }))).collect();
            let meta =
                json!({ "name": "test", "authors": ["test"], "licenseUrl": "https://vrm.dev/licenses/1.0/" });
            document["extensionsUsed"] = json!(["VRMC_vrm"]);
            document["extensions"]["VRMC_vrm"] =
                json!({ "specVersion": "1.0", "meta": meta, "humanoid": { "humanBones": bones } });
        }
        Vrm::Zero => {
            let bones: Vec<Value> = bones
                .map(|(k, node)| json!({ "bone": name_of_vrm_0(&node.0), "node": k, "useDefaultValues": true }))
                .collect();
            document["extensionsUsed"] = json!(["VRM"]);
            document["extensions"]["VRM"] = json!({
                "specVersion": "0.0", "meta": { "title": "test" }, "humanoid": { "humanBones": bones },
                "materialProperties": [], "blendShapeMaster": { "blendShapeGroups": [] },
                "firstPerson": {}, "secondaryAnimation": { "boneGroups": [], "colliderGroups": [] },
            });
        }
    }
    glb(&document)
}

/// The bones of the thumb have moved up by one since.
fn name_of_vrm_0(name: &str) -> String {
    name.replace("ThumbProximal", "ThumbIntermediate").replace("ThumbMetacarpal", "ThumbProximal")
}

fn glb(document: &Value) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let words = [0x4654_6c67, 2, 20 + text.len() as u32, text.len() as u32, 0x4e4f_534a];
    let mut bytes: Vec<u8> = words.into_iter().flat_map(u32::to_le_bytes).collect();
    bytes.extend(text);
    bytes
}

/// Names of the ends of a finger's bones in a packet of VMC and in [`Joint`].
fn chain(side: Side, finger: Finger) -> [(String, Joint); 4] {
    let side = if side == Side::Left { "Left" } else { "Right" };
    let word = ["Thumb", "Index", "Middle", "Ring", "Little"][finger as usize];
    let joints = Joint::of(finger);
    let joints = &joints[joints.len() - 4..];
    let parts = ["Proximal", "Intermediate", "Distal", "Tip"];
    std::array::from_fn(|k| (format!("{side}{word}{}", parts[k]), joints[k]))
}

/// Most degrees by which directions of bones, and bends between them, differ from the pose's: where the nodes of an avatar are, by
/// their names in a packet.
pub fn worst(pose: &HandPose, places: &HashMap<String, [f64; 3]>) -> [f64; 2] {
    let frames = Skeleton::new(&Morphology::default(), pose.side).frames(pose);
    let mut worst = [0.0f64; 2];
    for finger in Finger::ALL {
        let chain = chain(pose.side, finger);
        let place = |k: usize| Vector3::from(places[&chain[k].0]);
        let theirs: Vec<_> = (0..3).map(|k| place(k + 1) - place(k)).collect();
        let ours: Vec<_> =
            (0..3).map(|k| frames.position(chain[k + 1].1) - frames.position(chain[k].1)).collect();
        for (a, b) in theirs.iter().zip(&ours) {
            worst[0] = worst[0].max(a.angle(b));
        }
        for (a, b) in theirs.windows(2).zip(ours.windows(2)) {
            worst[1] = worst[1].max((a[0].angle(&a[1]) - b[0].angle(&b[1])).abs());
        }
    }
    worst.map(f64::to_degrees)
}
