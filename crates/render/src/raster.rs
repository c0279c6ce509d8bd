//! Triangles to a supersampled z-buffer.

use nalgebra::{Isometry3, Point3};

use super::MAX_SIDE;

/// Nearest drawn distance in front of a perspective camera, metres.
const NEAR: f64 = 0.01;

/// How camera space becomes pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Pinhole.
    Perspective {
        /// Focal length, pixels.
        focal: f64,
    },
    /// Parallel.
    Orthographic {
        /// Pixels per metre.
        scale: f64,
    },
}

/// A camera: +X right, +Y up, looking along −Z; image x right, y down, pixel centres at .5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// World to camera space.
    pub view: Isometry3<f64>,
    /// Camera space to pixels.
    pub projection: Projection,
    /// Where the axis meets the image, pixels.
    pub centre: [f64; 2],
}

impl Camera {
    /// A pinhole at the origin with the axis in the middle of a picture of `size` pixels.
    pub fn pinhole(size: (u32, u32), focal: f64) -> Self {
        Self {
            view: Isometry3::identity(),
            projection: Projection::Perspective { focal },
            centre: [f64::from(size.0) / 2.0, f64::from(size.1) / 2.0],
        }
    }

    /// Where a world point falls in the image; `None` behind a perspective camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<[f64; 2]> {
        self.project_view(&(self.view * point)).map(|p| [p[0], p[1]])
    }

    /// Pixels and depth of a point in camera space. Depth grows away from the camera and is linear in
    /// the image along a plane: −1/distance, or distance for parallel projection.
    fn project_view(&self, q: &Point3<f64>) -> Option<[f64; 3]> {
        let (scale, depth) = match self.projection {
            Projection::Perspective { focal } if -q.z >= NEAR => (focal / -q.z, 1.0 / q.z),
            Projection::Perspective { .. } => return None,
            Projection::Orthographic { scale } => (scale, -q.z),
        };
        Some([self.centre[0] + scale * q.x, self.centre[1] - scale * q.y, depth])
    }
}

/// Something to draw.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Vertices in world space, metres.
    pub positions: &'a [[f32; 3]],
    /// Unit normals in world space.
    pub normals: &'a [[f32; 3]],
    /// Triangles, counter-clockwise seen from outside; others are not drawn.
    pub triangles: &'a [[u32; 3]],
    /// Linear colour factors by vertex; may be empty.
    pub tints: &'a [[f32; 3]],
    /// How much of each vertex's skin is that of the palm, 0 to 1; may be empty.
    pub palms: &'a [f32],
    /// Where each vertex sits in its material (metres), to hold surface texture still; may be empty.
    pub grain: &'a [[f32; 3]],
    /// A number found again in [`Raster::coverage`].
    pub layer: u8,
}

impl Surface<'_> {
    /// The weighted mean of an attribute over a triangle; zero where data are missing.
    pub(super) fn mix(data: &[[f32; 3]], triangle: [u32; 3], share: [f32; 3]) -> Option<[f32; 3]> {
        let mut out = [0.0; 3];
        for (index, share) in triangle.into_iter().zip(share) {
            let v = data.get(index as usize)?;
            for k in 0..3 {
                out[k] += share * v[k];
            }
        }
        Some(out)
    }

    /// How much of the skin is that of the palm at a place of a triangle, where the surface tells it.
    pub(super) fn palm(&self, triangle: [u32; 3], share: [f32; 3]) -> Option<f32> {
        let corners = triangle.map(|index| self.palms.get(index as usize));
        let [Some(a), Some(b), Some(c)] = corners else { return None };
        Some(a * share[0] + b * share[1] + c * share[2])
    }
}

/// What one sample sees.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Order of drawing; `u32::MAX` for nothing.
    pub(super) surface: u32,
    pub(super) triangle: u32,
    /// Shares of the triangle's first two corners (perspective-correct).
    pub(super) share: [f32; 2],
    /// As [`Camera::project_view`].
    pub(super) depth: f32,
}

impl Sample {
    const NOTHING: Sample = Sample { surface: u32::MAX, triangle: 0, share: [0.0; 2], depth: f32::INFINITY };

    pub(super) fn hit(&self) -> bool {
        self.surface != u32::MAX
    }

    /// Shares of the triangle's three corners.
    pub(super) fn shares(&self) -> [f32; 3] {
        [self.share[0], self.share[1], 1.0 - self.share[0] - self.share[1]]
    }
}

/// A z-buffer with `samples` × `samples` samples a pixel.
#[derive(Clone, Debug)]
pub struct Raster {
    width: u32,
    height: u32,
    samples: u32,
    pub(super) buffer: Vec<Sample>,
    layers: Vec<u8>,
}

impl Raster {
    /// An empty raster. Sizes are held between 1 and [`MAX_SIDE`], samples between 1 and 4.
    pub fn new(width: u32, height: u32, samples: u32) -> Self {
        let (width, height) = (width.clamp(1, MAX_SIDE), height.clamp(1, MAX_SIDE));
        let samples = samples.clamp(1, 4);
        let buffer = vec![Sample::NOTHING; (width * samples) as usize * (height * samples) as usize];
        Self { width, height, samples, buffer, layers: Vec::new() }
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Samples along one side of a pixel.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// Samples along one row.
    pub(super) fn stride(&self) -> usize {
        (self.width * self.samples) as usize
    }

    /// Draws the front faces of `surface`. Triangles that reach behind the camera are left out.
    pub fn draw(&mut self, surface: &Surface, camera: &Camera) {
        let scale = f64::from(self.samples);
        let points: Vec<Option<[f64; 3]>> = surface
            .positions
            .iter()
            .map(|p| {
                let p = camera.view * Point3::from(*p).cast::<f64>();
                let [x, y, depth] = camera.project_view(&p)?;
                (x.is_finite() && y.is_finite() && depth.is_finite()).then_some([x * scale, y * scale, depth])
            })
            .collect();
        let id = self.layers.len() as u32;
        self.layers.push(surface.layer);
        let perspective = matches!(camera.projection, Projection::Perspective { .. });
        for (number, t) in surface.triangles.iter().enumerate() {
            let corner = |k: usize| points.get(t[k] as usize).copied().flatten();
            if let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) {
                self.draw_triangle([a, b, c], perspective, id, number as u32);
            }
        }
    }

    fn draw_triangle(&mut self, [a, b, c]: [[f64; 3]; 3], perspective: bool, surface: u32, triangle: u32) {
        // Image y runs down, so front faces turn clockwise: positive in this orientation.
        let area = (c[0] - a[0]) * (b[1] - a[1]) - (b[0] - a[0]) * (c[1] - a[1]);
        if area <= 0.0 {
            return;
        }
        let (width, height) = (self.stride(), (self.height * self.samples) as usize);
        let range = |k: usize, size: usize| {
            let low = a[k].min(b[k]).min(c[k]) - 0.5;
            let high = a[k].max(b[k]).max(c[k]) - 0.5;
            (low.ceil().max(0.0) as usize, high.floor().min(size as f64 - 1.0))
        };
        let ((x0, x1), (y0, y1)) = (range(0, width), range(1, height));
        if x1 < 0.0 || y1 < 0.0 {
            return;
        }
        let inverse = 1.0 / area;
        for y in y0..=y1 as usize {
            let py = y as f64 + 0.5;
            for x in x0..=x1 as usize {
                let px = x as f64 + 0.5;
                let u = ((c[0] - b[0]) * (py - b[1]) - (px - b[0]) * (c[1] - b[1])) * -inverse;
                let v = ((a[0] - c[0]) * (py - c[1]) - (px - c[0]) * (a[1] - c[1])) * -inverse;
                let w = 1.0 - u - v;
                if u < 0.0 || v < 0.0 || w < 0.0 {
                    continue;
                }
                let depth = (u * a[2] + v * b[2] + w * c[2]) as f32;
                let Some(sample) = self.buffer.get_mut(y * width + x) else { continue };
                if depth < sample.depth {
                    let share = if perspective {
                        let z = f64::from(depth);
                        [(u * a[2] / z) as f32, (v * b[2] / z) as f32]
                    } else {
                        [u as f32, v as f32]
                    };
                    *sample = Sample { surface, triangle, share, depth };
                }
            }
        }
    }

    /// Share of each pixel's samples that see `layer`, 0 to 255, row by row.
    pub fn coverage(&self, layer: u8) -> Vec<u8> {
        self.count(|sample| self.layers.get(sample.surface as usize) == Some(&layer))
    }

    /// As [`Raster::coverage`], counting the samples whose place in the material ([`Surface::grain`])
    /// `inside` accepts; `surfaces` as drawn, in that order.
    pub fn coverage_where(
        &self,
        layer: u8,
        surfaces: &[Surface],
        inside: impl Fn([f32; 3]) -> bool,
    ) -> Vec<u8> {
        self.count(|sample| {
            let place = || {
                let surface = surfaces.get(sample.surface as usize).filter(|s| s.layer == layer)?;
                let triangle = *surface.triangles.get(sample.triangle as usize)?;
                Surface::mix(surface.grain, triangle, sample.shares())
            };
            place().is_some_and(&inside)
        })
    }

    fn count(&self, wanted: impl Fn(&Sample) -> bool) -> Vec<u8> {
        let mut counts = vec![0u32; (self.width * self.height) as usize];
        let (s, stride) = (self.samples as usize, self.stride());
        for (i, sample) in self.buffer.iter().enumerate() {
            if sample.hit() && wanted(sample) {
                counts[(i / stride / s) * self.width as usize + (i % stride) / s] += 1;
            }
        }
        let full = self.samples * self.samples;
        counts.into_iter().map(|n| ((n * 255 + full / 2) / full) as u8).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_covers_its_area_and_the_nearer_surface_wins() {
        let disc = |z: f32, r: f32| -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
            let n = 64u32;
            let mut points = vec![[0.0, 0.0, z]];
            for i in 0..n {
                let a = i as f32 / n as f32 * std::f32::consts::TAU;
                points.push([r * a.cos(), r * a.sin(), z]);
            }
            (points, (0..n).map(|i| [0, 1 + i, 1 + (i + 1) % n]).collect())
        };
        let camera = Camera::pinhole((100, 80), 100.0);
        let mut raster = Raster::new(100, 80, 3);
        for (layer, z, r) in [(1, -1.0, 0.3), (2, -2.0, 0.72)] {
            let (positions, triangles) = disc(z, r);
            let surface = Surface {
                positions: &positions,
                normals: &[],
                triangles: &triangles,
                tints: &[],
                palms: &[],
                grain: &[],
                layer,
            };
            raster.draw(&surface, &camera);
        }
        let area = |layer| raster.coverage(layer).iter().map(|&v| f64::from(v) / 255.0).sum::<f64>();
        let pi = std::f64::consts::PI;
        assert!((area(1) - pi * 900.0).abs() < 20.0, "{}", area(1));
        assert!((area(2) - pi * (1296.0 - 900.0)).abs() < 20.0, "{}", area(2));
        assert_eq!(raster.coverage(1)[40 * 100 + 50], 255);
    }

    #[test]
    fn faces_seen_from_behind_and_points_behind_the_camera_are_not_drawn() {
        let camera = Camera::pinhole((20, 20), 20.0);
        for (points, triangle) in [
            ([[-0.5, -0.5, -1.0], [0.5, -0.5, -1.0], [0.0, 0.5, -1.0]], [0, 2, 1]),
            ([[-0.5, -0.5, -1.0], [0.5, -0.5, -1.0], [0.0, 0.5, 1.0]], [0, 1, 2]),
        ] {
            let mut raster = Raster::new(20, 20, 1);
            let surface = Surface {
                positions: &points,
                normals: &[],
                triangles: &[triangle],
                tints: &[],
                palms: &[],
                grain: &[],
                layer: 1,
            };
            raster.draw(&surface, &camera);
            assert!(raster.coverage(1).iter().all(|&v| v == 0));
        }
    }
}
