//! Poses out of GLB and glTF files: those that the export wrote, and those of any rig that moves.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use nalgebra::{Isometry3, Quaternion, Similarity3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;

use super::export::AXES;
use super::retarget::{FoundPoses, JointMap, MovedRig, RIG_NODES};
use super::source::Source;
use super::tracks::{moving, read_tracks};
use super::{FRAME_RATE, GltfError, JointNames, NodeAxes, START, vrma};
use handcast_hand::turns::PosesFromTurns;
use handcast_hand::{Finger, HandPose, Joint, JointAngle, Morphology, Side};
use handcast_limits::Limits;

/// Longest text of facts that is read, bytes: as values they take many times that.
const MAX_FACTS: usize = 1 << 20;
/// Frame rates that a file may tell.
const RATES: std::ops::RangeInclusive<f64> = 0.1..=1000.0;

/// One hand found in a file.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ImportedHand {
    /// Left or right.
    pub side: Side,
    /// The person's sizes, where the file states them, or those of a rig at rest.
    pub morphology: Option<Morphology>,
    /// The joint angles that the file tells, in the order of [`JointAngle::ALL`]; others are 0, or shared out.
    pub angles: Vec<JointAngle>,
    /// Pose at every key time, seconds.
    pub poses: Vec<(f64, HandPose)>,
}

/// What was read of a file.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Imported {
    /// Its hands.
    pub hands: Vec<ImportedHand>,
    /// Whether it tells where the wrists are; where it does not they are at the origin.
    pub placed: bool,
    /// Frames per second of the motion, where it tells.
    pub rate: Option<f64>,
    /// What is worth saying of how it was read.
    pub notes: Vec<String>,
}

/// How to read a file.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct ImportOptions<'a> {
    /// Where the files lie that it refers to; without one they are refused.
    pub folder: Option<&'a Path>,
    /// Which joint is which, where names do not tell.
    pub map: Option<&'a JointMap>,
    /// What it may hold.
    pub limits: Limits,
}

/// Reads the poses of every hand in a .glb or .gltf file: the joint angles at every key time. Files that [`super::export`]
/// wrote (names and axes of any convention, the side in the wrist's `extras`), rigs that [`super::retarget`] moved, and animations
/// for VRM avatars tell what is what. In files of other programs joints are known by a map, by the human bones of a VRM
/// avatar, or by their names ([`super::joints_named`]); a joint is bent by as much as its bone turns from where it rests, against the one above
/// it, whatever the axes of the nodes.
///
/// # Errors
/// [`GltfError::Syntax`] for bytes that are no glTF, [`GltfError::Rig`] for a file without a hand, [`GltfError::Unsupported`] for
/// one without an animation of it, or with keys of another shape; [`GltfError::Excess`] of nodes, of keys, or of instants or seconds
/// from the first key to the last.
pub fn import(file: &[u8], options: &ImportOptions) -> Result<Imported, GltfError> {
    let limits = &options.limits;
    let source = Source::read(file, options.folder, limits)?;
    let facts = Facts::of(&source.document);
    let mut found = match vrma::bones_of(source.text)? {
        Some(bones) => vrma::read(&source, &bones, &facts, limits)?,
        None => {
            let own = match options.map {
                None => own(&source, &facts, limits)?,
                Some(_) => None,
            };
            let found = match own {
                Some(found) => found,
                None => MovedRig::of(&source)?.named(options.map, &facts, limits)?,
            };
            found.of(&facts)
        }
    };
    if let Some(start) = facts.start {
        found.hands.iter_mut().flat_map(|hand| &mut hand.poses).for_each(|(time, _)| *time += start);
    }
    Ok(found)
}

/// As [`import`], the hands alone.
///
/// # Errors
/// Those of [`import`].
pub fn import_poses(glb: &[u8]) -> Result<Vec<ImportedHand>, GltfError> {
    Ok(import(glb, &ImportOptions::default())?.hands)
}

impl FoundPoses {
    fn of(self, facts: &Facts) -> Imported {
        Imported { hands: self.hands, placed: self.placed, rate: facts.rate.or(self.rate), notes: self.notes }
    }
}

/// What this program wrote; `None` where another one did, or has changed what tells.
fn own(source: &Source, facts: &Facts, limits: &Limits) -> Result<Option<FoundPoses>, GltfError> {
    if facts.moved().next().is_some() {
        return MovedRig::of(source)?.told(facts, limits);
    }
    let document = &source.document;
    let mut by_name = HashMap::new();
    for node in document.nodes() {
        if let Some(name) = node.name() {
            by_name.insert(name.to_owned(), node.clone());
        }
    }
    let mut hands: Vec<(Side, Turns, Vec<::gltf::Node>)> = Vec::new();
    let sides = [(1, Side::Right), (2, Side::Left), (2, Side::Right)];
    for (names, (count, told)) in JointNames::ALL.into_iter().flat_map(|n| sides.map(|s| (n, s))) {
        let node = |joint: Joint| by_name.get(&names.name(joint, told, count)).cloned();
        let Some(wrist) = node(Joint::Wrist) else { continue };
        let Some(side) = side_of(&wrist) else { continue };
        // Most conventions name the side, whether there is one hand or two.
        if hands.iter().any(|(other, ..)| *other == side) || (names != JointNames::WebXr && side != told) {
            continue;
        }
        let nodes: Option<Vec<_>> = Joint::ALL.into_iter().map(node).collect();
        let turns = turns_of(&wrist, side, facts.morphology(side).as_ref())?;
        if let (Some(nodes), Some(turns)) = (nodes, turns)
            && are_turned(&nodes, &turns)
        {
            hands.push((side, turns, nodes));
        }
    }
    // A hand that another program has changed is not left out without a word.
    let lost = document
        .nodes()
        .filter_map(|node| side_of(&node))
        .any(|side| hands.iter().all(|hand| hand.0 != side));
    if hands.is_empty() || lost {
        return Ok(None);
    }
    let nodes: BTreeSet<usize> =
        hands.iter().flat_map(|(.., nodes)| nodes).map(::gltf::Node::index).collect();
    let (animation, note) = moving(document, &nodes, &nodes)?;
    let mut found = FoundPoses { hands: Vec::new(), placed: true, rate: None, notes: Vec::from_iter(note) };
    for (side, turns, nodes) in hands {
        let numbers: Vec<_> = nodes.iter().map(::gltf::Node::index).collect();
        let tracks = read_tracks(&animation, &source.bytes, &numbers, limits)?;
        for (node, track) in nodes.iter().zip(&tracks.nodes) {
            if node.children().any(|below| numbers.contains(&below.index())) {
                track.check_scales(node.index(), node.name().unwrap_or_default())?;
            }
        }
        let rest: Vec<Similarity3<f64>> = nodes.iter().map(at_rest).collect();
        let mut reader = PosesFromTurns::new(side);
        let pose = |&time: &f64| {
            let local: Vec<_> =
                tracks.nodes.iter().zip(&rest).map(|(track, rest)| track.at(rest, time).isometry).collect();
            (time, pose_from_local(&mut reader, &turns, &local))
        };
        let poses = tracks.times.iter().map(pose).collect();
        let (morphology, angles) = (facts.morphology(side), JointAngle::ALL.to_vec());
        found.hands.push(ImportedHand { side, morphology, angles, poses });
    }
    Ok(Some(found))
}

/// Sine of how far from its bone the axis of a node may be that lies along it.
const ALONG: f64 = 0.02;

/// Whether nodes have the axes that they are said to have: other programs give them their own.
fn are_turned(nodes: &[::gltf::Node], turns: &Turns) -> bool {
    let along = |joint: &Joint| {
        let next = nodes.get(joint.index() + 1)?;
        let bone = at_rest(next).isometry.translation.vector.try_normalize(1e-9)?;
        let y = turns[joint.index()].inverse() * Vector3::y();
        Some((bone - y).norm() < ALONG)
    };
    let joints = Finger::ALL.into_iter().flat_map(|finger| {
        let joints = Joint::of(finger);
        &joints[joints.len() - 4..joints.len() - 1]
    });
    joints.into_iter().all(|joint| along(joint) != Some(false))
}

fn at_rest(node: &::gltf::Node) -> Similarity3<f64> {
    let (t, [x, y, z, w], _) = node.transform().decomposed();
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z).cast::<f64>());
    let shift = Translation3::from(Vector3::from(t).cast::<f64>());
    Similarity3::from_isometry(Isometry3::from_parts(shift, turn), 1.0)
}

/// A fact that the extras of a wrist tell.
fn told_by(wrist: &::gltf::Node, fact: &str) -> Option<Value> {
    let extras: Value = serde_json::from_str(wrist.extras().as_ref()?.get()).ok()?;
    extras.get(fact).cloned()
}

fn side_of(wrist: &::gltf::Node) -> Option<Side> {
    serde_json::from_value(told_by(wrist, "side")?).ok()
}

/// How the nodes of a hand are turned in the frames of their joints.
type Turns = [UnitQuaternion<f64>; Joint::COUNT];

/// What the extras of a wrist tell of it; `None` where that takes sizes, which are not told.
fn turns_of(
    wrist: &::gltf::Node,
    side: Side,
    morphology: Option<&Morphology>,
) -> Result<Option<Turns>, GltfError> {
    let told = told_by(wrist, AXES);
    let name = told.as_ref().map(|axes| axes.as_str().unwrap_or_default());
    let axes = NodeAxes::of_name(name).ok_or_else(|| GltfError::Unsupported {
        what: format!("the wrist's extras.axes is {}, allowed bones, webxr", told.unwrap_or_default()),
    })?;
    // The direction of a metacarpal is the person's.
    Ok(morphology.map(|sizes| axes.turns(sizes, side)))
}

/// What `asset.extras` tells.
#[derive(Default)]
pub(super) struct Facts {
    hands: Vec<Value>,
    /// Frames per second.
    pub(super) rate: Option<f64>,
    /// Seconds at which times begin that the file counts from 0.
    start: Option<f64>,
}

impl Facts {
    fn of(document: &::gltf::Document) -> Self {
        let read = || -> Option<Value> {
            let text = document.as_json().asset.extras.as_ref()?.get();
            serde_json::from_str(text.get(..).filter(|text| text.len() <= MAX_FACTS)?).ok()
        };
        let Some(facts) = read().and_then(|mut extras: Value| Some(extras.get_mut("handcast")?.take()))
        else {
            return Self::default();
        };
        let number = |name: &str| facts.get(name)?.as_f64();
        Self {
            hands: facts.get("hands").and_then(Value::as_array).cloned().unwrap_or_default(),
            rate: number(FRAME_RATE).filter(|rate| RATES.contains(rate)),
            start: number(START).filter(|start| start.is_finite()),
        }
    }

    /// The hands of a rig that was moved.
    pub(super) fn moved(&self) -> impl Iterator<Item = (Side, &Value)> {
        let moved = self.hands.iter().filter(|hand| hand.get(RIG_NODES).is_some());
        moved.filter_map(|hand| Some((side_in(hand)?, hand)))
    }

    /// The sizes of a hand, if they are usable.
    pub(super) fn morphology(&self, side: Side) -> Option<Morphology> {
        let hand = self.hands.iter().find(|hand| side_in(hand) == Some(side))?;
        let morphology: Morphology = serde_json::from_value(hand.get("morphology")?.clone()).ok()?;
        morphology.validate().is_ok().then_some(morphology)
    }
}

fn side_in(facts: &Value) -> Option<Side> {
    serde_json::from_value(facts.get("side")?.clone()).ok()
}

/// The joint angles behind local transforms of nodes that `turns` turns, in the order of [`Joint::ALL`].
fn pose_from_local(
    reader: &mut PosesFromTurns,
    turns: &[UnitQuaternion<f64>; Joint::COUNT],
    local: &[Isometry3<f64>],
) -> HandPose {
    let turn = |joint: Joint| turns[joint.index()];
    let identity = Isometry3::identity();
    let at = |joint: Joint| local.get(joint.index()).unwrap_or(&identity);
    let mut pose = reader
        .pose(|joint| turn(joint.parent().unwrap_or(joint)) * at(joint).rotation * turn(joint).inverse());
    pose.translation = at(Joint::Wrist).translation.vector;
    pose.rotation = at(Joint::Wrist).rotation * turn(Joint::Wrist).inverse();
    pose
}
