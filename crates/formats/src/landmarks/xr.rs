//! Frames of XR joints as JSON, however they were written: 26 joints of OpenXR, 25 of WebXR, or joints by name.
//!
//! ```text
//! {"time":0.0,"left":{"joints":[{"pos":[0.01,-0.2,-0.5],"quat":[0,0,0,1]},…]},"right":null}
//! {"time":0.0,"hands":[{"handedness":"right","joints":{"XR_HAND_JOINT_WRIST_EXT":{"position":{"x":0.01,"y":-0.2,"z":-0.5}},…}}]}
//! {"time":0.0,"hand":"left","joints":[[0.01,-0.2,-0.5, 0,0,0,1],…]}
//! ```
//!
//! A list of frames, an object with a list `frames`, or JSON lines. 26 joints in a list are those of OpenXR, whose first is
//! the palm; 25 those of WebXR; an object names them, in any convention. A joint is a list of coordinates, or an object with
//! `x`, `y` and `z`, or with one of these as `position`, `pos`, `translation`, `pose` or `transform`; `null`, `"valid":false`
//! and joints without numbers were not seen, nor was a hand with `"tracked":false`. `unit` is `m` (the default), `cm` or `mm`. Poses are solved for from the
//! positions. Read only.

use serde_json::{Map, Value};

use super::documents::{each_frame, get, get_in, point, side, stamp};
use super::{
    LandmarkClip, LandmarkFrame, Point, RATE, Sided, place, read_document, seconds_of_stamps,
    seconds_of_times,
};
use crate::motion::Format;
use crate::motion::format::names_any;
use handcast_gltf::joint_named;
use handcast_hand::landmarks::JointPoints;
use handcast_hand::{Joint, Side};
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "xr-joints",
    name: "joint poses (OpenXR, WebXR)",
    kind: "landmarks",
    ending: ".json",
    hands: 2,
    sniff: |bytes| names_any(bytes, &NAMES),
    read: |bytes, limits| read_document(&FORMAT, parse, bytes, limits),
    write: None,
};

/// Names one of which such a document has early.
const NAMES: [&str; 9] = [
    "joints",
    "jointPoses",
    "joint_poses",
    "jointLocations",
    "joint_locations",
    "XR_HAND_JOINT_PALM_EXT",
    "XR_HAND_JOINT_WRIST_EXT",
    "thumb-metacarpal",
    "index-finger-tip",
];
/// How deep joints may lie under names that say nothing.
const DEEPEST: usize = 4;

/// Least joints in a list for it to be a hand, whether it is read or not.
const LEAST: usize = 10;
/// Names of what says whether a joint or a hand was seen.
const TRACKED: [&str; 4] = ["valid", "isvalid", "tracked", "istracked"];

/// What is found in a frame.
#[derive(Default)]
struct Found {
    hands: Vec<(Option<Side>, JointPoints)>,
    /// Whether it says that a hand was not seen.
    lost: bool,
    /// How many joints a hand has of which they are neither 25 nor 26.
    other: Option<usize>,
}

/// What is known of the whole document.
#[derive(Default)]
struct Facts {
    rate: Option<f64>,
    metres: Option<f64>,
    side: Option<Side>,
}

impl Facts {
    /// What these names say.
    fn learn(&mut self, map: &Map<String, Value>) -> Result<(), String> {
        if let Some(rate) = get_in(map, &["fps", "framerate", "rate"]).and_then(Value::as_f64) {
            if !(rate > 0.0 && rate <= 10_000.0) {
                return Err(format!("fps is {rate}, allowed above 0 to 10000"));
            }
            self.rate = Some(rate);
        }
        if let Some(unit) = get_in(map, &["unit", "units"]).and_then(Value::as_str) {
            self.metres = Some(match unit.to_ascii_lowercase().as_str() {
                "m" | "metre" | "metres" | "meter" | "meters" => 1.0,
                "cm" => 0.01,
                "mm" => 0.001,
                _ => return Err(format!("unit is {unit:?}, allowed \"m\", \"cm\", \"mm\"")),
            });
        }
        self.side = get_in(map, &SIDES).and_then(side).or(self.side);
        Ok(())
    }
}

/// Names of what says the side.
const SIDES: [&str; 5] = ["handedness", "hand", "side", "chirality", "handtype"];

/// The hands of a document.
pub(super) fn parse(text: &[u8], limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    let (mut facts, mut frames) = (Facts::default(), Vec::new());
    let (mut count, mut other) = (0, None);
    each_frame(text, &mut |header, frame| {
        if frames.is_empty() {
            facts.learn(header)?;
        }
        let mut found = Found::default();
        find(&frame, facts.side, 0, &mut found)?;
        let (time, hands) = (stamp(&frame), found.hands);
        other = other.or(found.other);
        if let (true, None, Some(map)) = (hands.is_empty() && !found.lost, time, frame.as_object()) {
            // What holds for the lines behind it.
            return facts.learn(map);
        }
        count += hands.len().max(1);
        limits.check_frames(count, text.len() as u64).map_err(|excess| excess.to_string())?;
        frames.push((time, hands));
        Ok(())
    })?;
    let stamps: Vec<f64> = frames.iter().filter_map(|(time, _)| time.map(|(t, _)| t)).collect();
    let (times, unit) = (seconds_of_times(&stamps), seconds_of_stamps(&stamps));
    let rate = facts.rate.or(stamps.is_empty().then_some(RATE));
    let like = LandmarkClip {
        rate,
        rate_assumed: facts.rate.is_none() && rate.is_some(),
        metres: Some(facts.metres.unwrap_or(1.0)),
        points_per_frame: 25,
        ..LandmarkClip::default()
    };
    let mut sided = Sided::new(like);
    for (i, (time, hands)) in frames.into_iter().enumerate() {
        let time = match time {
            Some((t, told)) => t * told.map_or(unit, |told| if told == 1.0 { times } else { told }),
            None => i as f64 / rate.unwrap_or(RATE),
        };
        sided.pass(time);
        for (side, points) in hands {
            sided.push(side, LandmarkFrame::of(time, points)).map_err(|what| format!("frame {i}: {what}"))?;
        }
    }
    match other {
        Some(joints) if sided.clips.is_empty() => {
            Err(format!("a hand has {joints} joints, allowed are 26 (OpenXR), 25 (WebXR) and joints by name"))
        }
        _ => sided.finished(),
    }
}

/// The hands below a value.
fn find(value: &Value, above: Option<Side>, depth: usize, out: &mut Found) -> Result<(), String> {
    match value {
        Value::Array(list) if depth < DEEPEST => match joints_of_list(list)? {
            Some(points) => out.hands.push((above, points)),
            None => {
                let joints = list.iter().filter(|joint| place_of(joint).is_some()).count();
                out.other = out.other.or((joints >= LEAST).then_some(list.len()));
                list.iter().try_for_each(|one| find(one, above, depth + 1, out))?;
            }
        },
        Value::Object(_) if untracked(value) => out.lost = true,
        Value::Object(map) if depth < DEEPEST => {
            let told = get(value, &SIDES).and_then(side).or(above);
            if let Some(points) = joints_of_names(map)? {
                out.hands.push((told, points));
                return Ok(());
            }
            for (name, inner) in map {
                let named =
                    side(&Value::String(name.trim_end_matches("_hand").trim_end_matches("Hand").into()));
                find(inner, named.or(told), depth + 1, out)?;
            }
        }
        _ => {}
    }
    Ok(())
}

/// 25 or 26 joints in their order, or joints that say their names; `None` for another list.
fn joints_of_list(list: &[Value]) -> Result<Option<JointPoints>, String> {
    let names = |joint: &Value| get(joint, &["jointname", "name", "joint"])?.as_str().and_then(joint_named);
    let named: Vec<_> = list.iter().filter_map(|joint| Some((names(joint)?.0, joint))).collect();
    if named.len() > 2 {
        return points_of(named.into_iter()).map(Some);
    }
    let places: Vec<Point> = list.iter().map(place_of).collect();
    match places.len() {
        25 | 26 if places.iter().any(Option::is_some) => place(&places, places.len()).map(Some),
        _ => Ok(None),
    }
}

/// Joints of an object that names three or more.
fn joints_of_names(map: &Map<String, Value>) -> Result<Option<JointPoints>, String> {
    let named = map.iter().filter_map(|(name, joint)| Some((joint_named(name)?.0, joint)));
    let named: Vec<_> = named.filter(|(_, joint)| joint.is_null() || place_of(joint).is_some()).collect();
    if named.len() > 2 { points_of(named.into_iter()).map(Some) } else { Ok(None) }
}

fn points_of<'a>(named: impl Iterator<Item = (Option<Joint>, &'a Value)>) -> Result<JointPoints, String> {
    let mut places = [None; 25];
    for (joint, value) in named {
        if let Some(joint) = joint {
            places[joint.index()] = place_of(value);
        }
    }
    place(&places, 25)
}

/// Whether a joint or a hand says that it was not seen.
fn untracked(value: &Value) -> bool {
    get(value, &TRACKED).and_then(Value::as_bool) == Some(false)
}

/// Where a joint is.
fn place_of(joint: &Value) -> Point {
    if untracked(joint) {
        return None;
    }
    point(joint).or_else(|| {
        let inner = get(joint, &["position", "pos", "p", "translation", "location", "pose", "transform"])?;
        point(inner).or_else(|| place_of(inner))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Motion;
    use crate::motion::tests::{apart, feasible};
    use handcast_gltf::JointNames;
    use handcast_hand::{Morphology, Skeleton};
    use serde_json::json;

    #[test]
    fn joints_in_order_and_by_name_give_the_poses_back() {
        for side in [Side::Left, Side::Right] {
            let clip = feasible(side);
            let skeleton = Skeleton::new(&Morphology::default(), side);
            let frames: Vec<_> = clip.frames.iter().map(|f| (f.time, skeleton.frames(&f.pose))).collect();
            let at = |f: &handcast_hand::HandFrames, joint: Joint| {
                let p = f.position(joint);
                [p.x, p.y, p.z]
            };
            let name = side.name();
            // 26 poses, the palm first.
            let openxr = frames.iter().map(|(t, f)| {
                let mut joints = vec![json!({ "pos": [0, 0, 0], "quat": [0, 0, 0, 1] })];
                joints.extend(Joint::ALL.map(|j| json!({ "pos": at(f, j), "quat": [0, 0, 0, 1] })));
                json!({ "time": 7e12 + t * 1e9, name: { "joints": joints } })
            });
            // Rows of numbers, 25 of them, in centimetres.
            let rows = frames.iter().map(|(t, f)| {
                let joints = Joint::ALL
                    .map(|j| [at(f, j).map(|v| v * 100.0).to_vec(), vec![0.0, 0.0, 0.0, 1.0]].concat());
                json!({ "timestamp_ms": t * 1e3, "hand": name, "joints": joints })
            });
            // Objects by name.
            let named = frames.iter().map(|(t, f)| {
                let joint = |j: Joint| {
                    let [x, y, z] = at(f, j);
                    let pose = json!({ "pose": { "position": { "x": x, "y": y, "z": z } }, "radius": 0.01 });
                    (format!("XR_HAND_JOINT_{}_EXT", JointNames::OpenXr.name(j, side, 1)), pose)
                };
                let joints: Map<String, Value> = Joint::ALL.into_iter().map(joint).collect();
                json!({ "t": t, "hands": [{ "handedness": name, "joints": joints }] })
            });
            let all = |list: &mut dyn Iterator<Item = Value>| list.map(|v| v.to_string()).collect::<Vec<_>>();
            let (openxr, rows, named) =
                (all(&mut openxr.into_iter()), all(&mut rows.into_iter()), all(&mut named.into_iter()));
            for text in [
                format!("[{}]", openxr.join(",")),
                format!("{{\"unit\":\"cm\"}}\n{}", rows.join("\n")),
                format!("{{\"fps\":25,\"frames\":[{}]}}", named.join(",")),
            ] {
                let motion = Motion::parse("-".as_ref(), text.as_bytes()).unwrap();
                assert_eq!(motion.format.id, "xr-joints");
                let mut clip = clip.clone();
                let start = motion.clip.frames[0].time;
                clip.frames.iter_mut().for_each(|f| f.time += start);
                let off = apart(&clip, &motion.clip);
                assert!(off[0] < 2e-3 && off[1] < 1e-4 && off[2] < 1e-5, "{off:?}");
            }
        }
    }

    #[test]
    fn a_rate_that_is_not_told_is_assumed() {
        let frame = format!("{{\"handedness\":\"left\",\"joints\":[{}]}}", vec!["[0.1,0,0]"; 25].join(","));
        let read = |text: &str| super::parse(text.as_bytes(), &Limits::default()).unwrap().remove(0);
        let list = read(&format!("[{frame},{frame}]"));
        assert_eq!((list.rate, list.rate_assumed), (Some(30.0), true));
        assert!((list.at_rate(72.0).frames[1].time - 1.0 / 72.0).abs() < 1e-12);
        let told = read(&format!("{{\"fps\":90,\"frames\":[{frame},{frame}]}}"));
        assert_eq!((told.rate, told.rate_assumed), (Some(90.0), false));
        let timed = frame.replace("{\"hand", "{\"t\":1,\"hand");
        assert!(!read(&format!("[{timed}]")).rate_assumed);
    }

    #[test]
    fn joints_that_were_not_seen_are_left_out() {
        let mut joints = vec![json!([0.0, 0.0, 0.1]); 26];
        joints[1] = Value::Null;
        joints[2] = json!({ "valid": false, "position": [1, 2, 3] });
        joints[3] = json!({ "position": null });
        let points = joints_of_list(&joints).unwrap().unwrap();
        assert_eq!(points.iter().flatten().count(), 22);
        assert_eq!(joints_of_list(&joints[1..25]).unwrap(), None);
    }

    #[test]
    fn hands_that_were_not_seen_are_lost() {
        let joints = vec!["[0.1,0,0]"; 25].join(",");
        let frame = |tracked: bool| format!("{{\"joints\":[{joints}],\"tracked\":{tracked}}}");
        let hand = |tracked: bool| format!("{{\"left\":{}}}", frame(tracked));
        for frame in [&frame as &dyn Fn(bool) -> String, &hand] {
            let text = format!("[{},{},{}]", frame(true), frame(false), frame(true));
            let clip = super::parse(text.as_bytes(), &Limits::default()).unwrap().remove(0);
            let seen: Vec<bool> = clip.frames.iter().map(|f| f.points[0].is_some()).collect();
            assert_eq!(seen, [true, false, true], "{text}");
        }
    }

    #[test]
    fn wrong_documents_are_refused() {
        let parse = |text: &str| super::parse(text.as_bytes(), &Limits::default()).unwrap_err();
        assert_eq!(parse("{\"joints\":[1,2]}"), "no frame has a hand");
        let few = format!("[{{\"t\":0,\"joints\":[{}]}}]", vec!["[0.1,0,0]"; 24].join(","));
        assert!(parse(&few).contains("a hand has 24 joints, allowed are 26"), "{}", parse(&few));
        assert!(parse("{\"unit\":\"ft\",\"frames\":[{}]}").contains("unit is \"ft\""));
        assert!(parse("{\"fps\":0}\n{\"t\":0}").contains("fps is 0"));
        let far = format!("{{\"joints\":[{}]}}", vec!["[1e7,0,0]"; 25].join(","));
        assert!(parse(&far).contains("point 0 has coordinate 10000000"), "{}", parse(&far));
    }
}
