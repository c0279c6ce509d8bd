//! Poses from lines of sight: where a camera at the origin sees the joints, not how far away they are.

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

use super::{Fit, JointPoints, LandmarkError, PALM, PoseSolver, Targets, align, mirrored_points};
use crate::{HandPose, Side};

/// Distance of the joints from their lines, metres on average, beyond which a hand is looked for anew.
const LOST: f64 = 0.006;
/// Turns about each axis of space that a hand without a pose before starts from.
const QUARTERS: usize = 4;

impl PoseSolver {
    /// The pose whose joints lie nearest to the lines of sight of a camera at the origin that looks along −z, x right,
    /// y up: `seen` has one point of each line, at any distance. The hand's sizes say how far away it is.
    ///
    /// `lifted` are places of the joints in any scale and at any distance, as far as something tells how deep they lie;
    /// the hand starts from there. Without it a hand starts from the pose before, the first from turns all round.
    ///
    /// # Errors
    /// [`LandmarkError::TooFew`] or [`LandmarkError::Degenerate`] when less than four points of the palm are seen, or
    /// none of the poses tried lies before the camera.
    pub fn solve_seen(
        &mut self,
        seen: &JointPoints,
        lifted: Option<&JointPoints>,
    ) -> Result<Fit, LandmarkError> {
        let of_right = |points: &JointPoints| match self.side {
            Side::Right => *points,
            Side::Left => mirrored_points(points),
        };
        let (seen, lifted) = (of_right(seen), lifted.map(of_right));
        let palm = PALM.iter().filter(|joint| seen[joint.index()].is_some()).count();
        if palm < 4 {
            return Err(LandmarkError::TooFew { seen: palm, needed: 4 });
        }
        let targets = Targets::Rays(&seen);
        let starts = lifted.and_then(|lifted| self.lifted(&seen, &lifted)).into_iter();
        let mut best = self.best(starts.chain(self.last.clone()), targets);
        if best.as_ref().is_none_or(|(distance, _, _)| *distance > LOST) {
            let all_round = turns().filter_map(|turn| self.before_camera(&seen, turn));
            let found = self.best(all_round, targets);
            best = [best, found].into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0));
        }
        let (_, pose, steps) = best.ok_or(LandmarkError::Degenerate)?;
        Ok(self.fitted(pose, steps, targets))
    }

    /// Of the poses found from these starts the one nearest to the lines: mean distance, pose and steps.
    fn best(
        &self,
        starts: impl Iterator<Item = HandPose>,
        targets: Targets,
    ) -> Option<(f64, HandPose, usize)> {
        let found = starts.filter_map(|start| {
            let (pose, steps) = self.refine(start, targets);
            let frames = self.skeleton.frames(&pose);
            let (mut sum, mut count) = (0.0, 0usize);
            for (joint, _, residual) in targets.residuals(|joint| frames.position(joint)) {
                // Lines go on behind the camera; hands do not.
                if frames.position(joint).z >= 0.0 {
                    return None;
                }
                sum += residual.norm();
                count += 1;
            }
            Some((sum / count.max(1) as f64, pose, steps))
        });
        found.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// The pose of points that are right but for scale and place, put where the lines say.
    fn lifted(&self, seen: &JointPoints, lifted: &JointPoints) -> Option<HandPose> {
        let rest = |k: usize| self.palm[k];
        let pairs: Vec<_> =
            PALM.iter().enumerate().filter_map(|(k, j)| Some((rest(k), lifted[j.index()]?))).collect();
        let spread = |points: &mut dyn Iterator<Item = Point3<f64>>| {
            let points: Vec<Vector3<f64>> = points.map(|p| p.coords).collect();
            let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
            points.iter().map(|p| (p - mean).norm_squared()).sum::<f64>().sqrt()
        };
        let (ours, theirs) = (spread(&mut pairs.iter().map(|p| p.0)), spread(&mut pairs.iter().map(|p| p.1)));
        if pairs.len() < 3 || theirs.is_nan() || theirs <= 0.0 {
            return None;
        }
        let scaled = lifted.map(|p| p.map(|p| p * (ours / theirs)));
        let start = self.initial(&scaled).ok()?;
        let pairs: Vec<_> = pairs.into_iter().map(|(a, b)| (a, b * (ours / theirs))).collect();
        let rotation = align(&pairs)?.rotation;
        let placed = self.before_camera(seen, rotation)?;
        Some(HandPose { translation: placed.translation, rotation, angles: start.angles, side: Side::Right })
    }

    /// A hand with the angles of the pose before, turned like this, moved to where the lines say.
    fn before_camera(&self, seen: &JointPoints, rotation: UnitQuaternion<f64>) -> Option<HandPose> {
        let mut pose = HandPose { rotation, ..HandPose::neutral(Side::Right) };
        if let Some(last) = &self.last {
            pose.angles = last.angles;
        }
        pose.translation = Vector3::zeros();
        let frames = self.skeleton.frames(&pose);
        let joints = PALM.into_iter().filter_map(|j| Some((frames.position(j), seen[j.index()]?)));
        pose.translation = placed_on_lines(joints)?;
        (pose.translation.z < 0.0).then_some(pose)
    }
}

/// The way by which points are moved to come nearest to lines through the origin, least squares of the distances;
/// each pair is a point and a point of its line. `None` when the lines do not fix it.
pub fn placed_on_lines(pairs: impl IntoIterator<Item = (Point3<f64>, Point3<f64>)>) -> Option<Vector3<f64>> {
    let (mut normal, mut side) = (Matrix3::zeros(), Vector3::zeros());
    for (point, on_line) in pairs {
        let ray = on_line.coords.try_normalize(1e-12)?;
        let across = Matrix3::identity() - ray * ray.transpose();
        normal += across;
        side -= across * point.coords;
    }
    let moved = normal.try_inverse()? * side;
    moved.iter().all(|v| v.is_finite()).then_some(moved)
}

/// Quarter turns about two axes: every way that a palm can face, each in four turns.
fn turns() -> impl Iterator<Item = UnitQuaternion<f64>> {
    let quarter = |k: usize| k as f64 * std::f64::consts::FRAC_PI_2;
    let faces = (0..QUARTERS).map(move |k| UnitQuaternion::from_axis_angle(&Vector3::y_axis(), quarter(k)));
    let tilts = [1, 3].map(|k| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), quarter(k)));
    faces.chain(tilts).flat_map(move |face| {
        (0..QUARTERS).map(move |k| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), quarter(k)) * face)
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::points_of;
    use super::*;
    use crate::{Finger, Joint, Morphology};

    /// A moving hand half a metre before the camera, fingers bent by up to a radian.
    fn moving(side: Side) -> Vec<HandPose> {
        let frames = (0..30).map(|i| {
            let s = 0.5 - 0.5 * (0.2 * f64::from(i)).cos();
            let mut pose = HandPose::neutral(side);
            pose.rotation = UnitQuaternion::from_euler_angles(0.5 * s - 0.2, 0.9 * s, 0.4 - s);
            pose.translation = Vector3::new(0.05 - 0.1 * s, -0.05, -0.5 - 0.1 * s);
            for finger in Finger::LONG {
                pose.set(finger.base_flexion(), 0.8 * s);
                pose.set(finger.middle_flexion(), s);
                pose.set(finger.end_flexion(), 0.6 * s);
            }
            pose
        });
        frames.collect()
    }

    #[test]
    fn lines_of_sight_give_the_hand_back() {
        let morphology = Morphology::average(0.19);
        for side in [Side::Left, Side::Right] {
            let mut solver = PoseSolver::new(&morphology, side, super::super::SolverOptions::default());
            for (i, pose) in moving(side).into_iter().enumerate() {
                let points = points_of(&morphology, &pose);
                // Anywhere on the lines.
                let seen = points.map(|p| p.map(|p| p * (0.7 / -p.z)));
                let fit = solver.solve_seen(&seen, None).unwrap();
                assert!(fit.mean_distance < 5e-4, "{i}: {fit:?}");
                let turned = fit.pose.rotation.angle_to(&pose.rotation).to_degrees();
                assert!(turned < 4.0, "{side:?} {i}: {turned}°");
                assert!((fit.pose.translation - pose.translation).norm() < 0.02, "{i}");
            }
        }
    }

    #[test]
    fn depths_of_any_scale_are_a_start() {
        let morphology = Morphology::average(0.19);
        for pose in moving(Side::Left).into_iter().skip(7).step_by(6) {
            let options = super::super::SolverOptions { twists: false, ..Default::default() };
            let mut solver = PoseSolver::new(&morphology, Side::Left, options);
            let points = points_of(&morphology, &pose);
            let lifted = points.map(|p| p.map(|p| Point3::from((p - points[0].unwrap()) * 700.0)));
            let fit = solver.solve_seen(&points, Some(&lifted)).unwrap();
            assert!(fit.mean_distance < 3e-4, "{fit:?}");
            assert!(fit.pose.rotation.angle_to(&pose.rotation).to_degrees() < 4.0);
        }
    }

    #[test]
    fn too_little_is_refused() {
        let mut solver = PoseSolver::new(&Morphology::default(), Side::Right, Default::default());
        let mut seen = [None; Joint::COUNT];
        seen[0] = Some(Point3::new(0.0, 0.0, -1.0));
        assert_eq!(solver.solve_seen(&seen, None), Err(LandmarkError::TooFew { seen: 1, needed: 4 }));
        let everywhere = [Some(Point3::new(0.0, 0.0, -1.0)); Joint::COUNT];
        // All joints on one line: some pose or an error, no panic.
        let _ = solver.solve_seen(&everywhere, None);
    }
}
