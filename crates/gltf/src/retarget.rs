//! The motion of a hand on a rig made elsewhere.
//!
//! The rig keeps its proportions, its mesh and materials, and the axes of its joints: a joint is turned from
//! its rest pose by what takes the bone as it rests to the bone as the pose has it. The direction of every
//! finger bone and the axis it bends about are then those of the pose, whatever the rig's conventions. The
//! palm is laid over ours by wrist and knuckles.
//!
//! The wrist goes where the pose has it, unless it hangs on an arm: then it only turns, with the body as it stands in the
//! file. Animations that the file brings are left out.

mod body;
mod document;
mod find;
mod hand;
mod moved;
mod spare;
mod weights;

use std::collections::BTreeMap;
use std::path::Path;

use gltf_json::Index;
use nalgebra::{Similarity3, UnitQuaternion, Vector3};
use serde::Deserialize;
use serde_json::{Value, json};
use thiserror::Error;

use self::document::RigDocument;
pub(super) use self::document::{PACKED, gathered};
use self::find::find;
use self::hand::RigHand;
pub(super) use self::moved::{FoundPoses, MovedRig, RIG_NODES};
use super::animation::{Channels, moves};
use super::export::{check_clip, facts, generator};
use super::names::meaning;
use super::writer::{Writer, glb};
use super::{Clip, ExportOptions, GltfError, HandTrack};
use handcast_hand::{Joint, JointAngle, Side, Skeleton};
use handcast_limits::{Limits, quoted};

/// Most bytes of a joint map.
pub const MAX_MAP_BYTES: usize = 1 << 20;
/// Values of a track this close to the rig's rest pose are its rest pose: radians, and metres of the world.
const AT_REST: f64 = 1e-5;

/// Why a rig cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RigError {
    /// The file is no glTF, or not one that can be taken apart.
    #[error("rig: {what}")]
    File {
        /// What is wrong and where.
        what: String,
    },
    /// No hand can be made out.
    #[error(
        "rig: no hand found: {what}; a joint map says which is which: below [joints] a line such as \"Bone_012\" = \"wrist\" \
         for the wrist, the knuckles (\"index-finger-phalanx-proximal\" …) and each further joint there is"
    )]
    NoHand {
        /// What is missing.
        what: String,
    },
    /// A hand is there, and may be either.
    #[error(
        "rig: left or right cannot be told from the joints; a joint map says which is which: a line hand = \"right\" before \
         [joints], or \"left\""
    )]
    NoSide,
    /// A joint map names what is not there.
    #[error("rig: joint map: {what}")]
    Map {
        /// What is wrong, and what was allowed.
        what: String,
    },
    /// The rig and the clip have no side in common.
    #[error("rig: its hand is a {rig} one, that of the motion a {motion} one")]
    Sides {
        /// Side of the rig.
        rig: &'static str,
        /// Side of the motion.
        motion: &'static str,
    },
}

/// Why a joint map cannot be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MapError {
    /// No TOML, or not these tables.
    #[error("joint map: {0}")]
    Syntax(#[from] toml::de::Error),
    /// Too long.
    #[error("joint map: {bytes} bytes, allowed at most {MAX_MAP_BYTES}")]
    Size {
        /// How long.
        bytes: usize,
    },
    /// Joints of one hand and of two.
    #[error("joint map: [joints] is for a rig with one hand, [left] and [right] for one with two: not both")]
    Tables,
    /// A name that is no joint.
    #[error("joint map: {node:?} is to be {name:?}, which is no joint (e.g. index-finger-phalanx-proximal)")]
    Joint {
        /// The rig's joint.
        node: String,
        /// What it was said to be.
        name: String,
    },
}

/// Which joint of a rig is which of ours, in TOML:
///
/// ```toml
/// hand = "right"        # only where the joints' places leave it open
/// [joints]              # or [left] and [right]
/// Palm = "wrist"
/// F1a = "index-finger-phalanx-proximal"
/// ```
///
/// The names on the right are those of any convention of [`super::JointNames`]; on the left `"#12"` is node 12 of the file,
/// for nodes whose names do not tell them apart. Joints of the rig that are not named keep still in the one above them.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointMap {
    hand: Option<Side>,
    #[serde(default)]
    joints: BTreeMap<String, String>,
    #[serde(default)]
    left: BTreeMap<String, String>,
    #[serde(default)]
    right: BTreeMap<String, String>,
}

impl JointMap {
    /// Reads a map.
    ///
    /// # Errors
    /// See [`MapError`].
    pub fn parse(text: &str) -> Result<Self, MapError> {
        if text.len() > MAX_MAP_BYTES {
            return Err(MapError::Size { bytes: text.len() });
        }
        let map: Self = toml::from_str(text)?;
        if !(map.joints.is_empty() || map.left.is_empty() && map.right.is_empty()) {
            return Err(MapError::Tables);
        }
        for (node, name) in map.joints.iter().chain(&map.left).chain(&map.right) {
            if meaning(name).is_none() {
                return Err(MapError::Joint { node: node.clone(), name: name.clone() });
            }
        }
        Ok(map)
    }

    /// Node, joint (`None` for the palm) and side of every entry.
    fn entries(&self) -> impl Iterator<Item = (&str, Option<Joint>, Option<Side>)> {
        let tables =
            [(&self.joints, self.hand), (&self.left, Some(Side::Left)), (&self.right, Some(Side::Right))];
        tables.into_iter().flat_map(|(table, side)| {
            table.iter().filter_map(move |(node, name)| {
                let (joint, told) = meaning(name)?;
                Some((node.as_str(), joint, side.or(told)))
            })
        })
    }
}

/// A rig with a motion.
#[derive(Clone, Debug)]
pub struct Retargeted {
    /// The file, everything embedded.
    pub glb: Vec<u8>,
    /// The hands that move, of those in the clip.
    pub sides: Vec<Side>,
    /// What is worth saying: as [`CheckedRig::notes`], of the hands that move.
    pub notes: Vec<String>,
    /// What of the motion the rig does not show, since it lacks bones.
    pub lacking: Vec<String>,
}

/// A rig that can be used.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct CheckedRig {
    /// The hands it has.
    pub sides: Vec<Side>,
    /// What is worth saying: what was mended, that wrists do not travel, that nothing visible moves.
    pub notes: Vec<String>,
}

/// Whether a rig can be used: what [`retarget`] would check of it.
///
/// # Errors
/// [`GltfError::Rig`]; [`GltfError::Excess`].
pub fn check_rig(
    rig: &[u8],
    folder: Option<&Path>,
    map: Option<&JointMap>,
    limits: &Limits,
) -> Result<CheckedRig, GltfError> {
    let document = RigDocument::read(rig, folder, limits)?;
    let (hands, found) = find(&document, map, &|_| Vec::new())?;
    let notes = notes(&document, &hands.iter().collect::<Vec<_>>(), found);
    Ok(CheckedRig { sides: hands.iter().map(|hand| hand.side).collect(), notes })
}

/// What is worth saying of a rig whose `hands` move, behind what was `found` to be.
fn notes(document: &RigDocument, hands: &[&RigHand], found: Vec<String>) -> Vec<String> {
    let mut notes = document.notes.clone();
    notes.extend(found);
    let held: Vec<_> = hands.iter().filter_map(|hand| Some((hand.side.name(), hand.arm?))).collect();
    match held.as_slice() {
        [] => {}
        [(side, arm)] => {
            let arm = quoted(&document.names[*arm]);
            notes.push(format!("the {side} wrist only turns, since it hangs on an arm ({arm})"));
        }
        _ => notes.push("both wrists only turn, since they hang on arms".into()),
    }
    let mut moved = vec![false; document.names.len()];
    hands.iter().flat_map(|hand| hand.nodes()).for_each(|(_, node)| moved[node] = true);
    // Parents come first.
    for &node in &document.order {
        moved[node] |= document.parents[node].is_some_and(|above| moved[above]);
    }
    let mut carriers = (0..document.names.len()).filter(|&node| document.carries[node]).peekable();
    if carriers.peek().is_some() && !carriers.any(|node| moved[node]) {
        notes.push("nothing visible moves: no vertex has weights for the joints of the hand".into());
    }
    notes
}

/// Puts the motion of `clip` on the rigged hand or hands in `rig`, a .glb or .gltf file. `folder` is where
/// files that it refers to lie; without one they are refused. `map` says which joint is which; without it the
/// names must be those of a convention of [`super::JointNames`]. `options.names`, `skin` and
/// `animation_only` have no effect; `quantize` concerns the animation alone.
///
/// # Errors
/// [`GltfError::Rig`] for a rig that cannot be used, and those of [`super::export`] for the clip.
pub fn retarget(
    clip: &Clip,
    rig: &[u8],
    folder: Option<&Path>,
    map: Option<&JointMap>,
    options: &ExportOptions,
) -> Result<Retargeted, GltfError> {
    let sides = check_clip(clip)?;
    let mut document = RigDocument::read(rig, folder, &options.limits)?;
    let (hands, found) = find(&document, map, &|_| Vec::new())?;
    let mut writer = Writer::new(String::new());
    let mut channels = Channels::new(options);
    let mut facts = facts(clip, &sides, options);
    let (mut moved, mut lacking, mut units) = (Vec::new(), Vec::new(), Vec::new());
    for (number, (track, side)) in clip.hands.iter().zip(&sides).enumerate() {
        let Some(hand) = hands.iter().find(|h| h.side == *side) else { continue };
        let skeleton = Skeleton::new(&track.morphology, *side);
        let times: Vec<f64> = track.poses.iter().map(|(t, _)| *t).collect();
        let frames = track.poses.iter().map(|(_, pose)| skeleton.frames(pose));
        let bind = hand.bind(&document, &track.morphology)?;
        let metres = hand.sizes(&document, &bind).unit();
        if metres != 1.0 && hand.arm.is_none() {
            let side = side.name();
            units
                .push(format!("the {side} hand is made in units of {metres} m, and its wrist moves in them"));
        }
        let tracks = local_tracks(&document, hand, (&bind, metres), frames);
        let before = channels.len();
        for (node, keys) in &tracks {
            push_track(&mut channels, &mut writer, (&mut document, metres), *node, &times, keys);
        }
        // Without any track the motion would lose its duration.
        if let (Some((node, keys)), true) = (tracks.first(), channels.len() == before) {
            document.make_movable(*node);
            let turns = keys.iter().map(|key| key.isometry.rotation).collect();
            channels.rotation(&mut writer, &times, turns, Index::new(*node as u32));
        }
        lacking.extend(lacks(hand, track));
        // Which nodes they are tells those who read the poses back.
        moved::keep(&mut facts["hands"][number], &document, hand);
        moved.push(hand);
    }
    if moved.is_empty() {
        let (rig, motion) = (hands.first().map_or(Side::Right, |h| h.side), sides[0]);
        return Err(RigError::Sides { rig: rig.name(), motion: motion.name() }.into());
    }
    writer.root.push(channels.finish());
    let (mut notes, sides) = (notes(&document, &moved, found), moved.iter().map(|hand| hand.side).collect());
    notes.extend(units);
    let RigDocument { mut json, mut bytes, .. } = document;
    spare::drop_animations(&mut json, &mut bytes);
    describe(&mut json, facts);
    merge(&mut json, &mut bytes, writer)?;
    Ok(Retargeted { glb: glb(serde_json::to_vec(&json)?, &bytes)?, sides, notes, lacking })
}

/// Joint angles that stay below this are not missed, radians.
const MISSED: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// The joint angles of a motion for which a hand has no bone, and how large they become.
fn lacks(hand: &RigHand, track: &HandTrack) -> Option<String> {
    let has: Vec<JointAngle> = hand.angles().collect();
    let most = |angle: JointAngle| track.poses.iter().map(|(_, p)| p.angle(angle).abs()).fold(0.0, f64::max);
    let missed = JointAngle::ALL.into_iter().filter(|angle| !has.contains(angle));
    let missed: Vec<String> = missed
        .filter(|angle| most(*angle) > MISSED)
        .map(|angle| format!("{} (up to {:.0}°)", angle.name(), most(angle).to_degrees()))
        .collect();
    let side = hand.side.name();
    (!missed.is_empty()).then(|| format!("the {side} hand has no bone of its own for {}", missed.join(", ")))
}

/// Local transforms over time of each node that moves.
fn local_tracks(
    document: &RigDocument,
    hand: &RigHand,
    (bind, metres): (&hand::Bind, f64),
    frames: impl Iterator<Item = handcast_hand::HandFrames>,
) -> Vec<(usize, Vec<Similarity3<f64>>)> {
    let moved: Vec<usize> = hand.nodes().map(|(_, node)| node).collect();
    let mut tracks: Vec<Vec<Similarity3<f64>>> = vec![Vec::new(); moved.len()];
    let slot = |node: usize| moved.iter().position(|&n| n == node);
    // Only these and what lies above them matter.
    let order: Vec<(usize, Option<usize>)> = document
        .order
        .iter()
        .filter(|&&n| moved.iter().any(|&m| m == n || document.is_below(m, n)))
        .map(|&n| (n, slot(n)))
        .collect();
    let mut world = document.world.clone();
    for frames in frames {
        let placed = hand.placed(document, bind, metres, &frames);
        for &(node, slot) in &order {
            let above = document.parents[node].map_or_else(Similarity3::identity, |p| world[p]);
            world[node] = match slot {
                Some(slot) => {
                    tracks[slot].push(above.inverse() * placed[slot]);
                    placed[slot]
                }
                None => above * document.locals[node],
            };
        }
    }
    moved.into_iter().zip(tracks).collect()
}

/// Tracks of what leaves the rest pose.
fn push_track(
    channels: &mut Channels,
    writer: &mut Writer,
    (document, metres): (&mut RigDocument, f64),
    node: usize,
    times: &[f64],
    keys: &[Similarity3<f64>],
) {
    let rest = document.locals[node];
    let index = Index::new(node as u32);
    let shifts: Vec<Vector3<f64>> = keys.iter().map(|k| k.isometry.translation.vector).collect();
    let turns: Vec<UnitQuaternion<f64>> = keys.iter().map(|k| k.isometry.rotation).collect();
    // A unit of the node above in those of the world.
    let above = document.parents[node].map_or(1.0, |above| document.world[above].scaling());
    let (shift, turn) = (
        moves(&shifts, &rest.isometry.translation.vector, AT_REST / above),
        moves(&turns, &rest.isometry.rotation, AT_REST),
    );
    if shift || turn {
        document.make_movable(node);
    }
    if shift {
        channels.translation(writer, times, &shifts, 1.0 / (above * metres), index);
    }
    if turn {
        channels.rotation(writer, times, turns, index);
    }
}

/// Who made the file, and of what.
fn describe(json: &mut Value, mut facts: Value) {
    let asset = &mut json["asset"];
    if let (Some(rig), Some(facts)) = (asset.get("generator").cloned(), facts.as_object_mut()) {
        facts.insert("rig_generator".into(), rig);
    }
    asset["generator"] = generator().into();
    match asset.get_mut("extras").and_then(Value::as_object_mut) {
        Some(extras) => {
            extras.insert("handcast".into(), facts);
        }
        None => asset["extras"] = json!({ "handcast": facts }),
    }
}

/// Appends the animation and its data to the rig's document, which has no other.
fn merge(json: &mut Value, bytes: &mut Vec<u8>, writer: Writer) -> Result<(), GltfError> {
    let (root, data) = writer.into_parts();
    let mut added = serde_json::to_value(&root)?;
    while !bytes.len().is_multiple_of(4) {
        bytes.push(0);
    }
    let count = |json: &Value, list: &str| json[list].as_array().map_or(0, Vec::len);
    let (views, accessors) = (count(json, "bufferViews"), count(json, "accessors"));
    let shift = |value: &mut Value, by: usize| {
        *value = (value.as_u64().unwrap_or(0) + by as u64).into();
    };
    let each = |value: &mut Value, list: &str| match value[list].take() {
        Value::Array(items) => items,
        _ => Vec::new(),
    };
    for mut view in each(&mut added, "bufferViews") {
        view["buffer"] = 0.into();
        shift(&mut view["byteOffset"], bytes.len());
        append(json, "bufferViews", view);
    }
    for mut accessor in each(&mut added, "accessors") {
        shift(&mut accessor["bufferView"], views);
        append(json, "accessors", accessor);
    }
    for mut animation in each(&mut added, "animations") {
        for sampler in animation["samplers"].as_array_mut().into_iter().flatten() {
            shift(&mut sampler["input"], accessors);
            shift(&mut sampler["output"], accessors);
        }
        append(json, "animations", animation);
    }
    bytes.extend_from_slice(&data);
    while !bytes.len().is_multiple_of(4) {
        bytes.push(0);
    }
    json["buffers"] = json!([{ "byteLength": bytes.len() }]);
    Ok(())
}

fn append(json: &mut Value, list: &str, item: Value) {
    match json[list].as_array_mut() {
        Some(items) => items.push(item),
        None => json[list] = json!([item]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_name_joints_of_any_convention() {
        let map = JointMap::parse("hand = \"left\"\n[joints]\nA = \"wrist\"\nB = \"Index_Tip_L\"\n").unwrap();
        let entries: Vec<_> = map.entries().collect();
        assert_eq!(entries[0], ("A", Some(Joint::Wrist), Some(Side::Left)));
        assert_eq!(entries[1], ("B", Some(Joint::IndexTip), Some(Side::Left)));
        let message = |text: &str| JointMap::parse(text).unwrap_err().to_string();
        assert!(message("[joints]\nA = \"elbow\"").contains("\"elbow\", which is no joint"));
        assert!(message("[bones]\nA = \"wrist\"").contains("unknown field"));
        assert!(message("[joints]\nA = \"wrist\"\n[left]\nB = \"wrist\"").contains("not both"));
        assert!(message(&" ".repeat(MAX_MAP_BYTES + 1)).contains("allowed at most"));
    }
}
