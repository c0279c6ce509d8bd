//! The seam from pixels to poses: a clip tracked, against true poses where there are any, and in the mirror.

use image::RgbImage;
use serde::Serialize;

use super::round_trip::FidelityError;
use super::summary::{Worst, mean};
use super::symmetry::mirrored;
use super::tracking::tracked_angles;
use super::{Observation, TrackingMeter, TrackingReport, ever_other_than_0};
use handcast_codec::clip_rate;
use handcast_hand::{HandPose, JointAngle, Morphology, PoseClip, Side, TimedPose};
use handcast_media::{ClipInfo, Frame, FrameError, FrameSource};
use handcast_render::draw_overlay;
use handcast_track::pipeline::{ClipOptions, ClipSink, TrackedClip, TrackedFrame, TrackedHand, track_clip};
use handcast_track::{HandModel, ModelState, View};

/// How well a clip was tracked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrackingSeam {
    /// Which hand: of two the one that was found first.
    pub hand: &'static str,
    /// How many hands were found.
    pub hands: usize,
    /// Palm or back.
    pub view: View,
    /// Whether palm or back was assumed.
    pub view_assumed: bool,
    /// The frame in which the open hand was fitted.
    pub open_frame: usize,
    /// Overlap of that fit; none where tracking started from another posture.
    pub fit_iou: Option<f64>,
    /// Numbers of the frames in which the tracker lost the hand, whether it was there or not: `report.lost_frames` counts those
    /// in which it was.
    pub lost: Vec<usize>,
    /// Overlap of model and silhouette (intersection over union) in each frame.
    pub frame_iou: Vec<f64>,
    /// Mean error of the joint angles in each frame, degrees, where the true pose of every frame is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_deg: Option<Vec<f64>>,
    /// Times of the clip's first frame and of the first true pose, seconds: both are counted from there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub starts: Option<[f64; 2]>,
    /// Where the overlap is smallest: 1 minus it.
    pub worst_overlap: Worst,
    /// Where the joint angles are furthest off on average, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub worst_angles: Option<Worst>,
    /// Errors of each degree of freedom, where the true poses are known, of the joint angles that are ever other than 0 in them;
    /// overlap, evaluations, losses.
    pub report: TrackingReport,
    /// The same clip in the mirror, if that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mirror: Option<MirroredTracking>,
}

/// What tracking makes of a clip and of its mirror image: first as it is, then mirrored.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MirroredTracking {
    /// Mean overlap.
    pub iou_mean: [f64; 2],
    /// Smallest overlap.
    pub iou_min: [f64; 2],
    /// Frames lost.
    pub lost: [usize; 2],
    /// Mean error of the joint angles, degrees, where the true poses are known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angle_mean_deg: Option<[f64; 2]>,
    /// Mean difference of the joint angles between the poses found and those found in the mirror, degrees.
    pub apart_mean_deg: f64,
}

/// A frame worth looking at.
#[derive(Clone, Debug)]
pub struct Moment {
    /// Number of the frame.
    pub frame: usize,
    /// Its time, seconds.
    pub time: f64,
    /// How bad it is: mean error of the joint angles in degrees where the true pose is known, else 1 minus the overlap.
    pub badness: f64,
    /// Its overlap.
    pub iou: f64,
    /// The picture with what was seen and what was made of it.
    pub overlay: RgbImage,
}

/// A clip, tracked and measured.
#[derive(Debug)]
pub struct MeasuredClip {
    /// What was tracked.
    pub clip: TrackedClip,
    /// How well.
    pub seam: TrackingSeam,
    /// The worst moments, the worst first.
    pub moments: Vec<Moment>,
}

/// Worst moments kept for a look at them.
const MOMENTS: usize = 4;
/// Seconds two of them are apart at least.
const APART: f64 = 0.8;

/// Tracks a clip and measures how well. `truth` holds the true poses in the camera frame, from the first frame of the
/// clip on; `progress` hears how many frames have been read.
///
/// # Errors
/// [`FidelityError::Clip`].
pub fn measure_clip(
    source: impl FrameSource + 'static,
    masks: Option<Box<dyn FrameSource>>,
    options: &ClipOptions,
    truth: Option<&PoseClip>,
    progress: &mut dyn FnMut(usize),
) -> Result<MeasuredClip, FidelityError> {
    let mut watcher = Watcher { truth, moments: Vec::new(), progress };
    let clip = track_clip(source, masks, options, &mut watcher)?;
    let moments = watcher.moments;
    let seam = seam_of(&clip, truth)?;
    Ok(MeasuredClip { clip, seam, moments })
}

/// Tracks the mirror image of a clip that has been measured, told which hand it is, and compares.
///
/// # Errors
/// [`FidelityError::Clip`].
pub fn measure_mirrored(
    source: impl FrameSource + 'static,
    masks: Option<Box<dyn FrameSource>>,
    options: &ClipOptions,
    truth: Option<&PoseClip>,
    measured: &MeasuredClip,
) -> Result<MirroredTracking, FidelityError> {
    let mut options = options.clone();
    let hand = first(&measured.clip)?;
    options.side = Some(hand.start.side.other());
    options.view = Some(hand.start.view);
    let truth = truth.map(mirrored);
    let masks = masks.map(|masks| Box::new(Mirror { source: masks }) as Box<dyn FrameSource>);
    let mut nothing = |_| {};
    let mut watcher = Watcher { truth: None, moments: Vec::new(), progress: &mut nothing };
    let other = track_clip(Mirror { source }, masks, &options, &mut watcher)?;
    let seam = seam_of(&other, truth.as_ref())?;
    let one = &measured.seam.report;
    let both = hand.frames.iter().zip(&first(&other)?.frames);
    let apart: Vec<f64> = both
        .map(|(a, b)| (&a.tracked, &b.tracked))
        .filter(|(a, b)| a.valid && b.valid)
        .map(|(a, b)| {
            let off = a.state.free.iter().zip(&b.state.free).map(|(a, b)| (a - b).abs().to_degrees());
            off.sum::<f64>() / a.state.free.len() as f64
        })
        .collect();
    Ok(MirroredTracking {
        iou_mean: [one.iou_mean, seam.report.iou_mean],
        iou_min: [one.iou_min, seam.report.iou_min],
        lost: [measured.seam.lost.len(), seam.lost.len()],
        angle_mean_deg: one.angle_mean_deg.zip(seam.report.angle_mean_deg).map(|(a, b)| [a, b]),
        apart_mean_deg: mean(&apart),
    })
}

/// A clip in the mirror.
struct Mirror<S> {
    source: S,
}

impl<S: FrameSource> FrameSource for Mirror<S> {
    fn info(&self) -> &ClipInfo {
        self.source.info()
    }

    fn set_max_side(&mut self, side: u32) {
        self.source.set_max_side(side);
    }

    fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let mut frame = self.source.next_frame()?;
        if let Some(frame) = &mut frame {
            image::imageops::flip_horizontal_in_place(&mut frame.image);
        }
        Ok(frame)
    }

    fn shortfall(&self) -> Option<String> {
        self.source.shortfall()
    }
}

/// What is known of a hand at an instant.
enum Known<'a> {
    /// How it is.
    Pose(&'a HandPose),
    /// That it is not there.
    Absent,
    /// Nothing.
    Nothing,
}

/// What the truth says at a time from the first frame on.
fn known_at(truth: Option<&PoseClip>, time: f64, side: Side) -> Known<'_> {
    let Some((truth, first)) = truth.and_then(|truth| Some((truth, truth.frames.first()?))) else {
        return Known::Nothing;
    };
    let off = |f: &TimedPose| (f.time - first.time - time).abs();
    let nearest = truth.of(side).min_by(|a, b| off(a).total_cmp(&off(b)));
    match nearest.filter(|f| off(f) <= 0.5 / clip_rate(truth) + 1e-6) {
        Some(pose) if pose.valid => Known::Pose(&pose.pose),
        Some(_) => Known::Absent,
        None => Known::Nothing,
    }
}

/// The joint angles that are measured: those that are ever other than 0 in the truth, without one those a tracker moves.
fn measured_angles(truth: Option<&PoseClip>, side: Side) -> Vec<JointAngle> {
    truth.map_or_else(|| tracked_angles().collect(), |truth| ever_other_than_0(truth, side))
}

/// Mean error of joint angles, degrees.
fn angles_off(angles: &[JointAngle], truth: &HandPose, found: &HandPose) -> f64 {
    let off: Vec<f64> =
        angles.iter().map(|&a| (truth.angle(a) - found.angle(a)).abs().to_degrees()).collect();
    mean(&off)
}

/// The hand that is measured.
fn first(clip: &TrackedClip) -> Result<&TrackedHand, FidelityError> {
    clip.hands.first().ok_or(FidelityError::Clip(handcast_track::pipeline::ClipError::Empty))
}

fn seam_of(clip: &TrackedClip, truth: Option<&PoseClip>) -> Result<TrackingSeam, FidelityError> {
    let hand = first(clip)?;
    let start = &hand.start;
    let side = start.side;
    let known = truth.and_then(|t| t.header.hand(side)).and_then(|h| h.morphology.clone());
    let morphology = known.unwrap_or_else(|| start.morphology.clone());
    let angles = measured_angles(truth, side);
    let mut meter = TrackingMeter::with_angles(&morphology, side, angles.clone());
    let begun = clip.times.first().copied().unwrap_or_default();
    let mut picture = InPicture::new(&morphology, hand);
    let (mut frame_iou, mut frame_deg) = (Vec::new(), Vec::new());
    let (mut worst_overlap, mut worst_angles) = (Worst::default(), Worst::default());
    for (i, (time, frame)) in clip.times.iter().zip(&hand.frames).enumerate() {
        let (time, tracked) = (time - begun, &frame.tracked);
        let found = frame.pose.clone();
        let known = known_at(truth, time, side);
        let pose = if let Known::Pose(pose) = known { Some(pose) } else { None };
        let visible = match known {
            Known::Pose(pose) => Some(picture.shows(pose)),
            Known::Absent => Some(false),
            // Without any truth a hand is taken to be there.
            Known::Nothing => truth.is_none().then_some(true),
        };
        meter.add(&Observation {
            truth: pose,
            visible,
            found: &found,
            valid: tracked.valid,
            iou: tracked.iou,
            evaluations: tracked.evaluations,
            restarted: tracked.restarted,
            confidence: frame.confidence,
            seconds: clip.timings.frames.track.get(i).map_or(0.0, std::time::Duration::as_secs_f64),
        });
        frame_iou.push(tracked.iou);
        // As the meter has it.
        if tracked.valid && visible != Some(false) {
            worst_overlap.add(1.0 - tracked.iou, i, time);
        }
        if let Some(pose) = pose {
            let off = angles_off(&angles, pose, &found);
            frame_deg.push(off);
            worst_angles.add(off, i, time);
        }
    }
    let known = !frame_deg.is_empty() && frame_deg.len() == frame_iou.len();
    let lost = hand.frames.iter().enumerate().filter(|(_, f)| !f.tracked.valid);
    Ok(TrackingSeam {
        hand: side.name(),
        hands: clip.hands.len(),
        view: start.view,
        view_assumed: start.assumed,
        open_frame: start.frame,
        fit_iou: start.fit.as_ref().map(|fit| fit.iou),
        lost: lost.map(|(i, _)| i).collect(),
        frame_iou,
        worst_overlap,
        starts: truth.and_then(|truth| Some([begun, truth.frames.first()?.time])),
        worst_angles: (!frame_deg.is_empty()).then_some(worst_angles),
        frame_deg: known.then_some(frame_deg),
        report: meter.report(),
        mirror: None,
    })
}

/// Tells whether a true hand is in the picture.
struct InPicture {
    model: HandModel,
    camera: handcast_track::PinholeCamera,
}

impl InPicture {
    fn new(morphology: &Morphology, hand: &TrackedHand) -> Self {
        let camera = hand.start.camera;
        Self { model: HandModel::new(morphology, hand.start.side).with_camera(camera), camera }
    }

    fn shows(&mut self, pose: &HandPose) -> bool {
        let (w, h) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let joints = self.model.joints(&ModelState::from_pose(pose, &self.camera));
        joints.iter().any(|[x, y]| (0.0..w).contains(x) && (0.0..h).contains(y))
    }
}

/// Keeps the worst moments of a clip.
struct Watcher<'a> {
    truth: Option<&'a PoseClip>,
    moments: Vec<Moment>,
    progress: &'a mut dyn FnMut(usize),
}

impl ClipSink for Watcher<'_> {
    fn read(&mut self, index: usize) -> Result<(), String> {
        (self.progress)(index + 1);
        Ok(())
    }

    fn tracked(&mut self, mut frame: TrackedFrame<'_>) -> Result<(), String> {
        let Some(hand) = frame.hands.first() else { return Ok(()) };
        let iou = hand.found.tracked.iou;
        let side = hand.start.side;
        let badness = match known_at(self.truth, frame.time, side) {
            Known::Pose(truth) => angles_off(&measured_angles(self.truth, side), truth, &hand.found.pose),
            _ => 1.0 - iou,
        };
        // Of moments close together only the worst is kept.
        let near = |m: &Moment| (m.time - frame.time).abs() < APART;
        let beaten = self.moments.iter().any(|m| near(m) && m.badness >= badness);
        let full = self.moments.len() >= MOMENTS
            && !self.moments.iter().any(near)
            && self.moments.last().is_some_and(|m| m.badness >= badness);
        if beaten || full {
            return Ok(());
        }
        self.moments.retain(|m| !near(m));
        let (index, time) = (frame.index, frame.time);
        let overlay = draw_overlay(&mut frame);
        self.moments.push(Moment { frame: index, time, badness, iou, overlay });
        self.moments.sort_by(|a, b| b.badness.total_cmp(&a.badness));
        self.moments.truncate(MOMENTS);
        Ok(())
    }
}
