//! Biomechanical constraints: static limits, and the dynamic constraints (2)-(6) of the paper's 3.3.
//!
//! Everything is linear, so feasible poses form a convex set. Sources and the reading of each equation
//! are in `spec/hand-model.md`.

use std::f64::consts::FRAC_PI_2;

use nalgebra::DVector;

use super::quadratic::constrained_minimum;
use super::{Finger, HandPose, JointAngle, JointAngles};

/// Smallest and largest value of one joint angle, radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleLimits {
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

/// Static limits of one joint angle (paper 3.3 for MCP and CMC flexion; spec/hand-model.md for the others).
pub fn limits(angle: JointAngle) -> AngleLimits {
    use JointAngle::*;
    let (min, max) = match angle {
        Pinky0Flexion => (-5.0, 30.0),
        Ring0Flexion => (-5.0, 20.0),
        Middle0Flexion | Index0Flexion => (-5.0, 8.0),
        Pinky1Flexion | Ring1Flexion | Middle1Flexion | Index1Flexion => (-15.0, 110.0),
        Pinky1Abduction => (-15.0, 40.0),
        Ring1Abduction => (-15.0, 25.0),
        Middle1Abduction => (-15.0, 15.0),
        Index1Abduction => (-15.0, 25.0),
        Pinky1Twisting | Ring1Twisting | Middle1Twisting | Index1Twisting => (-30.0, 30.0),
        Pinky2Flexion | Ring2Flexion | Middle2Flexion | Index2Flexion => (-5.0, 110.0),
        Pinky3Flexion | Ring3Flexion | Middle3Flexion | Index3Flexion => (-15.0, 90.0),
        Thumb1Flexion => (-35.0, 70.0),
        Thumb1Abduction => (-15.0, 70.0),
        Thumb1Twisting => (-40.0, 60.0),
        Thumb2Flexion => (-15.0, 60.0),
        Thumb3Flexion => (-20.0, 85.0),
    };
    AngleLimits { min: f64::to_radians(min), max: f64::to_radians(max) }
}

/// θ_PIP = 3/2 θ_DIP (eq. 2).
pub const DIP_FROM_PIP: f64 = 2.0 / 3.0;

/// Thumb MCP flexion from CMC flexion, radians: θ_MCP = 2 (θ_CMC − 30°) (eq. 5), with the equation's
/// CMC angle counted so that the neutral thumb (straight, 45° from the fingers) satisfies it, and held
/// between straight and the MCP's static maximum: beyond, the equation would break the joint.
pub fn thumb_mcp_from_cmc(cmc: f64) -> f64 {
    (2.0 * cmc).clamp(0.0, limits(JointAngle::Thumb2Flexion).max)
}

/// Change of the thumb's MCP flexion per change of CMC flexion: the slope of [`thumb_mcp_from_cmc`].
pub fn thumb_mcp_slope(cmc: f64) -> f64 {
    if cmc > 0.0 && 2.0 * cmc < limits(JointAngle::Thumb2Flexion).max { 2.0 } else { 0.0 }
}

/// MCP flexion at which the palm is cupped as far as it goes, radians.
const CUPPED: f64 = FRAC_PI_2;

/// Palm flexion of `finger` from its MCP flexion, radians.
pub fn palm_from_mcp(finger: Finger, mcp: f64) -> f64 {
    cupping(finger) * mcp.clamp(0.0, CUPPED)
}

/// Change of the palm flexion of `finger` per change of its MCP flexion: the slope of [`palm_from_mcp`].
pub fn palm_slope(finger: Finger, mcp: f64) -> f64 {
    if (0.0..CUPPED).contains(&mcp) { cupping(finger) } else { 0.0 }
}

/// Palm flexion per MCP flexion (`spec/hand-model.md`): a fist cups the palm.
fn cupping(finger: Finger) -> f64 {
    match finger {
        Finger::Ring => 0.1,
        Finger::Pinky => 0.33,
        _ => 0.0,
    }
}

/// How many joint angles are free: with the six global parameters the 21 of the paper.
pub const FREE_ANGLES: usize = Finger::COUNT * Finger::FREE_ANGLES;

/// Values of the free joint angles in the order of [`Domain::FREE`], radians. [`Finger::range`] says which are a
/// finger's.
pub type FreeAngles = [f64; FREE_ANGLES];

/// One linear constraint Σ cᵢ θᵢ ≤ bound.
#[derive(Clone, Debug, PartialEq)]
pub struct HalfSpace {
    /// Variable and coefficient of each term.
    pub terms: Vec<(usize, f64)>,
    /// Right-hand side, radians.
    pub bound: f64,
    /// What it says, for messages.
    pub name: String,
}

impl HalfSpace {
    /// Σ cᵢ θᵢ − bound: positive outside.
    pub fn excess(&self, point: &[f64]) -> f64 {
        self.terms.iter().map(|&(i, c)| c * point[i]).sum::<f64>() - self.bound
    }
}

/// An intersection of half-spaces: a convex set of joint angles.
#[derive(Clone, Debug)]
pub struct Domain {
    half_spaces: Vec<HalfSpace>,
}

impl Domain {
    /// The free joint angles of the tracker ([`Domain::expand`]): 15 of the 21 free parameters, the
    /// other six being global.
    pub const FREE: [JointAngle; FREE_ANGLES] = {
        use JointAngle::*;
        [
            Thumb1Flexion,
            Thumb1Abduction,
            Thumb3Flexion,
            Index1Flexion,
            Index1Abduction,
            Index2Flexion,
            Middle1Flexion,
            Middle1Abduction,
            Middle2Flexion,
            Ring1Flexion,
            Ring1Abduction,
            Ring2Flexion,
            Pinky1Flexion,
            Pinky1Abduction,
            Pinky2Flexion,
        ]
    };

    /// The feasible set over all 29 angles: static limits and the inequalities (3) and (4).
    pub fn full() -> Self {
        Self::over(&JointAngle::ALL)
    }

    /// The feasible set over the 15 free angles, in the order of [`Domain::FREE`]; the angles tied to
    /// them ([`Domain::expand`]) are feasible whenever these are.
    pub fn free() -> Self {
        Self::over(&Self::FREE)
    }

    /// The same angles under their static limits alone: what a joint allows when other fingers or another
    /// hand hold it, as recordings of isolated finger movements show.
    #[must_use]
    pub fn static_limits(mut self) -> Self {
        self.half_spaces.retain(|h| h.terms.len() == 1);
        self
    }

    /// The feasible set over any choice of angles, the others being zero.
    pub fn over(variables: &[JointAngle]) -> Self {
        let at = |angle: JointAngle| variables.iter().position(|&v| v == angle);
        let mut half_spaces = Vec::new();
        let mut add = |name: String, terms: &[(JointAngle, f64)], bound: f64| {
            let terms: Option<Vec<_>> = terms.iter().map(|&(a, c)| at(a).map(|i| (i, c))).collect();
            if let Some(terms) = terms {
                half_spaces.push(HalfSpace { terms, bound, name });
            }
        };
        for &angle in variables {
            let l = limits(angle);
            add(format!("{} maximum", angle.name()), &[(angle, 1.0)], l.max);
            add(format!("{} minimum", angle.name()), &[(angle, -1.0)], -l.min);
        }
        for finger in Finger::LONG {
            // (3): abd ≤ abd_max (1 − flex / flex_max), and the mirror image for adduction.
            let (flex, abd) = (finger.base_flexion(), finger.abduction());
            let (f, a) = (limits(flex), limits(abd));
            let name = |what| format!("{} {what} shrinks with flexion", finger.name());
            add(name("abduction"), &[(abd, 1.0), (flex, a.max / f.max)], a.max);
            add(name("adduction"), &[(abd, -1.0), (flex, -a.min / f.max)], -a.min);
        }
        // (4) with factor 1, θ_middle ≥ θ_index − 60° and θ_middle ≥ θ_ring − 45°. The 25° printed for
        // the index would forbid the F of the paper's own fig. 8 (spec/hand-model.md).
        let middle = Finger::Middle.base_flexion();
        for (finger, degrees) in [(Finger::Index, 60.0), (Finger::Ring, 45.0)] {
            let name = format!("{} flexion carries the middle finger along", finger.name());
            add(name, &[(finger.base_flexion(), 1.0), (middle, -1.0)], f64::to_radians(degrees));
        }
        Self { half_spaces }
    }

    /// The constraints.
    pub fn half_spaces(&self) -> &[HalfSpace] {
        &self.half_spaces
    }

    /// Whether no constraint is exceeded by more than `tolerance` radians.
    pub fn is_feasible(&self, point: &[f64], tolerance: f64) -> bool {
        self.half_spaces.iter().all(|h| h.excess(point) <= tolerance)
    }

    /// The constraints `point` exceeds by more than `tolerance` radians.
    pub fn exceeded<'a>(&'a self, point: &'a [f64], tolerance: f64) -> impl Iterator<Item = &'a HalfSpace> {
        self.half_spaces.iter().filter(move |h| h.excess(point) > tolerance)
    }

    /// The feasible point nearest to `point`, the distance being that of the angles taken as coordinates.
    /// A feasible point stays as it is, to the bit.
    pub fn project(&self, point: &[f64]) -> Vec<f64> {
        let found = constrained_minimum(None, DVector::from_column_slice(point), &self.half_spaces);
        // The neutral pose is inside, so the sets meet; only round-off could keep the method from ending,
        // and then the way to the neutral pose leads inside too.
        let point = match &found {
            Some(p) => p.as_slice(),
            None => point,
        };
        let t = if self.is_feasible(point, 1e-9) {
            1.0
        } else {
            self.clip_segment(&vec![0.0; point.len()], point)
        };
        point.iter().map(|v| v * t).collect()
    }

    /// The pose with the nearest feasible angles; of a domain over all 29 angles.
    #[must_use]
    pub fn project_pose(&self, pose: &HandPose) -> HandPose {
        let mut out = pose.clone();
        for (to, from) in out.angles.iter_mut().zip(self.project(&pose.angles)) {
            *to = from;
        }
        out
    }

    /// How far from the feasible point `from` towards `to` the segment stays feasible: the largest t in
    /// 0..=1 with `from + t (to − from)` inside. The paper's 6.4.4: a vertex that leaves the domain is
    /// put where its path crosses the constraint's hyperplane.
    pub fn clip_segment(&self, from: &[f64], to: &[f64]) -> f64 {
        let mut t = 1.0f64;
        for h in &self.half_spaces {
            let (a, b) = (h.excess(from), h.excess(to));
            // A constraint that the step does not approach cannot stop it, even when rounding has left
            // `from` a hair outside.
            if b > 0.0 && b > a + 1e-12 {
                t = t.min(if a >= 0.0 { 0.0 } else { a / (a - b) });
            }
        }
        t
    }

    /// The 29 angles of 15 free ones: DIP from PIP by (2), thumb MCP from CMC by (5), palm flexion of the ring and
    /// the little finger from their MCP flexion ([`palm_from_mcp`]), the others 0.
    pub fn expand(free: &FreeAngles) -> JointAngles {
        let mut angles = [0.0; JointAngle::COUNT];
        for (angle, value) in Self::FREE.into_iter().zip(free) {
            angles[angle.index()] = *value;
        }
        for finger in Finger::LONG {
            angles[finger.end_flexion().index()] = DIP_FROM_PIP * angles[finger.middle_flexion().index()];
            if let Some(palm) = finger.palm_flexion() {
                angles[palm.index()] = palm_from_mcp(finger, angles[finger.base_flexion().index()]);
            }
        }
        angles[JointAngle::Thumb2Flexion.index()] =
            thumb_mcp_from_cmc(angles[JointAngle::Thumb1Flexion.index()]);
        angles
    }

    /// The free angles among 29.
    pub fn reduce(angles: &JointAngles) -> FreeAngles {
        Self::FREE.map(|a| angles[a.index()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn free_angles() -> impl Strategy<Value = FreeAngles> {
        prop::array::uniform15(-2.0f64..2.5)
    }

    proptest! {
        #[test]
        fn clipped_segments_end_inside(to in free_angles()) {
            let domain = Domain::free();
            let from = [0.0; FREE_ANGLES];
            let t = domain.clip_segment(&from, &to);
            let end: Vec<f64> = to.iter().map(|v| v * t).collect();
            prop_assert!(domain.is_feasible(&end, 1e-9));
            if t < 1.0 {
                let beyond: Vec<f64> = to.iter().map(|v| v * (t + 1e-6)).collect();
                prop_assert!(!domain.is_feasible(&beyond, 0.0), "t is the largest");
            } else {
                prop_assert!(domain.is_feasible(&to, 1e-12));
            }
        }

        #[test]
        fn feasible_free_angles_expand_to_feasible_poses(to in free_angles()) {
            let domain = Domain::free();
            let t = domain.clip_segment(&[0.0; FREE_ANGLES], &to);
            let free: FreeAngles = to.map(|v| v * t);
            let angles = Domain::expand(&free);
            prop_assert!(Domain::full().is_feasible(&angles, 1e-9));
            prop_assert_eq!(Domain::reduce(&angles), free);
        }

        #[test]
        fn the_domain_is_convex(a in free_angles(), b in free_angles(), t in 0.0f64..1.0) {
            let domain = Domain::free();
            let inside = |p: FreeAngles| { let t = domain.clip_segment(&[0.0; FREE_ANGLES], &p); p.map(|v| v * t) };
            let (a, b) = (inside(a), inside(b));
            let mid: FreeAngles = std::array::from_fn(|i| a[i] + t * (b[i] - a[i]));
            prop_assert!(domain.is_feasible(&mid, 1e-9));
        }
    }

    /// Dykstra's alternating projections: slow, simple, and known to converge to the nearest point. The
    /// point may rest for many rounds while the corrections still move, so these decide the end.
    fn dykstra(domain: &Domain, point: &[f64]) -> Vec<f64> {
        let mut x = point.to_vec();
        let mut corrections = vec![0.0; domain.half_spaces().len()];
        for _ in 0..100_000 {
            let mut change = 0.0f64;
            for (h, correction) in domain.half_spaces().iter().zip(&mut corrections) {
                let before = *correction;
                let square: f64 = h.terms.iter().map(|(_, c)| c * c).sum();
                *correction = (before + h.excess(&x) / square).max(0.0);
                for &(i, c) in &h.terms {
                    x[i] += (before - *correction) * c;
                }
                change = change.max((before - *correction).abs());
            }
            if change < 1e-13 {
                break;
            }
        }
        x
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]
        #[test]
        fn projection_equals_dykstras(point in free_angles(), all in prop::array::uniform29(-2.0f64..2.5)) {
            for (domain, point) in [(Domain::free(), &point[..]), (Domain::full(), &all[..])] {
                let found = domain.project(point);
                prop_assert!(domain.is_feasible(&found, 1e-9));
                for (a, b) in found.iter().zip(dykstra(&domain, point)) {
                    prop_assert!((a - b).abs() < 1e-7, "{a} {b}");
                }
            }
        }

        #[test]
        fn feasible_points_project_to_themselves(point in free_angles()) {
            let domain = Domain::free();
            let t = domain.clip_segment(&[0.0; FREE_ANGLES], &point);
            let inside = point.map(|v| v * t * 0.999);
            prop_assert_eq!(domain.project(&inside), inside.to_vec());
        }
    }

    #[test]
    fn projection_survives_points_far_outside() {
        let domain = Domain::full();
        for scale in [1e3, 1e6] {
            let point: Vec<f64> = (0..29).map(|i| if i % 2 == 0 { scale } else { -scale }).collect();
            assert!(domain.is_feasible(&domain.project(&point), 1e-9));
        }
    }

    #[test]
    fn exceeded_constraints_are_named() {
        let mut angles = [0.0; JointAngle::COUNT];
        angles[JointAngle::Index1Flexion.index()] = 80f64.to_radians();
        let domain = Domain::full();
        let names: Vec<_> = domain.exceeded(&angles, 1e-9).map(|h| h.name.as_str()).collect();
        assert_eq!(names, ["index flexion carries the middle finger along"]);
    }

    #[test]
    fn abduction_vanishes_at_full_flexion() {
        let domain = Domain::full();
        let mut angles = [0.0; JointAngle::COUNT];
        for finger in Finger::LONG {
            angles[finger.base_flexion().index()] = limits(finger.base_flexion()).max;
        }
        assert!(domain.is_feasible(&angles, 1e-12));
        angles[JointAngle::Index1Abduction.index()] = 0.01;
        assert!(!domain.is_feasible(&angles, 1e-12));
    }

    #[test]
    fn the_index_carries_the_middle_finger_along() {
        let mut angles = [0.0; JointAngle::COUNT];
        angles[JointAngle::Index1Flexion.index()] = 85f64.to_radians();
        assert!(!Domain::full().is_feasible(&angles, 1e-9));
        angles[JointAngle::Middle1Flexion.index()] = 25f64.to_radians();
        assert!(Domain::full().is_feasible(&angles, 1e-9));
    }
}
