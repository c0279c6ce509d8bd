//! Poses to a GLB file.

use gltf_json::scene::Node;
use gltf_json::{Index, Material, Scene};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::animation::{Channels, moves};
use super::skin::{push_material, push_skinned_mesh};
use super::writer::Writer;
use super::{Clip, ExportOptions, FRAME_RATE, GltfError, HandTrack, START};
use handcast_hand::{HandPose, Joint, Morphology, PLAIN_SKIN, Side, Skeleton};

/// What the wrist's `extras` call the axes of the nodes.
pub(super) const AXES: &str = "axes";
/// Rotations that stay this close to their node's keep still, radians.
const STILL: f64 = 1e-6;

/// Writes the clip as a binary glTF file.
///
/// # Errors
/// [`GltfError`] for an empty clip, two tracks for one side, times that do not increase, poses that are
/// not finite, or sizes out of range.
pub fn export(clip: &Clip, options: &ExportOptions) -> Result<Vec<u8>, GltfError> {
    let sides = check_clip(clip)?;
    let mut writer = Writer::new(generator());
    let mut materials: Vec<(&Morphology, Index<Material>)> = Vec::new();
    let skin = options.skin.or(clip.skin).unwrap_or(PLAIN_SKIN);
    let mut scene = Vec::new();
    let mut channels = Channels::new(options);
    for (track, side) in clip.hands.iter().zip(&sides) {
        let turns = options.axes.turns(&track.morphology, *side);
        let locals = local_tracks(track, *side, &turns);
        let rests = rests(track, *side, &turns, &locals, options);
        let nodes = push_nodes(&mut writer, &rests, *side, clip.hands.len(), options);
        scene.push(nodes[0]);
        if !options.animation_only {
            let mesh = options.skins.mesh(&track.morphology, *side);
            // Hands of the same sizes have the same textures.
            let made = materials.iter().find(|(sizes, _)| **sizes == track.morphology);
            let material = match made {
                Some((_, material)) => *material,
                None => push_material(&mut writer, &mesh, &track.morphology, skin, options),
            };
            materials.push((&track.morphology, material));
            scene.push(push_skinned_mesh(&mut writer, &mesh, &nodes, &turns, material, options.quantize));
        }
        push_track(&mut channels, &mut writer, track, &locals, (&rests, &nodes));
    }
    writer.root.push(channels.finish());
    let scene = writer.root.push(Scene { extensions: None, extras: None, name: None, nodes: scene });
    writer.root.scene = Some(scene);
    let facts = serde_json::json!({ "handcast": facts(clip, &sides, options) });
    writer.root.asset.extras = Some(serde_json::value::to_raw_value(&facts)?);
    writer.finish()
}

/// What `asset.generator` says.
pub(super) fn generator() -> String {
    format!("handcast {}", env!("CARGO_PKG_VERSION"))
}

/// The sides of the tracks of a clip that can be written.
pub(super) fn check_clip(clip: &Clip) -> Result<Vec<Side>, GltfError> {
    if clip.hands.is_empty() {
        return Err(GltfError::Empty { what: "the clip" });
    }
    let sides = clip.hands.iter().map(check_track).collect::<Result<Vec<_>, _>>()?;
    match (1..sides.len()).find(|&i| sides[..i].contains(&sides[i])) {
        Some(i) => Err(GltfError::Sides { what: "several tracks", side: sides[i] }),
        None => Ok(sides),
    }
}

/// The side of a track whose poses can be written.
fn check_track(track: &HandTrack) -> Result<Side, GltfError> {
    track.morphology.validate()?;
    let Some((_, first)) = track.poses.first() else {
        return Err(GltfError::Empty { what: "a hand's track" });
    };
    let mut previous: Option<f64> = None;
    for (index, (time, pose)) in track.poses.iter().enumerate() {
        let time = *time;
        let follows = previous.is_none_or(|p| (time as f32) > (p as f32));
        if !(time.is_finite() && time >= 0.0 && follows) {
            return Err(GltfError::Time { index, time, previous: previous.unwrap_or(0.0) });
        }
        if pose.side != first.side {
            return Err(GltfError::Sides { what: "poses of both sides in the track", side: first.side });
        }
        if !pose.is_finite() {
            return Err(GltfError::Pose { index, side: pose.side });
        }
        previous = Some(time);
    }
    Ok(first.side)
}

/// Transforms relative to the parent joint, the nodes turned by `turns`: for each joint, one for each pose.
fn local_tracks(
    track: &HandTrack,
    side: Side,
    turns: &[UnitQuaternion<f64>; Joint::COUNT],
) -> Vec<Vec<Isometry3<f64>>> {
    let skeleton = Skeleton::new(&track.morphology, side);
    let mut locals = vec![Vec::with_capacity(track.poses.len()); Joint::ALL.len()];
    for (_, pose) in &track.poses {
        for (joint, local) in locals_of(&skeleton, pose, turns).into_iter().zip(&mut locals) {
            local.push(joint);
        }
    }
    locals
}

/// Transforms of a pose's joints relative to their parents, the nodes turned by `turns`.
fn locals_of(
    skeleton: &Skeleton,
    pose: &HandPose,
    turns: &[UnitQuaternion<f64>; Joint::COUNT],
) -> [Isometry3<f64>; Joint::COUNT] {
    let frames = skeleton.frames(pose);
    let turned = |joint: Joint| frames.get(joint) * turns[joint.index()];
    Joint::ALL.map(|joint| match joint.parent() {
        Some(parent) => turned(parent).inverse() * turned(joint),
        None => turned(joint),
    })
}

/// How the nodes stand: as in the first pose, which a file shows that is not played. Where no skin says how the hand rests the
/// nodes do, with straight fingers: other programs, and this one, read motions by how joints are turned from there.
fn rests(
    track: &HandTrack,
    side: Side,
    turns: &[UnitQuaternion<f64>; Joint::COUNT],
    locals: &[Vec<Isometry3<f64>>],
    options: &ExportOptions,
) -> [Isometry3<f64>; Joint::COUNT] {
    let first = |joint: Joint| locals[joint.index()].first().copied().unwrap_or_else(Isometry3::identity);
    if !options.animation_only {
        return Joint::ALL.map(first);
    }
    let skeleton = Skeleton::new(&track.morphology, side);
    let mut rests = locals_of(&skeleton, &HandPose::neutral(side), turns);
    rests[Joint::Wrist.index()] = first(Joint::Wrist);
    rests
}

/// The joint nodes, wrist first.
fn push_nodes(
    writer: &mut Writer,
    rests: &[Isometry3<f64>; Joint::COUNT],
    side: Side,
    hands: usize,
    options: &ExportOptions,
) -> Vec<Index<Node>> {
    let first = writer.root.nodes.len() as u32;
    let index = |joint: Joint| Index::new(first + joint.index() as u32);
    let palm = options.names.palm(side);
    for (joint, rest) in Joint::ALL.into_iter().zip(rests) {
        let mut children: Vec<_> =
            Joint::ALL.into_iter().filter(|j| j.parent() == Some(joint)).map(index).collect();
        if palm.is_some() && joint == Joint::MiddleMetacarpal {
            children.push(Index::new(first + Joint::ALL.len() as u32));
        }
        let extras = (joint == Joint::Wrist)
            .then(|| serde_json::json!({ "side": side.name(), AXES: options.axes.name() }))
            .and_then(|facts| serde_json::value::to_raw_value(&facts).ok());
        writer.root.push(Node {
            name: Some(options.names.name(joint, side, hands)),
            children: (!children.is_empty()).then_some(children),
            translation: Some(rest.translation.vector.cast::<f32>().into()),
            rotation: Some(gltf_json::scene::UnitQuaternion(rest.rotation.coords.cast::<f32>().into())),
            extras,
            ..Default::default()
        });
    }
    if let Some(name) = palm {
        // OpenXR: in the middle of the middle finger's metacarpal bone.
        let middle = rests[Joint::MiddleProximal.index()].translation.vector / 2.0;
        writer.root.push(Node {
            name: Some(name.into()),
            translation: Some(middle.cast::<f32>().into()),
            ..Default::default()
        });
    }
    Joint::ALL.into_iter().map(index).collect()
}

fn push_track(
    channels: &mut Channels,
    writer: &mut Writer,
    track: &HandTrack,
    locals: &[Vec<Isometry3<f64>>],
    (rests, nodes): (&[Isometry3<f64>; Joint::COUNT], &[Index<Node>]),
) {
    let times: Vec<f64> = track.poses.iter().map(|(t, _)| *t).collect();
    for (joint, (local, node)) in Joint::ALL.into_iter().zip(locals.iter().zip(nodes)) {
        // Without any track the clip would lose its duration: the wrist always has one.
        if joint == Joint::Wrist {
            let keys: Vec<Vector3<f64>> = local.iter().map(|i| i.translation.vector).collect();
            channels.translation(writer, &times, &keys, 1.0, *node);
        }
        let keys: Vec<UnitQuaternion<f64>> = local.iter().map(|i| i.rotation).collect();
        if moves(&keys, &rests[joint.index()].rotation, STILL) {
            channels.rotation(writer, &times, keys, *node);
        }
    }
}

/// What the file says of where it comes from.
pub(super) fn facts(clip: &Clip, sides: &[Side], options: &ExportOptions) -> serde_json::Value {
    let hands: Vec<_> = clip
        .hands
        .iter()
        .zip(sides)
        .map(|(track, side)| {
            serde_json::json!({
                "side": side.name(),
                "frames": track.poses.len(),
                "morphology": track.morphology,
            })
        })
        .collect();
    let mut facts = options.extras.clone();
    facts.insert("hands".into(), hands.into());
    if let Some(rate) = clip.rate {
        facts.insert(FRAME_RATE.into(), rate.into());
    }
    if clip.start != 0.0 {
        facts.insert(START.into(), clip.start.into());
    }
    facts.into()
}
