//! Still poses of WebXR: an array of objects, each the joints of a hand in one posture.
//!
//! ```text
//! [{"names":["fist"],"handedness":"right","jointPositions":[[0.0,-12.5,3.0],…]},…]
//! ```
//!
//! 25 points in millimetres in the order of `XRHandJoint`. Each object becomes one frame, a second after the one
//! before. Read only.

use serde::Deserialize;

use super::{LandmarkClip, LandmarkFrame, Point, check_size, place};
use crate::motion::format::says;
use crate::motion::{Content, ContentError, Format};
use handcast_hand::Side;
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "webxr-poses",
    name: "joint positions",
    kind: "landmarks",
    ending: ".json",
    hands: 1,
    sniff,
    read: |bytes, limits| {
        let clip = check_size(bytes).and_then(|()| parse(bytes, limits));
        Ok(Content::Joints(vec![clip.map_err(|what| ContentError::Webxr { what })?]))
    },
    write: None,
};

/// How far into a file the joints are looked for, bytes.
const HEAD: usize = 4096;

/// An array of objects, the first of which names its joints.
pub(super) fn sniff(bytes: &[u8]) -> bool {
    let start = bytes.trim_ascii_start();
    let start = &start[..start.len().min(HEAD)];
    let inside = start.strip_prefix(b"[").map(<[u8]>::trim_ascii_start);
    inside.is_some_and(|inside| inside.first() == Some(&b'{') && says(inside, "\"jointPositions\""))
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct StillPose {
    #[serde(default)]
    names: Vec<String>,
    handedness: Side,
    joint_positions: Vec<Point>,
}

pub(super) fn parse(text: &[u8], limits: &Limits) -> Result<LandmarkClip, String> {
    let poses: Vec<StillPose> = serde_json::from_slice(text).map_err(|e| e.to_string())?;
    limits.check_frames(poses.len(), text.len() as u64).map_err(|excess| excess.to_string())?;
    let side = poses.first().ok_or("the array is empty")?.handedness;
    let mut clip = LandmarkClip {
        rate: Some(1.0),
        side: Some(side),
        metres: Some(0.001),
        points_per_frame: 25,
        ..LandmarkClip::default()
    };
    for (i, pose) in poses.into_iter().enumerate() {
        if pose.handedness != side {
            return Err(format!("pose {i}: {} hand among {} ones", pose.handedness.name(), side.name()));
        }
        let points = place(&pose.joint_positions, 25).map_err(|what| format!("pose {i}: {what}"))?;
        clip.frames.push(LandmarkFrame { names: pose.names, ..LandmarkFrame::of(i as f64, points) });
    }
    Ok(clip)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &[u8]) -> Result<LandmarkClip, String> {
        super::parse(text, &Limits::default())
    }

    #[test]
    fn webxr_arrays_are_read() {
        let points: Vec<_> = (0..25).map(|i| format!("[{i},0,0]")).collect();
        let pose = |side: &str, n: usize| {
            let points = points[..n].join(",");
            format!("{{\"names\":[\"a\"],\"handedness\":\"{side}\",\"jointPositions\":[{points}]}}")
        };
        let clip = parse(format!("[{},{}]", pose("left", 25), pose("left", 25)).as_bytes()).unwrap();
        assert_eq!(clip.frames.len(), 2);
        assert_eq!(clip.side, Some(Side::Left));
        assert_eq!(clip.frames[1].names, ["a"]);
        assert!(parse(b"[]").unwrap_err().contains("empty"));
        let mixed = format!("[{},{}]", pose("left", 25), pose("right", 25));
        assert!(parse(mixed.as_bytes()).unwrap_err().contains("pose 1: right hand among left ones"));
        let short = format!("[{}]", pose("left", 24));
        assert!(parse(short.as_bytes()).unwrap_err().contains("24 points, expected 25"));
    }
}
