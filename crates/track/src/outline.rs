//! The outline of the projected model.

use super::projection::{COLUMNS, ProjectedSphere};
use super::raster::ProjectedDisc;
use handcast_hand::{Finger, MAX_HULL_SPHERES};
use handcast_vision::Mask;

/// A point of the outline of the model's silhouette.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutlinePoint {
    /// Position, pixels.
    pub(super) position: [f64; 2],
    /// Unit vector out of the silhouette.
    pub(super) normal: [f64; 2],
    /// The two spheres between whose outlines it lies, and the share of the second.
    spheres: [u8; 2],
    share: f64,
    /// Length of outline that it stands for, pixels.
    pub(super) length: f64,
}

impl OutlinePoint {
    /// The two spheres that it lies between, each with its share; `None` without one.
    pub(super) fn ends(&self) -> [Option<(usize, f64)>; 2] {
        let end = |k: usize, share: f64| (share > 0.0).then_some((self.spheres[k].into(), share));
        [end(0, 1.0 - self.share), end(1, self.share)]
    }

    /// Derivative of its place along `direction` by each of `columns`, which change x, y and radius of an end of this
    /// `share`.
    pub(super) fn moved<const N: usize>(
        &self,
        columns: &[[f64; 3]; N],
        share: f64,
        direction: [f64; 2],
    ) -> [f64; N] {
        let along = self.normal[0] * direction[0] + self.normal[1] * direction[1];
        columns.map(|c| share * (c[0] * direction[0] + c[1] * direction[1] + c[2] * along))
    }

    /// The fingers that its two ends move with, with the derivative of the point's place along `direction` by
    /// each of their columns, weighted by their shares.
    pub(super) fn gradient(
        &self,
        spheres: &[ProjectedSphere],
        direction: [f64; 2],
    ) -> [(Option<Finger>, [f64; COLUMNS]); 2] {
        self.ends().map(|end| match end.and_then(|(i, share)| Some((spheres.get(i)?, share))) {
            Some((sphere, share)) => (sphere.finger, self.moved(&sphere.columns, share, direction)),
            None => (None, [0.0; COLUMNS]),
        })
    }
}

/// Points on a circle.
const AROUND: usize = 24;
/// How far outside the silhouette must be empty for a point to be on its outline, pixels: farther than the diagonal of
/// the pixel that the outline passes through.
const BEYOND: f64 = 1.6;
/// Rounding of where a tangent touches, pixels.
const ROUNDING: f64 = 1e-6;

/// Collects the outline of the model: the points on the outlines of its `hulls` (indices of spheres) beyond which
/// `drawn`, its silhouette in the window whose corner is at `origin`, is empty. `spacing` is the distance of points
/// along straight outlines, pixels.
pub(super) fn trace<'a>(
    hulls: impl Iterator<Item = &'a [u8]>,
    spheres: &[ProjectedSphere],
    (drawn, origin): (&Mask, [f64; 2]),
    spacing: f64,
    out: &mut Vec<OutlinePoint>,
) {
    out.clear();
    let mut push = |point: OutlinePoint| {
        let beyond = |k: usize| point.position[k] + BEYOND * point.normal[k] - origin[k];
        let (x, y) = (beyond(0), beyond(1));
        let inside = x >= 0.0 && y >= 0.0 && x < drawn.width().into() && y < drawn.height().into();
        if inside && !drawn.get(x as u32, y as u32) {
            out.push(point);
        }
    };
    let circle: [[f64; 2]; AROUND] = std::array::from_fn(|k| {
        let (y, x) = (std::f64::consts::TAU * k as f64 / AROUND as f64).sin_cos();
        [x, y]
    });
    for hull in hulls {
        let mut ends = [(0, ProjectedDisc { x: 0.0, y: 0.0, radius: 0.0 }); MAX_HULL_SPHERES];
        let mut count = 0;
        for (end, &i) in ends.iter_mut().zip(hull) {
            if let Some(s) = spheres.get(usize::from(i)) {
                *end = (i, s.disc);
                count += 1;
            }
        }
        let ends = &ends[..count];
        trace_arcs(ends, &circle, &mut push);
        trace_tangents(ends, spacing, &mut push);
    }
}

/// The points of a hull's arcs, in the directions of `circle`.
fn trace_arcs(
    ends: &[(u8, ProjectedDisc)],
    circle: &[[f64; 2]; AROUND],
    push: &mut impl FnMut(OutlinePoint),
) {
    for &normal in circle {
        let mut farthest = (f64::NEG_INFINITY, None);
        for end in ends {
            let reach = end.1.support(normal);
            if reach > farthest.0 {
                farthest = (reach, Some(end));
            }
        }
        if let Some((i, disc)) = farthest.1 {
            let length = std::f64::consts::TAU * disc.radius / AROUND as f64;
            push(OutlinePoint { position: disc.edge(normal), normal, spheres: [*i, *i], share: 0.0, length });
        }
    }
}

/// The points of a hull's outer tangents, `spacing` pixels apart.
fn trace_tangents(ends: &[(u8, ProjectedDisc)], spacing: f64, push: &mut impl FnMut(OutlinePoint)) {
    for (k, (i, a)) in ends.iter().enumerate() {
        for (j, b) in &ends[k + 1..] {
            for normal in a.tangents(b).into_iter().flatten() {
                let limit = a.support(normal) + ROUNDING;
                if ends.iter().any(|(_, o)| o.support(normal) > limit) {
                    continue;
                }
                let (start, end) = (a.edge(normal), b.edge(normal));
                let length = (end[0] - start[0]).hypot(end[1] - start[1]);
                let pieces = (length / spacing).round().max(1.0);
                for m in 0..pieces as usize {
                    let share = (m as f64 + 0.5) / pieces;
                    let position =
                        [start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])];
                    push(OutlinePoint {
                        position,
                        normal,
                        spheres: [*i, *j],
                        share,
                        length: length / pieces,
                    });
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HandModel, ModelState};
    use handcast_hand::{FREE_ANGLES, Morphology, Side};

    #[test]
    fn points_lie_on_the_border_of_the_silhouette_and_go_all_around_it() {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let mut free = [0.1; FREE_ANGLES];
        free[Finger::Index.free_outer()] = 1.2;
        let state = ModelState { free, ..ModelState::facing([150.0, 210.0], 900.0) };
        let mut drawn = Mask::new(320, 240);
        model.draw(&state, [0.0, 0.0], &mut drawn);
        let (mut spheres, mut outline) = (Vec::new(), Vec::new());
        model.project_moving(&state, &mut spheres);
        trace(model.shape().hulls(), &spheres, (&drawn, [0.0, 0.0]), 4.0, &mut outline);
        for p in &outline {
            let at = |by: f64| {
                let [x, y] = [0, 1].map(|k| p.position[k] + by * p.normal[k]);
                drawn.get(x as u32, y as u32)
            };
            assert!(at(-1.5) && !at(1.6), "{p:?}");
        }
        let mut contour = handcast_vision::Contour::default();
        contour.trace(&drawn);
        let missed = contour.points().iter().filter(|c| {
            outline.iter().all(|p| {
                (p.position[0] - f64::from(c.position[0])).hypot(p.position[1] - f64::from(c.position[1]))
                    > 6.0
            })
        });
        assert!(missed.count() < contour.points().len() / 50);
    }
}
