//! Poses to a GLB file.

use std::collections::{BTreeMap, HashMap};

use gltf_json::accessor::{Accessor, ComponentType, Type};
use gltf_json::animation::{Animation, Channel, Interpolation, Property, Sampler, Target};
use gltf_json::buffer::Target as BufferTarget;
use gltf_json::mesh::{Mode, Primitive, Semantic};
use gltf_json::scene::Node;
use gltf_json::validation::Checked;
use gltf_json::{Index, Material, Mesh, Scene, Skin};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use super::keys::{self, Key};
use super::writer::{Layout, Writer};
use super::{Clip, ExportOptions, GltfError, HandTrack, ours_from_webxr, prefix};
use crate::hand::{HandMesh, Joint, Side, Skeleton};
use crate::render::linear_from_srgb;

/// Rotations (radians) and translations (metres) that stay this close to the first key keep still.
const STILL: f64 = 1e-6;

/// Vertex colours are stored as shares of this, so that factors above 1 fit into bytes.
const BRIGHTEST_TINT: f32 = 1.25;

/// Writes the clip as a binary glTF file.
///
/// # Errors
/// [`GltfError`] for an empty clip, two tracks for one side, times that do not increase, poses that are
/// not finite, or sizes out of range.
pub fn export(clip: &Clip, options: &ExportOptions) -> Result<Vec<u8>, GltfError> {
    if clip.hands.is_empty() {
        return Err(GltfError::Empty { what: "the clip" });
    }
    let sides = clip.hands.iter().map(check_track).collect::<Result<Vec<_>, _>>()?;
    if let Some(i) = (1..sides.len()).find(|&i| sides[..i].contains(&sides[i])) {
        return Err(GltfError::Sides { what: "several tracks", side: sides[i] });
    }
    let mut writer = Writer::new(format!("handcast {}", env!("CARGO_PKG_VERSION")));
    let material = (!options.animation_only).then(|| writer.root.push(material(options)));
    let mut scene = Vec::new();
    let mut channels = Channels::default();
    for (track, side) in clip.hands.iter().zip(&sides) {
        let locals = local_tracks(track, *side);
        let nodes = push_nodes(&mut writer, &locals, *side, clip.hands.len(), options);
        scene.push(nodes[0]);
        if let Some(material) = material {
            scene.push(push_skinned_mesh(&mut writer, track, *side, &nodes, material));
        }
        channels.push_track(&mut writer, track, &locals, &nodes, options);
    }
    writer.root.push(Animation {
        extensions: None,
        extras: None,
        channels: channels.channels,
        name: Some("motion".into()),
        samplers: channels.samplers,
    });
    let scene = writer.root.push(Scene { extensions: None, extras: None, name: None, nodes: scene });
    writer.root.scene = Some(scene);
    writer.root.asset.extras = Some(asset_extras(clip, &sides, options)?);
    writer.finish()
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

/// Transforms relative to the parent joint, in WebXR axes: for each joint, one for each pose.
fn local_tracks(track: &HandTrack, side: Side) -> Vec<Vec<Isometry3<f64>>> {
    let skeleton = Skeleton::new(&track.morphology, side);
    let turn = ours_from_webxr();
    let mut locals = vec![Vec::with_capacity(track.poses.len()); Joint::ALL.len()];
    for (_, pose) in &track.poses {
        let frames = skeleton.frames(pose);
        for (joint, local) in Joint::ALL.into_iter().zip(&mut locals) {
            let world = frames.get(joint) * turn;
            local.push(match joint.parent() {
                Some(parent) => (frames.get(parent) * turn).inverse() * world,
                None => world,
            });
        }
    }
    locals
}

fn quaternion(q: &UnitQuaternion<f64>) -> [f32; 4] {
    q.coords.cast::<f32>().into()
}

/// The joint nodes at the first pose, wrist first.
fn push_nodes(
    writer: &mut Writer,
    locals: &[Vec<Isometry3<f64>>],
    side: Side,
    hands: usize,
    options: &ExportOptions,
) -> Vec<Index<Node>> {
    let first = writer.root.nodes.len() as u32;
    let index = |joint: Joint| Index::new(first + joint.index() as u32);
    for (joint, local) in Joint::ALL.into_iter().zip(locals) {
        let rest = local.first().copied().unwrap_or_else(Isometry3::identity);
        let children: Vec<_> =
            Joint::ALL.into_iter().filter(|j| j.parent() == Some(joint)).map(index).collect();
        let extras = (joint == Joint::Wrist)
            .then(|| serde_json::value::to_raw_value(&serde_json::json!({ "side": side.name() })).ok());
        writer.root.push(Node {
            name: Some(format!("{}{}", prefix(side, hands), options.names.name(joint))),
            children: (!children.is_empty()).then_some(children),
            translation: Some(rest.translation.vector.cast::<f32>().into()),
            rotation: Some(gltf_json::scene::UnitQuaternion(quaternion(&rest.rotation))),
            extras: extras.flatten(),
            ..Default::default()
        });
    }
    Joint::ALL.into_iter().map(index).collect()
}

/// The skin-coloured material of all hands.
fn material(options: &ExportOptions) -> Material {
    let [r, g, b] = options.skin.map(|v| (linear_from_srgb(v) * BRIGHTEST_TINT).min(1.0));
    Material {
        name: Some("skin".into()),
        pbr_metallic_roughness: gltf_json::material::PbrMetallicRoughness {
            base_color_factor: gltf_json::material::PbrBaseColorFactor([r, g, b, 1.0]),
            metallic_factor: gltf_json::material::StrengthFactor(0.0),
            roughness_factor: gltf_json::material::StrengthFactor(0.6),
            ..Default::default()
        },
        ..Default::default()
    }
}

/// Mesh, skin and the node that joins them; the node is a root of the scene, since a skinned mesh
/// ignores the nodes above it.
fn push_skinned_mesh(
    writer: &mut Writer,
    track: &HandTrack,
    side: Side,
    joints: &[Index<Node>],
    material: Index<Material>,
) -> Index<Node> {
    let mesh = HandMesh::generate(&track.morphology, side);
    let name = format!("{}-hand", side.name());
    let count = mesh.positions.len();
    let vertices = |kind, component, normalized| Layout {
        kind,
        component,
        normalized,
        target: Some(BufferTarget::ArrayBuffer),
    };
    let mut attributes = BTreeMap::new();
    let position = writer.bounded_floats(&mesh.positions, Layout::vertices(Type::Vec3));
    attributes.insert(Checked::Valid(Semantic::Positions), position);
    let normal = writer.floats(mesh.normals.iter().copied(), Layout::vertices(Type::Vec3));
    attributes.insert(Checked::Valid(Semantic::Normals), normal);
    let uv = writer.floats(mesh.uvs.iter().copied(), Layout::vertices(Type::Vec2));
    attributes.insert(Checked::Valid(Semantic::TexCoords(0)), uv);
    let colours: Vec<u8> = mesh
        .tints
        .iter()
        .flat_map(|t| {
            let [r, g, b] = t.map(|v| (v / BRIGHTEST_TINT * 255.0).round().clamp(0.0, 255.0) as u8);
            [r, g, b, 255]
        })
        .collect();
    let colour = writer.accessor(&colours, count, vertices(Type::Vec4, ComponentType::U8, true));
    attributes.insert(Checked::Valid(Semantic::Colors(0)), colour);
    let carriers: Vec<u8> = mesh.joints.iter().flatten().copied().collect();
    let carrier = writer.accessor(&carriers, count, vertices(Type::Vec4, ComponentType::U8, false));
    attributes.insert(Checked::Valid(Semantic::Joints(0)), carrier);
    let weight = writer.floats(mesh.weights.iter().copied(), Layout::vertices(Type::Vec4));
    attributes.insert(Checked::Valid(Semantic::Weights(0)), weight);

    let corners: Vec<u8> = mesh.triangles.iter().flatten().flat_map(|&i| (i as u16).to_le_bytes()).collect();
    let wide: Vec<u8> = mesh.triangles.iter().flatten().flat_map(|&i| i.to_le_bytes()).collect();
    let (data, component) = if count <= usize::from(u16::MAX) {
        (corners, ComponentType::U16)
    } else {
        (wide, ComponentType::U32)
    };
    let layout = Layout {
        kind: Type::Scalar,
        component,
        normalized: false,
        target: Some(BufferTarget::ElementArrayBuffer),
    };
    let indices = writer.accessor(&data, mesh.triangles.len() * 3, layout);

    let turn = ours_from_webxr();
    let inverse = mesh.bind.0.map(|frame| {
        let matrix = (frame * turn).inverse().to_homogeneous().cast::<f32>();
        let mut columns = [0.0f32; 16];
        columns.copy_from_slice(matrix.as_slice());
        columns
    });
    let inverse_bind = writer.floats(inverse.into_iter(), Layout::floats(Type::Mat4));
    let skin = writer.root.push(Skin {
        extensions: None,
        extras: None,
        inverse_bind_matrices: Some(inverse_bind),
        joints: joints.to_vec(),
        name: Some(name.clone()),
        skeleton: joints.first().copied(),
    });
    let mesh = writer.root.push(Mesh {
        extensions: None,
        extras: None,
        name: Some(name.clone()),
        primitives: vec![Primitive {
            attributes,
            extensions: None,
            extras: None,
            indices: Some(indices),
            material: Some(material),
            mode: Checked::Valid(Mode::Triangles),
            targets: None,
        }],
        weights: None,
    });
    writer.root.push(Node { name: Some(name), mesh: Some(mesh), skin: Some(skin), ..Default::default() })
}

/// Channels of the one animation; equal lists of times are stored once.
#[derive(Default)]
struct Channels {
    channels: Vec<Channel>,
    samplers: Vec<Sampler>,
    times: HashMap<Vec<u32>, Index<Accessor>>,
}

impl Channels {
    fn push_track(
        &mut self,
        writer: &mut Writer,
        track: &HandTrack,
        locals: &[Vec<Isometry3<f64>>],
        nodes: &[Index<Node>],
        options: &ExportOptions,
    ) {
        let times: Vec<f64> = track.poses.iter().map(|(t, _)| *t).collect();
        for (joint, (local, node)) in Joint::ALL.into_iter().zip(locals.iter().zip(nodes)) {
            // Without any track the clip would lose its duration: the wrist always has one.
            let root = joint == Joint::Wrist;
            let translations: Vec<Vector3<f64>> = local.iter().map(|i| i.translation.vector).collect();
            if root {
                let kept = keys::reduce(&times, &translations, options.translation_tolerance);
                let output = writer.floats(
                    kept.iter().map(|&k| translations[k].cast::<f32>().into()),
                    Layout::floats(Type::Vec3),
                );
                self.push(writer, &times, &kept, output, *node, Property::Translation);
            }
            let mut rotations: Vec<UnitQuaternion<f64>> = local.iter().map(|i| i.rotation).collect();
            if !moves(&rotations) {
                continue;
            }
            keys::make_continuous(&mut rotations);
            let kept = keys::reduce(&times, &rotations, options.rotation_tolerance);
            let output =
                writer.floats(kept.iter().map(|&k| quaternion(&rotations[k])), Layout::floats(Type::Vec4));
            self.push(writer, &times, &kept, output, *node, Property::Rotation);
        }
    }

    fn push(
        &mut self,
        writer: &mut Writer,
        times: &[f64],
        kept: &[usize],
        output: Index<Accessor>,
        node: Index<Node>,
        property: Property,
    ) {
        let rows: Vec<[f32; 1]> = kept.iter().map(|&k| [times[k] as f32]).collect();
        let bits: Vec<u32> = rows.iter().map(|t| t[0].to_bits()).collect();
        let input = *self
            .times
            .entry(bits)
            .or_insert_with(|| writer.bounded_floats(&rows, Layout::floats(Type::Scalar)));
        let sampler = Index::new(self.samplers.len() as u32);
        self.samplers.push(Sampler {
            extensions: None,
            extras: None,
            input,
            interpolation: Checked::Valid(Interpolation::Linear),
            output,
        });
        self.channels.push(Channel {
            sampler,
            target: Target { extensions: None, extras: None, node, path: Checked::Valid(property) },
            extensions: None,
            extras: None,
        });
    }
}

fn moves<K: Key>(keys: &[K]) -> bool {
    keys.first().is_some_and(|first| keys.iter().any(|k| k.distance(first) > STILL))
}

fn asset_extras(
    clip: &Clip,
    sides: &[Side],
    options: &ExportOptions,
) -> Result<Box<serde_json::value::RawValue>, GltfError> {
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
    Ok(serde_json::value::to_raw_value(&serde_json::json!({ "handcast": facts }))?)
}
