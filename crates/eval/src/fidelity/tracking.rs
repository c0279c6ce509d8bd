//! What a tracker made of a sequence whose poses are known.

use std::fmt;

use serde::Serialize;

use super::summary::{mean, percentile};
use handcast_hand::{Finger, HandPose, Joint, JointAngle, Morphology, Side, Skeleton};

/// A degree of freedom whose truth covers more than this in a sequence is a moving one, degrees or mm.
const MOVING: f64 = 10.0;

/// One frame: what is true and what was found.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// The true pose; `None` on clips without truth.
    pub truth: Option<&'a HandPose>,
    /// Whether there was a hand to be seen; `None` where that is not known, and the frame counts neither as one with a hand
    /// nor as one without.
    pub visible: Option<bool>,
    /// The pose found; of a lost frame the one that is shown instead.
    pub found: &'a HandPose,
    /// Whether the tracker says it found the hand.
    pub valid: bool,
    /// Intersection over union of model and silhouette.
    pub iou: f64,
    /// How far the tracker says it can be trusted, 0 to 1.
    pub confidence: f64,
    /// Evaluations of the functional.
    pub evaluations: usize,
    /// Whether the search was started again in this frame.
    pub restarted: bool,
    /// Seconds it took.
    pub seconds: f64,
}

/// The errors of one degree of freedom over the frames in which the hand was visible.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DofError {
    /// A joint angle's name; `x`, `y`, `z`; `turn_x`, `turn_y`, `turn_z` (rotation vector, camera axes).
    pub name: String,
    /// `deg` or `mm`.
    pub unit: &'static str,
    /// Largest minus smallest true value.
    pub range: f64,
    /// Whether it moves in this sequence: its range exceeds 10 degrees or 10 mm.
    pub moving: bool,
    /// Mean magnitude of the error.
    pub mean: f64,
    /// 95th percentile of the magnitude.
    pub p95: f64,
    /// Largest magnitude.
    pub max: f64,
}

/// Everything measured on one sequence. Lost frames count with the pose that is shown in their place, so
/// that giving up does not pay.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrackingReport {
    /// Frames of the sequence.
    pub frames: usize,
    /// Frames with a true pose that was compared.
    pub truth_frames: usize,
    /// Frames in which there was a hand.
    pub visible_frames: usize,
    /// Frames in which the hand was there and was not found.
    pub lost_frames: usize,
    /// Frames in which a hand was found and there was none.
    pub false_frames: usize,
    /// The joint angles that are measured ([`TrackingMeter::with_angles`]), then position and rotation; empty without truth.
    pub dofs: Vec<DofError>,
    /// Mean over the joint angles, degrees.
    pub angle_mean_deg: Option<f64>,
    /// 95th percentile over all joint angles of all frames, degrees.
    pub angle_p95_deg: Option<f64>,
    /// Mean over the joint angles and rotations that move in the sequence, degrees.
    pub moving_mean_deg: Option<f64>,
    /// Mean over the positions that move in the sequence, millimetres.
    pub moving_mean_mm: Option<f64>,
    /// Mean distance of the five fingertips from where they are, wrist on wrist, millimetres.
    pub fingertip_mean_mm: Option<f64>,
    /// 95th percentile over all fingertips of all frames, millimetres.
    pub fingertip_p95_mm: Option<f64>,
    /// Mean intersection over union, frames in which the hand was tracked, but for those known to be without one.
    pub iou_mean: f64,
    /// Smallest intersection over union, the same frames.
    pub iou_min: f64,
    /// Evaluations of the functional, mean of all frames.
    pub evaluations_mean: f64,
    /// Most evaluations in a frame.
    pub evaluations_max: usize,
    /// Frames in which the search was started again.
    pub restarts: usize,
    /// Mean time of a frame, milliseconds.
    pub ms_per_frame: f64,
    /// Confidence and mean error of the joint angles (degrees) of each visible frame; empty without truth.
    #[serde(skip)]
    pub sureness: Vec<(f64, f64)>,
}

/// Collects observations of one sequence.
#[derive(Clone, Debug)]
pub struct TrackingMeter {
    skeleton: Skeleton,
    angles: Vec<JointAngle>,
    dofs: Vec<Samples>,
    tips: Vec<f64>,
    ious: Vec<f64>,
    evaluations: Vec<usize>,
    seconds: f64,
    visible: usize,
    lost: usize,
    ghosts: usize,
    restarts: usize,
    first: Option<HandPose>,
    sureness: Vec<(f64, f64)>,
}

#[derive(Clone, Debug)]
struct Samples {
    name: String,
    unit: &'static str,
    low: f64,
    high: f64,
    errors: Vec<f64>,
}

impl Samples {
    fn new(name: impl Into<String>, unit: &'static str) -> Self {
        Self { name: name.into(), unit, low: f64::MAX, high: f64::MIN, errors: Vec::new() }
    }

    fn add(&mut self, truth: f64, error: f64) {
        self.low = self.low.min(truth);
        self.high = self.high.max(truth);
        self.errors.push(error.abs());
    }

    fn error(&self) -> DofError {
        let range = (self.high - self.low).max(0.0);
        DofError {
            name: self.name.clone(),
            unit: self.unit,
            range,
            moving: range > MOVING,
            mean: mean(&self.errors),
            p95: percentile(&self.errors, 0.95),
            max: self.errors.iter().copied().fold(0.0, f64::max),
        }
    }
}

/// The joint angles a tracker moves: the free ones and those tied to them.
pub(super) fn tracked_angles() -> impl Iterator<Item = JointAngle> {
    Finger::ALL
        .into_iter()
        .flat_map(|f| [f.base_flexion(), f.abduction(), f.middle_flexion(), f.end_flexion()])
}

impl TrackingMeter {
    /// A meter for poses of this hand, of the 20 joint angles that a tracker moves.
    pub fn new(morphology: &Morphology, side: Side) -> Self {
        Self::with_angles(morphology, side, tracked_angles().collect())
    }

    /// A meter for poses of this hand, of these joint angles.
    pub fn with_angles(morphology: &Morphology, side: Side, measured: Vec<JointAngle>) -> Self {
        let angles = measured.iter().map(|a| Samples::new(a.name(), "deg"));
        let position = ["x", "y", "z"].map(|name| Samples::new(name, "mm"));
        let rotation = ["turn_x", "turn_y", "turn_z"].map(|name| Samples::new(name, "deg"));
        Self {
            skeleton: Skeleton::new(morphology, side),
            dofs: angles.chain(position).chain(rotation).collect(),
            angles: measured,
            tips: Vec::new(),
            ious: Vec::new(),
            evaluations: Vec::new(),
            seconds: 0.0,
            visible: 0,
            lost: 0,
            ghosts: 0,
            restarts: 0,
            first: None,
            sureness: Vec::new(),
        }
    }

    /// Adds a frame.
    pub fn add(&mut self, seen: &Observation) {
        self.evaluations.push(seen.evaluations);
        self.seconds += seen.seconds;
        self.restarts += usize::from(seen.restarted);
        if seen.visible == Some(false) {
            self.ghosts += usize::from(seen.valid);
            return;
        }
        if seen.visible == Some(true) {
            self.visible += 1;
            self.lost += usize::from(!seen.valid);
        }
        if seen.valid {
            self.ious.push(seen.iou);
        }
        if let Some(truth) = seen.truth {
            self.compare(truth, seen.found);
            let off = |a: JointAngle| (seen.found.angle(a) - truth.angle(a)).to_degrees().abs();
            let errors: Vec<f64> = self.angles.iter().copied().map(off).collect();
            self.sureness.push((seen.confidence, mean(&errors)));
        }
    }

    fn compare(&mut self, truth: &HandPose, found: &HandPose) {
        let first = self.first.get_or_insert_with(|| truth.clone());
        let off = (found.rotation * truth.rotation.inverse()).scaled_axis();
        let turned = (truth.rotation * first.rotation.inverse()).scaled_axis();
        let apart = found.translation - truth.translation;
        let angles = self.angles.iter().map(|&a| {
            let (t, f) = (truth.angle(a), found.angle(a));
            (t.to_degrees(), (f - t).to_degrees())
        });
        let position = (0..3).map(|k| (1e3 * truth.translation[k], 1e3 * apart[k]));
        let rotation = (0..3).map(|k| (turned[k].to_degrees(), off[k].to_degrees()));
        for (dof, (value, error)) in self.dofs.iter_mut().zip(angles.chain(position).chain(rotation)) {
            dof.add(value, error);
        }
        let (a, b) = (self.skeleton.local_frames(&truth.angles), self.skeleton.local_frames(&found.angles));
        self.tips.extend(
            Finger::ALL.map(|f| 1e3 * (a.position(Joint::tip(f)) - b.position(Joint::tip(f))).norm()),
        );
    }

    /// The report so far.
    pub fn report(&self) -> TrackingReport {
        let known = self.first.is_some();
        let dofs: Vec<DofError> =
            if known { self.dofs.iter().map(Samples::error).collect() } else { Vec::new() };
        let joints = self.angles.len();
        let angle_errors: Vec<f64> =
            self.dofs.iter().take(joints).flat_map(|d| d.errors.iter().copied()).collect();
        let moving = |unit: &str| {
            let chosen: Vec<f64> =
                dofs.iter().filter(|d| d.moving && d.unit == unit).map(|d| d.mean).collect();
            (!chosen.is_empty()).then(|| mean(&chosen))
        };
        let frames = self.evaluations.len();
        TrackingReport {
            frames,
            truth_frames: self.sureness.len(),
            visible_frames: self.visible,
            lost_frames: self.lost,
            false_frames: self.ghosts,
            angle_mean_deg: known.then(|| mean(&angle_errors)),
            angle_p95_deg: known.then(|| percentile(&angle_errors, 0.95)),
            moving_mean_deg: moving("deg"),
            moving_mean_mm: moving("mm"),
            fingertip_mean_mm: known.then(|| mean(&self.tips)),
            fingertip_p95_mm: known.then(|| percentile(&self.tips, 0.95)),
            iou_mean: mean(&self.ious),
            iou_min: if self.ious.is_empty() { 0.0 } else { self.ious.iter().copied().fold(1.0, f64::min) },
            evaluations_mean: self.evaluations.iter().sum::<usize>() as f64 / frames.max(1) as f64,
            evaluations_max: self.evaluations.iter().copied().max().unwrap_or(0),
            restarts: self.restarts,
            ms_per_frame: 1e3 * self.seconds / frames.max(1) as f64,
            sureness: self.sureness.clone(),
            dofs,
        }
    }
}

impl fmt::Display for TrackingReport {
    /// A summary line, then a line for each degree of freedom.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "{} frames ({} with a hand, {} lost, {} found falsely); IoU mean {:.3}, least {:.3}; \
             {:.0} evaluations a frame (at most {}), {} restarts, {:.2} ms a frame",
            self.frames,
            self.visible_frames,
            self.lost_frames,
            self.false_frames,
            self.iou_mean,
            self.iou_min,
            self.evaluations_mean,
            self.evaluations_max,
            self.restarts,
            self.ms_per_frame
        )?;
        if let (Some(mean), Some(p95), Some(tip), Some(tip95)) =
            (self.angle_mean_deg, self.angle_p95_deg, self.fingertip_mean_mm, self.fingertip_p95_mm)
        {
            writeln!(
                f,
                "joint angles off by {mean:.2} deg (95 %: {p95:.2}); fingertips wrist on wrist by {tip:.2} mm \
                 (95 %: {tip95:.2})"
            )?;
            writeln!(f, "{:<17} {:>4} {:>8} {:>8} {:>8} {:>8}", "", "", "range", "mean", "95 %", "max")?;
        }
        for d in &self.dofs {
            let mark = if d.moving { " moving" } else { "" };
            let (range, mean, p95, max) = (d.range, d.mean, d.p95, d.max);
            writeln!(f, "{:<17} {:>4} {range:>8.2} {mean:>8.2} {p95:>8.2} {max:>8.2}{mark}", d.name, d.unit)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::Domain;

    fn seen<'a>(truth: &'a HandPose, found: &'a HandPose) -> Observation<'a> {
        Observation {
            truth: Some(truth),
            visible: Some(true),
            found,
            valid: true,
            iou: 0.9,
            confidence: 0.7,
            evaluations: 60,
            restarted: false,
            seconds: 0.002,
        }
    }

    #[test]
    fn errors_go_to_their_degree_of_freedom() {
        let mut meter = TrackingMeter::new(&Morphology::default(), Side::Right);
        for i in 0..20 {
            let truth =
                HandPose::neutral(Side::Right).with_degrees(JointAngle::Index2Flexion, 2.0 * f64::from(i));
            let mut found = truth.clone();
            found.set(
                JointAngle::Index2Flexion,
                truth.angle(JointAngle::Index2Flexion) + f64::from(i).to_radians(),
            );
            found.translation.y = 0.004;
            meter.add(&seen(&truth, &found));
        }
        let report = meter.report();
        let dof = |name: &str| report.dofs.iter().find(|d| d.name == name).unwrap();
        let index = dof("index2_flexion");
        assert!(index.moving && (index.mean - 9.5).abs() < 1e-9 && (index.p95 - 18.0).abs() < 1e-9);
        assert!((index.range - 38.0).abs() < 1e-9 && (index.max - 19.0).abs() < 1e-9);
        assert!(!dof("y").moving && (dof("y").mean - 4.0).abs() < 1e-9);
        assert_eq!(dof("turn_z").mean, 0.0);
        assert!((report.moving_mean_deg.unwrap() - 9.5).abs() < 1e-9);
        assert_eq!(report.moving_mean_mm, None);
        assert!((report.angle_mean_deg.unwrap() - 9.5 / 20.0).abs() < 1e-9);
        assert!((report.ms_per_frame - 2.0).abs() < 1e-9);
        assert_eq!(report.dofs.len(), Domain::FREE.len() + 5 + 6, "20 angles and 6 global");
        assert!(report.to_string().contains("index2_flexion"));
    }

    #[test]
    fn lost_and_false_frames_are_counted_and_lost_ones_still_compared() {
        let mut meter = TrackingMeter::new(&Morphology::default(), Side::Left);
        let truth = HandPose::neutral(Side::Left).with_degrees(JointAngle::Ring1Flexion, 30.0);
        let found = HandPose::neutral(Side::Left);
        meter.add(&Observation { valid: false, ..seen(&truth, &found) });
        meter.add(&Observation { visible: Some(false), ..seen(&truth, &found) });
        meter.add(&Observation { visible: Some(false), valid: false, ..seen(&truth, &found) });
        let report = meter.report();
        assert_eq!((report.frames, report.visible_frames), (3, 1));
        assert_eq!((report.lost_frames, report.false_frames), (1, 1));
        assert!((report.angle_mean_deg.unwrap() - 1.5).abs() < 1e-9);
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["lost_frames"], 1);
        // Where nobody knows, nothing is counted but the frame.
        meter.add(&Observation { truth: None, visible: None, valid: false, ..seen(&truth, &found) });
        let report = meter.report();
        assert_eq!((report.frames, report.truth_frames, report.visible_frames), (4, 1, 1));
        assert_eq!((report.lost_frames, report.false_frames), (1, 1));
    }

    #[test]
    fn without_truth_there_are_no_angle_errors() {
        let mut meter = TrackingMeter::new(&Morphology::default(), Side::Left);
        let found = HandPose::neutral(Side::Left);
        meter.add(&Observation { truth: None, ..seen(&found, &found) });
        let report = meter.report();
        assert!(report.dofs.is_empty() && report.angle_mean_deg.is_none());
        assert!((report.iou_mean - 0.9).abs() < 1e-12);
    }
}
