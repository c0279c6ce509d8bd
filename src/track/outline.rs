//! The outlines of the projected model: its silhouette, and the edges of fingers seen in front of the hand.

use super::cover::Cover;
use super::projection::{COLUMNS, ProjectedSphere};
use crate::hand::{Finger, Primitive};
use crate::vision::Mask;

/// A point of the outline of a primitive, seen in the image.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutlinePoint {
    /// Position, pixels.
    pub(super) position: [f64; 2],
    /// Unit vector out of the primitive.
    pub(super) normal: [f64; 2],
    /// The two spheres between whose outlines it lies, and the share of the second.
    spheres: [u8; 2],
    share: f64,
    /// Length of outline that it stands for, pixels.
    pub(super) length: f64,
    /// Whether it lies inside the silhouette of the model, in front of other parts.
    pub(super) inner: bool,
}

impl OutlinePoint {
    /// The fingers that its two ends move with, with the change of the point's place along `direction` for
    /// each of their columns, already weighted by their shares.
    pub(super) fn slopes(
        &self,
        spheres: &[ProjectedSphere],
        direction: [f64; 2],
    ) -> [(Option<Finger>, [f64; COLUMNS]); 2] {
        let along = self.normal[0] * direction[0] + self.normal[1] * direction[1];
        let of = |k: usize, share: f64| {
            let mut slopes = [0.0; COLUMNS];
            let sphere = spheres.get(usize::from(self.spheres[k])).filter(|_| share > 0.0);
            if let Some(s) = sphere {
                for (to, c) in slopes.iter_mut().zip(&s.columns) {
                    *to = share * (c[0] * direction[0] + c[1] * direction[1] + c[2] * along);
                }
            }
            (sphere.and_then(|s| s.finger), slopes)
        };
        [of(0, 1.0 - self.share), of(1, self.share)]
    }
}

/// Points on a circle.
const AROUND: usize = 24;
/// How far beyond an outline it is looked what lies there, pixels.
const BEYOND: f64 = 1.6;

/// Collects the visible outline of the model.
///
/// `drawn` is the silhouette of the model in the window whose corner is at `origin`; `spacing` is the
/// distance of points along straight outlines, pixels; `step` the least difference of depth, metres, that
/// makes an inner edge; `scale` is pixels per metre.
pub(super) fn trace(
    primitives: &[Primitive],
    spheres: &[ProjectedSphere],
    (drawn, origin): (&Mask, [f64; 2]),
    cover: &Cover,
    (spacing, step, scale): (f64, f64, f64),
    out: &mut Vec<OutlinePoint>,
) {
    out.clear();
    let circle: [[f64; 2]; AROUND] = std::array::from_fn(|k| {
        let (s, c) = (std::f64::consts::TAU * k as f64 / AROUND as f64).sin_cos();
        [c, s]
    });
    let mut push = |position: [f64; 2], normal: [f64; 2], ends: [u8; 2], share: f64, length: f64| {
        let mix = |of: &dyn Fn(&ProjectedSphere) -> f64| {
            let at = |k: usize| spheres.get(usize::from(ends[k])).map_or(0.0, of);
            (1.0 - share) * at(0) + share * at(1)
        };
        let beyond = |by: f64| [position[0] + by * normal[0], position[1] + by * normal[1]];
        let [x, y] = beyond(BEYOND);
        let (column, row) = ((x - origin[0]).floor(), (y - origin[1]).floor());
        if !(column >= 0.0 && row >= 0.0) || column >= drawn.width().into() || row >= drawn.height().into() {
            return;
        }
        let inner = drawn.get(column as u32, row as u32);
        if inner {
            // In front of what lies beyond by a step, and not itself hidden.
            let behind = cover.depth(beyond(2.0 * BEYOND));
            let here = cover.depth(beyond(-2.0 * BEYOND));
            let depth = mix(&|s| s.depth);
            let front = depth + mix(&|s| s.disc.radius) / scale;
            if behind > depth - step || here > front + step {
                return;
            }
        }
        out.push(OutlinePoint { position, normal, spheres: ends, share, length, inner });
    };
    for primitive in primitives {
        let of = |i: u8| spheres.get(usize::from(i));
        let support = |n: [f64; 2], s: &ProjectedSphere| s.disc.x * n[0] + s.disc.y * n[1] + s.disc.radius;
        for n in circle {
            let best = primitive
                .spheres
                .iter()
                .filter_map(|&i| Some((i, of(i)?)))
                .max_by(|a, b| support(n, a.1).total_cmp(&support(n, b.1)));
            if let Some((i, s)) = best {
                let r = s.disc.radius;
                let length = std::f64::consts::TAU * r / AROUND as f64;
                push([s.disc.x + r * n[0], s.disc.y + r * n[1]], n, [i, i], 0.0, length);
            }
        }
        for (k, &i) in primitive.spheres.iter().enumerate() {
            for &j in &primitive.spheres[k + 1..] {
                let (Some(a), Some(b)) = (of(i), of(j)) else { continue };
                for normal in tangents(a, b).into_iter().flatten() {
                    let edge = support(normal, a) + 1e-6;
                    let outermost =
                        primitive.spheres.iter().filter_map(|&o| of(o)).all(|o| support(normal, o) <= edge);
                    if !outermost {
                        continue;
                    }
                    let start = [a.disc.x + a.disc.radius * normal[0], a.disc.y + a.disc.radius * normal[1]];
                    let end = [b.disc.x + b.disc.radius * normal[0], b.disc.y + b.disc.radius * normal[1]];
                    let length = (end[0] - start[0]).hypot(end[1] - start[1]);
                    let n = (length / spacing).round().max(1.0);
                    for m in 0..n as usize {
                        let t = (m as f64 + 0.5) / n;
                        let at = [start[0] + t * (end[0] - start[0]), start[1] + t * (end[1] - start[1])];
                        push(at, normal, [i, j], t, length / n);
                    }
                }
            }
        }
    }
}

/// Outward normals of the two outer tangents of a pair of discs; none when one holds the other.
fn tangents(a: &ProjectedSphere, b: &ProjectedSphere) -> [Option<[f64; 2]>; 2] {
    let (dx, dy) = (b.disc.x - a.disc.x, b.disc.y - a.disc.y);
    let square = dx * dx + dy * dy;
    let narrowing = a.disc.radius - b.disc.radius;
    if square <= narrowing * narrowing {
        return [None; 2];
    }
    let along = narrowing / square;
    let across = (square - narrowing * narrowing).sqrt() / square;
    [-across, across].map(|c| Some([along * dx - c * dy, along * dy + c * dx]))
}
