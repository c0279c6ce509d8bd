//! Which part of the model is in front, where: a coarse depth buffer.

use super::evidence::CELL;
use super::objective::Window;
use super::projection::ProjectedSphere;
use super::raster::{ProjectedDisc, Rasterizer};
use handcast_hand::Primitive;

/// Side of the squares of the image whose middles are looked at, pixels: the cells of the evidence.
pub(super) const COARSE: f64 = CELL as f64;

/// What holds a plane through few centres level: square pixels, and share of the squares of the centres' distances.
const LEVEL_SQUARE: f64 = 1.0;
const LEVEL_SHARE: f64 = 1e-3;

/// No primitive.
const NONE: u8 = u8::MAX;

/// Depth of the foremost surface of the model in the middle of squares of a window, [`COARSE`] pixels wide, or of every
/// second, third … of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Cover {
    depth: Vec<f32>,
    /// The primitive in front, [`NONE`] beside the model.
    front: Vec<u8>,
    width: usize,
    height: usize,
    every: usize,
    rasterizer: Rasterizer,
}

impl Cover {
    /// Draws the model over every `every`th square of `window`, each way, 1 or more; `scale` is pixels per metre.
    pub(super) fn draw(
        &mut self,
        primitives: &[Primitive],
        spheres: &[ProjectedSphere],
        scale: f64,
        window: &Window,
        every: usize,
    ) {
        self.every = every;
        let side = COARSE * every as f64;
        let coarse = |v: u32| ((f64::from(v) / COARSE).ceil() as usize).div_ceil(every);
        let origin = window.origin();
        // Pixel centres are at .5; the first is the middle of the first square, however many are left out after it.
        let place = |v: f64, origin: f64| (v - origin - 0.5 * COARSE) / side + 0.5;
        (self.width, self.height) =
            (coarse(window.silhouette().width()), coarse(window.silhouette().height()));
        self.depth.clear();
        self.depth.resize(self.width * self.height, f32::NEG_INFINITY);
        self.front.clear();
        self.front.resize(self.width * self.height, NONE);
        let Self { depth, front, width, height, rasterizer, .. } = self;
        for (index, primitive) in primitives.iter().enumerate() {
            let of = |&i: &u8| spheres.get(usize::from(i));
            let plane = Plane::through(primitive.spheres.iter().filter_map(of), origin, scale);
            let discs = primitive.spheres.iter().filter_map(of).map(|s| ProjectedDisc {
                x: place(s.disc.x, origin[0]),
                y: place(s.disc.y, origin[1]),
                radius: s.disc.radius / side,
            });
            rasterizer.spans(*height as u32, discs, |y, x0, x1| {
                let (x0, x1) = (x0.clamp(0, *width as i32) as usize, x1.clamp(0, *width as i32) as usize);
                let row = y as usize * *width + x0..y as usize * *width + x1.max(x0);
                let (mut z, step) =
                    plane.along([x0, y as usize].map(|v| v as f64 * side + 0.5 * COARSE), side);
                if let (Some(depths), Some(fronts)) = (depth.get_mut(row.clone()), front.get_mut(row)) {
                    for (cell, id) in depths.iter_mut().zip(fronts) {
                        let here = z.clamp(plane.range[0], plane.range[1]);
                        if here > *cell {
                            (*cell, *id) = (here, index as u8);
                        }
                        z += step;
                    }
                }
            });
        }
    }

    /// The drawn squares that show the model, row by row: the number of the primitive in front, and the square's column
    /// and row in the window.
    pub(super) fn squares(&self) -> impl Iterator<Item = (usize, [usize; 2])> {
        let rows = self.front.chunks(self.width.max(1)).enumerate();
        let cells = rows.flat_map(|(y, ids)| ids.iter().enumerate().map(move |(x, &id)| (id, [x, y])));
        let shown = cells.filter(|&(id, _)| id != NONE);
        shown.map(|(id, cell)| (usize::from(id), cell.map(|v| self.every * v)))
    }
}

/// The depth of a primitive's front as a linear function of the place, within the range of its spheres.
struct Plane {
    at_origin: f64,
    slope: [f64; 2],
    range: [f32; 2],
}

impl Plane {
    /// The plane of least squares through the centres, moved to the front by the mean radius.
    fn through<'a>(
        spheres: impl Iterator<Item = &'a ProjectedSphere> + Clone,
        origin: [f64; 2],
        scale: f64,
    ) -> Self {
        let n = spheres.clone().count().max(1) as f64;
        let mut mean = [0.0; 4];
        for s in spheres.clone() {
            for (m, v) in mean.iter_mut().zip([s.disc.x, s.disc.y, s.depth(), s.disc.radius / scale]) {
                *m += v / n;
            }
        }
        let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for s in spheres {
            let (x, y, z) = (s.disc.x - mean[0], s.disc.y - mean[1], s.depth() - mean[2]);
            xx += x * x;
            xy += x * y;
            yy += y * y;
            xz += x * z;
            yz += y * z;
            let front = s.depth() + mean[3];
            range = [range[0].min(front), range[1].max(front)];
        }
        // Centres in a line leave the slope across it open: a little damping makes it level.
        let damping = LEVEL_SQUARE + LEVEL_SHARE * (xx + yy);
        let (xx, yy) = (xx + damping, yy + damping);
        let determinant = xx * yy - xy * xy;
        let slope = [(xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant];
        let at_origin =
            mean[2] + mean[3] + slope[0] * (origin[0] - mean[0]) + slope[1] * (origin[1] - mean[1]);
        Self { at_origin, slope, range: range.map(|v| v as f32) }
    }

    /// Depth at a place of the window, pixels, and its change `further` along the row.
    fn along(&self, [x, y]: [f64; 2], further: f64) -> (f32, f32) {
        let z = self.at_origin + self.slope[0] * x + self.slope[1] * y;
        (z as f32, (self.slope[0] * further) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HandModel, ModelState};
    use handcast_hand::{FREE_ANGLES, Finger, Joint, Morphology, Side};
    use handcast_vision::{Mask, PixelRect};
    use nalgebra::UnitQuaternion;

    #[test]
    fn a_folded_finger_is_in_front_of_the_palm_and_behind_it_from_the_back() {
        let mut free = [0.0; FREE_ANGLES];
        (free[Finger::Index.free_base()], free[Finger::Index.free_outer()]) = (1.4, 1.5);
        let front = |rotation| {
            let model = HandModel::new(&Morphology::default(), Side::Right);
            let state = ModelState { rotation, free, ..ModelState::facing([160.0, 200.0], 900.0) };
            let mut spheres = Vec::new();
            model.project_moving(&state, &mut spheres);
            let all = PixelRect { x0: 0, y0: 0, x1: 320, y1: 240 };
            let mut cover = Cover::default();
            let primitives = model.shape().primitives();
            cover.draw(primitives, &spheres, state.scale, &Window::new(&Mask::new(320, 240), None, all), 1);
            let tip = model.joints(&state)[Joint::IndexDistal.index()];
            let tip = [tip[0], tip[1]].map(|v| (v / COARSE) as usize);
            let (part, _) = cover.squares().find(|&(_, square)| square == tip).unwrap();
            let spheres = &primitives[part].spheres;
            spheres.iter().all(|&s| {
                let joint = model.shape().spheres()[usize::from(s)].joint;
                Joint::of(Finger::Index).contains(&joint)
            })
        };
        assert!(front(UnitQuaternion::identity()));
        let back = UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), std::f64::consts::PI);
        assert!(!front(back));
    }
}
