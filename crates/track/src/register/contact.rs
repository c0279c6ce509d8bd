//! Fingers cannot be in the same place.
//!
//! Several fingers stretched out behind one another have the silhouette of a single one. The capsules of
//! neighbouring fingers are therefore held apart.

use nalgebra::Vector3;

use super::super::normal_equations::NormalEquations;
use super::super::projection::{FREE, OWN, ProjectedSphere, parameter};
use handcast_hand::{Finger, Shape};
use handcast_vision::tuning::tuning;

tuning! {
    /// How near neighbouring fingers may come.
    pub struct ContactTuning {
        /// Distance that the axes of two capsules keep: share of the sum of their mean radii. Fingers are soft.
        ["1", "spec/experiments.md, Firm priors"]
        pub distance: f64 = 0.8,
        /// Standard deviation of how much nearer they are.
        ["m", "spec/experiments.md, Firm priors"]
        pub deviation: f64 = 0.001,
    }
}

/// Determinant, m⁴, or squared length, m², below which segments are parallel or points.
const PARALLEL: f64 = 1e-12;
/// Distance of axes below which its direction is lost to rounding, metres.
const TOUCHING: f64 = 1e-9;
/// Pairs of fingers that are held apart.
const PAIRS: [[Finger; 2]; 3] =
    [[Finger::Index, Finger::Middle], [Finger::Middle, Finger::Ring], [Finger::Ring, Finger::Pinky]];

/// Two capsules that are too near.
struct Contact<'a> {
    fingers: [Finger; 2],
    /// The ends of the capsules.
    ends: [[&'a ProjectedSphere; 2]; 2],
    /// Where on the axes they are nearest: share of the second end.
    shares: [f64; 2],
    /// Unit vector from the first to the second.
    away: Vector3<f64>,
    /// How much too near, metres.
    depth: f64,
}

/// Adds the depth of each contact as a residual.
pub(super) fn add_to(equations: &mut NormalEquations, spheres: &[ProjectedSphere], tuning: &ContactTuning) {
    let weight = 1.0 / (tuning.deviation * tuning.deviation);
    visit(spheres, tuning.distance, |contact| {
        let mut gradient = [(0, 0.0); 2 * (OWN)];
        for (k, finger) in contact.fingers.into_iter().enumerate() {
            let ([a, b], share) = (contact.ends[k], contact.shares[k]);
            let sign = if k == 0 { 1.0 } else { -1.0 };
            for column in 0..OWN {
                let motion = a.moves[column].lerp(&b.moves[column], share);
                gradient[k * (OWN) + column] =
                    (parameter(finger, FREE + column), sign * motion.dot(&contact.away));
            }
        }
        equations.add(&gradient, contact.depth, weight);
    });
}

/// The cost of contact: half the sum of squares in standard deviations.
pub(super) fn cost(spheres: &[ProjectedSphere], tuning: &ContactTuning) -> f64 {
    let mut sum = 0.0;
    visit(spheres, tuning.distance, |contact| sum += 0.5 * (contact.depth / tuning.deviation).powi(2));
    sum
}

/// Gives each pair of capsules of neighbouring fingers that are nearer than `distance` sums of their mean radii.
fn visit<'a>(spheres: &'a [ProjectedSphere], distance: f64, mut found: impl FnMut(Contact<'a>)) {
    let capsules = |finger| {
        let [a, b, c, d] = Shape::finger_spheres(finger);
        let capsule = |i: usize, j: usize| Some([spheres.get(i)?, spheres.get(j)?]);
        [capsule(a, b), capsule(b, c), capsule(c, d)]
    };
    for fingers in PAIRS {
        for one in capsules(fingers[0]).into_iter().flatten() {
            for other in capsules(fingers[1]).into_iter().flatten() {
                let ends = [one, other];
                let shares = nearest(ends.map(|e| e.map(|s| s.centre)));
                let [p, q] = [0, 1].map(|k| ends[k][0].centre.lerp(&ends[k][1].centre, shares[k]));
                let away = q - p;
                let thickness: f64 = ends.iter().flatten().map(|s| 0.5 * s.radius).sum();
                let depth = distance * thickness - away.norm();
                if depth > 0.0 {
                    let away = away.try_normalize(TOUCHING).unwrap_or_else(Vector3::x);
                    found(Contact { fingers, ends, shares, away, depth });
                }
            }
        }
    }
}

/// Where two segments are nearest to each other: shares of their second ends.
fn nearest([[a, b], [c, d]]: [[Vector3<f64>; 2]; 2]) -> [f64; 2] {
    let (u, v, w) = (b - a, d - c, a - c);
    let (uu, uv, vv) = (u.norm_squared(), u.dot(&v), v.norm_squared());
    let (uw, vw) = (u.dot(&w), v.dot(&w));
    let determinant = uu * vv - uv * uv;
    let on = |numerator: f64, denominator: f64| {
        if denominator < PARALLEL { 0.0 } else { (numerator / denominator).clamp(0.0, 1.0) }
    };
    let s = on(uv * vw - vv * uw, determinant);
    let t = on(vw + s * uv, vv);
    // Once more for the first, now that the second is inside its segment.
    [on(t * uv - uw, uu), t]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HandModel, ModelState};
    use handcast_hand::{FREE_ANGLES, FreeAngles, Morphology, Side};
    use proptest::prelude::*;

    const INDEX: Finger = Finger::Index;
    const MIDDLE: Finger = Finger::Middle;
    const RING: Finger = Finger::Ring;
    const PINKY: Finger = Finger::Pinky;
    const SOFT: ContactTuning = ContactTuning { distance: 0.8, deviation: 0.003 };

    fn spheres(free: FreeAngles) -> Vec<ProjectedSphere> {
        let model = HandModel::new(&Morphology::default(), Side::Right);
        let mut spheres = Vec::new();
        model.project_moving(&ModelState { free, ..ModelState::facing([0.0; 2], 1000.0) }, &mut spheres);
        spheres
    }

    fn side_by_side() -> FreeAngles {
        let mut free = [0.0; FREE_ANGLES];
        // Index and ring finger both towards the middle one, but not across it.
        (free[INDEX.free_abduction()], free[RING.free_abduction()]) = (-0.02, -0.02);
        free
    }

    #[test]
    fn adducted_fingers_touch_and_crossed_ones_do_not_fit() {
        assert_eq!(cost(&spheres([0.0; FREE_ANGLES]), &SOFT), 0.0);
        assert!(cost(&spheres(side_by_side()), &SOFT) < 1.0);
        let mut free = [0.0; FREE_ANGLES];
        (free[INDEX.free_abduction()], free[RING.free_abduction()]) = (-0.25, -0.25);
        assert!(cost(&spheres(free), &SOFT) > 10.0);
        // A bent finger leaves the place to its neighbours.
        (free[MIDDLE.free_base()], free[MIDDLE.free_outer()]) = (1.4, 1.7);
        assert!(cost(&spheres(free), &SOFT) < 6.0, "{}", cost(&spheres(free), &SOFT));
    }

    #[test]
    fn gradients_are_those_of_the_cost() {
        let mut free = side_by_side();
        (free[INDEX.free_abduction()], free[RING.free_abduction()]) = (-0.2, -0.15);
        (free[INDEX.free_base()], free[INDEX.free_outer()], free[MIDDLE.free_outer()]) = (0.1, 0.2, 0.1);
        // Where the palm begins to be cupped there is no slope.
        (free[RING.free_base()], free[PINKY.free_base()]) = (0.05, 0.05);
        let mut equations = NormalEquations::new();
        add_to(&mut equations, &spheres(free), &SOFT);
        let h = 1e-6;
        for i in 0..FREE_ANGLES {
            let at = |by: f64| {
                let mut moved = free;
                moved[i] += by;
                cost(&spheres(moved), &SOFT)
            };
            let slope = (at(h) - at(-h)) / (2.0 * h);
            let found = equations.gradient(FREE + i);
            assert!((found - slope).abs() < 1e-2 * (1.0 + slope.abs()), "{i}: {found} {slope}");
        }
    }

    proptest! {
        #[test]
        fn nearest_points_are_those_of_a_plain_search(v in prop::array::uniform12(-1.0f64..1.0)) {
            let p: [Vector3<f64>; 4] = std::array::from_fn(|k| Vector3::from_column_slice(&v[3 * k..3 * k + 3]));
            let distance = |s: f64, t: f64| (p[0].lerp(&p[1], s) - p[2].lerp(&p[3], t)).norm();
            let [s, t] = nearest([[p[0], p[1]], [p[2], p[3]]]);
            let steps = || (0..=40).map(|k| f64::from(k) / 40.0);
            let least = steps().flat_map(|s| steps().map(move |t| (s, t)))
                .map(|(s, t)| distance(s, t)).fold(f64::INFINITY, f64::min);
            prop_assert!(distance(s, t) <= least + 1e-9, "{} {}", distance(s, t), least);
        }
    }
}
