//! Mean colours of part of a picture, near every pixel of it.

use super::{Mask, OutlineTuning};

/// Longest side of a cell, pixels: the sum of the levels of one of its rows fits 16 bits.
const MAX_CELL: usize = 256;
/// The mean where there is no pixel at all, and its weight, pixels.
const GREY: [f32; 3] = [128.0; 3];
const GREY_WEIGHT: f32 = 1e-3;

/// Mean colour of part of the picture, known everywhere: near the part its own local mean, farther off that
/// of ever larger surroundings.
#[derive(Clone, Debug, Default)]
pub(super) struct LocalColour {
    /// Cells in a pixel, along each axis.
    per_pixel: f32,
    /// From cells of a few pixels to one cell of all.
    levels: Vec<Grid>,
}

/// Cells in row order, each with three sums or means and the number of pixels, or their weight, last.
#[derive(Clone, Debug)]
struct Grid {
    columns: usize,
    rows: usize,
    cells: Vec<[f32; 4]>,
}

impl LocalColour {
    /// Means over the pixels of `part`, of a picture `width` pixels wide.
    pub(super) fn gather(&mut self, part: &Mask, colours: &[[u8; 3]], width: usize, tuning: &OutlineTuning) {
        let side = tuning.cell.clamp(1, MAX_CELL);
        self.per_pixel = 1.0 / side as f32;
        self.levels.clear();
        let mut grid = Grid::sums(part, colours, width, side);
        while grid.columns > 1 || grid.rows > 1 {
            let coarser = grid.halved();
            self.levels.push(std::mem::replace(&mut grid, coarser));
        }
        self.levels.push(grid);
        // From the coarsest level down, sums become means; a cell with few pixels takes most of its mean from the
        // coarser level.
        for level in (0..self.levels.len()).rev() {
            let (finer, coarser) = self.levels.split_at_mut(level + 1);
            if let Some(grid) = finer.last_mut() {
                grid.average(coarser.first(), tuning.coarser_weight);
            }
        }
    }

    /// The mean colour round a pixel.
    pub(super) fn at(&self, x: u32, y: u32) -> [f32; 3] {
        let cell = |v: u32| (v as f32 + 0.5) * self.per_pixel - 0.5;
        self.levels.first().map_or(GREY, |grid| grid.interpolated(cell(x), cell(y)))
    }
}

impl Grid {
    /// Sums over the pixels of `part` in cells of `side` pixels.
    fn sums(part: &Mask, colours: &[[u8; 3]], width: usize, side: usize) -> Self {
        let (columns, rows) = (width.div_ceil(side), (part.height() as usize).div_ceil(side));
        let mut cells = vec![[0f32; 4]; columns * rows];
        for y in 0..part.height() {
            let row = y as usize * width;
            let cell_row = y as usize / side * columns;
            for (start, end) in part.runs(y) {
                let (mut x, end) = (start as usize, end as usize);
                let mut column = x / side;
                while x < end {
                    // Sums of a cell are whole numbers, which f32 holds exactly.
                    let until = end.min((column + 1) * side);
                    let mut sums = [0u16; 3];
                    for colour in &colours[row + x..row + until] {
                        for c in 0..3 {
                            sums[c] += u16::from(colour[c]);
                        }
                    }
                    let cell = &mut cells[cell_row + column];
                    for c in 0..3 {
                        cell[c] += f32::from(sums[c]);
                    }
                    cell[3] += (until - x) as f32;
                    (x, column) = (until, column + 1);
                }
            }
        }
        Self { columns, rows, cells }
    }

    /// Sums over cells of twice the side.
    fn halved(&self) -> Self {
        let (columns, rows) = (self.columns.div_ceil(2), self.rows.div_ceil(2));
        let mut cells = vec![[0f32; 4]; columns * rows];
        for (i, cell) in self.cells.iter().enumerate() {
            let sum = &mut cells[i / self.columns / 2 * columns + i % self.columns / 2];
            for c in 0..4 {
                sum[c] += cell[c];
            }
        }
        Self { columns, rows, cells }
    }

    /// Turns sums into means, in which those of the level above weigh as many pixels as `weight`.
    fn average(&mut self, coarser: Option<&Self>, weight: f32) {
        for (i, cell) in self.cells.iter_mut().enumerate() {
            let (x, y) = (i % self.columns, i / self.columns);
            let (wide, weight) = match coarser {
                Some(grid) => (grid.interpolated(x as f32 * 0.5 - 0.25, y as f32 * 0.5 - 0.25), weight),
                None => (GREY, GREY_WEIGHT),
            };
            let total = cell[3] + weight;
            for c in 0..3 {
                cell[c] = (cell[c] + weight * wide[c]) / total;
            }
        }
    }

    /// The mean at a place, cells whose centres are whole numbers: bilinear.
    fn interpolated(&self, x: f32, y: f32) -> [f32; 3] {
        let (x, y) = (x.clamp(0.0, (self.columns - 1) as f32), y.clamp(0.0, (self.rows - 1) as f32));
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(self.columns - 1), (y0 + 1).min(self.rows - 1));
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let at = |x: usize, y: usize| self.cells[y * self.columns + x];
        let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
        std::array::from_fn(|k| {
            let (top, bottom) = (a[k] + (b[k] - a[k]) * fx, c[k] + (d[k] - c[k]) * fx);
            top + (bottom - top) * fy
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_colours_are_known_near_and_far() {
        // The left quarter is of one colour, the right one of another; what lies between is not part of it.
        let (width, height) = (256usize, 64u32);
        let colour = |x: usize| if x < 128 { [40, 100, 150] } else { [200, 120, 130] };
        let colours: Vec<[u8; 3]> = (0..width * height as usize).map(|i| colour(i % width)).collect();
        let part = Mask::from_fn(width as u32, height, |x, _| !(64..192).contains(&x));
        let mut local = LocalColour::default();
        assert_eq!(local.at(3, 3), GREY);
        local.gather(&part, &colours, width, &OutlineTuning::default());
        for (x, near) in [(8u32, [40.0, 100.0, 150.0]), (250, [200.0, 120.0, 130.0])] {
            let found = local.at(x, 30);
            assert!((0..3).all(|c| (found[c] - near[c]).abs() < 12.0), "{x}: {found:?}");
        }
        let middle = local.at(128, 30)[0];
        assert!((100.0..140.0).contains(&middle), "{middle}");
    }

    #[test]
    fn sums_are_those_of_the_pixels() {
        let (width, height) = (45usize, 31u32);
        let colours: Vec<[u8; 3]> =
            (0..width * height as usize).map(|i| [7, 13, 29].map(|k| (i * k % 251) as u8)).collect();
        let part = Mask::from_fn(width as u32, height, |x, y| (x * 3 + y * 5) % 7 < 4);
        for side in [1, 5, 8, 64] {
            let grid = Grid::sums(&part, &colours, width, side);
            let mut slow = vec![[0f32; 4]; grid.columns * grid.rows];
            for (x, y) in part.pixels().map(|(x, y)| (x as usize, y as usize)) {
                let cell = &mut slow[y / side * grid.columns + x / side];
                let colour = colours[y * width + x].map(f32::from);
                (0..3).for_each(|c| cell[c] += colour[c]);
                cell[3] += 1.0;
            }
            assert_eq!(grid.cells, slow, "{side}");
            let halved = grid.halved();
            let total = |grid: &Grid| grid.cells.iter().map(|c| c[3]).sum::<f32>();
            assert_eq!(total(&halved), part.area() as f32);
        }
    }
}
