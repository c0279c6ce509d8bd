//! What is given beside a clip, and whether it is of that clip: joints of another tracker, true poses.

use std::path::{Path, PathBuf};

use anyhow::bail;
use handcast_formats::landmarks::{ImagePoints, LandmarkClip, LandmarkFrame};
use handcast_hand::landmarks::LANDMARKS_21;
use handcast_hand::{PoseClip, Side, nearest_in_time};
use handcast_media::{ClipInfo, FrameSource, Part};
use handcast_track::pipeline::{FinderSource, HandFrame, TrackedFrame, TrackedHand};
use handcast_vision::sighting::{JOINTS, ReadySightings, Region, Sighting};

use super::common::counted;

/// Probability of a side that a file of landmarks names.
const SURE: f64 = 0.98;
/// Frames per second of clip and landmarks that both do not say.
const FALLBACK_RATE: f64 = 30.0;
/// Share by which times that another program counted may be off, and the pictures that they may be off besides.
const NOMINAL: f64 = 0.02;
const LATE_PICTURES: f64 = 2.0;
/// Share by which the picture of a clip at another size may be longer or shorter, by whole pixels and blocks of them.
const STRETCHED: f64 = 0.02;
/// Joints of the clip lie within this of where outlines put them, in hand lengths, in half of the pictures: in the
/// three shared clips 0.07 at most, with joints of one of the others 0.10 at least.
const NEAR: f64 = 0.09;
/// The same of the wrists of true poses, which no outline has drawn near.
const NEAR_WRIST: f64 = 0.5;
/// Pictures from which on this is judged.
const ENOUGH: usize = 10;

/// Makes sure that `what`, which `file` has of some `times` (seconds from the clip's first picture, in rising order), can be
/// of the clip that `source` reads a part of.
///
/// # Errors
/// There are more of them than the clip has pictures, and they go on behind its end; none is of the part. That they go on
/// behind its end is said.
pub fn check_times(
    file: &Path,
    what: &str,
    times: &[f64],
    source: &dyn FrameSource,
    part: Part,
) -> anyhow::Result<()> {
    let info = source.info();
    let (Some(first), Some(last)) = (times.first(), times.last()) else { return Ok(()) };
    let slack = |time: f64| LATE_PICTURES / info.rate.unwrap_or(FALLBACK_RATE) + NOMINAL * time;
    let file = file.display();
    let in_part = |time: &&f64| **time >= part.from - slack(part.from) && **time < part.until;
    if !part.is_whole() && !times.iter().any(|time| in_part(&time)) {
        bail!("{file}: {what} from {first:.2} s to {last:.2} s, none of them between --from and --until");
    }
    if part.until.is_finite() {
        return Ok(());
    }
    let steady = || Some((info.before + info.frames?.checked_sub(1)?) as f64 / info.rate?);
    let Some(end) = source.times().and_then(|times| times.last().copied()).or_else(steady) else {
        return Ok(());
    };
    let behind = times.iter().filter(|time| **time > end + slack(end)).count();
    let pictures = info.frames.map(|frames| info.before + frames.max(info.told.unwrap_or(0)));
    match pictures.filter(|pictures| *pictures < times.len()) {
        _ if behind == 0 => {}
        Some(pictures) => {
            bail!(
                "{file}: {what} of {} for the {pictures} of the clip: they are of another one",
                counted(times.len(), "picture")
            );
        }
        None => errln!(
            "handcast: {file}: {what} until {last:.2} s, {behind} of {} behind the clip's last picture at {end:.2} s: are they of this clip?",
            times.len()
        ),
    }
    Ok(())
}

/// Joints that another tracker found in a clip.
pub struct Joints {
    file: PathBuf,
    sightings: ReadySightings,
    /// The joints in pixels, and when they were seen.
    frames: Vec<(f64, [[f64; 2]; JOINTS])>,
    /// Seconds by which a picture may be off.
    tolerance: f64,
    /// Width of the pictures that they lie in, pixels.
    width: f64,
}

impl Joints {
    /// Those of a file of landmarks, in the part of a clip that `source` reads.
    ///
    /// # Errors
    /// The file cannot be read or has none, or they are of another clip.
    pub fn read(path: &Path, source: &dyn FrameSource, part: Part) -> anyhow::Result<Self> {
        let clip = source.info();
        let landmarks = LandmarkClip::read(path)?;
        let right = landmarks.side.map_or(0.5, |side| if side == Side::Right { SURE } else { 1.0 - SURE });
        let placed = |image: &ImagePoints| {
            let points = LANDMARKS_21.map(|joint| image[joint.index()].map(|p| [p.x, p.y]));
            points.iter().all(Option::is_some).then(|| points.map(Option::unwrap_or_default))
        };
        let seen = |frame: &LandmarkFrame| Some((frame.time, placed(frame.image.as_ref()?)?));
        let frames: Vec<_> = landmarks.frames.iter().filter_map(seen).collect();
        if frames.is_empty() {
            bail!("{}: no frame has `image`, the places of all 21 joints in the picture", path.display());
        }
        let width = check_places(path, clip, landmarks.image_size, &frames)?;
        let times: Vec<f64> = frames.iter().map(|frame| frame.0).collect();
        check_times(path, "joints", &times, source, part)?;
        let sighted = |&(time, points): &(f64, [[f64; 2]; JOINTS])| {
            let region = Region::of_joints(&points);
            (time, vec![Sighting { points, world: None, presence: 1.0, right, region, age: 0 }])
        };
        let tolerance = 0.75 / clip.rate.or(landmarks.rate).unwrap_or(FALLBACK_RATE);
        let sightings = ReadySightings::new(frames.iter().map(sighted), tolerance);
        let sightings = sightings.in_pictures_of(width.round() as u32);
        Ok(Self { file: path.to_owned(), sightings, frames, tolerance, width })
    }

    /// A finder of hands that sees these.
    pub fn finder(&self) -> FinderSource {
        let ready = self.sightings.clone();
        FinderSource::new(move || Box::new(ready.clone()))
    }

    /// The name of the file.
    pub fn name(&self) -> String {
        self.file.display().to_string()
    }

    /// Those of a picture.
    fn at(&self, time: f64) -> Option<&[[f64; 2]; JOINTS]> {
        let (at, joints) = &self.frames[nearest_in_time(&self.frames, time, |frame| frame.0)?];
        ((at - time).abs() <= self.tolerance).then_some(joints)
    }
}

/// Makes sure that joints lie in the clip's pictures, whose width is given back: they may be of the clip at another size, where
/// the file says so.
fn check_places(
    path: &Path,
    clip: &ClipInfo,
    told: Option<[f64; 2]>,
    frames: &[(f64, [[f64; 2]; JOINTS])],
) -> anyhow::Result<f64> {
    let [clip_width, clip_height] = [clip.width, clip.height].map(f64::from);
    let [width, height] = told.unwrap_or([clip_width, clip_height]);
    let file = path.display();
    let stretched = (width * clip_height) / (height * clip_width);
    if !(1.0 - STRETCHED..=1.0 + STRETCHED).contains(&stretched) {
        bail!(
            "{file}: joints in pictures of {width} x {height}, those of the clip are {} x {}, of another shape: they are of another clip, or of this one cut or turned",
            clip.width,
            clip.height
        );
    }
    let inside = |[x, y]: &[f64; 2]| (0.0..=width).contains(x) && (0.0..=height).contains(y);
    let (mut all, mut outside) = (0, 0);
    for point in frames.iter().flat_map(|(_, points)| points) {
        all += 1;
        outside += usize::from(!inside(point));
    }
    if outside > all / 4 {
        bail!(
            "{file}: {outside} of {all} joints lie outside pictures of {width} x {height}: they are of another clip, or of this one at another size"
        );
    }
    Ok(width)
}

/// How near joints lie to those of the hands that were registered on outlines.
pub struct Nearness {
    joints: Joints,
    distances: Vec<f64>,
}

impl Nearness {
    /// Of these.
    pub fn new(joints: Joints) -> Self {
        Self { joints, distances: Vec::new() }
    }

    /// Adds a picture: the hand nearest to the joints that were given for it.
    pub fn add(&mut self, frame: &TrackedFrame<'_>) {
        let Some(given) = self.joints.at(frame.time) else { return };
        let scale = f64::from(frame.image.width()) / self.joints.width.max(1.0);
        let given = given.map(|p| p.map(|v| v * scale));
        let found = frame.hands.iter().filter(|hand| hand.found.tracked.valid).map(|hand| {
            let joints = hand.model.joints(&hand.found.tracked.state);
            apart(&given, &LANDMARKS_21.map(|joint| joints[joint.index()]))
        });
        self.distances.extend(found.min_by(f64::total_cmp));
    }

    /// What is to be said of them.
    pub fn notice(&self) -> Option<String> {
        let distance = median(&self.distances).filter(|distance| *distance > NEAR)?;
        Some(format!(
            "{}: its joints lie {distance:.2} hand lengths off those that the outlines show, in half of the pictures: are they of this clip?",
            self.joints.file.display()
        ))
    }
}

/// Mean distance of joints in a picture, in lengths of the longer of both hands.
fn apart(a: &[[f64; 2]; JOINTS], b: &[[f64; 2]; JOINTS]) -> f64 {
    let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let length = |points: &[[f64; 2]; JOINTS]| {
        [(0, 9), (9, 10), (10, 11), (11, 12)].map(|(i, j)| distance(points[i], points[j])).iter().sum::<f64>()
    };
    let off = a.iter().zip(b).map(|(a, b)| distance(*a, *b)).sum::<f64>() / JOINTS as f64;
    off / length(a).max(length(b)).max(1.0)
}

/// The middle one, of enough to judge by.
fn median(values: &[f64]) -> Option<f64> {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().filter(|_| values.len() >= ENOUGH)
}

/// What is to be said of true poses whose wrists lie elsewhere in the pictures than those of the hand that was found, where they
/// lie before the camera; both are counted from their first instant.
pub fn notice_of_truth(file: &Path, truth: &PoseClip, hand: &TrackedHand, times: &[f64]) -> Option<String> {
    let (first, begun) = (truth.frames.first()?.time, times.first()?);
    let length = hand.start.morphology.hand_length;
    let known: Vec<_> = truth.of(hand.start.side).filter(|pose| pose.valid).collect();
    let distance = |(frame, time): (&HandFrame, &f64)| {
        let time = time - begun + first;
        let nearest = known[nearest_in_time(&known, time, |pose| pose.time)?];
        let [a, b] = [nearest.pose.translation, frame.pose.translation];
        let before =
            (nearest.time - time).abs() < 0.05 && frame.tracked.valid && a.z < -length && b.z < -length;
        // Where the true wrist would be seen in the plane of the one that was found.
        before.then(|| (a.x * b.z / a.z - b.x).hypot(a.y * b.z / a.z - b.y) / length)
    };
    let distances: Vec<f64> = hand.frames.iter().zip(times).filter_map(distance).collect();
    let distance = median(&distances).filter(|distance| *distance > NEAR_WRIST)?;
    Some(format!(
        "{}: the true wrist is seen {distance:.1} hand lengths off the one that was found, in half of the pictures: are these the poses of this clip, in its camera's frame?",
        file.display()
    ))
}
