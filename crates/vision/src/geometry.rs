//! Points and directions in a picture: `[x, y]` in pixels, x to the right, y down, pixel centres at .5.

/// The middle of a pixel.
pub(super) fn pixel_centre(x: u32, y: u32) -> [f64; 2] {
    [f64::from(x) + 0.5, f64::from(y) + 0.5]
}

/// The vector from `b` to `a`.
pub(super) fn minus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

/// `point` moved by `distance` times `direction`.
pub(super) fn moved(point: [f64; 2], direction: [f64; 2], distance: f64) -> [f64; 2] {
    [point[0] + direction[0] * distance, point[1] + direction[1] * distance]
}

pub(super) fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// The third component of the cross product: positive where `b` is clockwise of `a` on the screen.
pub(super) fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// `direction` turned clockwise by a right angle.
pub(super) fn quarter_turn(direction: [f64; 2]) -> [f64; 2] {
    [-direction[1], direction[0]]
}

pub(super) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    let d = minus(a, b);
    d[0].hypot(d[1])
}

/// Unit vector, `None` for the null vector.
pub(super) fn unit(v: [f64; 2]) -> Option<[f64; 2]> {
    let length = v[0].hypot(v[1]);
    (length > 1e-9).then(|| v.map(|c| c / length))
}

/// `direction` or its opposite, whichever is within a right angle of `reference`.
pub(super) fn facing(direction: [f64; 2], reference: [f64; 2]) -> [f64; 2] {
    if dot(direction, reference) < 0.0 { direction.map(|c| -c) } else { direction }
}

/// The mean of points; the origin without any.
pub(super) fn mean(points: &[[f64; 2]]) -> [f64; 2] {
    let n = points.len() as f64;
    points.iter().fold([0.0; 2], |sum, p| [sum[0] + p[0] / n, sum[1] + p[1] / n])
}

/// Direction of the line nearest to the points in the mean square: their inertia axis.
pub(super) fn line_direction(points: &[[f64; 2]]) -> Option<[f64; 2]> {
    let mean = mean(points);
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in points {
        let [dx, dy] = minus(*p, mean);
        xx += dx * dx;
        xy += dx * dy;
        yy += dy * dy;
    }
    (xx + yy > 0.0).then(|| {
        let angle: f64 = 0.5 * (2.0 * xy).atan2(xx - yy);
        [angle.cos(), angle.sin()]
    })
}

/// Where two lines cross, each given by a point and a direction; `None` if the sine of the angle between them is
/// `least_sine` or less.
pub(super) fn crossing([p, d]: [[f64; 2]; 2], [q, e]: [[f64; 2]; 2], least_sine: f64) -> Option<[f64; 2]> {
    let sine = cross(d, e);
    (sine.abs() > least_sine).then(|| moved(p, d, cross(minus(q, p), e) / sine))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_and_signs_are_those_of_the_screen() {
        let (right, down) = ([1.0, 0.0], [0.0, 1.0]);
        assert_eq!(quarter_turn(right), [0.0, 1.0]);
        assert!(cross(right, down) > 0.0);
        assert_eq!(facing([0.6, -0.8], down), [-0.6, 0.8]);
        assert_eq!(facing([0.6, 0.8], down), [0.6, 0.8]);
        assert_eq!(unit([0.0, 0.0]), None);
        assert_eq!(unit([0.0, -3.0]), Some([0.0, -1.0]));
    }

    #[test]
    fn a_line_through_points_has_their_direction() {
        let points: Vec<[f64; 2]> = (0..9).map(|k| moved([4.0, -7.0], [0.6, 0.8], f64::from(k))).collect();
        let direction = facing(line_direction(&points).unwrap(), [1.0, 0.0]);
        assert!(distance(direction, [0.6, 0.8]) < 1e-12, "{direction:?}");
        assert!(distance(mean(&points), [6.4, -3.8]) < 1e-12);
        assert_eq!(line_direction(&[[2.0, 3.0]; 4]), None);
    }

    #[test]
    fn lines_cross_where_they_should_unless_parallel() {
        let at = crossing([[0.0, 1.0], [1.0, 0.0]], [[3.0, -5.0], [0.0, 1.0]], 0.05);
        assert_eq!(at, Some([3.0, 1.0]));
        assert_eq!(crossing([[0.0, 1.0], [1.0, 0.0]], [[3.0, -5.0], [1.0, 0.01]], 0.05), None);
    }
}
