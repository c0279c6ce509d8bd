//! Background, forearm, camera and sensor.

use image::RgbImage;
use nalgebra::{Isometry3, Point3, Vector3};

use super::{Background, Synth, SynthOptions};
use handcast_hand::linear_from_srgb;
use handcast_hand::random::Random;
use handcast_hand::{HandPose, SkinnedSurface};
use handcast_render::{Raster, Style, Surface, hand_surface, shade};
use handcast_vision::Mask;

/// Layer of the hand in the raster.
const HAND: u8 = 1;
/// Layer of the forearm.
const ARM: u8 = 2;
/// How far behind the wrist the hand ends, in half palm thicknesses: where the primitive shape of the palm does.
pub(super) const WRIST: f64 = 0.4;

/// One frame with all that is true of it.
#[derive(Clone, Debug)]
pub struct SynthFrame {
    /// Seconds from the start.
    pub time: f64,
    /// The true pose.
    pub pose: HandPose,
    /// The picture.
    pub image: RgbImage,
    /// Where the hand is seen, from the wrist on.
    pub hand: Mask,
    /// Where skin is seen: hand, wrist and forearm.
    pub skin: Mask,
}

pub(super) fn render(synth: &Synth, frame: usize) -> SynthFrame {
    let mut out = before(synth, frame, &synth.background);
    out.image = photographed(&synth.options, out.image, frame);
    out
}

/// Two hands in one picture, the second in front; each frame has the whole picture.
pub(super) fn render_pair(first: &Synth, second: &Synth, frame: usize) -> [SynthFrame; 2] {
    let mut far = before(first, frame, &first.background);
    let behind: Vec<[f32; 3]> = far.image.pixels().map(|p| p.0.map(linear_from_srgb)).collect();
    let mut near = before(second, frame, &behind);
    near.image = photographed(&first.options, near.image, frame);
    far.image.clone_from(&near.image);
    far.hand.subtract(&near.skin);
    far.skin.subtract(&near.skin);
    [far, near]
}

/// Hand and forearm in front of `behind` (linear light), as sharp as they are drawn.
fn before(synth: &Synth, frame: usize, behind: &[[f32; 3]]) -> SynthFrame {
    let o = &synth.options;
    let style = Style {
        skin: o.skin,
        grain: 0.6,
        samples: 2,
        light: o.light.into(),
        exposure: o.exposure,
        every_sample: true,
        shadow_offset: 0.0,
        ..Style::default()
    };
    drawn(synth, frame, |pose, raster, surfaces| {
        let image = shade(raster, surfaces, &synth.camera, &style).over(behind);
        let (hand, arm) = (raster.coverage(HAND), raster.coverage(ARM));
        let skin: Vec<u8> = hand.into_iter().zip(arm).map(|(a, b)| a.saturating_add(b)).collect();
        let (hand, skin) = (hand_mask(synth, raster, surfaces), mask(o.size, &skin));
        SynthFrame { time: synth.time(frame), pose, image, hand, skin }
    })
}

/// What lens, sensor and compression make of a picture.
fn photographed(o: &SynthOptions, mut image: RgbImage, frame: usize) -> RgbImage {
    soften(&mut image);
    add_noise(&mut image, o.noise, &mut Random::new(o.seed, 1000 + frame as u64));
    match o.compression {
        Some(quality) => compressed(image, quality),
        None => image,
    }
}

/// Where the hand is seen, without a picture of it.
pub(super) fn silhouette(synth: &Synth, frame: usize) -> Mask {
    drawn(synth, frame, |_, raster, surfaces| hand_mask(synth, raster, surfaces))
}

/// Draws hand and forearm of a frame, and makes something of it.
fn drawn<T>(synth: &Synth, frame: usize, make: impl FnOnce(HandPose, &Raster, &[Surface]) -> T) -> T {
    let o = &synth.options;
    let pose = synth.pose(frame);
    let mut skinned = SkinnedSurface::default();
    synth.mesh.skin(&synth.skeleton.frames(&pose), &mut skinned);
    let arm = o.forearm.then(|| Tube::forearm(o, &pose));
    let mut surfaces = vec![Surface { layer: HAND, ..hand_surface(&synth.mesh, &skinned) }];
    surfaces.extend(arm.as_ref().map(Tube::surface));
    let mut raster = Raster::new(o.size.0, o.size.1, 2);
    for s in &surfaces {
        raster.draw(s, &synth.camera);
    }
    make(pose, &raster, &surfaces)
}

/// Pixels at least half covered.
fn mask((width, height): (u32, u32), coverage: &[u8]) -> Mask {
    Mask::from_fn(width, height, |x, y| coverage.get((y * width + x) as usize).is_some_and(|&v| v >= 128))
}

fn hand_mask(synth: &Synth, raster: &Raster, surfaces: &[Surface]) -> Mask {
    let wrist = (-WRIST * synth.options.morphology.palm_radius) as f32;
    mask(synth.options.size, &raster.coverage_where(HAND, surfaces, |place| place[1] >= wrist))
}

/// A picture after JPEG compression; as it was should that fail.
fn compressed(image: RgbImage, quality: u8) -> RgbImage {
    let mut bytes = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality);
    let back = image.write_with_encoder(encoder).and_then(|()| {
        image::load_from_memory_with_format(&bytes, image::ImageFormat::Jpeg).map(|i| i.to_rgb8())
    });
    back.unwrap_or(image)
}

/// A bent tube with an oval section.
struct Tube {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    grain: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl Tube {
    /// The forearm from inside the wrist towards an elbow that follows the hand's rotation only in part.
    fn forearm(o: &SynthOptions, pose: &HandPose) -> Self {
        const RINGS: usize = 40;
        const AROUND: usize = 32;
        let m = &o.morphology;
        let place: Isometry3<f64> = pose.isometry();
        let wrist = place * Point3::new(0.0, -0.01 * m.hand_length, 0.0);
        let back = place.rotation * -Vector3::y();
        let elbow =
            Point3::new(pose.translation.x, pose.translation.y - 1.6 * m.hand_length, pose.translation.z);
        let rest = (elbow - wrist).try_normalize(1e-9).unwrap_or(back);
        let along = (back * 0.7 + rest * 0.3).try_normalize(1e-9).unwrap_or(back);
        let across = place.rotation * Vector3::x();
        let across = (across - along * across.dot(&along)).try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let through = across.cross(&along);
        let mut tube =
            Self { positions: Vec::new(), normals: Vec::new(), grain: Vec::new(), triangles: Vec::new() };
        let length = 2.6 * m.hand_length;
        let radius = |s: f64| {
            // From just under the skin of the wrist to the thick of the forearm.
            let grow = (s / (0.9 * length)).min(1.0);
            let emerge = 0.86 + 0.16 * (s / (0.2 * m.hand_length)).min(1.0);
            let swell = emerge + 0.45 * grow * grow * (3.0 - 2.0 * grow);
            [m.wrist_half_width * 0.98 * swell, m.palm_radius * 1.40 * (swell + 0.35 * grow)]
        };
        for ring in 0..=RINGS {
            let s = length * ring as f64 / RINGS as f64;
            // The bend of the wrist is spread over its first part.
            let ease = (s / (0.5 * m.hand_length)).min(1.0);
            let direction = (back * (1.0 - ease) + along * ease).try_normalize(1e-9).unwrap_or(along);
            let centre = wrist + direction * s;
            let [a, b] = radius(s);
            for k in 0..AROUND {
                let angle = k as f64 / AROUND as f64 * std::f64::consts::TAU;
                let (sin, cos) = angle.sin_cos();
                let p = centre + across * (a * cos) + through * (b * sin);
                let n = (across * (cos / a) + through * (sin / b)).try_normalize(1e-9);
                tube.positions.push(p.coords.cast::<f32>().into());
                tube.normals.push(n.unwrap_or(across).cast::<f32>().into());
                let g = Vector3::new(a * cos, -s, b * sin);
                tube.grain.push(g.cast::<f32>().into());
            }
        }
        for ring in 0..RINGS {
            for k in 0..AROUND {
                let at = |r: usize, k: usize| (r * AROUND + k % AROUND) as u32;
                let (p, q, r, s) = (at(ring, k), at(ring + 1, k), at(ring + 1, k + 1), at(ring, k + 1));
                tube.triangles.extend([[p, r, s], [p, q, r]]);
            }
        }
        tube
    }

    fn surface(&self) -> Surface<'_> {
        Surface {
            positions: &self.positions,
            normals: &self.normals,
            triangles: &self.triangles,
            tints: &[],
            palms: &[],
            grain: &self.grain,
            layer: ARM,
        }
    }
}

/// A soft-edged thing in the background: an ellipse or a box.
struct Thing {
    centre: [f32; 2],
    half: [f32; 2],
    turn: f32,
    boxed: bool,
    colour: [f32; 3],
}

impl Thing {
    /// Share of the pixel it covers.
    fn cover(&self, x: f32, y: f32) -> f32 {
        let (s, c) = self.turn.sin_cos();
        let (dx, dy) = (x - self.centre[0], y - self.centre[1]);
        let (u, v) = ((dx * c + dy * s) / self.half[0], (dy * c - dx * s) / self.half[1]);
        let r = if self.boxed { u.abs().max(v.abs()) } else { u.hypot(v) };
        // Half a dozen pixels of blur: the background is out of focus.
        ((1.0 - r) * self.half[0].min(self.half[1]) / 6.0 + 0.5).clamp(0.0, 1.0)
    }
}

/// Colours of things that nobody takes for skin, sRGB.
const THING_COLOURS: [[u8; 3]; 8] = [
    [40, 92, 150],
    [52, 120, 70],
    [92, 60, 132],
    [30, 120, 128],
    [70, 76, 84],
    [150, 160, 60],
    [28, 40, 66],
    [200, 206, 212],
];

/// Cream, wood, brick and cardboard, sRGB.
const SKIN_LIKE_COLOURS: [[u8; 3]; 4] = [[228, 206, 176], [150, 104, 66], [164, 84, 60], [190, 152, 108]];

/// The picture behind the hand, linear light, row by row.
pub(super) fn background(o: &SynthOptions) -> Vec<[f32; 3]> {
    let (width, height) = (o.size.0 as f32, o.size.1 as f32);
    let mut random = Random::new(o.seed, 1);
    let base: [u8; 3] =
        [[168, 178, 190], [150, 168, 160], [186, 188, 194], [120, 134, 156]][random.bits() as usize % 4];
    let corner = base.map(|v| (f32::from(v) * random.range(0.62, 0.8)) as u8);
    let (base, corner) = (base.map(linear_from_srgb), corner.map(linear_from_srgb));
    let lean = random.range(-0.6, 0.6);
    let cluttered = matches!(o.background, Background::Clutter | Background::SkinLike);
    let things: Vec<Thing> = (0..if cluttered { 9 } else { 0 })
        .map(|i| {
            let skin_like = o.background == Background::SkinLike && i % 2 == 0;
            let list: &[[u8; 3]] = if skin_like { &SKIN_LIKE_COLOURS } else { &THING_COLOURS };
            let colour = list[random.bits() as usize % list.len()];
            let light = random.range(0.75, 1.1);
            let size = height * 0.16;
            Thing {
                centre: [random.range(0.0, width), random.range(0.0, height)],
                half: [random.range(0.4, 1.6) * size, random.range(0.4, 1.6) * size],
                turn: random.range(-0.6, 0.6),
                boxed: random.bits().is_multiple_of(2),
                colour: colour.map(|v| linear_from_srgb(v) * light),
            }
        })
        .collect();
    let plain = o.background == Background::Plain;
    let mut out = Vec::with_capacity((o.size.0 * o.size.1) as usize);
    for y in 0..o.size.1 {
        for x in 0..o.size.0 {
            let (fx, fy) = (x as f32 + 0.5, y as f32 + 0.5);
            let t = if plain { 0.0 } else { (fy / height + lean * (fx / width - 0.5)).clamp(0.0, 1.0) };
            let mut c: [f32; 3] = std::array::from_fn(|k| base[k] + (corner[k] - base[k]) * t);
            for thing in &things {
                let share = thing.cover(fx, fy);
                let shade = 0.8 + 0.35 * (1.0 - fy / height);
                for (v, colour) in c.iter_mut().zip(thing.colour) {
                    *v += (colour * shade - *v) * share;
                }
            }
            out.push(c);
        }
    }
    out
}

/// A lens is never quite sharp: one pass of a 3 × 3 kernel with weights 1 6 1 each way.
fn soften(image: &mut RgbImage) {
    let (width, height) = image.dimensions();
    let source = image.clone();
    let mut rows: Vec<[f32; 3]> = Vec::with_capacity((width * height) as usize);
    let mix = |a: [f32; 3], b: [f32; 3], c: [f32; 3]| -> [f32; 3] {
        std::array::from_fn(|k| (a[k] + 6.0 * b[k] + c[k]) / 8.0)
    };
    for y in 0..height {
        for x in 0..width {
            let at = |x: u32| source.get_pixel(x.min(width - 1), y).0.map(f32::from);
            rows.push(mix(at(x.saturating_sub(1)), at(x), at(x + 1)));
        }
    }
    for y in 0..height {
        for x in 0..width {
            let at = |y: u32| rows[(y.min(height - 1) * width + x) as usize];
            let v = mix(at(y.saturating_sub(1)), at(y), at(y + 1));
            image.put_pixel(x, y, image::Rgb(v.map(|v| v.round() as u8)));
        }
    }
}

/// Noise that all channels share in part, as after a camera's colour conversion.
fn add_noise(image: &mut RgbImage, deviation: f32, random: &mut Random) {
    if deviation <= 0.0 {
        return;
    }
    for pixel in image.pixels_mut() {
        let common = random.gauss() * 0.8;
        for v in &mut pixel.0 {
            let n = (common + random.gauss() * 0.6) * deviation;
            *v = (f32::from(*v) + n).round().clamp(0.0, 255.0) as u8;
        }
    }
}
