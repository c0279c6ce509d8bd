//! The nearest point of the model's outline.

use super::super::outline::OutlinePoint;
use handcast_vision::ContourPoint;

/// Points looked at in one go.
const LANES: usize = 8;
/// Most blocks of that many points.
const MOST_BLOCKS: usize = 1 << 10;
/// What is added to the squared distance of a point that faces another way.
const FAR: f32 = (1u64 << 40) as f32;

/// [`LANES`] points that follow one another.
#[derive(Clone, Copy, Debug)]
struct Block {
    x: [f32; LANES],
    y: [f32; LANES],
    /// Their normals.
    nx: [f32; LANES],
    ny: [f32; LANES],
}

/// The points of an outline in columns, for a fast search of the nearest.
#[derive(Clone, Debug, Default)]
pub(super) struct Columns {
    blocks: Vec<Block>,
    /// For each block a circle around its points: centre and radius.
    circles: Vec<[f32; 3]>,
}

impl Columns {
    /// Loads the points of an outline; what is more than eight thousand of them is left out.
    pub(super) fn load(&mut self, outline: &[OutlinePoint]) {
        self.blocks.clear();
        self.circles.clear();
        for points in outline.chunks(LANES).take(MOST_BLOCKS) {
            // What is missing in the last block faces no way, so that it is never nearest.
            let mut block = Block { x: [0.0; LANES], y: [0.0; LANES], nx: [0.0; LANES], ny: [0.0; LANES] };
            let mut bounds = [[f32::INFINITY, f32::NEG_INFINITY]; 2];
            for (lane, p) in points.iter().enumerate() {
                let [x, y] = p.position.map(|v| v as f32);
                (block.x[lane], block.y[lane]) = (x, y);
                (block.nx[lane], block.ny[lane]) = (p.normal[0] as f32, p.normal[1] as f32);
                for (b, v) in bounds.iter_mut().zip([x, y]) {
                    *b = [b[0].min(v), b[1].max(v)];
                }
            }
            let [x, y] = bounds.map(|[low, high]| 0.5 * (low + high));
            let half = bounds.map(|[low, high]| 0.5 * (high - low));
            self.blocks.push(block);
            self.circles.push([x, y, (half[0] * half[0] + half[1] * half[1]).sqrt()]);
        }
    }

    /// The index of the nearest point whose normal has a cosine of more than `facing` with that of `q`; distances are
    /// told apart to a part in two thousand. `hint` is a point that is probably near, such as the one found for a neighbour of `q`.
    pub(super) fn nearest(&self, q: &ContourPoint, facing: f32, hint: Option<usize>) -> Option<usize> {
        let [x, y] = q.position;
        let mut least = i32::MAX;
        let mut reach = f32::INFINITY;
        let mut look = |k: usize, reach: &mut f32| {
            if let Some(block) = self.blocks.get(k) {
                let key = block.nearest(q, facing, k);
                if key < least {
                    least = key;
                    *reach = if key < FAR.to_bits() as i32 { place(key).0.sqrt() } else { f32::INFINITY };
                }
            }
        };
        let first = hint.map_or(0, |i| i / LANES);
        look(first, &mut reach);
        for (k, &[cx, cy, radius]) in self.circles.iter().enumerate() {
            let (dx, dy) = (cx - x, cy - y);
            let far = reach + radius;
            if dx * dx + dy * dy < far * far && k != first {
                look(k, &mut reach);
            }
        }
        (least < FAR.to_bits() as i32).then(|| place(least).1)
    }
}

/// Squared distance and index of a key.
fn place(key: i32) -> (f32, usize) {
    // Rounded up, so that nothing nearer is passed over.
    let square = f32::from_bits((key | ((LANES * MOST_BLOCKS) as i32 - 1)) as u32);
    (square, key as usize % (LANES * MOST_BLOCKS))
}

impl Block {
    /// The least key of its points. Bits of positive numbers are in the order of the numbers: the lowest ones of a
    /// squared distance give room to the index, and to compare both is one comparison of integers.
    fn nearest(&self, q: &ContourPoint, facing: f32, block: usize) -> i32 {
        let ([x, y], [nx, ny]) = (q.position, q.normal);
        let squares: [f32; LANES] = std::array::from_fn(|lane| {
            let (dx, dy) = (self.x[lane] - x, self.y[lane] - y);
            let cosine = self.nx[lane] * nx + self.ny[lane] * ny;
            dx * dx + dy * dy + if cosine > facing { 0.0 } else { FAR }
        });
        let rest = !(LANES as i32 * MOST_BLOCKS as i32 - 1);
        let mut least = i32::MAX;
        for (lane, square) in squares.into_iter().enumerate() {
            least = least.min((square.to_bits() as i32 & rest) | (block * LANES + lane) as i32);
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::evidence::Evidence;
    use super::super::super::outline;
    use super::*;
    use crate::{HandModel, ModelState};
    use handcast_hand::{Morphology, Side};
    use handcast_vision::Mask;

    #[test]
    fn the_nearest_point_is_that_of_a_plain_search() {
        let mut model = HandModel::new(&Morphology::default(), Side::Right);
        let (mut image, mut drawn) = (Mask::new(320, 240), Mask::new(320, 240));
        let state = ModelState::facing([160.0, 210.0], 900.0);
        model.draw(&state, [0.0, 0.0], &mut image);
        let mut evidence = Evidence::default();
        assert!(evidence.load(&image, None, None, 1).unwrap());
        let moved = ModelState::facing([163.0, 214.0], 900.0);
        model.draw(&moved, [0.0, 0.0], &mut drawn);
        let (mut spheres, mut outline, mut columns) = (Vec::new(), Vec::new(), Columns::default());
        model.project_moving(&moved, &mut spheres);
        outline::trace(model.shape().hulls(), &spheres, (&drawn, [0.0, 0.0]), 4.0, &mut outline);
        assert!(outline.len() > 100);
        columns.load(&outline);
        let (mut last, facing) = (None, 0.4);
        for q in evidence.points() {
            let [x, y] = q.position.map(f64::from);
            let square = |p: &OutlinePoint| (p.position[0] - x).powi(2) + (p.position[1] - y).powi(2);
            let faces = |p: &&OutlinePoint| {
                p.normal[0] * f64::from(q.normal[0]) + p.normal[1] * f64::from(q.normal[1]) > facing + 1e-6
            };
            let least = outline.iter().filter(faces).map(square).fold(f64::INFINITY, f64::min);
            for hint in [None, last, Some(outline.len() - 1)] {
                let found = columns.nearest(q, facing as f32, hint);
                let found_square = found.map_or(f64::INFINITY, |i| square(&outline[i]));
                assert!(found_square <= 1.001 * least + 1e-3, "{found_square} {least}");
                last = found;
            }
        }
    }
}
