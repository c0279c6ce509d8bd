//! The skin as textures: colour, normals, occlusion and roughness, baked from the marks of the bind pose.

use nalgebra::{Point3, Vector3};

use super::marks::{nearness, smooth_step};
use super::{HandMesh, Mark};
use crate::{Finger, Joint, Side, linear_from_srgb, srgb_from_linear};

/// Square textures of a hand, for the texture coordinates of its mesh; rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct SkinMaps {
    /// Pixels a side.
    pub side: usize,
    /// Colour, sRGB.
    pub colour: Vec<[u8; 3]>,
    /// Tangent-space normals, x along the texture's rows, y up its columns, 128 is 0.
    pub normal: Vec<[u8; 3]>,
    /// Occlusion in red (255 is open), roughness in green, metal (none) in blue.
    pub surface: Vec<[u8; 3]>,
}

/// Colours of skin from the lightest to the darkest, sRGB: ten steps of about equal difference to the eye.
const TONES: [[u8; 3]; 10] = [
    [244, 214, 198],
    [236, 198, 176],
    [226, 176, 148],
    [211, 159, 128],
    [190, 137, 105],
    [166, 115, 84],
    [140, 93, 66],
    [113, 73, 52],
    [88, 57, 42],
    [66, 44, 35],
];

/// Skin where no tone is known, sRGB: that of tone 3.
pub const PLAIN_SKIN: [u8; 3] = TONES[2];

/// Skin of a tone of 1 (lightest) to 10 (darkest), sRGB; `None` for other numbers.
pub fn skin_tone(tone: u8) -> Option<[u8; 3]> {
    TONES.get(usize::from(tone).checked_sub(1)?).copied()
}

/// The tone (1 to 10) nearest to a colour of skin (sRGB), by their individual typology angles: atan2(L* − 50, b*) of CIELAB
/// (white D65), which skin types are told by.
pub fn nearest_skin_tone(colour: [u8; 3]) -> u8 {
    let angle = typology_angle(colour);
    let away = |tone: [u8; 3]| (typology_angle(tone) - angle).abs();
    let tones = (1..).zip(TONES);
    tones
        .fold((1, f32::INFINITY), |best, (n, tone)| if away(tone) < best.1 { (n, away(tone)) } else { best })
        .0
}

/// What shines through nails, linear light: those of dark skin are lighter than it.
pub const NAIL_BED: [f32; 3] = [0.60, 0.36, 0.28];

/// The palm of a hand whose back has this colour, both in linear light. Palms hold little pigment: the darker the skin, the
/// more they differ from it.
pub fn palm_of(skin: [f32; 3]) -> [f32; 3] {
    let bright = 0.3 * skin[0] + 0.6 * skin[1] + 0.1 * skin[2];
    let share = (0.42 - 0.75 * bright).clamp(0.10, 0.40);
    let pale = [0.66, 0.37, 0.27];
    std::array::from_fn(|k| skin[k] + share * (pale[k] - skin[k]).max(0.04 * skin[k]))
}

/// The individual typology angle of a colour (sRGB), radians.
fn typology_angle(colour: [u8; 3]) -> f32 {
    let [r, g, b] = colour.map(linear_from_srgb);
    let (y, z) = (0.2126 * r + 0.7152 * g + 0.0722 * b, (0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
    let f = |v: f32| if v > 0.008_856 { v.cbrt() } else { 7.787 * v + 16.0 / 116.0 };
    (116.0 * f(y) - 66.0).atan2(200.0 * (f(y) - f(z)))
}

/// What a place of the skin looks like.
#[derive(Clone, Copy, Default, PartialEq)]
struct Texel {
    colour: [f32; 3],
    /// Above the mesh, metres.
    height: f32,
    open: f32,
    rough: f32,
    /// Metres a pixel along rows and columns; 0 where there is no skin.
    metres: [f32; 2],
}

/// Fine wrinkles on the backs of two joints of every finger: their frames, the finger's radius there, and how deep they are.
struct Wrinkles {
    frame: nalgebra::Isometry3<f32>,
    radius: f32,
    depth: f32,
}

/// A line of the palm or the back of the hand, seen from the front: a vein, a tendon, a fine crease.
struct Stroke {
    points: Vec<[f32; 2]>,
    width: f32,
}

/// The skin of one hand, to be asked place by place.
struct Skin<'a> {
    mesh: &'a HandMesh,
    /// Linear light.
    skin: [f32; 3],
    palm: [f32; 3],
    wrinkles: Vec<Wrinkles>,
    veins: Vec<Stroke>,
    tendons: Vec<Stroke>,
    fine: Vec<Stroke>,
    /// 1, or −1 for a left hand, whose places are looked up in the mirror.
    sense: f32,
}

impl HandMesh {
    /// Bakes textures of `side` pixels for skin of this colour (sRGB), on all cores. Deterministic; both hands of a person
    /// have the same ones.
    pub fn maps(&self, side: usize, skin: [u8; 3]) -> SkinMaps {
        let side = side.clamp(16, 4096);
        let mut texels = vec![Texel::default(); side * side];
        let skin = Skin::new(self, skin);
        // One where there are no threads, as in a browser.
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        skin.paint_all(side, &mut texels, cores);
        let filled = grow(&mut texels, side, side / 128 + 2);
        let normal = normals(&texels, side);
        let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
        let rest = skin.skin;
        let colour = texels.iter().zip(&filled).map(|(t, filled)| {
            let colour = if *filled { t.colour } else { rest };
            colour.map(|v| srgb_from_linear(v).round() as u8)
        });
        let surface = texels.iter().zip(&filled).map(|(t, filled)| match filled {
            true => [byte(t.open), byte(t.rough), 0],
            false => [255, 150, 0],
        });
        SkinMaps { side, colour: colour.collect(), surface: surface.collect(), normal }
    }

    /// For each vertex the unit direction in which rows of the texture run, across its normal, and the sense (±1) of the
    /// third axis, which runs up the texture's columns.
    pub fn tangents(&self) -> Vec<[f32; 4]> {
        let mut sums = vec![[Vector3::<f32>::zeros(); 2]; self.positions.len()];
        for t in &self.triangles {
            let at = t.map(|i| Vector3::from(self.positions[i as usize]));
            let uv = t.map(|i| self.uvs[i as usize]);
            let (e, f) = (at[1] - at[0], at[2] - at[0]);
            let [p, q] = [1, 2].map(|k| [uv[k][0] - uv[0][0], uv[k][1] - uv[0][1]]);
            let area = p[0] * q[1] - q[0] * p[1];
            if area.abs() < 1e-12 {
                continue;
            }
            let size = e.cross(&f).norm();
            let along = ((e * q[1] - f * p[1]) / area).try_normalize(1e-12).unwrap_or_default() * size;
            let up = ((e * q[0] - f * p[0]) / area).try_normalize(1e-12).unwrap_or_default() * size;
            for i in t {
                sums[*i as usize][0] += along;
                sums[*i as usize][1] += up;
            }
        }
        let axes = sums.iter().zip(&self.normals).map(|([along, up], normal)| {
            let n = Vector3::from(*normal);
            let flat = along - n * n.dot(along);
            let other = if n.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
            let t = flat.try_normalize(1e-12).unwrap_or_else(|| n.cross(&other).normalize());
            [t.x, t.y, t.z, if n.cross(&t).dot(up) < 0.0 { -1.0 } else { 1.0 }]
        });
        axes.collect()
    }
}

impl<'a> Skin<'a> {
    fn new(mesh: &'a HandMesh, skin: [u8; 3]) -> Self {
        let light = skin.map(linear_from_srgb);
        let mut wrinkles = Vec::new();
        for finger in Finger::ALL {
            let joints = Joint::of(finger);
            for k in [joints.len() - 3, joints.len() - 2] {
                let (a, b) = (mesh.bind.get(joints[k - 1]), mesh.bind.get(joints[k]));
                let rotation = a.rotation.slerp(&b.rotation, 0.5);
                let frame = nalgebra::Isometry3::from_parts(b.translation, rotation).cast();
                let length =
                    (mesh.bind.position(joints[k]) - mesh.bind.position(joints[k + 1])).norm() as f32;
                // Those of end joints are finer.
                let depth = if k + 2 == joints.len() { 0.45 } else { 0.8 };
                wrinkles.push(Wrinkles { frame, radius: (0.30 * length).clamp(0.004, 0.012), depth });
            }
        }
        let sense = if mesh.side == Side::Left { -1.0 } else { 1.0 };
        let [veins, tendons, fine] = [veins(mesh), tendons(mesh), fine_creases(mesh)];
        Self { mesh, skin: light, palm: palm_of(light), wrinkles, veins, tendons, fine, sense }
    }

    /// Fills a texture of `side` pixels, in bands of rows side by side: more of them than `threads`, since they hold more skin
    /// or less.
    fn paint_all(&self, side: usize, texels: &mut [Texel], threads: usize) {
        let band = side.div_ceil(8 * threads.max(1));
        let paint = |(k, texels): (usize, &mut [Texel])| {
            for triangle in &self.mesh.triangles {
                self.paint(*triangle, side, k * band, texels);
            }
        };
        let bands = texels.chunks_mut(band * side).enumerate();
        if threads < 2 {
            return bands.for_each(paint);
        }
        let bands = std::sync::Mutex::new(bands);
        std::thread::scope(|scope| {
            for _ in 0..threads {
                scope.spawn(|| {
                    while let Some(band) = bands.lock().ok().and_then(|mut bands| bands.next()) {
                        paint(band);
                    }
                });
            }
        });
    }

    /// Fills the pixels of a triangle in a band of rows from `top` on.
    fn paint(&self, triangle: [u32; 3], side: usize, top: usize, texels: &mut [Texel]) {
        let mesh = self.mesh;
        let corner = |k: usize| triangle[k] as usize;
        let scale = side as f32;
        let uv: [[f32; 2]; 3] = std::array::from_fn(|k| mesh.uvs[corner(k)].map(|v| v * scale));
        let at: [Vector3<f32>; 3] = std::array::from_fn(|k| Vector3::from(mesh.positions[corner(k)]));
        let [a, b, c] = uv;
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        if area.abs() < 1e-9 {
            return;
        }
        // Metres along rows and columns, from the gradient of the place.
        let (e, f) = (at[1] - at[0], at[2] - at[0]);
        let along = (e * (c[1] - a[1]) - f * (b[1] - a[1])) / area;
        let down = (f * (b[0] - a[0]) - e * (c[0] - a[0])) / area;
        let metres = [along.norm(), down.norm()];
        let low = |k: usize| a[k].min(b[k]).min(c[k]);
        let high = |k: usize| a[k].max(b[k]).max(c[k]);
        let range = |k: usize, from: usize, to: usize| {
            let last = (high(k) + 0.5).floor().max(0.0) as usize;
            from.max((low(k) - 0.5).ceil().max(0.0) as usize)..last.saturating_add(1).min(to)
        };
        for y in range(1, top, top + texels.len() / side) {
            for x in range(0, 0, side) {
                let p = [x as f32 + 0.5, y as f32 + 0.5];
                let share = |q: [f32; 2], r: [f32; 2]| {
                    ((q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1])) / area
                };
                let shares = [share(b, c), share(c, a), share(a, b)];
                if shares.iter().any(|s| *s < -1e-4) {
                    continue;
                }
                let mix = |v: &dyn Fn(usize) -> f32| (0..3).map(|k| shares[k] * v(corner(k))).sum::<f32>();
                let place: [f32; 3] = std::array::from_fn(|k| mix(&|i| mesh.positions[i][k]));
                let tint: [f32; 3] = std::array::from_fn(|k| mix(&|i| mesh.tints[i][k]));
                let mut texel =
                    self.texel(place, tint, mix(&|i| mesh.palms[i]), mix(&|i| mesh.normals[i][2]));
                texel.metres = metres;
                texels[(y - top) * side + x] = texel;
            }
        }
    }

    /// The skin at a place of the bind pose that is of the palm to a share of `palm` and faces the front by `front`.
    fn texel(&self, place: [f32; 3], tint: [f32; 3], palm: f32, front: f32) -> Texel {
        let mark: Mark = self.mesh.marks.at(place);
        let grain = [place[0] * self.sense, place[1], place[2]];
        let skin = 1.0 - mark.nail;
        let worn = 0.8 + 0.2 * noise(grain, 0.004);
        let inside = palm * skin;
        let wrinkle = self.wrinkle_at(place, grain) * (1.0 - inside);
        let behind = smooth_step(0.1, -0.5, front);
        let vein = strokes_at(&self.veins, place) * behind;
        let tendon = strokes_at(&self.tendons, place) * behind;
        let fine = strokes_at(&self.fine, place) * smooth_step(0.1, 0.5, front) * worn;
        let blotch = noise(grain, 0.009);
        let of_mark = mark.colour(worn);
        let colour = std::array::from_fn(|k| {
            let base = self.skin[k] + (self.palm[k] - self.skin[k]) * inside;
            let blood = [0.0, 0.020, 0.022][k] * blotch;
            let blue = [0.075, 0.035, 0.0][k] * vein;
            let fold = [0.06, 0.09, 0.10][k] * wrinkle + [0.06, 0.10, 0.11][k] * fine;
            // Nails of dark skin are lighter than it.
            let bed = mark.nail * (0.55 * (NAIL_BED[k] - base)).max(0.0);
            (base * tint[k] * of_mark[k] + bed) * (1.0 - blood - blue) * (1.0 - fold)
        });
        let pores = noise(grain, 0.0016) * skin;
        let height = -0.00026 * mark.crease * skin - 0.00007 * wrinkle - 0.00025 * mark.fold * skin
            + 0.00016 * mark.nail
            + 0.00026 * vein
            + 0.00045 * tendon
            - 0.00010 * fine * skin
            + 0.000018 * pores;
        let open = 1.0 - 0.28 * mark.crease * skin - 0.10 * wrinkle - 0.35 * mark.fold * skin;
        let rough =
            (0.60 + 0.05 * inside + 0.03 * pores) * skin + 0.32 * mark.nail + 0.08 * mark.crease * skin;
        Texel { colour, height, open, rough, metres: [0.0; 2] }
    }

    /// Depth of the wrinkles on the back of joints, 0 to 1.
    fn wrinkle_at(&self, place: [f32; 3], grain: [f32; 3]) -> f32 {
        let p = Point3::from(place);
        let mut deepest = 0.0f32;
        for w in &self.wrinkles {
            let off = p - Point3::from(w.frame.translation.vector);
            if off.norm_squared() > 4.0 * w.radius * w.radius {
                continue;
            }
            let q = w.frame.rotation.inverse() * off / w.radius;
            let back = smooth_step(0.25, 0.8, -q.z) * smooth_step(1.5, 0.9, q.x.abs());
            if back <= 0.0 {
                continue;
            }
            let wave = 0.035 * noise(grain, 0.003);
            // The middle ones are the longest.
            for (k, depth, half) in
                [(-0.62, 0.45, 0.7), (-0.30, 0.9, 1.1), (0.0, 0.7, 1.3), (0.32, 1.0, 1.1), (0.64, 0.5, 0.7)]
            {
                let across = (q.y - k * (1.0 - 0.10 * q.x * q.x) - wave) / 0.06;
                let fades = smooth_step(half, 0.4 * half, q.x.abs());
                deepest = deepest.max((-across * across).exp() * back * depth * fades * w.depth);
            }
        }
        deepest
    }
}

/// Widths from its middle up to which a line is painted.
const STROKE_REACH: f32 = 3.0;

/// How much of these lines is at a place, 0 to 1.
fn strokes_at(strokes: &[Stroke], place: [f32; 3]) -> f32 {
    let taper = |share| smooth_step(0.0, 0.2, share) * smooth_step(1.0, 0.75, share);
    let near = |stroke: &Stroke| nearness(&stroke.points, place, stroke.width, STROKE_REACH, taper);
    strokes.iter().map(near).fold(0.0, f32::max)
}

/// Along a line with a bow to its left, a share of its length.
fn bowed(from: [f32; 2], to: [f32; 2], bow: f32, width: f32) -> Stroke {
    let along = [to[0] - from[0], to[1] - from[1]];
    let points = (0..=8).map(|i| {
        let t = i as f32 / 8.0;
        let off = 4.0 * t * (1.0 - t) * bow;
        [from[0] + t * along[0] - off * along[1], from[1] + t * along[1] + off * along[0]]
    });
    Stroke { points: points.collect(), width }
}

/// Of the back of the hand, from the knuckles to the wrist.
fn tendons(mesh: &HandMesh) -> Vec<Stroke> {
    let at = |joint: Joint| mesh.bind.position(joint).cast::<f32>();
    let wrist = at(Joint::Wrist);
    let fingers = Finger::LONG.into_iter().map(|finger| {
        let knuckle = at(Joint::base(finger));
        let end = wrist + (knuckle - wrist) * 0.12;
        bowed([knuckle.x, knuckle.y], [0.6 * end.x, end.y], 0.0, 0.0026)
    });
    fingers.collect()
}

/// Of the palm and the wrist, besides the three long lines.
fn fine_creases(mesh: &HandMesh) -> Vec<Stroke> {
    let at = |joint: Joint| mesh.bind.position(joint).cast::<f32>();
    let [index, middle, ring, little] = Finger::LONG.map(|finger| at(Joint::base(finger)));
    let (wrist, width) = (at(Joint::Wrist), mesh.marks.width * 0.6);
    let across = (index - little).x;
    let place = |x: f32, y: f32| [wrist.x + x * across, wrist.y + y * middle.y];
    let of = |p: nalgebra::Point3<f32>, x: f32, y: f32| [p.x + x * across, p.y + y * middle.y];
    let line = |from, to, bow| bowed(from, to, bow, width);
    vec![
        line(place(-0.42, 0.0), place(0.44, 0.02), 0.03),
        line(place(-0.40, -0.07), place(0.42, -0.06), 0.03),
        line(place(0.02, 0.12), of(middle, -0.02, -0.22), -0.04),
        line(place(-0.30, 0.30), of(little, 0.02, -0.20), 0.05),
        line(of(ring, 0.10, -0.38), of(index, -0.10, -0.24), 0.08),
        line(place(0.28, 0.28), of(index, -0.05, -0.42), -0.06),
        line(of(middle, 0.02, -0.12), of(little, 0.08, -0.10), 0.10),
    ]
}

/// From between the knuckles to the wrist, with a bend each.
fn veins(mesh: &HandMesh) -> Vec<Stroke> {
    let at = |joint: Joint| mesh.bind.position(joint).cast::<f32>();
    let knuckles = Finger::LONG.map(|f| at(Joint::base(f)));
    let wrist = at(Joint::Wrist);
    let length = (knuckles[1] - wrist).norm();
    let across = (knuckles[0] - knuckles[3]) * 0.25;
    let sway = [(0, 0.10, 0.55), (1, -0.13, 0.30), (2, 0.12, -0.10)];
    let mut veins: Vec<Stroke> = sway
        .into_iter()
        .map(|(gap, bend, end)| {
            let from = nalgebra::center(&knuckles[gap], &knuckles[gap + 1]);
            let to = wrist + across * end - Vector3::y() * (0.1 * length);
            let points = (0..=12).map(|i| {
                let t = i as f32 / 12.0;
                let wave = bend * (t * std::f32::consts::PI).sin() + 0.03 * (11.0 * t + gap as f32).sin();
                let p = from + (to - from) * t + across * (2.0 * wave);
                [p.x, p.y]
            });
            Stroke { points: points.collect(), width: 0.018 * length }
        })
        .collect();
    // One joins two of them half way.
    let join = [veins[0].points[8], veins[1].points[5]];
    let middle = [(join[0][0] + join[1][0]) / 2.0, (join[0][1] + join[1][1]) / 2.0 + 0.03 * length];
    veins.push(Stroke { points: vec![join[0], middle, join[1]], width: 0.014 * length });
    veins
}

/// Fills what is near to skin from its neighbours, `steps` pixels far; tells which pixels are filled then.
fn grow(texels: &mut [Texel], side: usize, steps: usize) -> Vec<bool> {
    let mut filled: Vec<bool> = texels.iter().map(|t| t.metres[0] > 0.0).collect();
    let mut border: Vec<usize> = (0..texels.len()).filter(|&i| filled[i]).collect();
    for _ in 0..steps {
        let mut next = Vec::new();
        for &i in &border {
            let (x, y) = (i % side, i / side);
            let around = [
                (x > 0).then(|| i - 1),
                (x + 1 < side).then(|| i + 1),
                (y > 0).then(|| i - side),
                (y + 1 < side).then(|| i + side),
            ];
            for n in around.into_iter().flatten().filter(|&n| !filled[n]) {
                texels[n] = Texel { metres: [0.0; 2], ..texels[i] };
                next.push(n);
            }
            for n in around.into_iter().flatten() {
                filled[n] = true;
            }
        }
        border = next;
    }
    filled
}

/// Normals of the heights, by differences of neighbours.
fn normals(texels: &[Texel], side: usize) -> Vec<[u8; 3]> {
    let mut out = vec![[128, 128, 255]; texels.len()];
    for (i, (pixel, t)) in out.iter_mut().zip(texels).enumerate() {
        let (x, y) = (i % side, i / side);
        if t.metres[0] <= 0.0 || t.metres[1] <= 0.0 || x == 0 || y == 0 || x + 1 == side || y + 1 == side {
            continue;
        }
        let height = |i: usize| texels[i].height;
        // Up the texture's columns is against their numbers.
        let slope = [
            (height(i + 1) - height(i - 1)) / (2.0 * t.metres[0]),
            (height(i - side) - height(i + side)) / (2.0 * t.metres[1]),
        ];
        let n = Vector3::new(-slope[0], -slope[1], 1.0).normalize();
        *pixel = [n.x, n.y, n.z].map(|v| (128.0 + 127.0 * v).round().clamp(0.0, 255.0) as u8);
    }
    out
}

/// Smooth value noise in −1..=1 of a point, lattice `cell` metres.
pub fn noise(p: [f32; 3], cell: f32) -> f32 {
    let q = p.map(|v| (v / cell).clamp(-1e6, 1e6));
    let base = q.map(f32::floor);
    let f: [f32; 3] = std::array::from_fn(|k| {
        let t = q[k] - base[k];
        t * t * (3.0 - 2.0 * t)
    });
    let hash = |x: i32, y: i32, z: i32| {
        let mut h = (x as u32).wrapping_mul(0x8DA6_B343)
            ^ (y as u32).wrapping_mul(0xD816_3841)
            ^ (z as u32).wrapping_mul(0xCB1A_B31F);
        h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
        h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
        ((h ^ (h >> 15)) >> 8) as f32 / 8_388_608.0 - 1.0
    };
    let [x, y, z] = base.map(|v| v as i32);
    let mut sum = 0.0;
    for corner in 0..8 {
        let d = [corner & 1, corner >> 1 & 1, corner >> 2 & 1];
        let share: f32 = (0..3).map(|k| if d[k] == 1 { f[k] } else { 1.0 - f[k] }).product();
        sum += share * hash(x + d[0], y + d[1], z + d[2]);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Morphology;

    #[test]
    fn noise_is_bounded_and_smooth() {
        let mut last = noise([0.0; 3], 0.01);
        for i in 1..2000 {
            let v = noise([i as f32 * 1e-4, 0.0, 0.003], 0.01);
            assert!((-1.0..=1.0).contains(&v));
            if i > 1 {
                assert!((v - last).abs() < 0.05);
            }
            last = v;
        }
    }

    #[test]
    fn tangents_are_unit_lie_in_the_surface_and_turn_over_in_the_mirror() {
        let m = Morphology::default();
        let [right, left] = [Side::Right, Side::Left].map(|side| HandMesh::generate(&m, side));
        let sense = |mesh: &HandMesh| mesh.tangents().iter().map(|t| t[3]).sum::<f32>();
        for (t, n) in right.tangents().iter().zip(&right.normals) {
            let (tangent, n) = (Vector3::new(t[0], t[1], t[2]), Vector3::from(*n));
            assert!((tangent.norm() - 1.0).abs() < 1e-4 && tangent.dot(&n).abs() < 1e-4);
        }
        assert_eq!(sense(&right), -sense(&left));
        assert!(sense(&right).abs() > 0.9 * right.positions.len() as f32);
    }

    #[test]
    fn tones_are_nearest_to_themselves_and_in_order() {
        for tone in 1..=10 {
            let colour = skin_tone(tone).unwrap();
            assert_eq!(nearest_skin_tone(colour), tone);
            // A little more light or less.
            assert!(nearest_skin_tone(colour.map(|v| v.saturating_add(3))).abs_diff(tone) <= 1);
        }
        assert_eq!((nearest_skin_tone([255, 250, 240]), nearest_skin_tone([9, 6, 4])), (1, 10));
        // L* 75, b* 19.
        assert!((typology_angle([226, 176, 148]).to_degrees() - 52.0).abs() < 2.0);
    }

    #[test]
    fn threads_paint_what_one_paints() {
        let mesh = HandMesh::generate(&Morphology::default(), Side::Right);
        let skin = Skin::new(&mesh, [226, 176, 148]);
        for side in [50, 64] {
            let [one, other] = [1, 3].map(|threads| {
                let mut texels = vec![Texel::default(); side * side];
                skin.paint_all(side, &mut texels, threads);
                texels
            });
            assert!(one == other && one.iter().any(|t| t.open > 0.0));
        }
    }

    #[test]
    fn both_hands_have_the_same_maps_and_tones_darken() {
        let m = Morphology::default();
        let maps =
            [Side::Right, Side::Left].map(|side| HandMesh::generate(&m, side).maps(64, [226, 176, 148]));
        let differ = |a: &[[u8; 3]], b: &[[u8; 3]]| {
            a.iter().zip(b).filter(|(a, b)| (0..3).any(|k| a[k].abs_diff(b[k]) > 2)).count()
        };
        assert!(differ(&maps[0].colour, &maps[1].colour) < 30);
        assert!(differ(&maps[0].normal, &maps[1].normal) < 30);
        let bright = |tone: u8| -> u32 {
            let [r, g, b] = skin_tone(tone).unwrap().map(u32::from);
            2 * r + 5 * g + b
        };
        assert!((1..10).all(|tone| bright(tone) > bright(tone + 1)));
        assert_eq!((skin_tone(0), skin_tone(11)), (None, None));
    }
}
