//! Poses back from a GLB file the export wrote.

use std::collections::HashMap;

use ::gltf::accessor::{Accessor, DataType, Dimensions};
use ::gltf::animation::util::ReadOutputs;
use ::gltf::animation::{Interpolation, Property};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;

use super::NodeAxes;
use super::container::split;
use super::export::AXES;
use super::keys::Key;
use super::retarget::{COMPRESSED, MovedRig, RIG_NODES};
use super::root::{refused, root};
use super::{GltfError, JointNames, vrma};
use handcast_hand::turns::PosesFromTurns;
use handcast_hand::{HandPose, Joint, Morphology, Side};
use handcast_limits::{Limit, Limits};

/// Longest text of facts that is read, bytes: as values they take many times that.
const MAX_FACTS: usize = 1 << 20;

/// One hand found in a file.
#[derive(Clone, Debug)]
pub struct ImportedHand {
    /// Left or right.
    pub side: Side,
    /// The person's sizes, where the file states them.
    pub morphology: Option<Morphology>,
    /// Pose at every key time, seconds.
    pub poses: Vec<(f64, HandPose)>,
}

/// Reads the poses of every hand in a GLB that [`super::export`] wrote (names and axes of any
/// convention, the side in the wrist's `extras`) or of a rig that [`super::retarget`] moved, or of an animation
/// for VRM avatars: the joint angles at every key time of the hand's tracks.
///
/// # Errors
/// [`GltfError::Syntax`] for bytes that are no glTF, [`GltfError::Unsupported`] for a file without a hand
/// of that kind, [`GltfError::Rig`] for a moved rig that was changed since.
pub fn import_poses(glb: &[u8]) -> Result<Vec<ImportedHand>, GltfError> {
    import_poses_within(glb, &Limits::default())
}

/// As [`import_poses`], within other limits.
///
/// # Errors
/// Those of [`import_poses`], and [`GltfError::Excess`] of nodes, of keys, or of instants or seconds from the first key to
/// the last.
pub fn import_poses_within(glb: &[u8], limits: &Limits) -> Result<Vec<ImportedHand>, GltfError> {
    let (document, blob) = read_document(glb, limits)?;
    let facts = facts_of(&document);
    if let Some(bones) = vrma::bones_of(split(glb)?.0)? {
        return vrma::read(&document, blob, &bones, &facts, limits);
    }
    let moved: Vec<(Side, &Value)> = facts
        .iter()
        .filter(|hand| hand.get(RIG_NODES).is_some())
        .filter_map(|hand| Some((side_in(hand)?, hand)))
        .collect();
    if !moved.is_empty() {
        return read_rig(glb, (&document, blob), &facts, &moved, limits);
    }
    let mut by_name = HashMap::new();
    for node in document.nodes() {
        if let Some(name) = node.name() {
            by_name.insert(name.to_owned(), node.clone());
        }
    }
    let mut hands: Vec<ImportedHand> = Vec::new();
    let sides = [(1, Side::Right), (2, Side::Left), (2, Side::Right)];
    for (names, (count, told)) in JointNames::ALL.into_iter().flat_map(|n| sides.map(|s| (n, s))) {
        let name = names.name(Joint::Wrist, told, count);
        let Some(wrist) = by_name.get(&name) else { continue };
        let side = side_of(wrist).ok_or_else(|| GltfError::Unsupported {
            what: format!("node {name} does not say which side it is (extras.side)"),
        })?;
        // Most conventions name the side, whether there is one hand or two.
        if hands.iter().any(|h| h.side == side) || (names != JointNames::WebXr && side != told) {
            continue;
        }
        let nodes = Joint::ALL
            .into_iter()
            .map(|joint| {
                let name = names.name(joint, told, count);
                by_name
                    .get(&name)
                    .cloned()
                    .ok_or_else(|| GltfError::Unsupported { what: format!("node {name} is missing") })
            })
            .collect::<Result<Vec<_>, _>>()?;
        let morphology = morphology_of(&facts, side);
        let turns = turns_of(wrist, side, morphology.as_ref())?;
        let poses = read_poses(&document, blob, (side, &turns), &nodes, limits)?;
        hands.push(ImportedHand { side, morphology, poses });
    }
    if hands.is_empty() {
        let what = "no hand that this program wrote or moved: no node is named wrist, in any convention, and \
                    asset.extras tells of no rig";
        return Err(GltfError::Unsupported { what: what.into() });
    }
    Ok(hands)
}

/// The poses of hands of a rig that was moved; `moved` has the facts of each.
fn read_rig(
    glb: &[u8],
    (document, blob): (&::gltf::Document, &[u8]),
    facts: &[Value],
    moved: &[(Side, &Value)],
    limits: &Limits,
) -> Result<Vec<ImportedHand>, GltfError> {
    let rig = MovedRig::read(glb, limits)?;
    let nodes: Vec<usize> = (0..document.nodes().len()).collect();
    let (tracks, times) = read_tracks(document, blob, &nodes, limits)?;
    let hand = |(side, told): &(Side, &Value)| {
        let morphology = morphology_of(facts, *side);
        let hand = rig.hand(*side, told, &morphology.clone().unwrap_or_default())?;
        let mut reader = PosesFromTurns::new(*side).without_palms(|finger| !hand.has_palm(finger));
        let pose = |&time: &f64| (time, hand.pose(&mut reader, |node, rest| tracks[node].at(rest, time)));
        Ok(ImportedHand { side: *side, morphology, poses: times.iter().map(pose).collect() })
    };
    moved.iter().map(hand).collect()
}

/// The document and the binary chunk of a GLB. Extensions are let pass that concern meshes and materials: poses lie in
/// the nodes.
fn read_document<'a>(glb: &'a [u8], limits: &Limits) -> Result<(::gltf::Document, &'a [u8]), GltfError> {
    let (text, chunk) = split(glb)?;
    let mut json = root(text, limits)?;
    json.extensions_required.retain(|e| COMPRESSED.contains(&e.as_str()));
    Ok((::gltf::Document::from_json(json).map_err(refused)?, chunk.unwrap_or_default()))
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
fn turns_of(
    wrist: &::gltf::Node,
    side: Side,
    morphology: Option<&Morphology>,
) -> Result<[UnitQuaternion<f64>; Joint::COUNT], GltfError> {
    let unsupported = |what: String| GltfError::Unsupported { what };
    let told = told_by(wrist, AXES);
    let name = told.as_ref().map(|axes| axes.as_str().unwrap_or_default());
    let axes = NodeAxes::of_name(name).ok_or_else(|| {
        unsupported(format!("the wrist's extras.axes is {}, allowed bones, webxr", told.unwrap_or_default()))
    })?;
    match (axes, morphology) {
        (NodeAxes::WebXr, _) => Ok(axes.turns(&Morphology::default(), side)),
        (NodeAxes::Bones, Some(sizes)) => Ok(axes.turns(sizes, side)),
        // The direction of a metacarpal is the person's.
        (NodeAxes::Bones, None) => {
            let hand = side.name();
            Err(unsupported(format!(
                "nodes along the bones, but asset.extras tells no sizes of the {hand} hand"
            )))
        }
    }
}

/// What `asset.extras` tells of each hand.
fn facts_of(document: &::gltf::Document) -> Vec<Value> {
    let read = || -> Option<Vec<Value>> {
        let text = document.as_json().asset.extras.as_ref()?.get();
        let extras: Value =
            serde_json::from_str(text.get(..).filter(|text| text.len() <= MAX_FACTS)?).ok()?;
        extras.get("handcast")?.get("hands")?.as_array().cloned()
    };
    read().unwrap_or_default()
}

fn side_in(facts: &Value) -> Option<Side> {
    serde_json::from_value(facts.get("side")?.clone()).ok()
}

/// The sizes that the facts tell, if they are usable.
pub(super) fn morphology_of(facts: &[Value], side: Side) -> Option<Morphology> {
    let hand = facts.iter().find(|hand| side_in(hand) == Some(side))?;
    let morphology: Morphology = serde_json::from_value(hand.get("morphology")?.clone()).ok()?;
    morphology.validate().is_ok().then_some(morphology)
}

/// Values of one node over time; empty where no track moves it.
#[derive(Clone, Default)]
pub(super) struct NodeTrack {
    rotations: (Vec<f64>, Vec<UnitQuaternion<f64>>),
    translations: (Vec<f64>, Vec<Vector3<f64>>),
}

/// The value of a channel at a time; held before the first and after the last key.
fn sample<K: Key>(times: &[f64], keys: &[K], time: f64) -> Option<K> {
    let after = times.partition_point(|t| *t <= time);
    match (after.checked_sub(1), times.get(after)) {
        (None, _) => keys.first().copied(),
        (Some(before), None) => keys.get(before).copied(),
        (Some(before), Some(next)) => {
            let t = (time - times[before]) / (next - times[before]);
            Some(keys.get(before)?.between(keys.get(after)?, t))
        }
    }
}

impl NodeTrack {
    /// Whether a track turns the node.
    pub(super) fn turns(&self) -> bool {
        !self.rotations.0.is_empty()
    }

    /// How the node is turned against the one above it, where a track tells.
    pub(super) fn turn_at(&self, time: f64) -> Option<UnitQuaternion<f64>> {
        sample(&self.rotations.0, &self.rotations.1, time)
    }

    /// Where the node is against the one above it.
    fn at(&self, rest: &Isometry3<f64>, time: f64) -> Isometry3<f64> {
        let rotation = self.turn_at(time).unwrap_or(rest.rotation);
        let (at, keys) = &self.translations;
        let translation = sample(at, keys, time).unwrap_or(rest.translation.vector);
        Isometry3::from_parts(Translation3::from(translation), rotation)
    }
}

/// Refuses keys of a shape that glTF does not allow, or that no tool writes in animations.
fn check_keys(channel: &::gltf::animation::Channel) -> Result<(), GltfError> {
    let shape = match channel.target().property() {
        Property::Rotation => Dimensions::Vec4,
        Property::Translation => Dimensions::Vec3,
        _ => {
            let what = "a track of scales or morph weights on a joint".into();
            return Err(GltfError::Unsupported { what });
        }
    };
    let sound = |accessor: &Accessor, shape: Dimensions, packed: bool| {
        let data = accessor.data_type();
        let strides = accessor.view().is_none_or(|view| view.stride().is_none_or(|s| s >= accessor.size()));
        let data = data == DataType::F32 || packed && data != DataType::U32;
        accessor.dimensions() == shape
            && data
            && strides
            && accessor.count() > 0
            && accessor.sparse().is_none()
    };
    let sampler = channel.sampler();
    let turns = shape == Dimensions::Vec4;
    let (times, values) = (sampler.input(), sampler.output());
    if times.count() != values.count() {
        return Err(GltfError::Unsupported {
            what: format!(
                "node {} has {} key times, and values at {}",
                channel.target().node().index(),
                times.count(),
                values.count()
            ),
        });
    }
    if sound(&times, Dimensions::Scalar, false) && sound(&values, shape, turns) {
        return Ok(());
    }
    Err(GltfError::Unsupported {
        what: format!("keys of node {} have another shape", channel.target().node().index()),
    })
}

/// Whether the rows of an accessor lie within so many bytes.
fn lies_within(accessor: &Accessor, length: usize) -> bool {
    let end = || {
        let view = accessor.view()?;
        let stride = view.stride().unwrap_or_else(|| accessor.size());
        let rows = accessor.count().checked_sub(1)?.checked_mul(stride)?;
        let start = view.offset().checked_add(accessor.offset())?;
        let within = accessor.offset().checked_add(rows)?.checked_add(accessor.size())? <= view.length();
        start.checked_add(rows)?.checked_add(accessor.size()).filter(|_| within)
    };
    end().is_some_and(|end| end <= length)
}

/// How far the norm of a rotation may be from 1: bytes round it by less.
const NEAR_UNIT: f64 = 0.05;

/// How the first animation moves each of `nodes`, and all its key times in order.
pub(super) fn read_tracks(
    document: &::gltf::Document,
    blob: &[u8],
    nodes: &[usize],
    limits: &Limits,
) -> Result<(Vec<NodeTrack>, Vec<f64>), GltfError> {
    let unsupported = |what: String| GltfError::Unsupported { what };
    let place: HashMap<usize, usize> = nodes.iter().enumerate().map(|(i, n)| (*n, i)).collect();
    let mut tracks = vec![NodeTrack::default(); nodes.len()];
    let mut times: Vec<f64> = Vec::new();
    let animation = document.animations().next().ok_or_else(|| unsupported("no animation".into()))?;
    for channel in animation.channels() {
        let Some(track) = place.get(&channel.target().node().index()).and_then(|&i| tracks.get_mut(i)) else {
            continue;
        };
        let sampler = channel.sampler();
        if sampler.interpolation() != Interpolation::Linear {
            return Err(unsupported(format!("interpolation {:?}", sampler.interpolation())));
        }
        limits.check_count(Limit::Instants, sampler.input().count().max(sampler.output().count()))?;
        check_keys(&channel)?;
        let reader = channel.reader(|buffer| (buffer.index() == 0).then_some(blob));
        let short = || unsupported("an animation sampler lies outside of the binary chunk".into());
        if ![sampler.input(), sampler.output()].iter().all(|keys| lies_within(keys, blob.len())) {
            return Err(short());
        }
        let input: Vec<f64> = reader.read_inputs().ok_or_else(short)?.map(f64::from).collect();
        if !input.is_sorted() || input.iter().any(|t| !t.is_finite()) {
            return Err(unsupported("key times that do not increase".into()));
        }
        times.extend(&input);
        // Tracks share most of their times: what is twice does not pile up.
        if times.len() as u64 > limits.instants.saturating_mul(2) {
            tidy(&mut times);
            limits.check_count(Limit::Instants, times.len())?;
        }
        match reader.read_outputs().ok_or_else(short)? {
            ReadOutputs::Rotations(values) => {
                let keys = values
                    .into_f32()
                    .map(|[x, y, z, w]| {
                        let q = Quaternion::new(w, x, y, z).cast::<f64>();
                        let near = (q.norm() - 1.0).abs() < NEAR_UNIT;
                        UnitQuaternion::try_new(q, 1e-3)
                            .filter(|_| near)
                            .ok_or_else(|| unsupported("a rotation that is no unit quaternion".into()))
                    })
                    .collect::<Result<Vec<_>, _>>()?;
                track.rotations = (input, keys);
            }
            ReadOutputs::Translations(values) => {
                track.translations = (input, values.map(|v| Vector3::from(v).cast::<f64>()).collect());
            }
            _ => return Err(short()),
        }
    }
    tidy(&mut times);
    limits.check_count(Limit::Instants, times.len())?;
    let span = times.first().zip(times.last()).map_or(0.0, |(first, last)| last - first);
    limits.check(Limit::Seconds, span)?;
    Ok((tracks, times))
}

/// Least time between two instants, seconds: what other formats tell apart.
const APART: f64 = 2e-6;

/// Times in order, each once.
fn tidy(times: &mut Vec<f64>) {
    times.sort_by(f64::total_cmp);
    times.dedup_by(|later, earlier| *later - *earlier < APART);
}

fn read_poses(
    document: &::gltf::Document,
    blob: &[u8],
    (side, turns): (Side, &[UnitQuaternion<f64>; Joint::COUNT]),
    nodes: &[::gltf::Node],
    limits: &Limits,
) -> Result<Vec<(f64, HandPose)>, GltfError> {
    let numbers: Vec<_> = nodes.iter().map(::gltf::Node::index).collect();
    let (tracks, times) = read_tracks(document, blob, &numbers, limits)?;
    let rest: Vec<Isometry3<f64>> = nodes
        .iter()
        .map(|node| {
            let (t, [x, y, z, w], _) = node.transform().decomposed();
            let q = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z).cast::<f64>());
            Isometry3::from_parts(Translation3::from(Vector3::from(t).cast::<f64>()), q)
        })
        .collect();
    let mut reader = PosesFromTurns::new(side);
    let pose = |time: f64| {
        let local: Vec<_> = tracks.iter().zip(&rest).map(|(track, rest)| track.at(rest, time)).collect();
        (time, pose_from_local(&mut reader, turns, &local))
    };
    Ok(times.into_iter().map(pose).collect())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_hold_their_ends() {
        let times = [1.0, 2.0];
        let keys = [Vector3::zeros(), Vector3::x()];
        for (time, x) in [(0.0, 0.0), (1.25, 0.25), (2.0, 1.0), (9.0, 1.0)] {
            assert_eq!(sample(&times, &keys, time).unwrap().x, x);
        }
        assert!(sample::<Vector3<f64>>(&[], &[], 0.0).is_none());
    }
}
