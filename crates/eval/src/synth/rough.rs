//! Silhouettes with a rough edge, as segmentation leaves them.

use handcast_hand::random::Random;
use handcast_vision::Mask;
use handcast_vision::morphology::{DistanceMap, FAR};

/// Pixels between the nodes of the noise: how long the dents along an edge are.
const CELL: u32 = 5;

/// `mask` with its edge moved in and out by smooth noise of standard deviation `deviation` pixels.
pub(super) fn roughened(mask: Mask, deviation: f64, random: &mut Random) -> Mask {
    if deviation <= 0.0 || mask.is_empty() {
        return mask;
    }
    let (width, height) = (mask.width(), mask.height());
    let columns = width.div_ceil(CELL) + 1;
    let rows = height.div_ceil(CELL) + 1;
    // Interpolation halfway between nodes averages four of them; this evens out the mean variance.
    let level = 1.5 * deviation;
    let nodes: Vec<f64> = (0..columns * rows).map(|_| level * f64::from(random.gauss())).collect();
    let field = |x: u32, y: u32| {
        let at = |i: u32, j: u32| nodes[(j * columns + i) as usize];
        let (i, j) = (x / CELL, y / CELL);
        let share = |v: u32| f64::from(v % CELL) / f64::from(CELL);
        let (s, t) = (share(x), share(y));
        let row = |j: u32| at(i, j) + s * (at(i + 1, j) - at(i, j));
        row(j) + t * (row(j + 1) - row(j))
    };
    let (outside, inside) = (DistanceMap::to_value(&mask, true), DistanceMap::to_value(&mask, false));
    let distance = |map: &DistanceMap, x, y| match map.squared(x, y) {
        FAR => f64::INFINITY,
        squared => f64::from(squared).sqrt() - 0.5,
    };
    Mask::from_fn(width, height, |x, y| {
        let beyond = if mask.get(x, y) { -distance(&inside, x, y) } else { distance(&outside, x, y) };
        beyond < field(x, y)
    })
}
