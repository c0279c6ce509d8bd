//! The smooth shape of the hand: one closed, skinned surface made from the morphology.
//!
//! The flesh is an implicit function around the bones of a slightly spread and bent hand (so that fingers do not grow
//! together); a designed surface of quads is laid around it, spread evenly, and bound to the joints by linear blend skinning, in
//! a pose from which knuckles bend both ways.

mod field;
mod maps;
mod marks;
mod pack;
mod smooth;
mod template;
mod weights;

use std::collections::HashMap;

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::{HandFrames, HandPose, Joint, JointAngle, Morphology, Side, Skeleton};
use field::Field;
pub use maps::{NAIL_BED, PLAIN_SKIN, SkinMaps, nearest_skin_tone, noise, palm_of, skin_tone};
use marks::smooth_step;
pub use marks::{Crease, LINE_POINTS, Mark, Nail, SkinMarks};
pub use pack::PackedHand;
use template::Template;

/// A closed skinned surface in the hand frame of its side (see [`crate`]), metres.
#[derive(Clone, Debug)]
pub struct HandMesh {
    /// Left or right.
    pub side: Side,
    /// Vertices of the bind pose.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals of the bind pose, outwards.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, v downwards; of a left hand those of its mirror image, so that both share a texture.
    pub uvs: Vec<[f32; 2]>,
    /// Skin colour variation, linear RGB factors around 1: redder pads and knuckles, pale nails.
    pub tints: Vec<[f32; 3]>,
    /// How much of each vertex's skin is that of the palm, which holds little pigment, 0 to 1.
    pub palms: Vec<f32>,
    /// Triangles, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Joints that carry each vertex, as [`super::Joint::index`].
    pub joints: Vec<[u8; 4]>,
    /// Their weights; each row adds up to exactly 1.
    pub weights: Vec<[f32; 4]>,
    /// Creases and nails, which are finer than the surface.
    pub marks: SkinMarks,
    /// The joint frames the surface was made for.
    pub bind: HandFrames,
}

/// A surface posed by [`HandMesh::skin`].
#[derive(Clone, Debug, Default)]
pub struct SkinnedSurface {
    /// Vertices, metres.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals.
    pub normals: Vec<[f32; 3]>,
}

impl HandMesh {
    /// The surface of a hand of these sizes. Deterministic. Its vertices are welded but for the seams of the texture,
    /// along which they come twice.
    pub fn generate(morphology: &Morphology, side: Side) -> Self {
        let skeleton = Skeleton::new(morphology, Side::Right);
        let poses = [designed_pose(), HandPose::neutral(Side::Right), skinned_pose()];
        let [designed, straight, bind] = poses.map(|pose| skeleton.local_frames(&pose.angles));
        let relief = field::relief(morphology, &designed);
        let field = Field::new(morphology, &designed).with_relief(&relief);
        let template = Template::new(morphology, &designed, &field);
        let triangles = triangles_of(&template.points, &template.quads);
        let rows = weights::rows(morphology, &designed, &template.points, &template.parts, &triangles);
        let normals = normals_of(&template.points, &triangles);
        let palmar = palmar_sides(&designed, &normals, &rows);
        let mut tints = tints(morphology, &designed, &template.points, &normals, &palmar);
        redden(&mut tints, &template.points, &palmar, &relief);
        let skins: Vec<_> = rows.iter().map(weights::strongest).collect();
        let points: Vec<_> = template
            .points
            .iter()
            .zip(&skins)
            .map(|(p, skin)| rebound(p, skin, &designed, &straight, &bind))
            .collect();
        let normals = normals_of(&points, &triangles);
        let mut mesh = Self::empty(side);
        let mut numbers = HashMap::new();
        for (quad, uvs) in template.quads.iter().zip(&template.uvs) {
            let mut corners = [0; 4];
            for ((corner, &v), uv) in corners.iter_mut().zip(quad).zip(uvs) {
                let key = (v, uv.map(|c| (c * 65536.0) as i64));
                *corner = *numbers.entry(key).or_insert_with(|| {
                    let i = v as usize;
                    let (joints, weights) = skins[i];
                    mesh.positions.push(points[i].coords.cast::<f32>().into());
                    mesh.normals.push(normals[i].cast::<f32>().into());
                    mesh.tints.push(tints[i]);
                    mesh.palms.push(palm_share(palmar[i] as f32));
                    mesh.uvs.push(*uv);
                    mesh.joints.push(joints);
                    mesh.weights.push(weights);
                    mesh.positions.len() as u32 - 1
                });
            }
            mesh.triangles.extend(halves(corners, quad.map(|v| template.points[v as usize])));
        }
        mesh.marks = SkinMarks::new(morphology, &bind);
        mesh.bind = bind;
        if side == Side::Left {
            mesh.mirror();
        }
        mesh
    }

    fn empty(side: Side) -> Self {
        Self {
            side,
            positions: Vec::new(),
            normals: Vec::new(),
            uvs: Vec::new(),
            tints: Vec::new(),
            palms: Vec::new(),
            triangles: Vec::new(),
            joints: Vec::new(),
            weights: Vec::new(),
            marks: SkinMarks::default(),
            bind: HandFrames([Isometry3::identity(); Joint::COUNT]),
        }
    }

    /// Right to left: mirrored in x = 0, winding turned.
    fn mirror(&mut self) {
        for v in self.positions.iter_mut().chain(&mut self.normals) {
            v[0] = -v[0];
        }
        for t in &mut self.triangles {
            t.swap(1, 2);
        }
        self.marks.mirror();
        let frames = &mut self.bind.0;
        for frame in frames.iter_mut() {
            frame.translation.vector = super::pose::mirror_vector(frame.translation.vector);
            frame.rotation = super::pose::mirror_rotation(&frame.rotation);
        }
    }

    /// Inverse bind matrices: from the hand frame of the bind pose to each joint's frame.
    pub fn inverse_bind(&self) -> [Isometry3<f64>; Joint::COUNT] {
        self.bind.0.map(|f| f.inverse())
    }

    /// Linear blend skinning: the surface with its joints at `frames`, in the space of `frames`. The
    /// vectors of `out` are reused.
    pub fn skin(&self, frames: &HandFrames, out: &mut SkinnedSurface) {
        let inverse = self.inverse_bind();
        let moves: [_; Joint::COUNT] =
            std::array::from_fn(|i| (frames.0[i] * inverse[i]).to_homogeneous().cast::<f32>());
        out.positions.clear();
        out.normals.clear();
        let vertices = self.positions.iter().zip(&self.normals).zip(self.joints.iter().zip(&self.weights));
        for ((position, normal), (joints, weights)) in vertices {
            let mut blend = nalgebra::Matrix4::<f32>::zeros();
            for (joint, weight) in joints.iter().zip(weights) {
                if *weight > 0.0 {
                    blend += moves[usize::from(*joint) % Joint::COUNT] * *weight;
                }
            }
            let p = blend.transform_point(&Point3::from(*position));
            let n = blend.fixed_view::<3, 3>(0, 0) * Vector3::from(*normal);
            out.positions.push(p.coords.into());
            out.normals.push(n.try_normalize(1e-9).unwrap_or_else(Vector3::y).into());
        }
    }
}

/// The pose the designed surface is made in: half closed, fingers apart.
fn designed_pose() -> HandPose {
    use JointAngle::*;
    let mut pose = HandPose::neutral(Side::Right);
    for (angle, degrees) in [
        (Index1Abduction, 6.3),
        (Middle1Abduction, 0.7),
        (Ring1Abduction, 4.9),
        (Pinky1Abduction, 10.5),
        // The skin between thumb and index finger stretches better than it folds.
        (Thumb1Abduction, 14.0),
        (Thumb1Flexion, 6.0),
        (Thumb2Flexion, 12.0),
        (Thumb3Flexion, 20.0),
    ] {
        pose = pose.with_degrees(angle, degrees);
    }
    for finger in super::Finger::LONG {
        pose = pose
            .with_degrees(finger.base_flexion(), 40.0)
            .with_degrees(finger.middle_flexion(), 50.0)
            .with_degrees(finger.end_flexion(), 32.0);
    }
    pose
}

/// The pose the designed surface is bound in. Linear skinning leaves of a joint that bends by an angle from there the cosine of
/// its half: where this pose is half way to a right angle, a joint is as thick at that as it is straight.
fn skinned_pose() -> HandPose {
    let mut pose = designed_pose()
        .with_degrees(JointAngle::Thumb2Flexion, 25.0)
        .with_degrees(JointAngle::Thumb3Flexion, 38.0);
    for finger in super::Finger::LONG {
        // Bent fingers come nearer to each other.
        let spread = 1.2 * pose.angle(finger.abduction());
        pose.set(finger.abduction(), spread);
        pose = pose.with_degrees(finger.base_flexion(), 50.0).with_degrees(finger.end_flexion(), 40.0);
    }
    pose
}

/// The affine map of a vertex from the joints of `bind` to those of `frames`, by linear skinning: matrix and translation.
fn blend(
    bind: &HandFrames,
    frames: &HandFrames,
    (joints, weights): &([u8; 4], [f32; 4]),
) -> (Matrix3<f64>, Vector3<f64>) {
    let (mut matrix, mut translation) = (Matrix3::zeros(), Vector3::zeros());
    for (&joint, &weight) in joints.iter().zip(weights) {
        let joint = usize::from(joint) % Joint::COUNT;
        let moved = frames.0[joint] * bind.0[joint].inverse();
        matrix += moved.rotation.to_rotation_matrix().into_inner() * f64::from(weight);
        translation += moved.translation.vector * f64::from(weight);
    }
    (matrix, translation)
}

/// Where a vertex of the surface around `designed` is around `bind`, so that both are at the same place in the `straight` hand.
fn rebound(
    p: &Point3<f64>,
    skin: &([u8; 4], [f32; 4]),
    designed: &HandFrames,
    straight: &HandFrames,
    bind: &HandFrames,
) -> Point3<f64> {
    let [out, back] = [designed, bind].map(|from| blend(from, straight, skin));
    let place = out.0 * p.coords + out.1;
    back.0.try_inverse().map_or(*p, |matrix| Point3::from(matrix * (place - back.1)))
}

/// Two triangles for a quad, along the shorter diagonal of its `places`.
fn halves([a, b, c, d]: [u32; 4], places: [Point3<f64>; 4]) -> [[u32; 3]; 2] {
    let [p, q, r, s] = places;
    if (p - r).norm_squared() <= (q - s).norm_squared() {
        [[a, b, c], [a, c, d]]
    } else {
        [[a, b, d], [b, c, d]]
    }
}

fn triangles_of(points: &[Point3<f64>], quads: &[[u32; 4]]) -> Vec<[u32; 3]> {
    quads.iter().flat_map(|q| halves(*q, q.map(|v| points[v as usize]))).collect()
}

/// Unit normals, outwards: those of the triangles around, by their angles.
fn normals_of(points: &[Point3<f64>], triangles: &[[u32; 3]]) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); points.len()];
    for t in triangles {
        let corners = t.map(|v| points[v as usize]);
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let Some(normal) = normal.try_normalize(1e-15) else { continue };
        for k in 0..3 {
            let (to, from) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
            sums[t[k] as usize] += normal * to.angle(&from);
        }
    }
    sums.into_iter().map(|n| n.try_normalize(1e-9).unwrap_or_else(Vector3::y)).collect()
}

/// How far each normal faces to the palmar side of the bones that carry it, −1 to 1.
fn palmar_sides(bind: &HandFrames, normals: &[Vector3<f64>], rows: &[weights::Row]) -> Vec<f64> {
    let axes = bind.0.map(|f| f.rotation * Vector3::z());
    let side = |n: &Vector3<f64>, row: &weights::Row| {
        row.iter().zip(&axes).map(|(w, axis)| f64::from(*w) * n.dot(axis)).sum()
    };
    normals.iter().zip(rows).map(|(n, row)| side(n, row)).collect()
}

/// How much of the skin is that of the palm where it faces the palmar side of its bone by `palmar`, −1 to 1.
fn palm_share(palmar: f32) -> f32 {
    smooth_step(-0.15, 0.55, palmar)
}

/// Colour factors: the blood of pads and knuckles, the pale of the nails, the lighter palm. `palmar` is how far each point faces
/// to the palmar side.
fn tints(
    m: &Morphology,
    bind: &HandFrames,
    points: &[Point3<f64>],
    normals: &[Vector3<f64>],
    palmar: &[f64],
) -> Vec<[f32; 3]> {
    use super::{Finger, Joint};
    let near =
        |p: &Point3<f64>, c: Point3<f64>, reach: f64| (-(p - c).norm_squared() / (reach * reach)).exp();
    points
        .iter()
        .zip(normals)
        .zip(palmar)
        .map(|((p, normal), side)| {
            let mut blood = 0.0;
            let mut nail = 0.0f64;
            for finger in Finger::ALL {
                let f = m.finger(finger);
                let joints = Joint::of(finger);
                let [a, b, c] =
                    [joints.len() - 4, joints.len() - 3, joints.len() - 2].map(|i| bind.get(joints[i]));
                let r = f.radii;
                blood += 0.7 * near(p, a * Point3::new(0.0, 0.0, -r[0]), 0.9 * r[0]);
                blood += 0.8 * near(p, b * Point3::new(0.0, 0.0, -r[1]), 0.8 * r[1]);
                blood += 0.5 * near(p, c * Point3::new(0.0, 0.0, -r[2]), 0.7 * r[2]);
                blood += 0.9 * near(p, c * Point3::new(0.0, f.bones[2] - 0.8 * r[3], 0.6 * r[3]), 1.3 * r[3]);
                let local = c.inverse() * p;
                let up = -(c.rotation.inverse() * normal).z;
                let bed = f.bones[2] - 0.85 * r[3];
                let (x, y) = (local.x / (0.72 * r[3]), (local.y - bed) / (0.80 * r[3]));
                let inside = 1.0 - x.powi(4) - y.powi(4);
                let behind = (0.0..2.0).contains(&(-local.z / r[3]));
                if up > 0.35 && inside > 0.0 && behind {
                    nail = nail.max((4.0 * inside).min(1.0));
                }
            }
            let palm = side.max(0.0) * 0.6;
            let blood = blood.min(1.0) * (1.0 - nail);
            let shade = [
                1.0 - 0.02 * blood + 0.05 * nail,
                1.0 - 0.16 * blood + 0.06 * palm + 0.10 * nail,
                1.0 - 0.17 * blood + 0.06 * palm + 0.16 * nail,
            ];
            shade.map(|v| v as f32)
        })
        .collect()
}

/// The blood of the pads and balls of the palm.
fn redden(tints: &mut [[f32; 3]], points: &[Point3<f64>], palmar: &[f64], relief: &[field::Swelling]) {
    for ((tint, p), side) in tints.iter_mut().zip(points).zip(palmar) {
        let full = relief.iter().filter(|s| s.height > 0.0);
        let blood: f64 = full.map(|s| (-(p - s.centre).norm_squared() / (s.reach * s.reach)).exp()).sum();
        let blood = (blood.min(1.0) * side.max(0.0)) as f32;
        *tint =
            [tint[0] * (1.0 - 0.01 * blood), tint[1] * (1.0 - 0.10 * blood), tint[2] * (1.0 - 0.09 * blood)];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Finger;

    fn point(v: [f32; 3]) -> Point3<f64> {
        Point3::from(v).cast()
    }

    /// Pairs of triangles without a common vertex that cross, by brute force over a grid of boxes.
    fn crossings(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> usize {
        let corners = |t: &[u32; 3]| t.map(|i| point(positions[i as usize]));
        let cell = 0.006;
        let mut grid: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
        let range = |t: &[u32; 3], k: usize| {
            let c = corners(t).map(|p| p[k]);
            let low = c.iter().copied().fold(f64::MAX, f64::min);
            let high = c.iter().copied().fold(f64::MIN, f64::max);
            (low / cell).floor() as i32..=(high / cell).floor() as i32
        };
        for (n, t) in triangles.iter().enumerate() {
            for x in range(t, 0) {
                for y in range(t, 1) {
                    for z in range(t, 2) {
                        grid.entry([x, y, z]).or_default().push(n);
                    }
                }
            }
        }
        // An edge of one triangle that passes through the inside of the other.
        let pierces = |t: &[Point3<f64>; 3], u: &[Point3<f64>; 3]| {
            let normal = (u[1] - u[0]).cross(&(u[2] - u[0]));
            (0..3).any(|k| {
                let (p, q) = (t[k], t[(k + 1) % 3]);
                let (a, b) = ((p - u[0]).dot(&normal), (q - u[0]).dot(&normal));
                if a * b >= 0.0 {
                    return false;
                }
                let hit = p + (q - p) * (a / (a - b));
                (0..3).all(|j| (u[(j + 1) % 3] - u[j]).cross(&(hit - u[j])).dot(&normal) > 0.0)
            })
        };
        let mut found = std::collections::HashSet::new();
        for list in grid.values() {
            for (i, &a) in list.iter().enumerate() {
                for &b in &list[i + 1..] {
                    let (ta, tb) = (&triangles[a], &triangles[b]);
                    if ta.iter().any(|v| tb.contains(v)) {
                        continue;
                    }
                    let (ca, cb) = (corners(ta), corners(tb));
                    if pierces(&ca, &cb) || pierces(&cb, &ca) {
                        found.insert((a.min(b), a.max(b)));
                    }
                }
            }
        }
        found.len()
    }

    /// Vertices − edges + faces of a closed orientable manifold (2 for a sphere); `None` if some edge does
    /// not join exactly two triangles of the same orientation or some vertex joins two sheets.
    pub(super) fn euler_characteristic(triangles: &[[u32; 3]]) -> Option<i64> {
        let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
        let mut next_around: HashMap<(u32, u32), u32> = HashMap::new();
        let mut faces_at: HashMap<u32, u32> = HashMap::new();
        for t in triangles {
            for k in 0..3 {
                let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
                *edges.entry((a, b)).or_default() += 1;
                next_around.insert((a, b), c);
                *faces_at.entry(a).or_default() += 1;
            }
        }
        let matched = edges.iter().all(|(&(a, b), &n)| n == 1 && edges.get(&(b, a)) == Some(&1));
        if !matched {
            return None;
        }
        // The triangles around a vertex must form one ring.
        let mut starts: HashMap<u32, u32> = HashMap::new();
        for &(a, b) in edges.keys() {
            starts.insert(a, b);
        }
        for (&v, &start) in &starts {
            let (mut at, mut steps) = (start, 0);
            loop {
                at = *next_around.get(&(v, at))?;
                steps += 1;
                if at == start {
                    break;
                }
            }
            if steps != *faces_at.get(&v)? {
                return None;
            }
        }
        Some(starts.len() as i64 - edges.len() as i64 / 2 + triangles.len() as i64)
    }

    /// Triangles between vertices that come once, for vertices of these positions.
    pub(super) fn welded(mesh: &HandMesh) -> Vec<[u32; 3]> {
        let mut first = HashMap::new();
        let number = |i: u32| mesh.positions[i as usize].map(f32::to_bits);
        mesh.triangles.iter().map(|t| t.map(|i| *first.entry(number(i)).or_insert(i))).collect()
    }

    fn posed(mesh: &HandMesh, m: &Morphology, pose: &HandPose) -> SkinnedSurface {
        let mut out = SkinnedSurface::default();
        mesh.skin(&Skeleton::new(m, mesh.side).frames(pose), &mut out);
        out
    }

    /// Most pairs of triangles that may cross in the folds of webs away from the bind pose.
    const FOLDS: usize = 12;

    fn volume(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> f64 {
        let v = |i: u32| point(positions[i as usize]).coords;
        triangles.iter().map(|t| v(t[0]).dot(&v(t[1]).cross(&v(t[2]))) / 6.0).sum()
    }

    fn morphologies() -> Vec<Morphology> {
        let average = Morphology::default();
        let mut slim = average.scaled(0.85);
        let mut stout = average.scaled(1.1);
        for f in &mut slim.fingers {
            f.radii = f.radii.map(|r| r * 0.85);
        }
        for f in &mut stout.fingers {
            f.radii = f.radii.map(|r| r * 1.12);
            f.bones = f.bones.map(|b| b * 0.92);
            // Thick fingers stand on a broad palm: else they would meet at rest.
            f.base[0] *= 1.12;
            f.metacarpal[0] *= 1.12;
        }
        vec![average, slim, stout]
    }

    #[test]
    fn the_surface_is_a_closed_sphere_of_even_triangles() {
        for m in morphologies() {
            let mesh = HandMesh::generate(&m, Side::Right);
            let n = mesh.positions.len();
            assert!((3000..=6000).contains(&n), "{n} vertices");
            assert_eq!(euler_characteristic(&welded(&mesh)), Some(2));
            let mut thin = 0;
            for (t, c) in mesh.triangles.iter().map(|t| (t, t.map(|i| point(mesh.positions[i as usize])))) {
                let sides = [(c[1] - c[0]).norm(), (c[2] - c[1]).norm(), (c[0] - c[2]).norm()];
                let longest = sides.iter().copied().fold(0.0, f64::max);
                let height = (c[1] - c[0]).cross(&(c[2] - c[0])).norm() / longest;
                assert!(height > 0.02 * longest, "{t:?} {sides:?} at {}", c[0]);
                thin += usize::from(height < 0.1 * longest);
                let outward = (c[1] - c[0]).cross(&(c[2] - c[0]));
                let normal: Vector3<f64> =
                    t.iter().map(|&i| Vector3::from(mesh.normals[i as usize]).cast::<f64>()).sum();
                assert!(outward.dot(&normal) > 0.0, "{t:?} at {} is turned over", c[0]);
            }
            // Where the thumb's window meets the rows of the palm corners are blunt.
            assert!(thin * 500 < mesh.triangles.len(), "{thin} thin triangles");
        }
    }

    #[test]
    fn texture_coordinates_cover_the_square_once() {
        let mesh = HandMesh::generate(&Morphology::default(), Side::Right);
        let side = 256usize;
        let mut hits = vec![0u8; side * side];
        for t in &mesh.triangles {
            let uv = t.map(|i| mesh.uvs[i as usize].map(|v| f64::from(v) * side as f64));
            assert!(uv.iter().flatten().all(|v| (0.0..=side as f64).contains(v)));
            let area = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
                (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
            };
            let whole = area(uv[0], uv[1], uv[2]);
            assert!(whole.abs() > 1e-6, "a triangle without texture: {uv:?}");
            let range = |k: usize| {
                let low = uv.iter().map(|p| p[k]).fold(f64::MAX, f64::min);
                let high = uv.iter().map(|p| p[k]).fold(f64::MIN, f64::max);
                low.floor() as usize..(high.ceil() as usize).min(side)
            };
            for (x, y) in range(0).flat_map(|x| range(1).map(move |y| (x, y))) {
                let p = [x as f64 + 0.501, y as f64 + 0.497];
                let inside = [area(p, uv[1], uv[2]), area(uv[0], p, uv[2]), area(uv[0], uv[1], p)];
                hits[y * side + x] += u8::from(inside.iter().all(|a| a / whole > 1e-9));
            }
        }
        let covered = hits.iter().filter(|h| **h > 0).count();
        assert!(hits.iter().all(|h| *h <= 1), "texture used twice");
        assert!(covered * 10 > 7 * side * side, "{covered} of {} pixels used", side * side);
    }

    #[test]
    fn nothing_crosses_in_rest_and_spread() {
        for m in morphologies() {
            let mesh = HandMesh::generate(&m, Side::Right);
            assert_eq!(crossings(&mesh.positions, &welded(&mesh)), 0, "bind pose");
            let rest = posed(&mesh, &m, &HandPose::neutral(Side::Right));
            // Straight fingers side by side fold the webs between them.
            let folds = crossings(&rest.positions, &welded(&mesh));
            assert!(folds <= FOLDS, "{folds} at rest");
            let mut spread = HandPose::neutral(Side::Right);
            for finger in [Finger::Index, Finger::Ring, Finger::Pinky] {
                spread = spread.with_degrees(finger.abduction(), 12.0);
            }
            let folds = crossings(&posed(&mesh, &m, &spread).positions, &welded(&mesh));
            assert!(folds <= FOLDS, "{folds} spread");
        }
    }

    #[test]
    fn weights_are_exact_and_move_every_joint() {
        let mesh = HandMesh::generate(&Morphology::default(), Side::Right);
        let mut carried = [false; Joint::COUNT];
        for (joints, weights) in mesh.joints.iter().zip(&mesh.weights) {
            assert_eq!(weights.iter().sum::<f32>(), 1.0);
            for (j, w) in joints.iter().zip(weights) {
                carried[usize::from(*j)] |= *w > 0.5;
            }
        }
        for joint in super::super::Joint::ALL {
            let tip = joint.webxr_name().ends_with("tip");
            assert_eq!(carried[joint.index()], !tip, "{}", joint.webxr_name());
        }
    }

    #[test]
    fn bending_keeps_the_volume_of_the_fingers() {
        let m = Morphology::default();
        let mesh = HandMesh::generate(&m, Side::Right);
        let straight = volume(&posed(&mesh, &m, &HandPose::neutral(Side::Right)).positions, &mesh.triangles);
        let mut fist = HandPose::neutral(Side::Right);
        for finger in Finger::LONG {
            fist = fist
                .with_degrees(finger.base_flexion(), 80.0)
                .with_degrees(finger.middle_flexion(), 100.0)
                .with_degrees(finger.end_flexion(), 66.0);
        }
        let bent = volume(&posed(&mesh, &m, &fist).positions, &mesh.triangles);
        assert!((bent / straight - 1.0).abs() < 0.05, "{straight} {bent}");
    }

    /// No joint lies behind the wrist, so that nothing can twist there.
    #[test]
    fn the_forearm_turns_with_the_wrist_as_a_whole() {
        let m = Morphology::default();
        let mesh = HandMesh::generate(&m, Side::Right);
        let mut bent = HandPose::neutral(Side::Right);
        bent.angles = std::array::from_fn(|_| 0.6);
        let [rest, bent] = [HandPose::neutral(Side::Right), bent].map(|pose| posed(&mesh, &m, &pose));
        let behind = (0..rest.positions.len()).filter(|&i| mesh.positions[i][1] < -0.03);
        let moved = behind.map(|i| (point(rest.positions[i]) - point(bent.positions[i])).norm());
        let moved: Vec<f64> = moved.collect();
        assert!(moved.len() > 100 && moved.iter().all(|far| *far < 5e-4));
    }

    #[test]
    fn bind_pose_skins_to_itself_and_rigid_motion_is_rigid() {
        let m = Morphology::default();
        let mesh = HandMesh::generate(&m, Side::Left);
        let mut out = SkinnedSurface::default();
        mesh.skin(&mesh.bind, &mut out);
        for (a, b) in mesh.positions.iter().zip(&out.positions) {
            assert!((point(*a) - point(*b)).norm() < 1e-6);
        }
    }

    #[test]
    fn left_is_the_mirror_image() {
        let m = Morphology::default();
        let (right, left) = (HandMesh::generate(&m, Side::Right), HandMesh::generate(&m, Side::Left));
        let mut pose = HandPose::neutral(Side::Right);
        pose.angles = std::array::from_fn(|i| 0.02 * i as f64);
        let (r, l) = (posed(&right, &m, &pose), posed(&left, &m, &pose.mirrored()));
        for (a, b) in r.positions.iter().zip(&l.positions) {
            assert!((a[0] + b[0]).abs() + (a[1] - b[1]).abs() + (a[2] - b[2]).abs() < 1e-5);
        }
        let (a, b) = (volume(&r.positions, &right.triangles), volume(&l.positions, &left.triangles));
        assert!(a > 0.0 && (a - b).abs() < 1e-7);
        assert_eq!(euler_characteristic(&welded(&left)), Some(2));
    }

    #[test]
    fn hands_of_many_sizes_are_closed_and_rest_without_crossing() {
        // Sizes well beyond the spread of adults, from a fixed sequence.
        let mut state = 1u64;
        let mut between = |low: f64, high: f64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            low + (high - low) * ((state >> 33) as f64 / (1u64 << 31) as f64)
        };
        let mut compared = 0;
        for case in 0..16 {
            let mut m = Morphology::average(between(0.15, 0.22));
            let stout = between(0.8, 1.2);
            m.palm_radius *= between(0.8, 1.25);
            m.wrist_half_width *= between(0.8, 1.2);
            m.webs = m.webs.map(|w| w * between(0.8, 1.25));
            for f in &mut m.fingers {
                f.bones = f.bones.map(|b| b * between(0.88, 1.12));
                f.radii = f.radii.map(|r| r * stout * between(0.93, 1.07));
            }
            let mesh = HandMesh::generate(&m, Side::Right);
            assert_eq!(euler_characteristic(&welded(&mesh)), Some(2), "case {case}");
            let rest = posed(&mesh, &m, &HandPose::neutral(Side::Right));
            let crossed = crossings(&rest.positions, &welded(&mesh));
            println!(
                "case {case}: stoutness {stout:.2}, {} vertices, {crossed} crossings",
                mesh.positions.len()
            );
            // Fingers thicker than their knuckles are apart do overlap side by side, whatever the mesh.
            let apart = m.fingers[1..].windows(2).all(|f| {
                let thick = f[0].radii[0].max(f[0].radii[1]) + f[1].radii[0].max(f[1].radii[1]);
                (f[0].base[0] - f[1].base[0]).abs() > 1.05 * thick
            });
            compared += usize::from(apart);
            assert!(crossed <= FOLDS || !apart, "case {case}");
            assert_eq!(crossings(&mesh.positions, &welded(&mesh)), 0, "case {case}: bind pose");
        }
        assert!(compared >= 6, "{compared}");
    }

    #[test]
    fn absurd_sizes_do_not_break_the_generator() {
        for (radius, bone) in [(0.3, 1.0), (0.005, 0.01), (0.29, 0.02)] {
            let mut m = Morphology::default();
            for f in &mut m.fingers {
                f.radii = [radius * m.hand_length; 4];
                f.bones = [bone * m.hand_length; 3];
            }
            let mesh = HandMesh::generate(&m, Side::Right);
            assert_eq!(mesh.positions.len(), mesh.weights.len());
        }
    }
}
