//! WebXR-shaped frames, as [`crate::export::webxr`] writes them.

use serde::Deserialize;

use super::{LandmarkClip, LandmarkFrame, MAX_FRAMES, Point, check_time, place};
use handcast_hand::{Joint, Side};

#[derive(Deserialize)]
struct Document {
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
}

#[derive(Deserialize)]
struct Position {
    x: f64,
    y: f64,
    z: f64,
}

/// The hands of a document, in the order in which they appear.
pub(super) fn parse(text: &[u8]) -> Result<Vec<LandmarkClip>, String> {
    let document: Document = serde_json::from_slice(text).map_err(|e| e.to_string())?;
    if document.format != super::WEBXR_FORMAT {
        return Err(format!("format is {:?}, allowed {:?}", document.format, super::WEBXR_FORMAT));
    }
    if document.unit != "m" {
        return Err(format!("unit is {:?}, allowed \"m\"", document.unit));
    }
    if document.frames.len() > MAX_FRAMES {
        return Err(format!("{} frames, allowed {MAX_FRAMES}", document.frames.len()));
    }
    let mut clips: Vec<LandmarkClip> = Vec::new();
    for (i, frame) in document.frames.into_iter().enumerate() {
        for hand in frame.hands {
            let at = clips.iter().position(|clip| clip.side == Some(hand.handedness));
            let at = at.unwrap_or_else(|| {
                clips.push(LandmarkClip {
                    rate: document.fps,
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
                    Ok(LandmarkFrame { time: frame.time, names: Vec::new(), points, image: None })
                })
                .map_err(|what| format!("frame {i}, {side} hand: {what}"))?;
            clips[at].frames.push(frame);
        }
    }
    if clips.is_empty() { Err("no frame has a hand".into()) } else { Ok(clips) }
}

impl Hand {
    fn points(&self) -> Result<super::JointPoints, String> {
        let mut points: [Point; 25] = [None; 25];
        for joint in &self.joints {
            let name = &joint.joint_name;
            let known = Joint::ALL.into_iter().find(|known| known.webxr_name() == name);
            let known = known.ok_or_else(|| format!("no joint is called {name:?}"))?;
            let Position { x, y, z } = joint.transform.position;
            if points[known.index()].replace([x, y, z]).is_some() {
                return Err(format!("two joints are called {name:?}"));
            }
        }
        place(&points, 25)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let clips = parse(document(&frames.join(",")).as_bytes()).unwrap();
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
            let message = parse(document(&frames).as_bytes()).unwrap_err();
            assert!(message.contains(words), "{message}");
        }
        let message = parse(document("").replace("\"m\"", "\"ft\"").as_bytes()).unwrap_err();
        assert!(message.contains("unit is \"ft\""), "{message}");
    }
}
