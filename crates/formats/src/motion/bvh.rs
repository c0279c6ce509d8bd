//! Biovision hierarchy (BVH): a tree of joints with their offsets, and a row of angles for each instant.
//!
//! ```text
//! HIERARCHY
//! ROOT wrist
//! {
//!   OFFSET 0.000000 0.000000 0.000000
//!   CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
//!   JOINT thumb-metacarpal
//!   {
//!     OFFSET 0.018000 0.019000 0.008000
//!     CHANNELS 3 Zrotation Xrotation Yrotation
//!     …
//! MOTION
//! Frames: 30
//! Frame Time: 0.04000000
//! 0.100000 -0.200000 -0.500000 0.00000 12.50000 …
//! ```
//!
//! Offsets are metres, channels degrees. The root is the wrist; of two hands a common root `hands` that keeps still,
//! since many readers know one root only. The wrist has six channels, every other joint three: rotations about its own
//! axes, z, then x, then y. At zero all axes are parallel (+Y along the fingers, +Z out of the palm). Tips are end
//! sites. Joints are named by any convention of [`JointNames`]; where the names do not tell the side, the place of the
//! thumb does. The person's sizes are those of the offsets; how thick a finger is, they do not tell. Files of other
//! programs are read as [`foreign`] says.

pub(crate) mod foreign;

use std::fmt::Write as _;
use std::io;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use thiserror::Error;

use super::format::head;
use super::{
    Content, Format, Keeps, Lost, Motion, Ticks, Times, WriteError, WriteOptions, Writer, rounded, sides,
    skeleton,
};
use crate::landmarks::LandmarkClip;
use handcast_gltf::JointNames;
use handcast_hand::clip::MAX_RATE;
use handcast_hand::turns::{PosesFromTurns, turns_zxy};
use handcast_hand::{
    ClipHand, Finger, HandFrames, Joint, Morphology, PoseClip, PoseHeader, Side, Skeleton, TimedPose,
};
use handcast_limits::{Limit, Limits, quoted};

/// Its row.
pub(crate) static FORMAT: Format = Format {
    id: "bvh",
    name: "BVH",
    kind: "bvh",
    ending: ".bvh",
    hands: 2,
    sniff,
    read: |bytes, limits| match parse(&String::from_utf8_lossy(bytes), limits)? {
        Parsed::Ours(clip) => Ok(Motion::of(&FORMAT, clip).into()),
        Parsed::Foreign(hands) => Ok(Content::Joints(hands)),
    },
    write: Some(Writer { keeps: Keeps { times: Times::Even, ..Keeps::all(Lost::Bridged) }, write }),
};

pub(crate) fn sniff(bytes: &[u8]) -> bool {
    head(bytes).starts_with(FIRST.as_bytes())
}

/// The words that begin a file, its motion and what is in it.
const FIRST: &str = "HIERARCHY";
const MOTION: &str = "MOTION";
const FRAMES: &str = "Frames:";
const FRAME_TIME: &str = "Frame Time:";
/// What can change at a wrist, and at any other joint.
const WRIST_CHANNELS: &str = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation";
const JOINT_CHANNELS: &str = "CHANNELS 3 Zrotation Xrotation Yrotation";

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
    /// Its motion is not as long as it says.
    #[error("bvh: the motion has {found} lines, but \"{FRAMES}\" tells {told}")]
    Count {
        /// What it says.
        told: f64,
        /// Lines that follow.
        found: usize,
    },
    /// Its frames are nearer to one another than those of any motion.
    #[error("bvh: \"{FRAME_TIME}\" tells {step} s, allowed at least {} s", MAX_RATE.recip())]
    Step {
        /// Seconds from frame to frame.
        step: f64,
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
    /// The joint that it hangs on, which comes before it.
    parent: Option<usize>,
    offset: [f64; 3],
    /// Each by its name in [`CHANNELS`].
    channels: Vec<(&'static str, usize)>,
}

/// What moves a joint.
const CHANNELS: [&str; 6] = ["Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation"];

/// What a file holds.
enum Parsed {
    /// Poses, as this program writes them.
    Ours(PoseClip),
    /// Joints of another program's skeleton.
    Foreign(Vec<LandmarkClip>),
}

/// Reads a file with the joints this program writes.
///
/// # Errors
/// See [`BvhError`]; [`BvhError::NoHand`] for the skeleton of another program ([`Motion::parse`] reads it).
pub fn read_bvh(text: &str) -> Result<PoseClip, BvhError> {
    match parse(text, &Limits::default())? {
        Parsed::Ours(clip) => Ok(clip),
        Parsed::Foreign(_) => {
            Err(BvhError::NoHand { what: "the skeleton is that of another program".into() })
        }
    }
}

/// The joints of another program's skeleton.
pub(crate) fn parse_foreign(bytes: &[u8], limits: &Limits) -> Result<Vec<LandmarkClip>, String> {
    match parse(&String::from_utf8_lossy(bytes), limits)
        .map_err(|error| error.to_string().trim_start_matches("bvh: ").to_owned())?
    {
        Parsed::Ours(_) => Err("it tells poses, those of this program, not joint positions".into()),
        Parsed::Foreign(hands) => Ok(hands),
    }
}

fn parse(text: &str, limits: &Limits) -> Result<Parsed, BvhError> {
    let mut lines = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())).filter(|(_, l)| !l.is_empty());
    match lines.next() {
        Some((_, FIRST)) => {}
        found => {
            let line = found.map_or(1, |(line, _)| line);
            return Err(BvhError::Syntax { line, what: format!("the first word must be {FIRST}") });
        }
    }
    let (nodes, width) = hierarchy(&mut lines, limits)?;
    let (rows, step) = motion(&mut lines, width, limits)?;
    let Some(hands) = hands(&nodes) else {
        return foreign::clips(&nodes, &rows, step, text.len(), limits).map(Parsed::Foreign);
    };
    let mut clip = PoseClip { header: PoseHeader::default(), frames: Vec::new() };
    clip.header.rate = Some(1.0 / step);
    for (side, joints) in hands {
        clip.header.hands.push(ClipHand { side, morphology: sizes(side, &joints) });
        let mut poses = PosesFromTurns::new(side);
        for (i, row) in rows.iter().enumerate() {
            let turn = |joint: Joint| {
                joints[joint.index()].map_or_else(UnitQuaternion::identity, |n| rotation(n, row))
            };
            let mut pose = poses.pose(turn);
            let wrist =
                joints[Joint::Wrist.index()].map_or_else(Isometry3::identity, |n| world(&nodes, n, row));
            (pose.rotation, pose.translation) = (wrist.rotation, wrist.translation.vector);
            clip.frames.push(TimedPose::new(i as f64 * step, pose));
        }
    }
    Ok(Parsed::Ours(clip))
}

fn hierarchy<'a>(
    lines: &mut impl Iterator<Item = (usize, &'a str)>,
    limits: &Limits,
) -> Result<(Vec<Node>, usize), BvhError> {
    let mut nodes: Vec<Node> = Vec::new();
    // The joints whose braces are open.
    let mut open: Vec<usize> = Vec::new();
    let mut width = 0;
    for (line, text) in lines {
        let wrong = |what: &str| BvhError::Syntax { line, what: what.to_owned() };
        let mut words = text.split_whitespace();
        match words.next() {
            Some(MOTION) if !open.is_empty() => return Err(wrong("a brace is not closed")),
            Some(MOTION) => return Ok((nodes, width)),
            Some(kind @ ("ROOT" | "JOINT" | "End")) => {
                let one_more = limits.check_count(Limit::Nodes, nodes.len() + 1);
                one_more.map_err(|excess| wrong(&excess.to_string()))?;
                // End sites have no name and no channels, so that no joint is mistaken for one.
                let rest = text[kind.len()..].trim_end_matches('{').trim();
                let name = if kind == "End" { "" } else { rest };
                nodes.push(Node { name: name.to_owned(), parent: open.last().copied(), ..Node::default() });
                if text.ends_with('{') {
                    open.push(nodes.len() - 1);
                }
            }
            Some("OFFSET") => {
                let numbers: Vec<f64> =
                    words.filter_map(|w| w.parse().ok()).filter(|v: &f64| v.is_finite()).collect();
                let node = nodes.last_mut().ok_or_else(|| wrong("an offset before any joint"))?;
                node.offset = numbers.try_into().map_err(|_| wrong("OFFSET needs three numbers"))?;
            }
            Some("CHANNELS") => {
                let count = words.next().and_then(|count| count.parse::<usize>().ok());
                let node = nodes.last_mut().ok_or_else(|| wrong("channels before any joint"))?;
                node.channels = channels(words, count, width).map_err(|what| wrong(&what))?;
                width += node.channels.len();
            }
            Some("{") => {
                open.push(nodes.len().checked_sub(1).ok_or_else(|| wrong("a brace before any joint"))?)
            }
            Some("}") => {
                open.pop().ok_or_else(|| wrong("a closing brace too many"))?;
            }
            _ => return Err(wrong("expected ROOT, JOINT, End Site, OFFSET, CHANNELS, a brace or MOTION")),
        }
    }
    Err(BvhError::Short { part: "hierarchy" })
}

/// The channels that a line names, and where their numbers stand in a row; `told` is how many it says there are.
fn channels<'a>(
    names: impl Iterator<Item = &'a str>,
    told: Option<usize>,
    from: usize,
) -> Result<Vec<(&'static str, usize)>, String> {
    let mut found = Vec::new();
    for name in names {
        let known = CHANNELS.into_iter().find(|known| known.eq_ignore_ascii_case(name));
        let known = known.ok_or_else(|| {
            format!("no channel is called {}; allowed are {}", quoted(name), CHANNELS.join(", "))
        })?;
        if found.iter().any(|(other, _)| *other == known) {
            return Err(format!("the channel {known} is there twice"));
        }
        found.push((known, from + found.len()));
    }
    match told {
        Some(told) if told == found.len() && told <= CHANNELS.len() => Ok(found),
        Some(told) => Err(format!("{told} channels, of which {} are named; allowed are 0 to 6", found.len())),
        None => Err("CHANNELS needs their number first".to_owned()),
    }
}

fn motion<'a>(
    lines: &mut impl Iterator<Item = (usize, &'a str)>,
    width: usize,
    limits: &Limits,
) -> Result<(Vec<Vec<f64>>, f64), BvhError> {
    let mut field = |name: &'static str| -> Result<f64, BvhError> {
        let (line, text) = lines.next().ok_or(BvhError::Short { part: "motion" })?;
        // Blanks are of any kind and number.
        let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
        let value = words.strip_prefix(name).and_then(|v| v.trim().parse::<f64>().ok());
        let sound = value.filter(|v| v.is_finite() && *v > 0.0);
        sound.ok_or_else(|| BvhError::Syntax {
            line,
            what: format!("expected {name:?} and a positive number"),
        })
    };
    let count = field(FRAMES)?;
    let step = field(FRAME_TIME)?;
    if step.recip() > MAX_RATE {
        return Err(BvhError::Step { step });
    }
    let mut rows = Vec::new();
    for (line, text) in lines {
        let wrong = |what: String| BvhError::Syntax { line, what };
        let row = numbers(text, width).map_err(wrong)?;
        limits.check_count(Limit::Instants, rows.len() + 1).map_err(|excess| wrong(excess.to_string()))?;
        rows.push(row);
    }
    if rows.len() as f64 == count {
        return Ok((rows, step));
    }
    Err(BvhError::Count { told: count, found: rows.len() })
}

/// The numbers in a line of the motion.
fn numbers(text: &str, width: usize) -> Result<Vec<f64>, String> {
    let number = |(i, word): (usize, &str)| {
        let value = word.parse::<f64>().ok().filter(|value| value.is_finite());
        value.ok_or_else(|| format!("number {} is {}, allowed are finite numbers", i + 1, quoted(word)))
    };
    let row = text.split_whitespace().enumerate().map(number).collect::<Result<Vec<_>, _>>()?;
    if row.len() == width { Ok(row) } else { Err(format!("{width} numbers expected, found {}", row.len())) }
}

/// The nodes of a hand, by joint; those of tips are end sites.
type HandNodes<'a> = (Side, [Option<&'a Node>; 25]);

/// How far a bone may lie off the axis that it has in our files, metres.
const OFF_AXIS: f64 = 1e-4;

/// The hands of a file of this program; `None` for the skeleton of another.
fn hands(nodes: &[Node]) -> Option<Vec<HandNodes<'_>>> {
    let find = |name: &str| nodes.iter().position(|n| n.name == name);
    let mut hands: Vec<HandNodes> = Vec::new();
    let tries = [(1, Side::Right), (2, Side::Left), (2, Side::Right)];
    for (names, (count, told)) in JointNames::ALL.into_iter().flat_map(|n| tries.map(|t| (n, t))) {
        let named = |joint: Joint| find(&names.name(joint, told, count));
        if named(Joint::Wrist).is_none() {
            continue;
        }
        let end_of = |joint: Joint| {
            let above = named(joint.parent()?)?;
            nodes.iter().position(|n| n.name.is_empty() && n.parent == Some(above))
        };
        let joints = Joint::ALL.map(|joint| {
            let at = if is_tip(joint) { end_of(joint) } else { named(joint) };
            at.and_then(|at| nodes.get(at))
        });
        if !Joint::ALL.into_iter().all(|joint| is_tip(joint) || is_ours(joint, joints[joint.index()])) {
            return None;
        }
        // A right hand's thumb is on the side of +X.
        let thumb = joints[Joint::of(Finger::Thumb)[0].index()].map_or(0.0, |n| n.offset[0]);
        let side = if thumb > 0.0 { Side::Right } else { Side::Left };
        if hands.iter().all(|(s, _)| *s != side) {
            hands.push((side, joints));
        }
    }
    (!hands.is_empty()).then_some(hands)
}

/// Whether a joint is there and lies as in our files: in metres, behind a bone along +Y, turned as we turn it.
fn is_ours(joint: Joint, node: Option<&Node>) -> bool {
    let Some(Node { offset: [x, y, z], channels, .. }) = node else { return false };
    let words = if joint == Joint::Wrist { WRIST_CHANNELS } else { JOINT_CHANNELS };
    let named = channels.iter().map(|(name, _)| *name).eq(words.split_whitespace().skip(2));
    let inner =
        Finger::ALL.into_iter().any(|finger| joint > Joint::base(finger) && joint < Joint::tip(finger));
    let along = x.abs().max(z.abs()) < OFF_AXIS && *y > 0.0;
    named && [x, y, z].into_iter().all(|v| v.abs() < 1.0) && (along || !inner)
}

/// The sizes that the offsets of one of our files tell: at zero no bone is turned. The thickness is that of the mean hand
/// of that length. `None` where an end site is missing, or nobody has such a hand.
fn sizes(side: Side, joints: &[Option<&Node>; 25]) -> Option<Morphology> {
    let offset = |joint: Joint| {
        let [x, y, z] = joints[joint.index()]?.offset;
        Some(Vector3::new(if side == Side::Left { -x } else { x }, y, z))
    };
    let mut fingers = Morphology::default().fingers;
    for (finger, sizes) in Finger::ALL.into_iter().zip(&mut fingers) {
        let metacarpal = offset(Joint::of(finger)[0])?;
        let base = if finger == Finger::Thumb { Vector3::zeros() } else { offset(Joint::base(finger))? };
        let first = Joint::base(finger).index() + 1;
        for (bone, joint) in sizes.bones.iter_mut().zip(&Joint::ALL[first..]) {
            *bone = offset(*joint)?.norm();
        }
        (sizes.metacarpal, sizes.base) = (metacarpal.into(), (metacarpal + base).into());
    }
    let middle = &fingers[Finger::Middle as usize];
    let mut morphology = Morphology::average(middle.base[1] + middle.length());
    for (sizes, told) in morphology.fingers.iter_mut().zip(&fingers) {
        (sizes.metacarpal, sizes.base, sizes.bones) = (told.metacarpal, told.base, told.bones);
    }
    morphology.validate().is_ok().then_some(morphology)
}

/// Where a joint is in a row, with all that it hangs on.
fn world(nodes: &[Node], node: &Node, row: &[f64]) -> Isometry3<f64> {
    // What hangs on another comes behind it, so that this ends.
    let above = |node: &&Node| node.parent.and_then(|above| nodes.get(above));
    std::iter::successors(above(&node), above).fold(local(node, row), |here, above| local(above, row) * here)
}

/// A joint against the one above it.
fn local(node: &Node, row: &[f64]) -> Isometry3<f64> {
    Isometry3::from_parts(shift(node, row).into(), rotation(node, row))
}

/// The same before it turns: a position channel stands in place of the offset.
fn shift(node: &Node, row: &[f64]) -> Vector3<f64> {
    let moves = node.channels.iter().any(|(name, _)| name.ends_with("position"));
    if moves { position(node, row) } else { node.offset.into() }
}

/// Channels apply from the left.
fn rotation(node: &Node, row: &[f64]) -> UnitQuaternion<f64> {
    node.channels.iter().fold(UnitQuaternion::identity(), |turned, (name, at)| {
        let axis = match *name {
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
        let channel = node.channels.iter().find(|(n, _)| *n == name);
        channel.and_then(|(_, at)| row.get(*at)).copied().unwrap_or(0.0)
    };
    Vector3::new(value("Xposition"), value("Yposition"), value("Zposition"))
}

fn write(
    clip: &PoseClip,
    options: &WriteOptions,
    out: &mut dyn io::Write,
) -> Result<Vec<String>, WriteError> {
    write_bvh(clip, &options.morphology, options.gltf.names, options.rate_of(clip)?, out)?;
    Ok(Vec::new())
}

/// Writes the valid poses at `rate` frames a second from the clip's first instant on; a hand that comes later or goes
/// earlier holds its first or last pose. Hands of unknown sizes get those of `fallback`.
///
/// # Errors
/// [`WriteError::Empty`], [`WriteError::Rate`], [`WriteError::Io`].
pub fn write_bvh(
    clip: &PoseClip,
    fallback: &Morphology,
    names: JointNames,
    rate: f64,
    mut out: impl io::Write,
) -> Result<(), WriteError> {
    let ticks = Ticks::of(clip, rate)?;
    let sides = sides(clip);
    let mut text = format!("{FIRST}\n");
    let two = sides.len() > 1;
    if two {
        let _ = writeln!(text, "ROOT hands\n{{\n  OFFSET 0 0 0\n  {WRIST_CHANNELS}");
    }
    let mut hands: Vec<Moving> = Vec::new();
    for side in &sides {
        let skeleton = skeleton(clip, *side, fallback);
        let rest = skeleton.local_frames(&[0.0; 29]);
        let label = |joint: Joint| names.name(joint, *side, sides.len());
        write_joint(&mut text, &rest, &label, Joint::Wrist, usize::from(two));
        let track = ticks.even.of(*side).collect();
        hands.push(Moving { skeleton, track, at: 0, before: [[0.0; 3]; 25] });
    }
    if two {
        text.push_str("}\n");
    }
    let _ = writeln!(text, "{MOTION}\n{FRAMES} {}\n{FRAME_TIME} {:.8}", ticks.count, 1.0 / rate);
    out.write_all(text.as_bytes())?;
    let mut row = String::new();
    for k in 0..ticks.count {
        row.clear();
        row.push_str(if two { "0 0 0 0 0 0 " } else { "" });
        for Moving { skeleton, track, at, before } in &mut hands {
            while *at + 1 < track.len() && ticks.at(track[*at + 1].time) <= k {
                *at += 1;
            }
            write_frame(&mut row, &skeleton.frames(&track[*at].pose), before);
        }
        writeln!(out, "{}", row.trim_end())?;
    }
    Ok(())
}

/// A hand whose rows are being written.
struct Moving<'a> {
    skeleton: Skeleton,
    track: Vec<&'a TimedPose>,
    /// The pose in force.
    at: usize,
    /// The angles in the row before.
    before: [[f64; 3]; 25],
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
        let _ = writeln!(out, "{indent}  {JOINT_CHANNELS}");
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
    let [z, x, y] = turns_zxy(rotation, [0.0; 2], before[2]);
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
    use crate::motion::tests::{clip, two_hands, worst};
    use nalgebra::Point3;
    use std::collections::HashSet;

    fn text(clip: &PoseClip, names: JointNames) -> String {
        let mut out = Vec::new();
        write_bvh(clip, &Morphology::default(), names, 25.0, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn one_hand_of_either_side_under_any_names() {
        for side in [Side::Left, Side::Right] {
            for names in JointNames::ALL {
                let one = clip(&[side]);
                let back = read_bvh(&text(&one, names)).unwrap();
                assert_eq!(back.header.hands[0].side, side, "{names:?}");
                assert!(worst(&one, &back) < 2e-6, "{names:?}");
            }
        }
    }

    #[test]
    fn sizes_are_those_of_the_offsets() {
        let mut sizes = Morphology::average(0.153);
        sizes.fingers[0].bones[2] *= 1.1;
        sizes.fingers[4].metacarpal[0] -= 0.002;
        for sides in [[Side::Left, Side::Right].as_slice(), &[Side::Left]] {
            let mut given = clip(sides);
            for hand in &mut given.header.hands {
                hand.morphology = Some(sizes.clone());
            }
            let back = read_bvh(&text(&given, JointNames::Vrm)).unwrap();
            for side in sides {
                let told = back.header.hand(*side).unwrap().morphology.clone().unwrap();
                let places = |of: &Morphology| {
                    let fingers = of.fingers.iter().flat_map(|f| [f.metacarpal, f.base, f.bones]);
                    fingers.flatten().collect::<Vec<f64>>()
                };
                for (told, given) in places(&told).into_iter().zip(places(&sizes)) {
                    assert!((told - given).abs() < 1e-6, "{told} {given}");
                }
                assert!((told.hand_length - sizes.hand_length).abs() < 2e-6);
            }
        }
        // Of a hand without end sites nobody knows how long it is.
        let whole = text(&clip(&[Side::Right]), JointNames::WebXr);
        let site = whole.find("End Site").unwrap();
        let end = site + whole[site..].find('}').unwrap() + 1;
        let without = read_bvh(&format!("{}{}", &whole[..site], &whole[end..])).unwrap();
        assert!(without.header.hands[0].morphology.is_none());
    }

    #[test]
    fn damaged_files_are_refused() {
        let text = text(&clip(&[Side::Right]), JointNames::WebXr);
        let cut = &text[..text.len() - 40];
        for (text, words) in [
            ("", "HIERARCHY"),
            (&text[..300], "line"),
            (cut, "found"),
            (&text.replace("Frames: 30", "Frames: 31"), "the motion has 30 lines, but \"Frames:\" tells 31"),
            (&text.replace("Frames: 30", "Frames: 20"), "the motion has 30 lines, but \"Frames:\" tells 20"),
            (&text[..text.find("Frames").unwrap()], "the file ends in its motion"),
            (&text.replace("0.04000000\n", "0.04000000\nnan "), "number 1 is \"nan\", allowed are finite"),
            (
                &text.replace("0.04000000\n", "0.04000000\n1 1e999 "),
                "number 2 is \"1e999\", allowed are finite",
            ),
            (&text.replace("ROOT wrist", "ROOT hip"), "no joint is the wrist"),
            (&text.replace("JOINT thumb-metacarpal", "JOINT other"), "no joint is the thumb-metacarpal"),
            (&text.replacen("  }", "", 1), "a brace is not closed"),
            (&text.replace("MOTION", "}\nMOTION"), "a closing brace too many"),
        ] {
            let message = read_bvh(text).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }

    /// An animator's: the hand goes with what it hangs on.
    #[test]
    fn a_hand_moves_with_its_root() {
        let clip = two_hands();
        let text = text(&clip, JointNames::WebXr);
        let plain = read_bvh(&text).unwrap();
        let (head, rows) = text.split_once("Frame Time").unwrap();
        let moved = |(i, row): (usize, &str)| match (i, row.strip_prefix("0 0 0 0 0 0 ")) {
            (0, _) | (_, None) => row.to_owned(),
            (_, Some(row)) => format!("1.5 0.7 -3 90 0 0 {row}"),
        };
        let rows: Vec<String> = rows.lines().enumerate().map(moved).collect();
        let found = read_bvh(&format!("{head}Frame Time{}", rows.join("\n"))).unwrap();
        let root = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        for (plain, found) in plain.frames.iter().zip(&found.frames) {
            let place = root * plain.pose.translation + Vector3::new(1.5, 0.7, -3.0);
            assert!((place - found.pose.translation).norm() < 1e-9);
            assert!((root * plain.pose.rotation).angle_to(&found.pose.rotation) < 1e-9);
            assert_eq!(plain.pose.angles, found.pose.angles);
        }
    }

    #[test]
    fn blanks_between_words_are_of_any_kind() {
        let text = text(&clip(&[Side::Right]), JointNames::WebXr);
        let clip = read_bvh(&text).unwrap();
        for time in ["Frame\tTime:\t", "Frame  Time:", "Frame Time: \t "] {
            assert_eq!(read_bvh(&text.replace("Frame Time: ", time)).unwrap(), clip, "{time:?}");
        }
        assert_eq!(read_bvh(&text.replace("Frames: ", "Frames:\t")).unwrap(), clip);
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
        let clip = two_hands();
        let text = text(&clip, JointNames::Mixamo);
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
        assert!(write_bvh(&clip, &Morphology::default(), JointNames::WebXr, 0.0, Vec::new()).is_err());
    }

    #[test]
    fn bvh_angles_never_jump() {
        let text = text(&two_hands(), JointNames::WebXr);
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
}
