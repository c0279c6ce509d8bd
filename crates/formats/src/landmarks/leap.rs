//! Frames of a Leap Motion as JSON: those of its WebSocket and of LeapJS, recordings of LeapJS Playback, and frames with
//! hands, fingers and bones as the other libraries have them.
//!
//! ```text
//! {"timestamp":4729292670,"hands":[{"id":57,"type":"right","palmPosition":[x,y,z],"direction":[x,y,z],"wrist":[x,y,z]}],
//!  "pointables":[{"handId":57,"type":1,"carpPosition":[x,y,z],"mcpPosition":[…],"pipPosition":[…],"dipPosition":[…],"btipPosition":[…]},…]}
//! {"metadata":{…},"frames":[["id","timestamp",{"hands":[["id","type",…]]},{"pointables":[["id","handId",…]]}],[1,4729292670,[[57,"right",…]],[[571,57,…],…]],…]}
//! {"timestamp":4729292670,"hands":[{"type":"left","arm":{"next_joint":{"x":…}},"fingers":[{"bones":[{"prev_joint":{"x":…},"next_joint":{…}},…]},…]}]}
//! ```
//!
//! One frame, a list of them, an object with a list `frames`, or JSON lines. x goes right, y up from the device, z towards the
//! person. The unit is the millimetre, or the metre where a hand would be smaller than one. The thumb has no metacarpal: its
//! four joints are the ends of its other bones. A wrist that is not told lies 50 mm behind the middle of the palm. Read only.

use nalgebra::Point3;
use serde_json::{Map, Value};

use super::documents::{each_frame, get, point, side};
use super::{LandmarkClip, LandmarkFrame, Point, Sided, place, read_document};
use crate::motion::Format;
use crate::motion::format::names_any;
use handcast_hand::landmarks::hand_length;
use handcast_hand::{Finger, Joint, Side};
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "leap",
    name: "joint positions (Leap Motion)",
    kind: "landmarks",
    ending: ".json",
    hands: 2,
    sniff: |bytes| names_any(bytes, &NAMES),
    read: |bytes, limits| read_document(&FORMAT, parse, bytes, limits),
    write: None,
};

/// Names one of which a frame has early.
const NAMES: [&str; 9] = [
    "pointables",
    "palmPosition",
    "palm_position",
    "PalmPosition",
    "prev_joint",
    "prevJoint",
    "PrevJoint",
    "prev joint",
    "next_joint",
];
/// Joints of a frame of LeapJS, of a long finger from the metacarpal on.
const JOINTS: [&[&str]; 5] = [
    &["carpposition"],
    &["mcpposition"],
    &["pipposition"],
    &["dipposition"],
    &["btipposition", "tipposition"],
];
/// From the middle of the palm to the wrist against the direction of the hand, millimetres.
const PALM_TO_WRIST: f64 = 50.0;
/// Hands shorter than this are in metres.
const SHORTEST: f64 = 2.0;
/// Seconds in a unit of the time stamps.
const MICROSECOND: f64 = 1e-6;
/// Frames a second of recordings without times.
const RATE: f64 = 60.0;

type Joints = [Point; 25];

/// The hands of a recording.
pub(super) fn parse(text: &[u8], limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    let like =
        LandmarkClip { points_per_frame: 25, made_by: Some("Leap Motion".into()), ..LandmarkClip::default() };
    let (mut hands, mut packing, mut count, mut first) = (Sided::new(like), None, 0usize, None);
    let (mut frames, mut timed) = (0u32, false);
    each_frame(text, &mut |_, frame| {
        let frame = match (frame, &packing) {
            // The names of what the lists behind it hold.
            (Value::Array(names), None) => {
                packing = Some(names);
                return Ok(());
            }
            (Value::Array(values), Some(names)) => unpacked(names, values)?,
            (frame, _) => frame,
        };
        let time = match get(&frame, &["timestamp"]).and_then(Value::as_f64) {
            Some(stamp) => {
                timed = true;
                (stamp - *first.get_or_insert(stamp)) * MICROSECOND
            }
            None => f64::from(frames) / RATE,
        };
        frames += 1;
        hands.pass(time);
        for hand in get(&frame, &["hands"]).and_then(Value::as_array).into_iter().flatten() {
            count += 1;
            limits.check_frames(count, text.len() as u64).map_err(|excess| excess.to_string())?;
            let joints = joints(hand, &frame);
            if joints.iter().flatten().next().is_some() {
                hands.push(side_of(hand), LandmarkFrame::of(time, place(&joints, 25)?))?;
            }
        }
        Ok(())
    })?;
    let mut clips = hands.finished()?;
    for clip in &mut clips {
        let points: Vec<_> = clip.frames.iter().map(|frame| frame.points).collect();
        let metres = hand_length(&points).is_some_and(|length| length < SHORTEST);
        clip.metres = Some(if metres { 1.0 } else { 1e-3 });
        (clip.rate, clip.rate_assumed) = if timed { (None, false) } else { (Some(RATE), true) };
        if !clip.frames.iter().any(|frame| frame.points[Joint::PinkyMetacarpal.index()].is_some()) {
            clip.points_per_frame = 21;
        }
    }
    Ok(clips)
}

/// A frame of LeapJS Playback: lists become objects by the names that come first.
fn unpacked(names: &[Value], values: Vec<Value>) -> Result<Value, String> {
    let mut out = Map::new();
    for (name, value) in names.iter().zip(values) {
        match name {
            Value::String(name) => {
                out.insert(name.clone(), value);
            }
            Value::Object(inner) => {
                for (name, parts) in inner {
                    out.insert(name.clone(), unpacked_parts(parts, value.clone())?);
                }
            }
            _ => return Err("the first frame names what is neither a value nor a list".into()),
        }
    }
    Ok(Value::Object(out))
}

fn unpacked_parts(parts: &Value, value: Value) -> Result<Value, String> {
    match (parts.as_array().map(Vec::as_slice), value) {
        // One list of names for each of many.
        (Some([Value::Array(names)]), Value::Array(list)) => {
            let one = |value| match value {
                Value::Array(values) => unpacked(names, values),
                other => Ok(other),
            };
            list.into_iter().map(one).collect::<Result<Vec<_>, _>>().map(Value::Array)
        }
        (Some(names), Value::Array(values)) => unpacked(names, values),
        (_, other) => Ok(other),
    }
}

fn side_of(hand: &Value) -> Option<Side> {
    let right = |value: &Value| value.as_bool().map(|right| if right { Side::Right } else { Side::Left });
    get(hand, &["type", "handtype", "chirality", "side", "handedness"])
        .and_then(side)
        .or_else(|| right(get(hand, &["isright"])?))
        .or_else(|| right(get(hand, &["isleft"])?).map(Side::other))
}

/// The joints of a hand of a frame.
fn joints(hand: &Value, frame: &Value) -> Joints {
    let mut out = [None; 25];
    let mut put = |finger: Finger, joints: [Point; 5]| {
        let to = Joint::of(finger);
        // A thumb has one joint less.
        for (joint, p) in to.iter().zip(&joints[joints.len() - to.len()..]) {
            out[joint.index()] = *p;
        }
    };
    let id = get(hand, &["id"]).and_then(Value::as_i64);
    let of_hand = |finger: &&Value| get(finger, &["handid"]).and_then(Value::as_i64) == id;
    let pointables =
        get(frame, &["pointables"]).and_then(Value::as_array).into_iter().flatten().filter(of_hand);
    for (k, finger) in pointables.enumerate() {
        let joint = |names: &[&str]| get(finger, names).and_then(point);
        if let Some(which) = which(finger, k) {
            put(which, JOINTS.map(joint));
        }
    }
    let fingers = get(hand, &["fingers", "digits"]).and_then(Value::as_array);
    for (k, finger) in fingers.into_iter().flatten().enumerate() {
        if let (Some(which), Some(joints)) = (which(finger, k), bones(finger)) {
            put(which, joints);
        }
    }
    out[Joint::Wrist.index()] = wrist(hand, &out);
    out
}

/// Which finger it is: what it says, else by its number, whose last digit tells, or its place among the fingers.
fn which(finger: &Value, k: usize) -> Option<Finger> {
    let told = get(finger, &["type", "fingertype"]);
    let word = told.and_then(Value::as_str).map(str::to_ascii_lowercase);
    if let Some(word) = word {
        return Finger::ALL.into_iter().find(|finger| word.contains(finger.name()));
    }
    let number = get(finger, &["id", "fingerid"]).and_then(Value::as_u64).map(|id| id % 10);
    let at = told.and_then(Value::as_u64).or(number).and_then(|n| usize::try_from(n).ok()).unwrap_or(k);
    Finger::ALL.get(at).copied()
}

/// The ends of the four bones, from the metacarpal on.
fn bones(finger: &Value) -> Option<[Point; 5]> {
    let bones = get(finger, &["bones"])?;
    let named = |k: usize| {
        let names = [["metacarpal", "0"], ["proximal", "1"], ["intermediate", "2"], ["distal", "3"]];
        bones.as_array().map_or_else(|| get(bones, &names[k]), |list| list.get(k))
    };
    let end = |bone: Option<&Value>, names: &[&str]| get(bone?, names).and_then(point);
    Some(std::array::from_fn(|k| {
        let next = |k: usize| end(named(k), &["nextjoint", "end"]);
        let previous = |k: usize| end(named(k), &["prevjoint", "previousjoint", "start"]);
        if k < 4 { previous(k).or_else(|| next(k.checked_sub(1)?)) } else { next(3) }
    }))
}

/// The wrist, or the place behind the palm where it must be.
fn wrist(hand: &Value, joints: &Joints) -> Point {
    let told = get(hand, &["wrist", "wristposition"]).and_then(point);
    let of_arm = || point(get(get(hand, &["arm"])?, &["nextjoint", "wrist", "wristposition", "end"])?);
    told.or_else(of_arm).or_else(|| {
        let palm = get(hand, &["palm"]);
        let of = |whole: &[&str], part: &[&str]| {
            get(hand, whole).and_then(point).or_else(|| point(get(palm?, part)?)).map(Point3::from)
        };
        let (at, direction) = (of(&["palmposition"], &["position"])?, of(&["direction"], &["direction"])?);
        // In metres where the fingers are.
        let bone = |a: Joint, b: Joint| Some((joints[a.index()]?, joints[b.index()]?));
        let (a, b) = bone(Joint::MiddleProximal, Joint::MiddleTip)?;
        let unit = if (Point3::from(a) - Point3::from(b)).norm() < 0.5 * SHORTEST { 1e-3 } else { 1.0 };
        Some((at - direction.coords.try_normalize(1e-9)? * (PALM_TO_WRIST * unit)).into())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Motion;
    use crate::motion::tests::{apart, feasible};
    use handcast_hand::{HandFrames, Morphology, PoseClip, Skeleton};
    use serde_json::json;

    /// Each pose of a clip with its joints, millimetres.
    fn frames(clip: &PoseClip) -> Vec<(f64, HandFrames)> {
        let skeleton = Skeleton::new(&Morphology::default(), clip.header.hands[0].side);
        clip.frames.iter().map(|f| (f.time, skeleton.frames(&f.pose))).collect()
    }

    fn at(frames: &HandFrames, joint: Joint, unit: f64) -> Value {
        json!(frames.position(joint).coords.as_slice().iter().map(|v| v / unit).collect::<Vec<_>>())
    }

    /// The joints of a finger from its metacarpal on; the thumb's first bone has no length.
    fn chain(finger: Finger) -> [Joint; 5] {
        let joints = Joint::of(finger);
        std::array::from_fn(|k| joints[(k + joints.len()).saturating_sub(5)])
    }

    fn leapjs(side: Side, t: f64, frames: &HandFrames) -> Value {
        let fingers = Finger::ALL.into_iter().enumerate().map(|(k, finger)| {
            let [carp, mcp, pip, dip, tip] = chain(finger).map(|joint| at(frames, joint, 1e-3));
            json!({ "id": 570 + k, "handId": 57, "type": k, "carpPosition": carp, "mcpPosition": mcp,
                    "pipPosition": pip, "dipPosition": dip, "btipPosition": tip, "tool": false })
        });
        let hand = json!({ "id": 57, "type": side.name(), "palmPosition": [0, 200, 0], "direction": [0, 0, -1],
                           "wrist": at(frames, Joint::Wrist, 1e-3) });
        json!({ "timestamp": 4e9 + t * 1e6, "hands": [hand], "pointables": fingers.collect::<Vec<_>>() })
    }

    #[test]
    fn frames_of_leapjs_give_the_poses_back() {
        for side in [Side::Left, Side::Right] {
            let clip = feasible(side);
            let lines: Vec<String> =
                frames(&clip).iter().map(|(t, f)| leapjs(side, *t, f).to_string()).collect();
            let list = format!("[{}]", lines.join(","));
            let document = format!("{{\"metadata\":{{\"formatVersion\":1}},\"frames\":{list}}}");
            for text in [lines.join("\n"), list, document] {
                let motion = Motion::parse("-".as_ref(), text.as_bytes()).unwrap();
                assert_eq!(motion.format.id, "leap");
                let off = apart(&clip, &motion.clip);
                assert!(off[0] < 1e-3 && off[1] < 1e-4 && off[2] < 1e-5, "{off:?}");
            }
        }
    }

    #[test]
    fn frames_of_one_time_and_hands_of_one_side_are_told_of() {
        let clip = feasible(Side::Right);
        let frames: Vec<Value> = frames(&clip).iter().map(|(t, f)| leapjs(Side::Right, *t, f)).collect();
        let read = |frames: &[Value]| {
            let text = json!({ "frames": frames, "metadata": { "formatVersion": 1 } }).to_string();
            parse(text.as_bytes(), &Limits::default())
        };
        assert!(read(&frames).unwrap()[0].notes.is_empty());
        let mut still = frames.clone();
        still.iter_mut().for_each(|frame| frame["timestamp"] = json!(7));
        assert!(read(&still).unwrap_err().contains("with the time of the frame before"));
        let mut some = frames.clone();
        some[3]["timestamp"] = some[2]["timestamp"].clone();
        // As often as it was read.
        let often: Vec<Value> = frames.iter().flat_map(|frame| vec![frame.clone(); 3]).collect();
        assert_eq!(read(&often).unwrap()[0].frames.len(), frames.len());
        assert!(read(&often).unwrap()[0].notes.is_empty());
        assert_eq!(
            read(&some).unwrap()[0].notes,
            ["1 hands in frames with the time of the frame before are left out"]
        );
        let mut two = frames.clone();
        let hand = two[5]["hands"][0].clone();
        two[5]["hands"].as_array_mut().unwrap().push(hand);
        two[5]["hands"][1]["wrist"][0] = json!(3.0);
        let notes = read(&two).unwrap()[0].notes.clone();
        assert_eq!(notes, ["1 hands beside another one of their side, or without a side, are left out"]);
    }

    #[test]
    fn packed_recordings_are_unpacked() {
        let clip = feasible(Side::Right);
        let whole: Vec<Value> = frames(&clip).iter().map(|(t, f)| leapjs(Side::Right, *t, f)).collect();
        let (of_hand, of_finger) = (
            ["id", "type", "direction", "palmPosition", "wrist"],
            [
                "id",
                "handId",
                "tool",
                "carpPosition",
                "mcpPosition",
                "pipPosition",
                "dipPosition",
                "btipPosition",
            ],
        );
        let pick =
            |value: &Value, names: &[&str]| names.iter().map(|name| value[*name].clone()).collect::<Vec<_>>();
        let list = |value: &Value, names: &[&str]| {
            value.as_array().unwrap().iter().map(|one| pick(one, names)).collect::<Vec<_>>()
        };
        let mut packed =
            vec![json!(["id", "timestamp", { "hands": [of_hand] }, { "pointables": [of_finger] }])];
        packed.extend(whole.iter().enumerate().map(|(i, frame)| {
            json!([
                i,
                frame["timestamp"],
                list(&frame["hands"], &of_hand),
                list(&frame["pointables"], &of_finger)
            ])
        }));
        let text = json!({ "frames": packed, "metadata": { "formatVersion": 2 } }).to_string();
        let motion = Motion::parse("-".as_ref(), text.as_bytes()).unwrap();
        let off = apart(&clip, &motion.clip);
        assert_eq!(motion.format.id, "leap");
        assert!(off[0] < 1e-3 && off[1] < 1e-4 && off[2] < 1e-5, "{off:?}");
    }

    #[test]
    fn hands_with_fingers_and_bones_are_read_in_metres() {
        let clip = feasible(Side::Left);
        let xyz = |value: Value| json!({ "x": value[0], "y": value[1], "z": value[2] });
        let of = |(t, frames): &(f64, HandFrames)| {
            let fingers = Finger::ALL.map(|finger| {
                let ends = chain(finger).map(|joint| xyz(at(frames, joint, 1.0)));
                let bones: Vec<Value> =
                    ends.windows(2).map(|w| json!({ "PrevJoint": w[0], "NextJoint": w[1] })).collect();
                json!({ "Type": format!("TYPE_{}", finger.name().to_uppercase()), "bones": bones })
            });
            let arm = json!({ "NextJoint": xyz(at(frames, Joint::Wrist, 1.0)) });
            json!({ "Timestamp": t * 1e6, "Hands": [{ "IsLeft": true, "Arm": arm, "Fingers": fingers }] })
        };
        let text = Value::Array(frames(&clip).iter().map(of).collect()).to_string();
        let motion = Motion::parse("-".as_ref(), text.as_bytes()).unwrap();
        let off = apart(&clip, &motion.clip);
        assert!(off[0] < 1e-3 && off[1] < 1e-4 && off[2] < 1e-5, "{off:?}");
    }

    #[test]
    fn a_wrist_that_is_not_told_lies_behind_the_palm() {
        let hand = json!({ "palmPosition": [0, 200, 10], "direction": [0, 0, -1] });
        let mut joints = [None; 25];
        joints[Joint::MiddleProximal.index()] = Some([0.0, 200.0, -30.0]);
        joints[Joint::MiddleTip.index()] = Some([0.0, 200.0, -110.0]);
        assert_eq!(wrist(&hand, &joints), Some([0.0, 200.0, 60.0]));
        assert_eq!(wrist(&json!({}), &joints), None);
    }

    #[test]
    fn wrong_recordings_are_refused() {
        let parse = |text: &str| super::parse(text.as_bytes(), &Limits::default()).unwrap_err();
        assert_eq!(parse("[{\"timestamp\":1,\"hands\":[]}]"), "no frame has a hand");
        assert!(parse("[[5],[1]]").contains("frame 1: the first frame names"));
        assert!(parse("[{\"pointables\":").contains("line 1"));
    }
}
