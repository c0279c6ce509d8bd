//! WebXR-shaped frames: the joints of one hand or two as WebXR Hand Input gives them, as one JSON document.
//!
//! ```text
//! {"format":"webxr-hands","unit":"m","fps":30,"frames":[
//!  {"time":0.0,"hands":[{"handedness":"right","joints":[
//!   {"jointName":"wrist","radius":0.013,
//!    "transform":{"orientation":{"x":0,"y":0,"z":0,"w":1},"position":{"x":0.01,"y":-0.2,"z":-0.5,"w":1}}},
//!   …]}]},…]}
//! ```
//!
//! Joints are shaped like `XRJointPose` and named like `XRHandJoint`, with the axes of WebXR: −Z along the bone, +Y out
//! of the back of the hand. Written are 25 joints in their order; radii are those of the person's sizes, of wrist and
//! metacarpals half the palm's thickness. Read are any joints; `orientation` and `radius` may be missing. Where all
//! joints have orientations that our hand can take, as those of our own files, they give the joint angles; otherwise
//! poses are solved for from the positions.

use std::cell::Cell;
use std::fmt::{self, Formatter};
use std::io::{self, BufReader, Read, Write};
use std::marker::PhantomData;

use nalgebra::{Point3, Quaternion, UnitQuaternion};
use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::{Value, json};

use super::{LandmarkClip, LandmarkFrame, Point, RATE, check_time, place, tell_absences, told_time};
use crate::motion::format::{head, says};
use crate::motion::{
    Content, ContentError, Format, Keeps, Lost, Motion, WriteError, WriteOptions, Writer, rounded, sides,
    skeleton,
};
use crate::whole::Counted;
use handcast_hand::landmarks::{JointPoints, measure_posed};
use handcast_hand::turns::{PosesFromTurns, ours_from_webxr};
use handcast_hand::{
    ClipHand, Finger, HandPose, Joint, Morphology, PoseClip, PoseHeader, Side, Skeleton, TimedPose,
};
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "webxr",
    name: "joint positions and orientations (WebXR)",
    kind: "landmarks",
    ending: ".webxr.json",
    hands: 2,
    sniff,
    read,
    write: Some(Writer {
        keeps: Keeps::all(Lost::LeftOut),
        write: |clip, o: &WriteOptions, out| write_webxr(clip, &o.morphology, out).map(|()| Vec::new()),
    }),
};

/// What a document says of its format.
pub const NAME: &str = "webxr-hands";
/// Its unit.
const METRE: &str = "m";
/// Digits after the point of all numbers but times.
const DIGITS: i32 = 7;
/// How far the orientation of a joint may be from that of our hand in the same pose, radians: some digits more than
/// are written.
const TOLERANCE: f64 = 1e-5;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct NamedJoint {
    joint_name: String,
    transform: Transform,
}

#[derive(Deserialize)]
struct Transform {
    position: Position,
    orientation: Option<Orientation>,
}

#[derive(Deserialize)]
struct Position {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Deserialize)]
struct Orientation {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

pub(super) fn sniff(bytes: &[u8]) -> bool {
    head(bytes).starts_with(b"{") && says(head(bytes), NAME)
}

/// What is read of a document, frame by frame: of a frame no more is held than two hands have.
struct Reading<'a> {
    limits: &'a Limits,
    /// How many bytes of the document are read, or at hand.
    bytes: &'a Cell<u64>,
    facts: Facts,
    /// Frames so far.
    frames: usize,
    /// Their times, seconds, or their numbers where they are `untimed`.
    instants: Vec<f64>,
    untimed: bool,
    /// The positions of each hand's joints; hands in the order in which they appear.
    clips: Vec<LandmarkClip>,
    /// The poses that the orientations tell; `None` where they are not asked for, some are missing or are not those of our hand.
    poses: Option<Vec<TimedPose>>,
    turns: [Option<(Skeleton, PosesFromTurns)>; 2],
    /// What is wrong with a frame.
    error: Option<String>,
}

/// What a document says beside its frames.
#[derive(Default)]
struct Facts {
    format: Option<String>,
    unit: Option<String>,
    fps: Option<f64>,
    /// Whether there were frames, if only an empty list.
    frames: bool,
}

/// The recordings of a document, and its poses where `turns` are asked for and tell them.
fn document<'de, D>(
    input: D,
    (limits, bytes): (&Limits, &Cell<u64>),
    turns: bool,
) -> Result<(Vec<LandmarkClip>, Option<Vec<TimedPose>>), String>
where
    D: Deserializer<'de, Error = serde_json::Error>,
{
    let mut reading = Reading {
        limits,
        bytes,
        facts: Facts::default(),
        frames: 0,
        instants: Vec::new(),
        untimed: false,
        clips: Vec::new(),
        poses: turns.then(Vec::new),
        turns: [None, None],
        error: None,
    };
    let read = input.deserialize_map(Top(&mut reading));
    let Reading { facts: Facts { format, unit, fps, frames }, error, untimed, .. } = &mut reading;
    let (format, unit, fps, frames, untimed) = (format.take(), unit.take(), *fps, *frames, *untimed);
    let error = error.take();
    let told = |wrong: serde_json::Error| {
        // Where reading itself failed no place in the text is wrong.
        if wrong.is_io() { io::Error::from(wrong).to_string() } else { wrong.to_string() }
    };
    read.map_err(|wrong| error.unwrap_or_else(|| told(wrong)))?;
    for (what, said, allowed) in [("format", format, NAME), ("unit", unit, METRE)] {
        let said = said.ok_or_else(|| format!("{what} is missing"))?;
        if said != allowed {
            return Err(format!("{what} is {said:?}, allowed {allowed:?}"));
        }
    }
    if !frames {
        return Err("frames are missing".into());
    }
    let Reading { mut clips, mut instants, mut poses, .. } = reading;
    if let Some(rate) = fps.filter(|rate| !(*rate > 0.0 && *rate <= 10_000.0)) {
        return Err(format!("fps is {rate}, allowed above 0 to 10000"));
    }
    let rate = fps.or(untimed.then_some(RATE));
    if let Some(rate) = rate.filter(|_| untimed) {
        let times = clips.iter_mut().flat_map(|clip| &mut clip.frames).map(|frame| &mut frame.time);
        let found = poses.iter_mut().flatten().map(|pose| &mut pose.time);
        times.chain(found).chain(&mut instants).for_each(|time| *time /= rate);
    }
    for clip in &mut clips {
        (clip.rate, clip.rate_assumed) = (rate, untimed && fps.is_none());
    }
    tell_absences(&mut clips, instants);
    if clips.is_empty() { Err("no frame has a hand".into()) } else { Ok((clips, poses)) }
}

/// The recordings of a document that is read piece by piece.
pub(super) fn clips(reader: impl Read, limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    let counted = Counted::new(reader, limits);
    let bytes = counted.count();
    let mut input = serde_json::Deserializer::from_reader(BufReader::new(counted));
    let (clips, _) = document(&mut input, (limits, &bytes), false)?;
    input.end().map_err(|error| error.to_string())?;
    Ok(clips)
}

/// The whole document.
struct Top<'a, 'b>(&'a mut Reading<'b>);

impl<'de> Visitor<'de> for Top<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str("an object with frames")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(name) = map.next_key::<String>()? {
            let facts = &mut self.0.facts;
            match name.as_str() {
                "format" => facts.format = Some(map.next_value()?),
                "unit" => facts.unit = Some(map.next_value()?),
                "fps" => facts.fps = map.next_value()?,
                "frames" if facts.frames => return Err(A::Error::duplicate_field("frames")),
                "frames" => {
                    facts.frames = true;
                    map.next_value_seed(Frames(&mut *self.0))?;
                }
                _ => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        Ok(())
    }
}

/// The list of frames.
struct Frames<'a, 'b>(&'a mut Reading<'b>);

impl<'de> DeserializeSeed<'de> for Frames<'_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        let Self(reading) = self;
        each(deserializer, "a list of frames", |frame: Frame| {
            reading.take(&frame).map_err(|what| {
                reading.error = Some(what);
                "a frame".to_owned()
            })
        })
    }
}

/// Hands the elements of a list to `take`, one by one.
fn each<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    list: D,
    name: &'static str,
    take: impl FnMut(T) -> Result<(), String>,
) -> Result<(), D::Error> {
    list.deserialize_seq(Elements { name, take, of: PhantomData })
}

struct Elements<T, F> {
    /// What the list is.
    name: &'static str,
    take: F,
    of: PhantomData<T>,
}

impl<'de, T: Deserialize<'de>, F: FnMut(T) -> Result<(), String>> Visitor<'de> for Elements<T, F> {
    type Value = ();

    fn expecting(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<(), A::Error> {
        while let Some(element) = list.next_element()? {
            (self.take)(element).map_err(A::Error::custom)?;
        }
        Ok(())
    }
}

#[derive(Deserialize)]
struct Frame {
    time: Option<f64>,
    hands: Hands,
}

/// Hands in a frame.
struct Hands(Vec<Hand>);

/// Most hands in a frame.
const HANDS: usize = 2;

impl<'de> Deserialize<'de> for Hands {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut hands = Vec::with_capacity(HANDS);
        each(deserializer, "a list of hands", |hand| {
            if hands.len() == HANDS {
                return Err(format!("more than the {HANDS} hands allowed in a frame"));
            }
            hands.push(hand);
            Ok(())
        })?;
        Ok(Self(hands))
    }
}

#[derive(Deserialize)]
struct Hand {
    handedness: Side,
    joints: Joints,
}

/// The joints of a hand, each by its place in [`Joint::ALL`], or what is wrong with their names.
struct Joints(Result<Box<[Option<Transform>; 25]>, String>);

impl<'de> Deserialize<'de> for Joints {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut joints = Ok(Box::new([const { None }; 25]));
        each(deserializer, "a list of joints", |joint: NamedJoint| {
            if let Ok(places) = &mut joints
                && let Err(wrong) = joint.into_place(places)
            {
                joints = Err(wrong);
            }
            Ok(())
        })?;
        Ok(Self(joints))
    }
}

impl NamedJoint {
    fn into_place(self, joints: &mut [Option<Transform>; 25]) -> Result<(), String> {
        let Self { joint_name, transform } = self;
        let known = Joint::ALL.into_iter().find(|known| known.webxr_name() == joint_name);
        let known = known.ok_or_else(|| format!("no joint is called {joint_name:?}"))?;
        match joints[known.index()].replace(transform) {
            Some(_) => Err(format!("two joints are called {joint_name:?}")),
            None => Ok(()),
        }
    }
}

impl Reading<'_> {
    /// Takes in a frame.
    fn take(&mut self, frame: &Frame) -> Result<(), String> {
        let i = self.frames;
        self.frames += 1;
        let checked = self.limits.check_frames(self.frames, self.bytes.get());
        checked.map_err(|excess| excess.to_string())?;
        let told = told_time(frame.time, i == 0, &mut self.untimed, "time");
        let time = told.map_err(|what| format!("frame {i}: {what}"))?.unwrap_or(i as f64);
        self.instants.push(time);
        for hand in &frame.hands.0 {
            let side = hand.handedness;
            let clip = self.clip(side);
            let taken = hand.points().and_then(|points| {
                check_time(time, clip.frames.last())?;
                clip.frames.push(LandmarkFrame::of(time, points));
                Ok(())
            });
            taken.map_err(|what| format!("frame {i}, {} hand: {what}", side.name()))?;
            self.turn(time, hand);
        }
        Ok(())
    }

    /// The recording of a hand.
    fn clip(&mut self, side: Side) -> &mut LandmarkClip {
        let at = self.clips.iter().position(|clip| clip.side == Some(side)).unwrap_or_else(|| {
            self.clips.push(LandmarkClip {
                side: Some(side),
                metres: Some(1.0),
                points_per_frame: Joint::ALL.len(),
                ..LandmarkClip::default()
            });
            self.clips.len() - 1
        });
        &mut self.clips[at]
    }

    /// Takes in the pose that a hand's orientations tell, as long as all did.
    fn turn(&mut self, time: f64, hand: &Hand) {
        let Some(poses) = &mut self.poses else { return };
        let side = hand.handedness;
        let (skeleton, reader) = self.turns[side as usize]
            .get_or_insert_with(|| (Skeleton::new(&Morphology::default(), side), PosesFromTurns::new(side)));
        match hand.pose(skeleton, reader) {
            Some(pose) => poses.push(TimedPose::new(time, pose)),
            None => self.poses = None,
        }
    }
}

impl Hand {
    fn points(&self) -> Result<JointPoints, String> {
        let joints = self.joints.0.as_ref().map_err(Clone::clone)?;
        let point = |joint: &Option<Transform>| -> Point {
            let Position { x, y, z } = joint.as_ref()?.position;
            Some([x, y, z])
        };
        place(&joints.each_ref().map(point), 25)
    }

    /// The pose that the orientations tell, where our hand has all of them in that pose.
    fn pose(&self, skeleton: &Skeleton, reader: &mut PosesFromTurns) -> Option<HandPose> {
        let joints = self.joints.0.as_ref().ok()?;
        let back = ours_from_webxr().inverse();
        let mut turns = [UnitQuaternion::identity(); 25];
        for (turn, joint) in turns.iter_mut().zip(joints.iter()) {
            let Orientation { x, y, z, w } = joint.as_ref()?.orientation.as_ref()?;
            *turn = UnitQuaternion::try_new(Quaternion::new(*w, *x, *y, *z), 1e-3)? * back;
        }
        let turned = |joint: Joint| {
            let above = joint.parent().map_or_else(UnitQuaternion::identity, |above| turns[above.index()]);
            above.inverse() * turns[joint.index()]
        };
        let mut pose = reader.pose(turned);
        pose.rotation = turns[Joint::Wrist.index()];
        let Position { x, y, z } = joints[Joint::Wrist.index()].as_ref()?.position;
        pose.translation = [x, y, z].into();
        let frames = skeleton.frames(&pose);
        let near = |joint: Joint| frames.get(joint).rotation.angle_to(&turns[joint.index()]) < TOLERANCE;
        Joint::ALL.into_iter().all(near).then_some(pose)
    }
}

/// The instants at which a hand is away, with the pose that it had last.
fn lost(clip: &LandmarkClip, seen: &[TimedPose]) -> Vec<TimedPose> {
    let mut seen = seen.iter().filter(|frame| Some(frame.pose.side) == clip.side).peekable();
    let mut last = None;
    let pose_of = |frame: &LandmarkFrame| {
        if let Some(found) = seen.next_if(|found| found.time == frame.time) {
            last = Some(found);
            return None;
        }
        Some(TimedPose { valid: false, ..TimedPose::new(frame.time, last?.pose.clone()) })
    };
    clip.frames.iter().filter_map(pose_of).collect()
}

/// The poses that the orientations tell, or the positions where they tell none.
fn read(bytes: &[u8], limits: &Limits) -> Result<Content, ContentError> {
    let wrong = |what| ContentError::Webxr { what };
    let mut input = serde_json::Deserializer::from_slice(bytes);
    let length = Cell::new(bytes.len() as u64);
    let (clips, poses) = document(&mut input, (limits, &length), true).map_err(wrong)?;
    input.end().map_err(|error| wrong(error.to_string()))?;
    let Some(mut frames) = poses else { return Ok(Content::Joints(clips)) };
    let absent: Vec<TimedPose> = clips.iter().flat_map(|clip| lost(clip, &frames)).collect();
    frames.extend(absent);
    frames.sort_by(|a, b| a.time.total_cmp(&b.time));
    let info = |points: &LandmarkClip| {
        let side = points.side?;
        let posed = points.frames.iter().filter_map(|frame| {
            let own = |pose: &&TimedPose| pose.pose.side == side && pose.valid;
            let at = frames.partition_point(|pose| pose.time < frame.time);
            let pose = frames[at..].iter().take_while(|pose| pose.time == frame.time).find(own)?;
            Some((&pose.pose, &frame.points))
        });
        Some(ClipHand { side, morphology: measure_posed(posed, side).ok() })
    };
    let hands = clips.iter().filter_map(info).collect();
    let header = PoseHeader { rate: clips[0].rate, hands, ..PoseHeader::default() };
    let rate_assumed = clips[0].rate_assumed;
    let mut motion = Motion { rate_assumed, ..Motion::of(&FORMAT, PoseClip { header, frames }) };
    motion.notes.extend(motion.rate_notice());
    Ok(motion.into())
}

/// Writes the document with the valid poses of a clip; hands of unknown sizes get those of `fallback`.
///
/// # Errors
/// [`WriteError::Empty`], [`WriteError::Json`], [`WriteError::Io`].
pub fn write_webxr(clip: &PoseClip, fallback: &Morphology, mut out: impl Write) -> Result<(), WriteError> {
    let hands = sides(clip).into_iter().map(|side| {
        let sizes = clip.header.hand(side).and_then(|h| h.morphology.as_ref()).unwrap_or(fallback);
        (side, skeleton(clip, side, fallback), sizes)
    });
    let hands: Vec<_> = hands.collect();
    let poses = hands.iter().flat_map(|hand| clip.of(hand.0).filter(|f| f.valid).map(move |f| (hand, f)));
    let mut poses: Vec<_> = poses.collect();
    if poses.is_empty() {
        return Err(WriteError::Empty);
    }
    poses.sort_by(|a, b| a.1.time.total_cmp(&b.1.time));
    write!(out, "{{\"format\":{},\"fps\":{},\"frames\":[", json!(NAME), json!(clip.header.rate))?;
    let mut before = "";
    for of_time in poses.chunk_by(|a, b| a.1.time == b.1.time) {
        let hand = |((side, skeleton, sizes), frame): &(&(Side, Skeleton, &Morphology), &TimedPose)| {
            let joints = joints(skeleton, sizes, &frame.pose);
            json!({ "handedness": side.name(), "joints": joints })
        };
        let hands: Vec<Value> = of_time.iter().map(hand).collect();
        write!(out, "{before}")?;
        serde_json::to_writer(&mut out, &json!({ "time": of_time[0].1.time, "hands": hands }))?;
        before = ",";
    }
    Ok(writeln!(out, "],\"unit\":{}}}", json!(METRE))?)
}

fn joints(skeleton: &Skeleton, sizes: &Morphology, pose: &HandPose) -> Vec<Value> {
    let (frames, turn) = (skeleton.frames(pose), ours_from_webxr());
    let number = |v: f64| rounded(v, DIGITS);
    let joint = |joint: Joint| {
        let p: Point3<f64> = frames.position(joint);
        let q = (frames.get(joint).rotation * turn).coords;
        json!({
            "jointName": joint.webxr_name(),
            "transform": {
                "position": { "x": number(p.x), "y": number(p.y), "z": number(p.z), "w": 1 },
                "orientation": { "x": number(q.x), "y": number(q.y), "z": number(q.z), "w": number(q.w) },
            },
            "radius": number(radius(sizes, joint)),
        })
    };
    Joint::ALL.map(joint).to_vec()
}

/// Distance of a joint from the skin, metres.
fn radius(morphology: &Morphology, joint: Joint) -> f64 {
    let chain = Finger::ALL.into_iter().find_map(|finger| {
        let joints = Joint::of(finger);
        let at = joints.iter().position(|&j| j == joint)?.checked_sub(joints.len() - 4)?;
        Some(morphology.finger(finger).radii[at])
    });
    chain.unwrap_or(morphology.palm_radius)
}

#[cfg(test)]
mod tests {
    use super::super::MAX_DOCUMENT_BYTES;
    use super::*;
    use crate::import::ImportOptions;
    use crate::motion::tests::{two_hands, worst};
    use handcast_hand::JointAngle;
    use nalgebra::Vector3;

    fn read(text: &[u8]) -> Result<Motion, ContentError> {
        match super::read(text, &Limits::default())? {
            Content::Poses(motion) => Ok(*motion),
            Content::Joints(hands) => crate::landmarks::solved(&FORMAT, &hands, &ImportOptions::default()),
        }
    }

    fn clips(text: &str) -> Result<Vec<LandmarkClip>, String> {
        super::clips(text.as_bytes(), &Limits::default())
    }

    fn document(frames: &str) -> String {
        format!("{{\"format\":\"webxr-hands\",\"unit\":\"m\",\"fps\":30,\"frames\":[{frames}]}}")
    }

    fn frame(time: f64, side: &str, joint: &str) -> String {
        format!(
            "{{\"time\":{time},\"hands\":[{{\"handedness\":\"{side}\",\"joints\":[{{\"jointName\":\"{joint}\",\
             \"transform\":{{\"position\":{{\"x\":1,\"y\":2,\"z\":3,\"w\":1}}}}}}]}}]}}"
        )
    }

    #[test]
    fn hands_are_told_apart_and_joints_may_be_missing() {
        let frames =
            [frame(0.0, "left", "wrist"), frame(0.5, "right", "thumb-tip"), frame(1.0, "left", "wrist")];
        let clips = clips(&document(&frames.join(","))).unwrap();
        assert_eq!(
            clips.iter().map(|c| (c.side, c.frames.len())).collect::<Vec<_>>(),
            [(Some(Side::Left), 3), (Some(Side::Right), 1)]
        );
        // Away while the other is there alone.
        assert_eq!(clips[0].frames[1].time, 0.5);
        assert!(clips[0].frames[1].points.iter().all(Option::is_none));
        assert_eq!(clips[1].frames[0].points[Joint::ThumbTip.index()].map(|p| p.z), Some(3.0));
        assert_eq!(clips[1].frames[0].points.iter().flatten().count(), 1);
    }

    #[test]
    fn frames_without_times_go_by_the_rate() {
        let both = two_hands();
        let text = String::from_utf8(FORMAT.write(&both, &WriteOptions::default()).unwrap().bytes).unwrap();
        let mut untimed: Value = serde_json::from_str(&text).unwrap();
        for frame in untimed["frames"].as_array_mut().unwrap() {
            frame.as_object_mut().unwrap().remove("time");
        }
        untimed["fps"] = json!(40);
        let timed = read(untimed.to_string().as_bytes()).unwrap();
        assert_eq!((timed.clip.header.rate, timed.rate_assumed), (Some(40.0), false));
        assert_eq!(timed.clip.frames.last().unwrap().time, 39.0 / 40.0);
        untimed.as_object_mut().unwrap().remove("fps");
        let assumed = read(untimed.to_string().as_bytes()).unwrap();
        assert!(assumed.rate_assumed && assumed.notes[0].contains("30 frames a second are taken"));
        let told = assumed.at_rate(72.0);
        assert!(told.notes.is_empty() && !told.rate_assumed);
        assert!((told.clip.frames.last().unwrap().time - 39.0 / 72.0).abs() < 1e-12);
        let clip = clips(&untimed.to_string()).unwrap().remove(0);
        assert!(clip.rate_assumed && clip.rate == Some(30.0));
        let mixed = [frame(0.0, "left", "wrist"), frame(1.0, "left", "wrist").replace("\"time\":1,", "")];
        assert!(clips(&document(&mixed.join(","))).unwrap_err().contains("frame 1: missing field `time`"));
    }

    /// Also of a hand that never shows its palm flat.
    #[test]
    fn sizes_come_back_where_the_palm_is_cupped() {
        let mut both = two_hands();
        for frame in &mut both.frames {
            for (angle, bend) in [(JointAngle::Ring0Flexion, 0.2), (JointAngle::Pinky0Flexion, 0.35)] {
                frame.pose.set(angle, bend);
            }
        }
        let written = FORMAT.write(&both, &WriteOptions::default()).unwrap();
        let back = read(&written.bytes).unwrap().clip;
        for (hand, ours) in back.header.hands.iter().zip(&both.header.hands) {
            let [a, b] = [hand, ours].map(|hand| Skeleton::new(hand.morphology.as_ref().unwrap(), hand.side));
            for (there, given) in back.of(hand.side).zip(both.of(hand.side)) {
                let (there, given) = (a.frames(&there.pose), b.frames(&given.pose));
                let off = |joint| (there.position(joint) - given.position(joint)).norm();
                let most = Joint::ALL.into_iter().map(off).fold(0.0, f64::max);
                assert!(most < 2e-5, "{most}");
            }
        }
    }

    #[test]
    fn wrong_documents_are_refused() {
        for (frames, words) in [
            (String::new(), "no frame has a hand"),
            (frame(0.0, "left", "elbow"), "frame 0, left hand: no joint is called \"elbow\""),
            (
                [frame(1.0, "left", "wrist"), frame(1.0, "left", "wrist")].join(","),
                "frame 1, left hand: t is 1 s",
            ),
            (frame(0.0, "left", "wrist").replace(":3,", ":3e9,"), "coordinate 3000000000"),
            (frame(0.0, "both", "wrist"), "both"),
        ] {
            let message = clips(&document(&frames)).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
        let message = clips(&document("").replace("\"m\"", "\"ft\"")).unwrap_err();
        assert!(message.contains("unit is \"ft\""), "{message}");
    }

    #[test]
    fn orientations_give_every_angle_back() {
        let both = two_hands();
        let written = FORMAT.write(&both, &WriteOptions::default()).unwrap();
        let back = read(&written.bytes).unwrap();
        assert!(worst(&both, &back.clip) < 3e-6, "{}", worst(&both, &back.clip));
        assert!(back.import.is_none() && back.angles.len() == 29);
        for (hand, ours) in back.clip.header.hands.iter().zip(&both.header.hands) {
            let (a, b) = (hand.morphology.as_ref().unwrap(), ours.morphology.as_ref().unwrap());
            assert_eq!(hand.side, ours.side);
            for (a, b) in a.fingers.iter().zip(&b.fingers) {
                assert!(a.bones.iter().zip(&b.bones).all(|(a, b)| (a - b).abs() < 1e-5));
            }
        }
    }

    #[test]
    fn orientations_that_our_hand_cannot_take_are_not_believed() {
        let both = two_hands();
        let text = String::from_utf8(FORMAT.write(&both, &WriteOptions::default()).unwrap().bytes).unwrap();
        // A joint that is turned where ours is a hinge.
        let mut turned: Value = serde_json::from_str(&text).unwrap();
        let orientation = &mut turned["frames"][0]["hands"][0]["joints"][8]["transform"]["orientation"];
        *orientation = json!({ "x": 0.5, "y": 0.5, "z": 0.5, "w": 0.5 });
        // None at all.
        let bare = text.replace("\"orientation\"", "\"turn\"");
        for text in [turned.to_string(), bare] {
            let back = read(text.as_bytes()).unwrap();
            assert_eq!(back.import.unwrap().solved, both.frames.len());
            assert!(back.angles.len() < 29);
        }
    }

    #[test]
    fn a_document_is_as_long_as_a_motion_may_be() {
        let clip = PoseClip { frames: two_hands().frames[..1].to_vec(), ..two_hands() };
        let text = FORMAT.write(&clip, &WriteOptions::default()).unwrap().bytes;
        let mut frame = serde_json::from_slice::<Value>(&text).unwrap()["frames"][0].take();
        // More than other documents may have.
        let count = MAX_DOCUMENT_BYTES as usize / frame.to_string().len() + 1;
        let at = |i: usize| {
            frame["time"] = i.into();
            frame.to_string()
        };
        let frames: Vec<String> = (0..count).map(at).collect();
        let long = document(&frames.join(","));
        drop(frames);
        assert!(long.len() as u64 > MAX_DOCUMENT_BYTES);
        let clips = super::clips(long.as_bytes(), &Limits::default()).unwrap();
        assert_eq!((clips.len(), clips[0].frames.len()), (1, count));
        let back = read(long.as_bytes()).unwrap();
        assert_eq!((back.clip.frames.len(), back.import), (count, None));
        let few = Limits::default().with_bytes(1 << 20);
        let message = super::clips(long.as_bytes(), &few).unwrap_err();
        assert!(message.ends_with(" bytes, allowed at most 1048576"), "{message}");
        let few = Limits::default().with_instants(500);
        for message in [
            super::clips(long.as_bytes(), &few).unwrap_err(),
            super::read(long.as_bytes(), &few).unwrap_err().to_string(),
        ] {
            assert!(message.contains("501 frames, allowed at most 500"), "{message}");
        }
    }

    #[test]
    fn two_hands_of_an_instant_are_one_instant() {
        let written = FORMAT.write(&two_hands(), &WriteOptions::default()).unwrap();
        let within = |instants| super::read(&written.bytes, &Limits::default().with_instants(instants));
        assert!(within(40).is_ok());
        assert!(within(39).unwrap_err().to_string().contains("40 frames, allowed at most 39"));
    }

    #[test]
    fn no_more_is_held_of_a_frame_than_hands_have() {
        let hand = "{\"handedness\":\"left\",\"joints\":[]}";
        let crowd = format!("{{\"time\":0,\"hands\":[{}{hand}]}}", format!("{hand},").repeat(100_000));
        assert!(clips(&document(&crowd)).unwrap_err().contains("more than the 2 hands allowed"));
        let joint = frame(0.0, "left", "wrist");
        let joint = &joint[joint.find("{\"jointName").unwrap()..joint.len() - 4];
        let joints = format!("{}{joint}", format!("{joint},").repeat(100_000));
        let crowd = format!("{{\"time\":0,\"hands\":[{{\"handedness\":\"left\",\"joints\":[{joints}]}}]}}");
        let message = clips(&document(&crowd)).unwrap_err();
        assert_eq!(message, "frame 0, left hand: two joints are called \"wrist\"");
        // Small frames are worth their bytes.
        let empty = vec!["{\"time\":0,\"hands\":[]}"; 30_000].join(",");
        assert!(clips(&document(&empty)).unwrap_err().contains("frames, allowed at most 24000"));
        let twice = document("").replace("\"unit\"", "\"frames\":[],\"unit\"");
        assert!(clips(&twice).unwrap_err().contains("duplicate field"));
    }

    #[test]
    fn joints_point_along_their_bones() {
        let mut text = Vec::new();
        write_webxr(&two_hands(), &Morphology::default(), &mut text).unwrap();
        let document: Value = serde_json::from_slice(&text).unwrap();
        let frames = document["frames"].as_array().unwrap();
        assert_eq!((frames.len(), frames[0]["hands"].as_array().unwrap().len()), (40, 1));
        for hand in frames[20]["hands"].as_array().unwrap() {
            let joints = hand["joints"].as_array().unwrap();
            assert_eq!(joints.len(), 25);
            let number = |v: &Value, k: &str| v[k].as_f64().unwrap();
            let place = |j: Joint| {
                let p = &joints[j.index()]["transform"]["position"];
                Vector3::new(number(p, "x"), number(p, "y"), number(p, "z"))
            };
            let q = &joints[Joint::RingIntermediate.index()]["transform"]["orientation"];
            let q = Quaternion::new(number(q, "w"), number(q, "x"), number(q, "y"), number(q, "z"));
            let bone = (place(Joint::RingDistal) - place(Joint::RingIntermediate)).normalize();
            let along = UnitQuaternion::from_quaternion(q) * -Vector3::z();
            assert!((along - bone).norm() < 1e-5);
            assert!(number(&joints[3], "radius") > 0.004);
        }
    }
}
