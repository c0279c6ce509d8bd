//! Skeletons of other programs: hands on arms and bodies, in any unit and with any axes.
//!
//! Joints are known by their names ([`joints_named`]), the hierarchy says where each is in every frame, and poses are
//! solved for from there: how a program turns its axes does not matter. Needed are wrist, thumb base and the four
//! knuckles. A position channel stands in place of the offset. The tip is what hangs on the end joint and bears no other
//! name, mostly the end site; where there is none the end bone goes on as the one before it, [`END_BONE`] as long. The
//! unit is the one of metre, centimetre, millimetre and inch in which the hand is as long as a hand; else it is unknown.

use nalgebra::{Isometry3, Point3};

use super::{BvhError, Node, local};
use crate::landmarks::{LandmarkClip, LandmarkFrame};
use handcast_gltf::joints_named;
use handcast_hand::landmarks::{JointPoints, hand_length};
use handcast_hand::{Finger, Joint, Side};
use handcast_limits::{Limits, quoted};

/// Length of an end bone over that of the bone before it, where a file does not tell: that of the mean hand.
const END_BONE: f64 = 0.66;
/// Metres in the units that are tried, and the lengths of hands, metres.
const UNITS: [f64; 4] = [1.0, 0.01, 0.001, 0.0254];
const HAND_LENGTHS: std::ops::Range<f64> = 0.12..0.26;
/// Frames by which the unit is told.
const TRIED: usize = 50;

/// Where the joints of a hand are, by node.
struct FoundHand {
    side: Option<Side>,
    joints: [Option<usize>; 25],
}

/// The hands of a skeleton and where their joints are in each frame.
pub(super) fn clips(
    nodes: &[Node],
    rows: &[Vec<f64>],
    step: f64,
    bytes: usize,
    limits: &Limits,
) -> Result<Vec<LandmarkClip>, BvhError> {
    let (hands, left_out) = find(nodes)?;
    let wrong = |what: String| BvhError::NoHand { what };
    limits
        .check_frames(rows.len() * hands.len(), bytes as u64)
        .map_err(|excess| wrong(excess.to_string()))?;
    let empty = |hand: &FoundHand| LandmarkClip {
        rate: Some(1.0 / step),
        side: hand.side,
        notes: left_out.iter().cloned().collect(),
        points_per_frame: if hand.joints[Joint::PinkyMetacarpal.index()].is_some() { 25 } else { 21 },
        ..LandmarkClip::default()
    };
    let mut clips: Vec<LandmarkClip> = hands.iter().map(empty).collect();
    let mut world = vec![Isometry3::identity(); nodes.len()];
    for (i, row) in rows.iter().enumerate() {
        for (k, node) in nodes.iter().enumerate() {
            let here = local(node, row);
            world[k] = node.parent.map_or(here, |above| world[above] * here);
        }
        for (hand, clip) in hands.iter().zip(&mut clips) {
            let points = hand.points(nodes, &world);
            if points.iter().flatten().any(|p| !p.iter().all(|v| v.abs() < 1e6)) {
                return Err(wrong(format!("frame {i}: a joint is farther away than 1000000 units")));
            }
            clip.frames.push(LandmarkFrame::of(i as f64 * step, points));
        }
    }
    for clip in &mut clips {
        let seen: Vec<JointPoints> = clip.frames.iter().take(TRIED).map(|frame| frame.points).collect();
        let length = hand_length(&seen).unwrap_or(0.0);
        clip.metres = UNITS.into_iter().find(|unit| HAND_LENGTHS.contains(&(length * unit)));
    }
    Ok(clips)
}

impl FoundHand {
    fn points(&self, nodes: &[Node], world: &[Isometry3<f64>]) -> JointPoints {
        let mut points = self.joints.map(|node| node.map(|n| Point3::from(world[n].translation.vector)));
        for finger in Finger::ALL {
            let tip = Joint::tip(finger).index();
            let Some(end) = self.joints[tip - 1].filter(|_| points[tip].is_none()) else { continue };
            // The end joint's own shift lies along the bone before it, in that bone's axes.
            let Some(above) = nodes[end].parent else { continue };
            let bone =
                world[above].inverse_transform_point(&Point3::from(world[end].translation.vector)).coords;
            points[tip] = Some(world[end] * Point3::from(bone * END_BONE));
        }
        points
    }
}

/// The hands among the joints, left before right, and why another one is none.
fn find(nodes: &[Node]) -> Result<(Vec<FoundHand>, Option<String>), BvhError> {
    let mut found: [[Option<usize>; 25]; 3] = [[None; 25]; 3];
    let named = joints_named(nodes.iter().map(|node| node.name.as_str()));
    for (k, (node, named)) in nodes.iter().zip(&named).enumerate() {
        let Some((Some(joint), side)) = *named else { continue };
        let slot = &mut found[side.map_or(2, |side| side as usize)][joint.index()];
        if let Some(other) = slot.replace(k) {
            let what =
                format!("{:?} and {:?} are both the {}", nodes[other].name, node.name, joint.webxr_name());
            return Err(BvhError::NoHand { what });
        }
    }
    let (mut hands, mut missing) = (Vec::new(), None);
    for (side, mut joints) in [Some(Side::Left), Some(Side::Right), None].into_iter().zip(found) {
        if joints.iter().all(Option::is_none) {
            continue;
        }
        let needed = [Joint::Wrist].into_iter().chain(Finger::ALL.map(Joint::base));
        if let Some(lost) = needed.into_iter().find(|joint| joints[joint.index()].is_none()) {
            let of = side.map_or(String::new(), |side| format!("{} hand: ", side.name()));
            missing = missing.or(Some(format!("{of}no joint is the {}", lost.webxr_name())));
            continue;
        }
        for finger in Finger::ALL {
            let tip = Joint::tip(finger).index();
            let is_end = |k: usize, end| {
                nodes[k].parent == Some(end) && named[k].is_none() && nodes[k].offset != [0.0; 3]
            };
            let below = |end: usize| (0..nodes.len()).find(|&k| is_end(k, end));
            joints[tip] = joints[tip].or_else(|| joints[tip - 1].and_then(below));
        }
        hands.push(FoundHand { side, joints });
    }
    if hands.is_empty() {
        let names: Vec<String> = nodes.iter().take(8).map(|n| quoted(&n.name)).collect();
        let none = || {
            format!("no joint is the wrist of a hand in any convention; joints are {}, …", names.join(", "))
        };
        return Err(BvhError::NoHand { what: missing.unwrap_or_else(none) });
    }
    Ok((hands, missing.map(|what| format!("{what}; it is left out"))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Motion;
    use crate::motion::tests::{apart, feasible};
    use handcast_hand::{HandFrames, HandPose, Morphology, PoseClip, Skeleton};
    use nalgebra::{UnitQuaternion, Vector3};
    use std::fmt::Write;

    type Turn = UnitQuaternion<f64>;

    /// How a file is written: what joints are called, in which unit, how it lies at rest, and what it has.
    struct Style {
        name: fn(Joint, Side) -> Option<String>,
        unit: f64,
        rest: Turn,
        sites: bool,
        /// Whether each joint has its place in every row, and its offset says nothing.
        places: bool,
    }

    /// The finger of a joint, and its number there, the metacarpal's 0; `None` of the wrist.
    fn place(joint: Joint) -> Option<(Finger, usize)> {
        Finger::ALL.into_iter().find_map(|finger| {
            let joints = Joint::of(finger);
            let at = joints.iter().position(|other| *other == joint)?;
            Some((finger, at + 5 - joints.len()))
        })
    }

    fn rokoko(joint: Joint, side: Side) -> Option<String> {
        let word = if side == Side::Left { "Left" } else { "Right" };
        let Some((finger, at)) = place(joint) else { return Some(format!("{word}Hand")) };
        let bones = if finger == Finger::Thumb {
            ["", "Metacarpal", "Proximal", "Distal"]
        } else {
            ["Metacarpal", "Proximal", "Medial", "Distal"]
        };
        Some(format!("{word}Finger{}{}", finger as usize + 1, bones.get(at)?))
    }

    fn motive(joint: Joint, side: Side) -> Option<String> {
        let letter = if side == Side::Left { "L" } else { "R" };
        let Some((finger, at)) = place(joint) else { return Some(format!("{letter}Hand")) };
        let name = ["Thumb", "Index", "Middle", "Ring", "Pinky"][finger as usize];
        (1..4).contains(&at).then(|| format!("{letter}{name}{at}"))
    }

    /// Unity calls the thumb's first bone what others call its second.
    fn unity(joint: Joint, side: Side) -> Option<String> {
        let word = if side == Side::Left { "Left" } else { "Right" };
        let Some((finger, at)) = place(joint) else { return Some(format!("{word}Hand")) };
        let name = ["Thumb", "Index", "Middle", "Ring", "Little"][finger as usize];
        let bone = ["Proximal", "Intermediate", "Distal"].get(at.checked_sub(1)?)?;
        Some(format!("{word}{name}{bone}"))
    }

    /// A body with an arm and a hand that moves as in the clip.
    fn file(clip: &PoseClip, style: &Style) -> String {
        let side = clip.header.hands[0].side;
        let skeleton = Skeleton::new(&Morphology::default(), side);
        let mut neutral = HandPose::neutral(side);
        neutral.rotation = style.rest;
        let rest = skeleton.frames(&neutral);
        let (upper, lower) = (Vector3::new(0.2, 0.5, 0.01), Vector3::new(0.3, -0.02, 0.03));
        let numbers =
            |v: Vector3<f64>| format!("{} {} {}", v.x / style.unit, v.y / style.unit, v.z / style.unit);
        let channels = "CHANNELS 3 Zrotation Yrotation Xrotation";
        let mut text = format!(
            "HIERARCHY\nROOT Hips {{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation\n\
             JOINT Arm\n{{\n\tOFFSET {}\n\t{channels}\n",
            numbers(upper)
        );
        let mut order = Vec::new();
        write(&mut text, style, &rest, side, Joint::Wrist, numbers(lower), &mut order);
        text.push_str("}\n}\n");
        let _ = writeln!(text, "MOTION\nFrames:\t{}\nFrame Time:\t0.04", clip.frames.len());
        for (i, frame) in clip.frames.iter().enumerate() {
            let pose = skeleton.frames(&frame.pose);
            let world = |joint: Joint| pose.get(joint).rotation * rest.get(joint).rotation.inverse();
            let (hips, arm) = (
                Turn::from_euler_angles(0.1 * i as f64, 0.3, 1.0),
                Turn::from_euler_angles(-0.5, 0.05 * i as f64, 0.2),
            );
            let place = pose.position(Joint::Wrist).coords - hips * (upper + arm * lower);
            let degrees = |turn: Turn| {
                let (x, y, z) = turn.euler_angles();
                format!("{} {} {}", z.to_degrees(), y.to_degrees(), x.to_degrees())
            };
            let _ = write!(text, "{} {} {}", numbers(place), degrees(hips), degrees(arm));
            for (joint, above, place) in &order {
                let above = above.map_or(hips * arm, world);
                if style.places {
                    let _ = write!(text, " {place}");
                }
                let _ = write!(text, " {}", degrees(above.inverse() * world(*joint)));
            }
            text.push('\n');
        }
        text
    }

    /// A joint and those below it; `order` gets the joints with channels, and the one each hangs on.
    fn write(
        text: &mut String,
        style: &Style,
        rest: &HandFrames,
        side: Side,
        joint: Joint,
        offset: String,
        order: &mut Vec<(Joint, Option<Joint>, String)>,
    ) {
        let name = (style.name)(joint, side).unwrap();
        let channels = if style.places { "6 Xposition Yposition Zposition" } else { "3" };
        let told = if style.places { "9 9 9" } else { &offset };
        let _ = writeln!(
            text,
            "JOINT {name}\n{{\nOFFSET {told}\nCHANNELS {channels} Zrotation Yrotation Xrotation"
        );
        let above = order.iter().rev().map(|(j, ..)| *j).find(|above| is_above(style, side, *above, joint));
        order.push((joint, above, offset));
        let away = |from: Joint, to: Joint| {
            let v = (rest.position(to) - rest.position(from)) / style.unit;
            format!("{} {} {}", v.x, v.y, v.z)
        };
        let mut below = Vec::new();
        children(style, side, joint, &mut below);
        for child in below {
            write(text, style, rest, side, child, away(joint, child), order);
        }
        let tip = Joint::ALL
            .get(joint.index() + 1)
            .filter(|next| next.parent() == Some(joint) && (style.name)(**next, side).is_none());
        if let Some(tip) =
            tip.filter(|tip| style.sites && Finger::ALL.iter().any(|f| Joint::tip(*f) == **tip))
        {
            let _ = writeln!(text, "End Site\n{{\nOFFSET {}\n}}", away(joint, *tip));
        }
        text.push_str("}\n");
    }

    /// The joints with a name that hang on this one, over those without.
    fn children(style: &Style, side: Side, joint: Joint, out: &mut Vec<Joint>) {
        for child in Joint::ALL.into_iter().filter(|j| j.parent() == Some(joint)) {
            match (style.name)(child, side) {
                Some(_) => out.push(child),
                None => children(style, side, child, out),
            }
        }
    }

    fn is_above(style: &Style, side: Side, above: Joint, joint: Joint) -> bool {
        let mut below = Vec::new();
        children(style, side, above, &mut below);
        below.contains(&joint)
    }

    #[test]
    fn hands_on_bodies_are_read_under_any_names_and_axes() {
        let turned = Turn::from_euler_angles(0.4, -1.2, 2.0);
        for side in [Side::Left, Side::Right] {
            let clip = feasible(side);
            for style in [
                Style { name: rokoko, unit: 0.01, rest: turned, sites: true, places: false },
                Style { name: motive, unit: 0.001, rest: Turn::identity(), sites: true, places: true },
                Style { name: motive, unit: 0.0254, rest: turned, sites: true, places: false },
                Style { name: unity, unit: 0.01, rest: turned, sites: true, places: false },
            ] {
                let text = file(&clip, &style);
                let motion = Motion::parse("-".as_ref(), text.as_bytes()).unwrap();
                let off = apart(&clip, &motion.clip);
                assert!(
                    off[0] < 2e-3 && off[1] < 1e-4 && off[2] < 1e-5,
                    "{} {}: {off:?}",
                    style.unit,
                    side.name()
                );
                assert!(motion.placed && motion.import.is_some());
            }
        }
    }

    #[test]
    fn end_bones_without_a_site_go_on_as_the_bones_before() {
        let clip = feasible(Side::Right);
        let style = Style { name: rokoko, unit: 0.01, rest: Turn::identity(), sites: false, places: false };
        let motion = Motion::parse("-".as_ref(), file(&clip, &style).as_bytes()).unwrap();
        for (found, frame) in motion.clip.frames.iter().zip(&clip.frames) {
            for finger in Finger::LONG {
                let off = found.pose.angle(finger.end_flexion()) - frame.pose.angle(finger.end_flexion());
                assert!(off.abs() < 0.02, "{}: {off}", finger.name());
            }
        }
    }

    #[test]
    fn channels_are_known_in_any_case_and_others_refused() {
        let clip = feasible(Side::Left);
        let style = Style { name: rokoko, unit: 0.01, rest: Turn::identity(), sites: true, places: false };
        let text = file(&clip, &style);
        let read = |text: &str| Motion::parse("a.bvh".as_ref(), text.as_bytes());
        let plain = read(&text).unwrap();
        let cased = read(&text.replace("Zrotation", "ZROTATION").replace("Xrotation", "xRotation")).unwrap();
        assert_eq!(plain.clip, cased.clip);
        for (from, to, words) in [
            (
                "CHANNELS 3 Zrotation",
                "CHANNELS 3 Zrot",
                "no channel is called \"Zrot\"; allowed are Xposition",
            ),
            ("CHANNELS 3 Zrotation", "CHANNELS 7 Zrotation", "7 channels, of which 3 are named"),
            ("CHANNELS 3 Zrotation", "CHANNELS Zrotation", "CHANNELS needs their number first"),
            (
                "CHANNELS 3 Zrotation Yrotation",
                "CHANNELS 3 Zrotation Zrotation",
                "the channel Zrotation is there twice",
            ),
        ] {
            let message = read(&text.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn a_hand_that_is_not_whole_beside_another_is_told() {
        let style = Style { name: rokoko, unit: 0.01, rest: Turn::identity(), sites: true, places: false };
        let text = file(&feasible(Side::Left), &style);
        let more =
            "JOINT RightHand\n{\nOFFSET 1 2 3\nJOINT RightFinger2Proximal\n{\nOFFSET 1 2 3\n}\n}\nJOINT Arm";
        let motion = Motion::parse("a.bvh".as_ref(), text.replacen("JOINT Arm", more, 1).as_bytes()).unwrap();
        assert_eq!(motion.clip.header.hands.len(), 1);
        let words = "right hand: no joint is the thumb-metacarpal; it is left out";
        assert_eq!(motion.notes, [words]);
    }

    #[test]
    fn skeletons_without_a_hand_are_refused() {
        let message = |text: &str| Motion::parse("a.bvh".as_ref(), text.as_bytes()).unwrap_err().to_string();
        let style = Style { name: rokoko, unit: 0.01, rest: Turn::identity(), sites: true, places: false };
        let text = file(&feasible(Side::Right), &style);
        for (text, words) in [
            (
                text.replace("Finger4Proximal", "x"),
                "right hand: no joint is the ring-finger-phalanx-proximal",
            ),
            (
                text.replace("RightHand", "RightPaw").replace("Finger", "Claw"),
                "joints are \"Hips\", \"Arm\", \"RightPaw\"",
            ),
            (
                text.replace("RightFinger3Medial", "RightFinger2Medial"),
                "are both the index-finger-phalanx-intermediate",
            ),
        ] {
            let message = message(&text);
            assert!(message.contains(words), "{message}");
        }
    }
}
