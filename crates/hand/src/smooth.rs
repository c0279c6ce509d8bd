//! Smoothing of poses over time: the 1 € filter of Casiez, Roussel & Vogel (CHI 2012).
//!
//! A low-pass whose cut-off rises with speed: still hands stop trembling, fast ones do not lag behind.

use nalgebra::UnitQuaternion;

use super::{Domain, HandPose};

/// The filter's two settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OneEuro {
    /// Cut-off of a still hand, hertz: lower trembles less and lags more.
    pub min_cutoff: f64,
    /// Rise of the cut-off with speed, hertz for each radian a second (angles, rotation) or each
    /// decimetre a second (translation).
    pub beta: f64,
}

impl Default for OneEuro {
    fn default() -> Self {
        Self { min_cutoff: 1.5, beta: 1.0 }
    }
}

/// Cut-off of the speed itself, hertz.
const SPEED_CUTOFF: f64 = 1.0;
/// Radians as which a metre counts: a decimetre weighs as much as a radian.
const RADIANS_A_METRE: f64 = 10.0;

/// Smooths the poses of one hand, in order of time.
#[derive(Clone, Debug)]
pub struct PoseSmoother {
    filter: OneEuro,
    domain: Domain,
    last: Option<(f64, HandPose)>,
    /// Smoothed speeds: 29 angles, rotation, translation.
    speeds: [f64; 31],
}

impl PoseSmoother {
    /// A smoother that has seen nothing yet.
    pub fn new(filter: OneEuro) -> Self {
        Self { filter, domain: Domain::full(), last: None, speeds: [0.0; 31] }
    }

    /// Forgets what it saw: for gaps.
    pub fn reset(&mut self) {
        self.last = None;
        self.speeds = [0.0; 31];
    }

    /// The smoothed pose at `time`, seconds. Feasible poses stay feasible: filtered each at its own pace,
    /// the angles may leave the feasible set a little, and go to its nearest point then.
    pub fn smooth(&mut self, time: f64, pose: &HandPose) -> HandPose {
        let Some((then, last)) = &self.last else {
            self.last = Some((time, pose.clone()));
            return pose.clone();
        };
        let dt = time - then;
        if dt <= 0.0 || !dt.is_finite() {
            return last.clone();
        }
        let weight = |cutoff: f64| {
            let r = std::f64::consts::TAU * cutoff * dt;
            r / (r + 1.0)
        };
        let turn = last.rotation.rotation_to(&pose.rotation);
        let shift = pose.translation - last.translation;
        let mut share = |i: usize, step: f64| {
            let speed = &mut self.speeds[i];
            *speed += weight(SPEED_CUTOFF) * (step / dt - *speed);
            weight(self.filter.min_cutoff + self.filter.beta * speed.abs())
        };
        let mut out = pose.clone();
        for (i, angle) in out.angles.iter_mut().enumerate() {
            let step = *angle - last.angles[i];
            *angle = last.angles[i] + share(i, step) * step;
        }
        let part = share(29, turn.angle());
        out.rotation = UnitQuaternion::from_scaled_axis(turn.scaled_axis() * part) * last.rotation;
        out.translation = last.translation + shift * share(30, shift.norm() * RADIANS_A_METRE);
        if self.domain.is_feasible(&pose.angles, 1e-9) && !self.domain.is_feasible(&out.angles, 1e-9) {
            out = self.domain.project_pose(&out);
        }
        self.last = Some((time, out.clone()));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{JointAngle, Side};

    fn bent(radians: f64) -> HandPose {
        let mut pose = HandPose::neutral(Side::Right);
        pose.set(JointAngle::Index1Flexion, radians);
        pose.translation.x = 0.1 * radians;
        pose.rotation = UnitQuaternion::from_euler_angles(0.0, radians, 0.0);
        pose
    }

    fn run(input: impl Fn(f64) -> f64) -> Vec<[f64; 3]> {
        let mut smoother = PoseSmoother::new(OneEuro::default());
        (0..120)
            .map(|i| {
                let t = f64::from(i) / 30.0;
                let out = smoother.smooth(t, &bent(input(t)));
                [out.angle(JointAngle::Index1Flexion), out.translation.x * 10.0, out.rotation.angle()]
            })
            .collect()
    }

    #[test]
    fn trembling_is_cut_down_and_stillness_kept() {
        let shake = |t: f64| 0.3 + 0.01 * (t * 60.0).sin();
        for k in 0..3 {
            let out = run(shake);
            let (low, high) =
                out[60..].iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v[k]), b.max(v[k])));
            assert!(high - low < 0.008, "{k}: {}", high - low);
            assert!(run(|_| 0.3).iter().all(|v| (v[k] - 0.3).abs() < 1e-12));
        }
    }

    #[test]
    fn fast_movements_are_followed() {
        // A bend of 1 rad in a quarter of a second.
        let out = run(|t| ((t - 1.0) * 4.0).clamp(0.0, 1.0));
        for v in &out[30 + 8 + 6..] {
            assert!(v.iter().all(|v| (v - 1.0).abs() < 0.15), "{v:?}");
        }
    }

    #[test]
    fn feasible_poses_stay_feasible() {
        let domain = Domain::full();
        let mut smoother = PoseSmoother::new(OneEuro { min_cutoff: 0.5, beta: 2.0 });
        for i in 0..200 {
            let mut pose = HandPose::neutral(Side::Left);
            for (k, angle) in pose.angles.iter_mut().enumerate() {
                *angle = ((i * (k + 3)) as f64 * 0.31).sin() * 2.0;
            }
            let pose = domain.project_pose(&pose);
            let out = smoother.smooth(i as f64 * 0.02, &pose);
            assert!(domain.is_feasible(&out.angles, 1e-9));
        }
    }
}
