//! Surface nets: a vertex in every grid cell for each sheet of the surface that crosses it, a quad for
//! every grid edge the surface crosses; then the vertices are spread evenly on the surface.
//!
//! A vertex for each sheet, not only for each cell, is what keeps the result a manifold where two parts
//! of the surface come close (the dual of marching cubes).

use std::collections::HashMap;
use std::ops::Range;

use nalgebra::{Point3, Vector3};

use super::field::{Field, Near};

/// Cells along one axis, at most: bounds memory for any morphology.
const MAX_CELLS: usize = 256;

/// Nodes along one side of the blocks in which the grid is filled.
const BLOCK: usize = 4;

/// Distance from the surface, in radii of a block, beyond which the field is taken to keep its sign in the block.
const FAR: f64 = 1.25;

/// A closed surface.
#[derive(Default)]
pub(super) struct Polygons {
    pub(super) points: Vec<Point3<f64>>,
    /// Unit, outwards.
    pub(super) normals: Vec<Vector3<f64>>,
    /// Counter-clockwise seen from outside.
    pub(super) triangles: Vec<[u32; 3]>,
}

/// The raw net: vertices somewhere near the surface, quads between them.
pub(super) struct Net {
    points: Vec<Point3<f64>>,
    /// The block in which each vertex lies.
    blocks: Vec<u32>,
    quads: Vec<[u32; 4]>,
    near: HashMap<u32, Near>,
}

/// Corners of the unit cell: bit 0 is x, bit 1 y, bit 2 z. Edges as pairs of corners, by direction.
const EDGES: [[usize; 2]; 12] =
    [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

/// Edges of the six faces, in order round the face.
const FACES: [[usize; 4]; 6] =
    [[4, 10, 6, 8], [5, 11, 7, 9], [0, 9, 2, 8], [1, 11, 3, 10], [0, 5, 1, 4], [2, 7, 3, 6]];

fn corner(i: usize) -> Vector3<f64> {
    Vector3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64)
}

/// For each crossed edge of a cell, the sheet it belongs to (0, 1, …); `None` for edges not crossed.
fn sheets(inside: [bool; 8]) -> [Option<usize>; 12] {
    let crossed = EDGES.map(|[a, b]| inside[a] != inside[b]);
    let mut leader: [usize; 12] = std::array::from_fn(|i| i);
    fn find(leader: &[usize; 12], mut i: usize) -> usize {
        while leader[i] != i {
            i = leader[i];
        }
        i
    }
    for face in FACES {
        let cut: Vec<usize> = face.into_iter().filter(|&e| crossed[e]).collect();
        let mut join = |a: usize, b: usize| {
            let (a, b) = (find(&leader, a), find(&leader, b));
            leader[a.max(b)] = a.min(b);
        };
        match cut[..] {
            [a, b] => join(a, b),
            [a, b, c, d] => {
                // Two corners in opposition are inside: keep them apart, each with its own two edges.
                let shared = |e: usize, f: usize| {
                    EDGES[e].into_iter().find(|c| EDGES[f].contains(c)).is_some_and(|c| inside[c])
                };
                if shared(a, b) {
                    join(a, b);
                    join(c, d);
                } else {
                    join(b, c);
                    join(d, a);
                }
            }
            _ => {}
        }
    }
    let mut numbers: Vec<usize> = Vec::new();
    std::array::from_fn(|e| {
        crossed[e].then(|| {
            let root = find(&leader, e);
            numbers.iter().position(|&n| n == root).unwrap_or_else(|| {
                numbers.push(root);
                numbers.len() - 1
            })
        })
    })
}

/// The nodes of a grid.
struct Grid {
    origin: Point3<f64>,
    /// Side of a cell, metres.
    cell: f64,
    /// Nodes along x, y and z.
    counts: [usize; 3],
}

impl Grid {
    /// Place of a node in x-major order.
    fn node(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.counts[1] + y) * self.counts[0] + x
    }

    fn at(&self, node: [usize; 3]) -> Point3<f64> {
        self.origin + Vector3::from(node.map(|v| v as f64)) * self.cell
    }

    /// Number of the block that a node lies in.
    fn block(&self, [x, y, z]: [usize; 3]) -> u32 {
        let [nx, ny, _] = self.counts.map(|n| n.div_ceil(BLOCK));
        ((z / BLOCK * ny + y / BLOCK) * nx + x / BLOCK) as u32
    }

    /// The values of `field` at all nodes, and what is near to the blocks at the surface.
    ///
    /// Blocks far from the surface get one value for all their nodes: the field grows about as fast as
    /// the distance, so its sign cannot change inside.
    fn sample(&self, field: &Field) -> (Vec<f64>, HashMap<u32, Near>) {
        let [nx, ny, nz] = self.counts;
        let radius = self.cell * (BLOCK as f64 - 1.0) * 3f64.sqrt() / 2.0;
        let far = FAR * radius + self.cell;
        let half = Vector3::repeat((BLOCK as f64 - 1.0) * 0.5 * self.cell);
        let mut near = HashMap::new();
        let mut values = vec![0.0; nx * ny * nz];
        for first in nodes([0..nx, 0..ny, 0..nz], BLOCK) {
            let centre = self.at(first) + half;
            let middle = field.value(&centre);
            // Vertices of the block's cells lie a cell further out, and move some on the surface.
            let parts = (middle.abs() <= far).then(|| field.near(&centre, radius + 3.0 * self.cell));
            let [x, y, z] = [0, 1, 2].map(|k| first[k]..(first[k] + BLOCK).min(self.counts[k]));
            for node in nodes([x, y, z], 1) {
                values[self.node(node)] = match &parts {
                    Some(parts) => field.value_near(parts, &self.at(node)),
                    None => middle,
                };
            }
            if let Some(parts) = parts {
                near.insert(self.block(first), parts);
            }
        }
        (values, near)
    }
}

/// Every `step`th node in these ranges, x fastest.
fn nodes([x, y, z]: [Range<usize>; 3], step: usize) -> impl Iterator<Item = [usize; 3]> {
    z.step_by(step).flat_map(move |z| {
        let x = x.clone();
        y.clone().step_by(step).flat_map(move |y| x.clone().step_by(step).map(move |x| [x, y, z]))
    })
}

/// A cell that the surface crosses: number of its first vertex, and the sheet of each edge.
type Crossed = (u32, [Option<usize>; 12]);

/// The net of `field` in cells of size `cell`; `shift` (in cells) moves the grid.
pub(super) fn surface_net(field: &Field, cell: f64, shift: f64) -> Net {
    let (low, high) = field.bounds();
    let counts = (high - low).map(|v| ((v / cell).ceil() as usize + 2).clamp(1, MAX_CELLS) + 1);
    let grid = Grid { origin: Point3::from(low.add_scalar(-shift * cell)), cell, counts: counts.into() };
    let (values, near) = grid.sample(field);
    let mut net = Net { points: Vec::new(), blocks: Vec::new(), quads: Vec::new(), near };
    let cells = net.place_vertices(&grid, &values);
    net.join_vertices(&grid, &values, &cells);
    net
}

impl Net {
    /// Adds a vertex for each sheet of each cell, in the middle of where the sheet crosses the cell's edges.
    fn place_vertices(&mut self, grid: &Grid, values: &[f64]) -> HashMap<usize, Crossed> {
        let mut cells = HashMap::new();
        let [x, y, z] = grid.counts.map(|n| 0..n - 1);
        for cell in nodes([x, y, z], 1) {
            let [x, y, z] = cell;
            let value: [f64; 8] =
                std::array::from_fn(|c| values[grid.node([x + (c & 1), y + (c >> 1 & 1), z + (c >> 2 & 1)])]);
            let inside = value.map(|v| v < 0.0);
            if inside.iter().all(|&i| i == inside[0]) {
                continue;
            }
            let first = self.points.len() as u32;
            let sheet = sheets(inside);
            let mut sums: Vec<(Vector3<f64>, f64)> = Vec::new();
            for (edge, sheet) in EDGES.iter().zip(sheet) {
                let Some(sheet) = sheet else { continue };
                if sums.len() <= sheet {
                    sums.resize(sheet + 1, (Vector3::zeros(), 0.0));
                }
                let [a, b] = *edge;
                let t = value[a] / (value[a] - value[b]);
                sums[sheet].0 += corner(a) + (corner(b) - corner(a)) * t;
                sums[sheet].1 += 1.0;
            }
            for (sum, count) in sums {
                self.points.push(grid.at(cell) + sum / count * grid.cell);
                self.blocks.push(grid.block(cell));
            }
            cells.insert(grid.node(cell), (first, sheet));
        }
        cells
    }

    /// Adds a quad for every edge of the grid that the surface crosses.
    fn join_vertices(&mut self, grid: &Grid, values: &[f64], cells: &HashMap<usize, Crossed>) {
        let [x, y, z] = grid.counts.map(|n| 1..n - 1);
        for [x, y, z] in nodes([x, y, z], 1) {
            let here = values[grid.node([x, y, z])] < 0.0;
            // The four cells around the edge, counter-clockwise seen from its far end, and which
            // of their own edges it is.
            let mut edge = |there: [usize; 3], around: [([usize; 3], usize); 4]| {
                if here == (values[grid.node(there)] < 0.0) {
                    return;
                }
                let vertex = |(cell, edge): ([usize; 3], usize)| {
                    let (first, sheet) = cells.get(&grid.node(cell))?;
                    Some(first + sheet[edge]? as u32)
                };
                if let [Some(a), Some(b), Some(c), Some(d)] = around.map(vertex) {
                    self.quads.push(if here { [a, b, c, d] } else { [d, c, b, a] });
                }
            };
            let (x0, y0, z0) = (x - 1, y - 1, z - 1);
            edge([x + 1, y, z], [([x, y0, z0], 3), ([x, y, z0], 2), ([x, y, z], 0), ([x, y0, z], 1)]);
            edge([x, y + 1, z], [([x0, y, z0], 7), ([x0, y, z], 5), ([x, y, z], 4), ([x, y, z0], 6)]);
            edge([x, y, z + 1], [([x0, y0, z], 11), ([x, y0, z], 10), ([x, y, z], 8), ([x0, y, z], 9)]);
        }
    }

    /// Triangles by one diagonal of each quad, to look at the topology.
    pub(super) fn triangles(&self) -> Vec<[u32; 3]> {
        self.quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect()
    }

    /// Drops all but the connected part with the most quads.
    pub(super) fn keep_largest_part(&mut self) {
        let mut leader: Vec<u32> = (0..self.points.len() as u32).collect();
        fn find(leader: &mut [u32], mut i: u32) -> u32 {
            while leader[i as usize] != i {
                leader[i as usize] = leader[leader[i as usize] as usize];
                i = leader[i as usize];
            }
            i
        }
        for q in &self.quads {
            for k in 1..4 {
                let (a, b) = (find(&mut leader, q[0]), find(&mut leader, q[k]));
                leader[b as usize] = a;
            }
        }
        let mut sizes = vec![0u32; self.points.len()];
        for q in &self.quads {
            sizes[find(&mut leader, q[0]) as usize] += 1;
        }
        let largest =
            sizes.iter().enumerate().max_by_key(|&(i, s)| (*s, usize::MAX - i)).map(|(i, _)| i as u32);
        let all = std::mem::take(&mut self.quads);
        let (points, blocks) = (std::mem::take(&mut self.points), std::mem::take(&mut self.blocks));
        let mut number = vec![u32::MAX; points.len()];
        for q in all {
            if Some(find(&mut leader, q[0])) == largest {
                let quad = q.map(|i| {
                    let i = i as usize;
                    if number[i] == u32::MAX {
                        number[i] = self.points.len() as u32;
                        self.points.push(points[i]);
                        self.blocks.push(blocks[i]);
                    }
                    number[i]
                });
                self.quads.push(quad);
            }
        }
    }

    /// Moves the vertices onto the surface and spreads them; splits quads along their shorter diagonal.
    pub(super) fn refine(self, field: &Field) -> Polygons {
        let everything = field.near(&Point3::origin(), f64::MAX);
        let Net { mut points, blocks, quads, near } = self;
        let parts: Vec<&Near> = blocks.iter().map(|b| near.get(b).unwrap_or(&everything)).collect();
        let project = |points: &mut [Point3<f64>], steps: usize| {
            for (p, near) in points.iter_mut().zip(&parts) {
                for _ in 0..steps {
                    let g = field.gradient_near(near, p);
                    *p -= g * (field.value_near(near, p) / g.norm_squared().max(0.05));
                }
            }
        };
        let normals = |points: &[Point3<f64>]| -> Vec<Option<Vector3<f64>>> {
            let all = points.iter().zip(&parts);
            all.map(|(p, near)| field.gradient_near(near, p).try_normalize(1e-9)).collect()
        };
        project(&mut points, 2);
        let mut sums = vec![(Vector3::zeros(), 0.0); points.len()];
        let mut outward = Vec::new();
        for pass in 0..6 {
            // The surface is smooth on the scale of these steps: old normals do for two passes more.
            if pass % 3 == 0 {
                outward = normals(&points);
            }
            sums.fill((Vector3::zeros(), 0.0));
            for q in &quads {
                for k in 0..4 {
                    let (here, next) = (q[k] as usize, q[(k + 1) % 4] as usize);
                    sums[here].0 += points[next].coords;
                    sums[here].1 += 1.0;
                    sums[next].0 += points[here].coords;
                    sums[next].1 += 1.0;
                }
            }
            for (i, (p, (sum, count))) in points.iter_mut().zip(&sums).enumerate() {
                let Some(normal) = outward[i] else { continue };
                // Along the surface only, so that no volume is lost.
                let step = sum / *count - p.coords;
                *p += (step - normal * step.dot(&normal)) * 0.6;
                *p -= normal * field.value_near(parts[i], p);
            }
        }
        project(&mut points, 1);
        let normals = normals(&points).into_iter().map(|n| n.unwrap_or_else(Vector3::y)).collect();
        let triangles = quads
            .iter()
            .flat_map(|q| {
                let [a, b, c, d] = q.map(|i| points[i as usize]);
                if (a - c).norm_squared() <= (b - d).norm_squared() {
                    [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]
                } else {
                    [[q[0], q[1], q[3]], [q[1], q[2], q[3]]]
                }
            })
            .collect();
        Polygons { points, normals, triangles }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_list_their_edges_in_order() {
        for face in FACES {
            for k in 0..4 {
                let (e, f) = (EDGES[face[k]], EDGES[face[(k + 1) % 4]]);
                assert_eq!(e.iter().filter(|c| f.contains(c)).count(), 1, "{face:?}");
            }
        }
    }

    #[test]
    fn every_sheet_of_every_cell_is_a_closed_loop() {
        for bits in 0..256usize {
            let inside: [bool; 8] = std::array::from_fn(|c| bits >> c & 1 == 1);
            let sheet = sheets(inside);
            for (edge, s) in EDGES.iter().zip(sheet) {
                assert_eq!(s.is_some(), inside[edge[0]] != inside[edge[1]]);
            }
            let count = sheet.iter().flatten().max().map_or(0, |m| m + 1);
            assert!(count <= 4);
            for s in 0..count {
                assert!(sheet.iter().filter(|e| **e == Some(s)).count() >= 3, "{bits:08b}");
            }
        }
        // Two inside corners in opposition are two sheets.
        let sheet = sheets(std::array::from_fn(|c| c == 0 || c == 7));
        assert_eq!(sheet.iter().flatten().max(), Some(&1));
    }
}
