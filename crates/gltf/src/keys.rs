//! Keys of one animation channel: continuous signs, and leaving out what interpolation gives back.

use nalgebra::{Quaternion, UnitQuaternion, Vector3, Vector4};

/// Longest run of keys left out in one go: bounds the work on motions that hardly change.
const LONGEST_RUN: usize = 512;

/// A value glTF interpolates.
pub(super) trait Key: Copy {
    /// What a player shows at share `t` of the way from `self` to `to`.
    fn between(&self, to: &Self, t: f64) -> Self;
    /// How far apart two values are: radians or metres.
    fn distance(&self, other: &Self) -> f64;
    /// Its numbers, of which cubic splines are made: those of a quaternion x first.
    fn numbers(&self) -> Vector4<f64>;
    /// The value of such numbers.
    fn of_numbers(numbers: Vector4<f64>) -> Self;
}

impl Key for UnitQuaternion<f64> {
    fn between(&self, to: &Self, t: f64) -> Self {
        slerp(self, to, t)
    }

    fn distance(&self, other: &Self) -> f64 {
        // Half-angle by the chord: exact also where the cosine is flat.
        let dot = self.coords.dot(&other.coords);
        let chord = (self.coords - other.coords * dot.signum()).norm();
        4.0 * (0.5 * chord).min(1.0).asin()
    }

    fn numbers(&self) -> Vector4<f64> {
        self.coords
    }

    fn of_numbers(numbers: Vector4<f64>) -> Self {
        UnitQuaternion::try_new(Quaternion::from(numbers), 1e-9).unwrap_or_default()
    }
}

impl Key for Vector3<f64> {
    fn between(&self, to: &Self, t: f64) -> Self {
        self.lerp(to, t)
    }

    fn distance(&self, other: &Self) -> f64 {
        (self - other).norm()
    }

    fn numbers(&self) -> Vector4<f64> {
        self.push(0.0)
    }

    fn of_numbers(numbers: Vector4<f64>) -> Self {
        numbers.xyz()
    }
}

/// Spherical interpolation along the shorter arc, as glTF defines it.
pub(super) fn slerp(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>, t: f64) -> UnitQuaternion<f64> {
    let (a, mut b) = (a.coords, b.coords);
    let mut dot = a.dot(&b);
    if dot < 0.0 {
        b = -b;
        dot = -dot;
    }
    let angle = dot.min(1.0).acos();
    let mixed = if angle < 1e-4 {
        a.lerp(&b, t)
    } else {
        (a * ((1.0 - t) * angle).sin() + b * (t * angle).sin()) / angle.sin()
    };
    UnitQuaternion::from_quaternion(Quaternion::from(mixed))
}

/// Turns signs so that each quaternion lies in the half-space of the one before: players that
/// interpolate components do not take the long way round.
pub(super) fn make_continuous(keys: &mut [UnitQuaternion<f64>]) {
    for i in 1..keys.len() {
        if keys[i].coords.dot(&keys[i - 1].coords) < 0.0 {
            keys[i] = UnitQuaternion::new_unchecked(-keys[i].into_inner());
        }
    }
}

/// Numbers of the keys to keep so that interpolation gives back each of the others within `tolerance`;
/// first and last always stay.
pub(super) fn reduce<K: Key>(times: &[f64], keys: &[K], tolerance: f64) -> Vec<usize> {
    let last = keys.len().saturating_sub(1);
    if tolerance <= 0.0 {
        return (0..keys.len()).collect();
    }
    let spans = |from: usize, to: usize| {
        (from + 1..to).all(|k| {
            let t = (times[k] - times[from]) / (times[to] - times[from]);
            keys[from].between(&keys[to], t).distance(&keys[k]) <= tolerance
        })
    };
    let mut kept = vec![0];
    let mut from = 0;
    while from < last {
        let mut to = from + 1;
        while to < last && to - from < LONGEST_RUN && spans(from, to + 1) {
            to += 1;
        }
        kept.push(to);
        from = to;
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn left_out_keys_come_back_within_tolerance(
            steps in prop::collection::vec((0.01f64..0.1, -0.2f64..0.2, -0.2f64..0.2), 2..60),
            tolerance in 0.0f64..0.1,
        ) {
            let mut times = vec![0.0];
            let mut keys = vec![UnitQuaternion::identity()];
            for (dt, a, b) in steps {
                times.push(times[times.len() - 1] + dt);
                let turn = UnitQuaternion::from_scaled_axis(Vector3::new(a, b, 0.0));
                keys.push(keys[keys.len() - 1] * turn);
            }
            make_continuous(&mut keys);
            let kept = reduce(&times, &keys, tolerance);
            prop_assert_eq!(kept[0], 0);
            prop_assert_eq!(kept[kept.len() - 1], keys.len() - 1);
            for pair in kept.windows(2) {
                for k in pair[0]..pair[1] {
                    let t = (times[k] - times[pair[0]]) / (times[pair[1]] - times[pair[0]]);
                    let shown = slerp(&keys[pair[0]], &keys[pair[1]], t);
                    prop_assert!(shown.angle_to(&keys[k]) <= tolerance + 1e-7);
                }
            }
        }

        #[test]
        fn distance_is_the_angle(a in -3.0f64..3.0, b in -3.0f64..3.0) {
            let p = UnitQuaternion::from_scaled_axis(Vector3::x() * a);
            let q = UnitQuaternion::from_scaled_axis(Vector3::x() * b);
            prop_assert!((p.distance(&q) - p.angle_to(&q)).abs() < 1e-6);
        }
    }

    #[test]
    fn a_steady_turn_needs_two_keys() {
        let times: Vec<f64> = (0..100).map(f64::from).collect();
        let keys: Vec<_> =
            times.iter().map(|t| UnitQuaternion::from_scaled_axis(Vector3::y() * (0.01 * t))).collect();
        assert_eq!(reduce(&times, &keys, 1e-4), [0, 99]);
    }
}
