//! Poses back from the BVH files that [`crate::export::bvh`] writes.

use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;

use handcast_gltf::JointNames;
use handcast_hand::clip::MAX_FRAMES;
use handcast_hand::turns::pose_from_turns;
use handcast_hand::{ClipHand, Finger, Joint, PoseClip, PoseHeader, Side, TimedPose};

/// Most joints in a file: two hands and a root have 41.
const MAX_JOINTS: usize = 4096;

/// What is wrong with a BVH file.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum BvhError {
    /// The text is no BVH.
    #[error("bvh: line {line}: {what}")]
    Syntax {
        /// Line number, from 1.
        line: usize,
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// It ends too early.
    #[error("bvh: the file ends in its {part}")]
    Short {
        /// Where.
        part: &'static str,
    },
    /// It moves no hand of this program.
    #[error("bvh: {what}")]
    NoHand {
        /// What is missing.
        what: String,
    },
}

/// A joint of the hierarchy and where its numbers stand in a row.
#[derive(Debug, Default)]
struct Node {
    name: String,
    offset: [f64; 3],
    channels: Vec<(String, usize)>,
}

/// Reads a BVH file with the joints this program writes (any naming convention): metres, degrees, axes parallel at
/// zero. The side is told by the names, or else by the place of the thumb.
///
/// # Errors
/// See [`BvhError`].
pub fn read_bvh(text: &str) -> Result<PoseClip, BvhError> {
    let mut lines = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())).filter(|(_, l)| !l.is_empty());
    match lines.next() {
        Some((_, "HIERARCHY")) => {}
        found => {
            let line = found.map_or(1, |(line, _)| line);
            return Err(BvhError::Syntax { line, what: "the first word must be HIERARCHY".into() });
        }
    }
    let (nodes, width) = hierarchy(&mut lines)?;
    let (rows, step) = motion(&mut lines, width)?;
    let hands = hands(&nodes)?;
    let mut clip = PoseClip { header: PoseHeader::default(), frames: Vec::new() };
    clip.header.rate = Some(1.0 / step);
    for (side, joints) in hands {
        clip.header.hands.push(ClipHand { side, morphology: None });
        for (i, row) in rows.iter().enumerate() {
            let turn = |joint: Joint| {
                joints[joint.index()].map_or_else(UnitQuaternion::identity, |n| rotation(n, row))
            };
            let mut pose = pose_from_turns(side, turn);
            pose.rotation = turn(Joint::Wrist);
            pose.translation = joints[Joint::Wrist.index()].map_or_else(Vector3::zeros, |n| position(n, row));
            clip.frames.push(TimedPose::new(i as f64 * step, pose));
        }
    }
    Ok(clip)
}

fn hierarchy<'a>(lines: &mut impl Iterator<Item = (usize, &'a str)>) -> Result<(Vec<Node>, usize), BvhError> {
    let mut nodes: Vec<Node> = Vec::new();
    let mut width = 0;
    for (line, text) in lines {
        let wrong = |what: &str| BvhError::Syntax { line, what: what.to_owned() };
        let mut words = text.split_whitespace();
        match words.next() {
            Some("MOTION") => return Ok((nodes, width)),
            Some("ROOT" | "JOINT" | "End") if nodes.len() >= MAX_JOINTS => {
                return Err(wrong(&format!("more than the {MAX_JOINTS} joints allowed")));
            }
            // End sites have no channels, so that no joint is mistaken for one.
            Some("ROOT" | "JOINT") => {
                nodes.push(Node { name: words.next().unwrap_or_default().to_owned(), ..Node::default() });
            }
            Some("End") => nodes.push(Node::default()),
            Some("OFFSET") => {
                let numbers: Vec<f64> = words.filter_map(|w| w.parse().ok()).collect();
                let node = nodes.last_mut().ok_or_else(|| wrong("an offset before any joint"))?;
                node.offset = numbers.try_into().map_err(|_| wrong("OFFSET needs three numbers"))?;
            }
            Some("CHANNELS") => {
                let names: Vec<&str> = words.skip(1).collect();
                let node = nodes.last_mut().ok_or_else(|| wrong("channels before any joint"))?;
                if names.len() > 6 {
                    return Err(wrong("more than 6 channels"));
                }
                for name in names {
                    node.channels.push((name.to_owned(), width));
                    width += 1;
                }
            }
            Some("{" | "}") => {}
            _ => return Err(wrong("expected ROOT, JOINT, End Site, OFFSET, CHANNELS, a brace or MOTION")),
        }
    }
    Err(BvhError::Short { part: "hierarchy" })
}

fn motion<'a>(
    lines: &mut impl Iterator<Item = (usize, &'a str)>,
    width: usize,
) -> Result<(Vec<Vec<f64>>, f64), BvhError> {
    let mut field = |name: &'static str| -> Result<f64, BvhError> {
        let (line, text) = lines.next().ok_or(BvhError::Short { part: "motion" })?;
        let value = text.strip_prefix(name).and_then(|v| v.trim().parse::<f64>().ok());
        let sound = value.filter(|v| v.is_finite() && *v > 0.0);
        sound.ok_or_else(|| BvhError::Syntax {
            line,
            what: format!("expected {name:?} and a positive number"),
        })
    };
    let count = field("Frames:")?;
    let step = field("Frame Time:")?;
    let mut rows = Vec::new();
    for (line, text) in lines {
        let wrong = |what: String| BvhError::Syntax { line, what };
        let row = text.split_whitespace().map(str::parse::<f64>).collect::<Result<Vec<f64>, _>>();
        let row = row.map_err(|e| wrong(e.to_string()))?;
        if row.len() != width || row.iter().any(|v| !v.is_finite()) {
            return Err(wrong(format!("{} finite numbers expected, found {}", width, row.len())));
        }
        if rows.len() == MAX_FRAMES {
            return Err(wrong(format!("more than the {MAX_FRAMES} frames allowed")));
        }
        rows.push(row);
    }
    if rows.len() as f64 == count { Ok((rows, step)) } else { Err(BvhError::Short { part: "motion" }) }
}

/// The nodes of a hand, by joint; tips have none.
type HandNodes<'a> = (Side, [Option<&'a Node>; 25]);

fn hands(nodes: &[Node]) -> Result<Vec<HandNodes<'_>>, BvhError> {
    let find = |name: &str| nodes.iter().find(|n| n.name == name);
    let mut hands: Vec<HandNodes> = Vec::new();
    let tries = [(1, Side::Right), (2, Side::Left), (2, Side::Right)];
    for (names, (count, told)) in JointNames::ALL.into_iter().flat_map(|n| tries.map(|t| (n, t))) {
        let named = |joint: Joint| find(&names.name(joint, told, count));
        if named(Joint::Wrist).is_none() {
            continue;
        }
        let mut joints = [None; 25];
        for joint in Joint::ALL {
            let tip = Finger::ALL.into_iter().any(|f| Joint::tip(f) == joint);
            joints[joint.index()] = named(joint);
            if joints[joint.index()].is_none() && !tip {
                return Err(BvhError::NoHand {
                    what: format!("joint {} is missing", names.name(joint, told, count)),
                });
            }
        }
        // A right hand's thumb is on the side of +X.
        let thumb = joints[Joint::of(Finger::Thumb)[0].index()].map_or(0.0, |n| n.offset[0]);
        let side = if thumb > 0.0 { Side::Right } else { Side::Left };
        if hands.iter().all(|(s, _)| *s != side) {
            hands.push((side, joints));
        }
    }
    if hands.is_empty() {
        return Err(BvhError::NoHand { what: "no joint is named wrist, in any convention".into() });
    }
    Ok(hands)
}

/// Channels apply from the left.
fn rotation(node: &Node, row: &[f64]) -> UnitQuaternion<f64> {
    node.channels.iter().fold(UnitQuaternion::identity(), |turned, (name, at)| {
        let axis = match name.as_str() {
            "Xrotation" => Vector3::x_axis(),
            "Yrotation" => Vector3::y_axis(),
            "Zrotation" => Vector3::z_axis(),
            _ => return turned,
        };
        turned * UnitQuaternion::from_axis_angle(&axis, row.get(*at).copied().unwrap_or(0.0).to_radians())
    })
}

fn position(node: &Node, row: &[f64]) -> Vector3<f64> {
    let value = |name: &str| {
        let channel = node.channels.iter().find(|(n, _)| n == name);
        channel.and_then(|(_, at)| row.get(*at)).copied().unwrap_or(0.0)
    };
    Vector3::new(value("Xposition"), value("Yposition"), value("Zposition"))
}

#[cfg(test)]
mod tests {
    use super::super::tests::{clip, worst};
    use super::*;
    use crate::export::bvh;
    use handcast_hand::Morphology;

    #[test]
    fn one_hand_of_either_side_under_any_names() {
        for side in [Side::Left, Side::Right] {
            for names in JointNames::ALL {
                let one = clip(&[side]);
                let back = read_bvh(&bvh(&one, &Morphology::default(), names, 25.0).unwrap()).unwrap();
                assert_eq!(back.header.hands[0].side, side, "{names:?}");
                assert!(worst(&one, &back) < 2e-6, "{names:?}");
            }
        }
    }

    #[test]
    fn damaged_files_are_refused() {
        let text = bvh(&clip(&[Side::Right]), &Morphology::default(), JointNames::WebXr, 25.0).unwrap();
        let cut = &text[..text.len() - 40];
        for (text, words) in [
            ("", "HIERARCHY"),
            (&text[..300], "line"),
            (cut, "found"),
            (&text.replace("Frames: 30", "Frames: 31"), "motion"),
            (&text.replace("ROOT wrist", "ROOT hip"), "wrist"),
            (&text.replace("JOINT thumb-metacarpal", "JOINT other"), "thumb-metacarpal"),
        ] {
            let message = read_bvh(text).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}
