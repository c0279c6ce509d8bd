//! Surface nets: one vertex in every grid cell the surface crosses, one quad for every grid edge it
//! crosses; then the vertices are spread evenly on the surface.

use nalgebra::{Point3, Vector3};

use super::field::Field;

/// Cells along one axis, at most: bounds memory for any morphology.
const MAX_CELLS: usize = 256;

/// Triangles with outward, counter-clockwise winding.
#[derive(Clone, Debug, Default)]
pub(super) struct Polygons {
    pub(super) points: Vec<Point3<f64>>,
    pub(super) triangles: Vec<[u32; 3]>,
}

/// The surface of `field` in cells of size `cell`; `shift` (in cells) moves the grid.
pub(super) fn surface_nets(field: &Field, cell: f64, shift: f64) -> Polygons {
    let (low, high) = field.bounds();
    let origin = Point3::from(low.add_scalar(-shift * cell));
    let counts = (high - low).map(|v| ((v / cell).ceil() as usize + 2).clamp(1, MAX_CELLS));
    let (nx, ny, nz) = (counts.x + 1, counts.y + 1, counts.z + 1);
    let node = |x: usize, y: usize, z: usize| (z * ny + y) * nx + x;
    let at = |x: usize, y: usize, z: usize| origin + Vector3::new(x as f64, y as f64, z as f64) * cell;
    // Blocks far from the surface get one value for all their nodes: the field grows about as fast as
    // the distance, so its sign cannot change inside.
    const BLOCK: usize = 4;
    let far = 1.25 * cell * BLOCK as f64 * 3f64.sqrt() / 2.0 + cell;
    let mut values = vec![0.0; nx * ny * nz];
    for z0 in (0..nz).step_by(BLOCK) {
        for y0 in (0..ny).step_by(BLOCK) {
            for x0 in (0..nx).step_by(BLOCK) {
                let half = Vector3::repeat((BLOCK as f64 - 1.0) * 0.5 * cell);
                let middle = field.value(&(at(x0, y0, z0) + half));
                let near = middle.abs() <= far;
                for z in z0..(z0 + BLOCK).min(nz) {
                    for y in y0..(y0 + BLOCK).min(ny) {
                        for x in x0..(x0 + BLOCK).min(nx) {
                            values[node(x, y, z)] = if near { field.value(&at(x, y, z)) } else { middle };
                        }
                    }
                }
            }
        }
    }

    let mut out = Polygons::default();
    // Vertex number of the cell whose low corner is this node.
    let mut vertex = vec![u32::MAX; values.len()];
    for z in 0..nz - 1 {
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                if let Some(offset) = cell_vertex(|i, j, k| values[node(x + i, y + j, z + k)]) {
                    vertex[node(x, y, z)] = out.points.len() as u32;
                    out.points.push(at(x, y, z) + offset * cell);
                }
            }
        }
    }
    let mut quads = Vec::new();
    for z in 1..nz - 1 {
        for y in 1..ny - 1 {
            for x in 1..nx - 1 {
                let here = values[node(x, y, z)] < 0.0;
                let mut edge = |there: f64, cells: [usize; 4]| {
                    if here != (there < 0.0) {
                        let quad = cells.map(|c| vertex[c]);
                        // `cells` turn counter-clockwise seen from the far end of the edge.
                        quads.push(if here { quad } else { [quad[3], quad[2], quad[1], quad[0]] });
                    }
                };
                edge(
                    values[node(x + 1, y, z)],
                    [node(x, y - 1, z - 1), node(x, y, z - 1), node(x, y, z), node(x, y - 1, z)],
                );
                edge(
                    values[node(x, y + 1, z)],
                    [node(x - 1, y, z - 1), node(x - 1, y, z), node(x, y, z), node(x, y, z - 1)],
                );
                edge(
                    values[node(x, y, z + 1)],
                    [node(x - 1, y - 1, z), node(x, y - 1, z), node(x, y, z), node(x - 1, y, z)],
                );
            }
        }
    }
    project(field, &mut out.points, 2);
    spread_quads(field, &mut out.points, &quads);
    for q in &quads {
        let [a, b, c, d] = q.map(|i| out.points[i as usize]);
        let (p, r) = if (a - c).norm_squared() <= (b - d).norm_squared() {
            ([q[0], q[1], q[2]], [q[0], q[2], q[3]])
        } else {
            ([q[0], q[1], q[3]], [q[1], q[2], q[3]])
        };
        out.triangles.extend([p, r]);
    }
    out
}

/// Mean of the crossings on the twelve edges of the unit cell with these corner values.
fn cell_vertex(value: impl Fn(usize, usize, usize) -> f64) -> Option<Vector3<f64>> {
    const EDGES: [[[usize; 3]; 2]; 12] = [
        [[0, 0, 0], [1, 0, 0]],
        [[0, 1, 0], [1, 1, 0]],
        [[0, 0, 1], [1, 0, 1]],
        [[0, 1, 1], [1, 1, 1]],
        [[0, 0, 0], [0, 1, 0]],
        [[1, 0, 0], [1, 1, 0]],
        [[0, 0, 1], [0, 1, 1]],
        [[1, 0, 1], [1, 1, 1]],
        [[0, 0, 0], [0, 0, 1]],
        [[1, 0, 0], [1, 0, 1]],
        [[0, 1, 0], [0, 1, 1]],
        [[1, 1, 0], [1, 1, 1]],
    ];
    let mut sum = Vector3::zeros();
    let mut count = 0u32;
    for [a, b] in EDGES {
        let (va, vb) = (value(a[0], a[1], a[2]), value(b[0], b[1], b[2]));
        if (va < 0.0) != (vb < 0.0) {
            let t = va / (va - vb);
            let corner = |c: [usize; 3]| Vector3::from(c.map(|v| v as f64));
            sum += corner(a) + (corner(b) - corner(a)) * t;
            count += 1;
        }
    }
    (count > 0).then(|| sum / f64::from(count))
}

/// Newton steps along the gradient onto the surface.
fn project(field: &Field, points: &mut [Point3<f64>], steps: usize) {
    for p in points {
        for _ in 0..steps {
            let g = field.gradient(p);
            *p -= g * (field.value(p) / g.norm_squared().max(0.05));
        }
    }
}

/// Laplacian smoothing along the surface: even quads without losing volume.
fn spread_quads(field: &Field, points: &mut [Point3<f64>], quads: &[[u32; 4]]) {
    let mut sums = vec![(Vector3::zeros(), 0.0); points.len()];
    let mut normals = Vec::new();
    for pass in 0..6 {
        // The surface is smooth on the scale of these steps: old normals do for two passes more.
        if pass % 3 == 0 {
            normals = points.iter().map(|p| field.gradient(p).try_normalize(1e-9)).collect();
        }
        sums.fill((Vector3::zeros(), 0.0));
        for q in quads {
            for k in 0..4 {
                let (here, next) = (q[k] as usize, q[(k + 1) % 4] as usize);
                sums[here].0 += points[next].coords;
                sums[here].1 += 1.0;
                sums[next].0 += points[here].coords;
                sums[next].1 += 1.0;
            }
        }
        for ((p, (sum, count)), normal) in points.iter_mut().zip(&sums).zip(&normals) {
            let Some(normal) = normal else { continue };
            let step = sum / *count - p.coords;
            *p += (step - normal * step.dot(normal)) * 0.6;
            *p -= normal * field.value(p);
        }
    }
    project(field, points, 1);
}
