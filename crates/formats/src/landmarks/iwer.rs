//! Recordings of the Immersive Web Emulation Runtime (`ActionRecorder`), as one JSON document.
//!
//! ```text
//! {"schema":[[0,{"handedness":"right","hasGrip":true,"hasHand":true,"jointSequence":["wrist",…],"hasGamepad":true}]],
//!  "frames":[[16.7, x,y,z, qx,qy,qz,qw, [0, x,y,z, qx,qy,qz,qw, [grip], [25 × (x,y,z, qx,qy,qz,qw, radius)], [gamepad]]],…]}
//! ```
//!
//! A frame has its time in milliseconds, the viewer's pose, and each input with its number, the pose of its target ray,
//! and, where the schema says so, grip, hand and gamepad. Joints are in the frame of the target ray; here they are put
//! into the space of the session. Numbers have three digits after the point, joints are up to a millimetre off: bends of the
//! palm are lost in that, and the metacarpals are left out. Read only.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde_json::{Map, Value};

use super::documents::{each_frame, side};
use super::{LandmarkClip, LandmarkFrame, Sided, place, read_document};
use crate::motion::Format;
use crate::motion::format::names_any;
use handcast_gltf::joint_named;
use handcast_hand::landmarks::LANDMARKS_21;
use handcast_hand::{Joint, Side};
use handcast_limits::Limits;

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "iwer",
    name: "joint poses (IWER)",
    kind: "landmarks",
    ending: ".json",
    hands: 2,
    sniff: |bytes| names_any(bytes, &["schema"]) && names_any(bytes, &["hasHand"]),
    read: |bytes, limits| read_document(&FORMAT, parse, bytes, limits),
    write: None,
};

/// Numbers of a joint: place, orientation, radius.
const JOINT_VALUES: usize = 8;

/// What the schema says of an input with a hand.
struct Input {
    index: u64,
    side: Option<Side>,
    grip: bool,
    /// The joints in their order; `None` for one that is left out.
    joints: Vec<Option<Joint>>,
}

/// The hands of a recording.
pub(super) fn parse(text: &[u8], limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    let like = LandmarkClip {
        metres: Some(1.0),
        points_per_frame: LANDMARKS_21.len(),
        made_by: Some("IWER".into()),
        ..LandmarkClip::default()
    };
    let (mut hands, mut inputs, mut count) = (Sided::new(like), None, 0);
    each_frame(text, &mut |header, frame| {
        let inputs = match &inputs {
            Some(inputs) => inputs,
            None => inputs.insert(schema(header)?),
        };
        let list = frame.as_array().ok_or("no list")?;
        let time = list.first().and_then(Value::as_f64).ok_or("no time comes first")? * 1e-3;
        hands.pass(time);
        for value in list {
            let Some((side, joints)) = hand(value, inputs)? else { continue };
            count += 1;
            limits.check_frames(count, text.len() as u64).map_err(|excess| excess.to_string())?;
            hands.push(side, LandmarkFrame::of(time, place(&joints, 25)?))?;
        }
        Ok(())
    })?;
    hands.finished()
}

fn schema(header: &Map<String, Value>) -> Result<Vec<Input>, String> {
    let list =
        header.get("schema").and_then(Value::as_array).ok_or("no list \"schema\" comes before the frames")?;
    let input = |entry: &Value| -> Option<Input> {
        let (index, schema) = (entry.get(0)?.as_u64()?, entry.get(1)?);
        let has = |name: &str| schema.get(name).and_then(Value::as_bool).unwrap_or(false);
        let names = schema.get("jointSequence")?.as_array().filter(|_| has("hasHand"))?;
        let joint =
            |name: &Value| joint_named(name.as_str()?)?.0.filter(|joint| LANDMARKS_21.contains(joint));
        let joints = names.iter().map(joint).collect();
        Some(Input { index, side: schema.get("handedness").and_then(side), grip: has("hasGrip"), joints })
    };
    let inputs: Vec<Input> = list.iter().filter_map(input).collect();
    if inputs.is_empty() { Err("no input of the schema has a hand".into()) } else { Ok(inputs) }
}

type Joints = [Option<[f64; 3]>; 25];

/// The joints of an input in a frame; `None` where it is none with a hand.
fn hand(value: &Value, inputs: &[Input]) -> Result<Option<(Option<Side>, Joints)>, String> {
    let Some(list) = value.as_array() else { return Ok(None) };
    let index = list.first().and_then(Value::as_u64);
    let Some(input) = inputs.iter().find(|input| Some(input.index) == index) else { return Ok(None) };
    let numbers = |values: &[Value]| values.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>();
    let ray = list.get(1..8).and_then(numbers).ok_or("an input without the pose of its target ray")?;
    let ray = pose(&ray).ok_or("a target ray with an orientation of length 0")?;
    let at = 8 + usize::from(input.grip);
    let Some(values) = list.get(at).and_then(Value::as_array) else { return Ok(None) };
    let values = numbers(values).ok_or("a hand with what is no number")?;
    if values.len() != input.joints.len() * JOINT_VALUES {
        let expected = input.joints.len() * JOINT_VALUES;
        return Err(format!("a hand of {} numbers, expected {expected}", values.len()));
    }
    let mut joints = [None; 25];
    for (joint, values) in input.joints.iter().zip(values.chunks_exact(JOINT_VALUES)) {
        if let (Some(joint), [x, y, z, ..]) = (joint, values) {
            joints[joint.index()] = Some((ray * Point3::new(*x, *y, *z)).into());
        }
    }
    Ok(Some((input.side, joints)))
}

fn pose(values: &[f64]) -> Option<Isometry3<f64>> {
    let [x, y, z, i, j, k, w] = *values else { return None };
    let turn = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-6)?;
    Some(Isometry3::from_parts(Translation3::from(Vector3::new(x, y, z)), turn))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Motion;
    use crate::motion::tests::{apart, feasible};
    use handcast_hand::turns::ours_from_webxr;
    use handcast_hand::{Morphology, PoseClip, Skeleton};
    use serde_json::json;

    /// A recording of both hands as the recorder prints it, rounded to so many digits.
    fn recording(clips: &[PoseClip; 2], digits: i32) -> String {
        let names: Vec<&str> = Joint::ALL.map(Joint::webxr_name).to_vec();
        let round = |v: f64| (v * 10f64.powi(digits)).round() / 10f64.powi(digits);
        let of_pose = |pose: &Isometry3<f64>| {
            let (p, q) = (pose.translation.vector, pose.rotation.coords);
            [p.x, p.y, p.z, q.x, q.y, q.z, q.w].map(round)
        };
        let schema = |side: Side| {
            json!({ "handedness": side.name(), "targetRayMode": "tracked-pointer", "hasGrip": true, "hasHand": true,
                    "jointSequence": names, "hasGamepad": true })
        };
        let sides = [Side::Left, Side::Right];
        let schema: Vec<Value> = sides.iter().map(|&side| json!([side as usize, schema(side)])).collect();
        let frames = (0..clips[0].frames.len()).map(|i| {
            let mut row = vec![json!(clips[0].frames[i].time * 1e3)];
            row.extend([0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0].map(|v| json!(v)));
            for (side, clip) in sides.into_iter().zip(clips) {
                let frames = Skeleton::new(&Morphology::default(), side).frames(&clip.frames[i].pose);
                let turn = UnitQuaternion::from_euler_angles(0.3, -0.1 * i as f64, 0.2);
                let ray = Isometry3::from_parts(Translation3::new(0.1, 1.2, -0.3), turn);
                // What is read is the rounded ray.
                let ray = pose(&of_pose(&ray)).unwrap();
                let hand = Joint::ALL.map(|joint| {
                    let mut here = ray.inverse() * frames.get(joint);
                    here.rotation *= ours_from_webxr();
                    let mut values = of_pose(&here).to_vec();
                    values.push(0.008);
                    values
                });
                let mut input = vec![json!(side as usize)];
                input.extend(of_pose(&ray).map(|v| json!(v)));
                input.push(json!(of_pose(&ray)));
                input.push(json!(hand.concat()));
                input.push(json!([[0, 0, 0], null, 0.5]));
                row.push(Value::Array(input));
            }
            Value::Array(row)
        });
        format!("{{\"schema\":{},\"frames\":{}}}", json!(schema), Value::Array(frames.collect()))
    }

    #[test]
    fn recordings_give_both_hands_back() {
        let clips = [Side::Left, Side::Right].map(feasible);
        let mut both = clips[0].clone();
        both.header.hands.extend(clips[1].header.hands.clone());
        both.frames.extend(clips[1].frames.clone());
        let motion = Motion::parse("-".as_ref(), recording(&clips, 12).as_bytes()).unwrap();
        assert_eq!(motion.format.id, "iwer");
        let off = apart(&both, &motion.clip);
        assert!(off[0] < 2e-3 && off[1] < 1e-4 && off[2] < 1e-5, "{off:?}");
        // With the recorder's three digits joints are a millimetre off.
        let motion = Motion::parse("-".as_ref(), recording(&clips, 3).as_bytes()).unwrap();
        assert!(motion.import.unwrap().mean_distance < 1e-3);
        for side in [Side::Left, Side::Right] {
            let sizes = motion.clip.header.hand(side).and_then(|hand| hand.morphology.clone()).unwrap();
            let [found, true_hand] = [&sizes, &Morphology::default()].map(|sizes| Skeleton::new(sizes, side));
            for (pose, true_pose) in motion.clip.of(side).zip(both.of(side)) {
                let [found, expected] = [found.frames(&pose.pose), true_hand.frames(&true_pose.pose)];
                for joint in LANDMARKS_21 {
                    let off = (found.position(joint) - expected.position(joint)).norm();
                    assert!(off < 4e-3, "{}: {off}", joint.webxr_name());
                }
            }
        }
    }

    #[test]
    fn wrong_recordings_are_refused() {
        let clips = [Side::Left, Side::Right].map(feasible);
        let text = recording(&clips, 3);
        let parse = |text: &str| super::parse(text.as_bytes(), &Limits::default()).unwrap_err();
        assert!(parse(&text.replace("\"schema\"", "\"shape\"")).contains("no list \"schema\""));
        assert!(
            parse(&text.replace("\"hasHand\":true", "\"hasHand\":false")).contains("no input of the schema")
        );
        assert!(parse(&text.replacen("\"wrist\",", "", 1)).contains("a hand of 200 numbers, expected 192"));
        assert!(parse("{\"schema\":[],\"frames\":[]}").contains("no frame has a hand"));
    }
}
