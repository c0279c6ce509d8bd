//! A tracker's poses against the joints another tracker found in the same pictures.
//!
//! The other tracker is a reference with errors of its own, so these numbers compare trackers with each other;
//! they are no truth.

use nalgebra::{Point2, Vector2};
use serde::Serialize;

use super::counts::CountAgreement;
use super::summary::{mean, percentile};
use super::tracking::tracked_angles;
use handcast_formats::import::{ImportOptions, import};
use handcast_formats::landmarks::{ImagePoints, LandmarkClip};
use handcast_hand::{Finger, HandPose, Joint, JointAngle, count_extended, count_extended_of};

/// A tip nearer than this to the bones of another finger or to the palm is not told from them: half the breadth
/// of a finger, as a share of the hand's length.
const HALF_FINGER: f64 = 0.04;
/// The hand's length in the picture is that of the middle finger's chain of joints, from the wrist to the tip, in
/// the frames that show it longest; this share of the frames shows it shorter.
const LONGEST: f64 = 0.95;

/// Which fingertips stand out from the hand in a picture, in the order of [`Finger::ALL`]: those farther from the
/// wrist than the finger's PIP joint (the thumb's MCP joint), outside the palm (the outline through wrist, thumb's
/// CMC and the four MCP joints), and farther than 4 % of the hand's length (`length`, pixels) from every bone of
/// another finger and from the palm. Only of these can a silhouette tell where they are.
pub fn standing_out(points: &ImagePoints, length: f64) -> [bool; 5] {
    Finger::ALL.map(|finger| stands_out(points, finger, HALF_FINGER * length).unwrap_or(false))
}

/// The outline of the palm.
const PALM: [Joint; 6] = [
    Joint::Wrist,
    Joint::ThumbMetacarpal,
    Joint::IndexProximal,
    Joint::MiddleProximal,
    Joint::RingProximal,
    Joint::PinkyProximal,
];

/// The joints of a finger that both kinds of landmarks have: from the thumb's CMC, or the MCP joint.
fn chain(finger: Finger) -> &'static [Joint] {
    let joints = Joint::of(finger);
    if finger == Finger::Thumb { joints } else { &joints[1..] }
}

fn stands_out(points: &ImagePoints, finger: Finger, least: f64) -> Option<bool> {
    let at = |joint: Joint| points[joint.index()];
    let (tip, wrist) = (at(Joint::tip(finger))?, at(Joint::Wrist)?);
    let bend = at(chain(finger)[1])?;
    if (tip - wrist).norm() <= (bend - wrist).norm() {
        return Some(false);
    }
    let near =
        |a: Joint, b: Joint| at(a).zip(at(b)).is_some_and(|(a, b)| distance_to_segment(tip, a, b) <= least);
    let others = Finger::ALL.into_iter().filter(|f| *f != finger);
    let crossed = others.flat_map(|f| chain(f).windows(2)).any(|bone| near(bone[0], bone[1]));
    let palm: Vec<_> = PALM.into_iter().filter_map(at).collect();
    let edges = palm.iter().zip(palm.iter().cycle().skip(1));
    let on_palm =
        inside(tip, &palm) || edges.into_iter().any(|(&a, &b)| distance_to_segment(tip, a, b) <= least);
    Some(!crossed && !on_palm)
}

fn distance_to_segment(p: Point2<f64>, a: Point2<f64>, b: Point2<f64>) -> f64 {
    let along: Vector2<f64> = b - a;
    let t = (p - a).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE);
    (a + along * t.clamp(0.0, 1.0) - p).norm()
}

/// Even-odd rule.
fn inside(p: Point2<f64>, outline: &[Point2<f64>]) -> bool {
    let edges = outline.iter().zip(outline.iter().cycle().skip(1));
    let crosses = |(a, b): &(&Point2<f64>, &Point2<f64>)| {
        (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x)
    };
    edges.filter(crosses).count() % 2 == 1
}

/// The length of the hand in the pictures of a recording, pixels: the middle finger's chain of joints from the
/// wrist to the tip, where it is longest (95th percentile). `None` when it is nowhere whole.
pub fn length_in_pictures(clip: &LandmarkClip) -> Option<f64> {
    let bones = |points: &ImagePoints| -> Option<f64> {
        let joints = [Joint::Wrist].iter().chain(chain(Finger::Middle));
        let points: Option<Vec<_>> = joints.map(|j| points[j.index()]).collect();
        Some(points?.windows(2).map(|p| (p[1] - p[0]).norm()).sum())
    };
    let lengths: Vec<f64> = clip.frames.iter().filter_map(|f| bones(f.image.as_ref()?)).collect();
    Some(percentile(&lengths, LONGEST)).filter(|length| *length > 0.0)
}

/// Distances of fingertips in the picture, percent of the hand's length.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TipDistance {
    /// Fingertips compared.
    pub tips: usize,
    /// Half of them are nearer.
    pub median: f64,
    /// Mean.
    pub mean: f64,
    /// Nine in ten are nearer.
    pub p90: f64,
}

impl TipDistance {
    fn of(values: &[f64]) -> Self {
        Self {
            tips: values.len(),
            median: percentile(values, 0.5),
            mean: mean(values),
            p90: percentile(values, 0.9),
        }
    }
}

/// A tracker against the reference, on one clip.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReferenceReport {
    /// Frames compared: those the reference saw a hand in.
    pub frames: usize,
    /// Length of the hand in the picture, pixels of the whole clip.
    pub hand_px: f64,
    /// All fingertips that stand out: see [`standing_out`].
    pub tips: TipDistance,
    /// The same finger by finger, thumb first.
    pub fingers: [TipDistance; 5],
    /// Difference of the joint angles a tracker moves from those of the pose fitted to the reference's points in
    /// space: median, degrees; `None` where the reference has none.
    pub angle_median_deg: Option<f64>,
    /// Its mean, degrees.
    pub angle_mean_deg: Option<f64>,
    /// The numbers of fingers stretched out by the reference's points in space ([`count_extended_of`]) and by the
    /// tracker's pose ([`count_extended`]).
    pub extended: CountAgreement,
    /// These numbers frame by frame: number of the frame, reference, tracker.
    pub extended_frames: Vec<(usize, usize, usize)>,
}

/// Compares poses with a reference, frame by frame.
#[derive(Clone, Debug)]
pub struct ReferenceMeter<'a> {
    clip: &'a LandmarkClip,
    poses: Vec<Option<HandPose>>,
    length: f64,
    frames: usize,
    tips: [Vec<f64>; 5],
    angles: Vec<f64>,
    extended: Vec<(usize, usize, usize)>,
}

impl<'a> ReferenceMeter<'a> {
    /// A meter for the clip of the reference; `None` when the reference has no positions in pictures.
    pub fn new(clip: &'a LandmarkClip) -> Option<Self> {
        let length = length_in_pictures(clip)?;
        let options = ImportOptions { max_gap: 0.0, ..ImportOptions::default() };
        let mut poses = vec![None; clip.frames.len()];
        // A reference without points in space has no poses; its tips are compared all the same.
        if let Ok((found, _)) = import(clip, &options) {
            for pose in found.frames.into_iter().filter(|f| f.valid) {
                let at = clip.frames.partition_point(|f| f.time < pose.time);
                if let Some(place) = poses.get_mut(at) {
                    *place = Some(pose.pose);
                }
            }
        }
        Some(Self {
            clip,
            poses,
            length,
            frames: 0,
            tips: Default::default(),
            angles: Vec::new(),
            extended: Vec::new(),
        })
    }

    /// Adds what a tracker found in frame `index` of the clip: the pose, and the positions of its joints in the
    /// picture, pixels of the whole clip, in the order of [`Joint::ALL`].
    pub fn add(&mut self, index: usize, pose: &HandPose, joints: &[[f64; 2]; 25]) {
        let Some(frame) = self.clip.frames.get(index) else { return };
        let Some(points) = &frame.image else { return };
        self.frames += 1;
        let standing = standing_out(points, self.length);
        for (finger, out) in Finger::ALL.into_iter().zip(standing) {
            let tip = Joint::tip(finger).index();
            if let Some(reference) = points[tip].filter(|_| out) {
                let distance = (Point2::from(joints[tip]) - reference).norm();
                self.tips[finger as usize].push(100.0 * distance / self.length);
            }
        }
        if let Some(reference) = self.poses.get(index).and_then(Option::as_ref) {
            let off = |angle: JointAngle| (pose.angle(angle) - reference.angle(angle)).to_degrees().abs();
            self.angles.extend(tracked_angles().map(off));
        }
        // Of the points themselves: a pose fitted to them bends where their errors of depth do.
        if let Some(reference) = count_extended_of(&frame.points) {
            self.extended.push((index, reference, count_extended(pose)));
        }
    }

    /// What was found.
    pub fn report(self) -> ReferenceReport {
        let known = !self.angles.is_empty();
        ReferenceReport {
            frames: self.frames,
            hand_px: self.length,
            tips: TipDistance::of(&self.tips.concat()),
            fingers: self.tips.each_ref().map(|values| TipDistance::of(values)),
            angle_median_deg: known.then(|| percentile(&self.angles, 0.5)),
            angle_mean_deg: known.then(|| mean(&self.angles)),
            extended: CountAgreement::of(self.extended.iter().map(|&(_, a, b)| (a, b))),
            extended_frames: self.extended,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_formats::landmarks::LandmarkFrame;
    use handcast_hand::shapes::ShapeLibrary;
    use handcast_hand::{Morphology, Side, Skeleton};

    /// The pose seen from the front at 1000 pixels a metre.
    fn picture(pose: &HandPose) -> [[f64; 2]; 25] {
        let frames = Skeleton::new(&Morphology::default(), pose.side).frames(pose);
        Joint::ALL.map(|j| {
            let p = frames.position(j);
            [300.0 + 1000.0 * p.x, 400.0 - 1000.0 * p.y]
        })
    }

    fn points(pose: &HandPose) -> ImagePoints {
        picture(pose).map(|p| Some(Point2::from(p)))
    }

    fn shape(name: &str) -> HandPose {
        let mut pose = ShapeLibrary::builtin().unwrap().get(name).unwrap().pose(Side::Right);
        pose.rotation = nalgebra::UnitQuaternion::identity();
        pose
    }

    fn clip(poses: &[HandPose]) -> LandmarkClip {
        let frame = |(i, pose): (usize, &HandPose)| {
            let frames = Skeleton::new(&Morphology::default(), pose.side).frames(pose);
            let joints = Joint::ALL.map(|j| Some(frames.position(j)));
            LandmarkFrame { image: Some(points(pose)), ..LandmarkFrame::of(i as f64, joints) }
        };
        LandmarkClip {
            side: Some(Side::Right),
            metres: Some(1.0),
            points_per_frame: 25,
            frames: poses.iter().enumerate().map(frame).collect(),
            ..LandmarkClip::default()
        }
    }

    #[test]
    fn tips_stand_out_that_one_counts() {
        for (name, expected) in [
            ("spread", [true; 5]),
            ("fist", [false; 5]),
            ("asl:W", [false, true, true, true, false]),
            ("asl:4", [false, true, true, true, true]),
            ("asl:1", [false, true, false, false, false]),
        ] {
            assert_eq!(standing_out(&points(&shape(name)), 189.0), expected, "{name}");
        }
        let mut crossed = points(&shape("asl:2"));
        assert!(standing_out(&crossed, 189.0)[1]);
        crossed[Joint::tip(Finger::Index).index()] = crossed[Joint::tip(Finger::Middle).index()];
        assert_eq!(standing_out(&crossed, 189.0), [false; 5]);
        assert_eq!(standing_out(&[None; 25], 189.0), [false; 5]);
    }

    #[test]
    fn the_pose_itself_is_at_no_distance_and_a_shifted_one_at_its_shift() {
        let poses = [shape("spread"), shape("asl:1")];
        let clip = clip(&poses);
        let length = length_in_pictures(&clip).unwrap();
        assert!((length - 189.0).abs() < 4.0, "{length}");
        let mut meter = ReferenceMeter::new(&clip).unwrap();
        meter.add(0, &poses[0], &picture(&poses[0]));
        let shift = 0.1 * length;
        let moved = poses[1].clone().with_degrees(JointAngle::Middle2Flexion, 0.0);
        let moved = moved.with_degrees(JointAngle::Middle1Flexion, 0.0);
        meter.add(1, &moved, &picture(&moved).map(|[x, y]| [x + shift, y]));
        meter.add(2, &moved, &picture(&moved));
        let report = meter.report();
        assert_eq!((report.frames, report.tips.tips), (2, 6));
        assert_eq!(report.fingers[1].tips, 2);
        assert!((report.fingers[1].p90 - 10.0).abs() < 1e-9 && report.tips.median < 1e-9);
        assert!(report.angle_median_deg.unwrap() < 3.0, "{report:?}");
        assert_eq!(report.extended_frames, [(0, 5, 5), (1, 1, 2)]);
        assert_eq!(report.extended.share, Some(0.5));
    }

    #[test]
    fn a_recording_without_pictures_is_no_reference() {
        let mut clip = clip(&[shape("spread")]);
        clip.frames[0].image = None;
        assert!(ReferenceMeter::new(&clip).is_none());
    }
}
