//! Deferred shading of a [`Raster`].

use image::{Rgb, RgbImage, Rgba, RgbaImage};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::raster::{Camera, Projection, Raster, Sample, Surface};
use handcast_hand::{Mark, NAIL_BED, PLAIN_SKIN, SkinMarks, noise, palm_of};
use handcast_hand::{linear_from_srgb, srgb_from_linear};

/// How surfaces look.
#[derive(Clone, Debug, PartialEq)]
pub struct Style {
    /// Skin colour, sRGB.
    pub skin: [u8; 3],
    /// Background, sRGB; `None` is transparent.
    pub background: Option<[u8; 3]>,
    /// Samples along one side of a pixel, 1 to 4.
    pub samples: u32,
    /// Where the key light comes from, camera space.
    pub light: Vector3<f64>,
    /// Strength of the fine skin texture, 0 to 1.
    pub grain: f32,
    /// Brightness of all light.
    pub exposure: f32,
    /// Shade every sample, not just one for all samples of a pixel that see the same piece of surface: fine
    /// texture is then smoothed as a camera smooths it, at several times the cost.
    pub every_sample: bool,
    /// Shadows are looked up this far above the surface, metres, so that light that grazes it leaves no stripes.
    pub shadow_offset: f64,
}

impl Default for Style {
    fn default() -> Self {
        Self {
            skin: PLAIN_SKIN,
            background: Some([246, 246, 248]),
            samples: 3,
            light: Vector3::new(-0.55, 0.75, 0.75),
            grain: 0.35,
            exposure: 1.0,
            every_sample: false,
            shadow_offset: 0.0018,
        }
    }
}

/// A shaded picture in linear light: red, green, blue (times coverage) and coverage by pixel.
#[derive(Clone, Debug)]
pub struct Shaded {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Row by row.
    pub pixels: Vec<[f32; 4]>,
}

impl Shaded {
    /// On a plain colour, or on nothing.
    pub fn to_rgba(&self, background: Option<[u8; 3]>) -> RgbaImage {
        let mut out = RgbaImage::new(self.width, self.height);
        let behind = background.map(|c| c.map(linear_from_srgb));
        for (pixel, p) in out.pixels_mut().zip(&self.pixels) {
            let [r, g, b, a] = *p;
            *pixel = match behind {
                Some(c) => {
                    let v = [r + c[0] * (1.0 - a), g + c[1] * (1.0 - a), b + c[2] * (1.0 - a)];
                    let [r, g, b] = v.map(|v| srgb_from_linear(v).round() as u8);
                    Rgba([r, g, b, 255])
                }
                None if a > 0.0 => {
                    let [r, g, b] = [r, g, b].map(|v| srgb_from_linear(v / a).round() as u8);
                    Rgba([r, g, b, (a * 255.0).round() as u8])
                }
                None => Rgba([0; 4]),
            };
        }
        out
    }

    /// Over a picture of the same size in linear light (`behind`, row by row); pixels without a
    /// counterpart are black.
    pub fn over(&self, behind: &[[f32; 3]]) -> RgbImage {
        let mut out = RgbImage::new(self.width, self.height);
        for ((pixel, p), c) in out.pixels_mut().zip(&self.pixels).zip(behind) {
            let v: [f32; 3] = std::array::from_fn(|k| p[k] + c[k] * (1.0 - p[3]));
            *pixel = Rgb(v.map(|v| srgb_from_linear(v).round() as u8));
        }
        out
    }
}

/// Depth seen from the key light.
struct ShadowMap {
    raster: Raster,
    camera: Camera,
    /// Offset against self-shadowing, metres.
    bias: f64,
}

const SHADOW_SIDE: u32 = 384;

impl ShadowMap {
    fn new(surfaces: &[Surface], light: &Vector3<f64>) -> Self {
        let up = if light.y.abs() > 0.9 * light.norm() { Vector3::x() } else { Vector3::y() };
        let turn = UnitQuaternion::face_towards(light, &up).inverse();
        let mut low = Vector3::repeat(f64::MAX);
        let mut high = Vector3::repeat(f64::MIN);
        for p in surfaces.iter().flat_map(|s| s.positions) {
            let q = turn * Vector3::from(*p).cast::<f64>();
            if q.iter().all(|v| v.is_finite()) {
                low = low.inf(&q);
                high = high.sup(&q);
            }
        }
        let extent = (high.x - low.x).max(high.y - low.y).clamp(1e-3, 100.0);
        let scale = f64::from(SHADOW_SIDE) * 0.98 / extent;
        let centre = (low + high) / 2.0;
        let half = f64::from(SHADOW_SIDE) / 2.0;
        let camera = Camera {
            view: Isometry3::from_parts(Translation3::from(-centre), turn),
            projection: Projection::Orthographic { scale },
            centre: [half, half],
        };
        let mut raster = Raster::new(SHADOW_SIDE, SHADOW_SIDE, 1);
        for s in surfaces {
            raster.draw(s, &camera);
        }
        Self { raster, camera, bias: 2.0 / scale + 0.0015 }
    }

    /// Share of the light that arrives, from 16 nearby texels with soft thresholds.
    fn light_at(&self, point: &Point3<f64>) -> f32 {
        let q = self.camera.view * point;
        let Some([x, y]) = self.camera.project(point) else { return 1.0 };
        let mut sum = 0.0;
        for dy in 0..4 {
            for dx in 0..4 {
                let (sx, sy) = (x - 2.5 + 1.5 * f64::from(dx), y - 2.5 + 1.5 * f64::from(dy));
                if sx < 0.0 || sy < 0.0 || sx >= f64::from(SHADOW_SIDE) || sy >= f64::from(SHADOW_SIDE) {
                    sum += 1.0;
                    continue;
                }
                let depth = self.raster.buffer[sy as usize * self.raster.stride() + sx as usize].depth;
                let gap = -q.z - self.bias - f64::from(depth);
                sum += if gap.is_nan() { 1.0 } else { 1.0 - (gap / 0.002).clamp(0.0, 1.0) };
            }
        }
        (sum / 16.0) as f32
    }
}

/// Samples of a pixel no further apart in depth than this, metres, see the same piece of surface.
const SAME_PIECE: f32 = 0.003;

/// Shades everything `raster` saw; `surfaces` as drawn into it, in that order, with the same camera.
pub fn shade(raster: &Raster, surfaces: &[Surface], camera: &Camera, style: &Style) -> Shaded {
    shade_marked(raster, surfaces, &[], camera, style)
}

/// [`shade`] with creases and nails: `marks` are those of each surface, looked up where its grain sits.
pub fn shade_marked(
    raster: &Raster,
    surfaces: &[Surface],
    marks: &[&SkinMarks],
    camera: &Camera,
    style: &Style,
) -> Shaded {
    let (width, height) = raster.size();
    let mut pixels = vec![[0.0f32; 4]; (width * height) as usize];
    let shader = Shader::new(surfaces, marks, camera, style);
    let occlusion = Occlusion::new(raster, camera);
    let samples = raster.samples() as usize;
    let stride = raster.stride();
    let share_of_pixel = 1.0 / (samples * samples) as f32;
    let order = from_the_middle(samples);
    let mut pieces: Vec<Piece> = Vec::with_capacity(samples * samples);
    for (at, pixel) in pixels.iter_mut().enumerate() {
        let (px, py) = (at % width as usize * samples, at / width as usize * samples);
        pieces.clear();
        for &(dx, dy) in &order {
            let (x, y) = (px + dx, py + dy);
            let distance = occlusion.distances[y * stride + x];
            if distance == f32::INFINITY {
                continue;
            }
            let sample = &raster.buffer[y * stride + x];
            let same = |p: &&mut Piece| {
                !style.every_sample
                    && p.sample.surface == sample.surface
                    && (p.distance - distance).abs() < SAME_PIECE
            };
            match pieces.iter_mut().find(same) {
                Some(piece) => piece.count += 1.0,
                None => pieces.push(Piece { sample: *sample, distance, at: (x, y), count: 1.0 }),
            }
        }
        // Neighbouring samples share one reading of the occlusion: it is smooth.
        let mut near: Option<f32> = None;
        for piece in &pieces {
            let read = || occlusion.open_at(piece.at.0, piece.at.1);
            let open = if style.every_sample { *near.get_or_insert_with(read) } else { read() };
            if let Some(colour) = shader.light_of(&piece.sample, open) {
                for k in 0..3 {
                    pixel[k] += colour[k] * piece.count;
                }
                pixel[3] += piece.count;
            }
        }
        *pixel = pixel.map(|v| v * share_of_pixel);
    }
    Shaded { width, height, pixels }
}

/// Samples of a pixel that are shaded together.
#[derive(Clone, Copy)]
struct Piece {
    /// The one nearest to the middle of the pixel, its distance and place.
    sample: Sample,
    distance: f32,
    at: (usize, usize),
    count: f32,
}

/// Places of the samples of a pixel, from its middle outwards.
fn from_the_middle(samples: usize) -> Vec<(usize, usize)> {
    let mut places: Vec<_> = (0..samples * samples).map(|i| (i % samples, i / samples)).collect();
    let off = |v: usize| (2 * v + 1).abs_diff(samples);
    places.sort_by_key(|&(x, y)| off(x).pow(2) + off(y).pow(2));
    places
}

/// Light that surfaces send to a camera.
struct Shader<'a> {
    surfaces: &'a [Surface<'a>],
    marks: &'a [&'a SkinMarks],
    camera: &'a Camera,
    style: &'a Style,
    shadows: ShadowMap,
    /// Towards the key light, camera space.
    light: Vector3<f32>,
    /// Of the back and of the palm, linear light.
    skin: [[f32; 3]; 2],
}

impl<'a> Shader<'a> {
    fn new(
        surfaces: &'a [Surface<'a>],
        marks: &'a [&'a SkinMarks],
        camera: &'a Camera,
        style: &'a Style,
    ) -> Self {
        let skin = style.skin.map(linear_from_srgb);
        let to_world = camera.view.inverse();
        let light_world = to_world.rotation * style.light.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        Self {
            surfaces,
            marks,
            camera,
            style,
            shadows: ShadowMap::new(surfaces, &light_world),
            light: (camera.view.rotation * light_world).cast(),
            skin: [skin, palm_of(skin)],
        }
    }

    /// Linear light of what a sample sees, in surroundings that are `open` to a share.
    fn light_of(&self, sample: &Sample, open: f32) -> Option<[f32; 3]> {
        let (camera, style) = (self.camera, self.style);
        let surface = self.surfaces.get(sample.surface as usize)?;
        let &triangle = surface.triangles.get(sample.triangle as usize)?;
        let share = sample.shares();
        let mix = |data: &[[f32; 3]]| Surface::mix(data, triangle, share);
        let position = Point3::from(mix(surface.positions).unwrap_or_default()).cast::<f64>();
        let normal = Vector3::from(mix(surface.normals).unwrap_or([0.0, 0.0, 1.0])).cast::<f64>();
        let lit = self.shadows.light_at(&(position + normal * style.shadow_offset));
        let mut normal: Vector3<f32> = (camera.view.rotation * normal).cast();
        let view = match camera.projection {
            Projection::Perspective { .. } => -(camera.view * position).coords.cast::<f32>().normalize(),
            Projection::Orthographic { .. } => Vector3::z(),
        };
        let mut colour = mix(surface.tints).unwrap_or([1.0; 3]);
        let place = mix(surface.grain);
        let mark = match (self.marks.get(sample.surface as usize), place) {
            (Some(marks), Some(place)) => marks.at(place),
            _ => Mark::default(),
        };
        let worn = place.map_or(1.0, |p| 0.8 + 0.2 * noise(p, 0.004));
        let skin = 1.0 - mark.nail;
        let of_mark = mark.colour(worn);
        for (v, factor) in colour.iter_mut().zip(of_mark) {
            *v *= factor;
        }
        if let (Some(g), true) = (place, style.grain > 0.0) {
            let coarse = noise(g, 0.007);
            let fine = noise(g, 0.0016);
            let blood = style.grain * 0.07 * coarse;
            let speck = 1.0 + style.grain * 0.07 * fine;
            colour = [colour[0] * speck, colour[1] * (speck - blood), colour[2] * (speck - blood)];
            let bend = |o: f32| noise([g[0] + o, g[1], g[2] - o], 0.0012);
            normal += Vector3::new(bend(0.31), bend(0.57), bend(0.83)) * (0.10 * style.grain * skin);
        }
        let normal = normal.try_normalize(1e-6).unwrap_or_else(Vector3::z);
        let c = skin_light(&normal, &view, &self.light, lit, open, mark.nail);
        let skin = self.skin_of(surface.palm(triangle, share), mark.nail, colour);
        Some(std::array::from_fn(|k| (skin[k] * c.diffuse[k] + c.gloss) * style.exposure))
    }

    /// Linear colour of skin that is of the palm to this share, where surfaces tell one, and of a nail to that one, under
    /// colour factors.
    fn skin_of(&self, palm: Option<f32>, nail: f32, factors: [f32; 3]) -> [f32; 3] {
        let [back, front] = self.skin;
        let Some(palm) = palm else { return std::array::from_fn(|k| back[k] * factors[k]) };
        std::array::from_fn(|k| {
            let base = back[k] + (front[k] - back[k]) * palm * (1.0 - nail);
            base * factors[k] + nail * (0.55 * (NAIL_BED[k] - base)).max(0.0)
        })
    }
}

struct Light {
    diffuse: [f32; 3],
    gloss: f32,
}

/// Light on skin: it scatters, so red reaches round the terminator and into creases.
fn skin_light(
    n: &Vector3<f32>,
    view: &Vector3<f32>,
    light: &Vector3<f32>,
    lit: f32,
    open: f32,
    nail: f32,
) -> Light {
    let facing = n.dot(light);
    let sky = [0.40f32, 0.42, 0.46];
    let ground = [0.24f32, 0.20, 0.18];
    let up = 0.5 + 0.5 * n.y;
    let rim = (1.0 - n.dot(view).clamp(0.0, 1.0)).powi(3);
    let half = (light + view).try_normalize(1e-6).unwrap_or(*view);
    let mirrored = n.dot(&half).max(0.0);
    let gloss = (0.055 * mirrored.powi(14) + 0.16 * nail * mirrored.powi(50)) * lit;
    let wrap = [0.40f32, 0.20, 0.14];
    let bleed = [0.16f32, 0.02, 0.0];
    let diffuse = std::array::from_fn(|k| {
        let key = ((facing + wrap[k]) / (1.0 + wrap[k])).max(0.0);
        let lit = lit + (1.0 - lit) * bleed[k];
        let fill = ground[k] + (sky[k] - ground[k]) * up;
        let open = open + (1.0 - open) * bleed[k] * 1.6;
        0.78 * key * lit + (fill + 0.16 * rim) * open
    });
    Light { diffuse, gloss }
}

/// Reach of the darkening, metres, and the shares of it at which depths are looked at, in so many directions.
const REACH: f32 = 0.016;
const RINGS: [f32; 3] = [0.25, 0.55, 1.0];
const SPOKES: u32 = 8;

/// How open the surroundings of a sample are, from the depths around it.
struct Occlusion {
    /// Of each sample, metres; infinite where nothing is.
    distances: Vec<f32>,
    /// Samples along a row, and rows.
    size: [usize; 2],
    /// Pixels a metre at a distance of one, or, in parallel projection, at any, and samples along a pixel's side.
    scale: f32,
    samples: f32,
    perspective: bool,
    /// Where to look, with the ring.
    directions: Vec<(f32, [f32; 2])>,
}

impl Occlusion {
    fn new(raster: &Raster, camera: &Camera) -> Self {
        let (scale, perspective) = match camera.projection {
            Projection::Perspective { focal } => (focal as f32, true),
            Projection::Orthographic { scale } => (scale as f32, false),
        };
        let distance = |sample: &Sample| match (sample.hit(), perspective) {
            (false, _) => f32::INFINITY,
            (true, true) => -1.0 / sample.depth,
            (true, false) => sample.depth,
        };
        let spokes = |(i, ring): (usize, f32)| {
            (0..SPOKES).map(move |spoke| {
                let angle = (spoke as f32 + 0.37 * i as f32) * std::f32::consts::TAU / SPOKES as f32;
                (ring, [angle.cos(), angle.sin()])
            })
        };
        Self {
            distances: raster.buffer.iter().map(distance).collect(),
            size: [raster.stride(), (raster.size().1 * raster.samples()) as usize],
            scale,
            samples: raster.samples() as f32,
            perspective,
            directions: RINGS.into_iter().enumerate().flat_map(spokes).collect(),
        }
    }

    fn open_at(&self, x: usize, y: usize) -> f32 {
        let [stride, rows] = self.size;
        let here = self.distances[y * stride + x];
        let scale = if self.perspective { self.scale / here } else { self.scale };
        let pixels = scale * self.samples * REACH;
        let mut closed = 0.0;
        for &(ring, [dx, dy]) in &self.directions {
            let (sx, sy) = (x as f32 + ring * pixels * dx, y as f32 + ring * pixels * dy);
            if sx < 0.0 || sy < 0.0 || sx >= stride as f32 || sy >= rows as f32 {
                continue;
            }
            // A neighbour blocks when it stands nearer than a slope of about 45°, not when far in front.
            let rise = (here - self.distances[sy as usize * stride + sx as usize]) / REACH;
            let slope = rise / ring;
            if slope <= 0.55 {
                continue;
            }
            let steep = ((slope - 0.55) / 1.2).clamp(0.0, 1.0);
            let fade = (1.0 - (rise - 1.0).max(0.0) / 2.5).clamp(0.25, 1.0);
            closed += steep * fade;
        }
        let share = closed / (RINGS.len() as u32 * SPOKES) as f32;
        (1.0 - 1.35 * share).clamp(0.25, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_round_trips() {
        for v in 0..=255u8 {
            assert_eq!(srgb_from_linear(linear_from_srgb(v)).round() as u8, v);
        }
    }
}
