//! How well the shading of the model explains the luminance inside the silhouette.
//!
//! Skin is nearly matt, and under any distant light its luminance is close to a linear function of the
//! surface normal (Ramamoorthi & Hanrahan 2001, first order). That function is fitted to the picture for each
//! posture that is compared: what it leaves unexplained tells postures apart that have the same silhouette.

use nalgebra::{SMatrix, SVector};

use super::cover::{COARSE, Cover, NONE};
use super::evidence::Evidence;
use super::projection::ProjectedSphere;
use crate::hand::Primitive;

/// Terms of the fit: a constant, the normal, and another constant for the palm.
const TERMS: usize = 5;
/// Luminance that noise and texture leave unexplained, levels.
const NOISE: f32 = 4.0;
/// Errors beyond this are shadows or things the model lacks, levels.
const OUTLIER: f32 = 30.0;
/// Every how many cells of the buffer one is looked at, each way.
const STRIDE: usize = 2;

/// A primitive made ready for normals.
#[derive(Clone, Copy, Debug)]
struct Surface {
    start: [f32; 2],
    along: [f32; 2],
    /// One over the square of the length of `along`; 0 for a hull of more than two spheres.
    inverse: f32,
    radii: [f32; 2],
    /// Unit vector of the axis, or the normal of a flat hull: right, up, towards the viewer.
    axis: [f32; 3],
    flat: bool,
}

/// Fits shading to luminance. Holds the buffers.
#[derive(Clone, Debug, Default)]
pub(super) struct Appearance {
    surfaces: Vec<Surface>,
    rows: Vec<([f32; TERMS], f32)>,
}

impl Appearance {
    /// The mean square of luminance left unexplained, levels², robustly; `None` without a picture or model.
    /// `cover` is the model drawn over the window of `evidence`; `scale` is pixels per metre.
    pub(super) fn unexplained(
        &mut self,
        primitives: &[Primitive],
        spheres: &[ProjectedSphere],
        cover: &Cover,
        evidence: &Evidence,
        scale: f64,
    ) -> Option<f64> {
        let (luma, width) = evidence.coarse_luma();
        let (front, length) = cover.front();
        if luma.is_empty() || width != length {
            return None;
        }
        let origin = evidence.window().origin();
        self.surfaces.clear();
        self.surfaces.extend(primitives.iter().map(|p| Surface::of(p, spheres, origin, scale)));
        self.rows.clear();
        let silhouette = evidence.window().silhouette();
        let rows = front.chunks(length.max(1)).zip(luma.chunks(width.max(1))).enumerate();
        for (y, (ids, values)) in rows.step_by(STRIDE) {
            for x in (0..ids.len()).step_by(STRIDE) {
                let id = ids[x];
                let place = [(x as f32 + 0.5) * COARSE as f32, (y as f32 + 0.5) * COARSE as f32];
                if id == NONE || !silhouette.get(place[0] as u32, place[1] as u32) {
                    continue;
                }
                let Some(surface) = self.surfaces.get(usize::from(id)) else { continue };
                let n = surface.normal(place);
                let terms = [1.0, n[0], n[1], n[2], f32::from(u8::from(surface.flat))];
                self.rows.push((terms, values[x]));
            }
        }
        self.fit()
    }

    /// Least squares, once more without the outliers, and what remains.
    fn fit(&self) -> Option<f64> {
        if self.rows.len() < 50 {
            return None;
        }
        let mut solution: Option<[f32; TERMS]> = None;
        for _ in 0..2 {
            let mut a = SMatrix::<f32, TERMS, TERMS>::zeros();
            let mut b = SVector::<f32, TERMS>::zeros();
            for (terms, value) in &self.rows {
                if solution.is_some_and(|s| (value - product(&s, terms)).abs() > OUTLIER) {
                    continue;
                }
                for i in 0..TERMS {
                    b[i] += terms[i] * value;
                    for j in 0..=i {
                        a[(i, j)] += terms[i] * terms[j];
                    }
                }
            }
            for i in 0..TERMS {
                a[(i, i)] += 1.0;
                for j in 0..i {
                    a[(j, i)] = a[(i, j)];
                }
            }
            let x = a.cholesky()?.solve(&b);
            solution = Some(std::array::from_fn(|i| x[i]));
        }
        let solution = solution?;
        let left: f32 = self
            .rows
            .iter()
            .map(|(terms, value)| (value - product(&solution, terms)).powi(2).min(OUTLIER * OUTLIER))
            .sum();
        Some(f64::from(left / self.rows.len() as f32 + NOISE * NOISE))
    }
}

fn product(a: &[f32; TERMS], b: &[f32; TERMS]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Surface {
    fn of(primitive: &Primitive, spheres: &[ProjectedSphere], origin: [f64; 2], scale: f64) -> Self {
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
            };
        };
        let (start, end) = (place(a), place(b));
        let along = [end[0] - start[0], end[1] - start[1]];
        let square = along[0] * along[0] + along[1] * along[1];
        let axis = if flat {
            // The normal of the triangle of the first two spheres and the last.
            let c = primitive.spheres.last().and_then(|&i| at(i)).unwrap_or(b);
            let vector = |s: &ProjectedSphere| {
                let p = place(s);
                let z = ((s.depth - a.depth) * scale) as f32;
                nalgebra::Vector3::new(p[0] - start[0], -(p[1] - start[1]), z)
            };
            let n = vector(b).cross(&vector(c));
            n * n.z.signum()
        } else {
            nalgebra::Vector3::new(along[0], -along[1], ((b.depth - a.depth) * scale) as f32)
        };
        let axis = axis.try_normalize(1e-3).unwrap_or_else(nalgebra::Vector3::z);
        Self {
            start,
            along,
            inverse: if flat || square < 1e-3 { 0.0 } else { 1.0 / square },
            radii: [a.disc.radius as f32, b.disc.radius as f32],
            axis: axis.into(),
            flat,
        }
    }

    /// The unit normal at a place of the window, pixels: right, up, towards the viewer.
    fn normal(&self, at: [f32; 2]) -> [f32; 3] {
        if self.flat {
            return self.axis;
        }
        let (dx, dy) = (at[0] - self.start[0], at[1] - self.start[1]);
        let t = ((dx * self.along[0] + dy * self.along[1]) * self.inverse).clamp(0.0, 1.0);
        let radius = (self.radii[0] + t * (self.radii[1] - self.radii[0])).max(0.5);
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
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(1e-3);
        n.map(|v| v / length)
    }
}
