//! A hand's outline as its joints let expect it.

use crate::geometry::{cross, distance, dot, mean, minus, moved, unit};
use crate::mask::{Mask, PixelRect};
use crate::sighting::Sighting;

/// Joints at the ends of the bones of the fingers, and half their breadths there, hand lengths (Greiner 1991 for the
/// breadths of a mean hand).
const BONES: [([usize; 2], [f64; 2]); 15] = [
    ([1, 2], [0.075, 0.062]),
    ([2, 3], [0.062, 0.056]),
    ([3, 4], [0.056, 0.045]),
    ([5, 6], [0.058, 0.050]),
    ([6, 7], [0.050, 0.044]),
    ([7, 8], [0.044, 0.038]),
    ([9, 10], [0.058, 0.050]),
    ([10, 11], [0.050, 0.044]),
    ([11, 12], [0.044, 0.038]),
    ([13, 14], [0.056, 0.047]),
    ([14, 15], [0.047, 0.041]),
    ([15, 16], [0.041, 0.036]),
    ([17, 18], [0.052, 0.042]),
    ([18, 19], [0.042, 0.037]),
    ([19, 20], [0.037, 0.032]),
];
/// The corners of the palm, and how far the flesh reaches beyond them, hand lengths.
const PALM: [usize; 6] = [0, 1, 5, 9, 13, 17];
const PALM_FLESH: f64 = 0.06;
/// The web of the thumb reaches from its MCP to the index finger's.
const WEB: [usize; 3] = [1, 2, 5];
/// How far beyond the tip's joint a finger goes on, hand lengths.
const BEYOND_TIP: f64 = 0.02;
/// Half the breadth of wrist and forearm, hand lengths.
const FOREARM: f64 = 0.17;
/// How far before the wrist's joint the forearm ends, hand lengths.
const BEFORE_WRIST: f64 = 0.1;
/// A distance at which nothing is of the hand, hand lengths.
const FAR: f64 = 1e3;
/// Radius of the palm, hand lengths.
const PALM_RADIUS: f64 = 0.2;
/// Shortest palm in the picture that shows where the forearm is, hand lengths.
const SHORTEST_PALM: f64 = 0.2;
/// Palm, breadth of the knuckles, and middle finger, hand lengths.
const PALM_LENGTH: f64 = 0.5;
const KNUCKLES: f64 = 0.34;
const MIDDLE_FINGER: f64 = 0.48;
/// Side of the squares in which the forearm is covered, pixels.
const BLOCK: u32 = 4;

/// A hand in a picture, pixels, by its joints.
#[derive(Clone, Debug)]
pub(super) struct Figure {
    /// Length of the hand if it were stretched out and faced the camera, pixels.
    pub(super) length: f64,
    /// The wrist.
    pub(super) wrist: [f64; 2],
    /// Unit vector from the wrist to the knuckles, unless the palm is seen from its end.
    pub(super) axis: Option<[f64; 2]>,
    points: [[f64; 2]; 21],
}

impl Figure {
    /// That of a sighting; `None` where its joints are in one place, or nowhere.
    pub(super) fn of(hand: &Sighting) -> Option<Self> {
        let mut points = hand.points;
        let length = length_of(hand);
        if !(length.is_finite() && length > 1.0 && points.iter().flatten().all(|v| v.abs() < 1e6)) {
            return None;
        }
        for tip in [4, 8, 12, 16, 20] {
            if let Some(direction) = unit(minus(points[tip], points[tip - 1])) {
                points[tip] = moved(points[tip], direction, BEYOND_TIP * length);
            }
        }
        let wrist = points[0];
        let ahead = minus(hand.knuckles(), wrist);
        let long = dot(ahead, ahead).sqrt() > SHORTEST_PALM * length;
        Some(Self { length, wrist, axis: unit(ahead).filter(|_| long), points })
    }

    /// The part of a picture around it, with the beginning of the forearm.
    pub(super) fn window(&self, margin: f64, (width, height): (u32, u32)) -> Option<PixelRect> {
        let margin = margin * self.length;
        let range = |k: usize, size: u32| {
            let values = self.points.iter().map(|p| p[k]);
            let (low, high) =
                values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            let clamp = |v: f64| v.clamp(0.0, f64::from(size)) as u32;
            (clamp((low - margin).floor()), clamp((high + margin).ceil()))
        };
        let ((x0, x1), (y0, y1)) = (range(0, width), range(1, height));
        (x1 >= x0 + 8 && y1 >= y0 + 8).then_some(PixelRect { x0, y0, x1, y1 })
    }

    /// Distance of a point from its outline, hand lengths: negative inside.
    pub(super) fn away(&self, at: [f64; 2]) -> f64 {
        let scale = 1.0 / self.length;
        let bones = BONES.iter().map(|([a, b], [ra, rb])| {
            let (d, t) = from_segment(at, self.points[*a], self.points[*b]);
            d.sqrt() * scale - (ra + t * (rb - ra))
        });
        let palm = from_polygon(at, PALM.map(|i| self.points[i])) * scale - PALM_FLESH;
        let web = from_polygon(at, WEB.map(|i| self.points[i])) * scale - 0.5 * PALM_FLESH;
        bones.fold(palm.min(web), f64::min)
    }

    /// Distance of a point from the forearm's outline, hand lengths; [`FAR`] where it is not known where the forearm
    /// is.
    pub(super) fn forearm_away(&self, at: [f64; 2]) -> f64 {
        let Some(axis) = self.axis else { return FAR };
        let from = minus(at, self.wrist);
        let along = dot(from, axis) / self.length;
        let across = cross(from, axis).abs() / self.length;
        (across - FOREARM).max(along - BEFORE_WRIST)
    }

    /// Covers where the forearm may be, `margin` hand lengths wider than it is, to the border of the picture.
    pub(super) fn cover_forearm(&self, margin: f64, out: &mut Mask) {
        if self.axis.is_none() {
            return;
        }
        // Blocks of pixels are covered by what is so at their middle.
        for y in (0..out.height()).step_by(BLOCK as usize) {
            for x in (0..out.width()).step_by(BLOCK as usize) {
                let middle = [x, y].map(|v| f64::from(v) + 0.5 * f64::from(BLOCK));
                if self.forearm_away(middle) < margin {
                    (y..y + BLOCK).for_each(|row| out.fill_span(row, x as i32, (x + BLOCK) as i32));
                }
            }
        }
    }

    pub(super) fn wrist_width(&self) -> f64 {
        2.0 * FOREARM * self.length
    }

    pub(super) fn palm_centre(&self) -> [f64; 2] {
        mean(&PALM.map(|i| self.points[i]))
    }

    pub(super) fn palm_radius(&self) -> f64 {
        PALM_RADIUS * self.length
    }
}

/// Length of the stretched hand, pixels: by the joints in space where they are there, or else by the palm, whose
/// longer side is hardly ever turned away as well.
fn length_of(hand: &Sighting) -> f64 {
    let p = &hand.points;
    if let (Some(world), Some(length)) = (&hand.world, hand.world_length()) {
        let middle = |k: usize| world.iter().map(|w| w[k]).sum::<f64>() / world.len() as f64;
        let (mx, my) = (middle(0), middle(1));
        let centre = mean(p);
        let spread = |values: &mut dyn Iterator<Item = [f64; 2]>| values.map(|v| dot(v, v)).sum::<f64>();
        let seen = spread(&mut p.iter().map(|&q| minus(q, centre)));
        let real = spread(&mut world.iter().map(|w| [w[0] - mx, w[1] - my]));
        return (seen / real.max(1e-9)).sqrt() * length;
    }
    let long = distance(p[0], p[9]) / PALM_LENGTH;
    let broad = distance(p[5], p[17]) / KNUCKLES;
    let middle = distance(p[9], p[10]) + distance(p[10], p[11]) + distance(p[11], p[12]);
    long.max(broad).max(middle / MIDDLE_FINGER)
}

/// Squared distance of a point from a segment, and how far along it is nearest, 0 to 1.
fn from_segment(at: [f64; 2], a: [f64; 2], b: [f64; 2]) -> (f64, f64) {
    let (ab, ap) = (minus(b, a), minus(at, a));
    let t = (dot(ap, ab) / dot(ab, ab).max(1e-12)).clamp(0.0, 1.0);
    let off = minus(ap, [t * ab[0], t * ab[1]]);
    (dot(off, off), t)
}

/// Distance of a point from a polygon: negative inside, by the even-odd rule.
fn from_polygon<const N: usize>(at: [f64; 2], corners: [[f64; 2]; N]) -> f64 {
    let mut least = f64::INFINITY;
    let mut inside = false;
    for k in 0..N {
        let (a, b) = (corners[k], corners[(k + 1) % N]);
        least = least.min(from_segment(at, a, b).0);
        if (a[1] > at[1]) != (b[1] > at[1]) && at[0] < (b[0] - a[0]) * (at[1] - a[1]) / (b[1] - a[1]) + a[0] {
            inside = !inside;
        }
    }
    if inside { -least.sqrt() } else { least.sqrt() }
}
