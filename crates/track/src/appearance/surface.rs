//! The surface of a projected primitive: where it faces, and which part of it is seen.

use super::super::projection::ProjectedSphere;
use handcast_hand::Primitive;

/// Cells of a surface along it and across.
const SIDE: usize = 10;
/// Cells of a surface.
pub(super) const CELLS: usize = SIDE * SIDE;
/// How far the cells of a round surface reach beyond the ends of its axis, shares of the axis.
const BEYOND_ENDS: f32 = 0.3;
/// How far the cells of a flat surface reach beyond its corners, shares of its edges.
const BEYOND_CORNERS: f32 = 0.4;
/// Square of an axis, square pixels, and length of a normal, pixels, below which there is none.
const NOTHING: f32 = 1e-3;
/// Least radius that normals are taken with, pixels.
const THINNEST: f32 = 0.5;

/// A primitive made ready for normals, and divided into cells.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    start: [f32; 2],
    along: [f32; 2],
    /// One over the square of the length of `along`; 0 for a hull of more than two spheres.
    inverse: f32,
    radii: [f32; 2],
    /// Unit vector of the axis, or the normal of a flat hull: right, up, towards the viewer.
    axis: [f32; 3],
    pub(super) flat: bool,
    /// Where the last sphere of a flat hull is, seen from the first.
    across: [f32; 2],
}

impl Surface {
    pub(super) fn of(
        primitive: &Primitive,
        spheres: &[ProjectedSphere],
        origin: [f64; 2],
        scale: f64,
    ) -> Self {
        let at = |i: u8| spheres.get(usize::from(i));
        let place = |s: &ProjectedSphere| [(s.disc.x - origin[0]) as f32, (s.disc.y - origin[1]) as f32];
        let flat = primitive.spheres.len() > 2;
        let (Some(a), Some(b)) =
            (primitive.spheres.first().and_then(|&i| at(i)), primitive.spheres.get(1).and_then(|&i| at(i)))
        else {
            return Self {
                start: [0.0; 2],
                along: [0.0; 2],
                inverse: 0.0,
                radii: [1.0; 2],
                axis: [0.0, 0.0, 1.0],
                flat,
                across: [0.0, 1.0],
            };
        };
        let (start, end) = (place(a), place(b));
        let offset = |p: [f32; 2]| [p[0] - start[0], p[1] - start[1]];
        let along = offset(end);
        let last = primitive.spheres.last().and_then(|&i| at(i));
        let square = along[0] * along[0] + along[1] * along[1];
        let axis = if flat {
            // The normal of the triangle of the first two spheres and the last.
            let c = last.unwrap_or(b);
            let vector = |s: &ProjectedSphere| {
                let [x, y] = offset(place(s));
                let z = ((s.depth() - a.depth()) * scale) as f32;
                nalgebra::Vector3::new(x, -y, z)
            };
            let n = vector(b).cross(&vector(c));
            n * n.z.signum()
        } else {
            nalgebra::Vector3::new(along[0], -along[1], ((b.depth() - a.depth()) * scale) as f32)
        };
        let axis = axis.try_normalize(NOTHING).unwrap_or_else(nalgebra::Vector3::z);
        Self {
            start,
            along,
            inverse: if flat || square < NOTHING { 0.0 } else { 1.0 / square },
            radii: [a.disc.radius as f32, b.disc.radius as f32],
            axis: axis.into(),
            flat,
            across: last.map_or([0.0, 1.0], |c| offset(place(c))),
        }
    }

    /// The cell of the surface, below [`CELLS`], at a place of the window, pixels.
    pub(super) fn cell(&self, at: [f32; 2]) -> usize {
        let (dx, dy) = (at[0] - self.start[0], at[1] - self.start[1]);
        let [ax, ay] = self.along;
        let (u, v) = if self.flat {
            let [bx, by] = self.across;
            let area = ax * by - ay * bx;
            let area = if area.abs() < 1.0 { 1.0 } else { area };
            let across = 1.0 + 2.0 * BEYOND_CORNERS;
            (
                ((dx * by - dy * bx) / area + BEYOND_CORNERS) / across,
                ((ax * dy - ay * dx) / area + BEYOND_CORNERS) / across,
            )
        } else {
            let side = (dx * ay - dy * ax) * self.inverse.sqrt() / self.radii[0].max(1.0);
            (
                ((dx * ax + dy * ay) * self.inverse + BEYOND_ENDS) / (1.0 + 2.0 * BEYOND_ENDS),
                0.5 * (side + 1.0),
            )
        };
        let place = |v: f32| (v * SIDE as f32).clamp(0.0, SIDE as f32 - 1.0) as usize;
        place(u) * SIDE + place(v)
    }

    /// The unit normal at a place of the window, pixels: right, up, towards the viewer.
    pub(super) fn normal(&self, at: [f32; 2]) -> [f32; 3] {
        if self.flat {
            return self.axis;
        }
        let (dx, dy) = (at[0] - self.start[0], at[1] - self.start[1]);
        let t = ((dx * self.along[0] + dy * self.along[1]) * self.inverse).clamp(0.0, 1.0);
        let radius = (self.radii[0] + t * (self.radii[1] - self.radii[0])).max(THINNEST);
        let (ox, oy) = ((dx - t * self.along[0]) / radius, (dy - t * self.along[1]) / radius);
        let z = (1.0 - ox * ox - oy * oy).max(0.0).sqrt();
        let mut n = [ox, -oy, z];
        if t > 0.0 && t < 1.0 {
            // The side of a cylinder is perpendicular to its axis.
            let along = n[0] * self.axis[0] + n[1] * self.axis[1] + n[2] * self.axis[2];
            for (v, a) in n.iter_mut().zip(self.axis) {
                *v -= along * a;
            }
        }
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(NOTHING);
        n.map(|v| v / length)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::projection::{COLUMNS, OWN};
    use super::super::super::raster::ProjectedDisc;
    use super::*;

    #[test]
    fn cells_keep_to_the_surface_when_it_moves() {
        let sphere = |x, y, depth| ProjectedSphere {
            disc: ProjectedDisc { x, y, radius: 10.0 },
            centre: nalgebra::Vector3::new(0.0, 0.0, depth),
            radius: 0.1,
            finger: None,
            columns: [[0.0; 3]; COLUMNS],
            moves: [nalgebra::Vector3::zeros(); OWN],
        };
        let primitive = |n: u8| Primitive { spheres: (0..n).collect() };
        for n in [2, 3] {
            let lying = [sphere(20.0, 30.0, 0.0), sphere(60.0, 30.0, 0.0), sphere(60.0, 60.0, 0.0)];
            // A quarter turn about the first centre.
            let standing = [sphere(20.0, 30.0, 0.0), sphere(20.0, 70.0, 0.0), sphere(-10.0, 70.0, 0.0)];
            let [a, b] = [lying, standing].map(|s| Surface::of(&primitive(n), &s, [0.0, 0.0], 100.0));
            let mut seen = std::collections::BTreeSet::new();
            for (u, v) in (0..50).flat_map(|u| (-8..9).map(move |v| (u as f32 + 0.37, v as f32 + 0.21))) {
                assert_eq!(a.cell([20.0 + u, 30.0 + v]), b.cell([20.0 - v, 30.0 + u]), "{n}: {u} {v}");
                seen.insert(a.cell([20.0 + u, 30.0 + v]));
            }
            assert!(seen.len() > 10 && seen.iter().all(|&c| c < CELLS));
        }
    }
}
