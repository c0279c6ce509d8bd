//! Poses in the formats of other programs: BVH, CSV, WebXR-shaped JSON, 21 landmarks.
//!
//! All of them hold valid poses only. Positions are in metres in the camera frame of the poses (+X right,
//! +Y up, +Z towards the viewer), angles in degrees.

use std::fmt::Write as _;

use nalgebra::{Isometry3, UnitQuaternion};
use serde_json::{Value, json};
use thiserror::Error;

use handcast_gltf::JointNames;
use handcast_hand::landmarks::LANDMARKS_21;
use handcast_hand::turns::{ours_from_webxr, turns_zxy};
use handcast_hand::{Finger, HandFrames, Joint, JointAngle, Morphology, PoseClip, Side, Skeleton, TimedPose};

/// Why poses cannot be written in a format.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ExportError {
    /// There is no valid pose.
    #[error("export: no valid pose")]
    Empty,
    /// The format holds one hand.
    #[error("export: {format} holds one hand, the clip has two: choose one")]
    TwoHands {
        /// Name of the format.
        format: &'static str,
    },
    /// The frame rate is no rate.
    #[error("export: {rate} frames per second, allowed above 0 to 10000")]
    Rate {
        /// The rate.
        rate: f64,
    },
}

fn sides(clip: &PoseClip) -> Vec<Side> {
    [Side::Left, Side::Right].into_iter().filter(|&s| clip.of(s).any(|f| f.valid)).collect()
}

fn skeleton(clip: &PoseClip, side: Side, fallback: &Morphology) -> Skeleton {
    let info = clip.header.hand(side).and_then(|h| h.morphology.as_ref());
    Skeleton::new(info.unwrap_or(fallback), side)
}

/// The joint angles as a table: `time,hand,x,y,z,qx,qy,qz,qw` and the 29 angles in degrees by name. The first
/// line names the columns; x to qw are the wrist's position (m) and rotation.
///
/// # Errors
/// [`ExportError::Empty`].
pub fn csv(clip: &PoseClip) -> Result<String, ExportError> {
    let mut out = String::from("time,hand,x,y,z,qx,qy,qz,qw");
    for angle in JointAngle::ALL {
        let _ = write!(out, ",{}", angle.name());
    }
    out.push('\n');
    let mut rows = 0;
    for frame in clip.frames.iter().filter(|f| f.valid) {
        let (t, q) = (frame.pose.translation, frame.pose.rotation.coords);
        let _ = write!(out, "{:.6},{}", frame.time, frame.pose.side.name());
        for (value, digits) in t.iter().map(|v| (v, 6)).chain(q.iter().map(|v| (v, 7))) {
            let _ = write!(out, ",{value:.digits$}");
        }
        for angle in frame.pose.angles {
            let _ = write!(out, ",{:.4}", rounded(angle.to_degrees(), 4));
        }
        out.push('\n');
        rows += 1;
    }
    if rows == 0 { Err(ExportError::Empty) } else { Ok(out) }
}

/// The joints as WebXR Hand Input gives them: for each frame and hand, 25 objects shaped like `XRJointPose`
/// (`transform.position`, `transform.orientation`, `radius`) in the order of `XRHandJoint`, with the axes of
/// WebXR: −Z along the bone, +Y out of the back of the hand. Radii are those of the person's sizes; of wrist
/// and metacarpals half the palm's thickness.
///
/// # Errors
/// [`ExportError::Empty`].
pub fn webxr(clip: &PoseClip, fallback: &Morphology) -> Result<Value, ExportError> {
    let sides = sides(clip);
    if sides.is_empty() {
        return Err(ExportError::Empty);
    }
    let turn = ours_from_webxr();
    let number = |v: f64| rounded(v, 7);
    let mut entries: Vec<(f64, Value)> = Vec::new();
    for side in &sides {
        let skeleton = skeleton(clip, *side, fallback);
        let info = clip.header.hand(*side).and_then(|h| h.morphology.as_ref()).unwrap_or(fallback);
        for frame in clip.of(*side).filter(|f| f.valid) {
            let frames = skeleton.frames(&frame.pose);
            let joints: Vec<Value> = Joint::ALL
                .into_iter()
                .map(|joint| {
                    let (p, q) = (frames.position(joint), (frames.get(joint).rotation * turn).coords);
                    json!({
                        "jointName": joint.webxr_name(),
                        "transform": {
                            "position": { "x": number(p.x), "y": number(p.y), "z": number(p.z), "w": 1 },
                            "orientation":
                                { "x": number(q.x), "y": number(q.y), "z": number(q.z), "w": number(q.w) },
                        },
                        "radius": number(radius(info, joint)),
                    })
                })
                .collect();
            entries.push((frame.time, json!({ "handedness": side.name(), "joints": joints })));
        }
    }
    entries.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut frames: Vec<(f64, Vec<Value>)> = Vec::new();
    for (time, hand) in entries {
        match frames.last_mut() {
            Some((last, hands)) if *last == time => hands.push(hand),
            _ => frames.push((time, vec![hand])),
        }
    }
    let frames: Vec<Value> =
        frames.into_iter().map(|(time, hands)| json!({ "time": time, "hands": hands })).collect();
    Ok(json!({ "format": "webxr-hands", "unit": "m", "fps": clip.header.rate, "frames": frames }))
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

/// 21 landmarks as JSON lines, which [`super::landmarks`] reads: a header, and then one frame a line.
///
/// # Errors
/// [`ExportError::Empty`], [`ExportError::TwoHands`].
pub fn landmarks21(clip: &PoseClip, fallback: &Morphology) -> Result<String, ExportError> {
    let side = match sides(clip).as_slice() {
        [] => return Err(ExportError::Empty),
        [side] => *side,
        _ => return Err(ExportError::TwoHands { format: "landmarks" }),
    };
    let skeleton = skeleton(clip, side, fallback);
    let header = json!({
        "format": "landmarks21",
        "order": "mediapipe",
        "unit": "m",
        "fps": clip.header.rate,
        "hand": side.name(),
        "made_by": clip.header.made_by,
    });
    let mut out = format!("{header}\n");
    for frame in clip.of(side) {
        let points = frame.valid.then(|| {
            let frames = skeleton.frames(&frame.pose);
            LANDMARKS_21.map(|j| frames.position(j).coords.map(|v| rounded(v, 7)))
        });
        let points = points.map(|p| p.map(<[f64; 3]>::from).to_vec());
        let _ = writeln!(out, "{}", json!({ "t": frame.time, "points": points }));
    }
    Ok(out)
}

/// What can change at a wrist.
const WRIST_CHANNELS: &str = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation";

/// Biovision hierarchy: offsets in metres, channels in degrees, at `rate` frames a second from the clip's first
/// instant on; a hand that comes later or goes earlier holds its first or last pose. The root is the wrist; of
/// two hands a common root `hands` that keeps still, since many readers know one root only.
///
/// The wrist has six channels, every other joint three: rotations about its own axes, z, then x, then y. At
/// zero all axes are parallel (+Y along the fingers, +Z out of the palm). Tips are end sites.
///
/// # Errors
/// [`ExportError::Empty`], [`ExportError::Rate`].
pub fn bvh(
    clip: &PoseClip,
    fallback: &Morphology,
    names: JointNames,
    rate: f64,
) -> Result<String, ExportError> {
    if !(rate > 0.0 && rate <= 10_000.0) {
        return Err(ExportError::Rate { rate });
    }
    let sides = sides(clip);
    let even = clip.even(rate);
    let start = even.frames.iter().map(|f| f.time).fold(f64::INFINITY, f64::min);
    let tick = |time: f64| ((time - start) * rate).round() as usize;
    let count = even.frames.iter().map(|f| tick(f.time) + 1).max().ok_or(ExportError::Empty)?;
    let mut out = String::from("HIERARCHY\n");
    let mut rows = vec![String::new(); count];
    let two = sides.len() > 1;
    if two {
        let _ = writeln!(out, "ROOT hands\n{{\n  OFFSET 0 0 0\n  {WRIST_CHANNELS}");
        rows = vec!["0 0 0 0 0 0 ".to_owned(); count];
    }
    for side in &sides {
        let skeleton = skeleton(clip, *side, fallback);
        let rest = skeleton.local_frames(&[0.0; 29]);
        let label = |joint: Joint| names.name(joint, *side, sides.len());
        write_joint(&mut out, &rest, &label, Joint::Wrist, usize::from(two));
        let track: Vec<&TimedPose> = even.of(*side).collect();
        let mut before: [[f64; 3]; 25] = [[0.0; 3]; 25];
        let mut at = 0;
        for (k, row) in rows.iter_mut().enumerate() {
            while at + 1 < track.len() && tick(track[at + 1].time) <= k {
                at += 1;
            }
            write_frame(row, &skeleton.frames(&track[at].pose), &mut before);
        }
    }
    if two {
        out.push_str("}\n");
    }
    let _ = writeln!(out, "MOTION\nFrames: {count}\nFrame Time: {:.8}", 1.0 / rate);
    for row in rows {
        out.push_str(row.trim_end());
        out.push('\n');
    }
    Ok(out)
}

/// Rounded to this many digits after the point; minus zero becomes zero.
fn rounded(value: f64, digits: i32) -> f64 {
    let unit = 10f64.powi(digits);
    (value * unit).round() / unit + 0.0
}

fn is_tip(joint: Joint) -> bool {
    Finger::ALL.into_iter().any(|f| Joint::tip(f) == joint)
}

/// Where a joint is from the one above it, in its frame: the same in every pose.
fn relative(frames: &HandFrames, joint: Joint) -> Isometry3<f64> {
    match joint.parent() {
        Some(above) => frames.get(above).inv_mul(frames.get(joint)),
        None => *frames.get(joint),
    }
}

fn write_joint(
    out: &mut String,
    rest: &HandFrames,
    label: &dyn Fn(Joint) -> String,
    joint: Joint,
    depth: usize,
) {
    let indent = "  ".repeat(depth);
    let o = relative(rest, joint).translation.vector.map(|v| rounded(v, 6));
    let title = match (joint, is_tip(joint)) {
        (Joint::Wrist, _) if depth == 0 => format!("ROOT {}", label(joint)),
        (_, true) => "End Site".to_owned(),
        _ => format!("JOINT {}", label(joint)),
    };
    let _ = writeln!(out, "{indent}{title}\n{indent}{{");
    let _ = writeln!(out, "{indent}  OFFSET {:.6} {:.6} {:.6}", o.x, o.y, o.z);
    if joint == Joint::Wrist {
        let _ = writeln!(out, "{indent}  {WRIST_CHANNELS}");
    } else if !is_tip(joint) {
        let _ = writeln!(out, "{indent}  CHANNELS 3 Zrotation Xrotation Yrotation");
    }
    for below in Joint::ALL.into_iter().filter(|j| j.parent() == Some(joint)) {
        write_joint(out, rest, label, below, depth + 1);
    }
    let _ = writeln!(out, "{indent}}}");
}

fn write_frame(row: &mut String, frames: &HandFrames, before: &mut [[f64; 3]; 25]) {
    for joint in Joint::ALL.into_iter().filter(|j| !is_tip(*j)) {
        let local = relative(frames, joint);
        if joint == Joint::Wrist {
            let p = local.translation.vector.map(|v| rounded(v, 6));
            let _ = write!(row, "{:.6} {:.6} {:.6} ", p.x, p.y, p.z);
        }
        let last = &mut before[joint.index()];
        *last = nearest_turns(&local.rotation, last);
        for turn in last {
            let _ = write!(row, "{:.5} ", rounded(turn.to_degrees(), 5));
        }
    }
}

/// Angles (z, x, y) of a rotation: of all that mean the same, those nearest to the ones before, so that
/// programs which interpolate angles do not spin.
fn nearest_turns(rotation: &UnitQuaternion<f64>, before: &[f64; 3]) -> [f64; 3] {
    use std::f64::consts::{PI, TAU};
    let [z, x, y] = turns_zxy(rotation);
    let near = |found: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|k| found[k] + TAU * ((before[k] - found[k]) / TAU).round())
    };
    let far = |found: &[f64; 3]| -> f64 { found.iter().zip(before).map(|(a, b)| (a - b).abs()).sum() };
    let (one, other) = (near([z, x, y]), near([z + PI, PI - x, y + PI]));
    if far(&one) <= far(&other) { one } else { other }
}

#[cfg(test)]
mod tests {
    use super::*;
    use handcast_hand::{ClipHand, HandPose, PoseHeader};
    use nalgebra::{Point3, Vector3};
    use std::collections::HashSet;

    /// Both hands, the right one a little later, moving every angle, the wrist past half a turn.
    fn clip() -> PoseClip {
        let mut clip = PoseClip { header: PoseHeader::default(), frames: Vec::new() };
        clip.header.rate = Some(25.0);
        for (side, from) in [(Side::Left, 0), (Side::Right, 3)] {
            clip.header.hands.push(ClipHand { side, morphology: Some(Morphology::average(0.17)) });
            for i in from..40 {
                let t = f64::from(i) / 25.0;
                let mut pose = HandPose::neutral(side);
                for (k, angle) in JointAngle::ALL.into_iter().enumerate() {
                    let size = if angle.name().ends_with("2_flexion") { 1.7 } else { 0.3 };
                    pose.set(angle, size * (0.5 - 0.5 * (2.0 * t + k as f64).cos()));
                }
                pose.rotation = UnitQuaternion::from_euler_angles(0.9 * t, 2.5 * t, 3.0 * t);
                pose.translation = Vector3::new(0.1 * t, -0.2, -0.5 + t);
                clip.frames.push(TimedPose::new(t, pose));
            }
        }
        clip
    }

    /// How often a joint's name is given again.
    fn repeated(text: &str) -> usize {
        let titles = |l: &'_ str| ["JOINT ", "ROOT "].iter().any(|w| l.trim().starts_with(w));
        let names: Vec<&str> = text.lines().filter(|l| titles(l)).map(str::trim).collect();
        names.len() - names.iter().collect::<HashSet<_>>().len()
    }

    /// A plain reader of BVH: end positions of every joint and site in each frame, by depth-first order.
    fn positions(text: &str) -> (f64, Vec<Vec<Point3<f64>>>) {
        let (hierarchy, motion) = text.split_once("MOTION\n").unwrap();
        let mut lines = motion.lines();
        let count: usize = lines.next().unwrap().strip_prefix("Frames: ").unwrap().parse().unwrap();
        let time: f64 = lines.next().unwrap().strip_prefix("Frame Time: ").unwrap().parse().unwrap();
        let frames: Vec<Vec<Point3<f64>>> = lines
            .map(|line| {
                let mut values = line.split(' ').map(|v| v.parse::<f64>().unwrap());
                let mut stack: Vec<Isometry3<f64>> = Vec::new();
                let mut out = Vec::new();
                for line in hierarchy.lines().skip(1).map(str::trim) {
                    let words: Vec<&str> = line.split(' ').collect();
                    match words[0] {
                        "OFFSET" => {
                            let v: Vec<f64> = words[1..].iter().map(|v| v.parse().unwrap()).collect();
                            let above = stack.last().copied().unwrap_or_else(Isometry3::identity);
                            stack.push(above * Isometry3::translation(v[0], v[1], v[2]));
                        }
                        "CHANNELS" => {
                            let mut here = stack.pop().unwrap();
                            for name in &words[2..] {
                                let value = values.next().unwrap();
                                let axis = match name.as_bytes()[0] {
                                    b'X' => Vector3::x(),
                                    b'Y' => Vector3::y(),
                                    _ => Vector3::z(),
                                };
                                here *= if name.ends_with("position") {
                                    Isometry3::new(axis * value, Vector3::zeros())
                                } else {
                                    Isometry3::new(Vector3::zeros(), axis * value.to_radians())
                                };
                            }
                            stack.push(here);
                        }
                        "}" => out.push(Point3::from(stack.pop().unwrap().translation.vector)),
                        _ => {}
                    }
                }
                assert_eq!(values.next(), None, "every value has its channel");
                out
            })
            .collect();
        assert_eq!(frames.len(), count);
        (time, frames)
    }

    /// Joints in the order in which their braces close.
    fn closing(joint: Joint, out: &mut Vec<Joint>) {
        for below in Joint::ALL.into_iter().filter(|j| j.parent() == Some(joint)) {
            closing(below, out);
        }
        out.push(joint);
    }

    #[test]
    fn bvh_gives_the_joints_back() {
        let clip = clip();
        let text = bvh(&clip, &Morphology::default(), JointNames::Mixamo, 25.0).unwrap();
        assert_eq!(repeated(&text), 0);
        let (time, frames) = positions(&text);
        assert!((time - 0.04).abs() < 1e-9);
        assert_eq!(frames.len(), 40);
        let mut order = Vec::new();
        closing(Joint::Wrist, &mut order);
        for (k, found) in frames.iter().enumerate() {
            for (hand, side) in [Side::Left, Side::Right].into_iter().enumerate() {
                let track: Vec<_> = clip.of(side).collect();
                let at = if hand == 0 { k } else { k.saturating_sub(3) };
                let expected = Skeleton::new(&Morphology::average(0.17), side).frames(&track[at].pose);
                for (i, joint) in order.iter().enumerate() {
                    let off = (found[hand * 25 + i] - expected.position(*joint)).norm();
                    assert!(off < 1e-5, "frame {k}, {}: {off} m", joint.webxr_name());
                }
            }
        }
        assert!(bvh(&clip, &Morphology::default(), JointNames::WebXr, 0.0).is_err());
    }

    #[test]
    fn bvh_angles_never_jump() {
        let text = bvh(&clip(), &Morphology::default(), JointNames::WebXr, 25.0).unwrap();
        let rows: Vec<Vec<f64>> = text
            .split_once("Frame Time")
            .unwrap()
            .1
            .lines()
            .skip(1)
            .map(|l| l.split(' ').map(|v| v.parse().unwrap()).collect())
            .collect();
        for pair in rows.windows(2) {
            for (a, b) in pair[0].iter().zip(&pair[1]) {
                assert!((a - b).abs() < 60.0, "{a} to {b}");
            }
        }
    }

    #[test]
    fn tables_hold_degrees_by_name() {
        let clip = clip();
        let text = csv(&clip).unwrap();
        let mut lines = text.lines().map(|l| l.split(',').collect::<Vec<_>>());
        let header = lines.next().unwrap();
        assert_eq!((header.len(), header[0], header[9]), (38, "time", "pinky0_flexion"));
        let row = lines.nth(7).unwrap();
        let column = header.iter().position(|h| *h == "index2_flexion").unwrap();
        let expected = clip.frames[7].pose.angle(JointAngle::Index2Flexion).to_degrees();
        assert!((row[column].parse::<f64>().unwrap() - expected).abs() < 1e-4);
        assert_eq!(text.lines().count(), 1 + 40 + 37);
        assert!(csv(&PoseClip::default()).is_err());
    }

    #[test]
    fn webxr_joints_point_along_their_bones() {
        let document = webxr(&clip(), &Morphology::default()).unwrap();
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
            let q = nalgebra::Quaternion::new(number(q, "w"), number(q, "x"), number(q, "y"), number(q, "z"));
            let bone = (place(Joint::RingDistal) - place(Joint::RingIntermediate)).normalize();
            let along = UnitQuaternion::from_quaternion(q) * -Vector3::z();
            assert!((along - bone).norm() < 1e-5);
            assert!(number(&joints[3], "radius") > 0.004);
        }
    }

    #[test]
    fn landmarks_hold_one_hand() {
        let mut clip = clip();
        assert!(landmarks21(&clip, &Morphology::default()).unwrap_err().to_string().contains("one hand"));
        clip.frames.retain(|f| f.pose.side == Side::Left);
        clip.frames[4].valid = false;
        let text = landmarks21(&clip, &Morphology::default()).unwrap();
        assert_eq!(text.lines().count(), 41);
        assert!(text.lines().nth(5).unwrap().contains("\"points\":null"));
    }
}
