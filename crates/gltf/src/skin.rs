//! Mesh and skin of a hand, in floats or quantised (`KHR_mesh_quantization`).

use std::collections::BTreeMap;

use gltf_json::accessor::{Accessor, ComponentType, Type};
use gltf_json::buffer::Target as BufferTarget;
use gltf_json::mesh::{Mode, Primitive, Semantic};
use gltf_json::scene::Node;
use gltf_json::validation::Checked;
use gltf_json::{Index, Material, Mesh, Skin};
use nalgebra::{Matrix4, Vector3};

use super::writer::{Layout, Writer};
use super::{ExportOptions, HandTrack};
use handcast_hand::linear_from_srgb;
use handcast_hand::turns::ours_from_webxr;
use handcast_hand::{HandMesh, Side};

/// Vertex colours are stored as shares of this, so that factors above 1 fit into bytes.
const BRIGHTEST_TINT: f32 = 1.25;
const QUANTIZATION: &str = "KHR_mesh_quantization";

/// The skin-coloured material of all hands.
pub(super) fn material(options: &ExportOptions) -> Material {
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
pub(super) fn push_skinned_mesh(
    writer: &mut Writer,
    track: &HandTrack,
    side: Side,
    joints: &[Index<Node>],
    material: Index<Material>,
    quantize: bool,
) -> Index<Node> {
    let mesh = HandMesh::generate(&track.morphology, side);
    let name = format!("{}-hand", side.name());
    let cube = quantize.then(|| Cube::around(&mesh.positions));
    let (mut attributes, indices) = match &cube {
        Some(cube) => (quantized(writer, &mesh, cube), triangles(writer, &mesh)),
        None => (floats(writer, &mesh), triangles(writer, &mesh)),
    };
    let colours: Vec<u8> = mesh
        .tints
        .iter()
        .flat_map(|t| {
            let [r, g, b] = t.map(|v| (v / BRIGHTEST_TINT * 255.0).round().clamp(0.0, 255.0) as u8);
            [r, g, b, 255]
        })
        .collect();
    let count = mesh.positions.len();
    let colour = writer.accessor(&colours, count, bytes(Type::Vec4, ComponentType::U8, true));
    attributes.insert(Checked::Valid(Semantic::Colors(0)), colour);
    // Where the weight is stored as 0 there is no joint.
    let stored = |joint: u8, weight: u8| if quantize && weight == 0 { 0 } else { joint };
    let carriers: Vec<u8> = mesh
        .joints
        .iter()
        .zip(&mesh.weights)
        .flat_map(|(joints, weights)| {
            let weights = weight_bytes(weights);
            std::array::from_fn::<u8, 4, _>(|k| stored(joints[k], weights[k]))
        })
        .collect();
    let carrier = writer.accessor(&carriers, count, bytes(Type::Vec4, ComponentType::U8, false));
    attributes.insert(Checked::Valid(Semantic::Joints(0)), carrier);

    let turn = ours_from_webxr();
    // A skinned mesh ignores its node's transform: what undoes the quantisation goes before the bind.
    let undo = cube.map_or_else(Matrix4::identity, |cube| cube.undo());
    let inverse = mesh.bind.0.map(|frame| {
        let matrix = ((frame * turn).inverse().to_homogeneous() * undo).cast::<f32>();
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
    if quantize && !writer.root.extensions_used.iter().any(|e| e == QUANTIZATION) {
        writer.root.extensions_used.push(QUANTIZATION.into());
        writer.root.extensions_required.push(QUANTIZATION.into());
    }
    writer.root.push(Node { name: Some(name), mesh: Some(mesh), skin: Some(skin), ..Default::default() })
}

type Attributes = BTreeMap<Checked<Semantic>, Index<Accessor>>;

fn bytes(kind: Type, component: ComponentType, normalized: bool) -> Layout {
    Layout { component, normalized, ..Layout::vertices(kind) }
}

fn floats(writer: &mut Writer, mesh: &HandMesh) -> Attributes {
    let mut attributes = BTreeMap::new();
    let position = writer.bounded_floats(&mesh.positions, Layout::vertices(Type::Vec3));
    attributes.insert(Checked::Valid(Semantic::Positions), position);
    let normal = writer.floats(mesh.normals.iter().copied(), Layout::vertices(Type::Vec3));
    attributes.insert(Checked::Valid(Semantic::Normals), normal);
    let uv = writer.floats(mesh.uvs.iter().copied(), Layout::vertices(Type::Vec2));
    attributes.insert(Checked::Valid(Semantic::TexCoords(0)), uv);
    let weight = writer.floats(mesh.weights.iter().copied(), Layout::vertices(Type::Vec4));
    attributes.insert(Checked::Valid(Semantic::Weights(0)), weight);
    attributes
}

/// Positions as normalised shorts in a cube, normals as bytes, texture coordinates as shorts, weights as
/// bytes that add up to 255.
fn quantized(writer: &mut Writer, mesh: &HandMesh, cube: &Cube) -> Attributes {
    let mut attributes = BTreeMap::new();
    let count = mesh.positions.len();
    let rows: Vec<[i16; 3]> = mesh.positions.iter().map(|p| cube.shorts(p)).collect();
    let data: Vec<u8> = rows.iter().flat_map(|&[x, y, z]| [x, y, z, 0]).flat_map(i16::to_le_bytes).collect();
    let layout = Layout { stride: Some(8), ..bytes(Type::Vec3, ComponentType::I16, true) };
    let position = writer.accessor(&data, count, layout);
    writer.set_bounds(position, &rows.iter().map(|r| r.map(f32::from)).collect::<Vec<_>>());
    attributes.insert(Checked::Valid(Semantic::Positions), position);

    let byte = |v: f32| ((v * 127.0).round() as i8).to_le_bytes()[0];
    let data: Vec<u8> = mesh.normals.iter().flat_map(|&[x, y, z]| [byte(x), byte(y), byte(z), 0]).collect();
    let layout = Layout { stride: Some(4), ..bytes(Type::Vec3, ComponentType::I8, true) };
    attributes.insert(Checked::Valid(Semantic::Normals), writer.accessor(&data, count, layout));

    let data: Vec<u8> = mesh
        .uvs
        .iter()
        .flatten()
        .flat_map(|v| ((v.clamp(0.0, 1.0) * 65535.0).round() as u16).to_le_bytes())
        .collect();
    let uv = writer.accessor(&data, count, bytes(Type::Vec2, ComponentType::U16, true));
    attributes.insert(Checked::Valid(Semantic::TexCoords(0)), uv);

    let data: Vec<u8> = mesh.weights.iter().flat_map(weight_bytes).collect();
    let weight = writer.accessor(&data, count, bytes(Type::Vec4, ComponentType::U8, true));
    attributes.insert(Checked::Valid(Semantic::Weights(0)), weight);
    attributes
}

/// Weights in 255ths that add up to 255: what rounding leaves goes to the largest.
fn weight_bytes(weights: &[f32; 4]) -> [u8; 4] {
    let mut out = weights.map(|w| (w * 255.0).round().clamp(0.0, 255.0) as u8);
    let sum: i32 = out.iter().map(|&b| i32::from(b)).sum();
    if let Some(largest) = out.iter_mut().max() {
        *largest = (i32::from(*largest) + 255 - sum).clamp(0, 255) as u8;
    }
    out
}

fn triangles(writer: &mut Writer, mesh: &HandMesh) -> Index<Accessor> {
    let corners = mesh.triangles.iter().flatten();
    let (data, component): (Vec<u8>, _) = if mesh.positions.len() <= usize::from(u16::MAX) {
        (corners.flat_map(|&i| (i as u16).to_le_bytes()).collect(), ComponentType::U16)
    } else {
        (corners.flat_map(|&i| i.to_le_bytes()).collect(), ComponentType::U32)
    };
    let layout =
        Layout { component, target: Some(BufferTarget::ElementArrayBuffer), ..Layout::floats(Type::Scalar) };
    writer.accessor(&data, mesh.triangles.len() * 3, layout)
}

/// The cube whose sides are ±1 of the quantised positions: a cube, so that normals keep their directions.
struct Cube {
    centre: Vector3<f64>,
    half: f64,
}

impl Cube {
    fn around(points: &[[f32; 3]]) -> Self {
        let bound = |pick: fn(f64, f64) -> f64| {
            let points = points.iter().map(|&p| Vector3::from(p).cast::<f64>());
            points.reduce(|a, b| a.zip_map(&b, pick)).unwrap_or_default()
        };
        let (low, high) = (bound(f64::min), bound(f64::max));
        Self { centre: (low + high) / 2.0, half: ((high - low) / 2.0).max().max(1e-9) }
    }

    fn shorts(&self, point: &[f32; 3]) -> [i16; 3] {
        let p = (Vector3::from(*point).cast::<f64>() - self.centre) / self.half;
        p.map(|v| (v * 32767.0).round() as i16).into()
    }

    fn undo(&self) -> Matrix4<f64> {
        Matrix4::new_translation(&self.centre) * Matrix4::new_scaling(self.half)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_in_bytes_add_up() {
        for weights in
            [[0.25; 4], [1.0, 0.0, 0.0, 0.0], [0.334, 0.333, 0.333, 0.0], [0.9, 0.05, 0.049, 0.001]]
        {
            let bytes = weight_bytes(&weights);
            assert_eq!(bytes.iter().map(|&b| u32::from(b)).sum::<u32>(), 255);
            for (b, w) in bytes.iter().zip(weights) {
                assert!((f32::from(*b) / 255.0 - w).abs() < 0.008);
            }
        }
    }

    #[test]
    fn positions_come_back_within_half_a_step() {
        let points = [[0.1, -0.2, 0.3], [0.12, 0.0, 0.28], [0.05, -0.01, 0.31f32]];
        let cube = Cube::around(&points);
        for p in points {
            let q = Vector3::from(cube.shorts(&p)).map(|v| f64::from(v) / 32767.0);
            let back = cube.undo().transform_point(&q.into());
            assert!((back.coords - Vector3::from(p).cast()).abs().max() < 0.51 * cube.half / 32767.0);
        }
    }
}
