//! Everything measured of one clip or motion.

use std::fmt;

use serde::Serialize;

use super::clip::TrackingSeam;
use super::latency::{StageLatency, of_link};
use super::round_trip::{FidelityError, Promise, RoundTrip, Seam, round_trip};
use super::stream::{RateCurve, StreamAccount, account, rate_curve};
use super::symmetry::{Symmetry, symmetry};
use handcast_codec::mapping::Profile;
use handcast_fba::FrameRate;
use handcast_fba::plan::PlanOptions;
use handcast_formats::import::ImportReport;
use handcast_hand::{MAX_GAP, PoseClip};

/// Degrees of freedom of a hand in space, behind its joint angles in [`TrackingReport::dofs`](super::TrackingReport::dofs).
const GLOBAL_DOFS: usize = 6;

/// What is measured, and with which settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FidelityOptions {
    /// How position and rotation of the hand travel.
    pub profile: Profile,
    /// The encoder's settings.
    pub plan: PlanOptions,
    /// Seconds up to which gaps are bridged; of 0 none.
    pub max_gap: f64,
    /// Whether the rate is measured over the error, which codes the clip two dozen times.
    pub curve: bool,
    /// Whether the mirrored motion is measured, too.
    pub mirror: bool,
}

impl Default for FidelityOptions {
    fn default() -> Self {
        Self {
            profile: Profile::Hand,
            plan: PlanOptions::default(),
            max_gap: MAX_GAP,
            curve: true,
            mirror: true,
        }
    }
}

/// How well a recording's joint positions are met by the poses found for them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ImportSeam {
    /// Frames with a pose found from their own points.
    pub solved: usize,
    /// Frames in short gaps, between two that were.
    pub bridged: usize,
    /// Frames without a pose.
    pub lost: usize,
    /// Mean distance of points and joints, millimetres.
    pub mean_mm: f64,
    /// Largest distance of a point from its joint, millimetres.
    pub max_mm: f64,
}

impl From<&ImportReport> for ImportSeam {
    fn from(report: &ImportReport) -> Self {
        Self {
            solved: report.solved,
            bridged: report.bridged,
            lost: report.lost,
            mean_mm: 1e3 * report.mean_distance,
            max_mm: 1e3 * report.max_distance,
        }
    }
}

/// The facts of a fidelity report; its JSON is this, with these names.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FidelityReport {
    /// What was measured.
    pub source: String,
    /// Version of the program.
    pub made_by: String,
    /// The hands in it.
    pub hands: Vec<&'static str>,
    /// Instants.
    pub frames: usize,
    /// Frames per second.
    pub rate: f64,
    /// Pixels to poses, of clips.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracking: Option<TrackingSeam>,
    /// Joint positions to poses, of recordings by other trackers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub import: Option<ImportSeam>,
    /// From poses through the stream to glTF, seam by seam; the last is the whole way.
    pub seams: Vec<Seam>,
    /// What the stream costs.
    pub stream: StreamAccount,
    /// Rate over error, if measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curve: Option<RateCurve>,
    /// Time of each stage for a frame.
    pub latency: Vec<StageLatency>,
    /// Left against right, if measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub symmetry: Option<Symmetry>,
}

impl FidelityReport {
    /// The seam of this name.
    pub fn seam(&self, name: &str) -> Option<&Seam> {
        self.seams.iter().find(|s| s.name == name)
    }

    /// Whether every seam keeps its promise.
    pub fn all_kept(&self) -> bool {
        self.seams.iter().all(|s| s.kept)
    }
}

/// Measures the way of `clip` from poses to glTF. Tracking or import is added by who knows of it, as are its stages'
/// latencies.
///
/// ```
/// use handcast_eval::fidelity::{FidelityOptions, measure};
/// use handcast_hand::{HandPose, JointAngle, PoseClip, PoseHeader, Side, TimedPose};
///
/// let mut clip = PoseClip { header: PoseHeader::one(Side::Right, None, Some(30.0)), frames: Vec::new() };
/// for i in 0..30 {
///     let pose = HandPose::neutral(Side::Right).with_degrees(JointAngle::Index2Flexion, f64::from(i));
///     clip.frames.push(TimedPose::new(f64::from(i) / 30.0, pose));
/// }
/// let (report, _) = measure("a bending finger", &clip, &FidelityOptions::default())?;
/// assert!(report.all_kept());
/// assert!(report.seam("coding").unwrap().rms_deg() <= 0.5);
/// # Ok::<(), handcast_eval::fidelity::FidelityError>(())
/// ```
///
/// # Errors
/// See [`FidelityError`].
pub fn measure(
    source: &str,
    clip: &PoseClip,
    options: &FidelityOptions,
) -> Result<(FidelityReport, RoundTrip), FidelityError> {
    let FidelityOptions { profile, plan, max_gap, .. } = *options;
    let trip = round_trip(clip, profile, &plan, max_gap)?;
    let rate = trip.decoded.rate;
    // The live encoder is told the rate; the planner finds it in the clip.
    let live = PlanOptions { rate: FrameRate::nearest(rate).unwrap_or(plan.rate), ..plan };
    let report = FidelityReport {
        source: source.to_owned(),
        made_by: format!("handcast {}", env!("CARGO_PKG_VERSION")),
        hands: clip.header.hands.iter().map(|h| h.side.name()).collect(),
        frames: trip.encoded.report.frames as usize,
        rate,
        tracking: None,
        import: None,
        seams: trip.seams.clone(),
        stream: account(&trip.encoded, &plan)?,
        curve: if options.curve { Some(rate_curve(clip, profile, &plan, max_gap)?) } else { None },
        latency: of_link(&trip.encoded.clip, profile, &live)?,
        symmetry: if options.mirror { Some(symmetry(clip, profile, &plan, max_gap, &trip)?) } else { None },
    };
    Ok((report, trip))
}

impl fmt::Display for FidelityReport {
    /// A page of text.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { source, frames, stream, .. } = self;
        let rate = (1e3 * self.rate).round() / 1e3;
        writeln!(f, "{source}: {} hand, {frames} frames at {rate} frames/s", self.hands.join(" and "))?;
        if let Some(t) = &self.tracking {
            tell_tracking(t, f)?;
        }
        if let Some(i) = &self.import {
            writeln!(
                f,
                "  import      joints {:.2} mm from the points on average, {:.1} at most",
                i.mean_mm, i.max_mm
            )?;
        }
        for seam in &self.seams {
            let limit = match seam.promise {
                Promise::MaxDeg(limit) => format!("at most {limit:.5}° promised"),
                Promise::RmsDeg(limit) => format!("{limit:.2}° RMS promised"),
                Promise::Nothing => "nothing promised".to_owned(),
            };
            let kept = if seam.kept { "" } else { ", NOT KEPT" };
            let (rms, max, tips) = (seam.rms_deg(), seam.max_deg(), seam.fingertip_max_mm());
            writeln!(
                f,
                "  {:<10}  {rms:.5}° RMS, {max:.5}° at most, fingertips wrist on wrist {tips:.3} mm at most; \
                 {limit}{kept}",
                seam.name
            )?;
        }
        writeln!(
            f,
            "  stream      {} bytes, {:.2} kbit/s, {} planes of which {} I",
            stream.bytes, stream.kbit_per_s, stream.planes, stream.intra_planes
        )?;
        if let Some(s) = &self.symmetry {
            writeln!(
                f,
                "  other hand  {} bytes, {:.5}° RMS; {:.5}° apart at most",
                s.bytes[1], s.rms_deg[1], s.apart_deg
            )?;
        }
        let stages: Vec<String> =
            self.latency.iter().map(|l| format!("{} {:.3} ({:.3})", l.stage, l.mean_ms, l.p95_ms)).collect();
        writeln!(f, "  latency     ms a frame, mean (95 %): {}", stages.join(", "))
    }
}

/// How a clip was tracked, in lines of text.
fn tell_tracking(t: &TrackingSeam, f: &mut fmt::Formatter) -> fmt::Result {
    let r = &t.report;
    write!(f, "  tracking    overlap {:.3} on average, {:.3} at worst", r.iou_mean, r.iou_min)?;
    write!(f, " (frame {}); {} lost", t.worst_overlap.frame, t.lost.len())?;
    if t.starts.is_some() {
        write!(f, ", of them {} of the {} with a hand", r.lost_frames, r.visible_frames)?;
    }
    writeln!(f)?;
    if let Some([clip, truth]) = t.starts {
        write!(f, "  truth       in {} of {} frames", r.truth_frames, r.frames)?;
        if let (Some(mean), Some(p95), Some(tip)) = (r.angle_mean_deg, r.angle_p95_deg, r.fingertip_mean_mm) {
            let angles = r.dofs.len().saturating_sub(GLOBAL_DOFS);
            write!(
                f,
                "; its {angles} joint angles that are not always 0 off by {mean:.2}° (95 %: {p95:.2}°), fingertips \
                 wrist on wrist by {tip:.1} mm"
            )?;
        }
        writeln!(f)?;
        if (clip - truth).abs() > 1e-3 {
            writeln!(
                f,
                "  note: the clip starts at {clip:.3} s, its truth at {truth:.3} s: both are counted from there"
            )?;
        }
    }
    if let Some(m) = &t.mirror {
        write!(f, "  mirrored    overlap {:.3} on average, {} lost", m.iou_mean[1], m.lost[1])?;
        if let Some([_, other]) = m.angle_mean_deg {
            write!(f, "; joint angles off by {other:.2}°")?;
        }
        writeln!(f, "; found {:.2}° apart on average", m.apart_mean_deg)?;
    }
    Ok(())
}
