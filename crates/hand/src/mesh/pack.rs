//! A hand's surface and rest as the numbers that a graphics card takes.

use nalgebra::{Isometry3, Vector3};

use super::{Crease, HandMesh, Nail};
use crate::{HandFrames, Joint};

/// A surface as WebGL takes it, and what places it: the form that the pages' shaders read.
#[derive(Clone, Debug)]
pub struct PackedHand {
    /// 32 bytes a vertex: position (4 shorts, of `cube`), normal (4 shorts), tint (3 bytes, of
    /// [`Self::BRIGHTEST_TINT`]), how little of it is palm (1 byte), joints (4 bytes), weights (4 unsigned shorts); little-endian.
    pub vertices: Vec<u8>,
    /// Corners of triangles.
    pub triangles: Vec<u32>,
    /// Centre and half side of the cube that is ±1 in positions, metres.
    pub cube: [f32; 4],
    /// Half the width of creases, metres.
    pub crease_width: f32,
    /// Twelve numbers a crease: middle, radius, normal of its plane, 0, palmar direction, 0.
    pub creases: Vec<f32>,
    /// Twelve numbers a nail: see [`Nail`].
    pub nails: Vec<f32>,
    /// Lines of the palm, eight points (x, y) each.
    pub lines: Vec<f32>,
    /// Joint that carries each joint, −1 for the wrist.
    pub parents: [i32; Joint::COUNT],
    /// Place of each joint in the frame of its parent, metres.
    pub offsets: [[f32; 3]; Joint::COUNT],
    /// Rows of the matrix from the surface at rest to each joint's frame.
    pub inverse_bind: [[f32; 12]; Joint::COUNT],
}

impl PackedHand {
    /// Vertex colours are stored as shares of this.
    pub const BRIGHTEST_TINT: f32 = 1.25;

    /// The numbers of a surface.
    pub fn new(mesh: &HandMesh) -> Self {
        let rest = mesh.bind.in_parents();
        let cube = cube(&mesh.positions);
        Self {
            vertices: vertices(mesh, cube),
            triangles: mesh.triangles.iter().flatten().copied().collect(),
            cube,
            crease_width: mesh.marks.width,
            creases: mesh.marks.creases.iter().flat_map(crease_numbers).collect(),
            nails: mesh.marks.nails.iter().flat_map(|Nail(rows)| rows.iter().flatten().copied()).collect(),
            lines: mesh.marks.lines.iter().flatten().flatten().copied().collect(),
            parents: Joint::ALL.map(|j| j.parent().map_or(-1, |p| p.index() as i32)),
            offsets: rest.map(|f| f.translation.vector.cast().into()),
            inverse_bind: mesh.inverse_bind().map(|frame| {
                let m = frame.to_homogeneous().cast::<f32>();
                std::array::from_fn(|i| m[(i / 4, i % 4)])
            }),
        }
    }
}

impl HandFrames {
    /// Each joint's frame in that of its parent; of the wrist as it is.
    pub fn in_parents(&self) -> [Isometry3<f64>; Joint::COUNT] {
        Joint::ALL.map(|joint| match joint.parent() {
            Some(parent) => self.get(parent).inverse() * self.get(joint),
            None => *self.get(joint),
        })
    }
}

/// −1..=1 as a normalised short.
fn short(v: f32) -> i16 {
    (f64::from(v).clamp(-1.0, 1.0) * 32767.0).round() as i16
}

fn crease_numbers(c: &Crease) -> [f32; 12] {
    let ([x, y, z], [u, v, w], [a, b, d]) = (c.centre, c.along, c.palmar);
    [x, y, z, c.radius, u, v, w, 0.0, a, b, d, 0.0]
}

/// Centre and half side of a cube around points.
fn cube(points: &[[f32; 3]]) -> [f32; 4] {
    let bound = |pick: fn(f32, f32) -> f32| {
        points.iter().map(|&p| Vector3::from(p)).reduce(|a, b| a.zip_map(&b, pick)).unwrap_or_default()
    };
    let (low, high) = (bound(f32::min), bound(f32::max));
    let (centre, half) = ((low + high) / 2.0, ((high - low) / 2.0).max().max(1e-6));
    [centre.x, centre.y, centre.z, half]
}

fn vertices(mesh: &HandMesh, [x, y, z, half]: [f32; 4]) -> Vec<u8> {
    let mut out = Vec::with_capacity(mesh.positions.len() * 32);
    let rows = mesh.positions.iter().zip(&mesh.normals).zip(&mesh.tints);
    let rows = rows.zip(mesh.joints.iter().zip(&mesh.weights)).zip(&mesh.palms);
    for ((((position, normal), tint), (joints, weights)), palm) in rows {
        let place = [(position[0] - x) / half, (position[1] - y) / half, (position[2] - z) / half, 0.0];
        let shorts = place.into_iter().chain(*normal).chain([0.0]);
        out.extend(shorts.flat_map(|v| short(v).to_le_bytes()));
        out.extend(tint.map(|v| (v / PackedHand::BRIGHTEST_TINT * 255.0).round().clamp(0.0, 255.0) as u8));
        out.push(((1.0 - palm) * 255.0).round().clamp(0.0, 255.0) as u8);
        out.extend(joints);
        let weight = |w: &f32| (w * 65535.0).round().clamp(0.0, 65535.0) as u16;
        out.extend(weights.iter().flat_map(|w| weight(w).to_le_bytes()));
    }
    out
}
