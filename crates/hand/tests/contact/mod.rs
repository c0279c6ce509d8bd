//! How parts of the posed surface lie to each other: what is inside what, and how far fingers are apart.

use std::collections::HashMap;

use handcast_hand::{
    Finger, HandFrames, HandMesh, HandPose, Joint, JointAngles, Morphology, Side, Skeleton, SkinnedSurface,
};
use nalgebra::Vector3;

type V = Vector3<f64>;

/// Parts of the hand: the palm is 0, then three bones a finger from the thumb on.
fn part_of(joint: usize) -> usize {
    let joint = Joint::ALL[joint];
    for finger in Finger::ALL {
        let bones = Joint::of(finger);
        let bones = &bones[bones.len() - 4..];
        if let Some(k) = bones.iter().position(|&j| j == joint) {
            return 1 + 3 * finger as usize + k.min(2);
        }
    }
    0
}

/// Whether two parts share a joint, or skin: the thumb's first bone lies in the palm.
fn joined(a: usize, b: usize) -> bool {
    let (a, b) = (a.min(b), a.max(b));
    if a == 0 {
        return b == 0 || (b - 1) % 3 == 0;
    }
    // Skin between thumb and index finger.
    (a == 1 && b == 4) || a == b || ((a - 1) / 3 == (b - 1) / 3 && b - a == 1)
}

/// The part around a bone of a finger, counted from the first one that bends.
pub fn part(finger: Finger, bone: usize) -> usize {
    1 + 3 * finger as usize + bone
}

fn name(part: usize) -> String {
    match part {
        0 => "palm".into(),
        p => format!("{} {}", Finger::ALL[(p - 1) / 3].name(), (p - 1) % 3 + 1),
    }
}

/// Pairs of neighbours, by the first one's number among the long fingers, that touch when a signer makes the letter.
pub fn touching(letter: char) -> &'static [usize] {
    match letter {
        'F' | 'W' => &[],
        'H' | 'N' | 'U' => &[0, 2],
        // Its thumb comes out between the ring and the little finger.
        'M' => &[0, 1],
        'I' | 'J' | 'Y' => &[0, 1],
        'D' | 'G' | 'L' | 'Q' | 'T' | 'X' | 'Z' => &[1, 2],
        'K' | 'P' | 'R' | 'V' => &[2],
        _ => &[0, 1, 2],
    }
}

/// A surface to be posed.
pub struct Contact {
    mesh: HandMesh,
    skeleton: Skeleton,
    /// Part of each vertex.
    parts: Vec<usize>,
    /// Vertices of either seam once: the number of the first of each place.
    welded: Vec<[u32; 3]>,
    /// How far along its bone each vertex of the bind pose is, a share.
    along: Vec<f64>,
}

impl Contact {
    pub fn new(morphology: &Morphology) -> Self {
        let mesh = HandMesh::generate(morphology, Side::Right);
        let strongest = |i: usize| {
            (0..4)
                .max_by(|&a, &b| mesh.weights[i][a].total_cmp(&mesh.weights[i][b]))
                .map(|k| mesh.joints[i][k])
        };
        let carriers: Vec<usize> =
            (0..mesh.positions.len()).map(|i| usize::from(strongest(i).unwrap())).collect();
        let along = carriers
            .iter()
            .enumerate()
            .map(|(i, &joint)| {
                let local = mesh.bind.0[joint].inverse()
                    * nalgebra::Point3::from(V::from(mesh.positions[i].map(f64::from)));
                let next = Joint::ALL.get(joint + 1).map_or(1.0, |next| {
                    (mesh.bind.position(*next) - mesh.bind.position(Joint::ALL[joint])).norm()
                });
                local.y / next
            })
            .collect();
        let mut first = HashMap::new();
        let place = |i: u32| mesh.positions[i as usize].map(f32::to_bits);
        let welded = mesh.triangles.iter().map(|t| t.map(|i| *first.entry(place(i)).or_insert(i))).collect();
        let parts = carriers.into_iter().map(part_of).collect();
        Self { skeleton: Skeleton::new(morphology, Side::Right), mesh, parts, welded, along }
    }

    pub fn pose(&self, angles: &JointAngles) -> Posed<'_> {
        let pose = HandPose { angles: *angles, ..HandPose::neutral(Side::Right) };
        let mut skinned = SkinnedSurface::default();
        let frames = self.skeleton.frames(&pose);
        self.mesh.skin(&frames, &mut skinned);
        let lift = |v: &[f32; 3]| V::from(v.map(f64::from));
        let points: Vec<V> = skinned.positions.iter().map(lift).collect();
        let normals = skinned.normals.iter().map(lift).collect();
        let grid = Grid::new(&points, &self.welded);
        Posed { contact: self, frames, points, normals, grid }
    }
}

/// Triangles by where they are seen along x.
struct Grid {
    cells: HashMap<(i32, i32), Vec<u32>>,
}

const CELL: f64 = 0.004;

impl Grid {
    fn new(points: &[V], triangles: &[[u32; 3]]) -> Self {
        let mut cells: HashMap<(i32, i32), Vec<u32>> = HashMap::new();
        let cell = |v: f64| (v / CELL).floor() as i32;
        for (n, t) in (0..).zip(triangles) {
            let c = t.map(|i| points[i as usize]);
            let range = |k: usize| {
                let low = c.iter().map(|p| p[k]).fold(f64::MAX, f64::min);
                let high = c.iter().map(|p| p[k]).fold(f64::MIN, f64::max);
                cell(low)..=cell(high)
            };
            for y in range(1) {
                for z in range(2) {
                    cells.entry((y, z)).or_default().push(n);
                }
            }
        }
        Self { cells }
    }

    /// How often the surface is left, less how often it is entered, on the way from `p` along x.
    fn winding(&self, p: &V, points: &[V], triangles: &[[u32; 3]]) -> i32 {
        let key = ((p.y / CELL).floor() as i32, (p.z / CELL).floor() as i32);
        let Some(list) = self.cells.get(&key) else { return 0 };
        let mut count = 0;
        for &n in list {
            let [a, b, c] = triangles[n as usize].map(|i| points[i as usize]);
            let cross = |u: &V, v: &V| (u.y - p.y) * (v.z - p.z) - (v.y - p.y) * (u.z - p.z);
            let shares = [cross(&b, &c), cross(&c, &a), cross(&a, &b)];
            let area: f64 = shares.iter().sum();
            let inside = shares.iter().all(|s| *s > 0.0) || shares.iter().all(|s| *s < 0.0);
            if !inside || area == 0.0 {
                continue;
            }
            let x = (a.x * shares[0] + b.x * shares[1] + c.x * shares[2]) / area;
            if x > p.x {
                count += if area > 0.0 { 1 } else { -1 };
            }
        }
        count
    }
}

/// The nearest place of a triangle.
fn nearest(p: &V, [a, b, c]: [V; 3]) -> V {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / (d4 - d3 + d5 - d6));
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum)
}

/// The surface in a pose.
pub struct Posed<'a> {
    contact: &'a Contact,
    /// Its joints, in the frame of the hand.
    pub frames: HandFrames,
    points: Vec<V>,
    normals: Vec<V>,
    grid: Grid,
}

impl Posed<'_> {
    /// How far each vertex is inside a part with which its own has no joint in common, metres, and both parts.
    pub fn inside(&self) -> Vec<(f64, usize, usize)> {
        let c = self.contact;
        let mut found = Vec::new();
        for (i, p) in self.points.iter().enumerate() {
            // Slightly outside its own skin a vertex is in nothing, or in another part.
            let out = p + self.normals[i] * 1e-4;
            if self.grid.winding(&out, &self.points, &c.welded) < 1 {
                continue;
            }
            let mut best: Option<(f64, bool, usize)> = None;
            for t in &c.welded {
                let part = c.parts[t[0] as usize];
                if joined(part, c.parts[i]) || t.iter().any(|&v| joined(c.parts[v as usize], c.parts[i])) {
                    continue;
                }
                let corners = t.map(|v| self.points[v as usize]);
                let reach = best.map_or(0.015, |b| b.0);
                if (corners[0] - p).norm() > reach + 0.012 {
                    continue;
                }
                let q = nearest(p, corners);
                let distance = (p - q).norm();
                if distance < reach {
                    // The normals of its corners say on which side of it the vertex is.
                    let normal: V = t.iter().map(|&v| self.normals[v as usize]).sum();
                    best = Some((distance, (p - q).dot(&normal) < 0.0, part));
                }
            }
            if let Some((distance, true, part)) = best {
                found.push((distance, c.parts[i], part));
            }
        }
        found
    }

    /// The deepest that one part is inside another, metres, and which these are.
    pub fn depth(&self) -> (f64, String) {
        let all = self.inside();
        let deepest = all.iter().fold((0.0, 0, 0), |best, d| if d.0 > best.0 { *d } else { best });
        (deepest.0, format!("{} in {}", name(deepest.1), name(deepest.2)))
    }

    /// For pairs of neighbours, by the first one's number among the long fingers: the space between them at their
    /// first bones beyond the web, and at their second ones, metres.
    pub fn gaps(&self, pairs: &[usize]) -> Vec<(String, f64)> {
        let bones =
            pairs.iter().flat_map(|pair| (0..2).map(move |bone| [4 + 3 * pair + bone, 7 + 3 * pair + bone]));
        bones.map(|[a, b]| (format!("{} and {}", name(a), name(b)), self.between(&[a], &[b]))).collect()
    }

    /// The least space between the skin of some parts and that of others, first bones beyond the web alone, metres.
    pub fn between(&self, some: &[usize], others: &[usize]) -> f64 {
        let c = self.contact;
        // Beyond the web.
        let of = |i: usize, parts: &[usize]| {
            parts.contains(&c.parts[i]) && (!(c.parts[i] + 2).is_multiple_of(3) || c.along[i] > 0.6)
        };
        let near: Vec<usize> = (0..self.points.len()).filter(|&i| of(i, some)).collect();
        let mut least = f64::MAX;
        for t in c.welded.iter().filter(|t| t.iter().all(|&v| of(v as usize, others))) {
            let corners = t.map(|v| self.points[v as usize]);
            for &i in &near {
                if (self.points[i] - corners[0]).norm() < least + 0.012 {
                    least = least.min((self.points[i] - nearest(&self.points[i], corners)).norm());
                }
            }
        }
        least
    }
}
