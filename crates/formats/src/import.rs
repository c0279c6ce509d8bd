//! Poses from other trackers' joint positions.

use std::collections::VecDeque;

use nalgebra::Point3;

use super::landmarks::LandmarkClip;
use handcast_hand::landmarks::{
    JointPoints, LANDMARKS_21, LandmarkError, PoseSolver, SideTrial, SolverOptions, hand_length, measure,
    tell_side,
};
use handcast_hand::smooth::{PoseSmoother, SmoothOptions};
use handcast_hand::{HandPose, Joint, Morphology, PoseClip, PoseHeader, Side, TimedPose};

/// Hand length given to a recording without a unit, metres: the population mean.
pub const MEAN_HAND_LENGTH: f64 = 0.189;

/// How to import.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportOptions {
    /// Left or right; by default what the source says, or else what fits better.
    pub side: Option<Side>,
    /// The hand's sizes; by default measured from the recording.
    pub morphology: Option<Morphology>,
    /// The hand's length in metres, which sets the scale; by default the source's unit does, or else
    /// [`MEAN_HAND_LENGTH`].
    pub hand_length: Option<f64>,
    /// What the solver may vary; palm bends are switched on by sources that show the metacarpals.
    pub solver: SolverOptions,
    /// Longest time without a hand that is bridged, seconds from the last pose to the next.
    pub max_gap: f64,
    /// Smooths the poses found; the distances reported are those before.
    pub smooth: Option<SmoothOptions>,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            side: None,
            morphology: None,
            hand_length: None,
            solver: SolverOptions::default(),
            max_gap: 0.25,
            smooth: None,
        }
    }
}

/// What an import found.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportReport {
    /// The hand.
    pub side: Side,
    /// The trial that told the side, when the source did not say.
    pub trial: Option<SideTrial>,
    /// Metres in one unit of the source.
    pub metres: f64,
    /// Frames with a pose found from their own points.
    pub solved: usize,
    /// Frames whose pose lies between their neighbours', in gaps of at most `max_gap`.
    pub bridged: usize,
    /// Frames without a pose.
    pub lost: usize,
    /// Points missing in frames that were solved all the same.
    pub missing_points: usize,
    /// Mean over the solved frames of the mean distance of points and joints, metres.
    pub mean_distance: f64,
    /// Largest distance of a point from its joint, metres.
    pub max_distance: f64,
}

impl ImportReport {
    /// Both hands of a recording together; side and trial are those of the first.
    #[must_use]
    pub fn with(self, other: &Self) -> Self {
        let solved = self.solved + other.solved;
        let sum = self.mean_distance * self.solved as f64 + other.mean_distance * other.solved as f64;
        Self {
            solved,
            bridged: self.bridged + other.bridged,
            lost: self.lost + other.lost,
            missing_points: self.missing_points + other.missing_points,
            mean_distance: sum / solved.max(1) as f64,
            max_distance: self.max_distance.max(other.max_distance),
            ..self
        }
    }
}

/// Finds the poses of a recording. Bridged frames are valid and have confidence 0; frames of longer gaps
/// are not valid and repeat the last pose.
///
/// # Errors
/// [`LandmarkError`] when the recording never shows a whole palm or its sizes are not those of a hand.
pub fn import(
    clip: &LandmarkClip,
    options: &ImportOptions,
) -> Result<(PoseClip, ImportReport), LandmarkError> {
    let mut frames: Vec<JointPoints> = clip.frames.iter().map(|f| f.points).collect();
    let metres = scale(clip, options, &frames).ok_or(LandmarkError::NoPalm)?;
    for point in frames.iter_mut().flatten().flatten() {
        *point = Point3::from(point.coords * metres);
    }
    let known = options.side.or(clip.side);
    let trial = match known {
        Some(_) => None,
        None => Some(tell_side(&frames)?),
    };
    let side = known.or(trial.map(|t| t.side())).unwrap_or(Side::Right);
    let morphology = match &options.morphology {
        Some(m) => m.clone(),
        None => measure(&frames, side)?,
    };
    let mut solver_options = options.solver.clone();
    solver_options.palm |= frames.iter().any(|f| f[Joint::PinkyMetacarpal.index()].is_some());
    let mut solver = PoseSolver::new(&morphology, side, solver_options);

    let mut report = ImportReport {
        side,
        trial,
        metres,
        solved: 0,
        bridged: 0,
        lost: 0,
        missing_points: 0,
        mean_distance: 0.0,
        max_distance: 0.0,
    };
    let mut smoother = options.smooth.map(PoseSmoother::new);
    let mut out: Vec<TimedPose> = Vec::with_capacity(frames.len());
    let mut last: Option<(f64, HandPose)> = None;
    let mut gap: VecDeque<f64> = VecDeque::new();
    for (points, frame) in frames.iter().zip(&clip.frames) {
        let Ok(fit) = solver.solve(points) else {
            gap.push_back(frame.time);
            continue;
        };
        report.solved += 1;
        let expected = if clip.points_per_frame == 21 { LANDMARKS_21.len() } else { points.len() };
        report.missing_points += expected - fit.seen;
        report.mean_distance += fit.mean_distance;
        report.max_distance = report.max_distance.max(fit.max_distance);
        let pose = match &mut smoother {
            Some(smoother) => {
                if last.as_ref().is_some_and(|(t, _)| frame.time - t > options.max_gap) {
                    smoother.reset();
                }
                smoother.next(frame.time, Some(&fit.pose)).unwrap_or(fit.pose)
            }
            None => fit.pose,
        };
        close_gap(&mut gap, last.as_ref(), Some((frame.time, &pose)), side, options, &mut out, &mut report);
        out.push(TimedPose::new(frame.time, pose.clone()));
        last = Some((frame.time, pose));
    }
    close_gap(&mut gap, last.as_ref(), None, side, options, &mut out, &mut report);
    report.mean_distance /= report.solved.max(1) as f64;
    let mut header = PoseHeader::one(side, Some(morphology), clip.rate);
    header.made_by.clone_from(&clip.made_by);
    Ok((PoseClip { header, frames: out }, report))
}

fn scale(clip: &LandmarkClip, options: &ImportOptions, frames: &[JointPoints]) -> Option<f64> {
    if let Some(length) = options.hand_length {
        return Some(length / hand_length(frames)?);
    }
    if let Some(metres) = clip.metres {
        return Some(metres);
    }
    let length = options.morphology.as_ref().map_or(MEAN_HAND_LENGTH, |m| m.hand_length);
    Some(length / hand_length(frames)?)
}

/// Fills the frames without a pose between two that have one.
fn close_gap(
    gap: &mut VecDeque<f64>,
    before: Option<&(f64, HandPose)>,
    after: Option<(f64, &HandPose)>,
    side: Side,
    options: &ImportOptions,
    out: &mut Vec<TimedPose>,
    report: &mut ImportReport,
) {
    for time in gap.drain(..) {
        match (before, after) {
            (Some((t0, a)), Some((t1, b))) if t1 - t0 <= options.max_gap => {
                let pose = a.interpolated(b, (time - t0) / (t1 - t0));
                out.push(TimedPose { confidence: Some(0.0), ..TimedPose::new(time, pose) });
                report.bridged += 1;
            }
            _ => {
                let pose = before.map_or_else(|| HandPose::neutral(side), |(_, pose)| pose.clone());
                out.push(TimedPose { valid: false, ..TimedPose::new(time, pose) });
                report.lost += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::landmarks::LandmarkFrame;
    use handcast_hand::{Finger, Skeleton};

    /// A closing hand, 40 frames at 20 a second, in units of a tenth of a millimetre.
    fn clip(hide: impl Fn(usize, Joint) -> bool) -> LandmarkClip {
        let skeleton = Skeleton::new(&Morphology::average(0.18), Side::Left);
        let frames = (0..40).map(|i| {
            let mut pose = HandPose::neutral(Side::Left);
            for finger in Finger::LONG {
                pose.set(finger.base_flexion(), 0.03 * i as f64);
                pose.set(finger.middle_flexion(), 0.03 * i as f64);
            }
            let joints = skeleton.frames(&pose);
            let mut points = [None; 25];
            for joint in LANDMARKS_21.into_iter().filter(|j| !hide(i, *j)) {
                points[joint.index()] = Some(Point3::from(joints.position(joint).coords * 1e4));
            }
            LandmarkFrame { time: i as f64 / 20.0, names: Vec::new(), points, image: None }
        });
        LandmarkClip { points_per_frame: 21, frames: frames.collect(), ..LandmarkClip::default() }
    }

    #[test]
    fn side_scale_and_gaps_are_found() {
        // Frames 5-7 (a gap of 0.2 s) and 20-29 are lost; the index tip is missing in two more.
        let source = clip(|i, joint| {
            (5..8).contains(&i) || (20..30).contains(&i) || (matches!(i, 10 | 11) && joint == Joint::IndexTip)
        });
        let (poses, report) = import(&source, &ImportOptions::default()).unwrap();
        assert_eq!(report.side, Side::Left);
        assert!((report.metres - 1e-4 * MEAN_HAND_LENGTH / 0.18).abs() < 1e-6);
        assert_eq!((report.solved, report.bridged, report.lost, report.missing_points), (27, 3, 10, 2));
        assert!(report.max_distance < 1e-3, "{report:?}");
        assert_eq!(poses.frames.len(), 40);
        for (i, frame) in poses.frames.iter().enumerate() {
            assert_eq!(frame.valid, !(20..30).contains(&i));
            assert_eq!(frame.confidence.is_some(), (5..8).contains(&i));
            let expected = match i {
                20..30 => continue,
                _ => 0.03 * i as f64,
            };
            assert!((frame.pose.angle(Finger::Ring.middle_flexion()) - expected).abs() < 0.02, "{i}");
        }
    }

    #[test]
    fn the_hand_length_sets_the_scale() {
        let options = ImportOptions { hand_length: Some(0.2), ..ImportOptions::default() };
        let (poses, _) = import(&clip(|_, _| false), &options).unwrap();
        let length = poses.header.hands[0].morphology.as_ref().unwrap().hand_length;
        assert!((length - 0.2).abs() < 0.001);
    }

    #[test]
    fn recordings_without_a_palm_are_refused() {
        let source = clip(|_, joint| joint == Joint::RingProximal);
        assert_eq!(import(&source, &ImportOptions::default()).unwrap_err(), LandmarkError::NoPalm);
        let mut collapsed = clip(|_, _| false);
        for point in collapsed.frames.iter_mut().flat_map(|f| &mut f.points).flatten() {
            *point = Point3::new(1.0, 2.0, 3.0);
        }
        import(&collapsed, &ImportOptions::default()).unwrap_err();
        collapsed.metres = Some(1.0);
        import(&collapsed, &ImportOptions { side: Some(Side::Left), ..Default::default() }).unwrap_err();
    }
}
