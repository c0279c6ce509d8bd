//! `.pose` files of the sign-language field (the Python package `pose-format`), versions 0.1 and 0.2.
//!
//! Little-endian. A header: version (f32), width, height, depth of the picture, number of components (u16 each); of each
//! component its name and the letters of a point (`XYZC`), numbers of points, limbs and colours (u16), the points'
//! names, the limbs as pairs, the colours as triples of u16. Texts are a u16 of bytes and these bytes in UTF-8. A body:
//! frames per second, frames, people (0.1: u16, u16, u16; 0.2: f32, u32, u16), then the coordinates of all points of all
//! people of all frames (f32), then the confidence of each (f32), 0 where it is missing.
//!
//! Hands are the components of MediaPipe Holistic, `LEFT_HAND_LANDMARKS` and `RIGHT_HAND_LANDMARKS` (pixels, z in shares of
//! the width), or OpenPose's (`hand_left_keypoints_2d`). Where `LEFT_HAND_WORLD_LANDMARKS` and its like are there (metres,
//! x right, y down, z away), poses are solved for from these. Written are both, the picture's as a camera of 60° across
//! 1000×1000 pixels sees the hand; where it is not before that camera, 0.6 m farther away, and where that does not bring it there, no picture's.

use std::io;

use nalgebra::{Point2, Point3, Vector3};

use super::axes::{Axes, Camera};
use super::{LandmarkClip, LandmarkFrame, PicturePoints, PictureUnit, Point, place};
use crate::import::FIELD_OF_VIEW;
use crate::motion::{
    Content, ContentError, Format, Keeps, Lost, Ticks, Times, WriteError, WriteOptions, Writer, sides,
    skeleton,
};
use handcast_codec::gaps;
use handcast_hand::clip::MAX_RATE;
use handcast_hand::landmarks::{JointPoints, mediapipe_21};
use handcast_hand::{HandPose, Morphology, PoseClip, Side, Skeleton, TimedPose, nearest_in_time};
use handcast_limits::{Limit, Limits};

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "pose",
    name: "joint positions (pose-format)",
    kind: "landmarks",
    ending: ".pose",
    hands: 2,
    sniff,
    read: |bytes, limits| {
        let clips = parse(bytes, limits);
        Ok(Content::Joints(clips.map_err(|what| ContentError::Foreign { format: FORMAT.id, what })?))
    },
    write: Some(Writer {
        keeps: Keeps { times: Times::Even, palm: false, ..Keeps::all(Lost::Told) },
        write: |clip, options: &WriteOptions, out| {
            let rate = options.rate_of(clip)?;
            write_pose(clip, &options.morphology, rate, PoseVersion::V0_2, out).map(|()| Vec::new())
        },
    }),
};

/// Version of a `.pose` file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseVersion {
    /// Whole frames per second, at most 65535 frames.
    V0_1,
    /// What the Python package writes.
    V0_2,
}

impl PoseVersion {
    const ALL: [Self; 2] = [Self::V0_1, Self::V0_2];

    fn number(self) -> f32 {
        match self {
            Self::V0_1 => 0.1,
            Self::V0_2 => 0.2,
        }
    }
}

/// Joints of a hand.
const POINTS: usize = 21;
/// Their names, in the order of MediaPipe.
const NAMES: [&str; POINTS] = [
    "WRIST",
    "THUMB_CMC",
    "THUMB_MCP",
    "THUMB_IP",
    "THUMB_TIP",
    "INDEX_FINGER_MCP",
    "INDEX_FINGER_PIP",
    "INDEX_FINGER_DIP",
    "INDEX_FINGER_TIP",
    "MIDDLE_FINGER_MCP",
    "MIDDLE_FINGER_PIP",
    "MIDDLE_FINGER_DIP",
    "MIDDLE_FINGER_TIP",
    "RING_FINGER_MCP",
    "RING_FINGER_PIP",
    "RING_FINGER_DIP",
    "RING_FINGER_TIP",
    "PINKY_MCP",
    "PINKY_PIP",
    "PINKY_DIP",
    "PINKY_TIP",
];
/// The joints that lines are drawn between.
const LIMBS: [[u16; 2]; 21] = [
    [0, 1],
    [1, 2],
    [2, 3],
    [3, 4],
    [0, 5],
    [5, 6],
    [6, 7],
    [7, 8],
    [5, 9],
    [9, 10],
    [10, 11],
    [11, 12],
    [9, 13],
    [13, 14],
    [14, 15],
    [15, 16],
    [13, 17],
    [17, 18],
    [18, 19],
    [19, 20],
    [0, 17],
];
/// Width and height of the picture that is written, pixels.
const PICTURE: u16 = 1000;
/// Where a hand that is not before the camera is put for its picture.
const BEFORE_CAMERA: Vector3<f64> = Vector3::new(0.0, 0.0, -0.6);
/// Nearest a joint may be to the camera to be in its picture, metres.
const NEAREST: f64 = 0.05;
/// How near the points of a space that is the camera's lie to their places in the picture, pixels.
const SAME_PIXEL: f64 = 0.05;
/// Largest depth that is a share of the picture's width.
const LARGEST_SHARE: f64 = 3.0;
/// Confidence that is written of a hand that is there, at least; 0 says that it is not.
const LEAST_CONFIDENCE: f64 = 1e-6;

/// A version of which files are read.
pub(super) fn sniff(bytes: &[u8]) -> bool {
    PoseVersion::ALL.iter().any(|version| bytes.starts_with(&version.number().to_le_bytes()))
}

/// Bytes not read yet, and how many there were.
struct Bytes<'a> {
    rest: &'a [u8],
    whole: usize,
}

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], String> {
        let at = self.whole - self.rest.len();
        let Some((taken, rest)) = self.rest.split_at_checked(count) else {
            return Err(format!(
                "it ends in {what}: {count} bytes from byte {at} on, of which {} are there",
                self.rest.len()
            ));
        };
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], String> {
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N, what)?);
        Ok(bytes)
    }

    fn u16(&mut self, what: &str) -> Result<usize, String> {
        Ok(usize::from(u16::from_le_bytes(self.array(what)?)))
    }

    fn text(&mut self, what: &str) -> Result<&'a str, String> {
        let length = self.u16(what)?;
        let at = self.whole - self.rest.len();
        std::str::from_utf8(self.take(length, what)?).map_err(|_| format!("{what} at byte {at} is no UTF-8"))
    }
}

/// Points of one kind.
struct Component<'a> {
    name: &'a str,
    /// Coordinates of a point.
    axes: usize,
    /// Number of its first point among all.
    first: usize,
    points: Vec<&'a str>,
}

struct Header<'a> {
    version: PoseVersion,
    size: [usize; 2],
    components: Vec<Component<'a>>,
    points: usize,
}

impl<'a> Component<'a> {
    /// The name of a hand's side, of a component of this kind as it is written.
    fn side(&self, kind: &str) -> Option<&'a str> {
        let side = self.name.strip_suffix(kind)?.strip_suffix("_HAND_")?;
        (self.axes == 3 && self.points == NAMES).then_some(side)
    }
}

impl Header<'_> {
    /// Whether it is as [`write_header`] writes it.
    fn is_ours(&self) -> bool {
        let (picture, space) = self.components.split_at(self.components.len() / 2);
        let same = |(picture, space): (&Component, &Component)| {
            let side = picture.side("LANDMARKS");
            side.is_some() && side == space.side("WORLD_LANDMARKS")
        };
        self.size == [usize::from(PICTURE); 2]
            && picture.len() == space.len()
            && picture.iter().zip(space).all(same)
    }
}

fn header<'a>(bytes: &mut Bytes<'a>, limits: &Limits) -> Result<Header<'a>, String> {
    let number = f32::from_le_bytes(bytes.array("the version")?);
    let version = PoseVersion::ALL.into_iter().find(|version| version.number() == number);
    let version = version.ok_or_else(|| format!("version {number}, read are 0.1 and 0.2"))?;
    let [width, height, _depth] = [(); 3].map(|()| bytes.u16("the picture's size"));
    let size = [width?, height?];
    let count = bytes.u16("the number of components")?;
    limits.check_count(Limit::Nodes, count).map_err(|e| format!("components: {e}"))?;
    let (mut components, mut points) = (Vec::new(), 0);
    for _ in 0..count {
        let name = bytes.text("a component's name")?;
        let letters = bytes.text("a component's format")?;
        let axes = match letters.strip_suffix('C') {
            Some(axes @ ("X" | "XY" | "XYZ")) => axes.len(),
            _ => return Err(format!("component {name:?} has points {letters:?}, allowed XC, XYC, XYZC")),
        };
        let [names, limbs, colors] = [(); 3].map(|()| bytes.u16("a component's counts"));
        let (names, limbs, colors) = (names?, limbs?, colors?);
        limits.check_count(Limit::Nodes, points + names).map_err(|e| format!("points: {e}"))?;
        let named = (0..names).map(|_| bytes.text("a point's name")).collect::<Result<_, _>>()?;
        bytes.take(4 * limbs, "a component's limbs")?;
        bytes.take(6 * colors, "a component's colours")?;
        components.push(Component { name, axes, first: points, points: named });
        points += names;
    }
    Ok(Header { version, size, components, points })
}

/// The numbers of a body.
struct Body<'a> {
    rate: f64,
    frames: usize,
    people: usize,
    /// Coordinates of a point.
    axes: usize,
    points: usize,
    places: &'a [u8],
    confidences: &'a [u8],
}

fn body<'a>(mut bytes: Bytes<'a>, header: &Header, limits: &Limits) -> Result<Body<'a>, String> {
    let (rate, mut frames) = match header.version {
        PoseVersion::V0_1 => (bytes.u16("the frame rate")? as f64, bytes.u16("the number of frames")?),
        PoseVersion::V0_2 => {
            let rate = f64::from(f32::from_le_bytes(bytes.array("the frame rate")?));
            (rate, u32::from_le_bytes(bytes.array("the number of frames")?) as usize)
        }
    };
    let people = bytes.u16("the number of people")?;
    if !(rate > 0.0 && rate <= MAX_RATE) {
        return Err(format!("{rate} frames per second, allowed above 0 to {MAX_RATE}"));
    }
    let axes = header.components.iter().map(|component| component.axes).max().unwrap_or(0);
    let of_frame = people * header.points * (axes + 1) * 4;
    // Version 0.1 counts frames in 16 bits; what is there says how often these went round.
    if header.version == PoseVersion::V0_1 && of_frame > 0 {
        let there = bytes.rest.len() / of_frame;
        if there > frames && (there - frames).is_multiple_of(1 << 16) {
            frames = there;
        }
    }
    limits.check_count(Limit::Instants, frames).map_err(|e| e.to_string())?;
    let wanted = frames as u128 * of_frame as u128;
    if bytes.rest.len() as u128 != wanted {
        return Err(format!(
            "{frames} frames of {people} people with {} points are {wanted} bytes, {} follow the header",
            header.points,
            bytes.rest.len()
        ));
    }
    let places = bytes.take(frames * people * header.points * axes * 4, "the points")?;
    Ok(Body { rate, frames, people, axes, points: header.points, places, confidences: bytes.rest })
}

impl Body<'_> {
    fn float(bytes: &[u8], at: usize) -> f64 {
        let float = bytes.get(4 * at..4 * at + 4).and_then(|b| b.try_into().ok()).map(f32::from_le_bytes);
        float.map_or(0.0, f64::from)
    }

    /// A point of a person in a frame, with its confidence; `None` where it is missing.
    fn point(&self, frame: usize, person: usize, point: usize) -> Option<([f64; 3], f64)> {
        let at = (frame * self.people + person) * self.points + point;
        let confidence = Self::float(self.confidences, at);
        let axis = |k: usize| if k < self.axes { Self::float(self.places, at * self.axes + k) } else { 0.0 };
        let place = [axis(0), axis(1), axis(2)];
        (confidence > 0.0 && place.iter().all(|v| v.is_finite())).then_some((place, confidence))
    }
}

/// Of each joint the number of its point among all; `None` of joints that the component lacks.
fn points_of(component: &Component) -> Result<[Option<usize>; POINTS], String> {
    let named = NAMES.map(|name| component.points.iter().position(|point| *point == name));
    if named.iter().any(Option::is_some) {
        return Ok(named.map(|at| at.map(|at| component.first + at)));
    }
    // Other names, the usual order.
    if component.points.len() != POINTS {
        let count = component.points.len();
        return Err(format!("component {:?} has {count} points, expected {POINTS}", component.name));
    }
    Ok(std::array::from_fn(|i| Some(component.first + i)))
}

/// A hand's components.
struct HandParts {
    side: Side,
    picture: Option<[Option<usize>; POINTS]>,
    deep: bool,
    world: Option<[Option<usize>; POINTS]>,
}

fn parts(header: &Header, side: Side) -> Result<Option<HandParts>, String> {
    let upper = side.name().to_ascii_uppercase();
    let lower = side.name();
    let find = |names: [String; 2]| {
        header.components.iter().find(|component| names.iter().any(|name| name == component.name))
    };
    let picture = find([format!("{upper}_HAND_LANDMARKS"), format!("hand_{lower}_keypoints_2d")]);
    let world = find([format!("{upper}_HAND_WORLD_LANDMARKS"), format!("{upper}_WORLD_HAND_LANDMARKS")]);
    if picture.is_none() && world.is_none() {
        return Ok(None);
    }
    let deep = picture.is_some_and(|component| component.axes == 3);
    let [picture, world] = [picture, world].map(|part| part.map(points_of).transpose());
    Ok(Some(HandParts { side, picture: picture?, deep, world: world? }))
}

/// The hands of a file, one or two recordings, of the first person who shows any.
pub(super) fn parse(file: &[u8], limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    let mut bytes = Bytes { rest: file, whole: file.len() };
    let header = header(&mut bytes, limits)?;
    let body = body(bytes, &header, limits)?;
    limits.check_frames(body.frames, file.len() as u64).map_err(|e| e.to_string())?;
    let mut hands = Vec::new();
    for side in [Side::Left, Side::Right] {
        hands.extend(parts(&header, side)?);
    }
    if hands.is_empty() {
        let names: Vec<&str> = header.components.iter().map(|component| component.name).take(20).collect();
        return Err(format!("no component is a hand (LEFT_HAND_LANDMARKS, RIGHT_HAND_LANDMARKS): {names:?}"));
    }
    let clips = |person: usize| -> Result<Vec<LandmarkClip>, String> {
        let clips = hands.iter().map(|hand| clip_of(hand, person, &header, &body));
        Ok(clips.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    };
    for person in 0..body.people {
        let mut found = clips(person)?;
        if found.is_empty() {
            continue;
        }
        check_pixels(&found, header.size)?;
        let frames = || found.iter().flat_map(|clip| &clip.frames);
        if frames().all(|frame| frame.confidence.is_none_or(|confidence| confidence == 1.0)) {
            // Detectors that know no confidence say 1 of all that is there.
            found.iter_mut().flat_map(|clip| &mut clip.frames).for_each(|frame| frame.confidence = None);
        }
        return Ok(found);
    }
    Err("no frame has a hand".into())
}

/// Hands narrower than this are none of a picture, pixels.
const NARROWEST: f64 = 8.0;

/// That hands are as wide as what is seen in a picture of this size; those that are where their camera is may be far away.
fn check_pixels(clips: &[LandmarkClip], size: [usize; 2]) -> Result<(), String> {
    let seen = clips.iter().filter(|clip| clip.centred || clip.frames.iter().all(|f| f.points == [None; 25]));
    let images = seen.flat_map(|clip| clip.frames.iter().filter_map(|frame| frame.image.as_ref()));
    let width = |image: &[Option<Point2<f64>>; 25]| {
        let extent = |axis: usize| {
            let values = image.iter().flatten().map(|p| p[axis]);
            values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
        };
        extent(0).max(extent(1))
    };
    let widest = images.map(width).reduce(f64::max);
    match widest
        .filter(|widest| (f64::MIN_POSITIVE..NARROWEST).contains(widest) && size[0] as f64 > 4.0 * NARROWEST)
    {
        Some(widest) => Err(format!(
            "hands are {widest:.1} pixels wide at most in a picture of {} × {}, allowed are {NARROWEST} and more: places that \
             were normalised, as by pose.normalize() of pose-format, are none in a picture; take the file as it was before that",
            size[0], size[1]
        )),
        None => Ok(()),
    }
}

/// What a person's hand does; `None` if it is never there.
fn clip_of(
    hand: &HandParts,
    person: usize,
    header: &Header,
    body: &Body,
) -> Result<Option<LandmarkClip>, String> {
    let depth_unit = depth_unit(hand, person, header, body);
    let mut clip = LandmarkClip {
        rate: Some(body.rate),
        side: Some(hand.side),
        points_per_frame: POINTS,
        axes: Axes::Mediapipe,
        tips_inside: true,
        image_size: header.size.iter().all(|v| *v > 0).then(|| header.size.map(|v| v as f64)),
        metres: Some(1.0),
        ..LandmarkClip::default()
    };
    let mut seen = false;
    for frame in 0..body.frames {
        let part = |part: &Option<[Option<usize>; POINTS]>| {
            part.map(|points| points.map(|point| body.point(frame, person, point?)))
        };
        let (picture, world) = (part(&hand.picture), part(&hand.world));
        let placed = |points: [Option<([f64; 3], f64)>; POINTS], depth: f64| -> Result<JointPoints, String> {
            let points: Vec<Point> = points.map(|p| p.map(|([x, y, z], _)| [x, y, z * depth])).to_vec();
            place(&points, POINTS).map_err(|what| format!("frame {frame}: {} hand: {what}", hand.side.name()))
        };
        let there = |points: &[Option<([f64; 3], f64)>; POINTS]| points.iter().any(Option::is_some);
        let (picture, world) = (picture.filter(there), world.filter(there));
        let confidences: Vec<f64> =
            world.or(picture).iter().flatten().flatten().map(|(_, confidence)| *confidence).collect();
        let mean = confidences.iter().sum::<f64>() / confidences.len().max(1) as f64;
        seen |= !confidences.is_empty();
        let time = frame as f64 / body.rate;
        let points = world.map_or(Ok([None; 25]), |points| placed(points, 1.0))?;
        let picture = picture.map(|points| placed(points, depth_unit)).transpose()?;
        clip.frames.push(LandmarkFrame {
            image: picture.map(|points| points.map(|p| p.map(|p| p.xy()))),
            picture: picture
                .map(|points| Box::new(PicturePoints { unit: PictureUnit::Pixels, deep: hand.deep, points })),
            confidence: (!confidences.is_empty()).then_some(mean),
            ..LandmarkFrame::of(time, points)
        });
    }
    clip.centred = hand.world.is_some() && !in_camera_space(&clip).unwrap_or_else(|| header.is_ours());
    Ok(seen.then_some(clip))
}

/// Pixels of a unit of depth in the picture: its width where depths are shares of it, as MediaPipe gives them.
fn depth_unit(hand: &HandParts, person: usize, header: &Header, body: &Body) -> f64 {
    let Some(points) = hand.picture else { return 1.0 };
    let largest = (0..body.frames)
        .flat_map(|frame| points.into_iter().filter_map(move |point| body.point(frame, person, point?)))
        .fold([0.0f64; 2], |[x, z], (p, _)| [x.max(p[0].abs()), z.max(p[2].abs())]);
    match largest {
        [x, z] if x > LARGEST_SHARE && z <= LARGEST_SHARE => header.size[0].max(1) as f64,
        _ => 1.0,
    }
}

/// Whether points in space lie where a camera as that of written files sees them in the picture: then they say where the
/// hand is. `None` where no point is in both.
fn in_camera_space(clip: &LandmarkClip) -> Option<bool> {
    let pairs = || {
        clip.frames.iter().flat_map(|frame| {
            let image = frame.image.as_ref().into_iter().flatten();
            frame.points.iter().zip(image).filter_map(|(p, seen)| Some(((*p)?, (*seen)?)))
        })
    };
    pairs().next()?;
    let camera = Camera::new(clip.image_size?, FIELD_OF_VIEW);
    Some([Vector3::zeros(), BEFORE_CAMERA].into_iter().any(|moved| {
        pairs().all(|(p, seen)| {
            let p = Axes::Mediapipe.to_webxr(p) + moved;
            p.z < 0.0 && (camera.seen(p) - seen).norm() < SAME_PIXEL
        })
    }))
}

/// Writes the poses of a clip at `rate` frames a second from its first instant on. Hands of unknown sizes get those of
/// `fallback`.
///
/// # Errors
/// [`WriteError::Empty`], [`WriteError::Rate`] (version 0.1 has whole frames per second up to 65535),
/// [`WriteError::Excess`] of frames that the version cannot count, [`WriteError::Io`].
pub fn write_pose(
    clip: &PoseClip,
    fallback: &Morphology,
    rate: f64,
    version: PoseVersion,
    mut out: impl io::Write,
) -> Result<(), WriteError> {
    let whole = version == PoseVersion::V0_1;
    if whole && rate.fract() != 0.0 {
        return Err(WriteError::Rate { rate });
    }
    let ticks = Ticks::of(clip, rate)?;
    let sides = sides(clip);
    let count = ticks.count;
    let most = if whole { usize::from(u16::MAX) } else { u32::MAX as usize };
    Limits::default().with_instants(most as u64).check_count(Limit::Instants, count)?;
    let hands: Vec<(Side, Skeleton)> =
        sides.into_iter().map(|side| (side, skeleton(clip, side, fallback))).collect();
    let mut poses: Vec<Vec<Option<Tick>>> = vec![vec![None; count]; hands.len()];
    for (track, (side, _)) in poses.iter_mut().zip(&hands) {
        let given: Vec<&TimedPose> = clip.of(*side).collect();
        let gaps = gaps(clip, *side);
        for frame in ticks.even.of(*side) {
            // Whether a hand is there, and how surely, is not interpolated.
            let near = nearest_in_time(&given, frame.time, |given| given.time).map(|at| given[at]);
            let gap = gaps.get(gaps.partition_point(|gap| gap.to < frame.time));
            let missing = |given: &TimedPose| {
                let off = (given.time - frame.time).abs();
                gap.is_some_and(|gap| gap.from < frame.time && off > gap.step() / 2.0)
            };
            let there = near.filter(|given| given.valid && !missing(given));
            track[ticks.at(frame.time)] =
                there.map(|given| Tick { pose: &frame.pose, confidence: given.confidence.unwrap_or(1.0) });
        }
    }
    write_header(&hands, version, &mut out)?;
    match version {
        PoseVersion::V0_1 => {
            out.write_all(&(rate as u16).to_le_bytes())?;
            out.write_all(&(count as u16).to_le_bytes())?;
        }
        PoseVersion::V0_2 => {
            out.write_all(&(rate as f32).to_le_bytes())?;
            out.write_all(&(count as u32).to_le_bytes())?;
        }
    }
    out.write_all(&1u16.to_le_bytes())?;
    write_points(&hands, &poses, count, &mut out)
}

/// A hand at an instant of even ones.
#[derive(Clone, Copy)]
struct Tick<'a> {
    pose: &'a HandPose,
    confidence: f64,
}

fn write_text(text: &str, out: &mut impl io::Write) -> io::Result<()> {
    out.write_all(&(text.len() as u16).to_le_bytes())?;
    out.write_all(text.as_bytes())
}

/// Of each hand the component of its picture, then of each that of its space.
fn write_header(
    hands: &[(Side, Skeleton)],
    version: PoseVersion,
    out: &mut impl io::Write,
) -> io::Result<()> {
    out.write_all(&version.number().to_le_bytes())?;
    for number in [PICTURE, PICTURE, PICTURE, 2 * hands.len() as u16] {
        out.write_all(&number.to_le_bytes())?;
    }
    for kind in ["LANDMARKS", "WORLD_LANDMARKS"] {
        for (side, _) in hands {
            write_text(&format!("{}_HAND_{kind}", side.name().to_ascii_uppercase()), out)?;
            write_text("XYZC", out)?;
            for number in [NAMES.len(), LIMBS.len(), 1] {
                out.write_all(&(number as u16).to_le_bytes())?;
            }
            NAMES.iter().try_for_each(|name| write_text(name, out))?;
            for number in LIMBS.into_iter().flatten() {
                out.write_all(&number.to_le_bytes())?;
            }
            let color: [u16; 3] = if *side == Side::Left { [0, 170, 90] } else { [220, 110, 0] };
            for number in color {
                out.write_all(&number.to_le_bytes())?;
            }
        }
    }
    Ok(())
}

fn write_points(
    hands: &[(Side, Skeleton)],
    poses: &[Vec<Option<Tick>>],
    count: usize,
    out: &mut impl io::Write,
) -> Result<(), WriteError> {
    let joints = |hand: usize, frame: usize| {
        let pose = poses[hand][frame]?;
        let frames = hands[hand].1.frames(pose.pose);
        Some(mediapipe_21(|joint| frames.position(joint)))
    };
    let camera = Camera::new([f64::from(PICTURE); 2], FIELD_OF_VIEW);
    let mut nearest = f64::NEG_INFINITY;
    for (hand, i) in (0..hands.len()).flat_map(|hand| (0..count).map(move |i| (hand, i))) {
        nearest = joints(hand, i).iter().flatten().fold(nearest, |nearest, p| nearest.max(p.z));
    }
    let mut places = [Vector3::zeros(), BEFORE_CAMERA].into_iter();
    let moved = places.find(|moved| nearest + moved.z < -NEAREST);
    for i in 0..count {
        for hand in 0..hands.len() {
            let points = moved.and_then(|moved| Some(joints(hand, i)?.map(|p| p + moved)));
            let points = points.map(|all| all.map(|p| in_picture(&camera, p, &all[0])));
            write_floats(points, out)?;
        }
        for hand in 0..hands.len() {
            write_floats(joints(hand, i).map(|all| all.map(|p| [p.x, -p.y, -p.z])), out)?;
        }
    }
    for i in 0..count {
        for there in [moved.is_some(), true] {
            for track in poses {
                let sure = |tick: Tick| tick.confidence.max(LEAST_CONFIDENCE);
                let confidence = track[i].filter(|_| there).map_or(0.0, sure) as f32;
                for _ in 0..POINTS {
                    out.write_all(&confidence.to_le_bytes())?;
                }
            }
        }
    }
    Ok(())
}

/// A joint as MediaPipe gives it: pixels, and how much farther away than the wrist, in shares of the picture's width.
fn in_picture(camera: &Camera, p: Point3<f64>, wrist: &Point3<f64>) -> [f64; 3] {
    let seen = camera.seen(p);
    let depth = (wrist.z - p.z) * camera.focal() / -wrist.z / f64::from(PICTURE);
    [seen.x, seen.y, depth]
}

fn write_floats(points: Option<[[f64; 3]; POINTS]>, out: &mut impl io::Write) -> io::Result<()> {
    for value in points.unwrap_or([[0.0; 3]; POINTS]).into_iter().flatten() {
        out.write_all(&(value as f32).to_le_bytes())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Motion;
    use crate::motion::tests::two_hands;
    use handcast_hand::PoseHeader;
    use proptest::prelude::*;

    /// A file of a few frames of both hands.
    fn file(version: PoseVersion) -> Vec<u8> {
        let mut clip = two_hands();
        clip.frames.retain(|frame| frame.time < 0.3);
        let mut bytes = Vec::new();
        write_pose(&clip, &Morphology::default(), 25.0, version, &mut bytes).unwrap();
        bytes
    }

    fn read(bytes: &[u8]) -> Result<Vec<LandmarkClip>, String> {
        parse(bytes, &Limits::default())
    }

    proptest! {
        #[test]
        fn damaged_files_are_refused_or_read_but_never_panic(
            flips in prop::collection::vec((0usize..4000, any::<u8>()), 0..4),
            cut in 0usize..4000,
            old in any::<bool>(),
        ) {
            let whole = file(if old { PoseVersion::V0_1 } else { PoseVersion::V0_2 });
            let mut bytes = whole.clone();
            for (at, byte) in flips {
                let n = bytes.len();
                bytes[at % n] ^= byte;
            }
            if let Ok(clips) = read(&bytes) {
                prop_assert!(clips.len() <= 2);
            }
            bytes.truncate(cut % whole.len());
            prop_assert!(read(&bytes).is_err(), "nothing behind the header may be missing");
        }

        #[test]
        fn what_is_written_is_read_again(
            confidences in prop::collection::vec(
                prop_oneof![Just(None), Just(Some(1.0)), (0.0f64..1.0).prop_map(Some)],
                2..20,
            ),
            at in prop::array::uniform3(-0.3f64..0.3),
            turn in prop::array::uniform3(-3.0f64..3.0),
            left in any::<bool>(),
        ) {
            let side = if left { Side::Left } else { Side::Right };
            let mut clip = PoseClip { header: PoseHeader::one(side, None, Some(30.0)), frames: Vec::new() };
            for (i, confidence) in confidences.into_iter().enumerate() {
                let mut pose = HandPose::neutral(side);
                pose.translation = Vector3::from(at);
                pose.rotation = nalgebra::UnitQuaternion::from_euler_angles(turn[0], turn[1], turn[2]);
                let frame = TimedPose::new(i as f64 / 30.0, pose);
                clip.frames.push(TimedPose { confidence, ..frame });
            }
            let doubtful = clip.frames.iter().any(|frame| frame.confidence.is_some_and(|c| (c as f32) < 1.0));
            let mut bytes = Vec::new();
            write_pose(&clip, &Morphology::default(), 30.0, PoseVersion::V0_2, &mut bytes).unwrap();
            let back = Motion::parse("x".as_ref(), &bytes).unwrap();
            prop_assert!(back.placed);
            prop_assert_eq!(back.clip.frames.len(), clip.frames.len());
            for (a, b) in clip.frames.iter().zip(&back.clip.frames) {
                prop_assert!((a.pose.translation - b.pose.translation).norm() < 1e-5);
                prop_assert!(a.pose.rotation.angle_to(&b.pose.rotation) < 1e-3);
                let sure = a.confidence.map_or(1.0, |c| c.max(LEAST_CONFIDENCE));
                prop_assert!((b.confidence.unwrap_or(1.0) - sure).abs() < 1e-6);
                prop_assert_eq!(b.confidence.is_some(), doubtful);
            }
        }
    }

    #[test]
    fn normalised_places_are_refused() {
        let mut bytes = file(PoseVersion::V0_2);
        let mut read_on = Bytes { rest: &bytes, whole: bytes.len() };
        let head = header(&mut read_on, &Limits::default()).unwrap();
        let numbers = body(read_on, &head, &Limits::default()).unwrap().places.len() / 4;
        // Coordinates and confidences end the file.
        let start = bytes.len() - numbers * 4 - numbers / 3 * 4;
        for float in bytes[start..start + numbers * 4].chunks_exact_mut(4) {
            let value = f32::from_le_bytes([float[0], float[1], float[2], float[3]]);
            float.copy_from_slice(&(value / 200.0).to_le_bytes());
        }
        let said = read(&bytes).unwrap_err();
        assert!(said.contains("pixels wide at most in a picture of 1000 × 1000"), "{said}");
        assert!(said.contains("pose.normalize()"), "{said}");
    }

    #[test]
    fn where_there_is_no_pose_there_is_no_hand() {
        let mut clip = crate::motion::tests::clip(&[Side::Right]);
        clip.frames.drain(8..18);
        // Twice as many frames as there are poses: a hand between two of them is there.
        for (rate, missing) in [(25.0, 10), (50.0, 19)] {
            let mut bytes = Vec::new();
            write_pose(&clip, &Morphology::default(), rate, PoseVersion::V0_2, &mut bytes).unwrap();
            let read = read(&bytes).unwrap();
            let there = |frame: &&LandmarkFrame| frame.points.iter().any(Option::is_some);
            let absent: Vec<f64> = read[0].frames.iter().filter(|f| !there(f)).map(|f| f.time).collect();
            assert!(absent.len().abs_diff(missing) <= 2, "{rate}: {absent:?}");
            assert!(absent.iter().all(|time| (0.28..0.72).contains(time)), "{rate}: {absent:?}");
            assert!(read[0].frames.iter().filter(there).all(|f| f.confidence.is_none_or(|c| c == 1.0)));
        }
    }

    #[test]
    fn both_versions_say_the_same() {
        let [old, new] = [PoseVersion::V0_1, PoseVersion::V0_2].map(|version| read(&file(version)).unwrap());
        assert_eq!(old, new);
        assert_eq!(
            old.iter().map(|clip| clip.side).collect::<Vec<_>>(),
            [Some(Side::Left), Some(Side::Right)]
        );
        assert_eq!(old[0].frames.len(), 8);
        // The right hand comes three frames later.
        let seen = old[1].frames.iter().map(|frame| frame.points[0].is_some());
        assert_eq!(seen.collect::<Vec<_>>(), [false, false, false, true, true, true, true, true]);
        let refused = write_pose(&two_hands(), &Morphology::default(), 29.97, PoseVersion::V0_1, Vec::new());
        assert!(matches!(refused, Err(WriteError::Rate { .. })));
    }

    /// A file of one component, XYC, of one person in one frame.
    fn plain(version: f32, name: &str, count: u16, frames: u32, more: usize) -> Vec<u8> {
        let mut bytes = version.to_le_bytes().to_vec();
        [640u16, 480, 0, 1].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        write_text(name, &mut bytes).unwrap();
        write_text("XYC", &mut bytes).unwrap();
        [count, 0, 0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        (0..count).for_each(|i| write_text(&format!("P{i}"), &mut bytes).unwrap());
        bytes.extend(25f32.to_le_bytes());
        bytes.extend(frames.to_le_bytes());
        bytes.extend(1u16.to_le_bytes());
        bytes.extend(vec![0x3e; more]);
        bytes
    }

    #[test]
    fn points_in_space_alone_do_not_say_where_the_hand_is() {
        let world = read(&plain(0.2, "LEFT_HAND_WORLD_LANDMARKS", 21, 1, 12 * 21)).unwrap();
        assert!(world[0].centred);
        // Behind the camera of a file that is written there is no picture.
        let mut clip = two_hands();
        clip.frames.iter_mut().for_each(|frame| frame.pose.translation.z += 2.0);
        let mut bytes = Vec::new();
        write_pose(&clip, &Morphology::default(), 25.0, PoseVersion::V0_2, &mut bytes).unwrap();
        let ours = read(&bytes).unwrap();
        assert!(ours.iter().all(|clip| !clip.centred && clip.frames.iter().all(|f| f.image.is_none())));
        // The same of another picture, which says nothing.
        bytes[4..6].copy_from_slice(&640u16.to_le_bytes());
        assert!(read(&bytes).unwrap().iter().all(|clip| clip.centred));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let of = |count: usize| 12 * count;
        for (bytes, words) in [
            (plain(0.3, "x", 1, 1, of(1)), "version 0.3, read are 0.1 and 0.2"),
            (plain(0.2, "x", 1, 1, of(1)), "no component is a hand"),
            (plain(0.2, "LEFT_HAND_LANDMARKS", 20, 1, of(20)), "20 points, expected 21"),
            (plain(0.2, "LEFT_HAND_LANDMARKS", 21, 1, of(21) - 4), "are 252 bytes, 248 follow"),
            (plain(0.2, "LEFT_HAND_LANDMARKS", 21, u32::MAX, of(21)), "instants, allowed at most 110000"),
            (plain(0.2, "LEFT_HAND_LANDMARKS", 21, 0, 0), "no frame has a hand"),
            (plain(0.2, "x", 20_000, 1, of(20_000)), "points: 20000 nodes, allowed at most 10000"),
            (0.2f32.to_le_bytes().to_vec(), "it ends in the picture's size: 2 bytes from byte 4 on"),
        ] {
            let message = read(&bytes).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
        // OpenPose's points have the same order, in the picture alone.
        let clips = read(&plain(0.2, "hand_right_keypoints_2d", 21, 2, 2 * of(21))).unwrap();
        assert_eq!((clips.len(), clips[0].side, clips[0].frames.len()), (1, Some(Side::Right), 2));
        assert!(clips[0].frames[0].points.iter().all(Option::is_none) && clips[0].frames[0].image.is_some());
    }
}
