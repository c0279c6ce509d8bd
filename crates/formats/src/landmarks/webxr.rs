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

use std::io::Write;

use nalgebra::{Point3, Quaternion, UnitQuaternion};
use serde::Deserialize;
use serde_json::{Value, json};

use super::{LandmarkClip, LandmarkFrame, Point, check_size, check_time, place, solved};
use crate::motion::format::{head, says};
use crate::motion::{ContentError, Format, Motion, WriteError, WriteOptions, rounded, sides, skeleton};
use handcast_hand::landmarks::{JointPoints, measure};
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
    write: Some(|clip, o: &WriteOptions, out| write_webxr(clip, &o.morphology, out).map(|()| Vec::new())),
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
pub(super) struct Document {
    format: String,
    unit: String,
    fps: Option<f64>,
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    time: f64,
    hands: Vec<Hand>,
}

#[derive(Deserialize)]
struct Hand {
    handedness: Side,
    joints: Vec<NamedJoint>,
}

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

/// A document, with what holds for the whole of it checked.
pub(super) fn parse(text: &[u8], limits: &Limits) -> Result<Document, String> {
    let document: Document = serde_json::from_slice(text).map_err(|e| e.to_string())?;
    if document.format != NAME {
        return Err(format!("format is {:?}, allowed {NAME:?}", document.format));
    }
    if document.unit != METRE {
        return Err(format!("unit is {:?}, allowed {METRE:?}", document.unit));
    }
    let hands = document.frames.iter().map(|frame| frame.hands.len().max(1)).sum();
    limits.check_frames(hands, text.len() as u64).map_err(|excess| excess.to_string())?;
    Ok(document)
}

impl Document {
    /// The positions of each hand's joints; hands in the order in which they appear.
    pub(super) fn clips(&self) -> Result<Vec<LandmarkClip>, String> {
        let mut clips: Vec<LandmarkClip> = Vec::new();
        for (i, frame) in self.frames.iter().enumerate() {
            for hand in &frame.hands {
                let at = clips.iter().position(|clip| clip.side == Some(hand.handedness));
                let at = at.unwrap_or_else(|| {
                    clips.push(LandmarkClip {
                        rate: self.fps,
                        side: Some(hand.handedness),
                        metres: Some(1.0),
                        points_per_frame: Joint::ALL.len(),
                        ..LandmarkClip::default()
                    });
                    clips.len() - 1
                });
                let side = hand.handedness.name();
                let frame = hand
                    .points()
                    .and_then(|points| {
                        check_time(frame.time, clips[at].frames.last())?;
                        Ok(LandmarkFrame::of(frame.time, points))
                    })
                    .map_err(|what| format!("frame {i}, {side} hand: {what}"))?;
                clips[at].frames.push(frame);
            }
        }
        if clips.is_empty() { Err("no frame has a hand".into()) } else { Ok(clips) }
    }

    /// The poses that the orientations tell; `None` where some are missing or are not those of our hand.
    fn poses(&self) -> Option<Vec<TimedPose>> {
        let mut readers: [Option<(Skeleton, PosesFromTurns)>; 2] = [None, None];
        let mut poses = Vec::new();
        for frame in &self.frames {
            for hand in &frame.hands {
                let side = hand.handedness;
                let (skeleton, reader) = readers[side as usize].get_or_insert_with(|| {
                    (Skeleton::new(&Morphology::default(), side), PosesFromTurns::new(side))
                });
                poses.push(TimedPose::new(frame.time, hand.pose(skeleton, reader)?));
            }
        }
        Some(poses)
    }
}

impl Hand {
    /// Each joint by its place in [`Joint::ALL`].
    fn joints(&self) -> Result<[Option<&Transform>; 25], String> {
        let mut joints = [None; 25];
        for NamedJoint { joint_name, transform } in &self.joints {
            let known = Joint::ALL.into_iter().find(|known| known.webxr_name() == joint_name);
            let known = known.ok_or_else(|| format!("no joint is called {joint_name:?}"))?;
            if joints[known.index()].replace(transform).is_some() {
                return Err(format!("two joints are called {joint_name:?}"));
            }
        }
        Ok(joints)
    }

    fn points(&self) -> Result<JointPoints, String> {
        let point = |joint: Option<&Transform>| -> Point {
            let Position { x, y, z } = joint?.position;
            Some([x, y, z])
        };
        place(&self.joints()?.map(point), 25)
    }

    /// The pose that the orientations tell, where our hand has all of them in that pose.
    fn pose(&self, skeleton: &Skeleton, reader: &mut PosesFromTurns) -> Option<HandPose> {
        let joints = self.joints().ok()?;
        let back = ours_from_webxr().inverse();
        let mut turns = [UnitQuaternion::identity(); 25];
        for (turn, joint) in turns.iter_mut().zip(joints) {
            let Orientation { x, y, z, w } = joint?.orientation.as_ref()?;
            *turn = UnitQuaternion::try_new(Quaternion::new(*w, *x, *y, *z), 1e-3)? * back;
        }
        let turned = |joint: Joint| {
            let above = joint.parent().map_or_else(UnitQuaternion::identity, |above| turns[above.index()]);
            above.inverse() * turns[joint.index()]
        };
        let mut pose = reader.pose(turned);
        pose.rotation = turns[Joint::Wrist.index()];
        let Position { x, y, z } = joints[Joint::Wrist.index()]?.position;
        pose.translation = [x, y, z].into();
        let frames = skeleton.frames(&pose);
        let near = |joint: Joint| frames.get(joint).rotation.angle_to(&turns[joint.index()]) < TOLERANCE;
        Joint::ALL.into_iter().all(near).then_some(pose)
    }
}

fn read(bytes: &[u8], limits: &Limits) -> Result<Motion, ContentError> {
    let wrong = |what| ContentError::Webxr { what };
    check_size(bytes).map_err(wrong)?;
    let document = parse(bytes, limits).map_err(wrong)?;
    let clips = document.clips().map_err(wrong)?;
    let Some(frames) = document.poses() else { return solved(&FORMAT, &clips) };
    // The bones are as long as the joints are apart.
    let info = |points: &LandmarkClip| {
        let frames: Vec<JointPoints> = points.frames.iter().map(|frame| frame.points).collect();
        let side = points.side?;
        Some(ClipHand { side, morphology: measure(&frames, side).ok() })
    };
    let hands = clips.iter().filter_map(info).collect();
    let header = PoseHeader { rate: document.fps, hands, ..PoseHeader::default() };
    Ok(Motion::of(&FORMAT, PoseClip { header, frames }))
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
    use super::*;
    use crate::motion::tests::{two_hands, worst};
    use nalgebra::Vector3;

    fn parse(text: &[u8]) -> Result<Document, String> {
        super::parse(text, &Limits::default())
    }

    fn read(text: &[u8]) -> Result<Motion, ContentError> {
        super::read(text, &Limits::default())
    }

    fn clips(text: &str) -> Result<Vec<LandmarkClip>, String> {
        parse(text.as_bytes())?.clips()
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
            [(Some(Side::Left), 2), (Some(Side::Right), 1)]
        );
        assert_eq!(clips[1].frames[0].points[Joint::ThumbTip.index()].map(|p| p.z), Some(3.0));
        assert_eq!(clips[1].frames[0].points.iter().flatten().count(), 1);
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
