//! Poses from other trackers' joint positions.

use std::collections::VecDeque;

use nalgebra::{Point3, Vector3};

use super::landmarks::{Axes, AxesSource, Camera, LandmarkClip, LandmarkFrame};
use handcast_hand::landmarks::{
    Fit, JointPoints, LANDMARKS_21, LandmarkError, PALM, PoseSolver, SideTrial, SolverOptions, bone_spread,
    hand_length, measure, placed_on_lines, tell_side,
};
use handcast_hand::smooth::{Jitter, SmoothOptions, smooth_recording};
use handcast_hand::{Finger, HandPose, Joint, Morphology, PoseClip, PoseHeader, Side, TimedPose};

/// Hand length given to a recording without a unit, metres: the population mean.
pub const MEAN_HAND_LENGTH: f64 = 0.189;

/// Field of view across the longer side of a picture of which nothing else is known, radians.
pub const FIELD_OF_VIEW: f64 = 60.0 * std::f64::consts::PI / 180.0;
/// How much better hands must fit the other way round before the names a source gives them are exchanged.
const EXCHANGED: f64 = 1.1;
/// The same where names are mostly right, and how badly they must fit as they are, metres: flat hands that are splayed reach 2.6,
/// fifths of a second of them by Leap Motion, within 2 mm.
const FAR_BETTER: f64 = 3.0;
const BADLY: f64 = 4e-3;
/// The same for it to be said alone: good recordings, and any pieces of them, reach 1.2 where they fit so badly.
const BETTER: f64 = 1.5;
/// Spread of the lengths of bones from which on their directions are believed rather than the places of their ends: above
/// what markers on the skin have, below learned trackers ([`bone_spread`]).
const STRETCHING: f64 = 0.08;
/// Frames in which a hand is tried as left and right where its side is told, or it is seen in pictures alone.
const TRIED: usize = 12;

/// How to import.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportOptions {
    /// Left or right; by default what the source says, or else what fits better.
    pub side: Option<Side>,
    /// The hand's sizes; by default those of a mean hand where the points are one's to the last digit, or else measured from
    /// the recording.
    pub morphology: Option<Morphology>,
    /// The hand's length in metres, which sets the scale; by default the source's unit does, or else
    /// [`MEAN_HAND_LENGTH`].
    pub hand_length: Option<f64>,
    /// What the solver may vary; palm bends are switched on by sources that show the metacarpals.
    pub solver: SolverOptions,
    /// Axes of the points; by default what the source says, or what files of its format have.
    pub axes: Option<Axes>,
    /// Width and height of the picture in which the joints were found, pixels; by default what the source says. Given
    /// here, it places hands before the camera by their joints in the picture.
    pub image_size: Option<[f64; 2]>,
    /// What the camera sees across the picture's longer side, radians.
    pub field_of_view: f64,
    /// Longest time without a hand that is bridged, seconds from the last pose to the next.
    pub max_gap: f64,
    /// Smooths the poses found, in both directions of time; the distances reported are those before.
    pub smooth: Option<SmoothOptions>,
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            side: None,
            morphology: None,
            hand_length: None,
            solver: SolverOptions::default(),
            axes: None,
            image_size: None,
            field_of_view: FIELD_OF_VIEW,
            max_gap: 0.25,
            smooth: None,
        }
    }
}

impl ImportOptions {
    /// Those of a recording: the mean hand is known where it is seen to be one.
    fn of_hand(&self, clip: &LandmarkClip) -> Self {
        let mean = || {
            let mean = mean_hand(clip)?;
            Some(self.hand_length.map_or(mean, Morphology::average))
        };
        Self { morphology: self.morphology.clone().or_else(mean), ..self.clone() }
    }
}

/// What an import found.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportReport {
    /// The hand.
    pub side: Side,
    /// The trial that told the side, when the source did not say, or that speaks for the other one.
    pub trial: Option<SideTrial>,
    /// Whether it is the other side than the one the source names: that of the hand in a mirrored picture.
    pub exchanged: bool,
    /// Whether the source's names of sides are mostly right.
    pub named_surely: bool,
    /// Metres in one unit of the source.
    pub metres: f64,
    /// The axes of the points as they were read.
    pub axes: Axes,
    /// What told them.
    pub axes_from: AxesSource,
    /// Whether joints were seen in pictures alone, not in space.
    pub flat: bool,
    /// Whether the poses say where the hand is.
    pub placed: bool,
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
    /// Unsteadiness of the joint angles as found ([`Jitter`]), degrees; `None` below 22 frames a second.
    pub jitter: Option<f64>,
}

/// Of how many times the distance the other side counts as one that fits almost alike.
const ALIKE: f64 = 1.1;
/// Unsteadiness from which on joints tremble, degrees: learned trackers have 2.2 to 8, Leap, markers and true motion of
/// rendered hands 0.04 to 1.3.
const TREMBLING: f64 = 2.0;
/// Longest time between frames at which motion does not pass for trembling, seconds.
const FAST_ENOUGH: f64 = 0.045;

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
            jitter: self.jitter.into_iter().chain(other.jitter).reduce(f64::max),
            ..self
        }
    }

    /// What is doubtful of which side the hand is, in words.
    pub fn notice(&self) -> Option<String> {
        let side = self.side.name();
        match self.trial {
            Some(trial) if self.exchanged && self.named_surely => Some(format!(
                "the hand called {} fits far better as a {side} one ({:.1} against {:.1} mm), as where the sides or the axes \
                 of a file are exchanged: it is taken for that",
                self.side.other().name(),
                trial.left.min(trial.right) * 1e3,
                trial.left.max(trial.right) * 1e3,
            )),
            Some(trial) if self.named_surely && trial.side() != self.side => Some(format!(
                "the hand called {side} fits better as a {} one ({:.1} against {:.1} mm), as where the sides or the axes of a \
                 file are exchanged: it is taken as it is called",
                trial.side().name(),
                trial.left.min(trial.right) * 1e3,
                trial.left.max(trial.right) * 1e3,
            )),
            _ if self.exchanged => Some(format!(
                "the hand called {} fits as a {side} one, as in a picture that was not mirrored: it is taken for that",
                self.side.other().name()
            )),
            Some(trial) if trial.ratio() < ALIKE => Some(format!(
                "left and right fit almost alike ({:.1} and {:.1} mm): it is taken for a {side} one",
                trial.left * 1e3,
                trial.right * 1e3,
            )),
            _ => None,
        }
    }

    /// That joints tremble as those of learned trackers do, in words.
    pub fn trembling(&self) -> Option<String> {
        let jitter = self.jitter.filter(|jitter| *jitter > TREMBLING)?;
        Some(format!("joint angles tremble by {jitter:.1}° RMS from frame to frame, which a stream pays for"))
    }
}

/// Finds the poses of a recording. Bridged frames are valid and have confidence 0; frames of longer gaps
/// are not valid and repeat the last pose.
///
/// # Errors
/// [`LandmarkError`] when the recording never shows a whole palm or its sizes are not those of a hand, or shows joints in
/// a picture of unknown size only.
pub fn import(
    clip: &LandmarkClip,
    options: &ImportOptions,
) -> Result<(PoseClip, ImportReport), LandmarkError> {
    let options = &options.of_hand(clip);
    let source = Source::of(clip, options)?;
    let told = told(clip, &source, options)?;
    source.solved(clip, told, options)
}

/// Finds the poses of all hands of a file. Two hands come out as one left and one right hand, unless the options tell the
/// side, which is that of all.
///
/// # Errors
/// Those of [`import`].
pub fn import_all(
    hands: &[LandmarkClip],
    options: &ImportOptions,
) -> Result<(PoseClip, Vec<ImportReport>), LandmarkError> {
    let mut prepared = Vec::new();
    for hand in hands {
        let options = options.of_hand(hand);
        let source = Source::of(hand, &options)?;
        let told = told(hand, &source, &options)?;
        prepared.push((hand, options, source, told));
    }
    // One of each side: of two of a side, that which fits the other one less badly is it.
    if let [(one, _, _, a), (two, _, _, b)] = prepared.as_mut_slice()
        && a.side == b.side
        && options.side.is_none()
    {
        let doubt = |told: &Told| told.trial.map_or(f64::INFINITY, |trial| trial.ratio());
        let (other, clip) = if doubt(a) < doubt(b) { (a, one) } else { (b, two) };
        other.side = other.side.other();
        other.exchanged = clip.side.is_some_and(|named| named != other.side);
    }
    let mut all = PoseClip::default();
    let mut reports = Vec::new();
    for (hand, options, source, told) in prepared {
        let (clip, report) = source.solved(hand, told, &options)?;
        all.header.rate = all.header.rate.or(clip.header.rate);
        all.header.made_by = all.header.made_by.or(clip.header.made_by);
        all.header.hands.extend(clip.header.hands);
        all.frames.extend(clip.frames);
        reports.push(report);
    }
    all.frames.sort_by(|a, b| a.time.total_cmp(&b.time));
    Ok((all, reports))
}

/// How near to one another the middles of two hands are that lie in one place, metres.
const ONE_PLACE: f64 = 0.05;

/// That two hands whose places are not told lie in one another, in words.
pub fn in_one_place(hands: &[LandmarkClip], reports: &[ImportReport]) -> Option<String> {
    let [one, two] = hands else { return None };
    if reports.iter().any(|report| report.placed) {
        return None;
    }
    let middle = |clip: &LandmarkClip, frame: &LandmarkFrame| {
        let points = || frame.points.iter().flatten();
        let sum: Vector3<f64> = points().map(|p| p.coords).sum();
        (points().next().is_some()).then(|| sum * (clip.metres.unwrap_or(1.0) / points().count() as f64))
    };
    let mut others = two.frames.iter().peekable();
    let mut apart: Vec<f64> = Vec::new();
    for frame in &one.frames {
        while others.next_if(|other| other.time < frame.time).is_some() {}
        if let Some(other) = others.peek().filter(|other| other.time == frame.time)
            && let (Some(a), Some(b)) = (middle(one, frame), middle(two, other))
        {
            apart.push((a - b).norm());
        }
    }
    apart.sort_by(f64::total_cmp);
    let near = apart.get(apart.len() / 2).is_some_and(|apart| *apart < ONE_PLACE);
    near.then(|| "it does not tell where the two hands are: both are put in one place".into())
}

/// Which hand it is, and how that became known.
#[derive(Clone, Copy)]
struct Told {
    side: Side,
    trial: Option<SideTrial>,
    exchanged: bool,
}

fn told(clip: &LandmarkClip, source: &Source, options: &ImportOptions) -> Result<Told, LandmarkError> {
    if let Some(side) = options.side {
        return Ok(Told { side, trial: None, exchanged: false });
    }
    if let Some(side) = clip.side.filter(|_| !clip.side_unsure) {
        let trial = source.few().and_then(|few| tell_side(&few).ok());
        let trial = trial.filter(|trial| {
            let off = trial.left.max(trial.right);
            trial.side() != side && trial.ratio() > BETTER && off > BADLY
        });
        let exchanged = trial.is_some_and(|trial| trial.ratio() > FAR_BETTER);
        return Ok(Told { side: if exchanged { side.other() } else { side }, trial, exchanged });
    }
    let trial = source.tell_side(options);
    Ok(match clip.side {
        Some(side) => match trial {
            Ok(trial) if trial.side() != side && trial.ratio() > EXCHANGED => {
                Told { side: trial.side(), trial: Some(trial), exchanged: true }
            }
            trial => Told { side, trial: trial.ok(), exchanged: false },
        },
        None => trial.map(|t| Told { side: t.side(), trial: Some(t), exchanged: false })?,
    })
}

/// How far a bone may be from that of a mean hand, metres: the last digits that are written.
const EXACT: f64 = 1e-6;

/// The sizes of the mean hand, where the points are those of one to the last digit, as in files written of a hand
/// whose sizes were not known. Measuring would say how long its bones are, but not how its palm lies among them.
fn mean_hand(clip: &LandmarkClip) -> Option<Morphology> {
    let metres = clip.metres?;
    let whole = |frame: &&LandmarkFrame| LANDMARKS_21.into_iter().all(|j| frame.points[j.index()].is_some());
    let points = clip.to_ends(clip.frames.iter().find(whole)?.points);
    let bone = |finger: Finger, k: usize| {
        let a = Joint::base(finger).index() + k;
        Some(metres * (points[a + 1]? - points[a]?).norm())
    };
    let length: Option<f64> = (0..3).map(|k| bone(Finger::Middle, k)).sum();
    let mean = Morphology::default();
    let mean = Morphology::average(mean.hand_length * length? / mean.finger(Finger::Middle).length());
    let fits = |(finger, k): (Finger, usize)| {
        bone(finger, k).is_some_and(|found| (found - mean.finger(finger).bones[k]).abs() < EXACT)
    };
    Finger::ALL
        .into_iter()
        .flat_map(|finger| [0, 1, 2].map(|k| (finger, k)))
        .all(fits)
        .then_some(mean)
        .filter(|mean| mean.validate().is_ok())
}

/// The joints of a recording, in metres and our axes.
struct Source {
    metres: f64,
    frames: Vec<JointPoints>,
    /// Points on the lines of sight, of hands seen in pictures.
    rays: Vec<Option<JointPoints>>,
    /// Joints in any scale, as deep as the source says, of such hands.
    lifted: Vec<Option<JointPoints>>,
    flat: bool,
    placed: bool,
    axes: (Axes, AxesSource),
}

impl Source {
    fn of(clip: &LandmarkClip, options: &ImportOptions) -> Result<Self, LandmarkError> {
        let axes = match options.axes {
            Some(axes) => (axes, AxesSource::Asked),
            None => (clip.axes, clip.axes_from),
        };
        let turned =
            |frame: &LandmarkFrame| clip.to_ends(frame.points).map(|p| p.map(|p| axes.0.to_webxr(p)));
        let mut frames: Vec<JointPoints> = clip.frames.iter().map(turned).collect();
        let flat = !frames.iter().any(|points| points.iter().any(Option::is_some))
            && clip.frames.iter().any(|frame| frame.image.is_some() || frame.picture.is_some());
        let size = options.image_size.or(clip.image_size);
        if flat && size.is_none() {
            return Err(LandmarkError::NoPictureSize);
        }
        let camera = size.map(|size| Camera::new(size, options.field_of_view));
        let place = flat || clip.centred || options.image_size.is_some();
        let rays = |camera: Camera| {
            let rays = |frame: &LandmarkFrame| {
                Some(pixels(clip, frame, size)?.map(|p| p.map(|p| camera.ray(p.xy()))))
            };
            clip.frames.iter().map(rays).collect()
        };
        let rays: Vec<Option<JointPoints>> =
            camera.filter(|_| place).map_or_else(|| vec![None; frames.len()], rays);
        if flat {
            let lifted = clip.frames.iter().map(|frame| {
                frame.picture.as_ref().filter(|picture| picture.deep)?;
                Some(pixels(clip, frame, size)?.map(|p| p.map(|p| Axes::Mediapipe.to_webxr(p))))
            });
            let lifted = lifted.collect();
            return Ok(Self { metres: 1.0, frames, rays, lifted, flat, placed: true, axes });
        }
        let metres = scale(clip, options, &frames).ok_or(LandmarkError::NoPalm)?;
        if let (Some(metres), None) = (clip.metres, options.hand_length)
            && let Some(length) = hand_length(&frames)
        {
            check_unit(length, metres)?;
        }
        for point in frames.iter_mut().flatten().flatten() {
            *point = Point3::from(point.coords * metres);
        }
        let mut placed = clip.metres.is_some() && !clip.centred;
        for (points, rays) in frames.iter_mut().zip(&rays) {
            let Some(rays) = rays else { continue };
            let pairs = points.iter().zip(rays).filter_map(|(p, ray)| Some(((*p)?, (*ray)?)));
            if let Some(moved) = placed_on_lines(pairs) {
                placed = true;
                points.iter_mut().flatten().for_each(|p| *p += moved);
            }
        }
        let lifted = vec![None; frames.len()];
        Ok(Self { metres, frames, rays, lifted, flat, placed, axes })
    }

    /// Some frames that show the whole palm in space.
    fn few(&self) -> Option<Vec<JointPoints>> {
        let whole = |points: &&JointPoints| PALM.iter().all(|joint| points[joint.index()].is_some());
        let whole: Vec<&JointPoints> = self.frames.iter().filter(whole).collect();
        let step = whole.len().div_ceil(TRIED).max(1);
        (!whole.is_empty()).then(|| whole.into_iter().step_by(step).copied().collect())
    }

    /// Solves some frames as either hand.
    fn tell_side(&self, options: &ImportOptions) -> Result<SideTrial, LandmarkError> {
        if !self.flat {
            return tell_side(&self.frames);
        }
        let seen: Vec<usize> = (0..self.rays.len()).filter(|i| self.rays[*i].is_some()).collect();
        let mut distances = [Side::Left, Side::Right].map(|side| {
            let mut solver = PoseSolver::new(&self.sizes(options), side, self.solver_options(options));
            let tried = seen.iter().step_by(seen.len().div_ceil(TRIED).max(1));
            let found = tried.filter_map(|&i| {
                solver.reset();
                let fit = solver.solve_seen(self.rays[i].as_ref()?, self.lifted[i].as_ref()).ok()?;
                Some(fit.mean_distance)
            });
            let found: Vec<f64> = found.collect();
            (found.iter().sum::<f64>() / found.len().max(1) as f64, found.len())
        });
        // The side that more frames can be solved as is it.
        let most = distances[0].1.max(distances[1].1);
        if most == 0 {
            return Err(LandmarkError::NoPalm);
        }
        for (distance, count) in &mut distances {
            *distance = if *count * 2 < most { f64::MAX } else { *distance };
        }
        Ok(SideTrial { left: distances[0].0, right: distances[1].0 })
    }

    /// Sizes of a hand seen in pictures: those given, or a mean hand's of the length given.
    fn sizes(&self, options: &ImportOptions) -> Morphology {
        let mean = || Morphology::average(options.hand_length.unwrap_or(MEAN_HAND_LENGTH));
        options.morphology.clone().unwrap_or_else(mean)
    }

    fn solver_options(&self, options: &ImportOptions) -> SolverOptions {
        let mut solver = options.solver.clone();
        let metacarpal = Joint::PinkyMetacarpal.index();
        solver.palm |= self.frames.iter().any(|f| f[metacarpal].is_some());
        // Lines of sight do not tell twists from bends.
        solver.twists &= !self.flat;
        solver
    }

    fn solved(
        &self,
        clip: &LandmarkClip,
        told: Told,
        options: &ImportOptions,
    ) -> Result<(PoseClip, ImportReport), LandmarkError> {
        let side = told.side;
        let morphology = match &options.morphology {
            Some(m) => m.clone(),
            None if self.flat => self.sizes(options),
            None => measure(&self.frames, side)?,
        };
        let mut solver = PoseSolver::new(&morphology, side, self.solver_options(options));
        let expected = if clip.points_per_frame == 21 { LANDMARKS_21.len() } else { Joint::COUNT };
        let stretching = bone_spread(&self.frames).is_some_and(|spread| spread > STRETCHING);
        let mut track = Track::new(told, options);
        track.report.named_surely = clip.side.is_some() && !clip.side_unsure;
        for (i, frame) in clip.frames.iter().enumerate() {
            let fit = match (&self.rays[i], self.flat) {
                (Some(rays), true) => solver.solve_seen(rays, self.lifted[i].as_ref()),
                (None, true) => Err(LandmarkError::NoPalm),
                _ if stretching => solver.solve_along(&self.frames[i]),
                _ => solver.solve(&self.frames[i]),
            };
            track.add(frame, expected, fit.ok());
        }
        let (frames, mut report) = track.finished();
        report.metres = self.metres;
        (report.axes, report.axes_from) = self.axes;
        (report.flat, report.placed) = (self.flat, self.placed);
        let mut header = PoseHeader::one(side, Some(morphology), clip.rate);
        header.made_by.clone_from(&clip.made_by);
        Ok((PoseClip { header, frames }, report))
    }
}

/// Joints in the picture, pixels, with depths.
fn pixels(clip: &LandmarkClip, frame: &LandmarkFrame, size: Option<[f64; 2]>) -> Option<JointPoints> {
    let points = match (&frame.picture, &frame.image) {
        (Some(picture), _) => picture.pixels(size),
        (None, Some(image)) => Some(image.map(|p| p.map(|p| Point3::new(p.x, p.y, 0.0)))),
        (None, None) => None,
    };
    points.map(|points| clip.to_ends(points))
}

/// The poses found so far.
struct Track<'a> {
    options: &'a ImportOptions,
    report: ImportReport,
    jitter: Jitter,
    out: Vec<TimedPose>,
    last: Option<(f64, HandPose)>,
    gap: VecDeque<f64>,
}

impl<'a> Track<'a> {
    fn new(told: Told, options: &'a ImportOptions) -> Self {
        let report = ImportReport {
            side: told.side,
            trial: told.trial,
            exchanged: told.exchanged,
            named_surely: false,
            metres: 1.0,
            axes: Axes::default(),
            axes_from: AxesSource::default(),
            flat: false,
            placed: false,
            solved: 0,
            bridged: 0,
            lost: 0,
            missing_points: 0,
            mean_distance: 0.0,
            max_distance: 0.0,
            jitter: None,
        };
        let jitter = Jitter::default();
        Self { options, report, jitter, out: Vec::new(), last: None, gap: VecDeque::new() }
    }

    fn add(&mut self, frame: &LandmarkFrame, expected: usize, fit: Option<Fit>) {
        let near = self.last.as_ref().is_none_or(|(before, _)| frame.time - before <= FAST_ENOUGH);
        if !near {
            self.jitter.push(None);
        }
        self.jitter.push(fit.as_ref().map(|fit| &fit.pose));
        let Some(fit) = fit else {
            self.gap.push_back(frame.time);
            return;
        };
        let report = &mut self.report;
        report.solved += 1;
        report.missing_points += expected.saturating_sub(fit.seen);
        report.mean_distance += fit.mean_distance;
        report.max_distance = report.max_distance.max(fit.max_distance);
        let pose = fit.pose;
        self.close_gap(Some((frame.time, &pose)));
        let confidence = frame.confidence;
        self.out.push(TimedPose { confidence, ..TimedPose::new(frame.time, pose.clone()) });
        self.last = Some((frame.time, pose));
    }

    fn finished(mut self) -> (Vec<TimedPose>, ImportReport) {
        self.close_gap(None);
        self.report.mean_distance /= self.report.solved.max(1) as f64;
        self.report.jitter = self.jitter.degrees();
        if let Some(smooth) = self.options.smooth {
            smooth_recording(&mut self.out, smooth, self.options.max_gap);
        }
        (self.out, self.report)
    }

    /// Fills the frames without a pose between two that have one.
    fn close_gap(&mut self, after: Option<(f64, &HandPose)>) {
        for time in self.gap.drain(..) {
            match (&self.last, after) {
                (Some((t0, a)), Some((t1, b))) if t1 - t0 <= self.options.max_gap => {
                    let pose = a.interpolated(b, (time - t0) / (t1 - t0));
                    self.out.push(TimedPose { confidence: Some(0.0), ..TimedPose::new(time, pose) });
                    self.report.bridged += 1;
                }
                (before, _) => {
                    let neutral = || HandPose::neutral(self.report.side);
                    let pose = before.as_ref().map_or_else(neutral, |(_, pose)| pose.clone());
                    self.out.push(TimedPose { valid: false, ..TimedPose::new(time, pose) });
                    self.report.lost += 1;
                }
            }
        }
    }
}

/// Lengths of hands that a unit may be known by, metres.
const LIKELY: std::ops::Range<f64> = 0.1..0.28;
/// Units that numbers may be in, metres.
const UNITS: [(&str, f64); 3] = [("metres", 1.0), ("centimetres", 0.01), ("millimetres", 0.001)];

/// That a hand of this length, in units of so many metres, is as long as hands are.
fn check_unit(length: f64, metres: f64) -> Result<(), LandmarkError> {
    let [shortest, longest] = Morphology::LENGTHS;
    if (shortest..=longest).contains(&(length * metres)) {
        return Ok(());
    }
    match UNITS.into_iter().find(|(_, unit)| LIKELY.contains(&(length * unit))) {
        Some((looks, _)) => Err(LandmarkError::Unit { length: length * metres, looks }),
        None => Ok(()),
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::Skeleton;
    use handcast_hand::random::Random;
    use nalgebra::Vector3;

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
            LandmarkFrame::of(i as f64 / 20.0, points)
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
    fn hands_called_by_the_other_side_are_told() {
        let mut source = clip(|_, _| false);
        source.metres = Some(1e-4);
        source.side = Some(Side::Left);
        let found = |source: &LandmarkClip| import(source, &ImportOptions::default()).unwrap().1;
        let good = found(&source);
        assert!(!good.exchanged && good.trial.is_none() && good.notice().is_none());
        source.side = Some(Side::Right);
        let wrong = found(&source);
        assert_eq!((wrong.side, wrong.exchanged), (Side::Left, true));
        assert!(
            wrong.mean_distance < 1e-4 && wrong.notice().unwrap().contains("fits far better as a left one")
        );
        let asked = ImportOptions { side: Some(Side::Right), ..ImportOptions::default() };
        assert!(!import(&source, &asked).unwrap().1.exchanged);
        // Joints that tremble by 3 mm each way fit neither side well.
        let mut random = Random::new(5, 0);
        let mut rough = source.clone();
        for point in rough.frames.iter_mut().flat_map(|f| &mut f.points).flatten() {
            *point += Vector3::from_fn(|_, _| 30.0 * f64::from(random.gauss()));
        }
        let doubtful = found(&rough);
        assert_eq!((doubtful.side, doubtful.exchanged), (Side::Right, false));
        let notice = doubtful.notice().unwrap();
        assert!(
            notice.contains("called right fits better as a left one") && notice.contains("as it is called")
        );
        // Axes that are not as the file says mirror a hand as well.
        source.side = Some(Side::Left);
        source.axes = Axes::Unity;
        assert_eq!(found(&source).side, Side::Right);
        // Names of an open hand are believed.
        source.axes = Axes::Webxr;
        source.frames.truncate(2);
        source.side = Some(Side::Right);
        assert!(!found(&source).exchanged);
    }

    #[test]
    fn wrong_units_are_named() {
        let mut source = clip(|_, _| false);
        for (metres, scale, looks) in
            [(1.0, 0.1, "millimetres"), (1.0, 0.01, "centimetres"), (0.001, 1e-4, "metres")]
        {
            let mut wrong = source.clone();
            wrong.metres = Some(metres);
            for point in wrong.frames.iter_mut().flat_map(|f| &mut f.points).flatten() {
                *point *= scale;
            }
            let said = import(&wrong, &ImportOptions::default()).unwrap_err().to_string();
            assert!(said.contains("m long, and its numbers look like ") && said.contains(looks), "{said}");
            let told = ImportOptions { hand_length: Some(0.18), ..ImportOptions::default() };
            assert!(import(&wrong, &told).is_ok());
        }
        source.metres = Some(1e-4);
        assert!(import(&source, &ImportOptions::default()).is_ok());
    }

    #[test]
    fn two_hands_in_one_place_are_told() {
        let mut hands = [clip(|_, _| false), clip(|_, _| false)];
        for (hand, side) in hands.iter_mut().zip([Side::Left, Side::Right]) {
            (hand.metres, hand.side, hand.centred) = (Some(1e-4), Some(side), true);
        }
        let told = |hands: &[LandmarkClip]| {
            let (_, reports) = import_all(hands, &ImportOptions::default()).unwrap();
            in_one_place(hands, &reports)
        };
        assert!(told(&hands).unwrap().contains("both are put in one place"));
        assert_eq!(told(&hands[..1]), None);
        for point in hands[0].frames.iter_mut().flat_map(|f| &mut f.points).flatten() {
            point.x += 2000.0;
        }
        assert_eq!(told(&hands), None);
    }

    #[test]
    fn trembling_joints_are_told_and_steadied() {
        let mut random = Random::new(7, 0);
        let mut source = clip(|_, _| false);
        let slow = source.clone();
        for (i, frame) in source.frames.iter_mut().enumerate() {
            frame.time = i as f64 / 30.0;
        }
        let sure = source.clone();
        for point in source.frames.iter_mut().flat_map(|f| &mut f.points).flatten() {
            // 3 mm each way.
            *point += Vector3::from_fn(|_, _| 30.0 * f64::from(random.gauss()));
        }
        let found = |clip: &LandmarkClip, smooth| {
            import(clip, &ImportOptions { smooth, ..ImportOptions::default() }).unwrap()
        };
        assert_eq!(found(&slow, None).1.jitter, None);
        let (truth, steady) = found(&sure, None);
        assert!(steady.jitter.is_some_and(|jitter| jitter < 0.1) && steady.trembling().is_none());
        let (raw, report) = found(&source, None);
        assert!(report.trembling().is_some_and(|words| words.contains("tremble by")), "{report:?}");
        let (smooth, report) = found(&source, Some(SmoothOptions::recorded()));
        assert!(report.trembling().is_some(), "as found: {report:?}");
        let off = |poses: &PoseClip| {
            let pairs = poses.frames.iter().zip(&truth.frames);
            let squares = pairs.flat_map(|(a, b)| a.pose.angles.iter().zip(b.pose.angles));
            squares.map(|(a, b)| (a - b).powi(2)).sum::<f64>()
        };
        assert!(off(&smooth) < 0.5 * off(&raw), "{} {}", off(&smooth), off(&raw));
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
