//! A flat open hand of capsules on a background, with its true outline: made here, so that everything is known.

use handcast_vision::Mask;
use image::{Rgb, RgbImage};

/// Capsule from `a` to `b` with radii `ra` and `rb`.
#[derive(Clone, Copy)]
pub struct Capsule {
    pub a: (f64, f64),
    pub b: (f64, f64),
    pub ra: f64,
    pub rb: f64,
}

impl Capsule {
    /// Signed distance, negative inside (radii that change slowly).
    fn distance(&self, p: (f64, f64)) -> f64 {
        let d = (self.b.0 - self.a.0, self.b.1 - self.a.1);
        let t = ((p.0 - self.a.0) * d.0 + (p.1 - self.a.1) * d.1) / (d.0 * d.0 + d.1 * d.1);
        let t = t.clamp(0.0, 1.0);
        let q = (self.a.0 + d.0 * t, self.a.1 + d.1 * t);
        (p.0 - q.0).hypot(p.1 - q.1) - (self.ra + (self.rb - self.ra) * t)
    }
}

/// A hand in the picture: fingers thumb to little, palm, forearm.
pub struct FlatHand {
    pub fingers: [Capsule; 5],
    pub others: Vec<Capsule>,
    pub wrist: (f64, f64),
    /// From the wrist to the fingers.
    pub up: (f64, f64),
}

impl FlatHand {
    /// Wrist at `wrist`, fingers turned clockwise by `turn` radians from up, `size` pixels from wrist to the tip
    /// of the middle finger, thumb to the right unless `mirrored`, the middle of the forearm `forearm` long.
    /// Shown fingers are those set in `shown`; the others are folded into the palm.
    pub fn new(
        wrist: (f64, f64),
        turn: f64,
        size: f64,
        mirrored: bool,
        forearm: f64,
        shown: [bool; 5],
    ) -> Self {
        let place = |x: f64, y: f64| {
            let (x, y) = (if mirrored { -x } else { x } * size, -y * size);
            (wrist.0 + x * turn.cos() - y * turn.sin(), wrist.1 + x * turn.sin() + y * turn.cos())
        };
        let capsule = |a: (f64, f64), b: (f64, f64), ra: f64, rb: f64| Capsule {
            a: place(a.0, a.1),
            b: place(b.0, b.1),
            ra: ra * size,
            rb: rb * size,
        };
        // Root, direction from up in degrees, length to the tip's centre and radii of each finger.
        let shape = [
            ((0.13, 0.16), 48.0, 0.32, 0.062, 0.05),
            ((0.155, 0.47), 14.0, 0.38, 0.05, 0.042),
            ((0.052, 0.5), 2.0, 0.44, 0.05, 0.042),
            ((-0.052, 0.48), -10.0, 0.40, 0.047, 0.04),
            ((-0.15, 0.44), -26.0, 0.31, 0.042, 0.036),
        ];
        let mut fingers = [capsule((0.0, 0.0), (0.0, 0.1), 0.1, 0.1); 5];
        for (k, (root, degrees, length, ra, rb)) in shape.into_iter().enumerate() {
            let (angle, length) = (f64::to_radians(degrees), if shown[k] { length } else { 0.04 });
            let tip = (root.0 + angle.sin() * length, root.1 + angle.cos() * length);
            fingers[k] = capsule(root, tip, ra, rb);
        }
        let mut others = vec![
            capsule((0.06, 0.14), (0.11, 0.42), 0.12, 0.1),
            capsule((-0.05, 0.14), (-0.1, 0.4), 0.12, 0.1),
            capsule((0.0, 0.2), (0.0, 0.42), 0.15, 0.13),
        ];
        if forearm > 0.0 {
            others.push(capsule((0.0, 0.1), (0.0, -forearm), 0.13, 0.16));
        }
        let up = place(0.0, 1.0);
        let up = ((up.0 - wrist.0) / size, (up.1 - wrist.1) / size);
        Self { fingers, others, wrist, up }
    }

    /// Signed distance to the outline, negative inside.
    pub fn distance(&self, p: (f64, f64)) -> f64 {
        self.fingers.iter().chain(&self.others).map(|c| c.distance(p)).fold(f64::INFINITY, f64::min)
    }

    /// The true outline of hand and forearm.
    pub fn mask(&self, width: u32, height: u32) -> Mask {
        Mask::from_fn(width, height, |x, y| self.distance((f64::from(x) + 0.5, f64::from(y) + 0.5)) < 0.0)
    }

    /// The hand in `skin` colour, rounded by shading, over what is already in `image`.
    pub fn paint(&self, image: &mut RgbImage, skin: [f64; 3]) {
        for (x, y, pixel) in image.enumerate_pixels_mut() {
            let d = self.distance((f64::from(x) + 0.5, f64::from(y) + 0.5));
            let share = (0.5 - d).clamp(0.0, 1.0);
            let shade = 0.72 + 0.28 * (-d / 8.0).clamp(0.0, 1.0);
            for (c, value) in pixel.0.iter_mut().enumerate() {
                let mixed = f64::from(*value) * (1.0 - share) + skin[c] * shade * share;
                *value = mixed.round() as u8;
            }
        }
    }
}

/// A wall with a smooth change of light and clutter: a yellow ball and dark stripes.
pub fn wall(width: u32, height: u32, colour: [f64; 3], clutter: bool) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let light = 0.85 + 0.15 * f64::from(x) / f64::from(width) - 0.1 * f64::from(y) / f64::from(height);
        let ball = (f64::from(x) - 60.0).hypot(f64::from(y) - f64::from(height) + 40.0) < 25.0;
        let stripes = x + 90 > width && y + 60 > height && (x / 6) % 2 == 0;
        if clutter && ball {
            Rgb([235, 200, 30])
        } else if clutter && stripes {
            Rgb([60, 62, 60])
        } else {
            Rgb(colour.map(|c| (c * light).round().clamp(0.0, 255.0) as u8))
        }
    })
}

/// Adds the same noise at every run, `level` its standard deviation.
pub fn add_noise(image: &mut RgbImage, level: f64) {
    let mut state = 0x1234_5678_9abc_def1u64;
    let mut uniform = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    for value in image.iter_mut() {
        let sum: f64 = (0..6).map(|_| uniform()).sum::<f64>() - 3.0;
        *value = (f64::from(*value) + sum * level * 1.414).round().clamp(0.0, 255.0) as u8;
    }
}
