//! The turned square in which joints are looked for.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::JOINTS;

/// A square in a picture, turned so that the hand points up in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Its centre in pixels: to the right, down.
    pub centre: [f64; 2],
    /// Its side in pixels.
    pub side: f64,
    /// By how much it is turned clockwise, in radians from -π to π.
    pub angle: f64,
}

impl Region {
    /// The point at a place of the region, from (0, 0) at its upper left to (1, 1) at its lower right corner.
    pub fn point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [dx, dy] = turn([(x - 0.5) * self.side, (y - 0.5) * self.side], self.angle);
        [self.centre[0] + dx, self.centre[1] + dy]
    }

    /// Its corners: upper left, upper right, lower right, lower left.
    pub fn corners(&self) -> [[f64; 2]; 4] {
        [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|corner| self.point(corner))
    }

    /// The region of a hand whose palm was found: from its upright box, wrist and the middle finger's MCP. The square is 2.6
    /// times the longer side of the box, and half a height of the box towards the fingers.
    pub fn of_palm(centre: [f64; 2], size: [f64; 2], wrist: [f64; 2], middle: [f64; 2]) -> Self {
        Self { centre, side: 0.0, angle: direction(wrist, middle) }.grown(size, 2.6, -0.5)
    }

    /// The region of a hand whose joints were found: twice the longer side of the turned box round wrist, thumb up to its
    /// IP joint, and MCP and PIP joints of the fingers, a tenth of its height towards the fingers.
    pub fn of_joints(points: &[[f64; 2]; JOINTS]) -> Self {
        let [index, middle, ring] = [points[5], points[9], points[13]];
        let knuckles = [0, 1].map(|i| ((index[i] + ring[i]) / 2.0 + middle[i]) / 2.0);
        let angle = direction(points[0], knuckles);
        let palm = || [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18].into_iter().map(|i| points[i]);
        let (centre, _) = bounds(palm());
        let (middle, size) = bounds(palm().map(|[x, y]| turn([x - centre[0], y - centre[1]], -angle)));
        let [dx, dy] = turn(middle, angle);
        Self { centre: [centre[0] + dx, centre[1] + dy], side: 0.0, angle }.grown(size, 2.0, -0.1)
    }

    /// A square of `scale` times the longer side of a box, shifted along the box's height.
    fn grown(self, size: [f64; 2], scale: f64, shift: f64) -> Self {
        let [dx, dy] = turn([0.0, size[1] * shift], self.angle);
        let centre = [self.centre[0] + dx, self.centre[1] + dy];
        Self { centre, side: size[0].max(size[1]) * scale, ..self }
    }

    /// Intersection over union of the squares as if they were not turned.
    pub fn overlap(&self, other: &Self) -> f64 {
        let bounds = |r: &Self| [r.centre.map(|c| c - r.side / 2.0), r.centre.map(|c| c + r.side / 2.0)];
        overlap(bounds(self), bounds(other))
    }
}

/// Intersection over union of two upright boxes, each of its lower and its upper corner; 0 where neither has an area.
pub fn overlap(a: [[f64; 2]; 2], b: [[f64; 2]; 2]) -> f64 {
    let common = [0, 1].map(|i| (a[1][i].min(b[1][i]) - a[0][i].max(b[0][i])).max(0.0));
    let area = |r: [[f64; 2]; 2]| (r[1][0] - r[0][0]) * (r[1][1] - r[0][1]);
    let common = common[0] * common[1];
    let union = area(a) + area(b) - common;
    if union > 0.0 { common / union } else { 0.0 }
}

/// `point` turned clockwise (y is down) by `angle`.
fn turn([x, y]: [f64; 2], angle: f64) -> [f64; 2] {
    let (sin, cos) = angle.sin_cos();
    [x * cos - y * sin, x * sin + y * cos]
}

/// How far the direction from one point to another is turned clockwise from up, from -π to π.
fn direction(from: [f64; 2], to: [f64; 2]) -> f64 {
    let angle = FRAC_PI_2 - (from[1] - to[1]).atan2(to[0] - from[0]);
    angle - TAU * ((angle + PI) / TAU).floor()
}

/// Centre and size of the upright box round points.
fn bounds(points: impl Iterator<Item = [f64; 2]>) -> ([f64; 2], [f64; 2]) {
    let start = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let (low, high) = points.fold(start, |(low, high), p| {
        ([low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])])
    });
    ([0, 1].map(|i| (low[i] + high[i]) / 2.0), [0, 1].map(|i| high[i] - low[i]))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A right hand pointing up, palm to the camera, in units of its length.
    fn hand() -> [[f64; 2]; JOINTS] {
        let mut points = [[0.0, 0.0]; JOINTS];
        for finger in 0..5 {
            for joint in 0..4 {
                let along = 0.45 + 0.15 * joint as f64;
                points[1 + 4 * finger + joint] = [0.12 * (finger as f64 - 2.0), -along];
            }
        }
        points
    }

    #[test]
    fn a_hand_that_points_up_is_in_an_upright_region() {
        let region = Region::of_joints(&hand());
        assert!(region.angle.abs() < 1e-12);
        assert!(region.centre[0].abs() < 1e-12 && region.centre[1] < -0.3);
        assert!(region.side > 1.0);
    }

    proptest! {
        #[test]
        fn the_region_turns_with_the_hand(angle in -3.1..3.1f64, scale in 10.0..500.0f64, x in 0.0..1e3f64, y in 0.0..1e3f64) {
            let upright = Region::of_joints(&hand());
            let moved = hand().map(|p| {
                let [a, b] = turn(p, angle);
                [a * scale + x, b * scale + y]
            });
            let region = Region::of_joints(&moved);
            prop_assert!((region.angle - angle).abs() < 1e-9);
            // The centre of the box is that of the turned points, so size and place do not change.
            prop_assert!((region.side - upright.side * scale).abs() < 1e-9 * scale);
            let [a, b] = turn(upright.centre, angle);
            prop_assert!((region.centre[0] - (a * scale + x)).abs() < 1e-9 * scale.max(1e3));
            prop_assert!((region.centre[1] - (b * scale + y)).abs() < 1e-9 * scale.max(1e3));
        }

        #[test]
        fn overlap_is_that_of_counted_pixels(a in prop::array::uniform4(0..20u8), b in prop::array::uniform4(0..20u8)) {
            let square = |[x, y, w, h]: [u8; 4]| {
                let low = [f64::from(x), f64::from(y)];
                [low, [low[0] + f64::from(w) + 1.0, low[1] + f64::from(h) + 1.0]]
            };
            let inside = |[x, y, w, h]: [u8; 4], i: u8, j: u8| (x..=x + w).contains(&i) && (y..=y + h).contains(&j);
            let (mut both, mut either) = (0, 0);
            for i in 0..40 {
                for j in 0..40 {
                    both += i32::from(inside(a, i, j) && inside(b, i, j));
                    either += i32::from(inside(a, i, j) || inside(b, i, j));
                }
            }
            let expected = f64::from(both) / f64::from(either);
            prop_assert!((overlap(square(a), square(b)) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn corners_are_where_points_say() {
        let region = Region { centre: [10.0, 20.0], side: 4.0, angle: FRAC_PI_2 };
        let [upper_left, upper_right, ..] = region.corners();
        assert!((upper_left[0] - 12.0).abs() < 1e-12 && (upper_left[1] - 18.0).abs() < 1e-12);
        assert!((upper_right[0] - 12.0).abs() < 1e-12 && (upper_right[1] - 22.0).abs() < 1e-12);
    }
}
