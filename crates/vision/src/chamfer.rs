//! Distances along chamfer paths (Borgefors, "Distance transformations in digital images", CVGIP 34, 1986).

use super::mask::Mask;
use super::morphology::erode_cross;

/// The set pixels with a neighbour among the four beside them that is not set; what lies outside the
/// image does not count.
pub fn outline(mask: &Mask) -> Mask {
    let mut out = mask.clone();
    out.subtract(&erode_cross(mask));
    out
}

/// The lengths of the steps a path may take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Chamfer {
    /// Steps to the eight neighbours, 3 and 4 to a unit of 3: at most 8 % off the Euclidean distance.
    #[default]
    ThreeFour,
    /// Knight's moves too, 5, 7 and 11 to a unit of 5: at most 2 % off.
    FiveSevenEleven,
}

impl Chamfer {
    /// What one pixel counts.
    fn unit(self) -> u32 {
        match self {
            Chamfer::ThreeFour => 3,
            Chamfer::FiveSevenEleven => 5,
        }
    }

    /// Steps to pixels that come before in row order, (dx, dy, length); those after are their mirror images.
    fn steps(self) -> &'static [(i32, i32, u32)] {
        match self {
            Chamfer::ThreeFour => &[(-1, 0, 3), (-1, -1, 4), (0, -1, 3), (1, -1, 4)],
            Chamfer::FiveSevenEleven => &[
                (-1, 0, 5),
                (-1, -1, 7),
                (0, -1, 5),
                (1, -1, 7),
                (-2, -1, 11),
                (2, -1, 11),
                (-1, -2, 11),
                (1, -2, 11),
            ],
        }
    }
}

/// The chamfer distance of every pixel to a set. Keeps its buffer between maps.
#[derive(Clone, Debug, Default)]
pub struct ChamferMap {
    chamfer: Chamfer,
    width: u32,
    height: u32,
    values: Vec<u32>,
}

impl ChamferMap {
    /// A map without pixels.
    pub fn new(chamfer: Chamfer) -> Self {
        Self { chamfer, ..Self::default() }
    }

    /// Measures the distance of every pixel to the set pixels of `set`: one pass down, one back up. Where
    /// nothing is set every distance is larger than the image.
    pub fn measure(&mut self, set: &Mask) {
        (self.width, self.height) = (set.width(), set.height());
        let (width, height) = (self.width as i32, self.height as i32);
        let far = self.chamfer.unit() * 2 * (self.width + self.height);
        self.values.clear();
        self.values.resize(width as usize * height as usize, far);
        for (x, y) in set.pixels() {
            self.values[(y * self.width + x) as usize] = 0;
        }
        let at = |x: i32, y: i32| (y * width + x) as usize;
        for sign in [1, -1] {
            for row in 0..height {
                let y = if sign == 1 { row } else { height - 1 - row };
                for column in 0..width {
                    let x = if sign == 1 { column } else { width - 1 - column };
                    let mut least = self.values[at(x, y)];
                    for &(dx, dy, length) in self.chamfer.steps() {
                        let (u, v) = (x + sign * dx, y + sign * dy);
                        if (0..width).contains(&u) && (0..height).contains(&v) {
                            least = least.min(self.values[at(u, v)] + length);
                        }
                    }
                    self.values[at(x, y)] = least;
                }
            }
        }
    }

    /// Distance at a pixel, pixels; infinite outside the map.
    pub fn distance(&self, x: u32, y: u32) -> f64 {
        self.units(x, y).map_or(f64::INFINITY, |v| f64::from(v) / self.per_pixel())
    }

    /// Distance at a pixel in the chamfer's units.
    pub fn units(&self, x: u32, y: u32) -> Option<u32> {
        let inside = x < self.width && y < self.height;
        inside.then(|| self.values.get((y * self.width + x) as usize).copied()).flatten()
    }

    /// A row in the chamfer's units; empty outside the map.
    pub fn row(&self, y: u32) -> &[u32] {
        let start = y as usize * self.width as usize;
        self.values.get(start..start + self.width as usize).unwrap_or(&[])
    }

    /// Units in a pixel.
    pub fn per_pixel(&self) -> f64 {
        f64::from(self.chamfer.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::morphology::DistanceMap;
    use proptest::prelude::*;

    /// The shortest path in closed form: as many long steps as fit, then straight on.
    fn path(chamfer: Chamfer, dx: u32, dy: u32) -> u32 {
        let (long, short) = (dx.max(dy), dx.min(dy));
        match chamfer {
            Chamfer::ThreeFour => 4 * short + 3 * (long - short),
            Chamfer::FiveSevenEleven if long >= 2 * short => 11 * short + 5 * (long - 2 * short),
            Chamfer::FiveSevenEleven => 7 * (2 * short - long) + 11 * (long - short),
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn two_passes_find_the_shortest_paths(points in prop::collection::vec((0u32..45, 0u32..30), 1..12)) {
            let mut set = Mask::new(45, 30);
            for &(x, y) in &points {
                set.set(x, y, true);
            }
            let exact = DistanceMap::to_value(&set, true);
            for (chamfer, off) in [(Chamfer::ThreeFour, 0.081), (Chamfer::FiveSevenEleven, 0.021)] {
                let mut map = ChamferMap::new(chamfer);
                map.measure(&set);
                for y in 0u32..30 {
                    for x in 0u32..45 {
                        let slow = points.iter().map(|&(u, v)| path(chamfer, x.abs_diff(u), y.abs_diff(v))).min();
                        prop_assert_eq!(map.units(x, y), slow);
                        let true_distance = f64::from(exact.squared(x, y)).sqrt();
                        prop_assert!((map.distance(x, y) - true_distance).abs() <= off * true_distance + 1e-9);
                    }
                }
            }
        }
    }

    #[test]
    fn an_empty_set_is_far_and_outside_is_infinite() {
        let mut map = ChamferMap::default();
        assert_eq!(map.distance(0, 0), f64::INFINITY);
        map.measure(&Mask::new(8, 6));
        assert!(map.distance(3, 3) > 14.0);
        assert_eq!(map.distance(8, 0), f64::INFINITY);
    }

    #[test]
    fn the_outline_of_a_box_is_its_frame_but_not_where_the_image_ends() {
        let mask = Mask::from_fn(10, 10, |x, y| (2..6).contains(&x) && y < 5);
        let expected = Mask::from_fn(10, 10, |x, y| mask.get(x, y) && (x == 2 || x == 5 || y == 4));
        assert_eq!(outline(&mask), expected);
    }
}
