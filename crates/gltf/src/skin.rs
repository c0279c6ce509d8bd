//! Mesh, skin and material of a hand, in floats or quantised (`KHR_mesh_quantization`).

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use gltf_json::accessor::{Accessor, ComponentType, Type};
use gltf_json::buffer::Target as BufferTarget;
use gltf_json::material::{
    NormalTexture, OcclusionTexture, PbrBaseColorFactor, PbrMetallicRoughness, StrengthFactor,
};
use gltf_json::mesh::{Mode, Primitive, Semantic};
use gltf_json::scene::Node;
use gltf_json::texture::{Info, MagFilter, MinFilter, Sampler, WrappingMode};
use gltf_json::validation::Checked;
use gltf_json::{Index, Material, Mesh, Skin, Texture};
use nalgebra::{Matrix4, UnitQuaternion, Vector3};

use super::writer::{Layout, Writer};
use super::{ExportOptions, png};
use handcast_hand::linear_from_srgb;
use handcast_hand::{HandMesh, Joint, Morphology, Side};

const QUANTIZATION: &str = "KHR_mesh_quantization";

/// Surfaces and textures of hands, which do not depend on how they move: kept from file to file that is written with the same
/// options, or clones of them. They are those of the hands that were written last.
#[derive(Clone, Default)]
pub struct Skins(Arc<Mutex<Kept>>);

#[derive(Default)]
struct Kept {
    meshes: Vec<(Morphology, Arc<HandMesh>)>,
    pictures: Vec<(PictureKey, Arc<Pictures>)>,
}

/// Sizes of the hand, colour of the skin, pixels a side, and steps of levels.
type PictureKey = (Morphology, [u8; 3], usize, u8);

/// Colour, normals, and occlusion with roughness, as PNG.
type Pictures = [Vec<u8>; 3];

/// Most surfaces, and most sets of textures, that are kept: two hands of two people.
const MOST_KEPT: usize = 4;

impl Skins {
    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The surface of a hand.
    pub(super) fn mesh(&self, morphology: &Morphology, side: Side) -> Arc<HandMesh> {
        let is = |kept: &&(Morphology, Arc<HandMesh>)| kept.1.side == side && kept.0 == *morphology;
        if let Some((_, mesh)) = self.kept().meshes.iter().find(is) {
            return mesh.clone();
        }
        let mesh = Arc::new(HandMesh::generate(morphology, side));
        keep(&mut self.kept().meshes, (morphology.clone(), mesh.clone()));
        mesh
    }

    fn pictures(&self, key: PictureKey, make: impl FnOnce() -> Pictures) -> Arc<Pictures> {
        if let Some((_, pictures)) = self.kept().pictures.iter().find(|kept| kept.0 == key) {
            return pictures.clone();
        }
        let pictures = Arc::new(make());
        keep(&mut self.kept().pictures, (key, pictures.clone()));
        pictures
    }
}

fn keep<T>(all: &mut Vec<T>, new: T) {
    if all.len() == MOST_KEPT {
        all.remove(0);
    }
    all.push(new);
}

impl fmt::Debug for Skins {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kept = self.kept();
        write!(f, "Skins({} surfaces, {} sets of textures)", kept.meshes.len(), kept.pictures.len())
    }
}

/// The material of a hand: textures of its skin (sRGB), or a plain colour where none are asked for.
pub(super) fn push_material(
    writer: &mut Writer,
    mesh: &HandMesh,
    morphology: &Morphology,
    skin: [u8; 3],
    options: &ExportOptions,
) -> Index<Material> {
    let side = match options.texture {
        Some(side) if options.quantize => side.min(QUANTIZED_TEXTURE),
        side => side.unwrap_or(0),
    };
    let mut pbr = PbrMetallicRoughness {
        metallic_factor: StrengthFactor(0.0),
        roughness_factor: StrengthFactor(0.6),
        ..Default::default()
    };
    if side == 0 {
        let [r, g, b] = skin.map(linear_from_srgb);
        pbr.base_color_factor = PbrBaseColorFactor([r, g, b, 1.0]);
        let name = Some("skin".into());
        return writer.root.push(Material { name, pbr_metallic_roughness: pbr, ..Default::default() });
    }
    // Steps too small to be seen cost most of a file's bytes.
    let step = if options.quantize { 4 } else { 2 };
    let key = (morphology.clone(), skin, side, step);
    let pictures = options.skins.pictures(key, || painted(mesh, skin, side, step));
    let sampler = writer.root.push(Sampler {
        mag_filter: Some(Checked::Valid(MagFilter::Linear)),
        min_filter: Some(Checked::Valid(MinFilter::LinearMipmapLinear)),
        wrap_s: Checked::Valid(WrappingMode::ClampToEdge),
        wrap_t: Checked::Valid(WrappingMode::ClampToEdge),
        name: None,
        extensions: None,
        extras: None,
    });
    let mut texture = |name: &str, file: &[u8]| {
        let source = writer.picture(file, name);
        let texture = Texture { name: None, sampler: Some(sampler), source, extensions: None, extras: None };
        writer.root.push(texture)
    };
    let colour = texture("skin-colour", &pictures[0]);
    let normal = texture("skin-normal", &pictures[1]);
    let surface = texture("skin-occlusion-roughness", &pictures[2]);
    let info = |index| Info { index, tex_coord: 0, extensions: None, extras: None };
    pbr.base_color_texture = Some(info(colour));
    pbr.metallic_roughness_texture = Some(info(surface));
    pbr.roughness_factor = StrengthFactor(1.0);
    writer.root.push(Material {
        name: Some("skin".into()),
        pbr_metallic_roughness: pbr,
        normal_texture: Some(NormalTexture {
            index: normal,
            scale: 1.0,
            tex_coord: 0,
            extensions: None,
            extras: None,
        }),
        occlusion_texture: Some(OcclusionTexture {
            index: surface,
            strength: StrengthFactor(1.0),
            tex_coord: 0,
            extensions: None,
            extras: None,
        }),
        ..Default::default()
    })
}

/// The textures of a hand, in steps of so many levels.
fn painted(mesh: &HandMesh, skin: [u8; 3], side: usize, step: u8) -> Pictures {
    let maps = mesh.maps(side, skin);
    let side = maps.side;
    let coarse = |pixels: &[[u8; 3]], step: u8| -> Vec<[u8; 3]> {
        pixels.iter().map(|p| p.map(|v| v.saturating_add(step / 2) / step * step)).collect()
    };
    let half = halved(&maps.surface, side);
    std::thread::scope(|scope| {
        let maps = [
            (side, coarse(&maps.colour, step)),
            (side, coarse(&maps.normal, step)),
            (side / 2, coarse(&half, 2 * step)),
        ];
        let threads = maps.map(|(side, pixels)| scope.spawn(move || png::encode(side, &pixels)));
        threads.map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// Most pixels a side of the textures of quantised files.
const QUANTIZED_TEXTURE: usize = 512;

/// A picture of half the side, by the mean of four pixels.
fn halved(pixels: &[[u8; 3]], side: usize) -> Vec<[u8; 3]> {
    let half = side / 2;
    let mean = |i: usize| {
        let at = i / half * 2 * side + i % half * 2;
        let four = [at, at + 1, at + side, at + side + 1].map(|i| pixels[i]);
        std::array::from_fn(|k| (four.iter().map(|p| u32::from(p[k])).sum::<u32>() / 4) as u8)
    };
    (0..half * half).map(mean).collect()
}

/// Mesh, skin and the node that joins them, for joint nodes that `turns` turns; the node is a root of the scene, since a skinned mesh
/// ignores the nodes above it.
pub(super) fn push_skinned_mesh(
    writer: &mut Writer,
    mesh: &HandMesh,
    joints: &[Index<Node>],
    turns: &[UnitQuaternion<f64>; Joint::COUNT],
    material: Index<Material>,
    quantize: bool,
) -> Index<Node> {
    let name = format!("{}-hand", mesh.side.name());
    let cube = quantize.then(|| Cube::around(&mesh.positions));
    let (mut attributes, indices) = match &cube {
        Some(cube) => (quantized(writer, mesh, cube), triangles(writer, mesh)),
        None => (floats(writer, mesh), triangles(writer, mesh)),
    };
    let count = mesh.positions.len();
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

    // A skinned mesh ignores its node's transform: what undoes the quantisation goes before the bind.
    let undo = cube.map_or_else(Matrix4::identity, |cube| cube.undo());
    let inverse = Joint::ALL.map(|joint| {
        let matrix =
            ((mesh.bind.get(joint) * turns[joint.index()]).inverse().to_homogeneous() * undo).cast::<f32>();
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
    let tangent = writer.floats(mesh.tangents().into_iter(), Layout::vertices(Type::Vec4));
    attributes.insert(Checked::Valid(Semantic::Tangents), tangent);
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

    let data: Vec<u8> = mesh.tangents().into_iter().flatten().map(byte).collect();
    let tangent = writer.accessor(&data, count, bytes(Type::Vec4, ComponentType::I8, true));
    attributes.insert(Checked::Valid(Semantic::Tangents), tangent);

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
    fn surfaces_and_textures_are_made_once() {
        let (options, sizes) = (ExportOptions::default(), Morphology::default());
        let mesh = options.skins.mesh(&sizes, Side::Left);
        assert!(Arc::ptr_eq(&mesh, &options.clone().skins.mesh(&sizes, Side::Left)));
        assert!(!Arc::ptr_eq(&mesh, &options.skins.mesh(&sizes, Side::Right)));
        assert_eq!(options.skins.mesh(&Morphology::average(0.15), Side::Left).side, Side::Left);
        for (skin, made) in [([1, 2, 3], 1), ([1, 2, 3], 1), ([3, 2, 1], 2)] {
            let mut options = options.clone();
            options.texture = Some(16);
            push_material(&mut Writer::new(String::new()), &mesh, &sizes, skin, &options);
            assert!(
                format!("{:?}", options.skins).ends_with(&format!("3 surfaces, {made} sets of textures)"))
            );
        }
    }

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
